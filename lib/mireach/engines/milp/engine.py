"""Lemmas 1 and 2 of [Teichrib2025] by mixed-integer linear programming (HiGHS), for any number of states and steps.

Three formulations answer the same question. "paper" is eq. MILPReachableSets as it is printed, "whole" is one model
with a big-M for every row and without what bounds show to be superfluous, and "split" is a branch and bound over boxes
of the state space: affine bounds (`boxes`) settle most of them, and what is left are models with a handful of binaries.

A bound is one of boxes, with rounding counted, or the largest of the nodes of a search tree, each proven by weak
duality: HiGHS proposes multipliers and incumbents and is not believed. Only where a model with many binaries takes more
than `PROOF_NODES` nodes, HiGHS's own bound is returned, and the support says that it rests on it. A value is
attained by a trajectory that satisfies all constraints in rational arithmetic (`attained`).
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import product
from os import cpu_count
from threading import Lock
from time import perf_counter
from typing import ClassVar

import highspy
import numpy as np

from ...checks import positive_number, real_array, whole_number
from ...errors import SolverError, SolverStopped
from ...solvers.linear_program import BRANCHED, GAP, MIP_TOLERANCE
from ..attained import attained
from ..base import COUNTED, SOLVER, Engine, Support, checked_query, empty_support, replay
from ..bounds import METHODS, SAFETY, far_points, proven_support
from .boxes import Boxes, bound_loop
from .formulation import build, build_inputs, root_box

FORMULATIONS = ("split", "whole", "paper")
MARGIN = 2e-10  # beside MIP_TOLERANCE and the gap, by which a bound may stay above the value (relative to 1 + it)
LOOSE = 1e-7  # a bound further above the best trajectory is asked for again with smaller big-M (relative to 1 + it)
DOUBT = 1e-6  # a trajectory above the bound by more shows that the bound is wrong (relative to 1 + its size)
OUTSIDE = 1e-11  # a point of a linear program that is farther outside of its polytope is the tip of a needle
KEPT = 6  # trajectories a direction, the best ones: rational arithmetic may reject some of them
INPUT_TOLERANCE = 1e-7  # how far Phi may leave U, for rounding (relative to 1 + the size of the limit)
FEW = 8  # binaries a step of a box that is not split further
MANY = 40  # boxes solved for one direction, divided by k^2, after which one model of all of F settles it
NARROW = 1e-4  # a box is not split along a side shorter than this (relative to 1 + where it is)
MOST_BOXES = 20_000  # looked at for one set, divided by k^4; then one model of all of F settles the rest
AT_ONCE = 1024  # boxes that are bounded together: what they hold in memory
ROUNDS = 12  # of states ever closer to the best ones
FITTING = 0.7  # boxes of a larger set serve as long as the box around it is not larger than this one by more
SAMPLES = 200  # states from which the first attained values come


@dataclass(frozen=True)
class Milp(Engine):
    """h of R_k(F) by the MILP of Lemma 2, for any number of states, inputs and steps; HiGHS solves the programs.

    Parameters
    ----------
    formulation : "split", "whole" or "paper"
        How the question is put to the solver. "split": F & X is halved until few binaries are left in each box that
        may hold the maximum. "whole": one model. "paper": one model as in the paper, with s + sum of p_i w_i binaries
        per step and big-M by interval arithmetic, one for each layer and one for the plant.
    bounds : "interval", "lp" or "tight"
        Where the big-M of "whole" come from: ranges of single variables; LPs over what has been built so far; or
        MILPs over that, stopped early, where the LP leaves a sign open (see `bounds.upper_bound`). For "split" only
        boxes that still need many binaries ask for it; "paper" takes intervals.
    time_limit : float or None
        Seconds for the whole call: all directions, all steps and the building of models. It is checked between linear
        programs, so that a call may take a little longer.
    gap : float
        Relative gap between bound and value at which the solver may stop. The default of HiGHS, 1e-4, is too large for
        sets that are compared with each other.
    jobs : int or None
        Threads that share the directions; the answer does not depend on it. None is one per core where a model has more
        binaries than are branched on here, else one: only HiGHS runs beside other threads, and the small linear
        programs of one step do not keep it busy.

    Raises
    ------
    ValueError
        If a setting is not as above.

    See Also
    --------
    Cvxpy : the paper's formulation, to be read beside the paper.
    """

    name: ClassVar[str] = "milp"
    resolution: ClassVar[float] = 1e-6

    formulation: str = "split"
    bounds: str = "lp"
    time_limit: float | None = None
    gap: float = GAP
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

    def support(self, loop, F, V, steps=1, *, cutoff=None, warm_start=None) -> Support:
        """As `Engine.support`.

        Notes
        -----
        `bound` is that of the boxes, or the dual bound of `LinearProgram.maximize_integer`. `value` is attained by a
        trajectory in rational arithmetic and rounded downward; the witness is that trajectory, rounded to floats. It
        is -inf, without a witness, where no such trajectory is found. `rests_on` is COUNTED, or SOLVER if a bound of
        HiGHS that is not proven contributes. "split" answers with a `BoxSupport`, whose boxes and bounds are the warm
        start for a smaller set; of any other `warm_start` the bounds are used. The cutoff is not used by "whole" and
        "paper".

        Raises
        ------
        SolverStopped
            If the time limit came first; its `support` holds what was found, and `bound` is proven.
        SolverError
            If a bound cannot be right because a trajectory passes it.
        """
        V, steps = checked_query(loop, F, V, steps)
        end = np.inf if self.time_limit is None else perf_counter() + self.time_limit
        known = np.full(len(V), np.inf) if warm_start is None else warm_start.bound
        cutoff = np.full(len(V), -np.inf) if cutoff is None else real_array(cutoff, "cutoff", 1)
        X = loop.system.state_set
        start = F & X
        if start.is_empty:
            return empty_support(len(V))
        ask = _Ask(loop, start, V, steps, self.bounds, self.gap, end, known)
        if self.formulation == "split":
            before = warm_start if isinstance(warm_start, BoxSupport) else None
            answers, covering = _split(ask, cutoff, self.jobs, before)
        else:
            answers, covering = _at_once(ask, self.formulation, self.jobs), None
        bound = np.array([answer.bound for answer in answers])
        reached = [attained(loop, start, answer.v, answer.paths, end=end) for answer in answers]
        if (bound == -np.inf).any() and all(one is None for one in reached):
            return empty_support(len(V))
        value = np.array([-np.inf if one is None else one.value for one in reached])
        witness = tuple(None if one is None else one.witness() for one in reached)
        _require_consistent(V, bound, witness)
        found = value, np.maximum(bound, value), witness
        rests_on = _rests_on(warm_start, all(answer.proven for answer in answers))
        if covering is None:
            found = Support(*found, rests_on=rests_on)
        else:
            found = BoxSupport(*found, *covering, rests_on=rests_on)
        if not all(answer.finished for answer in answers):
            raise SolverStopped(_stopped(self.time_limit), found)
        return found


def _stopped(time_limit):
    return f"the MILP was stopped by time_limit = {time_limit} s; allow more time"


def _rests_on(warm_start, proven):
    """What an answer rests on, given its warm start and whether its own bounds are proven."""
    return SOLVER if not proven or (warm_start is not None and warm_start.rests_on == SOLVER) else COUNTED


@dataclass(frozen=True, eq=False)
class BoxSupport(Support):
    """A Support and the boxes from which it comes.

    Attributes
    ----------
    boxes : Boxes
        Of (x(0), d(0), ..., d(k - 2)); together they hold all that can start in F and stay in X.
    upper : array (B, k)
        v x(k) is at most this from each box.
    root : Boxes
        The one box that was halved.
    """

    boxes: Boxes
    upper: np.ndarray
    root: Boxes


@dataclass(frozen=True, eq=False)
class _Ask:
    """The question: the largest v x(k), or v u(0), over trajectories from F, for each row v of V.

    F lies in X. `known` (k,) are bounds that hold already; `end` is the `perf_counter` at which the time is over;
    `inputs` asks for u(0) instead of x(k); the rest is as in `support`.
    """

    loop: object
    F: object
    V: np.ndarray
    steps: int
    bounds: str
    gap: float
    end: float
    known: np.ndarray
    inputs: bool = False

    @cached_property
    def spread(self):
        """Upper bounds of the support function of the disturbance sets along V: (s, k)."""
        known = {D: proven_support(D, self.V) for D in {mode.disturbance for mode in self.loop.system.modes}}
        return np.array([known[mode.disturbance] for mode in self.loop.system.modes])

    def highest(self, bounds):
        """Upper bounds over the boxes of LoopBounds: (B, k)."""
        return bounds.highest_input(self.V) if self.inputs else bounds.highest_state(self.loop, self.V, self.spread)

    def enough(self, value, cutoff):
        """Bounds (k,) up to which nothing more has to be known, given attained values."""
        return np.maximum(_above(value, self.gap), cutoff)

    def model(self, bounds, box, known):
        """The MILP on one box, or None."""
        if self.inputs:
            return build_inputs(self.loop, self.F, bounds, box, known, self.end)
        return build(self.loop, self.F, self.steps, bounds, "whole", box, known, self.end)

    @property
    def remaining(self):
        """Seconds until the time is over, or None."""
        return None if self.end == np.inf else max(self.end - perf_counter(), 0.0)


@dataclass(eq=False)
class _Answer:
    """What is known along one direction: the best trajectories, what they attain in floats, and the bound.

    Attributes
    ----------
    paths : list of (value, (x(0), modes, disturbances))
        The best first; the last disturbance may be left out.
    proven : bool
        Whether the bound rests on no bound of HiGHS.
    """

    v: np.ndarray
    bound: float = -np.inf
    paths: list = field(default_factory=list)
    finished: bool = True
    proven: bool = True

    @property
    def value(self):
        """The largest value that floats attain."""
        return self.paths[0][0] if self.paths else -np.inf

    @property
    def path(self):
        """The trajectory that attains it, or None."""
        return self.paths[0][1] if self.paths else None

    def offer(self, value, path):
        """Keep a trajectory if it is better."""
        if value > self.value:
            self.paths = [(float(value), path), *self.paths[: KEPT - 1]]


def _above(value, gap=0.0):
    """A bound that is close enough above an attained value."""
    return value + np.where(np.isfinite(value), MIP_TOLERANCE + (MARGIN + gap) * (1 + np.abs(value)), 0)


# -- branch and bound over boxes ----------------------------------------------------------------------


def _split(ask, cutoff, jobs, before=None):
    """An _Answer for each direction, and what a BoxSupport adds to them: (boxes, upper, root).

    It begins with the boxes of `before`, the BoxSupport of a larger set, where that is not much larger than F.
    """
    answers = [_Answer(v) for v in ask.V]
    simulation = _Simulation(ask, answers)
    simulation.improve()
    k = len(ask.V)
    root = boxes = root_box(ask.loop, ask.F, ask.steps)
    upper, settled, looked, left, done = ask.known[None].copy(), np.full(k, -np.inf), 0, [], []
    if before is not None and (root.reach / before.root.reach).prod() > FITTING:
        boxes, chosen = before.boxes.within(root)
        upper, root = np.minimum(before.upper[chosen], upper), before.root
    while len(boxes):
        now, later = np.arange(len(boxes)) < AT_ONCE, np.arange(len(boxes)) >= AT_ONCE
        waiting, waiting_upper = boxes.take(later), upper[later]
        now &= boxes.meets(ask.F)
        boxes, upper = boxes.take(now), upper[now]
        looked += len(boxes)
        found = bound_loop(ask.loop, boxes, ask.steps)
        upper = np.minimum(upper, ask.highest(found))
        simulation.look_at(boxes.middle)
        value = np.array([answer.value for answer in answers])
        still = upper > ask.enough(value, cutoff)
        settled = np.maximum(settled, np.where(still, -np.inf, upper).max(axis=0, initial=-np.inf))
        binaries, keep = found.binaries, still.any(axis=1)
        below = ~keep & np.isfinite(upper).any(axis=1)
        done.append((boxes.take(below), upper[below]))
        wide = boxes.reach > NARROW * (1 + boxes.size)
        stop = looked > MOST_BOXES / ask.steps**4 or perf_counter() > ask.end
        leaf = keep & (stop | (binaries <= FEW * ask.steps) | ~wide.any(axis=1))
        left.append((boxes.take(leaf), upper[leaf]))
        on = keep & ~leaf
        halves = boxes.take(on).split(np.where(wide, found.doubt, -1)[on].argmax(axis=1), SAFETY)
        boxes = Boxes(np.concatenate([waiting.lower, halves.lower]), np.concatenate([waiting.upper, halves.upper]))
        upper = np.concatenate([waiting_upper, upper[on], upper[on]])
    boxes, upper = _joined(left)
    value = np.array([answer.value for answer in answers])
    keep = (upper > ask.enough(value, cutoff)).any(axis=1)
    settled = np.maximum(settled, upper[~keep].max(axis=0, initial=-np.inf))
    many = 1 if looked > MOST_BOXES / ask.steps**4 else max(1, MANY // ask.steps**2)
    leaves = _Leaves(ask, boxes.take(keep), upper[keep], many)

    def settle(row):
        answers[row].bound = settled[row]
        leaves.settle(row, answers[row], cutoff[row])

    _share(settle, k, jobs, leaves.large)
    return answers, (*_joined([(boxes, upper), *done]), root)


def _joined(parts):
    """Boxes and their bounds (B, k) from several pairs of both."""
    boxes, upper = zip(*parts)
    lower, higher = (np.concatenate([getattr(part, end) for part in boxes]) for end in ("lower", "upper"))
    return Boxes(lower, higher), np.concatenate(upper)


class _Leaves:
    """The boxes that are left, and a MILP on each of them."""

    def __init__(self, ask, boxes, upper, many):
        self.ask, self.boxes, self.upper, self.many = ask, boxes, upper, many
        self.found = bound_loop(ask.loop, boxes, ask.steps)
        self.simple = self.found.binaries <= FEW * ask.steps
        self.large = bool((self.found.binaries > BRANCHED).any())
        self.models = {}

    def model(self, index, bounds):
        """The model on one box, of all of F for None; None if there is nothing. `bounds` as in `support`."""
        if index is None:
            box = root_box(self.ask.loop, self.ask.F, self.ask.steps)
            return self.ask.model(bounds, box, bound_loop(self.ask.loop, box, self.ask.steps).at(0))
        return self.ask.model(bounds, self.boxes.take([index]), self.found.at(index))

    def solve(self, index, bounds, answer, cutoff):
        """The bound on one box along the answer's direction, or one that is not above the cutoff."""
        shared = self.models.setdefault((index, bounds), _Shared(partial(self.model, index, bounds)))
        return shared.solve(self.ask, answer, cutoff)

    def settle(self, row, answer, cutoff):
        """Solve on one box after another, the most promising first, until the others cannot be better."""
        upper, careful = self.upper[:, row], self.ask.bounds
        for count, index in enumerate(np.argsort(-upper, kind="stable")):
            if upper[index] <= self.ask.enough(answer.value, cutoff):
                answer.bound = max(answer.bound, upper[index])
                break
            if perf_counter() > self.ask.end:
                answer.finished, answer.bound = False, max(answer.bound, upper[index])
                break
            if count == self.many:
                answer.bound = max(answer.bound, min(self.solve(None, careful, answer, cutoff), upper[index]))
                break
            quick = "interval" if self.simple[index] else careful
            bound = min(self.solve(index, quick, answer, cutoff), upper[index])
            loose = bound > max(answer.value + LOOSE * (1 + abs(bound)), cutoff)
            if answer.finished and loose and quick != careful:
                bound = min(bound, self.solve(index, careful, answer, cutoff))  # smaller big-M
            answer.bound = max(answer.bound, bound)


