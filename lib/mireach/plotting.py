"""Figures: sets and trajectories in two and three dimensions, and Figures 1 to 3 of [Teichrib2025].

`plot_planes` shows sets of more dimensions in planes of two coordinates.

Colours are from the Okabe-Ito palette, and every kind of set also differs by line style or hatch, so that
figures can be read in grey.
"""

import io
import os
from collections.abc import Callable, Mapping, Sequence
from itertools import combinations, pairwise
from os import PathLike
from pathlib import PurePath
from typing import Any

import numpy as np

from .analysis.maximal_set import MaximalSafeSet
from .analysis.safe_set import SafeSet
from .analysis.terminal_set import TerminalSet
from .errors import MissingExtraError
from .files import write_whole
from .sets.faces import Ring, edges, rings
from .sets.polytope import Polytope
from .sets.region import Region
from .systems.pwa import PWASystem
from .typing import Array, ArrayLike

try:
    from matplotlib import rc_context
    from matplotlib.axes import Axes
    from matplotlib.cm import cividis
    from matplotlib.colors import to_rgba
    from matplotlib.container import BarContainer
    from matplotlib.figure import Figure
    from matplotlib.patches import PathPatch, Polygon, Rectangle
    from matplotlib.path import Path
    from matplotlib.ticker import MaxNLocator
    from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
    from mpl_toolkits.mplot3d.proj3d import proj_transform
except ImportError as missing:
    raise MissingExtraError("a figure", "matplotlib", "plot") from missing

GREEN = "#009E73"
BLUE = "#0072B2"
RED = "#D55E00"
BLACK = "#000000"
GREY = "#9A9A9A"
ORANGE = "#E69F00"
PURPLE = "#CC79A7"
Style = dict[str, Any]  # options of a matplotlib artist
SAFE: Style = {"facecolor": "#009E7333", "edgecolor": GREEN, "linewidth": 1.8}
TERMINAL: Style = {"facecolor": "#0072B280", "edgecolor": BLUE, "linewidth": 1.5, "hatch": "////"}
EARLIER: Style = {"facecolor": "none", "edgecolor": GREEN, "linewidth": 0.7, "linestyle": (0, (5, 3))}
SEQUENCE: Style = {"facecolor": "none", "edgecolor": BLACK, "linewidth": 0.7}
REGION: Style = {"facecolor": "none", "edgecolor": GREY, "linewidth": 2.2, "zorder": 0.5}
MAXIMAL: Style = {"facecolor": "#0072B22E", "edgecolor": BLUE, "linewidth": 1.8}
HIDDEN: Style = {"linestyle": (0, (1, 2)), "linewidth": 0.8}  # edges of a solid behind its faces
VIEW: Style = {"elev": 20, "azim": -66}  # degrees; the three faces of a box that are seen differ in size
ZOOM = 0.8  # of axes of R^3, which leaves room for their labels
SHOWN = 6  # sets of a history in one picture: as many outlines as can be told apart
LONGEST = 4  # ratio of the sides of a box up to which three axes get equal scales
ARROWS = 34  # grid points per axis of a vector field
GOLDEN = 0.618034  # multiples of it, less whole numbers, spread evenly: jitter that is the same every time


def draw_set(ax: Axes, P: Polytope, **style: Any) -> Any:
    """Draw a bounded Polytope of the plane or of R^3.

    Parameters
    ----------
    ax : matplotlib Axes
        For a set of R^3 with projection="3d"; its artists are then drawn in the order in which they were added.
    P : Polytope
        A point is drawn as a dot, a segment as a line, the empty set not at all.
    **style
        Of matplotlib.patches.Polygon, such as the module's SAFE, TERMINAL and SEQUENCE; label included. In R^3
        there are no hatches, and edges behind the faces are dotted.

    Returns
    -------
    matplotlib artist

    Raises
    ------
    ValueError
        If P is unbounded, or lies in another space than the axes.

    See Also
    --------
    plot_planes : sets of more dimensions.

    Examples
    --------
    >>> figure, ax = new_figure((3, 3))
    >>> patch = draw_set(ax, Polytope.box([0, 0], [1, 1]), **SAFE)
    >>> len(ax.patches)
    1
    """
    if P.dimension != (3 if ax.name == "3d" else 2):
        raise ValueError(f"these axes do not show sets of R^{P.dimension}; see new_figure(dimension=3) and plot_planes")
    if P.dimension == 3:
        corners, faces = rings(P)
        if faces:
            return _draw_solid(ax, corners, faces, style)
    else:
        corners = P.vertices()
    if len(corners) > 2:
        return ax.add_patch(Polygon(corners, closed=True, **style))
    colour, label = style.get("edgecolor", BLACK), style.get("label")
    line = {"marker": ".", "linestyle": ""} if len(corners) == 1 else {"linestyle": style.get("linestyle", "-")}
    shown = label if len(corners) else None  # what is not drawn is not in the legend
    return ax.plot(*corners.T, **line, color=colour, linewidth=style.get("linewidth"), label=shown)[0]


