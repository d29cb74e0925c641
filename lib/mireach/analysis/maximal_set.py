"""The maximal RPI set of a loop with two states, by a backward iteration, and its proof in rational arithmetic.

Forward images are nonconvex. A template encloses them in convex sets, and this over-approximation is propagated by
every further step. The backward iteration needs no template: a state is lost if some disturbance leads it to a lost
state, and the lost part of a cell is a union of convex polygons.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from shapely.errors import GEOSException

from ..arithmetic.scaling import times
from ..checks import positive_number, require_bools, require_kind, whole_number
from ..engines import exact_plane
from ..engines.base import EXACT, Witness, witness_of
from ..engines.units import Units
from ..errors import CellLimitError, RegionError
from ..results import Result, Verdict
from ..sets.geos import Shape, Shapes, hulls, overlay
from ..sets.polygons import Polygons
from ..sets.polytope import Polytope
from ..sets.region import Region
from ..systems.loop import ClosedLoop
from ..tolerances import LEAST_SLACK, SLACK
from ..typing import Array, IntArray
from .plane import PlanarLoop, normals, square

MOST_ITERATIONS = 500  # default of `max_iterations`
MOST_TRIANGLES = 1_000  # of an S_k; beyond it a larger slack is tried, with which the iteration ends sooner
MOST_LOST = 10_000  # the same for sets that are not proven afterwards
COARSER = 4  # powers of 10 by which the slack may grow
STEEP = 0.2  # rows of a region that change with x more slowly than this (relative to their length) are inaccurate
ROUNDING = 1e-3  # share of the slack that covers the rounding of one operation
NO_SHAPES: Shapes = np.zeros(0, object)
FLOATS = "floating point"  # what a result rests on that `slack` protects from rounding errors, but that is not proven


@dataclass(frozen=True, eq=False)
class RegionCheck(Result):
    """Result of `prove_rpi`.

    Attributes
    ----------
    verdict : Verdict
    witness : Witness or None
        A step out of the region, where the verdict is "refuted"; the state alone, if it has no successor. Its floats
        are rounded; `witness.exact` is the step in fractions.
    reason : str
        What was shown, or why nothing was shown.
    settled : str
        What the verdict rests on: "exact arithmetic"; empty where it is "unknown".
    """

    verdict: Verdict
    witness: Witness | None
    reason: str
    settled: str = ""

    def __str__(self) -> str:
        return f"RPI region: {self.verdict}; {self.reason}"


@dataclass(frozen=True, eq=False)
class MaximalSafeSet(Result):
    """Result of `maximal_safe_set`: `set` lies in the maximal RPI set in X, and that lies in `outer`.

    Attributes
    ----------
    set : Region or None
        An RPI set, shown in the figures as the maximal set. None if none was found.
    outer : Region
        Every state outside of it can be driven out of X.
    iterations : int
        The k with S_k = `set`.
    history : list of Region
        S_0, S_1, ..., S_k, of the iteration that led to `set`.
    verdict : Verdict
        "proven": `set` is RPI, in rational arithmetic. "refuted": X contains no RPI set at all, since `outer` is empty.
    reason : str
        What was shown, and which values of the slack failed before.
    slack : float
        The slack with which `set` was found, as the argument of `maximal_safe_set`.
    settled : str
        What the verdict rests on: "exact arithmetic" where it is "proven", "floating point" where it is "refuted"
        (with the margin `slack`), empty where it is "unknown".
    """

    set: Region | None
    outer: Region
    iterations: int
    history: list[Region]
    verdict: Verdict
    reason: str
    slack: float
    settled: str = ""

    def __str__(self) -> str:
        if self.set is None:
            return f"maximal safe set: {self.verdict}, none found; {self.reason}"
        figures = f"area {self.set.area:.6g}, {self.iterations} iterations, slack {self.slack:g}"
        return f"maximal safe set: {self.verdict}; {figures}"

    @property
    def given_up(self) -> float:
        """Share of the area of `outer` outside `set`: an upper bound on the part of the maximal set outside it."""
        own = 0.0 if self.set is None else self.set.area
        return (self.outer.area - own) / self.outer.area if self.outer.area else 0.0


def maximal_safe_set(
    loop: ClosedLoop, *, slack: float = SLACK, max_iterations: int = MOST_ITERATIONS, prove: bool = True
) -> MaximalSafeSet:
    """The maximal RPI set in X: S_0 = X, S_(k+1) = S_k without the states that some d in D can drive out of S_k.

    Parameters
    ----------
    loop : ClosedLoop
        With two states. Modes may depend on u and differ in D; the loop may be discontinuous.
    slack : float
        Half-width of the box by which disturbance sets and lost parts are enlarged. It is relative to the largest
        coordinate of X, its image and the disturbance sets, in units in which the largest |x_i| over X lies between 1/2
        and 1 for each i. It must exceed the rounding errors of GEOS, and should be so small that the lost area is
        negligible. At least 1e-11.
    max_iterations : int
        Largest k.
    prove : bool
        Whether to prove the set in rational arithmetic. Without a proof the verdict is "unknown" or "refuted".

    Returns
    -------
    MaximalSafeSet

    Raises
    ------
    TypeError
        If `loop` is no ClosedLoop.
    ValueError
        If the loop has not two states, Phi leaves U, or an argument is out of range.

    See Also
    --------
    safe_set : the largest one with a template, in any dimension; prove_rpi : the proof alone;
    carried_out : one step of the iteration; largest_disturbance : the largest disturbance with such a set.

    Examples
    --------
    >>> import mireach as mr
    >>> zero, X, U = mr.Polytope.box([0, 0], [0, 0]), mr.Polytope.box([-1, -1], [1, 1]), mr.Polytope.box([-1], [1])
    >>> mode = mr.Mode([[0, 1.5], [0.5, 0]], [[0], [0]], [0, 0], X.product(U), zero)
    >>> loop = mr.ClosedLoop(mr.PWASystem([mode], X, U), mr.MaxoutNetwork((), [[0.0, 0.0]], [0.0]))
    >>> found = mr.maximal_safe_set(loop)  # x1+ = 1.5 x2, x2+ = x1 / 2
    >>> print(found)
    maximal safe set: proven; area 2.66667, 1 iterations, slack 1e-09
    >>> found.set.contains([[1.0, 0.6], [1.0, 0.7]]).tolist()
    [True, False]

    Notes
    -----
    What is proven: `set` is RPI. `prove_rpi` shows this without rounding and without any of the code below. If the
    proof fails, or S_k has too many corners, slacks up to 10^4 times as large are tried, and finally a slack of 0,
    which suits sets that are RPI without any margin. `slack`, `reason` and `given_up` report this.

    What rests on floats: `outer` contains every RPI set, so X contains none if `outer` is empty. For `outer` the
    iteration removes only states that are lost with a margin: lost sets are shrunk by the slack before their preimages
    are computed, and the result is enlarged by the slack. The slack is thousands of times as large as the rounding
    error of one operation, but it is not proven that no rounding error exceeds it. If (x, Phi(x)) lies on, or very
    close to, a boundary of regions that involve u for all states of a cell, floats do not determine which mode acts;
    then `outer` is X.

    On a boundary of regions every mode counts. A single line may therefore be lost; with the slack a thin strip around
    it is removed. The maximal set itself need not be closed; `set` and `outer` are closed.
    """
    require_bools(prove=prove)
    slack = positive_number(slack, "slack")
    max_iterations = whole_number(max_iterations, "max_iterations", 1)
    if slack < LEAST_SLACK:
        raise ValueError(f"slack must be at least {LEAST_SLACK:g}, above the rounding of GEOS; got {slack:g}")
    plane = PlanarLoop.of(loop)
    found = _maximal(plane, slack, max_iterations, prove)
    own = None if found.set is None else plane.in_user_units(found.set)
    history = [own if own is not None and S is found.set else plane.in_user_units(S) for S in found.history]
    return replace(found, set=own, outer=plane.in_user_units(found.outer), history=history)


def _maximal(plane: PlanarLoop, slack: float, max_iterations: int, prove: bool) -> MaximalSafeSet:
    """`maximal_safe_set` in the loop's own units."""
    outer = _outer(plane, slack, max_iterations)
    if outer.is_empty:
        reason = "X holds no RPI set: every state of it can be driven out of it"
        return MaximalSafeSet(None, outer, 0, [Region.of(plane.state_set)], Verdict.REFUTED, reason, slack, FLOATS)
    failures = []
    for tried in (*(slack * 10.0**power for power in range(COARSER + 1)), 0.0):
        history, unfinished = _shrink(plane, tried * plane.size, max_iterations)
        if unfinished or history[-1].is_empty:
            failures.append(f"with slack {tried:g} {unfinished or 'nothing is left'}")
            continue
        if history[-1].area > outer.area:
            failures.append(f"with slack {tried:g} only rounding is left")
            continue
        found = history[-1], outer, len(history) - 1, history
        if not prove:
            reason = "; ".join([*failures, "not proven, for prove = False"])
            return MaximalSafeSet(*found, Verdict.UNKNOWN, reason, tried)
        check = _check(plane.units, history[-1].pieces)
        if check.verdict == Verdict.PROVEN:
            return MaximalSafeSet(*found, Verdict.PROVEN, "; ".join([*failures, check.reason]), tried, check.settled)
        failures.append(f"with slack {tried:g} {check.reason}")
    return MaximalSafeSet(None, outer, len(history) - 1, history, Verdict.UNKNOWN, "; ".join(failures), tried)


