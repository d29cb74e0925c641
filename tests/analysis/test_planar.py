"""The maximal safe set and exact reachable sets: against sampling, adversaries, a grid game, theory, and forgeries."""

import pickle
from itertools import pairwise

import numpy as np
import pytest
from loops import (
    affine_loop,
    assert_escapes,
    evaluate,
    jump_loop,
    narrow_spike,
    random_images,
    random_loop,
    random_successors,
)

import mireach as mr
from mireach.analysis import planar
from mireach.systems.network import MaxoutNetwork

QUICK = (0, 1, 4, 6)  # seeds of random loops that have a maximal set with few corners


def square(r):
    return mr.Polytope.box([-r, -r], [r, r])


def pieces_of(region):
    return [region.pieces[i] for i in range(len(region.pieces))]


def triangles_of(region):
    return [region.simplices[i] for i in range(len(region.simplices))]


def draw(region, rng, count):
    """Random states of a region, many of them near its boundary."""
    lower, upper = region.bounding_box()
    x = rng.uniform(lower, upper, (20 * count, 2))
    inside = x[region.contains(x)][:count]
    corners = region.simplices.points
    middles = (corners + np.roll(corners, 1, axis=0)) / 2
    return np.vstack([inside, corners, middles[region.contains(middles)]])


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
                    distance = np.array([S.shape.distance(point) for point in planar.shapely.points(outside)])
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
    units, every = planar._own(loop)
    history, _ = planar._shrink(units.loop, every, planar.SLACK * planar._size(every), planar.MOST_ITERATIONS)
    history = [planar._rescaled(S, units.state) for S in history]
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
    out = planar.carried_out(loop, S)
    for x in X.sample(rng, 150):
        u, leaves = evaluate(loop.network, x), []
        for mode in loop.system.modes:
            if (mode.region.H @ np.concatenate([x, u]) <= mode.region.h).all():
                image = mr.Region.of(mode.A @ x + mode.B @ u + mode.p + mode.disturbance.vertices())
                leaves.append(not image.is_subset(S))
        near = out.shape.boundary.distance(planar.shapely.points(x)) < 1e-6
        assert near or out.contains(x) == any(leaves)


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
        assert_escapes(loop, triangles_of(region), check.witness)


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
                assert_escapes(case.loop, triangles_of(region), check.witness)
                refuted += 1
    assert refuted >= 4


def test_a_proof_needs_a_set():
    with pytest.raises(ValueError, match="nothing to prove"):
        mr.prove_rpi(jump_loop([0.0, 0.0], [0.0, 0.0]), mr.Region.of())
    assert mr.prove_rpi(affine_loop(0.5 * np.eye(2)), square(1)).verdict == "proven"


def test_a_proof_that_grows_too_large_is_given_up(monkeypatch):
    monkeypatch.setattr(planar.exact, "MOST_PARTS", 0)
    frame = mr.Region.of(square(1)) - square(0.5)
    check = mr.prove_rpi(affine_loop(0.5 * np.eye(2)), frame)
    assert check.verdict == "unknown" and "parts" in check.reason and check.witness is None


# -- reachable sets -----------------------------------------------------------------------------------


@pytest.mark.parametrize("with_input", [False, True])
@pytest.mark.parametrize("seed", range(5))
def test_reachable_sets_hold_what_is_sampled_and_have_the_right_support(seed, with_input):
    loop, rng = random_loop(seed, with_input=with_input), np.random.default_rng(seed)
    F, V = loop.system.state_set.scale(0.5), mr.directions(9)
    sets = mr.exact_reach(loop, F, 2)
    for steps in (1, 2):
        R = sets[steps]
        images = random_images(loop, F, rng, 800, steps)
        assert R.contains(images, tol=1e-8).all()
        reached = (R.simplices.points @ V.T).max(axis=0)
        np.testing.assert_allclose(reached, mr.support(loop, F, V, steps=steps).value, atol=1e-8)


