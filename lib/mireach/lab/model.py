"""The disturbance lab without its picture: what may be set, and what the library answers to it.

`subject` says what may vary of a case study, or of a planar loop of one's own; `look` computes the sets and the
trajectories for one choice of settings; `next_amount` finds, one set at a time, how much disturbance the loop stands.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from time import perf_counter

import numpy as np

from ..analysis.maximal_set import maximal_safe_set
from ..analysis.safe_set import SafeSet, safe_set
from ..analysis.terminal_set import TerminalSet, terminal_set
from ..checks import require_kind
from ..sets.polytope import Polytope
from ..sets.templates import directions
from ..studies.case_studies import CaseStudy, case_study, double_integrator_fit
from ..studies.seed_study import load_study
from ..systems.loop import ClosedLoop
from ..systems.nonlinear import NonlinearSystem

OWN = "own"  # name of a network that is not one of the seed study
SHAPES = {"box": "ball", "segment": "polytope"}  # name in the lab -> `error` of `fit_pwa`
TRAJECTORIES = 20
LONGEST = 50  # steps that are simulated at most
SETTLING = 10  # steps that trajectories run on after they have to be in the terminal set
MOST_ITERATIONS = 300  # sets F_k; close to the largest disturbance the sequence takes ever longer
MOST_STEPS = 100  # sets R_k-bar; a sequence that has not come to its end by then is not followed on a page
COARSE = 9  # amounts, evenly spread, that are tried before the bisection
ACCURACY = 1e-4  # of the largest disturbance, relative to the range of amounts


@dataclass(frozen=True)
class Control:
    """One thing that may be set.

    Attributes
    ----------
    name, label : str
    default : float or str
    low, high, step : float
        Range and grid of a number, which is a whole one where `step` is 1.
    slider : bool
        Whether a number has a slider beside its field.
    choices : dict of str to str
        Value -> label, for a choice; empty for a number.
    """

    name: str
    label: str
    default: float | str
    low: float = 0.0
    high: float = 0.0
    step: float = 0.0
    slider: bool = True
    choices: dict = field(default_factory=dict)

    def settle(self, value):
        """The nearest value that may be set: numbers are brought into the range, whole ones are rounded.

        Raises
        ------
        ValueError
            If the value is no finite number, or not among the choices.
        """
        if self.choices:
            if str(value) not in self.choices:
                raise ValueError(f"{self.name} must be one of {', '.join(self.choices)}; got {value!r:.80}")
            return str(value)
        try:
            number = float(value)
        except (TypeError, ValueError, OverflowError) as error:
            raise ValueError(f"{self.name} must be a number; got {value!r:.80}") from error
        if not np.isfinite(number):
            raise ValueError(f"{self.name} must be finite; got {value!r}")
        number = min(max(number, self.low), self.high)
        return round(number) if self.step == 1 else number


@dataclass(frozen=True, eq=False)
class Subject:
    """What a lab looks at.

    Attributes
    ----------
    name : str
    controls : tuple of Control
    base : callable
        settings -> ClosedLoop whose disturbance sets are those of amount 1; equal settings give the same object.
    source : callable
        settings -> list of str, lines of Python that make the base, called `loop`.
    plant : NonlinearSystem or None
        What the loop's system approximates.
    """

    name: str
    controls: tuple
    base: Callable
    source: Callable
    plant: NonlinearSystem | None = None

    def loop(self, settings):
        """The ClosedLoop that these settings describe."""
        return _scaled(self.base(settings), settings["amount"])

    def control(self, name):
        """The Control of this name; None if there is none."""
        return next((control for control in self.controls if control.name == name), None)

    def settle(self, settings):
        """Settings with every number in its range, and defaults for what is not given.

        Parameters
        ----------
        settings : dict
            Control name -> value.

        Raises
        ------
        ValueError
            If it is no dict, there is no such control, or a value is of the wrong kind.
        """
        require_kind(settings, dict, "settings")
        known = {control.name: control for control in self.controls}
        unknown = sorted(f"{name!s:.80}" for name in set(settings) - set(known))
        if unknown:
            raise ValueError(f"there is no control {', '.join(unknown)}; there are {', '.join(known)}")
        return {name: control.settle(settings.get(name, control.default)) for name, control in known.items()}


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
    nominal : array (steps + 1, 2)
    disturbed : array (N, steps + 1, 2)
    plant : array (steps + 1, 2) or None
        The trajectory of the nonlinear plant, if there is one.
    seconds : float
        What the sets took when they were computed.
    """

    settings: dict
    loop: ClosedLoop
    safe: SafeSet
    terminal: TerminalSet | None
    remark: str
    nominal: np.ndarray
    disturbed: np.ndarray
    plant: np.ndarray | None
    seconds: float

    @property
    def sequence(self):
        """All sets in the order in which they were found: list of (name "F" or "R", k, Polytope)."""
        found = [("F", k, F) for k, F in enumerate(self.safe.history)]
        return found + [("R", k, R) for k, R in enumerate(self.terminal.history) if k] if self.terminal else found

    def to_dict(self):
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


