"""The cells of a closed loop in the plane in rational arithmetic: no rounding, so an answer is a proof.

Every number is the float that it is (`rational`). A polygon is a list of its corners, in order around it and none
of them superfluous; one corner is a point, two are a segment.
"""

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import ClassVar

import numpy as np

from ..arithmetic.balls import flint
from ..arithmetic.rational import above, binary, dot, fractions, maximize, nearest
from ..sets.polytope import Polytope
from .base import EXACT, Engine, Escape, LazySequence, Support, checked_query, empty_support, replay
from .steps import Step, with_bias

AROUND = 2.0**-40  # boxes that sort out what cannot meet are this much larger (relative), for they are floats
MOST_PARTS = 10_000  # parts that the rest of one image may fall into while it is compared with a region


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

    corners: list
    mode: int
    M: tuple
    c: tuple

    def image(self, x):
        """M x + c."""
        return tuple(row[0] * x[0] + row[1] * x[1] + offset for row, offset in zip(self.M, self.c))


@dataclass(frozen=True)
class Exact(Engine):
    """h of R_1(F) by the cells in rational arithmetic, for two states and one step.

    See Also
    --------
    Cells : the same in floating point, for any number of steps.
    """

    name: ClassVar[str] = "exact"

    def support(self, loop, F, V, steps=1, *, cutoff=None, warm_start=None) -> Support:
        """As `Engine.support`: `bound` is the smallest float that is not below the exact value, `value` the nearest.

        `cutoff` and `warm_start` are not used.

        Raises
        ------
        ValueError
            If the loop has not two states, or `steps` is not 1.
        """
        V, steps = checked_query(loop, F, V, steps)
        if steps != 1:
            raise ValueError(f'the exact engine takes one step; got steps = {steps}; use engine="cells"')
        best = farthest_steps(loop, F, V)
        if best is None:
            return empty_support(len(V), EXACT)
        value, bound = (np.array([rounded(step.value) for step in best]) for rounded in (nearest, above))

        def witness(k):
            x, d = ([nearest(entry) for entry in part] for part in (best[k].state, best[k].disturbance))
            return replay(loop, np.array(x), [best[k].mode], [np.array(d)])

        return Support(value, bound, LazySequence(len(V), witness), rests_on=EXACT)


def farthest_steps(loop, F, V):
    """The Step from F that goes farthest along each row of V: list, or None if F does not meet X."""
    rows = _rows(F)
    every, spread, parts = cells(loop), disturbances(loop), {}
    heights, near, best = _heights(loop, V), _near(loop, F), []
    for k, v in enumerate(map(binary, V.tolist())):
        farthest = [max(corners, key=lambda d: dot(v, d)) for corners in spread]
        found = None
        for j in near[np.argsort(-heights[near, k], kind="stable")].tolist():
            if found is not None and heights[j, k] < nearest(found[0]):  # nor do the cells that follow reach higher
                break
            if j not in parts:
                parts[j] = _clip_all(every[j].corners, rows)
            d = farthest[every[j].mode]
            for x in parts[j]:
                value = dot(v, every[j].image(x)) + dot(v, d)
                if found is None or value > found[0]:
                    found = (value, x, j, d)
        if found is None:
            return None
        value, x, j, d = found
        best.append(Step(value, x, every[j].mode, d, tuple(zip(*_sides(every[j].corners), *rows))))
    return best


