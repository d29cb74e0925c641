"""Polytopes {x : H x <= h}: support functions, vertices, inclusion, templates (Sec. I.A of [Teichrib2025])."""

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from math import comb

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from .checks import positive_number, real_array, require_columns, require_kind, whole_number
from .compiled import around, polygon
from .lp import LinearProgram

TOUCH = 1e-11  # vertices count as one point, and as inside, within this distance (relative to 1 + the size of the set)
PARALLEL = 1e-12  # unit rows whose determinant is below this have no vertex
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
        object.__setattr__(self, "H", H)
        object.__setattr__(self, "h", h)

    def __reduce__(self):
        return Polytope, (self.H, self.h)  # what is cached holds a solver, which cannot be pickled

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
        if not len(points):
            raise ValueError("points is empty; a convex hull needs at least one point")
        try:
            H = ConvexHull(points).equations[:, :-1]
        except (QhullError, ValueError) as error:
            flat = np.ptp(points, axis=0).max() == 0
            if points.shape[1] > 2 and not flat:
                raise ValueError(
                    f"the {len(points)} points span no volume in R^{points.shape[1]}; "
                    "give H and h of a flat set directly"
                ) from error
            H = np.vstack([np.eye(points.shape[1]), -np.eye(points.shape[1])])
            if not flat and points.shape[1] == 2:
                along = points[np.argmax(np.linalg.norm(points - points[0], axis=1))] - points[0]
                along = along / np.linalg.norm(along)
                across = np.array([-along[1], along[0]])
                H = np.array([along, -along, across, -across])
        return Polytope(H, (points @ H.T).max(axis=0))

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
        """Support function h_P(v) = max {v x : x in P}, for each row v of V.

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

        Notes
        -----
        In the plane a maximum over the vertices; otherwise one LP a row (HiGHS), warm-started from
        the last. Sec. I.A of [Teichrib2025].
        """
        V = real_array(V, "V", 2)
        require_columns(V, self.dimension, "V", "the dimension of the polytope")
        if self.dimension == 2 and self.is_bounded and not self.is_empty:
            return (V @ self.vertices().T).max(axis=1)
        lp, x = self._program
        return np.array([lp.maximize(x, v).value for v in V])

    def farthest(self, v):
        """A point (n,) of P that attains h_P(v), or None if P is empty or unbounded along v."""
        v = real_array(v, "v", 1)
        require_columns(v, self.dimension, "v", "the dimension of the polytope")
        lp, x = self._program
        return lp.maximize(x, v).point

    @cached_property
    def _program(self):
        """The constraints H x <= h as a linear program, and the indices of x."""
        lp = LinearProgram()
        x = lp.add_columns(np.full(self.dimension, -np.inf), np.full(self.dimension, np.inf))
        lp.add_rows(x, self.H, upper=self.h)
        return lp, x

    @cached_property
    def is_empty(self):
        """True if no point satisfies H x <= h (to within the LP solver's 1e-9)."""
        if self._polygon is not None:
            return False
        lp, x = self._program
        return lp.maximize(x, np.zeros(self.dimension)).value == -np.inf

    @cached_property
    def is_bounded(self):
        """True if P is empty or its support function is finite everywhere."""
        return self._polygon is not None or self.is_empty or self._extent < np.inf

    @cached_property
    def _extent(self):
        """Largest coordinate, up to sign, of a nonempty set."""
        lp, x = self._program
        identity = np.eye(self.dimension)
        return max(lp.maximize(x, v).value for v in np.vstack([identity, -identity]))

    def contains(self, x, tol=0.0):
        """Whether H x <= h + tol.

        Parameters
        ----------
        x : array (n,) or (N, n)
        tol : float
            In units of h. The default asks for the closed set itself; a computed vertex is inside
            only to within rounding, 1e-9 is ample for it.

        Returns
        -------
        bool, or array (N,) of bool
        """
        x = np.asarray(x, float)
        require_columns(x, self.dimension, "x", "the dimension of the polytope")
        return (x @ self.H.T <= self.h + tol).all(axis=-1)

    def is_subset(self, Q, tol=0.0):
        """Whether P lies in Q: h_P(H_Q) <= h_Q + tol. An empty P lies in every Q.

        Parameters
        ----------
        Q : Polytope
        tol : float
            In units of Q.h. Rows that P shares with Q are compared as numbers, so that P lies in P
            without any tolerance.
        """
        require_kind(Q, Polytope, "Q")
        if Q.dimension != self.dimension:
            raise ValueError(f"P lies in R^{self.dimension} but Q in R^{Q.dimension}; inclusion needs one space")
        own = {row.tobytes(): offset for row, offset in zip(self.H + 0.0, self.h)}
        shared = np.array([own.get(row.tobytes(), np.inf) for row in Q.H + 0.0])
        open_rows = shared > Q.h + tol
        return bool(not open_rows.any() or (self.support(Q.H[open_rows]) <= Q.h[open_rows] + tol).all())

    def vertices(self):
        """The extreme points of a bounded set.

        Returns
        -------
        array (v, n)
            Counter-clockwise for n = 2; no rows if P is empty. Points closer than rounding are one.

        Raises
        ------
        ValueError
            If P is unbounded, or so large that its subsets of n rows cannot be tried.

        Notes
        -----
        Tries all n rows at a time, which is sturdy for flat sets and slow for many rows in high
        dimension.
        """
        return self._vertices.copy()

    @cached_property
    def _polygon(self):
        """In the plane the vertices, where they prove P bounded and nonempty without a linear program; else None."""
        found = polygon(self.H, self.h, PARALLEL, TOUCH) if self.dimension == 2 else ()
        return found if len(found) else None

    @cached_property
    def _vertices(self):
        n = self.dimension
        if self._polygon is not None:
            return self._polygon
        if self.is_empty:
            return np.zeros((0, n))
        if not self.is_bounded:
            raise ValueError("the polytope is unbounded; intersect it with a box before asking for vertices")
        if comb(len(self.h), n) > MOST_VERTEX_CANDIDATES:
            raise ValueError(f"{len(self.h)} rows in R^{n} are too many to enumerate vertices; use support()")
        length = np.linalg.norm(self.H, axis=1)
        used = length > 0
        H, h = self.H[used] / length[used, None], self.h[used] / length[used]
        subsets = np.array(list(combinations(range(len(h)), n)))
        regular = np.abs(np.linalg.det(H[subsets])) > PARALLEL
        points = np.linalg.solve(H[subsets[regular]], h[subsets[regular]][..., None])[..., 0]
        scale = 1 + abs(self._extent)  # not the largest offset: a redundant row may lie far away
        excess = (points @ H.T - h).max(axis=1)
        inside = excess <= max(TOUCH * scale, excess.min())  # a set that is empty by a rounding error is a point
        points = _distinct(points[inside], TOUCH * scale)
        return around(points) if n == 2 else points

    def chebyshev(self):
        """Centre and radius of the largest ball in P: ((n,), float).

        The radius is negative by the smallest widening that would make an empty P nonempty, 0 for a
        flat P, and inf (with a centre of None) if P holds balls of any size.
        """
        lp = LinearProgram()
        x = lp.add_columns(np.full(self.dimension, -np.inf), np.full(self.dimension, np.inf))
        r = lp.add_columns([-np.inf], [np.inf])
        norms = np.linalg.norm(self.H, axis=1)
        lp.add_rows(np.concatenate([x, r]), np.column_stack([self.H, norms]), upper=self.h)
        best = lp.maximize(r, [1.0])
        return (None, np.inf) if best.point is None else (best.point[:-1], best.value)

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
        x, y = self._vertices.T
        return float(x @ np.roll(y, -1) - np.roll(x, -1) @ y) / 2

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


def _distinct(points, distance):
    """One of each group of points that are closer than `distance` to the first of the group."""
    kept = []
    for point in points:
        if all(np.abs(point - other).max() > distance for other in kept):
            kept.append(point)
    return np.array(kept).reshape(-1, points.shape[1])
