"""Clean running for long: what the guards must not do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fraclink import _kernels
from fraclink._arm.reference import hold, smooth_step
from fraclink._campaign.faults.trial import Bench
from fraclink._simulate.kernel import GAUGE_ERROR, ArmState, healthy_inputs
from fraclink._validate import checked_noun, checked_whole

__all__ = ["Soak", "soak"]

ROUND = smooth_step(1.0, duration=1.2).then(hold(0.0, 0.8)).then(smooth_step(-1.0, duration=1.2))
ROUND_TIME = 4.0  # [s]: 0.8 s of rest at either end
CHUNK = 100  # rounds at once: 9 MB of inputs


@dataclass(frozen=True)
class Soak:
    """Clean periods, those in another mode than RUN, those with a flag, and the largest tip error [rad]."""

    periods: int
    trips: int
    flagged: int
    peak: float


def soak(bench: Bench, payload: float, *, periods: int = 1_000_000, seed: int = 1) -> Soak:
    """Move the healthy arm to and fro by 1 rad for `periods` control periods and count what the law says.

    payload [kg] > 0. The gauge has the rig's noise, offset and quantum. Raises FieldError for a count below
    1.
    """
    checked_noun("bench", bench, Bench, remedy="Bench.of(design) makes one")
    checked_whole("periods", periods, 1, 10**12)
    checked_whole("seed", seed, 0, 2**64 - 1)
    law = bench.law
    twin = bench.twin.with_payload(payload)
    generator = np.random.default_rng(seed)
    rounds = healthy_inputs(twin, ROUND, law.period, round(ROUND_TIME / law.period), generator)
    arm = ArmState(twin, law.period, law.initial_state())
    trips = flagged = done = 0
    peak = 0.0
    while done < periods:
        inputs = np.tile(rounds, (CHUNK, 1))[: periods - done]
        noise = twin.sensors.gauge_noise * generator.standard_normal(len(inputs))
        inputs[:, GAUGE_ERROR] = twin.sensors.gauge_offset + noise
        record = arm.run(law.block, inputs, single=law.precision == "single")
        flags = record[:, 11].astype(int)
        trips += int(np.count_nonzero(record[:, 9] != 1))
        flagged += int(np.count_nonzero(flags & ~_kernels.LAW_FLAG_STARTED))
        peak = max(peak, float(np.abs(record[:, 2] - record[:, 0]).max()))
        done += len(record)
        if len(record) < len(inputs):
            return Soak(done, trips + periods - done, flagged, peak)
    return Soak(done, trips, flagged, peak)
