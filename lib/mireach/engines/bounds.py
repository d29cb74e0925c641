"""Proven bounds of affine functions over a relaxation. Every big-M and every removed binary rests on them."""

from functools import lru_cache
from time import perf_counter

import numpy as np

from ..errors import SolverError
from ..sets.polytope import Polytope
from ..solvers.linear_program import LinearProgram
from ..tolerances import ROUNDOFF
from ..typing import Array, ArrayLike, IntArray

METHODS = ("interval", "lp", "tight")
# Added to the bound that an LP proves, relative to 1 + its size. It has to stay far above the tolerance of HiGHS's MILP
# solver, which looks for incumbents: with slacks of 1e-8 and a tolerance of 1e-9, HiGHS 1.15 cut off the optimum of one
# random model in 25.
SAFETY = 1e-6
NODES = 200  # nodes after which a partial MILP returns the bound that it has
CACHED = 64  # polytopes whose linear programs are cached


def upper_bound(
    lp: LinearProgram,
    columns: IntArray,
    coefficients: ArrayLike,
    constant: float = 0.0,
    method: str = "lp",
    error: float = 0.0,
) -> float:
    """An upper bound of coefficients x[columns] + constant, and of every function within `error` of it.

    Parameters
    ----------
    lp : LinearProgram
        A relaxation: every trajectory satisfies its constraints.
    columns, coefficients : array (k,)
    constant : float
    method : "interval", "lp" or "tight"
        From the bounds of the single variables; or from all constraints by one LP; or, if the bound of the LP is
        positive and there are binaries, by the dual bound of a MILP of at most `NODES` nodes. The more expensive
        methods are skipped where the bound is already not positive, and after `lp.end`.
    error : float
        The function differs from the one with these coefficients by at most this, on all points of the relaxation.

    Returns
    -------
    float
        -inf only if it is proven that the relaxation has no point. For "lp" and "tight" it lies above the maximum by
        at least `SAFETY`.
    """
    row = np.asarray(coefficients, float)
    used = row != 0
    ends = np.maximum(row[used] * lp.lower[columns][used], row[used] * lp.upper[columns][used])
    size = np.abs(ends).sum() + abs(constant) + error
    interval = ends.sum() + constant + error + ROUNDOFF * (len(ends) + 4) * size
    if method == "interval" or interval <= 0 or not used.any() or perf_counter() > lp.end:
        return interval
    try:
        bound = _safe(lp.bound(columns, row), constant, error, interval)
        if method == "tight" and lp.binaries and bound > 0:
            found = lp.maximize_integer(columns, row, gap=SAFETY, nodes=NODES)
            bound = _safe(found.bound, constant, error, bound)
    except SolverError:  # for flat sets the solver may give no answer; the interval bound holds anyway
        return interval
    return bound


def lower_bound(
    lp: LinearProgram,
    columns: IntArray,
    coefficients: ArrayLike,
    constant: float = 0.0,
    method: str = "lp",
    error: float = 0.0,
) -> float:
    """A lower bound of coefficients x[columns] + constant; as `upper_bound`."""
    return -upper_bound(lp, columns, -np.asarray(coefficients, float), -constant, method, error)


def _safe(found: float, constant: float, error: float, earlier: float) -> float:
    """The bound of an LP plus `SAFETY`, which exceeds the rounding of the sum, or an earlier bound if that is less."""
    if found == -np.inf:
        return found
    return min(earlier, found + constant + error + SAFETY * (1 + abs(found) + abs(constant)))


# -- polytopes ----------------------------------------------------------------------------------------


def proven_support(P: Polytope, V: ArrayLike) -> Array:
    """Upper bounds (k,) of h_P along the rows of V, for a bounded Polytope: weak duality, rounding counted.

    They exceed `Polytope.bound` by a few units in the last place. `Polytope.bound` takes longer; it is used where the
    multipliers prove nothing.
    """
    lp, x = _program(P)
    rows = np.asarray(V, float)
    found = np.array([lp.bound(x, v) for v in rows])
    for i in np.flatnonzero(found == np.inf):
        found[i] = P.bound(rows[i : i + 1])[0]
    return found


def support_vectors(P: Polytope, V: Array) -> Array:
    """Support vectors (k, n) of a bounded, nonempty Polytope along the rows of V, to within tolerances."""
    lp, x = _program(P)
    found = [lp.maximize(x, v).point for v in V]
    return np.array([P.support_vector(v) if point is None else point for v, point in zip(V, found)])


@lru_cache(maxsize=CACHED)
def proven_box(P: Polytope) -> tuple[Array, Array]:
    """A box (lower (n,), upper (n,)) around a bounded Polytope; lower > upper if it is proven to be empty."""
    identity = np.eye(P.dimension)
    return -proven_support(P, -identity), proven_support(P, identity)


@lru_cache(maxsize=CACHED)
def _program(P: Polytope) -> tuple[LinearProgram, IntArray]:
    """H x <= h as a LinearProgram, and the columns of x."""
    lp = LinearProgram()
    x = lp.add_columns(np.full(P.dimension, -np.inf), np.full(P.dimension, np.inf))
    lp.add_rows(x, P.H, upper=P.h)
    return lp, x
