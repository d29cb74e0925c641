"""Data sets: states, the optimal first inputs, and the states for which no input sequence is feasible."""

import csv
import io
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from scipy.linalg import solve_discrete_are
from tqdm.auto import tqdm

from ..checks import real_array, require_bools, require_columns, whole_number
from ..errors import CorruptFileError, MireachError
from ..files import END, write_whole
from ..sets.polytope import Polytope
from ..systems.plants import (
    aircraft_pitch_plant,
    double_integrator_plant,
    four_tanks_plant,
    pwa_plant,
    quadrotor_plant,
    three_tanks_plant,
)
from ..systems.pwa import PWASystem
from ..typing import Array, ArrayLike
from ..workers import in_parallel
from .mpc import MIQPSolution, NonlinearMPC, NonlinearSolution, solve_miqp


class Regulation(NamedTuple):
    """An optimal control problem with Q = diag(q), R = diag(r), and P the cost to go of the unconstrained regulator."""

    horizon: int
    q: tuple[float, ...]
    r: tuple[float, ...]


THREE_TANKS = Regulation(horizon=8, q=(0.1, 0.1, 1.0), r=(10.0, 10.0))
FOUR_TANKS = Regulation(horizon=20, q=(1.0, 1.0, 0.1, 0.1), r=(5.0, 5.0))
AIRCRAFT_PITCH = Regulation(horizon=12, q=(0.01, 3.0, 1.0), r=(1.0,))
QUADROTOR = Regulation(horizon=10, q=(1.0, 1.0, 1.0, 0.1, 0.1, 0.1), r=(1.0, 1.0, 10.0))
CHUNKS = 40  # of states, each one task of a process

Solutions: TypeAlias = Sequence[MIQPSolution | NonlinearSolution]
Show: TypeAlias = Callable[[Any], Iterable[Any]]  # goes through states, with or without a progress bar


@dataclass(frozen=True, eq=False, init=False)
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

    See Also
    --------
    train : Fits a network to the states and inputs.

    Examples
    --------
    >>> DataSet(states=[[0.5, 2.0]], inputs=[[3.0]], costs=[4.0], infeasible=[[8.0, 0.25]])
    DataSet(1 states with inputs, 1 infeasible)
    """

    states: Array
    inputs: Array
    costs: Array
    infeasible: Array

    def __init__(self, states: ArrayLike, inputs: ArrayLike, costs: ArrayLike, infeasible: ArrayLike) -> None:
        states, infeasible = real_array(states, "states", 2), real_array(infeasible, "infeasible", 2)
        inputs, costs = real_array(inputs, "inputs", 2), real_array(costs, "costs", 1)
        for name, value in (("inputs", inputs), ("costs", costs)):
            if len(value) != len(states):
                raise ValueError(f"{name} has {len(value)} rows but states has {len(states)}")
        require_columns(infeasible, states.shape[1], "infeasible", "as states has")
        fields = {"states": states, "inputs": inputs, "costs": costs, "infeasible": infeasible}
        for name, value in fields.items():
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return len(self.states)

    def __repr__(self) -> str:
        return f"DataSet({len(self)} states with inputs, {len(self.infeasible)} infeasible)"

    def save(self, path: str | Path) -> None:
        """Write the data as CSV whose numbers read back to the same floats.

        Parameters
        ----------
        path : str or Path

        Notes
        -----
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
    def load(path: str | Path) -> "DataSet":
        """Read a data set that `save` wrote.

        Parameters
        ----------
        path : str or Path

        Raises
        ------
        CorruptFileError
            If the file is truncated or holds anything but such a data set; the message says where.
        """
        try:
            return _parse(Path(path).read_text(encoding="utf-8"))
        except ValueError as error:
            raise CorruptFileError(f"{path} holds no data set: {error}; restore it or make it again") from error


