"""Checks of exercise 06: safe and terminal sets of the four-mode loop."""

from typing import Any

import numpy as np

from ..analysis.reach import support
from ..analysis.rpi import check_rpi
from ..analysis.safe_set import safe_set
from ..sets.polytope import Polytope
from ..sets.templates import box_directions, directions
from ..studies.case_studies import case_study
from ..systems.loop import ClosedLoop
from ..systems.plants import pwa_plant
from ..systems.pwa import PWASystem
from .common import (
    random_network,
    require,
    require_array,
    require_close,
    require_instance,
    require_number,
    require_pair,
    text,
    with_bound,
)

ACCURACY = 1e-4  # of a largest disturbance bound, in units of x
ROWS, ROUGH = 5, 0.5  # task 4: rows of a template, and the disturbance bound that it must tolerate
APART, FUTURES = (
    4.0,
    6,
)  # task 6: distance of the ends of two trajectories (units of x), and the largest number of steps
INSIDE = 1e-9  # for rounding of states and disturbances
STEPS = 100  # iterations after which a check stops looking for a safe set


def check_t1(top: Any, bottom: Any) -> None:
    """Task 1: top(limit, bound) and bottom(limit, bound), the largest and smallest x2 of R_1(X) under any controller.

    Parameters
    ----------
    top, bottom : callable
        float, float -> number.

    Raises
    ------
    Wrong
        With a limit, a bound, and by how much an answer is off for a random network.
    """
    rng = np.random.default_rng()
    for _ in range(4):
        limit, bound = rng.uniform(3, 12), rng.uniform(0, 1)
        loop = _random_loop(rng, limit, bound)
        true_top, minus_bottom = support(loop, loop.system.state_set, [[0, 1], [0, -1]]).value
        case = f"(limit = {limit:.3f}, bound = {bound:.3f})"
        require_close(top(limit, bound), true_top, f"top{case}", 1e-6)
        require_close(bottom(limit, bound), -minus_bottom, f"bottom{case}", 1e-6)
    print("ok: top and bottom of R1(X), whatever the network")


def check_t2(find_safe_set: Any) -> None:
    """Task 2: find_safe_set(loop, C, most) = (F_max, k) of Prop. 3, Fmax, or (None, None).

    Parameters
    ----------
    find_safe_set : callable
        ClosedLoop, (l, n), int -> (Polytope or None, int or None).

    Raises
    ------
    Wrong
        If a set is not RPI or not F_max, if k is not its index, or if a set is returned where there is none, or None
        where there is one.
    """
    rng = np.random.default_rng()
    integrator = case_study("double_integrator")
    cases = [
        (disturbed_loop(rng.uniform(0.02, 0.18)), box_directions(2)),
        (disturbed_loop(rng.uniform(0.3, 0.6)), directions(8)),
        (disturbed_loop(rng.uniform(0.3, 0.6)), box_directions(2)),
        (integrator.loop, integrator.directions),
    ]
    for loop, C in cases:
        answer = find_safe_set(loop, C, STEPS)
        F, k = require_pair(answer, "find_safe_set", "(set, k) or (None, None)")
        true = safe_set(loop, C, max_iterations=STEPS)
        case = f"with {len(loop.system.modes)} modes, {len(C)} directions and {_size(loop):.3f} of disturbance"
        if true.set is None:
            require(F is None, f"{case} you return a set, but there is none: {true.reason}")
            continue
        require(F is not None, f"{case} you find no set, but F{true.iterations} is RPI")
        require_instance(F, Polytope, "the set")
        check = check_rpi(loop, F, tol=INSIDE)
        require(check.verdict == "proven", f"{case} your set is not RPI: {check.reason}")
        gap = np.abs(F.support(C) - true.set.support(C)).max()
        require(
            gap < 1e-6,
            f"{case} your set is RPI, but not F_k of eq. (21), Fk: it differs by {gap:.3g} along a direction",
        )
        require(k == true.iterations, f"{case} your set is right, but its number is not {k}; F_0 = X has number 0")
    print("ok: Prop. 3, Fmax, and None where no set is found")


def check_t3(largest_bound: Any) -> None:
    """Task 3: the largest b for which boxes find a safe set under |d|_inf <= b, to within `ACCURACY`.

    Parameters
    ----------
    largest_bound : float

    Raises
    ------
    Wrong
        If no safe set is found just below, or one just above.
    """
    b = require_number(largest_bound, "largest_bound")
    require(b > ACCURACY, f"a disturbance bound is positive; largest_bound = {b:g}")
    below, above = (safe_set(disturbed_loop(b + sign * ACCURACY), box_directions(2)) for sign in (-1, 1))
    require(below.set is not None, f"largest_bound = {b:.6g} is too large: just below it, {below.reason}")
    require(above.set is None, f"largest_bound = {b:.6g} is too small: at {b + ACCURACY:.6g} there still is a safe set")
    print(f"ok: boxes find a safe set up to |d| <= {b:.4f}, and none from {b + ACCURACY:.4f} on")


