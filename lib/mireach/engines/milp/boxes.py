"""Affine bounds of the closed loop on many boxes at once: which channels can win, which modes are met, how far it gets.

Trajectories are functions of w = (x(0), d(0), ..., d(k - 2)); the last disturbance only adds its support function.
On a box of w every quantity lies between two affine functions of w, carried from layer to layer by sign. Where one
channel wins on the whole box, both follow it, so that the bounds become exact as boxes shrink.

All bounds hold for the loop in real arithmetic, whatever the sizes of the weights: the rounding errors of each function
are bounded by the sizes of the terms that were summed up, before they cancel, and move its constant outward.
"""

from dataclasses import dataclass

import numpy as np

from ...solvers.weak_duality import ROUNDOFF
from ..bounds import proven_box

ON_BOUNDARY = 1e-8  # a mode whose rows are violated by less than this and rounding counts as met (units of h)


@dataclass(frozen=True, eq=False)
class Boxes:
    """B boxes of R^D.

    Attributes
    ----------
    lower, upper : array (B, D)
    """

    lower: np.ndarray
    upper: np.ndarray

    def __post_init__(self):
        object.__setattr__(self, "middle", (self.lower + self.upper) / 2)
        object.__setattr__(self, "reach", (self.upper - self.lower) / 2)
        object.__setattr__(self, "size", np.maximum(np.abs(self.lower), np.abs(self.upper)))

    def __len__(self):
        return len(self.lower)

    def take(self, chosen):
        """The boxes with the given indices."""
        return Boxes(self.lower[chosen], self.upper[chosen])

    def split(self, axis, overlap):
        """Both halves of every box along its own axis (B,), which overlap by twice `overlap` times 1 + |where|."""
        rows = np.arange(len(self))
        where = self.middle[rows, axis]
        lower, upper = self.lower.copy(), self.upper.copy()
        lower[rows, axis] = where - overlap * (1 + np.abs(where))
        upper[rows, axis] = where + overlap * (1 + np.abs(where))
        return Boxes(np.concatenate([self.lower, lower]), np.concatenate([upper, self.upper]))

    def within(self, box):
        """The parts of the boxes in the first of other Boxes, and the indices of those that reach into it."""
        lower, upper = np.maximum(self.lower, box.lower[0]), np.minimum(self.upper, box.upper[0])
        chosen = np.flatnonzero((lower <= upper).all(axis=1))
        return Boxes(lower[chosen], upper[chosen]), chosen

    def meets(self, P):
        """Whether no single row of the Polytope P separates it from the box, by the first n coordinates: (B,)."""
        n = P.dimension
        nearest = self.middle[:, :n] @ P.H.T - self.reach[:, :n] @ np.abs(P.H).T
        nearest -= 2 * _rounding(n) * (self.size[:, :n] @ np.abs(P.H).T)
        return (nearest <= P.h + ON_BOUNDARY * (1 + np.abs(P.h))).all(axis=1)


@dataclass(frozen=True, eq=False)
class Values:
    """r quantities on each of B boxes: low (w, 1) <= value <= high (w, 1), and least <= value <= most.

    Attributes
    ----------
    low, high : array (r, B, D + 1)
        Coefficients of w, then the constant.
    least, most : array (r, B)
    size : array (r, B)
        The sum of sizes of the terms of `low` and of `high`, wherever w is in the box.
    """

    low: np.ndarray
    high: np.ndarray
    least: np.ndarray
    most: np.ndarray
    size: np.ndarray

    @staticmethod
    def of(boxes, low, high, least, most):
        """With `size` found out."""
        size = _terms(boxes, high)
        return Values(low, high, least, most, size if low is high else np.maximum(size, _terms(boxes, low)))

    @property
    def largest(self):
        """Largest size of each value: (r, B)."""
        return np.maximum(np.abs(self.least), np.abs(self.most))

    def join(self, other):
        """The quantities of both."""
        return Values(*(np.concatenate(pair) for pair in zip(self._parts, other._parts)))

    def at(self, box):
        """The quantities on one box."""
        return Values(*(part[:, box] for part in self._parts))

    @property
    def _parts(self):
        return self.low, self.high, self.least, self.most, self.size


