"""The cells of a closed loop with any number of states: the polytopes of X on which one mode acts and Phi is affine."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from ..arithmetic.balls import flint
from ..arithmetic.rational import Rational, Vector, above, binary, dot, maximize, nearest
from ..errors import CellLimitError, SolverError
from ..sets.cell_complex import CellComplex
from ..sets.polytope import Polytope
from ..sets.templates import box_directions
from ..solvers.linear_program import LinearProgram
from ..systems.loop import ClosedLoop
from ..systems.network import MaxoutNetwork
from ..tolerances import BOUND_GRID, CLOSE_BOUND, FLAT_IMAGE, LARGE_IMAGE, ROUNDOFF, THIN_IMAGE
from ..typing import Array, BoolArray, IntArray
from .base import LazySequence, Support, Witness, empty_support, replay

MOST_PIECES = 2_000  # limit of the number of polytopes whose union is the reachable set of several steps


@dataclass(frozen=True, eq=False)
class NetworkCells:
    """A covering of X by polytopes, each with one mode and one affine piece u = K x + g.

    Attributes
    ----------
    complex : CellComplex
        N cells. On a boundary that several modes share, each mode has a cell, even if it is only a face or a point.
    mode : array (N,) of int
    K : array (N, m, n)
    g : array (N, m)
    error : array (N, m)
        Upper bound of |K x + g - Phi(x)| on the cell.
    """

    complex: CellComplex
    mode: IntArray
    K: Array
    g: Array
    error: Array

    def __len__(self) -> int:
        return len(self.mode)


@dataclass(frozen=True, eq=False)
class LoopCells:
    """The cells of a loop, with the nominal dynamics x+ = M x + c on each of them.

    Attributes
    ----------
    cells : NetworkCells
    M : array (N, n, n)
    c : array (N, n)
    error : array (N, n)
        Upper bound of the error of each component of M x + c + d that rounding of M, c, d and of the sums causes.
    unit : float
        Bounds are rounded up to multiples of this power of two.
    """

    cells: NetworkCells
    M: Array
    c: Array
    error: Array
    unit: float

    @cached_property
    def all(self) -> IntArray:
        """The indices of all cells: array (N,)."""
        return np.arange(len(self.cells))

    def images(self, points: Array, owner: IntArray) -> Array:
        """M x + c at points (T, n) of the cells `owner` (T,): array (T, n)."""
        found: Array = np.einsum("tij,tj->ti", self.M[owner], points) + self.c[owner]
        return found


@dataclass(frozen=True, eq=False)
class SpaceSupport(Support):
    """A Support, and the cells that a later query with a smaller set has to search.

    Attributes
    ----------
    F : Polytope
        The initial set.
    every : LoopCells
        All cells of the loop.
    left : array (q,) of int
        The cells that may meet F.
    """

    F: Polytope
    every: LoopCells
    left: IntArray


Chain: TypeAlias = tuple[tuple[Polytope, int], ...]  # (part of a cell, cell), one for each step


class Piece(NamedTuple):
    """A Polytope that contains the states after a sequence of cells.

    Attributes
    ----------
    set : Polytope
    chain : Chain
    close : bool
        Whether none of the parts is thin or a needle; the images of such parts may be loose.
    """

    set: Polytope
    chain: Chain
    close: bool


class Trajectory(NamedTuple):
    """Where v x(k) is largest over the trajectories through a sequence of cells.

    Attributes
    ----------
    value : fmpq
    start : array (n,)
        x(0).
    modes : list of int
    disturbances : list of arrays (n,)
    """

    value: Rational
    start: Array
    modes: list[int]
    disturbances: list[Array]


def dynamics(loop: ClosedLoop, limit: int) -> LoopCells:
    """The cells of a closed loop, with x+ = M x + c on each of them; the result is cached for each loop.

    Raises
    ------
    CellLimitError
        If there are more than `limit` cells.
    """
    found = _dynamics(loop, limit)
    if isinstance(found, CellLimitError):
        raise found
    return found


@lru_cache(maxsize=64)
def _dynamics(loop: ClosedLoop, limit: int) -> LoopCells | CellLimitError:
    """The cells, or the error that there are too many."""
    system = loop.system
    regions = tuple(mode.region for mode in system.modes)
    try:
        found = _cells(loop.network, regions, system.state_set, limit)
    except CellLimitError as error:
        return error
    A, B, p = (maps[found.mode] for maps in system.maps)
    extent, terms = found.complex.extent, system.state_size + system.input_size + 8
    M, c = A + B @ found.K, np.einsum("nij,nj->ni", B, found.g) + p
    inputs = np.abs(found.K) @ extent + np.abs(found.g) + found.error
    reach = np.array([np.abs(mode.disturbance.bounding_box()).max(axis=0) for mode in system.modes])
    size = np.abs(A) @ extent + np.einsum("nij,nj->ni", np.abs(B), inputs) + np.abs(p) + reach[found.mode]
    error = np.einsum("nij,nj->ni", np.abs(B), found.error) + 2 * terms * ROUNDOFF * size
    largest = max(1.0, float(size.max(initial=0.0)))
    return LoopCells(found, M, c, error, float(max(BOUND_GRID, LARGE_IMAGE * 2.0 ** np.ceil(np.log2(largest)))))


@lru_cache(maxsize=64)
def _cells(network: MaxoutNetwork, regions: tuple[Polytope, ...], X: Polytope, limit: int) -> NetworkCells:
    """X cut by the rows of the regions in x, then by the network, layer by layer, then by the rows in (x, u)."""
    return _cut_by_inputs(_before_inputs(network, regions, X, limit), regions)


@lru_cache(maxsize=64)
def _before_inputs(network: MaxoutNetwork, regions: tuple[Polytope, ...], X: Polytope, limit: int) -> NetworkCells:
    """The NetworkCells before the cut by the rows of the regions that involve u."""
    n, domains = X.dimension, []
    for region in regions:
        of_x = ~(region.H[:, n:] != 0).any(axis=1)
        domains.append(Polytope(np.vstack([X.H, region.H[of_x, :n]]), np.concatenate([X.h, region.h[of_x]])))
    modes = np.flatnonzero([not domain.is_empty for domain in domains])
    layers = [(layer.weight, layer.bias, layer.pool) for layer in network.hidden] + [(network.weight, network.bias, 1)]
    arrays = (
        np.concatenate([weight.ravel() for weight, _, _ in layers]),
        np.concatenate([bias for _, bias, _ in layers]),
        np.array([n] + [len(bias) // pool for _, bias, pool in layers]),
        np.array([pool for _, _, pool in layers]),
    )
    start = CellComplex.of([domains[mode] for mode in modes])
    found, owner, K, g, error = start.affine_pieces(arrays, limit)
    return NetworkCells(found, modes[owner], K, g, error)


def _cut_by_inputs(found: NetworkCells, regions: tuple[Polytope, ...]) -> NetworkCells:
    """Cut each cell by the rows of its mode's region that involve u, moved outward by the error of u."""
    n = found.complex.dimension
    own = [region.H[(region.H[:, n:] != 0).any(axis=1)] for region in regions]
    offsets = [region.h[(region.H[:, n:] != 0).any(axis=1)] for region in regions]
    counts = np.array([len(rows) for rows in own])[found.mode]
    if not counts.any():
        return found
    cell = np.repeat(np.arange(len(found)), counts)
    H, h = np.concatenate([own[i] for i in found.mode]), np.concatenate([offsets[i] for i in found.mode])
    Hx = H[:, :n]
    Hu = H[:, n:]
    K = found.K[cell]
    a, b = Hx + np.einsum("rm,rmi->ri", Hu, K), h - np.einsum("rm,rm->r", Hu, found.g[cell])
    extent, inputs = found.complex.extent, np.abs(found.K) @ found.complex.extent + np.abs(found.g)
    size = np.abs(Hx) @ extent + np.einsum("rm,rm->r", np.abs(Hu), inputs[cell]) + np.abs(h)
    slack = np.einsum("rm,rm->r", np.abs(Hu), found.error[cell]) + (n + Hu.shape[1] + 8) * ROUNDOFF * size
    ends = np.cumsum(counts)
    part, kept = found.complex.clip(np.column_stack([a, b + slack]), ends - counts, ends)
    return NetworkCells(part, found.mode[kept], found.K[kept], found.g[kept], found.error[kept])


