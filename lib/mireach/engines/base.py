"""What every engine answers with."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ..checks import real_array, require_columns, require_kind, whole_number
from ..sets.polytope import Polytope
from ..systems.loop import ClosedLoop

EXACT = "exact arithmetic"  # what a bound may rest on, the strongest first
COUNTED = "rounding counted"  # floats whose rounding errors are bounded and added
SOLVER = "a solver's word"  # within its tolerances, if the solver is right


@dataclass(frozen=True, eq=False)
class Witness:
    """A trajectory of the closed loop that attains a value.

    Attributes
    ----------
    states : array (steps + 1, n)
        From a state of F to the state in which the value is attained.
    inputs : array (steps, m)
        Phi of the states.
    modes : array (steps,) of int
        The mode that acts at each step, counted from 0; it matters where regions share a boundary.
    disturbances : array (steps, n)
    """

    states: np.ndarray
    inputs: np.ndarray
    modes: np.ndarray
    disturbances: np.ndarray

    def __str__(self):
        x, u, d = (np.round(part, 6).tolist() for part in (self.states, self.inputs, self.disturbances))
        return "; ".join(
            f"x = {x[k]}, u = {u[k]}, mode {self.modes[k] + 1}, d = {d[k]} -> {x[k + 1]}" for k in range(len(u))
        )


@dataclass(frozen=True, eq=False)
class Support:
    """The support function of a reachable set along k directions, from both sides.

    Attributes
    ----------
    value : array (k,)
        Attained by the witness; -inf where the reachable set is empty.
    bound : array (k,)
        Upper bound; no trajectory exceeds it. Sets are built from it.
    witness : sequence of Witness or None
        One a direction; None where there is no trajectory at all.
    rests_on : str
        What `bound` rests on: `EXACT`, `COUNTED` or `SOLVER`.
    resolution : array (k,) or float
        How far the engine's bounds may lie above the truth, and tie with it (units of v x).
    source : Support or None
        The engine's own answer, in the units of `units.own_units`; it helps as `known` for a smaller set.
    """

    value: np.ndarray
    bound: np.ndarray
    witness: Sequence
    rests_on: str = field(default=COUNTED, kw_only=True)
    resolution: np.ndarray | float = field(default=0.0, kw_only=True)
    source: "Support | None" = field(default=None, kw_only=True, repr=False)


class Lazily(Sequence):
    """A sequence whose entry i is make(i), made when it is first asked for; pickled it is a tuple."""

    def __init__(self, count, make):
        self._indices, self._make, self._made = range(count), make, {}

    def __reduce__(self):
        return tuple, (list(self),)

    def __len__(self):
        return len(self._indices)

    def __getitem__(self, i):
        chosen = self._indices[i]
        return tuple(map(self._entry, chosen)) if isinstance(chosen, range) else self._entry(chosen)

    def _entry(self, i):
        if i not in self._made:
            self._made[i] = self._make(i)
        return self._made[i]


def empty_support(count, rests_on=COUNTED):
    """The support function of the empty set along `count` directions."""
    nothing = np.full(count, -np.inf)
    return Support(nothing, nothing, (None,) * count, rests_on=rests_on)


def replay(loop, x0, modes, disturbances):
    """The trajectory from x0 under given modes (steps,) and disturbances (steps, n), as a Witness."""
    states, inputs = [np.asarray(x0, float)], []
    for i, d in zip(modes, disturbances):
        inputs.append(loop.network(states[-1]))
        states.append(loop.system.modes[i].successor(states[-1], inputs[-1], d))
    return Witness(np.array(states), np.array(inputs), np.asarray(modes, int), np.asarray(disturbances, float))


def checked_query(loop, F, V, steps):
    """V as an array (k, n) and steps as an int, after all arguments of a query have been looked at.

    Raises
    ------
    ValueError
        If F or V do not fit the state, or steps is not a positive whole number.
    """
    require_kind(loop, ClosedLoop, "loop")
    require_kind(F, Polytope, "F")
    n = loop.system.state_size
    V = real_array(V, "V", 2)
    require_columns(V, n, "V", "the state's size")
    if F.dimension != n:
        raise ValueError(f"F lies in R^{F.dimension}, but the state has {n} entries")
    return V, whole_number(steps, "steps", 1)
