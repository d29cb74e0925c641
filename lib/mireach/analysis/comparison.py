"""Whether R_1(F) lies in half-spaces. Floats propose the answer; a proof decides it.

A row "holds" because of a bound that includes all rounding errors or, if floats do not decide it, because of exact
arithmetic. R_1(F) "leaves" a half-space because of a step in rational numbers. A loop with three or more states may
have too many cells for exact arithmetic (`FEW_CELLS`). Rows that are then undecided hold to within the resolution of
the MILP, and the result states this. A bound that rests on a solver's word decides no row by itself: it needs exact
arithmetic, or a resolution that the engine states for its solver.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..arithmetic.rational import binary
from ..engines import exact, steps
from ..engines.base import COUNTED, EXACT, SOLVER, Engine, Support, Witness
from ..engines.exact import Exact
from ..engines.exact_cells import FEW_CELLS, MOST_CELLS, cells
from ..engines.registry import engine_for
from ..engines.units import own_units
from ..errors import CellLimitError, SolverStopped
from ..sets.polytope import Polytope
from ..systems.loop import ClosedLoop
from ..tolerances import CLEAR
from ..typing import Array
from .reach import support

WITHIN = "to within {:.0e} of the size of X, {}"


@dataclass(frozen=True, eq=False)
class Comparison:
    """Comparison of R_1(F) with the half-spaces V x <= limit.

    Attributes
    ----------
    loop : ClosedLoop
    F : Polytope
    V : array (k, n)
    limit : array (k,)
    image : Support
        Of R_1(F) along V.
    bound : array (k,)
        The smallest upper bound on h of R_1(F) along V that was computed.
    holds : array (k,) of bool
        Rows along which R_1(F) does not exceed the limit.
    settled : str
        What the result rests on if all rows hold.
    stopped : str
        Why the engine did not finish; "" if it did.
    """

    loop: ClosedLoop
    F: Polytope
    V: Array
    limit: Array
    image: Support
    bound: Array
    holds: NDArray[np.bool_]
    settled: str
    stopped: str = ""
    _steps: dict[int, Witness | None] = field(default_factory=dict, repr=False)

    @property
    def weights(self) -> Array:
        """Factors (k,) that make excesses along different rows comparable, relative to the size of X."""
        return own_units(self.loop).rows(self.V)[1]

    @property
    def worst(self) -> int:
        """The row whose bound exceeds its limit by the largest amount."""
        asked = np.isfinite(self.limit)
        return int(np.argmax(np.where(asked, self.bound - np.where(asked, self.limit, 0), -np.inf) * self.weights))

    @property
    def is_believed_only(self) -> bool:
        """Whether all bounds keep their limits, but some rest on a solver's word that nothing confirms."""
        return not self.holds.all() and bool((self.bound <= self.limit).all())

    def escape(self, row: int) -> Witness | None:
        """A step from F that exceeds the limit of a row in exact arithmetic, or None."""
        if row not in self._steps:
            step = self._passing(row)
            self._steps[row] = None if step is None else step.witness(self.loop, self.V[row], self.limit[row])
        return self._steps[row]

    def first_escape(self) -> tuple[int, Witness] | None:
        """A row with a step that exceeds its limit, the largest excess first; None if no such step is found."""
        excess = (self.image.value - self.limit) * self.weights
        for row in np.argsort(-excess, kind="stable").tolist():
            if not self.holds[row]:
                witness = self.escape(row)
                if witness is not None:
                    return row, witness
        return None

    def _passing(self, row: int) -> steps.Step | None:
        v = self.V[row]
        limit = binary(self.limit[row])
        witness = self.image.witness[row]
        if witness is not None:
            step = steps.farthest_step(self.loop, self.F, v, witness.states[0], int(witness.modes[0]))
            if step is not None and step.value > limit:
                return step
        step = highest_step(self.loop, self.F, v, self.stopped)
        return step if step is not None and step.value > limit else None