# -- queries ------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Rows:
    """The quantities along the rows v of V that do not depend on F.

    Attributes
    ----------
    maps : tuple
        The fields of `cell_kernels.Maps`.
    spread : array (s, k)
        Upper bounds of the support function of D^(i).
    unit : array (k,)
        Bounds are rounded up to multiples of it.
    """

    maps: tuple[Any, ...]
    spread: Array
    unit: Array


@lru_cache(maxsize=32)
def _rows(loop: ClosedLoop, limit: int, shape: tuple[int, ...], content: bytes) -> _Rows:
    """The _Rows of an array of this shape and content."""
    every, V = dynamics(loop, limit), np.frombuffer(content).reshape(shape).copy()
    spread = np.array([mode.disturbance.bound(V) for mode in loop.system.modes])
    maps = _maps(every, every.all, V, spread)
    heights, tops = every.cells.complex.heights(maps)
    unit = every.unit * 2.0 ** np.floor(np.log2(np.linalg.norm(V, axis=1).clip(1)))
    return _Rows((*maps[:5], heights, tops, V), spread, unit)


def _maps(every: LoopCells, cells: IntArray, V: Array, spread: Array) -> tuple[Any, ...]:
    """The fields of `cell_kernels.Maps` of some cells, without the maxima over whole cells."""
    nothing = np.zeros((0, len(V)))
    return (every.M[cells], every.c[cells], every.error[cells], every.cells.mode[cells], spread, nothing, nothing, V)


