"""Binary logs written for tests, one per format, all with the same numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from made_logs import made_motion, made_output

Columns = dict[str, NDArray[np.float64]]
KINDS = ("mat5", "mat73", "hdf5", "tdms")


def made_columns(count: int = 400) -> Columns:
    """A good log."""
    time, motor = made_motion(count)
    return {"time_s": time, "motor_angle_rad": motor, "torque_Nm": made_output(motor)}


def write_mat5(path: Path, columns: Columns, *, compressed: bool = True) -> Path:
    from scipy.io import savemat

    savemat(
        path,
        {name: values.reshape(-1, 1) for name, values in columns.items()},
        do_compression=compressed,
    )
    return path


def write_mat73(path: Path, columns: Columns) -> Path:
    """MATLAB v7.3: HDF5 after a header of 512 bytes, with transposed arrays."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in columns.items():
            item = file.create_dataset(name, data=values.reshape(1, -1))
            item.attrs["MATLAB_class"] = np.bytes_("double")
    raw = bytearray(path.read_bytes())
    raw[:128] = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, HDF5 schema 1.00 .".ljust(128)
    path.write_bytes(raw)
    return path


def write_hdf5(path: Path, columns: Columns) -> Path:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        for name, values in columns.items():
            item = file.create_dataset(name, data=values, compression="gzip")
            item.attrs["units"] = name.rsplit("_", 1)[1]
    return path


def write_tdms(path: Path, columns: Columns) -> Path:
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter(str(path)) as writer:
        writer.write_segment(
            [
                nptdms.ChannelObject(
                    "arm",
                    name,
                    values,
                    properties={"unit_string": name.rsplit("_", 1)[1]},
                )
                for name, values in columns.items()
            ]
        )
    return path


def made_file(kind: str, folder: Path, count: int = 400) -> Path:
    """A good log in a format."""
    columns = made_columns(count)
    write, name = {
        "mat5": (write_mat5, "log.mat"),
        "mat73": (write_mat73, "log73.mat"),
        "hdf5": (write_hdf5, "log.h5"),
        "tdms": (write_tdms, "log.tdms"),
    }[kind]
    return write(folder / name, columns)
