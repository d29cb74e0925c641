"""The plants of the case studies, with all their parameters.

`pwa` and `double_integrator` are those of Sec. V of [Teichrib2025]. The others have more than two states: `three_tanks`
and `four_tanks` are benchmarks of process control, `aircraft_pitch` and `quadrotor` are linear models of aircraft.
"""

from collections.abc import Sequence
from itertools import pairwise, product
from typing import Any

import numpy as np
from scipy.linalg import expm

from ..checks import whole_number
from ..sets.polytope import Polytope
from ..typing import Array
from .nonlinear import NonlinearSystem
from .pwa import Mode, PWASystem

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

# Case 2: x+ = A x + B u + CURVATURE x'x in both components, eq. (29), NL_DI.
INTEGRATOR_A = ((1.0, 1.0), (0.0, 1.0))
INTEGRATOR_B = (0.5, 1.0)
INTEGRATOR_CURVATURE = 0.025
INTEGRATOR_STATE_LIMIT, INTEGRATOR_INPUT_LIMIT = 6.0, 2.0
INTEGRATOR_DISTURBANCE = 0.1186  # |d|_inf, the error of the piecewise-affine fit rounded up

# Case 3, the three-tank benchmark of [Bemporad1999b, Yaakoubi2023], in cm and s.
THREE_TANKS_AREA = 154.0  # of each tank, cm^2
THREE_TANKS_PIPE = 0.2  # of each pipe, cm^2
THREE_TANKS_HEIGHT = 62.0  # of the tanks, cm
THREE_TANKS_UPPER_PIPE = 30.0  # height of the upper pipes, cm
THREE_TANKS_PUMP = 100.0  # largest flow of a pump, cm^3/s
# Our choice. The set-point of the outer tanks is the level at which the upper pipes begin to carry water.
THREE_TANKS_SAMPLING = 10.0  # s
THREE_TANKS_LEVELS = (30.0, 30.0, 20.0)  # cm
THREE_TANKS_STATE_LIMIT = 10.0  # |x|_inf, cm
THREE_TANKS_DISTURBANCE = 0.2  # |d|_inf, cm

# Case 4, the quadruple-tank process of [Johansson2000] at its minimum-phase operating point, in cm, s and V.
FOUR_TANKS_AREAS = (28.0, 32.0, 28.0, 32.0)  # cm^2
FOUR_TANKS_OUTLETS = (0.071, 0.057, 0.071, 0.057)  # cm^2
FOUR_TANKS_LEVELS = (12.4, 12.7, 1.8, 1.4)  # cm
FOUR_TANKS_PUMPS = (3.33, 3.35)  # cm^3/(V s)
FOUR_TANKS_VALVES = (0.70, 0.60)  # the share of each pump's flow that goes to the lower tank
# Our choice. Within these limits no tank runs dry, and no level exceeds 18 cm.
FOUR_TANKS_SAMPLING = 5.0  # s
FOUR_TANKS_STATE_LIMITS = (5.0, 5.0, 1.5, 1.2)  # |x_i|, cm
FOUR_TANKS_INPUT_LIMIT = 1.0  # |u|, V
FOUR_TANKS_DISTURBANCE = 0.05  # |d|_inf, cm

# Case 5, the pitch of an airliner [ControlTutorials]: d/dt (alpha, q, theta) for the elevator delta, in rad and s.
AIRCRAFT_A = ((-0.313, 56.7, 0.0), (-0.0139, -0.426, 0.0), (0.0, 56.7, 0.0))
AIRCRAFT_B = (0.232, 0.0203, 0.0)
# Our choice, in degrees and s.
AIRCRAFT_SAMPLING = 0.5
AIRCRAFT_STATE_LIMITS = (25.0, 10.0, 20.0)  # |alpha|, |dtheta/dt|, |theta|
AIRCRAFT_INPUT_LIMIT = 15.0  # |delta|
AIRCRAFT_DISTURBANCE = 0.1  # |d|_inf

# Case 6, the quadrotor with six states of [Hu2020, Everett2021], in m and s.
QUADROTOR_GRAVITY = 9.8  # m/s^2
QUADROTOR_TILT = np.pi / 9  # largest |tan(pitch)| and |tan(roll)|; the thrust lies between 0 and twice the weight
# Our choice. The sampling time is twice that of the benchmark.
QUADROTOR_SAMPLING = 0.2  # s
QUADROTOR_STATE_LIMIT = 2.0  # |position|, m, and |velocity|, m/s, along each axis
QUADROTOR_DISTURBANCE = 0.02  # |d|_inf, m and m/s

GRAVITY = 981.0  # cm/s^2


