"""The terminal set R_min-bar (eq. (24), RminOver): where every trajectory from F_max ends, with alpha of Theorem 1."""

from dataclasses import dataclass

import numpy as np
from tqdm.auto import tqdm

from ..arithmetic.rational import binary
from ..checks import positive_number, require_bools, whole_number
from ..engines.base import Engine, Witness
from ..engines.registry import engine_for
from ..engines.steps import attained, farthest_step
from ..results import Result
from ..sets.polytope import Polytope
from ..systems.loop import ClosedLoop
from ..typing import Array, ArrayLike
from .arguments import Centre, centre_point, template, tolerance, with_rows
from .comparison import highest_step, is_attained, weaker
from .contraction import growth, rounding, scaled
from .reach import support
from .rpi import require_rpi
from .safe_set import SafeSet, set_to_start_from


@dataclass(frozen=True, eq=False)
class TerminalSet(Result):
    """Result of `terminal_set`.

    Attributes
    ----------
    set : Polytope
        R_k-bar(F_max). It is RPI and reached from all of F_max within `steps` steps, even if `criterion` is False.
    steps : int
        The k of `set`.
    history : list of Polytope
        R_0-bar = F_max, R_1-bar, ..., `set`.
    criterion : bool
        Whether eq. (25), TerminationFmin, holds about `centre`. Then the set lies in the limit scaled by 1 + `epsilon`.
    reason : str
        Why the sequence ended.
    epsilon : float
    centre : array (n,)
    alpha : float
        Largest alpha with alpha R_k-bar in R_(k-1)-bar, both relative to `centre` (eq. (26), StabCondFmin);
        nan if the centre is not inside R_k-bar.
    delta_max : float
        Radius of the tube of Theorem 1's proof (units of x); nan with alpha.
    stable : bool
        Theorem 1's verdict at k = `steps`: alpha > 1.
    alphas : array (steps,)
        alpha at k = 1, ..., `steps`, rounded down.
    settled : str
        What the statement that every set of the sequence is RPI and reached from F_max rests on, as in `RPICheck`.
    """

    set: Polytope
    steps: int
    history: list[Polytope]
    criterion: bool
    reason: str
    epsilon: float
    centre: Array
    alpha: float
    delta_max: float
    stable: bool
    alphas: Array
    settled: str = ""

    def __str__(self) -> str:
        return f"terminal set: R{self.steps} of {len(self.alphas)} steps; {self.reason}; alpha = {self.alpha:.8g}"

    @property
    def stable_steps(self) -> list[int]:
        """Those k >= 1 of the sequence at which Theorem 1 applies."""
        return [k for k, alpha in enumerate(self.alphas, start=1) if alpha > 1]


