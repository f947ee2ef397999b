"""The catalogue: each fault of faults.toml with its injection and the measurement of its requirement."""

from __future__ import annotations

import functools
import math
import struct
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.resources import files
from typing import Literal

import numpy as np

from fraclink._arm.reference import Reference, hold, smooth_step
from fraclink._campaign.fault_trial import (
    BAD_CRC,
    BAD_ENCODER,
    BAD_GAUGE,
    BAD_SIZE,
    BAD_VERSION,
    DEGRADED,
    ENCODER,
    FROZEN_ENCODER,
    FROZEN_GAUGE,
    GAUGE,
    HOLD,
    IDLE,
    MISSED,
    MISSED_PERIODS,
    MOVE,
    OFF,
    OVERLOAD,
    REALS,
    REFERENCE,
    REPEATED,
    RESIDUAL,
    RUN,
    STARTED,
    SWAPPED,
    TICK_MISSED,
    TICK_REPEATED,
    Check,
    Evidence,
    Real,
    Requirement,
    Trial,
    bounded,
    final,
    flagged,
    limit_cycle,
    members,
    only,
    peak,
    peak_ratio,
    reacts,
    settled,
)
from fraclink._files.codec import Storage, codec_of
from fraclink._law import Modes
from fraclink._law.discretization import drive_for
from fraclink._simulate import kernel
from fraclink._simulate.kernel import ArmState
from fraclink._validate import checked
from fraclink.errors import FieldError

__all__ = ["CATALOGUE", "RULES", "Fault", "FaultRule", "fault_named"]

EVER = 1e6  # [s]
ANY = 10**6  # periods: the catalogue states no number
MOVE_BEGINS = 1.0  # [s]
HEADER, COUNTS = 16, 40  # bytes of law_params before its reals
WATCHDOG = 5  # periods after which a board's watchdog switches the drive off
# A second move after ten seconds of the first: what a wound-up loop would spoil.
BACK_AT = 12.2
THERE_AND_BACK = MOVE.then(hold(0.0, 10.0)).then(smooth_step(-0.75, duration=1.2))
# The paper's gauge, with a noise of 0.01 N·m, asks for 0.24 rad in this time (`Law.wiring_angle`).
SELF_TEST = smooth_step(0.35, duration=0.12, start=0.1)


# ---- sensors -----------------------------------------------------------------------------------------


def _one_bad(sensor: str, *values: float) -> Callable[[Trial], None]:
    """One bad sample; the harder severities repeat it, always with good ones in between."""

    def inject(trial: Trial) -> None:
        every = (0, 25, 5)[trial.case.severity - 1]
        rows = np.arange(trial.row, trial.row + (250 if every else 1), every or 1)
        trial.replace_reading(sensor, np.resize(values, rows.size), rows)

    return inject


def _three(trial: Trial) -> None:
    trial.replace_reading("encoder", math.nan, slice(trial.row, trial.row + int(trial.pick(2, 3, 4))))


def _both(trial: Trial) -> None:
    for sensor in ("encoder", "gauge"):
        trial.replace_reading(sensor, math.nan, trial.rows(trial.pick(0.02, 0.1, EVER)))


def _held(e: Evidence) -> Check:
    first = e.row + e.reacted - 1
    moved = np.ptp(e.faulty.command[first:]) if e.reacted > 0 else np.inf
    return Check.at_most("change of the held motor reference [rad]", moved, 0.0)


def _dropped(trial: Trial) -> None:
    trial.set_bits(trial.sprinkled(trial.pick(0.01, 0.05, 0.2)), FROZEN_ENCODER | FROZEN_GAUGE)


def _last_outside(error: Real, band: float, e: Evidence, *, after: int = 0) -> float:
    """When an error was outside `band` for the last time, and `after` periods [s]."""
    return float(np.flatnonzero(np.abs(error) > band)[-1] + after) * e.law.period


def _settling(e: Evidence) -> Check:
    faulty, clean = (_last_outside(run.error, 0.02, e) - MOVE_BEGINS for run in (e.faulty, e.clean))
    return Check.at_most("settling time over clean", faulty / clean, 1.02)


def _stuck(bits: int, *seconds: float) -> Callable[[Trial], None]:
    return lambda trial: trial.set_bits(trial.rows(trial.pick(*seconds)), bits, mark=True)


def _rail(trial: Trial) -> None:
    trial.replace_reading("gauge", trial.pick(4.1, -4.1, 40.0), trial.rows(EVER))


