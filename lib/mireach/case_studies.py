"""The two case studies of Sec. V of [Teichrib2025], wired: plant, network, loop, templates, data, and its numbers."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .approximation import PWAFit, fit_pwa
from .datasets import DataSet
from .loop import ClosedLoop
from .network import MaxoutNetwork
from .plants import (
    INTEGRATOR_DISTURBANCE,
    INTEGRATOR_INPUT_LIMIT,
    PWA_DISTURBANCE,
    PWA_INPUT_LIMIT,
    chessboard,
    double_integrator_plant,
    pwa_plant,
)
from .polytope import Polytope, box_directions, directions
from .system import NonlinearSystem, PWASystem

NAMES = ("pwa", "double_integrator")
SHAPES = {"pwa": {"layers": 3, "width": 3, "pool": 3}, "double_integrator": {"layers": 5, "width": 5, "pool": 5}}
INPUT_LIMITS = {"pwa": PWA_INPUT_LIMIT, "double_integrator": INTEGRATOR_INPUT_LIMIT}
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
    directions : array (8, 2)
        Template C of the terminal set.
    safe_directions : array (l, 2)
        Template C of F_max: (I, -I) for `pwa`, the same 8 directions for `double_integrator`.
    data : DataSet
        What the network was trained on.
    disturbance_bound : float
        D = {d : |d|_inf <= disturbance_bound}.
    starts : array (k, 2)
        The initial states of the paper's figures.
    epsilon : float
        Of eq. TerminationFmin.
    paper : dict
        The numbers that the paper prints for this case.
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
    """A case study of the paper.

    Parameters
    ----------
    name : "pwa" or "double_integrator"
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
    if name == "pwa":
        bound, system, plant, fit = PWA_DISTURBANCE, pwa_plant(), None, None
    else:
        bound, plant, fit = INTEGRATOR_DISTURBANCE, double_integrator_plant(), double_integrator_fit()
        system = fit.system().with_disturbance(Polytope.box([-bound, -bound], [bound, bound]))
    eight = directions(8)
    return CaseStudy(
        name=name,
        system=system,
        network=network if isinstance(network, MaxoutNetwork) else MaxoutNetwork.from_torch(network),
        directions=eight,
        safe_directions=box_directions(2) if name == "pwa" else eight,
        data=DataSet.load(data_file(name, "samples.csv")),
        disturbance_bound=bound,
        starts=np.array(PAPER[name]["starts"]),
        epsilon=PAPER[name]["epsilon"],
        paper=PAPER[name],
        plant=plant,
        fit=fit,
    )


def double_integrator_fit(cells=3, **options):
    """The paper's fit of the double integrator on a chessboard of cells x cells regions (a PWAFit).

    Options are those of `fit_pwa`.
    """
    plant = double_integrator_plant()
    return fit_pwa(plant, chessboard(plant.state_set, plant.input_set, cells), **options)


def data_file(name, file):
    """Path of a file of case `name`, in the installed package or in the checkout.

    Raises
    ------
    ValueError
        If there is no such case.
    """
    require_name(name)
    packaged = Path(__file__).parent / "data"
    folder = packaged if packaged.is_dir() else Path(__file__).resolve().parents[2] / "data"
    return folder / name / file


def require_name(name):
    """Raise ValueError if there is no case study of this name."""
    if name not in NAMES:
        raise ValueError(f"there is no case study {name!r}; choose one of {', '.join(NAMES)}")
