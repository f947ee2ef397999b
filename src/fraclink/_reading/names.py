"""The meaning of column names: the quantity that a name usually denotes, and the unit
at its end.

Names are hints: `start` uses them and asks where they are ambiguous. `read_log` takes
only names such as ``motor_angle_rad`` as stated.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence

from fraclink._arm.log_columns import UNITS, UNITS_OF

# Words used in logs, English and German. A word of at least three letters also matches
# at the beginning of a longer one, a word of at least five letters anywhere in it.
_ROLES = {
    "torque": (
        *("torque", "gamma", "moment", "effort", "nm", "drehmoment", "tau"),
        *("torsion", "m"),
    ),
    "deflection": (
        *("deflection", "alpha", "strain", "gauge", "bend", "bridge", "flex", "defl"),
        *("dehnung", "dms", "biegung", "auslenkung", "bruecke", "brücke", "eps"),
    ),
    "motor_angle": (
        *("theta", "pot", "enc", "position", "angle", "hub", "joint", "phi", "pos"),
        *("winkel", "cart", "carriage", "slider", "schlitten", "axis", "achse"),
        *("thm", "th", "q"),
    ),
    "voltage": ("volt", "command", "spannung", "vin", "umot", "vm", "um", "u", "v"),
}
# Words that give a column another meaning, whatever other words are in its name.
_OTHER = {
    "a commanded value": (
        *("ref", "cmd", "set", "target", "desired", "reference", "setpoint", "soll"),
        *("sollwert", "command", "demand", "sim", "simulated"),
    ),
    "a speed": (
        *("speed", "velocity", "vel", "omega", "rpm", "drehzahl", "geschwindigkeit"),
        *("dot", "rate", "dq"),
    ),
    "an acceleration": (
        *("acc", "accel", "acceleration", "accelerometer", "beschleunigung", "imu"),
    ),
    "a current": ("current", "strom", "amps"),
    "a temperature": ("temp", "temperature", "temperatur"),
}
_TIP = ("tip", "endpoint", "spitze", "laser", "camera", "kamera")
# After the name of another column they mark its desired value.
_DESIRED = ("d", "des", "r", "sp")
_TIME = (
    *("time", "t", "zeit", "timestamp", "stamp", "seconds", "sec", "millis", "micros"),
    *("ms", "tempo", "temps"),
)
# Spellings of the units of `UNITS` and of frequency responses, in lower case and
# without blanks, dots and stars. Units with a prefix are listed only if lower case is
# unambiguous: mhz may be milli or mega.
_SPELLINGS = {
    **dict.fromkeys(("sec", "secs", "second", "seconds", "sek", "sekunden"), "s"),
    **dict.fromkeys(("msec", "millis", "milliseconds"), "ms"),
    **dict.fromkeys(("usec", "µs", "μs", "micros", "microseconds"), "us"),
    **dict.fromkeys(("deg", "degree", "degrees", "grad", "°"), "deg"),
    **dict.fromkeys(("rad", "radian", "radians"), "rad"),
    **dict.fromkeys(("turns", "revolutions", "umdrehungen"), "rev"),
    **dict.fromkeys(("nm",), "Nm"),
    **dict.fromkeys(("mnm", "nmm"), "mNm"),
    **dict.fromkeys(("volt", "volts"), "V"),
    **dict.fromkeys(("millivolt", "millivolts"), "mV"),
    **dict.fromkeys(("hz", "hertz"), "Hz"),
    **dict.fromkeys(("khz", "kilohertz"), "kHz"),
    **dict.fromkeys(("rad/s", "rads", "rad/sec", "radian/s"), "rad/s"),
    **dict.fromkeys(("db", "decibel"), "dB"),
    **dict.fromkeys(("-", "abs", "lin", "linear", "v/v"), "1"),
}
# Units of the columns of a log.
KNOWN = frozenset(unit for units in UNITS_OF.values() for unit in units)
# Units at the end of a name that no reader converts. If they were not recognised, a
# time in minutes would be read as seconds.
_UNITS_ELSEWHERE = KNOWN | {
    *("Hz", "rad/s", "dB", "rpm", "%", "mm", "cm", "um", "µm", "N", "kg"),
    *("min", "mins", "minute", "minutes", "h", "hr", "hrs", "hour", "hours", "day"),
    *("days", "tick", "ticks", "count", "counts", "samples"),
}
# in upper or lower case: GHZ and ghz are units too, although none that can be converted
_PREFIXES = "kmgtuµnp"


def words_of(name: str) -> tuple[str, ...]:
    """The words of a name in lower case, split at signs, digits and capitals.

    >>> words_of("motorAngle2 [deg]"), words_of("theta_ref")
    (('motor', 'angle', 'deg'), ('theta', 'ref'))
    """
    # Only after a lower-case letter: VIEW and GHZ must not fall apart into single
    # letters.
    spaced = re.sub(r"(?<=[a-zäöüß])(?=[A-Z])", " ", name)
    return tuple(word.lower() for word in re.split(r"[\W\d_]+", spaced) if word)


def unit_of_name(name: str, known: Collection[str] = KNOWN) -> str:
    """The unit in brackets or at the end of a name, in the spelling of `known` (or
    `UNITS`), or "".

    >>> [unit_of_name(name) for name in ("Zeit (Sekunden)", "moment [N m]", "alpha_deg", "s")]
    ['s', 'Nm', 'deg', '']
    """
    spelled = (_spelled(ending, known) for ending in _endings(name))
    return next(filter(None, spelled), "")


def stated_unit(name: str, known: Collection[str]) -> str:
    """The unit stated by a name, spelled as in `known`; if it is not in `known`, as in
    the name.

    >>> [stated_unit(name, ("s", "ms")) for name in ("t [ms]", "time_min", "t [kg]", "time_stamp", "time")]
    ['ms', 'min', 'kg', '', '']
    """
    square = name.strip().endswith("]")
    others = (text for text in _endings(name) if square or _is_unit(text))
    return unit_of_name(name, known) or next(others, "")


def _endings(name: str) -> list[str]:
    """The endings of a name that may be its unit, the longest first.

    The ends of "omega_rad_per_s" are "rad/s" and "s". Text in round brackets may be an
    argument, as in "Re(H)"; text in square brackets is always a unit.
    """
    if bracketed := re.search(r"[\[(]([^\])]*)[\])]\s*$", name):
        inside = bracketed[1].strip()
        # "(Theta in rad)" ends with its unit.
        return [inside, *inside.split()[-1:]] if inside else []
    # Without the first part, which is the name itself: a column "s" is not a unit.
    parts = [part for part in re.split(r"[_ /.\-]+", name.strip()) if part != "per"]
    return ["/".join(parts[k:]) for k in range(1, len(parts)) if parts[k]]


def _spelled(text: str, spellings: Collection[str]) -> str:
    """A unit in its spelling among `spellings`, or ""."""
    # N m, N.m, N·m, N-m and N*m are one unit.
    plain = re.sub(r"[ .·*⋅]|(?<=N)-", "", text)
    own = _SPELLINGS.get(plain.lower(), "")
    return next((unit for unit in (text, plain, own) if unit in spellings), "")


def _is_unit(text: str) -> bool:
    """Whether a string is a unit or a quotient of units, with or without a prefix."""
    parts = text.split("/", 1)
    if len(parts) == 2 and all(map(_is_unit, parts)):
        return True
    base = text[1:] if text[:1].lower() in _PREFIXES else ""
    return any(_spelled(unit, _UNITS_ELSEWHERE) for unit in (text, base) if unit)


def length_of_name(name: str) -> str:
    """The unit of length at the end of a name, or ""; "m" alone may be the motor, as in
    theta_m.

    >>> [length_of_name(name) for name in ("laser_mm", "tip [m]", "cart_m", "theta_m", "x_V")]
    ['mm', 'm', 'm', '', '']
    """
    unit = next((each for each in _endings(name) if each in UNITS["length"]), "")
    # theta_m is the motor angle in many papers: there "m" is a unit of length only in
    # brackets.
    angle = {"theta", "th", "angle", "enc", "q", "pot"} & set(words_of(name))
    return "" if unit == "m" and angle and not re.search(r"[\[(]", name) else unit


def names_time(name: str) -> bool:
    """Whether a name is a usual one for time stamps."""
    return any(word in _TIME for word in words_of(name))


def role_of_name(name: str) -> tuple[str, str]:
    """The role suggested by a name, or "", and the decisive word.

    A quantity without a role (a speed, a reference, the tip) is returned by its
    description: "a speed".

    >>> role_of_name("theta_ref"), role_of_name("Motorwinkel"), role_of_name("x7")
    (('a commanded value', 'ref'), ('motor_angle', 'winkel'), ('', ''))
    """
    unit, ending = unit_of_name(name), next(filter(_is_unit, _endings(name)), "")
    words = words_of(name[: name.rfind(ending)] if ending in name else name)
    by_words = _by_words(words, unit)
    # Potentiometers and strain gauges are also read in volts; only a column that is no
    # sensor is the voltage of the motor.
    if by_words[0] in ("", "voltage") and unit in UNITS["voltage"]:
        return "voltage", by_words[1] or unit
    if by_words == ("voltage", "command"):
        return by_words
    for meaning, hints in _OTHER.items():
        if word := next((word for word in words if word in hints), ""):
            return meaning, word
    if words[:1] == ("d",) and by_words[0]:
        return "a speed", "d"
    if unit in UNITS["torque"]:
        return "torque", unit
    # A deflection of the tip is measured from the hub; for a tip alone the origin is
    # unknown.
    tip = next((word for word in words if word in _TIP), "")
    if tip and by_words[0] != "deflection":
        return "the tip", tip
    if not by_words[0] and unit in UNITS["angle"] and "motor" in words:
        return "motor_angle", "motor"
    return by_words


def roles_of(names: Sequence[str]) -> list[tuple[str, str]]:
    """`role_of_name` of each; beside a column theta, theta_d and theta_r are commanded
    values.
    """
    roles = [role_of_name(name) for name in names]
    lower = {name.lower() for name in names}
    for place, name in enumerate(names):
        plain = re.sub(r"[\[(].*", "", name.lower()).strip()
        first, _, last = plain.rpartition("_")
        ending = name.lower()[len(plain) :]
        if last in _DESIRED and {first, first + ending} & lower:
            roles[place] = "a commanded value", last
    return roles


def _by_words(words: Sequence[str], unit: str) -> tuple[str, str]:
    # A column in degrees is neither a torque nor a voltage.
    others = {"torque", "voltage"} if unit in UNITS["angle"] else ()
    roles = {role: hints for role, hints in _ROLES.items() if role not in others}
    # In this order, because a name may hold words of two roles: "joint_effort" is a
    # torque, not an angle.
    for role, hints in roles.items():
        for hint in hints:
            if len(hint) >= 3 and any(_hits(word, hint) for word in words):
                return role, hint
    # Of symbols of one or two letters the first counts, the others are its indices: q_m
    # and th_m are angles of the motor, M_z is a torque.
    for word in words:
        for role, hints in roles.items():
            if word in hints:
                return role, word
    return "", ""


def _hits(word: str, hint: str) -> bool:
    return word.startswith(hint) or (len(hint) >= 5 and hint in word)
