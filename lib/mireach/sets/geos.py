"""Set operations of shapely (GEOS) that are the same in all units, and parts of its geometries."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
import shapely
from numpy.typing import NDArray

from ..tolerances import EXPRESSION, GEOS_GRID
from ..typing import Array
from .polygons import Polygons

Shape: TypeAlias = Any  # a geometry of shapely, which has no types
Shapes: TypeAlias = NDArray[np.object_]  # several of them

FAR = 16  # exponent of coordinates that are brought near 1 before GEOS multiplies them
APART = 16  # exponent of the ratio of two coordinates beyond which one grid does not suit both
LARGEST = 2.0**400  # coordinates whose products GEOS can form


def overlay(operation: Callable[..., Shape], *shapes: Any) -> Shape:
    """A set operation of shapely; where GEOS fails on edges that nearly coincide, it is done with rounded corners.

    Parameters
    ----------
    operation : shapely.union_all, shapely.union, shapely.intersection or shapely.difference
    *shapes
        Its arguments.

    Returns
    -------
    shapely geometry
        In the second case with corners on a grid of `GEOS_GRID` times the largest coordinate.

    Notes
    -----
    Coordinates that are far from 1, or from each other, are brought there by powers of two and back, which rounds
    nothing: the answer is the same in all units.
    """
    sizes = np.max([np.abs(shapely.get_coordinates(shape)).max(axis=0, initial=0.0) for shape in shapes], axis=0)
    unit: Any = np.where(sizes > 0, np.frexp(sizes)[1], np.frexp(sizes.max())[1])
    if np.abs(unit).max() > FAR or abs(unit[0] - unit[1]) > APART:
        near = overlay(operation, *(shapely.transform(shape, lambda x: np.ldexp(x, -unit)) for shape in shapes))
        return shapely.transform(near, lambda x: np.ldexp(x, unit))
    size = sizes.max()
    try:
        found = operation(*shapes)
        if operation not in (shapely.union_all, shapely.union) or _holds(found, np.hstack(shapes), GEOS_GRID * size):
            return found
    except shapely.errors.GEOSException:
        pass
    return operation(*shapes, grid_size=GEOS_GRID * size)


def _holds(union: Shape, parts: Any, tol: float) -> bool:
    """Whether a union holds the middle of each of its parts: on edges that nearly coincide GEOS may drop a part."""
    shapely.prepare(union)
    parts = shapely.get_parts(parts)
    return bool(shapely.dwithin(union, shapely.centroid(parts[~shapely.is_empty(parts)]), tol).all())


def hulls(polygons: Polygons, margin: float = 0.0) -> Shapes:
    """Polygons as an array (N,) of shapely geometries, each widened by the box |x|_inf <= margin (units of x)."""
    points, owner = polygons.points, polygons.owner
    if margin:
        corners = margin * np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])
        points, owner = (points[:, None] + corners).reshape(-1, 2), np.repeat(owner, 4)
    if not len(points):
        return np.zeros(0, object)
    points, owner = np.repeat(points, 2, axis=0), np.repeat(owner, 2)  # shapely wants lines of at least two points
    return shapely.convex_hull(shapely.linestrings(points, indices=owner))


def require_size(points: Array) -> None:
    """Raise ValueError if all coordinates are too small, or some are too large, to be multiplied."""
    size = np.abs(points).max(initial=0.0)
    if size and not 1 / LARGEST <= size <= LARGEST:
        raise ValueError(
            f"the largest coordinate is {size:.3g}, but regions need one between {1 / LARGEST:.0e} and {LARGEST:.0e}; "
            "choose another unit of length"
        )


def polygons_of(shape: Shape) -> Shapes:
    """Those parts of a shapely geometry that have an area."""
    parts = shapely.get_parts(shapely.get_parts(shape))
    return parts[shapely.get_dimensions(parts) == 2]


def flat_parts(shape: Shape) -> list[Array]:
    """The segments, each (2, 2), and then the points, each (1, 2), of a shapely geometry."""
    parts = shapely.get_parts(shapely.get_parts(shape))
    lines, points = (parts[shapely.get_dimensions(parts) == dimension] for dimension in (1, 0))
    return [*_edges(lines), *shapely.get_coordinates(points)[:, None]]


def _edges(lines: Shapes) -> Array:
    """All edges of polygons and lines: array (E, 2, 2)."""
    rings = shapely.get_rings(lines[shapely.get_dimensions(lines) == 2])
    coordinates, ring = shapely.get_coordinates(
        np.concatenate([rings, lines[shapely.get_dimensions(lines) == 1]]), return_index=True
    )
    onward = np.flatnonzero(ring[1:] == ring[:-1])
    return np.stack([coordinates[onward], coordinates[onward + 1]], axis=1)


def measures(corners: Array) -> Array:
    """Area of triangles (N, 3, 2), length of segments (N, 2, 2), or 1 for points (N, 1, 2), up to a common factor."""
    if corners.shape[1] == 1:
        return np.ones(len(corners))
    sides = corners[:, 1:] - corners[:, :1]
    if corners.shape[1] == 2:
        return np.linalg.norm(sides[:, 0], axis=1)
    return np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])


def widened_edges(shape: Shape, corners: Array) -> Shapes:
    """The edges and points of a shapely geometry, each plus the hull of `corners` (k, 2): array of geometries."""
    parts = shapely.get_parts(shapely.get_parts(shape))
    ends = _edges(parts)
    points = shapely.get_coordinates(parts[shapely.get_dimensions(parts) == 0])[:, None]
    return hulls(Polygons.of([(end[:, None] + corners).reshape(-1, 2) for end in (*ends, *points)]))


def merged(triangles: list[Array]) -> list[Array]:
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


def _from(ring: list[Any], corner: Any) -> list[Any]:
    """A ring that begins at one of its corners."""
    start = ring.index(corner)
    return ring[start:] + ring[:start]


def _turns_left(p: Any, q: Any, r: Any) -> bool:
    """Whether p, q, r turn to the left by more than rounding explains."""
    left, right = (q[0] - p[0]) * (r[1] - q[1]), (q[1] - p[1]) * (r[0] - q[0])
    return left - right > EXPRESSION * (abs(left) + abs(right))
