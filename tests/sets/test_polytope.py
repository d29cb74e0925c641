"""Polytopes against scipy and fractions: supports by linprog, vertices by qhull, decisions by rational elimination."""

import json
import pickle
from fractions import Fraction
from itertools import combinations, permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from loops import highest_vertex, largest, solve_exactly
from scipy.spatial import ConvexHull, HalfspaceIntersection

from mireach import Polytope, Region, box_directions, directions

small = st.floats(-5, 5, allow_subnormal=False)
points = arrays(float, st.tuples(st.integers(3, 12), st.just(2)), elements=st.integers(-40, 40).map(lambda k: k / 8))
rows = arrays(float, (4, 2), elements=small)


@st.composite
def polytopes(draw, n=2):
    """Nonempty bounded sets: a box of any size, cut by random rows that keep its middle."""
    rng = np.random.default_rng(draw(st.integers(0, 10**6)))
    middle, reach = rng.uniform(-3, 3, n), rng.uniform(0.2, 3, n)
    H = rng.normal(size=(draw(st.integers(0, 4)), n))
    return Polytope.box(middle - reach, middle + reach) & Polytope(H, H @ middle + rng.uniform(0, 2, len(H)))


def by_linprog(P, V):
    return np.array([largest(v, P.H, P.h) for v in V])


# -- support ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_support_is_the_optimum_of_a_linear_program(n):
    rng = np.random.default_rng(n)
    for _ in range(8):
        H = np.vstack([np.eye(n), -np.eye(n), rng.normal(size=(5, n))])
        P = Polytope(H, rng.uniform(0, 3, len(H)))
        V = rng.normal(size=(6, n))
        np.testing.assert_allclose(P.support(V), by_linprog(P, V), rtol=0, atol=1e-8)


def test_support_of_unbounded_and_empty_sets():
    half_plane = Polytope([[1.0, 0.0]], [2.0])
    assert half_plane.support([[1, 0], [-1, 0], [0, 1]]).tolist() == [2.0, np.inf, np.inf]
    assert not half_plane.is_bounded and not half_plane.is_empty
    empty = Polytope([[1.0, 0.0], [-1.0, 0.0]], [0.0, -1.0])
    assert empty.is_empty and empty.is_bounded and len(empty.vertices()) == 0
    assert (empty.support(directions(5)) == -np.inf).all()
    assert empty.is_subset(Polytope.box([9, 9], [9, 9]))
    assert Polytope([[0.0, 0.0]], [-1.0]).is_empty and not Polytope([[0.0, 0.0]], [1.0]).is_empty