def terminal_set(
    loop: ClosedLoop,
    safe: SafeSet | Polytope,
    C: ArrayLike | None = None,
    epsilon: float = 1e-3,
    centre: Centre = "origin",
    engine: Engine | str | None = None,
    *,
    max_steps: int = 1000,
    tol: float | None = None,
    progress: bool = False,
) -> TerminalSet:
    """R_min-bar = R_k-bar(F_max) of eq. (24), RminOver, with the first k at which eq. (25), TerminationFmin, holds.

    It also gives alpha of Theorem 1.

    Parameters
    ----------
    loop : ClosedLoop
    safe : SafeSet or Polytope
        F_max, or any set that `check_rpi` proves.
    C : array (l, n) or None
        As in `safe_set`. Rows of F_max that it does not contain are added, so that R_1-bar(F_max) lies in F_max.
    epsilon : float
        Positive.
    centre : "origin", "equilibrium" or array (n,)
        Centre of the scaling in eq. (25), TerminationFmin. With the origin, as in the paper, the rule may fail if the
        equilibrium of the closed loop is another point: the sequence converges, but not towards the origin.
    engine : Engine, str or None
        As in `support`.
    max_steps : int
    tol : float or None
        As in `check_rpi`. Changes of at most `tol` count as stagnation.
    progress : bool
        Show a progress bar.

    Returns
    -------
    TerminalSet

    Raises
    ------
    TypeError
        If an argument is of another kind.
    ValueError
        If `safe` contains no proven set, or the set of another loop, epsilon is not positive, or no equilibrium was
        found.
    SolverStopped
        If a limit stopped the solver.

    See Also
    --------
    contraction : alpha from the set alone; it may be larger.
    ultimately_bounded : Theorem 2.

    Examples
    --------
    >>> import mireach as mr
    >>> loop = mr.case_study("pwa").loop
    >>> terminal = mr.terminal_set(loop, mr.safe_set(loop, mr.directions(8)), mr.directions(8))
    >>> print(terminal)
    terminal set: R43 of 43 steps; eq. (25), TerminationFmin, holds at k = 43; alpha = 1.0000202

    Notes
    -----
    With S = c + (R_k-bar - c) / (1 + epsilon), c in R_k-bar, S in R_1-bar(S) implies by monotonicity that S lies in
    R_j-bar(F_max) for all j. So the limit lies in R_k-bar, and R_k-bar lies in c + (1 + epsilon) (limit - c). The
    offsets of R_1-bar(S) are attained values here, not upper bounds.
    """
    require_bools(progress=progress)
    F = set_to_start_from(safe)
    epsilon, max_steps = positive_number(epsilon, "epsilon"), whole_number(max_steps, "max_steps", 1)
    engine, tol = engine_for(loop, engine), tolerance(tol)
    c = centre_point(loop, centre)
    V = with_rows(template(loop, C), F.H)
    found = require_rpi(loop, F, V, engine, tol)
    image = found.image
    after = found.bound
    settled = found.settled
    h, history = F.bound(V), [F]
    alphas: list[float] = []
    still = image.resolution if tol is None else tol  # smaller changes count as none
    criterion = stagnant = False
    with tqdm(total=max_steps, desc="terminal set", disable=not progress) as bar:
        while not (criterion or stagnant) and len(alphas) < max_steps:
            smaller = np.minimum(after, h)
            R = Polytope(V, smaller)
            stagnant, same = (smaller >= h - still).all(), (smaller >= h).all()
            constant = same and is_attained(loop, image, V, h)
            reach = R.bound(V)
            alphas.append(growth(V, reach, h, c))
            settled = weaker(settled, image.rests_on)
            h, history = smaller, [*history, R]
            image = support(loop, R, V, engine=engine, warm_start=image)
            after = image.bound
            criterion = _is_near_limit(loop, R, reach, after, V, epsilon, c, engine)
            bar.update()
    k = len(alphas)
    if criterion:
        reason = f"eq. (25), TerminationFmin, holds at k = {k}"
    elif stagnant:
        reason = _stagnation(k, c, bool(same), bool(constant), isinstance(centre, str) and centre == "origin")
    else:
        reason = f"max_steps = {max_steps} came first"
    alpha = alphas[-1]
    inner_radius = ((reach - V @ c) / np.linalg.norm(V, axis=1)).min()
    return TerminalSet(
        set=R,
        steps=k,
        history=history,
        criterion=criterion,
        reason=reason,
        epsilon=epsilon,
        centre=c,
        alpha=alpha,
        delta_max=(alpha - 1) * inner_radius,
        stable=bool(alpha > 1),
        alphas=np.array(alphas),
        settled=settled,
    )


def _stagnation(k: int, c: Array, same: bool, constant: bool, about_origin: bool) -> str:
    """Why the iteration ended at R_k = R_(k-1), although the criterion about c fails."""
    rest = f"R{k} = R{k - 1}{'' if same else ' to within what the engine resolves'}"
    reason = f"stagnation: {rest}, but eq. (25), TerminationFmin, about {c.tolist()} fails"
    reason += ", and always will" if constant else ""
    return reason + '; try centre="equilibrium"' if about_origin else reason


def _is_near_limit(
    loop: ClosedLoop,
    R: Polytope,
    reach: Array,
    after: Array,
    V: Array,
    epsilon: float,
    c: Array,
    engine: Engine,
) -> bool:
    """Eq. (25), TerminationFmin, about c: S = c + (R - c) / (1 + epsilon) lies in R_1-bar(S).

    `reach` and `after` are upper bounds on the support functions of R and of R_1(R) along V. The offsets of R_1-bar(S)
    must be attained by steps in rational numbers.
    """
    middle = V @ c
    if (middle + (reach - middle) / (1 + epsilon) > after + 4 * rounding(V, c, reach, after)).any():
        return False  # clearly, S is not even in R_1-bar(R)
    if not R.contains(c):
        return False
    S = scaled(R, float(np.nextafter(1 / (1 + epsilon), 2)), c)
    reach = S.bound(V)
    if (reach > after).any():  # S is not even in R_1-bar(R)
        return False
    found = support(loop, S, V, engine=engine)
    return bool((reach <= found.value).all()) and all(
        _attains(loop, S, v, b, w) for v, b, w in zip(V, reach, found.witness)
    )


def _attains(loop: ClosedLoop, S: Polytope, v: Array, limit: float, witness: Witness | None) -> bool:
    """Whether a step from S reaches the limit along v, without rounding."""
    if witness is None:
        return False
    value, exact_limit = attained(loop, S, v, witness), binary(limit)
    if value is not None and value >= exact_limit:
        return True
    step = farthest_step(loop, S, v, witness.states[0], int(witness.modes[0]))
    if step is None:
        step = highest_step(loop, S, v)
    return bool(step is not None and step.value >= exact_limit)
