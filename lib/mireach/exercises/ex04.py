"""Checks of exercise 04: disturbances and one-step sets."""

from functools import lru_cache
from typing import Any

import numpy as np

from ..analysis.reach import outer_step, support
from ..analysis.rpi import RPICheck, check_rpi
from ..engines.cvxpy_model import model
from ..sets.polytope import Polytope
from ..sets.templates import box_directions
from ..studies.case_studies import case_study
from ..systems.loop import ClosedLoop
from ..systems.network import MaxoutNetwork
from ..systems.plants import chessboard, pwa_plant
from ..systems.pwa import Mode, PWASystem
from ..typing import Array
from .common import Wrong, random_network, require, require_array, require_number, text, with_bound

TOL = 1e-7  # for numbers that differ by rounding only; all data here are of size 10
LEAVES = 1e-6  # a witness has to leave a set by at least this
NEAR = 1e-3  # accuracy required of the largest disturbance bound
REFUTE = Polytope.box([-7.6, -10], [9.5, 8.6])  # the set of task 3
KEEP = Polytope.box([-7.4, -10], [9.5, 9])  # the set of task 4
START = Polytope.box([-6, -9], [8, 3])  # the set of task 6
BETTER = 0.01  # in task 5, by which the bound of another set may be larger
SHARE = 0.75  # of the box's area, to be reached in task 6


def check_t1(binaries: Any) -> None:
    """Task 1: binaries(loop, k) = number of binary variables of the MILP of Lemma 2, on random loops.

    Parameters
    ----------
    binaries : callable
        ClosedLoop, int -> int.

    Raises
    ------
    Wrong
        With the modes, the layers and k of a loop, and by how many the answer is off.
    """
    rng = np.random.default_rng()
    for side, steps in ((1, 1), (2, 1), (1, 3), (3, 2)):
        loop = ClosedLoop(_random_system(rng, side), _saturated_network(rng))
        answer = require_number(binaries(loop, steps), "binaries(loop, k)")
        problem, *_ = model(loop, loop.system.state_set, steps)
        truth = sum(variable.size for variable in problem.variables() if variable.attributes["boolean"])
        layers = ", ".join(f"{layer.width} neurons with {layer.pool} channels" for layer in loop.network.hidden)
        require(
            answer == truth,
            f"for s = {side**2} modes, layers of {layers}, and k = {steps} you return {answer:g}; "
            f"the model has {abs(truth - answer):g} binary variables {'more' if truth > answer else 'fewer'}",
        )
    print("ok: the binary variables of Lemma 2's MILP")


def check_t2(support_of_step: Any) -> None:
    """Task 2: support_of_step(system, x, u, C) = h of the successors of one state along C, boundaries included.

    Parameters
    ----------
    support_of_step : callable
        PWASystem, (2,), (1,), (l, 2) -> (l,).

    Raises
    ------
    Wrong
        With the state and, where the answer is too small, a mode and a disturbance that give a larger value.
    """
    rng = np.random.default_rng()
    for kind in ("inside", "inside", "inside", "edge", "edge", "corner"):
        system = pwa_plant().with_disturbance([_random_disturbance(rng) for _ in range(4)])
        x, u = rng.uniform(-9, 9, 2).round(2), rng.uniform(-1, 1, 1).round(2)
        x = {"inside": x, "edge": x * rng.permutation([0, 1]), "corner": 0 * x}[kind]
        C = rng.normal(size=(6, 2))
        h = require_array(
            support_of_step(system, x.copy(), u.copy(), C.copy()), (6,), "support_of_step(system, x, u, C)"
        )
        constant = MaxoutNetwork((), np.zeros((1, 2)), u)
        truth = support(ClosedLoop(system, constant), Polytope.box(x, x), C)
        i = int(np.argmax(np.abs(h - truth.value)))
        witness = truth.witness[i]
        assert witness is not None  # a point has a successor along every direction
        case = f"at x = {text(x)}, u = {u[0]:g}, along v = {text(C[i])} you return {h[i]:.4f}"
        require(
            h[i] >= truth.value[i] - TOL,
            f"{case}, but mode {witness.modes[0] + 1} with d = {text(witness.disturbances[0])} "
            f"leads to v x+ = {truth.value[i]:.4f}",
        )
        require(h[i] <= truth.value[i] + TOL, f"{case}, which no mode whose region contains (x, u) attains")
    print("ok: one step from one state, on boundaries too")


def check_t3(state: Any, disturbance: Any) -> None:
    """Task 3: a state of F and a disturbance of D whose successor under the shipped network leaves F.

    Parameters
    ----------
    state, disturbance : array (2,)

    Raises
    ------
    Wrong
        If the state is not in F, the disturbance not in D, or the successor still in F; with numbers.
    """
    x = require_array(state, (2,), "state")
    d = require_array(disturbance, (2,), "disturbance")
    loop = _shipped_loop()
    _require_inside(REFUTE, x, "state", "F")
    after = []
    u = loop.network(x)
    for i in np.flatnonzero(loop.system.violation(x[None], u[None])[0] <= TOL):
        mode = loop.system.modes[i]
        _require_inside(mode.disturbance, d, "disturbance", f"D^({i + 1})")
        after.append(mode.successor(x, u, d))
    excess = np.array(after) @ REFUTE.H.T - REFUTE.h
    best = np.unravel_index(np.argmax(excess), excess.shape)
    require(
        excess[best] > LEAVES,
        f"x+ = {text(after[best[0]])} is still in F; {-excess[best]:.4f} is left to the nearest facet, "
        f"which has the normal {text(REFUTE.H[best[1]])}",
    )
    print(f"ok: x+ = {text(after[best[0]])} is outside F by {excess[best]:.4f}, so F is not RPI")


