"""The cells of a closed loop without rounding, for any number of states: where the loop is affine, and its maps there.

A number is the IEEE float that it is (`rational`). Points, rows and affine maps are homogeneous integers: the map
x -> M x + c is the matrix with the rows d (M, c) and the last row (0, d), with d > 0.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import islice
from typing import Any, NamedTuple, TypeVar

import numpy as np

from ..arithmetic.balls import flint
from ..arithmetic.rational import dot, nearest
from ..errors import CellLimitError
from ..sets.exact_polytopes import ExactPolytope, Integers, integers
from ..sets.polytope import Polytope
from ..systems.loop import ClosedLoop
from ..systems.network import Layer, MaxoutNetwork
from ..systems.pwa import Mode
from ..tolerances import AROUND, SMALL_PRODUCTS
from ..typing import Array, BoolArray, IntArray, Rational
from .steps import Form, dynamics, matrices

MOST_CELLS = 20_000  # cells of a loop with four states that are kept; `affordable` says how many for others
FEW_CELLS = 1_000  # as MOST_CELLS, where exact arithmetic is not asked for but settles a doubt: a few seconds
SAMPLES = 250  # random states that are tried first before pieces are built

Point = tuple[Rational, ...]
Map = Any  # an fmpz_mat: a homogeneous affine map

T = TypeVar("T")


class Piece(NamedTuple):
    """A polytope on which Phi is affine: Phi = K x + g.

    Attributes
    ----------
    part : ExactPolytope
    output : Map
        x -> K x + g.
    """

    part: ExactPolytope
    output: Map


@dataclass(frozen=True, eq=False)
class ExactCell:
    """A closed convex polytope of X on which x+ = M x + c + d, d in D of `mode`.

    Attributes
    ----------
    part : ExactPolytope
    mode : int
        Counted from 0.
    after : Map
        x -> M x + c.
    """

    part: ExactPolytope
    mode: int
    after: Map

    @property
    def corners(self) -> list[Point]:
        """The vertices of the cell: list of tuple of n fmpq."""
        return self.part.vertices

    @cached_property
    def images(self) -> list[Point]:
        """M x + c at the corners: list of tuple of n fmpq."""
        return _points(self.after * self.part.columns)

    @cached_property
    def forms(self) -> list[Form]:
        """The rows of M x + c as affine functions."""
        *rows, last = self.after.tolist()
        return [tuple(flint().fmpq(entry, last[-1]) for entry in row) for row in rows]

    def image(self, x: Point) -> Point:
        """M x + c."""
        return tuple(dot(form, x) + form[-1] for form in self.forms)


class Clouds(NamedTuple):
    """Several sets of points in floats.

    Attributes
    ----------
    points : array (T, n)
    starts : array (sets,) of int
        The first index of each set.
    """

    points: Array
    starts: IntArray

    @classmethod
    def of(cls, sets: Sequence[Array]) -> "Clouds":
        """From the points of every set."""
        return cls(np.concatenate(sets), np.cumsum([0, *map(len, sets[:-1])]))

    def sides(self, H: Array, h: Array) -> tuple[BoolArray, BoolArray]:
        """Whether each set may have a point with a x <= b, and one with a x >= b, for the rows of H x <= h.

        Each array is (sets, l). Rounding is counted: whatever it may have decided is True.
        """
        low, high = np.ones((len(self.starts), len(h)), bool), np.ones((len(self.starts), len(h)), bool)
        size = np.abs(self.points).max(initial=0.0)
        for k, (a, b) in enumerate(zip(H, h)):
            excess, around = self.points @ a - b, AROUND * (size * np.abs(a).sum() + abs(b)) + SMALL_PRODUCTS
            low[:, k] = ~(np.minimum.reduceat(excess, self.starts) > around)
            high[:, k] = ~(np.maximum.reduceat(excess, self.starts) < -around)
        return low, high


def cells(loop: ClosedLoop, most: int = MOST_CELLS) -> tuple[ExactCell, ...]:
    """The cells of a closed loop over X, including those that are only a face, an edge or a point of their mode.

    Parameters
    ----------
    loop : ClosedLoop
    most : int
        For four states; see `affordable`.

    Raises
    ------
    CellLimitError
        If there are more cells than `affordable`.

    Notes
    -----
    A mode acts on the part of X within those rows of its region that do not involve u, and there within the others.
    Pieces of Phi whose share of that part has a lower dimension than the part are left out: Phi is continuous, so that
    neighbours contain such a share. Rows that involve u are cut afterwards, and whatever is left of a piece counts.
    """
    found = _cells(loop, affordable(loop.system.state_size, most))
    return _required(found, "the loop has", "cells", loop.system.state_size, most)


@lru_cache(maxsize=32)
def _cells(loop: ClosedLoop, limit: int) -> tuple[ExactCell, ...] | None:
    """The cells, or None if they are more than `limit`."""
    pieces = _affine_pieces(loop.network, loop.system.state_set, limit)
    if not pieces:
        return None if pieces is None else ()
    found: list[ExactCell] = []
    clouds = Clouds.of([piece.part.floats for piece in pieces])
    for number in range(len(loop.system.modes)):
        found += islice(_cells_of_mode(loop, number, pieces, clouds), limit + 1 - len(found))
    return tuple(found) if len(found) <= limit else None


def _cells_of_mode(loop: ClosedLoop, number: int, pieces: Sequence[Piece], clouds: Clouds) -> Iterator[ExactCell]:
    """The cells of one mode, from the pieces of Phi and their vertices in floats."""
    mode, n = loop.system.modes[number], loop.system.state_size
    of_u: BoolArray = (mode.region.H[:, n:] != 0).any(axis=1)
    rows = rows_of(mode.region)
    rows_of_x = [(*row[:n], row[-1]) for row, with_u in zip(rows, of_u) if not with_u]
    rows_of_xu = [row for row, with_u in zip(rows, of_u) if with_u]
    domain = exactly(loop.system.state_set).clip_all(rows_of_x)
    low, high = clouds.sides(mode.region.H[~of_u, :n], mode.region.h[~of_u])
    for i in np.flatnonzero(low.all(axis=1)).tolist() if not domain.is_empty else ():
        part = pieces[i].part.clip_all(row for row, cuts in zip(rows_of_x, high[i]) if cuts)
        if part.dimension < domain.dimension:
            continue
        xu = _with_input(pieces[i].output)
        if rows_of_xu:
            part = part.clip_all(map(tuple, (flint().fmpz_mat(rows_of_xu) * xu).tolist()))
        if not part.is_empty:
            yield ExactCell(part, number, _dynamics(mode) * xu)


def affordable(n: int, most: int = MOST_CELLS) -> int:
    """The number of cells in R^n that are kept: `most` for n = 4, and half of it for each further state.

    A box has twice as many vertices for each further state, and so have cells.
    """
    return (most << 4) >> n


def _required(found: tuple[T, ...] | None, owner: str, what: str, n: int, most: int) -> tuple[T, ...]:
    """`found`, or a CellLimitError if it is None."""
    if found is None:
        raise CellLimitError(
            f"{owner} more than {affordable(n, most)} {what}, the limit of exact arithmetic for {n} states; "
            'use engine="milp", or raise the limit with Exact(most_cells=...)'
        )
    return found


@lru_cache(maxsize=32)
def cell_floats(loop: ClosedLoop, most: int = MOST_CELLS) -> tuple[Clouds, Clouds]:
    """The corners of all cells and M x + c there, in floats."""
    every = cells(loop, most)
    images = [np.array([[nearest(entry) for entry in x] for x in cell.images]) for cell in every]
    return Clouds.of([cell.part.floats for cell in every]), Clouds.of(images)


@lru_cache(maxsize=64)
def exactly(P: Polytope) -> ExactPolytope:
    """A bounded Polytope, every number the float that it is."""
    return ExactPolytope.of(P)


def rows_of(P: Polytope) -> list[Integers]:
    """The rows (a, -b) of a Polytope."""
    return [integers((*a, -b)) for a, b in zip(*P.exact)]


def disturbances(loop: ClosedLoop) -> list[list[Point]]:
    """The vertices of D^(i) of every mode.

    Raises
    ------
    ValueError
        If a set is empty in rational arithmetic.
    """
    found = []
    for number, mode in enumerate(loop.system.modes, start=1):
        vertices = exactly(mode.disturbance).vertices
        if not vertices:
            raise ValueError(f"the disturbance set of mode {number} is empty in rational arithmetic")
        found.append(vertices)
    return found


# -- pieces of the network ----------------------------------------------------------------------------


def affine_pieces(network: MaxoutNetwork, X: Polytope, most: int = MOST_CELLS) -> tuple[Piece, ...]:
    """Polytopes that cover X, with Phi on each of them.

    Parameters
    ----------
    network : MaxoutNetwork
    X : Polytope
        Bounded.
    most : int
        For four states; see `affordable`.

    Raises
    ------
    CellLimitError
        If there are more of them than `affordable`.
    """
    found = _affine_pieces(network, X, affordable(X.dimension, most))
    return _required(found, "Phi has", "affine pieces", X.dimension, most)


@lru_cache(maxsize=32)
def _affine_pieces(network: MaxoutNetwork, X: Polytope, limit: int) -> tuple[Piece, ...] | None:
    """As `affine_pieces`; None if there are more than `limit`.

    Depth first, so that memory and time are bounded by the limit: every part that is split holds a piece.
    """
    n = X.dimension
    if not limit:
        return None
    whole = exactly(X)
    if whole.is_empty:
        return ()
    if _has_more_pieces(network, X, limit):
        return None
    identity = flint().fmpz_mat(n + 1, n + 1, [int(i == j) for i in range(n + 1) for j in range(n + 1)])
    layers = list(zip(map(_homogeneous, matrices(network)), [*network.hidden, None]))
    found = list(islice(_pieces(whole, identity, layers), limit + 1))
    return tuple(found) if len(found) <= limit else None


def _has_more_pieces(network: MaxoutNetwork, X: Polytope, limit: int) -> bool:
    """Whether random states show that there are more than `limit` pieces, up to rounding.

    States with different largest channels lie in different pieces. There are more and more states, as long as at least
    half of them differ, so that a network with few pieces costs little.
    """
    count = SAMPLES
    while True:
        y, chosen = X.sample(0, count), [np.zeros((count, 1), np.int16)]
        for layer in network.hidden:
            channels = layer.channels(y)
            chosen.append(channels.argmax(axis=-1).astype(np.int16))
            y = channels.max(axis=-1)
        different = len({row.tobytes() for row in np.hstack(chosen)})
        if different > limit or 2 * different < count:
            return different > limit
        count *= 2


def _pieces(part: ExactPolytope, before: Map, layers: Sequence[tuple[Map, Layer | None]]) -> Iterator[Piece]:
    """The pieces of a polytope for the layers that are left; `before` is what the layers before them give on it."""
    (weight, layer), *rest = layers
    if layer is None:
        yield Piece(part, weight * before)
        return
    *channels, last = (weight * before).tolist()
    for smaller, won in _by_neurons(part, channels, layer.pool):
        yield from _pieces(smaller, flint().fmpz_mat([*won, last]), rest)


def _by_neurons(
    part: ExactPolytope, channels: Sequence[Integers], pool: int
) -> Iterator[tuple[ExactPolytope, list[Integers]]]:
    """Split a polytope into parts on which the same channel of each neuron is largest: pairs (part, these channels)."""
    values = part.values(channels) if channels else []
    won: list[Integers] = []
    for start in range(0, len(channels), pool):
        neuron = values[start : start + pool]
        top = [max(column) for column in zip(*neuron)]
        if top in neuron:
            won.append(channels[start + neuron.index(top)])
            continue
        for smaller, j in _by_winner(part, channels[start : start + pool], neuron):
            for smallest, others in _by_neurons(smaller, channels[start + pool :], pool):
                yield smallest, [*won, channels[start + j], *others]
        return
    yield part, won


def _by_winner(
    part: ExactPolytope, channels: Sequence[Integers], values: Sequence[list[Any]]
) -> Iterator[tuple[ExactPolytope, int]]:
    """Split a polytope into parts on which one of the channels of a neuron is largest: pairs (part, channel).

    `values` are those of the channels at the vertices. Parts of lower dimension than the polytope are left out: Phi is
    continuous, and their neighbours contain them. Of channels that are equal on the polytope the first has the part.
    """
    for j, own in enumerate(channels):
        if values[j] in values[:j]:
            continue
        winning = part
        for other, value in zip(channels, values):
            if winning.dimension == part.dimension and any(a > b for a, b in zip(value, values[j])):
                winning = winning.clip(tuple(a - b for a, b in zip(other, own)))
        if winning.dimension == part.dimension:
            yield winning, j


# -- homogeneous maps ---------------------------------------------------------------------------------


def _homogeneous(matrix: Any) -> Map:
    """The fmpq_mat (M, c) as a Map."""
    numerators, denominator = matrix.numer_denom()
    last = [0] * (matrix.ncols() - 1) + [denominator]
    return flint().fmpz_mat([*numerators.tolist(), last])


@lru_cache(maxsize=1024)
def _dynamics(mode: Mode) -> Map:
    """(x, u) -> A x + B u + p."""
    return _homogeneous(flint().fmpq_mat(dynamics(mode)))


def _with_input(output: Map) -> Map:
    """x -> (x, u), from x -> u."""
    *rows, last = output.tolist()
    n = len(last) - 1
    return flint().fmpz_mat([*([last[-1] if i == j else 0 for j in range(n + 1)] for i in range(n)), *rows, last])


def highest(part: ExactPolytope, forward: Map, v: Sequence[Rational]) -> tuple[Rational, Point]:
    """max v y over the images y of a polytope that is not empty, and the vertex that has it."""
    row, denominator = flint().fmpq_mat(1, len(v) + 1, [*v, 0]).numer_denom()
    values = (row * forward * part.columns).entries()
    heights = [flint().fmpq(value, x[-1]) for value, x in zip(values, part.points)]
    k = max(range(len(heights)), key=heights.__getitem__)
    return heights[k] / (denominator * forward[len(v), forward.ncols() - 1]), part.vertices[k]


def _points(columns: Any) -> list[Point]:
    """The points whose homogeneous integers are the columns of an fmpz_mat."""
    fmpq = flint().fmpq
    return [tuple(fmpq(entry, x[-1]) for entry in x[:-1]) for x in columns.transpose().tolist()]
