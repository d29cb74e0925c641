"""Checks of exercise 08: optimal plans, a small network, and extrapolation."""

from collections.abc import Callable
from typing import Any

import numpy as np

from ..learning.mpc.piecewise_affine import trajectory_cost
from ..studies.case_studies import case_study
from ..systems.network import MaxoutNetwork
from ..systems.nonlinear import NonlinearSystem
from ..systems.plants import double_integrator_plant
from ..typing import Array, ArrayLike
from .common import Wrong, require, require_array, require_filled, require_instance, require_number, text

START, TARGET = (5.5, -1.5), 52.0  # of task 3
MOST_BINARIES, LARGEST_ERROR = 20, 0.01  # of task 4
STATE_WEIGHT, INPUT_WEIGHT = 0.8, 0.1  # of case study 2's optimal control problem
TOL = 1e-9  # for numbers that differ by rounding only, relative to their size


def check_t1(lost: Any) -> None:
    """Task 1: lost(x, limit): whether no input |u| <= limit keeps f(x, u) in X, for every state.

    Parameters
    ----------
    lost : callable
        (N, 2), number -> (N,) of bool.

    Raises
    ------
    Wrong
        With a state that an input keeps in X, or one that none of 2001 inputs does.
    """
    plant, rng = double_integrator_plant(), np.random.default_rng()
    for limit in (2.0, *rng.uniform(0.2, 1.0, 2), rng.uniform(2.0, 4.0)):
        x, inputs = rng.uniform(-6, 6, (1500, 2)), np.linspace(-limit, limit, 2001)
        answer = require_array(lost(x, limit), (len(x),), "lost(x, limit)") > 0.5
        after = plant(x[:, None], np.broadcast_to(inputs[:, None], (len(x), len(inputs), 1)))
        excess = np.abs(after).max(axis=2) - 6
        least = excess.min(axis=1)
        kept, gone = np.flatnonzero(answer & (least <= 0)), np.flatnonzero(~answer & (least > 2 * limit / 1000))
        if len(kept):
            i = kept[0]
            u = inputs[excess[i].argmin()]
            raise Wrong(
                f"|u| <= {limit:.2f}: you call x = {text(x[i])} lost, but u = {u:.2f} leads to "
                f"{text(plant(x[i], [u]))}, which is in X ({len(kept)} such states of {len(x)})"
            )
        if len(gone):
            i = gone[0]
            after = plant(x[i], [inputs[excess[i].argmin()]])
            raise Wrong(
                f"|u| <= {limit:.2f}: you say that x = {text(x[i])} can be kept in X, but the best of 2001 inputs "
                f"leads to {text(after)} ({len(gone)} such states of {len(x)}); does one u keep both components in X?"
            )
    print("ok: two intervals for u decide which states are lost")


def check_t2(cost: Any) -> None:
    """Task 2: cost(x0, inputs) = J of case study 2, inf where a constraint is violated.

    Parameters
    ----------
    cost : callable
        (2,), (N,) -> number.

    Raises
    ------
    Wrong
        With the term that explains the difference, if one does.
    """
    plant, rng = double_integrator_plant(), np.random.default_rng()
    seen: set[str] = set()
    while seen < {"feasible", "state", "input"}:
        x0, inputs = rng.uniform(-4, 4, 2), rng.uniform(-2.1, 2.1, int(rng.integers(1, 7)))
        states = _rollout(plant, x0, inputs)
        kind = "input" if np.abs(inputs).max() > 2 else "state" if np.abs(states).max() > 6 else "feasible"
        seen.add(kind)
        _compare_cost(cost(x0, inputs), kind, states, inputs)
    print("ok: the cost, and inf for infeasible plans")


