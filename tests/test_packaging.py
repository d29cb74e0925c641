"""The package away from its checkout, and the entry point."""

import ast
import importlib
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

import mireach

ROOT = Path(__file__).resolve().parents[1]
HEAVY = ("torch", "casadi", "cvxpy", "daqp", "joblib", "dask", "matplotlib", "cvxopt")


def test_installed_package_carries_its_data_and_needs_no_heavy_parts(tmp_path):
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-compile"]
    subprocess.run([*pip, "--target", str(tmp_path / "site"), str(ROOT)], check=True)
    script = f"""
import sys
sys.modules.update(dict.fromkeys({HEAVY!r}))  # importing one of them fails from here on
import mireach as mr
assert mr.__file__.startswith({str(tmp_path)!r}), mr.__file__
for name in ("pwa", "double_integrator"):
    case = mr.case_study(name)
    safe = mr.safe_set(case.loop, case.safe_directions)
    assert safe.verdict == "proven"
    assert mr.terminal_set(case.loop, safe, case.directions).steps > 0
"""
    environment = {**os.environ, "PYTHONPATH": str(tmp_path / "site")}
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    static = ROOT / "lib" / "mireach" / "lab" / "static"
    assert {path.name for path in (tmp_path / "site" / "mireach" / "lab" / "static").iterdir()} == {
        path.name for path in static.iterdir()
    }


COMPILE = """
import mireach
import numpy as np
from mireach.sets.kernels import _most  # the smallest of the compiled functions
assert _most(np.array([0, 3, 8])) == 5
print(mireach.__file__)
"""


@pytest.fixture
def package(tmp_path):
    """A copy of the package, and an environment that imports it and has no home."""
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "lib" / "mireach", tmp_path / "site" / "mireach", ignore=ignored)
    (tmp_path / "file").touch()
    (tmp_path / "tmp").mkdir()
    nowhere = str(tmp_path / "file" / "below")  # cannot be made, by no user
    environment = dict.fromkeys(("HOME", "XDG_CACHE_HOME", "NUMBA_CACHE_DIR", "USERPROFILE"), nowhere)
    environment |= {"PYTHONPATH": str(tmp_path / "site"), "TMPDIR": str(tmp_path / "tmp")}
    return tmp_path / "site" / "mireach", tmp_path / "tmp", {**os.environ, **environment}


def run_compiled(package, before=""):
    """Import the copy, compute with it, and see that it says nothing else."""
    folder, _, environment = package
    command = [sys.executable, "-c", before + COMPILE]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == str(folder / "__init__.py") and not done.stderr


@pytest.mark.skipif(os.name == "nt", reason="the temporary folder of Windows belongs to its user")
@pytest.mark.parametrize("foreign", [None, "file", "open", "link"])
def test_package_works_where_neither_its_folder_nor_the_home_can_be_written(package, foreign):
    folder, temporary, _ = package
    (folder / "sets" / "__pycache__").touch()  # a file, in which no user can write compiled code
    private = temporary / f"mireach-{os.getuid()}"
    if foreign == "file":
        private.touch()
    elif foreign == "link":
        (temporary / "elsewhere").mkdir(mode=0o700)
        private.symlink_to(temporary / "elsewhere")
    elif foreign == "open":
        private.mkdir()
        private.chmod(0o777)
    run_compiled(package)
    assert (folder / "sets" / "__pycache__").is_file()
    assert bool([*private.rglob("*.nbc"), *temporary.rglob("*.nbc")]) == (foreign is None)
    if foreign is None:
        assert private.stat().st_mode & 0o777 == 0o700
        run_compiled(package)


def test_package_works_where_compiled_code_cannot_be_kept_or_read(package):
    pytest.importorskip("resource")  # a limit of the size of files stands for a full disk
    limit = "import resource, signal\nsignal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
    run_compiled(package, f"{limit}resource.setrlimit(resource.RLIMIT_FSIZE, (100, resource.RLIM_INFINITY))\n")
    kept = package[0] / "sets" / "__pycache__"
    assert not list(kept.glob("*.nbc"))
    run_compiled(package)
    files = [*kept.glob("*.nbi"), *kept.glob("*.nbc")]
    assert files
    for file in files:
        file.write_bytes(file.read_bytes()[:60])
    run_compiled(package)


def in_a_new_process(script):
    """What a script prints, with warnings as errors."""
    done = subprocess.run([sys.executable, "-W", "error", "-c", script], capture_output=True, text=True)
    assert done.stderr == ""
    return done.stdout.strip()


def test_import_says_nothing_and_brings_no_heavy_parts():
    script = "import mireach, sys; {}; print([name for name in {} if name in sys.modules])"
    assert in_a_new_process(script.format("pass", (*HEAVY, "numba", "shapely", "scipy", "highspy", "numpy"))) == "[]"
    assert in_a_new_process(script.format("mireach.safe_set", HEAVY)) == "[]"


