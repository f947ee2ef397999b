"""What a trial Ĉ makes of a sheet of loops: each figure with its gradient over the
parameters of Ĉ.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fraclink._design.sheet import Outer, Sheet
from fraclink._law.modes import MODE_POINTS

__all__ = ["Figure", "Trial"]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

_CROSSINGS, _DENTS = 4, 3  # of each link: the ones that matter most


@dataclass(frozen=True)
class Figure:
    """Values (K,) or (K, count) of K links, their gradients (P, ...), and where they
    were taken [rad/s].
    """

    value: Real
    gradient: Real
    at: Real


class Trial:
    """The loops of a sheet under one Ĉ."""

    def __init__(self, sheet: Sheet, outer: Outer) -> None:
        self.sheet, self.outer = sheet, outer
        self.log = outer.log(sheet.w) + sheet.rest
        self.slope = outer.slope(sheet.w) + sheet.slope

    def _between(
        self, row: NDArray[np.int64], i: NDArray[np.int64], t: Real
    ) -> tuple[Real, Complex, Complex]:
        """(ω, ln L, d ln L/d ln ω) at the share `t` of the interval behind column i."""
        u0, u1 = np.log(self.sheet.w[row, i]), np.log(self.sheet.w[row, i + 1])
        h = u1 - u0
        f0, f1 = self.log[row, i], self.log[row, i + 1]
        s0, s1 = self.slope[row, i] * h, self.slope[row, i + 1] * h
        # Hermite's cubic
        a, b = f1 - f0, s0
        c2, c3 = 3.0 * a - 2.0 * s0 - s1, s0 + s1 - 2.0 * a
        value = f0 + t * (b + t * (c2 + t * c3))
        slope = (b + t * (2.0 * c2 + 3.0 * t * c3)) / np.where(h > 0.0, h, 1.0)
        return np.exp(u0 + t * h), value, slope

    def crossings(
        self,
    ) -> tuple[NDArray[np.int64], Real, Complex, Complex, NDArray[np.bool_]]:
        """(link, ω, ln L, slope, whether |L| rises) of every crossing of |L| = 1."""
        level = self.log.real
        above = level > 0.0
        row, i = np.nonzero(above[:, :-1] != above[:, 1:])
        f0, f1 = level[row, i], level[row, i + 1]
        t = f0 / (f0 - f1)
        u = np.log(self.sheet.w[row, i + 1] / self.sheet.w[row, i])
        for _ in range(3):
            _, value, slope = self._between(row, i, t)
            change = value.real / np.where(
                np.abs(slope.real * u) > 1e-12, slope.real * u, 1.0
            )
            t = np.clip(t - change, 0.0, 1.0)
        w, value, slope = self._between(row, i, t)
        return row, w, value, slope, ~above[row, i]

    def bands(self) -> tuple[NDArray[np.int64], Real, Complex, Real]:
        """(link, ω, slope, offset) of every crossing: how far its phase is from the
        multiple of 2π in whose band the loop has to stay there [rad].

        |L| > 1 between a rising and the next falling crossing. The loop is stable where
        both lie in one band of 2π about a multiple of it.
        """
        row, w, log, slope, rising = self.crossings()
        phase = log.imag
        # the partner: behind a rising crossing the next one of its link, before a
        # falling one the last; the ends of the table where there is none
        partner = phase.copy()
        up, down = np.flatnonzero(rising), np.flatnonzero(~rising)
        after, before = np.minimum(up + 1, row.size - 1), np.maximum(down - 1, 0)
        partner[up] = np.where(
            (up < after) & (row[after] == row[up]), phase[after], phase[up]
        )
        has_last = (before < down) & (row[before] == row[down])
        partner[down] = np.where(has_last, phase[before], phase[down])
        middle = 0.5 * (phase + partner)
        # |L| > 1 from the first frequency on: the curve began in its band there
        first = down[~has_last]
        middle[first] = self.log[row[first], 0].imag
        return row, w, slope, phase - np.round(middle / (2.0 * math.pi)) * 2.0 * math.pi

    def margins(self) -> tuple[Figure, Real]:
        """The smallest margins of each link at its crossings [rad], shape (K, 4), and
        the last crossing (K,), 0 where there is none.

        What a crossing keeps from the edges of its band is its margin, negative on the
        wrong side.
        """
        count, size = len(self.sheet), self.outer.x.size
        value = np.full((count, _CROSSINGS), math.pi)
        at = np.ones((count, _CROSSINGS))
        gradient = np.zeros((size, count, _CROSSINGS))
        last = np.zeros(count)
        row, w, slope, offset = self.bands()
        if not row.size:
            return Figure(value, gradient, at), last
        np.maximum.at(last, row, w)
        margin = math.pi - np.abs(offset)
        g = self.outer.gradient(w)
        steep = np.where(
            np.abs(slope.real) > 1e-2, slope.real, np.copysign(1e-2, slope.real)
        )
        moved = g.imag - g.real * (slope.imag / steep)
        moved = -np.sign(offset) * moved
        order = np.lexsort((margin, row))
        start = np.searchsorted(row[order], np.arange(count))
        place = np.arange(order.size) - start[row[order]]
        kept = place < _CROSSINGS
        chosen, place = order[kept], place[kept]
        value[row[chosen], place] = margin[chosen]
        at[row[chosen], place] = w[chosen]
        gradient[:, row[chosen], place] = moved[:, chosen]
        return Figure(value, gradient, at), last

    def coarse(self) -> tuple[Real, Real, Real]:
        """(smallest margin [rad], last crossing [rad/s], ln of the smallest |1 + L| in
        the table) of each link, without gradients: for a Ĉ of its own at each.
        """
        row, w, _, offset = self.bands()
        margin, last = np.full(len(self.sheet), math.pi), np.zeros(len(self.sheet))
        np.minimum.at(margin, row, math.pi - np.abs(offset))
        np.maximum.at(last, row, w)
        loop = np.exp(np.minimum(self.log.real, 50.0) + 1j * self.log.imag)
        return margin, last, np.log(np.min(np.abs(1.0 + loop), axis=1) + 1e-300)

    def noise_level(self) -> Real:
        """ln of the noise gain of each link, without gradients."""
        sheet = self.sheet
        outer = np.exp(self.outer.log(sheet.noise_w))
        power = np.abs(outer / (1.0 + outer * sheet.noise_rest)) ** 2 * sheet.weight
        return np.asarray(0.5 * np.log(np.sum(power, axis=1) + 1e-300))

    def mode_level(self) -> Real:
        """ln of the largest loop gain at a higher mode of each link, without gradients."""
        loud = self.outer.log(self.sheet.modes_w).real + self.sheet.modes_level
        return np.asarray(np.max(loud, axis=1, initial=-1e3))

    def distances(self) -> Figure:
        """ln of the smallest |1 + L| of each link at its dents, shape (K, 3)."""
        loop = np.exp(np.minimum(self.log.real, 50.0) + 1j * self.log.imag)
        one = 1.0 + loop
        distance = np.abs(one)
        # half of d|1 + L|²/d ln ω
        turn = (np.conj(one) * loop * self.slope).real
        # where it goes from minus to plus lies a dent
        row, i = np.nonzero(
            (turn[:, :-1] < 0.0)
            & (turn[:, 1:] >= 0.0)
            & (np.minimum(distance[:, :-1], distance[:, 1:]) < 1.5)
        )
        count, size = len(self.sheet), self.outer.x.size
        value = np.full((count, _DENTS), 1.0)
        gradient, at = np.zeros((size, count, _DENTS)), np.ones((count, _DENTS))
        if not row.size:
            return Figure(value, gradient, at)
        low, high = turn[row, i], turn[row, i + 1]
        t = low / (low - high)
        for _ in range(4):
            w, log, slope = self._between(row, i, t)
            loop = np.exp(log)
            here = (np.conj(1.0 + loop) * loop * slope).real
            # regula falsi on the side that still holds the root
            left = here < 0.0
            a, b = np.where(left, t, 0.0), np.where(left, 1.0, t)
            fa, fb = np.where(left, here, low), np.where(left, high, here)
            t = np.clip(a - fa * (b - a) / np.where(fb != fa, fb - fa, 1.0), 0.0, 1.0)
        w, log, _ = self._between(row, i, t)
        loop = np.exp(log)
        found = np.log(np.abs(1.0 + loop) + 1e-300)
        moved = (loop / (1.0 + loop) * self.outer.gradient(w)).real
        order = np.lexsort((found, row))
        start = np.searchsorted(row[order], np.arange(count))
        place = np.arange(order.size) - start[row[order]]
        kept = place < _DENTS
        chosen, place = order[kept], place[kept]
        value[row[chosen], place] = found[chosen]
        at[row[chosen], place] = w[chosen]
        gradient[:, row[chosen], place] = moved[:, chosen]
        return Figure(value, gradient, at)

    def loudest(self, low: float) -> tuple[Figure, Real]:
        """The largest ln|L| of each link from `low` [rad/s] up, shape (K,), and its
        slope over ln `low`: zero unless the maximum is taken there.
        """
        w, rows = self.sheet.w, np.arange(len(self.sheet))
        beyond = w > low
        i = np.clip(np.argmax(beyond, axis=1) - 1, 0, w.shape[1] - 2)
        width = np.log(w[rows, i + 1] / w[rows, i])
        t = np.log(low / w[rows, i]) / np.where(width > 0.0, width, 1.0)
        _, first, slope = self._between(rows, i, np.clip(t, 0.0, 1.0))
        level = np.where(beyond, self.log.real, -1e3)
        best = np.argmax(level, axis=1)
        at_low = first.real >= level[rows, best]
        at = np.where(at_low, low, w[rows, best])
        figure = Figure(
            np.where(at_low, first.real, level[rows, best]),
            self.outer.gradient(at).real,
            at,
        )
        return figure, np.where(at_low, slope.real, 0.0)

    def noise(self) -> tuple[Figure, Figure]:
        """ln of the noise gain, and of the share of the voltage that noise takes,
        shape (K,).
        """
        sheet = self.sheet
        outer = np.exp(self.outer.log(sheet.noise_w))
        back = 1.0 / (1.0 + outer * sheet.noise_rest)
        power = np.abs(outer * back) ** 2 * sheet.weight
        moved = (self.outer.gradient(sheet.noise_w) * back).real
        found = []
        for share in (power, power * sheet.voltage**2):
            total = np.sum(share, axis=1) + 1e-300
            found.append(
                Figure(
                    0.5 * np.log(total), np.sum(share * moved, axis=2) / total, total
                )
            )
        return found[0], found[1]

    def modes(self) -> Figure:
        """ln of the largest loop gain of each link at each of the higher modes, shape
        (K, modes).
        """
        shape = (len(self.sheet), -1, MODE_POINTS)
        w = self.sheet.modes_w.reshape(shape)
        level = self.outer.log(w).real + self.sheet.modes_level.reshape(shape)
        best = np.argmax(level, axis=2)[..., None]
        at = np.take_along_axis(w, best, 2)[..., 0]
        value = np.take_along_axis(level, best, 2)[..., 0]
        return Figure(value, self.outer.gradient(at).real, at)
