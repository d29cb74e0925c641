"""The inner loops of the plane, compiled where numba is installed (`compilation`).

Functions of several arrays that belong together take them as one tuple, which becomes a NamedTuple inside: numba needs
several times as long to look at the arguments of a call where these are NamedTuples.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..tolerances import EXPRESSION, NEEDLE_TIP, SMALL_PRODUCTS
from ..typing import Array
from .compilation import Kernel

Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]

EMPTY = 0  # what `polygon` says of a set: see there
DOUBTFUL = 1
FAT = 2


@Kernel
def _exponents(H: Array, h: Array, unit: Ints) -> None:
    """Exponents e of units 2^e for the coordinates, to `unit` (2,): medians of where rows cut the axes.

    They follow the data: another power of two as the unit of a coordinate, or as the factor of a row, changes e
    accordingly, or does not change it.
    """
    known, cuts = np.zeros(2, np.bool_), np.empty(len(h), np.int64)
    for j in range(2):
        count = 0
        for r in range(len(h)):
            if h[r] != 0 and H[r, j] != 0:
                cuts[count] = math.frexp(h[r])[1] - math.frexp(H[r, j])[1]
                count += 1
        if count:
            unit[j], known[j] = np.sort(cuts[:count])[count // 2], True
        else:
            unit[j] = 0
    for j in range(2):
        if known[j] or (j == 0 and not known[1]):
            continue
        count = 0
        for r in range(len(h)):
            if H[r, 0] != 0 and H[r, 1] != 0:
                cuts[count] = math.frexp(H[r, 1 - j])[1] + unit[1 - j] - math.frexp(H[r, j])[1]
                count += 1
        if count:
            unit[j] = np.sort(cuts[:count])[count // 2]


@Kernel
def _in_units(H: Array, h: Array, unit: Ints, row: Array, offset: Array) -> bool:
    """Rows H x <= h for x in units of 2^unit, each scaled by a power of two to entries below 1: row z <= offset.

    Returns False if an offset is too large for that. Rounding occurs only far below `SMALL_PRODUCTS`.
    """
    for r in range(len(h)):
        most = -10000
        for j in range(2):
            if H[r, j] != 0:
                most = max(most, math.frexp(H[r, j])[1] + unit[j])
        if most == -10000:
            row[r, :] = 0.0
            offset[r] = np.sign(h[r])
            continue
        for j in range(2):
            row[r, j] = np.ldexp(H[r, j], unit[j] - most)
        if h[r] != 0 and math.frexp(h[r])[1] - most > 400:
            return False
        offset[r] = np.ldexp(h[r], -most)
    return True


@Kernel
def polygon(H: Array, h: Array, parallel: float, tol: float) -> tuple[int, Array, Array, Array, Array, Ints]:
    """The vertices of {x : H x <= h} in the plane, if its rows leave no half-plane free and it holds a point.

    Parameters
    ----------
    H : array (l, 2)
    h : array (l,)
    parallel : float
        Rows of length about 1 whose determinant is at most this do not meet.
    tol : float
        Vertices closer than this are one, and a vertex is inside if it satisfies the rows to within this (relative to
        the largest coordinates).

    Returns
    -------
    kind : int
        FAT: the set is bounded and has an interior, both certainly, and the vertices are sharp. DOUBTFUL: it may be
        flat, empty, a needle, or far from the origin for its size, or vertices are taken for one that may be two.
        EMPTY: there are no vertices, because the set is empty, perhaps unbounded, or in doubt.
    corners : array (v, 2)
        Counter-clockwise.
    local, row, offset, unit : arrays (v, 2), (l, 2), (l,) and (2,) of int
        The corners and the rows for x in units of 2^unit, rows scaled by powers of two.
    """
    none = np.empty((0, 2))
    unit = np.zeros(2, np.int64)
    row = np.empty(H.shape)
    offset = np.empty(len(h))
    _exponents(H, h, unit)
    local = none
    far = np.zeros(2)
    kind = EMPTY
    for attempt in range(3):
        if not _in_units(H, h, unit, row, offset):
            return EMPTY, none, none, row, offset, unit
        kind, local, far = _corners(row, offset, parallel, tol)
        if not len(local):
            return EMPTY, none, none, row, offset, unit
        good = True
        for j in range(2):
            more = math.frexp(far[j])[1]
            if far[j] > 0 and abs(more) > 6 and attempt < 2:
                unit[j] += more
                good = False
        if good:
            break
    corners = np.empty(local.shape)
    for k in range(len(local)):
        for j in range(2):
            corners[k, j] = np.ldexp(local[k, j], unit[j])
    return kind, corners, local, row, offset, unit


@Kernel
def _corners(row: Array, offset: Array, parallel: float, tol: float) -> tuple[int, Array, Array]:
    """The corners of {z : row z <= offset}: kind, corners (v, 2), and the largest coordinates (2,)."""
    none = np.empty((0, 2))
    if _leaves_a_half_plane(row, offset):
        return EMPTY, none, np.zeros(2)
    found, sine = _meetings(row, offset, parallel, tol)
    if not len(found):
        return EMPTY, none, np.zeros(2)
    far = np.zeros(2)
    least = np.array([np.inf, np.inf])
    most = -least
    for k in range(len(found)):
        for j in range(2):
            far[j] = max(far[j], abs(found[k, j]))
            least[j], most[j] = min(least[j], found[k, j]), max(most[j], found[k, j])
    size = max(far[0], far[1])
    distinct, apart = _merge(found, sine, tol * size)
    local = around(found[:distinct])
    if len(local) < 3 or sine[:distinct].min() < NEEDLE_TIP or (most - least < 1e-3 * far).any() or size > 2.0**64:
        return DOUBTFUL, local, far
    if apart > 2.0**-44 * size:
        return DOUBTFUL, local, far
    x, y = local[:, 0].mean(), local[:, 1].mean()
    for r in range(len(offset)):
        terms = abs(row[r, 0] * x) + abs(row[r, 1] * y) + abs(offset[r])
        if row[r, 0] * x + row[r, 1] * y - offset[r] > -1e-9 * terms:
            return DOUBTFUL, local, far
    return FAT, local, far


@Kernel
def _leaves_a_half_plane(row: Array, offset: Array) -> bool:
    """Whether the normals of the rows leave a half-plane free, so that the set is unbounded, or 0 <= -1 is a row."""
    angle, used = np.empty(len(offset)), 0
    for r in range(len(offset)):
        if row[r, 0] != 0 or row[r, 1] != 0:
            angle[used] = np.arctan2(row[r, 1], row[r, 0])
            used += 1
        elif offset[r] < 0:
            return True
    angle = np.sort(angle[:used])
    for r in range(used):
        following = angle[r + 1] if r + 1 < used else angle[0] + 2 * np.pi
        if following - angle[r] > np.pi - 1e-9:
            return True
    return False


@Kernel
def _meetings(row: Array, offset: Array, parallel: float, tol: float) -> tuple[Array, Array]:
    """Points (k, 2) in which two rows meet and which satisfy all rows to within `tol`, and the sines (k,) there."""
    rows = len(offset)
    found = np.empty((max(rows * (rows - 1) // 2, 1), 2))
    sine = np.empty(len(found))
    count, strict = 0, 0
    for i in range(rows):
        for j in range(i + 1, rows):
            turn = row[i, 0] * row[j, 1] - row[i, 1] * row[j, 0]
            if abs(turn) <= parallel:
                continue
            x, y = 0.0, 0.0
            for _ in range(2):  # the second round takes back what the first one rounded off
                p = offset[i] - row[i, 0] * x - row[i, 1] * y
                q = offset[j] - row[j, 0] * x - row[j, 1] * y
                x, y = x + (p * row[j, 1] - q * row[i, 1]) / turn, y + (q * row[i, 0] - p * row[j, 0]) / turn
            limit, inside = tol * (1 + max(abs(x), abs(y))), True
            for k in range(rows):
                r = (strict + k) % rows  # the row that the last point failed is likely to refuse this one too
                if not row[r, 0] * x + row[r, 1] * y - offset[r] <= limit:
                    inside, strict = False, r
                    break
            if inside:
                found[count, 0], found[count, 1] = x, y
                sine[count] = abs(turn)
                count += 1
    return found[:count], sine[:count]


@Kernel
def _merge(found: Array, sine: Array, limit: float) -> tuple[int, float]:
    """Move the distinct ones of points (k, 2) to the front, each with the largest of its sines (k,).

    Returns how many there are, and how far a point is from the one that stands for it, at most.
    """
    distinct, apart = 0, 0.0
    for k in range(len(found)):
        other = 0
        while other < distinct and max(abs(found[other, 0] - found[k, 0]), abs(found[other, 1] - found[k, 1])) > limit:
            other += 1
        if other < distinct:
            sine[other] = max(sine[other], sine[k])
            apart = max(apart, abs(found[other, 0] - found[k, 0]), abs(found[other, 1] - found[k, 1]))
        else:
            found[distinct, 0], found[distinct, 1] = found[k, 0], found[k, 1]
            sine[distinct] = sine[k]
            distinct += 1
    return distinct, apart


@Kernel
def _tight_pair(v0: float, v1: float, local: Array, row: Array, offset: Array) -> tuple[int, int, int]:
    """A corner that is highest along v, and two rows through it that v lies between, to within rounding: (k, i, j).

    i or j is -1 where there is none.
    """
    best, highest = 0, -np.inf
    for k in range(len(local)):
        height = v0 * local[k, 0] + v1 * local[k, 1]
        if height > highest:
            best, highest = k, height
    x, y = local[best, 0], local[best, 1]
    before, after = -np.inf, np.inf
    i, j = -1, -1
    for r in range(len(offset)):
        if abs(row[r, 0] * x + row[r, 1] * y - offset[r]) > 1e-10 * (1 + abs(x) + abs(y)) or not row[r].any():
            continue
        angle = np.arctan2(v0 * row[r, 1] - v1 * row[r, 0], v0 * row[r, 0] + v1 * row[r, 1])
        if angle <= 0 and (angle > before or (angle == before and offset[r] < offset[i])):
            before, i = angle, r
        if angle > 0 and (angle < after or (angle == after and offset[r] < offset[j])):
            after, j = angle, r
    return best, i, j


@Kernel
def _dual(v0: float, v1: float, local: Array, row: Array, offset: Array) -> tuple[float, float, float]:
    """Weak duality, v x = y row x + (v - row'y) x <= y offset + |v - row'y| |x| for the y >= 0 of two rows.

    Returns y offset and |v - row'y|, both raised by what rounding may have taken from them.
    """
    _, i, j = _tight_pair(v0, v1, local, row, offset)
    if i < 0:
        i = j
    if j < 0:
        j = i
    if i < 0:
        return np.inf, np.inf, np.inf
    a0, a1 = row[i, 0], row[i, 1]
    b0, b1 = row[j, 0], row[j, 1]
    turn = a0 * b1 - a1 * b0
    if i != j and turn != 0:
        p, q = max((v0 * b1 - v1 * b0) / turn, 0.0), max((a0 * v1 - a1 * v0) / turn, 0.0)
    else:
        p, q = max(v0 * a0 + v1 * a1, 0.0) / (a0 * a0 + a1 * a1), 0.0
    value = p * offset[i] + q * offset[j] + EXPRESSION * (abs(p * offset[i]) + abs(q * offset[j])) + SMALL_PRODUCTS
    rest0 = abs(v0 - p * a0 - q * b0) + EXPRESSION * (abs(v0) + abs(p * a0) + abs(q * b0)) + SMALL_PRODUCTS
    rest1 = abs(v1 - p * a1 - q * b1) + EXPRESSION * (abs(v1) + abs(p * a1) + abs(q * b1)) + SMALL_PRODUCTS
    return value, rest0, rest1


@Kernel
def _extent(local: Array, row: Array, offset: Array) -> float:
    """A number that no coordinate of a FAT set exceeds; inf where that is not proven.

    With m the largest coordinate, weak duality along the axes bounds m by y offset + |v - row'y| m.
    """
    most, left = 0.0, 0.0
    for v0, v1 in ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)):
        value, rest0, rest1 = _dual(v0, v1, local, row, offset)
        most, left = max(most, value), max(left, rest0 + rest1)
    return most / (1 - left) * (1 + EXPRESSION) + SMALL_PRODUCTS if left < 0.5 else np.inf


@Kernel
def in_units(v: Array, unit: Ints) -> Array:
    """v (n,) for x in units of 2^unit, scaled by a power of two to entries below 1."""
    most, scaled = -10000, np.zeros(len(v))
    for j in range(len(v)):
        if v[j] != 0:
            most = max(most, math.frexp(v[j])[1] + unit[j])
    for j in range(len(v)):
        if v[j] != 0:
            scaled[j] = np.ldexp(v[j], unit[j] - most)
    return scaled


@Kernel
def inclusion(V: Array, w: Array, local: Array, row: Array, offset: Array, unit: Ints) -> tuple[int, Ints]:
    """Whether v x <= w holds in a FAT set of the plane, for each row v of V: array (k,) of 1, of -1 if not, 0 in doubt.

    1 is proven by weak duality, -1 by a point inside the set that is beyond the row, both with their rounding counted.
    `local`, `row`, `offset`, `unit` are what `polygon` returns. The least of the answers comes first; 1 for no rows.
    """
    answer, extent = np.zeros(len(w), np.int64), _extent(local, row, offset)
    x, y = local[:, 0].mean(), local[:, 1].mean()
    for k in range(len(w)):
        most = -10000
        for j in range(2):
            if V[k, j] != 0:
                most = max(most, math.frexp(V[k, j])[1] + unit[j])
        if most == -10000 or (w[k] != 0 and math.frexp(w[k])[1] - most > 400):
            continue
        v0, v1 = np.ldexp(V[k, 0], unit[0] - most), np.ldexp(V[k, 1], unit[1] - most)
        limit = np.ldexp(w[k], -most)
        value, rest0, rest1 = _dual(v0, v1, local, row, offset)
        value = value + (rest0 + rest1) * extent * (1 + EXPRESSION)
        if value + EXPRESSION * abs(value) + SMALL_PRODUCTS <= limit:
            answer[k] = 1
            continue
        best, _, _ = _tight_pair(v0, v1, local, row, offset)
        x0, x1 = local[best, 0], local[best, 1]
        if v0 * x0 + v1 * x1 - EXPRESSION * (abs(v0 * x0) + abs(v1 * x1)) - SMALL_PRODUCTS <= limit:
            continue
        for shift in (2.0**-40, 2.0**-20):  # a point a little inside
            z0, z1 = x0 + (x - x0) * shift, x1 + (y - x1) * shift
            inside = v0 * z0 + v1 * z1 - EXPRESSION * (abs(v0 * z0) + abs(v1 * z1)) - SMALL_PRODUCTS > limit
            for r in range(len(offset)):
                terms = abs(row[r, 0] * z0) + abs(row[r, 1] * z1) + abs(offset[r])
                inside &= row[r, 0] * z0 + row[r, 1] * z1 - offset[r] + EXPRESSION * terms + SMALL_PRODUCTS <= 0
            if inside:
                answer[k] = -1
                break
    return (answer.min() if len(w) else 1), answer


@Kernel
def dual_bounds(V: Array, local: Array, row: Array, offset: Array, unit: Ints) -> Array:
    """Upper bounds of v x over a FAT set of the plane for each row v of V, by weak duality with its rounding counted.

    The arguments are those of `inclusion`; array (k,).
    """
    bound, extent = np.zeros(len(V)), _extent(local, row, offset)
    for k in range(len(V)):
        most = -10000
        for j in range(2):
            if V[k, j] != 0:
                most = max(most, math.frexp(V[k, j])[1] + unit[j])
        if most > -10000:
            v0, v1 = np.ldexp(V[k, 0], unit[0] - most), np.ldexp(V[k, 1], unit[1] - most)
            value, rest0, rest1 = _dual(v0, v1, local, row, offset)
            value = value + (rest0 + rest1) * extent * (1 + EXPRESSION)
            bound[k] = np.ldexp(value + EXPRESSION * abs(value) + SMALL_PRODUCTS, most)
    return bound


@Kernel
def around(points: Array) -> Array:
    """Points (k, 2) on the boundary of a convex set, counter-clockwise, without those between two others."""
    count = len(points)
    if count < 3:
        return points
    x, y = points[:, 0].mean(), points[:, 1].mean()
    points = points[np.argsort(np.arctan2(points[:, 1] - y, points[:, 0] - x))]
    kept = np.empty(count, np.bool_)
    for k in range(count):
        a, b = points[k - 1], points[k]
        c = points[(k + 1) % count]
        turn = (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0])
        kept[k] = turn > 1e-12 * np.hypot(b[0] - a[0], b[1] - a[1]) * np.hypot(c[0] - b[0], c[1] - b[1])
    if kept.sum() > 2:
        return points[kept]
    far = 0  # the points are collinear: keep the two ends
    for k in range(count):
        if (points[k, 0] - points[0, 0]) ** 2 + (points[k, 1] - points[0, 1]) ** 2 > (
            points[far, 0] - points[0, 0]
        ) ** 2 + (points[far, 1] - points[0, 1]) ** 2:
            far = k
    along = (points[:, 0] - points[0, 0]) * (points[far, 0] - points[0, 0]) + (points[:, 1] - points[0, 1]) * (
        points[far, 1] - points[0, 1]
    )
    return points[np.array([np.argmin(along), np.argmax(along)])]


@Kernel
def hull(points: Array, turn: float) -> Ints:
    """The corners of the convex hull of points (k, 2), sorted by the first coordinate: array (v,) of int.

    Counter-clockwise from the first point, by Andrew's monotone chain. Corners at which the boundary turns by a sine
    of at most `turn` are left out.
    """
    chain, count = np.empty(2 * len(points) + 1, np.int64), 0
    for half in range(2):
        start = count
        for step in range(len(points)):
            k = step if half == 0 else len(points) - 1 - step
            while count >= start + 2:
                a, b = points[chain[count - 2]], points[chain[count - 1]]
                c = points[k]
                sine = (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0])
                if sine > turn * np.hypot(b[0] - a[0], b[1] - a[1]) * np.hypot(c[0] - b[0], c[1] - b[1]):
                    break
                count -= 1
            chain[count] = k
            count += 1
        count -= 1  # the last point of a half is the first one of the other
    return chain[: max(count, 1)].copy()


@Kernel
def membership(x: Array, H: Array, h: Array, tol: Array) -> Ints:
    """Whether H x <= h + tol, tol (l,), for each row of x (N, n): array (N,) of 1, of -1 if not, 0 in doubt."""
    answer = np.ones(len(x), np.int64)
    for k in range(len(x)):
        for r in range(len(h)):
            value, terms = 0.0, abs(h[r]) + abs(tol[r])
            for j in range(x.shape[1]):
                value += H[r, j] * x[k, j]
                terms += abs(H[r, j] * x[k, j])
            value -= h[r] + tol[r]
            doubt = (x.shape[1] + 4) * 2.0**-52 * terms + 2.0**-1060
            if value > doubt:
                answer[k] = -1
                break
            if not value < -doubt:
                answer[k] = 0
    return answer


# -- cutting one polygon ------------------------------------------------------------------------------


class HalfPlane(NamedTuple):
    """a x <= b, the tolerances with which a polygon is cut by it.

    Attributes
    ----------
    a0, a1, b : float
        a has length 1, or is 0.
    slack : float
        The polygon is cut this far beyond the line (a length).
    touch : float
        Where nothing of it is left, corners beyond the line by no more than this stay (a length).
    """

    a0: float
    a1: float
    b: float
    slack: float
    touch: float


@Kernel
def _cut(polygon: Array, size: int, line: HalfPlane, part: Array, excess: Array) -> int:
    """The part a x <= b + slack of a convex polygon; where that is empty, its corners with a x <= b + touch.

    The corners are polygon[:size]; those of the part are written to `part`, and their number is returned: -1 where
    nothing is cut off and `part` is left alone. A corner that is cut anew lies off its edge by rounding alone.
    """
    slack = line.slack
    if 2 * size > len(part):
        raise ValueError("a cell has lost its convexity by rounding")
    least, most = np.inf, -np.inf
    for t in range(size):
        excess[t] = line.a0 * polygon[t, 0] + line.a1 * polygon[t, 1] - line.b
        least, most = min(least, excess[t]), max(most, excess[t])
    if most <= slack:
        return -1
    kept = 0
    if least > slack:
        for t in range(size):
            if excess[t] <= line.touch:
                part[kept, 0], part[kept, 1] = polygon[t, 0], polygon[t, 1]
                kept += 1
        return kept
    for t in range(size):
        after = t + 1 if t + 1 < size else 0
        if excess[t] <= slack:
            part[kept, 0], part[kept, 1] = polygon[t, 0], polygon[t, 1]
            kept += 1
        if (excess[t] <= slack) != (excess[after] <= slack):
            share = min(max((excess[t] - slack) / (excess[t] - excess[after]), 0.0), 1.0)
            x = polygon[t, 0] + share * (polygon[after, 0] - polygon[t, 0])
            y = polygon[t, 1] + share * (polygon[after, 1] - polygon[t, 1])
            end = t if excess[t] <= slack else after
            if polygon[end, 0] != x or polygon[end, 1] != y:
                part[kept, 0], part[kept, 1] = x, y
                kept += 1
    return kept


@Kernel
def _unit_rows(H: Array, h: Array) -> tuple[Array, Array]:
    """The rows H x <= h with normals of length 1; those of zeros stay."""
    H, h = H.copy(), h.copy()
    for r in range(len(h)):
        length = np.hypot(H[r, 0], H[r, 1])
        if length > 0:
            H[r, 0] /= length
            H[r, 1] /= length
            h[r] /= length
    return H, h


@Kernel
def _grown(array: Any, needed: int) -> Any:
    """The array (n, k), or a longer copy of it that has room for `needed` rows."""
    if needed <= len(array):
        return array
    longer = np.empty((max(needed, 2 * len(array)), array.shape[1]), array.dtype)
    for i in range(len(array)):
        for j in range(array.shape[1]):
            longer[i, j] = array[i, j]
    return longer


@Kernel
def _copy(source: Array, first: int, count: int, target: Array, at: int) -> None:
    """target[at : at + count] = source[first : first + count] for points; numba compiles this faster than slices."""
    for t in range(count):
        target[at + t, 0], target[at + t, 1] = source[first + t, 0], source[first + t, 1]


@Kernel
def _most(starts: Ints) -> int:
    """The largest number of corners of a polygon."""
    most = 0
    for i in range(len(starts) - 1):
        most = max(most, starts[i + 1] - starts[i])
    return most


# -- cells --------------------------------------------------------------------------------------------


class Layers(NamedTuple):
    """A maxout network.

    Attributes
    ----------
    weight, bias : array, flat
        Of all layers one after the other, the rows of each in turn; the affine output is the last one, of pool 1.
    sizes : array (l + 2,) of int
        2, the neurons of every layer, and the outputs.
    pools : array (l + 1,) of int
        The channels of a neuron in every layer.
    """

    weight: Array
    bias: Array
    sizes: Ints
    pools: Ints


class Lengths(NamedTuple):
    """Lengths in the plane.

    Attributes
    ----------
    size : float
        Largest coordinate.
    touch : float
        A channel that is ahead of all others by no more than this (a length where channels are steeper than 1) does
        not get a piece.
    corner : float
        How far rounding moves a corner off the edge on which it is made.
    """

    size: float
    touch: float
    corner: float


class Neuron(NamedTuple):
    """The channels of one neuron: row base + j of `affine` (K0, K1, g) and of `error` belongs to channel j."""

    affine: Array
    error: Array
    base: int
    channels: int


class Scratch(NamedTuple):
    """Arrays that functions write to: polygons (r, 2), heights of corners (r,), channels (p,) that may win."""

    part: Array
    spare: Array
    excess: Array
    active: Flags


class Layout(NamedTuple):
    """Where the neurons, channels and weights of each layer begin; x itself comes first, as two neurons."""

    neuron: Ints
    row: Ints
    weight: Ints
    layer_of: Ints


class Values(NamedTuple):
    """What is known on the present polygon.

    Attributes
    ----------
    affine, error, slope : array (rows, 3), (rows,) and (rows,)
        K and g of every channel, their error, and |K|.
    won, unsure : array (neurons,)
        The channel that each neuron takes, and the error of that.
    inputs, doubt : array (widest layer, 3) and (widest layer,)
        K and g of the inputs of the present layer, and their errors.
    """

    affine: Array
    error: Array
    slope: Array
    won: Ints
    unsure: Array
    inputs: Array
    doubt: Array


class Stack(NamedTuple):
    """Polygons that wait, with the neuron, its channel, the number of cuts, the owner and the size of each."""

    entries: Ints
    points: Array
    unsure: Array


@Kernel
def affine_pieces(
    polygons: tuple[Any, ...], network: tuple[Any, ...], lengths: tuple[Any, ...], shaped: int
) -> tuple[Array, Ints, Array]:
    """The pieces of polygons on which a maxout network is affine, with K, g and an error of each.

    Parameters
    ----------
    polygons : (points, starts)
        Convex polygons, as in `polygons.Polygons`: array (T, 2) and (P + 1,) of int.
    network : tuple
        The fields of `Layers`.
    lengths : tuple
        The fields of `Lengths`.
    shaped : int
        Cuts that the polygons themselves count for.

    Returns
    -------
    points : array (S, 2)
        The corners of all pieces, one piece after the other.
    shape : array (N, 3) of int
        How many corners each piece has, the polygon that it is a part of, and how many cuts have shaped it.
    values : array (N, 4 m)
        K (two numbers), g and the error of each output in turn. Every x of the polygons lies in a piece, or within
        its number of cuts times `corner`, such that |K x + g - Phi(x)| is at most the error.

    Notes
    -----
    Depth first: one polygon goes through the neurons, the parts that other channels win wait on a stack. Memory
    grows with the pieces alone, and pieces that follow each other lie near each other.

    The pieces cover the polygons, but for slits: each cut may lose what lies within `corner` of an edge. The error
    adds up along the layers. With E and s the errors and sizes |K| |x| + |g| of a neuron's inputs and u the rounding
    unit, a channel has the error e = |W| (E + (n + 4) 2 u s) + ... A neuron that channel j wins has the error of j, or
    that of another channel c where this one may be ahead: e_c + (z_c - z_j at the corners of the piece, where an affine
    function is largest) + |K_c - K_j| (width of the slits).

    The function is long because splitting it made the cells slower.
    """
    points, starts = polygons
    net, scale = Layers(*network), Lengths(*lengths)
    layers = len(net.pools)
    layout = _layout(net.sizes, net.pools)
    values = _values(layout, max(net.sizes))
    room = 4 * (_most(starts) + len(values.error))
    polygon = np.empty((room, 2))
    pool = max(net.pools)
    scratch = Scratch(np.empty((room, 2)), np.empty((room, 2)), np.empty(room), np.empty(pool, np.bool_))
    z, lead = np.empty((room, pool)), np.empty(pool)
    stack = Stack(np.empty((64, 5), np.int64), np.empty((512, 2)), np.empty((64, 1)))
    found, found_points = np.empty((64, 3), np.int64), np.empty((512, 2))
    found_values = np.empty((64, 4 * net.sizes[-1]))
    depth, top = 0, 0  # of the stack: polygons and their corners
    count, last = 0, 0  # pieces and their corners
    for i in range(len(starts) - 2, -1, -1):
        size = starts[i + 1] - starts[i]
        stack = _pushed(stack, depth, top, points[starts[i] : starts[i + 1]], (1, 1, shaped, i), 0.0)
        depth, top = depth + 1, top + size
    while depth:
        depth -= 1
        neuron, row = stack.entries[depth, 0], stack.entries[depth, 1]
        cuts, owner = stack.entries[depth, 2], stack.entries[depth, 3]
        size = stack.entries[depth, 4]
        top -= size
        _copy(stack.points, top, size, polygon, 0)
        values.won[neuron], values.unsure[neuron] = row, stack.unsure[depth, 0]
        while True:
            neuron += 1
            layer = layout.layer_of[neuron]
            channels = net.pools[layer]
            if neuron == layout.neuron[layer + 1]:  # all inputs of this layer are settled
                _enter_layer(net, layout, values, layer, scale.size)
                if layer == layers - 1:
                    break
            base = layout.row[layer + 1] + (neuron - layout.neuron[layer + 1]) * channels
            own = Neuron(values.affine, values.error, base, channels)
            slits = (cuts + channels) * scale.corner
            best = _nearest_winner(polygon, size, own, z, lead)
            if lead[best] < -scale.touch:
                left = _contenders(polygon, size, own, scale.touch, scratch)
                if left > 1:
                    # where three channels meet, rounding may part what each of them wins: the parts overlap there
                    overlap = scale.corner if left > 2 else 0.0
                    for j in range(channels - 1, -1, -1):
                        if not scratch.active[j]:
                            continue
                        kept = _won(polygon, size, own, j, overlap, scratch)
                        if not kept:
                            continue
                        doubt = _doubt(scratch.part, kept, own, j, slits)
                        entry = (neuron, base + j, cuts + left - 1, owner)
                        stack = _pushed(stack, depth, top, scratch.part[:kept], entry, doubt)
                        depth, top = depth + 1, top + kept
                    break
                for c in range(channels):
                    if scratch.active[c]:
                        best = c
            values.won[neuron] = base + best
            values.unsure[neuron] = _doubt(polygon, size, own, best, slits)
        if neuron != layout.neuron[layers]:
            continue
        found, found_points = _grown(found, count + 1), _grown(found_points, last + size)
        found_values = _grown(found_values, count + 1)
        found[count, 0], found[count, 1] = size, owner
        found[count, 2] = cuts
        _copy(polygon, 0, size, found_points, last)
        for r in range(net.sizes[-1]):
            row = layout.row[layers] + r
            for i in range(3):
                found_values[count, 4 * r + i] = values.affine[row, i]
            found_values[count, 4 * r + 3] = values.error[row]
        count, last = count + 1, last + size
    return found_points[:last].copy(), found[:count].copy(), found_values[:count].copy()


@Kernel
def _layout(sizes: Ints, pools: Ints) -> Layout:
    """The Layout of a network."""
    layers = len(pools)
    neuron, row = np.zeros(layers + 2, np.int64), np.zeros(layers + 2, np.int64)
    weight = np.zeros(layers + 1, np.int64)
    neuron[1] = row[1] = 2
    for l in range(layers):  # noqa: E741
        neuron[l + 2] = neuron[l + 1] + sizes[l + 1]
        row[l + 2] = row[l + 1] + sizes[l + 1] * pools[l]
        weight[l + 1] = weight[l] + sizes[l] * sizes[l + 1] * pools[l]
    layer_of = np.zeros(neuron[layers + 1], np.int64)
    for l in range(layers):  # noqa: E741
        layer_of[neuron[l + 1] : neuron[l + 2]] = l
    return Layout(neuron, row, weight, layer_of)


@Kernel
def _values(layout: Layout, widest: int) -> Values:
    """The Values before the first layer: x itself has K = (1, 0) and (0, 1), without an error."""
    rows, neurons = layout.row[-1], layout.neuron[-1]
    affine, slope = np.zeros((rows, 3)), np.zeros(rows)
    affine[0, 0] = affine[1, 1] = 1.0
    slope[0] = slope[1] = 1.0
    won, unsure = np.zeros(neurons, np.int64), np.zeros(neurons)
    return Values(affine, np.zeros(rows), slope, won, unsure, np.empty((widest, 3)), np.empty(widest))


@Kernel
def _pushed(
    stack: Stack, depth: int, top: int, corners: Array, entry: tuple[int, int, int, int], unsure: float
) -> Stack:
    """The stack with one more polygon, of which (neuron, channel, cuts, owner) are known."""
    size = len(corners)
    entries, points = _grown(stack.entries, depth + 1), _grown(stack.points, top + size)
    errors = _grown(stack.unsure, depth + 1)
    _copy(corners, 0, size, points, top)
    for k in range(4):
        entries[depth, k] = entry[k]
    entries[depth, 4] = size
    errors[depth, 0] = unsure
    return Stack(entries, points, errors)


@Kernel
def _enter_layer(net: Layers, layout: Layout, values: Values, layer: int, size: float) -> None:
    """Write K, g, error and slope of all channels of a layer, whose inputs are settled; `size` bounds coordinates."""
    before = net.sizes[layer]
    channels_before = net.pools[layer - 1] if layer else 1
    affine, error = values.affine, values.error
    inputs, doubt = values.inputs, values.doubt
    start = layout.neuron[layer]
    rounding = 2.0**-52 * (before + 4)
    for i in range(before):
        own = values.won[start + i]
        inputs[i, 0], inputs[i, 1] = affine[own, 0], affine[own, 1]
        inputs[i, 2] = affine[own, 2]
        own, extent = layout.row[layer] + i * channels_before, 0.0
        for r in range(own, own + channels_before):
            extent = max(extent, values.slope[r] * size + abs(affine[r, 2]))
        doubt[i] = values.unsure[start + i] + rounding * extent
    at = layout.weight[layer]
    for r in range(net.sizes[layer + 1] * net.pools[layer]):
        k0, k1 = 0.0, 0.0
        g, summed = 0.0, 0.0
        for i in range(before):
            w = net.weight[at + i]
            k0 += w * inputs[i, 0]
            k1 += w * inputs[i, 1]
            g += w * inputs[i, 2]
            summed += abs(w) * doubt[i]
        at += before
        to = layout.row[layer + 1] + r
        offset = net.bias[to - 2]
        affine[to, 0], affine[to, 1] = k0, k1
        affine[to, 2] = g + offset
        error[to] = summed * (1 + rounding) + rounding * abs(offset)
        values.slope[to] = abs(k0) + abs(k1)


@Kernel
def _nearest_winner(polygon: Array, size: int, neuron: Neuron, z: Array, lead: Array) -> int:
    """The channel that is behind the largest one by least; by how much each is behind, at most, goes to `lead`.

    The channels at the corners go to `z`.
    """
    for c in range(neuron.channels):
        lead[c] = np.inf
    for t in range(size):
        highest_here = -np.inf
        for c in range(neuron.channels):
            z[t, c] = _at(neuron.affine, neuron.base + c, polygon, t)
            highest_here = max(highest_here, z[t, c])
        for c in range(neuron.channels):
            lead[c] = min(lead[c], z[t, c] - highest_here)
    best = 0
    for c in range(1, neuron.channels):
        if lead[c] > lead[best]:
            best = c
    return best


@Kernel
def _at(affine: Array, row: int, polygon: Array, t: int) -> float:
    """K x + g of a channel at a corner."""
    return affine[row, 0] * polygon[t, 0] + affine[row, 1] * polygon[t, 1] + affine[row, 2]


@Kernel
def _won(polygon: Array, size: int, neuron: Neuron, j: int, overlap: float, scratch: Scratch) -> int:
    """The part of a polygon on which channel j is not below the other active ones, to `part`: its number of corners.

    `overlap` is 0 or the rounding of a corner: the part is then wider by what rounding may do to its edges.
    """
    affine, base = neuron.affine, neuron.base
    _copy(polygon, 0, size, scratch.part, 0)
    for i in range(neuron.channels):
        if i == j or not scratch.active[i] or not size:
            continue
        a0, a1 = affine[base + i, 0] - affine[base + j, 0], affine[base + i, 1] - affine[base + j, 1]
        b, steepness = affine[base + j, 2] - affine[base + i, 2], max(np.hypot(a0, a1), 1.0)
        slack = 0.0
        if overlap:
            steep = abs(affine[base + i, 0]) + abs(affine[base + i, 1]) + abs(affine[base + j, 0])
            steep += abs(affine[base + j, 1])
            offsets = abs(affine[base + i, 2]) + abs(affine[base + j, 2])
            slack = overlap * (1 + steep / steepness) + 2.0**-50 * offsets / steepness
        line = HalfPlane(a0 / steepness, a1 / steepness, b / steepness, slack, slack)
        kept = _cut(scratch.part, size, line, scratch.spare, scratch.excess)
        if kept >= 0:
            _copy(scratch.spare, 0, kept, scratch.part, 0)
            size = kept
    return size


@Kernel
def _contenders(polygon: Array, size: int, neuron: Neuron, touch: float, scratch: Scratch) -> int:
    """Leave those channels active that are somewhere ahead of all others by more than `touch`: their number.

    One leaves at a time, the last one first: of equal channels the first stays, and whatever leaves is nowhere ahead
    of those that stay by more than `touch`. At least one stays.
    """
    affine, base = neuron.affine, neuron.base
    left = neuron.channels
    for c in range(neuron.channels):
        scratch.active[c] = True
    for j in range(neuron.channels - 1, -1, -1):
        if left == 1:
            break
        kept, ahead = _won(polygon, size, neuron, j, 0.0, scratch), np.inf
        for i in range(neuron.channels):
            if i == j or not scratch.active[i]:
                continue
            a0, a1 = affine[base + j, 0] - affine[base + i, 0], affine[base + j, 1] - affine[base + i, 1]
            b, most = affine[base + j, 2] - affine[base + i, 2], -np.inf
            for t in range(kept):
                most = max(most, a0 * scratch.part[t, 0] + a1 * scratch.part[t, 1] + b)
            ahead = min(ahead, most / max(np.hypot(a0, a1), 1.0))
        if ahead <= touch:
            scratch.active[j] = False
            left -= 1
    return left


@Kernel
def _doubt(polygon: Array, size: int, neuron: Neuron, j: int, slits: float) -> float:
    """By how much the largest channel may differ from K x + g of channel j within `slits` of a polygon, at most."""
    affine, base = neuron.affine, neuron.base
    most = neuron.error[base + j]
    for c in range(neuron.channels):
        if c == j:
            continue
        a0, a1 = affine[base + c, 0] - affine[base + j, 0], affine[base + c, 1] - affine[base + j, 1]
        b, ahead = affine[base + c, 2] - affine[base + j, 2], -np.inf
        for t in range(size):
            ahead = max(ahead, a0 * polygon[t, 0] + a1 * polygon[t, 1] + b)
        most = max(most, neuron.error[base + c] + ahead + (abs(a0) + abs(a1)) * slits)
    return most


# -- queries ------------------------------------------------------------------------------------------


class Query(NamedTuple):
    """N convex polygons in discs, and half-planes H x <= h that cut them.

    Attributes
    ----------
    points, starts : array (T, 2) and (N + 1,) of int
        The polygons, as in `polygons.Polygons`.
    centres, radii : array (N, 2) and (N,)
        Discs around them.
    mode : array (N,) of int
    H, h : array (l, 2) and (l,)
        Rows of any length.
    only : array (l,) of int
        The mode whose polygons a row cuts; -1 for all.
    slack : float
        Polygons are cut this far beyond each row (a length).
    touch : float
        Closed sets that come this close (a length) touch.
    """

    points: Array
    starts: Ints
    centres: Array
    radii: Array
    mode: Ints
    H: Array
    h: Array
    only: Ints
    slack: float
    touch: float


class Maps(NamedTuple):
    """The map on each of N polygons, and what is known of its maxima along k rows of V.

    Attributes
    ----------
    M, c : array (N, 2, 2) and (N, 2)
        x+ = M x + c.
    error : array (N, 2)
        Of the map, by component.
    spread : array (s, k)
        h of D^(i) along the rows of V.
    heights, tops : array (N, k)
        The maximum over each whole polygon, and with its error.
    V : array (k, 2)
    """

    M: Array
    c: Array
    error: Array
    spread: Array
    heights: Array
    tops: Array
    V: Array


@Kernel
def sharp_pairs(
    H: Array, h: Array, walls_H: Array, walls_h: Array, reach: float, parallel: float, sharp: float
) -> Ints:
    """Pairs of half-planes whose strip between them narrows to a sharp tip, unless that is certainly out of reach.

    Parameters
    ----------
    H, h : array (l, 2) and (l,)
    walls_H, walls_h : array (w, 2) and (w,)
        Rows like them; pairs of two walls are left out.
    reach : float
        Tips farther than this from the origin do not matter.
    parallel, sharp : float
        Between which the sine of the angle at the tip lies.

    Returns
    -------
    array (p, 2) of int
        The two rows; those from l on are walls.
    """
    rows, count = len(h), 0
    pairs = np.empty((4, 2), np.int64)
    H, h = _unit_rows(np.concatenate((H, walls_H)), np.concatenate((h, walls_h)))
    for r in range(rows):
        a, b = H[r, 0], H[r, 1]
        for s in range(r + 1, len(h)):
            c, d = H[s, 0], H[s, 1]
            turn = abs(a * d - b * c)
            if turn > sharp or turn <= parallel or a * c + b * d >= 0:
                continue
            far = 2 * reach * turn + 1e-14 * (abs(h[r]) + abs(h[s]))
            if abs(h[r] * d - h[s] * b) <= far and abs(a * h[s] - c * h[r]) <= far:
                pairs = _grown(pairs, count + 1)
                pairs[count, 0], pairs[count, 1] = r, s
                count += 1
    return pairs[:count]


class Disc(NamedTuple):
    """A disc that holds a polygon, and the mode of that polygon."""

    x: float
    y: float
    radius: float
    mode: int


class Lines(NamedTuple):
    """The half-planes of a Query, with rows of length 1."""

    H: Array
    h: Array
    only: Ints
    slack: float
    touch: float


@Kernel
def _side(disc: Disc, lines: Lines) -> int:
    """1 if a disc lies within the half-planes that cut its polygon, -1 if it misses them, else 0."""
    side = 1
    for r in range(len(lines.h)):
        if lines.only[r] < 0 or lines.only[r] == disc.mode:
            beyond = lines.H[r, 0] * disc.x + lines.H[r, 1] * disc.y - lines.h[r]
            if beyond > disc.radius + lines.touch:
                return -1
            if beyond > -disc.radius:
                side = 0
    return side


@Kernel
def _clip(polygon: Array, size: int, disc: Disc, lines: Lines, part: Array, excess: Array) -> int:
    """Cut polygon[:size], which lies in a disc, by half-planes, in its place: the number of corners that are left."""
    for r in range(len(lines.h)):
        a0, a1 = lines.H[r, 0], lines.H[r, 1]
        applies = lines.only[r] < 0 or lines.only[r] == disc.mode
        if applies and a0 * disc.x + a1 * disc.y - lines.h[r] > -disc.radius:
            line = HalfPlane(a0, a1, lines.h[r], lines.slack, lines.touch)
            kept = _cut(polygon, size, line, part, excess)
            if kept >= 0:
                _copy(part, 0, kept, polygon, 0)
                size = kept
    return size


@Kernel
def parts(query: tuple[Any, ...]) -> tuple[Array, Ints, Ints]:
    """The parts of N convex polygons in {x : H x <= h}.

    Parameters
    ----------
    query : tuple
        The fields of `Query`.

    Returns
    -------
    points, starts : array (S, 2) and (p + 1,) of int
    owner : array (p,) of int
        The polygon that each part comes from.
    """
    asked = Query(*query)
    H, h = _unit_rows(asked.H, asked.h)
    lines = Lines(H, h, asked.only, asked.slack, asked.touch)
    polygons = len(asked.mode)
    room = 2 * (_most(asked.starts) + 2 * len(h)) if polygons else 0
    polygon, spare = np.empty((room, 2)), np.empty((room, 2))
    excess = np.empty(room)
    found, ends = np.empty((len(asked.points), 2)), np.zeros(polygons + 1, np.int64)
    owner, count = np.empty(polygons, np.int64), 0
    for j in range(polygons):
        disc = Disc(asked.centres[j, 0], asked.centres[j, 1], asked.radii[j], asked.mode[j])
        side = _side(disc, lines)
        if side < 0:
            continue
        size = asked.starts[j + 1] - asked.starts[j]
        _copy(asked.points, asked.starts[j], size, polygon, 0)
        if side == 0:
            size = _clip(polygon, size, disc, lines, spare, excess)
        if size:
            found = _grown(found, ends[count] + size)
            _copy(polygon, 0, size, found, ends[count])
            ends[count + 1], owner[count] = ends[count] + size, j
            count += 1
    return found[: ends[count]].copy(), ends[: count + 1].copy(), owner[:count].copy()


@Kernel
def highest(query: tuple[Any, ...], maps: tuple[Any, ...], chosen: Ints) -> tuple[Array, Array, Ints, Ints]:
    """max v (M_j x + c_j) + h of D over the parts of N convex polygons in {x : H x <= h}.

    Parameters
    ----------
    query : tuple
        The fields of `Query`.
    maps : tuple
        The fields of `Maps`.
    chosen : array (p,) of int
        The polygons to look at.

    Returns
    -------
    value : array (k,)
        -inf if no polygon meets the set.
    top : array (k,)
        The largest value with the error of its polygon.
    owner : array (k,) of int
        The polygon that has it.
    left : array (q,) of int
        The chosen polygons without those that were found to miss the set.
    """
    asked, on = Query(*query), Maps(*maps)
    H, h = _unit_rows(asked.H, asked.h)
    lines = Lines(H, h, asked.only, asked.slack, asked.touch)
    V = on.V
    M, c = on.M, on.c
    directions = len(V)
    top, value = np.full(directions, -np.inf), np.full(directions, -np.inf)
    owner = np.zeros(directions, np.int64)
    room = 2 * (_most(asked.starts) + 2 * len(h))
    polygon, part = np.empty((room, 2)), np.empty((room, 2))
    excess = np.empty(room)
    left, count = np.empty(len(chosen), np.int64), 0
    for i in range(len(chosen)):
        j = left[count] = chosen[i]
        count += 1
        for k in range(directions):
            if on.tops[j, k] > top[k]:
                break
        else:
            continue
        disc = Disc(asked.centres[j, 0], asked.centres[j, 1], asked.radii[j], asked.mode[j])
        side = _side(disc, lines)
        if side > 0:
            for k in range(directions):
                if on.tops[j, k] > top[k]:
                    top[k], value[k] = on.tops[j, k], on.heights[j, k]
                    owner[k] = j
        elif side < 0:
            count -= 1
        if side != 0:
            continue
        size = asked.starts[j + 1] - asked.starts[j]
        _copy(asked.points, asked.starts[j], size, polygon, 0)
        size = _clip(polygon, size, disc, lines, part, excess)
        for t in range(size):
            x = M[j, 0, 0] * polygon[t, 0] + M[j, 0, 1] * polygon[t, 1] + c[j, 0]
            y = M[j, 1, 0] * polygon[t, 0] + M[j, 1, 1] * polygon[t, 1] + c[j, 1]
            for k in range(directions):
                reached = V[k, 0] * x + V[k, 1] * y + on.spread[asked.mode[j], k]
                above = reached + abs(V[k, 0]) * on.error[j, 0] + abs(V[k, 1]) * on.error[j, 1]
                if above > top[k]:
                    top[k], value[k] = above, reached
                    owner[k] = j
    return value, top, owner, left[:count].copy()
