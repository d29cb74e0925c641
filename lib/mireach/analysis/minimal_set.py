"""The scaled minimal RPI set of Sec. IV.B, from the forward sequence that starts at a point."""

from dataclasses import dataclass

import numpy as np

from ..checks import positive_number, whole_number
from ..engines.base import SOLVER, Engine
from ..engines.registry import engine_for
from ..engines.units import own_units
from ..results import Result, Verdict
from ..sets.polytope import Polytope
from ..systems.loop import ClosedLoop
from ..tolerances import CLEAR
from ..typing import Array, ArrayLike
from .arguments import Centre, centre_point, template, with_rows
from .comparison import compare
from .contraction import scaled
from .reach import require_bounds, support
from .rpi import check_rpi, require_rpi
from .safe_set import SafeSet, set_to_start_from


@dataclass(frozen=True, eq=False)
class MinimalSet(Result):
    """Result of `scaled_minimal_set`.

    Attributes
    ----------
    set : Polytope or None
        (1 + epsilon) R_k-bar(centre), if it is RPI for some k.
    steps : int
        The last k.
    history : list of Polytope
        R_0-bar(centre), ...
    verdict : Verdict
        Whether `set` is RPI.
    reached_at : int or None
        First j with R_j-bar(F_max) in `set`; then `set` may be used as terminal set. None if there is no such j, or no
        F_max was given, or if bounds on the way are a solver's word that nothing confirms.
    reason : str
    """

    set: Polytope | None
    steps: int
    history: list[Polytope]
    verdict: Verdict
    reached_at: int | None
    reason: str

    def __str__(self) -> str:
        return f"scaled minimal set: {self.verdict}; {self.reason}"


def scaled_minimal_set(
    loop: ClosedLoop,
    C: ArrayLike | None = None,
    epsilon: float = 1e-3,
    centre: Centre = "origin",
    safe: SafeSet | Polytope | None = None,
    engine: Engine | str | None = None,
    *,
    max_steps: int = 1000,
    tol: float | None = None,
) -> MinimalSet:
    """(1 + epsilon) R_k-bar(0), the scaled minimal RPI set of Sec. IV.B, with the first k at which it is RPI.

    Parameters
    ----------
    loop : ClosedLoop
    C : array (l, n) or None
        As in `safe_set`.
    epsilon : float
        Positive.
    centre : "origin", "equilibrium" or array (n,)
        Where the sequence starts, and about which it is scaled.
    safe : SafeSet, Polytope or None
        F_max, to check whether the set is reached from it.
    engine : Engine, str or None
        As in `support`.
    max_steps : int
    tol : float or None
        As in `check_rpi`.

    Returns
    -------
    MinimalSet

    Raises
    ------
    TypeError, ValueError
        As `terminal_set`.

    See Also
    --------
    terminal_set : starts from F_max and needs no scaling.

    Examples
    --------
    >>> import mireach as mr
    >>> print(mr.scaled_minimal_set(mr.case_study("pwa").loop, mr.directions(8)))
    scaled minimal set: proven; (1 + epsilon) R27 is RPI
    """
    epsilon, max_steps = positive_number(epsilon, "epsilon"), whole_number(max_steps, "max_steps", 1)
    engine = engine_for(loop, engine)
    c = centre_point(loop, centre)
    V = template(loop, C)
    X = loop.system.state_set
    if not X.contains(c):
        raise ValueError(f"the sequence starts from {c.tolist()}, which lies outside X; give a centre in X")
    history = [Polytope.box(c, c)]
    found = None
    reason = f"max_steps = {max_steps} came first"
    h, weights = V @ c, own_units(loop).rows(V)[1]
    for k in range(1, max_steps + 1):
        after = support(loop, history[-1], V, engine=engine).bound
        require_bounds(after, engine)
        history.append(Polytope(V, after))
        candidate = scaled(history[-1], 1 + epsilon, c)
        if not history[-1].is_subset(X):
            reason = f"R{k} leaves the state set"
            break
        check = check_rpi(loop, candidate, engine, tol=tol)
        if check.verdict == Verdict.PROVEN:
            found, reason = candidate, f"(1 + epsilon) R{k} is RPI"
            break
        if (np.abs(after - h) * weights).max() <= CLEAR:
            reason = f"stagnation: R{k} = R{k - 1}, but scaled by 1 + epsilon it is not RPI: {check.reason}"
            break
        h = after
    reached_at = None
    if found is not None and safe is not None:
        reached_at = _steps_into(loop, safe, found, V, engine, tol, max_steps)
    verdict = Verdict.UNKNOWN if found is None else Verdict.PROVEN
    return MinimalSet(found, k, history, verdict, reached_at, reason)


def _steps_into(
    loop: ClosedLoop,
    safe: SafeSet | Polytope,
    target: Polytope,
    V: Array,
    engine: Engine,
    tol: float | None,
    max_steps: int,
) -> int | None:
    """First j with R_j-bar(F_max) in the target, or None."""
    F = set_to_start_from(safe)
    V = with_rows(V, F.H)
    require_rpi(loop, F, V, engine, tol)
    R, weights = F, own_units(loop).rows(V)[1]
    for j in range(max_steps + 1):
        if R.is_subset(target):
            return j
        found = support(loop, R, V, engine=engine)
        after = np.minimum(found.bound, R.bound(V))
        if found.rests_on == SOLVER and not compare(loop, R, V, after, engine, tol).holds.all():
            return None
        if j and ((R.h - after) * weights <= CLEAR).all():
            return None
        R = Polytope(V, after)
    return None
