"""Branch and bound over binaries, each node of which is bounded by whoever calls it.

The result is as trustworthy as the bounds of the nodes: the answer of a MILP solver only tells the search where it may
stop.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter
from typing import NamedTuple, TypeAlias

import numpy as np

from ..errors import SolverError
from ..tolerances import INTEGRALITY, MIP_GAP, OPEN_BINARY
from ..typing import Array, IntArray

BRANCHED = 16  # binaries up to which no incumbent of HiGHS's MILP solver is asked for before branching
PROOF_NODES = 100_000  # of the search tree over more binaries, after which HiGHS's own bound may be returned


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
    point: Array | None
    finished: bool
    proven: bool = True


class Stop(NamedTuple):
    """When a search may end.

    Attributes
    ----------
    gap : float
        Between bound and point, relative and absolute, at which it may.
    enough : float
        A bound that need not be lowered further.
    nodes : int or None
        The largest number of nodes.
    seconds : float or None
    """

    gap: float = MIP_GAP
    enough: float = -np.inf
    nodes: int | None = None
    seconds: float | None = None


class Node(NamedTuple):
    """Limits of the binaries in a part of the search tree.

    Attributes
    ----------
    bound : float
        No point of this part exceeds it.
    low, high : array (binaries,)
    """

    bound: float
    low: Array
    high: Array


Relaxation: TypeAlias = Callable[[Array, Array], tuple[float, Array | None]]


def branch(root: Node, order: IntArray, relaxation: Relaxation, binaries: IntArray, stop: Stop) -> IntegerOptimum:
    """Depth-first branch and bound.

    A node is left out only if its bound is not above `stop.enough` or the best point. Where the relaxation has neither
    a point nor a proof that there is none, the node keeps the bound of its parent and is branched further.

    Parameters
    ----------
    root : Node
    order : array (binaries,)
        Of the open binaries, the one with the least number is branched on.
    relaxation : callable
        relaxation(low, high) gives a bound of the part between these limits, -inf if it holds no point, and a point
        (columns,), or None if none is known.
    binaries : array (binaries,) of int
        The columns of the binaries in a point.
    stop : Stop

    Returns
    -------
    IntegerOptimum

    Raises
    ------
    SolverError
        If a part of the tree has no finite bound.

    Examples
    --------
    max x1 + x2 over binaries with x1 + x2 <= 1.5, whose relaxation this function solves by hand:

    >>> def relaxation(low, high):
    ...     first = min(high[0], 1.5 - low[1])
    ...     second = min(high[1], 1.5 - first)
    ...     return (first + second, np.array([first, second])) if low.sum() <= 1.5 else (-np.inf, None)
    >>> root = Node(np.inf, np.zeros(2), np.ones(2))
    >>> float(branch(root, np.arange(2), relaxation, np.arange(2), Stop()).bound)
    1.0
    """
    best = stop.enough
    bound = -np.inf
    point: Array | None = None
    looked = 0
    end = np.inf if stop.seconds is None else perf_counter() + stop.seconds
    waiting = [root]
    while waiting and (stop.nodes is None or looked < stop.nodes) and perf_counter() < end:
        above, low, high = waiting.pop()
        settled = best + stop.gap * (1 + abs(best)) if np.isfinite(best) else best
        if above > settled:
            proven, relaxed = relaxation(low, high)
            looked += 1
            above = min(above, proven)
        if above <= settled:
            bound = max(bound, above)
            continue
        if above == np.inf:
            raise SolverError("HiGHS found no bound of a MILP: its relaxation is unbounded")
        share = relaxed[binaries] if relaxed is not None else (low + high) / 2
        apart = np.minimum(share - low, high - share)
        if apart.max(initial=0) <= INTEGRALITY:
            bound = max(bound, above)
            if relaxed is not None:
                best, point = above, relaxed
            continue
        waiting += _children(Node(above, low, high), share, apart, order)
    return IntegerOptimum(max([bound, *(node.bound for node in waiting)]), point, not waiting)


def _children(node: Node, share: Array, apart: Array, order: IntArray) -> list[Node]:
    """The two halves of a node; the second one, nearer to the relaxed point, is looked at first.

    `share` (binaries,) is the relaxed point, `apart` (binaries,) its distance to the limits of the node.
    """
    undecided = np.flatnonzero(apart > min(OPEN_BINARY, apart.max() / 2))
    chosen = undecided[np.argmin(order[undecided])]
    halves = []
    for value in (0.0, 1.0) if share[chosen] > 0.5 else (1.0, 0.0):
        low, high = node.low.copy(), node.high.copy()
        low[chosen] = high[chosen] = value
        halves.append(Node(node.bound, low, high))
    return halves


def prove(
    claim: Callable[[bool, float | None], IntegerOptimum],
    search: Callable[[Stop], IntegerOptimum],
    stop: Stop,
    is_well_scaled: bool,
) -> IntegerOptimum:
    """Prove what a MILP solver calls the optimum, by a search that may stop there.

    Parameters
    ----------
    claim : callable
        claim(presolve, seconds) is the solver's answer, with its presolve or without; SolverError if it has none.
    search : callable
        search(stop) is the answer of a branch and bound.
    stop : Stop
        Its nodes are not used: `PROOF_NODES` are allowed.
    is_well_scaled : bool
        Whether the solver's own bound may be returned after that, not proven.

    Returns
    -------
    IntegerOptimum
    """
    begin = perf_counter()

    def remaining() -> float | None:
        return None if stop.seconds is None else stop.seconds - (perf_counter() - begin)

    try:
        claimed = claim(True, None if stop.seconds is None else stop.seconds / 2)
    except SolverError:
        claimed = IntegerOptimum(np.inf, None, False, False)
    goal = stop.enough
    if claimed.finished and claimed.bound > -np.inf:
        goal = max(goal, claimed.bound + INTEGRALITY * (1 + abs(claimed.bound)))
    left = remaining()
    found = search(Stop(stop.gap, goal, PROOF_NODES, None if left is None else max(left, 0.0)))
    if found.point is None and claimed.point is not None:
        found = replace(found, point=claimed.point)
    left = remaining()
    if found.finished or (left is not None and left <= 0):
        return found
    try:
        other = claim(False, left)
    except SolverError:
        other = claimed
    said = max(claimed.bound, other.bound)
    if said < found.bound and claimed.finished and other.finished and is_well_scaled:
        return IntegerOptimum(said, found.point, True, False)
    return replace(found, finished=True)
