"""Piecewise-affine systems with bounded disturbances: eqs. (1), (2), (13), SysWithDis, HRep, dinDi, [Teichrib2025]."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from ..arithmetic.rational import nearest
from ..checks import real_array, require_columns, require_kind
from ..sets.polytope import Polytope
from ..tolerances import OVERLAP
from ..typing import Array, ArrayLike, IntArray
from .partition import narrow_gap, uncovered_point


@dataclass(frozen=True, eq=False, init=False)
class Mode:
    """x+ = A x + B u + p + d, d in D, wherever (x, u) lies in the closed region P: eqs. (1), (13), SysWithDis, dinDi.

    Parameters
    ----------
    A : array (n, n)
    B : array (n, m)
    p : array (n,)
        In units of x.
    region : Polytope
        P^(i) in R^(n+m), the rows H^(i) (x, u) <= h^(i) of eq. (2), HRep. It need not repeat the limits of
        x and u: only its part in X x U counts.
    disturbance : Polytope or None
        D^(i) in R^n, in units of x: a box, a segment, a single point, any bounded polytope. None is the point 0.

    Raises
    ------
    TypeError
        If `region` or `disturbance` is not a Polytope.
    ValueError
        If sizes do not match, a row of the region says 0 <= -1, or the disturbance set is empty or unbounded.

    See Also
    --------
    PWASystem : Several modes with X and U.

    Examples
    --------
    x+ = x / 2 + u + d for x >= 0, with |d| <= 0.1:

    >>> from mireach import Mode, Polytope
    >>> mode = Mode([[0.5]], [[1.0]], [0.0], Polytope([[-1.0, 0.0]], [0.0]), Polytope.box([-0.1], [0.1]))
    >>> mode
    Mode(1 state, 1 input, 1 row)
    >>> mode.successor([2.0], [0.25]).tolist()
    [1.25]
    """

    A: Array
    B: Array
    p: Array
    region: Polytope
    disturbance: Polytope

    def __init__(
        self, A: ArrayLike, B: ArrayLike, p: ArrayLike, region: Polytope, disturbance: Polytope | None = None
    ) -> None:
        A, B = real_array(A, "A", 2), real_array(B, "B", 2)
        p = real_array(p, "p", 1)
        n = len(A)
        require_columns(A, n, "A", "for A is square")
        require_columns(p, n, "p", "the rows of A")
        if len(B) != n:
            raise ValueError(f"B has {len(B)} rows but A has {n}; both give the next state")
        if disturbance is None:
            disturbance = Polytope.box(np.zeros(n), np.zeros(n))
        _check_region(region, n, B.shape[1])
        _check_disturbance(disturbance, n)
        fields = {"A": A, "B": B, "p": p, "region": region, "disturbance": disturbance}
        for name, value in fields.items():
            object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        return f"Mode({_sizes(*self.B.shape)}, {_counted(len(self.region.h), 'row')})"

    def successor(self, x: ArrayLike, u: ArrayLike, d: ArrayLike = 0.0) -> Array:
        """A x + B u + p + d.

        Parameters
        ----------
        x : array (n,) or (N, n)
        u : array (m,) or (N, m)
        d : array like x, or 0

        Returns
        -------
        array (n,) or (N, n)
            Whether (x, u) lies in the region is not checked.
        """
        return np.asarray(x) @ self.A.T + np.asarray(u) @ self.B.T + self.p + np.asarray(d)

    def to_dict(self) -> dict[str, Any]:
        """{"A", "B", "p", "region", "disturbance"} as lists of numbers, which JSON reads back to the same floats."""
        return {
            "A": self.A.tolist(),
            "B": self.B.tolist(),
            "p": self.p.tolist(),
            "region": self.region.to_dict(),
            "disturbance": self.disturbance.to_dict(),
        }

    @staticmethod
    def from_dict(value: Mapping[str, Any]) -> "Mode":
        """Inverse of `to_dict`.

        Raises
        ------
        ValueError
            If a key is missing, or the numbers are not those of a mode.

        Examples
        --------
        >>> from mireach import Mode, Polytope
        >>> mode = Mode([[0.1]], [[1.0]], [0.0], Polytope([[-1.0, 0.0]], [0.0]))
        >>> Mode.from_dict(mode.to_dict()).A.tolist()
        [[0.1]]
        """
        A, B, p, region, disturbance = _entries(value, ("A", "B", "p", "region", "disturbance"), "a mode")
        return Mode(A, B, p, Polytope.from_dict(region), Polytope.from_dict(disturbance))


@dataclass(frozen=True, eq=False, init=False)
class PWASystem:
    """The modes of a piecewise-affine system and its constraints X and U, eqs. (1), (2), SysWithDis, HRep.

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
    TypeError
        If an argument has the wrong type.
    ValueError
        If sizes do not match, X or U is empty or unbounded, or the regions leave a gap in X x U or
        overlap; the message gives a point.

    Warns
    -----
    UserWarning
        If the region of a mode does not meet X x U.

    See Also
    --------
    ClosedLoop : The system under a network.
    fit_pwa : Modes that approximate a nonlinear system.

    Examples
    --------
    x+ = |x| / 2 + u:

    >>> from mireach import Mode, Polytope, PWASystem
    >>> left = Mode([[-0.5]], [[1.0]], [0.0], Polytope([[1.0, 0.0]], [0.0]))
    >>> right = Mode([[0.5]], [[1.0]], [0.0], Polytope([[-1.0, 0.0]], [0.0]))
    >>> PWASystem([left, right], Polytope.box([-4], [4]), Polytope.box([-1], [1]))
    PWASystem(2 modes, 1 state, 1 input)
    """

    modes: tuple[Mode, ...]
    state_set: Polytope
    input_set: Polytope

    def __init__(self, modes: Sequence[Mode], state_set: Polytope, input_set: Polytope) -> None:
        require_kind(modes, (list, tuple), "modes")
        for number, mode in enumerate(modes, start=1):
            require_kind(mode, Mode, f"mode {number}")
        if not modes:
            raise ValueError("modes is empty; a system needs at least one mode")
        n, m = modes[0].B.shape
        for number, mode in enumerate(modes, start=1):
            if mode.B.shape != (n, m):
                raise ValueError(f"mode {number} has B of shape {mode.B.shape}, but mode 1 has {(n, m)}")
        _check_constraint(state_set, "state_set", n)
        _check_constraint(input_set, "input_set", m)
        object.__setattr__(self, "modes", tuple(modes))
        object.__setattr__(self, "state_set", state_set)
        object.__setattr__(self, "input_set", input_set)
        _check_partition(tuple(mode.region for mode in modes), state_set, input_set)

    def __repr__(self) -> str:
        return f"PWASystem({_counted(len(self.modes), 'mode')}, {_sizes(self.state_size, self.input_size)})"

    @property
    def state_size(self) -> int:
        """n."""
        return self.modes[0].B.shape[0]

    @property
    def input_size(self) -> int:
        """m."""
        return self.modes[0].B.shape[1]

    def state_regions(self) -> list[Polytope]:
        """For each mode the part of X that the rows of its region leave which do not involve u."""
        n, X = self.state_size, self.state_set
        parts = []
        for mode in self.modes:
            of_x = (mode.region.H[:, n:] == 0).all(axis=1)
            parts.append(Polytope(mode.region.H[of_x, :n], mode.region.h[of_x]) & X if of_x.any() else X)
        return parts

    def with_disturbance(self, disturbance: Polytope | Sequence[Polytope]) -> "PWASystem":
        """The same system with other disturbance sets.

        Parameters
        ----------
        disturbance : Polytope or sequence of Polytope
            One for all modes, or one per mode, in units of x.

        Raises
        ------
        TypeError
            If it is neither.
        ValueError
            If the number of sets is not that of the modes, or a set does not fit.

        Examples
        --------
        >>> from mireach import Polytope, case_study
        >>> case_study("pwa").system.with_disturbance(Polytope.box([-0.1, 0], [0.1, 0]))
        PWASystem(4 modes, 2 states, 1 input)
        """
        require_kind(disturbance, (Polytope, list, tuple), "disturbance")
        sets = [disturbance] * len(self.modes) if isinstance(disturbance, Polytope) else list(disturbance)
        if len(sets) != len(self.modes):
            raise ValueError(f"got {len(sets)} disturbance sets for {len(self.modes)} modes; give one, or one per mode")
        modes = tuple(replace(mode, disturbance=D) for mode, D in zip(self.modes, sets))
        return replace(self, modes=modes)

    def violation(self, x: Array, u: Array) -> Array:
        """How far (x, u) is from each mode's region: max over rows of H (x, u) - h, at least 0.

        Parameters
        ----------
        x : array (N, n)
        u : array (N, m)

        Returns
        -------
        array (N, s)
            0 where the closed region contains the point; in units of the rows.
        """
        H, h, starts = self._rows
        excess = np.concatenate([x, u], axis=-1) @ H.T - h
        return np.maximum.reduceat(excess, starts, axis=-1)

    def successor(self, x: Array, u: Array, modes: IntArray) -> Array:
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
    def _rows(self) -> tuple[Array, Array, IntArray]:
        """The rows of all regions, each region begun by 0 (x, u) <= 0: H, h, and where each of them begins."""
        regions = [mode.region for mode in self.modes]
        H = [np.vstack([np.zeros(region.dimension), region.H]) for region in regions]
        h = [np.append(0.0, region.h) for region in regions]
        return np.vstack(H), np.concatenate(h), np.cumsum([0, *map(len, h[:-1])])

    @cached_property
    def maps(self) -> tuple[Array, Array, Array]:
        """A (s, n, n), B (s, n, m) and p (s, n) of all modes."""
        A, B, p = (np.array([getattr(mode, name) for mode in self.modes]) for name in "ABp")
        return A, B, p

    def to_dict(self) -> dict[str, Any]:
        """{"modes", "state_set", "input_set"} as lists of numbers, which JSON reads back to the same floats."""
        return {
            "modes": [mode.to_dict() for mode in self.modes],
            "state_set": self.state_set.to_dict(),
            "input_set": self.input_set.to_dict(),
        }

    @staticmethod
    def from_dict(value: Mapping[str, Any]) -> "PWASystem":
        """Inverse of `to_dict`.

        Raises
        ------
        ValueError
            If a key is missing, or the numbers are not those of a system.

        Examples
        --------
        >>> import json
        >>> from mireach import PWASystem, case_study
        >>> PWASystem.from_dict(json.loads(json.dumps(case_study("pwa").system.to_dict())))
        PWASystem(4 modes, 2 states, 1 input)
        """
        modes, state_set, input_set = _entries(value, ("modes", "state_set", "input_set"), "a system")
        if not isinstance(modes, list):
            raise ValueError(f"the modes of a system must be a list; got {modes!r:.80}")
        return PWASystem(
            [Mode.from_dict(mode) for mode in modes], Polytope.from_dict(state_set), Polytope.from_dict(input_set)
        )


# -- words ----------------------------------------------------------------------------------------


def _counted(number: int, noun: str) -> str:
    """A number and its noun: "1 state", "2 states"."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _sizes(n: int, m: int) -> str:
    """The sizes of x and u."""
    return f"{_counted(n, 'state')}, {_counted(m, 'input')}"


