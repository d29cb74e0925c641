"""Robustly positively invariant (RPI) sets, the safe set, the terminal set, Theorems 1 and 2 (Secs. III, IV)."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from tqdm.auto import tqdm

from ..approximation.fit import prove_error
from ..arithmetic.rational import above, below, binary, dot, fractions, nearest, rational, strict_point
from ..arithmetic.scaling import normal_rows
from ..checks import positive_number, real_array, require_kind, whole_number
from ..engines import exact
from ..engines.base import SOLVER, Witness
from ..engines.inputs import violating_state
from ..engines.steps import Escape, attained, farthest_step
from ..engines.units import own_units
from ..sets.convex_set import ROUNDING
from ..sets.polytope import Polytope
from ..sets.templates import box_directions, directions
from ..systems.loop import ClosedLoop
from ..systems.pwa import NonlinearSystem
from .reach import default_engine, support
from .settle import CLEAR, EXACT, compare, standing, tolerance, weaker


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
        outside X. Its state and disturbance lie in their sets as the floats that they are, and the step passes
        the facet without rounding, unless F or D is so thin that no floats do.
    reason : str
    settled : str
        What the verdict rests on: "exact arithmetic", "rounding counted", or a tolerance in words.
    escape : Escape or None
        The step that leaves F in rational numbers, where the verdict is "refuted".
    """

    verdict: str
    margin: np.ndarray
    witness: Witness | None
    reason: str
    settled: str = ""
    escape: Escape | None = None


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
    settled : str
        As in `RPICheck`.
    """

    set: Polytope | None
    iterations: int
    history: list
    verdict: str
    reason: str
    witness: Witness | None
    settled: str = ""


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
        alpha at k = 1, ..., `steps`, rounded down.
    settled : str
        What it rests on that every set of the sequence is RPI and reached from F_max, as in `RPICheck`.
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
    settled: str = ""

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
    settled : str
        What the steps of the loop rest on, as in `RPICheck`.
    """

    verdict: str
    conditions: dict
    settled: str = ""


