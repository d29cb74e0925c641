"""Checks of exercise 07: piecewise-affine fits and proven errors."""

from typing import Any

import numpy as np

from ..approximation.fit import fit_pwa
from ..sets.polytope import Polytope
from ..studies.case_studies import double_integrator_fit
from ..systems.plants import INTEGRATOR_CURVATURE, chessboard, double_integrator_plant
from ..typing import Array
from .common import require, require_array, require_filled, require_instance, require_number, require_whole, text

DECEIVED = 0.02  # task 2: by how much the error at a state must exceed that of the grid (units of x)
WANTED = 0.02  # task 5: error that the fits must not exceed (units of x)
ROUNDING = 1e-9
TIGHT = 5.0  # task 6: allowed excess of a bound over an interval of width w, as a multiple of w^2


def check_t1(grid_error: Any) -> None:
    """Task 1: grid_error(side, points), the largest error at the grid of a least-squares fit on a square.

    Parameters
    ----------
    grid_error : callable
        float, int -> number.

    Raises
    ------
    Wrong
        With a side, a number of points, and by how much the answer is off.
    """
    rng = np.random.default_rng()
    for points in (*rng.permutation(np.arange(4, 16))[:4].tolist(), 3, 10):
        side = rng.uniform(1, 6)
        middle = rng.uniform(-2, 2, 2)
        truth = _fit_square(middle, side, points)[1]
        value = require_number(grid_error(side, points), "grid_error(side, points)")
        hint = "" if points != 3 else " (with 3 points the middle of the square is one of them)"
        require(
            abs(value - truth) <= 1e-8,
            f"grid_error(side = {side:.3f}, points = {points}) = {value:.6f} is off by {abs(value - truth):.2g}{hint}",
        )
    print("ok: the error at the grid, for squares anywhere in the plane")


def check_t2(points: Any, x: Any) -> None:
    """Task 2: a grid of `points` >= 3 per axis on [-2, 2]^2 that hides an error at the state x.

    Parameters
    ----------
    points : int
    x : array (2,)

    Raises
    ------
    Wrong
        If the error at x does not exceed that of the grid by `DECEIVED`.
    """
    count, x = require_whole(points, "points", 3, 50), require_array(x, (2,), "x")
    require(np.abs(x).max() <= 2, f"x = {text(x)} is not in the square [-2, 2]^2")
    theta, largest = _fit_square(np.zeros(2), 4.0, count)
    here = float(np.abs(_bend(x[None]) - np.array([[*x, 1.0]]) @ theta)[0])
    require(
        here >= largest + DECEIVED,
        f"with {count} points the largest error at the grid is {largest:.4f}, and the error at x is {here:.4f}; it "
        f"shall be larger by {DECEIVED}",
    )
    print(f"ok: the largest error at the grid is {largest:.4f}, but at x = {text(x)} the error is {here:.4f}")


def check_t3(minimax_mode: Any) -> None:
    """Task 3: minimax_mode(lower, upper) = (A, B, p) with the smallest largest error on a box of states.

    Parameters
    ----------
    minimax_mode : callable
        (2,), (2,) -> arrays (2, 2), (2, 1), (2,).

    Raises
    ------
    Wrong
        With a point at which the error is larger than necessary.
    """
    rng, plant = np.random.default_rng(), double_integrator_plant()
    for _ in range(5):
        lower = rng.uniform(-6, 3, 2)
        upper = lower + rng.uniform(1, 3, 2)
        answer = minimax_mode(lower, upper)
        require_filled(answer, "minimax_mode")
        require(len(answer) == 3, f"minimax_mode must return (A, B, p); got {len(answer)} items")
        A, B, p = (require_array(part, shape, n) for part, shape, n in zip(answer, ((2, 2), (2, 1), (2,)), "ABp"))
        ends = np.stack(np.meshgrid(*np.transpose([lower, (lower + upper) / 2, upper])), axis=-1).reshape(-1, 2)
        x = np.vstack([ends, rng.uniform(lower, upper, (300, 2))])
        u = rng.uniform(-2, 2, (len(x), 1))
        error = np.abs(plant(x, u) - x @ A.T - u @ B.T - p).max(axis=1)
        best = INTEGRATOR_CURVATURE * ((upper - lower) ** 2).sum() / 8
        worst = int(np.argmax(error))
        require(
            error[worst] <= best + ROUNDING,
            f"on [{lower[0]:.2f}, {upper[0]:.2f}] x [{lower[1]:.2f}, {upper[1]:.2f}] your error at "
            f"x = {text(x[worst])}, u = {text(u[worst])} is {error[worst]:.4f}, "
            f"{error[worst] / best:.2f} times as large as need be",
        )
    print("ok: the smallest possible largest error, on boxes of any shape")


