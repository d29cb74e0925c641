"""Piecewise-affine fits of nonlinear systems, with an error set that is proven (Lemma RkNonlinear of [Teichrib2025]).

The paper's 0.1186 is the largest error at the points of the fit. Theorem UUB needs a bound at *all* points of
X x U; `prove_error` gives one, by branch and bound in ball arithmetic.
"""

import heapq
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import count, product

import numpy as np
from scipy.optimize import linprog

from ..arithmetic.balls import PRECISION, ball, evaluate, flint, interval, pairs, precision, upper_float
from ..checks import real_array, require_columns
from ..errors import SolverError
from ..sets.polytope import Polytope
from ..sets.templates import box_directions
from ..solvers.linear_program import LinearProgram
from ..systems.pwa import Mode, NonlinearSystem, PWASystem

METHODS = ("least_squares", "minimax")
ERRORS = ("box", "polytope", "ball")
GAP = 1e-9  # proven bound minus attained error at which the search ends, as a share of the error
SMALL = 2.0**-10  # errors below this share of X's size count as this large there: floats do not resolve a share of them
MAX_BOXES = 4000  # boxes a mode, about 0.3 ms each; a bound is proven whatever ends the search
INSIDE = 1e-9  # a grid point this far outside a region still belongs to it (X x U has the size 1 there)
CUTS = 1e-12  # a row that cuts off less of a box than this is not used to tighten its bound (the same)
FLAT = 2.0**-20  # half-widths of X x U below this share of its largest coordinate are taken as this share
PULL = 1e-10  # share of the way to the region's centre by which points that rounding put outside are moved


@dataclass(frozen=True, eq=False)
class ErrorProof:
    """Bounds on v (f(x, u) - A x - B u - p) over the region of each of s modes and X x U.

    Attributes
    ----------
    directions : array (k, n)
        The rows v.
    bound : array (s, k)
        Proven upper bounds, rounded upward; -inf where a region does not meet X x U.
    attained : array (s, k)
        Largest values met on the way, in floating point: how tight `bound` is, no part of the proof.
    boxes : array (s,) of int
        Boxes that were bounded.
    tol : float
        The difference of the two at which the search was to end, as a share of |attained|, or of `SMALL` times `unit`
        where that is larger.
    precision : int
        Bits of the ball arithmetic.
    unit : array (k,)
        The size of X along each direction: the power of two below the largest |v_i| times half-width i of X.
    """

    directions: np.ndarray
    bound: np.ndarray
    attained: np.ndarray
    boxes: np.ndarray
    tol: float
    precision: int
    unit: np.ndarray

    @property
    def gap(self):
        """bound - attained, array (s, k); 0 for a mode without points."""
        return np.subtract(self.bound, self.attained, where=np.isfinite(self.bound), out=np.zeros(self.bound.shape))

    @property
    def complete(self):
        """Whether the search of each mode ended by its tolerance, array (s,) of bool."""
        return (self.gap <= self.tol * np.maximum(SMALL * self.unit, np.abs(self.attained))).all(axis=1)

    def error_set(self, mode):
        """{d : v d <= bound for every direction v}, or the point 0 for a mode without points."""
        if not np.isfinite(self.bound[mode]).all():
            return _point(self.directions.shape[1])
        return Polytope(self.directions, self.bound[mode])

    def shifted(self, before, after):
        """The same proof for modes whose p went from `before` to `after`, arrays (s, n)."""
        bound = np.array([_shift(*row, self.directions) for row in zip(self.bound, before, after)])
        return replace(self, bound=bound, attained=self.attained - (after - before) @ self.directions.T)


