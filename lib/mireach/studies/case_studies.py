"""The case studies: what defines each of them, and how plant, network, loop, templates and data are put together.

`pwa` and `double_integrator` are those of Sec. V of [Teichrib2025], with its numbers; `three_tanks`, `four_tanks`,
`aircraft_pitch` and `quadrotor` have three to six states.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from ..approximation.fit import PWAFit, fit_pwa
from ..certificate import checker
from ..checks import require_kind
from ..errors import CorruptFileError
from ..files import read_json
from ..learning.datasets import (
    DataSet,
    make_aircraft_pitch_data,
    make_double_integrator_data,
    make_four_tanks_data,
    make_pwa_data,
    make_quadrotor_data,
    make_three_tanks_data,
)
from ..sets.polytope import Polytope
from ..sets.templates import box_directions, directions, octahedral_directions
from ..systems.loop import ClosedLoop
from ..systems.network import MaxoutNetwork
from ..systems.nonlinear import NonlinearSystem
from ..systems.plants import (
    AIRCRAFT_DISTURBANCE,
    AIRCRAFT_STATE_LIMITS,
    FOUR_TANKS_DISTURBANCE,
    INTEGRATOR_DISTURBANCE,
    PWA_DISTURBANCE,
    QUADROTOR_DISTURBANCE,
    THREE_TANKS_DISTURBANCE,
    aircraft_pitch_plant,
    chessboard,
    double_integrator_plant,
    four_tanks_plant,
    pwa_plant,
    quadrotor_plant,
    three_tanks_plant,
)
from ..systems.pwa import PWASystem
from ..typing import Array
from .tables import html_table

EPSILON = 1e-3  # of eq. (25), TerminationFmin, as in the paper


class NetworkShape(NamedTuple):
    """Hidden layers of a network without its saturation: how many, neurons per layer, channels per neuron.

    `pool` is None for a ReLU network, whose neurons have the two channels z and 0.
    """

    layers: int
    width: int
    pool: int | None


class AmountSlider(NamedTuple):
    """The disturbance slider of a case in the disturbance lab: its label, default, end and step; it begins at 0.

    `unit` is that of the states, empty if there is none.
    """

    label: str
    default: float
    high: float
    step: float
    unit: str = ""


@dataclass(frozen=True, eq=False, kw_only=True)
class CaseDefinition:
    """Everything in which one case study differs from the others; `case_study` builds the case from it.

    Attributes
    ----------
    name : str
        Also the name of its folder in `data`.
    plant : callable
        () -> PWASystem with its disturbance sets, or the NonlinearSystem that `fit` approximates.
    fit : callable or None
        (cells, **options of `fit_pwa`) -> PWAFit of the plant on cells x cells regions; None where the plant is
        piecewise affine itself.
    disturbance_bound : float
        D = {d : |d|_inf <= disturbance_bound}, in units of x.
    shape : NetworkShape
        Of the network that is trained for it.
    make_data : callable
        (progress=...) -> DataSet, which the network is trained on.
    directions, safe_directions : array (l, n)
        Templates of the terminal set and of F_max.
    starts : list of list of float
        The initial states of the paper's figures; elsewhere some states of F_max.
    paper : mapping
        The numbers that the paper prints for this case; empty for cases that are not the paper's.
    safe_set_remark : str
        Why the box F_max differs from the paper's; empty where the paper prints no box.
    figures : tuple of str
        Names of the figures that the report draws of it; a case without any is not in the report.
    slider : AmountSlider or None
        None for cases whose disturbance sets the disturbance lab scales, as those of any other loop.
    """

    name: str
    plant: Callable[[], PWASystem | NonlinearSystem]
    fit: Callable[..., PWAFit] | None = None
    disturbance_bound: float
    shape: NetworkShape
    make_data: Callable[..., DataSet]
    directions: Array
    safe_directions: Array
    starts: list[list[float]]
    paper: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    safe_set_remark: str = ""
    figures: tuple[str, ...] = ()
    slider: AmountSlider | None = None

    def __str__(self) -> str:
        source = "the paper's" if self.paper else "not the paper's"
        return f"definition of case {self.name} ({source}), |d|_inf <= {self.disturbance_bound:g}"


@dataclass(frozen=True, eq=False)
class CaseStudy:
    """One case study, ready to be analysed.

    Attributes
    ----------
    definition : CaseDefinition
        What it was built from.
    system : PWASystem
        With the disturbance sets of the case.
    network : MaxoutNetwork
        Trained by this project; its last two layers saturate it to U.
    data : DataSet
        What the network was trained on.
    starts : array (k, n)
        The initial states of the paper's figures; elsewhere some states of F_max.
    plant : NonlinearSystem or None
        The nonlinear system that `system` approximates.
    fit : PWAFit or None
        That approximation.
    epsilon : float
        Of eq. (25), TerminationFmin.
    loop : ClosedLoop
        Of `system` and `network`.

    See Also
    --------
    case_study
    """

    definition: CaseDefinition
    system: PWASystem
    network: MaxoutNetwork
    data: DataSet
    starts: Array
    plant: NonlinearSystem | None = None
    fit: PWAFit | None = None
    epsilon: float = EPSILON
    loop: ClosedLoop = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "loop", ClosedLoop(self.system, self.network))

    @property
    def name(self) -> str:
        """Of the case, such as "pwa"."""
        return self.definition.name

    @property
    def directions(self) -> Array:
        """Template C (l, n) of the terminal set: 8 directions in the plane, (I, -I) and more elsewhere."""
        return self.definition.directions

    @property
    def safe_directions(self) -> Array:
        """Template C (l, n) of F_max: (I, -I) for `pwa`, otherwise `directions`."""
        return self.definition.safe_directions

    @property
    def disturbance_bound(self) -> float:
        """D = {d : |d|_inf <= disturbance_bound}, in units of x."""
        return self.definition.disturbance_bound

    @property
    def paper(self) -> dict[str, Any]:
        """The numbers that the paper prints for this case; empty for cases that are not the paper's."""
        return dict(self.definition.paper)

    def __repr__(self) -> str:
        return f"CaseStudy({self.name!r}, {self.system!r}, {self.network!r})"

    def __str__(self) -> str:
        n = self.system.state_size
        m = self.system.input_size
        modes = len(self.system.modes)
        return (
            f"case {self.name}: n = {n}, m = {m}, {modes} {'mode' if modes == 1 else 'modes'}, "
            f"{self.network.binaries} binaries of the network, |d|_inf <= {self.disturbance_bound:g}"
        )

    def _repr_html_(self) -> str:
        rows = {
            "states, inputs": f"{self.system.state_size}, {self.system.input_size}",
            "modes": len(self.system.modes),
            "network": repr(self.network),
            "disturbance": f"|d|_inf <= {self.disturbance_bound:g}",
            "directions of F_max, of R_min": f"{len(self.safe_directions)}, {len(self.directions)}",
            "data": repr(self.data),
        }
        return html_table(("case", self.name), rows.items())


