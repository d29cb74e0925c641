"""Exact polytopes: against all meetings of n rows in fractions of the standard library."""

from fractions import Fraction
from itertools import combinations, product
from operator import mul

import numpy as np
import pytest
from loops import solve_exactly

from mireach import Polytope
from mireach.arithmetic.rational import binary, fractions
from mireach.sets.exact_polytopes import ExactPolytope, dimension, integers


def enumerated(rows):
    """All vertices of the polytope with the rows (a, b): the points in which n rows meet that satisfy all rows."""
    found = set()
    for chosen in combinations(rows, len(rows[0][0])):
        x = solve_exactly([a for a, _ in chosen], [b for _, b in chosen])
        if x is not None and all(sum(map(mul, a, x)) <= b for a, b in rows):
            found.add(tuple(x))
    return found


def in_fractions(H, h):
    """The rows (a, b) of H x <= h."""
    return [([Fraction(entry) for entry in a], Fraction(b)) for a, b in zip(np.asarray(H).tolist(), list(h))]


def rank(points):
    """The dimension of the affine hull of points in fractions (Gauss)."""
    if not points:
        return -1
    first, *others = points
    rows, found = [[a - b for a, b in zip(x, first)] for x in others], 0
    for column in range(len(first)):
        pivot = next((row for row in rows if row[column]), None)
        if pivot is not None:
            found += 1
            rows = [
                [a - row[column] / pivot[column] * b for a, b in zip(row, pivot)] for row in rows if row is not pivot
            ]
    return found


def assert_is(part, H, h):
    """`part` is {x : H x <= h}: its vertices, its dimension, and the rows that are tight at each vertex."""
    points = [fractions(x) for x in part.vertices]
    expected = enumerated(in_fractions(H, h))
    assert len(points) == len(set(points)) and set(points) == expected
    assert part.dimension == rank(sorted(expected)) == dimension(part.points)
    for x, mask in zip(part.points, part.tight):
        for i, row in enumerate(part.rows):
            value = sum(map(mul, row, x))
            assert value <= 0 and (value == 0) == bool(mask >> i & 1)
    if points:
        assert enumerated([(fractions(a), *fractions([b])) for a, b in part.half_spaces]) == expected


def cube(n):
    return np.vstack([np.eye(n), -np.eye(n)]), np.ones(2 * n)


def cut_cube(n):
    """A cube cut through vertices: x_1 + ... + x_n <= n - 2 and the opposite corner."""
    H, h = cube(n)
    return np.vstack([H, np.ones(n), -np.ones(n)]), np.append(h, [n - 2, n - 2])


def cross_polytope(n):
    return np.array(list(product([1.0, -1.0], repeat=n))), np.ones(2**n)


def pyramid(n):
    """Apex (0, ..., 0, 1), at which 2 (n - 1) facets meet, over a cube of n - 1 dimensions."""
    sides = np.vstack([np.eye(n)[:-1], -np.eye(n)[:-1]])
    sides[:, -1] = 1
    return np.vstack([sides, -np.eye(n)[-1:]]), np.append(np.ones(len(sides)), 0)


def repeated(n):
    """A simplex, each row twice, once in another length, and rows that touch a vertex or miss it."""
    H, h = np.vstack([-np.eye(n), np.ones((1, n))]), np.append(np.zeros(n), 1.0)
    extra = np.eye(n)[0] + 0.5 * np.ones(n)
    return np.vstack([H, 4 * H, extra, extra]), np.concatenate([h, 4 * h, [1.5, 7.0]])


def flat(n):
    """A cross-polytope in the hyperplane x_1 = x_2."""
    H, h = cross_polytope(n)
    a = np.eye(n)[0] - np.eye(n)[1]
    return np.vstack([H, a, -a]), np.append(h, [0, 0])


def edge(n):
    """The part of a cube in which x_1 + ... + x_(n-1) is largest."""
    H, h = cube(n)
    return np.vstack([H, -1.0 * (np.arange(n) < n - 1)]), np.append(h, 1.0 - n)


def corner(n):
    H, h = cube(n)
    return np.vstack([H, -np.ones((1, n))]), np.append(h, -float(n))


def nothing(n):
    H, h = cube(n)
    return np.vstack([H, -np.ones((1, n))]), np.append(h, -np.nextafter(n, n + 1.0))


SHAPES = [cube, cut_cube, cross_polytope, pyramid, repeated, flat, edge, corner, nothing]


@pytest.mark.parametrize(
    ("shape", "n"), [*product(SHAPES, [2, 3]), (cube, 4), (cut_cube, 4), (pyramid, 4), (repeated, 4), (edge, 4)]
)
def test_vertices_of_degenerate_polytopes_are_all_meetings_of_n_rows(shape, n):
    H, h = shape(n)
    assert_is(ExactPolytope.of(Polytope(H, h)), H, h)


@pytest.mark.parametrize("n", [2, 3, 4, 5])
@pytest.mark.parametrize("seed", range(3))
def test_vertices_of_random_polytopes_are_all_meetings_of_n_rows(n, seed):
    rng = np.random.default_rng([n, seed])
    H, h = cube(n)
    rows = 5 if n < 5 else 2
    whole = rng.integers(-2, 3, (rows, n)).astype(float)  # small integers meet vertices often
    H, h = np.vstack([H, whole, rng.normal(size=(1, n))]), np.concatenate([h, rng.integers(0, 4, rows), [0.3]])
    assert_is(ExactPolytope.of(Polytope(H, h)), H, h)


@pytest.mark.parametrize("shape", [cut_cube, cross_polytope, pyramid, flat])
@pytest.mark.parametrize("n", [2, 3])
def test_one_row_more_cuts_as_if_it_had_been_there(shape, n):
    H, h = shape(n)
    rng, part = np.random.default_rng(n), ExactPolytope.of(Polytope(H, h))
    for a in rng.integers(-2, 3, (6, n)).astype(float):
        for b in (-1.0, 0.0, 0.5, 1.0, 2.0):
            row = integers((*binary(a), -binary(b)))
            assert_is(part.clip(row), np.vstack([H, a]), np.append(h, b))


def test_a_row_that_only_touches_leaves_the_polytope_as_it_is():
    square = ExactPolytope.box([(0, 1), (0, 1)])
    assert square.clip(integers([1, 1, -2])) is square and square.clip(integers([0, 0, -1])) is square
    assert square.clip(integers([0, 0, 1])).is_empty


def test_floats_are_taken_as_they_are():
    part = ExactPolytope.of(Polytope.box([0.1, 0.2, -0.3], [0.1, 0.7, 1e-300]))
    assert part.dimension == 2
    assert set(map(fractions, part.vertices)) == {
        (Fraction(0.1), b, c) for b in (Fraction(0.2), Fraction(0.7)) for c in (Fraction(-0.3), Fraction(1e-300))
    }


def test_an_unbounded_polytope_is_refused():
    with pytest.raises(ValueError, match="unbounded"):
        ExactPolytope.of(Polytope([[1.0, 0], [0, 1], [0, -1]], [1, 1, 1]))
