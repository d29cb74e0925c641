"""The compiled loops against brute force over all pairs of rows, and against scipy's linear programs."""

from fractions import Fraction
from itertools import combinations

import numpy as np
import pytest
from loops import solve_exactly
from scipy.optimize import linprog
from scipy.spatial import ConvexHull, HalfspaceIntersection

from mireach.sets.kernels import (
    FAT,
    HalfPlane,
    Neuron,
    _cut,
    _doubt,
    around,
    dual_bounds,
    highest,
    parts,
    polygon,
    sharp_pairs,
)
from mireach.sets.polygons import Polygons

PARALLEL, TOL = 1e-12, 1e-11


def readonly(array):
    """As the arrays of a Polytope are."""
    array = np.array(array, float)
    array.setflags(write=False)
    return array


def vertices(H, h):
    return polygon(readonly(H), readonly(h), PARALLEL, TOL)[1]


def support_by_lp(H, h, v):
    found = linprog(-np.asarray(v), A_ub=H, b_ub=h, bounds=(None, None))
    return -found.fun if found.status == 0 else None


def random_rows(rng, count):
    angles = np.sort(rng.uniform(0, 2 * np.pi, count))
    return np.column_stack([np.cos(angles), np.sin(angles)]) * rng.uniform(0.1, 3, (count, 1))


@pytest.mark.parametrize("seed", range(40))
def test_vertices_have_the_support_of_the_rows_and_go_around(seed):
    rng = np.random.default_rng(seed)
    H = random_rows(rng, rng.integers(3, 14))
    h = H @ rng.normal(size=2) + rng.uniform(0, 2, len(H)) * np.linalg.norm(H, axis=1)
    H = np.vstack([H, H[:2], np.zeros((1, 2))])  # two rows twice, and 0 x <= 1/2
    h = np.array([*h, h[0], h[1] + 1, 0.5])
    found = vertices(H, h)
    V = rng.normal(size=(12, 2))
    wanted = [support_by_lp(H, h, v) for v in V]
    if None in wanted:
        assert not len(found)
        return
    np.testing.assert_allclose((V @ found.T).max(axis=1), wanted, atol=1e-7)
    edges = np.roll(found, -1, axis=0) - found
    turns = edges[:, 0] * np.roll(edges, -1, axis=0)[:, 1] - edges[:, 1] * np.roll(edges, -1, axis=0)[:, 0]
    assert (turns > 0).all()


@pytest.mark.parametrize(
    ("H", "h"),
    [
        ([[1, 0], [-1, 0], [0, 1], [0, -1]], [1, -2, 1, 1]),  # empty
        ([[1, 0], [-1, 0]], [1, 1]),  # a strip
        ([[1, 0], [0, 1]], [1, 1]),  # a corner
        ([[1, 0], [-1, 0], [0, 1], [0, -1], [0, 0]], [1, 1, 1, 1, -1]),  # 0 <= -1
        ([[0, 0]], [1]),  # the plane
    ],
)
def test_sets_without_vertices_give_none(H, h):
    assert not len(vertices(H, h))


def test_points_and_segments_are_sets():
    H = [[1, 0], [-1, 0], [0, 1], [0, -1]]
    np.testing.assert_array_equal(vertices(H, [2, -2, 3, -3]), [[2, 3]])
    segment = vertices([*H, [1, 1]], [2, 1, 3, -3, 100])
    assert sorted(map(tuple, segment.tolist())) == [(-1, 3), (2, 3)]


def test_around_leaves_out_what_is_not_extreme():
    square = np.array([[0, 0], [1, 1], [0.5, 0.0], [1, 0], [0, 1]], float)
    turns = [np.roll([[0, 0], [1, 0], [1, 1], [0, 1]], k, axis=0).tolist() for k in range(4)]
    assert around(square).tolist() in turns
    line = np.array([[0, 0], [2, 2], [1, 1], [0.3, 0.3]])
    assert sorted(map(tuple, around(line).tolist())) == [(0, 0), (2, 2)]


