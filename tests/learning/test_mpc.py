"""Optimal control problems against oracles that share no code with them."""

from itertools import product

import numpy as np
import pytest
from scipy.optimize import Bounds, LinearConstraint, milp, minimize

from mireach import Mode, Polytope, PWASystem
from mireach.errors import SolverStopped
from mireach.learning.mpc import NonlinearMPC, solve_miqp
from mireach.systems.plants import double_integrator_plant, pwa_plant

pytest.importorskip("daqp")


def least_cost(system, x0, x, u):
    """What no trajectory from x0 undercuts with Q = R = P = I, by a big-M MILP of scipy in place of the MIQP.

    In it every square is the highest one of some of its tangents, so its optimum is a lower bound, and a close one if
    the best trajectory is near x (horizon + 1, n) and u (horizon, m).
    """
    horizon, n, modes = len(u), system.state_size, system.modes
    points = np.concatenate([x.ravel(), u.ravel()])
    states, inputs = np.split(np.arange(points.size), [x.size])
    states, inputs = states.reshape(x.shape), inputs.reshape(u.shape)
    squares = points.size + np.arange(points.size)
    chosen = 2 * points.size + np.arange(horizon * len(modes)).reshape(horizon, -1)
    rows, limits = [], []

    def add(columns, coefficients, limit):
        rows.append(np.zeros(chosen.max() + 1))
        rows[-1][columns] = coefficients
        limits.append(limit)

    for k, (i, mode) in product(range(horizon), enumerate(modes)):
        M = 10 + 10 * np.abs(mode.A).sum(axis=1) + np.abs(mode.B).sum(axis=1)
        for j, sign in product(range(n), (1, -1)):
            columns = [states[k + 1, j], *states[k], *inputs[k], chosen[k, i]]
            add(columns, [sign, *(-sign * mode.A[j]), *(-sign * mode.B[j]), M[j]], sign * mode.p[j] + M[j])
        for a, b in zip(mode.region.H, mode.region.h):
            add([*states[k], *inputs[k], chosen[k, i]], [*a, 10], b + 10)
    limit = np.concatenate([np.full(x.size, 10.0), np.full(u.size, 1.0)])
    near = np.concatenate([-(0.3 ** np.arange(1, 5)), [0], 0.3 ** np.arange(1, 5)])
    for column, (point, reach) in enumerate(zip(points, limit)):
        for t in [*(point + near), *np.linspace(-reach, reach, 9)]:
            add([column, squares[column]], [2 * t, -1], t**2)
    low = np.concatenate([-limit, np.zeros(points.size + chosen.size)])
    high = np.concatenate([limit, np.full(points.size, 100.0), np.ones(chosen.size)])
    low[states[0]] = high[states[0]] = x0
    one = np.zeros((horizon, len(low)))
    np.put_along_axis(one, chosen, 1, axis=1)
    found = milp(
        np.isin(np.arange(len(low)), squares).astype(float),
        integrality=np.isin(np.arange(len(low)), chosen),
        bounds=Bounds(low, high),
        constraints=[LinearConstraint(np.array(rows), ub=limits), LinearConstraint(one, 1, 1)],
    )
    return found.mip_dual_bound


def sequence_cost(system, x0, sequence):
    """Optimal cost of one mode sequence by SLSQP on a simulation; inf if no start leads to a feasible point."""

    def states(u):
        x = [np.asarray(x0, float)]
        for k, i in enumerate(sequence):
            x.append(system.modes[i].A @ x[-1] + system.modes[i].B @ u[[k]] + system.modes[i].p)
        return np.array(x)

    def slack(u):
        x = states(u)
        inside = [system.modes[i].region.h - system.modes[i].region.H @ [*x[k], u[k]] for k, i in enumerate(sequence)]
        return np.concatenate([*inside, 10 - x.ravel(), 10 + x.ravel()])

    found = minimize(
        lambda u: (states(u) ** 2).sum() + u @ u,
        np.zeros(len(sequence)),
        bounds=[(-1, 1)] * len(sequence),
        constraints={"type": "ineq", "fun": slack},
        method="SLSQP",
        options={"ftol": 1e-12},
    )
    return found.fun if found.success and slack(found.x).min() > -1e-7 else np.inf