def check_t4(C: Any) -> None:
    """Task 4: a template of at most `ROWS` rows with which a safe set is found for |d|_inf <= `ROUGH`.

    Parameters
    ----------
    C : array (l, 2)

    Raises
    ------
    Wrong
        If C has too many rows, does not bound a set, or finds no safe set.
    """
    C = require_array(C, (None, 2), "C")
    require(0 < len(C) <= ROWS, f"C has {len(C)} rows, but may have at most {ROWS}")
    require((np.linalg.norm(C, axis=1) > 0).all(), "C has a row of zeros, which is no direction")
    require(Polytope(C, np.ones(len(C))).is_bounded, "sets {x : C x <= h} are unbounded with this C; a side is missing")
    loop = disturbed_loop(ROUGH)
    found = safe_set(loop, C, max_iterations=STEPS)
    require(found.set is not None, f"no safe set with this C: {found.reason}")
    print(f"ok: {len(C)} rows, and a safe set after {found.iterations} iteration(s)")


def check_t5(growth: Any) -> None:
    """Task 5: growth(before, after), the largest alpha with alpha * after in before.

    Parameters
    ----------
    growth : callable
        Polytope, Polytope -> number; both sets have the origin inside.

    Raises
    ------
    Wrong
        If alpha * after leaves `before`, or a larger alpha would do.
    """
    rng = np.random.default_rng()
    for trial in range(6):
        after = Polytope.from_points(rng.uniform(0.4, 1, 7)[:, None] * directions(7))
        H = directions(int(rng.integers(4, 9)))
        loose = Polytope(after.H, after.h * rng.choice([1.0, 1.5], len(after.h)))
        idle = H if trial % 2 == 0 else rng.normal(size=(3, 2))  # rows of `before`, or of neither
        after = Polytope(np.vstack([after.H, idle]), np.concatenate([after.h, loose.support(idle) + 0.3]))
        before = Polytope(H, after.support(H) * rng.uniform(0.9, 1.4, len(H)))
        alpha = require_number(growth(before, after), "growth(before, after)")
        require(alpha > 0, f"growth returns {alpha:g}, but alpha must be positive")
        excess = (after.scale(alpha).support(H) - before.h).max()
        require(
            excess <= 1e-7, f"growth returns alpha = {alpha:.6f}, but alpha * after leaves `before` by {excess:.3g}"
        )
        excess = (after.scale(alpha * (1 + 1e-6)).support(H) - before.h).max()
        require(excess > 0, f"growth returns alpha = {alpha:.6f}, but a larger alpha is possible as well")
    print("ok: the largest alpha of eq. (26), StabCondFmin, below 1 where a set has grown")


def check_t6(x0: Any, first: Any, second: Any) -> None:
    """Task 6: two disturbance sequences from one state of F_max that end at least `APART` from each other.

    Parameters
    ----------
    x0 : array (2,)
    first, second : array (steps, 2)
        At most `FUTURES` steps.

    Raises
    ------
    Wrong
        If x0 is not in F_max, a disturbance is too large, or the trajectories end too close to each other.
    """
    case = case_study("pwa")
    F = safe_set(case.loop, case.safe_directions).set
    assert F is not None  # the case study has a safe set
    x0 = require_array(x0, (2,), "x0")
    first, second = require_array(first, (None, 2), "first"), require_array(second, (None, 2), "second")
    require(F.contains(x0, tol=INSIDE), f"x0 = {text(x0)} is not in F_max")
    require(len(first) == len(second), f"both sequences need the same number of steps; got {len(first)}, {len(second)}")
    require(1 <= len(first) <= FUTURES, f"between 1 and {FUTURES} steps are allowed; got {len(first)}")
    for name, d in (("first", first), ("second", second)):
        worst = np.abs(d).max()
        require(
            worst <= case.disturbance_bound + INSIDE,
            f"{name} contains a disturbance of size {worst:.4g}, beyond {case.disturbance_bound}",
        )
    ends = [case.loop.simulate(x0, len(d), d)[-1] for d in (first, second)]
    distance = float(np.abs(ends[0] - ends[1]).max())
    require(distance >= APART, f"the ends are only {distance:.3f} apart (largest coordinate); {APART:g} are needed")
    print(f"ok: after {len(first)} steps the two trajectories are {distance:.2f} apart")


def disturbed_loop(bound: float) -> ClosedLoop:
    """The shipped four-mode loop with |d|_inf <= bound."""
    return with_bound(case_study("pwa").loop, bound)


def _random_loop(rng: np.random.Generator, limit: float, bound: float) -> ClosedLoop:
    """The four modes on |x|_inf <= limit with a random network."""
    plant = pwa_plant(bound)
    X = Polytope.box([-limit, -limit], [limit, limit])
    network = random_network(rng, [(3, 2)]).saturate([-1.0], [1.0])
    return ClosedLoop(PWASystem(plant.modes, X, plant.input_set), network)


def _size(loop: ClosedLoop) -> float:
    """Largest entry of a disturbance."""
    return max(float(np.abs(mode.disturbance.vertices()).max()) for mode in loop.system.modes)