def draw_region(ax: Axes, region: Region, **style: Any) -> Any:
    """Draw the polygons of a Region, holes left open; its segments and points are not shown.

    Parameters
    ----------
    ax : matplotlib Axes
    region : Region
    **style
        Of matplotlib.patches.PathPatch, such as the module's MAXIMAL; label included.

    Returns
    -------
    matplotlib artist

    Examples
    --------
    >>> figure, ax = new_figure((3, 3))
    >>> patch = draw_region(ax, Region.of(Polytope.box([0, 0], [1, 1])), **MAXIMAL)
    >>> len(ax.patches)
    1
    """
    paths = [Path(ring, closed=True) for ring in region.rings()]
    return ax.add_patch(PathPatch(Path.make_compound_path(*paths) if paths else Path(np.zeros((0, 2))), **style))


def draw_regions(ax: Axes, system: PWASystem) -> None:
    """Thick grey outlines of the mode regions, as far as they do not depend on u."""
    for region in system.state_regions():
        draw_set(ax, region, **REGION)


def draw_trajectories(ax: Axes, trajectories: Array, **style: Any) -> None:
    """Draw one trajectory (steps + 1, n) or several (N, steps + 1, n), n = 2 or 3, as lines; a label is given once."""
    label = style.pop("label", None)
    for i, path in enumerate(trajectories if trajectories.ndim == 3 else trajectories[None]):
        ax.plot(*path.T, label=label if i == 0 else None, **style)


def label_axes(ax: Any, P: Polytope, title: str | None = None) -> None:
    """Axis labels with the paper's symbols, equal scales, and limits that show the Polytope P with a small margin.

    Axes of R^3 get equal scales unless the longest side of the bounding box is more than LONGEST times the shortest.
    They are seen from VIEW, and have no grid, whose lines could be taken for edges.
    """
    lower, upper = P.bounding_box()
    size = upper - lower
    margin = 0.04 * np.where(size > 0, size, size.max() or 1)
    limits = np.column_stack([lower - margin, upper + margin])
    for i, axis in enumerate("xyz"[: P.dimension]):
        ax.set(**{f"{axis}lim": limits[i], f"{axis}label": f"$x_{i + 1}$"})
    if P.dimension == 3:
        size += 2 * margin
        ax.set_box_aspect(size if size.max() <= LONGEST * size.min() else None, zoom=ZOOM)
        ax.set_proj_type("ortho")
        ax.view_init(**VIEW)
        ax.grid(False)
        ax.tick_params(labelsize="small")
        for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
            axis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
    else:
        ax.set_aspect("equal")
    if title:
        ax.set_title(title)


def legend_above(ax: Axes, columns: int) -> None:
    """A legend over the axes, where it hides nothing."""
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=columns, frameon=False, fontsize="small")


def new_figure(
    size: tuple[float, float], dpi: float | None = None, dimension: int = 2, panels: tuple[int, int] = (1, 1)
) -> tuple[Figure, Any]:
    """A figure of `size` inches that no window shows, and its Axes of the plane or of R^3: an array for more panels."""
    figure = Figure(figsize=size, dpi=dpi, layout="constrained")
    return figure, figure.subplots(*panels, subplot_kw={"projection": "3d"} if dimension == 3 else None)


