"""The law in real time, around a board, a simulated arm or two functions of Python; and
an arm tuned over it.

The loop is C on absolute deadlines; what it runs is law.c, the file that is simulated
and exported. It does not judge what happens on the way to the arm: a sample that did
not come is NaN and a missed period is a jump of the tick, so that the law's own guards
decide, and a record replays to the last bit.
"""

from __future__ import annotations

from fraclink import _kernels
from fraclink._realtime.arm import ServedArm, serve_arm
from fraclink._realtime.connections import (
    Callback,
    Command,
    Connection,
    Library,
    SharedMemory,
    Udp,
    parse_connection,
)
from fraclink._realtime.loop import run_realtime
from fraclink._realtime.machine import Spread, WakeUps, measure_wake_ups, signals_held
from fraclink._realtime.run import RealtimeRun, reserved, saved

__all__ = [
    "Callback",
    "Command",
    "Connection",
    "Library",
    "RealtimeRun",
    "ServedArm",
    "SharedMemory",
    "Spread",
    "Udp",
    "VirtualClock",
    "WakeUps",
    "measure_wake_ups",
    "parse_connection",
    "reserved",
    "run_realtime",
    "saved",
    "serve_arm",
    "signals_held",
]

# Time for tests, in which `threads` loops and their peers take turns; see
# csrc/kernels/realtime.h.
VirtualClock = getattr(_kernels, "RealtimeClock", None)  # Linux only
