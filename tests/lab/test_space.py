"""The lab of three tanks: its answers are those of the library, and its pictures are views of them."""

import json

import numpy as np
import pytest
from loops import random_loop

import mireach as mr
from mireach import lab
from mireach.lab.views import view_choices
from mireach.lab.widget import DisturbanceLab


@pytest.fixture(scope="module")
def tanks():
    return lab.subject("three_tanks")


@pytest.fixture(scope="module")
def case():
    return mr.case_study("three_tanks")


def same(P, Q):
    return (P.H == Q.H).all() and (P.h == Q.h).all()


def bounded(case, bound):
    return case.loop.with_disturbance(mr.Polytope.box([-bound] * 3, [bound] * 3))


def test_sets_and_verdicts_are_those_of_direct_calls(tanks, case):
    for amount, names in ((0.2, ("safe_directions", "directions")), (0.1, ("box", "box"))):
        loop = bounded(case, amount)
        C, R = (mr.box_directions(3) if name == "box" else getattr(case, name) for name in names)
        safe = mr.safe_set(loop, C)
        terminal = mr.terminal_set(loop, safe, R, case.epsilon, max_steps=100)
        templates = {} if names[0] != "box" else {"safe_directions": "6", "directions": "6"}
        look = lab.look(tanks, {"amount": amount, **templates})
        assert look.safe.verdict == safe.verdict == "proven" and same(look.safe.set, safe.set)
        assert same(look.terminal.set, terminal.set) and look.terminal.alpha == terminal.alpha
        assert (look.terminal.steps, look.terminal.criterion) == (terminal.steps, terminal.criterion)
        for P in (look.safe.set, look.terminal.set):
            assert mr.check_rpi(loop, P).verdict == "proven"


def test_loss_of_the_safe_set_comes_with_the_same_step(tanks, case):
    look, safe = lab.look(tanks, {"amount": 0.9}, terminal=False), mr.safe_set(bounded(case, 0.9), case.safe_directions)
    assert (look.safe.verdict, look.safe.reason) == (safe.verdict, safe.reason) and look.safe.set is None
    assert (look.safe.witness.states == safe.witness.states).all()
    begin, end = look.safe.witness.states
    X, d = case.system.state_set, look.safe.witness.disturbances[0]
    assert X.contains(begin, tol=1e-9) and not X.contains(end, tol=1e-3) and np.abs(d).max() <= 0.9
    modes = look.loop.system.modes
    assert any(np.allclose(mode.successor(begin, look.loop.network(begin), d), end, atol=1e-9) for mode in modes)
    drawn = lab.scene(look)
    assert drawn["witness"] == safe.witness.states[:, :2].tolist() and "cm" in dict(drawn["facts"])["leaves X"]
    assert "may be drawn inside, but lies outside X" in drawn["caption"]


def test_script_makes_the_very_same_sets(tanks, capsys):
    settings, found = {"amount": 0.25, "directions": "14", "view": "section 1 2"}, {}
    exec(lab.script(tanks, settings), found)
    look = lab.look(tanks, settings)
    assert same(found["safe"].set, look.safe.set) and same(found["terminal"].set, look.terminal.set)


def test_every_view_draws_the_sets_of_the_look(tanks, case):
    for choice in view_choices(3):
        look = lab.look(tanks, {"view": choice, "x3": 0.5})
        drawn, axes = lab.scene(look), [int(i) - 1 for i in choice.split()[1:]]
        for name, P in (("state", case.system.state_set), ("safe", look.safe.set), ("terminal", look.terminal.set)):
            wanted = P.project(axes) if choice.startswith("projection") else P.section(axes, [5, -8, 0.5])
            assert drawn[name] == wanted.vertices().tolist()
        assert drawn["nominal"] == look.nominal[:, axes].tolist() and drawn["nominal"][0] == drawn["disturbed"][0][0]
        assert [axis for axis, _ in drawn["axes"]] == axes and "projection" in drawn["caption"].lower()
        assert dict(drawn["facts"])["initial state"] == "x = [5.0, -8.0, 0.5] cm, in F_max"
        json.dumps(drawn, allow_nan=False)


