"""What is drawn has the right shape: read back from the artists."""

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import mireach as mr
from mireach import plotting
from mireach.studies.seed_study import SeedRow


@pytest.fixture
def ax():
    return Figure().add_subplot()


def test_polygon_is_drawn_with_its_vertices(ax):
    P = mr.Polytope.from_points([[0, 0], [2, 0], [0, 1]])
    drawn = plotting.draw_set(ax, P, **plotting.SAFE).get_xy()
    assert {tuple(np.round(corner, 9) + 0.0) for corner in drawn} == {(0, 0), (2, 0), (0, 1)}


def test_segments_and_points_are_drawn_too(ax):
    segment = plotting.draw_set(ax, mr.Polytope.box([0, 1], [3, 1]), **plotting.TERMINAL)
    assert sorted(segment.get_xdata()) == [0, 3] and segment.get_linestyle() == "-"
    point = plotting.draw_set(ax, mr.Polytope.box([2, 1], [2, 1]), edgecolor="k")
    assert (point.get_xdata(), point.get_ydata()) == ([2], [1]) and point.get_marker() == "."


@pytest.fixture
def solid_ax():
    return plotting.new_figure((3, 3), dimension=3)[1]


def octahedron(size=1.0):
    return mr.Polytope.from_points(size * np.vstack([np.eye(3), -np.eye(3)]))


def cube(size=1.0):
    return mr.Polytope.box([-size] * 3, [size] * 3)


FLAT = cube() & mr.Polytope([[1, 2, 3], [-1, -2, -3]], [0, 0])


def test_regions_that_depend_on_u_are_drawn_by_their_limits_of_x_alone(ax):
    lower = mr.Polytope([[1, 0, 0], [0, 0, 1]], [0, 0.5])
    upper = mr.Polytope([[1, 0, 0], [0, 0, -1]], [0, -0.5])
    right = mr.Polytope([[-1, 0, 0]], [0])
    modes = [mr.Mode(np.eye(2), [[1], [0]], [0, 0], region) for region in (lower, upper, right)]
    system = mr.PWASystem(modes, mr.Polytope.box([-1, -1], [1, 1]), mr.Polytope.box([-1], [1]))
    plotting.draw_regions(ax, system)
    spans = sorted((patch.get_xy()[:, 0].min(), patch.get_xy()[:, 0].max()) for patch in ax.patches)
    np.testing.assert_allclose(spans, [(-1, 0), (-1, 0), (0, 1)], atol=1e-12)


def test_history_spreads_its_panels_from_the_first_set_to_the_last():
    axes = Figure().subplots(1, 4)
    history = [mr.Polytope.box([-r, -r], [r, r]) for r in (5, 4, 3, 2, 1)]
    plotting.plot_history(axes, history)
    assert [ax.get_title() for ax in axes] == [rf"$\mathcal{{F}}_{{{k}}}$" for k in (0, 1, 3, 4)]
    assert [len(ax.patches) for ax in axes] == [1, 2, 4, 5]


def test_trajectories_get_one_label(ax):
    plotting.draw_trajectories(ax, np.zeros((3, 5, 2)), label="paths")
    assert len(ax.lines) == 3 and len(ax.get_legend_handles_labels()[1]) == 1
    plotting.draw_trajectories(ax, np.zeros((5, 2)), label="one")
    assert len(ax.lines) == 4


