"""What a log's columns are: matched by name and unit, or asked.

`read_log` guesses nothing. Here names and units are matched with the roles, and the one
vibration that a scan finds in the log checks them: sign, gain, and whether a tip's angle
is measured from the hub. What does not match is a `Question`, one for each role at most;
what moves no frequency, order or delay of a fit is assumed, and said to be.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.log_columns import (
    ROW_NUMBER,
    UNITS,
    Channel,
    ColumnStatement,
    LogColumns,
    OutputKind,
)
from fraclink._reading.columns import (
    check_count,
    clock_step,
    is_stated,
    seconds_and_parts,
    with_combined,
)
from fraclink._reading.names import (
    UNITS_OF_LENGTH,
    length_of_name,
    names_time,
    roles_of,
    words_of,
)
from fraclink._reading.text import LogTable
from fraclink.errors import LogError
from fraclink.logs._channels import Mode, find_mode
from fraclink.logs._dead_ends import check_no_response, no_angle, no_output
from fraclink.logs._weighing import Certainty, Guess, Question, Weighing, stamps_of

__all__ = ["Guess", "GuessedColumns", "Question", "guess_columns"]

Array = NDArray[np.float64]
Roles = list[tuple[str, str]]

# A vibrating arm is sampled every 0.2 ms to 0.1 s. The window is narrower than a factor
# of 1000, so that at most one of s, ms, us and ns puts a clock's step into it.
_FASTEST, _SLOWEST = 2e-4, 0.1
# More than half of an output: one vibration cannot explain that much of two signals.
_SHOWN = 0.5
# An output may be late by half of the vibration before it looks like one of the other
# sign that is early; with its sign unknown, by a quarter on either side: half of that.
_LATE = 1 / 8
# A deflection θm − θt has the gain 1 on the motor angle, and degrees taken for radians
# make it 57: halfway between the two, in the logarithm, one is as far off as the other.
_OTHER_UNIT = math.sqrt(180 / math.pi)


@dataclass(frozen=True)
class GuessedColumns:
    """What was concluded: the columns, None as long as a question is open, and every
    guess behind them.
    """

    columns: LogColumns | None
    guesses: tuple[Guess, ...]
    questions: tuple[Question, ...]


def guess_columns(
    table: LogTable,
    stated: Mapping[str, ColumnStatement],
    *,
    assume: bool = False,
    interpolate: bool = False,
    source: str = "log.csv",
) -> GuessedColumns:
    """Match names and units of a log with the roles of its columns.

    Parameters
    ----------
    table
        the log as its file holds it.
    stated
        what is known already, by role: time, motor_angle, output, voltage. A
        statement's own role says which output it is, torque or deflection.
    assume
        take the defaults of the questions that have one.
    interpolate
        look past missing cells.
    source
        the file, as a command that a refusal names is to call it.

    Raises
    ------
    LogError
        a column that is stated is not there, a cell of one that is needed is no number,
        or the log has no column that could be the motor angle or the output.
    """
    # First what no answer could mend, then what a question may.
    check_no_response(table, source)
    check_count(max((values.size for values in table.values), default=0))
    table = with_combined(
        table, [each.column for each in stated.values() if each.column]
    )
    weighing = Weighing(table, stated, assume, interpolate, source)
    for remark in table.remarks:
        weighing.conclude(
            "form of the file", remark, "certain", "the whole file agrees"
        )
    # Values near the largest double overflow in a difference: such a column is no
    # signal, and no error here.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        columns = _columns(weighing)
    return GuessedColumns(
        None if weighing.questions else columns,
        tuple(weighing.guesses),
        tuple(weighing.questions),
    )


def _columns(weighing: Weighing) -> LogColumns | None:
    time = _time(weighing)
    places = _signals(weighing, time)
    angle, output = places.get("motor_angle"), places.get("output")
    channel = None if angle is None else _angle(weighing, angle)
    if time is None or angle is None or output is None or channel is None:
        return None
    # The median: a gap or a stamp that jumps back is for the reader to refuse, and does
    # not move the scan's period.
    period = float(np.median(np.abs(np.diff(stamps_of(weighing, time)))))
    if not period > 0:
        raise LogError(
            "column of time",
            time.column,
            "the same in most samples",
            allowed="stamps that rise from sample to sample",
            remedy="state another column, or --period-ms 4",
        )
    turned = channel.in_si(weighing.cells(angle), "motor_angle")
    raw = weighing.cells(output)
    if turned.size != raw.size:
        return None
    made = _from_the_hub(weighing, channel, turned, output, period)
    if made is None:
        return None
    output, raw = made, weighing.cells(made)
    mode = find_mode(turned, raw, period)
    mode = mode if mode is not None and mode.share > _SHOWN else None
    kind_and_unit = _kind_and_unit(weighing, output, mode)
    if kind_and_unit is None:
        return None
    kind, unit, scale = kind_and_unit
    signal = Channel(
        weighing.label(output), unit, sign=_sign(weighing, mode), scale=scale
    )
    voltage = _voltage(weighing, turned, taken=(angle, output))
    return LogColumns(time, channel, signal, kind, voltage)


# --- time -------------------------------------------------------------------------------


def _time(weighing: Weighing) -> Channel | None:
    """The channel of the stamps."""
    statement, table = weighing.statement("time"), weighing.table
    scale = statement.scale or 1.0
    if statement.column == ROW_NUMBER:
        unit = statement.unit or "s"
        value = f"one sample every {scale:g} {unit}"
        weighing.conclude("time", value, "stated", "the log has no stamps")
        return Channel(ROW_NUMBER, unit, scale=scale)
    place = weighing.place(statement)
    if place is None and (parts := seconds_and_parts(table)):
        place = weighing.add(parts, "s")
    elif place is None:
        place = _clock(weighing)
    if place is None:
        text = "No column rises as a clock does: how long is one sample?"
        option = '--period-ms 4, or --column "time=NAME [s]"'
        weighing.ask(Question("time", "period", text, ("4 ms",), "", option))
        return None
    named, label = names_time(weighing.name(place)), weighing.label(place)
    steps = np.abs(np.diff(weighing.cells(place)))
    step = float(np.median(steps))
    rate = f"a sample every {step * scale:.6g}"
    sure: Certainty = "certain" if named else "likely"
    weighing.conclude("time", label, "stated" if statement.column else sure, rate)
    own = statement.unit or weighing.unit(place)
    fitting = [
        unit
        for unit, size in UNITS["time"].items()
        if _FASTEST <= step * scale * size <= _SLOWEST
    ]
    # A column that rises by one may count samples or milliseconds: only a name of time
    # makes it the latter.
    counter = step == 1.0 and not named
    # The name's unit stands unless nobody samples an arm so: then milliseconds were
    # exported under the name of seconds.
    if statement.unit or own in fitting or (own in UNITS["time"] and not fitting):
        weighing.conclude("unit of time", own, "stated", f"{rate} {own}")
        return Channel(label, own, scale=scale)
    if len(fitting) == 1 and not counter and own not in UNITS["time"]:
        why = f"{rate}: of s, ms, us and ns the one in which arms are sampled"
        weighing.conclude("unit of time", fitting[0], "likely", why)
        return Channel(label, fitting[0], scale=scale)
    text = f"{label} rises by {step:.6g}" + (f" {own} by its name" if own else "")
    text += ": how long is one step?" if counter else ": in which unit?"
    example = f"{label} * 0.004 [s]" if counter else f"{label} [ms]"
    option = f'--column "time={example}"'
    choices = ("4 ms",) if counter else ("s", "ms", "us")
    weighing.ask(Question("time", "unit", text, choices, "", option))
    return None


def _clock(weighing: Weighing) -> int | None:
    """The place of the column that is named as a time, or else rises as one."""
    table = weighing.table
    clocks = [k for k, v in enumerate(table.values) if clock_step(v) is not None]
    # A file may hold several recordings, each with its clock: of most signals, and of
    # these the longest.
    sizes = [values.size for values in table.values if _moves(values)]
    most = max(((sizes.count(n), n) for n in sizes), default=(0, 0))[1]
    clocks = [place for place in clocks if table.values[place].size == most]
    # Stamps that jump back, or hold no number, are still those: the reader says what is
    # wrong with them.
    named = [k for k in clocks or range(len(table.names)) if _is_time(weighing, k)]
    # A counter of rows last: it may be one.
    clocks.sort(key=lambda place: clock_step(table.values[place]) == 1.0)
    return next(iter([*named, *clocks]), None)


def _is_time(weighing: Weighing, place: int) -> bool:
    return names_time(weighing.name(place))


# --- which column is the motor angle, which the output ----------------------------------


def _signals(weighing: Weighing, time: Channel | None) -> dict[str, int]:
    """The places of the motor angle and of the output, as far as they are stated or
    match; a question asks for what does not.
    """
    table = weighing.table
    roles = roles_of([weighing.name(place) for place in range(len(table.names))])
    stated = {
        role: place
        for role in ("motor_angle", "output")
        if (place := weighing.place(weighing.statement(role))) is not None
    }
    free = _free(weighing, time, roles, next(iter(stated.values()), None))
    if time is not None and weighing.lacks("motor_angle"):
        raise no_angle(weighing, time, free, roles)
    if time is not None and weighing.lacks("output"):
        raise no_output(weighing, time, stated.get("motor_angle"), free, roles)
    places: dict[str, int] = {}
    suggested: set[str] = set()
    wanted: dict[str, tuple[str, ...]]
    wanted = {"motor_angle": ("motor_angle",), "output": ("torque", "deflection")}
    for role, part in (("motor_angle", "motor angle"), ("output", "output")):
        if role in stated:
            places[role] = stated[role]
            weighing.conclude(part, weighing.label(stated[role]), "stated", "as stated")
            continue
        left = [k for k in free if k not in (*places.values(), *stated.values())]
        named = [place for place in left if roles[place][0] in wanted[role]]
        if len(named) > 1 and role == "motor_angle":
            # Of two angles the one at the motor's side is wanted.
            hub = {"motor", "hub", "m", "joint"}
            named = [k for k in named if hub & set(words_of(weighing.name(k)))] or named
        tips = [place for place in left if roles[place][0] == "the tip"]
        if not named and role == "output" and len(tips) == 1:
            named = tips
        if len(named) == 1:
            places[role] = named[0]
            _conclude_match(weighing, part, named[0], roles)
        else:
            # Never what was only asked for, nor what is measured of something else.
            likely = ("", "the tip", "motor_angle", *wanted[role])
            unnamed = [k for k in left if roles[k][0] in likely]
            # Names of one letter are habits, and say little: u may be any input.
            unnamed += [k for k in left if len(weighing.name(k)) == 1]
            choices = named or list(dict.fromkeys(unnamed))
            # The column that one question suggests is no suggestion of the other.
            choices.sort(key=lambda k: weighing.label(k) in suggested)
            suggested.update(weighing.label(k) for k in choices[:1])
            _ask_column(weighing, role, choices)
    open_roles = [q for q in weighing.questions if q.part == "column"]
    if time is not None and any(not question.choices for question in open_roles):
        # Asked without a choice: there is nothing in this log to answer with.
        if "motor_angle" not in places and not any(
            q.role == "motor_angle" and q.choices for q in open_roles
        ):
            raise no_angle(weighing, time, free, roles)
        raise no_output(weighing, time, places.get("motor_angle"), free, roles)
    return places


def _free(
    weighing: Weighing, time: Channel | None, roles: Roles, stated: int | None
) -> list[int]:
    """The places of the signals: as long as the time, moving, and each once."""
    table = weighing.table
    clock = None
    if time is not None and time.column != ROW_NUMBER:
        clock = table.place(time.column, "time")
    of_length = clock if clock is not None else stated
    length = max(v.size for v in table.values)
    length = length if of_length is None else table.values[of_length].size
    places: list[int] = []
    # Named columns first: of two that are equal the one with the better name stays.
    for place in sorted(range(len(roles)), key=lambda k: not roles[k][0]):
        values = table.values[place]
        # A column that only rises is another clock, unless its name says what it
        # measures and not when.
        rises = clock_step(values) is not None and (
            not roles[place][0] or _is_time(weighing, place)
        )
        again = any(np.array_equal(values, table.values[k]) for k in places)
        moves = values.size == length and _moves(values)
        if place != clock and moves and not rises and not again:
            places.append(place)
    return sorted(places)


def _moves(values: Array) -> bool:
    finite = values[np.isfinite(values)]
    # A column with a tenth of its cells missing is an event counter or a comment,
    # whatever it is called.
    return finite.size > 0.9 * values.size and bool(np.ptp(finite) > 0)


def _conclude_match(weighing: Weighing, part: str, place: int, roles: Roles) -> None:
    name, label = weighing.name(place), weighing.label(place)
    others = [
        weighing.name(k)
        for k, (role, _) in enumerate(roles)
        if role.startswith(("a ", "the ")) and k != place
    ]
    evidence = f"its name says {roles[place][1]!r}"
    evidence += f": {name}" if name != label else ""
    evidence += f"; not used: {', '.join(others[:4])}" if others else ""
    weighing.conclude(part, label, "stated" if is_stated(name) else "likely", evidence)


def _ask_column(weighing: Weighing, role: str, choices: list[int]) -> None:
    names = tuple(weighing.label(place) for place in choices)
    first = names[0] if names else "NAME"
    text = "Which column is the motor angle, and in which unit?"
    option = f'--column "motor_angle={first} [deg]"'
    if role == "output":
        text = "Which column is the output of the link, its torque or deflection?"
        option = f'--column "torque={first} [Nm]" or "deflection={first} [raw]"'
    weighing.ask(Question(role, "column", text, names, "", option))


# --- the motor angle --------------------------------------------------------------------


def _angle(weighing: Weighing, place: int) -> Channel | None:
    """The channel of the motor angle; None where its unit is a question."""
    statement, own = weighing.statement("motor_angle"), weighing.unit(place)
    label, raw = weighing.label(place), weighing.cells(place)
    sign, scale = statement.sign or 1, statement.scale or 1.0
    reach = float(np.abs(raw - raw[0]).max())
    unit = statement.unit or (own if own in UNITS["angle"] else "")
    if unit:
        source = "as stated" if statement.unit else "by its name"
        evidence = f"{source}; it moves by {scale * reach:.4g} {unit}"
        weighing.conclude("unit of the motor angle", unit, "stated", evidence)
        return Channel(label, unit, sign=sign, scale=scale)
    if length := length_of_name(weighing.name(place)):
        # Any radius makes an angle of its way, for all but the gain.
        value = f"1 rad for 1 m of {label}"
        why = "a linear axis: frequency, order and delay do not depend on the lever"
        weighing.conclude("unit of the motor angle", value, "assumed", why)
        return Channel(label, "rad", sign=sign, scale=UNITS_OF_LENGTH[length])
    text, example = f"{label} moves by {reach:.4g}: in which unit?", "[deg]"
    choices: tuple[str, ...] = ("rad", "deg")
    if own in UNITS["voltage"]:
        text, example = f"{label} is in volts: which angle is one volt?", "* 36.8 [deg]"
        choices = ("36.8 deg", "0.64 rad")
    # Whole numbers are counts, unless they are few: an angle in whole degrees.
    elif reach > 2 * math.pi and (raw == np.round(raw)).all():
        text, example = f"{label} counts: which angle is one count?", "* 1/4096 [rev]"
        choices = ("1/4096 rev", "0.09 deg")
    option = f'--column "motor_angle={label} {example}"'
    weighing.ask(Question("motor_angle", "unit", text, choices, "", option))
    return None


# --- the output -------------------------------------------------------------------------


def _from_the_hub(
    weighing: Weighing, channel: Channel, turned: Array, output: int, period: float
) -> int | None:
    """The place of the output, or of the deflection that is made of it where it is the
    tip's angle in space; None where that is a question.

    A deflection δ = θm − θt answers an acceleration with a positive gain, a tip angle
    with a negative one, and rings as a deflection of the other sign does: but what is
    left of θm by subtracting it is then a vibration, and a clearer one.
    """
    statement, own = weighing.statement("output"), weighing.unit(output)
    name, length = weighing.label(output), length_of_name(weighing.name(output))
    stated = statement.column is not None
    if own in (*UNITS["torque"], *UNITS["voltage"]) or (stated and length):
        return output
    moved = weighing.cells(output) - weighing.cells(output)[0]
    slope = float(moved @ turned) / float(turned @ turned) if turned.any() else 0.0
    if length and not slope:
        return output
    # Without a unit it is taken to have that of the motor angle.
    size = UNITS["angle"].get(own or channel.unit, 1.0)
    factor = 1 / slope if length else size
    itself = find_mode(turned, moved, period)
    rest = find_mode(turned, turned - factor * moved, period)
    if itself is None or rest is None:
        return output
    if not (itself.gain < 0 < rest.gain and rest.share > max(itself.share, _SHOWN)):
        return output
    angle = channel.column
    unit_of_angle = UNITS["angle"][channel.unit] * channel.scale * channel.sign
    if length:
        text = (
            f"{name} moves with the motor, so it sees the tip in space: how far does "
        )
        text += f"1 {length} of it turn the arm?"
        option = f'--column "deflection={angle} - K * {name} [{channel.unit}]"'
        weighing.ask(Question("output", "column", text, (name,), "", option))
        return None
    ratio = size / unit_of_angle
    made = f"{angle} - {name}"
    if abs(ratio - 1) > 1e-9:
        made = f"{angle} {'-' if ratio > 0 else '+'} {abs(ratio):.9g} * {name}"
    if stated:
        raise LogError(
            "column of output",
            name,
            "the angle of the tip: the motor angle less it is what vibrates",
            allowed="the torque at the base, or the deflection: motor angle less tip angle",
            remedy=f'state the difference, --column "deflection={made} [{channel.unit}]"',
        )
    if channel.scale != 1 or channel.sign != 1:
        return output  # the difference of raw numbers would be none of angles
    text = f"the motor angle less {name} is one vibration ({100 * rest.share:.3g} %): "
    weighing.guesses[:] = [each for each in weighing.guesses if each.part != "output"]
    weighing.conclude("output", made, "likely", text + "the tip in space")
    return weighing.add(made, channel.unit)


def _kind_and_unit(
    weighing: Weighing, place: int, mode: Mode | None
) -> tuple[OutputKind, str, float] | None:
    """Torque or deflection, its unit and the factor to it; None where that is a
    question.
    """
    statement, own = weighing.statement("output"), weighing.unit(place)
    unit, scale = statement.unit or own, statement.scale or 1.0
    name, part = weighing.label(place), "output measures"
    source = "as stated" if statement.unit else "by its name"
    if unit in UNITS["torque"] or (statement.role == "torque" and statement.unit):
        size = scale * UNITS["torque"].get(unit, 1.0)
        said = f"; {abs(mode.gain) * size:.3g} N·m/rad" if mode else ""
        weighing.conclude(part, f"torque [{unit}]", "stated", source + said)
        return "torque", unit, scale
    gain = abs(mode.gain) if mode is not None else 0.0
    if unit in UNITS["angle"] or (statement.unit and statement.unit != "raw"):
        calibrated = gain * scale * UNITS["angle"].get(unit, 1.0)
        odd = gain and not 1 / _OTHER_UNIT < calibrated < _OTHER_UNIT
        if odd and not statement.unit:
            text = f"{name} is in {own} by its name, but {calibrated:.3g} times what the motor turns: in which unit?"
            option = (
                f'--column "deflection={name} [deg]", or the unit of the motor angle'
            )
            choices = ("rad", "deg", "raw")
            weighing.ask(Question("output", "unit", text, choices, "", option))
            return None
        said = (
            f"; gain {calibrated:.3g} on the motor angle, 1 in theory" if gain else ""
        )
        weighing.conclude(part, f"deflection [{unit}]", "stated", source + said)
        return "deflection", unit, scale  # `LogColumns` refuses a unit of none
    role = roles_of([weighing.name(place)])[0][0]
    beside = weighing.statement("motor_angle").unit or ""
    if role == "motor_angle" and beside in UNITS["angle"] and not statement.unit:
        why = "named as an angle: in the unit of the motor's"
        weighing.conclude(part, f"deflection [{beside}]", "likely", why)
        return "deflection", beside, scale
    if (statement.role == "torque" or role == "torque") and statement.unit != "raw":
        text = f"{name} is a torque: in which unit? (raw: not calibrated)"
        option = f'--column "torque={name} [Nm]" or "torque={name} [mNm]"'
        choices = ("Nm", "mNm", "raw")
        weighing.ask(Question("output", "unit", text, choices, "", option))
        return None
    return _uncalibrated(weighing, place, gain)


def _uncalibrated(
    weighing: Weighing, place: int, gain: float
) -> tuple[OutputKind, str, float]:
    """A sensor without a unit, scaled so that it answers the motor angle as a
    deflection does.
    """
    name, length = weighing.label(place), length_of_name(weighing.name(place))
    if not gain:
        raise LogError(
            "column of output",
            name,
            "not calibrated, and no vibration that the motor's motion explains could scale it",
            allowed="Nm, mNm, rad or deg",
            remedy=f'state --column "torque={name} [Nm]" or "deflection={name} [deg]"',
        )
    # Four digits, as people write a calibration: the gain itself is known to a percent.
    scale = float(f"{1 / gain:.4g}")
    what = f"a link of {gain:.3g} {length}" if length else f"{name} is not calibrated"
    why = (
        f"{what}: scaled to a gain of 1 on the motor angle, as a deflection has; "
        "frequency, order and delay do not depend on it"
    )
    weighing.conclude(
        "output measures", f"deflection, {scale:g} rad each", "assumed", why
    )
    return "deflection", "rad", scale


def _sign(weighing: Weighing, mode: Mode | None) -> Literal[1, -1]:
    """The sign with which the output is positive where the motor speeds up."""
    stated, part = weighing.statement("output").sign, "sign of the output"
    if mode is not None:
        explained = f"explains {100 * mode.share:.3g} % of the output"
        frequency = f"{mode.frequency:.3g} rad/s"
        weighing.conclude("vibration", frequency, "certain", explained)
    # Where the motor speeds up the link is bent backwards, and Γ = c(θm − θt) is
    # positive: the sign convention of rig and law.
    sign: Literal[1, -1] = -1 if mode is not None and mode.gain < 0 else 1
    mark = "+" if (stated or sign) > 0 else "-"
    if stated:
        weighing.conclude(part, mark, "stated", "as stated")
        return stated
    if mode is None or mode.delay * mode.frequency > 2 * math.pi * _LATE:
        why = "no vibration that tells" if mode is None else "it answers late"
        why += ": state a minus, as in torque=-bridge [mNm], where it is turned"
        weighing.conclude(part, mark, "assumed", why)
        return sign
    way = "with" if sign > 0 else "against"
    weighing.conclude(part, mark, "certain", f"it goes {way} the motor's acceleration")
    return sign


def _voltage(
    weighing: Weighing, angle: Array, *, taken: tuple[int, int]
) -> Channel | None:
    """The channel of the amplifier's voltage, where one column is named so; a fit of
    the link does not need it.
    """
    table, statement = weighing.table, weighing.statement("voltage")
    place = weighing.place(statement)
    roles = roles_of([weighing.name(k) for k in range(len(table.names))])
    named = [k for k, r in enumerate(roles) if r[0] == "voltage" and k not in taken]
    if place is None and len(named) == 1:
        place = named[0]
    if place is None or table.values[place].size != angle.size:
        return None
    raw, own, label = table.values[place], weighing.unit(place), weighing.label(place)
    unit = statement.unit or (own if own in UNITS["voltage"] else "")
    if not np.isfinite(raw).all() or not _moves(raw):
        return None
    # A motor runs where its voltage drives it, though a servo brakes as often.
    relation = float(np.corrcoef(raw, np.gradient(angle))[0, 1])
    sign: Literal[1, -1] = statement.sign or (-1 if relation < -_SHOWN else 1)
    evidence = f"correlation {relation:.2g} with the motor's speed"
    value = f"{'-' if sign < 0 else ''}{label} [{unit or 'V'}]"
    weighing.conclude("voltage", value, "stated" if unit else "likely", evidence)
    return Channel(label, unit or "V", sign=sign, scale=statement.scale or 1.0)