def _saturated(trial: Trial) -> None:
    trial.replace_reading("gauge", trial.pick(2.0, 3.9, -3.9), trial.rows(trial.pick(0.04, 0.04, 0.2)))


def _offset(trial: Trial) -> None:
    trial.inputs[trial.row :, kernel.GAUGE_ERROR] += trial.pick(0.025, 0.05, 0.1)


def _drift(trial: Trial) -> None:
    time = trial.period * np.arange(trial.count - trial.row)
    trial.inputs[trial.row :, kernel.GAUGE_ERROR] += trial.pick(0.005, 0.01, 0.02) * time


def _gain(trial: Trial) -> None:
    trial.inputs[trial.row :, kernel.GAUGE_GAIN] = trial.pick(1.05, 1.1, 0.9)


def _noise(trial: Trial) -> None:
    sigma = trial.pick(0.02, 0.05, 0.1)
    trial.inputs[:, kernel.GAUGE_ERROR] = sigma * trial.chance.standard_normal(trial.count)


def _noise_bound(e: Evidence) -> Check:
    """rms of the command against Ms σ/c ‖Ĉ‖₂: the sensitivity amplifies what the correction passes."""
    grid = (np.arange(4096) + 0.5) * math.pi / 4096 / e.law.period
    energy = math.sqrt(float(np.mean(np.abs(e.law.frequency_response(grid)) ** 2)))
    bound = e.pick(0.02, 0.05, 0.1) / e.law.stiffness * energy / e.bench.modulus_margin
    last = e.faulty.command[-round(2.0 / e.law.period) :]
    return Check.at_most("rms of the command at rest [rad]", float(np.std(last)), bound)


def _spikes(trial: Trial) -> None:
    rows = trial.sprinkled(trial.pick(0.0025, 0.005, 0.01))
    rows = rows[rows >= trial.row]
    rows = rows if rows.size else np.array([trial.row])
    trial.inputs[rows, kernel.GAUGE_ERROR] += 3.0 * trial.chance.choice((-1.0, 1.0), rows.size)
    trial.marks[rows] = True


def _coarse(trial: Trial) -> None:
    quantum = 2 * math.pi / trial.pick(8000, 4000, 2000)
    trial.at(0, lambda arm: arm.rig.__setitem__(7, quantum))


def _one_count(e: Evidence) -> Check:
    return Check.at_most("final tip error [rad]", e.final, 2 * math.pi / e.pick(8000, 4000, 2000))


# ---- clock, reference, limits ------------------------------------------------------------------------


def _jitter(trial: Trial) -> None:
    """Move the sampling instants by up to one step of 1 ms; their mean stays."""
    count = trial.count
    if trial.case.severity == 3:
        shifts = np.resize([1, -1], count)
    else:
        shifts = trial.chance.integers(-1, 2, count)
        if trial.case.severity == 1:
            shifts[trial.chance.random(count) > 0.1] = 0
    shifts[0] = shifts[-1] = 0
    trial.shifts = shifts
    # The reference is a table over the task's periods; it is the instant that is late.
    trial.wanted = np.asarray(trial.reference.angle(trial.period * np.arange(count) + 1e-3 * shifts))


def _dead(trial: Trial) -> None:
    trial.miss(int(trial.pick(8, 12, 25)))
    trial.at(trial.row + WATCHDOG, lambda arm: arm.voltage.fill(0.0))


def _off_at_once(e: Evidence) -> Check:
    first = e.row + e.reacted - 1
    good = e.reacted > 0 and e.faulty.mode[first] == OFF and e.faulty.reason[first] == MISSED_PERIODS
    return Check.at_most("calls of the law until off", e.reacted - e.pick(8, 12, 25) if good else math.inf, 1)


def _repeated(trial: Trial) -> None:
    if trial.case.severity == 3:
        rows = slice(trial.row, trial.row + 3)

        def back(arm: ArmState) -> None:
            arm.counters[1] -= 3

        trial.at(trial.row, back)
    else:
        rows = slice(trial.row, trial.row + int(trial.pick(1, 25, 0)))
        trial.set_bits(rows, TICK_REPEATED)
    trial.marks[rows] = True


def _delay(trial: Trial) -> None:
    def later(arm: ArmState) -> None:
        arm.voltage = np.zeros(arm.voltage.size + trial.case.severity)
        arm.rig[1] += trial.case.severity

    trial.at(0, later)


