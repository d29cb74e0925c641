"""The error of a piecewise-affine fit, with its first and second derivatives in ball arithmetic."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..arithmetic.balls import ball, evaluate, flint, pairs
from ..systems.pwa import Mode
from ..typing import Array, IntArray


class Residual:
    """e(z) = v (f(x, u) - A x - B u - p) / unit with (x, u) = scale z, for each row v of `directions`.

    Parameters
    ----------
    f : callable
        f(x, u) -> n components, by the operations in `balls.ALLOWED`.
    mode : Mode
        A, B and p.
    directions : array (k, n)
        The rows v.
    scale : array (n+m,)
        Powers of two, in units of (x, u).
    unit : array (k,)
        Powers of two, in units of v x.

    Notes
    -----
    Balls are Arb's, at the precision of the surrounding `balls.precision` block.
    """

    def __init__(self, f: Callable[[Any, Any], Any], mode: Mode, directions: Array, scale: Array, unit: Array) -> None:
        self.f, self.mode = f, mode
        self.directions, self.unit = directions, unit
        self.scale = scale
        self.n = len(mode.A)
        self._affine = [[ball(entry) for entry in row] for row in np.column_stack([mode.A, mode.B, mode.p])]
        self._scales = [ball(s) for s in scale]
        self._rows = [[ball(c) / ball(t) for c in v] for v, t in zip(directions, unit)]

    def at(self, point: Array) -> Array:
        """Values (k,) at a point z (n+m,), in floating point."""
        z = point * self.scale
        x, u = z[: self.n], z[self.n :]
        with np.errstate(all="ignore"):
            return self.directions @ (np.asarray(self.f(x, u), float) - self.mode.successor(x, u)) / self.unit

    def tangent(self, centre: Array, rows: IntArray) -> list[list[Any]]:
        """e and its gradient at z = `centre` for some of the directions: balls (len(rows), 1 + n+m)."""
        z, jets = self._jets([ball(c) for c in centre], 1)
        table = []
        for jet, (*slope, offset) in zip(jets, self._affine):
            value = jet.value - offset - sum(a * c for a, c in zip(slope, z))
            table.append([value] + [(g - a) * s for g, a, s in zip(jet.gradient, slope, self._scales)])
        return self._combine(rows, table)

    def curvature(self, box: Sequence[Any], rows: IntArray) -> list[list[Any]]:
        """The Hessian of e over a box of balls (n+m,) for some of the directions: entries `balls.pairs(n+m)`."""
        both = [self._scales[i] * self._scales[j] for i, j in pairs(len(self._scales))]
        _, jets = self._jets(box, 2)
        return self._combine(rows, [[h * s for h, s in zip(jet.hessian, both)] for jet in jets])

    def _jets(self, point: Sequence[Any], order: int) -> tuple[list[Any], list[Any]]:
        """(x, u) of a point of balls (n+m,), and the components of f there."""
        z = [c * s for c, s in zip(point, self._scales)]
        jets = evaluate(self.f, z[: self.n], z[self.n :], order)
        if len(jets) != self.n:
            raise ValueError(f"f gives {len(jets)} components, but the state has {self.n} entries")
        return z, jets

    def _combine(self, rows: IntArray, table: list[list[Any]]) -> list[list[Any]]:
        """Some rows of directions / unit @ a table (n, c) of balls, as nested lists of balls."""
        matrix = flint().arb_mat
        return (matrix([self._rows[k] for k in rows]) * matrix(table)).tolist()
