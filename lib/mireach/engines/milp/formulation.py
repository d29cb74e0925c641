"""Lemmas 1 and 2 of [Teichrib2025] as a mixed-integer linear program, ready for any objective.

The model grows from the state to the output of each layer, to the modes, to the next state. The program so far bounds
what is added next. So every row has a big-M of its own, a neuron of which one channel always wins has no variable, and
a channel that never wins or a mode that never acts has no binary. The paper's own formulation, with all binaries and
one big-M, is here as well.

Every trajectory of the loop in real arithmetic satisfies the rows: coefficients that are composed of several layers are
rounded, and a bound of that rounding moves the limits of the rows outward.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...sets.polytope import Polytope
from ...solvers.linear_program import LinearProgram
from ...systems.loop import ClosedLoop
from ...systems.network import MaxoutNetwork
from ...systems.pwa import Mode, PWASystem
from ...tolerances import ROUNDOFF
from ...typing import Array, BoolArray, IntArray
from ..bounds import METHODS, SAFETY, lower_bound, upper_bound
from ..boxes import Boxes, LayerBounds, StepBounds, Values, bound_loop, disturbance_box, root_box, widened


@dataclass(frozen=True, eq=False)
class Model:
    """The MILP of eq. (17), MILPReachableSets, ready for any objective v x(k).

    Attributes
    ----------
    program : LinearProgram
        All constraints; its `binaries` are the delta and gamma that are not fixed.
    states : list of k + 1 arrays (n,)
        Columns of x(0), ..., x(k).
    modes : list of k arrays (s,)
        Columns of gamma(0), ..., gamma(k - 1).
    disturbances : list of k arrays (n,)
        Columns of d(0), ..., d(k - 1).
    inputs : list of k arrays (m,)
        Columns of u(0), ..., u(k - 1).
    """

    program: LinearProgram
    states: list[IntArray]
    modes: list[IntArray]
    disturbances: list[IntArray]
    inputs: list[IntArray]

    @property
    def binaries(self) -> list[int]:
        """Columns of the binaries."""
        return self.program.binaries

    def add_step(self, x: IntArray, gamma: IntArray, d: IntArray, u: IntArray) -> None:
        """Append the columns of x(j + 1), gamma(j), d(j) and u(j)."""
        self.states.append(x)
        self.modes.append(gamma)
        self.disturbances.append(d)
        self.inputs.append(u)


@dataclass(frozen=True, eq=False)
class Affine:
    """r functions of the columns of a linear program, within `error` of matrix c[:N] + constant.

    Attributes
    ----------
    matrix : array (r, N)
        N is at most the number of columns.
    constant : array (r,)
    error : array (r,)
        Upper bounds of the rounding error of both, on all points between the limits of the columns.
    """

    matrix: Array
    constant: Array
    error: Array

    @staticmethod
    def columns(chosen: Sequence[int] | IntArray) -> "Affine":
        """The values of the given columns."""
        indices = np.asarray(chosen)
        return Affine(np.eye(indices.max(initial=-1) + 1)[indices], np.zeros(len(indices)), np.zeros(len(indices)))

    @staticmethod
    def join(parts: Sequence["Affine"]) -> "Affine":
        """All functions of all parts."""
        constant, error = (np.concatenate([getattr(part, name) for part in parts]) for name in ("constant", "error"))
        row = 0
        matrix = np.zeros((len(constant), max(part.matrix.shape[1] for part in parts)))
        for part in parts:
            rows, columns = part.matrix.shape
            matrix[row : row + rows, :columns] = part.matrix
            row += rows
        return Affine(matrix, constant, error)

    def take(self, rows: slice | Sequence[int]) -> "Affine":
        """The functions with the given indices."""
        return Affine(self.matrix[rows], self.constant[rows], self.error[rows])

    def map(self, lp: LinearProgram, weight: Array, bias: Array) -> "Affine":
        """weight (...) + bias: the error grows by |weight| error and by the rounding of the products and sums."""
        limit = np.maximum(np.abs(lp.lower), np.abs(lp.upper))[: self.matrix.shape[1]]
        terms = np.abs(weight) @ (np.abs(self.matrix) @ limit + np.abs(self.constant) + self.error) + np.abs(bias)
        count = sum(self.matrix.shape) + 8
        error = (np.abs(weight) @ self.error) * (1 + ROUNDOFF * count)
        if not _copies(self.matrix) or self.constant.any():
            error = error + ROUNDOFF * count * terms
        return Affine(weight @ self.matrix, weight @ self.constant + bias, error)

    def minus(self, lp: LinearProgram, i: int, j: int) -> "Affine":
        """Function i minus function j, as an Affine of one row."""
        weight = np.zeros((1, len(self.constant)))
        weight[0, i], weight[0, j] = 1, -1
        return self.map(lp, weight, np.zeros(1))

    @property
    def used(self) -> IntArray:
        """The first N columns, which the coefficients belong to."""
        return np.arange(self.matrix.shape[1])

    @property
    def rows(self) -> Iterator[tuple[Array, float, float]]:
        """Coefficients, constant and error of each function."""
        return zip(self.matrix, self.constant, self.error)

    def most(self, lp: LinearProgram, method: str) -> Array:
        """Upper bounds (r,), as `upper_bound`."""
        return np.array([upper_bound(lp, self.used, row, c, method, error) for row, c, error in self.rows])

    def least(self, lp: LinearProgram, method: str) -> Array:
        """Lower bounds (r,), as `lower_bound`."""
        return np.array([lower_bound(lp, self.used, row, c, method, error) for row, c, error in self.rows])


def _copies(matrix: Array) -> bool:
    """Whether each row has a single 1 and zeros, so that products with it are not rounded."""
    binary = ((matrix == 0) | (matrix == 1)).all()
    return bool(binary and (matrix.sum(axis=1) == 1).all() and (matrix.sum(axis=0) <= 1).all())


def above(*terms: float) -> float:
    """The sum of a few numbers, rounded upward."""
    return sum(terms) + ROUNDOFF * (len(terms) + 1) * sum(map(abs, terms))


def below(*terms: float) -> float:
    """The sum of a few numbers, rounded downward."""
    return sum(terms) - ROUNDOFF * (len(terms) + 1) * sum(map(abs, terms))


def build(
    loop: ClosedLoop,
    F: Polytope,
    steps: int,
    bounds: str = "lp",
    formulation: str = "whole",
    box: Boxes | None = None,
    step_bounds: Sequence[StepBounds] | None = None,
    end: float = np.inf,
) -> Model | None:
    """The model of eq. (15), MIClosedLoop, over x(0) in F & X for k = `steps`.

    Parameters
    ----------
    loop : ClosedLoop
    F : Polytope
    steps : int
    bounds : "interval", "lp" or "tight"
        As in `bounds.upper_bound`; the paper's formulation takes intervals.
    formulation : "whole" or "paper"
    box : Boxes or None
        One box of (x(0), d(0), ..., d(k - 2)) to which the model is restricted; None is all of F & X and D.
    step_bounds : list of StepBounds or None
        Bounds of every step on that box; None computes them, except for "interval".
    end : float
        The `perf_counter` after which bounds are taken from intervals.

    Returns
    -------
    Model, or None
        None if it is proven that no mode can act, or, without a box, if F & X is empty.

    Raises
    ------
    ValueError
        If `bounds` or `formulation` has another name.
    """
    if bounds not in METHODS:
        raise ValueError(f"bounds must be one of {METHODS}; got {bounds!r}")
    if formulation not in ("whole", "paper"):
        raise ValueError(f'formulation must be "whole" or "paper" for a single model; got {formulation!r}')
    if box is None:
        start = F & loop.system.state_set
        if start.is_empty:
            return None
        box = root_box(loop, start, steps)
    if formulation == "paper":
        return _paper(loop, F, box, steps)
    if step_bounds is None and bounds != "interval":
        step_bounds = bound_loop(loop, box, steps).at(0)
    n, X = loop.system.state_size, loop.system.state_set
    lp = LinearProgram()
    lp.end = end
    x = lp.add_columns(box.lower[0, :n], box.upper[0, :n])
    lp.add_rows(x, F.H, upper=F.h)
    model = Model(lp, [x], [], [], [])
    for j in range(steps):
        lp.add_rows(x, X.H, upper=X.h)
        step = None if step_bounds is None else step_bounds[j]
        u = add_network(lp, loop.network, x, bounds, step)
        ends = slice(n * (j + 1), n * (j + 2))
        d_box = (box.lower[0, ends], box.upper[0, ends]) if j + 1 < steps else None
        met = None if step is None else step.met
        added = add_system(lp, loop.system, np.concatenate([x, u]), bounds, met, d_box)
        if added is None:
            return None
        x, gamma, d = added
        model.add_step(x, gamma, d, u)
    return model


def build_inputs(
    loop: ClosedLoop, F: Polytope, bounds: str, box: Boxes, step_bounds: Sequence[StepBounds], end: float = np.inf
) -> Model:
    """The model of eq. (9), MI_Constraints_NN, alone, u(0) = Phi(x(0)) over x(0) in F & X; arguments as in `build`.

    Returns
    -------
    Model
        Its last "state" is u(0).
    """
    lp, X = LinearProgram(), loop.system.state_set
    lp.end = end
    x = lp.add_columns(box.lower[0], box.upper[0])
    lp.add_rows(x, F.H, upper=F.h)
    lp.add_rows(x, X.H, upper=X.h)
    u = add_network(lp, loop.network, x, bounds, step_bounds[0])
    return Model(lp, [x, u], [], [], [u])


def add_network(
    lp: LinearProgram, network: MaxoutNetwork, x: IntArray, bounds: str = "lp", step: StepBounds | None = None
) -> IntArray:
    """Eq. (9), MI_Constraints_NN: columns of u = Phi(x); the binaries delta are added to `lp.binaries`.

    For neuron l of layer i with its channels z_j = W_j q + b_j, j in A_l:
    z_j <= q_l <= z_j + M_j (1 - delta_j), sum of delta_j = 1, with M_j >= max over x of (max_i z_i - z_j).
    Where one channel always wins, q_l is that affine function and has no column.
    """
    q = Affine.columns(x)
    for i, layer in enumerate(network.hidden):
        neurons, channels = [], q.map(lp, layer.weight, layer.bias)
        for neuron in range(layer.width):
            rows = slice(neuron * layer.pool, (neuron + 1) * layer.pool)
            z = channels.take(rows)
            neurons.append(_add_neuron(lp, z, bounds, None if step is None else step.layers[i].neuron(neuron)))
        q = Affine.join(neurons)
    return _add_values(lp, q.map(lp, network.weight, network.bias), bounds, None if step is None else step.inputs)


def add_system(
    lp: LinearProgram,
    system: PWASystem,
    xu: IntArray,
    bounds: str = "lp",
    met: BoolArray | None = None,
    d_box: tuple[Array, Array] | None = None,
) -> tuple[IntArray, IntArray, IntArray] | None:
    """Eqs. (10), gammaForR, (12b), MI_PWA_xTilde, (12c), MI_PWA_sumXTilde, and (14), MISysWithDis, in a program.

    Parameters
    ----------
    lp : LinearProgram
        It gets new columns and rows.
    system : PWASystem
    xu : array (n + m,) of int
        Columns of x and u.
    bounds : str
        As in `upper_bound`.
    met : array (s,) of bool, or None
        Modes that may act; None is all of them.
    d_box : pair of arrays (n,), or None
        Limits of d.

    Returns
    -------
    tuple of arrays of int, or None
        Columns of x+ (n,), gamma (s,) and d (n,). None if no mode can act.
    """
    modes = system.modes
    gamma = lp.add_columns(np.zeros(len(modes)), np.ones(len(modes)) if met is None else np.asarray(met, float))
    lp.add_row(gamma, np.ones(len(modes)), 1, 1)
    for mode, on in zip(modes, gamma):
        if lp.upper[on] != 0:
            _add_region(lp, mode, on, xu, bounds, prune=met is None)
    images = {i: _image_bounds(lp, modes[i], gamma[i], xu, bounds) for i in np.flatnonzero(lp.upper[gamma] > 0)}
    acting = {i: image for i, image in images.items() if image is not None}
    if not acting:
        return None
    if len(acting) == 1:
        lp.set_bounds(gamma[list(acting)], 1, 1)
    else:
        lp.binaries.extend(gamma[list(acting)])
        lp.first.extend(gamma[list(acting)])
    chosen = [modes[i] for i in acting]
    d_low, d_high = widened(*disturbance_box(chosen))
    if d_box is not None:
        d_low, d_high = np.maximum(d_low, d_box[0]), np.minimum(d_high, d_box[1])
        if (d_low > d_high).any():
            return None
    d = lp.add_columns(d_low, d_high)
    _add_disturbance(lp, chosen, gamma[list(acting)], d)
    if len(acting) == 1:
        after = _add_one_image(lp, chosen[0], next(iter(acting.values())), xu, d)
    else:
        parts = [_add_image(lp, modes[i], gamma[i], image, xu, d) for i, image in acting.items()]
        after = lp.add_columns(
            np.min([lp.lower[part] for part in parts], axis=0), np.max([lp.upper[part] for part in parts], axis=0)
        )
        _add_sum(lp, after, parts)
    return after, gamma, d


# -- parts --------------------------------------------------------------------------------------------


def _add_neuron(lp: LinearProgram, z: Affine, bounds: str, earlier: LayerBounds | None) -> Affine:
    """One maxout neuron with channels z: its value as Affine, one column if more than one channel may win."""
    alive, ahead = _compare(lp, z, bounds, earlier)
    z = z.take(alive)
    if len(alive) == 1:
        return z
    low, high = _range(lp, z, bounds, earlier)
    column = lp.add_columns(low.max(), high.max())
    deltas = lp.add_columns(np.zeros(len(alive)), np.ones(len(alive)))
    for j, (delta, (row, offset, error)) in enumerate(zip(deltas, z.rows)):
        M = max(ahead[i, alive[j]] for i in alive if i != alive[j])
        lp.add_row([*column, *z.used], [1, *-row], lower=below(offset, -error))
        lp.add_row([*column, *z.used, delta], [1, *-row, M], upper=above(offset, error, M))
    lp.add_row(deltas, np.ones(len(alive)), 1, 1)
    lp.binaries.extend(deltas)
    return Affine.columns(column)


def _compare(lp: LinearProgram, z: Affine, bounds: str, earlier: LayerBounds | None) -> tuple[list[int], Array]:
    """Channels of z that may win, and upper bounds ahead[i, j] >= z_i - z_j for those i that may."""
    p = len(z.constant)
    if earlier is None:
        alive, ahead = list(range(p)), np.full((p, p), np.inf)
    else:
        alive, ahead = np.flatnonzero(earlier.alive).tolist(), earlier.ahead + SAFETY * (1 + np.abs(earlier.ahead))
    if len(alive) == 1 or (earlier is not None and bounds == "interval"):
        return alive, ahead
    for i in list(alive):
        for j in alive:
            if i != j:
                ahead[i, j] = min(ahead[i, j], z.minus(lp, i, j).most(lp, bounds)[0])
                if ahead[i, j] <= 0:  # z_i never exceeds z_j
                    alive.remove(i)
                    break
    return alive, ahead


def _range(lp: LinearProgram, values: Affine, bounds: str, earlier: LayerBounds | Values | None) -> tuple[Array, Array]:
    """Lower and upper bounds (r,) of affine functions, no wider than earlier bounds of them or of their maximum."""
    if earlier is None:
        return values.least(lp, bounds), values.most(lp, bounds)
    low, high = widened(earlier.least, earlier.most)
    if bounds == "interval":
        return np.atleast_1d(low), np.atleast_1d(high)
    return np.maximum(low, values.least(lp, bounds)), np.minimum(high, values.most(lp, bounds))


def _add_values(lp: LinearProgram, values: Affine, bounds: str, earlier: Values | None) -> IntArray:
    """Columns that equal the affine functions `values`."""
    columns = lp.add_columns(*_range(lp, values, bounds, earlier))
    for column, (row, offset, error) in zip(columns, values.rows):
        limits = (below(offset, -error), above(offset, error)) if error else (offset, offset)
        lp.add_row([column, *values.used], [1, *-row], *limits)
    return columns


def _add_region(lp: LinearProgram, mode: Mode, on: int, xu: IntArray, bounds: str, prune: bool) -> None:
    """Eq. (10), gammaForR: H (x, u) <= h + M (1 - gamma). With `prune`, gamma is 0 if a row is never satisfied."""
    for row, offset in zip(mode.region.H, mode.region.h):
        if prune and lower_bound(lp, xu, row, -offset, bounds) > 0:
            lp.set_bounds(on, 0, 0)
            break
        M = upper_bound(lp, xu, row, -offset, bounds)
        if M > 0:
            lp.add_row([*xu, on], [*row, M], upper=above(offset, M))


class _Image(NamedTuple):
    """Bounds (n,) of A x + B u + p where the mode acts, and wherever the constraints so far hold."""

    low: Array
    high: Array
    low_all: Array
    high_all: Array


def _image_bounds(lp: LinearProgram, mode: Mode, on: int, xu: IntArray, bounds: str) -> _Image | None:
    """The bounds of the image of a mode. None, and gamma = 0, where the relaxation proves that it cannot act."""
    image = Affine.columns(xu).map(lp, np.hstack([mode.A, mode.B]), mode.p)
    low_all, high_all = image.least(lp, bounds), image.most(lp, bounds)
    if bounds == "interval":
        return _Image(low_all, high_all, low_all, high_all)
    lp.set_bounds(on, 1, 1)
    low, high = image.least(lp, bounds), image.most(lp, bounds)
    reachable = np.isfinite(low).all() and np.isfinite(high).all()
    lp.set_bounds(on, 0, 1 if reachable else 0)
    return _Image(low, high, low_all, high_all) if reachable else None


def _add_one_image(lp: LinearProgram, mode: Mode, image: _Image, xu: IntArray, d: IntArray) -> IntArray:
    """Columns of x+ = A x + B u + p + d, of the only mode that can act."""
    after = lp.add_columns(*widened(image.low + lp.lower[d], image.high + lp.upper[d]))
    for c in range(len(after)):
        lp.add_row([after[c], d[c], *xu], [1, -1, *-mode.A[c], *-mode.B[c]], mode.p[c], mode.p[c])
    return after


def _add_image(lp: LinearProgram, mode: Mode, on: int, image: _Image, xu: IntArray, d: IntArray) -> IntArray:
    """Columns of x-tilde of one of several modes: A x + B u + p + d where it acts, else 0."""
    d_low, d_high = lp.lower[d], lp.upper[d]
    low, high = widened(image.low + d_low, image.high + d_high)
    part = lp.add_columns(np.minimum(low, 0), np.maximum(high, 0))
    for c in range(len(part)):
        lp.add_row([part[c], on], [1, -high[c]], upper=0)  # eq. (12b), MI_PWA_xTilde
        lp.add_row([part[c], on], [1, -low[c]], lower=0)
        row = [*mode.A[c], *mode.B[c], 1, -1]  # eq. (14a), MI_PWA_ABpd
        M_high, M_low = above(image.high_all[c], d_high[c]), below(image.low_all[c], d_low[c])
        lp.add_row([*xu, d[c], part[c], on], [*row, M_high], upper=above(M_high, -mode.p[c]))
        lp.add_row([*xu, d[c], part[c], on], [*row, M_low], lower=below(M_low, -mode.p[c]))
    return part


def _add_sum(lp: LinearProgram, after: IntArray, parts: Sequence[IntArray]) -> None:
    """Eq. (12c), MI_PWA_sumXTilde: x+ is the sum of the x-tilde of all modes."""
    for c in range(len(after)):
        lp.add_row([after[c], *(part[c] for part in parts)], [1, *[-1] * len(parts)], 0, 0)


def _add_disturbance(lp: LinearProgram, modes: Sequence[Mode], gamma: IntArray, d: IntArray) -> None:
    """Eq. (14b), MI_PWA_Hd: H_D d <= h_D + M (1 - gamma), without big-M where all modes have the same set."""
    if len({mode.disturbance for mode in modes}) == 1:
        lp.add_rows(d, modes[0].disturbance.H, upper=modes[0].disturbance.h)
        return
    for mode, on in zip(modes, gamma):
        for row, offset in zip(mode.disturbance.H, mode.disturbance.h):
            M = upper_bound(lp, d, row, -offset, "interval")
            if M > 0:
                lp.add_row([*d, on], [*row, M], upper=above(offset, M))


def _paper(loop: ClosedLoop, F: Polytope, box: Boxes, steps: int) -> Model:
    """The paper's plain formulation over x(0) in F: all binaries, one big-M per layer and one for the plant."""
    X, n = loop.system.state_set, loop.system.state_size
    lp = LinearProgram()
    x = lp.add_columns(box.lower[0, :n], box.upper[0, :n])
    lp.add_rows(x, F.H, upper=F.h)
    model = Model(lp, [x], [], [], [])
    for _ in range(steps):
        lp.add_rows(x, X.H, upper=X.h)
        u = _add_paper_network(lp, loop.network, x)
        x, gamma, d = _add_paper_system(lp, loop.system, x, u)
        model.add_step(x, gamma, d, u)
    return model


