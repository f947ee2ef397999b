"""A modal model with one common λ: its starting points, its least-squares problem, its result.

A start comes from peaks and dips, and from Levy's linear equations in x = s^λ. With H D(x) = N(x) linear in
the coefficients of D and N, no guess is needed; the roots of D and N in x are −p^λ and −z^λ where the
response is what the model says. Where a response has more modes than the model, Levy's roots pair up
beside a strong one; its most prominent peaks and dips do not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares

from fraclink._arm.link import LinkModel
from fraclink.errors import FieldError, NotConvergedError

Reals = NDArray[np.float64]
Complexes = NDArray[np.complex128]

_ORDERS = (1.98, 1.9, 1.75)
_DELAYS = (0.0, 0.3, 1.0)  # in radians at the highest frequency
_ROUNDS = 6
_SPARE = 2  # peaks and dips more than there are modes


@dataclass(frozen=True, eq=False)
class SpectrumFit:
    """A modal model with one common λ, fitted to a frequency response.

    Parameters
    ----------
    order
        λ.
    resonances, anti_resonances
        p_i, z_i ascending [rad/s].
    gain, delay
        g [unit of H at high frequency] and τ [s].
    derivative
        d.
    standard_errors
        of "order", "delay", "resonance 1", … (robust to unequal noise).
    fit
        100 (1 − ‖w(H − Ĥ)‖/‖wH‖) over the lines that were kept [%].
    outliers
        indices of the lines that were set aside.
    at_bound
        whether λ ended on 1 or 2.
    predicted
        Ĥ at all lines.
    """

    order: float
    resonances: tuple[float, ...]
    anti_resonances: tuple[float, ...]
    gain: float
    delay: float
    derivative: int
    standard_errors: dict[str, float]
    fit: float
    outliers: tuple[int, ...]
    at_bound: bool
    predicted: Complexes = field(repr=False)

    def response(self, frequency: ArrayLike) -> Complexes:
        """Ĥ(jω) at `frequency` [rad/s]."""
        values = [self.order, self.delay, *np.log(self.resonances), *np.log(self.anti_resonances)]
        basis = _basis(
            np.array(values), np.asarray(frequency, dtype=np.float64), len(self.resonances), self.derivative
        )
        return np.asarray(self.gain * basis, dtype=np.complex128)

    def model(self, *, stiffness: float | None = None, payload: float | None = None) -> LinkModel:
        """The link of a fit with one resonance and no anti-resonance; c is `stiffness` or |gain|."""
        if len(self.resonances) != 1 or self.anti_resonances:
            allowed, remedy = "1 resonance, no anti-resonance", "fit one mode to make a LinkModel"
            raise FieldError(
                "resonances", len(self.resonances), "no single-mode link", allowed=allowed, remedy=remedy
            )
        frequency = self.resonances[0] ** (self.order / 2)
        c = stiffness or abs(self.gain)
        return LinkModel(c, frequency, self.order, payload=payload, gauge_delay=self.delay)


@dataclass(frozen=True, eq=False)
class ModalProblem:
    """Lines of a response with their weights, and how many modes are to be found in them."""

    frequency: Reals
    response: Complexes
    weight: Reals
    resonances: int
    anti_resonances: int
    derivative: int
    order: float | None
    delay: float | None

    def full(self, free: Reals) -> Reals:
        """All parameters from the free ones: λ, τ, ln p, ln z."""
        values = list(free)
        order = self.order if self.order is not None else values.pop(0)
        delay = self.delay if self.delay is not None else values.pop(0)
        return np.array([order, delay, *values])

    def predicted(self, free: Reals, kept: NDArray[np.bool_]) -> Complexes:
        basis = _basis(self.full(free), self.frequency, self.resonances, self.derivative)
        return self._gain(basis, kept) * basis

    def _gain(self, basis: Complexes, kept: NDArray[np.bool_]) -> float:
        a, b = (self.weight * basis)[kept], (self.weight * self.response)[kept]
        return float(np.real(np.vdot(a, b)) / np.real(np.vdot(a, a)))

    def errors(self, free: Reals, kept: NDArray[np.bool_]) -> Reals:
        error = (self.weight * (self.response - self.predicted(free, kept)))[kept]
        return np.concatenate([error.real, error.imag])

    def solve(self, kept: NDArray[np.bool_], start: Reals | None, *, loss: str) -> Reals:
        scale = float(np.median(np.abs((self.weight * self.response)[kept])))
        starts = [start] if start is not None else self._starts(kept)
        low, high = self._limits()
        best, least = None, math.inf
        for point in starts:
            inside = np.clip(point, low + 1e-9, high - 1e-9)
            found = least_squares(
                lambda x: self.errors(x, kept) / scale,
                inside,
                bounds=(low, high),
                loss=loss,
                f_scale=0.05,
                x_scale="jac",
                xtol=1e-12,
                ftol=1e-12,
                gtol=1e-12,
                max_nfev=300,
            )
            if found.cost < least:
                best, least = np.asarray(found.x, dtype=np.float64), float(found.cost)
        if best is None:
            raise NotConvergedError(
                "the frequency fit", reached=math.inf, wanted=0.0, remedy="fit fewer modes or a narrower band"
            )
        return best

    def _limits(self) -> tuple[Reals, Reals]:
        low_w, high_w = math.log(self.frequency.min()) - 1.5, math.log(self.frequency.max()) + 1.5
        most = 20 / self.frequency.max()
        count = self.resonances + self.anti_resonances
        low = ([] if self.order is not None else [1.0]) + ([] if self.delay is not None else [-most])
        high = ([] if self.order is not None else [2.0]) + ([] if self.delay is not None else [most])
        return np.array(low + [low_w] * count), np.array(high + [high_w] * count)

    def _starts(self, kept: NDArray[np.bool_]) -> list[Reals]:
        places = starting_points(
            self.frequency[kept],
            self.response[kept],
            self.weight[kept],
            self.resonances,
            self.anti_resonances,
            self.derivative,
            order=self.order,
            delay=self.delay,
        )
        head = (0 if self.order is None else 1), (0 if self.delay is None else 1)
        return [np.delete(x, [i for i in (0, 1) if head[i]]) for x in places]

    def result(self, free: Reals, kept: NDArray[np.bool_]) -> SpectrumFit:
        full = self.full(free)
        basis = _basis(full, self.frequency, self.resonances, self.derivative)
        gain = self._gain(basis, kept)
        p, z = np.exp(full[2 : 2 + self.resonances]), np.exp(full[2 + self.resonances :])
        error = (self.weight * (self.response - gain * basis))[kept]
        whole = (self.weight * self.response)[kept]
        return SpectrumFit(
            order=float(full[0]),
            resonances=tuple(np.sort(p).tolist()),
            anti_resonances=tuple(np.sort(z).tolist()),
            gain=gain,
            delay=float(full[1]),
            derivative=self.derivative,
            standard_errors=self._standard_errors(free, kept),
            fit=100 * (1 - float(np.linalg.norm(error) / np.linalg.norm(whole))),
            outliers=tuple(np.flatnonzero(~kept).tolist()),
            at_bound=self.order is None and not 1 + 1e-6 < full[0] < 2 - 1e-6,
            predicted=gain * basis,
        )

    def _standard_errors(self, free: Reals, kept: NDArray[np.bool_]) -> dict[str, float]:
        """White's sandwich: lines near a resonance err more than others, and in their own way."""
        steps = 1e-6
        columns = [
            (self.errors(free + steps * unit, kept) - self.errors(free - steps * unit, kept)) / (2 * steps)
            for unit in np.eye(free.size)
        ]
        jacobian, error = np.array(columns).T, self.errors(free, kept)
        inverse = np.linalg.pinv(jacobian.T @ jacobian)
        meat = (jacobian * error[:, None]).T @ (jacobian * error[:, None])
        spread = np.sqrt(np.maximum(np.diag(inverse @ meat @ inverse), 0))
        names = ([] if self.order is not None else ["order"]) + ([] if self.delay is not None else ["delay"])
        full = self.full(free)
        result = dict(zip(names, spread[: len(names)].tolist(), strict=True))
        for kind, first, count in (
            ("resonance", 0, self.resonances),
            ("anti-resonance", self.resonances, self.anti_resonances),
        ):
            logs, own = (
                full[2 + first : 2 + first + count],
                spread[len(names) + first : len(names) + first + count],
            )
            for rank, i in enumerate(np.argsort(logs)):
                result[f"{kind} {rank + 1}"] = float(own[i] * math.exp(logs[i]))
        return result


