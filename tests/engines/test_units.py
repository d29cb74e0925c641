"""No answer depends on units: loops scaled by powers of two, each state and input by its own, give the same ones."""

import numpy as np
import pytest
from loops import affine_loop, in_other_units, random_loop, set_in_other_units

import mireach as mr
from mireach import Polytope, box_directions, directions
from mireach.arithmetic.scaling import normal_rows, power_of_two
from mireach.engines.units import own_units

RANGES = [(-60, -60), (60, 60), (-60, 60), (-8, 8)]


def other_units(rng, lowest, highest, n, m):
    """Powers of two for n states and m inputs, the first state's at one end of the range."""
    s = 2.0 ** rng.integers(lowest, highest + 1, n)
    return np.append(2.0**lowest, s[1:]), 2.0 ** rng.integers(lowest, highest + 1, m)


def small_loop(seed, n):
    return random_loop(seed, n, m=1 + seed % 2, cuts=2, with_input=seed % 2 == 1, layers=1, limits=4.0)


@pytest.mark.parametrize("exponents", RANGES)
@pytest.mark.parametrize(("n", "engine"), [(2, "cells"), (2, "exact"), (2, "milp"), (3, "milp")])
def test_supports_are_the_same_to_the_last_bit(n, engine, exponents):
    for seed in range(3):
        rng, loop = np.random.default_rng(seed), small_loop(seed, n)
        s, t = other_units(rng, *exponents, n, loop.system.input_size)
        other, F, V = (
            in_other_units(loop, s, t),
            loop.system.state_set.scale(0.7),
            np.vstack([box_directions(n), np.ones(n)]),
        )
        one = mr.support(loop, F, V, engine=engine)
        two = mr.support(other, set_in_other_units(F, s), V / s, engine=engine)
        np.testing.assert_array_equal(one.bound, two.bound)
        np.testing.assert_array_equal(one.value, two.value)
        for here, there in zip(one.witness, two.witness):
            np.testing.assert_array_equal(here.states * s, there.states)
            np.testing.assert_array_equal(here.inputs * t, there.inputs)
            np.testing.assert_array_equal(here.disturbances * s, there.disturbances)


@pytest.mark.parametrize("exponents", RANGES)
@pytest.mark.parametrize("n", [2, 3])
def test_safe_sets_terminal_sets_and_verdicts_are_the_same(n, exponents):
    verdicts = set()
    for seed in range(8 if n == 2 else 3):
        rng, loop = np.random.default_rng(seed), small_loop(seed, n)
        s, t = other_units(rng, *exponents, n, loop.system.input_size)
        other, C = in_other_units(loop, s, t), directions(8) if n == 2 else box_directions(n)
        one, two = mr.safe_set(loop, C, max_iterations=12), mr.safe_set(other, C / s, max_iterations=12)
        assert (one.verdict, one.iterations, one.settled) == (two.verdict, two.iterations, two.settled)
        verdicts.add(one.verdict)
        F = loop.system.state_set.scale(0.6)
        first, second = mr.check_rpi(loop, F), mr.check_rpi(other, set_in_other_units(F, s))
        assert (first.verdict, first.settled) == (second.verdict, second.settled)
        verdicts.add(first.verdict)
        if one.set is None:
            continue
        for here, there in zip(one.history[1:], two.history[1:]):
            k = len(C)
            np.testing.assert_array_equal(here.h[:k], there.h[:k])
        c = one.set.chebyshev()[0]
        one = mr.terminal_set(loop, one, C, centre=c, max_steps=5)
        two = mr.terminal_set(other, two, C / s, centre=c * s, max_steps=5)
        assert (one.steps, one.criterion, one.stable) == (two.steps, two.criterion, two.stable)
        np.testing.assert_array_equal(one.alphas, two.alphas)
    assert verdicts >= {"proven", "refuted"}


@pytest.mark.parametrize("power", [-60, -20, 0, 20, 60])
@pytest.mark.parametrize("n", [1, 2, 3])
def test_what_holds_without_any_margin_holds_in_every_unit(n, power):
    """x+ = x / 2 + d with |d| <= r: the box |x| <= 1 is RPI exactly for r <= 1/2."""
    unit = 2.0**power
    for r, verdict in ((0.5, "proven"), (0.5 + 2.0**-15, "refuted")):
        D = Polytope.box([-r] * n, [r] * n)
        loop = in_other_units(affine_loop(0.5 * np.eye(n), D), np.full(n, unit), np.ones(1))
        F = Polytope.box([-unit] * n, [unit] * n)
        assert mr.check_rpi(loop, F).verdict == verdict
        assert mr.safe_set(loop).verdict == verdict


def test_a_loop_in_its_own_units_reaches_to_between_one_half_and_one():
    loop = in_other_units(small_loop(1, 2), np.array([2.0**40, 2.0**-33]), np.array([2.0**17, 2.0**-9]))
    own = own_units(loop).loop
    for P in (own.system.state_set, own.system.input_set):
        size = np.abs(P.bounding_box()).max(axis=0)
        assert (size <= 1).all() and (size > 0.5).all()
    x = own.system.state_set.sample(np.random.default_rng(0), 50)
    np.testing.assert_array_equal(own.network(x) * own_units(loop).inputs, loop.network(x * own_units(loop).state))


def test_powers_of_two_are_the_smallest_that_are_not_below():
    for power in (-1021, -52, -1, 0, 1, 60, 1022):
        for value in (2.0**power, -(2.0**power), np.nextafter(2.0**power, 0), np.nextafter(2.0**power, np.inf)):
            found = power_of_two(value)
            assert found / 2 < abs(value) <= found and np.frexp(found)[0] == 0.5
    assert power_of_two(0.0) == 1
    rows, factor = normal_rows(np.array([[4.0, -1.0], [0.75, 0.0], [0.0, 0.0]]))
    assert rows.tolist() == [[1, -0.25], [0.75, 0], [0, 0]] and factor.tolist() == [0.25, 1, 1]


def test_numbers_that_no_units_hold_are_refused():
    loop = affine_loop(np.diag([1e-300, 1.0]), None, 1.0)
    tiny = in_other_units(loop, np.array([1.0, 2.0**-60]), np.ones(1))
    assert mr.check_rpi(tiny, tiny.system.state_set).verdict == "proven"
    net = mr.MaxoutNetwork((), [[5e-324, 1e300]], [0.0])
    X = Polytope.box([-1e-300, -1e-300], [1e-300, 1e-300])
    mode = mr.Mode(0.5 * np.eye(2), [[0.0], [0.0]], [0.0, 0.0], Polytope(np.eye(3)[:1], [1.0]))
    with pytest.raises(ValueError, match="choose other units"):
        mr.check_rpi(mr.ClosedLoop(mr.PWASystem([mode], X, Polytope.box([-2], [2])), net), X)
