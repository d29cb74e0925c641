"""A linear program that is built row by row and solved for many objectives (HiGHS, warm-started).

Bounds do not depend on HiGHS. Its multipliers are only a proposal: weak duality turns any multipliers into a bound,
rounding included (`weak_duality.Rows.bound`). A program is called empty by `bound` only if a ray proves it.
`maximize` returns HiGHS's own answer, to within its tolerances.
"""

import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from threading import Lock
from typing import Any, Concatenate, ParamSpec, TypeVar

import highspy
import numpy as np
from numpy.typing import NDArray

from ..errors import SolverError
from ..tolerances import FEASIBILITY, INTEGRALITY, LOOSE_BOUND, MIP_GAP, TINY_COEFFICIENT
from ..typing import Array, ArrayLike, IntArray
from .branch_and_bound import BRANCHED, IntegerOptimum, Node, Stop, branch, prove
from .weak_duality import Row, Rows, joint_limits

RELAXED = (1e-9, 1e-7, 1e-5, 1e-3)  # rows are widened by this where HiGHS finds no point and no proof of that
WELL_SCALED = 2.0**-10  # HiGHS's own bound is not used where a row has coefficients of more different sizes

LARGEST = 1e19  # lower limits above it, and upper limits below its negative, are this for HiGHS

P = ParamSpec("P")
T = TypeVar("T")

DUAL, PRIMAL = 1, 4  # HiGHS's numbers for its simplex methods; the dual one is its default
CONCLUSIVE = (
    highspy.HighsModelStatus.kOptimal,
    highspy.HighsModelStatus.kInfeasible,
    highspy.HighsModelStatus.kUnbounded,
)
STOPPED = (highspy.HighsModelStatus.kTimeLimit, highspy.HighsModelStatus.kSolutionLimit)


@dataclass(frozen=True)
class Optimum:
    """Answer to one objective.

    Attributes
    ----------
    value : float
        -inf if no point satisfies the constraints, inf if the objective is unbounded.
    point : array (columns,) or None
        Where `value` is attained; None if `value` is not finite.
    """

    value: float
    point: Array | None


def _alone(method: "Callable[Concatenate[LinearProgram, P], T]") -> "Callable[Concatenate[LinearProgram, P], T]":
    """Let one thread at a time into a method of a LinearProgram."""

    @wraps(method)
    def alone(self: "LinearProgram", /, *arguments: P.args, **options: P.kwargs) -> T:
        with self._lock:
            return method(self, *arguments, **options)

    return alone


