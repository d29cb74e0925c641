"""Lemmas 1 and 2 of [Teichrib2025]: the k-step reachable set as one mixed-integer linear program (HiGHS).

The model grows from the state to the output of each layer, to the modes, to the next state. What has been
built so far is, with its binaries relaxed to [0, 1], a linear program that bounds what comes next: hence a
big-M for every single row, no binary for a channel that never wins, and none for a mode that is never met.
"""

from dataclasses import dataclass

import highspy
import numpy as np

from ..checks import positive_number, real_array
from ..errors import SolverError, SolverStopped
from ..loop import require_inputs
from ..lp import TOLERANCE, LinearProgram
from .bounds import METHODS, SAFETY, lower_bound, upper_bound
from .common import Support, checked_query, empty_support, replay

MIP_TOLERANCE = 1e-8  # feasibility in the MILP; bounds.SAFETY has to stay far above it
MARGIN = (
    2e-9  # beside MIP_TOLERANCE, by which HiGHS may prune what is better: for gap and LPs, relative to 1 + the bound
)
DOUBT = 1e-6  # a trajectory above the bound by more shows that HiGHS is wrong (relative to 1 + its size)
INPUT_TOLERANCE = 1e-7  # how far Phi may leave U, for rounding (relative to 1 + the size of the limit)


@dataclass(frozen=True, eq=False)
class Model:
    """The MILP of eq. MILPReachableSets, ready for any objective v x(k).

    Attributes
    ----------
    program : LinearProgram
        All constraints; binaries are relaxed until `solve` declares them.
    states : list of k + 1 arrays (n,)
        Columns of x(0), ..., x(k).
    modes : list of k arrays (s,)
        Columns of gamma(0), ..., gamma(k - 1).
    disturbances : list of k arrays (n,)
        Columns of d(0), ..., d(k - 1).
    binaries : array of int
        Columns of all delta and gamma that are still open.
    """

    program: LinearProgram
    states: list
    modes: list
    disturbances: list
    binaries: np.ndarray


def support(loop, F, V, steps=1, *, bounds="lp", time_limit=None, gap=1e-9):
    """h of R_k(F) along the rows of V by the MILP of Lemma 2, one solve a row, for any k, n and m.

    Parameters
    ----------
    loop : ClosedLoop
    F : Polytope
        States outside X have no successor: F & X counts.
    V : array (k, n)
    steps : int
        k; the model has k times as many binaries.
    bounds : "lp" or "interval"
        Where the big-M come from (see `bounds`).
    time_limit : float or None
        Seconds for each direction.
    gap : float
        Relative gap between bound and value at which the solver may stop. HiGHS's own default of 1e-4
        would be far too loose for sets that are compared with each other.

    Returns
    -------
    Support
        `bound` is HiGHS's dual bound plus its tolerance, `value` what the witness attains when it is
        replayed on the loop (constraints hold to HiGHS's tolerance of 1e-8).

    Raises
    ------
    SolverStopped
        If the time limit came first; its `support` holds what is known.
    SolverError
        If HiGHS ends without an answer, or with bounds that its own trajectories pass.
    ValueError
        If Phi leaves U at some state of F & X.
    """
    V, steps = checked_query(loop, F, V, steps)
    gap = float(real_array(gap, "gap", 0))
    if gap < 0:
        raise ValueError(f"gap must not be negative; got {gap}")
    time_limit = None if time_limit is None else positive_number(time_limit, "time_limit")
    model = build(loop, F, steps, bounds)
    if model is None:
        return empty_support(len(V))
    value, bound, witness, stopped = np.full(len(V), -np.inf), np.full(len(V), np.inf), [None] * len(V), False
    _declare_binaries(model, gap)
    for row, v in enumerate(V):
        limit, point, finished = _solve(model, v, time_limit)
        if limit == -np.inf:
            return empty_support(len(V))
        bound[row] = limit + MIP_TOLERANCE + MARGIN * (1 + abs(limit))
        stopped |= not finished
        if point is not None:
            modes = [int(np.argmax(point[columns])) for columns in model.modes]
            witness[row] = replay(loop, point[model.states[0]], modes, [point[d] for d in model.disturbances])
            value[row] = min(v @ witness[row].states[-1], bound[row])
    _require_consistent(V, bound, witness)
    found = Support(value, bound, tuple(witness))
    if stopped:
        raise SolverStopped(f"HiGHS was stopped by time_limit = {time_limit} s; allow more time", found)
    return found


