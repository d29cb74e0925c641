"""The exact cells of a closed loop in the plane.

Under a maxout network a piecewise-affine system with two states is again piecewise affine: X falls into
convex polygons, the cells, on each of which one mode acts and Phi is affine. The support function of the
reachable set is then a maximum over the vertices of (cell & F), without any MILP.
"""

from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, lru_cache
from math import inf, nextafter
from typing import ClassVar

import numpy as np

from ..sets.kernels import affine_pieces, highest, parts, sharp_pairs
from ..sets.polygons import Polygons
from ..sets.polytope import Polytope, box_directions
from ..solvers.linear_program import LinearProgram
from .base import Engine, LazySequence, Support, checked_query, empty_support, replay

TOUCH = 1e-11  # closed sets that come this close touch (relative to the size of X)
ROUNDING = 2.0**-36  # bounds are rounded up to multiples of this (in the units of the loop) ...
NOISE = 2.0**-44  # ... and of this for large images, relative to them: it has to stay above the rounding of floats
CORNER = 2.0**-50  # how far rounding moves a new corner off its edge, at most (relative to the size of X)
SHAPED = 16  # cuts that a polygon of X and a region counts for; rounding moves its corners by no more than theirs
CUTS = 64  # cuts by rows of F, one after the other, that the errors of a cell allow for
PARALLEL = 4e-15  # rows of a smaller sine are opposite but for rounding, as those of a template are
SHARP = 0.1  # tips of a smaller sine are cut off by a row of their own, for rounding moves them far
MOST_PIECES = 20_000  # polygons that a reachable set of several steps may fall into


@dataclass(frozen=True, eq=False)
class Walls:
    """The half-planes of x beyond which the state or a mode ends: rows H x <= h of X and of regions.

    Attributes
    ----------
    H, h : array (w, 2) and (w,)
    mode : array (w,) of int
        The mode whose region the row bounds; -1 for the rows of X.
    """

    H: np.ndarray
    h: np.ndarray
    mode: np.ndarray


@dataclass(frozen=True, eq=False)
class NetworkCells:
    """A covering of X by closed convex polygons, each with one mode and one affine piece u = K x + g.

    Attributes
    ----------
    polygons : Polygons
        N cells. On a boundary that modes share, each of them has a cell, be it only an edge or a point.
    mode : array (N,) of int
    K : array (N, m, 2)
    g : array (N, m)
    error : array (N, m)
        |K x + g - Phi(x)| is at most this on the cell, as far as the rounding of its corners reaches.
    cuts : array (N,) of int
        Every state x of a mode lies within `cuts` CORNER of a cell of the mode (relative to the size of X).
    walls : Walls
    """

    polygons: Polygons
    mode: np.ndarray
    K: np.ndarray
    g: np.ndarray
    error: np.ndarray
    cuts: np.ndarray
    walls: Walls

    def __len__(self):
        return len(self.polygons)

    def take(self, chosen):
        """The cells with the given indices."""
        per_cell = (self.mode, self.K, self.g, self.error, self.cuts)
        return NetworkCells(self.polygons.take(chosen), *(array[chosen] for array in per_cell), self.walls)

    @cached_property
    def all(self):
        """The indices of all cells: array (N,)."""
        return np.arange(len(self))

    @cached_property
    def size(self):
        """Largest coordinate, at least 1."""
        return _size(self.polygons.points)

    def restrict(self, F):
        """Those parts of the cells that meet the Polytope F: Polygons, and the cell each comes from.

        A part is the intersection to within rounding, from outside, wherever F has an edge.
        """
        points, starts, owner = parts(*self.question(F))
        return Polygons(points, starts), owner

    def question(self, F):
        """What the compiled loops have to know: the cells, the half-planes of F, and what counts as rounding.

        Cells are cut a little beyond each row of F, so that nothing of F is lost to rounding.
        """
        H, h, only = _blunted(F, self.walls, self.size)
        slack = (self._most_cuts + len(h)) * CORNER * self.size
        return (*self._shapes, H, h, only, slack, TOUCH * self.size)

    @cached_property
    def _shapes(self):
        return (self.polygons.points, self.polygons.starts, *self.polygons.discs, self.mode)

    @cached_property
    def _most_cuts(self):
        return int(self.cuts.max(initial=0))


