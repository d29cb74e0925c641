"""The cells against brute force over all modes and winning channels, and against sampled trajectories."""

from fractions import Fraction

import numpy as np
import pytest
from fuzz import space_loop, space_sets
from loops import (
    affine_loop,
    assert_replays,
    brute_support,
    evaluate,
    exact_input,
    jump_loop,
    narrow_spike,
    random_images,
    random_loop,
)

from mireach import (
    CellLimitError,
    ClosedLoop,
    Layer,
    MaxoutNetwork,
    Mode,
    Polytope,
    PWASystem,
    box_directions,
    case_study,
    directions,
    exact_reach,
    safe_set,
)
from mireach.engines.cells import Cells, cells
from mireach.engines.exact import Exact
from mireach.systems.plants import chessboard
from mireach.tolerances import CORNER

V = np.vstack([directions(5), [[-5, 1]]])
SETS = {
    "X": Polytope.box([-9, -9], [9, 9]),
    "box": Polytope.box([-0.8, -1.1], [1.3, 0.4]),
    "triangle": Polytope.from_points([[-1.2, -0.7], [1.4, -0.2], [0.1, 1.3]]),
    "flat": Polytope.box([-1, 0.25], [1.5, 0.25]),
    "segment": Polytope.from_points([[-1.1, 0.7], [0.9, -0.6]]),
    "point": Polytope.box([0.3, -0.4], [0.3, -0.4]),
    "half-plane": Polytope([[1.0, 2.0]], [0.5]),
}
KINDS_OF_LOOPS = [
    {"cuts": 0, "width": 2, "pool": 3},
    {"cuts": 2},
    {"cuts": 3, "with_input": True},
    {"cuts": 2, "with_input": True, "m": 2, "saturated": True, "layers": 1},
]


def check(loop, F, found, expected, V=V, exact=1e-7):
    np.testing.assert_allclose(found.value, expected, rtol=0, atol=exact)
    assert (found.bound >= expected - 1e-9).all() and (found.bound >= found.value).all()
    for v, value, witness in zip(V, found.value, found.witness, strict=True):
        assert_replays(loop, F, v, value, witness)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", KINDS_OF_LOOPS, ids=lambda kind: ",".join(map(str, kind.values())))
def test_one_step_is_the_best_of_all_modes_and_channels(seed, kind):
    loop = random_loop(seed, **kind)
    for F in list(SETS.values())[seed % 2 :: 2]:
        check(loop, F, Cells().support(loop, F, V), brute_support(loop, F, V))


@pytest.mark.parametrize(("seed", "steps"), [(0, 2), (1, 2), (2, 2), (3, 2), (4, 3), (5, 3)])
def test_several_steps_are_the_best_of_all_sequences(seed, steps):
    loop = random_loop(seed, cuts=1, layers=1, width=1 + (steps == 2), with_input=seed % 2 == 1)
    for F in (SETS["X"], SETS["segment"], SETS["point"]):
        expected = brute_support(loop, F, V[:5], steps)
        found = Cells().support(loop, F, V[:5], steps)
        if np.isfinite(expected).all():
            check(loop, F, found, expected, V[:5])
        else:
            assert (found.bound == -np.inf).all() and found.witness == (None,) * 5


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("steps", [1, 2])
def test_no_sampled_trajectory_passes_the_bound(seed, steps):
    loop = random_loop(seed, cuts=3, with_input=seed % 2 == 0, layers=2, width=3, pool=3)
    rng = np.random.default_rng(seed)
    for F in (SETS["X"] & loop.system.state_set, SETS["triangle"]):
        images = random_images(loop, F, rng, 300, steps)
        found = Cells().support(loop, F, V, steps)
        assert len(images) == 0 or ((images @ V.T).max(axis=0) <= found.bound).all()


