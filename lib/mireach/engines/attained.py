"""Trajectories that are attained without rounding: float states are tried, moved inward where they have to be.

Points of linear programs lie outside of their sets by the solver's tolerance, and at the tip of a needle far outside.
What is said to be attained here comes from a state that satisfies every constraint in rational arithmetic.
"""

from functools import lru_cache
from time import perf_counter

import numpy as np

from ..arithmetic import rational
from ..arithmetic.balls import flint
from ..errors import SolverError
from ..sets.polytope import Polytope
from ..solvers.linear_program import LinearProgram
from .base import Witness
from .bounds import far_points

INWARD = (1e-12, 1e-10, 1e-8, 1e-6, 1e-4)  # shares of the way to a centre by which a state is moved, one after another
CORNERS = 12  # of the set where trajectories start, towards which other pieces are looked for
BESIDE = 1e-6  # share of the way to a corner at which another piece of the loop is looked for
CLOSE = 1e-9  # a value this close to what floats claimed is taken at once (relative to 1 + its size)
FLAT = 1e-9  # radius of the largest ball in a set below which it is flat (units of x)
CACHED = 64  # loops and disturbance sets that are kept as rationals


class Attained:
    """A trajectory of the loop in rational arithmetic.

    Attributes
    ----------
    value : float
        v x(k) (or v u(0)), rounded downward.
    states, inputs, disturbances : list of tuples of fmpq
    modes : list of int
    """

    def __init__(self, value, states, inputs, modes, disturbances):
        self.value, self.states, self.inputs = rational.below(value), states, inputs
        self.modes, self.disturbances = modes, disturbances

    @property
    def start(self):
        """x(0), rounded to floats: (n,)."""
        return _floats(self.states[:1])[0]

    def witness(self):
        """The trajectory, rounded to floats, as a Witness."""
        n, m, steps = len(self.states[0]), len(self.inputs[0]), len(self.modes)
        return Witness(
            _floats(self.states).reshape(-1, n),
            _floats(self.inputs).reshape(-1, m)[:steps],
            np.array(self.modes, int),
            _floats(self.disturbances).reshape(-1, n),
        )


def attained(loop, F, v, paths, inputs=False, end=np.inf):
    """The best Attained that is found near float trajectories, or None.

    Parameters
    ----------
    loop : ClosedLoop
    F : Polytope
        In X; where trajectories start.
    v : array (n,), or (m,) for inputs
    paths : list of (value, (x(0), modes, disturbances))
        The best first, `value` being what floats claim. The last disturbance is chosen anew.
    inputs : bool
        Ask for v u(0) instead of v x(k).
    end : float
        The `perf_counter` after which each path is tried once only.
    """
    exact, best, v = _exact(loop), None, rational.binary(v)
    for starts in (_itself, _towards_the_middle, _inside_of_its_piece, _best_of_pieces):
        for claimed, (x, modes, disturbances) in paths[: 1 if starts is _best_of_pieces else None]:
            enough = claimed - CLOSE * (1 + abs(claimed))
            if best is not None and best.value >= enough:
                break
            for start in starts(loop, F, v, np.asarray(x, float), modes, disturbances):
                found = exact.replay(F.exact, v, start, modes, disturbances, inputs)
                if found is not None and (best is None or found.value > best.value):
                    best = found
                if (best is not None and best.value >= enough) or perf_counter() > end:
                    break
    return best


# -- states near x as rationals (None where there is none), from the cheapest to the most thorough -------------------


def _itself(loop, F, v, x, modes, disturbances):
    """x as it is."""
    yield rational.binary(x)


def _towards_the_middle(loop, F, v, x, modes, disturbances):
    """x moved towards the centre of F."""
    yield from _moved(F, x, _centre(F))


def _inside_of_its_piece(loop, F, v, x, modes, disturbances):
    """x moved towards the centre of its piece of the loop; the points of F that are nearest to these, if it is flat."""
    centre = _centre(_part(loop, F, x, modes, disturbances)) if modes else None
    yield from _moved(F, x, centre)
    for towards in (centre, _centre(F)):
        for share in (0.0, *INWARD) if towards is not None else ():
            yield _nearest(F, x + share * (towards - x))


def _best_of_pieces(loop, F, v, x, modes, disturbances):
    """The best states of whole pieces of the loop: that of x and, as channels may tie there, those beside it."""
    seen = set()
    for near in [x, *(x + BESIDE * (corner - x) for corner in _corners(F))] if modes else ():
        yield _exact(loop).best_of_piece(F, v, near, modes, disturbances, seen)


