"""Steps in rational arithmetic: every refutation replays in fractions, from a state that lies in the set."""

from fractions import Fraction

import numpy as np
import pytest
from loops import (
    affine_loop,
    exact_highest,
    exact_input,
    exact_maximum,
    exactly_inside,
    jump_loop,
    random_loop,
    replays,
)

import mireach as mr
from mireach import Polytope
from mireach.arithmetic.rational import fractions, rational
from mireach.engines.base import Escape, Witness
from mireach.engines.steps import attained, farthest_step, successor


def in_fractions(loop, witness):
    """The first step of a Witness, its floats taken as the fractions that they are, as an Escape."""
    x, d = (tuple(map(Fraction, part.tolist())) for part in (witness.states[0], witness.disturbances[0]))
    mode = int(witness.modes[0])
    return Escape(x, mode, d, successor(loop, x, mode, d))


@pytest.mark.parametrize("gain", [0.6, 2.0**12, 2.0**17, 1e6])
@pytest.mark.parametrize("n", [2, 3])
def test_a_refutation_replays_without_rounding_whatever_the_gain(n, gain):
    refuted = 0
    for seed in range(6):
        loop = random_loop(seed, n, cuts=1, with_input=seed % 2 == 0, layers=1, kinds=("box", "origin", "point"))
        modes = [mr.Mode(gain * mode.A, mode.B, mode.p, mode.region, mode.disturbance) for mode in loop.system.modes]
        loop = mr.ClosedLoop(mr.PWASystem(modes, loop.system.state_set, loop.system.input_set), loop.network)
        F = loop.system.state_set.scale(0.5)
        check = mr.check_rpi(loop, F)
        if check.verdict != "refuted":
            continue
        refuted += 1
        assert check.settled == "exact arithmetic"
        assert replays(loop, F, check.escape)
        assert replays(loop, F, in_fractions(loop, check.witness))
    assert refuted >= 3


@pytest.mark.parametrize(
    ("engine", "n", "gain"), [("milp", 3, 2.0**12), ("milp", 3, 2.0**20), ("cells", 2, 2.0**17), ("cells", 2, 2.0**40)]
)
def test_a_gain_does_not_lift_a_slack_to_a_refutation(engine, n, gain):
    """x+ = (g x2, 0), F = {|x1| <= 1, |x2| <= 1 / g}: the image is |x1| <= 1."""
    A = np.zeros((n, n))
    A[0, 1] = gain
    F = Polytope.box([-1, -1 / gain] + [-1.0] * (n - 2), [1, 1 / gain] + [1.0] * (n - 2))
    assert mr.check_rpi(affine_loop(A), F, engine).verdict != "refuted"
    wider = Polytope.box([-1, -1.25 / gain] + [-1.0] * (n - 2), [1, 1.25 / gain] + [1.0] * (n - 2))
    check = mr.check_rpi(affine_loop(A), wider, engine)
    assert check.verdict == "refuted" and replays(affine_loop(A), wider, check.escape)


@pytest.mark.parametrize("gap", [2.0**-50, 1e-13, 1e-10, 1e-6])
def test_a_set_that_ends_short_of_a_jump_does_not_touch_it(gap):
    loop = jump_loop([0.5, 0.0], [9.0, 0.0], limits=9.5)  # x+ = (9, 0) where x1 >= 1
    short, touching = Polytope.box([-1, -1], [1 - gap, 1]), Polytope.box([-1, -1], [1, 1])
    assert mr.check_rpi(loop, short).verdict == "proven"
    check = mr.check_rpi(loop, touching)
    assert check.verdict == "refuted" and check.escape.state[0] == 1 and replays(loop, touching, check.escape)


def test_a_flat_set_is_left_by_a_rational_step():
    """A segment of R^3 through no floats but its ends, given by equalities in whole numbers."""
    E, x = np.array([[827.0, 485, -851], [-594, -124, -775]]), np.array([593.0, -744, 953])
    F = Polytope(np.vstack([E, -E, np.eye(3), -np.eye(3)]), np.concatenate([E @ x, -E @ x, x + 1, 1 - x]))
    loop = affine_loop(0.5 * np.eye(3), limits=900.0)
    loop = mr.ClosedLoop(
        mr.PWASystem(
            [mr.Mode(0.5 * np.eye(3), np.zeros((3, 1)), np.zeros(3), Polytope(np.zeros((1, 4)), [1.0]))],
            Polytope.box([-2e5] * 3, [2e5] * 3),
            loop.system.input_set,
        ),
        loop.network,
    )
    check = mr.check_rpi(loop, F)
    assert check.verdict == "refuted" and replays(loop, F, check.escape)


@pytest.mark.parametrize("n", [2, 3])
def test_the_farthest_step_of_a_piece_is_attained_and_no_farther_than_the_truth(n):
    for seed in range(8):
        loop = random_loop(seed, n, m=1 + seed % 2, cuts=1, layers=1, kinds=("box",))
        F, rng = loop.system.state_set.scale(0.6), np.random.default_rng(seed)
        x, v = F.sample(rng, 1)[0], rng.normal(size=n)
        truth = exact_highest(loop, F, v[None])[0]
        for mode in range(len(loop.system.modes)):
            step = farthest_step(loop, F, v, x, mode)
            if step is None:
                continue
            escape = step.escape(loop)
            value = sum(Fraction(a) * b for a, b in zip(v.tolist(), escape.after))
            assert rational(value) == step.value and value <= truth
            beyond = Polytope(np.vstack([F.H, v]), np.append(F.h, np.nextafter(float(value), -np.inf)))
            assert not beyond.contains(np.array([float(entry) for entry in escape.after]))


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
