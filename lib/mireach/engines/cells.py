"""The exact cells of a closed loop in the plane.

Under a maxout network a piecewise-affine system with two states is again piecewise affine: X falls into
convex polygons, the cells, on each of which one mode acts and Phi is affine. The support function of the
reachable set is then a maximum over the vertices of (cell & F), without any MILP.
"""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from ..compiled import highest
from ..loop import require_inputs
from ..lp import LinearProgram
from ..polygons import Polygons
from ..polytope import Polytope
from .common import Lazily, Support, checked_query, empty_support, replay

TOUCH = 1e-11  # closed sets that come this close touch (relative to the size of X)
ROUNDING = 2.0**-36  # bounds are rounded up to multiples of this, relative to the size of the states
MOST_PIECES = 20_000  # polygons that a reachable set of several steps may fall into


@dataclass(frozen=True, eq=False)
class Cells:
    """A covering of X by closed convex polygons, each with one mode and one affine piece u = K x + g.

    Attributes
    ----------
    polygons : Polygons
        N cells. On a boundary that modes share, each of them has a cell, be it only an edge or a point.
    mode : array (N,) of int
    K : array (N, m, 2)
    g : array (N, m)
    """

    polygons: Polygons
    mode: np.ndarray
    K: np.ndarray
    g: np.ndarray

    def __len__(self):
        return len(self.polygons)

    def take(self, chosen):
        """The cells with the given indices."""
        return Cells(self.polygons.take(chosen), self.mode[chosen], self.K[chosen], self.g[chosen])

    @cached_property
    def size(self):
        """Largest coordinate, at least 1."""
        return _size(self.polygons.points)

    def restrict(self, F):
        """Those parts of the cells that meet the Polytope F: Polygons, and the cell each comes from."""
        polygons, norms = self.polygons, np.linalg.norm(F.H, axis=1)
        norms[norms == 0] = 1
        H, h = F.H / norms[:, None], F.h / norms
        touch = TOUCH * self.size
        excess = polygons.points @ H.T - h
        near = (polygons.least(excess) <= touch).all(axis=1)
        straddling = near[:, None] & (polygons.largest(excess) > touch)
        whole = np.flatnonzero(near & ~straddling.any(axis=1))
        cut = np.flatnonzero(straddling.any(axis=1))
        pieces = polygons.take(cut)
        for row in np.flatnonzero(straddling.any(axis=0)):
            a, b = np.broadcast_to(H[row], (len(pieces), 2)), np.full(len(pieces), h[row])
            pieces, kept = pieces.clip(a, b, touch)
            cut = cut[kept]
        return Polygons.join([polygons.take(whole), pieces]), np.concatenate([whole, cut])


@dataclass(frozen=True, eq=False)
class LoopCells:
    """The cells of a loop with its nominal dynamics x+ = M x + c on each of them.

    Attributes
    ----------
    cells : Cells
    M : array (N, 2, 2)
    c : array (N, 2)
    unit : float
        Bounds are rounded up to multiples of this power of two, the same for all sets of the loop.
    """

    cells: Cells
    M: np.ndarray
    c: np.ndarray
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
    Cells
        The same object for loops that differ only in A, B, p or the disturbances.

    Raises
    ------
    ValueError
        If the loop has not two states, or Phi leaves U somewhere in X (checked at every vertex, which
        for an affine piece decides it).
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
    found = _cells(loop.network, tuple(mode.region for mode in system.modes), system.state_set, system.input_set)
    A, B, p = (maps[found.mode] for maps in system.maps)
    every = LoopCells(found, A + B @ found.K, np.einsum("nij,nj->ni", B, found.g) + p, 0.0)
    images = every.images(found.polygons.points, found.polygons.owner)
    limits = [mode.disturbance.bounding_box() for mode in system.modes]
    size = max(_size(found.polygons.points), _size(images), _size(np.array(limits)))
    return replace(every, unit=ROUNDING * 2.0 ** np.ceil(np.log2(size)))


