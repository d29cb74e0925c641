"""Piecewise-affine systems with bounded disturbances (eqs. SysWithDis, HRep, dinDi), and nonlinear systems."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from ..arithmetic.rational import binary, dot, nearest, strict_point
from ..checks import real_array, require_columns, require_kind
from ..sets.polytope import Polytope

OVERLAP = 1e-7  # radius of the smallest ball that counts as an overlap of regions (relative to the size of X and U)
OPPOSITE = 1e-6  # rows whose unit normals add up to less than this name the same boundary from both sides


@dataclass(frozen=True, eq=False)
class Mode:
    """x+ = A x + B u + p + d, d in D, wherever (x, u) lies in the closed region P (eqs. SysWithDis, dinDi).

    Parameters
    ----------
    A : array (n, n)
    B : array (n, m)
    p : array (n,)
    region : Polytope
        P^(i) in R^(n+m), the rows H^(i) (x, u) <= h^(i) of eq. HRep. It need not repeat the limits of
        x and u: only its part in X x U counts.
    disturbance : Polytope or None
        D^(i) in R^n: a box, a segment, a single point, any polytope. None is the point 0.

    Raises
    ------
    ValueError
        If sizes do not match, a row of the region says 0 <= -1, or the disturbance set is empty or unbounded.
    """

    A: np.ndarray
    B: np.ndarray
    p: np.ndarray
    region: Polytope
    disturbance: Polytope | None = None

    def __post_init__(self):
        for name, ndim in (("A", 2), ("B", 2), ("p", 1)):
            object.__setattr__(self, name, real_array(getattr(self, name), name, ndim))
        n = len(self.A)
        require_columns(self.A, n, "A", "for A is square")
        require_columns(self.p, n, "p", "the rows of A")
        if len(self.B) != n:
            raise ValueError(f"B has {len(self.B)} rows but A has {n}; both give the next state")
        if self.disturbance is None:
            object.__setattr__(self, "disturbance", Polytope.box(np.zeros(n), np.zeros(n)))
        require_kind(self.region, Polytope, "region")
        require_kind(self.disturbance, Polytope, "disturbance")
        impossible = ~self.region.H.any(axis=1) & (self.region.h < 0)
        if impossible.any():
            row = int(np.argmax(impossible))
            raise ValueError(f"row {row + 1} of region says 0 <= {self.region.h[row]:g}, which holds nowhere")
        if self.region.dimension != n + self.B.shape[1]:
            raise ValueError(
                f"region lies in R^{self.region.dimension}, but (x, u) has {n} + {self.B.shape[1]} entries; "
                "a region of x alone has zero columns for u"
            )
        if self.disturbance.dimension != n:
            raise ValueError(f"disturbance lies in R^{self.disturbance.dimension}, but the state has {n} entries")
        if self.disturbance.is_empty:
            raise ValueError("disturbance is an empty set; use None for no disturbance")
        if not self.disturbance.is_bounded:
            raise ValueError("disturbance is unbounded; no robustly invariant set can be bounded then")

    def successor(self, x, u, d=0.0):
        """A x + B u + p + d, for (n,) or (N, n)."""
        return x @ self.A.T + u @ self.B.T + self.p + d


@dataclass(frozen=True, eq=False)
class PWASystem:
    """The modes of a piecewise-affine system and its constraints X and U.

    Parameters
    ----------
    modes : sequence of Mode
        Closed regions that cover X x U; they may share boundaries, and there every mode that contains
        the point counts. That they leave no gap is decided without rounding, each number being the float
        that it is: write a boundary as a x <= b in one region and as -a x <= -b, the same numbers, in the other.
    state_set : Polytope
        X in R^n.
    input_set : Polytope
        U in R^m.

    Raises
    ------
    ValueError
        If sizes do not match, X or U is empty or unbounded, or the regions leave a gap in X x U or
        overlap; the message gives a point.

    Warns
    -----
    UserWarning
        If the region of a mode does not meet X x U.
    """

    modes: tuple
    state_set: Polytope
    input_set: Polytope

    def __post_init__(self):
        require_kind(self.modes, (list, tuple), "modes")
        for number, mode in enumerate(self.modes, start=1):
            require_kind(mode, Mode, f"mode {number}")
        object.__setattr__(self, "modes", tuple(self.modes))
        if not self.modes:
            raise ValueError("modes is empty; a system needs at least one mode")
        n, m = self.modes[0].B.shape
        for number, mode in enumerate(self.modes, start=1):
            if mode.B.shape != (n, m):
                raise ValueError(f"mode {number} has B of shape {mode.B.shape}, but mode 1 has {(n, m)}")
        for name, value, size in (("state_set", self.state_set, n), ("input_set", self.input_set, m)):
            require_kind(value, Polytope, name)
            if value.dimension != size:
                raise ValueError(f"{name} lies in R^{value.dimension}, but the modes need R^{size}")
            if value.is_empty:
                raise ValueError(f"{name} is empty; the system has nowhere to be")
            if not value.is_bounded:
                raise ValueError(f"{name} is unbounded; cells and big-M need a bounded set, such as a large box")
        _check_partition(tuple(mode.region for mode in self.modes), self.state_set, self.input_set)

    @property
    def state_size(self):
        """n."""
        return self.modes[0].B.shape[0]

    @property
    def input_size(self):
        """m."""
        return self.modes[0].B.shape[1]

    def state_regions(self):
        """For each mode the part of X that the rows of its region leave which do not involve u: list of Polytope."""
        n, X = self.state_size, self.state_set
        found = []
        for mode in self.modes:
            of_x = (mode.region.H[:, n:] == 0).all(axis=1)
            found.append(Polytope(mode.region.H[of_x, :n], mode.region.h[of_x]) & X if of_x.any() else X)
        return found

    def with_disturbance(self, disturbance):
        """The same system with other disturbance sets.

        Parameters
        ----------
        disturbance : Polytope or sequence of Polytope
            One for all modes, or one a mode.
        """
        require_kind(disturbance, (Polytope, list, tuple), "disturbance")
        sets = [disturbance] * len(self.modes) if isinstance(disturbance, Polytope) else list(disturbance)
        if len(sets) != len(self.modes):
            raise ValueError(f"got {len(sets)} disturbance sets for {len(self.modes)} modes; give one, or one a mode")
        return replace(self, modes=[replace(mode, disturbance=D) for mode, D in zip(self.modes, sets)])

    def violation(self, x, u):
        """How far (x, u) is from each mode's region: max over rows of H (x, u) - h, at least 0.

        Parameters
        ----------
        x : array (N, n)
        u : array (N, m)

        Returns
        -------
        array (N, s)
            0 where the closed region contains the point.
        """
        H, h, starts = self._rows
        excess = np.concatenate([x, u], axis=-1) @ H.T - h
        return np.maximum.reduceat(excess, starts, axis=-1)

    def successor(self, x, u, modes):
        """A x + B u + p of the given modes, without disturbance.

        Parameters
        ----------
        x : array (N, n)
        u : array (N, m)
        modes : array (N,) of int
            Which mode acts on each state, counted from 0.

        Returns
        -------
        array (N, n)
        """
        A, B, p = self.maps
        return np.einsum("tij,tj->ti", A[modes], x) + np.einsum("tij,tj->ti", B[modes], u) + p[modes]

    @cached_property
    def _rows(self):
        """The rows of all regions, each region begun by 0 (x, u) <= 0: H, h, and where each of them begins."""
        regions = [mode.region for mode in self.modes]
        H = [np.vstack([np.zeros(region.dimension), region.H]) for region in regions]
        h = [np.append(0.0, region.h) for region in regions]
        return np.vstack(H), np.concatenate(h), np.cumsum([0, *map(len, h[:-1])])

    @cached_property
    def maps(self):
        """A (s, n, n), B (s, n, m) and p (s, n) of all modes."""
        return tuple(np.array([getattr(mode, name) for mode in self.modes]) for name in "ABp")


@dataclass(frozen=True, eq=False)
class NonlinearSystem:
    """x+ = f(x, u) (eq. f) with constraints x in X and u in U.

    Parameters
    ----------
    f : callable
        f(x, u) -> n numbers; x and u are indexable. Arithmetic, whole powers and numpy's exp, log,
        sin, cos, tanh and sqrt may be used, so that f can be evaluated on numbers, arrays and balls.
    state_set : Polytope
    input_set : Polytope
    """

    f: Callable
    state_set: Polytope
    input_set: Polytope

    def __post_init__(self):
        require_kind(self.f, Callable, "f")
        require_kind(self.state_set, Polytope, "state_set")
        require_kind(self.input_set, Polytope, "input_set")

    def __call__(self, x, u):
        """f at (n,) and (m,), or at (N, n) and (N, m)."""
        x, u = np.asarray(x, float), np.asarray(u, float)
        require_columns(x, self.state_set.dimension, "x", "the state's size")
        require_columns(u, self.input_set.dimension, "u", "the input's size")
        values = self.f(np.moveaxis(x, -1, 0), np.moveaxis(u, -1, 0))
        return np.stack(np.broadcast_arrays(*values), axis=-1)

    def step(self, controller, x):
        """f(x, controller(x)) for (n,) or (N, n)."""
        return self(x, controller(x))

    def simulate(self, controller, x0, steps):
        """Trajectories of x+ = f(x, controller(x)).

        Parameters
        ----------
        controller : callable
            (N, n) -> (N, m), such as a MaxoutNetwork.
        x0 : array (n,) or (N, n)
        steps : int

        Returns
        -------
        array (steps + 1, n) or (N, steps + 1, n)
            Nothing stops a trajectory at the limits of X.
        """
        path = [np.asarray(x0, float)]
        for _ in range(steps):
            path.append(self.step(controller, path[-1]))
        return np.stack(path, axis=-2)


@lru_cache(maxsize=64)
def _check_partition(regions, state_set, input_set):
    """Raise ValueError unless the regions cover X x U without overlap (the text after eq. HRep)."""
    scale = np.concatenate([state_set.reach, input_set.reach])
    domain, n = state_set.product(input_set).in_units(scale), state_set.dimension
    scaled = [region.in_units(scale) for region in regions]
    parts = [domain & region for region in scaled]
    for number, part in enumerate(parts, start=1):
        if part.is_empty:
            warnings.warn(f"the region of mode {number} does not meet X x U; the mode is never used", stacklevel=4)
    boxes = [None if part.is_empty else part.bounding_box() for part in parts]
    for j, second in enumerate(boxes):
        for i, first in enumerate(boxes[:j]):
            if (
                first is None
                or second is None
                or (np.minimum(first[1], second[1]) - np.maximum(first[0], second[0])).min() <= OVERLAP
            ):
                continue
            centre, radius = (parts[i] & parts[j]).chebyshev()
            if radius > OVERLAP:
                raise ValueError(
                    f"the regions of modes {i + 1} and {j + 1} overlap around {_point(centre * scale, n)} "
                    f"(a ball of radius {radius:.3g} of the size of X x U); regions may share boundaries only"
                )
    gap = _Rows().cut(domain, scaled)
    if gap is not None:
        point = np.array([nearest(entry) for entry in gap])
        raise ValueError(
            f"no region contains {_point(point * scale, n)}, which lies in X x U; the regions must cover all of it"
            f"{_between(gap, scaled)}"
        )


class _Rows:
    """Half-planes a z <= b, some of them a z < b, in rational numbers; rows of one direction are kept once.

    Attributes
    ----------
    limits : dict
        Direction, scaled to a first entry of 1 or -1, to (offset, whether it is strict).
    point : tuple of fmpq or None
        A point of all of them, where one is known.
    """

    def __init__(self, limits=None, point=None):
        self.limits, self.point = limits or {}, point

    def cut(self, domain, regions):
        """A point of the domain that no region contains, or None."""
        inside = self
        for a, b in zip(binary(domain.H), binary(domain.h)):
            inside = inside and inside.with_row(a, b)
        return inside and inside.without([list(zip(binary(P.H), binary(P.h))) for P in regions])

    def with_row(self, a, b, strict=False):
        """These rows and a z <= b, or a z < b; None where another row contradicts it."""
        size = abs(next((entry for entry in a if entry), 1))
        if not any(a):
            return self if b > 0 or (b == 0 and not strict) else None
        key, limit = tuple(entry / size for entry in a), (b / size, not strict)
        limits = {**self.limits, key: min(limit, self.limits.get(key, limit))}
        offset, closed = limits[key]
        opposite = limits.get(tuple(-entry for entry in key))
        if opposite is not None and (offset + opposite[0], closed and opposite[1]) <= (0, False):
            return None
        known = self.point
        if known is not None and not (dot(a, known) < b or (dot(a, known) == b and not strict)):
            known = None
        return _Rows(limits, known)

    def located(self):
        """These rows with a point, or None if they have none in common."""
        if self.point is None:
            rows = [[], []], [[], []]
            for a, (b, closed) in self.limits.items():
                H, h = rows[0] if closed else rows[1]
                H.append(a)
                h.append(b)
            self.point = strict_point(*rows[0], *rows[1])
        return None if self.point is None else self

    def without(self, regions):
        """A point of these rows that lies in no region, or None: beyond a region's first row, or its second, ..."""
        if self.located() is None:
            return None
        for number, region in enumerate(regions):
            inside = self
            for a, b in region:
                inside = inside and inside.with_row(a, b)
            if inside is None or inside.located() is None:
                continue
            inside = self
            for a, b in region:
                beyond = inside.with_row(tuple(-entry for entry in a), -b, strict=True)
                gap = None if beyond is None else beyond.without(regions[number + 1 :])
                if gap is not None:
                    return gap
                inside = inside.with_row(a, b)
                if inside is None:
                    return None
            return None
        return self.point


def _between(point, regions):
    """Which two rows leave a point between them that should name the same boundary, as the end of a message."""
    outside = []
    for number, region in enumerate(regions, start=1):
        for row, (a, b) in enumerate(zip(binary(region.H), binary(region.h))):
            excess = dot(a, point) - b
            if excess > 0:
                length = np.linalg.norm(region.H[row])
                outside.append((number, row + 1, region.H[row] / length, nearest(excess) / length))
    pairs = [
        (one[3] + other[3], one, other)
        for i, one in enumerate(outside)
        for other in outside[:i]
        if one[0] != other[0] and np.abs(one[2] + other[2]).max() <= OPPOSITE
    ]
    if not pairs:
        return ""
    width, one, other = min(pairs, key=lambda pair: pair[0])
    return (
        f". It lies between row {other[1]} of mode {other[0]} and row {one[1]} of mode {one[0]}, in a gap of width "
        f"{width:.2g} of the size of X x U; if they are to name the same boundary, write it with the same numbers, as "
        "a x <= b and -a x <= -b"
    )


def _point(point, n):
    """x and u of a point of R^(n+m), for messages."""
    return f"x = {point[:n].tolist()}, u = {point[n:].tolist()}"
