"""The interface of an engine, and the types of its results.

`Engine` says how to write an engine of your own, and names the parts that it is built from.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar, overload

import numpy as np

from ..arithmetic.rational import nearest, rational
from ..checks import real_array, require_columns, require_kind, whole_number
from ..results import NOT_STORED, Result
from ..sets.polytope import Polytope
from ..systems.loop import ClosedLoop
from ..typing import Array, ArrayLike, IntArray

EXACT = "exact arithmetic"  # what a bound may rest on, the strongest first
COUNTED = "rounding counted"  # floats whose rounding errors are bounded and added
SOLVER = "a solver's word"  # within its tolerances, if the solver is right

T = TypeVar("T")


@dataclass(frozen=True)
class Escape(Result):
    """A step that leads out of a set, in rational numbers; `steps.successor` computes it again.

    Attributes
    ----------
    state, disturbance, after : tuple of n Fraction
        A state of the set, a disturbance of the mode's set, and the successor, which lies outside the set.
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
        The step in fractions with which the trajectory leaves a set; None where no set is left.
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
    """The arguments of a support function: h of R_k(F) along the rows of V (l, n), with k = `steps`."""

    loop: ClosedLoop
    F: Polytope
    V: Array
    steps: int


@dataclass(frozen=True, eq=False)
class Support(Result):
    """Upper bounds and attained values of the support function of a reachable set along k directions.

    Attributes
    ----------
    value : array (k,)
        Attained by the witness; -inf without a witness, and where the reachable set is empty.
    bound : array (k,)
        Upper bound; no trajectory exceeds it. Sets are built from it.
    witness : sequence of Witness or None
        One per direction; None where no trajectory was found.
    rests_on : str
        What `bound` rests on: `EXACT`, `COUNTED` or `SOLVER`.
    resolution : array (k,) or float
        `Engine.resolution` in units of v x, which `mireach.support` sets: a bound that exceeds a limit by less is a
        tie, not yet a violation.
    engine : str
        The name of the engine. `mireach.support` sets it.
    source : Support or None
        The result of the engine, in the units of `units.own_units`: a warm start for a smaller set. `mireach.support`
        sets it.
    query : Query or None
        The arguments, in the user's units. `mireach.support` sets it.
    """

    value: Array
    bound: Array
    witness: Sequence[Witness | None]
    rests_on: str = field(default=COUNTED, kw_only=True)
    resolution: Array | float = field(default=0.0, kw_only=True)
    engine: str = field(default="", kw_only=True)
    source: "Support | None" = field(default=None, kw_only=True, repr=False, metadata=NOT_STORED)
    query: Query | None = field(default=None, kw_only=True, repr=False, metadata=NOT_STORED)

    def __str__(self) -> str:
        return f"support function along {len(self.bound)} directions: bound {self.bound.tolist()}, {self.rests_on}"


