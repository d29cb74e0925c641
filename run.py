#!/usr/bin/env python3
"""The one entry point: makes .venv, installs what is pinned in requirements.txt, runs a task.

    python3 run.py reproduce          the case studies -> results/report.md, results/report.json, docs/figures/
    python3 run.py test               every test, the notebooks and exercises included
    python3 run.py verify FILE        check a certificate, such as data/pwa/certificate.json; needs no set-up
    python3 run.py lab                JupyterLab on notebooks/
    python3 run.py app                the disturbance lab as a page of its own, for a lecture
    python3 run.py exercises          the students' copies of the exercises -> notebooks/exercises/release/
    python3 run.py notebooks [NAME]   execute the notebooks' .py files and keep the outputs in the .ipynb files
    python3 run.py train CASE         make the data set and the network of CASE from scratch; the cases are pwa,
                                      double_integrator, three_tanks, four_tanks, aircraft_pitch and quadrotor
    python3 run.py seeds CASE         the seed study of pwa or double_integrator, on all cores or with --scheduler
                                      ADDRESS; with --analyse-only its maximal safe sets alone; a study that was
                                      interrupted is resumed
    python3 run.py bench              benchmarks/

What follows the task is passed on to it: `python3 run.py reproduce --help`.
Needs only Python 3.11 or newer with pip, on Linux, macOS or Windows.
"""

import hashlib
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

ROOT = Path(__file__).resolve().parent
VENV = ROOT / ".venv"
STAMP = VENV / "installed"  # written last: the digest of what was installed
LOCK = ROOT / ".venv.lock"  # held while .venv is being made
PYTHON = VENV / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
FIRST_CALLS = """
import mireach as mr
for name in ("pwa", "three_tanks"):
    case = mr.case_study(name)
    mr.safe_set(case.loop, case.safe_directions)
"""
TASKS = {
    "reproduce": ["-m", "mireach", "reproduce"],
    "test": ["-m", "pytest", "-n", "auto"],
    "train": ["-m", "mireach", "train"],
    "seeds": ["-m", "mireach", "seeds"],
    "lab": ["-m", "jupyterlab", "notebooks"],
    "app": [str(ROOT / "notebooks" / "app.py")],
    "exercises": [str(ROOT / "notebooks" / "exercises" / "release.py")],
    "notebooks": [str(ROOT / "notebooks" / "build.py")],
    "verify": [str(ROOT / "lib" / "mireach" / "certificate" / "checker.py")],
    "bench": [str(ROOT / "benchmarks" / "run.py")],
}


def set_up() -> None:
    """Make .venv and install, unless the last installation was of the same files; one process at a time."""
    wanted = hashlib.sha256()
    for name in ("requirements.txt", "pyproject.toml"):
        wanted.update((ROOT / name).read_bytes())
    wanted.update(f"{sys.version} {ROOT}".encode())
    if is_installed(wanted.hexdigest()):
        return
    with locked(LOCK):
        if not is_installed(wanted.hexdigest()):  # another process may have done it while this one waited
            make_environment()
            STAMP.write_text(wanted.hexdigest())


def is_installed(wanted: str) -> bool:
    """Whether .venv was made from what has the digest `wanted`."""
    return PYTHON.exists() and STAMP.exists() and STAMP.read_text() == wanted


def make_environment() -> None:
    """Make .venv anew and install into it."""
    print("setting up .venv (some minutes the first time)", flush=True)
    try:
        import ensurepip  # noqa: F401 - Debian's python3 comes without it
        import venv

        venv.create(VENV, with_pip=True, clear=True)
    except ImportError as error:
        sys.exit(f"cannot make a virtual environment ({error}). On Debian and Ubuntu: apt install python3-venv")
    except (OSError, subprocess.CalledProcessError) as error:
        sys.exit(f"cannot make a virtual environment in {VENV}: {error}")
    pip = [str(PYTHON), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    install([*pip, "-r", str(ROOT / "requirements.txt")])
    install([*pip, "--no-deps", "--no-build-isolation", "-e", str(ROOT)])
    compile_kernels()


def compile_kernels() -> None:
    """Run the compiled functions once; numba keeps them on disk. A failure shows when they are used."""
    print("compiling (about a minute, once)", flush=True)
    subprocess.run([str(PYTHON), "-c", FIRST_CALLS], cwd=ROOT, capture_output=True)


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold a lock on a file until the block ends, or until this process does; wait for others and say so."""
    try:
        file = open(path, "a+b")
    except OSError as error:
        sys.exit(f"cannot set up: {error}")
    with file:
        if not lock(file, wait=False):
            print(f"waiting for another process that is setting up .venv (it holds {path.name})", flush=True)
            lock(file, wait=True)
        yield


def lock(file: IO[bytes], wait: bool) -> bool:
    """Lock an open file; False if another process holds it and `wait` is False. Closing the file unlocks it."""
    if sys.platform == "win32":
        import msvcrt

        while True:
            try:
                file.seek(0)
                msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
                return True
            except OSError:
                if not wait:
                    return False
                time.sleep(1)
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        return True
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks: set up as if alone
        return True


def install(command: list[str]) -> None:
    """Run pip; on failure say what to look at."""
    if subprocess.run(command).returncode:
        sys.exit(
            "the installation failed; pip's message above says which package. It needs a package index "
            f"within reach and a Python for which wheels exist (this one is {sys.version.split()[0]}; 3.11 is tested)."
        )


def main(arguments: list[str]) -> int:
    """Run one task; returns the exit status."""
    if sys.version_info < (3, 11):  # noqa: UP036 - an older Python has to be told so
        sys.exit(f"Python 3.11 or newer is needed, this is {sys.version.split()[0]}")
    if not arguments or arguments[0] in ("-h", "--help"):
        print(__doc__)
        return 0
    task, *rest = arguments
    if task not in TASKS:
        sys.exit(f"there is no task {task!r}; choose one of {', '.join(TASKS)}")
    if task == "verify":  # nothing but Python is to be trusted there, and nothing has to be installed
        return subprocess.run([sys.executable, *TASKS[task], *rest]).returncode
    set_up()
    return subprocess.run([str(PYTHON), *TASKS[task], *rest], cwd=ROOT).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
