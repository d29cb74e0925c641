"""The plane without templates: the maximal RPI set, reachable sets, the attractor, and the largest disturbance.

Forward images of a nonconvex set have to be covered by a template, and every cover adds what is then carried
on. Backwards nothing is covered: a state is lost if a disturbance carries it to a lost state, and the lost part
of a cell is a union of convex polygons.

Everything is computed in the loop's own units (`units.own_units`) and scaled back by powers of two, without rounding.
The answers therefore do not depend on the units of the states, the inputs and the disturbances.
"""

from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
import shapely
from shapely.errors import GEOSException

from ..arithmetic.scaling import times
from ..checks import positive_number, real_array, require_kind, whole_number
from ..engines import exact
from ..engines.base import EXACT, Escape
from ..engines.cells import TOUCH, dynamics
from ..engines.inputs import require_inputs
from ..engines.units import own_units
from ..errors import RegionError
from ..sets.polygons import Polygons
from ..sets.polytope import Polytope
from ..sets.region import Region, hulls, overlay
from ..systems.loop import ClosedLoop
from .safe_set import SafeSet, safe_set

SLACK = 1e-9  # default of `slack`: thousands of times the rounding of GEOS, and far below what is seen in an area
LEAST_SLACK = 1e-11  # smaller ones would drown in the rounding of GEOS
MOST_ITERATIONS = 500  # default of `max_iterations`
MOST_TRIANGLES = 1_000  # that an S_k may fall into; a larger slack then ends a boundary of ever more corners sooner
MOST_LOST = 10_000  # the same where nothing has to be proven afterwards
COARSER = 4  # powers of 10 by which the slack may grow
STEEP = 0.2  # rows of a region that change with x more slowly than this (relative to their length) are not located well
ROUNDING = 1e-3  # share of the slack that covers the rounding of one operation
FLOATS = "floating point"  # what an answer rests on that `slack` protects from rounding, but no proof
CLOSING = 2.0**-36  # least widening of an image (relative to `_size`): far above rounding, far below what is seen
GRIDS = 2.0 ** np.array([-5, -4, -3])  # of the corners of a union, relative to the widening; the next one if GEOS fails
FEWER = 0.75  # share of the widening by which the boundary may move inward again while it loses corners
MORE = 8  # factor from one widening to the next where a set has too many corners
MOST_CORNERS = 300  # of a set of the attractor, beyond which it is widened more
MOST_PARTS = 100_000  # that the image of a set may fall into


@dataclass(frozen=True, eq=False)
class RegionCheck:
    """Answer of `prove_rpi`.

    Attributes
    ----------
    verdict : "proven", "refuted" or "unknown"
    witness : engines.steps.Escape or None
        A step out of the region, in rational numbers, where the verdict is "refuted".
    reason : str
    settled : str
        What the verdict rests on: "exact arithmetic"; empty where it is "unknown".
    """

    verdict: str
    witness: Escape | None
    reason: str
    settled: str = ""


@dataclass(frozen=True, eq=False)
class MaximalSafeSet:
    """Answer of `maximal_safe_set`: set <= the maximal RPI set in X <= outer.

    Attributes
    ----------
    set : Region or None
        RPI, and what is meant by the maximal set in every figure; None if none was found.
    outer : Region
        Outside of it every state can be driven out of X.
    iterations : int
        k with S_k = `set`.
    history : list of Region
        S_0, S_1, ..., S_k, of the iteration that led to `set`.
    verdict : "proven", "refuted" or "unknown"
        "proven": `set` is RPI, in rational arithmetic. "refuted": X holds no RPI set at all, since `outer` is
        empty.
    reason : str
    slack : float
        By which `set` was found, relative to the size of X and its image, as the argument of `maximal_safe_set`.
    settled : str
        What the verdict rests on: "exact arithmetic" where it is "proven", "floating point" where it is "refuted"
        (with the margin `slack`), empty where it is "unknown".
    """

    set: Region | None
    outer: Region
    iterations: int
    history: list
    verdict: str
    reason: str
    slack: float
    settled: str = ""

    @property
    def given_up(self):
        """Share of the area of `outer` that `set` lacks; what is given up for the proof is at most that."""
        own = 0.0 if self.set is None else self.set.area
        return (self.outer.area - own) / self.outer.area if self.outer.area else 0.0