class LinearProgram:
    """max c x subject to lower <= A x <= upper and bounds on x, for one c after another.

    Threads that ask the same program wait for each other.

    Attributes
    ----------
    lower, upper : array (columns,)
    binaries : list of int
        Columns that `maximize_integer` holds to 0 and 1; `maximize` relaxes them.
    first : list of int
        Those of them that are branched on before the others.
    end : float
        The `perf_counter` at which whoever builds the program wants to be done; see `bounds.upper_bound`.

    Examples
    --------
    >>> lp = LinearProgram()
    >>> x = lp.add_columns([0, 0], [1, 1])
    >>> lp.add_row(x, [1, 1], upper=1.5)
    >>> lp.maximize(x, [1, 2]).value
    2.5
    """

    def __init__(self) -> None:
        self.highs: Any = highspy.Highs()  # its types leave out some of its methods
        options: dict[str, Any] = {
            "output_flag": False,  # first: HiGHS prints its name and version with the first thing that it logs
            "presolve": "off",
            "primal_feasibility_tolerance": FEASIBILITY,
            "dual_feasibility_tolerance": FEASIBILITY,
            "small_matrix_value": TINY_COEFFICIENT,
        }
        for name, setting in options.items():
            self.highs.setOptionValue(name, setting)
        self.highs.changeObjectiveSense(highspy.ObjSense.kMaximize)
        self.lower: Array = np.zeros(0)
        self.upper: Array = np.zeros(0)
        self.binaries: list[int] = []
        self.first: list[int] = []
        self.end = np.inf
        self._costed: IntArray = np.zeros(0, np.int32)  # the columns of the objective
        self._costs: Array = np.zeros(0)
        self._factor = 1.0  # by which HiGHS sees the objective multiplied
        self._declared = 0  # how many binaries HiGHS takes for integers
        self._lock = Lock()
        self._entries: list[Row] = []
        self._powers: list[int] = []  # the exponents of the factors of the rows
        self._cached_rows: Rows | None = None
        self._cached_limits: tuple[Array, Array] | None = None

    @_alone
    def copy(self) -> "LinearProgram":
        """A program of its own with the same constraints, binaries and objective.

        Examples
        --------
        >>> lp = LinearProgram()
        >>> x = lp.add_columns([0], [1])
        >>> other = lp.copy()
        >>> other.set_bounds(x, 0, 3)
        >>> lp.maximize(x, [1]).value, other.maximize(x, [1]).value
        (1.0, 3.0)
        """
        other = LinearProgram()
        other.highs.passModel(self.highs.getLp())
        other.lower = self.lower.copy()
        other.upper = self.upper.copy()
        other.binaries = list(self.binaries)
        other.first = list(self.first)
        other.end = self.end
        other._costed = self._costed
        other._costs = self._costs
        other._factor = self._factor
        other._declared = self._declared
        other._entries = list(self._entries)
        other._powers = list(self._powers)
        other._cached_rows = self._rows()
        return other

    def add_columns(self, lower: ArrayLike, upper: ArrayLike) -> IntArray:
        """Add variables with bounds (k,) each; returns their indices (k,)."""
        lower, upper = np.broadcast_arrays(np.asarray(lower, float), np.asarray(upper, float))
        first = len(self.lower)
        self._cached_rows = None
        self._cached_limits = None
        low, high = lower.ravel(), upper.ravel()
        self.lower = np.concatenate([self.lower, low])
        self.upper = np.concatenate([self.upper, high])
        if (low > LARGEST).any() or (high < -LARGEST).any():
            low, high = np.array([_within_reach(*pair) for pair in zip(low.tolist(), high.tolist())]).T.copy()
        _require_accepted(self.highs.addVars(lower.size, low, high), "variables")
        return np.arange(first, first + lower.size, dtype=np.int32)

    def set_bounds(self, columns: ArrayLike, lower: ArrayLike, upper: ArrayLike) -> None:
        """Change the bounds of existing variables."""
        columns = np.atleast_1d(columns)
        lower = np.broadcast_to(lower, columns.shape)
        upper = np.broadcast_to(upper, columns.shape)
        for column, low, high in zip(columns, lower, upper):
            ends = _within_reach(float(low), float(high))
            _require_accepted(self.highs.changeColBounds(int(column), *ends), "limits")
        self.lower[columns] = lower
        self.upper[columns] = upper
        self._cached_limits = None

    def add_row(
        self, columns: ArrayLike, coefficients: ArrayLike, lower: float = -np.inf, upper: float = np.inf
    ) -> None:
        """Add lower <= coefficients x[columns] <= upper, for distinct columns.

        The row is multiplied by the power of two that brings its largest coefficient into [1/2, 1), so that its length
        does not matter. `bound` proves with these coefficients. HiGHS is given the row without those up to
        `TINY_COEFFICIENT`, widened by what they can contribute where their variables have limits.
        """
        coefficients = np.asarray(coefficients, float)
        lower = float(lower)
        upper = float(upper)
        power = 0
        _, exponent = math.frexp(np.abs(coefficients).max(initial=0))
        scaled = np.ldexp(coefficients, -exponent)
        if exponent < 0 or (np.ldexp(scaled, exponent) == coefficients).all():  # else numbers would become too small
            coefficients = scaled
            power = -exponent
            lower, upper = -_scaled_up(-lower, -exponent), _scaled_up(upper, -exponent)
        used = coefficients.nonzero()
        indices, coefficients = np.asarray(columns, np.int32)[used], coefficients[used]
        row = Row(indices, coefficients, lower, upper)
        size = np.abs(coefficients)
        if size.min(initial=np.inf) <= TINY_COEFFICIENT:
            tiny = size <= TINY_COEFFICIENT
            left_out = indices[tiny]
            most = size[tiny] * np.maximum(np.abs(self.lower[left_out]), np.abs(self.upper[left_out]))
            slack = most[np.isfinite(most)].sum()
            indices = indices[~tiny]
            coefficients = coefficients[~tiny]
            lower -= slack
            upper += slack
        ends = _within_reach(lower, upper)
        _require_accepted(self.highs.addRow(*ends, len(indices), indices, coefficients), "a row")
        self._cached_rows = None
        self._entries.append(row)
        self._powers.append(power)

    def add_rows(
        self, columns: ArrayLike, matrix: ArrayLike, lower: ArrayLike = -np.inf, upper: ArrayLike = np.inf
    ) -> None:
        """Add lower <= matrix x[columns] <= upper, row by row; matrix (r, k), limits (r,) or numbers."""
        matrix = np.atleast_2d(matrix)
        lower = np.broadcast_to(lower, len(matrix))
        upper = np.broadcast_to(upper, len(matrix))
        for row, low, high in zip(matrix, lower, upper):
            self.add_row(columns, row, low, high)

    @_alone
    def maximize(self, columns: ArrayLike, coefficients: ArrayLike) -> Optimum:
        """max coefficients x[columns] over the constraints so far, for distinct columns.

        Returns
        -------
        Optimum

        Raises
        ------
        SolverError
            If HiGHS ends without an answer.
        """
        self._declare_binaries(False)
        self.set_objective(columns, coefficients)
        return self._relaxation()

    def multipliers(self) -> Array:
        """HiGHS's multipliers y (rows,) of the last maximum, of the rows as given: c = A'y to its tolerances."""
        return np.ldexp(self._multipliers(), self._powers)

    @_alone
    def bound(self, columns: ArrayLike, coefficients: ArrayLike) -> float:
        """A number that coefficients x[columns] nowhere exceeds, close to the value of `maximize`.

        Proven by weak duality with HiGHS's multipliers, in floating point with its rounding counted; -inf only if a ray
        proves in the same way that there is no point. It is inf where nothing is proven, as for variables that the
        rows do not bound. Where HiGHS finds no point and no proof of that, the multipliers are those of wider rows.

        Returns
        -------
        float
        """
        self._declare_binaries(False)
        self.set_objective(columns, coefficients)
        lower, upper = self._limits()
        return self._proven(lower, upper).value

    @_alone
    def limits(self) -> tuple[Array, Array]:
        """Two arrays (columns,) between which every point lies: proven as `bound`, where variables have no limits."""
        self._declare_binaries(False)
        return self._limits()

    def _relaxation(self) -> Optimum:
        """The Optimum of the objective, binaries being relaxed."""
        self.highs.run()
        status = self.highs.getModelStatus()
        if status not in CONCLUSIVE:  # the basis of the last objective can be a poor start, the dual simplex can stall
            self.highs.clearSolver()
            self.highs.setOptionValue("simplex_strategy", PRIMAL)
            self.highs.run()
            self.highs.setOptionValue("simplex_strategy", DUAL)
            status = self.highs.getModelStatus()
        if status == highspy.HighsModelStatus.kOptimal:
            point = np.array(self.highs.getSolution().col_value)
            return Optimum(float(self.highs.getInfo().objective_function_value) / self._factor, point)
        if status == highspy.HighsModelStatus.kInfeasible:
            return Optimum(-np.inf, None)
        if status == highspy.HighsModelStatus.kUnbounded:
            return Optimum(np.inf, None)
        if not len(self.lower):  # no variables: the empty sum
            return Optimum(0.0, np.zeros(0))
        raise SolverError(f"HiGHS ended a linear program with {self.highs.modelStatusToString(status)}")

    @_alone
    def maximize_integer(
        self,
        columns: ArrayLike,
        coefficients: ArrayLike,
        *,
        gap: float = MIP_GAP,
        enough: float = -np.inf,
        nodes: int | None = None,
        time_limit: float | None = None,
        presolve: bool | None = None,
    ) -> IntegerOptimum:
        """max coefficients x[columns] over the constraints so far, the `binaries` being 0 or 1.

        Branch and bound, each node bounded as by `bound`. With more than `BRANCHED` binaries HiGHS's MILP solver is run
        first, and what it calls the optimum is what the search has to prove.

        Parameters
        ----------
        columns, coefficients : array (k,)
        gap : float
            Between bound and point, relative and absolute, at which the search may stop.
        enough : float
            A bound that need not be lowered further, such as a value that is attained already.
        nodes : int or None
            At most so many nodes of the search tree. None allows `PROOF_NODES` where HiGHS has an answer of its own;
            it is returned after that, not proven, if all rows are well scaled, and the bound of the tree if not.
        time_limit : float or None
            Seconds.
        presolve : bool or None
            True or False returns the answer of HiGHS's MILP solver, with presolve or without, and nothing is proven.

        Returns
        -------
        IntegerOptimum

        Raises
        ------
        SolverError
            If HiGHS ends without an answer and it alone is asked, or variables without limits leave no bound.

        Notes
        -----
        HiGHS 1.15 has called points optimal that were not, without a word (with presolve on models of five in 10,000
        random sets; without on one of a case study), and feasibility to 1e-9 cuts off points where big-M are large.
        """
        self.set_objective(columns, coefficients)
        stop = Stop(gap, enough, nodes, time_limit)
        if presolve is not None:
            return self._claim(bool(presolve), stop)
        if nodes is not None or len(self.binaries) <= BRANCHED:
            return self._branch(stop)

        def claim(presolve: bool, seconds: float | None) -> IntegerOptimum:
            return self._claim(presolve, Stop(gap, nodes=None, seconds=seconds))

        return prove(claim, self._branch, stop, self._is_well_scaled())

    def _is_well_scaled(self) -> bool:
        """Whether no row has coefficients of very different sizes, so that HiGHS's tolerances mean what they say."""
        return all(np.abs(row.coefficients).min(initial=1) >= WELL_SCALED for row in self._entries)

    def _claim(self, presolve: bool, stop: Stop) -> IntegerOptimum:
        """The IntegerOptimum of HiGHS's MILP solver, in one of its ways; SolverError if it ends without an answer."""
        self._declare_binaries(True)
        self.highs.clearSolver()  # the answer does not depend on what was asked before
        for name, setting in {
            "mip_rel_gap": float(stop.gap),
            "mip_abs_gap": float(stop.gap),
            "mip_feasibility_tolerance": INTEGRALITY,
            "mip_heuristic_run_feasibility_jump": False,  # two thirds of the time on a model with few binaries
            "mip_max_nodes": highspy.kHighsIInf if stop.nodes is None else stop.nodes,
            "time_limit": np.inf if stop.seconds is None else self.highs.getRunTime() + stop.seconds,  # of all its runs
            "presolve": "choose" if presolve else "off",
        }.items():
            self.highs.setOptionValue(name, setting)
        self.highs.run()
        self.highs.setOptionValue("presolve", "off")
        self.highs.setOptionValue("time_limit", np.inf)
        status = self.highs.getModelStatus()
        info = self.highs.getInfo()
        solution = self.highs.getSolution()
        if status == highspy.HighsModelStatus.kInfeasible:
            return IntegerOptimum(-np.inf, None, True, False)
        if status not in (highspy.HighsModelStatus.kOptimal, *STOPPED):
            raise SolverError(f"HiGHS ended the MILP with {self.highs.modelStatusToString(status)}")
        attained = solution.value_valid and np.isfinite(info.objective_function_value)
        point = np.array(solution.col_value) if attained else None
        finished = status == highspy.HighsModelStatus.kOptimal
        return IntegerOptimum(float(info.mip_dual_bound) / self._factor, point, finished, False)

    def _branch(self, stop: Stop) -> IntegerOptimum:
        """Branch and bound, each node of which is a linear program."""
        self._declare_binaries(False)
        self.highs.passModel(self.highs.getLp())  # last digits do not depend on how it was scaled for other questions
        self.highs.setOptionValue("simplex_iteration_limit", 1000 + 20 * (len(self._entries) + len(self.lower)))
        columns = np.array(self.binaries, np.int32)
        first = set(self.first)
        order = np.array([k if column in first else k + len(columns) for k, column in enumerate(columns)])
        lower, upper = (ends.copy() for ends in self._limits())
        root = self._rows().bound(self._objective(), np.zeros(len(self._entries)), lower, upper)
        low, high = lower[columns], upper[columns]

        def relaxation(low: Array, high: Array) -> tuple[float, Array | None]:
            self.highs.changeColsBounds(len(columns), columns, low, high)
            lower[columns] = low
            upper[columns] = high
            found = self._proven(lower, upper)
            return found.value, found.point

        try:
            return branch(Node(root, low, high), order, relaxation, columns, stop)
        finally:
            self.highs.changeColsBounds(len(columns), columns, low, high)
            self.highs.clearSolver()
            self.highs.setOptionValue("simplex_iteration_limit", highspy.kHighsIInf)

    def _proven(self, lower: Array, upper: Array) -> Optimum:
        """The Optimum of the relaxation between limits of x, its value being a bound that weak duality proves.

        HiGHS solves with the limits that it has; `lower` and `upper` may be tighter where they hold for another reason.
        The point is None if HiGHS found none.
        """
        c = self._objective()
        rows = self._rows()
        best = np.inf
        point: Array | None = None
        try:
            for method in (DUAL, PRIMAL):
                if method == PRIMAL:
                    self.highs.clearSolver()
                self.highs.setOptionValue("simplex_strategy", method)
                try:
                    relaxed = self._relaxation()
                except SolverError:
                    continue
                if relaxed.value == -np.inf:
                    if self._ray_proves_empty(lower, upper):
                        return Optimum(-np.inf, None)
                elif relaxed.value < np.inf:
                    bound = rows.bound(c, self._multipliers(), lower, upper)
                    if bound <= best:
                        best, point = bound, relaxed.point
                    if bound <= relaxed.value + LOOSE_BOUND * (1 + abs(relaxed.value)):
                        break
            if point is None:
                best, point = self._proven_by_wider_rows(c, lower, upper)
        finally:
            self.highs.setOptionValue("simplex_strategy", DUAL)
        return Optimum(best if best < np.inf else rows.bound(c, np.zeros(len(rows.lower)), lower, upper), point)

    def _proven_by_wider_rows(self, c: Array, lower: Array, upper: Array) -> tuple[float, Array | None]:
        """(bound, point): the multipliers are those of rows that are moved outward until HiGHS finds a point."""
        count = len(self._entries)
        model = self.highs.getLp()
        low = np.array(model.row_lower_)
        high = np.array(model.row_upper_)
        every = np.arange(count, dtype=np.int32)
        try:
            for width in RELAXED:
                room = width * (1 + np.minimum(np.abs(low), np.abs(high)))
                self.highs.changeRowsBounds(count, every, low - room, high + room)
                try:
                    relaxed = self._relaxation()
                except SolverError:
                    continue
                if relaxed.point is not None:
                    return self._rows().bound(c, self._multipliers(), lower, upper), relaxed.point
                if self._ray_proves_empty(lower, upper):
                    return -np.inf, None
        finally:
            self.highs.changeRowsBounds(count, every, low, high)
        return np.inf, None

    def _ray_proves_empty(self, lower: Array, upper: Array) -> bool:
        """Whether HiGHS has a dual ray, and that ray proves that there is no point between limits of x."""
        _, known, ray = self.highs.getDualRay()
        return bool(known) and self._rows().is_proven_empty(np.array(ray), lower, upper)

    def _limits(self) -> tuple[Array, Array]:
        """Limits of all columns: their own, and where there are none, what the rows prove (`joint_limits`)."""
        free = ~(np.isfinite(self.lower) & np.isfinite(self.upper))
        if not free.any():
            return self.lower, self.upper
        if self._cached_limits is None:
            lower, upper = self.lower.copy(), self.upper.copy()
            proven = joint_limits(*self._mutual_bounds(free))
            if proven is not None:
                lower[free] = np.maximum(lower[free], proven[0])
                upper[free] = np.minimum(upper[free], proven[1])
            self._cached_limits = lower, upper
        return self._cached_limits

    def _mutual_bounds(self, free: NDArray[np.bool_]) -> tuple[Array, Array]:
        """b (2, k) and e (2, k, k) with -x_j and x_j <= b_j + sum over i of e_ji |x_i| for the k free columns."""
        chosen = np.flatnonzero(free).astype(np.int32)
        costed, costs = self._costed, self._costs
        b = np.full((2, len(chosen)), np.inf)
        e = np.zeros((2, len(chosen), len(chosen)))
        for i, sign in enumerate((-1.0, 1.0)):
            for k, column in enumerate(chosen):
                self.set_objective([column], [sign])
                try:
                    found = self._relaxation()
                except SolverError:
                    continue
                if found.point is not None:
                    b[i, k], e[i, k] = self._rows().bound_without_limits(
                        self._objective(), self._multipliers(), self.lower, self.upper, free
                    )
        self.set_objective(costed, costs)
        return b, e

    def _objective(self) -> Array:
        """The coefficients of the objective, one per column."""
        c = np.zeros(len(self.lower))
        c[self._costed] = self._costs
        return c

    def _multipliers(self) -> Array:
        """What HiGHS offers as multipliers of the rows for the objective."""
        return np.array(self.highs.getSolution().row_dual) / self._factor

    def _rows(self) -> Rows:
        """The constraints so far."""
        if self._cached_rows is None:
            self._cached_rows = Rows.of(self._entries, len(self.lower))
        return self._cached_rows

    def _declare_binaries(self, integer: bool) -> None:
        """Hold the binaries to 0 and 1, or relax them."""
        declared = len(self.binaries) if integer else 0
        if self._declared != declared:
            columns = np.array(self.binaries, np.int32)
            kind = highspy.HighsVarType.kInteger if integer else highspy.HighsVarType.kContinuous
            self.highs.changeColsIntegrality(len(columns), columns, np.full(len(columns), kind))
            self._declared = declared

    def set_objective(self, columns: ArrayLike, coefficients: ArrayLike) -> None:
        """Replace the objective; the constraints and the basis stay. HiGHS sees it multiplied by a power of two."""
        self.highs.changeColsCost(len(self._costed), self._costed, np.zeros(len(self._costed)))
        self._costed = np.array(columns, np.int32)
        self._costs = np.array(coefficients, float)
        _, exponent = math.frexp(np.abs(self._costs).max(initial=0))
        self._factor = 2.0 ** -max(-1000, min(exponent, 1000))
        self.highs.changeColsCost(len(self._costed), self._costed, self._costs * self._factor)


def _within_reach(lower: float, upper: float) -> tuple[float, float]:
    """Limits as HiGHS can take them, which are wider: it holds numbers of 1e20 and more for infinite."""
    return (LARGEST if LARGEST < lower < np.inf else lower), (-LARGEST if -np.inf < upper < -LARGEST else upper)


def _require_accepted(status: highspy.HighsStatus, what: str) -> None:
    """Raise SolverError if HiGHS has not taken over a change of its model, as it does not for a lower limit of inf."""
    if status == highspy.HighsStatus.kError:
        raise SolverError(f"HiGHS refuses {what} of the model: a limit or a coefficient has no meaning")


def _scaled_up(limit: float, exponent: int) -> float:
    """limit 2^exponent, rounded upward where it is too small or too large for a float."""
    try:
        scaled = math.ldexp(limit, exponent)
    except OverflowError:
        scaled = math.inf if limit > 0 else -sys.float_info.max
    return scaled if scaled == math.inf or math.ldexp(scaled, -exponent) >= limit else math.nextafter(scaled, math.inf)
