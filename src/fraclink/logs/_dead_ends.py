"""Logs to which `start` cannot fit a link, and the command to continue with in each
case.
"""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING

from fraclink._arm.log_columns import Channel
from fraclink._reading.names import words_of
from fraclink._reading.table import LogTable, moves
from fraclink.errors import LogError

if TYPE_CHECKING:
    from fraclink.logs._match import _Matching

_FREQUENCY = frozenset(("freq", "frequency", "frequenz", "omega", "hz", "f", "w"))
_RESPONSE = frozenset(("gain", "mag", "magnitude", "amplitude", "phase", "real"))
_RESPONSE |= {"imag", "coherence", "db"}
_RINGS = ("torque", "deflection", "the tip", "an acceleration", "")


def check_signals_in(table: LogTable, source: str) -> None:
    """Raise LogError for a table of a frequency response, which has no time column, and
    for one without two columns of numbers.
    """
    if sum(map(moves, table.values)) < 2 and (faults := table.bad_cells()):
        raise LogError(
            "log",
            source,
            f"not two columns of numbers ({faults[0]})",
            "a motor angle and an output that move",
            "export the log as a table of numbers",
        )
    words = [set(words_of(name)) for name in table.names]
    matches = [each for each in words if each & _RESPONSE]
    # Two columns of a response in addition to one of frequencies: "phase" alone may be
    # a channel of a log.
    if len(matches) > 1 and any(x & _FREQUENCY for x in words if x not in matches):
        command = f"fraclink identify {shlex.quote(source)} --structure"
        raise _without_model(
            table,
            "a frequency response",
            f'run {command} "k*s**a/(s**a + w)" where its input is the motor angle, '
            f"{command} driven --rig RIG where it is the amplifier's voltage",
        )


def dead_end(
    matching: _Matching,
    time: Channel,
    angle: int | None,
    free: list[int],
    roles: list[tuple[str, str]],
    missing: str,
) -> LogError:
    """The error for a log without a moving motor, or without torque or deflection of
    the link; with the command that fits its content.
    """
    table, file = matching.table, shlex.quote(matching.source)
    period = matching.period
    names = {place: shlex.quote(matching.label(place)) for place in free}
    sensors, voltages, speeds = (
        [place for place in free if roles[place][0] == meaning]
        for meaning in ("an acceleration", "voltage", "a speed")
    )
    rings = [place for place in free if roles[place][0] in _RINGS]
    steps = [matching.label(place) for place in free if table.is_switched(place)]
    mode, channels = '"k/(s**a + w)*exp(-L*s)"', ""
    if missing == "output" and angle is not None and sensors:
        # A lag of a quarter of a sample makes the structure proper, and every
        # accelerometer has one; any further lag is L.
        mode = f'"k*s**2/(s**a + w)/({0.25 * period:.3g}*s + 1)*exp(-L*s)"'
        channels = (
            f"--input {shlex.quote(matching.label(angle))} --output {names[sensors[0]]}"
        )
        problem = "with an acceleration, which is no angle, as its output"
        remedy = "run"
    elif missing == "output" and angle is not None and voltages:
        scale = "" if time.scale == 1 else f" * {time.scale:g}"
        statements = (
            f"time={time.column}{scale} [{time.unit}]",
            f"motor_angle={matching.label(angle)} [{matching.unit(angle) or 'deg'}]",
            f"voltage={matching.label(voltages[0])} [{matching.unit(voltages[0]) or 'V'}]",
        )
        columns = " ".join(f'--column "{text}"' for text in statements)
        return _without_model(
            table,
            "of a motor, without a signal of the link's bending",
            f"run fraclink identify {file} --structure motor {columns}",
        )
    # One signal that rings and nothing that moves it; with two it would be unknown
    # which one is the output.
    elif (
        missing == "motor_angle"
        and len(rings) == 1
        and not (voltages or speeds or steps)
    ):
        channels = f"--ring-down --output {names[rings[0]]}"
        problem = "without a motor that moves"
        remedy = "if the link was bent and let go, run"
    elif missing == "motor_angle" and len(free) > 1:
        # Any structure can be fitted to two related signals, whatever they are; the
        # user decides which one is the input.
        channels = f"--input {names[free[0]]} --output {names[free[1]]}"
        problem = "without the motor angle, from which a link is identified"
        if steps:
            problem += f" ({', '.join(steps)}: half its range or more in one sample: a command, or an angle to unwrap)"
        remedy = "if one of its signals drives the other, run"
    if channels:
        command = (
            f"fraclink identify {file} --structure {mode} {channels} "
            f"--period-ms {1e3 * period:.6g}"
        )
        return _without_model(table, problem, f"{remedy} {command}")
    return _without_model(
        table,
        "without the output of the link (torque or deflection)"
        if missing == "output"
        else "without the motor angle",
        "record both signals together: a link is identified from the motor's motion to its output",
    )


def _without_model(table: LogTable, problem: str, remedy: str) -> LogError:
    allowed = (
        "a time, and the motor angle and the link's torque or deflection, both moving"
    )
    names = ", ".join(table.names[:12])
    return LogError("columns", names, problem, allowed, remedy)
