"""Upper bounds of linear programs by weak duality: they hold for any multipliers, with rounding counted.

A solver proposes multipliers. What it says about them, or about its optimum, is not used.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from ..tolerances import ROUNDOFF, UNDERFLOW
from ..typing import Array

DENSE = 100_000  # entries up to which a matrix of rows is kept dense, for speed

Matrix: TypeAlias = Any  # an Array, or a csr_array of scipy, which has no types


class Row(NamedTuple):
    """One constraint, lower <= coefficients x[columns] <= upper."""

    columns: NDArray[np.int32]
    coefficients: Array
    lower: float
    upper: float


@dataclass(frozen=True, eq=False)
class Rows:
    """The constraints lower <= A x <= upper.

    Attributes
    ----------
    transposed, size : csr_array or array (columns, rows)
        A' and |A|'.
    lower, upper : array (rows,)

    Examples
    --------
    x1 + 2 x2 <= 4 with multiplier 1 bounds x1 + 2 x2, whatever the limits of x are:

    >>> rows = Rows.of([Row(np.array([0, 1], np.int32), np.array([1.0, 2.0]), -np.inf, 4.0)], 2)
    >>> rows.bound(np.array([1.0, 2.0]), np.array([1.0]), np.zeros(2), np.full(2, 9.0)) - 4 < 1e-12
    True
    """

    transposed: Matrix
    size: Matrix
    lower: Array
    upper: Array

    @classmethod
    def of(cls, rows: Sequence[Row], columns: int) -> "Rows":
        """From the rows of a matrix with so many columns."""
        starts = np.cumsum([0, *(len(row.columns) for row in rows)])
        indices = np.concatenate([np.zeros(0, np.int32), *(row.columns for row in rows)])
        values = np.concatenate([np.zeros(0), *(row.coefficients for row in rows)])
        transposed: Matrix
        if len(rows) * columns <= DENSE:
            transposed = np.zeros((columns, len(rows)))
            transposed[indices, np.repeat(np.arange(len(rows)), np.diff(starts))] = values
        else:
            transposed = csr_array(csr_array((values, indices, starts), shape=(len(rows), columns)).T)
        lower = np.array([row.lower for row in rows], float)
        upper = np.array([row.upper for row in rows], float)
        return cls(transposed, abs(transposed), lower, upper)

    def bound(self, c: Array, y: Array, low: Array, high: Array) -> float:
        """A number that c x nowhere exceeds on these rows and low <= x <= high, for any multipliers y.

        Weak duality: c x = y A x + (c - A'y) x <= sum max(y lower, y upper) + sum max((c - A'y) low, (c - A'y) high).
        What rounding may take from that is added.

        Parameters
        ----------
        c : array (columns,)
        y : array (rows,)
            Where a row has no limit on the side that y points to, 0 is taken.
        low, high : array (columns,)
            Limits of x; infinite ones are allowed.

        Returns
        -------
        float
            inf if nothing is proven.
        """
        rows, reduced, terms = self._split(c, y)
        columns = np.where(reduced > 0, high, np.where(reduced < 0, low, 0)) * reduced
        extent = np.where(terms > 0, np.maximum(np.abs(low), np.abs(high)), 0)
        size = np.abs(rows).sum() + extent @ terms
        rounding = self._rounding * size + (UNDERFLOW if 0 < size < 2.0**-900 else 0.0)
        total = float(rows.sum() + columns.sum() + rounding)
        return np.inf if np.isnan(total) else total

    def is_proven_empty(self, ray: Array, low: Array, high: Array) -> bool:
        """Whether multipliers (rows,) bound 0 x by a negative number: there is no x then (Farkas's lemma)."""
        return self.bound(np.zeros(len(low)), -ray, low, high) < 0

    def bound_without_limits(
        self, c: Array, y: Array, low: Array, high: Array, free: NDArray[np.bool_]
    ) -> tuple[float, Array]:
        """Coefficients (b, e) with c x <= b + sum of e_j |x_j| over the columns `free`; low <= x <= high in the others.

        Parameters
        ----------
        c, y, low, high : array
            As in `bound`.
        free : array (columns,) of bool

        Returns
        -------
        b : float
        e : array (number of free columns,)
        """
        _, reduced, terms = self._split(c, y)
        inside = self.bound(c, y, np.where(free, 0, low), np.where(free, 0, high))
        return inside, (np.abs(reduced) + self._rounding * terms)[free]

    @property
    def _rounding(self) -> float:
        """The relative rounding error of a sum over all rows and columns."""
        return ROUNDOFF * (sum(self.transposed.shape) + 8)

    def _split(self, c: Array, y: Array) -> tuple[Array, Array, Array]:
        """max(y lower, y upper) of each row, c - A'y of each column, and the sizes of its terms."""
        y = np.where(((y > 0) & (self.upper == np.inf)) | ((y < 0) & (self.lower == -np.inf)), 0, y)
        rows = np.where(y > 0, self.upper, np.where(y < 0, self.lower, 0)) * y
        return rows, c - self.transposed @ y, np.abs(c) + self.size @ np.abs(y)


def joint_limits(b: Array, e: Array) -> tuple[Array, Array] | None:
    """Limits (lower, upper) of k variables, each of which is bounded in terms of the sizes of all of them.

    If |x_j| <= b_j + sum over i of e_ji |x_i| for all j, then no |x_i| exceeds s = max b / (1 - max sum_i e_ji), and so
    |x_j| <= b_j + s sum_i e_ji.

    Parameters
    ----------
    b : array (2, k)
        Of -x and of x.
    e : array (2, k, k)

    Returns
    -------
    tuple of array (k,) or None
        None if nothing is proven.

    Examples
    --------
    >>> lower, upper = joint_limits(np.array([[1.0], [2.0]]), np.array([[[0.25]], [[0.25]]]))
    >>> lower.round(9).tolist(), upper.round(9).tolist()
    ([-1.666666667], [2.666666667])
    """
    count = b.shape[1]
    share = e.sum(axis=2).max() * (1 + ROUNDOFF * (count + 1))
    if not (np.isfinite(b).all() and share < 0.5):
        return None
    most = max(b.max(), 0) / (1 - share) * (1 + 8 * ROUNDOFF)
    ends = (b + e.sum(axis=2) * most) + ROUNDOFF * (count + 8) * (np.abs(b) + e.sum(axis=2) * most)
    return -ends[0], ends[1]
