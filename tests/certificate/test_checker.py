"""The checker of certificates as its adversaries see it: edges, hostile files, mutations that an oracle judges."""

import json
import subprocess
import sys
import time
import tracemalloc
from collections import Counter
from dataclasses import replace
from fractions import Fraction
from itertools import combinations_with_replacement, pairwise, product
from pathlib import Path

import numpy as np
import pytest
from certificates import (
    CASE_CHANGES,
    CASE_MUTATIONS,
    MUTATIONS,
    STRANGE,
    corners_of,
    dot,
    false_claims,
    get,
    growth_of,
    holds,
    nodes,
    outcome,
    put,
    random_certificate,
    small_world,
    uncovered,
    with_cases,
)

from mireach.__main__ import main
from mireach.certificate import checker

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = {name: ROOT / "data" / name / "certificate.json" for name in ("pwa", "double_integrator")}
SQUARE = [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]]
WORLDS = 120  # small contents whose every verdict is found by brute force
SHIPPED_SEEDS = {"pwa": 2, "double_integrator": 1}  # mutations of each of some kinds


# -- contents by hand ---------------------------------------------------------------------------------


def box(r):
    """{x : |x|_inf <= r} of the plane."""
    return {"H": SQUARE, "h": [r] * 4}


def mode(A=((0.5, 0.0), (0.0, 0.5)), p=(0.0, 0.0), region=((0.0, 0.0, 0.0), 1.0), D=None):
    """A mode whose input has no effect, with one row of region."""
    rows = [region] if isinstance(region[1], float) else region
    return {
        "A": [list(row) for row in A],
        "B": [[0.0], [0.0]],
        "p": list(p),
        "region": {"H": [list(a) for a, _ in rows], "h": [b for _, b in rows]},
        "disturbance": box(0.0) if D is None else D,
    }


def content(*modes, F=(1.0, 1.0, 1.0, 1.0), X=None, later=(), **claims):
    """A certificate of Phi = 0 and a square template; `later` are the sets after F."""
    X = box(1.0) if X is None else X
    sets = [list(F), *map(list, later)]
    found = {"inputs": {}, "safe_set": {}}
    if later:
        found["sequence"], found["terminal_set"] = {}, {"steps": len(later)}
        found["criterion"] = {"epsilon": 0.1, "centre": [0.0, 0.0], "holds": True}
        found["theorem_1"] = {"alpha": "1", "centre": [0.0, 0.0], "stable": False}
    return {
        "format": checker.FORMAT,
        "system": {
            "modes": list(modes or (mode(),)),
            "state_set": X,
            "input_set": {"H": [[1.0], [-1.0]], "h": [1.0, 1.0]},
        },
        "network": {
            "format": checker.NETWORK,
            "hidden": [],
            "output": {"weight": [[0.0, 0.0]], "bias": [0.0]},
        },
        "template": SQUARE,
        "sets": sets,
        "claims": {name: {"verdict": "proven", **claim, **claims.get(name, {})} for name, claim in found.items()},
    }


def check(value, **options):
    """The results of a content, by claim."""
    report = checker.check(checker.parse(json.dumps(value)), **options)
    return {result.claim: result for result in report.results}


def verdict(value, claim="safe_set"):
    return check(value)[claim].verdict


# -- all verdicts, by brute force ---------------------------------------------------------------------


@pytest.mark.parametrize(("n", "seeds"), [(1, 40), (2, WORLDS), (3, 5)])
def test_every_verdict_is_that_of_brute_force_and_every_witness_replays(n, seeds):
    for seed in range(seeds):
        world = small_world(seed, n)
        for claim, found in check(world.content).items():
            assert found.verdict == world.verdict(claim), (seed, claim, found)
            assert found.witness is None or world.replays(claim, found.witness), (seed, claim, found)


@pytest.mark.parametrize(("n", "seeds"), [(1, 40), (2, 40), (3, 5)])
def test_what_is_decided_by_cases_is_what_brute_force_says(n, seeds):
    """Claims that hold are proven most of the time, and so are those that hold without any margin."""
    decided = Counter()
    for seed in range(seeds):
        world = small_world(seed, n)
        for claim, found in check(with_cases(world.content)).items():
            assert found.verdict in ("not checked", world.verdict(claim)), (seed, claim, found)
            decided[found.verdict, world.verdict(claim)] += 1
    assert 2 * decided["not checked", "proven"] < decided["proven", "proven"]


@pytest.mark.parametrize("kind", CASE_MUTATIONS)
def test_forged_proofs_by_cases_prove_nothing_that_is_false(kind):
    """The claims of these contents are false as often as they are true, and so are some in a forged proof."""
    refused = 0
    for seed in range(30):
        world, rng = small_world(seed, 1 + seed % 2), np.random.default_rng([seed, list(CASE_MUTATIONS).index(kind)])
        value = with_cases(world.content)
        for _ in range(4):
            forged = json.loads(json.dumps(value))
            for _ in range(rng.integers(1, 4)):
                CASE_CHANGES[kind](forged, rng)
            try:
                results = check(forged)
            except checker.Malformed:
                refused += 1
                continue
            for claim, found in results.items():
                assert found.verdict in ("not checked", world.verdict(claim)), (seed, claim, found)
    assert refused < 90


# -- sets and regions at their edges ------------------------------------------------------------------


def test_a_set_that_fits_without_any_margin_is_proven_and_the_next_float_is_refuted():
    assert verdict(content(mode(D=box(0.5)))) == "proven"
    assert verdict(content(mode(D=box(np.nextafter(0.5, 1))))) == "refuted"
    text = json.dumps(content(mode(D=box(0.25)))).replace("0.25", "0.5000000000000000000000001")
    assert checker.check(checker.parse(text)).proven  # which is the float 0.5


@pytest.mark.parametrize("r", [0.1, 0.3, 0.7, 1e-9, 1e9, 5e-324])
def test_sets_and_limits_are_read_alike(r):
    """x+ = x / 2 on X = F_max = [-r, r]^2, whether the float r lies above or below the decimal."""
    assert verdict(content(F=(r,) * 4, X=box(r))) == "proven"
    assert verdict(content(F=(np.nextafter(r, 2 * r),) * 4, X=box(r))) == "refuted"


def test_a_witness_is_a_step_that_can_be_replayed():
    step = check(content(mode(p=(0.6, 0.0))))["safe_set"].witness
    x, d, after = ([Fraction(entry) for entry in step[key]] for key in ("state", "disturbance", "after"))
    assert all(abs(entry) <= 1 for entry in x) and d == [0, 0] and step["mode"] == 1
    assert after == [x[0] / 2 + Fraction(0.6), x[1] / 2] and after[0] > 1


@pytest.mark.parametrize("first", [True, False])
def test_where_regions_meet_all_of_their_modes_act(first):
    left = mode(region=((1.0, 0.0, 0.0), 0.5))
    right = mode(p=(9.0, 0.0), region=((-1.0, 0.0, 0.0), -0.5))
    modes = (left, right) if first else (right, left)
    assert verdict(content(*modes, F=(0.4999999, 1.0, 1.0, 1.0))) == "proven"
    found = check(content(*modes, F=(0.5, 1.0, 1.0, 1.0)))["safe_set"]
    assert found.verdict == "refuted" and found.witness["state"][0] == "1/2"
    corner = mode(p=(9.0, 0.0), region=(((-1.0, 0.0, 0.0), -0.5), ((0.0, -1.0, 0.0), -1.0)))
    found = check(content(mode(), corner, F=(0.5, 1.0, 1.0, 1.0)))["safe_set"]  # a region that is met in a point
    assert found.verdict == "refuted" and found.witness["state"] == ["1/2", "1"]


def test_regions_that_overlap_act_together_whatever_their_order():
    for modes in ((mode(), mode(p=(0.6, 0.0))), (mode(p=(0.6, 0.0)), mode())):
        assert verdict(content(*modes)) == "refuted"


@pytest.mark.parametrize("width", [1e-9, 0.3])
@pytest.mark.parametrize("F", [(1.0, 1.0, 1.0, 1.0), (1.0, 0.0, 1.0, 0.0)], ids=["square", "segment"])
def test_states_between_regions_have_no_successor_however_narrow_the_gap(width, F):
    left = mode(region=((1.0, 0.0, 0.0), 0.0))
    for gap in (0.0, width):
        found = check(content(left, mode(region=((-1.0, 0.0, 0.0), -gap)), F=F))["safe_set"]
        assert found.verdict == ("refuted" if gap else "proven")
    assert "no successor" in found.reason and 0 < Fraction(found.witness["state"][0]) < Fraction(width)


def test_a_row_of_zeros_in_a_region_says_all_or_nothing():
    nothing, everything = ((0.0, 0.0, 0.0), -1.0), ((0.0, 0.0, 0.0), 0.0)
    assert verdict(content(mode(region=everything))) == "proven"
    assert verdict(content(mode(region=nothing))) == "refuted"  # no successors at all
    assert verdict(content(mode(), mode(p=(9.0, 0.0), region=nothing))) == "proven"
    empty = ((1.0, 0.0, 0.0), 0.1), ((-1.0, 0.0, 0.0), -0.2)
    assert verdict(content(mode(), mode(p=(9.0, 0.0), region=empty))) == "proven"
    line = ((1.0, 0.0, 0.0), 0.1), ((-1.0, 0.0, 0.0), -0.1)
    assert verdict(content(mode(), mode(p=(9.0, 0.0), region=line))) == "refuted"


def test_disturbance_sets_may_be_flat_but_neither_empty_nor_unbounded():
    assert verdict(content(mode(D={"H": SQUARE, "h": [0.5, 0.0, 0.0, 0.0]}))) == "proven"
    assert verdict(content(mode(D={"H": SQUARE, "h": [0.50001, 0.0, 0.0, 0.0]}))) == "refuted"
    assert verdict(content(mode(D={"H": SQUARE, "h": [0.5, 0.3, -0.5, -0.3]}))) == "proven"
    assert verdict(content(mode(D={"H": [*SQUARE, [0.0, 0.0], SQUARE[0]], "h": [0.1] * 4 + [0.0, 9.0]}))) == "proven"
    for D, says in (
        ({"H": SQUARE, "h": [0.5, 0.5, -0.6, 0.5]}, "is empty"),
        ({"H": [*SQUARE, [0.0, 0.0]], "h": [0.5, 0.5, 0.5, 0.5, -1.0]}, "is empty"),
        ({"H": SQUARE[:3], "h": [0.1] * 3}, "is not bounded"),
        ({"H": [[1.0, 1.0], [-1.0, -1.0]], "h": [0.1, 0.1]}, "is not bounded"),
        ({"H": [[0.0, 0.0]], "h": [0.0]}, "is not bounded"),
    ):
        with pytest.raises(checker.Malformed, match=says):
            check(content(mode(D=D)))


def test_flat_sets_are_sets():
    for F in ((1.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 0.0), (0.3, 0.0, 0.0, 0.0)):
        assert verdict(content(F=F)) == "proven"
        assert verdict(content(mode(p=(0.0, 1e-9)), F=F)) == "refuted"
        assert verdict(content(F=F, X={"H": SQUARE, "h": list(F)})) == "proven"  # X is flat as well
    assert check(content(F=(1.0, 1.0, -2.0, 1.0)))["safe_set"].reason == "F_max is empty"