class _Shared:
    """A model that is built when it is first asked for; each thread asks a copy of its own."""

    def __init__(self, build):
        self._build, self._building, self._idle = build, Lock(), []

    def solve(self, ask, answer, cutoff=-np.inf):
        """The bound along the answer's direction, or one that is not above the cutoff; -inf if there is no model."""
        with self._building:
            if self._model is None:
                return -np.inf
            model = self._idle.pop() if self._idle else replace(self._model, program=self._model.program.copy())
        bound = _ask_solver(ask, model, answer, cutoff)
        self._idle.append(model)
        return bound

    @cached_property
    def _model(self):
        return self._build()


class _Simulation:
    """Attained values: trajectories from states of F, with random extreme disturbances, the last one the best."""

    def __init__(self, ask, answers):
        self.ask, self.answers, self.rng = ask, answers, np.random.default_rng(0)
        n = ask.loop.system.state_size
        self.modes = ask.loop.system.modes
        self.before = range(ask.steps - 1)  # the steps whose disturbance has to be chosen
        diagonals = np.array(list(product([-1.0, 1.0], repeat=n)))
        self.extreme = [_extreme_points(mode.disturbance, diagonals) for mode in self.modes] if self.before else None

    def improve(self, rounds=ROUNDS):
        """Try random states of F, then states and disturbances ever closer to the best ones."""
        F, n = self.ask.F, self.ask.loop.system.state_size
        across = np.zeros((0, n)) if self.ask.inputs else self.ask.V
        corners = _extreme_points(F, np.vstack([np.eye(n), -np.eye(n), across]))
        states = self.rng.dirichlet(np.full(len(corners), 0.5), SAMPLES) @ corners
        self.try_all(np.vstack([corners, states]))
        for shrink in 0.6 ** np.arange(1, rounds + 1):
            if perf_counter() > self.ask.end:
                return
            paths = [answer.path for answer in self.answers if answer.path is not None]
            if not paths:
                return
            towards = np.vstack([corners, states[self.rng.integers(len(states), size=8)]])
            best = np.array([path[0] for path in paths])
            x = ((1 - shrink) * best[:, None] + shrink * towards).reshape(-1, n)
            self.try_all(x, [np.repeat([path[2][j] for path in paths], len(towards), axis=0) for j in self.before])

    def look_at(self, w):
        """Try the states x(0) of points w (N, D)."""
        x = w[:, : self.ask.loop.system.state_size]
        self.try_all(x[self.ask.F.contains(x)])

    def try_all(self, x, disturbances=None):
        """Simulate from states x (N, n); of given disturbances (k - 1 arrays (N, n)) one in four is drawn anew."""
        ask, system = self.ask, self.ask.loop.system
        if ask.inputs:
            self._offer(ask.loop.network(x) @ ask.V.T, lambda i, row: (x[i], [], []))
            return
        alive, start, modes, drawn = np.arange(len(x)), x, [], []
        for j in self.before:
            u = ask.loop.network(x)
            inside = system.violation(x, u) <= 0
            chosen = np.where(inside, self.rng.random(inside.shape), -1).argmax(axis=1)
            d = np.array([self.extreme[i][self.rng.integers(len(self.extreme[i]))] for i in chosen]).reshape(x.shape)
            if disturbances is not None:
                given = disturbances[j][alive]
                keep = self.rng.random(len(x)) < 0.75
                keep &= [self.modes[i].disturbance.contains(one) for i, one in zip(chosen, given)]
                d = np.where(keep[:, None], given, d)
            after = system.successor(x, u, chosen) + d
            kept = inside.any(axis=1) & system.state_set.contains(after)
            x, start, alive = after[kept], start[kept], alive[kept]
            modes = [before[kept] for before in modes] + [chosen[kept]]
            drawn = [before[kept] for before in drawn] + [d[kept]]
        u = ask.loop.network(x)
        inside = system.violation(x, u) <= 0
        A, B, p = system.maps
        images = np.einsum("sij,tj->tsi", A, x) + np.einsum("sij,tj->tsi", B, u) + p
        values = np.where(inside[:, :, None], images @ ask.V.T + ask.spread, -np.inf)  # (N, s, k)
        last = values.argmax(axis=1)
        self._offer(
            values.max(axis=1),
            lambda i, row: (start[i], [*(m[i] for m in modes), last[i, row]], [d[i] for d in drawn]),
        )

    def _offer(self, values, path):
        """Offer the best of values (N, k) to each direction."""
        if len(values):
            for row, (answer, i) in enumerate(zip(self.answers, values.argmax(axis=0))):
                answer.offer(values[i, row], path(i, row))


