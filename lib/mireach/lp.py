"""A linear program that is built row by row and asked for many objectives (HiGHS, warm-started)."""

from dataclasses import dataclass
from functools import wraps
from threading import Lock
from time import perf_counter

import highspy
import numpy as np
from scipy.sparse import csc_array, csr_array

from .errors import SolverError

MIP_TOLERANCE = 1e-9  # feasibility in a MILP; `engines.bounds.SAFETY` has to stay far above it
GAP = 1e-10  # between the bound of a MILP and its best point, at which the solver may stop; relative and absolute
TOLERANCE = 1e-10  # HiGHS keeps constraints and reduced costs to within this, in units of the row
TINY = 1e-12  # HiGHS leaves out coefficients that are not larger, and cannot be told to keep them
SMALL = 2.0**-10  # rows whose largest coefficient is below this are scaled up, by a power of two
LOOSE = 1e-8  # a bound further above what HiGHS attains may be better with other multipliers (relative to 1 + it)
BRANCHED = 16  # binaries up to which a branch and bound over LPs is faster than a MILP solver, and easier to trust

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
    point: np.ndarray | None


@dataclass(frozen=True)
class IntegerOptimum:
    """Answer to one objective with binaries.

    Attributes
    ----------
    bound : float
        The dual bound: no point exceeds it by more than the solver's tolerances. -inf if there is no point.
    point : array (columns,) or None
        The best that was found, if any is better than what was called enough.
    finished : bool
        False if a limit stopped the search.
    """

    bound: float
    point: np.ndarray | None
    finished: bool


@dataclass(frozen=True, eq=False)
class _Rows:
    """lower <= A x <= upper.

    Attributes
    ----------
    transposed, size : csr_array (columns, rows)
        A' and |A|'.
    lower, upper : array (rows,)
    """

    transposed: csr_array
    size: csr_array
    lower: np.ndarray
    upper: np.ndarray

    @classmethod
    def of(cls, lp):
        """The rows of a HighsLp."""
        matrix, shape = lp.a_matrix_, (lp.num_row_, lp.num_col_)
        kind = csr_array if matrix.format_ == highspy.MatrixFormat.kRowwise else csc_array
        A = kind((np.array(matrix.value_), np.array(matrix.index_), np.array(matrix.start_)), shape=shape)
        transposed = csr_array(A.T)
        return cls(transposed, abs(transposed), np.array(lp.row_lower_), np.array(lp.row_upper_))

    def bound(self, c, y, low, high):
        """A number that c x nowhere exceeds on these rows and low <= x <= high, for any multipliers y (rows,).

        Weak duality: c x = y A x + (c - A'y) x <= sum max(y lower, y upper) + sum max((c - A'y) low, (c - A'y) high).
        What rounding may do to that is added.
        """
        y = np.where(((y > 0) & (self.upper == np.inf)) | ((y < 0) & (self.lower == -np.inf)), 0, y)
        rows = np.where(y > 0, self.upper, np.where(y < 0, self.lower, 0)) * y
        reduced, terms = c - self.transposed @ y, np.abs(c) + self.size @ np.abs(y)
        columns = np.where(reduced > 0, high, np.where(reduced < 0, low, 0)) * reduced
        extent = np.where(terms > 0, np.maximum(np.abs(low), np.abs(high)), 0)
        rounding = 2.0**-53 * (len(rows) + len(columns) + 4) * (np.abs(rows).sum() + extent @ terms)
        return float(rows.sum() + columns.sum() + rounding)


