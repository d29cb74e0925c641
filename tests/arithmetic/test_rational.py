"""Rational arithmetic: roundings of known direction, and linear programs against brute force over all vertices."""

from fractions import Fraction
from itertools import product
from math import inf

import numpy as np
import pytest
from loops import highest_vertex
from scipy.optimize import linprog

from mireach.arithmetic import rational
from mireach.arithmetic.rational import above, below, binary, maximize, nearest, strict_point


def fmpq(values):
    return rational.rational([list(map(Fraction, row)) if isinstance(row, (list, tuple)) else row for row in values])


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_maxima_over_random_bounded_sets_are_those_over_their_vertices(n):
    rng = np.random.default_rng(n)
    empty = 0
    for _ in range(40 if n < 4 else 10):
        H = [*map(list, np.vstack([np.eye(n, dtype=int), -np.eye(n, dtype=int), rng.integers(-3, 4, (3, n))]).tolist())]
        h = [*[2] * (2 * n), *rng.integers(-4, 4, 3).tolist()]
        c = rng.integers(-3, 4, n).tolist()
        found, right = maximize(fmpq(H), fmpq(h), fmpq(c)), highest_vertex(H, h, c)
        if right is None:
            empty += 1
            assert found.value == -inf and found.point is None
            continue
        assert Fraction(int(found.value.p), int(found.value.q)) == right
        assert all(rational.dot(a, found.point) <= b for a, b in zip(fmpq(H), fmpq(h)))
        assert rational.dot(fmpq(c), found.point) == found.value
        tight = rng.permutation(len(h))[: n + 1].tolist()
        assert maximize(fmpq(H), fmpq(h), fmpq(c), tight).value == found.value
    assert n == 1 or empty


def test_flat_unbounded_and_empty_sets_are_told_apart():
    rng, seen = np.random.default_rng(0), set()
    for _ in range(300):
        n, rows = int(rng.integers(1, 4)), int(rng.integers(1, 7))
        H, h, c = rng.integers(-1, 2, (rows, n)), rng.integers(-1, 2, rows), rng.integers(-1, 2, n)
        found = maximize(fmpq(H.tolist()), fmpq(h.tolist()), fmpq(c.tolist()))
        other = linprog(-c, A_ub=H, b_ub=h, bounds=[(None, None)] * n)
        feasible = linprog(0 * c, A_ub=H, b_ub=h, bounds=[(None, None)] * n).status == 0
        right = -other.fun if other.status == 0 else inf if feasible else -inf
        assert found.value == right if np.isinf(right) else abs(nearest(found.value) - right) < 1e-9
        seen.add(right if np.isinf(right) else 0)
    assert seen == {inf, -inf, 0}


def test_a_segment_given_by_equalities_has_exact_ends():
    E, x = [[827, 485, -851], [-594, -124, -775]], [593, -744, 953]
    b = [sum(a * y for a, y in zip(row, x)) for row in E]
    H = E + [[-a for a in row] for row in E] + [[1, 0, 0], [-1, 0, 0]]
    h = b + [-value for value in b] + [x[0] + 1, 1 - x[0]]
    assert maximize(fmpq(H), fmpq(h), fmpq([1, 0, 0])).value == 594
    assert maximize(fmpq(H), fmpq(h), fmpq([-1, 0, 0])).value == -592


def test_a_strict_point_lies_on_the_right_side_of_every_row():
    one, half = fmpq([1])[0], fmpq([Fraction(1, 2)])[0]
    rows = fmpq([[1, 0], [-1, 0], [0, 1], [0, -1]])
    x = strict_point(rows, [one] * 4, fmpq([[-1, -1]]), [-2 * one + half])
    assert -x[0] - x[1] < -2 * one + half and max(x) <= one
    assert strict_point(rows, [one] * 4, fmpq([[-1, -1]]), [-2 * one]) is None  # the corner alone is not strict


def test_roundings_go_the_way_they_say():
    rng = np.random.default_rng(1)
    for numerator, denominator in rng.integers(1, 10**9, (200, 2)).tolist():
        for sign, power in product((1, -1), (-1060, -300, 0, 300, 990)):
            value = rational.rational(sign * Fraction(numerator, denominator) * Fraction(2) ** power)
            low, high = below(value), above(value)
            assert binary(low) <= value <= binary(high)
            assert low == high or np.nextafter(low, inf) == high
            assert nearest(value) in (low, high)
    huge = rational.rational(10**400)
    assert above(huge) == inf and below(huge) == np.finfo(float).max and above(-huge) == -below(huge)


def test_a_float_is_rounded_to_itself():
    largest = np.finfo(float).max
    for value in (0.0, 1.0, -0.1, 1 / 3, 2.0**-1074, -(2.0**-1022), largest, -largest):
        assert above(binary(value)) == below(binary(value)) == nearest(binary(value)) == value


def test_a_float_is_the_fraction_that_it_is():
    assert rational.fractions(binary([0.1]))[0] == Fraction(0.1) != Fraction(1, 10)
