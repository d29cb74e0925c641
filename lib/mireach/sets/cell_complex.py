"""Many convex polytopes of R^n at once, each represented by its vertices and the rows that are tight at each vertex."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..errors import CellLimitError
from ..typing import Array, IntArray
from . import cell_kernels as kernels
from .polytope import Polytope
from .templates import box_directions

ROOM = 512  # vertices per cell that a kernel starts with room for
MOST_STATES = 12  # since a box has 2^n vertices
UNLIMITED = 2**62


@dataclass(frozen=True, eq=False)
class CellComplex:
    """N convex polytopes, the cells; lower-dimensional ones are legitimate.

    A cell is the set of its rows, and its vertices are computed in floats: the set is exact, its vertices have
    rounding errors, and bounds are proven from the rows (weak duality).

    Attributes
    ----------
    points : array (T, n)
        The vertices of all cells, one cell after the other.
    masks : array (T, w) of int
        Bit r of a mask, 62 bits per integer, says that row r of the cell is tight at the vertex.
    rows : array (S, n + 1)
        The rows (a, b) of all cells, a x <= b. Those whose bit no vertex has are superfluous.
    boxes : array (N, 2 n)
        Lower and upper limits, proven, of the coordinates.
    counts : array (N, 2) of int
        Vertices and rows of each cell.
    extent : array (n,)
        No coordinate of any cell exceeds it in size.

    Examples
    --------
    The half-space x1 + x2 + x3 <= 1/2 cuts a corner off the unit cube:

    >>> cube = CellComplex.of([Polytope.box([0, 0, 0], [1, 1, 1])])
    >>> part, owner = cube.clip(np.array([[1.0, 1, 1, 0.5]]))
    >>> sorted(part.vertices(0).tolist()), owner.tolist()
    ([[0.0, 0.0, 0.0], [0.0, 0.0, 0.5], [0.0, 0.5, 0.0], [0.5, 0.0, 0.0]], [0])
    """

    points: Array
    masks: IntArray
    rows: Array
    boxes: Array
    counts: IntArray
    extent: Array

    @staticmethod
    def of(polytopes: Sequence[Polytope]) -> CellComplex:
        """The complex of bounded Polytopes, none of them empty.

        Raises
        ------
        CellLimitError
            If n is above `MOST_STATES`.
        """
        n = polytopes[0].dimension
        if n > MOST_STATES:
            raise CellLimitError(f'a box in R^{n} alone has 2^{n} vertices, too many for cells; use engine="milp"')
        limits = np.array([P.bound(box_directions(n)) for P in polytopes]).reshape(-1, 2, n)
        high, low = limits[:, 0], 0.0 - limits[:, 1]
        corners = [_corners(*ends) for ends in zip(low, high)]
        rows = np.concatenate(
            [np.broadcast_to(box_directions(n), (len(polytopes), 2 * n, n)), np.hstack([high, -low])[..., None]], axis=2
        )
        boxes = CellComplex(
            np.concatenate([points for points, _ in corners]),
            np.concatenate([masks for _, masks in corners])[:, None],
            rows.reshape(-1, n + 1),
            np.hstack([low, high]),
            np.array([[len(points), 2 * n] for points, _ in corners]),
            np.abs(limits).max(axis=(0, 1)),
        )
        ends = np.cumsum([0, *(len(P.h) for P in polytopes)])
        every = np.vstack([np.column_stack([P.H, P.h]) for P in polytopes])
        return boxes.clip(every, ends[:-1], ends[1:])[0]

    def __len__(self) -> int:
        return len(self.counts)

    @property
    def dimension(self) -> int:
        """n."""
        return self.points.shape[1]

    @cached_property
    def starts(self) -> IntArray:
        """First vertex and first row of each cell, and their numbers at the end: array (N + 1, 2) of int."""
        return np.concatenate([np.zeros((1, 2), int), np.cumsum(self.counts, axis=0)])

    def vertices(self, i: int) -> Array:
        """Vertices (v, n) of cell i."""
        return self.points[self.starts[i, 0] : self.starts[i + 1, 0]]

    def polytope(self, i: int) -> Polytope:
        """Cell i as a Polytope: its rows that touch it, and those of its box."""
        masks, rows = (
            self.masks[self.starts[i, 0] : self.starts[i + 1, 0]],
            self.rows[self.starts[i, 1] : self.starts[i + 1, 1]],
        )
        used = np.bitwise_or.reduce(masks, axis=0)[:, None] >> np.arange(kernels.WORD) & 1
        rows, n = rows[used.ravel()[: len(rows)] != 0], self.dimension
        low, high = self.boxes[i, :n], self.boxes[i, n:]
        return Polytope(np.vstack([rows[:, :n], box_directions(n)]), np.concatenate([rows[:, n], high, -low]))

    def take(self, chosen: IntArray) -> CellComplex:
        """The cells with the given indices, in that order."""
        points, rows = (
            np.concatenate([np.arange(a, b) for a, b in zip(self.starts[chosen, k], self.starts[chosen + 1, k])])
            if len(chosen)
            else np.zeros(0, int)
            for k in (0, 1)
        )
        return replace(
            self,
            points=self.points[points],
            masks=self.masks[points],
            rows=self.rows[rows],
            boxes=self.boxes[chosen],
            counts=self.counts[chosen],
        )

    def clip(
        self, rows: Array, first: IntArray | None = None, last: IntArray | None = None
    ) -> tuple[CellComplex, IntArray]:
        """The parts of the cells in half-spaces.

        Parameters
        ----------
        rows : array (l, n + 1)
            Half-spaces (a, b), a x <= b.
        first, last : array (N,) of int or None
            Cell i is cut by rows[first[i] : last[i]]; None is by all of them.

        Returns
        -------
        CellComplex
            The parts that are not proven to be empty.
        array of int
            The cell that each of them comes from.
        """
        if first is None or last is None:
            first, last = np.zeros(len(self), int), np.full(len(self), len(rows))
        found = self._run(lambda storage: kernels.clipped(self.arrays, rows, first, last, self.extent, storage))
        return self._of(found[0]), found[0][5][:, 0]

    def affine_pieces(self, network: tuple[Any, ...], limit: int) -> tuple[CellComplex, IntArray, Array, Array, Array]:
        """The pieces of the cells on which a maxout network is affine.

        Parameters
        ----------
        network : tuple
            The fields of `kernels.Layers`.
        limit : int
            The largest number of pieces.

        Returns
        -------
        CellComplex
            N pieces, which cover the cells.
        owner : array (N,) of int
            The cell that each piece lies in.
        K, g, error : arrays (N, m, n), (N, m) and (N, m)
            |K x + g - Phi(x)| <= error on the piece.

        Raises
        ------
        CellLimitError
            If there are more pieces.
        """
        found, forms = self._run(
            lambda storage: kernels.affine_pieces(self.arrays, network, self.extent, storage), limit
        )
        values = forms.reshape(len(forms), -1, self.dimension + 2)
        K, g, error = np.split(values, [self.dimension, self.dimension + 1], axis=2)
        return self._of(found), found[5][:, 0], K.copy(), g[..., 0].copy(), error[..., 0].copy()

    def heights(self, maps: tuple[Any, ...]) -> tuple[Array, Array]:
        """max v (M x + c) + h of D over each cell, and its upper bound: two arrays (N, k).

        `maps` are the fields of `kernels.Maps`.
        """
        storage = (int(self.counts[:, 0].max(initial=1)), self.masks.shape[1], UNLIMITED)
        heights, tops = kernels.whole(self.arrays, maps, self.extent, storage)
        return heights, tops

    def highest(
        self, maps: tuple[Any, ...], rows: Array, chosen: IntArray, gap: float
    ) -> tuple[Array, Array, IntArray, IntArray, IntArray]:
        """The same over the parts of all cells in half-spaces: what `kernels.highest` returns after its status."""
        value, top, owner, left, doubtful = self._run(
            lambda storage: kernels.highest(self.arrays, maps, rows, chosen, gap, self.extent, storage)
        )
        return value, top, owner, left, doubtful

    @cached_property
    def arrays(self) -> tuple[Any, ...]:
        """The fields of `kernels.Pool`."""
        info, doubt = np.zeros((len(self), 3), int), np.zeros((len(self), 1))
        return self.points, self.masks, self.rows, self.boxes, self.counts, info, doubt

    def _of(self, arrays: tuple[Any, ...]) -> CellComplex:
        points, masks, rows, boxes, counts = arrays[:5]
        return CellComplex(points, masks, rows, boxes, counts, self.extent)

    def _run(self, kernel: Callable[[tuple[int, int, int]], tuple[Any, ...]], limit: int = UNLIMITED) -> Any:
        """What a kernel returns after its status, with as much room per cell as it needs."""
        room = max(ROOM, 2 * int(self.counts[:, 0].max(initial=1)))
        words = self.masks.shape[1]
        while True:
            status, *found = kernel((room, words, limit))
            if status == kernels.NO_ROOM:
                room *= 4
            elif status == kernels.NO_WORDS:
                words *= 2
            elif status == kernels.TOO_MANY:
                raise CellLimitError(
                    f"the map falls into more than {limit} cells; the search for them stopped there. "
                    'Use engine="milp", or an engine with a larger limit, such as Cells(limit=...)'
                )
            else:
                return found


def _corners(low: Array, high: Array) -> tuple[Array, IntArray]:
    """The corners (v, n) of a box, and masks (v,) of its rows `box_directions(n)`: where it is flat both are tight."""
    n = len(low)
    free = np.flatnonzero(low < high)
    upper = np.zeros((2 ** len(free), n), bool)
    upper[:, free] = (np.arange(len(upper))[:, None] >> np.arange(len(free))) & 1
    flat = low == high
    bits = np.where(upper | flat, 1, 0) + np.where(~upper | flat, 2**n, 0)
    return np.where(upper, high, low), (bits << np.arange(n)).sum(axis=1)