@dataclass(frozen=True, eq=False)
class Attractor:
    """Answer of `attractor`.

    Attributes
    ----------
    set : Region
        An outer approximation of R_k(S) with k = `steps`; every trajectory from S is in it from step k on.
    steps : int
    history : list of Region
        S, and outer approximations of R_1(S), ..., R_k(S), and of R_(k+1)(S), by which the rule was tested. Each
        holds the image of the one before it.
    settled : bool
        Whether no point of R_k is farther than `tolerance` from R_(k+1).
    tolerance : float or array (2,)
    added : array (2,)
        By how much the sets of `history` were widened, all steps together (units of x): each of them lies within
        the image of the one before it, widened by a box, and the half-widths of these boxes sum up to at most this.
    """

    set: Region
    steps: int
    history: list
    settled: bool
    tolerance: float | np.ndarray
    added: np.ndarray


@dataclass(frozen=True)
class LargestDisturbance:
    """Answer of `largest_disturbance`.

    Attributes
    ----------
    bound : float
        With D = {d : |d_i| <= bound weights_i} in every mode there is a safe set; nan if there is none for d = 0.
    above : float
        With this bound there was none found; at most `accuracy` more, or inf if the search ended before.
    tried : int
        Loops that were looked at.
    """

    bound: float
    above: float
    tried: int


def maximal_safe_set(loop, *, slack=SLACK, max_iterations=MOST_ITERATIONS, prove=True):
    """The maximal RPI set in X: S_0 = X, S_(k+1) = S_k without the states that some d in D carries out of S_k.

    Parameters
    ----------
    loop : ClosedLoop
        With two states; modes may depend on u, jump, and differ in D.
    slack : float
        By how much disturbance sets and lost parts are widened (a box of this half-width), relative to the
        largest coordinate of X, its image and the disturbance sets, in units in which X reaches to between 1/2 and 1
        along each axis. It has to exceed the rounding of GEOS, and the area that it costs should not be seen. At
        least 1e-11.
    max_iterations : int
    prove : bool
        Whether to prove the set in rational arithmetic. Without a proof the verdict is at best "unknown".

    Returns
    -------
    MaximalSafeSet

    Raises
    ------
    ValueError
        If the loop has not two states, Phi leaves U, or an argument is out of range.

    Notes
    -----
    What is proven: `set` is RPI. `prove_rpi` shows that without rounding and without any of the code below.
    If it fails, or the boundary of S_k has ever more corners, up to 10^4 times the slack is tried, and then none
    at all, which suits sets that fit by a hair; `slack`, `reason` and `given_up` say so.

    What rests on floats: that `outer` holds every RPI set, and so that X holds none where it is empty. There
    the iteration removes only states that are lost with a margin: lost sets are shrunk by the slack before
    anything is taken to be carried into them, and the result is widened by it. The slack is thousands of times
    the rounding of one operation, but that no rounding exceeds it is not proven. Where Phi rests on a boundary of
    regions that involve u, or nearly so, floats do not tell which mode acts; then `outer` is X.

    On a boundary of regions every mode counts, so that a single line may be lost; the slack removes a thin strip
    with it. The maximal set itself need not be closed; `set` and `outer` are.
    """
    slack, max_iterations = positive_number(slack, "slack"), whole_number(max_iterations, "max_iterations", 1)
    if slack < LEAST_SLACK:
        raise ValueError(f"slack must be at least {LEAST_SLACK:g}, above the rounding of GEOS; got {slack:g}")
    units, every = _own(loop)
    found = _maximal(units.loop, every, slack, max_iterations, prove)
    own = None if found.set is None else _rescaled(found.set, units.state)
    history = [own if S is found.set else _rescaled(S, units.state) for S in found.history]
    return replace(found, set=own, outer=_rescaled(found.outer, units.state), history=history)


