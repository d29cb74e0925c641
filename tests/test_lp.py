"""The warm-started linear program against scipy."""

from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction

import highspy
import numpy as np
import pytest
from loops import largest
from scipy.optimize import Bounds, LinearConstraint, milp

from mireach import Polytope
from mireach.errors import SolverError
from mireach.lp import BRANCHED, DUAL, IntegerOptimum, LinearProgram, Optimum


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


@pytest.mark.parametrize("without", ["infeasible", "unclear"])
def test_no_point_has_to_be_found_in_both_ways(monkeypatch, without):
    lp = LinearProgram()
    x = lp.add_columns(np.zeros(BRANCHED + 1), 1)
    lp.binaries += x.tolist()
    nothing = (IntegerOptimum(-np.inf, None, True), highspy.HighsModelStatus.kInfeasible)
    unclear = (None, highspy.HighsModelStatus.kUnknown)
    answers = {True: nothing, False: nothing if without == "infeasible" else unclear}
    monkeypatch.setattr(lp, "_search", lambda presolve, time_limit: answers[presolve])
    if without == "infeasible":
        assert lp.maximize_integer(x, np.ones(len(x))).bound == -np.inf
    else:
        with pytest.raises(SolverError, match="HiGHS ended the MILP with Unknown"):
            lp.maximize_integer(x, np.ones(len(x)))
    found = (IntegerOptimum(1.5, None, True), highspy.HighsModelStatus.kOptimal)
    answers[False] = found
    assert lp.maximize_integer(x, np.ones(len(x))).bound == 1.5  # the larger bound counts


def random_binaries(seed):
    """A program with some binaries, its objective, and its optimum by scipy (-inf if there is no point)."""
    rng, lp = np.random.default_rng(seed), LinearProgram()
    count = int(rng.integers(0, 9))
    low, high = np.append(np.zeros(count), -np.ones(4)), np.ones(count + 4)
    x, A, c = lp.add_columns(low, high), rng.normal(size=(12, count + 4)), rng.normal(size=count + 4)
    b = rng.uniform(-0.5, 1.5, 12)
    lp.add_rows(x, A, upper=b)
    lp.binaries += x[:count].tolist()
    best = milp(
        -c, constraints=LinearConstraint(A, ub=b), bounds=Bounds(low, high), integrality=np.arange(count + 4) < count
    )
    return lp, x, c, -best.fun if best.success else -np.inf


@pytest.mark.parametrize("seed", range(40))
def test_branching_agrees_with_scipy(seed):
    lp, x, c, best = random_binaries(seed)
    for _ in range(2):
        found = lp.maximize_integer(x, c)
        assert found.finished and found.bound == pytest.approx(best, abs=1e-8)
        assert lp.maximize(x, c).value >= found.bound - 1e-9  # the binaries are free again
    if best == -np.inf:
        assert found.point is None
        return
    assert c @ found.point == pytest.approx(best, abs=1e-8)
    assert set(found.point[lp.binaries].round(8)) <= {0, 1}
    for enough in (best - 0.1, best + 0.1):
        stopped = lp.maximize_integer(x, c, enough=enough)
        assert stopped.finished and best - 1e-8 <= stopped.bound <= max(best, enough) + 1e-8
        assert (stopped.point is None) == (enough > best)


@pytest.mark.parametrize("limits", [{"nodes": 0}, {"nodes": 1}, {"nodes": 3}, {"time_limit": 0.0}], ids=str)
def test_branching_that_is_stopped_still_bounds(limits):
    for seed in range(10):
        lp, x, c, best = random_binaries(seed)
        found = lp.maximize_integer(x, c, **limits)
        assert found.bound >= best - 1e-8
        assert found.finished or found.bound == np.inf or found.bound <= lp.maximize(x, c).value + 1e-8


def test_relaxation_without_end_is_no_bound():
    lp = LinearProgram()
    x = lp.add_columns([0, 0], [1, np.inf])
    lp.binaries.append(int(x[0]))
    with pytest.raises(SolverError, match="unbounded"):
        lp.maximize_integer(x, [1, 1])


def test_a_node_is_left_out_only_if_both_simplex_methods_find_no_point(monkeypatch):
    lp, x, c, best = random_binaries(0)
    solve, wrong = LinearProgram._relaxation, []

    def dual_finds_nothing(lp):
        found = solve(lp)
        _, strategy = lp.highs.getOptionValue("simplex_strategy")
        wrong.append(strategy == DUAL)
        return Optimum(-np.inf, None) if wrong[-1] else found

    monkeypatch.setattr(LinearProgram, "_relaxation", dual_finds_nothing)
    assert best > -np.inf and lp.maximize_integer(x, c).bound == pytest.approx(best, abs=1e-8)
    assert any(wrong) and lp.highs.getOptionValue("simplex_strategy")[1] == DUAL