def first_escape(loop, pieces):
    """A step of the loop that leads out of a union of convex pieces, or None: then the union is RPI, which is proven.

    Parameters
    ----------
    loop : ClosedLoop
        With two states.
    pieces : sequence of arrays (v, 2)
        The corners of convex sets, as the floats they are.

    Returns
    -------
    Escape or None
        States without a successor count as escapes: those outside X, and those in a gap between regions, however
        narrow.

    Raises
    ------
    ArithmeticError
        If the rest of an image falls into too many parts to go on.

    Notes
    -----
    For every cell C and every piece P, the image of C & P, widened by D, less all pieces has to be empty.
    Parts of it without interior relative to the image are left out: the image less a closed set is open
    relative to the image, so that it is empty if it has no interior there. The same way every piece less all
    cells has to be empty.
    """
    flint()
    hulls = [_hull([binary(corner) for corner in piece]) for piece in pieces]
    limits = _rows(loop.system.state_set)
    for corners in hulls:
        for x in corners:
            if any(dot(a, x) > b for a, b in limits):
                return Escape(fractions(x))
    every = cells(loop)
    around = [(_sides(cell.corners), _box(cell.corners)) for cell in every]
    for corners in hulls:
        gap = _less(corners, around)
        if gap:
            return Escape(fractions(_middle(gap)))
    sides, boxes = [_sides(corners) for corners in hulls], np.array([_box(corners) for corners in hulls])
    others = list(zip(sides, boxes.tolist()))
    spread = disturbances(loop)

    def leaves(cell, part):
        """The escape from a part of a cell, or None."""
        ends = {}
        for x in part:
            y = cell.image(x)
            ends |= {(y[0] + d[0], y[1] + d[1]): (x, d) for d in spread[cell.mode]}
        image = _hull(list(ends))
        rest = _less(image, [others[j] for j in np.flatnonzero(_meeting(boxes, np.array(_box(image))))])
        return _escape(cell.mode, image, ends, rest) if rest else None

    for cell in every:
        met = np.flatnonzero(_meeting(boxes, np.array(_box(cell.corners))))
        if not len(met) or leaves(cell, cell.corners) is None:  # most cells stay in the set as a whole
            continue
        for i in met:
            part = _clip_all(cell.corners, sides[i])
            escape = leaves(cell, part) if part else None
            if escape is not None:
                return escape
    return None


def growth(C, before, h, centre):
    """The largest alpha with c + alpha (R - c) in R_before, R = {x : C x <= h}, without rounding (eq. StabCondFmin).

    Parameters
    ----------
    C : array (l, 2)
        Rows of both sets, bounded; like the offsets these are the floats they are.
    before, h : array (l,)
        Offsets of R_before and R.
    centre : array (2,)
        c.

    Returns
    -------
    Fraction or None
        None if c is not inside R.
    """
    corners, c, shares = _polygon(Polytope(C, h)), binary(list(centre)), []
    for a, limit in zip(binary(np.asarray(C).tolist()), before.tolist()):
        size = max((dot(a, x) for x in corners), default=dot(a, c)) - dot(a, c)
        if size <= 0:
            return None
        shares.append((binary(limit) - dot(a, c)) / size)
    return fractions([min(shares)])[0]


# -- polygons -----------------------------------------------------------------------------------------


def _clip(corners, a, b):
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


def _clip_all(corners, rows):
    """The part of a polygon in all half-planes (a, b)."""
    for a, b in rows:
        if not corners:
            break
        corners = _clip(corners, a, b)
    return corners


def _hull(points):
    """Corners of the convex hull, counter-clockwise (Andrew's monotone chain)."""
    points = sorted(set(points))
    if len(points) < 3:
        return points

    def chain(points):
        kept = []
        for x in points:
            while len(kept) > 1 and _turn(kept[-2], kept[-1], x) <= 0:
                kept.pop()
            kept.append(x)
        return kept[:-1]

    return chain(points) + chain(points[::-1])


def _turn(x, y, z):
    """Twice the area of the triangle x, y, z: positive if it is counter-clockwise."""
    return (y[0] - x[0]) * (z[1] - x[1]) - (y[1] - x[1]) * (z[0] - x[0])


def _sides(corners):
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


def _less(corners, others):
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


def _less_one(part, sides):
    """The parts of a polygon outside of another: beyond its first side, beyond its second but not its first, ..."""
    dimension, outside = min(len(part), 3), []
    inside = part
    for a, b in sides:
        beyond = [dot(a, x) > b for x in inside]
        if any(beyond):
            outside.append(_clip(inside, tuple(-entry for entry in a), -b))
            inside = _clip(inside, a, b)
            if min(len(inside), 3) < dimension:  # what they share has no interior: all the rest is outside
                return outside
    return outside


