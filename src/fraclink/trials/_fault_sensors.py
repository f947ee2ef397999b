"""Faults of sensors, clock, reference and limits: each injection, and what only it
measures.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from fraclink._arm.reference import Reference, hold, smooth_step
from fraclink._simulate import sensors as columns
from fraclink._simulate.kernel import ArmState
from fraclink.trials._fault_checks import (
    Check,
    Evidence,
)
from fraclink.trials._fault_trial import (
    DEGRADED,
    EVER,
    FROZEN_ENCODER,
    FROZEN_GAUGE,
    MISSED_PERIODS,
    MOVE,
    MOVE_BEGINS,
    OFF,
    TICK_REPEATED,
    Real,
    Trial,
)

JITTER = 1e-3  # [s] by which an instant of sampling is early or late
WATCHDOG = 5  # periods after which a board's watchdog switches the drive off
# A second move after ten seconds of the first: what a wound-up loop would spoil.
BACK_AT = 12.2
THERE_AND_BACK: Reference = MOVE.then(hold(0.0, 10.0)).then(
    smooth_step(-0.75, duration=1.2)
)


# ---- sensors -----------------------------------------------------------------------------------------


def one_bad(sensor: str, *values: float) -> Callable[[Trial], None]:
    """One bad sample; the harder severities repeat it, always with good ones in
    between.
    """

    def inject(trial: Trial) -> None:
        # A second of single bad samples: the law counts those in a row, so that no
        # number of them that lie apart may add up to a trip.
        every = (0, 25, 5)[trial.case.severity - 1]
        rows = np.arange(trial.row, trial.row + (250 if every else 1), every or 1)
        trial.replace_reading(sensor, np.resize(values, rows.size), rows)

    return inject


def three(trial: Trial) -> None:
    trial.replace_reading(
        "encoder", math.nan, slice(trial.row, trial.row + int(trial.pick(2, 3, 4)))
    )


def both(trial: Trial) -> None:
    for sensor in ("encoder", "gauge"):
        trial.replace_reading(sensor, math.nan, trial.rows(trial.pick(0.02, 0.1, EVER)))


def held(e: Evidence) -> Check:
    first = e.row + e.reacted - 1
    # To the bit: a command that is held is not computed again.
    moved = np.ptp(e.faulty.command[first:]) if e.reacted > 0 else np.inf
    return Check.at_most("change of the held motor reference [rad]", moved, 0.0)


def dropped(trial: Trial) -> None:
    trial.set_bits(
        trial.sprinkled(trial.pick(0.01, 0.05, 0.2)), FROZEN_ENCODER | FROZEN_GAUGE
    )


def last_outside(error: Real, band: float, e: Evidence, *, after: int = 0) -> float:
    """When an error was outside `band` for the last time, and `after` periods [s]."""
    return float(np.flatnonzero(np.abs(error) > band)[-1] + after) * e.law.period


def settling(e: Evidence) -> Check:
    # 2 % of the move of 1 rad. The ratio, since the clean run's own settling depends on
    # payload and noise.
    faulty, clean = (
        last_outside(run.error, 0.02, e) - MOVE_BEGINS for run in (e.faulty, e.clean)
    )
    return Check.at_most("settling time over clean", faulty / clean, 1.02)


def stuck(bits: int, *seconds: float) -> Callable[[Trial], None]:
    return lambda trial: trial.set_bits(
        trial.rows(trial.pick(*seconds)), bits, mark=True
    )


def without_gauge(trial: Trial) -> None:
    """Let the law give up its gauge in the very period of the fault."""
    trial.at(
        trial.row, lambda arm: arm.law.__setitem__(slice(4, 8), DEGRADED)
    )  # the mode's four copies


def rail(trial: Trial) -> None:
    trial.replace_reading("gauge", trial.pick(4.1, -4.1, 40.0), trial.rows(EVER))


def saturated(trial: Trial) -> None:
    trial.replace_reading(
        "gauge", trial.pick(2.0, 3.9, -3.9), trial.rows(trial.pick(0.04, 0.04, 0.2))
    )


def offset(trial: Trial) -> None:
    # Up to 0.1 N·m: 64 mrad of apparent bend, which a correction without the zero at z
    # = 1 would leave in the tip.
    trial.inputs[trial.row :, columns.GAUGE_ERROR] += trial.pick(0.025, 0.05, 0.1)


def drift(trial: Trial) -> None:
    time = trial.period * np.arange(trial.count - trial.row)
    trial.inputs[trial.row :, columns.GAUGE_ERROR] += (
        trial.pick(0.005, 0.01, 0.02) * time
    )


def gain(trial: Trial) -> None:
    trial.inputs[trial.row :, columns.GAUGE_GAIN] = trial.pick(1.05, 1.1, 0.9)


def noise(trial: Trial) -> None:
    sigma = trial.pick(0.02, 0.05, 0.1)
    trial.inputs[:, columns.GAUGE_ERROR] = sigma * trial.chance.standard_normal(
        trial.count
    )


def noise_bound(e: Evidence) -> Check:
    """rms of the command against Ms σ/c ‖Ĉ‖₂: the sensitivity amplifies what the
    correction passes.
    """
    # Middles of 4096 equal parts of the band up to Nyquist: the rule that is exact for
    # a periodic function, and Ĉ(z) is one.
    grid = (np.arange(4096) + 0.5) * math.pi / 4096 / e.law.period
    energy = math.sqrt(float(np.mean(np.abs(e.law.frequency_response(grid)) ** 2)))
    bound = e.pick(0.02, 0.05, 0.1) / e.law.stiffness * energy / e.bench.modulus_margin
    last = e.faulty.command[-round(2.0 / e.law.period) :]
    return Check.at_most("rms of the command at rest [rad]", float(np.std(last)), bound)


def spikes(trial: Trial) -> None:
    rows = trial.sprinkled(trial.pick(0.0025, 0.005, 0.01))
    rows = rows[rows >= trial.row]
    # At 0.25 % the 950 periods of rest are without a spike in one draw of eleven, and
    # such a run would pass with nothing shown.
    rows = rows if rows.size else np.array([trial.row])
    trial.inputs[rows, columns.GAUGE_ERROR] += 3.0 * trial.chance.choice(
        (-1.0, 1.0), rows.size
    )
    trial.marks[rows] = True


def coarse(trial: Trial) -> None:
    quantum = 2 * math.pi / trial.pick(8000, 4000, 2000)
    # Number 7 of twin_rig: the angle of an encoder's count.
    trial.at(0, lambda arm: arm.rig.__setitem__(7, quantum))


def one_count(e: Evidence) -> Check:
    return Check.at_most(
        "final tip error [rad]", e.final, 2 * math.pi / e.pick(8000, 4000, 2000)
    )


# ---- clock, reference, limits ------------------------------------------------------------------------


def jitter(trial: Trial) -> None:
    """Move the sampling instants by up to one step of the twin, 1 ms; their mean stays."""
    count = trial.count
    if trial.case.severity == 3:
        shifts = np.resize([1, -1], count)
    else:
        shifts = trial.chance.integers(-1, 2, count)
        if trial.case.severity == 1:
            shifts[trial.chance.random(count) > 0.1] = 0
    # The run has its length, and the mean of the periods stays the law's.
    shifts[0] = shifts[-1] = 0
    trial.shifts = shifts
    # The reference is a table over the task's periods; it is the instant that is late.
    trial.wanted = np.asarray(
        trial.reference.angle(trial.period * np.arange(count) + JITTER * shifts)
    )


def jitter_peak(e: Evidence) -> Check:
    """2 % more than clean, and what two instants of sampling, each off by 1 ms, are
    apart at full speed.

    The arm follows the table of the reference by what it sampled before, and is seen at
    an instant that is off the other way: 2 v δ, which no law can know of.
    """
    speed = float(np.abs(np.diff(e.clean.wanted)).max()) / e.law.period
    return Check.at_most(
        "peak tip error [rad]", e.peak, 1.02 * e.clean_peak + 2 * speed * JITTER
    )


def few_missed(trial: Trial) -> None:
    trial.miss(int(trial.pick(1, 3, 5)))


def gap_peak(e: Evidence) -> Check:
    """10 % more than clean, and what the motor has gone astray by before the law is
    called again.

    While the task does not run, the motor keeps its last voltage, that of one sample of
    noise: up to there the two runs have the same noise, so that the difference of their
    motors is the gap's alone.
    """
    # The first period in which the task runs again.
    back = e.row + int(e.pick(1, 3, 5))
    astray = abs(float(e.faulty.motor[back] - e.clean.motor[back]))
    return Check.at_most("peak tip error [rad]", e.peak, 1.1 * e.clean_peak + astray)


def dead(trial: Trial) -> None:
    trial.miss(int(trial.pick(8, 12, 25)))
    trial.at(trial.row + WATCHDOG, lambda arm: arm.voltage.fill(0.0))


def off_at_once(e: Evidence) -> Check:
    first = e.row + e.reacted - 1
    # The watchdog has already stopped the drive; the law must know by itself that it
    # was away, and say so.
    good = (
        e.reacted > 0
        and e.faulty.mode[first] == OFF
        and e.faulty.reason[first] == MISSED_PERIODS
    )
    return Check.at_most(
        "calls of the law until off",
        e.reacted - e.pick(8, 12, 25) if good else math.inf,
        1,
    )


def repeated(trial: Trial) -> None:
    if trial.case.severity == 3:
        rows = slice(trial.row, trial.row + 3)

        def back(arm: ArmState) -> None:
            arm.counters[1] -= 3

        trial.at(trial.row, back)
    else:
        rows = slice(trial.row, trial.row + int(trial.pick(1, 25, 0)))
        trial.set_bits(rows, TICK_REPEATED)
    # A clock that was set back is followed at once: it is a period behind once, and
    # then as good as any.
    trial.marks[trial.row if trial.case.severity == 3 else rows] = True


def delay(trial: Trial) -> None:
    def later(arm: ArmState) -> None:
        arm.voltage = np.zeros(arm.voltage.size + trial.case.severity)
        arm.rig[1] += trial.case.severity

    trial.at(0, later)


def jump(trial: Trial) -> None:
    trial.inputs[trial.row :, columns.REFERENCE] += trial.pick(0.25, 0.5, 1.0)
    trial.wanted = trial.inputs[:, columns.REFERENCE].copy()
    trial.marks[trial.row] = True


def overshoot(e: Evidence) -> Check:
    # Only beyond the last reference, in the direction of the jump, which is upward at
    # every severity.
    beyond = max(0.0, float(e.faulty.tip.max()) - float(e.faulty.wanted[-1]))
    return Check.at_most(
        "overshoot over the jump", beyond / e.pick(0.25, 0.5, 1.0), 0.2
    )


def bad_reference(trial: Trial) -> None:
    rows = trial.rows(trial.pick(trial.period, 0.1, 0.1))
    trial.inputs[rows, columns.REFERENCE] = trial.pick(math.nan, math.nan, 1e3)
    # The acceleration comes by the same line as the angle: where one is nonsense the
    # other is, too.
    trial.inputs[rows, columns.ACCELERATION] = trial.pick(math.nan, math.nan, 1e6)
    trial.marks[rows] = True


def limited(trial: Trial) -> None:
    limits = replace(trial.law.limits, motor_limit=trial.pick(0.9, 0.7, 0.5))
    trial.use(replace(trial.law, limits=limits))


def asked_for_less(trial: Trial) -> None:
    """Give the law a reference that ends where its motor ends: nothing is left that
    could be wound up.
    """
    limit = trial.law.limits.motor_limit
    beyond = trial.inputs[:, columns.REFERENCE] > limit
    trial.inputs[beyond, columns.REFERENCE] = limit
    trial.inputs[beyond, columns.ACCELERATION] = 0.0


def recovery(e: Evidence) -> Check:
    """Settling of the move back over that of a law that was never asked for more than
    it could give.

    Not over the clean run: whoever stands at the limit joins a reference that comes
    back at full speed, and the blow of that speed rings the link, whatever the law
    remembers.
    """
    assert e.best is not None  # the rule states it  # noqa: S101
    band = 0.015  # 2 % of the move back
    times = (
        last_outside(run.error, band, e, after=1) - BACK_AT
        for run in (e.faulty, e.best)
    )
    name = "settling time of the move back over that without wind-up"
    return Check.at_most(name, next(times) / next(times), 1.2)


def without_noise(trial: Trial) -> None:
    """Leave the gauge's noise out: two peaks of a few hundredths of a radian differ by
    a tenth for it.
    """
    trial.inputs[:, columns.GAUGE_ERROR] = trial.twin.sensors.gauge_offset


def calm_end(trial: Trial) -> None:
    """Leave the gauge's noise out of the last three seconds: a limit cycle goes on
    without it.

    In the last two, which are measured, noise alone moves the tip by up to 5e-3 rad.
    Without a limit cycle the arm comes to rest.
    """
    quiet = trial.inputs[-round(3.0 / trial.period) :]
    quiet[:, columns.GAUGE_ERROR] = trial.twin.sensors.gauge_offset


def slow(trial: Trial) -> None:
    limits = trial.law.limits
    trial.use(
        replace(
            trial.law,
            limits=replace(limits, motor_step=limits.motor_step / trial.pick(3, 5, 10)),
        )
    )