@pytest.fixture(scope="module")
def plant():
    return pwa_plant()


def check_solution(system, x0, solution):
    """The trajectory meets every constraint, follows the modes it names, and costs what it says."""
    x, u = solution.states, solution.inputs
    assert np.abs(x[0] - x0).max() == 0 and np.abs(x).max() <= 10 + 1e-8 and np.abs(u).max() <= 1 + 1e-8
    for k, i in enumerate(solution.modes):
        mode = system.modes[i]
        assert (mode.region.H @ [*x[k], *u[k]] <= mode.region.h + 1e-8).all()
        np.testing.assert_allclose(x[k + 1], mode.A @ x[k] + mode.B @ u[k] + mode.p, atol=1e-12)
    assert solution.cost == pytest.approx((x**2).sum() + (u**2).sum(), rel=1e-12)
    assert abs(solution.gap) <= 1e-8 * (1 + solution.cost)


@pytest.mark.parametrize("x0", [(-7.3, 8.52), (-7.3, -10), (8, 8), (3.5, -6), (0.4, -0.3)])
def test_no_trajectory_is_cheaper_than_that_of_the_miqp(plant, x0):
    solution = solve_miqp(plant, x0)
    check_solution(plant, x0, solution)
    lower = least_cost(plant, x0, solution.states, solution.inputs)
    assert lower - 1e-6 <= solution.cost <= lower + 1e-4 * (1 + lower)


def test_miqp_agrees_with_all_mode_sequences(plant):
    rng = np.random.default_rng(1)
    for x0 in rng.uniform(-9, 9, (4, 2)):
        quadrant = [i for i in range(4) if plant.violation(x0[None], np.zeros((1, 1)))[0, i] == 0]
        best = min(sequence_cost(plant, x0, [*quadrant, *rest]) for rest in product(range(4), repeat=2))
        solution = solve_miqp(plant, x0, horizon=3)
        check_solution(plant, x0, solution)
        assert solution.cost == pytest.approx(best, rel=1e-6)


def test_miqp_infeasible_corner(plant):
    # In the third quadrant x2+ = 0.491 x1 + 0.62 x2, whatever the input is.
    assert not solve_miqp(plant, [-9.0, -9.5]).feasible
    assert solve_miqp(plant, [-9.0, -8.9]).feasible
    outside = solve_miqp(plant, [10.5, 0])
    assert outside.inputs is None and outside.cost == np.inf and outside.gap == 0


@pytest.mark.parametrize("x0", [(0, 3), (0, -4), (5, 0), (-6, 0), (0, 0)])
def test_miqp_takes_the_cheaper_mode_of_a_boundary(plant, x0):
    touching = [i for i in range(4) if plant.violation(np.array([x0], float), np.zeros((1, 1)))[0, i] == 0]
    best = min(sequence_cost(plant, x0, [first, *rest]) for first in touching for rest in product(range(4), repeat=1))
    assert solve_miqp(plant, x0, horizon=2).cost == pytest.approx(best, rel=1e-6, abs=1e-9)


def test_miqp_regions_may_depend_on_the_input():
    # x+ = x + u for u >= 0, x+ = x + 2 u for u <= 0: braking from x = 1 is worth more with the second mode.
    line = Polytope.box([-5], [5])
    up = Mode([[1]], [[1]], [0], Polytope([[0, -1]], [0]))
    down = Mode([[1]], [[2]], [0], Polytope([[0, 1]], [0]))
    system = PWASystem([up, down], line, Polytope.box([-1], [1]))
    for x0, gain in ((1.0, 2.0), (-1.0, 1.0)):
        expected = -gain * x0 / (1 + gain**2)  # the minimizer of (x0 + gain u)^2 + u^2
        assert solve_miqp(system, [x0], horizon=1).inputs[0, 0] == pytest.approx(expected, abs=1e-8)


