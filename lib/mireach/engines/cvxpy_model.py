"""Lemmas 1 and 2 of [Teichrib2025] as printed in the paper, in cvxpy, for any MILP solver that cvxpy supports.

For reading together with the paper: comments give the number and name of each equation, and every big-M comes from
plain interval arithmetic. The engine `milp` is faster, and its dual bound is proven.
"""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

import numpy as np

from ..errors import MissingExtraError, SolverStopped
from ..sets.polytope import Polytope
from ..systems.loop import ClosedLoop
from ..systems.network import Layer, MaxoutNetwork
from ..systems.pwa import Mode, PWASystem
from ..tolerances import CVXPY_RESOLUTION, CVXPY_TOLERANCE
from ..typing import Array, ArrayLike
from .attained import Path, attained
from .base import SOLVER, Engine, Support, Witness, checked_query, empty_support

ZERO_GAP: dict[str, dict[str, Any]] = {
    "HIGHS": {
        "mip_rel_gap": 1e-9,
        "mip_abs_gap": 1e-9,
        "mip_feasibility_tolerance": 1e-8,  # with 1e-9, HiGHS 1.15 cut off optimal points in tests
        "primal_feasibility_tolerance": 1e-9,
        "presolve": "off",  # the optimum is cut off less often, see `LinearProgram.maximize_integer`
    },
    "SCIP": {"scip_params": {"limits/gap": 1e-9, "numerics/feastol": 1e-9}},
    "GUROBI": {"MIPGap": 1e-9, "FeasibilityTol": 1e-9, "IntFeasTol": 1e-9},
}
TIME_LIMIT: dict[str, Callable[[float], dict[str, Any]]] = {
    "HIGHS": lambda seconds: {"time_limit": seconds},
    "SCIP": lambda seconds: {"scip_params": {"limits/time": seconds}},
    "GUROBI": lambda seconds: {"TimeLimit": seconds},
    "GLPK_MI": lambda seconds: {"tm_lim": int(1000 * seconds)},
}


@dataclass(frozen=True)
class Cvxpy(Engine):
    """c_k*(v, F) = h of R_k(F), by the MILP of Lemma 2, eq. (17), MILPReachableSets, for any MILP solver of cvxpy.

    Parameters
    ----------
    solver : str
        A MILP solver of `cvxpy.installed_solvers()`.
    time_limit : float or None
        Seconds per direction.
    tolerance : float
        Added to the optimum of the solver, in units of v x.
    options : mapping
        The solver's own options, passed to `cvxpy.Problem.solve`.

    See Also
    --------
    Milp : faster, with bounds that do not rest on the solver.
    """

    name: ClassVar[str] = "cvxpy"
    resolution: ClassVar[float] = CVXPY_RESOLUTION

    solver: str = "HIGHS"
    time_limit: float | None = None
    tolerance: float = CVXPY_TOLERANCE
    options: Mapping[str, object] = field(default_factory=dict)

    def support(
        self,
        loop: ClosedLoop,
        F: Polytope,
        V: ArrayLike,
        steps: int = 1,
        *,
        cutoff: Array | None = None,
        warm_start: Support | None = None,
    ) -> Support:
        """As `Engine.support`. The model has k (s + sum of p_i w_i) binary variables.

        Notes
        -----
        `value` is attained by the witness in rational arithmetic, or -inf without one. `bound` is the solver's optimum
        plus `tolerance`. It is not proven, since cvxpy does not expose the dual bound: `rests_on` is SOLVER. `cutoff`
        and `warm_start` are not used.

        Raises
        ------
        ValueError
            If cvxpy does not have the solver.
        SolverStopped
            If the solver ends without an optimum.
        MissingExtraError
            If cvxpy is not installed.
        """
        V, steps = checked_query(loop, F, V, steps)
        start = F & loop.system.state_set
        if start.is_empty:
            return empty_support(len(V))
        options = _options(self.solver, self.time_limit, self.options)
        problem, v, x, gamma, d = model(loop, F, steps)
        values: list[float] = []
        bounds: list[float] = []
        witnesses: list[Witness | None] = []
        for row in V:
            v.value = row
            optimum = _solve(problem, self.solver, options, len(V))
            if optimum is None:
                return empty_support(len(V), SOLVER)
            modes = [int(np.argmax(choice.value)) for choice in gamma]
            path = Path(x[0].value, modes, [part.value for part in d])
            found = attained(loop, start, row, [(optimum, path)])
            values.append(-np.inf if found is None else found.value)
            bounds.append(max(values[-1], optimum) + self.tolerance)
            witnesses.append(None if found is None else found.witness())
        return Support(np.array(values), np.array(bounds), tuple(witnesses), rests_on=SOLVER)