def _maximal(loop, every, slack, max_iterations, prove):
    """`maximal_safe_set` of a loop in its own units."""
    outer = _shrink(loop, every, -slack * _size(every), max_iterations, MOST_LOST)[0][-1]
    outer = outer.sum(_square(slack * _size(every))) & loop.system.state_set if not outer.is_empty else outer
    if _mode_in_doubt(loop, every):
        outer = Region.of(loop.system.state_set)
    if outer.is_empty:
        reason = "X holds no RPI set: every state of it can be driven out of it"
        return MaximalSafeSet(None, outer, 0, [Region.of(loop.system.state_set)], "refuted", reason, slack, FLOATS)
    failures = []
    for tried in (*(slack * 10.0**power for power in range(COARSER + 1)), 0.0):
        history, unfinished = _shrink(loop, every, tried * _size(every), max_iterations)
        if unfinished or history[-1].is_empty:
            failures.append(f"with slack {tried:g} {unfinished or 'nothing is left'}")
            continue
        if history[-1].area > outer.area:
            failures.append(f"with slack {tried:g} only rounding is left")
            continue
        found = history[-1], outer, len(history) - 1, history
        if not prove:
            return MaximalSafeSet(*found, "unknown", "; ".join([*failures, "not proven, for prove = False"]), tried)
        check = _check(loop, history[-1].pieces)
        if check.verdict == "proven":
            return MaximalSafeSet(*found, "proven", "; ".join([*failures, check.reason]), tried, check.settled)
        failures.append(f"with slack {tried:g} {check.reason}")
    return MaximalSafeSet(None, outer, len(history) - 1, history, "unknown", "; ".join(failures), tried)


def carried_out(loop, S):
    """The states of X that some disturbance carries out of S: one step of the iteration, without slack.

    Parameters
    ----------
    loop : ClosedLoop
        With two states.
    S : Region or Polytope

    Returns
    -------
    Region
        Its closure; parts without area are left out.

    Raises
    ------
    ValueError
        If the loop has not two states, Phi leaves U, or S is not a set of the plane.
    RegionError
        If GEOS fails.
    """
    require_kind(S, (Region, Polytope), "S")
    units, every = _own(loop)
    X, lost = units.loop.system.state_set, []
    try:
        start = _start(units, S)
        targets = Region(_with_area((Region.of(X) - start).shape)).simplices.points.reshape(-1, 3, 2)
        for D, own in _groups(units.loop, every):
            chosen = np.flatnonzero(own)
            lost += [_lost_outside(every, chosen, D, X, 0.0), _lost_into(every, chosen, D, targets, 0.0)]
        return _rescaled(Region(_union(lost, Region.of(X), 0.0)), units.state)
    except GEOSException as error:
        raise RegionError(f"GEOS fails on the states that are lost ({error}); try an S with fewer corners") from error


def prove_rpi(loop, region):
    """Whether a region is RPI, in rational arithmetic.

    Parameters
    ----------
    loop : ClosedLoop
        With two states.
    region : Region or Polytope
        Not empty. What is proven is proven of the union of its `pieces`, with the floats that their corners are.

    Returns
    -------
    RegionCheck
        "unknown" only if an image falls into too many parts.

    Raises
    ------
    ValueError
        If the region is empty, the loop has not two states, or Phi leaves U.

    Notes
    -----
    For every cell of the loop and every piece of the region: the image of their intersection, widened by D^(i),
    less the pieces of the region has to be empty (`engines.exact.first_escape`). Neither GEOS nor the float
    cells are trusted; python-flint, and the few lines of `engines/exact.py`, are.
    """
    require_kind(region, (Region, Polytope), "region")
    units, _ = _own(loop)
    region = Region.of(region) if isinstance(region, Polytope) else region
    if region.is_empty:
        raise ValueError("the region is empty; there is nothing to prove")
    pieces = region.pieces
    return _check(units.loop, Polygons(times(pieces.points, 1 / units.state), pieces.starts), units.state)


