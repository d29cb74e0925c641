"""Modes for the tests of systems: the same dynamics in different regions."""

import numpy as np

from mireach import Mode, Polytope

X, U = Polytope.box([-2, -2], [2, 2]), Polytope.box([-1], [1])


def mode(region, D=None, n=2, m=1):
    return Mode(np.eye(n), np.ones((n, m)), np.zeros(n), region, D)


def halves(normal, left, right):
    """The regions normal (x, u) <= left and normal (x, u) >= right."""
    normal = np.array([normal], float)
    return [mode(Polytope(normal, [left])), mode(Polytope(-normal, [-right]))]