def check_rpi(loop, F, engine=None, *, tol=None, **options):
    """Whether R_1(F) lies in F (Def. RPI), by h of R_1(F) along H <= h for every facet of F.

    Parameters
    ----------
    loop : ClosedLoop
    F : Polytope
    engine : str or None
        As in `support`.
    tol : float or None
        A facet holds if bound <= h + tol, in units of h. None allows nothing for two states, where exact arithmetic
        decides what rounding leaves in doubt, and what a MILP solver resolves for more (1e-6 of the size of X).
    **options
        Passed to the engine.

    Returns
    -------
    RPICheck

    Raises
    ------
    ValueError
        If F is empty, Phi leaves U, or an argument does not fit.
    """
    require_kind(loop, ClosedLoop, "loop")
    require_kind(F, Polytope, "F")
    engine, tol = default_engine(loop) if engine is None else engine, tolerance(tol)
    if F.is_empty:
        raise ValueError("F is empty; there is nothing to check")
    outside = _outside(loop, F)
    if outside is not None:
        return outside
    options |= {"cutoff": F.h} if engine == "milp" else {}
    found = compare(loop, F, F.H, F.h, engine, tol, **options)
    escape = None if found.holds.all() else found.first_escape()
    if escape is None and not found.holds.all():
        found = compare(loop, F, F.H, F.h, engine, tol, thorough=True, **options)
    margin = F.h - found.bound
    if found.holds.all():
        within = "" if (margin >= 0).all() else f" to within {-margin.min():.1g}"
        return RPICheck("proven", margin, None, f"R1(F) lies in F{within}; {found.settled}", found.settled)
    if escape is not None:
        row, step, witness = escape
        excess = dot(binary(F.H[row]), rational(step.after)) - binary(F.h[row])
        reason = f"facet {row + 1} is passed by {nearest(excess):.3g}: {witness}{_hint(loop, F.H[row], excess)}"
        return RPICheck("refuted", margin, witness, reason, EXACT, step)
    worst = found.worst
    gap = f"bound - h = {-margin[worst]:.3g}, attained - h = {found.found.value[worst] - F.h[worst]:.3g}"
    return RPICheck("unknown", margin, None, f"facet {worst + 1} is not settled: {gap}{found.stopped}")


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
    V = _with_rows(_template(loop, C), loop.system.state_set.H)
    engine, tol, X = default_engine(loop) if engine is None else engine, tolerance(tol), loop.system.state_set
    limit, weights = X.offsets(V), own_units(loop).rows(V)[1]
    h, history, image, believed = X.bound(V), [X], None, False
    with tqdm(total=max_iterations, desc="safe set", disable=not progress) as bar:
        for k in range(max_iterations + 1):
            found = compare(loop, history[-1], V, limit, engine, tol, **_reused(engine, image), **options)
            if found.stopped:
                return SafeSet(None, k, history, "unknown", found.stopped.removeprefix("; "), None)
            if found.holds.all():
                if believed:  # F_k may be smaller than the image of F_(k-1): that it is RPI is settled for itself
                    found = compare(loop, history[-1], V, history[-1].offsets(V), engine, tol, **options)
                if not found.holds.all():
                    reason = f"R1(F{k}) lies in X, but not in F{k}: a bound that rests on {SOLVER} was wrong"
                    return SafeSet(None, k, history, "unknown", reason, None)
                reason = f"R1(F{k}) lies in X, so F{k} is RPI; {found.settled}"
                return SafeSet(history[-1], k, history, "proven", reason, None, found.settled)
            image, smaller = found.found, np.minimum(found.bound, h)
            believed |= image.rests_on == SOLVER
            following = Polytope(V, smaller)
            rests = (smaller >= h - (image.resolution if tol is None else tol)).all()
            if rests or following.is_empty or k == max_iterations:
                break
            h, history = smaller, [*history, following]
            bar.update()
    escape, worst = found.first_escape(), found.worst
    excess, witness = (found.bound - limit)[worst], image.witness[worst]
    if escape is not None:
        worst, step, witness = escape
        exact_excess = dot(binary(V[worst]), rational(step.after)) - binary(limit[worst])
        excess, hint = nearest(exact_excess), _hint(loop, V[worst], exact_excess)
    leaves = f"R1(F{k}) leaves X by {excess:.3g}: {witness}{hint if escape is not None else ''}"
    if rests:
        still = (smaller >= h).all()
        verdict = "refuted" if escape is not None and still else "unknown"
        within = "" if still else f" to within {((h - smaller) * weights).max():.1g} of the size of X"
        reason = f"F{k + 1} = F{k}{within}, yet {leaves}"
    elif following.is_empty:
        verdict, reason = "refuted", f"F{k + 1} is empty: {leaves}"
    else:
        verdict, reason = "unknown", f"max_iterations = {max_iterations} came first; {leaves}"
    return SafeSet(None, k, history, verdict, reason, witness, EXACT if verdict == "refuted" else "")


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
    F = _set_to_start_from(safe)
    epsilon, max_steps = positive_number(epsilon, "epsilon"), whole_number(max_steps, "max_steps", 1)
    engine, tol, c = default_engine(loop) if engine is None else engine, tolerance(tol), _centre(loop, centre)
    V = _with_rows(_template(loop, C), F.H)
    found = _require_rpi(loop, F, V, engine, tol, options)
    history, alphas, image, h, after = [F], [], found.found, F.bound(V), found.bound
    still = image.resolution if tol is None else tol
    criterion, stagnant, settled = False, False, found.settled
    with tqdm(total=max_steps, desc="terminal set", disable=not progress) as bar:
        while not (criterion or stagnant) and len(alphas) < max_steps:
            smaller = np.minimum(after, h)
            R = Polytope(V, smaller)
            stagnant, same = (smaller >= h - still).all(), (smaller >= h).all()
            reach = R.bound(V)
            alphas.append(_growth(V, reach, h, c))
            h, history, settled = smaller, [*history, R], weaker(settled, image.rests_on)
            image = support(loop, R, V, engine=engine, **_reused(engine, image), **options)
            after = image.bound
            criterion = _is_near_limit(loop, R, reach, after, V, epsilon, c, engine, options)
            bar.update()
    k = len(alphas)
    if criterion:
        reason = f"eq. TerminationFmin holds at k = {k}"
    elif stagnant:
        rest = f"R{k} = R{k - 1}{'' if same else ' to within what the engine resolves'}"
        reason = f"stagnation: {rest}, but eq. TerminationFmin about {c.tolist()} fails"
        reason += ", and always will" if same else ""
        if isinstance(centre, str) and centre == "origin":
            reason += '; try centre="equilibrium"'
    else:
        reason = f"max_steps = {max_steps} came first"
    alpha, inner_radius = alphas[-1], ((reach - V @ c) / np.linalg.norm(V, axis=1)).min()
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
        settled,
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
        grown = _scaled(R, alpha, c)
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
    c, V, X = _centre(loop, centre), _template(loop, C), loop.system.state_set
    if not X.contains(c):
        raise ValueError(f"the sequence starts from {c.tolist()}, which lies outside X; give a centre in X")
    history, found, reason = [Polytope.box(c, c)], None, f"max_steps = {max_steps} came first"
    h, weights = V @ c, own_units(loop).rows(V)[1]
    for k in range(1, max_steps + 1):
        after = support(loop, history[-1], V, engine=engine, **options).bound
        history.append(Polytope(V, after))
        candidate = _scaled(history[-1], 1 + epsilon, c)
        if not history[-1].is_subset(X):
            reason = f"R{k} leaves the state set"
            break
        check = check_rpi(loop, candidate, engine, tol=tol, **options)
        if check.verdict == "proven":
            found, reason = candidate, f"(1 + epsilon) R{k} is RPI"
            break
        if (np.abs(after - h) * weights).max() <= CLEAR:
            reason = f"stagnation: R{k} = R{k - 1}, but scaled by 1 + epsilon it is not RPI: {check.reason}"
            break
        h = after
    reached_at = (
        None if found is None or safe is None else _steps_into(loop, safe, found, V, engine, tol, max_steps, options)
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
    sets = [safe.set, *terminal.history[1:]] if safe.verdict == "proven" else []
    steps = [_images_within(loop, F, G, engine, options) for F, G in zip([*sets[:1], *sets], sets)]
    conditions = {
        "f - f_PWA lies in D for every mode": bool(within),
        "Phi lies in the plant's U": U.is_subset(plant.input_set) or violating_state(loop, plant.input_set) is None,
        "F_max is RPI": bool(steps) and steps[0].holds.all() and safe.set.is_subset(X),
        "F_max lies in the plant's X": bool(sets) and safe.set.is_subset(plant.state_set),
        "the terminal set is reached from F_max": bool(sets)
        and _same(terminal.history[0], safe.set)
        and all(step.holds.all() for step in steps)
        and all(after.is_subset(before) for before, after in pairwise(sets)),
        "the terminal set has the origin inside": bool((terminal.set.h > 0).all()),
    }
    conditions = {name: bool(holds) for name, holds in conditions.items()}
    verdict = "proven" if all(conditions.values()) else "unknown"
    return UltimateBound(verdict, conditions, weaker(*(step.settled for step in steps)) if verdict == "proven" else "")


# -- parts --------------------------------------------------------------------------------------------


def _reused(engine, before):
    """What an engine is told: the support of the last, larger set, whose bounds, boxes or cells still serve."""
    return {"known": before} if engine in ("cells", "milp") and before is not None else {}


def _outside(loop, F):
    """A refuted RPICheck if F has a state outside X, or None."""
    X = loop.system.state_set
    if F.is_subset(X):
        return None
    for row, (a, b) in enumerate(zip(X.H, X.h)):
        x = F.exact_maximum(a)
        if x.value > binary(b):
            state = x.point or strict_point(binary(F.H), binary(F.h), [tuple(-e for e in binary(a))], [-binary(b)])
            reason = (
                f"F holds states outside the state set, beyond its row {row + 1}, where the loop has no successor"
                f"{'' if x.point is None else _hint(loop, a, x.value - binary(b))}"
            )
            floats = np.array([nearest(entry) for entry in state])
            nothing = np.full(len(F.h), -np.inf)
            return RPICheck("refuted", nothing, standing(loop, floats), reason, EXACT, Escape(fractions(state)))
    return None


def _hint(loop, v, excess):
    """What to add to a message where a limit is passed by no more than the rounding of decimals to floats."""
    weight = own_units(loop).rows(np.asarray(v, float)[None])[1][0]
    if abs(nearest(excess)) * weight > CLEAR:
        return ""
    return "; this is as little as the rounding of a decimal: every number counts as the float that it is"


def _images_within(loop, F, G, engine, options):
    """The Comparison of R_1(F) with the rows of G."""
    limits = {"cutoff": G.h} if engine == "milp" or (engine is None and default_engine(loop) == "milp") else {}
    return compare(loop, F, G.H, G.h, engine, **limits, **options)


def _same(P, Q):
    """Whether two polytopes have the same rows."""
    return np.array_equal(P.H, Q.H) and np.array_equal(P.h, Q.h)


def _at_most(loop, F, V, limit, engine, options):
    """`support` where only "is it at most `limit`?" is asked: the MILP then settles most rows without an optimum."""
    only = {"cutoff": limit} if engine == "milp" or (engine is None and default_engine(loop) == "milp") else {}
    return support(loop, F, V, engine=engine, **only, **options)


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
    """C, and below it those rows of H that it lacks, up to powers of two."""
    known = {row.tobytes() for row in normal_rows(C)[0]}
    return np.vstack([C, *(row[None] for row, own in zip(H, normal_rows(H)[0]) if own.tobytes() not in known)])


def _set_to_start_from(safe):
    """The Polytope of a SafeSet, or the Polytope itself."""
    require_kind(safe, (SafeSet, Polytope), "safe")
    if isinstance(safe, SafeSet) and safe.verdict != "proven":
        raise ValueError(f"there is no safe set to start from: {safe.reason}")
    F = safe.set if isinstance(safe, SafeSet) else safe
    if F.is_empty:
        raise ValueError("the set to start from is empty")
    return F


def _require_rpi(loop, F, V, engine, tol, options):
    """The Comparison of R_1(F) with the rows of F among V; ValueError unless F lies in X and is RPI for this loop."""
    outside = _outside(loop, F)
    found = None if outside is not None else compare(loop, F, V, F.offsets(V), engine, tol, **options)
    if found is None or not found.holds.all():
        reason = outside.reason if found is None else check_rpi(loop, F, engine, tol=tol, **options).reason
        raise ValueError(f"the set to start from is not shown to be RPI for this loop: {reason}")
    return found


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


def _growth(V, reach, before, c):
    """Largest alpha with alpha (R - c) in R_before - c, rounded down, for sets with rows V; nan if c is not inside R.

    `reach` is the support function of R along V, and `before` has the offsets of R_before. Floats leave out the rows
    that cannot have the smallest ratio, their rounding counted; the others are compared in rational arithmetic.
    """
    middle, rounding = V @ c, _rounding(V, c, reach, before)
    top, bottom = before - middle, reach - middle
    rows = np.arange(len(V))
    if (bottom > 2 * rounding).all():
        least = (top - rounding) / np.where(top > rounding, bottom + rounding, bottom - rounding)
        most = (top + rounding) / np.where(top > -rounding, bottom - rounding, bottom + rounding)
        rows = np.flatnonzero(least - most.min() <= 8 * ROUNDING * (np.abs(least) + np.abs(most.min())))
    c, shares = binary(c), []
    for r in rows:
        value, inner = dot(binary(V[r]), c), binary(reach[r])
        if inner <= value:
            return np.nan
        shares.append((binary(before[r]) - value) / (inner - value))
    return below(min(shares))


def _rounding(V, c, h, other):
    """What floats round off at most in h - V c and in other - V c: array (k,)."""
    return (len(c) + 4) * ROUNDING * (np.abs(V) @ np.abs(c) + np.maximum(np.abs(h), np.abs(other)))


def _scaled(R, s, c):
    """c + s (R - c), its offsets rounded upward."""
    s, centre = binary(s), binary(c)
    offsets = [above(s * b + (1 - s) * dot(a, centre)) for a, b in zip(binary(R.H), binary(R.h))]
    return Polytope(R.H, offsets)


def _is_near_limit(loop, R, reach, after, V, epsilon, c, engine, options):
    """Eq. TerminationFmin about c: S = c + (R - c) / (1 + epsilon) lies in R_1-bar(S).

    `reach` and `after` are upper bounds on the support functions of R and of R_1(R) along V. What S must lie in is
    attained by steps in rational numbers.
    """
    middle = V @ c
    if (middle + (reach - middle) / (1 + epsilon) > after + 4 * _rounding(V, c, reach, after)).any():
        return False  # clearly, S is not even in R_1-bar(R)
    if not R.contains(c):
        return False
    S = _scaled(R, np.nextafter(1 / (1 + epsilon), 2), c)
    reach = S.bound(V)
    if (reach > after).any():  # S is not even in R_1-bar(R)
        return False
    found = support(loop, S, V, engine=engine, **options)
    return bool((reach <= found.value).all()) and all(
        _attains(loop, S, v, b, w) for v, b, w in zip(V, reach, found.witness)
    )


def _attains(loop, S, v, limit, witness):
    """Whether a step from S reaches the limit along v, without rounding."""
    value, limit = attained(loop, S, v, witness), binary(limit)
    if value is not None and value >= limit:
        return True
    step = farthest_step(loop, S, v, witness.states[0], int(witness.modes[0]))
    if step is None and loop.system.state_size == 2:
        step = exact.farthest_steps(loop, S, v[None])[0]
    return step is not None and step.value >= limit


def _steps_into(loop, safe, target, V, engine, tol, max_steps, options):
    """First j with R_j-bar(F_max) in the target, or None."""
    F = _set_to_start_from(safe)
    V = _with_rows(V, F.H)
    _require_rpi(loop, F, V, engine, tol, options)
    R, weights = F, own_units(loop).rows(V)[1]
    for j in range(max_steps + 1):
        if R.is_subset(target):
            return j
        after = np.minimum(support(loop, R, V, engine=engine, **options).bound, R.bound(V))
        if j and ((R.h - after) * weights <= CLEAR).all():
            return None
        R = Polytope(V, after)
    return None
