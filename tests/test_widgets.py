"""The step viewer: its callback as a plain function, at both ends of the slider and outside."""

import numpy as np
import pytest
from traitlets import TraitError

from mireach.widgets import step_viewer


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