def test_regions_are_drawn_with_their_holes(ax):
    frame = mr.Region.of(mr.Polytope.box([0, 0], [3, 3])) - mr.Polytope.box([1, 1], [2, 2])
    plotting.draw_region(ax, frame, facecolor="black", edgecolor="none")
    ax.set(xlim=(0, 3), ylim=(0, 3), position=(0, 0, 1, 1))
    canvas = FigureCanvasAgg(ax.figure)
    canvas.draw()
    dark = np.asarray(canvas.buffer_rgba())[..., 0] < 128
    height, width = dark.shape
    assert dark[height // 6, width // 6] and not dark[height // 2, width // 2]
    assert len(plotting.draw_region(ax, mr.Region.of()).get_path()) == 0


def test_the_maximal_set_is_labelled_with_its_size_and_each_loss_with_its_step(ax):
    case = mr.case_study("double_integrator")
    safe, maximal = mr.safe_set(case.loop), mr.maximal_safe_set(case.loop, prove=False)
    plotting.plot_maximal(ax, case.system, safe, maximal)
    assert "5.9 times" in "".join(ax.get_legend_handles_labels()[1]) + "".join(
        text.get_text() for text in ax.get_legend().get_texts()
    )
    other = Figure().add_subplot()
    plotting.plot_lost(other, maximal.history, case.system.state_set)
    assert other.get_legend_handles_labels()[1][:2] == ["lost at $k = 1$", "lost at $k = 2$"]
    assert len(other.patches) == maximal.iterations + 1


def test_areas_of_a_study_are_drawn_as_shares_of_x(ax):
    row = SeedRow(0, 0.1, 10, "proven", 1, safe_area=2.0, maximal_area=3.0)
    plotting.plot_areas(ax, {"pwa": [row], "double_integrator": [row]}, {"pwa": 4.0, "double_integrator": 8.0})
    drawn = [marks.get_offsets()[:, 0].tolist() for marks in ax.collections]
    assert drawn == [[0.5], [0.75], [0.25], [0.375]]
    none = Figure().add_subplot()
    plotting.plot_areas(none, {"pwa": [row, SeedRow(1, 0.1, 10, "refuted", 1, maximal_area=1.0)]}, {"pwa": 4.0})
    labels = [label.get_text() for label in none.get_yticklabels()]
    assert labels[0].endswith(": 1 of 2") and labels[1].endswith("maximal set: 2 of 2")


def test_growth_leaves_out_what_a_time_limit_stopped():
    axes = Figure().subplots(1, 3)
    networks = [("ReLU", 16, 100, 0.1, 0.01, 1.0), ("ReLU", 64, 1000, 1.0, 0.1, np.inf), ("maxout", 9, 50, 1, 1, 1)]
    plotting.plot_growth(axes, networks, [("pwa", 1, 0.1, 1.0), ("pwa", 2, 0.2, np.inf)])
    assert [line.get_label() for line in axes[0].lines] == ["ReLU", "maxout"]
    milp = {line.get_label(): line.get_ydata() for line in (*axes[1].lines, *axes[2].lines)}
    assert np.isnan(milp["MILP"]).tolist() == [False, True, False]
    assert np.isnan(milp["pwa, MILP"]).tolist() == [False, True]


@pytest.mark.parametrize(
    "P, count, hidden",
    [(cube(), (6, 12), 3), (octahedron(), (8, 12), 4), (FLAT, (1, 4), 0)],
    ids=["cube", "octahedron", "flat"],
)
def test_solids_are_drawn_with_their_faces_and_edges(solid_ax, P, count, hidden):
    plotting.draw_set(solid_ax, P, **plotting.SAFE, label="set")
    plotting.label_axes(solid_ax, P, "title")
    solid_ax.figure.draw_without_rendering()
    solid, lines = solid_ax.collections
    assert (len(solid.get_facecolor()), len(lines.get_segments())) == count
    assert sum(lines.hidden()) == hidden
    assert [solid_ax.get_xlabel(), solid_ax.get_ylabel(), solid_ax.get_zlabel()] == ["$x_1$", "$x_2$", "$x_3$"]
    assert solid_ax.get_legend_handles_labels()[1] == ["set"]


@pytest.mark.parametrize("mirrored", [False, True])
def test_hidden_edges_of_a_box_meet_in_the_corner_that_is_farthest_from_the_reader(solid_ax, mirrored):
    P = mr.Polytope.box([0, 0, 0], [1, 20, 300])
    plotting.draw_set(solid_ax, P, **plotting.SEQUENCE)
    solid_ax.set(xlim=(0, 1), ylim=(20, 0) if mirrored else (0, 20), zlim=(0, 300))
    lines = solid_ax.collections[1]
    for elevation, azimuth in np.random.default_rng(0).uniform((-80, -180), (80, 180), (20, 2)):
        solid_ax.view_init(elevation, azimuth)
        e, a = np.radians((elevation, azimuth))
        toward = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a) * (-1 if mirrored else 1), np.sin(e)])
        far = int(np.argmin(lines.corners @ (toward / [1, 20, 300])))
        if np.abs(toward).min() > 0.3:  # in perspective, fewer faces are seen of a box that is seen from its side
            assert {pair for pair, one in zip(lines.pairs, lines.hidden()) if one} == {
                pair for pair in lines.pairs if far in pair
            }


