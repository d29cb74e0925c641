"""Certificates as they are written: case studies, repair of rounding, honest failures, more than two states."""

import json
import warnings
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from certificates import contracted, corners_of, false_claims, growth_of, random_certificate
from loops import affine_loop, exact_input, exactly_inside, jump_loop, random_loop

import mireach as mr
from mireach import certificate
from mireach.__main__ import main
from mireach.certificate import checker
from mireach.engines import exact

DATA = Path(__file__).resolve().parents[2] / "data"
PLANAR = {"inputs", "safe_set", "sequence", "terminal_set", "criterion", "theorem_1"}


def square(r):
    return mr.Polytope.box([-r, -r], [r, r])


def with_set(safe, h):
    """A SafeSet with other offsets."""
    return replace(safe, set=mr.Polytope(safe.set.H, h))


def verdicts(made):
    return {result.claim: result.verdict for result in made.report.results}


def small_loop(seed, **options):
    """A random loop that has a safe set."""
    loop = contracted(random_loop(seed, **options), 0.3)
    return loop, mr.safe_set(loop)


# -- the case studies ---------------------------------------------------------------------------------


@pytest.mark.parametrize("name", mr.case_studies.NAMES)
def test_shipped_certificates_are_proven_and_speak_of_the_shipped_network(name, capsys):
    path, network = str(DATA / name / "certificate.json"), str(DATA / name / "network.json")
    assert main(["verify", path, "--network", network]) == 0
    words = capsys.readouterr().out
    assert words.count(" proven ") == (8 if name == "double_integrator" else 6) and "the one asked about" in words
    assert ("by weak duality" in words) == (name == "quadrotor")
    content = json.loads(Path(path).read_text())
    case = mr.case_study(name)
    assert Fraction(content["claims"]["theorem_1"]["alpha"]) > 1 and content["claims"]["theorem_1"]["stable"]
    for mode, own in zip(content["system"]["modes"], case.system.modes, strict=True):
        for key in "ABp":  # the last digits of a least-squares fit depend on the machine
            np.testing.assert_allclose(mode[key], getattr(own, key), rtol=0, atol=1e-12)
    assert [mode["disturbance"] for mode in content["system"]["modes"]] == [
        mode.disturbance.to_dict() for mode in case.system.modes
    ]


def test_a_certificate_of_another_network_says_so(tmp_path, capsys):
    other = json.loads((DATA / "pwa" / "seed_networks.jsonl").read_text().splitlines()[0])["network"]
    path = tmp_path / "network.json"
    path.write_text(json.dumps(other))
    assert main(["verify", str(DATA / "pwa" / "certificate.json"), "--network", str(path)]) == 1
    assert "ANOTHER" in capsys.readouterr().out


def test_a_certificate_is_written_and_read(tmp_path):
    case = mr.case_study("pwa")
    safe = mr.safe_set(case.loop, case.safe_directions)
    terminal = mr.terminal_set(case.loop, safe, case.directions, 0.5)
    made = certificate.write(tmp_path / "it.json", case.loop, safe, terminal)
    report = certificate.verify(tmp_path / "it.json", DATA / "pwa" / "network.json")
    assert report.digest == "as written" and report.network
    assert report.results == made.report.results and verdicts(made).keys() == PLANAR
    assert made.report["safe_set"].verdict == "proven" and made.alpha == Fraction(
        made.content["claims"]["theorem_1"]["alpha"]
    )
    assert 0 <= made.inflation < 1e-8
    content, F = made.content, safe.set
    for row, h in zip(content["template"], content["sets"][0]):
        assert F.support([row])[0] <= h + 1e-9


# -- sets that rounding made too small ----------------------------------------------------------------


def test_a_set_that_rounding_made_too_small_is_enlarged_to_the_smallest_that_holds():
    loop = affine_loop(np.zeros((2, 2)), square(0.8))
    safe = mr.safe_set(loop, mr.box_directions(2))
    made = certificate.make(loop, with_set(safe, np.full(4, 0.8 - 1e-10)))
    assert made.report.results[1].verdict == "proven" and made.content["sets"] == [[0.8] * 4]
    assert made.inflation == 0.8 - (0.8 - 1e-10)