def _outer(plane: PlanarLoop, slack: float, max_iterations: int) -> Region:
    """A region in own units that contains every RPI set: states outside of it are lost by more than the slack."""
    margin = slack * plane.size
    outer = _shrink(plane, -margin, max_iterations, MOST_LOST)[0][-1]
    outer = outer.sum(square(margin)) & plane.state_set if not outer.is_empty else outer
    return Region.of(plane.state_set) if _mode_in_doubt(plane) else outer


def limit_within(
    loop: ClosedLoop, slack: float, start: Region | None = None, met: Sequence[Polytope] = ()
) -> Region | None:
    """The last set of the iteration of `maximal_safe_set` if it starts from a set within X; in the loop's own units.

    Parameters
    ----------
    loop : ClosedLoop
    slack : float
        Half-width of a box in own units; the default of `maximal_safe_set` where that is larger.
    start : Region or None
        In own units; None is X.
    met : sequence of Polytope
        Sets in the units of the user that every RPI set meets.

    Returns
    -------
    Region or None
        None if nothing is left, or less than meets all of `met`, or the iteration does not end.

    Raises
    ------
    ValueError
        If the loop has not two states, or Phi leaves U.
    """
    plane = PlanarLoop.of(loop)
    own = hulls(Polygons.of([plane.units.polytope(F).vertices() for F in met]))
    history, unfinished = _shrink(plane, max(slack, SLACK * plane.size), MOST_ITERATIONS, MOST_LOST, start, own)
    return None if unfinished or history[-1].is_empty else history[-1]


