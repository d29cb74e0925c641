"""Float cells against exact cells on random loops, and on sets that are points, segments, or touch where maps jump."""

import numpy as np
import pytest
from loops import random_loop

from mireach import Polytope, directions
from mireach.engines import cells, exact

CLOSE = 1e-9  # what float bounds may lie above the truth, for rows of length 1


def some_loop(seed):
    """A loop of random shape: up to four modes, regions of x or of (x, u), up to two layers of up to three neurons."""
    rng = np.random.default_rng(seed)
    return rng, random_loop(
        seed,
        cuts=int(rng.integers(0, 4)),
        with_input=bool(rng.integers(0, 2)),
        saturated=bool(rng.integers(0, 2)),
        layers=int(rng.integers(1, 3)),
        width=int(rng.integers(1, 4)),
        pool=int(rng.integers(1, 4)),
    )


def on_boundaries(loop, x):
    """For every row of a region that does not involve u, the point nearest to x on its boundary: array (k, 2)."""
    rows = [row for mode in loop.system.modes for row in zip(mode.region.H, mode.region.h) if not row[0][2:].any()]
    return np.array([x + (b - a[:2] @ x) / (a[:2] @ a[:2]) * a[:2] for a, b in rows]).reshape(-1, 2)


@pytest.mark.parametrize("first", range(0, 200, 20))
def test_float_bounds_are_never_below_the_exact_value_and_hardly_above(first):
    for seed in range(first, first + 20):
        rng, loop = some_loop(seed)
        X, V = loop.system.state_set, np.vstack([directions(5), rng.normal(size=(1, 2)) * 30])
        x = X.sample(rng, 6)
        touching = on_boundaries(loop, x[0])
        inside = [Polytope.from_points(x[:count]) for count in (1, 2, 6)] + [X, Polytope.box(x[0], x[0])]
        at_jumps = [Polytope.from_points(np.vstack([touching, x[1 : 1 + count]])) for count in (0, 1, 3)]
        for F in inside + (at_jumps if len(touching) else []):
            bound, value = cells.support(loop, F, V).bound, exact.support(loop, F, V).value
            assert (bound >= value).all(), seed
            if any(F is one for one in inside):  # at a jump, what touches to within rounding counts as touching
                assert (bound <= value + CLOSE * np.maximum(1, np.linalg.norm(V, axis=1))).all(), seed
