"""Cutting many polygons at once against qhull's intersection of half-planes, one by one."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull, HalfspaceIntersection

from mireach.sets.polygons import Polygons


def random_polygons(rng, count):
    """Hulls of random points, in order around them."""
    hulls = []
    for _ in range(count):
        points = rng.normal(size=(rng.integers(3, 9), 2))
        hulls.append(points[ConvexHull(points).vertices])
    return hulls


def area(points):
    x, y = points.T
    return abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


@pytest.mark.parametrize("seed", range(10))
def test_clip_leaves_the_part_in_the_half_plane(seed):
    rng = np.random.default_rng(seed)
    hulls = random_polygons(rng, 25)
    a, b = rng.normal(size=(25, 2)), 0.5 * rng.normal(size=25)
    clipped, kept = Polygons.of(hulls).clip(a, b, 0.0)
    for i in range(25):
        if i not in kept:
            assert (hulls[i] @ a[i] > b[i]).all()
            continue
        found = clipped[list(kept).index(i)]
        equations = np.vstack([ConvexHull(hulls[i]).equations, [*a[i], -b[i]]])
        middle = found.mean(axis=0)
        expected = ConvexHull(HalfspaceIntersection(equations, middle).intersections)
        assert area(found) == pytest.approx(expected.volume, abs=1e-9)
        assert (found @ a[i] <= b[i] + 1e-12).all()


@pytest.mark.parametrize("seed", range(5))
def test_both_sides_of_a_cut_add_up(seed):
    rng = np.random.default_rng(seed)
    hulls = random_polygons(rng, 25)
    a, b = rng.normal(size=(25, 2)), 0.5 * rng.normal(size=25)
    whole = Polygons.of(hulls)
    total = np.zeros(25)
    for sign in (1, -1):
        part, kept = whole.clip(sign * a, sign * b, 0.0)
        for j, i in enumerate(kept):
            total[i] += area(part[j])
    np.testing.assert_allclose(total, [area(points) for points in hulls], rtol=1e-9)


SQUARE = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])


@pytest.mark.parametrize(
    ("points", "a", "b", "left"),
    [
        (SQUARE, [1, 0], 0.0, [[0, 0], [0, 1]]),
        (SQUARE, [1, 1], 0.0, [[0, 0]]),
        (SQUARE, [1, 0], -0.1, None),
        (SQUARE, [1, 0], 1.0, SQUARE),
        (SQUARE[:2], [1, 0], 0.25, [[0, 0], [0.25, 0]]),
        (SQUARE[:2], [0, 1], 0.0, [[0, 0], [1, 0]]),
        (SQUARE[:2], [0, 1], -0.1, None),
        (SQUARE[2:3], [1, 0], 1.0, [[1, 1]]),
        (SQUARE[2:3], [1, 0], 0.9, None),
    ],
)
def test_touching_pieces_segments_and_points_survive(points, a, b, left):
    clipped, kept = Polygons.of([points]).clip(np.array([a], float), np.array([b]), 1e-12)
    if left is None:
        assert len(clipped) == 0 and len(kept) == 0
    else:
        assert {tuple(p) for p in clipped[0]} == {tuple(p) for p in np.asarray(left, float)}


def test_take_join_and_extremes_by_polygon():
    P = Polygons.of([SQUARE, SQUARE[:1] + 5, SQUARE[:2] - 3])
    Q = Polygons.join([P.take([2, 0]), P.take([1]), P.take([])])
    assert len(Q) == 3
    for found, expected in zip((Q[0], Q[1], Q[2]), (SQUARE[:2] - 3, SQUARE, SQUARE[:1] + 5), strict=True):
        np.testing.assert_array_equal(found, expected)
    assert Q.owner.tolist() == [0, 0, 1, 1, 1, 1, 2]
    assert P.largest(P.points).tolist() == [[1, 1], [5, 5], [-2, -3]]
    assert P.least(P.points).tolist() == [[0, 0], [5, 5], [-3, -3]]
    assert len(Polygons.of([])) == 0 and len(P.take([]).clip(np.zeros((0, 2)), np.zeros(0), 0.0)[1]) == 0