def test_reachable_sets_have_no_area_that_nothing_reaches():
    loop, rng = random_loop(1), np.random.default_rng(0)
    F = loop.system.state_set.scale(0.5)
    R = mr.exact_reach(loop, F, 1)[1]
    images = np.vstack([random_images(loop, F, rng, 4000), F.sample(rng, 1)])
    inside = draw(R, rng, 300)[:300]
    near = np.array([np.abs(images - x).max(axis=1).min() for x in inside])
    assert np.mean(near < 0.25) > 0.9  # images take extreme disturbances: the middle of D is not sampled


def test_points_and_segments_have_images():
    still = mr.exact_reach(affine_loop(0.5 * np.eye(2)), mr.Polytope.box([1, 1], [1, 1]), 3)[3]
    assert still.area == 0 and still.contains([0.125, 0.125]) and len(still.pieces) == 1
    R = mr.exact_reach(affine_loop(0.5 * np.eye(2), square(0.1)), mr.Polytope.box([0, 0], [1, 0]), 1)[1]
    assert R.area == pytest.approx(0.7 * 0.2)
    both = mr.exact_reach(jump_loop([0.0, 0.0], [3.0, 0.0]), mr.Polytope.box([1, 0], [1, 0]), 1)[1]
    assert both.contains([[0.0, 0.0], [3.0, 0.0]]).all() and both.components == 2
    mixed = jump_loop([0.0, 0.0], [3.0, 0.0], [mr.Polytope.box([0, 0], [0, 0]), square(0.1)])
    R = mr.exact_reach(mixed, mr.Polytope.box([1, 0], [1, 0]), 1)[1]
    assert R.area == pytest.approx(0.04) and R.components == 2 and R.contains([0.0, 0.0])
    assert mr.exact_reach(affine_loop(np.eye(2)), mr.Polytope.box([5, 5], [6, 6]), 1)[1].is_empty


def test_the_template_covers_the_exact_sets():
    case = mr.case_study("double_integrator")
    F = mr.safe_set(case.loop, case.safe_directions).set
    outer, exactly = mr.outer_reach(case.loop, F, case.directions, 4), mr.exact_reach(case.loop, F, 4)
    assert all(R.is_subset(cover, tol=1e-9) for R, cover in zip(exactly, outer))
    assert mr.Region.of(outer[4]).area > 1.1 * exactly[4].area


def test_the_attractor_is_a_nested_sequence_that_settles_and_is_entered():
    case = mr.case_study("double_integrator")
    S = mr.maximal_safe_set(case.loop, prove=False)
    found = mr.attractor(case.loop, S, tolerance=1e-3)
    assert found.settled and len(found.history) == found.steps + 2
    assert all(after.is_subset(before, tol=1e-9) for before, after in pairwise(found.history))
    assert found.set.is_subset(found.history[-1], tol=1e-3)
    assert not found.history[found.steps - 1].is_subset(found.set, tol=1e-3)
    rng = np.random.default_rng(0)
    paths = case.loop.simulate(draw(S.set, rng, 500), found.steps, rng)
    assert found.set.contains(paths[:, -1], tol=1e-9).all()


def test_the_attractor_of_a_linear_loop_is_the_minimal_set():
    loop = affine_loop(0.5 * np.eye(2), square(0.25))
    found = mr.attractor(loop, square(1), tolerance=1e-6)
    assert found.set.is_subset(mr.Region.of(square(0.5)), tol=2e-6) and mr.Region.of(square(0.5)).is_subset(found.set)
    short = mr.attractor(loop, square(1), tolerance=1e-6, max_steps=3)
    assert not short.settled and short.steps == 2
    with pytest.raises(ValueError, match="no safe set to start from"):
        mr.attractor(loop, mr.maximal_safe_set(affine_loop(0.5 * np.eye(2), square(0.6))))


# -- the largest disturbance --------------------------------------------------------------------------


