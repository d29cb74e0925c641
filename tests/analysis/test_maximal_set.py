"""The maximal safe set: against sampling, adversaries, a grid game, theory, and forgeries."""

from itertools import pairwise

import numpy as np
import pytest
import shapely
from loops import affine_loop, assert_escapes, evaluate, jump_loop, random_loop, random_successors
from regions import draw, pieces_of, square, triangles_of

import mireach as mr
from mireach.analysis import maximal_set
from mireach.analysis.maximal_set import carried_out
from mireach.analysis.plane import PlanarLoop
from mireach.engines import exact_plane
from mireach.systems.network import MaxoutNetwork

QUICK = (0, 1, 4, 6)  # seeds of random loops that have a maximal set with few corners


def constant_loop(targets, regions, D=None, limits=3.0):
    """x+ = targets[i] + d on the i-th region of x, given as (H, h)."""
    column, zero = np.zeros((2, 1)), np.zeros((2, 2))
    modes = [
        mr.Mode(zero, column, target, mr.Polytope(np.column_stack([H, np.zeros(len(H))]), h), D)
        for target, (H, h) in zip(targets, regions)
    ]
    net = MaxoutNetwork((), np.zeros((1, 2)), [0.0])
    return mr.ClosedLoop(mr.PWASystem(modes, square(limits), mr.Polytope.box([-1], [1])), net)


def stripes(*ends):
    """Regions ends[i] <= x1 <= ends[i + 1]."""
    return [(np.array([[1.0, 0], [-1, 0]]), np.array([b, -a])) for a, b in pairwise(ends)]


def board():
    """The nine regions of a chessboard with lines at -1 and 1; the middle one is number 4."""
    sides = ((-3.0, -1.0), (-1.0, 1.0), (1.0, 3.0))
    box = np.vstack([np.eye(2), -np.eye(2)])
    return [(box, np.array([x[1], y[1], -x[0], -y[0]])) for x in sides for y in sides]


# -- the maximal safe set -----------------------------------------------------------------------------


@pytest.mark.parametrize("with_input", [False, True])
@pytest.mark.parametrize("seed", QUICK)
def test_no_sampled_disturbance_leaves_the_set(seed, with_input):
    loop, rng = random_loop(seed, with_input=with_input), np.random.default_rng(seed)
    found = mr.maximal_safe_set(loop)
    if found.set is None:
        assert found.verdict == "refuted"
        return
    assert found.verdict == "proven" and found.set.is_subset(found.outer) and found.given_up < 1e-5
    after = random_successors(loop, np.repeat(draw(found.set, rng, 400), 5, axis=0), rng)
    assert len(after) > 1000 and found.set.contains(after, tol=1e-12).all()


def escapes(loop, history, x, rng):
    """Whether an adversary, who looks for disturbances that lead out of the smallest S_k, drives x out of X."""
    X = loop.system.state_set
    for _ in range(len(history) + 3):
        if not X.contains(x):
            return True
        u, best = evaluate(loop.network, x), (len(history), None)
        for mode in loop.system.modes:
            if (mode.region.H @ np.concatenate([x, u]) > mode.region.h).any():
                continue
            corners = mode.disturbance.vertices()
            d = np.vstack([corners, rng.dirichlet(np.ones(len(corners)), 150) @ corners])
            after = mode.A @ x + mode.B @ u + mode.p + d
            for k, S in enumerate(history[: best[0]]):
                outside = after[~S.contains(after)]
                if len(outside):
                    distance = np.array([S.shape.distance(point) for point in shapely.points(outside)])
                    best = (k, outside[distance.argmax()])
                    break
        if best[1] is None:
            return False
        x = best[1]
    return not X.contains(x)


@pytest.mark.parametrize("with_input", [False, True])
@pytest.mark.parametrize("seed", (0, 1, 2, 3))
def test_an_adversary_drives_states_outside_of_the_outer_set_out_of_x(seed, with_input):
    loop, rng = random_loop(seed, with_input=with_input), np.random.default_rng(seed)
    found = mr.maximal_safe_set(loop, prove=False)
    plane = PlanarLoop.of(loop)
    slack = maximal_set.SLACK * np.abs(plane.state_set.bounding_box()).max()
    history = [plane.in_user_units(S) for S in maximal_set._shrink(plane, slack, maximal_set.MOST_ITERATIONS)[0]]
    x = loop.system.state_set.sample(rng, 300)
    lost = x[~found.outer.contains(x, tol=0.02)][:40]  # nearer ones need a disturbance that samples may miss
    assert all(escapes(loop, history, state, rng) for state in lost)


