"""Exercise 08: plausible wrong answers are caught, with a hint that names what is violated."""

import numpy as np
import pytest
from helpers import expect

import mireach as mr
from mireach.exercises import ex08


@pytest.fixture(scope="module")
def case():
    return mr.case_study("double_integrator")


def drift(x):
    """x1+ without input."""
    return x.sum(axis=1) + 0.025 * (x**2).sum(axis=1)


def test_lost_by_the_first_component_alone_is_caught():
    def first_only(x, limit):
        return (drift(x) - limit / 2 > 6) | (drift(x) + limit / 2 < -6)

    expect(ex08.check_t1, first_only, "can be kept in X", "both components")


def test_lost_without_input_is_caught_with_an_input():
    expect(ex08.check_t1, lambda x, limit: np.abs(drift(x)) > 6, "lost, but u =", "leads to")


def test_costs_that_lack_a_term_are_told_which(solved):
    full, step = solved["cost"], solved["plant"]

    def end(x, inputs):
        x = np.asarray(x, float)
        for u in inputs:
            x = step(x, [u])
        return 0.8 * x @ x

    expect(ex08.check_t2, lambda x, u: full(x, u) - end(x, u), "terminal cost", "missing")
    expect(ex08.check_t2, lambda x, u: full(x, u) - 0.1 * float(u @ u), "inputs is missing")
    expect(ex08.check_t2, lambda x, u: full(x, u) / 2, "off by")


def test_costs_that_ignore_constraints_are_caught(solved):
    def careless(x, inputs):
        x, J = np.asarray(x, float), 0.0
        for u in inputs:
            J, x = J + 0.8 * x @ x + 0.1 * u**2, solved["plant"](x, [u])
        return J + 0.8 * x @ x

    expect(ex08.check_t2, careless, "violates", "np.inf")
    expect(ex08.check_t2, lambda x, u: np.inf, "you return inf")


def test_poor_plans_are_caught():
    expect(ex08.check_t3, [-3] + 9 * [0], "input limit")
    expect(ex08.check_t3, 10 * [2], "leaves X", "x(")
    expect(ex08.check_t3, [-2, 0.2, 0.5, 0.5, 0, 0, 0, 0, 0, 0], "costs", "at k =")
    expect(ex08.check_t3, [-2, 0.5], "shape (10,)")


def test_networks_of_the_wrong_kind_are_caught(case, solved):
    expect(ex08.check_t4, case.network, "129 binary", "saturation")
    small = solved["small"]
    raw = mr.MaxoutNetwork(small.hidden[:-2], 3 * small.hidden[-2].weight[:1], 3 * small.hidden[-2].bias[:1])
    expect(ex08.check_t4, raw, "outside |u| <= 2")
    expect(ex08.check_t4, raw.saturate(-2, 2), "mean squared error", "worst error")
    expect(ex08.check_t4, solved["result"], "must be a MaxoutNetwork")


def test_controllers_that_give_themselves_away_are_caught(case):
    def jump(x):
        beyond = x.sum(axis=1, keepdims=True) > 11.5
        return np.where(beyond, -case.network(x), case.network(x))

    def steep(x):
        return np.clip(case.network(x) + 2 * np.maximum(x[:, :1], 0), -2, 2)

    def unbounded(x):
        return case.network(x) + 2 * np.maximum(x.sum(axis=1, keepdims=True) - 7, 0)

    expect(ex08.check_t5, case.network, "at (6, 6)", "less than 1")
    expect(ex08.check_t5, jump, "not continuous")
    expect(ex08.check_t5, steep, "convex combination of data states")
    expect(ex08.check_t5, unbounded, "outside |u| <= 2")
    expect(ex08.check_t5, lambda x: case.network(x)[:, 0], "shape")
