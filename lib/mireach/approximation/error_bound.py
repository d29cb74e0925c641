"""Proven bounds on the error of a piecewise-affine fit: branch and bound in ball arithmetic.

Theorem UUB of [Teichrib2025] needs a bound on f - f_PWA at *all* points of X x U (Lemma RkNonlinear), not only at the
points of a grid.
"""

import heapq
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import count, product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..arithmetic.balls import ball, interval, pairs, precision, upper_float
from ..checks import real_array, require_columns, require_kind, whole_number
from ..errors import SolverError
from ..sets.polytope import Polytope
from ..sets.templates import box_directions
from ..solvers.linear_program import LinearProgram
from ..systems.nonlinear import NonlinearSystem
from ..systems.pwa import Mode
from ..tolerances import CUTTING_ROW, ERROR_GAP, LEAST_ERROR, PULL
from ..typing import Array, ArrayLike, IntArray
from .domain import checked_regions, domain_units, nonlinear_system, power_below
from .jets import Residual

MAX_BOXES = 4000  # boxes per mode, about 0.3 ms each; a bound is proven whatever ends the search


@dataclass(frozen=True, eq=False)
class ErrorProof:
    """Bounds on v (f(x, u) - A x - B u - p) over the region of each of s modes and X x U.

    Attributes
    ----------
    directions : array (k, n)
        The rows v.
    bound : array (s, k)
        Proven upper bounds in units of v x, rounded upward; -inf where a region does not meet X x U.
    attained : array (s, k)
        The largest values at points that the search evaluated, in floating point. They show how tight `bound` is
        and are no part of the proof.
    boxes : array (s,) of int
        Number of boxes that were bounded.
    tol : float
        The difference of `bound` and `attained` at which the search was to end, as a share of |attained|, or of
        `LEAST_ERROR` times `unit` where that is larger.
    unit : array (k,)
        The size of X along each direction: the power of two below the largest |v_i| times half-width i of X.

    See Also
    --------
    prove_error : Computes it.
    """

    directions: Array
    bound: Array
    attained: Array
    boxes: IntArray
    tol: float
    unit: Array

    def __repr__(self) -> str:
        used = np.isfinite(self.bound)
        return (
            f"ErrorProof({len(self.bound)} modes, {len(self.directions)} directions, "
            f"largest bound {self.bound.max(where=used, initial=-np.inf):.6g}, largest gap {self.gap.max():.2g}, "
            f"{self.boxes.sum()} boxes)"
        )

    @property
    def gap(self) -> Array:
        """bound - attained, array (s, k); 0 where a region does not meet X x U."""
        return np.subtract(self.bound, self.attained, where=np.isfinite(self.bound), out=np.zeros(self.bound.shape))

    @property
    def complete(self) -> NDArray[np.bool_]:
        """Whether the search of each mode ended by its tolerance, array (s,) of bool."""
        return np.all(self.gap <= self.tol * np.maximum(LEAST_ERROR * self.unit, np.abs(self.attained)), axis=1)

    def error_set(self, mode: int) -> Polytope:
        """{d : v d <= bound for every direction v}; the point 0 where the region of the mode does not meet X x U.

        Parameters
        ----------
        mode : int
            Its number, counted from 0.
        """
        if not np.isfinite(self.bound[mode]).all():
            n = self.directions.shape[1]
            return Polytope.box(np.zeros(n), np.zeros(n))
        return Polytope(self.directions, self.bound[mode])

    def shifted(self, before: Array, after: Array) -> "ErrorProof":
        """The same proof for modes with another p.

        Parameters
        ----------
        before, after : array (s, n)
            p of every mode, then and now.
        """
        bound = np.array([_shift(*row, self.directions) for row in zip(self.bound, before, after)])
        return replace(self, bound=bound, attained=self.attained - (after - before) @ self.directions.T)