@pytest.mark.parametrize("gain", [0.5, 0.99])
def test_a_set_whose_enlargement_creeps_ends_just_above_the_limit(gain):
    loop = affine_loop(gain * np.eye(2), square(0.8 * (1 - gain)))
    safe = mr.safe_set(loop, mr.box_directions(2))
    made = certificate.make(loop, with_set(safe, np.full(4, 0.8 - 1e-10)))
    assert made.report["safe_set"].verdict == "proven" and made.inflation < 1e-8
    assert all(0.8 - 1e-12 < h < 0.8 + 1e-8 for h in made.content["sets"][0])


@pytest.mark.parametrize("seed", range(4))
def test_a_terminal_set_that_is_a_little_too_small_is_repaired(seed):
    loop, safe = small_loop(seed, with_input=seed % 2 == 1)
    terminal = mr.terminal_set(loop, safe, max_steps=6)
    shrunk = [terminal.history[0], *(mr.Polytope(R.H, R.h - 1e-10) for R in terminal.history[1:])]
    made = certificate.make(loop, safe, replace(terminal, set=shrunk[-1], history=shrunk))
    found = verdicts(made)
    assert {found[name] for name in ("safe_set", "sequence", "terminal_set")} == {"proven"}
    assert made.inflation < 1e-8
    assert not false_claims(json.dumps(made.content), made.report)


def test_offsets_of_x_that_are_no_short_decimals_stay_in_x():
    for seed in range(20):
        r = np.random.default_rng(seed).uniform(0.5, 5)
        loop = affine_loop(0.5 * np.eye(2), limits=r)
        safe = mr.safe_set(loop, mr.box_directions(2))
        assert certificate.make(loop, safe).report.results[1].verdict == "proven"