@dataclass(frozen=True, eq=False)
class LayerBounds:
    """One hidden layer on B boxes.

    Attributes
    ----------
    alive : array (w, p, B) of bool
        Channels that may win; one of those that tie everywhere.
    ahead : array (w, p, p, B)
        ahead[l, i, j] >= z_i - z_j of neuron l.
    least, most : array (w, B)
        Range of each neuron.
    """

    alive: np.ndarray
    ahead: np.ndarray
    least: np.ndarray
    most: np.ndarray

    def neuron(self, index):
        """Bounds of one neuron."""
        return LayerBounds(*(part[index] for part in (self.alive, self.ahead, self.least, self.most)))

    def at(self, box):
        """Bounds on one box."""
        return LayerBounds(*(part[..., box] for part in (self.alive, self.ahead, self.least, self.most)))


@dataclass(frozen=True, eq=False)
class StepBounds:
    """One step of the loop on B boxes.

    Attributes
    ----------
    state, inputs : Values
        x(j) and u(j).
    layers : list of LayerBounds
    met : array (s, B) of bool
        Modes whose region may contain (x, u).
    """

    state: Values
    inputs: Values
    layers: list
    met: np.ndarray

    def at(self, box):
        """Bounds on one box."""
        layers = [layer.at(box) for layer in self.layers]
        return StepBounds(self.state.at(box), self.inputs.at(box), layers, self.met[:, box])


@dataclass(frozen=True, eq=False)
class LoopBounds:
    """k steps of the loop on B boxes.

    Attributes
    ----------
    boxes : Boxes
    steps : list of k StepBounds
    possible : array (B,) of bool
        False where a state of the trajectory certainly leaves X.
    doubt : array (B, D)
        How much each coordinate of w contributes to what is still open; where to split.
    """

    boxes: Boxes
    steps: list
    possible: np.ndarray
    doubt: np.ndarray

    def at(self, box):
        """The StepBounds of one box."""
        return [step.at(box) for step in self.steps]

    @property
    def binaries(self):
        """Binary variables that a MILP over each box needs: (B,)."""
        count = np.zeros(len(self.boxes), int)
        for step in self.steps:
            for choice in [layer.alive for layer in step.layers] + [step.met[None]]:
                alive = choice.sum(axis=1)
                count += np.where(alive > 1, alive, 0).sum(axis=0)
        return count

    def highest_state(self, loop, V, spread):
        """Upper bound of v x(k) for each row of V: (B, rows of V); -inf where no mode is met.

        `spread` (s, rows of V) is the support function of the modes' disturbance sets along V.
        """
        last = self.steps[-1]
        xu = last.state.join(last.inputs)
        best = np.full((len(V), len(self.boxes)), -np.inf)
        for mode, met, most in zip(loop.system.modes, last.met, spread):
            if not met.any():
                continue
            AB, count = np.hstack([mode.A, mode.B]), V.shape[1] + 2
            weight_error = _rounding(count) * (np.abs(V) @ np.abs(AB))
            bias_error = _rounding(count) * (np.abs(V) @ np.abs(mode.p) + np.abs(most))
            error = weight_error @ xu.largest + bias_error[:, None]
            reach = highest(self.boxes, V @ AB, V @ mode.p + most, xu)
            reach = reach + (error + ROUNDOFF * (np.abs(reach) + error))
            best = np.where(met, np.maximum(best, reach), best)
        return np.where(self.possible, best, -np.inf).T

    def highest_input(self, V):
        """Upper bound of v u(0) for each row of V: (B, rows of V)."""
        return highest(self.boxes, V, np.zeros(len(V)), self.steps[0].inputs).T


def bound_loop(loop, boxes, steps=1):
    """Bounds of `steps` steps of the loop on each box of w.

    Parameters
    ----------
    loop : ClosedLoop
    boxes : Boxes
        In R^(n steps).
    steps : int

    Returns
    -------
    LoopBounds
    """
    system, n = loop.system, loop.system.state_size
    doubt = np.zeros(boxes.lower.shape)
    possible = np.ones(len(boxes), bool)
    state, found = _coordinates(boxes, range(n)), []
    for j in range(steps):
        if j:
            X = system.state_set
            possible &= (-highest(boxes, -X.H, X.h, state) <= ON_BOUNDARY * (1 + np.abs(X.h[:, None]))).all(axis=0)
            low, high = proven_box(X)
            least, most = np.maximum(state.least, low[:, None]), np.minimum(state.most, high[:, None])
            state = Values(state.low, state.high, least, most, state.size)
        values, layers = state, []
        for layer in loop.network.hidden:
            values, bounds = _bound_layer(layer, boxes, values, doubt)
            layers.append(bounds)
        net = loop.network
        inputs = _affine(boxes, net.weight, net.bias, values)
        met = _met(system, boxes, state.join(inputs), doubt)
        possible &= met.any(axis=0)
        found.append(StepBounds(state, inputs, layers, met))
        if j + 1 < steps:
            state = _next_state(system, boxes, state.join(inputs), met, range(n * (j + 1), n * (j + 2)))
    return LoopBounds(boxes, found, possible, doubt)


