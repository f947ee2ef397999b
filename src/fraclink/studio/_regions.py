"""What the Design step shows around its curves: regions that they may not enter, the
map, arms of a box.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.box import ParameterBox, arms_of
from fraclink._design import Design
from fraclink._design.assess import feasibility_map
from fraclink._display import number
from fraclink.errors import FieldError
from fraclink.studio._messages import checked_request

__all__ = [
    "Region",
    "checked_regions",
    "fan_of",
    "map_of",
    "parted",
    "violated",
]

Real = NDArray[np.float64]

_MOST = 8  # regions of a design
_PAYLOADS = 9  # at which a region is looked at, ends included
# Six intervals have 64 corners: at two payloads and 280 frequencies 36 000 numbers, for
# what is drawn as a veil.
_ARMS, _SKIPPED = (
    16,
    4,
)  # of the fan: at most so many corners of the box, every fourth frequency
# Cells of the map, 20 ms each: the margins of 10° to 100° in tens.
_CROSSOVERS, _MARGINS = 17, 10
_FASTEST, _WIDEST = (
    4.0,
    100.0,
)  # of the map: beyond the lightest link's ω₀ (as rad/s), and degrees of margin
_DECIBELS = 20.0 / math.log(10.0)


@dataclass(frozen=True)
class Region:
    """A rectangle that no curve may enter: gain [dB] over frequency [rad/s], or over
    phase [°] (Nichols).
    """

    plot: Literal["gain", "nichols"]
    left: float
    right: float
    low: float
    high: float

    def said(self, entered: bool) -> str:
        """Return the region in words, behind whether the loop enters it.

        >>> Region("gain", 10.0, 100.0, 0.0, 20.0).said(False)
        '✓ kept out of: 10 to 100 rad/s, 0 to 20 dB'
        """
        unit = "rad/s" if self.plot == "gain" else "°"
        left, right, low, high = (
            number(edge, 3) for edge in (self.left, self.right, self.low, self.high)
        )
        return f"{'✗ entered' if entered else '✓ kept out of'}: {left} to {right} {unit}, {low} to {high} dB"

    def entered(self, frequency: Real, gain: Real, phase: Real) -> bool:
        """Whether the loop has a part of it inside; gain and phase have shape
        (payloads, frequencies).

        Straight lines join neighbours, in frequency and in payload: what lies between
        two curves is found.

        >>> box = Region("gain", 10.0, 100.0, 0.0, 20.0)
        >>> w = np.array([1.0, 1000.0])
        >>> above, across = np.array([[30.0, 30.0]]), np.array([[30.0, -10.0]])
        >>> box.entered(w, above, above), box.entered(w, across, above)
        (False, True)
        """
        # Over ln ω lines between neighbours are what the page draws, as its axis is
        # logarithmic.
        logs = self.plot == "gain"
        x = np.broadcast_to(np.log(frequency), gain.shape) if logs else phase
        ends = (
            (math.log(self.left), math.log(self.right))
            if logs
            else (self.left, self.right)
        )
        # Along the payloads too: between two that are looked at, a resonance moves
        # right across a narrow region, and neither curve enters it.
        return any(self._crossed(x, gain, ends, axis) for axis in (0, 1))

    def _crossed(
        self, x: Real, gain: Real, ends: tuple[float, float], axis: int
    ) -> bool:
        """Whether a line between neighbours along `axis` has a part inside: Liang and
        Barsky's clipping.
        """
        points = np.stack([x, gain])
        first = points[:, :-1] if axis == 0 else points[:, :, :-1]
        step = np.diff(points, axis=1 + axis)
        low = np.array([ends[0], self.low])[:, None, None] - first
        high = np.array([ends[1], self.high])[:, None, None] - first
        # A step of nothing divides by zero: such lines run along an edge, and are in or
        # out as a whole (`still`).
        with np.errstate(divide="ignore", invalid="ignore"):
            one, two = low / step, high / step
        still, inside = step == 0.0, (low < 0.0) & (high > 0.0)
        begin = np.where(
            still, np.where(inside, -np.inf, np.inf), np.minimum(one, two)
        ).max(axis=0)
        end = np.where(
            still, np.where(inside, np.inf, -np.inf), np.maximum(one, two)
        ).min(axis=0)
        # Strictly: a line along the edge, or one that touches a corner, does not enter.
        return bool(np.any((begin < end) & (begin < 1.0) & (end > 0.0)))


def parted(given: object) -> tuple[object, tuple[Region, ...]]:
    """Return what a page asks of a design, and the regions that it keeps beside it."""
    if not isinstance(given, Mapping) or "regions" not in given:
        return given, ()
    rest = {name: value for name, value in given.items() if name != "regions"}
    return rest, checked_regions(given["regions"])


def checked_regions(given: object) -> tuple[Region, ...]:
    """Return the regions that a page sent; FieldError for anything else."""
    if not isinstance(given, list) or len(given) > _MOST:
        raise _refused(given)
    found = []
    for row in given:
        if not isinstance(row, Mapping) or row.get("plot") not in ("gain", "nichols"):
            raise _refused(row)
        edges = [row.get(name) for name in ("left", "right", "low", "high")]
        if not all(type(e) in (int, float) and abs(e) < 1e6 for e in edges):  # type: ignore[arg-type]
            raise _refused(row)
        region = Region(row["plot"], *map(float, edges))  # type: ignore[arg-type]
        if not (region.left < region.right and region.low < region.high):
            raise _refused(row)
        # ω lies on a logarithmic axis: at 0 it has no place.
        if region.plot == "gain" and region.left <= 0.0:
            raise _refused(row)
        found.append(region)
    return tuple(found)


def _refused(value: object) -> FieldError:
    return FieldError(
        "regions",
        str(value)[:80],
        "no regions",
        allowed=f"at most {_MOST} of {{plot: gain or nichols, left < right, low < high}}, finite",
        remedy="draw them again",
    )


def violated(made: Design, regions: Iterable[Region], frequencies: Real) -> list[bool]:
    """Return for each region whether the loop enters it at some payload designed for."""
    low, high = made.payloads
    links = np.array(
        [made.natural_frequency(mass) for mass in np.linspace(low, high, _PAYLOADS)]
    )
    logs = made.loop.log(frequencies, links[:, None])
    gain, phase = _DECIBELS * logs.real, np.degrees(logs.imag)
    return [region.entered(frequencies, gain, phase) for region in regions]


def map_of(
    subject: Any, state: object, going: Callable[[], object] = lambda: None
) -> dict[str, Any]:
    """Return which pairs of crossover and margin can be had: noise gain of each cell,
    −1 where none is.

    It takes seconds: `going` is called before each crossover, and may wait or raise.
    """
    request = checked_request(state)
    # ω₀ has the unit s^(−λ/2); ω₀^(2/λ) is the frequency [rad/s] that it belongs to.
    slowest = float(subject.link_frequencies.min()) ** (2.0 / subject.model.order)
    fastest = float(subject.link_frequencies.max()) ** (2.0 / subject.model.order)
    crossovers = np.geomspace(0.5 * slowest, _FASTEST * fastest, _CROSSOVERS)
    margins = np.linspace(10.0, _WIDEST, _MARGINS)
    names = ("payloads", "filter_time")
    given = {name: request[name] for name in names if request[name] is not None}
    if "payloads" not in given:
        given["payloads"] = (subject.rig.payloads.low, subject.rig.payloads.high)
    columns = []
    for crossover in crossovers:
        going()
        found = feasibility_map(
            subject.model,
            subject.rig,
            gain_crossovers=[crossover],
            phase_margins=np.radians(margins),
            filter_order=request["filter_order"] or 1,
            **given,
        )
        columns.append(found.noise_gain)
    noise = np.nan_to_num(np.hstack(columns), nan=-1.0, posinf=-1.0)
    return {"crossovers": crossovers, "margins": margins, "noise": noise}


def fan_of(made: Design, frequencies: Real) -> dict[str, Real]:
    """Return gain [dB] and phase [°] of arms at the corners of what fit and rig leave
    open, at both payloads.

    Every row is one arm; of more than sixteen corners, sixteen spread over them.
    """
    box = made.box if made.box is not None else ParameterBox.of(made.model, made.rig)
    arms = arms_of(box, made.model)
    chosen = [
        arms[k] for k in np.unique(np.linspace(0, len(arms) - 1, _ARMS).astype(int))
    ]
    w = frequencies[::_SKIPPED]
    links = np.array([made.natural_frequency(mass) for mass in made.payloads])
    logs = np.concatenate(
        [arm.loop(made.controller, made.rig).log(w, links[:, None]) for arm in chosen]
    )
    return {
        "fan_gain": np.clip(_DECIBELS * logs.real, -300.0, 300.0),
        "fan_phase": np.clip(np.degrees(logs.imag), -7200.0, 7200.0),
    }