@pytest.mark.parametrize(("name", "steps"), [("pwa", 3), ("double_integrator", 2)])
def test_several_steps_of_a_case_study_agree_with_the_union_of_what_is_reached(name, steps):
    case = case_study(name)
    F = safe_set(case.loop, case.safe_directions).set
    region = exact_reach(case.loop, F, steps)[-1]  # found by GEOS, which merges what overlaps
    found = Cells().support(case.loop, F, case.directions, steps)
    np.testing.assert_allclose(found.value, (region.pieces.points @ case.directions.T).max(axis=0), atol=1e-7)
    assert (found.bound >= found.value).all() and (found.bound <= found.value + 1e-9).all()


def test_multi_step_equals_steps_of_one_for_an_affine_loop():
    A = np.array([[0.6, 0.5], [-0.4, 0.7]])
    D = Polytope.from_points([[0.1, 0.1], [-0.1, 0.2]])
    loop, F = affine_loop(A, D, limits=5.0), Polytope.box([-1, -1], [1, 0.5])
    expected, power = np.zeros(len(V)), np.eye(2)
    for _ in range(3):
        expected += D.support(V @ power)
        power = power @ A
    expected += F.support(V @ power)
    np.testing.assert_allclose(Cells().support(loop, F, V, 3).value, expected, atol=1e-9)


# -- where the map jumps ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "F",
    [
        Polytope.box([1, 0.5], [1, 0.5]),
        Polytope.box([1, -1], [1, 1]),
        Polytope.box([1, -1], [2, 1]),
        Polytope.box([0, -1], [1, 1]),
        Polytope([[1.0, 0], [-1.0, 0]], [1.0, -1.0]),
    ],
    ids=["point", "segment", "box to the right", "box to the left", "line"],
)
def test_both_values_count_on_a_shared_boundary(F):
    loop = jump_loop([2.0, -1.0], [-3.0, 1.5])
    found = Cells().support(loop, F, directions(4))
    np.testing.assert_allclose(found.value, [2, 1.5, 3, 1], atol=1e-12)
    assert [int(witness.modes[0]) for witness in found.witness] == [0, 1, 1, 0]
    for v, value, witness in zip(directions(4), found.value, found.witness):
        assert_replays(loop, F, v, value, witness)


@pytest.mark.parametrize("n", [1, 2])
def test_a_mode_counts_that_acts_on_a_line_or_a_point_only(n):
    """x+ = 0 for x1 <= 0 and for x1 >= 0, and x1+ = 3/4 where the first n coordinates are 0 (and U is all of it)."""
    rows, zero, column = np.eye(3)[:n], np.zeros((2, 2)), np.zeros((2, 1))
    regions = Polytope([[1.0, 0, 0]], [0.0]), Polytope([[-1.0, 0, 0]], [0.0])
    thin = Mode(zero, column, [0.75, 0], Polytope(np.vstack([rows, -rows]), np.zeros(2 * n)))
    modes = [*(Mode(zero, column, [0, 0], region) for region in regions), thin]
    system = PWASystem(modes, Polytope.box([-1, -1], [1, 1]), Polytope.box([-1], [1]))
    loop = ClosedLoop(system, MaxoutNetwork((), np.zeros((1, 2)), [0.0]))
    for F, reached in (([-1, -1], [1, 1]), 0.75), (([0, 0], [0.5, 0]), 0.75), (([0.1, -1], [1, 1]), 0.0):
        assert 0 <= Cells().support(loop, Polytope.box(*F), [[1.0, 0]]).bound[0] - reached <= 1e-9


def test_only_one_value_counts_off_the_boundary():
    loop = jump_loop([2.0, -1.0], [-3.0, 1.5])
    for x1, image in ((1 - 1e-6, [2, -1]), (1 + 1e-6, [-3, 1.5])):
        found = Cells().support(loop, Polytope.box([x1, 0], [x1, 0]), directions(4))
        np.testing.assert_allclose(found.value, directions(4) @ image, atol=1e-12)


