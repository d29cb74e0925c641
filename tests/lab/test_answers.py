"""Looks of the lab, their scenes and scripts, against the library asked directly."""

import json

import numpy as np
import pytest
from loops import random_loop

import mireach as mr
from mireach import lab
from mireach.studies.case_studies import double_integrator_fit
from mireach.studies.seed_study import load_networks

CASES = ("pwa", "double_integrator")


@pytest.fixture(scope="module")
def subjects():
    return {name: lab.subject(name) for name in CASES}


def same(P, Q):
    return (P.H == Q.H).all() and (P.h == Q.h).all()


def test_default_look_is_the_case_study(subjects):
    case = mr.case_study("pwa")
    safe = mr.safe_set(case.loop, case.safe_directions)
    terminal = mr.terminal_set(case.loop, safe, case.directions, case.epsilon)
    look = lab.look(subjects["pwa"])
    np.testing.assert_allclose(look.safe.set.support(mr.directions(8)), safe.set.support(mr.directions(8)), atol=1e-9)
    assert (look.terminal.steps, look.terminal.criterion) == (terminal.steps, terminal.criterion)
    np.testing.assert_allclose(look.terminal.set.support(case.directions), terminal.set.h[:8], atol=1e-9)


def test_amount_shape_and_regions_mean_what_they_say(subjects):
    settings = {"amount": 0.7, "shape": "segment", "regions": 2, "network": "25"}
    look = lab.look(subjects["double_integrator"], settings)
    fit = double_integrator_fit(2, error="polytope")
    loop = mr.ClosedLoop(fit.system(), load_networks("double_integrator")[25])
    D = [mode.disturbance.scale(0.7) for mode in loop.system.modes]
    safe = mr.safe_set(loop.with_disturbance(D), mr.directions(8))
    assert len(look.loop.system.modes) == 4
    np.testing.assert_allclose(look.loop.system.modes[0].disturbance.vertices(), D[0].vertices(), atol=1e-12)
    assert look.safe.verdict == safe.verdict and same(look.safe.history[-1], safe.history[-1])


@pytest.mark.parametrize("settings", [{}, {"amount": 0.6}, {"amount": 0.1, "centre": "equilibrium", "log_epsilon": -2}])
@pytest.mark.parametrize("name", CASES)
def test_script_makes_the_very_same_sets(subjects, name, settings, capsys):
    look, found = lab.look(subjects[name], settings), {}
    exec(lab.script(subjects[name], settings), found)
    assert found["safe"].verdict == look.safe.verdict and same(found["safe"].history[-1], look.safe.history[-1])
    assert (look.terminal is None) == ("terminal" not in found)
    if look.terminal:
        assert same(found["terminal"].set, look.terminal.set) and found["terminal"].steps == look.terminal.steps


def test_trajectories_stay_where_the_sets_say(subjects):
    for name in CASES:
        look = lab.look(subjects[name])
        C = mr.directions(8)
        for k, R in enumerate(look.terminal.history):
            if k < look.disturbed.shape[1] and look.safe.set.contains(look.nominal[0], tol=1e-9):
                assert (look.disturbed[:, k] @ C.T <= R.support(C) + 1e-9).all()


def test_disturbances_grow_with_the_amount_and_depend_on_the_seed(subjects):
    def spread(**settings):
        look = lab.look(subjects["pwa"], {"x1": 1.0, "x2": 1.0, **settings})
        return look.disturbed[:, 1] - look.nominal[1]

    np.testing.assert_allclose(spread(amount=0.2), 2 * spread(amount=0.1), atol=1e-12)
    assert (
        np.abs(spread(amount=0.1)).max() <= 0.1 and np.abs(spread(amount=0.1) - spread(amount=0.1, seed=1)).max() > 0.01
    )
    assert np.abs(spread(amount=0)).max() < 1e-12


def test_loss_of_the_safe_set_comes_with_a_step_that_leaves_the_state_set(subjects):
    for name, amount in (("pwa", 0.3), ("double_integrator", 3.0)):
        look = lab.look(subjects[name], {"amount": amount})
        begin, end = look.safe.witness.states
        X, d = look.loop.system.state_set, look.safe.witness.disturbances[0]
        assert look.safe.set is None and look.terminal is None and look.remark
        assert X.contains(begin, tol=1e-9) and not X.contains(end)
        modes = look.loop.system.modes
        assert any(np.allclose(mode.successor(begin, look.loop.network(begin), d), end, atol=1e-9) for mode in modes)
        drawn = lab.scene(look)
        assert drawn["safe"] is None and drawn["witness"] == look.safe.witness.states.tolist()
        assert drawn["verdict"].startswith("No F_max was found: F")


def test_scene_and_file_hold_the_sets_themselves(subjects):
    look = lab.look(subjects["double_integrator"], {"amount": 0.9})
    drawn, kept = lab.scene(look), json.loads(json.dumps(look.to_dict(), allow_nan=False))
    assert drawn["safe"] == look.safe.set.vertices().tolist()
    assert [(one["name"], one["k"]) for one in drawn["sequence"]][-1] == ("R", look.terminal.steps)
    assert len(drawn["sequence"]) == look.safe.iterations + 1 + look.terminal.steps
    assert same(mr.Polytope.from_dict(kept["safe_set"]["set"]), look.safe.set)
    assert same(mr.Polytope.from_dict(kept["terminal_set"]["history"][-1]), look.terminal.set)


def test_loop_without_an_equilibrium_has_no_terminal_set_about_it():
    X, U = mr.Polytope.box([-1, -1], [1, 1]), mr.Polytope.box([-1], [1])
    left, right = (mr.Polytope([[side, 0, 0]], [0]) for side in (1, -1))
    modes = [
        mr.Mode(np.zeros((2, 2)), [[0], [0]], [jump, 0], region, mr.Polytope.box([-0.1, -0.1], [0.1, 0.1]))
        for jump, region in ((0.5, left), (-0.5, right))
    ]
    system = mr.PWASystem(modes, X, U)
    network = mr.MaxoutNetwork([], np.zeros((1, 2)), np.zeros(1))
    subject = lab.subject(mr.ClosedLoop(system, network))
    look = lab.look(subject, {"centre": "equilibrium"})
    assert look.safe.verdict == "proven" and look.terminal is None and "no equilibrium" in look.remark
    assert ("terminal set", f"none: {look.remark}") in lab.scene(look)["facts"]


def test_loop_of_ones_own_is_scaled_about_zero_even_if_its_sets_are_not():
    loop = random_loop(3, kinds=("triangle",), limits=4.0)
    look = lab.look(lab.subject(loop), {"amount": 2.0})
    for before, after in zip(loop.system.modes, look.loop.system.modes):
        V = mr.directions(16)
        np.testing.assert_allclose(after.disturbance.support(V), 2 * before.disturbance.support(V), atol=1e-9)
    nothing = lab.look(lab.subject(loop), {"amount": 0.0})
    assert all(np.abs(mode.disturbance.vertices()).max() < 1e-12 for mode in nothing.loop.system.modes)
