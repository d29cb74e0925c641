"""The widgets without a browser: their callbacks as plain functions, at both ends of every control and outside."""

import json

import numpy as np
import pytest
from loops import random_loop
from traitlets import TraitError

from mireach import Region, maximal_safe_set
from mireach.lab import look, subject
from mireach.lab.search import ACCURACY
from mireach.lab.widget import DisturbanceLab, step_viewer


def viewer(count=3):
    drawn = []

    def draw(ax, k):
        drawn.append(k)
        ax.plot([0, 1], [0, k])

    box = step_viewer(draw, count)
    (play, slider), image = box.children[0].children, box.children[1]
    return drawn, play, slider, image


def test_first_picture_is_shown_and_others_are_drawn_on_demand_once():
    drawn, _, slider, image = viewer()
    first = bytes(image.value)
    assert first.startswith(b"\x89PNG") and drawn == [0]
    slider.value = 2
    assert bytes(image.value) != first and drawn == [0, 2]
    slider.value = 0
    assert bytes(image.value) == first and drawn == [0, 2]


def test_slider_and_play_cover_exactly_the_steps():
    _, play, slider, _ = viewer(5)
    assert (slider.min, slider.max, play.min, play.max) == (0, 4, 0, 4)
    slider.value = 99
    assert slider.value == 4
    with pytest.raises(TraitError):
        slider.value = np.nan


def test_nothing_to_show_is_refused():
    with pytest.raises(ValueError, match="at least 1"):
        step_viewer(lambda ax, k: None, 0)


# -- the disturbance lab ------------------------------------------------------------------------------


@pytest.fixture
def lab():
    lab = DisturbanceLab("pwa")
    lab.sent = []
    lab.send = lambda content, buffers=None: lab.sent.append(content)
    return lab


def ask(lab, **message):
    """What the page does: a custom message."""
    lab._on_message(lab, message, [])


def test_lab_answers_the_page_and_says_to_what(lab):
    ask(lab, do="look", settings={**lab.settings, "amount": 0.1}, stamp=7)
    assert lab.picture["stamp"] == 7 and lab.settings["amount"] == 0.1
    assert lab.picture["safe"] == look(subject("pwa"), {"amount": 0.1}).safe.set.vertices().tolist()
    ask(lab, do="look", settings=lab.settings, stamp=8)  # the same wish again is answered too
    assert lab.picture["stamp"] == 8


def test_every_control_beyond_its_ends_goes_to_the_end(lab):
    for control in lab.subject.controls:
        if not control.choices:
            for wild, end in ((-1e9, control.low), (1e9, control.high)):
                ask(lab, do="look", settings={**lab.settings, control.name: wild}, stamp=1)
                assert lab.settings[control.name] == end and "error" not in lab.picture


def test_nonsense_from_the_page_is_said_and_changes_nothing(lab):
    before = lab.settings
    ask(lab, do="look", settings={**before, "network": "none"}, stamp=3)
    assert lab.picture["error"].startswith("network must be one of") and lab.picture["stamp"] == 3
    assert lab.settings == before
    ask(lab, do="look", settings=before, stamp=4)
    assert "error" not in lab.picture


MALFORMED = [
    None,
    5,
    "look",
    ["look"],
    {},
    {"do": None},
    {"do": "dance"},
    {"do": ["look"]},
    {"do": {"do": "look"}},
    {"do": "look"},
    {"do": "look", "stamp": 1},
    {"do": "look", "settings": {}},
    {"do": "look", "stamp": "x", "settings": {}},
    {"do": "look", "stamp": None, "settings": {}},
    {"do": "look", "stamp": -1, "settings": {}},
    {"do": "look", "stamp": 1.5, "settings": {}},
    {"do": "look", "stamp": float("inf"), "settings": {}},
    {"do": "look", "stamp": 10**400, "settings": {}},
    {"do": "look", "stamp": 1, "settings": None},
    {"do": "look", "stamp": 1, "settings": []},
    {"do": "look", "stamp": 1, "settings": "amount"},
    {"do": "look", "stamp": 1, "settings": {"bound": 1}},
    {"do": "look", "stamp": 1, "settings": {1: 1}},
    {"do": "look", "stamp": 1, "settings": {"amount": None}},
    {"do": "look", "stamp": 1, "settings": {"amount": {}}},
    {"do": "look", "stamp": 1, "settings": {"amount": [1]}},
    {"do": "look", "stamp": 1, "settings": {"amount": "much"}},
    {"do": "look", "stamp": 1, "settings": {"amount": float("nan")}},
    {"do": "look", "stamp": 1, "settings": {"amount": 10**400}},
    {"do": "look", "stamp": 1, "settings": {"network": {}}},
    {"do": "look", "stamp": 1, "settings": {"centre": None}},
    {"do": "save"},
    {"do": "save", "kind": "png"},
    {"do": "save", "kind": ["figure"]},
    {"do": "save", "kind": None},
    {"do": "save", "kind": "sets", "path": "/tmp"},
    {"do": "idle", "stamp": 1},
    {"do": "layer", 1: 1},
    {"do": "look", "stamp": 1, "settings": {}, "amount": 1},
    {"do": "look", "stamp": True, "settings": {}},
]


