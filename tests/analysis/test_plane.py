"""What all computations in the plane share: units, checks of arguments, and results that can be pickled."""

import json
import pickle

import numpy as np
import pytest
from loops import affine_loop, assert_escapes, narrow_spike, random_loop
from regions import assert_same, in_other_units, powers, rescaled, square, triangles_of

import mireach as mr
from mireach.analysis.maximal_set import carried_out

QUICK = (0, 1, 4, 6)  # seeds of random loops that have a maximal set with few corners


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
    assert_same(carried_out(loop, S), carried_out(other, rescaled(S, s)), s)
    check, check_other = mr.prove_rpi(loop, S), mr.prove_rpi(other, rescaled(S, s))
    assert check.verdict == check_other.verdict and check.settled == "exact arithmetic"
    if check.verdict == "refuted":
        assert_escapes(other, triangles_of(rescaled(S, s)), check_other.witness.exact)
        assert_escapes(loop, triangles_of(S), check.witness.exact)
    if own.set is not None:
        settled = mr.attractor(loop, own, tolerance=0.1, max_steps=4)
        settled_other = mr.attractor(other, its, tolerance=0.1 / s, max_steps=4)
        assert (settled.steps, settled.settled) == (settled_other.steps, settled_other.settled)
        assert np.array_equal(settled.added, settled_other.added * s)
        for R, R_other in zip(settled.history, settled_other.history):
            assert_same(R, R_other, s)


@pytest.mark.parametrize(
    "ask",
    [
        mr.maximal_safe_set,
        lambda loop: carried_out(loop, square(1)),
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


def test_results_read_back_from_json():
    loop = affine_loop(0.5 * np.eye(2), square(0.1))
    found = mr.maximal_safe_set(loop)
    settled, check = mr.attractor(loop, found), mr.prove_rpi(loop, square(0.1))
    largest = mr.largest_disturbance(loop, "template", largest=0.25)
    for result in (found, settled, check, largest, mr.maximal_safe_set(affine_loop(1.5 * np.eye(2), square(0.1)))):
        again = type(result).from_dict(json.loads(json.dumps(result.to_dict())))
        assert str(again) == str(result) and "\n" not in str(result)
    again = mr.MaximalSafeSet.from_dict(json.loads(json.dumps(found.to_dict())))
    assert again.set.equals(found.set) and again.verdict is mr.Verdict.PROVEN and again.given_up == found.given_up
    assert check.verdict is mr.Verdict.REFUTED and str(largest).startswith("largest disturbance: yes at 0.25")


def test_answers_pickle():
    loop = affine_loop(0.5 * np.eye(2), square(0.1))
    found = mr.maximal_safe_set(loop)
    again = pickle.loads(pickle.dumps(found))
    assert again.settled == "exact arithmetic" and again.set.area == found.set.area
    for answer in (mr.prove_rpi(loop, square(0.1)), mr.attractor(loop, found), mr.exact_reach(loop, square(1), 1)):
        assert repr(pickle.loads(pickle.dumps(answer)))[:40] == repr(answer)[:40]
    assert mr.prove_rpi(loop, square(0.1)).verdict == "refuted" and found.verdict == "proven"