def compare(
    loop: ClosedLoop,
    F: Polytope,
    V: Array,
    limit: Array,
    engine: Engine | str | None = None,
    tol: float | None = None,
    thorough: bool = False,
    *,
    cutoff: Array | None = None,
    warm_start: Support | None = None,
) -> Comparison:
    """Compare R_1(F) with the half-spaces V x <= limit.

    Parameters
    ----------
    loop : ClosedLoop
    F : Polytope
    V : array (k, n)
    limit : array (k,)
        inf for rows without a limit.
    engine : Engine, str or None
        As in `reach.support`.
    tol : float or None
        A row holds if its bound is at most limit + tol (units of V x). None is no tolerance at all if exact arithmetic
        can decide: for two states, and for more if the loop has few cells, up to 2,000 for three states and half as
        many for each further one. Otherwise None is the resolution of the engine. If the bounds rest on a solver's
        word, exact arithmetic decides with any tol; where it cannot, rows hold only for engines with a resolution
        above 0.
    thorough : bool
        Whether exact arithmetic must decide every row in doubt, even if floats show that another row clearly does not
        hold.
    cutoff, warm_start
        As in `reach.support`.

    Returns
    -------
    Comparison

    Notes
    -----
    What decides the rows with a limit:

    ==============  ============  ==================================  =============================================
    bounds          tol           with exact arithmetic               without (more states, or a time limit passed)
    ==============  ============  ==================================  =============================================
    proven          a number      the bound <= limit + tol            the same
    proven          None          the bound, then the exact value     the bound <= limit + resolution (two states: 0)
    solver's word   a number      the exact value <= limit + tol      the bound <= limit + tol, if resolution > 0
    solver's word   None          the exact value <= limit            as for proven bounds, if resolution > 0
    ==============  ============  ==================================  =============================================

    Exact arithmetic is left out where a value clearly exceeds a limit, unless `thorough`: then not all rows hold.
    """
    engine = engine_for(loop, engine)
    asked = np.isfinite(limit)
    try:
        found, stopped = support(loop, F, V, engine=engine, cutoff=cutoff, warm_start=warm_start), ""
    except SolverStopped as stop:
        if stop.support is None:
            raise
        found, stopped = stop.support, f"; {stop}"
    bound = found.bound
    settled = found.rests_on
    allowed = limit + (0.0 if tol is None else tol)
    believed = settled == SOLVER
    holds = ~asked if believed else ~asked | (bound <= allowed)
    if not holds.all() and (tol is None or believed):
        resolved = holds | _resolved(loop, found, allowed, tol)
        clear = asked & ((found.value - allowed) * own_units(loop).rows(V)[1] > CLEAR)
        if (thorough or resolved.all() or not clear.any()) and _can_be_exact(loop, stopped):
            rows = np.flatnonzero(~holds)
            bound = bound.copy()
            bound[rows] = support(loop, F, V[rows], engine=Exact(_most_cells(loop))).bound
            holds, settled = holds | (bound <= allowed), EXACT
        elif engine.resolution:  # without one, a solver's word counts nowhere
            holds, settled = resolved, WITHIN.format(engine.resolution, settled)
    if tol is not None and not (bound <= limit)[asked].all():
        settled = f"to within tol = {tol:g}, {settled}"
    return Comparison(loop, F, V, limit, found, bound, holds, settled, stopped)


def highest_step(loop: ClosedLoop, F: Polytope, v: Array, stopped: str = "") -> steps.Step | None:
    """The step from F with the largest v x+, in exact arithmetic.

    Parameters
    ----------
    loop : ClosedLoop
    F : Polytope
    v : array (n,)
    stopped : str
        Not empty if a time limit has passed already.

    Returns
    -------
    steps.Step or None
        None if the loop has too many cells for exact arithmetic, or F does not meet X.
    """
    if not _can_be_exact(loop, stopped):
        return None
    found = exact.support_steps(loop, F, v[None], _most_cells(loop))
    return None if found is None else found[0]


def _resolved(loop: ClosedLoop, found: Support, allowed: Array, tol: float | None) -> NDArray[np.bool_]:
    """Rows whose bound keeps what is allowed, as far as the engine resolves it, where exact arithmetic cannot decide.

    In the plane nothing counts to within a resolution, only to within a `tol` that is asked for.
    """
    if tol is None and loop.system.state_size == 2:
        return np.zeros(len(allowed), bool)
    return found.bound <= allowed + (found.resolution if tol is None else 0.0)


def is_attained(loop: ClosedLoop, found: Support, V: Array, offsets: Array) -> bool:
    """Whether the values of a Support reach offsets (k,) along V, up to rounding and the resolution of its engine.

    Where they do not, the bounds may be loose: what follows from them about the largest value of v x is not shown.
    """
    return bool((found.value >= offsets - found.resolution - CLEAR / own_units(loop).rows(V)[1]).all())


def _can_be_exact(loop: ClosedLoop, stopped: str) -> bool:
    """Whether exact arithmetic can afford the cells of a loop, and no time limit has passed that it would exceed."""
    if stopped and loop.system.state_size > 2:
        return False
    try:
        cells(own_units(loop).loop, _most_cells(loop))
    except CellLimitError:
        return False
    return True


def _most_cells(loop: ClosedLoop) -> int:
    """The cells that exact arithmetic can afford for a loop: in the plane as many as it ever keeps."""
    return MOST_CELLS if loop.system.state_size == 2 else FEW_CELLS


def believed(engine: Engine) -> str:
    """The reason why bounds that keep all limits prove nothing; see `Comparison.is_believed_only`."""
    return (
        f"the bounds of the engine {engine.name} are {SOLVER}, its resolution is {engine.resolution:g}, "
        "and the loop has too many cells for exact arithmetic"
    )


def weaker(*settled: str) -> str:
    """The weakest of several foundations of a result."""
    order = {EXACT: 0, COUNTED: 1}
    return max(settled, key=lambda one: 3 if SOLVER in one else order.get(one, 2), default=EXACT)
