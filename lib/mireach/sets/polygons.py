"""Many convex polygons at once, cut by half-planes in array operations."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..typing import Array, IntArray


@dataclass(frozen=True, eq=False)
class Polygons:
    """N convex polygons of the plane; segments and single points are legitimate ones.

    Attributes
    ----------
    points : array (T, 2)
        The vertices of all polygons, one polygon after the other, each counter-clockwise around it.
    starts : array (N + 1,) of int
        Polygon i has the vertices points[starts[i] : starts[i + 1]], at least one.

    Examples
    --------
    The half-plane x1 <= 1 cuts a square in two and leaves nothing of the other polygon, a point:

    >>> found = Polygons.of([np.array([[0.0, 0], [2, 0], [2, 2], [0, 2]]), np.array([[3.0, 3]])])
    >>> cut, owner = found.clip(np.array([[1.0, 0], [1, 0]]), np.array([1.0, 1]), 0.0)
    >>> cut[0].tolist(), owner.tolist()
    ([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0], [0.0, 2.0]], [0])
    """

    points: Array
    starts: IntArray

    @staticmethod
    def of(lists: Sequence[Array]) -> "Polygons":
        """Polygons with the given vertices: sequence of arrays (v, 2), none of them empty."""
        sizes = [len(points) for points in lists]
        return Polygons(np.concatenate([np.zeros((0, 2)), *lists]), np.concatenate([[0], np.cumsum(sizes, dtype=int)]))

    def __len__(self) -> int:
        return len(self.starts) - 1

    def __getitem__(self, i: int) -> Array:
        """Vertices (v, 2) of polygon i."""
        return self.points[self.starts[i] : self.starts[i + 1]]

    @cached_property
    def owner(self) -> IntArray:
        """(T,) index of the polygon that each vertex belongs to."""
        return np.repeat(np.arange(len(self)), np.diff(self.starts))

    @cached_property
    def onward(self) -> IntArray:
        """(T,) index of the vertex that follows each vertex around its polygon."""
        following = np.arange(1, len(self.points) + 1)
        following[self.starts[1:] - 1] = self.starts[:-1]
        return following

    @cached_property
    def discs(self) -> tuple[Array, Array]:
        """For each polygon a disc that holds it: centres (N, 2) and radii (N,), rounded up."""
        centres = (self.least(self.points) + self.largest(self.points)) / 2
        reach = np.linalg.norm(self.points - centres[self.owner], axis=1)
        return centres, self.largest(reach) * (1 + 1e-12)

    def least(self, values: Array) -> Array:
        """Smallest of `values` (T, ...) over the vertices of each polygon: (N, ...)."""
        return np.minimum.reduceat(values, self.starts[:-1], axis=0) if len(self) else values[:0]

    def largest(self, values: Array) -> Array:
        """Largest of `values` (T, ...) over the vertices of each polygon: (N, ...)."""
        return np.maximum.reduceat(values, self.starts[:-1], axis=0) if len(self) else values[:0]

    def take(self, chosen: IntArray) -> "Polygons":
        """The polygons with the given indices, in that order."""
        sizes = np.diff(self.starts)[chosen]
        starts = np.concatenate([[0], np.cumsum(sizes)])
        rows = np.arange(starts[-1]) + np.repeat(self.starts[:-1][chosen] - starts[:-1], sizes)
        return Polygons(self.points[rows], starts)

    @staticmethod
    def join(batches: "Sequence[Polygons]") -> "Polygons":
        """All polygons of several batches, one batch after the other."""
        ends = np.cumsum([0] + [len(batch.points) for batch in batches])
        starts = [batch.starts[:-1] + end for batch, end in zip(batches, ends)]
        return Polygons(np.concatenate([batch.points for batch in batches]), np.concatenate([*starts, ends[-1:]]))

    def clip(self, a: Array, b: Array, tol: float) -> "tuple[Polygons, IntArray]":
        """The part of each polygon in its half-plane a x <= b.

        Parameters
        ----------
        a : array (N, 2)
        b : array (N,)
        tol : float
            A vertex with a x <= b + tol stays where it is, so that a polygon that only touches the
            half-plane keeps the point or edge in which it does. In units of b.

        Returns
        -------
        Polygons
            Those of which something is left.
        array of int
            Which polygons they come from.
        """
        excess = np.einsum("ij,ij->i", self.points, a[self.owner]) - b[self.owner]
        inside = excess <= tol
        if inside.all():
            return self, np.arange(len(self))
        crossing = np.flatnonzero(inside != inside[self.onward])
        onward = self.onward[crossing]
        share = np.clip(excess[crossing] / (excess[crossing] - excess[onward]), 0, 1)
        cuts = self.points[crossing] + share[:, None] * (self.points[onward] - self.points[crossing])
        counts = inside.astype(int)
        counts[crossing] += 1
        first = np.cumsum(counts) - counts
        points = np.empty((counts.sum(), 2))
        points[first[inside]] = self.points[inside]
        points[first[crossing] + inside[crossing]] = cuts
        sizes = np.add.reduceat(counts, self.starts[:-1])
        kept = np.flatnonzero(sizes)
        return Polygons(points, np.concatenate([[0], np.cumsum(sizes[kept])])), kept