def support(
    loop: ClosedLoop, F: Polytope, V: Array, steps: int, limit: int, warm_start: Support | None = None
) -> Support:
    """Support function of R_k(F) along V by the cells: the result of `cells.Cells` for more than two states."""
    every = dynamics(loop, limit)
    rows = _rows(loop, limit, V.shape, V.tobytes())
    chosen = every.all
    if steps == 1 and isinstance(warm_start, SpaceSupport) and warm_start.every is every:
        if np.array_equal(F.H, warm_start.F.H) and (F.h <= warm_start.F.h).all():
            chosen = warm_start.left
    pieces = _reached(loop, every, F, steps, _uncovered)
    found = [(piece, _highest(every, rows, piece.set, chosen)) for piece in pieces]
    found = [(piece, best) for piece, best in found if not _is_empty(every, piece.set, best)]
    if not found:
        return empty_support(len(V))
    pieces, best = zip(*found)
    tops = np.array([found.top for found in best])
    end, k = tops.argmax(axis=0), np.arange(len(V))
    value, top = np.array([found.value for found in best])[end, k], tops[end, k]
    witness = LazySequence(len(V), lambda k: _witness(loop, every, F, V[k], pieces[end[k]], best[end[k]], k))
    bound = np.ceil(top / rows.unit + 0.05) * rows.unit
    if steps > 1:
        loose = {
            k: (
                *pieces[i].chain,
                (every.cells.complex.polytope(best[i].owner[k]) & pieces[i].set, int(best[i].owner[k])),
            )
            for k, i in enumerate(end.tolist())
            if not pieces[i].close
        }
        several = Support(value, bound, witness)
        return _narrowed(loop, every, F, steps, rows, several, loose) if loose else several
    return SpaceSupport(value, bound, witness, F, every, best[0].left)


def _reached(
    loop: ClosedLoop, every: LoopCells, F: Polytope, steps: int, kept: Callable[[Sequence[Piece]], list[Piece]]
) -> list[Piece]:
    """Pieces that cover the states after steps - 1 steps from F; after each step only those that `kept` returns.

    Raises
    ------
    CellLimitError
        If there are too many.
    """
    pieces = [Piece(F, (), True)]
    for step in range(steps - 1):
        pieces = kept([image for piece in pieces for image in _images(loop, every, piece)])
        if len(pieces) > MOST_PIECES:
            raise CellLimitError(
                f"after {step + 1} steps the reachable set has {len(pieces)} pieces; take fewer steps, a smaller F, "
                'or engine="milp"'
            )
    return pieces


