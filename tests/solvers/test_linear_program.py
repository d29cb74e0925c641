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
from mireach.solvers.linear_program import BRANCHED, DUAL, IntegerOptimum, LinearProgram, Optimum


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


def many_binaries(seed):
    """A program with more binaries than are branched on at once, its objective, and its optimum by scipy."""
    rng, lp, count = np.random.default_rng(seed), LinearProgram(), BRANCHED + 4
    A, c, b = rng.integers(-4, 5, (6, count)) / 4, rng.normal(size=count), rng.uniform(1, 3, 6)
    x = lp.add_columns(np.zeros(count), 1)
    lp.add_rows(x, A, upper=b)
    lp.binaries += x.tolist()
    return lp, x, c, -milp(-c, constraints=LinearConstraint(A, ub=b), bounds=Bounds(0, 1), integrality=1).fun


def claim(bound):
    """What HiGHS's MILP solver may say."""
    if bound is None:
        raise SolverError("HiGHS ended the MILP with Unknown")
    return IntegerOptimum(bound, None, True, False)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("wrong", [-np.inf, -1.0, 1.0, None], ids=str)
def test_wrong_answers_of_the_milp_solver_do_not_reach_the_bound(monkeypatch, seed, wrong):
    lp, x, c, best = many_binaries(seed)
    assert lp.maximize_integer(x, c).bound == pytest.approx(best, abs=1e-8)
    monkeypatch.setattr(lp, "_search", lambda *asked: claim(None if wrong is None else best + wrong))
    found = lp.maximize_integer(x, c)
    assert found.finished and found.proven and best - 1e-9 <= found.bound <= best + max(wrong or 0, 0) + 1e-8


@pytest.mark.parametrize(("scale", "proven"), [(1.0, False), (1e-5, True)])
def test_answer_of_the_milp_solver_after_many_nodes_is_marked_and_needs_rows_of_one_scale(monkeypatch, scale, proven):
    lp, x, c, best = many_binaries(0)
    lp.add_row(x[:2], [1, scale], upper=1.5)
    monkeypatch.setattr("mireach.solvers.linear_program.PROOF_NODES", 1)
    found = lp.maximize_integer(x, c)
    assert found.finished and found.proven == proven and found.bound >= best - 1e-6
    assert proven == (found.bound > best + 1e-6)


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
        assert (
            found.finished
            or limits["nodes" if "nodes" in limits else "time_limit"] == 0
            or (found.bound <= lp.maximize(x, c).value + 1e-8)
        )


def test_relaxation_without_end_is_no_bound():
    lp = LinearProgram()
    x = lp.add_columns([0, 0], [1, np.inf])
    lp.binaries.append(int(x[0]))
    with pytest.raises(SolverError, match="unbounded"):
        lp.maximize_integer(x, [1, 1])


def test_a_node_is_not_left_out_because_the_dual_simplex_finds_no_point(monkeypatch):
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
    assert found.finished and found.bound >= lp.maximize(x, c).value and found.point is None


@pytest.mark.parametrize("seed", range(8))
def test_a_program_is_not_empty_because_the_solver_says_so(monkeypatch, seed):
    """Every simplex run claims that there is no point, with a ray that proves nothing: all bounds still hold."""
    lp, x, c, best = random_binaries(seed)
    relaxed = lp.maximize(x, c).value
    monkeypatch.setattr(LinearProgram, "_relaxation", lambda lp: Optimum(-np.inf, None))
    monkeypatch.setattr(highspy.Highs, "getDualRay", lambda highs: (None, True, np.ones(12)))
    assert lp.bound(x, c) >= relaxed - 1e-9 or relaxed == -np.inf
    assert lp.maximize_integer(x, c).bound >= best - 1e-8


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
    scale = np.array([entry[3] for entry in lp._entries]) / b  # rows are kept multiplied by powers of two
    found = lp._rows().bound(c, y / scale, np.array(low, float), np.array(high, float))
    assert 0 <= Fraction(found) - exact <= 1e-12 * (np.abs(y).sum() + np.abs(c).sum())
    assert np.isinf(best) or found >= lp.maximize(np.arange(5), c).value - 1e-8 * (1 + np.abs(c).sum())


@pytest.mark.parametrize("seed", range(10))
def test_bound_holds_whatever_value_the_solver_claims(seed, monkeypatch):
    lp, x, _, _, c, best = random_program(seed)
    solve = LinearProgram._relaxation
    monkeypatch.setattr(LinearProgram, "_relaxation", lambda lp: Optimum(solve(lp).value - 0.5, solve(lp).point))
    assert lp.maximize(x, c).value == pytest.approx(best - 0.5) or best == -np.inf
    assert lp.bound(x, c) == pytest.approx(best, abs=1e-9)


@pytest.mark.parametrize("seed", range(10))
def test_without_limits_on_variables_the_rows_prove_them(seed):
    rng, n = np.random.default_rng(seed), 2 + seed % 3
    A, b = np.vstack([np.eye(n), -np.eye(n), rng.normal(size=(4, n))]), rng.uniform(0.1, 2, 2 * n + 4)
    turn = np.linalg.qr(rng.normal(size=(n, n)))[0] * 10.0 ** rng.integers(-6, 7)
    lp, A = LinearProgram(), A @ turn
    x = lp.add_columns(np.full(n, -np.inf), np.full(n, np.inf))
    lp.add_rows(x, A, upper=b)
    for v in rng.normal(size=(5, n)):
        best = Fraction(int((top := Polytope(A, b).exact_maximum(v).value).p), int(top.q))
        assert best <= Fraction(lp.bound(x, v)) <= best + Fraction(1, 10**9) * (1 + abs(best))
    low, high = lp.limits()
    assert np.isfinite(low).all() and np.isfinite(high).all() and (low < high).all()


def test_nothing_is_proven_of_variables_that_the_rows_do_not_bound():
    lp = LinearProgram()
    x = lp.add_columns([-np.inf, -np.inf], [np.inf, np.inf])
    lp.add_rows(x, [[1, 0.1], [0.3, 1]], upper=[1, 1])
    assert lp.bound(x, [1, -1]) == np.inf and lp.maximize(x, [1, -1]).value == np.inf


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