def save_svg(figure: Figure, file: Any, **options: Any) -> None:
    """Write a figure as SVG to an open file; the same figure gives the same content."""
    with rc_context({"svg.hashsalt": "mireach"}):
        figure.savefig(file, format="svg", metadata={"Date": None}, **options)


def save_figure(figure: Figure, path: str | PathLike[str], **options: Any) -> None:
    """Write a figure to a file, whole or not at all; what `path` ends in, such as .svg or .png, is the format.

    Parameters
    ----------
    figure : matplotlib Figure
    path : str or pathlib.Path
    **options
        Of `Figure.savefig`.
    """
    kind, content = PurePath(path).suffix[1:], io.BytesIO()
    if kind == "svg":
        save_svg(figure, content, **options)
    else:
        figure.savefig(content, format=kind, **options)
    write_whole(os.fspath(path), content.getvalue())


def plot_sequence(ax: Axes, system: PWASystem, safe: SafeSet, terminal: TerminalSet) -> None:
    """Figure 1: F_max in green, the shrinking R_k-bar(F_max) as black outlines, the terminal set in blue."""
    zoom = ax.inset_axes((0.635, 0.055, 0.27, 0.27))
    for panel in (ax, zoom):
        draw_set(panel, _set_of(safe), **SAFE, label=r"$\mathcal{F}_{\max}$")
        for k, R in enumerate(terminal.history[1:-1], start=1):
            label = rf"$\overline{{\mathcal{{R}}}}_k,\ k = 1, \dots, {terminal.steps - 1}$" if k == 1 else None
            draw_set(panel, R, **SEQUENCE, label=label)
        label = rf"$\overline{{\mathcal{{R}}}}_{{\min}}$ ($k = {terminal.steps}$)"
        draw_set(panel, terminal.set, **TERMINAL, label=label)
    label_axes(ax, system.state_set)
    label_axes(zoom, terminal.set.scale(1.6, terminal.set.chebyshev()[0]))
    zoom.set(xticks=[], yticks=[], xlabel="", ylabel="")
    ax.indicate_inset_zoom(zoom, edgecolor=GREY)
    legend_above(ax, 3)


def plot_tubes(
    ax: Axes,
    system: PWASystem,
    safe: SafeSet,
    terminal: TerminalSet,
    tubes: Sequence[Array],
    nominal: Sequence[Array] | Array,
) -> None:
    """Figure 2: disturbed trajectories from two states, the nominal ones, F_max, terminal set and regions.

    Parameters
    ----------
    tubes : two arrays (N, steps + 1, 2)
    nominal : two arrays (steps + 1, 2)
    """
    draw_regions(ax, system)
    draw_set(ax, _set_of(safe), **{**SAFE, "facecolor": "none"}, label=r"$\mathcal{F}_{\max}$")
    for tube, colour, style in zip(tubes, (GREEN, BLUE), ("-", "--")):
        start = ", ".join(f"{value:.2f}".rstrip("0").rstrip(".") for value in tube[0, 0])
        label = f"{len(tube)} disturbed from ({start})"
        draw_trajectories(ax, tube, color=colour, linewidth=0.6, linestyle=style, alpha=0.55, label=label)
    for path, label in zip(nominal, ("nominal, $d = 0$", None)):
        ax.plot(*path.T, color=BLACK, linewidth=1.6, marker=".", markersize=4, label=label, zorder=4)
    draw_set(
        ax,
        terminal.set,
        facecolor="none",
        edgecolor=RED,
        linewidth=1.8,
        zorder=5,
        label=r"$\overline{\mathcal{R}}_{\min}$",
    )
    label_axes(ax, system.state_set)
    legend_above(ax, 3)