def build(loop, F, steps, bounds="lp"):
    """The model of eq. MIClosedLoop over x(0) in F & X for K = `steps`.

    Returns
    -------
    Model, or None
        None if F & X is empty.

    Raises
    ------
    ValueError
        If `bounds` is not one of the methods, or Phi leaves U.
    """
    if bounds not in METHODS:
        raise ValueError(f"bounds must be one of {METHODS}; got {bounds!r}")
    start = F & loop.system.state_set
    if start.is_empty:
        return None
    lp = LinearProgram()
    x = lp.add_columns(*_widened(*start.bounding_box()))
    lp.add_rows(x, F.H, upper=F.h)
    states, modes, disturbances, binaries = [x], [], [], []
    for _ in range(steps):
        lp.add_rows(x, loop.system.state_set.H, upper=loop.system.state_set.h)
        u, deltas = add_network(lp, loop.network, x, bounds)
        _require_inputs(lp, loop, x, u, deltas, bounds)
        x, gamma, d = add_system(lp, loop.system, x, u, bounds)
        if x is None:
            return None
        states, modes, disturbances = [*states, x], [*modes, gamma], [*disturbances, d]
        binaries += [*deltas, *gamma[lp.upper[gamma] > 0]]
    return Model(lp, states, modes, disturbances, np.array(binaries, np.int32))


def add_network(lp, network, x, bounds="lp"):
    """Eq. MI_Constraints_NN: columns of u = Phi(x), and those of the binaries delta that are needed.

    For neuron l of layer i with its channels z_j = W_j q + b_j, j in A_l:
    z_j <= q_l <= z_j + M_j (1 - delta_j), sum of delta_j = 1, with M_j >= max over x of (max_i z_i - z_j).
    """
    q, deltas = x, []
    for layer in network.hidden:
        outputs = []
        for neuron in range(layer.width):
            rows = slice(neuron * layer.pool, (neuron + 1) * layer.pool)
            column, new = _add_neuron(lp, q, layer.weight[rows], layer.bias[rows], bounds)
            outputs.append(column)
            deltas += new
        q = np.array(outputs, np.int32)
    u = _add_affine(lp, q, network.weight, network.bias, bounds)
    return u, deltas


def add_system(lp, system, x, u, bounds="lp"):
    """Eqs. gammaForR, MI_PWA_xTilde, MI_PWA_sumXTilde and MISysWithDis: columns of x+, gamma and d.

    x+ is None if no mode can be met.
    """
    modes, n = system.modes, system.state_size
    gamma = lp.add_columns(np.zeros(len(modes)), np.ones(len(modes)))
    lp.add_row(gamma, np.ones(len(modes)), 1, 1)
    xu = np.concatenate([x, u])
    for mode, on in zip(modes, gamma):  # eq. gammaForR: H (x, u) <= h + M (1 - gamma)
        for row, offset in zip(mode.region.H, mode.region.h):
            if lower_bound(lp, xu, row, -offset, bounds) > 10 * TOLERANCE:
                lp.set_bounds(on, 0, 0)
                break
            M = upper_bound(lp, xu, row, -offset, bounds)
            if M > 0:
                lp.add_row([*xu, on], [*row, M], upper=offset + M)
    images = [_image_bounds(lp, mode, on, xu, bounds) for mode, on in zip(modes, gamma)]
    met = [i for i in range(len(modes)) if lp.upper[gamma[i]] > 0]
    if not met:
        return None, gamma, None
    boxes = {i: modes[i].disturbance.bounding_box() for i in met}
    d_low = np.min([boxes[i][0] for i in met], axis=0)
    d_high = np.max([boxes[i][1] for i in met], axis=0)
    d = lp.add_columns(*_widened(d_low, d_high))
    _add_disturbance(lp, [modes[i] for i in met], gamma[met], d)
    parts = []
    for i in met:
        mode, on, (low, high, low_all, high_all) = modes[i], gamma[i], images[i]
        low, high = _widened(low + boxes[i][0], high + boxes[i][1])
        part = lp.add_columns(np.minimum(low, 0), np.maximum(high, 0))
        for c in range(n):
            lp.add_row([part[c], on], [1, -high[c]], upper=0)  # eq. MI_PWA_xTilde
            lp.add_row([part[c], on], [1, -low[c]], lower=0)
            row = [*mode.A[c], *mode.B[c], 1, -1]  # eq. MI_PWA_ABpd
            M_high, M_low = high_all[c] + d_high[c], low_all[c] + d_low[c]
            lp.add_row([*xu, d[c], part[c], on], [*row, M_high], upper=M_high - mode.p[c])
            lp.add_row([*xu, d[c], part[c], on], [*row, M_low], lower=M_low - mode.p[c])
        parts.append(part)
    after = lp.add_columns(
        np.min([lp.lower[gamma_part] for gamma_part in parts], axis=0),
        np.max([lp.upper[gamma_part] for gamma_part in parts], axis=0),
    )
    for c in range(n):  # eq. MI_PWA_sumXTilde
        lp.add_row([after[c], *(part[c] for part in parts)], [1, *[-1] * len(parts)], 0, 0)
    return after, gamma, d


