"""What the law must bear beside the catalogue: clean periods without end, every bit of
its memory.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from fraclink import _kernels
from fraclink._arm.reference import hold, smooth_step
from fraclink._simulate.kernel import ArmState
from fraclink._simulate.sensors import GAUGE_ERROR, healthy_inputs
from fraclink.trials._fault_checks import SAFE
from fraclink.trials._fault_trial import (
    COUNTERS,
    MOVE,
    OFF,
    REALS,
    RUN,
    WORDS,
    Bench,
    Case,
    Phase,
    Trial,
    execute,
)
from fracsys.checks import Between, Payload, Seed, checked

__all__ = ["Soak", "Upset", "soak", "upsets"]

ROUND = (
    smooth_step(1.0, duration=1.2)
    .then(hold(0.0, 0.8))
    .then(smooth_step(-1.0, duration=1.2))
)
ROUND_TIME = 4.0  # [s]: 0.8 s of rest at either end
CHUNK = 100  # rounds at once: 9 MB of inputs
AT_ONCE = 10  # periods in which a drive that does not stay on is off


# ---- clean running for long: what the guards must not do ---------------------------------------------


@dataclass(frozen=True)
class Soak:
    """Clean periods, those in another mode than RUN, those with a flag, and the largest
    tip error [rad].
    """

    periods: int
    trips: int
    flagged: int
    peak: float


@checked
def soak(
    bench: Bench,
    payload: Payload,
    *,
    periods: Annotated[int, Between(1, 10**12)] = 1_000_000,
    seed: Seed = 1,
) -> Soak:
    """Move the healthy arm to and fro by 1 rad for `periods` control periods and count
    what the law says.

    The gauge has the rig's noise, offset and quantum.
    """
    law = bench.law
    twin = bench.twin.with_payload(payload)
    generator = np.random.default_rng(seed)
    # One round of inputs, repeated: a million periods at once would be 100 MB, and only
    # the noise differs.
    rounds = healthy_inputs(
        twin.sensors, ROUND, law.period, round(ROUND_TIME / law.period), generator
    )
    arm = ArmState(twin, law.period, law.initial_state())
    trips = flagged = done = 0
    peak = 0.0
    while done < periods:
        inputs = np.tile(rounds, (CHUNK, 1))[: periods - done]
        noise = twin.sensors.gauge_noise * generator.standard_normal(len(inputs))
        inputs[:, GAUGE_ERROR] = twin.sensors.gauge_offset + noise
        record = arm.run(law.block, inputs, single=law.precision == "single")
        flags = record[:, 11].astype(int)
        trips += int(np.count_nonzero(record[:, 9] != RUN))
        flagged += int(np.count_nonzero(flags & ~_kernels.LAW_FLAG_STARTED))
        peak = max(peak, float(np.abs(record[:, 2] - record[:, 0]).max()))
        done += len(record)
        # The arm has left every bound: what was asked for and not run counts as
        # tripped.
        if len(record) < len(inputs):
            return Soak(done, trips + periods - done, flagged, peak)
    return Soak(done, trips, flagged, peak)


# ---- every bit of the memory -------------------------------------------------------------------------


@dataclass(frozen=True)
class Upset:
    """One bit of the law's memory that was flipped in a move, and what came of it.

    name: of the number that it belongs to; bit: in it, 0 the lowest; peak: largest |tip
    error| from then on [rad]; off: periods until the drive was off, counting the flip's
    own as 1, and 0 where it stayed on.
    """

    name: str
    bit: int
    peak: float
    off: int

    @property
    def passed(self) -> bool:
        """Whether the tip stayed within 0.3 rad of its reference, or the drive was off
        within 10 periods.
        """
        return self.peak <= SAFE or 0 < self.off <= AT_ONCE


@checked
def upsets(
    bench: Bench,
    *,
    payload: Payload = 0.02,
    phase: Phase = "mid",
    names: Sequence[str] = (),
    seed: Annotated[int, Between(0, 2**63 - 1)] = 1,
) -> tuple[Upset, ...]:
    """Flip each bit of the law's memory in a run of its own, in a phase of the
    catalogue's move.

    names: of the numbers of `law_state`, see `law.h`; without them all, the counters as
    well as the reals.

    >>> import fraclink as fl
    >>> from fraclink._simulate import geared
    >>> rig = geared(fl.Rig.named("paper-2023"))
    >>> design = fl.design(
    ...     rig.model, rig, payloads=(0.020, 0.040), gain_crossover=12.0, phase_margin=fl.deg(50)
    ... )
    >>> found = upsets(Bench.of(design, link_mass=0.00735), names=["mode"])
    >>> len(found), all(upset.passed for upset in found)
    (32, True)
    """
    case = Case("F29", 1, payload, phase, seed)
    width = 4 if bench.law.precision == "single" else 8
    # Every word and every real: a memory in which some bits were never tried says
    # nothing of the others.
    wanted = set(names) or {*WORDS, *REALS}
    return tuple(
        _upset(bench, case, *place) for place in _bits(width) if place[0] in wanted
    )


def _bits(width: int) -> Iterator[tuple[str, int, int]]:
    """Name, bit, and place in the memory of each bit of it."""
    for number, name in enumerate((*WORDS, *REALS)):
        words = number < COUNTERS
        first = (
            32 * number if words else 32 * COUNTERS + 8 * width * (number - COUNTERS)
        )
        for bit in range(32 if words else 8 * width):
            yield name, bit, first + bit


def _upset(bench: Bench, case: Case, name: str, bit: int, place: int) -> Upset:
    trial = Trial(bench, case, bench.law, MOVE, 7.0)

    def flip(arm: ArmState) -> None:
        arm.law[place // 8] ^= np.uint8(1 << place % 8)

    trial.at(trial.row, flip)
    run = execute(trial)
    # From the flip on: a law that was off before would be no answer to it.
    off = np.flatnonzero(run.mode[trial.row :] == OFF)
    peak = float(np.abs(run.error[trial.row :]).max()) if run.finished else np.inf
    return Upset(name, bit, peak, int(off[0]) + 1 if off.size else 0)