def test_f_max_outside_x_proves_nothing():
    """Beyond X the loop is not even looked at, so no claim may rest on it."""
    away = content(mode(), F=(2.0, 1.0, 1.0, 1.0), later=[(1.0, 1.0, 1.0, 1.0)])
    found = check(away)
    assert {name for name, result in found.items() if result.verdict == "proven"} <= {"inputs", "theorem_1"}
    assert "not in X" in found["safe_set"].reason and "not in X" in found["sequence"].reason


def test_a_later_set_outside_f_max_proves_nothing():
    found = check(content(later=[(1.0, 1.0, 1.5, 1.0), (1.0, 1.0, 1.0, 1.0)]))
    assert found["sequence"].verdict == "refuted" and "not in F_max" in found["sequence"].reason
    assert found["terminal_set"].verdict == "not checked"  # it rests on the sequence
    found = check(content(later=[(1.0, 1.0, 1.5, 1.0)], X=box(2.0)))  # the last of all
    assert found["sequence"].verdict == "proven" and found["terminal_set"].verdict == "refuted"


def test_a_last_set_that_holds_the_image_of_the_one_before_need_not_be_invariant():
    swap = mode(A=((0.0, 0.9), (0.9, 0.0)))
    found = check(content(swap, later=[(0.9, 0.9, 0.9, 0.9), (0.82, 1.0, 0.82, 1.0)]))
    assert found["sequence"].verdict == "proven" and found["terminal_set"].verdict == "refuted"
    x, after = (abs(Fraction(found["terminal_set"].witness[key][i])) for key, i in (("state", 1), ("after", 0)))
    assert x <= 1 and after == x * Fraction(0.9) > Fraction(0.82)


def test_an_empty_terminal_set_does_not_hold_the_image():
    found = check(content(later=[(1.0, 1.0, -2.0, 1.0)]))
    assert not any(found[name].verdict == "proven" for name in ("sequence", "terminal_set", "criterion", "theorem_1"))


def test_x_has_to_be_bounded_and_not_empty():
    for X, says in (
        ({"H": SQUARE[:3], "h": [1.0] * 3}, "not bounded"),
        ({"H": SQUARE, "h": [1.0, 1.0, -2.0, 1.0]}, "empty"),
    ):
        with pytest.raises(checker.Malformed, match=says):
            check(content(X=X))


# -- claims about the end of the sequence -------------------------------------------------------------


def test_theorem_1_wants_the_very_fraction():
    later, own = [(0.5, 0.5, 0.5, 0.5)], {"alpha": "2", "stable": True}
    assert verdict(content(later=later, theorem_1=own), "theorem_1") == "proven"
    for change in ({"alpha": "2000000001/1000000000"}, {"stable": False}, {"alpha": None}, {"alpha": "-2"}):
        assert verdict(content(later=later, theorem_1={**own, **change}), "theorem_1") == "refuted"
    moved = {"alpha": "3/2", "stable": True, "centre": [0.0, 0.0]}
    assert verdict(content(later=[(0.5, 0.5, 2 / 3, 0.5)], theorem_1=moved), "theorem_1") == "refuted"  # 2/3 is a float
    beside = {"alpha": "6/5", "stable": True, "centre": [0.0, 0.5]}
    assert verdict(content(later=[(0.5, 0.5, 0.5, 0.5)], theorem_1=beside), "theorem_1") == "refuted"
    centre = {"alpha": "3/2", "stable": True, "centre": [0.25, 0.0]}
    assert verdict(content(later=[(0.75, 0.5, 0.5, 0.5)], theorem_1=centre), "theorem_1") == "proven"
    outside = {"alpha": None, "centre": [0.5, 0.0]}
    assert verdict(content(later=later, theorem_1=outside), "theorem_1") == "proven"


def test_theorem_1_does_not_rest_on_offsets_that_nothing_touches():
    """R_1 is a triangle whose last row is loose: alpha is about the set, not about its rows."""
    template = [[1.0, 0.0], [0.0, 1.0], [-1.0, -1.0], [1.0, 1.0]]
    value = content(later=[(0.0,) * 4], theorem_1={"alpha": "2", "stable": True})
    value["template"], value["sets"] = template, [[1.0, 1.0, 1.0, 2.0], [0.5, 0.5, 0.5, 7.0]]
    value["system"]["state_set"] = box(9.0)
    assert verdict(value, "theorem_1") == "proven"


def test_theorem_1_is_about_alpha_above_1_strictly():
    """R_1 = R_0: the boundaries touch, alpha is 1, and nothing is stable."""
    for stable, expected in ((True, "refuted"), (False, "proven")):
        own = {"alpha": "1", "stable": stable}
        assert verdict(content(later=[(1.0,) * 4], theorem_1=own), "theorem_1") == expected
    above = Fraction(1) / Fraction(np.nextafter(1, 0))
    value = content(later=[(np.nextafter(1, 0),) * 4], theorem_1={"alpha": str(above), "stable": True})
    assert verdict(value, "theorem_1") == "proven"


@pytest.mark.parametrize(
    ("before", "last", "centre", "alpha", "says"),
    [
        ((0.125,) * 4, (0.5,) * 4, (0.25, 0.25), "-1/2", None),  # c outside R_(k-1), inside R_k
        ((0.125,) * 4, (0.5,) * 4, (0.25, 0.25), None, "not in R_1"),
        ((0.125,) * 4, (0.5,) * 4, (0.25, 0.25), "0", None),
        ((0.25,) * 4, (0.5,) * 4, (0.25, 0.25), "0", "alpha = 1 - 1"),  # on the boundary of R_(k-1)
        ((0.25,) * 4, (0.5,) * 4, (0.25, 0.25), None, None),
        ((0.5,) * 4, (0.25,) * 4, (0.25, 0.0), None, "not inside R_k"),  # on the boundary of R_k
        ((0.5,) * 4, (0.25,) * 4, (0.375, 0.0), None, "not inside R_k"),
        ((0.5,) * 4, (0.25,) * 4, (2.0, 0.0), None, "not inside R_k"),
        ((0.5,) * 4, (0.0,) * 4, (0.0, 0.0), None, "not inside R_k"),  # a point
        ((0.5,) * 4, (0.25, 0.0, 0.25, 0.0), (0.0, 0.0), None, "not inside R_k"),  # a segment
        ((0.5,) * 4, (0.25, 0.0, 0.25, 0.0), (0.0, 0.0), "2", None),
    ],
)
def test_alpha_where_the_centre_is_outside_or_sets_are_flat(before, last, centre, alpha, says):
    """x+ = 0, which every set here holds; `says` None: the claim is wrong."""
    zero = mode(A=((0.0, 0.0), (0.0, 0.0)))
    own = {"alpha": alpha, "centre": list(centre), "stable": False}
    for last_row in ((), ((1.0, 0.0),)):  # a row that stands there twice changes nothing
        value = content(zero, later=[before, last], theorem_1=own)
        value["template"] = [*SQUARE, *map(list, last_row)]
        value["sets"] = [[*h, *h[: len(last_row)]] for h in value["sets"]]
        found = check(value)["theorem_1"]
        assert found.verdict == ("refuted" if says is None else "proven") and (says or "") in found.reason
        value["claims"]["theorem_1"]["stable"] = True
        assert verdict(value, "theorem_1") == "refuted"


def test_a_claim_that_needs_a_refuted_one_is_not_proven():
    found = check(content(mode(p=(0.6, 0.0)), later=[(0.5, 0.5, 0.5, 0.5)], theorem_1={"alpha": "2", "stable": True}))
    assert not any(found[name].verdict == "proven" for name in ("terminal_set", "criterion", "theorem_1"))


def test_theorems_need_inputs_in_u():
    value = with_plant(f=LINEAR, later=[(0.5,) * 4], theorem_1={"alpha": "2", "stable": True})
    assert {verdict(value, name) for name in ("theorem_1", "theorem_2")} == {"proven"}
    value["network"]["output"]["bias"] = [1.5]  # without effect on the states, for B = 0
    found = check(value)
    assert found["inputs"].verdict == found["safe_set"].verdict == "refuted"
    assert "outside U" in found["safe_set"].reason and found["safe_set"].witness.keys() == {"state"}
    assert {found[name].verdict for name in ("terminal_set", "theorem_1", "theorem_2")} == {"not checked"}
    value["network"]["output"] = {"weight": [[1.0, 0.0]], "bias": [0.5]}  # outside U in a part of X beyond F_max
    value["sets"] = [[0.5] * 4, [0.25] * 4]
    found = check(value)
    assert found["inputs"].verdict == "refuted" and found["terminal_set"].verdict == "proven"
    assert {found[name].verdict for name in ("theorem_1", "theorem_2")} == {"not checked"}


def test_the_criterion_is_decided_both_ways():
    value = content(mode(D=box(0.5)), later=[(1.0, 1.0, 1.0, 1.0)])
    assert verdict(value, "criterion") == "proven"
    value["claims"]["criterion"]["holds"] = False
    assert verdict(value, "criterion") == "refuted"
    value = content(mode(D=box(0.25)), later=[(1.0, 1.0, 1.0, 1.0)], criterion={"holds": False})
    assert verdict(value, "criterion") == "proven"  # R_1 of the shrunk set is smaller than that
    still = content(mode(A=((1.0, 0.0), (0.0, 1.0))), later=[(1.0, 1.0, 1.0, 1.0)])
    assert verdict(still, "criterion") == "proven"  # R_1 of the shrunk set is that set, neither more nor less
    value["claims"]["criterion"]["centre"] = [3.0, 0.0]
    assert "fails" in check(value)["criterion"].reason


@pytest.mark.parametrize(
    ("centre", "holds"), [((1.0, 0.0), True), ((1.0, 1.0), True), ((np.nextafter(1, 2), 0), False)]
)
def test_the_criterion_needs_a_centre_in_the_terminal_set(centre, holds):
    """x+ = x, so that S, which is about a centre on the boundary as well, is its own image."""
    still = mode(A=((1.0, 0.0), (0.0, 1.0)))
    for told in (True, False):
        own = {"centre": list(centre), "holds": told}
        value = content(still, later=[(1.0,) * 4], X=box(2.0), criterion=own)
        assert verdict(value, "criterion") == ("proven" if told == holds else "refuted")


def test_the_criterion_holds_for_a_point_and_a_segment():
    for last in ((0.0,) * 4, (0.5, 0.0, 0.5, 0.0)):
        value = content(mode(A=((1.0, 0.0), (0.0, 0.0))), F=last, later=[last])
        assert verdict(value, "criterion") == "proven"


@pytest.mark.parametrize("epsilon", ["0", "-0.0", "-1e-3", "1e-399"])
def test_epsilon_is_positive(epsilon):
    text = json.dumps(content(later=[(1.0,) * 4], criterion={"epsilon": 12345})).replace("12345", epsilon)
    with pytest.raises(checker.Malformed, match="positive epsilon"):
        checker.check(checker.parse(text))


def test_a_witness_in_the_file_counts_for_nothing():
    value = content(mode(p=(0.6, 0.0)))
    own = check(value)["safe_set"]
    told = {"verdict": "not proven", "reason": own.reason, "witness": own.witness}
    value["claims"]["safe_set"] = told
    assert check(value)["safe_set"] == own
    for other in ({**own.witness, "state": ["1", "1/2"]}, {**own.witness, "mode": 2}, {}, 7, "x", [[1e300]]):
        value["claims"]["safe_set"] = {**told, "witness": other}
        found = check(value)["safe_set"]
        assert found.verdict == "refuted" and found.witness == own.witness and "another" in found.reason
    value["claims"]["safe_set"] = {**told, "verdict": "proven"}
    with pytest.raises(checker.Malformed, match="witness"):
        check(value)


