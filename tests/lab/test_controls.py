"""Every control of the lab at its ends and beyond, and settings that are refused."""

import json

import numpy as np
import pytest

from mireach import lab

CASES = ("pwa", "double_integrator")


@pytest.fixture(scope="module")
def subjects():
    return {name: lab.subject(name) for name in CASES}


@pytest.mark.parametrize("name", CASES)
def test_every_control_works_at_both_ends_and_beyond_them(subjects, name):
    subject = subjects[name]
    for control in subject.controls:
        ends = list(control.choices) or [control.low, control.high]
        for value in ends:
            look = lab.look(subject, {control.name: value})
            assert look.settings[control.name] == value
            assert look.safe.verdict in ("proven", "refuted", "unknown")
            json.dumps(lab.scene(look), allow_nan=False)
        if not control.choices:
            assert subject.settle({control.name: control.low - 7})[control.name] == control.low
            assert subject.settle({control.name: control.high + 7})[control.name] == control.high
            for wrong in (np.nan, np.inf, "much", None):
                with pytest.raises(ValueError, match=control.name):
                    subject.settle({control.name: wrong})
        else:
            for wrong in ("none of them", -3, None):
                with pytest.raises(ValueError, match=control.name):
                    subject.settle({control.name: wrong})


def test_unknown_controls_and_subjects_are_named(subjects):
    with pytest.raises(ValueError, match="no control bound; there are amount"):
        subjects["pwa"].settle({"bound": 0.1})
    with pytest.raises(ValueError, match="no case study 'pwb'"):
        lab.subject("pwb")
    with pytest.raises(TypeError, match="case must be of the kind"):
        lab.subject(3)


def test_whole_numbers_are_rounded_and_others_are_not(subjects):
    settled = subjects["pwa"].settle({"directions": 9.6, "amount": 0.123})
    assert settled["directions"] == 10 and isinstance(settled["directions"], int) and settled["amount"] == 0.123