def test_flat_sets_of_space_are_drawn_as_lines_and_dots_and_others_refused(ax, solid_ax):
    segment = plotting.draw_set(solid_ax, mr.Polytope.box([0, 1, 2], [3, 1, 2]), edgecolor="k")
    assert sorted(segment.get_data_3d()[0]) == [0, 3]
    point = plotting.draw_set(solid_ax, mr.Polytope.box([0, 1, 2], [0, 1, 2]))
    assert np.ravel(point.get_data_3d()).tolist() == [0, 1, 2] and point.get_marker() == "."
    for axes, P in ((ax, cube()), (solid_ax, mr.Polytope.box([0, 0], [1, 1])), (ax, mr.Polytope.box([0] * 4, [1] * 4))):
        with pytest.raises(ValueError, match="plot_planes"):
            plotting.draw_set(axes, P)


def test_histories_of_space_are_outlines_but_for_the_last(solid_ax):
    loop = mr.case_study("three_tanks").loop
    history = mr.safe_set(loop, engine="cells").history
    plotting.draw_history(solid_ax, history)
    names = solid_ax.get_legend_handles_labels()[1]
    assert names[0] == r"$\mathcal{F}_{0}$" and names[-1] == rf"$\mathcal{{F}}_{{{len(history) - 1}}}$"
    assert len(names) <= plotting.SHOWN
    plotting.draw_trajectories(solid_ax, loop.simulate(np.zeros(3), 5), marker=".", label="one")
    solid_ax.figure.draw_without_rendering()
    opacity = [solid.get_facecolor()[0, 3] for solid in solid_ax.collections[::2]]
    assert opacity[:-1] == [0] * (len(names) - 1) and 0 < opacity[-1] < 1
    assert len(solid_ax.lines) == 1
    np.testing.assert_allclose(np.ptp(solid_ax.get_zlim()), 1.08 * 20)
    panels = Figure().subplots(1, 2, subplot_kw={"projection": "3d"})
    plotting.plot_history(panels, history[:3])
    assert [len(panel.collections) for panel in panels] == [2, 6]


def test_planes_show_projections_or_sections_with_the_coordinates_that_they_fix():
    history = [octahedron(3), octahedron(2), octahedron()]
    axes, path = Figure().subplots(2, 2), np.arange(12.0).reshape(4, 3)
    plotting.plot_planes(axes, history, paths=path)
    assert [len(ax.patches) for ax in axes.flat] == [3, 3, 3, 0] and not axes[1, 1].axison
    assert np.ptp(axes[0, 1].patches[0].get_xy(), axis=0).tolist() == pytest.approx([6, 6])
    assert np.array_equal(axes[0, 1].lines[0].get_xydata(), path[:, [0, 2]])
    ax = Figure().add_subplot()
    plotting.plot_planes(ax, history, [(2, 0)], at=[0, 1.5, 0])
    assert (ax.get_xlabel(), ax.get_ylabel(), ax.get_title()) == ("$x_3$", "$x_1$", "$x_2 = 1.5$")
    widths = [np.ptp(patch.get_xy()[:, 0]) for patch in ax.patches]
    assert widths == pytest.approx([3, 1])  # the last set has no point with x_2 = 1.5
    assert ax.get_legend_handles_labels()[1] == [r"$\mathcal{F}_{0}$", r"$\mathcal{F}_{1}$"]


def test_histories_without_a_set_to_draw_are_refused_and_empty_sets_left_out():
    empty, box = mr.Polytope([[1.0, 0], [-1, 0]], [-1, -1]), mr.Polytope.box([0, 0], [1, 1])
    _, ax = plotting.new_figure((3, 3))
    for history in ([], [empty]):
        with pytest.raises(ValueError, match="empty"):
            plotting.draw_history(ax, history)
        with pytest.raises(ValueError, match="empty"):
            plotting.plot_planes([ax], history)
    plotting.draw_history(ax, [empty, box])
    assert ax.get_xlim()[1] >= 1
