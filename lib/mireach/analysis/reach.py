"""Reachable sets: support functions by any engine, outer steps and outer sequences."""

import inspect
import warnings
from importlib import import_module
from time import perf_counter

import numpy as np

from ..checks import positive_number, real_array, require_columns, require_kind, whole_number
from ..engines.base import Support, checked_query
from ..engines.inputs import require_inputs
from ..engines.units import own_units
from ..errors import SolverStopped
from ..sets.polytope import Polytope
from ..systems.loop import ClosedLoop

ENGINES = {
    "cells": "cells",
    "milp": "milp.engine",
    "exact": "exact",
    "cvxpy": "cvxpy_model",
}  # name -> module in `engines` with its `support`
RESOLUTION = {
    "cells": 0.0,
    "milp": 1e-6,
    "exact": 0.0,
    "cvxpy": 1e-5,
}  # how far an engine's bound may lie above the truth, and tie with it (relative to the size of X)

LEAST_TIME = 1e-3  # seconds that are left to an engine where the check of the inputs took all of its time


def default_engine(loop):
    """The cells where they apply (two states), else the MILP."""
    require_kind(loop, ClosedLoop, "loop")
    return "cells" if loop.system.state_size == 2 else "milp"


def support(loop, F, V, steps=1, engine=None, **options):
    """Support function of the k-step reachable set: h of R_k(F) along V (Lemma 2).

    Parameters
    ----------
    loop : ClosedLoop
    F : Polytope
        Where trajectories start. States outside X have no successor: F & X counts, and at every later
        step only what stays in X goes on.
    V : array (k, n)
        Directions, one a row.
    steps : int
        The k of R_k.
    engine : "cells", "milp", "exact", "cvxpy" or None
        None takes the cells for two states, else the MILP.
    **options
        Passed to the engine, such as `time_limit` for the MILP.

    Returns
    -------
    Support
        `value` (k,) attained, `bound` (k,) proven, and the `witness` that attains the value.

    Raises
    ------
    ValueError
        If sizes do not match, the engine has another name or no such option, or Phi leaves U.
    SolverStopped
        If a limit stopped the solver.
    """
    engine = default_engine(loop) if engine is None else engine
    if not isinstance(engine, str) or engine not in ENGINES:
        raise ValueError(f"engine must be one of {', '.join(ENGINES)}; got {engine!r}")
    answer = import_module(f"mireach.engines.{ENGINES[engine]}").support
    accepted = inspect.signature(answer).parameters if options else {}
    unknown = [name for name in options if name not in accepted]
    if unknown and not any(parameter.kind is parameter.VAR_KEYWORD for parameter in accepted.values()):
        own = ", ".join(list(accepted)[4:]) or "none"
        raise ValueError(f"the engine {engine!r} has no option {', '.join(unknown)}; its options: {own}")
    V, steps = checked_query(loop, F, V, steps)
    units, begin, time_limit = own_units(loop), perf_counter(), options.get("time_limit")
    if time_limit is not None:
        time_limit = positive_number(time_limit, "time_limit")
    rows, factor = units.rows(V)
    for name in ("known", "cutoff"):
        if options.get(name) is not None:
            given = options[name]
            options[name] = given.source if isinstance(given, Support) else np.asarray(given, float) * factor
    resolution = RESOLUTION[engine]
    try:
        require_inputs(loop, time_limit)
        if time_limit is not None:
            options["time_limit"] = max(time_limit - (perf_counter() - begin), LEAST_TIME)
        return units.support(answer(units.loop, units.polytope(F), rows, steps, **options), factor, resolution)
    except SolverStopped as stop:
        raise units.stopped(stop, factor, resolution) from stop


def outer_step(loop, F, C, engine=None, **options):
    """R_1-bar(F) = {x : C x <= h of R_1(F) along C} (eq. Rover1), the smallest such set around R_1(F).

    Parameters
    ----------
    loop : ClosedLoop
    F : Polytope
    C : array (l, n)
        Template.

    Returns
    -------
    Polytope

    Raises
    ------
    ValueError
        As `support`, and if F does not meet X.
    """
    C = real_array(C, "C", 2)
    require_columns(C, loop.system.state_size, "C", "the state's size")
    bound = support(loop, F, C, engine=engine, **options).bound
    if not np.isfinite(bound).all():
        raise ValueError("F does not meet the state set, so no state of it has a successor")
    return Polytope(C, bound)


def outer_reach(loop, F, C, steps, engine=None, **options):
    """R_0-bar(F) = F, R_1-bar(F), ..., R_k-bar(F) for k = `steps` (eq. ROverOver).

    Parameters
    ----------
    loop : ClosedLoop
    F : Polytope
    C : array (l, n)
        Template.
    steps : int
        At least 0.

    Returns
    -------
    list of steps + 1 Polytope

    Warns
    -----
    UserWarning
        If a set leaves X; what follows then only describes trajectories that stay in X.
    """
    require_kind(F, Polytope, "F")
    sets = [F]
    for k in range(whole_number(steps, "steps", 0)):
        if not sets[-1].is_subset(loop.system.state_set):
            warnings.warn(f"R{k} leaves the state set; later sets describe only what stays in it", stacklevel=2)
        sets.append(outer_step(loop, sets[-1], C, engine, **options))
    return sets