def _add_paper_system(
    lp: LinearProgram, system: PWASystem, x: IntArray, u: IntArray
) -> tuple[IntArray, IntArray, IntArray]:
    """Eqs. (10), gammaForR, (12b), (12c) and (14) with one M for all rows: columns of x+, gamma and d."""
    modes, n = system.modes, system.state_size
    gamma = lp.add_columns(np.zeros(len(modes)), np.ones(len(modes)))
    d = lp.add_columns(*widened(*disturbance_box(modes)))
    lp.add_row(gamma, np.ones(len(modes)), 1, 1)
    lp.binaries.extend(gamma)
    lp.first.extend(gamma)
    xu, xud = Affine.columns([*x, *u]), Affine.columns([*x, *u, *d])
    inside = [xu.map(lp, mode.region.H, -mode.region.h) for mode in modes]
    images = [xud.map(lp, np.hstack([mode.A, mode.B, np.eye(n)]), mode.p) for mode in modes]
    within = [Affine.columns(d).map(lp, mode.disturbance.H, -mode.disturbance.h) for mode in modes]
    every = [*images, *(image.map(lp, -np.eye(n), np.zeros(n)) for image in images), *inside, *within]
    M = max(part.most(lp, "interval").max(initial=0) for part in every)
    parts = [lp.add_columns(np.full(n, -M), np.full(n, M)) for _ in modes]
    for on, part, *rows, image in zip(gamma, parts, inside, within, images):
        for row, offset, error in Affine.join(rows).rows:  # eqs. (10), gammaForR, and (14b), MI_PWA_Hd
            lp.add_row([*range(len(row)), on], [*row, M], upper=above(M, -offset, error))
        for column, (row, offset, error) in zip(part, image.rows):
            lp.add_row([column, on], [1, -M], upper=0)  # eq. (12b), MI_PWA_xTilde
            lp.add_row([column, on], [1, M], lower=0)
            columns = [*range(len(row)), column, on]
            lp.add_row(columns, [*row, -1, M], upper=above(M, -offset, error))  # eq. (14a), MI_PWA_ABpd
            lp.add_row(columns, [*row, -1, -M], lower=below(-M, -offset, -error))
    after = lp.add_columns(np.full(n, -M), np.full(n, M))
    _add_sum(lp, after, parts)
    return after, gamma, d