@pytest.mark.parametrize("message", MALFORMED)
def test_malformed_messages_are_shown_and_change_nothing(lab, message):
    before, shown = lab.settings, lab.picture["safe"]
    lab._on_message(lab, message, [])
    assert lab.picture["error"] and len(lab.picture["error"]) < 500
    assert lab.settings == before and lab.picture["safe"] == shown and not lab.sent
    ask(lab, do="look", settings=before, stamp=9)
    assert "error" not in lab.picture and lab.picture["stamp"] == 9


def test_settings_may_come_from_code(lab):
    lab.settings = {**lab.settings, "amount": 99}
    assert lab.settings["amount"] == lab.subject.control("amount").high and lab.look.safe.set is None
    with pytest.raises(TraitError, match="no control bound"):
        lab.settings = {"bound": 1}
    with pytest.raises(ValueError, match="no control bound"):
        DisturbanceLab("pwa", bound=1)
    assert DisturbanceLab("pwa", amount=0.1).look.settings["amount"] == 0.1


def test_idle_work_finds_the_largest_disturbance_and_ends(lab):
    pieces = 0
    while not lab.curve["done"]:
        ask(lab, do="idle")
        pieces += 1
    assert pieces < 100 and lab.curve["settled"]
    largest, control = lab.curve["largest"], lab.subject.control("amount")
    for amount, there in ((largest, True), (largest + 2 * ACCURACY * control.high, False)):
        found = look(lab.subject, {"amount": amount}).safe.set
        assert (found is not None) == there
    lab.settings = {**lab.settings, "safe_directions": 8}  # another template, another curve
    assert lab.curve["points"] == [] and not lab.curve["settled"]
    lab.settings = {**lab.settings, "safe_directions": 4, "amount": 0.1}  # the first one is still known
    assert lab.curve["largest"] == largest


@pytest.mark.parametrize(("amount", "there"), [(0.15, True), (1.9, False)])
def test_layer_is_the_maximal_safe_set_of_the_picture_that_is_shown(lab, amount, there):
    lab.settings = {**lab.settings, "amount": amount}
    ask(lab, do="layer")
    assert lab.layer["number"] == lab.picture["number"] and bool(lab.layer["rings"]) == there
    if there:
        drawn = Region.of(*lab.layer["rings"])  # X without a corner, which is convex
        assert drawn.area == pytest.approx(maximal_safe_set(lab.look.loop, prove=False).set.area, rel=1e-9)
        assert drawn.contains(lab.look.safe.set.vertices(), 1e-9).all()
    else:
        assert "no RPI set" in lab.layer["text"]
    lab.settings = {**lab.settings, "amount": 0.1}
    assert lab.layer["number"] != lab.picture["number"]  # the page shows no layer of other settings


@pytest.mark.parametrize("amount", [0.15, 0.5])
def test_lab_saves_figure_sets_and_python(lab, amount, tmp_path):
    lab.settings = {**lab.settings, "amount": amount}
    for kind, ending in (("figure", "svg"), ("sets", "json"), ("script", "py")):
        ask(lab, do="save", kind=kind)
        lab.save(tmp_path / f"look.{ending}")
        text = (tmp_path / f"look.{ending}").read_text(encoding="utf-8")
        assert lab.sent[-1]["text"] == text and lab.sent[-1]["file"] == f"mireach_pwa.{ending}"
    assert (tmp_path / "look.svg").read_text(encoding="utf-8").startswith("<?xml")
    sets = json.loads((tmp_path / "look.json").read_text(encoding="utf-8"))
    assert sets["safe_set"]["verdict"] == lab.look.safe.verdict
    again = {}
    exec((tmp_path / "look.py").read_text(encoding="utf-8"), again)
    assert again["safe"].verdict == lab.look.safe.verdict
    with pytest.raises(ValueError, match=r"must end in \.svg, \.json, \.py"):
        lab.save(tmp_path / "look.png")


def test_lab_of_a_loop_of_ones_own_needs_two_states():
    lab = DisturbanceLab(random_loop(1))
    assert {control["name"] for control in lab.controls}.isdisjoint({"network", "regions", "shape"})
    with pytest.raises(ValueError, match="only 1 state"):
        DisturbanceLab(random_loop(0, n=1))
    assert "kernel" in repr(lab)
