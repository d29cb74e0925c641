"""Unions of polygons in rational arithmetic: sets that fit by a hair, gaps, jumps, points and segments."""

from fractions import Fraction

import numpy as np
import pytest
import shapely
from loops import affine_loop, assert_escapes, jump_loop

import mireach as mr
from mireach.arithmetic.rational import binary
from mireach.engines import exact_plane, steps


def square(r):
    return mr.Polytope.box([-r, -r], [r, r])


def corners(*boxes):
    return [mr.Polytope.box(*box).vertices() for box in boxes]


def test_every_number_is_the_float_that_it_is():
    loop = affine_loop(0.1 * np.eye(2), square(0.1), limits=0.3)
    expected = Fraction(0.1) + Fraction(1, 10), 2 * Fraction(0.1)
    assert steps.successor(loop, (1, 2), 0, (Fraction(1, 10), 0)) == expected


def test_a_set_that_fits_without_any_margin_is_proven_and_one_ulp_more_is_refuted():
    X = corners(([-1, -1], [1, 1]))
    assert exact_plane.first_escape(affine_loop(0.5 * np.eye(2), square(0.5)), X) is None
    escape = exact_plane.first_escape(affine_loop(0.5 * np.eye(2), square(np.nextafter(0.5, 1))), X)
    assert max(abs(value) for value in escape.after) > 1 and "->" in str(escape)


def test_a_state_outside_of_x_is_a_witness_by_itself():
    escape = exact_plane.first_escape(affine_loop(0.5 * np.eye(2)), corners(([-1, -1], [1, 1.5])))
    assert escape.after is None and escape.state[1] == Fraction(3, 2) and "outside the state set" in str(escape)


@pytest.fixture
def gaps_allowed(monkeypatch):
    """Systems whose regions leave gaps, which PWASystem refuses: the exact engine must not rely on that."""
    monkeypatch.setattr("mireach.systems.pwa._check_partition", lambda *_: None)


def test_a_gap_between_regions_is_noticed_however_narrow(gaps_allowed):
    zero, column = np.zeros((2, 2)), np.zeros((2, 1))
    for width in (0.0, 1e-9):
        regions = mr.Polytope([[1.0, 0, 0]], [0.0]), mr.Polytope([[-1.0, 0, 0]], [-width])
        modes = [mr.Mode(zero, column, [0.5, 0.0], region) for region in regions]
        net = mr.MaxoutNetwork((), np.zeros((1, 2)), [0.0])
        loop = mr.ClosedLoop(mr.PWASystem(modes, square(1), mr.Polytope.box([-1], [1])), net)
        escape = exact_plane.first_escape(loop, corners(([-1, -1], [1, 1])))
        assert escape is None if not width else 0 < escape.state[0] < width and "no region contains" in str(escape)


def test_on_a_boundary_every_mode_counts():
    loop = jump_loop([0.0, 0.0], [9.0, 0.0])  # right of x1 = 1, and on it, all is carried out of X
    assert exact_plane.first_escape(loop, corners(([-1, -1], [np.nextafter(1, 0), 1]))) is None
    escape = exact_plane.first_escape(loop, corners(([-1, -1], [1, 1])))
    assert escape.mode == 1 and escape.state[0] == 1


def test_points_and_segments_are_sets_too():
    still, loop = [np.zeros((1, 2))], affine_loop([[0.5, 0], [0, 2.0]])
    assert exact_plane.first_escape(loop, still) is None
    assert exact_plane.first_escape(loop, [np.array([[-1.0, 0], [1, 0]])]) is None
    escape = exact_plane.first_escape(loop, [np.array([[0, -1.0], [0, 1]])])
    assert escape.state[0] == 0 and abs(escape.after[1]) > 1
    assert exact_plane.first_escape(affine_loop([[0, 0], [0, 0.0]], square(0.25)), corners(([-1, -1], [1, 1]))) is None
    segment = mr.Polytope.box([-0.5, 0], [0.5, 0])
    assert exact_plane.first_escape(affine_loop(0 * np.eye(2), segment), [np.array([[-0.5, 0], [0.5, 0]])]) is None
    assert exact_plane.first_escape(affine_loop(0 * np.eye(2), segment), [np.array([[-0.4, 0], [0.5, 0]])]) is not None


def test_a_hole_that_the_image_covers_is_found():
    loop = affine_loop(0.5 * np.eye(2), square(0.25), limits=4)
    around = mr.Region.of(square(2)) - square(0.01)
    pieces = [around.pieces[i] for i in range(len(around.pieces))]
    escape = exact_plane.first_escape(loop, pieces)
    assert max(abs(value) for value in escape.after) < 0.01
    assert_escapes(loop, pieces, escape)


ZERO, COLUMN = np.zeros((2, 2)), np.zeros((2, 1))