def _jump(trial: Trial) -> None:
    trial.inputs[trial.row :, kernel.REFERENCE] += trial.pick(0.25, 0.5, 1.0)
    trial.wanted = trial.inputs[:, kernel.REFERENCE].copy()
    trial.marks[trial.row] = True


def _overshoot(e: Evidence) -> Check:
    beyond = max(0.0, float(e.faulty.tip.max()) - float(e.faulty.wanted[-1]))
    return Check.at_most("overshoot over the jump", beyond / e.pick(0.25, 0.5, 1.0), 0.2)


def _bad_reference(trial: Trial) -> None:
    rows = trial.rows(trial.pick(trial.period, 0.1, 0.1))
    trial.inputs[rows, kernel.REFERENCE] = trial.pick(math.nan, math.nan, 1e3)
    trial.inputs[rows, kernel.ACCELERATION] = trial.pick(math.nan, math.nan, 1e6)
    trial.marks[rows] = True


def _limited(trial: Trial) -> None:
    limits = replace(trial.law.limits, motor_limit=trial.pick(0.9, 0.7, 0.5))
    trial.use(replace(trial.law, limits=limits))


def _recovery(e: Evidence) -> Check:
    band = 0.015  # 2 % of the move back
    times = (_last_outside(run.error, band, e, after=1) - BACK_AT for run in (e.faulty, e.clean))
    return Check.at_most("settling time of the move back over clean", next(times) / next(times), 1.2)


def _slow(trial: Trial) -> None:
    limits = trial.law.limits
    trial.use(replace(trial.law, limits=replace(limits, motor_step=limits.motor_step / trial.pick(3, 5, 10))))


# ---- memory, parameters, start -----------------------------------------------------------------------


def _flip(trial: Trial) -> None:
    modes = len(trial.law.correction.poles)
    name = f"modes[{int(trial.chance.integers(modes))}]" if modes else "modes[16]"
    if trial.case.severity == 3:
        live = [real for real in REALS if not real.startswith("modes")] + [name]
        name = live[int(trial.chance.integers(len(live)))]
    trial.flip(name, 0 if trial.case.severity == 1 else 1)


def _wipe(trial: Trial) -> None:
    def action(arm: ArmState) -> None:
        if trial.case.severity == 3:
            members(arm.law, trial.width)[:] = math.nan
        else:
            arm.law[:] = (0x00, 0xFF)[trial.case.severity - 1]

    trial.at(trial.row, action)


def _mismatch(trial: Trial) -> None:
    version, size, _, crc = struct.unpack_from("<IIII", trial.block)
    trial.corrupt(*((0, version + 1), (4, size - 4), (12, crc ^ 1))[trial.case.severity - 1])


def _damaged(trial: Trial) -> None:
    direct = HEADER + COUNTS + 2 * trial.width
    inside = HEADER + int(trial.chance.integers(len(trial.block) - HEADER))
    trial.corrupt(int(trial.pick(direct, len(trial.block) - 1, inside)))


def _refused(*reasons: int) -> Requirement:
    def check(e: Evidence) -> Check:
        reason = int(e.pick(*reasons))
        wrong = (e.faulty.mode != IDLE) | (e.faulty.reason != reason)
        return Check.at_most(f"periods not refused for reason {reason}", int(np.count_nonzero(wrong)), 0)

    return check


def _silent(e: Evidence) -> Check:
    """Voltage and motor reference of a law that must not have started."""
    rows = e.marks if e.marks.any() else slice(None)
    out = np.abs(np.vstack((e.faulty.command[rows], e.faulty.asked[rows])))
    return Check.at_most("output of a law that is not started", out.max(), 0.0)


def _restarts(trial: Trial) -> None:
    if trial.case.severity == 2:
        trial.set_bits(slice(trial.row, trial.row + 3), TICK_MISSED)
    trial.restart(trial.row + int(trial.pick(0, 3, 0)))
    if trial.case.severity == 3:
        trial.restart(trial.row + 25)


def _bumpless(e: Evidence) -> Check:
    apart = np.abs(e.faulty.command - e.faulty.encoder)[e.marks]
    return Check.at_most("first command from the motor angle [rad]", apart.max(), e.law.limits.motor_step)


def _far(trial: Trial) -> None:
    trial.start_angle += trial.pick(1.0, 2.0, 3.0)


def _blind_start(trial: Trial) -> None:
    trial.replace_reading("encoder", math.nan, slice(0, int(trial.pick(1, 25, trial.count))))


