"""Checks of exercise 09: the double integrator's safe set, its limits, and what the plant does."""

from collections.abc import Callable
from typing import Any

import numpy as np

from ..analysis.reach import support
from ..analysis.safe_set import SafeSet, safe_set
from ..analysis.terminal_set import terminal_set
from ..sets.polytope import Polytope
from ..sets.templates import directions
from ..studies.case_studies import CaseStudy, case_study, double_integrator_fit
from ..systems.loop import ClosedLoop
from ..systems.plants import double_integrator_plant
from ..typing import Array
from .common import (
    Wrong,
    require,
    require_array,
    require_filled,
    require_number,
    require_whole,
    text,
    with_bound,
)

MAX_ITERATIONS, ACCURACY = 60, 0.002  # of task 2
SMALL_BOUND = 0.1  # of task 5
ROUNDING = 1e-9  # of states that are computed twice (units of x)
CLEAR = 1e-7  # excesses closer to 0 than this are left out


def check_t1(count_iterations: Any) -> None:
    """Task 1: count_iterations(loop, C, limit) is the first k <= limit with R1-bar(F_k) in X, or None.

    Parameters
    ----------
    count_iterations : callable
        ClosedLoop, (l, 2), int -> int or None.

    Raises
    ------
    Wrong
        With the template and the disturbance bound, and by how much the image leaves X at the k returned.
    """
    rng, case = np.random.default_rng(), case_study("double_integrator")
    for count, low, high, limit in ((16, 0.0, 0.1, 40), (12, 0.05, 0.15, 40), (8, 0.0, 0.03, 40), (4, 0.1, 0.1, 20)):
        bound, C = rng.uniform(low, high), directions(count)
        loop = with_bound(case.loop, bound)
        k = count_iterations(loop, C, limit)
        require(k is not ..., "count_iterations is not filled in yet")
        truth = safe_set(loop, C, max_iterations=limit)
        title = f"{count} directions, |d| <= {bound:.3f}"
        if truth.verdict != "proven":
            require(k is None, f"{title}: you return {k}, but R1-bar(F_k) leaves X for all k <= {limit}")
            continue
        require(k is not None, f"{title}: you return None, but the sequence ends before k = {limit}")
        k = require_whole(k, "count_iterations(loop, C, limit)", 0)
        require(
            k >= truth.iterations,
            f"{title}: you return k = {k}, but R1-bar(F_{k}) leaves X by {_excess(loop, truth.history, k):.3g}",
        )
        require(k <= truth.iterations, f"{title}: you return k = {k}, but R1-bar(F_{k - 1}) lies in X already")
    # the smallest limit that suffices, and one less
    loop, C = with_bound(case.loop, 0.05), directions(16)
    k = safe_set(loop, C).iterations
    require(count_iterations(loop, C, k) == k, f"16 directions, |d| <= 0.05: k = limit = {k} is allowed, too")
    require(
        count_iterations(loop, C, k - 1) is None,
        f"16 directions, |d| <= 0.05: with limit = {k - 1} the answer is None, for R1-bar(F_{k - 1}) leaves X",
    )
    print("ok: Prop. 3, Fmax, by hand")


def check_t2(largest: Any) -> None:
    """Task 2: {8: bound, 16: bound}, the largest with a safe set within 60 iterations, to within 0.002.

    Parameters
    ----------
    largest : dict

    Raises
    ------
    Wrong
        With the result of the iteration at the bound, or a little above it.
    """
    require_filled(largest, "largest")
    require(isinstance(largest, dict) and set(largest) == {8, 16}, "largest must be a dict with the keys 8 and 16")
    loop = case_study("double_integrator").loop
    for count, answer in largest.items():
        require_filled(answer, f"largest[{count}]")
        bound = require_number(answer, f"largest[{count}]")
        require(bound >= 0, f"largest[{count}] = {bound:g} is negative; a bound on |d| is at least 0")
        found = _try_bound(loop, bound, count)
        require(
            found.verdict == "proven",
            f"largest[{count}] = {bound:.4f} is too large: {found.reason.split(':')[0]}, so no safe set within "
            f"{MAX_ITERATIONS} iterations",
        )
        more = _try_bound(loop, bound + ACCURACY, count)
        require(
            more.verdict != "proven",
            f"largest[{count}] = {bound:.4f} is not the largest: with {bound + ACCURACY:.4f} a safe set is still "
            f"found, after {more.iterations} iterations",
        )
    print(f"ok: the largest bound is {largest[8]:.3f} with 8 directions and {largest[16]:.3f} with 16")


def check_t3(leaving_state: Any) -> None:
    """Task 3: leaving_state(G) is a state of G from which the plant leaves G in one step, or None.

    Parameters
    ----------
    leaving_state : callable
        Polytope -> (2,) or None.

    Raises
    ------
    Wrong
        If a state is no witness, with its successor; or if None is returned where many states leave.
    """
    rng = np.random.default_rng()
    case = case_study("double_integrator")
    plant = double_integrator_plant()
    safe = safe_set(case.loop, case.safe_directions)
    terminal = terminal_set(case.loop, safe, case.directions, centre="equilibrium")
    assert safe.set is not None  # the case study has a safe set
    middle = int(rng.integers(1, terminal.steps))
    invariant = {"F_max": safe.set, f"R{middle}-bar(F_max)": terminal.history[middle], "R_min-bar": terminal.set}
    for name, G in invariant.items():
        x = _state_of(leaving_state, G)
        if x is not None:
            _require_leaving(case, G, x, f"G = {name}, which is proven to be RPI")
            raise Wrong(f"G = {name} is RPI, yet you found x = {text(x)}: that refutes a proof; please report it")
    lower, upper = safe.set.bounding_box()
    side = rng.uniform(0.8, 1.2)
    quiet = with_bound(case.loop, 0.002)  # its sets are invariant for f_PWA without d, and not for f
    small = terminal_set(quiet, safe_set(quiet, case.safe_directions), case.directions, centre="equilibrium").set
    for name, G in {
        "the bounding box of F_max": Polytope.box(lower, upper),
        f"|x|_inf <= {side:.2f}": Polytope.box([-side, -side], [side, side]),
        "X": case.system.state_set,
        "a small set about the equilibrium of the PWA loop": small,
    }.items():
        x = _state_of(leaving_state, G)
        if x is None:
            states = G.sample(rng, 4000)
            share = np.mean(~G.contains(plant.step(case.network, states), ROUNDING))
            raise Wrong(f"G = {name}: you return None, but the plant leaves G from about {share:.0%} of its states")
        _require_leaving(case, G, x, f"G = {name}")
    print("ok: a leaving state wherever there is one, and no false alarm")