@dataclass(frozen=True, eq=False)
class PWAFit:
    """A piecewise-affine approximation of x+ = f(x, u) with proven error sets.

    Attributes
    ----------
    modes : tuple of Mode
        One a region, in the order given; the disturbance sets are what `error` and `per_mode` say.
    max_error : float
        Largest |f - f_PWA|_inf at the points of the fit: the paper's number, in floating point, no bound.
    proof : ErrorProof
    state_set, input_set : Polytope
    method : str
    grid : int
    error : "box", "polytope" or "ball"
    per_mode : bool
    """

    modes: tuple
    max_error: float
    proof: ErrorProof = field(repr=False)
    state_set: Polytope
    input_set: Polytope
    method: str
    grid: int
    error: str
    per_mode: bool

    @property
    def proven_error(self):
        """Upper bound on |f - f_PWA|_inf over all of X x U."""
        return float(self.errors.max())

    @property
    def errors(self):
        """Upper bound on |f - f_PWA|_inf over each region, array (s,); 0 where a region is not used."""
        n = self.state_set.dimension
        return np.where(self._used, self.proof.bound[:, : 2 * n].max(axis=1), 0.0)

    @property
    def error_range(self):
        """lower, upper: arrays (s, n), the smallest and largest f - f_PWA of each component, proven."""
        n = self.state_set.dimension
        bound = np.where(self._used[:, None], self.proof.bound, 0.0)
        return -bound[:, n : 2 * n], bound[:, :n]

    @property
    def error_boxes(self):
        """The smallest box around the error of each mode, tuple of Polytope."""
        return tuple(Polytope.box(lower, upper) for lower, upper in zip(*self.error_range))

    @cached_property
    def error_sets(self):
        """The error of each mode between tight parallel planes along `error_directions`, tuple of Polytope."""
        return tuple(self.proof.error_set(i) for i in range(len(self.modes)))

    def with_error(self, error, per_mode=None):
        """The same fit with other disturbance sets.

        Parameters
        ----------
        error : "box", "polytope" or "ball"
            See `fit_pwa`.
        per_mode : bool or None
            None keeps what it was.
        """
        _require_choice(error, ERRORS, "error")
        per_mode = self.per_mode if per_mode is None else per_mode
        sets = self._disturbances(error, per_mode)
        modes = tuple(replace(mode, disturbance=D) for mode, D in zip(self.modes, sets))
        return replace(self, modes=modes, error=error, per_mode=per_mode)

    def system(self):
        """The PWASystem of this fit; modes whose region does not meet X x U are left out."""
        return PWASystem([m for m, used in zip(self.modes, self._used) if used], self.state_set, self.input_set)

    @property
    def _used(self):
        return np.isfinite(self.proof.bound).all(axis=1)

    def _disturbances(self, error, per_mode):
        """One error set a mode; the same for all unless `per_mode`."""
        n = self.state_set.dimension
        if not per_mode:
            worst = replace(self.proof, bound=np.broadcast_to(self.proof.bound.max(axis=0), self.proof.bound.shape))
            return replace(self, proof=worst)._disturbances(error, True)
        if error == "ball":
            return [Polytope.box(np.full(n, -radius), np.full(n, radius)) for radius in self.errors]
        return self.error_boxes if error == "box" else self.error_sets


