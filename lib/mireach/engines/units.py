"""A closed loop in its own units, so that no result depends on the units of the user.

With x = s x' and u = t u', one power of two for each state and each input, every number of the loop is scaled
exactly. The powers are chosen so that the largest |x_i| over X and the largest |u_i| over U lie between 1/2 and 1. Rows
of H are scaled so that their largest entry lies there, and hidden neurons so that |q| <= 1 over X, since a maximum
scales with its channels. Loops that differ only in units become the same loop, bit by bit, and a tolerance relative to
1 is relative to the size of X.
"""

from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import Any, TypeVar

import numpy as np

from ..arithmetic.scaling import LARGEST, normal_rows, power_of_two, times
from ..errors import SolverStopped
from ..sets.polytope import Polytope
from ..systems.loop import ClosedLoop
from ..systems.network import Layer, MaxoutNetwork
from ..systems.pwa import Mode, PWASystem
from ..typing import Array
from .base import Engine, Escape, LazySequence, Query, Support, Witness

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Units:
    """The units of a loop, and the loop in them.

    Attributes
    ----------
    loop : ClosedLoop
    state : array (n,)
        x = state x'; powers of two.
    inputs : array (m,)
        u = inputs u'; powers of two.
    """

    loop: ClosedLoop
    state: Array
    inputs: Array

    def rows(self, V: Array) -> tuple[Array, Array]:
        """V' (k, n) and the powers of two `factor` (k,) with V' x' = factor V x."""
        return _rows(self, V.shape, V.tobytes())

    def polytope(self, P: Polytope) -> Polytope:
        """A Polytope of states in these units."""
        H, factor = self.rows(P.H)
        return _made(Polytope, H=H, h=np.minimum(np.maximum(P.h * factor, -LARGEST), LARGEST))

    def states(self, x: Array) -> Array:
        """States (..., n) of these units in those of the user."""
        return x * self.state

    def witness(self, found: Witness | None) -> Witness | None:
        """A Witness in the units of the user."""
        if found is None:
            return None
        states, disturbances = found.states * self.state, found.disturbances * self.state
        exact = None if found.exact is None else self.escape(found.exact)
        return Witness(states, found.inputs * self.inputs, found.modes, disturbances, exact)

    def escape(self, found: Escape) -> Escape:
        """An Escape in the units of the user."""
        factors = [Fraction(s) for s in self.state.tolist()]
        x, d, after = (
            None if part is None else tuple(value * s for value, s in zip(part, factors))
            for part in (found.state, found.disturbance, found.after)
        )
        assert x is not None  # every Escape has a state
        return Escape(x, found.mode, d, after)

    def support(self, found: Support, factor: Array, engine: Engine, query: Query | None = None) -> Support:
        """A Support along rows V' in the units of the user, along V."""
        witness = LazySequence(len(factor), lambda k: self.witness(found.witness[k]))
        return Support(
            found.value / factor,
            found.bound / factor,
            witness,
            rests_on=found.rests_on,
            resolution=engine.resolution / factor,
            engine=engine.name,
            source=found,
            query=query,
        )

    def stopped(self, stop: SolverStopped, factor: Array, engine: Engine, query: Query | None = None) -> SolverStopped:
        """A SolverStopped whose support is in the units of the user."""
        k = len(factor)
        found = stop.support or Support(np.full(k, -np.inf), np.full(k, np.inf), (None,) * k)
        return SolverStopped(str(stop), self.support(found, factor, engine, query))


@lru_cache(maxsize=128)
def own_units(loop: ClosedLoop) -> Units:
    """The Units of a closed loop: the same object for the same loop.

    Raises
    ------
    ValueError
        If numbers of the loop lie so far apart that they cannot be scaled without rounding.
    """
    system = loop.system
    regions = tuple(mode.region for mode in system.modes)
    network, regions, X, U, s, t = _parts(loop.network, regions, system.state_set, system.input_set)
    sets = {D: D.in_units(s) for D in {mode.disturbance for mode in system.modes}}
    modes = tuple(
        _made(
            Mode,
            A=times(mode.A, s / s[:, None]),
            B=times(mode.B, t / s[:, None]),
            p=times(mode.p, 1 / s),
            region=region,
            disturbance=sets[mode.disturbance],
        )
        for mode, region in zip(system.modes, regions)
    )
    system = _made(PWASystem, modes=modes, state_set=X, input_set=U)
    return Units(_made(ClosedLoop, system=system, network=network), s, t)


@lru_cache(maxsize=128)
def _parts(
    network: MaxoutNetwork, regions: tuple[Polytope, ...], X: Polytope, U: Polytope
) -> tuple[MaxoutNetwork, tuple[Polytope, ...], Polytope, Polytope, Array, Array]:
    """The parts that loops with other A, B, p and D share: network, regions, X and U in the units s and t; s; t."""
    s = X.half_width
    t = U.half_width
    both = np.concatenate([s, t])
    return _network(network, s, t), tuple(P.in_units(both) for P in regions), X.in_units(s), U.in_units(t), s, t


def _network(network: MaxoutNetwork, s: Array, t: Array) -> MaxoutNetwork:
    """The network from x' to u', its neurons scaled to |q'| <= 1 over |x'| <= 1 by interval arithmetic."""
    scale = s
    hidden: list[Layer] = []
    for layer in network.hidden:
        weight = times(layer.weight, scale)
        extent = (np.abs(weight).sum(axis=1) + np.abs(layer.bias)).reshape(layer.width, layer.pool).max(axis=1)
        scale = power_of_two(extent)
        own = 1 / np.repeat(scale, layer.pool)
        hidden.append(Layer(times(weight, own[:, None]), times(layer.bias, own), layer.pool))
    return MaxoutNetwork(tuple(hidden), times(network.weight, scale / t[:, None]), times(network.bias, 1 / t))


@lru_cache(maxsize=128)
def _rows(units: Units, shape: tuple[int, ...], content: bytes) -> tuple[Array, Array]:
    """`Units.rows` of an array with this shape and content."""
    scaled, factor = normal_rows(times(np.frombuffer(content).reshape(shape), units.state))
    scaled.setflags(write=False)
    return scaled, factor


def _made(kind: type[T], **fields: Any) -> T:
    """An object of a frozen class whose fields need no check: they are exact multiples of checked ones."""
    made = object.__new__(kind)
    for name, value in fields.items():
        object.__setattr__(made, name, value)
    return made