def _extreme_points(P, V):
    """Points of a polytope that are farthest along the rows of V: (e, n).

    Tolerances can lead far beyond the tip of a needle: such points are left out, unless there are no others.
    """
    points = far_points(P, V)
    excess = (points @ P.H.T - P.h).max(axis=1)
    return points[excess <= max(OUTSIDE, excess.min())]


# -- one model ----------------------------------------------------------------------------------------


def _at_once(ask, formulation, jobs):
    """An _Answer for each direction, from one model of all of F."""
    answers = [_Answer(v) for v in ask.V]
    model = _Shared(partial(build, ask.loop, ask.F, ask.steps, ask.bounds, formulation, end=ask.end))
    _Simulation(ask, answers).improve()
    root = bound_loop(ask.loop, root_box(ask.loop, ask.F, ask.steps), ask.steps)
    known = np.minimum(ask.known, ask.highest(root)[0])

    def settle(row):
        answers[row].bound = min(model.solve(ask, answers[row]), known[row])

    _share(settle, len(answers), jobs, True)
    return answers


def _ask_solver(ask, model, answer, cutoff):
    """Solve a model along the answer's direction, offer its trajectory to the answer, and return the bound."""
    enough = max(answer.value, 2 * cutoff - float(_above(cutoff, ask.gap)) if cutoff > -np.inf else cutoff)
    found = model.program.maximize_integer(
        model.states[-1], answer.v, gap=ask.gap, enough=enough, time_limit=ask.remaining
    )
    answer.finished &= found.finished
    answer.proven &= found.proven
    if found.point is not None:
        x = found.point[model.states[0]]
        modes = [int(np.argmax(found.point[columns])) for columns in model.modes]
        path = (x, modes, [found.point[d] for d in model.disturbances])
        if ask.inputs:
            answer.offer(answer.v @ ask.loop.network(x), path)
        else:
            answer.offer(answer.v @ replay(ask.loop, *path).states[-1], path)
    return found.bound


