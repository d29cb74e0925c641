"""Lemmas 1 and 2 of [Teichrib2025] by mixed-integer linear programming (HiGHS), for any number of states and steps.

There are three formulations. "paper" is eq. (17), MILPReachableSets, as it is printed. "whole" is one model with a
big-M for every row and without variables that bounds show to be superfluous. "split" is a branch and bound over boxes
of the state space: affine bounds (`boxes`) settle most boxes, and models with few binaries settle the others.

A bound is a bound over boxes, with rounding counted, or the largest bound of the nodes of a search tree, each proven by
weak duality: HiGHS proposes multipliers and incumbents, but the bound does not depend on HiGHS. Only where a model with
many binaries takes more than `PROOF_NODES` nodes, HiGHS's own bound is returned, and `rests_on` says so. A value is
attained by a trajectory that satisfies all constraints in rational arithmetic (`attained`).
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import product
from os import cpu_count
from threading import Lock
from time import perf_counter
from typing import ClassVar, NamedTuple

import highspy
import numpy as np

from ...checks import positive_number, real_array, whole_number
from ...errors import SolverError, SolverStopped
from ...sets.polytope import Polytope
from ...solvers.branch_and_bound import BRANCHED
from ...systems.loop import ClosedLoop
from ...tolerances import (
    INPUT_TOLERANCE,
    INTEGRALITY,
    LOOSE_MILP_BOUND,
    MILP_MARGIN,
    MILP_RESOLUTION,
    MIP_GAP,
    NEEDLE_POINT,
    WRONG_BOUND,
)
from ...typing import Array, ArrayLike, BoolArray, IntArray
from ..attained import Attained, Path, attained
from ..base import COUNTED, SOLVER, Engine, Support, Witness, checked_query, empty_support, replay
from ..bounds import METHODS, SAFETY, proven_support, support_vectors
from ..boxes import Boxes, LoopBounds, StepBounds, bound_loop, root_box
from .formulation import Model, build, build_inputs

FORMULATIONS = ("split", "whole", "paper")
KEPT = 6  # best trajectories per direction: rational arithmetic may reject some of them
FEW = 8  # binaries per step of a box that is not split further
MANY = 40  # boxes solved for one direction, divided by k^2, after which one model of all of F settles it
NARROW = 1e-4  # a box is not split along a side shorter than this (relative to 1 + where it is)
MOST_BOXES = 20_000  # boxes bounded for one set, divided by k^4; then one model of all of F settles the rest
AT_ONCE = 1024  # boxes that are bounded together, which limits the memory
ROUNDS = 12  # rounds of sampling, ever closer to the best states
FITTING = 0.7  # boxes of a larger set are used if the volume of the box around F is at least this share of its box
SAMPLES = 200  # random states for the first attained values


@dataclass(frozen=True)
class Milp(Engine):
    """h of R_k(F) by the MILP of Lemma 2, for any number of states, inputs and steps; HiGHS solves the programs.

    Parameters
    ----------
    formulation : "split", "whole" or "paper"
        "split": F & X is halved until few binaries are left in each box that may contain the maximum. "whole": one
        model. "paper": one model as in the paper, with s + sum of p_i w_i binaries per step and big-M by interval
        arithmetic, one for each layer and one for the plant.
    bounds : "interval", "lp" or "tight"
        Where the big-M of "whole" come from: ranges of single variables; LPs over the model so far; or MILPs over it,
        stopped early, where the LP does not decide a sign (see `bounds.upper_bound`). "split" uses it only for boxes
        that still need many binaries; "paper" always uses intervals.
    time_limit : float or None
        Seconds for the whole call: all directions, all steps and the building of models. It is checked between linear
        programs, so that a call may take a little longer.
    gap : float
        Relative gap between bound and value at which the solver may stop. The default of HiGHS, 1e-4, is too large for
        sets that are compared with each other.
    jobs : int or None
        Threads that share the directions; the result does not depend on it. None is one per core where a model has
        more than `BRANCHED` binaries, so that HiGHS's MILP solver runs, which releases the GIL; else one.

    Raises
    ------
    ValueError
        If a setting is not as above.

    See Also
    --------
    Cvxpy : the paper's formulation, for reading together with the paper.
    """

    name: ClassVar[str] = "milp"
    resolution: ClassVar[float] = MILP_RESOLUTION

    formulation: str = "split"
    bounds: str = "lp"
    time_limit: float | None = None
    gap: float = MIP_GAP
    jobs: int | None = None

    def __post_init__(self) -> None:
        if self.formulation not in FORMULATIONS:
            raise ValueError(f"formulation must be one of {FORMULATIONS}; got {self.formulation!r}")
        if self.bounds not in METHODS:
            raise ValueError(f"bounds must be one of {METHODS}; got {self.bounds!r}")
        if self.time_limit is not None:
            positive_number(self.time_limit, "time_limit")
        if not float(real_array(self.gap, "gap", 0)) >= 0:
            raise ValueError(f"gap must not be negative; got {self.gap}")
        if self.jobs is not None:
            whole_number(self.jobs, "jobs", 1)

    @property
    def software(self) -> str:
        """HiGHS with its version."""
        return f"HiGHS {highspy.Highs().version()}"

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
        """As `Engine.support`.

        Notes
        -----
        `bound` is that of the boxes, or the dual bound of `LinearProgram.maximize_integer`. `value` is attained by a
        trajectory in rational arithmetic and rounded downward; the witness is that trajectory, rounded to floats. It
        is -inf, without a witness, where no such trajectory is found. `rests_on` is COUNTED, or SOLVER if a bound of
        HiGHS that is not proven contributes. "split" returns a `BoxSupport`, whose boxes and bounds are the warm
        start for a smaller set; of any other `warm_start` only the bounds are used. "whole" and "paper" do not use the
        cutoff.

        Raises
        ------
        SolverStopped
            If the time limit was reached first; its `support` holds what was found, and `bound` is proven.
        SolverError
            If a bound cannot be right because a trajectory exceeds it.
        """
        V, steps = checked_query(loop, F, V, steps)
        end = np.inf if self.time_limit is None else perf_counter() + self.time_limit
        start = F & loop.system.state_set
        if start.is_empty:
            return empty_support(len(V))
        earlier = np.full(len(V), np.inf) if warm_start is None else warm_start.bound
        limit = np.full(len(V), -np.inf) if cutoff is None else real_array(cutoff, "cutoff", 1)
        problem = _Problem(loop, start, V, steps, self.bounds, self.gap, end, earlier)
        if self.formulation == "split":
            before = warm_start if isinstance(warm_start, BoxSupport) else None
            answers, cover = _split(problem, limit, self.jobs, before)
        else:
            answers, cover = _from_one_model(problem, self.formulation, self.jobs), None
        trajectories = [attained(loop, start, answer.v, answer.paths, end=end) for answer in answers]
        if any(answer.bound == -np.inf for answer in answers) and all(one is None for one in trajectories):
            return empty_support(len(V))
        found = _support(answers, trajectories, cover, _rests_on(warm_start, answers))
        if not all(answer.finished for answer in answers):
            raise SolverStopped(_stopped(self.time_limit), found)
        return found


def _stopped(time_limit: float | None) -> str:
    """The message of a SolverStopped."""
    return f"the MILP was stopped by time_limit = {time_limit} s; allow more time"


def _rests_on(warm_start: Support | None, answers: "Sequence[_Answer]") -> str:
    """What the bounds of a Support rest on, given its warm start."""
    proven = all(answer.proven for answer in answers)
    return SOLVER if not proven or (warm_start is not None and warm_start.rests_on == SOLVER) else COUNTED


@dataclass(frozen=True, eq=False)
class BoxSupport(Support):
    """A Support and the boxes from which it comes.

    Attributes
    ----------
    boxes : Boxes
        Of (x(0), d(0), ..., d(k - 2)); together they contain every trajectory that starts in F and stays in X.
    upper : array (B, k)
        Upper bounds of v x(k) from each box.
    root : Boxes
        The one box that was halved.
    """

    boxes: Boxes
    upper: Array
    root: Boxes


class _Cover(NamedTuple):
    """What a BoxSupport adds to a Support."""

    boxes: Boxes
    upper: Array
    root: Boxes


def _support(
    answers: "Sequence[_Answer]", trajectories: Sequence[Attained | None], cover: _Cover | None, rests_on: str
) -> Support:
    """The Support of all directions; SolverError if a trajectory exceeds a bound."""
    bound = np.array([answer.bound for answer in answers])
    value = np.array([-np.inf if one is None else one.value for one in trajectories])
    witness = tuple(None if one is None else one.witness() for one in trajectories)
    _require_consistent(np.array([answer.v for answer in answers]), bound, witness)
    bound = np.maximum(bound, value)
    if cover is None:
        return Support(value, bound, witness, rests_on=rests_on)
    return BoxSupport(value, bound, witness, *cover, rests_on=rests_on)


@dataclass(frozen=True, eq=False)
class _Problem:
    """The largest v x(k), or v u(0), over trajectories from F, for each row v of V.

    Attributes
    ----------
    loop : ClosedLoop
    F : Polytope
        In X.
    V : array (k, n), or (k, m) for inputs
    steps : int
    bounds : str
        As in `Milp`.
    gap : float
    end : float
        The `perf_counter` at which the time limit is over.
    earlier : array (k,)
        Upper bounds that hold already, from a warm start.
    inputs : bool
        The objective is v u(0) instead of v x(k).
    """

    loop: ClosedLoop
    F: Polytope
    V: Array
    steps: int
    bounds: str
    gap: float
    end: float
    earlier: Array
    inputs: bool = False

    @cached_property
    def spread(self) -> Array:
        """Upper bounds of the support function of the disturbance sets along V: (s, k)."""
        modes = self.loop.system.modes
        of_set = {D: proven_support(D, self.V) for D in {mode.disturbance for mode in modes}}
        return np.array([of_set[mode.disturbance] for mode in modes])

    @cached_property
    def root(self) -> Boxes:
        """The box around all (x(0), d(0), ..., d(k - 2))."""
        return root_box(self.loop, self.F, self.steps)

    def upper(self, bounds: LoopBounds) -> Array:
        """Upper bounds over the boxes of LoopBounds: (B, k)."""
        return bounds.highest_input(self.V) if self.inputs else bounds.highest_state(self.loop, self.V, self.spread)

    def enough(self, value: Array | float, cutoff: Array | float) -> Array:
        """Upper bounds (k,) that need not be lowered further, given attained values."""
        return np.maximum(_above(value, self.gap), cutoff)

    def model(self, bounds: str, box: Boxes, step_bounds: list[StepBounds]) -> Model | None:
        """The MILP on one box, or None."""
        if self.inputs:
            return build_inputs(self.loop, self.F, bounds, box, step_bounds, self.end)
        return build(self.loop, self.F, self.steps, bounds, "whole", box, step_bounds, self.end)

    @property
    def is_over(self) -> bool:
        """Whether the time limit is over."""
        return perf_counter() > self.end

    @property
    def remaining(self) -> float | None:
        """Seconds until the time limit, or None."""
        return None if self.end == np.inf else max(self.end - perf_counter(), 0.0)


@dataclass(eq=False)
class _Answer:
    """The result along one direction so far.

    Attributes
    ----------
    v : array (n,)
    bound : float
    paths : list of (value, Path)
        The best trajectories with their values in floats, the best first.
    finished : bool
        False if the time limit was reached first.
    proven : bool
        Whether the bound rests on no bound of HiGHS.
    """

    v: Array
    bound: float = -np.inf
    paths: list[tuple[float, Path]] = field(default_factory=list)
    finished: bool = True
    proven: bool = True

    @property
    def value(self) -> float:
        """The largest value that floats attain."""
        return self.paths[0][0] if self.paths else -np.inf

    @property
    def path(self) -> Path | None:
        """The trajectory that attains it, or None."""
        return self.paths[0][1] if self.paths else None

    def offer(self, value: float, path: Path) -> None:
        """Keep a trajectory if it is better."""
        if value > self.value:
            self.paths = [(float(value), path), *self.paths[: KEPT - 1]]


def _above(value: Array | float, gap: float = 0.0) -> Array:
    """A bound that is close enough above an attained value."""
    return value + np.where(np.isfinite(value), INTEGRALITY + (MILP_MARGIN + gap) * (1 + np.abs(value)), 0)


# -- branch and bound over boxes ----------------------------------------------------------------------


def _split(
    problem: _Problem, cutoff: Array, jobs: int | None, before: BoxSupport | None = None
) -> tuple[list[_Answer], _Cover]:
    """An _Answer for each direction, by branch and bound over boxes and MILPs on those that are left.

    `before` is the BoxSupport of a larger set. Its boxes are the first ones where that set is not much larger than F.
    """
    answers = [_Answer(v) for v in problem.V]
    simulation = _Simulation(problem, answers)
    simulation.improve()
    search = _Search(problem, simulation, cutoff, before)
    while len(search.boxes):
        search.advance()
    boxes, upper = _joined(search.left)
    keep = np.any(upper > problem.enough(simulation.values, cutoff), axis=1)
    settled = np.maximum(search.settled, upper[~keep].max(axis=0, initial=-np.inf))
    leaves = _Leaves(problem, boxes.take(keep), upper[keep], search.most_models)

    def settle(row: int) -> None:
        answers[row].bound = settled[row]
        leaves.settle(row, answers[row], cutoff[row])

    _share(settle, len(answers), jobs, leaves.large)
    return answers, _Cover(*_joined([(boxes, upper), *search.done]), search.root)


class _Search:
    """Branch and bound over boxes of (x(0), d(0), ..., d(k - 2)): boxes are bounded, then settled, left or halved.

    Attributes
    ----------
    boxes : Boxes
        Those that are to be bounded.
    upper : array (B, k)
        Upper bounds over them.
    root : Boxes
        The one box that was halved.
    settled : array (k,)
        Upper bounds over the settled boxes, which are not searched further.
    left : list of (Boxes, upper)
        Boxes that are not halved further and need a MILP.
    done : list of (Boxes, upper)
        Boxes that are settled along every direction.
    """

    def __init__(self, problem: _Problem, simulation: "_Simulation", cutoff: Array, before: BoxSupport | None) -> None:
        self.problem, self.simulation = problem, simulation
        self.cutoff = cutoff
        self.boxes = self.root = problem.root
        self.upper = problem.earlier[None].copy()
        self.settled = np.full(len(problem.V), -np.inf)
        self.left: list[tuple[Boxes, Array]] = []
        self.done: list[tuple[Boxes, Array]] = []
        self._count = 0
        if before is not None and (self.root.half_width / before.root.half_width).prod() > FITTING:
            self.boxes, chosen = before.boxes.within(self.root)
            self.upper = np.minimum(before.upper[chosen], self.upper)
            self.root = before.root

    @property
    def most_models(self) -> int:
        """Boxes solved for one direction, after which one model of all of F settles it."""
        return 1 if self._is_exhausted else max(1, MANY // self.problem.steps**2)

    @property
    def _is_exhausted(self) -> bool:
        """Whether the limit on bounded boxes of one search is reached."""
        return self._count > MOST_BOXES / self.problem.steps**4

    def advance(self) -> None:
        """Bound the first `AT_ONCE` boxes."""
        problem, first = self.problem, np.arange(len(self.boxes)) < AT_ONCE
        waiting, waiting_upper = self.boxes.take(~first), self.upper[~first]
        first &= self.boxes.meets(problem.F)
        boxes, upper = self.boxes.take(first), self.upper[first]
        self._count += len(boxes)
        found = bound_loop(problem.loop, boxes, problem.steps)
        upper = np.minimum(upper, problem.upper(found))
        self.simulation.look_at(boxes.middle)
        still = upper > problem.enough(self.simulation.values, self.cutoff)
        self.settled = np.maximum(self.settled, np.where(still, -np.inf, upper).max(axis=0, initial=-np.inf))
        keep = np.any(still, axis=1)
        below = ~keep & np.isfinite(upper).any(axis=1)
        self.done.append((boxes.take(below), upper[below]))
        wide = boxes.half_width > NARROW * (1 + boxes.size)
        few = found.binaries <= FEW * problem.steps
        leaf = keep & (self._is_exhausted | problem.is_over | few | ~wide.any(axis=1))
        self.left.append((boxes.take(leaf), upper[leaf]))
        on = keep & ~leaf
        halves = boxes.take(on).split(np.where(wide, found.doubt, -1)[on].argmax(axis=1), SAFETY)
        self.boxes, self.upper = _joined([(waiting, waiting_upper), (halves, np.concatenate([upper[on], upper[on]]))])


def _joined(parts: Sequence[tuple[Boxes, Array]]) -> tuple[Boxes, Array]:
    """Boxes and their bounds (B, k) from several pairs of both."""
    boxes, upper = zip(*parts)
    lower, higher = (np.concatenate([getattr(part, end) for part in boxes]) for end in ("lower", "upper"))
    return Boxes(lower, higher), np.concatenate(upper)


class _Leaves:
    """The boxes that are left, and a MILP on each of them; after `most_models` of them one model of all of F."""

    def __init__(self, problem: _Problem, boxes: Boxes, upper: Array, most_models: int) -> None:
        self.problem, self.boxes = problem, boxes
        self.upper, self.most_models = upper, most_models
        self.found = bound_loop(problem.loop, boxes, problem.steps)
        self.simple = self.found.binaries <= FEW * problem.steps
        self.large = bool((self.found.binaries > BRANCHED).any())
        self.models: dict[tuple[int | None, str], _Shared] = {}

    def model(self, index: int | None, bounds: str) -> Model | None:
        """The model on one box, or of all of F for None; None if it is proven empty. `bounds` as in `Milp`."""
        if index is None:
            box = self.problem.root
            return self.problem.model(bounds, box, bound_loop(self.problem.loop, box, self.problem.steps).at(0))
        return self.problem.model(bounds, self.boxes.take([index]), self.found.at(index))

    def solve(self, index: int | None, bounds: str, answer: _Answer, cutoff: float) -> float:
        """The bound on one box along the answer's direction, or one that is not above the cutoff."""
        shared = self.models.setdefault((index, bounds), _Shared(partial(self.model, index, bounds)))
        return shared.solve(self.problem, answer, cutoff)

    def settle(self, row: int, answer: _Answer, cutoff: float) -> None:
        """Solve on one box after another, the largest bound first, until the others cannot be better."""
        upper, careful = self.upper[:, row], self.problem.bounds
        for count, index in enumerate(np.argsort(-upper, kind="stable").tolist()):
            if upper[index] <= self.problem.enough(answer.value, cutoff):
                answer.bound = max(answer.bound, upper[index])
                break
            if self.problem.is_over:
                answer.finished, answer.bound = False, max(answer.bound, upper[index])
                break
            if count == self.most_models:
                answer.bound = max(answer.bound, min(self.solve(None, careful, answer, cutoff), upper[index]))
                break
            quick = "interval" if self.simple[index] else careful
            bound = min(self.solve(index, quick, answer, cutoff), upper[index])
            loose = bound > max(answer.value + LOOSE_MILP_BOUND * (1 + abs(bound)), cutoff)
            if answer.finished and loose and quick != careful:
                bound = min(bound, self.solve(index, careful, answer, cutoff))  # smaller big-M
            answer.bound = max(answer.bound, bound)


