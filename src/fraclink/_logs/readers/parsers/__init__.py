"""Parsers of binary formats; they run in a child process that may be killed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from fraclink._logs.readers.parsers.column import RawColumn

__all__ = ["RawColumn", "parser"]


def parser(kind: str) -> Callable[[Path], tuple[list[RawColumn], dict[str, str]]]:
    """The parser of a format: path to columns and notes."""
    from importlib import import_module

    homes = {"MAT v5": "mat5", "HDF5": "hdf5", "Parquet": "parquet", "TDMS": "tdms", "ROS 2": "ros"}
    module = import_module(f"fraclink._logs.readers.parsers.{homes[kind]}")
    chosen: Callable[[Path], tuple[list[RawColumn], dict[str, str]]] = module.read
    return chosen
