"""F01–F15, F17–F19: faults of encoder and gauge."""

from __future__ import annotations

import math

import numpy as np

from fraclink._campaign.faults import evidence as need
from fraclink._campaign.faults.evidence import DEGRADED, OFF, RUN, Evidence
from fraclink._campaign.faults.inject import (
    FROZEN_ENCODER,
    FROZEN_GAUGE,
    add_fault,
    bad_samples,
    freeze,
    sprinkled,
)
from fraclink._campaign.faults.nouns import Check, Fault
from fraclink._campaign.faults.trial import Trial
from fraclink._simulate.kernel import GAUGE_ERROR, GAUGE_GAIN

__all__ = ["SENSORS"]

BAD_ENCODER, BAD_GAUGE, GAUGE_STUCK, RESIDUAL = 5, 6, 7, 8  # reasons of law.h
EVER = 1e6  # [s]
RIDES = (need.only(RUN), need.peak_ratio(1.1))


def _single(sensor: str, *values: float) -> Fault:
    """One bad sample; the harder severities repeat it, always with good ones in between."""
    name = "NaN" if math.isnan(values[0]) else "±Inf"

    def inject(trial: Trial) -> None:
        every = (0, 25, 5)[trial.severity - 1]
        rows = np.array([trial.row]) if not every else np.arange(trial.row, trial.row + 250, every)
        bad_samples(trial, sensor, np.resize(values, rows.size), rows)

    bit = need.ENCODER if sensor == "encoder" else need.GAUGE
    return Fault(
        {"encoder": "F01", "gauge": "F02" if name == "NaN" else "F05"}[sensor],
        f"{name} from the {sensor}, one sample",
        f"sample = {name}",
        "A: flag in the same sample, peak <= 1.1 x clean",
        ("one sample", "one in 25 for 1 s", "one in 5 for 1 s"),
        "A",
        inject,
        (need.flagged(bit, sensor), *RIDES),
    )


def _three(trial: Trial) -> None:
    count = int(trial.pick(2, 3, 4))
    bad_samples(trial, "encoder", math.nan, slice(trial.row, trial.row + count))


def _both(trial: Trial) -> None:
    for sensor in ("encoder", "gauge"):
        bad_samples(trial, sensor, math.nan, trial.rows(trial.pick(0.02, 0.1, EVER)))


def _held(e: Evidence) -> Check:
    first = e.row + e.reacted - 1
    moved = np.ptp(e.faulty.command[first:]) if e.reacted > 0 else np.inf
    return Check.at_most("change of the held motor reference [rad]", moved, 0.0)


