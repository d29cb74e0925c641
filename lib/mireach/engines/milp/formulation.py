"""Lemmas 1 and 2 of [Teichrib2025] as a mixed-integer linear program, ready for any objective.

The model grows from the state to the output of each layer, to the modes, to the next state. What has been built so
far is a program that bounds what comes next: hence a big-M for every single row, no variable for a neuron of which
one channel always wins, no binary for a channel that never wins, and none for a mode that is never met. The paper's
own formulation, with all binaries and one big-M, is here as well.

Every trajectory of the loop in real arithmetic satisfies the rows: what rounding may do to coefficients that are
composed of several layers is bounded and moves the limits of the rows outward.
"""

from dataclasses import dataclass

import numpy as np

from ...solvers.linear_program import LinearProgram
from ...solvers.weak_duality import ROUNDOFF
from ..bounds import METHODS, SAFETY, lower_bound, proven_box, upper_bound
from .boxes import Boxes, bound_loop


@dataclass(frozen=True, eq=False)
class Model:
    """The MILP of eq. MILPReachableSets, ready for any objective v x(k).

    Attributes
    ----------
    program : LinearProgram
        All constraints; its `binaries` are the delta and gamma that are still open.
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
    states: list
    modes: list
    disturbances: list
    inputs: list

    @property
    def binaries(self):
        """Columns of the binaries."""
        return self.program.binaries


@dataclass(frozen=True, eq=False)
class Affine:
    """r functions of the columns of a linear program, within `error` of matrix c[:N] + constant.

    Attributes
    ----------
    matrix : array (r, N)
        N is at most the number of columns.
    constant : array (r,)
    error : array (r,)
        What rounding may have done to both, on all points between the limits of the columns.
    """

    matrix: np.ndarray
    constant: np.ndarray
    error: np.ndarray

    @staticmethod
    def columns(chosen):
        """The values of the given columns."""
        chosen = np.asarray(chosen)
        return Affine(np.eye(chosen.max(initial=-1) + 1)[chosen], np.zeros(len(chosen)), np.zeros(len(chosen)))

    @staticmethod
    def join(parts):
        """All functions of all parts."""
        constant, error = (np.concatenate([getattr(part, name) for part in parts]) for name in ("constant", "error"))
        row = 0
        matrix = np.zeros((len(constant), max(part.matrix.shape[1] for part in parts)))
        for part in parts:
            rows, columns = part.matrix.shape
            matrix[row : row + rows, :columns] = part.matrix
            row += rows
        return Affine(matrix, constant, error)

    def take(self, rows):
        """The functions with the given indices."""
        return Affine(self.matrix[rows], self.constant[rows], self.error[rows])

    def map(self, lp, weight, bias):
        """weight (...) + bias: the error grows by |weight| error and by the rounding of the products and sums."""
        limit = np.maximum(np.abs(lp.lower), np.abs(lp.upper))[: self.matrix.shape[1]]
        terms = np.abs(weight) @ (np.abs(self.matrix) @ limit + np.abs(self.constant) + self.error) + np.abs(bias)
        count = sum(self.matrix.shape) + 8
        error = (np.abs(weight) @ self.error) * (1 + ROUNDOFF * count)
        if not _copies(self.matrix) or self.constant.any():
            error = error + ROUNDOFF * count * terms
        return Affine(weight @ self.matrix, weight @ self.constant + bias, error)

    def minus(self, lp, i, j):
        """Function i minus function j, as an Affine of one row."""
        weight = np.zeros((1, len(self.constant)))
        weight[0, i], weight[0, j] = 1, -1
        return self.map(lp, weight, np.zeros(1))

    @property
    def support(self):
        """Indices of the columns that may count."""
        return np.arange(self.matrix.shape[1])

    @property
    def rows(self):
        """Coefficients, constant and error of one function after another."""
        return zip(self.matrix, self.constant, self.error)

    def most(self, lp, method):
        """Upper bounds (r,), as `upper_bound`."""
        return np.array([upper_bound(lp, self.support, *row, method, error) for *row, error in self.rows])

    def least(self, lp, method):
        """Lower bounds (r,)."""
        return np.array([lower_bound(lp, self.support, *row, method, error) for *row, error in self.rows])


def _copies(matrix):
    """Whether each row holds a single 1, so that nothing is rounded where it is multiplied."""
    return ((matrix == 0) | (matrix == 1)).all() and (matrix.sum(axis=1) == 1).all() and (matrix.sum(axis=0) <= 1).all()


def above(*terms):
    """The sum of a few numbers, rounded upward."""
    return sum(terms) + ROUNDOFF * (len(terms) + 1) * sum(map(abs, terms))


def below(*terms):
    """The sum of a few numbers, rounded downward."""
    return sum(terms) - ROUNDOFF * (len(terms) + 1) * sum(map(abs, terms))


def build(loop, F, steps, bounds="lp", formulation="whole", box=None, known=None, end=np.inf):
    """The model of eq. MIClosedLoop over x(0) in F & X for K = `steps`.

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
    known : list of StepBounds or None
        What is known of the steps on that box; None finds it out, except for "interval".
    end : float
        The `perf_counter` after which bounds are taken from intervals.

    Returns
    -------
    Model, or None
        None if it is proven that no mode can be met, or, without a box, if F & X is empty.

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
    if known is None and bounds != "interval":
        known = bound_loop(loop, box, steps).at(0)
    n, X, lp = loop.system.state_size, loop.system.state_set, LinearProgram()
    lp.end = end
    x = lp.add_columns(box.lower[0, :n], box.upper[0, :n])
    lp.add_rows(x, F.H, upper=F.h)
    model = Model(lp, [x], [], [], [])
    for j in range(steps):
        lp.add_rows(x, X.H, upper=X.h)
        step = None if known is None else known[j]
        u = add_network(lp, loop.network, x, bounds, step)
        ends = slice(n * (j + 1), n * (j + 2))
        d_box = (box.lower[0, ends], box.upper[0, ends]) if j + 1 < steps else None
        x, gamma, d = add_system(lp, loop.system, x, u, bounds, None if step is None else step.met, d_box)
        if x is None:
            return None
        for found, columns in ((model.states, x), (model.modes, gamma), (model.disturbances, d), (model.inputs, u)):
            found.append(columns)
    return model


