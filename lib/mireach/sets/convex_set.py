"""Convex sets {x : H x <= h} by their support functions: maxima, inclusion, emptiness (Sec. I.A of [Teichrib2025]).

Every number is the float that it is. Floating point is tried first, in units that follow the set (powers of two, so
that scaling rounds nothing). What it proposes is proven over the rationals, or else the rationals decide alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import combinations
from typing import Any, NamedTuple, Self, TypeAlias

import highspy
import numpy as np

from ..arithmetic import rational
from ..arithmetic.balls import flint
from ..arithmetic.rational import ExactOptimum, above, binary, nearest
from ..arithmetic.scaling import normal_rows
from ..checks import real_array, require_columns, require_kind
from ..errors import SolverError
from ..solvers.linear_program import LinearProgram
from ..tolerances import EXPRESSION, NEAR_VERTEX, PARALLEL_ROWS, SINGULAR_ROWS, SMALLEST, TOUCH
from ..typing import Array, ArrayLike, IntArray
from .exact_polytopes import ExactPolytope
from .kernels import EMPTY, FAT, around, dual_bounds, in_units, inclusion, membership, polygon

Rational: TypeAlias = Any  # an fmpq of python-flint, which has no types

MANY = 256  # rows in the plane up to which all vertices are computed when one is needed; directions remembered per H
MOST_VERTICES = 2_000  # of the sets that are cut row by row to find vertices; they take some seconds


class _Plane(NamedTuple):
    """What `kernels.polygon` returns."""

    kind: int
    corners: Array
    local: Array
    row: Array
    offset: Array
    unit: IntArray


@dataclass(frozen=True, eq=False, init=False)
class ConvexSet:
    """The closed convex set {x : H x <= h}: its support function, and the decisions that follow from it.

    It is the base class of `Polytope`, which adds vertices, sizes, and the operations that make new sets.

    Parameters
    ----------
    H : array (l, n)
        Outward normals, one per row, of any length.
    h : array (l,)
        Offsets, in units of H x.

    Raises
    ------
    ValueError
        If sizes do not match or an entry is not finite.
    """

    H: Array
    h: Array

    def __init__(self, H: ArrayLike, h: ArrayLike) -> None:
        rows, offsets = real_array(H, "H", 2), real_array(h, "h", 1)
        if len(rows) != len(offsets):
            raise ValueError(f"H has {len(rows)} rows but h has {len(offsets)} entries; each row needs one offset")
        if not rows.shape[1]:
            raise ValueError("H has no columns; a polytope needs at least one dimension")
        if not rows.flags.c_contiguous:  # the compiled functions need one layout
            rows = np.ascontiguousarray(rows)
            rows.setflags(write=False)
        object.__setattr__(self, "H", rows)
        object.__setattr__(self, "h", offsets)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.H, self.h)  # what is cached holds a solver and fractions, which cannot be pickled

    def __repr__(self) -> str:
        return f"{type(self).__name__}({len(self.h)} rows in R^{self.dimension})"

    # -- support function -------------------------------------------------------------------------

    @property
    def dimension(self) -> int:
        """n of R^n."""
        return self.H.shape[1]

    def support(self, V: ArrayLike) -> Array:
        """Support function h_P(v) = max {v x : x in P}, for each row v of V, as the nearest floats.

        Parameters
        ----------
        V : array (k, n)
            Directions, one per row.

        Returns
        -------
        array (k,)
            inf where P is unbounded along v, -inf where P is empty.

        Raises
        ------
        ValueError
            If V does not have n columns; the message gives both sizes.

        See Also
        --------
        bound : a proven upper bound; exact_maximum : without rounding; support_vector : where it is attained.

        Examples
        --------
        >>> from mireach import Polytope
        >>> Polytope([[1, 0]], [2]).support([[1, 0], [0, 1]])  # a half-plane
        array([ 2., inf])

        Notes
        -----
        In the plane a maximum over the vertices, which are computed over the rationals if the set is flat, a needle, or
        far from the origin for its size. Otherwise one `exact_maximum` per row. Sec. I.A of [Teichrib2025].
        """
        V = self._directions(V)
        if self._plane is not None and self._plane.kind == FAT:
            return (V @ self._plane.corners.T).max(axis=1)
        if self._plane is not None and len(self.h) <= MANY and np.isfinite(self._nearest_corners).all():
            return (V @ self._nearest_corners.T).max(axis=1, initial=-np.inf)
        return self._rounded(V, nearest)

    def bound(self, V: ArrayLike) -> Array:
        """Floats that are not below the support function, and hardly above it: array (k,).

        Parameters
        ----------
        V : array (k, n)
            Directions, one per row.

        Returns
        -------
        array (k,)
            inf where P is unbounded along v, -inf where P is empty. On the rows of H it does not exceed h.

        Raises
        ------
        ValueError
            If V does not have n columns; the message gives both sizes.

        See Also
        --------
        support : the nearest floats.

        Examples
        --------
        >>> from mireach import Polytope
        >>> P = Polytope([[3, 0], [-1, 0], [0, 1], [0, -1]], [1, 1, 1, 1])
        >>> P.bound([[1, 0]]) > 1 / 3  # the float 1 / 3 lies below one third
        array([ True])

        Notes
        -----
        In the plane weak duality, rounding included, where the vertices of P are certain; elsewhere exact.
        """
        V = self._directions(V)
        if not self._is_fat:
            return self._rounded(V, above)
        found = self._plane
        bound = dual_bounds(V, found.local, found.row, found.offset, found.unit)
        return np.minimum(bound, self.offsets(V))

    def _rounded(self, V: Array, rounding: Callable[[Rational], float]) -> Array:
        """The exact support function along each row of V, rounded by `nearest` or `above`."""
        values: list[Any] = [self._maximum(v) for v in V]
        return np.array([value if isinstance(value, float) else rounding(value) for value in values])

    def _maximum(self, v: Array) -> Any:
        """The value of `exact_maximum`. Rows that were tight for another set with the same H are tried first."""
        if self._plane is not None or self._ends is not None or not v.any():
            return self.exact_maximum(v).value
        tight, key, direction = _tight_rows(self.H.tobytes(), self.dimension), v.tobytes(), binary(v)
        best = self._at(tight[key], direction) if key in tight else None
        if best is None:
            rows, _ = self._proposed(v)
            best = self._at(rows, direction)
            if best is None:
                return self.exact_maximum(v).value
            if len(tight) < MANY:
                tight[key] = rows
        return best.value

    def offsets(self, V: ArrayLike) -> Array:
        """The smallest offset that P has along each row v of V.

        Parameters
        ----------
        V : array (k, n)
            Directions, one per row.

        Returns
        -------
        array (k,)
            inf where no row of H is v times a power of two.

        Raises
        ------
        ValueError
            If V does not have n columns; the message gives both sizes.

        See Also
        --------
        bound : along any direction.

        Examples
        --------
        >>> from mireach import Polytope
        >>> Polytope([[1, 0], [2, 0]], [1, 1]).offsets([[1, 0], [0, 1]])
        array([0.5, inf])
        """
        rows, factor = normal_rows(self._directions(V))
        return np.array([self._own_offsets.get(row.tobytes(), np.inf) for row in rows]) / factor

    @cached_property
    def _own_offsets(self) -> dict[bytes, float]:
        """Offsets by the bytes of the scaled rows."""
        own: dict[bytes, float] = {}
        rows, factor = normal_rows(self.H)
        for row, offset in zip(rows, (self.h * factor).tolist()):
            own[row.tobytes()] = min(offset, own.get(row.tobytes(), np.inf))
        return own

    def _directions(self, V: ArrayLike) -> Array:
        """V as an array, its columns checked."""
        V = real_array(V, "V", 2)
        require_columns(V, self.dimension, "V", "the dimension of the polytope")
        return V

    def support_vector(self, v: ArrayLike) -> Array | None:
        """A point of P that attains h_P(v), rounded to nearest.

        Parameters
        ----------
        v : array (n,)

        Returns
        -------
        array (n,) or None
            None if P is empty or unbounded along v.

        Raises
        ------
        ValueError
            If v does not have n entries; the message gives both sizes.

        See Also
        --------
        exact_maximum : without rounding.

        Examples
        --------
        >>> from mireach import Polytope
        >>> Polytope.box([0, 0], [1, 2]).support_vector([1, 1])
        array([1., 2.])
        """
        point = self.exact_maximum(v).point
        return None if point is None else np.array([nearest(entry) for entry in point])

    @cached_property
    def exact(self) -> tuple[tuple[tuple[Rational, ...], ...], tuple[Rational, ...]]:
        """H and h as the fractions that they are: l rows of n fmpq, and l fmpq."""
        return binary(self.H), binary(self.h)

    def exact_maximum(self, v: ArrayLike | Sequence[Rational]) -> ExactOptimum:
        """The support function along v, and a point that attains it, without rounding.

        Parameters
        ----------
        v : vector (n,) of floats or fmpq

        Returns
        -------
        rational.ExactOptimum
            Of value inf where P is unbounded along v, -inf where P is empty; the point is then None.

        Raises
        ------
        ValueError
            If v does not have n entries; the message gives both sizes.

        See Also
        --------
        support, bound, support_vector : rounded to floats.

        Examples
        --------
        >>> from mireach import Polytope
        >>> best = Polytope([[3, 0], [-1, 0], [0, 1], [0, -1]], [1, 1, 1, 1]).exact_maximum([1, 1])
        >>> best.value, best.point
        (4/3, (1/3, 1))

        Notes
        -----
        A float solver proposes n rows that are tight at the maximum. They prove it if the point x at which they meet
        lies in P and v is a sum of their normals with factors y >= 0 (both over the rationals), since then
        v x = y h. Otherwise the simplex method decides over the rationals, starting from those rows. Bounded sets of
        the plane have their vertices computed over the rationals, once. A box needs no solver.
        """
        given: Any = v
        if len(given) and all(isinstance(entry, flint().fmpq) for entry in given):
            direction, row = tuple(given), np.array([nearest(entry) for entry in given])
        else:
            row = real_array(given, "v", 1)
            direction = binary(row)
        require_columns(row, self.dimension, "v", "the dimension of the polytope")
        if not any(direction):
            return ExactOptimum(-np.inf, None) if self.point is None else ExactOptimum(direction[0], self.point)
        if self._plane is not None and len(self.h) <= MANY:
            return self._highest_corner(row, direction)
        if self._ends is not None:
            return self._highest_end(direction)
        rows, _ = self._proposed(row)
        proven = self._at(rows, direction)
        return proven or rational.maximize(*self.exact, direction, [r for r in rows if r < len(self.h)])

    @cached_property
    def point(self) -> tuple[Rational, ...] | None:
        """A point of P as a tuple of n fmpq, certainly inside; None if P is empty."""
        if self._is_fat:
            two, middle = flint().fmpq(2), binary(self._plane.local.mean(axis=0))
            return tuple(z * two ** int(e) for z, e in zip(middle, self._plane.unit))
        if self._plane is not None and len(self.h) <= MANY:
            return next(iter(self._corners), None)
        if self._ends is not None:
            return self._middle
        (H, h), (rows, found) = self.exact, self._proposed(np.zeros(self.dimension))
        zero = [flint().fmpq(0)] * self.dimension
        for candidate in found:
            if self._holds(candidate):
                return candidate
        proven = self._at(rows, zero)
        if proven is not None:
            return proven.point
        few = self._contradiction
        if few and rational.maximize([H[r] for r in few], [h[r] for r in few], zero).point is None:
            return None
        return rational.maximize(H, h, zero).point

    # -- decisions --------------------------------------------------------------------------------

    @cached_property
    def is_empty(self) -> bool:
        """True if no point satisfies H x <= h, decided without rounding."""
        return not self._is_fat and self.point is None

    @cached_property
    def is_bounded(self) -> bool:
        """True if P is empty or its support function is finite everywhere, decided without rounding."""
        if self._plane is not None or self.is_empty:  # rows that leave no half-plane free bound every set
            return True
        identity = np.eye(self.dimension)
        return all(self.exact_maximum(v).point is not None for v in np.vstack([identity, -identity]))

    def contains(self, x: ArrayLike, tol: ArrayLike = 0.0) -> Any:
        """Whether H x <= h + tol, decided without rounding.

        Parameters
        ----------
        x : array (n,) or (N, n)
        tol : float or array (l,)
            In units of h, for all rows or for each. The default asks for the closed set itself; a computed vertex is
            inside only to within rounding, 1e-9 is ample for it in units in which the set has a size of about 1.

        Returns
        -------
        bool, or array (N,) of bool

        Raises
        ------
        ValueError
            If the last size of x is not n; the message gives both sizes.

        See Also
        --------
        is_subset : of a whole set.

        Examples
        --------
        >>> from mireach import Polytope
        >>> P = Polytope.box([0, 0], [1, 1])
        >>> P.contains([1, 1]), P.contains([[0.5, 0.5], [1, 2]]).tolist()
        (True, [True, False])
        """
        x, tol = np.asarray(x, float), np.full(len(self.h), tol, float)
        require_columns(x, self.dimension, "x", "the dimension of the polytope")
        if not x.flags.c_contiguous:
            x = np.ascontiguousarray(x)
        if x.ndim == 1:
            answer = membership(x[None], self.H, self.h, tol)[0]
            return bool(answer > 0 or (answer == 0 and self._holds_floats(x, tol)))
        rows = x.reshape(-1, self.dimension)
        answer = membership(rows, self.H, self.h, tol)
        inside = answer > 0
        for k in np.flatnonzero(answer == 0):
            inside[k] = self._holds_floats(rows[k], tol)
        return inside.reshape(x.shape[:-1])

    def _holds_floats(self, x: Array, tol: Array) -> bool:
        """Whether a row of floats satisfies H x <= h + tol; False if one of them is not finite."""
        return bool(np.isfinite(x).all()) and self._holds(binary(x), binary(tol))

    def _holds(self, point: Sequence[Rational], tol: Sequence[Rational] | None = None) -> bool:
        """Whether a point of fmpq satisfies H x <= h + tol, for tol (l,) of fmpq."""
        H, h = self.exact
        limits = h if tol is None else [b + t for b, t in zip(h, tol)]
        return all(rational.dot(a, point) <= b for a, b in zip(H, limits))

    def is_subset(self, Q: Self, tol: float = 0.0) -> bool:
        """Whether P lies in Q, h_P(H_Q) <= h_Q, decided without rounding. An empty P lies in every Q.

        Parameters
        ----------
        Q : Polytope
        tol : float
            Q is widened by this share of the largest |v x| over x in P, for each of its rows v, or of |h_Q| where P is
            unbounded along -v. The share has no unit: the answer is the same in all units.

        Returns
        -------
        bool

        Raises
        ------
        TypeError
            If Q is no Polytope.
        ValueError
            If Q lies in another space; the message gives both dimensions.

        See Also
        --------
        equals : in both directions; contains : of a point.

        Examples
        --------
        >>> from mireach import Polytope
        >>> P, Q = Polytope.box([0], [1.001]), Polytope.box([0], [1])
        >>> P.is_subset(Q), P.is_subset(Q, tol=0.01)
        (False, True)
        """
        self._require_same_space(Q, "inclusion")
        if np.array_equal(self.H, Q.H) and (self.h <= Q.h).all():
            return True
        if self._is_fat:
            found = self._plane
            least, answer = inclusion(Q.H, Q.h, found.local, found.row, found.offset, found.unit)
            if least > 0 or (least < 0 and not tol):
                return bool(least > 0)
            doubtful = np.flatnonzero(answer < 1)
        else:
            doubtful = np.arange(len(Q.h))
        rows = doubtful[~(self.offsets(Q.H[doubtful]) <= Q.h[doubtful])].tolist()
        return not rows or self.is_empty or all(self._stays_below(Q.H[r], Q.h[r], tol) for r in rows)

    def _stays_below(self, v: Array, limit: float, tol: float) -> bool:
        """Whether v x <= limit on a P that is not empty, up to the share tol of `is_subset`."""
        highest: Any = self.exact_maximum(v).value
        exact_limit = binary(limit)
        if isinstance(highest, float):
            return False
        if highest <= exact_limit or not tol:
            return bool(highest <= exact_limit)
        lowest: Any = self.exact_maximum(-v).value
        size = abs(exact_limit) if isinstance(lowest, float) else max(abs(highest), abs(lowest))
        return bool(highest <= exact_limit + binary(tol) * size)

    def equals(self, Q: Self) -> bool:
        """Whether P = Q as sets: P is a subset of Q and Q of P.

        Parameters
        ----------
        Q : Polytope

        Returns
        -------
        bool

        Raises
        ------
        TypeError
            If Q is no Polytope.
        ValueError
            If Q lies in another space; the message gives both dimensions.

        See Also
        --------
        is_subset : one direction, with a tolerance.

        Examples
        --------
        >>> from mireach import Polytope
        >>> P = Polytope([[1], [-1]], [1, 1])
        >>> Q = Polytope([[2], [1], [-3]], [2, 5, 3])
        >>> P.equals(Q), P == Q
        (True, False)

        Notes
        -----
        Decided without rounding. `==` compares objects, and `hash` goes with it.
        """
        return self.is_subset(Q) and Q.is_subset(self)

    def _require_same_space(self, Q: Self, operation: str) -> None:
        """Raise TypeError unless Q is a Polytope, and ValueError unless it lies in the space of P."""
        require_kind(Q, type(self), "Q")
        if Q.dimension != self.dimension:
            raise ValueError(f"P lies in R^{self.dimension} but Q in R^{Q.dimension}; {operation} needs one space")

    # -- exact maxima -----------------------------------------------------------------------------

    @cached_property
    def _meets(self) -> dict[tuple[int, ...], tuple[Any, tuple[Rational, ...] | None]]:
        """What `_meeting` found, by rows."""
        return {}

    @cached_property
    def _ends(self) -> tuple[list[Rational | None], list[Rational | None]] | None:
        """The lower and upper ends of each coordinate over the rationals, if every row bounds one coordinate alone.

        None stands for no end; the whole is None for sets that are no boxes. A lower end may exceed its upper end.
        """
        if ((self.H != 0).sum(axis=1) != 1).any():
            return None
        ends: tuple[list[Rational | None], list[Rational | None]] = ([None] * self.dimension, [None] * self.dimension)
        for row, offset in zip(*self.exact):
            j = next(j for j, entry in enumerate(row) if entry)
            side, sign = (ends[1], 1) if row[j] > 0 else (ends[0], -1)
            end, known = offset / row[j], side[j]
            side[j] = end if known is None or sign * end < sign * known else known
        return ends

    @cached_property
    def _middle(self) -> tuple[Rational, ...] | None:
        """The centre of a box, or a point of an unbounded one; None if it is empty."""
        ends: Any = self._ends
        point = []
        for low, high in zip(*ends):
            if low is not None and high is not None and low > high:
                return None
            known = [end for end in (low, high) if end is not None]
            point.append(sum(known, flint().fmpq(0)) / max(len(known), 1))
        return tuple(point)

    def _highest_end(self, direction: Sequence[Rational]) -> ExactOptimum:
        """The ExactOptimum of a box."""
        if self._middle is None:
            return ExactOptimum(-np.inf, None)
        ends: Any = self._ends
        chosen = [
            middle if not entry else high if entry > 0 else low
            for entry, middle, low, high in zip(direction, self._middle, *ends)
        ]
        if any(end is None for end in chosen):
            return ExactOptimum(np.inf, None)
        return ExactOptimum(rational.dot(direction, chosen), tuple(chosen))

    def _highest_corner(self, v: Array, direction: tuple[Rational, ...]) -> ExactOptimum:
        """The ExactOptimum of a bounded set of the plane."""
        corners = [*self._corners]
        if not corners:
            return ExactOptimum(-np.inf, None)
        ahead, size = [*range(len(corners))], np.abs(self._local_corners).max()
        if all(1e-290 < abs(entry) < 1e290 or not exact for entry, exact in zip(v, direction)) and size < np.inf:
            heights = self._local_corners @ _direction(v, self._plane.unit)  # no entry of the direction exceeds 1
            ahead = np.flatnonzero(heights >= heights.max() - 8 * EXPRESSION * size - SMALLEST).tolist()
        value, k = max((rational.dot(direction, corners[k]), -k) for k in ahead)
        return ExactOptimum(value, corners[-k])

    def _at(self, rows: tuple[int, ...], direction: Sequence[Rational]) -> ExactOptimum | None:
        """The ExactOptimum along a direction, if n rows that may be tight there prove it; else None."""
        if len(rows) != self.dimension:
            return None
        if rows not in self._meets:
            self._meets[rows] = self._meeting(rows)
        inverse, point = self._meets[rows]
        if point is None:
            return None
        y = (flint().fmpq_mat(1, len(rows), list(direction)) * inverse).entries()
        if any(factor < 0 for factor in y) or any(y[i] for i, r in enumerate(rows) if r >= len(self.h)):
            return None
        return ExactOptimum(rational.dot(direction, point), point)

    def _meeting(self, rows: Sequence[int]) -> tuple[Any, tuple[Rational, ...] | None]:
        """The inverse of n rows, and the point of P at which they meet: None if it is outside, or if there is none.

        Numbers from l on stand for the rows of x_j = 0.
        """
        n, h = self.dimension, self.exact[1]
        inverse = _inverse(self.H.tobytes(), n, tuple(rows))
        if inverse is None:
            return None, None
        zero = flint().fmpq(0)
        x = inverse * flint().fmpq_mat(n, 1, [h[r] if r < len(h) else zero for r in rows])
        reached = (self._matrix * x).entries()
        return inverse, tuple(x.entries()) if all(a <= b for a, b in zip(reached, h)) else None

    @cached_property
    def _matrix(self) -> Any:
        """H as a matrix of fractions."""
        return flint().fmpq_mat(*self.H.shape, [entry for row in self.exact[0] for entry in row])

    # -- floating point proposes ------------------------------------------------------------------

    @cached_property
    def _plane(self) -> _Plane | Any:
        """In the plane the result of `kernels.polygon`, unless it has no vertices; else None."""
        if self.dimension != 2:
            return None
        found = _Plane(*polygon(self.H, self.h, PARALLEL_ROWS, TOUCH))
        return found if found.kind != EMPTY else None

    @property
    def _is_fat(self) -> bool:
        """True if P lies in the plane and its vertices are certain: bounded, with an interior, and no needle."""
        return self._plane is not None and self._plane.kind == FAT

    @cached_property
    def _scaled(self) -> tuple[Array, Array, IntArray]:
        """row, offset, unit: H x <= h for x in units of 2^unit, rows scaled by powers of two to entries below 1."""
        if self._plane is not None:
            return self._plane.row, self._plane.offset, self._plane.unit
        unit = _units(self.H, self.h)
        top = top_exponent(self.H, unit)
        with np.errstate(over="ignore"):
            offset = np.clip(np.ldexp(self.h, -top), -1e300, 1e300)
        return np.ldexp(self.H, unit - top[:, None]), offset, unit

    @cached_property
    def _program(self) -> tuple[LinearProgram, IntArray, IntArray]:
        """The scaled constraints as a linear program, the indices of x, and the exponents of its units."""
        row, offset, unit = self._scaled
        lp = LinearProgram()
        x = lp.add_columns(np.full(self.dimension, -np.inf), np.full(self.dimension, np.inf))
        lp.add_rows(x, row, upper=offset)
        return lp, x, unit

    def _proposed(self, v: Array) -> tuple[tuple[int, ...], tuple[tuple[Rational, ...], ...]]:
        """HiGHS's optimum along v: rows that are tight (from l on those of x_j = 0), and its point, if it has one."""
        lp, x, unit = self._program
        try:
            best = lp.maximize(x, _direction(v, unit))
        except SolverError:
            return (), ()
        if best.point is None:
            return (), ()
        basis, basic = lp.highs.getBasis(), highspy.HighsBasisStatus.kBasic
        rows = [r for r, status in enumerate(basis.row_status) if status != basic]
        rows += [len(self.h) + j for j, status in enumerate(basis.col_status) if status != basic]
        with np.errstate(over="ignore"):
            point = np.ldexp(best.point, unit)
        return tuple(rows), (binary(point),) if np.isfinite(point).all() else ()

    @property
    def _contradiction(self) -> tuple[int, ...]:
        """A few rows that no point satisfies together, according to HiGHS; or none."""
        lp, x, _ = self._program
        try:
            if lp.maximize(x, np.zeros(self.dimension)).value > -np.inf:
                return ()
        except SolverError:
            return ()
        highs: Any = lp.highs  # its stubs lack getDualRay
        _, found, ray = highs.getDualRay()
        return tuple(int(r) for r in np.flatnonzero(ray)) if found else ()

    # -- vertices ---------------------------------------------------------------------------------

    @cached_property
    def _vertices(self) -> Array:
        """The vertices of a bounded set as floats (v, n): see `Polytope.vertices`."""
        if self._is_fat:
            return self._plane.corners
        if self.is_empty:
            return np.zeros((0, self.dimension))
        self._require_bounded()
        points = self._nearest_corners
        if not np.isfinite(points).all():
            raise ValueError("a vertex lies beyond the largest float; choose another unit, or use exact_maximum()")
        return _apart(points)

    @cached_property
    def exact_vertices(self) -> list[tuple[Rational, ...]]:
        """The vertices of a bounded set without rounding: list of tuples of n fmpq."""
        if self.is_empty:
            return []
        self._require_bounded()
        return [*self._corners]

    def _require_bounded(self) -> None:
        """Raise ValueError if the set is unbounded."""
        if not self.is_bounded:
            raise ValueError("the polytope is unbounded; intersect it with a box before asking for vertices")

    @cached_property
    def _corners(self) -> dict[tuple[Rational, ...], None]:
        """The vertices over the rationals: tuples of n fmpq, each once, as the keys of a dict."""
        if self.dimension != 2 or len(self.h) > MANY:
            return dict.fromkeys(ExactPolytope.of(self, MOST_VERTICES).vertices)
        points = (self._meeting(rows)[1] for rows in self._candidates())
        return {point: None for point in points if point is not None}

    @cached_property
    def _nearest_corners(self) -> Array:
        """The floats nearest to them: array (v, n)."""
        points = [[nearest(entry) for entry in point] for point in self._corners]
        return np.array(points).reshape(-1, self.dimension)

    @cached_property
    def _local_corners(self) -> Array:
        """Those of the plane as floats, for x in units of 2^unit: array (v, 2)."""
        two = [flint().fmpq(2) ** int(-e) for e in self._plane.unit]
        return np.array([[nearest(entry * scale) for entry, scale in zip(point, two)] for point in self._corners])

    def _candidates(self) -> list[list[int]]:
        """Pairs of rows of a set of the plane that may meet in a point of it."""
        row, offset, _ = self._scaled
        size = np.abs(row)
        pairs = np.array([*combinations(np.flatnonzero(size.any(axis=1)).tolist(), 2)]).reshape(-1, 2)
        if ((size > 0) == (self.H != 0)).all() and (size[size > 0] > SMALLEST).all():  # the scaled rows are not rounded
            parallel = np.logical_or(*((row[:, None] == sign * row).all(axis=2) for sign in (1, -1)))
            pairs = pairs[~parallel[pairs[:, 0], pairs[:, 1]]]
        regular = np.abs(np.linalg.det(row[pairs])) > SINGULAR_ROWS
        points = np.linalg.solve(row[pairs[regular]], offset[pairs[regular]][..., None])[..., 0]
        terms = np.abs(points).max(axis=1)[:, None] * size.sum(axis=1) + np.abs(offset)
        inside = (points @ row.T - offset <= NEAR_VERTEX * terms).all(axis=1)
        return [*pairs[regular][inside].tolist(), *pairs[~regular].tolist()]