def prove_error(
    f: NonlinearSystem | Callable[[Any, Any], Any],
    modes: Iterable[Mode],
    state_set: Polytope | None = None,
    input_set: Polytope | None = None,
    directions: ArrayLike | None = None,
    *,
    tol: float = ERROR_GAP,
    max_boxes: int = MAX_BOXES,
) -> ErrorProof:
    """Upper bounds on v (f(x, u) - A x - B u - p) over region & X x U, for each mode and direction v.

    Parameters
    ----------
    f : NonlinearSystem or callable
        f(x, u) -> n components, for x (n,) and u (m,); by the operations in `balls.ALLOWED`.
    modes : sequence of Mode
    state_set, input_set : Polytope or None
        X and U; needed with a callable, taken from a NonlinearSystem otherwise.
    directions : array (k, n) or None
        The rows v; None is `error_directions(n)`.
    tol : float
        Gap between proven and attained error to aim at, as a share of the error, or of `LEAST_ERROR` times the
        half-width of X along the direction (rounded down to a power of two) where that is larger. Units do not matter.
    max_boxes : int
        Boxes per mode after which the search ends in any case; the bound is proven nevertheless.

    Returns
    -------
    ErrorProof

    Raises
    ------
    TypeError
        If an argument has the wrong type, or f uses a function that ball arithmetic does not have.
    ValueError
        If sizes do not match, or some region has no finite bound within `max_boxes`.
    SolverError
        If no box around a region can be proven.

    See Also
    --------
    fit_pwa : Fits the modes and proves their error.

    Notes
    -----
    Branch and bound over boxes. In a box with centre c and radii r, the error e of a direction satisfies

        e(c + h) <= e(c) + g h + sum_i Q_ii h_i^2 / 2 + sum_(i<j) |Q_ij| r_i r_j,   |h_i| <= r_i,

    g the gradient at c and Q any ball that contains the Hessian over the box; the sum over i is maximised
    exactly, one coordinate at a time. Rows H (x, u) <= h of the region that cut the box enter by weak
    duality: for any multipliers y >= 0, adding y (h - H c) - y H h to the right-hand side keeps it an upper
    bound. The multipliers come from an LP in floating point, whose errors do not matter: everything
    that the proof rests on is evaluated in balls. What is trusted: Arb, and HiGHS where it says that a
    region does not meet X x U at all.

    The search measures x and u in units of the half-widths of X and U, and errors in those of X along v, all rounded
    to powers of two, so that scaling rounds nothing.

    Fast where f - A x - B u - p has its extremes at isolated points or is quadratic without cross terms,
    as in the paper; slow, and then less tight, where it is extreme along a slanted line such as that of
    sin(x1 + x2), or where it cancels between components without being quadratic.

    Examples
    --------
    The error of the tangent 0 of x^2 / 4 over [-1, 1]:

    >>> import mireach as mr
    >>> X = U = mr.Polytope.box([-1], [1])
    >>> mode = mr.Mode([[0.0]], [[0.0]], [0.0], X.product(U))
    >>> mr.prove_error(lambda x, u: [x[0] ** 2 / 4], [mode], X, U, [[1.0]]).bound.tolist()
    [[0.25]]
    """
    system, modes = nonlinear_system(f, state_set, input_set), list(modes)
    for number, mode in enumerate(modes, start=1):
        require_kind(mode, Mode, f"mode {number}")
    checked_regions([mode.region for mode in modes], system)
    n = system.state_set.dimension
    directions = error_directions(n) if directions is None else real_array(directions, "directions", 2)
    require_columns(directions, n, "directions", "the state's size")
    max_boxes = whole_number(max_boxes, "max_boxes", 1)
    if not tol >= 0:
        raise ValueError(f"tol must not be negative; got {tol!r}")
    domain, scale = system.state_set.product(system.input_set), domain_units(system)
    unit = power_below(np.abs(directions * scale[:n]).max(axis=1))
    with precision():
        searches = [
            _search(Residual(system.f, m, directions, scale, unit), (domain & m.region).in_units(scale), tol, max_boxes)
            for m in modes
        ]
        bound = np.array([[_times(b, t) for b, t in zip(search.bound, unit)] for search in searches])
    attained = np.array([search.attained for search in searches]) * unit
    boxes = np.array([search.boxes for search in searches])
    for number, row in enumerate(bound, start=1):
        if (row == np.inf).any():
            raise ValueError(
                f"no finite error could be proven in region {number} with {boxes[number - 1]} boxes; f or a "
                "derivative is not finite there (log or sqrt at 0?), or max_boxes is too small"
            )
    return ErrorProof(directions, bound, attained, boxes, float(tol), unit)