@dataclass(frozen=True, eq=False)
class CellSupport(Support):
    """A Support and the cells that are worth a look for smaller sets.

    Attributes
    ----------
    F : Polytope
        Of which the reachable set was asked for.
    cells : NetworkCells
    left : array (q,) of int
        All of them but those that were found to miss F.
    """

    F: Polytope
    cells: NetworkCells
    left: np.ndarray

    def within(self, F, cells):
        """Those of `cells` that a set F may meet: `left` if it lies in the one here, row by row, else all of them."""
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
        Of M x + c + d, by component: the state x that it stands for is another one by rounding, and so are M and c.
    corners : list of arrays (v, 2)
        Of the D^(i) of every mode.
    unit : float
        Bounds are rounded up to multiples of this power of two, the same for all sets of the loop.
    """

    cells: NetworkCells
    M: np.ndarray
    c: np.ndarray
    error: np.ndarray
    corners: list
    unit: float

    def images(self, points, owner):
        """M x + c at points (T, 2) of the cells `owner` (T,): array (T, 2)."""
        return np.einsum("tij,tj->ti", self.M[owner], points) + self.c[owner]


def cells(loop):
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
        If the loop has not two states.
    """
    return dynamics(loop).cells


@lru_cache(maxsize=128)
def dynamics(loop):
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
    known = {mode.disturbance: _corners(mode.disturbance) for mode in system.modes}
    every = LoopCells(found, M, c, np.zeros_like(c), [known[mode.disturbance] for mode in system.modes], 0.0)
    images = every.images(found.polygons.points, found.polygons.owner)
    size = max(_size(found.polygons.points), _size(images), *(_size(corners) for corners in known.values()))
    inputs = np.abs(found.K).sum(axis=2) * found.size + np.abs(found.g) + found.error
    rounding = np.abs(A).sum(axis=2) * found.size + np.einsum("nij,nj->ni", np.abs(B), inputs) + np.abs(p) + size
    error = np.einsum("nij,nj->ni", np.abs(B), found.error) + 4 * CORNER * rounding
    error += np.abs(M).sum(axis=2) * ((found.cuts + CUTS) * CORNER * found.size)[:, None]
    return replace(every, error=error, unit=_unit(size))


