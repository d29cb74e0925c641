"""The rows of new sets: intersections, hulls, sums, differences, images and preimages of polytopes.

Every function returns the rows H and the offsets h of {x : H x <= h}; the methods of `Polytope` document
what the sets are and in which direction they are rounded.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from ..arithmetic import rational
from ..arithmetic.rational import above, below, binary, nearest
from ..arithmetic.scaling import normal_rows
from ..tolerances import EXPRESSION, SMALLEST, TOUCH, TURN
from ..typing import Array, IntArray
from .convex_set import ConvexSet, Rational, top_exponent
from .facets import Frame, image, rank, scaled
from .kernels import hull
from .templates import box_directions

if TYPE_CHECKING:
    from .polytope import Polytope

MOST = 2**900  # rows with a larger entry, or with none above its inverse, are scaled before they are rounded
WIDE = np.pi - 1e-2  # between the normals of two neighbouring sides: they meet in a needle's tip


class Rows(NamedTuple):
    """The set {x : H x <= h}: array (l, n) and array (l,)."""

    H: Array
    h: Array


def empty(n: int) -> Rows:
    """The empty set of R^n."""
    return Rows(np.zeros((1, n)), np.array([-1.0]))


def intersection(P: Rows | Polytope, Q: Rows | Polytope) -> Rows:
    """The rows of both, each once, with the smaller offset."""
    rows: dict[bytes, tuple[Array, float]] = {}
    for row, offset in zip(np.vstack([P.H, Q.H]) + 0.0, np.concatenate([P.h, Q.h]).tolist()):
        key = row.tobytes()
        rows[key] = (row, min(offset, rows[key][1]) if key in rows else offset)
    return Rows(np.array([row for row, _ in rows.values()]), np.array([offset for _, offset in rows.values()]))


def minkowski_sum(P: Polytope, Q: Polytope) -> Rows:
    """P + Q, rounded outward: see `Polytope.sum`."""
    n = P.dimension
    if P.is_empty or Q.is_empty:
        return empty(n)
    rows = np.vstack([P.H, Q.H])
    if n > 2 and (np.count_nonzero(rows, axis=1) > 1).any():
        if not (P.is_bounded and Q.is_bounded):  # p + q for (p, q) in the product
            return linear_image(P.product(Q), np.hstack([np.eye(n), np.eye(n)]), np.zeros(n))
        return _hull([tuple(a + b for a, b in zip(p, q)) for p in P.exact_vertices for q in Q.exact_vertices])
    rows = _distinct(rows)
    pairs: list[list[Any]] = [[S.exact_maximum(v).value for S in (P, Q)] for v in rows]
    return _rows_with(rows, [np.inf if any(isinstance(b, float) for b in pair) else sum(pair) for pair in pairs])


def pontryagin_difference(P: Polytope, Q: Polytope) -> Rows:
    """P - Q for a nonempty Q, rounded inward: see `Polytope.erode`."""
    highest: list[Any] = [Q.exact_maximum(v).value for v in P.H]
    if any(isinstance(value, float) for value in highest):
        return empty(P.dimension)
    h = np.array([below(b - value) for b, value in zip(P.exact[1], highest)])
    return Rows(P.H, h) if (h > -np.inf).all() else empty(P.dimension)


def linear_image(P: Polytope, M: Array, t: Array) -> Rows:
    """M P + t, rounded outward for bounded P: see `Polytope.map`."""
    if P.is_empty:
        return empty(len(M))
    rows, shift = binary(M), binary(t)
    if rank(rows) < P.dimension and P.is_bounded:
        return _hull([tuple(rational.dot(a, x) + b for a, b in zip(rows, shift)) for x in P.exact_vertices])
    columns = [*zip(*rows)]

    def highest(v: Sequence[Rational]) -> Rational:  # h_P(M'v) + v t
        value: Any = P.exact_maximum([rational.dot(v, column) for column in columns]).value
        return value if isinstance(value, float) else value + rational.dot(v, shift)

    exact = [_in_range(v, b) for v, b in image(*P.exact, rows)]
    found = np.array([[nearest(entry) for entry in v] for v, _ in exact]).reshape(-1, len(M)) + 0.0
    values = [highest(binary(v)) for v in found]
    if P.is_bounded:
        return _within_box(_rows_with(found, values), highest)
    limits = [b + rational.dot(v, shift) for v, b in exact]
    return _image_of_unbounded(found, values, limits)


def linear_preimage(P: Polytope, M: Array, t: Array) -> Rows:
    """{x : M x + t in P}, rounded to nearest: see `Polytope.preimage`."""
    if P.is_empty:
        return empty(M.shape[1])
    H, h = P.exact
    columns, shift = [*zip(*binary(M))], binary(t)
    rows = [[nearest(rational.dot(a, column)) for column in columns] for a in H]
    return Rows(np.array(rows), np.array([nearest(b - rational.dot(a, shift)) for a, b in zip(H, h)]))


def section(P: Polytope, axes: Sequence[int], at: Array) -> Rows:
    """{y : x in P, where x_i = y_i for i in axes and x_j = at_j for the others}: see `Polytope.section`."""
    others = [j for j in range(P.dimension) if j not in axes]
    plane = np.eye(P.dimension)[others]
    if ConvexSet(np.vstack([P.H, plane, -plane]), np.concatenate([P.h, at[others], -at[others]])).is_empty:
        return empty(len(axes))
    shift = binary(np.where(np.isin(np.arange(P.dimension), axes), 0, at))
    return _rows_with(P.H[:, axes], [b - rational.dot(row, shift) for row, b in zip(*P.exact)])


def hull_of(points: Array) -> Rows:
    """The convex hull of points (k, n), rounded outward: see `Polytope.from_points`."""
    n = points.shape[1]
    unit = np.frexp(np.ptp(np.ldexp(points, -1), axis=0))[1] + 1  # half the points, for ptp must not overflow
    local = np.ldexp(points - points[0] if n > 2 else points, -unit)
    if n == 1 or (points == points[0]).all():
        normals = box_directions(n)
    elif n == 2:
        normals = _normals(local)
    else:
        try:
            normals = ConvexHull(local).equations[:, :-1]
        except QhullError as error:
            raise ValueError(
                f"the {len(points)} points span no volume in R^{n}; give H and h of a flat set directly"
            ) from error
    found = _rows_around(normals, unit, points)
    if n <= 2 or ConvexSet(*found).is_bounded:
        return found
    return intersection(found, _rows_around(box_directions(n), 0 * unit, points))


# -- parts --------------------------------------------------------------------------------------------


def _distinct(H: Array) -> Array:
    """The rows of H of which no earlier one is a multiple by a power of two."""
    return np.array([*{row.tobytes(): row for row in normal_rows(H)[0]}.values()])


def _rows_with(rows: Array, values: Sequence[Rational | float]) -> Rows:
    """{x : rows x <= values}, the values rounded up; rows with a value of inf are left out."""
    kept = [(row, above(value)) for row, value in zip(rows, values) if not isinstance(value, float)]
    kept = [(row, offset) for row, offset in kept if offset < np.inf]
    if not kept:
        return Rows(np.zeros((1, rows.shape[1])), np.array([1.0]))  # the whole space
    return Rows(np.array([row for row, _ in kept]), np.array([offset for _, offset in kept]))


def _in_range(v: tuple[Rational, ...], b: Rational) -> tuple[tuple[Rational, ...], Rational]:
    """A row v y <= b, divided by the largest entry of v where floats are too coarse there."""
    top = max(abs(entry) for entry in v)
    if not top or (top < MOST and top * MOST > 1):
        return v, b
    return tuple(entry / top for entry in v), b / top


def _image_of_unbounded(rows: Array, values: list[Rational], limits: list[Rational]) -> Rows:
    """{y : rows y <= values}, with the offsets before rounding (`limits`) along rounded rows without a finite maximum.

    Of two opposite rows both get them, or none does: otherwise the two might exclude each other by rounding. If the
    rows exclude each other even so, those without a finite maximum are left out.
    """
    unlimited = {row.tobytes() for row, value in zip(rows, values) if value == np.inf}
    opposite = [(-row + 0.0).tobytes() in unlimited for row in rows]
    offsets = [limit if value == np.inf or other else value for value, limit, other in zip(values, limits, opposite)]
    found = _rows_with(rows, offsets)
    return _rows_with(rows, values) if ConvexSet(*found).is_empty else found


def _hull(points: list[tuple[Rational, ...]]) -> Rows:
    """The convex hull of points of fmpq, rounded outward; flat ones included."""
    rows = _distinct(np.array([scaled(v) for v in Frame(points).normals()]))

    def highest(v: Sequence[Rational]) -> Rational:
        return max(rational.dot(v, x) for x in points)

    return _within_box(_rows_with(rows, [highest(binary(v)) for v in rows]), highest)


def _within_box(found: Rows, highest: Callable[[Sequence[Rational]], Rational]) -> Rows:
    """A set with those sides of a bounding box that it exceeds by more than rounding, as needles do.

    The box is that of the set with the support function `highest`, of rows of fmpq.
    """
    rows = box_directions(found.H.shape[1])
    limits = np.array([above(highest(v)) for v in binary(rows)])
    size = np.tile(limits.reshape(2, -1).sum(axis=0), 2)
    wide = ConvexSet(*found).support(rows) > limits + TOUCH * size
    return intersection(found, Rows(rows[wide], limits[wide])) if wide.any() else found


def _normals(points: Array) -> Array:
    """Outward normals of the hull of at least two points (k, 2), each coordinate of which spreads over about 1."""
    points = points[np.lexsort(points.T[::-1])]
    ring = points[hull(points, TURN)]
    if len(ring) < 3:
        along = points[-1] - points[0]
        return np.vstack([[[-along[1], along[0]], [along[1], -along[0]]], np.eye(2), -np.eye(2)])
    along = np.roll(ring, -1, axis=0) - ring
    return np.column_stack([along[:, 1], -along[:, 0]])


def _rows_around(normals: Array, unit: IntArray, points: Array) -> Rows:
    """The polytope that touches points (k, n), for given normals in units of 2^unit; it certainly holds them.

    In the plane the sides of their bounding box are added where the normals alone would let a needle reach too far.
    """
    top = top_exponent(normals, -unit)
    H = np.ldexp(normals, -unit - top[:, None])
    H /= np.linalg.norm(H, axis=1)[:, None]
    H = np.where(H == 0, 0.0, H)
    if H.shape[1] == 2:
        angle = np.sort(np.arctan2(H[:, 1], H[:, 0]))
        if np.diff(angle, append=angle[0] + 2 * np.pi).max() > WIDE:
            H = np.vstack([H, np.eye(2), -np.eye(2)])
    H = np.array([*{row.tobytes(): row for row in H}.values()])
    exact = np.count_nonzero(H, axis=1) == 1  # rows of the coordinates, whose products do not round
    terms = np.where(exact, 0, EXPRESSION * (np.abs(points) @ np.abs(H).T) + SMALLEST)
    return Rows(H, (points @ H.T + terms).max(axis=0))
