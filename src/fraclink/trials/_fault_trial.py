"""One run of a fault: the bench, the trial with the fault, and its execution."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from fraclink import _kernels
from fraclink._arm.reference import Reference, hold, smooth_step
from fraclink._arm.rig import Rig
from fraclink._design import Design
from fraclink._law import MODES, REASONS, Law
from fraclink._law import block as layout
from fraclink._simulate import Twin, kernel
from fraclink._simulate import events as columns
from fraclink._simulate.events import FAULTS, healthy_inputs
from fraclink._simulate.kernel import ArmState
from fraclink._simulate.on_twin import acted, twin_run
from fraclink._simulate.run import Run
from fracsys.checks import Between, Real, above, checked

__all__ = ["PHASES", "Bench", "Case", "FaultTrial", "Phase", "end_of", "execute"]

Rows = slice | NDArray[np.int_]
Action = Callable[[ArmState], None]
Phase = Literal["whole", "start", "mid", "rest"]

# The move of the catalogue: 1 rad, from 1.0 to 2.2 s; times of its phases [s].
MOVE = smooth_step(1.0, duration=1.2, start=1.0)
TIMES: dict[Phase, float] = {"whole": 0.0, "start": 1.1, "mid": 1.6, "rest": 3.2}
PHASES = tuple(TIMES)
MOVES: dict[str, Reference] = {
    "move": MOVE,
    # The move back, ten seconds after the first one, would be spoilt by a wound-up loop.
    "there and back": MOVE.then(hold(0.0, 10.0)).then(smooth_step(-0.75, duration=1.2)),
    # With the paper's gauge (noise 0.01 N·m) the test needs 0.26 rad in about this time
    # (`Law.wiring_angle`).
    "self-test": smooth_step(0.35, duration=0.12, start=0.1),
}
RUN = MODES.index("run")
# The law's memory (law.h) begins with words, followed by reals, whose bytes double with
# the precision.
SINGLE, DOUBLE = _kernels.law_sizes(True)[1], _kernels.law_sizes(False)[1]
MEMORY_WORDS = 2 * SINGLE - DOUBLE


# --- before the run -------------------------------------------------------------------


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
    payload: Annotated[float, above(0.0, 1e3, "kg")]
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
    def of(design: Design, *, link_mass: float | None = None) -> Bench:
        """Return the bench of a design on its rig, with its shipped law and motor
        loop.
        """
        twin = Twin.from_rig(design.rig, link_mass=link_mass)
        low, high = design.payloads
        nominal = design.rig.payloads.nominal
        # A design for payloads other than those of its rig is tested in the middle of
        # its own range.
        if not low <= nominal <= high:
            nominal = 0.5 * (low + high)
        # At both ends, since the peak of the sensitivity may lie at the lightest or the
        # heaviest payload, depending on the design.
        margin = min(design.sampled_at(p).modulus_margin for p in (low, high))
        return Bench(design.rig, design.law(), twin, (low, nominal, high), margin)


class FaultTrial:
    """A run before it begins, in which faults can be injected. Internal, mutable."""

    def __init__(
        self, bench: Bench, case: Case, reference: Reference, duration: float
    ) -> None:
        self.bench, self.case, self.reference = bench, case, reference
        self.use(bench.law)
        self.twin = bench.twin.with_payload(case.payload)
        self.period = bench.law.period
        # The fault's own random numbers depend on seed and name.
        self.chance = np.random.default_rng([case.seed, zlib.crc32(case.name.encode())])
        # A separate stream: a fault that drew from the same one would change the noise, so
        # that the clean and the faulty run would differ by more than the fault.
        noise = np.random.default_rng([case.seed, 0])
        self.inputs = healthy_inputs(
            self.twin.gauge, reference, self.period, duration, noise
        )
        self.count = len(self.inputs)
        self.wanted = self.inputs[:, columns.REFERENCE].copy()
        # The nearest period to the time of each phase, so that a rig with another
        # period has its fault at the same moment of the move.
        self.row = round(TIMES[case.phase] / self.period)
        # periods in which a sample is bad
        self.marks = np.zeros(self.count, bool)
        self.actions: dict[int, list[Action]] = {}
        self.start_angle = float(self.wanted[0])
        self.detail = ""  # the random choices
        # shift of each sampling instant [steps of 1 ms]
        self.shifts: NDArray[np.int_] | None = None

    def use(self, law: Law) -> None:
        """Run another law from the first period on."""
        self.law, self.block = law, law.block
        self.state = law.initial_state()
        self.real: np.dtype[np.float32] | np.dtype[np.float64] = (
            np.dtype(np.float32) if law.precision == "single" else np.dtype(np.float64)
        )

    @property
    def motor_loop(self) -> layout.DiscreteMotorLoop:
        """The law's motor loop, which the law of every bench has."""
        assert self.law.motor_loop is not None  # noqa: S101
        return self.law.motor_loop

    @property
    def designed_for(self) -> bool:
        """Whether the arm's payload is in the design's range, up to rounding."""
        low, _, high = self.bench.payloads
        payload = self.twin.beam.payload
        return low * (1 - 1e-9) <= payload <= high

    def rows(self, seconds: float) -> slice:
        """Return the periods from the fault on for `seconds`; a slice of at least one."""
        length = max(1, round(min(seconds / self.period, self.count)))
        return slice(self.row, min(self.row + length, self.count))

    def sprinkled(self, share: float) -> NDArray[np.int_]:
        """Return random periods, `share` of all but the first two."""
        rows = np.flatnonzero(self.chance.random(self.count) < share)
        return rows[rows >= 2]

    def at(self, row: int, action: Action) -> None:
        """Apply `action` to the arm just before period `row`."""
        self.actions.setdefault(row, []).append(action)

    def set_bits(self, rows: Rows, fault: str, *, mark: bool = False) -> None:
        """Set the bit of a fault in the kernel's fault word; mark the periods as bad."""
        column = self.inputs[:, columns.FAULT_BITS]
        # Several faults may occur in one period; the column holds a bit mask as a real.
        column[rows] = column[rows].astype(int) | FAULTS[fault][0]
        self.marks[rows] |= mark


# --- the run --------------------------------------------------------------------------


def end_of(run: Run) -> tuple[str, str]:
    """Return the law's last mode and reason in words."""
    return MODES[run.mode[-1]], REASONS[run.reason[-1]]


def execute(trial: FaultTrial) -> tuple[Run, bytes]:
    """Run a trial on the twin; return the run, with the reference as it was without the
    fault, and the law's memory at its end.
    """
    arm = ArmState(trial.twin, trial.period, trial.state, start_angle=trial.start_angle)
    actions: Mapping[int, Sequence[Action]] = trial.actions
    steps = None
    if trial.shifts is not None:
        # A period lasts from one sampling instant to the next. The arm has exact steps of
        # 1 ms, so an early sample is a period with fewer steps, and every period is a
        # separate call.
        steps = arm.count + np.diff(trial.shifts, append=0)
        actions = {row: actions.get(row, ()) for row in range(trial.count)}

    def part(first: int, last: int) -> Real:
        if steps is not None:
            arm.rig[0] = steps[first]
        return arm.run(
            trial.block, trial.inputs[first:last], single=trial.real.itemsize == 4
        )

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
