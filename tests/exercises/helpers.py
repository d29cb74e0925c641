"""Run the exercises' source notebooks without a kernel: solved, with other answers, or as a student gets them."""

import re
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import nbformat
import pytest

from mireach.exercises import Wrong

matplotlib.use("Agg")

SOURCE = Path(__file__).resolve().parents[2] / "notebooks" / "exercises" / "source"
SOLUTION = re.compile(r"^[ \t]*### BEGIN SOLUTION.*?^[ \t]*### END SOLUTION[^\n]*\n?", re.DOTALL | re.MULTILINE)


def numbers():
    """The numbers of the exercise sets that exist, in order."""
    return sorted(int(folder.name[2:]) for folder in SOURCE.glob("ex[0-9][0-9]"))


def read_source(number):
    """The instructor's notebook of set `number`."""
    name = f"ex{number:02d}"
    return nbformat.read(SOURCE / name / f"{name}.ipynb", as_version=4)


def nbgrader_data(cell):
    """A cell's nbgrader metadata; {} for a plain cell."""
    return cell.metadata.get("nbgrader", {})


def run_source(number, replace=None):
    """Execute the code cells of a set in order, except its check cells.

    Parameters
    ----------
    number : int
        1 for ex01.
    replace : dict of str to str or None
        grade_id of an answer cell -> code that stands in its place. The other answer cells keep their solutions.

    Returns
    -------
    dict
        The namespace after the last cell.

    Raises
    ------
    KeyError
        If `replace` names a cell that does not exist.
    """
    return _run(number, dict(replace or {}), lambda source: source)


def placeholder(number):
    """Execute a set as a student gets it, with every solution removed; the namespace after the last cell."""
    return _run(number, {}, without_solution)


def without_solution(source):
    """A cell's code without what stands between BEGIN SOLUTION and END SOLUTION."""
    return SOLUTION.sub("", source)


def check_cells(number):
    """The check cells of a set: dict of grade_id to code."""
    cells = read_source(number).cells
    return {nbgrader_data(cell)["grade_id"]: cell.source for cell in cells if nbgrader_data(cell).get("grade")}


def expect(check, answer, *words):
    """The check raises Wrong for a single answer, and its hint says all the words."""
    expect_hint(check, answer, words=words)


def expect_hint(check, *answers, words):
    """The check raises Wrong for the answers, and its hint says all the words."""
    with pytest.raises(Wrong) as hint:
        check(*answers)
    for word in words:
        assert word in str(hint.value), hint.value


def _run(number, replace, change):
    namespace = {"__name__": "__main__"}
    for i, cell in enumerate(read_source(number).cells):
        grader = nbgrader_data(cell)
        if cell.cell_type != "code" or grader.get("grade"):
            continue
        code = replace.pop(grader.get("grade_id"), None)
        if code is None:
            code = change(cell.source)
        exec(compile(code, f"ex{number:02d}, cell {i}", "exec"), namespace)
    if replace:
        raise KeyError(f"ex{number:02d} has no answer cell {', '.join(map(repr, replace))}")
    plt.close("all")
    return namespace
