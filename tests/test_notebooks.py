"""Every notebook of the course: executed with nbval, key results compared, and in order as a file.

nbval runs in a process of its own, one a notebook: its items are cells, which must neither be spread over xdist's
workers nor reordered.
"""

import os
import re
import subprocess
import sys
from pathlib import Path

import jupytext
import nbformat
import pytest

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "notebooks"
SOURCES = sorted(FOLDER.glob("[0-9][0-9]_*.py"))
NAMES = [source.stem for source in SOURCES]
CHECKED = "nbval-check-output"
CELL_TIMEOUT = 300  # seconds; the longest cells train a network
LARGEST = 2 * 2**20  # bytes
OPENING = ("what you will do", "learn", "need")
CLOSING = ("what you saw", "on your own", "further reading")


def run_nbval(path):
    """Execute a notebook; compare the outputs of the cells that carry the tag."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST")}
    environment |= {"OMP_NUM_THREADS": "1"}  # two notebooks at once would fight for the cores
    command = [sys.executable, "-m", "pytest", "--nbval-lax", f"--nbval-cell-timeout={CELL_TIMEOUT}", "-q"]
    options = ["-o", "addopts=", "-p", "no:cacheprovider", "-p", "no:xdist", "--rootdir", str(path.parent)]
    return subprocess.run([*command, *options, str(path)], env=environment, capture_output=True, text=True)


def read(name):
    """The .ipynb of a notebook."""
    return nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)


def text_of(cell):
    """What a cell shows as text."""
    outputs = cell.get("outputs", [])
    return "".join(output.get("text", "") or output.get("data", {}).get("text/plain", "") for output in outputs)


def test_there_are_notebooks_and_each_has_both_files():
    assert NAMES
    assert NAMES == sorted(path.stem for path in FOLDER.glob("[0-9][0-9]_*.ipynb"))


@pytest.mark.parametrize("name", NAMES)
def test_runs_and_key_results_agree(name):
    done = run_nbval(FOLDER / f"{name}.ipynb")
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]


@pytest.mark.parametrize("name", NAMES)
def test_both_files_say_the_same(name):
    def content(notebook):
        return [(cell.cell_type, cell.source, cell.metadata.get("tags", [])) for cell in notebook.cells]

    assert content(jupytext.read(FOLDER / f"{name}.py")) == content(read(name)), f"run notebooks/build.py {name}"


@pytest.mark.parametrize("name", NAMES)
def test_file_is_in_order(name):
    notebook = read(name)
    nbformat.validate(notebook)
    assert notebook.metadata.kernelspec.name == "python3"  # JupyterLab asks for a kernel without it
    assert (FOLDER / f"{name}.ipynb").stat().st_size < LARGEST
    checked = [cell for cell in notebook.cells if CHECKED in cell.metadata.get("tags", [])]
    assert checked
    for cell in checked:
        assert text_of(cell).strip(), f"nothing to compare with is stored below\n{cell.source}"
    for cell in notebook.cells:
        for output in cell.get("outputs", []):
            assert output.output_type != "error" and output.get("name") != "stderr", cell.source
            assert str(ROOT) not in str(output) and "Warning:" not in str(output.get("text", "")), cell.source


@pytest.mark.parametrize("name", NAMES)
def test_opens_and_closes_as_all_do(name):
    markdown = [cell.source for cell in read(name).cells if cell.cell_type == "markdown"]
    assert markdown[0].startswith("# ")
    opening, closing = "\n".join(markdown[:2]).lower(), "\n".join(markdown[-4:]).lower()
    assert all(words in opening for words in OPENING)
    assert re.search(r"second|minute", opening), "say how long it runs"
    assert all(words in closing for words in CLOSING)


def test_nbval_notices_a_changed_result(tmp_path):
    cell = nbformat.v4.new_code_cell("print(6 * 7)", metadata={"tags": [CHECKED]}, execution_count=1)
    cell.outputs = [nbformat.v4.new_output("stream", name="stdout", text="42\n")]
    kernelspec = {"display_name": "Python 3 (ipykernel)", "language": "python", "name": "python3"}
    notebook = nbformat.v4.new_notebook(cells=[cell], metadata={"kernelspec": kernelspec})
    path = tmp_path / "small.ipynb"
    nbformat.write(notebook, path)
    done = run_nbval(path)
    assert done.returncode == 0, done.stdout
    cell.outputs[0].text = "43\n"
    nbformat.write(notebook, path)
    done = run_nbval(path)
    assert done.returncode == 1 and "mismatch" in done.stdout and "43" in done.stdout
