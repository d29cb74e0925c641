"""Bounds over boxes against sampled trajectories, and the formulations of the MILP against each other and the cells."""

import numpy as np
import pytest
from loops import random_loop, random_network

from mireach import Polytope, Support, directions, safe_set
from mireach.engines.bounds import upper_bound
from mireach.engines.boxes import Boxes, bound_loop
from mireach.engines.exact import Exact
from mireach.engines.milp.engine import Milp
from mireach.engines.milp.formulation import add_network
from mireach.solvers.linear_program import LinearProgram

ROUNDING = 1e-9


def random_boxes(rng, limits, count):
    """Boxes of all sizes inside of [-limits, limits], one of them a point."""
    ends = np.sort(rng.uniform(-1, 1, (2, count, len(limits))), axis=0) * limits
    ends[1] = ends[0] + (ends[1] - ends[0]) * 10.0 ** rng.uniform(-3, 0, (count, 1))
    ends[1, 0] = ends[0, 0]
    return Boxes(*ends)


def some_loop(seed, n):
    return random_loop(seed, n, 1 + seed % 2, cuts=3, with_input=seed % 2 == 0, layers=2, width=3, pool=2 + seed % 3)


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("steps", [1, 2])
def test_no_trajectory_from_a_box_passes_its_bounds(n, steps):
    for seed in range(3):
        rng, loop = np.random.default_rng(seed), some_loop(seed, n)
        X, V = loop.system.state_set, np.random.default_rng(seed).normal(size=(3, n))
        d = np.abs([mode.disturbance.bounding_box() for mode in loop.system.modes]).max()
        limits = np.concatenate([X.h[:n], np.full(n * (steps - 1), d)])
        boxes = random_boxes(rng, limits, 6)
        found = bound_loop(loop, boxes, steps)
        spread = np.array([mode.disturbance.support(V) for mode in loop.system.modes])
        highest, inputs = found.highest_state(loop, V, spread), found.highest_input(np.eye(loop.system.input_size))
        for b in range(len(boxes)):
            w = rng.uniform(boxes.lower[b], boxes.upper[b], (15, len(limits)))
            x = w[:, :n][X.contains(w[:, :n])]
            assert (loop.network(x) <= inputs[b] + ROUNDING).all()
            for x, d in zip(w[:, :n], np.split(w[:, n:], max(steps - 1, 1), axis=1)[0]):
                for j in range(steps):
                    if not X.contains(x):
                        break
                    assert (x <= found.steps[j].state.most[:, b] + ROUNDING).all()
                    u = loop.network(x)
                    for i in np.flatnonzero(loop.system.violation(x[None], u[None])[0] <= 0):
                        assert found.steps[j].met[i, b]
                        mode = loop.system.modes[i]
                    after = mode.successor(x, u)
                    if j + 1 == steps:
                        assert (V @ after + mode.disturbance.support(V) <= highest[b] + ROUNDING).all()
                    else:
                        x = after + d


@pytest.mark.parametrize("seed", range(6))
def test_channels_left_out_never_win_on_their_box(seed):
    rng, loop = np.random.default_rng(seed), some_loop(seed, 2)
    boxes = random_boxes(rng, loop.system.state_set.h[:2], 20)
    (step,) = bound_loop(loop, boxes).steps
    for b in range(len(boxes)):
        q = rng.uniform(boxes.lower[b], boxes.upper[b], (50, 2))
        for layer, bound in zip(loop.network.hidden, step.layers):
            z = layer.channels(q)
            q = z.max(axis=-1)
            best_left = np.where(bound.alive[:, :, b], z, -np.inf).max(axis=-1)
            assert (best_left >= q - ROUNDING).all()
            assert (z[..., :, None] - z[..., None, :] <= bound.ahead[..., b] + ROUNDING).all()
            assert (q <= bound.most[:, b] + ROUNDING).all() and (q >= bound.least[:, b] - ROUNDING).all()


def test_bounds_are_exact_where_one_channel_wins():
    loop = some_loop(1, 2)
    middle = np.array([[0.1234, -0.4321]])
    found = bound_loop(loop, Boxes(middle - 1e-7, middle + 1e-7))
    assert found.binaries[0] == 0
    assert found.steps[0].inputs.most[:, 0] == pytest.approx(loop.network(middle[0]), abs=1e-5)


