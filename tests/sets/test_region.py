"""Regions: known areas, points by brute force, sums and erosions by their definitions."""

import json

import numpy as np
import pytest
import shapely

import mireach as mr
from mireach.arithmetic.rational import binary
from mireach.engines import exact_plane
from mireach.sets.geos import hulls

SQUARE, SMALL = mr.Polytope.box([0, 0], [4, 4]), mr.Polytope.box([1, 1], [3, 3])
TRIANGLE = mr.Polytope.from_points([[0.3, 0.1], [-0.2, 0.4], [0.0, -0.3]])


def random_region(rng, count=4):
    """A union of random triangles less one of them: holes, several components, nonconvex."""
    triangles = [rng.uniform(-3, 3, 2) + rng.uniform(-2, 2, (3, 2)) for _ in range(count)]
    return mr.Region.of(*triangles) - mr.Region.of(triangles[0] * 0.5)


def grid(reach=6, count=121):
    axis = np.linspace(-reach, reach, count)
    return np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)


def test_a_frame_has_a_hole_and_its_corners():
    frame = mr.Region.of(SQUARE) - SMALL
    assert (frame.area, frame.holes, frame.components) == (12, 1, 1)
    assert frame.contains([[0.5, 0.5], [2, 2], [1, 2], [4, 4], [4.1, 4]]).tolist() == [True, False, True, True, False]
    assert frame.contains([4.1, 4], tol=0.11)
    lower, upper = frame.bounding_box()
    assert (lower.tolist(), upper.tolist()) == ([0, 0], [4, 4])


@pytest.mark.parametrize("seed", range(5))
def test_set_operations_agree_with_points(seed):
    rng = np.random.default_rng(seed)
    P, Q, x = random_region(rng), random_region(rng), grid() + 1e-4 * np.sqrt(2)
    inside_p, inside_q = P.contains(x), Q.contains(x)
    np.testing.assert_array_equal((P | Q).contains(x), inside_p | inside_q)
    np.testing.assert_array_equal((P & Q).contains(x), inside_p & inside_q)
    np.testing.assert_array_equal((P - Q).contains(x), inside_p & ~inside_q)


@pytest.mark.parametrize("seed", range(5))
def test_pieces_are_convex_and_tile_the_region(seed):
    P = random_region(np.random.default_rng(seed))
    pieces = [P.pieces[i] for i in range(len(P.pieces))]
    assert sum(mr.Region.of(piece).area for piece in pieces) == pytest.approx(P.area, rel=1e-12)
    again = mr.Region.from_dict(P.to_dict())
    assert (again - P).area < 1e-12 and (P - again).area < 1e-12


@pytest.mark.parametrize("D", [TRIANGLE, SMALL.scale(0.1), mr.Polytope.box([0.5, 0.2], [0.5, 0.2])], ids=str)
@pytest.mark.parametrize("seed", range(3))
def test_sum_and_erosion_agree_with_their_definitions(seed, D):
    rng = np.random.default_rng(seed)
    P, x = random_region(rng), rng.uniform(-6, 6, (3000, 2))
    corners = D.vertices()
    weights = rng.dirichlet(np.ones(len(corners)), 200)
    d = np.vstack([corners, weights @ corners])
    backward = np.array([P.contains(x - one) for one in d])  # x is in P + D if x - d is in P for some d
    wide = P.sum(D)
    assert wide.contains(x[backward.any(axis=0)], tol=1e-9).all()
    forward = np.array([P.contains(x + one) for one in d])
    narrow = P.erode(D)
    assert not narrow.contains(x[~forward.all(axis=0)]).any()
    # what the samples of D cannot tell apart lies near the boundary
    assert (~backward.any(axis=0) & wide.contains(x)).mean() < 0.02
    assert (forward.all(axis=0) & ~narrow.contains(x)).mean() < 0.02


def test_known_sums_and_erosions():
    frame = mr.Region.of(SQUARE) - SMALL
    D = mr.Polytope.box([-0.25, -0.5], [0.25, 0.5])
    assert frame.sum(D).area == pytest.approx(4.5 * 5 - 1.5 * 1)
    assert frame.erode(D).area == pytest.approx(3.5 * 3 - 2.5 * 3)
    assert frame.erode(mr.Polytope.box([0, 0], [1.5, 0.0])).area == pytest.approx(2.5 * 2)
    assert frame.erode(SQUARE).is_empty


