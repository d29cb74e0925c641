"""Invariant sets: hand answers for linear loops, and random loops whose trajectories must not leave what is proven."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from loops import affine_loop, assert_replays, brute_support, jump_loop, largest, random_loop, random_successors
from regions import in_other_units, powers

import mireach as mr
from mireach import (
    Cells,
    ClosedLoop,
    Exact,
    Milp,
    NonlinearSystem,
    Polytope,
    PWASystem,
    box_directions,
    check_rpi,
    directions,
    safe_set,
    scaled_minimal_set,
    terminal_set,
    ultimately_bounded,
)
from mireach.analysis.contraction import growth
from mireach.analysis.reach import cut_support
from mireach.engines.base import SOLVER, Support
from mireach.studies.seed_study import load_networks

BOX = box_directions(2)


def contraction(a=0.5, w=0.1, p=(0.0, 0.0), limits=1.0, n=2):
    """x+ = a x + p + d with |d| <= w in every entry: all sets of the box template are known by hand."""
    return affine_loop(a * np.eye(n), Polytope.box(-w * np.ones(n), w * np.ones(n)), limits, p=np.asarray(p)[:n])


def half_widths(a, w, count, start=1.0):
    """r_0 = start, r_(k+1) = a r_k + w."""
    r = [start]
    for _ in range(count):
        r.append(a * r[-1] + w)
    return np.array(r)


# -- check_rpi ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("engine", ["cells", "milp"])
@pytest.mark.parametrize(("r", "verdict"), [(0.19, "refuted"), (0.2001, "proven"), (0.9, "proven"), (1.1, "refuted")])
def test_box_is_invariant_exactly_from_the_minimal_one_up(engine, r, verdict):
    loop, F = contraction(), Polytope.box([-r, -r], [r, r])
    check = check_rpi(loop, F, engine)
    assert check.verdict == verdict
    if r < 1:
        np.testing.assert_allclose(check.margin, 0.5 * r - 0.1, atol=1e-6)
    else:
        assert "outside the state set" in check.reason


def loops_with_a_safe_set(seeds):
    for seed in seeds:
        loop = random_loop(seed, cuts=2, with_input=seed % 2 == 0, layers=1, limits=4.0)
        yield seed, loop, safe_set(loop, max_iterations=40)


def test_proven_sets_are_never_left_and_refuted_ones_are_left_by_their_witness():
    proven = refuted = 0
    for seed, loop, safe in loops_with_a_safe_set(range(16)):
        if safe.verdict == "proven":
            proven += 1
            assert check_rpi(loop, safe.set, tol=1e-9).verdict == "proven"
            x = safe.set.sample(np.random.default_rng(seed), 60)
            for k in range(6):
                x = random_successors(loop, np.vstack([x, safe.set.vertices()]), np.random.default_rng(k))
                assert safe.set.contains(x, tol=1e-9).all()
        small = (Polytope.box([-0.2, -0.3], [0.4, 0.1]) & loop.system.state_set).scale(0.9)
        check = check_rpi(loop, small)
        if check.verdict == "refuted":
            refuted += 1
            facet = int(np.argmax(small.H @ check.witness.states[-1] - small.h))
            assert small.H[facet] @ check.witness.states[-1] > small.h[facet]
            assert_replays(loop, small, small.H[facet], small.H[facet] @ check.witness.states[-1], check.witness)
            assert "mode" in check.reason and "d = " in check.reason
        else:
            assert (brute_support(loop, small, small.H) <= small.h + 1e-9).all()
    assert proven >= 3 and refuted >= 3


def test_set_whose_boundary_touches_a_jump_is_left_by_the_other_mode():
    loop = jump_loop([0.5, 0.0], [3.0, 0.0])
    assert check_rpi(loop, Polytope.box([0, -0.5], [0.999, 0.5])).verdict == "proven"
    check = check_rpi(loop, Polytope.box([0, -0.5], [1, 0.5]))
    assert check.verdict == "refuted" and check.witness.modes.tolist() == [1]


def answering(monkeypatch, bound, value, resolution=0.0):
    """Let every engine answer with the same bound and value along every row, without a witness."""

    def support(_loop, _F, V, **_options):
        k = len(V)
        return Support(np.full(k, value), np.full(k, bound), (None,) * k, resolution=np.full(k, resolution))

    monkeypatch.setattr("mireach.analysis.comparison.support", support)


@pytest.mark.parametrize(
    ("bound", "value", "verdict", "settled"),
    [
        (0.5, 0.5, "proven", "rounding counted"),
        (0.5 + 1e-9, 0.5, "proven", "to within 1e-06 of the size of X, rounding counted"),
        (0.5 + 1e-5, 0.4, "unknown", ""),
        (0.6, 0.55, "unknown", ""),  # what no step attains without rounding refutes nothing
    ],
)
def test_bounds_decide_a_proof_and_steps_a_refutation(monkeypatch, bound, value, verdict, settled):
    loop, F = contraction(n=3, p=np.zeros(3)), Polytope.box([-0.5] * 3, [0.5] * 3)
    answering(monkeypatch, bound, value, 1e-6)
    monkeypatch.setattr("mireach.analysis.comparison.FEW_CELLS", 0)
    check = check_rpi(loop, F, "milp")
    assert (check.verdict, check.settled) == (verdict, settled)


def test_a_safe_set_is_proven_by_bounds_and_not_by_attained_values(monkeypatch):
    loop = contraction(n=3, p=np.zeros(3))
    for bound, verdict in ((1.0, "proven"), (1.1, "unknown")):
        answering(monkeypatch, bound, 0.9)
        assert safe_set(loop, max_iterations=3).verdict == verdict


def test_a_wrong_word_of_a_solver_proves_no_safe_set(monkeypatch):
    """R_1(X) is [-0.05, 1.05] along x1; one that says 0.3 too little leads to F_1 = [0.25, 0.75], which is left."""
    loop = contraction(w=0.05, p=(0.5, 0.0))

    def lying(*args, engine, **_):
        found = mr.support(*args, engine=engine if engine == Exact() else "cells")
        return found if engine == Exact() else replace(found, bound=found.bound - 0.3, rests_on=SOLVER)

    monkeypatch.setattr("mireach.analysis.comparison.support", lying)
    found = safe_set(loop, BOX, "cvxpy", max_iterations=5)
    assert found.verdict == "unknown" and found.set is None and SOLVER in found.reason


def test_a_terminal_sequence_of_a_solver_says_so():
    pytest.importorskip("cvxpy")
    loop = contraction()
    assert terminal_set(loop, safe_set(loop, BOX), BOX, max_steps=2).settled == "rounding counted"
    assert "solver's word" in terminal_set(loop, safe_set(loop, BOX), BOX, engine="cvxpy", max_steps=2).settled


def test_exact_arithmetic_overrules_a_loose_bound_in_the_plane(monkeypatch):
    loop, F = contraction(), Polytope.box([-0.5, -0.5], [0.5, 0.5])  # its image has the half-width 0.35
    found = mr.support(loop, F, BOX)
    monkeypatch.setattr(
        "mireach.analysis.comparison.support",
        lambda *args, engine, **_: (
            mr.support(*args, engine=engine) if engine == Exact() else replace(found, bound=found.bound + 1)
        ),
    )
    check = check_rpi(loop, F)
    assert check.verdict == "proven" and check.settled == "exact arithmetic" and (check.margin > 0.14).all()


def test_stopped_solver_proves_nothing():
    engine = Milp(formulation="whole", bounds="interval", time_limit=1e-4)
    loop = random_loop(1, 3, cuts=3, with_input=True, layers=3, width=5, pool=4, gain=0.8)
    X = loop.system.state_set
    check = check_rpi(loop, X.scale(0.99), engine)
    assert check.verdict == "refuted" or (check.verdict == "unknown" and "time_limit" in check.reason)
    safe = safe_set(loop, engine=engine)
    assert safe.verdict == "unknown" and safe.set is None and "time_limit" in safe.reason


# -- safe_set -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("engine", ["cells", "milp"])
def test_safe_set_by_hand(engine):
    """x1+ = 0.5 x1 + 0.9 x2 leaves [-1, 1] from X, but not once |x2| <= 0.5."""
    safe = safe_set(affine_loop([[0.5, 0.9], [0, 0.5]]), BOX, engine)
    assert (safe.verdict, safe.iterations, len(safe.history)) == ("proven", 1, 2)
    np.testing.assert_allclose(safe.set.support(BOX), [1, 0.5, 1, 0.5], atol=1e-6)
    assert safe.history[-1] is safe.set and "R1(F1) lies in X" in safe.reason


def test_a_safe_set_is_bounded_by_bounds_whatever_is_attained(monkeypatch):
    """As above: F_1 is |x1| <= 1, |x2| <= 1/2, though the values that are said to be attained are 0.1 too low."""

    def support(*args, **options):
        found = mr.support(*args, **options)
        return replace(found, value=found.value - 0.1)

    monkeypatch.setattr("mireach.analysis.comparison.support", support)
    safe = safe_set(affine_loop([[0.5, 0.9], [0, 0.5]]), BOX)
    assert safe.verdict == "proven" and len(safe.history) == 2
    assert (safe.set.h >= [1, 0.5, 1, 0.5]).all() and (safe.set.h <= np.array([1, 0.5, 1, 0.5]) + 1e-9).all()


@pytest.mark.parametrize(("n", "a"), [(1, 0.5), (2, -0.7), (3, 0.5)])
def test_contraction_makes_all_of_the_state_set_safe(n, a):
    loop = contraction(a, 0.2, np.zeros(n), n=n)
    safe = safe_set(loop)
    assert safe.verdict == "proven" and safe.iterations == 0
    assert safe.set.is_subset(loop.system.state_set) and loop.system.state_set.is_subset(safe.set)


@pytest.mark.parametrize("engine", ["cells", "milp"])
def test_expansion_has_no_safe_set(engine):
    loop = affine_loop(2 * np.eye(2))
    safe = safe_set(loop, engine=engine)
    assert (safe.verdict, safe.set, safe.iterations) == ("refuted", None, 0) and "F1 = F0" in safe.reason
    end = safe.witness.states[-1]
    assert np.abs(end).max() == pytest.approx(2) and np.abs(safe.witness.states[0]).max() <= 1 + 1e-7


def test_map_out_of_the_state_set_has_no_safe_set():
    safe = safe_set(affine_loop(0.1 * np.eye(2), p=[5.0, 0]))
    assert (safe.verdict, safe.set) == ("refuted", None) and "F1 is empty" in safe.reason
    assert safe.witness.states[-1][0] > 1


def test_iteration_limit_is_said():
    loop = affine_loop([[0.5, 0.9], [0, 0.5]])
    safe = safe_set(loop, BOX, max_iterations=0)
    assert (safe.verdict, safe.set) == ("unknown", None) and "max_iterations = 0" in safe.reason


def test_row_of_the_state_set_that_stands_there_twice_counts_with_its_smaller_offset():
    loop = affine_loop(np.zeros((2, 2)), p=[1.5, 0])
    for h in ([1, 3, 1, 1, 1], [3, 1, 1, 1, 1]):
        X = Polytope([[1, 0], [1, 0], [-1, 0], [0, 1], [0, -1]], h)
        twice = ClosedLoop(PWASystem(loop.system.modes, X, loop.system.input_set), loop.network)
        assert safe_set(twice).set is None


def test_safe_sets_shrink_stay_in_the_state_set_and_keep_the_template():
    for _, loop, safe in loops_with_a_safe_set(range(6)):
        for before, after in zip(safe.history, safe.history[1:]):
            assert after.is_subset(before, tol=1e-9) and after.is_subset(loop.system.state_set)
        if safe.iterations:
            assert len(safe.history[-1].h) == 8


# -- safe_set with cut_first --------------------------------------------------------------------------


def test_cutting_first_needs_fewer_iterations_and_finds_more():
    """The double integrator as in notebook 10: its shipped network, and one for which eq. (21), Fk, finds no set."""
    case = mr.case_study("double_integrator")
    other = ClosedLoop(case.system, load_networks("double_integrator")[12])
    for loop, paper, cut in ((case.loop, ("proven", 29), 21), (other, ("refuted", 52), 23)):
        first, found = safe_set(loop, directions(8)), safe_set(loop, directions(8), cut_first=True)
        assert (first.verdict, first.iterations) == paper
        assert (found.verdict, found.iterations) == ("proven", cut)
        assert check_rpi(loop, found.set).verdict == "proven"
        for after, before, covered in zip(found.history[1:], found.history, first.history[1:]):
            assert after.is_subset(before) and after.is_subset(covered, tol=1e-9)


def test_cutting_first_changes_nothing_where_all_of_the_state_set_is_safe():
    found = safe_set(contraction(), BOX, cut_first=True)
    assert found.verdict == "proven" and found.iterations == 0


def test_cutting_first_does_not_depend_on_units():
    loop = random_loop(0)
    s, t = powers(np.random.default_rng(0), True)
    own, other = safe_set(loop, BOX, cut_first=True), safe_set(in_other_units(loop, s, t), BOX, cut_first=True)
    assert (own.verdict, own.iterations) == (other.verdict, other.iterations) and own.iterations > 0
    for F, G in zip(own.history, other.history):
        assert (F.bounding_box()[1] == G.bounding_box()[1] * s).all()


def test_cutting_first_without_a_set_says_why():
    found = safe_set(affine_loop(2 * np.eye(2), p=[1.5, 0]), BOX, cut_first=True)
    assert found.verdict == "refuted" and found.set is None and found.witness is not None


def test_a_wrong_bound_within_the_state_set_proves_nothing():
    """R_1(X) is [-0.05, 1.05] along x1; with 0.3 too little F_1 is [0.25, 0.7], which is left."""

    class Lying(Cells):
        def cut_support(self, loop, F, V):
            return super().cut_support(loop, F, V) - 0.3

    found = safe_set(contraction(w=0.05, p=(0.5, 0.0)), BOX, Lying(), max_iterations=5, cut_first=True)
    assert found.verdict == "unknown" and found.set is None and "was wrong" in found.reason


@pytest.mark.parametrize(("n", "engine"), [(2, "milp"), (2, "exact"), (3, "milp")])
def test_engines_that_cannot_cut_first_are_named(n, engine):
    with pytest.raises(ValueError, match=r"cannot cut first.*cells"):
        safe_set(contraction(n=n, p=np.zeros(n)), engine=engine, cut_first=True)
    with pytest.raises(ValueError, match="cut_support"):
        cut_support(contraction(n=n, p=np.zeros(n)), Polytope.box(-np.ones(n), np.ones(n)), box_directions(n), engine)


# -- terminal_set -------------------------------------------------------------------------------------


@pytest.mark.parametrize(("n", "engine"), [(2, "cells"), (2, "milp"), (1, "milp"), (3, "milp")])
@pytest.mark.parametrize(("a", "w", "epsilon"), [(0.5, 0.1, 1e-2), (-0.6, 0.2, 1e-1)])
def test_terminal_set_of_a_contraction_by_hand(n, engine, a, w, epsilon):
    loop = contraction(a, w, np.zeros(n), n=n)
    r = half_widths(abs(a), w, 60)
    k = int(np.argmax(r[1:] <= (1 + epsilon) * w / (1 - abs(a)))) + 1
    found = terminal_set(loop, safe_set(loop), box_directions(n), epsilon, engine=engine)
    assert found.criterion and found.steps == k and len(found.history) == k + 1
    np.testing.assert_allclose([R.h for R in found.history], np.outer(r[: k + 1], np.ones(2 * n)), atol=2e-5)
    np.testing.assert_allclose(found.alphas, r[:k] / r[1 : k + 1], rtol=1e-4)
    assert found.alpha == found.alphas[-1] and found.stable and found.stable_steps == list(range(1, k + 1))
    assert found.delta_max == pytest.approx((r[k - 1] / r[k] - 1) * r[k], rel=1e-2)
    assert f"holds at k = {k}" in found.reason


@pytest.mark.parametrize("length", [0.1, 10])
def test_delta_max_is_a_distance_whatever_the_length_of_the_rows(length):
    loop = contraction()
    plain = terminal_set(loop, safe_set(loop), BOX, 1e-2)
    scaled = terminal_set(loop, safe_set(loop), length * BOX, 1e-2)
    assert scaled.steps == plain.steps and scaled.delta_max == pytest.approx(plain.delta_max, rel=1e-6)


def test_criterion_fails_about_the_origin_and_holds_about_the_equilibrium():
    """The limit is c + [-0.2, 0.2]^2 with c = (0.6, 0.5): the origin lies outside."""
    loop, c, epsilon = contraction(p=[0.3, 0.25]), np.array([0.6, 0.5]), 1e-2
    safe = safe_set(loop)
    about_origin = terminal_set(loop, safe, BOX, epsilon)
    assert not about_origin.criterion and "stagnation" in about_origin.reason and "equilibrium" in about_origin.reason
    assert about_origin.alpha != about_origin.alpha and not about_origin.stable
    np.testing.assert_allclose(about_origin.set.support(BOX), [0.8, 0.7, -0.4, -0.3], atol=1e-9)

    low, high, k = -np.ones(2), np.ones(2), 0
    while not k or max((c - low).max(), (high - c).max()) > (1 + epsilon) * 0.2:
        low, high, k = 0.5 * low + c / 2 - 0.1, 0.5 * high + c / 2 + 0.1, k + 1
    for centre in ("equilibrium", c):
        found = terminal_set(loop, safe, BOX, epsilon, centre)
        assert found.criterion and found.steps == k
        np.testing.assert_allclose(found.centre, c, atol=1e-9)
        np.testing.assert_allclose(found.set.support(BOX), [*high, *-low], atol=1e-9)


def test_step_limit_is_said():
    loop = contraction(0.9, 0.01)
    found = terminal_set(loop, safe_set(loop), max_steps=3)
    assert not found.criterion and found.steps == 3 and "max_steps = 3" in found.reason and len(found.alphas) == 3


@pytest.mark.parametrize("angle", [0.3, 1.1, 2.0, 2.9])
def test_fixed_point_of_the_sequence_is_not_called_stable(angle):
    turn = 0.6 * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    loop = affine_loop(turn, Polytope.box([-0.07, -0.11], [0.05, 0.09]))
    found = terminal_set(loop, Polytope.box([-0.9, -0.9], [0.9, 0.9]), epsilon=1e-15)
    assert not found.criterion and "stagnation" in found.reason
    assert found.alpha == 1 and not found.stable and found.delta_max == 0
    assert found.stable_steps and max(found.stable_steps) < found.steps


def test_no_rounding_makes_a_set_grow_into_itself():
    rng = np.random.default_rng(0)
    for _ in range(200):
        angles = np.array([0, 2, 4]) + rng.uniform(0, 0.5, 3)
        R = Polytope(np.column_stack([np.cos(angles), np.sin(angles)]), rng.uniform(0.5, 2, 3))
        assert growth(R.H, R.bound(R.H), R.h, np.zeros(2)) == 1


def test_terminal_sets_of_random_loops_are_invariant_reached_and_near_the_limit():
    """The criterion, evaluated by brute force: it holds at the last step, and not at the one before."""
    seen = 0
    for seed, loop, safe in loops_with_a_safe_set(range(16)):
        if safe.verdict != "proven":
            continue
        try:
            centre = loop.equilibrium()
        except ValueError:
            continue
        found = terminal_set(loop, safe, epsilon=1e-2, centre=centre, max_steps=60)
        assert check_rpi(loop, found.set, tol=1e-9).verdict == "proven"
        x = safe.set.sample(np.random.default_rng(seed), 40)
        for _ in range(found.steps):
            x = random_successors(loop, x, np.random.default_rng(0))
        assert found.set.contains(x, tol=1e-9).all()
        if not found.criterion:
            continue
        seen += 1
        for R, holds in ((found.history[-1], True), (found.history[-2], False))[: 1 + (found.steps > 1)]:
            S = Polytope(R.H, (R.h - R.H @ centre) / 1.01 + R.H @ centre)
            V = found.set.H
            needed = np.array([largest(v, S.H, S.h) for v in V])
            assert (needed <= brute_support(loop, S, V) + (1e-9 if holds else -1e-9)).all() == holds
    assert seen >= 2


def test_rows_of_the_safe_set_that_the_template_lacks_are_kept():
    loop = affine_loop([[0.5, 0.4], [-0.4, 0.5]], Polytope.box([-0.05, -0.05], [0.05, 0.05]))
    octagon = Polytope(directions(8), 0.9 * np.ones(8))
    found = terminal_set(loop, octagon, BOX, 1e-2)
    assert found.set.H.shape == (8, 2) and found.criterion
    for before, after in zip(found.history, found.history[1:]):
        assert after.is_subset(before, tol=1e-9) and check_rpi(loop, after, tol=1e-9).verdict == "proven"


def test_alpha_is_the_largest_factor_that_keeps_the_set_inside_the_one_before():
    loop = affine_loop([[0.5, 0.4], [-0.4, 0.5]], Polytope.box([-0.05, -0.02], [0.04, 0.05]))
    found = terminal_set(loop, Polytope(directions(8), 0.9 * np.ones(8)), epsilon=1e-2)
    for before, after, alpha in zip(found.history, found.history[1:], found.alphas):
        corners = after.vertices()
        assert before.contains(alpha * (1 - 1e-7) * corners).all()
        assert not before.contains(alpha * (1 + 1e-7) * corners).all()
    ball = np.array([[np.cos(t), np.sin(t)] for t in np.linspace(0, 2 * np.pi, 100)])
    grown = found.set.scale(found.alpha)
    corners = found.set.vertices()[:, None]
    assert grown.contains(corners + 0.999 * found.delta_max * ball).all()
    assert not grown.contains(corners + 1.001 * found.delta_max * directions(8)).all()


def test_alpha_is_rounded_down():
    rng = np.random.default_rng(3)
    for _ in range(60):
        h, before, c = rng.uniform(0.5, 2, 4), rng.uniform(0.5, 2, 4), rng.uniform(-0.4, 0.4, 2)
        middle = [Fraction(s * e) for s, e in zip((1, 1, -1, -1), (*c.tolist(), *c.tolist()))]
        rooms = [(Fraction(b) - m, Fraction(o) - m) for b, o, m in zip(before.tolist(), h.tolist(), middle)]
        exactly, alpha = min(room / size for room, size in rooms), growth(BOX, h, before, c)
        assert Fraction(alpha) <= exactly < Fraction(np.nextafter(alpha, np.inf))


@pytest.mark.parametrize("distance", [0.0, 1.0, 1e4, 1e8])
def test_alpha_is_the_smallest_of_ratios_that_floats_cannot_tell_apart(distance):
    rng = np.random.default_rng(4)
    for _ in range(60):
        V, c = rng.normal(size=(6, 2)), distance * rng.normal(size=2)
        h = V @ c + rng.uniform(0.5, 2, 6)
        before = V @ c + 3 * (h - V @ c) + rng.integers(-2, 3, 6) * np.spacing(distance + 1)
        ratios = []
        for v, b, o in zip(V.tolist(), before.tolist(), h.tolist()):
            middle = sum(Fraction(a) * Fraction(y) for a, y in zip(v, c.tolist()))
            ratios.append((Fraction(b) - middle) / (Fraction(o) - middle))
        alpha = growth(V, h, before, c)
        assert Fraction(alpha) <= min(ratios) < Fraction(np.nextafter(alpha, np.inf))


def test_a_terminal_sequence_loses_nothing_of_f_max_by_rounding():
    """R_1(F) = F for x+ = x: every set of the sequence holds the corners of F, in fractions."""
    F, C = Polytope.box([-0.9, -0.7], [0.8, 0.6]), np.random.default_rng(0).normal(size=(24, 2))
    found = terminal_set(affine_loop(np.eye(2)), F, C, max_steps=3)
    for R in found.history:
        for a, b in zip(R.H.tolist(), R.h.tolist()):
            ends = [
                Fraction(a[0]) * Fraction(x) + Fraction(a[1]) * Fraction(y) for x in (-0.9, 0.8) for y in (-0.7, 0.6)
            ]
            assert max(ends) <= Fraction(b)


# -- scaled_minimal_set -------------------------------------------------------------------------------


@pytest.mark.parametrize(("a", "w", "epsilon"), [(0.5, 0.1, 1e-2), (0.8, 0.05, 1e-1)])
def test_scaled_minimal_set_by_hand(a, w, epsilon):
    loop, limit = contraction(a, w), w / (1 - a)
    k = next(k for k in range(1, 200) if (1 + epsilon) * (1 - a**k) >= 1)
    size = (1 + epsilon) * limit * (1 - a**k)
    found = scaled_minimal_set(loop, BOX, epsilon, safe=safe_set(loop))
    assert (found.verdict, found.steps) == ("proven", k)
    np.testing.assert_allclose(found.set.h, size, atol=1e-9)
    assert found.reached_at == next(j for j, r in enumerate(half_widths(a, w, 200)) if r <= size)
    assert check_rpi(loop, found.set).verdict == "proven"


def test_minimal_set_that_is_not_reached_is_not_called_reached():
    """Two modes, each of which keeps its half-plane: the right one never comes to the origin."""
    loop = jump_loop([0.0, 0.0], [2.0, 0.0], [Polytope.box([-0.1, -0.1], [0.1, 0.1])] * 2)
    found = scaled_minimal_set(loop, BOX, 1e-2, safe=safe_set(loop, BOX))
    assert found.verdict == "proven" and found.reached_at is None
    np.testing.assert_allclose(found.set.h, 0.101, atol=1e-9)


def test_minimal_set_that_leaves_the_state_set_is_unknown():
    found = scaled_minimal_set(contraction(0.9, 0.2), BOX)
    assert (found.verdict, found.set) == ("unknown", None) and "leaves the state set" in found.reason
    found = scaled_minimal_set(contraction(0.5, 0.1), BOX, max_steps=1)
    assert found.verdict == "unknown" and "max_steps = 1" in found.reason


# -- ultimately_bounded -------------------------------------------------------------------------------


@pytest.mark.parametrize(("curvature", "verdict"), [(0.09, "proven"), (0.11, "unknown")])
def test_ultimate_bound_needs_disturbances_that_hold_the_error(curvature, verdict):
    """The error of x+ = 0.5 x + c x^2 is c x^2 on |x| <= 1; D = [-0.1, 0.1]^2."""
    loop = contraction(limits=1.0)
    plant = NonlinearSystem(
        lambda x, u: tuple(0.5 * x[i] + curvature * x[i] ** 2 for i in (0, 1)),
        loop.system.state_set,
        loop.system.input_set,
    )
    safe = safe_set(loop)
    found = ultimately_bounded(plant, loop, safe, terminal_set(loop, safe))
    assert found.verdict == verdict
    assert [text for text, holds in found.conditions.items() if not holds] == (
        [] if verdict == "proven" else ["f - f_PWA lies in D for every mode"]
    )


def test_ultimate_bound_needs_a_plant_that_may_be_in_all_of_the_safe_set():
    loop = contraction()
    plant = NonlinearSystem(
        lambda x, u: (0.5 * x[0], 0.5 * x[1]), Polytope.box([-0.5, -1], [1, 1]), loop.system.input_set
    )
    safe = safe_set(loop)
    assert ultimately_bounded(plant, loop, safe, terminal_set(loop, safe)).verdict == "unknown"


# -- what a proof of Theorem 2 may rest on --------------------------------------------------------------


@pytest.mark.parametrize(
    ("limits", "verdict"),
    [
        ((0.75, 0.5, 0.375), "proven"),
        ((0.625,), "proven"),
        ((0.5,), "unknown"),  # R_1(F_max) is the box of 0.6
        ((0.75, 0.375), "unknown"),  # 0.75 goes to 0.475
        ((0.625, 0.8), "unknown"),  # the images fit, but the sets are not nested
        ((0.625, 0.63, 0.5), "unknown"),
    ],
)
def test_theorem_2_needs_nested_sets_that_hold_the_image_of_the_one_before(limits, verdict):
    """x+ = x / 2 + d with |d| <= 0.1 takes the box of half-width r to that of r / 2 + 0.1; F_max is X, of 1."""
    loop = contraction()
    plant = NonlinearSystem(lambda x, u: (0.5 * x[0], 0.5 * x[1]), loop.system.state_set, loop.system.input_set)
    safe = safe_set(loop, BOX)
    history = [safe.set, *(Polytope(BOX, np.full(4, r)) for r in limits)]
    terminal = replace(terminal_set(loop, safe, BOX), set=history[-1], steps=len(limits), history=history)
    found = ultimately_bounded(plant, loop, safe, terminal)
    assert found.verdict == verdict
    assert [text for text, holds in found.conditions.items() if not holds] == (
        [] if verdict == "proven" else ["the terminal set is reached from F_max"]
    )


@pytest.mark.parametrize(
    ("bound", "invariant", "reached"), [(0.35, True, True), (0.75, True, False), (1.5, False, False)]
)
def test_theorem_2_rests_on_bounds_and_not_on_attained_values(monkeypatch, bound, invariant, reached):
    loop = contraction(n=3, p=np.zeros(3))
    plant = NonlinearSystem(lambda x, u: [0.5 * x[i] for i in range(3)], loop.system.state_set, loop.system.input_set)
    safe = safe_set(loop)
    half = Polytope.box([-0.5] * 3, [0.5] * 3)
    terminal = replace(terminal_set(loop, safe), set=half, history=[safe.set, half])
    answering(monkeypatch, bound, 0.0)
    found = ultimately_bounded(plant, loop, safe, terminal)
    assert found.conditions["F_max is RPI"] == invariant
    assert found.conditions["the terminal set is reached from F_max"] == reached
    assert (found.verdict == "proven") == reached


# -- bad input ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("ask", "words"),
    [
        (lambda loop, F: safe_set(loop, np.eye(3)), ["C has 3 columns", "2 entries"]),
        (lambda loop, F: safe_set(loop, [[1.0, 0], [0, 0]]), ["C has a row of zeros"]),
        (lambda loop, F: safe_set(loop, [[np.inf, 0]]), ["C must be finite"]),
        (lambda loop, F: safe_set(loop, engine="magic"), ["engine must be one of", "'magic'"]),
        (lambda loop, F: terminal_set(loop, F, epsilon=0), ["epsilon must be positive", "0"]),
        (lambda loop, F: terminal_set(loop, F, max_steps=0), ["max_steps must be a whole number of at least 1", "0"]),
        (lambda loop, F: terminal_set(loop, F, centre="middle"), ["centre must be", "'middle'"]),
        (lambda loop, F: terminal_set(loop, F, centre=[1.0]), ["centre has 1 entries", "2"]),
        (lambda loop, F: terminal_set(loop, F.scale(0.1)), ["not shown to be RPI"]),
        (lambda loop, F: scaled_minimal_set(loop, epsilon=-1), ["epsilon must be positive", "-1"]),
        (lambda loop, F: scaled_minimal_set(loop, max_steps=0), ["max_steps must be a whole number of at least 1"]),
        (
            lambda loop, F: terminal_set(affine_loop(2 * np.eye(2)), safe_set(affine_loop(2 * np.eye(2)))),
            ["no safe set to start from", "leaves X"],
        ),
        (lambda loop, F: check_rpi(loop, Polytope.box([0], [1])), ["R^1", "R^2"]),
    ],
)
def test_bad_arguments_are_named(ask, words):
    with pytest.raises(ValueError) as error:
        ask(contraction(), Polytope.box([-1, -1], [1, 1]))
    assert all(word in str(error.value) for word in words), str(error.value)


def test_terminal_set_refuses_the_safe_set_of_another_loop():
    case = mr.case_study("pwa")
    safe = mr.safe_set(case.loop, case.directions)
    stronger = case.loop.with_disturbance(mr.Polytope.box([-3, -3], [3, 3]))
    with pytest.raises(ValueError, match="not shown to be RPI for this loop"):
        mr.terminal_set(stronger, safe, case.directions)


def test_theorem_2_does_not_trust_sets_of_another_loop():
    case = mr.case_study("double_integrator")
    weaker = case.loop.with_disturbance(mr.Polytope.box([-0.01, -0.01], [0.01, 0.01]))
    safe = mr.safe_set(weaker, case.directions)
    terminal = mr.terminal_set(weaker, safe, case.directions, centre="equilibrium")
    found = mr.ultimately_bounded(case.plant, case.loop, safe, terminal)
    assert found.verdict == "unknown"
    assert not found.conditions["the terminal set is reached from F_max"]


def test_contraction_is_nan_about_a_centre_outside():
    case = mr.case_study("pwa")
    safe = mr.safe_set(case.loop, case.directions)
    assert np.isnan(mr.contraction(case.loop, safe.set, [30, 0]))


@pytest.mark.parametrize("wrong", [-1, 1.5, "a", None])
def test_safe_set_names_a_wrong_limit(wrong):
    with pytest.raises(ValueError, match="max_iterations must be a whole number"):
        mr.safe_set(mr.case_study("pwa").loop, max_iterations=wrong)


@pytest.mark.parametrize("n", [2, 3, 4])
def test_a_set_that_fits_without_any_margin_is_proven_and_one_rounding_more_is_refuted(n):
    F = Polytope.box(-np.ones(n), np.ones(n))
    fits = check_rpi(affine_loop(np.eye(n), limits=2.0), F)
    assert fits.verdict == "proven" and (fits.margin >= 0).all() and "to within" not in fits.settled
    leaves = check_rpi(affine_loop((1 + 2.0**-52) * np.eye(n), limits=2.0), F)
    assert leaves.verdict == "refuted" and max(map(abs, leaves.escape.after)) == 1 + Fraction(2) ** -52


def test_options_must_be_true_or_false():
    loop = mr.case_study("pwa").loop
    for option in ({"cut_first": "no"}, {"progress": 1}):
        with pytest.raises(TypeError, match="must be True or False"):
            mr.safe_set(loop, **option)
    with pytest.raises(TypeError, match="prove must be True or False"):
        mr.maximal_safe_set(loop, prove="no")
