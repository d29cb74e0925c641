"""Facets over the rationals: of hulls of points and of linear images, in any dimension.

Flat and unbounded sets are included. Qhull proposes the facets of a hull in floating point, in coordinates in which the
hull is neither flat nor thin. Each normal is then computed over the rationals from the corners of its facet.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import factorial
from typing import Any, TypeAlias

import numpy as np
from scipy.spatial import ConvexHull

from ..arithmetic.balls import flint
from ..arithmetic.rational import binary, dot, maximize, nearest
from ..tolerances import ALIGNED_NORMALS
from ..typing import Array

Vector: TypeAlias = tuple[Any, ...]  # of fmpq


class Frame:
    """Coordinates y of the affine hull of points: x = p + B'y, in which the hull has an interior and a size of about 1.

    Parameters
    ----------
    points : sequence of k tuples (n,) of fmpq
        At least one.

    Attributes
    ----------
    rank : int
        Dimension r of the affine hull.
    y : list of k tuples (r,) of fmpq
        The points in these coordinates.

    Notes
    -----
    The rows of B are differences of points, chosen by Gaussian elimination with complete pivoting over the rationals.
    The rank is exact.
    """

    def __init__(self, points: Sequence[Vector]) -> None:
        matrix = flint().fmpq_mat
        first = points[0]
        self.dimension = len(first)
        offsets = [[a - b for a, b in zip(point, first)] for point in points]
        chosen, self.axes = _pivots(offsets)
        self.rank = len(chosen)
        self.free = [j for j in range(self.dimension) if j not in self.axes]
        self.basis = [offsets[i] for i in chosen]
        if not self.rank:
            self.y: list[Vector] = [() for _ in points]
            return
        r = self.rank
        self.square = matrix(r, r, [row[j] for row in self.basis for j in self.axes])
        self.inverse = self.square.inv()
        y = (matrix(len(points), r, [row[j] for row in offsets for j in self.axes]) * self.inverse).entries()
        self.y = [tuple(y[k * r : (k + 1) * r]) for k in range(len(points))]

    def normals(self) -> list[Vector]:
        """Outward normals of the hull: list of tuples (n,) of fmpq, those of its affine hull in both signs."""
        zero, one = flint().fmpq(0), flint().fmpq(1)
        found = []
        for j in self.free:  # B v = 0 with v_j = 1
            v = [zero] * self.dimension
            v[j] = one
            if self.rank:
                c = self.inverse * flint().fmpq_mat(self.rank, 1, [row[j] for row in self.basis])
                for axis, entry in zip(self.axes, c.entries()):
                    v[axis] = -entry
            found += [tuple(v), tuple(-entry for entry in v)]
        for w in self._local_normals():  # B v = w
            v = [zero] * self.dimension
            for axis, entry in zip(self.axes, (self.inverse * flint().fmpq_mat(self.rank, 1, list(w))).entries()):
                v[axis] = entry
            found.append(tuple(v))
        return found

    def volume(self) -> Any:
        """The n-dimensional volume of the hull as an fmpq, 0 if it is flat.

        Notes
        -----
        The sum of the simplices that a middle point spans with the facets of qhull, over the rationals.
        """
        if self.rank < self.dimension:
            return flint().fmpq(0)
        if self.rank == 1:
            return (max(self.y)[0] - min(self.y)[0]) * abs(self.square.det())
        r, facets = self.rank, ConvexHull(self._floats()).simplices.tolist()
        middle = [sum(column, flint().fmpq(0)) / len(self.y) for column in zip(*self.y)]
        total = flint().fmpq(0)
        for corners in facets:
            edges = [a - b for k in corners for a, b in zip(self.y[k], middle)]
            total += abs(flint().fmpq_mat(r, r, edges).det())
        return total * abs(self.square.det()) / factorial(r)

    def _floats(self) -> Array:
        """The points as floats: array (k, r)."""
        return np.array([[nearest(entry) for entry in row] for row in self.y])

    def _local_normals(self) -> list[Vector]:
        """Outward normals of the hull in the coordinates y: list of tuples (r,) of fmpq."""
        one = flint().fmpq(1)
        if self.rank < 2:
            return [(one,), (-one,)][: 2 * self.rank]
        found = ConvexHull(self._floats())
        return [*{self._exact_normal(*facet): None for facet in zip(found.simplices.tolist(), found.equations)}]

    def _exact_normal(self, corners: list[int], equation: Array) -> Vector:
        """The normal of the plane through `corners`, scaled to a largest entry of 1; qhull's if they span no plane."""
        r, first = self.rank, self.y[corners[0]]
        edges = [a - b for k in corners[1:] for a, b in zip(self.y[k], first)]
        reduced, spanned = flint().fmpq_mat(r - 1, r, edges).rref()
        near = binary(equation[:-1])
        if spanned < r - 1:
            return near
        rows = [[reduced[i, j] for j in range(r)] for i in range(spanned)]
        pivots = [next(j for j in range(r) if row[j]) for row in rows]
        (free,) = set(range(r)) - set(pivots)
        w = [flint().fmpq(0)] * r
        w[free] = flint().fmpq(1)
        for j, row in zip(pivots, rows):
            w[j] = -row[free]
        top = max(abs(entry) for entry in w)
        w = tuple(entry / (top if dot(w, near) > 0 else -top) for entry in w)
        unit = np.array([nearest(entry) for entry in w])
        close = np.abs(unit / np.linalg.norm(unit) - equation[:-1]).max() < ALIGNED_NORMALS
        return w if close else near