def _alone(method):
    """Let one thread at a time into a method of a LinearProgram."""

    @wraps(method)
    def alone(self, *arguments, **options):
        with self._asked:
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

    Examples
    --------
    >>> lp = LinearProgram()
    >>> x = lp.add_columns([0, 0], [1, 1])
    >>> lp.add_row(x, [1, 1], upper=1.5)
    >>> lp.maximize(x, [1, 2]).value
    2.5
    """

    def __init__(self):
        self.highs = highspy.Highs()
        for name, setting in {
            "output_flag": False,
            "presolve": "off",
            "primal_feasibility_tolerance": TOLERANCE,
            "dual_feasibility_tolerance": TOLERANCE,
            "small_matrix_value": TINY,
        }.items():
            self.highs.setOptionValue(name, setting)
        self.highs.changeObjectiveSense(highspy.ObjSense.kMaximize)
        self.lower, self.upper, self.binaries = np.zeros(0), np.zeros(0), []
        self._costed, self._costs = np.zeros(0, dtype=np.int32), np.zeros(0)
        self._declared, self._asked, self._known_rows = 0, Lock(), None

    @_alone
    def copy(self):
        """A program of its own with the same constraints, binaries and objective."""
        other = LinearProgram()
        other.highs.passModel(self.highs.getLp())
        other.lower, other.upper, other.binaries = self.lower.copy(), self.upper.copy(), list(self.binaries)
        other._costed, other._costs, other._declared = self._costed, self._costs, self._declared
        other._known_rows = self._rows()
        return other

    def add_columns(self, lower, upper):
        """Add variables with bounds (k,) each; returns their indices (k,)."""
        lower, upper = np.broadcast_arrays(np.asarray(lower, float), np.asarray(upper, float))
        first, self._known_rows = len(self.lower), None
        self.highs.addVars(lower.size, lower.ravel(), upper.ravel())
        self.lower = np.concatenate([self.lower, lower.ravel()])
        self.upper = np.concatenate([self.upper, upper.ravel()])
        return np.arange(first, first + lower.size, dtype=np.int32)

    def set_bounds(self, columns, lower, upper):
        """Change the bounds of existing variables."""
        columns = np.atleast_1d(columns)
        lower, upper = np.broadcast_to(lower, columns.shape), np.broadcast_to(upper, columns.shape)
        for column, low, high in zip(columns, lower, upper):
            self.highs.changeColBounds(int(column), float(low), float(high))
        self.lower[columns], self.upper[columns] = lower, upper

    def add_row(self, columns, coefficients, lower=-np.inf, upper=np.inf):
        """Add lower <= coefficients x[columns] <= upper, for distinct columns.

        Coefficients up to `TINY` are left out; where their variables have limits, the row is widened by what they can
        contribute, so that no point is lost.
        """
        coefficients = np.asarray(coefficients, float)
        size = np.abs(coefficients)
        largest = size.max(initial=0)
        if 0 < largest < SMALL:
            scale = 2.0 ** min(-np.floor(np.log2(largest)), 1000)  # beyond, it would overflow
            coefficients, size, lower, upper = coefficients * scale, size * scale, lower * scale, upper * scale
        tiny = (size <= TINY) & (size > 0)
        if tiny.any():
            left_out = np.asarray(columns)[tiny]
            most = size[tiny] * np.maximum(np.abs(self.lower[left_out]), np.abs(self.upper[left_out]))
            slack = most[np.isfinite(most)].sum()
            coefficients, lower, upper = np.where(tiny, 0, coefficients), lower - slack, upper + slack
        used, self._known_rows = coefficients != 0, None
        self.highs.addRow(
            float(lower), float(upper), int(used.sum()), np.asarray(columns, np.int32)[used], coefficients[used]
        )

    def add_rows(self, columns, matrix, lower=-np.inf, upper=np.inf):
        """Add lower <= matrix x[columns] <= upper, row by row; matrix (r, k), limits (r,) or numbers."""
        matrix = np.atleast_2d(matrix)
        lower, upper = np.broadcast_to(lower, len(matrix)), np.broadcast_to(upper, len(matrix))
        for row, low, high in zip(matrix, lower, upper):
            self.add_row(columns, row, low, high)

    @_alone
    def maximize(self, columns, coefficients):
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

    @_alone
    def bound(self, columns, coefficients):
        """A number that coefficients x[columns] nowhere exceeds: the value of `maximize`, raised to what is proven.

        The proof is weak duality with HiGHS's multipliers (of a ray, where there is no point), in floating point with
        its rounding counted. Where they prove nothing, as for variables without limits, it is the larger one of what
        both simplex methods say.

        Returns
        -------
        float

        Raises
        ------
        SolverError
            As `maximize`.
        """
        self._declare_binaries(False)
        self.set_objective(columns, coefficients)
        return self._proven(self.lower, self.upper).value

    def _relaxation(self):
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
            return Optimum(float(self.highs.getInfo().objective_function_value), point)
        if status == highspy.HighsModelStatus.kInfeasible:
            return Optimum(-np.inf, None)
        if status == highspy.HighsModelStatus.kUnbounded:
            return Optimum(np.inf, None)
        if not len(self.lower):  # no variables: the empty sum
            return Optimum(0.0, np.zeros(0))
        raise SolverError(f"HiGHS ended a linear program with {self.highs.modelStatusToString(status)}")

    @_alone
    def maximize_integer(
        self, columns, coefficients, *, gap=GAP, enough=-np.inf, nodes=None, time_limit=None, presolve=None
    ):
        """max coefficients x[columns] over the constraints so far, the `binaries` being 0 or 1.

        Up to `BRANCHED` binaries are branched on here, each node bounded as by `bound`: HiGHS need not be trusted, but
        where both its simplex methods call a node empty without a ray that proves it.

        Parameters
        ----------
        columns, coefficients : array (k,)
        gap : float
            Between bound and point, relative and absolute, at which the solver may stop.
        enough : float
            A bound that need not be lowered further, such as a value that is attained already. With many binaries it is
            not used.
        nodes : int or None
            At most so many nodes of the search tree.
        time_limit : float or None
            Seconds.
        presolve : bool or None
            None solves MILPs with many binaries twice, with HiGHS's presolve and without, and takes the larger bound:
            in either way HiGHS 1.15 has called points optimal that were not, without a word (on models of five in
            10,000 random sets with presolve; on one of a case study without). True or False leaves the search to
            HiGHS, in one way.

        Returns
        -------
        IntegerOptimum

        Raises
        ------
        SolverError
            If HiGHS ends without an answer.
        """
        self.set_objective(columns, coefficients)
        if len(self.binaries) <= (BRANCHED if presolve is None else 0):
            return self._branch(gap, enough, nodes, time_limit)
        self._declare_binaries(True)
        for name, setting in {
            "mip_rel_gap": float(gap),
            "mip_abs_gap": float(gap),
            "mip_feasibility_tolerance": MIP_TOLERANCE,
            "mip_heuristic_run_feasibility_jump": False,  # two thirds of the time on a model with few binaries
            "mip_max_nodes": highspy.kHighsIInf if nodes is None else nodes,
        }.items():
            self.highs.setOptionValue(name, setting)
        ways = (True, False) if presolve is None else (bool(presolve),)
        found = [self._search(way, None if time_limit is None else time_limit / len(ways)) for way in ways]
        self.highs.setOptionValue("presolve", "off")
        self.highs.setOptionValue("time_limit", np.inf)
        answers = [optimum for optimum, _ in found if optimum is not None]
        bound = max((one.bound for one in answers), default=-np.inf)
        unclear = [status for optimum, status in found if optimum is None]
        if unclear and bound == -np.inf:  # that there is no point has to hold in both ways
            raise SolverError(f"HiGHS ended the MILP with {self.highs.modelStatusToString(unclear[0])}")
        objective = np.zeros(len(self.lower))
        objective[columns] = coefficients
        points = [optimum.point for optimum in answers if optimum.point is not None]
        best = max(points, key=lambda point: objective @ point, default=None)
        return IntegerOptimum(bound, best, all(one.finished for one in answers))

    def _search(self, presolve, time_limit):
        """Let HiGHS solve the MILP in one of its ways: IntegerOptimum, None if it ends without one; and its status."""
        self.highs.clearSolver()  # the answer does not depend on what was asked before
        end = np.inf if time_limit is None else self.highs.getRunTime() + time_limit  # HiGHS counts all its runs
        self.highs.setOptionValue("time_limit", end)
        self.highs.setOptionValue("presolve", "choose" if presolve else "off")
        self.highs.run()
        status, info = self.highs.getModelStatus(), self.highs.getInfo()
        if status == highspy.HighsModelStatus.kInfeasible:
            return IntegerOptimum(-np.inf, None, True), status
        if status not in (highspy.HighsModelStatus.kOptimal, *STOPPED):
            return None, status
        finished, solution = status == highspy.HighsModelStatus.kOptimal, self.highs.getSolution()
        attained = solution.value_valid and np.isfinite(info.objective_function_value)
        point = np.array(solution.col_value) if attained else None
        return IntegerOptimum(float(info.mip_dual_bound), point, finished), status

    def _branch(self, gap, enough, nodes, time_limit):
        """Branch and bound, depth first, each node a linear program: IntegerOptimum.

        Each of them begins anew: from the basis of the node before, HiGHS 1.15 can go round for ever.
        """
        self._declare_binaries(False)
        self.highs.passModel(self.highs.getLp())  # last digits do not depend on how it was scaled for other questions
        columns = np.array(self.binaries, np.int32)
        lower, upper = self.lower.copy(), self.upper.copy()
        limits = lower[columns], upper[columns]
        best, bound, point, looked = enough, -np.inf, None, 0
        end = np.inf if time_limit is None else perf_counter() + time_limit
        waiting = [(np.inf, *limits)]  # what bounds a node from above, and the limits of its binaries
        try:
            while waiting and (nodes is None or looked < nodes) and perf_counter() < end:
                above, low, high = waiting.pop()
                settled = best + gap * (1 + abs(best)) if np.isfinite(best) else best
                if above > settled:
                    self.highs.changeColsBounds(len(columns), columns, low, high)
                    lower[columns], upper[columns] = low, high
                    relaxed, looked = self._proven(lower, upper, afresh=True), looked + 1
                    above = min(above, relaxed.value)
                if above <= settled:
                    bound = max(bound, above)
                    continue
                if relaxed.point is None:
                    raise SolverError("HiGHS found no bound of a MILP: its relaxation is unbounded")
                share = relaxed.point[columns]
                apart = np.minimum(share - low, high - share)
                if apart.max(initial=0) <= MIP_TOLERANCE:
                    best, bound, point = above, max(bound, above), relaxed.point
                    continue
                branch = int(np.argmax(apart))
                for value in (0.0, 1.0) if share[branch] > 0.5 else (1.0, 0.0):  # the last one is looked at first
                    low, high = low.copy(), high.copy()
                    low[branch] = high[branch] = value
                    waiting.append((above, low, high))
        finally:
            self.highs.changeColsBounds(len(columns), columns, *limits)
            self.highs.clearSolver()
        return IntegerOptimum(max([bound, *(above for above, _, _ in waiting)]), point, not waiting)

    def _proven(self, lower, upper, afresh=False):
        """The Optimum of the relaxation between limits of x, its value being raised to a bound by weak duality.

        Without multipliers that give a bound it is the larger one of what both simplex methods say.
        """
        c, rows, said, proven = np.zeros(len(lower)), self._rows(), [], []
        c[self._costed] = self._costs
        try:
            for method in (DUAL, PRIMAL):
                if afresh or method == PRIMAL:
                    self.highs.clearSolver()
                self.highs.setOptionValue("simplex_strategy", method)
                relaxed = self._relaxation()
                said.append(relaxed)
                if relaxed.value == -np.inf:
                    _, known, ray = self.highs.getDualRay()
                    if known and rows.bound(np.zeros(len(c)), -np.array(ray), lower, upper) < 0:
                        return relaxed
                elif relaxed.value < np.inf:
                    bound = rows.bound(c, np.array(self.highs.getSolution().row_dual), lower, upper)
                    proven.append(Optimum(bound, relaxed.point))
                    if bound <= relaxed.value + LOOSE * (1 + abs(relaxed.value)):
                        break
        finally:
            self.highs.setOptionValue("simplex_strategy", DUAL)
        best = min(proven, key=lambda optimum: optimum.value, default=None)
        return best if best is not None and best.value < np.inf else max(said, key=lambda optimum: optimum.value)

    def _rows(self):
        """The constraints so far."""
        if self._known_rows is None:
            self._known_rows = _Rows.of(self.highs.getLp())
        return self._known_rows

    def _declare_binaries(self, integer):
        """Hold the binaries to 0 and 1, or relax them."""
        declared = len(self.binaries) if integer else 0
        if self._declared != declared:
            columns = np.array(self.binaries, np.int32)
            kind = highspy.HighsVarType.kInteger if integer else highspy.HighsVarType.kContinuous
            self.highs.changeColsIntegrality(len(columns), columns, np.full(len(columns), kind))
            self._declared = declared

    def set_objective(self, columns, coefficients):
        """Replace the objective; the constraints and the basis stay."""
        self.highs.changeColsCost(len(self._costed), self._costed, np.zeros(len(self._costed)))
        self._costed, self._costs = np.array(columns, np.int32), np.array(coefficients, float)
        self.highs.changeColsCost(len(self._costed), self._costed, self._costs)
