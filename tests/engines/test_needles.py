"""Float cells against exact cells on slivers and needles, whose tips rounding moves far."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from fuzz import CLOSE, some_loop
from loops import jump_loop, random_loop

from mireach import Polytope, directions
from mireach.arithmetic.rational import binary, dot, maximize
from mireach.engines.cells import Cells
from mireach.engines.exact import Exact, cells
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


def needle_in_space(rng, loop):
    """{x : H x <= h} between two pairs of nearly parallel rows; its tip lies in the middle of X."""
    reach = loop.system.state_set.h.min()
    tip, w = rng.uniform(-0.3, 0.3, 3) * reach, 10.0 ** rng.uniform(-10, -8)
    Q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    H = np.array([Q[1], w * Q[0] - Q[1], Q[2], w * Q[0] / 3 - Q[2], -Q[0]])
    return Polytope(H, H @ tip + [0, 0, 0, 0, reach])


def exact_after_two_steps(loop, F, v):
    """The largest v x(2): over all pairs of exact cells, linear programs in x(0), d(0) in fractions; d(1) is added."""
    (n, every, best), v = (F.dimension, cells(loop, 10_000), None), binary(v)
    zero, identity = [0] * n, binary(np.eye(2 * n))
    for first in every:
        H, h = map(list, zip(*first.part.half_spaces, *zip(*F.exact)))
        if maximize(H, h, binary(zero)).point is None:
            continue
        D, limits = loop.system.modes[first.mode].disturbance.exact
        H = [(*a, *binary(zero)) for a in H] + [(*binary(zero), *a) for a in D]
        after = [(*form[:n], *row[n:]) for form, row in zip(first.forms, identity[n:])]
        for second in every:
            rows, ends = map(list, zip(*second.part.half_spaces))
            ends = [b - sum(x * form[-1] for x, form in zip(a, first.forms)) for a, b in zip(rows, ends)]
            rows = [[dot(a, column) for column in zip(*after)] for a in rows]
            w = [dot(v, column) for column in zip(*second.forms)]
            found = maximize(H + rows, [*h, *limits, *ends], [dot(w[:n], column) for column in zip(*after)])
            if found.point is None:
                continue
            pushed = max(dot(v, binary(d)) for d in loop.system.modes[second.mode].disturbance.vertices())
            value = found.value + sum(a * form[-1] for a, form in zip(w, first.forms)) + w[-1] + pushed
            best = value if best is None else max(best, value)
    return Fraction(int(best.p), int(best.q))


@pytest.mark.parametrize("seed", [13, 15, 21])
def test_bounds_of_two_steps_from_needles_in_space_are_sound_and_tight(seed):
    rng, loop = np.random.default_rng([seed, 5]), random_loop(seed % 11, n=3, cuts=1)
    F, V = needle_in_space(rng, loop), rng.normal(size=(1, 3))
    found, exactly = Cells().support(loop, F, V, 2), exact_after_two_steps(loop, F, V[0])
    assert exactly <= Fraction(found.bound[0]) and found.bound[0] <= exactly + CLOSE * np.linalg.norm(V)
    assert found.value[0] == pytest.approx(float(exactly), abs=CLOSE)
    end = found.witness[0].states[-1]
    assert V[0] @ end == pytest.approx(found.value[0], abs=1e-6)