def _check(loop, pieces, scale=(1.0, 1.0)):
    """`prove_rpi` of pieces in the units of the loop; an escape is multiplied by `scale`."""
    try:
        escape = exact.first_escape(loop, [pieces[i] for i in range(len(pieces))])
    except ArithmeticError as error:
        return RegionCheck("unknown", None, str(error))
    if escape is not None:
        parts = [escape.state, escape.disturbance, escape.after]
        x, d, after = (part and tuple(value * Fraction(s) for value, s in zip(part, scale)) for part in parts)
        escape = Escape(x, escape.mode, d, after)
        return RegionCheck("refuted", escape, f"a step leaves the region: {escape}", EXACT)
    reason = f"no step leaves the {len(pieces)} pieces of the region, in rational arithmetic"
    return RegionCheck("proven", None, reason, EXACT)


def exact_reach(loop, F, steps):
    """The exact reachable sets R_0(F) = F & X, R_1(F), ..., R_k(F) for k = `steps`, nonconvex as they are.

    Parameters
    ----------
    loop : ClosedLoop
        With two states.
    F : Polytope or Region
        Points and segments are fine.
    steps : int
        At least 0.

    Returns
    -------
    list of steps + 1 Region
        Up to rounding: images with an area are widened by up to 3e-11 of the size of X and its image at every step,
        so that no cracks open between them. Only what stays in X goes on. Nothing is proven about them.

    Raises
    ------
    ValueError
        If the loop has not two states, Phi leaves U, or F is not a set of the plane.
    RegionError
        If a set falls into too many parts to go on, or GEOS fails.
    """
    require_kind(F, (Region, Polytope), "F")
    steps = whole_number(steps, "steps", 0)
    units, every = _own(loop)
    advice = "take fewer steps, start from a smaller F, or cover the sets by a template (outer_reach)"
    with _named_failures(advice):
        sets = [_start(units, F)]
        cells, widening = hulls(every.cells.polygons), CLOSING * _size(every)
        for _ in range(steps):
            sets.append(Region(_closed(_images(units.loop, every, cells, sets[-1]), widening, flat=True)))
    return [_rescaled(R, units.state) for R in sets]


def attractor(loop, safe, *, tolerance=1e-3, max_steps=500):
    """A set that everything in a safe set enters, close to the smallest: R_k(S) once the sequence has settled.

    Parameters
    ----------
    loop : ClosedLoop
    safe : MaximalSafeSet, SafeSet, Region or Polytope
        An RPI set S, from which on the sequence R_k(S) shrinks.
    tolerance : float or array (2,)
        The sequence has settled when no point of R_k is farther than this from R_(k+1) along any axis (units of x).
        Where the states have different units, give one number for each. What comes later may still shrink by more,
        if slowly: the rule is about one step.
    max_steps : int

    Returns
    -------
    Attractor

    Raises
    ------
    ValueError
        If `safe` holds no set, the loop has not two states, or Phi leaves U.
    RegionError
        If a set falls into too many parts to go on, or GEOS fails.

    Notes
    -----
    R_k may have ever more corners. Every image is therefore widened by a box and then loses those corners that lie
    within that margin, so that each set holds the image of the one before it; floats check it, with a margin that
    covers their rounding. The half-width is 1.5e-11 of the size of X and its image at first. It grows, up to an eighth
    of the tolerance, where a set would have more than 300 corners. `added` says how much was added.
    """
    by_axis, max_steps = _per_axis(tolerance, 2, "tolerance"), whole_number(max_steps, "max_steps", 1)
    S = safe.set if isinstance(safe, (MaximalSafeSet, SafeSet)) else safe
    if S is None:
        raise ValueError(f"there is no safe set to start from: {safe.reason}")
    require_kind(S, (Region, Polytope), "safe")
    units, every = _own(loop)
    margin, cells, settled, added = by_axis / units.state, hulls(every.cells.polygons), False, 0.0
    widening = least = CLOSING * _size(every)
    most, box = max(least, margin.min() / 8), Polytope.box(-margin, margin)
    with _named_failures("try a larger tolerance, or start from a smaller set"):
        history = [_start(units, S)]
        while not settled and len(history) <= max_steps:
            images = _images(units.loop, every, cells, history[-1])
            following = _closed(images, widening)
            while len(shapely.get_coordinates(following)) > MOST_CORNERS and widening < most:
                widening = min(MORE * widening, most)
                following = _closed(images, widening)
            history.append(Region(following))
            added += 2 * widening
            if len(shapely.get_coordinates(following)) < MOST_CORNERS / 2:
                widening = max(widening / MORE, least)
            settled = history[-2].is_subset(history[-1].sum(box))
    history = [_rescaled(R, units.state) for R in history]
    tolerance = by_axis if np.ndim(tolerance) else float(by_axis[0])
    return Attractor(history[-2], len(history) - 2, history, settled, tolerance, added * units.state)


