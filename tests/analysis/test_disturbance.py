"""The largest disturbance: where it is known, and in other units."""

import numpy as np
import pytest
from loops import affine_loop, random_loop
from regions import in_other_units, powers

import mireach as mr


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
