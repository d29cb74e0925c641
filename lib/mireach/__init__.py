"""mireach: robustly positively invariant sets of neural loops by mixed-integer reachability."""

from .loop import ClosedLoop
from .network import Layer, MaxoutNetwork
from .polytope import Polytope, box_directions, directions
from .system import Mode, NonlinearSystem, PWASystem

__all__ = [
    "ClosedLoop",
    "Layer",
    "MaxoutNetwork",
    "Mode",
    "NonlinearSystem",
    "PWASystem",
    "Polytope",
    "box_directions",
    "directions",
]
