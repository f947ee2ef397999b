"""Limits of what the readers take: beyond them a file is refused before memory is taken.

A rig that runs for an hour at 1 kHz makes 3.6 million samples; four columns of them are about 200 MB of
text. What is larger is not one experiment.
"""

from __future__ import annotations

from pathlib import Path

from fraclink.errors import FileFormatError, SizeError

__all__ = [
    "COLUMN_LIMIT",
    "CPU_SECONDS",
    "FILE_LIMIT",
    "LINE_LIMIT",
    "MEMORY_LIMIT",
    "SAMPLE_LIMIT",
    "VALUE_LIMIT",
    "WALL_SECONDS",
    "check_file",
]

FILE_LIMIT = 256_000_000  # bytes
SAMPLE_LIMIT = 4_000_000  # rows
COLUMN_LIMIT = 1_000
LINE_LIMIT = 100_000  # bytes of one line of text
VALUE_LIMIT = 32_000_000  # numbers in all: 256 MB in memory
MEMORY_LIMIT = 1_000_000_000  # bytes of address space of the child that reads binary files
CPU_SECONDS = 10  # of that child, for one file
WALL_SECONDS = 60  # of that child, for one file: the disk may be slow


def check_file(path: Path) -> int:
    """Return the size of the file at `path` [bytes], or raise where there is none or it is too large."""
    if not path.exists():
        raise FileFormatError("log", str(path), "not there", allowed="a log file", remedy="check the path")
    if not path.is_file():
        raise FileFormatError(
            "log", str(path), "not a file", allowed="a log file", remedy="give the file itself"
        )
    size = path.stat().st_size
    if size > FILE_LIMIT:
        raise SizeError(
            "log",
            f"{size / 1e6:.0f} MB",
            "too large",
            allowed=f"{FILE_LIMIT / 1e6:.0f} MB",
            remedy="cut the recording to one experiment, or record at a lower rate",
        )
    if size == 0:
        raise FileFormatError(
            "log", str(path), "empty", allowed="a header and samples", remedy="record again"
        )
    return size