def carried_out(loop: ClosedLoop, S: Region | Polytope) -> Region:
    """The states of X that some disturbance drives out of S in one step: one iteration, without slack.

    Parameters
    ----------
    loop : ClosedLoop
        With two states.
    S : Region or Polytope
        In the plane.

    Returns
    -------
    Region
        Its closure; parts without area are left out.

    Raises
    ------
    TypeError
        If `loop` is no ClosedLoop, or S neither a Region nor a Polytope.
    ValueError
        If the loop has not two states, Phi leaves U, or S lies in another space.
    RegionError
        If GEOS fails.

    See Also
    --------
    maximal_safe_set : the limit of these steps.

    Examples
    --------
    >>> import mireach as mr
    >>> zero, X, U = mr.Polytope.box([0, 0], [0, 0]), mr.Polytope.box([-1, -1], [1, 1]), mr.Polytope.box([-1], [1])
    >>> mode = mr.Mode([[0, 1.5], [0.5, 0]], [[0], [0]], [0, 0], X.product(U), zero)
    >>> loop = mr.ClosedLoop(mr.PWASystem([mode], X, U), mr.MaxoutNetwork((), [[0.0, 0.0]], [0.0]))
    >>> carried_out(loop, X).contains([[0.0, 0.6], [0.0, 0.7]]).tolist()  # x1+ = 1.5 x2, x2+ = x1 / 2
    [False, True]
    """
    require_kind(S, (Region, Polytope), "S")
    plane = PlanarLoop.of(loop)
    X = Region.of(plane.state_set)
    lost = []
    try:
        start = plane.start(S)
        targets = _triangles(X - start)
        for D, own in plane.disturbances:
            chosen = np.flatnonzero(own)
            lost += [_lost_outside(plane, chosen, D, 0.0), _lost_into(plane, chosen, D, targets, 0.0)]
        return plane.in_user_units(Region(_union(lost, X, 0.0)))
    except GEOSException as error:
        raise RegionError(f"GEOS fails on the states that are lost ({error}); try an S with fewer corners") from error


