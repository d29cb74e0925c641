"""Bounded convex polytopes of R^n without rounding, by their vertices and the rows that are tight at each of them.

This is the double description of Motzkin et al. Coordinates are homogeneous integers: a point x is (w x, w) with w > 0,
a row a x <= b is (a, -b), and their product is w (a x - b). A product of integer matrices takes a fraction of the
time of the same sums of fractions, which are reduced after every operation.
"""

import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from operator import or_
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from ..arithmetic.balls import flint
from ..arithmetic.rational import maximize, nearest
from ..typing import Array, Rational

if TYPE_CHECKING:
    from .convex_set import ConvexSet

Integers: TypeAlias = tuple[Any, ...]  # several fmpz of python-flint, which has no types


@dataclass(frozen=True, eq=False)
class ExactPolytope:
    """A bounded convex polytope {x in R^n : a x <= b for all rows}; points, segments and the empty set are some, too.

    Attributes
    ----------
    points : tuple of tuple of n + 1 fmpz
        The vertices, as (w x, w) with w > 0 and without a common factor.
    tight : tuple of int
        For every vertex a mask: bit i is set if row i is tight there.
    rows : tuple of tuple of n + 1 fmpz
        (a, -b). Together they describe the polytope; some may be redundant.
    dimension : int
        That of the affine hull; -1 if the polytope is empty.
    """

    points: tuple[Integers, ...]
    tight: tuple[int, ...]
    rows: tuple[Integers, ...]
    dimension: int

    @classmethod
    def of(cls, P: "ConvexSet", most: int | None = None) -> "ExactPolytope":
        """A bounded ConvexSet, every number the float that it is.

        Parameters
        ----------
        P : ConvexSet
        most : int or None
            The largest number of vertices, also of the sets on the way; None is any number.

        Raises
        ------
        ValueError
            If P is unbounded, or there are more vertices.

        Examples
        --------
        >>> from mireach import Polytope
        >>> triangle = ExactPolytope.of(Polytope([[-1, 0], [0, -1], [1, 1]], [0, 0, 1]))
        >>> sorted(triangle.vertices), triangle.dimension
        ([(0, 0), (0, 1), (1, 0)], 2)
        """
        H, h = P.exact
        one, zero = flint().fmpq(1), flint().fmpq(0)
        ends = []
        for i in range(P.dimension):
            axis = [one if i == j else zero for j in range(P.dimension)]
            high, low = (maximize(H, h, [sign * entry for entry in axis]).value for sign in (one, -one))
            if -np.inf in (high, low):
                return cls((), (), (), -1)
            if np.inf in (high, low):
                raise ValueError("the polytope is unbounded")
            ends.append((-low, high))
        most = sys.maxsize if most is None else most
        if 2 ** sum(low < high for low, high in ends) > most:
            raise ValueError(_too_many(P, most))
        part = cls.box(ends)
        for a, b in zip(H, h):
            part = part.clip(integers((*a, -b)))
            if len(part.points) > most:
                raise ValueError(_too_many(P, most))
        return part

    @classmethod
    def box(cls, ends: Sequence[tuple[Rational, Rational]]) -> "ExactPolytope":
        """The box between ends (low_i, high_i) with low_i <= high_i; in the plane counter-clockwise."""
        rows: list[Integers] = []
        corners: list[tuple[tuple[Rational, ...], int]] = [((), 0)]
        for i, (low, high) in enumerate(ends):
            axis = [int(i == j) for j in range(len(ends))]
            rows += [integers((*[-entry for entry in axis], low)), integers((*axis, -high))]
            choices = [(low, 1 << 2 * i), (high, 2 << 2 * i)] if low < high else [(low, 3 << 2 * i)]
            corners = [
                ((*x, end), mask | bit)
                for (end, bit), others in zip(choices, (corners, corners[::-1]))
                for x, mask in others
            ]
        points, tight = zip(*((integers((*x, 1)), mask) for x, mask in corners))
        return cls(points, tight, tuple(rows), sum(low < high for low, high in ends))

    @property
    def is_empty(self) -> bool:
        """Whether there is no point."""
        return not self.points

    @cached_property
    def vertices(self) -> list[tuple[Rational, ...]]:
        """The vertices: list of tuple of n fmpq."""
        fmpq = flint().fmpq
        return [tuple(fmpq(entry, x[-1]) for entry in x[:-1]) for x in self.points]

    @cached_property
    def floats(self) -> Array:
        """The vertices, each number rounded to the nearest float: array (v, n)."""
        return np.array([[nearest(entry) for entry in x] for x in self.vertices])

    @cached_property
    def half_spaces(self) -> list[tuple[tuple[Rational, ...], Rational]]:
        """The rows (a, b) in fmpq that are tight at some vertex; the others are redundant."""
        fmpq, used = flint().fmpq, reduce(or_, self.tight, 0)
        chosen = [row for i, row in enumerate(self.rows) if used >> i & 1]
        return [(tuple(fmpq(entry) for entry in row[:-1]), fmpq(-row[-1])) for row in chosen]

    @cached_property
    def columns(self) -> Any:
        """The points as the columns of an fmpz_mat."""
        return flint().fmpz_mat(self.points).transpose()

    def values(self, rows: Sequence[Integers]) -> list[list[Any]]:
        """w (a x - b) for rows (a, -b), at every vertex (w x, w) of a polytope that is not empty: list per row."""
        found: list[list[Any]] = (flint().fmpz_mat(rows) * self.columns).tolist()
        return found

    def clip(self, row: Integers) -> "ExactPolytope":
        """The part with a x <= b, for a row (a, -b).

        Notes
        -----
        Vertices of the part are the vertices with a x <= b, and one point on each edge that crosses a x = b. Two
        vertices share an edge iff no third vertex lies on all rows on which both lie: those rows describe the smallest
        face that contains both. On an edge at least n - 1 rows are tight, which is a quick test. Rows that are tight
        inside an edge are tight on all of it.

        A row that cuts nothing off is redundant and needs no bit. A part with a vertex in a x < b has the
        dimension of the whole; any other part is a face.

        Examples
        --------
        >>> square = ExactPolytope.box([(0, 1), (0, 1)])
        >>> sorted(square.clip(integers([2, 2, -1])).vertices)  # 2 x1 + 2 x2 <= 1
        [(0, 0), (0, 1/2), (1/2, 0)]
        """
        if not self.points:
            return self
        (values,) = self.values([row])
        beyond = [j for j, value in enumerate(values) if value > 0]
        if not beyond:
            return self
        bit = 1 << len(self.rows)
        points = []
        tight = []
        inside = []
        for i, value in enumerate(values):
            if value <= 0:
                points.append(self.points[i])
                tight.append(self.tight[i] if value < 0 else self.tight[i] | bit)
                if value < 0:
                    inside.append(i)
        for i in inside:
            for j in beyond:
                if self.share_edge(i, j):
                    points.append(_between(self.points[i], self.points[j], values[i], values[j]))
                    tight.append(self.tight[i] & self.tight[j] | bit)
        return ExactPolytope(
            tuple(points), tuple(tight), (*self.rows, row), self.dimension if inside else dimension(points)
        )

    def clip_all(self, rows: Iterable[Integers]) -> "ExactPolytope":
        """The part in all half-spaces (a, -b)."""
        part = self
        for row in rows:
            part = part.clip(row)
        return part

    def share_edge(self, i: int, j: int) -> bool:
        """Whether no third vertex lies on all rows on which two vertices lie, at least n - 1 of them."""
        common, found = self.tight[i] & self.tight[j], 0
        if common.bit_count() < len(self.points[i]) - 2:
            return False
        for mask in self.tight:
            if mask & common == common:
                found += 1
                if found > 2:
                    return False
        return True


def _too_many(P: "ConvexSet", most: int) -> str:
    return (
        f"{len(P.h)} rows in R^{P.dimension} are too many to enumerate vertices: there are more than {most} of them; "
        "use support()"
    )


def integers(vector: Sequence[Rational]) -> Integers:
    """The vector of fmpq times the smallest positive number that makes all entries integers without common factor."""
    numerators, _ = flint().fmpq_mat(1, len(vector), list(vector)).numer_denom()
    return _reduced(numerators.entries())


def dimension(points: Sequence[Integers]) -> int:
    """The dimension of the affine hull of points (w x, w); -1 if there are none."""
    return int(flint().fmpz_mat(points).rank()) - 1 if points else -1


def _between(x: Integers, y: Integers, below: Any, above: Any) -> Integers:
    """The point between x and y in which a row is tight that is negative at x and positive at y."""
    return _reduced([above * p - below * q for p, q in zip(x, y)])


def _reduced(vector: Sequence[Any]) -> Integers:
    """Integers without their common factor."""
    factor = vector[-1]
    for entry in vector:
        if factor == 1:
            return tuple(vector)
        factor = factor.gcd(entry)
    return tuple(entry // factor for entry in vector) if factor > 1 else tuple(vector)
