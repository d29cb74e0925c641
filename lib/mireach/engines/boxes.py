"""Affine bounds of the closed loop on many boxes at once: channels that can win, modes that can act, values of v x(k).

Trajectories are functions of w = (x(0), d(0), ..., d(k - 2)); the last disturbance only adds its support function.
On a box of w every quantity lies between two affine functions of w, which are propagated from layer to layer by the
signs of the weights. Where one channel wins on the whole box, both are that channel, so that the bounds become exact as
boxes shrink.

All bounds hold for the loop in real arithmetic, whatever the sizes of the weights: the rounding errors of each function
are bounded by the sizes of the terms that were summed up, before they cancel, and move its constant outward.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..sets.polytope import Polytope
from ..systems.loop import ClosedLoop
from ..systems.network import Layer
from ..systems.pwa import Mode, PWASystem
from ..tolerances import MODE_BOUNDARY, ROUNDOFF
from ..typing import Array, BoolArray, IntArray
from .bounds import SAFETY, proven_box


@dataclass(frozen=True, eq=False)
class Boxes:
    """B boxes of R^D.

    Attributes
    ----------
    lower, upper : array (B, D)
    """

    lower: Array
    upper: Array

    @cached_property
    def middle(self) -> Array:
        """The middles of the boxes: (B, D)."""
        return (self.lower + self.upper) / 2

    @cached_property
    def half_width(self) -> Array:
        """Half the width of each box along each axis: (B, D)."""
        return (self.upper - self.lower) / 2

    @cached_property
    def size(self) -> Array:
        """The largest |w_i| on each box: (B, D)."""
        return np.maximum(np.abs(self.lower), np.abs(self.upper))

    def __len__(self) -> int:
        return len(self.lower)

    def take(self, chosen: Sequence[int] | IntArray | BoolArray) -> "Boxes":
        """The boxes with the given indices, or where a mask is True."""
        return Boxes(self.lower[chosen], self.upper[chosen])

    def split(self, axis: IntArray, overlap: float) -> "Boxes":
        """Both halves of every box along its own axis (B,). They overlap by 2 `overlap` (1 + |w_axis|)."""
        rows = np.arange(len(self))
        where = self.middle[rows, axis]
        lower, upper = self.lower.copy(), self.upper.copy()
        lower[rows, axis] = where - overlap * (1 + np.abs(where))
        upper[rows, axis] = where + overlap * (1 + np.abs(where))
        return Boxes(np.concatenate([self.lower, lower]), np.concatenate([upper, self.upper]))

    def within(self, box: "Boxes") -> tuple["Boxes", IntArray]:
        """The intersections with the first box of other Boxes, and the indices of the boxes that meet it."""
        lower, upper = np.maximum(self.lower, box.lower[0]), np.minimum(self.upper, box.upper[0])
        chosen = np.flatnonzero((lower <= upper).all(axis=1))
        return Boxes(lower[chosen], upper[chosen]), chosen

    def meets(self, P: Polytope) -> BoolArray:
        """Whether no single row of the Polytope P separates P from the first n coordinates of a box: (B,)."""
        n = P.dimension
        nearest = self.middle[:, :n] @ P.H.T - self.half_width[:, :n] @ np.abs(P.H).T
        nearest -= 2 * _rounding(n) * (self.size[:, :n] @ np.abs(P.H).T)
        return np.logical_and.reduce(nearest <= P.h + MODE_BOUNDARY * (1 + np.abs(P.h)), axis=1)


@dataclass(frozen=True, eq=False)
class Values:
    """r quantities on each of B boxes: low (w, 1) <= value <= high (w, 1), and least <= value <= most.

    Attributes
    ----------
    low, high : array (r, B, D + 1)
        Coefficients of w, then the constant.
    least, most : array (r, B)
    size : array (r, B)
        An upper bound over the box of the sum of |terms| of `low`, and of `high`.
    """

    low: Array
    high: Array
    least: Array
    most: Array
    size: Array

    @staticmethod
    def of(boxes: Boxes, low: Array, high: Array, least: Array, most: Array) -> "Values":
        """Values with their `size` computed."""
        size = _terms(boxes, high)
        return Values(low, high, least, most, size if low is high else np.maximum(size, _terms(boxes, low)))

    @property
    def largest(self) -> Array:
        """Largest size of each value: (r, B)."""
        return np.maximum(np.abs(self.least), np.abs(self.most))

    def join(self, other: "Values") -> "Values":
        """The quantities of both."""
        return Values(*(np.concatenate(pair) for pair in zip(self._parts, other._parts)))

    def at(self, box: int) -> "Values":
        """The quantities on one box."""
        return Values(*(part[:, box] for part in self._parts))

    @property
    def _parts(self) -> tuple[Array, ...]:
        return self.low, self.high, self.least, self.most, self.size


@dataclass(frozen=True, eq=False)
class LayerBounds:
    """One hidden layer on B boxes.

    Attributes
    ----------
    alive : array (w, p, B) of bool
        Channels that may win. Of channels that tie everywhere only one counts.
    ahead : array (w, p, p, B)
        Upper bounds: ahead[l, i, j] >= z_i - z_j of neuron l.
    least, most : array (w, B)
        Range of each neuron.
    """

    alive: BoolArray
    ahead: Array
    least: Array
    most: Array

    def neuron(self, index: int) -> "LayerBounds":
        """Bounds of one neuron."""
        return LayerBounds(self.alive[index], self.ahead[index], self.least[index], self.most[index])

    def at(self, box: int) -> "LayerBounds":
        """Bounds on one box."""
        return LayerBounds(self.alive[..., box], self.ahead[..., box], self.least[..., box], self.most[..., box])


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
    layers: list[LayerBounds]
    met: BoolArray

    def at(self, box: int) -> "StepBounds":
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
        How much each coordinate of w contributes to the gap of the bounds; boxes are split along the largest.
    """

    boxes: Boxes
    steps: list[StepBounds]
    possible: BoolArray
    doubt: Array

    def at(self, box: int) -> list[StepBounds]:
        """The StepBounds of one box, step by step."""
        return [step.at(box) for step in self.steps]

    @property
    def binaries(self) -> IntArray:
        """Binary variables that a MILP over each box needs: (B,)."""
        count = np.zeros(len(self.boxes), int)
        for step in self.steps:
            for choice in [layer.alive for layer in step.layers] + [step.met[None]]:
                alive = choice.sum(axis=1)
                count += np.where(alive > 1, alive, 0).sum(axis=0)
        return count

    def highest_state(self, loop: ClosedLoop, V: Array, spread: Array) -> Array:
        """Upper bound of v x(k) for each row of V: (B, rows of V); -inf where no mode can act.

        `spread` (s, rows of V) is the support function of the modes' disturbance sets along V.
        """
        last = self.steps[-1]
        xu = last.state.join(last.inputs)
        best = np.full((len(V), len(self.boxes)), -np.inf)
        for mode, met, most in zip(loop.system.modes, last.met, spread):
            if not met.any():
                continue
            AB = np.hstack([mode.A, mode.B])
            count = V.shape[1] + 2
            weight_error = _rounding(count) * (np.abs(V) @ np.abs(AB))
            bias_error = _rounding(count) * (np.abs(V) @ np.abs(mode.p) + np.abs(most))
            error = weight_error @ xu.largest + bias_error[:, None]
            value = highest(self.boxes, V @ AB, V @ mode.p + most, xu)
            value = value + (error + ROUNDOFF * (np.abs(value) + error))
            best = np.where(met, np.maximum(best, value), best)
        return np.where(self.possible, best, -np.inf).T

    def highest_input(self, V: Array) -> Array:
        """Upper bound of v u(0) for each row of V: (B, rows of V)."""
        return highest(self.boxes, V, np.zeros(len(V)), self.steps[0].inputs).T


