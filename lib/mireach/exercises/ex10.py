"""Checks of exercise 10: the maximal safe set, backwards from the lost states."""

from typing import Any

import numpy as np

from ..analysis.disturbance import largest_disturbance
from ..analysis.maximal_set import carried_out, maximal_safe_set
from ..sets.polytope import Polytope
from ..sets.region import Region
from ..studies.case_studies import case_study
from ..systems.loop import ClosedLoop
from ..systems.network import MaxoutNetwork
from ..systems.pwa import Mode, PWASystem
from .common import (
    Wrong,
    require,
    require_array,
    require_instance,
    require_number,
    require_pair,
    require_whole,
    text,
    with_bound,
)

ROUNDING = 1e-9  # of states that are computed twice (units of x)
SHARE = 1e-5  # areas may differ by this share of X
ACCURACY = 1e-3  # of task 4, in units of d


def spiral() -> ClosedLoop:
    """The loop of task 4: x+ = 0.8 (x rotated by 50 degrees) + d on |x|_inf <= 1."""
    angle = np.deg2rad(50)
    A = 0.8 * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    X, U = Polytope.box([-1, -1], [1, 1]), Polytope.box([-1], [1])
    mode = Mode(A, np.zeros((2, 1)), np.zeros(2), X.product(U))
    return ClosedLoop(PWASystem((mode,), X, U), MaxoutNetwork((), np.zeros((1, 2)), np.zeros(1)))


def check_t1(lost_in_cell: Any) -> None:
    """Task 1: lost_in_cell(C, M, c, D, T) is {x in C : M x + c + d in T for some d in D} for boxes C, D and T.

    Parameters
    ----------
    lost_in_cell : callable
        Polytope, (2, 2), (2,), Polytope, Polytope -> Polytope.

    Raises
    ------
    Wrong
        With a state that is wrongly in the set or wrongly not, and the images that show it.
    """
    rng = np.random.default_rng()
    for trial in range(12):
        M, c = rng.normal(size=(2, 2)), rng.normal(size=2)
        if trial % 3 == 1:
            M = np.outer(rng.normal(size=2), rng.normal(size=2))  # images are segments: there is no inverse
        middle, half_width = 0.2 * rng.normal(size=2), rng.uniform(0.05, 0.4, 2)
        C, D = Polytope.box([-1, -1], [1, 1]), Polytope.box(middle - half_width, middle + half_width)
        target = M @ rng.uniform(-1, 1, 2) + c + rng.normal(size=2) * 0.3
        T = Polytope.box(target - rng.uniform(0.1, 0.5, 2), target + rng.uniform(0.1, 0.5, 2))
        answer = lost_in_cell(C, M, c, D, T)
        require_instance(answer, Polytope, "lost_in_cell(C, M, c, D, T)")
        x = rng.uniform(-1.2, 1.2, (400, 2))
        image = x @ M.T + c
        low, high = image + middle - half_width, image + middle + half_width
        (left, bottom), (right, top) = T.bounding_box()
        gap = np.max([left - high[:, 0], low[:, 0] - right, bottom - high[:, 1], low[:, 1] - top], axis=0)
        inside, said = C.contains(x), answer.contains(x)
        title = "M is singular: " if trial % 3 == 1 else ""
        for i in np.flatnonzero(np.abs(gap) > ROUNDING):
            where = f"{title}x = {text(x[i])}, M x + c = {text(image[i])}, D = {_box(D)}, T = {_box(T)}"
            require(inside[i] or not said[i], f"{title}x = {text(x[i])} is in your set, but not in the cell C")
            require(
                not (said[i] and gap[i] > 0), f"{where}: no d leads into T, it misses by {gap[i]:.2g}; x is not lost"
            )
            require(said[i] or not inside[i] or gap[i] > 0, f"{where}: some d leads into T, so x is lost")
    print("ok: the preimage of an enlarged set, without any inverse")


