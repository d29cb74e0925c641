"""The largest disturbance for which a closed loop has a safe set."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..checks import positive_number, require_kind
from ..engines.inputs import require_inputs
from ..results import Result
from ..sets.polytope import Polytope
from ..systems.loop import ClosedLoop
from ..typing import ArrayLike
from .maximal_set import has_maximal_set
from .plane import per_axis
from .safe_set import safe_set


@dataclass(frozen=True)
class LargestDisturbance(Result):
    """Result of `largest_disturbance`.

    Attributes
    ----------
    bound : float
        With D = {d : |d_i| <= bound weights_i} in every mode there is a safe set; nan if there is none for d = 0.
    above : float
        No safe set was found with this bound. It is at most `accuracy` above `bound`, or inf if there is a safe set for
        the largest bound of the search.
    tried : int
        Number of loops for which a safe set was searched.
    """

    bound: float
    above: float
    tried: int

    def __str__(self) -> str:
        if np.isnan(self.bound):
            return "largest disturbance: none, there is no safe set even without disturbance"
        beyond = f"no at {self.above:.6g}" if self.above < np.inf else "no larger one tried"
        return f"largest disturbance: yes at {self.bound:.6g}, {beyond} ({self.tried} loops tried)"


def largest_disturbance(
    loop: ClosedLoop,
    method: str | Callable[[ClosedLoop], bool] = "maximal",
    *,
    accuracy: float = 1e-4,
    largest: float | None = None,
    C: ArrayLike | None = None,
    weights: ArrayLike = 1.0,
) -> LargestDisturbance:
    """The largest bound r for which the loop with D = {d : |d_i| <= r w_i} in every mode has a safe set, by bisection.

    Parameters
    ----------
    loop : ClosedLoop
        Its own disturbance sets do not matter.
    method : "maximal", "template", or callable
        Which safe set is searched for: the maximal one (two states), F_max with the template C, or one that a function
        searches for. The function gets a ClosedLoop and returns a bool.
    accuracy : float
        Largest difference between `bound` and `above`.
    largest : float or None
        Upper end of the search. None is the smallest r at which D is as wide as X along some axis; with a larger r no
        set in X is RPI.
    C : array (l, n) or None
        Template of F_max, as in `safe_set`.
    weights : float or array (n,)
        w, the shape of D. 1 gives D = {d : |d|_inf <= r} with r in units of d. If the states have different units, give
        one number per state.

    Returns
    -------
    LargestDisturbance

    Raises
    ------
    TypeError
        If `loop` is no ClosedLoop, or `method` is neither a string nor callable.
    ValueError
        If there is no such method, an argument is out of range, or Phi leaves U.

    See Also
    --------
    maximal_safe_set : the set for one disturbance, with a proof; safe_set : F_max.

    Examples
    --------
    >>> import mireach as mr
    >>> zero, X = mr.Polytope.box([0, 0], [0, 0]), mr.Polytope.box([-1, -1], [1, 1])
    >>> mode = mr.Mode([[0.5, 0], [0, 0.5]], [[0], [0]], [0, 0], X.product(mr.Polytope.box([-1], [1])), zero)
    >>> system = mr.PWASystem([mode], X, mr.Polytope.box([-1], [1]))
    >>> loop = mr.ClosedLoop(system, mr.MaxoutNetwork((), [[0.0, 0.0]], [0.0]))
    >>> print(largest_disturbance(loop, "template", C=mr.box_directions(2), accuracy=0.01))  # x+ = x / 2 + d
    largest disturbance: yes at 0.5, no at 0.507812 (9 loops tried)

    Notes
    -----
    The answer is *yes* up to a bound and *no* beyond. For "maximal": a set that is RPI for D is RPI for every smaller
    D. For "template": a smaller D makes every F_k and its image smaller. A function of a loop should be monotone in the
    same way; otherwise bisection finds one of the bounds at which its answer changes. The sets of the search for
    "maximal" are found in floating point; `maximal_safe_set` proves the one at `bound`.
    """
    require_kind(loop, ClosedLoop, "loop")
    accuracy = positive_number(accuracy, "accuracy")
    weights = per_axis(weights, loop.system.state_size, "weights")
    has_set = _method(method, C)
    require_inputs(loop)
    if largest is None:
        lower, upper = loop.system.state_set.bounding_box()
        largest = ((upper - lower) / weights).min() / 2
    low, high = 0.0, positive_number(largest, "largest")

    def holds(r: float) -> bool:
        return bool(has_set(loop.with_disturbance(Polytope.box(-r * weights, r * weights))))

    if not holds(low):
        return LargestDisturbance(np.nan, low, 1)
    if holds(high):
        return LargestDisturbance(high, np.inf, 2)
    tried = 2
    while high - low > accuracy:
        middle = (low + high) / 2
        low, high = (middle, high) if holds(middle) else (low, middle)
        tried += 1
    return LargestDisturbance(low, high, tried)


def _method(method: str | Callable[[ClosedLoop], bool], C: ArrayLike | None) -> Callable[[ClosedLoop], bool]:
    """The function that returns whether a loop has a safe set."""
    if callable(method):
        return method
    require_kind(method, str, "method")
    if method == "maximal":
        return has_maximal_set
    if method == "template":
        return lambda loop: safe_set(loop, C).set is not None
    raise ValueError(f'method must be "maximal", "template" or a function of a loop; got {method!r}')