def test_the_largest_disturbance_of_a_linear_loop_is_known():
    loop = affine_loop(0.5 * np.eye(2))
    for method in ("maximal", "template", lambda other: mr.safe_set(other).set is not None):
        found = mr.largest_disturbance(loop, method)
        assert found.bound <= 0.5 <= found.above + 1e-7 and found.above - found.bound <= 1e-4
    assert mr.largest_disturbance(loop, "template", largest=0.25).above == np.inf
    assert mr.largest_disturbance(loop, "template", largest=0.25).bound == 0.25


def test_where_even_no_disturbance_is_too_much():
    found = mr.largest_disturbance(affine_loop(2 * np.eye(2), p=[1.5, 0]))
    assert np.isnan(found.bound) and found.above == 0 and found.tried == 1
    with pytest.raises(ValueError, match="method must be"):
        mr.largest_disturbance(affine_loop(np.eye(2)), "none")


@pytest.mark.parametrize("bound", [0.2620548704212598, 0.29493856257645784])
def test_steps_backwards_come_to_rest_where_edges_nearly_coincide(bound):
    """GEOS finds no noding for these bounds without a grid."""
    loop = mr.case_study("double_integrator").loop.with_disturbance(mr.Polytope.box([-bound] * 2, [bound] * 2))
    S, found = mr.Region.of(loop.system.state_set), mr.maximal_safe_set(loop, prove=False)
    for _ in range(7):
        S = S - planar.carried_out(loop, S)
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


# -- units --------------------------------------------------------------------------------------------


def in_other_units(loop, s, t):
    """The loop for x = s x', u = t u' (powers of two, one for each coordinate): another ClosedLoop for x', u'."""
    both = np.concatenate([s, t])
    modes = [
        mr.Mode(
            mode.A * s / s[:, None],
            mode.B * t / s[:, None],
            mode.p / s,
            mr.Polytope(mode.region.H * both, mode.region.h),
            mr.Polytope(mode.disturbance.H * s, mode.disturbance.h),
        )
        for mode in loop.system.modes
    ]
    X, U = loop.system.state_set, loop.system.input_set
    system = mr.PWASystem(modes, mr.Polytope(X.H * s, X.h), mr.Polytope(U.H * t, U.h))
    first, *hidden = loop.network.hidden
    hidden = [mr.Layer(first.weight * s, first.bias, first.pool), *hidden]
    return mr.ClosedLoop(system, MaxoutNetwork(hidden, loop.network.weight / t[:, None], loop.network.bias / t))


def rescaled(region, s):
    """{x' : s x' in the region}."""
    return mr.Region(planar.shapely.transform(region.shape, lambda x: x / s))


def assert_same(own, other, s):
    """The region `other` is {x' : s x' in `own`}, corner by corner and bit by bit."""
    one, two = (planar.shapely.get_coordinates(region.shape) for region in (own, other))
    assert np.array_equal(one, two * s)


def powers(rng, mixed):
    """Units s (2,) and t (1,)."""
    s = 2.0 ** rng.integers(-60, 61, 2) if mixed else np.full(2, 2.0 ** rng.integers(-60, 61))
    return s, 2.0 ** rng.integers(-60, 61, 1)


