"""Whether Phi(x) lies in U for every x in X (Sec. II.A of [Teichrib2025]): one check for all engines.

A state whose input lies outside U has no successor, so that no result holds for a loop with such a state.
"""

from functools import lru_cache

import numpy as np

from ..arithmetic.rational import binary, nearest
from ..errors import CellLimitError
from ..sets.polytope import Polytope
from ..systems.loop import ClosedLoop, input_message
from ..systems.network import MaxoutNetwork
from ..tolerances import CLEAR
from ..typing import Array
from . import cells, exact
from .exact_cells import FEW_CELLS, MOST_CELLS
from .milp import engine as milp
from .units import Units, own_units


def require_inputs(loop: ClosedLoop, time_limit: float | None = None) -> None:
    """Raise ValueError if Phi leaves U somewhere in X; the message gives a state.

    Parameters
    ----------
    loop : ClosedLoop
    time_limit : float or None
        Seconds for the MILP, which decides where exact arithmetic would take long.

    Raises
    ------
    ValueError
        If Phi leaves U.
    SolverStopped
        If the time limit was reached first.

    Notes
    -----
    Interval arithmetic decides for saturated networks, which do not leave U even by rounding. Otherwise the corners of
    the cells decide: for two states in floats with bounds on the rounding errors, and in exact arithmetic if these do
    not suffice; for more states in exact arithmetic. If the network has too many affine pieces for that (`FEW_CELLS`),
    the MILP decides, to within 1e-7 of the size of U.
    """
    x = violating_state(loop, loop.system.input_set, time_limit)
    if x is not None:
        u, U = loop.network(x), loop.system.input_set
        raise ValueError(input_message(max((U.H @ u - U.h).max(), 0), x, u))


def violating_state(loop: ClosedLoop, U: Polytope, time_limit: float | None = None) -> Array | None:
    """A state (n,) of X whose input lies outside the Polytope U, or None."""
    units = own_units(loop)
    own, U = units.loop, _inputs_in_units(units, U)
    if _by_intervals(own.network, own.system.state_set, U):
        return None
    if own.system.state_size == 2:
        regions = tuple(mode.region for mode in own.system.modes)
        state = _in_the_plane(own.network, regions, own.system.state_set, U)
    else:
        state = _in_space(own, U, time_limit)
    return None if state is None else units.states(state)


@lru_cache(maxsize=128)
def _inputs_in_units(units: Units, U: Polytope) -> Polytope:
    """A Polytope of inputs in the units of the loop."""
    return U.in_units(units.inputs)


@lru_cache(maxsize=128)
def _in_the_plane(network: MaxoutNetwork, regions: tuple[Polytope, ...], X: Polytope, U: Polytope) -> Array | None:
    """A state (2,) of X whose input lies outside U, or None."""
    most, excess, x = cells.input_excess(network, regions, X, U)
    if most <= 0:
        return None
    if excess > CLEAR:
        return x
    return _exactly(network, X, U, MOST_CELLS)


@lru_cache(maxsize=128)
def _in_space(loop: ClosedLoop, U: Polytope, time_limit: float | None) -> Array | None:
    """A state (n,) of X whose input lies outside U, or None, for any n."""
    try:
        return _exactly(loop.network, loop.system.state_set, U, FEW_CELLS)
    except CellLimitError:
        return milp.violating_state(loop, U, time_limit=time_limit)


def _exactly(network: MaxoutNetwork, X: Polytope, U: Polytope, most: int) -> Array | None:
    """A state (n,) of X whose input lies outside U, or None, without rounding."""
    found = exact.highest_inputs(network, X, binary(U.H), most)
    for (value, state), limit in zip(found, binary(U.h)):
        if value > limit:
            return np.array([nearest(entry) for entry in state])
    return None


@lru_cache(maxsize=128)
def _by_intervals(network: MaxoutNetwork, X: Polytope, U: Polytope) -> bool:
    """Whether interval arithmetic shows that Phi(x) lies in U for every x in X, its rounding counted."""
    low, high = X.bounding_box()
    around = 2.0**-40 * np.maximum(np.abs(low), np.abs(high))
    low, high = low - around, high + around
    for layer in network.hidden:
        low, high = _range(layer.weight, layer.bias, low, high)
        low, high = (ends.reshape(layer.width, layer.pool).max(axis=1) for ends in (low, high))
    low, high = _range(network.weight, network.bias, low, high)
    return bool((_range(U.H, np.zeros(len(U.h)), low, high)[1] <= U.h).all())


def _range(W: Array, b: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Bounds of W y + b over low <= y <= high, rounded outward.

    A row whose only term is a power of two times an entry of y is exact.
    """
    up, down = np.maximum(W, 0), np.minimum(W, 0)
    most = up @ high + down @ low + b
    least = up @ low + down @ high + b
    size = np.abs(W) @ np.maximum(np.abs(low), np.abs(high)) + np.abs(b)
    terms = (W != 0).sum(axis=1) + (b != 0)
    simple = (terms <= 1) & ((W == 0) | (np.abs(np.frexp(W)[0]) == 0.5)).all(axis=1)
    rounding = np.where(simple, 0.0, 2.0**-52 * (terms + 2) * size)
    return least - rounding, most + rounding