def plot_vector_field(
    ax: Axes,
    system: PWASystem,
    safe: SafeSet,
    terminal: TerminalSet,
    step: Callable[[Array], Array],
    path: Array,
    reach: Sequence[Polytope],
    *,
    arrows: int = ARROWS,
) -> None:
    """Figure 3: the loop's vector field in F_max, one trajectory, and the reachable sets around its states.

    Parameters
    ----------
    step : callable
        (N, 2) -> (N, 2), the loop of the nonlinear plant.
    path : array (k + 1, 2)
        The trajectory of the plant.
    reach : list of Polytope
        R_i-bar of its first state, i = 1, ..., k.
    arrows : int
        Per axis of the box around F_max.
    """
    draw_regions(ax, system)
    F = _set_of(safe)
    draw_set(ax, F, **SAFE, label=r"$\mathcal{F}_{\max}$")
    lower, upper = F.bounding_box()
    grid = np.stack(np.meshgrid(*np.linspace(lower, upper, arrows).T), axis=-1).reshape(-1, 2)
    grid = grid[F.contains(grid)]
    move = step(grid) - grid
    ax.quiver(*grid.T, *move.T, color="#777777", angles="xy", scale_units="xy", scale=4, width=0.002, zorder=1.5)
    draw_set(ax, terminal.set, **TERMINAL, label=r"$\overline{\mathcal{R}}_{\min}$", zorder=2)
    for i, R in enumerate(reach):
        label = r"$\overline{\mathcal{R}}_i(\{x(0)\})$" if i == 0 else None
        draw_set(ax, R, facecolor="none", edgecolor=BLACK, linewidth=1.0, zorder=3, label=label)
    ax.plot(*path.T, color=RED, linewidth=1.5, marker="o", markersize=3, zorder=4, label="trajectory of the plant")
    label_axes(ax, F)
    legend_above(ax, 4)


def plot_maximal(ax: Axes, system: PWASystem, safe: SafeSet, maximal: MaximalSafeSet) -> None:
    """F_max inside the maximal safe set inside X, with their areas; what is dotted can be driven out of X.

    Parameters
    ----------
    safe : SafeSet
    maximal : MaximalSafeSet
        With a set.
    """
    X = Region.of(system.state_set)
    S = _set_of(maximal)
    F = _set_of(safe)
    label = r"lost: can be driven out of $\mathcal{X}$"
    draw_region(ax, X - S, facecolor="#F2F2F2", edgecolor=GREY, linewidth=0, hatch="....", label=label)
    label = f"maximal safe set, {S.area / Region.of(F).area:.1f} times as large"
    draw_region(ax, S, **MAXIMAL, label=label)
    own = {**SAFE, "facecolor": "#009E7380", "hatch": "////"}
    draw_set(ax, F, **own, label=r"the paper's $\mathcal{F}_{\max}$")
    draw_region(ax, X, facecolor="none", edgecolor=BLACK, linewidth=1.2)
    label_axes(ax, system.state_set)
    legend_above(ax, 3)


def plot_lost(ax: Axes, history: Sequence[Region], state_set: Polytope) -> None:
    """Which states are lost at which step of S_0, S_1, ...: darker is later, white with a blue edge is what stays.

    Parameters
    ----------
    history : list of Region
        Such as `MaximalSafeSet.history`.
    state_set : Polytope
    """
    steps = len(history) - 1
    for k, (before, after) in enumerate(pairwise(history), start=1):
        shade = cividis(1 - k / (steps + 1))
        draw_region(ax, before - after, facecolor=shade, edgecolor="white", linewidth=0.4, label=f"lost at $k = {k}$")
    draw_region(ax, history[-1], facecolor="none", edgecolor=BLUE, linewidth=1.8, label=rf"$\mathcal{{S}}_{{{steps}}}$")
    label_axes(ax, state_set)


