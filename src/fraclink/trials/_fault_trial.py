"""One run of a fault: the bench, the trial that is tampered with, and its execution."""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.reference import Reference, hold, smooth_step
from fraclink._arm.rig import Rig
from fraclink._design import Design
from fraclink._law import MODES, REASONS, Law
from fraclink._simulate import Twin, kernel
from fraclink._simulate import events as columns
from fraclink._simulate.events import FAULTS, Action, healthy_inputs
from fraclink._simulate.kernel import ArmState
from fraclink._simulate.on_twin import acted, twin_run, with_motor_loop
from fraclink._simulate.run import Run
from fraclink.errors import FieldError
from fracsys.checks import Between, checked

__all__ = ["PHASES", "Bench", "Case", "Phase", "Trial", "end_of", "execute"]

Real = NDArray[np.float64]
Rows = slice | NDArray[np.int_]
Phase = Literal["whole", "start", "mid", "rest"]

# The catalogue's move: 1 rad, 1.0 to 2.2 s; [s] of a phase.
MOVE = smooth_step(1.0, duration=1.2, start=1.0)
TIMES: dict[Phase, float] = {"whole": 0.0, "start": 1.1, "mid": 1.6, "rest": 3.2}
PHASES: tuple[Phase, ...] = ("whole", "start", "mid", "rest")
MOVE_BEGINS = 1.0  # [s]
# A second move after ten seconds of the first: what a wound-up loop would spoil.
BACK_AT = 12.2  # [s]
MOVES: dict[str, Reference] = {
    "move": MOVE,
    "there and back": MOVE.then(hold(0.0, 10.0)).then(smooth_step(-0.75, duration=1.2)),
    # The paper's gauge, with a noise of 0.01 N·m, asks for 0.24 rad in this time
    # (`Law.wiring_angle`).
    "self-test": smooth_step(0.35, duration=0.12, start=0.1),
}
RUN = MODES.index("run")
# Words of the law's memory (law.h), then its reals: the modes first, and among them the
# real ones.
WORDS, MODES_HELD = 14, 20


# ── before the run
# ────────────────────────────────────────────────────────────────────────────────────────────


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
            raise FieldError(
                "period",
                law.period,
                "not the rig's",
                allowed=f"{self.law.period} s",
                remedy="discretise at the rig's period",
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
            self.twin.gauge, reference, self.period, self.count, noise
        )
        self.wanted = self.inputs[:, columns.REFERENCE].copy()
        # Of every phase the nearest period, so that a rig of another clock is broken at
        # the same moment of its move.
        self.row = round(TIMES[case.phase] / self.period)
        # periods in which a sample is bad
        self.marks = np.zeros(self.count, dtype=bool)
        self.actions: dict[int, list[Action]] = {}
        self.start_angle = float(self.wanted[0])
        self.detail = ""  # what chance chose
        # of each sampling instant [steps of 1 ms]
        self.shifts: NDArray[np.int_] | None = None

    def use(self, law: Law) -> None:
        """Run another law from the first period on."""
        self.law, self.block = law, law.block
        self.state = law.initial_state()

    def rows(self, seconds: float) -> slice:
        """Return the periods from the fault on for `seconds`; a slice of at least one."""
        length = max(1, round(min(seconds / self.period, self.count)))
        return slice(self.row, min(self.row + length, self.count))

    def sprinkled(self, share: float) -> NDArray[np.int_]:
        """Return random periods, `share` of all but the first two."""
        rows = np.flatnonzero(self.chance.random(self.count) < share)
        return np.asarray(rows[rows >= 2])

    def at(self, row: int, action: Action) -> None:
        """Do `action` to the arm just before period `row`."""
        self.actions.setdefault(row, []).append(action)

    def set_bits(self, rows: Rows, fault: str) -> None:
        """Set the bit of a fault in the kernel's fault word."""
        column = self.inputs[:, columns.FAULT_BITS]
        # Several faults may meet in one period; the column holds a word of bits as a
        # real.
        column[rows] = column[rows].astype(int) | FAULTS[fault][0]

    def replace_reading(self, sensor: str, value: float | Real, rows: Rows) -> None:
        """Replace readings of "encoder" or "gauge" by `value` and mark them as bad."""
        column = FAULTS[f"{sensor} value"][1]
        assert column is not None  # values have one  # noqa: S101
        self.set_bits(rows, f"{sensor} value")
        self.marks[rows] = True
        self.inputs[rows, column] = value


# ── the run
# ───────────────────────────────────────────────────────────────────────────────────────────────────


def end_of(run: Run) -> tuple[str, str]:
    """Return the law's last mode and reason in words."""
    return MODES[run.mode[-1]], REASONS[run.reason[-1]]


def execute(trial: Trial) -> tuple[Run, bytes]:
    """Run a trial on the twin; return the run, whose reference is the one before the
    fault, and the law's memory at its end.
    """
    arm = ArmState(trial.twin, trial.period, trial.state, start_angle=trial.start_angle)
    single = trial.law.precision == "single"
    actions: Mapping[int, Sequence[Action]] = trial.actions
    steps = None
    if trial.shifts is not None:
        # A period is as long as its two instants of sampling are apart: the arm's own
        # steps are exact and of 1 ms, so that an early sample is a shorter period of
        # whole steps, and every period a call of its own.
        steps = arm.count + np.diff(trial.shifts, append=0)
        actions = {row: actions.get(row, ()) for row in range(trial.count)}

    def part(first: int, last: int) -> Real:
        if steps is not None:
            arm.rig[0] = steps[first]
        return arm.run(trial.block, trial.inputs[first:last], single=single)

    record, payloads = acted(arm, trial.count, actions, part)
    count = len(record)
    record[:, kernel.RECORD.index("reference")] = trial.wanted[:count]
    run = twin_run(
        record,
        payloads,
        trial.twin,
        trial.period,
        finished=count == trial.count,
        ended=trial.reference.duration,
        about={"case": trial.case.name, "law_sha256": trial.law.digest},
    )
    return run, arm.law.tobytes()