def _basis(full: Reals, frequency: Reals, resonances: int, derivative: int) -> Complexes:
    """Ĥ for g = 1."""
    s = 1j * frequency
    order, delay = full[0], full[1]
    power = s**order
    value = np.exp(-delay * s) * power**derivative
    for log_zero in full[2 + resonances :]:
        value = value * (power + math.exp(order * log_zero))
    for log_pole in full[2 : 2 + resonances]:
        value = value / (power + math.exp(order * log_pole))
    return np.asarray(value, dtype=np.complex128)


# --- starting points ---------------------------------------------------------------------------------------


def starting_points(
    frequency: Reals,
    response: Complexes,
    weight: Reals,
    resonances: int,
    anti_resonances: int,
    derivative: int,
    *,
    order: float | None,
    delay: float | None,
) -> list[Reals]:
    """Vectors (λ, τ, ln p…, ln z…) to start from, the best of a small grid in λ and τ first."""
    found = []
    scale = float(np.exp(np.mean(np.log(frequency))))
    delays = [d / frequency.max() for d in _DELAYS] if delay is None else [delay]
    for lam in _ORDERS if order is None else (order,):
        x = np.asarray((1j * frequency / scale) ** lam, dtype=np.complex128)
        for tau in delays:
            moved = np.asarray(response * np.exp(1j * frequency * tau) / x**derivative, dtype=np.complex128)
            top, bottom, error = _levy(x, moved, weight, anti_resonances, resonances)
            places = [_places(c, lam, scale) for c in (bottom, top)]
            found.append((error, np.array([lam, tau, *places[0], *places[1]])))
    found.sort(key=lambda pair: pair[0])
    by_eye = []
    for lam in _ORDERS[:2] if order is None else (order,):
        x = np.asarray((1j * frequency) ** lam, dtype=np.complex128)
        for spots in _seen(frequency, response, resonances, anti_resonances):
            error = _misfit(x, response, weight, np.exp(lam * np.array(spots)), resonances, derivative)
            by_eye.append((error, np.array([lam, delays[0], *spots])))
    by_eye.sort(key=lambda pair: pair[0])
    return [point for _, point in found[:2] + by_eye[:3]]


