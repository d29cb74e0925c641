"""Reachable sets: support functions by any engine, outer steps and outer sequences."""

import warnings
from time import perf_counter

import numpy as np

from ..checks import real_array, require_columns, require_kind, whole_number
from ..engines.base import Engine, Query, Support, checked_query
from ..engines.inputs import require_inputs
from ..engines.registry import engine_for
from ..engines.units import own_units
from ..errors import SolverStopped
from ..sets.polytope import Polytope
from ..systems.loop import ClosedLoop
from ..typing import Array, ArrayLike

LEAST_TIME = 1e-3  # seconds for an engine if the check of the inputs took all of its time


def support(
    loop: ClosedLoop,
    F: Polytope,
    V: ArrayLike,
    steps: int = 1,
    engine: Engine | str | None = None,
    *,
    cutoff: ArrayLike | None = None,
    warm_start: Support | None = None,
) -> Support:
    """Support function of the k-step reachable set: h of R_k(F) along V (Lemma 2).

    Parameters
    ----------
    loop : ClosedLoop
    F : Polytope
        Initial states. States outside X have no successor, so the trajectories start in F & X, and at every later step
        only states in X have successors.
    V : array (k, n)
        Directions, one per row.
    steps : int
        The k of R_k.
    engine : Engine, str or None
        An engine with its settings, such as `Milp(time_limit=60)`; "cells", "milp", "exact" or "cvxpy" for one with
        its defaults; None for the cells if there are few enough, else the MILP (`Support.engine` says which). For
        several steps of more than two states None is the MILP.
    cutoff : array (k,) or None
        Give it if only the question whether h exceeds this matters: an engine may stop at any bound that does not
        exceed it.
    warm_start : Support or None
        An earlier result for the same loop, V and steps, and a set that contains F.

    Returns
    -------
    Support
        `value` (k,) attained, `bound` (k,) an upper bound, and the `witness` that attains the value.

    Raises
    ------
    TypeError
        If an argument is of another kind.
    ValueError
        If sizes do not match, the engine has another name, `warm_start` is the result of another query, or Phi leaves
        U.
    SolverStopped
        If a time limit stopped the engine; its `support` holds the bounds so far.

    See Also
    --------
    outer_step : the polytope that these bounds describe.

    Examples
    --------
    >>> import mireach as mr
    >>> case = mr.case_study("pwa")
    >>> found = mr.support(case.loop, mr.Polytope.box([0, 0], [1, 1]), [[1, 0], [0, 1]])
    >>> bool((found.value <= found.bound).all()), found.rests_on
    (True, 'rounding counted')
    """
    begin = perf_counter()
    V, steps = checked_query(loop, F, V, steps)
    engine = engine_for(loop, engine, steps)
    query, units = Query(loop, F, V, steps), own_units(loop)
    rows, factor = units.rows(V)
    if cutoff is not None:
        cutoff = np.asarray(cutoff, float)
        if cutoff.shape != (len(V),):
            raise ValueError(f"cutoff has shape {cutoff.shape}, but V has {len(V)} rows; give one number per row")
        cutoff = cutoff * factor
    if warm_start is not None:
        _require_warm_start(warm_start, query)
        warm_start = warm_start.source
    try:
        require_inputs(loop, engine.time_limit)
        if engine.time_limit is not None:
            left = engine.time_limit - (perf_counter() - begin)
            engine = engine.within(max(left, LEAST_TIME))
        found = engine.support(units.loop, units.polytope(F), rows, steps, cutoff=cutoff, warm_start=warm_start)
    except SolverStopped as stop:
        raise units.stopped(stop, factor, engine, query) from stop
    return units.support(found, factor, engine, query)


