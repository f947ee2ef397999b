"""Loops without Ĉ over many links, tabulated once, and the figures of the loops with a
given Ĉ (`Outer`).

Every figure follows from g = ∂ ln Ĉ/∂x of the parameters x of Ĉ: a frequency
at which |L| crosses one moves by −Re g/Re σ with σ = d ln L/d ln ω, its phase by
Im g − Re g Im σ/Re σ, a distance from −1 by Re(L g/(1 + L)), noise by Re(g/(1 + L)).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.loop import Loop, noise_points
from fraclink._design.outer import Outer
from fraclink._law.modes import MODE_POINTS, HigherModes, gain_towards
from fracsys.checks import Complex, Mask, Real

__all__ = ["Figure", "Table", "Trial", "stacked", "tabulated"]

Index = NDArray[np.int64]

# Points per decade, from a twentieth of the resonance; cubics between them follow ln L
# to 2e-5, since the table includes its slope.
_DENSITY = 28
_NEAR = np.geomspace(1e-4, 0.2, 12)  # on both sides of a sharp resonance


@dataclass(frozen=True, eq=False)
class Table:
    """The loops beside Ĉ of K links, each at its own frequencies.

    ``w``, ``rest``, ``slope`` (K, N): frequencies [rad/s], ln of the loop beside Ĉ with
    its true phase, and that one's slope over ln ω. ``noise_w``, ``weight``,
    ``noise_rest`` (K, M): the points of the noise integral and the loop beside Ĉ there;
    ``voltage`` (K, M) the gain from motor reference to voltage [V/rad].
    ``modes_w``, ``modes_level``, ``modes_number`` (K, R): the higher modes. ``empty``
    (K,) says whether the gripper is; ``arm`` and ``natural_frequency`` (K,) which link
    it is; ``mode`` (K,) its resonance and ``band`` (K, 2) the frequencies that belong to
    its second mode [rad/s].
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
    empty: Mask
    arm: Index
    natural_frequency: Real
    mode: Real
    band: Real

    def __len__(self) -> int:
        return int(self.w.shape[0])

    @cached_property
    def mode_column(self) -> Index:
        """The column nearest to the resonance of each link."""
        distance = np.abs(self.w - self.mode[:, None])
        return np.asarray(np.argmin(distance, axis=1))

    @cached_property
    def at_mode(self) -> Mask:
        """Which columns belong to the second mode of their link."""
        low, high = self.band[:, :1], self.band[:, 1:]
        return (self.w > low) & (self.w < high)

    def rows(self, index: object) -> Table:
        """Return the table of some of the links."""
        return Table(*(getattr(self, field.name)[index] for field in fields(self)))


def tabulated(
    bare: Loop,
    natural_frequencies: Real,
    period: float,
    *,
    arm: int,
    highest: float,
    motor: tuple[float, float],
    modes: HigherModes | None = None,
    empty: bool = False,
) -> Table:
    """Return the table of one arm's loop without Ĉ (`bare`, k = 1 and β = 0) at its
    links.

    `highest` is the highest crossing allowed [rad/s], `motor` is (A, B) of A/(s(s + B));
    an `empty` gripper has no noise to judge.
    """
    w0 = np.atleast_1d(np.asarray(natural_frequencies, float))
    mode = bare.peak(w0)
    top = bare.highest
    if bare.exact_gauge:  # |L| falls far above the mode; that of a late gauge may not
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
    more = [bare.about_mode(49), np.array([highest]), turns]
    points = np.broadcast_to(np.concatenate(more), (w0.size, sum(map(len, more))))
    w = np.sort(np.concatenate([mode[:, None] * shape, points], axis=1), axis=1)
    # equal neighbours at the end make empty intervals without crossings
    w = np.minimum(w, top)
    noise = [] if empty else [noise_points(bare, float(x), period) for x in w0]
    count = max((row[0].size for row in noise), default=0)
    noise_w, weight = np.ones((w0.size, count)), np.zeros((w0.size, count))
    for k, (at, share) in enumerate(noise):
        noise_w[k, : at.size], weight[k, : at.size] = at, share
    gain, decay = motor
    drive = np.abs(noise_w * (1j * noise_w + decay)) / gain
    modes_w, level = np.ones((w0.size, 0)), np.ones((w0.size, 0), complex)
    number = np.zeros((w0.size, 0), int)
    if modes is not None:  # the same modes for each link, one link after the other
        modes_w = modes.frequency.reshape(w0.size, -1)
        level = modes.level.reshape(w0.size, -1)
        number = np.repeat(modes.number, MODE_POINTS).reshape(modes_w.shape)
    return Table(
        w,
        bare.log(w, w0[:, None]),
        bare.slope(w, w0[:, None]),
        noise_w,
        weight,
        np.exp(bare.log(noise_w, w0[:, None])),
        drive * np.exp(bare.motor_log(noise_w).real),
        modes_w,
        level,
        number,
        np.full(w0.size, empty),
        np.full(w0.size, arm),
        w0,
        np.asarray(mode),
        np.stack(bare.mode_band(w0), axis=1),
    )


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


