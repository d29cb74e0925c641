"""The warm-started linear program against scipy."""

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import highspy
import numpy as np
import pytest
from loops import largest

from mireach import Polytope
from mireach.errors import SolverError
from mireach.solvers.linear_program import LinearProgram


@pytest.mark.parametrize("seed", range(5))
def test_one_objective_after_another_gives_what_fresh_programs_give(seed):
    rng = np.random.default_rng(seed)
    A, b = rng.normal(size=(12, 4)), rng.uniform(0, 2, 12)
    lp = LinearProgram()
    x = lp.add_columns(-np.ones(4), [1, 2, 3, 4])
    lp.add_rows(x, A, upper=b)
    H, h = np.vstack([A, np.eye(4), -np.eye(4)]), np.concatenate([b, [1, 2, 3, 4], np.ones(4)])
    for c in rng.normal(size=(10, 4)):
        best = lp.maximize(x, c)
        assert best.value == pytest.approx(largest(c, H, h), abs=1e-8)
        assert c @ best.point == pytest.approx(best.value) and (H @ best.point <= h + 1e-8).all()


def test_infeasible_and_unbounded_are_told_apart_and_do_not_stick():
    lp = LinearProgram()
    x = lp.add_columns([-np.inf, 0.0], [np.inf, 1.0])
    assert lp.maximize(x, [1, 0]).value == np.inf and lp.maximize(x, [1, 0]).point is None
    assert lp.maximize(x, [0, 1]).value == 1
    lp.set_bounds(x[0], 2, 3)
    assert lp.maximize(x, [1, 1]).value == 4 and lp.maximize(x, [-1, 0]).value == -2
    lp.add_row(x, [1, 0], lower=5)
    assert lp.maximize(x, [1, 1]).value == -np.inf


def test_objective_of_the_last_question_is_forgotten():
    lp = LinearProgram()
    x = lp.add_columns([0, 0], [1, 1])
    lp.maximize(x, [5, 5])
    assert lp.maximize(x[:1], [1]).value == 1


def test_solver_without_an_answer_is_an_error_and_not_a_number():
    lp = LinearProgram()
    x = lp.add_columns(np.zeros(3), np.ones(3))
    lp.add_row(x, [1, 1, 1], upper=1.5)
    lp.highs.setOptionValue("simplex_iteration_limit", 0)
    lp.highs.setOptionValue("solver", "simplex")
    with pytest.raises(SolverError, match="HiGHS ended"):
        lp.maximize(x, [1, 2, 3])
    assert highspy.HighsModelStatus.kIterationLimit == lp.highs.getModelStatus()


def test_threads_may_ask_the_same_program():
    rng = np.random.default_rng(0)
    lp = LinearProgram()
    x = lp.add_columns(-np.ones(6), np.ones(6))
    lp.add_rows(x, rng.normal(size=(40, 6)), upper=rng.uniform(0, 2, 40))
    V = rng.normal(size=(200, 6))
    alone = [lp.maximize(x, v).value for v in V]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda v: lp.maximize(x, v).value, V))
    np.testing.assert_allclose(together, alone, atol=1e-9)


def test_a_set_that_is_empty_by_a_hair_keeps_a_bound():
    """x <= y <= x - 1e-11: HiGHS calls it empty or not, as its tolerances have it; either way the bound is right."""
    for gap in (1e-8, 1e-11, 1e-14, 0.0, -1e-14):
        lp = LinearProgram()
        x = lp.add_columns([0, 0], [1, 1])
        lp.add_row(x, [1, -1], upper=0)
        lp.add_row(x, [-1, 1], upper=-gap)
        bound = lp.bound(x, [1, 1])
        assert bound >= 2 if gap <= 0 else bound == -np.inf or bound <= 2 + 1e-6