# -- checks ---------------------------------------------------------------------------------------


def _entries(value: Any, keys: tuple[str, ...], what: str) -> list[Any]:
    """The entries of a dict, in the order of `keys`; ValueError if it is no dict or lacks one."""
    if not isinstance(value, Mapping) or not set(keys) <= value.keys():
        raise ValueError(f"{what} needs the keys {', '.join(keys)}; got {value!r:.80}")
    return [value[key] for key in keys]


def _check_region(region: Polytope, n: int, m: int) -> None:
    """Raise an error unless `region` is a polytope in (x, u) whose rows of zeros say nothing."""
    require_kind(region, Polytope, "region")
    impossible = ~region.H.any(axis=1) & (region.h < 0)
    if impossible.any():
        row = int(np.argmax(impossible))
        raise ValueError(f"row {row + 1} of region says 0 <= {region.h[row]:g}, which holds nowhere")
    if region.dimension != n + m:
        raise ValueError(
            f"region lies in R^{region.dimension}, but (x, u) has {n} + {m} entries; "
            "a region of x alone has zero columns for u"
        )


def _check_disturbance(disturbance: Polytope, n: int) -> None:
    """Raise an error unless `disturbance` is a bounded polytope in R^n that is not empty."""
    require_kind(disturbance, Polytope, "disturbance")
    if disturbance.dimension != n:
        raise ValueError(f"disturbance lies in R^{disturbance.dimension}, but the state has {n} entries")
    if disturbance.is_empty:
        raise ValueError("disturbance is an empty set; use None for no disturbance")
    if not disturbance.is_bounded:
        raise ValueError("disturbance is unbounded; no robustly invariant set can be bounded then")


