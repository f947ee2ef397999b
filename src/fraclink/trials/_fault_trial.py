"""One run of a fault: the trial that is tampered with, its execution, and what the run
must have shown.
"""

from __future__ import annotations

import itertools
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.reference import Reference, smooth_step
from fraclink._arm.rig import Rig
from fraclink._design import Design
from fraclink._law import Law
from fraclink._simulate import Twin, kernel
from fraclink._simulate import sensors as columns
from fraclink._simulate.kernel import ArmState
from fraclink._simulate.on_twin import with_motor_loop
from fraclink._simulate.sensors import healthy_inputs
from fraclink.errors import FieldError
from fracsys.checks import Between, checked

__all__ = [
    "MOVE",
    "PHASES",
    "TIMES",
    "Bench",
    "Case",
    "Trial",
    "TrialSignals",
    "execute",
]

Real = NDArray[np.float64]
Counts = NDArray[np.uint32]
Rows = slice | NDArray[np.int_]
Action = Callable[[ArmState], None]
Phase = Literal["whole", "start", "mid", "rest"]

MOVE = smooth_step(
    1.0, duration=1.2, start=1.0
)  # the catalogue's move: 1 rad, 1.0 to 2.2 s
TIMES = {"whole": 0.0, "start": 1.1, "mid": 1.6, "rest": 3.2}  # [s]
PHASES: tuple[Phase, ...] = ("whole", "start", "mid", "rest")
EVER = 1e6  # [s]: to the end of the run
MOVE_BEGINS = 1.0  # [s]
LAST = 1.0  # [s] of the end over which the final error is averaged

# law.h: modes, reasons and flags.
IDLE, RUN, DEGRADED, HOLD, OFF = range(5)
(
    BAD_VERSION,
    BAD_SIZE,
    BAD_CRC,
    _,
    BAD_ENCODER,
    BAD_GAUGE,
    GAUGE_STUCK,
    RESIDUAL,
    MISSED_PERIODS,
    OVERLOAD,
) = range(1, 11)
ENCODER, GAUGE, REFERENCE, MISSED, REPEATED, STARTED = 1, 2, 4, 8, 16, 128
# twin.h: bits of the kernel's fault word.
(
    ENCODER_REPLACED,
    GAUGE_REPLACED,
    FROZEN_ENCODER,
    FROZEN_GAUGE,
    SWAPPED,
    TICK_MISSED,
    TICK_REPEATED,
) = (1 << bit for bit in range(7))
# law_state: fourteen words, then these reals, in the order of law.h.
WORDS = (
    *("stamp", "mode", "reason", "tick", "bad_encoder", "bad_gauge"),
    *(
        "residual",
        "stuck",
        "overload",
        "frozen",
        "missed",
        "ringing",
        "tracking",
        "given",
    ),
)
COUNTERS = len(WORDS)
REALS = (
    *(f"modes[{i}]" for i in range(20)),
    *(
        "error",
        "reference",
        "motor_reference",
        "motor_angle",
        "torque",
        "model_angle",
        "model_push",
    ),
    *("stuck_torque", "encoder", "encoder_model", "input_reference"),
    *(
        "payload",
        "scale",
        "track",
        "track_push",
        "late",
        "fade",
        "swing",
        "integral",
        "filter",
        "voltage",
        "sum",
    ),
)


# ---- before the run ----------------------------------------------------------------------------------


@checked
@dataclass(frozen=True)
class Case:
    """One run of a fault: severity 1 … 3, payload [kg], phase of the move, seed of
    noise and chance.

    >>> Case("F07", 2, 0.02, "mid", 3).name
    'F07-2-20g-mid-3'
    """

    fault: str
    severity: Annotated[int, Between(1, 3)]
    payload: Annotated[float, Between(0.0, 1e3, "kg", low_open=True)]
    phase: Phase
    seed: Annotated[int, Between(0, 2**63 - 1)]

    @property
    def name(self) -> str:
        """A name for files."""
        return f"{self.fault}-{self.severity}-{1e3 * self.payload:g}g-{self.phase}-{self.seed}"