def support(loop, F, V, steps=1):
    """h of R_k(F) along the rows of V, by the vertices of the cells (Lemma 2 without its MILP).

    Parameters
    ----------
    loop : ClosedLoop
        With two states.
    F : Polytope
        States outside X have no successor: F & X counts. Flat sets and points are fine.
    V : array (k, 2)
    steps : int
        More than one step follows every piece of the reachable set through the cells; their number
        grows quickly with `steps`.

    Returns
    -------
    Support
        `bound` is the value rounded up by at most 3e-11 of the size of X and its image (times |v| for
        long rows), so that rounding errors are covered and equal sets give equal numbers.

    Raises
    ------
    ValueError
        If the loop has not two states, or the reachable set falls into too many pieces.

    Notes
    -----
    Against the exact engine `bound` was never below the truth, sets apart that are needles: where two rows of F
    are parallel to within w, rounding moves the point in which they meet by about 1e-15 / w, which can exceed the
    rounding up of the bound: by 6e-12 for w = 1e-4, by 4e-9 for w = 1e-6. engine="exact" settles such sets.
    """
    V, steps = checked_query(loop, F, V, steps)
    every = dynamics(loop)
    rows = _rows(loop, every, V.shape, V.tobytes())
    pieces = [(F, ())]
    for step in range(steps - 1):
        pieces = [image for piece, chain in pieces for image in _images(every, piece, loop, chain)]
        if len(pieces) > MOST_PIECES:
            raise ValueError(
                f"after {step + 1} steps the reachable set has {len(pieces)} pieces; take fewer steps, "
                'a smaller F, or engine="milp"'
            )
    value, end, cell = np.full(len(V), -np.inf), np.zeros(len(V), int), np.zeros(len(V), int)
    for number, (piece, _) in enumerate(pieces):
        reached, where = _highest(every, piece, rows)
        better = reached > value
        value[better], end[better], cell[better] = reached[better], number, where[better]
    if not np.isfinite(value).all():
        return empty_support(len(V))
    witness = Lazily(len(V), lambda k: _witness(loop, every, F, V[k], *pieces[end[k]], cell[k]))
    return Support(value, np.ceil(value / rows.unit + 0.05) * rows.unit, witness)


# -- building the cells -------------------------------------------------------------------------------


@lru_cache(maxsize=128)
def _cells(network, regions, state_set, input_set):
    """Cells of `network` over X and the regions: cut by the rows of x, then layer by layer, then by rows of (x, u).

    Raises ValueError if the network leaves U at a vertex of them.
    """
    n = 2
    found = Cells(
        Polygons.of([state_set.vertices()] * len(regions)),
        np.arange(len(regions)),
        np.zeros((len(regions), 0, n)),
        np.zeros((len(regions), 0)),
    )
    found = _cut_by_regions(found, regions, with_input=False)
    found = _cut_by_network(found, network)
    found = _cut_by_regions(found, regions, with_input=True)
    require_inputs(network, input_set, found.polygons.points)
    return found


def _cut_by_regions(found, regions, with_input):
    """Cut each cell by those rows of its mode's region that involve u, or by those that do not."""
    touch = TOUCH * _size(found.polygons.points)
    mode_rows = []
    for region in regions:
        H, h = region.H, region.h
        chosen = (H[:, 2:] != 0).any(axis=1) == with_input
        mode_rows.append((H[chosen], h[chosen]))
    for row in range(max(len(h) for _, h in mode_rows)):
        owns = np.array([row < len(h) for _, h in mode_rows])
        H = np.array([H[row] if row < len(h) else np.zeros(H.shape[1]) for H, h in mode_rows])[found.mode]
        h = np.array([h[row] if row < len(h) else 0.0 for _, h in mode_rows])[found.mode]
        a, b = H[:, :2], h
        if with_input:
            a = a + np.einsum("nm,nmi->ni", H[:, 2:], found.K)
            b = b - np.einsum("nm,nm->n", H[:, 2:], found.g)
        norm = np.maximum(np.linalg.norm(a, axis=1), np.linalg.norm(H, axis=1))
        norm[~owns[found.mode]] = 1
        polygons, kept = found.polygons.clip(a / norm[:, None], b / norm, 10 * touch if with_input else touch)
        found = replace(found.take(kept), polygons=polygons)
    return found


def _cut_by_network(found, network):
    """Cut cells wherever the winning channel of a neuron changes; K and g become those of Phi."""
    count = len(found)
    K, g = np.broadcast_to(np.eye(2), (count, 2, 2)), np.zeros((count, 2))
    for layer in network.hidden:
        K_next, g_next = np.empty((len(found), layer.width, 2)), np.empty((len(found), layer.width))
        for neuron in range(layer.width):
            rows = slice(neuron * layer.pool, (neuron + 1) * layer.pool)
            K_channels = layer.weight[rows] @ K
            g_channels = g @ layer.weight[rows].T + layer.bias[rows]
            polygons, parent, winner = _cut_by_winner(found.polygons, K_channels, g_channels)
            found = replace(found.take(parent), polygons=polygons)
            K, g, K_next, g_next = K[parent], g[parent], K_next[parent], g_next[parent]
            K_next[:, neuron], g_next[:, neuron] = K_channels[parent, winner], g_channels[parent, winner]
        K, g = K_next, g_next
    return replace(found, K=network.weight @ K, g=g @ network.weight.T + network.bias)