def _settling(e: Evidence) -> Check:
    def time(error: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> float:
        return float(np.flatnonzero(np.abs(error) > 0.02)[-1]) * e.law.period - 1.0  # the move begins at 1 s

    return Check.at_most("settling time over clean", time(e.faulty.error) / time(e.clean.error), 1.02)


def _noise_bound(e: Evidence) -> Check:
    """rms of the command against Ms σ/c ‖Ĉ‖₂: the sensitivity amplifies what the correction passes."""
    sigma = (0.02, 0.05, 0.1)[e.case.severity - 1]
    grid = (np.arange(4096) + 0.5) * math.pi / 4096 / e.law.period
    energy = math.sqrt(float(np.mean(np.abs(e.law.frequency_response(grid)) ** 2)))
    bound = sigma / e.law.stiffness * energy / e.bench.modulus_margin
    last = e.faulty.command[-round(2.0 / e.law.period) :]
    return Check.at_most("rms of the command at rest [rad]", float(np.std(last)), bound)


def _noise(trial: Trial) -> None:
    sigma = trial.pick(0.02, 0.05, 0.1)
    trial.inputs[:, GAUGE_ERROR] = sigma * trial.chance.standard_normal(trial.count)


def _spikes(trial: Trial) -> None:
    rows = sprinkled(trial, trial.pick(0.0025, 0.005, 0.01))
    rows = rows[rows >= trial.row]
    rows = rows if rows.size else np.array([trial.row])
    trial.inputs[rows, GAUGE_ERROR] += 3.0 * trial.chance.choice((-1.0, 1.0), rows.size)
    trial.marks[rows] = True


def _offset(trial: Trial) -> None:
    trial.inputs[trial.row :, GAUGE_ERROR] += trial.pick(0.025, 0.05, 0.1)


def _offset_fault(number: str, title: str, when: str, within: str, phase: str, duration: float) -> Fault:
    """An offset of the gauge, which Ĉ(1) = 0 must reject exactly whenever it comes."""
    return Fault(
        number,
        title,
        f"+0.025, +0.05, +0.1 N·m {when}",
        f"final <= 1e-3 rad{within}",
        ("0.025 N·m", "0.05 N·m", "0.1 N·m"),
        "-",
        _offset,
        (need.only(RUN), need.final(1e-3)),
        phases=(phase,),
        duration=duration,
    )


def _drift(trial: Trial) -> None:
    time = trial.period * np.arange(trial.count - trial.row)
    trial.inputs[trial.row :, GAUGE_ERROR] += trial.pick(0.005, 0.01, 0.02) * time


def _dropped(trial: Trial) -> None:
    add_fault(trial, sprinkled(trial, trial.pick(0.01, 0.05, 0.2)), FROZEN_ENCODER | FROZEN_GAUGE)


def _coarse(trial: Trial) -> None:
    quantum = 2 * math.pi / trial.pick(8000, 4000, 2000)
    trial.at(0, lambda arm: arm.rig.__setitem__(7, quantum))


def _one_count(e: Evidence) -> Check:
    counts = (8000, 4000, 2000)[e.case.severity - 1]
    return Check.at_most("final tip error [rad]", e.final, 2 * math.pi / counts)


def _gain(trial: Trial) -> None:
    trial.inputs[trial.row :, GAUGE_GAIN] = trial.pick(1.05, 1.1, 0.9)


def _stuck(trial: Trial, bits: int, *seconds: float) -> None:
    freeze(trial, bits, trial.rows(trial.pick(*seconds)))


def _rail(trial: Trial) -> None:
    bad_samples(trial, "gauge", trial.pick(4.1, -4.1, 40.0), trial.rows(EVER))


def _saturated(trial: Trial) -> None:
    bad_samples(trial, "gauge", trial.pick(2.0, 3.9, -3.9), trial.rows(trial.pick(0.04, 0.04, 0.2)))


SENSORS: tuple[Fault, ...] = (
    _single("encoder", math.nan),
    _single("gauge", math.nan),
    Fault(
        "F03",
        "NaN from the encoder, several in a row",
        "2, 3, 4 samples = NaN",
        "A: flag in the same sample, peak <= 1.1 x clean",
        ("2 in a row", "3 in a row", "4 in a row"),
        "A",
        _three,
        (need.flagged(need.ENCODER, "encoder"), *RIDES),
    ),
    Fault(
        "F04",
        "NaN from both sensors",
        "both samples = NaN for 20 ms, 100 ms, ever",
        "D by sample 5; command held",
        ("20 ms", "100 ms", "for ever"),
        "D",
        _both,
        (need.reacts(OFF, 5, BAD_ENCODER), _held, need.only(RUN, OFF)),
    ),
    _single("gauge", math.inf, -math.inf),
    Fault(
        "F06",
        "dropped samples",
        "1, 5, 20 % of the samples of both sensors repeat the last one",
        "A: peak <= 1.1 x clean, settling + 2 %",
        ("1 %", "5 %", "20 %"),
        "A",
        _dropped,
        (*RIDES, _settling),
        phases=("whole",),
    ),
    Fault(
        "F07",
        "encoder stuck in a move",
        "reading frozen for 0.25 s, 0.5 s, ever",
        "D within 20 samples, peak <= 0.4 rad",
        ("0.25 s", "0.5 s", "for ever"),
        "D",
        lambda trial: _stuck(trial, FROZEN_ENCODER, 0.25, 0.5, EVER),
        (need.reacts(OFF, 20, BAD_ENCODER, RESIDUAL), need.peak(0.4, phases=("mid",)), need.only(RUN, OFF)),
        phases=("start", "mid"),
        note="half of the move is left undone: no drive that is switched off stays within 0.4 rad",
    ),
    Fault(
        "F08",
        "encoder stuck at rest",
        "reading frozen without motion for 0.5, 2, 3.5 s",
        "no trip, no harm: peak <= 1.1 x clean",
        ("0.5 s", "2 s", "3.5 s"),
        "A",
        lambda trial: _stuck(trial, FROZEN_ENCODER, 0.5, 2.0, 3.5),
        RIDES,
        phases=("rest",),
        note="the gauge's noise keeps the motor moving, so the freeze is seen, and the drive is switched off",
    ),
    Fault(
        "F09",
        "gauge open circuit",
        "reading at a rail beyond its range, for ever",
        "B within 5 samples; move completes, final <= 0.02 rad",
        ("+4.1 N·m", "-4.1 N·m", "+40 N·m"),
        "B",
        _rail,
        (need.reacts(DEGRADED, 5, BAD_GAUGE), need.final(0.02), need.only(RUN, DEGRADED)),
    ),
    Fault(
        "F10",
        "gauge saturated inside its range",
        "+2.0, +3.9 N·m for 40 ms, -3.9 N·m for 200 ms",
        "B within 5 samples (slew test); final <= 0.02 rad",
        ("+2.0 N·m, 40 ms", "+3.9 N·m, 40 ms", "-3.9 N·m, 200 ms"),
        "B",
        _saturated,
        (need.reacts(DEGRADED, 5, BAD_GAUGE), need.final(0.02), need.only(RUN, DEGRADED)),
    ),
    Fault(
        "F11",
        "gauge stuck",
        "reading frozen for 0.25, 0.5, 1 s",
        "peak <= 1.1 x clean",
        ("0.25 s", "0.5 s", "1 s"),
        "A",
        lambda trial: _stuck(trial, FROZEN_GAUGE, 0.25, 0.5, 1.0),
        (need.only(RUN, DEGRADED), need.peak_ratio(1.1)),
    ),
    _offset_fault("F12", "gauge offset at the start", "from the first sample on", "", "whole", 7.0),
    _offset_fault("F13", "gauge offset step", "at rest", " in 10 s; no trip", "rest", 13.2),
    Fault(
        "F14",
        "gauge drift",
        "0.005, 0.01, 0.02 N·m/s",
        "final <= 5e-3 rad",
        ("0.005 N·m/s", "0.01 N·m/s", "0.02 N·m/s"),
        "-",
        _drift,
        (need.only(RUN), need.final(5e-3)),
    ),
    Fault(
        "F15",
        "gauge gain wrong",
        "gain +5, +10, -10 %",
        "peak <= 1.1 x clean",
        ("+5 %", "+10 %", "-10 %"),
        "-",
        _gain,
        RIDES,
        phases=("whole", "start", "mid", "rest"),
    ),
    Fault(
        "F17",
        "gauge noise",
        "white noise of 0.02, 0.05, 0.1 N·m",
        "no trip; rms of the command at rest within Ms σ/c ‖Ĉ‖₂",
        ("0.02 N·m", "0.05 N·m", "0.1 N·m"),
        "A",
        _noise,
        (need.only(RUN), _noise_bound),
        phases=("whole",),
    ),
    Fault(
        "F18",
        "gauge spikes",
        "±3 N·m on 0.25, 0.5, 1 % of the samples",
        "A: each rejected by the slew test; peak <= 1.05 x clean",
        ("0.25 %", "0.5 %", "1 %"),
        "A",
        _spikes,
        (need.flagged(need.GAUGE, "gauge"), need.only(RUN), need.peak_ratio(1.05)),
    ),
    Fault(
        "F19",
        "coarse encoder",
        "8000, 4000, 2000 counts a turn of the output",
        "final <= 1 count",
        ("8000 counts", "4000 counts", "2000 counts"),
        "-",
        _coarse,
        (need.only(RUN), _one_count),
        phases=("whole",),
    ),
)