def check_t4(rule_holds: Any) -> None:
    """Task 4: rule_holds(loop, R, C, epsilon, centre) is eq. (25), TerminationFmin about a centre.

    Parameters
    ----------
    rule_holds : callable
        ClosedLoop, Polytope, (l, 2), number, (2,) -> bool.

    Raises
    ------
    Wrong
        With the set, the centre and epsilon, and by how much S exceeds R1-bar(S).
    """
    rng, case = np.random.default_rng(), case_study("double_integrator")
    C = case.directions
    for system in (double_integrator_fit().system(), case.system):
        loop = ClosedLoop(system, case.network)
        safe = safe_set(loop, C)
        found = terminal_set(loop, safe, C, centre="equilibrium")
        equilibrium, last = found.centre, len(found.history) - 1
        questions = [(last, 1e-3, equilibrium), (last, 1e-3, np.zeros(2)), (last - 1, 1e-3, equilibrium)]
        questions += [
            (k, 10 ** rng.uniform(-3, -0.3), c) for k in rng.integers(0, last, 6) for c in (equilibrium, 0 * C[0])
        ]
        for k, epsilon, c in questions:
            R = found.history[int(k)]
            S = R.scale(1 / (1 + epsilon), c)
            excess = S.support(C) - support(loop, S, C).value
            if np.abs(excess.max()) < CLEAR:
                continue
            answer = rule_holds(loop, R, C, float(epsilon), c)
            require_filled(answer, "rule_holds(loop, R, C, epsilon, centre)")
            case_text = f"k = {k}, epsilon = {epsilon:.2g}, centre {text(c)}"
            i = int(excess.argmax())
            said = bool(answer)
            require(
                not (said and excess[i] > 0),
                f"{case_text}: you say that the rule holds, but S sticks out of R1-bar(S) by {excess[i]:.2g} "
                f"along C_{i + 1}",
            )
            require(
                said or excess[i] > 0,
                f"{case_text}: you say that the rule fails, but S lies in R1-bar(S), with {-excess[i]:.2g} to spare",
            )
    print("ok: eq. (25), TerminationFmin, about any centre")


def check_t5(state: Any, value: Any) -> None:
    """Task 5: a state and an input at which the fit is off by more than 0.1.

    Parameters
    ----------
    state : array (2,)
    value : float

    Raises
    ------
    Wrong
        If the point lies outside X x U, or with the error there.
    """
    x, u = require_array(state, (2,), "state"), require_number(value, "value")
    require(np.abs(x).max() <= 6, f"state = {text(x)} lies outside X")
    require(abs(u) <= 2, f"value = {u:g} lies outside U")
    truth = double_integrator_plant()(x, [u])
    point = np.append(x, u)
    errors = [
        np.abs(truth - mode.successor(x, np.array([u]))).max()
        for mode in double_integrator_fit().modes
        if mode.region.contains(point, ROUNDING)
    ]
    require(
        max(errors) > SMALL_BOUND,
        f"at x = {text(x)}, u = {u:g} the error is only {max(errors):.4f}, not above {SMALL_BOUND}; "
        "there the smaller bound covers it",
    )
    print(f"ok: the error there is {max(errors):.4f}, so the disturbance set does not contain it")


# -- parts --------------------------------------------------------------------------------------------


def _excess(loop: ClosedLoop, history: list[Polytope], k: int) -> float:
    """By how much R1-bar(F_k) leaves X."""
    X = loop.system.state_set
    return float((support(loop, history[k], X.H).value - X.h).max()) if 0 <= k < len(history) else np.nan


def _try_bound(loop: ClosedLoop, bound: float, count: int) -> SafeSet:
    """The safe set with that bound and that number of directions."""
    return safe_set(with_bound(loop, bound), directions(count), max_iterations=MAX_ITERATIONS)


def _state_of(leaving_state: Callable[[Polytope], Any], G: Polytope) -> Array | None:
    """The answer for G: an array (2,), or None."""
    x = leaving_state(G)
    require(x is not ..., "leaving_state is not filled in yet")
    return None if x is None else require_array(x, (2,), "leaving_state(G)")


def _require_leaving(case: CaseStudy, G: Polytope, x: Array, title: str) -> None:
    """Raise `Wrong` unless x is in G and the plant's next state is not."""
    require(G.contains(x, ROUNDING), f"{title}: x = {text(x)} is not in G")
    after = double_integrator_plant().step(case.network, x)
    require(
        not G.contains(after, ROUNDING),
        f"{title}: from x = {text(x)} the plant goes to {text(after)}, which is in G",
    )