def fit_pwa(
    f,
    regions,
    state_set=None,
    input_set=None,
    *,
    method="least_squares",
    grid=10,
    error="box",
    per_mode=False,
    tol=GAP,
    max_boxes=MAX_BOXES,
):
    """Fit A x + B u + p to f(x, u) in every region, and prove how far off it is.

    Parameters
    ----------
    f : NonlinearSystem or callable
        f(x, u) -> n components, for x (n,) and u (m,); by the operations in `balls.ALLOWED`.
    regions : sequence of Polytope
        In (x, u); what lies outside X x U does not count.
    state_set, input_set : Polytope
        X and U; needed with a callable, taken from a NonlinearSystem otherwise.
    method : "least_squares" or "minimax"
        Smallest sum of squares, or smallest largest error of each component, at the points of the grid.
        After minimax, p is moved by the middle of the proven error, so that the error of each component
        is symmetric over the whole region.
    grid : int
        Points an axis, ends included, over the bounding box of each region; points outside it are dropped.
    error : "box", "polytope" or "ball"
        Disturbance set: the smallest box around the error; the tighter polytope along `error_directions`;
        or the paper's |d|_inf <= proven error.
    per_mode : bool
        True gives each mode the error of its own region; False gives all the same set, as the paper does.
    tol : float
        Gap between proven and attained error to aim at, as a share of the error, or of `SMALL` times the half-width of
        X along the direction (rounded down to a power of two) where that is larger. Units do not matter.
    max_boxes : int
        Boxes a region after which the search ends in any case; the bound is proven nevertheless.

    Returns
    -------
    PWAFit

    Raises
    ------
    ValueError
        If an argument does not fit, f is not finite somewhere, or no finite error can be proven.
    TypeError
        If f uses a function that ball arithmetic does not have.
    ImportError
        If python-flint is missing.
    SolverError
        If an LP ends without an answer.

    Notes
    -----
    Second case study of [Teichrib2025]; its error of 0.1186 comes from a grid of 10.
    """
    system = _nonlinear(f, state_set, input_set)
    regions = _checked_regions(regions, system)
    _require_choice(method, METHODS, "method")
    _require_choice(error, ERRORS, "error")
    if isinstance(grid, bool) or grid != int(grid) or grid < 2:
        raise ValueError(f"grid must be a whole number of at least 2 points an axis; got {grid!r}")

    domain, n = system.state_set.product(system.input_set), system.state_set.dimension
    fit = {"least_squares": _least_squares, "minimax": _minimax}[method]
    scale = _scale(system)
    points = [_grid_points((domain & region).in_units(scale), int(grid)) * scale for region in regions]
    values = [_values(system.f, z, n, number) for number, z in enumerate(points, start=1)]
    modes = [_mode(fit, z, y, region, scale) for z, y, region in zip(points, values, regions)]
    proof = prove_error(system, modes, tol=tol, max_boxes=max_boxes)
    if method == "minimax":
        modes, proof = _recentred(modes, proof)
    largest = max(
        np.abs(y - mode.successor(z[:, :n], z[:, n:])).max(initial=0.0) for mode, z, y in zip(modes, points, values)
    )
    result = PWAFit(
        tuple(modes), float(largest), proof, system.state_set, system.input_set, method, int(grid), error, per_mode
    )
    return result.with_error(error)


def prove_error(
    f, modes, state_set=None, input_set=None, directions=None, *, tol=GAP, max_boxes=MAX_BOXES, bits=PRECISION
):
    """Upper bounds on v (f(x, u) - A x - B u - p) over region & X x U, for each mode and direction v.

    Parameters
    ----------
    f, state_set, input_set
        As for `fit_pwa`.
    modes : sequence of Mode
    directions : array (k, n) or None
        The rows v; None is `error_directions(n)`.
    tol, max_boxes
        As for `fit_pwa`.
    bits : int
        Precision of the ball arithmetic.

    Returns
    -------
    ErrorProof

    Raises
    ------
    ValueError
        If an argument does not fit, or some region has no finite bound within `max_boxes`.

    Notes
    -----
    Branch and bound over boxes. In a box with centre c and radii r, the error e of a direction satisfies

        e(c + h) <= e(c) + g h + sum_i Q_ii h_i^2 / 2 + sum_(i<j) |Q_ij| r_i r_j,   |h_i| <= r_i,

    g the gradient at c and Q any ball that contains the Hessian over the box; the sum over i is maximised
    exactly, one coordinate at a time. Rows H (x, u) <= h of the region that cut the box enter by weak
    duality: for any multipliers y >= 0, adding y (h - H c) - y H h to the right-hand side keeps it an upper
    bound. The multipliers come from an LP in floating point, which may be inexact without harm: everything
    that the proof rests on is evaluated in balls. What is trusted: Arb, and HiGHS where it says that a
    region does not meet X x U at all.

    The search measures x and u in units of the half-widths of X and U, and errors in those of X along v, all rounded
    to powers of two, by which nothing is rounded off.

    Quick where f - A x - B u - p has its extremes at isolated points or is quadratic without cross terms,
    as in the paper; slow, and then less tight, where it is extreme along a slanted line such as that of
    sin(x1 + x2), or where it cancels between components without being quadratic.
    """
    system = _nonlinear(f, state_set, input_set)
    modes = list(modes)
    _checked_regions([mode.region for mode in modes], system)
    n = system.state_set.dimension
    directions = error_directions(n) if directions is None else real_array(directions, "directions", 2)
    require_columns(directions, n, "directions", "the state's size")
    if not tol >= 0 or not max_boxes >= 1:
        raise ValueError(f"tol must not be negative and max_boxes at least 1; got {tol!r} and {max_boxes!r}")
    domain, scale = system.state_set.product(system.input_set), _scale(system)
    unit = _power_below(np.abs(directions * scale[:n]).max(axis=1))
    with precision(bits):
        found = [
            _search(
                _Residual(system.f, m, directions, scale, unit), (domain & m.region).in_units(scale), tol, max_boxes
            )
            for m in modes
        ]
        bound = np.array([[_upper(b, t) for b, t in zip(row, unit)] for row, *_ in found])
    attained, boxes = np.array([row for _, row, _ in found]) * unit, np.array([number for *_, number in found])
    for number, row in enumerate(bound, start=1):
        if (row == np.inf).any():
            raise ValueError(
                f"no finite error could be proven in region {number} with {boxes[number - 1]} boxes; f or a "
                "derivative is not finite there (log or sqrt at 0?), or max_boxes is too small"
            )
    return ErrorProof(directions, bound, attained, boxes, float(tol), int(bits), unit)