def test_what_a_certificate_does_not_claim_is_not_proven():
    value = content(safe_set={"verdict": "not proven", "reason": "so it is", "witness": None})
    found = check(value)["safe_set"]
    assert found.verdict == "not checked" and "does not claim" in found.reason
    report = checker.check(checker.parse(json.dumps(value)))
    assert not report.proven


# -- the error set ------------------------------------------------------------------------------------


def with_plant(*modes, f, **options):
    """`content` of a plant with components [(coefficient, powers of x1, x2, u), ...]."""
    value = content(*modes, **options)
    value["plant"] = {"f": [[{"coefficient": c, "powers": list(powers)} for c, *powers in terms] for terms in f]}
    value["claims"] |= {"error_set": {"verdict": "proven"}, "theorem_2": {"verdict": "proven"}}
    return value


LINEAR = [(0.5, 1, 0, 0)], [(0.5, 0, 1, 0)]


def test_an_error_that_d_just_holds_is_proven_and_one_that_it_does_not_is_refuted():
    f = [*LINEAR[0], (0.25, 2, 0, 0)], [*LINEAR[1], (0.125, 1, 0, 1)]
    D = {"H": SQUARE, "h": [0.25, 0.125, 0.0, 0.125]}
    assert verdict(with_plant(mode(D=D), f=f), "error_set") == "proven"
    for i in range(4):
        small = {"H": SQUARE, "h": [b - 1e-6 * (i == k) for k, b in enumerate(D["h"])]}
        if i != 2:
            assert verdict(with_plant(mode(D=small), f=f), "error_set") == "refuted"
    found = check(with_plant(mode(D={"H": SQUARE, "h": [0.2, 0.2, 0.0, 0.2]}), f=f))["error_set"]
    x = Fraction(found.witness["state"][0])
    assert x * x / 4 > Fraction(2, 10) and abs(x) <= 1


def test_what_is_missing_from_a_certificate_proves_nothing():
    """`Certificate.of` refuses such files; were one to pass, no claim would rest on what is not there."""
    whole = checker.Certificate.of(checker.parse(json.dumps(with_plant(mode(), f=LINEAR))))
    claims = checker.Claims(replace(whole, plant=None), checker.Budget(60))
    assert claims.error_set({})[:2] == ("not checked", "the certificate names no plant")
    assert checker.Claims(whole, checker.Budget(60)).error_set({})[0] == "proven"


def test_an_error_that_is_largest_inside_is_found():
    f = [(1.5, 1, 0, 0), (-1.0, 2, 0, 0)], LINEAR[1]  # x1 (1 - x1), at most 1/4
    for top, expected in ((0.25, "proven"), (0.2499, "refuted"), (0.1, "refuted")):
        D = {"H": SQUARE, "h": [top, 0.0, 2.0, 0.0]}
        assert verdict(with_plant(mode(D=D), f=f), "error_set") == expected


@pytest.mark.parametrize("seed", range(25))
def test_an_error_may_touch_d_and_not_pass_it_by_one_ulp(seed):
    """b t + a t^2 in every coordinate, whose maximum over the box is a float."""
    rng = np.random.default_rng(seed)
    a, b = rng.choice([-1.0, -0.5, 0.0, 0.25], 3), rng.integers(-4, 5, 3) / 4
    low, high = -rng.integers(0, 5, 3) / 4, rng.integers(0, 5, 3) / 4
    top = 0.0
    for i in range(3):
        peak = -b[i] / (2 * a[i]) if a[i] else low[i]
        top += max(b[i] * t + a[i] * t * t for t in (low[i], high[i], min(max(peak, low[i]), high[i])))
    terms = [(v, *(power * (i == j) for j in range(3))) for i in range(3) for v, power in ((b[i], 1), (a[i], 2)) if v]
    f = [(1.0, 1, 0, 0), *terms] if b[0] == 0 else [(1.0 + b[0], 1, 0, 0), *(t for t in terms if t[1:] != (1, 0, 0))]
    for given, expected in ((top, "proven"), (np.nextafter(top, -9), "refuted"), (top - 1e-10, "refuted")):
        D = {"H": SQUARE, "h": [given, 0.0, 99.0, 0.0]}
        value = with_plant(mode(A=((1.0, 0.0), (0.0, 0.0)), D=D), f=(f, []), F=(0.0,) * 4)
        value["system"]["state_set"]["h"] = [high[0], high[1], -low[0], -low[1]]
        value["system"]["input_set"]["h"] = [high[2], -low[2]]
        assert verdict(value, "error_set") == expected


def test_products_of_powers_count_by_their_sign():
    """x1^2 x2^2 lies in [0, 1], x1 x2, x1^2 x2 and x1^3 in [-1, 1]: tops of f - 0 along +x1 and -x1."""
    zero = {"A": ((0.0, 0.0), (0.0, 0.0))}
    for term, up, down in (((2, 2, 0), 1.0, 0.0), ((1, 1, 0), 1.0, 1.0), ((3, 0, 0), 1.0, 1.0), ((2, 1, 0), 1.0, 1.0)):
        for sign in (1.0, -1.0):
            top, bottom = (up, down) if sign > 0 else (down, up)
            cases = ((top, bottom), "proven"), ((top - 1e-10, bottom), "refuted"), ((top, bottom - 1e-10), "refuted")
            for h, expected in cases:
                D = {"H": SQUARE, "h": [h[0], 0.0, h[1], 0.0]}
                assert verdict(with_plant(mode(**zero, D=D), f=([(sign, *term)], [])), "error_set") == expected


def test_the_error_of_every_mode_counts_all_over_its_region():
    """f = x1^2 / 4 with X = [-3, 3] x [-1, 1]: 9/4 at the ends, in the region of the second mode as in the first."""
    zero, X = {"A": ((0.0, 0.0), (0.0, 0.0))}, {"H": SQUARE, "h": [3.0, 1.0, 3.0, 1.0]}
    tops = [{"H": SQUARE, "h": [top, 0.0, 0.0, 0.0]} for top in (2.25, 2.25 - 1e-10)]
    left, right = ((1.0, 0.0, 0.0), 0.0), ((-1.0, 0.0, 0.0), 0.0)
    for first, second, expected in ((0, 0, "proven"), (0, 1, "refuted"), (1, 0, "refuted")):
        modes = mode(**zero, region=left, D=tops[first]), mode(**zero, region=right, D=tops[second])
        found = check(with_plant(*modes, f=([(0.25, 2, 0, 0)], []), X=X))["error_set"]
        assert found.verdict == expected and (expected == "proven" or found.witness["mode"] == 1 + (second == 1))


def test_coefficients_of_f_may_be_fractions_as_text():
    f = [("1/2", 1, 0, 0), ("1/10", 0, 0, 0)], LINEAR[1]
    for top, expected in ((0.1, "proven"), (np.nextafter(0.1, 0), "refuted")):  # the float 0.1 is above 1/10
        assert verdict(with_plant(mode(D={"H": SQUARE, "h": [top, 0.0, 0.0, 0.0]}), f=f), "error_set") == expected
    for text in ("0.5", "1/0", "x", ""):
        with pytest.raises(checker.Malformed, match="no fraction"):
            check(with_plant(f=([(text, 1, 0, 0)], [])))


def test_the_error_counts_where_the_region_meets_x_and_u():
    f = [*LINEAR[0], (1.0, 0, 0, 1)], LINEAR[1]  # the error is u
    half = ((0.0, 0.0, 1.0), 0.25)
    D = {"H": SQUARE, "h": [0.3, 0.0, 1.0, 0.0]}
    assert verdict(with_plant(mode(D=D, region=half), f=f), "error_set") == "proven"
    assert verdict(with_plant(mode(D=D), f=f), "error_set") == "refuted"
    for top in (0.75, 1.5):  # a corner of the box is cut off, which takes no more than half of the error
        assert verdict(with_plant(mode(D=D, region=((1.0, 0.0, 1.0), top)), f=f), "error_set") == "refuted"
    slanted = ((1.0, 0.0, 1.0), 0.25), ((-1.0, 0.0, 0.0), 0.0)  # x1 >= 0, so that u <= 0.25
    assert verdict(with_plant(mode(D=D, region=slanted), f=f), "error_set") == "proven"
    nowhere = ((1.0, 0.0, 0.0), -2.0)
    assert verdict(with_plant(mode(D=box(2.0)), mode(D=box(0.0), region=nowhere), f=f), "error_set") == "proven"
    value = with_plant(mode(D=D), f=f)
    value["system"]["input_set"] = {"H": [[1.0], [-1.0]], "h": [0.3, 1.0]}
    assert verdict(value, "error_set") == "proven"
    value["system"]["input_set"]["h"] = [0.30000000001, 1.0]
    assert verdict(value, "error_set") == "refuted"
    value["system"]["input_set"] = {"H": [[1.0]], "h": [0.25]}
    assert "no limits" in check(value)["error_set"].reason


def test_theorem_2_needs_the_origin_inside_and_all_else_proven():
    f, later = LINEAR, [(0.5, 0.5, 0.5, 0.5)]
    options = {"theorem_1": {"alpha": "2", "stable": True}, "criterion": {"holds": False}}
    assert verdict(with_plant(f=f, later=later, **options), "theorem_2") == "proven"
    assert "origin" in check(with_plant(f=f, later=[(0.5, 0.5, 0.0, 0.5)]))["theorem_2"].reason
    wide = mode(D=box(0.3))  # leads from F_max beyond R_1
    found = check(with_plant(wide, f=f, later=later, **options))
    assert found["error_set"].verdict == found["safe_set"].verdict == "proven"
    assert found["theorem_2"].verdict == "not checked" and "sequence" in found["theorem_2"].reason
    swap = mode(A=((0.0, 0.9), (0.9, 0.0)))  # does not keep the last set
    last = {"F": (0.9,) * 4, "later": [(0.82, 1.0, 0.82, 1.0)]}
    found = check(with_plant(swap, f=([(0.9, 0, 1, 0)], [(0.9, 1, 0, 0)]), **last))
    assert found["error_set"].verdict == found["safe_set"].verdict == found["sequence"].verdict == "proven"
    assert found["theorem_2"].verdict == "not checked" and "terminal_set" in found["theorem_2"].reason
    wrong = [(0.6, 1, 0, 0)], LINEAR[1]
    assert verdict(with_plant(f=wrong, later=later, **options), "theorem_2") != "proven"
    assert verdict(with_plant(f=f), "theorem_2") == "not checked"


# -- geometry -----------------------------------------------------------------------------------------


free = checker.Budget(3600)


def exact(rows):
    """Rows (a, b) of numbers as fractions."""
    return [(tuple(map(Fraction, a)), Fraction(b)) for a, b in rows]


def cube(n, r=1):
    """The rows of |x|_inf <= r."""
    return exact([([s * (i == j) for j in range(n)], r) for s in (1, -1) for i in range(n)])


