"""What an engine is, and what it answers with."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import ClassVar, NamedTuple

import numpy as np

from ..checks import real_array, require_columns, require_kind, whole_number
from ..results import NOT_STORED, Result
from ..sets.polytope import Polytope
from ..systems.loop import ClosedLoop
from ..typing import Array, IntArray

EXACT = "exact arithmetic"  # what a bound may rest on, the strongest first
COUNTED = "rounding counted"  # floats whose rounding errors are bounded and added
SOLVER = "a solver's word"  # within its tolerances, if the solver is right


@dataclass(frozen=True)
class Escape(Result):
    """A step that leads out of a set, in rational numbers; `steps.successor` replays it.

    Attributes
    ----------
    state, disturbance, after : tuple of n Fraction
        A state of the set, a disturbance of the mode's set, and where they lead: outside the set.
        The last two are None where the state itself has no successor.
    mode : int or None
        Counted from 0.
    """

    state: tuple[Fraction, ...]
    mode: int | None = None
    disturbance: tuple[Fraction, ...] | None = None
    after: tuple[Fraction, ...] | None = None

    def __str__(self) -> str:
        x = [float(f"{float(value):.6g}") for value in self.state]
        if self.after is None or self.disturbance is None or self.mode is None:
            return f"x = {x} has no successor: it lies outside the state set, or no region contains it with its input"
        d, after = ([float(f"{float(value):.6g}") for value in part] for part in (self.disturbance, self.after))
        return f"x = {x}, mode {self.mode + 1}, d = {d} -> {after}"


@dataclass(frozen=True, eq=False)
class Witness(Result):
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
    exact : Escape or None
        Where the trajectory leaves a set: the step that does, in fractions.
    """

    states: Array
    inputs: Array
    modes: IntArray
    disturbances: Array
    exact: Escape | None = None

    def __str__(self) -> str:
        x, u, d = (np.round(part, 6).tolist() for part in (self.states, self.inputs, self.disturbances))
        return "; ".join(
            f"x = {x[k]}, u = {u[k]}, mode {self.modes[k] + 1}, d = {d[k]} -> {x[k + 1]}" for k in range(len(u))
        )


class Query(NamedTuple):
    """What a support function was asked for: h of R_k(F) along the rows of V (k, n), with k = `steps`."""

    loop: ClosedLoop
    F: Polytope
    V: Array
    steps: int


@dataclass(frozen=True, eq=False)
class Support(Result):
    """The support function of a reachable set along k directions, from both sides.

    Attributes
    ----------
    value : array (k,)
        Attained by the witness; -inf where the reachable set is empty.
    bound : array (k,)
        Upper bound; no trajectory exceeds it. Sets are built from it.
    witness : sequence of Witness or None
        One per direction; None where there is no trajectory at all.
    rests_on : str
        What `bound` rests on: `EXACT`, `COUNTED` or `SOLVER`.
    resolution : array (k,) or float
        How far the engine's bounds may lie above the truth, and tie with it (units of v x).
    source : Support or None
        The engine's own answer, in the units of `units.own_units`: a warm start for a smaller set.
    query : Query or None
        The question, in the user's units.
    """

    value: Array
    bound: Array
    witness: Sequence[Witness | None]
    rests_on: str = field(default=COUNTED, kw_only=True)
    resolution: Array | float = field(default=0.0, kw_only=True)
    source: "Support | None" = field(default=None, kw_only=True, repr=False, metadata=NOT_STORED)
    query: Query | None = field(default=None, kw_only=True, repr=False, metadata=NOT_STORED)

    def __str__(self) -> str:
        return f"support function along {len(self.bound)} directions: bound {self.bound.tolist()}, {self.rests_on}"


class Engine(ABC):
    """An algorithm for the support function of R_k(F), the k-step reachable set (Lemma 2 of [Teichrib2025]).

    A subclass is a frozen dataclass: its fields are its settings. `registry.ENGINES` gives names to engines, so that
    `engine="milp"` means `engine=Milp()`. An engine of your own needs no name; pass the object.

    Attributes
    ----------
    name : str
    resolution : float
        How far `bound` may lie above the true value, and tie with it, relative to the size of X. 0 for engines whose
        error is of the order of rounding.
    time_limit : float or None
        Seconds for one call of `mireach.support`, the check that Phi lies in U included.
    """

    name: ClassVar[str]
    resolution: ClassVar[float] = 0.0
    time_limit: float | None = None

    @property
    def software(self) -> str:
        """The program that computes the bounds, as a certificate names it."""
        return self.name

    @abstractmethod
    def support(self, loop, F, V, steps=1, *, cutoff=None, warm_start=None) -> Support:
        """The support function of R_k(F) along the rows of V.

        Parameters
        ----------
        loop : ClosedLoop
            In its own units (`units.own_units`): X and U reach to between 1/2 and 1 along every axis. Phi lies in U.
        F : Polytope
            States outside X have no successor: F & X counts. It may be empty or flat.
        V : array (k, n)
            Directions, one per row, with a largest entry between 1/2 and 1.
        steps : int
            The k of R_k.
        cutoff : array (k,) or None
            An engine may stop at a bound that is not above the cutoff.
        warm_start : Support or None
            An earlier answer of this engine for the same loop, V and steps and a larger F. An engine may ignore it.

        Returns
        -------
        Support
            `bound` is not below the supremum over all modes whose closed region contains (x, Phi(x)); inf where no
            bound was found. `value` is attained by `witness`; without a witness (None) it is -inf. Both are -inf if no
            state of F has a successor.

        Raises
        ------
        SolverStopped
            If `time_limit` came first; its `support` holds the bounds so far.
        """


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


def standing(loop, x, exact=None):
    """A trajectory of no steps at x (n,), as a Witness."""
    n, m = loop.system.state_size, loop.system.input_size
    return Witness(np.asarray(x)[None], np.zeros((0, m)), np.zeros(0, int), np.zeros((0, n)), exact)


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