def play_on_a_grid(loop, count=121):
    """States of a grid from which X is never left if successors are rounded to the grid: the points, and which."""
    X = loop.system.state_set
    lower, upper = X.bounding_box()
    axes = [np.linspace(low, high, count) for low, high in zip(lower, upper)]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    u = np.array([evaluate(loop.network, state) for state in x])
    moves = []
    for mode in loop.system.modes:
        here = np.flatnonzero((np.column_stack([x, u]) @ mode.region.H.T <= mode.region.h).all(axis=1))
        corners = mode.disturbance.vertices()
        weights = np.random.default_rng(0).dirichlet(np.full(len(corners), 0.5), 40)
        for d in np.vstack([corners, weights @ corners]):
            after = x[here] @ mode.A.T + u[here] @ mode.B.T + mode.p + d
            place = np.rint((after - lower) / (upper - lower) * (count - 1)).astype(int)
            inside = ((after >= lower) & (after <= upper)).all(axis=1)
            place = np.clip(place, 0, count - 1)
            moves.append((here, inside, place[:, 0] * count + place[:, 1]))
    safe = np.ones(len(x), bool)
    while True:
        before = safe.copy()
        for here, inside, place in moves:
            safe[here] &= inside & before[place]
        if (safe == before).all():
            return x, safe


@pytest.mark.parametrize("with_input", [False, True])
@pytest.mark.parametrize("seed", (0, 1, 2, 4))
def test_a_game_on_a_fine_grid_comes_to_the_same_set(seed, with_input):
    loop = random_loop(seed, with_input=with_input)
    found = mr.maximal_safe_set(loop, prove=False)
    x, safe = play_on_a_grid(loop)
    here = np.zeros(len(x), bool) if found.set is None else found.set.contains(x)
    assert np.mean(here != safe) < 0.03  # rounding to the grid shifts boundaries by about a step


@pytest.mark.parametrize("seed", range(4))
def test_a_linear_loop_has_the_set_that_theory_gives(seed):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(2, 2))
    A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
    D, X = square(0.03), square(1.0)
    found = mr.maximal_safe_set(affine_loop(A, D))
    H, h, power, room = X.H, X.h, np.eye(2), X.h.copy()
    rows, offsets = [H], [h]
    for _ in range(60):  # {x : H A^k x <= h - sum over j < k of h_D(H A^j)} for all k
        room = room - D.support(X.H @ power)
        power = power @ A
        rows.append(X.H @ power)
        offsets.append(room)
    rows, offsets = np.vstack(rows), np.concatenate(offsets)
    box = mr.Region.of(X)
    for row, offset in zip(rows, offsets):  # a half-plane at a time: vertices of 240 rows would take long
        if np.linalg.norm(row) > 1e-6:
            beyond = mr.Polytope(np.vstack([-row[None], np.vstack([np.eye(2), -np.eye(2)])]), [-offset, 9, 9, 9, 9])
            box = box - beyond
    assert found.verdict == "proven"
    assert found.set.area == pytest.approx(box.area, rel=1e-6) and found.given_up < 1e-6


def test_a_set_that_fits_by_a_hair_is_proven_without_slack():
    found = mr.maximal_safe_set(affine_loop(0.5 * np.eye(2), square(0.5)))
    assert found.verdict == "proven" and found.slack == 0 and found.set.area == 4 and found.iterations == 0
    assert "nothing is left" in found.reason


def test_where_there_is_none_it_says_so():
    for loop in (
        affine_loop(0.5 * np.eye(2), square(0.51)),
        affine_loop(2 * np.eye(2), p=[1.5, 0]),
        affine_loop(1.5 * np.eye(2), square(0.1)),
    ):
        found = mr.maximal_safe_set(loop)
        assert found.verdict == "refuted" and found.set is None and found.outer.is_empty
        assert "holds no RPI set" in found.reason


def test_a_set_without_area_is_left_open():
    found = mr.maximal_safe_set(affine_loop(2 * np.eye(2)))  # only the origin stays
    assert found.verdict == "unknown" and found.set is None and found.outer.contains([0.0, 0.0])


