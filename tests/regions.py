"""What tests of sets of the plane share: random states of a region, and the same loop and region in other units."""

import numpy as np
import shapely

import mireach as mr
from mireach.systems.network import MaxoutNetwork


def square(r):
    return mr.Polytope.box([-r, -r], [r, r])


def pieces_of(region):
    return [region.pieces[i] for i in range(len(region.pieces))]


def triangles_of(region):
    return [region.simplices[i] for i in range(len(region.simplices))]


def draw(region, rng, count):
    """Random states of a region, many of them near its boundary."""
    lower, upper = region.bounding_box()
    x = rng.uniform(lower, upper, (20 * count, 2))
    inside = x[region.contains(x)][:count]
    corners = region.simplices.points
    middles = (corners + np.roll(corners, 1, axis=0)) / 2
    return np.vstack([inside, corners, middles[region.contains(middles)]])


def in_other_units(loop, s, t):
    """The loop for x = s x', u = t u' (powers of two, one for each coordinate): another ClosedLoop for x', u'."""
    both = np.concatenate([s, t])
    modes = [
        mr.Mode(
            mode.A * s / s[:, None],
            mode.B * t / s[:, None],
            mode.p / s,
            mr.Polytope(mode.region.H * both, mode.region.h),
            mr.Polytope(mode.disturbance.H * s, mode.disturbance.h),
        )
        for mode in loop.system.modes
    ]
    X, U = loop.system.state_set, loop.system.input_set
    system = mr.PWASystem(modes, mr.Polytope(X.H * s, X.h), mr.Polytope(U.H * t, U.h))
    first, *hidden = loop.network.hidden
    hidden = [mr.Layer(first.weight * s, first.bias, first.pool), *hidden]
    return mr.ClosedLoop(system, MaxoutNetwork(hidden, loop.network.weight / t[:, None], loop.network.bias / t))


def rescaled(region, s):
    """{x' : s x' in the region}."""
    return mr.Region(shapely.transform(region.shape, lambda x: x / s))


def assert_same(own, other, s):
    """The region `other` is {x' : s x' in `own`}, corner by corner and bit by bit."""
    one, two = (shapely.get_coordinates(region.shape) for region in (own, other))
    assert np.array_equal(one, two * s)


def powers(rng, mixed):
    """Units s (2,) and t (1,)."""
    s = 2.0 ** rng.integers(-60, 61, 2) if mixed else np.full(2, 2.0 ** rng.integers(-60, 61))
    return s, 2.0 ** rng.integers(-60, 61, 1)
