"""The seed study: rows, choice, files, and a run on a Dask cluster."""

import json
import math
import os
import shutil
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from mireach import MaxoutNetwork, MireachError
from mireach.analysis.maximal_set import maximal_safe_set
from mireach.errors import CorruptFileError
from mireach.learning.datasets import make_four_tanks_data
from mireach.studies import seed_study as seeds
from mireach.studies.case_studies import CASES, PAPER_NAMES, case_study, data_file
from mireach.studies.seed_study import (
    SeedRow,
    analyse_seed,
    choose,
    load_networks,
    load_rows,
    load_study,
    run_seed,
    save_networks,
    save_rows,
    study,
)

ROW = SeedRow(0, 0.01, 100, "proven", 1, -7.3, 9.0, -10.0, 8.52, 50, True, 1.1)


def same(row, other):
    return all(a == b or (a != a and b != b) for a, b in zip(vars(row).values(), vars(other).values()))


def test_rows_read_back_to_the_same_numbers(tmp_path):
    rows = [ROW, replace(ROW, seed=1, loss=0.1 + 0.2, verdict="refuted", x1_max=math.nan, criterion=False)]
    save_rows(tmp_path / "seeds.csv", rows)
    assert all(map(same, load_rows(tmp_path / "seeds.csv"), rows))


def test_a_truncated_study_is_refused(tmp_path):
    file = tmp_path / "seeds.csv"
    save_rows(file, [ROW, replace(ROW, seed=1)])
    text = file.read_text()
    at_the_end_of_a_line = "".join(text.splitlines(keepends=True)[:-2])
    for part in (text[:-4], text[:-40], at_the_end_of_a_line):
        file.write_text(part)
        with pytest.raises(CorruptFileError, match="seed study"):
            load_rows(file)


@pytest.fixture
def shipped_copy(tmp_path, monkeypatch):
    """The files of case pwa in a folder of their own, from which the package reads."""
    for file in ("seeds.csv", "seed_networks.jsonl"):
        shutil.copy(data_file("pwa", file), tmp_path / file)
    monkeypatch.setattr(seeds, "data_file", lambda name, file: tmp_path / file)
    return tmp_path


def test_networks_cut_at_any_line_or_byte_are_refused(shipped_copy):
    file = shipped_copy / "seed_networks.jsonl"
    networks = load_networks("pwa")
    save_networks(file, {seed: networks[seed] for seed in (3, 4, 5)})
    lines = file.read_bytes().splitlines(keepends=True)
    assert set(load_networks("pwa")) == {3, 4, 5} and json.loads(lines[-1]) == {"end": 3}
    content = b"".join(lines)
    ends = np.cumsum([len(line) for line in lines[:-1]])
    for cut in {*range(0, len(content) - 1, 211), *ends, *(ends - 1), *(ends + 1), len(content) - 2}:
        file.write_bytes(content[:cut])
        with pytest.raises(CorruptFileError, match="restore it"):
            load_networks("pwa")
    for damaged in (lines[:1] + lines[2:], [*lines[:2], lines[1], lines[3]], [*lines, lines[0]]):
        file.write_bytes(b"".join(damaged))  # a line is missing, or there twice, or after the end
        with pytest.raises(CorruptFileError):
            load_networks("pwa")


def test_rows_and_networks_of_different_studies_are_refused(shipped_copy):
    rows, networks = load_study("pwa")
    save_networks(shipped_copy / "seed_networks.jsonl", {row.seed: networks[row.seed] for row in rows[:-1]})
    with pytest.raises(CorruptFileError, match="restore both files"):
        load_study("pwa")
    with pytest.raises(CorruptFileError, match="restore both files"):
        seeds.reanalyse("pwa", jobs=1, folder=shipped_copy, progress=False)


def test_two_processes_give_what_one_gives(tmp_path):
    pytest.importorskip("joblib")
    rows, networks = study("pwa", [4, 3], jobs=2, progress=False, keep=tmp_path, steps=5)
    here, own = study("pwa", [3, 4], jobs=1, progress=False, steps=5)
    timeless = {"train_seconds": 0.0, "analysis_seconds": 0.0, "maximal_seconds": 0.0}
    assert all(same(replace(one, **timeless), replace(two, **timeless)) for one, two in zip(rows, here, strict=True))
    assert all(networks[seed].to_dict() == own[seed].to_dict() for seed in (3, 4))
    assert sorted(os.listdir(tmp_path)) == ["3.json", "4.json"]


