"""Whether a union of polygons is RPI, in rational arithmetic: no rounding, so an answer is a proof.

A number is the IEEE float that it is (`rational`). A polygon is the list of its corners, in order around it and none
of them superfluous. One corner is a point, two corners are a segment.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from ..arithmetic.balls import flint
from ..arithmetic.rational import binary, dot, fractions, nearest
from ..sets.exact_polytopes import ExactPolytope
from ..systems.loop import ClosedLoop
from ..tolerances import AROUND
from ..typing import Array, BoolArray, Rational
from .base import Escape
from .exact_cells import ExactCell, Point, cells, disturbances
from .steps import Row

MOST_PARTS = 10_000  # parts into which the rest of one image may fall while it is compared with a region

Polygon = list[Point]
Box = tuple[float, float, float, float]  # left, bottom, right, top


def first_escape(loop: ClosedLoop, pieces: Sequence[Array]) -> Escape | None:
    """A step of the loop that leads out of a union of convex pieces, or None: then the union is proven RPI.

    Parameters
    ----------
    loop : ClosedLoop
        With two states.
    pieces : sequence of arrays (v, 2)
        The corners of convex sets.

    Returns
    -------
    Escape or None
        States without a successor count as escapes: those outside X, and those in a gap between regions, however
        narrow.

    Raises
    ------
    ArithmeticError
        If the rest of an image falls into more than `MOST_PARTS` parts.
    CellLimitError
        If the loop has too many cells.

    Notes
    -----
    For every cell C and every piece P, the image of C & P, widened by D, less all pieces has to be empty.
    Parts of it without interior relative to the image are left out: the image less a closed set is open
    relative to the image, so that it is empty if it has no interior there. In the same way every piece less all
    cells has to be empty.
    """
    hulls = [_hull([binary(corner) for corner in piece]) for piece in pieces]
    whole = [(cell, _around(cell.part)) for cell in cells(loop)]
    without_successor = _without_successor(loop, hulls, [corners for _, corners in whole])
    if without_successor is not None:
        return without_successor
    sides, boxes = [_sides(corners) for corners in hulls], np.array([_box(corners) for corners in hulls])
    others = list(zip(sides, boxes.tolist()))
    spread = disturbances(loop)

    def leaves(cell: ExactCell, part: Polygon) -> Escape | None:
        """The escape from a part of a cell, or None."""
        ends: dict[Point, tuple[Point, Point]] = {}
        for x in part:
            y = cell.image(x)
            ends |= {(y[0] + d[0], y[1] + d[1]): (x, d) for d in spread[cell.mode]}
        image = _hull(list(ends))
        rest = _less(image, [others[j] for j in np.flatnonzero(_meeting(boxes, np.array(_box(image))))])
        return _escape(cell.mode, image, ends, rest) if rest else None

    for cell, corners in whole:
        met = np.flatnonzero(_meeting(boxes, np.array(_box(corners))))
        if not len(met) or leaves(cell, corners) is None:  # most cells stay in the set as a whole
            continue
        for i in met:
            part = _clip_all(corners, sides[i])
            escape = leaves(cell, part) if part else None
            if escape is not None:
                return escape
    return None


def _without_successor(loop: ClosedLoop, hulls: Sequence[Polygon], whole: Sequence[Polygon]) -> Escape | None:
    """A state of polygons outside X or in none of the cells `whole`, or None."""
    limits = list(zip(*loop.system.state_set.exact))
    for corners in hulls:
        for x in corners:
            if any(dot(a, x) > b for a, b in limits):
                return Escape(fractions(x))
    around = [(_sides(corners), _box(corners)) for corners in whole]
    for corners in hulls:
        gap = _less(corners, around)
        if gap:
            return Escape(fractions(_middle(gap)))
    return None


# -- polygons -----------------------------------------------------------------------------------------


def _clip(corners: Polygon, a: Sequence[Rational], b: Rational) -> Polygon:
    """The part of a polygon with a x <= b."""
    excess = [dot(a, x) - b for x in corners]
    if all(value <= 0 for value in excess):
        return corners
    kept = []
    for i, (x, value) in enumerate(zip(corners, excess)):
        if value <= 0:
            kept.append(x)
        y, after = corners[i - len(corners) + 1], excess[i - len(corners) + 1]
        if value * after < 0:
            share = value / (value - after)
            kept.append((x[0] + share * (y[0] - x[0]), x[1] + share * (y[1] - x[1])))
    kept = [x for i, x in enumerate(kept) if i == 0 or x != kept[i - 1]]
    return kept[:-1] if len(kept) > 1 and kept[-1] == kept[0] else kept  # a segment is crossed there and back


def _clip_all(corners: Polygon, rows: Sequence[Row]) -> Polygon:
    """The part of a polygon in all half-planes (a, b)."""
    for a, b in rows:
        if not corners:
            break
        corners = _clip(corners, a, b)
    return corners


def _hull(points: Sequence[Point]) -> Polygon:
    """Corners of the convex hull, counter-clockwise (Andrew's monotone chain)."""
    ordered = sorted(set(points))
    if len(ordered) < 3:
        return ordered

    def chain(points: Polygon) -> Polygon:
        kept: Polygon = []
        for x in points:
            while len(kept) > 1 and _turn(kept[-2], kept[-1], x) <= 0:
                kept.pop()
            kept.append(x)
        return kept[:-1]

    return chain(ordered) + chain(ordered[::-1])


def _around(part: ExactPolytope) -> Polygon:
    """The corners of an ExactPolytope, counter-clockwise: each shares an edge with the next."""
    if part.dimension < 2:
        return part.vertices
    order, rest = [0], list(range(1, len(part.points)))
    while rest:
        following = next(j for j in rest if part.share_edge(order[-1], j))
        order.append(following)
        rest.remove(following)
    corners = [part.vertices[i] for i in order]
    return corners if _turn(*corners[:3]) > 0 else corners[::-1]


def _turn(x: Point, y: Point, z: Point) -> Rational:
    """Twice the area of the triangle x, y, z: positive if it is counter-clockwise."""
    return (y[0] - x[0]) * (z[1] - x[1]) - (y[1] - x[1]) * (z[0] - x[0])


def _sides(corners: Polygon) -> list[Row]:
    """Half-planes (a, b) whose intersection is the polygon with these corners, counter-clockwise."""
    x = corners[0]
    if len(corners) == 1:
        one, none = flint().fmpq(1), flint().fmpq(0)
        normals = [(one, none), (none, one), (-one, none), (none, -one)]
        return [(a, dot(a, x)) for a in normals]
    ahead = [(y[0] - x[0], y[1] - x[1]) for x, y in zip(corners, corners[1:] + corners[:1])]
    rows = [((t[1], -t[0]), x) for t, x in zip(ahead, corners)]
    if len(corners) == 2:
        rows += [(t, y) for t, y in zip(ahead, corners[::-1])]
    return [(a, dot(a, x)) for a, x in rows]


def _less(corners: Polygon, others: Sequence[tuple[Sequence[Row], Sequence[float]]]) -> Polygon:
    """A part, with interior relative to it, of a polygon less closed polygons (sides, box); or []."""
    rest = [(corners, _box(corners))]
    for sides, (left, bottom, right, top) in others:
        following = []
        for part, box in rest:
            if box[0] > right or box[1] > top or box[2] < left or box[3] < bottom:
                following.append((part, box))
                continue
            for piece in _less_one(part, sides):
                following.append((piece, box if piece is part else _box(piece)))
        rest = following
        if len(rest) > MOST_PARTS:
            raise ArithmeticError(f"the rest of an image falls into more than {MOST_PARTS} parts")
        if not rest:
            return []
    return rest[0][0]


def _less_one(part: Polygon, sides: Sequence[Row]) -> list[Polygon]:
    """The parts of a polygon outside another one: beyond its first side, beyond its second but not its first, ..."""
    dimension = min(len(part), 3)
    outside: list[Polygon] = []
    inside = part
    for a, b in sides:
        beyond = [dot(a, x) > b for x in inside]
        if any(beyond):
            outside.append(_clip(inside, tuple(-entry for entry in a), -b))
            inside = _clip(inside, a, b)
            if min(len(inside), 3) < dimension:  # the intersection has no interior: all the rest is outside
                return outside
    return outside


def _middle(corners: Polygon) -> Point:
    """The mean of the corners."""
    zero = flint().fmpq(0)
    return sum((x[0] for x in corners), zero) / len(corners), sum((x[1] for x in corners), zero) / len(corners)


def _box(corners: Polygon) -> Box:
    """A box (left, bottom, right, top) in floats that contains the polygon, rounding included."""
    x, y = [nearest(point[0]) for point in corners], [nearest(point[1]) for point in corners]
    around = AROUND * (1 + max(abs(min(x)), abs(max(x)), abs(min(y)), abs(max(y))))
    return min(x) - around, min(y) - around, max(x) + around, max(y) + around


def _meeting(boxes: Array, box: Array) -> BoolArray:
    """Which of several boxes (N, 4) meet a box (4,)."""
    return np.all(boxes[:, :2] <= box[2:], axis=1) & np.all(boxes[:, 2:] >= box[:2], axis=1)


def _escape(mode: int, image: Polygon, ends: dict[Point, tuple[Point, Point]], rest: Polygon) -> Escape:
    """The step to the middle of `rest`, a part of the image.

    `ends` gives the state and the disturbance that lead to each corner of the image. The middle of `rest` is a convex
    combination of such corners, and its state and disturbance are the same combination of theirs.
    """
    y = _middle(rest)
    shares = _shares(image, y)
    state, disturbance = (
        tuple(sum((share * ends[corner][which][i] for corner, share in shares), flint().fmpq(0)) for i in range(2))
        for which in (0, 1)
    )
    return Escape(fractions(state), mode, fractions(disturbance), fractions(y))


def _shares(corners: Polygon, y: Point) -> list[tuple[Point, Rational]]:
    """y as a convex combination of corners of its polygon: list of (corner, weight)."""
    first = corners[0]
    if len(corners) == 1:
        return [(first, flint().fmpq(1))]
    if len(corners) == 2:
        along = [b - a for a, b in zip(*corners)]
        share = dot(along, [b - a for a, b in zip(first, y)]) / dot(along, along)
        return [(first, 1 - share), (corners[1], share)]
    for second, third in pairwise(corners[1:]):
        whole = _turn(first, second, third)
        shares = [_turn(second, third, y) / whole, _turn(third, first, y) / whole, _turn(first, second, y) / whole]
        if min(shares) >= 0:
            break
    return list(zip((first, second, third), shares))
