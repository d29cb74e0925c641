"""The subjects of a disturbance lab: what may vary of a case study, or of a loop of one's own."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from ..approximation.fit import PWAFit
from ..checks import require_kind
from ..sets.polytope import Polytope
from ..sets.templates import directions
from ..studies.case_studies import AmountSlider, CaseStudy, case_definition, case_study, data_file
from ..studies.seed_study import load_study
from ..systems.loop import ClosedLoop
from ..systems.network import MaxoutNetwork
from ..systems.pwa import PWASystem
from ..typing import Array
from .controls import Control, Settings, Subject, Template
from .views import coordinate, view_choices

OWN, SHIPPED = "own", "shipped"  # names of networks that are not of a seed study: one's own, that of the case
CASE = "case"  # name of the template that a case study defines
ERRORS = {"box": "ball", "segment": "polytope"}  # shape of the error set in the lab -> `error` of `fit_pwa`


def subject(case: Any) -> Subject:
    """What a lab may vary of a case study or of a loop.

    Parameters
    ----------
    case : CaseStudy, str or ClosedLoop
        A case study or its name, or a loop with two or more states, whose disturbance sets are scaled. For three and
        more states the lab draws projections or sections.

    Returns
    -------
    Subject

    Raises
    ------
    TypeError
        If it is none of these.
    ValueError
        If there is no such case, or the loop has only one state.

    Examples
    --------
    >>> subject("pwa").amount.default
    0.15
    """
    case = case_study(case) if isinstance(case, str) else case
    require_kind(case, (CaseStudy, ClosedLoop), "case")
    if isinstance(case, ClosedLoop):
        return _loop_subject(case)
    slider = case.definition.slider
    if slider is None:
        return _loop_subject(case.loop)
    return _bounded_subject(case, slider) if case.fit is None else _fitted_subject(case, slider)


def _loop_subject(loop: ClosedLoop) -> Subject:
    """A loop whose disturbance sets are scaled."""
    X = loop.system.state_set
    if X.dimension < 2:
        raise ValueError("the lab draws two states against each other, but the loop has only 1 state; give it another")
    slider = AmountSlider("disturbance, times its set", 1.0, 4.0, 0.01)
    templates = _counts(16, 8) if X.dimension == 2 else _spread_choices(X.dimension)
    return Subject(
        "loop",
        (_amount(slider), *templates, *_common_controls(X, (X.chebyshev()[0] + X.vertices()[0]) / 2)),
        lambda settings: loop,
        lambda settings: ["import mireach as mr", "", "# loop is the one that the lab was given"],
        lambda name, value: _spread(int(value), X.dimension),
        X.dimension,
    )


def _bounded_subject(case: CaseStudy, slider: AmountSlider) -> Subject:
    """A case whose system is piecewise affine: the amount is the bound on |d|_inf."""
    trained = _networks(case)
    lower, upper = [-1] * case.system.state_size, [1] * case.system.state_size
    system = case.system.with_disturbance(Polytope.box(lower, upper))

    def source(settings: Settings) -> list[str]:
        unit = f"mr.Polytope.box({lower}, {upper})"
        return [*_network_source(case.name, trained.name(settings)), f"loop = case.loop.with_disturbance({unit})"]

    return Subject(
        case.name,
        (_amount(slider, slider.unit), *trained.controls, *_case_controls(case, slider.unit)),
        lambda settings: _loop(system, trained.networks[trained.name(settings)]),
        source,
        _case_templates(case),
        case.system.state_size,
        slider.unit,
    )


def _fitted_subject(case: CaseStudy, slider: AmountSlider) -> Subject:
    """A case whose system is a fit: the amount scales the proven error sets, whose shape and number may be set."""
    trained = _networks(case)
    fit = case.definition.fit
    assert fit is not None  # `case.fit` was made by it

    def base(settings: Settings) -> ClosedLoop:
        system = _fitted_system(case.name, settings["regions"], settings["shape"])
        return _loop(system, trained.networks[trained.name(settings)])

    def source(settings: Settings) -> list[str]:
        return [
            *_network_source(
                case.name, trained.name(settings), imports=[f"from {fit.__module__} import {fit.__name__}"]
            ),
            f"fit = {fit.__name__}({settings['regions']}, error={ERRORS[settings['shape']]!r})",
            "loop = mr.ClosedLoop(fit.system(), case.network)",
        ]

    shapes = {"box": "box |d|∞ ≤ e", "segment": "segment along (1, 1)"}
    controls = (
        _amount(slider),
        Control("shape", "shape of the error set", "box", choices=shapes),
        Control("regions", "regions of the fit along each axis", 3, 1, 6, 1),
        *trained.controls,
        *_case_controls(case, slider.unit),
    )
    return Subject(
        case.name, controls, base, source, _case_templates(case), case.system.state_size, slider.unit, case.plant
    )


def _amount(slider: AmountSlider, unit: str = "") -> Control:
    return Control("amount", slider.label, slider.default, 0.0, slider.high, slider.step, unit=unit)


def _case_controls(case: CaseStudy, unit: str) -> tuple[Control, ...]:
    n, X = case.system.state_size, case.system.state_set
    safe, other = len(case.safe_directions), len(case.directions)
    templates = _counts(safe, 8) if n == 2 else _spread_choices(n, (safe, other))
    return (*templates, *_common_controls(X, case.starts[0], unit))


def _common_controls(X: Polytope, start: Array, unit: str = "") -> tuple[Control, ...]:
    """The controls that every subject has; for more than two states also that of the view, and sliders of the state."""
    n, centres = X.dimension, {"origin": "the origin", "equilibrium": "the loop's equilibrium"}
    views = view_choices(n) if n > 2 else {}
    view = [Control("view", "view", next(iter(views)), choices=views)] if views else []
    states = [
        Control(f"x{i + 1}", f"initial state {coordinate(i)}", at, low, high, 0.05, slider=n > 2, unit=unit)
        for i, (at, low, high) in enumerate(np.column_stack([start, *X.bounding_box()]).tolist())
    ]
    return (
        Control("log_epsilon", "stopping rule: log₁₀ ε", -3.0, -6.0, -1.0, 0.25),
        Control("centre", "stopping rule: scale about", "origin", choices=centres),
        *view,
        *states,
        Control("seed", "seed of the disturbance", 0, 0, 9999, 1, slider=False),
    )


# -- templates ----------------------------------------------------------------------------------------


def _counts(safe: int, other: int) -> tuple[Control, Control]:
    """The controls of templates in the plane, by the number of their rows."""
    return (
        Control("safe_directions", "directions of Fₖ", safe, 4, 32, 1),
        Control("directions", "directions of Rₖ", other, 4, 32, 1),
    )


def _spread_choices(n: int, of_case: tuple[int, int] | None = None) -> tuple[Control, Control]:
    """The controls of templates for n > 2 states; `of_case` counts the rows of the case's own, which come first."""
    spread = {str(2 * n): f"box, {2 * n} rows", str(2 * n + 2**n): f"{2 * n + 2**n} rows, evenly spread"}
    safe, other = ({CASE: f"the case's, {rows} rows", **spread} if rows else spread for rows in of_case or (None, None))
    return (
        Control("safe_directions", "template of Fₖ", next(iter(safe)), choices=safe),
        Control("directions", "template of Rₖ", next(iter(other)), choices=other),
    )


