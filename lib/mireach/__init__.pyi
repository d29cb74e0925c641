"""The public names: what each module provides. They are imported on first use."""

from . import approximation, certificate, errors
from .analysis.disturbance import largest_disturbance
from .analysis.exact_reach import attractor, exact_reach
from .analysis.invariance import (
    check_rpi,
    contraction,
    safe_set,
    scaled_minimal_set,
    terminal_set,
    ultimately_bounded,
)
from .analysis.maximal_set import maximal_safe_set, prove_rpi
from .analysis.reach import outer_reach, outer_step, support
from .approximation.fit import fit_pwa, prove_error
from .errors import CorruptFileError, MireachError, MissingExtraError, SolverError, SolverStopped
from .sets.polytope import Polytope
from .sets.region import Region
from .sets.templates import box_directions, directions
from .studies import case_studies
from .studies.case_studies import case_study
from .systems.loop import ClosedLoop
from .systems.network import Layer, MaxoutNetwork
from .systems.pwa import Mode, NonlinearSystem, PWASystem

__all__ = [
    "ClosedLoop",
    "CorruptFileError",
    "Layer",
    "MaxoutNetwork",
    "MireachError",
    "MissingExtraError",
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
    "largest_disturbance",
    "maximal_safe_set",
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