def make_pwa_data(
    rng: np.random.Generator | int = 0, count: int = 1000, *, progress: bool = False, jobs: int = 1
) -> DataSet:
    """The MIQP of case study 1 at random states (Sec. V.A of [Teichrib2025]).

    Parameters
    ----------
    rng : numpy.random.Generator or int
        Draws the states; an int is a seed.
    count : int
        Number of states, uniform in X.
    progress : bool
        Show a progress bar.
    jobs : int
        Processes, -1 for one per core; anything but 1 needs joblib. The result does not depend on it.

    Returns
    -------
    DataSet

    Raises
    ------
    ValueError
        If `count` is not a whole number of at least 1.
    MireachError
        If no state has a feasible input sequence.

    Examples
    --------
    >>> make_pwa_data(rng=3, count=5)
    DataSet(5 states with inputs, 0 infeasible)
    """
    return _collect(_uniform(pwa_plant().state_set, rng, count), _solve_pwa, progress, jobs)


def make_double_integrator_data(grid: int = 30, *, progress: bool = False, jobs: int = 1) -> DataSet:
    """The nonlinear problem of case study 2 on a regular grid over X (Sec. V.B of [Teichrib2025]).

    Parameters
    ----------
    grid : int
        States along each axis, the limits included.
    progress, jobs
        As in `make_pwa_data`.

    Returns
    -------
    DataSet

    Raises
    ------
    ValueError
        If `grid` is not a whole number of at least 2.
    MireachError
        If no state has a feasible input sequence.

    Examples
    --------
    >>> data = make_double_integrator_data(grid=3)
    >>> len(data) + len(data.infeasible)
    9
    """
    grid = whole_number(grid, "grid", 2)
    lower, upper = double_integrator_plant().state_set.bounding_box()
    axes = [np.linspace(low, high, grid) for low, high in zip(lower, upper)]
    states = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    return _collect(states, _solve_nonlinear, progress, jobs)


def make_three_tanks_data(
    rng: np.random.Generator | int = 0, count: int = 1500, *, progress: bool = False, jobs: int = 1
) -> DataSet:
    """The MIQP of the three tanks at random states.

    The middle level counts most: Q = diag(0.1, 0.1, 1), R = 10 I, N = 8, and P is the cost of the regulator that
    is optimal where the upper pipes are dry. Constraints are those of the plant.

    Parameters
    ----------
    rng, count, progress, jobs
        As in `make_pwa_data`, which also says what is raised.

    Returns
    -------
    DataSet
    """
    return _collect(_uniform(three_tanks_plant().state_set, rng, count), _solve_three_tanks, progress, jobs)


def make_four_tanks_data(
    rng: np.random.Generator | int = 0, count: int = 2000, *, progress: bool = False, jobs: int = 1
) -> DataSet:
    """The QP of the four tanks at random states: Q = diag(1, 1, 0.1, 0.1), R = 5 I, N = 20, P of the optimal regulator.

    Parameters
    ----------
    rng, count, progress, jobs
        As in `make_pwa_data`, which also says what is raised.

    Returns
    -------
    DataSet
    """
    return _collect(_uniform(four_tanks_plant().state_set, rng, count), _solve_four_tanks, progress, jobs)


def make_aircraft_pitch_data(
    rng: np.random.Generator | int = 0, count: int = 2000, *, progress: bool = False, jobs: int = 1
) -> DataSet:
    """The QP of the aircraft's pitch at random states: Q = diag(0.01, 3, 1), R = 1, N = 12, P of the optimal regulator.

    Parameters
    ----------
    rng, count, progress, jobs
        As in `make_pwa_data`, which also says what is raised.

    Returns
    -------
    DataSet
    """
    return _collect(_uniform(aircraft_pitch_plant().state_set, rng, count), _solve_aircraft_pitch, progress, jobs)


def make_quadrotor_data(
    rng: np.random.Generator | int = 0, count: int = 1500, *, progress: bool = False, jobs: int = 1
) -> DataSet:
    """The QP of the quadrotor at random states.

    Q = diag(1, 1, 1, 0.1, 0.1, 0.1), R = diag(1, 1, 10), N = 10, P of the optimal regulator.

    Parameters
    ----------
    rng, count, progress, jobs
        As in `make_pwa_data`, which also says what is raised.

    Returns
    -------
    DataSet
    """
    return _collect(_uniform(quadrotor_plant().state_set, rng, count), _solve_quadrotor, progress, jobs)


def _solve_pwa(states: Array, show: Show) -> Solutions:
    """Solutions of case study 1."""
    system = pwa_plant()
    return [solve_miqp(system, x) for x in show(states)]