def test_the_public_names_are_those_of_the_stub_and_can_be_imported():
    stub = ast.parse((ROOT / "lib" / "mireach" / "__init__.pyi").read_text())
    listed = next(ast.literal_eval(node.value) for node in stub.body if isinstance(node, ast.Assign))
    assert sorted(listed) == sorted(mireach.__all__) and set(listed) <= set(dir(mireach))
    assert in_a_new_process(f"from mireach import *; print(set({listed}) <= set(globals()))") == "True"
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = mireach.no_such_name


def test_the_parts_of_an_engine_on_the_architecture_page_exist():
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    (table,) = re.findall(r"\| part \|.*?\n\n", text, flags=re.DOTALL)
    parts = re.findall(r"`(\w+)\.(\w+)`", table)
    assert len(parts) >= 8
    for module, name in parts:
        assert hasattr(importlib.import_module(f"mireach.engines.{module}"), name), (module, name)


def test_the_readme_s_example_runs_and_its_files_exist(capsys):
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    exec(code, {})
    printed = re.findall(r"print\(\w+\)  # (.*)", code)
    assert len(printed) == 2 and capsys.readouterr().out.splitlines() == printed
    for path in re.findall(r"\]\((?!http)([^)]+)\)", text):
        assert (ROOT / path).is_file(), path


def test_run_py_uses_the_standard_library_only():
    tree = ast.parse((ROOT / "run.py").read_text(encoding="utf-8"))
    imported = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    imported |= {node.module.split(".")[0] for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert imported <= sys.stdlib_module_names


SET_UP = """
import sys, time, pathlib
sys.path.insert(0, {folder!r})
import run, venv

def create(place, with_pip, clear):
    log("venv")
    run.PYTHON.parent.mkdir(parents=True, exist_ok=True)
    time.sleep(1)
    run.PYTHON.touch()

def log(line):
    with open({folder!r} + "/log", "a") as file:
        file.write(line + "\\n")

venv.create, run.install = create, lambda command: (time.sleep(0.5), log("install"))
run.compile_kernels = lambda: log("compile")
run.set_up()
log("ready")
"""


@pytest.fixture
def checkout(tmp_path):
    """run.py in a folder of its own."""
    for name in ("run.py", "requirements.txt", "pyproject.toml"):
        shutil.copy(ROOT / name, tmp_path / name)
    return tmp_path


def test_two_first_set_ups_at_once_install_once_and_the_second_says_that_it_waits(checkout):
    command = [sys.executable, "-c", SET_UP.format(folder=str(checkout))]
    both = [subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) for _ in range(2)]
    said = sorted(process.communicate(timeout=60)[0] for process in both)
    assert [process.returncode for process in both] == [0, 0]
    assert said[0].startswith("setting up .venv") and said[1].startswith("waiting for another process")
    assert "setting up .venv (some" not in said[1]
    assert (checkout / "log").read_text().split() == ["venv", "install", "install", "compile", "ready", "ready"]


def test_a_set_up_that_was_killed_leaves_no_lock_behind(checkout):
    slow = SET_UP.format(folder=str(checkout)).replace("time.sleep(1)", "time.sleep(100)")
    first = subprocess.Popen([sys.executable, "-c", slow])
    while not (checkout / "log").exists():
        time.sleep(0.05)
    first.kill()
    first.wait()
    command = [sys.executable, "-c", SET_UP.format(folder=str(checkout))]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and "waiting" not in done.stdout
    assert (checkout / "log").read_text().split() == ["venv", "venv", "install", "install", "compile", "ready"]


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("sys.modules['ensurepip'] = None", ["apt install python3-venv"]),
        (
            "venv.create = lambda *_, **__: pathlib.Path('/dev/null/x').mkdir()",
            ["cannot make a virtual", "/dev/null/x"],
        ),
        ("run.LOCK = pathlib.Path('/dev/null/lock')", ["cannot set up", "/dev/null/lock"]),
    ],
)
def test_a_set_up_that_fails_says_why(checkout, fault, words):
    script = SET_UP.format(folder=str(checkout)).replace("run.set_up()", f"{fault}\nrun.set_up()")
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 1 and all(word in done.stderr for word in words), done.stderr
    assert ("apt install" in done.stderr) == ("apt install" in words[0]) and "Traceback" not in done.stderr


def test_run_py_lists_its_tasks_and_refuses_others():
    run = [sys.executable, str(ROOT / "run.py")]
    listed = subprocess.run(run, capture_output=True, text=True)
    assert listed.returncode == 0 and "reproduce" in listed.stdout and "test" in listed.stdout
    refused = subprocess.run([*run, "tset"], capture_output=True, text=True)
    assert refused.returncode and "choose one of" in refused.stderr


def test_code_is_clean_by_ruff():
    for command in (["check"], ["format", "--check"]):
        done = subprocess.run([sys.executable, "-m", "ruff", *command, str(ROOT)], capture_output=True, text=True)
        assert done.returncode == 0, done.stdout


def test_every_requirement_is_pinned_and_has_a_reason():
    for line in (ROOT / "requirements.txt").read_text().splitlines()[1:]:
        package, _, reason = line.partition("#")
        assert "==" in package and reason.strip(), line