class _Shared:
    """A model that is built at its first use; each thread solves a copy of its own."""

    def __init__(self, build: Callable[[], Model | None]) -> None:
        self._build = build
        self._building = Lock()
        self._idle: list[Model] = []

    def solve(self, problem: _Problem, answer: _Answer, cutoff: float = -np.inf) -> float:
        """The bound along the answer's direction, or one that is not above the cutoff; -inf if there is no model."""
        with self._building:
            if self._model is None:
                return -np.inf
            model = self._idle.pop() if self._idle else replace(self._model, program=self._model.program.copy())
        bound = _solve(problem, model, answer, cutoff)
        self._idle.append(model)
        return bound

    @cached_property
    def _model(self) -> Model | None:
        return self._build()


class _Simulation:
    """Attained values: trajectories from states of F, with random extreme disturbances, the last one the best."""

    def __init__(self, problem: _Problem, answers: list[_Answer]) -> None:
        self.problem, self.answers = problem, answers
        self.rng = np.random.default_rng(0)
        self.modes = problem.loop.system.modes
        self.before = range(problem.steps - 1)  # the steps whose disturbance has to be chosen
        diagonals = np.array(list(product([-1.0, 1.0], repeat=problem.loop.system.state_size)))
        self.extreme = [_extreme_points(mode.disturbance, diagonals) for mode in self.modes] if self.before else []

    @property
    def values(self) -> Array:
        """The largest value of each direction in floats: (k,)."""
        return np.array([answer.value for answer in self.answers])

    def improve(self, rounds: int = ROUNDS) -> None:
        """Try random states of F, then states and disturbances ever closer to the best ones."""
        F, n = self.problem.F, self.problem.loop.system.state_size
        across = np.zeros((0, n)) if self.problem.inputs else self.problem.V
        corners = _extreme_points(F, np.vstack([np.eye(n), -np.eye(n), across]))
        states = self.rng.dirichlet(np.full(len(corners), 0.5), SAMPLES) @ corners
        self.try_all(np.vstack([corners, states]))
        for shrink in 0.6 ** np.arange(1, rounds + 1):
            if self.problem.is_over:
                return
            paths = [answer.path for answer in self.answers if answer.path is not None]
            if not paths:
                return
            towards = np.vstack([corners, states[self.rng.integers(len(states), size=8)]])
            best = np.array([path.start for path in paths])
            x = ((1 - shrink) * best[:, None] + shrink * towards).reshape(-1, n)
            drawn = [np.repeat([path.disturbances[j] for path in paths], len(towards), axis=0) for j in self.before]
            self.try_all(x, drawn)

    def look_at(self, w: Array) -> None:
        """Try the states x(0) of points w (N, D)."""
        x = w[:, : self.problem.loop.system.state_size]
        self.try_all(x[self.problem.F.contains(x)])

    def try_all(self, x: Array, disturbances: Sequence[Array] | None = None) -> None:
        """Simulate from states x (N, n); of given disturbances (k - 1 arrays (N, n)) one in four is drawn anew."""
        problem, loop = self.problem, self.problem.loop
        if problem.inputs:
            self._offer(loop.network(x) @ problem.V.T, lambda i, row: Path(x[i], [], []))
            return
        alive, start = np.arange(len(x)), x
        modes: list[IntArray] = []
        drawn: list[Array] = []
        for j in self.before:
            u = loop.network(x)
            inside = loop.system.violation(x, u) <= 0
            chosen, d = self._draw(x, inside, None if disturbances is None else disturbances[j][alive])
            after = loop.system.successor(x, u, chosen) + d
            kept = inside.any(axis=1) & loop.system.state_set.contains(after)
            x, start = after[kept], start[kept]
            alive = alive[kept]
            modes = [part[kept] for part in (*modes, chosen)]
            drawn = [part[kept] for part in (*drawn, d)]
        inside = loop.system.violation(x, loop.network(x)) <= 0
        values = np.where(inside[:, :, None], self._ends(x) @ problem.V.T + problem.spread, -np.inf)  # (N, s, k)
        last = values.argmax(axis=1)
        self._offer(
            values.max(axis=1),
            lambda i, row: Path(start[i], [*(part[i] for part in modes), last[i, row]], [d[i] for d in drawn]),
        )

    def _draw(self, x: Array, inside: BoolArray, given: Array | None) -> tuple[IntArray, Array]:
        """A random mode (N,) of those that act on each state, and a disturbance (N, n) of it."""
        chosen = np.where(inside, self.rng.random(inside.shape), -1).argmax(axis=1)
        d = np.array([self.extreme[i][self.rng.integers(len(self.extreme[i]))] for i in chosen]).reshape(x.shape)
        if given is not None:
            keep = self.rng.random(len(x)) < 0.75
            keep &= [self.modes[i].disturbance.contains(one) for i, one in zip(chosen, given)]
            d = np.where(keep[:, None], given, d)
        return chosen, d

    def _ends(self, x: Array) -> Array:
        """A x + B Phi(x) + p of every mode: (N, s, n)."""
        A, B, p = self.problem.loop.system.maps
        u = self.problem.loop.network(x)
        return np.einsum("sij,tj->tsi", A, x) + np.einsum("sij,tj->tsi", B, u) + p

    def _offer(self, values: Array, path: Callable[[int, int], Path]) -> None:
        """Offer the best of values (N, k) to each direction."""
        if len(values):
            for row, (answer, i) in enumerate(zip(self.answers, values.argmax(axis=0))):
                answer.offer(values[i, row], path(i, row))


