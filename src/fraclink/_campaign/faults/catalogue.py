"""The fault catalogue: forty-four ways to break an arm, and what the law must do about each."""

from __future__ import annotations

from fraclink._campaign.faults.arm import ARM
from fraclink._campaign.faults.clock import CLOCK
from fraclink._campaign.faults.memory import MEMORY
from fraclink._campaign.faults.nouns import Fault
from fraclink._campaign.faults.sensors import SENSORS
from fraclink.errors import FieldError

__all__ = ["CATALOGUE", "fault_named"]

CATALOGUE: tuple[Fault, ...] = tuple(
    sorted((*SENSORS, *CLOCK, *MEMORY, *ARM), key=lambda fault: fault.number)
)


def fault_named(number: str) -> Fault:
    """Return a fault by its number; FieldError where there is none.

    >>> fault_named("F07").title
    'encoder stuck in a move'
    """
    for fault in CATALOGUE:
        if isinstance(number, str) and fault.number == number.upper():
            return fault
    raise FieldError(
        "only", number, "not in the catalogue", allowed="F01 … F44", remedy="choose one of these"
    )
