"""What may be set in a disturbance lab: controls, and the subject whose loop, templates and view they describe."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from ..checks import require_kind
from ..sets.polytope import Polytope
from ..systems.loop import ClosedLoop
from ..systems.nonlinear import NonlinearSystem
from ..typing import Array
from .views import View, chosen_view

Settings = dict[str, Any]  # control name -> value


@dataclass(frozen=True)
class Control:
    """One thing that may be set.

    Attributes
    ----------
    name, label : str
    default : float or str
    low, high, step : float
        Range and grid of a number, which is a whole one where `step` is 1.
    slider : bool
        Whether a number has a slider beside its field.
    choices : dict of str to str
        Value -> label, for a choice; empty for a number.
    unit : str
        Of a number; empty if it has none.

    Examples
    --------
    >>> Control("k", "steps", 8, 4, 32, step=1).settle(99)
    32
    """

    name: str
    label: str
    default: float | str
    low: float = 0.0
    high: float = 0.0
    step: float = 0.0
    slider: bool = True
    choices: dict[str, str] = field(default_factory=dict)
    unit: str = ""

    def __str__(self) -> str:
        values = f"one of {', '.join(self.choices)}" if self.choices else f"{self.low:g} to {self.high:g}"
        return f"{self.name} ({self.label}): {values}, at first {self.default}"

    def settle(self, value: Any) -> float | str:
        """The nearest value that may be set: numbers are brought into the range, whole ones are rounded.

        Raises
        ------
        ValueError
            If the value is no finite number, or not among the choices.
        """
        if self.choices:
            if str(value) not in self.choices:
                raise ValueError(f"{self.name} must be one of {', '.join(self.choices)}; got {value!r:.80}")
            return str(value)
        try:
            number = float(value)
        except (TypeError, ValueError, OverflowError) as error:
            raise ValueError(f"{self.name} must be a number; got {value!r:.80}") from error
        if not np.isfinite(number):
            raise ValueError(f"{self.name} must be finite; got {value!r}")
        number = min(max(number, self.low), self.high)
        return round(number) if self.step == 1 else number

    def values(self) -> list[Any]:
        """All values of a choice or of a whole number."""
        return list(self.choices) or list(range(int(self.low), int(self.high) + 1))


@dataclass(frozen=True, eq=False)
class Template:
    """The rows of a template, and the Python that makes them.

    Attributes
    ----------
    rows : array (l, n)
    source : str
    """

    rows: Array
    source: str

    def __str__(self) -> str:
        return f"template of {len(self.rows)} rows: {self.source}"


@dataclass(frozen=True, eq=False)
class Subject:
    """What a lab looks at.

    Attributes
    ----------
    name : str
    controls : tuple of Control
    base : callable
        settings -> ClosedLoop whose disturbance sets are those of amount 1; equal settings give the same object.
    source : callable
        settings -> list of str, lines of Python that make the base, called `loop`.
    templates : callable
        (name, value) -> Template of the control "safe_directions" or "directions"; equal values give the same object.
    dimension : int
        Number of states n.
    unit : str
        Of the states; empty if they have none.
    plant : NonlinearSystem or None
        What the loop's system approximates.

    See Also
    --------
    subject
    """

    name: str
    controls: tuple[Control, ...]
    base: Callable[[Settings], ClosedLoop]
    source: Callable[[Settings], list[str]]
    templates: Callable[[str, Any], Template]
    dimension: int = 2
    unit: str = ""
    plant: NonlinearSystem | None = None

    def __str__(self) -> str:
        return f"subject {self.name} of a lab, with the controls {', '.join(one.name for one in self.controls)}"

    def loop(self, settings: Settings) -> ClosedLoop:
        """The ClosedLoop that these settings describe."""
        return _scaled(self.base(settings), settings["amount"])

    def template(self, name: str, settings: Settings) -> Template:
        """The Template that the control "safe_directions" or "directions" chooses."""
        return self.templates(name, settings[name])

    def start(self, settings: Settings) -> Array:
        """The initial state of the trajectories: array (n,)."""
        return np.array([settings[f"x{i}"] for i in range(1, self.dimension + 1)])

    def view(self, settings: Settings) -> View:
        """How states and sets are drawn."""
        return chosen_view(settings.get("view"), self.start(settings), self.unit)

    @property
    def slow(self) -> bool:
        """Whether a terminal set takes longer than a look may, so that a page fills it in afterwards."""
        return self.dimension > 2

    def control(self, name: str) -> Control | None:
        """The Control of this name; None if there is none."""
        return next((control for control in self.controls if control.name == name), None)

    @property
    def amount(self) -> Control:
        """The control of the disturbance, which every subject has."""
        return next(control for control in self.controls if control.name == "amount")

    def settle(self, settings: Mapping[str, Any]) -> Settings:
        """Settings with every number in its range, and defaults for what is not given.

        Parameters
        ----------
        settings : dict
            Control name -> value.

        Raises
        ------
        TypeError
            If it is no dict.
        ValueError
            If there is no such control, or a value is of the wrong kind.

        Examples
        --------
        >>> from mireach.lab import subject
        >>> subject("pwa").settle({"amount": -3})["amount"]
        0.0
        """
        require_kind(settings, dict, "settings")
        known = {control.name: control for control in self.controls}
        unknown = sorted(f"{name!s:.80}" for name in set(settings) - set(known))
        if unknown:
            raise ValueError(f"there is no control {', '.join(unknown)}; there are {', '.join(known)}")
        return {name: control.settle(settings.get(name, control.default)) for name, control in known.items()}


def epsilon_of(settings: Settings) -> float:
    """The epsilon of eq. (25), TerminationFmin, which is set by its logarithm, to three digits."""
    return float(f"{10 ** settings['log_epsilon']:.3g}")


@lru_cache(maxsize=256)
def _scaled(loop: ClosedLoop, amount: float) -> ClosedLoop:
    """The loop with its disturbance sets scaled about the point 0; equal sets become one object."""
    sets: dict[tuple[bytes, bytes], Polytope] = {}
    for mode in loop.system.modes:
        D = mode.disturbance
        sets.setdefault((D.H.tobytes(), D.h.tobytes()), Polytope(D.H, amount * D.h))
    D = [sets[mode.disturbance.H.tobytes(), mode.disturbance.h.tobytes()] for mode in loop.system.modes]
    return loop.with_disturbance(D)
