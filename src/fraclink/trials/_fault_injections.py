"""The effect of a fault on a trial, under the names used in faults.toml.

A list of three numbers in that file has one for each severity; `inject` passes on the
one of the case.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from fraclink._arm.motor import place_pid
from fraclink._arm.rig import Encoder
from fraclink._law import MODES, Modes
from fraclink._law import block as layout
from fraclink._simulate import events as columns
from fraclink._simulate.events import Obstacle, PayloadChange
from fraclink._simulate.kernel import ArmState
from fraclink.trials._fault_trial import MEMORY_WORDS, Case, FaultTrial

__all__ = ["INJECTIONS", "at_severity", "inject"]

COLUMNS = {
    "reference": columns.REFERENCE,
    "reference acceleration": columns.ACCELERATION,
    "gauge": columns.GAUGE_ERROR,
    "gauge gain": columns.GAUGE_GAIN,
    "encoder": columns.ENCODER_ERROR,
    "encoder gain": columns.ENCODER_GAIN,
    "tip force": columns.TIP_FORCE,
    "encoder value": columns.ENCODER_VALUE,
    "gauge value": columns.GAUGE_VALUE,
}


def inject(trial: FaultTrial, steps: Sequence[Mapping[str, Any]]) -> None:
    """Apply the steps of a fault to a trial, at the severity of its case."""
    for step in steps:
        INJECTIONS[step["do"]](trial, **at_severity(step, trial.case, but=("do",)))


def at_severity(
    row: Mapping[str, Any], case: Case, *, but: Sequence[str]
) -> dict[str, Any]:
    """Return a row of the catalogue without the names in `but`, each list replaced by
    its value at the severity of the case.
    """
    return {
        name: value[case.severity - 1] if isinstance(value, list) else value
        for name, value in row.items()
        if name not in but
    }


# --- sensors, clock, reference --------------------------------------------------------


def reading(
    trial: FaultTrial,
    sensor: str,
    value: float,
    *,
    samples: int = 1,
    seconds: float = 0.0,
    every: int = 0,
    alternate: bool = False,
) -> None:
    """Replace a sensor's readings: for some samples or seconds, or for a second in
    isolated samples with good ones in between.
    """
    if every:
        # The law counts consecutive bad samples: any number of isolated ones must not
        # add up to a trip.
        second = trial.rows(1.0)
        rows = np.arange(second.start, second.stop, every)
    else:
        span = trial.rows(seconds)
        last = max(span.stop, min(span.start + samples, trial.count))
        rows = np.arange(span.start, last)
    signs = np.resize([1.0, -1.0] if alternate else [1.0], rows.size)
    trial.set_bits(rows, f"{sensor} value", mark=True)
    trial.inputs[rows, COLUMNS[f"{sensor} value"]] = value * signs


def stick(trial: FaultTrial, sensor: str, seconds: float) -> None:
    """Repeat a sensor's last reading."""
    trial.set_bits(trial.rows(seconds), f"{sensor} frozen", mark=True)


def drop(trial: FaultTrial, share: float) -> None:
    """Lose a share of the samples of both sensors: the last ones are repeated."""
    rows = trial.sprinkled(share)
    trial.set_bits(rows, "encoder frozen")
    trial.set_bits(rows, "gauge frozen")


def add(
    trial: FaultTrial,
    to: str,
    value: float,
    *,
    seconds: float = math.inf,
    per_second: bool = False,
) -> None:
    """Add a constant or a ramp to an input from the fault on."""
    rows = trial.rows(seconds)
    time = trial.period * np.arange(len(trial.inputs[rows]))
    trial.inputs[rows, COLUMNS[to]] += value * (time if per_second else 1.0)
    if to == "reference":
        # an intended jump: it is now the desired motion
        trial.wanted = trial.inputs[:, columns.REFERENCE].copy()
        trial.marks[trial.row] = True


def put(
    trial: FaultTrial,
    to: str,
    value: float,
    *,
    seconds: float = math.inf,
    mark: bool = False,
) -> None:
    """Replace an input by a number."""
    rows = trial.rows(seconds)
    trial.inputs[rows, COLUMNS[to]] = value
    trial.marks[rows] |= mark


def noise(trial: FaultTrial, deviation: float) -> None:
    trial.inputs[:, columns.GAUGE_ERROR] = deviation * trial.chance.standard_normal(
        trial.count
    )


def spikes(trial: FaultTrial, share: float, size: float) -> None:
    rows = trial.sprinkled(share)
    rows = rows[rows >= trial.row]
    # At 0.25 % one draw in eleven has no spike in the 950 periods of rest, and such a
    # run would pass without testing anything.
    rows = rows if rows.size else np.array([trial.row])
    signs = trial.chance.choice((-1.0, 1.0), rows.size)
    trial.inputs[rows, columns.GAUGE_ERROR] += size * signs
    trial.marks[rows] = True