def test_both_values_count_where_the_boundary_follows_the_input():
    """Regions u <= x2 and u >= x2 with Phi = max(x1, 0): they share the line x2 = max(x1, 0) only."""
    net = MaxoutNetwork([Layer([[1.0, 0], [0, 0]], [0, 0], 2)], [[1.0]], [0.0])
    zero, column = np.zeros((2, 2)), np.zeros((2, 1))
    modes = [
        Mode(zero, column, [1.0, 0], Polytope([[0, -1.0, 1]], [0.0])),
        Mode(zero, column, [0.0, 1], Polytope([[0, 1.0, -1]], [0.0])),
    ]
    loop = ClosedLoop(PWASystem(modes, Polytope.box([-2, -2], [2, 2]), Polytope.box([0], [2])), net)
    for x, both in (([0.5, 0.5], True), ([-1, 0], True), ([0, 0], True), ([0.5, 0.6], False), ([-1, 0.1], False)):
        found = Cells().support(loop, Polytope.box(x, x), [[1.0, 0], [0, 1.0]]).value
        assert found.tolist() == ([1, 1] if both else [1, 0])


def test_mode_specific_disturbances_count_where_their_mode_acts():
    sets = [Polytope.box([0, 0], [0.5, 0]), Polytope.box([0, 0.25], [0, 0.25])]
    loop = jump_loop([0, 0], [0, 0], sets)
    V = directions(4)
    assert Cells().support(loop, Polytope.box([0, 0], [0.5, 0.5]), V).value.tolist() == [0.5, 0, 0, 0]
    assert Cells().support(loop, Polytope.box([2, 0], [2, 0]), V).value.tolist() == [0, 0.25, 0, -0.25]
    assert Cells().support(loop, Polytope.box([1, 0], [1, 0]), V).value.tolist() == [0.5, 0.25, 0, 0]


def test_step_after_a_boundary_goes_on_from_both_values():
    loop = jump_loop([1.0, 1.0], [-2.0, 0.5])
    found = Cells().support(loop, Polytope.box([0, 0], [0, 0]), directions(4), steps=2)
    np.testing.assert_allclose(found.value, [1, 1, 2, -0.5], atol=1e-12)


def test_trajectories_that_leave_the_state_set_end_there():
    loop = jump_loop([9.0, 0.0], [0.5, 0.0])
    start = Polytope.box([0, 0], [2, 0])
    assert Cells().support(loop, start, [[1.0, 0]]).value.tolist() == [9]
    assert Cells().support(loop, start, [[1.0, 0]], steps=2).value.tolist() == [9]
    assert Cells().support(loop, Polytope.box([0, 0], [0.5, 0]), [[1.0, 0]], steps=2).bound.tolist() == [-np.inf]


# -- the cells themselves -----------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(6))
def test_cells_cover_the_state_set_with_the_right_piece(seed):
    loop = random_loop(seed, cuts=3, with_input=seed % 2 == 0, layers=2, width=3, pool=3)
    found = cells(loop)
    for x in loop.system.state_set.sample(np.random.default_rng(seed), 150):
        u = evaluate(loop.network, x)
        owners = [i for i in range(len(found)) if inside(found.polygons[i], x)]
        assert owners
        for i in owners:
            region = loop.system.modes[found.mode[i]].region
            assert (region.H @ np.concatenate([x, u]) <= region.h + 1e-8).all()
            np.testing.assert_allclose(found.K[i] @ x + found.g[i], u, atol=1e-8)


def inside(points, x):
    """Whether a polygon with an interior holds x; others are left out."""
    onward = np.roll(points, -1, axis=0) - points
    turns = onward[:, 0] * (x[1] - points[:, 1]) - onward[:, 1] * (x[0] - points[:, 0])
    size = np.abs(turns).max()
    return size > 1e-9 and ((turns >= -1e-12).all() or (turns <= 1e-12).all())


@pytest.mark.parametrize("seed", range(6))
def test_areas_of_the_cells_add_up_to_the_state_set(seed):
    loop = random_loop(seed, cuts=3, with_input=seed % 2 == 0, layers=2, width=3, pool=3)
    found, total = cells(loop).polygons, 0.0
    for i in range(len(found)):
        x, y = found[i].T
        total += abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2
    lower, upper = loop.system.state_set.bounding_box()
    assert total == pytest.approx(np.prod(upper - lower), rel=1e-9)


