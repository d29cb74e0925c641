"""The exact engine: against brute force and fractions of the standard library, for two states and more."""

from copy import copy
from fractions import Fraction
from operator import mul

import numpy as np
import pytest
from loops import affine_loop, brute_support, exact_highest, exact_input, exactly_inside, random_loop

import mireach as mr
from mireach.arithmetic.rational import fractions
from mireach.engines import exact
from mireach.engines.cells import Cells

SHRUNK = 0.7  # F of the random questions, as a share of X


def square(r):
    return mr.Polytope.box([-r, -r], [r, r])


@pytest.mark.parametrize("with_input", [False, True])
@pytest.mark.parametrize("seed", range(6))
def test_support_agrees_with_brute_force_and_lies_below_the_bound_of_the_float_cells(seed, with_input):
    loop = random_loop(seed, with_input=with_input)
    F, V = loop.system.state_set.scale(SHRUNK), mr.directions(7)
    found = mr.support(loop, F, V, engine="exact")
    np.testing.assert_allclose(found.value, brute_support(loop, F, V), atol=1e-7)
    assert (found.bound >= found.value).all() and (found.bound <= np.nextafter(found.value, np.inf)).all()
    assert (Cells().support(loop, F, V).bound >= found.bound).all()


def test_the_safe_set_of_case_1_is_the_one_of_the_float_cells():
    case = mr.case_study("pwa")
    here, there = (mr.safe_set(case.loop, case.safe_directions, engine=engine) for engine in ("exact", "cells"))
    assert here.verdict == there.verdict == "proven" and here.iterations == there.iterations
    np.testing.assert_allclose(here.set.h, there.set.h, atol=1e-9)


def test_one_step_only():
    with pytest.raises(ValueError, match="takes one step; got steps = 2"):
        mr.support(affine_loop(0.5 * np.eye(2)), square(1), mr.directions(4), steps=2, engine="exact")
    empty = mr.Polytope([[1.0, 0], [-1, 0]], [-5, -5])
    assert mr.support(affine_loop(0.5 * np.eye(2)), empty, mr.directions(4), engine="exact").bound.max() == -np.inf


# -- any number of states -----------------------------------------------------------------------------


def assert_highest(loop, F, V):
    """The steps attain the largest value that any mode and choice of channels has, in fractions."""
    assert_attained(loop, F, V, exact_highest(loop, F, V))


def assert_attained(loop, F, V, expected):
    """There are steps from F, in fractions, that attain the expected values."""
    found = exact.support_steps(loop, F, V)
    for k, truth in enumerate(expected):
        assert (found is None) == (truth is None)
        if found is not None:
            step = found[k]
            (value,), x, d = fractions([step.value]), fractions(step.state), fractions(step.disturbance)
            mode, after = loop.system.modes[step.mode], step.escape(loop).after
            assert value == truth == sum(Fraction(a) * y for a, y in zip(V[k].tolist(), after))
            assert exactly_inside(F, x) and exactly_inside(loop.system.state_set, x)
            assert exactly_inside(mode.region, [*x, *exact_input(loop.network, x)])
            assert exactly_inside(mode.disturbance, d)
            assert all(sum(map(mul, fractions(a), x)) <= fractions([b])[0] for a, b in zip(*step.piece))


@pytest.mark.parametrize(
    ("seed", "n", "m", "with_input"), [(0, 3, 1, False), (1, 3, 2, True), (2, 4, 1, True), (3, 4, 2, False)]
)
def test_support_of_random_loops_is_the_largest_of_all_exact_maxima(seed, n, m, with_input):
    rng = np.random.default_rng(seed)
    loop = random_loop(seed, n=n, m=m, cuts=2, with_input=with_input, layers=2)
    X, x = loop.system.state_set, loop.system.state_set.sample(rng, 2)
    flat = np.arange(n) == 0
    sets = [X, X.scale(0.5), mr.Polytope.box(x[0], x[0])]
    sets.append(mr.Polytope.box(np.where(flat, x[0], x.min(axis=0)), np.where(flat, x[0], x.max(axis=0))))
    for F in sets:
        assert_highest(loop, F, rng.normal(size=(1, n)))