def test_segments_and_points_are_legitimate():
    flat = mr.Region.of([[0, 0], [1, 1]], [[2.0, 0.0]])
    assert flat.area == 0 and not flat.is_empty and flat.components == 2
    assert flat.contains([[0.5, 0.5], [2, 0], [1, 0]]).tolist() == [True, True, False]
    assert [len(flat.pieces[i]) for i in range(2)] == [2, 1]
    assert flat.sum(mr.Polytope.box([-0.5, -0.5], [0.5, 0.5])).area == pytest.approx(3 + 1 - 0.25 / 2, abs=0.2)
    assert flat.is_subset(SQUARE) and not flat.is_subset(SMALL)


def test_inclusion_with_and_without_tolerance():
    P = mr.Region.of(SMALL)
    assert P.is_subset(SQUARE) and not mr.Region.of(SQUARE).is_subset(P)
    wider = mr.Region.of(mr.Polytope.box([1, 1], [3.01, 3]))
    assert not wider.is_subset(P) and wider.is_subset(P, tol=0.0101)
    assert mr.Region.of().is_subset(P) and mr.Region.of().is_empty


def test_hulls_of_many_polygons_keep_their_order():
    P = random_region(np.random.default_rng(0))
    areas = [shape.area for shape in hulls(P.pieces)]
    np.testing.assert_allclose(areas, [mr.Region.of(P.pieces[i]).area for i in range(len(P.pieces))], rtol=1e-12)
    assert shapely.union_all(hulls(P.pieces)).area == pytest.approx(P.area)


def test_what_is_no_region_is_refused():
    with pytest.raises(ValueError, match="lies in R"):
        mr.Region.of(mr.Polytope.box([0, 0, 0], [1, 1, 1]))
    with pytest.raises(ValueError, match="unbounded"):
        mr.Region.of(mr.Polytope([[1.0, 0]], [1]))
    with pytest.raises(ValueError, match="needs the key pieces"):
        mr.Region.from_dict({})
    with pytest.raises(ValueError, match="region is empty"):
        mr.Region.of().bounding_box()
    with pytest.raises(ValueError, match="nonempty polytope of the plane"):
        mr.Region.of(SQUARE).sum(mr.Polytope([[1.0, 0], [-1, 0]], [-1, -1]))


def test_sum_with_and_erosion_by_a_segment_that_does_not_hold_the_origin():
    wide = mr.Region.of(mr.Polytope.box([0, 0], [1, 1])).sum(mr.Polytope.box([1, 0], [2, 0]))
    assert [limit.tolist() for limit in wide.bounding_box()] == [[1, 0], [3, 1]] and wide.area == pytest.approx(2)
    narrow = mr.Region.of(mr.Polytope.box([0, 0], [4, 1])).erode(mr.Polytope.box([1, 0], [2, 0]))
    assert [limit.tolist() for limit in narrow.bounding_box()] == [[-1, 0], [2, 1]]


def test_tolerance_of_the_point_test_is_what_it_says():
    square = mr.Region.of(mr.Polytope.box([0, 0], [1, 1]))
    assert square.contains([1.09, 0.5], tol=0.1) and not square.contains([1.15, 0.5], tol=0.1)


@pytest.mark.parametrize("seed", range(40))
def test_pieces_are_convex_beyond_rounding(seed):
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(2, 2))
    across, middle = np.array([-(b - a)[1], (b - a)[0]]), a + rng.uniform(0.2, 0.8) * (b - a)
    halves = shapely.Polygon([a, middle, a + across]), shapely.Polygon([middle, b, a + across])
    pieces = mr.Region(shapely.union_all(halves)).pieces
    for i in range(len(pieces)):
        assert len(exact_plane._hull([binary(x) for x in pieces[i]])) == len(pieces[i])


# -- the words of Polytope ----------------------------------------------------------------------------


def random_polygon(rng):
    return mr.Polytope.from_points(rng.uniform(-3, 3, (6, 2)))


