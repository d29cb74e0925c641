"""Exercise 03: plausible wrong answers are caught, with a hint that names what is violated."""

from types import SimpleNamespace

import cvxpy as cp
import numpy as np
from helpers import expect, run_source

import mireach as mr
from mireach.exercises import ex03


def test_one_mode_on_a_boundary_and_four_successors_of_the_origin_are_caught():
    expect(ex03.check_t1, [(1, 1), (1, 1), (1, 1), (1, 1)], "x = (0.0, 5.0)", "closed")
    expect(ex03.check_t1, [(1, 1), (2, 2), (2, 2), (4, 4)], "x = (0.0, 0.0)", "4 different successors")
    wrong = run_source(3, {"ex03_t1": "counts = [(1, 1), (2, 2)]"})["counts"]
    expect(ex03.check_t1, wrong, "must have shape (4, 2)")


def model(region_M=None, next_M=None, tied=True, chosen=True):
    """A step_model with flaws: other big-M, x~ of a mode that is off not tied to zero, or no sum of gamma."""

    def step_model(system, xi, XU):
        gamma, constraints, parts = cp.Variable(len(system.modes), boolean=True), [], []
        if chosen:
            constraints.append(cp.sum(gamma) == 1)
        for on, mode in zip(gamma, system.modes):
            H, h, AB = mode.region.H, mode.region.h, np.hstack([mode.A, mode.B])
            part, off = cp.Variable(system.state_size), 1 - on
            M = region_M(H, h, XU) if region_M else np.maximum(XU.support(H) - h, 0)
            L = next_M(AB, mode.p, XU) if next_M else np.maximum(XU.support(AB) + mode.p, XU.support(-AB) - mode.p)
            rest = AB @ xi + mode.p - part
            constraints += [H @ xi <= h + cp.multiply(M, off), -L * off <= rest, rest <= L * off]
            if tied:
                constraints += [-L * on <= part, part <= L * on]
            parts.append(part)
        return sum(parts), constraints

    return step_model


def test_big_M_that_forgets_the_offset_h_or_p_is_caught():
    tight = lambda H, h, XU: 0.2 * np.maximum(XU.support(H) - h, 0)  # noqa: E731
    expect(ex03.check_t2, model(region_M=tight), "no solution", "gamma_i = 0")
    expect(ex03.check_t2, model(next_M=lambda AB, p, XU: XU.support(AB)), "no solution", "not silent there")


def test_model_without_ties_or_without_the_sum_of_gamma_is_caught():
    expect(ex03.check_t2, model(tied=False), "x~ of a mode that is off is not zero")
    expect(ex03.check_t2, lambda system, xi, XU: (cp.Variable(system.state_size), []), "x+ is unbounded")
    expect(ex03.check_t2, model(chosen=False), "mode")


def with_regions(change):
    """The right model of a system whose regions are changed: change(number, Polytope) -> Polytope."""

    def step_model(system, xi, XU):
        modes = [mr.Mode(m.A, m.B, m.p, change(i, m.region)) for i, m in enumerate(system.modes, start=1)]
        return model()(SimpleNamespace(modes=modes, state_size=system.state_size), xi, XU)

    return step_model


def test_loose_big_M_is_no_mistake():
    ex03.check_t2(model(region_M=lambda H, h, XU: np.full(len(h), 50.0)))


def test_a_round_number_for_every_big_M_is_caught():
    hundred = model(lambda H, h, XU: np.full(len(h), 100.0), lambda AB, p, XU: np.full(len(p), 100.0))
    expect(ex03.check_t2, hundred, "no solution", "too small for the next state")


def test_model_that_ignores_the_regions_is_caught():
    everywhere = with_regions(lambda i, P: mr.Polytope(0 * P.H, np.ones(len(P.h))))
    expect(ex03.check_t2, everywhere, "a mode acts outside its region")


def test_model_that_takes_the_first_mode_on_a_boundary_is_caught():
    second_is_open = with_regions(lambda i, P: mr.Polytope(P.H, P.h - 1e-3 * (i == 2)))
    expect(ex03.check_t2, second_is_open, "the model has lost this mode")


def test_other_things_than_a_model_are_caught():
    expect(ex03.check_t2, lambda system, xi, XU: xi, "the pair (x+, constraints)")
    expect(ex03.check_t2, lambda system, xi, XU: (xi, []), "expression of shape (1,)")


def test_witness_is_replayed():
    expect(ex03.check_t3, ([3.0, 1.0], 0.0, 1), "refutes nothing")
    expect(ex03.check_t3, ([3.0, 1.0], 0.0, 2), "mode 2 does not act", "violated by 1")
    expect(ex03.check_t3, ([1.0, 0.0], 0.0, 2), "is not in F")
    expect(ex03.check_t3, ([4.0, 0.0], 2.0, 2), "is not in U")
    expect(ex03.check_t3, ([4.0, 0.0], 0.0, 0), "mode must be a whole number from 1 to 4")


def test_share_of_the_length_and_share_beyond_one_are_caught():
    expect(ex03.check_t4, lambda M: min(M / 10, 1), "40,000 random states", "needs M =")
    expect(ex03.check_t4, lambda M: (M / 10) ** 2, "you say")


def mode(A, B, p, *rows):
    """A mode of a one-state system, its region given by rows (a, b, limit): a x + b u <= limit."""
    rows = np.array(rows, float)
    return mr.Mode([[A]], [[B]], [p], mr.Polytope(rows[:, :2], rows[:, 2]))


def test_friction_with_regions_of_x_alone_with_gaps_or_wrong_sign_is_caught():
    of_x = [
        mode(1, 0.5, -0.1, (-1, 0, -0.1)),
        mode(0, 0, 0, (1, 0, 0.1), (-1, 0, 0.1)),
        mode(1, 0.5, 0.1, (1, 0, -0.1)),
    ]
    expect(ex03.check_t5, of_x, "the next velocity is", "v = x + 0.5 u")
    regions = (-1, -0.5, -0.1), (1, 0.5, -0.1)
    expect(ex03.check_t5, [mode(1, 0.5, -0.1, regions[0]), mode(1, 0.5, 0.1, regions[1])], "no piecewise-affine system")
    rest = mode(0, 0, 0, (1, 0.5, 0.1), (-1, -0.5, 0.1))
    flipped = [mode(1, 0.5, 0.1, regions[0]), rest, mode(1, 0.5, -0.1, regions[1])]
    expect(ex03.check_t5, flipped, "your mode", "but the next velocity is")
    expect(ex03.check_t5, [1, 2, 3], "list of mr.Mode")