def highest(boxes, weight, bias, values):
    """Upper bound of weight values + bias on each box: (r, B)."""
    return _highest(boxes, _upper(weight, bias, values), weight, bias, values)


# -- parts --------------------------------------------------------------------------------------------


def _rounding(terms):
    """The rounding error of a sum of so many products, relative to the sum of their sizes."""
    return ROUNDOFF * (terms + 8)


def _terms(boxes, functions):
    """The sum of sizes of the terms of affine functions (r, B, D + 1) on the boxes: (r, B)."""
    size = np.abs(functions)
    return np.einsum("rbd,bd->rb", size[..., :-1], boxes.size) + size[..., -1]


def _coordinates(boxes, columns):
    """Coordinates of w as values of themselves."""
    B, D = boxes.lower.shape
    identity, columns = np.zeros((len(columns), B, D + 1)), list(columns)
    identity[np.arange(len(columns)), :, columns] = 1
    return Values(identity, identity, boxes.lower.T[columns], boxes.upper.T[columns], boxes.size.T[columns])


def _upper(weight, bias, values):
    """Affine functions (r, B, D + 1) above weight values + bias."""
    up, down = np.maximum(weight, 0), np.minimum(weight, 0)
    found = np.tensordot(up, values.high, 1) + np.tensordot(down, values.low, 1)
    bias, terms = np.asarray(bias)[:, None], _upper_terms(weight, bias, values)
    found[:, :, -1] += bias + _rounding(2 * weight.shape[1]) * terms
    return found


def _upper_terms(weight, bias, values):
    """The sizes (r, B) that the rounding errors of `_upper` are relative to; they bound those of its terms."""
    return np.abs(weight) @ values.size + np.abs(bias)[:, None]


def _highest(boxes, upper, weight, bias, values):
    """The smaller of two bounds of weight values + bias: by the affine functions `upper`, and by ranges; (r, B)."""
    slope, constant = upper[:, :, :-1], upper[:, :, -1]
    steep = np.abs(slope)
    affine = np.einsum("rbd,bd->rb", slope, boxes.middle) + np.einsum("rbd,bd->rb", steep, boxes.reach) + constant
    terms = 2 * np.einsum("rbd,bd->rb", steep, boxes.size) + np.abs(constant)
    affine += _rounding(2 * slope.shape[2]) * terms
    up, down, bias = np.maximum(weight, 0), np.minimum(weight, 0), np.asarray(bias)[:, None]
    ranges = up @ values.most + down @ values.least + bias
    terms = up @ np.abs(values.most) - down @ np.abs(values.least) + np.abs(bias)
    ranges += _rounding(2 * weight.shape[1]) * terms
    return np.minimum(affine, ranges)


def _affine(boxes, weight, bias, values):
    """weight values + bias as Values."""
    high, low = _upper(weight, bias, values), -_upper(-weight, -bias, values)
    most = _highest(boxes, high, weight, bias, values)
    least = -_highest(boxes, -low, -weight, -bias, values)
    return Values.of(boxes, low, high, least, most)


def _at_middle(boxes, functions):
    """Affine functions (..., B, D + 1) at the middle of the boxes: (..., B)."""
    return np.einsum("...bd,bd->...b", functions[..., :-1], boxes.middle) + functions[..., -1]


