"""Which format a file is in, by its first bytes, and the child process that parses the
binary ones.

A name that says another format than the content is an error.
"""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path
from types import TracebackType
from typing import IO, Any

import numpy as np

from fraclink._reading.text import (
    CPU_SECONDS,
    MEMORY_LIMIT,
    WALL_SECONDS,
    LogTable,
    check_bytes,
    check_file,
    read_text_table,
)
from fraclink.errors import (
    FieldError,
    FileFormatError,
    LogError,
    MissingExtraError,
    SizeError,
)

_MAGIC = (
    (0, b"MATLAB 5.0", "MAT v5"),
    (0, b"MATLAB 7.3", "HDF5"),
    (0, b"\x89HDF\r\n\x1a\n", "HDF5"),
    (512, b"\x89HDF\r\n\x1a\n", "HDF5"),
    (0, b"PAR1", "Parquet"),
    (0, b"TDSm", "TDMS"),
    (0, b"\x93NUMPY", "NumPy"),
    (0, b"\x89MCAP0\r\n", "ROS 2"),
    (0, b"SQLite format 3\x00", "ROS 2"),
)
_FOREIGN = (
    (b"PK\x03\x04", "a zip or spreadsheet"),
    (b"\x1f\x8b", "gzip"),
    (b"\xd0\xcf\x11\xe0", "an old spreadsheet"),
    (b"%PDF", "PDF"),
    (b"\x80\x04", "pickle"),
    (b"{", "JSON"),
    (b"<", "HTML or XML"),
)
# Names that promise a format; other endings (.txt, .dat, .log …) promise nothing.
_PROMISED = {
    ".mat": ("MAT v5", "HDF5"),
    ".h5": ("HDF5",),
    ".hdf5": ("HDF5",),
    ".parquet": ("Parquet",),
    ".tdms": ("TDMS",),
    ".npy": ("NumPy",),
    ".mcap": ("ROS 2",),
    ".db3": ("ROS 2",),
    ".csv": ("text",),
    ".tsv": ("text",),
}


def sniffed_kind(path: Path) -> str:
    """The format of the file at `path`: text, MAT v5, HDF5, Parquet, TDMS, NumPy or ROS
    2.

    Raises FileFormatError where its content holds no log, or is of another format than
    its name says.
    """
    if path.is_dir():
        if (path / "metadata.yaml").is_file():
            return "ROS 2"
        raise FileFormatError(
            "log",
            path.name or str(path),
            "a folder",
            allowed="a file, or a rosbag2 folder",
            remedy="give the file itself",
        )
    check_file(path)
    with path.open("rb") as stream:
        head = stream.read(1024)
    # By content and not by name: a .mat file is MATLAB's own format or HDF5, by its
    # age.
    kind = next(
        (kind for at, magic, kind in _MAGIC if head[at : at + len(magic)] == magic),
        "text",
    )
    for magic, name in _FOREIGN:
        if head.startswith(magic):
            known = "text, MAT, HDF5, Parquet, TDMS, NumPy, rosbag2, MCAP"
            raise _other(path, name, known, "export it as CSV")
    promised = _PROMISED.get(path.suffix.lower(), (kind,))
    if kind not in promised:
        raise _other(path, kind, " or ".join(promised), _remedy(path, kind))
    return kind


def _other(path: Path, found: str, allowed: str, remedy: str) -> FileFormatError:
    return FileFormatError(
        "log", path.name, f"{found} by its content", allowed=allowed, remedy=remedy
    )


def _remedy(path: Path, kind: str) -> str:
    if path.suffix.lower() == ".mat":
        return "it is damaged or of MATLAB v4: save it again, save log.mat t theta torque -v7"
    return (
        "correct the ending of its name"
        if kind != "text"
        else "it is damaged, or correct its ending"
    )


def read_table(path: Path, *, numbered: bool = False) -> LogTable:
    """Read the columns of a file of any known format.

    Where `numbered`, columns of text that the file's names do not fit are called by
    their numbers.

    Binary formats are parsed in a child process with limits of memory and time. Raises
    FileFormatError, LogError, SizeError or MissingExtraError.
    """
    kind = sniffed_kind(path)
    if kind == "text":
        return read_text_table(path, numbered=numbered)
    _check_folder(path)
    with ReaderChild() as child:
        table = child.read(path, kind)
    if not table.names:
        raise LogError(
            "log",
            path.name,
            f"a {kind} file without a numeric array of two samples or more",
            allowed="arrays of real numbers",
            remedy="export plain arrays; in MATLAB save log.mat t theta torque -v7",
        )
    return table


def _check_folder(path: Path) -> None:
    """Refuse a bag by its size: recorders split one into files, each of which may be
    small enough alone.
    """
    if path.is_dir():
        check_bytes(
            sum(file.stat().st_size for file in path.iterdir() if file.is_file())
        )


