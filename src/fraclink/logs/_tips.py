"""A deflection made of two columns: motor angle less tip angle, or two gauges of one
bridge.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from fraclink._arm.log_columns import UNITS, Channel
from fraclink._reading.columns import with_combined
from fraclink._reading.names import length_of_name, words_of
from fraclink.logs._channels import Mode, find_mode
from fraclink.logs._weighing import Weighing, stamps_of

__all__ = ["CLEARER", "LONGEST_SCAN", "TIP", "gauges", "tip_difference"]

Array = NDArray[np.float64]

# samples looked at where many pairs or factors are tried: a scan takes 30 ms then
LONGEST_SCAN = 2_048
# Shares of the difference of both angles: on made logs 0.97 and more, of the tip angle
# itself 0.54 to 0.91.
TIP, CLEARER = 0.9, 0.05
# factor by which the deflection that is left may differ from what its angles say
_OWN_GAIN = 1.5
_SNAP = 0.03  # of the factor between two units of angle: what is so close is that
_TOGETHER = 0.9  # correlation of two gauges of one bridge


def tip_difference(
    weighing: Weighing, angle: int, tip: int, time: Channel | None
) -> int | None:
    """The place of the deflection that the tip's column gives, which may be that
    column; None if neither.

    A tip angle θt = θm − δ rings as a deflection of the other sign does, and would pass
    for one: what is left of the motor angle must be one vibration, and its gain on the
    motor angle 1. Where the units do not say how many of one make one of the other, as
    for a camera's metres, the factor is taken with which the difference is most of all
    one vibration.
    """
    if time is None:
        return None
    turned, moved = weighing.cells(angle), weighing.cells(tip)
    stride = max(1, turned.size // LONGEST_SCAN)
    period = stride * float(np.median(np.abs(np.diff(stamps_of(weighing, time)))))
    if turned.size != moved.size or not period > 0:
        return None
    x, y = turned[::stride] - turned[0], moved[::stride] - moved[0]
    # Without any unit both columns are taken to be in the same one, as people record
    # both angles alike.
    units = (
        weighing.statement("motor_angle").unit or weighing.unit(angle),
        weighing.unit(tip),
    )
    angles = [UNITS["angle"].get(unit) for unit in units]
    if all(angles) or (
        units[0] == units[1] == "" and not length_of_name(weighing.table.names[tip])
    ):
        factor = (angles[1] or 1.0) / (angles[0] or 1.0)
    else:
        factor = _factor(x, y, period)
    itself, rest = find_mode(x, y, period), find_mode(x, x - factor * y, period)
    if itself is None or rest is None:
        return None
    # Clearer than the column itself: a deflection that is subtracted from the motor
    # angle leaves a mode as well, but a worse one.
    if (
        rest.share > max(TIP, itself.share + CLEARER)
        and 1 / _OWN_GAIN < rest.gain < _OWN_GAIN
    ):
        return _difference(weighing, angle, tip, factor, rest)
    if itself.share > TIP:
        share = f"one vibration explains {100 * itself.share:.3g} % of it: it is measured from the hub"
        weighing.conclude("output", weighing.label(tip), "likely", share)
        return tip
    return None


def _factor(x: Array, y: Array, period: float) -> float:
    """How many of x make one of y, so that x less that many y is one vibration."""
    slope = float(x @ y) / float(x @ x) if np.any(x) else 0.0
    if not slope:
        return 1.0

    def left(logarithm: float) -> float:
        mode = find_mode(x, x - np.exp(logarithm) / slope * y, period)
        return 1.0 if mode is None else -mode.share

    # A slow motion moves tip and motor alike, so that the plain slope is wrong by the
    # vibration in it only. A factor of 2 either way in steps of a tenth of the
    # logarithm: the share has several local maxima, and a bounded minimisation alone
    # would end in the nearest.
    grid = np.linspace(-0.7, 0.7, 15)
    best = float(min(grid, key=left))
    found = minimize_scalar(
        left, bounds=(best - 0.1, best + 0.1), method="bounded", options={"xatol": 1e-4}
    )
    factor = float(np.exp(found.x) / slope)
    known = (
        size
        for unit in UNITS["angle"].values()
        for size in (unit, 1 / unit, -unit, -1 / unit)
    )
    return next((size for size in known if abs(factor / size - 1) < _SNAP), factor)


def _difference(
    weighing: Weighing, angle: int, tip: int, factor: float, rest: Mode
) -> int:
    """A column of the motor angle less the tip's."""
    first, second, length = (
        weighing.label(angle),
        weighing.label(tip),
        length_of_name(weighing.table.names[tip]),
    )
    text = f"the motor angle less it is one vibration, of {100 * rest.share:.3g} %: the tip in space"
    own = weighing.unit(angle)
    name = f"{first} - {second}"
    if factor != 1:
        sign, size = ("-", factor) if factor > 0 else ("+", -factor)
        name = f"{first} {sign} {size:.6g} * {second}"
        turns = UNITS["angle"].get(own or "rad", 1.0) * abs(factor)
        text += f"; the link would be {1 / turns:.4g} {length} long" if length else ""
    weighing.conclude("output", name, "likely", text)
    return _added(weighing, name, own if own in UNITS["angle"] else "")


def _added(weighing: Weighing, name: str, unit: str) -> int:
    """Add a combined column to the table that is weighed; return its place."""
    table = with_combined(weighing.table, [name])
    place = table.names.index(name)
    units = [*(table.units or [""] * len(table.names))]
    units[place] = unit
    weighing.table = replace(table, units=tuple(units))
    return place


def gauges(
    weighing: Weighing, named: Mapping[int, tuple[str, str]], free: list[int]
) -> int | None:
    """The place of two gauges of one bridge, which move together or against each other;
    None for others.
    """
    found = [place for place in free if named[place][0] == "deflection"]
    names = [weighing.table.names[place] for place in found]
    # strain1 and strain2 are one bridge, strain and bend are two quantities.
    if len(found) != 2 or words_of(names[0]) != words_of(names[1]):
        return None
    first, second = (weighing.cells(place) for place in found)
    together = float(np.corrcoef(first, second)[0, 1])
    if abs(together) < _TOGETHER:
        return None
    # Gauges on both faces of the link: one is stretched where the other is compressed.
    # Their difference doubles the signal and cancels what temperature does to both.
    mark, way = ("-", "against each other") if together < 0 else ("+", "together")
    name = f"{weighing.label(found[0])} {mark} {weighing.label(found[1])}"
    weighing.conclude(
        "output", name, "likely", f"both move {way} (correlation {together:.2g})"
    )
    return _added(weighing, name, weighing.unit(found[0]))