def error_directions(n: int) -> Array:
    """Normals of error sets: e_i, -e_i, and all e_i + e_j, e_i - e_j, -e_i + e_j, -e_i - e_j with i < j.

    For n = 2 these are the eight directions of the paper's template, here with whole numbers, so that the difference
    of two equal components is exactly 0.

    Parameters
    ----------
    n : int
        Size of the state.

    Returns
    -------
    array (2 n^2, n)

    Examples
    --------
    >>> error_directions(2).tolist()[4:]
    [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]]
    """
    identity = np.eye(n)
    signs = list(product((1, -1), (1, -1)))
    mixed = [s * identity[i] + t * identity[j] for j in range(n) for i in range(j) for s, t in signs]
    return np.vstack([box_directions(n), *mixed]) + 0.0


# -- rounding -------------------------------------------------------------------------------------


def _times(bound: float, unit: float) -> float:
    """The float bound * unit, rounded upward; -inf and inf stay."""
    return upper_float(ball(bound) * ball(unit)) if np.isfinite(bound) else bound


def _shift(bound: Sequence[float], before: Array, after: Array, directions: Array) -> list[float]:
    """Upper bounds (k,) after p went from `before` to `after`: bound - v (after - before), rounded upward."""
    with precision():
        step = [ball(b) - ball(a) for a, b in zip(before, after)]
        return [
            upper_float(ball(offset) - sum(ball(c) * s for c, s in zip(v, step))) if np.isfinite(offset) else offset
            for offset, v in zip(bound, directions)
        ]


# -- branch and bound -----------------------------------------------------------------------------


class _Rows:
    """The rows H z <= h of a polytope, and multipliers for the bounds."""

    def __init__(self, P: Polytope) -> None:
        self.P = P
        self.H = [[ball(c) for c in row] for row in P.H]
        self.h = [ball(offset) for offset in P.h]
        self.centre = P.chebyshev_centre()[0]
        self.program = LinearProgram()
        self.z = self.program.add_columns(np.full(P.dimension, -np.inf), np.full(P.dimension, np.inf))
        self.program.add_rows(self.z, P.H, upper=P.h)

    def multipliers(self, objective: Sequence[float] | Array) -> tuple[Array | None, Array]:
        """A solution (n+m,) of max objective z, or None if there is none, and y >= 0 (rows,) from its dual."""
        best = self.program.maximize(self.z, objective)
        if best.point is None:
            return None, np.zeros(len(self.P.h))
        dual = self.program.multipliers()
        return best.point, np.where(dual > 0, dual, 0.0)

    def enclosing_box(self) -> tuple[Array, Array] | None:
        """Floats lower, upper (n+m,) between which P lies, proven; None if P is empty.

        With y >= 0, z_i <= y h + (e_i - y H) z; the residual e_i - y H is 0 but for rounding, and the
        largest |z_j| of a bounded P, say m, satisfies m <= max y h + |residual| m.
        """
        ends, residuals = [], []
        for e in box_directions(self.P.dimension):
            y = self.multipliers(e)[1]
            used = np.flatnonzero(y)
            ends.append(sum((ball(y[k]) * self.h[k] for k in used), ball(0)))
            residuals.append(sum(abs(ball(c) - sum(ball(y[k]) * self.H[k][j] for k in used)) for j, c in enumerate(e)))
        share = max(upper_float(residual) for residual in residuals)
        if share > 0.5:
            raise SolverError("no box around a region could be proven; its rows may be badly scaled")
        size = ball(max(0.0, *(upper_float(end) for end in ends))) / (1 - ball(share))
        outer = np.array([upper_float(end + residual * size) for end, residual in zip(ends, residuals)])
        upper, lower = np.split(outer, 2)
        return None if (-lower > upper).any() else (-lower + 0.0, upper + 0.0)

    def cutting(self, centre: Array, radius: Array) -> IntArray | None:
        """Indices of the rows that cut a box, or None if one of them certainly excludes all of it."""
        middle, spread = self.P.H @ centre, np.abs(self.P.H) @ radius
        slack = CUTTING_ROW * (1 + np.abs(self.P.h))
        for k in np.flatnonzero(middle - spread > self.P.h):
            lowest = sum(a * ball(c) - abs(a) * ball(r) for a, c, r in zip(self.H[k], centre, radius))
            if lowest > self.h[k]:
                return None
        return np.flatnonzero(middle + spread > self.P.h + slack)

    def nearest(self, point: Array) -> Array | None:
        """The point, moved a little towards the centre of P if rounding put it outside; None if it is far outside."""
        for candidate in (point, point + PULL * (self.centre - point)):
            if self.P.contains(candidate):
                return candidate
        return None


