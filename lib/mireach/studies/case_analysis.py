"""The analysis of one case study: all sets, theorems and trajectories of the report."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from time import perf_counter
from typing import Any

import numpy as np
from tqdm.auto import tqdm

from ..analysis.boundedness import UltimateBound, ultimately_bounded
from ..analysis.contraction import contraction
from ..analysis.maximal_set import MaximalSafeSet, maximal_safe_set
from ..analysis.minimal_set import MinimalSet, scaled_minimal_set
from ..analysis.reach import outer_reach, support
from ..analysis.rpi import check_rpi
from ..analysis.safe_set import SafeSet, safe_set
from ..analysis.terminal_set import TerminalSet, terminal_set
from ..arithmetic.rational import fractions
from ..certificate.writer import Certificate, make
from ..checks import require_bools, require_kind
from ..engines import exact
from ..sets.polytope import Polytope
from ..systems.loop import ClosedLoop
from ..typing import Array
from .case_studies import CaseStudy

SETTLING = 10  # steps that trajectories run on after they have to be in the terminal set
INSIDE = 1e-9  # simulated states count as inside a set to within this, for rounding (units of x)
TRAJECTORIES = 200


@dataclass(frozen=True, eq=False)
class Trajectories:
    """The trajectories of a case's figures, and the reachable sets around one of them.

    Attributes
    ----------
    tubes : list of arrays (N, steps + 1, n)
        With disturbance (of the plant, where there is one), one array per initial state or draw.
    nominal : array (k, steps + 1, n)
        Of the nominal loop (of the plant, where there is one) from the paper's initial states.
    reach : list of Polytope
        R_i-bar of the first of those states, i = 0, ..., k-bar.
    """

    tubes: list[Array]
    nominal: Array
    reach: list[Polytope]

    def __str__(self) -> str:
        return f"{sum(map(len, self.tubes))} disturbed and {len(self.nominal)} nominal trajectories"


@dataclass(frozen=True, eq=False)
class Analysis:
    """Everything that is computed for one case study.

    Attributes
    ----------
    case : CaseStudy
    safe : SafeSet
    terminal : TerminalSet
        About the origin, as in the paper.
    centred : TerminalSet or None
        About the closed loop's equilibrium; None if it has none.
    minimal : MinimalSet
    maximal : MaximalSafeSet or None
        For two states alone.
    certificate : Certificate
        Of F_max, the terminal set about the origin, and the theorems.
    exactly : dict of str to bool
        Of every set, whether its claim is proven in exact arithmetic.
    exact_supports : dict of str to list of Fraction
        h of R_1(F_max) and of R_1 of the terminal set along `case.directions`, without rounding.
    trajectories : Trajectories
    contraction : float
        Largest alpha with R_1(alpha R_min-bar) in R_min-bar.
    bounded : UltimateBound or None
        Theorem 2, where there is a nonlinear plant.
    cross_check : dict
        Of the cells against the MILP.
    seconds : dict of str to float
        Of each stage.
    """

    case: CaseStudy
    safe: SafeSet
    terminal: TerminalSet
    centred: TerminalSet | None
    minimal: MinimalSet
    maximal: MaximalSafeSet | None
    certificate: Certificate
    exactly: dict[str, bool]
    exact_supports: dict[str, list[Fraction]]
    trajectories: Trajectories
    contraction: float
    bounded: UltimateBound | None
    cross_check: dict[str, Any]
    seconds: dict[str, float]

    def __str__(self) -> str:
        safe, terminal = self.safe, self.terminal
        return (
            f"case {self.case.name}: F_max after {safe.iterations} iterations ({safe.verdict}), "
            f"terminal set after {terminal.steps} steps, alpha = {terminal.alpha:.9g}"
        )

    @property
    def F_max(self) -> Polytope:
        """The safe set as a polytope; a case without one is not analysed."""
        assert self.safe.set is not None
        return self.safe.set

    def count_trajectories(self) -> dict[str, int]:
        """How many simulated trajectories stay in F_max, and are in the terminal set from k-bar on."""
        paths = np.concatenate(self.trajectories.tubes)
        safe, terminal = self.F_max, self.terminal
        return {
            "simulated": len(paths),
            "inside_safe_set": int(safe.contains(paths, INSIDE).all(axis=1).sum()),
            "entered_terminal_set": int(terminal.set.contains(paths[:, terminal.steps :], INSIDE).all(axis=1).sum()),
        }


def analyse(
    case: CaseStudy, engine: Any = None, cross_check: str | None = "milp", *, progress: bool = False
) -> Analysis:
    """All sets, theorems and trajectories of one case study.

    Parameters
    ----------
    case : CaseStudy
    engine : str or None
        As in `support`.
    cross_check : str or None
        Another engine that computes supports of X, F_max, the terminal set and single states again; None leaves it
        out.
    progress : bool
        Show progress bars.

    Returns
    -------
    Analysis

    Raises
    ------
    TypeError
        If `case` is no CaseStudy.
    ValueError
        If the case has no safe set.
    """
    require_kind(case, CaseStudy, "case")
    require_bools(progress=progress)
    seconds: dict[str, float] = {}
    loop = case.loop
    with _timed(seconds, "safe_set"):
        safe = safe_set(loop, case.safe_directions, engine, progress=progress)
    if safe.set is None:
        raise ValueError(f"case {case.name} has no safe set: {safe.reason}")
    with _timed(seconds, "terminal_set"):
        terminal = terminal_set(loop, safe, case.directions, case.epsilon, engine=engine, progress=progress)
    with _timed(seconds, "terminal_set_about_equilibrium"):
        centred = _about_equilibrium(case, safe, engine)
    with _timed(seconds, "scaled_minimal_set"):
        minimal = scaled_minimal_set(loop, case.directions, case.epsilon, safe=safe, engine=engine)
    maximal = None
    if case.system.state_size == 2:
        with _timed(seconds, "maximal_safe_set"):
            maximal = maximal_safe_set(loop)
    with _timed(seconds, "certificate"):
        certificate = make(loop, safe, terminal, plant=case.plant)
    with _timed(seconds, "trajectories"):
        trajectories = _trajectories(case, safe.set, terminal.steps, engine)
    with _timed(seconds, "exact_proofs"):
        exactly = _proven_by_certificate(certificate)
        exactly |= _proven_exactly(loop, centred, minimal, maximal, trajectories.reach)
        exact_supports = {
            "safe_set": _exact_supports(case, safe.set),
            "terminal_set": _exact_supports(case, terminal.set),
        }
    with _timed(seconds, "contraction"):
        growth = contraction(loop, terminal.set, terminal.centre, engine)
    bounded = None
    if case.plant is not None:
        with _timed(seconds, "theorem_2"):
            bounded = ultimately_bounded(case.plant, loop, safe, terminal)
    check: dict[str, Any] = {}
    if cross_check is not None:
        with _timed(seconds, "cross_check"):
            check = _cross_check(case, (safe.set, terminal.set), engine, cross_check, progress)
    return Analysis(
        case=case,
        safe=safe,
        terminal=terminal,
        centred=centred,
        minimal=minimal,
        maximal=maximal,
        certificate=certificate,
        exactly=exactly,
        exact_supports=exact_supports,
        trajectories=trajectories,
        contraction=growth,
        bounded=bounded,
        cross_check=check,
        seconds=seconds,
    )


@contextmanager
def _timed(seconds: dict[str, float], name: str) -> Iterator[None]:
    """Note how long the block took."""
    begin = perf_counter()
    yield
    seconds[name] = perf_counter() - begin


def _about_equilibrium(case: CaseStudy, safe: SafeSet, engine: Any) -> TerminalSet | None:
    """The terminal set about the equilibrium; None if the loop has none."""
    try:
        centre = case.loop.equilibrium()
    except ValueError:
        return None
    return terminal_set(case.loop, safe, case.directions, case.epsilon, centre, engine)


def _trajectories(case: CaseStudy, F_max: Polytope, steps: int, engine: Any) -> Trajectories:
    """Trajectories from the paper's states and from F_max, `SETTLING` steps longer than the terminal set needs."""
    rng, longer = np.random.default_rng(0), steps + SETTLING
    if case.plant is not None:
        tubes = [case.plant.simulate(case.network, F_max.sample(rng, TRAJECTORIES), longer)]
        nominal = case.plant.simulate(case.network, case.starts, longer)
    else:
        each = TRAJECTORIES // len(case.starts)
        tubes = [case.loop.simulate(np.tile(start, (each, 1)), longer, rng) for start in case.starts]
        nominal = case.loop.simulate(case.starts, longer)
    point = Polytope(case.directions, case.directions @ case.starts[0])
    return Trajectories(tubes, nominal, outer_reach(case.loop, point, case.directions, steps, engine))


