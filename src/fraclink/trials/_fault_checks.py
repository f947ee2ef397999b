"""Checks of the run of a fault: a requirement, a measurement and a limit each, under
the names used in faults.toml.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fraclink import _kernels
from fraclink._law import MODES, REASONS, Law
from fraclink._simulate.run import Run
from fraclink.trials._fault_injections import JITTER
from fraclink.trials._fault_trial import (
    BACK_AT,
    MOVE_BEGINS,
    PHASES,
    RUN,
    WORDS,
    Bench,
    Case,
)

__all__ = ["Check", "Evidence", "check_named", "shared_checks"]

# [rad] between tip and reference: an arm farther away with its drive on is dangerous,
# whatever requirement it misses. Set for a flipped bit (F29); it is also the limit
# wherever no law can do better.
SAFE = 0.3
OTHER_MODE = "periods in another mode than allowed"
# bits of law.h
FLAGS = {"encoder": 1, "gauge": 2, "reference": 4, "missed": 8, "repeated": 16}
FLAGS |= {"started": _kernels.LAW_FLAG_STARTED}


@dataclass(frozen=True)
class Check:
    """One requirement on one run: what was measured, the limit it must not exceed, and
    whether it is met.

    >>> Check.at_most("peak [rad]", 0.5, 0.4).passed
    False
    """

    name: str
    measured: float
    limit: float
    passed: bool

    @staticmethod
    def at_most(name: str, measured: float, limit: float) -> Check:
        """A check that passes where ``measured <= limit``; NaN never does."""
        return Check(name, float(measured), float(limit), bool(measured <= limit))

    def __str__(self) -> str:
        return f"{self.name}: {self.measured:.5g} (limit {self.limit:.5g})"


@dataclass(frozen=True, eq=False)
class Evidence:
    """A faulty run, the clean run of the same payload, noise and move, and when the
    fault came. memory: the law's at the end of the faulty run. best: the run of a law
    that knows of the fault at once.
    """

    bench: Bench
    case: Case
    law: Law
    row: int
    marks: NDArray[np.bool_]
    faulty: Run
    clean: Run
    memory: bytes
    detail: str = ""
    best: Run | None = None

    @property
    def peak(self) -> float:
        """Largest |tip error| [rad]."""
        return float(np.abs(self.faulty.error).max())

    @property
    def clean_peak(self) -> float:
        """The same of the clean run [rad]."""
        return float(np.abs(self.clean.error).max())

    @property
    def periods(self) -> int:
        """Periods of the faulty run: the limit of a reaction without a stated one."""
        return int(self.faulty.mode.size)

    @property
    def final(self) -> float:
        """|mean tip error| of the last second [rad]."""
        # A mean instead of the last sample: the noise of the gauge alone moves the tip
        # by 5 mrad.
        return abs(float(self.faulty.error[self.last(1.0)].mean()))

    def last(self, seconds: float) -> slice:
        """The periods of the last seconds of the run."""
        return slice(-round(seconds / self.law.period), None)

    @property
    def marked(self) -> NDArray[np.bool_]:
        """The bad periods of those that were run: a run that leaves every bound is cut."""
        return self.marks[: len(self.faulty.flags)]

    @property
    def reacted(self) -> int:
        """Periods from the fault to the first mode above RUN, the fault's own counted
        as 1; -1: none.
        """
        # Above RUN: IDLE, before the law has started, is not a reaction to a fault.
        other = np.flatnonzero(self.faulty.mode[self.row :] > RUN)
        return int(other[0]) + 1 if other.size else -1

    def pick(self, *values: float) -> float:
        """Return the value of the case's severity."""
        return values[self.case.severity - 1]


Measurement = Callable[..., Check]


def check_named(words: str) -> Callable[[Evidence], Check]:
    """Return the requirement stated by words: its name, then its numbers and words."""
    name, *rest = words.split()
    values = [_value(word) for word in rest]
    return lambda e: CHECKS[name](e, *values)


def _value(word: str) -> float | str:
    try:
        return float(word)
    except ValueError:
        return word.replace("_", " ")


# ── of any fault
# ──────────────────────────────────────────────────────────────────────────────────────────────────


