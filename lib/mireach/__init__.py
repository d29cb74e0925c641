"""mireach: robustly positively invariant sets of neural loops by mixed-integer reachability."""

from .approximation import fit_pwa, prove_error
from .case_studies import case_study
from .errors import CorruptFileError, MireachError, SolverError, SolverStopped
from .invariance import (
    check_rpi,
    contraction,
    safe_set,
    scaled_minimal_set,
    terminal_set,
    ultimately_bounded,
)
from .loop import ClosedLoop
from .network import Layer, MaxoutNetwork
from .polytope import Polytope, box_directions, directions
from .reach import outer_reach, outer_step, support
from .system import Mode, NonlinearSystem, PWASystem

__all__ = [
    "ClosedLoop",
    "CorruptFileError",
    "Layer",
    "MaxoutNetwork",
    "MireachError",
    "Mode",
    "NonlinearSystem",
    "PWASystem",
    "Polytope",
    "SolverError",
    "SolverStopped",
    "box_directions",
    "case_study",
    "check_rpi",
    "contraction",
    "directions",
    "fit_pwa",
    "outer_reach",
    "outer_step",
    "prove_error",
    "safe_set",
    "scaled_minimal_set",
    "support",
    "terminal_set",
    "ultimately_bounded",
]
