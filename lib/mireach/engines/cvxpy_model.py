"""Lemmas 1 and 2 of [Teichrib2025] written as they are printed, in cvxpy, for any MILP solver that cvxpy knows.

To be read beside the paper: equation names stand at the constraints, and every big-M comes from plain interval
arithmetic. The engine `milp` answers the same question faster and with a proven dual bound.
"""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from ..errors import MissingExtraError, SolverStopped
from .attained import attained
from .base import SOLVER, Engine, Support, checked_query, empty_support

TOLERANCE = 1e-7  # added to what the solver calls optimal, in units of v x
ZERO_GAP = {
    "HIGHS": {
        "mip_rel_gap": 1e-9,
        "mip_abs_gap": 1e-9,
        "mip_feasibility_tolerance": 1e-8,  # with 1e-9, HiGHS 1.15 has been seen to cut off optimal points
        "primal_feasibility_tolerance": 1e-9,
        "presolve": "off",  # the optimum is lost less often, see `lp.LinearProgram.maximize_integer`
    },
    "SCIP": {"scip_params": {"limits/gap": 1e-9, "numerics/feastol": 1e-9}},
    "GUROBI": {"MIPGap": 1e-9, "FeasibilityTol": 1e-9, "IntFeasTol": 1e-9},
}
TIME_LIMIT = {
    "HIGHS": lambda seconds: {"time_limit": seconds},
    "SCIP": lambda seconds: {"scip_params": {"limits/time": seconds}},
    "GUROBI": lambda seconds: {"TimeLimit": seconds},
    "GLPK_MI": lambda seconds: {"tm_lim": int(1000 * seconds)},
}