def _bound_layer(layer, boxes, values, doubt):
    """The neurons of one layer as Values, and its LayerBounds; adds to `doubt` (B, D).

    The largest channel is above each of them, and below z_r + sum of max(z_j - z_r, 0): with l <= z_j - z_r <= u,
    the last is at most the chord u (z_j - z_r - l) / (u - l), or else the largest u stands for them all.
    """
    w, p, B = layer.width, layer.pool, len(boxes)
    W, b = layer.weight.reshape(w, p, layer.weight.shape[1]), layer.bias.reshape(w, p)
    apart = (W[:, :, None] - W[:, None]).reshape(w * p * p, W.shape[2])
    apart_bias = (b[:, :, None] - b[:, None]).reshape(-1)
    above = _upper(apart, apart_bias, values)
    ahead = _highest(boxes, above, apart, apart_bias, values).reshape(w, p, p, B)
    alive = np.ones((w, p, B), bool)
    for i in range(p):
        for j in range(p):
            if i != j:  # z_i never exceeds z_j, which is still there
                alive[:, i] &= ~(alive[:, j] & (ahead[:, i, j] <= 0))

    z = _affine(boxes, layer.weight, layer.bias, values)
    low, high = (part.reshape(w, p, *part.shape[1:]) for part in (z.low, z.high))
    guess = np.where(alive, _at_middle(boxes, low) + _at_middle(boxes, high), -np.inf).argmax(axis=1)  # the r above
    neuron, box = np.arange(w)[:, None], np.arange(B)[None]
    low, high = low[neuron, guess, box], high[neuron, guess, box]
    rows = np.arange(p)[None, :, None]
    u = np.where(alive, np.maximum(ahead[neuron[:, None], rows, guess[:, None], box[None]], 0), 0)
    u[neuron, guess, box] = 0
    open_ = u.any(axis=(1, 2))
    if open_.any():
        l = -ahead[neuron[:, None], guess[:, None], rows, box[None]]  # noqa: E741 - as in the docstring
        slope = np.where(u > 0, u / np.where(u > 0, u - l, 1), 0)
        rise = above.reshape(w, p, p, *above.shape[1:])[neuron[:, None], rows, guess[:, None], box[None]]
        doubt += np.einsum("wpbd->bd", np.abs(rise[..., :-1]) * (u > 0)[..., None]) * boxes.reach
        chord = slope[..., None] * rise
        chord[..., -1] -= slope * l
        terms = _upper_terms(apart, apart_bias, values).reshape(w, p, p, B)
        terms = terms[neuron[:, None], rows, guess[:, None], box[None]]
        terms = (slope * (terms + np.abs(l)) + u).sum(axis=1) + z.size.reshape(w, p, B)[neuron, guess, box]
        chord, highest_u = chord.sum(axis=1), u.max(axis=1)
        better = _at_middle(boxes, chord) < highest_u
        flat = np.zeros_like(chord)
        flat[..., -1] = highest_u
        high = high + np.where(better[..., None], chord, flat)
        high[..., -1] += _rounding(p) * terms
    channels = (w, p, B)
    most = np.where(alive, z.most.reshape(channels), -np.inf).max(axis=1)
    least = z.least.reshape(channels).max(axis=1)
    return Values.of(boxes, low, high, least, most), LayerBounds(alive, ahead, least, most)


def _met(system, boxes, xu, doubt):
    """Modes whose region the box may meet: (s, B); adds to `doubt` (B, D)."""
    met = []
    for mode in system.modes:
        H, h = mode.region.H, mode.region.h
        deepest = highest(boxes, -H, h, xu)
        met.append((deepest >= -ON_BOUNDARY).all(axis=0))
    return np.array(met)


def _next_state(system, boxes, xu, met, columns):
    """x(j + 1) = A x + B u + p + d(j), d(j) the coordinates `columns` of w, over all modes met.

    Affine functions where there is one mode; the hull of all images where there are more.
    """
    n, B = system.state_size, len(boxes)
    shape = (n, B, boxes.lower.shape[1] + 1)
    low, high = np.zeros(shape), np.zeros(shape)
    least, most = np.full((n, B), np.inf), np.full((n, B), -np.inf)
    for mode, on in zip(system.modes, met):
        image = _affine(boxes, np.hstack([mode.A, mode.B]), mode.p, xu)
        low, high = np.where(on[None, :, None], image.low, low), np.where(on[None, :, None], image.high, high)
        least = np.where(on, np.minimum(least, image.least), least)
        most = np.where(on, np.maximum(most, image.most), most)
    several = met.sum(axis=0) != 1
    flat = np.zeros(shape)
    for ends, bound in ((low, least), (high, most)):
        flat[..., -1] = bound
        ends[:, several] = flat[:, several]
    d = _coordinates(boxes, columns)
    least, most = least + d.least, most + d.most
    least, most = least - ROUNDOFF * np.abs(least), most + ROUNDOFF * np.abs(most)
    return Values.of(boxes, low + d.low, high + d.high, least, most)
