"""Polytopes against qhull and formulas: hulls, vertices, sizes, samples, files, and bad arguments."""

import json
from fractions import Fraction
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from polytopes import (
    exact_corners,
    exactly,
    far_away,
    flat,
    nearly_flat,
    ordinary,
    polytopes,
    random_set,
    small,
    whole_vector,
)
from scipy.spatial import ConvexHull, HalfspaceIntersection

from mireach import Polytope, directions

points = arrays(float, st.tuples(st.integers(3, 12), st.just(2)), elements=st.integers(-40, 40).map(lambda k: k / 8))
dimensions = pytest.mark.parametrize("n", [1, 2, 3, 4])
units = pytest.mark.parametrize("unit", [0, -40, 40])


# -- vertices -----------------------------------------------------------------------------------------


@given(points)
def test_vertices_of_a_hull_are_those_of_qhull_and_counter_clockwise(points):
    P = Polytope.from_points(points)
    corners = P.vertices()
    assert P.contains(points, tol=1e-9).all()
    rank = np.linalg.matrix_rank(points - points[0], tol=1e-9)
    assert len(corners) == {0: 1, 1: 2}.get(rank, len(ConvexHull(points).vertices) if rank == 2 else 0)
    assert np.abs(corners[:, None] - points[None]).max(axis=2).min(axis=1).max() < 1e-8
    if rank == 2:
        onward, before = np.roll(corners, -1, axis=0) - corners, corners - np.roll(corners, 1, axis=0)
        assert (before[:, 0] * onward[:, 1] - before[:, 1] * onward[:, 0] > 0).all()


@pytest.mark.parametrize("n", [2, 3])
def test_vertices_are_those_of_qhull_halfspaces(n):
    rng = np.random.default_rng(7 * n)
    for _ in range(6):
        H = np.vstack([np.eye(n), -np.eye(n), rng.normal(size=(4, n))])
        h = rng.uniform(0.5, 2, len(H))
        expected = HalfspaceIntersection(np.column_stack([H, -h]), np.zeros(n)).intersections
        found = Polytope(H, h).vertices()
        gaps = np.abs(found[:, None] - expected[None]).max(axis=2)
        assert gaps.min(axis=0).max() < 1e-8 and gaps.min(axis=1).max() < 1e-8


def test_vertices_of_points_and_segments():
    assert Polytope.box([1, 2], [1, 2]).vertices().tolist() == [[1, 2]]
    ends = np.array([[0.3, -1.7], [2.1, 0.4]])
    corners = Polytope.from_points(ends).vertices()
    np.testing.assert_allclose(corners[np.argsort(corners[:, 0])], ends, atol=1e-12)
    assert len(Polytope.box([0, 0, 0], [1, 0, 0]).vertices()) == 2


def test_vertices_of_a_product_are_those_of_its_factors():
    """Three octagons in R^6, whose rows meet in many nearly singular ways."""
    P = Polytope(np.vstack([np.kron(directions(8), axis) for axis in np.eye(3)]), np.ones(24))  # (x_i, x_(i + 3))
    octagon = Polytope(directions(8), np.ones(8)).vertices()
    expected = [np.ravel(corners, order="F") for corners in product(octagon, repeat=3)]
    found = P.vertices()
    assert found.shape == (512, 6)
    np.testing.assert_allclose(
        found[np.lexsort(found.T)], np.array(expected)[np.lexsort(np.transpose(expected))], atol=1e-12
    )


@pytest.mark.parametrize("n", [1, 2, 3])
def test_sets_wider_than_the_largest_float_have_vertices_and_refuse_samples(n):
    P = Polytope.box([-1e308] * n, [1e308] * n)
    assert len(P.vertices()) == 2**n and np.abs(P.vertices()).min() == 1e308
    with pytest.raises(ValueError, match="wider than the largest float"):
        P.sample(0, 5)


# -- intersection, scaling, samples --------------------------------------------------------------------


@given(polytopes(), polytopes(), st.integers(0, 10**6))
def test_intersection_holds_exactly_what_both_hold(P, Q, seed):
    x = np.random.default_rng(seed).uniform(-5, 5, (50, 2))
    both = P & Q
    assert (both.contains(x) == (P.contains(x) & Q.contains(x))).all()
    assert both.is_subset(P) and both.is_subset(Q)


@given(polytopes(), st.floats(0.1, 4), arrays(float, 2, elements=small))
def test_scaling_moves_every_vertex_along_its_ray_from_the_centre(P, s, c):
    V = directions(7)
    expected = (V @ (c + s * (P.vertices() - c)).T).max(axis=1)
    np.testing.assert_allclose(P.scale(s, c).support(V), expected, atol=1e-8)
    np.testing.assert_allclose(P.scale(s).support(V), s * P.support(V), atol=1e-8)


