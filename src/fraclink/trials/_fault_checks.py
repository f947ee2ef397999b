"""Checks of a faulty run, each with a measurement and its limit, under the names used
in faults.toml.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, SupportsFloat

import numpy as np
from numpy.typing import NDArray

from fraclink._law import MODES, REASONS
from fraclink._simulate.run import Run
from fraclink.trials._fault_trial import MEMORY_WORDS, RUN, FaultTrial
from fracsys.checks import Mask

__all__ = ["CHECKS", "Check", "Evidence", "shared_checks"]

OTHER_MODE = "periods in another mode than allowed"
# in the order of their bits in law.h
FLAGS = (
    *("encoder", "gauge", "reference", "missed", "repeated"),
    *("limited", "saturated", "started"),
)


@dataclass(frozen=True)
class Check:
    """One requirement on one run: what was measured, the limit it must not exceed, and
    whether it is met.

    >>> Check("peak [rad]", 0.5, 0.4, passed=False).excess
    1.25
    """

    name: str
    measured: float
    limit: float
    passed: bool

    @property
    def excess(self) -> float:
        """The factor by which the limit is exceeded; a reaction that never came is the
        worst.
        """
        if not math.isfinite(self.measured):
            return math.inf
        return self.measured / self.limit if self.limit > 0 else self.measured

    def __str__(self) -> str:
        return f"{self.name}: {self.measured:.5g} (limit {self.limit:.5g})"


def at_most(name: str, measured: SupportsFloat, limit: SupportsFloat) -> Check:
    """A check that passes where ``measured <= limit``; NaN never does."""
    value, most = float(measured), float(limit)
    return Check(name, value, most, value <= most)


@dataclass(frozen=True, eq=False)
class Evidence:
    """A faulty run, its trial, and the clean run of the same payload, noise and move.

    memory: the law's at the end of the faulty run. best: the run of a law that knows of
    the fault at once.
    """

    trial: FaultTrial
    faulty: Run
    clean: Run
    memory: bytes
    best: Run | None = None

    @property
    def peak(self) -> float:
        """Largest |tip error| [rad]."""
        return self.faulty.metrics.peak_tip_error

    @property
    def clean_peak(self) -> float:
        """The same of the clean run [rad]."""
        return self.clean.metrics.peak_tip_error

    @property
    def final(self) -> float:
        """|mean tip error| of the last second [rad]."""
        # A mean instead of the last sample: the noise of the gauge alone moves the tip
        # by up to a milliradian.
        return abs(float(self.faulty.error[self.last(1.0)].mean()))

    def last(self, seconds: float) -> slice:
        """The periods of the last seconds of the run."""
        return slice(-round(seconds / self.trial.period), None)

    def flags(self, name: str) -> Mask:
        """The periods of the faulty run in which the law raised a flag."""
        bit = 1 << FLAGS.index(name)
        return (self.faulty.flags & bit) != 0

    @property
    def marked(self) -> Mask:
        """The bad periods that were simulated: a run that leaves every bound ends early."""
        return self.trial.marks[: len(self.faulty.flags)]

    @property
    def reacted(self) -> int:
        """Periods from the fault to the first mode above RUN, the fault's own counted
        as 1; -1: none.
        """
        # Above RUN: IDLE, before the law has started, is not a reaction to a fault.
        other = np.flatnonzero(self.faulty.mode[self.trial.row :] > RUN)
        return int(other[0]) + 1 if other.size else -1


# --- of the law's modes and flags -----------------------------------------------------


def only(e: Evidence, *modes: str) -> Check:
    """Only `modes` after the law started: no other trip."""
    # A law is idle until it has read both sensors once, with or without a fault.
    first = np.argmax(e.flags("started"))
    allowed = [MODES.index(mode) for mode in modes]
    others = np.count_nonzero(~np.isin(e.faulty.mode[first:], allowed))
    return at_most(OTHER_MODE, others, 0)


def flagged(e: Evidence, by: str) -> Check:
    """Every marked period carries a flag in the same period."""
    return at_most(
        f"bad periods without the {by} flag",
        # A fault that was never injected must not pass.
        np.count_nonzero(e.marked & ~e.flags(by)) if e.marked.any() else 1,
        0,
    )


def reacts(
    e: Evidence, mode: str, reason: str, within: float = 0.0, harmless: float = 0.0
) -> Check:
    """The first mode above run is `mode`, for one of the reasons, after at most `within`
    periods (0: at any time), and it latches; or the peak tip error is at most `harmless`
    [rad].
    """
    first = e.trial.row + e.reacted - 1
    target = MODES.index(mode)
    remark = ""
    if e.reacted < 0:
        remark = " (never)"
    elif e.faulty.mode[first] != target:
        remark = f" (went {MODES[e.faulty.mode[first]]})"
    elif REASONS[e.faulty.reason[first]] not in reason.split(" or "):
        remark = f" (for {REASONS[e.faulty.reason[first]]})"
    # A higher mode may follow (degraded, then off). A law must not return on its own,
    # since a fault that pauses has not gone.
    elif np.any(e.faulty.mode[first:] < target):
        remark = " (did not latch)"
    measured = np.inf if remark else e.reacted
    reaction = at_most(
        f"periods until {mode}{remark}", measured, within or e.faulty.mode.size
    )
    if reaction.passed or not harmless:
        return reaction
    return at_most("peak tip error without reaction [rad]", e.peak, harmless)


def idle(e: Evidence, reason: str = "") -> Check:
    """The law is idle in every marked period, or in all where none is marked."""
    # A law that is idle for another reason has not found the damage in its block.
    wrong = e.faulty.mode != MODES.index("idle")
    if reason:
        wrong |= e.faulty.reason != REASONS.index(reason)
    words = f"periods not idle{' for ' if reason else ''}{reason}"
    return at_most(words, np.count_nonzero(wrong[_judged(e)]), 0)


def silent(e: Evidence) -> Check:
    """A law that must not have started outputs no voltage and no motor reference."""
    outputs = np.abs([e.faulty.motor_reference, e.faulty.extras["voltage_asked"]])
    largest = outputs[:, _judged(e)].max()
    return at_most("output of a law that is not started", largest, 0.0)


def _judged(e: Evidence) -> Mask:
    """The marked periods, or all where none is."""
    return e.marked if e.marked.any() else np.ones_like(e.marked)


def held(e: Evidence) -> Check:
    """The motor reference does not change after the reaction."""
    first = e.trial.row + e.reacted - 1
    # Exactly equal: a held command is not recomputed.
    travel = np.ptp(e.faulty.motor_reference[first:]) if e.reacted > 0 else np.inf
    return at_most("change of the held motor reference [rad]", travel, 0.0)


def bumpless(e: Evidence) -> Check:
    """The first command after a restart is within one step of the motor angle."""
    apart = np.abs(e.faulty.motor_reference - e.faulty.motor_angle_measured)[e.marked]
    name = "first command from the motor angle [rad]"
    return at_most(name, apart.max(), e.trial.law.limits.motor_step)


def wiring(e: Evidence, run: Literal["faulty", "clean"], answer: str) -> Check:
    """The result of the wiring test for the faulty or the clean run."""
    test: Run = getattr(e, run)
    result = e.trial.law.check_wiring(test.motor_angle_measured, test.torque_measured)
    name = f"wiring test of the {run} run (it says: {result})"
    return at_most(name, result != answer, 0)


# --- of the tip -----------------------------------------------------------------------


def peak(
    e: Evidence,
    *,
    ratio: float = 0.0,
    limit: float = 0.0,
    late: float = 0.0,
    outside: float = 0.0,
) -> Check:
    """Largest tip error against `limit` [rad], or `ratio` times that of the clean run or
    of a law that knows of the fault at once, whichever is larger.

    Two errors that no law can avoid are allowed in addition: the deviation of the motor
    angle from the clean run in the first period in which the law can see the fault,
    since the motor keeps its last voltage, noise included, until then; and, with sampling
    instants that are `late` or early [s], twice that time at full speed, since the
    law's sample and the instant of the judgement may be off in opposite directions. For
    a payload outside the design, `outside` [rad] replaces `limit` and `ratio`.
    """
    if outside and not e.trial.designed_for:
        ratio, limit = 0.0, outside
    best = 0.0 if e.best is None else e.best.metrics.peak_tip_error
    first = np.argmax(e.marked)
    motor = e.faulty.motor_angle[first] - e.clean.motor_angle[first]
    speed = np.abs(np.diff(e.clean.reference)).max() / e.trial.period
    unseen = abs(motor) * e.marked[first] + 2 * speed * late
    error = e.peak if e.faulty.finished else np.inf
    known = ratio * max(e.clean_peak, best)
    return at_most("peak tip error [rad]", error, limit + known + unseen)


def travel(e: Evidence, limit: float) -> Check:
    """Motion of the tip after the fault [rad]: a drive that is switched off at the
    beginning of a move omits the whole move, which is harmless.
    """
    after = e.faulty.tip_angle[e.trial.row :]
    way = np.abs(after - after[0]).max()
    return at_most("tip travel after the fault [rad]", way, limit)


def final(e: Evidence, limit: float) -> Check:
    """Mean tip error of the last second [rad]."""
    return at_most("final tip error [rad]", e.final, limit)


def settled(e: Evidence, within: float) -> Check:
    """The tip is within 0.02 rad of reference or clean run from `within` [s] after the
    fault on.
    """
    # The clean run is included, since the move itself also has an error.
    tip = e.faulty.tip_angle
    apart = np.minimum(
        np.abs(e.faulty.error), np.abs(tip - e.clean.tip_angle[: len(tip)])
    )
    outside = np.flatnonzero(apart[e.trial.row :] > 0.02)
    time = (int(outside[-1]) + 1) * e.trial.period if outside.size else 0.0
    return at_most("recovery [s]", time if e.faulty.finished else np.inf, within)


def settling(e: Evidence, ratio: float) -> Check:
    """Settling time of the last motion, divided by the settling time of a law that knows
    of the fault, or else of the clean run. With any law, the reference comes back into
    the motor's range at full speed, and this shock excites the link.
    """
    wanted = e.trial.wanted
    moving = np.flatnonzero(np.diff(wanted))
    # The last motion begins where the reference last stood still before its end.
    begins = moving[np.flatnonzero(np.diff(moving, prepend=-2) > 1)[-1]]
    band = 0.02 * abs(wanted[-1] - wanted[begins])
    faulty, best = (
        np.flatnonzero(np.abs(run.error) > band)[-1] + 1 - begins
        for run in (e.faulty, e.best or e.clean)
    )
    return at_most("settling time over the best", faulty / best, ratio)


def overshoot(e: Evidence, limit: float) -> Check:
    """Tip beyond the last reference, which jumps upward at every severity [rad]."""
    beyond = max(0.0, float(e.faulty.tip_angle.max()) - float(e.faulty.reference[-1]))
    return at_most("overshoot over the jump [rad]", beyond, limit)


def limit_cycle(e: Evidence, limit: float, friction: float = 1.0) -> Check:
    """Half the peak-to-peak tip angle in the last two seconds [rad]: at most a limit, or
    the angle at which uncompensated friction holds the motor.

    Within (friction - 1) times the compensated voltage over the motor loop's stiffness,
    the proportional action does not move the motor; only the integral does, and it
    hunts through that band.
    """
    loop = e.trial.motor_loop
    band = (friction - 1.0) * loop.coulomb_voltage / loop.pid.stiffness
    size = 0.5 * np.ptp(e.faulty.tip_angle[e.last(2.0)])
    return at_most("limit cycle [rad]", size, max(limit, band))


def noise(e: Evidence, deviation: float) -> Check:
    """RMS of the command against Ms σ/c ‖Ĉ‖₂: the sensitivity amplifies the noise
    passed by the correction.
    """
    law = e.trial.law
    # Midpoints of 4096 equal parts of the band up to the Nyquist frequency: this rule
    # converges exponentially for a periodic function such as Ĉ(z).
    grid = (np.arange(4096) + 0.5) * math.pi / 4096 / law.period
    energy = math.sqrt(np.mean(np.abs(law.frequency_response(grid)) ** 2))
    bound = deviation / law.stiffness * energy / e.trial.bench.modulus_margin
    size = float(np.std(e.faulty.motor_reference[e.last(2.0)]))
    return at_most("rms of the command at rest [rad]", size, bound)


# --- of a long rest -------------------------------------------------------------------


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
    count = round(seconds / e.trial.period)
    angle, torque = (
        float(np.mean(signal[e.last(1.0)]))
        for signal in (e.faulty.motor_angle_measured, e.faulty.torque_measured)
    )
    # The reference is the tip estimate θm − Γ/c at rest, so that the error is zero and
    # remains zero.
    inputs = (angle - torque / e.trial.law.stiffness, 0.0, angle, torque)
    state, outputs = e.trial.law.run(
        e.memory,
        *(np.full(count, value) for value in inputs),
        first_tick=len(e.faulty.time) + 1,
    )
    return outputs.mode, state


def denormals(e: Evidence, seconds: float) -> Check:
    """Denormal numbers in the law's memory after a long rest."""
    memory = np.frombuffer(_quiet(e, seconds)[1], np.uint8)
    reals = memory[MEMORY_WORDS:].view(e.trial.real)
    # Many processors take a hundred times as long for a denormal number: a law whose
    # state decays to one would miss its period after an hour at rest.
    count = np.count_nonzero(
        (reals != 0) & (np.abs(reals) < np.finfo(e.trial.real).tiny)
    )
    return at_most("denormal numbers left in the state", count, 0)


