"""NPZ and JSON files: contents survive a round trip, and hostile files are refused
before they use memory.
"""

from __future__ import annotations

import io
import json
import struct
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

import fraclink as fl
from fraclink._files.containers import read_archive, write_archive
from fraclink.errors import FileFormatError

ARRAYS = {
    "a": np.random.default_rng(0).standard_normal(50),
    "b": np.arange(6.0).reshape(2, 3),
    "empty": np.zeros(0),
    "flags": np.arange(5, dtype=np.uint32),
    "turned": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
}
ABOUT = {"payload": 0.03, "names": ["x", "ü"]}


def write_npz(path: Path) -> None:
    """Write the arrays with an envelope."""
    head = {"fraclink": "thing", "format": 1, "units": "SI, radians"}
    with path.open("wb") as stream:
        write_archive(stream, json.dumps(head | ABOUT), ARRAYS)


def npy(array: np.ndarray, **options: object) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array(stream, array, **options)  # type: ignore[arg-type]
    return stream.getvalue()


def header_npy(kind: str = "thing", version: int = 1) -> bytes:
    return npy(np.array(json.dumps({"fraclink": kind, "format": version})))


def archive(
    path: Path, members: list[tuple[str, bytes]], way: int = zipfile.ZIP_DEFLATED
) -> Path:
    with zipfile.ZipFile(path, "w", way) as file:
        for name, content in members:
            file.writestr(zipfile.ZipInfo(name), content, way)
    return path


def refused(path: Path) -> FileFormatError:
    with pytest.raises(FileFormatError) as caught:
        fl.load(path)
    assert caught.value.allowed and caught.value.remedy
    return caught.value


def test_what_was_written_comes_back(tmp_path: Path) -> None:
    write_npz(tmp_path / "a.npz")
    text, arrays = read_archive(tmp_path / "a.npz", "a thing")
    about = json.loads(text)
    assert (
        about["payload"] == 0.03
        and about["names"] == ["x", "ü"]
        and about["units"] == "SI, radians"
    )
    assert list(arrays) == list(ARRAYS)
    for name, values in ARRAYS.items():
        assert (
            np.array_equal(arrays[name], values) and arrays[name].dtype == values.dtype
        )
        assert not arrays[name].flags.writeable
    with np.load(
        tmp_path / "a.npz", allow_pickle=False
    ) as data:  # other programs can open it as well
        assert np.array_equal(data["a"], ARRAYS["a"])


def test_the_same_content_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a.npz", "b.npz"):
        write_npz(tmp_path / name)
        time.sleep(0.01)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


class Trap:
    """An object that makes a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[object, ...]:
        return Path.touch, (self.path,)


def test_b63_no_object_of_an_array_is_made(tmp_path: Path) -> None:
    sprung = tmp_path / "sprung"
    blob = npy(np.array([Trap(sprung)], dtype=object), allow_pickle=True)
    error = refused(
        archive(tmp_path / "a.npz", [("about.npy", header_npy()), ("x.npy", blob)])
    )
    assert "damaged" in error.problem or "object" in error.problem
    assert not sprung.exists()


@pytest.mark.parametrize("kind", ["<f4", "<i4", ">f8", "<c8", "|S8"])
def test_b63_an_array_of_another_type(kind: str, tmp_path: Path) -> None:
    blob = npy(np.zeros(4, dtype=kind))
    error = refused(
        archive(tmp_path / "a.npz", [("about.npy", header_npy()), ("x.npy", blob)])
    )
    assert "not float64" in error.problem


@pytest.mark.parametrize("shape", ["(1000000000000,)", "(-5,)", "(2, 3)", "(4,", "x"])
def test_b64_a_header_that_claims_what_is_not_there(shape: str, tmp_path: Path) -> None:
    header = (
        f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".ljust(117)
        + "\n"
    )
    blob = (
        b"\x93NUMPY\x01\x00"
        + struct.pack("<H", len(header))
        + header.encode()
        + bytes(32)
    )
    error = refused(
        archive(tmp_path / "a.npz", [("about.npy", header_npy()), ("x.npy", blob)])
    )
    assert "damaged" in error.problem


def test_b65_a_zip_bomb_is_refused_before_it_unpacks(tmp_path: Path) -> None:
    blob = npy(np.zeros(100))
    path = archive(tmp_path / "a.npz", [("about.npy", header_npy()), ("x.npy", blob)])
    raw = bytearray(path.read_bytes())
    real = struct.pack("<I", len(blob))
    assert raw.count(real) == 2  # in the local header and in the directory
    path.write_bytes(raw.replace(real, struct.pack("<I", 500_000_000)))
    assert "too large" in refused(path).problem


@pytest.mark.slow
def test_b65_a_directory_that_lies_about_sizes(tmp_path: Path) -> None:
    blob = npy(np.zeros(2_500_000))
    path = archive(tmp_path / "a.npz", [("about.npy", header_npy()), ("x.npy", blob)])
    raw = bytearray(path.read_bytes())
    real, told = struct.pack("<I", len(blob)), struct.pack("<I", 1000)
    path.write_bytes(raw.replace(real, told))
    assert "damaged" in refused(path).problem


def test_b67_a_member_given_twice(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="Duplicate"):
        path = archive(
            tmp_path / "a.npz",
            [("about.npy", header_npy()), ("x.npy", npy(np.zeros(3)))] * 2,
        )
    assert "given twice" in refused(path).problem


def test_b67_an_encrypted_member(tmp_path: Path) -> None:
    path = archive(tmp_path / "a.npz", [("about.npy", header_npy())])
    raw = bytearray(path.read_bytes())
    raw[raw.index(b"PK\x01\x02") + 8] |= 1
    path.write_bytes(raw)
    assert "encrypted" in refused(path).problem


def test_b68_no_archive_at_all(tmp_path: Path) -> None:
    (tmp_path / "a.npz").write_bytes(b"time_s,motor_angle_rad\n")
    assert "not valid JSON" in refused(tmp_path / "a.npz").problem
    assert (
        "without a header"
        in refused(archive(tmp_path / "a.npz", [("x.npy", npy(np.zeros(3)))])).problem
    )