def check_t2(shrink: Any) -> None:
    """Task 2: shrink(loop) is the maximal safe set as a Region, and the number of steps.

    Parameters
    ----------
    shrink : callable
        ClosedLoop -> (Region, int).

    Raises
    ------
    Wrong
        With a state that can still leave, or a safe state that was removed.
    """
    rng = np.random.default_rng()
    for name, low, high in (("double_integrator", 0.0, 0.2), ("pwa", 0.05, 1.0), ("double_integrator", 0.1, 0.3)):
        bound = rng.uniform(low, high)
        loop = with_bound(case_study(name).loop, bound)
        S, steps = require_pair(shrink(loop), "shrink(loop)", "of a Region and a number")
        require_instance(S, Region, "the first part of shrink(loop)")
        title = f"{name}, |d| <= {bound:.3f}"
        truth, X = maximal_safe_set(loop, prove=False), Region.of(loop.system.state_set)
        extra, lacking = S - truth.outer, truth.set - S
        if extra.area > SHARE * X.area:
            x = extra.shape.representative_point().coords[0]
            more = carried_out(loop, S)
            leaves = "can be driven out of X within some steps"
            if (more & S).area > SHARE * X.area:
                x = (more & S).shape.representative_point().coords[0]
                leaves = "can be carried out of your set in one step"
            raise Wrong(f"{title}: your set is too large: x = {text(x)} {leaves}")
        if lacking.area > SHARE * X.area:
            x = lacking.shape.representative_point().coords[0]
            raise Wrong(f"{title}: your set is too small: x = {text(x)} stays in the maximal set forever")
        assert truth.set is not None  # every case of this task has a maximal set
        k = require_whole(steps, "the number of steps", 0)
        near = [j for j, S_j in enumerate(truth.history) if S_j.area - truth.set.area < SHARE * X.area]
        require(
            near[0] <= k <= truth.iterations + 1,
            f"{title}: you count {k} steps, but S_{truth.iterations} is the last that differs from the one before",
        )
    print("ok: the maximal safe set, backwards")


def check_t3(start: Any, disturbances: Any) -> None:
    """Task 3: a state of the double integrator that no single step can drive out of X, and disturbances that do.

    Parameters
    ----------
    start : array (2,)
    disturbances : array (k, 2)
        With k >= 2.

    Raises
    ------
    Wrong
        With the step at which the claim fails.
    """
    x, d = require_array(start, (2,), "start"), require_array(disturbances, (None, 2), "disturbances")
    case = case_study("double_integrator")
    X, bound = case.system.state_set, case.disturbance_bound
    require(X.contains(x), f"start = {text(x)} lies outside X")
    require(len(d) >= 2, f"disturbances has {len(d)} row; from a state that no single step drives out, it takes two")
    worst = int(np.abs(d).max(axis=1).argmax())
    require(
        np.abs(d).max() <= bound + ROUNDING,
        f"disturbance {worst + 1}, {text(d[worst])}, is larger than {bound} in the max norm",
    )
    require(
        not carried_out(case.loop, X).contains(x),
        f"from start = {text(x)} a single step can lead out of X already; look among the states that are lost later",
    )
    path = case.loop.simulate(x, len(d), d)
    outside = ~X.contains(np.nan_to_num(path, nan=99.0), ROUNDING)
    require(outside.any(), f"from start = {text(x)} the trajectory ends at {text(path[-1])}, inside X")
    print(f"ok: out of X after {int(outside.argmax())} steps")


def check_t4(largest: Any) -> None:
    """Task 4: the largest bound on |d|_inf for which `spiral()` has a safe set, to within 0.001.

    Parameters
    ----------
    largest : float

    Raises
    ------
    Wrong
        With the maximal safe set at that bound, or a little above it.
    """
    bound = require_number(largest, "largest")
    require(bound >= 0, f"largest = {bound:g} is negative; a bound on |d| is at least 0")
    truth = largest_disturbance(spiral(), accuracy=ACCURACY / 10)
    require(
        bound <= truth.above + ACCURACY,
        f"largest = {bound:.4f} is too large: every state of X can be driven out with that bound",
    )
    require(
        bound >= truth.bound - ACCURACY,
        f"largest = {bound:.4f} is not the largest: with {bound + ACCURACY:.4f} there is still a safe set",
    )
    print("ok: beyond that bound nothing is safe")


# -- parts --------------------------------------------------------------------------------------------


def _box(P: Polytope) -> str:
    """A box for messages."""
    lower, upper = P.bounding_box()
    return f"{text(lower)} to {text(upper)}"
