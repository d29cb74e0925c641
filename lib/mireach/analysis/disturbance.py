"""The largest disturbance for which a closed loop has a safe set."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..checks import positive_number, require_kind
from ..engines.inputs import require_inputs
from ..results import Result
from ..sets.polytope import Polytope
from ..sets.region import Region
from ..sets.templates import directions
from ..systems.loop import ClosedLoop
from ..typing import Array, ArrayLike
from .maximal_set import limit_within
from .plane import PlanarLoop, per_axis
from .reach import support
from .safe_set import safe_set

MAXIMAL_DOUBT = 1 / 16  # share of `accuracy` that the coarser slack of the search for "maximal" may cost
COVER = 16  # directions of the covers of R_k(X) for a disturbance that stays the same
STEPS = 40  # the k of these covers
SLACKS = 4  # slacks that D has to grow by for a certain *no*: 3 (see the notes), and one for rounding


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
    The answer is *yes* up to a bound and *no* beyond, so bisection finds that bound. For "maximal": what is RPI for D
    is RPI for every smaller D. For F_max with a fixed template: R_1(F) grows with F and with D. By induction
    over k each F_k grows with D, so R_1(F_k) in X for one D gives R_1(F_k) in X, with the same k, for a smaller one. A
    function that is passed as `method` has to be monotone as well.

    The sets of the search are found in floating point; `maximal_safe_set` proves the one at `bound`. The search for
    "maximal" has a coarser slack s than its default: a box of half-width s widens D and what is lost. A set that it
    finds is RPI all the same. Where it finds none for r, there is none for r + e, if e w is at least 3 s along every
    axis (in the units of the engine): let S be RPI for r + e, and let T be S less everything within 2 s of its
    complement. T is not empty, as S holds a translate of D for r + e. States within s of T lie in S, and what D for r,
    widened by s, makes of them lies in T. So the iteration for r never removes T. Each iteration starts from the set
    for a smaller r, which holds the set for r. It ends early where it misses a set that every RPI set meets.
    """
    require_kind(loop, ClosedLoop, "loop")
    accuracy = positive_number(accuracy, "accuracy")
    weights = per_axis(weights, loop.system.state_size, "weights")
    has_set, doubt = _method(loop, method, C, accuracy * weights)
    doubt *= accuracy
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
    while high + doubt - low > accuracy:
        middle = (low + high) / 2
        low, high = (middle, high) if holds(middle) else (low, middle)
        tried += 1
    return LargestDisturbance(low, high + doubt, tried)


def _method(
    loop: ClosedLoop, method: str | Callable[[ClosedLoop], bool], C: ArrayLike | None, least: Array
) -> tuple[Callable[[ClosedLoop], bool], float]:
    """The function of a loop that says whether there is a safe set, and how much larger D must be for a certain *no*.

    The latter is a share of `least` (n,), half-widths of a disturbance (units of x).
    """
    if callable(method):
        return method, 0.0
    require_kind(method, str, "method")
    if method == "maximal":
        half_width = float((least / PlanarLoop.of(loop).units.state).min())
        return _ShrinkingSets(MAXIMAL_DOUBT * half_width / SLACKS).has_set, MAXIMAL_DOUBT
    if method == "template":
        return lambda loop: safe_set(loop, C).set is not None, 0.0
    raise ValueError(f'method must be "maximal", "template" or a function of a loop; got {method!r}')


@dataclass
class _ShrinkingSets:
    """The maximal sets of loops whose D grows as long as there is a set, each searched within the one before.

    Attributes
    ----------
    slack : float
        Of all of them but the first, which is searched with the default slack (units of the engine).
    last : Region or None
        The last set that was found, in these units; None is X.
    """

    slack: float
    last: Region | None = None

    def has_set(self, loop: ClosedLoop) -> bool:
        """Whether the loop has a maximal set; its D has to hold every D for which one was found before."""
        met = sets_that_are_met(loop)
        if met is None:
            return False
        found = limit_within(loop, 0.0 if self.last is None else self.slack, self.last, met)
        if found is not None:
            self.last = found
        return found is not None


def sets_that_are_met(loop: ClosedLoop) -> list[Polytope] | None:
    """Sets that every RPI set meets; None if there is no RPI set, since some d drives every state of X out of it.

    If d stays at one corner of D, a trajectory from an RPI set stays in it, and is in a cover of R_k(X) after k steps.

    Parameters
    ----------
    loop : ClosedLoop
        With two states and the same D in all modes.
    """
    (D,) = {mode.disturbance for mode in loop.system.modes}
    C, met = directions(COVER), []
    for d in D.vertices():
        held, F = loop.with_disturbance(Polytope.box(d, d)), loop.system.state_set
        for _ in range(STEPS):
            bound = support(held, F, C).bound
            if not np.isfinite(bound).all():
                return None
            F = Polytope(C, bound)
        met.append(F & loop.system.state_set)
    return None if any(F.is_empty for F in met) else met