def _check_constraint(value: Polytope, name: str, size: int) -> None:
    """Raise an error unless `value` is a bounded polytope in R^size that is not empty."""
    require_kind(value, Polytope, name)
    if value.dimension != size:
        raise ValueError(f"{name} lies in R^{value.dimension}, but the modes need R^{size}")
    if value.is_empty:
        raise ValueError(f"{name} is empty; the system has nowhere to be")
    if not value.is_bounded:
        raise ValueError(f"{name} is unbounded; cells and big-M need a bounded set, such as a large box")


@lru_cache(maxsize=64)
def _check_partition(regions: tuple[Polytope, ...], state_set: Polytope, input_set: Polytope) -> None:
    """Raise ValueError unless the regions cover X x U without overlap (the text after eq. (2), HRep)."""
    scale = np.concatenate([state_set.half_width, input_set.half_width])
    domain, n = state_set.product(input_set).in_units(scale), state_set.dimension
    scaled = [region.in_units(scale) for region in regions]
    parts = [domain & region for region in scaled]
    for number, part in enumerate(parts, start=1):
        if part.is_empty:
            warnings.warn(f"the region of mode {number} does not meet X x U; the mode is never used", stacklevel=3)
    boxes = [None if part.is_empty else part.bounding_box() for part in parts]
    for j, second in enumerate(boxes):
        for i, first in enumerate(boxes[:j]):
            if (
                first is None
                or second is None
                or (np.minimum(first[1], second[1]) - np.maximum(first[0], second[0])).min() <= OVERLAP
            ):
                continue
            centre, radius = (parts[i] & parts[j]).chebyshev_centre()
            if radius > OVERLAP:
                raise ValueError(
                    f"the regions of modes {i + 1} and {j + 1} overlap around {_point(centre * scale, n)} "
                    f"(a ball of radius {radius:.3g} of the size of X x U); regions may share boundaries only"
                )
    gap = uncovered_point(domain, scaled)
    if gap is not None:
        point = np.array([nearest(entry) for entry in gap])
        raise ValueError(
            f"no region contains {_point(point * scale, n)}, which lies in X x U; the regions must cover all of it"
            f"{narrow_gap(gap, scaled)}"
        )


def _point(point: Array, n: int) -> str:
    """x and u of a point of R^(n+m), for messages."""
    return f"x = {point[:n].tolist()}, u = {point[n:].tolist()}"
