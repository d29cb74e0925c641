"""Piecewise-affine fits of nonlinear systems: least squares or minimax, with proven error sets.

The paper's 0.1186 is the largest error at the points of the fit. Theorem UUB of [Teichrib2025] needs a bound at all
points of X x U, which `prove_error` gives.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from ..checks import require_bools, whole_number
from ..errors import SolverError
from ..sets.polytope import Polytope
from ..systems.nonlinear import NonlinearSystem
from ..systems.pwa import Mode, PWASystem
from ..tolerances import ERROR_GAP, GRID_POINT
from ..typing import Array
from .domain import checked_regions, domain_units, nonlinear_system
from .error_bound import MAX_BOXES, ErrorProof, prove_error

METHODS = ("least_squares", "minimax")
ERRORS = ("box", "polytope", "ball")


@dataclass(frozen=True, eq=False)
class PWAFit:
    """A piecewise-affine approximation of x+ = f(x, u), eq. (28), f, with proven error sets.

    Attributes
    ----------
    modes : tuple of Mode
        One per region, in the order given; the disturbance sets are what `error` and `per_mode` say.
    max_error : float
        Largest |f - f_PWA|_inf at the points of the fit, in units of x: the paper's number, in floating point, not a
        bound.
    proof : ErrorProof
        The bounds from which the error sets are built.
    state_set, input_set : Polytope
        X and U.
    method : "least_squares" or "minimax"
    grid : int
        Points per axis and region.
    error : "box", "polytope" or "ball"
        Shape of the disturbance sets; see `fit_pwa`.
    per_mode : bool
        Whether each mode has the error set of its own region.

    See Also
    --------
    fit_pwa : Makes it.
    """

    modes: tuple[Mode, ...]
    max_error: float
    proof: ErrorProof = field(repr=False)
    state_set: Polytope
    input_set: Polytope
    method: str
    grid: int
    error: str
    per_mode: bool

    def __repr__(self) -> str:
        return (
            f"PWAFit({len(self.modes)} modes, {self.method} on {self.grid} points per axis, "
            f"largest error {self.max_error:.6g} at them, {self.proven_error:.6g} proven)"
        )

    @property
    def proven_error(self) -> float:
        """Upper bound on |f - f_PWA|_inf over all of X x U, in units of x."""
        return float(self.errors.max())

    @property
    def errors(self) -> Array:
        """Upper bound on |f - f_PWA|_inf over each region, array (s,); 0 where a region does not meet X x U."""
        n = self.state_set.dimension
        return np.where(self._used, self.proof.bound[:, : 2 * n].max(axis=1), 0.0)

    @property
    def error_range(self) -> tuple[Array, Array]:
        """lower, upper: arrays (s, n), the smallest and largest f - f_PWA of each component, proven."""
        n = self.state_set.dimension
        bound = np.where(self._used[:, None], self.proof.bound, 0.0)
        return -bound[:, n : 2 * n], bound[:, :n]

    @property
    def error_boxes(self) -> tuple[Polytope, ...]:
        """The smallest box around the error of each mode, tuple of Polytope."""
        return tuple(Polytope.box(lower, upper) for lower, upper in zip(*self.error_range))

    @cached_property
    def error_sets(self) -> tuple[Polytope, ...]:
        """The error of each mode between parallel planes with the normals `error_directions`, tuple of Polytope."""
        return tuple(self.proof.error_set(i) for i in range(len(self.modes)))

    def with_error(self, error: str, per_mode: bool | None = None) -> "PWAFit":
        """The same fit with other disturbance sets.

        Parameters
        ----------
        error : "box", "polytope" or "ball"
            See `fit_pwa`.
        per_mode : bool or None
            None keeps the present choice.

        Raises
        ------
        ValueError
            If `error` is none of the three.
        """
        _require_choice(error, ERRORS, "error")
        per_mode = self.per_mode if per_mode is None else per_mode
        sets = self._disturbances(error, per_mode)
        modes = tuple(replace(mode, disturbance=D) for mode, D in zip(self.modes, sets))
        return replace(self, modes=modes, error=error, per_mode=per_mode)

    def system(self) -> PWASystem:
        """The PWASystem of this fit; modes whose region does not meet X x U are left out.

        Its `to_dict` stores the fit as numbers.
        """
        return PWASystem([m for m, used in zip(self.modes, self._used) if used], self.state_set, self.input_set)

    @property
    def _used(self) -> NDArray[np.bool_]:
        """Whether the region of each mode meets X x U: array (s,) of bool."""
        return np.all(np.isfinite(self.proof.bound), axis=1)

    def _disturbances(self, error: str, per_mode: bool) -> Sequence[Polytope]:
        """One error set per mode; the same for all unless `per_mode`."""
        n = self.state_set.dimension
        if not per_mode:
            worst = replace(self.proof, bound=np.broadcast_to(self.proof.bound.max(axis=0), self.proof.bound.shape))
            return replace(self, proof=worst)._disturbances(error, True)
        if error == "ball":
            return [Polytope.box(np.full(n, -radius), np.full(n, radius)) for radius in self.errors]
        return self.error_boxes if error == "box" else self.error_sets


def fit_pwa(
    f: NonlinearSystem | Callable[[Any, Any], Any],
    regions: Iterable[Polytope],
    state_set: Polytope | None = None,
    input_set: Polytope | None = None,
    *,
    method: str = "least_squares",
    grid: int = 10,
    error: str = "box",
    per_mode: bool = False,
    tol: float = ERROR_GAP,
    max_boxes: int = MAX_BOXES,
) -> PWAFit:
    """Fit A x + B u + p to f(x, u) in every region, and prove a bound on the error.

    Parameters
    ----------
    f : NonlinearSystem or callable
        f(x, u) -> n components, for x (n,) and u (m,); by the operations in `balls.ALLOWED`.
    regions : sequence of Polytope
        In (x, u); what lies outside X x U does not count.
    state_set, input_set : Polytope or None
        X and U; needed with a callable, taken from a NonlinearSystem otherwise.
    method : "least_squares" or "minimax"
        Smallest sum of squares, or smallest largest error of each component, at the points of the grid.
        After minimax, p is moved by the middle of the proven error, so that the error of each component
        is symmetric over the whole region.
    grid : int
        Points per axis, ends included, over the bounding box of each region; points outside it are dropped.
    error : "box", "polytope" or "ball"
        Disturbance set: the smallest box around the error; the tighter polytope with normals `error_directions`;
        or the paper's |d|_inf <= proven error.
    per_mode : bool
        True gives each mode the error of its own region; False gives all the same set, as the paper does.
    tol, max_boxes
        As for `prove_error`.

    Returns
    -------
    PWAFit

    Raises
    ------
    TypeError
        If an argument has the wrong type, or f uses a function that ball arithmetic does not have.
    ValueError
        If sizes do not match, f is not finite somewhere, or no finite error can be proven.
    SolverError
        If an LP ends without an answer.

    See Also
    --------
    prove_error : The bound alone, for modes from elsewhere.
    PWAFit.with_error : Other disturbance sets for the same fit.

    Notes
    -----
    Second case study of [Teichrib2025]; its error of 0.1186 comes from a grid of 10.

    Examples
    --------
    >>> import mireach as mr
    >>> X = U = mr.Polytope.box([-1], [1])
    >>> fit = mr.fit_pwa(lambda x, u: [x[0] ** 2 / 4 + u[0]], [X.product(U)], X, U, method="minimax")
    >>> round(fit.proven_error, 6), fit.modes[0].p.round(6).tolist()
    (0.125, [0.125])
    """
    system = nonlinear_system(f, state_set, input_set)
    regions = checked_regions(regions, system)
    require_bools(per_mode=per_mode)
    _require_choice(method, METHODS, "method")
    _require_choice(error, ERRORS, "error")
    grid = whole_number(grid, "grid", 2)

    domain, n = system.state_set.product(system.input_set), system.state_set.dimension
    fit = {"least_squares": _least_squares, "minimax": _minimax}[method]
    scale = domain_units(system)
    points = [_grid_points((domain & region).in_units(scale), grid) * scale for region in regions]
    values = [_values(system.f, z, n, number) for number, z in enumerate(points, start=1)]
    modes = [_mode(fit, z, y, region, scale) for z, y, region in zip(points, values, regions)]
    proof = prove_error(system, modes, tol=tol, max_boxes=max_boxes)
    if method == "minimax":
        modes, proof = _recentred(modes, proof)
    largest = max(
        np.abs(y - mode.successor(z[:, :n], z[:, n:])).max(initial=0.0) for mode, z, y in zip(modes, points, values)
    )
    result = PWAFit(
        modes=tuple(modes),
        max_error=float(largest),
        proof=proof,
        state_set=system.state_set,
        input_set=system.input_set,
        method=method,
        grid=grid,
        error=error,
        per_mode=per_mode,
    )
    return result.with_error(error)


def _require_choice(value: str, choices: Sequence[str], name: str) -> None:
    """Raise ValueError unless `value` is one of `choices`."""
    if value not in choices:
        raise ValueError(f"{name} must be one of {', '.join(map(repr, choices))}; got {value!r}")


# -- points and values ----------------------------------------------------------------------------


def _grid_points(part: Polytope, grid: int) -> Array:
    """Points of the fit in a part of X x U, array (N, n+m): a grid, and the vertices where it is too coarse."""
    if part.is_empty:
        return np.zeros((0, part.dimension))
    axes = [np.linspace(low, high, grid) for low, high in zip(*part.bounding_box())]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, part.dimension)
    points = np.unique(points[part.contains(points, tol=GRID_POINT)], axis=0)
    return points if len(points) > part.dimension else np.vstack([points, part.vertices()])


def _values(f: Callable[[Any, Any], Any], points: Array, n: int, number: int) -> Array:
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


# -- fits -----------------------------------------------------------------------------------------


def _mode(fit: Callable[[Array, Array], Array], points: Array, values: Array, region: Polytope, scale: Array) -> Mode:
    """The mode that fits values (N, n) at points (N, n+m); zeros where there are no points."""
    n = values.shape[1]
    columns, units = np.append(scale, 1.0), scale[:n]
    regressors = np.column_stack([points, np.ones(len(points))]) / columns
    theta = fit(regressors, values / units) if len(points) else np.zeros((regressors.shape[1], n))
    theta = theta * units / columns[:, None]
    return Mode(theta[:n].T, theta[n:-1].T, theta[-1], region)


def _least_squares(regressors: Array, values: Array) -> Array:
    """theta (n+m+1, n) with the smallest sum of squares; of smallest size where points leave it open."""
    return np.asarray(np.linalg.lstsq(regressors, values, rcond=None)[0], float)


def _minimax(regressors: Array, values: Array) -> Array:
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


def _recentred(modes: list[Mode], proof: ErrorProof) -> tuple[list[Mode], ErrorProof]:
    """Modes with p moved by the middle of the proven error, and the proof that holds for them."""
    n = len(modes[0].p)
    upper, lower = proof.bound[:, :n], -proof.bound[:, n : 2 * n]
    used = np.isfinite(upper)
    before = np.array([mode.p for mode in modes])
    after = before + np.add(upper, lower, where=used, out=np.zeros(upper.shape)) / 2
    return [replace(mode, p=p) for mode, p in zip(modes, after)], proof.shifted(before, after)
