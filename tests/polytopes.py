"""Polytopes that tests share: random ones, flat and nearly flat ones, and their numbers as fractions."""

from fractions import Fraction
from itertools import combinations

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from loops import solve_exactly

from mireach import Polytope

small = st.floats(-5, 5, allow_subnormal=False)
rows = arrays(float, (4, 2), elements=small)


@st.composite
def polytopes(draw, n=2):
    """Nonempty bounded sets: a box of any size, cut by random rows that keep its middle."""
    rng = np.random.default_rng(draw(st.integers(0, 10**6)))
    middle, reach = rng.uniform(-3, 3, n), rng.uniform(0.2, 3, n)
    H = rng.normal(size=(draw(st.integers(0, 4)), n))
    return Polytope.box(middle - reach, middle + reach) & Polytope(H, H @ middle + rng.uniform(0, 2, len(H)))


def exactly(numbers):
    """Floats, or rows of them, as Fractions."""
    return [exactly(one) if np.ndim(one) else Fraction(one) for one in np.asarray(numbers, float).tolist()]


def fraction(value):
    return Fraction(int(value.p), int(value.q))


def whole_vector(rng, n, reach=1000):
    return rng.integers(-reach, reach, n).astype(float)


def flat(rng, n):
    """A set around a point of whole numbers, of which one to n equalities in whole numbers hold."""
    x, E = whole_vector(rng, n), np.array([whole_vector(rng, n) for _ in range(rng.integers(1, n + 1))])
    box = np.vstack([np.eye(n), -np.eye(n)])
    return np.vstack([E, -E, box]), np.concatenate([E @ x, -E @ x, x + 1, 1 - x])


def nearly_flat(rng, n):
    """Rows that nearly oppose each other, at a distance that may be zero or negative."""
    a, width = rng.normal(size=n), 10.0 ** -rng.integers(3, 17)
    H = np.vstack([a + width * rng.normal(size=n), -a, -a + width * rng.normal(size=n), np.eye(n), -np.eye(n)])
    return H, np.concatenate([[width, 0, width * rng.normal()], np.full(2 * n, 1000.0)])


def far_away(rng, n):
    """A box, some of whose sides have no length, far from the origin for its size."""
    x, reach = whole_vector(rng, n), rng.integers(0, 3, n) * 10.0 ** -rng.integers(0, 8)
    return np.vstack([np.eye(n), -np.eye(n)]), np.concatenate([x + reach, reach - x])


def ordinary(rng, n):
    """Random rows around or near the origin; often empty."""
    H = np.vstack([np.eye(n), -np.eye(n), rng.normal(size=(3, n))])
    return H, rng.normal(size=len(H)) + 0.7


def random_set(rng, n, kind, unit=0):
    """A bounded set of R^n in units of 2^unit: with an interior, flat, or a point."""
    if kind == "fat":
        H = np.vstack([np.eye(n), -np.eye(n), rng.normal(size=(2, n))])
        h = rng.uniform(0.5, 2, len(H))
    elif kind == "flat":  # one equality, in whole numbers
        a, x = whole_vector(rng, n, 5), whole_vector(rng, n, 5)
        H, h = np.vstack([a, -a, np.eye(n), -np.eye(n)]), np.concatenate([[a @ x, -a @ x], x + 1, 1 - x])
    else:
        x = whole_vector(rng, n, 5)
        H, h = np.vstack([np.eye(n), -np.eye(n)]), np.concatenate([x, -x])
    return Polytope(H, np.ldexp(h, unit))


def exact_corners(P):
    """The vertices of P as Fractions, from all n rows at a time."""
    H, h = exactly(P.H), exactly(P.h)
    met = (solve_exactly([H[i] for i in rows], [h[i] for i in rows]) for rows in combinations(range(len(h)), len(H[0])))
    return {tuple(x) for x in met if x is not None and all(product(a, x) <= b for a, b in zip(H, h))}


def product(a, x):
    return sum(left * right for left, right in zip(a, x))
