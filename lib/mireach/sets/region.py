"""Regions: finite unions of polygons, segments and points in the plane."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import shapely

from ..checks import positive_number, real_array, require_columns, require_kind, whole_number
from ..typing import Array, ArrayLike
from .geos import Shape, flat_parts, hulls, measures, merged, overlay, polygons_of, require_size, widened_edges
from .polygons import Polygons
from .polytope import Polytope


@dataclass(frozen=True, eq=False)
class Region:
    """A closed set of the plane: polygons, which may have holes, segments and points, finitely many of them.

    Parameters
    ----------
    shape : shapely geometry
        `Region.of` makes it from polytopes or from corners.

    Raises
    ------
    TypeError
        If shape is no shapely geometry.
    ValueError
        If a coordinate is not finite, or the largest one is not between 2^-400 and 2^400.

    See Also
    --------
    Polytope : convex sets in any dimension, without rounding.

    Notes
    -----
    shapely (GEOS) computes in floating point: corners that an operation makes are off by rounding, about
    1e-12 of the largest coordinate, to either side. No operation rounds inward or outward; widen or narrow the result
    (`sum`, `erode`) where that matters. Sets stay closed: a difference is the closure of the difference. What
    has to be proven about a region is proven about its `pieces`, whose corners are the floats they are.

    `==` and `hash` compare objects, not sets; `equals` compares sets.

    Examples
    --------
    >>> frame = Region.of(Polytope.box([0, 0], [3, 3])) - Polytope.box([1, 1], [2, 2])
    >>> frame.area, frame.erode(Polytope.box([-0.25, -0.25], [0.25, 0.25])).area
    (8.0, 4.0)
    """

    shape: Shape

    def __post_init__(self) -> None:
        require_kind(self.shape, shapely.Geometry, "shape")
        if not np.isfinite(shapely.get_coordinates(self.shape)).all():
            raise ValueError("shape holds coordinates that are not finite; a region is bounded")
        require_size(shapely.get_coordinates(self.shape))

    def __repr__(self) -> str:
        return f"Region(area {self.area:.6g}, {self.components} components)"

    # -- making -----------------------------------------------------------------------------------

    @staticmethod
    def of(*parts: Region | Polytope | ArrayLike) -> Region:
        """The union of parts, each a Region, a bounded Polytope, or the corners (v, 2) of a convex polygon.

        Parameters
        ----------
        *parts : Region, Polytope or array (v, 2)
            None for the empty region.

        Returns
        -------
        Region

        Raises
        ------
        ValueError
            If a part is unbounded or does not lie in the plane; the message gives its size.

        See Also
        --------
        pieces : the inverse, into convex polygons.

        Examples
        --------
        >>> Region.of(Polytope.box([0, 0], [1, 1]), [[2, 0], [3, 0], [3, 1]])
        Region(area 1.5, 2 components)
        """
        return Region(overlay(shapely.union_all, [_shape(part) for part in parts]))

    @staticmethod
    def from_dict(value: dict[str, Any]) -> Region:
        """The region that `to_dict` wrote, with the same corners.

        Parameters
        ----------
        value : dict
            With the key pieces.

        Returns
        -------
        Region

        Raises
        ------
        ValueError
            If the key is missing, or a piece is no list of corners.

        See Also
        --------
        to_dict : the inverse.

        Examples
        --------
        >>> Region.from_dict({"pieces": [[[0, 0], [1, 0], [0, 1]]]})
        Region(area 0.5, 1 components)
        """
        if not isinstance(value, dict) or "pieces" not in value:
            raise ValueError(f"a region needs the key pieces; got {value!r:.80}")
        return Region.of(*value["pieces"])

    def to_dict(self) -> dict[str, Any]:
        """{"pieces": [[[x1, x2], ...], ...]}: the corners of convex pieces whose union is the region.

        Returns
        -------
        dict
            Ready for JSON, which reads every number back to the same float.

        See Also
        --------
        from_dict : the inverse.

        Examples
        --------
        >>> Region.of([[0, 0], [2, 1]]).to_dict()
        {'pieces': [[[0.0, 0.0], [2.0, 1.0]]]}
        """
        return {"pieces": [self.pieces[i].tolist() for i in range(len(self.pieces))]}

    # -- size and shape ---------------------------------------------------------------------------

    @property
    def dimension(self) -> int:
        """2, for a region lies in the plane."""
        return 2

    @property
    def area(self) -> float:
        """In units of x1 times x2, rounded."""
        return float(shapely.area(self.shape))

    @property
    def is_empty(self) -> bool:
        """True if there is no point in it, not even a single one."""
        return bool(shapely.is_empty(self.shape))

    @property
    def is_bounded(self) -> bool:
        """True, for every region is bounded."""
        return True

    @property
    def components(self) -> int:
        """Number of polygons, segments and points that the region falls into; they may touch in points."""
        return len(shapely.get_parts(shapely.get_parts(self.shape)))

    @property
    def holes(self) -> int:
        """Number of holes of all components."""
        return int(shapely.get_num_interior_rings(polygons_of(self.shape)).sum())

    def support(self, V: ArrayLike) -> Array:
        """Support function h_S(v) = max {v x : x in S}, for each row v of V.

        Parameters
        ----------
        V : array (k, 2)
            Directions, one per row.

        Returns
        -------
        array (k,)
            Computed in floating point from the corners, rounded to either side; -inf where the region is empty.

        Raises
        ------
        ValueError
            If V does not have 2 columns; the message gives both sizes.

        See Also
        --------
        bounding_box : along the axes; convex_hull : the convex set with the same support function.

        Examples
        --------
        >>> Region.of([[0, 0], [1, 1]], [[3, 0]]).support([[1, 0], [0, 1], [1, 1]])
        array([3., 1., 3.])
        """
        V = real_array(V, "V", 2)
        require_columns(V, 2, "V", "for a region lies in the plane")
        return (V @ shapely.get_coordinates(self.shape).T).max(axis=1, initial=-np.inf)

    def bounding_box(self) -> tuple[Array, Array]:
        """Smallest box around the region, without rounding.

        Returns
        -------
        lower, upper : array (2,)

        Raises
        ------
        ValueError
            If the region is empty.

        See Also
        --------
        support : along any direction.

        Examples
        --------
        >>> Region.of([[1, 1], [2, 5]], [[3, 2]]).bounding_box()
        (array([1., 1.]), array([3., 5.]))
        """
        if self.is_empty:
            raise ValueError("the region is empty; no box is the smallest around it")
        limits = np.array(shapely.bounds(self.shape))
        return limits[:2], limits[2:]

    def convex_hull(self) -> Polytope:
        """The convex hull as a Polytope, rounded outward: it holds every corner of the region.

        Returns
        -------
        Polytope

        Raises
        ------
        ValueError
            If the region is empty.

        See Also
        --------
        Polytope.from_points : of any points.

        Examples
        --------
        >>> Region.of([[0, 0], [4, 0]], [[0, 2]]).convex_hull().contains([1, 1])
        True
        """
        if self.is_empty:
            raise ValueError("the region is empty; a convex hull needs at least one point")
        return Polytope.from_points(shapely.get_coordinates(self.shape))

    @cached_property
    def simplices(self) -> Polygons:
        """Triangles, segments and points whose union is the region, as Polygons, the triangles first.

        No corners are added: those of the simplices are corners of the region, as the floats they are.
        """
        triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(polygons_of(self.shape)))
        corners = shapely.get_coordinates(triangles).reshape(-1, 4, 2)[:, :3]
        solid = Polygons(corners.reshape(-1, 2), 3 * np.arange(len(corners) + 1))
        return Polygons.join([solid, Polygons.of(flat_parts(self.shape))])

    @cached_property
    def pieces(self) -> Polygons:
        """Convex pieces whose union is the region, as Polygons: its simplices, of which neighbours are merged.

        A side that two triangles share is left out where what results is convex beyond rounding (Hertel and
        Mehlhorn): at most four times as many pieces as need be.
        """
        simplices = self.simplices
        count = int((np.diff(simplices.starts) == 3).sum())
        convex = merged([simplices[i] for i in range(count)])
        return Polygons.of([*convex, *(simplices[i] for i in range(count, len(simplices)))])

    def rings(self) -> list[Array]:
        """Closed rings of corners, counter-clockwise around polygons, clockwise around holes.

        Returns
        -------
        list of arrays (v, 2)
            The last corner of each is its first. Segments and points have none.

        See Also
        --------
        pieces : convex polygons instead.

        Examples
        --------
        >>> [ring.tolist() for ring in Region.of([[0, 0], [1, 0], [0, 1]]).rings()]
        [[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, 0.0]]]
        """
        return [shapely.get_coordinates(r) for r in shapely.get_rings(shapely.orient_polygons(polygons_of(self.shape)))]

    def sample(self, rng: np.random.Generator | int, size: int) -> Array:
        """Random points, uniform over the area; over the length of segments, or points, where there is no area.

        Parameters
        ----------
        rng : numpy.random.Generator or int
            Source of randomness, or the seed of a new one. The same seed gives the same points.
        size : int
            Number of points.

        Returns
        -------
        array (size, 2)
            In the region to within rounding.

        Raises
        ------
        TypeError
            If rng is neither a Generator nor an int.
        ValueError
            If the region is empty.

        See Also
        --------
        Polytope.sample : of convex sets, in any dimension.

        Examples
        --------
        >>> x = Region.of([[0, 0], [1, 0], [0, 1]], [[5, 5]]).sample(0, 1000)
        >>> x.shape, bool((x.sum(axis=1) <= 1 + 1e-12).all())
        ((1000, 2), True)
        """
        require_kind(rng, (np.random.Generator, int, np.integer), "rng")
        rng = np.random.default_rng(rng)
        size = whole_number(size, "size", 0)
        if self.is_empty:
            raise ValueError("the region is empty; nothing can be drawn from it")
        counts = np.diff(self.simplices.starts)
        corners = self.simplices.take(np.flatnonzero(counts == counts.max())).points.reshape(-1, counts.max(), 2)
        weights = measures(corners)
        chosen = corners[rng.choice(len(corners), size, p=weights / weights.sum())]
        shares = rng.dirichlet(np.ones(corners.shape[1]), size)[:, 1:]
        return chosen[:, 0] + np.einsum("sk,skj->sj", shares, chosen[:, 1:] - chosen[:, :1])

    # -- decisions --------------------------------------------------------------------------------

    def contains(self, x: ArrayLike, tol: float = 0.0) -> Any:
        """Whether points lie in the region, its boundary included.

        Parameters
        ----------
        x : array (2,) or (N, 2)
        tol : float
            Points this close count as inside (units of x, Euclidean).

        Returns
        -------
        bool, or array (N,) of bool
            With tol = 0 decided without rounding, for the floats that x and the corners are.

        Raises
        ------
        ValueError
            If the last size of x is not 2.

        See Also
        --------
        is_subset : of a whole set.

        Examples
        --------
        >>> R = Region.of([[0, 0], [1, 0], [0, 1]])
        >>> R.contains([0.5, 0.5]), R.contains([[2, 0], [0, 0]]).tolist(), R.contains([1.1, 0], tol=0.2)
        (True, [False, True], True)
        """
        x = np.asarray(x, float)
        require_columns(x, 2, "x", "for a region lies in the plane")
        shapely.prepare(self.shape)
        points = shapely.points(x)
        found = shapely.dwithin(self.shape, points, tol) if tol else shapely.intersects(self.shape, points)
        return bool(found) if x.ndim == 1 else found

    def is_subset(self, other: Region | Polytope, tol: float = 0.0) -> bool:
        """Whether the region lies in another set, widened by the box |x|_inf <= tol.

        Parameters
        ----------
        other : Region or bounded Polytope
        tol : float
            In units of x; for a Polytope it is a share instead (`Polytope.is_subset`).

        Returns
        -------
        bool
            Decided by GEOS for the floats that the corners are. Corners that were computed are off by rounding; a small
            tol covers it.

        Raises
        ------
        ValueError
            If the other set is unbounded or does not lie in the plane.

        See Also
        --------
        equals : in both directions; contains : of points.

        Examples
        --------
        >>> R = Region.of(Polytope.box([0, 0], [1, 1]))
        >>> R.is_subset(Polytope.box([0, 0], [2, 2])), R.is_subset(Polytope.box([0, 0], [2, 0.9]), tol=0.11)
        (True, True)
        """
        other = Region(_shape(other))
        if tol:
            other = other.sum(Polytope.box([-tol, -tol], [tol, tol]))
        return self.is_empty or bool(shapely.covers(other.shape, self.shape))

    def equals(self, other: Region | Polytope, tol: float = 0.0) -> bool:
        """Whether two sets are the same: each is a subset of the other.

        Parameters
        ----------
        other : Region or bounded Polytope
        tol : float
            As in `is_subset`, for both directions.

        Returns
        -------
        bool
            Decided as in `is_subset`.

        Raises
        ------
        ValueError
            If the other set is unbounded or does not lie in the plane.

        See Also
        --------
        is_subset : one direction.

        Examples
        --------
        >>> left, right = Polytope.box([0, 0], [1, 1]), Polytope.box([1, 0], [2, 1])
        >>> Region.of(left, right).equals(Polytope.box([0, 0], [2, 1]))
        True
        """
        other = Region(_shape(other))
        return self.is_subset(other, tol) and other.is_subset(self, tol)

    # -- new regions ------------------------------------------------------------------------------

    def __or__(self, other: Region | Polytope) -> Region:
        """Union with a Region or Polytope."""
        return Region(overlay(shapely.union, self.shape, _shape(other)))

    def __and__(self, other: Region | Polytope) -> Region:
        """Intersection with a Region or Polytope."""
        return Region(overlay(shapely.intersection, self.shape, _shape(other)))

    def __sub__(self, other: Region | Polytope) -> Region:
        """Closure of what lies in this region and not in another Region or Polytope."""
        return Region(overlay(shapely.difference, self.shape, _shape(other)))

    def sum(self, D: Polytope) -> Region:
        """Minkowski sum {x + d : x in the region, d in D}, rounded to either side.

        Parameters
        ----------
        D : Polytope
            Bounded: a polygon, a segment or a point.

        Returns
        -------
        Region

        Raises
        ------
        TypeError
            If D is no Polytope.
        ValueError
            If D is empty, unbounded, or does not lie in the plane.

        See Also
        --------
        erode : the Pontryagin difference; Polytope.sum : of convex sets, rounded outward.

        Examples
        --------
        >>> Region.of([[0, 0]], [[3, 0]]).sum(Polytope.box([0, 0], [1, 2])).area
        4.0

        Notes
        -----
        With a point c of D: the region and its edges widened by D - c, moved by c. An edge widened by a
        convex set is the convex hull of its ends plus the corners of that set.
        """
        middle, corners = _about_middle(D)
        return Region(shapely.transform(self._widened(corners), lambda x: x + middle))

    def erode(self, D: Polytope) -> Region:
        """Pontryagin difference {x : x + d in the region for all d in D}, rounded to either side.

        Parameters
        ----------
        D : Polytope
            Bounded: a polygon, a segment or a point.

        Returns
        -------
        Region
            Without the parts that have no area.

        Raises
        ------
        TypeError
            If D is no Polytope.
        ValueError
            If D is empty, unbounded, or does not lie in the plane.

        See Also
        --------
        sum : the Minkowski sum; Polytope.erode : of convex sets, rounded inward.

        Examples
        --------
        >>> Region.of(Polytope.box([0, 0], [4, 2])).erode(Polytope.box([0, 0], [1, 1])).area
        3.0

        Notes
        -----
        With a point c of D, {x : x + D - c in S} is S without those points from which some point of
        D - c leads across the boundary of S; then all is moved by -c. No frame around S is needed.
        """
        middle, corners = _about_middle(D)
        kept = shapely.union_all(polygons_of(self.shape))
        kept = overlay(shapely.difference, kept, overlay(shapely.union_all, widened_edges(kept, -corners)))
        return Region(shapely.transform(shapely.union_all(polygons_of(kept)), lambda x: x - middle))

    def map(self, M: ArrayLike, t: ArrayLike | None = None) -> Region:
        """Affine image {M x + t : x in the region}, corners rounded to either side.

        Parameters
        ----------
        M : array (2, 2)
            Of any rank.
        t : array (2,), optional
            0 if left out.

        Returns
        -------
        Region

        Raises
        ------
        ValueError
            If the sizes of M and t do not match.

        See Also
        --------
        scale : about a centre; Polytope.map : of convex sets, in any dimension.

        Examples
        --------
        >>> turned = Region.of(Polytope.box([0, 0], [2, 1])).map([[0, -1], [1, 0]])
        >>> turned.equals(Polytope.box([-1, 0], [0, 2]))
        True

        Notes
        -----
        The union of the images of the `simplices`.
        """
        M, t = real_array(M, "M", 2), np.zeros(2) if t is None else real_array(t, "t", 1)
        if M.shape != (2, 2) or t.shape != (2,):
            raise ValueError(f"M and t have shapes {M.shape} and {t.shape}, but a region needs (2, 2) and (2,)")
        images = Polygons(self.simplices.points @ M.T + t, self.simplices.starts)
        return Region(overlay(shapely.union_all, hulls(images)))

    def scale(self, s: float, centre: ArrayLike = 0) -> Region:
        """c + s (S - c), corners rounded to either side.

        Parameters
        ----------
        s : float
            Positive.
        centre : array (2,) or number
            The point c that stays where it is.

        Returns
        -------
        Region

        Raises
        ------
        ValueError
            If s is not positive, or centre has another size.

        See Also
        --------
        map : any affine map.

        Examples
        --------
        >>> Region.of(Polytope.box([0, 0], [2, 2])).scale(0.5, [2, 2]).bounding_box()
        (array([1., 1.]), array([2., 2.]))
        """
        s, c = positive_number(s, "s"), real_array(centre, "centre", np.ndim(centre))
        if c.shape not in ((), (2,)):
            raise ValueError(f"centre has shape {c.shape}, but a region lies in the plane")
        return self.map(s * np.eye(2), (1 - s) * np.broadcast_to(c, 2))

    def _widened(self, corners: Array) -> Shape:
        """The sum with the hull of `corners` (k, 2), which holds 0, as a shapely geometry."""
        if len(corners) == 1 or self.is_empty:
            return self.shape
        return overlay(shapely.union_all, [self.shape, *widened_edges(self.shape, corners)])


# -- parts --------------------------------------------------------------------------------------------


def _shape(part: Region | Polytope | ArrayLike) -> Shape:
    """The shapely geometry of a Region, a bounded Polytope, or the corners of a convex polygon."""
    if isinstance(part, Region):
        return part.shape
    if isinstance(part, Polytope):
        if part.dimension != 2:
            raise ValueError(f"the polytope lies in R^{part.dimension}, but regions lie in the plane")
        part = part.vertices()
    corners = real_array(part, "the corners of a piece", 2)
    require_columns(corners, 2, "the corners of a piece", "for a region lies in the plane")
    require_size(corners)
    return shapely.convex_hull(shapely.multipoints(corners)) if len(corners) else shapely.Polygon()


def _about_middle(D: Polytope) -> tuple[Array, Array]:
    """A point (2,) of D, and the corners (k, 2) of D as seen from it."""
    require_kind(D, Polytope, "D")
    if D.dimension != 2 or D.is_empty:
        raise ValueError(f"D must be a nonempty polytope of the plane; got {D!r}")
    corners = D.vertices()
    middle = corners.mean(axis=0) if len(corners) > 1 else corners[0]
    return middle, corners - middle