def test_a_hole_where_one_region_throws_everything_out():
    targets = [[2.0, 2.0]] * 9
    targets[4] = [9.0, 0.0]
    found = mr.maximal_safe_set(constant_loop(targets, board(), square(0.5)))
    assert found.verdict == "proven" and found.set.holes == 1 and found.iterations == 1
    assert found.set.area == pytest.approx(36 - 4, rel=1e-7) and found.given_up < 1e-7
    assert not found.set.contains([1.0, 0.0])  # on the line every mode counts


def test_several_components_and_disturbances_of_their_own():
    regions = stripes(-3.0, -1.0, 1.0, 3.0)
    loop = constant_loop([[-2.0, 0], [0, 9.0], [2.0, 0]], regions)
    sets = [square(0.9), square(0.1), mr.Polytope.box([0.2, 0], [0.5, 0])]
    found = mr.maximal_safe_set(loop.with_disturbance(sets))
    assert found.verdict == "proven" and found.set.components == 2
    assert found.set.area == pytest.approx(24, rel=1e-7)
    wide = mr.maximal_safe_set(loop.with_disturbance([square(1.1), *sets[1:]]))  # the left stripe leaks into the middle
    assert wide.set.components == 1 and wide.set.area == pytest.approx(12, rel=1e-7)


def test_images_that_are_segments_are_followed():
    loop = affine_loop([[0.5, 0.5], [0.0, 0.0]], mr.Polytope.box([-0.2, 0], [0.2, 0]), limits=1.0, p=[0.0, 0.5])
    found = mr.maximal_safe_set(loop)
    # x1+ = (x1 + x2) / 2 + d and x2+ = 0.5: lost is what comes to x1 > 0.8, and what comes from x2 = 0.5 to there
    assert found.verdict == "proven" and found.given_up < 1e-6
    after = random_successors(loop, draw(found.set, np.random.default_rng(0), 500), np.random.default_rng(0))
    assert found.set.contains(after).all()
    x, safe = play_on_a_grid(loop)
    assert np.mean(found.set.contains(x) != safe) < 0.03


def test_a_mode_that_acts_on_a_line_only_counts():
    """A region of (x, u) that the network meets on a line: what is there is thrown out."""
    net = MaxoutNetwork([mr.Layer([[1.0, 0], [-1.0, 0]], [0, 0], 2)], [[1.0]], [0.0])  # u = |x1|
    zero, column = np.zeros((2, 2)), np.zeros((2, 1))
    modes = [
        mr.Mode(zero, column, [1.0, 0.0], mr.Polytope([[0, 0, -1.0]], [0.0])),
        mr.Mode(zero, column, [9.0, 0.0], mr.Polytope([[0, 0, 1.0]], [0.0])),
    ]
    loop = mr.ClosedLoop(mr.PWASystem(modes, square(2), mr.Polytope.box([-3], [3])), net)
    found = mr.maximal_safe_set(loop)
    assert found.verdict == "proven" and found.set.components == 2 and not found.set.contains([0.0, 1.0])
    assert found.set.area == pytest.approx(16, rel=1e-7)


@pytest.mark.parametrize("name", ["pwa", "double_integrator"])
def test_case_studies_are_proven_and_hold_f_max(name):
    case = mr.case_study(name)
    found = mr.maximal_safe_set(case.loop)
    assert found.verdict == "proven" and found.given_up < 1e-6
    F = mr.Region.of(mr.safe_set(case.loop, case.safe_directions).set)
    assert F.is_subset(found.outer, tol=1e-9) and F.is_subset(found.set, tol=1e-7) and found.set.area > 1.2 * F.area
    rng = np.random.default_rng(0)
    x = draw(found.set, rng, 3000)
    corners = np.array([[i, j] for i in (-1, 1) for j in (-1, 1)]) * case.disturbance_bound
    for d in corners:
        assert found.set.contains(case.loop.step(x, np.tile(d, (len(x), 1)))).all()


def test_limits_and_arguments():
    loop = random_loop(5)
    found = mr.maximal_safe_set(loop, max_iterations=1)
    assert found.verdict == "unknown" and "max_iterations = 1 came first" in found.reason and found.set is None
    assert found.outer.area > 0
    with pytest.raises(ValueError, match="slack must be at least"):
        mr.maximal_safe_set(loop, slack=1e-14)
    with pytest.raises(ValueError, match="2 states"):
        mr.maximal_safe_set(affine_loop(0.5 * np.eye(3)))


