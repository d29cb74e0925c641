"""The exact cells of a closed loop in the plane.

Under a maxout network the loop of a piecewise-affine system with two states is again piecewise affine: X is divided
into convex polygons, the cells, on each of which one mode acts and Phi is affine. The support function of the reachable
set is then a maximum over the vertices of (cell & F), without a MILP.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, lru_cache
from math import inf, nextafter
from typing import Any, ClassVar, NamedTuple

import numpy as np

from ..checks import whole_number
from ..errors import CellLimitError
from ..sets.kernels import affine_pieces, highest, parts, sharp_pairs
from ..sets.polygons import Polygons
from ..sets.polytope import Polytope
from ..sets.templates import box_directions
from ..solvers.linear_program import LinearProgram
from ..systems.loop import ClosedLoop
from ..systems.network import MaxoutNetwork
from ..tolerances import BOUND_GRID, CORNER, LARGE_IMAGE, OPPOSITE_ROWS, TOUCH
from ..typing import Array, ArrayLike, IntArray
from . import space
from .base import Engine, LazySequence, Support, Witness, checked_query, empty_support, replay

SHAPED = 16  # a polygon of X and a region counts for this many cuts, which bounds the rounding of its corners
CUTS = 64  # consecutive cuts by rows of F whose rounding the error of a cell includes
SHARP = 0.1  # tips whose angle has a smaller sine are cut off by an additional row, since rounding moves them far
MOST_CELLS = 500_000  # default of `Cells.limit`
MOST_PIECES = 20_000  # polygons that a reachable set of several steps may fall into


@dataclass(frozen=True, eq=False)
class Walls:
    """The half-planes of x that limit X or a mode: rows H x <= h of X and of regions.

    Attributes
    ----------
    H, h : array (w, 2) and (w,)
    mode : array (w,) of int
        The mode whose region the row bounds; -1 for the rows of X.
    """

    H: Array
    h: Array
    mode: IntArray


@dataclass(frozen=True, eq=False)
class NetworkCells:
    """A covering of X by closed convex polygons, each with one mode and one affine piece u = K x + g.

    Attributes
    ----------
    polygons : Polygons
        N cells. On a boundary that modes share, each of them has a cell, even if it is only an edge or a point.
    mode : array (N,) of int
    K : array (N, m, 2)
    g : array (N, m)
    error : array (N, m)
        Upper bound of |K x + g - Phi(x)| on the cell, rounding of its corners included.
    cuts : array (N,) of int
        Every state x of a mode lies within `cuts` times CORNER of a cell of the mode (relative to the size of X).
    walls : Walls
    """

    polygons: Polygons
    mode: IntArray
    K: Array
    g: Array
    error: Array
    cuts: IntArray
    walls: Walls

    def __len__(self) -> int:
        return len(self.polygons)

    def take(self, chosen: IntArray) -> "NetworkCells":
        """The cells with the given indices."""
        return NetworkCells(
            self.polygons.take(chosen),
            self.mode[chosen],
            self.K[chosen],
            self.g[chosen],
            self.error[chosen],
            self.cuts[chosen],
            self.walls,
        )

    @cached_property
    def all(self) -> IntArray:
        """The indices of all cells: array (N,)."""
        return np.arange(len(self))

    @cached_property
    def size(self) -> float:
        """Largest coordinate, at least 1."""
        return _size(self.polygons.points)

    def restrict(self, F: Polytope) -> tuple[Polygons, IntArray]:
        """The intersections of the cells with the Polytope F: Polygons, and the index of the cell of each.

        They contain the exact intersections, and exceed them by no more than rounding.
        """
        points, starts, owner = parts(self.kernel_arguments(F))
        return Polygons(points, starts), owner

    def kernel_arguments(self, F: Polytope) -> tuple[Any, ...]:
        """The arguments of the compiled loops: the cells, the half-planes of F, and the tolerances for rounding.

        Cells are cut slightly beyond each row of F, so that no part of F is lost to rounding.
        """
        H, h, only = _blunted(F, self.walls, self.size)
        slack = (self._most_cuts + len(h)) * CORNER * self.size
        return (*self._shapes, H, h, only, slack, TOUCH * self.size)

    @cached_property
    def _shapes(self) -> tuple[Any, ...]:
        return (self.polygons.points, self.polygons.starts, *self.polygons.discs, self.mode)

    @cached_property
    def _most_cuts(self) -> int:
        return int(self.cuts.max(initial=0))


@dataclass(frozen=True, eq=False)
class CellSupport(Support):
    """A Support and the cells that may meet F, for warm starts with smaller sets.

    Attributes
    ----------
    F : Polytope
        The set whose reachable set it is.
    cells : NetworkCells
    left : array (q,) of int
        The cells that may meet F.
    """

    F: Polytope
    cells: NetworkCells
    left: IntArray

    def within(self, F: Polytope, cells: NetworkCells) -> IntArray:
        """The `cells` that a set F may meet: `left` if F has the rows of `self.F` and no larger offsets, else all."""
        smaller = self.cells is cells and np.array_equal(F.H, self.F.H) and (F.h <= self.F.h).all()
        return self.left if smaller else cells.all


@dataclass(frozen=True, eq=False)
class LoopCells:
    """The cells of a loop with its nominal dynamics x+ = M x + c on each of them.

    Attributes
    ----------
    cells : NetworkCells
    M : array (N, 2, 2)
    c : array (N, 2)
    error : array (N, 2)
        Upper bound of the error of every component of M x + c + d, from the rounding of x, M and c.
    corners : list of arrays (v, 2)
        The corners of D^(i) of every mode.
    unit : float
        Bounds are rounded up to multiples of this power of two, the same for all sets of the loop.
    """

    cells: NetworkCells
    M: Array
    c: Array
    error: Array
    corners: list[Array]
    unit: float

    def images(self, points: Array, owner: IntArray) -> Array:
        """M x + c at points (T, 2) of the cells `owner` (T,): array (T, 2)."""
        return np.einsum("tij,tj->ti", self.M[owner], points) + self.c[owner]


def cells(loop: ClosedLoop) -> NetworkCells:
    """The cells of a closed loop over X.

    Parameters
    ----------
    loop : ClosedLoop
        With two states and any number of inputs.

    Returns
    -------
    NetworkCells
        The same object for loops that differ only in A, B, p or the disturbances.

    Raises
    ------
    ValueError
        If the loop does not have two states.
    """
    return dynamics(loop).cells


@lru_cache(maxsize=128)
def dynamics(loop: ClosedLoop) -> LoopCells:
    """The cells of a closed loop with x+ = M x + c on each of them: LoopCells, the same object for the same loop.

    Raises
    ------
    ValueError
        As `cells`.
    """
    if loop.system.state_size != 2:
        raise ValueError(f'the cells need 2 states, but the loop has {loop.system.state_size}; use engine="milp"')
    system = loop.system
    found = _cells(loop.network, tuple(mode.region for mode in system.modes), system.state_set)
    A, B, p = (maps[found.mode] for maps in system.maps)
    M, c = A + B @ found.K, np.einsum("nij,nj->ni", B, found.g) + p
    of_set = {mode.disturbance: _corners(mode.disturbance) for mode in system.modes}
    every = LoopCells(found, M, c, np.zeros_like(c), [of_set[mode.disturbance] for mode in system.modes], 0.0)
    images = every.images(found.polygons.points, found.polygons.owner)
    size = max(_size(found.polygons.points), _size(images), *(_size(corners) for corners in of_set.values()))
    inputs = np.abs(found.K).sum(axis=2) * found.size + np.abs(found.g) + found.error
    rounding = np.abs(A).sum(axis=2) * found.size + np.einsum("nij,nj->ni", np.abs(B), inputs) + np.abs(p) + size
    error = np.einsum("nij,nj->ni", np.abs(B), found.error) + 4 * CORNER * rounding
    error += np.abs(M).sum(axis=2) * ((found.cuts + CUTS) * CORNER * found.size)[:, None]
    return replace(every, error=error, unit=_unit(size))


@dataclass(frozen=True)
class Cells(Engine):
    """h of R_k(F) by the vertices of the cells, the pieces of X on which the loop is affine (Lemma 2 without its MILP).

    For any number of states and steps, and F of any shape, points included.

    Attributes
    ----------
    limit : int
        The largest number of cells for more than two states; `CellLimitError` if there are more. Cells of many
        states have many vertices: 2^n each, on average.

    See Also
    --------
    Exact : the same cells in rational arithmetic, for one step.
    Milp : for loops with too many cells.

    Notes
    -----
    For every set that was compared with the exact engine, exact <= bound <= exact + 1e-9 along rows of length 1. Very
    thin sets were among them, and loops with coordinates up to 800 and gains |M| up to 400.

    For more than two states, `sets.cell_complex` keeps the cells. Their vertices only propose a value. Weak duality on
    the rows of a cell and of F proves each bound, rounding included. Exact arithmetic replaces a bound that lies more
    than 6e-11 above the value at a vertex, as at the tip of a needle.

    Two states have polygons with ordered corners, which take a half to a sixth of the time. Their bounds have the
    following reasons, with eta = `CORNER` for the rounding of one corner:

    - Every state x of a mode lies within `cuts` eta of a cell of that mode, and there |K x + g - Phi(x)| is at most
      the `error` of the cell (`kernels.affine_pieces`), which grows with the weights. Rows of a region that involve u
      are moved outward by it.
    - Cells are cut by the rows of F moved outward by (`cuts` + rows) eta, so the remaining part of the cell contains a
      point within this distance of x. So v x+ is at most the largest v (M x + c + d) over its corners, plus |v| times
      `LoopCells.error`, which is |B| error + |M| (cuts + 64) eta + the rounding of M, c and d. The bound is therefore
      not below the true value.
    - The bound is not far above the true value either. The remaining part of a cell may exceed F & X, or the cell
      itself, but in each row by no more than this distance. Edges between cells of one mode may be nearly parallel,
      because Phi is continuous. Where two rows of F, or one of F and one of X or of a region, meet at an angle with a
      sine below `SHARP`, a row through the exact tip is added, computed in rational arithmetic.

    Limits: a mode whose boundary depends on u is enlarged by the rounding of u. For a row of F at a small angle w to
    this boundary, the bound is therefore too large by about 1e-14 / w. Sets that come within 1e-11 of each other count
    as touching, and rows that are opposite to within 4e-15 count as parallel. With `steps` > 1 each piece is widened by
    its error before the next step: the bound stays above the true value, and the error grows with the gain of the loop.
    """

    name: ClassVar[str] = "cells"
    limit: int = MOST_CELLS

    def __post_init__(self) -> None:
        object.__setattr__(self, "limit", whole_number(self.limit, "limit", 1))

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
        """As `Engine.support`, for any number of states.

        Notes
        -----
        For one step the result is a `CellSupport`: as `warm_start` for a smaller set it excludes cells that this set
        cannot meet. For more than one step, every piece of the reachable set is propagated through the cells; the
        number of pieces grows with `steps`. `bound` is rounded up to a multiple of 1.5e-11 (of a larger number for
        images above 256, and times |v| for long rows), so that equal sets give equal numbers. `cutoff` is not used.

        Raises
        ------
        CellLimitError
            If the loop has more than `limit` cells, or the reachable set falls into too many pieces.
        """
        V, steps = checked_query(loop, F, V, steps)
        if loop.system.state_size != 2:
            return space.support(loop, F, V, steps, self.limit, warm_start)
        every = dynamics(loop)
        chosen = every.cells.all
        if steps == 1 and isinstance(warm_start, CellSupport):
            chosen = warm_start.within(F, every.cells)
        rows = _rows(loop, every, V.shape, V.tobytes())
        pieces: list[Piece] = [Piece(F, ())]
        for step in range(steps - 1):
            pieces = _uncovered([image for piece in pieces for image in _images(every, piece)])
            if len(pieces) > MOST_PIECES:
                raise CellLimitError(
                    f"after {step + 1} steps the reachable set has {len(pieces)} pieces; take fewer steps, "
                    'a smaller F, or engine="milp"'
                )
        if not pieces:
            return empty_support(len(V))
        value, top, cell, left = _highest(every, pieces[0].set, rows, chosen)
        end = np.zeros(len(V), int)
        for number, piece in enumerate(pieces[1:], start=1):
            piece_value, piece_top, piece_cell, _ = _highest(every, piece.set, rows, chosen)
            better = piece_top > top
            value[better] = piece_value[better]
            top[better] = piece_top[better]
            cell[better] = piece_cell[better]
            end[better] = number
        if not np.isfinite(value).all():
            return empty_support(len(V))
        witness = LazySequence(len(V), lambda k: _witness(loop, every, F, V[k], pieces[end[k]], cell[k]))
        found = Support(value, np.ceil(top / rows.unit + 0.05) * rows.unit, witness)
        if steps > 1:
            return found
        return CellSupport(found.value, found.bound, witness, F, every.cells, left)

    def cut_support(self, loop: ClosedLoop, F: Polytope, V: Array) -> Array:
        """Upper bounds of the support function of R_1(F) & X, as `Engine.cut_support`.

        Parameters
        ----------
        loop : ClosedLoop
        F : Polytope
        V : array (k, n)

        Returns
        -------
        array (k,)
            Rounded up as `support` does.

        Raises
        ------
        CellLimitError
            If the loop has more than `limit` cells.
        """
        if loop.system.state_size != 2:
            return space.cut_support(loop, F, V, self.limit)
        every = dynamics(loop)
        return _highest_in_state_set(loop.system.state_set, every, F, _rows(loop, every, V.shape, V.tobytes()))


# -- building the cells -------------------------------------------------------------------------------


@lru_cache(maxsize=128)
def _cells(network: MaxoutNetwork, regions: tuple[Polytope, ...], state_set: Polytope) -> NetworkCells:
    """Cells of `network` over X and the regions: cut by the rows of x, then layer by layer, then by rows of (x, u)."""
    return _cut_by_inputs(_before_inputs(network, regions, state_set), regions)


@lru_cache(maxsize=128)
def _before_inputs(network: MaxoutNetwork, regions: tuple[Polytope, ...], state_set: Polytope) -> NetworkCells:
    """The NetworkCells before they are cut by those rows of regions that involve u: they cover X for every mode."""
    domains, modes, walls = _domains(regions, state_set)
    size = _size(domains.points)
    layers = [(layer.weight, layer.bias, layer.pool) for layer in network.hidden] + [(network.weight, network.bias, 1)]
    network_arrays = (
        np.concatenate([weight.ravel() for weight, _, _ in layers]),
        np.concatenate([bias for _, bias, _ in layers]),
        np.array([2] + [len(bias) // pool for _, bias, pool in layers]),
        np.array([pool for _, _, pool in layers]),
    )
    lengths = (size, TOUCH * size, CORNER * size)
    points, shape, values = affine_pieces((domains.points, domains.starts), network_arrays, lengths, SHAPED)
    sizes, owner, cuts = shape.T
    polygons = Polygons(points, np.concatenate([[0], np.cumsum(sizes)]))
    K, g, error = np.split(values.reshape(len(values), -1, 4), [2, 3], axis=2)
    return NetworkCells(polygons, modes[owner], K.copy(), g[..., 0].copy(), error[..., 0].copy(), cuts, walls)


def input_excess(
    network: MaxoutNetwork, regions: tuple[Polytope, ...], X: Polytope, U: Polytope
) -> tuple[float, float, Array]:
    """The largest violation of U by Phi over X, in the units of U.h.

    Parameters
    ----------
    network : MaxoutNetwork
        With two inputs.
    regions : tuple of Polytope
    X, U : Polytope

    Returns
    -------
    most : float
        Upper bound of U.H Phi(x) - U.h over all x of X and all rows, rounding counted.
    excess : float
        The largest value at a corner of a cell, up to rounding.
    x : array (2,)
        That corner.
    """
    found = _before_inputs(network, regions, X)
    points, owner = found.polygons.points, found.polygons.owner
    inputs = np.einsum("tij,tj->ti", found.K[owner], points) + found.g[owner]
    excess = inputs @ U.H.T - U.h
    extent = (np.abs(found.K).sum(axis=2) * found.size + np.abs(found.g)) @ np.abs(U.H).T + np.abs(U.h)
    error = found.error @ np.abs(U.H).T + 4 * CORNER * (extent + np.abs(U.H).sum(axis=1))
    error += np.abs(np.einsum("rm,nmi->nri", U.H, found.K)).sum(axis=2) * (found.cuts * CORNER * found.size)[:, None]
    worst, _ = np.unravel_index(np.argmax(excess), excess.shape)
    return float((excess + error[owner]).max()), float(excess.max()), points[worst]


@lru_cache(maxsize=32)
def _domains(regions: tuple[Polytope, ...], state_set: Polytope) -> tuple[Polygons, IntArray, Walls]:
    """X cut by those rows of each region that do not involve u: Polygons, the mode of each, and all rows as Walls."""
    found, walls = [], [(state_set.H, state_set.h)]
    for region in regions:
        of_x = ~(region.H[:, 2:] != 0).any(axis=1)
        H, h = region.H[of_x, :2], region.h[of_x]
        found.append(_corners(state_set, H, h))
        walls.append((H, h))
    modes = np.flatnonzero([len(corners) for corners in found])
    of_mode = np.repeat(np.arange(-1, len(regions)), [len(h) for _, h in walls])
    walls = Walls(np.vstack([H for H, _ in walls]), np.concatenate([h for _, h in walls]), of_mode)
    return Polygons.of([found[mode] for mode in modes]), modes, walls


def _corners(P: Polytope, H: Array = np.zeros((0, 2)), h: Array = np.zeros(0)) -> Array:  # noqa: B008
    """The corners of {x in P : H x <= h} for a bounded Polytope P: array (v, 2).

    Their error is at most the rounding of `SHAPED` cuts. At sharp tips they may lie further outside.
    """
    box = np.array(P.bounding_box())
    size, nowhere = _size(box), Walls(np.zeros((0, 2)), np.zeros(0), np.zeros(0, int))
    corner, touch = CORNER * size, TOUCH * size
    start, around = P.vertices(), Polytope.box(*(box + np.array([[-1.0], [1.0]]))).vertices()
    both = Polytope(np.vstack([P.H, H]), np.concatenate([P.h, h]))
    rows = _blunted(both, nowhere, size)
    if len(rows[1]) > len(both.h):
        return _part(around, *rows, SHAPED * corner, touch)
    careful = _part(around, P.H, P.h, np.full(len(P.h), -1), 4 * corner, touch)
    apart = np.abs(careful[:, None] - start).max(axis=2).min(axis=1, initial=inf)
    if (apart > SHAPED / 2 * corner).any():  # `vertices` merges corners that are closer than 1e-11
        start = careful
    found = Polygons.of([start])
    for a, b in zip(H, h):
        norm = max(np.linalg.norm(a), np.finfo(float).tiny)
        found, _ = found.clip(a[None] / norm, np.array([b / norm]), touch)
        if not len(found):
            break
    return found.points


def _part(corners: Array, H: Array, h: Array, only: IntArray, slack: float, touch: float) -> Array:
    """The part of one polygon in half-planes: array (v, 2)."""
    whole = Polygons.of([corners])
    return parts((whole.points, whole.starts, *whole.discs, np.zeros(1, int), H, h, only, slack, touch))[0]


def _cut_by_inputs(found: NetworkCells, regions: tuple[Polytope, ...]) -> NetworkCells:
    """Cut each cell by the rows of its mode's region that involve u, moved outward by the error of u."""
    size = found.size
    chosen = [(region.H[:, 2:] != 0).any(axis=1) for region in regions]
    for row in range(max(own.sum() for own in chosen)):
        H, h = np.zeros((len(regions), regions[0].dimension)), np.zeros(len(regions))
        for i, (region, own) in enumerate(zip(regions, chosen)):
            if row < own.sum():
                H[i], h[i] = region.H[own][row], region.h[own][row]
        H, h = H[found.mode], h[found.mode]
        a = H[:, :2] + np.einsum("nm,nmi->ni", H[:, 2:], found.K)
        b = h - np.einsum("nm,nm->n", H[:, 2:], found.g)
        inputs = np.abs(found.K).sum(axis=2) * size + np.abs(found.g)
        rounding = np.abs(H[:, :2]).sum(axis=1) * size + np.einsum("nm,nm->n", np.abs(H[:, 2:]), inputs) + np.abs(h)
        slack = np.einsum("nm,nm->n", np.abs(H[:, 2:]), found.error) + 4 * CORNER * rounding
        slack += np.abs(a).sum(axis=1) * (found.cuts + CUTS) * CORNER * size
        norm = np.maximum(np.linalg.norm(a, axis=1), np.linalg.norm(H, axis=1))
        norm[norm == 0] = 1
        polygons, kept = found.polygons.clip(a / norm[:, None], (b + slack) / norm, 10 * TOUCH * size)
        found = replace(found.take(kept), polygons=polygons)
        found = replace(found, cuts=found.cuts + 1)
    return found


