"""How sets and states of R^n are drawn in the plane: as they are for n = 2, as projections or sections for n > 2."""

from abc import ABC, abstractmethod
from functools import lru_cache
from itertools import combinations

import numpy as np

from ..checks import real_array, require_kind
from ..sets.polytope import Polytope
from ..typing import Array, ArrayLike

DIGITS = "₀₁₂₃₄₅₆₇₈₉"
DRAWN = 4096  # polygons in the cache: enough for several looks, whose sequences have up to a few hundred sets


class View(ABC):
    """How sets and states of R^n are drawn in the plane.

    Parameters
    ----------
    axes : (int, int)
        The two coordinates that are drawn, horizontal and vertical, counted from 0.
    state : array (n,)
        The initial state of the trajectories; a section passes through it.
    unit : str
        The unit of the states; empty if there is none.

    See Also
    --------
    Plane, Projection, Section : the available views.
    """

    def __init__(self, axes: tuple[int, int], state: ArrayLike, unit: str = "") -> None:
        self.axes, self.state, self.unit = axes, real_array(state, "state", 1), unit
        if not 0 <= min(axes) < max(axes) < len(self.state):
            raise ValueError(f"axes must be two different coordinates from 0 to {len(self.state) - 1}; got {axes}")

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.axes}, state={self.state.tolist()}, unit={self.unit!r})"

    @abstractmethod
    def polygon(self, P: Polytope) -> Polytope:
        """The Polytope of R^2 that is drawn for a bounded Polytope of R^n."""

    def points(self, states: Array) -> Array:
        """The points (..., 2) that are drawn for states (..., n): two of their coordinates."""
        return states[..., list(self.axes)]

    @property
    @abstractmethod
    def title(self) -> str:
        """What is drawn of a set, such as "projection onto (x₁, x₂)"; empty if the whole set is drawn."""

    @property
    @abstractmethod
    def caption(self) -> str:
        """What the picture does not show of the sets, and how it may mislead; empty if it shows them as they are."""

    @property
    def names(self) -> tuple[str, str]:
        """The labels of the axes, such as "x₁ (cm)"."""
        unit = f" ({self.unit})" if self.unit else ""
        right, up = (f"{coordinate(axis)}{unit}" for axis in self.axes)
        return right, up

    @property
    def pair(self) -> str:
        """The coordinates that are drawn, such as "(x₁, x₂)"."""
        return f"({', '.join(map(coordinate, self.axes))})"

    @property
    def hidden(self) -> list[int]:
        """The coordinates that are not drawn."""
        return [axis for axis in range(len(self.state)) if axis not in self.axes]

    @property
    def fixed(self) -> str:
        """The initial state's coordinates that are not drawn, such as "x₃ = 0 cm"."""
        unit = f" {self.unit}" if self.unit else ""
        return ", ".join(f"{coordinate(axis)} = {self.state[axis]:.4g}{unit}" for axis in self.hidden).replace("-", "−")


class Plane(View):
    """The view of R^2, which shows every state and every set as it is.

    Examples
    --------
    >>> P = Polytope.box([0, 0], [1, 2])
    >>> Plane((0, 1), [0, 0]).polygon(P) is P
    True
    """

    title = caption = ""

    def polygon(self, P: Polytope) -> Polytope:
        """P itself."""
        return P


class Projection(View):
    """The projection {(x_i, x_j) : x in P} of sets and states onto two coordinates.

    Examples
    --------
    >>> box = Polytope.box([0, 0, 0], [1, 2, 3])
    >>> Projection((0, 2), [0, 0, 0]).polygon(box).vertices().tolist()
    [[0.0, 0.0], [1.0, 0.0], [1.0, 3.0], [0.0, 3.0]]
    """

    def polygon(self, P: Polytope) -> Polytope:
        """The projection of P, rounded outward."""
        return _projected(P, self.axes)

    @property
    def title(self) -> str:
        return f"projection onto {self.pair}"

    @property
    def choice(self) -> str:
        """The label of this view in the menu."""
        return self.title

    @property
    def caption(self) -> str:
        hidden = ", ".join(map(coordinate, self.hidden))
        return (
            f"Projection onto {self.pair}: a point belongs to the projection of a set if the set contains a state with "
            f"these coordinates, for some {hidden}. A state drawn inside may lie outside the set, so a trajectory may "
            f"enter the projection before it enters the set. The initial state (ring) has {self.fixed}."
        )


