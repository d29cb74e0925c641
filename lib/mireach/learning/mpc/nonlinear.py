"""Model predictive control of a nonlinear system by local optimization (case study 2 of [Teichrib2025])."""

from dataclasses import dataclass

import numpy as np

from ...checks import real_array, require_columns
from ...errors import MissingExtraError
from .piecewise_affine import trajectory_cost, weight

TOLERANCE = 1e-8  # IPOPT's `tol`, and by how much a constraint may be violated (units of x and u)
CONSTANT_STARTS = 3  # constant inputs, evenly spread over U, that are rolled out as starts
SEARCH_STARTS = 6  # further random starts, for states where no start has led anywhere yet


@dataclass(frozen=True, eq=False)
class NonlinearSolution:
    """Answer of `NonlinearMPC.solve`.

    Attributes
    ----------
    cost : float
        Of the best trajectory that was found; inf if none was.
    inputs : array (N, m) or None
    states : array (N + 1, n) or None
    solved : int
        Starts that ended in a feasible local optimum.
    """

    cost: float
    inputs: np.ndarray | None
    states: np.ndarray | None
    solved: int

    @property
    def feasible(self):
        """Whether a feasible trajectory was found; False is no proof that there is none."""
        return self.inputs is not None


class NonlinearMPC:
    """min sum_{k<N} (x(k)'Q x(k) + u(k)'R u(k)) + x(N)'P x(N) over x(k+1) = f(x(k), u(k)).

    Subject to x(k) in X for k = 0..N and u(k) in U for k < N. The problem is set up once, then solved
    for one state after another.

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
    tol : float
        IPOPT's tolerance, and by how much a constraint may be violated (units of x and u).

    Raises
    ------
    MissingExtraError
        If CasADi is not installed.

    Notes
    -----
    Multiple shooting, solved by IPOPT from several starts of which the best result is kept. The
    problem is not convex: a better optimum, or a feasible trajectory where none was found, may exist.
    The weights are those of Sec. IV of [Lueken2024], which [Teichrib2025] refers to; the small charge
    on changes of the input in its public code is left out.
    """

    def __init__(self, system, horizon=10, Q=None, R=None, P=None, tol=TOLERANCE):
        if horizon != int(horizon) or horizon < 1:
            raise ValueError(f"horizon must be a whole number of at least 1; got {horizon}")
        self.system, self.horizon, self.tol = system, int(horizon), tol
        n, m = system.state_set.dimension, system.input_set.dimension
        self.Q = weight(0.8 * np.eye(n) if Q is None else Q, n, "Q")
        self.P = weight(0.8 * np.eye(n) if P is None else P, n, "P")
        self.R = weight(0.1 * np.eye(m) if R is None else R, m, "R", definite=True)
        self._box = system.state_set.bounding_box()
        self._solver, self._limits = self._program()

    def solve(self, x0):
        """The best local optimum from several starts.

        Parameters
        ----------
        x0 : array (n,)

        Returns
        -------
        NonlinearSolution
            The states are those of f under the inputs, not the solver's.
        """
        x0 = real_array(x0, "x0", 1)
        require_columns(x0, self.system.state_set.dimension, "x0", "the state's size")
        best, solved = NonlinearSolution(np.inf, None, None, 0), 0
        if not self.system.state_set.contains(x0, tol=self.tol):
            return best
        for number, (states, inputs) in enumerate(self._starts(x0)):
            if solved and number > CONSTANT_STARTS:
                break  # the random starts are for states that have no trajectory yet
            found = self._attempt(x0, states, inputs)
            if found is not None:
                solved += 1
                best = min(best, found, key=lambda solution: solution.cost)
        return NonlinearSolution(best.cost, best.inputs, best.states, solved)

    def _program(self):
        """IPOPT on the variables (u(0..N-1), x(1..N)) with parameter x(0), and its constraint limits."""
        try:
            import casadi
        except ImportError as error:
            raise MissingExtraError("nonlinear MPC", "casadi", "data") from error
        system, N = self.system, self.horizon
        n, m = system.state_set.dimension, system.input_set.dimension
        x0, inputs, states = casadi.SX.sym("x0", n), casadi.SX.sym("u", m, N), casadi.SX.sym("x", n, N)
        cost, defects, limits, x = 0, [], [], x0
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
        quiet = {"print_level": 0, "sb": "yes", "max_iter": 300, "tol": self.tol, "bound_relax_factor": 0.0}
        solver = casadi.nlpsol("mpc", "ipopt", problem, {"ipopt": quiet, "print_time": False})
        lower = np.full(problem["g"].shape[0], -np.inf)
        lower[: n * N] = 0.0
        return solver, (lower, np.zeros(len(lower)))

    def _starts(self, x0):
        """Trajectories to begin from: rest, rolled-out constant inputs, then rolled-out random inputs."""
        N, U = self.horizon, self.system.input_set
        corners, rng = U.vertices(), np.random.default_rng(0)
        yield np.outer(np.linspace(1, 0, N + 1), x0), np.zeros((N, U.dimension))
        for share in np.linspace(0, 1, CONSTANT_STARTS):
            constant = (1 - share) * corners[0] + share * corners[-1]
            yield self._rollout(x0, np.tile(constant, (N, 1)))
        for inputs in U.sample(rng, SEARCH_STARTS * N).reshape(SEARCH_STARTS, N, -1):
            yield self._rollout(x0, inputs)

    def _rollout(self, x0, inputs):
        """States (N + 1, n) under `inputs`, each cut back to the bounding box of X; and the inputs."""
        lower, upper = self._box
        states = [x0]
        for u in inputs:
            states.append(np.clip(self.system(states[-1], u), lower, upper))
        return np.array(states), inputs

    def _attempt(self, x0, states, inputs):
        """One run of IPOPT; None if it ends without a feasible trajectory."""
        lower, upper = self._limits
        start = np.concatenate([inputs.ravel(), states[1:].ravel()])
        result = self._solver(x0=start, p=x0, lbg=lower, ubg=upper)
        if not self._solver.stats()["success"]:
            return None
        inputs = np.array(result["x"]).ravel()[: inputs.size].reshape(inputs.shape)
        states = [x0]
        for u in inputs:
            states.append(self.system(states[-1], u))
        states = np.array(states)
        meets = self.system.state_set.contains(states, tol=100 * self.tol).all()  # defects add up along the horizon
        if not (meets and self.system.input_set.contains(inputs, tol=self.tol).all()):
            return None
        return NonlinearSolution(trajectory_cost(states, inputs, self.Q, self.R, self.P), inputs, states, 1)
