"""Trajectories that are attained without rounding: float states are tried, and moved inward where necessary.

Solutions of linear programs may lie outside their sets by the solver's tolerance, and far outside at the tip of a very
thin set. A value counts as attained here only if its trajectory satisfies every constraint in rational arithmetic.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from time import perf_counter
from typing import NamedTuple

import numpy as np

from ..arithmetic import rational
from ..arithmetic.balls import flint
from ..errors import SolverError
from ..sets.polytope import Polytope
from ..solvers.linear_program import LinearProgram
from ..systems.loop import ClosedLoop
from ..tolerances import BESIDE, CLOSE_VALUE, FLAT_SET
from ..typing import Array, Rational
from .base import Witness
from .bounds import support_vectors
from .steps import Row, composed, composed_rows, dynamics, identity, network_piece, values
from .steps import inputs as exact_inputs

INWARD = (1e-12, 1e-10, 1e-8, 1e-6, 1e-4)  # shares of the way to a centre by which a state is moved, tried in turn
CORNERS = 12  # points of the set where trajectories start; other pieces are searched towards them
CACHED = 64  # disturbance sets whose results are cached

Point = tuple[Rational, ...]


class Path(NamedTuple):
    """A trajectory in floats: x(0) (n,), the mode of every step, and d (n,) of every step, the last one optional."""

    start: Array
    modes: list[int]
    disturbances: list[Array]


@dataclass(frozen=True, eq=False)
class Attained:
    """A trajectory of the loop in rational arithmetic.

    Attributes
    ----------
    value : float
        v x(k) (or v u(0)), rounded downward.
    states, inputs : list of tuples of fmpq
    modes : list of int
    disturbances : list of tuples of fmpq
    """

    value: float
    states: list[Point]
    inputs: list[Point]
    modes: list[int]
    disturbances: list[Point]

    @property
    def start(self) -> Array:
        """x(0), rounded to floats: (n,)."""
        return _floats(self.states[:1])[0]

    def witness(self) -> Witness:
        """The trajectory, rounded to floats, as a Witness."""
        n, m = len(self.states[0]), len(self.inputs[0])
        return Witness(
            _floats(self.states).reshape(-1, n),
            _floats(self.inputs).reshape(-1, m)[: len(self.modes)],
            np.array(self.modes, int),
            _floats(self.disturbances).reshape(-1, n),
        )


def attained(
    loop: ClosedLoop,
    F: Polytope,
    v: Array,
    paths: Sequence[tuple[float, Path]],
    inputs: bool = False,
    end: float = np.inf,
) -> Attained | None:
    """The best Attained that is found near float trajectories, or None.

    Parameters
    ----------
    loop : ClosedLoop
    F : Polytope
        In X; where trajectories start.
    v : array (n,), or (m,) for inputs
    paths : list of (value, Path)
        The best first, with their values in floats. The last disturbance is chosen anew.
    inputs : bool
        The value is v u(0) instead of v x(k).
    end : float
        The value of `perf_counter` after which each path is tried only once.
    """
    best, direction = None, rational.binary(v)
    for starts in (_itself, _towards_the_middle, _inside_of_its_piece, _best_of_pieces):
        for claimed, path in paths[: 1 if starts is _best_of_pieces else None]:
            enough = claimed - CLOSE_VALUE * (1 + abs(claimed))
            if best is not None and best.value >= enough:
                break
            for start in starts(loop, F, direction, path):
                found = _replay(loop, F, direction, start, path, inputs)
                if found is not None and (best is None or found.value > best.value):
                    best = found
                if (best is not None and best.value >= enough) or perf_counter() > end:
                    break
    return best


# -- states near x as rationals (None where there is none), from the cheapest to the most thorough -------------------


def _itself(loop: ClosedLoop, F: Polytope, v: Point, path: Path) -> Iterator[Point | None]:
    """x as it is."""
    yield rational.binary(path.start)


def _towards_the_middle(loop: ClosedLoop, F: Polytope, v: Point, path: Path) -> Iterator[Point | None]:
    """x moved towards the centre of F."""
    yield from _moved(path.start, _centre(F))


def _inside_of_its_piece(loop: ClosedLoop, F: Polytope, v: Point, path: Path) -> Iterator[Point | None]:
    """x moved towards the centre of its piece of the loop, then the points of F nearest to such states."""
    x, centre = path.start, _centre(_part(loop, F, path)) if path.modes else None
    yield from _moved(x, centre)
    for towards in (centre, _centre(F)):
        if towards is None:
            continue
        for share in (0.0, *INWARD):
            yield _nearest(F, x + share * (towards - x))


def _best_of_pieces(loop: ClosedLoop, F: Polytope, v: Point, path: Path) -> Iterator[Point | None]:
    """The best states of whole affine pieces: the piece around x and, as channels may tie there, its neighbours."""
    x, seen = path.start, set[tuple[int, ...]]()
    for near in [x, *(x + BESIDE * (corner - x) for corner in _corners(F))] if path.modes else ():
        yield _best_of_piece(loop, F, v, path._replace(start=near), seen)


def _moved(x: Array, centre: Array | None) -> Iterator[Point | None]:
    """x moved towards a point, if there is one, by increasing shares."""
    if centre is None:
        return
    for share in INWARD:
        yield rational.binary(x + share * (centre - x))


@lru_cache(maxsize=4 * CACHED)
def _corners(P: Polytope) -> Array:
    """Support vectors of P along `CORNERS` random directions."""
    return support_vectors(P, np.random.default_rng(0).normal(size=(CORNERS, P.dimension)))


def _part(loop: ClosedLoop, F: Polytope, path: Path) -> Polytope:
    """The part of F with the same largest channels and the same modes as along a trajectory from x.

    All values are affine functions of x(0) there: E x(0) + e.
    """
    x, n = path.start, loop.system.state_size
    rows, limits = [F.H], [F.h]
    E, e = np.eye(n), np.zeros(n)
    for j, i in enumerate(path.modes):
        mode = loop.system.modes[i]
        K, g = E, e
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
        if j + 1 < len(path.modes):
            d, X = path.disturbances[j], loop.system.state_set
            E, e = mode.A @ E + mode.B @ U, mode.A @ e + mode.B @ c + mode.p + d
            rows.append(X.H @ E)
            limits.append(X.h - X.H @ e)
    H, h = np.vstack(rows), np.concatenate(limits)
    finite = np.isfinite(H).all(axis=1) & np.isfinite(h) & H.any(axis=1)
    return Polytope(H[finite], h[finite])


@lru_cache(maxsize=4 * CACHED)
def _centre(P: Polytope) -> Array | None:
    """The centre of a large ball in P; for a flat P a point strictly inside all rows that allow it; None if empty."""
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
        if not ball or best.value > FLAT_SET:
            return best.point[:n]
    return None


def _nearest(P: Polytope, x: Array) -> Point | None:
    """The point of P nearest to x in the 1-norm, or None if P is empty: a rational linear program."""
    zero, one = flint().fmpq(0), flint().fmpq(1)
    n = len(x)
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
def _support_vector(D: Polytope, v: Point) -> Point | None:
    """A point of D that attains its support function along the rational vector v, or None if D is empty."""
    return D.exact_maximum(v).point


# -- trajectories from these states ------------------------------------------------------------------------------------


def _replay(
    loop: ClosedLoop, F: Polytope, v: Point, x: Point | None, path: Path, inputs: bool = False
) -> Attained | None:
    """The Attained from x under the modes and disturbances of a path; None if x is not in F or a step is impossible.

    The last step takes the mode and the disturbance with the largest value.
    """
    if x is None or not _satisfies(x, F):
        return None
    states, used = [tuple(x)], list[Point]()
    acted, moved = list[int](), list[Point]()
    for j in range(max(len(path.modes), 1)):
        xu = (*states[-1], *exact_inputs(loop.network, states[-1]))
        used.append(xu[len(x) :])
        if inputs:
            return Attained(rational.below(rational.dot(v, used[0])), states, used, [], [])
        if j and not _satisfies(states[-1], loop.system.state_set):
            return None
        last = j + 1 == len(path.modes)
        ends = []
        for i in range(len(loop.system.modes)) if last else [path.modes[j]]:
            mode = loop.system.modes[i]
            if not _satisfies(xu, mode.region):
                continue
            d = _support_vector(mode.disturbance, v) if last else _inside(mode.disturbance, path.disturbances[j])
            if d is not None:
                after = tuple(a + b for a, b in zip(values(dynamics(mode), xu), d))
                ends.append((rational.dot(v, after), after, i, d))
        if not ends:
            return None
        value, after, i, d = max(ends, key=lambda end: end[0])
        states.append(after)
        acted.append(i)
        moved.append(d)
    return Attained(rational.below(value), states, used, acted, moved)


def _best_of_piece(loop: ClosedLoop, F: Polytope, v: Point, path: Path, seen: set[tuple[int, ...]]) -> Point | None:
    """The state of F with the largest v x(k) among those on the affine piece of a path: a rational linear program.

    The piece is given by the largest channels along the path. `seen` holds the pieces that were tried already; for
    these, and where there is no such state, the result is None.
    """
    x, n = rational.binary(path.start), len(path.start)
    E = identity(n)  # x(j) = E (x(0), 1)
    rows: list[Row] = [*zip(*F.exact)]
    winners: list[int] = []
    for j, i in enumerate(path.modes):
        mode, piece = loop.system.modes[i], network_piece(loop.network, x, E)
        xu = [*E, *piece.output]
        rows += piece.rows
        winners += piece.winners
        rows += composed_rows([*zip(*mode.region.exact)], xu)
        E = composed(dynamics(mode), xu)
        if j + 1 < len(path.modes):
            d = _inside(mode.disturbance, path.disturbances[j])
            if d is None:
                return None
            E = [(*form[:n], form[n] + shift) for form, shift in zip(E, d)]
            rows += composed_rows([*zip(*loop.system.state_set.exact)], E)
    if tuple(winners) in seen:
        return None
    seen.add(tuple(winners))
    H, h = zip(*rows)
    objective = [rational.dot(v, column) for column in zip(*E)]
    return rational.maximize(H, h, objective[:n]).point


def _inside(D: Polytope, d: Array) -> Point | None:
    """A disturbance near d that lies in D, or None."""
    centre = _centre(D)
    for share in (0.0, *INWARD) if centre is not None else (0.0,):
        moved = rational.binary(d if centre is None else d + share * (centre - d))
        if _satisfies(moved, D):
            return moved
    return _nearest(D, np.asarray(d, float))


def _satisfies(x: Point, P: Polytope) -> bool:
    """Whether x lies in P, without rounding."""
    return all(rational.dot(a, x) <= b for a, b in zip(*P.exact))


def _floats(vectors: Sequence[Point]) -> Array:
    """Points as an array, each number the nearest float."""
    return np.array([[rational.nearest(entry) for entry in vector] for vector in vectors], float)