def bound_loop(loop: ClosedLoop, boxes: Boxes, steps: int = 1) -> LoopBounds:
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
    system, net = loop.system, loop.network
    n = system.state_size
    doubt = np.zeros(boxes.lower.shape)
    possible = np.ones(len(boxes), bool)
    state = _coordinates(boxes, range(n))
    found = []
    for j in range(steps):
        if j:
            X = system.state_set
            possible &= (-highest(boxes, -X.H, X.h, state) <= MODE_BOUNDARY * (1 + np.abs(X.h[:, None]))).all(axis=0)
            low, high = proven_box(X)
            least, most = np.maximum(state.least, low[:, None]), np.minimum(state.most, high[:, None])
            state = Values(state.low, state.high, least, most, state.size)
        values = state
        layers = []
        for layer in net.hidden:
            values, bounds = _bound_layer(layer, boxes, values, doubt)
            layers.append(bounds)
        inputs = _affine(boxes, net.weight, net.bias, values)
        met = _met(system, boxes, state.join(inputs))
        possible &= met.any(axis=0)
        found.append(StepBounds(state, inputs, layers, met))
        if j + 1 < steps:
            state = _next_state(system, boxes, state.join(inputs), met, range(n * (j + 1), n * (j + 2)))
    return LoopBounds(boxes, found, possible, doubt)