def error_directions(n):
    """Normals of error sets: e_i, -e_i, and all e_i + e_j, e_i - e_j, -e_i + e_j, -e_i - e_j with i < j.

    For n = 2 the eight directions of the paper's template, here with whole numbers, so that a difference of
    two equal components is exactly 0.

    Returns
    -------
    array (2 n^2, n)
    """
    identity = np.eye(n)
    signs = list(product((1, -1), (1, -1)))
    mixed = [s * identity[i] + t * identity[j] for j in range(n) for i in range(j) for s, t in signs]
    return np.vstack([box_directions(n), *mixed]) + 0.0


# -- arguments ------------------------------------------------------------------------------------


def _nonlinear(f, state_set, input_set):
    """f with its sets as a NonlinearSystem."""
    if isinstance(f, NonlinearSystem):
        return replace(f, state_set=state_set or f.state_set, input_set=input_set or f.input_set)
    if not isinstance(f, Callable):
        raise TypeError(f"f must be a NonlinearSystem or a function f(x, u); got {type(f).__name__}")
    if state_set is None or input_set is None:
        raise ValueError("a function f needs state_set and input_set: the error is proven over X x U")
    return NonlinearSystem(f, state_set, input_set)


def _checked_regions(regions, system):
    """Regions as a list; ValueError if there is none, or one of another dimension, or X or U is no bounded set."""
    regions = list(regions)
    if not regions:
        raise ValueError("there are no regions; give at least one")
    for name, part in (("state_set", system.state_set), ("input_set", system.input_set)):
        if part.is_empty or not part.is_bounded:
            raise ValueError(f"{name} must be bounded and not empty; an error over all of it is to be proven")
    n, m = system.state_set.dimension, system.input_set.dimension
    for number, region in enumerate(regions, start=1):
        if region.dimension != n + m:
            raise ValueError(f"region {number} lies in R^{region.dimension}, but (x, u) has {n} + {m} entries")
    return regions


def _require_choice(value, choices, name):
    if value not in choices:
        raise ValueError(f"{name} must be one of {', '.join(map(repr, choices))}; got {value!r}")


def _point(n):
    return Polytope.box(np.zeros(n), np.zeros(n))


# -- units ----------------------------------------------------------------------------------------


def _scale(system):
    """Powers of two near the half-widths of X x U, by which x and u are divided: array (n+m,)."""
    ends = [_extent(part) for part in (system.state_set, system.input_set)]
    lower, upper = (np.concatenate(side) for side in zip(*ends))
    size = np.maximum(np.abs(lower), np.abs(upper))
    return _power_below(np.maximum((upper - lower) / 2, FLAT * size))