@dataclass(frozen=True)
class Bench:
    """What is tested: the law, the twin it runs on, the rig, the payloads (low,
    nominal, high) [kg].

    modulus_margin: least |1 + L| of the true sampled loop over the payloads, for the
    bound on noise.
    """

    rig: Rig
    law: Law
    twin: Twin
    payloads: tuple[float, float, float]
    modulus_margin: float

    @staticmethod
    @checked
    def of(
        design: Design, rig: Rig | None = None, *, link_mass: float | None = None
    ) -> Bench:
        """Return the bench of a design on `rig` (default: its own), with its shipped
        law and motor loop.
        """
        arm = design.rig if rig is None else rig
        twin = Twin.from_rig(arm, link_mass=link_mass)
        law, _ = with_motor_loop(replace(design, rig=arm).law(), twin=twin)
        low, high = design.payloads
        nominal = arm.payloads.nominal
        # A design for other payloads than its rig's is tested in the middle of its own.
        if not low <= nominal <= high:
            nominal = 0.5 * (low + high)
        # Of both ends, since the sensitivity's peak moves from the lightest to the
        # heaviest payload with the design.
        margin = min(design.sampled_at(p).modulus_margin for p in (low, high))
        return Bench(arm, law, twin, (low, nominal, high), margin)

    def with_law(self, law: Law) -> Bench:
        """Return the same bench for another law; FieldError where its period is not the
        rig's.
        """
        if law.period != self.law.period:
            allowed, remedy = f"{self.law.period} s", "discretise at the rig's period"
            raise FieldError(
                "period", law.period, "not the rig's", allowed=allowed, remedy=remedy
            )
        return replace(self, law=with_motor_loop(law, twin=self.twin)[0])