@dataclass(frozen=True)
class Cells(Engine):
    """h of R_k(F) by the vertices of the cells, the pieces of X on which the loop is affine (Lemma 2 without its MILP).

    For two states, any number of steps, and F of any shape, points included.

    See Also
    --------
    Exact : the same cells in rational arithmetic, for one step.
    Milp : for any number of states.

    Notes
    -----
    exact <= bound <= exact + 1e-9 was found for every set that was compared with the exact engine, thin slivers and
    needles among them, along rows of length 1, for loops with coordinates up to 800 and gains |M| up to 400. What is
    behind it, with eta = `CORNER` for what rounding does to one corner:

    - Every state x of a mode lies within `cuts` eta of a cell of that mode, and there |K x + g - Phi(x)| is at most
      the `error` of the cell (`compiled.affine_pieces`); large weights make it large. Rows of a region that involve u
      are moved outward by it.
    - Cells are cut by the rows of F moved outward by (`cuts` + rows) eta, so what is left of the cell holds a point
      that near x, and v x+ is at most the largest v (M x + c + d) over its corners plus |v| times `LoopCells.error`:
      |B| error + |M| (cuts + 64) eta + the rounding of M, c and d. So the bound is not below the truth.
    - Nor is it far above. What is left of a cell may lie outside of F & X, or outside of the cell itself, but not by
      more than that in any row. Edges between cells of one mode may be as parallel as they like: Phi is continuous.
      Where two rows of F, or one of F and one of X or of a region, make a tip of a sine below `SHARP`, a row through
      the exact tip, in rational arithmetic, is added across it.

    What remains: a mode whose boundary depends on u reaches as far as the rounding of u says, so for a row of F that
    is parallel to the boundary within an angle w the bound is high by about 1e-14 / w. Sets that come within 1e-11 of
    each other count as touching, and rows that are opposite to within 4e-15 as parallel. With `steps` > 1 each piece
    is widened by its error before it goes on: the bound stays above the truth, and that error grows with the gain of
    the loop.
    """

    name: ClassVar[str] = "cells"

    def support(self, loop, F, V, steps=1, *, cutoff=None, warm_start=None) -> Support:
        """As `Engine.support`, for two states.

        Notes
        -----
        For one step the answer is a `CellSupport`: as `warm_start` for a smaller set it names the cells that need not
        be looked at again. More than one step follows every piece of the reachable set through the cells; their number
        grows with `steps`. `bound` is rounded up to a multiple of 1.5e-11, of more for images above 256 (times |v| for
        long rows), so that equal sets give equal numbers. `cutoff` is not used.

        Raises
        ------
        ValueError
            If the loop has not two states, or the reachable set falls into too many pieces.
        """
        V, steps = checked_query(loop, F, V, steps)
        every = dynamics(loop)
        chosen = every.cells.all
        if steps == 1 and isinstance(warm_start, CellSupport):
            chosen = warm_start.within(F, every.cells)
        rows = _rows(loop, every, V.shape, V.tobytes())
        pieces = [(F, ())]
        for step in range(steps - 1):
            pieces = _uncovered([image for piece, chain in pieces for image in _images(every, piece, chain)])
            if len(pieces) > MOST_PIECES:
                raise ValueError(
                    f"after {step + 1} steps the reachable set has {len(pieces)} pieces; take fewer steps, "
                    'a smaller F, or engine="milp"'
                )
        if not pieces:
            return empty_support(len(V))
        value, top, cell, left = _highest(every, pieces[0][0], rows, chosen)
        end = np.zeros(len(V), int)
        for number, (piece, _) in enumerate(pieces[1:], start=1):
            reached, above, where, _ = _highest(every, piece, rows, chosen)
            better = above > top
            value[better], top[better], cell[better] = reached[better], above[better], where[better]
            end[better] = number
        if not np.isfinite(value).all():
            return empty_support(len(V))
        witness = LazySequence(len(V), lambda k: _witness(loop, every, F, V[k], *pieces[end[k]], cell[k]))
        found = value, np.ceil(top / rows.unit + 0.05) * rows.unit, witness
        return CellSupport(*found, F, every.cells, left) if steps == 1 else Support(*found)


# -- building the cells -------------------------------------------------------------------------------


@lru_cache(maxsize=128)
def _cells(network, regions, state_set):
    """Cells of `network` over X and the regions: cut by the rows of x, then layer by layer, then by rows of (x, u)."""
    return _cut_by_inputs(_before_inputs(network, regions, state_set), regions)


