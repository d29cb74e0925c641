"""Reachable sets of the plane and the attractor: against sampling, templates, theory, and exact cells."""

from itertools import pairwise

import numpy as np
import pytest
from loops import affine_loop, evaluate, jump_loop, random_images, random_loop
from regions import draw, square

import mireach as mr
from mireach.analysis import exact_reach
from mireach.arithmetic.rational import nearest
from mireach.engines import exact_cells
from mireach.engines.exact_cells import rows_of
from mireach.engines.units import own_units
from mireach.systems.network import MaxoutNetwork

# -- reachable sets -----------------------------------------------------------------------------------


@pytest.mark.parametrize("with_input", [False, True])
@pytest.mark.parametrize("seed", range(5))
def test_reachable_sets_hold_what_is_sampled_and_have_the_right_support(seed, with_input):
    loop, rng = random_loop(seed, with_input=with_input), np.random.default_rng(seed)
    F, V = loop.system.state_set.scale(0.5), mr.directions(9)
    sets = mr.exact_reach(loop, F, 2)
    for steps in (1, 2):
        R = sets[steps]
        images = random_images(loop, F, rng, 800, steps)
        assert R.contains(images, tol=1e-8).all()
        reached = (R.simplices.points @ V.T).max(axis=0)
        np.testing.assert_allclose(reached, mr.support(loop, F, V, steps=steps).value, atol=1e-8)


def test_reachable_sets_have_no_area_that_nothing_reaches():
    loop, rng = random_loop(1), np.random.default_rng(0)
    F = loop.system.state_set.scale(0.5)
    R = mr.exact_reach(loop, F, 1)[1]
    images = np.vstack([random_images(loop, F, rng, 4000), F.sample(rng, 1)])
    inside = draw(R, rng, 300)[:300]
    near = np.array([np.abs(images - x).max(axis=1).min() for x in inside])
    assert np.mean(near < 0.25) > 0.9  # images take extreme disturbances: the middle of D is not sampled


def test_points_and_segments_have_images():
    still = mr.exact_reach(affine_loop(0.5 * np.eye(2)), mr.Polytope.box([1, 1], [1, 1]), 3)[3]
    assert still.area == 0 and still.contains([0.125, 0.125]) and len(still.pieces) == 1
    R = mr.exact_reach(affine_loop(0.5 * np.eye(2), square(0.1)), mr.Polytope.box([0, 0], [1, 0]), 1)[1]
    assert R.area == pytest.approx(0.7 * 0.2)
    both = mr.exact_reach(jump_loop([0.0, 0.0], [3.0, 0.0]), mr.Polytope.box([1, 0], [1, 0]), 1)[1]
    assert both.contains([[0.0, 0.0], [3.0, 0.0]]).all() and both.components == 2
    mixed = jump_loop([0.0, 0.0], [3.0, 0.0], [mr.Polytope.box([0, 0], [0, 0]), square(0.1)])
    R = mr.exact_reach(mixed, mr.Polytope.box([1, 0], [1, 0]), 1)[1]
    assert R.area == pytest.approx(0.04) and R.components == 2 and R.contains([0.0, 0.0])
    assert mr.exact_reach(affine_loop(np.eye(2)), mr.Polytope.box([5, 5], [6, 6]), 1)[1].is_empty


def test_the_template_covers_the_exact_sets():
    case = mr.case_study("double_integrator")
    F = mr.safe_set(case.loop, case.safe_directions).set
    outer, exactly = mr.outer_reach(case.loop, F, case.directions, 4), mr.exact_reach(case.loop, F, 4)
    assert all(R.is_subset(cover, tol=1e-9) for R, cover in zip(exactly, outer))
    assert mr.Region.of(outer[4]).area > 1.1 * exactly[4].area


def test_the_attractor_is_a_nested_sequence_that_settles_and_is_entered():
    case = mr.case_study("double_integrator")
    S = mr.maximal_safe_set(case.loop, prove=False)
    found = mr.attractor(case.loop, S, tolerance=1e-3)
    assert found.settled and len(found.history) == found.steps + 2
    assert all(after.is_subset(before, tol=1e-9) for before, after in pairwise(found.history))
    assert found.set.is_subset(found.history[-1], tol=1e-3)
    assert not found.history[found.steps - 1].is_subset(found.set, tol=1e-3)
    rng = np.random.default_rng(0)
    paths = case.loop.simulate(draw(S.set, rng, 500), found.steps, rng)
    assert found.set.contains(paths[:, -1], tol=1e-9).all()


def test_the_attractor_of_a_linear_loop_is_the_minimal_set():
    loop = affine_loop(0.5 * np.eye(2), square(0.25))
    found = mr.attractor(loop, square(1), tolerance=1e-6)
    assert found.set.is_subset(mr.Region.of(square(0.5)), tol=2e-6) and mr.Region.of(square(0.5)).is_subset(found.set)
    short = mr.attractor(loop, square(1), tolerance=1e-6, max_steps=3)
    assert not short.settled and short.steps == 2
    with pytest.raises(ValueError, match="no safe set to start from"):
        mr.attractor(loop, mr.maximal_safe_set(affine_loop(0.5 * np.eye(2), square(0.6))))


