"""Float cells against exact cells on slivers and needles, whose tips rounding moves far."""

from dataclasses import replace

import numpy as np
import pytest
from fuzz import CLOSE, some_loop
from loops import jump_loop, random_loop

from mireach import Polytope, directions
from mireach.engines.cells import Cells
from mireach.engines.exact import Exact
from mireach.engines.milp.engine import Milp


def needle(rng, tip, w):
    """{x : H x <= h} between two rows of random length that meet in a tip, at an angle w."""
    turn = rng.uniform(0, 2 * np.pi)
    H = np.array([[-np.sin(turn), np.cos(turn)], [np.sin(turn + w), -np.cos(turn + w)]]) * 10 ** rng.uniform(-1, 1, 2)
    return Polytope(H, H @ tip)


def sliver(rng, x, width):
    """A triangle whose third corner lies `width` off the line through the other two."""
    return Polytope.from_points([x[0], x[1], x[0] + rng.uniform(-1, 2) * (x[1] - x[0]) + width * rng.normal(size=2)])


def against_walls(rng, loop, x, w):
    """Half-planes that make a needle with the boundary of X or of a region, or that run along it on the same side."""
    walls = [(a[:2], b) for mode in loop.system.modes for a, b in zip(mode.region.H, mode.region.h) if not a[2:].any()]
    walls += list(zip(loop.system.state_set.H, loop.system.state_set.h))
    a, b = walls[rng.integers(len(walls))]
    on_wall = x + (b - a @ x) / (a @ a) * a
    turned = np.array([[np.cos(w), -np.sin(w)], [np.sin(w), np.cos(w)]]) @ a
    return [Polytope([side * turned], [side * (turned @ on_wall)]) for side in (1, -1)]


def assert_agree(loop, F, V):
    found, exactly = Cells().support(loop, F, V), Exact().support(loop, F, V).value
    lengths = np.maximum(1, np.linalg.norm(V, axis=1))
    assert (found.bound >= exactly).all()
    assert (found.bound <= exactly + CLOSE * lengths).all()
    assert (found.value <= exactly + 0.1 * CLOSE * lengths).all()


@pytest.mark.parametrize("first", range(1000, 1036, 12))
def test_bounds_of_needles_and_slivers_are_sound_and_tight(first):
    for seed in range(first, first + 12):
        rng, loop = some_loop(seed)
        X, V = loop.system.state_set, np.vstack([directions(5), rng.normal(size=(1, 2)) * 30])
        x, widths = X.sample(rng, 6), 10 ** rng.uniform(-9, -2, 5)
        thin = needle(rng, x[1], widths[1])
        cut = Polytope(rng.normal(size=(2, 2)), rng.normal(size=2) + 2)
        sets = [needle(rng, x[0], widths[0]), thin, thin & X, thin & cut, sliver(rng, x, widths[2] / 100)]
        for F in [*sets, *against_walls(rng, loop, x[2], widths[3])]:
            assert_agree(loop, F, V)


@pytest.mark.parametrize(
    ("H", "h"),
    [
        ([[0, 1], [1e-8, -1]], [0.1, -0.1 + 3e-9]),  # ends at x1 = 0.3, but for rounding
        ([[3, 4], [-0.6, -0.80001]], [0, 0]),
        ([[1 / 3, 0.7], [-1 / 3 - 1e-6, -0.7]], [0.25, -0.25]),
    ],
    ids=["1e-8", "1e-5", "1e-6"],
)
@pytest.mark.parametrize("seed", [3, 4, 5])
def test_three_needles(H, h, seed):
    for cut in range(3):
        assert_agree(random_loop(seed, cuts=cut), Polytope(H, h), directions(8))


@pytest.mark.parametrize("w", [2.0**-10, 2.0**-17, 2.0**-24, 2.0**-30])
def test_needles_end_where_they_meet_the_line_at_which_the_map_jumps(w):
    """x1 <= 1 and x1 >= 1 + w (x2 - 11/16): of the left mode only what has x2 <= 11/16 counts."""
    loop, end = jump_loop([0, 0], [0, 0]), 11 / 16
    modes = [replace(mode, A=A) for mode, A in zip(loop.system.modes, (np.eye(2), np.zeros((2, 2))))]
    loop = replace(loop, system=replace(loop.system, modes=modes))
    found = Cells().support(loop, Polytope([[-1.0, w]], [-1.0 + end * w]), [[0, 1.0], [1.0, 1.0]])
    assert (found.bound >= [end, 1 + end]).all() and (found.bound <= np.array([end, 1 + end]) + CLOSE).all()


@pytest.mark.parametrize("seed", range(2000, 2008))
def test_milp_attains_its_values_in_needles(seed):
    rng, loop = some_loop(seed)
    X, V = loop.system.state_set, directions(4)
    x, widths = X.sample(rng, 2), 10 ** rng.uniform(-9, -2, 2)
    for F in (needle(rng, x[0], widths[0]), sliver(rng, np.vstack([x, x]), widths[1] / 100)):
        found, truth = Milp().support(loop, F, V), Exact().support(loop, F, V)
        assert (found.bound >= truth.value).all() and (found.value <= truth.bound).all()
        assert (found.value >= truth.value - 1e-6 * (1 + np.abs(truth.value))).all()
