"""The child that parses binary files: one request a line on its input, columns as .npy bytes on its output.

It is started as ``python -m fraclink._logs.worker``, may use 1 GB of address space
and 10 s of processor time for a file, and is expected to die: one changed byte makes some parsers crash.
"""

from __future__ import annotations

import io
import json
import os
import sys
from pathlib import Path
from typing import BinaryIO

import numpy as np

from fraclink._logs.parsers import PARSERS, RawColumn
from fraclink._logs.table import COLUMN_LIMIT, MEMORY_LIMIT, VALUE_LIMIT
from fraclink.errors import FieldError, MissingExtraError


def _limit_memory() -> None:
    try:
        import resource
    except ImportError:  # Windows has no such limits: the parent's clock is what remains there
        return
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_LIMIT, MEMORY_LIMIT))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _limit_time(seconds: int) -> None:
    """Allow `seconds` of processor time from now on; the kernel ends the process beyond that."""
    try:
        import resource
    except ImportError:
        return
    usage = resource.getrusage(resource.RUSAGE_SELF)
    limit = int(usage.ru_utime + usage.ru_stime) + 1 + seconds
    resource.setrlimit(resource.RLIMIT_CPU, (limit, resource.getrlimit(resource.RLIMIT_CPU)[1]))


def _answer(path: Path, kind: str) -> tuple[dict[str, object], list[bytes]]:
    """The header of the answer and the columns' bytes."""
    try:
        columns, notes = PARSERS[kind](path)
        _check_total(columns)
    except MissingExtraError as error:
        return {"missing": [error.package, error.extra]}, []
    except FieldError as error:
        return {"refused": [error.field, str(error.value), error.problem, error.allowed, error.remedy]}, []
    except MemoryError:
        return {"damaged": "it asks for more memory than a log needs"}, []
    except Exception as error:  # noqa: BLE001 - parsers of hostile bytes raise anything; all of it means one thing
        return {"damaged": f"{type(error).__name__}: {error}"[:200]}, []
    blobs = [_npy(column) for column in columns]
    listed = [
        [column.name[:200], column.unit, len(blob)] for column, blob in zip(columns, blobs, strict=True)
    ]
    return {"columns": listed, "notes": notes}, blobs


def _check_total(columns: list[RawColumn]) -> None:
    total = sum(column.values.size for column in columns)
    if len(columns) > COLUMN_LIMIT or total > VALUE_LIMIT:
        raise FieldError(
            "log",
            f"{total} numbers in {len(columns)} columns",
            "too large",
            allowed=f"{VALUE_LIMIT} numbers, {COLUMN_LIMIT} columns",
            remedy="cut the recording to one experiment",
        )


def _npy(column: RawColumn) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.asarray(column.values, dtype="<f8"), allow_pickle=False)
    return stream.getvalue()


def _serve(requests: BinaryIO, answers: BinaryIO) -> None:
    for line in requests:
        request = json.loads(line)
        _limit_time(int(request["cpu_seconds"]))
        header, blobs = _answer(Path(request["path"]), request["kind"])
        # As UTF-8, not as ASCII escapes: those make 12 bytes of one emoji, and the parent's limit is bytes.
        answers.write(json.dumps(header, ensure_ascii=False).encode("utf-8", "replace") + b"\n")
        for blob in blobs:
            answers.write(blob)
        answers.flush()


def main() -> None:
    """Serve requests until the input ends."""
    _limit_memory()
    # Libraries print warnings to standard output; the pipe of the answers must hold nothing else.
    with os.fdopen(os.dup(1), "wb") as answers, Path(os.devnull).open("wb") as nowhere:
        os.dup2(nowhere.fileno(), 1)
        _serve(sys.stdin.buffer, answers)


if __name__ == "__main__":
    main()
