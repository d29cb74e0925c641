"""The exact engine: against brute force and fractions of the standard library, for two states and more."""

import numpy as np
import pytest
from loops import affine_loop, brute_support, random_loop

import mireach as mr
from mireach.engines.cells import Cells

SHRUNK = 0.7  # F of the random questions, as a share of X


def square(r):
    return mr.Polytope.box([-r, -r], [r, r])


@pytest.mark.parametrize("with_input", [False, True])
@pytest.mark.parametrize("seed", range(6))
def test_support_agrees_with_brute_force_and_lies_below_the_bound_of_the_float_cells(seed, with_input):
    loop = random_loop(seed, with_input=with_input)
    F, V = loop.system.state_set.scale(SHRUNK), mr.directions(7)
    found = mr.support(loop, F, V, engine="exact")
    np.testing.assert_allclose(found.value, brute_support(loop, F, V), atol=1e-7)
    assert (found.bound >= found.value).all() and (found.bound <= np.nextafter(found.value, np.inf)).all()
    assert (Cells().support(loop, F, V).bound >= found.bound).all()


def test_the_safe_set_of_case_1_is_the_one_of_the_float_cells():
    case = mr.case_study("pwa")
    here, there = (mr.safe_set(case.loop, case.safe_directions, engine=engine) for engine in ("exact", "cells"))
    assert here.verdict == there.verdict == "proven" and here.iterations == there.iterations
    np.testing.assert_allclose(here.set.h, there.set.h, atol=1e-9)


def test_one_step_only():
    with pytest.raises(ValueError, match="takes one step; got steps = 2"):
        mr.support(affine_loop(0.5 * np.eye(2)), square(1), mr.directions(4), steps=2, engine="exact")
    empty = mr.Polytope([[1.0, 0], [-1, 0]], [-5, -5])
    assert mr.support(affine_loop(0.5 * np.eye(2)), empty, mr.directions(4), engine="exact").bound.max() == -np.inf
