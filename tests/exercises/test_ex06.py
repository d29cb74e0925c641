"""Exercise 06: plausible mistakes are told what is wrong."""

import numpy as np
import pytest

import mireach as mr
from mireach.exercises import Wrong, ex06


def test_a_side_without_the_disturbance_is_off(solved):
    with pytest.raises(Wrong, match=r"top.* is off by"):
        ex06.check_t1(lambda limit, bound: 0.837 * limit, solved["bottom"])


def test_a_side_for_the_papers_limits_only_is_off(solved):
    with pytest.raises(Wrong, match=r"bottom.* is off by"):
        ex06.check_t1(solved["top"], lambda limit, bound: -11.26)


def iterate(loop, C, most, cut=True, last=True, shift=0):
    """The iteration, with mistakes that can be switched on."""
    X = F = loop.system.state_set
    for k in range(most + 1):
        image = mr.outer_step(loop, F, C)
        if image.is_subset(X, tol=1e-9):
            return (F if last else image), k + shift
        F = image & X if cut else image
    return (None, None) if cut else (F, k)


@pytest.mark.parametrize(
    ("mistake", "hint"),
    [
        ({"cut": False}, "not RPI|but not F_k"),
        ({"last": False}, r"not F_k of eq. \(21\), Fk"),
        ({"shift": 1}, "its number is not"),
    ],
)
def test_mistakes_in_the_iteration_are_told_apart(mistake, hint):
    with pytest.raises(Wrong, match=hint):
        ex06.check_t2(lambda loop, C, most: iterate(loop, C, most, **mistake))


def test_the_last_set_is_no_safe_set():
    def stubborn(loop, C, most):
        F, k = iterate(loop, C, most)
        return (loop.system.state_set, 0) if F is None else (F, k)

    with pytest.raises(Wrong, match="there is none"):
        ex06.check_t2(stubborn)


def test_the_papers_bound_is_not_the_largest():
    with pytest.raises(Wrong, match=r"too small: .* still is a safe set"):
        ex06.check_t3(0.15)


def test_a_bound_beyond_the_threshold_has_no_safe_set(solved):
    with pytest.raises(Wrong, match="too large: just below it"):
        ex06.check_t3(solved["largest_bound"] + 0.01)


@pytest.mark.parametrize(
    ("C", "hint"),
    [
        (mr.box_directions(2), "no safe set with this C"),
        (np.vstack([mr.box_directions(2), [[1.0, 1.0]]]), "no safe set with this C"),
        (mr.directions(8), "at most 5"),
        ([[-1.0, -1.0]], "unbounded"),
    ],
)
def test_templates_that_do_not_do(C, hint):
    with pytest.raises(Wrong, match=hint):
        ex06.check_t4(C)


def test_the_largest_ratio_is_not_the_largest_alpha():
    with pytest.raises(Wrong, match="leaves `before`"):
        ex06.check_t5(lambda before, after: (before.h / after.support(before.H)).max())


def test_offsets_that_are_not_attained_give_too_small_an_alpha():
    def by_offsets(before, after):
        return (before.h / after.h[-len(before.h) :]).min()

    with pytest.raises(Wrong, match="a larger alpha is possible"):
        ex06.check_t5(by_offsets)


def test_the_rows_of_the_smaller_set_do_not_suffice():
    with pytest.raises(Wrong, match="leaves `before`"):
        ex06.check_t5(lambda before, after: (before.support(after.H) / after.support(after.H)).min())


def test_futures_must_respect_the_disturbance_bound(solved):
    with pytest.raises(Wrong, match=r"beyond 0\.15"):
        ex06.check_t6(solved["x0"], 2 * solved["first"], solved["second"])


def test_futures_must_start_in_the_safe_set(solved):
    with pytest.raises(Wrong, match="not in F_max"):
        ex06.check_t6([-10.0, -10.0], solved["first"], solved["second"])


def test_futures_without_a_jump_are_too_close(solved):
    with pytest.raises(Wrong, match=r"only .* apart"):
        ex06.check_t6(solved["x0"], solved["first"], solved["first"])