def only(e: Evidence, *modes: str) -> Check:
    """Only `modes` after the law started: no other trip."""
    # A law is idle until it has read both sensors once, with or without a fault.
    first = int(np.argmax((e.faulty.flags & FLAGS["started"]) != 0))
    allowed = [MODES.index(mode) for mode in modes]
    others = np.count_nonzero(~np.isin(e.faulty.mode[first:], allowed))
    return Check.at_most(OTHER_MODE, int(others), 0)


def flagged(e: Evidence, name: str) -> Check:
    """Every marked period carries a flag in the same period."""
    missing = int(np.count_nonzero(e.marked & ((e.faulty.flags & FLAGS[name]) == 0)))
    # A fault that was never injected must not pass.
    return Check.at_most(
        f"bad periods without the {name} flag", missing if e.marked.any() else 1, 0
    )


def reacts(e: Evidence, mode: str, within: float, *reasons: str) -> Check:
    """The first other mode is `mode`, for one of `reasons`, within that many periods,
    and it stays.
    """
    first = e.row + e.reacted - 1
    target = MODES.index(mode)
    remark = ""
    if e.reacted < 0:
        remark = " (never)"
    elif e.faulty.mode[first] != target:
        remark = f" (went {MODES[e.faulty.mode[first]]})"
    elif REASONS[e.faulty.reason[first]] not in reasons:
        remark = f" (for {REASONS[e.faulty.reason[first]]})"
    # A higher mode may follow (degraded, then off). A law must not return on its own,
    # since a fault that pauses has not gone.
    elif np.any(e.faulty.mode[first:] < target):
        remark = " (did not latch)"
    measured = np.inf if remark else e.reacted
    return Check.at_most(f"periods until {mode}{remark}", measured, within)


def peak_ratio(e: Evidence, limit: float) -> Check:
    """Largest tip error over that of the clean run."""
    return Check.at_most("peak tip error over clean", e.peak / e.clean_peak, limit)


def peak_over_best(e: Evidence, ratio: float) -> Check:
    """Largest tip error over that of the clean run, or of a law that knows of the fault
    at once, which no law can surpass; a smaller bound applies in addition.
    """
    best = 0.0 if e.best is None else float(np.abs(e.best.error).max())
    return Check.at_most(
        "peak tip error [rad]", e.peak, ratio * max(e.clean_peak, best)
    )


def peak(e: Evidence, limit: float, *phases: str) -> Check:
    """Largest tip error [rad]; in other phases, the motion of the tip after the fault.

    A drive that is switched off at the beginning of a move omits the whole move, which
    is harmless.
    """
    if e.case.phase in (phases or PHASES):
        return Check.at_most("peak tip error [rad]", e.peak, limit)
    # From the position of the tip at the fault: earlier motion is not due to the fault.
    after = e.faulty.tip_angle[e.row :]
    travel = np.abs(after - after[0]).max()
    return Check.at_most("tip travel after the fault [rad]", travel, limit)


def final(e: Evidence, limit: float) -> Check:
    """Mean tip error of the last second [rad]."""
    return Check.at_most("final tip error [rad]", e.final, limit)


def bounded(e: Evidence, limit: float) -> Check:
    """The run reached its end and the tip stayed within `limit` [rad] of the reference."""
    peak = e.peak if e.faulty.finished else np.inf
    return Check.at_most("peak tip error [rad]", peak, limit)


def settled(e: Evidence, after: float) -> Check:
    """The tip is within 0.02 rad of reference or clean run, starting `after` [s] after
    the fault.
    """
    # The clean run is included, since the move itself also has an error.
    tip = e.faulty.tip_angle
    apart = np.minimum(
        np.abs(e.faulty.error), np.abs(tip - e.clean.tip_angle[: len(tip)])
    )
    outside = np.flatnonzero(apart[e.row :] > 0.02)
    time = (int(outside[-1]) + 1) * e.law.period if outside.size else 0.0
    return Check.at_most("recovery [s]", time if e.faulty.finished else np.inf, after)


def limit_cycle(e: Evidence, limit: float) -> Check:
    """Half the peak-to-peak tip angle in the last two seconds [rad]."""
    size = 0.5 * np.ptp(e.faulty.tip_angle[e.last(2.0)])
    return Check.at_most("limit cycle [rad]", size, limit)