def plot_areas(ax: Axes, studies: Mapping[str, Sequence[Any]], sizes: Mapping[str, float]) -> None:
    """Areas of F_max and of the maximal safe set, one mark per network of a seed study, a row of marks for each.

    Parameters
    ----------
    studies : dict of str to list of SeedRow
        By the name of the case.
    sizes : dict of str to float
        Areas of X, by which the areas are divided.
    """
    marks = (("safe_area", r"$\mathcal{F}_{\max}$", "^", GREEN), ("maximal_area", "maximal set", "o", BLUE))
    ticks: list[str] = []
    for name, rows in studies.items():
        for field, what, marker, colour in marks:
            place = -len(ticks)
            areas = np.array([getattr(row, field) for row in rows]) / sizes[name]
            spread = place + 0.5 * (np.array([row.seed for row in rows]) * GOLDEN % 1 - 0.5)
            found = areas > 0
            ax.scatter(areas[found], spread[found], s=16, marker=marker, color=colour, edgecolors=BLACK, linewidths=0.3)
            ticks.append(f"{name.replace('_', ' ')}\n{what}: {found.sum()} of {len(rows)}")
    ax.set(xlim=(0, 1.02), xlabel=r"area, share of $\mathcal{X}$ (one mark for each network that has the set)")
    ax.set_yticks(-np.arange(len(ticks)), ticks)
    ax.set_ylim(0.5 - len(ticks), 0.5)
    ax.grid(axis="x", color="#DDDDDD")
    ax.set_axisbelow(True)


def plot_growth(axes: Sequence[Axes], networks: Sequence[Any], steps: Sequence[Any]) -> None:
    """How cells and seconds grow with the network, and seconds with the number of steps.

    Parameters
    ----------
    axes : three matplotlib Axes
    networks : list of (kind, neurons, cells, seconds to build, seconds of one step, seconds of the MILP)
        inf seconds are left out.
    steps : list of (case, k, seconds by cells, seconds by the MILP)
    """
    first, second, third = axes
    for kind, style in (("ReLU", {"color": BLUE, "marker": "o"}), ("maxout", {"color": RED, "marker": "s"})):
        rows = [row for row in networks if row[0] == kind]
        first.loglog([row[1] for row in rows], [row[2] for row in rows], linestyle="none", label=kind, **style)
    first.set(xlabel="neurons", ylabel="cells")
    count = [row[2] for row in networks]
    parts = (("building the cells", 3, GREEN, "o"), ("one step, 8 directions", 4, BLUE, "v"), ("MILP", 5, RED, "x"))
    for label, column, colour, marker in parts:
        values = [row[column] if np.isfinite(row[column]) else np.nan for row in networks]
        second.loglog(count, values, linestyle="none", color=colour, marker=marker, label=label)
    second.set(xlabel="cells", ylabel="seconds")
    for case, line in zip(dict.fromkeys(row[0] for row in steps), ("-", "--")):
        rows = [row for row in steps if row[0] == case]
        k = [row[1] for row in rows]
        for label, column, colour, marker in (("cells", 2, BLUE, "v"), ("MILP", 3, RED, "x")):
            values = [row[column] if np.isfinite(row[column]) else np.nan for row in rows]
            third.semilogy(k, values, color=colour, marker=marker, linestyle=line, label=f"{case}, {label}")
    third.set(xlabel="steps $k$", ylabel="seconds of one direction")
    third.xaxis.set_major_locator(MaxNLocator(integer=True))
    for ax in axes:
        ax.legend(fontsize="x-small", handlelength=3 if ax is third else None)  # long enough to show dashes


def plot_history(
    axes: Any, history: Sequence[Polytope], chosen: Sequence[int] | None = None, name: str = r"\mathcal{F}"
) -> None:
    r"""Small multiples of a sequence of sets: each panel one set over its predecessors, for readers without a kernel.

    Parameters
    ----------
    axes : array of matplotlib Axes
        As many panels as are shown.
    history : list of Polytope
    chosen : sequence of int or None
        The steps shown; None spreads them evenly from the first to the last.
    name : str
        Of the sets, in mathtext.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> axes = Figure().subplots(1, 2)
    >>> plot_history(axes, [Polytope.box([-r, -r], [r, r]) for r in (3, 2, 1)])
    >>> [ax.get_title() for ax in axes]
    ['$\\mathcal{F}_{0}$', '$\\mathcal{F}_{2}$']
    """
    axes = np.ravel(axes)
    if chosen is None:
        chosen = _spread(history, len(axes))
    for ax, k in zip(axes, chosen):
        plot_step(ax, history, int(k), name)
    for ax in axes[len(chosen) :]:
        ax.set_axis_off()


