"""Ways to tamper with a trial: samples, the clock, the law's memory and its parameters."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from fraclink._campaign.faults.trial import Trial
from fraclink._simulate import kernel
from fraclink._simulate.kernel import ArmState

__all__ = [
    "FROZEN_ENCODER",
    "FROZEN_GAUGE",
    "REALS",
    "SWAPPED",
    "TICK_MISSED",
    "TICK_REPEATED",
    "add_fault",
    "bad_samples",
    "corrupt",
    "flip",
    "freeze",
    "members",
    "miss",
    "restart",
    "sprinkled",
    "width",
]

# Bits of the kernel's fault word (csrc/kernels/twin.h).
ENCODER_REPLACED, GAUGE_REPLACED, FROZEN_ENCODER, FROZEN_GAUGE, SWAPPED, TICK_MISSED, TICK_REPEATED = (
    1,
    2,
    4,
    8,
    16,
    32,
    64,
)
# Members of law_state behind its twelve words, in the order of law.h.
REALS = (
    *(f"modes[{i}]" for i in range(20)),
    "error",
    "reference",
    "motor_reference",
    "motor_angle",
    "torque",
    "model_near",
    "model_angle",
    "stuck_torque",
    "encoder",
    "encoder_model",
    "input_reference",
    "fade",
    "integral",
    "filter",
    "voltage",
)
COUNTERS = 12

Rows = slice | NDArray[np.int_]


def add_fault(trial: Trial, rows: Rows, bits: int) -> None:
    """Set bits of the fault word."""
    column = trial.inputs[:, kernel.FAULT_BITS]
    column[rows] = column[rows].astype(int) | bits


def bad_samples(trial: Trial, sensor: str, value: float | NDArray[np.float64], rows: Rows) -> None:
    """Replace readings of "encoder" or "gauge" by `value` and mark them as bad."""
    encoder = sensor == "encoder"
    add_fault(trial, rows, ENCODER_REPLACED if encoder else GAUGE_REPLACED)
    trial.inputs[rows, kernel.ENCODER_VALUE if encoder else kernel.GAUGE_VALUE] = value
    trial.marks[rows] = True


def freeze(trial: Trial, bits: int, rows: Rows) -> None:
    """Repeat the last reading."""
    add_fault(trial, rows, bits)
    trial.marks[rows] = True


def miss(trial: Trial, count: int) -> None:
    """Do not run the task for `count` periods; the next one is marked, where the law can first tell."""
    add_fault(trial, slice(trial.row, trial.row + count), TICK_MISSED)
    trial.marks[trial.row + count] = True


def sprinkled(trial: Trial, share: float, *, begin: int = 2) -> NDArray[np.int_]:
    """Return random periods, `share` of all from `begin` on."""
    rows = np.flatnonzero(trial.chance.random(trial.count) < share)
    return np.asarray(rows[rows >= begin])


def width(trial: Trial) -> int:
    """Return the bytes of a real number of the trial's law."""
    return 4 if trial.law.precision == "single" else 8


def members(memory: NDArray[np.uint8], size: int) -> NDArray[np.float64] | NDArray[np.float32]:
    """Return the reals, of `size` bytes each, of a law's memory; a view of it."""
    body = memory[4 * COUNTERS :]
    return body.view(np.float32) if size == 4 else body.view(np.float64)


def flip(trial: Trial, name: str, bit_from_top: int) -> None:
    """Flip one bit of a real of the law's memory at the fault; 1 is the highest bit of the exponent."""
    size = width(trial)
    place = 4 * COUNTERS + size * REALS.index(name)
    bit = 8 * size - 1 - bit_from_top
    trial.detail = f"{name}, {'sign' if bit_from_top == 0 else 'exponent'}"

    def action(arm: ArmState) -> None:
        arm.law[place + bit // 8] ^= np.uint8(1 << (bit % 8))

    trial.at(trial.row, action)


def restart(trial: Trial, row: int) -> None:
    """Start the law anew before period `row`."""
    fresh = np.frombuffer(trial.law.initial_state(), dtype=np.uint8)

    def action(arm: ArmState) -> None:
        arm.law[:] = fresh

    trial.at(row, action)
    trial.marks[row] = True


def corrupt(trial: Trial, byte: int, value: int | None = None) -> None:
    """Flip the lowest bit of a byte of the parameter block, or set the 32-bit word there to `value`."""
    block = bytearray(trial.block)
    trial.detail = f"byte {byte}"
    if value is None:
        block[byte] ^= 1
    else:
        struct.pack_into("<I", block, byte, value % 2**32)
    trial.block = bytes(block)
