"""The largest disturbance: where it is known, and in other units."""

from itertools import pairwise

import numpy as np
import pytest
from loops import affine_loop, random_loop
from regions import in_other_units, powers

import mireach as mr
from mireach.analysis.disturbance import sets_that_are_met
from mireach.analysis.maximal_set import limit_within


def test_the_largest_disturbance_of_a_linear_loop_is_known():
    loop = affine_loop(0.5 * np.eye(2))
    for method in ("maximal", "template", lambda other: mr.safe_set(other).set is not None):
        found = mr.largest_disturbance(loop, method)
        assert found.bound <= 0.5 <= found.above + 1e-7 and found.above - found.bound <= 1e-4
    assert mr.largest_disturbance(loop, "template", largest=0.25).above == np.inf
    assert mr.largest_disturbance(loop, "template", largest=0.25).bound == 0.25


def test_where_even_no_disturbance_is_too_much():
    found = mr.largest_disturbance(affine_loop(2 * np.eye(2), p=[1.5, 0]))
    assert np.isnan(found.bound) and found.above == 0 and found.tried == 1
    with pytest.raises(ValueError, match="method must be"):
        mr.largest_disturbance(affine_loop(np.eye(2)), "none")


@pytest.mark.parametrize("mixed", [False, True])
def test_the_largest_disturbance_does_not_depend_on_units(mixed):
    rng = np.random.default_rng(mixed)
    loop, (s, t) = random_loop(0), powers(rng, mixed)
    own = mr.largest_disturbance(loop, accuracy=0.05)
    assert own == mr.largest_disturbance(in_other_units(loop, s, t), accuracy=0.05, weights=1 / s)
    assert own.bound > 0


@pytest.mark.parametrize("seed", [0, 1, 4])
def test_the_coarser_slack_of_the_search_costs_no_more_than_the_accuracy(seed):
    loop = random_loop(seed)
    plain = mr.largest_disturbance(loop, lambda other: limit_within(other, 0.0) is not None, accuracy=0.02)
    found = mr.largest_disturbance(loop, accuracy=0.02)
    assert found.bound <= plain.above and plain.bound <= found.above
    assert found.above - found.bound <= 0.02


@pytest.mark.parametrize("seed", range(4))
def test_f_max_grows_with_the_disturbance_until_there_is_none(seed):
    loop, C = random_loop(seed), mr.directions(8)
    sets = [mr.Polytope.box([-r, -r], [r, r]) for r in (0.0, 0.05, 0.1, 0.2, 0.4)]
    found = [mr.safe_set(loop.with_disturbance(D), C) for D in sets]
    for less, more in pairwise(found):
        assert less.set is not None or more.set is None
        assert less.iterations <= more.iterations or more.set is None
        for F, G in zip(less.history, more.history):
            assert F.is_subset(G, tol=1e-9)


def test_each_search_starts_within_the_last_set():
    """x+ = x / 2 + d, |d| <= 0.2 along each axis: a box is RPI exactly if it reaches to 0.4 on each side.

    What leaves the first set is lost although it stays in X.
    """
    loop = affine_loop(0.5 * np.eye(2)).with_disturbance(mr.Polytope.box([-0.2, -0.2], [0.2, 0.2]))
    start = mr.Region.of(mr.Polytope.box([-0.5, -0.45], [0.5, 0.75]))
    assert limit_within(loop, 0.0, start).equals(start, tol=1e-6)
    assert limit_within(loop, 0.0, mr.Region.of(mr.Polytope.box([-0.5, -0.39], [0.5, 0.75]))) is None
    assert limit_within(loop, 0.01, start) is not None and limit_within(loop, 0.03, start) is None


@pytest.mark.parametrize("seed", [0, 1, 4])
def test_rpi_sets_meet_what_they_are_said_to_meet(seed):
    loop = random_loop(seed).with_disturbance(mr.Polytope.box([-0.05, -0.05], [0.05, 0.05]))
    maximal, met = mr.maximal_safe_set(loop, prove=False), sets_that_are_met(loop)
    assert met is not None and len(met) == 4 and maximal.set is not None
    for F in met:
        assert not (maximal.set & F).is_empty


def test_what_every_rpi_set_meets_of_a_linear_loop_are_its_fixed_points():
    D = mr.Polytope.box([-0.2, -0.2], [0.2, 0.2])
    loop = affine_loop(0.5 * np.eye(2)).with_disturbance(D)  # x = 2 d
    met = sets_that_are_met(loop)
    np.testing.assert_allclose([F.vertices().mean(axis=0) for F in met], 2 * D.vertices(), atol=1e-6)
    assert limit_within(loop, 0.0, None, met) is not None
    assert sets_that_are_met(loop.with_disturbance(mr.Polytope.box([-0.6, -0.2], [0.6, 0.2]))) is None


def test_a_search_ends_where_it_misses_what_every_rpi_set_meets():
    loop = affine_loop([[0, 1.5], [0.5, 0]])  # the maximal set is |x1| <= 1, |x2| <= 2/3
    assert limit_within(loop, 0.0) is not None
    assert limit_within(loop, 0.0, None, [mr.Polytope.box([0, 0.7], [1, 1])]) is None