def check_t3(plan: Any) -> None:
    """Task 3: ten inputs from x(0) = (5.5, -1.5) that meet all constraints and cost at most 52.

    Parameters
    ----------
    plan : array (10,)

    Raises
    ------
    Wrong
        With the step at which a constraint is violated, or that costs most.
    """
    inputs = require_array(plan, (10,), "plan")
    late = np.flatnonzero(np.abs(inputs) > 2)
    require(not len(late), f"the input limit |u| <= 2 is violated at k = {late[:1]}")
    states = _rollout(double_integrator_plant(), START, inputs)
    outside = np.flatnonzero(np.abs(states).max(axis=1) > 6)
    require(not len(outside), f"the plan leaves X: x({outside[:1]}) = {text(states[outside[:1]])}")
    total, stages = _cost(states, inputs), STATE_WEIGHT * (states**2).sum(axis=1)
    k = 2 + int(stages[2:].argmax())
    require(
        total <= TARGET,
        f"the plan is allowed but costs {total:.2f}, more than {TARGET:g}; from k = 2 on, the largest share is "
        f"{stages[k]:.2f} at k = {k}, where x = {text(states[k])}",
    )
    print(f"ok: a plan that costs {total:.2f}")


def check_t4(small: Any) -> None:
    """Task 4: a network with at most 20 binaries and a mean squared error of at most 0.01 on the data.

    Parameters
    ----------
    small : MaxoutNetwork

    Raises
    ------
    Wrong
        With the number of binaries, an input outside U, or the error and where it is largest.
    """
    require_instance(small, MaxoutNetwork, "small (the `.network` of the result)")
    require(
        small.binaries <= MOST_BINARIES,
        f"the network has {small.binaries} binary variables, more than {MOST_BINARIES}: "
        + " + ".join(str(len(layer.bias)) for layer in small.hidden)
        + " (the saturation counts as well)",
    )
    data, rng = case_study("double_integrator").data, np.random.default_rng()
    states = rng.uniform(-6, 6, (5000, 2))
    largest = np.abs(small(states)).max()
    require(largest <= 2, f"the network gives inputs of up to {largest:.3f}, outside |u| <= 2: saturate it")
    error = np.abs(small(data.states) - data.inputs)[:, 0]
    mean = float((error**2).mean())
    require(
        mean <= LARGEST_ERROR,
        f"the mean squared error on the data is {mean:.4f}, more than {LARGEST_ERROR}; the worst error is "
        f"{error.max():.2f} at x = {text(data.states[error.argmax()])}: more steps? another seed?",
    )
    print(f"ok: {small.binaries} binary variables, mean squared error {mean:.4f}")


def check_t5(other: Any) -> None:
    """Task 5: a controller that agrees with the shipped network on the hull of the data, but not at (6, 6).

    Parameters
    ----------
    other : callable
        (N, 2) -> (N, 1).

    Raises
    ------
    Wrong
        With a state where it differs, is not continuous, or leaves U; or how little it differs at (6, 6).
    """
    case, rng = case_study("double_integrator"), np.random.default_rng()
    states, network = case.data.states, case.network
    triples = states[rng.integers(0, len(states), (2000, 3))]
    covered = np.vstack([states, np.einsum("ij,ijk->ik", rng.dirichlet(np.ones(3), 2000), triples)])
    gap = np.abs(_inputs(other, covered) - network(covered))[:, 0]
    require(
        gap.max() <= 1e-6,
        f"at x = {text(covered[gap.argmax()])}, a convex combination of data states, your input differs by "
        f"{gap.max():.2g} from the shipped network's",
    )
    anywhere = np.vstack([rng.uniform(-6, 6, (4000, 2)), [[6, 6]], rng.uniform(5, 6, (500, 2))])
    inputs = _inputs(other, anywhere)
    worst = int(np.abs(inputs).argmax())
    require(
        np.abs(inputs).max() <= 2 + 1e-9,
        f"at x = {text(anywhere[worst])} your input is {inputs[worst, 0]:.2f}, outside |u| <= 2",
    )
    corner = np.array([[6.0, 6.0]])
    difference = float(np.abs(_inputs(other, corner) - network(corner))[0, 0])
    require(
        difference >= 1, f"at (6, 6) your input differs from the shipped network's by {difference:.3g}, less than 1"
    )
    ends = anywhere[rng.integers(0, len(anywhere), (60, 2))]
    ends[:20, 0], ends[:20, 1] = states[rng.integers(0, len(states), 20)], corner[0]
    for a, b in ends:
        path = a + np.linspace(0, 1, 4001)[:, None] * (b - a)
        jumps, length = np.abs(np.diff(_inputs(other, path), axis=0)).ravel(), np.abs(b - a).max() / 4000
        k = int(jumps.argmax())
        require(
            jumps[k] <= 50 * length + 1e-9,
            f"your input jumps by {jumps[k]:.2g} within {length:.1g} at x = {text(path[k])}: it is not continuous",
        )
    print(f"ok: the data do not distinguish the two controllers, and at (6, 6) they differ by {difference:.1f}")


