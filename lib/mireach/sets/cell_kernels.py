"""The inner loops of cell complexes in R^n, compiled where numba is installed (`compilation`).

A cell is a polytope {x : a x <= b for its rows (a, b)}. It is kept with its vertices, and each vertex with a bit mask
of the rows that are tight there. Vertices are computed in floats and only propose: whatever is left out is proven by
weak duality from the rows, with its rounding counted (`_upper`).

Arrays that belong together are passed as one tuple, which becomes a NamedTuple inside: numba needs several times as
long to look at the arguments of a call where these are NamedTuples. `Layers` and its layout stand in `kernels`, too,
since kernels cannot be called across files (`compilation.Kernel`).
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..tolerances import ROUNDOFF, TIE, TOUCH
from ..typing import Array
from .compilation import Kernel

Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]

WORD = 62  # rows that one integer of a mask stands for
PIVOTS = 50  # exchanges of rows in the search for multipliers at a vertex with more than n tight rows

DONE = 0  # what a kernel says of its run: see `Storage`
NO_ROOM = 1
NO_WORDS = 2
TOO_MANY = 3

WHOLE = 0  # what `_clip` and `_cut` say of a cell: nothing is cut off, a part is left, nothing is left
CUT = 1
EMPTY = 2
OVERFULL = 3  # there is no room for another vertex
OVERBITS = 4  # there is no bit for another row


class Storage(NamedTuple):
    """Room for one cell.

    Attributes
    ----------
    room : int
        Vertices; where a cell has more, a kernel returns NO_ROOM.
    words : int
        Integers per mask; where a cell has more than `WORD` rows for each, a kernel returns NO_WORDS.
    limit : int
        Cells; where there are more, a kernel returns TOO_MANY.
    """

    room: int
    words: int
    limit: int


class Cell(NamedTuple):
    """The cell that is worked on.

    Attributes
    ----------
    points : array (room, n)
        Its vertices, the first used[0] of them.
    masks : array (room, words) of int
        Bit r of the mask of a vertex says that row r is tight there.
    rows : array (WORD words, n + 1)
        Rows (a, b) with a largest entry of a between 1/2 and 1, the first used[1] of them. Those whose bit no vertex
        has are free.
    box : array (2, n)
        Lower and upper limits, proven, of the coordinates.
    used : array (2,) of int
        How many vertices and rows there are.
    """

    points: Array
    masks: Ints
    rows: Array
    box: Array
    used: Ints


class Work(NamedTuple):
    """Scratch of the functions that work on one cell.

    Attributes
    ----------
    excess : array (room,)
        a x - b at the vertices.
    simple : array (room,) of bool
        Vertices at which exactly n rows are tight.
    tight, basis : array (WORD words,) and (n,) of int
        Rows that are tight at a vertex, and n independent ones of them.
    matrix : array (n, n + 1)
    y : array (n,)
        Multipliers of the rows of the basis.
    a : array (n,)
        An objective.
    row : array (n + 1,)
    extent : array (n,)
        No coordinate of any cell exceeds it in size.
    """

    excess: Array
    simple: Flags
    tight: Ints
    basis: Ints
    matrix: Array
    y: Array
    a: Array
    row: Array
    extent: Array


class Pool(NamedTuple):
    """Cells one after the other.

    Attributes
    ----------
    points, masks : array (T, n) and (T, words)
    rows : array (S, n + 1)
    boxes : array (N, 2 n)
    counts : array (N, 2) of int
        Vertices and rows of each cell.
    info : array (N, 3) of int
    doubt : array (N, 1)
    """

    points: Array
    masks: Ints
    rows: Array
    boxes: Array
    counts: Ints
    info: Ints
    doubt: Array


# -- one cell -----------------------------------------------------------------------------------------


@Kernel
def _new_cell(n: int, storage: Storage) -> Cell:
    """An empty Cell."""
    bits = WORD * storage.words
    masks = np.zeros((storage.room, storage.words), np.int64)
    used = np.zeros(2, np.int64)
    return Cell(np.empty((storage.room, n)), masks, np.zeros((bits, n + 1)), np.empty((2, n)), used)


@Kernel
def _new_work(extent: Array, storage: Storage) -> Work:
    """Scratch for cells of the same size."""
    n = len(extent)
    tight, basis = np.empty(WORD * storage.words, np.int64), np.empty(n, np.int64)
    simple = np.empty(storage.room, np.bool_)
    return Work(
        np.empty(storage.room), simple, tight, basis, np.empty((n, n + 1)), np.empty(n), np.empty(n), np.empty(n + 1),
        extent,
    )  # fmt: skip


@Kernel
def _copied(source: Cell, target: Cell) -> None:
    """Make `target` the same cell as `source`."""
    n, words = source.points.shape[1], source.masks.shape[1]
    for t in range(source.used[0]):
        for i in range(n):
            target.points[t, i] = source.points[t, i]
        for k in range(words):
            target.masks[t, k] = source.masks[t, k]
    for r in range(source.used[1]):
        for i in range(n + 1):
            target.rows[r, i] = source.rows[r, i]
    for i in range(n):
        target.box[0, i], target.box[1, i] = source.box[0, i], source.box[1, i]
    target.used[0], target.used[1] = source.used[0], source.used[1]


@Kernel
def _free_row(cell: Cell) -> int:
    """A row whose bit no vertex has; -1 if there is none."""
    for k in range(cell.masks.shape[1]):
        used = np.int64(0)
        for t in range(cell.used[0]):
            used |= cell.masks[t, k]
        for bit in range(WORD):
            if not (used >> bit) & 1:
                return k * WORD + bit
    return -1


@Kernel
def _ones(bits: int) -> int:
    """The number of ones of a mask; compiled, one instruction."""
    count = 0
    while bits:
        bits &= bits - 1
        count += 1
    return count


@Kernel
def _is_simple(masks: Ints, t: int, n: int) -> bool:
    """Whether exactly n rows are tight at a vertex."""
    count = 0
    for k in range(masks.shape[1]):
        count += _ones(masks[t, k])
    return count == n


@Kernel
def _has_third(masks: Ints, size: int, u: int, w: int) -> bool:
    """Whether a third of the first `size` vertices has all the rows tight that both u and w have."""
    words = masks.shape[1]
    for t in range(size):
        if t == u or t == w:
            continue
        k = 0
        while k < words and masks[u, k] & masks[w, k] & ~masks[t, k] == 0:
            k += 1
        if k == words:
            return True
    return False


@Kernel
def _clip(cell: Cell, row: Array, work: Work) -> int:
    """Cut a cell by a x <= b, in its place: WHOLE, CUT, EMPTY, OVERFULL or OVERBITS.

    Vertices within `TIE` of the hyperplane count as lying on it. A new vertex lies on every edge that crosses it. Two
    vertices share an edge if no third one has all the rows tight that both of them have; at a vertex with exactly n
    tight rows, any n - 1 of them make an edge. EMPTY leaves the cell as it is, with the distances of its vertices in
    work.excess.
    """
    points, masks = cell.points, cell.masks
    excess, simple = work.excess, work.simple
    n = points.shape[1]
    size = cell.used[0]
    words = masks.shape[1]
    least, most = np.inf, -np.inf
    for t in range(size):
        excess[t] = -row[n]
        for i in range(n):
            excess[t] += row[i] * points[t, i]
        least, most = min(least, excess[t]), max(most, excess[t])
    if most <= TIE:
        return WHOLE
    if least > TIE:
        return EMPTY
    slot = _free_row(cell)
    if slot < 0:
        return OVERBITS
    word, bit = slot // WORD, np.int64(1) << (slot % WORD)
    for t in range(size):
        simple[t] = _is_simple(masks, t, n)
    last = size
    for u in range(size):
        if excess[u] >= -TIE:
            continue
        for w in range(size):
            if excess[w] <= TIE:
                continue
            common = 0
            for k in range(words):
                common += _ones(masks[u, k] & masks[w, k])
            if common < n - 1 or (not simple[u] and not simple[w] and _has_third(masks, size, u, w)):
                continue
            if last == len(points):
                return OVERFULL
            share = excess[u] / (excess[u] - excess[w])
            for i in range(n):
                points[last, i] = points[u, i] + share * (points[w, i] - points[u, i])
            for k in range(words):
                masks[last, k] = masks[u, k] & masks[w, k]
            masks[last, word] |= bit
            last += 1
    kept = 0
    for t in range(last):
        if t < size:
            if excess[t] > TIE:
                continue
            if excess[t] >= -TIE:
                masks[t, word] |= bit
        for i in range(n):
            points[kept, i] = points[t, i]
        for k in range(words):
            masks[kept, k] = masks[t, k]
        kept += 1
    for i in range(n + 1):
        cell.rows[slot, i] = row[i]
    cell.used[0], cell.used[1] = kept, max(cell.used[1], slot + 1)
    return CUT


@Kernel
def _cut(cell: Cell, row: Array, work: Work) -> int:
    """As `_clip`, but EMPTY is proven; where it cannot be proven, the vertex that is nearest stays."""
    found = _clip(cell, row, work)
    if found != EMPTY:
        return found
    n, nearest = len(work.a), np.argmin(work.excess[: cell.used[0]])
    for i in range(n):
        work.a[i] = -row[i]
    if _upper(cell, nearest, work.a, work) < -row[n]:
        return EMPTY
    slot = _free_row(cell)
    if slot < 0:
        return OVERBITS
    for i in range(n):
        cell.points[0, i] = cell.points[nearest, i]
    for k in range(cell.masks.shape[1]):
        cell.masks[0, k] = cell.masks[nearest, k]
    cell.masks[0, slot // WORD] |= np.int64(1) << (slot % WORD)
    for i in range(n + 1):
        cell.rows[slot, i] = row[i]
    cell.used[0], cell.used[1] = 1, max(cell.used[1], slot + 1)
    return CUT


@Kernel
def _tight_rows(cell: Cell, v: int, tight: Ints) -> int:
    """Write the rows that are tight at vertex v to `tight`: their number."""
    count = 0
    for k in range(cell.masks.shape[1]):
        left, bit = cell.masks[v, k], 0
        while left:
            if left & 1:
                tight[count] = k * WORD + bit
                count += 1
            left >>= 1
            bit += 1
    return count


@Kernel
def _independent(cell: Cell, count: int, work: Work) -> bool:
    """Choose n independent rows of the `count` tight ones as basis, each the farthest from the span of those before."""
    n = len(work.a)
    rest = np.empty((count, n))
    for r in range(count):
        for i in range(n):
            rest[r, i] = cell.rows[work.tight[r], i]
    for k in range(n):
        best, most = -1, 1e-20
        for r in range(count):
            length = 0.0
            for i in range(n):
                length += rest[r, i] * rest[r, i]
            if length > most:
                best, most = r, length
        if best < 0:
            return False
        work.basis[k] = work.tight[best]
        for r in range(count):
            if r != best:
                along = 0.0
                for i in range(n):
                    along += rest[r, i] * rest[best, i]
                for i in range(n):
                    rest[r, i] -= along / most * rest[best, i]
        for i in range(n):
            rest[best, i] = 0.0
    return True


@Kernel
def _eliminated(matrix: Array, y: Array) -> bool:
    """Solve matrix[:, :n] y = matrix[:, n] by elimination, which changes the matrix; False if it is singular."""
    n = len(y)
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(matrix[i, k]) > abs(matrix[pivot, k]):
                pivot = i
        if not abs(matrix[pivot, k]) > 1e-14:
            return False
        if pivot != k:
            for j in range(k, n + 1):
                matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
        for i in range(k + 1, n):
            share = matrix[i, k] / matrix[k, k]
            for j in range(k + 1, n + 1):
                matrix[i, j] -= share * matrix[k, j]
    for k in range(n - 1, -1, -1):
        value = matrix[k, n]
        for j in range(k + 1, n):
            value -= matrix[k, j] * y[j]
        y[k] = value / matrix[k, k]
    return True


@Kernel
def _multipliers(cell: Cell, a: Array, work: Work) -> bool:
    """Write y with sum of y_k a_k = a over the rows a_k of the basis to work.y; False if they are dependent."""
    n = len(a)
    for i in range(n):
        for k in range(n):
            work.matrix[i, k] = cell.rows[work.basis[k], i]
        work.matrix[i, n] = a[i]
    return _eliminated(work.matrix, work.y)


@Kernel
def _entering(cell: Cell, leaving: int, count: int, work: Work) -> int:
    """The first tight row that stops the edge on which all rows of the basis but one stay tight; -1 if none does."""
    n = len(work.a)
    for k in range(n):
        for i in range(n):
            work.matrix[k, i] = cell.rows[work.basis[k], i]
        work.matrix[k, n] = -1.0 if k == leaving else 0.0
    edge = np.empty(n)
    if not _eliminated(work.matrix, edge):
        return -1
    length = 0.0
    for i in range(n):
        length = max(length, abs(edge[i]))
    for r in range(count):
        row, rise = work.tight[r], 0.0
        for i in range(n):
            rise += cell.rows[row, i] * edge[i]
        if rise > 1e-10 * length:
            return row
    return -1


@Kernel
def _upper(cell: Cell, v: int, a: Array, work: Work) -> float:
    """Upper bound of a x over a cell, from the rows that are tight at vertex v; good if v is highest along a.

    Weak duality: for y >= 0, a x = y A x + (a - A'y) x <= y b + |a - A'y| |x|. The simplex method with Bland's rule
    finds y on the cone of the tight rows. The bound holds whatever y it ends with: its rounding is counted.
    """
    n, most = len(a), 0.0
    for i in range(n):
        most = max(most, abs(a[i]))
    if most == 0:
        return 0.0
    count = _tight_rows(cell, v, work.tight)
    if count < n:
        return np.inf
    if count == n:
        for k in range(n):
            work.basis[k] = work.tight[k]
    elif not _independent(cell, count, work):
        return np.inf
    y = work.y
    for attempt in range(PIVOTS):
        if not _multipliers(cell, a, work):
            return np.inf
        leaving = -1
        if count > n and attempt < PIVOTS - 1:
            for k in range(n):
                if y[k] < -1e-13 * most and (leaving < 0 or work.basis[k] < work.basis[leaving]):
                    leaving = k
        if leaving < 0:
            break
        row = _entering(cell, leaving, count, work)
        if row < 0:
            break
        work.basis[leaving] = row
    value = 0.0
    terms = 0.0
    rest = 0.0
    for k in range(n):
        y[k] = max(y[k], 0.0)
        value += y[k] * cell.rows[work.basis[k], n]
        terms += abs(y[k] * cell.rows[work.basis[k], n])
    for i in range(n):
        left, size = a[i], abs(a[i])
        for k in range(n):
            part = y[k] * cell.rows[work.basis[k], i]
            left -= part
            size += abs(part)
        rest += (abs(left) + (n + 4) * ROUNDOFF * size) * work.extent[i]
    return value + (n + 4) * ROUNDOFF * (terms + rest) + rest + 1e-300


@Kernel
def _fit_box(cell: Cell, work: Work) -> None:
    """Tighten the box of a cell to proven limits of its coordinates."""
    for i in range(cell.points.shape[1]):
        low, high = 0, 0
        for t in range(cell.used[0]):
            if cell.points[t, i] < cell.points[low, i]:
                low = t
            if cell.points[t, i] > cell.points[high, i]:
                high = t
        for j in range(len(work.a)):
            work.a[j] = 0.0
        work.a[i] = 1.0
        cell.box[1, i] = min(cell.box[1, i], _upper(cell, high, work.a, work))
        work.a[i] = -1.0
        cell.box[0, i] = max(cell.box[0, i], -_upper(cell, low, work.a, work))


@Kernel
def _scale_row(row: Array) -> None:
    """Scale a row (a, b) by a power of two, so that the largest entry of a lies between 1/2 and 1."""
    n, most = len(row) - 1, 0.0
    for i in range(n):
        most = max(most, abs(row[i]))
    if most > 0:
        exponent = math.frexp(most)[1]
        for i in range(n + 1):
            row[i] = np.ldexp(row[i], -exponent)


# -- many cells ---------------------------------------------------------------------------------------


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
def _new_pool(n: int, words: int) -> Pool:
    """A Pool without cells."""
    points, masks = np.empty((256, n)), np.empty((256, words), np.int64)
    counts, info = np.empty((16, 2), np.int64), np.empty((16, 3), np.int64)
    return Pool(points, masks, np.empty((256, n + 1)), np.empty((16, 2 * n)), counts, info, np.empty((16, 1)))


@Kernel
def _stored(pool: Pool, at: Ints, cell: Cell, info: tuple[int, int, int], doubt: float) -> Pool:
    """The pool with one more cell; at (3,) counts its cells, vertices and rows."""
    n, words = cell.points.shape[1], cell.masks.shape[1]
    size, used = cell.used[0], cell.used[1]
    number = at[0]
    top = at[1]
    low = at[2]
    points, masks = _grown(pool.points, top + size), _grown(pool.masks, top + size)
    rows, boxes = _grown(pool.rows, low + used), _grown(pool.boxes, number + 1)
    counts, notes = _grown(pool.counts, number + 1), _grown(pool.info, number + 1)
    errors = _grown(pool.doubt, number + 1)
    for t in range(size):
        for i in range(n):
            points[top + t, i] = cell.points[t, i]
        for k in range(words):
            masks[top + t, k] = cell.masks[t, k]
    for r in range(used):
        for i in range(n + 1):
            rows[low + r, i] = cell.rows[r, i]
    for i in range(n):
        boxes[number, i], boxes[number, n + i] = cell.box[0, i], cell.box[1, i]
    counts[number, 0], counts[number, 1] = size, used
    for k in range(3):
        notes[number, k] = info[k]
    errors[number, 0] = doubt
    at[0], at[1] = number + 1, top + size
    at[2] = low + used
    return Pool(points, masks, rows, boxes, counts, notes, errors)


@Kernel
def _loaded(pool: Pool, number: int, top: int, low: int, cell: Cell) -> bool:
    """Copy a cell of a pool, with vertices from `top` and rows from `low`, to `cell`; False if it has no room."""
    n, words = pool.points.shape[1], pool.masks.shape[1]
    size, used = pool.counts[number, 0], pool.counts[number, 1]
    if size > len(cell.points):
        return False
    for t in range(size):
        for i in range(n):
            cell.points[t, i] = pool.points[top + t, i]
        for k in range(words):
            cell.masks[t, k] = pool.masks[top + t, k]
        for k in range(words, cell.masks.shape[1]):
            cell.masks[t, k] = 0
    for r in range(used):
        for i in range(n + 1):
            cell.rows[r, i] = pool.rows[low + r, i]
    for i in range(n):
        cell.box[0, i], cell.box[1, i] = pool.boxes[number, i], pool.boxes[number, n + i]
    cell.used[0], cell.used[1] = size, used
    return True


@Kernel
def _results(pool: Pool, at: Ints) -> tuple[Any, ...]:
    """The arrays of a pool without their spare room."""
    number = at[0]
    top = at[1]
    low = at[2]
    return (
        pool.points[:top].copy(),
        pool.masks[:top].copy(),
        pool.rows[:low].copy(),
        pool.boxes[:number].copy(),
        pool.counts[:number].copy(),
        pool.info[:number].copy(),
        pool.doubt[:number].copy(),
    )


@Kernel
def clipped(
    cells: tuple[Any, ...], rows: Array, first: Ints, last: Ints, extent: Array, storage: tuple[int, int, int]
) -> tuple[Any, ...]:
    """The parts of cells in half-spaces.

    Parameters
    ----------
    cells : tuple
        The fields of `Pool`, of N cells.
    rows : array (S, n + 1)
        Half-spaces (a, b).
    first, last : array (N,) of int
        Those of the rows that cut each cell: rows[first : last].
    extent : array (n,)
        No coordinate of any cell exceeds it.
    storage : tuple
        The fields of `Storage`.

    Returns
    -------
    status : int
        DONE, NO_ROOM or NO_WORDS.
    tuple
        The fields of a `Pool`; info (N, 3) begins with the number of the cell that each part comes from.
    """
    pool, n = Pool(*cells), len(extent)
    store = Storage(*storage)
    cell, work = _new_cell(n, store), _new_work(extent, store)
    found, at = _new_pool(n, store.words), np.zeros(3, np.int64)
    row = np.empty(n + 1)
    top, low = 0, 0
    for j in range(len(pool.counts)):
        if not _loaded(pool, j, top, low, cell):
            return NO_ROOM, _results(found, at)
        top += pool.counts[j, 0]
        low += pool.counts[j, 1]
        said = WHOLE
        for r in range(first[j], last[j]):
            side = _side(rows[r], pool.boxes[j])
            if side > 0:
                continue
            if side < 0:
                said = EMPTY
                break
            for i in range(n + 1):
                row[i] = rows[r, i]
            _scale_row(row)
            now = _cut(cell, row, work)
            if now == OVERFULL:
                return NO_ROOM, _results(found, at)
            if now == OVERBITS:
                return NO_WORDS, _results(found, at)
            if now == EMPTY:
                said = EMPTY
                break
            if now == CUT:
                said = CUT
        if said == EMPTY:
            continue
        if said == CUT:
            _fit_box(cell, work)
        found = _stored(found, at, cell, (j, pool.info[j, 1], pool.info[j, 2]), pool.doubt[j, 0])
    return DONE, _results(found, at)


@Kernel
def _side(row: Array, box: Array) -> int:
    """1 if a box lies in a half-space, -1 if it misses it, 0 if neither is certain."""
    n = len(row) - 1
    low = -row[n]
    high = -row[n]
    terms = abs(row[n])
    for i in range(n):
        p, q = row[i] * box[i], row[i] * box[n + i]
        low += min(p, q)
        high += max(p, q)
        terms += max(abs(p), abs(q))
    rounding = (n + 4) * ROUNDOFF * terms
    if high + rounding <= 0:
        return 1
    return -1 if low - rounding > 0 else 0


# -- the pieces of a network --------------------------------------------------------------------------


class Layers(NamedTuple):
    """A maxout network.

    Attributes
    ----------
    weight, bias : array, flat
        Of all layers one after the other, the rows of each in turn; the affine output is the last one, of pool 1.
    sizes : array (l + 2,) of int
        n, the neurons of every layer, and the outputs.
    pools : array (l + 1,) of int
        The channels of a neuron in every layer.
    """

    weight: Array
    bias: Array
    sizes: Ints
    pools: Ints


class Layout(NamedTuple):
    """Where the neurons, channels and weights of each layer begin; x itself comes first, as n neurons."""

    neuron: Ints
    row: Ints
    weight: Ints
    layer_of: Ints


class Values(NamedTuple):
    """What is known on the present cell.

    Attributes
    ----------
    affine, error, slope : array (channels, n + 1), (channels,) and (channels,)
        K and g of every channel, their error, and a bound of |K x|.
    won, unsure : array (neurons,)
        The channel that each neuron takes, and the error of that.
    inputs, doubt : array (widest layer, n + 1) and (widest layer,)
        K and g of the inputs of the present layer, and their errors.
    active : array (pool,) of bool
        Channels of the present neuron that may be the largest.
    """

    affine: Array
    error: Array
    slope: Array
    won: Ints
    unsure: Array
    inputs: Array
    doubt: Array
    active: Flags


@Kernel
def _layout(sizes: Ints, pools: Ints) -> Layout:
    """The Layout of a network."""
    layers = len(pools)
    neuron, row = np.zeros(layers + 2, np.int64), np.zeros(layers + 2, np.int64)
    weight = np.zeros(layers + 1, np.int64)
    neuron[1] = row[1] = sizes[0]
    for l in range(layers):  # noqa: E741
        neuron[l + 2] = neuron[l + 1] + sizes[l + 1]
        row[l + 2] = row[l + 1] + sizes[l + 1] * pools[l]
        weight[l + 1] = weight[l] + sizes[l] * sizes[l + 1] * pools[l]
    layer_of = np.zeros(neuron[layers + 1], np.int64)
    for l in range(layers):  # noqa: E741
        layer_of[neuron[l + 1] : neuron[l + 2]] = l
    return Layout(neuron, row, weight, layer_of)


@Kernel
def _values(layout: Layout, net: Layers, extent: Array) -> Values:
    """The Values before the first layer: x itself has K = I, without an error."""
    rows = layout.row[-1]
    neurons = layout.neuron[-1]
    n = len(extent)
    affine, slope = np.zeros((rows, n + 1)), np.zeros(rows)
    won, unsure = np.zeros(neurons, np.int64), np.zeros(neurons)
    for i in range(n):
        affine[i, i] = 1.0
        slope[i] = extent[i]
        won[i] = i
    widest = max(net.sizes)
    active = np.empty(max(net.pools), np.bool_)
    return Values(affine, np.zeros(rows), slope, won, unsure, np.empty((widest, n + 1)), np.empty(widest), active)


@Kernel
def _enter_layer(net: Layers, layout: Layout, values: Values, layer: int, extent: Array) -> None:
    """Write K, g, error and slope of all channels of a layer, whose inputs are settled."""
    before, n = net.sizes[layer], len(extent)
    affine, error = values.affine, values.error
    inputs, doubt = values.inputs, values.doubt
    start = layout.neuron[layer]
    channels_before = net.pools[layer - 1] if layer else 1
    rounding = ROUNDOFF * (before + 4)
    for i in range(before):
        own = values.won[start + i]
        for j in range(n + 1):
            inputs[i, j] = affine[own, j]
        own, largest = layout.row[layer] + i * channels_before, 0.0
        for r in range(own, own + channels_before):
            largest = max(largest, values.slope[r] + abs(affine[r, n]))
        doubt[i] = values.unsure[start + i] + rounding * largest
    at = layout.weight[layer]
    first = layout.row[layer + 1]
    for r in range(net.sizes[layer + 1] * net.pools[layer]):
        to = first + r
        summed = 0.0
        slope = 0.0
        for j in range(n + 1):
            affine[to, j] = 0.0
        for i in range(before):
            w = net.weight[at + i]
            for j in range(n + 1):
                affine[to, j] += w * inputs[i, j]
            summed += abs(w) * doubt[i]
        at += before
        offset = net.bias[to - n]
        affine[to, n] += offset
        for j in range(n):
            slope += abs(affine[to, j]) * extent[j]
        error[to] = summed * (1 + rounding) + rounding * abs(offset)
        values.slope[to] = slope


@Kernel
def _ahead_in_box(affine: Array, c: int, j: int, box: Array) -> float:
    """Upper bound of z_c - z_j over a box, rounding counted."""
    n = box.shape[1]
    value = affine[c, n] - affine[j, n]
    terms = abs(affine[c, n]) + abs(affine[j, n])
    for i in range(n):
        k = affine[c, i] - affine[j, i]
        most = max(k * box[0, i], k * box[1, i])
        value += most
        terms += abs(most)
    return value + (n + 4) * ROUNDOFF * terms


@Kernel
def _most_ahead(cell: Cell, affine: Array, c: int, j: int, work: Work) -> tuple[int, float]:
    """The vertex at which z_c - z_j is largest, and that value; K_c - K_j goes to work.a."""
    n = len(work.a)
    for i in range(n):
        work.a[i] = affine[c, i] - affine[j, i]
    best, most = 0, -np.inf
    for t in range(cell.used[0]):
        value = 0.0
        for i in range(n):
            value += work.a[i] * cell.points[t, i]
        if value > most:
            best, most = t, value
    return best, most + affine[c, n] - affine[j, n]


@Kernel
def _proven_ahead(cell: Cell, affine: Array, c: int, j: int, best: int, work: Work) -> float:
    """Upper bound of z_c - z_j over the cell, after `_most_ahead` has found the vertex `best`."""
    n, terms = len(work.a), abs(affine[c, len(work.a)]) + abs(affine[j, len(work.a)])
    for i in range(n):
        terms += abs(work.a[i]) * work.extent[i]
    return _upper(cell, best, work.a, work) + affine[c, n] - affine[j, n] + 4 * ROUNDOFF * terms


@Kernel
def _is_nowhere_ahead(cell: Cell, affine: Array, c: int, j: int, work: Work) -> bool:
    """Whether channel c is nowhere in a cell ahead of channel j by more than `TOUCH`, proven."""
    best, most = _most_ahead(cell, affine, c, j, work)
    steepness = 1.0
    for i in range(len(work.a)):
        steepness = max(steepness, abs(work.a[i]))
    return most <= TOUCH * steepness and _proven_ahead(cell, affine, c, j, best, work) <= TOUCH * steepness


@Kernel
def _win(cell: Cell, values: Values, base: int, channels: int, j: int, work: Work) -> int:
    """Cut a cell, in its place, to where channel j is not below the other active ones: as `_cut`."""
    affine = values.affine
    n = len(work.a)
    said = WHOLE
    row = work.row
    for c in range(channels):
        if c == j or not values.active[c]:
            continue
        terms = abs(affine[base + c, n]) + abs(affine[base + j, n])
        for i in range(n):
            row[i] = affine[base + c, i] - affine[base + j, i]
            terms += abs(row[i]) * work.extent[i]
        row[n] = affine[base + j, n] - affine[base + c, n] + 4 * ROUNDOFF * terms
        _scale_row(row)
        now = _cut(cell, row, work)
        if now >= EMPTY:
            return now
        if now == CUT:
            said = CUT
    return said


@Kernel
def _contenders(cell: Cell, part: Cell, values: Values, base: int, channels: int, work: Work) -> int:
    """Leave those channels active that may be ahead of all others by more than `TOUCH`: their number, or -OVERFULL, ...

    The last one leaves first, so that of equal channels the first stays. Whatever leaves is nowhere ahead of those
    that stay by more than `TOUCH`. At least one stays.
    """
    affine = values.affine
    active = values.active
    n = len(work.a)
    start, highest = base, -np.inf
    for c in range(base, base + channels):  # the channel that is largest in the middle of the box
        value = affine[c, n]
        for i in range(n):
            value += affine[c, i] * (cell.box[0, i] + cell.box[1, i]) / 2
        if value > highest:
            start, highest = c, value
    left = channels
    for c in range(channels):
        active[c] = base + c == start or _ahead_in_box(affine, base + c, start, cell.box) > 0
        left -= not active[c]
    for j in range(channels - 1, -1, -1):
        if left == 1:
            break
        if not active[j]:
            continue
        for c in range(channels):
            if c != j and active[c] and _is_nowhere_ahead(cell, affine, base + j, base + c, work):
                active[j] = False
                left -= 1
                break
        if active[j] and left > 2:
            _copied(cell, part)
            said = _win(part, values, base, channels, j, work)
            if said > EMPTY:
                return -said
            gone = said == EMPTY
            for c in range(channels):
                if not gone and c != j and active[c]:
                    gone = _is_nowhere_ahead(part, affine, base + j, base + c, work)
            if gone:
                active[j] = False
                left -= 1
    return left


@Kernel
def _unsure(cell: Cell, values: Values, base: int, channels: int, j: int, work: Work) -> float:
    """By how much the largest channel may differ from K x + g of channel j on a cell, at most."""
    affine, error = values.affine, values.error
    most = error[base + j]
    for c in range(channels):
        if c == j:
            continue
        ahead = _ahead_in_box(affine, base + c, base + j, cell.box)
        if ahead + error[base + c] > most:
            best, _ = _most_ahead(cell, affine, base + c, base + j, work)
            ahead = min(ahead, _proven_ahead(cell, affine, base + c, base + j, best, work))
        most = max(most, ahead + error[base + c])
    return most


@Kernel
def _split(
    cell: Cell, part: Cell, values: Values, place: tuple[int, int, int, int], stack: Pool, depth: Ints, work: Work
) -> tuple[Pool, int]:
    """Store the parts of a cell that the active channels of a neuron win: the stack, and what the last cut said.

    `place` is (neuron, its first row, number of channels, owner of the cell).
    """
    neuron, base, channels, owner = place
    said = WHOLE
    for j in range(channels - 1, -1, -1):
        if not values.active[j]:
            continue
        _copied(cell, part)
        said = _win(part, values, base, channels, j, work)
        if said > EMPTY:
            break
        if said != EMPTY:
            _fit_box(part, work)
            doubt = _unsure(part, values, base, channels, j, work)
            stack = _stored(stack, depth, part, (neuron, base + j, owner), doubt)
    return stack, said


@Kernel
def affine_pieces(
    domains: tuple[Any, ...], network: tuple[Any, ...], extent: Array, storage: tuple[int, int, int]
) -> tuple[Any, ...]:
    """The pieces of polytopes on which a maxout network is affine, with K, g and an error of each.

    Parameters
    ----------
    domains : tuple
        The fields of `Pool`: the polytopes.
    network : tuple
        The fields of `Layers`.
    extent : array (n,)
        No coordinate of any polytope exceeds it.
    storage : tuple
        The fields of `Storage`.

    Returns
    -------
    status : int
        DONE, NO_ROOM, NO_WORDS or TOO_MANY.
    tuple
        The fields of a `Pool` with N cells; info (N, 3) begins with the polytope that each is a part of.
    values : array (N, m (n + 2))
        K (n numbers), g and the error of each output in turn. Every x of the polytopes lies in a cell on which
        |K x + g - Phi(x)| is at most the error.

    Notes
    -----
    Depth first: one cell goes through the neurons, the parts that other channels win wait on a stack. Memory grows
    with the cells alone.

    The cells cover the polytopes without a gap. A neuron's channels are affine forms with float coefficients, and one
    of those forms is largest at any point: a cell is cut along the forms, not along the network, and its rows are moved
    outward by the rounding of their own coefficients. A channel is left out where the others are proven to be ahead,
    or behind by no more than `TOUCH`. So the error of a neuron that channel j wins is the error of j, or that of
    another channel c plus what c may be ahead. The errors add up along the layers: with E and s the errors and sizes of
    a neuron's inputs, a channel has |W| (E + (n + 4) ROUNDOFF s) + the rounding of its offset.
    """
    pool = Pool(*domains)
    net = Layers(*network)
    n = len(extent)
    store = Storage(*storage)
    layers, outputs = len(net.pools), net.sizes[-1]
    layout = _layout(net.sizes, net.pools)
    values = _values(layout, net, extent)
    cell = _new_cell(n, store)
    part = _new_cell(n, store)
    work = _new_work(extent, store)
    stack, depth = _new_pool(n, store.words), np.zeros(3, np.int64)
    found, at = _new_pool(n, store.words), np.zeros(3, np.int64)
    forms = np.empty((16, outputs * (n + 2)))
    top, low = len(pool.points), len(pool.rows)
    for j in range(len(pool.counts) - 1, -1, -1):
        top -= pool.counts[j, 0]
        low -= pool.counts[j, 1]
        if not _loaded(pool, j, top, low, cell):
            return NO_ROOM, _results(found, at), forms
        stack = _stored(stack, depth, cell, (n - 1, n - 1, j), 0.0)
    while depth[0]:
        last = depth[0] - 1
        depth[0] = last
        depth[1] -= stack.counts[last, 0]
        depth[2] -= stack.counts[last, 1]
        _loaded(stack, last, depth[1], depth[2], cell)
        neuron, owner = stack.info[last, 0], stack.info[last, 2]
        values.won[neuron], values.unsure[neuron] = stack.info[last, 1], stack.doubt[last, 0]
        while True:
            neuron += 1
            layer = layout.layer_of[neuron]
            channels = net.pools[layer]
            if neuron == layout.neuron[layer + 1]:  # all inputs of this layer are settled
                _enter_layer(net, layout, values, layer, extent)
                if layer == layers - 1:
                    break
            base = layout.row[layer + 1] + (neuron - layout.neuron[layer + 1]) * channels
            left = _contenders(cell, part, values, base, channels, work)
            if left < 0:
                return (NO_ROOM if left == -OVERFULL else NO_WORDS), _results(found, at), forms
            if left > 1:
                stack, said = _split(cell, part, values, (neuron, base, channels, owner), stack, depth, work)
                if said > EMPTY:
                    return (NO_ROOM if said == OVERFULL else NO_WORDS), _results(found, at), forms
                break
            j = 0
            while not values.active[j]:
                j += 1
            values.won[neuron] = base + j
            values.unsure[neuron] = _unsure(cell, values, base, channels, j, work)
        if neuron != layout.neuron[layers]:
            continue
        if at[0] == store.limit:
            return TOO_MANY, _results(found, at), forms
        forms = _grown(forms, at[0] + 1)
        for r in range(outputs):
            row, first = layout.row[layers] + r, r * (n + 2)
            for i in range(n + 1):
                forms[at[0], first + i] = values.affine[row, i]
            forms[at[0], first + n + 1] = values.error[row]
        found = _stored(found, at, cell, (owner, 0, 0), 0.0)
    return DONE, _results(found, at), forms[: at[0]].copy()


# -- queries ------------------------------------------------------------------------------------------


class Maps(NamedTuple):
    """The map on each of N cells, and what is known of its maxima along k rows of V.

    Attributes
    ----------
    M, c : array (N, q, n) and (N, q)
        y = M x + c.
    error : array (N, q)
        Of the map, by component.
    mode : array (N,) of int
    spread : array (s, k)
        What is added along the rows of V in each mode: h of D^(i).
    heights, tops : array (N, k)
        The maximum over each whole cell, and its upper bound.
    V : array (k, q)
    """

    M: Array
    c: Array
    error: Array
    mode: Ints
    spread: Array
    heights: Array
    tops: Array
    V: Array


@Kernel
def _pulled_back(maps: Maps, j: int, k: int, a: Array) -> float:
    """Write M'v to a, for the map of cell j and row k of V; returns v c + h of D, and the error adds to that."""
    n, value = len(a), maps.spread[maps.mode[j], k]
    for i in range(n):
        a[i] = 0.0
    for r in range(maps.V.shape[1]):
        v = maps.V[k, r]
        if v != 0:
            value += v * maps.c[j, r]
            for i in range(n):
                a[i] += v * maps.M[j, r, i]
    return value


@Kernel
def _highest_vertex(cell: Cell, a: Array) -> tuple[int, float]:
    """The vertex at which a x is largest, and that value."""
    best, most = 0, -np.inf
    for t in range(cell.used[0]):
        value = 0.0
        for i in range(len(a)):
            value += a[i] * cell.points[t, i]
        if value > most:
            best, most = t, value
    return best, most


@Kernel
def whole(cells: tuple[Any, ...], maps: tuple[Any, ...], extent: Array, storage: tuple[int, int, int]) -> Any:
    """max v (M_j x + c_j) + h of D over whole cells, and upper bounds, for k rows v of V: two arrays (N, k)."""
    pool = Pool(*cells)
    on = Maps(*maps)
    n = len(extent)
    store = Storage(*storage)
    cell, work = _new_cell(n, store), _new_work(extent, store)
    heights, tops = np.empty((len(pool.counts), len(on.V))), np.empty((len(pool.counts), len(on.V)))
    top, low = 0, 0
    for j in range(len(pool.counts)):
        _loaded(pool, j, top, low, cell)
        top += pool.counts[j, 0]
        low += pool.counts[j, 1]
        for k in range(len(on.V)):
            offset = _pulled_back(on, j, k, work.a)
            best, most = _highest_vertex(cell, work.a)
            heights[j, k] = most + offset
            tops[j, k] = _with_error(on, j, k, _upper(cell, best, work.a, work) + offset)
    return heights, tops


@Kernel
def _with_error(maps: Maps, j: int, k: int, value: float) -> float:
    """A value plus the error of the map of cell j along row k of V."""
    for i in range(maps.V.shape[1]):
        value += abs(maps.V[k, i]) * maps.error[j, i]
    return value


@Kernel
def highest(
    cells: tuple[Any, ...],
    maps: tuple[Any, ...],
    rows: Array,
    chosen: Ints,
    gap: float,
    extent: Array,
    storage: tuple[int, int, int],
) -> tuple[Any, ...]:
    """max v (M_j x + c_j) + h of D over the parts of cells in {x : H x <= h}.

    Parameters
    ----------
    cells : tuple
        The fields of `Pool`, of N cells; `starts` are the first vertices and rows of each.
    maps : tuple
        The fields of `Maps`.
    rows : array (l, n + 1)
        H and h.
    chosen : array (p,) of int
        The cells to look at.
    gap : float
        Bounds that differ from the value at a vertex by more are listed, not used.
    extent : array (n,)
    storage : tuple
        The fields of `Storage`.

    Returns
    -------
    status : int
        DONE, NO_ROOM or NO_WORDS.
    value, top : array (k,)
        The largest value at a vertex, -inf if no cell meets the set, and the largest upper bound.
    owner : array (k,) of int
        The cell that has it.
    left : array (q,) of int
        The chosen cells without those that were found to miss the set.
    doubtful : array (d, 2) of int
        Pairs of a cell and a row of V whose bound has a larger gap.

    Notes
    -----
    The function is long because splitting it made a step 1.7 times as slow.
    """
    pool = Pool(*cells)
    on = Maps(*maps)
    n = len(extent)
    store = Storage(*storage)
    cell, work = _new_cell(n, store), _new_work(extent, store)
    directions = len(on.V)
    value, top = np.full(directions, -np.inf), np.full(directions, -np.inf)
    owner = np.zeros(directions, np.int64)
    left, count = np.empty(len(chosen), np.int64), 0
    doubtful, pairs = np.empty((4, 2), np.int64), 0
    points_before, rows_before = _starts(pool.counts)
    status, row = DONE, np.empty(n + 1)
    for number in range(len(chosen)):
        j = chosen[number]
        left[count] = j
        count += 1
        k = 0
        while k < directions and on.tops[j, k] <= top[k]:
            k += 1
        if k == directions:
            continue
        said, loaded = WHOLE, False
        for r in range(len(rows)):
            side = _side(rows[r], pool.boxes[j])
            if side < 0:
                said = EMPTY
                break
            if side > 0:
                continue
            if not loaded:
                if not _loaded(pool, j, points_before[j], rows_before[j], cell):
                    status = NO_ROOM
                    break
                loaded = True
            for i in range(n + 1):
                row[i] = rows[r, i]
            _scale_row(row)
            now = _cut(cell, row, work)
            if now == OVERFULL or now == OVERBITS:
                status = NO_ROOM if now == OVERFULL else NO_WORDS
                break
            if now == EMPTY:
                said = EMPTY
                break
            if now == CUT:
                said = CUT
        if status != DONE:
            break
        if said == EMPTY:
            count -= 1
            continue
        for k in range(directions):
            if on.tops[j, k] <= top[k]:
                continue
            if said == WHOLE:
                bound = on.tops[j, k]
                attained = on.heights[j, k]
            else:
                offset = _pulled_back(on, j, k, work.a)
                best, most = _highest_vertex(cell, work.a)
                bound = min(_with_error(on, j, k, _upper(cell, best, work.a, work) + offset), on.tops[j, k])
                attained = most + offset
            if bound <= top[k]:
                continue
            if abs(bound - _with_error(on, j, k, attained)) > gap:
                doubtful = _grown(doubtful, pairs + 1)
                doubtful[pairs, 0], doubtful[pairs, 1] = j, k
                pairs += 1
            else:
                top[k] = bound
                value[k] = attained
                owner[k] = j
    return status, value, top, owner, left[:count].copy(), doubtful[:pairs].copy()


@Kernel
def _starts(counts: Ints) -> tuple[Ints, Ints]:
    """The first vertex and the first row of every cell."""
    points, rows = np.zeros(len(counts) + 1, np.int64), np.zeros(len(counts) + 1, np.int64)
    for j in range(len(counts)):
        points[j + 1] = points[j] + counts[j, 0]
        rows[j + 1] = rows[j] + counts[j, 1]
    return points, rows
