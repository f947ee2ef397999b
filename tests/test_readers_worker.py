"""The parsers of binary logs in this process: what they take for a column, what they
leave, and its name.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fraclink._reading import worker
from fraclink._reading.worker import columns_of
from fraclink.errors import SizeError

SAMPLES = np.arange(12.0)


def listed(array: object, **options: object) -> list[tuple[str, list[float]]]:
    return [
        (column.name, column.values.tolist())
        for column in columns_of("x", array, **options)
    ]


@pytest.mark.parametrize(
    "array",
    [
        3.0, [1.0, 2.0], np.array(["a", "b"]), np.array([1j, 2j]), np.array([None, 1]), np.zeros(1),
        np.zeros(0),
        np.zeros((2, 2, 2)), np.array(5.0), np.zeros((300, 257)),
    ],
)  # fmt: skip
def test_what_holds_no_samples_yields_no_column(array: object) -> None:
    assert listed(array) == []
    assert len(listed(np.zeros((300, 256)))) == 256


def test_what_is_over_the_limits_is_refused_before_it_is_made() -> None:
    worker.check_size(32_000_000, 1000)
    for values, columns in ((32_000_001, 1), (1, 1001)):
        found = f"{values} numbers in {columns} columns"
        with pytest.raises(
            SizeError,
            match=rf"log: too large .got {found}.; expected 32000000 numbers, 1000",
        ):
            worker.check_size(values, columns)
    with pytest.raises(SizeError):
        list(columns_of("x", np.broadcast_to(0.0, (32_000_001,))))


def test_hdf5_datasets_that_are_no_signals_are_left(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["group/angle"] = SAMPLES
        file["group/angle"].attrs["unit"] = "deg"
        file["table"] = np.array([[1, 2], [3, 4], [5, 6]])
        file["text"], file["cube"], file["one"] = "words", np.zeros((2, 3, 4)), 4.0
        file["#refs"] = SAMPLES
        file["soft"] = h5py.SoftLink("/group/angle")
        file["char"] = np.arange(5)
        file["char"].attrs["MATLAB_class"] = np.bytes_("char")
    columns, _ = worker.read_hdf5(tmp_path / "a.h5")
    # "char" says that MATLAB wrote the file: groups are structures then, and arrays
    # stand transposed.
    assert [(column.name, column.unit) for column in columns] == [
        ("group.angle", "deg"), ("table(1,:)", ""), ("table(2,:)", "")
    ]  # fmt: skip
    assert columns[1].values.tolist() == [1.0, 3.0, 5.0]
    with h5py.File(tmp_path / "b.h5", "w") as file:
        file["group/table"] = np.array([[1, 2], [3, 4], [5, 6]])
    names = [column.name for column in worker.read_hdf5(tmp_path / "b.h5")[0]]
    assert names == ["group/table[:,0]", "group/table[:,1]"]


def test_structures_of_matlab_become_dotted_names(tmp_path: Path) -> None:
    from scipy.io import savemat

    inner = {"values": np.arange(6.0).reshape(3, 2), "label": "theta"}
    savemat(
        tmp_path / "a.mat",
        {"scope": {"time": np.arange(3.0), "signals": inner}, "note": "words"},
    )
    columns, _ = worker.read_mat5(tmp_path / "a.mat")
    found = {column.name: column.values.tolist() for column in columns}
    assert found == {
        "scope.time": [0.0, 1.0, 2.0],
        "scope.signals.values(:,1)": [0.0, 2.0, 4.0],
        "scope.signals.values(:,2)": [1.0, 3.0, 5.0],
    }
    two = np.array([(np.arange(2.0),), (np.arange(3.0),)], dtype=[("y", object)])
    assert [column.name for column in worker._flat("runs", two, 6)] == [
        "runs(1).y",
        "runs(2).y",
    ]
    assert (
        not list(worker._flat("runs", two, 1))
        and len(list(worker._flat("runs", two, 2))) == 2
    )
    many = np.array([(np.arange(2.0),)] * 70, dtype=[("y", object)])
    assert len(list(worker._flat("runs", many, 6))) == 64


def test_the_answer_names_what_is_wrong(tmp_path: Path) -> None:
    (tmp_path / "a.npy").write_bytes(b"\x93NUMPY\x01\x00")
    header, blobs = worker._answer(tmp_path / "a.npy", "NumPy")
    assert list(header) == ["damaged"] and not blobs
    np.save(tmp_path / "b.npy", SAMPLES)
    header, blobs = worker._answer(tmp_path / "b.npy", "NumPy")
    assert header == {"columns": [["#1", "", len(blobs[0])]], "notes": {}}
    assert blobs[0].startswith(b"\x93NUMPY") and blobs[0].endswith(
        SAMPLES.astype("<f8").tobytes()
    )