def prove_rpi(loop: ClosedLoop, region: Region | Polytope) -> RegionCheck:
    """Whether a region is RPI, in rational arithmetic.

    Parameters
    ----------
    loop : ClosedLoop
        With two states.
    region : Region or Polytope
        Not empty. The proof is about the union of its `pieces`, whose corners are exactly the stored floats.

    Returns
    -------
    RegionCheck
        The verdict is "unknown" only if an image falls into too many parts.

    Raises
    ------
    TypeError
        If `loop` is no ClosedLoop, or `region` neither a Region nor a Polytope.
    ValueError
        If the region is empty, the loop has not two states, or Phi leaves U.

    See Also
    --------
    check_rpi : the same for a Polytope, in any dimension, with every engine; maximal_safe_set : finds such a region.

    Examples
    --------
    >>> import mireach as mr
    >>> zero, X, U = mr.Polytope.box([0, 0], [0, 0]), mr.Polytope.box([-1, -1], [1, 1]), mr.Polytope.box([-1], [1])
    >>> mode = mr.Mode([[0, 1.5], [0.5, 0]], [[0], [0]], [0, 0], X.product(U), zero)
    >>> loop = mr.ClosedLoop(mr.PWASystem([mode], X, U), mr.MaxoutNetwork((), [[0.0, 0.0]], [0.0]))
    >>> print(mr.prove_rpi(loop, mr.Polytope.box([-1, -0.5], [1, 0.5])))  # x1+ = 1.5 x2, x2+ = x1 / 2
    RPI region: proven; no step leaves the 1 pieces of the region, in rational arithmetic
    >>> mr.prove_rpi(loop, X).verdict == "refuted"
    True

    Notes
    -----
    For every cell of the loop and every piece of the region, the image of their intersection, enlarged by D^(i), minus
    the pieces of the region must be empty (`engines.exact_plane.first_escape`). The proof does not depend on GEOS or on
    the float cells. It depends on python-flint, `sets/exact_polytopes.py`, `engines/exact_cells.py` and
    `engines/exact_plane.py`.
    """
    require_kind(region, (Region, Polytope), "region")
    units = PlanarLoop.of(loop).units
    region = Region.of(region) if isinstance(region, Polytope) else region
    if region.is_empty:
        raise ValueError("the region is empty; there is nothing to prove")
    pieces = region.pieces
    return _check(units, Polygons(times(pieces.points, 1 / units.state), pieces.starts))


def _check(units: Units, pieces: Polygons) -> RegionCheck:
    """`prove_rpi` of pieces in the loop's own units; the witness is in the units of the user."""
    try:
        escape = exact_plane.first_escape(units.loop, [pieces[i] for i in range(len(pieces))])
    except (ArithmeticError, CellLimitError) as error:
        return RegionCheck(Verdict.UNKNOWN, None, str(error))
    if escape is not None:
        witness = units.witness(witness_of(units.loop, escape))
        return RegionCheck(Verdict.REFUTED, witness, f"a step leaves the region: {units.escape(escape)}", EXACT)
    reason = f"no step leaves the {len(pieces)} pieces of the region, in rational arithmetic"
    return RegionCheck(Verdict.PROVEN, None, reason, EXACT)


def _mode_in_doubt(plane: PlanarLoop) -> bool:
    """Whether some cell touches a row of its mode's region whose value hardly changes with x on the cell.

    The float cells of such a mode may exceed the region by more than the slack, or exist although the mode never acts.
    """
    found, near = plane.dynamics.cells, SLACK * plane.size
    domain = plane.state_set.product(plane.loop.system.input_set)
    for number, mode in enumerate(plane.loop.system.modes):
        own = np.flatnonzero(found.mode == number)
        part = found.polygons.take(own)
        for row, offset in zip(mode.region.H, mode.region.h):
            if not row[2:].any() or not len(own):
                continue
            if domain.support(row[None])[0] - offset <= near * np.linalg.norm(row):  # such as a limit of U itself
                continue
            a, b = row[:2] + row[2:] @ found.K[own], offset - found.g[own] @ row[2:]
            flat = np.linalg.norm(a, axis=1) < STEEP * np.linalg.norm(row)
            nearest = part.largest(np.einsum("ti,ti->t", part.points, a[part.owner]) - b[part.owner])
            if (flat & (nearest > -near * np.linalg.norm(row))).any():
                return True
    return False