class Engine(ABC):
    """An algorithm for the support function of R_k(F), the k-step reachable set (Lemma 2 of [Teichrib2025]).

    A subclass is a frozen dataclass with a `name` and a method `support`; its fields are its settings. Pass an object
    of it wherever the package takes an `engine`. It need not be registered: `registry.ENGINES` only maps short names
    to the engines of the package, so that `engine="milp"` means `engine=Milp()`.

    Attributes
    ----------
    name : str
        The name of the engine in messages and reports.
    resolution : float
        A tolerance that verdicts allow, relative to the size of X, at most 1e-5. A bound that exceeds a limit by less
        is a tie, and "proven" then says "to within" this tolerance where exact arithmetic cannot decide. It is the
        tolerance of a solver, and not how loose the bounds are: an engine with loose bounds keeps 0, as does one
        whose error is of the order of rounding.
    time_limit : float or None
        Seconds for one call of `mireach.support`, the check that Phi lies in U included. Declare it as a field if the
        engine has such a setting: `mireach.support` then passes a copy of the engine with the seconds that are left.
        None is no limit.

    Notes
    -----
    `mireach.support` checks the arguments, converts the loop, F, V and the cutoff into the loop's own units
    (`units.own_units`), checks that Phi lies in U, calls `support`, and converts the answer back. So an engine never
    sees the units of the user, and tolerances relative to 1 are relative to the size of X. `source` and `query` of the
    answer are set there, too.

    The results of the package are proofs for every engine that guarantees two properties:

    - No trajectory from F exceeds `bound`, for any mode on a shared boundary and any disturbance. An engine that has no
      bound along a row returns inf there: a bound is never a guess. `rests_on` says what the bound rests on: `EXACT`
      without rounding, `COUNTED` if bounds on all rounding errors are included, `SOLVER` if a solver is trusted. With
      `SOLVER`, exact arithmetic decides wherever the loop has few enough cells. Elsewhere a bound counts only if the
      engine states the tolerance of its solver as its `resolution`: the verdict then holds to within this tolerance and
      says that it is a solver's word. Without one, the verdict is "unknown". So an estimate never proves anything.
    - `value` is attained by `witness`, a trajectory from F & X whose states before the last lie in X.

    An engine may be called from several threads and must not change its arguments. Keep random numbers reproducible:
    draw from a generator with a seed.

    See Also
    --------
    checked_query : the arguments as arrays, for engines that are also called directly.
    empty_support : the answer where F & X is empty.
    bounds.proven_support : bounds of a polytope, such as a disturbance set.
    boxes.bound_loop : bounds of k steps over boxes of states, from intervals; `boxes.root_box` is a box around F.
    attained.attained : a value and its witness in rational arithmetic, from trajectories in floats.
    replay : a Witness from a state, modes and disturbances.
    LazySequence : witnesses that are computed when they are read.

    Examples
    --------
    A complete engine. Its bounds count their rounding errors, so that what they prove is proven. They are loose, since
    they are those of a box around F & X. It attains no values, so that exact arithmetic alone refutes.

    >>> from dataclasses import dataclass
    >>> import numpy as np
    >>> import mireach as mr
    >>> from mireach.engines.boxes import bound_loop, root_box
    >>> from mireach.engines.bounds import proven_support
    >>> @dataclass(frozen=True)
    ... class Intervals(Engine):
    ...     name = "intervals"
    ...
    ...     def support(self, loop, F, V, steps=1, *, cutoff=None, warm_start=None):
    ...         V, steps = checked_query(loop, F, V, steps)
    ...         start = F & loop.system.state_set
    ...         if start.is_empty:
    ...             return empty_support(len(V))
    ...         spread = np.array([proven_support(mode.disturbance, V) for mode in loop.system.modes])
    ...         bounds = bound_loop(loop, root_box(loop, start, steps), steps).highest_state(loop, V, spread)
    ...         return Support(np.full(len(V), -np.inf), bounds[0], (None,) * len(V))
    >>> loop = mr.case_study("pwa").loop
    >>> F, V = mr.Polytope.box([0, 0], [1, 1]), mr.directions(4)
    >>> bool((mr.support(loop, F, V, 2, Intervals()).bound >= mr.support(loop, F, V, 2).bound).all())
    True
    >>> print(mr.safe_set(loop, engine=Intervals()))
    safe set: proven; R1(F1) lies in X, so F1 is RPI; exact arithmetic
    """

    name: ClassVar[str]
    resolution: ClassVar[float] = 0.0
    time_limit: float | None = None

    @property
    def software(self) -> str:
        """The name of the program that computes the bounds, for certificates."""
        return self.name

    def within(self, seconds: float) -> "Engine":
        """This engine with another time limit.

        Parameters
        ----------
        seconds : float
        """
        return replace(self, time_limit=seconds)  # type: ignore[type-var]  # a subclass is a dataclass

    @abstractmethod
    def support(
        self,
        loop: ClosedLoop,
        F: Polytope,
        V: ArrayLike,
        steps: int = 1,
        *,
        cutoff: Array | None = None,
        warm_start: Support | None = None,
    ) -> Support:
        """The support function of R_k(F) along the rows of V.

        Parameters
        ----------
        loop : ClosedLoop
            In its own units (`units.own_units`): the largest |x_i| over X, and the largest |u_i| over U, lie between
            1/2 and 1 for every i. Phi lies in U.
        F : Polytope
            States outside X have no successor: F & X counts. It may be empty or flat.
        V : array (k, n)
            Directions, one per row, with a largest entry between 1/2 and 1.
        steps : int
            The k of R_k.
        cutoff : array (k,) or None
            An engine may stop as soon as its bound is not above the cutoff. It may ignore the cutoff.
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
            If `time_limit` was reached first; its `support` holds the bounds so far.
        """

    def cut_support(self, loop: ClosedLoop, F: Polytope, V: Array) -> Array:
        """Upper bounds of the support function of R_1(F) & X along the rows of V. An engine may lack this method.

        They must be tight up to rounding: `safe_set` reads from them that its sequence has come to rest.

        Parameters
        ----------
        loop : ClosedLoop
        F : Polytope
        V : array (k, n)
            All three as in `support`.

        Returns
        -------
        array (k,)
            -inf where no state of F has a successor in X.

        Raises
        ------
        ValueError
            If the engine has no such bounds.
        """
        raise ValueError(f'the engine "{self.name}" has no bounds of R_1(F) & X (cut_support); use engine="cells"')

    @property
    def cuts(self) -> bool:
        """Whether the engine has `cut_support`."""
        return type(self).cut_support is not Engine.cut_support


