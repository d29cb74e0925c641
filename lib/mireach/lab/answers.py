"""What the library computes for one choice of settings: the sets and the trajectories of a disturbance lab."""

from dataclasses import dataclass
from functools import lru_cache
from time import perf_counter
from typing import Any, Literal

import numpy as np

from ..analysis.maximal_set import MaximalSafeSet, maximal_safe_set
from ..analysis.safe_set import SafeSet, safe_set
from ..analysis.terminal_set import TerminalSet, terminal_set
from ..checks import require_bools, require_kind
from ..sets.polytope import Polytope
from ..studies.case_analysis import SETTLING
from ..systems.loop import ClosedLoop
from ..systems.network import MaxoutNetwork
from ..systems.nonlinear import NonlinearSystem
from ..typing import Array
from .controls import Settings, Subject, Template, epsilon_of
from .views import View

TRAJECTORIES = 20
LONGEST = 50  # steps that are simulated at most
MAX_ITERATIONS = 300  # sets F_k; close to the largest disturbance the sequence takes ever longer
MAX_STEPS = 100  # sets R_k-bar; a sequence that has not come to its end by then is not followed on a page


@dataclass(frozen=True, eq=False)
class Look:
    """The answer to one choice of settings.

    Attributes
    ----------
    settings : dict
    loop : ClosedLoop
    safe : SafeSet
    terminal : TerminalSet or None
    remark : str
        Why there is no terminal set; else empty.
    nominal : array (steps + 1, n)
    disturbed : array (N, steps + 1, n)
    plant : array (steps + 1, n) or None
        The trajectory of the nonlinear plant, if there is one.
    regions : list of Polytope
        The mode regions, as far as they do not depend on u.
    view : View
        How states and sets are drawn.
    pending : bool
        Whether this is only a first answer: the terminal set was not asked for, and `sequence` has one set.
    seconds : float
        What the sets took when they were computed.

    See Also
    --------
    look
    """

    settings: Settings
    loop: ClosedLoop
    safe: SafeSet
    terminal: TerminalSet | None
    remark: str
    nominal: Array
    disturbed: Array
    plant: Array | None
    regions: list[Polytope]
    view: View
    pending: bool
    seconds: float

    def __str__(self) -> str:
        safe = f"F_max after {self.safe.iterations} iterations" if self.safe.set else "no F_max"
        end = f"{self.terminal.steps} steps to the last R_k" if self.terminal else f"no terminal set: {self.remark}"
        return f"amount {self.settings['amount']:g}: {safe}; {end}"

    @property
    def sequence(self) -> list[tuple[Literal["F", "R"], int, Polytope]]:
        """All sets in the order in which they were found: list of (name "F" or "R", k, Polytope).

        Only the last F_k if the look is pending: there may be hundreds, and each of them has to be drawn.
        """
        sets: list[tuple[Literal["F", "R"], int, Polytope]] = [("F", k, F) for k, F in enumerate(self.safe.history)]
        if self.pending:
            return sets[-1:]
        if self.terminal:
            sets += [("R", k, R) for k, R in enumerate(self.terminal.history) if k]
        return sets

    def to_dict(self) -> dict[str, Any]:
        """Settings, sets and verdicts, ready for JSON; numbers read back to the same floats."""
        safe, terminal = self.safe, self.terminal
        return {
            "settings": dict(self.settings),
            "safe_set": {
                "verdict": safe.verdict,
                "reason": safe.reason,
                "iterations": safe.iterations,
                "set": safe.set and safe.set.to_dict(),
                "history": [F.to_dict() for F in safe.history],
                "leaves": safe.witness and safe.witness.states.tolist(),
            },
            "terminal_set": terminal
            and {
                "steps": terminal.steps,
                "criterion": terminal.criterion,
                "reason": terminal.reason,
                "centre": terminal.centre.tolist(),
                "alpha": terminal.alpha if np.isfinite(terminal.alpha) else None,
                "set": terminal.set.to_dict(),
                "history": [R.to_dict() for R in terminal.history],
            },
        }


