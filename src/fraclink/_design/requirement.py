"""One requirement of a design: what was wanted, what is achieved, and where it is worst."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

__all__ = ["Requirement"]

_ROUNDING = 1e-9  # relative: the equations are solved to 1e-15, a requirement met with equality must pass


@dataclass(frozen=True)
class Requirement:
    """One requirement, the value achieved over the whole payload range, and where it is worst.

    ``bound`` says whether `wanted` is the least or the most that is admitted; ``at_payload`` [kg] is the
    payload of the worst value; ``unit`` the unit of wanted, achieved and slack.

    Examples
    --------
    >>> Requirement.at_least("phase margin", 0.8, 0.9, "rad", 0.02).passed
    True
    >>> Requirement.at_most("Ms", 1.5, 1.6, "", 0.02).passed
    False
    """

    name: str
    wanted: float
    achieved: float
    unit: str
    at_payload: float
    bound: Literal["at least", "at most"]

    @staticmethod
    def at_least(name: str, wanted: float, achieved: float, unit: str, at_payload: float) -> Requirement:
        """A lower bound: passed where achieved >= wanted."""
        return Requirement(name, wanted, achieved, unit, at_payload, "at least")

    @staticmethod
    def at_most(name: str, wanted: float, achieved: float, unit: str, at_payload: float) -> Requirement:
        """An upper bound: passed where achieved <= wanted."""
        return Requirement(name, wanted, achieved, unit, at_payload, "at most")

    @property
    def slack(self) -> float:
        """Distance from the wanted value, positive with room to spare."""
        gap = self.achieved - self.wanted
        return gap if self.bound == "at least" else -gap

    @property
    def passed(self) -> bool:
        """Whether the bound is kept, to rounding."""
        return self.slack >= -_ROUNDING * max(1.0, abs(self.wanted))

    def __str__(self) -> str:
        shown = [math.degrees(x) if self.unit == "rad" else x for x in (self.wanted, self.achieved)]
        unit = "°" if self.unit == "rad" else f" {self.unit}".rstrip()
        verdict = "passed" if self.passed else "FAILED"
        return (
            f"{self.name}: wanted {shown[0]:.5g}{unit}, achieved {shown[1]:.5g}{unit} "
            f"at {1e3 * self.at_payload:g} g, {verdict}"
        )
