"""The parsers of binary logs in this process: what they take for a column, what they
leave, and its name.
"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fraclink._reading import worker
from fraclink._reading.worker import NUMPY, columns_of
from fraclink.errors import SizeError
from made_files import made_columns, made_file

SAMPLES = np.arange(12.0)


def listed(array: object, **options: object) -> list[tuple[str, list[float]]]:
    return [
        (column.name, column.values.tolist())
        for column in columns_of("x", array, **options)
    ]


def test_time_runs_along_the_longer_axis() -> None:
    assert listed(np.array([1, 2, 3])) == [("x", [1.0, 2.0, 3.0])]
    wide = [("x(1,:)", [0, 1, 2, 3, 4, 5]), ("x(2,:)", [6, 7, 8, 9, 10, 11])]
    assert listed(SAMPLES.reshape(2, 6)) == wide
    high = [("x(:,1)", [0, 6, 1, 7, 2, 8]), ("x(:,2)", [3, 9, 4, 10, 5, 11])]
    tall = np.array([[0, 3], [6, 9], [1, 4], [7, 10], [2, 5], [8, 11]])
    assert listed(tall) == high
    assert [name for name, _ in listed(tall, indexing=NUMPY)] == ["x[:,0]", "x[:,1]"]
    assert [name for name, _ in listed(tall.T, indexing=NUMPY)] == ["x[0,:]", "x[1,:]"]
    assert listed(np.ones((1, 5))) == [("x", [1.0] * 5)]
    assert listed(np.array([[1.0, 2.0], [3.0, 4.0]])) == [
        ("x(:,1)", [1.0, 3.0]),
        ("x(:,2)", [2.0, 4.0]),
    ]
    (column,) = columns_of("x", np.array([True, False]), "V")
    assert (column.unit, column.values.tolist()) == ("V", [1.0, 0.0])


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


@pytest.mark.parametrize(
    ("kind", "read", "names", "units"),
    [
        ("mat5", worker.read_mat5, ("time_s", "motor_angle_rad", "torque_Nm"), ("", "", "")),
        ("mat73", worker.read_hdf5, ("motor_angle_rad", "time_s", "torque_Nm"), ("", "", "")),
        ("hdf5", worker.read_hdf5, ("motor_angle_rad", "time_s", "torque_Nm"), ("rad", "s", "Nm")),
        ("parquet", worker.read_parquet, ("time_s", "motor_angle_rad", "torque_Nm"), ("", "", "")),
        (
            "tdms", worker.read_tdms,
            ("arm/time_s", "arm/motor_angle_rad", "arm/torque_Nm"), ("s", "rad", "Nm"),
        ),
    ],
)  # fmt: skip
def test_each_parser_finds_the_columns_of_its_format(
    kind: str,
    read: object,
    names: tuple[str, ...],
    units: tuple[str, ...],
    tmp_path: Path,
) -> None:
    columns, notes = read(made_file(kind, tmp_path, 60))
    assert tuple(column.name for column in columns) == names
    assert tuple(column.unit for column in columns) == units
    assert notes == {}
    wanted = made_columns(60)
    for column in columns:
        assert column.values.dtype == np.float64
        np.testing.assert_array_equal(
            column.values, wanted[column.name.rsplit("/", 1)[-1]]
        )


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


def test_parquet_columns_of_other_types(tmp_path: Path) -> None:
    pa = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    stamps = pa.array(
        [1_700_000_000_000_000 + 4000 * k for k in range(5)], pa.timestamp("us")
    )
    fields = {
        "t": stamps,
        "on": [True, False] * 2 + [True],
        "n": [1, 2, None, 4, 5],
        "who": ["a"] * 5,
    }
    table = pa.table(
        fields | {"late": pa.array([None, *stamps[1:].to_pylist()], pa.timestamp("us"))}
    )
    table = table.append_column(
        pa.field("g", pa.float32(), metadata={"unit": "N*m"}),
        pa.array([0.5] * 5, pa.float32()),
    )
    table = table.append_column("twice", pa.array(range(5))).append_column(
        "twice", pa.array(range(5))
    )
    parquet.write_table(table, tmp_path / "a.parquet")
    columns, _ = worker.read_parquet(tmp_path / "a.parquet")
    assert [(column.name, column.unit) for column in columns] == [
        ("t", "s"),
        ("on", ""),
        ("n", ""),
        ("g", "N*m"),
    ]
    np.testing.assert_allclose(
        columns[0].values, [0.0, 0.004, 0.008, 0.012, 0.016], atol=1e-12
    )
    np.testing.assert_array_equal(columns[2].values, [1, 2, np.nan, 4, 5])


def test_joints_and_numbers_of_messages() -> None:
    joints = SimpleNamespace(
        name=["a", "b"], position=[1.0, 2.0], velocity=[], effort=[3.0, 4.0]
    )
    assert worker._joints(joints) == {
        "a.position": 1.0,
        "b.position": 2.0,
        "a.effort": 3.0,
        "b.effort": 4.0,
    }

    def message(**fields: object) -> object:
        return SimpleNamespace(__dataclass_fields__=dict.fromkeys(fields), **fields)

    vector = message(x=1, y=2.5, label="word", flag=True)
    whole = message(header=message(seq=7), force=vector, temperature=20)
    assert worker._numbers(whole, "", 4) == {
        "force.x": 1.0,
        "force.y": 2.5,
        "temperature": 20.0,
    }
    assert worker._numbers(whole, "", 0) == {"temperature": 20.0}


def test_messages_are_sorted_by_their_stamps() -> None:
    """The second one overtook the first; the effort is missing from the last."""
    base = 1_700_000_000_000_000_000
    stamps = {"/joints": [base + 4_000_000, base, base + 8_000_000]}
    series = {"/joints": {"a.position": [2.0, 1.0, 3.0], "a.effort": [5.0, 4.0]}}
    columns, notes = worker._sorted_columns(series, stamps)
    assert notes == {"first stamp of /joints": f"{base} ns"}
    named = {column.name: (column.unit, column.values.tolist()) for column in columns}
    assert named["/joints/time"][0] == "s" and named["/joints/a.position"] == (
        "rad",
        [1.0, 2.0, 3.0],
    )
    np.testing.assert_allclose(
        named["/joints/time"][1], [0.0, 0.004, 0.008], atol=1e-15
    )
    assert named["/joints/a.effort"][0] == "Nm"
    np.testing.assert_array_equal(named["/joints/a.effort"][1], [4.0, 5.0, np.nan])


def test_a_waveform_s_step_makes_stamps() -> None:
    def channel(**properties: object) -> list[tuple[str, str, list[float]]]:
        made = type(
            "Channel",
            (),
            {"properties": properties, "__getitem__": lambda self, key: SAMPLES[:3]},
        )()
        return [
            (c.name, c.unit, c.values.tolist()) for c in worker._channel("g/u", made)
        ]

    signal = ("g/u", "", [0.0, 1.0, 2.0])
    assert channel() == [signal]
    assert channel(unit_string="V", wf_increment=0.5) == [
        ("g/u", "V", signal[2]),
        ("g/u.time", "s", [0.0, 0.5, 1.0]),
    ]
    assert channel(wf_increment=0.5, wf_start_offset=2.0)[1][2] == [2.0, 2.5, 3.0]
    for step in (0.0, -0.5, float("nan"), 1):
        assert channel(wf_increment=step) == [signal]


def test_arrays_of_numpy(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", SAMPLES.reshape(6, 2))
    columns, _ = worker.read_npy(tmp_path / "a.npy")
    assert [(column.name, column.values.size) for column in columns] == [
        ("#1", 6),
        ("#2", 6),
    ]
    np.save(
        tmp_path / "b.npy",
        np.array([(0.0, 1), (0.1, 2)], dtype=[("t", "f8"), ("n", "i4")]),
    )
    columns, _ = worker.read_npy(tmp_path / "b.npy")
    assert [(column.name, column.values.tolist()) for column in columns] == [
        ("t", [0.0, 0.1]),
        ("n", [1.0, 2.0]),
    ]


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
