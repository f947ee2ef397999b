"""What people read of a shaped move: its table beside the rivals."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from fraclink._show.text import Row, Table, View, finding_line, milli, number

if TYPE_CHECKING:
    from fraclink._simulate.shaped_move import Measured, ShapedMove

__all__ = ["shaped_view"]


def _seconds(value: float) -> str:
    return f"{value:.3f}" if math.isfinite(value) else "never"


def _grams(payload: float) -> str:
    return f"{number(round(1e3 * payload, 1))} g"


def shaped_view(made: ShapedMove) -> View:
    """The settling time, or along a path the largest distance, as promised and as measured."""
    ours, along = made.shaped, made.target is not None
    low, high = map(_grams, made.payloads)
    carried = low if low == high else f"{low} to {high}"
    what = f"{number(made.amplitude)} rad with {carried}, payload {'given' if made.told else 'not given'}"
    if along:
        result = f"the tip stays within {milli(ours.largest_error)} mrad of the path"
    else:
        time = ours.settling_time
        result = f"settles in {_seconds(time)} s" if math.isfinite(time) else "does not settle"
    voltage = f"{number(ours.peak_voltage, 3)} V of {number(made.voltage)} V"
    last = "farthest [mrad]" if along else "residual vibration [mrad]"
    promised = ("promised [mrad]", "lasts [s]") if along else ("promised [s]", "settles to 2 % [s]")
    header = ("reference", *promised, last, "peak voltage [V]", "guards act [% of runs]")
    table = Table(header, tuple(_row(each, along=along) for each in made.measured))
    state = "passed" if made.passed else "failed"
    return View(f"{what}: {result}, {voltage}", (table,), tuple(map(finding_line, made.findings)), state)


def _row(each: Measured, *, along: bool) -> Row:
    first = (milli(each.predicted), _seconds(each.duration), milli(each.largest_error))
    if not along:
        settled = _seconds(each.predicted), _seconds(each.settling_time)
        first = (*settled, milli(each.residual_vibration))
    return (each.name, *first, number(each.peak_voltage, 3), f"{100 * each.limited:.0f}")
