"""The two plants of Sec. V of [Teichrib2025]; every number of theirs is written here, once."""

from itertools import pairwise, product

import numpy as np

from .polytope import Polytope
from .system import Mode, NonlinearSystem, PWASystem

# Case 1: the four modes; the matrix A of each, with the signs s of its region {x : s_i x_i >= 0}.
PWA_MODES = (
    ([[-0.04, -0.461], [-0.139, 0.341]], (1, 1)),
    ([[0.936, 0.323], [0.788, -0.049]], (1, -1)),
    ([[-0.857, 0.815], [0.491, 0.62]], (-1, -1)),
    ([[-0.022, 0.644], [0.758, 0.271]], (-1, 1)),
)
PWA_B = ((1.0,), (0.0,))
PWA_STATE_LIMIT, PWA_INPUT_LIMIT = 10.0, 1.0  # |x|_inf and |u|
PWA_DISTURBANCE = 0.15  # |d|_inf

# Case 2: x+ = A x + B u + CURVATURE x'x in both components (eq. NL_DI).
INTEGRATOR_A = ((1.0, 1.0), (0.0, 1.0))
INTEGRATOR_B = (0.5, 1.0)
INTEGRATOR_CURVATURE = 0.025
INTEGRATOR_STATE_LIMIT, INTEGRATOR_INPUT_LIMIT = 6.0, 2.0
INTEGRATOR_DISTURBANCE = 0.1186  # |d|_inf, the error of the piecewise-affine fit rounded up


def pwa_plant(disturbance_bound=PWA_DISTURBANCE):
    """The four-mode system of case study 1.

    Parameters
    ----------
    disturbance_bound : float
        D = {d : |d|_inf <= disturbance_bound} in every mode, in units of x.

    Returns
    -------
    PWASystem
        The regions are the quadrants, closed, and do not depend on u.
    """
    if not disturbance_bound >= 0:
        raise ValueError(f"disturbance_bound must be at least 0; got {disturbance_bound}")
    D = _cube(disturbance_bound, 2)
    modes = [Mode(A, PWA_B, np.zeros(2), _quadrant(signs), D) for A, signs in PWA_MODES]
    return PWASystem(modes, _cube(PWA_STATE_LIMIT, 2), _cube(PWA_INPUT_LIMIT, 1))


def double_integrator(x, u):
    """f(x, u) of eq. NL_DI, on anything that can be indexed, added, multiplied and squared."""
    bend = INTEGRATOR_CURVATURE * (x[0] ** 2 + x[1] ** 2)
    return tuple(row[0] * x[0] + row[1] * x[1] + gain * u[0] + bend for row, gain in zip(INTEGRATOR_A, INTEGRATOR_B))


def double_integrator_plant():
    """The nonlinear double integrator of case study 2 (eq. NL_DI), a NonlinearSystem."""
    return NonlinearSystem(double_integrator, _cube(INTEGRATOR_STATE_LIMIT, 2), _cube(INTEGRATOR_INPUT_LIMIT, 1))


def chessboard(state_set, input_set, cells=3):
    """Regions that divide X into a regular pattern of boxes, each times U.

    Parameters
    ----------
    state_set, input_set : Polytope
        Bounded. A state set that is not a box is covered by the pattern of its bounding box.
    cells : int
        Boxes along each axis of x.

    Returns
    -------
    list of Polytope
        cells^n regions in (x, u), the last axis of x running fastest; neighbours share their edge as
        the same float.
    """
    if cells != int(cells) or cells < 1:
        raise ValueError(f"cells must be a whole number of at least 1; got {cells}")
    lower, upper = state_set.bounding_box()
    axes = [list(pairwise(np.linspace(low, high, int(cells) + 1))) for low, high in zip(lower, upper)]
    return [Polytope.box(*np.transpose(sides)).product(input_set) for sides in product(*axes)]


def _cube(limit, n):
    """{x in R^n : |x|_inf <= limit}."""
    return Polytope.box(np.full(n, -limit), np.full(n, limit))


def _quadrant(signs):
    """{(x, u) : signs_i x_i >= 0} for x in the plane and one input."""
    return Polytope([[-signs[0], 0, 0], [0, -signs[1], 0]], np.zeros(2))