def swap(trial: FaultTrial, seconds: float) -> None:
    """Exchange the two channels for a time, or from the first sample on for ever."""
    whole = trial.case.phase == "whole"
    trial.set_bits(trial.rows(math.inf if whole else seconds), "channels swapped")
    lasting = whole or math.isinf(seconds)
    trial.detail = "for ever" if lasting else "for a while"
    if whole:
        # until then both readings are zero
        trial.row = int(np.flatnonzero(np.diff(trial.wanted))[0])


def scale_encoder(trial: FaultTrial, factor: float) -> None:
    """Scale the encoder; the fault counts from the time at which its reading differs
    from the motor angle by more than a good encoder's may.

    At zero angle the fault does not show: `residual_angle` is the allowed deviation of
    a motor from its model. The motor is where its reference was a lag of 2/p + 1.5 T
    ago, the lag that the guards also assume.
    """
    trial.inputs[trial.row :, columns.ENCODER_GAIN] = factor
    lag = round((2 / trial.law.motor_loop_pole + 1.5 * trial.period) / trial.period)
    motor = np.concatenate((np.full(lag, trial.wanted[0]), trial.wanted))
    apart = (factor - 1) * np.abs(motor[trial.row : trial.count])
    trial.row += int(np.argmax(apart > trial.law.limits.residual_angle))


def jitter(trial: FaultTrial, kind: str) -> None:
    """Shift the sampling instants by up to one step of the twin, without changing
    their mean.
    """
    shifts = trial.chance.integers(-1, 2, trial.count)
    if kind == "alternating":
        shifts = np.resize([1, -1], trial.count)
    elif kind == "one in 10":
        shifts[trial.chance.random(trial.count) > 0.1] = 0
    # The run keeps its length, and the mean period remains that of the law.
    shifts[0] = shifts[-1] = 0
    trial.shifts = shifts
    # The reference is a table over the periods of the task; only the sampling instant
    # is late.
    time = trial.period * np.arange(trial.count) + trial.twin.step * shifts
    trial.wanted = trial.reference.angle(time)


def miss(trial: FaultTrial, periods: int, *, watchdog: int = 0) -> None:
    """Do not run the task; the next period, in which the law can first detect it, is
    marked. A board's watchdog switches the drive off after some periods.
    """
    trial.set_bits(slice(trial.row, trial.row + periods), "tick missed")
    trial.marks[trial.row + periods] = True
    if watchdog:
        trial.at(trial.row + watchdog, lambda arm: arm.voltage.fill(0.0))


def repeat(trial: FaultTrial, times: int) -> None:
    """Call the law twice in a period, or set its clock back by three."""
    if times:
        rows = slice(trial.row, trial.row + times)
        trial.set_bits(rows, "tick repeated", mark=True)
        return

    def back(arm: ArmState) -> None:
        arm.counters[1] -= 3

    trial.at(trial.row, back)
    # A clock that was set back is followed at once: the law is a period late once, and
    # unaffected afterwards.
    trial.marks[trial.row] = True


# --- the law: its limits, its memory, its block ---------------------------------------


def limit(trial: FaultTrial, name: str, value: float = 0.0, share: float = 0.0) -> None:
    """Change a limit of the law to a value, or to a share of its own."""
    own: dict[str, Any] = asdict(trial.law.limits)
    limits = replace(trial.law.limits, **own | {name: value or share * own[name]})
    trial.use(replace(trial.law, limits=limits))


def slow_motor_loop(trial: FaultTrial, share: float) -> None:
    """Place the law's own motor loop slower than the correction assumes, as with a
    wrongly identified motor.
    """
    pole = share * trial.law.motor_loop_pole
    pid = place_pid(trial.bench.rig.motor, pole).discretize(trial.period)
    trial.use(replace(trial.law, motor_loop=replace(trial.motor_loop, pid=pid)))


def self_test(trial: FaultTrial) -> None:
    """The commissioning move: motor loop alone, without correction and compensation by
    the gauge.
    """
    # With a gauge wired backwards, compensation and correction would be positive
    # feedback; the test of its sign must not depend on them.
    alone = replace(trial.motor_loop, torque_voltage=0.0)
    none = Modes(0.0)
    trial.use(replace(trial.law, correction=none, feedforward=none, motor_loop=alone))


def without_gauge(trial: FaultTrial) -> None:
    """Make the law give up its gauge in the period of the fault."""
    # the four copies of the mode
    degraded = MODES.index("degraded")
    trial.at(trial.row, lambda arm: arm.law.__setitem__(slice(4, 8), degraded))


def asked_for_less(trial: FaultTrial) -> None:
    """Give the law a reference that ends where its motor stops, so that nothing can
    wind up.
    """
    most = trial.law.limits.motor_limit
    beyond = trial.inputs[:, columns.REFERENCE] > most
    trial.inputs[beyond, columns.REFERENCE] = most
    trial.inputs[beyond, columns.ACCELERATION] = 0.0