def quiet_trips(e: Evidence, seconds: float) -> Check:
    """Periods of a long rest in another mode than run."""
    others = np.count_nonzero(_quiet(e, seconds)[0] != RUN)
    return at_most("quiet periods in another mode than run", others, 0)


CHECKS: dict[str, Callable[..., Check]] = {
    function.__name__.replace("_", " "): function
    for function in (
        *(flagged, reacts, idle, silent, held, bumpless, wiring),
        *(peak, travel, final, settled, settling, overshoot, limit_cycle, noise),
        *(denormals, quiet_trips),
    )
}


def shared_checks(e: Evidence, *modes: str) -> tuple[Check, ...]:
    """Return the global criteria of the faulty run: G1 finite, G2 within limits, G3
    slew-limited; and that it stays in the modes that its fault allows.
    """
    signals, law = e.faulty, e.trial.law
    limits, volts = law.limits, e.trial.motor_loop.voltage_limit
    # The limits themselves are rounded to the precision of the block, by 6e-8 of their
    # value with 24 bits.
    slack = 1e-6 if law.precision == "single" else 1e-12
    # Both the output of the law and the voltage request of the motor loop: either one
    # may hide a step that the other shows.
    command, demand = signals.motor_reference, signals.extras["voltage_asked"]
    infinite = np.count_nonzero(~np.isfinite([command, demand, signals.voltage]))
    step = np.abs(np.diff(command))
    # A restarted law does not know the last command before the restart: it begins at
    # the motor angle.
    counted = ~e.flags("started")[1:]
    # A step from or to NaN has no size: it counts as infinite.
    worst = float(step[counted].max(initial=0.0)) if np.isfinite(step).all() else np.inf
    most = 1 + slack
    return (
        at_most("G1: outputs that are not finite", infinite, 0),
        at_most(
            "G2: |motor reference| [rad]",
            np.abs(command).max(),
            limits.motor_limit * most,
        ),
        at_most("G2: |voltage| [V]", np.abs(demand).max(), volts * most),
        at_most(
            "G3: motor reference step [rad]", worst, limits.motor_step * most + slack
        ),
        only(e, *modes),
    )
