"""Checks of exercise 01: sets and support functions."""

from typing import Any

import numpy as np

from ..sets.polytope import Polytope
from ..sets.templates import box_directions, directions
from .common import require, require_array, require_number, require_whole, text

TOL = 1e-9  # for numbers that differ by rounding only; all data here are of size 1


def check_t1(support_of_box: Any) -> None:
    """Task 1: support_of_box(lower, upper, v) = h of the box along v, on random boxes in R^1 to R^5.

    Parameters
    ----------
    support_of_box : callable
        (n,), (n,), (n,) -> number.

    Raises
    ------
    Wrong
        With a box, a direction and, where the answer is too small, a point of the box that shows it.
    """
    rng = np.random.default_rng()
    for n in (1, 2, 2, 3, 5, 5):
        lower = rng.uniform(-2, 1, n)
        size = rng.uniform(0.5, 2, n)
        v = rng.choice([-1.0, 1.0], n)
        upper, v = lower + size, v * rng.uniform(0.5, 2, n)
        value = require_number(support_of_box(lower, upper, v), "support_of_box(lower, upper, v)")
        best = float(Polytope.box(lower, upper).support([v])[0])
        case = f"lower = {text(lower)}, upper = {text(upper)}, v = {text(v)}: you return {value:.3f}"
        corner = np.where(v > 0, upper, lower)
        require(
            value >= best - TOL,
            f"{case}, but the point x = {text(corner)} of the box has v x = {v @ corner:.3f}",
        )
        require(value <= best + TOL, f"{case}, which no point of the box attains")
    print("ok: the support function of a box, without any optimisation")


def check_t2(offsets_of_sum: Any) -> None:
    """Task 2: offsets_of_sum(P, Q, C) = h of the Minkowski sum of P and Q along the rows of C.

    Parameters
    ----------
    offsets_of_sum : callable
        Polytope, Polytope, (l, 2) -> (l,).

    Raises
    ------
    Wrong
        With a direction and, where the answer is too small, two points whose sum lies outside.
    """
    rng = np.random.default_rng()
    for _ in range(5):
        P, Q = _polygon(rng), _polygon(rng)
        C = directions(int(rng.integers(3, 12)))
        h = require_array(offsets_of_sum(P, Q, C), (len(C),), "offsets_of_sum(P, Q, C)")
        sums = (P.vertices()[:, None] + Q.vertices()[None]).reshape(-1, 2)
        best = (C @ sums.T).max(axis=1)
        i = int(np.argmax(np.abs(h - best)))
        case = f"along C_i = {text(C[i])} you return {h[i]:.3f}"
        p, q = (R.vertices()[np.argmax(R.vertices() @ C[i])] for R in (P, Q))
        require(
            h[i] >= best[i] - TOL,
            f"{case}, but a = {text(p)} is in P, b = {text(q)} in Q, and C_i (a + b) = {C[i] @ (p + q):.3f}",
        )
        require(h[i] <= best[i] + TOL, f"{case}, but no sum a + b of points of P and Q gets further than {best[i]:.3f}")
    print("ok: support functions of a sum add up")


def check_t3(leaving_point: Any) -> None:
    """Task 3: leaving_point(P, Q) is None if P lies in Q, and else a point of P outside Q.

    Parameters
    ----------
    leaving_point : callable
        Polytope, Polytope -> None or (2,).

    Raises
    ------
    Wrong
        If None is returned although P leaves Q (even by 0.001 at one corner), or a point that is no witness.
    """
    rng = np.random.default_rng()
    for wanted in (0.0, 0.5, 1e-3, 0.0, 1e-3, 0.5):
        P, facet = _polygon(rng), int(rng.integers(8))
        slack = rng.uniform(0.2, 0.6, 8)
        slack[facet] = -wanted if wanted else slack[facet]
        Q = Polytope(directions(8), P.support(directions(8)) + slack)
        x = leaving_point(P, Q)
        require(x is not ..., "leaving_point is not filled in yet")
        if x is None:
            require(
                not wanted,
                f"you say that P lies in Q, but h_P - h_Q = {wanted:g} > 0 along row {facet} of Q.H: "
                "look at the corner of P with the largest value along that row",
            )
            continue
        x = require_array(x, (2,), "leaving_point(P, Q)")
        require(wanted, f"you return x = {text(x)}, but P lies in Q: h_P <= h_Q along all rows of Q.H")
        require(P.contains(x, TOL), f"x = {text(x)} is not in P: H_P x - h_P is up to {(P.H @ x - P.h).max():.2g}")
        require(not Q.contains(x, TOL), f"x = {text(x)} is no witness: it lies in Q as well")
    print("ok: inclusion decided, and refuted by a point")


def check_t4(count: Any) -> None:
    """Task 4: the smallest number of directions for which the template around the unit disc has at most 1 % more area.

    Parameters
    ----------
    count : int

    Raises
    ------
    Wrong
        With the excess area for that number, or for one direction less.
    """
    number = require_whole(count, "count", 3)
    excess = _excess_area(number)
    require(excess <= 0.01, f"with {number} directions the polygon still has {excess:.2%} more area than the disc")
    if number > 3:
        less = _excess_area(number - 1)
        require(less > 0.01, f"{number} directions are enough, but not the fewest: one less gives {less:.2%}")
    print(f"ok: {number} directions, {excess:.3%} more area")


def check_t5(largest_factor: Any) -> None:
    """Task 5: the largest rho for which a box template does not grow under x+ = rho R(theta) x.

    Parameters
    ----------
    largest_factor : callable
        Angle theta in (0, pi/2), in radians -> number.

    Raises
    ------
    Wrong
        With the angle, and the half-width of the box after one step with that rho, or with one 1 % larger.
    """
    for theta in np.random.default_rng().uniform(0.1, 1.47, 6):
        rho = require_number(largest_factor(theta), "largest_factor(theta)")
        require(rho > 0, f"theta = {theta:.3f}: rho must be positive; got {rho:.3g}")
        after = _half_width(rho, theta)
        require(
            after <= 1 + TOL,
            f"theta = {theta:.3f}: with rho = {rho:.4f} the box |x| <= 1 becomes |x| <= {after:.4f}: it grows",
        )
        more = _half_width(1.01 * rho, theta)
        require(
            more > 1,
            f"theta = {theta:.3f}: rho = {rho:.4f} is not the largest, for 1.01 rho still gives |x| <= {more:.4f}",
        )
    print("ok: the wrapping effect, measured")


# -- parts --------------------------------------------------------------------------------------------


def _polygon(rng: np.random.Generator) -> Polytope:
    """A random polygon with the origin inside and 5 to 8 corners at most."""
    angles = np.sort(rng.uniform(0, 2 * np.pi, 5)) + np.linspace(0, 0.5, 5)
    points = np.column_stack([np.cos(angles), np.sin(angles)]) * rng.uniform(0.5, 1.5, (5, 1))
    return Polytope.from_points(np.vstack([points, 0.3 * directions(3)]))


def _excess_area(count: int) -> float:
    """Area of {x : C x <= 1} with `count` directions, relative to the unit disc, minus 1."""
    return float(Polytope(directions(count), np.ones(count)).area / np.pi - 1)


def _half_width(rho: float, theta: float) -> float:
    """Half-width of the smallest box around the image of |x| <= 1."""
    rotation = np.array([[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]])
    corners = Polytope.box([-1, -1], [1, 1]).vertices() @ (rho * rotation).T
    return float((box_directions(2) @ corners.T).max())