class LazySequence(Sequence[T], Generic[T]):
    """A sequence whose entry i is make(i), computed when it is first read; pickled it is a tuple."""

    def __init__(self, count: int, make: Callable[[int], T]) -> None:
        self._indices = range(count)
        self._make = make
        self._made: dict[int, T] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        return tuple, (list(self),)

    def __len__(self) -> int:
        return len(self._indices)

    @overload
    def __getitem__(self, i: int) -> T: ...

    @overload
    def __getitem__(self, i: slice) -> tuple[T, ...]: ...

    def __getitem__(self, i: int | slice) -> T | tuple[T, ...]:
        chosen = self._indices[i]
        return tuple(map(self._entry, chosen)) if isinstance(chosen, range) else self._entry(chosen)

    def _entry(self, i: int) -> T:
        if i not in self._made:
            self._made[i] = self._make(i)
        return self._made[i]


def empty_support(count: int, rests_on: str = COUNTED) -> Support:
    """The support function of the empty set along `count` directions."""
    nothing = np.full(count, -np.inf)
    return Support(nothing, nothing, (None,) * count, rests_on=rests_on)


def replay(loop: ClosedLoop, x0: ArrayLike, modes: Iterable[int], disturbances: Iterable[ArrayLike]) -> Witness:
    """The trajectory from x0 under given modes (steps,) and disturbances (steps, n), as a Witness."""
    modes, disturbances = list(modes), list(disturbances)
    states: list[Array] = [np.asarray(x0, float)]
    inputs: list[Array] = []
    for i, d in zip(modes, disturbances):
        inputs.append(loop.network(states[-1]))
        states.append(loop.system.modes[i].successor(states[-1], inputs[-1], d))
    return Witness(np.array(states), np.array(inputs), np.asarray(modes, int), np.asarray(disturbances, float))


def witness_of(loop: ClosedLoop, escape: Escape) -> Witness:
    """A step in fractions as a Witness, rounded to floats; `exact` is the step itself.

    Where the state has no successor, the Witness has no steps.
    """
    x = np.array([nearest(entry) for entry in rational(list(escape.state))])
    if escape.mode is None or escape.disturbance is None:
        n, m = len(x), loop.system.input_size
        return Witness(x[None], np.zeros((0, m)), np.zeros(0, int), np.zeros((0, n)), escape)
    d = np.array([nearest(entry) for entry in rational(list(escape.disturbance))])
    return replace(replay(loop, x, [escape.mode], [d]), exact=escape)


def checked_query(loop: ClosedLoop, F: Polytope, V: ArrayLike, steps: int) -> tuple[Array, int]:
    """V as an array (k, n) and steps as an int, after all arguments of a query are checked.

    Raises
    ------
    TypeError
        If loop is no ClosedLoop or F no Polytope.
    ValueError
        If F or V do not fit the state, or steps is not a positive whole number.
    """
    require_kind(loop, ClosedLoop, "loop")
    require_kind(F, Polytope, "F")
    n = loop.system.state_size
    directions = real_array(V, "V", 2)
    require_columns(directions, n, "V", "the state's size")
    if F.dimension != n:
        raise ValueError(f"F lies in R^{F.dimension}, but the state has {n} entries")
    return directions, whole_number(steps, "steps", 1)
