"""Checks of exercise 14: sets, cells and templates in three dimensions."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..analysis.reach import support
from ..analysis.safe_set import safe_set
from ..engines.space import dynamics
from ..sets.polytope import Polytope
from ..studies.case_studies import case_study, load_sets
from ..systems.loop import ClosedLoop
from ..systems.network import Layer, MaxoutNetwork
from ..systems.pwa import Mode, PWASystem
from ..typing import Array
from .common import (
    Wrong,
    require,
    require_array,
    require_close,
    require_filled,
    require_pair,
    require_whole,
    text,
)

TOL = 1e-7  # for numbers that differ by rounding only
THIN = 1e-9  # inner radius up to which a part counts as empty or flat
FAT = 1e-3  # inner radius of the parts in task 3, at least
CLEAR = 1e-3  # task 2: smallest distance of the state from the boundaries of the projections and of the set (cm)
MOST_CELLS = 10_000
ROWS, ROUGH, STEPS = 6, 0.7, 100  # task 5: rows of a template, the disturbance bound (cm), and iterations

Piece = tuple[Polytope, Array, Array]  # a cell, and M and c of x+ = M x + c on it


def tanks(bound: float = ROUGH) -> ClosedLoop:
    """The loop of the three tanks with D = {d : |d|_inf <= bound}, in cm."""
    return case_study("three_tanks").loop.with_disturbance(Polytope.box([-bound] * 3, [bound] * 3))


def terminal_set() -> Polytope:
    """The terminal set of the three tanks, from the certificate that is shipped with the package."""
    return load_sets("three_tanks")[-1]


def random_pieces(seed: int) -> tuple[ClosedLoop, list[Piece]]:
    """A loop in R^3 with two modes that jump at x1 = 0 and a small random network, and its cells."""
    rng = np.random.default_rng(seed)
    n, width = 3, 4
    first, second = rng.normal(size=(width, n)), rng.normal(size=(1, width))
    relu = Layer(np.kron(first, [[1], [0]]), np.kron(0.5 * rng.normal(size=width), [1, 0]), 2)
    net = MaxoutNetwork((relu,), second, np.zeros(1)).saturate([-1], [1])
    X, U = Polytope.box([-1] * n, [1] * n), Polytope.box([-1], [1])
    D = Polytope.box(-rng.uniform(0.05, 0.3, n), rng.uniform(0.05, 0.3, n))
    modes = []
    for sign in (1, -1):
        A, p = 0.5 * rng.normal(size=(n, n)), 0.3 * rng.normal(size=n)
        modes.append(Mode(A, rng.normal(size=(n, 1)), p, Polytope([[sign, 0, 0, 0]], [0]), D))
    loop = ClosedLoop(PWASystem(modes, X, U), net)
    every = dynamics(loop, MOST_CELLS)
    return loop, [(every.cells.complex.polytope(i), every.M[i], every.c[i]) for i in range(len(every.cells))]


def check_t1(heights: Any) -> None:
    """Task 1: heights(P, y) = (low, high), the x3 with (y, x3) in P, or None if there are none.

    Parameters
    ----------
    heights : callable
        Polytope of R^3, (2,) -> pair of numbers, or None.

    Raises
    ------
    Wrong
        With a y for which the answer is wrong.
    """
    rng = np.random.default_rng()
    for trial in range(20):
        P = _random_polytope(rng)
        around = P.project([0, 1]).bounding_box()
        for y in rng.uniform(around[0] - 0.3, around[1] + 0.3, (15, 2)):
            _check_heights(heights(P, y), P, y, f"polytope {trial + 1}, y = {text(y)}")
    print("ok: heights(P, y) is the section of P along a vertical line; it is empty if y is outside the projection")


def check_t2(state: Any) -> None:
    """Task 2: a state in all three projections of `terminal_set()` that is not in the set.

    Parameters
    ----------
    state : array (3,)

    Raises
    ------
    Wrong
        With the projection that the state is not in, or if it is in the set.
    """
    x, R = require_array(state, (3,), "state"), terminal_set()
    for pair in ((0, 1), (0, 2), (1, 2)):
        shadow = R.project(pair)
        beyond = float((shadow.H @ x[[*pair]] - shadow.h).max())
        where = f"the projection onto (x{pair[0] + 1}, x{pair[1] + 1})"
        require(beyond <= -CLEAR, f"state = {text(x)} is not inside {where}, or closer than {CLEAR} to its boundary")
    outside = R.H @ x - R.h
    require(
        outside.max() >= CLEAR,
        f"state = {text(x)} is in all three projections, and in the set: the largest row of H x - h is "
        f"{outside.max():.3g}, and outside it must be at least {CLEAR}",
    )
    row = R.H[int(outside.argmax())]
    print(f"ok: the state is inside all three projections, but it violates the row {text(row)} of the set")


def check_t3(count_pieces: Any) -> None:
    """Task 3: count_pieces(W, b, P), the parts of P with an interior on which all ReLU neurons keep their signs.

    Parameters
    ----------
    count_pieces : callable
        (N, 3), (N,), Polytope of R^3 -> int.

    Raises
    ------
    Wrong
        With the network, and what kind of part was counted wrongly.
    """
    rng = np.random.default_rng()
    P = Polytope.box([-1, -1, -1], [1, 1, 1])
    kinds = ("random planes", "a plane twice", "a plane that misses P", "a plane that touches P in a face")
    for kind in kinds:
        W, b, parts = _planes(rng, P, kind)
        answer = count_pieces(W, b, P)
        require_filled(answer, "count_pieces(W, b, P)")
        count, N = require_whole(answer, "count_pieces(W, b, P)", 0), len(b)
        case = f"{N} neurons, {kind}: you count {count}"
        require(count != 2**N, f"{case}, one part per sign pattern; but not all of the {2**N} patterns occur in P")
        require(
            count <= len(parts),
            f"{case}, too many: some sign patterns occur nowhere in P, or only on a face, which has no interior",
        )
        smallest = min(part.chebyshev()[1] for part in parts)
        require(
            count >= len(parts),
            f"{case}, too few: P has parts with an inner radius of only {smallest:.2g}; sampled points may miss them",
        )
    print("ok: the affine pieces of one ReLU layer, counted by their sign patterns")


def check_t4(step_support: Any) -> None:
    """Task 4: step_support(pieces, F, D, V), h of R_1(F) along the rows of V by the vertices of the cells.

    Parameters
    ----------
    step_support : callable
        list of (Polytope, (3, 3), (3,)), Polytope, Polytope, (k, 3) -> (k,).

    Raises
    ------
    Wrong
        With a direction, the error of the answer, and where the answer is too small, a state that exceeds it.
    """
    rng = np.random.default_rng()
    for _ in range(3):
        loop, pieces = random_pieces(int(rng.integers(1000)))
        middle = rng.uniform(-0.4, 0.4, 3)
        half = rng.uniform(0.2, 0.5, 3)
        F, D, V = Polytope.box(middle - half, middle + half), loop.system.modes[0].disturbance, rng.normal(size=(5, 3))
        answer = require_array(step_support(pieces, F, D, V), (len(V),), "step_support(pieces, F, D, V)")
        found, calm = (support(one, F, V) for one in (loop, loop.with_disturbance(Polytope.box([0] * 3, [0] * 3))))
        whole = support(loop, loop.system.state_set, V).value
        hints = (
            (calm.value, "this is the value without a disturbance; D is missing"),
            (whole, "this is the value for all of X; take the part of each cell that lies in F"),
        )
        for v, h, true, words in zip(V, answer, found.value, zip(*(value for value, _ in hints))):
            if abs(h - true) <= TOL:
                continue
            k = [j for j, value in enumerate(words) if abs(h - value) <= TOL]
            why = hints[k[0]][1] if k else _why(h, true, loop, F, v)
            raise Wrong(f"along v = {text(v)} your {h:.6g} is off by {abs(h - true):.3g}: {why}")
    print("ok: one step of a loop in space; no solver is needed for the maximum")


def check_t5(C: Any) -> None:
    """Task 5: a template of at most `ROWS` rows with which the three tanks get a safe set for |d|_inf <= `ROUGH` cm.

    Parameters
    ----------
    C : array (l, 3)

    Raises
    ------
    Wrong
        If C has too many rows, does not bound a set, or finds no safe set.
    """
    C = require_array(C, (None, 3), "C")
    require(0 < len(C) <= ROWS, f"C has {len(C)} rows, but may have at most {ROWS}")
    require((np.linalg.norm(C, axis=1) > 0).all(), "C has a row of zeros, which is no direction")
    for axis, sign in ((axis, sign) for axis in range(3) for sign in (1, -1)):
        v = sign * np.eye(3)[axis]
        limit = Polytope(C, np.ones(len(C))).support(v[None])[0]
        require(np.isfinite(limit), f"the sets {{x : C x <= h}} are unbounded with this C, along {text(v)}")
    found = safe_set(tanks(), C, max_iterations=STEPS)
    require(found.set is not None, f"no safe set with this C after {found.iterations} iterations: {found.reason}")
    print(f"ok: {len(C)} rows, and a safe set after {found.iterations} iterations")


# -- parts --------------------------------------------------------------------------------------------


def _random_polytope(rng: np.random.Generator) -> Polytope:
    """A box of R^3 cut by three random planes and a vertical one."""
    normals = np.vstack([rng.normal(size=(3, 3)), np.append(rng.normal(size=2), 0)])
    return Polytope(normals, rng.uniform(0.3, 0.8, 4)) & Polytope.box(-rng.uniform(0.5, 2, 3), rng.uniform(0.5, 2, 3))


def _check_heights(answer: Any, P: Polytope, y: Array, case: str) -> None:
    """Whether heights(P, y) is right."""
    require(answer is not ..., "heights is not filled in yet")
    line = P.section([2], at=[*y, 0])
    if line.is_empty:
        require(
            answer is None,
            f"{case}: no (y, x3) is in P, so y is outside of the projection; return None; check the rows without x3",
        )
        return
    low, high = (float(end[0]) for end in line.bounding_box())
    if high - low < TOL:  # rounding decides
        return
    require(answer is not None, f"{case}: (y, {(low + high) / 2:.4g}) is in P, but you return None")
    ends = require_pair(answer, "heights(P, y)", "(low, high) or None")
    require_close(ends[0], low, f"{case}: low", TOL)
    require_close(ends[1], high, f"{case}: high", TOL)


def _planes(rng: np.random.Generator, P: Polytope, kind: str) -> tuple[Array, Array, Sequence[Polytope]]:
    """A layer W, b of some kind, and the parts of P, each with an inner radius above `FAT`."""
    while True:
        W, b = rng.normal(size=(4, 3)), rng.uniform(-0.6, 0.6, 4)
        if kind == "a plane twice":
            W, b = np.vstack([W, -2 * W[1]]), np.append(b, -2 * b[1])
        elif kind == "a plane that misses P":
            W, b = np.vstack([W, [1, 1, 0]]), np.append(b, 4)
        elif kind == "a plane that touches P in a face":
            W, b = np.vstack([W, [1, 0, 0]]), np.append(b, -1)
        parts = [P]
        for w, offset in zip(W, b):
            sides = [part & Polytope([sign * w], [-sign * offset]) for part in parts for sign in (1, -1)]
            parts = [side for side in sides if side.chebyshev()[1] > THIN]
        if min(part.chebyshev()[1] for part in parts) > FAT:
            return W, b, parts


def _why(h: float, true: float, loop: ClosedLoop, F: Polytope, v: Array) -> str:
    """What a wrong value of task 4 means."""
    if h > true:
        return "no state of F leads that far"
    step = support(loop, F, v[None]).witness[0]
    assert step is not None  # the maximum is attained
    x, after = step.states[0], step.states[-1]
    return f"x = {text(x)} is in F and leads to {text(after)}; it may be a vertex of a cell but not of F"