@given(polytopes(), rows)
def test_support_is_subadditive_and_positively_homogeneous(P, V):
    a, b = P.support(V[:2]), P.support(V[2:])
    assert (P.support(V[:2] + V[2:]) <= a + b + 1e-9).all()
    np.testing.assert_allclose(P.support(3.5 * V[:2]), 3.5 * a, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("far", [1e3, 1e9, 1e12])
def test_redundant_row_far_away_does_not_blur_a_small_set(far):
    small_box = Polytope.box([-1e-4, -1e-4], [1e-4, 2e-4])
    P = small_box & Polytope([[0.6, 0.8]], [far])
    assert len(P.vertices()) == 4
    np.testing.assert_allclose(P.support(directions(8)), small_box.support(directions(8)), rtol=1e-9)


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


@pytest.mark.parametrize("n", [2, 3])
def test_rows_of_zeros_say_nothing_about_x(n):
    """0 x <= b holds everywhere for b >= 0 and nowhere for b < 0, whatever else the set is."""
    rng = np.random.default_rng(n)
    for b in (0.0, 5e-324, 1e-13, 1.0):
        for _ in range(20):
            H, h = rng.integers(-3, 4, (6, n)), rng.integers(0, 3, 6)
            P = Polytope(np.vstack([H, np.eye(n), -np.eye(n)]), np.concatenate([h, np.full(2 * n, 4)]))
            Q = Polytope(np.vstack([np.zeros(n), P.H]), np.concatenate([[b], P.h]))
            V = rng.integers(-3, 4, (5, n))
            assert Q.equals(P) and not Q.is_empty and Q.contains(P.vertices(), tol=1e-9).all()
            assert [Q.exact_maximum(v).value for v in V] == [P.exact_maximum(v).value for v in V]
            np.testing.assert_allclose([Q.support(V), Q.bound(V)], [P.support(V)] * 2, atol=1e-12)
            assert Q.is_subset(P.scale(2)) == P.is_subset(P.scale(2))
            assert Polytope(Q.H, np.concatenate([[-b or -1e-300], P.h])).is_empty


# -- inclusion, intersection, scaling -----------------------------------------------------------------


@given(polytopes(), polytopes(), st.integers(0, 10**6))
def test_intersection_holds_exactly_what_both_hold(P, Q, seed):
    x = np.random.default_rng(seed).uniform(-5, 5, (50, 2))
    both = P & Q
    assert (both.contains(x) == (P.contains(x) & Q.contains(x))).all()
    assert both.is_subset(P) and both.is_subset(Q)


@given(polytopes())
def test_every_set_lies_in_itself_without_tolerance(P):
    assert P.is_subset(P) and (P & P).is_subset(P) and P.is_subset(P & P)
    assert P.is_subset(P.scale(1.5, P.chebyshev()[0])) and not P.scale(1.5, P.chebyshev()[0]).is_subset(P)


@given(polytopes(), polytopes())
def test_inclusion_is_inclusion_of_all_vertices(P, Q):
    reached = P.vertices() @ Q.H.T
    excess = (reached - Q.h).max()
    if abs(excess) > 1e-7:
        assert P.is_subset(Q) == (excess < 0)
    share = ((reached - Q.h).max(axis=0) / np.abs(reached).max(axis=0)).max()
    if share > 1e-7:
        assert P.is_subset(Q, tol=share + 1e-9) and not P.is_subset(Q, tol=share - 1e-9)


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


# -- without rounding ---------------------------------------------------------------------------------


def exactly(numbers):
    """Floats, or rows of them, as Fractions."""
    return [exactly(one) if np.ndim(one) else Fraction(one) for one in np.asarray(numbers, float).tolist()]


def rounded_up(value):
    """The smallest float that is not below a Fraction."""
    near = float(value)
    return near if Fraction(near) >= value else float(np.nextafter(near, np.inf))


def fraction(value):
    return Fraction(int(value.p), int(value.q))


def whole_vector(rng, n, reach=1000):
    return rng.integers(-reach, reach, n).astype(float)


def flat(rng, n):
    """A set around a point of whole numbers, of which one to n equalities in whole numbers hold."""
    x, E = whole_vector(rng, n), np.array([whole_vector(rng, n) for _ in range(rng.integers(1, n + 1))])
    box = np.vstack([np.eye(n), -np.eye(n)])
    return np.vstack([E, -E, box]), np.concatenate([E @ x, -E @ x, x + 1, 1 - x])


def nearly_flat(rng, n):
    """Rows that nearly oppose each other, at a distance that may be zero or negative."""
    a, width = rng.normal(size=n), 10.0 ** -rng.integers(3, 17)
    H = np.vstack([a + width * rng.normal(size=n), -a, -a + width * rng.normal(size=n), np.eye(n), -np.eye(n)])
    return H, np.concatenate([[width, 0, width * rng.normal()], np.full(2 * n, 1000.0)])


def far_away(rng, n):
    """A box, some of whose sides have no length, far from the origin for its size."""
    x, reach = whole_vector(rng, n), rng.integers(0, 3, n) * 10.0 ** -rng.integers(0, 8)
    return np.vstack([np.eye(n), -np.eye(n)]), np.concatenate([x + reach, reach - x])


def ordinary(rng, n):
    """Random rows around or near the origin; often empty."""
    H = np.vstack([np.eye(n), -np.eye(n), rng.normal(size=(3, n))])
    return H, rng.normal(size=len(H)) + 0.7


def in_other_units(rng, H, h):
    """The rows times positive factors, the coordinates times powers of two: H, h and the exponents."""
    factors = [np.ones(len(h)), 2.0 ** rng.integers(-900, 900, len(h)), 10.0 ** rng.uniform(-280, 280, len(h))]
    s, e = factors[rng.integers(3)], rng.integers(-60, 61, H.shape[1])
    return np.ldexp(H, -e) * s[:, None], h * s, e


@pytest.mark.parametrize("make", [flat, nearly_flat, far_away, ordinary])
@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_every_decision_is_that_of_rational_elimination(make, n):
    rng = np.random.default_rng(n)
    for _ in range((8, 8, 3, 1)[n - 1]):
        H, h, e = in_other_units(rng, *make(rng, n))
        P, V = Polytope(H, h), np.vstack([np.ldexp(whole_vector(rng, n, 4), -e), H[:1], np.zeros((1, n))])
        right = [highest_vertex(exactly(H), exactly(h), exactly(v)) for v in V]
        support, bound, radius = P.support(V), P.bound(V), P.chebyshev()[1]
        assert P.is_bounded and P.is_empty == (right[0] is None)
        if P.is_empty:
            assert (support == -np.inf).all() and (bound == -np.inf).all() and P.point is None
            assert len(P.vertices()) == 0 and radius <= 0 and P.farthest(V[0]) is None
            continue
        assert radius >= 0 and len(P.vertices()) and bound[1] <= h[0]
        x = [fraction(entry) for entry in P.point]
        assert all(sum(a * y for a, y in zip(row, x)) <= b for row, b in zip(exactly(H), exactly(h)))
        lower, upper = P.bounding_box()
        reach = np.abs(V) @ np.maximum(np.abs(lower), np.abs(upper))
        for v, value, one, above, size in zip(V, right, support, bound, reach):
            assert fraction(P.exact_maximum(v).value) == value
            assert value <= Fraction(above) <= value + Fraction(1e-10 * size)
            assert abs(one - float(value)) <= 1e-13 * size
            least = rounded_up(value)
            assert P.is_subset(Polytope([v], [least]))
            assert not P.is_subset(Polytope([v], [float(np.nextafter(least, -np.inf))]))


def test_a_vertex_on_a_row_without_offset_is_found():
    """A segment that ends on -x1 <= 0, where the float candidate has x1 = 4e-16 instead of 0."""
    P = Polytope([[3, 5], [-3, -5], [1, 0], [0, 1], [-1, 0], [0, -1]], [13, -13, 3, 4, 0, -1])
    assert P.exact_maximum([2, 5]).value == 13 and not P.is_subset(Polytope([[2, 5]], [12]))


@pytest.mark.parametrize("n, count", [(2, 400), (3, 60)])
def test_maxima_over_flat_sets_with_rows_without_offset(n, count):
    rng = np.random.default_rng(n)
    for _ in range(count):
        a, x = whole_vector(rng, n, 5), whole_vector(rng, n, 5)
        H = np.vstack([a, -a, np.eye(n), -np.eye(n)])
        h = np.concatenate([[a @ x, -a @ x], (x + rng.integers(0, 3, n)).clip(0), (rng.integers(0, 3, n) - x).clip(0)])
        P = Polytope(H, h)
        corners = [exactly(corner) for corner in P.vertices()]
        for v in rng.integers(-5, 6, (3, n)).astype(float):
            right = highest_vertex(exactly(H), exactly(h), exactly(v))
            assert fraction(P.exact_maximum(v).value) == right
            highest = max(sum(b * y for b, y in zip(exactly(v), corner)) for corner in corners)
            assert abs(highest - right) <= 1e-12


@pytest.mark.parametrize("make", [flat, nearly_flat, far_away, ordinary])
@pytest.mark.parametrize("n", [1, 2, 3])
def test_vertices_move_with_the_units(make, n):
    rng = np.random.default_rng(10 + n)
    for _ in range(10):
        H, h = make(rng, n)
        e, s = rng.integers(-60, 61, n), 2.0 ** rng.integers(-300, 300, len(h))
        P, Q = Polytope(H, h), Polytope(np.ldexp(H, -e) * s[:, None], h * s)
        np.testing.assert_array_equal(Q.vertices(), np.ldexp(P.vertices(), e))


def test_inclusion_sees_the_last_bit():
    rng = np.random.default_rng(0)
    for _ in range(40):
        P = Polytope(directions(8), 1 + rng.random(8))
        v = rng.normal(size=(1, 2))
        right = highest_vertex(exactly(P.H), exactly(P.h), exactly(v[0]))
        least = rounded_up(right)
        assert P.bound(v)[0] >= least and P.bound(v)[0] <= least + 1e-13
        assert P.is_subset(Polytope(v, [least])) and not P.is_subset(Polytope(v, [np.nextafter(least, -9)]))


def test_of_rows_of_one_direction_the_smallest_offset_counts_in_any_order():
    """x1 <= 1, 2 x1 <= 1 and x1 / 2 <= 2 are one row of three lengths; the second is the one that holds."""
    rows = [([1.0, 0], 1.0), ([2.0, 0], 1.0), ([0.5, 0], 2.0)]
    for order in permutations(rows):
        P = Polytope([*(a for a, _ in order), [-1.0, 0], [0, 1], [0, -1]], [*(b for _, b in order), 1.0, 1, 1])
        V = np.array([[1.0, 0], [4, 0], [0.25, 0], [-2, 0], [1, 1]])
        assert P.offsets(V).tolist() == [0.5, 2, 0.125, 2, np.inf]
        assert P.bound(V[:4]).tolist() == [0.5, 2, 0.125, 2]


def test_unbounded_sets_have_bounds_where_they_are_bounded():
    strip = Polytope([[827.0, 485, -851], [-827, -485, 851]], [3.0, -3.0])
    V = np.array([[827.0, 485, -851], [-1654, -970, 1702], [1, 0, 0]])
    assert strip.bound(V).tolist() == strip.support(V).tolist() == [3, -6, np.inf]
    assert not strip.is_bounded and not strip.is_empty and strip.farthest(V[2]) is None
    assert strip.is_subset(Polytope(V[:1], [3.0])) and not strip.is_subset(Polytope(V[2:], [1e300]), tol=1)


def test_membership_sees_the_last_bit():
    P = Polytope([[3.0, 1.0]], [1.0])
    x = np.array([[1 / 3, 0.0], [np.nextafter(1 / 3, 1), 0.0], [1 / 3, 2.0**-60], [np.nan, 0.0], [-np.inf, 0.0]])
    assert P.contains(x).tolist() == [True, False, True, False, False]
    assert P.contains(x[1], tol=1e-15) and not P.contains(x[1])
    square = Polytope.box([0, 0], [1, 1])
    assert square.contains([1.5, 1], tol=np.array([0.5, 0, 0, 0])) and not square.contains([1, 1.5], tol=[0.5, 0, 0, 0])
    large = Polytope([[1e300, 1e300]], [0.0])
    assert large.contains([1e10, -1e10]) and not large.contains([1e10, -np.nextafter(1e10, 0)])
    assert P.contains(np.zeros((2, 3, 2))).shape == (2, 3) and P.contains(np.zeros((0, 2))).shape == (0,)


def test_a_set_with_its_caches_can_be_pickled():
    for P in (Polytope.box([0, 0], [1, 1]), Polytope.box([0, 0, 0], [0, 1, 1])):
        P.vertices(), P.bound(np.eye(P.dimension)), P.is_empty, P.is_bounded
        Q = pickle.loads(pickle.dumps(P))
        assert (Q.H == P.H).all() and (Q.vertices() == P.vertices()).all()


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


# -- sums, differences, images ------------------------------------------------------------------------

kinds = pytest.mark.parametrize("kind", ["fat", "flat", "point"])
units = pytest.mark.parametrize("unit", [0, -40, 40])
dimensions = pytest.mark.parametrize("n", [1, 2, 3, 4])
empty_sets = [Polytope([[1.0, 0], [-1, 0]], [0, -1.0]), Polytope([[0.0, 0.0]], [-1.0])]


def random_set(rng, n, kind, unit=0):
    """A bounded set of R^n in units of 2^unit: with an interior, flat, or a point."""
    if kind == "fat":
        H = np.vstack([np.eye(n), -np.eye(n), rng.normal(size=(2, n))])
        h = rng.uniform(0.5, 2, len(H))
    elif kind == "flat":  # one equality, in whole numbers
        a, x = whole_vector(rng, n, 5), whole_vector(rng, n, 5)
        H, h = np.vstack([a, -a, np.eye(n), -np.eye(n)]), np.concatenate([[a @ x, -a @ x], x + 1, 1 - x])
    else:
        x = whole_vector(rng, n, 5)
        H, h = np.vstack([np.eye(n), -np.eye(n)]), np.concatenate([x, -x])
    return Polytope(H, np.ldexp(h, unit))


def exact_corners(P):
    """The vertices of P as Fractions, from all n rows at a time."""
    H, h = exactly(P.H), exactly(P.h)
    met = (solve_exactly([H[i] for i in rows], [h[i] for i in rows]) for rows in combinations(range(len(h)), len(H[0])))
    return {tuple(x) for x in met if x is not None and all(product(a, x) <= b for a, b in zip(H, h))}


def product(a, x):
    return sum(left * right for left, right in zip(a, x))


def highest(v, corners):
    """The support function of the hull of corners, exactly."""
    return max(product(v, x) for x in corners)


def mapped(M, t, corners):
    """The images of corners, exactly."""
    M, t = exactly(M), exactly(t)
    return {tuple(product(a, x) + b for a, b in zip(M, t)) for x in corners}


def require_hull(found, corners, rng, unit):
    """`found` holds every corner without exception, and exceeds their hull by rounding alone, in units of 2^unit."""
    for v, b in zip(exactly(found.H), exactly(found.h)):
        assert highest(v, corners) <= b
    V = np.vstack([rng.normal(size=(6, found.dimension)), np.eye(found.dimension)])
    expected = (V @ np.array([*corners], float).T).max(axis=1)
    np.testing.assert_allclose(np.ldexp(found.support(V) - expected, -unit), 0, atol=1e-11)


@kinds
@units
@dimensions
def test_sum_is_the_hull_of_all_sums_of_two_vertices(kind, unit, n):
    rng = np.random.default_rng(n)
    P, Q = random_set(rng, n, "fat" if n < 4 else "flat", unit), random_set(rng, n, kind, unit)
    for one, other in ((P, Q), (Q, Q)) if n < 4 else ((Q, Q),):
        sums = {tuple(map(sum, zip(p, q))) for p in exact_corners(one) for q in exact_corners(other)}
        require_hull(one.sum(other), sums, rng, unit)


@given(polytopes(), polytopes(), rows)
def test_support_of_a_sum_is_the_sum_of_the_supports(P, Q, V):
    np.testing.assert_allclose(P.sum(Q).support(V), P.support(V) + Q.support(V), rtol=1e-12, atol=1e-12)
    assert Q.sum(P).equals(P.sum(Q))


@kinds
@units
@dimensions
def test_erosion_has_the_largest_offsets_that_are_not_above_the_difference(kind, unit, n):
    rng = np.random.default_rng(n)
    P, Q = random_set(rng, n, "fat", unit), random_set(rng, n, kind, unit)
    corners = exact_corners(Q)
    for v, b, found in zip(exactly(P.H), exactly(P.h), P.erode(Q).h):
        assert Fraction(found) <= b - highest(v, corners) < Fraction(np.nextafter(found, np.inf))


@given(polytopes(), polytopes())
def test_what_is_added_to_a_set_can_be_eroded_again(P, Q):
    P = P.scale(4, P.chebyshev_centre()[0])
    back = P.sum(Q).erode(Q)
    np.testing.assert_allclose(back.support(directions(16)), P.support(directions(16)), rtol=0, atol=1e-10)
    smaller = P.erode(Q)
    assert smaller.is_empty or smaller.sum(Q).is_subset(P, tol=1e-13)


def test_polytopes_and_regions_have_the_same_sums_and_differences():
    rng = np.random.default_rng(0)
    for kind in ("fat", "flat", "point"):
        P, Q = random_set(rng, 2, "fat").scale(9), random_set(rng, 2, kind)
        R = Region.of(P)
        assert R.sum(Q).area == pytest.approx(P.sum(Q).area) and R.erode(Q).area == pytest.approx(P.erode(Q).area)


@kinds
@units
@pytest.mark.parametrize("sizes", [(1, 1), (2, 2), (3, 3), (1, 3), (2, 3), (3, 2), (2, 4), (4, 1)], ids=str)
def test_image_is_the_hull_of_the_images_of_the_vertices(kind, unit, sizes):
    rng = np.random.default_rng(sizes)
    P, t = random_set(rng, sizes[1], kind, unit), np.ldexp(rng.normal(size=sizes[0]), unit)
    one, other = rng.integers(-5, 6, (sizes[0], 1)), rng.integers(1, 6, (1, sizes[1]))
    nearly = one / 3 @ (other / 7)  # of rank one but for rounding
    for M in (rng.normal(size=sizes), one @ other, nearly, np.zeros(sizes)):
        require_hull(P.map(M, t), mapped(M, t, exact_corners(P)), rng, unit)


@given(polytopes(), arrays(float, (3, 2), elements=small), rows)
def test_support_of_an_image_is_that_along_the_transposed_map(P, M, V):
    V = np.column_stack([V, V[:, 0]])
    np.testing.assert_allclose(P.map(M).support(V), P.support(V @ M), rtol=1e-11, atol=1e-11)


@units
@pytest.mark.parametrize(("n", "k"), [(1, 1), (2, 2), (3, 3), (2, 3), (3, 2), (4, 1)])
def test_preimage_holds_what_is_mapped_into_the_set(unit, n, k):
    rng, counts = np.random.default_rng(n), np.zeros(2, int)
    for _ in range(5):
        M, t = rng.integers(-4, 5, (n, k)).astype(float), np.ldexp(whole_vector(rng, n, 3), unit)
        H = np.vstack([np.eye(n), -np.eye(n), rng.integers(-9, 10, (3, n))])
        P = Polytope(H, np.ldexp(rng.integers(0, 20.0, len(H)), unit))
        x = np.ldexp(rng.integers(-9, 10, (60, k)).astype(float), unit - 1)
        inside = P.contains(x @ M.T + t)  # whole and half units: no product is rounded
        assert (P.preimage(M, t).contains(x) == inside).all() and len(P.preimage(M, t).h) == len(P.h)
        counts += [inside.sum(), (~inside).sum()]
    assert (counts > 0).all()


@given(polytopes(), arrays(float, (2, 2), elements=small))
def test_preimage_of_the_image_is_the_set(P, M):
    if np.linalg.cond(M) < 1e4:
        back = P.map(M, [1, 2]).preimage(M, [1, 2])
        np.testing.assert_allclose(back.support(directions(8)), P.support(directions(8)), rtol=0, atol=1e-9)


@kinds
@units
def test_projection_drops_coordinates(kind, unit):
    rng = np.random.default_rng(4)
    P = random_set(rng, 3, kind, unit)
    for axes in ([1], [2, 0], [0, 1, 2], (1, 2)):
        require_hull(P.project(axes), {tuple(x[i] for i in axes) for x in exact_corners(P)}, rng, unit)


@units
def test_unbounded_sets_can_be_added_mapped_and_projected(unit):
    size = 2.0**unit
    half, strip = Polytope([[1, 0]], [size]), Polytope([[1, 1], [-1, -1]], [size, size])
    assert half.sum(strip).equals(Polytope([[0, 0]], [1])) and half.sum(half).equals(half.scale(2))
    assert strip.sum(strip).equals(strip.scale(2)) and strip.map(np.diag([2.0, 0.5])).contains([2 * size, -size / 2])
    assert strip.map([[1, 1]]).equals(Polytope.box([-size], [size])) and not strip.project([0]).is_bounded
    assert strip.erode(half).is_empty and half.erode(Polytope([[1, 0]], [0])).equals(half)
    cylinder = Polytope([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]], [size, 0, size, 0])
    square = Polytope.box([0, 0], [size, size])
    assert cylinder.project([0, 1]).equals(square) and cylinder.project([1]).equals(Polytope.box([0], [size]))
    assert cylinder.project([1, 2]).equals(Polytope([[1, 0], [-1, 0]], [size, 0]))
    cone = Polytope([[1, 0, -1], [-1, 0, -1], [0, 1, -1], [0, -1, -1]], np.zeros(4))  # |x1|, |x2| <= x3
    lifted = cone.sum(Polytope.from_points(np.ldexp([[0.0, 0, 1], [0, 0, 2], [1, 0, 1], [0, 1, 1]], unit)))
    V = np.array([[0, 0, -1.0], [1, 0, -1], [0, 1, -1], [-1, 0, -1], [1, 0, 0]])
    np.testing.assert_allclose(lifted.support(V) / size, [-1, 0, 0, -1, np.inf], atol=1e-14)
    turned = cone.map([[3, 1, 0], [1, 3, 0], [0, 0, 2]], [0, 0, size])
    x = size * np.array([[0, 0, 1], [4, 4, 3], [2, -2, 3], [4, 4, 2.9], [2, -2, 2.9]])
    assert turned.contains(x).tolist() == [True, True, True, False, False]


