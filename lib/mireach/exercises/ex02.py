"""Checks of exercise 02: a maxout network as mixed-integer constraints."""

from itertools import product
from typing import Any

import numpy as np

from ..sets.polytope import Polytope
from ..systems.network import Layer, MaxoutNetwork
from ..typing import Array
from .common import require, require_array, require_filled, require_number, require_pair, require_whole, text

TOL = 1e-9  # for numbers that differ by rounding only
NOTICEABLE = 0.05  # by how much a broken model must be wrong in task 3, in units of Phi
INTEGRAL = 1e-6  # how far from 0 or 1 a binary may be for a solver, as HiGHS has it


def example() -> tuple[MaxoutNetwork, Polytope]:
    """The network of task 3, with weights of one decimal, and the box F of its inputs.

    Returns
    -------
    MaxoutNetwork
        2 inputs, two layers of three neurons with three channels each, 1 output.
    Polytope
    """
    return _network(np.random.default_rng(9)), Polytope.box([-4, -4], [4, 4])


def largest_output(net: MaxoutNetwork, F: Polytope, M: float) -> float:
    """max Phi(x) over x in F by eq. (9), MI_Constraints_NN, with the same big-M in every row.

    Parameters
    ----------
    net : MaxoutNetwork
        With one output.
    F : Polytope
    M : float

    Returns
    -------
    float
        -inf if the constraints have no solution at all.
    """
    import cvxpy as cp

    x: Any = cp.Variable(net.input_size)
    constraints: list[Any] = [F.H @ x <= F.h]
    q = x
    for layer in net.hidden:
        z, q = layer.weight @ q + layer.bias, cp.Variable(layer.width)
        for neuron in range(layer.width):
            A_l, delta = slice(layer.pool * neuron, layer.pool * (neuron + 1)), cp.Variable(layer.pool, boolean=True)
            constraints += [
                q[neuron] <= z[A_l] + M * (1 - delta),
                -q[neuron] <= -z[A_l],
                np.ones(layer.pool) @ delta == 1,
            ]
    problem = cp.Problem(cp.Maximize((net.weight @ q + net.bias)[0]), constraints)
    problem.solve(solver="HIGHS")
    return float(problem.value) if problem.status == cp.OPTIMAL else -np.inf


def check_t1(counts: Any) -> None:
    """Task 1: binaries and channel choices of a saturated ReLU controller with 2, 32, 32 and 1 neurons.

    Parameters
    ----------
    counts : (number, number)

    Raises
    ------
    Wrong
        With the number that is wrong, and by how much.
    """
    binaries, choices = require_array(counts, (2,), "counts")
    relu = [
        Layer(np.ones((64, before)), np.zeros(64), 2) for before in (2, 32)
    ]  # only sizes matter here; (z, 0) are the channels of a ReLU
    net = MaxoutNetwork(tuple(relu), np.ones((1, 32)), np.zeros(1)).saturate(-1, 1)
    require(
        binaries == net.binaries,
        f"binaries = {binaries:g} is off by {abs(binaries - net.binaries):g}: there is one delta for each channel of "
        "each neuron, in the two layers that saturate the output as well",
    )
    true = np.prod([float(layer.pool) ** layer.width for layer in net.hidden])
    require(
        abs(choices / true - 1) < 0.01,
        f"choices = {choices:.3g} is {choices / true:.2g} times what it should be: each neuron follows one of its "
        "channels, independently of all other neurons",
    )
    print(f"ok: {choices:.1e} choices; nobody tries them one by one")