def _share(work, count, jobs, large):
    """work(row) for the rows 0, ..., count - 1, by `jobs` threads; for None one a core if models are large."""
    jobs = jobs or (large and cpu_count()) or 1
    if min(jobs, count) <= 1:
        for row in range(count):
            work(row)
        return
    with ThreadPoolExecutor(min(jobs, count)) as pool:
        list(pool.map(work, range(count)))


# -- checks -------------------------------------------------------------------------------------------


def violating_state(loop, U, bounds="lp", time_limit=None):
    """A state (n,) of X at which Phi leaves the Polytope U by more than `INPUT_TOLERANCE`, or None.

    Raises
    ------
    SolverStopped
        If the time limit, in seconds, came first.
    SolverError
        If it can neither be shown that Phi stays in U nor that it leaves.
    """
    end = np.inf if time_limit is None else perf_counter() + positive_number(time_limit, "time_limit")
    X, limit = loop.system.state_set, U.h + INPUT_TOLERANCE * (1 + np.abs(U.h))
    found = bound_loop(loop, root_box(loop, X, 1))
    open_rows = found.highest_input(U.H)[0] > limit
    if not open_rows.any():
        return None
    V, limit = U.H[open_rows], limit[open_rows]
    ask = _Ask(loop, X, V, 1, bounds, GAP, end, np.full(len(V), np.inf), inputs=True)
    for answer, most in zip(_split(ask, limit, 1)[0], limit):
        if answer.bound <= most:
            continue
        reached = attained(loop, X, answer.v, answer.paths, inputs=True, end=end)
        if reached is not None and reached.value > most:
            return reached.start
        if not answer.finished:
            raise SolverStopped(_stopped(time_limit))
        raise SolverError(
            f"it could not be shown that the network stays in the input set: {answer.v.tolist()} u is at most "
            f"{answer.bound:.9g}, where {most:.9g} is allowed; use network.saturate(lower, upper)"
        )
    return None


def _require_consistent(V, bound, witness):
    """Raise SolverError if a trajectory, found for whichever direction, passes a bound by more than rounding."""
    ends = np.array([one.states[-1] for one in witness if one is not None]).reshape(-1, V.shape[1])
    reached = (ends @ V.T).max(axis=0, initial=-np.inf)
    excess = reached - bound
    worst = int(np.argmax(excess))
    if excess[worst] > DOUBT * (1 + abs(reached[worst])):
        raise SolverError(
            f"direction {V[worst].tolist()} is bounded by {bound[worst]:.9g}, but a trajectory passes this by "
            f'{excess[worst]:.3g}; try another formulation, or engine="cells" for two states'
        )