def _proven_by_certificate(certificate: Certificate) -> dict[str, bool]:
    """Of the sets of a certificate by name, whether the checker proves their claims."""
    claims = {"F_max": "safe_set", "R_1 to R_k": "sequence", "terminal set": "terminal_set"}
    return {name: certificate.report[claim].verdict == "proven" for name, claim in claims.items()}


def _proven_exactly(
    loop: ClosedLoop,
    centred: TerminalSet | None,
    minimal: MinimalSet,
    maximal: MaximalSafeSet | None,
    reach: list[Polytope],
) -> dict[str, bool]:
    """Of the sets by name, whether their claims are proven in exact arithmetic; without those of a certificate."""

    def holds_images(sets: list[Polytope]) -> bool:
        return all((support(loop, F, G.H, engine="exact").bound <= G.h).all() for F, G in pairwise(sets))

    proven = {}
    if centred is not None:
        proven["terminal set about the equilibrium"] = holds_images([*centred.history, centred.set])
    if minimal.set is not None:
        proven["scaled minimal set"] = holds_images([minimal.set, minimal.set])
    if maximal is not None:
        proven["maximal safe set"] = maximal.verdict == "proven"
    proven["reachable sets of the first state"] = holds_images(reach)
    return proven


def _exact_supports(case: CaseStudy, F: Polytope) -> list[Fraction]:
    """h of R_1(F) along the rows of the case's template, without rounding."""
    steps = exact.support_steps(case.loop, F, case.directions)
    assert steps is not None  # an invariant set of a case is not empty
    return [*fractions(step.value for step in steps)]


def _cross_check(
    case: CaseStudy, invariant: tuple[Polytope, Polytope], engine: Any, other: str, progress: bool
) -> dict[str, Any]:
    """Supports of one step by two engines over X, F_max, the terminal set and single states."""
    origin = np.zeros(case.system.state_size)
    points = [Polytope.box(x, x) for x in (*case.starts, origin)]
    sets = [case.system.state_set, *invariant, *points]
    values = []
    bounds = []
    safe_side = True
    for F in tqdm(sets, desc=f"cross-check by {other}", unit="set", disable=not progress):
        here = support(case.loop, F, case.directions, engine=engine)
        there = support(case.loop, F, case.directions, engine=other)
        values.append(np.abs(here.value - there.value))
        bounds.append(np.abs(here.bound - there.bound))
        safe_side &= bool((there.bound >= here.value).all())
    safe, terminal = (check_rpi(case.loop, F, other).verdict for F in invariant)
    return {
        "engine": other,
        "supports_compared": len(sets) * len(case.directions),
        "largest_difference": float(np.max(values)),
        "largest_difference_of_bounds": float(np.max(bounds)),
        "bounds_on_the_safe_side": safe_side,
        "safe_set_rpi": safe,
        "terminal_set_rpi": terminal,
    }
