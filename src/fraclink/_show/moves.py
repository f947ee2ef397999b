"""What people see of a shaped move: its table beside the rivals, and the tips that it moves."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from fraclink._show.drawing import FAINT, FULL_WIDTH, GREY, INK, LINES, envelope, figure, svg
from fraclink._show.figures import stacked
from fraclink._show.text import Row, Table, View, milli, number

if TYPE_CHECKING:
    from fraclink._shape import Measured, ShapedMove

__all__ = ["shaped_figure", "shaped_view"]


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
    return View(f"{what}: {result}, {voltage}", (table,), tuple(map(str, made.findings)), state)


def _row(each: Measured, *, along: bool) -> Row:
    first = (milli(each.predicted), _seconds(each.duration), milli(each.largest_error))
    if not along:
        settled = _seconds(each.predicted), _seconds(each.settling_time)
        first = (*settled, milli(each.residual_vibration))
    return (each.name, *first, number(each.peak_voltage, 3), f"{100 * each.limited:.0f}")


def shaped_figure(made: ShapedMove) -> str:
    """Draw reference and tips, the reference's acceleration, and the voltages of the runs that are kept."""
    reference, time = made.reference, made.period * np.arange(made.tip_angle.shape[1])
    with figure(FULL_WIDTH, 5.4) as drawing:
        labels = ("tip angle θt [rad]", "reference [rad/s²]", "motor [V]")
        tip, push, voltage = stacked(drawing, (2.2, 1, 1), labels, xlabel="time [s]")
        if made.target is None:
            end = made.amplitude
            tip.axhspan(0.98 * end, 1.02 * end, color=FAINT)
            tip.axvline(made.settling_time, color=GREY, linewidth=0.8, linestyle=":")
        else:
            tip.plot(*envelope(time, made.target.angle(time)), color=INK, linewidth=0.8, label="path")
        dashed = {"color": GREY, "linestyle": (0, (4, 2))}
        tip.plot(*envelope(time, reference.angle(time)), **dashed, label="reference")
        push.plot(*envelope(time, reference.acceleration(time)), color=INK, linewidth=0.9)
        for line, payload, angle, volts in zip(
            LINES, made.shown, made.tip_angle, made.motor_voltage, strict=False
        ):
            tip.plot(*envelope(time, angle), **line, label=_grams(payload))
            voltage.plot(*envelope(time, volts), color=line["color"], linewidth=0.7)
        for side in (-made.voltage, made.voltage):
            voltage.axhline(side, color=GREY, linewidth=0.8, linestyle=":")
        tip.legend(loc="lower right", ncols=2)
        # what comes after twice the move is rest and noise
        voltage.set_xlim(0.0, min(float(time[-1]), 2.0 * reference.duration))
        drawing.align_ylabels()
        return svg(drawing, "shaped", "Tip angle, acceleration of the reference and voltage of a shaped move")