def check_t2(smallest_M: Any) -> None:
    """Task 2: smallest_M(W, b, lower, upper) for random neurons over random boxes in R^1 to R^3.

    Parameters
    ----------
    smallest_M : callable
        (p, n), (p,), (n,), (n,) -> (p,).

    Raises
    ------
    Wrong
        With a state that some M_j excludes, or by how much M_j could be smaller.
    """
    rng = np.random.default_rng()
    for n in (1, 1, 2, 2, 3):
        p = int(rng.integers(2, 5))
        W = rng.uniform(-2, 2, (p, n))
        b = rng.uniform(-1, 1, p)
        lower = rng.uniform(-2, 1, n)
        upper = lower + rng.uniform(0.5, 2, n)
        M = require_array(smallest_M(W, b, lower, upper), (p,), "smallest_M(W, b, lower, upper)")
        corners = np.array(list(product(*zip(lower, upper))))
        z = corners @ W.T + b
        behind = z.max(axis=1, keepdims=True) - z
        for j in range(p):
            k = int(np.argmax(behind[:, j]))
            require(
                M[j] >= behind[k, j] - TOL,
                f"M_{j + 1} = {M[j]:.3f} is too small: at x = {text(corners[k])} channel {j + 1} is {z[k, j]:.3f} and "
                f"the largest channel {z[k].max():.3f}, so q <= z_{j + 1} + M_{j + 1} cuts this state off",
            )
            require(
                M[j] <= behind[k, j] + TOL,
                f"M_{j + 1} = {M[j]:.3f} is sound, but not the smallest: {M[j] - behind[k, j]:.3f} less is "
                f"enough. Where z_i is largest, z_{j + 1} need not be smallest",
            )
    print("ok: the smallest big-M of each channel")


def check_t3(broken: Any) -> None:
    """Task 3: a big-M with which the model is wrong without warning, a state that it excludes, and the row to blame.

    Parameters
    ----------
    broken : dict
        "M": number, "x": (2,), and "layer", "neuron", "channel", counted from 1.

    Raises
    ------
    Wrong
        If the model is infeasible, if the state does not show that its value is too small, or if the named row does not
        exclude the state.
    """
    require_filled(broken, "broken")
    names = ("M", "x", "layer", "neuron", "channel")
    require(isinstance(broken, dict) and set(broken) == set(names), f"broken must be a dict with the keys {names}")
    for name in names:
        require_filled(broken[name], f'broken["{name}"]')
    net, F = example()
    M, x = require_number(broken["M"], "M"), require_array(broken["x"], (2,), "x")
    require(F.contains(x, tol=TOL), f"x = {text(x)} is not in F")
    claim = largest_output(net, F, M)
    require(claim > -np.inf, f"with M = {M:g} no state is left, and the solver says so; find an M that nobody notices")
    output = float(net(x)[0])
    require(
        output > claim + NOTICEABLE,
        f"with M = {M:g} the model claims Phi <= {claim:.3f} on F, and Phi(x) = {output:.3f} at your x does not "
        f"contradict that by {NOTICEABLE:g} or more",
    )
    layers = _behind(net, x)
    where = [
        require_whole(broken["layer"], "layer", 1, len(layers)) - 1,
        require_whole(broken["neuron"], "neuron", 1, net.hidden[0].width) - 1,
        require_whole(broken["channel"], "channel", 1, net.hidden[0].pool) - 1,
    ]
    gap = layers[where[0]][where[1], where[2]]
    row = f"channel {where[2] + 1} of neuron {where[1] + 1} in layer {where[0] + 1}"
    require(
        gap > M,
        f"with M = {M:g} the model has indeed lost x = {text(x)}, but not by the row of {row}: this channel is "
        f"{gap:.3f} behind its winner there, which M = {M:g} allows",
    )
    print(
        f"ok: the model claims Phi <= {claim:.3f}, but Phi({text(x)}) = {output:.3f}. Unsound, for {row} is "
        f"{gap:.3f} behind its winner there, and q <= z_j + {M:g} cannot hold"
    )


def check_t4(network_M: Any) -> None:
    """Task 4: network_M(net, lower, upper), a sound big-M for each channel, no larger than interval arithmetic's.

    Parameters
    ----------
    network_M : callable
        MaxoutNetwork, (n,), (n,) -> list of arrays (w, p), one per layer.

    Raises
    ------
    Wrong
        With a state that is excluded and the neuron whose row excludes it; or where a number is larger than needed.
    """
    rng = np.random.default_rng()
    for _ in range(4):
        net = _network(rng)
        lower = rng.uniform(-3, 0, 2)
        upper = lower + rng.uniform(1, 4, 2)
        M = network_M(net, lower, upper)
        require_filled(M, "network_M(net, lower, upper)")
        require(len(M) == len(net.hidden), f"network_M must return one array per layer; got {len(M)} for 2 layers")
        M = [require_array(M_i, (3, 3), f"M of layer {i}") for i, M_i in enumerate(M, start=1)]
        corners = np.array(list(product(*zip(lower, upper))))
        states = np.vstack([corners, rng.uniform(lower, upper, (20000, 2))])
        for i, (behind, M_i, wide) in enumerate(zip(_behind(net, states), M, _interval_M(net, lower, upper)), start=1):
            k, neuron, j = np.unravel_index(np.argmax(behind - M_i), behind.shape)
            require(
                behind[k, neuron, j] <= M_i[neuron, j] + TOL,
                f"cuts states off: at x = {text(states[k])}, channel {j + 1} of neuron {neuron + 1} in layer {i} is "
                f"{behind[k, neuron, j]:.3f} behind its winner, but its M is {M_i[neuron, j]:.3f}. A bound must hold "
                "for every state, tried or not, and for the inputs that this layer gets",
            )
            neuron, j = np.unravel_index(np.argmax(M_i - wide), wide.shape)
            require(
                M_i[neuron, j] <= wide[neuron, j] + 1e-6,
                f"sound, but M = {M_i[neuron, j]:.3f} of channel {j + 1} of neuron {neuron + 1} in layer {i} is larger "
                f"than what interval arithmetic proves, by {M_i[neuron, j] - wide[neuron, j]:.3f}",
            )
    print("ok: no state is excluded")