def random_rows(rng, n, kind):
    """Small whole numbers, so that many rows meet in one corner, within a cube."""
    numbers = rng.integers(-2, 3, size=(rng.integers(1, 5), n + 1)).tolist()
    rows = exact((row[:-1], Fraction(row[-1] + 1, 2)) for row in numbers) + cube(n, 2)
    if kind == "flat":
        a, b = rows[0]
        rows.append((tuple(-entry for entry in a), -b))
    if kind == "point":
        x = rng.integers(-1, 2, n).tolist()
        rows = [(a, max(b, dot(a, x))) for a, b in rows] + [(a, dot(a, x)) for a, _ in cube(n)]
    if kind == "repeated":
        rows += [(tuple(3 * entry for entry in a), 3 * b + int(rng.integers(2))) for a, b in rows]
        rows.append(((Fraction(0),) * n, Fraction(int(rng.integers(2)))))
    if kind == "scaled":
        rows = [(tuple(entry / 3 * 2**40 for entry in a), b * Fraction(2) ** -60) for a, b in rows]
    rng.shuffle(rows)
    return rows


def assert_consistent(P, rows):
    """P has the corners of these rows, and two of them the same smallest face by their masks as by the rows."""
    points = list(map(checker.point, P))
    assert len(set(points)) == len(points) and sorted(points) == corners_of(rows)
    tight = [{i for i, (a, b) in enumerate(rows) if dot(a, x) == b} for x in points]
    masks = list(P.values())
    for i, j in combinations_with_replacement(range(len(points)), 2):
        face = [k for k, own in enumerate(tight) if tight[i] & tight[j] <= own]
        assert face == [k for k, mask in enumerate(masks) if masks[i] & masks[j] & ~mask == 0]


KINDS_OF_SETS = ("any", "flat", "point", "repeated", "scaled")


@pytest.mark.parametrize("kind", KINDS_OF_SETS)
@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_polytopes_have_the_corners_that_brute_force_finds(n, kind):
    for seed in range(8 if n < 4 else 3):
        rows = random_rows(np.random.default_rng([seed, n]), n, kind)
        assert_consistent(checker.polytope(rows, "it", free), rows)


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_sets_may_be_empty_but_not_unbounded(n):
    for rows in (
        [*cube(n), ((Fraction(0),) * n, Fraction(-1))],
        exact([([1] * n, 0), ([-1] * n, -1)]),  # empty, though nothing limits it
        exact([([1] * n, 0), ([-1] * n, -1e-300)]),
    ):
        assert checker.polytope(rows, "it", free) == {}
    for rows in (
        cube(n)[1:],
        cube(n)[:n],
        exact([([0] * n, 1)]),
        exact([([1] + [0] * (n - 1), 1)]),
        [row for row in cube(n) if not row[0][-1]] or exact([([1], 10**300)]),
    ):
        with pytest.raises(checker.Malformed, match="it is not bounded"):
            checker.polytope(rows, "it", free)


@pytest.mark.parametrize("scale", [Fraction(2) ** -1074, Fraction(2) ** 1000, Fraction(1, 3)])
@pytest.mark.parametrize("n", [1, 2, 3])
def test_sets_may_have_any_size_and_place(n, scale):
    rows = [(a, scale * (b + 5 * sum(a))) for a, b in [*cube(n), *exact([([1] * n, n - 1)])]]
    assert_consistent(checker.polytope(rows, "it", free), rows)
    rows = [(tuple(entry * scale for entry in a), b) for a, b in cube(n)]
    assert_consistent(checker.polytope(rows, "it", free), rows)
    rows = cube(n, 0)[n:] + exact([([0] * (n - 1) + [1], 5)])  # x >= 0, x_n <= 5, x_i <= 1000 x_(i+1) + 1
    rows += exact([([int(i == j) - 1000 * (i + 1 == j) for j in range(n)], 1) for i in range(n - 1)])
    assert_consistent(checker.polytope(rows, "it", free), rows)


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_a_polytope_that_is_cut_again_and_again_is_what_brute_force_finds(n):
    """Up to seven cuts: some go through corners, some leave a face, some change nothing, some leave nothing."""
    for seed in range(25 if n < 4 else 6):
        rng = np.random.default_rng([seed, n])
        rows = cube(n)
        P = checker.polytope(rows, "it", free)
        for _ in range(7):
            a, b = rng.integers(-2, 3, n).tolist(), Fraction(int(rng.integers(-1, 5)), 2)
            form = checker.half_space(*exact([(a, b)])[0])
            inside, beyond = ({checker.at(form, x) * sign > 0 for x in P} for sign in (-1, 1))
            full = checker.clip(P, form, free, flat=False)
            P = checker.clip(P, form, free)
            rows += exact([(a, b)])
            assert_consistent(P, rows)
            assert full == (P if True in inside or True not in beyond else {})


@pytest.mark.parametrize(("n", "m"), [(1, 1), (2, 1), (1, 2), (2, 2)])
def test_products_have_the_corners_and_faces_of_both(n, m):
    for seed in range(6):
        rng = np.random.default_rng(seed)
        one, other = (random_rows(rng, k, KINDS_OF_SETS[rng.integers(5)]) for k in (n, m))
        both = [((*a, *(Fraction(0),) * m), b) for a, b in one] + [((*(Fraction(0),) * n, *a), b) for a, b in other]
        P, Q = (checker.polytope(rows, "it", free) for rows in (one, other))
        found = checker.product(P, Q, free)
        assert_consistent(found, both)
        for _ in range(2):
            a, b = rng.integers(-2, 3, n + m).tolist(), Fraction(int(rng.integers(-1, 3)), 2)
            both += exact([(a, b)])
            found = checker.clip(found, checker.half_space(*both[-1]), free)
            assert_consistent(found, both)


@pytest.mark.parametrize("n", [1, 2, 3])
def test_what_no_region_covers_is_found_and_only_that(n):
    """Regions that overlap, meet in faces, leave needles, or are flat, against rational linear programs."""
    outcomes = set()
    for seed in range(30):
        rng = np.random.default_rng([seed, n])
        rows = random_rows(rng, n, KINDS_OF_SETS[rng.integers(4)])
        P = checker.polytope(rows, "it", free)
        cuts = [(rng.integers(-1, 2, n).tolist(), Fraction(int(rng.integers(-1, 2)), 2)) for _ in range(3)]
        regions = []
        for signs in product((1, -1), repeat=2):
            region = [([s * entry for entry in a], s * b) for s, (a, b) in zip(signs, cuts)]
            room = Fraction(int(rng.choice([0, 0, 0, -1])), 10**9)
            regions.append(exact([(a, b + room) for a, b in region] + cuts[2:] * bool(rng.integers(4) == 0)))
        if not P:
            continue
        found = checker.uncovered(P, [[checker.half_space(*row) for row in region] for region in regions], free)
        assert bool(found) == (uncovered(rows, regions) is not None)
        outcomes.add(bool(found))
        if found:
            x = checker.middle(found)
            assert holds(rows, x) and not any(holds(region, x) for region in regions)
    assert outcomes == {True, False}


@pytest.mark.parametrize("flat", [False, True])
@pytest.mark.parametrize("n", [1, 2, 3])
def test_pieces_cover_the_domain_with_what_the_network_says(n, flat):
    """Small whole weights, so that channels tie and some are the same."""
    for seed, pool in product(range(2), (1, 2, 3)):
        rng = np.random.default_rng([seed, n])
        net = small_network(rng, n, pool)
        rows = [(a, b * (not flat or not a[-1])) for a, b in cube(n)]
        pieces = checker.affine_pieces(net, checker.polytope(rows, "it", free), free)
        for x in (rng.integers(-4, 5, (12, n)) * [*[1] * (n - 1), int(not flat)]).tolist():
            corner = (4, *x)
            x = [Fraction(entry, 4) for entry in x]
            holding = [piece for piece in pieces if is_in(piece[0], x)]
            assert holding
            for _, forms, unit in holding:
                assert Fraction(checker.at(forms[0], corner), unit * 4) == net(x, free)[0]


def small_network(rng, n, pool, layers=2):
    """Two hidden layers of few small numbers, which tie, and one input."""
    sizes = [n, *[2 + int(n < 3)] * (layers - 1), 2]
    hidden = [
        {"weight": (rng.integers(-2, 3, (pool * b, a)) / 2).tolist(), "bias": rng.integers(-1, 2, pool * b).tolist()}
        for a, b in pairwise(sizes)
    ]
    output = {"weight": rng.integers(-2, 3, (1, 2)).tolist(), "bias": [0.5]}
    value = {"format": checker.NETWORK, "hidden": [{**layer, "pool": pool} for layer in hidden], "output": output}
    return checker.Network.of(checker.parse(json.dumps(value)))


def is_in(P, x):
    """Whether a point is a mean of corners with weights that are not negative, by a linear program in fractions."""
    points = list(map(checker.point, P))
    rows = [(tuple(Fraction(-int(i == k)) for i in range(len(points))), Fraction(0)) for k in range(len(points))]
    for column, value in [*zip(zip(*points), x), ((Fraction(1),) * len(points), Fraction(1))]:
        rows += [(column, value), (tuple(-entry for entry in column), -value)]
    return uncovered(rows, []) is not None


# -- cases --------------------------------------------------------------------------------------------


def values_of(case, net, x):
    """1, x and the values of the neurons that are open in a case."""
    found, y = [Fraction(1), *x], x
    for layer, (rows, pool) in enumerate(net.hidden):
        z = checker.affine(rows, y, free)
        y = [max(z[i : i + pool]) for i in range(0, len(z), pool)]
        found += [value for neuron, value in enumerate(y) if (layer, neuron) in case.open]
    return found


