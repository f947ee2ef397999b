"""Loops without their Ĉ over many links, tabulated once: every figure of a trial Ĉ, and
its gradient, is then a sum over the table.

The parameters are ln|Ĉ| without its filter at a frequency ω_r, β and ln δ, so that

    ln Ĉ = x₀ + β ln(s/ω_r) − n ln(1 + e^{x₂} s) + ln N(s; x₃, x₄, x₅)

is nearly linear in them, and every figure follows from g = ∂ ln Ĉ/∂x: a phase at a
crossing moves by Im g − Re g Im σ/Re σ with σ = d ln L/d ln ω, a distance from −1 by
Re(L g/(1 + L)), noise by −Re(g/(1 + L)).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.loop import Loop, noise_points
from fraclink._arm.notch import Notch

__all__ = ["Outer", "Sheet", "stacked", "tabulated", "voltage_share"]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

# Points a decade, from a twentieth of the resonance; cubics between them follow ln L to
# 1e-6, as its slope is in the table.
_DENSITY = 28
_NEAR = np.geomspace(1e-4, 0.2, 12)  # to either side of a sharp resonance


@dataclass(frozen=True)
class Outer:
    """Ĉ of the parameters `x`: its logarithm, that one's slope over ln ω and its
    gradient.

    ``reference`` is ω_r [rad/s], ``filter_order`` n; parameters beyond the third are
    ln ω_N, ln ζ_p and ln(ζ_z/ζ_p) of a notch. ``x`` (P,) is one Ĉ, (P, R) one for each
    row of the frequencies (R, N) of `log` and `slope`.
    """

    x: Real
    reference: float
    filter_order: int

    def log(self, w: NDArray[Any]) -> Complex:
        """Return ln Ĉ(jω)."""
        s = 1j * w
        gain, order, lag, *notch = self._columns
        value = gain + order * (np.log(w / self.reference) + 0.5j * math.pi)
        value = value - self.filter_order * np.log1p(np.exp(lag) * s)
        if notch:
            top, bottom, *_ = self._notch(s)
            value = value + np.log(top / bottom)
        return np.asarray(value)

    def slope(self, w: Real) -> Complex:
        """Return d ln Ĉ/d ln ω."""
        s = 1j * w
        _, order, lag, *notch = self._columns
        lagged = np.exp(lag) * s
        value = order - self.filter_order * lagged / (1.0 + lagged)
        if notch:
            top, bottom, zero, pole, centre = self._notch(s)
            value = value + 2.0 * s * (
                (s + zero * centre) / top - (s + pole * centre) / bottom
            )
        return np.asarray(value)

    def gradient(self, w: NDArray[Any]) -> Complex:
        """Return ∂ ln Ĉ/∂x at ω, the parameters along the first axis."""
        s = 1j * w
        lagged = math.exp(self.x[2]) * s
        rows = [
            np.ones_like(s),
            np.log(w / self.reference) + 0.5j * math.pi,
            -self.filter_order * lagged / (1.0 + lagged),
        ]
        if self.x.size > 3:
            top, bottom, zero, pole, centre = self._notch(s)
            both = 2.0 * centre * centre
            rows += [
                (2.0 * zero * centre * s + both) / top
                - (2.0 * pole * centre * s + both) / bottom,
                2.0 * zero * centre * s / top - 2.0 * pole * centre * s / bottom,
                2.0 * zero * centre * s / top,
            ]
        return np.array(rows)

    @property
    def _columns(self) -> Real:
        return self.x if self.x.ndim == 1 else self.x[:, :, None]

    @property
    def notch(self) -> Notch | None:
        """The notch of the parameters."""
        if self.x.size == 3:
            return None
        centre, poles = math.exp(self.x[3]), math.exp(self.x[4])
        return Notch(centre, min(poles * math.exp(self.x[5]), poles), poles)

    def _notch(self, s: NDArray[Any]) -> tuple[Complex, Complex, Any, Any, Any]:
        centre, pole, ratio = np.exp(self._columns[3:])
        zero = pole * ratio
        rest = s * s + centre * centre
        return (
            rest + 2.0 * zero * centre * s,
            rest + 2.0 * pole * centre * s,
            zero,
            pole,
            centre,
        )


@dataclass(frozen=True, eq=False)
class Sheet:
    """The loops beside Ĉ of K links, each at its own frequencies.

    ``w``, ``rest``, ``slope`` (K, N): frequencies [rad/s], ln of the loop beside Ĉ with
    its true phase, and that one's slope over ln ω. ``noise_w``, ``weight``,
    ``noise_rest`` (K, M): the points of the noise integral and the loop beside Ĉ there;
    ``voltage`` (K, M) the gain from motor reference to share of the voltage limit, in
    the gauge's noise. ``modes_w``, ``modes_level`` (K, R): the higher modes. ``kind``
    (K,) says what a link has to keep.
    """

    w: Real
    rest: Complex
    slope: Complex
    noise_w: Real
    weight: Real
    noise_rest: Complex
    voltage: Real
    modes_w: Real
    modes_level: Real
    kind: NDArray[np.int64]
    arm: NDArray[np.int64]
    natural_frequency: Real

    def __len__(self) -> int:
        return int(self.w.shape[0])

    def rows(self, index: object) -> Sheet:
        """Return the sheet of some of the links."""
        return Sheet(*(getattr(self, field.name)[index] for field in fields(self)))


def tabulated(
    bare: Loop,
    natural_frequencies: Real,
    period: float,
    *,
    kind: int,
    arm: int,
    noisy: bool,
    voltage: tuple[float, float, float] | None,
    modes: tuple[Real, Real] | None,
) -> Sheet:
    """Return the table of one arm's loop beside Ĉ (`bare`, k = 1 and β = 0) at its
    links.

    `voltage` is (noise over limit [1/...], A, B of the motor); `modes` (ω, ln level) of
    the higher modes, shape (R,).
    """
    w0 = np.atleast_1d(np.asarray(natural_frequencies, dtype=float))
    mode = bare.peak(w0)
    top = min(bare.highest, max(40.0 * float(mode.max()), 8.0 / (bare.lag or 0.1)))
    decades = math.log10(top / (0.05 * float(mode.min())))
    shape = np.concatenate(
        [
            np.geomspace(0.05, top / float(mode.min()), int(_DENSITY * decades) + 1),
            1.0 + _NEAR,
            1.0 / (1.0 + _NEAR),
            [1.0],
        ]
    )
    more = [bare.about_mode(49)]
    if bare.gauge_delay:
        more.append(bare.turns(0.25 * float(mode.min()), top, 6.0))
    points = np.concatenate(more)
    w = np.concatenate(
        [mode[:, None] * shape, np.broadcast_to(points, (w0.size, points.size))], axis=1
    )
    w = np.sort(np.minimum(w, top), axis=1)
    # equal neighbours at the end make empty intervals, in which nothing crosses
    rest, slope = bare.log(w, w0[:, None]), bare.slope(w, w0[:, None])
    noise = [noise_points(bare, float(x), period) for x in w0] if noisy else []
    count = max((row[0].size for row in noise), default=0)
    noise_w, weight = np.ones((w0.size, count)), np.zeros((w0.size, count))
    for k, (at, share) in enumerate(noise):
        noise_w[k, : at.size], weight[k, : at.size] = at, share
    noise_rest = (
        np.exp(bare.log(noise_w, w0[:, None]))
        if count
        else np.ones((w0.size, 0), dtype=complex)
    )
    volts = np.zeros_like(noise_w)
    if voltage is not None and count:
        volts = voltage_share(bare, noise_w, voltage)
    modes_w, level = modes or (np.ones(0), np.zeros(0))
    return Sheet(
        w,
        rest,
        slope,
        noise_w,
        weight,
        noise_rest,
        volts,
        np.broadcast_to(modes_w, (w0.size, modes_w.size)),
        np.broadcast_to(level, (w0.size, level.size)),
        np.full(w0.size, kind),
        np.full(w0.size, arm),
        w0,
    )


def voltage_share(
    loop: Loop, frequency: Real, voltage: tuple[float, float, float]
) -> Real:
    """Return the gain from motor reference to share of the voltage limit, in the
    gauge's noise; `voltage` as in `tabulated`.
    """
    size, gain, decay = voltage
    drive = np.abs(frequency * (1j * frequency + decay)) / gain
    return np.asarray(size * drive * np.exp(loop.motor_log(frequency).real))


def stacked(sheets: Iterable[Sheet]) -> Sheet:
    """Return one sheet of all links, shorter rows continued at their last frequency."""
    parts = list(sheets)
    if len(parts) == 1:
        return parts[0]
    columns = []
    for field in fields(Sheet):
        values = [getattr(part, field.name) for part in parts]
        if values[0].ndim == 2:
            width = max(value.shape[1] for value in values)
            # a weight of zero, a level of -1000 and a repeated frequency count nothing
            fill = {"weight": 0.0, "modes_level": -1e3}.get(field.name)
            values = [_widened(value, width, fill) for value in values]
        columns.append(np.concatenate(values))
    return Sheet(*columns)


def _widened(value: NDArray[Any], width: int, fill: float | None) -> NDArray[Any]:
    missing = width - value.shape[1]
    if not missing:
        return value
    if not value.shape[1]:
        return np.full((value.shape[0], width), 1.0 if fill is None else fill).astype(
            value.dtype
        )
    if fill is None:
        return np.pad(value, ((0, 0), (0, missing)), mode="edge")
    return np.pad(value, ((0, 0), (0, missing)), constant_values=fill)