def largest_disturbance(loop, method="maximal", *, accuracy=1e-4, largest=None, C=None, weights=1.0):
    """The largest bound r for which the loop with D = {d : |d_i| <= r w_i} in every mode has a safe set, by bisection.

    Parameters
    ----------
    loop : ClosedLoop
        Its own disturbance sets do not matter.
    method : "maximal", "template", or callable
        Which safe set: the maximal one (two states), F_max with the template C, or whatever a function of a
        ClosedLoop says (bool).
    accuracy : float
        Of r.
    largest : float or None
        Where the search ends; None is the smallest r at which D is as wide as X along some axis, beyond which D fits
        into no set in X.
    C : array (l, n) or None
        Template of F_max, as in `safe_set`.
    weights : float or array (n,)
        w, the shape of D; 1 for D = {d : |d|_inf <= r}, r in units of d. Where the states have different units, give
        one number for each.

    Returns
    -------
    LargestDisturbance

    Raises
    ------
    ValueError
        If there is no such method, an argument is out of range, or Phi leaves U.

    Notes
    -----
    For "maximal" the answer is *yes* up to a bound and *no* beyond: what is RPI stays RPI for a smaller D. The sets
    of the search are found in floating point; `maximal_safe_set` proves the one at `bound`. For F_max the
    answer need not be monotone, for its sequence starts from X and a template covers different images
    differently well. Bisection then finds one bound at which the answer changes from yes to no, of perhaps several.
    """
    require_kind(loop, ClosedLoop, "loop")
    accuracy, weights = positive_number(accuracy, "accuracy"), _per_axis(weights, loop.system.state_size, "weights")
    holds = (
        {
            "maximal": _has_safe_region,
            "template": lambda other: safe_set(other, C).set is not None,
        }.get(method, method)
        if isinstance(method, str)
        else method
    )
    if not isinstance(holds, Callable):
        raise ValueError(f'method must be "maximal", "template" or a function of a loop; got {method!r}')
    require_inputs(loop)
    if largest is None:
        lower, upper = loop.system.state_set.bounding_box()
        largest = ((upper - lower) / weights).min() / 2
    low, high, tried = 0.0, positive_number(largest, "largest"), 2

    def exists(r):
        return bool(holds(loop.with_disturbance(Polytope.box(-r * weights, r * weights))))

    if not exists(low):
        return LargestDisturbance(np.nan, low, 1)
    if exists(high):
        return LargestDisturbance(high, np.inf, tried)
    while high - low > accuracy:
        middle, tried = (low + high) / 2, tried + 1
        low, high = (middle, high) if exists(middle) else (low, middle)
    return LargestDisturbance(low, high, tried)


