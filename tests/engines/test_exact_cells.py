"""Exact cells: they cover the state set, and their maps are the steps that fractions give."""

from fractions import Fraction

import numpy as np
import pytest
from loops import exact_input, exactly_inside, random_loop

import mireach as mr
from mireach.arithmetic.rational import binary, dot
from mireach.engines import exact_cells, steps


def as_fraction(value):
    return Fraction(int(value.p), int(value.q))


def square(r):
    return mr.Polytope.box([-r, -r], [r, r])


@pytest.mark.parametrize(("seed", "n"), [(0, 2), (1, 2), (2, 2), (3, 2), (0, 3), (1, 3)])
def test_cells_hold_every_state_with_the_step_that_fractions_give(seed, n):
    loop, rng = random_loop(seed, n=n, with_input=seed % 2 == 1, saturated=True), np.random.default_rng(seed)
    X, found = loop.system.state_set, exact_cells.cells(loop)
    for x in X.scale(0.9).sample(rng, 30).tolist():
        point, u = [Fraction(value) for value in x], exact_input(loop.network, x)
        for number, mode in enumerate(loop.system.modes):
            inside = exactly_inside(mode.region, [*point, *u])
            holding = [cell for cell in found if cell.mode == number and holds(cell, binary(x))]
            assert bool(holding) == inside
            for cell in holding:
                after = steps.successor(loop, point, number, [0] * n)
                assert tuple(as_fraction(value) for value in cell.image(binary(x))) == after


def holds(cell, x):
    """Whether a rational point is in a cell."""
    return all(dot(a, x) <= b for a, b in cell.part.half_spaces)


@pytest.mark.parametrize("rows", [(1, 1, -1), (1, -1, 1), (-1, 1, 1), (1, 1, 1), (1, -1, -1)])
def test_of_channels_that_tie_on_all_of_a_piece_one_has_it(rows):
    """Phi(x) = max(r x1 for r in rows), x1+ = Phi(x): the cells cover X once, and every side of x1 = 0 counts."""
    net = mr.MaxoutNetwork([mr.Layer([[r, 0.0] for r in rows], np.zeros(3), 3)], [[1.0]], [0.0])
    mode = mr.Mode(np.zeros((2, 2)), [[1.0], [0.0]], [0, 0], mr.Polytope([[0.0, 0, 0]], [1.0]))
    loop = mr.ClosedLoop(mr.PWASystem([mode], square(1), mr.Polytope.box([-1], [1])), net)
    assert len(exact_cells.cells(loop)) == len(set(rows))
    for low, high in ((-1.0, -0.25), (0.25, 1.0), (-1.0, 1.0)):
        ends = [max(r * x for r in rows) for x in (low, high, min(max(low, 0), high))]
        found = mr.support(loop, mr.Polytope.box([low, 0], [high, 0.5]), [[1.0, 0], [-1.0, 0]], engine="exact")
        assert found.bound.tolist() == [max(ends), -min(ends)]


def loop_of(regions, targets, X, network, U):
    """x+ = target on each region (H, h) of (x, u)."""
    n, m = X.dimension, U.dimension
    zero, column = np.zeros((n, n)), np.zeros((n, m))
    modes = [mr.Mode(zero, column, target, mr.Polytope(*region)) for region, target in zip(regions, targets)]
    return mr.ClosedLoop(mr.PWASystem(modes, X, U), network)


def reached(loop, F):
    """h of R_1(F) along x1."""
    return mr.support(loop, F, np.eye(loop.system.state_size)[:1], engine="exact").bound[0]


@pytest.mark.parametrize("held", [1, 2])
def test_rows_of_u_may_leave_an_edge_or_a_point_of_a_cell(held):
    """u = (x1, x2) in R^3. A third mode acts where x3 = -u1, and u_i >= 1 for the first `held` inputs."""
    cube, square = mr.Polytope.box([-1] * 3, [1] * 3), mr.Polytope.box([-2] * 2, [2] * 2)
    net = mr.MaxoutNetwork((), [[1.0, 0, 0], [0, 1, 0]], [0.0, 0])
    row = np.eye(5)
    of_both = np.vstack([row[2] + row[3], -row[2] - row[3], -row[3 : 3 + held]])
    regions = [(row[[2]], [0.0]), (-row[[2]], [0.0]), (of_both, [0.0, 0.0, *-np.ones(held)])]
    loop = loop_of(regions, [[0.5, 0, 0], [0.25, 0, 0], [9.0, 0, 0]], cube, net, square)
    assert reached(loop, cube) == 9 and reached(loop, cube.scale(0.75)) == 0.5
    for end, value in (([1.0, 1, -1], 9), ([1.0, 0.5, -1], 9 if held == 1 else 0.5), ([1.0, 1, -0.5], 0.5)):
        assert reached(loop, mr.Polytope.box(end, end)) == value


def test_a_mode_that_acts_on_a_face_of_the_state_set_has_cells():
    cube, interval = mr.Polytope.box([-1] * 3, [1] * 3), mr.Polytope.box([-9], [9])
    net = random_loop(0, n=3).network
    row = np.eye(4)
    regions = [(row[[0]], [2.0]), (-row[[2]], [-1.0])]
    loop = loop_of(regions, [[0.5, 0, 0], [9.0, 0, 0]], cube, net, interval)
    assert reached(loop, cube) == 9 and reached(loop, mr.Polytope.box([0, 0, -1], [0, 0, np.nextafter(1, 0)])) == 0.5
    assert {cell.part.dimension for cell in exact_cells.cells(loop)} == {2, 3}
