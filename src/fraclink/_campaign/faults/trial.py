"""One run on the twin before it begins, open to be tampered with; and its execution."""

from __future__ import annotations

import itertools
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.reference import Reference, smooth_step
from fraclink._arm.rig import Rig
from fraclink._campaign.faults.nouns import Case
from fraclink._simulate.kernel import REFERENCE, ArmState, healthy_inputs
from fraclink._simulate.simulate import with_motor_loop
from fraclink._validate import checked_noun
from fraclink.errors import FieldError

if TYPE_CHECKING:
    from fraclink._design import Design
    from fraclink._law import Law
    from fraclink._simulate import Twin

__all__ = ["MOVE", "TIMES", "Bench", "Signals", "Trial", "execute"]

Real = NDArray[np.float64]
Counts = NDArray[np.uint32]
Action = Callable[[ArmState], None]

MOVE = smooth_step(1.0, duration=1.2, start=1.0)  # the catalogue's move: 1 rad, 1.0 to 2.2 s
TIMES = {"whole": 0.0, "start": 1.1, "mid": 1.6, "rest": 3.2}  # [s]


@dataclass(frozen=True)
class Bench:
    """What is tested: the law, the twin it runs on, the rig, the payloads (low, nominal, high) [kg].

    modulus_margin: least |1 + L| of the true sampled loop over the payloads, for the bound on noise.
    """

    rig: Rig
    law: Law
    twin: Twin
    payloads: tuple[float, float, float]
    modulus_margin: float

    @staticmethod
    def of(design: Design, rig: Rig | None = None, *, link_mass: float | None = None) -> Bench:
        """Return the bench of a design on `rig` (default: its own), with its shipped law and motor loop."""
        from fraclink._design import Design
        from fraclink._simulate import Twin

        checked_noun("plan", design, Design, remedy="fl.design makes one")
        arm = design.rig if rig is None else rig
        checked_noun("rig", arm, Rig, remedy="Rig.named or Rig.load make one")
        twin = Twin.from_rig(arm, link_mass=link_mass)
        law = replace(design, rig=arm).law()
        low, high = design.payloads
        nominal = arm.payloads.nominal
        if not low <= nominal <= high:
            nominal = 0.5 * (low + high)
        margin = min(design.sampled_at(p).modulus_margin for p in (low, high))
        return Bench(arm, with_motor_loop(law, twin=twin)[0], twin, (low, nominal, high), margin)

    def with_law(self, law: Law) -> Bench:
        """Return the same bench for another law; FieldError where its period is not the rig's."""
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
    """A run that is still open: what faults write into. Internal, mutable."""

    def __init__(self, bench: Bench, case: Case, law: Law, reference: Reference, duration: float) -> None:
        self.bench, self.case, self.law, self.reference = bench, case, law, reference
        self.block = law.block
        self.state = law.initial_state()
        self.twin = bench.twin.with_payload(case.payload)
        self.period = law.period
        self.count = round(duration / self.period) + 1
        self.generator = np.random.default_rng([case.seed, 0])
        # The fault's own dice, so that the noise is that of the clean run; the name holds the seed.
        self.chance = np.random.default_rng([case.seed, zlib.crc32(case.name.encode())])
        self.inputs = healthy_inputs(self.twin, reference, self.period, self.count, self.generator)
        self.wanted = self.inputs[:, REFERENCE].copy()
        self.row = round(TIMES[case.phase] / self.period)
        self.marks = np.zeros(self.count, dtype=bool)  # periods in which a sample is bad
        self.actions: dict[int, list[Action]] = {}
        self.start_angle = float(self.wanted[0])
        self.detail = ""  # what chance chose
        self.shifts: NDArray[np.int_] | None = None  # of each sampling instant [ms-steps]

    @property
    def severity(self) -> int:
        """Severity of the case, 1 … 3."""
        return self.case.severity

    def pick(self, *values: float) -> float:
        """Return the value of the case's severity."""
        return values[self.case.severity - 1]

    def rows(self, seconds: float) -> slice:
        """Return the periods from the fault on for `seconds`; a slice of at least one."""
        return slice(self.row, self.row + max(1, round(seconds / self.period)))

    def at(self, row: int, action: Action) -> None:
        """Do `action` to the vessel just before period `row`."""
        self.actions.setdefault(row, []).append(action)

    def use(self, law: Law) -> None:
        """Run another law from the first period on."""
        self.law, self.block, self.state = law, law.block, law.initial_state()


@dataclass(frozen=True, eq=False)
class Signals:
    """One value per control period of a run; units as in `Run`. `law_state`: the law's memory at the
    end.
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

    @property
    def error(self) -> Real:
        """Tip angle minus reference [rad]."""
        return np.asarray(self.tip - self.wanted)


def execute(trial: Trial) -> Signals:
    """Run a trial on the twin."""
    arm = ArmState(trial.twin, trial.period, trial.state, start_angle=trial.start_angle)
    single = trial.law.precision == "single"
    steps = None
    if trial.shifts is not None:
        steps = arm.count + np.diff(trial.shifts, append=0)
    edges = sorted({0, trial.count, *(k for k in trial.actions if 0 <= k < trial.count)})
    if steps is not None:
        edges = list(range(trial.count + 1))
    records: list[Real] = []
    for first, last in itertools.pairwise(edges):
        for action in trial.actions.get(first, ()):
            action(arm)
        if steps is not None:
            arm.rig[0] = steps[first]
        records.append(arm.run(trial.block, trial.inputs[first:last], single=single))
        if len(records[-1]) < last - first:
            break
    return _signals(np.vstack(records), trial, arm)


def _signals(record: Real, trial: Trial, arm: ArmState) -> Signals:
    columns: list[Real] = [np.ascontiguousarray(column, dtype=np.float64) for column in record.T]
    count = len(record)
    time: Real = trial.period * np.arange(count, dtype=np.float64)
    wanted = trial.wanted[:count].copy()
    mode, reason, flags = (column.astype(np.uint32) for column in columns[9:12])
    for array in (*columns, time, wanted):
        array.flags.writeable = False
    for counts in (mode, reason, flags):
        counts.flags.writeable = False
    _, motor, tip, torque, encoder, gauge, command, voltage, asked = columns[:9]
    return Signals(
        time=time,
        wanted=wanted,
        tip=tip,
        motor=motor,
        torque=torque,
        encoder=encoder,
        gauge=gauge,
        command=command,
        voltage=voltage,
        asked=asked,
        mode=mode,
        reason=reason,
        flags=flags,
        law_state=arm.law.tobytes(),
        finished=count == trial.count,
    )
