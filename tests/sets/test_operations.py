"""Sums, differences, images, preimages and projections against the vertices as fractions."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis.extra.numpy import arrays
from polytopes import exact_corners, exactly, fraction, polytopes, product, random_set, rows, small, whole_vector

from mireach import Polytope, Region, directions

kinds = pytest.mark.parametrize("kind", ["fat", "flat", "point"])
units = pytest.mark.parametrize("unit", [0, -40, 40])
dimensions = pytest.mark.parametrize("n", [1, 2, 3, 4])
empty_sets = [Polytope([[1.0, 0], [-1, 0]], [0, -1.0]), Polytope([[0.0, 0.0]], [-1.0])]


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


@kinds
@units
def test_section_fixes_the_other_coordinates(kind, unit):
    rng = np.random.default_rng(5)
    P = random_set(rng, 3, kind, unit)
    at = P.sample(rng, 1)[0] if kind == "fat" else P.vertices()[0]
    for axes in ([1], [2, 0], [0, 1, 2], [1, 2]):
        E = np.delete(np.eye(3), axes, axis=0)
        found = P.section(axes, at)
        assert found.is_empty == (P & Polytope([*E, *-E, [0, 0, 0]], [*E @ at, *-E @ at, 0])).is_empty
        y = np.tile(at, (50, 1))
        y[:, axes] += np.ldexp(rng.normal(size=(50, len(axes))), unit) * np.arange(50)[:, None]
        inside = P.contains(y)
        assert (found.contains(y[:, axes]) >= inside).all()
        if kind == "fat":
            assert inside[0] and (found.contains(y[:, axes]) == inside).all()


def test_sections_are_empty_exactly_where_no_point_has_these_coordinates():
    simplex = Polytope([[1, 1, 1], [-1, 0, 0], [0, -1, 0], [0, 0, -1]], [1, 0, 0, 0])
    assert simplex.section([0, 1], [9, 9, 1]).vertices().tolist() == [[0, 0]]
    assert simplex.section([0, 1], [9, 9, np.nextafter(1, 2)]).is_empty
    third = Polytope([[3, 0], [-3, 0], [0, 1], [0, -1]], [1, -1, 1, 1])  # x_1 = 1/3, which is no float
    assert third.section([1], 1 / 3).is_empty and third.section([0], 0.5).equals(Polytope([[3], [-3]], [1, -1]))
    tenths = Polytope([[1, 0.1], [-1, -0.1]], [0.3, -0.3])  # x_1 = 0.3 - 0.1 x_2, no float for x_2 = 3 either
    lower, upper = tenths.section([0], 3).bounding_box()
    assert lower <= upper and upper - lower < 1e-15
    assert simplex.section([2, 0, 1]).equals(Polytope(simplex.H[:, [2, 0, 1]], simplex.h))
    half_space = Polytope([[1, 1, 0]], [1])
    assert not half_space.section([2], [0.5, 0.5, 0]).is_bounded and half_space.section([2], [1, 1, 0]).is_empty
    assert Polytope([[0, 0, 0]], [-1]).section([1]).is_empty
