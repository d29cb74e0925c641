"""Theorem 1: the largest factor by which an RPI set may be enlarged so that one step still leads into the set."""

import numpy as np

from ..arithmetic.rational import above, below, binary, dot
from ..checks import positive_number, require_kind
from ..engines.base import SOLVER, Engine
from ..engines.registry import engine_for
from ..sets.polytope import Polytope
from ..systems.loop import ClosedLoop
from ..tolerances import EXPRESSION
from ..typing import Array
from .arguments import Centre, centre_point
from .comparison import compare
from .reach import support


def contraction(
    loop: ClosedLoop,
    R: Polytope,
    centre: Centre = "origin",
    engine: Engine | str | None = None,
    *,
    largest: float = 2.0,
    accuracy: float = 1e-9,
) -> float:
    """Largest alpha found with R_1(c + alpha (R - c)) in R, the only property of alpha in the proof of Theorem 1.

    Eq. (26), StabCondFmin, alpha R_k-bar in R_(k-1)-bar, implies this inclusion. The inclusion can hold with alpha > 1
    even if some facets of the sequence no longer move, so that eq. (26), StabCondFmin, holds only with alpha = 1.

    Parameters
    ----------
    loop : ClosedLoop
    R : Polytope
        An RPI set, such as a terminal set.
    centre : "origin", "equilibrium" or array (n,)
        As in `terminal_set`.
    engine : Engine, str or None
        As in `support`.
    largest : float
        Upper end of the search.
    accuracy : float
        Accuracy of the bisection, in units of alpha. The returned alpha is proven, up to the accuracy of the engine.

    Returns
    -------
    float
        If it is above 1, the set R is stable. 1 means that no alpha above 1 was found; it does not mean that R is RPI.
        nan if the centre is not inside R.

    Raises
    ------
    TypeError
        If an argument is of another kind.
    ValueError
        If `largest` or `accuracy` is not positive, or as `support`.

    See Also
    --------
    terminal_set : gives alpha of eq. (26), StabCondFmin.

    Examples
    --------
    >>> import mireach as mr
    >>> loop = mr.case_study("double_integrator").loop
    >>> R = mr.terminal_set(loop, mr.safe_set(loop)).set
    >>> mr.contraction(loop, R, accuracy=1e-3) >= 1
    True
    """
    require_kind(R, Polytope, "R")
    largest, accuracy = positive_number(largest, "largest"), positive_number(accuracy, "accuracy")
    c, X = centre_point(loop, centre), loop.system.state_set
    engine = engine_for(loop, engine)
    if (R.H @ c >= R.h).any():
        return np.nan

    def holds(alpha: float) -> bool:
        grown = scaled(R, alpha, c)
        if not grown.is_subset(X):
            return False
        found = support(loop, grown, R.H, engine=engine, cutoff=R.h)
        if not (found.bound <= R.h).all():
            return False
        return found.rests_on != SOLVER or bool(compare(loop, grown, R.H, R.h, engine, cutoff=R.h).holds.all())

    low, high = 1.0, largest
    while high - low > accuracy:
        middle = (low + high) / 2
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def growth(V: Array, reach: Array, before: Array, c: Array) -> float:
    """Largest alpha with alpha (R - c) in R_before - c, rounded down, for sets with rows V; nan if c is not inside R.

    `reach` is the support function of R along V, and `before` has the offsets of R_before. Rows that cannot have the
    smallest ratio are excluded by floats with error bounds. The other rows are compared in rational arithmetic.
    """
    middle, error = V @ c, rounding(V, c, reach, before)
    top, bottom = before - middle, reach - middle
    rows = np.arange(len(V))
    if (bottom > 2 * error).all():
        least = (top - error) / np.where(top > error, bottom + error, bottom - error)
        most = (top + error) / np.where(top > -error, bottom - error, bottom + error)
        rows = np.flatnonzero(least - most.min() <= 8 * EXPRESSION * (np.abs(least) + np.abs(most.min())))
    c, shares = binary(c), []
    for r in rows:
        value, inner = dot(binary(V[r]), c), binary(reach[r])
        if inner <= value:
            return np.nan
        shares.append((binary(before[r]) - value) / (inner - value))
    return below(min(shares))


def rounding(V: Array, c: Array, h: Array, other: Array) -> Array:
    """Bounds on the rounding errors of h - V c and of other - V c: array (k,)."""
    return (len(c) + 4) * EXPRESSION * (np.abs(V) @ np.abs(c) + np.maximum(np.abs(h), np.abs(other)))


def scaled(R: Polytope, s: float, c: Array) -> Polytope:
    """c + s (R - c), its offsets rounded upward."""
    s, centre = binary(s), binary(c)
    offsets = [above(s * b + (1 - s) * dot(a, centre)) for a, b in zip(binary(R.H), binary(R.h))]
    return Polytope(R.H, np.array(offsets))