def build_inputs(loop, F, bounds, box, known, end=np.inf):
    """The model of eq. MI_Constraints_NN alone, u(0) = Phi(x(0)) over x(0) in F & X; arguments as in `build`.

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
    u = add_network(lp, loop.network, x, bounds, known[0])
    return Model(lp, [x, u], [], [], [u])


def root_box(loop, start, steps):
    """The box of (x(0), d(0), ..., d(k - 2)) around start x D x ... x D, as Boxes."""
    x_low, x_high = proven_box(start)
    d_low, d_high = disturbance_box(loop.system.modes)
    low, high = widened(
        np.concatenate([x_low, np.tile(d_low, steps - 1)]), np.concatenate([x_high, np.tile(d_high, steps - 1)])
    )
    return Boxes(low[None], high[None])


def add_network(lp, network, x, bounds="lp", known=None):
    """Eq. MI_Constraints_NN: columns of u = Phi(x); the binaries delta are added to `lp.binaries`.

    For neuron l of layer i with its channels z_j = W_j q + b_j, j in A_l:
    z_j <= q_l <= z_j + M_j (1 - delta_j), sum of delta_j = 1, with M_j >= max over x of (max_i z_i - z_j).
    Where one channel always wins, q_l is that function of what is before it, without a column.
    """
    q = Affine.columns(x)
    for i, layer in enumerate(network.hidden):
        neurons, channels = [], q.map(lp, layer.weight, layer.bias)
        for neuron in range(layer.width):
            rows = slice(neuron * layer.pool, (neuron + 1) * layer.pool)
            z = channels.take(rows)
            neurons.append(_add_neuron(lp, z, bounds, None if known is None else known.layers[i].neuron(neuron)))
        q = Affine.join(neurons)
    return _add_values(lp, q.map(lp, network.weight, network.bias), bounds, known and known.inputs)


def add_system(lp, system, x, u, bounds="lp", met=None, d_box=None):
    """Eqs. gammaForR, MI_PWA_xTilde, MI_PWA_sumXTilde and MISysWithDis: columns of x+, gamma and d.

    `met` (s,) says which modes may be met, `d_box` limits d. x+ is None if no mode can be met.
    """
    modes, n = system.modes, system.state_size
    gamma = lp.add_columns(np.zeros(len(modes)), np.ones(len(modes)) if met is None else np.asarray(met, float))
    lp.add_row(gamma, np.ones(len(modes)), 1, 1)
    xu = np.concatenate([x, u])
    for mode, on in zip(modes, gamma):  # eq. gammaForR: H (x, u) <= h + M (1 - gamma)
        if lp.upper[on] == 0:
            continue
        for row, offset in zip(mode.region.H, mode.region.h):
            if met is None and lower_bound(lp, xu, row, -offset, bounds) > 0:
                lp.set_bounds(on, 0, 0)
                break
            M = upper_bound(lp, xu, row, -offset, bounds)
            if M > 0:
                lp.add_row([*xu, on], [*row, M], upper=above(offset, M))
    images = {i: _image_bounds(lp, modes[i], gamma[i], xu, bounds) for i in np.flatnonzero(lp.upper[gamma] > 0)}
    images = {i: bound for i, bound in images.items() if bound is not None}
    if not images:
        return None, gamma, None
    if len(images) == 1:
        lp.set_bounds(gamma[list(images)], 1, 1)
    else:
        lp.binaries.extend(gamma[list(images)])
        lp.first.extend(gamma[list(images)])
    chosen = [modes[i] for i in images]
    d_low, d_high = widened(*disturbance_box(chosen))
    if d_box is not None:
        d_low, d_high = np.maximum(d_low, d_box[0]), np.minimum(d_high, d_box[1])
        if (d_low > d_high).any():
            return None, gamma, None
    d = lp.add_columns(d_low, d_high)
    _add_disturbance(lp, chosen, gamma[list(images)], d)
    if len(images) == 1:
        (low, high, _, _), mode = next(iter(images.values())), chosen[0]
        after = lp.add_columns(*widened(low + d_low, high + d_high))
        for c in range(n):
            lp.add_row([after[c], d[c], *xu], [1, -1, *-mode.A[c], *-mode.B[c]], mode.p[c], mode.p[c])
        return after, gamma, d
    parts = []
    for i, (low, high, low_all, high_all) in images.items():
        mode, on = modes[i], gamma[i]
        low, high = widened(low + d_low, high + d_high)
        part = lp.add_columns(np.minimum(low, 0), np.maximum(high, 0))
        for c in range(n):
            lp.add_row([part[c], on], [1, -high[c]], upper=0)  # eq. MI_PWA_xTilde
            lp.add_row([part[c], on], [1, -low[c]], lower=0)
            row = [*mode.A[c], *mode.B[c], 1, -1]  # eq. MI_PWA_ABpd
            M_high, M_low = above(high_all[c], d_high[c]), below(low_all[c], d_low[c])
            lp.add_row([*xu, d[c], part[c], on], [*row, M_high], upper=above(M_high, -mode.p[c]))
            lp.add_row([*xu, d[c], part[c], on], [*row, M_low], lower=below(M_low, -mode.p[c]))
        parts.append(part)
    after = lp.add_columns(
        np.min([lp.lower[part] for part in parts], axis=0), np.max([lp.upper[part] for part in parts], axis=0)
    )
    for c in range(n):  # eq. MI_PWA_sumXTilde
        lp.add_row([after[c], *(part[c] for part in parts)], [1, *[-1] * len(parts)], 0, 0)
    return after, gamma, d


def disturbance_box(modes):
    """The smallest box around all disturbance sets: two arrays (n,)."""
    lower, upper = zip(*(proven_box(D) for D in {mode.disturbance for mode in modes}))
    return np.min(lower, axis=0), np.max(upper, axis=0)


def widened(low, high):
    """Bounds moved apart, by far more than HiGHS's tolerances; rows beside them hold the exact limits."""
    return low - SAFETY * (1 + np.abs(low)), high + SAFETY * (1 + np.abs(high))