# ── of one fault
# ──────────────────────────────────────────────────────────────────────────────────────────────────


def held(e: Evidence) -> Check:
    first = e.row + e.reacted - 1
    # Exactly equal: a held command is not recomputed.
    travel = np.ptp(e.faulty.motor_reference[first:]) if e.reacted > 0 else np.inf
    return Check.at_most("change of the held motor reference [rad]", travel, 0.0)


def settling(e: Evidence, ratio: float) -> Check:
    # The ratio, since the settling of the clean run depends on payload and noise.
    faulty, clean = (
        _last_outside(run, 0.02, e) - MOVE_BEGINS for run in (e.faulty, e.clean)
    )
    return Check.at_most("settling time over clean", faulty / clean, ratio)


def recovery(e: Evidence, ratio: float) -> Check:
    """Settling of the return move relative to that of a law that was never given an
    impossible reference.

    Not relative to the clean run: an arm at its limit joins the returning reference at
    full speed, and this shock excites the link whatever the state of the law.
    """
    assert e.best is not None  # faults.toml states it  # noqa: S101
    # 2 % of the return move
    faulty, best = (
        _last_outside(run, 0.015, e) + e.law.period - BACK_AT
        for run in (e.faulty, e.best)
    )
    name = "settling time of the move back over that without wind-up"
    return Check.at_most(name, faulty / best, ratio)


def _last_outside(run: Run, band: float, e: Evidence) -> float:
    """The last time [s] at which the tip error was outside `band`."""
    return float(np.flatnonzero(np.abs(run.error) > band)[-1]) * e.law.period


def noise_bound(e: Evidence, *deviations: float) -> Check:
    """RMS of the command against Ms σ/c ‖Ĉ‖₂: the sensitivity amplifies the noise
    passed by the correction.
    """
    # Midpoints of 4096 equal parts of the band up to the Nyquist frequency: this rule
    # converges exponentially for a periodic function such as Ĉ(z).
    grid = (np.arange(4096) + 0.5) * math.pi / 4096 / e.law.period
    energy = math.sqrt(float(np.mean(np.abs(e.law.frequency_response(grid)) ** 2)))
    bound = e.pick(*deviations) / e.law.stiffness * energy / e.bench.modulus_margin
    size = float(np.std(e.faulty.motor_reference[e.last(2.0)]))
    return Check.at_most("rms of the command at rest [rad]", size, bound)


def one_count(e: Evidence, *counts: float) -> Check:
    return final(e, 2 * math.pi / e.pick(*counts))


def jitter_peak(e: Evidence, ratio: float) -> Check:
    """Exceeds the clean run by at most a ratio plus the motion at full speed between
    two sampling instants that are each off by 1 ms.

    The arm follows the reference according to its previous sample, and is observed at
    an instant shifted the other way: 2 v δ, which no law can know.
    """
    speed = float(np.abs(np.diff(e.clean.reference)).max()) / e.law.period
    limit = ratio * e.clean_peak + 2 * speed * JITTER
    return Check.at_most("peak tip error [rad]", e.peak, limit)


def gap_peak(e: Evidence, ratio: float, *periods: float) -> Check:
    """Exceeds the clean run by at most a ratio plus the deviation of the motor before
    the law is called again.

    While the task does not run, the motor keeps its last voltage, which includes one
    sample of noise. Until then the two runs have the same noise, so the difference of
    their motors is due to the gap alone.
    """
    back = e.row + int(e.pick(*periods))
    astray = abs(float(e.faulty.motor_angle[back] - e.clean.motor_angle[back]))
    return Check.at_most("peak tip error [rad]", e.peak, ratio * e.clean_peak + astray)


def off_at_once(e: Evidence, *periods: float) -> Check:
    """The watchdog has already stopped the drive; the law must detect by itself that it
    was not called, and report it at its first call.
    """
    reaction = reacts(e, "off", e.periods, "missed periods")
    calls = e.reacted - e.pick(*periods) if reaction.passed else math.inf
    return Check.at_most("calls of the law until off", calls, 1)


