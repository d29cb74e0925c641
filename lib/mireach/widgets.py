"""Widgets for notebooks: step through a sequence of pictures."""

import io

import ipywidgets
from matplotlib.figure import Figure

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