# -- parts --------------------------------------------------------------------------------------------


def _add_neuron(lp, z, bounds, known):
    """One maxout neuron with channels z: its value as Affine, one column if more than one channel may win."""
    alive, ahead = _compare(lp, z, bounds, known)
    z = z.take(alive)
    if len(alive) == 1:
        return z
    low, high = _range(lp, z, bounds, known)
    column = lp.add_columns(low.max(), high.max())
    deltas = lp.add_columns(np.zeros(len(alive)), np.ones(len(alive)))
    for j, (delta, (row, offset, error)) in enumerate(zip(deltas, z.rows)):
        M = max(ahead[i, alive[j]] for i in alive if i != alive[j])
        lp.add_row([*column, *z.support], [1, *-row], lower=below(offset, -error))
        lp.add_row([*column, *z.support, delta], [1, *-row, M], upper=above(offset, error, M))
    lp.add_row(deltas, np.ones(len(alive)), 1, 1)
    lp.binaries.extend(deltas)
    return Affine.columns(column)


def _compare(lp, z, bounds, known):
    """Channels of z that may win, and upper bounds ahead[i, j] >= z_i - z_j for those i that may."""
    p = len(z.constant)
    if known is None:
        alive, ahead = list(range(p)), np.full((p, p), np.inf)
    else:
        alive, ahead = np.flatnonzero(known.alive).tolist(), known.ahead + SAFETY * (1 + np.abs(known.ahead))
    if len(alive) == 1 or (known is not None and bounds == "interval"):
        return alive, ahead
    for i in list(alive):
        for j in alive:
            if i != j:
                ahead[i, j] = min(ahead[i, j], z.minus(lp, i, j).most(lp, bounds)[0])
                if ahead[i, j] <= 0:  # z_i never exceeds z_j
                    alive.remove(i)
                    break
    return alive, ahead