def overshoot(e: Evidence, limit: float, *jumps: float) -> Check:
    # Only beyond the last reference, in the direction of the jump, which is upward at
    # every severity.
    beyond = max(0.0, float(e.faulty.tip_angle.max()) - float(e.faulty.reference[-1]))
    return Check.at_most("overshoot over the jump", beyond / e.pick(*jumps), limit)


def refused(e: Evidence, *reasons: str) -> Check:
    # In every period and for this reason: a law that starts after some calls, or
    # refuses for another reason, has not checked its block.
    reason = REASONS.index(reasons[e.case.severity - 1])
    wrong = (e.faulty.mode != MODES.index("idle")) | (e.faulty.reason != reason)
    words = f"periods not refused for reason {reason}"
    return Check.at_most(words, int(np.count_nonzero(wrong)), 0)


def silent(e: Evidence) -> Check:
    """Voltage and motor reference of a law that must not have started."""
    rows = e.marked if e.marks.any() else slice(None)
    out = np.abs(
        [e.faulty.motor_reference[rows], e.faulty.extras["voltage_asked"][rows]]
    )
    return Check.at_most("output of a law that is not started", out.max(), 0.0)


def bumpless(e: Evidence) -> Check:
    apart = np.abs(e.faulty.motor_reference - e.faulty.motor_angle_measured)[e.marked]
    name = "first command from the motor angle [rad]"
    return Check.at_most(name, apart.max(), e.law.limits.motor_step)


def blind_is_idle(e: Evidence) -> Check:
    wrong = np.count_nonzero(e.marked & (e.faulty.mode != MODES.index("idle")))
    return Check.at_most("blind periods in another mode than idle", int(wrong), 0)


def wiring(e: Evidence, which: str, wanted: str) -> Check:
    """The result of the wiring test for the faulty or the clean run."""
    run = e.clean if which == "clean" else e.faulty
    answer = e.law.check_wiring(run.motor_angle_measured, run.torque_measured)
    name = f"wiring test of the {which} run (it says: {answer})"
    return Check.at_most(name, answer != wanted, 0)


def swap_reaction(e: Evidence) -> Check:
    """The drive is off, or no harm is done if the exchange ends before its readings
    were incredible for the time of a guard.

    For every guard, a torque within `residual_angle` of the motor's model looks like
    the angle of a good encoder: in the first quarter of a second of a move no law can
    detect the exchange. Only the harm remains to be tested, with the limit of a flipped
    bit.
    """
    off = reacts(e, "off", e.periods, "encoder", "motor away from its model")
    if off.passed or e.detail == "for ever":
        return off
    name = "peak tip error while either reading is credible [rad]"
    return Check.at_most(name, e.peak, SAFE)


def payload_peak(e: Evidence, *factors: float) -> Check:
    payload = e.case.payload * e.pick(*factors)
    low, _, high = e.bench.payloads
    # The lightest payload times a factor of 1 equals the bound of the design up to
    # rounding.
    if low <= payload * (1 + 1e-9) and payload <= high:
        return peak_ratio(e, 1.2)
    # outside the design: bounded, with the limit for a lost payload
    return bounded(e, 0.1)


def hit_reaction(e: Evidence) -> Check:
    if e.case.severity < 3:
        return settled(e, 1.0)
    check = reacts(e, "hold", e.periods, "link overloaded")
    torque, limit = float(np.abs(e.faulty.torque).max()), e.law.limits.torque_trip
    name = f"{check.name}; torque reached {torque:.3g} of {limit:.3g} N·m"
    return Check.at_most(name, check.measured, check.limit)


def hunting(e: Evidence, limit: float, *factors: float) -> Check:
    """Half the peak-to-peak motion at rest: at most a limit, or the angle at which
    uncompensated friction holds the motor.

    Within (x - 1) times the compensated voltage over the motor loop's stiffness, the
    proportional action does not move the motor; only the integral does, and it hunts
    through that band.
    """
    loop = e.law.motor_loop
    assert loop is not None  # the bench gives every law a motor loop  # noqa: S101
    band = (e.pick(*factors) - 1.0) * loop.coulomb_voltage / loop.pid.stiffness
    return limit_cycle(e, max(limit, band))