@dataclass(frozen=True)
class Cvxpy(Engine):
    """c_k*(v, F) = h of R_k(F), by the MILP of Lemma 2 written in cvxpy, for any MILP solver that cvxpy has.

    Parameters
    ----------
    solver : str
        A MILP solver of `cvxpy.installed_solvers()`.
    time_limit : float or None
        Seconds per direction.
    tolerance : float
        In units of v x; the solver's answer is trusted to within it.
    options : mapping
        The solver's own options, passed to `cvxpy.Problem.solve`.

    See Also
    --------
    Milp : faster, with bounds that do not rest on the solver.
    """

    name: ClassVar[str] = "cvxpy"
    resolution: ClassVar[float] = 1e-5

    solver: str = "HIGHS"
    time_limit: float | None = None
    tolerance: float = TOLERANCE
    options: Mapping[str, object] = field(default_factory=dict)

    def support(self, loop, F, V, steps=1, *, cutoff=None, warm_start=None) -> Support:
        """As `Engine.support`. The model has k (s + sum of p_i w_i) binary variables.

        Notes
        -----
        `value` is attained by the witness in rational arithmetic, or -inf without one. `bound` is the solver's optimum
        plus `tolerance`: cvxpy does not expose the dual bound, so it is as accurate as the solver and not proven
        (`rests_on` is SOLVER). `cutoff` and `warm_start` are not used.

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
        answers = []
        for row in V:
            v.value = row
            optimum = _solve(problem, self.solver, options, len(V))
            if optimum is None:
                return empty_support(len(V), SOLVER)
            modes = [int(np.argmax(choice.value)) for choice in gamma]
            reached = attained(loop, start, row, [(optimum, (x[0].value, modes, [part.value for part in d]))])
            value = -np.inf if reached is None else reached.value
            witness = None if reached is None else reached.witness()
            answers.append((value, max(value, optimum) + self.tolerance, witness))
        values, bounds, witnesses = zip(*answers) if answers else ((), (), ())
        return Support(np.array(values), np.array(bounds), tuple(witnesses), rests_on=SOLVER)


def model(loop, F, steps):
    """The MILP of eq. MILPReachableSets, max v x(k) over trajectories that start in F.

    Returns
    -------
    problem : cvxpy.Problem
    v : cvxpy.Parameter (n,)
    x, gamma, d : lists of cvxpy.Variable
        States x(0), ..., x(k); mode choices and disturbances at the steps 0, ..., k - 1.
    """
    cp = _cvxpy()
    system, net, n = loop.system, loop.network, loop.system.state_size
    modes, X = system.modes, system.state_set
    x = [cp.Variable(n, name=f"x({k})") for k in range(steps + 1)]
    d = [cp.Variable(n, name=f"d({k})") for k in range(steps)]
    gamma = [cp.Variable(len(modes), boolean=True, name=f"gamma({k})") for k in range(steps)]
    constraints = [F.H @ x[0] <= F.h]

    for k in range(steps):
        box = (F & X if k == 0 else X).bounding_box()
        constraints += [X.H @ x[k] <= X.h]  # the regions partition X x U
        q = x[k]  # eq. MIConQEqhatX
        y = box
        for i, layer in enumerate(net.hidden, start=1):
            low, high = affine_range(layer.weight, layer.bias, *y)
            delta = cp.Variable(len(layer.bias), boolean=True, name=f"delta{i}({k})")
            q_next = cp.Variable(layer.width, name=f"q{i}({k})")
            z = layer.weight @ q + layer.bias
            for neuron in range(layer.width):
                A_l = slice(layer.pool * neuron, layer.pool * (neuron + 1))
                M = high[A_l].max() - low[A_l]
                constraints += [  # eq. MI_Constraints_NN
                    q_next[neuron] <= z[A_l] + cp.multiply(M, 1 - delta[A_l]),
                    -q_next[neuron] <= -z[A_l],
                    cp.sum(delta[A_l]) == 1,
                ]
            q, y = q_next, maxout_range(layer, low, high)
        u = net.weight @ q + net.bias  # eq. hatUEqWqplusB
        xi = cp.hstack([x[k], u])
        xi_range = [np.concatenate(ends) for ends in zip(box, affine_range(net.weight, net.bias, *y))]
        d_range = disturbance_range(modes)

        parts = []
        for i, mode in enumerate(modes):
            H, h, D, on = mode.region.H, mode.region.h, mode.disturbance, gamma[k][i]
            part = cp.Variable(n, name=f"x~{i + 1}({k + 1})")
            AB = np.hstack([mode.A, mode.B])
            every = [np.concatenate(ends) for ends in zip(xi_range, d_range)]
            ends = affine_range(np.hstack([AB, np.eye(n)]), mode.p, *every)
            M = np.abs(ends).max(axis=0)
            constraints += [H @ xi <= h + excess(H, h, *xi_range) * (1 - on)]  # eq. gammaForR
            constraints += [-M * on <= part, part <= M * on]  # eq. MI_PWA_xTilde
            constraints += [  # eq. MISysWithDis
                -M * (1 - on) <= AB @ xi + mode.p + d[k] - part,
                AB @ xi + mode.p + d[k] - part <= M * (1 - on),
                D.H @ d[k] <= D.h + excess(D.H, D.h, *d_range) * (1 - on),
            ]
            parts.append(part)
        constraints += [cp.sum(gamma[k]) == 1]  # eq. gammaForR
        constraints += [x[k + 1] == sum(parts)]  # eq. MI_PWA_sumXTilde

    v = cp.Parameter(n, name="v")
    return cp.Problem(cp.Maximize(v @ x[steps]), constraints), v, x, gamma, d  # eq. MILPReachableSets


# -- big-M by interval arithmetic -----------------------------------------------------------------


def affine_range(W, b, lower, upper):
    """Smallest and largest W y + b over the box lower <= y <= upper, row by row."""
    centre, radius = (lower + upper) / 2, (upper - lower) / 2
    return W @ centre + b - np.abs(W) @ radius, W @ centre + b + np.abs(W) @ radius


def maxout_range(layer, low, high):
    """Range of each neuron from the ranges of its channels (eq. maxout)."""
    return low.reshape(-1, layer.pool).max(axis=1), high.reshape(-1, layer.pool).max(axis=1)


def disturbance_range(modes):
    """The smallest box around all disturbance sets."""
    lower, upper = zip(*(mode.disturbance.bounding_box() for mode in modes))
    return np.min(lower, axis=0), np.max(upper, axis=0)


def excess(H, h, lower, upper):
    """M of the rows H z <= h: by how much they can be violated in the box, at least 0."""
    return np.maximum(affine_range(H, -h, lower, upper)[1], 0.0)


# -- solvers --------------------------------------------------------------------------------------


def _cvxpy():
    try:
        import cvxpy
    except ImportError as error:
        raise MissingExtraError("the engine cvxpy", "cvxpy", "model") from error
    return cvxpy


def _options(solver, time_limit, given):
    """Keyword arguments for `cvxpy.Problem.solve`; what the caller gives goes last."""
    known = _cvxpy().installed_solvers()
    if solver not in known:
        raise ValueError(f"solver {solver!r} is not installed; cvxpy knows {', '.join(known)}")
    options = {name: dict(v) if isinstance(v, dict) else v for name, v in ZERO_GAP.get(solver, {}).items()}
    if time_limit is not None and solver not in TIME_LIMIT:
        raise ValueError(f"no time limit is known for {solver}; pass the solver's own option instead")
    limits = {} if time_limit is None else TIME_LIMIT[solver](time_limit)
    for name, value in [*limits.items(), *given.items()]:
        options[name] = {**options.get(name, {}), **value} if isinstance(value, dict) else value
    return options


def _solve(problem, solver, options, count):
    """Optimal value, or None if there is no trajectory; SolverStopped where the solver has no answer."""
    cp = _cvxpy()
    try:
        with warnings.catch_warnings(action="ignore"):  # an inaccurate answer is refused below
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
