"""The closed loop: steps and trajectories against a hand-written loop, equilibria, bad input."""

import numpy as np
import pytest
from loops import affine_loop, evaluate, jump_loop, random_loop, random_network

from mireach import ClosedLoop, MaxoutNetwork, Polytope


def step_by_hand(loop, x):
    """Nominal successors of x, one for each closed region that holds (x, Phi(x))."""
    u = evaluate(loop.network, x)
    xu = np.concatenate([x, u])
    modes = [mode for mode in loop.system.modes if (mode.region.H @ xu <= mode.region.h + 1e-12).all()]
    return [mode.A @ x + mode.B @ u + mode.p for mode in modes]


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(("n", "m"), [(1, 1), (2, 1), (2, 2), (3, 2)])
def test_step_is_that_of_the_mode_that_holds_the_point(seed, n, m):
    loop = random_loop(seed, n, m, cuts=1, with_input=seed % 2 == 0)
    x = loop.system.state_set.sample(np.random.default_rng(seed), 30)
    after = loop.step(x)
    for state, image in zip(x, after):
        assert min(np.abs(image - other).max() for other in step_by_hand(loop, state)) < 1e-10
        np.testing.assert_allclose(loop.step(state), image, atol=1e-12)
        np.testing.assert_allclose(loop.step(state, np.full(n, 0.25)), image + 0.25, atol=1e-12)


def test_step_on_a_shared_boundary_takes_the_first_mode():
    loop = jump_loop([1, 0], [-1, 2])
    assert loop.step([1.0, 0.0]).tolist() == [1, 0] and loop.step([1.1, 0.0]).tolist() == [-1, 2]


def test_trajectories_follow_step_and_end_where_the_state_set_does():
    loop = affine_loop(2 * np.eye(2), limits=1.0)
    path = loop.simulate([0.3, 0.0], 5)
    assert path[:3, 0].tolist() == [0.3, 0.6, 1.2] and np.isnan(path[3:]).all()
    with pytest.raises(ValueError, match=r"x = \[1\.2, 0\.0\] lies outside the state set"):
        loop.step([1.2, 0.0])
    batch = loop.simulate([[0.3, 0.0], [0.0, 0.1]], 2)
    assert batch.shape == (2, 3, 2) and batch[1, 2].tolist() == [0, 0.4]


def test_given_disturbances_are_added_in_order():
    loop = affine_loop(0.5 * np.eye(2))
    d = np.array([[0.1, 0], [0, 0.2]])
    path = loop.simulate([0.4, 0.0], 2, d)
    np.testing.assert_allclose(path, [[0.4, 0], [0.3, 0], [0.15, 0.2]])
    both = loop.simulate([[0.4, 0.0], [0, 0]], 2, np.stack([d, -d]))
    np.testing.assert_allclose(both[1], [[0, 0], [-0.1, 0], [-0.05, -0.2]])


def test_random_disturbances_are_those_of_the_mode_and_repeat_with_the_seed():
    sets = [Polytope.box([0.1, 0], [0.2, 0]), Polytope.box([0, -0.3], [0, -0.3])]
    loop = jump_loop([0, 0], [3, 0], sets)
    start = np.array([[0.0, 0.0], [2.0, 0.0]])
    first = loop.simulate(start, 20, np.random.default_rng(3))
    np.testing.assert_array_equal(first, loop.simulate(start, 20, np.random.default_rng(3)))
    assert ((first[0, 1:, 0] >= 0.1 - 1e-12) & (first[0, 1:, 0] <= 0.2 + 1e-12)).all() and (first[0, 1:, 1] == 0).all()
    np.testing.assert_allclose(first[1, 1:], np.tile([3, -0.3], (20, 1)))


def test_equilibrium_by_hand():
    loop = affine_loop([[0.5, 0.1], [0, 0.2]], p=[0.1, 0.4])
    np.testing.assert_allclose(loop.equilibrium(), np.linalg.solve([[0.5, -0.1], [0, 0.8]], [0.1, 0.4]), atol=1e-10)


