"""Rational arithmetic: floats as the fractions that they are, roundings of known direction, and linear programs.

One reading of numbers holds for the whole package: **a number is the IEEE float that it is**. The float 0.1 is
0x1999999999999a / 2^56, which lies a little above one tenth. Scaling by powers of two is exact, so a
verdict does not depend on units. Rationals are python-flint's `fmpq`.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import inf, nextafter
from typing import Any, TypeAlias

import numpy as np

from .balls import flint

Rational: TypeAlias = Any  # an fmpq of python-flint, which has no types
Vector: TypeAlias = Sequence[Rational]


@dataclass(frozen=True)
class ExactOptimum:
    """Answer to a linear program over the rationals.

    Attributes
    ----------
    value : fmpq or float
        -inf if no point satisfies the constraints, inf if the objective is unbounded.
    point : tuple of fmpq or None
        Where `value` is attained; None if `value` is not finite.
    """

    value: Rational
    point: tuple[Rational, ...] | None


# -- numbers ------------------------------------------------------------------------------------------


def binary(value: Any) -> Any:
    """A float as the binary fraction that it is; lists and arrays are taken entry by entry, as tuples.

    Examples
    --------
    >>> binary(0.75), binary([0.5, 2])
    (3/4, (1/2, 2))
    """
    if isinstance(value, (list, tuple, np.ndarray)):
        return tuple(binary(entry) for entry in value)
    return flint().fmpq(*float(value).as_integer_ratio())


def rational(value: Any) -> Any:
    """A Fraction (or int) as an fmpq; lists are taken entry by entry, as tuples."""
    if isinstance(value, (list, tuple)):
        return tuple(rational(entry) for entry in value)
    value = Fraction(value)
    return flint().fmpq(value.numerator, value.denominator)


def fractions(vector: Iterable[Rational]) -> tuple[Fraction, ...]:
    """Several fmpq as a tuple of Fractions of the standard library."""
    return tuple(Fraction(int(value.p), int(value.q)) for value in vector)


def nearest(value: Rational) -> float:
    """The float nearest to an fmpq; infinite beyond the largest one."""
    try:
        return int(value.p) / int(value.q)
    except OverflowError:
        return inf if value > 0 else -inf


def above(value: Rational) -> float:
    """The smallest float that is not below an fmpq.

    Examples
    --------
    >>> third = rational(1) / 3
    >>> binary(below(third)) < third < binary(above(third))
    True
    """
    near = nearest(value)
    if near == inf or (near > -inf and binary(near) >= value):
        return near
    return nextafter(near, inf)


def below(value: Rational) -> float:
    """The largest float that is not above an fmpq."""
    return -above(-value)


def dot(a: Vector, b: Vector) -> Rational:
    """The sum of products of two vectors that are not empty."""
    total = a[0] * b[0]
    for left, right in zip(a[1:], b[1:]):
        total += left * right
    return total


# -- linear programs ----------------------------------------------------------------------------------


def maximize(H: Sequence[Vector], h: Vector, c: Vector, tight: Iterable[int] = ()) -> ExactOptimum:
    """max c x over {x in R^n : H x <= h}, without rounding.

    Parameters
    ----------
    H : sequence of l vectors (n,) of fmpq
    h : sequence of l fmpq
    c : vector (n,) of fmpq
    tight : sequence of int
        Rows that may be tight at the maximum, such as those that a float solver found. It changes the time alone.

    Returns
    -------
    ExactOptimum

    Notes
    -----
    Two-phase simplex method on the dual program, min h y over H'y = c, y >= 0: n equations however many rows there
    are, and its multipliers are the point x. Where a pivot does not change the costs, Bland's rule chooses the next
    one, so that it ends for every input. It is meant for small n.

    Examples
    --------
    >>> best = maximize(binary([[1, 0], [0, 1], [1, 1]]), binary([2, 2, 3]), binary([1, 2]))
    >>> best.value, best.point
    (5, (1, 2))
    """
    tableau = _Dual(H, h, c)
    if not tableau.starts_from(tight):
        tableau = _Dual(H, h, c)
    if not tableau.is_feasible():
        empty = any(c) and maximize(H, h, [flint().fmpq(0)] * len(c)).point is None
        return ExactOptimum(-inf if empty else inf, None)
    return tableau.optimum()


def strict_point(
    H: Sequence[Vector], h: Vector, strict_H: Sequence[Vector], strict_h: Vector
) -> tuple[Rational, ...] | None:
    """A point with H x <= h and strict_H x < strict_h, or None: tuple of n fmpq."""
    one, zero = flint().fmpq(1), flint().fmpq(0)
    n = len((*H, *strict_H)[0])
    rows = [(*a, zero) for a in H] + [(*a, one) for a in strict_H] + [(*[zero] * n, one)]
    best = maximize(rows, [*h, *strict_h, one], [zero] * n + [one])  # max t with a x + t <= b for the strict rows
    return best.point[:-1] if best.point is not None and best.value > 0 else None


class _Dual:
    """The simplex tableau of min h y over H'y = c, y >= 0, with one artificial variable per equation."""

    def __init__(self, H: Sequence[Vector], h: Vector, c: Vector) -> None:
        self.zero, self.one = flint().fmpq(0), flint().fmpq(1)
        self.l, self.n = len(h), len(c)
        self.h = list(h)
        self.sign = [-self.one if entry < 0 else self.one for entry in c]
        self.rows: list[list[Rational]] = []
        for i, entry in enumerate(c):
            artificial = [self.one if i == j else self.zero for j in range(self.n)]
            self.rows.append([self.sign[i] * a[i] for a in H] + artificial + [self.sign[i] * entry])
        self.basis = list(range(self.l, self.l + self.n))

    def starts_from(self, chosen: Iterable[int]) -> bool:
        """Let the chosen variables enter the basis; False if that is no feasible one."""
        for k in chosen:
            i = next((i for i, j in enumerate(self.basis) if j >= self.l and self.rows[i][k]), None)
            if i is not None:
                self._pivot(i, k)
        return all(row[-1] >= 0 for row in self.rows)

    def is_feasible(self) -> bool:
        """Phase 1: drive the artificial variables to zero."""
        costs = [self.zero] * self.l + [self.one] * self.n
        self._descend(costs)
        if any(row[-1] for row, j in zip(self.rows, self.basis) if j >= self.l):
            return False
        for i, j in enumerate(self.basis):  # what stays at zero must not rise again
            if j >= self.l:
                entering = next((k for k in range(self.l) if self.rows[i][k]), None)
                if entering is not None:
                    self._pivot(i, entering)
        return True

    def optimum(self) -> ExactOptimum:
        """Phase 2: the ExactOptimum of the primal program."""
        costs = self.h + [self.zero] * self.n
        if not self._descend(costs):
            return ExactOptimum(-inf, None)
        reduced = self._reduced(costs)
        point = tuple(-self.sign[i] * reduced[self.l + i] for i in range(self.n))
        value = sum((costs[j] * row[-1] for row, j in zip(self.rows, self.basis)), self.zero)
        return ExactOptimum(value, point)

    def _reduced(self, costs: Vector) -> list[Rational]:
        """The reduced costs of all variables."""
        reduced = list(costs)
        for row, j in zip(self.rows, self.basis):
            if costs[j]:
                reduced = [r - costs[j] * entry for r, entry in zip(reduced, row)]
        return reduced

    def _descend(self, costs: Vector) -> bool:
        """Pivot until no real variable has a negative reduced cost; False if there is no least cost."""
        reduced, stalled = self._reduced(costs), False
        while True:
            negative = [k for k in range(self.l) if reduced[k] < 0]
            if not negative:
                return True
            entering = negative[0] if stalled else min(negative, key=reduced.__getitem__)
            ratios = [
                (row[-1] / row[entering], j, i)
                for i, (row, j) in enumerate(zip(self.rows, self.basis))
                if row[entering] > 0
            ]
            if not ratios:
                return False
            ratio, _, i = min(ratios)
            stalled = not ratio
            self._pivot(i, entering)
            factor = reduced[entering]
            reduced = [r - factor * entry if entry else r for r, entry in zip(reduced, self.rows[i])]

    def _pivot(self, i: int, entering: int) -> None:
        """Let a variable enter the basis in row i."""
        pivot = self.rows[i][entering]
        self.rows[i] = chosen = [entry / pivot if entry else entry for entry in self.rows[i]]
        for k, row in enumerate(self.rows):
            if k != i and row[entering]:
                factor = row[entering]
                self.rows[k] = [e - factor * f if f else e for e, f in zip(row, chosen)]
        self.basis[i] = entering