def constant_maps(regions, targets, X):
    """x+ = target on each region (H, h) of (x, u), with u = 0."""
    modes = [mr.Mode(ZERO, COLUMN, target, mr.Polytope(*region)) for region, target in zip(regions, targets)]
    net = mr.MaxoutNetwork((), np.zeros((1, 2)), [0.0])
    return mr.ClosedLoop(mr.PWASystem(modes, X, mr.Polytope.box([-1], [1])), net)


@pytest.mark.parametrize("flip", [1, -1])
def test_a_flat_cell_does_not_stand_for_the_whole_of_its_line(gaps_allowed, flip):
    flat = mr.Polytope.box([-1, 0], [1, 0])  # nothing acts between -1/2 and 1/2
    loop = constant_maps([([[1.0, 0, 0]], [-0.5]), ([[-1.0, 0, 0]], [-0.5])], [[0.75, 0]] * 2, flat)
    assert mr.prove_rpi(loop, flat).verdict == "refuted"
    beside = [([[1.0, 0, 0]], [0.5 - 1e-8]), ([[-1.0, 0, 0]], [-0.5 - 1e-8])]  # a narrow gap
    within = [([[1.0, 0, 0], [-1, 0, 0], [0, flip, 0]], [0.5, -0.5, -0.5])]  # a mode on a part of the line in it
    loop = constant_maps(beside + within, [[0.5, -0.75 * flip]] * 3, square(1))
    assert mr.prove_rpi(loop, mr.Region(shapely.LineString([[0.5, -1], [0.5, 1]]))).verdict == "refuted"


@pytest.mark.parametrize("side", [1, -1])
def test_a_segment_that_is_cut_stays_a_segment(side):
    segment = [binary(x) for x in ([0.0, 0.0], [1.0, 0.0])]
    cut = exact_plane._clip(segment, binary([side, 0.0]), binary(side * 0.5))
    assert len(cut) == 2 and binary([0.5, 0.0]) in cut


def test_a_witness_leaves_flat_parts_as_well():
    loop = affine_loop(0 * np.eye(2), square(0.25))
    check = mr.prove_rpi(loop, mr.Region.of(np.zeros((1, 2))))
    step = check.witness.exact
    again = type(check).from_dict(check.to_dict()).witness
    assert again.exact == step and again.states.tolist() == check.witness.states.tolist()
    assert check.witness.modes.tolist() == [step.mode] == [0]
    assert check.witness.states[1].tolist() == [float(value) for value in step.after]
    assert step.after != (0, 0) and step.after == steps.successor(loop, step.state, step.mode, step.disturbance)


def test_a_set_that_ends_just_short_of_a_jump_is_not_refuted_by_it():
    regions = [([[1.0, 0, 0]], [0.1]), ([[-1.0, 0, 0]], [-0.1])]
    loop = constant_maps(regions, [[9.0, 0], [0.5, 0]], square(3))
    beyond = mr.Polytope.box([np.nextafter(0.1, 1), -1], [1, 1])
    assert mr.prove_rpi(loop, beyond).verdict == "proven"
    assert mr.prove_rpi(loop, mr.Polytope.box([0.1, -1], [1, 1])).verdict == "refuted"


def test_a_flat_cell_is_cut_by_rows_of_u():
    net = mr.MaxoutNetwork((), np.array([[0.0, 1.0]]), [0.0])  # u = x2; on x1 = 0, u >= 1.5 a third mode acts
    line = mr.Polytope([[1.0, 0, 0], [-1, 0, 0], [0, 0, -1]], [0.0, 0, -1.5])
    modes = [mr.Mode(ZERO, COLUMN, [0.5, 0], mr.Polytope([[sign, 0, 0]], [0.0])) for sign in (1.0, -1.0)]
    system = mr.PWASystem([*modes, mr.Mode(ZERO, COLUMN, [9.0, 0], line)], square(2), mr.Polytope.box([-3], [3]))
    loop = mr.ClosedLoop(system, net)
    assert mr.prove_rpi(loop, square(1)).verdict == "proven"
    assert mr.prove_rpi(loop, square(1.75)).verdict == "refuted"


@pytest.mark.parametrize("corner", [(1, 1), (1, -1), (-1, 1), (-1, -1)])
def test_every_corner_of_a_disturbance_set_leads_out_by_itself(corner):
    """x+ = d reaches the square of half-width 1/2; the row corner x <= limit cuts one corner of it off, or none."""
    loop = affine_loop(np.zeros((2, 2)), square(0.5))
    for limit, inside in ((1.0, True), (np.nextafter(1.0, 0), False), (0.75, False)):
        F = square(1) & mr.Polytope([corner], [limit])
        escape = exact_plane.first_escape(loop, [F.vertices()])
        assert (escape is None) == inside
        assert inside or sum(s * y for s, y in zip(corner, escape.after)) > Fraction(limit)
        bound = mr.support(loop, F, [corner], engine="exact").bound[0]
        assert bound == 1