def case_study(name: str, network: Any = None) -> CaseStudy:
    """A case study: one of the paper's two, or one of those with three to six states.

    Parameters
    ----------
    name : "pwa", "double_integrator", "three_tanks", "four_tanks", "aircraft_pitch" or "quadrotor"
    network : MaxoutNetwork, torch module or None
        None is the network that ships with the package.

    Returns
    -------
    CaseStudy

    Raises
    ------
    TypeError
        If the name is no str.
    ValueError
        If there is no such case, or the network does not fit it.
    FileNotFoundError
        If the data of the package are missing.

    Examples
    --------
    >>> print(case_study("pwa"))
    case pwa: n = 2, m = 1, 4 modes, 31 binaries of the network, |d|_inf <= 0.15
    """
    definition = case_definition(name)
    if network is None:
        network = MaxoutNetwork.load(data_file(name, "network.json"))
    made = definition.plant()
    plant: NonlinearSystem | None = None
    fit: PWAFit | None = None
    if isinstance(made, PWASystem):
        system = made
    elif definition.fit is None:
        raise TypeError(f"the plant of case {name} is nonlinear, so its definition needs a fit")
    else:
        plant, fit = made, definition.fit()
        bound = np.full(made.state_set.dimension, definition.disturbance_bound)
        system = fit.system().with_disturbance(Polytope.box(-bound, bound))
    return CaseStudy(
        definition=definition,
        system=system,
        network=network if isinstance(network, MaxoutNetwork) else MaxoutNetwork.from_torch(network),
        data=DataSet.load(data_file(name, "samples.csv")),
        starts=np.array(definition.starts, float),
        plant=plant,
        fit=fit,
    )


