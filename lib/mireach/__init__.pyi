"""The public names: what each module provides. They are imported on first use."""

from . import approximation, certificate, errors
from .analysis.boundedness import UltimateBound, ultimately_bounded
from .analysis.contraction import contraction
from .analysis.disturbance import LargestDisturbance, largest_disturbance
from .analysis.exact_reach import Attractor, attractor, exact_reach
from .analysis.maximal_set import MaximalSafeSet, RegionCheck, maximal_safe_set, prove_rpi
from .analysis.minimal_set import MinimalSet, scaled_minimal_set
from .analysis.reach import outer_reach, outer_step, support
from .analysis.rpi import RPICheck, check_rpi
from .analysis.safe_set import SafeSet, safe_set
from .analysis.terminal_set import TerminalSet, terminal_set
from .approximation.error_bound import ErrorProof, prove_error
from .approximation.fit import PWAFit, fit_pwa
from .engines.base import Engine, Escape, Support, Witness
from .engines.cells import Cells
from .engines.cvxpy_model import Cvxpy
from .engines.exact import Exact
from .engines.milp.engine import Milp
from .errors import CellLimitError, CorruptFileError, MireachError, MissingExtraError, SolverError, SolverStopped
from .results import Verdict
from .sets.polytope import Polytope
from .sets.region import Region
from .sets.templates import box_directions, directions, octahedral_directions
from .studies import case_studies
from .studies.case_studies import case_study
from .systems.loop import ClosedLoop
from .systems.network import Layer, MaxoutNetwork
from .systems.nonlinear import NonlinearSystem
from .systems.pwa import Mode, PWASystem

__all__ = [
    "Attractor",
    "CellLimitError",
    "Cells",
    "ClosedLoop",
    "CorruptFileError",
    "Cvxpy",
    "Engine",
    "ErrorProof",
    "Escape",
    "Exact",
    "LargestDisturbance",
    "Layer",
    "MaximalSafeSet",
    "MaxoutNetwork",
    "Milp",
    "MinimalSet",
    "MireachError",
    "MissingExtraError",
    "Mode",
    "NonlinearSystem",
    "PWAFit",
    "PWASystem",
    "Polytope",
    "RPICheck",
    "Region",
    "RegionCheck",
    "SafeSet",
    "SolverError",
    "SolverStopped",
    "Support",
    "TerminalSet",
    "UltimateBound",
    "Verdict",
    "Witness",
    "approximation",
    "attractor",
    "box_directions",
    "case_studies",
    "case_study",
    "certificate",
    "check_rpi",
    "contraction",
    "directions",
    "errors",
    "exact_reach",
    "fit_pwa",
    "largest_disturbance",
    "maximal_safe_set",
    "octahedral_directions",
    "outer_reach",
    "outer_step",
    "prove_error",
    "prove_rpi",
    "safe_set",
    "scaled_minimal_set",
    "support",
    "terminal_set",
    "ultimately_bounded",
]