@dataclass
class _Box:
    """A box, what is proven in it (k,), and the coordinate along which to cut it."""

    lower: Array
    upper: Array
    bound: Array
    axis: int | None = None

    def halves(self) -> "Iterator[_Box]":
        """The two halves along `axis`, with the bounds of the whole."""
        middle = (self.lower[self.axis] + self.upper[self.axis]) / 2
        for name in ("upper", "lower"):
            half = _Box(self.lower.copy(), self.upper.copy(), self.bound.copy())
            getattr(half, name)[self.axis] = middle
            yield half


class _Search(NamedTuple):
    """Proven bounds (k,), attained values (k,), and the number of boxes, for one part of X x U."""

    bound: Array
    attained: Array
    boxes: int


def _search(residual: Residual, part: Polytope, tol: float, max_boxes: int) -> _Search:
    """Bound the error over one part of X x U, the box with the largest excess first."""
    k = len(residual.directions)
    nothing = np.full(k, -np.inf)
    if part.is_empty:
        return _Search(nothing, nothing, 0)
    rows = _Rows(part)
    ends = rows.enclosing_box()
    if ends is None:
        return _Search(nothing, nothing, 0)

    attained, closed = nothing.copy(), nothing.copy()
    heap: list[tuple[float, int, _Box]] = []
    order, boxes = count(), 0  # `order` breaks ties, so that boxes are never compared
    fresh = [_Box(*ends, np.full(k, np.inf))]
    while fresh:
        for box in fresh:
            boxes += 1
            undecided = _undecided(box.bound, attained, tol)
            if not _tighten(box, residual, rows, undecided, attained):
                continue
            excess = np.where(_undecided(box.bound, attained, tol), box.bound - attained, 0.0).max()
            if excess > 0 and box.axis is not None:
                heapq.heappush(heap, (-excess, next(order), box))
            else:
                closed = np.maximum(closed, box.bound)
        fresh = []
        while heap and not fresh and boxes < max_boxes:
            box = heapq.heappop(heap)[-1]
            if _undecided(box.bound, attained, tol).any():
                fresh = list(box.halves())
            else:
                closed = np.maximum(closed, box.bound)
    return _Search(np.max([closed, *(box.bound for *_, box in heap)], axis=0), attained, boxes)


def _undecided(bound: Array, attained: Array, tol: float) -> NDArray[np.bool_]:
    """Whether the bound of each direction still exceeds what is attained by more than the tolerance: (k,) of bool."""
    size = np.where(np.isfinite(attained), np.maximum(LEAST_ERROR, np.abs(attained)), LEAST_ERROR)
    return bound > attained + tol * size