def root_box(loop: ClosedLoop, start: Polytope, steps: int) -> Boxes:
    """The box of w = (x(0), d(0), ..., d(k - 2)) around start x D x ... x D, widened by `widened`, as Boxes.

    Parameters
    ----------
    loop : ClosedLoop
    start : Polytope
        The part of F in X, which must not be empty.
    steps : int
        The k of R_k.
    """
    x_low, x_high = proven_box(start)
    d_low, d_high = disturbance_box(loop.system.modes)
    low, high = widened(
        np.concatenate([x_low, np.tile(d_low, steps - 1)]), np.concatenate([x_high, np.tile(d_high, steps - 1)])
    )
    return Boxes(low[None], high[None])


def disturbance_box(modes: Sequence[Mode]) -> tuple[Array, Array]:
    """The smallest box around all disturbance sets: two arrays (n,)."""
    lower, upper = zip(*(proven_box(D) for D in {mode.disturbance for mode in modes}))
    return np.min(lower, axis=0), np.max(upper, axis=0)


def widened(low: Array, high: Array) -> tuple[Array, Array]:
    """Bounds moved apart by `SAFETY` (1e-6) times 1 + their size, far more than HiGHS's tolerances.

    Programs with these limits of variables have rows with the exact ones. Bounds over such a box alone are valid, and
    looser by about as much.
    """
    return low - SAFETY * (1 + np.abs(low)), high + SAFETY * (1 + np.abs(high))


def highest(boxes: Boxes, weight: Array, bias: Array, values: Values) -> Array:
    """Upper bound of weight values + bias on each box: (r, B)."""
    return _highest(boxes, _upper(weight, bias, values), weight, bias, values)


# -- parts --------------------------------------------------------------------------------------------


def _rounding(terms: int) -> float:
    """The rounding error of a sum of `terms` products, relative to the sum of their absolute values."""
    return ROUNDOFF * (terms + 8)


def _terms(boxes: Boxes, functions: Array) -> Array:
    """An upper bound over the boxes of the sum of |terms| of affine functions (r, B, D + 1): (r, B)."""
    size = np.abs(functions)
    return np.einsum("rbd,bd->rb", size[..., :-1], boxes.size) + size[..., -1]


def _coordinates(boxes: Boxes, axes: range) -> Values:
    """Coordinates of w as Values."""
    B, D = boxes.lower.shape
    columns = list(axes)
    identity = np.zeros((len(columns), B, D + 1))
    identity[np.arange(len(columns)), :, columns] = 1
    return Values(identity, identity, boxes.lower.T[columns], boxes.upper.T[columns], boxes.size.T[columns])