def _seen(frequency: Reals, response: Complexes, peaks: int, dips: int) -> list[tuple[float, ...]]:
    """ln of prominent peaks and dips of |H|, every choice of them; noise may stand out like a mode."""
    level = np.log(np.abs(response) + 1e-300)
    smooth = np.array([np.median(level[max(0, k - 1) : k + 2]) for k in range(level.size)])
    ups, downs = _prominent(smooth, peaks + _SPARE), _prominent(-smooth, dips + _SPARE)
    logs = np.log(frequency)
    return [
        tuple(float(logs[k]) for k in (*up, *down))
        for up in combinations(ups, peaks)
        for down in combinations(downs, dips)
    ]


def _misfit(
    x: Complexes, response: Complexes, weight: Reals, powers: Reals, resonances: int, derivative: int
) -> float:
    basis = x**derivative
    for power in powers[resonances:]:
        basis = basis * (x + power)
    for power in powers[:resonances]:
        basis = basis / (x + power)
    a, b = weight * basis, weight * response
    gain = np.real(np.vdot(a, b)) / np.real(np.vdot(a, a))
    return float(np.linalg.norm(b - gain * a))


def _prominent(level: Reals, count: int) -> list[int]:
    """The `count` local maxima that stand highest over the saddle to a higher one."""
    rows = []
    for k in range(1, level.size - 1):
        if not level[k - 1] < level[k] >= level[k + 1]:
            continue
        saddles = []
        for side in (level[k::-1], level[k:]):
            higher = np.flatnonzero(side > level[k])
            saddles.append(float(np.min(side[: higher[0]] if higher.size else side)))
        rows.append((level[k] - max(saddles), k))
    return sorted(k for _, k in sorted(rows, reverse=True)[:count])


def _levy(
    x: Complexes, response: Complexes, weight: Reals, zeros: int, poles: int
) -> tuple[Reals, Reals, float]:
    """Coefficients (highest first) of N and D with D monic, and the weighted error of their ratio."""
    divisor: Complexes = np.ones(x.size, dtype=np.complex128)
    top, bottom, error = np.ones(zeros + 1), np.ones(poles + 1), np.inf
    for _ in range(_ROUNDS):
        row = (weight / np.abs(divisor))[:, None]
        matrix = row * np.column_stack(
            [x**k for k in range(zeros, -1, -1)] + [-response * x**k for k in range(poles - 1, -1, -1)]
        )
        right = row[:, 0] * response * x**poles
        solution = np.linalg.lstsq(
            np.concatenate([matrix.real, matrix.imag]), np.concatenate([right.real, right.imag]), rcond=None
        )[0]
        top, bottom = solution[: zeros + 1], np.concatenate([[1.0], solution[zeros + 1 :]])
        divisor = np.asarray(np.polyval(bottom, x), dtype=np.complex128)
        error = float(np.linalg.norm(weight * (response - np.polyval(top, x) / divisor)))
    return top, bottom, error


def _places(coefficients: Reals, order: float, scale: float) -> list[float]:
    """ln of the frequencies |root|^(1/λ) of a polynomial in x."""
    roots = np.roots(coefficients) if np.any(coefficients[:-1]) else np.zeros(0)
    missing = coefficients.size - 1 - roots.size
    sizes = np.sort(np.abs(roots)).tolist() + [1.0] * missing
    return [float(np.log(max(size, 1e-9)) / order + np.log(scale)) for size in sizes]