# -- backwards ----------------------------------------------------------------------------------------


def _shrink(
    plane: PlanarLoop,
    slack: float,
    max_iterations: int,
    most_triangles: int = MOST_TRIANGLES,
    start: Region | None = None,
    met: Shapes = NO_SHAPES,
) -> tuple[list[Region], str]:
    """S_0 = `start` or X, S_1, ..., and why the last of them is not the end of the sequence ("" if it is).

    A set that does not meet all of `met`, which every RPI set meets, is replaced by the empty one.

    `slack` (own units of x) is positive for an inner approximation of the maximal set: D and the lost sets are enlarged
    by it. It is negative for an outer approximation: a state counts as lost only if it is lost by more than the slack.
    With 0 there is no margin.
    """
    history = [Region.of(_inset(plane.state_set, max(slack, 0.0))) if start is None else start]
    try:
        return history, _shrunk(plane, slack, max_iterations, most_triangles, history, start is not None, met)
    except GEOSException as error:  # the sets found before remain valid
        return history, f"GEOS fails on S_{len(history)} ({error})"


def _shrunk(
    plane: PlanarLoop,
    slack: float,
    max_iterations: int,
    most_triangles: int,
    history: list[Region],
    smaller: bool,
    met: Shapes,
) -> str:
    """Append S_1, S_2, ... to [S_0]; why the last of them is not the end of the sequence ("" if it is).

    `smaller` says that S_0 is not all of X, so that what is carried into the rest of X is lost as well.
    """
    lost = [_lost_outside(plane, np.flatnonzero(own), D, slack) for D, own in plane.disturbances]
    S, box = history[0], plane.state_set.bounding_box()
    if smaller:
        rest = _triangles(Region.of(plane.state_set) - S)
        lost += [_lost_into(plane, np.flatnonzero(own), D, rest, slack) for D, own in plane.disturbances]
    for _ in range(max_iterations):
        gone = _union(lost, S, slack)
        following = Region(_within(_with_area(overlay(shapely.difference, S.shape, gone)), *box))
        fresh = Region(_with_area(overlay(shapely.intersection, S.shape, gone)))
        if _is_thin(fresh, S, abs(slack)):
            if fresh.area:
                history.append(following)
            return ""
        if not shapely.intersects(following.shape, met).all():
            following = Region(shapely.Polygon())
        history.append(following)
        if following.is_empty:
            return ""
        if _triangle_count(following.shape) > most_triangles:
            return f"S_{len(history) - 1} has more than {most_triangles} triangles"
        if slack < 0:
            fresh = S.sum(square(-slack)) - following.sum(square(-slack))
        targets = _triangles(fresh)
        shapely.prepare(following.shape)
        alive = shapely.dwithin(following.shape, plane.shapes, abs(slack))
        lost = [
            _lost_into(plane, np.flatnonzero(own & alive), D, targets, max(slack, 0.0)) for D, own in plane.disturbances
        ]
        S = following
    return f"max_iterations = {max_iterations} came first"


def _lost_outside(plane: PlanarLoop, chosen: IntArray, D: Polytope, slack: float) -> Polygons:
    """The parts of the chosen cells that D can drive out of X: Polygons."""
    X, every = plane.state_set, plane.dynamics
    polygons, found = plane.polygons.take(chosen), []
    limits = X.h - D.support(X.H) - slack * np.abs(X.H).sum(axis=1)
    for a, limit in zip(X.H, limits):
        found.append(polygons.clip(-a @ every.M[chosen], every.c[chosen] @ a - limit, 0.0)[0])
    return Polygons.join(found)