class Figure:
    """Values (M,) of some links, their gradients (P, M), the link of each, and its
    number if a link has several of a kind.
    """

    def __init__(
        self, value: Real, gradient: Real, link: Index, number: Index | None = None
    ) -> None:
        self.value, self.gradient, self.link = value, gradient, link
        self.number = 0 * link if number is None else number

    def at(self, kept: Mask | Index) -> Figure:
        """Return the entries at the given indices."""
        return Figure(
            self.value[kept], self.gradient[:, kept], self.link[kept], self.number[kept]
        )

    @property
    def least(self) -> tuple[float, int]:
        """(value, link) of the smallest entry."""
        k = int(np.argmin(self.value))
        return float(self.value[k]), int(self.link[k])

    def scaled(self, factor: float, offset: float) -> Figure:
        """Return the figure times a factor, plus an offset."""
        value = factor * self.value + offset
        return Figure(value, factor * self.gradient, self.link, self.number)


class Trial:
    """The loops of a table with Ĉ.

    `loops` are the loops of the table's arms without Ĉ.
    """

    def __init__(self, table: Table, outer: Outer, loops: tuple[Loop, ...]) -> None:
        self.table, self.outer, self.loops = table, outer, loops
        self.log = outer.log(table.w) + table.rest
        self.slope = outer.slope(table.w) + table.slope

    def _cubics(self, link: Index, i: Index) -> tuple[Real, Real, Complex]:
        """(ln ω at the left end, width, coefficients of the cubic Hermite interpolant
        of ln L) of the intervals that start at columns i.
        """
        u0, u1 = np.log(self.table.w[link, i]), np.log(self.table.w[link, i + 1])
        h, first = u1 - u0, self.log[link, i]
        s0, s1 = self.slope[link, i] * h, self.slope[link, i + 1] * h
        a = self.log[link, i + 1] - first
        return u0, h, np.array([first, s0, 3.0 * a - 2.0 * s0 - s1, s0 + s1 - 2.0 * a])

    @cached_property
    def _crossings(self) -> tuple[Index, Real, Complex, Complex, Mask, Complex]:
        """(link, ω, ln L, d ln L/d ln ω, whether |L| rises, ∂ ln Ĉ/∂x) at the crossings
        |L| = 1.
        """
        above = self.log.real > 0.0
        link, i = np.nonzero(above[:, :-1] != above[:, 1:])
        w, log, slope = self._zeros(link, i, 1.0)
        return link, w, log, slope, ~above[link, i], self.outer.gradient(w)

    def _zeros(
        self, link: Index, i: Index, part: complex, line: Real | float = 0.0
    ) -> tuple[Real, Complex, Complex]:
        """(ω, ln L, d ln L/d ln ω) where the real part of `part` times ln L meets a
        line, inside the intervals that start at columns i.
        """
        first, last = (
            (part * self.log[link, column]).real - line for column in (i, i + 1)
        )
        t, cubics = first / (first - last), self._cubics(link, i)
        width, along = cubics[1], (part * cubics[2]).real
        for _ in range(2):
            _, value, slope = _at((cubics[0], width, along), t)
            rate = slope * width
            change = (value - line) / np.where(np.abs(rate) > 1e-12, rate, 1.0)
            t = (t - change).clip(0.0, 1.0)
        return _at(cubics, t)

    @cached_property
    def _offsets(self) -> Real:
        """Distance of the phase of each crossing from the multiple of 2π within whose
        band the loop must stay there [rad].

        |L| > 1 between a rising and the next falling crossing. The loop is stable where
        both lie in one band of 2π about a multiple of it.
        """
        link, _, log, _, rising, _ = self._crossings
        phase = log.imag
        # the partner: for a rising crossing the next one of its link, for a falling one
        # the previous one; the ends of the table if there is none
        other = np.arange(link.size) + np.where(rising, 1, -1)
        other = np.clip(other, 0, link.size - 1)
        paired = (link[other] == link) & (rising[other] != rising)
        alone = np.where(rising, phase, self.log[link, 0].imag)
        partner = np.where(paired, phase[other], alone)
        middle = np.where(paired, 0.5 * (phase + partner), partner)
        return phase - math.tau * np.round(middle / math.tau)

    @cached_property
    def margin(self) -> Figure:
        """Distance of each crossing from the edges of its band [rad], negative on the
        wrong side.
        """
        link, _, _, slope, _, g = self._crossings
        rate = g.imag - g.real * slope.imag / _steep(slope.real)
        gradient = -np.sign(self._offsets) * rate
        return Figure(math.pi - np.abs(self._offsets), gradient, link)

    @cached_property
    def delay(self) -> Figure:
        """The delay that takes the phase of each crossing to the lower edge [s]."""
        link, w, _, slope, _, g = self._crossings
        room, shift = self._offsets + math.pi, -g.real / _steep(slope.real)
        gradient = g.imag + shift * slope.imag - room * shift
        return Figure(room / w, gradient / w, link)

    @cached_property
    def crossover(self) -> Figure:
        """ln of the frequency at which |L| of each link first falls to 1 beyond its
        resonance; −∞ if |L| is smaller there. A later crossing on a lobe of a delayed
        gauge is not the crossover of the tip.
        """
        link, w, _, _, rising, _ = self._crossings
        beyond = np.flatnonzero(w > self.table.mode[link])
        _, first = np.unique(link[beyond], return_index=True)
        return self._places(beyond[first][~rising[beyond[first]]])

    @cached_property
    def last_crossing(self) -> Figure:
        """ln of the last frequency with |L| = 1 of each link, except at its second
        mode; −∞ if there is none.
        """
        link, w, *_ = self._crossings
        low, high = self.table.band[link].T
        own = np.flatnonzero((w <= low) | (w >= high))
        last = np.append(link[own][1:] != link[own][:-1], True)[: own.size]
        return self._places(own[last])

    def _places(self, chosen: Index) -> Figure:
        """ln of some of the crossing frequencies, at most one per link."""
        link, w, _, slope, _, g = self._crossings
        value = np.full(len(self.table), -np.inf)
        gradient = np.zeros((len(self.outer.x), len(self.table)))
        at, rate = link[chosen], -g.real / _steep(slope.real)
        value[at], gradient[:, at] = np.log(w[chosen]), rate[:, chosen]
        return Figure(value, gradient, np.arange(len(self.table)))

    def crossed_beyond(self, frequency: float) -> Figure:
        """ln of the ratio of the crossover, or of the resonance without one, to a
        frequency [rad/s]; and ln|L| at the resonance, which must be positive for a
        crossover.
        """
        figure, table = self.crossover, self.table
        level = self.log.real[figure.link, table.mode_column]
        none = np.log(table.mode) + np.minimum(level, 0.0)
        value = np.maximum(figure.value, none) - math.log(frequency)
        slope = self.outer.gradient(table.mode).real
        gradient = np.where(np.isinf(figure.value), slope, figure.gradient)
        return Figure(
            np.concatenate([value, level]),
            np.concatenate([gradient, slope], axis=1),
            np.concatenate([figure.link, figure.link]),
        )

    def quiet_beyond(self, frequency: float) -> Figure:
        """−ln|L| at its largest value beyond a frequency [rad/s], except at the second
        mode.
        """
        every, w = np.arange(len(self.table)), self.table.w
        level = np.where((w < frequency) | self.table.at_mode, -1e3, self.log.real)
        best = np.argmax(level, axis=1)
        value, at = level[every, best], w[every, best]
        return Figure(-value, -self.outer.gradient(at).real, every)

    @cached_property
    def _loop(self) -> Complex:
        return np.asarray(np.exp(np.minimum(self.log.real, 50.0) + 1j * self.log.imag))

    @cached_property
    def sensitivity(self) -> Figure:
        """ln of each peak of 1/|1 + L| above 2/3."""
        one = 1.0 + self._loop
        # half of d|1 + L|²/d ln ω; a change from minus to plus is a local minimum
        turn = (np.conj(one) * self._loop * self.slope).real
        near, falls = np.abs(one) < 1.5, turn < 0.0
        near = near[:, :-1] | near[:, 1:]
        link, i = np.nonzero(falls[:, :-1] & ~falls[:, 1:] & near)
        low, high = turn[link, i], turn[link, i + 1]
        t = low / (low - high)
        cubics = self._cubics(link, i)
        width, (_, _, square, cube) = cubics[1], cubics[2]
        for _ in range(2):
            _, log, slope = _at(cubics, t)
            loop = np.exp(log)
            bend = (2.0 * square + 6.0 * t * cube) / width**2
            back = np.conj(1.0 + loop) * loop
            rate = np.abs(loop * slope) ** 2 + (back * (slope**2 + bend)).real
            change = (back * slope).real / np.where(rate > 0.0, rate * width, np.inf)
            t = (t - change).clip(0.0, 1.0)
        w, log, _ = _at(cubics, t)
        loop = np.exp(log)
        gradient = (loop / (1.0 + loop) * self.outer.gradient(w)).real
        return Figure(-np.log(np.abs(1.0 + loop) + 1e-300), -gradient, link)

    @cached_property
    def gain_margin(self) -> Figure:
        """ln of the factor by which |L| may grow where the phase passes -180° with |L|
        below 1.
        """
        half = np.floor((self.log.imag + math.pi) / math.tau)
        link, i = np.nonzero(half[:, :-1] != half[:, 1:])
        line = math.pi * (2.0 * np.maximum(half[link, i], half[link, i + 1]) - 1.0)
        w, log, slope = self._zeros(link, i, -1j, line)
        quiet = log.real < 0.0
        link, w, log, slope = link[quiet], w[quiet], log[quiet], slope[quiet]
        g = self.outer.gradient(w)
        gradient = g.real - g.imag * slope.real / _steep(slope.imag)
        return Figure(-log.real, -gradient, link)

    @cached_property
    def noise(self) -> Figure:
        """ln of the noise gain of each link (30)."""
        return self._power(self._noise_density)

    @cached_property
    def voltage(self) -> Figure:
        """ln of the RMS of the voltage for white noise of RMS one of the gauge, as an
        angle [V/rad].
        """
        links, density, slope = self._noise_density
        return self._power((links, density * self.table.voltage[links] ** 2, slope))

    @cached_property
    def _noise_density(self) -> tuple[Index, Real, Real]:
        """(links, weighted |Ĉ/(1 + L)|² at every point of the noise integral, gradient
        of half of its logarithm).
        """
        links = np.flatnonzero(self.table.weight.any(axis=1))
        w, rest = self.table.noise_w[links], self.table.noise_rest[links]
        outer = np.exp(self.outer.log(w))
        back = 1.0 / (1.0 + outer * rest)
        density = np.abs(outer * back) ** 2 * self.table.weight[links]
        return links, density, (self.outer.gradient(w) * back).real

    @staticmethod
    def _power(density: tuple[Index, Real, Real]) -> Figure:
        links, power, slope = density
        total = np.sum(power, axis=1)
        value = 0.5 * np.log(total + 1e-300)
        return Figure(value, np.sum(power * slope, axis=2) / total, links)

    @cached_property
    def modes(self) -> Figure:
        """ln of the loop gain towards -1 at each of the higher modes of each link."""
        shape = (len(self.table), -1, MODE_POINTS)
        w = self.table.modes_w.reshape(shape)
        each = np.broadcast_to(np.arange(len(w))[:, None, None], w.shape)
        log = self.outer.log(w) + self.table.modes_level.reshape(shape)
        peak = np.argmax(log.real, axis=2)[..., None]
        at, top = (np.take_along_axis(part, peak, 2).ravel() for part in (w, log))
        number = self.table.modes_number.reshape(shape)[..., 0].ravel()
        gain, by_gain, by_phase = gain_towards(np.asarray(top))
        gain, slope = np.maximum(gain, np.finfo(float).eps), self.outer.gradient(at)
        gradient = (by_gain * slope.real + by_phase * slope.imag) / gain
        return Figure(np.log(gain), gradient, each[..., 0].ravel(), number)

    @cached_property
    def damping(self) -> Figure:
        """The damping ratio of every vibration near the resonance of its link, i.e. of
        the roots of 1 + 1/L near the axis, by Halley's method from each local minimum
        of |1 + L|.
        """
        distance, w = np.abs(1.0 + self._loop), self.table.w
        parts = []
        for arm in np.unique(self.table.arm[~self.table.empty]):
            own = np.flatnonzero((self.table.arm == arm) & ~self.table.empty)
            loop = self.loops[arm]
            mode = self.table.mode[own]
            d, at = distance[own], w[own]
            dent = np.zeros(d.shape, bool)
            dent[:, 1:-1] = (d[:, 1:-1] <= d[:, :-2]) & (d[:, 1:-1] < d[:, 2:])
            # a root farther away belongs to the motor loop or to the delay of the gauge
            dent &= (at > 0.3 * mode[:, None]) & (at < 4.0 * mode[:, None])
            # a weak loop hardly moves the link's own pole
            dent[np.arange(own.size), self.table.mode_column[own]] = True
            row, column = np.nonzero(dent)
            parts.append(self._roots(loop, own[row], column, mode[row]))
        return Figure(
            *(np.concatenate(part, axis=-1) for part in zip(*parts, strict=True))
        )

    def _roots(
        self, loop: Loop, link: Index, column: Index, mode: Real
    ) -> tuple[Real, Real, Index]:
        """(damping ratio, its gradient, link) of the roots that Halley's method finds
        from columns of the table: ω = s/j, so that the decay rate is Im ω.
        """
        # first-order step from the table
        back = np.exp(-self.log[link, column])
        beside = (1.0 + back) / (back * self.slope[link, column])
        root = self.table.w[link, column] * (1.0 + _limited(beside, 0.2))
        frequency = self.table.natural_frequency[link]
        for _ in range(8):
            step = 1e-4 * np.abs(root)
            points = np.stack([root, root + step, root - step])
            outer = np.exp(self.outer.log(points))
            here, above, below = 1.0 / (outer * loop(points, frequency))
            # Halley's step: the two points of the slope give the bend as well
            bend = (above - 2.0 * here + below) / step**2
            rate = (above - below) / (2.0 * step)
            newton = (1.0 + here) / rate
            change = newton / (1.0 - 0.5 * newton * bend / rate) / np.abs(root)
            root = root - _limited(change, 0.1) * np.abs(root)
            # the next step would be of the order of the cube of this one
            if np.all(np.abs(change) < 1e-3):
                break
        size = np.abs(root)
        # a well damped loop has no root near its resonance
        valid = (np.abs(change) < 1e-3) & (size > 0.3 * mode) & (size < 4.0 * mode)
        root, rate, size, link = root[valid], rate[valid], size[valid], link[valid]
        # 1 + 1/L = 0: dω = -∂(1/L)/∂x / (d(1/L)/dω), and 1/L = -1
        shift = -self.outer.gradient(root) / rate
        gradient = (
            shift.imag / size - root.imag * (np.conj(root) * shift).real / size**3
        )
        return root.imag / size, gradient, link


def _at(cubics: tuple[Real, Real, Any], t: Real) -> tuple[Real, Any, Any]:
    """(ω, ln L, d ln L/d ln ω) at the fraction `t` of some intervals."""
    start, width, (c0, c1, c2, c3) = cubics
    value = c0 + t * (c1 + t * (c2 + t * c3))
    slope = (c1 + t * (2.0 * c2 + 3.0 * t * c3)) / np.where(width > 0.0, width, 1.0)
    return np.exp(start + t * width), value, slope


def _steep(slope: Real) -> Real:
    """A slope as a divisor, of modulus at least 0.01."""
    return np.copysign(np.maximum(np.abs(slope), 1e-2), slope)


def _limited(step: Complex, most: float) -> Complex:
    """A step of at most `most`, which keeps ω on the principal branch of its powers."""
    return np.asarray(step * np.minimum(1.0, most / np.maximum(np.abs(step), 1e-300)))
