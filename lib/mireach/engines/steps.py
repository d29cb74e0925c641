"""Single steps of a loop in rational arithmetic, for any number of states. Refutations are based on them.

Floats give a state and a mode. Around the state the loop is affine, on a polytope whose rows are rational, and one
linear program over the rationals gives the state of that polytope whose successor is largest along a direction.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from ..arithmetic.balls import flint
from ..arithmetic.rational import binary, dot, fractions, maximize, nearest, rational, strict_point
from ..sets.polytope import Polytope
from ..systems.loop import ClosedLoop
from ..systems.network import MaxoutNetwork
from ..systems.pwa import Mode
from ..tolerances import INWARD
from ..typing import Array, Rational
from .base import Escape, Witness, replay

PULLS = 2.0 ** np.arange(-54, -9, 4)  # shares of the way to the middle of a cell that a rounded state is moved

Row = tuple[tuple[Rational, ...], Rational]  # (a, b), the half-space a x <= b
Form = tuple[Rational, ...]  # (a, c), the affine function a x + c


def successor(
    loop: ClosedLoop, state: Sequence[Fraction], mode: int, disturbance: Sequence[Fraction]
) -> tuple[Fraction, ...]:
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
    xu = (*x, *inputs(loop.network, x))
    return fractions([value + part for value, part in zip(values(dynamics(loop.system.modes[mode]), xu), d)])


def inputs(network: MaxoutNetwork, x: Sequence[Rational]) -> list[Rational]:
    """Phi(x) of a state (n,) of fmpq: list of fmpq."""
    *hidden, output = matrices(network)
    y = _with_one(x)
    for layer, weight in zip(network.hidden, hidden):
        z = _column(weight * y)
        y = _with_one([z[j] for j in _winners(z, layer.pool)])
    return _column(output * y)


def with_bias(weight: Array, bias: Array) -> Any:
    """(W, b) as an fmpq_mat."""
    rows = np.column_stack([weight, bias])
    return flint().fmpq_mat(*rows.shape, list(binary(rows.ravel())))


@lru_cache(maxsize=64)
def matrices(network: MaxoutNetwork) -> list[Any]:
    """(W, b) of every hidden layer and of the output, as fmpq_mat."""
    parts = [*((layer.weight, layer.bias) for layer in network.hidden), (network.weight, network.bias)]
    return [with_bias(weight, bias) for weight, bias in parts]


@lru_cache(maxsize=1024)
def dynamics(mode: Mode) -> list[Form]:
    """The rows of A x + B u + p as affine functions of (x, u)."""
    return [binary(row) for row in np.column_stack([mode.A, mode.B, mode.p])]


def values(forms: Sequence[Form], y: Sequence[Rational]) -> list[Rational]:
    """The values of affine functions at y."""
    return [dot(form, y) + form[-1] for form in forms]


class NetworkPiece(NamedTuple):
    """Phi on the affine piece around a point, composed with an affine map x = E y + e.

    Attributes
    ----------
    output : list of Form
        Phi(E y + e) as affine functions of y.
    rows : list of Row
        The y for which the same channels are largest.
    winners : list of int
        The largest channel of every neuron, layer by layer; the first of those that tie.
    """

    output: list[Form]
    rows: list[Row]
    winners: list[int]


def network_piece(network: MaxoutNetwork, y: Sequence[Rational], forms: Sequence[Form]) -> NetworkPiece:
    """The NetworkPiece around the point y (k,), for x = E y + e given as affine functions of y."""
    *hidden, output = matrices(network)
    point, constant = _with_one(y), [0] * len(y) + [1]
    affine = _stacked(forms, constant)
    rows, winners = [], []
    for layer, weight in zip(network.hidden, hidden):
        product = weight * affine
        z, won = product.tolist(), _winners(_column(product * point), layer.pool)
        for neuron, j in enumerate(won):
            for i in range(neuron * layer.pool, (neuron + 1) * layer.pool):
                if i != j:
                    *a, b = (other - own for other, own in zip(z[i], z[j]))
                    rows.append((tuple(a), -b))
        winners += won
        affine = _stacked([z[j] for j in won], constant)
    return NetworkPiece([tuple(row) for row in (output * affine).tolist()], rows, winners)


def composed(forms: Sequence[Form], inner: Sequence[Form]) -> list[Form]:
    """Affine functions of affine functions."""
    columns = list(zip(*inner))
    return [(*(dot(form, column) for column in columns[:-1]), dot(form, columns[-1]) + form[-1]) for form in forms]


def composed_rows(rows: Sequence[Row], inner: Sequence[Form]) -> list[Row]:
    """The half-spaces in which affine functions satisfy the rows (a, b)."""
    columns = list(zip(*inner))
    return [(tuple(dot(a, column) for column in columns[:-1]), b - dot(a, columns[-1])) for a, b in rows]


def identity(n: int) -> list[Form]:
    """The coordinates of R^n as affine functions."""
    one, zero = flint().fmpq(1), flint().fmpq(0)
    return [tuple(one if i == j else zero for j in range(n + 1)) for i in range(n)]


def _with_one(x: Sequence[Rational]) -> Any:
    """A point as a column of an fmpq_mat, 1 below it."""
    return flint().fmpq_mat(len(x) + 1, 1, [*x, 1])


def _stacked(forms: Sequence[Sequence[Rational]], last: Sequence[int]) -> Any:
    """Affine functions as the rows of an fmpq_mat, `last` below them."""
    return flint().fmpq_mat(len(forms) + 1, len(last), [entry for form in (*forms, last) for entry in form])


def _column(product: Any) -> list[Rational]:
    """The entries of an fmpq_mat with one column."""
    return [row[0] for row in product.tolist()]


def _winners(z: Sequence[Rational], pool: int) -> list[int]:
    """The index of the largest channel of each neuron, the first of those that tie."""
    return [max(range(first, first + pool), key=z.__getitem__) for first in range(0, len(z), pool)]


@dataclass(frozen=True, eq=False)
class Step:
    """A step in rational numbers.

    Attributes
    ----------
    value : fmpq
        v x+ of it.
    state : tuple of n fmpq
    mode : int
    disturbance : tuple of n fmpq
    piece : pair
        Rows (H, h) of the states of F on whose affine piece the state lies.
    """

    value: Rational
    state: tuple[Rational, ...]
    mode: int
    disturbance: tuple[Rational, ...]
    piece: tuple[Sequence[tuple[Rational, ...]], Sequence[Rational]]

    def escape(self, loop: ClosedLoop) -> Escape:
        """The Escape of this step."""
        x, d = fractions(self.state), fractions(self.disturbance)
        return Escape(x, self.mode, d, successor(loop, x, self.mode, d))

    def witness(self, loop: ClosedLoop, v: Array, limit: float) -> Witness:
        """A Witness that exceeds `limit` along v without rounding, from a state whose floats lie in F.

        Where no floats do that, such as on a flat F, it is the step rounded to floats. `exact` is the step itself.
        """
        return replace(self._in_floats(loop, v, limit), exact=self.escape(loop))

    def _in_floats(self, loop: ClosedLoop, v: Array, limit: float) -> Witness:
        """The Witness of `witness`, without `exact`."""
        D = loop.system.modes[self.mode].disturbance
        middle = strict_point((), (), *self.piece), strict_point((), (), *D.exact)
        for share in (0.0, *PULLS):
            x, d = (_pulled(end, to, share) for end, to in zip((self.state, self.disturbance), middle))
            inside = all(dot(a, binary(x)) <= b for a, b in zip(*self.piece))
            if inside and all(dot(a, binary(d)) <= b for a, b in zip(*D.exact)):
                after = rational(list(successor(loop, fractions(binary(x)), self.mode, fractions(binary(d)))))
                if dot(binary(v), after) > binary(limit):
                    return replay(loop, x, [self.mode], [d])
        x, d = (np.array([nearest(entry) for entry in part]) for part in (self.state, self.disturbance))
        return replay(loop, x, [self.mode], [d])


def farthest_step(loop: ClosedLoop, F: Polytope, v: Array, x: Array, mode: int) -> Step | None:
    """The step with the largest v x+ from a state of F on the affine piece of the loop around x.

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
    rows, after = _piece(loop, F, x, mode)
    H, h = zip(*rows)
    direction, state = binary(v), binary(x)
    *objective, constant = (dot(direction, column) for column in zip(*after))
    slack = np.array([nearest(b - dot(a, state)) for a, b in rows])
    best = maximize(H, h, objective, np.argsort(slack, kind="stable")[: len(x)].tolist())
    if best.point is None:
        return None
    of_d, limits = loop.system.modes[mode].disturbance.exact
    pushed = maximize(of_d, limits, direction)
    if pushed.point is None:
        return None
    return Step(best.value + constant + pushed.value, best.point, mode, pushed.point, (H, h))


