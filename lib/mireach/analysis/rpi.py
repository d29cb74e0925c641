"""Whether a set is robustly positively invariant (RPI): R_1(F) lies in F."""

from dataclasses import dataclass

import numpy as np

from ..arithmetic.rational import binary, dot, fractions, nearest, rational, strict_point
from ..checks import require_kind
from ..engines.base import EXACT, Engine, Escape, Witness, witness_of
from ..engines.registry import engine_for
from ..engines.units import own_units
from ..results import Result, Verdict
from ..sets.polytope import Polytope
from ..systems.loop import ClosedLoop
from ..tolerances import CLEAR
from ..typing import Array, Rational
from .arguments import tolerance
from .comparison import Comparison, believed, compare


@dataclass(frozen=True, eq=False)
class RPICheck(Result):
    """Result of `check_rpi`.

    Attributes
    ----------
    verdict : Verdict
    margin : array (l,)
        Lower bound on the distance h - h_(R_1(F))(H), from the proven bound; negative where a facet is not shown to
        hold. The MILP stops as soon as a facet is proven, so its positive margins may be far smaller than the true
        distance. The margins of the cells are accurate.
    witness : Witness or None
        A step that leaves F, if the verdict is "refuted"; the state alone, if F has states outside X. The state and the
        disturbance are floats that lie in their sets, and the step exceeds the facet in exact arithmetic, unless F or D
        is so thin that there are no such floats. `witness.exact` is the step in fractions.
    reason : str
    settled : str
        What the verdict rests on: "exact arithmetic", "rounding counted" (bounds that include all rounding errors), or
        a tolerance; then "a solver's word" says that a solver is trusted.
    """

    verdict: Verdict
    margin: Array
    witness: Witness | None
    reason: str
    settled: str = ""

    def __str__(self) -> str:
        return f"RPI: {self.verdict}; {self.reason}"

    @property
    def escape(self) -> Escape | None:
        """The step of the witness in fractions."""
        return None if self.witness is None else self.witness.exact


def check_rpi(
    loop: ClosedLoop, F: Polytope, engine: Engine | str | None = None, *, tol: float | None = None
) -> RPICheck:
    """Whether R_1(F) lies in F (Def. RPI), by h of R_1(F) along H <= h for every facet of F.

    Parameters
    ----------
    loop : ClosedLoop
    F : Polytope
    engine : Engine, str or None
        As in `support`.
    tol : float or None
        A facet holds if bound <= h + tol, in units of h. None means no tolerance if exact arithmetic can decide where
        rounding leaves a doubt: for two states, and for more if the loop has few cells. Otherwise it means the
        resolution of the engine: 1e-6 of the size of X for the MILP.

    Returns
    -------
    RPICheck

    Raises
    ------
    TypeError
        If an argument is of another kind.
    ValueError
        If F is empty, Phi leaves U, or an argument does not fit.

    See Also
    --------
    safe_set : finds an RPI set.
    prove_rpi : the same for unions of polytopes in the plane.

    Examples
    --------
    >>> import mireach as mr
    >>> loop = mr.case_study("pwa").loop
    >>> mr.check_rpi(loop, mr.safe_set(loop).set).verdict == "proven"
    True
    """
    require_kind(loop, ClosedLoop, "loop")
    require_kind(F, Polytope, "F")
    engine, tol = engine_for(loop, engine), tolerance(tol)
    if F.is_empty:
        raise ValueError("F is empty; there is nothing to check")
    beyond = outside(loop, F)
    if beyond is not None:
        return beyond
    found = compare(loop, F, F.H, F.h, engine, tol, cutoff=F.h)
    proven = found.holds.all()
    escape = None if proven else found.first_escape()
    if escape is None and not proven:
        found = compare(loop, F, F.H, F.h, engine, tol, thorough=True, cutoff=F.h)
        proven = found.holds.all()
    margin = F.h - found.bound
    if proven:
        within = "" if (margin >= 0).all() else f" to within {-margin.min():.1g}"
        return RPICheck(Verdict.PROVEN, margin, None, f"R1(F) lies in F{within}; {found.settled}", found.settled)
    margin[~(found.holds | (found.bound > F.h))] = -np.inf  # a solver's word alone shows no margin
    if escape is not None:
        row, witness = escape
        excess = exact_excess(witness, F.H[row], F.h[row])
        reason = f"facet {row + 1} is passed by {nearest(excess):.3g}: {witness}{decimal_hint(loop, F.H[row], excess)}"
        return RPICheck(Verdict.REFUTED, margin, witness, reason, EXACT)
    worst = found.worst
    over, attained = found.bound[worst] - F.h[worst], found.image.value[worst] - F.h[worst]
    gap = f"bound - h = {over:.3g}, attained - h = {attained:.3g}"
    word = f"; {believed(engine)}" if found.is_believed_only else ""
    return RPICheck(Verdict.UNKNOWN, margin, None, f"facet {worst + 1} is not settled: {gap}{word}{found.stopped}")


# -- parts --------------------------------------------------------------------------------------------


def outside(loop: ClosedLoop, F: Polytope) -> RPICheck | None:
    """A refuted RPICheck if F has a state outside X, or None."""
    X = loop.system.state_set
    if F.is_subset(X):
        return None
    for row, (a, b) in enumerate(zip(X.H, X.h)):
        x = F.exact_maximum(a)
        if x.value > binary(b):
            state = x.point or strict_point(binary(F.H), binary(F.h), [tuple(-e for e in binary(a))], [-binary(b)])
            assert state is not None  # the supremum of a x over F exceeds b
            reason = (
                f"F holds states outside the state set, beyond its row {row + 1}, where the loop has no successor"
                f"{'' if x.point is None else decimal_hint(loop, a, x.value - binary(b))}"
            )
            nothing = np.full(len(F.h), -np.inf)
            witness = witness_of(loop, Escape(fractions(state)))
            return RPICheck(Verdict.REFUTED, nothing, witness, reason, EXACT)
    return None


def exact_excess(witness: Witness, v: Array, limit: float) -> Rational:
    """By how much the exact step of a witness exceeds the limit of v x <= limit, as an fmpq."""
    if witness.exact is None or witness.exact.after is None:
        raise ValueError("the witness holds no step in fractions")
    return dot(binary(v), rational(witness.exact.after)) - binary(limit)


def decimal_hint(loop: ClosedLoop, v: Array, excess: Rational) -> str:
    """Addition to a message if a limit is exceeded by no more than the rounding of decimals to floats."""
    weight = own_units(loop).rows(np.asarray(v, float)[None])[1][0]
    if abs(nearest(excess)) * weight > CLEAR:
        return ""
    return "; this is as little as the rounding of a decimal: every number counts as the float that it is"


def require_rpi(loop: ClosedLoop, F: Polytope, V: Array, engine: Engine, tol: float | None) -> Comparison:
    """The Comparison of R_1(F) with the rows of F among V; ValueError unless F lies in X and is RPI for this loop."""
    check = outside(loop, F)
    if check is None:
        found = compare(loop, F, V, F.offsets(V), engine, tol)
        if found.holds.all():
            return found
        check = check_rpi(loop, F, engine, tol=tol)
    raise ValueError(f"the set to start from is not shown to be RPI for this loop: {check.reason}")
