"""What every verb on a fractional system asks of its first argument."""

from __future__ import annotations

from fraclink._systems.fractional.function import FractionalTransferFunction
from fraclink._validate import checked_noun

__all__ = ["checked_system"]


def checked_system(field: str, value: object) -> FractionalTransferFunction:
    """Return `value` where it is a fractional transfer function; FieldError for anything else."""
    return checked_noun(
        field,
        value,
        FractionalTransferFunction,
        remedy="build it from fraclink.s, such as 100 / (s**1.92 + 100)",
    )