def _tighten(box: _Box, residual: Residual, rows: _Rows, undecided: NDArray[np.bool_], attained: Array) -> bool:
    """Improve box.bound in the undecided directions and choose box.axis; False if the box holds no point of P.

    `attained` is raised, in place, to the values at the points that are evaluated.
    """
    centre = (box.lower + box.upper) / 2
    r = [
        max((ball(high) - ball(c)).upper(), (ball(c) - ball(low)).upper())
        for low, c, high in zip(box.lower, centre, box.upper)
    ]
    radius = np.array([upper_float(entry) for entry in r])
    cuts = rows.cutting(centre, radius)
    if cuts is None:
        return False
    open_rows = np.flatnonzero(undecided)
    if not len(open_rows):
        return True
    tangents = residual.tangent(centre, open_rows)
    hessians = residual.curvature([interval(*ends) for ends in zip(box.lower, box.upper)], open_rows)
    if len(cuts):
        rows.program.set_bounds(rows.z, box.lower, box.upper)

    scores, points = np.zeros(len(centre)), [centre]
    for direction, tangent, hessian in zip(open_rows, tangents, hessians):
        if not all(entry.is_finite() for entry in (*tangent, *hessian)):
            scores += radius
            continue
        gradient = [float(g) for g in tangent[1:]]
        y = np.zeros(0)
        if len(cuts):
            corner, y = rows.multipliers(gradient)
            points += [corner] if corner is not None else []
        best = _taylor_bound(tangent, hessian, r, centre, rows, y)
        box.bound[direction] = min(box.bound[direction], upper_float(best.bound))
        points.append(np.clip(centre + best.step, box.lower, box.upper))
        score = best.score
        if len(cuts):
            slope = np.abs(rows.P.H[cuts]).max(axis=0)
            score = score + radius * (np.abs(gradient) * (slope > 0) + 1e-3 * slope)
        scores = np.maximum(scores, score)
    _attain(points, residual, rows, attained)
    width = box.upper - box.lower
    scores[(box.lower + width / 2 <= box.lower) | (box.lower + width / 2 >= box.upper)] = 0.0
    box.axis = int(np.argmax(scores)) if scores.max() > 0 else None
    return True


class _TaylorBound(NamedTuple):
    """The right-hand side in the notes of `prove_error`, over one box.

    Attributes
    ----------
    bound : arb
        Its maximum.
    step : array (n+m,)
        The h that attains it.
    score : array (n+m,)
        What each coordinate adds to its excess over the error.
    """

    bound: Any
    step: Array
    score: Array


def _taylor_bound(
    tangent: Sequence[Any], hessian: Sequence[Any], r: Sequence[Any], centre: Array, rows: _Rows, y: Array
) -> _TaylorBound:
    """Maximise the right-hand side in the notes of `prove_error` with multipliers y of the rows (none if empty)."""
    size, used = len(r), np.flatnonzero(y)
    value, *gradient = tangent
    for k in used:
        weight = ball(y[k])
        value += weight * (rows.h[k] - sum(a * ball(c) for a, c in zip(rows.H[k], centre)))
        gradient = [g - weight * a for g, a in zip(gradient, rows.H[k])]
    step, score = np.zeros(size), np.zeros(size)
    for (i, j), Q in zip(pairs(size), hessian):
        if i == j:
            best, h = _parabola(gradient[i], Q.upper(), r[i])
            value, step[i] = value + best, h
            score[i] += float(Q.rad() * r[i] * r[i]) + (float(Q.abs_upper() * r[i] * r[i]) if len(used) else 0.0)
        else:
            cross = Q.abs_upper() * r[i] * r[j]
            value += cross
            score[[i, j]] += float(cross)
    return _TaylorBound(value, step, score)


def _parabola(g: Any, q: Any, r: Any) -> tuple[Any, float]:
    """Upper bound on g h + q h^2 / 2 over |h| <= r, for any g in its ball, and about where it is attained."""
    steep = g.abs_upper()
    if not r > 0:
        return ball(0), 0.0
    sign = 1.0 if g.mid() >= 0 else -1.0
    if steep + q * r >= 0:
        return steep * r + q * r * r / 2, sign * float(r)
    return -(steep * steep) / (2 * q), sign * float(-steep / q)


def _attain(points: Iterable[Array], residual: Residual, rows: _Rows, attained: Array) -> None:
    """Raise `attained` to the values at those points that lie in the polytope, in place."""
    seen = set()
    for point in points:
        inside = rows.nearest(point)
        if inside is not None and inside.tobytes() not in seen:
            seen.add(inside.tobytes())
            np.fmax(attained, residual.at(inside), out=attained)