def _moved(F, x, centre):
    """x moved towards a point, if there is one, by more and more."""
    for share in INWARD if centre is not None else ():
        yield rational.binary(x + share * (centre - x))


@lru_cache(maxsize=4 * CACHED)
def _corners(P):
    """Points of P that are farthest along some directions."""
    return far_points(P, np.random.default_rng(0).normal(size=(CORNERS, P.dimension)))


def _part(loop, F, x, modes, disturbances):
    """The part of F on which the channels that win along a trajectory from x keep winning and its modes keep acting.

    All values are affine functions of x(0) there: E x(0) + e.
    """
    n, rows, limits = loop.system.state_size, [F.H], [F.h]
    E, e = np.eye(n), np.zeros(n)
    for j, i in enumerate(modes):
        mode, K, g = loop.system.modes[i], E, e
        for layer in loop.network.hidden:
            Z, z = layer.weight @ K, layer.weight @ g + layer.bias
            first = np.arange(layer.width) * layer.pool
            winner = first + (Z @ x + z).reshape(layer.width, layer.pool).argmax(axis=1)
            K, g = Z[winner], z[winner]
            rows.append(Z - np.repeat(K, layer.pool, axis=0))
            limits.append(np.repeat(g, layer.pool) - z)
        U, c = loop.network.weight @ K, loop.network.weight @ g + loop.network.bias
        H, h = mode.region.H, mode.region.h
        rows.append(H[:, :n] @ E + H[:, n:] @ U)
        limits.append(h - H[:, :n] @ e - H[:, n:] @ c)
        if j + 1 < len(modes):
            d, X = disturbances[j], loop.system.state_set
            E, e = mode.A @ E + mode.B @ U, mode.A @ e + mode.B @ c + mode.p + d
            rows.append(X.H @ E)
            limits.append(X.h - X.H @ e)
    H, h = np.vstack(rows), np.concatenate(limits)
    known = np.isfinite(H).all(axis=1) & np.isfinite(h) & H.any(axis=1)
    return Polytope(H[known], h[known])


@lru_cache(maxsize=4 * CACHED)
def _centre(P):
    """The centre of a large ball in P, or where P is flat a point inside of all rows that allow it; None if empty."""
    length, n = np.linalg.norm(P.H, axis=1), P.dimension
    for ball in (True, False):
        lp = LinearProgram()
        x = lp.add_columns(np.full(n, -np.inf), np.full(n, np.inf))
        room = lp.add_columns(np.zeros(1 if ball else len(P.h)), 1)
        for k, (a, b) in enumerate(zip(P.H, P.h)):  # a ball of radius t, or a distance t of each row
            lp.add_row([*x, room[0 if ball else k]], [*a, length[k]], upper=b)
        try:
            best = lp.maximize(room, np.ones(len(room)))
        except SolverError:
            return None
        if best.point is None:
            return None
        if not ball or best.value > FLAT:
            return best.point[:n]
    return None


def _nearest(P, x):
    """The point of P that is nearest to x in the sum of distances, or None if P is empty: a rational linear program."""
    zero, one, n = flint().fmpq(0), flint().fmpq(1), len(x)
    H, h = P.exact
    rows, limits = [(*row, *[zero] * n) for row in H], list(h)
    for i, entry in enumerate(rational.binary(x)):
        for sign in (one, -one):  # |x_i - entry| <= t_i
            row = [zero] * (2 * n)
            row[i], row[n + i] = sign, -one
            rows.append(tuple(row))
            limits.append(sign * entry)
    found = rational.maximize(rows, limits, (*[zero] * n, *[-one] * n))
    return None if found.point is None else found.point[:n]


@lru_cache(maxsize=64 * CACHED)
def _farthest(D, v):
    """A point of D that attains its support function along the rational vector v, or None if D is empty."""
    return D.exact_maximum(v).point


@lru_cache(maxsize=CACHED)
def _exact(loop):
    return _ExactLoop(loop)