def _narrowed(
    loop: ClosedLoop, every: LoopCells, F: Polytope, steps: int, rows: _Rows, found: Support, best: dict[int, Chain]
) -> Support:
    """A Support of several steps, computed again along the rows in `best`, where images may be loose.

    Trajectories through a chain of cells are the points of one polytope, over which v x(k) is maximized in rational
    arithmetic. If that does not attain the bound of the row with its best chain, the largest of the maxima over all
    chains counts. For it no piece may be left out because it lies in another one, for the images are looser than these
    maxima. Where there are too many pieces, the bound stays as it is.
    """
    V, value, bound, witnesses = rows.maps[7], found.value.copy(), found.bound.copy(), list(found.witness)
    chains: list[Chain] | None = None
    for k, chain in best.items():
        highest = highest_through(loop, every, F, V[k], chain)
        if highest is None or bound[k] - nearest(highest.value) > CLOSE_BOUND + 2 * rows.unit[k]:
            if chains is None:
                chains, tops = _chains(loop, every, F, steps, rows)
            if chains:
                highest, top = _highest_over(loop, every, F, V[k], chains, tops[:, k], highest)
                bound[k] = min(bound[k], np.ceil(top / rows.unit[k] + 0.05) * rows.unit[k])
        value[k] = -np.inf if highest is None else nearest(highest.value)
        witnesses[k] = None if highest is None else replay(loop, highest.start, highest.modes, highest.disturbances)
    return Support(value, bound, witnesses)


def _highest_over(
    loop: ClosedLoop,
    every: LoopCells,
    F: Polytope,
    v: Array,
    chains: Sequence[Chain],
    tops: Array,
    highest: Trajectory | None,
) -> tuple[Trajectory | None, float]:
    """The largest v x(k) over chains with upper bounds `tops` (N,), of which one may be known, and its upper bound."""
    for i in np.argsort(-tops, kind="stable").tolist():
        if highest is not None and tops[i] <= nearest(highest.value) + CLOSE_BOUND:
            return highest, max(tops[i], above(highest.value))
        other = highest_through(loop, every, F, v, chains[i])
        if highest is None or (other is not None and other.value > highest.value):
            highest = other
    return highest, -np.inf if highest is None else above(highest.value)


def _chains(loop: ClosedLoop, every: LoopCells, F: Polytope, steps: int, rows: _Rows) -> tuple[list[Chain], Array]:
    """All chains of cells from F, and upper bounds (N, k) of v x(k) over them; none if there are too many pieces."""
    chains: list[Chain] = []
    tops = [np.zeros((0, len(rows.unit)))]
    try:
        pieces = _reached(loop, every, F, steps, list)
    except CellLimitError:
        return chains, tops[0]
    for piece in pieces:
        part, owner = every.cells.complex.clip(np.column_stack([piece.set.H, piece.set.h]))
        tops.append(part.heights(_maps(every, owner, rows.maps[7], rows.spread))[1])
        chains += [(*piece.chain, (part.polytope(i), cell)) for i, cell in enumerate(owner.tolist())]
    return chains, np.vstack(tops)


def highest_through(loop: ClosedLoop, every: LoopCells, F: Polytope, v: Array, chain: Chain) -> Trajectory | None:
    """max v x(k) over x(0) in F, x(j) in part j of the chain, d(j) in D widened by the error of cell j; None if empty.

    One linear program in x(0), d(0), ..., d(k-1), solved in rational arithmetic.
    """
    n, count = len(v), len(v) * (len(chain) + 1)
    zero, one = flint().fmpq(0), flint().fmpq(1)
    unit = [tuple(one if i == j else zero for j in range(count)) for i in range(count)]
    x, offset = unit[:n], [zero] * n  # x(j) = x z + offset, for the variables z
    H, h = _composed(F, x, offset)
    modes = [int(every.cells.mode[cell]) for _, cell in chain]
    for j, (part, cell) in enumerate(chain):
        D, error = loop.system.modes[modes[j]].disturbance, binary(every.error[cell])
        inside, own = _composed(part, x, offset), _composed(D, unit[n * (j + 1) : n * (j + 2)], [zero] * n)
        widened = [b + sum((abs(e * s) for e, s in zip(a, error)), zero) for a, b in zip(D.exact[0], own[1])]
        H, h = [*H, *inside[0], *own[0]], [*h, *inside[1], *widened]
        M, c = every.M[cell], binary(every.c[cell])
        d = unit[n * (j + 1) : n * (j + 2)]
        x, offset = (
            [tuple(map(sum, zip(_combined(row, x), one_d))) for row, one_d in zip(map(binary, M), d)],
            [dot(row, offset) + b for row, b in zip(map(binary, M), c)],
        )
    best = maximize(H, h, _combined(binary(v), x))
    if best.point is None:
        return None
    z = np.array([nearest(entry) for entry in best.point]).reshape(-1, n)
    return Trajectory(best.value + dot(binary(v), offset), z[0], modes, list(z[1:]))