@pytest.mark.parametrize("seed", range(30))
def test_images_of_unbounded_sets_hold_the_images_of_their_points(seed):
    """Rows of the image are rounded: opposite ones must not exclude each other, as those of a half-line could."""
    rng = np.random.default_rng(seed)
    n, m = rng.integers(1, 4, 2)
    rays = rng.integers(-2, 3, (rng.integers(1, n + 1), n)).astype(float)  # a cone, a half-line, or a whole subspace
    P = Polytope(
        np.vstack([rays, -rays[:-1]]), np.concatenate([rng.integers(1, 4, len(rays)), np.zeros(len(rays) - 1)])
    )
    M, start = rng.normal(size=(m, n)), np.array([float(fraction(entry)) for entry in P.point])
    image = P.map(M)
    ways = rng.normal(size=(40, n)) * 10
    x = start + ways[(ways @ P.H.T <= 1e-12).all(axis=1)]
    assert not image.is_empty and not P.is_bounded
    assert image.contains(np.vstack([start, x]) @ M.T, tol=1e-11).all()


def test_half_lines_have_images():
    half_line = Polytope([[-1.0]], [-1.0])  # x >= 1
    for M in ([[1.3841972532088773], [-1.1056865405274372], [-1.0367950361177776]], [[0.1], [0.7]]):
        image = half_line.map(M)
        assert not image.is_empty and image.contains(np.outer([1, 2, 9], M), tol=1e-12).all()
        assert not image.contains(np.outer([0.99, 0], M), tol=1e-12).any()