@pytest.mark.parametrize("gain", [0.6, 30.0, 1e4])
@pytest.mark.parametrize("layers", [2, 3])
@pytest.mark.parametrize("seed", range(3))
def test_error_of_a_cell_covers_the_exact_input(seed, layers, gain):
    """K x + g against Phi(x) in rational numbers, in the middle of every cell, at its corners and a cut beyond them."""
    loop = random_loop(seed, cuts=1, layers=layers, width=3, pool=3, saturated=True, gain=gain)
    found, net, rng = cells(loop), loop.network, np.random.default_rng(seed)
    for i in range(len(found)):
        corners = found.polygons[i]
        beyond = corners + found.size * CORNER * rng.choice([-1, 1], corners.shape)
        points = np.vstack([corners, beyond, corners.mean(axis=0)])
        K, g = ([[Fraction(value) for value in row] for row in part] for part in (found.K[i].tolist(), [found.g[i]]))
        for x in points.tolist():
            piece = [a * Fraction(x[0]) + b * Fraction(x[1]) + c for (a, b), c in zip(K, g[0])]
            for u, exactly, error in zip(piece, exact_input(net, x), found.error[i]):
                assert abs(u - exactly) <= error
    assert gain > 1 or found.error.max() <= 1e-12


@pytest.mark.parametrize(("seed", "widths"), [(0, (24, 24)), (1, (16, 16, 16))])
def test_cells_of_a_wide_relu_network_on_a_chessboard(seed, widths):
    rng, hidden, size = np.random.default_rng(seed), [], 2
    for width in widths:
        weight, bias = np.zeros((2 * width, size)), np.zeros(2 * width)
        weight[::2], bias[::2] = rng.normal(size=(width, size)) * np.sqrt(2 / size), rng.normal(size=width)
        hidden.append(Layer(weight, bias, 2))
        size = width
    net = MaxoutNetwork(hidden, rng.normal(size=(1, size)), [0.0]).saturate([-1.0], [1.0])
    X, U = Polytope.box([-3, -3], [3, 3]), Polytope.box([-1], [1])
    modes = [Mode(0.5 * np.eye(2), [[1.0], [0.5]], rng.normal(size=2), region) for region in chessboard(X, U)]
    loop = ClosedLoop(PWASystem(modes, X, U), net)
    found = cells(loop)
    assert len(found) > 500 and (np.diff(found.mode) >= 0).all()
    points, ends, reached = found.polygons.points, [], np.full(len(V), -np.inf)
    low, high = found.polygons.least(points), found.polygons.largest(points)
    for x in X.sample(rng, 300):
        u, near = evaluate(net, x), np.flatnonzero(((low <= x) & (x <= high)).all(axis=1))
        owners = [i for i in near if inside(found.polygons[i], x)]
        assert owners
        for i in owners:
            np.testing.assert_allclose(found.K[i] @ x + found.g[i], u, atol=1e-10)
            mode = modes[found.mode[i]]
            ends.append(mode.A @ x + mode.B @ u + mode.p)
    asked = Cells().support(loop, X, V)
    assert ((np.array(ends) @ V.T).max(axis=0) <= asked.bound).all()
    for mode in modes:  # the largest value is attained at a corner of a cell
        x = points[mode.region.contains(np.hstack([points, np.zeros((len(points), 1))]), tol=1e-9)]
        images = x @ mode.A.T + net(x) @ mode.B.T + mode.p
        reached = np.maximum(reached, (images @ V.T).max(axis=0))
    np.testing.assert_allclose(asked.value, reached, atol=1e-7)


def test_cells_are_shared_by_loops_that_differ_in_the_dynamics_only():
    loop = random_loop(0)
    assert cells(loop) is cells(loop.with_disturbance(Polytope.box([0, 0], [1, 1])))


# -- accuracy and soundness ---------------------------------------------------------------------------