@pytest.mark.parametrize("seed", range(4))
def test_a_region_of_one_piece_answers_as_the_polytope(seed):
    rng = np.random.default_rng(seed)
    P, Q, V = random_polygon(rng), mr.Polytope.box(-rng.random(2), rng.random(2)), rng.normal(size=(7, 2))
    R, M, t = mr.Region.of(P), rng.normal(size=(2, 2)), rng.normal(size=2)
    assert (R.dimension, R.is_bounded, R.is_empty) == (P.dimension, P.is_bounded, P.is_empty)
    np.testing.assert_allclose(R.support(V), P.support(V), rtol=0, atol=1e-13)
    np.testing.assert_allclose(np.array(R.bounding_box()), np.array(P.bounding_box()), rtol=0, atol=1e-13)
    assert R.area == pytest.approx(P.area) and R.convex_hull().is_subset(P, tol=1e-12)
    made = [
        (R.sum(Q), P.sum(Q)),
        (R.scale(9).erode(Q), P.scale(9).erode(Q)),
        (R.map(M, t), P.map(M, t)),
        (R.scale(0.3, t), P.scale(0.3, t)),
        (R & Q, P & Q),
    ]
    for region, polytope in made:
        assert region.equals(polytope, tol=1e-12) and not region.equals(polytope.scale(1.01), tol=1e-12)
        np.testing.assert_allclose(region.support(V), polytope.support(V), rtol=0, atol=1e-12)
    x = rng.uniform(-3, 3, (500, 2))
    assert (R.contains(x) == P.contains(x)).all() and R.is_subset(P.scale(1.1, P.chebyshev_centre()[0]))


@pytest.mark.parametrize("seed", range(4))
def test_images_of_regions_agree_with_points(seed):
    rng = np.random.default_rng(seed)
    R, M, t, x = random_region(rng), rng.normal(size=(2, 2)), rng.normal(size=2), grid(6, 61) + 1e-4 * np.sqrt(2)
    inside = R.contains(x)
    np.testing.assert_array_equal(R.map(M, t).contains(x @ M.T + t), inside)
    np.testing.assert_array_equal(R.scale(0.7, t).contains(t + 0.7 * (x - t)), inside)
    image = R.map(M, t)
    assert image.area == pytest.approx(abs(np.linalg.det(M)) * R.area)
    assert (image.holes, image.components) == (R.holes, R.components)
    flat = R.map([[1, 2], [2, 4]])  # of rank one: segments
    assert flat.area == 0 and flat.contains(x[inside] @ [[1, 2], [2, 4]], tol=1e-9).all()
    V = rng.normal(size=(5, 2))
    np.testing.assert_allclose(R.support(V), (R.pieces.points @ V.T).max(axis=0), atol=1e-12)


def test_empty_regions_have_the_answers_of_empty_sets():
    empty, box = mr.Region.of(), mr.Polytope.box([-1, -1], [1, 1])
    assert empty.support(np.eye(2)).tolist() == [-np.inf, -np.inf] and empty.area == 0 and len(empty.pieces) == 0
    for made in (empty.sum(box), empty.erode(box), empty.map(np.eye(2)), empty.scale(2), empty & box, empty - box):
        assert made.is_empty and made.equals(empty)
    assert empty.is_subset(box) and not mr.Region.of(box).is_subset(empty) and not empty.contains([0, 0])


def test_equal_regions_may_be_made_of_other_pieces():
    whole, halves = mr.Region.of(SQUARE), mr.Region.of(mr.Polytope.box([0, 0], [1, 4]), mr.Polytope.box([1, 0], [4, 4]))
    assert whole.equals(halves) and halves.equals(whole) and whole != halves
    frame = whole - SMALL
    assert not frame.equals(whole) and (frame | SMALL).equals(SQUARE)
    assert not whole.equals(mr.Polytope.box([0, 0], [4, np.nextafter(4, 5)]))
    assert whole.equals(mr.Polytope.box([0, 0], [4, 4.01]), tol=0.02)