def test_operations_leave_their_inputs_alone():
    P, Q = Polytope.box([0, 0], [1, 1]), Polytope.box([-1, -1], [0.5, 0.5])
    before = P.H.copy(), P.h.copy()
    P & Q, P.scale(2), P.product(Q), P.vertices(), P.support(directions(4))
    assert (before[0] == P.H).all() and (before[1] == P.h).all()
    with pytest.raises(ValueError):
        P.h[0] = 3
    P.vertices()[0] = 9
    assert P.vertices().max() == 1


@pytest.mark.parametrize("n", [2, 3])
def test_chebyshev_ball_fits_and_no_larger_one_does(n):
    P = Polytope.box(np.zeros(n), np.arange(1.0, n + 1))
    centre, radius = P.chebyshev()
    assert radius == pytest.approx(0.5) and P.contains(centre, tol=1e-9)
    assert Polytope.box([0, 0], [0, 3]).chebyshev()[1] == pytest.approx(0, abs=1e-9)
    assert Polytope([[1.0, 0], [-1.0, 0]], [0, -1]).chebyshev()[1] == pytest.approx(-0.5)
    assert Polytope([[1.0, 0]], [0]).chebyshev() == (None, np.inf)


@pytest.mark.parametrize(
    "P",
    [Polytope.box([0, 1], [2, 4]), Polytope.box([1, 1], [1, 1]), Polytope.from_points([[0, 0], [1, 1]])],
    ids=["box", "point", "segment"],
)
def test_samples_lie_in_the_set(P):
    x = P.sample(np.random.default_rng(0), 100)
    assert x.shape == (100, 2) and P.contains(x, tol=1e-9).all()
    if P.vertices().shape[0] > 1:
        assert np.ptp(x, axis=0).min() > 0.5


@pytest.mark.parametrize("kind", ["flat", "needle", "point", "many rows"])
@pytest.mark.parametrize("n", [1, 3, 6])
def test_samples_of_sets_that_do_not_fill_their_box(kind, n):
    rng, a = np.random.default_rng(n), np.arange(1.0, n + 1)
    box = Polytope.box(-np.ones(n), np.ones(n))
    if kind == "flat":
        P = box & Polytope([a, -a], [0, 0])
    elif kind == "needle":
        P = box & Polytope([a, -a], [1e-9, 0])
    elif kind == "point":
        P = Polytope.box(a, a)
    else:  # whose vertices cannot be enumerated
        H = rng.normal(size=(5 * n + 30, n))
        P = Polytope(np.vstack([H, [a, -a]]), np.concatenate([np.linalg.norm(H, axis=1), [0, 0]])) & box
        if n == 6:
            with pytest.raises(ValueError, match="too many"):
                P.vertices()
    x = P.sample(3, 200)
    assert x.shape == (200, n) and P.contains(x, tol=1e-12).all()
    assert (x == P.sample(np.random.default_rng(3), 200)).all()
    if n > 1 and kind != "point":
        assert np.linalg.matrix_rank(x - x[0], tol=1e-6) == n - 1


def test_product_holds_pairs():
    both = Polytope.box([0], [1]).product(Polytope.box([2, 2], [3, 3]))
    assert both.contains([[0.5, 2.5, 3.0]]).all() and not both.contains([0.5, 1.9, 2.5])


@pytest.mark.parametrize("make", [flat, nearly_flat, far_away, ordinary])
@pytest.mark.parametrize("n", [1, 2, 3])
def test_vertices_move_with_the_units(make, n):
    rng = np.random.default_rng(10 + n)
    for _ in range(10):
        H, h = make(rng, n)
        e, s = rng.integers(-60, 61, n), 2.0 ** rng.integers(-300, 300, len(h))
        P, Q = Polytope(H, h), Polytope(np.ldexp(H, -e) * s[:, None], h * s)
        np.testing.assert_array_equal(Q.vertices(), np.ldexp(P.vertices(), e))


def nearly_collinear(rng):
    """Points on a line, but for rounding or a little more; some of them twice."""
    ends, share = rng.normal(size=(2, 2)) * 10.0 ** rng.integers(-3, 4), rng.random((rng.integers(2, 9), 1))
    noise = rng.choice([0, 1e-16, 1e-13, 1e-9]) * rng.normal(size=(len(share), 2))
    points = ends[0] + share * (ends[1] - ends[0]) + noise
    return np.vstack([points, points[:1]])