def double_integrator_fit(cells: int = 3, **options: Any) -> PWAFit:
    """The paper's fit of the double integrator on a chessboard of regions, the error f - f_PWA in each of them proven.

    Parameters
    ----------
    cells : int
        Regions along each axis of x.
    **options
        Of `fit_pwa`.

    Returns
    -------
    PWAFit

    Examples
    --------
    >>> len(double_integrator_fit(2).modes)
    4
    """
    plant = double_integrator_plant()
    return fit_pwa(plant, chessboard(plant.state_set, plant.input_set, cells), **options)


def load_sets(name: str) -> list[Polytope]:
    """The sets of a case's certificate: F_max = R_0, R_1, ..., the terminal set.

    A file is no proof by itself: `certificate.verify` checks it, and `check_rpi` proves its sets anew.

    Parameters
    ----------
    name : str
        Of the case study.

    Returns
    -------
    list of Polytope

    Raises
    ------
    CorruptFileError
        If the file is truncated or holds anything else.
    FileNotFoundError
        If the case has no such file.
    ValueError
        If there is no such case.

    Examples
    --------
    >>> len(load_sets("pwa"))
    45
    """
    path = data_file(name, "certificate.json")
    value = read_json(path, checker.FORMAT, checker.WITH_CASES)
    try:
        return [Polytope(value["template"], h) for h in value["sets"]]
    except (KeyError, TypeError, ValueError) as error:
        raise CorruptFileError(f"{path} holds no sets: {error!r}; make it again with run.py train {name}") from error


def data_file(name: str, file: str) -> Path:
    """Path of a file of case `name`, in the installed package or in the checkout.

    Raises
    ------
    ValueError
        If there is no such case.

    Examples
    --------
    >>> data_file("pwa", "network.json").name
    'network.json'
    """
    case_definition(name)
    packaged = Path(__file__).parents[1] / "data"
    folder = packaged if packaged.is_dir() else Path(__file__).resolve().parents[3] / "data"
    return folder / name / file


def case_definition(name: str) -> CaseDefinition:
    """The definition of a case study by its name.

    Raises
    ------
    TypeError
        If the name is no str.
    ValueError
        If there is no such case; the message names those that there are.

    Examples
    --------
    >>> case_definition("four_tanks").shape
    NetworkShape(layers=2, width=4, pool=3)
    """
    return _definition(name, NAMES)


def paper_case_definition(name: str) -> CaseDefinition:
    """The definition of one of the paper's case studies, as `case_definition`."""
    return _definition(name, PAPER_NAMES)


def _definition(name: str, names: tuple[str, ...]) -> CaseDefinition:
    require_kind(name, str, "name")
    if name not in names:
        raise ValueError(f"there is no case study {name!r}; choose one of {', '.join(names)}")
    return CASES[name]