@lru_cache(maxsize=64)
def _tight_rows(content: bytes, n: int) -> dict[bytes, tuple[int, ...]]:
    """n rows that were tight at the maximum along v over a set with the rows H, by the bytes of v.

    Sequences of sets differ by their offsets alone, and those rows often stay tight from one set to the next.
    """
    return {}


@lru_cache(maxsize=4096)
def _inverse(content: bytes, n: int, rows: tuple[int, ...]) -> Any:
    """The inverse of n rows of H over the rationals, or None if they are dependent; from l on the rows of x_j = 0."""
    H, one = np.frombuffer(content).reshape(-1, n), np.eye(n)
    chosen = [H[r] if r < len(H) else one[r - len(H)] for r in rows]
    try:
        return flint().fmpq_mat(n, n, [entry for row in chosen for entry in binary(row)]).inv()
    except ZeroDivisionError:
        return None


# -- parts --------------------------------------------------------------------------------------------


def top_exponent(H: Array, unit: IntArray) -> IntArray:
    """The largest exponent in each row of H, for x in units of 2^unit: array (l,) of int."""
    return np.where(H != 0, np.frexp(H)[1] + unit, -(10**6)).max(axis=1, initial=-(10**6)) * (H != 0).any(axis=1)


def _units(H: Array, h: Array) -> IntArray:
    """Exponents e (n,) of units 2^e for the coordinates, medians of where rows cut the axes.

    They follow the data: another power of two as the unit of a coordinate, or as the factor of a row, changes e
    accordingly, or does not change it.
    """
    size, offset = np.frexp(H)[1], np.frexp(h)[1]
    unit = np.zeros(H.shape[1], int)
    settled = np.zeros(H.shape[1], bool)
    for j in range(H.shape[1]):
        cuts = (H[:, j] != 0) & (h != 0)
        if cuts.any():
            unit[j] = np.sort(offset[cuts] - size[cuts, j])[cuts.sum() // 2]
            settled[j] = True
    while not settled.all():  # what no offset settles is settled by rows that it shares with other coordinates
        shared = (H != 0) & ~settled & ((H != 0) & settled).any(axis=1)[:, None]
        j = int(np.argmax(shared.any(axis=0)) if shared.any() else np.argmin(settled))
        if shared.any():
            top = np.where((H != 0) & settled, size + unit, -(10**6)).max(axis=1)
            unit[j] = np.sort((top - size[:, j])[shared[:, j]])[shared[:, j].sum() // 2]
        settled[j] = True
    return unit


def _direction(v: Array, unit: IntArray) -> Array:
    """v for x in units of 2^unit, scaled by a power of two to entries below 1."""
    return in_units(np.ascontiguousarray(v, float), unit)


def _apart(points: Array) -> Array:
    """Points (k, n) without those that are one to within rounding; for n = 2 counter-clockwise, corners alone."""
    half = np.ldexp(points, -1)  # so that differences do not overflow
    spread = np.ptp(half, axis=0)
    distance = np.maximum(TOUCH * spread, 2.0**-48 * np.abs(half).max(axis=0))
    chosen: list[int] = []
    for i, point in enumerate(half):
        if (np.abs(point - half[chosen]) > distance).any(axis=1).all():
            chosen.append(i)
    kept = points[chosen]
    if points.shape[1] != 2:
        return kept
    local = np.ldexp(half[chosen] - half[chosen[0]], -np.frexp(spread)[1])
    return kept[[int(np.flatnonzero((local == corner).all(axis=1))[0]) for corner in around(local)]]
