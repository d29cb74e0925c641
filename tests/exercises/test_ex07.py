"""Exercise 07: plausible mistakes are told what is wrong."""

import numpy as np
import pytest

from mireach import Polytope
from mireach.exercises import Wrong, ex07


def test_the_corner_alone_is_not_the_largest_error():
    def corners(side, points):
        t = np.linspace(-side / 2, side / 2, points)
        return 0.05 * (t[0] ** 2 - (t**2).mean())

    with pytest.raises(Wrong, match="3 points the middle"):
        ex07.check_t1(corners)


def test_the_continuous_fit_is_not_the_grids():
    with pytest.raises(Wrong, match="is off by"):
        ex07.check_t1(lambda side, points: side**2 / 120)


@pytest.mark.parametrize(
    ("points", "x", "hint"),
    [
        (10, [0.0, 0.0], "shall be larger"),
        (4, [2.0, 2.0], "shall be larger"),
        (2, [0.0, 0.0], "from 3 to 50"),
        (4, [3.0, 3.0], "not in the square"),
    ],
)
def test_grids_that_do_not_deceive(points, x, hint):
    with pytest.raises(Wrong, match=hint):
        ex07.check_t2(points, x)


def tangent(lower, upper):
    """Taylor's plane at the middle: right slopes, wrong constant."""
    c = (lower + upper) / 2
    return np.array([[1.0, 1], [0, 1]]) + 0.05 * np.vstack([c, c]), np.array([[0.5], [1]]), -0.025 * c @ c * np.ones(2)


def test_the_tangent_plane_is_not_minimax():
    with pytest.raises(Wrong, match=r"2\.00 times as large"):
        ex07.check_t3(tangent)


def test_a_map_without_the_bends_slope_is_far_off():
    with pytest.raises(Wrong, match="times as large as need be"):
        ex07.check_t3(lambda lower, upper: ([[1, 1], [0, 1]], [[0.5], [1]], [0, 0]))


@pytest.mark.parametrize(
    ("D", "hint"),
    [
        (Polytope.box([-0.1186, -0.1186], [0.1186, 0.1186]), "too large: along"),
        (Polytope.box([-0.08149, -0.08149], [0.11852, 0.11852]), r"too large: along \(1, -1\)"),
        (Polytope.from_points(np.array([[-0.1186, -0.1186], [0.1186, 0.1186]])), r"too large: along \(-1, -1\)"),
        (Polytope.from_points(np.array([[-0.1, -0.1], [0.1, 0.1]])), "occurs, but lies outside D"),
        (Polytope.from_points(np.array([[-0.1186, 0.1186], [0.1186, -0.1186]])), "occurs, but lies outside D"),
    ],
)
def test_error_sets_that_do_not_fit(D, hint):
    with pytest.raises(Wrong, match=hint):
        ex07.check_t4(D)


@pytest.mark.parametrize(
    ("least_squares", "minimax", "hint"),
    [
        (7, 7, "least_squares = 7 is too small"),
        (8, 8, "minimax = 8 is more than needed"),
        (18, 7, "more than needed"),
        (64, 49, "2 to 40"),
    ],
)
def test_wrong_numbers_of_regions(least_squares, minimax, hint):
    with pytest.raises(Wrong, match=hint):
        ex07.check_t5(least_squares, minimax)


@pytest.mark.parametrize(
    ("upper", "hint"),
    [
        (lambda a, b: max(np.sin(3 * t) - t for t in np.linspace(a, b, 100)), "is no bound"),
        (lambda a, b: 1 - a, "exceeds the maximum"),
        (lambda a, b: np.sin(1.5 * (a + b)) - (a + b) / 2 + 2 * (b - a), "exceeds the maximum"),
        (
            lambda a, b: np.sin(1.5 * (a + b)) - (a + b) / 2 + abs(3 * np.cos(1.5 * (a + b)) - 1) * (b - a) / 2,
            "no bound",
        ),
    ],
)
def test_bounds_that_are_none_or_loose(upper, hint):
    with pytest.raises(Wrong, match=hint):
        ex07.check_t6(upper)