def _solve_nonlinear(states: Array, show: Show) -> Solutions:
    """Solutions of case study 2."""
    mpc = NonlinearMPC(double_integrator_plant())
    return [mpc.solve(x) for x in show(states)]


def _solve_three_tanks(states: Array, show: Show) -> Solutions:
    """Solutions of the three tanks."""
    return _solve_regulation(three_tanks_plant(), THREE_TANKS, show(states))


def _solve_four_tanks(states: Array, show: Show) -> Solutions:
    """Solutions of the four tanks."""
    return _solve_regulation(four_tanks_plant(), FOUR_TANKS, show(states))


def _solve_aircraft_pitch(states: Array, show: Show) -> Solutions:
    """Solutions of the aircraft's pitch."""
    return _solve_regulation(aircraft_pitch_plant(), AIRCRAFT_PITCH, show(states))


def _solve_quadrotor(states: Array, show: Show) -> Solutions:
    """Solutions of the quadrotor."""
    return _solve_regulation(quadrotor_plant(), QUADROTOR, show(states))


def _solve_regulation(system: PWASystem, problem: Regulation, states: Iterable[Array]) -> Solutions:
    """Solutions of a regulation problem; P is that of the first mode."""
    Q, R = np.diag(problem.q), np.diag(problem.r)
    P = solve_discrete_are(system.modes[0].A, system.modes[0].B, Q, R)
    return [solve_miqp(system, x, problem.horizon, Q, R, P) for x in states]


def _uniform(box: Polytope, rng: np.random.Generator | int, count: int) -> Array:
    """Random states of a box: array (count, n)."""
    lower, upper = box.bounding_box()
    return np.random.default_rng(rng).uniform(lower, upper, (whole_number(count, "count", 1), len(lower)))


def _collect(states: Array, solve: Callable[[Array, Show], Solutions], progress: bool, jobs: int) -> DataSet:
    """The data set of `solve(states, show)`, a list of solutions, in `jobs` processes."""
    require_bools(progress=progress)
    if jobs == 1:
        solutions = solve(states, partial(tqdm, desc="optimal control", unit="state", disable=not progress))
    else:
        solutions = _in_parallel(states, solve, progress, jobs)
    feasible = np.array([solution.feasible for solution in solutions], dtype=bool)
    solved = [(solution.inputs[0], solution.cost) for solution in solutions if solution.inputs is not None]
    if not solved:
        raise MireachError(f"none of the {len(states)} states has a feasible input sequence; check the constraints")
    inputs, costs = (np.array(values) for values in zip(*solved))
    return DataSet(states[feasible], inputs, costs, states[~feasible])


def _in_parallel(
    states: Array, solve: Callable[[Array, Show], Solutions], progress: bool, jobs: int
) -> list[MIQPSolution | NonlinearSolution]:
    """Solutions in the order of `states`, one chunk per task."""
    chunks = np.array_split(states, min(len(states), CHUNKS))
    done = in_parallel(solve, [(chunk, iter) for chunk in chunks], jobs)
    shown = tqdm(done, total=len(chunks), desc="optimal control", unit="chunk", disable=not progress)
    return [solution for part in shown for solution in part]


def _columns(n: int, m: int) -> list[str]:
    """Names of the columns for n states and m inputs."""
    return [*(f"x{i + 1}" for i in range(n)), *(f"u{i + 1}" for i in range(m)), "cost", "feasible"]


def _parse(text: str) -> DataSet:
    """The data set in a file's text; ValueError says what is wrong and where."""
    header, *rows = [*csv.reader(io.StringIO(text))] or [[]]
    n, m = (sum(name.startswith(letter) for name in header) for letter in "xu")
    if header != _columns(n, m) or not n or not m:
        raise ValueError(f"its first line is {','.join(header)!r:.80}, not the columns x1.., u1.., cost, feasible")
    count = len(rows) - 1
    if not rows or ",".join(rows[-1]) != END.format(count) or not text.endswith("\n"):
        raise ValueError(f"its last line is not {END.format('(number of rows)')!r} for what it holds; it is truncated")
    solved: list[list[float]] = []
    infeasible: list[list[float]] = []
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