@pytest.mark.parametrize("seed", range(40))
def test_a_hull_is_bounded_and_holds_its_points_and_little_more(seed):
    rng = np.random.default_rng(seed)
    points = nearly_collinear(rng) if seed % 2 else whole_vector(rng, 12, 4).reshape(6, 2)
    points = np.ldexp(points, rng.integers(-60, 61, 2))
    P = Polytope.from_points(points)
    assert P.is_bounded and P.contains(points).all() and all(P.contains(x) for x in points)
    for x in exactly(points):
        assert all(sum(a * y for a, y in zip(row, x)) <= b for row, b in zip(exactly(P.H), exactly(P.h)))
    assert (points @ P.H.T <= P.h).all()
    V = np.ldexp(directions(16), -np.frexp(np.abs(points).max(axis=0))[1])
    assert (P.support(V) <= (points @ V.T).max(axis=0) + 1e-12).all()
    assert (P.vertices() @ V.T).max() <= 2


def test_hulls_of_points_and_segments_hold_their_ends():
    segment = Polytope.from_points([[3, 2.4], [6, 4.8]])
    assert segment.contains([[3, 2.4], [6, 4.8]]).all() and not segment.contains([[3, 2.5], [6.1, 4.88]]).any()
    for points in ([[0.1, 0.7]], [[0.1, 0.7]] * 3, [[0.1, 0.7, 0.3]] * 2, [[5.0], [7.0], [6.0]]):
        P = Polytope.from_points(points)
        assert P.is_bounded and P.contains(points).all()
    assert sorted(Polytope.from_points([[5.0], [7.0], [6.0]]).vertices().ravel()) == [5, 7]
    assert Polytope.from_points([[0.1, 0.7]] * 3).vertices().tolist() == [[0.1, 0.7]]
    rng = np.random.default_rng(0)
    for _ in range(5):
        points = np.ldexp(rng.normal(size=(8, 3)), rng.integers(-60, 61, 3))
        P = Polytope.from_points(points)
        assert P.is_bounded and P.contains(points).all() and len(P.H) >= 4


# -- volume --------------------------------------------------------------------------------------------


@units
@dimensions
def test_volume_is_that_of_qhull_and_follows_linear_maps(unit, n):
    rng = np.random.default_rng(n)
    P = random_set(rng, n, "fat", unit)
    size = 2.0 ** (unit * n)
    corners = np.array([*exact_corners(P)], float)
    assert P.volume() == pytest.approx(ConvexHull(corners / 2.0**unit).volume * size if n > 1 else np.ptp(corners))
    M = rng.normal(size=(n, n))
    assert P.map(M).volume() == pytest.approx(abs(np.linalg.det(M)) * P.volume())
    assert random_set(rng, n, "point", unit).volume() == 0
    assert n == 1 or random_set(rng, n, "flat", unit).volume() == 0


def test_volume_of_unbounded_sets_needles_and_boxes_far_away():
    assert Polytope([[1, 0]], [0]).volume() == np.inf and Polytope([[1, 0], [-1, 0]], [0, 0]).volume() == 0
    assert Polytope([[0, 0]], [0]).volume() == np.inf
    needle = Polytope(
        [[1, 1, 0], [-1, -1, 0], [1, -1, 0], [-1, 1, 0], [0, 0, 1], [0, 0, -1]], [2.0**-50, 0, 1, 0, 1, 0]
    )
    assert needle.volume() == pytest.approx(2.0**-51)
    far = 2.0**40
    assert Polytope.box([far, far], [far + 0.25, far + 0.5]).volume() == 0.125


# -- files ---------------------------------------------------------------------------------------------


@given(arrays(float, (5, 3), elements=st.floats(-1e300, 1e300)))
def test_dict_reads_back_to_the_same_bits(numbers):
    P = Polytope(numbers[:, :2], numbers[:, 2])
    Q = Polytope.from_dict(json.loads(json.dumps(P.to_dict())))
    assert Q.H.tobytes() == P.H.tobytes() and Q.h.tobytes() == P.h.tobytes()