def scene(look):
    """What a page needs to draw a look, ready for JSON: points, and the facts in words.

    Returns
    -------
    dict
        "state", "regions", "safe", "terminal" and "sequence" by vertices, "nominal", "disturbed", "plant" and
        "witness" as lists of states, "centre" of the stopping rule, "verdict" in one sentence, and "facts" as a list
        of (name, value).
    """
    system, safe, terminal = look.loop.system, look.safe, look.terminal
    X, R = system.state_set, terminal and terminal.set
    return {
        "state": _corners(X),
        "regions": [_corners(region) for region in system.state_regions()],
        "sequence": [{"name": name, "k": k, "points": _corners(P)} for name, k, P in look.sequence],
        "safe": safe.set and _corners(safe.set),
        "terminal": R and _corners(R),
        "nominal": _path(look.nominal),
        "disturbed": [_path(path) for path in look.disturbed],
        "plant": None if look.plant is None else _path(look.plant),
        "witness": safe.witness and safe.witness.states.tolist(),
        "centre": terminal.centre.tolist() if terminal else [0.0] * X.dimension,
        "verdict": _verdict(look),
        "facts": _facts(look),
    }


def _verdict(look):
    """The sentence above the picture."""
    safe = look.safe
    if safe.set:
        return f"Proven safe: no disturbance leads out of F_max = F_{safe.iterations}"
    return f"No F_max was found: {safe.reason.split(':')[0]}"


def _facts(look):
    """What stands beside the picture: list of (name, value)."""
    safe, terminal, X = look.safe, look.terminal, look.loop.system.state_set
    largest = max(np.abs(mode.disturbance.vertices()).max() for mode in look.loop.system.modes)
    facts = [
        ("largest |d|∞", f"{largest:.4g}"),
        ("iterations of Fₖ", f"{safe.iterations} ({'F_max proven' if safe.set else 'no F_max'})"),
    ]
    if safe.set:
        area = safe.set.area
        facts.append(("area of F_max", f"{area:.4g} of {X.area:.4g} ({area / X.area:.0%} of X)"))
    elif safe.witness is not None:
        x, after = (np.round(state, 3).tolist() for state in safe.witness.states)
        facts.append(("leaves X", f"x = {x} → {after}, d = {np.round(safe.witness.disturbances[0], 4).tolist()}"))
    if terminal is None:
        return [*facts, ("terminal set", f"none: {look.remark}"), ("computed in", f"{1e3 * look.seconds:.0f} ms")]
    reason = terminal.reason.split(";")[0]
    if not terminal.criterion and terminal.steps == MOST_STEPS:
        reason = f"not settled after {MOST_STEPS} steps"
    return [
        *facts,
        ("steps to R_min" if terminal.criterion else "last Rₖ", f"k = {terminal.steps}: {reason}"),
        ("its area", f"{terminal.set.area:.4g}"),
        ("α of Theorem 1", _alpha(terminal)),
        ("computed in", f"{1e3 * look.seconds:.0f} ms"),
    ]


def _alpha(terminal):
    """alpha and what it means."""
    if np.isnan(terminal.alpha):
        return "none: the centre is not inside R_min"
    return (
        f"1 + {terminal.alpha - 1:.2g} (stable)"
        if terminal.stable
        else f"{terminal.alpha:.6g} (Theorem 1 says nothing)"
    )


def _corners(P):
    """Vertices as lists."""
    return P.vertices().tolist()


def _path(trajectory):
    """States as lists, up to the first that is not there."""
    return trajectory[np.isfinite(trajectory).all(axis=1)].tolist()


# -- asking -------------------------------------------------------------------------------------------


