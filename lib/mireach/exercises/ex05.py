"""Checks of exercise 05: from optimal control to a maxout network."""

from typing import Any

import numpy as np

from ..engines.cells import cells
from ..learning.mpc import solve_miqp
from ..studies.case_studies import case_study
from ..systems.loop import ClosedLoop
from ..systems.network import MaxoutNetwork
from ..systems.plants import pwa_plant
from ..systems.pwa import PWASystem
from ..typing import Array
from .common import (
    Wrong,
    random_network,
    require,
    require_array,
    require_filled,
    require_instance,
    require_number,
    text,
)

TOL = 1e-6  # for numbers that differ by rounding, relative to 1 + their size
STRIP = 1e-3  # states this close to the line of task 2 are not tested
MOST_BINARIES, MOST_LOSS = 20, 0.05  # what task 6 allows


def check_t1(cost: Any) -> None:
    """Task 1: cost(system, x0, inputs) = cost of an input sequence, inf if it violates a constraint.

    Parameters
    ----------
    cost : callable
        PWASystem, (2,), (N, 1) -> number.

    Raises
    ------
    Wrong
        With the state, N, the answer, and what it should have been.
    """
    rng, system = np.random.default_rng(), pwa_plant()
    for kind in ("random", "random", "short", "plateau", "input", "state"):
        x0 = rng.uniform([-10, -10], [-9.5, -9.5]) if kind == "state" else rng.uniform(-4, 4, 2)
        horizon = int(rng.integers(1, 4)) if kind == "short" else 10
        inputs = rng.uniform(-1, 1, (horizon, 1))
        if kind == "plateau":
            inputs = np.sign(inputs)  # +1 and -1 are allowed
        if kind == "input":
            inputs[rng.integers(horizon)] = rng.choice([-1.2, 1.2])
        truth = _cost(system, x0, inputs)
        answer = cost(system, x0.copy(), inputs.copy())
        require_filled(answer, "cost(system, x0, inputs)")
        answer = float(answer)
        case = f"for x0 = {text(x0)} and N = {horizon} you return {answer:.4f}"
        if np.isinf(truth):
            what = "an input is outside [-1, 1]" if kind == "input" else "a state is outside |x| <= 10"
            require(np.isinf(answer) and answer > 0, f"{case}, but {what}, so the cost is inf")
        else:
            require(np.isfinite(answer), f"{case}, but no constraint is violated")
            require(
                abs(answer - truth) <= TOL * (1 + truth),
                f"{case}; the states cost {_cost(system, x0, inputs, R=0):.4f} "
                f"and the inputs {_cost(system, x0, inputs, Q=0):.4f}",
            )
    print("ok: the cost of an input sequence")


def check_t2(row: Any, offset: Any) -> None:
    """Task 2: a state of X has no feasible input sequence exactly where row x < offset.

    Parameters
    ----------
    row : array (2,)
    offset : float

    Raises
    ------
    Wrong
        With a state for which the optimal control problem says the opposite.
    """
    row, offset = require_array(row, (2,), "row"), require_number(offset, "offset")
    length = np.linalg.norm(row)
    require(length > 1e-6, "row is zero, so that row x < offset is no half-plane")
    row, offset = row / length, offset / length
    rng, system = np.random.default_rng(), pwa_plant()
    states = np.vstack([rng.uniform(-10, 10, (30, 2)), rng.uniform(-10, -7, (40, 2)), rng.uniform(-10, 10, (400, 2))])
    distance = rng.choice([-1, 1], 400) * rng.uniform(2 * STRIP, 0.2, 400)
    states[70:] += (offset + distance - states[70:] @ row)[:, None] * row  # close to the line, on both sides
    states = states[(np.abs(states) <= 10).all(axis=1)]
    states = states[np.abs(states @ row - offset) > STRIP][:150]
    for x in states:
        claimed, feasible = bool(row @ x < offset), solve_miqp(system, x).feasible
        require(
            claimed != feasible,
            f"x = {text(x)}: your half-plane says {'no solution' if claimed else 'a solution exists'}, "
            f"but the optimal control problem has {'one' if feasible else 'none'} there",
        )
    print("ok: exactly these states have no solution")


def check_t3(smallest_error: Any) -> None:
    """Task 3: the smallest worst error on the line x2 = 5 that a continuous controller can have.

    Parameters
    ----------
    smallest_error : float

    Raises
    ------
    Wrong
        Saying whether the number is too small or too large, and why.
    """
    system = pwa_plant()
    left, right = (_first_input(system, x1) for x1 in (-1e-7, 1e-7))
    best = abs(right - left) / 2
    number = require_number(smallest_error, "smallest_error")
    sides = "u* has one value just left of x1 = 0 and another just right of it; a continuous controller has to give"
    require(
        number >= best - 1e-6,
        f"smallest_error = {number:g} is too small: {sides} nearly the same value on both sides, and is then off by "
        "more than that on one of them",
    )
    require(
        number <= best + 1e-6,
        f"smallest_error = {number:g} is more than necessary: {sides} one value at x1 = 0 itself, but it may choose "
        "which; take the one that makes the larger of the two errors smallest",
    )
    print("ok: no training can give a smaller worst error")


