"""The plants of the case studies against the paper's formulas, written out again by hand."""

import numpy as np
import pytest

from mireach.plants import chessboard, double_integrator_plant, pwa_plant


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


@pytest.mark.parametrize("bound", [0.15, 0.0, 0.3])
def test_pwa_plant_sets(bound):
    system = pwa_plant(bound)
    lower, upper = system.modes[2].disturbance.bounding_box()
    np.testing.assert_array_equal([lower, upper], [[-bound] * 2, [bound] * 2])
    np.testing.assert_array_equal(system.state_set.bounding_box(), [[-10, -10], [10, 10]])
    np.testing.assert_array_equal(system.input_set.bounding_box(), [[-1], [1]])


def test_pwa_plant_refuses_a_negative_bound():
    with pytest.raises(ValueError, match="disturbance_bound"):
        pwa_plant(-0.1)


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
