"""Robustly positively invariant (RPI) sets, the safe set, the terminal set, Theorems 1 and 2 (Secs. III, IV)."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from tqdm.auto import tqdm

from .approximation import prove_error
from .checks import positive_number, real_array, require_kind, whole_number
from .engines.common import Witness
from .errors import SolverStopped
from .loop import ClosedLoop
from .polytope import Polytope, box_directions, directions
from .reach import RESOLUTION, default_engine, support
from .system import NonlinearSystem

ATTAINED = 1e-9  # a witness refutes a facet only by more than this, for rounding of the replayed trajectory


@dataclass(frozen=True, eq=False)
class RPICheck:
    """Answer of `check_rpi`.

    Attributes
    ----------
    verdict : "proven", "refuted" or "unknown"
    margin : array (l,)
        At most h - h of R_1(F) along H, from the proven bound; negative where a facet is not shown to hold.
        The MILP looks no further than is needed to prove a facet, so that its positive margins may be far
        smaller than the distance that there is; the cells give that.
    witness : Witness or None
        A step that leaves F, where the verdict is "refuted"; no step but the state alone, where F has states
        outside X.
    reason : str
    """

    verdict: str
    margin: np.ndarray
    witness: Witness | None
    reason: str


@dataclass(frozen=True, eq=False)
class SafeSet:
    """Answer of `safe_set`.

    Attributes
    ----------
    set : Polytope or None
        F_max; None if none was found.
    iterations : int
        k with F_max = F_k.
    history : list of Polytope
        F_0 = X, F_1, ...
    verdict : "proven", "refuted" or "unknown"
        "refuted": the sequence has come to a set that it cannot leave and that is not RPI, or to the
        empty set, so it finds none with this template.
    reason : str
    witness : Witness or None
        Where no set was found: a state of the last F_k, its input, mode and disturbance, whose image
        leaves X.
    """

    set: Polytope | None
    iterations: int
    history: list
    verdict: str
    reason: str
    witness: Witness | None


@dataclass(frozen=True, eq=False)
class TerminalSet:
    """Answer of `terminal_set`.

    Attributes
    ----------
    set : Polytope
        R_k-bar(F_max), RPI and reached from all of F_max within `steps` steps, whatever `criterion` says.
    steps : int
        The k of it.
    history : list of Polytope
        R_0-bar = F_max, R_1-bar, ..., `set`.
    criterion : bool
        Whether eq. TerminationFmin holds about `centre`: the set is then within 1 + `epsilon` of the limit.
    reason : str
        Why the sequence ended.
    epsilon : float
    centre : array (n,)
    alpha : float
        Largest alpha with alpha R_k-bar in R_(k-1)-bar, both seen from `centre` (eq. StabCondFmin);
        nan if the centre is not inside R_k-bar.
    delta_max : float
        Radius of the tube of Theorem 1's proof (units of x); nan with alpha.
    stable : bool
        Theorem 1's verdict at k = `steps`: alpha > 1.
    alphas : array (steps,)
        alpha at k = 1, ..., `steps`.
    """

    set: Polytope
    steps: int
    history: list
    criterion: bool
    reason: str
    epsilon: float
    centre: np.ndarray
    alpha: float
    delta_max: float
    stable: bool
    alphas: np.ndarray

    @property
    def stable_steps(self):
        """Those k >= 1 of the sequence at which Theorem 1 applies."""
        return [k for k, alpha in enumerate(self.alphas, start=1) if alpha > 1]


@dataclass(frozen=True, eq=False)
class MinimalSet:
    """Answer of `scaled_minimal_set`.

    Attributes
    ----------
    set : Polytope or None
        (1 + epsilon) R_k-bar(centre), if it is RPI for some k.
    steps : int
        The last k.
    history : list of Polytope
        R_0-bar(centre), ...
    verdict : "proven" or "unknown"
        Whether `set` is RPI.
    reached_at : int or None
        First j with R_j-bar(F_max) in `set`: it may serve as terminal set then. None if there is none
        (or no F_max was given).
    reason : str
    """

    set: Polytope | None
    steps: int
    history: list
    verdict: str
    reached_at: int | None
    reason: str


@dataclass(frozen=True)
class UltimateBound:
    """Answer of `ultimately_bounded`: Theorem 2's verdict, and each of its conditions.

    Attributes
    ----------
    verdict : "proven" or "unknown"
    conditions : dict of str to bool
    """

    verdict: str
    conditions: dict


def check_rpi(loop, F, engine=None, *, tol=None, **options):
    """Whether R_1(F) lies in F (Def. RPI), by h of R_1(F) along H <= h for every facet of F.

    Parameters
    ----------
    loop : ClosedLoop
    F : Polytope
    engine : str or None
        As in `support`.
    tol : float or None
        A facet holds if bound <= h + tol, in units of h. None is what the engine resolves
        (`reach.RESOLUTION`): 0 for the cells, whose bounds are rounded up already, and the accuracy of
        a MILP solver for the others. "proven" is to within this; the margins show what is used of it.
    **options
        Passed to the engine.

    Returns
    -------
    RPICheck
    """
    require_kind(loop, ClosedLoop, "loop")
    require_kind(F, Polytope, "F")
    X = loop.system.state_set
    engine = default_engine(loop) if engine is None else engine
    tol = _tolerance(engine, tol)
    if not F.is_subset(X, tol=ATTAINED):
        row = int(np.argmax(F.support(X.H) - X.h))
        return RPICheck(
            "refuted",
            np.full(len(F.h), -np.inf),
            _standing(loop, F.farthest(X.H[row])),
            f"F holds states outside the state set, beyond its row {row + 1}, where the loop has no successor",
        )
    try:
        found, stopped = _at_most(loop, F, F.H, F.h, engine, options), ""
    except SolverStopped as stop:
        found, stopped = stop.support, f"; {stop}"
    margin = F.h - found.bound
    if (margin >= -tol).all():
        within = "" if (margin >= 0).all() else f" to within {-margin.min():.1g}, which tol = {tol:g} allows"
        return RPICheck("proven", margin, None, f"R1(F) lies in F{within}")
    excess = found.value - F.h
    worst = int(np.argmax(excess))
    if excess[worst] > max(tol, ATTAINED):
        witness = found.witness[worst]
        return RPICheck("refuted", margin, witness, f"facet {worst + 1} is passed by {excess[worst]:.3g}: {witness}")
    worst = int(np.argmin(margin))
    gap = f"bound - h = {-margin[worst]:.3g}, attained - h = {excess[worst]:.3g}"
    return RPICheck("unknown", margin, None, f"facet {worst + 1} is not settled: {gap}{stopped}")


def safe_set(loop, C=None, engine=None, *, max_iterations=200, tol=None, progress=False, **options):
    """F_max of Prop. Fmax: iterate F_(k+1) = R_1-bar(F_k) & X from F_0 = X until R_1(F_k) lies in X (eq. Fk).

    Parameters
    ----------
    loop : ClosedLoop
    C : array (l, n) or None
        Template; None is 8 directions in the plane and (I, -I) otherwise. Rows of X that it lacks are
        added: the sets lie in X.
    engine : str or None
        As in `support`.
    max_iterations : int
    tol : float or None
        As in `check_rpi`.
    progress : bool
        Show a progress bar.
    **options
        Passed to the engine.

    Returns
    -------
    SafeSet

    Notes
    -----
    F_(k+1) is a subset of F_k, so R_1-bar(F_k) is one of F_k exactly when it is one of X. What remains
    of R_1(F_k) in F_k follows by monotonicity: F_k in F_(k-1) gives R_1(F_k) in R_1-bar(F_(k-1)).
    """
    max_iterations = whole_number(max_iterations, "max_iterations", 0)
    engine = default_engine(loop) if engine is None else engine
    tol, X = _tolerance(engine, tol), loop.system.state_set
    V = _with_rows(_template(loop, C), X.H)
    limit = _offsets(X, V)
    h, history, image = X.support(V), [X], None
    with tqdm(total=max_iterations, desc="safe set", disable=not progress) as bar:
        for k in range(max_iterations + 1):
            try:
                image = support(loop, history[-1], V, engine=engine, **_reused(engine, image), **options)
            except SolverStopped as stop:
                return SafeSet(None, k, history, "unknown", str(stop), None)
            worst = int(np.argmax(image.bound - limit))
            if image.bound[worst] <= limit[worst] + tol:
                return SafeSet(history[-1], k, history, "proven", f"R1(F{k}) lies in X, so F{k} is RPI", None)
            attained = image.value[worst] > limit[worst] + max(tol, ATTAINED)
            smaller = np.minimum(image.bound, h)
            following = Polytope(V, smaller)
            rests = (smaller >= h - tol).all()
            if rests or following.is_empty or k == max_iterations:
                break
            h, history = smaller, [*history, following]
            bar.update()
    witness = image.witness[worst]
    leaves = f"R1(F{k}) leaves X by {image.bound[worst] - limit[worst]:.3g}: {witness}"
    if rests:
        still = (smaller >= h).all()
        verdict = "refuted" if attained and still else "unknown"
        reason = f"F{k + 1} = F{k}{'' if still else f' to within {tol:g}'}, yet {leaves}"
    elif following.is_empty:
        verdict, reason = "refuted", f"F{k + 1} is empty: {leaves}"
    else:
        verdict, reason = "unknown", f"max_iterations = {max_iterations} came first; {leaves}"
    return SafeSet(None, k, history, verdict, reason, witness)


def terminal_set(
    loop,
    safe,
    C=None,
    epsilon=1e-3,
    centre="origin",
    engine=None,
    *,
    max_steps=1000,
    tol=None,
    progress=False,
    **options,
):
    """R_min-bar = R_k-bar(F_max) with the first k at which eq. TerminationFmin holds (eq. RminOver), and Theorem 1.

    Parameters
    ----------
    loop : ClosedLoop
    safe : SafeSet or Polytope
        F_max, or any set that `check_rpi` proves.
    C : array (l, n) or None
        As in `safe_set`. Rows of F_max that it lacks are added, so that R_1-bar(F_max) lies in F_max.
    epsilon : float
        Positive.
    centre : "origin", "equilibrium" or array (n,)
        About which eq. TerminationFmin scales. The paper's origin fails where the closed loop's
        equilibrium is another point: the sequence converges, but not towards the origin.
    engine, tol, progress, **options
        As in `safe_set`. Changes of at most `tol` count as stagnation.
    max_steps : int

    Returns
    -------
    TerminalSet

    Raises
    ------
    ValueError
        If `safe` holds no proven set or one of another loop, epsilon is not positive, or no equilibrium
        was found.
    SolverStopped
        If a limit stopped the solver.

    Notes
    -----
    With S = c + (R_k-bar - c) / (1 + epsilon), c in R_k-bar, S in R_1-bar(S) implies by monotonicity that
    S lies in R_j-bar(F_max) for all j, so the limit is within R_k-bar, and R_k-bar within
    c + (1 + epsilon) (limit - c). What S must lie in is taken from attained values, not from bounds.
    """
    F = _proven_set(loop, safe, engine, options)
    epsilon, max_steps = positive_number(epsilon, "epsilon"), whole_number(max_steps, "max_steps", 1)
    engine = default_engine(loop) if engine is None else engine
    tol = _tolerance(engine, tol)
    c = _centre(loop, centre)
    V = _with_rows(_template(loop, C), F.H)
    history, alphas = [F], []
    image = support(loop, F, V, engine=engine, **options)
    h, after = F.support(V), image.bound
    _require_own(after - h, tol)
    criterion = stagnant = False
    with tqdm(total=max_steps, desc="terminal set", disable=not progress) as bar:
        while not (criterion or stagnant) and len(alphas) < max_steps:
            smaller = np.minimum(after, h)
            R = Polytope(V, smaller)
            stagnant, still = (smaller >= h - tol).all(), (smaller >= h).all()
            reach = R.support(V)
            alphas.append(_growth(R, reach, h, c))
            h, history = smaller, [*history, R]
            image = support(loop, R, V, engine=engine, **_reused(engine, image), **options)
            after = image.bound
            criterion = _is_near_limit(loop, R, reach, after, V, epsilon, c, engine, options)
            bar.update()
    k = len(alphas)
    if criterion:
        reason = f"eq. TerminationFmin holds at k = {k}"
    elif stagnant:
        same = f"R{k} = R{k - 1}" if still else f"R{k} = R{k - 1} to within {tol:g}"
        reason = f"stagnation: {same}, but eq. TerminationFmin about {c.tolist()} fails"
        reason += ", and always will" if still else ""
        if isinstance(centre, str) and centre == "origin":
            reason += '; try centre="equilibrium"'
    else:
        reason = f"max_steps = {max_steps} came first"
    alpha, inner_radius = alphas[-1], ((np.minimum(reach, R.h) - V @ c) / np.linalg.norm(V, axis=1)).min()
    return TerminalSet(
        R,
        k,
        history,
        criterion,
        reason,
        epsilon,
        c,
        alpha,
        (alpha - 1) * inner_radius,
        bool(alpha > 1),
        np.array(alphas),
    )


def contraction(loop, R, centre="origin", engine=None, *, largest=2.0, accuracy=1e-9, **options):
    """Largest alpha found with R_1(c + alpha (R - c)) in R, all that the proof of Theorem 1 uses of alpha.

    Eq. StabCondFmin, alpha R_k-bar in R_(k-1)-bar, implies it. It can hold with alpha > 1 where some facets of
    the sequence have come to rest, so that eq. StabCondFmin holds with alpha = 1 only.

    Parameters
    ----------
    loop : ClosedLoop
    R : Polytope
        An RPI set, such as a terminal set.
    centre, engine, **options
        As in `terminal_set`.
    largest : float
        Where the search ends.
    accuracy : float
        Of the bisection, in units of alpha; what is returned is proven, up to the engine's own accuracy.

    Returns
    -------
    float
        Above 1 the set R is stable. 1 says that none above was found, not that R is RPI; nan if the centre
        is not inside R.
    """
    require_kind(R, Polytope, "R")
    largest, accuracy = positive_number(largest, "largest"), positive_number(accuracy, "accuracy")
    c, X = _centre(loop, centre), loop.system.state_set
    if (R.H @ c >= R.h).any():
        return np.nan

    def holds(alpha):
        grown = R.scale(alpha, c)
        return grown.is_subset(X) and (_at_most(loop, grown, R.H, R.h, engine, options).bound <= R.h).all()

    low, high = 1.0, largest
    while high - low > accuracy:
        middle = (low + high) / 2
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def scaled_minimal_set(
    loop, C=None, epsilon=1e-3, centre="origin", safe=None, engine=None, *, max_steps=1000, tol=None, **options
):
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
    engine, max_steps, tol, **options
        As in `terminal_set`.

    Returns
    -------
    MinimalSet

    Raises
    ------
    ValueError
        As `terminal_set`.
    """
    epsilon, max_steps = positive_number(epsilon, "epsilon"), whole_number(max_steps, "max_steps", 1)
    engine = default_engine(loop) if engine is None else engine
    resolution = max(_tolerance(engine, tol), ATTAINED)
    c, V, X = _centre(loop, centre), _template(loop, C), loop.system.state_set
    history, found, reason = [Polytope.box(c, c)], None, f"max_steps = {max_steps} came first"
    h = V @ c
    for k in range(1, max_steps + 1):
        after = support(loop, history[-1], V, engine=engine, **options).bound
        history.append(Polytope(V, after))
        candidate = history[-1].scale(1 + epsilon, c)
        if not history[-1].is_subset(X):
            reason = f"R{k} leaves the state set"
            break
        if candidate.is_subset(X) and check_rpi(loop, candidate, engine, tol=tol, **options).verdict == "proven":
            found, reason = candidate, f"(1 + epsilon) R{k} is RPI"
            break
        if np.abs(after - h).max() <= resolution:
            reason = f"stagnation: R{k} = R{k - 1}, but scaled by 1 + epsilon it is not RPI"
            break
        h = after
    reached_at = (
        None if found is None or safe is None else _steps_into(loop, safe, found, V, engine, max_steps, options)
    )
    return MinimalSet(found, k, history, "unknown" if found is None else "proven", reached_at, reason)


