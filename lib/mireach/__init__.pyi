"""The public names: what each module provides. They are imported on first use."""

from . import approximation, case_studies, certificate, errors, invariance, planar
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
from .planar import attractor, exact_reach, largest_disturbance, maximal_safe_set, prove_rpi
from .polytope import Polytope, box_directions, directions
from .reach import outer_reach, outer_step, support
from .region import Region
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
    "Region",
    "SolverError",
    "SolverStopped",
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
    "invariance",
    "largest_disturbance",
    "maximal_safe_set",
    "outer_reach",
    "outer_step",
    "planar",
    "prove_error",
    "prove_rpi",
    "safe_set",
    "scaled_minimal_set",
    "support",
    "terminal_set",
    "ultimately_bounded",
]
