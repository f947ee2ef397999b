"""Logs of which `start` fits no link, and the command that goes on with each."""

from __future__ import annotations

import shlex
from collections.abc import Sequence

from fraclink._arm.log_columns import Channel
from fraclink._reading.names import words_of
from fraclink._reading.text import LogTable
from fraclink.errors import LogError
from fraclink.logs._weighing import Weighing, stamps_of

__all__ = ["check_no_response", "no_angle", "no_output"]

Named = Sequence[tuple[str, str]]

_FREQUENCY = frozenset(("freq", "frequency", "frequenz", "omega", "hz", "f", "w"))
_RESPONSE = frozenset(
    (
        "gain",
        "mag",
        "magnitude",
        "amplitude",
        "phase",
        "real",
        "imag",
        "coherence",
        "db",
    )
)
_RINGS = ("torque", "deflection", "the tip", "an acceleration", "")


def check_no_response(table: LogTable, source: str) -> None:
    """Raise LogError for a table of a frequency response, which no clock runs through."""
    words = [set(words_of(name)) for name in table.names]
    shown = [each for each in words if each & _RESPONSE]
    # Two columns of a response and one of frequencies beside them: "phase" alone is a
    # channel of a log.
    if len(shown) < 2 or not any(
        each & _FREQUENCY for each in words if each not in shown
    ):
        return
    file = shlex.quote(source)
    raise _dead_end(
        table,
        "a frequency response",
        f"run fraclink identify-driven-link {file} --rig RIG where its input is the amplifier's voltage, "
        f"fraclink identify-spectrum {file} where it is the motor angle",
    )


def no_output(
    weighing: Weighing, time: Channel, angle: int | None, free: list[int], named: Named
) -> LogError:
    """The error of a log without the link's torque or deflection."""
    table, file = weighing.table, shlex.quote(weighing.source)
    felt = [place for place in free if named[place][0] == "an acceleration"]
    driven = [place for place in free if named[place][0] == "voltage"]
    if angle is not None and felt:
        channels = (
            f"--input {_called(weighing, angle)} --output {_called(weighing, felt[0])}"
        )
        # A quarter of a sample makes the structure proper, as every accelerometer is;
        # what it has more is L.
        period = _period(weighing, time)
        command = (
            f'fraclink identify-structure {file} "k*s**2/(s**a + w)/({0.25 * period:.3g}*s + 1)*exp(-L*s)" '
            f"{channels} --period-ms {1e3 * period:.6g} --bound k=-1e9,1e9"
        )
        return _dead_end(
            table,
            "with an acceleration, which is no angle, as its output",
            f"run {command}",
        )
    if angle is not None and driven:
        stated = {
            "time": f"{time.column}{'' if time.scale == 1 else f' * {time.scale:g}'} [{time.unit}]",
            "motor_angle": f"{weighing.label(angle)} [{weighing.unit(angle) or 'deg'}]",
            "voltage": f"{weighing.label(driven[0])} [{weighing.unit(driven[0]) or 'V'}]",
        }
        columns = " ".join(f'--column "{role}={text}"' for role, text in stated.items())
        command = f"fraclink identify-motor {file} {columns}"
        return _dead_end(
            table, "of a motor without a signal of its link's flexion", f"run {command}"
        )
    return _without(table, "the output of the link (torque or deflection)")


def no_angle(
    weighing: Weighing, time: Channel, free: list[int], named: Named
) -> LogError:
    """The error of a log in which no motor moves: a ring-down, where one other signal
    does.
    """
    table = weighing.table
    rings = [place for place in free if named[place][0] in _RINGS]
    # One signal that rings, and nothing that drives it; of two nobody knows which one
    # is the output.
    if len(rings) == 1 and not any(named[place][0] == "voltage" for place in free):
        command = (
            f'fraclink identify-structure {shlex.quote(weighing.source)} "k/(s**a + w)*exp(-L*s)" '
            f"--ring-down --output {_called(weighing, rings[0])} "
            f"--period-ms {1e3 * _period(weighing, time):.6g} --bound k=-1e9,1e9"
        )
        return _dead_end(
            table,
            "without a motor that moves",
            f"if the link was bent and let go, run {command}",
        )
    if len(free) > 1:
        # Of two signals that belong together any structure can be fitted, whatever they
        # are; which one drives is for the user to say.
        command = (
            f'fraclink identify-structure {shlex.quote(weighing.source)} "k/(s**a + w)*exp(-L*s)" '
            f"--input {_called(weighing, free[0])} --output {_called(weighing, free[1])} "
            f"--period-ms {1e3 * _period(weighing, time):.6g} --bound k=-1e9,1e9"
        )
        return _dead_end(
            table,
            "without the motor angle, from which a link is identified",
            f"if one of its signals drives the other, run {command}",
        )
    return _without(table, "the motor angle")


def _dead_end(table: LogTable, problem: str, remedy: str) -> LogError:
    allowed = "a time, the motor angle, and the link's torque or deflection, each of which moves"
    return LogError(
        "columns", ", ".join(table.names[:12]), problem, allowed=allowed, remedy=remedy
    )


def _without(table: LogTable, words: str) -> LogError:
    remedy = "record both signals together: a link is identified from the motor's motion to its output"
    return _dead_end(table, f"without {words}", remedy)


def _called(weighing: Weighing, place: int) -> str:
    return shlex.quote(weighing.label(place))


def _period(weighing: Weighing, time: Channel) -> float:
    stamps = stamps_of(weighing, time)
    return float(stamps[-1] - stamps[0]) / max(1, stamps.size - 1)
