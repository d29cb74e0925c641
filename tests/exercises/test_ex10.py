"""Exercise 10: plausible wrong answers are caught, with a hint that names what is violated."""

import numpy as np
import pytest
from helpers import expect, expect_hint, run_source

import mireach as mr
from mireach.analysis.maximal_set import carried_out
from mireach.exercises import ex10


@pytest.fixture(scope="module")
def solved():
    return run_source(10)


def test_a_target_that_is_not_widened_or_widened_the_wrong_way_is_caught():
    def with_offsets(offsets):
        return lambda C, M, c, D, T: mr.Polytope(T.H @ M, offsets(D, T) - T.H @ c) & C

    # D is not about the origin, so this set is too small in one place and may be too large in another
    expect(ex10.check_t1, with_offsets(lambda D, T: T.h), "d leads into T")
    expect(ex10.check_t1, with_offsets(lambda D, T: T.h + D.support(T.H)), "x")
    expect(ex10.check_t1, with_offsets(lambda D, T: T.h + 2), "no d leads into T, it misses by")


def test_a_forgotten_cell_and_a_forgotten_offset_are_caught(solved):
    expect(ex10.check_t1, lambda C, M, c, D, T: mr.Polytope(T.H @ M, T.h + D.support(-T.H) - T.H @ c), "cell C")
    expect(ex10.check_t1, lambda C, M, c, D, T: solved["lost_in_cell"](C, M, 0 * c, D, T), "T")
    expect(ex10.check_t1, lambda C, M, c, D, T: C.vertices(), "must be a Polytope; got ndarray")


def test_one_step_is_not_enough_and_too_much_is_too_much(solved):
    def once(loop):
        S = mr.Region.of(loop.system.state_set)
        return S - carried_out(loop, S), 1

    expect(ex10.check_t2, once, "too large", "can be carried out of your set in one step")

    def smaller(loop):
        S, k = solved["shrink"](loop)
        return S & loop.system.state_set.scale(0.9), k

    expect(ex10.check_t2, smaller, "too small", "stays in the maximal set")
    expect(ex10.check_t2, lambda loop: (solved["shrink"](loop)[0], 40), "you count 40 steps")
    expect(ex10.check_t2, lambda loop: solved["shrink"](loop)[0], "a Region and a number")


def test_states_that_leave_at_once_or_never_are_caught():
    push = np.full((3, 2), 0.1186)
    expect_hint(ex10.check_t3, [5.9, 5.9], push, words=["a single step can lead out"])
    expect_hint(ex10.check_t3, [0, 0], push, words=["inside X"])
    expect_hint(ex10.check_t3, [-3, 5.5], 2 * push, words=["larger than 0.1186"])
    expect_hint(ex10.check_t3, [7, 0], push, words=["outside X"])
    expect_hint(ex10.check_t3, [-3, 5.5], push[:1], words=["it takes two"])


def test_bounds_that_are_too_large_or_too_small_are_caught(solved):
    expect(ex10.check_t4, solved["largest"] + 0.002, "too large", "driven out")
    expect(ex10.check_t4, solved["largest"] - 0.003, "not the largest")
    expect(ex10.check_t4, -1, "negative")