def ultimately_bounded(plant, loop, safe, terminal, engine=None, **options):
    """Theorem 2: the nonlinear loop is ultimately bounded in the terminal set, uniformly in F_max.

    Parameters
    ----------
    plant : NonlinearSystem
    loop : ClosedLoop
        With a piecewise-affine approximation of the plant, whose disturbance sets shall hold the error.
    safe : SafeSet
    terminal : TerminalSet
    engine, **options
        As in `support`: every step of the sequence is looked at again, so that sets of another loop prove nothing.

    Returns
    -------
    UltimateBound
        "proven" if f - f_PWA lies in D^(i) everywhere (by ball arithmetic), F_max is RPI and in X, and
        the terminal set is a C-set reached from it.
    """
    require_kind(plant, NonlinearSystem, "plant")
    require_kind(safe, SafeSet, "safe")
    require_kind(terminal, TerminalSet, "terminal")
    X, U = loop.system.state_set, loop.system.input_set
    within = all(
        (prove_error(plant.f, [mode], X, U, mode.disturbance.H).bound[0] <= mode.disturbance.h).all()
        for mode in loop.system.modes
    )
    conditions = {
        "f - f_PWA lies in D for every mode": bool(within),
        "F_max is RPI": safe.verdict == "proven" and _holds_images(loop, [safe.set, safe.set], engine, options),
        "F_max lies in the plant's X": safe.set is not None and safe.set.is_subset(plant.state_set, ATTAINED),
        "the terminal set is reached from F_max": safe.set is not None
        and terminal.history[0] is safe.set
        and _holds_images(loop, terminal.history, engine, options),
        "the terminal set has the origin inside": bool((terminal.set.h > 0).all()),
    }
    return UltimateBound("proven" if all(conditions.values()) else "unknown", conditions)


