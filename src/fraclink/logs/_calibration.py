"""Unit, kind and sign of a log's columns, as far as names, ranges and the vibration in
the log show them.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.log_columns import UNITS, Channel, ColumnStatement, OutputKind
from fraclink._reading.names import (
    UNITS_OF_LENGTH,
    length_of_name,
    role_of_name,
    words_of,
)
from fraclink.errors import LogError
from fraclink.logs._channels import Mode, find_mode
from fraclink.logs._tips import CLEARER, TIP
from fraclink.logs._weighing import Certainty, Question, Weighing

__all__ = [
    "STRONG",
    "check_no_tip_angle",
    "guess_angle",
    "guess_output",
    "guess_voltage",
]

Array = NDArray[np.float64]

STRONG, _WEAK = (
    0.6,
    0.3,
)  # share of an output that one vibration explains: surely the output; not shown
_SURE = 0.8  # share from which no noise turns the sign
# factor by which the gain of a deflection may differ from 1 where its unit is the
# angle's
_ONE_UNIT = 3.0
_LATE = 0.12  # of a vibration: a later answer could as well be one of the other sign
# Stiffness of links in laboratories [N·m/rad]; in mN·m the number is a thousand times
# as large.
_SOFTEST, _STIFFEST = 0.02, 20.0
_SMALL_MOVE = 0.9  # an excitation that turns the motor by less than one degree is rare
_MOST_BENT = 3.0  # rad: no link bends by half a turn
_MANY_TURNS = 8 * math.pi  # that no cable of an arm follows
_LARGEST_TURN = 400.0  # degrees; beyond it they are counts, or millirad
_LARGEST_VOLTAGE = (
    60.0  # V of a servo-amplifier: more is millivolts or a converter's counts
)


def guess_angle(
    weighing: Weighing,
    place: int,
    raw: Array,
    stiffness: float = 0.0,
    bend: float = 0.0,
) -> Channel | None:
    """The channel of the motor angle; None where its unit is a question.

    `stiffness` is the gain of a torque on the angle as it stands [N·m], 0 where the
    output is none; `bend` is how far the link bends by it, in the angle's unit.
    """
    statement, own, name = (
        weighing.statement("motor_angle"),
        weighing.unit(place),
        weighing.label(place),
    )
    sign, reach = statement.sign or 1, float(np.abs(raw - raw[0]).max())
    unit = statement.unit or (own if own in UNITS["angle"] else "")
    if unit:
        source = "as stated" if statement.unit else "by its name"
        scale = statement.scale or 1.0
        evidence = f"{source}; it moves by {scale * reach:.4g} {unit}"
        weighing.conclude("unit of the motor angle", unit, "stated", evidence)
        return Channel(name, unit, sign=sign, scale=scale)
    # Whole numbers are counts where the motor moves by fifty of them: an angle in whole
    # degrees seldom does.
    counts = reach >= 50 and bool((raw == np.round(raw)).all())
    volts = own in UNITS["voltage"] or {"pot", "poti"} & set(words_of(name))
    if length := length_of_name(name):
        return _linear_axis(weighing, name, length, sign)
    # Between 0.9 and 2π both units are plausible motions, and a factor of 57 in c is no
    # place for a guess.
    if (
        not counts
        and not volts
        and (reach <= _SMALL_MOVE or 2 * math.pi < reach <= _LARGEST_TURN)
    ):
        unit = "rad" if reach <= _SMALL_MOVE else "deg"
        reason = "under one degree" if unit == "rad" else "more than a full turn"
        other = "degrees" if unit == "rad" else "radians"
        evidence = f"it moves by {reach:.4g}: as {other}, {reason}"
        # The stiffness decides where a torque tells one: a link of 1.5 N·m/rad would be
        # one of 0.026 if its degrees were radians.
        links = {
            each
            for each, size in UNITS["angle"].items()
            if each in ("rad", "deg")
            and _is_link(stiffness / size)
            and bend * size < _MOST_BENT
        }
        # As the other unit it would be a link as well, or as this one none.
        if stiffness and (
            unit not in links or (reach < _MANY_TURNS and len(links) > 1)
        ):
            _ask_by_stiffness(weighing, name, reach, stiffness)
            return None
        weighing.conclude("unit of the motor angle", unit, "likely", evidence)
        return Channel(name, unit, sign=sign)
    example, choices = "[deg]", ("rad", "deg")
    text = f"{name} moves by {reach:.4g}: in which unit?"
    if counts:
        text, example = f"{name} counts: which angle is one count?", "* 1/4096 [rev]"
        choices = ("1/4096 rev", "0.09 deg")
    elif volts:
        text, example = f"{name} is in volts: which angle is one volt?", "* 36.8 [deg]"
        choices = ("36.8 deg", "0.64 rad")
    option = f'--column "motor_angle={name} {example}"'
    weighing.ask(Question("motor_angle", "unit", text, choices, "", option))
    return None


def _is_link(stiffness: float) -> bool:
    return _SOFTEST < stiffness < _STIFFEST


def _ask_by_stiffness(
    weighing: Weighing, name: str, reach: float, stiffness: float
) -> None:
    in_degrees = stiffness / UNITS["angle"]["deg"]
    text = (
        f"{name} moves by {reach:.4g}, and the link would have {stiffness:.3g} N·m/rad if these are radians, "
        f"{in_degrees:.3g} if they are degrees: in which unit?"
    )
    option = f'--column "motor_angle={name} [deg]"'
    weighing.ask(Question("motor_angle", "unit", text, ("rad", "deg"), "", option))


def _linear_axis(
    weighing: Weighing, name: str, length: str, sign: Literal[1, -1]
) -> Channel | None:
    """The channel of a carriage: any radius makes an angle of its way, for all but the
    gain.
    """
    scale = UNITS_OF_LENGTH[length]
    text = f"{name} is a linear axis [{length}]: which angle of the root is 1 {length} of it?"
    option = (
        f'--column "motor_angle={name} * {scale / 0.1:g} [rad]" for a lever of 0.1 m'
    )
    question = Question(
        "motor_angle", "unit", text, (f"{scale:g} rad",), f"{scale:g} rad", option
    )
    if not weighing.ask(question):
        return None
    evidence = "a linear axis: frequency, order and delay do not depend on the lever"
    weighing.conclude(
        "unit of the motor angle", f"1 rad for 1 m of {name}", "assumed", evidence
    )
    return Channel(name, "rad", sign=sign, scale=scale)


def check_no_tip_angle(
    weighing: Weighing, place: int, angle: Array, output: Array, period: float
) -> None:
    """Refuse an output that is the tip's angle: motor and tip angle differ by what
    vibrates.

    A tip angle θt = θm − (deflection) rings as a deflection of the other sign does, and
    would pass for one. Both arguments are in radians, `output` as if its unit were that
    of the motor angle.
    """
    if weighing.unit(place) in (*UNITS["torque"], *UNITS["voltage"]):
        return
    # A deflection δ = θm − θt answers an acceleration with a positive gain, a tip angle
    # with a negative one; what is left of θm by subtracting it is then the positive
    # one.
    itself, rest = (
        find_mode(angle, output, period),
        find_mode(angle, angle - output, period),
    )
    if itself is None or rest is None or itself.gain > 0 or rest.gain < 0:
        return
    if rest.share > TIP and rest.share > itself.share + CLEARER:
        raise LogError(
            "column of output",
            weighing.label(place),
            "the angle of the tip: the motor angle less it is what vibrates",
            allowed="the torque at the base, or the deflection: motor angle less tip angle",
            remedy="state that difference as the deflection, as in "
            '--column "deflection=motor_angle_column - tip_angle_column [deg]"',
        )


def guess_output(
    weighing: Weighing, place: int, mode: Mode | None
) -> tuple[OutputKind, Channel] | None:
    """Kind and channel of the output, and what the vibration says of its sign and
    delay.
    """
    statement, name = weighing.statement("output"), weighing.label(place)
    share = 0.0 if mode is None else mode.share
    found = _kind_and_unit(weighing, place, mode)
    if found is None:
        return None
    kind, unit, scale = found
    sign = statement.sign or _sign(weighing, name, kind, mode)
    if mode is not None and share >= _WEAK:
        sure: Certainty = "certain" if share > STRONG else "likely"
        text = f"explains {100 * share:.3g} % of the output"
        weighing.conclude("vibration", f"{mode.frequency:.3g} rad/s", sure, text)
    return kind, Channel(name, unit, sign=sign, scale=scale)


def _kind_and_unit(
    weighing: Weighing, place: int, mode: Mode | None
) -> tuple[OutputKind, str, float] | None:
    """Torque or deflection, its unit and the factor to it; None where that is a
    question.
    """
    statement, own = weighing.statement("output"), weighing.unit(place)
    unit = statement.unit or own
    if unit in UNITS["torque"] or (statement.role == "torque" and statement.unit):
        gain = (
            abs(mode.gain) * (statement.scale or 1.0) * UNITS["torque"].get(unit, 1.0)
            if mode
            else 0.0
        )
        odd = mode is not None and mode.share >= STRONG and not _is_link(gain)
        evidence = _by(statement) + (
            f"; {gain:.3g} N·m/rad, which few links have" if odd else ""
        )
        weighing.conclude(
            "output measures",
            f"torque [{unit}]",
            "likely" if odd else "stated",
            evidence,
        )
        return "torque", unit, statement.scale or 1.0
    gain = abs(mode.gain) if mode is not None and mode.share >= _WEAK else 0.0
    calibrated = gain * (statement.scale or 1.0) * (UNITS["angle"].get(unit, 1.0))
    # A deflection θm − θt has the gain 1 on the motor angle in theory. A factor of 20
    # is no error of calibration; one of 57 is degrees taken for radians.
    in_line = not gain or 1 / 20 < calibrated < 20
    if unit in UNITS["angle"] and (in_line or statement.unit):
        evidence = _by(statement) + (
            f"; gain {calibrated:.3g} on the motor angle, 1 in theory" if gain else ""
        )
        weighing.conclude("output measures", f"deflection [{unit}]", "stated", evidence)
        return "deflection", unit, statement.scale or 1.0
    if statement.unit and statement.unit != "raw":
        return (
            "deflection",
            statement.unit,
            statement.scale or 1.0,
        )  # `LogColumns` refuses the unit
    if own in UNITS["angle"] and not statement.unit:
        _ask_angle_unit(weighing, place, own, calibrated)
        return None
    length = length_of_name(weighing.table.names[place])
    found = None if statement.unit or length else _by_gain(weighing, place, gain, own)
    return found or _uncalibrated(weighing, place, gain)


def _ask_angle_unit(weighing: Weighing, place: int, own: str, gain: float) -> None:
    """Ask about a deflection whose gain on the motor angle its own unit and the angle's
    make impossible.
    """
    name = weighing.label(place)
    text = f"{name} is in {own} by its name, but {gain:.3g} times what the motor turns: in which unit?"
    option = f'--column "deflection={name} [deg]", or the unit of the motor angle'
    weighing.ask(Question("output", "unit", text, ("rad", "deg", "raw"), "", option))


def _by(statement: ColumnStatement) -> str:
    return "as stated" if statement.unit else "by its name"


def _by_gain(
    weighing: Weighing, place: int, gain: float, own: str
) -> tuple[OutputKind, str, float] | None:
    """What a name without a unit and the gain on the motor angle make likely."""
    statement, words = (
        weighing.statement("output"),
        words_of(weighing.table.names[place]),
    )
    role = (
        statement.role
        if statement.role in ("torque", "deflection")
        else role_of_name(weighing.table.names[place])[0]
    )
    if not gain or own in UNITS["voltage"]:
        return None
    if role == "torque":
        for unit, factor in (("Nm", 1.0), ("mNm", 1e-3)):
            if _SOFTEST < gain * factor < _STIFFEST:
                evidence = f"a stiffness of {gain * factor:.3g} N·m/rad, as links have"
                weighing.conclude(
                    "output measures", f"torque [{unit}]", "likely", evidence
                )
                return "torque", unit, 1.0
    raw = {"strain", "gauge", "bridge", "dms", "dehnung", "bruecke", "brücke"}
    if role == "deflection" and not raw & set(words):
        for unit in ("rad", "deg"):
            calibrated = gain * UNITS["angle"][unit]
            if 1 / _ONE_UNIT < calibrated < _ONE_UNIT:
                evidence = (
                    f"so its gain on the motor angle is {calibrated:.3g}, 1 in theory"
                )
                weighing.conclude(
                    "output measures", f"deflection [{unit}]", "likely", evidence
                )
                return "deflection", unit, 1.0
    return None


def _uncalibrated(
    weighing: Weighing, place: int, gain: float
) -> tuple[OutputKind, str, float] | None:
    """A sensor without a unit: asked for; or scaled so that it answers the motor angle
    as a deflection.
    """
    statement, name = weighing.statement("output"), weighing.label(place)
    text = f"What does {name} measure, and in which unit? (raw: not calibrated, scaled by the fit)"
    default = "raw" if gain else ""
    option = f'--column "torque={name} [Nm]", --column "deflection={name} [deg]" or "deflection={name} [raw]"'
    length = length_of_name(weighing.table.names[place])
    if length:
        size = f"{0.32 / UNITS_OF_LENGTH[length]:.4g}"
        text = f"{name} is a length: how long is the link? (raw: scaled by the fit)"
        option = f'--column "deflection={name} * 1/{size} [rad]" for a link of {size} {length}'
    if statement.unit != "raw":
        question = Question(
            "output", "unit", text, ("Nm", "mNm", "deg", "rad", "raw"), default, option
        )
        if not weighing.ask(question):
            return None
    if not gain:
        problem = "not calibrated, and without a vibration that could scale it"
        raise LogError(
            "column of output",
            name,
            problem,
            allowed="Nm, mNm, rad or deg",
            remedy=f"state {option}",
        )
    # Four digits, as people write a calibration: the gain itself is known to a percent.
    scale = float(f"{1 / gain:.4g}")
    weighing.conclude(
        "output measures",
        f"deflection, {scale:g} rad each",
        "assumed",
        (
            f"a link of {gain:.3g} {length}: "
            if length
            else f"{name} is not calibrated: "
        )
        + "scaled to a gain of 1 on the motor angle, as a deflection has; "
        "frequency, order and delay do not depend on it",
    )
    return "deflection", "rad", scale


def _sign(
    weighing: Weighing, name: str, kind: str, mode: Mode | None
) -> Literal[1, -1]:
    """The sign with which the output is positive where the motor speeds up."""
    shown = mode is not None and mode.share >= _WEAK
    # Where the motor speeds up the link is bent backwards, and Γ = c(θm − θt) is
    # positive: the sign convention of rig and law.
    sign: Literal[1, -1] = -1 if mode is not None and shown and mode.gain < 0 else 1
    mark, part = "+" if sign > 0 else "-", "sign of the output"
    if mode is None or not shown or mode.delay * mode.frequency > 2 * math.pi * _LATE:
        text = f"Is {name} positive where the motor speeds up forward? The log does not show it."
        option = f'--column "{kind}=-{name} [unit]", or + for as it is'
        if weighing.ask(Question("output", "sign", text, ("+", "-"), mark, option)):
            weighing.conclude(
                part,
                mark,
                "assumed",
                "no vibration, or one that answers too late to tell",
            )
        return sign
    way = "with" if sign > 0 else "against"
    sure: Certainty = "certain" if mode.share > _SURE else "likely"
    weighing.conclude(part, mark, sure, f"it goes {way} the motor's acceleration")
    return sign


def guess_voltage(
    weighing: Weighing, angle: Array, *, taken: Collection[int] = ()
) -> Channel | None:
    """The channel of the amplifier's voltage, where the log has one; a fit of the link
    does not need it.

    `taken` are the places of angle and output: a column ``u`` that was stated to be one
    of them is not one.
    """
    table, statement = weighing.table, weighing.statement("voltage")
    place = weighing.place(statement)
    named = (
        p for p, name in enumerate(table.names) if role_of_name(name)[0] == "voltage"
    )
    found = [p for p in named if p not in taken]
    if place is None and len(found) == 1:
        place = found[0]
    if place is None or table.values[place].size != angle.size:
        return None
    raw, own = table.values[place], weighing.unit(place)
    if not np.isfinite(raw).all():
        return None
    unit = statement.unit or (own if own in UNITS["voltage"] else "")
    if not unit and np.abs(raw).max() > _LARGEST_VOLTAGE:
        return None
    # A motor runs where its voltage drives it. Of a servo that brakes as often as it
    # drives the correlation is small: −0.2 is what a wrong sign is at least.
    speed = np.gradient(angle)
    spread = float(np.std(raw) * np.std(speed))
    relation = (
        float(np.mean((raw - raw.mean()) * (speed - speed.mean()))) / spread
        if spread
        else 0.0
    )
    sign: Literal[1, -1] = statement.sign or (-1 if relation < -0.2 else 1)
    evidence = f"correlation {relation:.2g} with the motor's speed"
    sure: Certainty = "stated" if unit else "likely"
    weighing.conclude(
        "voltage",
        f"{'-' if sign < 0 else ''}{weighing.label(place)} [{unit or 'V'}]",
        sure,
        evidence,
    )
    return Channel(
        weighing.label(place), unit or "V", sign=sign, scale=statement.scale or 1.0
    )
