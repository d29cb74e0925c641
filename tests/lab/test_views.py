"""Views of R^n in the plane, against points that are projected and against membership that is asked directly."""

from itertools import combinations

import numpy as np
import pytest

import mireach as mr
from mireach.lab.views import Plane, Projection, Section, chosen_view, size_of, view_choices

V = mr.directions(24)


@pytest.mark.parametrize("n", [3, 4])
@pytest.mark.parametrize("size", [2.0**-30, 1.0, 2.0**30])
def test_projection_is_the_hull_of_the_projected_points(n, size):
    rng = np.random.default_rng(n)
    points = size * rng.normal(size=(n + 6, n))
    P = mr.Polytope.from_points(points)
    for axes in combinations(range(n), 2):
        polygon = Projection(axes, np.zeros(n)).polygon(P)
        wanted = (points[:, axes] @ V.T).max(axis=0)
        np.testing.assert_allclose(polygon.support(V), wanted, atol=1e-9 * size)
        assert polygon.contains(points[:, axes]).all()  # rounded outward


@pytest.mark.parametrize("n", [3, 4])
def test_section_holds_exactly_the_states_with_the_given_coordinates(n):
    rng = np.random.default_rng(n)
    P = mr.Polytope.from_points(rng.normal(size=(n + 8, n)))
    for axes in combinations(range(n), 2):
        states = np.tile(0.3 * rng.normal(size=n), (4000, 1))
        states[:, list(axes)] = rng.uniform(-2, 2, (4000, 2))
        section = Section(axes, states[0])
        slack = (P.h - states @ P.H.T).min(axis=1)
        clear = np.abs(slack) > 1e-9
        inside = section.polygon(P).contains(section.points(states))
        assert (inside == (slack > 0))[clear].all() and 0 < inside.sum() < len(inside)


def test_a_section_that_misses_a_set_is_empty_and_one_that_touches_it_is_flat():
    P = mr.Polytope([[1, 1, 1]], [2]) & mr.Polytope.box([0, 0, 0], [2, 2, 2])
    assert Section((0, 1), [0, 0, 2.001]).polygon(P).is_empty
    assert Section((0, 1), [0, 0, 2]).polygon(P).vertices().tolist() == [[0, 0]]
    assert len(Section((0, 2), [0, 2, 0]).polygon(P).vertices()) == 1


def test_flat_sets_and_points_are_drawn():
    for upper, corners in (([0, 0, 0], 1), ([0, 0, 1], 1), ([0, 1, 0], 2), ([1, 1, 0], 4)):
        P = mr.Polytope.box([0, 0, 0], upper)
        for view in (Projection((0, 1), np.zeros(3)), Section((0, 1), np.zeros(3))):
            assert len(view.polygon(P).vertices()) == corners


def test_a_section_lies_in_the_projection_and_states_are_drawn_at_their_coordinates():
    P, state = mr.Polytope.from_points(np.random.default_rng(0).normal(size=(9, 3))), np.array([0.1, -0.2, 0.1])
    for axes in ((0, 1), (0, 2), (1, 2)):
        projection, section = Projection(axes, state), Section(axes, state)
        assert section.polygon(P).is_subset(projection.polygon(P), 1e-9)
        paths = np.arange(24.0).reshape(2, 4, 3)
        assert (section.points(paths) == paths[..., axes]).all() and (projection.points(state) == state[[*axes]]).all()


def test_the_plane_is_shown_as_it_is():
    P, view = mr.Polytope.from_points([[0, 0], [1, 0], [0, 1]]), chosen_view(None, [0.5, 0.5])
    assert isinstance(view, Plane) and view.polygon(P) is P and not view.title and not view.caption
    assert view.names == ("x₁", "x₂") and not view.hidden


def test_words_name_the_kind_of_view_the_coordinates_and_the_unit():
    projection = chosen_view("projection 1 3", [0, -0.5, 2], "cm")
    section = chosen_view("section 2 3", [-0.5, 0, 2], "cm")
    assert projection.names == ("x₁ (cm)", "x₃ (cm)") and projection.title == "projection onto (x₁, x₃)"
    assert (
        "x₂ = −0.5 cm" in projection.caption and "enter the projection before it enters the set" in projection.caption
    )
    assert section.title == "section x₁ = −0.5 cm,\npaths projected"
    assert "drawn as projections onto (x₂, x₃)" in section.caption
    assert list(view_choices(3).values())[3] == "section (x₁, x₂) at the initial x₃"
    assert len(view_choices(4)) == 12 and repr(section).startswith("Section((1, 2), state=[-0.5")


def test_views_that_there_are_not_are_refused():
    with pytest.raises(ValueError, match="no view 'projection 1 4'; choose one of projection 1 2"):
        chosen_view("projection 1 4", [0, 0, 0])
    with pytest.raises(ValueError, match="must be chosen for 3 states"):
        chosen_view(None, [0, 0, 0])
    with pytest.raises(TypeError, match="choice must be of the kind str"):
        chosen_view(3, [0, 0, 0])
    with pytest.raises(ValueError, match="two different coordinates from 0 to 2"):
        Section((1, 1), [0, 0, 0])


def test_size_is_the_area_or_the_volume():
    assert size_of(mr.Polytope.box([0, 0], [2, 3])) == 6 and size_of(mr.Polytope.box([0] * 4, [2] * 4)) == 16