def _idle(e: Evidence) -> Check:
    wrong = e.marks[: len(e.faulty.mode)] & (e.faulty.mode != IDLE)
    return Check.at_most("blind periods in another mode than idle", int(np.count_nonzero(wrong)), 0)


# ---- wiring, units, the arm, its surroundings and its motor ------------------------------------------


def _self_test(trial: Trial) -> None:
    """The commissioning move: motor loop alone, without correction and compensation by the gauge."""
    drive = trial.law.drive
    assert drive is not None  # noqa: S101  # a bench gives every law a motor loop
    alone = replace(drive, torque_voltage=0.0)
    trial.use(replace(trial.law, correction=Modes(0.0), feedforward=Modes(0.0), drive=alone))


def _reversed(trial: Trial) -> None:
    trial.inputs[:, kernel.GAUGE_GAIN] = trial.pick(-1.0, -1.0, -0.5)
    trial.inputs[:, kernel.GAUGE_ERROR] += trial.pick(0.0, 0.1, 0.1)


def _wiring_answer(e: Evidence) -> Check:
    answer = e.law.check_wiring(e.faulty.encoder, e.faulty.gauge)
    return Check.at_most(f"wiring test failed to refuse (it says: {answer})", answer != "gauge reversed", 0)


def _wiring_clean(e: Evidence) -> Check:
    answer = e.law.check_wiring(e.clean.encoder, e.clean.gauge)
    return Check.at_most(f"wiring test refused a good gauge (it says: {answer})", answer != "none", 0)


def _from_the_move(trial: Trial) -> None:
    """Count from the beginning of the move: at zero angle the fault does not show."""
    if trial.case.phase == "whole":
        trial.row = round(MOVE_BEGINS / trial.period)


def _degrees(trial: Trial) -> None:
    trial.inputs[trial.row :, kernel.ENCODER_GAIN] = trial.pick(10.0, 180 / math.pi, 1800 / math.pi)
    _from_the_move(trial)


def _wrapped(trial: Trial) -> None:
    turn = 2 * math.pi
    trial.inputs[trial.row :, kernel.ENCODER_ERROR] += trial.pick(turn, -turn, 2**16 * turn / 1e5)


def _swapped(trial: Trial) -> None:
    whole = trial.case.phase == "whole"
    rows = slice(trial.row, None) if whole else trial.rows(trial.pick(0.25, 0.5, EVER))
    trial.set_bits(rows, SWAPPED)
    _from_the_move(trial)


def _other_payload(trial: Trial) -> None:
    trial.twin = trial.bench.twin.with_payload(trial.case.payload * trial.pick(1.0, 0.8, 0.4))


def _payload_peak(e: Evidence) -> Check:
    payload = e.case.payload * e.pick(1.0, 0.8, 0.4)
    low, _, high = e.bench.payloads
    if low <= payload * (1 + 1e-9) and payload <= high:
        return peak_ratio(1.2)(e)
    return bounded(0.1)(e)  # outside the design: bounded, with the limit of a lost payload


def _payload_changes(trial: Trial) -> None:
    payload = trial.case.payload
    after = trial.pick(0.5 * payload, 0.2 * payload, payload)
    if trial.case.severity == 3:
        trial.twin = trial.bench.twin.with_payload(0.2 * payload)
    trial.at(trial.row, lambda arm: arm.change_payload(after))


def _hit(trial: Trial) -> None:
    if trial.case.severity < 3:
        trial.inputs[trial.rows(0.02), kernel.TIP_FORCE] += trial.pick(0.1, 0.25, 0.0)
        return
    angle = float(trial.wanted[trial.row]) + 0.05

    def wall(arm: ArmState) -> None:
        arm.obstacle[:] = (angle, 500.0, 2.0, arm.twin.beam.length, 1.0)

    trial.at(trial.row, wall)


def _hit_reaction(e: Evidence) -> Check:
    if e.case.severity < 3:
        return settled(1.0)(e)
    check = reacts(HOLD, ANY, OVERLOAD)(e)
    felt, limit = float(np.abs(e.faulty.torque).max()), e.law.limits.torque_trip
    return replace(check, name=f"{check.name}; torque reached {felt:.3g} of {limit:.3g} N·m")


def _sticky(trial: Trial) -> None:
    def action(arm: ArmState) -> None:
        arm.rig[5:7] *= trial.pick(1.5, 2.0, 3.0)

    trial.at(0, action)


