"""Exercise 04: plausible wrong answers are caught, with a hint that names what is violated."""

import numpy as np
import pytest
from helpers import expect_hint

import mireach as mr
from mireach.exercises import Wrong, ex04


def test_the_modes_have_binaries_too():
    expect_hint(ex04.check_t1, lambda loop, k: k * loop.network.binaries, words=["binary variables more", "modes"])


def test_every_step_has_its_own_binaries():
    expect_hint(ex04.check_t1, lambda loop, k: len(loop.system.modes) + loop.network.binaries, words=["k = 3", "more"])


def test_one_mode_is_not_enough_on_a_boundary():
    def first_mode(system, x, u, C):
        mode = next(m for m in system.modes if m.region.contains(np.concatenate([x, u]), tol=1e-9))
        return C @ mode.successor(x, u) + mode.disturbance.support(C)

    expect_hint(ex04.check_t2, first_mode, words=["but mode", "leads to"])


def test_every_mode_is_too_much():
    def all_modes(system, x, u, C):
        return np.max([C @ m.successor(x, u) + m.disturbance.support(C) for m in system.modes], axis=0)

    expect_hint(ex04.check_t2, all_modes, words=["which no mode whose region contains (x, u) attains"])


def test_the_disturbance_is_part_of_the_step():
    def nominal(system, x, u, C):
        met = [m for m in system.modes if m.region.contains(np.concatenate([x, u]), tol=1e-9)]
        return np.max([C @ m.successor(x, u) for m in met], axis=0)

    with pytest.raises(Wrong, match="you return"):
        ex04.check_t2(nominal)


def test_what_task_3_says_about_its_set():
    loop = mr.case_study("pwa").loop
    assert mr.check_rpi(loop, ex04.REFUTE).verdict == "refuted"
    nominal = loop.with_disturbance(mr.Polytope.box([0, 0], [0, 0]))
    assert mr.check_rpi(nominal, ex04.REFUTE).verdict == "proven"
    rng = np.random.default_rng(0)
    after = loop.simulate(ex04.REFUTE.sample(rng, 5000), 1, rng)[:, 1]
    assert ex04.REFUTE.contains(after).all()


def test_witness_has_to_hold():
    expect_hint(ex04.check_t3, [-7.6, -10], [0, 0], words=["still in F", "is left to the nearest facet"])
    expect_hint(ex04.check_t3, [-7.6, -10], [0, -0.2], words=["disturbance", "is not in D^(3)", "0.15"])
    expect_hint(ex04.check_t3, [-8, -10], [0, -0.15], words=["state", "is not in F", "7.6"])
    expect_hint(ex04.check_t3, [-7, -9], [0, -0.15], words=["still in F"])
    expect_hint(ex04.check_t3, [-7.6, -10, 0], [0, -0.15], words=["state must have shape (2,)"])


def test_a_witness_found_by_the_library_counts():
    step = mr.check_rpi(mr.case_study("pwa").loop, ex04.REFUTE).witness
    ex04.check_t3(step.states[0], step.disturbances[0])


def test_what_task_4_says_about_its_set():
    assert mr.check_rpi(mr.case_study("pwa").loop, ex04.KEEP).verdict == "proven"


def test_largest_bound_is_neither_smaller_nor_larger(solved):
    expect_hint(ex04.check_t4, 0.15, words=["still RPI", "not the largest"])
    expect_hint(ex04.check_t4, solved["beta"] + 0.02, words=["is not RPI", "facet"])
    expect_hint(ex04.check_t4, -0.1, words=["has to be positive"])
    expect_hint(ex04.check_t4, "0.1 or so", words=["array of numbers"])


def test_the_other_set_must_be_better_nowhere(solved):
    a, beta = solved["best_a"], solved["best_beta"]
    expect_hint(ex04.check_t5, 7.4, 0.15, words=["the bound may be larger"])
    expect_hint(ex04.check_t5, a, beta - 0.05, words=["already with your a"])
    expect_hint(ex04.check_t5, a + 0.1, beta, words=["not RPI", "facet 4"])
    expect_hint(ex04.check_t5, a - 0.1, beta, words=["not RPI", "facet 3"])
    expect_hint(ex04.check_t5, 12, 0.1, words=["between 0 and 10"])


def test_template_must_be_small_and_bounded():
    expect_hint(ex04.check_t6, mr.box_directions(2), words=["which is 1.00 of the box's"])
    expect_hint(ex04.check_t6, mr.box_directions(2) @ [[0.96, 0.28], [-0.28, 0.96]], words=["of area"])
    expect_hint(ex04.check_t6, [[1, 0], [0, 1], [1, 1], [-1, 0]], words=["unbounded"])
    expect_hint(ex04.check_t6, mr.directions(8), words=["shape (4, 2)"])