def pwa_plant(disturbance_bound: float = PWA_DISTURBANCE) -> PWASystem:
    """The four-mode system of case study 1, Sec. V.A of [Teichrib2025].

    Parameters
    ----------
    disturbance_bound : float
        D = {d : |d|_inf <= disturbance_bound} in every mode, in units of x.

    Returns
    -------
    PWASystem
        The regions are the quadrants, closed, and do not depend on u.

    Raises
    ------
    ValueError
        If the bound is negative.

    Examples
    --------
    >>> pwa_plant()
    PWASystem(4 modes, 2 states, 1 input)
    """
    D = _cube(_bound(disturbance_bound), 2)
    modes = [Mode(A, PWA_B, np.zeros(2), _quadrant(signs), D) for A, signs in PWA_MODES]
    return PWASystem(modes, _cube(PWA_STATE_LIMIT, 2), _cube(PWA_INPUT_LIMIT, 1))


def double_integrator(x: Any, u: Any) -> tuple[Any, ...]:
    """f(x, u) of eq. (29), NL_DI, on anything that can be indexed, added, multiplied and squared.

    Examples
    --------
    >>> double_integrator([2.0, 0.0], [1.0])
    (2.6, 1.1)
    """
    bend = INTEGRATOR_CURVATURE * (x[0] ** 2 + x[1] ** 2)
    return tuple(row[0] * x[0] + row[1] * x[1] + gain * u[0] + bend for row, gain in zip(INTEGRATOR_A, INTEGRATOR_B))


def double_integrator_plant() -> NonlinearSystem:
    """The nonlinear double integrator of case study 2, eq. (29), NL_DI, with |x|_inf <= 6 and |u| <= 2.

    Examples
    --------
    >>> double_integrator_plant()
    NonlinearSystem(2 states, 1 input)
    """
    return NonlinearSystem(double_integrator, _cube(INTEGRATOR_STATE_LIMIT, 2), _cube(INTEGRATOR_INPUT_LIMIT, 1))


def three_tanks_plant(disturbance_bound: float = THREE_TANKS_DISTURBANCE) -> PWASystem:
    """Three tanks in a row, with pumps for the outer two and a drain in the middle one: n = 3, m = 2, four modes.

    Each outer tank i is connected to the middle one by a pipe at the bottom, with the flow k (h_i - h_3), and by one at
    height h_v, with the flow kappa (h_i - h_v) if h_i >= h_v and else none. Their sum is q_i. The flow of the drain is
    k h_3. The square roots of Torricelli's law are replaced by secants, k = S sqrt(2 g / h_max) and
    kappa = S sqrt(2 g / (h_max - h_v)). Each step is an Euler step:

        h_i+ = h_i + T / A (Q_i - q_i),   h_3+ = h_3 + T / A (q_1 + q_2 - k h_3).

    Parameters
    ----------
    disturbance_bound : float
        D = {d : |d|_inf <= disturbance_bound} in every mode, in cm.

    Returns
    -------
    PWASystem
        x is the deviation of the levels (h_1, h_2, h_3) from (30, 30, 20) cm. u is the deviation of the pump flows from
        those that keep these levels, in units of the largest flow of a pump, 100 cm^3/s. The upper pipes are at 30 cm,
        so all modes meet at the origin, and h_3 does not exceed their height in X.

    Raises
    ------
    ValueError
        If the bound is negative.

    Notes
    -----
    The three-tank benchmark in its mixed logical dynamical form [Bemporad1999b, Yaakoubi2023], with the usual
    parameters and secants. Here all four pipes and the drain are open, and the outer tanks do not leak. The set-point,
    the sampling time, X and the disturbance are our choice.

    Examples
    --------
    >>> three_tanks_plant()
    PWASystem(4 modes, 3 states, 2 inputs)
    """
    D = _cube(_bound(disturbance_bound), 3)
    per_area = THREE_TANKS_SAMPLING / THREE_TANKS_AREA
    depth = THREE_TANKS_HEIGHT - THREE_TANKS_UPPER_PIPE
    k = per_area * THREE_TANKS_PIPE * np.sqrt(2 * GRAVITY / THREE_TANKS_HEIGHT)
    kappa = per_area * THREE_TANKS_PIPE * np.sqrt(2 * GRAVITY / depth)
    pump = per_area * THREE_TANKS_PUMP
    h1, h2, h3 = THREE_TANKS_LEVELS
    resting = np.array([k * (h1 - h3), k * (h2 - h3)]) / pump  # share of the pumps' flow that keeps the levels
    B = [[pump, 0.0], [0.0, pump], [0.0, 0.0]]
    modes = []
    for signs in product((-1, 1), repeat=2):  # +1: the level is above the upper pipe
        k1, k2 = (k + kappa if sign > 0 else k for sign in signs)
        A = [[1 - k1, 0.0, k], [0.0, 1 - k2, k], [k1, k2, 1 - 3 * k]]
        region = Polytope(np.array([[-signs[0], 0, 0, 0, 0], [0, -signs[1], 0, 0, 0]]), np.zeros(2))
        modes.append(Mode(A, B, np.zeros(3), region, D))
    return PWASystem(modes, _cube(THREE_TANKS_STATE_LIMIT, 3), Polytope.box(-resting, 1 - resting))


