"""The table of requirements: what is asked of a design, by a person or by us.

Each row has a key (the name of its bound in `Specification`), words, a unit and a
sense. Solver, `Design.requirements`, command line, studio, tune, report and certificate
show this table; a new requirement is one row here and one figure where it is measured.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from fraclink._law.requirement import LAW_MARGIN, LAW_MODULUS, Requirement

__all__ = [
    "DAMPING",
    "EMPTY_SHARE",
    "NOISE_SHARE",
    "ROWS",
    "SENSITIVITY",
    "Row",
    "key_of",
    "row",
]

# Ms of 2 is the customary upper end of a robust loop (1.4 to 2): a gain margin of 2 and
# a phase margin of 29° follow from it. Asked for where no margin is.
SENSITIVITY = 2.0
# A vibration that takes longer than ten of its periods to fall to 2 % is seen as
# ringing: ζ = ln 50/(2π·10), for small ζ. Not less for a link that has less of its own:
# with a resonance of 1/(2ζ) any gain crosses beside it with a large margin, and such a
# loop passes every other row without damping anything.
_PERIODS = 10
DAMPING = math.log(50.0) / math.hypot(2.0 * math.pi * _PERIODS, math.log(50.0))
# Three standard deviations of the noise leave half of the voltage to the motion.
NOISE_SHARE = 0.5 / 3.0
# What a gripper without its load weighs, of the lightest payload, where nobody says.
EMPTY_SHARE = 0.4


@dataclass(frozen=True)
class Row:
    """One requirement of the table: what it is called and which way it is meant."""

    key: str
    words: str
    unit: str
    sense: Literal["at least", "at most"]

    def measured(
        self,
        wanted: float,
        achieved: float,
        payload: float,
        number: int | None = None,
        *,
        note: str = "",
    ) -> Requirement:
        """Return the requirement with what is achieved, worst at `payload` [kg]."""
        words = self.words if number is None else f"{self.words} {number}"
        words += f" ({note})" if note else ""
        return Requirement(words, wanted, achieved, self.unit, payload, self.sense)


ROWS = (
    Row("gain_crossover", "gain crossover", "rad/s", "at least"),
    Row("highest_crossover", "last gain crossing", "rad/s", "at most"),
    Row("settling_time", "settling time", "s", "at most"),
    Row("phase_margin", "phase margin", "rad", "at least"),
    Row("max_sensitivity", "sensitivity peak", "", "at most"),
    Row("gain_margin", "gain margin", "", "at least"),
    Row("delay_margin", "delay margin", "s", "at least"),
    Row("mode_gain", "loop gain at mode", "", "at most"),
    Row("noise_gain", "noise gain", "", "at most"),
    Row("noise_voltage", "noise, share of the voltage", "", "at most"),
    Row("damping", "damping ratio of the vibration", "", "at least"),
    Row("empty", "phase margin, empty gripper", "rad", "at least"),
    Row("law_margin", LAW_MARGIN, "rad", "at least"),
    Row("law_modulus", LAW_MODULUS, "", "at least"),
)
_BY_KEY = {entry.key: entry for entry in ROWS}


def row(key: str) -> Row:
    """Return the row of a key.

    >>> row("phase_margin").words
    'phase margin'
    """
    return _BY_KEY[key]


def key_of(item: Requirement) -> str:
    """Return the key of a requirement's row.

    >>> key_of(row("mode_gain").measured(0.5, 0.4, 0.02, 2))
    'mode_gain'
    """
    name = item.name.partition(" (")[0]
    return next(
        entry.key
        for entry in ROWS
        if name == entry.words or name.rstrip("0123456789") == entry.words + " "
    )