def rank(rows: Sequence[Vector]) -> int:
    """The rank of a matrix given by its rows of fmpq."""
    return flint().fmpq_mat(len(rows), len(rows[0]), [entry for row in rows for entry in row]).rank()


def image(H: Sequence[Vector], h: Sequence[Any], M: Sequence[Vector]) -> list[tuple[Vector, Any]]:
    """Rows v and offsets b of {M x : H x <= h} = {y : v y <= b}: list of pairs (v, b).

    Parameters
    ----------
    H : sequence of l tuples (n,) of fmpq
    h : sequence of l fmpq
        Such that H x <= h for some x.
    M : sequence of m tuples (n,) of fmpq

    Returns
    -------
    list of (tuple (m,) of fmpq, fmpq)

    Notes
    -----
    Independent rows of M and some coordinates of x are taken as new coordinates. Fourier-Motzkin elimination removes
    the latter. The rows of M that depend on the others give equations.
    """
    matrix = flint().fmpq_mat
    zero, one = flint().fmpq(0), flint().fmpq(1)
    m, n = len(M), len(M[0])
    chosen, pivots = _pivots(M)
    r = len(chosen)
    units = [[one if i == j else zero for i in range(n)] for j in range(n) if j not in pivots]
    inverse = matrix(n, n, [entry for row in [*(M[i] for i in chosen), *units] for entry in row]).inv()
    entries = (matrix(len(H), n, [entry for row in H for entry in row]) * inverse).entries()
    rows = [(tuple(entries[k * n : (k + 1) * n]), b) for k, b in enumerate(h)]
    for _ in units:
        rows = _without_last(rows)
    found = []
    for v, b in rows:
        lifted = [zero] * m
        for i, entry in zip(chosen, v):
            lifted[i] = entry
        found.append((tuple(lifted), b))
    for k in range(m):  # y_k = c y_chosen
        if k not in chosen:
            c = (matrix(1, n, list(M[k])) * inverse).entries()[:r]
            equation = [zero] * m
            equation[k] = one
            for i, entry in zip(chosen, c):
                equation[i] = -entry
            found += [(tuple(equation), zero), (tuple(-entry for entry in equation), zero)]
    return found


def scaled(v: Vector) -> Array:
    """A row of fmpq, divided by its largest entry and rounded to the nearest floats: array (n,)."""
    top = max(abs(entry) for entry in v)
    return np.array([nearest(entry / top) for entry in v])


def _pivots(rows: Sequence[Sequence[Any]]) -> tuple[list[int], list[int]]:
    """Independent rows and as many columns, by complete pivoting relative to the size of each column: two lists."""
    sizes = [max(abs(row[j]) for row in rows) for j in range(len(rows[0]))]
    rest = [[entry / size if size else entry for entry, size in zip(row, sizes)] for row in rows]
    chosen: list[int] = []
    columns: list[int] = []
    while len(columns) < len(sizes):
        top, i = max((max(map(abs, row)), i) for i, row in enumerate(rest))
        if not top:
            break
        j = next(j for j, entry in enumerate(rest[i]) if abs(entry) == top)
        chosen.append(i)
        columns.append(j)
        pivot = [entry / rest[i][j] for entry in rest[i]]
        rest = [[e - row[j] * p for e, p in zip(row, pivot)] if row[j] else row for row in rest]
    return chosen, columns


def _without_last(rows: list[tuple[Vector, Any]]) -> list[tuple[Vector, Any]]:
    """Fourier-Motzkin elimination of the last coordinate from rows (v, b), without what the others imply."""
    least: dict[Vector, Any] = {}
    plus, minus = ([row for row in rows if row[0][-1] * sign > 0] for sign in (1, -1))
    sums = [
        (tuple(x / a[-1] - y / c[-1] for x, y in zip(a[:-1], c[:-1])), b / a[-1] - d / c[-1])
        for a, b in plus
        for c, d in minus
    ]
    for v, b in [(v[:-1], b) for v, b in rows if not v[-1]] + sums:
        if any(v):
            top = max(abs(entry) for entry in v)
            v, b = tuple(entry / top for entry in v), b / top
            least[v] = min(b, least.get(v, b))
    kept = [*least.items()]
    for row in least.items():
        others = [other for other in kept if other != row]
        if others:
            highest: Any = maximize([v for v, _ in others], [b for _, b in others], row[0]).value
            if not isinstance(highest, float) and highest <= row[1]:
                kept = others
    return kept