def winning(net, x):
    """{(layer, neuron): the channels that are largest at x}."""
    found, y = {}, x
    for layer, (rows, pool) in enumerate(net.hidden):
        z = checker.affine(rows, y, free)
        y = []
        for start in range(0, len(z), pool):
            own = z[start : start + pool]
            y.append(max(own))
            found[layer, start // pool] = [j for j, value in enumerate(own) if value == max(own)]
    return found


@pytest.mark.parametrize("pool", [1, 2, 3])
@pytest.mark.parametrize("n", [1, 2, 3])
def test_a_case_holds_every_state_in_which_its_channels_win(n, pool):
    """Its limits, its box and its forms, at corners of boxes that no grid of binary fractions holds, and within."""
    for seed in range(12):
        rng = np.random.default_rng([seed, n, pool])
        net = small_network(rng, n, pool)
        ends = [sorted(Fraction(int(k), 3) for k in rng.integers(-4, 5, 2)) for _ in range(n)]
        box = checker.gridded([(low, high) for low, high in ends])
        grid = box[0][0]
        assert all(a <= low * grid and high * grid <= b for (a, b), (low, high) in zip(box[1:], ends))
        for weights in [*product((0, 1), repeat=n), *rng.random((5, n)).tolist()]:
            x = [low + Fraction(t) * (high - low) for t, (low, high) in zip(weights, ends)]
            won = winning(net, x)
            chosen = {key: int(rng.choice(channels)) for key, channels in won.items() if rng.random() < 0.4}
            case = checker.case_of(net, box, chosen, free)
            z = values_of(case, net, x)
            assert all(dot(form, z) <= 0 for form, _ in case.limits)
            assert all(low <= value * grid <= high for (low, high), value in zip(case.box, z, strict=True))
            assert [Fraction(dot(form, z), case.unit) for form in case.z] == [*x, *net(x, free)]
            assert set(case.open) <= set(won) - set(chosen)


def test_open_neurons_lie_between_their_channels_and_the_chord():
    """y = max(x, -x) over [-1, 3]: y >= x, y >= -x, y <= x + 2 (3 - x) / 4 = (x + 3) / 2, and 1 <= ... <= 3."""
    net = {"hidden": [{"weight": [[1.0], [-1.0]], "bias": [0.0, 0.0], "pool": 2}]}
    net |= {"format": checker.NETWORK, "output": {"weight": [[1.0]], "bias": [0.0]}}
    case = checker.case_of(
        checker.Network.of(checker.parse(json.dumps(net))), checker.gridded([(Fraction(-1), Fraction(3))]), {}, free
    )
    grid = case.box[0][0]
    assert case.box[1:] == [(-grid, 3 * grid), (-grid, 3 * grid)] and case.open == {(0, 0): 0}
    limits = [
        tuple(Fraction(entry, -form[2]) if form[2] < 0 else Fraction(entry, form[2]) for entry in form)
        for form, _ in case.limits
    ]
    assert limits == [(0, 1, -1), (0, -1, -1), (Fraction(-3, 2), Fraction(-1, 2), 1)]


def test_a_bound_is_one_and_emptiness_needs_a_strict_sign():
    box = checker.gridded([(Fraction(0), Fraction(1)), (Fraction(-2), Fraction(3))])
    grid = box[0][0]
    assert checker.highest((5, 2, -3), box) == grid * (5 + 2 + 6) and checker.highest((5,), box) == 5 * grid
    limits = [((0, 1, 0), 1), ((-1, -1, 2), 3), ((1, 2, 0), 1)]  # x <= 0, -1 - x + 2 y <= 0, 1 + 2 x <= 0
    for weights, expected in (
        ([1], Fraction(13)),
        ([2, 0, 3], 11 + Fraction(1, 2)),
        ([0, 0, 1], None),  # x <= 0 holds in a point of the box
        ([0, 2, 1], Fraction(-1)),
        ([0], None),
    ):
        assert checker.bound((5, 2, -3), 1, weights, limits, box) == expected
    rng = np.random.default_rng(0)
    for _ in range(200):
        form, limits = rng.integers(-3, 4, 3).tolist(), rng.integers(-3, 4, (2, 3)).tolist()
        units = rng.integers(1, 4, 3).tolist()
        m, v, w = rng.integers(0, 3, 3).tolist()
        found = checker.bound(form, units[0], [m, 0, v, 1, w], list(zip(limits, units[1:])), box)
        for x, y in product(range(2), range(-2, 4)):
            if all(dot(limit, (1, x, y)) <= 0 for limit in limits):
                assert found is None or (m and Fraction(dot(form, (1, x, y)), units[0]) <= found)


def by_cases(value, inputs=(), images=(), attained=()):
    """A content with a proof by cases; `images` are (from, to, trees)."""
    images = [{"from": k, "to": j, "rows": rows} for k, j, rows in images]
    own = {"inputs": list(inputs), "images": images, "attained": [{"mode": k, "state": x} for k, x in attained]}
    return {**value, "format": checker.WITH_CASES, "cases": own}


def bent():
    """u = max(x1, -x1) - 1, in U = [-1, 0], and x+ = (u, 0), which lies in F_max = [-1, 1]^n."""
    value = content(mode())
    value["network"]["hidden"] = [{"weight": [[1.0, 0.0], [-1.0, 0.0]], "bias": [0.0, 0.0], "pool": 2}]
    value["network"]["output"] = {"weight": [[1.0]], "bias": [-1.0]}
    value["system"]["modes"][0] |= {"A": [[0.0, 0.0], [0.0, 0.0]], "B": [[1.0], [0.0]]}
    value["system"]["input_set"] = {"H": [[1.0], [-1.0]], "h": [0.0, 1.0]}
    return value


ABS = [[0, 0], [1, 0, 1], [1, 2, 1]]  # |x1| - 1 <= 0: if x1 wins by the first row of X, else by the third
ONE = [[1]]  # the box says it


def test_a_proof_by_cases_is_followed_node_by_node():
    images = [0, 0, [ABS, ONE, [[0, 0], [2, 7, 1], [2, 7, 1]], ONE]]
    value = by_cases(bent(), [ABS, [[0, 0], [2, 4, 1], [2, 4, 1]]], [images])
    found = check(value)
    assert found["inputs"].verdict == found["safe_set"].verdict == "proven"
    assert found["inputs"].kind == "weak duality" and found["inputs"].work == {"cases": 4}
    for tree in (
        [],
        ABS[:1],
        ABS[:2],
        [*ABS, [1]],  # a node too many
        [ABS[0], ABS[2], ABS[1]],  # the cases in another order than the channels
        [[0, 0], [0, 0], *ABS[1:], *ABS[1:]],  # split twice
        [[0, 1], *ABS[1:]],  # neurons that there are not
        [[1, 0], *ABS[1:]],
        [[0, 1e300], *ABS[1:]],
        [[0, 0], [1, 5, 1], [1, 2, 1]],  # limits that there are not
        [[0, 0], [1, 1e300, 1], [1, 2, 1]],
        [[0, 0], [], [1, 2, 1]],  # nodes of an even length
        [[0, 0], [1, 0, 1, 0], [1, 2, 1]],
        [[0, 0], [0], [1, 2, 1]],  # m = 0, and nothing is empty
        [[0, 0], [0, 0, 1], [1, 2, 1]],
        [[0, 0], [1, 2, 1], [1, 2, 1]],
    ):
        value["cases"]["inputs"][0] = tree
        found = check(value)
        assert found["inputs"].verdict == "not checked" and "row 1 of U" in found["inputs"].reason, tree
        assert found["safe_set"].verdict == "not checked"  # with an input outside U there would be no successor


@pytest.mark.parametrize("entry", [-1, 0.5, "1", None, True, [1]])
def test_nodes_are_whole_numbers(entry):
    value = by_cases(bent(), [ABS, ONE], [])
    value["cases"]["inputs"][0] = [[0, 0], [1, 0, entry], [1, 2, 1]]
    with pytest.raises(checker.Malformed, match="cases of the inputs"):
        check(value)


def test_there_is_a_tree_for_every_row_and_in_it_one_for_every_mode():
    value = content(mode(), mode(p=(0.0, 0.25)))
    trees = [[[1], [1]]] * 4
    own = by_cases(value, [ONE, ONE], [(0, 0, trees)])
    assert verdict(own) == "proven"
    for rows in ([], trees[1:], [*trees, []], [ONE, *trees[1:]], [[[1], [1], [1]], *trees[1:]]):
        assert verdict(by_cases(value, [ONE, ONE], [(0, 0, rows)])) == "not checked"
    for images in ([], [(0, 1, trees)], [(1, 0, trees)], [(0, 0, trees), (0, 0, [])]):
        assert verdict(by_cases(value, [ONE, ONE], images)) == "not checked"
    assert verdict(by_cases(value, [ONE], [(0, 0, trees)])) == "not checked"  # inputs
    second = content(mode(), mode(p=(0.0, 0.75)))  # the second mode leads out
    assert verdict(by_cases(second, [ONE, ONE], [(0, 0, trees)])) == "not checked"
    beyond = content(mode(), F=(2.0, 1.0, 1.0, 1.0))  # outside X, where no box holds
    assert verdict(by_cases(beyond, [ONE, ONE], [(0, 0, [ONE] * 4)])) == "refuted"


def test_cases_of_a_mode_know_its_region_and_u():
    """x+ = x + 1/2 where x1 <= 0 and u <= -1/2, u = x1: rows 5 and on are those of (x, u) where the mode acts."""
    moves = mode(A=((1.0, 0.0), (0.0, 0.0)), p=(1.5, 0.0), region=((1.0, 0.0, 0.0), 0.0))
    value = content(moves, mode(A=((0.5, 0.0), (0.0, 0.5))))
    value["network"]["output"]["weight"] = [[1.0, 0.0]]
    value["system"]["input_set"]["h"] = [1.0, 1.0]
    inputs = [ONE, ONE]
    tree = {"x1": [1, 4, 1], "U": [1, 5, 1]}
    assert verdict(by_cases(value, inputs, [(0, 0, [[tree["x1"], [1]], *[[[1], [1]]] * 3])])) == "not checked"  # 3 / 2
    moves["p"] = [1.0, 0.0]
    assert verdict(by_cases(value, inputs, [(0, 0, [[tree["x1"], [1]], *[[[1], [1]]] * 3])])) == "proven"
    assert verdict(by_cases(value, inputs, [(0, 0, [[tree["U"], [1]], *[[[1], [1]]] * 3])])) == "not checked"
    value["system"]["state_set"] = box(2.0)  # F_max is a half of X: the box of F_max counts, not that of X
    value["system"]["input_set"]["h"] = [2.0, 2.0]
    assert verdict(by_cases(value, inputs, [(0, 0, [[tree["x1"], [1]], *[[[1], [1]]] * 3])])) == "proven"


def test_every_mode_has_a_region_of_its_own_in_a_proof_by_cases():
    """x+ = x + (1, 0) where x1 <= 0, which row 5 says, the first of the region."""
    left = mode(A=((1.0, 0.0), (0.0, 0.0)), p=(1.0, 0.0), region=((1.0, 0.0, 0.0), 0.0))
    anywhere = {**left, "region": mode()["region"]}
    tree, rest = [1, 4, 1], [[[1], [1]]] * 3
    assert verdict(by_cases(content(mode(), left), [ONE, ONE], [(0, 0, [[[1], tree], *rest])])) == "proven"
    assert verdict(by_cases(content(left, anywhere), [ONE, ONE], [(0, 0, [[tree, tree], *rest])])) == "not checked"


def test_a_proof_by_cases_is_about_one_set_after_the_other():
    """The last set is larger than the one before along x2, and not RPI for that."""
    value = content(mode(A=((0.0, 0.9), (0.9, 0.0))), later=[(0.9,) * 4, (0.82, 1.0, 0.82, 1.0)])
    images = [(k, j, [ONE] * 4) for k, j in ((0, 0), (0, 1), (1, 2), (2, 2))]
    found = check(by_cases(value, [ONE, ONE], images))
    assert found["sequence"].verdict == "proven" and found["terminal_set"].verdict == "not checked"


def test_only_rows_of_one_coordinate_cut_the_box_of_a_proof_by_cases():
    """x1 - x2 <= 0 does not limit x1; x+ = x + (1/2, 0) leaves the square."""
    value = content(mode(A=((1.0, 0.0), (0.0, 1.0)), p=(0.5, 0.0)), F=(1.0, 1.0, 1.0, 1.0, 0.0))
    value["template"] = [*SQUARE, [1.0, -1.0]]
    found = check(by_cases(value, [ONE, ONE], [(0, 0, [ONE] * 5)]))["safe_set"]
    assert found.verdict == "not checked" and "row 1 of F_max" in found.reason


def test_the_states_that_attain_the_criterion_are_replayed():
    value = content(mode(D=box(0.5)), later=[(1.0,) * 4])
    corners = [(1, [x, y]) for x, y in ((0.9, 0.0), (0.0, 0.9), (-0.9, 0.0), (0.0, -0.9))]
    trees = [ONE] * 4
    images = [(k, j, trees) for k, j in ((0, 0), (0, 1), (1, 1))]
    own = by_cases(value, [ONE, ONE], images, corners)
    assert {found.verdict for found in check(own).values()} == {"proven"}
    assert check(own)["criterion"].work == {"states": 4}
    for change in (
        corners[1:],
        [*corners, corners[0]],
        corners[::-1],
        [(0, corners[0][1]), *corners[1:]],  # modes are counted from 1
        [(2, corners[0][1]), *corners[1:]],
        [(1e300, corners[0][1]), *corners[1:]],
        [(1, [0.95, 0.0]), *corners[1:]],  # outside S
        [(1, [0.5, 0.0]), *corners[1:]],  # which leads to 3/4
        [],
    ):
        assert verdict(by_cases(value, [ONE, ONE], images, change), "criterion") == "not checked"
    value["claims"]["criterion"]["holds"] = False
    assert verdict(by_cases(value, [ONE, ONE], images, corners), "criterion") == "refuted"
    away = {**value["claims"]["criterion"], "centre": [3.0, 0.0]}
    value["claims"]["criterion"] = away
    assert verdict(by_cases(value, [ONE, ONE], images, []), "criterion") == "proven"  # no centre in R_k: it fails


def test_a_step_in_the_file_refutes_a_claim_by_cases_if_it_is_one():
    value = content(mode(p=(0.6, 0.0)))
    step = check(value)["safe_set"].witness
    trees = [ONE] * 4
    value["claims"]["safe_set"] = {"verdict": "not proven", "witness": step}
    found = check(by_cases(value, [ONE, ONE], [(0, 0, trees)]))["safe_set"]
    assert found.verdict == "refuted" and found.witness == step
    for change in (
        {"state": ["2", "0"]},
        {"state": ["0", "0"]},
        {"mode": 0},
        {"mode": 2},
        {"disturbance": ["1", "0"]},
        {"state": 7},
        {"more": 7},
    ):
        value["claims"]["safe_set"]["witness"] = {**step, **change}
        assert check(by_cases(value, [ONE, ONE], [(0, 0, trees)]))["safe_set"].verdict == "not checked"


def test_by_cases_regions_have_to_cover_all_of_f_max_and_u():
    left = mode(region=((1.0, 0.0, 0.5), 0.0))
    for room, expected in ((0.0, "proven"), (1e-300, "not checked")):
        right = mode(region=((-1.0, 0.0, -0.5), -room))
        value = by_cases(content(left, right), [ONE, ONE], [(0, 0, [[[1], [1]]] * 4)])
        assert verdict(value) == expected
    assert "no region contains" in check(value)["safe_set"].reason


@pytest.mark.parametrize("proof", ["cells", "cases"])
@pytest.mark.parametrize("n", [1, 3, 4])
def test_every_claim_is_decided_for_any_number_of_states(n, proof):
    """x+ = x / 2 from |x| <= 1 to |x| <= 1/2."""
    rows = np.vstack([np.eye(n), -np.eye(n)]).tolist()
    one = {
        "A": (0.5 * np.eye(n)).tolist(),
        "B": [[0.0]] * n,
        "p": [0.0] * n,
        "region": {"H": [[0.0] * (n + 1)], "h": [1.0]},
        "disturbance": {"H": rows, "h": [0.0] * 2 * n},
    }
    own = {"alpha": "2", "stable": True, "centre": [0.0] * n}
    value = content(one, later=[(0.5,) * 4], theorem_1=own, criterion={"holds": False, "centre": [2.0] * n})
    value["system"]["state_set"] = {"H": rows, "h": [1.0] * 2 * n}
    value["network"]["output"]["weight"] = [[0.0] * n]
    value["template"], value["sets"] = rows, [[1.0] * 2 * n, [0.5] * 2 * n]
    value["plant"] = {"f": [[{"coefficient": 0.5, "powers": [int(i == j) for j in range(n + 1)]}] for i in range(n)]}
    value["claims"] |= {"error_set": {"verdict": "proven"}, "theorem_2": {"verdict": "proven"}}
    if proof == "cases":
        value = by_cases(value, [ONE, ONE], [(k, j, [ONE] * 2 * n) for k, j in ((0, 0), (0, 1), (1, 1))])
    assert {found.verdict for found in check(value).values()} == {"proven"} and len(check(value)) == 8
    value["sets"][1][0] = np.nextafter(0.5, 0)
    assert verdict(value, "sequence") == ("refuted" if proof == "cells" else "not checked")
    value["sets"][1][0], value["system"]["modes"][0]["disturbance"]["h"][-1] = 0.5, 5e-324
    assert verdict(value, "sequence") == ("refuted" if proof == "cells" else "not checked")


def test_bounds_of_a_solver_count_for_nothing():
    value = content(mode(p=(0.6, 0.0)))
    value["bounds"] = {"solver": "HiGHS", "offsets": [[0.0] * 4]}
    assert verdict(value) == "refuted"
    with pytest.raises(checker.Malformed, match="bounds"):
        check({**value, "format": checker.WITH_CASES})
    with pytest.raises(checker.Malformed, match="cases"):
        check({**content(), "cases": {}})


# -- digest, numbers ----------------------------------------------------------------------------------


def test_a_digest_is_of_the_content_not_of_its_letters():
    def digest(text):
        return checker.digest(checker.parse(text))

    assert digest('{"a": 100, "b": [0.50]}') == digest('{"b":[5e-1],"digest": "x", "a":1e2}')
    assert digest('{"a": -0.0}') == digest('{"a": 0}')
    different = [
        "1",
        "true",
        '"1"',
        "null",
        "[]",
        "{}",
        '""',
        "[1]",
        "[[1]]",
        '{"1": 1}',
        '["1"]',
        "1.0000000000000001",
    ]
    different += ['"\\u00e9"', '"e\\u0301"', '"1,2"', '["1,2"]', '["1", "2"]', "[1, 2]", "[12]"]
    assert len({digest(f'{{"a": {text}}}') for text in different}) == len(different)
    assert digest('{"a": 1, "b": 2}') != digest('{"a": 2, "b": 1}')


def test_numbers_are_the_floats_that_they_are_and_fractions_are_themselves():
    for text in ("0.1", "0.10000000000000000000001", "1e-1", "0.1000000000000000055511151231257827"):
        assert checker.number(checker.Numeral(text), "it") == Fraction(0.1) != Fraction(1, 10)
    assert checker.number(checker.Numeral("1e-330"), "it") == 0
    assert checker.coefficient_of("1/10", "it") == Fraction(1, 10)
    assert checker.coefficient_of(checker.Numeral("0.1"), "it") == Fraction(0.1)
    everywhere = {"A": ((0.1, 0.0), (0.0, 0.1)), "p": (0.1, 0.0), "region": ((0.1, 0.0, 0.0), 0.1), "D": box(0.1)}
    value = with_plant(mode(**everywhere), f=([(0.1, 0, 0, 0)], []), F=(0.1,) * 4, X=box(0.1), later=[(0.1,) * 4])
    value["claims"]["criterion"] |= {"epsilon": 0.1, "centre": [0.1, 0.1]}
    value["network"]["output"] = {"weight": [[0.1, 0.1]], "bias": [0.1]}
    value["template"] = [[0.1, 0.0], [0.0, 0.1], [-0.1, 0.0], [0.0, -0.1]]
    read = checker.Certificate.of(checker.parse(json.dumps(value)))
    numbers, seen = [[getattr(read, name) for name in ("modes", "state_set", "network", "sets", "plant", "claims")]], []
    while numbers:
        one = numbers.pop()
        if isinstance(one, (checker.Mode, checker.Network)):
            numbers += vars(one).values()
        elif isinstance(one, (tuple, list, dict)):
            numbers += one.values() if isinstance(one, dict) else one
        elif isinstance(one, Fraction) and one.denominator > 1:
            seen.append(abs(one))
    assert set(seen) == {Fraction(0.1)} and len(seen) > 30


@pytest.mark.parametrize(
    "alpha", ["1/0", "1/00", "1/-2", "1/", "/2", "1.5", "", " 1", "1/2 ", "1_0", "\u0661/\u0660", 2.5]
)
def test_what_is_no_fraction_is_refused(alpha):
    with pytest.raises(checker.Malformed, match="no fraction"):
        check(content(later=[(0.5,) * 4], theorem_1={"alpha": alpha}))


@pytest.mark.parametrize("pool", [0, -1, 1.5, 4, 1e30, "3", None])
def test_pools_are_whole_and_divide_the_rows(pool):
    value = content()
    value["network"]["hidden"] = [{"weight": [[1.0, 0.0]] * 3, "bias": [0.0] * 3, "pool": pool}]
    value["network"]["output"]["weight"] = [[0.0]]
    with pytest.raises(checker.Malformed, match="hidden layer 1"):
        check(value)


@pytest.mark.parametrize("change", [{"steps": 0.5}, {"steps": -1}, {"steps": "1"}])
def test_steps_are_whole(change):
    with pytest.raises(checker.Malformed, match="terminal_set"):
        check(content(later=[(0.5,) * 4], terminal_set=change))


def test_a_template_has_no_row_of_zeros():
    value = content()
    value["template"] = [*SQUARE[:3], [0.0, -0.0]]
    with pytest.raises(checker.Malformed, match="row of zeros"):
        check(value)


# -- hostile files ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("seed", "n", "proof", "only"), [(15, 2, None, ()), (3, 2, None, ("claims", "plant")), (1, 1, "cases", ("cases",))]
)
def test_whatever_stands_in_whatever_place_is_refused_or_checked(seed, n, proof, only):
    """`outcome` lets no other exception than Malformed pass."""
    text = random_certificate(seed, n, proof)
    known = outcome(text)[0]
    for number, path in enumerate(nodes(json.loads(text))):
        if only and path[0] not in only:  # the rest of it has been in the first
            continue
        for strange in STRANGE:
            value = json.loads(text)
            put(value, path, strange)
            verdict, _ = outcome(json.dumps(value), seconds=20)
            assert verdict in ("refused", "refuted", "not checked", "accepted"), (number, path, strange)
            if verdict == "accepted" and known != "accepted":
                raise AssertionError(f"{path}: {strange} made it true")
            if isinstance(strange, (str, list, dict)) and isinstance(get(json.loads(text), path), (int, float)):
                assert verdict == "refused"


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"null",
        b"[]",
        b'"x"',
        b"1",
        b"\xff\xfe\x00",
        b"[" * 100_000,
        b"[" * 900 + b"]" * 900,
        b'{"a":' * 5_000 + b"1" + b"}" * 5_000,
        b'{"format": NaN}',
        b'{"format": -Infinity}',
        b'{"a": 1e9999}',
        b'{"a": ' + b"1" * 50 + b"}",
        b'{"a": 1, "a": 1}',
        b"{" + b",".join(b'"k%d":1' % i for i in range(100_000)) + b',"k99999":1}',
        b"[" + b"1e999," * 200_000 + b"1]",
        b" " * (checker.MOST_BYTES + 1),
    ],
    ids=range(17),
)
def test_what_is_no_certificate_is_refused(text, tmp_path):
    path = tmp_path / "certificate.json"
    path.write_bytes(text)
    with pytest.raises(checker.Malformed):
        checker.verify(path)
    with pytest.raises(checker.Malformed):
        checker.verify(SHIPPED["pwa"], network=path)


