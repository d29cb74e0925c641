"""Functions, regions and oracles for the tests of fits and of their proven errors."""

import numpy as np
from scipy.optimize import minimize

import mireach as mr

X6, U2 = mr.Polytope.box([-6, -6], [6, 6]), mr.Polytope.box([-2], [2])
NINE = [mr.Polytope.box([k - 2, j - 2, -2], [k + 2, j + 2, 2]) for k in (-4, 0, 4) for j in (-4, 0, 4)]
ROUNDING = 1e-13  # of f - f_PWA in floating point, against a bound that has none


def double_integrator(x, u):
    """Eq. NL_DI."""
    square = 0.025 * (x[0] ** 2 + x[1] ** 2)
    return [x[0] + x[1] + 0.5 * u[0] + square, x[1] + u[0] + square]


DI = mr.NonlinearSystem(double_integrator, X6, U2)


def errors_at(f, mode, points):
    """f - A x - B u - p at points (N, n+m), array (N, n)."""
    n = len(mode.A)
    x, u = points[:, :n], points[:, n:]
    return np.stack(np.broadcast_arrays(*f(x.T, u.T)), axis=-1) - mode.successor(x, u)


def largest_by_climbing(f, mode, part, directions, rng):
    """Largest v e found by random points, vertices, and SLSQP from the best of them, (k,)."""
    points = np.vstack([part.sample(rng, 3000), part.vertices()])
    errors = errors_at(f, mode, points) @ directions.T
    rows = {"type": "ineq", "fun": lambda z: part.h - part.H @ z, "jac": lambda z: -part.H}
    best = errors[part.contains(points)].max(axis=0)
    for k, v in enumerate(directions):
        for start in points[np.argsort(errors[:, k])[[-1, -20, -200]]]:
            answer = minimize(
                lambda z, v=v: -errors_at(f, mode, z[None])[0] @ v,
                start,
                method="SLSQP",
                constraints=[rows],
                options={"ftol": 1e-13, "maxiter": 100},
            )
            inside = answer.x + 1e-8 * (part.chebyshev()[0] - answer.x)
            if part.contains(inside):
                best[k] = max(best[k], errors_at(f, mode, inside[None])[0] @ v)
    return best


def slabs(normal, offset):
    """The two halves of space on either side of normal z = offset."""
    return [mr.Polytope([normal], [offset]), mr.Polytope([-np.asarray(normal)], [-offset])]


SMOOTH = {
    "sine and exponential": lambda x, u: [np.sin(x[0]) + 0.3 * np.exp(0.5 * x[1]) + u[0], np.tanh(x[0]) + 0.5 * u[0]],
    "pendulum": lambda x, u: [x[0] + 0.1 * x[1], x[1] + 0.1 * np.sin(x[0]) + 0.1 * u[0]],
    "products": lambda x, u: [x[0] * u[0] + np.cos(x[1]), x[1] * x[0] ** 3],
    "fractions": lambda x, u: [x[0] / (3 + x[1]), np.sqrt(4 + x[1]) * u[0] + np.log(3 + x[0])],
}
