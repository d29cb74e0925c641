"""Data sets: states, the optimal first inputs, and the states for which no input sequence is feasible."""

import csv
import io
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from scipy.linalg import solve_discrete_are
from tqdm.auto import tqdm

from ..checks import real_array, require_columns
from ..errors import CorruptFileError, MireachError
from ..files import END, write_whole
from ..systems.plants import double_integrator_plant, four_tanks_plant, pwa_plant, three_tanks_plant
from ..workers import in_parallel
from .mpc import NonlinearMPC, solve_miqp

THREE_TANKS_HORIZON, THREE_TANKS_Q, THREE_TANKS_R = 8, (0.1, 0.1, 1.0), 10.0
FOUR_TANKS_HORIZON, FOUR_TANKS_Q, FOUR_TANKS_R = 20, (1.0, 1.0, 0.1, 0.1), 5.0


@dataclass(frozen=True, eq=False)
class DataSet:
    """Solutions of an optimal control problem at many states.

    Parameters
    ----------
    states : array (N, n)
        Where the problem has a solution.
    inputs : array (N, m)
        The first input of each solution.
    costs : array (N,)
        The optimal cost at each state.
    infeasible : array (M, n)
        States for which no feasible input sequence was found.

    Raises
    ------
    ValueError
        If sizes do not match or an entry is not finite.
    """

    states: np.ndarray
    inputs: np.ndarray
    costs: np.ndarray
    infeasible: np.ndarray

    def __post_init__(self):
        for name, ndim in (("states", 2), ("inputs", 2), ("costs", 1), ("infeasible", 2)):
            object.__setattr__(self, name, real_array(getattr(self, name), name, ndim))
        for name in ("inputs", "costs"):
            if len(getattr(self, name)) != len(self.states):
                raise ValueError(f"{name} has {len(getattr(self, name))} rows but states has {len(self.states)}")
        require_columns(self.infeasible, self.states.shape[1], "infeasible", "as states has")

    def __len__(self):
        return len(self.states)

    def __repr__(self):
        return f"DataSet({len(self)} states with inputs, {len(self.infeasible)} infeasible)"

    def save(self, path):
        """Write the data as CSV whose numbers read back to the same floats.

        The columns are x1.., u1.., cost, feasible (1 or 0; u and cost are blank where it is 0), and the
        last line, a comment, gives the number of rows.
        """
        n, m = self.states.shape[1], self.inputs.shape[1]
        lines = [",".join(_columns(n, m))]
        solved = np.column_stack([self.states, self.inputs, self.costs])
        lines += [",".join([*map(repr, row), "1"]) for row in solved.tolist()]
        lines += [",".join([*map(repr, row), *[""] * (m + 1), "0"]) for row in self.infeasible.tolist()]
        write_whole(path, "\n".join([*lines, END.format(len(lines) - 1)]) + "\n")

    @staticmethod
    def load(path):
        """Read a data set that `save` wrote.

        Raises
        ------
        CorruptFileError
            If the file is truncated or holds anything but such a data set; the message says where.
        """
        try:
            return _parse(Path(path).read_text(encoding="utf-8"))
        except ValueError as error:
            raise CorruptFileError(f"{path} holds no data set: {error}; restore it or make it again") from error


def make_pwa_data(seed=0, count=1000, progress=True, jobs=1):
    """The MIQP of case study 1 at random states (Sec. IV.A of [Teichrib2025]).

    Parameters
    ----------
    seed : int
    count : int
        States, uniform in X.
    progress : bool
        Show a progress bar.
    jobs : int
        Processes, -1 for one a core; anything but 1 needs joblib. The result does not depend on it.

    Returns
    -------
    DataSet
    """
    return _collect(_uniform(pwa_plant().state_set, seed, count), _solve_pwa, progress, jobs)


def make_double_integrator_data(grid=30, progress=True, jobs=1):
    """The nonlinear problem of case study 2 on a regular grid over X (Sec. IV.B of [Teichrib2025]).

    Parameters
    ----------
    grid : int
        States along each axis, the limits included.
    progress, jobs
        As in `make_pwa_data`.

    Returns
    -------
    DataSet
    """
    lower, upper = double_integrator_plant().state_set.bounding_box()
    axes = [np.linspace(low, high, grid) for low, high in zip(lower, upper)]
    states = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    return _collect(states, _solve_nonlinear, progress, jobs)


def make_three_tanks_data(seed=0, count=1500, progress=True, jobs=1):
    """The MIQP of the three tanks at random states.

    The middle level counts most: Q = diag(0.1, 0.1, 1), R = 10 I, N = 8, and P is the cost of the regulator that
    is optimal where the upper pipes are dry. Constraints are those of the plant.

    Parameters
    ----------
    seed, count, progress, jobs
        As in `make_pwa_data`.

    Returns
    -------
    DataSet
    """
    return _collect(_uniform(three_tanks_plant().state_set, seed, count), _solve_three_tanks, progress, jobs)


