"""What a log's columns probably are: each guess with its evidence and its certainty,
and what must be asked.

`read_log` guesses nothing. Here names, ranges and the one vibration that a scan finds
in the log are weighed into the columns that `read_log` then takes. What they leave open
is a `Question`: with a default where a usable assumption exists (it moves no frequency,
order or delay of the fit), without one otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.log_columns import (
    ROW_NUMBER,
    UNITS,
    Channel,
    ColumnStatement,
    LogColumns,
)
from fraclink._reading.columns import check_count, clock_step, is_stated, with_combined
from fraclink._reading.names import names_time, role_of_name, words_of
from fraclink._reading.text import LogTable
from fraclink.errors import LogError
from fraclink.logs._calibration import (
    STRONG,
    check_no_tip_angle,
    guess_angle,
    guess_output,
    guess_voltage,
)
from fraclink.logs._channels import find_mode
from fraclink.logs._dead_ends import check_no_response, no_angle, no_output
from fraclink.logs._tips import LONGEST_SCAN, gauges, tip_difference
from fraclink.logs._weighing import (
    Certainty,
    Guess,
    Question,
    Weighing,
    guess_time,
    samples_of,
    stamps_of,
)

__all__ = ["Guess", "GuessedColumns", "Question", "guess_columns"]

Array = NDArray[np.float64]

# of the best share: a second pair of columns that explains more makes the first one
# doubtful
_APART = 0.6
_PAIR_COLUMNS = 6  # without names: thirty ordered pairs are a second


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
    """Weigh names, ranges and the vibration in the log into columns.

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
    time = guess_time(weighing)
    angle, output = _signals(weighing, time)
    if time is None or angle is None or output is None:
        return None
    raw_angle, raw_output = weighing.cells(angle), weighing.cells(output)
    # The median: a gap or a stamp that jumps back is for the reader to refuse, and does
    # not move the scan's period.
    period = float(np.median(np.abs(np.diff(stamps_of(weighing, time)))))
    if not period > 0:
        allowed, remedy = (
            "stamps that rise from sample to sample",
            "state another column, or --period-ms 4",
        )
        raise LogError(
            "column of time",
            time.column,
            "the same in most samples",
            allowed=allowed,
            remedy=remedy,
        )
    stiffness = _stiffness(weighing, output, raw_angle, raw_output, period)
    # Half of the range of Γ over c: how far the link bends to each side, in the unit in
    # which the stiffness was found.
    bend = (
        float(np.ptp(raw_output)) / 2 * _torque(weighing, output) / stiffness
        if stiffness
        else 0.0
    )
    angle_channel = guess_angle(weighing, angle, raw_angle, stiffness, bend)
    if angle_channel is None or raw_angle.size != raw_output.size:
        return None
    # From here on the angle is in radians: a gain of 1 then means a deflection, and c
    # is in N·m/rad.
    in_radians = angle_channel.in_si(raw_angle, "motor_angle")
    mode = find_mode(in_radians, raw_output, period)
    check_no_tip_angle(
        weighing,
        output,
        in_radians,
        raw_output * UNITS["angle"][angle_channel.unit],
        period,
    )
    found = guess_output(weighing, output, mode)
    if found is None:
        return None
    kind, channel = found
    voltage = guess_voltage(weighing, in_radians, taken=(angle, output))
    return LogColumns(time, angle_channel, channel, kind, voltage)


def _stiffness(
    weighing: Weighing, output: int, angle: Array, raw: Array, period: float
) -> float:
    """Gain of a torque on the angle in its own unit [N·m], 0 where there is none to
    tell the unit by.
    """
    scale = _torque(weighing, output)
    if not scale or angle.size != raw.size:
        return 0.0
    mode = find_mode(angle, raw, period)
    return abs(mode.gain) * scale if mode is not None and mode.share >= STRONG else 0.0


def _torque(weighing: Weighing, output: int) -> float:
    """N·m for one of the output as it stands, 0 where it is no torque by its unit."""
    statement = weighing.statement("output")
    return UNITS["torque"].get(statement.unit or weighing.unit(output), 0.0) * abs(
        statement.scale or 1.0
    )


