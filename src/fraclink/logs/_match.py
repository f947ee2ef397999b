"""The roles of the columns of a log: matched by name and unit, or asked for.

`read_log` guesses nothing. Here names and units are matched with the roles, and the one
vibration that a fit finds in the log checks them: sign, gain, and whether a tip's angle
is measured from the hub. A role without a match becomes a `Question`, at most one per
role. Values that affect no frequency, order or delay of a fit are assumed and reported
as assumptions.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

from fraclink._arm.log_columns import (
    ROW_NUMBER,
    UNITS,
    Channel,
    ColumnStatement,
    LogColumns,
    OutputKind,
)
from fraclink._identify import Fit
from fraclink._identify.problem import CLEARLY_LESS
from fraclink._reading.columns import check_count, stated_by
from fraclink._reading.formats import read_table
from fraclink._reading.names import (
    length_of_name,
    names_time,
    words_of,
)
from fraclink._reading.table import (
    LogTable,
    clock_step,
    moves,
)
from fraclink.errors import LogError
from fraclink.logs._dead_ends import check_signals_in, dead_end
from fraclink.logs._diagnosis import SHOWN, share_of
from fraclink.logs._pairs import LATE, Candidate, Pairs, phase
from fraclink.logs._questions import (
    ABSENT,
    Certainty,
    Guess,
    Question,
    statements,
)
from fracsys.checks import Real, checked

# A vibrating arm is sampled every 0.2 ms to 0.1 s. This window spans less than a factor
# of 1000, so at most one of s, ms, us and ns puts the step of a clock into it.
_FASTEST, _SLOWEST = 2e-4, 0.1
# Rank of a name for a role: it matches (0 or 1), has no meaning, or means something
# else.
_UNNAMED, _UNLIKELY = 2, 3


@dataclass(frozen=True)
class Match:
    """What was concluded: the columns, None as long as a question is open, and every
    guess behind them.
    """

    columns: LogColumns | None
    guesses: tuple[Guess, ...]
    questions: tuple[Question, ...]


@checked
def match(log: Path | str, *, column: Iterable[str] = ()) -> Match:
    """Match names and units of a log with the roles of its columns; nothing is fitted.

    Parameters
    ----------
    log
        the file, of any format that `read_log` reads.
    column
        what is known, as in `start`.

    Raises
    ------
    LogError
        a stated column is not there, a cell of a needed one is not a number, or the log
        has no column that could be the motor angle or the output.

    Examples
    --------
    >>> from fraclink._reading.reading import bundled_log
    >>> result = match(bundled_log("pulse_30g"))
    >>> result.columns.motor_angle.column, result.questions
    ('motor_angle_rad', ())
    """
    return match_table(read_table(Path(log)), statements(column, None), str(log))


def match_table(
    table: LogTable,
    stated: dict[str, ColumnStatement],
    source: str,
    interpolate: bool = False,
) -> Match:
    """`match` for a table that was read; `source` is its file name for the commands in
    error messages.
    """
    # Faults that no answer could remedy first, then those that a question may settle.
    check_signals_in(table, source)
    check_count(max((values.size for values in table.values), default=0))
    columns = [each.column for each in stated.values() if each.column]
    matching = _Matching(table.with_combined(columns), stated, source, interpolate)
    for remark in table.remarks:
        matching.conclude(
            "form of the file", remark, "certain", "the whole file agrees"
        )
    # Differences of values near the largest double overflow: such a column is not a
    # signal, and this is not an error.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        matched = matching.columns()
    questions = tuple(matching.questions)
    return Match(None if questions else matched, tuple(matching.guesses), questions)


@dataclass
class _Matching:
    """The state of the matching of one table; each step adds guesses or questions."""

    table: LogTable
    stated: dict[str, ColumnStatement]
    source: str
    interpolate: bool
    guesses: list[Guess] = field(default_factory=list)
    questions: list[Question] = field(default_factory=list)
    # The share that a link explains does not depend on the unit of time: any period
    # serves until one is known.
    period: float = 0.01

    def conclude(
        self, part: str, value: str, certainty: Certainty, evidence: str
    ) -> None:
        self.guesses.append(Guess(part, value, certainty, evidence))

    def ask(
        self, role: str, part: str, text: str, choices: Iterable[str], example: str
    ) -> None:
        option, columns = f'--column "{example}"', self.table.names
        others = (*map(self.label, range(len(columns))),) if part == "column" else ()
        question = Question(role, part, text, tuple(choices), option, others)
        self.questions.append(question)

    def statement(self, role: str) -> ColumnStatement:
        return self.stated.get(role, ColumnStatement(role))

    def place(self, role: str) -> int | None:
        """The place of a stated column; a name that itself ends in brackets is matched
        as a whole.
        """
        each = self.statement(role)
        if each.column is None or self.is_absent(role):
            return None
        whole = f"{each.column} [{each.unit}]"
        column = whole if whole in self.table.names else each.column
        return self.table.place(column, each.role)

    def is_absent(self, role: str) -> bool:
        """Whether an answer says that the log does not contain a role."""
        own = self.statement(role).column
        return own == ABSENT and ABSENT not in self.table.names

    def label(self, place: int) -> str:
        return self.table.label(place)

    def cells(self, place: int) -> Real:
        """The numbers of a column; LogError for a cell that is not a number."""
        return self.table.clean(place, interpolate=self.interpolate)[0]

    def unit(self, place: int) -> str:
        """The unit that the file or its name states for a column."""
        return self.table.unit(place)

    def add(self, name: str, unit: str) -> int:
        """Add a column computed from others, such as ``"theta - tip"``; return its
        place.
        """
        table = self.table.with_combined([name])
        units = [*table.units]
        units[table.names.index(name)] = unit
        self.table = replace(table, units=tuple(units))
        return table.names.index(name)

    @property
    def pairs(self) -> Pairs:
        """The columns in pairs, in the unit that is stated for the motor angle."""
        unit = self.statement("motor_angle").unit
        return Pairs(self.table, self.period, unit or "")

    def columns(self) -> LogColumns | None:
        time = self.time()
        if time is not None:
            rows = np.arange(2.0)
            if time.column != ROW_NUMBER:
                rows = self.cells(self.table.place(time.column, "time"))
            steps = np.diff(time.in_si(rows, "time"))
            self.period = float(np.median(np.abs(steps)))
        places = self.signals(time)
        angle, output = places.get("motor_angle"), places.get("output")
        channel = None if angle is None else self.motor_angle(angle)
        if time is None or angle is None or output is None or channel is None:
            return None
        motor_angle = channel.in_si(self.cells(angle), "motor_angle")
        if motor_angle.size != self.table.values[output].size:
            return None
        source = self.from_the_hub(channel, angle, output)
        if source is None:
            return None
        mode = self.pairs.vibration(motor_angle, self.cells(source))
        self.pairs.check_no_rate(source, motor_angle, mode)
        mode = mode if share_of(mode) > SHOWN else None
        measured = self.output(source, mode)
        if measured is None:
            return None
        kind, unit, scale = measured
        sign = self.sign(mode)
        signal = Channel(self.label(source), unit, sign=sign, scale=scale)
        voltage = self.voltage(motor_angle, taken=(angle, source))
        return LogColumns(time, channel, **{kind: signal}, voltage=voltage)

    # --- time ---

    def time(self) -> Channel | None:
        """The channel of the time stamps."""
        statement = self.statement("time")
        scale = statement.scale or 1.0
        if statement.column == ROW_NUMBER:
            unit = statement.unit or "s"
            value = f"one sample every {scale:g} {unit}"
            self.conclude("time", value, "stated", "the log has no time stamps")
            return Channel(ROW_NUMBER, unit, scale=scale)
        column = statement.column or self.table.clock()
        if not column:
            text = "No column rises as a clock does: how long is one sample?"
            option = '--period-ms 4, or --column "time=NAME [s]"'
            self.questions.append(Question("time", "period", text, ("4 ms",), option))
            return None
        place = self.place("time") if statement.column else None
        if place is None:
            place = self.table.place(column, "time")
        is_time = names_time(self.table.name(place))
        # The median: gaps or stamps that jump back are left to the reader.
        step = float(np.median(np.abs(np.diff(self.cells(place)))))
        if not step > 0:
            raise LogError(
                "column of time",
                self.label(place),
                "the same in most samples",
                "time stamps that rise",
                "state another column, or --period-ms 4",
            )
        rate = f"a sample every {step * scale:.6g}"
        sure: Certainty = "certain" if is_time else "likely"
        name = self.label(place)
        self.conclude("time", name, "stated" if statement.column else sure, rate)
        own = statement.unit or self.unit(place)
        fitting = [
            unit
            for unit, size in UNITS["time"].items()
            if _FASTEST <= step * scale * size <= _SLOWEST
        ]
        # A column that increases by one may count samples or milliseconds; it is a
        # clock only if its name says so.
        counter = step == 1.0 and not is_time
        # The unit in the name applies unless no arm is sampled that slowly: then
        # milliseconds were exported under a name for seconds.
        valid = own in UNITS["time"]
        if statement.unit or own in fitting or (valid and not fitting):
            self.conclude("unit of time", own, "stated", f"{rate} {own}")
            return Channel(name, own, scale=scale)
        if len(fitting) == 1 and not counter and not valid:
            why = f"{rate}: of s, ms, us and ns the one in which arms are sampled"
            self.conclude("unit of time", fitting[0], "likely", why)
            return Channel(name, fitting[0], scale=scale)
        text = f"{name} rises by {step:.6g}" + (f" {own} by its name" if own else "")
        if counter:
            text, example = f"{text}: how long is one step?", f"{name} * 0.004 [s]"
            self.ask("time", "unit", text, ("4 ms",), f"time={example}")
        else:
            text += ": in which unit?"
            self.ask("time", "unit", text, ("s", "ms", "us"), f"time={name} [ms]")
        return None

    # --- which column is the motor angle, which the output ---

    def signals(self, time: Channel | None) -> dict[str, int]:
        """The places of the motor angle and of the output, as far as they are stated or
        match; otherwise a question is added.
        """
        parts = {"motor_angle": "motor angle", "output": "output"}
        places = {r: k for r in parts if (k := self.place(r)) is not None}
        free = self.free(time, next(iter(places.values()), None))
        open_roles: dict[str, list[Candidate]] = {}
        for role, part in parts.items():
            if role in places:
                self.conclude(part, self.label(places[role]), "stated", "as stated")
                continue
            others = [k for k in free if k not in places.values()]
            partners = [k for k in free if k in places.values()]
            if role == "motor_angle":
                partners = partners or self.candidates("output", free, _UNNAMED)
            named = self.candidates(role, others, _UNNAMED)
            group = self.pairs.by_vibration(role, named, partners)
            if role == "output" and named and group[0].rest > CLEARLY_LESS:
                # The name may fit, but another column may hold the link's output.
                rivals = self.candidates(role, {*others} - {*named}, _UNLIKELY)
                clearer = self.pairs.by_vibration(role, rivals, partners)[:1]
                if clearer and clearer[0].rest < CLEARLY_LESS * group[0].rest:
                    named, group = [], [*clearer, *group]
            if self.is_absent(role) or not named:
                unnamed = self.candidates(role, others, _UNLIKELY)
                group = group or self.pairs.by_vibration(role, unnamed, partners)
                open_roles[role] = [] if self.is_absent(role) else group
            elif len(group) > 1 and group[0].rest > CLEARLY_LESS * group[1].rest:
                open_roles[role] = group
            else:
                place = places[role] = group[0].place
                name, label = self.table.name(place), self.label(place)
                evidence = f"its name says {self.table.roles[place][1]!r}"
                evidence += f": {name}" if name != label else ""
                sure: Certainty = "stated" if stated_by(name)[0] else "likely"
                self.conclude(part, label, sure, evidence)
        if time is not None and not all(open_roles.values()):
            missing = next(role for role, choices in open_roles.items() if not choices)
            angle = places.get("motor_angle")
            raise dead_end(self, time, angle, free, self.table.roles, missing)
        first = ""
        for role, choices in open_roles.items():
            # A column suggested by one question must not be suggested by another.
            labels = [choice.text for choice in choices]
            labels.sort(key=lambda name: name == first)
            first = next(iter(labels), "NAME")
            text = "Which column is the motor angle, and in which unit?"
            example = f"motor_angle={first} [deg]"
            if role == "output":
                text = "Which column is the link's output, its torque or deflection?"
                example = f'torque={first} [Nm]" or "deflection={first} [raw]'
                if first not in map(self.label, free):  # a difference of two angles
                    example = f"deflection={first} [deg]"
            self.ask(role, "column", text, labels, example)
        return places

    def candidates(self, role: str, free: Iterable[int], most: int) -> list[int]:
        """The places among `free` whose names match a role best, with a rank below
        `most`.
        """
        ranks = {place: self.rank(role, place) for place in sorted(free)}
        best = min(ranks.values(), default=most)
        return [place for place, rank in ranks.items() if rank == best < most]

    def rank(self, role: str, place: int) -> int:
        """The rank of a name for a role: below `_UNNAMED` it matches."""
        meaning, word = self.table.roles[place]
        name = self.table.name(place)
        # Of two angles the one at the motor's side is needed.
        hub = {"motor", "hub", "m", "joint"} & set(words_of(name))
        ranks = {"motor_angle": 0 if hub else 1, "the tip": _UNNAMED}
        if role == "output":
            ranks = {"torque": 0, "deflection": 0, "the tip": 1}
            ranks["motor_angle"] = _UNNAMED
        # What moves by over half its range in one sample has no inertia: it is a command.
        elif self.table.is_switched(place):
            return _UNLIKELY
        # Never a commanded value, nor a measurement of something else. Names of one
        # letter are conventions with little meaning: u may be any input. Volts are the
        # unit of sensors, too.
        habit = not meaning or len(name) == 1 or word in UNITS["voltage"]
        return ranks.get(meaning, _UNNAMED if habit else _UNLIKELY)

    def free(self, time: Channel | None, stated: int | None) -> list[int]:
        """The places of the signals: columns as long as the time that move, without
        duplicates.
        """
        table, clock = self.table, None
        if time is not None and time.column != ROW_NUMBER:
            clock = table.place(time.column, "time")
        of_length = clock if clock is not None else stated
        length = (
            max(values.size for values in table.values)
            if of_length is None
            else table.values[of_length].size
        )
        places: list[int] = []
        # Columns with names first: of two equal columns the one with the better name is
        # kept.
        order = range(len(table.names))
        for place in sorted(order, key=lambda k: not self.table.roles[k][0]):
            values = table.values[place]
            # A column that only increases is another clock, unless its name denotes a
            # quantity other than time.
            has_role = self.table.roles[place][0] and not names_time(table.name(place))
            rises = clock_step(values) is not None and not has_role
            again = any(table.repeats(place, k) for k in places)
            signal = values.size == length and moves(values)
            if place != clock and signal and not rises and not again:
                places.append(place)
        return sorted(places)

    # --- the motor angle ---

    def motor_angle(self, place: int) -> Channel | None:
        """The channel of the motor angle; None if its unit is a question."""
        statement, own = self.statement("motor_angle"), self.unit(place)
        name, raw = self.label(place), self.cells(place)
        sign, scale = statement.sign or 1, statement.scale or 1.0
        reach = float(np.abs(raw - raw[0]).max())
        unit = statement.unit or (own if own in UNITS["angle"] else "")
        part = "unit of the motor angle"
        if unit:
            source = "as stated" if statement.unit else "by its name"
            evidence = f"{source}; it moves by {scale * reach:.4g} {unit}"
            self.conclude(part, unit, "stated", evidence)
            return Channel(name, unit, sign=sign, scale=scale)
        if length := length_of_name(self.table.name(place)):
            # With any assumed radius a length becomes an angle; only the gain depends
            # on it.
            value = f"1 rad for 1 m of {name}"
            why = "a linear axis: frequency, order and delay do not depend on the lever"
            self.conclude(part, value, "assumed", why)
            return Channel(name, "rad", sign=sign, scale=UNITS["length"][length])
        text, example = f"{name} moves by {reach:.4g}: in which unit?", "[deg]"
        choices = ("rad", "deg")
        if own in UNITS["voltage"]:
            text = f"{name} is in volts: which angle is one volt?"
            choices, example = ("90 deg", "1.57 rad"), "* N [deg]"
        # Integers are counts, unless they are few: an angle in whole degrees.
        elif reach > math.tau and (raw == np.round(raw)).all():
            text = f"{name} counts: which angle is one count?"
            choices, example = ("1/4096 rev", "0.09 deg"), "* 1/N [rev]"
        example = f"motor_angle={name} {example}"
        self.ask("motor_angle", "unit", text, choices, example)
        return None

    def from_the_hub(self, channel: Channel, angle: int, output: int) -> int | None:
        """The place of the output, or of the deflection computed from it if it is the
        tip's angle in space; None if that is a question (the tip's position).
        """
        rest, difference = self.pairs.shared(angle, output)
        name = self.label(output)
        explicit = self.statement("output").column is not None
        # A difference of raw numbers would not be an angle.
        if explicit or channel.scale != 1 or channel.sign != 1 or difference == name:
            return output
        if length := length_of_name(self.table.name(output)):
            text = (
                f"{name} moves with the motor, so it sees the tip in space: how far does "
                f"1 {length} of it turn the arm?"
            )
            example = f"deflection={channel.column} - K * {name} [{channel.unit}]"
            self.ask("output", "column", text, (name,), example)
            return None
        why = f"the motor angle minus {name} is one vibration ({100 - 100 * rest:.3g} %): the tip in space"
        self.guesses = [each for each in self.guesses if each.part != "output"]
        self.conclude("output", difference, "likely", why)
        return self.add(difference, channel.unit)

    # --- the output ---

    def output(
        self, place: int, mode: Fit | None
    ) -> tuple[OutputKind, str, float] | None:
        """Torque or deflection, its unit and the factor to it; None if that is a
        question.
        """
        statement, own = self.statement("output"), self.unit(place)
        unit, scale = statement.unit or own, statement.scale or 1.0
        name, part = self.label(place), "output measures"
        source = "as stated" if statement.unit else "by its name"
        gain = abs(mode.gain) if mode is not None else 0.0
        torque = statement.role == "torque"
        if unit in UNITS["torque"] or (torque and statement.unit):
            size = gain * scale * UNITS["torque"].get(unit, 1.0)
            source += f"; {size:.3g} N·m/rad" if mode else ""
            self.conclude(part, f"torque [{unit}]", "stated", source)
            return "torque", unit, scale
        # `LogColumns` rejects a unit of another quantity.
        if unit in UNITS["angle"] or (statement.unit and statement.unit != "raw"):
            calibrated = gain * scale * UNITS["angle"].get(unit, 1.0)
            # A deflection θm − θt has a gain of 1 on the motor angle, and of 57 if
            # degrees are taken for radians: the limit is halfway between the two on a
            # logarithmic scale.
            degree = UNITS["angle"]["deg"]
            odd = gain and not degree < calibrated**2 < 1 / degree
            if odd and not statement.unit:
                text = (
                    f"{name} is in {own} by its name, but {calibrated:.3g} times the "
                    "motor angle: in which unit? (Or state motor_angle=NAME * 1/N, if "
                    "that angle is measured before a gear.)"
                )
                example = f"deflection={name} [deg]"
                self.ask("output", "unit", text, ("rad", "deg", "raw"), example)
                return None
            source += (
                f"; gain {calibrated:.3g} on the motor angle, 1 in theory"
                if gain
                else ""
            )
            self.conclude(part, f"deflection [{unit}]", "stated", source)
            return "deflection", unit, scale
        role = self.table.roles[place][0]
        beside = self.statement("motor_angle").unit or ""
        if role == "motor_angle" and beside in UNITS["angle"] and not statement.unit:
            why = "named as an angle: in the unit of the motor angle"
            self.conclude(part, f"deflection [{beside}]", "likely", why)
            return "deflection", beside, scale
        if (torque or role == "torque") and statement.unit != "raw":
            text = f"{name} is a torque: in which unit? (raw: not calibrated)"
            example = f'torque={name} [Nm]" or "torque={name} [mNm]'
            self.ask("output", "unit", text, ("Nm", "mNm", "raw"), example)
            return None
        if not gain:
            raise LogError(
                "column of output",
                name,
                "not calibrated, and no vibration that the motor's motion explains could scale it",
                "Nm, mNm, rad or deg",
                f'state --column "torque={name} [Nm]" or "deflection={name} [deg]"',
            )
        # A sensor without a unit is scaled so that its gain on the motor angle is that
        # of a deflection. Four digits, as in a usual calibration; the gain itself is
        # known to one per cent.
        scale = float(f"{1 / gain:.4g}")
        length = length_of_name(self.table.name(place))
        what = (
            f"a link of {gain:.3g} {length}" if length else f"{name} is not calibrated"
        )
        why = (
            f"{what}: scaled to a gain of 1 on the motor angle, as a deflection has; "
            "frequency, order and delay do not depend on it"
        )
        self.conclude(part, f"deflection, {scale:g} rad each", "assumed", why)
        return "deflection", "rad", scale

    def sign(self, mode: Fit | None) -> Literal[1, -1]:
        """The sign with which the output is positive while the motor accelerates."""
        # While the motor accelerates, the link is bent backwards, and Γ = c(θm − θt) is
        # positive: the sign convention of rig and law.
        sign: Literal[1, -1] = -1 if mode is not None and mode.gain < 0 else 1
        way = "with" if sign > 0 else "against"
        sure: Certainty = "certain"
        why = f"it goes {way} the motor's acceleration"
        if mode is not None:
            frequency = mode.model.natural_frequency
            explained = f"explains {100 * share_of(mode):.3g} % of the output"
            self.conclude("vibration", f"{frequency:.3g} rad/s", "certain", explained)
        if explicit := self.statement("output").sign:
            sign, sure, why = explicit, "stated", "as stated"
        elif mode is None or phase(mode) > LATE:
            sure = "assumed"
            why = "no vibration shows it" if mode is None else "it responds late"
            why += ": state a minus, as in torque=-bridge [mNm], if it is reversed"
        self.conclude("sign of the output", "+" if sign > 0 else "-", sure, why)
        return sign

    def voltage(self, angle: Real, *, taken: tuple[int, int]) -> Channel | None:
        """The channel of the amplifier's voltage, if a column has such a name; a fit of
        the link does not need it.
        """
        table, statement = self.table, self.statement("voltage")
        place = self.place("voltage")
        roles = enumerate(self.table.roles)
        voltages = [k for k, (role, _) in roles if role == "voltage" and k not in taken]
        if place is None and len(voltages) == 1:
            place = voltages[0]
        if place is None or table.values[place].size != angle.size:
            return None
        raw, own, name = table.values[place], self.unit(place), self.label(place)
        unit = statement.unit or (own if own in UNITS["voltage"] else "")
        if not np.isfinite(raw).all() or not moves(raw):
            return None
        # A motor mostly turns in the direction of its voltage, but a servo also brakes.
        relation = float(np.corrcoef(raw, np.gradient(angle))[0, 1])
        sign: Literal[1, -1] = statement.sign or (-1 if relation < -SHOWN else 1)
        evidence = f"correlation {relation:.2g} with the motor's speed"
        value = f"{'-' if sign < 0 else ''}{name} [{unit or 'V'}]"
        self.conclude("voltage", value, "stated" if unit else "likely", evidence)
        return Channel(name, unit or "V", sign=sign, scale=statement.scale or 1.0)
