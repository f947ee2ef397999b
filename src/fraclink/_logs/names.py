"""What the name of a column says: the quantity that loggers call so, and the unit at its end.

Names are hints. `inspect_log` prints what they suggest, `start` weighs them against the values; only names
such as ``motor_angle_rad`` count as stated.
"""

from __future__ import annotations

import re

from fraclink._arm.log_columns import QUANTITY_OF, UNITS

__all__ = ["COMMANDED", "HINTS", "role_of_name", "unit_in", "unit_of_name", "words_of"]
__all__ += ["names_time"]

# Words that loggers use, English and German; the time is known by its values: they never decrease.
HINTS = {
    "motor_angle": (
        *("motor_angle", "theta", "pot", "enc", "position", "angle", "hub", "joint", "winkel", "phi", "pos"),
    ),
    "torque": ("torque", "gamma", "moment", "effort", "nm", "drehmoment"),
    "deflection": (
        *("deflection", "alpha", "strain", "gauge", "bend", "bridge", "flex", "dehnung", "dms", "biegung"),
        *("auslenkung", "bruecke", "brücke"),
    ),
    "voltage": ("volt", "u_v", "vm", "motor_v", "command", "spannung"),
}
COMMANDED = ("ref", "cmd", "set", "target", "desired")  # what was asked for is not what was measured

# Words of whole names that exclude a column from being guessed, by what they mean. Of a tip angle the
# deflection θm − θt can be made; until it is, the column is no output that a link model is fitted to.
_OTHER = {
    "a commanded value": (*COMMANDED, "reference", "setpoint", "soll", "sollwert", "command", "demand"),
    "the tip": ("tip", "endpoint", "spitze", "laser", "camera", "kamera"),
    "a speed": ("speed", "velocity", "vel", "omega", "rpm", "drehzahl", "geschwindigkeit", "dtheta"),
    "an acceleration": ("acc", "accel", "acceleration", "beschleunigung"),
    "a current": ("current", "strom", "amps"),
    "a temperature": ("temp", "temperature", "temperatur"),
}
_TIME = (
    "time",
    "t",
    "zeit",
    "timestamp",
    "stamp",
    "seconds",
    "sec",
    "millis",
    "micros",
    "ms",
    "tempo",
    "temps",
)
_SHORT = {
    "motor_angle": ("th", "thm", "q", "poti", "theta"),
    "torque": ("tau", "torsion", "m"),
    "deflection": ("defl", "eps", "epsilon"),
    "voltage": ("u", "v", "vin", "um", "umot"),
}
# Spellings of the units of `UNITS`, in lower case and without blanks, dots and stars.
_SPELLINGS = {
    **dict.fromkeys(("sec", "secs", "second", "seconds", "sek", "sekunden"), "s"),
    **dict.fromkeys(("msec", "millis", "milliseconds"), "ms"),
    **dict.fromkeys(("usec", "µs", "μs", "micros", "microseconds"), "us"),
    **dict.fromkeys(("degree", "degrees", "grad", "°"), "deg"),
    **dict.fromkeys(("radian", "radians"), "rad"),
    **dict.fromkeys(("turns", "revolutions", "umdrehungen"), "rev"),
    **dict.fromkeys(("nm",), "Nm"),
    **dict.fromkeys(("mnm",), "mNm"),
    **dict.fromkeys(("volt", "volts"), "V"),
    **dict.fromkeys(("millivolt", "millivolts"), "mV"),
}
_KNOWN = frozenset(unit for units in UNITS.values() for unit in units)


def words_of(name: str) -> tuple[str, ...]:
    """The words of a name in lower case, broken at signs, digits and capitals.

    >>> words_of("motorAngle2 [deg]"), words_of("theta_ref")
    (('motor', 'angle', 'deg'), ('theta', 'ref'))
    """
    spaced = re.sub(r"(?<=[a-zäöüß])(?=[A-Z])", " ", name)
    return tuple(word.lower() for word in re.split(r"[\W\d_]+", spaced) if word)


def unit_in(name: str, role: str) -> str:
    """The unit that a column's name ends with, if it is one of the role's; "?" otherwise."""
    ending = re.split(r"[_ \[\]()/.]+", name.strip(" ])"))[-1]
    return ending if ending in UNITS[QUANTITY_OF[role]] else "?"


def unit_of_name(name: str) -> str:
    """The unit that a name states in brackets or behind its last ``_`` or blank, as `UNITS` spells it, or "".

    >>> [unit_of_name(name) for name in ("Zeit (Sekunden)", "moment [N m]", "alpha_deg", "s")]
    ['s', 'Nm', 'deg', '']
    """
    bracketed = re.search(r"[\[(]([^\])]*)[\])]\s*$", name)
    parts = re.split(r"[_ /.]+", name.strip())
    ending = bracketed[1] if bracketed else parts[-1] if len(parts) > 1 else ""
    ending = ending.strip()
    if ending in _KNOWN:
        return ending
    plain = re.sub(r"[ .·*⋅]", "", ending)
    return plain if plain in _KNOWN else _SPELLINGS.get(plain.lower(), "")


def names_time(name: str) -> bool:
    """Whether a name is one that loggers give to stamps."""
    return any(word in _TIME for word in words_of(name))


def role_of_name(name: str) -> tuple[str, str]:
    """The role that a name suggests, or "", and the word that says so.

    A quantity that no role has (a speed, a reference, the tip) is returned with its description: "a speed".

    >>> role_of_name("theta_ref"), role_of_name("Motorwinkel"), role_of_name("x7")
    (('a commanded value', 'ref'), ('motor_angle', 'winkel'), ('', ''))
    """
    words, unit = words_of(name), unit_of_name(name)
    # A potentiometer and a strain gauge are read in volts, too: only what is no sensor drives the motor.
    driving = unit if unit in UNITS["voltage"] else next(filter(_drives, words), "")
    if driving and not _sensor_role(words):
        return "voltage", driving
    for meaning, listed in _OTHER.items():
        if word := next((word for word in words if word in listed), ""):
            return meaning, word
    return ("torque", unit) if unit in UNITS["torque"] else _by_words(words)


def _drives(word: str) -> bool:
    return word in _SHORT["voltage"] or word.startswith("volt") or "spannung" in word


def _sensor_role(words: tuple[str, ...]) -> str:
    sensors = {"motor_angle": ("pot", "poti", "theta", "angle", "winkel"), "deflection": HINTS["deflection"]}
    return next((role for role, listed in sensors.items() if any(_hits(w, listed) for w in words)), "")


def _hits(word: str, listed: tuple[str, ...]) -> str:
    """The hint that is this word, begins it, or is a long part of it (Motorwinkel)."""
    for hint in listed:
        if word == hint or (len(hint) >= 3 and word.startswith(hint)) or (len(hint) >= 5 and hint in word):
            return hint
    return ""


def _by_words(words: tuple[str, ...]) -> tuple[str, str]:
    for role in ("torque", "deflection", "motor_angle", "voltage"):
        for word in words:
            if hint := _hits(word, HINTS[role]):
                return role, hint
    for role, listed in _SHORT.items():
        if word := next((word for word in words if word in listed), ""):
            return role, word
    return "", ""