def told(text, key="witness"):
    """A certificate whose claim `inputs` has this text where nobody needs it, with a digest."""
    value = content(inputs={"verdict": "not proven", key: "@"})
    return json.dumps({**value, "digest": "0"}).replace('"@"', text)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[" + "1e999," * 100_000 + "1]", "no number of reasonable size"),
        ("[" + "1e-999," * 100_000 + "1]", "no number of reasonable size"),
        ("[" + "1," * 1_100_000 + "1]", "commas"),
        ("[" * 2_900_000 + "]" * 2_900_000, "levels"),
        ('{"a":' * 300_000 + "1" + "}" * 300_000, "levels"),
        ('["' + '\\"' * 600_000, "not JSON"),
        ('["' + "[" * 5_900_000 + '"]', None),
        ('"' + "\\ud800" * 300_000 + '"', None),
        ("[" + "1e308," * 490_000 + "1]", None),
        ("{" + ",".join(f'"k{i}":1' for i in range(450_000)) + "}", None),
    ],
    ids=range(10),
)
def test_what_nobody_reads_costs_little_whatever_it_is(text, says, tmp_path):
    """Reading takes a few seconds, and the digest keeps to the seconds as everything does."""
    path = tmp_path / "certificate.json"
    path.write_text(told(text))
    begin = time.process_time()
    if says is None:
        report = checker.verify(path, seconds=0.2)
        assert report.digest in ("changed", "not checked")
        assert {result.verdict for result in report.results} == {"not checked"} and not report.proven
    else:
        with pytest.raises(checker.Malformed, match=says):
            checker.verify(path, seconds=0.2)
    assert time.process_time() - begin < 8


