"""The support function of one step without rounding, by the exact cells of a loop, for any number of states."""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, ClassVar

import numpy as np

from ..arithmetic.rational import above, binary, dot, fractions, nearest
from ..checks import whole_number
from ..sets.exact_polytopes import ExactPolytope
from ..sets.polytope import Polytope
from ..systems.loop import ClosedLoop
from ..systems.network import MaxoutNetwork
from ..tolerances import AROUND
from ..typing import Array, ArrayLike, Rational
from .base import EXACT, Engine, LazySequence, Support, Witness, checked_query, empty_support, replay
from .exact_cells import MOST_CELLS, Point, affine_pieces, cell_floats, cells, disturbances, highest, rows_of
from .steps import Step


@dataclass(frozen=True)
class Exact(Engine):
    """h of R_1(F) by the cells in exact arithmetic, for any number of states and one step.

    It is meant for loops with few cells, such as those of small networks and few states. The cells are kept, so that
    further questions about the same loop take a fraction of the time.

    Attributes
    ----------
    most_cells : int
        Cells that are affordable for four states; half as many for each further state, and twice as many for each
        state less. More of them are a CellLimitError. Time and memory grow in proportion.

    See Also
    --------
    Cells : the same in floating point, for any number of steps.
    Milp : without cells, for large networks.

    Examples
    --------
    >>> import mireach as mr
    >>> case = mr.case_study("four_tanks")
    >>> found = mr.support(case.loop, case.system.state_set, [[1, 0, 0, 0]], engine="exact")
    >>> bool(found.bound[0] <= np.nextafter(found.value[0], np.inf)), found.rests_on
    (True, 'exact arithmetic')
    """

    name: ClassVar[str] = "exact"
    most_cells: int = MOST_CELLS

    def __post_init__(self) -> None:
        object.__setattr__(self, "most_cells", whole_number(self.most_cells, "most_cells", 1))

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
        """As `Engine.support`: `bound` is the smallest float that is not below the exact value, `value` the nearest.

        `cutoff` and `warm_start` are not used.

        Raises
        ------
        ValueError
            If `steps` is not 1.
        CellLimitError
            If the loop has too many cells.
        """
        V, steps = checked_query(loop, F, V, steps)
        if steps != 1:
            instead = 'engine="cells"' if loop.system.state_size == 2 else 'engine="milp"'
            raise ValueError(f"the exact engine takes one step; got steps = {steps}; use {instead}")
        best = support_steps(loop, F, V, self.most_cells)
        if best is None:
            return empty_support(len(V), EXACT)
        value, bound = (np.array([rounded(step.value) for step in best]) for rounded in (nearest, above))

        def witness(k: int) -> Witness:
            x, d = ([nearest(entry) for entry in part] for part in (best[k].state, best[k].disturbance))
            return replay(loop, np.array(x), [best[k].mode], [np.array(d)])

        return Support(value, bound, LazySequence(len(V), witness), rests_on=EXACT)


def support_steps(loop: ClosedLoop, F: Polytope, V: Array, most: int = MOST_CELLS) -> list[Step] | None:
    """The Step from F with the largest v x+, for each row v of V: list, or None if F does not meet X.

    Parameters
    ----------
    loop : ClosedLoop
    F : Polytope
    V : array (k, n)
    most : int
        As `Exact.most_cells`.

    Raises
    ------
    CellLimitError
        If there are more cells.
    """
    every, spread = cells(loop, most), disturbances(loop)
    if not every:
        return None
    rows, parts = rows_of(F), dict[int, ExactPolytope]()
    low, high = cell_floats(loop, most)[0].sides(F.H, F.h)
    near, heights = np.flatnonzero(low.all(axis=1)), _heights(loop, V, most)
    best = []
    for k, v in enumerate(map(binary, V.tolist())):
        pushed = [max(corners, key=lambda d: dot(v, d)) for corners in spread]
        found = None
        for j in near[np.argsort(-heights[near, k], kind="stable")].tolist():
            if found is not None and heights[j, k] < nearest(found[0]):  # the cells that follow have no larger value
                break
            if j not in parts:
                parts[j] = every[j].part.clip_all(row for row, cuts in zip(rows, high[j]) if cuts)
            if parts[j].is_empty:
                continue
            d = pushed[every[j].mode]
            value, x = highest(parts[j], every[j].after, v)
            value += dot(v, d)
            if found is None or value > found[0]:
                found = (value, x, j, d)
        if found is None:
            return None
        value, x, j, d = found
        H, h = zip(*every[j].part.half_spaces, *zip(*F.exact))
        best.append(Step(value, x, every[j].mode, d, (H, h)))
    return best


def _heights(loop: ClosedLoop, V: Array, most: int) -> Array:
    """Upper bounds in floats of v x+ for all x of each whole cell and all d, for the rows v of V: array (cells, k)."""
    images, modes = cell_floats(loop, most)[1], [cell.mode for cell in cells(loop, most)]
    corners = [np.array([[nearest(entry) for entry in d] for d in one]) for one in disturbances(loop)]
    spread = np.array([(V @ ends.T).max(axis=1) for ends in corners])[modes]
    size = 1 + np.abs(images.points).max(initial=0.0) + np.abs(spread).max()
    around = AROUND * size * (1 + np.abs(V).sum(axis=1))
    return np.maximum.reduceat(images.points @ V.T, images.starts) + spread + around


def highest_inputs(
    network: MaxoutNetwork, X: Polytope, V: Sequence[Sequence[Rational]], most: int = MOST_CELLS
) -> list[tuple[Rational, Point]]:
    """max v Phi(x) over x in X and a maximizer x, for the rows v of V, without rounding: list of (fmpq, x).

    Raises
    ------
    CellLimitError
        If Phi has too many affine pieces on X; `most` is `Exact.most_cells`.
    """
    best: list[Any] = [None] * len(V)
    for part, output in affine_pieces(network, X, most):
        for k, v in enumerate(V):
            value, x = highest(part, output, v)
            if best[k] is None or value > best[k][0]:
                best[k] = value, x
    return best


def growth(C: ArrayLike, before: Array, h: Array, centre: ArrayLike) -> Fraction | None:
    """The largest alpha with c + alpha (R - c) in R_before, without rounding: eq. (26), StabCondFmin.

    R = {x : C x <= h} and R_before = {x : C x <= before}.

    Parameters
    ----------
    C : array (l, n)
        Rows of both sets, which are bounded.
    before, h : array (l,)
        Offsets of R_before and R.
    centre : array (n,)
        c.

    Returns
    -------
    Fraction or None
        None if c is not inside R.
    """
    corners, c = ExactPolytope.of(Polytope(np.asarray(C), h)).vertices, binary(np.asarray(centre).tolist())
    shares = []
    for a, limit in zip(binary(np.asarray(C).tolist()), before.tolist()):
        size = max((dot(a, x) for x in corners), default=dot(a, c)) - dot(a, c)
        if size <= 0:
            return None
        shares.append((binary(limit) - dot(a, c)) / size)
    return fractions([min(shares)])[0]
