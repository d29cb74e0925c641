"""The largest amount of disturbance for which a safe set is found, one trial at a time."""

import numpy as np

from ..sets.polytope import Polytope

COARSE = 9  # amounts, evenly spread, that are tried before the bisection
ACCURACY = 1e-4  # of the largest disturbance, relative to the range of amounts

Trials = dict[float, Polytope | None]  # amount -> F_max, or None where no safe set is found


def next_amount(trials: Trials, low: float, high: float) -> float | None:
    """The amount to be tried next on the way to the largest one with a safe set.

    Parameters
    ----------
    trials : dict of float to (Polytope or None)
        What `safe_set_at` gave for the amounts tried so far.
    low, high : float
        The range of amounts.

    Returns
    -------
    float or None
        First an even grid, then bisection between the largest amount with a safe set and the next one without;
        None once they are within `ACCURACY` of the range, or if there is no safe set at all.

    Notes
    -----
    Disturbance sets that hold the origin grow with the amount, and with them every F_k: the answer changes once, from
    yes to no. For other sets it may change more often; the bisection closes in on the last change that the grid has
    shown.

    Examples
    --------
    >>> next_amount({}, 0.0, 2.0)
    0.0
    """
    for amount in np.linspace(low, high, COARSE).tolist():
        if amount not in trials:
            return float(amount)
    best = largest_amount(trials)
    above = [amount for amount in trials if best is not None and amount > best]
    if best is None or not above or min(above) - best <= ACCURACY * (high - low):
        return None
    return (best + min(above)) / 2


def largest_amount(trials: Trials) -> float | None:
    """The largest amount for which a safe set was found; None if there is none.

    Examples
    --------
    >>> box = Polytope.box([-1], [1])
    >>> largest_amount({0.0: box, 1.0: box, 2.0: None})
    1.0
    """
    return max((amount for amount, found in trials.items() if found is not None), default=None)
