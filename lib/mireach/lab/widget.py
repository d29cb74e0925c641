"""Widgets for notebooks: step through a sequence of pictures, and the disturbance lab."""

import io
import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import anywidget
import ipywidgets
import traitlets

from ..checks import whole_number
from ..errors import MireachError
from ..files import write_whole
from ..plotting import legend_above, new_figure, plot_look, save_svg
from .answers import Look, look, maximal_set, safe_set_at
from .controls import Settings
from .messages import KINDS, Message, read_message
from .scenes import corners, maximal_scene, scene
from .scripts import script
from .search import Trials, largest_amount, next_amount
from .subjects import subject
from .views import size_name, size_of

STATIC = Path(__file__).parent / "static"
SCREEN_DPI = 90  # pixels of the page per inch; pictures have twice as many, for sharp screens
LOOP_CONTROLS = ("regions", "network")  # whose values need cells of their own
SAFE_SET_CONTROLS = ("network", "regions", "shape", "safe_directions")  # on which F_max depends, beside the amount
TERMINAL_SET_CONTROLS = (*SAFE_SET_CONTROLS, "amount", "directions", "log_epsilon", "centre")


def step_viewer(
    draw: Callable[[Any, int], object],
    count: int,
    label: str = "k",
    size: tuple[float, float] = (5.0, 5.0),
    *,
    dimension: int = 2,
) -> ipywidgets.VBox:
    """A slider with a play button that shows one picture per step.

    Parameters
    ----------
    draw : callable
        draw(ax, k) draws step k = 0, ..., count - 1 on empty Axes.
    count : int
        Number of steps.
    label : str
        Of the slider.
    size : (float, float)
        Of the picture, in inches.
    dimension : 2 or 3
        Of the Axes.

    Returns
    -------
    ipywidgets.VBox
        Its children are a row of (Play, IntSlider) and an Image; the slider's value may be set by code.

    Raises
    ------
    ValueError
        If count is no whole number of at least 1, or dimension neither 2 nor 3.

    Examples
    --------
    >>> viewer = step_viewer(lambda ax, k: ax.plot([0, k]), 3)
    >>> viewer.children[0].children[1].max
    2
    """
    count = whole_number(count, "count", 1)
    if dimension not in (2, 3):
        raise ValueError(f"dimension must be 2 or 3; got {dimension!r}")
    pictures: dict[int, bytes] = {}

    def picture(k: int) -> bytes:
        if k not in pictures:
            figure, ax = new_figure(size, 2 * SCREEN_DPI, dimension)
            draw(ax, k)
            file = io.BytesIO()
            figure.savefig(file, format="png")
            pictures[k] = file.getvalue()
        return pictures[k]

    width = f"{size[0] * SCREEN_DPI:.0f}px"
    image = ipywidgets.Image(value=picture(0), format="png", layout={"width": width})
    slider = ipywidgets.IntSlider(value=0, min=0, max=count - 1, description=label, layout={"flex": "1"})
    play = ipywidgets.Play(value=0, min=0, max=count - 1, interval=400, description="play")
    ipywidgets.jslink((play, "value"), (slider, "value"))
    slider.observe(lambda change: setattr(image, "value", picture(change["new"])), names="value")
    return ipywidgets.VBox([ipywidgets.HBox([play, slider], layout={"width": width}), image])