def test_miqp_unconstrained_is_the_regulator():
    A, B = np.array([[1.0, 0.5], [0.0, 1.0]]), np.array([[0.1], [0.5]])
    wide = Polytope.box([-1e3] * 2, [1e3] * 2)
    everywhere = Polytope(np.zeros((1, 3)), [1.0])
    system = PWASystem([Mode(A, B, np.zeros(2), everywhere)], wide, Polytope.box([-1e3], [1e3]))
    Q, R, P = np.diag([2.0, 1.0]), np.array([[0.3]]), np.diag([5.0, 4.0])
    S = P
    for _ in range(6):  # Riccati recursion
        K = np.linalg.solve(R + B.T @ S @ B, B.T @ S @ A)
        S = Q + A.T @ S @ (A - B @ K)
    x0 = np.array([3.0, -2.0])
    solution = solve_miqp(system, x0, horizon=6, Q=Q, R=R, P=P)
    assert solution.cost == pytest.approx(x0 @ S @ x0, rel=1e-9)
    np.testing.assert_allclose(solution.inputs[0], -K @ x0, atol=1e-7)


def test_miqp_refuses_what_it_cannot_solve(plant):
    with pytest.raises(ValueError, match="horizon"):
        solve_miqp(plant, [1, 1], horizon=0)
    with pytest.raises(ValueError, match="R must be positive definite"):
        solve_miqp(plant, [1, 1], R=[[0.0]])
    with pytest.raises(ValueError, match="x0"):
        solve_miqp(plant, [1, 1, 1])
    with pytest.raises(SolverStopped, match="max_nodes"):
        solve_miqp(plant, [1, 1], max_nodes=3)
    with pytest.raises(TypeError, match="system must be of the kind PWASystem"):
        solve_miqp(double_integrator_plant(), [1, 1])


def test_miqp_solution_is_shown_in_one_line(plant):
    solution = solve_miqp(plant, [1, 1], horizon=2)
    assert str(solution) == f"MIQPSolution(cost {solution.cost:.6g}, gap {solution.gap:.2g}, {solution.nodes} nodes)"


# -- case 2 ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def mpc():
    pytest.importorskip("casadi")
    return NonlinearMPC(double_integrator_plant())


def integrator(x, u):
    return np.array([x[0] + x[1] + 0.5 * u, x[1] + u]) + 0.025 * (x[0] ** 2 + x[1] ** 2)


def feedback_cost(x0, gain, horizon=10):
    """Cost of u = clip(-gain x) on case 2; inf where a constraint is violated."""
    x, cost = np.asarray(x0, float), 0.0
    for _ in range(horizon):
        u = np.clip(-gain @ x, -2, 2)
        cost += 0.8 * x @ x + 0.1 * u * u
        x = integrator(x, u)
        if np.abs(x).max() > 6:
            return np.inf
    return cost + 0.8 * x @ x


@pytest.mark.parametrize("x0", [(5.5, -1.5), (-4, 2), (1, 1), (-6, 4), (3, -3)])
def test_nonlinear_solution_is_feasible_and_beats_feedback(mpc, x0):
    solution = mpc.solve(x0)
    x, u = solution.states, solution.inputs
    assert np.abs(x).max() <= 6 + 1e-6 and np.abs(u).max() <= 2 + 1e-8
    for k in range(10):
        np.testing.assert_allclose(x[k + 1], integrator(x[k], u[k, 0]), atol=1e-9)
    cost = 0.8 * (x**2).sum() + 0.1 * (u**2).sum()
    assert solution.cost == pytest.approx(cost, rel=1e-12)
    gains = [np.array(gain) for gain in product(np.linspace(0.1, 1, 10), np.linspace(0.3, 1.8, 10))]
    rivals = [feedback_cost(x0, gain) for gain in gains]
    assert np.isfinite(min(rivals)) and solution.cost <= min(rivals) + 1e-6


