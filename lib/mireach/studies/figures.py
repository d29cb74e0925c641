"""The figures of the report: those of the paper, the maximal safe set, the tanks, and the areas of the seed study."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from .. import plotting
from .case_analysis import Analysis
from .case_studies import data_file
from .seed_study import load_rows

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SQUARE, WIDE = (6.4, 6.2), (6.4, 3.8)  # inches
REACH = r"\overline{\mathcal{R}}"


def draw_figures(analyses: list[Analysis], folder: str | Path) -> None:
    """Draw the figures of all cases, which their definitions name, and the areas of the seed study.

    Parameters
    ----------
    analyses : list of Analysis
    folder : str or Path
        Gets each figure as SVG and as PNG.
    """
    _save(Drawing(partial(_seed_areas, analyses=analyses), WIDE), Path(folder) / "seed_areas")
    for analysis in analyses:
        for name in analysis.case.definition.figures:
            one = FIGURES[name]
            _save(one._replace(draw=partial(one.draw, analysis=analysis)), Path(folder) / name)


class Drawing(NamedTuple):
    """A figure: what draws it, its size in inches, and its panels. One panel is passed as Axes, more as an array."""

    draw: Callable[..., None]
    size: tuple[float, float] = SQUARE
    panels: tuple[int, int] = (1, 1)
    dimension: int = 2


def _save(drawing: Drawing, path: Path) -> None:
    figure, axes = plotting.new_figure(drawing.size, dimension=drawing.dimension, panels=drawing.panels)
    drawing.draw(axes)
    plotting.save_figure(figure, path.with_suffix(".svg"), bbox_inches="tight")
    plotting.save_figure(figure, path.with_suffix(".png"), dpi=150, bbox_inches="tight")


def _seed_areas(ax: "Axes", analyses: list[Analysis]) -> None:
    cases = [analysis.case for analysis in analyses if analysis.case.paper]
    studies = {case.name: load_rows(data_file(case.name, "seeds.csv")) for case in cases}
    plotting.plot_areas(ax, studies, {case.name: case.system.state_set.area for case in cases})


def _sets(analysis: Analysis) -> dict[str, Any]:
    return {"system": analysis.case.system, "safe": analysis.safe, "terminal": analysis.terminal}


def _figure1(ax: "Axes", analysis: Analysis) -> None:
    plotting.plot_sequence(ax, **_sets(analysis))


def _figure2(ax: "Axes", analysis: Analysis) -> None:
    paths = analysis.trajectories
    plotting.plot_tubes(ax, **_sets(analysis), tubes=paths.tubes, nominal=paths.nominal)


def _figure3(ax: "Axes", analysis: Analysis) -> None:
    case, paths = analysis.case, analysis.trajectories
    assert case.plant is not None  # Figure 3 is the vector field of a nonlinear plant
    plant = case.plant
    path = paths.nominal[0][: analysis.terminal.steps + 1]
    plotting.plot_vector_field(
        ax, **_sets(analysis), step=lambda x: plant.step(case.network, x), path=path, reach=paths.reach[1:]
    )


def _maximal_set(ax: "Axes", analysis: Analysis) -> None:
    assert analysis.maximal is not None  # of a case with two states
    plotting.plot_maximal(ax, analysis.case.system, analysis.safe, analysis.maximal)


def _in_space(axes: Any, analysis: Analysis) -> None:
    """Two panels of R^3: the sequence F_k in X, and the sequence R_k-bar with nominal trajectories."""
    left, right = axes
    plotting.draw_history(left, analysis.safe.history)
    plotting.draw_history(right, analysis.terminal.history, name=REACH)
    paths = analysis.trajectories.nominal
    plotting.draw_trajectories(
        right, paths, color=plotting.RED, linewidth=1.2, marker=".", markersize=4, label="nominal, $d = 0$"
    )
    for ax in axes:
        ax.legend(loc="lower center", bbox_to_anchor=(0.5, 0.84), ncols=4, frameon=False, fontsize="small")


def _in_planes(axes: Any, analysis: Analysis) -> None:
    """Projections of the sequence R_k-bar and of a nominal trajectory onto all pairs of coordinates."""
    paths = analysis.trajectories.nominal[0]
    plotting.plot_planes(axes, analysis.terminal.history, name=REACH, paths=paths)
    handles, labels = axes.flat[0].get_legend_handles_labels()
    axes.flat[0].figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), frameon=False)


FIGURES = {
    "figure1": Drawing(_figure1),
    "figure2": Drawing(_figure2),
    "figure3": Drawing(_figure3),
    "maximal_set": Drawing(_maximal_set),
    "three_tanks": Drawing(_in_space, (9.6, 4.8), (1, 2), 3),
    "four_tanks": Drawing(_in_planes, (9.6, 6.6), (2, 3)),
}
