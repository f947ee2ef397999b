"""The parent's side of the child that parses binary files."""

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

from fraclink._logs.readers.limits import CPU_SECONDS, MEMORY_LIMIT, WALL_SECONDS
from fraclink._logs.readers.table import Table
from fraclink.errors import FieldError, FileFormatError, MissingExtraError, SizeError

__all__ = ["ReaderChild"]

_HEADER_LIMIT = 1_000_000  # bytes of the line that lists the columns


class ReaderChild:
    """A context manager around one child process; a child that dies is replaced at the next request.

    `cpu_seconds` is what the child may spend on one file [s of processor time].
    """

    def __init__(self, cpu_seconds: int = CPU_SECONDS) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._cpu_seconds = cpu_seconds

    def __enter__(self) -> ReaderChild:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
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
                [sys.executable, "-P", "-m", "fraclink._logs.readers.worker"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                # Every thread of a linear algebra library reserves address space, of which there is 1 GB.
                env=os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
            )
        return self._process

    def read(self, path: Path, kind: str) -> Table:
        """The table in the file at `path`; FileFormatError where the child refuses it or dies of it."""
        process = self._running()
        clock = threading.Timer(WALL_SECONDS, process.kill)
        clock.start()
        try:
            return self._ask(process, path, kind)
        except (BrokenPipeError, EOFError, json.JSONDecodeError) as error:
            reason = _death(process.wait(), self._cpu_seconds)
            self._end()
            raise _damaged(path, kind, reason) from error
        finally:
            clock.cancel()

    def _ask(self, process: subprocess.Popen[bytes], path: Path, kind: str) -> Table:
        requests, answers = process.stdin, process.stdout
        if requests is None or answers is None:
            raise EOFError
        request = {"path": str(path.absolute()), "kind": kind, "cpu_seconds": self._cpu_seconds}
        requests.write(json.dumps(request).encode() + b"\n")
        requests.flush()
        header = json.loads(answers.readline(_HEADER_LIMIT))
        if "columns" not in header:
            raise _refusal(path, kind, header)
        names, units, values = [], [], []
        for name, unit, size in header["columns"]:
            names.append(name)
            units.append(unit)
            values.append(_array(answers, size))
        return Table(tuple(names), tuple(values), kind, tuple(header["notes"].items()), {}, tuple(units))


def _array(answers: IO[bytes], size: int) -> Any:
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
        error = SizeError if "large" in problem else FieldError
        return error(field, value, problem, allowed=allowed, remedy=remedy)
    return _damaged(path, kind, str(header.get("damaged", "")))