def _unit(size: float) -> float:
    """The power of two of which bounds are multiples, for states of this size."""
    power = 2.0 ** np.ceil(np.log2(size))
    return float(max(BOUND_GRID, LARGE_IMAGE * power))


def _size(points: Array) -> float:
    """Largest coordinate, at least 1; tolerances are relative to it."""
    return max(1.0, float(np.abs(points).max(initial=0.0)))


# -- queries ------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Rows:
    """The quantities along the rows v of V that do not depend on F.

    Attributes
    ----------
    V : array (k, 2)
    heights, tops : array (N, k)
        Largest v x+ over each cell, and the same plus the error of the cell.
    spread : array (s, k)
        Support function of D^(i).
    unit : array (k,)
        Bounds are rounded up to multiples of it.
    """

    V: Array
    heights: Array
    tops: Array
    spread: Array
    unit: Array


@lru_cache(maxsize=32)
def _rows(loop: ClosedLoop, every: LoopCells, shape: tuple[int, ...], content: bytes) -> _Rows:
    """The _Rows of an array of this shape and content."""
    V, found = np.frombuffer(content).reshape(shape).copy(), every.cells
    spread = np.array([(V @ corners.T).max(axis=1) for corners in every.corners])
    heights = found.polygons.largest(every.images(found.polygons.points, found.polygons.owner) @ V.T)
    heights += spread[found.mode]
    unit = every.unit * 2.0 ** np.floor(np.log2(np.linalg.norm(V, axis=1).clip(1)))
    return _Rows(V, heights, heights + every.error @ np.abs(V).T, spread, unit)


