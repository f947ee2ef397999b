"""Files are either complete or absent, and what is read back is what was written."""

from __future__ import annotations

import hashlib
import json
import math
import os
import pickle
from pathlib import Path

import pytest

import fraclink as fl
from fraclink.errors import (
    FieldError,
    FileFormatError,
    LogError,
    SizeError,
)
from fraclink.findings import Finding

NOTE = Finding("W101", "info", "a note", {"stiffness": 1.56})


def test_a_failure_leaves_the_old_file_and_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = tmp_path / "x.json"
    place.write_text("old")

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        fl.save(NOTE, place, force=True)
    with pytest.raises(OSError, match="No space"):
        fl.save(NOTE, tmp_path / "y.json")
    assert place.read_text() == "old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["x.json"]


def test_numbers_round_trip_exactly(tmp_path: Path) -> None:
    numbers = [0.1, 1e-308, 1.7976931348623157e308, -0.0, math.pi, 2.0**53 + 2, 5e-324]
    evidence = {f"x{k}": number for k, number in enumerate(numbers)}
    place = fl.save(Finding("W101", "info", "a note", evidence), tmp_path / "x.json")
    back = fl.load(place, Finding).evidence
    assert [value.hex() for value in back.values()] == [x.hex() for x in numbers]
    assert json.loads(place.read_text())["units"] == "SI, radians"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "not valid JSON"),
        ("{", "not valid JSON"),
        ("[1]", "not written by fraclink"),
        ('{"fraclink": "other", "format": 1}', "of kind 'other'"),
        ('{"fraclink": "finding", "format": 9}', "does not read"),
        ('{"fraclink": "finding", "format": true}', "does not read"),
        ('{"fraclink": "finding", "format": 1, "a": NaN}', "not a finite number"),
        ('{"fraclink": "finding", "format": 1, "a": 1e999}', "not a finite number"),
        (
            '{"fraclink": "finding", "format": 1, "a": ' + "9" * 5000 + "}",
            "Exceeds the limit",
        ),
        ('{"fraclink": "finding", "format": 1, "a": 1, "a": 2}', "given twice"),
        ("[" * 100_000, "nested too deeply"),
        (
            "\ud800".encode("utf-16", "surrogatepass").decode("latin-1"),
            "not valid JSON",
        ),
    ],
)
def test_foreign_and_hostile_files_are_named(
    tmp_path: Path, text: str, words: str
) -> None:
    place = tmp_path / "x.json"
    place.write_text(text, "utf-8")
    with pytest.raises(FieldError, match=words):
        fl.load(place, Finding)


def test_a_missing_file_and_a_file_of_another_encoding(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="not there"):
        fl.load(tmp_path / "none")
    (tmp_path / "x").write_bytes(b"\xff\xfe{}")
    with pytest.raises(FileFormatError, match="not UTF-8"):
        fl.load(tmp_path / "x")


def test_what_is_there_needs_force(tmp_path: Path) -> None:
    place = tmp_path / "x.json"
    place.write_text("mine")
    with pytest.raises(FieldError, match="already there"):
        fl.save(NOTE, place)
    assert place.read_text() == "mine"
    assert fl.load(fl.save(NOTE, place, force=True)) == NOTE


def test_a_place_where_no_file_can_be_made_is_told_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "text").write_text("mine")
    for place in (tmp_path / "text" / "x.json", tmp_path / "text" / "new" / "x.json"):
        with pytest.raises(
            FieldError, match="below text, which is not a folder"
        ) as told:
            fl.save(NOTE, place, force=True)
        assert (told.value.field, told.value.value) == ("out", str(place))
        assert told.value.remedy == "choose another folder"
    with pytest.raises(FieldError, match="a folder"):
        fl.save(NOTE, tmp_path, force=True)
    with pytest.raises(FieldError, match="already there"):
        fl.save(NOTE, "/")
    assert fl.save(NOTE, tmp_path / "new" / "newer" / "x.json").is_file()
    # root may write anywhere
    monkeypatch.setattr(os, "access", lambda place, _: place != tmp_path)
    with pytest.raises(FieldError, match=r"not writable \(no permission in "):
        fl.save(NOTE, tmp_path / "newest" / "x.json")


def test_an_error_of_the_system_names_the_file_that_was_asked_for() -> None:
    """And not the temporary file, whose name is unknown to the user and which no longer
    exists.
    """
    missing = Path("/proc/fraclink-test")
    if not Path("/proc/self").exists():
        pytest.skip("this system has no /proc, where no file can be made")
    with pytest.raises((OSError, FieldError), match="fraclink-test") as told:
        fl.save(NOTE, missing)
    if isinstance(told.value, OSError):
        assert told.value.filename == str(missing)


def test_the_hash_of_a_log_is_that_of_its_bytes(tmp_path: Path) -> None:
    raw = fl.bundled_log("prbs_30g").read_bytes()
    (tmp_path / "log.csv").write_bytes(raw)
    log = fl.read_log(tmp_path / "log.csv")
    assert log.sha256 == hashlib.sha256(raw).hexdigest()


@pytest.mark.parametrize("kind", [FieldError, LogError, FileFormatError, SizeError])
def test_an_error_crosses_a_process_border_with_its_parts(
    kind: type[FieldError],
) -> None:
    error = kind("payload", -1, "negative", allowed="> 0 kg", remedy="give kg")
    # What a process pool does with an error; the package itself never unpickles such
    # bytes.
    back = pickle.loads(pickle.dumps(error))  # noqa: S301
    assert type(back) is kind
    assert (back.field, back.value, back.problem) == ("payload", -1, "negative")
    assert (back.allowed, back.remedy, str(back)) == ("> 0 kg", "give kg", str(error))