def four_tanks_plant(disturbance_bound: float = FOUR_TANKS_DISTURBANCE) -> PWASystem:
    """The quadruple-tank process: n = 4, m = 2, one mode.

    Two upper tanks (3 and 4) drain into two lower ones (1 and 2). Each pump feeds one lower tank and the upper tank on
    the opposite side. The linearisation of [Johansson2000], with the time constants T_i = A_i / a_i sqrt(2 h_i / g), is

        dx1/dt = -x1 / T1 + A3 x3 / (A1 T3) + gamma1 k1 u1 / A1,   dx3/dt = -x3 / T3 + (1 - gamma2) k2 u2 / A3,
        dx2/dt = -x2 / T2 + A4 x4 / (A2 T4) + gamma2 k2 u2 / A2,   dx4/dt = -x4 / T4 + (1 - gamma1) k1 u1 / A4.

    It is discretised exactly, with u constant between the samples.

    Parameters
    ----------
    disturbance_bound : float
        D = {d : |d|_inf <= disturbance_bound}, in cm.

    Returns
    -------
    PWASystem
        x is the deviation of the levels from (12.4, 12.7, 1.8, 1.4) cm, and u that of the pump voltages from 3 V.

    Raises
    ------
    ValueError
        If the bound is negative.

    Notes
    -----
    All parameters are those of the paper at its operating point P-, where the zeros are stable. The sampling time, X,
    U and the disturbance are our choice.

    Examples
    --------
    >>> four_tanks_plant()
    PWASystem(1 mode, 4 states, 2 inputs)
    """
    area, outlet, level = map(np.array, (FOUR_TANKS_AREAS, FOUR_TANKS_OUTLETS, FOUR_TANKS_LEVELS))
    rate = outlet / area / np.sqrt(2 * level / GRAVITY)  # 1 / T_i
    (k1, k2), (gamma1, gamma2) = FOUR_TANKS_PUMPS, FOUR_TANKS_VALVES
    A, B = np.diag(-rate), np.zeros((4, 2))
    A[0, 2], A[1, 3] = area[2] * rate[2] / area[0], area[3] * rate[3] / area[1]
    B[[0, 3], 0] = gamma1 * k1 / area[0], (1 - gamma1) * k1 / area[3]
    B[[1, 2], 1] = gamma2 * k2 / area[1], (1 - gamma2) * k2 / area[2]
    mode = _sampled(A, B, FOUR_TANKS_SAMPLING, disturbance_bound)
    limits = np.array(FOUR_TANKS_STATE_LIMITS)
    return PWASystem([mode], Polytope.box(-limits, limits), _cube(FOUR_TANKS_INPUT_LIMIT, 2))


def aircraft_pitch_plant(disturbance_bound: float = AIRCRAFT_DISTURBANCE) -> PWASystem:
    """The pitch dynamics of an airliner in cruise, with the elevator as input: n = 3, m = 1, one mode.

    The linearised longitudinal motion at constant speed has the angle of attack alpha, the pitch angle theta, and the
    elevator deflection delta. The pitch rate is dtheta/dt = 56.7 q.

        dalpha/dt = -0.313 alpha + 56.7 q + 0.232 delta,   dq/dt = -0.0139 alpha - 0.426 q + 0.0203 delta.

    It is discretised exactly, with delta constant between the samples.

    Parameters
    ----------
    disturbance_bound : float
        D = {d : |d|_inf <= disturbance_bound}, in degrees and degrees per second.

    Returns
    -------
    PWASystem
        x = (alpha, dtheta/dt, theta), the deviations from steady flight in degrees and degrees per second, and
        u = delta in degrees.

    Raises
    ------
    ValueError
        If the bound is negative.

    Notes
    -----
    The coefficients are those of the example *Aircraft Pitch* of [ControlTutorials], from data of a Boeing airliner.
    The model is linear, so it has the same coefficients in radians and in degrees. The pitch rate as a state in place
    of q, the sampling time, X, U and the disturbance are our choice.

    Examples
    --------
    >>> aircraft_pitch_plant()
    PWASystem(1 mode, 3 states, 1 input)
    """
    units = np.array([1.0, AIRCRAFT_A[2][1], 1.0])  # from (alpha, q, theta) to (alpha, dtheta/dt, theta)
    A, B = units[:, None] * np.array(AIRCRAFT_A) / units, units[:, None] * np.array(AIRCRAFT_B)[:, None]
    mode = _sampled(A, B, AIRCRAFT_SAMPLING, disturbance_bound)
    limits = np.array(AIRCRAFT_STATE_LIMITS)
    return PWASystem([mode], Polytope.box(-limits, limits), _cube(AIRCRAFT_INPUT_LIMIT, 1))