def in_unit(loop, s):
    """The loop in states s times as large, s a power of two."""
    system, net, n = loop.system, loop.network, loop.system.state_size
    first = mr.Layer(net.hidden[0].weight / s, net.hidden[0].bias, net.hidden[0].pool)
    modes = [
        replace(
            mode,
            B=s * mode.B,
            p=s * mode.p,
            region=mr.Polytope(np.hstack([mode.region.H[:, :n] / s, mode.region.H[:, n:]]), mode.region.h),
            disturbance=mr.Polytope(mode.disturbance.H, s * mode.disturbance.h),
        )
        for mode in system.modes
    ]
    X = mr.Polytope(system.state_set.H, s * system.state_set.h)
    with patch("mireach.systems.pwa._check_partition"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        system = mr.PWASystem(modes, X, system.input_set)
    return mr.ClosedLoop(system, mr.MaxoutNetwork((first, *net.hidden[1:]), net.weight, net.bias))


@pytest.mark.parametrize("seed", [1, 2])
def test_a_certificate_does_not_depend_on_the_unit(seed):
    """Sets that are too small by rounding are enlarged by the same share of X, from 2^-60 to 2^60."""
    loop, safe = small_loop(seed, with_input=seed % 2 == 1)
    terminal = mr.terminal_set(loop, safe, max_steps=4)
    for room, verdict in ((1e-10, "proven"), (-1e-3, "not proven")):
        known = None
        for s in (1.0, 2.0**-60, 2.0**-30, 2.0**30, 2.0**60):
            history = [mr.Polytope(R.H, s * (R.h - abs(room))) for R in terminal.history]
            history[0] = mr.Polytope(history[0].H, s * (terminal.history[0].h + min(room, 0)))
            own = replace(terminal, set=history[-1], history=history, centre=s * terminal.centre)
            made = certificate.make(in_unit(loop, s), replace(safe, set=history[0]), own)
            claims = made.content["claims"]
            found = made.alpha, made.inflation / s, [claim["verdict"] for claim in claims.values()]
            known = known or found
            assert found == known and claims["sequence"]["verdict"] == verdict
            assert verdict == "proven" or claims["sequence"]["reason"] == made.report["sequence"].reason


def test_rows_that_only_restate_a_set_have_the_exact_support_rounded_up():
    loop, safe = small_loop(3)
    terminal = mr.terminal_set(loop, safe, mr.directions(7), max_steps=2)
    made = certificate.make(loop, safe, terminal)
    own = {tuple(row + 0.0) for row in (*safe.set.H, *loop.system.state_set.H)}
    corners = corners_of(
        [(tuple(map(Fraction, a)), Fraction(b)) for a, b in zip(made.content["template"], made.content["sets"][0])]
    )
    restated = 0
    for row, h in zip(made.content["template"], made.content["sets"][0]):
        if tuple(row) not in own:
            top = max(Fraction(row[0]) * x[0] + Fraction(row[1]) * x[1] for x in corners)
            assert top <= Fraction(h) and np.nextafter(h, -np.inf) <= top
            restated += 1
    assert restated


# -- sets that cannot be repaired ---------------------------------------------------------------------


@pytest.mark.parametrize("with_terminal", [False, True])
def test_a_set_that_is_too_small_is_not_proven_and_has_a_step_of_fractions(with_terminal):
    loop = affine_loop([[0.5, 0.1], [0.0, 0.5]], square(0.3))
    safe = mr.safe_set(loop)
    small = with_set(safe, mr.terminal_set(loop, safe).set.support(safe.set.H) - 0.1)
    terminal = None
    if with_terminal:
        terminal = mr.terminal_set(loop, safe, max_steps=2)
        terminal = replace(terminal, history=[small.set, *terminal.history[1:]])
    made = certificate.make(loop, small, terminal)
    assert not made.report.proven and made.report["safe_set"].verdict == "refuted"
    claim = made.content["claims"]["safe_set"]
    assert claim["verdict"] == "not proven" and claim["reason"] == made.report["safe_set"].reason
    replays(loop, made.content, claim["witness"], 0)


def replays(loop, content, witness, k):
    """The step is one of the loop and leads out of set number k, exactly."""
    x, d, after = ([Fraction(value) for value in witness[key]] for key in ("state", "disturbance", "after"))
    mode = loop.system.modes[witness["mode"] - 1]
    u = exact_input(loop.network, x)
    rows = [([Fraction(a) for a in row], Fraction(h)) for row, h in zip(content["template"], content["sets"][k])]
    assert exactly_inside(mode.region, [*x, *u]) and exactly_inside(mode.disturbance, d)
    assert all(a[0] * x[0] + a[1] * x[1] <= b for a, b in rows)
    for i in range(2):
        row = [Fraction(value) for value in (*mode.A[i].tolist(), *mode.B[i].tolist())]
        assert sum(a * b for a, b in zip(row, [*x, *u])) + Fraction(mode.p.tolist()[i]) + d[i] == after[i]
    assert any(a[0] * after[0] + a[1] * after[1] > b for a, b in rows)


def test_what_rests_on_a_claim_that_is_not_proven_is_not_proven_and_says_why():
    loop = affine_loop([[0.5, 0.1], [0.0, 0.5]], square(0.3))
    safe = mr.safe_set(loop)
    terminal = mr.terminal_set(loop, safe, max_steps=2)
    small = with_set(safe, safe.set.h / 10)
    made = certificate.make(loop, small, replace(terminal, history=[small.set, *terminal.history[1:]]))
    for result in made.report.results:
        claim = made.content["claims"][result.claim]
        assert claim["verdict"] == ("proven" if result.verdict == "proven" else "not proven")
        assert result.verdict == "proven" or claim["reason"] == result.reason
    assert "rests on" in made.content["claims"]["terminal_set"]["reason"]


def test_a_file_that_is_not_proven_is_verified_as_such(tmp_path):
    loop = affine_loop(0.5 * np.eye(2), square(0.3))
    safe = with_set(mr.safe_set(loop, mr.box_directions(2)), np.full(4, 0.5))
    certificate.write(tmp_path / "it.json", loop, safe)
    assert main(["verify", str(tmp_path / "it.json")]) == 1
    report = certificate.verify(tmp_path / "it.json")
    assert report.digest == "as written" and [one.verdict for one in report.results] == ["proven", "refuted"]


def test_a_criterion_that_floats_got_wrong_is_put_right():
    loop, safe = small_loop(2)
    terminal = mr.terminal_set(loop, safe, epsilon=0.05, max_steps=4)
    for holds in (True, False):
        made = certificate.make(loop, safe, replace(terminal, criterion=holds))
        assert made.report["criterion"].verdict == "proven"
        assert made.content["claims"]["criterion"]["holds"] == terminal.criterion


# -- engines ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [1, 2])
def test_sets_that_the_milp_found_in_the_plane_are_proven_exactly(seed):
    loop, _ = small_loop(seed, with_input=seed % 2 == 1)
    safe = mr.safe_set(loop, mr.directions(6), engine="milp")
    terminal = mr.terminal_set(loop, safe, mr.directions(4), max_steps=3, engine="milp")
    made = certificate.make(loop, safe, terminal)
    assert {verdicts(made)[name] for name in ("safe_set", "sequence", "terminal_set")} == {"proven"}
    assert "bounds" not in made.content and not false_claims(json.dumps(made.content), made.report)


@pytest.mark.parametrize("n", [1, 2, 3])
def test_both_kinds_of_proof_are_written_and_say_the_same(n, tmp_path, capsys):
    loop, safe = small_loop(n, n=n, cuts=1, layers=1)
    terminal = mr.terminal_set(loop, safe, max_steps=2)
    by_cells = certificate.make(loop, safe, terminal, proof="cells")
    by_cases = certificate.write(tmp_path / "it.json", loop, safe, terminal, proof="cases")
    assert certificate.make(loop, safe, terminal).content == by_cells.content  # there are few cells
    assert "cases" not in by_cells.content and by_cells.content["format"] == checker.FORMAT
    assert by_cases.content["format"] == checker.WITH_CASES and by_cases.content["cases"].keys() == {
        "inputs",
        "images",
        "attained",
    }
    for name in ("inputs", "safe_set", "sequence", "terminal_set"):
        assert by_cells.report[name].verdict == by_cases.report[name].verdict == "proven"
        assert (by_cells.report[name].kind, by_cases.report[name].kind) == (
            "cells",
            "weak duality",
        ) or name == "safe_set"
    assert 0 <= by_cells.inflation <= by_cases.inflation < 1e-9
    for made in (by_cells, by_cases):
        assert not false_claims(json.dumps(made.content), made.report)
    main(["verify", str(tmp_path / "it.json")])
    words = capsys.readouterr().out
    assert "as written" in words and "weak duality" in words
    report = certificate.verify(tmp_path / "it.json")
    assert [one.verdict for one in report.results] == [one.verdict for one in by_cases.report.results]


@pytest.mark.parametrize("n", [1, 2, 3])
def test_sets_that_are_too_small_have_a_step_in_a_certificate_by_cases(n):
    loop = affine_loop(0.5 * np.eye(n), mr.Polytope.box([-0.3] * n, [0.3] * n))
    safe = mr.safe_set(loop, mr.box_directions(n))
    made = certificate.make(loop, with_set(safe, np.full(2 * n, 0.5)), proof="cases")
    claim = made.content["claims"]["safe_set"]
    assert made.report["safe_set"].verdict == "refuted" and claim["verdict"] == "not proven"
    x, d, after = ([Fraction(value) for value in claim["witness"][key]] for key in ("state", "disturbance", "after"))
    assert all(abs(entry) <= Fraction(0.5) for entry in x) and max(map(abs, after)) > Fraction(0.5)
    assert after == [entry / 2 + e for entry, e in zip(x, d)] and all(abs(e) <= Fraction(0.3) for e in d)


def test_a_step_in_a_certificate_by_cases_names_the_mode_that_acts():
    loop = jump_loop([0.0, 0.0], [3.0, 0.0])
    safe = mr.safe_set(loop, mr.box_directions(2))
    made = certificate.make(loop, with_set(safe, np.full(4, 2.0)), proof="cases")
    witness = made.content["claims"]["safe_set"]["witness"]
    assert made.report["safe_set"].verdict == "refuted" and made.report["safe_set"].witness == witness
    assert witness["mode"] == 2 and Fraction(witness["state"][0]) >= 1 and witness["after"] == ["3", "0"]


@pytest.mark.parametrize("seed", range(10))
def test_growth_agrees_with_corners_in_fractions(seed):
    rng = np.random.default_rng(seed)
    C = np.vstack([mr.directions(5), rng.normal(size=(2, 2))])
    h, before = rng.uniform(0.5, 2, 7), rng.uniform(0.5, 3, 7)
    centre = rng.choice([0.0, 0.1, 0.3], 2).tolist()
    rows = [[(tuple(map(Fraction, a)), Fraction(b)) for a, b in zip(C.tolist(), v.tolist())] for v in (before, h)]
    c = [Fraction(value) for value in centre]
    assert exact.growth(C, before, h, centre) == growth_of(rows[0], corners_of(rows[1]), c)
    assert exact.growth(C, before, h, [9.0, 0.0]) is None


# -- plants -------------------------------------------------------------------------------------------


def value_of(content, z):
    """f of a certificate in floats."""
    return [
        sum(float(Fraction(term["coefficient"])) * np.prod([b**k for b, k in zip(z, term["powers"])]) for term in terms)
        for terms in content["plant"]["f"]
    ]


def in_plane(f):
    """A certificate of x+ = x / 2 + d, |d| <= 0.4, with a plant f."""
    loop = affine_loop(0.5 * np.eye(2), square(0.4))
    plant = mr.NonlinearSystem(f, loop.system.state_set, loop.system.input_set)
    return certificate.make(loop, mr.safe_set(loop), plant=plant), plant


def test_f_is_written_as_the_polynomial_that_it_is():
    def f(x, u):
        cube = 0.1 * (x[0] - u[0]) ** 3 / 4
        return [x[0] / 2 + cube + np.float64(0.125), 0.5 * x[1] - (0.2 - x[0] * u[0]) * 0.1 + -x[1] * 0]

    made, plant = in_plane(f)
    for z in np.random.default_rng(0).uniform(-1, 1, (20, 3)):
        np.testing.assert_allclose(value_of(made.content, z), plant(z[:2], z[2:]), atol=1e-15)
    assert made.report["error_set"].verdict == "proven" and made.report["theorem_2"].verdict == "not checked"
    terms = [{tuple(term["powers"]): Fraction(term["coefficient"]) for term in f} for f in made.content["plant"]["f"]]
    tenth = Fraction(0.1)  # the floats in f are what they are, and their products are not rounded
    assert terms[0][2, 0, 1] == -3 * tenth / 4 and terms[1][1, 0, 1] == tenth
    assert terms[1][0, 0, 0] == -tenth * Fraction(0.2)
    assert terms[0][1, 0, 0] == Fraction(1, 2) and isinstance(made.content["plant"]["f"][1][0]["coefficient"], float)
    thirds, _ = in_plane(lambda x, u: [0.5 * x[0] / 3, 0.5 * x[1] + 0 * x[0]])
    assert thirds.content["plant"]["f"][0] == [{"coefficient": "1/6", "powers": [1, 0, 0]}]


def test_f_may_be_constant():
    made, _ = in_plane(lambda x, u: [0.5 * x[0], 0.25])
    assert value_of(made.content, (0.0, 0.0, 0.0)) == [0, 0.25] and made.report["error_set"].verdict == "refuted"
    claim = made.content["claims"]["error_set"]
    assert claim["verdict"] == "not proven" and abs(
        Fraction(claim["witness"]["state"][1]) / 2 - Fraction(1, 4)
    ) > Fraction(2, 5)


@pytest.mark.parametrize(
    "f",
    [
        lambda x, u: [np.sin(x[0]), x[1]],
        lambda x, u: [x[0] ** 0.5, x[1]],
        lambda x, u: [x[0] ** -1, x[1]],
        lambda x, u: [x[0] / x[1], x[1]],
        lambda x, u: [1 / x[0], x[1]],
        lambda x, u: [abs(x[0]), x[1]],
        lambda x, u: [2.0 ** x[0], x[1]],
    ],
    ids=["sin", "root", "1/x", "x/y", "reciprocal", "abs", "2^x"],
)
def test_what_is_no_polynomial_is_named(f):
    with pytest.raises(ValueError, match="polynomial"):
        in_plane(f)


def test_a_plant_with_narrower_limits_says_nothing_about_the_loop():
    loop = affine_loop(0.5 * np.eye(2))
    plant = mr.NonlinearSystem(lambda x, u: [x[0] * 0.5, x[1] * 0.5], square(0.5), loop.system.input_set)
    with pytest.raises(ValueError, match="limits"):
        certificate.make(loop, mr.safe_set(loop), plant=plant)


# -- arguments ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("x", "verdict"),
    [(["1", "-1"], "refuted"), (["1/3", "-1/3"], "refuted"), (["0", "0"], "not checked"), (["2", "0"], "not checked")],
)
def test_a_state_in_the_file_refutes_inputs_by_cases_if_it_does(x, verdict):
    U = mr.Polytope.box([-2], [2])
    mode = mr.Mode(0.3 * np.eye(2), [[0.1], [0.1]], [0, 0], square(1).product(U), square(0.01))
    hidden = mr.Layer([[1.0, -1.0], [0.0, 0.0]], [0.1, 0.0], 2)
    loop = mr.ClosedLoop(mr.PWASystem([mode], square(1), U), mr.MaxoutNetwork([hidden], [[0.7]], [0.0]))
    made = certificate.make(loop, mr.safe_set(loop), proof="cases")
    assert made.report["inputs"].verdict == "proven"  # u = 0.7 max(x1 - x2 + 0.1, 0) lies between 0 and 1.47
    made.content["system"]["input_set"]["h"] = [0.5, 0.5]
    made.content["claims"]["inputs"] = {"verdict": "not proven", "witness": {"state": x}}
    found = checker.check(checker.parse(json.dumps(made.content)))["inputs"]
    assert found.verdict == verdict and found.witness == ({"state": x} if verdict == "refuted" else None)