class Model(NamedTuple):
    """The MILP of eq. (17), MILPReachableSets, and its variables.

    Attributes
    ----------
    problem : cvxpy.Problem
    v : cvxpy.Parameter (n,)
    x : list of cvxpy.Variable (n,)
        States x(0), ..., x(k).
    gamma : list of cvxpy.Variable (s,)
        Mode choices at the steps 0, ..., k - 1.
    d : list of cvxpy.Variable (n,)
        Disturbances at the steps 0, ..., k - 1.
    """

    problem: Any
    v: Any
    x: list[Any]
    gamma: list[Any]
    d: list[Any]


def model(loop: ClosedLoop, F: Polytope, steps: int) -> Model:
    """The MILP of eq. (17), MILPReachableSets: max v x(k) over trajectories that start in F."""
    cp = _cvxpy()
    system, n = loop.system, loop.system.state_size
    X = system.state_set
    x = [cp.Variable(n, name=f"x({k})") for k in range(steps + 1)]
    d = [cp.Variable(n, name=f"d({k})") for k in range(steps)]
    gamma = [cp.Variable(len(system.modes), boolean=True, name=f"gamma({k})") for k in range(steps)]
    constraints = [F.H @ x[0] <= F.h]
    for k in range(steps):
        box = (F & X if k == 0 else X).bounding_box()
        constraints += [X.H @ x[k] <= X.h]  # the regions partition X x U
        u, u_range, network = network_constraints(loop.network, x[k], box, k)
        xi = cp.hstack([x[k], u])
        xi_range = np.concatenate([box[0], u_range[0]]), np.concatenate([box[1], u_range[1]])
        constraints += network + system_constraints(system, Step(xi, xi_range, gamma[k], d[k], x[k + 1], k))
    v = cp.Parameter(n, name="v")
    return Model(cp.Problem(cp.Maximize(v @ x[steps]), constraints), v, x, gamma, d)  # eq. (17), MILPReachableSets


def network_constraints(
    net: MaxoutNetwork, x: Any, box: tuple[Array, Array], k: int
) -> tuple[Any, tuple[Array, Array], list[Any]]:
    """u = Phi(x), its range for x in the box, and the constraints of eq. (9), MI_Constraints_NN."""
    cp, constraints = _cvxpy(), []
    q = x  # eq. (15c), MIConQEqhatX
    y = box
    for i, layer in enumerate(net.hidden, start=1):
        low, high = affine_range(layer.weight, layer.bias, *y)
        delta = cp.Variable(len(layer.bias), boolean=True, name=f"delta{i}({k})")
        q_next = cp.Variable(layer.width, name=f"q{i}({k})")
        z = layer.weight @ q + layer.bias
        for neuron in range(layer.width):
            A_l = slice(layer.pool * neuron, layer.pool * (neuron + 1))
            M = high[A_l].max() - low[A_l]
            constraints += [  # eqs. (9a-c), MI_Constraints_NN
                q_next[neuron] <= z[A_l] + cp.multiply(M, 1 - delta[A_l]),
                -q_next[neuron] <= -z[A_l],
                cp.sum(delta[A_l]) == 1,
            ]
        q, y = q_next, maxout_range(layer, low, high)
    u = net.weight @ q + net.bias  # eq. (15d), hatUEqWqplusB
    return u, affine_range(net.weight, net.bias, *y), constraints


class Step(NamedTuple):
    """The variables of step k: xi = (x, u) and its range, gamma, d, and x+."""

    xi: Any
    xi_range: tuple[Array, Array]
    gamma: Any
    d: Any
    after: Any
    k: int


