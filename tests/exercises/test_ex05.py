"""Exercise 05: plausible wrong answers are caught, with a hint that names what is violated."""

import numpy as np
import pytest
from helpers import expect_hint

import mireach as mr
from mireach.exercises import ex05
from mireach.learning.mpc import solve_miqp
from mireach.systems.plants import pwa_plant

torch = pytest.importorskip("torch")


def test_cost_agrees_with_the_solver():
    system = pwa_plant()
    for x0 in ((5.0, 5.0), (-7.3, 8.52), (8.0, -6.0)):
        solution = solve_miqp(system, np.array(x0))
        assert ex05._cost(system, np.array(x0), solution.inputs.clip(-1, 1)) == pytest.approx(solution.cost, rel=1e-6)


def test_terminal_state_costs_too(solved):
    def without_end(system, x0, inputs):
        return solved["cost"](system, x0, inputs[:-1]) + inputs[-1] @ inputs[-1]  # ends with x(N - 1)

    expect_hint(ex05.check_t1, without_end, words=["you return", "the states cost", "the inputs"])


def test_constraints_are_part_of_the_problem():
    def never_inf(system, x0, inputs):
        total, x = x0 @ x0, x0
        for u in inputs:
            x = system.modes[int(system.violation(x[None], u[None])[0].argmin())].successor(x, u)
            total += u @ u + x @ x
        return total

    expect_hint(ex05.check_t1, never_inf, words=["so the cost is inf"])


def test_half_plane_has_the_right_side_and_place():
    expect_hint(ex05.check_t2, [0.491, 0.62], -9.8, words=["says no solution", "has one there"])
    expect_hint(ex05.check_t2, [0.491, 0.62], -10.2, words=["says a solution exists", "has none there"])
    expect_hint(ex05.check_t2, [-0.491, -0.62], 10, words=["your half-plane"])
    expect_hint(ex05.check_t2, [0.491, 0.62, 1], -10, words=["shape (2,)"])
    expect_hint(ex05.check_t2, [0, 0], -10, words=["row is zero"])


def test_a_longer_row_is_the_same_half_plane():
    ex05.check_t2([4.91, 6.2], -100)


def test_the_whole_jump_is_too_much():
    expect_hint(ex05.check_t3, 2.0, words=["smallest_error = 2", "more than necessary"])


def test_no_continuous_controller_follows_the_jump():
    expect_hint(ex05.check_t3, 0.0, words=["smallest_error = 0", "too small", "both sides"])


def test_projection_must_be_complete():
    def only_upper(network, lower, upper):
        return project(network, np.full(len(lower), -1e6), upper)

    def same_for_all(network, lower, upper):
        return project(network, np.full(len(lower), lower[0]), np.full(len(lower), upper[0]))

    def forgotten_sign(network, lower, upper):
        done = project(network, lower, upper)
        return mr.MaxoutNetwork(done.hidden, -done.weight, done.bias)

    def project(network, lower, upper):
        return network.saturate(lower, upper)

    ex05.check_t4(project)
    for wrong in (only_upper, same_for_all, forgotten_sign):
        expect_hint(ex05.check_t4, wrong, words=["the raw output", "becomes"])
    expect_hint(
        ex05.check_t4, lambda network, lower, upper: lambda x: network(x).clip(lower, upper), words=["MaxoutNetwork"]
    )


def test_loss_must_clip_and_keep_its_slope():
    expect_hint(ex05.check_t5, lambda z, u, low, high, leak: ((z - u) ** 2).mean(), words=["the formula gives"])
    expect_hint(
        ex05.check_t5,
        lambda z, u, low, high, leak: ((z.clamp(low, high) - u) ** 2).mean(),
        words=["no slope", "wrong side"],
    )
    expect_hint(
        ex05.check_t5,
        lambda z, u, low, high, leak: (z.clamp(low, high) + leak * z - u).pow(2).mean(),
        words=["formula"],
    )
    expect_hint(ex05.check_t5, lambda z, u, low, high, leak: (z - u) ** 2, words=["one number, a mean"])
    expect_hint(
        ex05.check_t5, lambda z, u, low, high, leak: ((z.detach() - u) ** 2).mean(), words=["lost its gradient"]
    )


def test_small_network_must_be_small_good_and_inside(solved):
    expect_hint(ex05.check_t6, mr.case_study("pwa").network, words=["31 binaries", "at most 20"])
    nothing = mr.MaxoutNetwork((), np.zeros((1, 2)), np.zeros(1))
    expect_hint(ex05.check_t6, nothing, words=["mean squared error", "at most 0.05"])
    network = solved["network"]
    raw = mr.MaxoutNetwork(network.hidden[:-2], network.hidden[-2].weight[:1], network.hidden[-2].bias[:1])
    expect_hint(ex05.check_t6, raw, words=["leaves the input set"])
    expect_hint(ex05.check_t6, "done", words=["must be a MaxoutNetwork"])
