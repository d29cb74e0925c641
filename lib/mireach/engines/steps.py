"""Single steps of a loop in rational arithmetic, for any number of states: what a refutation rests on.

Floats find a state and a mode. Around the state the loop is affine, on a polytope whose rows are known without
rounding, and one linear program over the rationals gives the state of it that goes farthest.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from ..arithmetic.balls import flint
from ..arithmetic.rational import binary, dot, fractions, maximize, nearest, rational, strict_point
from .base import Escape, replay

INWARD = 2.0**-30  # share of the way to the middle of a set by which a state is moved, for rounding to be far below
PULLS = 2.0 ** np.arange(-54, -9, 4)  # shares of the way to the middle of a cell that a rounded state is moved


def successor(loop, state, mode, disturbance):
    """A x + B Phi(x) + p + d of a mode, without rounding.

    Parameters
    ----------
    loop : ClosedLoop
    state, disturbance : sequence of n Fraction
    mode : int
        Counted from 0.

    Returns
    -------
    tuple of n Fraction
    """
    x, d = rational(list(state)), rational(list(disturbance))
    u = inputs(loop.network, x)
    A, B, p = (binary(getattr(loop.system.modes[mode], name)) for name in "ABp")
    return fractions([dot(A[i], x) + dot(B[i], u) + p[i] + d[i] for i in range(len(x))])


def inputs(network, x):
    """Phi(x) of a state (n,) of fmpq: list of fmpq."""
    return _apply(network, with_one(x))[0]


def with_bias(weight, bias):
    """(W, b) as an fmpq_mat."""
    rows = np.column_stack([weight, bias])
    return flint().fmpq_mat(*rows.shape, list(binary(rows.ravel())))


@lru_cache(maxsize=64)
def matrices(network):
    """(W, b) of every hidden layer and of the output, as fmpq_mat."""
    return [with_bias(layer.weight, layer.bias) for layer in (*network.hidden, network)]


def with_one(x):
    """A point as a column of an fmpq_mat, 1 below it."""
    return flint().fmpq_mat(len(x) + 1, 1, [*x, 1])


def farthest_step(loop, F, v, x, mode):
    """The step that goes farthest along v, from a state of F on the affine piece of the loop around x.

    Parameters
    ----------
    loop : ClosedLoop
    F : Polytope
    v : array (n,)
    x : array (n,)
        In F & X and the region of the mode, or near them.
    mode : int

    Returns
    -------
    Step, or None
        None where the piece of x does not meet F & X and the region.
    """
    H, h, M, c = _piece(loop, F, x, mode)
    objective = [dot(binary(v), column) for column in zip(*M)]
    x = binary(x)
    slack = np.array([nearest(b - dot(a, x)) for a, b in zip(H, h)])
    best = maximize(H, h, objective, np.argsort(slack, kind="stable")[: len(x)].tolist())
    if best.point is None:
        return None
    D = loop.system.modes[mode].disturbance
    pushed = maximize(binary(D.H), binary(D.h), binary(v))
    value = best.value + dot(binary(v), c) + pushed.value
    return Step(value, best.point, mode, pushed.point, (H, h))


def attained(loop, F, v, witness):
    """v x+ of the first step of a witness, moved a little into F: an fmpq, or None if that is no step from F.

    F is not empty. It is quicker than `farthest_step`, and lower by the little that the state was moved.
    """
    mode, d = loop.system.modes[int(witness.modes[0])], witness.disturbances[0]
    x = witness.states[0]
    x = x + INWARD * (np.array([nearest(entry) for entry in F.point]) - x)
    if not (F.contains(x) and loop.system.state_set.contains(x) and mode.disturbance.contains(d)):
        return None
    x = binary(x)
    u = inputs(loop.network, x)
    if any(dot(a, [*x, *u]) > b for a, b in zip(*mode.region.exact)):
        return None
    after = successor(loop, fractions(x), int(witness.modes[0]), fractions(binary(d)))
    return dot(binary(v), rational(after))


@dataclass(frozen=True, eq=False)
class Step:
    """A step in rational numbers.

    Attributes
    ----------
    value : fmpq
        v x+ of it.
    state, disturbance : tuple of n fmpq
    mode : int
    piece : pair
        Rows (H, h) of the states of F on whose affine piece the state lies.
    """

    value: object
    state: tuple
    mode: int
    disturbance: tuple
    piece: tuple

    def escape(self, loop):
        """The Escape of this step."""
        x, d = fractions(self.state), fractions(self.disturbance)
        return Escape(x, self.mode, d, successor(loop, x, self.mode, d))

    def witness(self, loop, v, limit):
        """A Witness that passes `limit` along v without rounding, from a state that lies in F as the floats that it is.

        Where no floats do that, such as on a flat F, it is the step rounded to floats. `exact` is the step itself.
        """
        return replace(self._in_floats(loop, v, limit), exact=self.escape(loop))

    def _in_floats(self, loop, v, limit):
        D = loop.system.modes[self.mode].disturbance
        rows_d = binary(D.H), binary(D.h)
        middle = strict_point((), (), *self.piece), strict_point((), (), *rows_d)
        for share in (0.0, *PULLS):
            x, d = (_pulled(end, to, share) for end, to in zip((self.state, self.disturbance), middle))
            inside = all(dot(a, binary(x)) <= b for a, b in zip(*self.piece))
            if inside and all(dot(a, binary(d)) <= b for a, b in zip(*rows_d)):
                after = rational(list(successor(loop, fractions(binary(x)), self.mode, fractions(binary(d)))))
                if dot(binary(v), after) > binary(limit):
                    return replay(loop, x, [self.mode], [d])
        x, d = (np.array([nearest(entry) for entry in part]) for part in (self.state, self.disturbance))
        return replay(loop, x, [self.mode], [d])


def _pulled(point, middle, share):
    """A point moved by a share of the way to the middle, in floats."""
    if middle is not None and share:
        share = binary(share)
        point = [entry + share * (to - entry) for entry, to in zip(point, middle)]
    return np.array([nearest(entry) for entry in point])


def _piece(loop, F, x, mode):
    """The states of F & X in the region of a mode, on the affine piece of x: rows H, h; and x+ = M x + c on it."""
    n, system = len(x), loop.system
    identity = flint().fmpq_mat(n + 1, n + 1, [int(i == j) for i in range(n + 1) for j in range(n + 1)])
    _, output, rows = _apply(loop.network, with_one(binary(x)), identity)
    region, (A, B, p) = system.modes[mode].region, (binary(getattr(system.modes[mode], name)) for name in "ABp")
    rows += [(a, b) for P in (F, system.state_set) for a, b in zip(binary(P.H), binary(P.h))]
    for a, b in zip(binary(region.H), binary(region.h)):
        of_u = [dot(a[n:], column) for column in zip(*output)]
        rows.append((tuple(own + part for own, part in zip(a[:n], of_u)), b - of_u[n]))
    closed = [[dot(row, column) for column in zip(*output)] for row in B]
    M = [tuple(own + part for own, part in zip(row, of_u)) for row, of_u in zip(A, closed)]
    c = [of_u[n] + offset for of_u, offset in zip(closed, p)]
    H, h = zip(*rows)
    return H, h, M, c


def _apply(network, y, affine=None):
    """Phi at a point y (n + 1, 1); with `affine`, also (K, g) of its piece and the rows (a, b) of where it holds."""
    rows = []
    for layer, weight in zip(network.hidden, matrices(network)):
        values = [row[0] for row in (weight * y).tolist()]
        groups = [range(start, start + layer.pool) for start in range(0, len(values), layer.pool)]
        won = [max(group, key=values.__getitem__) for group in groups]
        y = flint().fmpq_mat(layer.width + 1, 1, [*(values[j] for j in won), 1])
        if affine is not None:
            z = (weight * affine).tolist()
            last = affine.tolist()[-1]
            for group, j in zip(groups, won):
                for i in group:
                    if i != j:
                        *a, b = (other - own for other, own in zip(z[i], z[j]))
                        rows.append((tuple(a), -b))
            entries = [entry for j in won for entry in z[j]] + last
            affine = flint().fmpq_mat(layer.width + 1, len(last), entries)
    weight = matrices(network)[-1]
    u = [row[0] for row in (weight * y).tolist()]
    return u, None if affine is None else (weight * affine).tolist(), rows