def _upper(weight: Array, bias: Array, values: Values) -> Array:
    """Affine functions (r, B, D + 1) above weight values + bias."""
    up, down = np.maximum(weight, 0), np.minimum(weight, 0)
    found = np.tensordot(up, values.high, 1) + np.tensordot(down, values.low, 1)
    found[:, :, -1] += bias[:, None] + _rounding(2 * weight.shape[1]) * _upper_terms(weight, bias, values)
    return found


def _upper_terms(weight: Array, bias: Array, values: Values) -> Array:
    """Upper bounds (r, B) of the sum of |terms| in `_upper`; its rounding errors are relative to them."""
    return np.abs(weight) @ values.size + np.abs(bias)[:, None]


def _highest(boxes: Boxes, upper: Array, weight: Array, bias: Array, values: Values) -> Array:
    """The smaller of two bounds of weight values + bias: by the affine functions `upper`, and by ranges; (r, B)."""
    slope, constant = upper[:, :, :-1], upper[:, :, -1]
    steep = np.abs(slope)
    affine = np.einsum("rbd,bd->rb", slope, boxes.middle) + np.einsum("rbd,bd->rb", steep, boxes.half_width) + constant
    terms = 2 * np.einsum("rbd,bd->rb", steep, boxes.size) + np.abs(constant)
    affine += _rounding(2 * slope.shape[2]) * terms
    up, down = np.maximum(weight, 0), np.minimum(weight, 0)
    ranges = up @ values.most + down @ values.least + bias[:, None]
    terms = up @ np.abs(values.most) - down @ np.abs(values.least) + np.abs(bias[:, None])
    ranges += _rounding(2 * weight.shape[1]) * terms
    return np.minimum(affine, ranges)


def _affine(boxes: Boxes, weight: Array, bias: Array, values: Values) -> Values:
    """weight values + bias as Values."""
    high, low = _upper(weight, bias, values), -_upper(-weight, -bias, values)
    most = _highest(boxes, high, weight, bias, values)
    least = -_highest(boxes, -low, -weight, -bias, values)
    return Values.of(boxes, low, high, least, most)


def _at_middle(boxes: Boxes, functions: Array) -> Array:
    """Affine functions (..., B, D + 1) at the middle of the boxes: (..., B)."""
    return np.einsum("...bd,bd->...b", functions[..., :-1], boxes.middle) + functions[..., -1]


def _bound_layer(layer: Layer, boxes: Boxes, values: Values, doubt: Array) -> tuple[Values, LayerBounds]:
    """The neurons of one layer as Values, and its LayerBounds; adds to `doubt` (B, D).

    The largest channel is at least each of them, and at most z_r + sum of max(z_j - z_r, 0) for every channel r. The
    sum is bounded by `_chords`.
    """
    w, p = layer.width, layer.pool
    channels, pairs = (w, p, len(boxes)), (w, p, p, len(boxes))
    apart, apart_bias = _differences(layer)
    above = _upper(apart, apart_bias, values)
    ahead = _highest(boxes, above, apart, apart_bias, values).reshape(pairs)
    alive = _alive(ahead)
    z = _affine(boxes, layer.weight, layer.bias, values)
    low, high = (part.reshape(w, p, *part.shape[1:]) for part in (z.low, z.high))
    guess = np.where(alive, _at_middle(boxes, low) + _at_middle(boxes, high), -np.inf).argmax(axis=1)  # the r above
    neuron, box = np.arange(w)[:, None], np.arange(len(boxes))[None]
    low, high = low[neuron, guess, box], high[neuron, guess, box]
    rows = np.arange(p)[None, :, None]
    versus_guess = neuron[:, None], rows, guess[:, None], box[None]  # the pairs (j, r)
    u = np.where(alive, np.maximum(ahead[versus_guess], 0), 0)
    u[neuron, guess, box] = 0
    if u.any():
        l = -ahead[neuron[:, None], guess[:, None], rows, box[None]]  # noqa: E741 - as in `_chords`
        rise = above.reshape(*pairs, -1)[versus_guess]
        doubt += np.einsum("wpbd->bd", np.abs(rise[..., :-1]) * (u > 0)[..., None]) * boxes.half_width
        added, terms = _chords(boxes, rise, l, u, _upper_terms(apart, apart_bias, values).reshape(pairs)[versus_guess])
        high = high + added
        high[..., -1] += _rounding(p) * (terms + z.size.reshape(channels)[neuron, guess, box])
    most = np.where(alive, z.most.reshape(channels), -np.inf).max(axis=1)
    least = z.least.reshape(channels).max(axis=1)
    return Values.of(boxes, low, high, least, most), LayerBounds(alive, ahead, least, most)