def _highest(every: LoopCells, F: Polytope, rows: _Rows, chosen: IntArray) -> tuple[Array, Array, IntArray, IntArray]:
    """max v x+ over the states of F in chosen cells, the same plus the error, and the cell; and the cells F may meet.

    Three arrays (k,), for the rows v of V, and one (q,).
    """
    maps = (every.M, every.c, every.error, rows.spread, rows.heights, rows.tops, rows.V)
    return highest(every.cells.kernel_arguments(F), maps, chosen)


def _blunted(F: Polytope, walls: Walls, size: float) -> tuple[Array, Array, IntArray]:
    """The rows of F, and a row across every sharp tip that they form with each other or with a wall.

    Returns H, h and the mode (-1 for all) to which each row belongs.
    """
    pairs, count = sharp_pairs(F.H, F.h, walls.H, walls.h, size, OPPOSITE_ROWS, SHARP), len(F.h)
    only, tips = np.full(count, -1), []
    for r, s in pairs:
        first = _exact_row(F.H[r], F.h[r])
        if s < count:
            second, mode = _exact_row(F.H[s], F.h[s]), -1
        else:
            second, mode = _exact_row(walls.H[s - count], walls.h[s - count]), walls.mode[s - count]
        tips.append((*_across(F.H[r], first, second), mode))
    if not tips:
        return F.H, F.h, only
    # a Polytope, since the kernels are compiled for read-only arrays like its own
    blunt = Polytope(np.vstack([F.H, [a for a, _, _ in tips]]), np.append(F.h, [b for _, b, _ in tips]))
    return blunt.H, blunt.h, np.append(only, [mode for _, _, mode in tips])