def check_t4(beta: Any) -> None:
    """Task 4: the largest beta for which F is RPI under |d|_inf <= beta.

    Parameters
    ----------
    beta : float

    Raises
    ------
    Wrong
        If F is not RPI slightly below beta (with a step that leaves it), or still is slightly above.
    """
    beta = require_number(beta, "beta")
    require(beta >= NEAR, f"beta = {beta:g} is no disturbance bound for which F is RPI; it has to be positive")
    _require_rpi(KEEP, beta - NEAR)
    require(
        _check(KEEP, beta + NEAR).verdict != "proven",
        f"F is still RPI for |d| <= {beta + NEAR:.4f}, so beta = {beta:.4f} is not the largest bound",
    )
    print(f"ok: F is RPI for disturbances up to {beta:.3f}, and for no larger bound")


def check_t5(a: Any, beta: Any) -> None:
    """Task 5: the a for which [-a, 9.5] x [-10, 9] is RPI under the largest disturbances, and their bound beta.

    Parameters
    ----------
    a, beta : float

    Raises
    ------
    Wrong
        If that set is not RPI for beta, or another a allows disturbances that are clearly larger.
    """
    a, beta = require_number(a, "a"), require_number(beta, "beta")
    require(0 < a <= 10, f"a = {a:g} gives no box within X; a has to lie between 0 and 10")
    require(beta >= 0, f"beta = {beta:g} is negative; a bound on |d| is at least 0")
    _require_rpi(_left(a), beta)
    better = [other for other in np.linspace(6, 10, 201) if _check(_left(other), beta + BETTER).verdict == "proven"]
    if better:
        nearest = min(better, key=lambda other: abs(other - a))
        where = (
            "already with your a" if abs(nearest - a) <= 0.02 else f"with a {'larger' if nearest > a else 'smaller'} a"
        )
        raise Wrong(f"your set is RPI for |d| <= {beta:.4f}, but {where} the bound may be larger by {BETTER}")
    print(f"ok: a = {a:.3f} tolerates disturbances up to {beta:.3f}; no other a tolerates {BETTER} more")


def check_t6(C: Any) -> None:
    """Task 6: four directions whose outer approximation of R_1(G) has at most 3/4 of the box's area.

    Parameters
    ----------
    C : array (4, 2)

    Raises
    ------
    Wrong
        If the set is unbounded, or too large, with both areas.
    """
    C = require_array(C, (4, 2), "C")
    require((np.linalg.norm(C, axis=1) > 1e-6).all(), "C has a row of zeros, which is no direction")
    loop = _shipped_loop()
    outer = outer_step(loop, START, C)
    require(outer.is_bounded, "the set of your template is unbounded; choose rows that bound it on all sides")
    box, area = (R.area for R in (outer_step(loop, START, box_directions(2)), outer))
    require(area <= SHARE * box, f"your set has {area:.1f} of area, which is {area / box:.2f} of the box's {box:.1f}")
    print(f"ok: four directions, area {area:.1f} instead of {box:.1f}")


def _left(a: float) -> Polytope:
    """The set of task 5."""
    return Polytope.box([-a, -10], [9.5, 9])


@lru_cache
def _shipped_loop() -> ClosedLoop:
    """The loop of the first case study."""
    return case_study("pwa").loop


def _check(F: Polytope, beta: float) -> RPICheck:
    """check_rpi of the case study's loop under |d|_inf <= beta."""
    return check_rpi(_under(beta), F)


@lru_cache
def _under(beta: float) -> ClosedLoop:
    """The loop under |d|_inf <= beta."""
    return with_bound(_shipped_loop(), beta)


def _require_rpi(F: Polytope, beta: float) -> None:
    """Raise Wrong, with a step that leaves F, unless F is RPI under |d|_inf <= beta."""
    check = _check(F, beta)
    if check.verdict != "proven":
        raise Wrong(f"for |d| <= {beta:.4f} the set is not RPI: {check.reason}")


def _require_inside(P: Polytope, point: Array, name: str, symbol: str) -> None:
    """Raise Wrong unless a point lies in P."""
    excess = P.H @ point - P.h
    i = int(np.argmax(excess))
    require(
        excess[i] <= 1e-9,
        f"{name} = {text(point)} is not in {symbol}: its row {text(P.H[i])} gives {P.H[i] @ point:.4f}, "
        f"but at most {P.h[i]:.4f} is allowed",
    )


def _random_system(rng: np.random.Generator, side: int) -> PWASystem:
    """side^2 modes on a chessboard, with random dynamics and a random disturbance each."""
    X, U = Polytope.box([-2, -2], [2, 2]), Polytope.box([-1], [1])
    return PWASystem(
        tuple(
            Mode(rng.normal(size=(2, 2)), rng.normal(size=(2, 1)), rng.normal(size=2), region, _random_disturbance(rng))
            for region in chessboard(X, U, side)
        ),
        X,
        U,
    )


def _saturated_network(rng: np.random.Generator) -> MaxoutNetwork:
    """A maxout network whose layers differ in size, saturated to [-1, 1]."""
    layers = [(int(width), int(pool)) for width, pool in rng.integers(2, 5, (rng.integers(1, 3), 2))]
    return random_network(rng, layers).saturate(-1, 1)


def _random_disturbance(rng: np.random.Generator) -> Polytope:
    """A box, a segment or a point, not centred."""
    centre, half_width = rng.uniform(-0.5, 0.5, 2), rng.uniform(0.2, 2, 2)
    kind = rng.integers(3)
    if kind == 0:
        return Polytope.box(centre - half_width, centre + half_width)
    return Polytope.from_points(np.array([centre - half_width, centre + half_width]) if kind == 1 else centre[None])