@pytest.mark.filterwarnings("ignore:the region of mode")
@pytest.mark.parametrize("mixed", [False, True])
@pytest.mark.parametrize("seed", (*QUICK, 2))
def test_answers_do_not_depend_on_units(seed, mixed):
    rng = np.random.default_rng([seed, mixed])
    loop, (s, t) = random_loop(seed, with_input=mixed), powers(rng, mixed)
    other = in_other_units(loop, s, t)
    own, its = mr.maximal_safe_set(loop), mr.maximal_safe_set(other)
    assert (own.verdict, own.iterations, own.slack, own.settled) == (
        its.verdict,
        its.iterations,
        its.slack,
        its.settled,
    )
    assert_same(own.outer, its.outer, s)
    assert len(own.history) == len(its.history)
    for S, S_other in zip(own.history, its.history):
        assert_same(S, S_other, s)
    F = loop.system.state_set.scale(0.5)
    for R, R_other in zip(mr.exact_reach(loop, F, 2), mr.exact_reach(other, mr.Polytope(F.H * s, F.h), 2)):
        assert_same(R, R_other, s)
    S = mr.Region.of(loop.system.state_set)
    assert_same(planar.carried_out(loop, S), planar.carried_out(other, rescaled(S, s)), s)
    check, check_other = mr.prove_rpi(loop, S), mr.prove_rpi(other, rescaled(S, s))
    assert check.verdict == check_other.verdict and check.settled == "exact arithmetic"
    if check.verdict == "refuted":
        assert_escapes(other, triangles_of(rescaled(S, s)), check_other.witness)
        assert_escapes(loop, triangles_of(S), check.witness)
    if own.set is not None:
        settled = mr.attractor(loop, own, tolerance=0.1, max_steps=4)
        settled_other = mr.attractor(other, its, tolerance=0.1 / s, max_steps=4)
        assert (settled.steps, settled.settled) == (settled_other.steps, settled_other.settled)
        assert np.array_equal(settled.added, settled_other.added * s)
        for R, R_other in zip(settled.history, settled_other.history):
            assert_same(R, R_other, s)


@pytest.mark.parametrize("mixed", [False, True])
def test_the_largest_disturbance_does_not_depend_on_units(mixed):
    rng = np.random.default_rng(mixed)
    loop, (s, t) = random_loop(0), powers(rng, mixed)
    own = mr.largest_disturbance(loop, accuracy=0.05)
    assert own == mr.largest_disturbance(in_other_units(loop, s, t), accuracy=0.05, weights=1 / s)
    assert own.bound > 0


@pytest.mark.parametrize("size", [0.1, 1.0, 120.0, 1000.0])
def test_the_slack_is_relative_to_the_largest_coordinate(size):
    """x1+ = 5/4 x2 + d leaves |x1| <= size where |x2| > 0.76 size; D and what is lost are widened by the slack."""
    loop = affine_loop([[0.0, 1.25], [0.1, 0.0]], square(0.05 * size), limits=size)
    found = mr.maximal_safe_set(loop, slack=1e-6)
    width = 1e-6 * 1.25 * size  # the image reaches to 5/4 size
    edge = np.abs(planar.shapely.get_coordinates(found.set.shape)[:, 1]).max()
    assert found.verdict == "proven" and found.slack == 1e-6
    assert 0.76 * size - edge == pytest.approx((1 / 1.25 + 1) * width, rel=1e-6)


@pytest.mark.parametrize(
    "ask",
    [
        mr.maximal_safe_set,
        lambda loop: planar.carried_out(loop, square(1)),
        lambda loop: mr.prove_rpi(loop, square(1)),
        lambda loop: mr.exact_reach(loop, square(1), 1),
        lambda loop: mr.attractor(loop, square(1)),
        mr.largest_disturbance,
    ],
)
def test_a_network_that_leaves_u_is_an_error(ask):
    loop = narrow_spike()
    with pytest.raises(ValueError, match="input"):
        ask(loop)


def test_answers_pickle():
    loop = affine_loop(0.5 * np.eye(2), square(0.1))
    found = mr.maximal_safe_set(loop)
    again = pickle.loads(pickle.dumps(found))
    assert again.settled == "exact arithmetic" and again.set.area == found.set.area
    for answer in (mr.prove_rpi(loop, square(0.1)), mr.attractor(loop, found), mr.exact_reach(loop, square(1), 1)):
        assert repr(pickle.loads(pickle.dumps(answer)))[:40] == repr(answer)[:40]
    assert mr.prove_rpi(loop, square(0.1)).verdict == "refuted" and found.verdict == "proven"


# -- many pieces --------------------------------------------------------------------------------------