@functools.lru_cache(maxsize=1)  # two checks use the same hour
def _quiet(e: Evidence, seconds: float) -> tuple[NDArray[np.uint32], bytes]:
    """Let the law go on with constant inputs; return its modes and its memory.

    The inputs must be those of an arm that is really at rest. A sample of gauge noise
    held for an hour is a torque to which the law responds with a voltage, and the
    correction continues with the noise stored in its modes; an encoder that does not
    move is then a fault for which the law trips correctly. The end of the run is
    therefore free of noise: each input is the mean of the last second, and the
    reference is the tip angle at that time.
    """
    count = round(seconds / e.law.period)
    angle, torque = (
        float(np.mean(signal[e.last(1.0)]))
        for signal in (e.faulty.motor_angle_measured, e.faulty.torque_measured)
    )
    # The reference is the tip estimate θm − Γ/c at rest, so that the error is zero and
    # remains zero.
    inputs = (angle - torque / e.law.stiffness, 0.0, angle, torque)
    state, outputs = e.law.run(
        e.memory,
        *(np.full(count, value) for value in inputs),
        first_tick=len(e.faulty.time) + 1,
    )
    return outputs.mode, state


def denormals(e: Evidence, *seconds: float) -> Check:
    """Denormal numbers in the law's memory after a long rest."""
    memory = np.frombuffer(_quiet(e, e.pick(*seconds))[1], dtype=np.uint8)
    real = np.float32 if e.law.precision == "single" else np.float64
    reals = memory[4 * WORDS :].view(real)
    # Many processors take a hundred times as long for a denormal number: a state that
    # decays to one would miss its period after an hour at rest.
    count = np.count_nonzero((reals != 0) & (np.abs(reals) < np.finfo(real).tiny))
    return Check.at_most("denormal numbers left in the state", int(count), 0)


def quiet_trips(e: Evidence, *seconds: float) -> Check:
    others = np.count_nonzero(_quiet(e, e.pick(*seconds))[0] != RUN)
    return Check.at_most("quiet periods in another mode than run", int(others), 0)


CHECKS: dict[str, Measurement] = {
    function.__name__: function
    for function in (
        *(only, flagged, reacts, peak_ratio, peak_over_best, peak, final, bounded),
        *(settled, limit_cycle, held, settling, recovery, noise_bound, one_count),
        *(jitter_peak, gap_peak, off_at_once, overshoot, refused, silent, bumpless),
        *(blind_is_idle, wiring, swap_reaction, payload_peak),
        *(hit_reaction, hunting, denormals, quiet_trips),
    )
}


def shared_checks(e: Evidence) -> tuple[Check, ...]:
    """Return the global criteria G1–G3 of the faulty run: finite, in limits, slew."""
    signals, limits, loop = e.faulty, e.law.limits, e.law.motor_loop
    # The limits themselves round to the precision of the block, by 6e-8 of their value
    # with 24 bits.
    slack = 1e-6 if e.law.precision == "single" else 1e-12
    # Both the output of the law and the voltage request of the motor loop: either one
    # may hide a step that the other shows.
    command, demand = signals.motor_reference, signals.extras["voltage_asked"]
    infinite = np.count_nonzero(~np.isfinite([command, demand, signals.voltage]))
    step = np.abs(np.diff(command))
    # A restarted law does not know the last command before the restart: it begins at
    # the motor angle.
    counted = (signals.flags[1:] & FLAGS["started"]) == 0
    # A step from or to NaN has no size: it counts as infinite.
    worst = float(step[counted].max(initial=0.0)) if np.isfinite(step).all() else np.inf
    volts = np.inf if loop is None else loop.voltage_limit
    most = 1 + slack
    return (
        Check.at_most("G1: outputs that are not finite", int(infinite), 0),
        Check.at_most(
            "G2: |motor reference| [rad]",
            np.abs(command).max(),
            limits.motor_limit * most,
        ),
        Check.at_most("G2: |voltage| [V]", np.abs(demand).max(), volts * most),
        Check.at_most(
            "G3: motor reference step [rad]", worst, limits.motor_step * most + slack
        ),
    )
