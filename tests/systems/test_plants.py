"""The plants of the case studies against the paper's formulas, written out again by hand."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mireach.systems.plants import (
    aircraft_pitch_plant,
    chessboard,
    double_integrator_plant,
    four_tanks_plant,
    pwa_plant,
    quadrotor_plant,
    three_tanks_plant,
)


def quadrant_successor(x, u):
    """Case 1 by its quadrants."""
    if x[0] > 0:
        A = [[-0.04, -0.461], [-0.139, 0.341]] if x[1] > 0 else [[0.936, 0.323], [0.788, -0.049]]
    else:
        A = [[-0.022, 0.644], [0.758, 0.271]] if x[1] > 0 else [[-0.857, 0.815], [0.491, 0.62]]
    return np.array([A[0][0] * x[0] + A[0][1] * x[1] + u[0], A[1][0] * x[0] + A[1][1] * x[1]])


def test_pwa_plant_in_every_quadrant():
    system, rng = pwa_plant(), np.random.default_rng(0)
    points, inputs = rng.uniform(-10, 10, (50, 2)), rng.uniform(-1, 1, (50, 1))
    for x, u in zip(points, inputs):
        (active,) = np.flatnonzero(system.violation(x[None], u[None])[0] == 0)
        np.testing.assert_allclose(system.modes[active].successor(x, u), quadrant_successor(x, u), atol=1e-14)


def test_pwa_plant_regions_are_closed():
    assert (pwa_plant().violation(np.zeros((1, 2)), np.ones((1, 1))) == 0).all()


def three_tanks_successor(x, u):
    """Case 3 in metres and seconds, by the flows through its five pipes."""
    h, area, pipe = np.array([0.3, 0.3, 0.2]) + x / 100, 0.0154, 2e-5
    k, kappa = pipe * np.sqrt(2 * 9.81 / 0.62), pipe * np.sqrt(2 * 9.81 / (0.62 - 0.3))
    resting = k * 0.1
    low, high = k * (h[:2] - h[2]), kappa * (np.maximum(h[:2], 0.3) - np.maximum(h[2], 0.3))
    change = [*(resting + 1e-4 * u - low - high), (low + high).sum() - k * h[2]]
    return (h + 10 * np.array(change) / area - [0.3, 0.3, 0.2]) * 100


def test_three_tanks_in_every_mode():
    system, rng = three_tanks_plant(), np.random.default_rng(0)
    seen = set()
    for x, u in zip(system.state_set.sample(rng, 100), system.input_set.sample(rng, 100)):
        (active,) = np.flatnonzero(system.violation(x[None], u[None])[0] == 0)
        np.testing.assert_allclose(system.modes[active].successor(x, u), three_tanks_successor(x, u), atol=1e-12)
        seen.add(int(active))
    assert seen == {0, 1, 2, 3}


def test_three_tanks_modes_meet_at_rest_and_agree_where_they_meet():
    system, rest = three_tanks_plant(), np.zeros((1, 3))
    assert (system.violation(rest, np.zeros((1, 2))) == 0).all()
    x, u = np.array([0.0, 0.0, -4.0]), np.array([0.3, -0.1])
    for mode in system.modes:
        np.testing.assert_array_equal(mode.successor(np.zeros(3), np.zeros(2)), np.zeros(3))
        np.testing.assert_allclose(mode.successor(x, u), system.modes[0].successor(x, u), atol=1e-14)


def four_tanks_levels(x, u):
    """Case 4 by Torricelli's law, its deviations made so small that the linearisation is exact; 5 s later."""
    area, outlet = np.array([28, 32, 28, 32]), np.array([0.071, 0.057, 0.071, 0.057])
    level, small = np.array([12.4, 12.7, 1.8, 1.4]), 1e-4

    def flows(h, v):
        out = outlet * np.sqrt(2 * 981 * h)
        k1v1, k2v2 = 3.33 * v[0], 3.35 * v[1]
        return np.array([out[2] + 0.7 * k1v1, out[3] + 0.6 * k2v2, 0.4 * k2v2, 0.3 * k1v1]) - out

    rest = flows(level, [3, 3])  # the printed levels are rounded, so they are not quite at rest

    def derivative(_, h):
        return (flows(h, [3 + small * u[0], 3 + small * u[1]]) - rest) / area

    return (solve_ivp(derivative, (0, 5), level + small * x, rtol=1e-12, atol=1e-13).y[:, -1] - level) / small


def test_four_tanks_is_the_linearisation_of_torricelli_s_law():
    system, rng = four_tanks_plant(), np.random.default_rng(0)
    (mode,) = system.modes
    for x, u in zip(system.state_set.sample(rng, 5), system.input_set.sample(rng, 5)):
        np.testing.assert_allclose(mode.successor(x, u), four_tanks_levels(x, u), atol=2e-4)


