"""Roles of columns and checks of their content: names that state a role and a unit, and
columns that are complete signals.

Only names such as ``motor_angle_rad`` count as stated. Everything else needs the
`[log]` table of a rig file.
"""

from __future__ import annotations

import re

import numpy as np

from fraclink._arm.log_columns import UNITS_OF, Channel, LogColumns
from fraclink._reading.table import NUMBER, LogTable
from fraclink.errors import LogError
from fraclink.findings import Finding
from fracsys.checks import Payload, Real, rule

# A role, then a unit: both are in the name, or a person has to state them. A person
# reads "theta" alone as a motor angle; this reader does not.
_NAME = re.compile(
    r"(time|motor_angle|torque|deflection|voltage)(?:_| *\[| *\()([A-Za-z·*]{1,5})[\])]?"
)


def stated_by(name: str) -> tuple[str, str]:
    """The role and the unit stated by a name such as ``motor_angle_rad``; otherwise two
    empty strings.
    """
    match = _NAME.fullmatch(name)
    valid = match is not None and match[2] in UNITS_OF[match[1]]
    return (match[1], match[2]) if match and valid else ("", "")


def columns_of_names(names: tuple[str, ...]) -> LogColumns | None:
    """The columns stated by `names` alone, or None if one of the three needed is not
    stated.

    >>> columns_of_names(("time_s", "motor_angle_deg", "torque_Nm")).motor_angle.unit
    'deg'
    >>> columns_of_names(("time_s", "motor_angle_deg")) is None  # of which output?
    True
    """
    channels: dict[str, Channel] = {}
    for name in names:
        role, unit = stated_by(name)
        if role in channels:
            raise LogError(
                f"column of {role}",
                name,
                f"stated twice, as {channels[role].column!r} too",
                "one column for each role",
                "say in [log] of the rig file which one is meant",
            )
        if role:
            channels[role] = Channel(name, unit)
    outputs = {"torque", "deflection"} & channels.keys()
    complete = outputs and {"time", "motor_angle"} <= channels.keys()
    return LogColumns(**channels) if complete else None


def converter_step(values: Real) -> float:
    """Step of the converter: the smallest gap between distinct values, 0 if values do
    not repeat.

    Gaps below a thousandth of the median gap are due to the decimal digits and not
    steps.
    """
    distinct = np.unique(values)
    # Readings of a converter repeat often. If more than half of the values are
    # distinct, they are continuous, and their smallest difference is accidental.
    if distinct.size < 2 or distinct.size > 0.5 * values.size:
        return 0.0
    gaps = np.diff(distinct)
    return float(gaps[gaps > 1e-3 * np.median(gaps)].min())


# --- what a stated column must be -------------------------------------------------------


# samples: three parameters, an offset and a held-out part need at least that many
_FEWEST = 200


def check_count(count: int) -> None:
    """Raise LogError if a log of `count` samples is too short for a fit."""
    if count < _FEWEST:
        allowed = f">= {_FEWEST} samples and 3 periods of the vibration"
        size, remedy = f"{count} samples", "record for longer"
        raise LogError("log", size, "too short", allowed, remedy)


def stated_payload(
    table: LogTable, stated: float | None
) -> tuple[float | None, list[Finding]]:
    """The payload of a log, from the call or from its own header."""
    mass = rule(Payload)
    # A set: repeating the same label is not a contradiction.
    labels = {value for key, value in table.notes if key == "payload_kg"}
    if len(labels) > 1:
        raise LogError(
            "payload_kg",
            ", ".join(sorted(labels)),
            "given more than once",
            "one label",
            "remove one",
        )
    masses = [
        mass.check("payload_kg", float(text) if NUMBER.fullmatch(text) else text)
        for text in labels
    ]
    if stated is None:
        return next(iter(masses), None), []
    payload = mass.check("payload", stated)
    findings = [
        Finding(
            "W216",
            "warning",
            f"payload {payload:g} kg was stated, the log's header says {header:g} kg",
            {"stated": payload, "header": header},
            "fraclink uses the stated one; correct the other",
        )
        for header in masses
        # 0.03 and a converted 30 g differ in the last bit.
        if abs(payload - header) > 1e-9 * payload
    ]
    return payload, findings
