"""Model predictive control of a piecewise-affine system to proven optimality (case study 1 of [Teichrib2025])."""

import heapq
from dataclasses import dataclass, replace
from itertools import count

import numpy as np

from ...checks import real_array, require_columns
from ...errors import MissingExtraError, SolverError, SolverStopped

TOLERANCE = 1e-9  # a constraint counts as met within this, in units of its row after scaling to length 1
FLAT = 1e-12  # a row of a condensed constraint shorter than this, relative to its region's row, does not depend on u
OPTIMAL, INFEASIBLE = 1, -1  # what DAQP's exit flags mean


@dataclass(frozen=True, eq=False)
class MIQPSolution:
    """Answer of `solve_miqp`.

    Attributes
    ----------
    cost : float
        Of the trajectory in `inputs` and `states`; inf if no input sequence is feasible.
    bound : float
        Proven lower bound of the optimal cost (to within the accuracy of the QP solver); inf if
        infeasible.
    inputs : array (N, m) or None
    states : array (N + 1, n) or None
    modes : array (N,) of int or None
        Which mode each step takes, counted from 0.
    nodes : int
        QPs that were solved.
    """

    cost: float
    bound: float
    inputs: np.ndarray | None
    states: np.ndarray | None
    modes: np.ndarray | None
    nodes: int

    @property
    def feasible(self):
        """Whether there is an input sequence that meets all constraints."""
        return self.inputs is not None

    @property
    def gap(self):
        """cost - bound; 0 if infeasible."""
        return self.cost - self.bound if self.feasible else 0.0


def solve_miqp(system, x0, horizon=10, Q=None, R=None, P=None, most_nodes=100_000, tol=TOLERANCE):
    """min sum_{k<N} (x(k)'Q x(k) + u(k)'R u(k)) + x(N)'P x(N) over the nominal system.

    Subject to x(k+1) = f_PWA(x(k), u(k)) from x(0) = x0, x(k) in X for k = 0..N and u(k) in U for k < N.

    Parameters
    ----------
    system : PWASystem
        Its disturbances are left out. The regions are closed: on a shared boundary the cheaper mode
        is taken.
    x0 : array (n,)
    horizon : int
        N, at least 1.
    Q, P : array (n, n) or None
        Positive semidefinite; None is I.
    R : array (m, m) or None
        Positive definite; None is I.
    most_nodes : int
        QPs after which the search gives up.
    tol : float
        By how much a constraint may be violated, in units of its row scaled to length 1.

    Returns
    -------
    MIQPSolution

    Raises
    ------
    ValueError
        If sizes do not match or a weight is not (semi)definite.
    SolverStopped
        If `most_nodes` QPs did not settle the problem.
    SolverError
        If DAQP fails on a QP.
    MissingExtraError
        If DAQP is not installed.

    Notes
    -----
    Best-first branch and bound over mode sequences. A node fixes the modes of the first j steps; its
    QP in u(0..j-1) (DAQP, states eliminated) charges x(j) its stage cost and forgets what follows, so
    its value is a lower bound. The first node of full length to be taken from the queue is optimal.
    The problem is that of Sec. IV.A of [Teichrib2025].
    """
    problem = _Problem(system, horizon, Q, R, P, tol)
    x0 = real_array(x0, "x0", 1)
    require_columns(x0, system.state_size, "x0", "the state's size")
    nodes, order = 0, count()  # `order` breaks ties, so that nodes are never compared
    queue = [(0.0, next(order), problem.root(x0))] if problem.admits(x0) else []
    while queue:
        bound, _, node = heapq.heappop(queue)
        if len(node.modes) == problem.horizon:
            return problem.solution(x0, node, bound, nodes)
        for child in problem.children(node):
            if nodes >= most_nodes:
                raise SolverStopped(
                    f"{nodes} QPs did not settle the problem at x0 = {x0.tolist()}; its cost is at least {bound}. "
                    "Raise most_nodes or shorten the horizon"
                )
            nodes += 1
            value, inputs = _solve_qp(child, tol)
            if inputs is not None:  # a relaxation of a child is never below its parent's, except by rounding
                heapq.heappush(queue, (max(bound, value), next(order), replace(child, inputs=inputs)))
    return MIQPSolution(np.inf, np.inf, None, None, None, nodes)


@dataclass(frozen=True, eq=False)
class _Node:
    """The QP min U'HU/2 + f U + c subject to A U <= b, and the last state x = G U + g, for one mode sequence."""

    modes: tuple
    H: np.ndarray
    f: np.ndarray
    c: float
    A: np.ndarray
    b: np.ndarray
    G: np.ndarray
    g: np.ndarray
    inputs: np.ndarray | None = None