@pytest.mark.parametrize("scale", [2.0**-40, 1e-6, 1.0, 1e6, 1e12])
def test_rows_of_any_length_give_the_same_answers(scale):
    rng = np.random.default_rng(0)
    for n in (2, 3):
        A, b, V = rng.normal(size=(9, n)), rng.uniform(0.5, 2, 9), rng.normal(size=(5, n)) * scale
        one, other = LinearProgram(), LinearProgram()
        for lp, factor in ((one, 1.0), (other, scale)):
            lp.add_rows(lp.add_columns(-2 * np.ones(n), 2 * np.ones(n)), factor * A, upper=factor * b)
        for v in V:
            value = one.maximize(range(n), v).value
            assert other.maximize(range(n), v).value == pytest.approx(value, rel=1e-9)
            assert other.bound(range(n), v) == pytest.approx(value, rel=1e-9)


def test_small_coefficients_count():
    lp = LinearProgram()
    x = lp.add_columns([0, 0], [10, 10])
    lp.add_row(x, [1e-9, 0], lower=2e-9)  # x1 >= 2
    lp.add_row(x, [1, 5e-10], upper=3)
    for ask in (lp.maximize, lp.maximize_integer):
        assert ask(x, [-1, 0]).point[0] == pytest.approx(2, abs=1e-9)
    assert lp.bound(x, [1, 0.5e-9]) == pytest.approx(3, abs=1e-12)
    assert Polytope(1e-9 * np.vstack([np.eye(3), -np.eye(3)]), 1e-9 * np.array([6, 6, 6, -5, -5, -5])).support(
        [[1, 1, 1]]
    ) == pytest.approx(18)


def test_no_point_is_lost_where_coefficients_are_too_small_for_the_solver():
    lp = LinearProgram()
    x = lp.add_columns([0, -1000], [10, 1000])
    lp.add_row(x, [1, 1e-13], lower=3, upper=3)
    assert 3 + 1e-10 <= lp.bound(x, [1, 0]) <= 3 + 2e-10
    free = lp.add_columns([-np.inf], [np.inf])
    lp.add_row([x[0], free[0]], [1, 6e-17], upper=2.5)  # holds for large values of the variable without limits
    assert lp.bound(x, [1, 0]) >= 3 + 1e-10


@pytest.mark.parametrize("size", [1e-300, 1e-310, 5e-324])
def test_rows_of_the_smallest_numbers_lose_no_point(size):
    lp = LinearProgram()
    x = lp.add_columns([0, 0], [10, 10])
    lp.add_row(x, [size, 0], upper=20 * size)  # holds everywhere
    assert lp.maximize(x, [1, 1]).value == pytest.approx(20) and lp.bound(x, [1, 1]) >= 20


SOLVE = """
import numpy as np
from mireach.solvers.linear_program import LinearProgram
rng, lp = np.random.default_rng(0), LinearProgram()
x = lp.add_columns(np.zeros(20), np.ones(20))
lp.add_rows(x, rng.integers(-4, 5, (6, 20)) / 4, upper=rng.uniform(1, 3, 6))
c = rng.normal(size=20)
assert lp.maximize(x, c).value > 0 and lp.bound(x, c) > 0
lp.binaries += x.tolist()
for presolve in (None, True, False):
    assert lp.maximize_integer(x, c, presolve=presolve).bound > 0
assert lp.copy().maximize_integer(x, c, nodes=3).bound > 0
"""


def test_the_solver_writes_nothing_to_the_terminal():
    """Nor does it to the file descriptors, which code in C++ uses."""
    done = subprocess.run([sys.executable, "-c", SOLVE], capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_a_change_that_highs_refuses_is_an_error():
    """HiGHS reports it by a status alone and goes on with the old model, which has another number of variables."""
    lp = LinearProgram()
    x = lp.add_columns([0.0], [1.0])
    for refused in (
        lambda: lp.add_columns([np.inf], [np.inf]),
        lambda: lp.set_bounds(x, np.inf, np.inf),
        lambda: lp.add_row(x, [1.0], lower=np.inf),
    ):
        with pytest.raises(SolverError, match="refuses"):
            refused()
