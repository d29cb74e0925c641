"""Files are written whole or not at all, and corrupt ones are named."""

import os

import pytest

from mireach.errors import CorruptFileError, MireachError
from mireach.files import read_json, write_json, write_whole


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