def check_t4(D: Any) -> None:
    """Task 4: a small polytope that contains all errors of the paper's least-squares fit.

    Parameters
    ----------
    D : Polytope

    Raises
    ------
    Wrong
        With an error that lies outside, or a direction in which D is larger than necessary.
    """
    require_instance(D, Polytope, "D")
    require(D.dimension == 2, f"D lies in R^{D.dimension}, but the error has 2 components")
    require(not D.is_empty and D.is_bounded, "D must be bounded and not empty")
    rng = np.random.default_rng()
    fit = double_integrator_fit()
    plant = double_integrator_plant()
    errors = []
    for mode in fit.modes:
        low, high = mode.region.bounding_box()
        corners = np.array([[a, b, 0.0] for a in (low[0], high[0]) for b in (low[1], high[1])])
        z = np.vstack([corners, (low + high)[None] / 2, rng.uniform(low, high, (200, 3))])
        errors.append(plant(z[:, :2], z[:, 2:]) - mode.successor(z[:, :2], z[:, 2:]))
    d = np.vstack(errors)
    excess = (d @ D.H.T - D.h).max(axis=1)
    worst = int(np.argmax(excess))
    require(excess[worst] <= 1e-6, f"the error d = {text(d[worst])} occurs, but lies outside D")
    for v, name in (((1, -1), "(1, -1)"), ((-1, 1), "(-1, 1)"), ((1, 1), "(1, 1)"), ((-1, -1), "(-1, -1)")):
        support, needed = D.support([v])[0], (d @ np.array(v)).max()
        require(
            support <= needed + 1e-3,
            f"D contains all errors but is too large: along {name} h_D = {support:.4f}, but {needed:.4f} is enough",
        )
    print("ok: D contains all errors and cannot be smaller")


def check_t5(least_squares: Any, minimax: Any) -> None:
    """Task 5: the fewest regions per axis with which each fit's proven error is at most `WANTED`.

    Parameters
    ----------
    least_squares, minimax : int

    Raises
    ------
    Wrong
        If the error is too large, or one region per axis less would do.
    """
    plant, rng = double_integrator_plant(), np.random.default_rng()
    for method, answer in (("least_squares", least_squares), ("minimax", minimax)):
        number = require_whole(answer, method, 2, 40)
        for count, enough in ((number, True), (number - 1, False)):
            regions = chessboard(plant.state_set, plant.input_set, count)
            some = [regions[i] for i in rng.choice(len(regions), min(3, len(regions)), replace=False)]
            error = fit_pwa(plant, some, method=method).proven_error
            if enough:
                require(error <= WANTED, f"{method} = {count} is too small: the proven error is {error:.4f} > {WANTED}")
            else:
                require(error > WANTED, f"{method} = {count + 1} is more than needed: {count} give {error:.4f} already")
    print(f"ok: {least_squares} and {minimax} regions per axis keep the error below {WANTED}")


def check_t6(upper: Any) -> None:
    """Task 6: upper(a, b), a bound on e(t) = sin(3 t) - t over [a, b] that is sound and tight to second order.

    Parameters
    ----------
    upper : callable
        float, float -> number.

    Raises
    ------
    Wrong
        With an interval on which it is no bound, or exceeds the maximum by more than `TIGHT` times its width squared.
    """
    rng = np.random.default_rng()
    for width in np.concatenate([10.0 ** rng.uniform(-3, 0, 300), [1e-3, 1.0, 2.0]]):
        a = rng.uniform(-3, 3)
        b = a + width
        value = upper(a, b)
        require(value is not None and value != np.inf, "upper is not filled in yet")
        value = require_number(value, "upper(a, b)")
        peaks = [(sign * np.arccos(1 / 3) + 2 * np.pi * k) / 3 for sign in (-1, 1) for k in range(-4, 5)]
        points = np.array([a, b, *(t for t in peaks if a < t < b)])  # where e' = 3 cos(3 t) - 1 vanishes
        e = np.sin(3 * points) - points
        best = int(np.argmax(e))
        case = f"upper({a:.4f}, {b:.4f}) = {value:.6f}"
        require(
            value >= e[best] - 1e-12, f"{case} is no bound: e({points[best]:.5f}) is larger by {e[best] - value:.2g}"
        )
        require(
            value <= e[best] + TIGHT * width**2 + 1e-12,
            f"{case} is a bound, but exceeds the maximum by {value - e[best]:.2g}, more than {TIGHT:g} times the width "
            f"squared ({TIGHT * width**2:.2g})",
        )
    print("ok: sound, and tight to second order")


def _bend(x: Array) -> Array:
    """0.025 x'x for states (N, 2)."""
    return INTEGRATOR_CURVATURE * (x**2).sum(axis=1)


def _fit_square(middle: Array, side: float, points: int) -> tuple[Array, float]:
    """Least-squares affine fit theta (3,) of the bend on a square, and its largest error at the grid."""
    axes = [np.linspace(c - side / 2, c + side / 2, points) for c in middle]
    x = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    rows = np.column_stack([x, np.ones(len(x))])
    theta = np.linalg.lstsq(rows, _bend(x), rcond=None)[0]
    return theta, float(np.abs(_bend(x) - rows @ theta).max())