# -- parts --------------------------------------------------------------------------------------------


def _tolerance(engine, tol):
    """The tolerance of a comparison: what the engine resolves, or `tol`."""
    return RESOLUTION.get(engine, 0.0) if tol is None else float(real_array(tol, "tol", 0))


def _reused(engine, before):
    """What an engine is told: the support of the last, larger set, whose bounds, boxes or cells still serve."""
    return {"known": before} if engine in ("cells", "milp") and before is not None else {}


def _require_own(excess, tol):
    """Raise ValueError if R_1(F_max) leaves F_max by more than any engine's inaccuracy: F_max of another loop."""
    if excess.max() > max(tol, *RESOLUTION.values()):
        raise ValueError(f"the set to start from is not RPI for this loop: a step leaves it by {excess.max():.3g}")


def _holds_images(loop, sets, engine, options):
    """Whether R_1 of each set lies in the next, to within what engines differ by."""
    tol = max(RESOLUTION.values())
    return all((_at_most(loop, F, G.H, G.h, engine, options).bound <= G.h + tol).all() for F, G in pairwise(sets))


def _at_most(loop, F, V, limit, engine, options):
    """`support` where only "is it at most `limit`?" is asked: the MILP then settles most rows without an optimum."""
    only = {"cutoff": limit} if engine == "milp" or (engine is None and default_engine(loop) == "milp") else {}
    return support(loop, F, V, engine=engine, **only, **options)