def _middle(corners):
    """The mean of the corners."""
    return tuple(sum((x[i] for x in corners), flint().fmpq(0)) / len(corners) for i in range(2))


def _box(corners):
    """A box (left, bottom, right, top) in floats that certainly holds the polygon."""
    x, y = [nearest(point[0]) for point in corners], [nearest(point[1]) for point in corners]
    around = AROUND * (1 + max(abs(min(x)), abs(max(x)), abs(min(y)), abs(max(y))))
    return min(x) - around, min(y) - around, max(x) + around, max(y) + around


def _meeting(boxes, box):
    """Which of several boxes (N, 4) meet a box (4,)."""
    return (boxes[:, :2] <= box[2:]).all(axis=1) & (boxes[:, 2:] >= box[:2]).all(axis=1)


def _escape(mode, image, ends, rest):
    """The step that leads to the middle of `rest`, a part of the image; `ends` says what leads to its corners.

    The middle lies in a triangle of corners of the image, and its state and disturbance lie between theirs
    in the same proportion.
    """
    y = _middle(rest)
    shares = _shares(image, y)
    state, disturbance = (
        tuple(sum((share * ends[corner][which][i] for corner, share in shares), flint().fmpq(0)) for i in range(2))
        for which in (0, 1)
    )
    return Escape(fractions(state), mode, fractions(disturbance), fractions(y))


def _shares(corners, y):
    """Corners of a polygon with non-negative shares that sum to 1 and average to its point y: list of pairs."""
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
def cells(loop):
    """The cells of a closed loop over X, those included that are only an edge or a point of their mode: tuple.

    Raises
    ------
    ValueError
        If the loop has not two states.
    """
    if loop.system.state_size != 2:
        raise ValueError(f'the exact cells need 2 states, but the loop has {loop.system.state_size}; use engine="milp"')
    found, X = [], _polygon(loop.system.state_set)
    pieces = _affine_pieces(loop.network, loop.system.state_set)
    boxes = np.array([_box(corners) for corners, _, _ in pieces])
    for number, mode in enumerate(loop.system.modes):
        A, B, p = (binary(getattr(mode, name).tolist()) for name in "ABp")
        rows = _rows(mode.region)
        of_x = [(a[:2], b) for a, b in rows if not any(a[2:])]
        domain = _clip_all(X, of_x)
        for i in np.flatnonzero(_meeting(boxes, np.array(_box(domain)))) if domain else ():
            corners, K, g = pieces[i]
            corners = _clip_all(corners, of_x)
            if min(len(corners), 3) < min(len(domain), 3):  # Phi is continuous: its neighbours in the mode hold it
                continue
            for a, b in rows:
                if any(a[2:]) and corners:
                    of_u = tuple(dot(a[2:], [row[i] for row in K]) for i in range(2))
                    corners = _clip(corners, (a[0] + of_u[0], a[1] + of_u[1]), b - dot(a[2:], g))
            if corners:
                M = tuple(tuple(A[i][j] + dot(B[i], [row[j] for row in K]) for j in range(2)) for i in range(2))
                c = tuple(dot(B[i], g) + p[i] for i in range(2))
                found.append(ExactCell(corners, number, M, c))
    return tuple(found)


def _heights(loop, V):
    """Floats above v x+ for all x of each whole cell and all d, for the rows v of V: array (cells, k)."""
    _, images, starts = _floats(loop)
    modes = [cell.mode for cell in cells(loop)]
    corners = [np.array([[nearest(entry) for entry in d] for d in one]) for one in disturbances(loop)]
    spread = np.array([(V @ ends.T).max(axis=1) for ends in corners])[modes]
    around = AROUND * (1 + np.abs(images).max(initial=0.0) + np.abs(spread).max()) * (1 + np.abs(V).sum(axis=1))
    return np.maximum.reduceat(images @ V.T, starts) + spread + around


def _near(loop, F):
    """Indices of the cells that floats do not show to lie outside F."""
    points, _, starts = _floats(loop)
    around = AROUND * (1 + np.abs(points).max()) * (1 + np.abs(F.H).sum(axis=1) + np.abs(F.h))
    return np.flatnonzero((np.minimum.reduceat(points @ F.H.T - F.h, starts) <= around).all(axis=1))