def test_offsets_beyond_the_range_of_floats():
    large = Polytope.box([0, 0], [1.5e308, 1])
    both = large.sum(large)  # no float is an offset along (1, 0)
    assert both.contains([[1.7e308, 2], [0, 0]]).all() and not both.contains([[0, 2.1], [-0.1, 0]]).any()
    assert Polytope.box([0, 0], [1, 1]).erode(large).is_empty
    assert Polytope([[1.0], [-1.0]], [-1e308, 1.5e308]).erode(Polytope.box([1e308], [1.2e308])).is_empty


@pytest.mark.parametrize("powers", [(-600, 500), (600, -500), (0, 900), (0, -1000)])
def test_images_in_extreme_units(powers):
    rows, gain = np.ldexp(1.0, powers)
    rng = np.random.default_rng(0)
    P, M = random_set(rng, 2, "fat"), rng.normal(size=(2, 2))
    image, same = Polytope(P.H * rows, P.h * rows).map(M * gain), P.map(M)
    np.testing.assert_allclose(image.support(directions(7)) / gain, same.support(directions(7)), rtol=1e-12)


def test_empty_sets_stay_empty():
    square = Polytope.box([0, 0], [1, 1])
    for P in empty_sets:
        made = [P.sum(square), square.sum(P), P.erode(square), P.map(np.eye(3, 2)), P.map([[1, 2]]), P.project([1])]
        assert all(Q.is_empty for Q in [*made, P.preimage(np.eye(2, 3))])
        assert [Q.dimension for Q in made] == [2, 2, 2, 3, 1, 1] and P.volume() == 0
        assert P.equals(empty_sets[0]) and not P.equals(square) and len(made[3].vertices()) == 0
    assert square.erode(Polytope.box([0, 0], [2, 0])).is_empty