def _add_paper_network(lp: LinearProgram, network: MaxoutNetwork, x: IntArray) -> IntArray:
    """Eq. (9), MI_Constraints_NN, as it is printed: columns of u."""
    q = Affine.columns(x)
    for layer in network.hidden:
        z = q.map(lp, layer.weight, layer.bias)
        low, high = (
            ends.reshape(layer.width, layer.pool) for ends in (z.least(lp, "interval"), z.most(lp, "interval"))
        )
        M = above(*max(zip(high.max(axis=1), -low.min(axis=1)), key=sum))  # the paper's b-bar of the layer
        columns = lp.add_columns(low.max(axis=1), high.max(axis=1))
        deltas = lp.add_columns(np.zeros(len(z.constant)), np.ones(len(z.constant)))
        for j, (delta, (row, offset, error)) in enumerate(zip(deltas, z.rows)):
            column = columns[j // layer.pool]
            lp.add_row([column, *z.used], [1, *-row], lower=below(offset, -error))
            lp.add_row([column, *z.used, delta], [1, *-row, M], upper=above(offset, error, M))
        for group in deltas.reshape(layer.width, layer.pool):
            lp.add_row(group, np.ones(layer.pool), 1, 1)
        lp.binaries.extend(deltas)
        q = Affine.columns(columns)
    return _add_values(lp, q.map(lp, network.weight, network.bias), "interval", None)
