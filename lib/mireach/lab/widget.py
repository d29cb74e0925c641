"""Widgets for notebooks: step through a sequence of pictures, and the disturbance lab."""

import io
import json
from dataclasses import asdict
from pathlib import Path

import anywidget
import ipywidgets
import traitlets
from matplotlib.figure import Figure

from ..checks import require_kind, whole_number
from ..errors import MireachError
from ..files import write_whole
from ..plotting import legend_above, plot_look, save_svg
from .model import largest_amount, look, maximal_scene, maximal_set, next_amount, safe_set_at, scene, script, subject

STATIC = Path(__file__).parent / "static"
KINDS = {"figure": ("svg", "image/svg+xml"), "sets": ("json", "application/json"), "script": ("py", "text/x-python")}
SCREEN_DPI = 90  # pixels of the page an inch; pictures have twice as many, for sharp screens


def step_viewer(draw, count, label="k", size=(5.0, 5.0)):
    """A slider with a play button that shows one picture a step.

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

    Returns
    -------
    ipywidgets.VBox
        Its children are a row of (Play, IntSlider) and an Image; the slider's value may be set by code.
    """
    if count < 1:
        raise ValueError(f"count must be at least 1, for there must be something to show; got {count}")
    pictures = {}

    def picture(k):
        if k not in pictures:
            figure = Figure(figsize=size, dpi=2 * SCREEN_DPI, layout="constrained")
            draw(figure.add_subplot(), k)
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
        As in `lab.subject`: a case study or its name, or a loop with two states of one's own.
    **settings
        Values of controls to begin with, such as amount=0.2; the rest are the case study's own.

    Attributes
    ----------
    settings : dict
        Control name -> value. May be replaced by code, as below (changes within the dict are not noticed); values
        out of range go to the nearest end.
    look : lab.Look
        The answer to `settings`: sets, verdicts and trajectories.

    Raises
    ------
    ValueError
        If there is no such case or control, or the loop has not two states.

    Examples
    --------
    >>> lab = DisturbanceLab("pwa", amount=0.1)
    >>> lab.settings = {**lab.settings, "amount": 0.2}
    >>> lab.look.safe.verdict
    'proven'
    """

    _esm = STATIC / "lab.js"
    _css = STATIC / "lab.css"
    name = traitlets.Unicode().tag(sync=True)
    controls = traitlets.List().tag(sync=True)
    settings = traitlets.Dict().tag(sync=True)
    picture = traitlets.Dict().tag(sync=True)
    curve = traitlets.Dict().tag(sync=True)
    layer = traitlets.Dict().tag(sync=True)

    def __init__(self, case, **settings):
        self.subject = subject(case)
        self._stamp, self._looks, self._known, self._prepared, self._maximal = 0, 0, {}, [], None
        controls = [{**asdict(control), "choices": control.choices or None} for control in self.subject.controls]
        super().__init__(name=self.subject.name, controls=controls, settings=self.subject.settle(settings))
        self._answer()
        self.observe(self._answer, names="settings")
        self.on_msg(self._on_message)

    def __repr__(self):
        return f"DisturbanceLab of {self.subject.name}: it appears where a kernel is running"

    def script(self):
        """Lines of Python that compute the same sets without the lab."""
        return script(self.subject, self.settings)

    def save(self, path):
        """Write the present look to a file: its figure (.svg), its sets (.json), or the Python that makes them (.py).

        Raises
        ------
        ValueError
            If the name ends otherwise.
        """
        kinds = {f".{ending}": kind for kind, (ending, _) in KINDS.items()}
        path = Path(path)
        if path.suffix not in kinds:
            raise ValueError(f"the name of the file must end in {', '.join(kinds)}; got {path.name!r}")
        write_whole(path, self._text(kinds[path.suffix]))

    @traitlets.validate("settings")
    def _settle(self, proposal):
        try:
            return self.subject.settle(proposal["value"])
        except ValueError as error:
            raise traitlets.TraitError(str(error)) from error

    def _answer(self, _change=None):
        """Compute the look of the present settings and hand it to the page."""
        self.look = look(self.subject, self.settings)
        self._looks += 1
        self.picture = {**scene(self.look), "stamp": self._stamp, "number": self._looks}
        self._show_curve()

    def _on_message(self, _widget, message, _buffers):
        """What the page asks for: a look at other settings, some idle work, the maximal safe set, or a file.

        A message that cannot be answered changes nothing; the page shows why, as the "error" of `picture`.
        """
        try:
            self._do(message)
        except (MireachError, ValueError, ArithmeticError) as error:
            self.picture = {**self.picture, "error": str(error), "stamp": self._stamp}

    def _do(self, message):
        """Answer one message; ValueError if it is none that the page sends."""
        require_kind(message, dict, "a message of the page")
        do = message.get("do")
        if do == "look":
            self._stamp = whole_number(message.get("stamp"), "stamp", 0)
            wanted = self.subject.settle(message.get("settings"))
            if wanted == self.settings:
                self._answer()
            self.settings = wanted
        elif do == "idle":
            self._idle()
        elif do == "layer":
            found = maximal_set(self.look.loop)
            self.layer = {**maximal_scene(found, self.look.loop.system.state_set), "number": self._looks}
            self._maximal = found.set
        elif do == "save":
            kind = message.get("kind")
            if kind not in tuple(KINDS):
                raise ValueError(f"a file must be of the kind {', '.join(KINDS)}; got {kind!r:.80}")
            ending, media = KINDS[kind]
            name = f"mireach_{self.subject.name}.{ending}"
            self.send({"file": name, "type": media, "text": self._text(kind)})
        else:
            raise ValueError(f"a message must ask for look, idle, layer or save; got {do!r:.80}")

    def _text(self, kind):
        if kind == "script":
            return self.script()
        maximal = self._maximal if self.layer.get("number") == self._looks else None
        if kind == "sets":
            found = {"subject": self.subject.name, **self.look.to_dict()}
            return json.dumps(found | {"maximal_safe_set": maximal and maximal.to_dict()}, indent=1)
        figure = Figure(figsize=(6, 6.4), layout="constrained")
        ax = figure.add_subplot()
        plot_look(ax, self.look, maximal=maximal)
        legend_above(ax, 4)
        file = io.StringIO()
        save_svg(figure, file)
        return file.getvalue()

    # -- work for idle moments: the largest disturbance, then what the next click may need -------------

    @property
    def _points(self):
        """What is known of safe sets for other amounts of disturbance: amount -> Polytope or None."""
        others = ("network", "regions", "shape", "safe_directions")
        return self._known.setdefault(tuple(self.settings.get(name) for name in others), {})

    def _idle(self):
        """One short piece of work: one more amount of disturbance, or cells that a click may need."""
        amount = self._next_amount()
        if amount is not None:
            self._points[amount] = safe_set_at(self.subject, self.settings, amount)
        elif self._ahead:
            look(self.subject, {**self.settings, **self._ahead[0]})
            self._prepared.append(self._ahead[0])
        self._show_curve()

    @property
    def _ahead(self):
        """Settings one click away that need cells of their own and have not been looked at."""
        controls = [self.subject.control(name) for name in ("regions", "network")]
        ahead = []
        for control in filter(None, controls):
            values = control.choices or range(int(control.low), int(control.high) + 1)
            now = {name: self.settings[name] for name in ("regions", "network") if name in self.settings}
            ahead += [{**now, control.name: value} for value in values]
        return [one for one in ahead if one not in self._prepared]

    def _next_amount(self):
        control = self.subject.control("amount")
        return next_amount(self._points, control.low, control.high)

    def _show_curve(self):
        """Hand to the page what is known of the largest disturbance."""
        points = sorted(self._points.items())
        largest, settled = largest_amount(self._points), self._next_amount() is None
        found = "none" if largest is None else f"{largest:.4f}"
        if largest == self.subject.control("amount").high:
            found = f"{found} or more, the end of the range"
        self.curve = {
            "points": [[amount, found and found.area] for amount, found in points],
            "largest": largest,
            "largest_set": None if largest is None else self._points[largest].vertices().tolist(),
            "settled": settled,
            "done": settled and not self._ahead,
            "summary": f"Area of F_max over the disturbance; largest with an F_max: {found}.",
        }