def _lost_into(plane: PlanarLoop, chosen: IntArray, D: Polytope, targets: Array, slack: float) -> Polygons:
    """The parts of the chosen cells that D, enlarged by a box of half-width `slack`, can drive into triangles.

    M x + c + d lies in the triangle T for some d exactly if M x + c lies in T + (-D), whose sides have the normals
    of T and of -D.
    """
    every, cells = plane.dynamics, plane.polygons.take(chosen)
    images, (low, high) = every.images(cells.points, chosen[cells.owner]), D.bounding_box()
    starts, ends = targets.min(axis=1) - high - slack, targets.max(axis=1) - low + slack
    near = (cells.least(images)[:, None] <= ends).all(axis=2) & (cells.largest(images)[:, None] >= starts).all(axis=2)
    which, target = np.nonzero(near)
    own, corners = normals(targets), D.vertices()
    others = np.unique(np.vstack([np.eye(2), -np.eye(2), -D.H[(D.H != 0).any(axis=1)]]) + 0.0, axis=0)
    A = np.concatenate([own, np.broadcast_to(others, (len(targets), *others.shape))], axis=1)
    b = np.einsum("trj,tvj->trv", A, targets).max(axis=2) + (-A @ corners.T).max(axis=2)
    b += slack * np.abs(A).sum(axis=2)
    part, kept = cells.take(which), np.arange(len(which))
    for row in range(A.shape[1]):
        cell, a = chosen[which[kept]], A[target[kept], row]
        limit = b[target[kept], row] - np.einsum("pi,pi->p", a, every.c[cell])
        part, left = part.clip(np.einsum("pi,pij->pj", a, every.M[cell]), limit, 0.0)
        kept = kept[left]
    return part


def _union(lost: list[Polygons], S: Region, slack: float) -> Shape:
    """The union of those lost polygons that meet S; polygons without area count only for an inner approximation."""
    polygons = Polygons.join(lost)
    if slack <= 0:
        polygons = polygons.take(np.flatnonzero(shapely.get_dimensions(hulls(polygons)) == 2))
    shapes = hulls(polygons, slack if slack > 0 else -ROUNDING * slack)
    shapely.prepare(S.shape)
    return overlay(shapely.union_all, shapes[shapely.intersects(S.shape, shapes)])


def _is_thin(fresh: Region, S: Region, slack: float) -> bool:
    """Whether the newly lost set lies within half the slack of the sets lost before, so that the slack covers it."""
    if not fresh.area:
        return True
    if fresh.area > slack * shapely.length(S.shape):
        return False
    return (S.erode(square(slack / 2)) & fresh).area == 0


def _inset(X: Polytope, slack: float) -> Polytope:
    """X with those sides moved inward whose corners, rounded to floats, might lie outside of X.

    Rows x_i <= h are not moved, since a float satisfies them without rounding. In own units these are the rows whose
    only entry is 1 or -1.
    """
    kept = [sorted(np.abs(a)) == [0, 1] for a in X.H]
    return Polytope(X.H, X.h - np.where(kept, 0.0, slack) * np.linalg.norm(X.H, axis=1))


def _with_area(shape: Shape) -> Shape:
    """The part of a shapely geometry that has an area."""
    parts = shapely.get_parts(shapely.get_parts(shape))
    return shapely.union_all(parts[shapely.get_dimensions(parts) == 2])


def _triangles(R: Region) -> Array:
    """The triangles (T, 3, 2) of the part of a region that has an area."""
    return Region(_with_area(R.shape)).simplices.points.reshape(-1, 3, 2)


def _triangle_count(shape: Shape) -> int:
    """The number of triangles that the polygons of a shapely geometry fall into: corners - 2 + 2 holes for each."""
    parts = shapely.get_parts(shape)
    holes = shapely.get_num_interior_rings(parts).sum()
    corners = shapely.get_num_coordinates(parts).sum() - len(parts) - holes  # each ring names one of them twice
    return int(corners - 2 * len(parts) + 2 * holes)


def _within(shape: Shape, lower: Array, upper: Array) -> Shape:
    """A shapely geometry, restricted to a box that contains it up to rounding: GEOS's grid may move corners outside."""
    points = shapely.get_coordinates(shape)
    if (points >= lower).all() and (points <= upper).all():
        return shape
    inside = shapely.transform(shape, lambda x: np.clip(x, lower, upper))
    return inside if shapely.is_valid(inside) else shape