def _has_safe_region(loop):
    """Whether the iteration of `maximal_safe_set` comes to rest before nothing is left."""
    units, every = _own(loop)
    history, unfinished = _shrink(units.loop, every, SLACK * _size(every), MOST_ITERATIONS, MOST_LOST)
    return not unfinished and not history[-1].is_empty


def _mode_in_doubt(loop, every):
    """Whether some cell touches a row of its mode's region along which u hardly depends on x.

    The float cells of such a mode may reach beyond the region by more than the slack, or be there although the
    mode never acts.
    """
    found, polygons, near = every.cells, every.cells.polygons, SLACK * _size(every)
    domain = loop.system.state_set.product(loop.system.input_set)
    for number, mode in enumerate(loop.system.modes):
        own = np.flatnonzero(found.mode == number)
        part = polygons.take(own)
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


def _shrink(loop, every, slack, max_iterations, most_triangles=MOST_TRIANGLES):
    """S_0, S_1, ..., and why the last of them is not the end of the sequence ("" if it is).

    `slack` (units of x) is positive for a set within the maximal one: D and what is lost are widened by it. It is
    negative for a set around it: only what is lost by more than that carries on. At 0 there is no margin.
    """
    history = [Region.of(_inset(loop.system.state_set, max(slack, 0.0)))]
    try:
        return history, _shrunk(loop, every, slack, max_iterations, most_triangles, history)
    except GEOSException as error:  # what was found before is found all the same
        return history, f"GEOS fails on S_{len(history)} ({error})"


def _shrunk(loop, every, slack, max_iterations, most_triangles, history):
    """Append S_1, S_2, ... to [S_0]; why the last of them is not the end of the sequence ("" if it is)."""
    groups = _groups(loop, every)
    shapes = hulls(every.cells.polygons)
    lost = [_lost_outside(every, np.flatnonzero(own), D, loop.system.state_set, slack) for D, own in groups]
    S, box = history[0], loop.system.state_set.bounding_box()
    for _ in range(max_iterations):
        gone = _union(lost, S, slack)
        following = Region(_within(_with_area(overlay(shapely.difference, S.shape, gone)), *box))
        fresh = Region(_with_area(overlay(shapely.intersection, S.shape, gone)))
        if _is_thin(fresh, S, abs(slack)):
            if fresh.area:
                history.append(following)
            return ""
        history.append(following)
        if following.is_empty:
            return ""
        if len(following.simplices) > most_triangles:
            return f"S_{len(history) - 1} has more than {most_triangles} triangles"
        if slack < 0:
            fresh = S.sum(_square(-slack)) - following.sum(_square(-slack))
        targets = Region(_with_area(fresh.shape)).simplices.points.reshape(-1, 3, 2)
        shapely.prepare(following.shape)
        alive = shapely.dwithin(following.shape, shapes, abs(slack))
        lost = [_lost_into(every, np.flatnonzero(own & alive), D, targets, max(slack, 0.0)) for D, own in groups]
        S = following
    return f"max_iterations = {max_iterations} came first"


def _groups(loop, every):
    """Every different disturbance set D, with the cells (N,) of bool in which it acts."""
    groups = {}
    for number, mode in enumerate(loop.system.modes):
        groups.setdefault(mode.disturbance, []).append(number)
    return [(D, np.isin(every.cells.mode, modes)) for D, modes in groups.items()]


def _lost_outside(every, chosen, D, X, slack):
    """The parts of the chosen cells that D can carry out of X: Polygons."""
    polygons, found = every.cells.polygons.take(chosen), []
    limits = X.h - D.support(X.H) - slack * np.abs(X.H).sum(axis=1)
    for a, limit in zip(X.H, limits):
        found.append(polygons.clip(-a @ every.M[chosen], every.c[chosen] @ a - limit, 0.0)[0])
    return Polygons.join(found)


