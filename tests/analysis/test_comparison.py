"""What may settle that R_1(F) stays within half-planes: bounds and exact arithmetic, not the word of a solver."""

from dataclasses import replace

import numpy as np
import pytest
from loops import affine_loop

import mireach as mr
from mireach import Exact, Polytope, box_directions
from mireach.analysis.comparison import compare
from mireach.engines.base import COUNTED, EXACT, SOLVER, Support


def answering(monkeypatch, bound, value, resolution=0.0, rests_on=COUNTED):
    """Let every engine but the exact one answer with the same numbers along every row, without a witness."""

    def support(loop, F, V, engine, **options):
        if engine == Exact():
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
def test_in_the_plane_a_solver_is_not_believed(monkeypatch, bound, a, holds):
    answering(monkeypatch, bound, 0.25, rests_on=SOLVER)
    found = asked(a, 2, "milp")
    assert (found.holds == holds).all()
    assert found.settled == EXACT or not holds


@pytest.mark.parametrize(("bound", "holds"), [(1.0, True), (1 + 1e-7, True), (1 + 9e-7, True), (1 + 2e-6, False)])
def test_a_bound_holds_to_within_the_resolution_of_the_milp_and_no_further(monkeypatch, bound, holds):
    answering(monkeypatch, bound, 0.25, resolution=1e-6)
    assert (asked(0.5, 3, "milp").holds == holds).all()


@pytest.mark.parametrize("tol", [0.0, 1e-3])
def test_an_attained_value_settles_nothing(monkeypatch, tol):
    answering(monkeypatch, 1.5, 0.5, resolution=1e-6)
    F, V = Polytope.box([-1] * 3, [1] * 3), box_directions(3)
    assert not compare(affine_loop(0.5 * np.eye(3)), F, V, np.ones(6), "milp", tol).holds.any()