class DisturbanceLab(anywidget.AnyWidget):
    """A picture of the sets of a loop that follows the controls beside it.

    Parameters
    ----------
    case : CaseStudy, str or ClosedLoop
        As in `lab.subject`: a case study or its name, or a loop of one's own with two or more states.
    **settings
        Values of controls to begin with, such as amount=0.2; the rest are the case study's own.

    Attributes
    ----------
    settings : dict
        Control name -> value. May be replaced by code, as below (changes within the dict are not noticed); values
        out of range go to the nearest end.
    look : lab.Look
        The answer to `settings`: sets, verdicts and trajectories. For more than two states the page first shows what
        `look(..., terminal=False)` gives, and the rest once nothing is moved; this attribute is always complete.

    Raises
    ------
    TypeError
        If `case` is none of these.
    ValueError
        If there is no such case or control, or the loop has only one state.

    Examples
    --------
    >>> lab = DisturbanceLab("pwa", amount=0.1)
    >>> lab.settings = {**lab.settings, "amount": 0.2}
    >>> lab.look.safe.verdict
    'refuted'
    """

    _esm = STATIC / "lab.js"
    _css = STATIC / "lab.css"
    name = traitlets.Unicode().tag(sync=True)
    about = traitlets.Dict().tag(sync=True)
    controls: Any = traitlets.List().tag(sync=True)
    settings = traitlets.Dict().tag(sync=True)
    picture = traitlets.Dict().tag(sync=True)
    curve = traitlets.Dict().tag(sync=True)
    layer = traitlets.Dict().tag(sync=True)

    def __init__(self, case: Any, **settings: Any) -> None:
        self.subject = subject(case)
        self._stamp = 0  # of the last message that asked for a look
        self._looks = 0
        self._trials: dict[tuple[Any, ...], Trials] = {}  # values of SAFE_SET_CONTROLS -> trials
        self._prepared: list[Settings] = []
        self._maximal: Any = None
        self._completed: set[tuple[Any, ...]] = set()  # values of TERMINAL_SET_CONTROLS whose terminal set is known
        controls = [{**asdict(control), "choices": control.choices or None} for control in self.subject.controls]
        n = self.subject.dimension
        about = {"size": size_name(n).capitalize(), "unit": self.subject.unit, "n": n, "maximal": n == 2}
        super().__init__(name=self.subject.name, about=about, controls=controls, settings=self.subject.settle(settings))
        self._answer()
        self.observe(self._answer, names="settings")
        self.on_msg(self._on_message)

    def __repr__(self) -> str:
        return f"DisturbanceLab of {self.subject.name}: it appears where a kernel is running"

    @property
    def look(self) -> Look:
        """The answer to `settings`, complete."""
        self._complete()
        return self._look

    def script(self) -> str:
        """Lines of Python that compute the same sets without the lab."""
        return script(self.subject, self.settings)

    def save(self, path: str | Path) -> None:
        """Write the present look to a file: its figure (.svg), its sets (.json), or the Python that makes them (.py).

        Raises
        ------
        ValueError
            If the name ends otherwise.
        OSError
            If the file cannot be written.
        """
        kinds = {f".{ending}": kind for kind, (ending, _) in KINDS.items()}
        path = Path(path)
        if path.suffix not in kinds:
            raise ValueError(f"the name of the file must end in {', '.join(kinds)}; got {path.name!r}")
        write_whole(path, self._text(kinds[path.suffix]))

    @traitlets.validate("settings")
    def _settle(self, proposal: dict[str, Any]) -> Settings:
        try:
            return self.subject.settle(proposal["value"])
        except (TypeError, ValueError) as error:
            raise traitlets.TraitError(str(error)) from error

    def _answer(self, _change: object = None) -> None:
        """Compute the look of the present settings and send it to the page."""
        at_once = not self.subject.slow or self._terminal_key in self._completed
        self._look = look(self.subject, self.settings, terminal=at_once)
        self._looks += 1
        self._show_look()
        self._show_curve()

    def _show_look(self) -> None:
        self.picture = {**scene(self._look), "stamp": self._stamp, "number": self._looks}

    def _complete(self) -> None:
        """Compute what a pending look lacks, and send it to the page."""
        if self._look.pending:
            self._look = look(self.subject, self.settings)
            self._completed.add(self._terminal_key)
            self._show_look()

    @property
    def _terminal_key(self) -> tuple[Any, ...]:
        return tuple(self.settings.get(name) for name in TERMINAL_SET_CONTROLS)

    def _on_message(self, _widget: object, content: Any, _buffers: object) -> None:
        """Answer a message of the page. One that cannot be answered changes nothing but the error that is shown."""
        try:
            message = read_message(content)
        except (TypeError, ValueError) as error:
            self._show_error(error)
            return
        try:
            self._do(message)
        except (MireachError, ValueError, ArithmeticError) as error:
            self._show_error(error)

    def _show_error(self, error: Exception) -> None:
        self.picture = {**self.picture, "error": str(error), "stamp": self._stamp}

    def _do(self, message: Message) -> None:
        """Do what a message asks for."""
        if message.do == "look":
            self._stamp = message.stamp
            wanted = self.subject.settle(message.settings)
            if wanted == self.settings:
                self._answer()
            self.settings = wanted
        elif message.do == "idle":
            self._idle()
        elif message.do == "layer":
            maximal = maximal_set(self._look.loop)
            self.layer = {**maximal_scene(maximal, self._look.loop.system.state_set), "number": self._looks}
            self._maximal = maximal.set
        else:
            ending, media = KINDS[message.kind]
            name = f"mireach_{self.subject.name}.{ending}"
            self.send({"file": name, "type": media, "text": self._text(message.kind)})

    def _text(self, kind: str) -> str:
        """The content of a file of one of the `KINDS`."""
        if kind == "script":
            return self.script()
        maximal = self._maximal if self.layer.get("number") == self._looks else None
        if kind == "sets":
            content = {"subject": self.subject.name, **self.look.to_dict()}
            return json.dumps(content | {"maximal_safe_set": maximal and maximal.to_dict()}, indent=1)
        figure, ax = new_figure((6, 6.4))
        plot_look(ax, self.look, maximal=maximal)
        legend_above(ax, 4)
        file = io.StringIO()
        save_svg(figure, file)
        return file.getvalue()

    # -- work for idle moments: what the look lacks, the largest disturbance, what the next click may need -----

    @property
    def _present_trials(self) -> Trials:
        """The trials of other amounts of disturbance, with all else as in the present settings."""
        values = tuple(self.settings.get(name) for name in SAFE_SET_CONTROLS)
        return self._trials.setdefault(values, {})

    def _idle(self) -> None:
        """One piece of work: what the look lacks, one more amount of disturbance, or cells that a click may need."""
        amount = self._next_amount()
        if self._look.pending:
            self._complete()
        elif amount is not None:
            self._present_trials[amount] = safe_set_at(self.subject, self.settings, amount)
        elif self._ahead:
            look(self.subject, {**self.settings, **self._ahead[0]})
            self._prepared.append(self._ahead[0])
        self._show_curve()

    @property
    def _ahead(self) -> list[Settings]:
        """Settings one click away that need cells of their own and have not been looked at."""
        now = {name: self.settings[name] for name in LOOP_CONTROLS if name in self.settings}
        ahead: list[Settings] = []
        for control in filter(None, map(self.subject.control, LOOP_CONTROLS)):
            ahead += [{**now, control.name: value} for value in control.values()]
        return [one for one in ahead if one not in self._prepared]

    def _next_amount(self) -> float | None:
        control = self.subject.amount
        return next_amount(self._present_trials, control.low, control.high)

    def _show_curve(self) -> None:
        """Send to the page what the trials show of the largest disturbance."""
        trials = self._present_trials
        largest, settled = largest_amount(trials), self._next_amount() is None
        text = "none" if largest is None else f"{largest:.4f}"
        if largest == self.subject.amount.high:
            text = f"{text} or more, the end of the range"
        best = None if largest is None else trials[largest]
        self.curve = {
            "points": [[amount, found and size_of(found)] for amount, found in sorted(trials.items())],
            "largest": largest,
            "largest_set": None if best is None else corners(self._look.view, best),
            "settled": settled,
            "done": settled and not self._ahead and not self._look.pending,
            "summary": f"{self.about['size']} of F_max over the disturbance; largest with an F_max: {text}.",
        }