# -- parts --------------------------------------------------------------------------------------------


def _rollout(plant: NonlinearSystem, x0: ArrayLike, inputs: Array) -> Array:
    """States (N + 1, 2) of the plant under inputs (N,)."""
    states = [np.asarray(x0, float)]
    for u in inputs:
        states.append(plant(states[-1], [u]))
    return np.array(states)


def _cost(states: Array, inputs: Array) -> float:
    """J of case study 2."""
    Q = STATE_WEIGHT * np.eye(2)
    return trajectory_cost(states, inputs[:, None], Q, INPUT_WEIGHT * np.eye(1), Q)


def _compare_cost(answer: Any, kind: str, states: Array, inputs: Array) -> None:
    """Raise `Wrong` unless the answer is J of a feasible plan, or inf for one that is not."""
    require_filled(answer, "cost(x0, inputs)")
    if isinstance(answer, float) and answer == np.inf:
        require(kind != "feasible", _feasible_hint(states, inputs))
        return
    J = require_number(answer, "cost(x0, inputs)")
    case = f"x0 = {text(states[0])}, {len(inputs)} input(s)"
    if kind != "feasible":
        limit = "|x|_inf <= 6" if kind == "state" else "|u| <= 2"
        worst = np.abs(states if kind == "state" else inputs).max()
        raise Wrong(f"{case}: you return {J:.3f}, but the plan reaches {worst:.2f} and violates {limit}; return np.inf")
    truth = _cost(states, inputs)
    terms = {
        "the terminal cost 0.8 x(N)'x(N) is missing": -STATE_WEIGHT * (states[-1] ** 2).sum(),
        "the cost of x(0) is missing": -STATE_WEIGHT * (states[0] ** 2).sum(),
        "the cost of the inputs is missing": -INPUT_WEIGHT * (inputs**2).sum(),
        "the terminal cost counts twice": STATE_WEIGHT * (states[-1] ** 2).sum(),
    }
    size = TOL * (1 + abs(truth))
    matching = [name for name, term in terms.items() if abs(J - truth - term) <= size]
    hint = f"{case}: your J is off by {abs(J - truth):.3g}"
    require(
        abs(J - truth) <= size,
        f"{hint}: {matching[0]}" if matching else f"{hint}; compare weights, states and inputs one by one",
    )


def _feasible_hint(states: Array, inputs: Array) -> str:
    """The message where inf is returned for a feasible plan."""
    return (
        f"x0 = {text(states[0])}, {len(inputs)} input(s): you return inf, but |x|_inf reaches only "
        f"{np.abs(states).max():.2f} and |u| only {np.abs(inputs).max():.2f}"
    )


def _inputs(other: Callable[[Array], Any], states: Array) -> Array:
    """The inputs of a controller at states (N, 2), as an array (N, 1)."""
    return require_array(other(states), (len(states), 1), "other(x)")