# -- bad input ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Polytope(np.eye(2), [1.0, 2.0, 3.0]), ["H has 2 rows", "h has 3"]),
        (lambda: Polytope([[np.nan, 1]], [1.0]), ["H must be finite", "(0, 0)"]),
        (lambda: Polytope([[1.0, 1]], [np.inf]), ["h must be finite"]),
        (lambda: Polytope([1.0, 2.0], [1.0]), ["H must have 2 axes", "(2,)"]),
        (lambda: Polytope([["a", "b"]], [1.0]), ["H must be an array of numbers"]),
        (lambda: Polytope(np.zeros((1, 0)), [1.0]), ["no columns"]),
        (lambda: Polytope.box([0, 0], [1, -1]), ["lower must not exceed upper", "entry 1"]),
        (lambda: Polytope.box([0, 0], [1]), ["lower has 2", "upper has 1"]),
        (lambda: Polytope.box([0, 0], [1, 1]).support([[1, 2, 3]]), ["V has shape (1, 3)", "2"]),
        (lambda: Polytope.box([0, 0], [1, 1]).contains([1, 2, 3]), ["x has shape (3,)", "2"]),
        (lambda: Polytope.box([0, 0], [1, 1]).is_subset(Polytope.box([0], [1])), ["R^2", "R^1"]),
        (lambda: Polytope.box([0, 0], [1, 1]) & Polytope.box([0], [1]), ["R^2", "R^1"]),
        (lambda: Polytope.box([0], [1]).scale(0), ["s must be positive", "0"]),
        (lambda: Polytope([[1.0, 0]], [1.0]).vertices(), ["unbounded", "intersect"]),
        (lambda: Polytope([[1.0], [-1.0]], [0, -1.0]).sample(np.random.default_rng(0), 3), ["empty"]),
        (lambda: Polytope([[1.0]], [0]).sample(np.random.default_rng(0), 3), ["unbounded"]),
        (lambda: Polytope.from_points(np.zeros((0, 2))), ["points is empty"]),
        (lambda: Polytope.from_points([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.0]]), ["no volume", "R^3"]),
        (lambda: Polytope.box([0], [1]).sample(None, 3), ["rng", "Generator", "NoneType"]),
        (lambda: directions(2), ["at least 3", "2"]),
        (lambda: Polytope.box([0], [1]).sum([1]), ["Q must be", "Polytope", "list"]),
        (lambda: Polytope.box([0], [1]).sum(Polytope.box([0, 0], [1, 1])), ["R^1", "R^2", "Minkowski"]),
        (lambda: Polytope.box([0], [1]).erode(Polytope.box([0, 0], [1, 1])), ["R^1", "R^2", "Pontryagin"]),
        (lambda: Polytope.box([0], [1]).erode(Polytope([[1.0], [-1.0]], [0, -1])), ["Q is empty", "nonempty"]),
        (lambda: Polytope.box([0], [1]).equals(Polytope.box([0, 0], [1, 1])), ["R^1", "R^2"]),
        (lambda: Polytope.box([0], [1]).map([[1, 2]]), ["M has shape (1, 2)", "R^1", "(m, 1)"]),
        (lambda: Polytope.box([0], [1]).map([[1]], [1, 2]), ["t has 2", "M has 1"]),
        (lambda: Polytope.box([0], [1]).preimage([[1], [2]]), ["M has shape (2, 1)", "R^1", "(1, k)"]),
        (lambda: Polytope.box([0], [1]).preimage(np.zeros((1, 0))), ["M has shape (1, 0)"]),
        (lambda: Polytope.box([0, 0], [1, 1]).project([0, 2]), ["0 to 1", "[0, 2]"]),
        (lambda: Polytope.box([0, 0], [1, 1]).project([1, 1]), ["different", "[1, 1]"]),
        (lambda: Polytope.box([0, 0], [1, 1]).project([]), ["at least one", "[]"]),
        (lambda: Polytope.box([0, 0], [1, 1]).section([0, 2]), ["0 to 1", "[0, 2]"]),
        (lambda: Polytope.box([0, 0], [1, 1]).section([0], [1, 2, 3]), ["at has shape (3,)", "R^2"]),
    ],
)
def test_bad_arguments_are_named(make, words):
    with pytest.raises((TypeError, ValueError)) as error:
        make()
    assert all(word in str(error.value) for word in words), str(error.value)


def test_area_of_polygons_and_of_flat_and_empty_sets():
    assert Polytope.box([0, 1], [2, 4]).area == pytest.approx(6)
    assert Polytope.from_points([[0, 0], [2, 0], [0, 1]]).area == pytest.approx(1)
    assert Polytope.box([1, 1], [1, 5]).area == 0 and Polytope.box([1, 1], [1, 1]).area == 0
    assert Polytope([[1, 0], [-1, 0], [0, 1], [0, -1]], [0, -1, 1, 1]).area == 0
    with pytest.raises(ValueError, match="R\\^3"):
        _ = Polytope.box([0, 0, 0], [1, 1, 1]).area


def test_offsets_beyond_the_largest_float_do_not_shrink_a_set_in_other_units():
    P = Polytope([[1.0, 0.0]], [1e308]).in_units([2.0**-20, 1.0])  # x1' <= 2^20 1e308
    assert Fraction(P.h[0]) / Fraction(P.H[0, 0]) == Fraction(1e308) * 2**20