@pytest.mark.parametrize("length", [1e-3, 1.0, 1e3, 1e6])
def test_bound_scales_with_the_length_of_a_direction(length):
    loop, F = random_loop(3), SETS["X"]
    plain, scaled = Cells().support(loop, F, V), Cells().support(loop, F, length * V)
    np.testing.assert_allclose(scaled.value / length, plain.value, rtol=1e-12)
    assert (scaled.bound - scaled.value >= 1e-13 * np.maximum(length, 1)).all()
    assert (scaled.bound - scaled.value <= 1e-9 * np.maximum(length, 1)).all()


def cancelling(rng, size):
    """Phi(x) = k x1 by two linear layers whose products nearly cancel: floats know k to within about 1e-16 size^2."""
    a, c = rng.normal(size=2) * size
    hidden = Layer([[a, 0], [a * (1 + 2**-32), 0]], [0, 0], 1)
    return MaxoutNetwork((hidden,), [[c, -c * (1 - 2**-32)]], [0.0])


@pytest.mark.parametrize("size", [1e3, 1e5])
def test_bound_counts_the_error_of_the_network(size):
    """x1+ = Phi(x) on |x1| <= 1 reaches |Phi(1, 0)| both ways; the attained values often fall short of it."""
    X, U = Polytope.box([-1, -1], [1, 1]), Polytope.box([-10], [10])
    mode, short = Mode(np.zeros((2, 2)), [[1.0], [0]], [0, 0], Polytope([[0.0, 0, 0]], [1.0])), 0
    for seed in range(12):
        net = cancelling(np.random.default_rng(seed), size)
        truth = abs(exact_input(net, [1, 0])[0])
        found = Cells().support(ClosedLoop(PWASystem([mode], X, U), net), X, [[1.0, 0], [-1.0, 0]])
        assert all(Fraction(bound) >= truth for bound in found.bound)
        short += any(Fraction(value) < truth for value in found.value)
    assert short > 2


def test_a_mode_counts_where_only_rounding_moves_its_row_of_u():
    """Phi(x) <= h holds at the state without a margin, and the float K x + g may be above h by 1e-6."""
    X, U, above = Polytope.box([-1, -1], [1, 1]), Polytope.box([-10], [10]), 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        net, x = cancelling(rng, 1e5), rng.uniform(0.2, 0.9)
        u = exact_input(net, [x, 0])[0]
        h = float(u) if Fraction(float(u)) >= u else np.nextafter(float(u), np.inf)
        regions = Polytope([[0.0, 0, 1]], [h]), Polytope([[0.0, 0, -1]], [-h])
        modes = [Mode(np.zeros((2, 2)), [[0], [0]], [p, 0], region) for p, region in zip((0.5, 0.0), regions)]
        loop = ClosedLoop(PWASystem(modes, X, U), net)
        assert Cells().support(loop, Polytope.box([x, 0], [x, 0]), [[1.0, 0]]).bound[0] >= 0.5
        above += net([x, 0])[0] > h + 1e-9
    assert above > 2


@pytest.mark.parametrize("size", [1e2, 1e4, 1e6])
def test_large_disturbances_are_covered_by_the_rounding(size):
    """And equal sets give equal numbers, in whichever order their rows come."""
    loop = affine_loop(0.5 * np.eye(2), Polytope.box([-size / 3, -size / 7], [size / 3, size / 7]))
    X, half = Polytope.box([-1, -1], [1, 1]), Polytope([[1.0, 1], [-1, 0], [1, 3]], [0.3, 0.7, 0.2])
    bound, exactly = Cells().support(loop, X, V).bound, Exact().support(loop, X, V).value
    assert (bound >= exactly).all()
    assert (bound <= exactly + (1e-13 * size + 4e-10) * np.linalg.norm(V, axis=1)).all()
    turned = [Polytope(half.H[order], half.h[order]) for order in ([0, 1, 2], [2, 0, 1])]
    first, second = (Cells().support(loop, F, V).bound for F in turned)
    np.testing.assert_array_equal(first, second)


