"""The domain X x U of a fit: checks of its sets and regions, and the units in which it is searched."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from ..checks import require_kind
from ..sets.polytope import Polytope
from ..systems.nonlinear import NonlinearSystem
from ..tolerances import FLAT_DOMAIN
from ..typing import Array


def nonlinear_system(
    f: NonlinearSystem | Callable[[Any, Any], Any], state_set: Polytope | None, input_set: Polytope | None
) -> NonlinearSystem:
    """x+ = f(x, u) over X x U as a NonlinearSystem.

    Parameters
    ----------
    f : NonlinearSystem or callable
    state_set, input_set : Polytope or None
        X and U. None takes those of a NonlinearSystem; a callable needs both.

    Raises
    ------
    TypeError
        If f is neither a NonlinearSystem nor a callable.
    ValueError
        If f is a callable and a set is missing.
    """
    if isinstance(f, NonlinearSystem):
        return replace(f, state_set=state_set or f.state_set, input_set=input_set or f.input_set)
    if not callable(f):
        raise TypeError(f"f must be a NonlinearSystem or a function f(x, u); got {type(f).__name__}")
    if state_set is None or input_set is None:
        raise ValueError("a function f needs state_set and input_set: the error is proven over X x U")
    return NonlinearSystem(f, state_set, input_set)


def checked_regions(regions: Iterable[Polytope], system: NonlinearSystem) -> list[Polytope]:
    """The regions as a list, after a check of the regions and of X and U.

    Raises
    ------
    TypeError
        If a region is not a Polytope.
    ValueError
        If there is no region, a region does not lie in R^(n+m), or X or U is empty or unbounded.
    """
    regions = list(regions)
    if not regions:
        raise ValueError("there are no regions; give at least one")
    for name, part in (("state_set", system.state_set), ("input_set", system.input_set)):
        if part.is_empty or not part.is_bounded:
            raise ValueError(f"{name} must be bounded and not empty; the error is proven over all of it")
    n, m = system.state_set.dimension, system.input_set.dimension
    for number, region in enumerate(regions, start=1):
        require_kind(region, Polytope, f"region {number}")
        if region.dimension != n + m:
            raise ValueError(f"region {number} lies in R^{region.dimension}, but (x, u) has {n} + {m} entries")
    return regions


def domain_units(system: NonlinearSystem) -> Array:
    """Powers of two near the half-widths of X x U, by which x and u are divided: array (n+m,)."""
    ends = [_extent(part) for part in (system.state_set, system.input_set)]
    lower, upper = (np.concatenate(side) for side in zip(*ends))
    size = np.maximum(np.abs(lower), np.abs(upper))
    return power_below(np.maximum((upper - lower) / 2, FLAT_DOMAIN * size))


def power_below(sizes: Array) -> Array:
    """The largest powers of two that do not exceed positive sizes; 1 for a size of 0.

    Examples
    --------
    >>> power_below(np.array([3.0, 4.0, 0.3, 0.0]))
    array([2.  , 4.  , 0.25, 1.  ])
    """
    return np.where(sizes > 0, np.ldexp(0.5, np.frexp(sizes)[1]), 1.0)


def _extent(P: Polytope) -> tuple[Array, Array]:
    """Lower and upper ends (n,) of a bounded set: from its own rows where it is a box, which leaves tiny ones exact."""
    upper, lower = np.full(P.dimension, np.inf), np.full(P.dimension, -np.inf)
    for row, offset in zip(P.H, P.h):
        used = np.flatnonzero(row)
        if len(used) == 1:
            i, limit = used[0], offset / row[used[0]]
            if row[i] > 0:
                upper[i] = min(upper[i], limit)
            else:
                lower[i] = max(lower[i], limit)
    return (lower, upper) if np.isfinite(upper - lower).all() else P.bounding_box()