def _add_neuron(lp, q, weight, bias, bounds):
    """One maxout neuron over the columns q: its column, and the list of its binaries (empty if one channel wins)."""
    alive = list(range(len(bias)))
    ahead = np.zeros((len(bias), len(bias)))  # ahead[i, j] >= z_i - z_j everywhere
    for i in range(len(bias)):
        for j in alive:
            if i != j:
                ahead[i, j] = upper_bound(lp, q, weight[i] - weight[j], bias[i] - bias[j], bounds)
                if ahead[i, j] <= 0:  # z_i never exceeds z_j
                    alive.remove(i)
                    break
    if len(alive) == 1:
        return _add_affine(lp, q, weight[alive], bias[alive], bounds)[0], []
    high = max(upper_bound(lp, q, weight[j], bias[j], bounds) for j in alive)
    low = max(lower_bound(lp, q, weight[j], bias[j], bounds) for j in alive)
    column = lp.add_columns(low, high)[0]
    deltas = lp.add_columns(np.zeros(len(alive)), np.ones(len(alive)))
    for j, delta in zip(alive, deltas):
        M = max(ahead[i, j] for i in alive if i != j)
        lp.add_row([column, *q], [1, *-weight[j]], lower=bias[j])
        lp.add_row([column, *q, delta], [1, *-weight[j], M], upper=bias[j] + M)
    lp.add_row(deltas, np.ones(len(alive)), 1, 1)
    return column, list(deltas)


def _add_affine(lp, q, weight, bias, bounds):
    """Columns of weight q + bias."""
    low = [lower_bound(lp, q, w, b, bounds) for w, b in zip(weight, bias)]
    high = [upper_bound(lp, q, w, b, bounds) for w, b in zip(weight, bias)]
    columns = lp.add_columns(low, high)
    for column, w, b in zip(columns, weight, bias):
        lp.add_row([column, *q], [1, *-w], b, b)
    return columns


def _image_bounds(lp, mode, on, xu, bounds):
    """Bounds of A x + B u + p where the mode acts and anywhere: low, high, low_all, high_all, each (n,).

    A mode that the relaxation shows to be out of reach is switched off for good.
    """
    rows = np.hstack([mode.A, mode.B])
    low_all = np.array([lower_bound(lp, xu, row, p, bounds) for row, p in zip(rows, mode.p)])
    high_all = np.array([upper_bound(lp, xu, row, p, bounds) for row, p in zip(rows, mode.p)])
    low, high = low_all, high_all
    if lp.upper[on] > 0 and bounds == "lp":
        lp.set_bounds(on, 1, 1)
        low = np.array([lower_bound(lp, xu, row, p, bounds) for row, p in zip(rows, mode.p)])
        high = np.array([upper_bound(lp, xu, row, p, bounds) for row, p in zip(rows, mode.p)])
        reachable = np.isfinite(low).all() and np.isfinite(high).all()
        lp.set_bounds(on, 0, 1 if reachable else 0)
    return low, high, low_all, high_all


def _add_disturbance(lp, modes, gamma, d):
    """Eq. MI_PWA_Hd: H_D d <= h_D + M (1 - gamma), without big-M where all modes have the same set."""
    if len({mode.disturbance for mode in modes}) == 1:
        lp.add_rows(d, modes[0].disturbance.H, upper=modes[0].disturbance.h)
        return
    for mode, on in zip(modes, gamma):
        for row, offset in zip(mode.disturbance.H, mode.disturbance.h):
            M = upper_bound(lp, d, row, -offset, "interval")
            if M > 0:
                lp.add_row([*d, on], [*row, M], upper=offset + M)