@lru_cache(maxsize=128)
def _before_inputs(network, regions, state_set):
    """The NetworkCells before they are cut by those rows of regions that involve u: they cover X for every mode."""
    domains, modes, walls = _domains(regions, state_set)
    size = _size(domains.points)
    layers = [(layer.weight, layer.bias, layer.pool) for layer in network.hidden] + [(network.weight, network.bias, 1)]
    points, shape, values = affine_pieces(
        domains.points,
        domains.starts,
        np.concatenate([weight.ravel() for weight, _, _ in layers]),
        np.concatenate([bias for _, bias, _ in layers]),
        np.array([2] + [len(bias) // pool for _, bias, pool in layers]),
        np.array([pool for _, _, pool in layers]),
        size,
        TOUCH * size,
        CORNER * size,
        SHAPED,
    )
    sizes, owner, cuts = shape.T
    polygons = Polygons(points, np.concatenate([[0], np.cumsum(sizes)]))
    K, g, error = np.split(values.reshape(len(values), -1, 4), [2, 3], axis=2)
    return NetworkCells(polygons, modes[owner], K.copy(), g[..., 0].copy(), error[..., 0].copy(), cuts, walls)


def input_excess(network, regions, X, U):
    """By how much Phi may leave U over X, in the units of U.h.

    Parameters
    ----------
    network : MaxoutNetwork
        With two inputs.
    regions : tuple of Polytope
    X, U : Polytope

    Returns
    -------
    most : float
        max U.H Phi(x) - U.h over all x of X and all rows is at most this, rounding counted.
    excess : float
        The largest value that was found, up to rounding.
    x : array (2,)
        Where it was found.
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
def _domains(regions, state_set):
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


def _corners(P, H=np.zeros((0, 2)), h=np.zeros(0)):  # noqa: B008
    """The corners of {x in P : H x <= h} for a bounded Polytope P: array (v, 2).

    They are off by no more than the rounding that `SHAPED` cuts count for, or further out where a tip is sharp.
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
    if (apart > SHAPED / 2 * corner).any():  # `vertices` takes corners that are closer than 1e-11 as one
        start = careful
    found = Polygons.of([start])
    for a, b in zip(H, h):
        norm = max(np.linalg.norm(a), np.finfo(float).tiny)
        found, _ = found.clip(a[None] / norm, np.array([b / norm]), touch)
        if not len(found):
            break
    return found.points


def _part(corners, H, h, only, slack, touch):
    """The part of one polygon in half-planes: array (v, 2)."""
    whole = Polygons.of([corners])
    return parts(whole.points, whole.starts, *whole.discs, np.zeros(1, int), H, h, only, slack, touch)[0]


def _cut_by_inputs(found, regions):
    """Cut each cell by those rows of its mode's region that involve u; outward, by the error of u."""
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


def _unit(size):
    """The power of two of which bounds are multiples, for states of this size."""
    power = 2.0 ** np.ceil(np.log2(size))
    return max(ROUNDING, NOISE * power)


def _size(points):
    """Largest coordinate, at least 1: what tolerances are relative to."""
    return max(1.0, np.abs(points).max(initial=0.0))


# -- asking -------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Rows:
    """What does not depend on F, for the rows v of V.

    Attributes
    ----------
    V : array (k, 2)
    heights, tops : array (N, k)
        Largest v x+ over each cell, and with the error of the cell.
    spread : array (s, k)
        h of D^(i).
    unit : array (k,)
        Bounds are rounded up to multiples of it.
    """

    V: np.ndarray
    heights: np.ndarray
    tops: np.ndarray
    spread: np.ndarray
    unit: np.ndarray


@lru_cache(maxsize=32)
def _rows(loop, every, shape, content):
    """The _Rows of an array of this shape and content."""
    V, found = np.frombuffer(content).reshape(shape).copy(), every.cells
    spread = np.array([(V @ corners.T).max(axis=1) for corners in every.corners])
    heights = found.polygons.largest(every.images(found.polygons.points, found.polygons.owner) @ V.T)
    heights += spread[found.mode]
    unit = every.unit * 2.0 ** np.floor(np.log2(np.linalg.norm(V, axis=1).clip(1)))
    return _Rows(V, heights, heights + every.error @ np.abs(V).T, spread, unit)


def _highest(every, F, rows, chosen):
    """max v x+ over the states of F in chosen cells, the same with its error, and the cell; and the cells F may meet.

    Arrays (k,) for the rows v of V, and (q,).
    """
    asked = every.cells.question(F)
    return highest(*asked, every.M, every.c, every.error, rows.spread, rows.heights, rows.tops, rows.V, chosen)


def _blunted(F, walls, size):
    """The rows of F, and one across every sharp tip that they make with each other or with a wall.

    Returns H, h and the mode (-1 for all) to which each row belongs.
    """
    pairs, count = sharp_pairs(F.H, F.h, walls.H, walls.h, size, PARALLEL, SHARP), len(F.h)
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
    # a Polytope, for the compiled loops are compiled for arrays like its own, which cannot be written to
    blunt = Polytope(np.vstack([F.H, [a for a, _, _ in tips]]), np.append(F.h, [b for _, b, _ in tips]))
    return blunt.H, blunt.h, np.append(only, [mode for _, _, mode in tips])


def _exact_row(a, b):
    """A half-plane a x <= b as three Fractions."""
    return [Fraction(value) for value in (*a.tolist(), float(b))]


def _across(normal, first, second):
    """The half-plane a x <= b across the tip of two others, a being `normal` turned by a right angle.

    The tip is exact, b rounded up. Every point of the two lies in it: a is between their normals.
    """
    (p, q, r), (s, t, u) = first, second
    turn = p * t - q * s
    a = np.array([-normal[1], normal[0]]) * (1 if turn > 0 else -1)
    x, y = (r * t - q * u) / turn, (p * u - r * s) / turn
    exact = Fraction(a[0]) * x + Fraction(a[1]) * y
    b = float(exact)
    return a, b if Fraction(b) >= exact else nextafter(b, inf)


@dataclass(frozen=True, eq=False)
class _Image:
    """The image of a part of a cell: the hull of `points` (v, 2), off by no more than `error` (2,).

    `set` is that hull, widened by the error; `chain` holds the (polygon, cell) that led here.
    """

    points: np.ndarray
    error: np.ndarray
    set: Polytope
    chain: tuple


def _images(every, F, chain):
    """The images of the parts of F: list of _Image. A box cuts them off, so that widening does not lengthen tips."""
    part, index = every.cells.restrict(F)
    images, found = Polygons(every.images(part.points, index[part.owner]), part.starts), []
    for i, cell in enumerate(index):
        points = (images[i][:, None] + every.corners[every.cells.mode[cell]]).reshape(-1, 2)
        H = np.vstack([Polytope.from_points(points).H, box_directions(2)])
        h = (points @ H.T).max(axis=0) + np.abs(H) @ every.error[cell]
        found.append(_Image(points, every.error[cell], Polytope(H, h), (*chain, (part[i], cell))))
    return found


def _uncovered(images):
    """(Polytope, chain) of those images that lie in no larger one, errors included."""
    if not images:
        return []
    images = sorted(images, key=lambda image: -image.set.area)
    points, error = Polygons.of([image.points for image in images]), np.array([image.error for image in images])
    box = points.largest(points.points @ box_directions(2).T) + np.hstack([error, error])  # a set's own box is one too
    left, kept = np.arange(len(images)), []
    while len(left):
        first, left = left[0], left[1:]
        largest = images[first].set
        kept.append((largest, images[first].chain))
        near = left[(box[left] <= box[first]).all(axis=1)]
        part = points.take(near)
        reach = part.largest(part.points @ largest.H.T) + error[near] @ np.abs(largest.H).T
        left = np.setdiff1d(left, near[(reach <= largest.h).all(axis=1)], assume_unique=True)
    return kept


def _witness(loop, every, F, v, piece, chain, cell):
    """A trajectory that attains the maximum along v: through the chain, to the part of `cell` in `piece`."""
    part, index = every.cells.restrict(piece)
    points = part[np.flatnonzero(index == cell)[0]]
    if chain:
        return _longer_witness(loop, every, F, v, [*chain, (points, cell)])
    mode = every.cells.mode[cell]
    corners = every.corners[mode]
    point = points[np.argmax(every.images(points, np.full(len(points), cell)) @ v)]
    return replay(loop, point, [mode], [corners[np.argmax(corners @ v)]])


def _longer_witness(loop, every, F, v, chain):
    """max v x(k) over x(0) in F, x(j) in the j-th polygon, d(j) in D: one LP for a known chain of polygons."""
    lp, free = LinearProgram(), np.full(2, np.inf)
    states = [lp.add_columns(-free, free) for _ in range(len(chain) + 1)]
    disturbances = [lp.add_columns(-free, free) for _ in chain]
    modes = [every.cells.mode[cell] for _, cell in chain]
    lp.add_rows(states[0], F.H, upper=F.h)
    for j, (points, cell) in enumerate(chain):
        polygon, D = Polytope.from_points(points), loop.system.modes[modes[j]].disturbance
        lp.add_rows(states[j], polygon.H, upper=polygon.h)
        lp.add_rows(disturbances[j], D.H, upper=D.h)
        columns = np.concatenate([states[j + 1], states[j], disturbances[j]])
        step = np.hstack([np.eye(2), -every.M[cell], -np.eye(2)])
        lp.add_rows(columns, step, lower=every.c[cell], upper=every.c[cell])
    best = lp.maximize(states[-1], v).point
    return replay(loop, best[states[0]], modes, [best[d] for d in disturbances])
