"""Polytopes: convex sets {x : H x <= h} that are made from boxes, points and each other."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..arithmetic import rational
from ..arithmetic.balls import flint
from ..arithmetic.rational import nearest
from ..arithmetic.scaling import normal_rows, power_of_two, times
from ..checks import positive_number, real_array, require_kind, whole_number
from ..typing import Array, ArrayLike
from . import operations
from .convex_set import ConvexSet, top_exponent
from .facets import Frame

EXTREME = 4  # points of a set, as a multiple of n + 1, that stand for its vertices where these are too many


class Polytope(ConvexSet):
    """The closed convex set {x : H x <= h}; empty, flat and unbounded ones included.

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

    See Also
    --------
    Region : finite unions of polygons in the plane.

    Notes
    -----
    `==` and `hash` compare objects, not sets: the same set has many H and h. `equals` compares sets.

    Examples
    --------
    >>> P = Polytope.box([-1, -2], [1, 2])
    >>> P.support([[1, 1]])
    array([3.])
    """

    # -- making -----------------------------------------------------------------------------------

    @staticmethod
    def box(lower: ArrayLike, upper: ArrayLike) -> Polytope:
        """The box {x : lower <= x <= upper}; a point or a segment where the two agree.

        Parameters
        ----------
        lower, upper : array (n,)

        Returns
        -------
        Polytope

        Raises
        ------
        ValueError
            If the sizes differ or lower > upper somewhere.

        See Also
        --------
        bounding_box : the inverse.

        Examples
        --------
        >>> Polytope.box([0, 0], [1, 2]).area
        2.0
        """
        low, high = real_array(lower, "lower", 1), real_array(upper, "upper", 1)
        if low.shape != high.shape:
            raise ValueError(f"lower has {len(low)} entries but upper has {len(high)}")
        if (low > high).any():
            i = int(np.argmax(low > high))
            raise ValueError(f"lower must not exceed upper; entry {i}: {low[i]} > {high[i]}")
        identity = np.eye(len(low))
        return Polytope(np.vstack([identity, -identity]), np.concatenate([high, -low]))

    @staticmethod
    def from_points(points: ArrayLike) -> Polytope:
        """The convex hull of points, rounded outward by at most a few units in the last place.

        It is bounded and contains every one of the points, whatever `contains` rounds.

        Parameters
        ----------
        points : array (k, n)
            A single point and collinear points in the plane are fine; for n > 2 the hull must have
            an interior.

        Returns
        -------
        Polytope

        Raises
        ------
        ValueError
            If there is no point, or the hull is flat and n > 2.

        See Also
        --------
        vertices : the inverse.

        Examples
        --------
        >>> triangle = Polytope.from_points([[0, 0], [4, 0], [0, 2], [1, 0.5]])
        >>> len(triangle.h), round(triangle.area, 12)
        (3, 4.0)
        """
        points = real_array(points, "points", 2)
        if not len(points):
            raise ValueError("points is empty; a convex hull needs at least one point")
        return Polytope(*operations.hull_of(points))

    @staticmethod
    def from_dict(value: dict[str, Any]) -> Polytope:
        """The polytope that `to_dict` wrote, bit by bit.

        Parameters
        ----------
        value : dict
            With the keys H and h.

        Returns
        -------
        Polytope

        Raises
        ------
        ValueError
            If a key is missing, or H and h make no polytope.

        See Also
        --------
        to_dict : the inverse.

        Examples
        --------
        >>> Polytope.from_dict({"H": [[1.0], [-1.0]], "h": [1.0, 0.0]})
        Polytope(2 rows in R^1)
        """
        if not isinstance(value, dict) or not {"H", "h"} <= value.keys():
            raise ValueError(f"a polytope needs the keys H and h; got {value!r:.80}")
        return Polytope(value["H"], value["h"])

    def to_dict(self) -> dict[str, Any]:
        """{"H": [[...]], "h": [...]}, the form of sets in this package's files.

        Returns
        -------
        dict
            Ready for JSON, which reads every number back to the same float.

        See Also
        --------
        from_dict : the inverse.

        Examples
        --------
        >>> Polytope([[1.0], [-1.0]], [1.0, 0.0]).to_dict()
        {'H': [[1.0], [-1.0]], 'h': [1.0, 0.0]}
        """
        return {"H": self.H.tolist(), "h": self.h.tolist()}

    # -- shape and size ---------------------------------------------------------------------------

    def vertices(self) -> Array:
        """The extreme points of a bounded set.

        Returns
        -------
        array (v, n)
            Counter-clockwise for n = 2; no rows if P is empty. Points that differ by rounding are one, relative to
            the size of the set in each coordinate.

        Raises
        ------
        ValueError
            If P is unbounded, or has more than about 2,000 vertices.

        See Also
        --------
        exact_vertices : without rounding; from_points : the inverse.

        Examples
        --------
        >>> Polytope.box([0, 0], [1, 2]).vertices().tolist()
        [[0.0, 0.0], [1.0, 0.0], [1.0, 2.0], [0.0, 2.0]]

        Notes
        -----
        Computed over the rationals, then rounded. In the plane pairs of rows meet in the vertices. In more dimensions
        the bounding box is cut by one row after the other (double description).
        """
        return self._vertices.copy()

    def chebyshev_centre(self) -> tuple[Any, float]:
        """Centre c and radius r of the largest ball in P: max r over H_i c + r |H_i| <= h_i.

        Returns
        -------
        centre : array (n,) or None
        radius : float
            Negative by the smallest widening that would make an empty P nonempty, 0 for a flat P, and inf
            (with a centre of None) if P holds balls of any size.

        See Also
        --------
        bounding_box : the size from outside.

        Examples
        --------
        >>> Polytope.box([0, 0], [2, 2]).chebyshev_centre()
        (array([1., 1.]), 1.0)

        Notes
        -----
        The program is solved without rounding. The lengths |H_i| and the answer are rounded to nearest. `chebyshev` is
        the same method.
        """
        top = top_exponent(self.H, np.zeros(self.dimension, int))
        row = np.ldexp(self.H, -top[:, None])
        lengths = np.ldexp(np.linalg.norm(row, axis=1), top)
        best = Polytope(np.column_stack([self.H, lengths]), self.h).support_vector(np.eye(self.dimension + 1)[-1])
        return (None, np.inf) if best is None else (best[:-1], float(best[-1]))

    chebyshev = chebyshev_centre

    def bounding_box(self) -> tuple[Array, Array]:
        """Smallest box around P, rounded to nearest.

        Returns
        -------
        lower, upper : array (n,)
            inf where P is unbounded; lower > upper if P is empty.

        See Also
        --------
        box : the inverse; bound : rounded outward.

        Examples
        --------
        >>> (Polytope.box([1, 1], [9, 9]) & Polytope([[1, 1]], [4])).bounding_box()
        (array([1., 1.]), array([3., 3.]))
        """
        identity = np.eye(self.dimension)
        return -self.support(-identity), self.support(identity)

    @property
    def half_width(self) -> Array:
        """For each axis the smallest power of two that a bounded P nowhere exceeds, up to rounding: array (n,)."""
        return power_of_two(np.abs(self.bounding_box()).max(axis=0))

    @property
    def area(self) -> float:
        """Of a bounded set of the plane, in units of x1 times x2; 0 for flat and empty ones.

        Raises
        ------
        ValueError
            If P is unbounded or not in the plane.
        """
        if self.dimension != 2:
            raise ValueError(f"only sets of the plane have an area; this one lies in R^{self.dimension}")
        corners = self._vertices
        if len(corners) < 3:
            return 0.0
        x, y = (corners - corners[0]).T
        return float(x @ np.roll(y, -1) - np.roll(x, -1) @ y) / 2

    def volume(self) -> float:
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
        return nearest(Frame(self.exact_vertices).volume())

    def sample(self, rng: np.random.Generator | int, size: int) -> Array:
        """Random points of a bounded set, in any dimension; flat sets and points included.

        Parameters
        ----------
        rng : numpy.random.Generator or int
            Source of randomness, or the seed of a new one. The same seed gives the same points.
        size : int
            Number of points.

        Returns
        -------
        array (size, n)
            Uniform where the set fills at least a tenth of its bounding box; otherwise random convex
            combinations of its vertices, which favour the middle. The latter lie in P to within rounding. Where the
            vertices cannot be enumerated, points that attain the support function along random directions replace
            them.

        Raises
        ------
        TypeError
            If rng is neither a Generator nor an int.
        ValueError
            If P is empty or unbounded.

        See Also
        --------
        vertices : the extreme points.

        Examples
        --------
        >>> x = Polytope.box([0, 5], [1, 5]).sample(0, 100)
        >>> x.shape, float(x[:, 1].min()), bool((x[:, 0] <= 1).all())
        ((100, 2), 5.0, True)
        """
        require_kind(rng, (np.random.Generator, int, np.integer), "rng")
        rng = np.random.default_rng(rng)
        size = whole_number(size, "size", 0)
        if self.is_empty:
            raise ValueError("the polytope is empty; nothing can be drawn from it")
        if not self.is_bounded:
            raise ValueError("the polytope is unbounded; intersect it with a box before drawing from it")
        lower, upper = self.bounding_box()
        if (np.ldexp(upper, -1) - np.ldexp(lower, -1) >= 2.0**1023).any():
            raise ValueError("the polytope is wider than the largest float; choose another unit")
        draws = rng.uniform(lower, upper, (20 * size + 100, self.dimension))
        own = (np.abs(self.H).sum(axis=1) != 1) | ((self.H != 0).sum(axis=1) != 1)  # rows that the box does not imply
        inside = draws[Polytope(self.H[own], self.h[own]).contains(draws)] if own.any() else draws
        if len(inside) >= max(size, len(draws) / 10):
            return inside[:size]
        try:
            corners = self._vertices
        except ValueError:  # too many of them
            V = rng.normal(size=(EXTREME * (self.dimension + 1), self.dimension))
            V /= np.where(upper > lower, upper - lower, 1)
            corners = np.array([self.support_vector(v) for v in V])
        return rng.dirichlet(np.ones(len(corners)), size) @ corners

    # -- new sets ---------------------------------------------------------------------------------

    def __and__(self, other: Polytope) -> Polytope:
        """Intersection; a row that both have is kept once, with the smaller offset."""
        require_kind(other, Polytope, "what P is intersected with")
        if other.dimension != self.dimension:
            raise ValueError(f"cannot intersect sets in R^{self.dimension} and R^{other.dimension}")
        return Polytope(*operations.intersection(self, other))

    def scale(self, s: float, centre: ArrayLike = 0) -> Polytope:
        """c + s (P - c) = {x : H x <= s h + (1 - s) H c}, offsets rounded to nearest.

        Parameters
        ----------
        s : float
            Positive.
        centre : array (n,) or number
            The point c that stays where it is.

        Returns
        -------
        Polytope

        Raises
        ------
        ValueError
            If s is not positive, or centre has another size.

        See Also
        --------
        map : any affine map, rounded outward.

        Examples
        --------
        >>> Polytope.box([0, 0], [2, 2]).scale(0.5, [2, 2]).bounding_box()
        (array([1., 1.]), array([2., 2.]))
        """
        s, centre = positive_number(s, "s"), real_array(centre, "centre", np.ndim(centre))
        if centre.shape not in ((), (self.dimension,)):
            raise ValueError(f"centre has shape {centre.shape}, but the polytope lies in R^{self.dimension}")
        return Polytope(self.H, s * self.h + (1 - s) * (self.H @ np.broadcast_to(centre, self.dimension)))

    def sum(self, Q: Polytope) -> Polytope:
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
        TypeError
            If Q is no Polytope.
        ValueError
            If Q lies in another space, or, for n > 2, if P or Q has too many rows to enumerate its vertices.

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
        `map` of the product, and approximate in the way described there.
        """
        self._require_same_space(Q, "a Minkowski sum")
        return Polytope(*operations.minkowski_sum(self, Q))

    def erode(self, Q: Polytope) -> Polytope:
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
        TypeError
            If Q is no Polytope.
        ValueError
            If Q lies in another space, or is empty.

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
        return Polytope(*operations.pontryagin_difference(self, Q))

    def map(self, M: ArrayLike, t: ArrayLike | None = None) -> Polytope:
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
        along it, the offset is that of the row before rounding, also for the opposite row if there is one, and the
        result is approximate: it may be bounded where the image is a narrow strip. If M is nearly singular,
        rounded rows may meet far away; the sides of the bounding box then limit the result.
        """
        return Polytope(*operations.linear_image(self, *self._affine(M, t, M_columns=True)))

    def preimage(self, M: ArrayLike, t: ArrayLike | None = None) -> Polytope:
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
            In R^k, with one row per row of P; empty if P is.

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
        return Polytope(*operations.linear_preimage(self, *self._affine(M, t, M_columns=False)))

    def project(self, axes: ArrayLike) -> Polytope:
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

        See Also
        --------
        section : the values in the other coordinates fixed; map : any linear image; product : the other way round.

        Examples
        --------
        >>> Polytope.box([0, 1, 2], [1, 2, 3]).project([2, 0]).equals(Polytope.box([2, 0], [3, 1]))
        True

        Notes
        -----
        Rounded outward for bounded P, and approximate for unbounded P: see `map`.
        """
        return self.map(np.eye(self.dimension)[self._coordinates(axes)])

    def section(self, axes: ArrayLike, at: ArrayLike = 0) -> Polytope:
        """Section {(x_i for i in axes) : x in P, x_j = at_j for all j not in axes}.

        Parameters
        ----------
        axes : sequence of int
            Different coordinates, from 0 to n - 1, in the order of the result.
        at : array (n,) or number
            A point of R^n through which the section passes. Its coordinates in axes have no effect.

        Returns
        -------
        Polytope
            In R^len(axes), with one row per row of P. Empty if and only if no point of P has these coordinates.

        Raises
        ------
        ValueError
            If axes is empty, repeats a coordinate, or names one that P does not have, or if `at` has another size.

        See Also
        --------
        project : the union of all sections; preimage : of any affine map.

        Examples
        --------
        >>> P = Polytope([[1, 1, 1]], [3]) & Polytope.box([0, 0, 0], [2, 2, 2])
        >>> P.section([0, 2], at=[0, 2, 0]).vertices().tolist()
        [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]

        Notes
        -----
        Whether it is empty is decided without rounding. Otherwise the offsets h - sum_j H_j at_j are rounded up, so the
        result holds every point of the section.
        """
        chosen, point = self._coordinates(axes), real_array(at, "at", np.ndim(at))
        if point.shape not in ((), (self.dimension,)):
            raise ValueError(f"at has shape {point.shape}, but the polytope lies in R^{self.dimension}")
        return Polytope(*operations.section(self, chosen, np.broadcast_to(point, self.dimension)))

    def _coordinates(self, axes: ArrayLike) -> list[int]:
        """The different coordinates that `axes` names, checked."""
        chosen = [whole_number(axis, "an entry of axes", 0) for axis in np.atleast_1d(axes).tolist()]
        n = self.dimension
        if not chosen or len({*chosen}) < len(chosen) or max(chosen) >= n:
            raise ValueError(f"axes must be different coordinates from 0 to {n - 1}, at least one; got {chosen}")
        return chosen

    def _affine(self, M: ArrayLike, t: ArrayLike | None, M_columns: bool) -> tuple[Array, Array]:
        """M and t of an affine map as arrays, their sizes checked; P lies where M comes from, or where it leads."""
        M = real_array(M, "M", 2)
        if not M.size or M.shape[M_columns] != self.dimension:
            needed = f"(m, {self.dimension})" if M_columns else f"({self.dimension}, k)"
            raise ValueError(f"M has shape {M.shape}, but P lies in R^{self.dimension}; give M the shape {needed}")
        t = np.zeros(len(M)) if t is None else real_array(t, "t", 1)
        if len(t) != len(M):
            raise ValueError(f"t has {len(t)} entries but M has {len(M)} rows; each row needs one entry")
        return M, t

    def in_units(self, scale: ArrayLike) -> Polytope:
        """{x' : scale x' in P}, without rounding.

        Rows are scaled by powers of two to a largest entry above 1/2 and up to 1, or as far as h stays finite.

        Parameters
        ----------
        scale : array (n,)
            Powers of two.

        Returns
        -------
        Polytope

        Raises
        ------
        ValueError
            If the numbers lie so far apart that rounding would be needed.

        See Also
        --------
        preimage : of any affine map.

        Examples
        --------
        >>> Polytope.box([2, 4], [4, 4]).in_units([2, 4]).bounding_box()
        (array([1., 1.]), array([2., 1.]))
        """
        H, factor = normal_rows(times(self.H, np.asarray(scale, float)))
        power = np.frexp(factor)[1] - 1
        beyond = np.maximum(np.frexp(self.h)[1] + power - 1024, 0)  # of the range of floats
        return Polytope(times(H, np.ldexp(1.0, -beyond)[:, None]), np.ldexp(self.h, power - beyond))

    def product(self, other: Polytope) -> Polytope:
        """Cartesian product {(x, y) : x in P, y in other}, without rounding.

        Parameters
        ----------
        other : Polytope
            In any space.

        Returns
        -------
        Polytope

        Raises
        ------
        TypeError
            If `other` is no Polytope.

        See Also
        --------
        project : onto some of the coordinates.

        Examples
        --------
        >>> Polytope.box([0], [1]).product(Polytope.box([2, 2], [3, 3])).dimension
        3
        """
        require_kind(other, Polytope, "the other factor")
        H = np.zeros((len(self.h) + len(other.h), self.dimension + other.dimension))
        H[: len(self.h), : self.dimension] = self.H
        H[len(self.h) :, self.dimension :] = other.H
        return Polytope(H, np.concatenate([self.h, other.h]))
