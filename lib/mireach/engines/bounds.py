"""Sound bounds of affine functions over a relaxation: what every big-M and every pruned binary rests on."""

from functools import lru_cache
from time import perf_counter

import numpy as np

from ..errors import SolverError
from ..solvers.linear_program import LinearProgram
from ..solvers.weak_duality import ROUNDOFF

METHODS = ("interval", "lp", "tight")
# Added to the bound that an LP proves, relative to 1 + its size. It has to stay far above the tolerance of HiGHS's MILP
# solver, which looks for incumbents: with slacks of 1e-8 and a tolerance of 1e-9, HiGHS 1.15 cut off the optimum of one
# random model in 25.
SAFETY = 1e-6
NODES = 200  # after which a partial MILP gives the bound that it has
CACHED = 64  # polytopes whose linear programs are kept


def upper_bound(lp, columns, coefficients, constant=0.0, method="lp", error=0.0):
    """A number that coefficients x[columns] + constant nowhere exceeds, nor any function within `error` of that.

    Parameters
    ----------
    lp : LinearProgram
        A relaxation: everything that may happen satisfies its constraints.
    columns, coefficients : array (k,)
    constant : float
    method : "interval", "lp" or "tight"
        From the bounds of the single variables; or from all constraints by one LP; or, if the sign is still open
        and there are binaries, by the dual bound of a MILP of at most `NODES` nodes. What costs more is left out
        where less shows already that the sign is not positive, and after `lp.end`.
    error : float
        How far the function may be from the one with these coefficients, on all points of the relaxation.

    Returns
    -------
    float
        -inf only if it is proven that the relaxation holds no point; what is above the attained maximum is at least
        `SAFETY` for "lp" and "tight".
    """
    coefficients = np.asarray(coefficients, float)
    used = coefficients != 0
    ends = np.maximum(coefficients[used] * lp.lower[columns][used], coefficients[used] * lp.upper[columns][used])
    size = np.abs(ends).sum() + abs(constant) + error
    interval = ends.sum() + constant + error + ROUNDOFF * (len(ends) + 4) * size
    if method == "interval" or interval <= 0 or not used.any() or perf_counter() > lp.end:
        return interval
    try:
        bound = _safe(lp.bound(columns, coefficients), constant, error, interval)
        if method == "tight" and lp.binaries and bound > 0:
            found = lp.maximize_integer(columns, coefficients, gap=SAFETY, nodes=NODES)
            bound = _safe(found.bound, constant, error, bound)
    except SolverError:  # flat sets can leave a solver undecided; the interval holds in any case
        return interval
    return bound


def lower_bound(lp, columns, coefficients, constant=0.0, method="lp", error=0.0):
    """A number below which coefficients x[columns] + constant never falls; as `upper_bound`."""
    return -upper_bound(lp, columns, -np.asarray(coefficients, float), -constant, method, error)


def _safe(found, constant, error, known):
    """A bound of an LP on the safe side, or what is known already; the sum is rounded by less than is added."""
    if found == -np.inf:
        return found
    return min(known, found + constant + error + SAFETY * (1 + abs(found) + abs(constant)))


# -- polytopes ----------------------------------------------------------------------------------------


def proven_support(P, V):
    """Numbers (k,) that v x nowhere exceeds on a bounded Polytope, for the rows v of V: weak duality, rounding counted.

    A few of the last digits above `Polytope.bound`, which takes longer and is asked where multipliers prove nothing.
    """
    lp, x = _program(P)
    V = np.asarray(V, float)
    found = np.array([lp.bound(x, v) for v in V])
    for i in np.flatnonzero(found == np.inf):
        found[i] = P.bound(V[i : i + 1])[0]
    return found


def far_points(P, V):
    """Points (k, n) of a bounded, nonempty Polytope that are farthest along the rows of V, to within tolerances."""
    lp, x = _program(P)
    found = [lp.maximize(x, v).point for v in V]
    return np.array([P.farthest(v) if point is None else point for v, point in zip(V, found)])


@lru_cache(maxsize=CACHED)
def proven_box(P):
    """A box (lower (n,), upper (n,)) around a bounded Polytope; lower > upper if it is proven to be empty."""
    identity = np.eye(P.dimension)
    return -proven_support(P, -identity), proven_support(P, identity)


@lru_cache(maxsize=CACHED)
def _program(P):
    """H x <= h as a LinearProgram, and the columns of x."""
    lp = LinearProgram()
    x = lp.add_columns(np.full(P.dimension, -np.inf), np.full(P.dimension, np.inf))
    lp.add_rows(x, P.H, upper=P.h)
    return lp, x
