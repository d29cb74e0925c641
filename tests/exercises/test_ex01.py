"""Exercise 01: plausible wrong answers are caught, with a hint that names what is violated."""

import numpy as np
import pytest
from helpers import expect, run_source

from mireach.exercises import ex01


def test_every_answer_cell_can_be_replaced():
    assert run_source(1, {"ex01_t4": "count = 12"})["count"] == 12
    with pytest.raises(KeyError, match="ex01_t9"):
        run_source(1, {"ex01_t9": "pass"})


def test_upper_corner_alone_is_caught_with_a_point():
    expect(ex01.check_t1, lambda lower, upper, v: v @ upper, "but the point x =", "v x =")
    expect(ex01.check_t1, lambda lower, upper, v: np.abs(v) @ np.maximum(-lower, upper), "which no point of the box")
    expect(ex01.check_t1, lambda lower, upper, v: v * upper, "must have shape ()")


def test_offsets_that_are_not_added_are_caught():
    expect(ex01.check_t2, lambda P, Q, C: np.maximum(P.support(C), Q.support(C)), "is in P", "C_i (a + b)")
    expect(ex01.check_t2, lambda P, Q, C: P.support(C) + 2 * Q.support(C), "gets further than")
    expect(ex01.check_t2, lambda P, Q, C: (P.support(C) + Q.support(C)).max(), "offsets_of_sum", "must have shape")


def test_inclusion_by_sampling_is_caught():
    def sampled(P, Q):
        x = P.sample(np.random.default_rng(0), 500)
        return next((point for point in x if not Q.contains(point)), None)

    expect(ex01.check_t3, sampled, "h_P - h_Q =", "corner")


def test_points_that_are_no_witness_are_caught():
    expect(ex01.check_t3, lambda P, Q: P.chebyshev()[0], "x =")
    expect(ex01.check_t3, lambda P, Q: None, "you say that P lies in Q")

    def outside_of_both(P, Q):
        return None if P.is_subset(Q, 1e-9) else np.array([50.0, 50.0])

    expect(ex01.check_t3, outside_of_both, "is not in P")


def test_wrong_numbers_of_directions_are_caught():
    expect(ex01.check_t4, 18, "more area than the disc")
    expect(ex01.check_t4, 32, "not the fewest")
    expect(ex01.check_t4, 18.5, "whole number")


def test_factors_that_let_the_box_grow_or_are_too_careful_are_caught():
    expect(ex01.check_t5, lambda theta: 1.0, "it grows", "theta =")
    expect(ex01.check_t5, lambda theta: 1 / np.cos(theta), "it grows")
    expect(ex01.check_t5, lambda theta: 1 / np.sqrt(2), "not the largest")  # the worst angle is not every angle
