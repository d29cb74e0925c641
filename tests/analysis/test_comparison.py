"""What may settle that R_1(F) stays within half-planes: bounds and exact arithmetic, not the word of a solver."""

from dataclasses import replace

import numpy as np
import pytest
from loops import affine_loop, random_network

import mireach as mr
from mireach import Exact, Polytope, box_directions
from mireach.analysis.comparison import compare
from mireach.engines.base import COUNTED, EXACT, SOLVER, Support


def answering(monkeypatch, bound, value, resolution=0.0, rests_on=COUNTED):
    """Let every engine but the exact one answer with the same numbers along every row, without a witness."""

    def support(loop, F, V, engine, **options):
        if isinstance(engine, Exact):
            return mr.support(loop, F, V, engine=engine)
        k = len(V)
        found = Support(np.full(k, value), np.full(k, bound), (None,) * k, rests_on=rests_on)
        return replace(found, resolution=np.full(k, resolution))

    monkeypatch.setattr("mireach.analysis.comparison.support", support)


def asked(a, n, engine):
    """x+ = a x from the box |x| <= 1, compared with that box."""
    F, V = Polytope.box(-np.ones(n), np.ones(n)), box_directions(n)
    return compare(affine_loop(a * np.eye(n), limits=4.0), F, V, np.ones(2 * n), engine)


@pytest.mark.parametrize(("a", "holds"), [(0.5, True), (1.0, True), (1.5, False), (1 + 2.0**-52, False)])
@pytest.mark.parametrize("bound", [0.5, 1.5])
@pytest.mark.parametrize("n", [2, 3])
def test_a_solver_is_not_believed_where_cells_are_few(monkeypatch, n, bound, a, holds):
    answering(monkeypatch, bound, 0.25, rests_on=SOLVER)
    found = asked(a, n, "milp")
    assert (found.holds == holds).all()
    assert found.settled == EXACT or not holds


@pytest.fixture
def too_many_cells(monkeypatch):
    """Exact arithmetic is too much for every loop."""
    monkeypatch.setattr("mireach.analysis.comparison.FEW_CELLS", 0)


@pytest.mark.parametrize("rests_on", [COUNTED, SOLVER])
@pytest.mark.parametrize(("bound", "holds"), [(1.0, True), (1 + 1e-7, True), (1 + 9e-7, True), (1 + 2e-6, False)])
def test_with_too_many_cells_a_bound_holds_to_within_the_resolution_of_the_milp_and_no_further(
    monkeypatch, too_many_cells, bound, holds, rests_on
):
    answering(monkeypatch, bound, 0.25, resolution=1e-6, rests_on=rests_on)
    found = asked(0.5, 3, "milp")
    assert (found.holds == holds).all()
    assert ("to within 1e-06" in found.settled) == (bound > 1 or rests_on == SOLVER) and rests_on in found.settled


@pytest.mark.parametrize(("a", "holds"), [(1.0, True), (1 + 2.0**-52, False)])
def test_a_doubt_in_three_states_is_settled_without_rounding(monkeypatch, a, holds):
    answering(monkeypatch, 1 + 1e-7, 1.0, resolution=1e-6)
    found = asked(a, 3, "milp")
    assert (found.holds == holds).all() and found.settled == EXACT
    assert (found.bound == a).all()


def test_a_time_limit_is_not_passed_by_exact_arithmetic(monkeypatch):
    def stopped(loop, F, V, engine, **options):
        assert not isinstance(engine, Exact)
        k = len(V)
        raise mr.SolverStopped("late", Support(np.full(k, -np.inf), np.full(k, np.inf), (None,) * k))

    monkeypatch.setattr("mireach.analysis.comparison.support", stopped)
    assert not asked(0.5, 3, "milp").holds.any()


def test_many_cells_are_noticed_before_they_are_built():
    rng = np.random.default_rng(0)
    network = random_network(rng, 4, 1, layers=2, width=24)
    loop = mr.ClosedLoop(affine_loop(0.5 * np.eye(4), limits=4.0).system, network.saturate([-1.0], [1.0]))
    F = Polytope.box(-np.ones(4), np.ones(4))
    with pytest.raises(mr.CellLimitError, match=r'more than 1000 cells.*4 states.*"milp"'):
        mr.support(loop, F, box_directions(4), engine=Exact(most_cells=1000))


@pytest.mark.parametrize("tol", [0.0, 1e-3])
def test_an_attained_value_settles_nothing(monkeypatch, tol):
    answering(monkeypatch, 1.5, 0.5, resolution=1e-6)
    F, V = Polytope.box([-1] * 3, [1] * 3), box_directions(3)
    assert not compare(affine_loop(0.5 * np.eye(3)), F, V, np.ones(6), "milp", tol).holds.any()