def _composed(P: Polytope, x: Sequence[Vector], offset: Vector) -> tuple[list[Vector], list[Rational]]:
    """The half-spaces of the z for which x z + offset lies in P."""
    H, h = P.exact
    return [_combined(a, x) for a in H], [b - dot(a, offset) for a, b in zip(H, h)]


def _combined(a: Vector, rows: Sequence[Vector]) -> Vector:
    """a rows, for rows of fmpq."""
    return tuple(dot(a, column) for column in zip(*rows))


@dataclass(frozen=True, eq=False)
class _Highest:
    """The maxima of v x+ over the parts of a set in some cells.

    Attributes
    ----------
    value, top : array (k,)
        The largest v x+, and its upper bound.
    owner : array (k,) of int
        The cell with the maximum.
    left : array (q,) of int
        Cells that the set may meet.
    points : dict
        Row -> the state that attains the maximum, where exact arithmetic decided.
    """

    value: Array
    top: Array
    owner: IntArray
    left: IntArray
    points: dict[int, Array]


def _highest(every: LoopCells, rows: _Rows, F: Polytope, chosen: IntArray) -> _Highest:
    """The maxima over the states of F in the chosen cells. Exact arithmetic decides where rounding leaves a gap."""
    cells, tops = every.cells.complex, rows.maps[6]
    found = cells.highest(rows.maps, np.column_stack([F.H, F.h]), chosen, CLOSE_BOUND)
    value, top, owner, left, doubtful = found
    points: dict[int, Array] = {}
    V = rows.maps[7]
    for j, k in doubtful.tolist():
        if tops[j, k] <= top[k]:
            continue
        part = cells.polytope(j) & F
        M, v = binary(every.M[j]), binary(V[k])
        a = [dot(v, [row[i] for row in M]) for i in range(len(v))]
        best = maximize(*part.exact, a)
        if best.point is None:  # the cell does not meet F
            continue
        offset = dot(v, binary(every.c[j])) + binary(rows.spread[every.cells.mode[j], k])
        bound = above(best.value + offset + dot(binary(np.abs(V[k])), binary(every.error[j])))
        if bound > top[k]:
            top[k] = bound
            value[k] = nearest(best.value + offset)
            owner[k] = j
            points[k] = np.array([nearest(entry) for entry in best.point])
    return _Highest(value, top, owner, left, points)


def _is_empty(every: LoopCells, F: Polytope, best: _Highest) -> bool:
    """Whether F is empty or meets no cell. Often one point of F shows at once that it is not."""
    if not np.isfinite(best.top).all():
        return True
    part, _ = every.cells.complex.take(best.owner[:1]).clip(np.column_stack([F.H, F.h]))
    if not len(part):
        return F.is_empty
    x = part.points.mean(axis=0)
    rounding = (len(x) + 4) * ROUNDOFF * (np.abs(F.H) @ np.abs(x) + np.abs(F.h))
    return bool((F.H @ x + rounding > F.h).any()) and F.is_empty