def cut_support(loop: ClosedLoop, F: Polytope, V: ArrayLike, engine: Engine | str | None = None) -> Array:
    """Upper bounds of the support function of R_1(F) & X along the rows of V.

    Parameters
    ----------
    loop : ClosedLoop
    F : Polytope
    V : array (k, n)
        Directions, one per row.
    engine : Engine, str or None
        As in `support`; one that has `Engine.cut_support`.

    Returns
    -------
    array (k,)
        -inf where no state of F has a successor in X.

    Raises
    ------
    ValueError
        If the engine has no such bounds, sizes do not match, or Phi leaves U.

    See Also
    --------
    support : of all of R_1(F), with witnesses.

    Examples
    --------
    >>> import mireach as mr
    >>> loop = mr.case_study("pwa").loop  # X is the box |x|_inf <= 10
    >>> V = mr.directions(8)
    >>> whole, cut = mr.support(loop, loop.system.state_set, V).bound, cut_support(loop, loop.system.state_set, V)
    >>> bool((cut <= whole + 1e-9).all()), bool((cut < whole - 0.1).any())
    (True, True)
    """
    engine = engine_for(loop, engine)
    V, _ = checked_query(loop, F, V, 1)
    units = own_units(loop)
    rows, factor = units.rows(V)
    require_inputs(loop, engine.time_limit)
    return engine.cut_support(units.loop, units.polytope(F), rows) / factor


def _require_warm_start(warm_start: Support, query: Query) -> None:
    """Raise ValueError unless the bounds of an earlier result are valid for this query."""
    require_kind(warm_start, Support, "warm_start")
    before = warm_start.query
    if (
        before is None
        or before.loop is not query.loop
        or before.steps != query.steps
        or not np.array_equal(before.V, query.V)
        or not query.F.is_subset(before.F)
    ):
        raise ValueError("warm_start answers another question: give one for the same loop, V and steps, and a larger F")


def outer_step(loop: ClosedLoop, F: Polytope, C: ArrayLike, engine: Engine | str | None = None) -> Polytope:
    """R_1-bar(F) = {x : C x <= h of R_1(F) along C} (eq. (18), Rover1), the smallest such set around R_1(F).

    Parameters
    ----------
    loop : ClosedLoop
    F : Polytope
    C : array (l, n)
        Template.
    engine : Engine, str or None
        As in `support`.

    Returns
    -------
    Polytope

    Raises
    ------
    ValueError
        As `support`, and if F does not meet X or the engine has no bound along a row.

    See Also
    --------
    outer_reach : several steps.

    Examples
    --------
    >>> import mireach as mr
    >>> case = mr.case_study("pwa")
    >>> mr.outer_step(case.loop, mr.Polytope.box([0, 0], [1, 1]), mr.directions(8))
    Polytope(8 rows in R^2)
    """
    C = real_array(C, "C", 2)
    require_kind(loop, ClosedLoop, "loop")
    require_columns(C, loop.system.state_size, "C", "the state's size")
    engine = engine_for(loop, engine)
    bound = support(loop, F, C, engine=engine).bound
    require_bounds(bound, engine)
    return Polytope(C, bound)


def require_bounds(bound: Array, engine: Engine) -> None:
    """Raise ValueError unless bounds (k,) of a reachable set are those of a bounded set that is not empty."""
    missing = np.flatnonzero(~(bound < np.inf))
    if len(missing):
        raise ValueError(f"the engine {engine.name} has no bound along row {missing[0] + 1}; use another engine")
    if (bound == -np.inf).any():
        raise ValueError("F does not meet the state set, so no state of it has a successor")


def outer_reach(
    loop: ClosedLoop, F: Polytope, C: ArrayLike, steps: int, engine: Engine | str | None = None
) -> list[Polytope]:
    """R_0-bar(F) = F, R_1-bar(F), ..., R_k-bar(F) for k = `steps` (eq. (19), ROverOver).

    Parameters
    ----------
    loop : ClosedLoop
    F : Polytope
    C : array (l, n)
        Template.
    steps : int
        At least 0.
    engine : Engine, str or None
        As in `support`.

    Returns
    -------
    list of steps + 1 Polytope

    Raises
    ------
    ValueError
        As `outer_step`.

    Warns
    -----
    UserWarning
        If a set leaves X: the later sets contain only trajectories that stay in X.

    See Also
    --------
    outer_step : one step.

    Examples
    --------
    >>> import mireach as mr
    >>> case = mr.case_study("pwa")
    >>> len(mr.outer_reach(case.loop, mr.Polytope.box([0, 0], [1, 1]), mr.directions(8), 3))
    4
    """
    require_kind(F, Polytope, "F")
    sets = [F]
    for k in range(whole_number(steps, "steps", 0)):
        if not sets[-1].is_subset(loop.system.state_set):
            warnings.warn(f"R{k} leaves the state set; later sets describe only what stays in it", stacklevel=2)
        sets.append(outer_step(loop, sets[-1], C, engine))
    return sets