def look(subject, settings=None):
    """The sets and trajectories for one choice of settings.

    Parameters
    ----------
    subject : Subject
    settings : dict or None
        Control name -> value, as `Subject.settle` takes them; None stands for all defaults.

    Returns
    -------
    Look

    Raises
    ------
    ValueError
        As `Subject.settle`.
    """
    settings = subject.settle(settings or {})
    loop = subject.loop(settings)
    safe, seconds = _safe(loop, settings["safe_directions"])
    terminal, remark = None, "there is no F_max to start from"
    if safe.set:
        rule = (settings["directions"], epsilon_of(settings), settings["centre"])
        terminal, remark, more = _terminal(subject.base(settings), loop, settings["safe_directions"], *rule)
        seconds += more
    steps = min(terminal.steps + SETTLING, LONGEST) if terminal else LONGEST
    start = np.array([settings["x1"], settings["x2"]])
    nominal, disturbed = _trajectories(loop, start, steps, settings["seed"])
    return Look(
        settings=settings,
        loop=loop,
        safe=safe,
        terminal=terminal,
        remark=remark,
        nominal=nominal,
        disturbed=disturbed,
        plant=subject.plant and _plant_path(subject.plant, loop.network, start, steps),
        seconds=seconds,
    )


@lru_cache(maxsize=64)
def maximal_set(loop):
    """The maximal RPI set of a loop in floating point, without its proof: a MaximalSafeSet."""
    return maximal_safe_set(loop, prove=False)


def maximal_scene(maximal, X):
    """What a page needs to draw a MaximalSafeSet within X, ready for JSON: "rings" of corners, and "text"."""
    if maximal.set is None:
        text = "none: X holds no RPI set (in floating point)" if maximal.verdict == "refuted" else "not settled"
        return {"rings": [], "text": text}
    area = maximal.set.area
    text = f"{area:.4g} of {X.area:.4g} ({area / X.area:.0%} of X), in floating point, not proven"
    return {"rings": [ring.tolist() for ring in maximal.set.rings()], "text": text}


def script(subject, settings):
    """Lines of Python that compute `safe` and `terminal` of these settings without the lab.

    Raises
    ------
    ValueError
        As `Subject.settle`.
    """
    settings = subject.settle(settings)
    lines = [
        *subject.source(settings),
        "D = [mode.disturbance for mode in loop.system.modes]",
        f"loop = loop.with_disturbance([mr.Polytope(one.H, {settings['amount']} * one.h) for one in D])",
        f"safe = mr.safe_set(loop, mr.directions({settings['safe_directions']}), max_iterations={MOST_ITERATIONS})",
        "print(safe.verdict, safe.iterations, safe.reason)",
        "if safe.set:",
        f"    C, epsilon = mr.directions({settings['directions']}), {epsilon_of(settings)}",
        f"    terminal = mr.terminal_set(loop, safe, C, epsilon, {settings['centre']!r}, max_steps={MOST_STEPS})",
        "    print(terminal.steps, terminal.alpha, terminal.reason)",
    ]
    return "\n".join(lines) + "\n"


def safe_set_at(subject, settings, amount):
    """F_max if the disturbance had this amount (a Polytope); None if no safe set is found."""
    settings = subject.settle({**settings, "amount": amount})
    return _safe(subject.loop(settings), settings["safe_directions"])[0].set


def next_amount(known, low, high):
    """The amount to be tried next on the way to the largest one with a safe set.

    Parameters
    ----------
    known : dict of float to (Polytope or None)
        What `safe_set_at` said of the amounts tried so far.
    low, high : float
        The range of amounts.

    Returns
    -------
    float or None
        First an even grid, then bisection between the largest amount with a safe set and the next one without;
        None once they are within `ACCURACY` of the range, or if there is no safe set at all.

    Notes
    -----
    A template that fails at one amount may succeed at a larger one; what the bisection closes in on is the last
    change that the grid has shown.
    """
    for amount in np.linspace(low, high, COARSE).tolist():
        if amount not in known:
            return amount
    best = largest_amount(known)
    above = [amount for amount in known if best is not None and amount > best]
    if not above or min(above) - best <= ACCURACY * (high - low):
        return None
    return (best + min(above)) / 2


def largest_amount(known):
    """The largest amount for which a safe set is known; None if there is none."""
    return max((amount for amount, found in known.items() if found is not None), default=None)


