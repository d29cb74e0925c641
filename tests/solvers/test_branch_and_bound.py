"""Branch and bound against scipy, with solvers that say what is wrong."""

import highspy
import numpy as np
import pytest
from scipy.optimize import Bounds, LinearConstraint, milp

from mireach.errors import SolverError
from mireach.solvers.branch_and_bound import BRANCHED, IntegerOptimum
from mireach.solvers.linear_program import DUAL, LinearProgram, Optimum


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
    monkeypatch.setattr(lp, "_claim", lambda *asked: claim(None if wrong is None else best + wrong))
    found = lp.maximize_integer(x, c)
    assert found.finished and found.proven and best - 1e-9 <= found.bound <= best + max(wrong or 0, 0) + 1e-8


@pytest.mark.parametrize(("scale", "proven"), [(1.0, False), (1e-5, True)])
def test_answer_of_the_milp_solver_after_many_nodes_is_marked_and_needs_rows_of_one_scale(monkeypatch, scale, proven):
    lp, x, c, best = many_binaries(0)
    lp.add_row(x[:2], [1, scale], upper=1.5)
    monkeypatch.setattr("mireach.solvers.branch_and_bound.PROOF_NODES", 1)
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