@pytest.mark.parametrize("n", [3, 4])
def test_of_a_flat_set_in_a_boundary_of_regions_both_modes_count(n):
    loop = random_loop(11, n=n, cuts=1)
    a, b = loop.system.modes[0].region.H[1, :n], loop.system.modes[0].region.h[1]
    F = loop.system.state_set & mr.Polytope([a, -a], [b, -b])
    V = np.random.default_rng(n).normal(size=(3, n))
    alone = [[step.value for step in exact.support_steps(without(loop, mode), F, V)] for mode in (0, 1)]
    assert_attained(loop, F, V, fractions(map(max, *alone)))
    np.testing.assert_allclose(mr.support(loop, F, V, engine="exact").value, brute_support(loop, F, V), atol=1e-7)


def without(loop, mode):
    """The loop without one of its modes."""
    system = copy(loop.system)
    object.__setattr__(system, "modes", tuple(one for i, one in enumerate(loop.system.modes) if i != mode))
    return mr.ClosedLoop(system, loop.network)


def test_a_state_set_that_is_flat_is_one():
    """X is a square in R^3; x+ = (max(x1, -x1), x2, 0) on it."""
    net = mr.MaxoutNetwork([mr.Layer([[1.0, 0, 0], [-1.0, 0, 0]], np.zeros(2), 2)], [[1.0]], [0.0])
    A, B = np.diag([0.0, 1, 0]), [[1.0], [0], [0]]
    mode = mr.Mode(A, B, np.zeros(3), mr.Polytope(np.eye(4)[:1], [9.0]))
    X, U = mr.Polytope.box([-2, -1, 0], [1, 1, 0]), mr.Polytope.box([-3], [3])
    loop = mr.ClosedLoop(mr.PWASystem([mode], X, U), net)
    found = mr.support(loop, X, np.vstack([np.eye(3), -np.eye(3)]), engine="exact")
    assert found.bound.tolist() == [2, 1, 0, 0, 1, 0]


@pytest.mark.parametrize("name", ["three_tanks", "four_tanks"])
def test_the_bound_of_the_milp_lies_above_the_exact_one_by_its_resolution_at_most(name):
    case = mr.case_study(name)
    F, V = case.system.state_set.scale(0.6), case.directions[:3]
    exactly, milp = (mr.support(case.loop, F, V, engine=engine) for engine in ("exact", "milp"))
    assert (exactly.bound <= milp.bound).all() and (milp.bound <= exactly.bound + milp.resolution).all()
    assert (exactly.value >= milp.value - 1e-9).all() and exactly.rests_on == "exact arithmetic"
    assert_attained(case.loop, F, V, fractions(step.value for step in exact.support_steps(case.loop, F, V)))


@pytest.mark.parametrize("n", [2, 3, 4])
def test_growth_is_the_same_in_every_dimension(n):
    C, centre = mr.box_directions(n), np.full(n, 0.25)
    assert exact.growth(C, np.full(2 * n, 1.0), np.full(2 * n, 0.5), centre) == Fraction(5, 3)
    assert exact.growth(C, np.full(2 * n, 1.0), np.full(2 * n, 0.5), np.full(n, 0.5)) is None


def test_too_many_cells_are_an_error_that_says_what_to_do():
    case = mr.case_study("three_tanks")
    with pytest.raises(mr.CellLimitError, match=r'has more than 200 .* 3 states; use engine="milp"'):
        mr.support(case.loop, case.system.state_set, case.directions, engine=mr.Exact(most_cells=100.0))
    with pytest.raises(ValueError, match="most_cells"):
        mr.Exact(most_cells=0)