def epsilon_of(settings):
    """The epsilon of eq. TerminationFmin, which is set by its logarithm, to three digits."""
    return float(f"{10 ** settings['log_epsilon']:.3g}")


@lru_cache(maxsize=256)
def _safe(loop, count):
    """The safe set, and the seconds that it took."""
    begin = perf_counter()
    return safe_set(loop, directions(count), max_iterations=MOST_ITERATIONS), perf_counter() - begin


@lru_cache(maxsize=256)
def _terminal(base, loop, safe_count, count, epsilon, centre):
    """The terminal set, or None and why; and the seconds that it took."""
    safe, begin = _safe(loop, safe_count)[0], perf_counter()
    point, remark = (centre, "") if centre == "origin" else _equilibrium(base)
    found = None if remark else terminal_set(loop, safe, directions(count), epsilon, point, max_steps=MOST_STEPS)
    return found, remark, perf_counter() - begin


@lru_cache(maxsize=256)
def _equilibrium(loop):
    """The equilibrium, or None and why."""
    try:
        return loop.equilibrium(), ""
    except ValueError:
        return None, "this loop has no equilibrium that could be found; scale about the origin"


def _plant_path(plant, network, start, steps):
    """The plant's trajectory up to its first state outside X: (k + 1, 2)."""
    path = [start]
    while len(path) <= steps and plant.state_set.contains(path[-1]):
        path.append(plant.step(network, path[-1]))
    return np.array(path)


def _trajectories(loop, start, steps, seed):
    """The nominal trajectory (steps + 1, 2) and disturbed ones (N, steps + 1, 2), which follow D as it grows."""
    rng, D = np.random.default_rng(seed), loop.system.modes[0].disturbance
    starts = np.tile(start, (TRAJECTORIES + 1, 1))
    if any(mode.disturbance is not D for mode in loop.system.modes):
        return loop.simulate(start, steps), loop.simulate(starts[1:], steps, rng)
    draws = D.sample(rng, TRAJECTORIES * LONGEST).reshape(TRAJECTORIES, LONGEST, 2)
    paths = loop.simulate(starts, steps, np.concatenate([np.zeros((1, steps, 2)), draws[:, :steps]]))
    return paths[0], paths[1:]


# -- subjects -----------------------------------------------------------------------------------------


def subject(case):
    """What a lab may vary of a case study or of a loop.

    Parameters
    ----------
    case : CaseStudy, str or ClosedLoop
        A case study or its name, or a loop with two states, whose disturbance sets are scaled.

    Returns
    -------
    Subject

    Raises
    ------
    ValueError
        If it is none of these, or the loop has not two states.
    """
    case = case_study(case) if isinstance(case, str) else case
    require_kind(case, (CaseStudy, ClosedLoop), "case")
    if isinstance(case, ClosedLoop):
        return _loop_subject(case)
    own = {"pwa": _pwa_subject, "double_integrator": _integrator_subject}
    return own[case.name](case) if case.name in own else _loop_subject(case.loop)


def _loop_subject(loop):
    X = loop.system.state_set
    if X.dimension != 2:
        raise ValueError(f"the lab draws the plane, but the loop has {X.dimension} states")
    start = (X.chebyshev()[0] + X.vertices()[0]) / 2
    return Subject(
        "loop",
        (Control("amount", "disturbance, times its set", 1.0, 0.0, 4.0, 0.01), *_controls(X, 16, start)),
        lambda settings: loop,
        lambda settings: ["import mireach as mr", "", "# loop is the one that the lab was given"],
    )


def _pwa_subject(case):
    networks, choice = _networks(case)
    amount = Control("amount", "disturbance bound |d|∞ ≤", case.disturbance_bound, 0.0, 2.0, 0.005)

    system = case.system.with_disturbance(Polytope.box([-1, -1], [1, 1]))

    def source(settings):
        unit = "mr.Polytope.box([-1, -1], [1, 1])"
        return [*_network_source("pwa", settings["network"]), f"loop = case.loop.with_disturbance({unit})"]

    return Subject(
        "pwa",
        (amount, choice, *_controls(case.system.state_set, 4, case.starts[0])),
        lambda settings: _loop(system, networks[settings["network"]]),
        source,
    )


