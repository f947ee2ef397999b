"""Which format a file is in, by its first bytes; a name that says another one is an error."""

from __future__ import annotations

from pathlib import Path

from fraclink.readers.table import Table
from fraclink.readers.text import read_text_table

__all__ = ["read_table"]


def read_table(path: Path) -> Table:
    """Read the columns of a file of any known format."""
    return read_text_table(path)