def flip(trial: FaultTrial, bit_from_top: int, *, of: str = "a mode") -> None:
    """Flip the sign or the highest bit of the exponent of a real of the law's memory."""
    width = trial.real.itemsize
    # A law that has only pairs stores them after the real modes. A mode that the law
    # does not have is unused memory; flipping it would test nothing.
    modes = layout.REAL_MODES + layout.FORWARD_MODES
    own = len(trial.law.correction.poles)
    place = int(trial.chance.integers(own)) if own else modes
    if of == "any":
        modes += 2 * layout.PAIR_MODES
        others = (len(trial.state) - MEMORY_WORDS) // width - modes
        index = int(trial.chance.integers(others + 1))
        place = place if index == others else modes + index
    # Little-endian: the sign is the highest bit of the last byte.
    bit = 8 * width - 1 - bit_from_top
    byte = MEMORY_WORDS + width * place + bit // 8
    trial.detail = f"real {place}, {'exponent' if bit_from_top else 'sign'}"

    def action(arm: ArmState) -> None:
        arm.law[byte] ^= np.uint8(1 << (bit % 8))

    trial.at(trial.row, action)


def wipe(trial: FaultTrial, byte: int) -> None:
    """Fill the law's memory with a byte, or its reals with NaN for a byte of -1."""

    def action(arm: ArmState) -> None:
        if byte >= 0:
            arm.law[:] = byte
        else:
            # Only the reals: with the words filled as well, it would be the case of
            # severity 2.
            arm.law[MEMORY_WORDS:].view(trial.real)[:] = math.nan

    trial.at(trial.row, action)


def restart(trial: FaultTrial, *, after: int = 0, missed: int = 0) -> None:
    """Restart the law; missed: periods in which the processor did not run, while the
    arm goes on with its last voltage.
    """
    row = trial.row + after + missed
    trial.set_bits(slice(trial.row, trial.row + missed), "tick missed")
    trial.at(row, ArmState.restart)
    trial.marks[row] = True


def corrupt(trial: FaultTrial, place: str) -> None:
    """Flip the lowest bit of a byte of the block: of a word of its header, of a
    coefficient, the last, or any.
    """
    words = {name: 4 * index for index, name in enumerate(layout.HEADER)}
    reals = 4 * (len(layout.HEADER) + len(layout.COUNTS))
    block = bytearray(trial.block)
    byte = {
        **words,
        # The third real is the direct gain of Ĉ; a law without a check would multiply
        # every command by it.
        "a coefficient": reals + 2 * trial.real.itemsize,
        "the last byte": len(block) - 1,
        "any byte": int(trial.chance.integers(4 * len(words), len(block))),
    }[place]
    block[byte] ^= 1
    trial.block, trial.detail = bytes(block), f"byte {byte}"


# --- the arm --------------------------------------------------------------------------


def arm(
    trial: FaultTrial,
    *,
    payload: float = 1.0,
    friction: float = 1.0,
    delay: int = 0,
    counts: int = 0,
) -> None:
    """Run on another arm: factors of payload and friction, additional periods of delay,
    encoder counts per turn of the output.
    """
    twin = trial.twin.with_payload(payload * trial.twin.beam.payload)
    # Sliding friction and, in proportion, stiction: the law compensates the values of
    # its rig.
    motor = replace(twin.motor, coulomb_torque=friction * twin.motor.coulomb_torque)
    trial.twin = replace(
        twin,
        motor=motor,
        encoder=Encoder(counts) if counts else twin.encoder,
        voltage_delay=twin.voltage_delay + delay,
    )


def change_payload(trial: FaultTrial, factor: float) -> None:
    trial.at(trial.row, PayloadChange(0.0, factor * trial.case.payload).act)


def stand(trial: FaultTrial, away: float) -> None:
    """Start the arm away from its reference [rad]."""
    # The arm is moved instead of the reference, so that the following move is the same
    # as for all other faults.
    trial.start_angle += away


def wall(trial: FaultTrial, ahead: float) -> None:
    """Place an obstacle in the way of the tip, ahead of the move [rad]."""
    if ahead:
        angle = float(trial.wanted[trial.row]) + ahead
        trial.at(trial.row, Obstacle(0.0, trial.count * trial.period, angle).act)


def quiet(trial: FaultTrial, seconds: float) -> None:
    """Remove the gauge's noise from the last seconds of the run."""
    last = round(min(seconds / trial.period, trial.count))
    trial.inputs[trial.count - last :, columns.GAUGE_ERROR] = trial.twin.gauge.offset


INJECTIONS: dict[str, Callable[..., None]] = {
    function.__name__.replace("_", " "): function
    for function in (
        *(reading, stick, drop, add, put, noise, spikes, swap, scale_encoder, jitter),
        *(miss, repeat, limit, slow_motor_loop, self_test, without_gauge),
        *(asked_for_less, flip, wipe, restart, corrupt),
        *(arm, change_payload, stand, wall, quiet),
    )
}