@pytest.mark.parametrize("seed", range(20))
def test_highest_point_of_cut_polygons(seed):
    """max v (M x + c) + spread over each polygon and {H x <= h}, by one linear program a polygon."""
    rng = np.random.default_rng(seed)
    count, V = 6, rng.normal(size=(5, 2))
    clouds = [rng.normal(size=(9, 2)) + rng.normal(size=2) for _ in range(count)]
    hulls = [cloud[ConvexHull(cloud).vertices] for cloud in clouds]
    hulls += [np.array([[0.5, 0.5], [2.0, -1.0]]), np.array([[0.1, -0.2]])]
    polygons, count = Polygons.of(hulls), len(hulls)
    M, c, mode = rng.normal(size=(count, 2, 2)), rng.normal(size=(count, 2)), rng.integers(0, 2, count)
    spread, H = rng.uniform(0, 1, (2, 5)), random_rows(rng, 6)
    h = rng.uniform(-0.2, 2, 6) * np.linalg.norm(H, axis=1)
    heights = np.array([((hull @ M[j].T + c[j]) @ V.T).max(axis=0) for j, hull in enumerate(hulls)])
    heights += spread[mode]
    error = rng.uniform(0, 0.1, (count, 2))
    shape = (polygons.points, polygons.starts, *polygons.discs, mode)
    tops = heights + error @ np.abs(V).T
    rows = (readonly(H), readonly(h), np.full(6, -1), 0.0, TOL)
    query, maps = (*shape, *rows), (M, c, error, spread, heights, tops, V)
    value, top, owner, left = highest(query, maps, np.arange(count))
    wanted = np.full((count, 5), -np.inf)
    for j, hull in enumerate(hulls):
        for k, v in enumerate(V):  # x = hull' w with weights w >= 0 that add up to 1
            best = linprog(
                -(hull @ M[j].T @ v), A_ub=H @ hull.T, b_ub=h, A_eq=np.ones((1, len(hull))), b_eq=[1], bounds=(0, None)
            )
            if best.status == 0:
                wanted[j, k] = -best.fun + v @ c[j] + spread[mode[j], k]
    with_error = wanted + error @ np.abs(V).T
    np.testing.assert_allclose(top, with_error.max(axis=0), atol=1e-8)
    if np.isfinite(value).all():
        np.testing.assert_allclose(with_error[owner, range(5)], top, atol=1e-8)
        np.testing.assert_allclose(wanted[owner, range(5)], value, atol=1e-8)
    assert set(np.flatnonzero(np.isfinite(wanted).any(axis=1))) <= set(left)
    again = highest(query, maps, left)
    assert all((one == other).all() for one, other in zip(again, (value, top, owner, left)))
    some = np.flatnonzero(rng.random(count) < 0.5)
    top = highest(query, maps, some)[1]
    np.testing.assert_allclose(top, with_error[some].max(axis=0, initial=-np.inf), atol=1e-8)


def test_every_pair_of_rows_may_make_a_vertex():
    """A regular polygon with many rows: all its vertices, each once."""
    angles = 2 * np.pi * np.arange(32) / 32
    H = np.column_stack([np.cos(angles), np.sin(angles)])
    found = vertices(H, np.ones(32))
    pairs = [np.linalg.solve(H[[i, j]], np.ones(2)) for i, j in combinations(range(32), 2) if (j - i) in (1, 31)]
    assert len(found) == 32
    for point in pairs:
        assert np.abs(found - point).max(axis=1).min() < 1e-9


def test_a_half_strip_is_unbounded_and_a_row_of_zeros_may_hold_with_equality():
    assert not len(vertices([[1, 0], [-1, 0], [0, 1]], [1, 1, 1]))
    assert len(vertices([[1, 0], [-1, 0], [0, 1], [0, -1], [0, 0]], [1, 1, 1, 1, 0])) == 4


def test_corners_that_rounding_feigns_are_left_out():
    assert len(around(np.array([[0, 0], [0.5, -1e-14], [1, 0], [1, 1], [0, 1]], float))) == 4


def test_a_tip_that_only_touches_counts():
    polygons = Polygons.of([np.array([[0.0, 0], [2, 0], [2, 1]]), np.array([[0.0, 0], [-0.5, 1], [-0.5, -1]])])
    shape = (polygons.points, polygons.starts, *polygons.discs, np.zeros(2, int))
    beyond = (readonly([[-1.0, 0]]), readonly([-2.0]), np.array([-1]), 0.0, TOL)  # x1 >= 2
    maps, whole = (np.tile(np.eye(2), (2, 1, 1)), np.zeros((2, 2)), np.zeros((2, 2))), np.full((2, 2), 9.0)
    query = (*shape, *beyond)
    value, top, *_ = highest(query, (*maps, np.zeros((1, 2)), whole, whole, np.eye(2)), np.arange(2))
    np.testing.assert_allclose(value, [2, 1])
    np.testing.assert_allclose(top, [2, 1])
    points, starts, owner = parts(query)
    assert sorted(map(tuple, points.tolist())) == [(2, 0), (2, 1)]
    assert starts.tolist() == [0, 2] and owner.tolist() == [0]


def test_a_row_of_one_mode_cuts_the_polygons_of_that_mode_only():
    square = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    polygons = Polygons.of([square, square])
    shape = (polygons.points, polygons.starts, *polygons.discs, np.array([0, 1]))
    points, starts, owner = parts((*shape, readonly([[1.0, 0]]), readonly([0.25]), np.array([1]), 0.0, TOL))
    assert owner.tolist() == [0, 1] and starts.tolist() == [0, 4, 8]
    assert points[:4].max() == 1 and points[4:, 0].max() == 0.25