def test_branching_ends_where_nothing_more_is_asked():
    lp, x, c, _ = random_binaries(0)
    found = lp.maximize_integer(x, c, enough=np.inf, gap=0.0)
    assert found.finished and found.bound == np.inf and found.point is None


def random_program(seed):
    """A program with limits on all variables, its rows A x <= b, its objective, and its optimum by scipy."""
    rng, lp = np.random.default_rng(seed), LinearProgram()
    A, b, c = rng.normal(size=(9, 5)), rng.uniform(-1, 2, 9), rng.normal(size=5)
    x = lp.add_columns(-np.ones(5), [1, 2, 3, 4, 5])
    lp.add_rows(x, A, upper=b)
    best = largest(c, np.vstack([A, np.eye(5), -np.eye(5)]), np.concatenate([b, [1, 2, 3, 4, 5], np.ones(5)]))
    return lp, x, A, b, c, best


@pytest.mark.parametrize("seed", range(30))
def test_bound_is_proven_and_close(seed):
    lp, x, _, _, c, best = random_program(seed)
    bound = lp.bound(x, c)
    assert bound == -np.inf if best == -np.inf else best - 1e-12 <= bound <= best + 1e-9


@pytest.mark.parametrize("seed", range(30))
def test_any_multipliers_give_a_bound_in_exact_arithmetic(seed):
    lp, _, A, b, c, best = random_program(seed)
    rng, low, high = np.random.default_rng(seed), [-1] * 5, [1, 2, 3, 4, 5]
    y = rng.normal(size=9) * 10.0 ** rng.integers(-3, 8, 9)
    c = c * 10.0 ** rng.integers(-3, 8)
    exact = sum(Fraction(float(w)) * Fraction(float(limit)) for w, limit in zip(y, b) if w > 0)
    for j in range(5):
        reduced = Fraction(float(c[j])) - sum(
            Fraction(float(w)) * Fraction(float(a)) for w, a in zip(y, A[:, j]) if w > 0
        )
        exact += max(reduced * low[j], reduced * high[j])
    found = lp._rows().bound(c, y, np.array(low, float), np.array(high, float))
    assert 0 <= Fraction(found) - exact <= 1e-12 * (np.abs(y).sum() + np.abs(c).sum())
    assert np.isinf(best) or found >= lp.maximize(np.arange(5), c).value - 1e-8 * (1 + np.abs(c).sum())


@pytest.mark.parametrize("seed", range(10))
def test_bound_holds_whatever_value_the_solver_claims(seed, monkeypatch):
    lp, x, _, _, c, best = random_program(seed)
    solve = LinearProgram._relaxation
    monkeypatch.setattr(LinearProgram, "_relaxation", lambda lp: Optimum(solve(lp).value - 0.5, solve(lp).point))
    assert lp.maximize(x, c).value == pytest.approx(best - 0.5) or best == -np.inf
    assert lp.bound(x, c) == pytest.approx(best, abs=1e-9)


def test_without_limits_on_variables_both_simplex_methods_are_believed():
    lp = LinearProgram()
    x = lp.add_columns([-np.inf, -np.inf], [np.inf, np.inf])
    lp.add_rows(x, [[1, 0.1], [0.3, 1]], upper=[1, 1])
    assert lp.bound(x, [1, 1]) == pytest.approx(lp.maximize(x, [1, 1]).value, abs=1e-9)
    assert lp.bound(x, [1, -1]) == np.inf
    lp.add_row(x, [-1, -0.1], upper=-2)
    assert lp.bound(x, [1, 1]) == -np.inf


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
    lp.add_row([x[0], free[0]], [1, 6e-17], upper=2.5)  # as the noise of a rotated row
    assert lp.bound(x, [1, 0]) == -np.inf


@pytest.mark.parametrize("size", [1e-300, 1e-310, 5e-324])
def test_rows_of_the_smallest_numbers_lose_no_point(size):
    lp = LinearProgram()
    x = lp.add_columns([0, 0], [10, 10])
    lp.add_row(x, [size, 0], upper=20 * size)  # holds everywhere
    assert lp.maximize(x, [1, 1]).value == pytest.approx(20) and lp.bound(x, [1, 1]) >= 20
