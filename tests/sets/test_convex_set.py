"""Support functions and decisions against scipy and fractions: linprog, and rational elimination."""

import pickle
from collections import Counter
from fractions import Fraction
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from loops import highest_vertex, largest
from polytopes import exactly, far_away, flat, fraction, nearly_flat, ordinary, polytopes, rows, whole_vector

from mireach import Polytope, directions
from mireach.arithmetic.rational import binary, maximize


def by_linprog(P, V):
    return np.array([largest(v, P.H, P.h) for v in V])


def rounded_up(value):
    """The smallest float that is not below a Fraction."""
    near = float(value)
    return near if Fraction(near) >= value else float(np.nextafter(near, np.inf))


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


# -- inclusion and equality ----------------------------------------------------------------------------


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


def test_equal_sets_may_have_other_rows():
    P = Polytope.box([0, 0], [1, 2])
    Q = Polytope(np.vstack([P.H[::-1] * 3, [[1, 1]]]), [*P.h[::-1] * 3, 3])
    assert P.equals(Q) and Q.equals(P) and P != Q and len({P, Q, P}) == 2
    assert not P.equals(Polytope.box([0, 0], [1, np.nextafter(2, 3)])) and not P.equals(Polytope.box([0, 0], [1, 1]))


# -- without rounding ---------------------------------------------------------------------------------


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
            assert len(P.vertices()) == 0 and radius <= 0 and P.support_vector(V[0]) is None
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


@pytest.mark.parametrize("n", [1, 2, 3, 5])
def test_a_box_in_any_rows_has_the_maxima_of_the_simplex_method(n):
    """Rows of any length, several along one axis, ends that are missing, boxes that are flat or empty."""
    rng, kinds = np.random.default_rng(n), Counter()
    for _ in range(80):
        count = int(rng.integers(n, 4 * n + 1))
        H = np.zeros((count, n))
        H[np.arange(count), rng.integers(0, n, count)] = rng.choice([-3.0, -1.0, 0.1, 7.0], count)
        P = Polytope(H, rng.choice([0.0, 0.3, 1.0, 2.0], count) - 0.2 * rng.integers(0, 2))
        for v in [*rng.integers(-1, 2, (4, n)).astype(float), np.zeros(n)]:
            best, right = P.exact_maximum(v), maximize(*P.exact, binary(v))
            assert best.value == right.value
            kinds[str(right.value) if right.point is None else "a point"] += 1
            if best.point is not None:
                assert P.exact_maximum(v).value == sum(a * x for a, x in zip(binary(v), best.point))
                assert all(sum(a * x for a, x in zip(row, best.point)) <= b for row, b in zip(*P.exact))
    assert min(kinds[kind] for kind in ("a point", "inf", "-inf")) >= 10


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
    assert not strip.is_bounded and not strip.is_empty and strip.support_vector(V[2]) is None
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


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("far", [1e19, 1e20, 1e21, 1e300])
def test_a_row_that_excludes_all_by_far_leaves_nothing(n, far):
    """HiGHS holds limits of 1e20 and more for infinite, so that it cannot be given such a row as it is."""
    cube = np.vstack([np.eye(n), -np.eye(n)])
    for row in (np.ones(n), np.zeros(n)):
        P = Polytope(np.vstack([cube, row]), [*np.ones(2 * n), -far])
        assert P.is_empty and P.is_bounded and (P.bound(cube) == -np.inf).all() and len(P.vertices()) == 0
    P = Polytope(np.vstack([np.eye(n), np.ones(n)]), [*np.ones(n), -far])  # unbounded, far away
    assert not P.is_empty and P.exact_maximum(np.ones(n)).value == int(-far)
