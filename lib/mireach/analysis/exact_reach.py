"""Exact, nonconvex reachable sets for two states, without templates, and the attractor to which they converge."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import shapely
from shapely.errors import GEOSException

from ..checks import require_kind, whole_number
from ..errors import RegionError
from ..results import Result
from ..sets.geos import Shape, Shapes, hulls, overlay
from ..sets.polygons import Polygons
from ..sets.polytope import Polytope
from ..sets.region import Region
from ..systems.loop import ClosedLoop
from ..tolerances import CLOSING
from ..typing import Array, ArrayLike, IntArray
from .maximal_set import MaximalSafeSet
from .plane import PlanarLoop, normals, per_axis
from .safe_set import SafeSet

GRIDS = 2.0 ** np.array([-5, -4, -3])  # of the corners of a union, relative to the margin; the next one if GEOS fails
FEWER = 0.75  # share of the margin by which the boundary may move inward again when corners are removed
MORE = 8  # factor from one margin to the next if a set has too many corners
MOST_CORNERS = 300  # of a set of the attractor, beyond which it is widened more
MOST_PARTS = 100_000  # that the image of a set may fall into


@dataclass(frozen=True, eq=False)
class Attractor(Result):
    """Result of `attractor`.

    Attributes
    ----------
    set : Region
        An outer approximation of R_k(S) with k = `steps`. Every trajectory from S is in it from step k on.
    steps : int
        k of `set`.
    history : list of Region
        S, and outer approximations of R_1(S), ..., R_k(S), and of R_(k+1)(S), which was used to test the stopping rule.
        Each set contains the image of the one before it.
    settled : bool
        Whether no point of R_k is farther than `tolerance` from R_(k+1).
    tolerance : float or array (2,)
        As given (units of x).
    added : array (2,)
        Upper bound on the sum of the enlargements of all steps (units of x). In every step the image was enlarged by a
        box; the half-widths of these boxes sum up to at most this value.
    """

    set: Region
    steps: int
    history: list[Region]
    settled: bool
    tolerance: float | Array
    added: Array

    def __str__(self) -> str:
        state = "settled" if self.settled else "not settled"
        return f"attractor: {state}; area {self.set.area:.6g}, {self.steps} steps"


def exact_reach(loop: ClosedLoop, F: Polytope | Region, steps: int) -> list[Region]:
    """The exact reachable sets R_0(F) = F & X, R_1(F), ..., R_k(F) for k = `steps`, without a template.

    Parameters
    ----------
    loop : ClosedLoop
        With two states.
    F : Polytope or Region
        May also be a point or a segment.
    steps : int
        At least 0.

    Returns
    -------
    list of steps + 1 Region
        Exact up to rounding: at every step, images with an area are enlarged by up to 3e-11 of the size of X and its
        image, so that no gaps open between them. Only the part within X has successors. The sets are not proven.

    Raises
    ------
    TypeError
        If `loop` is no ClosedLoop, or F neither a Polytope nor a Region.
    ValueError
        If the loop has not two states, Phi leaves U, F lies in another space, or `steps` is out of range.
    RegionError
        If a set falls into too many parts to go on, or GEOS fails.

    See Also
    --------
    outer_reach : encloses the sets by a template, in any dimension; attractor : the set to which they converge.

    Examples
    --------
    >>> import mireach as mr
    >>> loop = mr.case_study("pwa").loop
    >>> sets = mr.exact_reach(loop, mr.Polytope.box([-1, -1], [1, 1]), 2)
    >>> [R.contains([0.0, 0.0]) for R in sets]
    [True, True, True]
    """
    require_kind(F, (Region, Polytope), "F")
    steps = whole_number(steps, "steps", 0)
    plane = PlanarLoop.of(loop)
    advice = "take fewer steps, start from a smaller F, or cover the sets by a template (outer_reach)"
    with _named_failures(advice):
        sets = [plane.start(F)]
        for _ in range(steps):
            sets.append(Region(_closed(_images(plane, sets[-1]), CLOSING * plane.size, flat=True)))
    return [plane.in_user_units(R) for R in sets]


def attractor(
    loop: ClosedLoop,
    safe: MaximalSafeSet | SafeSet | Region | Polytope,
    *,
    tolerance: ArrayLike = 1e-3,
    max_steps: int = 500,
) -> Attractor:
    """A small set that all trajectories from a safe set S enter: R_k(S) with k at which the sequence hardly changes.

    Parameters
    ----------
    loop : ClosedLoop
        With two states.
    safe : MaximalSafeSet, SafeSet, Region or Polytope
        An RPI set S. The sequence R_k(S) is then nested.
    tolerance : float or array (2,)
        The sequence has settled when no point of R_k is farther than this from R_(k+1) along any axis (units of x). If
        the states have different units, give one number per state. The rule concerns one step only: over many later
        steps the sets may shrink by more than this.
    max_steps : int
        The sequence ends after this many steps, settled or not.

    Returns
    -------
    Attractor

    Raises
    ------
    TypeError
        If `loop` is no ClosedLoop, or `safe` of another kind than those above.
    ValueError
        If `safe` holds no set, the loop has not two states, Phi leaves U, or an argument is out of range.
    RegionError
        If a set falls into too many parts to go on, or GEOS fails.

    See Also
    --------
    maximal_safe_set : a set to start from; terminal_set : the proven counterpart with a template.

    Examples
    --------
    >>> import mireach as mr
    >>> loop = mr.case_study("pwa").loop
    >>> safe = mr.maximal_safe_set(loop, prove=False)
    >>> found = mr.attractor(loop, safe, tolerance=0.5)
    >>> found.settled, found.set.is_subset(safe.set, tol=1e-6)
    (True, True)

    Notes
    -----
    The number of corners of R_k may grow without bound. Every image is therefore enlarged by a box, and corners within
    this margin are then removed, so that each set contains the image of the one before it. This is checked in floats
    with a margin that covers their rounding. The half-width is at first 1.5e-11 of the size of X and its image. It
    grows, up to an eighth of the tolerance, if a set would have more than 300 corners. `added` bounds the sum of the
    enlargements.
    """
    by_axis = per_axis(tolerance, 2, "tolerance")
    max_steps = whole_number(max_steps, "max_steps", 1)
    S: Region | Polytope | None
    if isinstance(safe, (MaximalSafeSet, SafeSet)):
        S = safe.set
        if S is None:
            raise ValueError(f"there is no safe set to start from: {safe.reason}")
    else:
        S = safe
    require_kind(S, (Region, Polytope), "safe")
    plane = PlanarLoop.of(loop)
    margin = by_axis / plane.units.state
    box = Polytope.box(-margin, margin)
    least = CLOSING * plane.size
    most = max(least, margin.min() / 8)
    widening = least
    added, settled = 0.0, False
    with _named_failures("try a larger tolerance, or start from a smaller set"):
        history = [plane.start(S)]
        while not settled and len(history) <= max_steps:
            images = _images(plane, history[-1])
            following = _closed(images, widening)
            while len(shapely.get_coordinates(following)) > MOST_CORNERS and widening < most:
                widening = min(MORE * widening, most)
                following = _closed(images, widening)
            history.append(Region(following))
            added += 2 * widening
            if len(shapely.get_coordinates(following)) < MOST_CORNERS / 2:
                widening = max(widening / MORE, least)
            settled = history[-2].is_subset(history[-1].sum(box))
    history = [plane.in_user_units(R) for R in history]
    kept = by_axis if np.ndim(tolerance) else float(by_axis[0])
    return Attractor(history[-2], len(history) - 2, history, settled, kept, added * plane.units.state)


@contextmanager
def _named_failures(advice: str) -> Iterator[None]:
    """Turn an exception of GEOS into a RegionError that says what to do."""
    try:
        yield
    except GEOSException as error:
        raise RegionError(f"GEOS finds no answer for a set of that many corners ({error}); {advice}") from error
    except _TooManyParts as error:
        raise RegionError(f"{error}; {advice}") from error


class _TooManyParts(Exception):
    """An image falls into more than `MOST_PARTS` parts."""


# -- one step -----------------------------------------------------------------------------------------


def _images(plane: PlanarLoop, R: Region) -> Polygons:
    """The images of all parts of cells within R, each enlarged by the D of its mode: Polygons.

    A cell that lies in R is used as a whole.
    """
    cells = plane.polygons
    shapely.prepare(R.shape)
    whole = shapely.covers(R.shape, plane.shapes)
    which = np.flatnonzero(whole)
    batches: list[tuple[Polygons, IntArray]] = [(cells.take(which), which)]
    cut = np.flatnonzero(~whole & shapely.dwithin(R.shape, plane.shapes, 2 * plane.touch))
    if len(cut):
        batches.append(_parts(plane, cut, R.simplices))
    images = []
    for part, which in batches:
        image = Polygons(plane.dynamics.images(part.points, which[part.owner]), part.starts)
        for D, own in plane.disturbances:
            chosen, corners = image.take(np.flatnonzero(own[which])), D.vertices()
            points = (chosen.points[:, None] + corners).reshape(-1, 2)
            images.append(Polygons(points, chosen.starts * len(corners)))
    return Polygons.join(images)


def _parts(plane: PlanarLoop, chosen: IntArray, pieces: Polygons) -> tuple[Polygons, IntArray]:
    """The parts of chosen cells within pieces: Polygons, and the index of the cell of each part."""
    cells, touch = plane.polygons.take(chosen), plane.touch
    starts, ends = pieces.least(pieces.points) - touch, pieces.largest(pieces.points) + touch
    near = (cells.least(cells.points)[:, None] <= ends).all(axis=2)
    near &= (cells.largest(cells.points)[:, None] >= starts).all(axis=2)
    if near.sum() > MOST_PARTS:
        raise _TooManyParts(f"the image of a set falls into more than {MOST_PARTS} parts")
    which, piece = np.nonzero(near)
    A, b = _sides(pieces)
    part = cells.take(which)
    for row in range(A.shape[1]):
        part, left = part.clip(A[piece, row], b[piece, row], touch)
        which, piece = which[left], piece[left]
    return part, chosen[which]


def _closed(polygons: Polygons, widening: float, flat: bool = False) -> Shape:
    """A shapely geometry that contains polygons, each enlarged by a box, and lies within twice that margin of them.

    Enlarged polygons overlap where they share an edge, so that no gaps remain. A corner is removed if it lies closer
    than `FEWER` times the margin to the boundary without it. With `flat`, polygons without area are not enlarged where
    they lie outside the other polygons.
    """
    if not len(polygons):
        return shapely.Polygon()
    shapes, lines = hulls(polygons), np.zeros(0, object)
    if flat:
        solid = shapely.get_dimensions(shapes) == 2
        lines, shapes = shapes[~solid], shapes[solid]
        polygons = polygons.take(np.flatnonzero(solid))
    wide = hulls(polygons, widening)
    found = _union_of_wide(wide, shapes, widening) if len(wide) else shapely.Polygon()
    if len(lines):
        shapely.prepare(found)
        lines = lines[~shapely.covers(found, lines)]
        found = overlay(shapely.union_all, [found, *lines]) if len(lines) else found
    return found


def _union_of_wide(wide: Shapes, shapes: Shapes, widening: float) -> Shape:
    """The union of enlarged polygons with fewer corners; it contains `shapes`, the original polygons."""
    failure: object = "corners lie too close together"
    for grid in GRIDS * widening:
        try:
            union = shapely.union_all(wide, grid_size=2.0 ** np.floor(np.log2(grid)))
            for moved in (FEWER, FEWER / 8, 0.0):
                found = shapely.simplify(union, moved * widening) if moved else union
                shapely.prepare(found)
                if shapely.is_valid(found) and shapely.covers(found, shapes).all():
                    return found
        except GEOSException as error:
            failure = error
    raise GEOSException(f"no union holds the parts of an image: {failure}")


def _sides(pieces: Polygons) -> tuple[Array, Array]:
    """Half-planes A (N, 7, 2), b (N, 7) whose intersections are triangles, segments and points.

    Four of them are the bounding box, because a side of a very thin triangle may have no direction.
    """
    A = np.empty((len(pieces), 7, 2))
    A[:, 3:] = np.vstack([np.eye(2), -np.eye(2)])
    for i in range(len(pieces)):
        x = pieces[i]
        if len(x) == 3:
            A[i, :3] = normals(x[None])[0]
        else:
            along = x[-1] - x[0]
            across = np.array([-along[1], along[0]]) / max(np.linalg.norm(along), np.finfo(float).tiny)
            A[i, :3] = across, -across, across
    return A, pieces.largest(np.einsum("trj,tj->tr", A[pieces.owner], pieces.points))
