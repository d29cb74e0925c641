"""Regions: finite unions of polygons, segments and points in the plane."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely

from ..checks import real_array, require_columns, require_kind
from .polygons import Polygons
from .polytope import Polytope

GRID = 1e-13  # of the grid that makes an operation of GEOS sturdy, relative to the largest coordinate: its rounding
FAR = 16  # exponent of coordinates that are brought near 1 before GEOS multiplies them
APART = 16  # exponent of the ratio of two coordinates beyond which one grid does not suit both
LARGEST = 2.0**400  # coordinates whose products GEOS can form
CERTAIN = 2.0**-50  # a turn is certain beyond this share of its two products, whose differences and products round


@dataclass(frozen=True, eq=False)
class Region:
    """A closed set of the plane: polygons, which may have holes, segments and points, finitely many of them.

    Parameters
    ----------
    shape : shapely geometry
        `Region.of` makes it from polytopes or from corners.

    Notes
    -----
    shapely (GEOS) computes in floating point: corners that an operation makes are off by rounding, about
    1e-12 of the largest coordinate. Sets stay closed: a difference is the closure of the difference. What
    has to be proven about a region is proven about its `pieces`, whose corners are the floats they are.

    Examples
    --------
    >>> frame = Region.of(Polytope.box([0, 0], [3, 3])) - Polytope.box([1, 1], [2, 2])
    >>> frame.area, frame.erode(Polytope.box([-0.25, -0.25], [0.25, 0.25])).area
    (8.0, 4.0)
    """

    shape: shapely.Geometry

    def __post_init__(self):
        require_kind(self.shape, shapely.Geometry, "shape")
        if not np.isfinite(shapely.get_coordinates(self.shape)).all():
            raise ValueError("shape holds coordinates that are not finite; a region is bounded")
        _require_size(shapely.get_coordinates(self.shape))

    def __repr__(self):
        return f"Region(area {self.area:.6g}, {self.components} components)"

    # -- making -----------------------------------------------------------------------------------

    @staticmethod
    def of(*parts):
        """The union of parts, each a Region, a bounded Polytope, or the corners (v, 2) of a convex polygon.

        Raises
        ------
        ValueError
            If a part is unbounded or does not lie in the plane; the message gives its size.
        """
        return Region(overlay(shapely.union_all, [_shape(part) for part in parts]))

    @staticmethod
    def from_dict(value):
        """Inverse of `to_dict`; ValueError if the key is missing."""
        if not isinstance(value, dict) or "pieces" not in value:
            raise ValueError(f"a region needs the key pieces; got {value!r:.80}")
        return Region.of(*value["pieces"])

    def to_dict(self):
        """{"pieces": [[[x1, x2], ...], ...]}: the corners of convex pieces whose union is the region."""
        return {"pieces": [self.pieces[i].tolist() for i in range(len(self.pieces))]}

    # -- asking -----------------------------------------------------------------------------------

    @property
    def area(self):
        """In units of x1 times x2."""
        return float(shapely.area(self.shape))

    @property
    def is_empty(self):
        """True if there is no point in it, not even a single one."""
        return bool(shapely.is_empty(self.shape))

    @property
    def components(self):
        """Number of polygons, segments and points that the region falls into; they may touch in points."""
        return len(shapely.get_parts(shapely.get_parts(self.shape)))

    @property
    def holes(self):
        """Number of holes of all components."""
        return int(shapely.get_num_interior_rings(_polygons(self.shape)).sum())

    def contains(self, x, tol=0.0):
        """Whether points (2,) or (N, 2) lie in the region, its boundary included: bool or array (N,) of bool.

        Parameters
        ----------
        x : array (2,) or (N, 2)
        tol : float
            Points this close count as inside (units of x).
        """
        x = np.asarray(x, float)
        require_columns(x, 2, "x", "for a region lies in the plane")
        shapely.prepare(self.shape)
        points = shapely.points(x)
        return shapely.dwithin(self.shape, points, tol) if tol else shapely.intersects(self.shape, points)

    def is_subset(self, other, tol=0.0):
        """Whether the region lies in another Region or Polytope, widened by the box |x|_inf <= tol (units of x)."""
        other = Region(_shape(other))
        if tol:
            other = other.sum(Polytope.box([-tol, -tol], [tol, tol]))
        return self.is_empty or bool(shapely.covers(other.shape, self.shape))

    def bounding_box(self):
        """Smallest box around the region as (lower (2,), upper (2,)).

        Raises
        ------
        ValueError
            If the region is empty.
        """
        if self.is_empty:
            raise ValueError("the region is empty; no box is the smallest around it")
        limits = np.array(shapely.bounds(self.shape))
        return limits[:2], limits[2:]

    @cached_property
    def simplices(self):
        """Triangles, segments and points whose union is the region, as Polygons, the triangles first.

        No corners are added: those of the simplices are corners of the region, as the floats they are.
        """
        triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(_polygons(self.shape)))
        corners = shapely.get_coordinates(triangles).reshape(-1, 4, 2)[:, :3]
        return Polygons.of([*corners, *_flat_parts(self.shape)])

    @cached_property
    def pieces(self):
        """Convex pieces whose union is the region, as Polygons: its simplices, of which neighbours are merged.

        A side that two triangles share is left out where what results is convex beyond rounding (Hertel and
        Mehlhorn): at most four times as many pieces as need be.
        """
        simplices = self.simplices
        count = int((np.diff(simplices.starts) == 3).sum())
        merged = _merged([simplices[i] for i in range(count)])
        return Polygons.of([*merged, *(simplices[i] for i in range(count, len(simplices)))])

    def rings(self):
        """Closed rings of corners (v, 2), counter-clockwise around polygons, clockwise around holes: list of arrays."""
        return [shapely.get_coordinates(r) for r in shapely.get_rings(shapely.orient_polygons(_polygons(self.shape)))]

    # -- new regions ------------------------------------------------------------------------------

    def __or__(self, other):
        """Union with a Region or Polytope."""
        return Region(overlay(shapely.union, self.shape, _shape(other)))

    def __and__(self, other):
        """Intersection with a Region or Polytope."""
        return Region(overlay(shapely.intersection, self.shape, _shape(other)))

    def __sub__(self, other):
        """Closure of what lies in this region and not in another Region or Polytope."""
        return Region(overlay(shapely.difference, self.shape, _shape(other)))

    def sum(self, D):
        """Minkowski sum {x + d : x in the region, d in D}.

        Parameters
        ----------
        D : Polytope
            Bounded: a polygon, a segment or a point.

        Notes
        -----
        With a point c of D: the region and its edges widened by D - c, moved by c. An edge widened by a
        convex set is the convex hull of its ends plus the corners of that set.
        """
        middle, corners = _about_middle(D)
        return Region(shapely.transform(self._widened(corners), lambda x: x + middle))

    def erode(self, D):
        """Erosion {x : x + d in the region for all d in D} by a Polytope, up to parts without area.

        Notes
        -----
        With a point c of D, {x : x + D - c in S} is S without those points from which some point of
        D - c leads across the boundary of S; then all is moved by -c. No frame around S is needed.
        """
        middle, corners = _about_middle(D)
        kept = shapely.union_all(_polygons(self.shape))
        kept = overlay(shapely.difference, kept, overlay(shapely.union_all, _widened_edges(kept, -corners)))
        return Region(shapely.transform(shapely.union_all(_polygons(kept)), lambda x: x - middle))

    def _widened(self, corners):
        """The sum with the hull of `corners` (k, 2), which holds 0, as a shapely geometry."""
        if len(corners) == 1 or self.is_empty:
            return self.shape
        return overlay(shapely.union_all, [self.shape, *_widened_edges(self.shape, corners)])


def overlay(operation, *shapes):
    """A set operation of shapely; where GEOS fails on edges that nearly coincide, it is done with rounded corners.

    Parameters
    ----------
    operation : shapely.union_all, shapely.union, shapely.intersection or shapely.difference
    *shapes
        Its arguments.

    Returns
    -------
    shapely geometry
        In the second case with corners on a grid of `GRID` times the largest coordinate.

    Notes
    -----
    Coordinates that are far from 1, or from each other, are brought there by powers of two and back, which rounds
    nothing: the answer is the same in all units.
    """
    sizes = np.max([np.abs(shapely.get_coordinates(shape)).max(axis=0, initial=0.0) for shape in shapes], axis=0)
    unit = np.where(sizes > 0, np.frexp(sizes)[1], np.frexp(sizes.max())[1])
    if np.abs(unit).max() > FAR or abs(unit[0] - unit[1]) > APART:
        near = overlay(operation, *(shapely.transform(shape, lambda x: np.ldexp(x, -unit)) for shape in shapes))
        return shapely.transform(near, lambda x: np.ldexp(x, unit))
    size = sizes.max()
    try:
        found = operation(*shapes)
        if operation not in (shapely.union_all, shapely.union) or _holds(found, np.hstack(shapes), GRID * size):
            return found
    except shapely.errors.GEOSException:
        pass
    return operation(*shapes, grid_size=GRID * size)


def _holds(union, parts, tol):
    """Whether a union holds the middle of each of its parts: on edges that nearly coincide GEOS may drop a part."""
    shapely.prepare(union)
    parts = shapely.get_parts(parts)
    return bool(shapely.dwithin(union, shapely.centroid(parts[~shapely.is_empty(parts)]), tol).all())


def hulls(polygons, margin=0.0):
    """Polygons as an array (N,) of shapely geometries, each widened by the box |x|_inf <= margin (units of x)."""
    points, owner = polygons.points, polygons.owner
    if margin:
        corners = margin * np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])
        points, owner = (points[:, None] + corners).reshape(-1, 2), np.repeat(owner, 4)
    if not len(points):
        return np.zeros(0, object)
    points, owner = np.repeat(points, 2, axis=0), np.repeat(owner, 2)  # shapely wants lines of at least two points
    return shapely.convex_hull(shapely.linestrings(points, indices=owner))


# -- parts --------------------------------------------------------------------------------------------


def _shape(part):
    """The shapely geometry of a Region, a bounded Polytope, or the corners of a convex polygon."""
    if isinstance(part, Region):
        return part.shape
    if isinstance(part, Polytope):
        if part.dimension != 2:
            raise ValueError(f"the polytope lies in R^{part.dimension}, but regions lie in the plane")
        part = part.vertices()
    corners = real_array(part, "the corners of a piece", 2)
    require_columns(corners, 2, "the corners of a piece", "for a region lies in the plane")
    _require_size(corners)
    return shapely.convex_hull(shapely.multipoints(corners)) if len(corners) else shapely.Polygon()


def _require_size(points):
    """Raise ValueError if all coordinates are too small, or some are too large, to be multiplied."""
    size = np.abs(points).max(initial=0.0)
    if size and not 1 / LARGEST <= size <= LARGEST:
        raise ValueError(
            f"the largest coordinate is {size:.3g}, but regions need one between {1 / LARGEST:.0e} and {LARGEST:.0e}; "
            "choose another unit of length"
        )


def _polygons(shape):
    """Those parts of a shapely geometry that have an area."""
    parts = shapely.get_parts(shapely.get_parts(shape))
    return parts[shapely.get_dimensions(parts) == 2]


def _flat_parts(shape):
    """The segments, each (2, 2), and then the points, each (1, 2), of a shapely geometry."""
    parts = shapely.get_parts(shapely.get_parts(shape))
    lines, points = (parts[shapely.get_dimensions(parts) == dimension] for dimension in (1, 0))
    return [*_edges(lines), *shapely.get_coordinates(points)[:, None]]


def _merged(triangles):
    """Convex polygons, counter-clockwise, that triangles form when shared sides are left out, one after the other."""
    rings = {}
    for number, corners in enumerate(triangles):
        ring = [tuple(corner) for corner in corners.tolist()]
        if _turns_left(*ring):
            rings[number] = ring
        else:
            rings[number] = ring[::-1]
    owner = {(p, q): number for number, ring in rings.items() for p, q in zip(ring, ring[1:] + ring[:1])}
    for p, q in list(owner):
        one, other = owner.get((p, q)), owner.get((q, p))
        if one is None or other is None or one == other:
            continue
        here, there = _from(rings[one], q), _from(rings[other], p)  # q ... p, and p ... q
        if not (_turns_left(here[-2], p, there[1]) and _turns_left(there[-2], q, here[1])):
            continue
        ring = here + there[1:-1]
        del rings[other], owner[p, q], owner[q, p]
        rings[one] = ring
        owner |= {side: one for side in zip(ring, ring[1:] + ring[:1])}
    return [np.array(ring) for ring in rings.values()]


def _from(ring, corner):
    """A ring that begins at one of its corners."""
    start = ring.index(corner)
    return ring[start:] + ring[:start]


def _turns_left(p, q, r):
    """Whether p, q, r turn to the left by more than rounding can feign."""
    left, right = (q[0] - p[0]) * (r[1] - q[1]), (q[1] - p[1]) * (r[0] - q[0])
    return left - right > CERTAIN * (abs(left) + abs(right))


def _edges(lines):
    """All edges of polygons and lines: array (E, 2, 2)."""
    rings = shapely.get_rings(lines[shapely.get_dimensions(lines) == 2])
    coordinates, ring = shapely.get_coordinates(
        np.concatenate([rings, lines[shapely.get_dimensions(lines) == 1]]), return_index=True
    )
    onward = np.flatnonzero(ring[1:] == ring[:-1])
    return np.stack([coordinates[onward], coordinates[onward + 1]], axis=1)


def _widened_edges(shape, corners):
    """The edges and points of a shapely geometry, each plus the hull of `corners` (k, 2): array of geometries."""
    parts = shapely.get_parts(shapely.get_parts(shape))
    ends = _edges(parts)
    points = shapely.get_coordinates(parts[shapely.get_dimensions(parts) == 0])[:, None]
    return hulls(Polygons.of([(end[:, None] + corners).reshape(-1, 2) for end in (*ends, *points)]))


def _about_middle(D):
    """A point (2,) of D, and the corners (k, 2) of D as seen from it."""
    require_kind(D, Polytope, "D")
    if D.dimension != 2 or D.is_empty:
        raise ValueError(f"D must be a nonempty polytope of the plane; got {D!r}")
    corners = D.vertices()
    middle = corners.mean(axis=0) if len(corners) > 1 else corners[0]
    return middle, corners - middle