def test_an_interrupted_study_is_resumed_and_gives_what_it_would_have_given(tmp_path, monkeypatch):
    trained = []

    def stops_at_two(name, seed, **training):
        trained.append(seed)
        if seed == 2:
            raise KeyboardInterrupt
        return run_seed(name, seed, **training)

    whole, networks = study("pwa", range(4), jobs=1, progress=False, steps=5)
    monkeypatch.setattr(seeds, "run_seed", stops_at_two)
    again = partial(study, "pwa", range(4), jobs=1, progress=False, keep=tmp_path, steps=5)
    with pytest.raises(KeyboardInterrupt):
        again()
    assert trained == [0, 1, 2] and sorted(os.listdir(tmp_path)) == ["0.json", "1.json"]
    content = (tmp_path / "1.json").read_bytes()
    (tmp_path / "1.json").write_bytes(content[: len(content) // 2])  # such a file is no finished seed
    monkeypatch.setattr(
        seeds, "run_seed", lambda name, seed, **rest: (trained.append(seed), run_seed(name, seed, **rest))[1]
    )
    rows, kept = again()
    assert trained == [0, 1, 2, 1, 2, 3]
    timeless = {"train_seconds": 0.0, "analysis_seconds": 0.0, "maximal_seconds": 0.0}
    assert all(
        same(replace(one, **timeless), replace(other, **timeless)) for one, other in zip(rows, whole, strict=True)
    )
    assert all(kept[seed].to_dict() == networks[seed].to_dict() for seed in networks)
    again()
    assert len(trained) == 6
    study("pwa", [0], jobs=1, progress=False, keep=tmp_path, steps=6)  # other options: nothing is kept
    assert trained[6:] == [0]


def test_a_change_of_any_module_makes_another_origin(tmp_path, monkeypatch):
    package = tmp_path / "mireach"
    shutil.copytree(seeds.PACKAGE, package, ignore=shutil.ignore_patterns("data", "static", "__pycache__"))
    assert (package / "engines" / "milp" / "engine.py").is_file() and (package / "studies" / "seed_study.py").is_file()
    origin = seeds._origin("pwa", {})
    monkeypatch.setattr(seeds, "PACKAGE", package)
    assert seeds._origin("pwa", {}) == origin != seeds._origin("pwa", {"steps": 5})
    for module in ("__main__.py", "engines/cells.py", "engines/milp/engine.py", "learning/mpc/nonlinear.py"):
        content = (package / module).read_bytes()
        (package / module).write_bytes(content + b"# changed\n")
        assert seeds._origin("pwa", {}) != origin
        (package / module).write_bytes(content)
    assert seeds._origin("pwa", {}) == origin


def test_a_finished_study_leaves_no_kept_seeds(tmp_path, monkeypatch):
    row, network = load_rows(data_file("pwa", "seeds.csv"))[72], load_networks("pwa")[72]
    monkeypatch.setattr(seeds, "run_seed", lambda name, seed, **training: (replace(row, seed=seed), network))
    seeds.make_study("pwa", count=2, jobs=1, folder=tmp_path, progress=False)
    assert sorted(os.listdir(tmp_path)) == ["network.json", "seed_networks.jsonl", "seeds.csv"]


def test_choice_prefers_the_paper_s_figures_among_good_losses():
    near = replace(ROW, seed=1, loss=0.019, steps=51, x1_max=8.91)
    too_lossy = replace(near, seed=2, loss=0.021)
    no_criterion = replace(near, seed=3, criterion=False)
    assert choose("pwa", [ROW, near, too_lossy, no_criterion]).seed == 1
    with pytest.raises(MireachError, match="train more"):
        choose("pwa", [no_criterion])


@pytest.mark.parametrize("name", PAPER_NAMES)
def test_shipped_study_holds_fifty_seeds_and_the_shipped_network_is_the_chosen_one(name):
    rows, networks = load_rows(data_file(name, "seeds.csv")), load_networks(name)
    assert len(rows) >= 50 and set(networks) == {row.seed for row in rows}
    chosen = choose(name, rows)
    shipped = MaxoutNetwork.load(data_file(name, "network.json"))
    assert shipped.to_dict() == networks[chosen.seed].to_dict()
    again = analyse_seed(name, chosen.seed, shipped, chosen.loss)
    assert (again.cells, again.iterations, again.steps, again.criterion) == (
        chosen.cells,
        chosen.iterations,
        chosen.steps,
        chosen.criterion,
    )


@pytest.mark.parametrize("name", PAPER_NAMES)
def test_shipped_study_holds_the_maximal_safe_sets(name):
    rows = load_rows(data_file(name, "seeds.csv"))
    for row in rows:
        assert row.maximal_verdict in ("proven", "refuted", "unknown")
        assert (row.maximal_area > 0) == (row.maximal_verdict == "proven")
        assert (row.safe_area > 0) == (row.verdict == "proven")
        if row.safe_area and row.maximal_area:  # F_max is RPI, so the maximal set holds it
            assert row.area_ratio == row.maximal_area / row.safe_area >= 1
    chosen = choose(name, rows)
    case = case_study(name)
    again = maximal_safe_set(case.loop, prove=False)
    assert again.set.area == pytest.approx(chosen.maximal_area) and again.iterations == chosen.maximal_iterations


def test_analysing_a_study_again_changes_no_other_column(tmp_path, monkeypatch):
    row, network = load_rows(data_file("pwa", "seeds.csv"))[72], load_networks("pwa")[72]
    stale = replace(row, safe_area=0.0, maximal_verdict="", maximal_area=0.0, area_ratio=math.nan)
    monkeypatch.setattr(seeds, "load_study", lambda name: ([stale], {72: network}))
    said = seeds.reanalyse("pwa", jobs=1, folder=tmp_path, progress=False)
    (found,) = load_rows(tmp_path / "seeds.csv")
    assert found.maximal_area == pytest.approx(row.maximal_area) and found.area_ratio == pytest.approx(row.area_ratio)
    assert found.safe_area == pytest.approx(row.safe_area)
    new = {"safe_area": 0.0, "maximal_area": 0.0, "area_ratio": 0.0, "maximal_seconds": 0.0}
    assert same(replace(found, **new), replace(row, **new)) and "1 of 1" in said


def test_a_study_from_before_the_last_columns_can_be_read(tmp_path):
    file = tmp_path / "seeds.csv"
    save_rows(file, [ROW])
    names, values, end = file.read_text().splitlines()
    old = [",".join(line.split(",")[:-6]) for line in (names, values)]
    file.write_text("\n".join([*old, end]) + "\n")
    assert same(load_rows(file)[0], ROW)


def test_study_runs_on_a_dask_cluster_and_gives_what_this_machine_gives():
    distributed = pytest.importorskip("dask.distributed")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        rows, networks = study("pwa", [3, 4], scheduler=cluster.scheduler_address, progress=False, steps=20)
    here, own = study("pwa", [3, 4], jobs=1, progress=False, steps=20)
    assert [row.seed for row in rows] == [3, 4]
    x = np.random.default_rng(0).uniform(-10, 10, (100, 2))
    for seed in (3, 4):
        np.testing.assert_array_equal(networks[seed](x), own[seed](x))
    assert [row.loss for row in rows] == [row.loss for row in here]


def test_a_study_of_no_seeds_writes_nothing(tmp_path):
    with pytest.raises(ValueError, match="count must be a whole number"):
        seeds.make_study("pwa", count=0, folder=tmp_path)
    assert not list(tmp_path.iterdir())


def test_cases_that_are_not_the_paper_s_have_no_study(tmp_path):
    with pytest.raises(ValueError, match=r"choose one of pwa, double_integrator$"):
        choose("four_tanks", [ROW])
    with pytest.raises(ValueError, match=r"choose one of pwa, double_integrator$"):
        seeds.make_study("three_tanks", folder=tmp_path)
    assert not list(tmp_path.iterdir())


def test_training_a_case_without_a_study_writes_its_certificate(tmp_path, monkeypatch):
    shipped = case_study("four_tanks").network
    small = replace(CASES["four_tanks"], make_data=partial(make_four_tanks_data, count=20))
    monkeypatch.setitem(CASES, "four_tanks", small)
    monkeypatch.setattr(seeds, "train_case", lambda *_, **__: (shipped, 0.0))
    monkeypatch.setattr(seeds, "terminal_set", partial(seeds.terminal_set, max_steps=1))
    said = seeds.retrain("four_tanks", folder=tmp_path, progress=False)
    assert "F_max after 7 iterations; max_steps = 1 came first" in said
    assert {file.name for file in tmp_path.iterdir()} == {"samples.csv", "network.json", "certificate.json"}


def test_a_file_without_columns_is_no_study(tmp_path):
    (tmp_path / "seeds.csv").write_text("")
    with pytest.raises(CorruptFileError):
        seeds.load_rows(tmp_path / "seeds.csv")