PWA = CaseDefinition(
    name="pwa",
    plant=pwa_plant,
    disturbance_bound=PWA_DISTURBANCE,
    shape=NetworkShape(layers=3, width=3, pool=3),
    make_data=make_pwa_data,
    directions=directions(8),
    safe_directions=box_directions(2),
    starts=[[-7.30, 8.52], [-7.30, -10.0]],
    paper={
        "iterations": 1,
        "safe_set_box": [[-7.3, -10.0], [8.91, 8.52]],
        "steps": 51,
        "alpha": 1 + 9e-7,
        "epsilon": 1e-3,
        "disturbance_bound": 0.15,
        "samples": 1000,
        "starts": [[-7.30, 8.52], [-7.30, -10.0]],
        "trajectories": 200,
    },
    safe_set_remark="top and bottom follow from the modes and X, the left side if Phi(0, -10) = 1; "
    "the right one is the network's",
    figures=("figure1", "figure2"),
    slider=AmountSlider("disturbance bound |d|∞ ≤", PWA_DISTURBANCE, 2.0, 0.005),
)
DOUBLE_INTEGRATOR = CaseDefinition(
    name="double_integrator",
    plant=double_integrator_plant,
    fit=double_integrator_fit,
    disturbance_bound=INTEGRATOR_DISTURBANCE,
    shape=NetworkShape(layers=5, width=5, pool=5),
    make_data=make_double_integrator_data,
    directions=directions(8),
    safe_directions=directions(8),
    starts=[[5.5, -1.5]],
    paper={
        "iterations": 19,
        "steps": 20,
        "epsilon": 1e-3,
        "disturbance_bound": 0.1186,
        "max_error": 0.1186,
        "regions": 9,
        "samples": 900,
        "starts": [[5.5, -1.5]],
    },
    figures=("figure3", "maximal_set"),
    slider=AmountSlider("disturbance, times the proven error", 1.0, 8.0, 0.01),
)
LEVELS = np.array([[1.0, 1.0, 2.0], [-1.0, -1.0, -2.0]])  # found by trial: boxes alone shrink slowly, to a larger set
THREE_TANKS = CaseDefinition(
    name="three_tanks",
    plant=three_tanks_plant,
    disturbance_bound=THREE_TANKS_DISTURBANCE,
    shape=NetworkShape(layers=2, width=5, pool=2),
    make_data=make_three_tanks_data,
    directions=np.vstack([box_directions(3), LEVELS]),
    safe_directions=np.vstack([box_directions(3), LEVELS]),
    starts=[[5, -8, 0], [-8, -8, 7], [5, 5, -1]],
    figures=("three_tanks",),
    slider=AmountSlider("disturbance bound |d|∞ ≤", THREE_TANKS_DISTURBANCE, 1.0, 0.005, "cm"),
)
FOUR_TANKS = CaseDefinition(
    name="four_tanks",
    plant=four_tanks_plant,
    disturbance_bound=FOUR_TANKS_DISTURBANCE,
    shape=NetworkShape(layers=2, width=4, pool=3),
    make_data=make_four_tanks_data,
    directions=box_directions(4),
    safe_directions=box_directions(4),
    starts=[[2.5, -2.5, 0, 0], [-2.5, -2.5, -1, -1], [2, 3, 1, -1]],
    figures=("four_tanks",),
)
# Sums and differences of two states in units of their limits: they exclude that theta is near its limit while the pitch
# rate leads beyond it.
PITCH_PAIRS = octahedral_directions(3)[6:] / np.array(AIRCRAFT_STATE_LIMITS)
AIRCRAFT_PITCH = CaseDefinition(
    name="aircraft_pitch",
    plant=aircraft_pitch_plant,
    disturbance_bound=AIRCRAFT_DISTURBANCE,
    shape=NetworkShape(layers=2, width=16, pool=None),  # ReLU
    make_data=make_aircraft_pitch_data,
    directions=np.vstack([box_directions(3), PITCH_PAIRS]),
    safe_directions=np.vstack([box_directions(3), PITCH_PAIRS]),
    starts=[[0, 0, 19], [-10, -8, 10], [20, 0, 0]],
)
# Each axis is a double integrator of its own: an octagon in the plane of its position and velocity.
OCTAGONS = np.vstack([np.kron(directions(8), axis) for axis in np.eye(3)]) + 0.0
QUADROTOR = CaseDefinition(
    name="quadrotor",
    plant=quadrotor_plant,
    disturbance_bound=QUADROTOR_DISTURBANCE,
    shape=NetworkShape(layers=2, width=8, pool=2),
    make_data=make_quadrotor_data,
    directions=OCTAGONS,
    safe_directions=OCTAGONS,
    starts=[[1.9, 1.9, 1.4, -1, -1, -0.5], [-1, 1, 0, 1, -1, 0], [0, 0, -1, 1.2, -1.2, 0.5]],
)
CASES = {case.name: case for case in (PWA, DOUBLE_INTEGRATOR, THREE_TANKS, FOUR_TANKS, AIRCRAFT_PITCH, QUADROTOR)}
NAMES = tuple(CASES)
PAPER_NAMES = tuple(name for name, case in CASES.items() if case.paper)
REPORTED = tuple(name for name, case in CASES.items() if case.figures)
