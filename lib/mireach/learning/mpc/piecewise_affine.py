"""Model predictive control of a piecewise-affine system to proven optimality (case study 1 of [Teichrib2025])."""

import heapq
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import count

import numpy as np

from ...checks import real_array, require_columns, require_kind, whole_number
from ...errors import MissingExtraError, SolverError, SolverStopped
from ...sets.polytope import Polytope
from ...systems.pwa import PWASystem
from ...typing import Array, ArrayLike, IntArray

TOLERANCE = 1e-9  # a constraint counts as met within this, in units of its row after scaling to length 1
FLAT = 1e-12  # a row of a condensed constraint shorter than this, relative to its region's row, does not depend on u
OPTIMAL, INFEASIBLE = 1, -1  # what DAQP's exit flags mean


@dataclass(frozen=True, eq=False)
class MIQPSolution:
    """Result of `solve_miqp`.

    Attributes
    ----------
    cost : float
        Of the trajectory in `inputs` and `states`; inf if no input sequence is feasible.
    bound : float
        Lower bound of the optimal cost (to within the accuracy of the QP solver); inf if
        infeasible.
    inputs : array (N, m) or None
        In units of u.
    states : array (N + 1, n) or None
        In units of x.
    modes : array (N,) of int or None
        Which mode each step takes, counted from 0.
    nodes : int
        QPs that were solved.
    """

    cost: float
    bound: float
    inputs: Array | None
    states: Array | None
    modes: IntArray | None
    nodes: int

    def __repr__(self) -> str:
        return f"MIQPSolution(cost {self.cost:.6g}, gap {self.gap:.2g}, {self.nodes} nodes)"

    @property
    def feasible(self) -> bool:
        """Whether there is an input sequence that meets all constraints."""
        return self.inputs is not None

    @property
    def gap(self) -> float:
        """cost - bound; 0 if infeasible."""
        return self.cost - self.bound if self.feasible else 0.0


def solve_miqp(
    system: PWASystem,
    x0: ArrayLike,
    horizon: int = 10,
    Q: ArrayLike | None = None,
    R: ArrayLike | None = None,
    P: ArrayLike | None = None,
    *,
    max_nodes: int = 100_000,
) -> MIQPSolution:
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
    max_nodes : int
        QPs after which the search gives up.

    Returns
    -------
    MIQPSolution

    Raises
    ------
    TypeError
        If the system is not a PWASystem.
    ValueError
        If sizes do not match or a weight is not (semi)definite.
    SolverStopped
        If `max_nodes` QPs did not settle the problem.
    SolverError
        If DAQP fails on a QP.
    MissingExtraError
        If DAQP is not installed.

    See Also
    --------
    NonlinearMPC : The problem for a nonlinear system, by local optimisation.

    Notes
    -----
    Best-first branch and bound over mode sequences. A node fixes the modes of the first j steps; its
    QP in u(0..j-1) (DAQP, states eliminated) includes the stage cost of x(j) and leaves out what follows, so
    its value is a lower bound. The first node of full length to be taken from the queue is optimal. Constraints hold to
    within `TOLERANCE`. The problem is that of Sec. V.A of [Teichrib2025].

    Examples
    --------
    >>> from mireach.systems.plants import pwa_plant
    >>> solution = solve_miqp(pwa_plant(), [2.0, 1.0], horizon=3)
    >>> solution.feasible, solution.states.shape, solution.inputs.shape
    (True, (4, 2), (3, 1))
    """
    problem = _Problem(system, horizon, Q, R, P)
    x0 = real_array(x0, "x0", 1)
    require_columns(x0, system.state_size, "x0", "the state's size")
    nodes, order = 0, count()  # `order` breaks ties, so that nodes are never compared
    queue = [(0.0, next(order), problem.root(x0))] if problem.admits(x0) else []
    while queue:
        bound, _, node = heapq.heappop(queue)
        if len(node.modes) == problem.horizon:
            return problem.solution(x0, node, bound, nodes)
        for child in problem.children(node):
            if nodes >= max_nodes:
                raise SolverStopped(
                    f"{nodes} QPs did not settle the problem at x0 = {x0.tolist()}; its cost is at least {bound}. "
                    "Raise max_nodes or shorten the horizon"
                )
            nodes += 1
            value, inputs = _solve_qp(child)
            if inputs is not None:  # a relaxation of a child is never below its parent's, except by rounding
                heapq.heappush(queue, (max(bound, value), next(order), replace(child, inputs=inputs)))
    return MIQPSolution(np.inf, np.inf, None, None, None, nodes)


@dataclass(frozen=True, eq=False)
class _Node:
    """The QP min U'HU/2 + f U + c subject to A U <= b, and the last state x = G U + g, for one mode sequence."""

    modes: tuple[int, ...]
    H: Array
    f: Array
    c: float
    A: Array
    b: Array
    G: Array
    g: Array
    inputs: Array | None = None