@pytest.mark.parametrize("seed", range(4))
def test_one_step_backwards_takes_exactly_what_can_be_carried_out(seed):
    loop, rng = random_loop(seed, with_input=seed % 2 == 1), np.random.default_rng(seed)
    X = loop.system.state_set
    S = mr.Region.of(X.scale(0.9)) - X.scale(0.1)
    out = carried_out(loop, S)
    for x in X.sample(rng, 150):
        u, leaves = evaluate(loop.network, x), []
        for mode in loop.system.modes:
            if (mode.region.H @ np.concatenate([x, u]) <= mode.region.h).all():
                image = mr.Region.of(mode.A @ x + mode.B @ u + mode.p + mode.disturbance.vertices())
                leaves.append(not image.is_subset(S))
        near = out.shape.boundary.distance(shapely.points(x)) < 1e-6
        assert near or out.contains(x) == any(leaves)


@pytest.mark.parametrize("bound", [0.2620548704212598, 0.29493856257645784])
def test_steps_backwards_come_to_rest_where_edges_nearly_coincide(bound):
    """GEOS finds no noding for these bounds without a grid."""
    loop = mr.case_study("double_integrator").loop.with_disturbance(mr.Polytope.box([-bound] * 2, [bound] * 2))
    S, found = mr.Region.of(loop.system.state_set), mr.maximal_safe_set(loop, prove=False)
    for _ in range(7):
        S = S - carried_out(loop, S)
    assert S.area == pytest.approx(found.set.area, rel=1e-6)


def test_a_mode_that_acts_on_a_line_only_is_heeded_at_every_step():
    net = MaxoutNetwork([mr.Layer([[1.0, 0], [-1.0, 0]], [0, 0], 2)], [[1.0]], [0.0])  # u = |x1|
    zero, column = np.zeros((2, 2)), np.zeros((2, 1))
    regions = [
        ([[0, 0, -1.0], [1, 0, 0]], [0.0, 1.25]),
        ([[-1.0, 0, 0]], [-1.25]),
        ([[0, 0, 1.0], [1, 0, 0]], [0.0, 1.25]),
    ]
    targets = [1.0, 0], [9.0, 0], [1.5, 0]  # the third acts where u = 0: on x1 = 0, which is lost in the second step
    modes = [mr.Mode(zero, column, target, mr.Polytope(*region)) for region, target in zip(regions, targets)]
    found = mr.maximal_safe_set(mr.ClosedLoop(mr.PWASystem(modes, square(2), mr.Polytope.box([-3], [3])), net))
    assert found.verdict == "proven" and found.set.components == 2 and not found.set.contains([0.0, 1.0])
    assert found.set.area == pytest.approx(13, rel=1e-6)


def test_outer_bound_holds_what_is_safe_by_a_hair():
    found = mr.maximal_safe_set(
        constant_loop([[-2.0, 0], [0, 9.0], [2.0, 0]], stripes(-3.0, -1.0, 1.0, 3.0), square(0.5))
    )
    assert found.outer.contains([[-1 - 1e-12, 0.5], [1 + 1e-12, 0.5]]).all()


@pytest.mark.parametrize(("gradient", "edge"), [(0.0, 0.25), (1e-5, 2.0**-21), (1e-8, 2.0**-10)])
def test_nothing_is_refuted_where_floats_do_not_tell_which_mode_acts(gradient, edge):
    """u rests on the limit of two regions, or leaves it so slowly that the float cells reach too far."""
    zero, column, box = np.zeros((2, 2)), np.zeros((2, 1)), mr.Polytope.box([-0.25, -0.25], [edge, 0.25])
    if gradient:
        limit, net, safe = (
            0.0,
            MaxoutNetwork((), [[gradient, 0.0]], [0.0]),
            mr.Polytope.box([edge / 4, -0.125], [edge, 0.125]),
        )
    else:  # saturated at the float above the limit
        limit, net, safe = np.nextafter(0.1, 0), MaxoutNetwork((), [[1.0, 0.0]], [5.0]).saturate([-0.1], [0.1]), box
    modes = [
        mr.Mode(zero, column, [9.0, 0], mr.Polytope([[0, 0, 1.0]], [limit])),
        mr.Mode(zero, column, [edge / 2, 0], mr.Polytope([[0, 0, -1.0]], [-limit])),
    ]
    loop = mr.ClosedLoop(mr.PWASystem(modes, box, mr.Polytope.box([-1], [1])), net)
    assert mr.prove_rpi(loop, safe).verdict == "proven"
    found = mr.maximal_safe_set(loop)
    assert found.verdict != "refuted" and found.outer.area == pytest.approx(box.area)