def make_four_tanks_data(seed=0, count=2000, progress=True, jobs=1):
    """The QP of the four tanks at random states: Q = diag(1, 1, 0.1, 0.1), R = 5 I, N = 20, P of the optimal regulator.

    Parameters
    ----------
    seed, count, progress, jobs
        As in `make_pwa_data`.

    Returns
    -------
    DataSet
    """
    return _collect(_uniform(four_tanks_plant().state_set, seed, count), _solve_four_tanks, progress, jobs)


MAKERS = {
    "pwa": make_pwa_data,
    "double_integrator": make_double_integrator_data,
    "three_tanks": make_three_tanks_data,
    "four_tanks": make_four_tanks_data,
}


def _solve_pwa(states, show):
    system = pwa_plant()
    return [solve_miqp(system, x) for x in show(states)]


def _solve_nonlinear(states, show):
    mpc = NonlinearMPC(double_integrator_plant())
    return [mpc.solve(x) for x in show(states)]


def _solve_three_tanks(states, show):
    return _solve_regulation(three_tanks_plant(), THREE_TANKS_HORIZON, THREE_TANKS_Q, THREE_TANKS_R, states, show)


def _solve_four_tanks(states, show):
    return _solve_regulation(four_tanks_plant(), FOUR_TANKS_HORIZON, FOUR_TANKS_Q, FOUR_TANKS_R, states, show)


def _solve_regulation(system, horizon, q, r, states, show):
    """Solutions with Q = diag(q), R = r I, and as P the cost to go of the first mode without constraints."""
    first, Q, R = system.modes[0], np.diag(q), r * np.eye(system.input_size)
    P = solve_discrete_are(first.A, first.B, Q, R)
    return [solve_miqp(system, x, horizon, Q, R, P) for x in show(states)]


def _uniform(box, seed, count):
    """Random states of a box: array (count, n)."""
    lower, upper = box.bounding_box()
    return np.random.default_rng(seed).uniform(lower, upper, (count, len(lower)))


def _collect(states, solve, progress, jobs):
    """The data set of `solve(states, show)`, a list of solutions, in `jobs` processes."""
    if jobs == 1:
        solutions = solve(states, partial(tqdm, desc="optimal control", unit="state", disable=not progress))
    else:
        solutions = _in_parallel(states, solve, progress, jobs)
    feasible = np.array([solution.feasible for solution in solutions], dtype=bool)
    found = [solution for solution in solutions if solution.feasible]
    if not found:
        raise MireachError(f"none of the {len(states)} states has a feasible input sequence; check the constraints")
    inputs, costs = [solution.inputs[0] for solution in found], [solution.cost for solution in found]
    return DataSet(states[feasible], np.array(inputs), np.array(costs), states[~feasible])


def _in_parallel(states, solve, progress, jobs):
    """Solutions in the order of `states`, a chunk a task."""
    chunks = np.array_split(states, min(len(states), 40))
    done = in_parallel(solve, [(chunk, iter) for chunk in chunks], jobs)
    shown = tqdm(done, total=len(chunks), desc="optimal control", unit="chunk", disable=not progress)
    return [solution for part in shown for solution in part]


def _columns(n, m):
    """Names of the columns for n states and m inputs."""
    return [*(f"x{i + 1}" for i in range(n)), *(f"u{i + 1}" for i in range(m)), "cost", "feasible"]


def _parse(text):
    """The data set in a file's text; ValueError says what is wrong and where."""
    header, *rows = csv.reader(io.StringIO(text)) if text else [[]]
    n, m = (sum(name.startswith(letter) for name in header) for letter in "xu")
    if header != _columns(n, m) or not n or not m:
        raise ValueError(f"its first line is {','.join(header)!r:.80}, not the columns x1.., u1.., cost, feasible")
    count = len(rows) - 1
    if not rows or ",".join(rows[-1]) != END.format(count) or not text.endswith("\n"):
        raise ValueError(f"its last line is not {END.format('(number of rows)')!r} for what it holds; it is truncated")
    solved, infeasible = [], []
    for number, row in enumerate(rows[:-1], start=2):
        try:
            if len(row) != len(header) or row[-1] not in ("0", "1") or (row[-1] == "0" and any(row[n:-1])):
                raise ValueError(f"{','.join(row)!r:.80} does not fit the columns")
            values = [float(entry) for entry in (row[:-1] if row[-1] == "1" else row[:n])]
        except ValueError as error:
            raise ValueError(f"line {number}: {error}") from error
        (solved if row[-1] == "1" else infeasible).append(values)
    table = np.array(solved).reshape(-1, n + m + 1)
    return DataSet(table[:, :n], table[:, n:-1], table[:, -1], np.array(infeasible).reshape(-1, n))