class _Problem:
    """What all nodes share: the system, the weights, and rows scaled to length 1."""

    def __init__(
        self, system: PWASystem, horizon: int, Q: ArrayLike | None, R: ArrayLike | None, P: ArrayLike | None
    ) -> None:
        require_kind(system, PWASystem, "system")
        self.system, self.horizon = system, whole_number(horizon, "horizon", 1)
        n, m = system.state_size, system.input_size
        self.Q, self.P = weight(Q, n, "Q"), weight(P, n, "P")
        self.R = weight(R, m, "R", definite=True)
        self.state_rows = _unit_rows(system.state_set)
        self.input_rows = _unit_rows(system.input_set)
        self.region_rows = [_unit_rows(mode.region) for mode in system.modes]

    def admits(self, x0: Array) -> bool:
        """Whether x0 lies in X."""
        H, h = self.state_rows
        return bool((H @ x0 <= h + TOLERANCE).all())

    def root(self, x0: Array) -> _Node:
        """The node without a step; its cost is the stage cost of x(0)."""
        none, empty = np.zeros((0, 0)), np.zeros(0)
        return _Node((), none, empty, float(x0 @ self.Q @ x0), none, empty, np.zeros((len(x0), 0)), x0)

    def children(self, node: _Node) -> Iterator[_Node]:
        """The nodes with one more step, except those in which a row without inputs is violated."""
        for index in range(len(self.system.modes)):
            child = self._child(node, index)
            if child is not None:
                yield child

    def _child(self, node: _Node, index: int) -> _Node | None:
        """The node after one more step in mode `index`, or None if a row without inputs is violated."""
        mode, size = self.system.modes[index], len(node.f)
        n, m = mode.B.shape
        G = np.hstack([node.G, np.zeros((n, m))])  # the state before the step, in the longer input vector
        E = np.hstack([np.zeros((m, size)), np.eye(m)])  # picks the new input out of it
        G_next, g_next = mode.A @ G + mode.B @ E, mode.A @ node.g + mode.p
        Hr, hr = self.region_rows[index]
        Hx, hx = self.state_rows
        Hu, hu = self.input_rows
        A = np.vstack([Hr[:, :n] @ G + Hr[:, n:] @ E, Hx @ G_next, Hu @ E])
        b = np.concatenate([hr - Hr[:, :n] @ node.g, hx - Hx @ g_next, hu])
        flat = np.abs(A).max(axis=1) <= FLAT
        if (b[flat] < -TOLERANCE).any():
            return None
        # x(j) is counted already: add u(j)'R u(j) and the cost of x(j+1), with P at the end of the horizon.
        W = self.P if len(node.modes) + 1 == self.horizon else self.Q
        H, f = np.zeros((size + m, size + m)), np.zeros(size + m)
        H[:size, :size], f[:size] = node.H, node.f
        H += 2 * (E.T @ self.R @ E + G_next.T @ W @ G_next)
        f += 2 * G_next.T @ W @ g_next
        c = node.c + float(g_next @ W @ g_next)
        A = np.vstack([np.hstack([node.A, np.zeros((len(node.A), m))]), A[~flat]])
        return _Node((*node.modes, index), H, f, c, A, np.concatenate([node.b, b[~flat]]), G_next, g_next)

    def solution(self, x0: Array, node: _Node, bound: float, nodes: int) -> MIQPSolution:
        """The trajectory of a node of full length."""
        assert node.inputs is not None  # only nodes whose QP was solved have the full length
        inputs, states = node.inputs.reshape(self.horizon, -1), [x0]
        for index, u in zip(node.modes, inputs):
            states.append(self.system.modes[index].successor(states[-1], u))
        cost = trajectory_cost(np.array(states), inputs, self.Q, self.R, self.P)
        return MIQPSolution(cost, bound, inputs, np.array(states), np.array(node.modes), nodes)


