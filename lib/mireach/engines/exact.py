"""The cells of a closed loop in the plane in rational arithmetic: no rounding, so an answer is a proof.

Every float is converted exactly into a fraction (`rational`). A polygon is the list of its corners, in order and
without superfluous ones. One corner is a point, two corners are a segment.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np

from ..arithmetic.balls import flint
from ..arithmetic.rational import above, binary, dot, fractions, maximize, nearest
from ..sets.polytope import Polytope
from ..systems.loop import ClosedLoop
from ..systems.network import MaxoutNetwork
from ..tolerances import AROUND
from ..typing import Array, ArrayLike, BoolArray, IntArray, Rational
from .base import EXACT, Engine, Escape, LazySequence, Support, Witness, checked_query, empty_support, replay
from .steps import Row, Step, matrices

MOST_PARTS = 10_000  # parts of one image outside a region; beyond this number the comparison stops

Point = tuple[Rational, Rational]
Polygon = list[Point]
Box = tuple[float, float, float, float]  # left, bottom, right, top
Piece = tuple[Polygon, list[tuple[Rational, ...]], list[Rational]]  # Phi = K x + g on a polygon


@dataclass(frozen=True, eq=False)
class ExactCell:
    """A closed convex polygon of X on which x+ = M x + c + d, d in D of `mode`.

    Attributes
    ----------
    corners : list of (fmpq, fmpq)
    mode : int
    M : 2 pairs of fmpq
    c : pair of fmpq
    """

    corners: Polygon
    mode: int
    M: tuple[Point, Point]
    c: Point

    def image(self, x: Point) -> Point:
        """M x + c."""
        return dot(self.M[0], x) + self.c[0], dot(self.M[1], x) + self.c[1]


@dataclass(frozen=True)
class Exact(Engine):
    """h of R_1(F) by the cells in rational arithmetic, for two states and one step.

    See Also
    --------
    Cells : the same in floating point, for any number of steps.
    """

    name: ClassVar[str] = "exact"

    def support(
        self,
        loop: ClosedLoop,
        F: Polytope,
        V: ArrayLike,
        steps: int = 1,
        *,
        cutoff: Array | None = None,
        warm_start: Support | None = None,
    ) -> Support:
        """As `Engine.support`: `bound` is the smallest float that is not below the exact value, `value` the nearest.

        `cutoff` and `warm_start` are not used.

        Raises
        ------
        ValueError
            If the loop does not have two states, or `steps` is not 1.
        """
        V, steps = checked_query(loop, F, V, steps)
        if steps != 1:
            raise ValueError(f'the exact engine takes one step; got steps = {steps}; use engine="cells"')
        best = support_steps(loop, F, V)
        if best is None:
            return empty_support(len(V), EXACT)
        value, bound = (np.array([rounded(step.value) for step in best]) for rounded in (nearest, above))

        def witness(k: int) -> Witness:
            x, d = ([nearest(entry) for entry in part] for part in (best[k].state, best[k].disturbance))
            return replay(loop, np.array(x), [best[k].mode], [np.array(d)])

        return Support(value, bound, LazySequence(len(V), witness), rests_on=EXACT)


def support_steps(loop: ClosedLoop, F: Polytope, V: Array) -> list[Step] | None:
    """The Step from F with the largest v x+, for each row v of V: list, or None if F does not meet X."""
    rows = half_planes(F)
    every, spread = cells(loop), disturbances(loop)
    heights, near = _heights(loop, V), _near(loop, F)
    parts: dict[int, Polygon] = {}
    best = []
    for k, v in enumerate(map(binary, V.tolist())):
        pushed = [max(corners, key=lambda d: dot(v, d)) for corners in spread]
        found = None
        for j in near[np.argsort(-heights[near, k], kind="stable")].tolist():
            if found is not None and heights[j, k] < nearest(found[0]):  # the cells that follow have no larger value
                break
            if j not in parts:
                parts[j] = _clip_all(every[j].corners, rows)
            d = pushed[every[j].mode]
            for x in parts[j]:
                value = dot(v, every[j].image(x)) + dot(v, d)
                if found is None or value > found[0]:
                    found = (value, x, j, d)
        if found is None:
            return None
        value, x, j, d = found
        H, h = zip(*_sides(every[j].corners), *rows)
        best.append(Step(value, x, every[j].mode, d, (H, h)))
    return best


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

    Notes
    -----
    For every cell C and every piece P, the image of C & P, enlarged by D, minus all pieces must be empty. Parts of it
    without interior relative to the image need no check: the image minus a closed set is open relative to the image, so
    it is empty if it has no interior there. In the same way every piece minus all cells must be empty.
    """
    hulls = [_hull([binary(corner) for corner in piece]) for piece in pieces]
    without_successor = _without_successor(loop, hulls)
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

    for cell in cells(loop):
        met = np.flatnonzero(_meeting(boxes, np.array(_box(cell.corners))))
        if not len(met) or leaves(cell, cell.corners) is None:  # most cells stay in the set as a whole
            continue
        for i in met:
            part = _clip_all(cell.corners, sides[i])
            escape = leaves(cell, part) if part else None
            if escape is not None:
                return escape
    return None