def _standing(loop, x):
    """A trajectory of no steps at x; None if there is no x."""
    if x is None:
        return None
    n, m = loop.system.state_size, loop.system.input_size
    return Witness(x[None], np.zeros((0, m)), np.zeros(0, int), np.zeros((0, n)))


def _template(loop, C):
    """C as an array (l, n), or the default template."""
    require_kind(loop, ClosedLoop, "loop")
    n = loop.system.state_size
    if C is None:
        return directions(8) if n == 2 else box_directions(n)
    C = real_array(C, "C", 2) + 0.0
    if C.shape[1] != n:
        raise ValueError(f"C has {C.shape[1]} columns, but the state has {n} entries")
    if not (np.linalg.norm(C, axis=1) > 0).all():
        raise ValueError("C has a row of zeros, which is no direction")
    return C


def _with_rows(C, H):
    """C, and below it those rows of H that it lacks."""
    known = {row.tobytes() for row in C}
    return np.vstack([C, *(row[None] for row in H + 0.0 if row.tobytes() not in known)])


def _offsets(P, V):
    """The offsets of P along the rows of V; inf where V has a row that P has not."""
    known = {}
    for row, offset in zip(P.H + 0.0, P.h):  # a row may stand there twice
        known[row.tobytes()] = min(offset, known.get(row.tobytes(), np.inf))
    return np.array([known.get(row.tobytes(), np.inf) for row in V])


