"""Loops without Ĉ over many links, tabulated once, and the figures of the loops with a
given Ĉ (`Outer`).

Every figure follows from g = ∂ ln Ĉ/∂x of the parameters x of Ĉ: a frequency
at which |L| crosses one moves by −Re g/Re σ with σ = d ln L/d ln ω, its phase by
Im g − Re g Im σ/Re σ, a distance from −1 by Re(L g/(1 + L)), noise by Re(g/(1 + L)).
The compiled kernel computes all of them (csrc/kernels/figures.c).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.controller import Controller
from fraclink._arm.loop import Loop, noise_points
from fraclink._arm.notch import Notch
from fraclink._kernels import Loops
from fraclink._law.modes import MODE_POINTS, PHASE_DOUBT, HigherModes
from fracsys.checks import Complex, Mask, Real

__all__ = ["Figure", "Outer", "Table", "Trial", "stacked", "tabulated"]

Index = NDArray[np.int64]

# Points per decade, from a twentieth of the resonance; cubics with the table's slopes
# follow ln L to 1e-4 between them, and to 3e-3 on the flanks of a sharp resonance.
_DENSITY = 28
_NEAR = np.geomspace(1e-4, 0.2, 12)  # on both sides of a sharp resonance
# Roots of 1 + L up to this distance from the resonance, in ln ω, are vibrations of the
# link. Those farther away belong to its second mode, to the motor loop, or to the delay of
# the gauge: with any payload the second mode lies above the first mode of a beam pinned
# at its tip, which is 15.42/3.516 = 4.4 times the resonance of the arm without payload.
_REGION = math.log(4.4)
# Radius in ln ω of the expansions about the axis, in which roots are looked for: with a
# damping ratio of more than sin 0.6 = 0.56 nothing vibrates. The factors of the loop have
# their next singularity near the negative axis, π/2 away: 20 terms leave 0.38^20 = 4e-9.
_RADIUS, _TERMS = 0.6, 20

# What the kernel returns, as csrc/kernels/figures.h describes it, in its order.
FIGURES = (
    "crossover",
    "reach",
    "level",
    "last crossing",
    "quiet",
    "margin",
    "delay",
    "distance",
    "gain margin",
    "damping",
    "noise",
    "voltage",
    "modes",  # a row for each of them
)


@dataclass(frozen=True, eq=False)
class Outer:
    """Ĉ in terms of parameters `x` in which the rows of a design are nearly linear: ln|Ĉ|
    at a frequency ω_r (of Ĉ without its notch), β and ln δ,

        ln Ĉ = x₀ + β ln(s/ω_r) − n (ln(1 + δs) − ln|1 + jδω_r|) + ln N(s; x₃, x₄, x₅)

    so that neither β nor δ moves a crossover at ω_r.

    ``reference`` is ω_r [rad/s], ``filter_order`` n; parameters beyond the third are
    ln ω_N, ln ζ_p and ln(ζ_z/ζ_p) of a notch.
    """

    x: Real
    reference: float
    filter_order: int

    @staticmethod
    def of(controller: Controller, reference: float) -> Outer:
        """Return Ĉ of a controller."""
        order, notch = controller.filter_order, controller.notch
        # no filter is one whose corner lies far above every frequency
        lag = max(controller.filter_time, np.finfo(float).tiny)
        level = math.log(controller.derivative_gain)
        level += controller.derivative_order * math.log(reference)
        level -= 0.5 * order * math.log1p((lag * reference) ** 2)
        x = [level, controller.derivative_order, math.log(lag)]
        if notch is not None:
            parts = notch.frequency, notch.poles, notch.zeros / notch.poles
            x += map(math.log, parts)
        return Outer(np.array(x), reference, order)

    @property
    def notch(self) -> Notch | None:
        """The notch of these parameters."""
        if self.x.size == 3:
            return None
        centre, poles, depth = np.exp(self.x[3:])
        return Notch(float(centre), float(min(poles * depth, poles)), float(poles))


@dataclass(frozen=True, eq=False)
class Table:
    """The loops without Ĉ of K links, each at its own frequencies.

    ``w``, ``rest``, ``slope`` (K, N): frequencies [rad/s], ln of the loop without Ĉ
    with its true phase, and the slope of this over ln ω. ``noise_w``, ``weight``,
    ``noise_rest`` (K, M): the points of the noise integral and the loop without Ĉ there;
    ``voltage`` (K, M) the gain from motor reference to voltage [V/rad].
    ``modes_w``, ``modes_level``, ``modes_number`` (K, R): the higher modes. ``centre``
    (K, J), ``plant``, ``closing`` (K, J·T): places on the axis, in ln ω, and the Taylor
    coefficients there of the link's denominator D, and of D times the loop without Ĉ,
    neither of which has a pole nearby. ``empty``
    (K,) says whether the gripper is empty; ``arm`` and ``natural_frequency`` (K,) identify
    the link; ``mode`` (K,) its resonance, ``highest`` (K,) the highest crossing allowed and
    ``band`` (K, 2) the frequencies that belong to its second mode [rad/s].
    """

    w: Real
    rest: Complex
    slope: Complex
    noise_w: Real
    weight: Real
    noise_rest: Complex
    voltage: Real
    modes_w: Real
    modes_level: Complex
    modes_number: Index
    centre: Real
    plant: Complex
    closing: Complex
    empty: Mask
    arm: Index
    natural_frequency: Real
    mode: Real
    highest: Real
    band: Real

    def __len__(self) -> int:
        return int(self.w.shape[0])

    @cached_property
    def mode_column(self) -> Index:
        """The column nearest to the resonance of each link."""
        distance = np.abs(self.w - self.mode[:, None])
        return np.asarray(np.argmin(distance, axis=1))

    @cached_property
    def places(self) -> Index:
        """The flat index of every figure of every link among the figures of a trial."""
        count = len(FIGURES) - 1 + self.modes_w.shape[1] // MODE_POINTS
        return np.arange(count * len(self)).reshape(count, len(self))

    @cached_property
    def kernel(self) -> Loops:
        """The compiled kernel of these loops."""
        return Loops(self, MODE_POINTS, PHASE_DOUBT, _RADIUS, _REGION)

    def rows(self, index: object) -> Table:
        """Return the table of some of the links."""
        return Table(*(getattr(self, field.name)[index] for field in fields(self)))


def tabulated(
    bare: Loop,
    w0: Real,
    period: float,
    *,
    arm: int,
    highest: float,
    motor: tuple[float, float],
    modes: HigherModes | None = None,
    empty: bool = False,
) -> Table:
    """Return the table of one arm's loop without Ĉ (`bare`, k = 1 and β = 0) at the
    links with ω₀ (K,).

    `highest` is the highest crossing allowed [rad/s], `motor` is (A, B) of A/(s(s + B));
    an `empty` gripper has no noise to judge.
    """
    mode = bare.peak(w0)
    top = bare.highest
    if bare.exact_gauge:  # |L| falls far above the mode; with a late gauge it may not
        top = min(top, max(40.0 * float(mode.max()), 8.0 / (bare.lag or 0.1)))
    decades = math.log10(top / (0.05 * float(mode.min())))
    shape = np.concatenate(
        [
            np.geomspace(0.05, top / float(mode.min()), int(_DENSITY * decades) + 1),
            1.0 + _NEAR,
            1.0 / (1.0 + _NEAR),
            [1.0],
        ]
    )
    turns = bare.turns(0.25 * float(mode.min()), top, 6.0)
    points = np.concatenate([bare.about_mode(49), [highest], turns])
    rows = mode[:, None] * shape, np.broadcast_to(points, (w0.size, points.size))
    # equal neighbours at the end make empty intervals without crossings
    w = np.minimum(np.sort(np.concatenate(rows, axis=1), axis=1), top)
    judged = slice(0 if empty else None)
    noise_w, weight = (part[:, judged] for part in noise_points(bare, w0, period))
    followed = bare.motor_log(noise_w)
    rest, slope = bare.log_and_slope(w, w0[:, None])
    gain, decay = motor
    modes_w, level = np.ones((w0.size, 0)), np.ones((w0.size, 0), complex)
    number = np.zeros((w0.size, 0), int)
    if modes is not None:  # the same modes for each link, one link after the other
        modes_w = modes.frequency.reshape(w0.size, -1)
        level = modes.level.reshape(w0.size, -1)
        number = np.repeat(modes.number, MODE_POINTS).reshape(modes_w.shape)
    return Table(
        w,
        rest,
        slope,
        noise_w,
        weight,
        np.exp(bare.link_log(noise_w, w0[:, None]) + followed),
        np.abs(noise_w * (1j * noise_w + decay) * np.exp(followed)) / gain,
        modes_w,
        level,
        number,
        *_expansions(bare, w0, mode),
        np.full(w0.size, empty),
        np.full(w0.size, arm),
        w0,
        np.asarray(mode),
        np.full(w0.size, highest),
        np.stack(bare.mode_band(w0), axis=1),
    )


def _expansions(bare: Loop, w0: Real, mode: Real) -> tuple[Real, Complex, Complex]:
    """`centre`, `plant` and `closing` of a table.

    The links share the centres, multiples of a quarter of the radius, and both
    expansions are linear in 1/ω₀²: a rigid link and one other suffice.
    """
    spacing = 0.25 * _RADIUS
    first = np.floor((np.log(mode[:, None]) - _REGION) / spacing).astype(int)
    places = first + np.arange(math.ceil(2.0 * _REGION / spacing) + 2)
    start, stop = int(places.min()), int(places.max()) + 1
    terms = _expanded(bare, spacing, start, stop)[:, :, places - start]
    rigid, soft, inverse = terms[:, 0], terms[:, 1], w0[:, None, None] ** -2.0
    plant, closing = (rigid + inverse * (soft - rigid)).reshape(2, mode.size, -1)
    return np.asarray(spacing * places, np.float64), plant, closing


@lru_cache(
    maxsize=64
)  # the same for every payload of an arm, and so while a slider is dragged
def _expanded(bare: Loop, spacing: float, start: int, stop: int) -> Complex:
    """Taylor coefficients of D and of D times the loop without Ĉ, of a rigid link and of
    one with ω₀ = 1, about some multiples of `spacing`: from values on a circle about
    each.
    """
    circle = _RADIUS * np.exp(1j * math.tau * np.arange(_TERMS) / _TERMS)
    w = np.exp(spacing * np.arange(start, stop)[:, None] + circle)
    two = np.array([math.inf, 1.0])[:, None, None]
    plant = bare.denominator(w, two)
    return np.asarray(np.fft.fft([plant, plant * bare(w, two)]) / _TERMS)


def stacked(tables: Iterable[Table]) -> Table:
    """Return one table of all links, with shorter rows padded at their last frequency."""
    parts = list(tables)
    columns = []
    for field in fields(Table):
        values = [getattr(part, field.name) for part in parts]
        width = max(value.shape[-1] for value in values)
        if values[0].ndim == 2:
            values = [_widened(field.name, value, width) for value in values]
        columns.append(np.concatenate(values))
    return Table(*columns)


def _widened(name: str, value: NDArray[Any], width: int) -> NDArray[Any]:
    missing = len(value), width - value.shape[1]
    # a weight of 0 and a level of e^-1000 have no effect
    fill: Any = {"weight": 0.0, "modes_level": -1e3}.get(name, 1.0)
    if name in ("w", "rest", "slope"):
        fill = value[:, -1:]
    return np.concatenate([value, np.full(missing, fill, value.dtype)], axis=1)


@dataclass(frozen=True)
class Figure:
    """One of `FIGURES` times a factor, plus an offset."""

    name: str
    factor: float = 1.0
    offset: float = 0.0

    @property
    def rows(self) -> slice:
        """Its rows among those of the kernel."""
        first = FIGURES.index(self.name)
        return slice(first, None if self.name == "modes" else first + 1)

    def scaled(self, factor: float, offset: float) -> Figure:
        """Return the figure times a factor, plus an offset."""
        return Figure(self.name, factor * self.factor, factor * self.offset + offset)


class Trial:
    """The figures (R, K) of the K loops of a table with Ĉ, and their gradients (P, R, K);
    NaN where a link has none.
    """

    def __init__(self, table: Table, outer: Outer) -> None:
        self.table = table
        self.figures, self.gradients = table.kernel.figures(
            outer.x, outer.reference, outer.filter_order
        )

    def value(self, figure: Figure) -> Real:
        """Return a figure of every link, (R, K)."""
        return figure.factor * self.figures[figure.rows] + figure.offset