@pytest.mark.parametrize("unit", [0, -40, 40])
def test_samples_are_uniform_over_the_parts_of_the_largest_dimension(unit):
    s = 2.0**unit
    frame = (mr.Region.of(SQUARE) - SMALL).scale(s)
    x = frame.sample(np.random.default_rng(0), 20_000) / s
    assert frame.scale(1 / s).contains(x, tol=1e-12).all()
    below = (x[:, 1] < 1).mean()  # a strip of area 4 of 12
    assert below == pytest.approx(4 / 12, abs=0.02) and (x[:, 0] > 3).mean() == pytest.approx(4 / 12, abs=0.02)
    lines = mr.Region.of([[0, 0], [s, 0]], [[5 * s, 0], [8 * s, 0]], [[0, 9 * s]])
    y = lines.sample(1, 10_000) / s
    assert (y[:, 1] == 0).all() and (y[:, 0] > 4).mean() == pytest.approx(3 / 4, abs=0.02)
    points = mr.Region.of([[s, s]], [[2 * s, s]]).sample(1, 1000) / s
    assert {*points[:, 0].tolist()} == {1, 2} and (points[:, 1] == 1).all()
    assert (frame.sample(3, 5) == frame.sample(np.random.default_rng(3), 5)).all() and frame.sample(3, 0).shape == (
        0,
        2,
    )


@pytest.mark.parametrize("seed", range(4))
def test_dict_reads_back_to_the_same_set(seed):
    rng = np.random.default_rng(seed)
    R = random_region(rng) | mr.Region.of([[9, 9], [9.1, 9.7]], [[1 / 3, 8]])
    again = mr.Region.from_dict(json.loads(json.dumps(R.to_dict())))
    assert again.equals(R) and (again.holes, again.components) == (R.holes, R.components)
    for corners in (R.pieces.points, again.pieces.points):
        assert {*map(tuple, corners.tolist())} == {*map(tuple, R.pieces.points.tolist())}
    assert mr.Region.from_dict(json.loads(json.dumps(mr.Region.of().to_dict()))).is_empty


@pytest.mark.parametrize(
    ("make", "error", "words"),
    [
        (lambda: mr.Region.of().sample(0, 1), ValueError, "empty"),
        (lambda: mr.Region.of().convex_hull(), ValueError, "empty"),
        (lambda: mr.Region.of(SQUARE).sample("0", 1), TypeError, "rng"),
        (lambda: mr.Region.of(SQUARE).support([[1, 2, 3]]), ValueError, "V has shape"),
        (lambda: mr.Region.of(SQUARE).map([[1, 2]]), ValueError, "shapes"),
        (lambda: mr.Region.of(SQUARE).scale(0), ValueError, "s must be positive"),
        (lambda: mr.Region.of(SQUARE).scale(1, [1, 2, 3]), ValueError, "centre has shape"),
        (lambda: mr.Region.of(SQUARE).sum([1]), TypeError, "Polytope"),
        (lambda: mr.Region("square"), TypeError, "shape"),
    ],
)
def test_bad_arguments_are_named(make, error, words):
    with pytest.raises(error, match=words):
        make()


# -- units --------------------------------------------------------------------------------------------


def operations(s, seed):
    """What the operations make of random regions in units of s (2,)."""
    rng = np.random.default_rng(seed)
    triangles = [s * (rng.uniform(-3, 3, 2) + rng.uniform(-2, 2, (3, 2))) for _ in range(6)]
    P, Q = mr.Region.of(*triangles[:3]) - mr.Region.of(triangles[0] * 0.5), mr.Region.of(*triangles[3:])
    D = mr.Polytope.box(-0.25 * s, 0.5 * s)
    return [P, P | Q, P & Q, P - Q, P.sum(D), P.erode(D), mr.Region.of(mr.Polytope.box(-s, s)), mr.Region.of(*P.pieces)]


@pytest.mark.parametrize("power", [(-300, -300), (-60, -60), (-34, -34), (60, 60), (300, 300), (60, -60), (0, 40)])
@pytest.mark.parametrize("seed", range(3))
def test_regions_are_the_same_in_all_units(seed, power):
    s, t = np.ldexp(1.0, power), np.ldexp(1.0, sum(power))
    for region, same in zip(operations(s, seed), operations(np.ones(2), seed)):
        assert region.area / t == pytest.approx(same.area, rel=1e-9, abs=1e-9)
        assert (region.components, region.holes) == (same.components, same.holes)
        x = grid(6, 31) + 1e-4 * np.sqrt(2)
        np.testing.assert_array_equal(region.contains(x * s), same.contains(x))


@pytest.mark.parametrize("size", [1e-200, 1e200])
def test_coordinates_that_cannot_be_multiplied_are_refused(size):
    with pytest.raises(ValueError, match="unit of length"):
        mr.Region.of(mr.Polytope.box([-size, -size], [size, size]))