@pytest.mark.parametrize(("gain", "slack"), [(1.25, 1e-6), (120.0, 1e-7), (4800.0, 1e-9)])
@pytest.mark.parametrize("size", [1e-6, 1.0, 120.0, 4800.0])
def test_the_slack_is_relative_to_the_largest_coordinate(size, gain, slack):
    """x1+ = gain x2 + d leaves |x1| <= size on two strips; D and what is lost are widened by the slack."""
    d = 0.05 * size / gain
    found = mr.maximal_safe_set(affine_loop([[0.0, gain], [0.1 / gain, 0.0]], square(d), limits=size), slack=slack)
    width = slack * gain * size  # the image reaches to gain times the size of X
    edge = np.abs(shapely.get_coordinates(found.set.shape)[:, 1]).max()
    assert found.verdict == "proven" and found.slack == slack
    assert (size - d) / gain - edge == pytest.approx((1 / gain + 1) * width, rel=1e-5)


@pytest.mark.parametrize("seed", [1, 4, 5, 6])
def test_the_first_slack_is_enough_for_a_proof(seed):
    """What is lost is widened by the slack: were it narrowed, no slack would lead to a set that is RPI."""
    found = mr.maximal_safe_set(random_loop(seed, 2, cuts=1, layers=1, kinds=("box",), limits=4.0))
    assert found.verdict == "proven" and found.slack == 1e-9 and found.iterations > 1


# -- proofs and forgeries -----------------------------------------------------------------------------


@pytest.mark.parametrize("seed", QUICK)
def test_forged_regions_are_refuted_by_a_step_that_replays(seed):
    loop, rng = random_loop(seed), np.random.default_rng(seed)
    S = mr.maximal_safe_set(loop).set
    assert mr.prove_rpi(loop, S).verdict == "proven"
    X = mr.Region.of(loop.system.state_set)
    lost = X - S
    forged = [X]
    while len(forged) < 4:  # a bite of what is lost, added to the set
        x = rng.uniform(*X.bounding_box())
        if lost.contains(x) and not S.contains(x, tol=0.05):
            forged.append(S | (mr.Region.of(mr.Polytope.box(x - 0.05, x + 0.05)) & X))
    for region in forged:
        check = mr.prove_rpi(loop, region)
        assert check.verdict == "refuted" and "a step leaves the region" in check.reason
        assert_escapes(loop, triangles_of(region), check.witness.exact)


def test_a_corner_moved_outward_is_noticed():
    case = mr.case_study("pwa")
    S = mr.maximal_safe_set(case.loop, prove=False).set
    refuted = 0
    for piece in pieces_of(S):
        middle = piece.mean(axis=0)
        for corner in range(len(piece)):
            moved = piece.copy()
            moved[corner] += 1e-3 * (piece[corner] - middle)
            region = mr.Region.of(*pieces_of(S), moved)
            if region.area > S.area + 1e-9:
                check = mr.prove_rpi(case.loop, region)
                assert check.verdict == "refuted"
                assert_escapes(case.loop, triangles_of(region), check.witness.exact)
                refuted += 1
    assert refuted >= 4


def test_a_proof_needs_a_set():
    with pytest.raises(ValueError, match="nothing to prove"):
        mr.prove_rpi(jump_loop([0.0, 0.0], [0.0, 0.0]), mr.Region.of())
    assert mr.prove_rpi(affine_loop(0.5 * np.eye(2)), square(1)).verdict == "proven"


def test_a_proof_that_grows_too_large_is_given_up(monkeypatch):
    monkeypatch.setattr(exact_plane, "MOST_PARTS", 0)
    frame = mr.Region.of(square(1)) - square(0.5)
    check = mr.prove_rpi(affine_loop(0.5 * np.eye(2)), frame)
    assert check.verdict == "unknown" and "parts" in check.reason and check.witness is None