def look(subject: Subject, settings: Settings | None = None, *, terminal: bool = True) -> Look:
    """The sets and trajectories for one choice of settings.

    Parameters
    ----------
    subject : Subject
    settings : dict or None
        Control name -> value, as `Subject.settle` takes them; None stands for all defaults.
    terminal : bool
        False leaves out the terminal set, which takes longest for more than two states; the look is then `pending`.

    Returns
    -------
    Look

    Raises
    ------
    TypeError
        If `subject` is no Subject, or `settings` no dict.
    ValueError
        As `Subject.settle`.

    Examples
    --------
    >>> from mireach.lab import subject
    >>> look(subject("pwa"), {"amount": 0.1}).safe.verdict
    'proven'
    """
    require_kind(subject, Subject, "subject")
    require_bools(terminal=terminal)
    settings = subject.settle({} if settings is None else settings)
    base, loop, start = subject.base(settings), subject.loop(settings), subject.start(settings)
    template = subject.template("safe_directions", settings)
    safe, seconds = _safe(loop, template)
    found, remark = None, "there is no F_max to start from"
    if safe.set and not terminal:
        remark = "it was not asked for"
    elif safe.set:
        rule = (subject.template("directions", settings), epsilon_of(settings), settings["centre"])
        found, remark, more = _terminal(base, loop, template, *rule)
        seconds += more
    steps = min(found.steps + SETTLING, LONGEST) if found else LONGEST
    nominal, disturbed = _trajectories(base, loop, settings["amount"], start, steps, settings["seed"])
    return Look(
        settings=settings,
        loop=loop,
        safe=safe,
        terminal=found,
        remark=remark,
        nominal=nominal,
        disturbed=disturbed,
        plant=None if subject.plant is None else _plant_path(subject.plant, loop.network, start, steps),
        regions=_regions(base),
        view=subject.view(settings),
        pending=not terminal,
        seconds=seconds,
    )


def safe_set_at(subject: Subject, settings: Settings, amount: float) -> Polytope | None:
    """F_max if the disturbance had this amount; None if no safe set is found.

    Raises
    ------
    TypeError, ValueError
        As `Subject.settle`.

    See Also
    --------
    next_amount

    Examples
    --------
    >>> from mireach.lab import subject
    >>> safe_set_at(subject("pwa"), {}, 0.1).is_empty
    False
    >>> safe_set_at(subject("pwa"), {}, 2.0) is None
    True
    """
    settings = subject.settle({**settings, "amount": amount})
    return _safe(subject.loop(settings), subject.template("safe_directions", settings))[0].set


@lru_cache(maxsize=64)
def maximal_set(loop: ClosedLoop) -> MaximalSafeSet:
    """The maximal RPI set of a loop in floating point, without its proof.

    See Also
    --------
    mireach.maximal_safe_set, maximal_scene
    """
    return maximal_safe_set(loop, prove=False)


@lru_cache(maxsize=256)
def _safe(loop: ClosedLoop, template: Template) -> tuple[SafeSet, float]:
    """The safe set, and the seconds that it took."""
    begin = perf_counter()
    return safe_set(loop, template.rows, max_iterations=MAX_ITERATIONS), perf_counter() - begin


@lru_cache(maxsize=256)
def _terminal(
    base: ClosedLoop, loop: ClosedLoop, safe_template: Template, template: Template, epsilon: float, centre: str
) -> tuple[TerminalSet | None, str, float]:
    """The terminal set, or None and why; and the seconds that it took."""
    safe, begin = _safe(loop, safe_template)[0], perf_counter()
    point, remark = (centre, "") if centre == "origin" else _equilibrium(base)
    terminal = None
    if point is not None and not remark:
        terminal = terminal_set(loop, safe, template.rows, epsilon, point, max_steps=MAX_STEPS)
    return terminal, remark, perf_counter() - begin


@lru_cache(maxsize=256)
def _regions(base: ClosedLoop) -> list[Polytope]:
    """`state_regions`, which no disturbance changes; one list per base, so that a view draws each of them once."""
    return base.system.state_regions()


@lru_cache(maxsize=256)
def _equilibrium(loop: ClosedLoop) -> tuple[Array | None, str]:
    """The equilibrium, or None and why."""
    try:
        return loop.equilibrium(), ""
    except ValueError:
        return None, "this loop has no equilibrium that could be found; scale about the origin"


def _plant_path(plant: NonlinearSystem, network: MaxoutNetwork, start: Array, steps: int) -> Array:
    """The plant's trajectory up to its first state outside X: (k + 1, n)."""
    path = [start]
    while len(path) <= steps and plant.state_set.contains(path[-1]):
        path.append(plant.step(network, path[-1]))
    return np.array(path)


def _trajectories(
    base: ClosedLoop, loop: ClosedLoop, amount: float, start: Array, steps: int, seed: int
) -> tuple[Array, Array]:
    """The nominal trajectory (steps + 1, n) and disturbed ones (N, steps + 1, n), which follow D as it grows."""
    starts = np.tile(start, (TRAJECTORIES + 1, 1))
    if len({id(mode.disturbance) for mode in loop.system.modes}) > 1:
        return loop.simulate(start, steps), loop.simulate(starts[1:], steps, np.random.default_rng(seed))
    draws = amount * _draws(base.system.modes[0].disturbance, seed)
    paths = loop.simulate(starts, steps, np.concatenate([np.zeros_like(draws[:1, :steps]), draws[:, :steps]]))
    return paths[0], paths[1:]


@lru_cache(maxsize=256)
def _draws(D: Polytope, seed: int) -> Array:
    """Random disturbances of D (N, steps, n); those of the scaled set are multiples of them."""
    draws = D.sample(np.random.default_rng(seed), TRAJECTORIES * LONGEST).reshape(TRAJECTORIES, LONGEST, D.dimension)
    draws.setflags(write=False)
    return draws
