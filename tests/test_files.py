"""Files are written whole or not at all, and corrupt ones are named."""

import os
import shutil
import subprocess
import sys
from functools import partial

import numpy as np
import pytest

from mireach import MaxoutNetwork, case_studies
from mireach.errors import CorruptFileError, MireachError
from mireach.files import PART, read_json, write_json, write_whole
from mireach.learning.datasets import DataSet
from mireach.studies import seed_study as seeds
from mireach.studies.case_studies import NAMES, PAPER_NAMES, data_file, load_sets
from mireach.studies.seed_study import load_networks, load_rows


def test_text_and_bytes_are_written_in_new_folders(tmp_path):
    path = tmp_path / "new" / "folder" / "file.txt"
    write_whole(path, "é\n")
    assert path.read_bytes() == "é\n".encode()
    write_whole(path, b"\x00\x01")
    assert path.read_bytes() == b"\x00\x01" and os.listdir(path.parent) == ["file.txt"]


def test_failing_write_keeps_the_old_file_and_leaves_nothing_behind(tmp_path, monkeypatch):
    path = tmp_path / "set.json"
    write_json(path, {"format": "a"})

    def broken(*_):
        raise OSError("disk full")

    monkeypatch.setattr(os, "replace", broken)
    with pytest.raises(OSError, match="disk full"):
        write_json(path, {"format": "b"})
    assert read_json(path, "a") == {"format": "a"} and os.listdir(tmp_path) == ["set.json"]


@pytest.mark.parametrize("number", [float("nan"), float("inf")])
def test_nan_and_infinity_are_refused_before_anything_is_written(tmp_path, number):
    with pytest.raises(ValueError):
        write_json(tmp_path / "bad.json", {"x": number})
    assert os.listdir(tmp_path) == []


def test_numbers_read_back_to_the_same_floats(tmp_path):
    numbers = [0.1, 1 / 3, 5e-324, 1.7976931348623157e308, -0.0]
    write_json(tmp_path / "n.json", {"format": "f", "numbers": numbers})
    assert [x.hex() for x in read_json(tmp_path / "n.json", "f")["numbers"]] == [x.hex() for x in numbers]


@pytest.mark.parametrize(
    ("content", "word"),
    [
        (b'{"format": "f", "x": [1, 2', "not valid JSON"),
        (b"", "not valid JSON"),
        (b"\xff\xfe\x00", "not valid JSON"),
        (b'{"format": "other/2"}', "other/2"),
        (b"[1, 2]", "None"),
        (b'{"x": 1}', "None"),
    ],
)
def test_corrupt_file_is_named(tmp_path, content, word):
    path = tmp_path / "net.json"
    path.write_bytes(content)
    with pytest.raises(CorruptFileError) as error:
        read_json(path, "f")
    assert str(path) in str(error.value) and word in str(error.value)
    assert isinstance(error.value, MireachError) and isinstance(error.value, ValueError)


def test_missing_file_says_so(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_json(tmp_path / "none.json", "f")


def test_deeply_nested_json_is_corrupt_and_no_recursion_error(tmp_path):
    path = tmp_path / "network.json"
    for text in (
        "[" * 200_000,
        "[" * 200_000 + "]" * 200_000,
        '{"format": "mireach-network/1", "hidden": ' + "[" * 10**5,
    ):
        path.write_text(text)
        with pytest.raises(CorruptFileError, match=r"network\.json"):
            MaxoutNetwork.load(path)
    path.write_text('{"format": "mireach-network/1", "output": 1, "hidden": ' + "[" * 900 + "]" * 900 + "}")
    with pytest.raises(CorruptFileError, match=r"network\.json"):
        MaxoutNetwork.load(path)


# -- every shipped file, cut --------------------------------------------------------------------------

READERS = {
    "network.json": lambda name, path: MaxoutNetwork.load(path),
    "samples.csv": lambda name, path: DataSet.load(path),
    "seeds.csv": lambda name, path: load_rows(path),
    "seed_networks.jsonl": lambda name, path: load_networks(name),
    "certificate.json": lambda name, path: load_sets(name),
}
SHIPPED = [(name, file) for name in NAMES for file in READERS if not file.startswith("seed") or name in PAPER_NAMES]


@pytest.mark.parametrize(("name", "file"), SHIPPED)
def test_a_shipped_file_is_refused_wherever_it_is_cut(tmp_path, monkeypatch, name, file):
    path = tmp_path / file
    shutil.copy(data_file(name, file), path)
    for module in (case_studies, seeds):
        monkeypatch.setattr(module, "data_file", lambda name, file: tmp_path / file)
    content, read = path.read_bytes(), partial(READERS[file], name, path)
    read()
    ends = np.flatnonzero(np.frombuffer(content, np.uint8) == ord("\n"))[:-1] + 1
    some = ends[np.unique(np.linspace(0, len(ends) - 1, 8).astype(int))] if len(ends) else ends
    anywhere = np.random.default_rng(0).integers(0, len(content) - 1, 8)
    for cut in sorted({0, 1, *some, *(some - 1), *(some + 1), *anywhere, len(content) - 2}):
        path.write_bytes(content[:cut])
        with pytest.raises(CorruptFileError) as error:
            read()
        assert file in str(error.value), cut


# -- writers that fail or are killed ------------------------------------------------------------------


def test_an_error_names_the_file(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match=r"cannot write .*file/below\.json"):
        write_json(tmp_path / "file" / "below.json", {})


def test_a_file_too_large_for_the_disk_is_named_and_leaves_nothing(tmp_path):
    resource = pytest.importorskip("resource")  # a limit of the size of files stands for a full disk
    script = f"""
import resource, signal
from matplotlib.figure import Figure
from mireach.plotting import save_figure
figure = Figure()
figure.add_subplot().plot([0, 1])
for form in ("svg", "png"):
    save_figure(figure, "{tmp_path}/figure." + form)
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (2000, {resource.RLIM_INFINITY}))
figure.add_subplot().plot([1, 2])
for form in ("svg", "png"):
    try:
        save_figure(figure, "{tmp_path}/figure." + form)
    except OSError as error:
        print(error)
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert [f"figure.{form}" in line for form, line in zip(("svg", "png"), done.stdout.splitlines())] == [True, True]
    assert sorted(os.listdir(tmp_path)) == ["figure.png", "figure.svg"]
    assert (tmp_path / "figure.svg").read_text().rstrip().endswith("</svg>")
    assert (tmp_path / "figure.png").read_bytes().endswith(b"IEND\xaeB`\x82")


def test_two_writers_at_once_and_a_killed_one_leave_whole_files(tmp_path):
    path = tmp_path / "figure.svg"
    script = f"""
import sys
from mireach.files import write_whole
while True:
    write_whole({str(path)!r}, sys.argv[1] * 2_000_000)
"""
    writers = [subprocess.Popen([sys.executable, "-c", script, letter]) for letter in "ab"]
    try:
        seen = set()
        while len(seen) < 2 and all(writer.poll() is None for writer in writers):
            if path.exists():
                text = path.read_text()
                assert len(text) == 2_000_000 and len(set(text)) == 1
                seen.add(text[0])
    finally:
        for writer in writers:
            writer.kill()
            writer.wait()
    text = path.read_text()
    assert seen == {"a", "b"} and len(text) == 2_000_000 and len(set(text)) == 1
    assert all(name == path.name or name.endswith(PART) for name in os.listdir(tmp_path))
