"""Binary files: which contents become columns, which are left out, and their names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fraclink import inspect_log
from fraclink.errors import SizeError
from fraclink.extend import read_columns

SAMPLES = np.arange(12.0)

pytestmark = pytest.mark.slow  # one process per file


def test_what_holds_no_samples_yields_no_column(tmp_path: Path) -> None:
    from scipy.io import savemat

    cell = np.empty((1, 2), dtype=object)
    cell[0, 0], cell[0, 1] = "a", SAMPLES
    arrays = {
        "scalar": 3.0,
        "text": "words",
        "turned": np.array([1j, 2j]),
        "cell": cell,
        "one": np.zeros(1),
        "cube": np.zeros((2, 2, 2)),
        "picture": np.zeros((1100, 1001)),
        "table": np.zeros((300, 256)),
    }
    savemat(tmp_path / "a.mat", arrays)
    names = list(read_columns(tmp_path / "a.mat"))
    assert len(names) == 256 and names[0] == "table(:,1)"


def test_what_is_over_the_limits_is_refused(tmp_path: Path) -> None:
    from scipy.io import savemat

    arrays = {f"c{k}": np.zeros(2) for k in range(1001)}
    savemat(tmp_path / "b.mat", arrays)
    with pytest.raises(SizeError):
        read_columns(tmp_path / "b.mat")


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
    # "char" shows that MATLAB wrote the file: groups are then structures, and arrays
    # are transposed.
    listed = inspect_log(tmp_path / "a.h5").channels
    assert [(channel.name, channel.unit) for channel in listed] == [
        ("group.angle", "deg"),
        ("table(1,:)", ""),
        ("table(2,:)", ""),
    ]
    with h5py.File(tmp_path / "b.h5", "w") as file:
        file["group/table"] = np.array([[1, 2], [3, 4], [5, 6]])
    columns = read_columns(tmp_path / "b.h5")
    assert list(columns) == ["group/table[:,0]", "group/table[:,1]"]
    assert columns["group/table[:,0]"].tolist() == [1.0, 3.0, 5.0]


def test_structures_of_matlab_become_dotted_names(tmp_path: Path) -> None:
    from scipy.io import savemat

    inner = {"values": np.arange(6.0).reshape(3, 2), "label": "theta"}
    runs = np.array([(np.arange(2.0),), (np.arange(3.0),)], dtype=[("y", object)])
    scope = {"time": np.arange(3.0), "signals": inner}
    savemat(tmp_path / "a.mat", {"scope": scope, "runs": runs, "note": "words"})
    columns = {k: v.tolist() for k, v in read_columns(tmp_path / "a.mat").items()}
    assert columns == {
        "scope.time": [0.0, 1.0, 2.0],
        "scope.signals.values(:,1)": [0.0, 2.0, 4.0],
        "scope.signals.values(:,2)": [1.0, 3.0, 5.0],
        "runs(1).y": [0.0, 1.0],
        "runs(2).y": [0.0, 1.0, 2.0],
    }