def _slow_motor(trial: Trial) -> None:
    pole = trial.law.inner_pole * trial.pick(0.8, 0.65, 0.5)
    trial.use(replace(trial.law, drive=drive_for(trial.bench.rig, pole)))


def _nothing(trial: Trial) -> None:
    """The quiet begins where the run ends: see `_quiet`."""


@functools.lru_cache(maxsize=1)  # two measurements of the same hour
def _quiet(e: Evidence) -> tuple[Real, bytes]:
    """Let the law go on with constant inputs; return its modes and its memory.

    They must be those of an arm that is really at rest: one sample of the gauge's noise, held for an hour, is
    a torque that the law answers with a voltage, and an encoder that then does not move is a fault, for which
    it trips rightly. So each is the mean of the last second, and the reference what the tip then is.
    """
    count = round(e.pick(60.0, 600.0, 3600.0) / e.law.period)
    last = slice(-round(1.0 / e.law.period), None)
    angle, torque = float(np.mean(e.faulty.encoder[last])), float(np.mean(e.faulty.gauge[last]))
    inputs = (angle - torque / e.law.stiffness, 0.0, angle, torque)
    state, outputs = e.law.run(
        e.faulty.law_state, *(np.full(count, value) for value in inputs), first_tick=len(e.faulty.time) + 1
    )
    return outputs.mode, state


def _denormals(e: Evidence) -> Check:
    """Denormal numbers in the law's memory after long quiet; they would make every period slower."""
    size = 4 if e.law.precision == "single" else 8
    reals = members(np.frombuffer(_quiet(e)[1], dtype=np.uint8), size)
    tiny = np.finfo(reals.dtype).tiny
    count = np.count_nonzero((reals != 0) & (np.abs(reals) < tiny))
    return Check.at_most("denormal numbers left in the state", int(count), 0)


def _quiet_trips(e: Evidence) -> Check:
    others = np.count_nonzero(_quiet(e)[0] != RUN)
    return Check.at_most("quiet periods in another mode than run", int(others), 0)


# ---- the table ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class FaultRule:
    """What is done to a trial, and what is measured on its run.

    reference: of the run, where it is not the campaign's move. prepare: done to the faulty and the clean run
    alike.
    """

    inject: Callable[[Trial], None]
    require: tuple[Requirement, ...]
    reference: Reference = MOVE
    prepare: Callable[[Trial], None] | None = None


RIDES = (only(RUN), peak_ratio(1.1))
OFF_BY_ENCODER = (reacts(OFF, 20, BAD_ENCODER, RESIDUAL), only(RUN, OFF))
GIVES_UP_GAUGE = (reacts(DEGRADED, 5, BAD_GAUGE), final(0.02), only(RUN, DEGRADED))