def _differences(layer: Layer) -> tuple[Array, Array]:
    """Weight and bias of z_i - z_j for all pairs of channels of each neuron: (w p p, q) and (w p p,)."""
    W = layer.weight.reshape(layer.width, layer.pool, layer.weight.shape[1])
    b = layer.bias.reshape(layer.width, layer.pool)
    return (W[:, :, None] - W[:, None]).reshape(-1, W.shape[2]), (b[:, :, None] - b[:, None]).reshape(-1)


def _alive(ahead: Array) -> BoolArray:
    """Channels that may win (w, p, B), given ahead[l, i, j] >= z_i - z_j."""
    w, p, _, B = ahead.shape
    alive = np.ones((w, p, B), bool)
    for i in range(p):
        for j in range(p):
            if i != j:  # z_i never exceeds z_j, and z_j may win
                alive[:, i] &= ~(alive[:, j] & (ahead[:, i, j] <= 0))
    return alive


def _chords(boxes: Boxes, rise: Array, l: Array, u: Array, sizes: Array) -> tuple[Array, Array]:  # noqa: E741
    """Affine functions above the sum over j of max(z_j - z_r, 0), and the sizes that their rounding is relative to.

    With l <= z_j - z_r <= u, a term is at most the chord u (z_j - z_r - l) / (u - l). Where the largest u is less than
    the sum of the chords at the middle of a box, it bounds the sum there.

    Parameters
    ----------
    rise : array (w, p, B, D + 1)
        Affine functions above z_j - z_r.
    l, u : array (w, p, B)
    sizes : array (w, p, B)
        The sizes that the rounding of `rise` is relative to.

    Returns
    -------
    array (w, B, D + 1), array (w, B)
    """
    slope = np.where(u > 0, u / np.where(u > 0, u - l, 1), 0)
    chord = slope[..., None] * rise
    chord[..., -1] -= slope * l
    terms = (slope * (sizes + np.abs(l)) + u).sum(axis=1)
    chord, highest_u = chord.sum(axis=1), u.max(axis=1)
    better = _at_middle(boxes, chord) < highest_u
    flat = np.zeros_like(chord)
    flat[..., -1] = highest_u
    return np.where(better[..., None], chord, flat), terms


def _met(system: PWASystem, boxes: Boxes, xu: Values) -> BoolArray:
    """Modes whose region the box may meet: (s, B)."""
    met = []
    for mode in system.modes:
        H, h = mode.region.H, mode.region.h
        deepest = highest(boxes, -H, h, xu)
        met.append((deepest >= -MODE_BOUNDARY).all(axis=0))
    return np.array(met)


def _next_state(system: PWASystem, boxes: Boxes, xu: Values, met: BoolArray, axes: range) -> Values:
    """x(j + 1) = A x + B u + p + d(j), d(j) the coordinates `axes` of w, over all modes that can act.

    Affine functions where one mode can act; constants that bound all images where more can.
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
    d = _coordinates(boxes, axes)
    least, most = least + d.least, most + d.most
    least, most = least - ROUNDOFF * np.abs(least), most + ROUNDOFF * np.abs(most)
    return Values.of(boxes, low + d.low, high + d.high, least, most)