def pendulum_loop(seed, hidden=12, dt=0.05):
    """x+ = Phi(x): a ReLU 2-12-2 network fitted to a pendulum under feedback, random but for its last layer."""
    rng = np.random.default_rng(seed)
    W, b = rng.normal(size=(hidden, 2)), rng.uniform(-0.9, 0.9, hidden)
    W /= np.linalg.norm(W, axis=1)[:, None]
    x = rng.uniform(-1, 1, (4000, 2))
    after = x + dt * np.column_stack([x[:, 1], 2 * np.sin(2 * x[:, 0]) - 8 * x[:, 0] - 3 * x[:, 1]])
    features = np.column_stack([np.maximum(x @ W.T + b, 0), np.ones(len(x))])
    last = np.linalg.lstsq(features, after, rcond=None)[0].T
    weight, bias = np.zeros((2 * hidden, 2)), np.zeros(2 * hidden)
    weight[::2], bias[::2] = W, b
    net = MaxoutNetwork([mr.Layer(weight, bias, 2)], last[:, :-1], last[:, -1])
    mode = mr.Mode(np.zeros((2, 2)), np.eye(2), np.zeros(2), mr.Polytope(np.eye(4)[:1], [100.0]))
    return mr.ClosedLoop(mr.PWASystem([mode], square(1), mr.Polytope.box([-4, -4], [4, 4])), net)


@pytest.mark.parametrize("seed", [1, 3])
def test_the_attractor_of_a_network_with_many_cells_settles(seed):
    """GEOS fails on the union of these images; without cracks there are no holes."""
    loop, rng = pendulum_loop(seed), np.random.default_rng(seed)
    S = mr.maximal_safe_set(loop, slack=1e-5, prove=False).history[-1]
    found = mr.attractor(loop, S, tolerance=1e-2)
    assert found.settled and (found.added < 2 * 1e-2 / 8 * (found.steps + 1)).all()
    for before, after in pairwise(found.history):
        assert after.holes == 0 and after.components == 1
        x = draw(before, rng, 200)
        x = x[loop.system.state_set.contains(x)]
        assert after.contains(np.array([evaluate(loop.network, state) for state in x])).all()
    few = mr.attractor(loop, S, tolerance=1e-9, max_steps=4)
    exactly = mr.exact_reach(loop, S, 4)
    for R, cover in zip(exactly[:4], few.history):
        assert R.is_subset(cover, tol=1e-10) and cover.is_subset(R, tol=few.added.max() * 20)


def test_sets_of_the_attractor_hold_the_exact_images_of_exact_cells():
    loop = pendulum_loop(0)
    found = mr.attractor(loop, square(0.5), tolerance=1e-2, max_steps=1)
    units = planar.own_units(loop)
    assert np.array_equal(units.state, [1, 1])
    first = found.history[1]
    for cell in planar.exact.cells(units.loop):
        part = planar.exact._clip_all(cell.corners, planar.exact._rows(square(0.5)))
        images = [[planar.exact.nearest(entry) for entry in cell.image(x)] for x in part]
        assert not images or first.contains(np.array(images)).all()


def test_too_many_parts_are_an_error_that_says_what_to_do(monkeypatch):
    monkeypatch.setattr(planar, "MOST_PARTS", 5)
    loop = pendulum_loop(0)
    with pytest.raises(mr.errors.RegionError, match="take fewer steps"):
        mr.exact_reach(loop, square(0.7), 2)
    with pytest.raises(mr.errors.RegionError, match="larger tolerance"):
        mr.attractor(loop, square(0.7))


@pytest.mark.parametrize("seed", [1, 4, 5, 6])
def test_the_first_slack_is_enough_for_a_proof(seed):
    """What is lost is widened by the slack: were it narrowed, no slack would lead to a set that is RPI."""
    found = mr.maximal_safe_set(random_loop(seed, 2, cuts=1, layers=1, kinds=("box",), limits=4.0))
    assert found.verdict == "proven" and found.slack == 1e-9 and found.iterations > 1