def _require_inputs(lp, loop, x, u, deltas, bounds):
    """Raise ValueError if Phi leaves U: by the relaxation's bounds, and by a MILP where they do not settle it."""
    U = loop.system.input_set
    tol = INPUT_TOLERANCE * (1 + np.abs(U.h))
    open_rows = [r for r in range(len(U.h)) if upper_bound(lp, u, U.H[r], -U.h[r], bounds) > tol[r]]
    if not open_rows:
        return
    model = Model(lp, [x, u], [], [], np.array(deltas, np.int32))
    _declare_binaries(model, gap=1e-9)
    for r in open_rows:
        _, point, _ = _solve(model, U.H[r])
        if point is not None:  # None: no state gets here
            require_inputs(loop.network, loop.system.input_set, point[x][None], tol=tol[r])
    _relax_binaries(model)


def _require_consistent(V, bound, witness):
    """Raise SolverError if a trajectory found for one direction passes the bound of another."""
    ends = np.array([found.states[-1] for found in witness if found is not None]).reshape(-1, V.shape[1])
    excess = (ends @ V.T).max(axis=0, initial=-np.inf) - bound
    worst = int(np.argmax(excess))
    if excess[worst] > DOUBT * (1 + abs(bound[worst])):
        raise SolverError(
            f"HiGHS bounds direction {V[worst].tolist()} by {bound[worst]:.9g}, but a trajectory passes this by "
            f'{excess[worst]:.3g}; try bounds="interval", or engine="cells" for two states'
        )


def _widened(low, high):
    """Bounds moved apart so that they cut off nothing; rows beside them hold the exact limits."""
    return low - SAFETY * (1 + np.abs(low)), high + SAFETY * (1 + np.abs(high))


# -- solving ------------------------------------------------------------------------------------------


def _declare_binaries(model, gap):
    """Turn the relaxation into the MILP, with the accuracy that `support` promises."""
    highs = model.program.highs
    for name, setting in {
        "presolve": "choose",
        "mip_rel_gap": float(gap),
        "mip_abs_gap": float(gap),
        "mip_feasibility_tolerance": MIP_TOLERANCE,
    }.items():
        highs.setOptionValue(name, setting)
    kinds = np.full(len(model.binaries), highspy.HighsVarType.kInteger)
    highs.changeColsIntegrality(len(kinds), model.binaries, kinds)


def _relax_binaries(model):
    """Back to the relaxation."""
    highs = model.program.highs
    kinds = np.full(len(model.binaries), highspy.HighsVarType.kContinuous)
    highs.changeColsIntegrality(len(kinds), model.binaries, kinds)
    highs.setOptionValue("presolve", "off")


def _solve(model, v, time_limit=None):
    """max v x(k): dual bound (-inf if infeasible), the best point or None, and whether the solver finished."""
    lp = model.program
    lp.set_objective(model.states[-1], v)
    if time_limit is not None:  # HiGHS counts the seconds of all runs of a model together
        lp.highs.setOptionValue("time_limit", lp.highs.getRunTime() + time_limit)
    lp.highs.run()
    if lp.highs.getModelStatus() not in (highspy.HighsModelStatus.kOptimal, highspy.HighsModelStatus.kTimeLimit):
        lp.highs.clearSolver()  # no answer, or infeasible: that has to hold from the start and without presolve too
        lp.highs.setOptionValue("presolve", "off")
        lp.highs.run()
        lp.highs.setOptionValue("presolve", "choose")
    status, info = lp.highs.getModelStatus(), lp.highs.getInfo()
    if status == highspy.HighsModelStatus.kInfeasible:
        return -np.inf, None, True
    if status not in (highspy.HighsModelStatus.kOptimal, highspy.HighsModelStatus.kTimeLimit):
        raise SolverError(f"HiGHS ended the MILP with {lp.highs.modelStatusToString(status)}")
    finished = status == highspy.HighsModelStatus.kOptimal
    solution = lp.highs.getSolution()
    point = (
        np.array(solution.col_value) if solution.value_valid and np.isfinite(info.objective_function_value) else None
    )
    bound = info.mip_dual_bound if len(model.binaries) else (info.objective_function_value if finished else np.inf)
    return float(bound), point, finished