def _images(loop: ClosedLoop, every: LoopCells, piece: Piece) -> list[Piece]:
    """The images of the parts of a piece, widened by D and by their errors."""
    part, owner = every.cells.complex.clip(np.column_stack([piece.set.H, piece.set.h]))
    found = []
    corners = [mode.disturbance.vertices() for mode in loop.system.modes]
    for i, cell in enumerate(owner.tolist()):
        mode = every.cells.mode[cell]
        points = every.images(part.vertices(i), np.full(part.counts[i, 0], cell))
        H, thickness = _normals((points[:, None] + corners[mode]).reshape(-1, points.shape[1]))
        spread = np.array([one.disturbance.bound(H) for one in loop.system.modes])
        chosen = np.array([i])
        heights, tops = part.take(chosen).heights(_maps(every, np.array([cell]), H, spread))
        close = piece.close and thickness >= THIN_IMAGE and bool((tops - heights <= CLOSE_BOUND).all())
        found.append(Piece(Polytope(H, tops[0]), (*piece.chain, (part.polytope(i), cell)), close))
    return found


def _normals(points: Array) -> tuple[Array, float]:
    """Facet normals (l, n) for a close outer approximation of the hull of points (k, n): its own and those of a box.

    Also its smallest extent, except along axes along which it is flat, relative to its largest.
    """
    n, middle = points.shape[1], points.mean(axis=0)
    _, sizes, axes = np.linalg.svd(points - middle, full_matrices=True)
    size = max(1.0, float(np.abs(points).max()))
    rank = int((sizes > FLAT_IMAGE * size).sum())
    rows = [box_directions(n), axes[rank:], -axes[rank:]]
    if rank:
        local = (points - middle) @ axes[:rank].T
        inside = Polytope.from_points(local).H if rank > 1 else box_directions(1)
        rows.append(inside @ axes[:rank])
    return np.vstack(rows), float(sizes[rank - 1] / sizes[0]) if rank else 1.0


def _uncovered(pieces: Sequence[Piece]) -> list[Piece]:
    """The pieces without those that lie in another one."""
    kept: list[Piece] = []
    limits = {id(piece): piece.set.bound(box_directions(piece.set.dimension)) for piece in pieces}
    for piece in sorted(pieces, key=lambda piece: -float(limits[id(piece)].sum())):
        box = limits[id(piece)]
        if not any((box <= limits[id(other)]).all() and piece.set.is_subset(other.set) for other in kept):
            kept.append(piece)
    return kept


def _witness(
    loop: ClosedLoop, every: LoopCells, F: Polytope, v: Array, piece: Piece, best: _Highest, k: int
) -> Witness | None:
    """A trajectory that attains the maximum along v; it passes through the chain of the piece, then the best cell."""
    cell = int(best.owner[k])
    mode = int(every.cells.mode[cell])
    if not piece.chain:
        if k in best.points:
            x = best.points[k]
        else:
            part, _ = every.cells.complex.take(np.array([cell])).clip(np.column_stack([F.H, F.h]))
            x = max(part.points, key=lambda point: float(v @ every.M[cell] @ point))
        d = max(loop.system.modes[mode].disturbance.vertices(), key=lambda d: float(v @ d))
        return replay(loop, x, [mode], [d])
    chain = [*piece.chain, (every.cells.complex.polytope(cell) & piece.set, cell)]
    stages = [Stage(part, int(every.cells.mode[j]), every.M[j], every.c[j]) for part, j in chain]
    return longest(loop, F, v, stages)


class Stage(NamedTuple):
    """A part of a cell, as a Polytope, with the number of its mode and x+ = M x + c + d on it."""

    part: Polytope
    mode: int
    M: Array
    c: Array


def longest(loop: ClosedLoop, F: Polytope, v: Array, stages: Sequence[Stage]) -> Witness | None:
    """max v x(k) over x(0) in F, x(j) in the part of stage j, d(j) in D: one LP. None if HiGHS finds no trajectory."""
    n = len(v)
    lp, free = LinearProgram(), np.full(n, np.inf)
    states = [lp.add_columns(-free, free) for _ in range(len(stages) + 1)]
    disturbances = [lp.add_columns(-free, free) for _ in stages]
    lp.add_rows(states[0], F.H, upper=F.h)
    for j, (part, mode, M, c) in enumerate(stages):
        D = loop.system.modes[mode].disturbance
        lp.add_rows(states[j], part.H, upper=part.h)
        lp.add_rows(disturbances[j], D.H, upper=D.h)
        columns = np.concatenate([states[j + 1], states[j], disturbances[j]])
        lp.add_rows(columns, np.hstack([np.eye(n), -M, -np.eye(n)]), lower=c, upper=c)
    best = lp.maximize(states[-1], v).point
    if best is None:
        return None
    return replay(loop, best[states[0]], [stage.mode for stage in stages], [best[d] for d in disturbances])


