"""The package away from its checkout, and the entry point."""

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

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
    static = ROOT / "lib" / "mireach" / "static"
    assert {path.name for path in (tmp_path / "site" / "mireach" / "static").iterdir()} == {
        path.name for path in static.iterdir()
    }


def test_the_readme_s_example_runs_and_its_files_exist(capsys):
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    exec(code, {})
    assert capsys.readouterr().out.startswith("proven")
    for path in re.findall(r"\]\((?!http)([^)]+)\)", text):
        assert (ROOT / path).is_file(), path


def test_run_py_uses_the_standard_library_only():
    tree = ast.parse((ROOT / "run.py").read_text(encoding="utf-8"))
    imported = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    imported |= {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert imported <= sys.stdlib_module_names | {"pathlib"}


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
