"""Files are complete or not there, and what is read back is what was written."""

from __future__ import annotations

import math
import os
import pickle
from pathlib import Path

import pytest

from fraclink._files import (
    atomic_write,
    output_path,
    read_json,
    sha256_of,
    write_json,
    write_text,
)
from fraclink.errors import (
    FieldError,
    FileFormatError,
    LogError,
    SizeError,
    UnstableError,
)


def test_a_failure_leaves_the_old_file_and_no_other(tmp_path: Path) -> None:
    place = tmp_path / "x.json"
    write_text(place, "old")

    class Full(OSError):
        pass

    with pytest.raises(Full), atomic_write(place) as stream:
        stream.write("half")
        raise Full
    assert place.read_text() == "old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["x.json"]


def test_a_full_disk_is_an_error_and_leaves_nothing(tmp_path: Path) -> None:
    full = Path("/dev/full")
    if not full.exists():
        pytest.skip("this system has no /dev/full")
    with pytest.raises(OSError, match=r"[Nn]o space"), full.open("w") as stream:
        stream.write("x" * 100_000)
    # The same errno from within: nothing with the wanted name appears.
    with pytest.raises(OSError, match="No space"), atomic_write(tmp_path / "y"):
        raise OSError(28, "No space left on device")
    assert list(tmp_path.iterdir()) == []


def test_numbers_round_trip_exactly(tmp_path: Path) -> None:
    numbers = [0.1, 1e-308, 1.7976931348623157e308, -0.0, math.pi, 2**53 + 1]
    write_json(tmp_path / "x", "thing", 1, {"numbers": numbers})
    back = read_json(tmp_path / "x", "thing")
    assert back["numbers"] == numbers
    assert back["units"] == "SI, radians"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "not valid JSON"),
        ("{", "not valid JSON"),
        ("[1]", "not written by fraclink"),
        ('{"fraclink": "other", "format": 1}', "kind 'thing'"),
        ('{"fraclink": "thing", "format": 9}', "does not read"),
        ('{"fraclink": "thing", "format": 1, "a": NaN}', "not a finite number"),
        ('{"fraclink": "thing", "format": 1, "a": 1e999}', "not a finite number"),
        (
            '{"fraclink": "thing", "format": 1, "a": ' + "9" * 5000 + "}",
            "Exceeds the limit",
        ),
        ('{"fraclink": "thing", "format": 1, "a": 1, "a": 2}', "given twice"),
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
        read_json(place, "thing")


def test_a_missing_file_and_a_file_of_another_encoding(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="not there"):
        read_json(tmp_path / "none", "thing")
    (tmp_path / "x").write_bytes(b"\xff\xfe{}")
    with pytest.raises(FileFormatError, match="not UTF-8"):
        read_json(tmp_path / "x", "thing")


def test_what_is_there_needs_force(tmp_path: Path) -> None:
    place = tmp_path / "x"
    assert output_path(place) == place
    place.write_text("mine")
    with pytest.raises(FieldError, match="already there"):
        output_path(place)
    assert output_path(place, force=True) == place


def test_a_place_where_no_file_can_be_made_is_told_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "text").write_text("mine")
    for place in (tmp_path / "text" / "x.json", tmp_path / "text" / "new" / "x.json"):
        with pytest.raises(
            FieldError, match="below text, which is not a folder"
        ) as told:
            output_path(place, force=True)
        assert (told.value.field, told.value.value) == ("out", str(place))
        assert told.value.remedy == "choose another folder"
    with pytest.raises(FieldError, match="a folder"):
        output_path(tmp_path, force=True)
    with pytest.raises(FieldError, match="already there"):
        output_path("/")
    assert output_path(tmp_path / "new" / "newer" / "x.json").name == "x.json"
    monkeypatch.setattr(
        os, "access", lambda place, _: place != tmp_path
    )  # root may write everywhere
    with pytest.raises(FieldError, match=r"not writable \(no permission in "):
        output_path(tmp_path / "new" / "x.json")


def test_an_error_of_the_system_names_the_file_that_was_asked_for() -> None:
    """And not the temporary one, which nobody knows and which is gone."""
    missing = Path("/proc/fraclink-test")
    if not Path("/proc/self").exists():
        pytest.skip("this system has no /proc, where no file can be made")
    with pytest.raises(OSError, match="fraclink-test") as told, atomic_write(missing):
        pass
    assert told.value.filename == str(missing)


def test_the_hash_is_that_of_the_bytes(tmp_path: Path) -> None:
    (tmp_path / "x").write_bytes(b"abc")
    # FIPS 180-2, appendix B.1
    assert (
        sha256_of(tmp_path / "x")
        == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    )


@pytest.mark.parametrize(
    "kind", [FieldError, LogError, FileFormatError, SizeError, UnstableError]
)
def test_an_error_crosses_a_process_border_with_its_parts(
    kind: type[FieldError],
) -> None:
    error = kind("payload", -1, "negative", allowed="> 0 kg", remedy="give kg")
    # What a pool of processes does with an error; the package itself never unpacks such
    # bytes.
    back = pickle.loads(pickle.dumps(error))  # noqa: S301
    assert type(back) is kind
    assert (back.field, back.value, back.problem) == ("payload", -1, "negative")
    assert (back.allowed, back.remedy, str(back)) == ("> 0 kg", "give kg", str(error))