def test_flat_state_set_gives_flat_cells():
    system = affine_loop(0.5 * np.eye(2)).system
    flat = PWASystem(system.modes, Polytope.box([-1, 0.5], [2, 0.5]), system.input_set)
    net = MaxoutNetwork([Layer([[0.1, 0], [0, 0]], [0, 0.1], 2)], [[1.0]], [0.0])
    loop = ClosedLoop(flat, net)
    np.testing.assert_allclose(Cells().support(loop, SETS["X"], directions(4)).value, [1, 0.25, 0.5, -0.25], atol=1e-12)


def test_empty_set_and_set_outside_have_no_image():
    loop = random_loop(0)
    for F in (Polytope.box([20, 20], [21, 21]), Polytope([[1.0, 0], [-1, 0]], [0, -1]), Polytope([[0.0, 0]], [-1])):
        found = Cells().support(loop, F, V)
        assert (found.value == -np.inf).all() and (found.bound == -np.inf).all() and set(found.witness) == {None}


def test_a_point_whose_rows_are_rounded_is_a_point():
    """Rows of a template that are opposite but for rounding; read exactly they leave nothing of the point."""
    C, x = directions(8), np.array([-7.3, 8.52])
    loop = affine_loop(0.5 * np.eye(2), limits=10.0)
    found = Cells().support(loop, Polytope(C, C @ x), C)
    np.testing.assert_allclose(found.value, C @ x / 2, atol=1e-12)


# -- bad input ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("ask", "words"),
    [
        (lambda loop: Cells().support(loop, SETS["X"], [[1.0, 0, 0]]), ["V has shape (1, 3)", "2"]),
        (lambda loop: Cells().support(loop, SETS["X"], [[np.nan, 0]]), ["V must be finite"]),
        (lambda loop: Cells().support(loop, SETS["X"], [1.0, 0]), ["V must have 2 axes"]),
        (lambda loop: Cells().support(loop, Polytope.box([0], [1]), V), ["F lies in R^1", "2 entries"]),
        (lambda loop: Cells().support(loop, SETS["X"], V, 0), ["steps", "at least 1", "0"]),
        (lambda loop: Cells().support(loop, SETS["X"], V, 1.5), ["steps", "whole number", "1.5"]),
        (lambda loop: cells(random_loop(0, 3)), ["2 states", "has 3", "milp"]),
    ],
)
def test_bad_arguments_are_named(ask, words):
    with pytest.raises(ValueError) as error:
        ask(random_loop(0))
    assert all(word in str(error.value) for word in words), str(error.value)


def test_too_many_pieces_are_refused(monkeypatch):
    import mireach.engines.cells as module

    monkeypatch.setattr(module, "MOST_PIECES", 3)
    with pytest.raises(CellLimitError, match=r"after 1 steps .* pieces; take fewer steps"):
        Cells().support(random_loop(0, cuts=3), SETS["X"], V, 2)