def attained(loop: ClosedLoop, F: Polytope, v: Array, witness: Witness) -> Rational | None:
    """v x+ of the first step of a witness, moved slightly into F: an fmpq, or None if that is no step from F.

    F is not empty. This is faster than `farthest_step`, and its value is slightly lower, since the state is moved.
    """
    mode, d = loop.system.modes[int(witness.modes[0])], witness.disturbances[0]
    x = witness.states[0]
    if F.point is None:
        return None
    x = x + INWARD * (np.array([nearest(entry) for entry in F.point]) - x)
    if not (F.contains(x) and loop.system.state_set.contains(x) and mode.disturbance.contains(d)):
        return None
    state = binary(x)
    xu = (*state, *inputs(loop.network, state))
    if any(dot(a, xu) > b for a, b in zip(*mode.region.exact)):
        return None
    after = [value + part for value, part in zip(values(dynamics(mode), xu), binary(d))]
    return dot(binary(v), after)


def _pulled(point: Sequence[Rational], middle: Sequence[Rational] | None, share: float) -> Array:
    """A point moved by a share of the way to the middle, in floats."""
    if middle is not None and share:
        part = binary(share)
        point = [entry + part * (to - entry) for entry, to in zip(point, middle)]
    return np.array([nearest(entry) for entry in point])


def _piece(loop: ClosedLoop, F: Polytope, x: Array, mode: int) -> tuple[list[Row], list[Form]]:
    """The states of F & X in the region of a mode, on the affine piece of x: rows; and x+ on it, without d."""
    acting, start = loop.system.modes[mode], identity(len(x))
    piece = network_piece(loop.network, binary(x), start)
    xu = [*start, *piece.output]
    rows = [*piece.rows, *zip(*F.exact), *zip(*loop.system.state_set.exact)]
    return rows + composed_rows(list(zip(*acting.region.exact)), xu), composed(dynamics(acting), xu)