# -- successors within X ------------------------------------------------------------------------------


def cut_support(loop: ClosedLoop, F: Polytope, V: Array, limit: int) -> Array:
    """Support function of R_1(F) & X along V: the result of `cells.Cells.cut_support` for more than two states."""
    every, X = dynamics(loop, limit), loop.system.state_set
    rows = _rows(loop, limit, V.shape, V.tobytes())
    part, owner = every.cells.complex.clip(np.column_stack([F.H, F.h]))
    if not len(part):
        return np.full(len(V), -np.inf)
    W = np.vstack([X.H, V])
    spread = np.array([mode.disturbance.bound(W) for mode in loop.system.modes])
    heights, tops = part.heights(_maps(every, owner, W, spread))
    inside = np.all(tops[:, : len(X.h)] <= X.h, axis=1)
    sure = inside & np.all(tops - heights <= CLOSE_BOUND, axis=1)
    most = tops[:, len(X.h) :]
    most = np.where(inside[:, None], most, np.minimum(most, X.bound(V)))
    bound = highest_within(most, sure, lambda i: _successors_in(loop, every, part.polytope(i) & F, int(owner[i])), V)
    return np.ceil(bound / rows.unit + 0.05) * rows.unit


def highest_within(
    most: Array, sure: BoolArray, program: Callable[[int], tuple[LinearProgram, IntArray] | None], V: Array
) -> Array:
    """The largest v x+ over parts of a set: upper bounds (k,), rounding counted.

    Parameters
    ----------
    most : array (N, k)
        Upper bounds for each part.
    sure : array (N,) of bool
        Where these bounds are attained up to rounding.
    program : callable
        Part -> the linear program of its successors, and its columns of x+; None if the part is empty. It is called
        only for parts whose bound exceeds the maximum so far.
    V : array (k, n)
    """
    bound: Array = most[sure].max(axis=0, initial=-np.inf)
    programs: dict[int, tuple[LinearProgram, IntArray] | None] = {}
    for k, v in enumerate(V):
        for i in np.argsort(-most[:, k], kind="stable").tolist():
            if most[i, k] <= bound[k]:
                break
            if i not in programs:
                programs[i] = program(i)
            found = programs[i]
            if found is not None:
                bound[k] = max(bound[k], min(most[i, k], _proven_maximum(*found, v)))
    return bound


def _proven_maximum(lp: LinearProgram, columns: IntArray, v: Array) -> float:
    """An upper bound of v x[columns] by weak duality; inf where HiGHS gives no multipliers."""
    try:
        return lp.bound(columns, v)
    except SolverError:  # flat sets can leave a solver undecided
        return np.inf


def _successors_in(
    loop: ClosedLoop, every: LoopCells, part: Polytope, cell: int
) -> tuple[LinearProgram, IntArray] | None:
    """x+ = M x + c + d in X for x in a part of a cell, d in D, up to the error: a linear program; its columns of x+."""
    if part.is_empty:
        return None
    X, D = loop.system.state_set, loop.system.modes[every.cells.mode[cell]].disturbance
    lp, axes = LinearProgram(), np.eye(X.dimension)
    after, x, d = (lp.add_columns(-S.bound(-axes), S.bound(axes)) for S in (X, part, D))
    for columns, S in ((after, X), (x, part), (d, D)):
        lp.add_rows(columns, S.H, upper=S.h)
    low, high = every.c[cell] - every.error[cell], every.c[cell] + every.error[cell]
    step = np.hstack([axes, -every.M[cell], -axes])
    lp.add_rows(np.concatenate([after, x, d]), step, np.nextafter(low, -np.inf), np.nextafter(high, np.inf))
    return lp, after