def _exact_row(a: Array, b: float) -> list[Fraction]:
    """A half-plane a x <= b as three Fractions."""
    return [Fraction(value) for value in (*a.tolist(), float(b))]


def _across(normal: Array, first: Sequence[Fraction], second: Sequence[Fraction]) -> tuple[Array, float]:
    """The half-plane a x <= b through the tip of two others, a being `normal` turned by a right angle.

    The tip is exact and b is rounded up. The intersection of the two lies in it, since a is between their normals.
    """
    (p, q, r), (s, t, u) = first, second
    turn = p * t - q * s
    a = np.array([-normal[1], normal[0]]) * (1 if turn > 0 else -1)
    x, y = (r * t - q * u) / turn, (p * u - r * s) / turn
    exact = Fraction(a[0]) * x + Fraction(a[1]) * y
    b = float(exact)
    return a, b if Fraction(b) >= exact else nextafter(b, inf)


class Piece(NamedTuple):
    """A Polytope of states after some steps, and the chain of (polygon, cell) of the steps before."""

    set: Polytope
    chain: tuple[tuple[Array, int], ...]


@dataclass(frozen=True, eq=False)
class _Image:
    """The image of a part of a cell: the hull of `points` (v, 2), with an error of at most `error` (2,).

    `piece` is that hull widened by the error.
    """

    points: Array
    error: Array
    piece: Piece