def _proven_set(loop, safe, engine, options):
    """The Polytope of a proven SafeSet, or one that `check_rpi` proves."""
    if isinstance(safe, SafeSet):
        if safe.verdict != "proven":
            raise ValueError(f"there is no safe set to start from: {safe.reason}")
        return safe.set
    require_kind(safe, (SafeSet, Polytope), "safe")
    if safe.is_empty:
        raise ValueError("the set to start from is empty")
    check = check_rpi(loop, safe, engine, **options)
    if check.verdict != "proven":
        raise ValueError(f"the set to start from is not shown to be RPI: {check.reason}")
    return safe


def _centre(loop, centre):
    """The centre as a point (n,)."""
    if isinstance(centre, str):
        if centre == "origin":
            return np.zeros(loop.system.state_size)
        if centre == "equilibrium":
            return loop.equilibrium()
        raise ValueError(f'centre must be "origin", "equilibrium" or a point; got {centre!r}')
    c = real_array(centre, "centre", 1)
    if len(c) != loop.system.state_size:
        raise ValueError(f"centre has {len(c)} entries, but the state has {loop.system.state_size}")
    return c


def _growth(R, reach, h_before, c):
    """Largest alpha with alpha (R - c) in R_before - c, where R_before has the rows of R and the offsets h_before.

    `reach` is h of R along its rows.
    """
    # R.h where the row is a facet: the support is rounded, and alpha = 1 + 1e-16 would be a false proof
    reach = np.minimum(reach + ATTAINED * np.linalg.norm(R.H, axis=1), R.h) - R.H @ c
    if (reach <= 0).any():
        return np.nan
    return float(((h_before - R.H @ c) / reach).min())


def _is_near_limit(loop, R, reach, after, V, epsilon, c, engine, options):
    """Eq. TerminationFmin about c: S = c + (R - c) / (1 + epsilon) lies in R_1-bar(S).

    `reach` is h of R along V, and `after` a bound on that of R_1(R).
    """
    if not R.contains(c):
        return False
    if ((reach + epsilon * (V @ c)) / (1 + epsilon) > after).any():  # S is not even in R_1-bar(R)
        return False
    S = R.scale(1 / (1 + epsilon), c)
    return bool((S.support(V) <= support(loop, S, V, engine=engine, **options).value).all())


def _steps_into(loop, safe, target, V, engine, max_steps, options):
    """First j with R_j-bar(F_max) in the target, or None."""
    F = _proven_set(loop, safe, engine, options)
    V = _with_rows(V, F.H)
    R = F
    for j in range(max_steps + 1):
        if R.is_subset(target):
            return j
        after = np.minimum(support(loop, R, V, engine=engine, **options).bound, R.support(V))
        if j and (after >= R.h - ATTAINED).all():
            return None
        R = Polytope(V, after)
    return None