def plot_step(ax: Axes, history: Sequence[Polytope], k: int, name: str = r"\mathcal{F}") -> None:
    """Set k of a sequence in blue, its predecessors as thin outlines; the view stays that of the first set."""
    for before in history[:k]:
        draw_set(ax, before, **{**SEQUENCE, "edgecolor": GREY})
    draw_set(ax, history[k], **TERMINAL)
    label_axes(ax, history[0], rf"${name}_{{{k}}}$")


def draw_history(
    ax: Axes, history: Sequence[Polytope], chosen: Sequence[int] | None = None, name: str = r"\mathcal{F}"
) -> None:
    r"""A sequence of sets of the plane or of R^3 in one picture: outlines, darker is later, the last one filled.

    Parameters
    ----------
    ax : matplotlib Axes
        For sets of R^3 with projection="3d".
    history : list of Polytope
        The axes show what lies around the first of those that are chosen.
    chosen : sequence of int or None
        The steps shown, each with a label; None takes up to SHOWN from the first to the last, more of the early
        ones, since sets that converge differ most there.
    name : str
        Of the sets, in mathtext.

    Raises
    ------
    ValueError
        If there is no set, or none that is not empty. Empty ones among others are left out.

    See Also
    --------
    plot_history : one panel per set. plot_planes : sets of more dimensions.

    Examples
    --------
    >>> figure, ax = new_figure((4, 4), dimension=3)
    >>> draw_history(ax, [Polytope.box([-r, -r, -r], [r, r, r]) for r in (3, 2, 1)])
    >>> ax.get_legend_handles_labels()[1]
    ['$\\mathcal{F}_{0}$', '$\\mathcal{F}_{1}$', '$\\mathcal{F}_{2}$']
    """
    chosen = _steps(history, chosen)
    _draw_nested(ax, {k: history[k] for k in chosen}, name)
    label_axes(ax, history[chosen[0]])


def plot_planes(
    axes: Any,
    history: Sequence[Polytope],
    pairs: Sequence[tuple[int, int]] | None = None,
    *,
    at: ArrayLike | None = None,
    chosen: Sequence[int] | None = None,
    name: str = r"\mathcal{F}",
    paths: Array | None = None,
) -> None:
    r"""A sequence of sets of R^n in planes of two coordinates, one per panel: projections, or sections through a point.

    Parameters
    ----------
    axes : array of matplotlib Axes
        As many panels as are shown.
    history : list of Polytope
    pairs : sequence of (int, int) or None
        Coordinates of each panel, counted from 0; None takes all pairs i < j, in order.
    at : array (n,), number, or None
        None draws projections; otherwise the point through which the sections go. Empty ones are left out.
    chosen, name
        As in `draw_history`.
    paths : array (steps + 1, n) or (N, steps + 1, n), optional
        Trajectories, projected.

    Raises
    ------
    ValueError
        As `draw_history`.

    See Also
    --------
    Polytope.project, Polytope.section : the sets that are drawn.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> axes = Figure().subplots(1, 3)
    >>> plot_planes(axes, [Polytope.box([-r, -r, -r], [r, r, r]) for r in (3, 2, 1)])
    >>> [(ax.get_xlabel(), ax.get_ylabel()) for ax in axes]
    [('$x_1$', '$x_2$'), ('$x_1$', '$x_3$'), ('$x_2$', '$x_3$')]

    Notes
    -----
    Coordinates may have different units, so each axis has its own scale. A state outside of a projection lies outside
    of the set; one inside of all projections may still lie outside. A section holds only states with the other
    coordinates of `at`; trajectories are not confined to it.
    """
    chosen = _steps(history, chosen)
    axes, n = np.ravel(axes), history[0].dimension
    pairs = [*(combinations(range(n), 2) if pairs is None else pairs)]
    for ax, pair in zip(axes, pairs):
        sets = {k: history[k].project(pair) if at is None else history[k].section(pair, at) for k in chosen}
        _draw_nested(ax, sets, name)
        if paths is not None:
            draw_trajectories(
                ax, paths[..., pair], color=BLACK, linewidth=1, marker=".", markersize=4, label="trajectory"
            )
        label_axes(ax, history[chosen[0]].project(pair))
        ax.set(xlabel=f"$x_{pair[0] + 1}$", ylabel=f"$x_{pair[1] + 1}$", aspect="auto", box_aspect=1)
        if at is not None:
            fixed = [f"$x_{j + 1} = {value:.4g}$" for j, value in enumerate(np.broadcast_to(at, n)) if j not in pair]
            ax.set_title(", ".join(fixed), fontsize="small")
    for ax in axes[len(pairs) :]:
        ax.set_axis_off()