def _images(every: LoopCells, piece: Piece) -> list[_Image]:
    """The images of the parts of a piece. Rows of a box are added, so that widening does not lengthen tips."""
    part, index = every.cells.restrict(piece.set)
    images, found = Polygons(every.images(part.points, index[part.owner]), part.starts), []
    for i, cell in enumerate(index):
        points = (images[i][:, None] + every.corners[every.cells.mode[cell]]).reshape(-1, 2)
        H = np.vstack([Polytope.from_points(points).H, box_directions(2)])
        h = (points @ H.T).max(axis=0) + np.abs(H) @ every.error[cell]
        after = Piece(Polytope(H, h), (*piece.chain, (part[i], cell)))
        found.append(_Image(points, every.error[cell], after))
    return found


def _uncovered(images: Sequence[_Image]) -> list[Piece]:
    """The pieces of the images that lie in no larger image, errors included."""
    if not images:
        return []
    images = sorted(images, key=lambda image: -image.piece.set.area)
    points, error = Polygons.of([image.points for image in images]), np.array([image.error for image in images])
    box = points.largest(points.points @ box_directions(2).T) + np.hstack(
        [error, error]
    )  # rows of the box are rows of each set
    left, kept = np.arange(len(images)), []
    while len(left):
        first, left = left[0], left[1:]
        largest = images[first].piece.set
        kept.append(images[first].piece)
        near = left[(box[left] <= box[first]).all(axis=1)]
        part = points.take(near)
        heights = part.largest(part.points @ largest.H.T) + error[near] @ np.abs(largest.H).T
        left = np.setdiff1d(left, near[(heights <= largest.h).all(axis=1)], assume_unique=True)
    return kept