class _ExactLoop:
    """A closed loop as rationals."""

    def __init__(self, loop):
        self.layers = [(_sparse(layer.weight, layer.bias), layer.pool) for layer in loop.network.hidden]
        self.output = _sparse(loop.network.weight, loop.network.bias)
        self.modes = [
            (
                _sparse(mode.region.H, -mode.region.h),
                _sparse(np.hstack([mode.A, mode.B]), mode.p),
                mode.disturbance,
            )
            for mode in loop.system.modes
        ]
        X = loop.system.state_set
        self.state_set = _sparse(X.H, -X.h)

    def network(self, x):
        """Phi(x)."""
        for rows, pool in self.layers:
            z = _values(rows, x)
            x = [max(z[i : i + pool]) for i in range(0, len(z), pool)]
        return _values(self.output, x)

    def replay(self, inside, v, x, modes, disturbances, inputs):
        """The Attained from x: given modes and disturbances, at the last step the best of both; None if none exists."""
        if x is None or any(rational.dot(row, x) > limit for row, limit in zip(*inside)):
            return None
        states, used, acted, moved = [tuple(x)], [], [], []
        for j in range(max(len(modes), 1)):
            xu = (*states[-1], *self.network(states[-1]))
            used.append(xu[len(x) :])
            if inputs:
                return Attained(rational.dot(v, used[0]), states, used, [], [])
            if j and max(_values(self.state_set, states[-1])) > 0:
                return None
            last = j + 1 == len(modes)
            ends = []
            for i in range(len(self.modes)) if last else [modes[j]]:
                region, image, D = self.modes[i]
                if region and max(_values(region, xu)) > 0:
                    continue
                d = _farthest(D, v) if last else self._inside(D, disturbances[j])
                if d is not None:
                    after = tuple(a + b for a, b in zip(_values(image, xu), d))
                    ends.append((rational.dot(v, after), after, i, d))
            if not ends:
                return None
            value, after, i, d = max(ends, key=lambda end: end[0])
            states.append(after)
            acted.append(i)
            moved.append(d)
        return Attained(value, states, used, acted, moved)

    def best_of_piece(self, F, v, near, modes, disturbances, seen):
        """The state of F that is best along v among those at which the channels win that win at `near`: a rational LP.

        `seen` holds the winners that were tried already; for these, and where there is no such state, it is None.
        """
        one, zero = flint().fmpq(1), flint().fmpq(0)
        x, n = rational.binary(near), len(near)
        E = [(*(one if i == j else zero for j in range(n)), zero) for i in range(n)]  # x(j) = E (x(0), 1)
        rows, winners = [(*row, -limit) for row, limit in zip(*F.exact)], []
        for j, i in enumerate(modes):
            q, (region, image, D) = E, self.modes[i]
            for channels, pool in self.layers:
                z = _compose(channels, q)
                at = [rational.dot(function, (*x, one)) for function in z]
                first = range(0, len(z), pool)
                best = [max(range(k, k + pool), key=at.__getitem__) for k in first]
                rows += [_minus(z[c], z[w]) for k, w in zip(first, best) for c in range(k, k + pool) if c != w]
                winners += best
                q = [z[w] for w in best]
            xu = [*E, *_compose(self.output, q)]
            rows += _compose(region, xu)
            E = _compose(image, xu)
            if j + 1 < len(modes):
                d = self._inside(D, disturbances[j])
                if d is None:
                    return None
                E = [(*function[:n], function[n] + shift) for function, shift in zip(E, d)]
                rows += _compose(self.state_set, E)
        if tuple(winners) in seen:
            return None
        seen.add(tuple(winners))
        goal = [rational.dot(v, column) for column in zip(*E)]
        return rational.maximize([row[:n] for row in rows], [-row[n] for row in rows], goal[:n]).point

    @staticmethod
    def _inside(D, d):
        """A disturbance near d that lies in D, or None."""
        H, h = D.exact
        centre = _centre(D)
        for share in (0.0, *INWARD) if centre is not None else (0.0,):
            moved = rational.binary(d if centre is None else d + share * (centre - d))
            if all(rational.dot(row, moved) <= limit for row, limit in zip(H, h)):
                return moved
        return _nearest(D, np.asarray(d, float))


def _sparse(matrix, offsets):
    """Rows of matrix y + offsets as lists of (column, coefficient), and the offset."""
    return [
        ([(int(k), rational.binary(row[k])) for k in np.flatnonzero(row)], rational.binary(offset))
        for row, offset in zip(matrix, offsets)
    ]


def _values(rows, y):
    """The values of sparse rows at y."""
    found = []
    for terms, total in rows:
        for k, coefficient in terms:
            total = total + coefficient * y[k]
        found.append(total)
    return found


def _compose(rows, functions):
    """Sparse rows of affine functions, each a tuple of coefficients with the constant last."""
    zero, found = flint().fmpq(0), []
    for terms, offset in rows:
        total = [zero] * (len(functions[0]) - 1) + [offset]
        for k, coefficient in terms:
            total = [a + coefficient * b for a, b in zip(total, functions[k])]
        found.append(tuple(total))
    return found


def _minus(first, second):
    return tuple(a - b for a, b in zip(first, second))


def _floats(vectors):
    return np.array([[rational.nearest(entry) for entry in vector] for vector in vectors], float)