@pytest.mark.parametrize("text", ["1e309", "-1.8e308", "1e399", "9" * 40 + "e299"])
def test_numbers_are_finite_wherever_they_stand(text):
    with pytest.raises(checker.Malformed, match="reasonable size"):
        checker.parse(told(text))
    assert checker.parse(told("1.79e308"))["claims"]["inputs"]["witness"] == "1.79e308"


def test_the_digest_is_not_compared_after_the_time():
    report = checker.verify(SHIPPED["pwa"], seconds=0)
    assert report.digest == "not checked" and not report.proven
    assert all("stopped after 0 s" in result.reason for result in report.results)


def test_the_digest_is_made_in_parts():
    value = checker.parse("{" + ",".join(f'"k{i}": [1e308, 2e-308]' for i in range(5_000)) + "}")
    tracemalloc.start()
    try:
        checker.digest(value)
        assert tracemalloc.get_traced_memory()[1] < 2e6
    finally:
        tracemalloc.stop()


def test_marks_within_texts_are_no_levels():
    deep = "[" * 30 + '\\"' + "{" * 30
    assert checker.parse(json.dumps({"a": deep, deep: "}]\\"})) == {"a": deep, deep: "}]\\"}
    assert checker.parse("[" * 20 + "]" * 20) and checker.parse(b"\xef\xbb\xbf[1]") == ["1"]
    with pytest.raises(checker.Malformed, match="levels"):
        checker.parse("[" * 21 + "]" * 21)


def test_memory_is_limited_as_time_is(monkeypatch):
    monkeypatch.setattr(checker, "MOST_MEMORY", 20_000)
    net = dict(hostile())["1000 neurons"]
    assert all("needs more than" in found.reason for found in check(net).values())
    assert "needs more than" in check(content(*[mode() for _ in range(200)]))["safe_set"].reason
    with pytest.raises(checker.Stopped, match="needs more"):
        checker.Budget(9).hold(20_001)


@pytest.mark.parametrize("seconds", [-1.0, float("nan")])
def test_seconds_are_a_number_from_0_on(seconds):
    with pytest.raises(ValueError, match="seconds"):
        check(content(), seconds=seconds)
    with pytest.raises(SystemExit):
        main(["verify", str(SHIPPED["pwa"]), "--seconds", str(seconds)])


def test_reasons_that_nobody_reads_may_not_be_deep():
    deep = []
    for _ in range(400):
        deep = [deep]
    with pytest.raises(checker.Malformed, match="levels"):
        check(content(inputs={"reason": deep}))


def hostile():
    """Contents of a size that is allowed and that nobody could check."""
    rng = np.random.default_rng(0)
    turns = np.linspace(0, 2 * np.pi, 1500, endpoint=False)
    ring = np.column_stack([np.cos(turns), np.sin(turns)]).round(8).tolist()

    def net(layers, width, pool, scale=1.0):
        hidden, size = [], 2
        for _ in range(layers):
            W, b = rng.normal(size=(width * pool, size)), rng.normal(size=width * pool)
            hidden.append({"weight": (scale * W.round(2)).tolist(), "bias": b.round(2).tolist(), "pool": pool})
            size = width
        output = {"weight": rng.normal(size=(1, size)).round(2).tolist(), "bias": [0.0]}
        return {**content(), "network": {"format": checker.NETWORK, "hidden": hidden, "output": output}}

    yield "X with 1500 rows", content(X={"H": ring, "h": [3.0] * 1500})
    yield "D with 1500 rows", content(mode(D={"H": ring, "h": [0.1] * 1500}))
    value = content(later=[(0.5,) * 4])
    value["template"], value["sets"] = ring, [[0.5 - 1e-4 * k] * 1500 for k in range(30)]
    value["claims"]["terminal_set"]["steps"] = 29
    yield "30 sets with 1500 rows", value
    yield "100 layers", net(100, 8, 3)
    yield "100 layers of tiny weights", net(100, 6, 3, 1e-300)
    yield "100 layers of huge weights", net(100, 6, 3, 1e300)
    yield "2000 channels", net(1, 1, 2000)
    yield "1000 neurons", net(1, 1000, 2)
    yield "101 layers", net(101, 1, 1)
    strips = [[*rng.normal(size=3).round(2).tolist()] for _ in range(2000)]
    yield "2000 modes", content(*(mode(region=((a, 0.3), ([-e for e in a], 0.1))) for a in strips))
    f = [[(1.0, *powers) for powers in {tuple(rng.integers(0, 7, 3).tolist()) for _ in range(300)}] for _ in range(2)]
    yield "300 terms of degree 18", with_plant(f=f)
    f = [[(float(rng.normal()), *powers) for powers in {tuple(rng.integers(0, 4, 3).tolist()) for _ in range(40)}]] * 2
    yield "40 terms of degree 9", with_plant(mode(D=box(0.3)), f=f)
    yield "x^21", with_plant(f=[[(1.0, 21, 0, 0)], []])


def hostile_in_space():
    """Contents of many states, and proofs by cases, of a size that is allowed and that nobody could check."""
    rng = np.random.default_rng(0)

    def loop(n, m=1, rows=None, D=None, F=None):
        own = np.vstack([np.eye(n), -np.eye(n)]).tolist()
        rows, X = rows or own, {"H": own, "h": [1.0] * 2 * n}
        one = {"A": (0.5 * np.eye(n)).tolist(), "B": [[0.0] * m] * n, "p": [0.0] * n}
        one |= {"region": {"H": [[0.0] * (n + m)], "h": [1.0]}, "disturbance": D or {"H": own, "h": [0.0] * 2 * n}}
        value = content(one, F=F or [1.0] * len(rows))
        value["system"] |= {"state_set": X, "input_set": box_of(m)}
        output = {"weight": [[0.0] * n] * m, "bias": [0.0] * m}
        return {**value, "template": rows, "network": {**value["network"], "output": output}}

    def box_of(m):
        return {"H": np.vstack([np.eye(m), -np.eye(m)]).tolist(), "h": [1.0] * 2 * m}

    def net(value, layers, width, pool, scale=1.0):
        """A network of `layers` hidden layers; the first channel of each has no weights."""
        hidden, size = [], len(value["template"][0])
        for _ in range(layers):
            W, b = rng.normal(size=(width * pool, size)).round(2), rng.normal(size=width * pool).round(2)
            W[0] = 0
            hidden.append({"weight": (scale * W).tolist(), "bias": b.tolist(), "pool": pool})
            size = width
        m = len(value["system"]["input_set"]["H"][0])
        output = {"weight": rng.normal(size=(m, size)).round(2).tolist(), "bias": [0.0] * m}
        return {**value, "network": {"format": checker.NETWORK, "hidden": hidden, "output": output}}

    for n in (12, 100):
        yield f"boxes of {n} states", loop(n)
        yield f"boxes of {n} states by cases", by_cases(loop(n), [ONE, ONE], [(0, 0, [ONE] * 2 * n)])
    signs = (1.0 - 2 * rng.integers(0, 2, (2000, 11))).tolist()
    yield "a cross-polytope", loop(11, rows=signs, F=[3.0] * 2000)
    t = np.linspace(-1, 1, 400)[:, None] ** np.arange(1, 7)
    t = (t - t.mean(axis=0)).round(12).tolist()
    yield "a dual cyclic polytope", loop(6, rows=t, F=[1.0] * 400)
    yield "a dual cyclic D", loop(6, D={"H": t, "h": [0.1] * 400})
    long = (rng.normal(size=(24, 8)) * 10.0 ** rng.integers(-300, 300, (24, 8))).tolist()
    long += np.vstack([np.eye(8), -np.eye(8)]).tolist()
    yield "astronomically long corners", loop(8, rows=long, F=[1.0] * len(long))
    yield "many corners of F_max times those of U", by_cases(loop(7, 7), [ONE] * 14, [(0, 0, [ONE] * 14)])
    yield "a needle in space", loop(40, rows=[*np.eye(40).tolist(), [-1.0] * 40], F=[1e-300] * 40 + [1e300])
    value = loop(2)
    value["system"]["modes"] *= 400
    value["system"]["input_set"] = {"H": [[1.0], [-1.0]] * 500, "h": [1.0] * 1000}
    yield "400 modes and 1000 rows of U", value
    chain = [[layer, 0] for layer in range(100)]
    for name, shape in (
        ("2000 channels of one neuron", (1, 1, 2000)),
        ("2000 channels of 1000 neurons", (1, 1000, 2)),
        ("100 layers of huge weights", (100, 20, 2, 1e300)),
        ("100 layers of tiny weights", (100, 20, 2, 1e-300)),
        ("10 layers of 50 neurons", (10, 50, 2, 1e10)),
    ):
        tree = [*chain[: shape[0]], *[[1]] * 300]
        yield name, by_cases(net(loop(2), *shape), [tree, tree], [(0, 0, [tree] * 4)])
    value = loop(2)
    value["network"]["hidden"] = []
    for size in (2, *[1] * 9):
        for rows, columns in ((2000, size), (2, 1000)):
            layer = {"weight": [[1.0] * columns] * rows, "bias": [0.0] * rows, "pool": 2}
            value["network"]["hidden"].append(layer)
    value["network"]["output"]["weight"] = [[1.0]]
    tree = [[2 * k, i] for k in range(10) for i in range(1000)]
    yield "10,000 splits", by_cases(value, [tree, tree], [(0, 0, [tree] * 4)])
    yield (
        "splits of 2000 channels",
        by_cases(net(loop(2), 20, 1, 2000), [[[k, 0] for k in range(20)]] * 2, [(0, 0, [[]] * 4)]),
    )
    value = net(loop(2), 100, 20, 2, 1e300)
    value["claims"] = content(later=[(1.0,) * 4])["claims"]
    value["sets"] *= 2
    value["system"]["input_set"] = {"H": [[0.0]], "h": [0.0]}
    images = [(k, j, [ONE] * 4) for k, j in ((0, 0), (0, 1), (1, 1))]
    yield "long numbers in states that attain", by_cases(value, [ONE], images, [(1, [0.5, 0.3])] * 4)
    value = loop(300)
    value["system"]["state_set"] = {"H": [[1e308] * 299 + [5e-324]], "h": [1e308]}
    yield "a simplex of 300 states with long corners", value
    value = net(loop(12), 1, 2000, 1)
    layer = {"weight": [[1.0] * 2000] * 100, "bias": [0.0] * 100, "pool": 1}
    value["network"]["hidden"].append(layer)
    value["network"]["output"]["weight"] = [[0.0] * 100]
    value = by_cases(value, [[[1]]] * 2, [])
    x = [f"1/{10**3990 + 2 * int(k) + 1}" for k in rng.integers(0, 10**6, 12)]
    zeros = ["0"] * 12
    witness = {"mode": 1, "state": x, "disturbance": zeros, "after": zeros}
    value["claims"]["safe_set"] = {"verdict": "not proven", "witness": witness}
    yield "a witness of long fractions", value
    value = loop(2)
    value["system"]["state_set"] = {
        "H": [[1e308, 5e-324], [-1e308, 1e-300], [1e-308, -1e308], [7e-300, 1e300]],
        "h": [1e-308] * 4,
    }
    yield "X of long numbers, by cases", by_cases(net(value, 30, 20, 2, 1e-300), [ONE, ONE], [(0, 0, [ONE] * 4)])