# --- which column is the motor angle, which the output ----------------------------------------------------


def _signals(weighing: Weighing, time: Channel | None) -> tuple[int | None, int | None]:
    """The places of the motor angle and of the output; None where a question asks for
    it.
    """
    table, length = weighing.table, samples_of(weighing, time)
    named = {place: role_of_name(name) for place, name in enumerate(table.names)}
    clock = (
        None
        if time is None or time.column == ROW_NUMBER
        else table.place(time.column, "time")
    )
    free = [
        place
        for place, values in enumerate(table.values)
        # A column that only rises is another clock, unless its name says what it
        # measures and not when.
        if place != clock and values.size == length and _moves(values)
        if clock_step(values) is None
        or (named[place][0] and not names_time(table.names[place]))
    ]
    places: dict[str, int | None] = {}
    for role, part in (("motor_angle", "motor angle"), ("output", "output")):
        places[role] = place = weighing.place(weighing.statement(role))
        if place is not None:
            weighing.conclude(part, weighing.label(place), "stated", "as stated")
    taken = set(places.values())
    # A column that was stated is taken at its word, even where its values look like a
    # tip angle's.
    settled = places["output"] is not None
    if places["motor_angle"] is None:
        places["motor_angle"] = _by_name(
            weighing, "motor angle", ("motor_angle",), named, free, taken
        )
    if places["output"] is None:
        places["output"] = _by_name(
            weighing,
            "output",
            ("torque", "deflection"),
            named,
            free,
            taken | {places["motor_angle"]},
        )
    if places["output"] is None:
        places["output"] = _of_two(weighing, places["motor_angle"], named, free, time)
    if None in places.values():
        _by_vibration(
            weighing, places, [place for place in free if not named[place][0]], time
        )
    if None in places.values():
        _ask_columns(weighing, places, named, free, time)
    angle, output = places["motor_angle"], places["output"]
    if angle is None or output is None or settled or output >= len(named):
        return angle, output
    return angle, _in_space(weighing, angle, output, time)


def _of_two(
    weighing: Weighing,
    angle: int | None,
    named: Mapping[int, tuple[str, str]],
    free: list[int],
    time: Channel | None,
) -> int | None:
    """The place of an output that two gauges make, or the tip and the motor angle."""
    pair = gauges(weighing, named, free)
    tips = [place for place in free if named[place][0] == "the tip" and place != angle]
    if pair is not None or angle is None or len(tips) != 1:
        return pair
    return tip_difference(weighing, angle, tips[0], time)


def _in_space(weighing: Weighing, angle: int, output: int, time: Channel | None) -> int:
    """The output, or the deflection that is made of it where its values are those of
    the tip's angle.
    """
    own = weighing.unit(output)
    if own and own not in UNITS["angle"]:
        return output
    said = len(weighing.guesses)
    found = tip_difference(weighing, angle, output, time)
    if found is None or found == output:
        # Nothing was concluded after all: no sentence of the attempt may stand in the
        # report.
        del weighing.guesses[said:]
        return output
    weighing.guesses[:] = [
        g for k, g in enumerate(weighing.guesses) if g.part != "output" or k >= said
    ]
    return found


def _moves(values: Array) -> bool:
    finite = values[np.isfinite(values)]
    # A column with a tenth of its cells missing is an event counter or a comment,
    # whatever it is called.
    return finite.size > 0.9 * values.size and bool(np.ptp(finite) > 0)