def _range(lp, values, bounds, known):
    """Bounds (r,) of affine functions from below and from above; those of the largest of them count where known."""
    if known is None:
        return values.least(lp, bounds), values.most(lp, bounds)
    low, high = widened(known.least, known.most)
    if bounds == "interval":
        return np.atleast_1d(low), np.atleast_1d(high)
    return np.maximum(low, values.least(lp, bounds)), np.minimum(high, values.most(lp, bounds))


def _add_values(lp, values, bounds, known):
    """Columns that equal the affine functions `values`."""
    columns = lp.add_columns(*_range(lp, values, bounds, known))
    for column, (row, offset, error) in zip(columns, values.rows):
        limits = (below(offset, -error), above(offset, error)) if error else (offset, offset)
        lp.add_row([column, *values.support], [1, *-row], *limits)
    return columns


def _image_bounds(lp, mode, on, xu, bounds):
    """Bounds of A x + B u + p where the mode acts and anywhere: low, high, low_all, high_all, each (n,).

    None, and the mode switched off for good, where the relaxation proves that it is out of reach.
    """
    image = Affine.columns(xu).map(lp, np.hstack([mode.A, mode.B]), mode.p)
    low_all, high_all = image.least(lp, bounds), image.most(lp, bounds)
    if bounds == "interval":
        return low_all, high_all, low_all, high_all
    lp.set_bounds(on, 1, 1)
    low, high = image.least(lp, bounds), image.most(lp, bounds)
    reachable = np.isfinite(low).all() and np.isfinite(high).all()
    lp.set_bounds(on, 0, 1 if reachable else 0)
    return (low, high, low_all, high_all) if reachable else None


def _add_disturbance(lp, modes, gamma, d):
    """Eq. MI_PWA_Hd: H_D d <= h_D + M (1 - gamma), without big-M where all modes have the same set."""
    if len({mode.disturbance for mode in modes}) == 1:
        lp.add_rows(d, modes[0].disturbance.H, upper=modes[0].disturbance.h)
        return
    for mode, on in zip(modes, gamma):
        for row, offset in zip(mode.disturbance.H, mode.disturbance.h):
            M = upper_bound(lp, d, row, -offset, "interval")
            if M > 0:
                lp.add_row([*d, on], [*row, M], upper=above(offset, M))


def _paper(loop, F, box, steps):
    """The paper's plain formulation over x(0) in F: all binaries, one big-M a layer and one for the plant."""
    modes, X, n, lp = loop.system.modes, loop.system.state_set, loop.system.state_size, LinearProgram()
    x = lp.add_columns(box.lower[0, :n], box.upper[0, :n])
    lp.add_rows(x, F.H, upper=F.h)
    model = Model(lp, [x], [], [], [])
    d_low, d_high = widened(*disturbance_box(modes))
    for _ in range(steps):
        lp.add_rows(x, X.H, upper=X.h)
        u = _add_paper_network(lp, loop.network, x)
        gamma, d = lp.add_columns(np.zeros(len(modes)), np.ones(len(modes))), lp.add_columns(d_low, d_high)
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
            for row, offset, error in Affine.join(rows).rows:  # eqs. gammaForR and MI_PWA_Hd
                lp.add_row([*range(len(row)), on], [*row, M], upper=above(M, -offset, error))
            for column, (row, offset, error) in zip(part, image.rows):
                lp.add_row([column, on], [1, -M], upper=0)  # eq. MI_PWA_xTilde
                lp.add_row([column, on], [1, M], lower=0)
                columns = [*range(len(row)), column, on]
                lp.add_row(columns, [*row, -1, M], upper=above(M, -offset, error))  # eq. MI_PWA_ABpd
                lp.add_row(columns, [*row, -1, -M], lower=below(-M, -offset, -error))
        x = lp.add_columns(np.full(n, -M), np.full(n, M))
        for c in range(n):  # eq. MI_PWA_sumXTilde
            lp.add_row([x[c], *(part[c] for part in parts)], [1, *[-1] * len(parts)], 0, 0)
        for found, columns in ((model.states, x), (model.modes, gamma), (model.disturbances, d), (model.inputs, u)):
            found.append(columns)
    return model


def _add_paper_network(lp, network, x):
    """Eq. MI_Constraints_NN as it is printed: columns of u."""
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
            lp.add_row([column, *z.support], [1, *-row], lower=below(offset, -error))
            lp.add_row([column, *z.support, delta], [1, *-row, M], upper=above(offset, error, M))
        for group in deltas.reshape(layer.width, layer.pool):
            lp.add_row(group, np.ones(layer.pool), 1, 1)
        lp.binaries.extend(deltas)
        q = Affine.columns(columns)
    return _add_values(lp, q.map(lp, network.weight, network.bias), "interval", None)