def _without_successor(loop: ClosedLoop, hulls: Sequence[Polygon]) -> Escape | None:
    """A state of polygons outside X or in no cell, or None."""
    limits = half_planes(loop.system.state_set)
    for corners in hulls:
        for x in corners:
            if any(dot(a, x) > b for a, b in limits):
                return Escape(fractions(x))
    around = [(_sides(cell.corners), _box(cell.corners)) for cell in cells(loop)]
    for corners in hulls:
        gap = _less(corners, around)
        if gap:
            return Escape(fractions(_middle(gap)))
    return None


def growth(C: ArrayLike, before: Array, h: Array, centre: ArrayLike) -> Fraction | None:
    """The largest alpha with c + alpha (R - c) in R_before, without rounding: eq. (26), StabCondFmin.

    R = {x : C x <= h} and R_before = {x : C x <= before}.

    Parameters
    ----------
    C : array (l, 2)
        Rows of both sets, which are bounded.
    before, h : array (l,)
        Offsets of R_before and R.
    centre : array (2,)
        c.

    Returns
    -------
    Fraction or None
        None if c is not inside R.
    """
    corners, c = _polygon(Polytope(np.asarray(C), h)), binary(np.asarray(centre).tolist())
    shares = []
    for a, limit in zip(binary(np.asarray(C).tolist()), before.tolist()):
        size = max((dot(a, x) for x in corners), default=dot(a, c)) - dot(a, c)
        if size <= 0:
            return None
        shares.append((binary(limit) - dot(a, c)) / size)
    return fractions([min(shares)])[0]


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
    return kept[:-1] if len(kept) > 1 and kept[-1] == kept[0] else kept  # a segment is traversed in both directions


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
    """A part of a polygon minus closed polygons (sides, box), with interior relative to the polygon; or []."""
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
    """The step whose successor is the middle of `rest`, a part of the image.

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


# -- cells --------------------------------------------------------------------------------------------


@lru_cache(maxsize=32)
def cells(loop: ClosedLoop) -> tuple[ExactCell, ...]:
    """The cells of a closed loop over X, including those that are only an edge or a point of their mode.

    Raises
    ------
    ValueError
        If the loop does not have two states.
    """
    if loop.system.state_size != 2:
        raise ValueError(f'the exact cells need 2 states, but the loop has {loop.system.state_size}; use engine="milp"')
    found, X = list[ExactCell](), _polygon(loop.system.state_set)
    pieces = _affine_pieces(loop.network, loop.system.state_set)
    boxes = np.array([_box(corners) for corners, _, _ in pieces])
    for number, mode in enumerate(loop.system.modes):
        A, B, p = (binary(getattr(mode, name).tolist()) for name in "ABp")
        rows = half_planes(mode.region)
        of_x = [(a[:2], b) for a, b in rows if not any(a[2:])]
        domain = _clip_all(X, of_x)
        for i in np.flatnonzero(_meeting(boxes, np.array(_box(domain)))) if domain else ():
            corners, K, g = pieces[i]
            corners = _clip_all(corners, of_x)
            if min(len(corners), 3) < min(len(domain), 3):  # Phi is continuous: neighbours in the mode contain it
                continue
            for a, b in rows:
                if any(a[2:]) and corners:
                    of_u = tuple(dot(a[2:], [row[i] for row in K]) for i in range(2))
                    corners = _clip(corners, (a[0] + of_u[0], a[1] + of_u[1]), b - dot(a[2:], g))
            if corners:
                M = [tuple(A[i][j] + dot(B[i], [row[j] for row in K]) for j in range(2)) for i in range(2)]
                c = [dot(B[i], g) + p[i] for i in range(2)]
                found.append(ExactCell(corners, number, (M[0], M[1]), (c[0], c[1])))
    return tuple(found)


def _heights(loop: ClosedLoop, V: Array) -> Array:
    """Upper bounds in floats of v x+ for all x of each whole cell and all d, for the rows v of V: array (cells, k)."""
    _, images, starts = _floats(loop)
    modes = [cell.mode for cell in cells(loop)]
    corners = [np.array([[nearest(entry) for entry in d] for d in one]) for one in disturbances(loop)]
    spread = np.array([(V @ ends.T).max(axis=1) for ends in corners])[modes]
    around = AROUND * (1 + np.abs(images).max(initial=0.0) + np.abs(spread).max()) * (1 + np.abs(V).sum(axis=1))
    return np.maximum.reduceat(images @ V.T, starts) + spread + around


def _near(loop: ClosedLoop, F: Polytope) -> IntArray:
    """Indices of the cells that, computed in floats, may meet F."""
    points, _, starts = _floats(loop)
    around = AROUND * (1 + np.abs(points).max()) * (1 + np.abs(F.H).sum(axis=1) + np.abs(F.h))
    return np.flatnonzero((np.minimum.reduceat(points @ F.H.T - F.h, starts) <= around).all(axis=1))


@lru_cache(maxsize=32)
def _floats(loop: ClosedLoop) -> tuple[Array, Array, IntArray]:
    """The corners of all cells and M x + c there as floats, (T, 2) each, and the first index of each cell (cells,)."""
    corners, images = (
        [[[nearest(entry) for entry in pair] for pair in pairs] for pairs in found]
        for found in zip(*((cell.corners, map(cell.image, cell.corners)) for cell in cells(loop)))
    )
    return np.concatenate(corners), np.concatenate(images), np.cumsum([0, *map(len, corners[:-1])])


def disturbances(loop: ClosedLoop) -> list[Polygon]:
    """The corners of D^(i) of every mode.

    Raises
    ------
    ValueError
        If a set is empty in rational arithmetic.
    """
    found: dict[Polytope, Polygon] = {}
    for number, mode in enumerate(loop.system.modes, start=1):
        if mode.disturbance not in found:
            found[mode.disturbance] = _polygon(mode.disturbance)
        if not found[mode.disturbance]:
            raise ValueError(f"the disturbance set of mode {number} is empty in rational arithmetic")
    return [found[mode.disturbance] for mode in loop.system.modes]


def half_planes(P: Polytope) -> list[Row]:
    """The rows (a, b) of a Polytope in rational numbers."""
    return list(zip(*P.exact))


def _polygon(P: Polytope) -> Polygon:
    """The corners of a bounded Polytope of the plane; none if it is empty."""
    one, zero = flint().fmpq(1), flint().fmpq(0)
    H, h = P.exact
    ends = [maximize(H, h, v).value for v in ((one, zero), (zero, one), (-one, zero), (zero, -one))]
    if any(isinstance(end, float) for end in ends):  # -inf: P is empty
        return []
    (right, top), (left, bottom) = ends[:2], (-end for end in ends[2:])
    return _clip_all(_hull([(left, bottom), (right, bottom), (right, top), (left, top)]), half_planes(P))


def highest_inputs(
    network: MaxoutNetwork, X: Polytope, V: Sequence[Sequence[Rational]]
) -> list[tuple[Rational, Point]]:
    """max v Phi(x) over x in X and a maximizer x, for the rows v of V, without rounding: list of (fmpq, x)."""
    best: list[Any] = [None] * len(V)
    for corners, K, g in _affine_pieces(network, X):
        for x in corners:
            u = [dot(row, x) + offset for row, offset in zip(K, g)]
            for k, v in enumerate(V):
                value = dot(v, u)
                if best[k] is None or value > best[k][0]:
                    best[k] = value, x
    return best


@lru_cache(maxsize=32)
def _affine_pieces(network: MaxoutNetwork, X: Polytope) -> list[Piece]:
    """Polygons that cover X, each with K (m pairs) and g (m numbers) of Phi = K x + g on it."""
    matrix = flint().fmpq_mat
    pieces = [(_polygon(X), matrix(3, 3, [1, 0, 0, 0, 1, 0, 0, 0, 1]))]  # rows (K, g) of the last layer, below them 1
    *hidden, output = matrices(network)
    for layer, weight in zip(network.hidden, hidden):
        following = []
        for corners, affine in pieces:
            channels = (weight * affine).tolist()
            parts: list[tuple[Polygon, list[Rational]]] = [(corners, [])]
            for start in range(0, len(channels), layer.pool):
                neuron = channels[start : start + layer.pool]
                parts = [(part, [*won, *neuron[j]]) for whole, won in parts for part, j in _by_winner(whole, neuron)]
            following += [(part, matrix(layer.width + 1, 3, [*won, 0, 0, 1])) for part, won in parts]
        pieces = following
    found = []
    for corners, affine in pieces:
        forms = (output * affine).tolist()
        found.append((corners, [tuple(form[:2]) for form in forms], [form[2] for form in forms]))
    return found


def _by_winner(corners: Polygon, channels: Sequence[Sequence[Rational]]) -> list[tuple[Polygon, int]]:
    """Split a polygon into the parts on which one of the channels (k_1, k_2, g) is largest: list of (part, channel).

    Parts of lower dimension than the polygon are left out: Phi is continuous, and their neighbours contain them.
    """
    matrix = flint().fmpq_mat
    points = matrix(len(corners), 3, [entry for x in corners for entry in (*x, 1)])
    values = (matrix(channels) * points.transpose()).tolist()
    top = [max(column) for column in zip(*values)]
    for j, value in enumerate(values):
        if value == top:
            return [(corners, j)]
    found = []
    for j, channel in enumerate(channels):
        part = corners
        for i, other in enumerate(channels):
            if i == j or len(part) < min(len(corners), 3):
                continue
            *a, b = (entry - own for entry, own in zip(other, channel))
            part = _clip(part, a, -b)
            if i < j and all(dot(a, x) == -b for x in part):  # a tie on the whole part: it belongs to the first channel
                part = []
        if len(part) >= min(len(corners), 3):
            found.append((part, j))
    return found