def _cut_by_winner(polygons, K, g):
    """Split polygons into the parts on which one channel K[:, j] x + g[:, j] is the largest.

    Returns the parts, the polygon each comes from, and its winning channel. Phi is continuous, so parts
    of lower dimension than their polygon are left out: their neighbours contain them.
    """
    touch = TOUCH * _size(polygons.points)
    z = np.einsum("tji,ti->tj", K[polygons.owner], polygons.points) + g[polygons.owner]
    margin = polygons.least(z - z.max(axis=1, keepdims=True))
    winner = margin.argmax(axis=1)
    settled = margin.max(axis=1) >= -touch
    undecided = np.flatnonzero(~settled)
    if not len(undecided):
        return polygons, np.arange(len(polygons)), winner
    open_polygons = polygons.take(undecided)
    rank = open_polygons.rank(touch)
    batches, parents, winners = [polygons.take(np.flatnonzero(settled))], [np.flatnonzero(settled)], [winner[settled]]
    orphan = np.ones(len(undecided), bool)
    for j in range(K.shape[1]):
        part, source = open_polygons, np.arange(len(undecided))
        for i in range(K.shape[1]):
            if i == j:
                continue
            a = K[undecided[source], i] - K[undecided[source], j]
            b = g[undecided[source], j] - g[undecided[source], i]
            steepness = np.maximum(np.linalg.norm(a, axis=1), 1)
            part, kept = part.clip(a / steepness[:, None], b / steepness, touch if i < j else 0.0)
            source = source[kept]
            if i < j:  # where two channels agree on all of the part, the first of them has it
                ahead = _excess(part, a[kept], b[kept])
                part, source = part.take(ahead), source[ahead]
        full = np.flatnonzero(part.rank(touch) == rank[source]) if len(part) else np.zeros(0, int)
        orphan[source[full]] = False
        batches.append(part.take(full))
        parents.append(undecided[source[full]])
        winners.append(np.full(len(full), j))
    if orphan.any():  # thinner than rounding in every part: one winner does for all of it
        lost = undecided[orphan]
        batches.append(polygons.take(lost))
        parents.append(lost)
        winners.append(winner[lost])
    return Polygons.join(batches), np.concatenate(parents), np.concatenate(winners)


def _excess(part, a, b):
    """Indices of the polygons somewhere in which a x < b by more than rounding."""
    if not len(part):
        return np.zeros(0, int)
    slack = b[part.owner] - np.einsum("ti,ti->t", part.points, a[part.owner])
    return np.flatnonzero(part.largest(slack) > TOUCH * _size(part.points))


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
    heights : array (N, k)
        Largest v x+ without disturbance over each cell.
    spread : array (s, k)
        h of D^(i).
    unit : array (k,)
        Bounds are rounded up to multiples of it.
    """

    V: np.ndarray
    heights: np.ndarray
    spread: np.ndarray
    unit: np.ndarray


@lru_cache(maxsize=32)
def _rows(loop, every, shape, content):
    """The _Rows of an array of this shape and content."""
    V, polygons = np.frombuffer(content).reshape(shape).copy(), every.cells.polygons
    known = {}
    for mode in loop.system.modes:
        if mode.disturbance not in known:
            known[mode.disturbance] = mode.disturbance.support(V)
    return _Rows(
        V,
        polygons.largest(every.images(polygons.points, polygons.owner) @ V.T),
        np.array([known[mode.disturbance] for mode in loop.system.modes]),
        every.unit * 2.0 ** np.floor(np.log2(np.linalg.norm(V, axis=1).clip(1))),
    )


def _highest(every, F, rows):
    """max v x+ over the states of F, for the rows v of V, and the cell in which it is attained: (k,) and (k,)."""
    polygons, mode, touch = every.cells.polygons, every.cells.mode, TOUCH * every.cells.size
    shape = (polygons.points, polygons.starts, *polygons.discs)
    return highest(*shape, every.M, every.c, mode, rows.heights, rows.spread, F.H, F.h, touch, rows.V)


def _images(every, F, loop, chain):
    """The convex images M (cell & F) + c + D, each with the chain of (polygon, cell) that led to it."""
    part, index = every.cells.restrict(F)
    corners = [mode.disturbance.vertices() for mode in loop.system.modes]
    images = Polygons(every.images(part.points, index[part.owner]), part.starts)
    return [
        (
            Polytope.from_points((images[i][:, None] + corners[every.cells.mode[cell]]).reshape(-1, 2)),
            (*chain, (part[i], cell)),
        )
        for i, cell in enumerate(index)
    ]


def _witness(loop, every, F, v, piece, chain, cell):
    """A trajectory that attains the maximum along v: through the chain, to the part of `cell` in `piece`."""
    part, _ = every.cells.take([cell]).restrict(piece)
    points = part.points
    if chain:
        return _longer_witness(loop, every, F, v, [*chain, (points, cell)])
    mode = every.cells.mode[cell]
    corners = loop.system.modes[mode].disturbance.vertices()
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