def _integrator_subject(case):
    networks, choice = _networks(case)

    def source(settings):
        return [
            *_network_source("double_integrator", settings["network"]),
            f"fit = double_integrator_fit({settings['regions']}, error={SHAPES[settings['shape']]!r})",
            "loop = mr.ClosedLoop(fit.system(), case.network)",
        ]

    shapes = {"box": "box |d|∞ ≤ e", "segment": "segment along (1, 1)"}
    return Subject(
        "double_integrator",
        (
            Control("amount", "disturbance, times the proven error", 1.0, 0.0, 8.0, 0.01),
            Control("shape", "shape of the error set", "box", choices=shapes),
            Control("regions", "regions of the fit along each axis", 3, 1, 6, 1),
            choice,
            *_controls(case.system.state_set, 8, case.starts[0]),
        ),
        lambda settings: _loop(_fitted_system(settings["regions"], settings["shape"]), networks[settings["network"]]),
        source,
        case.plant,
    )


def _controls(X, safe_directions, start):
    """The controls that every subject has."""
    lower, upper = X.bounding_box()
    centres = {"origin": "the origin", "equilibrium": "the loop's equilibrium"}
    return (
        Control("safe_directions", "directions of Fₖ", safe_directions, 4, 32, 1),
        Control("directions", "directions of Rₖ", 8, 4, 32, 1),
        Control("log_epsilon", "stopping rule: log₁₀ ε", -3.0, -6.0, -1.0, 0.25),
        Control("centre", "stopping rule: scale about", "origin", choices=centres),
        Control("x1", "initial state x₁", float(start[0]), float(lower[0]), float(upper[0]), 0.05, slider=False),
        Control("x2", "initial state x₂", float(start[1]), float(lower[1]), float(upper[1]), 0.05, slider=False),
        Control("seed", "seed of the disturbance", 0, 0, 9999, 1, slider=False),
    )


def _networks(case):
    """Some networks of a case by name, from the seed study, and the control that chooses among them."""
    rows, trained = load_study(case.name)
    shipped, given = case_study(case.name).network.to_dict(), case.network.to_dict()
    by_loss = sorted(rows, key=lambda row: row.loss)
    proven = [row for row in by_loss if row.verdict == "proven"]
    remarks = {
        "shipped": [row for row in rows if trained[row.seed].to_dict() == shipped],
        "smallest loss": by_loss,
        "largest loss": by_loss[::-1],
        "slowest": sorted(proven, key=lambda row: -row.steps * row.criterion),
        "no end at the origin": [row for row in proven if not row.criterion],
        "no F_max": [row for row in by_loss if row.verdict != "proven"],
    }
    networks, choices = ({OWN: case.network}, {OWN: "the one given"}) if given != shipped else ({}, {})
    for remark, candidates in remarks.items():
        seed = next((row.seed for row in candidates if str(row.seed) not in networks), None)
        if seed is not None:
            networks[str(seed)], choices[str(seed)] = trained[seed], f"seed {seed}: {remark}"
    return networks, Control("network", "trained network", next(iter(choices)), choices=choices)


def _network_source(name, network):
    """Lines of Python that make `case` with a network of `_networks`."""
    lines = ["import mireach as mr"]
    if name == "double_integrator":
        lines.append("from mireach.studies.case_studies import double_integrator_fit")
    if network == OWN:
        lines += ["", "# network is that of the case study which the lab was given"]
    else:
        lines += [
            "from mireach.studies.seed_study import load_networks",
            "",
            f'network = load_networks("{name}")[{network}]',
        ]
    return [*lines, f'case = mr.case_study("{name}", network)']


@lru_cache(maxsize=256)
def _loop(system, network):
    """One loop for one pair."""
    return ClosedLoop(system, network)


@lru_cache(maxsize=16)
def _fit(regions):
    """The double integrator's fit on regions x regions boxes; its proof takes longest for many of them."""
    return double_integrator_fit(regions)


@lru_cache(maxsize=32)
def _fitted_system(regions, shape):
    return _fit(regions).with_error(SHAPES[shape]).system()


@lru_cache(maxsize=256)
def _scaled(loop, amount):
    """The loop with its disturbance sets scaled about the point 0; equal sets become one object."""
    sets = {}
    for mode in loop.system.modes:
        D = mode.disturbance
        sets.setdefault((D.H.tobytes(), D.h.tobytes()), Polytope(D.H, amount * D.h))
    D = [sets[mode.disturbance.H.tobytes(), mode.disturbance.h.tobytes()] for mode in loop.system.modes]
    return loop.with_disturbance(D)
