"""Checks of exercise 03: a piecewise-affine system as mixed-integer constraints."""

from typing import Any

import numpy as np

from ..sets.polytope import Polytope
from ..systems.plants import pwa_plant
from ..systems.pwa import Mode, PWASystem
from ..typing import Array
from .common import (
    Wrong,
    require,
    require_array,
    require_filled,
    require_number,
    require_pair,
    require_whole,
    text,
)

TOL = 1e-9  # for numbers that differ by rounding only
SOLVER_TOL = 1e-5  # accuracy of the MILPs of task 2, in units of x
POINTS = ((3.0, 2.0), (0.0, 5.0), (4.0, 0.0), (0.0, 0.0))  # of task 1
FRICTION = {"gain": 0.5, "loss": 0.1}  # of task 5


def claim() -> tuple[PWASystem, Polytope, Polytope]:
    """The four-mode plant without disturbance, a set F, and the set G that task 3 shows to be too small.

    Returns
    -------
    system : PWASystem
    F, G : Polytope
        G is the image of F under mode 1 for all u in U.
    """
    system, F = pwa_plant(disturbance_bound=0.0), Polytope.box([2, 0], [6, 4])
    mode, corners = system.modes[0], F.vertices()
    ends = [mode.successor(corners, np.full((len(corners), 1), u)) for u in (-1.0, 1.0)]
    return system, F, Polytope.from_points(np.vstack(ends))


def friction(x: Any, u: Any) -> Any:
    """The next velocity of the mass of task 5: v = x + 0.5 u loses 0.1 by friction, or comes to rest."""
    v = x + FRICTION["gain"] * u
    return np.sign(v) * np.maximum(np.abs(v) - FRICTION["loss"], 0.0) + 0.0  # no -0


def check_t1(counts: Any) -> None:
    """Task 1: for each of four states (u = 0.5), the number of possible gamma and of different successors.

    Parameters
    ----------
    counts : array (4, 2)

    Raises
    ------
    Wrong
        Naming the state, and which of its two numbers is off.
    """
    require_filled(counts, "counts")
    require(not any(row is None or None in np.ravel(row) for row in counts), "counts is not filled in yet")
    counts = require_array(counts, (4, 2), "counts")
    system, u = pwa_plant(disturbance_bound=0.0), np.array([0.5])
    for point, (gammas, successors) in zip(POINTS, counts):
        found = _successors(system, np.array(point), u)
        require(
            gammas == len(found),
            f"x = {point}: you count {gammas:g} possible gamma. Go through the regions, one by one: they are closed, "
            "and each region that contains the point counts",
        )
        different = len(np.unique(np.round(list(found.values()), 9), axis=0))
        require(
            successors == different,
            f"x = {point}: {gammas:g} gamma are right, but they do not give {successors:g} different successors; "
            "compute A x + B u for each",
        )
    print("ok: more choices do not always mean more successors")


def check_t2(step_model: Any) -> None:
    """Task 2: step_model(system, xi, XU) = (x+, constraints), on random systems, at random and at boundary points.

    Parameters
    ----------
    step_model : callable
        PWASystem, cvxpy.Variable (n + m,), Polytope -> cvxpy expression (n,), list of constraints.

    Raises
    ------
    Wrong
        With a point (x, u) at which the model has no solution, or a solution that differs from the successors by the
        modes that contain it.
    """
    import cvxpy as cp

    rng = np.random.default_rng()
    for n, shift in ((1, 0.0), (2, 0.0), (2, 4.0), (2, 400.0)):  # the last: beyond any round number
        system, normal, level = _random_system(rng, n, shift)
        XU = system.state_set.product(system.input_set)
        xi = cp.Variable(n + 1)
        at = cp.Parameter(n + 1)
        v = cp.Parameter(n)
        answer = step_model(system, xi, XU)
        after, constraints = require_pair(answer, "step_model(system, xi, XU)", "(x+, constraints)")
        require_filled(after, "x+")
        require(getattr(after, "shape", None) == (n,), f"x+ must be a cvxpy expression of shape ({n},)")
        problem = cp.Problem(cp.Maximize(v @ after), [*constraints, xi == at])
        corners = XU.vertices()
        on_boundary = XU.sample(rng, 200)
        on_boundary -= np.outer((on_boundary @ normal - level) / (normal @ normal), normal)
        on_boundary = on_boundary[XU.contains(on_boundary)][:2]
        for point in np.vstack([corners[rng.choice(len(corners), 3)], XU.sample(rng, 2), on_boundary]):
            at.value, w = point, rng.choice([-1.0, 1.0], n) * rng.uniform(0.5, 1.5, n)
            for v.value in (w, -w):
                _compare(problem, v, point, _successors(system, point[:n], point[n:], tol=1e-7))
    print("ok: your model describes f_PWA, also on the boundaries")


