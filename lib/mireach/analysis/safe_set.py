"""The safe set F_max (Prop. 3, Fmax): the RPI set in X that the iteration with a template finds."""

from dataclasses import dataclass

import numpy as np
from tqdm.auto import tqdm

from ..arithmetic.rational import nearest
from ..checks import require_kind, whole_number
from ..engines.base import EXACT, SOLVER, Engine, Support, Witness
from ..engines.registry import engine_for
from ..engines.units import own_units
from ..results import Result, Verdict
from ..sets.polytope import Polytope
from ..systems.loop import ClosedLoop
from ..typing import ArrayLike
from .arguments import template, tolerance, with_rows
from .comparison import compare
from .reach import cut_support
from .rpi import decimal_hint, exact_excess


@dataclass(frozen=True, eq=False)
class SafeSet(Result):
    """Result of `safe_set`.

    Attributes
    ----------
    set : Polytope or None
        F_max; None if none was found.
    iterations : int
        The k with F_max = F_k.
    history : list of Polytope
        F_0 = X, F_1, ...
    verdict : Verdict
        "refuted": the sequence has stopped at a set that is not RPI, or at the empty set, so it finds no safe set with
        this template.
    reason : str
    witness : Witness or None
        If no set was found: a state of the last F_k with its input, mode and disturbance, whose successor lies outside
        X.
    settled : str
        As in `RPICheck`.
    """

    set: Polytope | None
    iterations: int
    history: list[Polytope]
    verdict: Verdict
    reason: str
    witness: Witness | None
    settled: str = ""

    def __str__(self) -> str:
        return f"safe set: {self.verdict}; {self.reason}"


