"""A linear program that is built row by row and asked for many objectives (HiGHS, warm-started)."""

from dataclasses import dataclass

import highspy
import numpy as np

from .errors import SolverError

TOLERANCE = 1e-9  # HiGHS keeps constraints and reduced costs to within this, in units of the row

DUAL, PRIMAL = 1, 4  # HiGHS's numbers for its simplex methods; the dual one is its default
CONCLUSIVE = (
    highspy.HighsModelStatus.kOptimal,
    highspy.HighsModelStatus.kInfeasible,
    highspy.HighsModelStatus.kUnbounded,
)


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


class LinearProgram:
    """max c x subject to lower <= A x <= upper and bounds on x, for one c after another.

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
        }.items():
            self.highs.setOptionValue(name, setting)
        self.highs.changeObjectiveSense(highspy.ObjSense.kMaximize)
        self.lower, self.upper = np.zeros(0), np.zeros(0)
        self._costed = np.zeros(0, dtype=np.int32)

    def add_columns(self, lower, upper):
        """Add variables with bounds (k,) each; returns their indices (k,)."""
        lower, upper = np.broadcast_arrays(np.asarray(lower, float), np.asarray(upper, float))
        first = len(self.lower)
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
        """Add lower <= coefficients x[columns] <= upper."""
        coefficients = np.asarray(coefficients, float)
        used = coefficients != 0
        self.highs.addRow(
            float(lower), float(upper), int(used.sum()), np.asarray(columns, np.int32)[used], coefficients[used]
        )

    def add_rows(self, columns, matrix, lower=-np.inf, upper=np.inf):
        """Add lower <= matrix x[columns] <= upper, row by row; matrix (r, k), limits (r,) or numbers."""
        matrix = np.atleast_2d(matrix)
        lower, upper = np.broadcast_to(lower, len(matrix)), np.broadcast_to(upper, len(matrix))
        for row, low, high in zip(matrix, lower, upper):
            self.add_row(columns, row, low, high)

    def maximize(self, columns, coefficients):
        """max coefficients x[columns] over the constraints so far.

        Returns
        -------
        Optimum

        Raises
        ------
        SolverError
            If HiGHS ends without an answer.
        """
        self.set_objective(columns, coefficients)
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

    def set_objective(self, columns, coefficients):
        """Replace the objective; the constraints and the basis stay."""
        self.highs.changeColsCost(len(self._costed), self._costed, np.zeros(len(self._costed)))
        self._costed = np.asarray(columns, np.int32)
        self.highs.changeColsCost(len(self._costed), self._costed, np.asarray(coefficients, float))