class _Problem:
    """What all nodes share: the system, the weights, and rows scaled to length 1."""

    def __init__(self, system, horizon, Q, R, P, tol):
        if horizon != int(horizon) or horizon < 1:
            raise ValueError(f"horizon must be a whole number of at least 1; got {horizon}")
        self.system, self.horizon, self.tol = system, int(horizon), tol
        n, m = system.state_size, system.input_size
        self.Q, self.P = weight(Q, n, "Q"), weight(P, n, "P")
        self.R = weight(R, m, "R", definite=True)
        self.state_rows = _unit_rows(system.state_set)
        self.input_rows = _unit_rows(system.input_set)
        self.region_rows = [_unit_rows(mode.region) for mode in system.modes]

    def admits(self, x0):
        """Whether x0 lies in X."""
        H, h = self.state_rows
        return bool((H @ x0 <= h + self.tol).all())

    def root(self, x0):
        """No step taken yet, and the stage cost of x(0) charged."""
        none, empty = np.zeros((0, 0)), np.zeros(0)
        return _Node((), none, empty, x0 @ self.Q @ x0, none, empty, np.zeros((len(x0), 0)), x0)

    def children(self, node):
        """The nodes with one more step, but for those that a fixed row already rules out."""
        for index in range(len(self.system.modes)):
            child = self._child(node, index)
            if child is not None:
                yield child

    def _child(self, node, index):
        """The node after one more step in mode `index`, or None if a row without inputs is violated."""
        mode, (n, m), size = self.system.modes[index], self.system.modes[index].B.shape, len(node.f)
        G = np.hstack([node.G, np.zeros((n, m))])  # the state before the step, in the longer input vector
        E = np.hstack([np.zeros((m, size)), np.eye(m)])  # picks the new input out of it
        G_next, g_next = mode.A @ G + mode.B @ E, mode.A @ node.g + mode.p
        (Hr, hr), (Hx, hx), (Hu, hu) = self.region_rows[index], self.state_rows, self.input_rows
        A = np.vstack([Hr[:, :n] @ G + Hr[:, n:] @ E, Hx @ G_next, Hu @ E])
        b = np.concatenate([hr - Hr[:, :n] @ node.g, hx - Hx @ g_next, hu])
        flat = np.abs(A).max(axis=1) <= FLAT
        if (b[flat] < -self.tol).any():
            return None
        # x(j) is charged already: add u(j)'R u(j) and the charge of x(j+1), which P replaces at the end.
        W = self.P if len(node.modes) + 1 == self.horizon else self.Q
        H, f, c = np.zeros((size + m, size + m)), np.zeros(size + m), node.c
        H[:size, :size], f[:size] = node.H, node.f
        H += 2 * (E.T @ self.R @ E + G_next.T @ W @ G_next)
        f += 2 * G_next.T @ W @ g_next
        c += g_next @ W @ g_next
        A = np.vstack([np.hstack([node.A, np.zeros((len(node.A), m))]), A[~flat]])
        return _Node((*node.modes, index), H, f, c, A, np.concatenate([node.b, b[~flat]]), G_next, g_next)

    def solution(self, x0, node, bound, nodes):
        """The trajectory of a node of full length."""
        inputs, states = node.inputs.reshape(self.horizon, -1), [x0]
        for index, u in zip(node.modes, inputs):
            states.append(self.system.modes[index].successor(states[-1], u))
        cost = trajectory_cost(np.array(states), inputs, self.Q, self.R, self.P)
        return MIQPSolution(cost, bound, inputs, np.array(states), np.array(node.modes), nodes)


def trajectory_cost(states, inputs, Q, R, P):
    """sum_{k<N} (x'Qx + u'Ru) + x(N)'P x(N) for states (N + 1, n) and inputs (N, m)."""
    stages = np.einsum("ki,ij,kj->", states[:-1], Q, states[:-1]) + np.einsum("ki,ij,kj->", inputs, R, inputs)
    return float(stages + states[-1] @ P @ states[-1])


def weight(value, size, name, definite=False):
    """A weight as a symmetric array (size, size), None being I; ValueError if it is not (semi)definite."""
    value = np.eye(size) if value is None else real_array(value, name, 2)
    if value.shape != (size, size):
        raise ValueError(f"{name} has shape {value.shape}, but {(size, size)} is needed")
    value = (value + value.T) / 2
    smallest = np.linalg.eigvalsh(value)[0]
    if smallest < -1e-12 * np.abs(value).max() or (definite and smallest <= 1e-12 * np.abs(value).max()):
        kind = "definite" if definite else "semidefinite"
        raise ValueError(f"{name} must be positive {kind}; its smallest eigenvalue is {smallest}")
    return value


def _unit_rows(P):
    """H and h of a polytope with rows of length 1; rows of zeros are left as they are."""
    length = np.linalg.norm(P.H, axis=1)
    length[length == 0] = 1.0
    return P.H / length[:, None], P.h / length


def _solve_qp(node, tol):
    """Value and minimizer of a node's QP; (inf, None) if it is infeasible."""
    try:
        import daqp
    except ImportError as error:
        raise MissingExtraError("solving the MIQP", "daqp", "data") from error
    U, value, flag, _ = daqp.solve(
        node.H, node.f, node.A, node.b, np.full(len(node.b), -1e30), np.zeros(len(node.b), np.int32), primal_tol=tol
    )
    if flag == INFEASIBLE:
        return np.inf, None
    if flag != OPTIMAL:
        raise SolverError(f"DAQP ended the QP of modes {node.modes} with exit flag {flag}")
    return float(value + node.c), np.array(U)
