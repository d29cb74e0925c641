"""The figures of the report: those of the paper, the maximal safe set, and the areas of the seed study."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .. import plotting
from .case_analysis import Analysis
from .case_studies import data_file
from .seed_study import load_rows

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SQUARE, WIDE = (6.4, 6.2), (6.4, 3.8)  # inches


def draw_figures(analyses: list[Analysis], folder: str | Path) -> None:
    """Draw the figures of all cases, which their definitions name, and the areas of the seed study.

    Parameters
    ----------
    analyses : list of Analysis
    folder : str or Path
        Gets each figure as SVG and as PNG.
    """
    _save(partial(_seed_areas, analyses=analyses), WIDE, Path(folder) / "seed_areas")
    for analysis in analyses:
        for name in analysis.case.definition.figures:
            _save(partial(FIGURES[name], analysis=analysis), SQUARE, Path(folder) / name)


def _save(draw: Callable[..., None], size: tuple[float, float], path: Path) -> None:
    figure, ax = plotting.new_figure(size)
    draw(ax)
    plotting.save_figure(figure, path.with_suffix(".svg"), bbox_inches="tight")
    plotting.save_figure(figure, path.with_suffix(".png"), dpi=150, bbox_inches="tight")


def _seed_areas(ax: "Axes", analyses: list[Analysis]) -> None:
    cases = [analysis.case for analysis in analyses]
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
    plotting.plot_maximal(ax, analysis.case.system, analysis.safe, analysis.maximal)


FIGURES: dict[str, Callable[..., None]] = {
    "figure1": _figure1,
    "figure2": _figure2,
    "figure3": _figure3,
    "maximal_set": _maximal_set,
}