def check_t5(cheat: Any) -> None:
    """Task 5: cheat(z, M) = (q, delta), feasible for a solver, with q as far above max z as its tolerance permits.

    Parameters
    ----------
    cheat : callable
        (p,), number -> number, (p,).

    Raises
    ------
    Wrong
        With the row that is violated, or how much further q can go.
    """
    rng = np.random.default_rng()
    for M in (1e5, 1e6, 1e7):
        z = rng.uniform(-3, 3, int(rng.integers(2, 5)))
        pair = require_pair(cheat(z, M), "cheat(z, M)", "(q, delta)")
        q, delta = require_number(pair[0], "q"), require_array(pair[1], z.shape, "delta")
        case = f"M = {M:g}, z = {text(z)}"
        off = np.abs(delta - delta.round())
        j = int(np.argmax(off))
        require(
            off[j] <= INTEGRAL * (1 + 1e-6) and ((delta > -TOL) & (delta < 1 + TOL)).all(),
            f"{case}: delta_{j + 1} = {delta[j]:.9f} is further than {INTEGRAL:g} from 0 and 1; no solver accepts it",
        )
        require(abs(delta.sum() - 1) <= TOL, f"{case}: the delta sum up to {delta.sum():.9f}, not to 1")
        require(q >= z.max() - TOL, f"{case}: q = {q:.3f} is below a channel, and -q <= -z_j is violated")
        excess = q - z - M * (1 - delta)
        j = int(np.argmax(excess))
        require(
            excess[j] <= 1e-7,
            f"{case}: q = {q:.6f} <= z_{j + 1} + M (1 - delta_{j + 1}) is violated by {excess[j]:.3g}",
        )
        require(
            q - z.max() >= 0.9 * INTEGRAL * M,
            f"{case}: feasible, and q is wrong by {q - z.max():.3g}; but the tolerance permits far more",
        )
    print("ok: a solver accepts this, with an error of its tolerance times M")


# -- helpers --------------------------------------------------------------------------------------


def _network(rng: np.random.Generator) -> MaxoutNetwork:
    """A 3x3 network of two layers from R^2 to R, with weights of one decimal."""

    def tenths(*shape: int) -> Array:
        return rng.integers(-10, 11, shape) / 10

    return MaxoutNetwork(tuple(Layer(tenths(9, n), tenths(9), 3) for n in (2, 3)), tenths(1, 3), tenths(1))


def _behind(net: MaxoutNetwork, x: Array) -> list[Array]:
    """How far each channel is behind its neuron's winner: for each layer an array (..., w, p)."""
    found = []
    for layer in net.hidden:
        z = layer.channels(x)
        x = z.max(axis=-1)
        found.append(x[..., None] - z)
    return found


def _interval_M(net: MaxoutNetwork, lower: Array, upper: Array) -> list[Array]:
    """The big-M that interval arithmetic gives, one array (w, p) per layer."""
    found = []
    for layer in net.hidden:
        low = layer.channels((lower + upper) / 2)
        half_width = (np.abs(layer.weight) @ ((upper - lower) / 2)).reshape(low.shape)
        low, high = low - half_width, low + half_width
        found.append(high.max(axis=-1, keepdims=True) - low)
        lower, upper = low.max(axis=-1), high.max(axis=-1)
    return found
