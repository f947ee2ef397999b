"""Detection of the format of a file by its first bytes, and the child process that
parses binary formats.

A file name that contradicts the content is an error.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

from fraclink._files.containers import read_archive
from fraclink._reading.table import LogTable, check_file, too_large
from fraclink._reading.text import read_text_table
from fraclink._reading.worker import CPU_SECONDS, MEMORY_LIMIT
from fraclink.errors import (
    FileFormatError,
    LogError,
    MissingExtraError,
)

_MAGIC = (
    (0, b"MATLAB 5.0", "MAT v5"),
    (0, b"MATLAB 7.3", "HDF5"),
    (0, b"\x89HDF\r\n\x1a\n", "HDF5"),
    (512, b"\x89HDF\r\n\x1a\n", "HDF5"),
    (0, b"TDSm", "TDMS"),
)
_EXPORT = "export it as CSV"
_ECHO = "play it, and write a topic with `ros2 topic echo --csv TOPIC > log.csv`"
_TABLE = "keep only its table: sed -n '/^X_Value/,$p' LOG > log.csv"
# First bytes of files that are not logs, what they are, and how to get a log from them.
_FOREIGN = (
    (
        b"PK\x03\x04",
        "a zip or spreadsheet",
        f'{_EXPORT}; a fraclink log with fraclink.load("log.npz").save("log.csv")',
    ),
    (
        b"\x93NUMPY",
        "a NumPy array",
        f'{_EXPORT}: numpy.savetxt("log.csv", numpy.load("log.npy"), delimiter=",")',
    ),
    (b"\x1f\x8b", "gzip", _EXPORT),
    (b"\xd0\xcf\x11\xe0", "an old spreadsheet", _EXPORT),
    (b"%PDF", "PDF", _EXPORT),
    (b"PAR1", "Parquet", _EXPORT),
    (b"\x80\x04", "pickle", _EXPORT),
    (b"\x89MCAP", "a ROS 2 recording", _ECHO),
    (b"SQLite format 3", "a database", f"{_EXPORT}; a ROS 2 recording: {_ECHO}"),
    (b"LabVIEW Measurement", "a LabVIEW measurement file", _TABLE),
    (b"{", "JSON", _EXPORT),
    (b"<", "HTML or XML", _EXPORT),
)
# Name endings that imply a format; others (.txt, .dat, .log …) imply none.
_PROMISED = {
    ".mat": ("MAT v5", "HDF5"),
    ".h5": ("HDF5",),
    ".hdf5": ("HDF5",),
    ".tdms": ("TDMS",),
    ".csv": ("text",),
    ".tsv": ("text",),
}


def sniffed_kind(path: Path) -> str:
    """The format of the file at `path`: text, MAT v5, HDF5 or TDMS.

    Raises FileFormatError if its content is not a log, or contradicts its name.
    """
    check_file(path)
    with path.open("rb") as stream:
        head = stream.read(1024)
    # By content instead of name: a .mat file is MATLAB's own format or, from v7.3 on,
    # HDF5.
    kind = next(
        (kind for at, magic, kind in _MAGIC if head[at : at + len(magic)] == magic),
        "text",
    )
    promised = _PROMISED.get(path.suffix.lower(), (kind,))
    wrong = [
        (f"{name} by its content", "text, MAT, HDF5, TDMS", remedy)
        for magic, name, remedy in _FOREIGN
        if head.startswith(magic)
    ]
    if kind not in promised:
        remedy = "it is damaged, or its name has the wrong ending"
        if path.suffix.lower() == ".mat":
            remedy = "it is damaged or from MATLAB v4: save it again with save log.mat t theta torque -v7"
        wrong.append((f"{kind} by its content", " or ".join(promised), remedy))
    if wrong:
        raise FileFormatError("log", path.name, *wrong[0])
    return kind


def read_table(path: Path) -> LogTable:
    """Read the columns of a file of any known format.

    Binary formats are parsed in a child process with limits on memory and time. Raises
    FileFormatError, LogError, SizeError or MissingExtraError.
    """
    kind = sniffed_kind(path)
    if kind == "text":
        return read_text_table(path)
    table = _parsed_by_child(path, kind)
    if not table.names:
        raise LogError(
            "log",
            path.name,
            f"a {kind} file without a numeric array of two samples or more",
            "arrays of real numbers",
            "export plain arrays, in MATLAB with save log.mat t theta torque -v7",
        )
    return table


_WALL_SECONDS = 60  # wall time of the child for one file: the disk may be slow


def _parsed_by_child(path: Path, kind: str) -> LogTable:
    """The table in a binary file; FileFormatError if the child rejects it or crashes."""
    # Every thread of a linear algebra library reserves address space, and the child
    # has only 1 GB.
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    with tempfile.TemporaryDirectory() as folder:
        answer = Path(folder, "answer.npz")
        command = [sys.executable, "-P", "-m", "fraclink._reading.worker", kind]
        child = subprocess.Popen(  # noqa: S603
            [*command, str(path.absolute()), str(answer)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=environment,
        )
        try:
            # The child's own limit counts processor time, which does not advance while
            # it waits for a disk or a lock.
            child.wait(_WALL_SECONDS)
            text, arrays = read_archive(answer, "the columns of a file")
        except subprocess.TimeoutExpired as error:
            raise _damaged(
                path, kind, f"its parser was stopped after {_WALL_SECONDS} s"
            ) from error
        except FileFormatError as error:
            raise _damaged(path, kind, _reason_of_end(child.returncode)) from error
        finally:
            child.kill()
            child.wait()
    about = json.loads(text)
    if "missing" in about:
        raise MissingExtraError(f"the reader of {kind}", "io")
    if "large" in about:
        raise too_large(*about["large"])
    if "damaged" in about:
        raise _damaged(path, kind, about["damaged"])
    names, units = zip(*about["columns"], strict=True) if arrays else ((), ())
    values = tuple(arrays[f"c{place}"] for place in range(len(names)))
    return LogTable(names, values, units, kind)


def _reason_of_end(code: int) -> str:
    """Why the child ended without an answer, in words."""
    if hasattr(signal, "SIGXCPU") and code == -signal.SIGXCPU:
        return f"its parser needed more than {CPU_SECONDS} s"
    if code < 0:
        return f"its parser crashed ({signal.Signals(-code).name})"
    return f"its parser ended ({code}), perhaps because it needed over {MEMORY_LIMIT / 1e9:g} GB"


def _damaged(path: Path, kind: str, reason: str) -> FileFormatError:
    return FileFormatError(
        "log",
        path.name,
        f"damaged or hostile: {reason}",
        f"a sound {kind} file",
        "export it again, or as CSV",
    )