def _extreme_points(P: Polytope, V: Array) -> Array:
    """Support vectors of a polytope along the rows of V: (e, n).

    With the solver's tolerances, points may lie far beyond the tip of a very thin set. They are left out, unless there
    are no others.
    """
    points = support_vectors(P, V)
    excess = (points @ P.H.T - P.h).max(axis=1)
    return points[excess <= max(NEEDLE_POINT, excess.min())]


# -- one model ----------------------------------------------------------------------------------------


def _from_one_model(problem: _Problem, formulation: str, jobs: int | None) -> list[_Answer]:
    """An _Answer for each direction, from one model of all of F."""
    answers = [_Answer(v) for v in problem.V]
    loop, F = problem.loop, problem.F
    model = _Shared(partial(build, loop, F, problem.steps, problem.bounds, formulation, end=problem.end))
    _Simulation(problem, answers).improve()
    root = bound_loop(loop, problem.root, problem.steps)
    upper = np.minimum(problem.earlier, problem.upper(root)[0])

    def settle(row: int) -> None:
        answers[row].bound = min(model.solve(problem, answers[row]), upper[row])

    _share(settle, len(answers), jobs, True)
    return answers


def _solve(problem: _Problem, model: Model, answer: _Answer, cutoff: float) -> float:
    """Solve a model along the answer's direction, offer its trajectory to the answer, and return the bound."""
    enough = max(answer.value, 2 * cutoff - float(_above(cutoff, problem.gap)) if cutoff > -np.inf else cutoff)
    found = model.program.maximize_integer(
        model.states[-1], answer.v, gap=problem.gap, enough=enough, time_limit=problem.remaining
    )
    answer.finished &= found.finished
    answer.proven &= found.proven
    if found.point is not None:
        x = found.point[model.states[0]]
        modes = [int(np.argmax(found.point[columns])) for columns in model.modes]
        path = Path(x, modes, [found.point[d] for d in model.disturbances])
        if problem.inputs:
            answer.offer(float(answer.v @ problem.loop.network(x)), path)
        else:
            answer.offer(answer.v @ replay(problem.loop, *path).states[-1], path)
    return found.bound