@pytest.mark.parametrize("factor", [1.5, -1.5], ids=["repels", "repels and flips"])
def test_equilibrium_that_repels_is_found_too(factor):
    loop = affine_loop(factor * np.eye(2), p=[0.1, 0.05])
    x = loop.equilibrium()
    np.testing.assert_allclose(loop.step(x), x, atol=1e-9)


def test_loop_that_jumps_over_its_equilibrium_has_none():
    with pytest.raises(ValueError, match="no equilibrium was found"):
        jump_loop([2, 0], [-1, 0]).equilibrium()


@pytest.mark.parametrize("seed", range(8))
def test_equilibrium_stays_where_it_is_if_one_is_found(seed):
    loop = random_loop(seed, cuts=1)
    try:
        x = loop.equilibrium()
    except ValueError as error:
        assert "no equilibrium was found" in str(error)
    else:
        assert min(np.abs(image - x).max() for image in step_by_hand(loop, x)) < 1e-9


@pytest.mark.parametrize("rng", [0, 7, np.random.default_rng(3)])
def test_equilibrium_that_repels_does_not_depend_on_the_random_starts(rng):
    loop = affine_loop(1.5 * np.eye(2), p=[0.1, 0.05])
    np.testing.assert_allclose(loop.equilibrium(rng), [-0.2, -0.1], atol=1e-9)


def test_torch_module_becomes_a_network():
    torch = pytest.importorskip("torch")
    loop = affine_loop(np.eye(2))
    module = torch.nn.Sequential(torch.nn.Linear(2, 1), torch.nn.Hardtanh())
    with pytest.raises(ValueError, match="cannot import Hardtanh"):
        ClosedLoop(loop.system, module)
    module = torch.nn.Sequential(torch.nn.Linear(2, 1))
    module[0].weight.data[:], module[0].bias.data[:] = 0.1, 0.2
    assert isinstance(ClosedLoop(loop.system, module).network, MaxoutNetwork)


def test_a_loop_is_shown_by_its_sizes():
    assert str(affine_loop(np.eye(2))) == "ClosedLoop(1 mode, 2 states, 1 input, 0 binaries)"
    with pytest.raises(TypeError, match="system must be of the kind PWASystem"):
        ClosedLoop(None, affine_loop(np.eye(2)).network)


def test_with_disturbance_keeps_the_rest():
    loop, D = affine_loop(np.eye(2)), Polytope.box([-1, 0], [1, 0])
    other = loop.with_disturbance(D)
    assert other.network is loop.network and other.system.modes[0].disturbance is D
    assert loop.system.modes[0].disturbance is not D


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda s: ClosedLoop(s, random_network(np.random.default_rng(0), 3, 1)), ["3 inputs", "2 entries"]),
        (lambda s: ClosedLoop(s, random_network(np.random.default_rng(0), 2, 2)), ["2 outputs", "1 entries"]),
        (
            lambda s: ClosedLoop(s, MaxoutNetwork((), [[3.0, 0]], [0.0])),
            ["leaves the input set", "x = [", "u = [", "saturate"],
        ),
        (lambda s: affine_loop(np.eye(2)).step([0.0, 0, 0]), ["x has shape (3,)", "2"]),
        (lambda s: affine_loop(np.eye(2)).step([np.nan, 0]), ["outside the state set"]),
        (lambda s: affine_loop(np.eye(2)).simulate([0.0], 3), ["x0 has shape (1,)", "2"]),
        (lambda s: affine_loop(np.eye(2)).simulate([0.0, 0], 3, np.zeros((2, 2))), ["(2, 2)", "(1, 3, 2)"]),
        (lambda s: affine_loop(np.eye(2)).simulate([0.0, 0], 1, [[np.nan, 0]]), ["disturbances must be finite"]),
    ],
)
def test_bad_arguments_are_named(make, words):
    with pytest.raises(ValueError) as error:
        make(affine_loop(np.eye(2)).system)
    assert all(word in str(error.value) for word in words), str(error.value)
