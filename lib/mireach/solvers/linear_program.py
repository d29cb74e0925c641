"""A linear program that is built row by row and solved for many objectives (HiGHS, warm-started).

Bounds do not rest on HiGHS. Its multipliers are only a proposal: weak duality turns any multipliers into a bound, with
the rounding of the computation added (`_Rows.bound`). A program is called empty by `bound` only if a ray proves it.
`maximize` returns HiGHS's own answer, to within its tolerances.
"""

import math
import sys
from dataclasses import dataclass, replace
from functools import wraps
from threading import Lock
from time import perf_counter

import highspy
import numpy as np
from scipy.sparse import csr_array

from ..errors import SolverError

MIP_TOLERANCE = 1e-9  # feasibility in HiGHS's MILP; a binary this close to 0 or 1 counts as decided
GAP = 1e-10  # between the bound of a MILP and its best point, at which the search may stop; relative and absolute
TOLERANCE = 1e-10  # HiGHS keeps constraints and reduced costs to within this, in units of the scaled row
TINY = 1e-12  # HiGHS leaves out coefficients that are not larger, and cannot be told to keep them
LOOSE = 1e-8  # a bound further above what HiGHS attains may be better with other multipliers (relative to 1 + it)
BRANCHED = 16  # binaries up to which no incumbent of HiGHS's MILP solver is asked for before branching
PROOF_NODES = 100_000  # of the search tree over more binaries, after which HiGHS's own bound may be returned
OPEN = 1e-6  # a relaxed binary that is closer to an integer is branched on only if no other is open
RELAXED = (1e-9, 1e-7, 1e-5, 1e-3)  # rows are widened by this where HiGHS finds no point and no proof of that
WELL_SCALED = 2.0**-10  # HiGHS's own bound is not used where a row has coefficients of more different sizes
DENSE = 100_000  # entries up to which a matrix of rows is kept dense, for speed
UNDERFLOW = 2.0**-1000  # more than all products lose that are too small for a float
ROUNDOFF = 2.0**-52  # twice the unit roundoff: a sum of k terms is off by less than k ROUNDOFF times their sizes

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
        No point with integer binaries exceeds it. -inf if there is no point.
    point : array (columns,) or None
        The best that was found, if any is better than what was called enough; it satisfies the constraints to within
        HiGHS's tolerances.
    finished : bool
        False if a limit stopped the search.
    proven : bool
        Whether `bound` is proven by weak duality at every node, with rounding counted. If not, it is HiGHS's own.
    """

    bound: float
    point: np.ndarray | None
    finished: bool
    proven: bool = True


@dataclass(frozen=True, eq=False)
class _Rows:
    """lower <= A x <= upper.

    Attributes
    ----------
    transposed, size : csr_array or array (columns, rows)
        A' and |A|'.
    lower, upper : array (rows,)
    """

    transposed: csr_array | np.ndarray
    size: csr_array | np.ndarray
    lower: np.ndarray
    upper: np.ndarray

    @classmethod
    def of(cls, rows, columns):
        """From rows (indices, coefficients, lower, upper) of a matrix with so many columns."""
        starts = np.cumsum([0, *(len(indices) for indices, *_ in rows)])
        indices = np.concatenate([np.zeros(0, np.int32), *(row[0] for row in rows)])
        values = np.concatenate([np.zeros(0), *(row[1] for row in rows)])
        if len(rows) * columns <= DENSE:
            transposed = np.zeros((columns, len(rows)))
            transposed[indices, np.repeat(np.arange(len(rows)), np.diff(starts))] = values
        else:
            transposed = csr_array(csr_array((values, indices, starts), shape=(len(rows), columns)).T)
        lower, upper = (np.array([row[end] for row in rows], float) for end in (2, 3))
        return cls(transposed, abs(transposed), lower, upper)

    def bound(self, c, y, low, high):
        """A number that c x nowhere exceeds on these rows and low <= x <= high, for any multipliers y (rows,).

        Weak duality: c x = y A x + (c - A'y) x <= sum max(y lower, y upper) + sum max((c - A'y) low, (c - A'y) high).
        What rounding may do to that is added.
        """
        rows, reduced, terms = self._split(c, y)
        columns = np.where(reduced > 0, high, np.where(reduced < 0, low, 0)) * reduced
        extent = np.where(terms > 0, np.maximum(np.abs(low), np.abs(high)), 0)
        size = np.abs(rows).sum() + extent @ terms
        rounding = self._rounding * size + (UNDERFLOW if 0 < size < 2.0**-900 else 0.0)
        total = float(rows.sum() + columns.sum() + rounding)
        return np.inf if np.isnan(total) else total

    def bound_without_limits(self, c, y, low, high, free):
        """(b, e) with c x <= b + sum of e_j |x_j| over the columns `free`, the others lying in low <= x <= high."""
        _, reduced, terms = self._split(c, y)
        inside = self.bound(c, y, np.where(free, 0, low), np.where(free, 0, high))
        return inside, (np.abs(reduced) + self._rounding * terms)[free]

    @property
    def _rounding(self):
        return ROUNDOFF * (sum(self.transposed.shape) + 8)

    def _split(self, c, y):
        """max(y lower, y upper) of each row, c - A'y of each column, and the sizes of its terms."""
        y = np.where(((y > 0) & (self.upper == np.inf)) | ((y < 0) & (self.lower == -np.inf)), 0, y)
        rows = np.where(y > 0, self.upper, np.where(y < 0, self.lower, 0)) * y
        return rows, c - self.transposed @ y, np.abs(c) + self.size @ np.abs(y)


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
        self.lower, self.upper, self.binaries, self.first, self.end = np.zeros(0), np.zeros(0), [], [], np.inf
        self._costed, self._costs, self._factor = np.zeros(0, dtype=np.int32), np.zeros(0), 1.0
        self._declared, self._asked, self._known_rows, self._known_limits = 0, Lock(), None, None
        self._entries, self._powers = [], []

    @_alone
    def copy(self):
        """A program of its own with the same constraints, binaries and objective."""
        other = LinearProgram()
        other.highs.passModel(self.highs.getLp())
        other.lower, other.upper, other.end = self.lower.copy(), self.upper.copy(), self.end
        other.binaries, other.first = list(self.binaries), list(self.first)
        other._costed, other._costs, other._factor = self._costed, self._costs, self._factor
        other._declared, other._known_rows = self._declared, self._rows()
        other._entries, other._powers = list(self._entries), list(self._powers)
        return other

    def add_columns(self, lower, upper):
        """Add variables with bounds (k,) each; returns their indices (k,)."""
        lower, upper = np.broadcast_arrays(np.asarray(lower, float), np.asarray(upper, float))
        first, self._known_rows, self._known_limits = len(self.lower), None, None
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
        self.lower[columns], self.upper[columns], self._known_limits = lower, upper, None

    def add_row(self, columns, coefficients, lower=-np.inf, upper=np.inf):
        """Add lower <= coefficients x[columns] <= upper, for distinct columns.

        The row is multiplied by the power of two that brings its largest coefficient into [1/2, 1), so that its length
        does not matter. `bound` proves with these coefficients. HiGHS is given the row without those up to `TINY`,
        widened by what they can contribute where their variables have limits.
        """
        coefficients = np.asarray(coefficients, float)
        lower, upper, power = float(lower), float(upper), 0
        _, exponent = math.frexp(np.abs(coefficients).max(initial=0))
        scaled = np.ldexp(coefficients, -exponent)
        if exponent < 0 or (np.ldexp(scaled, exponent) == coefficients).all():  # else numbers would become too small
            coefficients, power = scaled, -exponent
            lower, upper = -_scaled_up(-lower, -exponent), _scaled_up(upper, -exponent)
        used = coefficients != 0
        indices, coefficients = np.asarray(columns, np.int32)[used], coefficients[used]
        self._known_rows = None
        self._entries.append((indices, coefficients, lower, upper))
        self._powers.append(power)
        tiny = np.abs(coefficients) <= TINY
        if tiny.any():
            left_out = indices[tiny]
            most = np.abs(coefficients[tiny]) * np.maximum(np.abs(self.lower[left_out]), np.abs(self.upper[left_out]))
            slack = most[np.isfinite(most)].sum()
            indices, coefficients, lower, upper = indices[~tiny], coefficients[~tiny], lower - slack, upper + slack
        self.highs.addRow(lower, upper, len(indices), indices, coefficients)

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

    def multipliers(self):
        """HiGHS's multipliers y (rows,) of the last maximum, of the rows as given: c = A'y to its tolerances."""
        return np.ldexp(self._multipliers(), self._powers)

    @_alone
    def bound(self, columns, coefficients):
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
    def limits(self):
        """Two arrays (columns,) between which every point lies: proven as `bound`, where variables have no limits."""
        self._declare_binaries(False)
        return self._limits()

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
        self, columns, coefficients, *, gap=GAP, enough=-np.inf, nodes=None, time_limit=None, presolve=None
    ):
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
        if presolve is not None:
            return self._search(bool(presolve), gap, nodes, time_limit)
        if nodes is not None or len(self.binaries) <= BRANCHED:
            return self._branch(gap, enough, nodes, time_limit)
        begin = perf_counter()
        try:
            claimed = self._search(True, gap, None, None if time_limit is None else time_limit / 2)
        except SolverError:
            claimed = IntegerOptimum(np.inf, None, False, False)
        goal = enough
        if claimed.finished and claimed.bound > -np.inf:
            goal = max(enough, claimed.bound + MIP_TOLERANCE * (1 + abs(claimed.bound)))
        remaining = None if time_limit is None else max(time_limit - (perf_counter() - begin), 0.0)
        found = self._branch(gap, goal, PROOF_NODES, remaining)
        if found.point is None and claimed.point is not None:
            found = replace(found, point=claimed.point)
        remaining = None if time_limit is None else time_limit - (perf_counter() - begin)
        if found.finished or (remaining is not None and remaining <= 0):
            return found
        try:
            other = self._search(False, gap, None, remaining)
        except SolverError:
            other = claimed
        said = max(claimed.bound, other.bound)
        if said < found.bound and claimed.finished and other.finished and self._is_well_scaled():
            return IntegerOptimum(said, found.point, True, False)
        return replace(found, finished=True)

    def _is_well_scaled(self):
        """Whether no row has coefficients of very different sizes, so that HiGHS's tolerances mean what they say."""
        return all(np.abs(entry[1]).min(initial=1) >= WELL_SCALED for entry in self._entries)

    def _search(self, presolve, gap, nodes, time_limit):
        """The IntegerOptimum of HiGHS's MILP solver, in one of its ways; SolverError if it ends without an answer."""
        self._declare_binaries(True)
        self.highs.clearSolver()  # the answer does not depend on what was asked before
        for name, setting in {
            "mip_rel_gap": float(gap),
            "mip_abs_gap": float(gap),
            "mip_feasibility_tolerance": MIP_TOLERANCE,
            "mip_heuristic_run_feasibility_jump": False,  # two thirds of the time on a model with few binaries
            "mip_max_nodes": highspy.kHighsIInf if nodes is None else nodes,
            "time_limit": np.inf if time_limit is None else self.highs.getRunTime() + time_limit,  # of all its runs
            "presolve": "choose" if presolve else "off",
        }.items():
            self.highs.setOptionValue(name, setting)
        self.highs.run()
        self.highs.setOptionValue("presolve", "off")
        self.highs.setOptionValue("time_limit", np.inf)
        status, info, solution = self.highs.getModelStatus(), self.highs.getInfo(), self.highs.getSolution()
        if status == highspy.HighsModelStatus.kInfeasible:
            return IntegerOptimum(-np.inf, None, True, False)
        if status not in (highspy.HighsModelStatus.kOptimal, *STOPPED):
            raise SolverError(f"HiGHS ended the MILP with {self.highs.modelStatusToString(status)}")
        attained = solution.value_valid and np.isfinite(info.objective_function_value)
        point = np.array(solution.col_value) if attained else None
        finished = status == highspy.HighsModelStatus.kOptimal
        return IntegerOptimum(float(info.mip_dual_bound) / self._factor, point, finished, False)

    def _branch(self, gap, enough, nodes, time_limit):
        """Branch and bound, depth first, each node a linear program: IntegerOptimum.

        A node is left out only if its proven bound is not above `enough` or the best point. Where HiGHS has neither a
        point nor a proof that there is none, the node keeps the bound of its parent and is branched further.
        """
        self._declare_binaries(False)
        self.highs.passModel(self.highs.getLp())  # last digits do not depend on how it was scaled for other questions
        self.highs.setOptionValue("simplex_iteration_limit", 1000 + 20 * (len(self._entries) + len(self.lower)))
        columns, first = np.array(self.binaries, np.int32), set(self.first)
        turn = np.array([k if column in first else k + len(columns) for k, column in enumerate(columns)])
        lower, upper = (ends.copy() for ends in self._limits())
        limits = lower[columns], upper[columns]
        best, bound, point, looked = enough, -np.inf, None, 0
        end = np.inf if time_limit is None else perf_counter() + time_limit
        waiting = [(self._rows().bound(self._objective(), np.zeros(len(self._entries)), lower, upper), *limits)]
        try:
            while waiting and (nodes is None or looked < nodes) and perf_counter() < end:
                above, low, high = waiting.pop()
                settled = best + gap * (1 + abs(best)) if np.isfinite(best) else best
                if above > settled:
                    self.highs.changeColsBounds(len(columns), columns, low, high)
                    lower[columns], upper[columns] = low, high
                    relaxed, looked = self._proven(lower, upper), looked + 1
                    above = min(above, relaxed.value)
                if above <= settled:
                    bound = max(bound, above)
                    continue
                if above == np.inf:
                    raise SolverError("HiGHS found no bound of a MILP: its relaxation is unbounded")
                share = relaxed.point[columns] if relaxed.point is not None else (low + high) / 2
                apart = np.minimum(share - low, high - share)
                if apart.max(initial=0) <= MIP_TOLERANCE:
                    bound = max(bound, above)
                    if relaxed.point is not None:
                        best, point = above, relaxed.point
                    continue
                open_ = np.flatnonzero(apart > min(OPEN, apart.max() / 2))
                branch = open_[np.argmin(turn[open_])]
                for value in (0.0, 1.0) if share[branch] > 0.5 else (1.0, 0.0):  # the last one is looked at first
                    low, high = low.copy(), high.copy()
                    low[branch] = high[branch] = value
                    waiting.append((above, low, high))
        finally:
            self.highs.changeColsBounds(len(columns), columns, *limits)
            self.highs.clearSolver()
            self.highs.setOptionValue("simplex_iteration_limit", highspy.kHighsIInf)
        return IntegerOptimum(max([bound, *(above for above, _, _ in waiting)]), point, not waiting)

    def _proven(self, lower, upper):
        """The Optimum of the relaxation between limits of x, its value being a bound that weak duality proves.

        HiGHS solves with the limits that it has; `lower` and `upper` may be tighter where they hold for another reason.
        The point is None if HiGHS found none.
        """
        c, rows, best, point = self._objective(), self._rows(), np.inf, None
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
                    _, known, ray = self.highs.getDualRay()
                    if known and rows.bound(np.zeros(len(c)), -np.array(ray), lower, upper) < 0:
                        return Optimum(-np.inf, None)
                elif relaxed.value < np.inf:
                    bound = rows.bound(c, self._multipliers(), lower, upper)
                    if bound <= best:
                        best, point = bound, relaxed.point
                    if bound <= relaxed.value + LOOSE * (1 + abs(relaxed.value)):
                        break
            if point is None:
                best, point = self._proven_by_wider_rows(c, lower, upper)
        finally:
            self.highs.setOptionValue("simplex_strategy", DUAL)
        return Optimum(best if best < np.inf else rows.bound(c, np.zeros(len(rows.lower)), lower, upper), point)

    def _proven_by_wider_rows(self, c, lower, upper):
        """(bound, point): the multipliers are those of rows that are moved outward until HiGHS finds a point."""
        rows, count = self._rows(), len(self._entries)
        model = self.highs.getLp()
        low, high = np.array(model.row_lower_), np.array(model.row_upper_)
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
                    return rows.bound(c, self._multipliers(), lower, upper), relaxed.point
                _, known, ray = self.highs.getDualRay()
                if known and rows.bound(np.zeros(len(c)), -np.array(ray), lower, upper) < 0:
                    return -np.inf, None
        finally:
            self.highs.changeRowsBounds(count, every, low, high)
        return np.inf, None

    def _limits(self):
        """Limits of all columns: their own, and where there are none, what the rows prove.

        With |x_j| <= b_j + sum over k of e_jk |x_k| for all columns without limits, as weak duality gives it, no |x_k|
        exceeds s = max b / (1 - max sum_k e_jk), and so |x_j| <= b_j + s sum_k e_jk.
        """
        free = ~(np.isfinite(self.lower) & np.isfinite(self.upper))
        if not free.any():
            return self.lower, self.upper
        if self._known_limits is None:
            self._known_limits = self.lower.copy(), self.upper.copy()
            chosen = np.flatnonzero(free).astype(np.int32)
            costed, costs = self._costed, self._costs
            b, e = np.full((2, len(chosen)), np.inf), np.zeros((2, len(chosen), len(chosen)))
            for i, sign in enumerate((-1.0, 1.0)):
                for k, column in enumerate(chosen):
                    self.set_objective([column], [sign])
                    try:
                        found = self._relaxation()
                    except SolverError:
                        continue
                    if found.point is not None:
                        c = self._objective()
                        b[i, k], e[i, k] = self._rows().bound_without_limits(
                            c, self._multipliers(), self.lower, self.upper, free
                        )
            self.set_objective(costed, costs)
            share = e.sum(axis=2).max() * (1 + ROUNDOFF * (len(chosen) + 1))
            if np.isfinite(b).all() and share < 0.5:
                most = max(b.max(), 0) / (1 - share) * (1 + 8 * ROUNDOFF)
                ends = (b + e.sum(axis=2) * most) + ROUNDOFF * (len(chosen) + 8) * (np.abs(b) + e.sum(axis=2) * most)
                self._known_limits[0][chosen] = np.maximum(self.lower[chosen], -ends[0])
                self._known_limits[1][chosen] = np.minimum(self.upper[chosen], ends[1])
        return self._known_limits

    def _objective(self):
        """The coefficients of the objective, one a column."""
        c = np.zeros(len(self.lower))
        c[self._costed] = self._costs
        return c

    def _multipliers(self):
        """What HiGHS offers as multipliers of the rows for the objective."""
        return np.array(self.highs.getSolution().row_dual) / self._factor

    def _rows(self):
        """The constraints so far."""
        if self._known_rows is None:
            self._known_rows = _Rows.of(self._entries, len(self.lower))
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
        """Replace the objective; the constraints and the basis stay. HiGHS sees it multiplied by a power of two."""
        self.highs.changeColsCost(len(self._costed), self._costed, np.zeros(len(self._costed)))
        self._costed, self._costs = np.array(columns, np.int32), np.array(coefficients, float)
        _, exponent = math.frexp(np.abs(self._costs).max(initial=0))
        self._factor = 2.0 ** -max(-1000, min(exponent, 1000))
        self.highs.changeColsCost(len(self._costed), self._costed, self._costs * self._factor)


def _scaled_up(limit, exponent):
    """limit 2^exponent, rounded upward where it is too small or too large for a float."""
    try:
        scaled = math.ldexp(limit, exponent)
    except OverflowError:
        scaled = math.inf if limit > 0 else -sys.float_info.max
    return scaled if scaled == math.inf or math.ldexp(scaled, -exponent) >= limit else math.nextafter(scaled, math.inf)