@pytest.mark.parametrize("gain", [0.5, 120.0, 4800.0])
@pytest.mark.parametrize("size", [1e-6, 1.0, 120.0, 4800.0])
def test_images_are_widened_in_proportion_to_the_largest_coordinate(size, gain):
    """x1+ = gain x2, x2+ = x1 / 2: from a box with half-widths `size` / 2 and `size`, exactly and by one step."""
    loop = affine_loop([[0.0, gain], [0.5, 0.0]], limits=size)
    F = mr.Polytope.box([-size / 2, -size], [size / 2, size])
    widening = 2.0**-36 * size * max(gain, 1)
    for R in (mr.exact_reach(loop, F, 1)[1], mr.attractor(loop, F, tolerance=1e-12 * size, max_steps=1).history[1]):
        upper = R.bounding_box()[1] - [gain * size, size / 4]
        assert (upper > 0.1 * widening).all() and (upper < 2.001 * widening).all()
    found = mr.attractor(loop, F, tolerance=1e-12 * size, max_steps=1)
    np.testing.assert_allclose(found.added, 2 * widening, rtol=1e-9)


@pytest.mark.parametrize("gain", [0.5, 120.0, 4800.0])
@pytest.mark.parametrize("gap", [1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12])
def test_corners_of_x_outside_of_a_set_have_no_part_in_its_image(gap, gain):
    """A corner that nearly touches the set may count, but not by a distance that grows with the image."""
    loop = affine_loop([[0.0, gain], [0.5, 0.0]])
    R = mr.exact_reach(loop, square(1 - gap), 1)[1]
    excess = R.bounding_box()[1] - np.array([gain, 0.5]) * (1 - gap)
    assert (excess >= 0).all() and (excess <= 3e-11 * max(gain, 1)).all()


# -- many pieces --------------------------------------------------------------------------------------


def pendulum_loop(seed, hidden=12, dt=0.05):
    """x+ = Phi(x): a ReLU 2-12-2 network fitted to a pendulum under feedback, random but for its last layer."""
    rng = np.random.default_rng(seed)
    W, b = rng.normal(size=(hidden, 2)), rng.uniform(-0.9, 0.9, hidden)
    W /= np.linalg.norm(W, axis=1)[:, None]
    x = rng.uniform(-1, 1, (4000, 2))
    after = x + dt * np.column_stack([x[:, 1], 2 * np.sin(2 * x[:, 0]) - 8 * x[:, 0] - 3 * x[:, 1]])
    features = np.column_stack([np.maximum(x @ W.T + b, 0), np.ones(len(x))])
    last = np.linalg.lstsq(features, after, rcond=None)[0].T
    weight, bias = np.zeros((2 * hidden, 2)), np.zeros(2 * hidden)
    weight[::2], bias[::2] = W, b
    net = MaxoutNetwork([mr.Layer(weight, bias, 2)], last[:, :-1], last[:, -1])
    mode = mr.Mode(np.zeros((2, 2)), np.eye(2), np.zeros(2), mr.Polytope(np.eye(4)[:1], [100.0]))
    return mr.ClosedLoop(mr.PWASystem([mode], square(1), mr.Polytope.box([-4, -4], [4, 4])), net)


@pytest.mark.parametrize("seed", [1, 3])
def test_the_attractor_of_a_network_with_many_cells_settles(seed):
    """GEOS fails on the union of these images; without cracks there are no holes."""
    loop, rng = pendulum_loop(seed), np.random.default_rng(seed)
    S = mr.maximal_safe_set(loop, slack=1e-5, prove=False).history[-1]
    found = mr.attractor(loop, S, tolerance=1e-2)
    assert found.settled and (found.added < 2 * 1e-2 / 8 * (found.steps + 1)).all()
    for before, after in pairwise(found.history):
        assert after.holes == 0 and after.components == 1
        x = draw(before, rng, 200)
        x = x[loop.system.state_set.contains(x)]
        assert after.contains(np.array([evaluate(loop.network, state) for state in x])).all()
    few = mr.attractor(loop, S, tolerance=1e-9, max_steps=4)
    exactly = mr.exact_reach(loop, S, 4)
    for R, cover in zip(exactly[:4], few.history):
        assert R.is_subset(cover, tol=1e-10) and cover.is_subset(R, tol=few.added.max() * 20)


def test_sets_of_the_attractor_hold_the_exact_images_of_exact_cells():
    loop = pendulum_loop(0)
    found = mr.attractor(loop, square(0.5), tolerance=1e-2, max_steps=1)
    units = own_units(loop)
    assert np.array_equal(units.state, [1, 1])
    first = found.history[1]
    for cell in exact_cells.cells(units.loop):
        part = cell.part.clip_all(rows_of(square(0.5)))
        images = [[nearest(entry) for entry in cell.image(x)] for x in part.vertices]
        assert not images or first.contains(np.array(images)).all()


def test_too_many_parts_are_an_error_that_says_what_to_do(monkeypatch):
    monkeypatch.setattr(exact_reach, "MOST_PARTS", 5)
    loop = pendulum_loop(0)
    with pytest.raises(mr.errors.RegionError, match="take fewer steps"):
        mr.exact_reach(loop, square(0.7), 2)
    with pytest.raises(mr.errors.RegionError, match="larger tolerance"):
        mr.attractor(loop, square(0.7))
