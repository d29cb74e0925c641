"""Theorem 2: ultimate boundedness of a nonlinear loop, from sets of its piecewise-affine approximation."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..approximation.error_bound import prove_error
from ..checks import require_kind
from ..engines.base import Engine
from ..engines.inputs import violating_state
from ..results import Result, Verdict
from ..sets.polytope import Polytope
from ..systems.loop import ClosedLoop
from ..systems.nonlinear import NonlinearSystem
from .comparison import compare, weaker
from .safe_set import SafeSet
from .terminal_set import TerminalSet


@dataclass(frozen=True)
class UltimateBound(Result):
    """Result of `ultimately_bounded`: the verdict of Theorem 2, and each of its conditions.

    Attributes
    ----------
    verdict : Verdict
    conditions : dict of str to bool
    settled : str
        What the inclusions of R_1 rest on, as in `RPICheck`.
    """

    verdict: Verdict
    conditions: dict[str, bool]
    settled: str = ""

    def __str__(self) -> str:
        failing = [name for name, holds in self.conditions.items() if not holds]
        return f"ultimately bounded: {self.verdict}; " + (
            f"not shown: {', '.join(failing)}" if failing else "all conditions hold"
        )


def ultimately_bounded(
    plant: NonlinearSystem,
    loop: ClosedLoop,
    safe: SafeSet,
    terminal: TerminalSet,
    engine: Engine | str | None = None,
) -> UltimateBound:
    """Theorem 2: the nonlinear loop is ultimately bounded in the terminal set, uniformly in F_max.

    Parameters
    ----------
    plant : NonlinearSystem
    loop : ClosedLoop
        With a piecewise-affine approximation of the plant. Its disturbance sets must contain the approximation error.
    safe : SafeSet
    terminal : TerminalSet
    engine : Engine, str or None
        As in `support`. Every step of the sequence is checked again, so sets that belong to another loop are not
        accepted.

    Returns
    -------
    UltimateBound
        "proven" if f - f_PWA lies in D^(i) everywhere (by ball arithmetic), F_max is RPI and in X, and
        the terminal set is a C-set reached from it.

    Raises
    ------
    TypeError
        If an argument is of another kind.

    See Also
    --------
    fit_pwa : an approximation whose disturbance sets contain its error.

    Examples
    --------
    >>> import mireach as mr
    >>> case = mr.case_study("double_integrator")
    >>> safe = mr.safe_set(case.loop)
    >>> plant = case.plant
    >>> print(mr.ultimately_bounded(plant, case.loop, safe, mr.terminal_set(case.loop, safe)))
    ultimately bounded: proven; all conditions hold
    """
    require_kind(plant, NonlinearSystem, "plant")
    require_kind(safe, SafeSet, "safe")
    require_kind(terminal, TerminalSet, "terminal")
    X, U = loop.system.state_set, loop.system.input_set
    within = all(
        (prove_error(plant.f, [mode], X, U, mode.disturbance.H).bound[0] <= mode.disturbance.h).all()
        for mode in loop.system.modes
    )
    F_max = safe.set if safe.verdict == Verdict.PROVEN else None
    sets = [] if F_max is None else [F_max, *terminal.history[1:]]
    steps = [compare(loop, F, G.H, G.h, engine, cutoff=G.h) for F, G in zip([*sets[:1], *sets], sets)]
    conditions = {
        "f - f_PWA lies in D for every mode": bool(within),
        "Phi lies in the plant's U": U.is_subset(plant.input_set) or violating_state(loop, plant.input_set) is None,
        "F_max is RPI": bool(steps) and steps[0].holds.all() and sets[0].is_subset(X),
        "F_max lies in the plant's X": bool(sets) and sets[0].is_subset(plant.state_set),
        "the terminal set is reached from F_max": bool(sets)
        and _same(terminal.history[0], sets[0])
        and all(step.holds.all() for step in steps)
        and all(after.is_subset(before) for before, after in pairwise(sets)),
        "the terminal set has the origin inside": bool((terminal.set.h > 0).all()),
    }
    conditions = {name: bool(holds) for name, holds in conditions.items()}
    if not all(conditions.values()):
        return UltimateBound(Verdict.UNKNOWN, conditions)
    return UltimateBound(Verdict.PROVEN, conditions, weaker(*(step.settled for step in steps)))


def _same(P: Polytope, Q: Polytope) -> bool:
    """Whether two polytopes have the same rows."""
    return np.array_equal(P.H, Q.H) and np.array_equal(P.h, Q.h)
