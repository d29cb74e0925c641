"""The case studies, wired: plant, network, loop, templates, data.

`pwa` and `double_integrator` are those of Sec. V of [Teichrib2025], with its numbers; `three_tanks` and `four_tanks`
have more than two states, where there are no cells and the MILP is the method.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..approximation.fit import PWAFit, fit_pwa
from ..certificate import checker
from ..errors import CorruptFileError
from ..files import read_json
from ..learning.datasets import DataSet
from ..sets.polytope import Polytope
from ..sets.templates import box_directions, directions
from ..systems.loop import ClosedLoop
from ..systems.network import MaxoutNetwork
from ..systems.nonlinear import NonlinearSystem
from ..systems.plants import (
    FOUR_TANKS_DISTURBANCE,
    INTEGRATOR_DISTURBANCE,
    PWA_DISTURBANCE,
    THREE_TANKS_DISTURBANCE,
    chessboard,
    double_integrator_plant,
    four_tanks_plant,
    pwa_plant,
    three_tanks_plant,
)
from ..systems.pwa import PWASystem

PLANTS = {
    "pwa": pwa_plant,
    "double_integrator": double_integrator_plant,
    "three_tanks": three_tanks_plant,
    "four_tanks": four_tanks_plant,
}
NAMES = tuple(PLANTS)
SHAPES = {
    "pwa": {"layers": 3, "width": 3, "pool": 3},
    "double_integrator": {"layers": 5, "width": 5, "pool": 5},
    "three_tanks": {"layers": 2, "width": 5, "pool": 2},
    "four_tanks": {"layers": 2, "width": 4, "pool": 3},
}
DISTURBANCES = {
    "pwa": PWA_DISTURBANCE,
    "double_integrator": INTEGRATOR_DISTURBANCE,
    "three_tanks": THREE_TANKS_DISTURBANCE,
    "four_tanks": FOUR_TANKS_DISTURBANCE,
}
# What the paper prints for its two cases.
PAPER = {
    "pwa": {
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
    "double_integrator": {
        "iterations": 19,
        "steps": 20,
        "epsilon": 1e-3,
        "disturbance_bound": 0.1186,
        "max_error": 0.1186,
        "regions": 9,
        "samples": 900,
        "starts": [[5.5, -1.5]],
    },
}
STARTS = {
    **{name: PAPER[name]["starts"] for name in PAPER},
    "three_tanks": [[5, -8, 0], [-8, -8, 7], [5, 5, -1]],
    "four_tanks": [[2.5, -2.5, 0, 0], [-2.5, -2.5, -1, -1], [2, 3, 1, -1]],
}
EPSILON = 1e-3  # of eq. TerminationFmin, as in the paper


@dataclass(frozen=True, eq=False)
class CaseStudy:
    """One case study, ready to be analysed.

    Attributes
    ----------
    name : str
    system : PWASystem
        With the disturbance sets of the case.
    network : MaxoutNetwork
        Trained by this project; its last two layers saturate it to U.
    directions : array (l, n)
        Template C of the terminal set: 8 directions in the plane, (I, -I) for `four_tanks`, and (I, -I) with
        +-(1, 1, 2) for `three_tanks`.
    safe_directions : array (l, n)
        Template C of F_max: (I, -I) for `pwa`, otherwise `directions`.
    data : DataSet
        What the network was trained on.
    disturbance_bound : float
        D = {d : |d|_inf <= disturbance_bound}.
    starts : array (k, n)
        The initial states of the paper's figures; elsewhere some states of F_max.
    epsilon : float
        Of eq. TerminationFmin.
    paper : dict
        The numbers that the paper prints for this case; empty for cases that are not the paper's.
    plant : NonlinearSystem or None
        The nonlinear system that `system` approximates.
    fit : PWAFit or None
        That approximation.
    """

    name: str
    system: PWASystem
    network: MaxoutNetwork
    directions: np.ndarray
    safe_directions: np.ndarray
    data: DataSet
    disturbance_bound: float
    starts: np.ndarray
    epsilon: float
    paper: dict
    plant: NonlinearSystem | None = None
    fit: PWAFit | None = None

    def __post_init__(self):
        object.__setattr__(self, "loop", ClosedLoop(self.system, self.network))

    def __repr__(self):
        return f"CaseStudy({self.name!r}, {len(self.system.modes)} modes, {self.network!r})"


def case_study(name, network=None):
    """A case study: one of the paper's two, or one of the two with more states.

    Parameters
    ----------
    name : "pwa", "double_integrator", "three_tanks" or "four_tanks"
    network : MaxoutNetwork, torch module or None
        None is the network that ships with the package.

    Returns
    -------
    CaseStudy

    Raises
    ------
    ValueError
        If there is no such case, or the network does not fit it.
    FileNotFoundError
        If the data of the package are missing.

    Examples
    --------
    >>> case_study("pwa").system.state_size
    2
    """
    require_name(name)
    if network is None:
        network = MaxoutNetwork.load(data_file(name, "network.json"))
    bound, plant, fit = DISTURBANCES[name], None, None
    if name == "double_integrator":
        plant, fit = double_integrator_plant(), double_integrator_fit()
        system = fit.system().with_disturbance(Polytope.box([-bound, -bound], [bound, bound]))
    else:
        system = PLANTS[name]()
    template = _template(name, system.state_size)
    return CaseStudy(
        name=name,
        system=system,
        network=network if isinstance(network, MaxoutNetwork) else MaxoutNetwork.from_torch(network),
        directions=template,
        safe_directions=box_directions(2) if name == "pwa" else template,
        data=DataSet.load(data_file(name, "samples.csv")),
        disturbance_bound=bound,
        starts=np.array(STARTS[name], float),
        epsilon=EPSILON,
        paper=PAPER.get(name, {}),
        plant=plant,
        fit=fit,
    )


def double_integrator_fit(cells=3, **options):
    """The paper's fit of the double integrator on a chessboard of cells x cells regions (a PWAFit).

    Options are those of `fit_pwa`.
    """
    plant = double_integrator_plant()
    return fit_pwa(plant, chessboard(plant.state_set, plant.input_set, cells), **options)


def load_sets(name):
    """The sets of a case's certificate, F_max = R_0, R_1, ..., the terminal set: list of Polytope.

    A file is no proof by itself: `certificate.verify` checks it, and `check_rpi` proves its sets anew.

    Raises
    ------
    CorruptFileError
        If the file is truncated or holds anything else.
    FileNotFoundError
        If the case has no such file.
    """
    path = data_file(name, "certificate.json")
    value = read_json(path, checker.FORMAT)
    try:
        return [Polytope(value["template"], h) for h in value["sets"]]
    except (KeyError, TypeError, ValueError) as error:
        raise CorruptFileError(f"{path} holds no sets: {error!r}; make it again with run.py train {name}") from error


def data_file(name, file):
    """Path of a file of case `name`, in the installed package or in the checkout.

    Raises
    ------
    ValueError
        If there is no such case.
    """
    require_name(name)
    packaged = Path(__file__).parents[1] / "data"
    folder = packaged if packaged.is_dir() else Path(__file__).resolve().parents[3] / "data"
    return folder / name / file


def require_name(name, names=NAMES):
    """Raise ValueError if `name` is none of `names`."""
    if name not in names:
        raise ValueError(f"there is no case study {name!r}; choose one of {', '.join(names)}")


def _template(name, n):
    """Template of the terminal set of case `name`, which has n states: array (l, n)."""
    if n == 2:
        return directions(8)
    if name != "three_tanks":
        return box_directions(n)
    levels = np.array([1.0, 1.0, 2.0])  # found by trial: boxes alone shrink slowly, and to a much larger terminal set
    return np.vstack([box_directions(n), levels, -levels])