def check_t4(project: Any) -> None:
    """Task 4: project(network, lower, upper), a maxout network whose outputs are projected onto a box.

    Parameters
    ----------
    project : callable
        MaxoutNetwork, (m,), (m,) -> MaxoutNetwork.

    Raises
    ------
    Wrong
        With an input, the raw output and the output of the new network.
    """
    rng = np.random.default_rng()
    for m in (1, 1, 2, 3):
        network = random_network(rng, [(4, 3)], m)
        lower = rng.uniform(-2, 1, m).round(2)
        upper = (lower + rng.uniform(0.5, 2, m)).round(2)
        answer = project(network, lower.copy(), upper.copy())
        require_instance(answer, MaxoutNetwork, "project(network, lower, upper)")
        sizes = (answer.input_size, answer.output_size)
        require(sizes == (2, m), f"your network has {sizes[0]} inputs and {sizes[1]} outputs; 2 and {m} are needed")
        x = rng.normal(scale=5, size=(2000, 2))
        raw, y = network(x), answer(x)
        wrong = np.abs(y - np.clip(raw, lower, upper))
        i, j = np.unravel_index(np.argmax(wrong), wrong.shape)
        require(
            wrong[i, j] <= 1e-12,
            f"with lower = {text(lower)} and upper = {text(upper)}, the raw output {text(raw[i])} becomes {text(y[i])}",
        )
        excess = np.maximum(lower - y, y - upper).max()
        require(
            excess <= 0, f"an output leaves the box by {excess:.1e}; use weights of 0, 1 and -1 only, and no rounding"
        )
    print("ok: projected, exactly")


def check_t5(loss: Any) -> None:
    """Task 5: loss(z, u, lower, upper, leak), the mean leaky clipped loss, as a torch function.

    Parameters
    ----------
    loss : callable
        Tensor (N, 1), tensor (N, 1), float, float, float -> tensor ().

    Raises
    ------
    Wrong
        If its value differs from the formula, or its gradient from difference quotients.
    """
    import torch

    rng = np.random.default_rng()
    for leak in (0.01, 0.2):
        lower, upper = rng.uniform(-2, -0.5), rng.uniform(0.5, 2)
        z, u = rng.uniform(-5, 5, (30, 1)), rng.uniform(lower, upper, (30, 1))
        z[:2], u[:2] = [[-5], [5]], [[upper], [lower]]  # cut off on the wrong side
        variable = torch.tensor(z, requires_grad=True)
        answer = loss(variable, torch.tensor(u), lower, upper, leak)
        require_instance(answer, torch.Tensor, "loss(z, u, lower, upper, leak)")
        require(answer.shape == (), f"loss must return one number, a mean; got shape {tuple(answer.shape)}")
        require(
            answer.requires_grad,
            "your loss has lost its gradient: compute it with torch functions of z, not with numpy",
        )
        (slope,) = torch.autograd.grad(answer, variable)
        require(
            bool((slope[:2] != 0).all()),
            f"the sample z = {z[0, 0]:g}, u* = {u[0, 0]:.2f} has no slope: an output that is cut off on the wrong side "
            "stays there forever",
        )
        truth = _leaky(z, u, lower, upper, leak)
        value = float(answer.detach())
        require(
            abs(value - truth) <= TOL * (1 + truth),
            f"with leak = {leak}, U = [{lower:.2f}, {upper:.2f}] and 30 random samples you return {value:.5f}; "
            f"the formula gives {truth:.5f}",
        )
    print("ok: clipped, with a nonzero slope wherever it is needed")


def check_t6(network: Any) -> None:
    """Task 6: a network with at most 20 binaries and a mean squared error of at most 0.05, within U everywhere.

    Parameters
    ----------
    network : MaxoutNetwork

    Raises
    ------
    Wrong
        With the binaries, the error, or a state at which the network leaves U.
    """
    require_instance(network, MaxoutNetwork, "network (the `.network` of what `train` returns)")
    case = case_study("pwa")
    require(
        network.binaries <= MOST_BINARIES,
        f"{network!r} has {network.binaries} binaries, saturation included; at most {MOST_BINARIES} are allowed",
    )
    try:
        cells(ClosedLoop(case.system, network))  # looks at every vertex of every affine piece
    except ValueError as error:
        raise Wrong(str(error)) from None
    error = float(((network(case.data.states) - case.data.inputs) ** 2).mean())
    require(error <= MOST_LOSS, f"its mean squared error on the data is {error:.4f}; at most {MOST_LOSS} is allowed")
    print(f"ok: {network.binaries} binaries, mean squared error {error:.4f}")


def _cost(system: PWASystem, x0: Array, inputs: Array, Q: float = 1.0, R: float = 1.0) -> float:
    """Sum of Q x'x and R u'u along the nominal trajectory, inf where it leaves X or U."""
    total: float = 0.0
    x = x0
    for u in inputs:
        if (np.abs(u) > 1).any():
            return np.inf
        total += Q * x @ x + R * u @ u
        x = system.modes[int(system.violation(x[None], u[None])[0].argmin())].successor(x, u)
        if (np.abs(x) > 10 + 1e-9).any():
            return np.inf
    return float(total + Q * x @ x)


def _leaky(z: Array, u: Array, lower: float, upper: float, leak: float) -> float:
    """The formula of section 6 of the notebook, sample by sample."""
    total = 0.0
    for value, wanted in zip(z.ravel(), u.ravel()):
        kept = min(max(value, lower), upper)
        total += (kept + leak * (value - kept) - wanted) ** 2
    return total / z.size


def _first_input(system: PWASystem, x1: float) -> float:
    """u(0) of the optimal control problem at (x1, 5)."""
    inputs = solve_miqp(system, np.array([x1, 5.0])).inputs
    assert inputs is not None  # the problem is feasible there
    return float(inputs[0, 0])