def test_equal_sets_may_have_other_rows():
    P = Polytope.box([0, 0], [1, 2])
    Q = Polytope(np.vstack([P.H[::-1] * 3, [[1, 1]]]), [*P.h[::-1] * 3, 3])
    assert P.equals(Q) and Q.equals(P) and P != Q and len({P, Q, P}) == 2
    assert not P.equals(Polytope.box([0, 0], [1, np.nextafter(2, 3)])) and not P.equals(Polytope.box([0, 0], [1, 1]))


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


# -- files and templates ------------------------------------------------------------------------------


@given(arrays(float, (5, 3), elements=st.floats(-1e300, 1e300)))
def test_dict_reads_back_to_the_same_bits(numbers):
    P = Polytope(numbers[:, :2], numbers[:, 2])
    Q = Polytope.from_dict(json.loads(json.dumps(P.to_dict())))
    assert Q.H.tobytes() == P.H.tobytes() and Q.h.tobytes() == P.h.tobytes()


def test_directions_are_unit_rows_with_exact_axes():
    C = directions(8)
    np.testing.assert_allclose(np.linalg.norm(C, axis=1), 1)
    assert C[[0, 2, 4, 6]].tolist() == [[1, 0], [0, 1], [-1, 0], [0, -1]]
    assert box_directions(2).tolist() == [[1, 0], [0, 1], [-1, 0], [0, -1]]


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