class Section(View):
    """The section {(x_i, x_j) : x in P, x_k = state_k for all other k} of sets; states are projected.

    Examples
    --------
    >>> P = Polytope([[1, 1, 1]], [3]) & Polytope.box([0, 0, 0], [2, 2, 2])
    >>> Section((0, 1), [0, 0, 2]).polygon(P).vertices().tolist()
    [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]
    """

    def polygon(self, P: Polytope) -> Polytope:
        """The section of P, rounded outward; empty if P contains no state with the fixed coordinates."""
        return _cut(P, self.axes, tuple(self.state.tolist()[axis] for axis in self.hidden))

    @property
    def title(self) -> str:
        return f"section {self.fixed},\npaths projected"

    @property
    def choice(self) -> str:
        """The label of this view in the menu; the initial state has controls of its own."""
        return f"section {self.pair} at the initial {', '.join(map(coordinate, self.hidden))}"

    @property
    def caption(self) -> str:
        return (
            f"Section at {self.fixed}, through the initial state (ring). Sets and regions are shown as sections. "
            f"Trajectories leave the section and are drawn as projections onto {self.pair}, so later states drawn "
            "inside a set may lie outside it."
        )


KINDS: dict[str, type[Projection] | type[Section]] = {"projection": Projection, "section": Section}


def view_choices(n: int) -> dict[str, str]:
    """The views of R^n, n > 2, for the menu of the lab: value -> label.

    See Also
    --------
    chosen_view

    Examples
    --------
    >>> list(view_choices(3))[2:4]
    ['projection 2 3', 'section 1 2']
    """
    origin, pairs = np.zeros(n), [*combinations(range(n), 2)]
    return {f"{name} {i + 1} {j + 1}": kind((i, j), origin).choice for name, kind in KINDS.items() for i, j in pairs}


def chosen_view(choice: str | None, state: ArrayLike, unit: str = "") -> View:
    """The View for a value of `view_choices`; None is the plane itself, for n = 2.

    Parameters
    ----------
    choice : str or None
    state : array (n,)
        The initial state.
    unit : str
        The unit of the states.

    Returns
    -------
    View

    Raises
    ------
    TypeError
        If choice is neither None nor str.
    ValueError
        If R^n has no such view.

    Examples
    --------
    >>> chosen_view("section 1 3", [0, 0.5, 0], "cm").fixed
    'x₂ = 0.5 cm'
    """
    state = real_array(state, "state", 1)
    if choice is None:
        if len(state) != 2:
            raise ValueError(f"a view must be chosen for {len(state)} states; only the plane needs none")
        return Plane((0, 1), state, unit)
    require_kind(choice, str, "choice")
    if choice not in view_choices(len(state)):
        raise ValueError(f"there is no view {choice!r:.80}; choose one of {', '.join(view_choices(len(state)))}")
    kind, i, j = choice.split()
    return KINDS[kind]((int(i) - 1, int(j) - 1), state, unit)


def coordinate(axis: int) -> str:
    """The name of the coordinate with this number, counted from 0.

    Examples
    --------
    >>> coordinate(2)
    'x₃'
    """
    return "x" + "".join(DIGITS[int(digit)] for digit in str(axis + 1))


def size_name(n: int) -> str:
    """The word for the size of a set of R^n: "area" or "volume"."""
    return "area" if n == 2 else "volume"


@lru_cache(maxsize=DRAWN)
def size_of(P: Polytope) -> float:
    """The area of a Polytope of R^2, or the volume of one of R^n.

    Examples
    --------
    >>> size_of(Polytope.box([0, 0, 0], [1, 2, 3]))
    6.0
    """
    return P.area if P.dimension == 2 else P.volume()


@lru_cache(maxsize=DRAWN)
def _projected(P: Polytope, axes: tuple[int, int]) -> Polytope:
    return P.project(axes)


@lru_cache(maxsize=DRAWN)
def _cut(P: Polytope, axes: tuple[int, int], fixed: tuple[float, ...]) -> Polytope:
    at = np.zeros(P.dimension)
    at[[axis for axis in range(P.dimension) if axis not in axes]] = fixed
    return P.section(axes, at)