def plot_look(ax: Axes, look: Any, title: str | None = None, maximal: Region | None = None) -> None:
    """One look of the disturbance lab: all F_k and R_k-bar, F_max, terminal set, trajectories, or why there are none.

    For more than two states it is what the look's view shows of them, which the label of the first axis says.

    Parameters
    ----------
    ax : matplotlib Axes
    look : lab.Look
    title : str or None
    maximal : Region or None
        The maximal safe set, if it is to be shown as well.
    """
    view = look.view
    for region in look.regions:
        draw_set(ax, view.polygon(region), **REGION)
    if maximal is not None:
        draw_region(ax, maximal, **MAXIMAL, zorder=0.6, label="maximal safe set")
    safe, terminal = look.safe, look.terminal
    for k, F in enumerate(safe.history):
        draw_set(ax, view.polygon(F), **EARLIER, label=r"$\mathcal{F}_k$" if k == 0 else None)
    if safe.set:
        draw_set(ax, view.polygon(safe.set), **SAFE, label=r"$\mathcal{F}_{\max}$")
    draw_trajectories(
        ax, view.points(look.disturbed), color=BLUE, linewidth=0.5, alpha=0.6, label="disturbed", zorder=1.5
    )
    if terminal:
        for k, R in enumerate(terminal.history[1:-1]):
            draw_set(ax, view.polygon(R), **SEQUENCE, label=r"$\overline{\mathcal{R}}_k$" if k == 0 else None)
        name = r"$\overline{\mathcal{R}}_{\min}$" if terminal.criterion else r"last $\overline{\mathcal{R}}_k$"
        draw_set(ax, view.polygon(terminal.set), **TERMINAL, label=name, zorder=2)
    ax.plot(
        *view.points(look.nominal).T, color=BLACK, linewidth=1.2, marker=".", markersize=3, label="nominal", zorder=3
    )
    if look.plant is not None:
        ax.plot(
            *view.points(look.plant).T, color=PURPLE, linestyle="--", linewidth=1.6, label="the plant itself", zorder=3
        )
    if safe.witness is not None:
        path = view.points(safe.witness.states).T
        ax.plot(*path, color=RED, linewidth=2.2, label=r"a step that leaves $\mathcal{X}$", zorder=4)
        ax.plot(*path[:, :1], "o", color=RED, markersize=4, zorder=4)
        ax.plot(*path[:, 1:], "X", color=RED, markersize=6, zorder=4)
        ax.text(0.5, 0.98, r"no $\mathcal{F}_{\max}$ found", color=RED, ha="center", va="top", transform=ax.transAxes)
    shown = view.polygon(look.loop.system.state_set)
    if safe.witness is not None:
        shown = type(shown).from_points(np.vstack([shown.vertices(), view.points(safe.witness.states)]))
    label_axes(ax, shown.scale(1.12, shown.chebyshev()[0]), title)
    if view.title:
        right, up = view.names
        ax.set(xlabel=f"{right}\n{view.title}", ylabel=up)


def _set_of(result: Any) -> Any:
    """The set of a SafeSet or MaximalSafeSet; ValueError says why there is none to be drawn."""
    if result.set is None:
        raise ValueError(f"there is no set to draw: {result.reason}")
    return result.set


def _spread(history: Sequence[Any], most: int, power: int = 1) -> list[int]:
    """At most `most` steps of a history from the first to the last, the gaps growing with the power."""
    spread = np.linspace(0, 1, min(most, len(history))) ** power * (len(history) - 1)
    return [int(k) for k in np.unique(np.maximum(spread.round(), np.arange(len(spread))))]