@lru_cache(maxsize=32)
def _floats(loop):
    """The corners of all cells and M x + c in them as floats, (T, 2) each, and where each cell's begin (cells,)."""
    corners, images = (
        [[[nearest(entry) for entry in pair] for pair in pairs] for pairs in found]
        for found in zip(*((cell.corners, map(cell.image, cell.corners)) for cell in cells(loop)))
    )
    return np.concatenate(corners), np.concatenate(images), np.cumsum([0, *map(len, corners[:-1])])


def disturbances(loop):
    """The corners of D^(i) of every mode: list of lists of pairs of fmpq.

    Raises
    ------
    ValueError
        If a set is empty without rounding.
    """
    found = {}
    for number, mode in enumerate(loop.system.modes, start=1):
        if mode.disturbance not in found:
            found[mode.disturbance] = _polygon(mode.disturbance)
        if not found[mode.disturbance]:
            raise ValueError(f"the disturbance set of mode {number} is empty in rational arithmetic")
    return [found[mode.disturbance] for mode in loop.system.modes]


def _rows(P):
    """The half-planes (a, b) of a Polytope."""
    return list(zip(binary(P.H.tolist()), binary(P.h.tolist())))


def _polygon(P):
    """The corners of a bounded Polytope of the plane; none if it is empty."""
    rows, one, zero = _rows(P), flint().fmpq(1), flint().fmpq(0)
    H, h = zip(*rows)
    ends = [maximize(H, h, v).value for v in ((one, zero), (zero, one), (-one, zero), (zero, -one))]
    if any(isinstance(end, float) for end in ends):  # -inf: P is empty
        return []
    right, top, left, bottom = ends[0], ends[1], -ends[2], -ends[3]
    return _clip_all(_hull([(left, bottom), (right, bottom), (right, top), (left, top)]), rows)


def highest_inputs(network, X, V):
    """max v Phi(x) over x in X for the rows v of V, without rounding: (fmpq, x) of each, x being a pair of fmpq."""
    best = [None] * len(V)
    for corners, K, g in _affine_pieces(network, X):
        for x in corners:
            u = [dot(row, x) + offset for row, offset in zip(K, g)]
            for k, v in enumerate(V):
                value = dot(v, u)
                if best[k] is None or value > best[k][0]:
                    best[k] = value, x
    return best


@lru_cache(maxsize=32)
def _affine_pieces(network, X):
    """Polygons that cover X, each with K (m pairs) and g (m numbers) of Phi = K x + g on it: list of triples."""
    matrix = flint().fmpq_mat
    pieces = [(_polygon(X), matrix(3, 3, [1, 0, 0, 0, 1, 0, 0, 0, 1]))]  # rows (K, g) of the last layer, below them 1
    for layer in network.hidden:
        weight, following = with_bias(layer.weight, layer.bias), []
        for corners, affine in pieces:
            channels = (weight * affine).tolist()
            parts = [(corners, [])]
            for start in range(0, len(channels), layer.pool):
                neuron = channels[start : start + layer.pool]
                parts = [(part, [*won, *neuron[j]]) for whole, won in parts for part, j in _by_winner(whole, neuron)]
            following += [(part, matrix(layer.width + 1, 3, [*won, 0, 0, 1])) for part, won in parts]
        pieces = following
    weight, found = with_bias(network.weight, network.bias), []
    for corners, affine in pieces:
        output = (weight * affine).tolist()
        found.append((corners, [tuple(row[:2]) for row in output], [row[2] for row in output]))
    return found


def _by_winner(corners, channels):
    """Split a polygon into the parts on which one of the channels (k_1, k_2, g) is largest: list of (part, channel).

    Parts of lower dimension than the polygon are left out: Phi is continuous, and their neighbours hold them.
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
            if i < j and all(dot(a, x) == -b for x in part):  # a tie on all of it: the first channel has it
                part = []
        if len(part) >= min(len(corners), 3):
            found.append((part, j))
    return found