def quadrotor_plant(disturbance_bound: float = QUADROTOR_DISTURBANCE) -> PWASystem:
    """The position dynamics of a quadrotor with an ideal attitude controller: n = 6, m = 3, one mode.

    The inputs are the pitch angle theta, the roll angle phi and the thrust per mass tau. They determine the
    acceleration of the position p in R^3,

        d^2p/dt^2 = (g tan theta, -g tan phi, tau - g),

    with |tan theta|, |tan phi| <= pi / 9 and 0 <= tau <= 2 g. The model is discretised exactly, with the inputs
    constant between the samples.

    Parameters
    ----------
    disturbance_bound : float
        D = {d : |d|_inf <= disturbance_bound}, in m and m/s.

    Returns
    -------
    PWASystem
        x = (p, dp/dt) relative to a hovering point, and u = (tan theta, tan phi, tau - g) in units of the largest
        values (pi / 9, pi / 9, g).

    Raises
    ------
    ValueError
        If the bound is negative.

    Notes
    -----
    The quadrotor of [Hu2020] and [Everett2021]; g and U are those of the code published with [Everett2021], whose
    sampling time is 0.1 s. The sampling time of 0.2 s, X and the disturbance are our choice.

    Examples
    --------
    >>> quadrotor_plant()
    PWASystem(1 mode, 6 states, 3 inputs)
    """
    g = QUADROTOR_GRAVITY
    A, B = np.zeros((6, 6)), np.zeros((6, 3))
    A[:3, 3:], B[3:] = np.eye(3), np.diag([g * QUADROTOR_TILT, -g * QUADROTOR_TILT, g])
    mode = _sampled(A, B, QUADROTOR_SAMPLING, disturbance_bound)
    return PWASystem([mode], _cube(QUADROTOR_STATE_LIMIT, 6), _cube(1.0, 3))


def chessboard(state_set: Polytope, input_set: Polytope, cells: int = 3) -> list[Polytope]:
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

    Raises
    ------
    ValueError
        If `cells` is not a whole number of at least 1.

    Examples
    --------
    >>> X, U = Polytope.box([-6, -6], [6, 6]), Polytope.box([-2], [2])
    >>> [region.bounding_box()[1].tolist() for region in chessboard(X, U, cells=2)]
    [[0.0, 0.0, 2.0], [0.0, 6.0, 2.0], [6.0, 0.0, 2.0], [6.0, 6.0, 2.0]]
    """
    cells = whole_number(cells, "cells", 1)
    lower, upper = state_set.bounding_box()
    axes = [list(pairwise(np.linspace(low, high, cells + 1))) for low, high in zip(lower, upper)]
    return [Polytope.box(*np.transpose(sides)).product(input_set) for sides in product(*axes)]


def _bound(disturbance_bound: float) -> float:
    """The bound itself; ValueError if it is negative."""
    if not disturbance_bound >= 0:
        raise ValueError(f"disturbance_bound must be at least 0; got {disturbance_bound}")
    return disturbance_bound


def _sampled(A: Array, B: Array, time: float, disturbance_bound: float) -> Mode:
    """The discretisation of dx/dt = A x + B u with constant u, as the only Mode of a system; |d|_inf <= the bound."""
    n, m = B.shape
    sampled = expm(time * np.block([[A, B], [np.zeros((m, n + m))]]))[:n]
    everywhere = Polytope(np.zeros((1, n + m)), np.ones(1))
    return Mode(sampled[:, :n], sampled[:, n:], np.zeros(n), everywhere, _cube(_bound(disturbance_bound), n))


def _cube(limit: float, n: int) -> Polytope:
    """{x in R^n : |x|_inf <= limit}."""
    return Polytope.box(np.full(n, -limit), np.full(n, limit))


def _quadrant(signs: Sequence[int]) -> Polytope:
    """{(x, u) : signs_i x_i >= 0} for x in the plane and one input."""
    return Polytope(np.array([[-signs[0], 0, 0], [0, -signs[1], 0]]), np.zeros(2))
