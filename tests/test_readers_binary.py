"""Binary logs: the same numbers from every format, and damaged or hostile files."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from fraclink import Channel, LogColumns, inspect_log, read_log
from fraclink.errors import (
    FieldError,
    FileFormatError,
    LogError,
    MissingExtraError,
    SizeError,
)
from fraclink.extend import read_columns
from made_files import KINDS, made_columns, made_file, write_mat5
from shared_data import shared_data

NAMES = {
    "tdms": ("arm/time_s", "arm/motor_angle_rad", "arm/torque_Nm"),
}


def stated(kind: str) -> LogColumns:
    time, angle, torque = NAMES.get(kind, ("time_s", "motor_angle_rad", "torque_Nm"))
    return LogColumns(
        Channel(time, "s"), Channel(angle, "rad"), torque=Channel(torque, "Nm")
    )


def refused(path: Path) -> FieldError:
    with pytest.raises(FieldError) as caught:
        read_columns(path)
    assert caught.value.remedy
    return caught.value


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_every_format_holds_the_same_numbers(kind: str, tmp_path: Path) -> None:
    log = read_log(made_file(kind, tmp_path), columns=stated(kind), payload=0.03)
    columns = made_columns()
    assert np.array_equal(log.motor_angle, columns["motor_angle_rad"])
    assert np.array_equal(log.output, columns["torque_Nm"])
    assert (log.period, log.start_time) == (0.004, 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["hdf5", "tdms"])
def test_units_that_a_file_states_are_listed(kind: str, tmp_path: Path) -> None:
    units = {
        channel.unit for channel in inspect_log(made_file(kind, tmp_path)).channels
    }
    assert units == {"s", "rad", "Nm"}


@pytest.mark.slow
def test_tdms_waveform_steps_become_stamps(tmp_path: Path) -> None:
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter(str(tmp_path / "a.tdms")) as writer:
        properties = {"wf_increment": 0.002, "wf_start_offset": 0.5}
        writer.write_segment(
            [nptdms.ChannelObject("g", "u", np.arange(5.0), properties=properties)]
        )
    assert read_columns(tmp_path / "a.tdms")["g/u.time"].tolist() == [
        0.5,
        0.502,
        0.504,
        0.506,
        0.508,
    ]


@pytest.mark.slow
def test_a_simulink_structure_with_time() -> None:
    columns = read_columns(
        shared_data("ist_flexbar", "1_test_deflection_model_2_final.mat")
    )
    assert columns["tensao_pot.time"].size == 30001
    assert columns["tensao_pot.signals.values(:,2)"].size == 30001
    assert columns["tensao_pot.signals.values(:,3)"].max() == pytest.approx(
        1.23535, abs=1e-5
    )
    assert columns["ScopeData(:,1)"].size == 7366
    log = read_log(
        shared_data("ist_flexbar", "1_test_deflection_model_2_final.mat"),
        columns=LogColumns(
            Channel("tensao_pot.time", "s"),
            Channel(
                "tensao_pot.signals.values(:,2)", "deg", scale=36.79, offset="first"
            ),
            deflection=Channel("tensao_pot.signals.values(:,3)", "deg", scale=1.301),
            voltage=Channel("tensao_pot.signals.values(:,1)", "V"),
        ),
    )
    assert (log.period, log.motor_angle.size) == (0.001, 30001)


@pytest.mark.slow
def test_matlab_arrays_of_merced_hold_what_the_table_holds() -> None:
    table = read_columns(shared_data("quanser_rfl_merced", "merced_rfl.csv"))
    arrays = read_columns(shared_data("quanser_rfl_merced", "data_alpha.mat"))
    np.testing.assert_allclose(
        arrays["data_alpha(:,2)"], table["alpha_deg"], rtol=2e-5, atol=1e-5
    )


@pytest.mark.slow
def test_b18_columns_of_different_clocks() -> None:
    path = shared_data("ist_flexbar", "1_test_deflection_model_2_final.mat")
    mixed = LogColumns(
        Channel("input.time", "s"),
        Channel("tensao_pot.signals.values(:,2)", "deg"),
        deflection=Channel("tensao_pot.signals.values(:,3)", "deg"),
    )
    with pytest.raises(
        LogError, match="30001 samples long, while time has 20001"
    ) as caught:
        read_log(path, columns=mixed)
    assert caught.value.field == "column of motor_angle"


@pytest.mark.slow
def test_b66_a_mat_file_without_a_numeric_array(tmp_path: Path) -> None:
    from scipy.io import savemat
    from scipy.sparse import eye_array

    cell = np.empty((1, 2), dtype=object)
    cell[0, 0], cell[0, 1] = "a", np.arange(5.0)
    savemat(
        tmp_path / "a.mat",
        {
            "text": "hello",
            "cell": cell,
            "sparse": eye_array(5),
            "scalar": 3.0,
            "z": np.ones(4) * 1j,
        },
    )
    error = refused(tmp_path / "a.mat")
    assert isinstance(error, LogError)
    assert "without a numeric array" in error.problem and "-v7" in error.remedy


@pytest.mark.slow
def test_b66_a_zlib_bomb_stays_within_its_limits(tmp_path: Path) -> None:
    import struct
    import zlib

    count = 300_000_000  # doubles: 2.4 GB of zeros in 2.4 MB
    matrix = (
        struct.pack("<IIII", 6, 8, 6, 0)
        + struct.pack("<IIii", 5, 8, 1, count)
        + struct.pack("<HHI", 1, 1, ord("x"))
    )
    matrix += struct.pack("<II", 9, 8 * count)
    packer = zlib.compressobj(9)
    start = packer.compress(
        struct.pack("<II", 14, len(matrix) + 8 * count) + matrix
    ) + packer.flush(zlib.Z_FULL_FLUSH)
    block = packer.compress(bytes(10_000_000)) + packer.flush(zlib.Z_FULL_FLUSH)
    # after a full flush the same zeros compress to the same bytes
    blob = start + 240 * block
    header = (
        b"MATLAB 5.0 MAT-file".ljust(116) + bytes(8) + struct.pack("<H", 0x0100) + b"IM"
    )
    (tmp_path / "a.mat").write_bytes(header + struct.pack("<II", 15, len(blob)) + blob)
    error = refused(tmp_path / "a.mat")
    assert isinstance(error, FileFormatError)
    assert "more memory than a log needs" in error.problem


@pytest.mark.slow
def test_b64_a_header_that_claims_a_thousand_billion_samples(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset(
            "big", shape=(1_000_000_000_000,), dtype="f8", chunks=(1000,)
        )
    error = refused(tmp_path / "a.h5")
    assert isinstance(error, SizeError)
    assert "1000000000000" in str(error.value)


@pytest.mark.slow
def test_hdf5_does_not_read_other_files(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    (tmp_path / "secret").write_bytes(np.arange(100.0).tobytes())
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("own", data=np.arange(10.0))
        file.create_dataset(
            "outside",
            shape=(100,),
            dtype="f8",
            external=[(str(tmp_path / "secret"), 0, 800)],
        )
        file["link"] = h5py.ExternalLink(str(tmp_path / "b.h5"), "/x")
    assert list(read_columns(tmp_path / "a.h5")) == ["own"]


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_b66_a_cut_file_is_damaged(kind: str, tmp_path: Path) -> None:
    path = made_file(kind, tmp_path)
    raw = path.read_bytes()
    path.write_bytes(raw[: len(raw) // 2])
    try:
        columns = read_columns(path)
    except FieldError as error:
        assert error.field == "log" and error.remedy
    else:  # a cut recording may still hold its first part
        assert kind == "tdms"
        assert all(values.size <= 400 for values in columns.values())


def test_b66_the_signal_that_ended_a_parser_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import subprocess

    code = "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)"
    start = subprocess.Popen

    def crashing(command: list[str], **options: object) -> subprocess.Popen[bytes]:
        return start([sys.executable, "-c", code], **options)  # type: ignore[call-overload,no-any-return]

    monkeypatch.setattr(subprocess, "Popen", crashing)
    error = refused(write_mat5(tmp_path / "a.mat", made_columns()))
    assert isinstance(error, FileFormatError)
    assert "damaged or hostile: its parser crashed (SIGSEGV)" in error.problem


@pytest.mark.slow
def test_a_missing_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = made_file("hdf5", tmp_path)
    (tmp_path / "empty" / "h5py").mkdir(parents=True)
    (tmp_path / "empty" / "h5py" / "__init__.py").write_text(
        "raise ImportError('not here')\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "empty"))
    with pytest.raises(MissingExtraError, match=r"fraclink\[io\]"):
        read_columns(path)


@pytest.mark.slow
def test_content_decides_about_the_format(tmp_path: Path) -> None:
    for kind, name in (
        ("mat5", "MAT v5"),
        ("mat73", "HDF5"),
        ("tdms", "TDMS"),
    ):
        path = made_file(kind, tmp_path)
        assert inspect_log(path).kind == name
        path = path.rename(tmp_path / f"{kind}.log")
        assert inspect_log(path).kind == name


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["v5", "v7.3", "hdf5"])
def test_columns_are_called_as_their_program_calls_them(
    kind: str, tmp_path: Path
) -> None:
    tall = np.arange(20.0).reshape(10, 2)
    if kind == "v5":
        from scipy.io import savemat

        savemat(tmp_path / "a.mat", {"tall": tall, "wide": tall.T})
        path = tmp_path / "a.mat"
    else:
        h5py = pytest.importorskip("h5py")
        path = tmp_path / "a.h5"
        with h5py.File(path, "w") as file:
            for name, values in (("tall", tall), ("wide", tall.T)):
                item = file.create_dataset(
                    name, data=values.T if kind == "v7.3" else values
                )
                if kind == "v7.3":
                    item.attrs["MATLAB_class"] = np.bytes_("double")
    columns = read_columns(path)
    second = (
        ("tall[:,1]", "wide[1,:]") if kind == "hdf5" else ("tall(:,2)", "wide(2,:)")
    )
    for name in second:
        assert columns[name].tolist() == tall[:, 1].tolist()
    assert len(columns) == 4


@pytest.mark.slow
def test_900_columns_with_long_names_are_read(tmp_path: Path) -> None:
    """With ASCII escapes the list of columns took 2 MB and exceeded the limit of the
    parent process, which then waited 60 s.
    """
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "n.h5", "w") as file:
        for number in range(900):
            file["\U0001f600" * 190 + str(number)] = np.arange(10.0)
    assert len(read_columns(tmp_path / "n.h5")) == 900


@pytest.mark.parametrize(
    ("head", "remedy"),
    [
        (b"\x89MCAP0\r\n", "ros2 topic echo --csv"),
        (b"LabVIEW Measurement\t\nX_Value\ta\n0.0\t1\n", "sed -n '/^X_Value/,$p'"),
    ],
)
def test_a_file_that_holds_no_table_is_refused_with_the_way_to_one(
    head: bytes, remedy: str, tmp_path: Path
) -> None:
    (tmp_path / "log").write_bytes(head)
    assert remedy in refused(tmp_path / "log").remedy