def test_what_a_section_misses_is_said(tanks):
    drawn = lab.scene(lab.look(tanks, {"view": "section 1 2", "x3": 5}))
    assert drawn["terminal"] == [] and drawn["safe"] and "does not meet the terminal set" in drawn["caption"]
    drawn = lab.scene(lab.look(tanks, {"view": "section 2 3", "x1": 9}))
    assert drawn["safe"] == [] and "does not meet F_max or the terminal set" in drawn["caption"]
    assert dict(drawn["facts"])["initial state"].endswith("outside F_max")


def test_trajectories_stay_where_the_sets_say(tanks, case):
    look = lab.look(tanks)
    for k, R in enumerate(look.terminal.history[: look.disturbed.shape[1]]):
        assert (look.disturbed[:, k] @ case.directions.T <= R.support(case.directions) + 1e-9).all()
    nothing = lab.look(tanks, {"amount": 0}, terminal=False)
    assert np.abs(nothing.disturbed - nothing.nominal).max() < 1e-12


# -- the widget ---------------------------------------------------------------------------------------


@pytest.fixture
def widget():
    widget = DisturbanceLab("three_tanks", amount=0.15)
    widget.send = lambda content, buffers=None: None
    return widget


def test_the_safe_set_is_shown_first_and_the_terminal_set_when_idle(widget, tanks):
    first = widget.picture
    assert first["pending"] and first["safe"] and first["terminal"] is None and not widget.curve["done"]
    assert dict(first["facts"])["terminal set"] == "follows when you pause"
    widget._on_message(widget, {"do": "idle"}, [])
    complete = {**lab.scene(lab.look(tanks, {"amount": 0.15})), "stamp": 0, "number": 1}
    for picture in (complete, widget.picture):
        assert picture["facts"].pop()[0] == "computed in"
    assert widget.picture == complete
    widget.settings = {**widget.settings, "x1": -3, "view": "section 1 3"}  # for which the terminal set is known
    assert not widget.picture["pending"] and widget.picture["terminal"] is not None
    widget.settings = {**widget.settings, "amount": 0.3}
    assert widget.picture["pending"]
    assert widget.look.terminal is not None and not widget.picture["pending"]  # whoever asks by code gets all of it


def test_idle_work_fills_the_curve_with_volumes_in_any_view(widget):
    for _ in range(4):
        widget._on_message(widget, {"do": "idle"}, [])
    amount, volume = widget.curve["points"][1]
    assert volume == lab.safe_set_at(widget.subject, {}, amount).volume()
    assert widget.curve["summary"].startswith("Volume of F_max") and len(widget.curve["largest_set"][0]) == 2


def test_there_is_no_layer_of_the_maximal_set(widget):
    assert not widget.about["maximal"]
    widget._on_message(widget, {"do": "layer"}, [])
    assert "error" in widget.picture
    widget._on_message(widget, {"do": "look", "settings": widget.settings, "stamp": 1}, [])
    assert "error" not in widget.picture


def test_figure_and_sets_are_saved_whole_in_a_section_that_misses_sets(tmp_path):
    widget = DisturbanceLab("three_tanks", amount=0.1, view="section 2 3", x1=9)
    widget.save(tmp_path / "look.svg")
    widget.save(tmp_path / "look.json")
    sets = json.loads((tmp_path / "look.json").read_text(encoding="utf-8"))
    assert same(mr.Polytope.from_dict(sets["terminal_set"]["set"]), widget.look.terminal.set)


# -- other loops --------------------------------------------------------------------------------------


def test_networks_of_ones_own_and_loops_of_any_dimension_have_a_lab():
    case = mr.case_study("three_tanks")
    own = mr.case_study("three_tanks", mr.MaxoutNetwork([], np.zeros((2, 3)), np.zeros(2)))
    assert lab.look(lab.subject(own), terminal=False).loop.network is own.network
    assert "network is that of the case study" in lab.script(lab.subject(own), {})
    assert lab.look(lab.subject(case), terminal=False).loop.network.to_dict() == case.network.to_dict()
    for loop, views in ((random_loop(1, n=3), 6), (mr.case_study("four_tanks"), 12)):
        subject = lab.subject(loop)
        assert len(subject.control("view").choices) == views
        assert lab.scene(lab.look(subject, {"amount": 0.5}, terminal=False))["axes"] == [(0, "x₁"), (1, "x₂")]


def test_a_loop_with_one_state_is_refused():
    with pytest.raises(ValueError, match="only 1 state"):
        lab.subject(random_loop(0, n=1))