def check_t3(witness: Any) -> None:
    """Task 3: a state of F, an input and a mode whose successor lies outside G.

    Parameters
    ----------
    witness : (x (2,), u, mode)
        mode counted from 1.

    Raises
    ------
    Wrong
        If the witness, replayed, refutes nothing; the message says which condition fails.
    """
    require_filled(witness, "witness")
    require(len(witness) == 3, "witness must be (x, u, mode)")
    for part, name in zip(witness, ("x", "u", "mode")):
        require_filled(part, name)
    system, F, G = claim()
    x, u = require_array(witness[0], (2,), "x"), require_array(np.atleast_1d(witness[1]), (1,), "u")
    mode = require_whole(witness[2], "mode", 1, len(system.modes))
    require(F.contains(x, tol=TOL), f"x = {text(x)} is not in F")
    require(system.input_set.contains(u, tol=TOL), f"u = {u[0]:g} is not in U")
    outside = system.violation(x[None], u[None])[0, mode - 1]
    require(
        outside <= TOL,
        f"mode {mode} does not act at x = {text(x)}: a row of its region is violated by {outside:.3g}",
    )
    after = system.modes[mode - 1].successor(x, u)
    excess = (G.H @ after - G.h).max()
    require(
        excess > 1e-6,
        f"mode {mode} takes x = {text(x)} to {text(after)}, and that is in G: this refutes nothing",
    )
    print(f"ok: {text(after)} is a successor of {text(x)}, and {excess:.3f} outside G")


def check_t4(share: Any) -> None:
    """Task 4: share(M), the share of X that eq. (10), gammaForR leaves if all its rows have the same M.

    Parameters
    ----------
    share : callable
        number -> number.

    Raises
    ------
    Wrong
        With what random states show, and one of them.
    """
    rng = np.random.default_rng()
    system = pwa_plant(disturbance_bound=0.0)
    x = system.state_set.sample(rng, 40000)
    violation = system.violation(x, np.zeros((len(x), 1)))
    for M in (*rng.uniform(1, 9.5, 3), rng.uniform(11, 20)):
        answer = require_number(share(M), "share(M)")
        left = (violation.min(axis=1) <= 0) & (violation.max(axis=1) <= M)  # one mode on, all others relaxed by M
        lost = x[np.argmax(violation.max(axis=1))]
        require(
            abs(answer - left.mean()) < 0.02,
            f"M = {M:.2f}: you say {answer:.3f}, but {left.mean():.3f} of 40,000 random states satisfy the rows of one "
            f"mode, and those of all other modes with M added; x = {text(lost)} needs M = {violation.max():.2f}",
        )
    print("ok: the part of X that is near every region remains")


def check_t5(modes: Any) -> None:
    """Task 5: the modes of a mass with friction, whose regions depend on x and u.

    Parameters
    ----------
    modes : list of Mode

    Raises
    ------
    Wrong
        If the regions leave a gap or overlap, or with a point (x, u) at which a mode gives another velocity.
    """
    require_filled(modes, "modes")
    require(len(modes) > 0 and all(isinstance(mode, Mode) for mode in modes), "modes must be a list of mr.Mode")
    try:
        system = PWASystem(modes, Polytope.box([-2], [2]), Polytope.box([-1], [1]))
    except ValueError as error:
        raise Wrong(f"these modes are no piecewise-affine system on X x U: {error}") from None
    rng = np.random.default_rng()
    near = rng.uniform(-0.2, 0.2, 200)  # v near the region in which the mass comes to rest
    u = rng.uniform(-1, 1, 400)
    x = np.concatenate([near - FRICTION["gain"] * u[:200], rng.uniform(-2, 2, 200)])
    for x_k, u_k in zip(x, u):
        for i, after in _successors(system, np.array([x_k]), np.array([u_k])).items():
            true = float(friction(x_k, u_k))
            require(
                abs(after[0] - true) < 1e-6,
                f"at x = {x_k:.3f}, u = {u_k:.3f} your mode {i} gives {after[0]:.4f}, but the next velocity is "
                f"{true:.4f}: v = x + 0.5 u is {x_k + FRICTION['gain'] * u_k:.4f} there",
            )
    print("ok: regions of x and u")


