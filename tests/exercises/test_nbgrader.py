"""The whole way of an exercise through nbgrader: release, submit, autograde. Slow parts run once a set."""

import importlib.util
import shutil
from pathlib import Path

import nbformat
import pytest
from helpers import SOURCE, nbgrader_data, numbers, read_source, without_solution

pytestmark = pytest.mark.filterwarnings("ignore::sqlalchemy.exc.SAWarning")  # of nbgrader's own queries
COURSE = SOURCE.parent
NAMES = [f"ex{number:02d}" for number in numbers()]


@pytest.fixture(scope="module")
def script():
    """notebooks/exercises/release.py as a module."""
    spec = importlib.util.spec_from_file_location("release", COURSE / "release.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def copy_course(folder, names):
    """A course folder with some of the sources."""
    for name in names:
        shutil.copytree(SOURCE / name, folder / "source" / name)
    return folder


def submit(course, student, name, notebook):
    """Hand in a notebook."""
    target = course / "submitted" / student / name
    target.mkdir(parents=True)
    nbformat.write(notebook, target / f"{name}.ipynb")


def solved(released, source):
    """The released copy with the source's answer cells in it, as a student would have typed them."""
    answers = {nbgrader_data(cell)["grade_id"]: cell.source for cell in source.cells if nbgrader_data(cell)}
    for cell in released.cells:
        if nbgrader_data(cell).get("solution"):
            cell.source = answers[nbgrader_data(cell)["grade_id"]]
    return released


def errors(cell):
    """The names of the exceptions that a cell's outputs hold."""
    return [output.ename for output in cell.get("outputs", []) if output.output_type == "error"]


def test_there_are_exercises_and_they_are_discovered():
    assert "ex01" in NAMES


@pytest.mark.parametrize("name", NAMES)
def test_source_is_in_order(name):
    notebook = read_source(int(name[2:]))
    nbformat.validate(notebook)
    assert notebook.nbformat == 4 and notebook.nbformat_minor >= 5
    assert notebook.metadata.kernelspec.name == "python3"
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert not any(cell.outputs or cell.execution_count for cell in code)
    marked = [(cell, nbgrader_data(cell)) for cell in code if nbgrader_data(cell)]
    answers = [(cell, data) for cell, data in marked if data["solution"]]
    checks = [(cell, data) for cell, data in marked if data["grade"]]
    assert 3 <= len(answers) <= 6 and len(answers) + len(checks) == len(marked)
    assert [data["grade_id"] for _, data in marked[1::2]] == [f"{data['grade_id']}_check" for _, data in marked[::2]]
    for cell, data in answers:
        assert not data["locked"] and "### BEGIN SOLUTION" in cell.source and "### END SOLUTION" in cell.source
    for cell, data in checks:
        assert data["locked"] and 1 <= data["points"] <= 3 and f"{name}.check" in cell.source


@pytest.mark.parametrize("name", NAMES)
def test_way_through_nbgrader(name, script, tmp_path, monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "1")  # two trainings at once would fight for the cores
    course = copy_course(tmp_path, [name])
    api = script.course_api(course, tmp_path / "gradebook.db")
    answer = api.generate_assignment(name)
    assert answer["success"], answer["log"]
    source = read_source(int(name[2:]))
    released = nbformat.read(course / "release" / name / f"{name}.ipynb", as_version=4)

    assert_no_solution(released, source)
    submit(course, "untouched", name, released)
    submit(course, "solved", name, solved(released, source))
    for student in ("untouched", "solved"):
        answer = api.autograde(name, student)
        assert answer["success"], answer["log"]

    with api.gradebook as book:
        full, zero = (book.find_submission(name, student) for student in ("solved", "untouched"))
        assert full.score == full.max_score > 0 and not full.needs_manual_grade
        assert zero.score == 0 and zero.max_score == full.max_score
    assert_only_checks_fail(nbformat.read(course / "autograded" / "untouched" / name / f"{name}.ipynb", as_version=4))


def assert_no_solution(released, source):
    """No marker, and no line that stands only in solutions, is left in the released copy."""
    text = "\n".join(cell.source for cell in released.cells)
    assert "BEGIN SOLUTION" not in text and "END SOLUTION" not in text
    assert "NotImplementedError" not in text
    public = {line.strip() for cell in source.cells for line in without_solution(cell.source).splitlines()}
    every = {line.strip() for cell in source.cells for line in cell.source.splitlines()}
    secret = {line for line in every - public if line}
    assert secret and not secret & {line.strip() for line in text.splitlines()}


def assert_only_checks_fail(autograded):
    """An untouched copy runs from top to bottom, and each check says that nothing is filled in."""
    for cell in autograded.cells:
        if nbgrader_data(cell).get("grade"):
            assert errors(cell) == ["Wrong"], (cell.source, errors(cell))
        elif cell.cell_type == "code":
            assert not errors(cell), (cell.source, cell.outputs)


def test_script_keeps_copies_that_students_may_have_worked_on(script, tmp_path, capsys):
    course = copy_course(tmp_path, ["ex01"])
    written = script.release(["ex01"], course=course)
    assert written == [course / "release" / "ex01" / "ex01.ipynb"] and written[0].exists()
    assert not list(tmp_path.rglob("gradebook.db"))
    written[0].write_text("my answers")
    assert script.release(["ex01"], course=course) == [] and written[0].read_text() == "my answers"
    assert "kept" in capsys.readouterr().out
    assert script.release(["ex01"], force=True, course=course) and written[0].read_text() != "my answers"


def test_script_names_what_there_is(script, capsys):
    with pytest.raises(SystemExit):
        script.main(["ex77"])
    assert "there is no exercise ex77; choose from ex01" in capsys.readouterr().err


def test_teachers_can_use_the_same_settings():
    settings = Path(COURSE / "nbgrader_config.py").read_text(encoding="utf-8")
    assert "code_stub" in settings and "course_id" in settings
