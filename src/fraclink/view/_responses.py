"""Loops and responses of any system over frequency: Bode plots.

Conventions of python-control: dB, degrees, rad/s, one curve for each system, into `ax`
or new axes of matplotlib, which are returned. Unlike there, the grid refines itself
where the drawn curve bends, and the phase starts on the sheet of the low-frequency
slope: a lead s^0.65 is drawn at 58.5° and not at −301.5°.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fraclink._arm.recording import FrequencyResponse
from fraclink._law.design import Design
from fraclink.errors import FieldError
from fraclink.view._drawing import Figure, Panel
from fraclink.view._marks import Across, Curve, Mark, Point
from fraclink.view._matplotlib import on_axes
from fraclink.view._pages import LINES
from fraclink.view._scales import Scale
from fracsys._loops import as_loop
from fracsys._sweep import frequency_grid
from fracsys.checks import Complex, Real

__all__ = ["bode", "line_of"]


_HIDDEN = 30.0  # dB beyond the rest, at which an undamped resonance is cut off
_SPREAD = 30.0  # factor on either side of the crossing frequencies that is shown


@dataclass(frozen=True)
class Response:
    """A response L(jω) at frequencies ω [rad/s], and its name."""

    frequency: Real
    values: Complex
    name: str = ""

    @staticmethod
    def of(
        system: Any,
        frequency: ArrayLike | None,
        limit: float | None,
        name: str = "",
    ) -> Response:
        """The response of a system on `frequency` [rad/s], by default on a grid fine
        enough for smooth curves over frequency and in the complex plane; a measured
        response as it was measured; for a design its loop.
        """
        if isinstance(system, FrequencyResponse):
            return Response(system.frequency, system.response, name)
        if isinstance(system, Design):
            return loop_response(system, system.payloads[1], name, frequency)
        loop = as_loop(system, limit)

        x = np.log(
            frequency_grid(system, limit=limit)
            if frequency is None
            else _checked_grid(frequency)
        )
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            values = loop(x)
        # A pole or zero hit exactly is a gap: an infinite value would spoil the scale,
        # and no finite one is right.
        usual = np.isfinite(values) & (values != 0)
        return Response(np.exp(x), np.where(usual, values, math.nan), name)

    @property
    def decibels(self) -> Real:
        """20 lg |L|."""
        return decibels(self.values)

    @property
    def degrees(self) -> Real:
        """arg L [°], continuous; it starts within 180° of 90° times the low-frequency
        slope, a power of ω.
        """
        turns = np.angle(self.values[1:] / self.values[:-1])
        size = np.abs(self.values)
        # Across a pole on the axis the phase falls by π, whatever sign rounding gave
        # the jump; a rise of 2.8 rad between two neighbours of a refined grid is such a
        # jump, not a steep curve. It counts as a pole only if both sides are large: at
        # a zero the phase rises.
        over = (turns > 2.8) & (np.minimum(size[1:], size[:-1]) > np.median(size))
        turns[over] -= math.tau
        first = float(np.angle(self.values[0]))
        # Bode's relation for a minimum-phase loop: phase = 90° times the slope. It
        # determines the multiple of 360°, which the angle alone leaves open: k/s³
        # starts at −270° and not at +90°.
        slope = np.diff(np.log(size[:2]))[0] / np.diff(np.log(self.frequency[:2]))[0]
        if math.isfinite(slope):
            turn = math.tau
            first += turn * round((0.5 * math.pi * slope - first) / turn)
        return np.degrees(np.append(first, first + np.cumsum(turns)))

    def around(self, frequencies: Sequence[float]) -> Response:
        """The part within a factor of 30 of some frequencies [rad/s]."""
        low, high = min(frequencies) / _SPREAD, max(frequencies) * _SPREAD
        part = (self.frequency >= low) & (self.frequency <= high)
        return replace(self, frequency=self.frequency[part], values=self.values[part])

    def on_sheet(self, frequency: float, degrees: float) -> float:
        """A phase [°] known up to a whole turn, on the turn drawn at a frequency
        [rad/s].
        """
        logs = np.log(self.frequency)
        own = np.interp(math.log(frequency), logs, self.degrees)
        return degrees + 360.0 * round((own - degrees) / 360.0)


def decibels(values: Complex | Real) -> Real:
    """Return 20 lg of the modulus of some values, −∞ for 0."""
    with np.errstate(divide="ignore"):
        return 20 * np.log10(np.abs(values))


def loop_response(
    design: Design,
    payload: float,
    name: str = "",
    frequency: ArrayLike | None = None,
) -> Response:
    """Return the open loop of a design at a payload [kg], up to the Nyquist frequency."""
    w0, limit = design.natural_frequency(payload), math.pi / design.rig.period

    def loop(s: Any) -> Complex:
        return np.asarray(design.loop(np.imag(s), w0))

    return Response.of(loop, frequency, limit, name)


def decibel_range(response: Response) -> tuple[float, float]:
    """The displayed range: an undamped resonance is cut off 30 dB above the rest."""
    usual = np.isfinite(response.decibels)
    if not usual.any():
        return -1.0, 1.0
    x, level = np.log(response.frequency[usual]), response.decibels[usual]
    # Percentiles of length along the axis, not of points, which crowd at the resonance.
    # The two per cent outside them are left to an undamped mode.
    even = np.interp(np.linspace(x[0], x[-1], 400), x, level)
    low, high = np.percentile(even, [1, 99])
    least, most = float(level.min()), float(level.max())
    return max(least, float(low) - _HIDDEN), min(most, float(high) + _HIDDEN)


def _checked_grid(frequency: ArrayLike) -> Real:
    w = np.asarray(frequency, float).reshape(-1)
    rising = np.isfinite(w).all() and np.all(w > 0) and np.all(np.diff(w) > 0)
    if w.size < 3 or not rising:
        raise FieldError(
            "frequency",
            frequency,
            "not a grid of frequencies",
            "three or more rising values > 0 rad/s",
            "numpy.geomspace(0.1, 100.0, 300), or None for an automatic grid",
        )
    return w


def _named(systems: Sequence[Any], labels: Sequence[str] | None) -> Sequence[str]:
    """A name for each system; FieldError without a system, or without enough names."""
    if not systems:
        raise FieldError(
            "systems",
            "none",
            "empty",
            "one system or more",
            "pass a loop",
        )
    if labels is not None and len(labels) != len(systems):
        raise FieldError(
            "labels",
            list(labels),
            f"{len(labels)} labels for {len(systems)} systems",
            "one label for each system",
            "give as many labels as systems",
        )
    return labels or [""] * len(systems)


def line_of(place: int) -> int:
    return LINES[place % len(LINES)]


# --- over frequency ----------------------------------------------------------------------


def bode(
    *systems: Any,
    ax: Sequence[Any] | None = None,
    labels: Sequence[str] | None = None,
    frequency: ArrayLike | None = None,
    limit: float | None = None,
    **style: Any,
) -> Any:
    """Draw magnitude [dB] and phase [°] over frequency [rad/s].

    Parameters
    ----------
    *systems
        transfer functions, functions of s = jω, python-control systems, designs (their
        loops at the heaviest payload), and measured frequency responses.
    ax
        Magnitude and phase axes to draw into; by default new ones.
    labels
        One for each system, shown in a legend.
    frequency
        Grid [rad/s]; by default one that is refined where the curve bends.
    limit
        Highest frequency [rad/s], such as the Nyquist frequency.
    **style
        Passed to `Axes.plot`.

    Examples
    --------
    >>> from fracsys._fractional import s
    >>> axes = bode(1.56 * s**1.92 / (s**1.92 + 100), labels=["30 g"])
    >>> axes[1].get_ylabel()
    'phase [°]'
    """
    responses = [
        Response.of(system, frequency, limit, name)
        for system, name in zip(systems, _named(systems, labels), strict=True)
    ]
    return on_axes(_bode_figure(responses), ax, **style)


def loop_figure(
    responses: Sequence[Response], crossings: Sequence[Sequence[tuple[float, float]]]
) -> Figure:
    """Return the Bode plot of open loops with a dot at each gain crossing; crossings:
    the frequencies [rad/s] and phase margins [rad] of each loop.
    """
    gain: list[Mark] = [Across(0.0, limit=False)]
    phase: list[Mark] = [Across(-180.0, limit=False)]
    places = [frequency for each in crossings for frequency, _ in each]
    responses = [one.around(places) if places else one for one in responses]
    for k, (response, own) in enumerate(zip(responses, crossings, strict=True)):
        for w, margin in own:
            at = response.on_sheet(w, math.degrees(margin) - 180.0)
            gain.append(Point(w, 0.0, line=line_of(k)))
            phase.append(Point(w, at, line=line_of(k)))
    return _bode_figure(responses, gain, phase)


def _bode_figure(
    responses: Sequence[Response],
    gain_marks: Sequence[Mark] = (),
    phase_marks: Sequence[Mark] = (),
) -> Figure:
    gain, phase = [*gain_marks], [*phase_marks]
    for k, one in enumerate(responses):
        gain.append(Curve(one.frequency, one.decibels, line_of(k), one.name))
        phase.append(Curve(one.frequency, one.degrees, line_of(k)))
    levels = [decibel_range(one) for one in responses]
    turns = _turns([one.degrees for one in responses])
    panels = (
        Panel("magnitude [dB]", gain, 190.0, Scale.around(*levels, least=2.0)),
        Panel("phase [°]", phase, 190.0, turns),
    )
    return Figure(
        "bode",
        "Magnitude and phase over frequency",
        panels,
        "frequency [rad/s]",
        "loop",
        log=True,
    )


def _turns(phases: Sequence[Real]) -> Scale:
    """A scale with customary steps in degrees."""
    scale = Scale.around(*phases, least=2.0)
    # Phases below one turn are due to delay at frequencies of very small gain: they
    # would flatten the relevant range.
    low = max(scale.low, -370.0) if scale.high > -270.0 else scale.low
    steps = (15.0, 30.0, 45.0, 90.0, 180.0, 360.0, 720.0)
    step = next((d for d in steps if (scale.high - low) / d <= 7), None)
    if step is None:
        return replace(scale, low=low)
    places = step * np.arange(math.ceil(low / step), math.floor(scale.high / step) + 1)
    ticks = tuple((float(k), f"{k:g}".replace("-", "−")) for k in places)
    return Scale(low, scale.high, ticks=ticks)