@pytest.mark.parametrize("seed", range(20))
def test_parts_are_those_of_qhull(seed):
    rng = np.random.default_rng(seed)
    clouds = [rng.normal(size=(9, 2)) + rng.normal(size=2) for _ in range(6)]
    hulls, H = [cloud[ConvexHull(cloud).vertices] for cloud in clouds], random_rows(rng, 4)
    h = H @ rng.normal(size=2) + rng.uniform(0.1, 2, 4) * np.linalg.norm(H, axis=1)
    polygons = Polygons.of(hulls)
    shape = (polygons.points, polygons.starts, *polygons.discs, np.zeros(6, int))
    points, starts, owner = parts((*shape, readonly(H), readonly(h), np.full(4, -1), 0.0, TOL))
    for j, hull in enumerate(hulls):
        rows = np.vstack([ConvexHull(hull).equations, np.column_stack([H, -h])])
        lengths = np.linalg.norm(rows[:, :2], axis=1)
        inner = linprog([0, 0, -1], np.column_stack([rows[:, :2], lengths]), -rows[:, 2], bounds=[(None, None)] * 3)
        if inner.x[2] < 1e-3:
            continue
        wanted = ConvexHull(HalfspaceIntersection(rows, inner.x[:2]).intersections).volume
        found = Polygons(points, starts)[list(owner).index(j)]
        assert ConvexHull(found).volume == pytest.approx(wanted, rel=1e-9)


def test_only_tips_within_reach_are_sharp():
    H, far = readonly([[0.0, 1], [1e-3, -1], [0, -1], [1, 0]]), readonly([0.5, -0.5, 0.5, 3])
    none = readonly(np.zeros((0, 2))), readonly([])
    assert sharp_pairs(H, far, *none, 6.0, 1e-12, 0.1).tolist() == [[0, 1]]  # in (0, 0.5)
    assert sharp_pairs(H, far + np.array([0, 0.1, 0, 0]), *none, 6.0, 1e-12, 0.1).tolist() == []  # 100 away
    assert sharp_pairs(H[[0]], far[[0]], H[[1]], far[[1]], 6.0, 1e-12, 0.1).tolist() == [[0, 1]]
    assert sharp_pairs(H, far, *none, 6.0, 1e-12, 1e-4).tolist() == []


@pytest.mark.parametrize("seed", range(20))
def test_many_rows_through_one_vertex_give_it_once(seed):
    rng = np.random.default_rng(seed)
    centre, angles = 10 * rng.normal(size=2), np.sort(rng.uniform(0.2, 1.3, 6))
    H = np.vstack([np.column_stack([np.cos(angles), np.sin(angles)]), [[-1, 0], [0, -1]]])
    assert len(vertices(H, H @ centre + np.array([0] * 6 + [1, 1]))) in (3, 4)


# -- what a piece may be off by -------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(10))
def test_the_doubt_of_a_piece_covers_all_states_in_the_slits_around_it(seed):
    """The largest of three channels against the first one, in fractions, at points that far beyond the edges."""
    rng, slits = np.random.default_rng(seed), 2.0**-4
    polygon, channels = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]]), rng.integers(-8, 9, (3, 3)) / 4.0
    error = np.array([0.0, 1 / 128, 0])
    doubt = _doubt(polygon, 4, Neuron(channels, error, 0, 3), 0, slits)
    for corner in polygon:
        for beyond in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            x = [Fraction(c) + Fraction(slits) * d for c, d in zip(corner.tolist(), beyond)]
            z = [sum(Fraction(a) * b for a, b in zip(row, [*x, 1])) + Fraction(e) for row, e in zip(channels, error)]
            assert max(z) - z[0] <= Fraction(doubt)


@pytest.mark.parametrize("seed", range(10))
def test_dual_bounds_are_not_below_the_exact_maximum(seed):
    """The corners are those meetings of two rows that satisfy all rows, in fractions."""
    rng = np.random.default_rng(seed)
    H, V = random_rows(rng, 6), rng.normal(size=(8, 2))
    H = np.vstack([H, np.eye(2), -np.eye(2)])
    h = rng.uniform(0.1, 2, len(H))
    kind, _, *found = polygon(readonly(H), readonly(h), PARALLEL, TOL)
    assert kind == FAT
    rows = [([Fraction(a), Fraction(b)], Fraction(c)) for (a, b), c in zip(H.tolist(), h.tolist())]
    meetings = [solve_exactly([a, b], [p, q]) for (a, p), (b, q) in combinations(rows, 2)]
    corners = [x for x in meetings if x and all(a[0] * x[0] + a[1] * x[1] <= b for a, b in rows)]
    for (p, q), bound in zip(V.tolist(), dual_bounds(readonly(V), *found)):
        highest_corner = max(Fraction(p) * x[0] + Fraction(q) * x[1] for x in corners)
        assert highest_corner <= Fraction(bound) <= highest_corner + Fraction(1, 10**9)


@pytest.mark.parametrize(("gap", "count"), [(0.0, 4), (5e-12, 2), (2e-11, 0), (-0.25, 4)])
def test_a_polygon_that_a_half_plane_touches_keeps_the_edge(gap, count):
    """The unit square and x1 >= 1 + gap, with touch = 1e-11; at a gap of 0 the part is as wide as the slack."""
    polygon, part = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]]), np.zeros((16, 2))
    kept = _cut(polygon, 4, HalfPlane(-1.0, 0.0, -1.0 - gap, 1e-15, 1e-11), part, np.zeros(16))
    assert kept == count
    assert part[:kept].tolist() == [] or np.abs(part[:kept, 0].min() - min(1 + gap, 1)) <= 1e-14
    assert sorted(set(part[:kept, 1].tolist())) == ([0, 1] if count else [])
