"""Nonlinear systems: points, batches, trajectories against a hand-written loop, bad input."""

from itertools import pairwise

import numpy as np
import pytest
from modes import U, X

from mireach import NonlinearSystem, Polytope

PLANT = NonlinearSystem(lambda x, u: (x[1], x[0] * u[0]), X, U)


def test_points_and_batches():
    assert PLANT([1.0, 2.0], [3.0]).tolist() == [2.0, 3.0]
    assert PLANT([[1.0, 2.0], [0.0, 1.0]], [[3.0], [4.0]]).tolist() == [[2.0, 3.0], [1.0, 0.0]]


def test_a_component_that_does_not_depend_on_the_state_is_repeated():
    plant = NonlinearSystem(lambda x, u: (x[0], 0.5), X, U)
    assert plant(np.ones((3, 2)), np.ones((3, 1))).tolist() == [[1.0, 0.5]] * 3


def test_trajectories_follow_f_beyond_the_state_set():
    def controller(x):
        return 1 - x[..., :1]

    starts = np.array([[1.0, 2.0], [5.0, -3.0]])
    paths = PLANT.simulate(controller, starts, 3)
    assert paths.shape == (2, 4, 2)
    for start, path in zip(starts, paths):
        for x, after in pairwise(path):
            assert after.tolist() == [x[1], x[0] * (1 - x[0])]
        np.testing.assert_array_equal(PLANT.simulate(controller, start, 3), path)
    np.testing.assert_array_equal(PLANT.step(controller, starts), paths[:, 1])


def test_bad_arguments_are_named():
    with pytest.raises(ValueError, match="x has shape"):
        PLANT([1.0], [3.0])
    with pytest.raises(ValueError, match="u has shape"):
        PLANT([1.0, 1.0], [3.0, 1.0])
    with pytest.raises(ValueError, match="steps must be a whole number"):
        PLANT.simulate(lambda x: x[..., :1], [1.0, 1.0], 1.5)
    with pytest.raises(TypeError, match="f must be a function"):
        NonlinearSystem("f", X, U)
    with pytest.raises(TypeError, match="input_set must be of the kind Polytope"):
        NonlinearSystem(PLANT.f, X, None)


def test_a_nonlinear_system_is_shown_by_its_sizes():
    assert str(PLANT) == "NonlinearSystem(2 states, 1 input)"
    assert str(NonlinearSystem(PLANT.f, Polytope.box([0], [1]), X)) == "NonlinearSystem(1 state, 2 inputs)"