def _witness(loop: ClosedLoop, every: LoopCells, F: Polytope, v: Array, piece: Piece, cell: int) -> Witness | None:
    """A trajectory that attains the maximum along v: through the chain of a piece, to the part of `cell` in it."""
    part, index = every.cells.restrict(piece.set)
    points = part[np.flatnonzero(index == cell)[0]]
    if piece.chain:
        chain = [*piece.chain, (points, cell)]
        stages = [
            space.Stage(Polytope.from_points(part), int(every.cells.mode[j]), every.M[j], every.c[j])
            for part, j in chain
        ]
        return space.longest(loop, F, v, stages)
    mode = every.cells.mode[cell]
    corners = every.corners[mode]
    point = points[np.argmax(every.images(points, np.full(len(points), cell)) @ v)]
    return replay(loop, point, [mode], [corners[np.argmax(corners @ v)]])


# -- successors within X ------------------------------------------------------------------------------


def _highest_in_state_set(X: Polytope, every: LoopCells, F: Polytope, rows: _Rows) -> Array:
    """Upper bounds (k,) of v x+ over the successors x+ of states of F that lie in X; rounding is counted.

    The successors from a part of a cell lie in the hull of M x + c at its corners, plus D, plus a box of the error.
    Where this set lies in X its own maximum counts, else a linear program bounds it (`_successors_in`). One is
    solved only for a part that may pass what the others attain.
    """
    part, index = every.cells.restrict(F)
    images = every.images(part.points, index[part.owner])
    mode = every.cells.mode[index]

    def tops(V: Array) -> Array:
        spread = np.array([(V @ corners.T).max(axis=1) for corners in every.corners])
        return part.largest(images @ V.T) + spread[mode] + every.error[index] @ np.abs(V).T

    inside = np.all(tops(X.H) <= X.h, axis=1)
    most = np.where(inside[:, None], tops(rows.V), np.minimum(tops(rows.V), X.bound(rows.V)))

    def program(i: int) -> tuple[LinearProgram, IntArray]:
        points, cell = images[part.starts[i] : part.starts[i + 1]], index[i]
        return _successors_in(X, points, every.corners[mode[i]], every.error[cell])

    bound = space.highest_within(most, inside, program, rows.V)
    return np.ceil(bound / rows.unit + 0.05) * rows.unit


def _successors_in(X: Polytope, points: Array, corners: Array, error: Array) -> tuple[LinearProgram, IntArray]:
    """X & (hull of `points` + hull of `corners` + box of half-widths `error`) as a linear program; its columns of x+.

    The states x+ are sums of convex combinations of the points and of the corners.
    """
    lp, axes = LinearProgram(), np.eye(X.dimension)
    after = lp.add_columns(-X.bound(-axes), X.bound(axes))
    shares, weights = (lp.add_columns(np.zeros(len(ends)), np.ones(len(ends))) for ends in (points, corners))
    lp.add_rows(after, X.H, upper=X.h)
    lp.add_row(shares, np.ones(len(shares)), 1.0, 1.0)
    lp.add_row(weights, np.ones(len(weights)), 1.0, 1.0)
    lp.add_rows(np.concatenate([after, shares, weights]), np.hstack([axes, -points.T, -corners.T]), -error, error)
    return lp, after