RULES = {
    "F01": FaultRule(_one_bad("encoder", math.nan), (flagged(ENCODER, "encoder"), *RIDES)),
    "F02": FaultRule(_one_bad("gauge", math.nan), (flagged(GAUGE, "gauge"), *RIDES)),
    "F03": FaultRule(_three, (flagged(ENCODER, "encoder"), *RIDES)),
    "F04": FaultRule(_both, (reacts(OFF, 5, BAD_ENCODER), _held, only(RUN, OFF))),
    "F05": FaultRule(_one_bad("gauge", math.inf, -math.inf), (flagged(GAUGE, "gauge"), *RIDES)),
    "F06": FaultRule(_dropped, (*RIDES, _settling)),
    "F07": FaultRule(
        _stuck(FROZEN_ENCODER, 0.25, 0.5, EVER),
        (reacts(OFF, 20, BAD_ENCODER, RESIDUAL), peak(0.4, phases=("mid",)), only(RUN, OFF)),
    ),
    "F08": FaultRule(_stuck(FROZEN_ENCODER, 0.5, 2.0, 3.5), RIDES),
    "F09": FaultRule(_rail, GIVES_UP_GAUGE),
    "F10": FaultRule(_saturated, GIVES_UP_GAUGE),
    "F11": FaultRule(_stuck(FROZEN_GAUGE, 0.25, 0.5, 1.0), (only(RUN, DEGRADED), peak_ratio(1.1))),
    # An offset of the gauge, which Ĉ(1) = 0 must reject exactly whenever it comes.
    "F12": FaultRule(_offset, (only(RUN), final(1e-3))),
    "F13": FaultRule(_offset, (only(RUN), final(1e-3))),
    "F14": FaultRule(_drift, (only(RUN), final(5e-3))),
    "F15": FaultRule(_gain, RIDES),
    "F16": FaultRule(_reversed, (_wiring_answer, _wiring_clean), SELF_TEST, _self_test),
    "F17": FaultRule(_noise, (only(RUN), _noise_bound)),
    "F18": FaultRule(_spikes, (flagged(GAUGE, "gauge"), only(RUN), peak_ratio(1.05))),
    "F19": FaultRule(_coarse, (only(RUN), _one_count)),
    "F20": FaultRule(_jitter, (only(RUN), peak_ratio(1.02))),
    "F21": FaultRule(lambda trial: trial.miss(int(trial.pick(1, 3, 5))), (flagged(MISSED, "missed"), *RIDES)),
    "F22": FaultRule(_dead, (flagged(MISSED, "missed"), _off_at_once, only(RUN, OFF))),
    "F23": FaultRule(_repeated, (flagged(REPEATED, "repeated"), *RIDES)),
    "F24": FaultRule(_delay, (only(RUN), peak_ratio(1.05))),
    "F25": FaultRule(_jump, (flagged(REFERENCE, "reference"), only(RUN), _overshoot)),
    "F26": FaultRule(_bad_reference, (flagged(REFERENCE, "reference"), only(RUN), final(0.02))),
    "F27": FaultRule(_limited, (only(RUN), _recovery), THERE_AND_BACK),
    "F28": FaultRule(_slow, (only(RUN), limit_cycle(2e-3))),
    "F29": FaultRule(_flip, (only(RUN), peak(0.3), settled(1.0))),
    "F30": FaultRule(_wipe, RIDES),
    "F31": FaultRule(_mismatch, (_refused(BAD_VERSION, BAD_SIZE, BAD_CRC), _silent)),
    "F32": FaultRule(_restarts, (flagged(STARTED, "started"), _bumpless, only(RUN), final(0.02))),
    "F33": FaultRule(_far, (only(RUN), final(0.02))),
    "F34": FaultRule(_blind_start, (flagged(ENCODER, "encoder"), _idle, _silent, only(IDLE, RUN))),
    "F35": FaultRule(_degrees, OFF_BY_ENCODER),
    "F36": FaultRule(_wrapped, OFF_BY_ENCODER),
    "F37": FaultRule(_swapped, (reacts(OFF, ANY, BAD_ENCODER, RESIDUAL), only(RUN, OFF))),
    "F38": FaultRule(_other_payload, (only(RUN), _payload_peak, final(0.02))),
    "F39": FaultRule(_payload_changes, (only(RUN), bounded(0.1), final(0.02))),
    "F40": FaultRule(_hit, (_hit_reaction, only(RUN, HOLD))),
    "F41": FaultRule(_sticky, (only(RUN), limit_cycle(2e-3))),
    "F42": FaultRule(_slow_motor, (only(RUN), bounded(0.2), final(0.02))),
    "F43": FaultRule(_nothing, (only(RUN), _denormals, _quiet_trips)),
    "F44": FaultRule(_damaged, (_refused(BAD_CRC, BAD_CRC, BAD_CRC), _silent)),
}


@dataclass(frozen=True)
class Fault:
    """A row of the catalogue, as faults.toml explains it.

    reaction: A ride through, B degrade, C hold, D off, "-" for another requirement. duration of the run [s].
    """

    number: str
    title: str
    injection: str
    severities: tuple[str, str, str]
    required: str
    reaction: Literal["A", "B", "C", "D", "-"]
    phases: tuple[str, ...] = ("start", "mid", "rest")
    duration: float = 7.0
    nominal: bool = False
    skips: tuple[tuple[int, str], ...] = ()
    note: str = ""

    @property
    def rule(self) -> FaultRule:
        """What is done and measured."""
        return RULES[self.number]


def _catalogue() -> tuple[Fault, ...]:
    rows = tomllib.loads(files("fraclink").joinpath("_campaign/faults.toml").read_text("utf-8"))
    decode = codec_of(Fault).decode
    return tuple(decode({"number": number, **row}, number, Storage()) for number, row in sorted(rows.items()))


CATALOGUE = _catalogue()


@checked
def fault_named(number: str) -> Fault:
    """Return a fault by its number; FieldError where there is none.

    >>> fault_named("F07").title
    'encoder stuck in a move'
    """
    found = next((fault for fault in CATALOGUE if fault.number == number.upper()), None)
    if found is None:
        remedy = "choose one of these"
        raise FieldError("only", number, "not in the catalogue", allowed="F01 … F44", remedy=remedy)
    return found