def test_nonlinear_solution_is_a_local_optimum(mpc):
    solution, rng = mpc.solve([4.0, -2.0]), np.random.default_rng(2)
    for _ in range(300):
        u = np.clip(solution.inputs[:, 0] + rng.normal(0, 10.0 ** rng.uniform(-4, 0), 10), -2, 2)
        x, cost = np.array([4.0, -2.0]), 0.0
        for value in u:
            cost += 0.8 * x @ x + 0.1 * value**2
            x = integrator(x, value)
            if np.abs(x).max() > 6:
                break
        else:
            assert cost + 0.8 * x @ x >= solution.cost - 1e-7


def test_nonlinear_at_rest_and_out_of_reach(mpc):
    rest = mpc.solve([0.0, 0.0])
    assert abs(rest.cost) < 1e-8 and np.abs(rest.inputs).max() < 1e-4
    # From (6, 6), x1+ = 12 + 0.5 u + 1.8 > 6 for every u.
    assert not mpc.solve([6.0, 6.0]).feasible
    assert not mpc.solve([6.5, 0.0]).feasible


def test_nonlinear_random_starts_do_not_change_what_other_starts_solve(mpc):
    first, second = mpc.solve([1.0, -2.0], rng=1), mpc.solve([1.0, -2.0], rng=np.random.default_rng(2))
    np.testing.assert_array_equal(first.inputs, second.inputs)
    assert str(first) == f"NonlinearSolution(cost {first.cost:.6g}, {first.solved} starts solved)"
    assert str(mpc) == "NonlinearMPC(horizon 10, 2 states, 1 inputs)"


def test_nonlinear_refuses_what_it_cannot_solve(plant):
    pytest.importorskip("casadi")
    with pytest.raises(TypeError, match="system must be of the kind NonlinearSystem"):
        NonlinearMPC(plant)
    with pytest.raises(ValueError, match="horizon must be a whole number of at least 1"):
        NonlinearMPC(double_integrator_plant(), horizon=0)


def test_nonlinear_on_a_linear_system_is_the_miqp():
    from mireach import NonlinearSystem

    box, inputs = Polytope.box([-6, -6], [6, 6]), Polytope.box([-1], [1])
    linear = NonlinearSystem(lambda x, u: (x[0] + x[1] + 0.5 * u[0], x[1] + u[0]), box, inputs)
    mode = Mode([[1, 1], [0, 1]], [[0.5], [1]], [0, 0], Polytope(np.zeros((1, 3)), [1.0]))
    system = PWASystem([mode], box, inputs)
    mpc = NonlinearMPC(linear, horizon=6)
    for x0 in ([4.0, -1.0], [-3.0, 2.0], [2.0, 1.0]):
        exact = solve_miqp(system, x0, horizon=6, Q=0.8 * np.eye(2), R=[[0.1]], P=0.8 * np.eye(2))
        found, mirrored = mpc.solve(x0), mpc.solve([-value for value in x0])
        assert found.cost == pytest.approx(exact.cost, rel=1e-6)
        assert mirrored.cost == pytest.approx(found.cost, rel=1e-6)  # the linear problem is symmetric
        np.testing.assert_allclose(found.inputs, exact.inputs, atol=1e-3)
    weights = {"Q": np.diag([2.0, 1.0]), "R": [[0.3]], "P": np.diag([5.0, 4.0])}
    exact = solve_miqp(system, [2.0, 1.0], horizon=4, **weights)
    assert NonlinearMPC(linear, horizon=4, **weights).solve([2.0, 1.0]).cost == pytest.approx(exact.cost, rel=1e-6)