def _lost_into(every, chosen, D, targets, slack):
    """The parts of the chosen cells that D, widened by a box of half-width `slack`, can carry into triangles.

    M x + c + d lies in the triangle T for some d exactly if M x + c lies in T + (-D), whose sides have the normals
    of T and of -D.
    """
    cells = every.cells.polygons.take(chosen)
    images, (low, high) = every.images(cells.points, chosen[cells.owner]), D.bounding_box()
    starts, ends = targets.min(axis=1) - high - slack, targets.max(axis=1) - low + slack
    near = (cells.least(images)[:, None] <= ends).all(axis=2) & (cells.largest(images)[:, None] >= starts).all(axis=2)
    which, target = np.nonzero(near)
    own, corners = _normals(targets), D.vertices()
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


def _normals(triangles):
    """Outward normals of length 1 of the sides of triangles (T, 3, 2): array (T, 3, 2)."""
    ahead = np.roll(triangles, -1, axis=1) - triangles
    turn = ahead[:, 0, 0] * ahead[:, 1, 1] - ahead[:, 0, 1] * ahead[:, 1, 0]
    normals = np.stack([ahead[..., 1], -ahead[..., 0]], axis=-1) * np.where(turn < 0, -1, 1)[:, None, None]
    return normals / np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), np.finfo(float).tiny)


def _union(lost, S, slack):
    """The union of those lost polygons that meet S; flat ones count only for a set within the maximal one."""
    polygons = Polygons.join(lost)
    if slack <= 0:
        polygons = polygons.take(np.flatnonzero(shapely.get_dimensions(hulls(polygons)) == 2))
    shapes = hulls(polygons, slack if slack > 0 else -ROUNDING * slack)
    shapely.prepare(S.shape)
    return overlay(shapely.union_all, shapes[shapely.intersects(S.shape, shapes)])


def _is_thin(fresh, S, slack):
    """Whether what is lost freshly lies within half the slack of what was lost before, which the slack covers."""
    if not fresh.area:
        return True
    if fresh.area > slack * shapely.length(S.shape):
        return False
    return (S.erode(_square(slack / 2)) & fresh).area == 0


def _inset(X, slack):
    """X with those sides moved inward whose corners, rounded to floats, might lie outside of X.

    Rows x_i <= h, which hold for a float or not, stay: in own units those of an entry that is a power of two.
    """
    kept = [sorted(np.abs(a)) == [0, 1] for a in X.H]
    return Polytope(X.H, X.h - np.where(kept, 0.0, slack) * np.linalg.norm(X.H, axis=1))


def _with_area(shape):
    """The part of a shapely geometry that has an area."""
    parts = shapely.get_parts(shapely.get_parts(shape))
    return shapely.union_all(parts[shapely.get_dimensions(parts) == 2])


def _within(shape, lower, upper):
    """A shapely geometry in the box that it lies in up to rounding: the grid of GEOS may move corners out of it."""
    points = shapely.get_coordinates(shape)
    if (points >= lower).all() and (points <= upper).all():
        return shape
    inside = shapely.transform(shape, lambda x: np.clip(x, lower, upper))
    return inside if shapely.is_valid(inside) else shape


def _size(every):
    """The largest coordinate of X, its image and the disturbance sets."""
    points, owner = every.cells.polygons.points, every.cells.polygons.owner
    parts = points, every.images(points, owner), *every.corners
    return float(max(np.abs(part).max(initial=0.0) for part in parts))


def _square(r):
    """The box |x|_inf <= r in the plane."""
    return Polytope.box([-r, -r], [r, r])


# -- units --------------------------------------------------------------------------------------------


def _own(loop):
    """The Units of a loop and the cells of the loop in them, after what all functions here require was checked."""
    require_kind(loop, ClosedLoop, "loop")
    require_inputs(loop)
    units = own_units(loop)
    return units, dynamics(units.loop)


def _start(units, F):
    """F & X as a Region in own units."""
    if isinstance(F, Polytope) and F.dimension == 2:
        F = units.polytope(F)
    own = _rescaled(F, 1 / units.state) if isinstance(F, Region) else Region.of(F)
    return own & units.loop.system.state_set


