"""Exercise 04: solutions pass, placeholders and plausible wrong answers do not."""

import numpy as np
import pytest
from helpers import placeholder, run_source

import mireach as mr
from mireach.exercises import Wrong, ex04

TASKS = {
    "t1": (ex04.check_t1, ["binaries"]),
    "t2": (ex04.check_t2, ["support_of_step"]),
    "t3": (ex04.check_t3, ["state", "disturbance"]),
    "t4": (ex04.check_t4, ["beta"]),
    "t5": (ex04.check_t5, ["best_a", "best_beta"]),
    "t6": (ex04.check_t6, ["C"]),
}


@pytest.fixture(scope="module")
def solved():
    return run_source(4)


@pytest.fixture(scope="module")
def untouched():
    return placeholder(4)


@pytest.mark.parametrize("task", TASKS)
def test_solution_passes(solved, task, capsys):
    check, names = TASKS[task]
    for _ in range(3 if task in ("t1", "t2") else 1):  # these two draw random data
        check(*(solved[name] for name in names))
    assert capsys.readouterr().out.startswith("ok")


@pytest.mark.parametrize("task", TASKS)
def test_placeholder_is_named(untouched, task):
    check, names = TASKS[task]
    with pytest.raises(Wrong, match="not filled in yet"):
        check(*(untouched[name] for name in names))


def expect(task, *answers, words):
    """The check of a task raises Wrong, and its hint says all the words."""
    with pytest.raises(Wrong) as hint:
        TASKS[task][0](*answers)
    for word in words:
        assert word in str(hint.value), hint.value


def test_the_modes_have_binaries_too():
    expect("t1", lambda loop, k: k * loop.network.binaries, words=["binary variables more", "modes"])


def test_every_step_has_its_own_binaries():
    expect("t1", lambda loop, k: len(loop.system.modes) + loop.network.binaries, words=["k = 3", "more"])


def test_one_mode_is_not_enough_on_a_boundary():
    def first_mode(system, x, u, C):
        mode = next(m for m in system.modes if m.region.contains(np.concatenate([x, u]), tol=1e-9))
        return C @ mode.successor(x, u) + mode.disturbance.support(C)

    expect("t2", first_mode, words=["but mode", "leads to"])


def test_every_mode_is_too_much():
    def all_modes(system, x, u, C):
        return np.max([C @ m.successor(x, u) + m.disturbance.support(C) for m in system.modes], axis=0)

    expect("t2", all_modes, words=["which no mode whose region contains (x, u) attains"])


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
    expect("t3", [-7.6, -10], [0, 0], words=["still in F", "is left to the nearest facet"])
    expect("t3", [-7.6, -10], [0, -0.2], words=["disturbance", "is not in D^(3)", "0.15"])
    expect("t3", [-8, -10], [0, -0.15], words=["state", "is not in F", "7.6"])
    expect("t3", [-7, -9], [0, -0.15], words=["still in F"])
    expect("t3", [-7.6, -10, 0], [0, -0.15], words=["state must have shape (2,)"])


def test_a_witness_found_by_the_library_counts():
    step = mr.check_rpi(mr.case_study("pwa").loop, ex04.REFUTE).witness
    ex04.check_t3(step.states[0], step.disturbances[0])


def test_what_task_4_says_about_its_set():
    assert mr.check_rpi(mr.case_study("pwa").loop, ex04.KEEP).verdict == "proven"


def test_largest_bound_is_neither_smaller_nor_larger(solved):
    expect("t4", 0.15, words=["still RPI", "not the largest"])
    expect("t4", solved["beta"] + 0.02, words=["is not RPI", "facet"])
    expect("t4", -0.1, words=["has to be positive"])
    expect("t4", "0.1 or so", words=["array of numbers"])


def test_the_other_set_must_be_better_nowhere(solved):
    a, beta = solved["best_a"], solved["best_beta"]
    expect("t5", 7.4, 0.15, words=["the bound may be larger"])
    expect("t5", a, beta - 0.05, words=["already with your a"])
    expect("t5", a + 0.1, beta, words=["not RPI", "facet 4"])
    expect("t5", a - 0.1, beta, words=["not RPI", "facet 3"])
    expect("t5", 12, 0.1, words=["between 0 and 10"])


def test_template_must_be_small_and_bounded():
    expect("t6", mr.box_directions(2), words=["which is 1.00 of the box's"])
    expect("t6", mr.box_directions(2) @ [[0.96, 0.28], [-0.28, 0.96]], words=["of area"])
    expect("t6", [[1, 0], [0, 1], [1, 1], [-1, 0]], words=["unbounded"])
    expect("t6", mr.directions(8), words=["shape (4, 2)"])