@pytest.mark.parametrize(("name", "value"), list(hostile()), ids=lambda value: value if isinstance(value, str) else "")
def test_what_would_take_too_long_ends(name, value):
    if name in ("101 layers", "300 terms of degree 18", "x^21"):
        with pytest.raises(checker.Malformed):
            check(value, seconds=0.5)
    else:
        assert {result.verdict for result in check(value, seconds=0.5).values()} <= {"proven", "refuted", "not checked"}


HOSTILE_IN_SPACE = dict(hostile_in_space())


@pytest.mark.parametrize("name", HOSTILE_IN_SPACE)
def test_what_would_take_too_long_ends_in_any_dimension(name):
    value = checker.parse(json.dumps(HOSTILE_IN_SPACE[name]))
    begin = time.process_time()
    report = checker.check(value, seconds=0.3)
    assert time.process_time() - begin < 2.5  # reading takes a part of it
    assert all(result.reason and result.verdict != "proven" for result in report.results[1:]) or "many" in name


@pytest.mark.parametrize(
    "name",
    [
        "many corners of F_max times those of U",
        "400 modes and 1000 rows of U",
        "10,000 splits",
        "2000 channels of 1000 neurons",
        "100 layers of huge weights",
        "astronomically long corners",
        "boxes of 100 states",
        "a simplex of 300 states with long corners",
    ],
)
def test_memory_is_limited_in_any_dimension(name, monkeypatch):
    monkeypatch.setattr(checker, "MOST_MEMORY", 1_000_000)
    value = checker.parse(json.dumps(HOSTILE_IN_SPACE[name]))
    certificate = checker.Certificate.of(value)
    tracemalloc.start()
    try:
        results = checker.Claims(certificate, checker.Budget(20)).results()
        assert tracemalloc.get_traced_memory()[1] < 8e6
    finally:
        tracemalloc.stop()
    assert "needs more than 1 MB" in results[0].reason + results[1].reason


def test_numbers_of_thousands_of_digits_have_a_witness_without_them():
    value = content()
    huge = [{"weight": [[1e300, 0.0]], "bias": [0.0], "pool": 1}] + [
        {"weight": [[1e300]], "bias": [0.0], "pool": 1} for _ in range(20)
    ]
    value["network"]["hidden"], value["network"]["output"]["weight"] = huge, [[1.0]]
    value["system"]["modes"][0]["B"] = [[1.0], [0.0]]
    found = check(value)
    assert found["inputs"].verdict == found["safe_set"].verdict == "refuted"
    assert "1e308 or more" in found["safe_set"].reason
    value["system"]["input_set"] = {"H": [[0.0]], "h": [0.0]}
    found = check(value)["safe_set"]
    assert found.witness["after"][0] is None and "1e308 or more" in found.reason


# -- the command --------------------------------------------------------------------------------------


@pytest.fixture
def small(tmp_path):
    """A function that writes a small certificate, with some text replaced, and returns the path."""

    def write(old="", new=""):
        text = random_certificate(0)
        assert old in text
        path = tmp_path / "certificate.json"
        path.write_text(text.replace(old, new, 1) if old else text)
        return path

    return write


def test_exit_status_and_words(small, capsys):
    assert main(["verify", str(small())]) == 0
    assert "as written" in capsys.readouterr().out
    changed = small('"sets": [[', '"sets": [[1')
    assert main(["verify", str(changed)]) == 1
    assert "not what the digest was made of" in capsys.readouterr().out
    assert main(["verify", str(changed), "--ignore-digest"]) == 1
    assert "refuted" in capsys.readouterr().out
    assert main(["verify", str(small('"digest"', '"more"'))]) == 2
    assert "'more'" in capsys.readouterr().err
    value = json.loads(random_certificate(0))
    del value["digest"]
    small().write_text(json.dumps(value))
    path = small()
    path.write_text(json.dumps(value))
    assert main(["verify", str(path)]) == 1 and "missing" in capsys.readouterr().out
    assert main(["verify", str(path), "--ignore-digest"]) == 0
    assert main(["verify", str(path), "--seconds", "0"]) == 1
    assert main(["verify", str(path.parent / "none.json")]) == 2
    assert main(["verify", str(path.parent)]) == 2


def test_the_network_that_is_asked_about(small, tmp_path, capsys):
    network, path = json.loads(random_certificate(0))["network"], small()
    asked = tmp_path / "network.json"
    asked.write_text(json.dumps(network, indent=3))
    assert main(["verify", str(path), "--network", str(asked)]) == 0
    assert "the one asked about" in capsys.readouterr().out
    network["output"]["bias"][0] += 1e-15
    asked.write_text(json.dumps(network))
    assert main(["verify", str(path), "--network", str(asked)]) == 1
    assert "ANOTHER" in capsys.readouterr().out
    assert main(["verify", str(path), "--network", str(path)]) == 2


@pytest.mark.parametrize("command", [["-I", "-S", "lib/mireach/certificate/checker.py"], ["-S", "run.py", "verify"]])
def test_nothing_has_to_be_installed(command):
    done = subprocess.run(
        [sys.executable, *command, str(SHIPPED["pwa"])], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0 and done.stdout.count(" proven ") == 6 and not done.stderr


def test_the_checker_imports_only_the_standard_library():
    lines = (ROOT / "lib" / "mireach" / "certificate" / "checker.py").read_text().splitlines()
    names = {line.split()[1].split(".")[0] for line in lines if line.startswith(("import ", "from "))}
    assert names <= set(sys.stdlib_module_names)


# -- mutations ----------------------------------------------------------------------------------------


def assert_nothing_false(text, changed):
    """With the digest a change is refused or named, without it what is called proven is true."""
    verdict, _ = outcome(changed, ignore_digest=False)
    if verdict not in ("refused", "named"):
        assert checker.digest(checker.parse(changed)) == checker.digest(checker.parse(text))
    verdict, report = outcome(changed)
    assert report is None or not false_claims(changed, report)
    return verdict


SMALL = [(seed, n, proof) for seed, n in enumerate((2, 1, 3, 2, 4)) for proof in ("cells", "cases")]


@pytest.mark.parametrize("kind", MUTATIONS)
def test_mutations_of_small_certificates_prove_nothing_that_is_false(kind):
    found = set()
    for number, one in enumerate(SMALL):
        text = random_certificate(*one)
        rng = np.random.default_rng([number, list(MUTATIONS).index(kind)])
        found.add(assert_nothing_false(text, MUTATIONS[kind](text, rng)))
    if kind == "written otherwise":
        assert found <= {"accepted", "refuted", "not checked"}  # as those certificates are themselves
    if kind in ("a key doubled", "a claim deleted", "cut off"):
        assert found == {"refused"}


@pytest.mark.parametrize("kind", CASE_MUTATIONS)
def test_mutations_of_proofs_by_cases_prove_nothing_that_is_false(kind):
    for seed, n in ((1, 1), (2, 2), (4, 1), (6, 2), (8, 3), (9, 2)):
        text = random_certificate(seed, n, "cases")
        for number in range(2):
            rng = np.random.default_rng([seed, number, list(CASE_MUTATIONS).index(kind)])
            assert_nothing_false(text, CASE_MUTATIONS[kind](text, rng))


@pytest.mark.parametrize(
    "kind", ["a digit", "a set moved", "a truth flipped", "swapped network", "the plant, slightly"]
)
@pytest.mark.parametrize("name", SHIPPED)
def test_mutations_of_the_shipped_certificates_prove_nothing_that_is_false(name, kind):
    text = SHIPPED[name].read_text()
    if kind == "swapped network":
        value = json.loads(text)
        line = (SHIPPED[name].parent / "seed_networks.jsonl").read_text().splitlines()[0]
        value["network"] = json.loads(line)["network"]
        assert assert_nothing_false(text, json.dumps(value)) == "refuted"
        return
    for seed in range(SHIPPED_SEEDS[name]):
        assert_nothing_false(text, MUTATIONS[kind](text, np.random.default_rng(seed)))


def test_the_oracle_notices_what_is_false():
    """Claims that a careless checker would let pass."""
    text = random_certificate(2)
    proven = checker.Report(
        tuple(checker.Result(name, "proven", "") for name in json.loads(text)["claims"]), "ignored", None
    )
    assert false_claims(text, proven) == []
    for change, claims in (
        (
            lambda value: value["sets"].__setitem__(-1, [h - 1e-3 for h in value["sets"][-1]]),
            {"sequence", "terminal_set"},
        ),
        (lambda value: value["sets"].__setitem__(0, [h + 9 for h in value["sets"][0]]), {"safe_set"}),
        (lambda value: value["system"]["input_set"].__setitem__("h", [1e-3, 1e-3]), {"inputs"}),
        (
            lambda value: value["claims"]["criterion"].__setitem__("holds", not value["claims"]["criterion"]["holds"]),
            {"criterion"},
        ),
        (lambda value: value["claims"]["theorem_1"].__setitem__("alpha", "7/5"), {"theorem_1"}),
        (lambda value: value["system"]["modes"][0]["p"].__setitem__(0, 5.0), {"safe_set"}),
    ):
        value = json.loads(text)
        change(value)
        assert claims <= set(false_claims(json.dumps(value), proven))


def test_growth_and_corners_of_the_oracle():
    corners = corners_of([((Fraction(a), Fraction(b)), Fraction(1, 2)) for a, b in SQUARE])
    assert len(corners) == 4 and holds([((Fraction(1), Fraction(1)), Fraction(1))], corners[-1])
    rows = [((Fraction(a), Fraction(b)), Fraction(1)) for a, b in SQUARE]
    assert growth_of(rows, corners, (0, 0)) == 2 and growth_of(rows, corners, (Fraction(1, 2), 0)) is None
