"""Polytopes {x : H x <= h}: support functions, vertices, inclusion, templates (Sec. I.A of [Teichrib2025]).

Every number is the float that it is. Floating point is tried first, in units that follow the set (powers of two, so
that scaling rounds nothing); what it cannot decide with certainty is decided over the rationals.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, islice
from math import comb
from typing import NamedTuple

import highspy
import numpy as np
from scipy.spatial import ConvexHull, QhullError

from ..arithmetic import rational
from ..arithmetic.balls import flint
from ..arithmetic.rational import ExactOptimum, above, below, binary, nearest
from ..arithmetic.scaling import LARGEST, normal_rows, power_of_two, times
from ..checks import positive_number, real_array, require_columns, require_kind, whole_number
from ..errors import SolverError
from ..solvers.linear_program import LinearProgram
from .facets import Frame, image, rank, scaled
from .kernels import EMPTY, FAT, around, dual_bounds, hull, in_units, inclusion, membership, polygon

TOUCH = 1e-11  # vertices count as one point within this distance, relative to the size of the set in each coordinate
PARALLEL = 1e-12  # rows of length about 1 whose determinant is below this have no vertex
NEARLY = 1e-6  # candidates for a vertex are decided over the rationals if they are inside to within this
TURN = 1e-12  # points are no corners of a hull where its boundary turns by a smaller sine
ROUNDING = 2.0**-50  # covers what a sum of a few products rounds off, relative to the sizes of its terms
LEAST = 2.0**-1060  # covers what products lose that are too small for full precision
SINGULAR = 1e-8  # n rows of length about 1 whose determinant is below this meet where floats do not tell
CHUNK = 4_000_000  # numbers that `vertices` handles at a time
MANY = 256  # rows in the plane up to which all vertices are computed when one is needed
MOST_SINGULAR = 40_000  # of those that `vertices` is willing to look at over the rationals
WIDE = np.pi - 1e-2  # between the normals of two neighbouring sides: they meet in a needle's tip
MOST_VERTEX_CANDIDATES = 2_000_000  # subsets of rows that `vertices` is willing to try


@dataclass(frozen=True, eq=False)
class Polytope:
    """The closed convex set {x : H x <= h}; empty, flat and unbounded ones included.

    Parameters
    ----------
    H : array (l, n)
        Outward normals, one a row, of any length.
    h : array (l,)
        Offsets, in units of H x.

    Raises
    ------
    ValueError
        If sizes do not match or an entry is not finite.

    Notes
    -----
    `==` and `hash` compare objects, not sets: the same set has many H and h. `equals` compares sets.

    Examples
    --------
    >>> P = Polytope.box([-1, -2], [1, 2])
    >>> P.support([[1, 1]])
    array([3.])
    """

    H: np.ndarray
    h: np.ndarray

    def __post_init__(self):
        H, h = real_array(self.H, "H", 2), real_array(self.h, "h", 1)
        if len(H) != len(h):
            raise ValueError(f"H has {len(H)} rows but h has {len(h)} entries; each row needs one offset")
        if not H.shape[1]:
            raise ValueError("H has no columns; a polytope needs at least one dimension")
        if not H.flags.c_contiguous:  # the compiled functions know one layout
            H = np.ascontiguousarray(H)
            H.setflags(write=False)
        object.__setattr__(self, "H", H)
        object.__setattr__(self, "h", h)

    def __reduce__(self):
        return Polytope, (self.H, self.h)  # what is cached holds a solver and fractions, which cannot be pickled

    def __repr__(self):
        return f"Polytope({len(self.h)} rows in R^{self.dimension})"

    # -- making -----------------------------------------------------------------------------------

    @staticmethod
    def box(lower, upper):
        """The box {x : lower <= x <= upper}; a point or a segment where the two agree.

        Parameters
        ----------
        lower, upper : array (n,)

        Raises
        ------
        ValueError
            If the sizes differ or lower > upper somewhere.
        """
        lower, upper = real_array(lower, "lower", 1), real_array(upper, "upper", 1)
        if lower.shape != upper.shape:
            raise ValueError(f"lower has {len(lower)} entries but upper has {len(upper)}")
        if (lower > upper).any():
            i = int(np.argmax(lower > upper))
            raise ValueError(f"lower must not exceed upper; entry {i}: {lower[i]} > {upper[i]}")
        identity = np.eye(len(lower))
        return Polytope(np.vstack([identity, -identity]), np.concatenate([upper, -lower]))

    @staticmethod
    def from_points(points):
        """The convex hull of points, rounded outward by at most a few units in the last place.

        It is bounded and contains every one of the points, whatever `contains` rounds.

        Parameters
        ----------
        points : array (k, n)
            A single point and collinear points in the plane are fine; for n > 2 the hull must have
            an interior.

        Raises
        ------
        ValueError
            If there is no point, or the hull is flat and n > 2.
        """
        points = real_array(points, "points", 2)
        n = points.shape[1]
        if not len(points):
            raise ValueError("points is empty; a convex hull needs at least one point")
        unit = np.frexp(np.ptp(np.ldexp(points, -1), axis=0))[1] + 1  # half the points, for ptp must not overflow
        local = np.ldexp(points - points[0] if n > 2 else points, -unit)
        identity = np.vstack([np.eye(n), -np.eye(n)])
        if n == 1 or (points == points[0]).all():
            normals = identity
        elif n == 2:
            normals = _normals(local)
        else:
            try:
                normals = ConvexHull(local).equations[:, :-1]
            except QhullError as error:
                raise ValueError(
                    f"the {len(points)} points span no volume in R^{n}; give H and h of a flat set directly"
                ) from error
        found = _rows_around(normals, unit, points)
        return found if n <= 2 or found.is_bounded else found & _rows_around(identity, 0 * unit, points)

    @staticmethod
    def from_dict(value):
        """Inverse of `to_dict`; ValueError if a key is missing."""
        if not isinstance(value, dict) or not {"H", "h"} <= value.keys():
            raise ValueError(f"a polytope needs the keys H and h; got {value!r:.80}")
        return Polytope(value["H"], value["h"])

    def to_dict(self):
        """{"H": [[...]], "h": [...]}, the form of sets in this package's files."""
        return {"H": self.H.tolist(), "h": self.h.tolist()}

    # -- asking -----------------------------------------------------------------------------------

    @property
    def dimension(self):
        """n of R^n."""
        return self.H.shape[1]

    def support(self, V):
        """Support function h_P(v) = max {v x : x in P}, for each row v of V, as the nearest floats.

        Parameters
        ----------
        V : array (k, n)
            Directions, one a row.

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
        bound : a proven upper bound; exact_maximum : without rounding.

        Notes
        -----
        In the plane a maximum over the vertices, which are computed over the rationals if the set is flat, a needle, or
        far from the origin for its size. Otherwise one `exact_maximum` a row. Sec. I.A of [Teichrib2025].
        """
        V = self._directions(V)
        if self._plane is not None and self._plane.kind == FAT:
            return (V @ self._plane.corners.T).max(axis=1)
        if self._plane is not None and len(self.h) <= MANY and np.isfinite(self._nearest_corners).all():
            return (V @ self._nearest_corners.T).max(axis=1, initial=-np.inf)
        return np.array([_float(self.exact_maximum(v).value, nearest) for v in V])

    def bound(self, V):
        """Floats that are not below the support function, and hardly above it: array (k,).

        Parameters
        ----------
        V : array (k, n)
            Directions, one a row.

        Returns
        -------
        array (k,)
            inf where P is unbounded along v, -inf where P is empty. On the rows of H it does not exceed h.

        Raises
        ------
        ValueError
            If V does not have n columns; the message gives both sizes.

        Examples
        --------
        >>> P = Polytope([[3, 0], [-1, 0], [0, 1], [0, -1]], [1, 1, 1, 1])
        >>> P.bound([[1, 0]]) > 1 / 3  # the float 1 / 3 lies below one third
        array([ True])

        Notes
        -----
        In the plane weak duality with its rounding counted, where the vertices of P are certain; elsewhere exact.
        """
        V = self._directions(V)
        if not self._is_fat:
            return np.array([_float(self.exact_maximum(v).value, above) for v in V])
        found = self._plane
        bound = dual_bounds(V, found.local, found.row, found.offset, found.unit)
        return np.minimum(bound, self.offsets(V))

    def offsets(self, V):
        """The smallest offset that P has along each row v of V: array (k,), inf where no row of H is v times 2^k."""
        rows, factor = normal_rows(V)
        return np.array([self._own_offsets.get(row.tobytes(), np.inf) for row in rows]) / factor

    @cached_property
    def _own_offsets(self):
        """Offsets by the bytes of the scaled rows."""
        own, (rows, factor) = {}, normal_rows(self.H)
        for row, offset in zip(rows, (self.h * factor).tolist()):
            own[row.tobytes()] = min(offset, own.get(row.tobytes(), np.inf))
        return own

    def _directions(self, V):
        """V as an array, its columns checked."""
        V = real_array(V, "V", 2)
        require_columns(V, self.dimension, "V", "the dimension of the polytope")
        return V

    def farthest(self, v):
        """A point (n,) of P, to within rounding, that attains h_P(v); None if P is empty or unbounded along v."""
        point = self.exact_maximum(v).point
        return None if point is None else np.array([nearest(entry) for entry in point])

    @cached_property
    def exact(self):
        """H and h as the fractions that they are: l rows of n fmpq, and l fmpq."""
        return binary(self.H), binary(self.h)

    def exact_maximum(self, v):
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

        Notes
        -----
        A float solver proposes n rows that are tight at the maximum. They prove it if the point x at which they meet
        lies in P and v is a sum of their normals with factors y >= 0 (both over the rationals), since then
        v x = y h. Otherwise the simplex method decides over the rationals, starting from those rows. Bounded sets of
        the plane have their vertices computed over the rationals, once.

        Examples
        --------
        >>> best = Polytope([[3, 0], [-1, 0], [0, 1], [0, -1]], [1, 1, 1, 1]).exact_maximum([1, 1])
        >>> best.value, best.point
        (4/3, (1/3, 1))
        """
        if len(v) and all(isinstance(entry, flint().fmpq) for entry in v):
            direction, v = tuple(v), np.array([nearest(entry) for entry in v])
        else:
            v = real_array(v, "v", 1)
            direction = binary(v)
        require_columns(v, self.dimension, "v", "the dimension of the polytope")
        if not any(direction):
            return ExactOptimum(-np.inf, None) if self.point is None else ExactOptimum(direction[0], self.point)
        if self._plane is not None and len(self.h) <= MANY:
            return self._highest_corner(v, direction)
        rows = self._tight(v)
        proven = self._at(rows, direction)
        return proven or rational.maximize(*self.exact, direction, [r for r in rows if r < len(self.h)])

    @cached_property
    def point(self):
        """A point of P as a tuple of n fmpq, certainly inside; None if P is empty."""
        if self._is_fat:
            two, middle = flint().fmpq(2), binary(self._plane.local.mean(axis=0))
            return tuple(z * two ** int(e) for z, e in zip(middle, self._plane.unit))
        if self._plane is not None and len(self.h) <= MANY:
            return next(iter(self._meeting_points), None)
        (H, h), (rows, found) = self.exact, self._asked(np.zeros(self.dimension))
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

    def _highest_corner(self, v, direction):
        """The ExactOptimum of a bounded set of the plane."""
        corners = [*self._meeting_points]
        if not corners:
            return ExactOptimum(-np.inf, None)
        ahead, size = range(len(corners)), np.abs(self._local_corners).max()
        if all(1e-290 < abs(entry) < 1e290 or not exact for entry, exact in zip(v, direction)) and size < np.inf:
            heights = self._local_corners @ _direction(v, self._plane.unit)  # no entry of the direction exceeds 1
            ahead = np.flatnonzero(heights >= heights.max() - 8 * ROUNDING * size - LEAST).tolist()
        value, k = max((rational.dot(direction, corners[k]), -k) for k in ahead)
        return ExactOptimum(value, corners[-k])

    def _at(self, rows, direction):
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

    @cached_property
    def _meets(self):
        """What `_meeting` found, by rows."""
        return {}

    def _meeting(self, rows):
        """The inverse of n rows, and the point of P at which they meet: None if it is outside, or if there is none.

        Numbers from l on stand for the rows of x_j = 0.
        """
        matrix, (H, h), n = flint().fmpq_mat, self.exact, self.dimension
        zero, one = flint().fmpq(0), flint().fmpq(1)
        chosen = [H[r] if r < len(h) else [one if r - len(h) == j else zero for j in range(n)] for r in rows]
        try:
            inverse = matrix(n, n, [entry for row in chosen for entry in row]).inv()
        except ZeroDivisionError:
            return None, None
        x = inverse * matrix(n, 1, [h[r] if r < len(h) else zero for r in rows])
        reached = (self._matrix * x).entries()
        return inverse, tuple(x.entries()) if all(a <= b for a, b in zip(reached, h)) else None

    @cached_property
    def _matrix(self):
        """H as a matrix of fractions."""
        return flint().fmpq_mat(*self.H.shape, [entry for row in self.exact[0] for entry in row])

    # -- floating point proposes ------------------------------------------------------------------

    @cached_property
    def _plane(self):
        """In the plane what `compiled.polygon` says, unless it finds no vertices; else None."""
        if self.dimension != 2:
            return None
        found = _Plane(*polygon(self.H, self.h, PARALLEL, TOUCH))
        return found if found.kind != EMPTY else None

    @property
    def _is_fat(self):
        """True if P lies in the plane and its vertices are certain: bounded, with an interior, and no needle."""
        return self._plane is not None and self._plane.kind == FAT

    @cached_property
    def _scaled(self):
        """row, offset, unit: H x <= h for x in units of 2^unit, rows scaled by powers of two to entries below 1."""
        if self._plane is not None:
            return self._plane.row, self._plane.offset, self._plane.unit
        unit = _units(self.H, self.h)
        top = _top(self.H, unit)
        with np.errstate(over="ignore"):
            offset = np.clip(np.ldexp(self.h, -top), -1e300, 1e300)
        return np.ldexp(self.H, unit - top[:, None]), offset, unit

    @cached_property
    def _program(self):
        """The scaled constraints as a linear program, the indices of x, and the exponents of its units."""
        row, offset, unit = self._scaled
        lp = LinearProgram()
        x = lp.add_columns(np.full(self.dimension, -np.inf), np.full(self.dimension, np.inf))
        lp.add_rows(x, row, upper=offset)
        return lp, x, unit

    def _tight(self, v):
        """Rows that a float solver proposes as tight at the maximum along v: sorted, n of them if it finds a vertex."""
        if self.dimension > 1:
            return self._asked(v)[0]
        row, offset, _ = self._scaled
        ahead = np.flatnonzero(row[:, 0] * v[0] > 0)
        return (int(ahead[np.argmin(offset[ahead] / np.abs(row[ahead, 0]))]),) if len(ahead) else ()

    def _asked(self, v):
        """HiGHS's answer along v: rows that are tight (from l on those of x_j = 0), and its point, if it has one."""
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
    def _contradiction(self):
        """Rows that, says HiGHS, no point satisfies together: a few, or none."""
        lp, x, _ = self._program
        try:
            if lp.maximize(x, np.zeros(self.dimension)).value > -np.inf:
                return ()
        except SolverError:
            return ()
        _, known, ray = lp.highs.getDualRay()
        return tuple(int(r) for r in np.flatnonzero(ray)) if known else ()

    # -- deciding ---------------------------------------------------------------------------------

    @cached_property
    def is_empty(self):
        """True if no point satisfies H x <= h, decided without rounding."""
        return not self._is_fat and self.point is None

    @cached_property
    def is_bounded(self):
        """True if P is empty or its support function is finite everywhere, decided without rounding."""
        if self._plane is not None or self.is_empty:  # rows that leave no half-plane free bound every set
            return True
        identity = np.eye(self.dimension)
        return all(self.exact_maximum(v).point is not None for v in np.vstack([identity, -identity]))

    def contains(self, x, tol=0.0):
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

    def _holds_floats(self, x, tol):
        """Whether a row of floats satisfies H x <= h + tol; False if one of them is not finite."""
        return bool(np.isfinite(x).all()) and self._holds(binary(x), binary(tol))

    def _holds(self, point, tol=None):
        """Whether a point of fmpq satisfies H x <= h + tol, for tol (l,) of fmpq."""
        H, h = self.exact
        limits = h if tol is None else [b + t for b, t in zip(h, tol)]
        return all(rational.dot(a, point) <= b for a, b in zip(H, limits))

    def is_subset(self, Q, tol=0.0):
        """Whether P lies in Q, h_P(H_Q) <= h_Q, decided without rounding. An empty P lies in every Q.

        Parameters
        ----------
        Q : Polytope
        tol : float
            Q is widened by this share of the largest |v x| over x in P, for each of its rows v, or of |h_Q| where P is
            unbounded along -v. The share has no unit: the answer is the same in all units.
        """
        require_kind(Q, Polytope, "Q")
        if Q.dimension != self.dimension:
            raise ValueError(f"P lies in R^{self.dimension} but Q in R^{Q.dimension}; inclusion needs one space")
        if self._is_fat:
            found = self._plane
            least, answer = inclusion(Q.H, Q.h, found.local, found.row, found.offset, found.unit)
            if least > 0 or (least < 0 and not tol):
                return least > 0
            rows = np.flatnonzero(answer < 1)
        else:
            rows = np.arange(len(Q.h))
        rows = rows[~(self.offsets(Q.H[rows]) <= Q.h[rows])].tolist()
        return not rows or self.is_empty or all(self._stays_below(Q.H[r], Q.h[r], tol) for r in rows)

    def equals(self, Q):
        """Whether P = Q as sets: P is a subset of Q and Q of P.

        Parameters
        ----------
        Q : Polytope

        Returns
        -------
        bool

        Raises
        ------
        ValueError
            If Q is no Polytope or lies in another space; the message gives both dimensions.

        Examples
        --------
        >>> P = Polytope([[1], [-1]], [1, 1])
        >>> Q = Polytope([[2], [1], [-3]], [2, 5, 3])
        >>> P.equals(Q), P == Q
        (True, False)

        Notes
        -----
        Decided without rounding. `==` compares objects, and `hash` goes with it.
        """
        return self.is_subset(Q) and Q.is_subset(self)

    def _stays_below(self, v, limit, tol):
        """Whether v x <= limit on a P that is not empty, up to the share tol of `is_subset`."""
        highest, limit = self.exact_maximum(v).value, binary(limit)
        if isinstance(highest, float):
            return False
        if highest <= limit or not tol:
            return highest <= limit
        lowest = self.exact_maximum(-v).value
        size = abs(limit) if isinstance(lowest, float) else max(abs(highest), abs(lowest))
        return highest <= limit + binary(tol) * size

    def vertices(self):
        """The extreme points of a bounded set.

        Returns
        -------
        array (v, n)
            Counter-clockwise for n = 2; no rows if P is empty. Points that differ by rounding are one, relative to
            the size of the set in each coordinate.

        Raises
        ------
        ValueError
            If P is unbounded, or so large that its subsets of n rows cannot be tried.

        Notes
        -----
        Tries all n rows at a time, over the rationals where floats are in doubt. This is slow for many rows in high
        dimension.
        """
        return self._vertices.copy()

    @cached_property
    def _vertices(self):
        n = self.dimension
        if self._is_fat:
            return self._plane.corners
        if self.is_empty:
            return np.zeros((0, n))
        self._require_enumerable()
        points = self._nearest_corners
        if not np.isfinite(points).all():
            raise ValueError("a vertex lies beyond the largest float; choose another unit, or use exact_maximum()")
        return _apart(points)

    def _require_enumerable(self):
        """Raise ValueError if the set is unbounded, or has too many subsets of n rows to try each."""
        if not self.is_bounded:
            raise ValueError("the polytope is unbounded; intersect it with a box before asking for vertices")
        if comb(len(self.h), self.dimension) > MOST_VERTEX_CANDIDATES:
            raise ValueError(
                f"{len(self.h)} rows in R^{self.dimension} are too many to enumerate vertices; use support()"
            )

    @cached_property
    def _exact_vertices(self):
        """The vertices of a bounded set without rounding: list of tuples of n fmpq."""
        if self.is_empty:
            return []
        self._require_enumerable()
        return [*self._meeting_points]

    @cached_property
    def _meeting_points(self):
        """The vertices over the rationals: tuples of n fmpq, each once, as the keys of a dict."""
        points = (self._meeting(tuple(rows))[1] for rows in self._candidates())
        return {point: None for point in points if point is not None}

    @cached_property
    def _nearest_corners(self):
        """The floats nearest to them: array (v, n)."""
        points = [[nearest(entry) for entry in point] for point in self._meeting_points]
        return np.array(points).reshape(-1, self.dimension)

    @cached_property
    def _local_corners(self):
        """Those of the plane as floats, for x in units of 2^unit: array (v, 2)."""
        two = [flint().fmpq(2) ** int(-e) for e in self._plane.unit]
        return np.array(
            [[nearest(entry * scale) for entry, scale in zip(point, two)] for point in self._meeting_points]
        )

    def _candidates(self):
        """Subsets of n rows that may meet in a point of P: lists of int."""
        row, offset, _ = self._scaled
        size = np.abs(row)
        number = np.flatnonzero(size.any(axis=1))
        parallel = np.zeros((len(row), len(row)), bool)
        if ((size > 0) == (self.H != 0)).all() and (size[size > 0] > LEAST).all():  # the scaled rows are not rounded
            parallel = np.logical_or(*((row[:, None] == sign * row).all(axis=2) for sign in (1, -1)))
        subsets, found, doubtful = combinations(number.tolist(), self.dimension), [], 0
        while chunk := [*islice(subsets, CHUNK // len(row) + 1)]:
            chunk = np.array(chunk)
            for i, j in combinations(range(self.dimension), 2):
                chunk = chunk[~parallel[chunk[:, i], chunk[:, j]]]
            regular = np.abs(np.linalg.det(row[chunk])) > SINGULAR
            points = np.linalg.solve(row[chunk[regular]], offset[chunk[regular]][..., None])[..., 0]
            terms = np.abs(points).max(axis=1)[:, None] * size.sum(axis=1) + np.abs(offset)
            inside = (points @ row.T - offset <= NEARLY * terms).all(axis=1)
            found += [*chunk[regular][inside].tolist(), *chunk[~regular].tolist()]
            doubtful += (~regular).sum()
            if doubtful > MOST_SINGULAR:
                raise ValueError(f"more than {MOST_SINGULAR} subsets of the rows are nearly singular; use support()")
        return found

    def chebyshev_centre(self):
        """Centre c and radius r of the largest ball in P: max r over H_i c + r |H_i| <= h_i.

        Returns
        -------
        centre : array (n,) or None
        radius : float
            Negative by the smallest widening that would make an empty P nonempty, 0 for a flat P, and inf
            (with a centre of None) if P holds balls of any size.

        Examples
        --------
        >>> Polytope.box([0, 0], [2, 2]).chebyshev_centre()
        (array([1., 1.]), 1.0)

        Notes
        -----
        The program is solved without rounding. The lengths |H_i| and the answer are rounded to nearest. `chebyshev` is
        the same method.
        """
        top = _top(self.H, np.zeros(self.dimension, int))
        row = np.ldexp(self.H, -top[:, None])
        lengths = np.ldexp(np.linalg.norm(row, axis=1), top)
        best = Polytope(np.column_stack([self.H, lengths]), self.h).farthest(np.eye(self.dimension + 1)[-1])
        return (None, np.inf) if best is None else (best[:-1], float(best[-1]))

    chebyshev = chebyshev_centre

    def bounding_box(self):
        """Smallest box around P as (lower (n,), upper (n,)): inf where P is unbounded, lower > upper if P is empty."""
        identity = np.eye(self.dimension)
        return -self.support(-identity), self.support(identity)

    @property
    def area(self):
        """Of a bounded set of the plane, in units of x1 times x2; 0 for flat and empty ones.

        Raises
        ------
        ValueError
            If P is unbounded or not in the plane.
        """
        if self.dimension != 2:
            raise ValueError(f"only sets of the plane have an area; this one lies in R^{self.dimension}")
        if len(self._vertices) < 3:
            return 0.0
        x, y = (self._vertices - self._vertices[0]).T
        return float(x @ np.roll(y, -1) - np.roll(x, -1) @ y) / 2

    def volume(self):
        """Volume of P, the integral of 1 over P, in units of x1 times ... times xn.

        Returns
        -------
        float
            0 for flat and empty sets, inf for unbounded sets with an interior.

        Raises
        ------
        ValueError
            If a bounded P has too many rows to enumerate its vertices.

        See Also
        --------
        area : the same in the plane, from the vertices in floating point.

        Examples
        --------
        >>> Polytope.box([0, 0, 0], [1, 2, 3]).volume()
        6.0

        Notes
        -----
        Whether it is 0 or inf is decided without rounding. Otherwise the sum of rational volumes of simplices between
        the rational vertices, rounded to nearest. qhull chooses the simplices in floating point, which changes the sum
        by about rounding.
        """
        if self.is_empty:
            return 0.0
        if not self.is_bounded:
            (H, h), zero = self.exact, [flint().fmpq(0)] * self.dimension
            rows = [r for r in range(len(h)) if any(H[r])]
            if not rows or rational.strict_point([zero], zero[:1], [H[r] for r in rows], [h[r] for r in rows]):
                return np.inf
            return 0.0
        return nearest(Frame(self._exact_vertices).volume())

    # -- new sets ---------------------------------------------------------------------------------

    def __and__(self, other):
        """Intersection; a row that both have is kept once, with the smaller offset."""
        require_kind(other, Polytope, "what P is intersected with")
        if other.dimension != self.dimension:
            raise ValueError(f"cannot intersect sets in R^{self.dimension} and R^{other.dimension}")
        rows = {}
        for row, offset in zip(np.vstack([self.H, other.H]) + 0.0, np.concatenate([self.h, other.h])):
            key = row.tobytes()
            rows[key] = (row, min(offset, rows[key][1]) if key in rows else offset)
        return Polytope(np.array([row for row, _ in rows.values()]), [offset for _, offset in rows.values()])

    def scale(self, s, centre=0):
        """c + s (P - c) = {x : H x <= s h + (1 - s) H c}.

        Parameters
        ----------
        s : float
            Positive.
        centre : array (n,) or number
            The point c that stays where it is.
        """
        s, centre = positive_number(s, "s"), real_array(centre, "centre", np.ndim(centre))
        if centre.shape not in ((), (self.dimension,)):
            raise ValueError(f"centre has shape {centre.shape}, but the polytope lies in R^{self.dimension}")
        return Polytope(self.H, s * self.h + (1 - s) * (self.H @ np.broadcast_to(centre, self.dimension)))

    def sum(self, Q):
        """Minkowski sum P + Q = {p + q : p in P, q in Q}.

        Parameters
        ----------
        Q : Polytope
            In the space of P.

        Returns
        -------
        Polytope
            Empty if P or Q is.

        Raises
        ------
        ValueError
            If Q is no Polytope or lies in another space, or, for n > 2, if P or Q has too many rows to enumerate its
            vertices.

        See Also
        --------
        erode : the Pontryagin difference.

        Examples
        --------
        >>> P = Polytope.box([0, 0], [2, 1]).sum(Polytope.from_points([[0, 0], [1, 1]]))
        >>> P.contains([3, 2]), P.contains([3, 0])
        (True, False)

        Notes
        -----
        Rounded outward: every offset is the smallest float that is not below h_P + h_Q along its row. The rows are
        exact for n <= 2 and for boxes, where every facet of P + Q is parallel to one of P or of Q. Otherwise they are
        the facets of the hull of all sums of two vertices, rounded to nearest. For n > 2 and unbounded sets it is
        `map` of the product, and approximate as `map` says.
        """
        self._require_same_space(Q, "a Minkowski sum")
        n = self.dimension
        if self.is_empty or Q.is_empty:
            return _nothing(n)
        rows = np.vstack([self.H, Q.H])
        if n > 2 and (np.count_nonzero(rows, axis=1) > 1).any():
            if not (self.is_bounded and Q.is_bounded):
                return self.product(Q).map(np.hstack([np.eye(n), np.eye(n)]))  # p + q for (p, q) in the product
            one, other = self._exact_vertices, Q._exact_vertices
            return _hull([tuple(a + b for a, b in zip(p, q)) for p in one for q in other])
        rows = _distinct(rows)
        pairs = [[S.exact_maximum(v).value for S in (self, Q)] for v in rows]
        return _rows_with(rows, [np.inf if any(isinstance(b, float) for b in pair) else sum(pair) for pair in pairs])

    def erode(self, Q):
        """Pontryagin difference P - Q = {x : x + q in P for all q in Q} = {x : H x <= h - h_Q(H)}.

        Parameters
        ----------
        Q : Polytope
            Nonempty, in the space of P.

        Returns
        -------
        Polytope
            With the rows of P. Empty if Q is unbounded along one of them.

        Raises
        ------
        ValueError
            If Q is no Polytope, lies in another space, or is empty.

        See Also
        --------
        sum : the Minkowski sum; (P - Q) + Q lies in P.

        Examples
        --------
        >>> P, Q = Polytope.box([0, 0], [4, 4]), Polytope.box([-1, 0], [1, 1])
        >>> P.erode(Q).equals(Polytope.box([1, 0], [3, 3]))
        True

        Notes
        -----
        Rounded inward: the offsets are the largest floats that are not above h - h_Q(H), which is computed without
        rounding.
        """
        self._require_same_space(Q, "a Pontryagin difference")
        if Q.is_empty:
            raise ValueError("Q is empty, so every x would satisfy x + Q in P; erode by a nonempty set")
        highest = [Q.exact_maximum(v).value for v in self.H]
        if any(isinstance(value, float) for value in highest):
            return _nothing(self.dimension)
        return Polytope(self.H, [below(b - value) for b, value in zip(self.exact[1], highest)])

    def map(self, M, t=None):
        """Affine image M P + t = {M x + t : x in P}.

        Parameters
        ----------
        M : array (m, n)
            Of any rank.
        t : array (m,), optional
            0 if left out.

        Returns
        -------
        Polytope
            In R^m.

        Raises
        ------
        ValueError
            If the sizes of M and t do not match, or if the rank of M is below n and a bounded P has too many rows to
            enumerate its vertices.

        See Also
        --------
        preimage : of a set under a map; project : onto some coordinates.

        Examples
        --------
        >>> P = Polytope.box([0, 0], [1, 1])
        >>> P.map([[1, 1]], [0.5]).equals(Polytope.box([0.5], [2.5]))
        True

        Notes
        -----
        Rounded outward for bounded P. The rows are H M^-1 for an invertible M. For a rank below n they are the facets
        of the hull of the images of the vertices or, if P is unbounded, what Fourier-Motzkin elimination leaves (slow
        for many rows). All are computed over the rationals and rounded to nearest. The offset of a row v is
        h_P(M'v) + v t without rounding, then rounded up. Where v had to be rounded and an unbounded P has no support
        along it, the offset is that of the row before rounding, and the result is approximate. If M is nearly singular,
        rounded rows may meet far away; the sides of the bounding box then limit the result.
        """
        M, t = self._affine(M, t, M_columns=True)
        if self.is_empty:
            return _nothing(len(M))
        rows, shift = binary(M), binary(t)
        if rank(rows) < self.dimension and self.is_bounded:
            return _hull([tuple(rational.dot(a, x) + b for a, b in zip(rows, shift)) for x in self._exact_vertices])
        columns = [*zip(*rows)]

        def highest(v):  # h_P(M'v) + v t
            value = self.exact_maximum([rational.dot(v, column) for column in columns]).value
            return value if isinstance(value, float) else value + rational.dot(v, shift)

        exact = image(*self.exact, rows)
        found = np.array([[nearest(entry) for entry in v] for v, _ in exact]).reshape(-1, len(M))
        values = [highest(binary(v)) for v in found]
        if self.is_bounded:
            return _within_box(_rows_with(found, values), highest)
        limits = [b + rational.dot(v, shift) for v, b in exact]
        return _rows_with(found, [limit if value == np.inf else value for limit, value in zip(limits, values)])

    def preimage(self, M, t=None):
        """Preimage {x : M x + t in P} = {x : H M x <= h - H t}.

        Parameters
        ----------
        M : array (n, k)
            Of any rank; P lies in R^n.
        t : array (n,), optional
            0 if left out.

        Returns
        -------
        Polytope
            In R^k, with one row per row of P.

        Raises
        ------
        ValueError
            If the sizes of M and t do not match P.

        See Also
        --------
        map : the image.

        Examples
        --------
        >>> P = Polytope.box([0], [1])
        >>> P.preimage([[2, 4]], [-1]).contains([[0.5, 0.125], [0, 0]]).tolist()
        [True, False]

        Notes
        -----
        Approximate: H M and h - H t are computed without rounding, then each number is rounded to the nearest float. It
        is exact where they are floats, as for small whole numbers or powers of two.
        """
        M, t = self._affine(M, t, M_columns=False)
        H, h = self.exact
        columns, shift = [*zip(*binary(M))], binary(t)
        rows = [[nearest(rational.dot(a, column)) for column in columns] for a in H]
        return Polytope(rows, [nearest(b - rational.dot(a, shift)) for a, b in zip(H, h)])

    def project(self, axes):
        """Projection {(x_i for i in axes) : x in P} onto some coordinates.

        Parameters
        ----------
        axes : sequence of int
            Different coordinates, from 0 to n - 1, in the order of the result.

        Returns
        -------
        Polytope
            In R^len(axes).

        Raises
        ------
        ValueError
            If axes is empty, repeats a coordinate, or names one that P does not have, or if a bounded P has too many
            rows to enumerate its vertices.

        Examples
        --------
        >>> Polytope.box([0, 1, 2], [1, 2, 3]).project([2, 0]).equals(Polytope.box([2, 0], [3, 1]))
        True

        Notes
        -----
        Rounded outward, and for unbounded P approximate, as `map` says.
        """
        axes = [whole_number(axis, "an entry of axes", 0) for axis in np.atleast_1d(axes).tolist()]
        n = self.dimension
        if not axes or len({*axes}) < len(axes) or max(axes) >= n:
            raise ValueError(f"axes must be different coordinates from 0 to {n - 1}, at least one; got {axes}")
        return self.map(np.eye(n)[axes])

    def _require_same_space(self, Q, operation):
        """Raise ValueError unless Q is a Polytope in the space of P."""
        require_kind(Q, Polytope, "Q")
        if Q.dimension != self.dimension:
            raise ValueError(f"P lies in R^{self.dimension} but Q in R^{Q.dimension}; {operation} needs one space")

    def _affine(self, M, t, M_columns):
        """M and t of an affine map as arrays, their sizes checked; P lies where M comes from, or where it leads."""
        M = real_array(M, "M", 2)
        if not M.size or M.shape[M_columns] != self.dimension:
            needed = f"(m, {self.dimension})" if M_columns else f"({self.dimension}, k)"
            raise ValueError(f"M has shape {M.shape}, but P lies in R^{self.dimension}; give M the shape {needed}")
        t = np.zeros(len(M)) if t is None else real_array(t, "t", 1)
        if len(t) != len(M):
            raise ValueError(f"t has {len(t)} entries but M has {len(M)} rows; each row needs one entry")
        return M, t

    def in_units(self, scale):
        """{x' : scale x' in P}, rows scaled by powers of two to a largest entry above 1/2 and up to 1.

        Parameters
        ----------
        scale : array (n,)
            Powers of two.

        Raises
        ------
        ValueError
            If the numbers lie so far apart that rounding would be needed.
        """
        H, factor = normal_rows(times(self.H, scale))
        return Polytope(H, np.clip(self.h * factor, -LARGEST, LARGEST))

    @property
    def reach(self):
        """For each axis the smallest power of two that a bounded P nowhere exceeds, up to rounding: array (n,)."""
        return power_of_two(np.abs(self.bounding_box()).max(axis=0))

    def product(self, other):
        """Cartesian product {(x, y) : x in P, y in other}."""
        require_kind(other, Polytope, "the other factor")
        H = np.zeros((len(self.h) + len(other.h), self.dimension + other.dimension))
        H[: len(self.h), : self.dimension] = self.H
        H[len(self.h) :, self.dimension :] = other.H
        return Polytope(H, np.concatenate([self.h, other.h]))

    def sample(self, rng, size):
        """Random points of a bounded set.

        Parameters
        ----------
        rng : numpy.random.Generator
        size : int

        Returns
        -------
        array (size, n)
            Uniform where the set fills at least a tenth of its bounding box; otherwise random convex
            combinations of its vertices, which favour the middle.
        """
        require_kind(rng, np.random.Generator, "rng")
        size = whole_number(size, "size", 0)
        if self.is_empty:
            raise ValueError("the polytope is empty; nothing can be drawn from it")
        if not self.is_bounded:
            raise ValueError("the polytope is unbounded; intersect it with a box before drawing from it")
        lower, upper = self.bounding_box()
        draws = rng.uniform(lower, upper, (20 * size + 100, self.dimension))
        inside = draws[self.contains(draws)]
        if len(inside) >= max(size, len(draws) / 10):
            return inside[:size]
        corners = self._vertices
        return rng.dirichlet(np.ones(len(corners)), size) @ corners


def directions(count):
    """The template of the paper's case studies: C_i = (cos 2 pi (i-1)/count, sin 2 pi (i-1)/count).

    Parameters
    ----------
    count : int
        At least 3, so that the sets are bounded.

    Returns
    -------
    array (count, 2)
        Unit rows, counter-clockwise from (1, 0); exact zeros and ones where they belong.
    """
    count = whole_number(count, "count", 3)
    angles = 2 * np.pi * np.arange(count) / count
    C = np.column_stack([np.cos(angles), np.sin(angles)])
    return np.where(np.abs(C) < 1e-15, 0.0, C)


def box_directions(n):
    """The template (I, -I) whose sets are boxes: array (2 n, n)."""
    n = whole_number(n, "n", 1)
    return np.vstack([np.eye(n), -np.eye(n)]) + 0.0


# -- parts --------------------------------------------------------------------------------------------


class _Plane(NamedTuple):
    """What `compiled.polygon` returns."""

    kind: int
    corners: np.ndarray
    local: np.ndarray
    row: np.ndarray
    offset: np.ndarray
    unit: np.ndarray


def _nothing(n):
    """The empty set of R^n."""
    return Polytope(np.zeros((1, n)), [-1.0])


def _distinct(H):
    """The rows of H of which no earlier one is a multiple by a power of two."""
    return np.array([*{row.tobytes(): row for row in normal_rows(H)[0]}.values()])


def _rows_with(rows, values):
    """{x : rows x <= values}, the values rounded up; rows with a value of inf are left out."""
    kept = [(row, above(value)) for row, value in zip(rows, values) if not isinstance(value, float)]
    if not kept:
        return Polytope(np.zeros((1, rows.shape[1])), [1.0])  # the whole space
    return Polytope([row for row, _ in kept], [offset for _, offset in kept])


def _hull(points):
    """The convex hull of points of fmpq, rounded outward; flat ones included."""
    rows = _distinct(np.array([scaled(v) for v in Frame(points).normals()]))

    def highest(v):
        return max(rational.dot(v, x) for x in points)

    return _within_box(_rows_with(rows, [highest(binary(v)) for v in rows]), highest)


def _within_box(found, highest):
    """A polytope with those sides of a bounding box that it exceeds by more than rounding, as needles do.

    The box is that of the set with the support function `highest`, of rows of fmpq.
    """
    rows = box_directions(found.dimension)
    limits = np.array([above(highest(v)) for v in binary(rows)])
    size = np.tile(limits.reshape(2, -1).sum(axis=0), 2)
    wide = found.support(rows) > limits + TOUCH * size
    return found & Polytope(rows[wide], limits[wide]) if wide.any() else found


def _float(value, rounding):
    """The value of an ExactOptimum as a float, by `nearest` or `above`."""
    return value if isinstance(value, float) else rounding(value)


def _units(H, h):
    """Exponents e (n,) of units 2^e for the coordinates, medians of where rows cut the axes.

    They follow the data: another power of two as the unit of a coordinate, or as the factor of a row, changes e
    accordingly, or does not change it.
    """
    unit, size, offset = np.zeros(H.shape[1], int), np.frexp(H)[1], np.frexp(h)[1]
    settled = np.zeros(H.shape[1], bool)
    for j in range(H.shape[1]):
        cuts = (H[:, j] != 0) & (h != 0)
        if cuts.any():
            unit[j], settled[j] = np.sort(offset[cuts] - size[cuts, j])[cuts.sum() // 2], True
    while not settled.all():  # what no offset settles is settled by rows that it shares with other coordinates
        shared = (H != 0) & ~settled & ((H != 0) & settled).any(axis=1)[:, None]
        j = int(np.argmax(shared.any(axis=0)) if shared.any() else np.argmin(settled))
        if shared.any():
            top = np.where((H != 0) & settled, size + unit, -(10**6)).max(axis=1)
            unit[j] = np.sort((top - size[:, j])[shared[:, j]])[shared[:, j].sum() // 2]
        settled[j] = True
    return unit


def _top(H, unit):
    """The largest exponent in each row of H, for x in units of 2^unit: array (l,) of int."""
    return np.where(H != 0, np.frexp(H)[1] + unit, -(10**6)).max(axis=1, initial=-(10**6)) * (H != 0).any(axis=1)


def _direction(v, unit):
    """v for x in units of 2^unit, scaled by a power of two to entries below 1."""
    return in_units(np.ascontiguousarray(v, float), unit)


def _normals(points):
    """Outward normals of the hull of at least two points (k, 2), each coordinate of which spreads over about 1."""
    points = points[np.lexsort(points.T[::-1])]
    ring = points[hull(points, TURN)]
    if len(ring) < 3:
        along = points[-1] - points[0]
        return np.vstack([[[-along[1], along[0]], [along[1], -along[0]]], np.eye(2), -np.eye(2)])
    along = np.roll(ring, -1, axis=0) - ring
    return np.column_stack([along[:, 1], -along[:, 0]])


def _rows_around(normals, unit, points):
    """The polytope that touches points (k, n), for given normals in units of 2^unit; it certainly holds them.

    In the plane the sides of their bounding box are added where the normals alone would let a needle reach too far.
    """
    top = _top(normals, -unit)
    H = np.ldexp(normals, -unit - top[:, None])
    H /= np.linalg.norm(H, axis=1)[:, None]
    H = np.where(H == 0, 0.0, H)
    if H.shape[1] == 2:
        angle = np.sort(np.arctan2(H[:, 1], H[:, 0]))
        if np.diff(angle, append=angle[0] + 2 * np.pi).max() > WIDE:
            H = np.vstack([H, np.eye(2), -np.eye(2)])
    H = np.array([*{row.tobytes(): row for row in H}.values()])
    exact = np.count_nonzero(H, axis=1) == 1  # rows of the coordinates, whose products do not round
    terms = np.where(exact, 0, ROUNDING * (np.abs(points) @ np.abs(H).T) + LEAST)
    return Polytope(H, (points @ H.T + terms).max(axis=0))


def _apart(points):
    """Points (k, n) without those that are one to within rounding; for n = 2 counter-clockwise, corners alone."""
    spread = np.ptp(np.ldexp(points, -1), axis=0) * 2
    distance = np.maximum(TOUCH * spread, 2.0**-48 * np.abs(points).max(axis=0))
    kept = []
    for point in points:
        if all((np.abs(point - other) > distance).any() for other in kept):
            kept.append(point)
    kept = np.array(kept)
    if points.shape[1] != 2:
        return kept
    local = np.ldexp(kept - kept[0], -np.frexp(spread)[1])
    return kept[[int(np.flatnonzero((local == corner).all(axis=1))[0]) for corner in around(local)]]