def trajectory_cost(states: Array, inputs: Array, Q: Array, R: Array, P: Array) -> float:
    """sum_{k<N} (x'Qx + u'Ru) + x(N)'P x(N).

    Parameters
    ----------
    states : array (N + 1, n)
    inputs : array (N, m)
    Q, P : array (n, n)
    R : array (m, m)

    Examples
    --------
    >>> one = np.eye(1)
    >>> trajectory_cost(np.array([[2.0], [1.0]]), np.array([[3.0]]), one, one, 10 * one)
    23.0
    """
    stages = np.einsum("ki,ij,kj->", states[:-1], Q, states[:-1]) + np.einsum("ki,ij,kj->", inputs, R, inputs)
    return float(stages + states[-1] @ P @ states[-1])


def weight(value: ArrayLike | None, size: int, name: str, definite: bool = False) -> Array:
    """A weight of the cost as a symmetric array (size, size).

    Parameters
    ----------
    value : array (size, size) or None
        None is I. Its symmetric part counts.
    size : int
    name : str
        Names it in messages.
    definite : bool
        Whether it must be positive definite, not only semidefinite.

    Raises
    ------
    ValueError
        If it has another size or is not (semi)definite.

    Examples
    --------
    >>> weight([[1.0, 2.0], [0.0, 3.0]], 2, "Q").tolist()
    [[1.0, 1.0], [1.0, 3.0]]
    """
    value = np.eye(size) if value is None else real_array(value, name, 2)
    if value.shape != (size, size):
        raise ValueError(f"{name} has shape {value.shape}, but {(size, size)} is needed")
    value = (value + value.T) / 2
    smallest = np.linalg.eigvalsh(value)[0]
    if smallest < -1e-12 * np.abs(value).max() or (definite and smallest <= 1e-12 * np.abs(value).max()):
        kind = "definite" if definite else "semidefinite"
        raise ValueError(f"{name} must be positive {kind}; its smallest eigenvalue is {smallest}")
    return value


def _unit_rows(P: Polytope) -> tuple[Array, Array]:
    """H and h of a polytope with rows of length 1; rows of zeros are left as they are."""
    length = np.linalg.norm(P.H, axis=1)
    length[length == 0] = 1.0
    return P.H / length[:, None], P.h / length


def _solve_qp(node: _Node) -> tuple[float, Array | None]:
    """Value and minimizer of a node's QP; (inf, None) if it is infeasible."""
    try:
        import daqp
    except ImportError as error:
        raise MissingExtraError("solving the MIQP", "daqp", "data") from error
    no_lower, inequality = np.full(len(node.b), -1e30), np.zeros(len(node.b), np.int32)
    U, value, flag, _ = daqp.solve(node.H, node.f, node.A, node.b, no_lower, inequality, primal_tol=TOLERANCE)
    if flag == INFEASIBLE:
        return np.inf, None
    if flag != OPTIMAL:
        raise SolverError(f"DAQP ended the QP of modes {node.modes} with exit flag {flag}")
    return float(value + node.c), np.array(U)
