"""The subjects of a disturbance lab: what may vary of a case study, or of a planar loop of one's own."""

from functools import lru_cache
from typing import Any, NamedTuple

from ..approximation.fit import PWAFit
from ..checks import require_kind
from ..sets.polytope import Polytope
from ..studies.case_studies import AmountSlider, CaseStudy, case_definition, case_study
from ..studies.seed_study import load_study
from ..systems.loop import ClosedLoop
from ..systems.network import MaxoutNetwork
from ..systems.pwa import PWASystem
from ..typing import Array
from .controls import Control, Settings, Subject

OWN = "own"  # name of a network that is not one of the seed study
ERRORS = {"box": "ball", "segment": "polytope"}  # shape of the error set in the lab -> `error` of `fit_pwa`


def subject(case: Any) -> Subject:
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
    TypeError
        If it is none of these.
    ValueError
        If there is no such case, or the loop has not two states.

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
    if X.dimension != 2:
        raise ValueError(f"the lab draws the plane, but the loop has {X.dimension} states")
    slider = AmountSlider("disturbance, times its set", 1.0, 4.0, 0.01)
    return Subject(
        "loop",
        (_amount(slider), *_common_controls(X, 16, (X.chebyshev()[0] + X.vertices()[0]) / 2)),
        lambda settings: loop,
        lambda settings: ["import mireach as mr", "", "# loop is the one that the lab was given"],
    )


def _bounded_subject(case: CaseStudy, slider: AmountSlider) -> Subject:
    """A case whose system is piecewise affine: the amount is the bound on |d|_inf."""
    trained = _networks(case)
    system = case.system.with_disturbance(Polytope.box([-1, -1], [1, 1]))

    def source(settings: Settings) -> list[str]:
        unit = "mr.Polytope.box([-1, -1], [1, 1])"
        return [*_network_source(case.name, settings["network"]), f"loop = case.loop.with_disturbance({unit})"]

    return Subject(
        case.name,
        (_amount(slider), trained.control, *_case_controls(case)),
        lambda settings: _loop(system, trained.networks[settings["network"]]),
        source,
    )


def _fitted_subject(case: CaseStudy, slider: AmountSlider) -> Subject:
    """A case whose system is a fit: the amount scales the proven error sets, whose shape and number may be set."""
    trained = _networks(case)
    fit = case.definition.fit
    assert fit is not None  # `case.fit` was made by it

    def base(settings: Settings) -> ClosedLoop:
        system = _fitted_system(case.name, settings["regions"], settings["shape"])
        return _loop(system, trained.networks[settings["network"]])

    def source(settings: Settings) -> list[str]:
        return [
            *_network_source(case.name, settings["network"], imports=[f"from {fit.__module__} import {fit.__name__}"]),
            f"fit = {fit.__name__}({settings['regions']}, error={ERRORS[settings['shape']]!r})",
            "loop = mr.ClosedLoop(fit.system(), case.network)",
        ]

    shapes = {"box": "box |d|∞ ≤ e", "segment": "segment along (1, 1)"}
    controls = (
        _amount(slider),
        Control("shape", "shape of the error set", "box", choices=shapes),
        Control("regions", "regions of the fit along each axis", 3, 1, 6, 1),
        trained.control,
        *_case_controls(case),
    )
    return Subject(case.name, controls, base, source, case.plant)


def _amount(slider: AmountSlider) -> Control:
    return Control("amount", slider.label, slider.default, 0.0, slider.high, slider.step)


def _case_controls(case: CaseStudy) -> tuple[Control, ...]:
    return _common_controls(case.system.state_set, len(case.safe_directions), case.starts[0])


def _common_controls(X: Polytope, safe_directions: int, start: Array) -> tuple[Control, ...]:
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


class _Trained(NamedTuple):
    """Networks by name, and the control that chooses among them."""

    networks: dict[str, MaxoutNetwork]
    control: Control


def _networks(case: CaseStudy) -> _Trained:
    """Some networks of a case from its seed study, that of the case first."""
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
            networks[str(seed)] = trained[seed]
            choices[str(seed)] = f"seed {seed}: {remark}"
    return _Trained(networks, Control("network", "trained network", next(iter(choices)), choices=choices))


def _network_source(name: str, network: str, imports: list[str] | None = None) -> list[str]:
    """Lines of Python that make `case` with a network of `_networks`, after what else is imported."""
    lines = ["import mireach as mr", *(imports or [])]
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