# -- helpers --------------------------------------------------------------------------------------


def _successors(system: PWASystem, x: Array, u: Array, tol: float = 0.0) -> dict[int, Array]:
    """The successor by each mode whose closed region contains (x, u): dict of mode (from 1) to (n,)."""
    distance = system.violation(x[None], u[None])[0]
    chosen = np.flatnonzero(distance <= max(tol, distance.min()))
    return {int(i) + 1: system.modes[i].successor(x, u) for i in chosen}


def _random_system(rng: np.random.Generator, n: int, shift: float) -> tuple[PWASystem, Array, float]:
    """Two modes on either side of a random plane {normal (x, u) = level}, the next state off zero by `shift`."""
    normal = rng.choice([-1.0, 1.0], n + 1) * rng.uniform(0.4, 1.0, n + 1)
    level = rng.uniform(-0.3, 0.3)
    sides = Polytope(normal[None], np.array([level])), Polytope(-normal[None], np.array([-level]))
    modes = [
        Mode(rng.uniform(-1, 1, (n, n)), rng.uniform(-1, 1, (n, 1)), rng.uniform(-1, 1, n) + shift, P) for P in sides
    ]
    X = Polytope.box(-rng.uniform(1, 4, n), rng.uniform(1, 4, n))
    return PWASystem(tuple(modes), X, Polytope.box([-1], [1])), normal, level


def _compare(problem: Any, v: Any, point: Array, successors: dict[int, Array]) -> None:
    """Raise `Wrong` unless the model's max v x+ at a point (x, u) is that of the successors by mode."""
    highest = _solve(problem, v)
    modes = " and ".join(str(i) for i in successors)
    case = f"at (x, u) = {text(point)}, which lies in the region of mode {modes},"
    if highest is None:
        raise Wrong(
            f"{case} your model has no solution: a row that belongs to another mode (gamma_i = 0) is not silent there. "
            "How large can its left side become over X x U? (Or the limit M of x~ is too small for the next state.)"
        )
    require(highest < np.inf, f"{case} x+ is unbounded in your model: something does not tie x~ to its mode")
    reached = max(successors, key=lambda i: float(v.value @ successors[i]))
    best = v.value @ successors[reached]
    require(
        highest <= best + SOLVER_TOL,
        f"{case} your model admits v x+ = {highest:.4f} for v = {text(v.value)}, but no mode there gives more than "
        f"{best:.4f}: a mode acts outside its region, x~ of a mode that is off is not zero, or that of the mode "
        "that is on is not A x + B u + p",
    )
    require(
        highest >= best - SOLVER_TOL,
        f"{case} your model admits at most v x+ = {highest:.4f} for v = {text(v.value)}, but mode {reached} gives "
        f"{best:.4f}: the model has lost this mode, or part of its successors",
    )


def _solve(problem: Any, v: Any) -> float | None:
    """The optimal value; None if there is no solution, inf if there is no bound."""
    import cvxpy as cp

    try:
        problem.solve(solver="HIGHS")
        if problem.status == cp.OPTIMAL:
            return float(problem.value)
        direction, v.value = v.value, 0 * v.value  # is there any solution?
        problem.solve(solver="HIGHS")
        v.value = direction
    except cp.error.SolverError as error:
        raise Wrong(f"the solver cannot solve your model: {error}") from None
    return np.inf if problem.status == cp.OPTIMAL else None
