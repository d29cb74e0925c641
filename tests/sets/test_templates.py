"""Templates."""

import numpy as np
import pytest

from mireach import Polytope, box_directions, directions, octahedral_directions
from mireach.arithmetic.rational import binary, maximize


def random_directions(rng, count, n):
    """Unit rows (count, n)."""
    x = rng.normal(size=(count, n))
    return x / np.linalg.norm(x, axis=1, keepdims=True)


def covering_angle(C):
    """The largest angle, in degrees, between one of 20,000 random directions and the nearest row of C."""
    x = random_directions(np.random.default_rng(0), 20_000, C.shape[1])
    return np.degrees(np.arccos((x @ C.T).max(axis=1).min()))


def test_directions_are_unit_rows_with_exact_axes():
    C = directions(8)
    np.testing.assert_allclose(np.linalg.norm(C, axis=1), 1)
    assert C[[0, 2, 4, 6]].tolist() == [[1, 0], [0, 1], [-1, 0], [0, -1]]
    assert box_directions(2).tolist() == [[1, 0], [0, 1], [-1, 0], [0, -1]]


@pytest.mark.parametrize("count", [3, 5, 8, 16, 31])
def test_in_the_plane_they_are_the_papers(count):
    angles = 2 * np.pi * np.arange(count) / count
    C = np.column_stack([np.cos(angles), np.sin(angles)])
    assert directions(count, 2).tobytes() == np.where(np.abs(C) < 1e-15, 0.0, C).tobytes()


@pytest.mark.parametrize(
    ("count", "n"), [(4, 3), (5, 3), (6, 3), (7, 3), (15, 3), (6, 5), (9, 5), (10, 5), (24, 4), (60, 6)]
)
def test_in_space_they_bound_the_sets(count, n):
    C = directions(count, n)
    assert C.shape == (count, n) and len({tuple(row) for row in C.tolist()}) == count
    np.testing.assert_allclose(np.linalg.norm(C, axis=1), 1)
    H, h = [[binary(a) for a in row] for row in C.tolist()], [binary(1.0)] * count
    for v in box_directions(n).tolist():  # without rounding: {x : C x <= 1} is bounded along every axis
        assert np.isfinite(float(maximize(H, h, [binary(a) for a in v]).value))
    assert directions(count, n).tobytes() == C.tobytes()


def test_in_space_the_box_comes_first_and_pairs_follow():
    for count in (14, 15):
        C = directions(count, 3)
        assert C[:6].tolist() == box_directions(3).tolist()
        assert {tuple(row) for row in C[:14].tolist()} == {tuple(row) for row in (-C[:14] + 0.0).tolist()}


@pytest.mark.parametrize(("count", "n", "angle"), [(14, 3, 37), (26, 3, 29), (24, 4, 46), (72, 6, 48)])
def test_in_space_they_are_spread_evenly(count, n, angle):
    rng, found = np.random.default_rng(1), covering_angle(directions(count, n))
    assert found < angle
    assert found < min(covering_angle(random_directions(rng, count, n)) for _ in range(3)) - 8


def test_octahedral_directions_are_the_box_and_its_diagonals():
    C = octahedral_directions(3)
    assert C.shape == (18, 3) and C[:6].tolist() == box_directions(3).tolist()
    np.testing.assert_allclose(np.linalg.norm(C, axis=1), 1)
    assert (np.count_nonzero(C[6:], axis=1) == 2).all() and len({tuple(row) for row in C.tolist()}) == 18
    assert octahedral_directions(1).tolist() == [[1], [-1]]
    octagon = Polytope(octahedral_directions(2), np.ones(8))
    assert octagon.area == pytest.approx(8 * np.tan(np.pi / 8))


@pytest.mark.parametrize(("count", "n"), [(3, 3), (2, 2), (8, 1), (8.5, 3)])
def test_too_few_directions_are_refused(count, n):
    with pytest.raises(ValueError, match="must be a whole number"):
        directions(count, n)