def _extent(P):
    """Lower and upper ends (n,) of a bounded set: from its own rows where it is a box, which leaves tiny ones exact."""
    upper, lower = np.full(P.dimension, np.inf), np.full(P.dimension, -np.inf)
    for row, offset in zip(P.H, P.h):
        used = np.flatnonzero(row)
        if len(used) == 1:
            i, limit = used[0], offset / row[used[0]]
            upper[i], lower[i] = (min(upper[i], limit), lower[i]) if row[i] > 0 else (upper[i], max(lower[i], limit))
    return (lower, upper) if np.isfinite(upper - lower).all() else P.bounding_box()


def _power_below(sizes):
    """The largest powers of two that do not exceed positive sizes; 1 for a size of 0."""
    return np.where(sizes > 0, np.ldexp(0.5, np.frexp(sizes)[1]), 1.0)


def _upper(bound, unit):
    """The float bound * unit, rounded upward; -inf and inf stay."""
    return upper_float(ball(bound) * ball(unit)) if np.isfinite(bound) else bound


# -- fits -----------------------------------------------------------------------------------------


def _grid_points(part, grid):
    """Points of the fit in a part of X x U, array (N, n+m): a grid, and the vertices where it is too coarse."""
    if part.is_empty:
        return np.zeros((0, part.dimension))
    axes = [np.linspace(low, high, grid) for low, high in zip(*part.bounding_box())]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, part.dimension)
    points = np.unique(points[part.contains(points, tol=INSIDE)], axis=0)
    return points if len(points) > part.dimension else np.vstack([points, part.vertices()])


def _values(f, points, n, number):
    """f at points (N, n+m), array (N, n)."""
    values = np.empty((len(points), n))
    for k, point in enumerate(points):
        value = np.asarray(f(point[:n], point[n:]), float)
        if value.shape != (n,):
            raise ValueError(f"f gives an array of shape {value.shape}, but the state has {n} entries")
        if not np.isfinite(value).all():
            where = f"x = {point[:n].tolist()}, u = {point[n:].tolist()}"
            raise ValueError(f"f gives {value.tolist()} at {where} in region {number}; it must be finite on X x U")
        values[k] = value
    return values


def _mode(fit, points, values, region, scale):
    """The mode that fits values (N, n) at points (N, n+m); zeros where there are no points."""
    n = values.shape[1]
    columns, units = np.append(scale, 1.0), scale[:n]
    regressors = np.column_stack([points, np.ones(len(points))]) / columns
    theta = fit(regressors, values / units) if len(points) else np.zeros((regressors.shape[1], n))
    theta = theta * units / columns[:, None]
    return Mode(theta[:n].T, theta[n:-1].T, theta[-1], region)


def _least_squares(regressors, values):
    """theta (n+m+1, n) with the smallest sum of squares; of smallest size where points leave it open."""
    return np.linalg.lstsq(regressors, values, rcond=None)[0]


