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


@pytest.mark.parametrize("seed", range(4))
def test_cells_hold_every_state_with_the_step_that_fractions_give(seed):
    loop, rng = random_loop(seed, with_input=seed % 2 == 1, saturated=True), np.random.default_rng(seed)
    X, found = loop.system.state_set, exact_cells.cells(loop)
    for x in X.scale(0.9).sample(rng, 30).tolist():
        point, u = [Fraction(value) for value in x], exact_input(loop.network, x)
        for number, mode in enumerate(loop.system.modes):
            inside = exactly_inside(mode.region, [*point, *u])
            holding = [cell for cell in found if cell.mode == number and holds(cell, binary(x))]
            assert bool(holding) == inside
            for cell in holding:
                after = steps.successor(loop, point, number, (0, 0))
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
