"""Model predictive control of a nonlinear system by local optimization (case study 2 of [Teichrib2025])."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...checks import real_array, require_columns, require_kind, whole_number
from ...errors import MissingExtraError
from ...systems.nonlinear import NonlinearSystem
from ...typing import Array, ArrayLike
from .piecewise_affine import trajectory_cost, weight

TOLERANCE = 1e-8  # IPOPT's `tol`, and by how much a constraint may be violated (units of x and u)
CONSTANT_STARTS = 3  # constant inputs, evenly spread over U, that are rolled out as starts
SEARCH_STARTS = 6  # further random starts, for states where no start has led anywhere yet


@dataclass(frozen=True, eq=False)
class NonlinearSolution:
    """Result of `NonlinearMPC.solve`.

    Attributes
    ----------
    cost : float
        Of the best feasible trajectory; inf if no start led to one.
    inputs : array (N, m) or None
        In units of u.
    states : array (N + 1, n) or None
        In units of x.
    solved : int
        Starts that ended in a feasible local optimum.
    """

    cost: float
    inputs: Array | None
    states: Array | None
    solved: int

    def __repr__(self) -> str:
        return f"NonlinearSolution(cost {self.cost:.6g}, {self.solved} starts solved)"

    @property
    def feasible(self) -> bool:
        """Whether there is a feasible trajectory in `inputs`; False does not prove that none exists."""
        return self.inputs is not None


class NonlinearMPC:
    """min sum_{k<N} (x(k)'Q x(k) + u(k)'R u(k)) + x(N)'P x(N) over x(k+1) = f(x(k), u(k)).

    Subject to x(k) in X for k = 0..N and u(k) in U for k < N. The problem is set up once, then solved
    for several states.

    Parameters
    ----------
    system : NonlinearSystem
        f is evaluated on CasADi symbols.
    horizon : int
        N, at least 1.
    Q, P : array (n, n) or None
        Positive semidefinite; None is 0.8 I, the weight of case study 2.
    R : array (m, m) or None
        Positive definite; None is 0.1 I.

    Raises
    ------
    TypeError
        If the system is not a NonlinearSystem.
    ValueError
        If a weight has the wrong size or is not (semi)definite, or the horizon is not a whole number of at least 1.
    MissingExtraError
        If CasADi is not installed.

    See Also
    --------
    solve_miqp : The problem for a piecewise-affine system, to proven optimality.

    Notes
    -----
    Multiple shooting, solved by IPOPT from several starts of which the best result is kept. Constraints hold to within
    `TOLERANCE`. The problem is not convex: a better optimum may exist, and a feasible trajectory where no start led to
    one.
    The weights are those of Sec. IV of [Lueken2024], which [Teichrib2025] refers to; the small charge
    on changes of the input in its public code is left out.

    Examples
    --------
    >>> from mireach.systems.plants import double_integrator_plant
    >>> mpc = NonlinearMPC(double_integrator_plant(), horizon=3)
    >>> mpc
    NonlinearMPC(horizon 3, 2 states, 1 inputs)
    >>> mpc.solve([1.0, 0.0]).inputs[0].round(3).tolist()
    [-0.64]
    """

    def __init__(
        self,
        system: NonlinearSystem,
        horizon: int = 10,
        Q: ArrayLike | None = None,
        R: ArrayLike | None = None,
        P: ArrayLike | None = None,
    ) -> None:
        require_kind(system, NonlinearSystem, "system")
        self.system, self.horizon = system, whole_number(horizon, "horizon", 1)
        n, m = system.state_set.dimension, system.input_set.dimension
        self.Q = weight(0.8 * np.eye(n) if Q is None else Q, n, "Q")
        self.P = weight(0.8 * np.eye(n) if P is None else P, n, "P")
        self.R = weight(0.1 * np.eye(m) if R is None else R, m, "R", definite=True)
        self._box = system.state_set.bounding_box()
        self._solver, self._limits = self._program()

    def __repr__(self) -> str:
        return f"NonlinearMPC(horizon {self.horizon}, {len(self.Q)} states, {len(self.R)} inputs)"

    def solve(self, x0: ArrayLike, rng: np.random.Generator | int = 0) -> NonlinearSolution:
        """The best local optimum from several starts.

        Parameters
        ----------
        x0 : array (n,)
        rng : numpy.random.Generator or int
            Draws inputs to start from, for states from which no other start is solved; an int is a seed.

        Returns
        -------
        NonlinearSolution
            The states are those of f under the inputs, not the solver's. A state outside X has no solution.

        Raises
        ------
        ValueError
            If x0 does not have n entries.
        """
        x0 = real_array(x0, "x0", 1)
        require_columns(x0, self.system.state_set.dimension, "x0", "the state's size")
        best, solved = NonlinearSolution(np.inf, None, None, 0), 0
        if not self.system.state_set.contains(x0, tol=TOLERANCE):
            return best
        for number, (states, inputs) in enumerate(self._starts(x0, np.random.default_rng(rng))):
            if solved and number > CONSTANT_STARTS:
                break  # the random starts are for states that have no trajectory yet
            solution = self._attempt(x0, states, inputs)
            if solution is not None:
                solved += 1
                best = min(best, solution, key=lambda one: one.cost)
        return NonlinearSolution(best.cost, best.inputs, best.states, solved)

    def _program(self) -> tuple[Any, tuple[Array, Array]]:
        """IPOPT on the variables (u(0..N-1), x(1..N)) with parameter x(0), and its constraint limits."""
        try:
            import casadi
        except ImportError as error:
            raise MissingExtraError("nonlinear MPC", "casadi", "data") from error
        system, N = self.system, self.horizon
        n, m = system.state_set.dimension, system.input_set.dimension
        x0 = casadi.SX.sym("x0", n)
        inputs, states = casadi.SX.sym("u", m, N), casadi.SX.sym("x", n, N)
        cost, x = 0, x0
        defects: list[Any] = []
        limits: list[Any] = []
        for k in range(N):
            u, after = inputs[:, k], states[:, k]
            cost += x.T @ self.Q @ x + u.T @ self.R @ u
            defects.append(after - casadi.vertcat(*system.f(x, u)))
            limits += [system.input_set.H @ u - system.input_set.h, system.state_set.H @ after - system.state_set.h]
            x = after
        cost += x.T @ self.P @ x
        problem = {
            "x": casadi.vertcat(casadi.vec(inputs), casadi.vec(states)),
            "p": x0,
            "f": cost,
            "g": casadi.vertcat(*defects, *limits),
        }
        quiet = {"print_level": 0, "sb": "yes", "max_iter": 300, "tol": TOLERANCE, "bound_relax_factor": 0.0}
        options: dict[str, Any] = {"ipopt": quiet, "print_time": False}
        solver = casadi.nlpsol("mpc", "ipopt", problem, options)
        lower = np.full(problem["g"].shape[0], -np.inf)
        lower[: n * N] = 0.0
        return solver, (lower, np.zeros(len(lower)))

    def _starts(self, x0: Array, rng: np.random.Generator) -> Iterator[tuple[Array, Array]]:
        """Trajectories to begin from: rest, rolled-out constant inputs, then rolled-out random inputs."""
        N, U = self.horizon, self.system.input_set
        corners = U.vertices()
        yield np.outer(np.linspace(1, 0, N + 1), x0), np.zeros((N, U.dimension))
        for share in np.linspace(0, 1, CONSTANT_STARTS):
            constant = (1 - share) * corners[0] + share * corners[-1]
            yield self._rollout(x0, np.tile(constant, (N, 1)))
        for inputs in U.sample(rng, SEARCH_STARTS * N).reshape(SEARCH_STARTS, N, -1):
            yield self._rollout(x0, inputs)

    def _rollout(self, x0: Array, inputs: Array) -> tuple[Array, Array]:
        """States (N + 1, n) under `inputs`, each cut back to the bounding box of X; and the inputs."""
        lower, upper = self._box
        path = [x0]
        for u in inputs:
            path.append(np.clip(self.system(path[-1], u), lower, upper))
        return np.array(path), inputs

    def _attempt(self, x0: Array, states: Array, inputs: Array) -> NonlinearSolution | None:
        """One run of IPOPT; None if it ends without a feasible trajectory."""
        lower, upper = self._limits
        start = np.concatenate([inputs.ravel(), states[1:].ravel()])
        result = self._solver(x0=start, p=x0, lbg=lower, ubg=upper)
        if not self._solver.stats()["success"]:
            return None
        inputs = np.array(result["x"]).ravel()[: inputs.size].reshape(inputs.shape)
        path = [x0]
        for u in inputs:
            path.append(self.system(path[-1], u))
        states = np.array(path)
        meets = self.system.state_set.contains(states, tol=100 * TOLERANCE).all()  # defects add up along the horizon
        if not (meets and self.system.input_set.contains(inputs, tol=TOLERANCE).all()):
            return None
        return NonlinearSolution(trajectory_cost(states, inputs, self.Q, self.R, self.P), inputs, states, 1)