def _share(work: Callable[[int], None], count: int, jobs: int | None, large: bool) -> None:
    """work(row) for the rows 0, ..., count - 1, by `jobs` threads; for None one per core if models are large."""
    jobs = jobs or (cpu_count() if large else 1) or 1
    if min(jobs, count) <= 1:
        for row in range(count):
            work(row)
        return
    with ThreadPoolExecutor(min(jobs, count)) as pool:
        list(pool.map(work, range(count)))


# -- checks -------------------------------------------------------------------------------------------


def violating_state(loop: ClosedLoop, U: Polytope, bounds: str = "lp", time_limit: float | None = None) -> Array | None:
    """A state (n,) of X at which Phi leaves the Polytope U by more than `INPUT_TOLERANCE`, or None.

    Raises
    ------
    SolverStopped
        If the time limit, in seconds, was reached first.
    SolverError
        If neither can be shown: that Phi stays in U, or that it leaves U.
    """
    end = np.inf if time_limit is None else perf_counter() + positive_number(time_limit, "time_limit")
    X, limits = loop.system.state_set, U.h + INPUT_TOLERANCE * (1 + np.abs(U.h))
    found = bound_loop(loop, root_box(loop, X, 1))
    open_rows = found.highest_input(U.H)[0] > limits
    if not open_rows.any():
        return None
    V, limits = U.H[open_rows], limits[open_rows]
    problem = _Problem(loop, X, V, 1, bounds, MIP_GAP, end, np.full(len(V), np.inf), inputs=True)
    for answer, limit in zip(_split(problem, limits, 1)[0], limits):
        if answer.bound <= limit:
            continue
        trajectory = attained(loop, X, answer.v, answer.paths, inputs=True, end=end)
        if trajectory is not None and trajectory.value > limit:
            return trajectory.start
        if not answer.finished:
            raise SolverStopped(_stopped(time_limit))
        raise SolverError(
            f"it could not be shown that the network stays in the input set: {answer.v.tolist()} u is at most "
            f"{answer.bound:.9g}, where {limit:.9g} is allowed; use network.saturate(lower, upper)"
        )
    return None


def _require_consistent(V: Array, bound: Array, witness: Sequence[Witness | None]) -> None:
    """Raise SolverError if a trajectory, of whichever direction, exceeds a bound by more than rounding."""
    ends = np.array([one.states[-1] for one in witness if one is not None]).reshape(-1, V.shape[1])
    values = (ends @ V.T).max(axis=0, initial=-np.inf)
    excess = values - bound
    worst = int(np.argmax(excess))
    if excess[worst] > WRONG_BOUND * (1 + abs(values[worst])):
        raise SolverError(
            f"direction {V[worst].tolist()} has the bound {bound[worst]:.9g}, but a trajectory exceeds it by "
            f'{excess[worst]:.3g}; try another formulation, or engine="cells" for two states'
        )