def test_arguments_are_checked():
    loop = affine_loop(0.5 * np.eye(2))
    safe = mr.safe_set(loop)
    for arguments in ((None, safe), (loop, safe.set), (loop, safe, safe)):
        with pytest.raises((TypeError, ValueError)):
            certificate.make(*arguments)
    with pytest.raises((TypeError, ValueError)):
        certificate.make(loop, safe, plant=lambda x, u: x)
    terminal = mr.terminal_set(loop, safe, max_steps=1)
    with pytest.raises(ValueError, match="no steps"):
        certificate.make(loop, safe, replace(terminal, history=[safe.set]))
    other = mr.safe_set(affine_loop(0.4 * np.eye(2)))
    with pytest.raises(ValueError, match="does not start from"):
        certificate.make(loop, safe, mr.terminal_set(loop, other))
    none = mr.safe_set(affine_loop(2.0 * np.eye(2), square(0.5)))
    assert none.set is None
    with pytest.raises(ValueError, match="no safe set"):
        certificate.make(loop, none)
    with pytest.raises(ValueError, match='proof must be "cells", "cases" or None'):
        certificate.make(loop, safe, proof="case")


@pytest.mark.parametrize("seed", range(6))
def test_random_certificates_are_confirmed(seed):
    text = random_certificate(seed)
    report = checker.check(checker.parse(text), ignore_digest=False)
    assert report.digest == "as written" and not false_claims(text, report)
    assert {"inputs", "safe_set"} <= {result.claim for result in report.results if result.verdict == "proven"}