def system_constraints(system: PWASystem, step: Step) -> list[Any]:
    """The constraints of x+ = A x + B u + p + d for the mode that acts."""
    cp, constraints = _cvxpy(), []
    xi, d = step.xi, step.d
    n = system.state_size
    d_range = disturbance_range(system.modes)
    every = [np.concatenate(ends) for ends in zip(step.xi_range, d_range)]
    parts = []
    for i, mode in enumerate(system.modes):
        H, h = mode.region.H, mode.region.h
        D, on = mode.disturbance, step.gamma[i]
        part = cp.Variable(n, name=f"x~{i + 1}({step.k + 1})")
        AB = np.hstack([mode.A, mode.B])
        M = np.abs(affine_range(np.hstack([AB, np.eye(n)]), mode.p, *every)).max(axis=0)
        constraints += [H @ xi <= h + excess(H, h, *step.xi_range) * (1 - on)]  # eq. (10), gammaForR
        constraints += [-M * on <= part, part <= M * on]  # eq. (12b), MI_PWA_xTilde
        constraints += [  # eq. (14), MISysWithDis
            -M * (1 - on) <= AB @ xi + mode.p + d - part,
            AB @ xi + mode.p + d - part <= M * (1 - on),
            D.H @ d <= D.h + excess(D.H, D.h, *d_range) * (1 - on),
        ]
        parts.append(part)
    constraints += [cp.sum(step.gamma) == 1]  # eq. (10), gammaForR
    constraints += [step.after == sum(parts)]  # eq. (12c), MI_PWA_sumXTilde
    return constraints


# -- big-M by interval arithmetic -----------------------------------------------------------------


def affine_range(W: Array, b: Array, lower: Array, upper: Array) -> tuple[Array, Array]:
    """Smallest and largest W y + b over the box lower <= y <= upper: two arrays with one entry per row of W."""
    centre, radius = (lower + upper) / 2, (upper - lower) / 2
    return W @ centre + b - np.abs(W) @ radius, W @ centre + b + np.abs(W) @ radius


def maxout_range(layer: Layer, low: Array, high: Array) -> tuple[Array, Array]:
    """Range of each neuron from the ranges of its channels, eq. (8), maxout."""
    return low.reshape(-1, layer.pool).max(axis=1), high.reshape(-1, layer.pool).max(axis=1)


def disturbance_range(modes: Sequence[Mode]) -> tuple[Array, Array]:
    """The smallest box around all disturbance sets."""
    lower, upper = zip(*(mode.disturbance.bounding_box() for mode in modes))
    return np.min(lower, axis=0), np.max(upper, axis=0)


def excess(H: Array, h: Array, lower: Array, upper: Array) -> Array:
    """M of the rows H z <= h: their largest violation in the box, at least 0."""
    return np.maximum(affine_range(H, -h, lower, upper)[1], 0.0)


# -- solvers --------------------------------------------------------------------------------------


def _cvxpy() -> Any:
    """The package cvxpy."""
    try:
        import cvxpy
    except ImportError as error:
        raise MissingExtraError("the engine cvxpy", "cvxpy", "model") from error
    return cvxpy


def _options(solver: str, time_limit: float | None, given: Mapping[str, Any]) -> dict[str, Any]:
    """Keyword arguments for `cvxpy.Problem.solve`; those of the caller override the others."""
    installed = _cvxpy().installed_solvers()
    if solver not in installed:
        raise ValueError(f"solver {solver!r} is not installed; cvxpy has {', '.join(installed)}")
    options = {name: dict(v) if isinstance(v, dict) else v for name, v in ZERO_GAP.get(solver, {}).items()}
    if time_limit is not None and solver not in TIME_LIMIT:
        raise ValueError(f"time_limit is not supported for {solver}; set the solver's own option in `options` instead")
    limits = {} if time_limit is None else TIME_LIMIT[solver](time_limit)
    for name, value in [*limits.items(), *given.items()]:
        options[name] = {**options.get(name, {}), **value} if isinstance(value, dict) else value
    return options


def _solve(problem: Any, solver: str, options: Mapping[str, Any], count: int) -> float | None:
    """The optimal value, or None if there is no trajectory; SolverStopped if the solver ends without an optimum."""
    cp = _cvxpy()
    try:
        with warnings.catch_warnings(action="ignore"):  # an inaccurate answer is rejected below
            problem.solve(solver=solver, **options)
        status = problem.status
    except cp.error.SolverError as error:
        status = str(error)
    if status == cp.OPTIMAL:
        return float(problem.value)
    if status in (cp.INFEASIBLE, cp.settings.INFEASIBLE_OR_UNBOUNDED):
        return None
    nothing = Support(np.full(count, -np.inf), np.full(count, np.inf), (None,) * count, rests_on=SOLVER)
    raise SolverStopped(f"{solver} ended with: {status}", nothing)
