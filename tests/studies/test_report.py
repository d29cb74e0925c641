"""`reproduce`: report.json as fixed, every row of the table, the figures."""

import json
from fractions import Fraction
from itertools import pairwise

import pytest

import mireach as mr
from mireach.__main__ import main
from mireach.studies.case_studies import PAPER_NAMES, REPORTED, data_file


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("reproduce")
    places = [part for name in ("results", "figures", "certificates") for part in (f"--{name}", str(folder))]
    arguments = ["reproduce", "--quiet", "--no-cross-check", *places]
    assert main(arguments) == 0
    return folder


@pytest.fixture(scope="module")
def report(folder):
    return json.loads((folder / "report.json").read_text())


@pytest.mark.parametrize("name", REPORTED)
def test_report_holds_the_fixed_keys(report, name):
    assert report["format"] == "mireach-report/1"
    case = report["cases"][name]
    assert case["network"] == f"data/{name}/network.json"
    for key in ("disturbance_bound", "alpha", "delta_max", "stable", "cross_check", "seconds"):
        assert key in case
    assert {"H", "h", "iterations", "verdict"} <= set(case["safe_set"])
    assert {"H", "h", "steps", "epsilon", "centre", "criterion"} <= set(case["terminal_set"])
    assert {"simulated", "inside_safe_set", "entered_terminal_set"} <= set(case["trajectories"])
    assert case["paper"] == json.loads(json.dumps(mr.case_study(name).paper))


@pytest.mark.parametrize("name", REPORTED)
def test_reported_sequence_runs_from_the_safe_set_to_the_terminal_set(report, name):
    case = report["cases"][name]
    sets = [mr.Polytope.from_dict(part) for part in case["reach_sequence"]]
    assert len(sets) == case["terminal_set"]["steps"] + 1
    assert case["reach_sequence"][0]["h"] == case["safe_set"]["h"]
    assert case["reach_sequence"][-1]["h"] == case["terminal_set"]["h"]
    assert all(after.is_subset(before) for before, after in pairwise(sets))
    loop = mr.case_study(name).loop
    assert mr.check_rpi(loop, mr.Polytope.from_dict(case["safe_set"])).verdict == "proven"
    assert mr.check_rpi(loop, mr.Polytope.from_dict(case["terminal_set"])).verdict == "proven"


@pytest.mark.parametrize("name", PAPER_NAMES)
def test_all_trajectories_stay_and_enter(report, name):
    counts = report["cases"][name]["trajectories"]
    assert counts["simulated"] == counts["inside_safe_set"] == counts["entered_terminal_set"] == 200


@pytest.mark.parametrize("name", PAPER_NAMES)
def test_reported_maximal_set_is_proven_and_holds_the_safe_set(report, name):
    case = report["cases"][name]
    maximal = mr.Region.from_dict(case["maximal_safe_set"])
    assert case["maximal_safe_set"]["verdict"] == "proven"
    assert maximal.area == pytest.approx(case["maximal_safe_set"]["area"])
    assert case["maximal_safe_set"]["outer_area"] - maximal.area < 1e-6 * maximal.area
    assert mr.Region.of(mr.Polytope.from_dict(case["safe_set"])).is_subset(maximal, tol=1e-7)


@pytest.mark.parametrize("name", PAPER_NAMES)
def test_every_set_is_proven_exactly_and_the_certificate_written_is_the_one_shipped(report, folder, name):
    case = report["cases"][name]
    assert len(case["proven_exactly"]) == 7 and all(case["proven_exactly"].values())
    assert {claim["verdict"] for claim in case["claims"].values()} == {"proven"}
    assert Fraction(case["exact_alpha"]) > 1 and float(Fraction(case["exact_alpha"])) == pytest.approx(case["alpha"])
    written = folder / name / "certificate.json"
    assert mr.certificate.verify(written, network=data_file(name, "network.json")).proven
    claims, shipped = (
        json.loads(path.read_text())["claims"] for path in (written, data_file(name, "certificate.json"))
    )
    assert claims.keys() == shipped.keys()


@pytest.mark.parametrize("name", sorted({*REPORTED} - {*PAPER_NAMES}))
def test_every_set_of_the_tanks_is_proven_exactly(report, name):
    case, loop = report["cases"][name], mr.case_study(name).loop
    assert len(case["proven_exactly"]) == 6 and all(case["proven_exactly"].values())
    assert case["maximal_safe_set"] is None and case["paper"] == {}
    assert {claim["verdict"] for claim in case["claims"].values()} == {"proven"} and len(case["claims"]) == 6
    counts = case["trajectories"]
    assert counts["simulated"] == counts["inside_safe_set"] == counts["entered_terminal_set"] == 198
    directions = case["exact_supports"]["directions"]
    for part in ("safe_set", "terminal_set"):
        exact = [Fraction(value) for value in case["exact_supports"][part]]
        F = mr.Polytope.from_dict(case[part])
        rows = dict(zip(map(tuple, F.H.tolist()), F.h.tolist()))
        assert all(value <= rows[tuple(v)] for v, value in zip(directions, exact))
        for engine, close in (("cells", 1e-9), ("milp", 1e-6)):
            bounds = mr.support(loop, F, directions, engine=engine).bound.tolist()
            assert all(0 <= Fraction(bound) - value <= close for bound, value in zip(bounds, exact))


def test_table_has_a_row_for_every_number_of_the_paper(folder):
    text = (folder / "report.md").read_text()
    for item in (
        "iterations to F_max",
        "k-bar (about the origin)",
        "alpha at k-bar",
        "delta_max",
        "[-7.30, 8.91] x [-10.00, 8.52]",
        "| 51 |",
        "| 19 |",
        "| 20 |",
        "0.1186",
        "1 + 9e-07",
        "Theorem 2",
        "area of the maximal safe set",
        "Theorem 1, decided by a fraction",
        "terminal set: proven exactly",
    ):
        assert item in text


def test_figures_are_drawn_as_svg_and_png(folder):
    for name in ("figure1", "figure2", "figure3", "maximal_set", "three_tanks", "four_tanks", "seed_areas"):
        assert (folder / f"{name}.svg").stat().st_size > 10_000
        assert (folder / f"{name}.png").read_bytes().startswith(b"\x89PNG")


def test_a_case_without_a_safe_set_is_reported_with_its_reason():
    from mireach.studies.case_analysis import analyse

    case = mr.case_study("pwa")
    wide = mr.case_study("pwa").system.with_disturbance(mr.Polytope.box([-5, -5], [5, 5]))
    object.__setattr__(case, "loop", mr.ClosedLoop(wide, case.network))
    with pytest.raises(ValueError, match="no safe set"):
        analyse(case, cross_check=None)