class Trial:
    """A run before it begins, open to be tampered with. Internal, mutable."""

    def __init__(
        self, bench: Bench, case: Case, law: Law, reference: Reference, duration: float
    ) -> None:
        self.bench, self.case, self.reference = bench, case, reference
        self.use(law)
        self.twin = bench.twin.with_payload(case.payload)
        self.period = law.period
        self.count = round(duration / self.period) + 1
        # The fault's own dice, so that the noise is that of the clean run; the name
        # holds the seed.
        self.chance = np.random.default_rng([case.seed, zlib.crc32(case.name.encode())])
        # A stream apart from the fault's dice: with one for both, a fault that draws
        # would change the noise behind it, and clean and faulty run would differ by
        # more than the fault.
        noise = np.random.default_rng([case.seed, 0])
        self.inputs = healthy_inputs(
            self.twin.sensors, reference, self.period, self.count, noise
        )
        self.wanted = self.inputs[:, columns.REFERENCE].copy()
        # Of every phase the nearest period, so that a rig of another clock is broken at
        # the same moment of its move.
        self.row = round(TIMES[case.phase] / self.period)
        self.marks = np.zeros(
            self.count, dtype=bool
        )  # periods in which a sample is bad
        self.actions: dict[int, list[Action]] = {}
        self.start_angle = float(self.wanted[0])
        self.detail = ""  # what chance chose
        self.shifts: NDArray[np.int_] | None = (
            None  # of each sampling instant [ms-steps]
        )

    def use(self, law: Law) -> None:
        """Run another law from the first period on."""
        self.law, self.block, self.state = law, law.block, law.initial_state()

    def pick(self, *values: float) -> float:
        """Return the value of the case's severity."""
        return values[self.case.severity - 1]

    def rows(self, seconds: float) -> slice:
        """Return the periods from the fault on for `seconds`; a slice of at least one."""
        return slice(self.row, self.row + max(1, round(seconds / self.period)))

    def sprinkled(self, share: float) -> NDArray[np.int_]:
        """Return random periods, `share` of all but the first two."""
        rows = np.flatnonzero(self.chance.random(self.count) < share)
        return np.asarray(rows[rows >= 2])

    def at(self, row: int, action: Action) -> None:
        """Do `action` to the arm just before period `row`."""
        self.actions.setdefault(row, []).append(action)

    def set_bits(self, rows: Rows, bits: int, *, mark: bool = False) -> None:
        """Set bits of the kernel's fault word, and mark the periods in which the law
        must say something.
        """
        column = self.inputs[:, columns.FAULT_BITS]
        # Several faults may meet in one period; the column holds a word of bits as a
        # real.
        column[rows] = column[rows].astype(int) | bits
        self.marks[rows] |= mark

    def replace_reading(self, sensor: str, value: float | Real, rows: Rows) -> None:
        """Replace readings of "encoder" or "gauge" by `value` and mark them as bad."""
        encoder = sensor == "encoder"
        self.set_bits(rows, ENCODER_REPLACED if encoder else GAUGE_REPLACED, mark=True)
        self.inputs[rows, columns.ENCODER_VALUE if encoder else columns.GAUGE_VALUE] = (
            value
        )

    def miss(self, count: int) -> None:
        """Do not run the task for `count` periods; the next one is marked, where the
        law can first tell.
        """
        self.set_bits(slice(self.row, self.row + count), TICK_MISSED)
        # While the task does not run there is nobody to raise a flag.
        self.marks[self.row + count] = True

    @property
    def width(self) -> int:
        """Bytes of a real number of the trial's law."""
        return 4 if self.law.precision == "single" else 8

    def flip(self, name: str, bit_from_top: int) -> None:
        """Flip one bit of a real of the law's memory at the fault; 1 is the highest bit
        of the exponent.
        """
        place = 4 * COUNTERS + self.width * REALS.index(name)
        # Little-endian: the sign is the highest bit of the last byte, the exponent's
        # highest the one below.
        bit = 8 * self.width - 1 - bit_from_top
        self.detail = f"{name}, {'sign' if bit_from_top == 0 else 'exponent'}"

        def action(arm: ArmState) -> None:
            arm.law[place + bit // 8] ^= np.uint8(1 << (bit % 8))

        self.at(self.row, action)

    def restart(self, row: int) -> None:
        """Start the law anew before period `row`."""
        fresh = np.frombuffer(self.law.initial_state(), dtype=np.uint8)
        self.at(row, lambda arm: arm.law.__setitem__(slice(None), fresh))
        self.marks[row] = True

    def corrupt(self, byte: int, value: int | None = None) -> None:
        """Flip the lowest bit of a byte of the parameter block, or set the 32-bit word
        there to `value`.
        """
        block = bytearray(self.block)
        self.detail = f"byte {byte}"
        if value is None:
            block[byte] ^= 1
        else:
            # The header's words are unsigned: −1 is the largest.
            struct.pack_into("<I", block, byte, value % 2**32)
        self.block = bytes(block)


def members(
    memory: NDArray[np.uint8], size: int
) -> NDArray[np.float64] | NDArray[np.float32]:
    """Return the reals, of `size` bytes each, of a law's memory; a view of it."""
    body = memory[4 * COUNTERS :]
    return body.view(np.float32) if size == 4 else body.view(np.float64)


# ---- the run -----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class TrialSignals:
    """One value per control period of a run; units as in `Run`. `law_state`: the law's
    memory at the end.
    """

    time: Real
    wanted: Real
    tip: Real
    motor: Real
    torque: Real
    encoder: Real
    gauge: Real
    command: Real
    voltage: Real
    asked: Real
    mode: Counts
    reason: Counts
    flags: Counts
    law_state: bytes
    finished: bool

    def __post_init__(self) -> None:
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False

    @property
    def error(self) -> Real:
        """Tip angle minus reference [rad]."""
        return np.asarray(self.tip - self.wanted)


# Signals -> columns of the kernel's record.
_COLUMNS = {
    "tip": "tip_angle",
    "motor": "motor_angle",
    "torque": "torque",
    "encoder": "motor_angle_measured",
    "gauge": "torque_measured",
    "command": "motor_reference",
    "voltage": "voltage",
    "asked": "voltage_asked",
}


def execute(trial: Trial) -> TrialSignals:
    """Run a trial on the twin."""
    arm = ArmState(trial.twin, trial.period, trial.state, start_angle=trial.start_angle)
    single = trial.law.precision == "single"
    # A period is as long as its two instants of sampling are apart: the arm's own steps
    # are exact and of 1 ms, so that an early sample is a shorter period of whole steps.
    steps = (
        None if trial.shifts is None else arm.count + np.diff(trial.shifts, append=0)
    )
    edges = sorted(
        {0, trial.count, *(k for k in trial.actions if 0 <= k < trial.count)}
    )
    if steps is not None:
        # Every period has a length of its own then, and is a call of its own.
        edges = list(range(trial.count + 1))
    records: list[Real] = []
    for first, last in itertools.pairwise(edges):
        for action in trial.actions.get(first, ()):
            action(arm)
        if steps is not None:
            arm.rig[0] = steps[first]
        records.append(arm.run(trial.block, trial.inputs[first:last], single=single))
        # The arm has left every bound: what would follow is no physics.
        if len(records[-1]) < last - first:
            break
    record = np.vstack(records)
    count = len(record)
    by_name = dict(zip(kernel.RECORD, np.ascontiguousarray(record.T), strict=False))
    marks = {
        name: by_name[name].astype(np.uint32) for name in ("mode", "reason", "flags")
    }
    return TrialSignals(
        time=trial.period * np.arange(count, dtype=np.float64),
        wanted=trial.wanted[:count].copy(),
        **{name: by_name[column] for name, column in _COLUMNS.items()},
        **marks,
        law_state=arm.law.tobytes(),
        finished=count == trial.count,
    )