def test_four_tanks_time_constants_are_the_paper_s():
    decay = np.log(np.diag(four_tanks_plant().modes[0].A))
    np.testing.assert_array_equal(np.floor(-5 / decay).astype(int), [62, 90, 23, 29])  # the paper prints 62, 90, 23, 30


def aircraft_pitch_successor(x, u):
    """Case 5 in radians, by its differential equations; half a second later, in degrees."""
    alpha, rate, theta = np.radians(x)
    delta = np.radians(u[0])

    def derivative(_, z):
        return [
            -0.313 * z[0] + 56.7 * z[1] + 0.232 * delta,
            -0.0139 * z[0] - 0.426 * z[1] + 0.0203 * delta,
            56.7 * z[1],
        ]

    alpha, q, theta = solve_ivp(derivative, (0, 0.5), [alpha, rate / 56.7, theta], rtol=1e-12, atol=1e-13).y[:, -1]
    return np.degrees([alpha, 56.7 * q, theta])


def test_aircraft_pitch_is_that_of_its_differential_equations():
    system, rng = aircraft_pitch_plant(), np.random.default_rng(0)
    (mode,) = system.modes
    for x, u in zip(system.state_set.sample(rng, 5), system.input_set.sample(rng, 5)):
        np.testing.assert_allclose(mode.successor(x, u), aircraft_pitch_successor(x, u), atol=1e-9)


def test_aircraft_pitch_has_the_printed_denominator():
    poles = np.log(np.linalg.eigvals(aircraft_pitch_plant().modes[0].A).astype(complex)) / 0.5
    np.testing.assert_allclose(np.poly(poles), [1, 0.739, 0.921, 0], atol=5e-4)  # s^3 + 0.739 s^2 + 0.921 s


def test_quadrotor_accelerates_by_its_tilt_and_its_thrust():
    system, rng, T = quadrotor_plant(), np.random.default_rng(0), 0.2
    (mode,) = system.modes
    for x, u in zip(system.state_set.sample(rng, 20), system.input_set.sample(rng, 20)):
        p, v, (tan_pitch, tan_roll), thrust = x[:3], x[3:], u[:2] * np.pi / 9, 9.8 + 9.8 * u[2]
        a = np.array([9.8 * tan_pitch, -9.8 * tan_roll, thrust - 9.8])
        assert 0 <= thrust <= 2 * 9.8
        np.testing.assert_allclose(mode.successor(x, u), [*(p + T * v + T**2 / 2 * a), *(v + T * a)], atol=1e-12)


@pytest.mark.parametrize("bound", [0.15, 0.0, 0.3])
def test_pwa_plant_sets(bound):
    system = pwa_plant(bound)
    lower, upper = system.modes[2].disturbance.bounding_box()
    np.testing.assert_array_equal([lower, upper], [[-bound] * 2, [bound] * 2])
    np.testing.assert_array_equal(system.state_set.bounding_box(), [[-10, -10], [10, 10]])
    np.testing.assert_array_equal(system.input_set.bounding_box(), [[-1], [1]])


@pytest.mark.parametrize(
    "plant", [pwa_plant, three_tanks_plant, four_tanks_plant, aircraft_pitch_plant, quadrotor_plant]
)
def test_plants_refuse_a_negative_bound(plant):
    with pytest.raises(ValueError, match="disturbance_bound"):
        plant(-0.1)


def test_double_integrator():
    system = double_integrator_plant()
    x, u = np.array([2.0, -3.0]), np.array([1.5])
    expected = np.array([[1, 1], [0, 1]]) @ x + np.array([0.5, 1]) * u + 0.025 * (x @ x)
    np.testing.assert_allclose(system(x, u), expected, atol=1e-14)
    np.testing.assert_allclose(system(np.tile(x, (4, 1)), np.tile(u, (4, 1))), np.tile(expected, (4, 1)), atol=1e-14)
    np.testing.assert_array_equal(system.state_set.bounding_box(), [[-6, -6], [6, 6]])
    np.testing.assert_array_equal(system.input_set.bounding_box(), [[-2], [2]])


def test_chessboard_squares():
    system = double_integrator_plant()
    regions = chessboard(system.state_set, system.input_set)
    centres = [(a, b) for a in (-4, 0, 4) for b in (-4, 0, 4)]
    assert len(regions) == 9
    for region, (a, b) in zip(regions, centres):
        lower, upper = region.bounding_box()
        np.testing.assert_array_equal(lower, [a - 2, b - 2, -2])
        np.testing.assert_array_equal(upper, [a + 2, b + 2, 2])


def test_chessboard_refuses_no_cells():
    system = double_integrator_plant()
    with pytest.raises(ValueError, match="cells"):
        chessboard(system.state_set, system.input_set, cells=0)