def _steps(history: Sequence[Polytope], chosen: Sequence[int] | None) -> list[int]:
    """The chosen steps of a history, or up to SHOWN of them; those of empty sets are left out."""
    if not len(history):
        raise ValueError("history is empty; give at least one set")
    found = [k for k in (_spread(history, SHOWN, 2) if chosen is None else chosen) if not history[k].is_empty]
    if not found:
        raise ValueError("all sets to be drawn are empty")
    return found


def _draw_nested(ax: Axes, sets: Mapping[int, Polytope], name: str) -> None:
    """Draw sets by their step: the last one filled, the others as outlines, darker is later."""
    shades = np.linspace(0.75, 0.1, len(sets))
    for (k, P), shade in zip(sets.items(), shades):
        if not P.is_empty:
            outline = {"facecolor": "none", "edgecolor": cividis(shade), "linewidth": 1.1}
            draw_set(ax, P, **(TERMINAL if k == [*sets][-1] else outline), label=rf"${name}_{{{k}}}$")


def _draw_solid(ax: Any, corners: Array, faces: list[Ring], style: Style) -> Any:
    """Draw a Polytope of R^3 that has faces: these and its edges."""
    own = {"facecolor": "none", "edgecolor": BLACK, "linewidth": 1.0, "linestyle": "-", **style}
    zorder = {"zorder": own["zorder"]} if "zorder" in own else {}
    *colour, alpha = to_rgba(own["facecolor"])
    if len(faces) > 1:  # the reader looks through two faces, which together are as opaque
        alpha = 1 - np.sqrt(1 - alpha)
    solid = Poly3DCollection(
        [corners[[*ring]] for ring in faces], facecolor=(*colour, alpha), edgecolor="none", **zorder
    )
    ax.computed_zorder = False  # the order of the artists; that of their depths has no meaning for nested sets
    ax.add_collection3d(solid)
    ax.add_collection3d(Edges(corners, faces, own["edgecolor"], own["linewidth"], own["linestyle"], **zorder))
    if own.get("label"):  # as in the plane; two artists make the set, and neither alone shows in a legend what it is
        look = {key: own[key] for key in ("facecolor", "edgecolor", "linewidth", "linestyle")}
        ax.add_container(BarContainer([Rectangle((0, 0), 1, 1, **look)], label=own["label"]))
    return solid


class Edges(Line3DCollection):  # type: ignore[misc]  # mpl_toolkits has no types
    """The edges of a Polytope of R^3; those with all their faces turned away from the reader are dotted, in any view.

    Parameters
    ----------
    corners : array (v, 3)
    faces : list of tuple of int
        Both from `faces.rings`.
    colour, width, line
        Of an edge that is not hidden.
    **style
        Of matplotlib.collections.LineCollection.
    """

    def __init__(self, corners: Array, faces: list[Ring], colour: Any, width: float, line: Any, **style: Any) -> None:
        self.corners = corners
        self.faces = faces
        self.pairs = edges(faces)
        self.width, self.line = width, line
        super().__init__([corners[[*pair]] for pair in self.pairs], colors=[colour], **style)

    def do_3d_projection(self) -> float:
        """Project to the plane of the picture."""
        hidden = self.hidden()
        self.set_linestyle([HIDDEN["linestyle"] if one else self.line for one in hidden])
        self.set_linewidth([min(HIDDEN["linewidth"], self.width) if one else self.width for one in hidden])
        return float(super().do_3d_projection())

    def hidden(self) -> list[bool]:
        """Whether all faces beside an edge are turned away, in the present view of the axes, for each edge."""
        points = np.column_stack(proj_transform(*self.corners.T, self.axes.get_proj()))
        seen = {pair for face in self.faces if self._faces_reader(points, face) for pair in edges([face])}
        return [pair not in seen for pair in self.pairs]

    def _faces_reader(self, points: Array, face: Ring) -> bool:
        """Whether the outward normal of a face points to the reader, who looks along the third axis of `points`."""
        around = points[[*face]]
        normal = np.cross(around, np.roll(around, -1, axis=0)).sum(axis=0)
        outward = normal @ (around.mean(axis=0) - points.mean(axis=0))
        return len(self.faces) == 1 or normal[2] * outward <= 0
