"""Readers of recorded logs: stated columns in, an `Experiment` out."""

from fraclink._logs.readers.inspection import ChannelSummary, LogListing, converter_step, inspect_log
from fraclink._logs.readers.reading import bundled_log, bundled_logs, read_columns, read_log

__all__ = [
    "ChannelSummary",
    "LogListing",
    "bundled_log",
    "bundled_logs",
    "converter_step",
    "inspect_log",
    "read_columns",
    "read_log",
]
