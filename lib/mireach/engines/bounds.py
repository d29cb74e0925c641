"""Sound bounds of affine functions over a relaxation: what every big-M and every pruned binary rests on."""

import numpy as np

from ..errors import SolverError

METHODS = ("interval", "lp", "tight")
# Added to what an LP solver calls the maximum, relative to 1 + its size. It has to stay far above the tolerance of the
# MILP: with slacks of 1e-8 and a tolerance of 1e-9, HiGHS 1.15 cut off the optimum of one random model in 25.
SAFETY = 1e-6
NODES = 200  # after which a partial MILP gives the bound that it has


def upper_bound(lp, columns, coefficients, constant=0.0, method="lp"):
    """A number that coefficients x[columns] + constant nowhere exceeds.

    Parameters
    ----------
    lp : LinearProgram
        A relaxation: everything that may happen satisfies its constraints.
    columns, coefficients : array (k,)
    constant : float
    method : "interval", "lp" or "tight"
        From the bounds of the single variables; or from all constraints by one LP; or, if the sign is still open
        and there are binaries, by the dual bound of a MILP of at most `NODES` nodes. What costs more is left out
        where less shows already that the sign is not positive.

    Returns
    -------
    float
        -inf if the relaxation holds no point; never an attained value, for `SAFETY` is added.
    """
    coefficients = np.asarray(coefficients, float)
    used = coefficients != 0
    ends = np.maximum(coefficients[used] * lp.lower[columns][used], coefficients[used] * lp.upper[columns][used])
    interval = ends.sum() + constant + 1e-12 * (np.abs(ends).sum() + abs(constant))
    if method == "interval" or interval <= 0 or not used.any():
        return interval
    try:
        bound = _safe(lp.bound(columns, coefficients) + constant, interval)
        if method == "tight" and lp.binaries and bound > 0:
            bound = _safe(lp.maximize_integer(columns, coefficients, nodes=NODES).bound + constant, bound)
    except SolverError:  # flat sets can leave a solver undecided; the interval holds in any case
        return interval
    return bound


def lower_bound(lp, columns, coefficients, constant=0.0, method="lp"):
    """A number below which coefficients x[columns] + constant never falls; as `upper_bound`."""
    return -upper_bound(lp, columns, -np.asarray(coefficients, float), -constant, method)


def _safe(found, known):
    """What a solver found, on the safe side, or what is known already."""
    return min(known, found + SAFETY * (1 + abs(found))) if found > -np.inf else found