def safe_set(
    loop: ClosedLoop,
    C: ArrayLike | None = None,
    engine: Engine | str | None = None,
    *,
    max_iterations: int = 200,
    tol: float | None = None,
    cut_first: bool = False,
    progress: bool = False,
) -> SafeSet:
    """F_max of Prop. 3, Fmax: iterate F_(k+1) = R_1-bar(F_k) & X from F_0 = X until R_1(F_k) lies in X (eq. (21), Fk).

    Parameters
    ----------
    loop : ClosedLoop
    C : array (l, n) or None
        Template; None is 8 directions in the plane and (I, -I) otherwise. Rows of X that it does not contain are added,
        so that the sets lie in X.
    engine : Engine, str or None
        As in `support`.
    max_iterations : int
    tol : float or None
        As in `check_rpi`.
    cut_first : bool
        Intersect with X before the template covers the image, not after it: F_(k+1) = F_k & (the smallest set of the
        template around R_1(F_k) & X). Often fewer iterations, and a set where eq. (21), Fk, finds none. Not the
        paper's F_max. For engines with `Engine.cut_support`, i.e. the cells.
    progress : bool
        Show a progress bar.

    Returns
    -------
    SafeSet

    Raises
    ------
    TypeError
        If an argument is of another kind.
    ValueError
        If Phi leaves U, an argument does not fit, or the engine cannot cut first.

    See Also
    --------
    terminal_set : the set that is reached from F_max.
    maximal_safe_set : the exact maximal RPI set in the plane, without a template.

    Examples
    --------
    >>> import mireach as mr
    >>> print(mr.safe_set(mr.case_study("pwa").loop, mr.directions(8)))
    safe set: proven; R1(F1) lies in X, so F1 is RPI; rounding counted

    Notes
    -----
    The stopping rule R_1(F_k) in X implies that F_k is RPI. F_k = R_1-bar(F_(k-1)) & X. Since F_k lies in F_(k-1),
    R_1(F_k) lies in R_1-bar(F_(k-1)) by monotonicity. If it also lies in X, it lies in F_k.

    With `cut_first`, R_1(F_k) in X gives R_1(F_k) in R_1(F_j) & X for all j < k, since F_k in F_j. Each of
    these sets lies in its cover, and F_k is the intersection of the covers and X: F_k is RPI. "proven" does not rest on
    this: R_1(F_k) in F_k is checked by itself. For the same k, F_k lies in that of eq. (21), Fk, so the iteration
    with `cut_first` ends no later.
    """
    max_iterations = whole_number(max_iterations, "max_iterations", 0)
    V = with_rows(template(loop, C), loop.system.state_set.H)
    engine, tol, X = engine_for(loop, engine), tolerance(tol), loop.system.state_set
    limit, weights = X.offsets(V), own_units(loop).rows(V)[1]
    h, history = X.bound(V), [X]
    image: Support | None = None
    if cut_first and not engine.cuts(loop):
        raise ValueError(f'the engine "{engine.name}" cannot cut first; use engine="cells", for two states')
    believed = cut_first  # whether R_1(F_k) in F_k is settled for itself: a bound may be a solver's, or one within X
    with tqdm(total=max_iterations, desc="safe set", disable=not progress) as bar:
        for k in range(max_iterations + 1):
            found = compare(loop, history[-1], V, limit, engine, tol, warm_start=image)
            if found.stopped:
                return SafeSet(None, k, history, Verdict.UNKNOWN, found.stopped.removeprefix("; "), None)
            if found.holds.all():
                if believed:  # F_k may be smaller than the image of F_(k-1), so whether it is RPI is decided separately
                    found = compare(loop, history[-1], V, history[-1].offsets(V), engine, tol)
                if not found.holds.all():
                    rests = found.found.rests_on
                    reason = f"R1(F{k}) lies in X, but not in F{k}: a bound of {engine.name} was wrong ({rests})"
                    return SafeSet(None, k, history, Verdict.UNKNOWN, reason, None)
                reason = f"R1(F{k}) lies in X, so F{k} is RPI; {found.settled}"
                return SafeSet(history[-1], k, history, Verdict.PROVEN, reason, None, found.settled)
            image, smaller = found.found, np.minimum(found.bound, h)
            if cut_first:
                smaller = np.minimum(cut_support(loop, history[-1], V, engine), h)
            believed |= image.rests_on == SOLVER
            following = None if (smaller == -np.inf).any() else Polytope(V, smaller)
            empty = following is None or following.is_empty
            rests = (smaller >= h - (image.resolution if tol is None else tol)).all()
            if following is None or rests or empty or k == max_iterations:
                break
            h, history = smaller, [*history, following]
            bar.update()
    escape, worst = found.first_escape(), found.worst
    excess, witness = (found.bound - limit)[worst], found.found.witness[worst]
    if escape is not None:
        worst, witness = escape
        passed = exact_excess(witness, V[worst], limit[worst])
        excess, hint = nearest(passed), decimal_hint(loop, V[worst], passed)
    leaves = f"R1(F{k}) leaves X by {excess:.3g}: {witness}{hint if escape is not None else ''}"
    if rests:
        still = (smaller >= h).all()
        verdict = Verdict.REFUTED if escape is not None and still else Verdict.UNKNOWN
        within = "" if still else f" to within {((h - smaller) * weights).max():.1g} of the size of X"
        reason = f"F{k + 1} = F{k}{within}, yet {leaves}"
    elif empty:
        verdict, reason = Verdict.REFUTED, f"F{k + 1} is empty: {leaves}"
    else:
        verdict, reason = Verdict.UNKNOWN, f"max_iterations = {max_iterations} came first; {leaves}"
    return SafeSet(None, k, history, verdict, reason, witness, EXACT if verdict == Verdict.REFUTED else "")


def set_to_start_from(safe: SafeSet | Polytope) -> Polytope:
    """The Polytope of a SafeSet, or the Polytope itself."""
    require_kind(safe, (SafeSet, Polytope), "safe")
    if isinstance(safe, SafeSet) and safe.verdict != Verdict.PROVEN:
        raise ValueError(f"there is no safe set to start from: {safe.reason}")
    F = safe.set if isinstance(safe, SafeSet) else safe
    if F is None or F.is_empty:
        raise ValueError("the set to start from is empty")
    return F
