"""Optimal control problems whose solutions the networks learn."""

from .nonlinear import NonlinearMPC, NonlinearSolution
from .piecewise_affine import MIQPSolution, solve_miqp

__all__ = ["MIQPSolution", "NonlinearMPC", "NonlinearSolution", "solve_miqp"]