@pytest.mark.parametrize("method", ["interval", "lp", "tight"])
def test_output_bounds_hold_and_shrink_with_effort(method):
    rng = np.random.default_rng(0)
    for _ in range(3):
        net = random_network(rng, 2, 1, layers=3, width=3, pool=3)
        lp = LinearProgram()
        x = lp.add_columns([-1, -1], [1, 1])
        u = add_network(lp, net, x, method)
        states = rng.uniform(-1, 1, (2000, 2))
        most = upper_bound(lp, u, [1.0], 0.0, method)
        assert (net(states) <= most).all()
        if method == "tight" and lp.upper[u[0]] > 0:
            best = lp.maximize_integer(u, [1.0]).bound
            assert best <= most + 1e-6 and net(states).max() == pytest.approx(best, abs=0.1)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"jobs": 2},
        {"bounds": "interval"},
        {"bounds": "tight"},
        {"formulation": "whole"},
        {"formulation": "whole", "bounds": "interval"},
        {"formulation": "whole", "bounds": "tight"},
        {"formulation": "paper"},
    ],
    ids=str,
)
def test_formulations_agree_with_the_exact_cells(options):
    V = directions(5)
    for seed in range(3):
        loop = random_loop(seed, m=1 + seed % 2, cuts=3, with_input=seed % 2 == 0, width=3, pool=3)
        for F in (loop.system.state_set, Polytope.box([0.2, -0.4], [0.2, 0.7]), Polytope.box([0.1, 0.1], [0.1, 0.1])):
            truth, found = Exact().support(loop, F, V).value, Milp(**options).support(loop, F, V)
            assert (found.bound >= truth).all() and (found.bound <= truth + 1e-6 * (1 + np.abs(truth))).all()
            np.testing.assert_allclose(found.value, truth, atol=1e-6)


@pytest.mark.parametrize("n", [2, 3])
@pytest.mark.parametrize("formulation", ["split", "whole"])
@pytest.mark.parametrize("seed", range(4))
def test_threads_change_no_number(seed, formulation, n):
    loop = random_loop(seed, n=n, cuts=3, with_input=True, width=4, pool=3)
    X, V = loop.system.state_set, np.random.default_rng(seed).normal(size=(8, n))
    one, two = (Milp(jobs=jobs, formulation=formulation).support(loop, X, V) for jobs in (1, 3))
    assert (one.bound == two.bound).all() and (one.value == two.value).all()


@pytest.mark.parametrize("seed", range(5))
def test_cutoff_proves_what_is_below_and_nothing_else(seed):
    rng, loop, V = np.random.default_rng(seed), random_loop(seed, cuts=3, width=4, pool=3), directions(8)
    truth = Exact().support(loop, loop.system.state_set, V).value
    cutoff = truth + rng.choice([-0.5, -1e-5, 1e-5, 0.5, 5.0], 8)
    found = Milp().support(loop, loop.system.state_set, V, cutoff=cutoff)
    assert (found.bound >= truth).all()
    assert ((found.bound <= cutoff) == (truth <= cutoff)).all()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"formulation": "plain"}, ["formulation must be one of", "'plain'"]),
        ({"jobs": 0}, ["jobs", "at least 1"]),
    ],
)
def test_bad_options_are_named(options, words):
    with pytest.raises(ValueError) as error:
        Milp(**options)
    assert all(word in str(error.value) for word in words), str(error.value)


@pytest.mark.parametrize("formulation", ["split", "whole"])
def test_bounds_that_hold_already_are_kept_and_nothing_is_lost(formulation):
    for seed in range(4):
        loop = random_loop(seed)
        X, V = loop.system.state_set, directions(6)
        whole = Milp().support(loop, X, V)
        for F in (X, X.scale(0.6)):
            fresh = Milp(formulation=formulation).support(loop, F, V)
            for known in (Support(whole.value, whole.bound, whole.witness), whole):
                warm = Milp(formulation=formulation).support(loop, F, V, warm_start=known)
                assert (warm.bound <= whole.bound).all()
                np.testing.assert_allclose(warm.bound, fresh.bound, atol=1e-6)
                assert (warm.bound >= Exact().support(loop, F, V).value - 1e-9).all()


@pytest.mark.parametrize("seed", range(6))
def test_boxes_of_larger_sets_hold_all_that_starts_in_smaller_ones(seed):
    """From set to set of a random shrinking sequence: the boxes cover F, and their bounds hold for sampled images."""
    rng, loop, V = np.random.default_rng(seed), random_loop(seed, cuts=3, with_input=seed % 2 == 0), directions(6)
    F, known = loop.system.state_set, None
    for _ in range(5):
        known = Milp().support(loop, F, V, warm_start=known)
        truth = Exact().support(loop, F, V).value
        assert (known.bound >= truth).all() and (known.bound <= truth + 1e-6).all()
        for x in F.sample(rng, 40):
            held = ((known.boxes.lower <= x) & (x <= known.boxes.upper)).all(axis=1)
            reached = Exact().support(loop, Polytope.box(x, x), V).value
            assert held.any() and (known.upper[held].max(axis=0) >= reached).all()
        F = F & Polytope(rng.normal(size=(2, 2)), rng.uniform(0.3, 1.0, 2))


@pytest.mark.parametrize("seed", [1, 4, 6])
def test_sequences_by_the_milp_agree_with_those_by_cells(seed):
    loop = random_loop(seed, kinds=("box",), gain=0.3)
    found, expected = (safe_set(loop, engine=engine, max_iterations=8) for engine in ("milp", "cells"))
    assert found.verdict == expected.verdict and len(found.history) == len(expected.history)
    for F, G in zip(found.history, expected.history):
        np.testing.assert_allclose(F.support(F.H), G.support(F.H), atol=1e-5)