def _by_name(
    weighing: Weighing,
    part: str,
    roles: tuple[str, ...],
    named: Mapping[int, tuple[str, str]],
    free: list[int],
    taken: set[int | None],
) -> int | None:
    """The one column whose name says the role; where several do, the one that names the
    motor or a unit.
    """
    found = [place for place in free if named[place][0] in roles and place not in taken]
    if len(found) > 1:
        exact = [
            p
            for p in found
            if any(
                w in ("motor", "hub", "m", "joint")
                for w in words_of(weighing.table.names[p])
            )
        ]
        # Of two angles the one at the motor's side is wanted; of two outputs no word
        # says which is better.
        found = exact if part == "motor angle" and exact else found
    if len(found) != 1:
        return None
    others = [
        weighing.table.names[p]
        for p, (role, _) in named.items()
        if p in free and role.startswith(("a ", "the "))
    ]
    evidence = f"its name says {named[found[0]][1]!r}" + (
        f"; not used: {', '.join(others[:4])}" if others else ""
    )
    sure: Certainty = (
        "stated" if is_stated(weighing.table.names[found[0]]) else "likely"
    )
    weighing.conclude(part, weighing.label(found[0]), sure, evidence)
    return found[0]


def _by_vibration(
    weighing: Weighing,
    places: dict[str, int | None],
    nameless: list[int],
    time: Channel | None,
) -> None:
    """Fill in what one vibration tells: in which pair of columns the output rings with
    the motor angle.
    """
    if time is None or len(nameless) > _PAIR_COLUMNS:
        return
    angles = nameless if places["motor_angle"] is None else [places["motor_angle"]]
    outputs = nameless if places["output"] is None else [places["output"]]
    stamps = stamps_of(weighing, time)
    # Every n-th sample of the whole log, not its first part: many logs begin at rest. A
    # vibration above the new Nyquist frequency is not found, and asked for instead.
    stride = max(1, stamps.size // LONGEST_SCAN)
    period = stride * float(np.median(np.abs(np.diff(stamps))))
    shares: dict[tuple[int, int], float] = {}
    for angle in angles:
        for output in outputs:
            if angle is None or output is None or angle == output or not period > 0:
                continue
            raw = weighing.cells(angle), weighing.cells(output)
            mode = find_mode(raw[0][::stride], raw[1][::stride], period)
            shares[angle, output] = 0.0 if mode is None else mode.share
    ranked = sorted(shares, key=lambda pair: -shares[pair])
    if not ranked or shares[ranked[0]] < STRONG:
        return
    # Another pair that explains nearly as much leaves it open: motor and tip angle both
    # ring with the torque.
    if len(ranked) > 1 and shares[ranked[1]] > _APART * shares[ranked[0]]:
        return
    share = f"one vibration explains {100 * shares[ranked[0]]:.3g} % of it"
    for role, part, place in zip(
        places, ("motor angle", "output"), ranked[0], strict=True
    ):
        if places[role] is None:
            weighing.conclude(
                part,
                weighing.label(place),
                "likely",
                f"{share}, of no other pair as much",
            )
            places[role] = place


_NO_SIGNAL = (
    "a commanded value",
    "a speed",
    "an acceleration",
    "a current",
    "a temperature",
    "voltage",
)


def _ask_columns(
    weighing: Weighing,
    places: Mapping[str, int | None],
    named: Mapping[int, tuple[str, str]],
    free: list[int],
    time: Channel | None,
) -> None:
    """Ask for each column that is open, by name; LogError where there is none left to
    choose from.
    """
    left = [
        place
        for place in free
        if place not in places.values() and named[place][0] not in _NO_SIGNAL
    ]
    open_roles = [role for role, place in places.items() if place is None]
    if len(left) < len(open_roles) and time is not None:
        if places["motor_angle"] is None and not [
            p for p in left if named[p][0] == "motor_angle"
        ]:
            raise no_angle(weighing, time, free, named)
        raise no_output(weighing, time, places["motor_angle"], free, named)
    if not left:
        return  # the question for the time comes first
    words = {
        "motor_angle": "the motor angle",
        "output": "the output of the link (torque or deflection)",
    }
    for role in open_roles:
        names = tuple(weighing.label(place) for place in left)
        spelled = "motor_angle" if role == "motor_angle" else "torque"
        option = f'--column "{spelled}={names[0]}"' + (
            ' or "deflection=…"' if role == "output" else ""
        )
        weighing.ask(
            Question(
                role, "column", f"Which column is {words[role]}?", names, "", option
            )
        )