def test_ties_between_equal_channels_give_one_cell():
    layer = Layer([[1.0, 0], [1.0, 0], [1.0, 0]], [0.5, 0.5, 0.5], 3)
    loop = ClosedLoop(
        PWASystem(
            [Mode(np.eye(2), np.ones((2, 1)), np.zeros(2), Polytope([[1.0, 0, 0]], [9.0]))],
            Polytope.box([-1, -1], [1, 1]),
            Polytope.box([-3], [3]),
        ),
        MaxoutNetwork([layer], [[1.0]], [0.0]),
    )
    assert len(cells(loop)) == 1
    np.testing.assert_allclose(Cells().support(loop, SETS["X"], directions(4)).value, [2.5, 2.5, 1.5, 1.5], atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_ties_on_whole_edges_lose_nothing(seed):
    """Integer weights and boundaries make channels, regions and X tie along edges and at corners."""
    rng = np.random.default_rng(seed)
    layers = [Layer(rng.integers(-1, 2, (4, 2)), rng.integers(-1, 2, 4), 2) for _ in range(2)]
    net = MaxoutNetwork(layers, rng.integers(-1, 2, (1, 2)), [0.0]).saturate(-1, 1)
    cut = np.append(rng.integers(-1, 2, 2), 1.0)[None]
    modes = [
        Mode(rng.integers(-1, 2, (2, 2)), rng.integers(-1, 2, (2, 1)), rng.integers(-1, 2, 2), Polytope(s * cut, [0.0]))
        for s in (1, -1)
    ]
    loop = ClosedLoop(PWASystem(modes, Polytope.box([-2, -2], [2, 2]), Polytope.box([-1], [1])), net)
    for F in (SETS["X"], Polytope.box([-1, -1], [1, 1]), Polytope.box([0, -2], [0, 2]), Polytope.box([1, 1], [1, 1])):
        check(loop, F, Cells().support(loop, F, V), brute_support(loop, F, V))


def test_narrow_spike_is_a_spike():
    net = narrow_spike().network
    assert net([[0.7123, 0], [0.0, 0], [0.72, 0]]).ravel() == pytest.approx([2, 0, 0])


@pytest.mark.parametrize("seed", range(3))
def test_cells_that_a_set_misses_are_left_out_for_smaller_ones(seed):
    loop, rng, known = random_loop(seed, cuts=2, width=4), np.random.default_rng(seed), None
    H, other = directions(7), random_loop(seed + 50, cuts=2, width=4)
    h, counts = Polytope.box([-3, -3], [3, 3]).support(H), []
    for _ in range(12):
        F = Polytope(H, h)
        alone, helped = Cells().support(loop, F, V), Cells().support(loop, F, V, warm_start=known)
        np.testing.assert_array_equal(helped.bound, alone.bound)
        np.testing.assert_array_equal(helped.value, alone.value)
        for_another = Cells().support(other, F, V, warm_start=known)
        np.testing.assert_array_equal(for_another.bound, Cells().support(other, F, V).bound)
        known = helped
        counts.append(len(known.left))
        h = h * rng.uniform(0.6, 1, len(h))
    assert counts == sorted(counts, reverse=True) and counts[-1] < counts[0]
    larger = Polytope.box([-3, -3], [3, 3])
    alone, helped = Cells().support(loop, larger, V), Cells().support(loop, larger, V, warm_start=known)
    np.testing.assert_array_equal(helped.bound, alone.bound)


@pytest.mark.parametrize("steps", [1, 2, 3])
def test_outside_the_state_set_nothing_is_reached(steps):
    loop = random_loop(0)
    found = Cells().support(loop, Polytope.box([50, 50], [60, 60]), V, steps)
    assert (found.bound == -np.inf).all() and list(found.witness) == [None] * len(V)


def test_nothing_is_reached_when_all_trajectories_have_left_the_state_set():
    X, U, D = Polytope.box([-1, -1], [1, 1]), Polytope.box([-1], [1]), Polytope.box([0, 0], [0, 0])
    everywhere = Polytope(np.zeros((0, 3)), np.zeros(0))
    system = PWASystem([Mode(3 * np.eye(2), [[0], [0]], [0, 0], everywhere, D)], X, U)
    loop = ClosedLoop(system, MaxoutNetwork([Layer(np.zeros((2, 2)), np.zeros(2), 2)], [[1.0]], [0.0]))
    F = Polytope.box([0.5, 0.5], [0.9, 0.9])  # R_1 lies beyond X
    assert (Cells().support(loop, F, V, 1).bound > -np.inf).all()
    for steps in (2, 3, 4):
        assert (Cells().support(loop, F, V, steps).bound == -np.inf).all()


@pytest.mark.parametrize("n", [1, 3, 4])
def test_modes_that_act_on_a_face_or_a_slice_of_the_state_set_alone(n):
    """Their cells are flat. A bound of theirs must not be loose, since it would hide the cells that attain more."""
    flat = 0
    for seed in range(12):
        rng, loop = space_loop(seed, n)
        system, X = loop.system, loop.system.state_set
        V = np.vstack([box_directions(n), rng.normal(size=(2, n))])
        low, high = X.bounding_box()
        at, axis = low[0] if seed % 2 else (2 * low[0] + high[0]) / 3, np.eye(n + system.input_size)[0]
        region = Polytope([axis, -axis], [at, -at])
        A, p = rng.normal(size=(n, n)), rng.normal(size=n)
        mode = Mode(A, np.zeros((n, system.input_size)), p, region, system.modes[0].disturbance)
        more = ClosedLoop(PWASystem([*system.modes, mode], X, system.input_set), loop.network)
        for F in (X, X.scale(0.7, X.chebyshev()[0]), Polytope.box(low, (low + high) / 2)):
            found, exact = Cells().support(more, F, V), Exact().support(more, F, V)
            assert (found.bound >= exact.bound).all() and (found.bound <= exact.bound + 1e-9).all()
            np.testing.assert_allclose(found.value, exact.value, rtol=0, atol=1e-9)
            flat += (exact.bound > Exact().support(loop, F, V).bound + 1e-3).any()
    assert flat > 5  # sets from which the new mode leads farther


@pytest.mark.parametrize("limit", ["many", None, 1.5, -1, 0])
def test_a_limit_that_is_no_number_of_cells_is_refused(limit):
    with pytest.raises((TypeError, ValueError), match="limit"):
        Cells(limit=limit)


# -- successors within X ------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS_OF_LOOPS)
def test_bounds_within_the_state_set_are_those_of_brute_force(kind):
    loop, left = random_loop(1, limits=1.5, **kind), 0
    X = loop.system.state_set
    for F in (X, *(SETS[name] & X for name in ("triangle", "flat", "segment", "point"))):
        found, expected = Cells().cut_support(loop, F, V), brute_support(loop, F, V, within=X)
        assert ((found >= expected - 1e-9) & ((found <= expected + 1e-7) | (found == expected))).all()
        assert (found <= Cells().support(loop, F, V).bound).all()
        left += (expected < Cells().support(loop, F, V).value - 1e-3).any()
        ends = random_images(loop, F, np.random.default_rng(1), 50)
        ends = ends[(ends @ X.H.T <= X.h).all(axis=1)]
        assert ((ends @ V.T).max(axis=0, initial=-np.inf) <= found + 1e-12).all()
    assert left  # sets whose image X cuts


@pytest.mark.parametrize(("n", "seeds"), [(1, 6), (3, 4), (4, 2)])
def test_bounds_within_the_state_set_of_any_dimension_are_those_of_brute_force(n, seeds):
    left = 0
    for seed in range(seeds):
        rng, loop = space_loop(seed, n)
        X, V = loop.system.state_set, np.vstack([box_directions(n), rng.normal(size=(2, n))])
        for kind, F in space_sets(loop, rng):
            if kind in ("sliver", "needle", "beyond X"):
                continue
            found, expected = Cells().cut_support(loop, F, V), brute_support(loop, F, V, within=X)
            assert ((found >= expected - 1e-9) & ((found <= expected + 1e-7) | (found == expected))).all(), kind
            left += (expected < Cells().support(loop, F, V).value - 1e-3).any()
    assert left  # sets whose image X cuts


def test_bounds_within_the_state_set_count_images_that_only_touch_it():
    jump = jump_loop([3.0, 0.0], [5.0, 0.0])  # X is the box |x|_inf <= 4
    assert Cells().cut_support(jump, SETS["X"], directions(4)).max() == pytest.approx(3, abs=1e-9)
    touching = affine_loop(np.eye(2), p=[2.0, 0.0])  # the image of |x|_inf <= 1 is 1 <= x1 <= 3
    found = Cells().cut_support(touching, SETS["X"], directions(4))
    np.testing.assert_allclose(found, [1, 1, -1, 1], atol=1e-9)
    beyond = affine_loop(np.eye(2), p=[2.1, 0.0])
    assert (Cells().cut_support(beyond, SETS["X"], directions(4)) == -np.inf).all()
    assert (Cells().cut_support(beyond, Polytope.box([5, 5], [6, 6]), directions(4)) == -np.inf).all()
