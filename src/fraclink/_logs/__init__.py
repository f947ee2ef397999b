"""Recorded logs: read, inspected, diagnosed; or guessed, for a first model."""

from fraclink._logs.columns import converter_step
from fraclink._logs.diagnosis import diagnose
from fraclink._logs.guess import Guess, Question
from fraclink._logs.reading import (
    ChannelSummary,
    LogListing,
    bundled_log,
    bundled_logs,
    inspect_log,
    read_columns,
    read_log,
)
from fraclink._logs.responses import read_frequency_response, read_recording

__all__ = [
    "ChannelSummary",
    "Guess",
    "LogListing",
    "Question",
    "bundled_log",
    "bundled_logs",
    "converter_step",
    "diagnose",
    "inspect_log",
    "read_columns",
    "read_frequency_response",
    "read_log",
    "read_recording",
]
