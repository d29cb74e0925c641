"""Single steps in rational arithmetic against the numbers of the loop, in fractions."""

from fractions import Fraction

import numpy as np
import pytest
from loops import affine_loop, exact_input, exact_maximum, exactly_inside, random_loop

from mireach import Polytope
from mireach.engines.common import Witness
from mireach.engines.steps import attained, farthest_step
from mireach.rational import fractions


def ends(loop, mode, x, d, v):
    """v (A x + B Phi(x) + p + d), in fractions."""
    u, mode, total = exact_input(loop.network, x), loop.system.modes[mode], Fraction(0)
    for i, weight in enumerate(v.tolist()):
        row = zip([*mode.A[i].tolist(), *mode.B[i].tolist()], [*x, *u])
        total += Fraction(weight) * (sum(Fraction(a) * b for a, b in row) + Fraction(mode.p.tolist()[i]) + d[i])
    return total


def states_by_mode(loop, F, seed, count):
    """States of F & X with a mode whose region holds them."""
    X, rng = loop.system.state_set, np.random.default_rng(seed)
    for x in (F & X).sample(rng, count):
        u = exact_input(loop.network, x.tolist())
        for number, mode in enumerate(loop.system.modes):
            if exactly_inside(mode.region, [*map(Fraction, x.tolist()), *u]):
                yield x, number


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("seed", range(4))
def test_the_farthest_step_is_one_of_the_loop_and_no_step_nearby_goes_farther(seed, n):
    loop = random_loop(seed, n, cuts=2, with_input=seed % 2 == 0, layers=1 + seed % 2, width=2, pool=3)
    F, V = loop.system.state_set.scale(0.9), np.vstack([np.eye(n)[:1], np.random.default_rng(seed).normal(size=n)])
    for x, mode in states_by_mode(loop, F, seed, 8):
        D = loop.system.modes[mode].disturbance
        for v in V:
            step = farthest_step(loop, F, v, x, mode)
            state, d, value = fractions(step.state), fractions(step.disturbance), fractions([step.value])[0]
            assert exactly_inside(F, state) and exactly_inside(loop.system.state_set, state)
            assert exactly_inside(loop.system.modes[mode].region, [*state, *exact_input(loop.network, state)])
            assert exactly_inside(D, d)
            assert value == ends(loop, mode, state, d, v)
            _, push = exact_maximum(D.H.tolist(), D.h.tolist(), v.tolist())
            assert value >= ends(loop, mode, [Fraction(c) for c in x.tolist()], push, v)
            escape = step.escape(loop)
            assert sum(Fraction(c) * y for c, y in zip(v.tolist(), escape.after)) == value


def test_nothing_is_attained_from_outside_of_f_x_or_d():
    loop, v = affine_loop(0.5 * np.eye(2), Polytope.box([-0.1, -0.1], [0.1, 0.1])), np.array([1.0, 0.0])
    F, wide = Polytope.box([-0.5, -0.5], [0.5, 0.5]), Polytope.box([-2, -2], [2, 2])

    def reached(F, x, d):
        states = np.array([[x, 0.0], [0.5 * x + d, 0.0]])
        return attained(loop, F, v, Witness(states, np.zeros((1, 1)), np.zeros(1, int), np.array([[d, 0.0]])))

    assert reached(F, 0.6, 0.1) is reached(F, 0.25, 0.11) is reached(wide, 1.5, 0.1) is None
    assert float(fractions([reached(F, 0.5, 0.1)])[0]) == pytest.approx(0.35, abs=1e-8)