def _case_templates(case: CaseStudy) -> Callable[[str, Any], Template]:
    """The templates of a case study."""
    own = {name: Template(getattr(case, name), f"case.{name}") for name in ("safe_directions", "directions")}
    n = case.system.state_size
    return lambda name, value: own[name] if value == CASE else _spread(int(value), n)


@lru_cache(maxsize=128)
def _spread(count: int, n: int) -> Template:
    """`directions(count, n)`."""
    return Template(directions(count, n), f"mr.directions({count}{'' if n == 2 else f', {n}'})")


# -- networks -----------------------------------------------------------------------------------------


class _Trained(NamedTuple):
    """Networks by name, and the control that chooses among them, if there is a choice."""

    networks: dict[str, MaxoutNetwork]
    controls: tuple[Control, ...]

    def name(self, settings: Settings) -> str:
        """The name of the network that is chosen."""
        return str(settings.get("network", next(iter(self.networks))))


def _networks(case: CaseStudy) -> _Trained:
    """Some networks of a case from its seed study, that of the case first; that one alone if there is no study."""
    shipped, given = case_study(case.name).network.to_dict(), case.network.to_dict()
    if not data_file(case.name, "seeds.csv").is_file():
        return _Trained({SHIPPED if given == shipped else OWN: case.network}, ())
    rows, trained = load_study(case.name)
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
            networks[str(seed)] = trained[seed]
            choices[str(seed)] = f"seed {seed}: {remark}"
    return _Trained(networks, (Control("network", "trained network", next(iter(choices)), choices=choices),))


def _network_source(name: str, network: str, imports: list[str] | None = None) -> list[str]:
    """Lines of Python that make `case` with a network of `_networks`, after what else is imported."""
    lines = ["import mireach as mr", *(imports or [])]
    if network == SHIPPED:
        return [*lines, "", f'case = mr.case_study("{name}")']
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
def _loop(system: PWASystem, network: MaxoutNetwork) -> ClosedLoop:
    """One loop for one pair."""
    return ClosedLoop(system, network)


@lru_cache(maxsize=16)
def _fit(name: str, regions: int) -> PWAFit:
    """The fit of a case on regions x regions boxes; its proof takes longest for many of them."""
    fit = case_definition(name).fit
    assert fit is not None  # `_fitted_subject` is for cases with a fit
    return fit(regions)


@lru_cache(maxsize=32)
def _fitted_system(name: str, regions: int, shape: str) -> PWASystem:
    return _fit(name, regions).with_error(ERRORS[shape]).system()
