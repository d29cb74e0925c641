"""The kernels with numba and without."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from mireach.sets.compilation import Kernel

ROOT = Path(__file__).resolve().parents[2]
PLUGIN = str(ROOT / "tests")  # where without_numba.py is
SELECTED = "kernels or (cells and (both_values or with_the_right_piece or ties or flat or is_a_point or large_numbers))"
OVERFLOW = """
import numpy as np
from mireach.sets.kernels import dual_bounds, polygon
box = np.vstack([np.eye(2), -np.eye(2)])
_, corners, *found = polygon(box, np.array([1.5e308, 1e308, 1e308, 1e308]), 1e-12, 1e-11)
print(corners.max(), dual_bounds(np.array([[2.0, 0]]), *found)[0])
"""
SETS = """
import mireach as mr
import numpy as np
for seed in range(20):
    rng = np.random.default_rng(seed)
    P = mr.Polytope(rng.normal(size=(7, 2)), rng.uniform(0.1, 2, 7)) & mr.Polytope.box([-2, -2], [2, 2])
    print(*P.vertices().ravel().tolist(), *P.bound(rng.normal(size=(3, 2))).tolist())
"""


def run(script, **environment):
    """What a script prints; warnings are errors."""
    command = [sys.executable, "-W", "error", "-c", script]
    done = subprocess.run(command, env={**os.environ, **environment}, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert not done.stderr
    return done.stdout.split()


def test_kernels_and_cells_work_without_numba():
    command = [sys.executable, "-W", "error::RuntimeWarning", "-m", "pytest", "-q", "-p", "no:cacheprovider"]
    command += ["-p", "without_numba", "-p", "no:xdist", "tests/sets/test_kernels.py", "tests/engines/test_cells.py"]
    path = os.pathsep.join([PLUGIN, os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "PYTHONPATH": path}
    done = subprocess.run([*command, "-k", SELECTED], cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
    assert "passed" in done.stdout


def test_both_give_the_same_numbers():
    compiled, plain = (run(SETS, NUMBA_DISABLE_JIT=switch) for switch in "01")
    np.testing.assert_allclose(np.array(compiled, float), np.array(plain, float), rtol=1e-12)


@pytest.mark.parametrize("switch", "01")
def test_what_overflows_is_infinite_in_both(switch):
    assert run(OVERFLOW, NUMBA_DISABLE_JIT=switch) == ["1.5e+308", "inf"]


def test_numba_is_imported_when_a_kernel_is_called():
    script = "import sys, mireach as mr; P = mr.Polytope.box([0, 0], [1, 1]); {}; print('numba' in sys.modules)"
    assert run(script.format("P.H")) == ["False"]
    assert run(script.format("P.vertices()")) == ["True"]


def test_a_numba_that_cannot_be_imported_is_named(tmp_path):
    (tmp_path / "numba.py").write_text("raise ImportError('Numba needs NumPy 1.0')")
    script = """
import warnings, mireach as mr
with warnings.catch_warnings(record=True) as told:
    warnings.simplefilter("always")
    mr.Polytope.box([0, 0], [1, 1]).vertices()
print(*(str(one.message) for one in told))
"""
    path = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    said = " ".join(run(script, PYTHONPATH=path))
    assert said.count("numba") == 1 and "Numba needs NumPy 1.0" in said


def test_a_kernel_keeps_its_name_and_docstring():
    @Kernel
    def double(x):
        """Twice x."""
        return 2 * x

    assert double.__name__ == "double" and double.__doc__ == "Twice x."
    assert double(2.0) == 4.0
