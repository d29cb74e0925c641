"""The safe set F_max (Prop. 3, Fmax): the RPI set in X that the iteration with a template finds."""

from dataclasses import dataclass

import numpy as np
from tqdm.auto import tqdm

from ..arithmetic.rational import nearest
from ..checks import require_bools, require_kind, whole_number
from ..engines.base import EXACT, SOLVER, Engine, Support, Witness
from ..engines.registry import engine_for
from ..results import Result, Verdict
from ..sets.polytope import Polytope
from ..systems.loop import ClosedLoop
from ..typing import Array, ArrayLike
from .arguments import template, tolerance, with_rows
from .comparison import Comparison, believed, compare, is_attained
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
    require_bools(cut_first=cut_first, progress=progress)
    max_iterations = whole_number(max_iterations, "max_iterations", 0)
    V = with_rows(template(loop, C), loop.system.state_set.H)
    engine = engine_for(loop, engine)
    tol = tolerance(tol)
    X = loop.system.state_set
    limit = X.offsets(V)
    h, history = X.bound(V), [X]
    image: Support | None = None
    if cut_first and not engine.cuts:
        raise ValueError(f'the engine "{engine.name}" cannot cut first; use engine="cells"')
    trusted = True  # whether no set of the sequence rests on a solver's word
    with tqdm(total=max_iterations, desc="safe set", disable=not progress) as bar:
        for k in range(max_iterations + 1):
            found = compare(loop, history[-1], V, limit, engine, tol, warm_start=image)
            if found.stopped:
                return _unknown(history, found.stopped.removeprefix("; "))
            if found.is_believed_only:
                return _unknown(history, f"R1(F{k}) lies in X by bounds that prove nothing: {believed(engine)}")
            if found.holds.all():
                return _safe(found, history, V, engine, tol, cut_first or not trusted)
            image, smaller = found.image, np.minimum(found.bound, h)
            if cut_first:
                smaller = np.minimum(cut_support(loop, history[-1], V, engine), h)
            trusted &= image.rests_on != SOLVER
            following = None if (smaller == -np.inf).any() else Polytope(V, smaller)
            empty = following is None or following.is_empty
            stagnant = (smaller >= h - (image.resolution if tol is None else tol)).all()
            if following is None or empty or stagnant or k == max_iterations:
                break
            h, history = smaller, [*history, following]
            bar.update()
    leaves, witness, escapes = _leaves(found, k, engine)
    if stagnant:
        ends, rest = _stagnation(found, h, smaller, k)
        refuted, reason = ends and escapes, f"{rest}, yet {leaves}"
    elif empty:
        refuted, reason = trusted, f"F{k + 1} is empty{'' if trusted else f' by {SOLVER}'}: {leaves}"
    else:
        refuted, reason = False, f"max_iterations = {max_iterations} came first; {leaves}"
    verdict, settled = (Verdict.REFUTED, EXACT) if refuted else (Verdict.UNKNOWN, "")
    return SafeSet(None, k, history, verdict, reason, witness, settled)


def _unknown(history: list[Polytope], reason: str) -> SafeSet:
    """A SafeSet without a set, with the reason why the question is open."""
    return SafeSet(None, len(history) - 1, history, Verdict.UNKNOWN, reason, None)


def _safe(
    found: Comparison, history: list[Polytope], V: Array, engine: Engine, tol: float | None, again: bool
) -> SafeSet:
    """The SafeSet of the last set of a sequence, whose image lies in X by `found`.

    `again` says that this set may be smaller than the image of the set before, as its bounds are a solver's or of a
    part in X: whether it is RPI is then decided separately.
    """
    k, F = len(history) - 1, history[-1]
    if again:
        found = compare(found.loop, F, V, F.offsets(V), engine, tol)
    if found.is_believed_only:
        return _unknown(history, f"R1(F{k}) lies in F{k} by bounds that prove nothing: {believed(engine)}")
    if not found.holds.all():
        rests = found.image.rests_on
        reason = f"R1(F{k}) lies in X, but not in F{k}: a bound of {engine.name} was wrong ({rests})"
        return _unknown(history, reason)
    reason = f"R1(F{k}) lies in X, so F{k} is RPI; {found.settled}"
    return SafeSet(F, k, history, Verdict.PROVEN, reason, None, found.settled)


def _leaves(found: Comparison, k: int, engine: Engine) -> tuple[str, Witness | None, bool]:
    """How R_1(F_k) leaves X, in words; the trajectory that shows it; and whether it does so in exact arithmetic."""
    escape = found.first_escape()
    V = found.V
    limit = found.limit
    if escape is not None:
        worst, witness = escape
        passed = exact_excess(witness, V[worst], limit[worst])
        hint = decimal_hint(found.loop, V[worst], passed)
        return f"R1(F{k}) leaves X by {nearest(passed):.3g}: {witness}{hint}", witness, True
    worst = found.worst
    if found.bound[worst] == np.inf:
        return f"the engine {engine.name} has no bound of R1(F{k}) along row {worst + 1} of the template", None, False
    seen = found.image.witness[worst]
    return f"R1(F{k}) leaves X by {(found.bound - limit)[worst]:.3g}: {seen}", seen, False


def _stagnation(found: Comparison, h: Array, smaller: Array, k: int) -> tuple[bool, str]:
    """Whether F_(k+1) = F_k shows that no later set of eq. (21), Fk, is smaller; and the equality in words.

    `h` and `smaller` are the offsets of F_k and of F_(k+1). If the image attains the offsets of F_k in all directions,
    F_k lies in R_1-bar(F_k) & X. By monotonicity it then lies in all sets of the sequence, even if bounds of earlier
    sets were loose or wrong, and a step that leads from F_k out of X refutes all of them.
    """
    if not (smaller >= h).all():
        apart = ((h - smaller) * found.weights).max()
        return False, f"F{k + 1} = F{k} to within {apart:.1g} of the size of X"
    if not is_attained(found.loop, found.image, found.V, h):
        return False, f"F{k + 1} = F{k} by bounds that may be loose, as no values attain them"
    return True, f"F{k + 1} = F{k}"


def set_to_start_from(safe: SafeSet | Polytope) -> Polytope:
    """The Polytope of a SafeSet, or the Polytope itself."""
    require_kind(safe, (SafeSet, Polytope), "safe")
    if isinstance(safe, SafeSet) and safe.verdict != Verdict.PROVEN:
        raise ValueError(f"there is no safe set to start from: {safe.reason}")
    F = safe.set if isinstance(safe, SafeSet) else safe
    if F is None or F.is_empty:
        raise ValueError("the set to start from is empty")
    return F
