"""Where the search for a structure begins: draws of orders and delays, coefficients by
linear least squares.

Numerator and denominator of a text come from an algebra of quotients that are not
divided out. Sanathanan and Koerner, IEEE Trans. Autom. Control 8 (1963) 56: the
equation N U = D Y is straight in the coefficients, and divided by the last D its error
is that of the output.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fraclink._identify.expression import Expression, Leaves, walk
from fraclink._identify.structure_data import Spectrum
from fraclink._identify.structure_problem import StructureCoordinates

__all__ = ["Starts", "quotient"]

Reals = NDArray[np.float64]
Complexes = NDArray[np.complex128]

_DRAWS = 60  # for each order or delay that is free, up to three
_DRAWS_AT_RANDOM = 600
_USUAL_ORDERS = (0.1, 2.5)  # of draws: a descent finds the rest of the range by itself
_ROUNDS = 5  # of Sanathanan and Koerner


@dataclass(frozen=True, eq=False)
class Starts:
    """Values to begin at for one structure and one transform."""

    coordinates: StructureCoordinates
    spectrum: Spectrum
    offset_is_free: bool

    def values(self) -> dict[str, Reals]:
        """Values of all free parameters, shape (M,) each; signs as the data have them.

        Coefficients by least squares are near where there is little noise; those at
        random are near some of the time under any.
        """
        own = self.coordinates
        straight = self._straight()
        shaped = [n for n in own.names if own.structure.roles[n] != "coefficient"]
        counts = [_DRAWS_AT_RANDOM]
        if straight:
            counts = [_DRAWS * min(max(len(shaped), 1), 3), _DRAWS_AT_RANDOM // 3]
        # Evenly spread and the same in every run: of 60 draws at random some orders
        # would be found by some seeds only.
        uniform = _halton(sum(counts), len(own.names))
        found = {n: self._drawn(n, uniform[:, k]) for k, n in enumerate(own.names)}
        if straight:
            first = {name: values[: counts[0]] for name, values in found.items()}
            solved = first | self._solved(first, straight)
            # Least squares know neither a range nor that a machine is stable: what came
            # out negative is tried as large with the other sign, too.
            turned = solved | {
                n: math.copysign(1.0, own.limits[n][1]) * np.abs(solved[n])
                for n in straight
            }
            found = {
                n: np.concatenate([solved[n], turned[n], v[counts[0] :]])
                for n, v in found.items()
            }
        return found

    def _drawn(self, name: str, uniform: Reals) -> Reals:
        own = self.coordinates
        low, high = own.limits[name]
        role = own.structure.roles[name]
        if role == "order":
            low, high = (
                max(low, min(_USUAL_ORDERS[0], high)),
                min(high, max(_USUAL_ORDERS[1], low)),
            )
            return np.asarray(low + (high - low) * uniform)
        size = np.abs(self.spectrum.points)
        slowest, fastest = float(size.min()), float(size.max())
        if role == "delay":
            # Small ones matter most, and none at all is the most usual.
            longest = min(high, 1.0 / slowest)
            scaled = np.maximum(
                longest * (fastest / slowest) ** (uniform - 1.0)
                - longest * slowest / fastest,
                low,
            )
            return np.where(uniform < 0.25, low, scaled)
        if name == own.gain:
            return np.ones(uniform.size)
        # ω^(−4 … 4) for a frequency of the band: coefficients are powers of one,
        # whatever the structure.
        frequency = slowest * (fastest / slowest) ** ((uniform * 7.0) % 1.0)
        sign = np.where((uniform * 31.0) % 1.0 < 0.25, -1.0, 1.0) if low < 0.0 else 1.0
        return np.clip(sign * frequency ** (8.0 * uniform - 4.0), low, high)

    def _straight(self) -> tuple[str, ...]:
        """Free coefficients in which N and D are straight together; none where they are
        not in all.
        """
        own = self.coordinates
        names = tuple(n for n in own.names if own.structure.roles[n] == "coefficient")
        if not names:
            return ()
        # N and D are straight in the coefficients if, and at points in general position
        # only if, their values at zero and one unit of each coefficient add up to those
        # at any other place.
        points = self.spectrum.points[:: max(1, self.spectrum.points.size // 5)]
        points = points / np.median(np.abs(points))
        base = own.middle()
        probes = [{**base, **dict.fromkeys(names, np.zeros((1, 1)))}]
        probes += [{**probes[0], name: np.ones((1, 1))} for name in names]
        zero, *units = (
            np.stack(quotient(own.structure, probe, points)) for probe in probes
        )
        whole = np.stack(quotient(own.structure, base, points))
        built = zero + sum(
            base[n][0, 0] * (unit - zero) for n, unit in zip(names, units, strict=True)
        )
        return names if np.allclose(whole, built, rtol=1e-9, atol=1e-12) else ()

    def _solved(
        self, values: Mapping[str, Reals], names: tuple[str, ...]
    ) -> dict[str, Reals]:
        """Coefficients of every draw by iterated linear least squares, shape (M,) each."""
        own = self.coordinates
        fixed = {name: np.array([[value]]) for name, value in own.fixed.items()}
        drawn = {
            name: column[:, None]
            for name, column in values.items()
            if name not in names
        }
        count = len(next(iter(values.values())))
        base = fixed | drawn | dict.fromkeys(names, np.zeros((1, 1)))
        probes = [base, *({**base, name: np.ones((1, 1))} for name in names)]
        shape = (count, self.spectrum.points.size)
        pairs = [
            quotient(own.structure, probe, self.spectrum.points) for probe in probes
        ]
        tops, bottoms = (
            np.stack([np.broadcast_to(p[i], shape) for p in pairs]) for i in (0, 1)
        )
        tops[1:] -= tops[0]
        bottoms[1:] -= bottoms[0]
        equations = (
            tops * self.spectrum.input - bottoms * self.spectrum.output
        )  # N U − D Y, to be zero
        divisor = np.ones(shape, dtype=np.complex128)
        found = np.ones((count, len(names)))
        for _ in range(_ROUNDS):
            # The first round weighs by one: what Levy did alone, which favours high
            # frequencies; from the second on the last denominator takes that away.
            row = self.spectrum.weight / np.maximum(np.abs(divisor), 1e-300)
            columns = [row * e for e in equations[1:]]
            if self.spectrum.of_constant is not None and self.offset_is_free:
                # N U + c D/s − D Y: an offset in the output passes the same
                # denominator.
                columns.append(row * self.spectrum.of_constant * divisor)
            if self.spectrum.of_state is not None:
                columns += [row * state for state in self.spectrum.of_state]
            found = _least_squares(np.stack(columns, axis=1), -row * equations[0])[
                :, : len(names)
            ]
            divisor = bottoms[0] + np.einsum("nmk,mn->mk", bottoms[1:], found)
        return {name: found[:, k] for k, name in enumerate(names)}


def _least_squares(
    matrix: NDArray[np.complex128], right: NDArray[np.complex128]
) -> Reals:
    """Real solutions (M, n) of M complex systems, matrix (M, n, K), right (M, K);
    columns are scaled.
    """
    real = np.concatenate([matrix.real, matrix.imag], axis=2)
    wanted = np.concatenate([right.real, right.imag], axis=1)
    size = np.sqrt(np.einsum("mnk,mnk->mn", real, real))
    size = np.where((size > 0) & np.isfinite(size), size, 1.0)
    real = np.nan_to_num(real / size[:, :, None])
    wanted = np.nan_to_num(wanted)
    # QR and not the normal matrix: columns of nearly equal orders are nearly parallel,
    # and its square would lose twice the digits.
    q, r = np.linalg.qr(real.transpose(0, 2, 1))
    diagonal = np.einsum("mnn->mn", r)
    # Two columns that are one (orders that were drawn alike): the pivot is held away
    # from zero, and the start is merely a bad one.
    small = np.abs(diagonal) < 1e-10
    r[:, range(r.shape[1]), range(r.shape[1])] = np.where(small, 1e-10, diagonal)
    solution = np.linalg.solve(r, np.einsum("mkn,mk->mn", q, wanted)[:, :, None])[
        :, :, 0
    ]
    return np.asarray(solution / size)


def _halton(count: int, size: int) -> Reals:
    """Points that fill the unit cube evenly, the same in every run, shape (count,
    size).
    """
    primes = (2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37)
    result = np.zeros((count, size))
    for k in range(size):
        number, weight = np.arange(1, count + 1), 1.0
        while number.any():
            weight /= primes[k]
            number, digit = np.divmod(number, primes[k])
            result[:, k] += weight * digit
    return result


# --- numerator and denominator ------------------------------------------------------------------------------


def quotient(
    structure: Expression, values: Mapping[str, Any], points: Complexes
) -> tuple[Complexes, Complexes]:
    """Numerator and denominator of G at `points` [rad/s], as the text divides them."""
    logarithm = np.log(points)
    leaves = Leaves(
        _Ratio(points),
        lambda order: _Ratio(np.exp(_plain(order) * logarithm)),
        lambda ratio: _Ratio(np.exp(ratio.top / ratio.bottom)),
        {name: np.asarray(value, dtype=np.float64) for name, value in values.items()},
    )
    with np.errstate(
        all="ignore"
    ):  # a draw may overflow: it is a bad start, and others are better
        found = _Ratio.of(walk(structure.tree, leaves))
    shape = np.broadcast_shapes(
        np.shape(found.top), np.shape(found.bottom), points.shape
    )
    return np.broadcast_to(found.top, shape), np.broadcast_to(found.bottom, shape)


def _plain(value: Any) -> Any:
    return value.top / value.bottom if isinstance(value, _Ratio) else value


def _is_one(bottom: Any) -> bool:
    return np.isscalar(bottom) and bottom == 1.0


@dataclass(frozen=True)
class _Ratio:
    """A quotient of arrays that is not divided out."""

    top: Any
    bottom: Any = 1.0

    __array_ufunc__ = None  # numpy hands `array * ratio` to the methods below

    @staticmethod
    def of(value: Any) -> _Ratio:
        return value if isinstance(value, _Ratio) else _Ratio(value)

    def __add__(self, other: Any) -> _Ratio:
        right = _Ratio.of(other)
        # A common denominator is kept and not squared: the equations would have roots
        # that G has not.
        if self.bottom is right.bottom or (
            _is_one(self.bottom) and _is_one(right.bottom)
        ):
            return _Ratio(self.top + right.top, self.bottom)
        return _Ratio(
            self.top * right.bottom + right.top * self.bottom,
            self.bottom * right.bottom,
        )

    def __radd__(self, other: Any) -> _Ratio:
        return _Ratio.of(other) + self

    def __neg__(self) -> _Ratio:
        return _Ratio(-self.top, self.bottom)

    def __sub__(self, other: Any) -> _Ratio:
        return self + (-_Ratio.of(other))

    def __rsub__(self, other: Any) -> _Ratio:
        return _Ratio.of(other) + (-self)

    def __mul__(self, other: Any) -> _Ratio:
        right = _Ratio.of(other)
        return _Ratio(self.top * right.top, self.bottom * right.bottom)

    def __rmul__(self, other: Any) -> _Ratio:
        return _Ratio.of(other) * self

    def __truediv__(self, other: Any) -> _Ratio:
        right = _Ratio.of(other)
        return _Ratio(self.top * right.bottom, self.bottom * right.top)

    def __rtruediv__(self, other: Any) -> _Ratio:
        return _Ratio.of(other) / self

    def __pow__(self, exponent: Any) -> _Ratio:
        power = _plain(exponent)
        if isinstance(power, int | float) and power < 0:
            # A negative power turns the quotient over: (s + 1)^−1 has its root in the
            # denominator.
            return _Ratio(self.bottom**-power, self.top**-power)
        return _Ratio(self.top**power, self.bottom**power)