def _rescaled(R, factor):
    """{factor x : x in R} for powers of two: the same corners, triangles and pieces, without rounding."""
    shape = shapely.transform(R.shape, lambda x: times(x, factor))
    made = Region(shape)
    for name in ("simplices", "pieces"):
        if name in R.__dict__:
            parts = R.__dict__[name]
            made.__dict__[name] = Polygons(times(parts.points, factor), parts.starts)
    return made


def _per_axis(value, n, name):
    """A positive number, or one for each of n axes, as an array (n,)."""
    if np.ndim(value) == 0:
        return np.full(n, positive_number(value, name))
    array = real_array(value, name, 1)
    if len(array) != n or not (array > 0).all():
        raise ValueError(f"{name} must be a positive number or {n} of them; got {value!r:.80}")
    return array


@contextmanager
def _named_failures(advice):
    """Turn what GEOS raises into a RegionError that says what to do."""
    try:
        yield
    except GEOSException as error:
        raise RegionError(f"GEOS finds no answer for a set of that many corners ({error}); {advice}") from error
    except _TooManyParts as error:
        raise RegionError(f"{error}; {advice}") from error


class _TooManyParts(Exception):
    """An image falls into more than `MOST_PARTS` parts."""


# -- forwards -----------------------------------------------------------------------------------------


def _images(loop, every, shapes, R):
    """The images of all parts of cells within R, each widened by the D of its mode: Polygons.

    `shapes` are the cells as shapely geometries. A cell that lies in R counts as a whole.
    """
    cells = every.cells.polygons
    shapely.prepare(R.shape)
    whole = shapely.covers(R.shape, shapes)
    which = np.flatnonzero(whole)
    batches = [(cells.take(which), which)]
    cut = np.flatnonzero(~whole & shapely.dwithin(R.shape, shapes, 2 * TOUCH * _size(every)))
    if len(cut):
        batches.append(_parts(every, cut, R.simplices))
    images = []
    for part, which in batches:
        image = Polygons(every.images(part.points, which[part.owner]), part.starts)
        for D, own in _groups(loop, every):
            chosen, corners = image.take(np.flatnonzero(own[which])), D.vertices()
            points = (chosen.points[:, None] + corners).reshape(-1, 2)
            images.append(Polygons(points, chosen.starts * len(corners)))
    return Polygons.join(images)


def _parts(every, chosen, pieces):
    """The parts of chosen cells within pieces: Polygons, and the cell each comes from."""
    cells, touch = every.cells.polygons.take(chosen), TOUCH * _size(every)
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


def _closed(polygons, widening, flat=False):
    """A shapely geometry that holds polygons, each widened by a box, and lies within twice that widening of them.

    Widened polygons overlap where they share an edge, so that no cracks are left; corners that lie closer than `FEWER`
    times the widening to the boundary without them are left out. With `flat`, polygons without area that stick out
    are not widened.
    """
    if not len(polygons):
        return shapely.Polygon()
    shapes, lines = hulls(polygons), []
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


def _union_of_wide(wide, shapes, widening):
    """The union of widened polygons with fewer corners, which holds `shapes`, those that are not widened."""
    failure = "corners lie too close together"
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


def _sides(pieces):
    """Half-planes A (N, 7, 2), b (N, 7) whose intersections are triangles, segments and points.

    Four of them are the bounding box: a triangle of almost no width has a side without a direction.
    """
    A = np.empty((len(pieces), 7, 2))
    A[:, 3:] = np.vstack([np.eye(2), -np.eye(2)])
    for i in range(len(pieces)):
        x = pieces[i]
        if len(x) == 3:
            A[i, :3] = _normals(x[None])[0]
        else:
            along = x[-1] - x[0]
            across = np.array([-along[1], along[0]]) / max(np.linalg.norm(along), np.finfo(float).tiny)
            A[i, :3] = across, -across, across
    return A, pieces.largest(np.einsum("trj,tj->tr", A[pieces.owner], pieces.points))
