"""Faces and edges of polytopes of R^3: Euler's formula, known solids, flat sets."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from polytopes import polytopes

from mireach import Polytope, octahedral_directions
from mireach.sets.faces import edges, rings

CUBE = Polytope.box([-1, -1, -1], [1, 1, 1])
OCTAHEDRON = Polytope.from_points(np.vstack([np.eye(3), -np.eye(3)]))
PYRAMID = Polytope([[1, 0, 1], [-1, 0, 1], [0, 1, 1], [0, -1, 1], [0, 0, -1]], [1, 1, 1, 1, 0])


@pytest.mark.parametrize("unit", [2.0**-40, 1, 2.0**40])
@pytest.mark.parametrize(
    "P, sides",
    [(CUBE, [4] * 6), (OCTAHEDRON, [3] * 8), (PYRAMID, [3, 3, 3, 3, 4])],
    ids=["cube", "octahedron", "pyramid"],
)
def test_known_solids_have_their_faces_in_any_units(P, sides, unit):
    scale = np.array([unit, 1, 1 / unit])
    vertices, faces = rings(Polytope(P.H / scale, P.h))
    assert sorted(map(len, faces)) == sides
    assert len(vertices) - len(edges(faces)) + len(faces) == 2


def test_rows_that_touch_an_edge_or_a_vertex_or_repeat_a_face_are_no_faces():
    touching = Polytope([[1, 1, 0], [1, 1, 1], [2, 0, 0], [0, 0, 0]], [2, 3, 2, 0])
    vertices, faces = rings(CUBE & touching)
    assert (len(vertices), len(faces), len(edges(faces))) == (8, 6, 12)


@settings(max_examples=20)
@given(polytopes(3))
def test_every_edge_has_two_faces_and_the_corners_of_a_face_turn_one_way(P):
    vertices, faces = rings(P)
    assert len(vertices) - len(edges(faces)) + len(faces) == 2
    sides = [frozenset(pair) for ring in faces for pair in pairwise((*ring, ring[0]))]
    assert all(sides.count(side) == 2 for side in sides)


@pytest.mark.parametrize("unit", [2.0**-40, 1, 2.0**40])
def test_flat_sets_are_their_own_face(unit):
    plane = Polytope(np.array([[1, 2, 3], [-1, -2, -3]]) / unit, [1, -1])
    vertices, faces = rings(Polytope(CUBE.H, CUBE.h * unit) & plane)
    assert len(faces) == 1 and sorted(faces[0]) == [*range(len(vertices))]
    assert len(edges(faces)) == len(vertices) > 3


@pytest.mark.parametrize("P, count", [(Polytope.box([0, 1, 2], [3, 1, 2]), 2), (Polytope.box([0, 1, 2], [0, 1, 2]), 1)])
def test_segments_and_points_have_no_faces(P, count):
    vertices, faces = rings(P)
    assert (len(vertices), faces) == (count, [])
    assert rings(P & Polytope([[1, 0, 0]], [-1]))[1] == []


def test_other_dimensions_and_unbounded_sets_are_refused():
    with pytest.raises(ValueError, match=r"R\^2"):
        rings(Polytope.box([0, 0], [1, 1]))
    with pytest.raises(ValueError, match="unbounded"):
        rings(Polytope(octahedral_directions(3)[:4], np.ones(4)))
