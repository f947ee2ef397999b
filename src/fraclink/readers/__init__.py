"""Readers of recorded logs: stated columns in, an `Experiment` out."""

from fraclink.readers.reading import bundled_log, bundled_logs, read_columns, read_log

__all__ = ["bundled_log", "bundled_logs", "read_columns", "read_log"]