# --- the parent's side of the child ----------------------------------------------------------------------


# Bytes of the line that lists the columns: 1000 names of 200 characters, four bytes
# each, and their lengths.
_HEADER_LIMIT = 2_000_000
# s: a child that died is waited for; one that lives, blocked in its answer, is killed
_GRACE = 1.0


class ReaderChild:
    """A context manager around one child process; a child that dies is replaced at the
    next request.

    `cpu_seconds` is what the child may spend on one file [s of processor time].
    """

    def __init__(self, cpu_seconds: int = CPU_SECONDS) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._cpu_seconds = cpu_seconds

    def __enter__(self) -> ReaderChild:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._end()

    def _end(self) -> None:
        process, self._process = self._process, None
        if process is None:
            return
        process.kill()
        for stream in (process.stdin, process.stdout):
            if stream is not None:
                stream.close()
        process.wait()

    def _running(self) -> subprocess.Popen[bytes]:
        if self._process is None or self._process.poll() is not None:
            self._end()
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "fraclink._reading.worker"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                # Every thread of a linear algebra library reserves address space, of
                # which there is 1 GB.
                env=os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
            )
        return self._process

    def read(self, path: Path, kind: str) -> LogTable:
        """The table in the file at `path`; FileFormatError where the child refuses it
        or dies of it.
        """
        process = self._running()
        # The child's own limit counts processor time: one that waits for a disk or
        # hangs in a lock never reaches it.
        clock = threading.Timer(WALL_SECONDS, process.kill)
        clock.start()
        try:
            return self._ask(process, path, kind)
        except (
            BrokenPipeError,
            EOFError,
            json.JSONDecodeError,
            UnicodeDecodeError,
        ) as error:
            try:
                # The pipe closes a moment before the process is gone: without a wait
                # there is no exit code to explain.
                reason = _death(process.wait(timeout=_GRACE), self._cpu_seconds)
            except subprocess.TimeoutExpired:
                reason = "its parser gave an answer that is no list of columns"
            self._end()  # kills before it waits
            raise _damaged(path, kind, reason) from error
        finally:
            clock.cancel()

    def _ask(self, process: subprocess.Popen[bytes], path: Path, kind: str) -> LogTable:
        requests, answers = process.stdin, process.stdout
        if requests is None or answers is None:
            raise EOFError
        request = {
            "path": str(path.absolute()),
            "kind": kind,
            "cpu_seconds": self._cpu_seconds,
        }
        requests.write(json.dumps(request).encode() + b"\n")
        requests.flush()
        # A limit, as the child works on hostile bytes: it must not fill the parent's
        # memory with an endless line.
        header = json.loads(answers.readline(_HEADER_LIMIT))
        if "columns" not in header:
            raise _refusal(path, kind, header)
        names, units, values = [], [], []
        for name, unit, size in header["columns"]:
            names.append(name)
            units.append(unit)
            values.append(_array(answers, size))
        return LogTable(
            tuple(names),
            tuple(values),
            kind,
            tuple(header["notes"].items()),
            {},
            tuple(units),
        )


def _array(answers: IO[bytes], size: int) -> Any:
    # The size is the child's word: what it does not send is an error, and read() takes
    # no memory for what does not come.
    blob = answers.read(size)
    if len(blob) != size:
        raise EOFError
    return np.lib.format.read_array(io.BytesIO(blob), allow_pickle=False)


def _death(code: int, cpu_seconds: int) -> str:
    """Why the child ended, in words."""
    if code == -9:  # by the clock
        return f"its parser was stopped after {WALL_SECONDS} s"
    if hasattr(signal, "SIGXCPU") and code == -signal.SIGXCPU:
        return f"its parser needed more than {cpu_seconds} s"
    if code < 0:
        return f"its parser crashed ({signal.Signals(-code).name})"
    return f"its parser ended ({code}), perhaps for want of {MEMORY_LIMIT / 1e9:g} GB"


def _damaged(path: Path, kind: str, reason: str) -> FileFormatError:
    return FileFormatError(
        "log",
        path.name,
        f"damaged or hostile: {reason}",
        allowed=f"a sound {kind} file",
        remedy="export it again, or as CSV",
    )


def _refusal(path: Path, kind: str, header: dict[str, Any]) -> Exception:
    if "missing" in header:
        return MissingExtraError(*header["missing"])
    if "refused" in header:
        field, value, problem, allowed, remedy = header["refused"]
        # Classes do not cross the pipe: the words of the problem tell which one it was.
        error = SizeError if "large" in problem else FieldError
        return error(field, value, problem, allowed=allowed, remedy=remedy)
    return _damaged(path, kind, str(header.get("damaged", "")))