def _minimax(regressors, values):
    """theta (n+m+1, n) with the smallest largest error of each component: min t, |values - regressors theta| <= t."""
    size, columns = regressors.shape[1], []
    ones = np.ones((len(regressors), 1))
    rows = np.vstack([np.hstack([regressors, -ones]), np.hstack([-regressors, -ones])])
    for y in values.T:
        answer = linprog(
            np.eye(size + 1)[-1],
            rows,
            np.concatenate([y, -y]),
            bounds=[(None, None)] * (size + 1),
            options={"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10},
        )
        if answer.x is None:
            raise SolverError(f"HiGHS ended the minimax fit with: {answer.message}")
        columns.append(answer.x[:-1])
    return np.column_stack(columns)


def _recentred(modes, proof):
    """Modes with p moved by the middle of the proven error, and the proof that holds for them."""
    n = len(modes[0].p)
    upper, lower = proof.bound[:, :n], -proof.bound[:, n : 2 * n]
    used = np.isfinite(upper)
    before = np.array([mode.p for mode in modes])
    after = before + np.add(upper, lower, where=used, out=np.zeros(upper.shape)) / 2
    return [replace(mode, p=p) for mode, p in zip(modes, after)], proof.shifted(before, after)


def _shift(bound, before, after, directions):
    """Upper bounds (k,) after p went from `before` to `after`: bound - v (after - before), rounded upward."""
    with precision():
        step = [ball(b) - ball(a) for a, b in zip(before, after)]
        return [
            upper_float(ball(offset) - sum(ball(c) * s for c, s in zip(v, step))) if np.isfinite(offset) else offset
            for offset, v in zip(bound, directions)
        ]


# -- branch and bound -----------------------------------------------------------------------------


class _Residual:
    """v (f(x, u) - A x - B u - p) / unit for the rows v of `directions` (k, n), as a function of (x, u) / scale."""

    def __init__(self, f, mode, directions, scale, unit):
        self.f, self.mode, self.directions, self.scale, self.unit = f, mode, directions, scale, unit
        self.n = len(mode.A)
        self.affine = [[ball(entry) for entry in row] for row in np.column_stack([mode.A, mode.B, mode.p])]
        self.scales = [ball(s) for s in scale]
        self.rows = [[ball(c) / ball(t) for c in v] for v, t in zip(directions, unit)]

    def at(self, point):
        """Values (k,) in floating point."""
        z = point * self.scale
        x, u = z[: self.n], z[self.n :]
        with np.errstate(all="ignore"):
            return self.directions @ (np.asarray(self.f(x, u), float) - self.mode.successor(x, u)) / self.unit

    def _jets(self, point, order):
        """The components of f at a point (n+m,) of balls in units of `scale`."""
        z = [c * s for c, s in zip(point, self.scales)]
        jets = evaluate(self.f, z[: self.n], z[self.n :], order)
        if len(jets) != self.n:
            raise ValueError(f"f gives {len(jets)} components, but the state has {self.n} entries")
        return z, jets

    def tangent(self, centre, rows):
        """[e(c), gradient of e at c] for some of the directions, as balls (len(rows), 1 + n+m)."""
        z, jets = self._jets([ball(c) for c in centre], 1)
        table = []
        for jet, (*slope, offset) in zip(jets, self.affine):
            value = jet.value - offset - sum(a * c for a, c in zip(slope, z))
            table.append([value] + [(g - a) * s for g, a, s in zip(jet.gradient, slope, self.scales)])
        return self._combine(rows, table)

    def curvature(self, box, rows):
        """Hessian of e over a box, entries `pairs(n+m)`, for some of the directions."""
        both = [self.scales[i] * self.scales[j] for i, j in pairs(len(self.scales))]
        _, jets = self._jets(box, 2)
        return self._combine(rows, [[h * s for h, s in zip(jet.hessian, both)] for jet in jets])

    def _combine(self, rows, table):
        """Some rows of directions / unit @ a table (n, c) of balls, as nested lists of balls."""
        matrix = flint().arb_mat
        return (matrix([self.rows[k] for k in rows]) * matrix(table)).tolist()


class _Rows:
    """The rows H z <= h of a polytope, and multipliers for the bounds."""

    def __init__(self, P):
        self.P = P
        self.H = [[ball(c) for c in row] for row in P.H]
        self.h = [ball(offset) for offset in P.h]
        self.centre = P.chebyshev()[0]
        self.program = LinearProgram()
        self.z = self.program.add_columns(np.full(P.dimension, -np.inf), np.full(P.dimension, np.inf))
        self.program.add_rows(self.z, P.H, upper=P.h)

    def multipliers(self, objective):
        """A solution (n+m,) of max objective z, or None if there is none, and y >= 0 (rows,) from its dual."""
        best = self.program.maximize(self.z, objective)
        if best.point is None:
            return None, np.zeros(len(self.P.h))
        dual = self.program.multipliers()
        return best.point, np.where(dual > 0, dual, 0.0)

    def enclosing_box(self):
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

    def cutting(self, centre, radius):
        """Indices of the rows that cut a box, or None if one of them certainly excludes all of it."""
        middle, reach = self.P.H @ centre, np.abs(self.P.H) @ radius
        slack = CUTS * (1 + np.abs(self.P.h))
        for k in np.flatnonzero(middle - reach > self.P.h):
            lowest = sum(a * ball(c) - abs(a) * ball(r) for a, c, r in zip(self.H[k], centre, radius))
            if lowest > self.h[k]:
                return None
        return np.flatnonzero(middle + reach > self.P.h + slack)

    def nearest(self, point):
        """The point, moved a little towards the centre of P if rounding put it outside; None if it is far outside."""
        for candidate in (point, point + PULL * (self.centre - point)):
            if self.P.contains(candidate):
                return candidate
        return None


@dataclass
class _Box:
    """A box, what is proven in it (k,), and the coordinate along which to cut it."""

    lower: np.ndarray
    upper: np.ndarray
    bound: np.ndarray
    axis: int | None = None

    def halves(self):
        middle = (self.lower[self.axis] + self.upper[self.axis]) / 2
        for name in ("upper", "lower"):
            half = _Box(self.lower.copy(), self.upper.copy(), self.bound.copy())
            getattr(half, name)[self.axis] = middle
            yield half


def _search(residual, part, tol, max_boxes):
    """Bound (k,), attained (k,) and number of boxes for one part of X x U."""
    k = len(residual.directions)
    nothing = np.full(k, -np.inf)
    if part.is_empty:
        return nothing, nothing, 0
    rows = _Rows(part)
    ends = rows.enclosing_box()
    if ends is None:
        return nothing, nothing, 0

    attained, closed, heap, order = nothing.copy(), nothing.copy(), [], count()
    fresh, boxes = [_Box(*ends, np.full(k, np.inf))], 0
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
    return np.max([closed, *(box.bound for *_, box in heap)], axis=0), attained, boxes


def _undecided(bound, attained, tol):
    """Directions (k,) in which a bound still exceeds what is attained by more than the tolerance."""
    size = np.where(np.isfinite(attained), np.maximum(SMALL, np.abs(attained)), SMALL)
    return bound > attained + tol * size


def _tighten(box, residual, rows, undecided, attained):
    """Improve box.bound in the undecided directions, and `attained` by points found; False if it holds no point."""
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
        y, y_used = np.zeros(0), []
        if len(cuts):
            corner, y = rows.multipliers([float(g) for g in tangent[1:]])
            y_used = np.flatnonzero(y)
            points += [corner] if corner is not None else []
        bound, step, score = _taylor_bound(tangent, hessian, r, centre, rows, y, y_used)
        box.bound[direction] = min(box.bound[direction], upper_float(bound))
        points.append(np.clip(centre + step, box.lower, box.upper))
        if len(cuts):
            reach = np.abs(rows.P.H[cuts]).max(axis=0)
            score = score + radius * (np.abs([float(g) for g in tangent[1:]]) * (reach > 0) + 1e-3 * reach)
        scores = np.maximum(scores, score)
    _attain(points, residual, rows, attained)
    width = box.upper - box.lower
    scores[(box.lower + width / 2 <= box.lower) | (box.lower + width / 2 >= box.upper)] = 0.0
    box.axis = int(np.argmax(scores)) if scores.max() > 0 else None
    return True


def _taylor_bound(tangent, hessian, r, centre, rows, y, used):
    """The right-hand side in the notes of `prove_error`, its maximiser h, and what each coordinate adds to its excess.

    Returns
    -------
    arb, array (n+m,), array (n+m,)
    """
    size = len(r)
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
    return value, step, score


def _parabola(g, q, r):
    """Upper bound on g h + q h^2 / 2 over |h| <= r, for any g in its ball, and about where it is attained."""
    steep = g.abs_upper()
    if not r > 0:
        return ball(0), 0.0
    sign = 1.0 if g.mid() >= 0 else -1.0
    if steep + q * r >= 0:
        return steep * r + q * r * r / 2, sign * float(r)
    return -(steep * steep) / (2 * q), sign * float(-steep / q)


def _attain(points, residual, rows, attained):
    """Raise `attained` to the values at those points that lie in the polytope, in place."""
    seen = set()
    for point in points:
        inside = rows.nearest(point)
        if inside is not None and inside.tobytes() not in seen:
            seen.add(inside.tobytes())
            np.fmax(attained, residual.at(inside), out=attained)
