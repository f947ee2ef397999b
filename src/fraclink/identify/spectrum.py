"""Identify from a frequency response: several modes with one common λ, outliers set aside.

    H(s) = g e^(−τs) s^(dλ) Π_i (s^λ + z_i^λ) / Π_i (s^λ + p_i^λ)

A resonance p_i and an anti-resonance z_i are in rad/s (or in radians per sample, where the frequencies
are); p_i = ϖ_i^(2/λ). d = 1 without anti-resonances is the torque of a link, d = 0 its tip.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fraclink.errors import FieldError, LogError, NotConvergedError
from fraclink.identify.levy import starting_points
from fraclink.link import LinkModel

__all__ = ["FrequencyResponse", "SpectrumFit", "frequency_response", "identify_frequency_response"]

Reals = NDArray[np.float64]
Complexes = NDArray[np.complex128]

_EXCITED = 0.05  # of the largest input line: below, a line's ratio is mostly noise
_ROUNDS = 5  # of setting outliers aside
_HAMPEL = 6.0  # robust standard deviations from the neighbours' median


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """Ratio of output to input lines at the excited frequencies.

    `frequency` [rad/s], `response` complex, `magnitude` of the input's lines: the weight with which each
    line's error appears in the output.
    """

    frequency: Reals
    response: Complexes
    magnitude: Reals


def frequency_response(
    signal: ArrayLike, output: ArrayLike, *, period: float = 1.0, threshold: float = _EXCITED
) -> FrequencyResponse:
    """Frequency response from whole periods of a periodic excitation.

    Arguments: `signal` and `output`, shape (N,), one or more whole periods; sampling period [s] (1 where
    it is unknown: frequencies are then in radians per sample); lines whose input is below `threshold`
    (0 to 1) of the largest are left out. Raises LogError for other lengths.

    >>> wave = np.cos(2 * np.pi * np.arange(64) / 16)
    >>> found = frequency_response(wave, 2 * wave)
    >>> found.response.real.round(6).tolist(), (found.frequency / 2 / np.pi).tolist()
    ([2.0], [0.0625])
    """
    u, y = np.asarray(signal, dtype=np.float64), np.asarray(output, dtype=np.float64)
    if u.ndim != 1 or u.shape != y.shape or u.size < 16:
        raise LogError(
            "output",
            str(y.shape),
            f"not as long as the input {u.shape}",
            allowed=">= 16 samples of each",
            remedy="cut both to the same whole periods",
        )
    into, out = np.fft.rfft(u)[1:], np.fft.rfft(y)[1:]
    lines = np.abs(into) >= threshold * np.max(np.abs(into))
    frequency = 2 * np.pi * np.arange(1, into.size + 1) / (u.size * period)
    return FrequencyResponse(frequency[lines], out[lines] / into[lines], np.abs(into[lines]))


@dataclass(frozen=True, eq=False)
class SpectrumFit:
    """A modal model with one common λ, fitted to a frequency response.

    Arguments:
        order: λ; resonances, anti_resonances: p_i, z_i ascending [rad/s]; gain: g, delay: τ [s].
        derivative: d. standard_errors: of "order", "delay", "resonance 1", … (robust to unequal noise).
        fit: 100 (1 − ‖w(H − Ĥ)‖/‖wH‖) over the lines that were kept [%].
        outliers: indices of the lines that were set aside. predicted: Ĥ at all lines.
        at_bound: whether λ ended on 1 or 2.
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
            raise FieldError(
                "resonances",
                len(self.resonances),
                "no single-mode link",
                allowed="1 resonance, no anti-resonance",
                remedy="fit one mode to make a LinkModel",
            )
        frequency = self.resonances[0] ** (self.order / 2)
        return LinkModel(stiffness or abs(self.gain), frequency, self.order, payload=payload)


def identify_frequency_response(
    frequency: ArrayLike,
    response: ArrayLike,
    *,
    coherence: ArrayLike | None = None,
    weights: ArrayLike | None = None,
    resonances: int = 1,
    anti_resonances: int = 0,
    derivative: int | None = None,
    order: float | None = None,
    delay: float | None = None,
    robust: bool = True,
) -> SpectrumFit:
    """Fit modes with one common λ to a frequency response; no guess is asked.

    Arguments:
        frequency: ω, shape (N,), > 0, ascending or not [rad/s] (or radians per sample).
        response: H(jω), complex, shape (N,).
        coherence: γ² in (0, 1) of each line; an error then counts as √(γ²/(1 − γ²))/|H|.
        weights: w of each line's error instead, such as the input's magnitude; 1 by default.
        resonances, anti_resonances: their numbers. derivative: d; 1 where there are no anti-resonances
            (base torque over motor angle), else 0.
        order, delay: values of λ and τ [s] that are known.
        robust: set lines aside that stand out from their neighbours (mains hum, lines of lost samples).

    Raises FieldError for bad arguments, NotConvergedError where nothing fits. Source: the paper, (10) and
    (11), extended to several modes.

    >>> w = np.linspace(1, 40, 200)
    >>> link = LinkModel(1.56, 10.02, order=1.92)
    >>> fit = identify_frequency_response(w, link.torque()(1j * w))
    >>> round(fit.order, 6), round(fit.gain, 6), round(fit.model().natural_frequency, 5)
    (1.92, 1.56, 10.02)
    """
    w, h, weight = _checked(frequency, response, coherence, weights)
    power = (0 if anti_resonances else 1) if derivative is None else derivative
    problem = _Problem(w, h, weight, resonances, anti_resonances, power, order, delay)
    if w.size < 2 * (resonances + anti_resonances) + 4:
        raise FieldError(
            "frequency",
            w.size,
            "too few lines",
            allowed=f">= {2 * (resonances + anti_resonances) + 4}",
            remedy="fit fewer modes",
        )
    if not robust:
        every = np.ones(w.size, dtype=bool)
        return problem.result(problem.solve(every, None, loss="linear"), every)
    # A loss that ignores outliers may also ignore a mode; one that does not may follow an outlier. Try both.
    tried = [_without_outliers(problem, loss) for loss in ("soft_l1", "linear")]
    return max(tried, key=lambda fit: fit.fit - 100 * len(fit.outliers) / w.size)


def _without_outliers(problem: _Problem, loss: str) -> SpectrumFit:
    kept = np.ones(problem.frequency.size, dtype=bool)
    best = problem.solve(kept, None, loss=loss)
    for _ in range(_ROUNDS):
        again = ~_standing_out(problem.weight * (problem.response - problem.predicted(best, kept)))
        best = problem.solve(again, best, loss="linear")
        settled = np.array_equal(again, kept)
        kept = again
        if settled:
            break
    return problem.result(best, kept)


@dataclass(frozen=True, eq=False)
class _Problem:
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
        from scipy.optimize import least_squares

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


def _standing_out(error: Complexes) -> NDArray[np.bool_]:
    """Lines whose error is far from the median of its neighbours': a model's error is smooth over lines."""
    count, reach = error.size, 4
    result = np.zeros(count, dtype=bool)
    floor = 1.4826 * float(np.median(np.abs(error)))
    for k in range(count):
        near = [i for i in range(max(0, k - reach), min(count, k + reach + 1)) if i != k]
        centre = np.median(error[near].real) + 1j * np.median(error[near].imag)
        spread = 1.4826 * float(np.median(np.abs(error[near] - centre)))
        result[k] = abs(error[k] - centre) > _HAMPEL * max(spread, floor)
    return result


def _checked(
    frequency: ArrayLike, response: ArrayLike, coherence: ArrayLike | None, weights: ArrayLike | None
) -> tuple[Reals, Complexes, Reals]:
    w, h = np.asarray(frequency, dtype=np.float64), np.asarray(response, dtype=np.complex128)
    if w.ndim != 1 or h.shape != w.shape:
        raise FieldError(
            "response",
            str(h.shape),
            f"not as long as frequency {w.shape}",
            allowed="equal lengths",
            remedy="cut one",
        )
    if not (np.all(np.isfinite(w)) and np.all(w > 0) and np.all(np.isfinite(h))):
        raise FieldError(
            "frequency",
            float(w.min()) if w.size else 0.0,
            "not positive or not finite",
            allowed="> 0 rad/s",
            remedy="leave the line at zero frequency out",
        )
    if weights is not None and coherence is not None:
        raise FieldError(
            "weights", "both", "given beside coherence", allowed="one of them", remedy="drop one"
        )
    if coherence is not None:
        share = np.asarray(coherence, dtype=np.float64)
        if share.shape != w.shape or not np.all((share > 0) & (share <= 1)):
            raise FieldError(
                "coherence",
                float(share.min()),
                "out of range",
                allowed="0 < γ² <= 1, one a line",
                remedy="leave lines without coherence out",
            )
        share = np.minimum(share, 1 - 1e-6)
        return w, h, np.sqrt(share / (1 - share)) / np.abs(h)
    weight = np.ones(w.size) if weights is None else np.asarray(weights, dtype=np.float64)
    if weight.shape != w.shape or not np.all(weight >= 0):
        raise FieldError(
            "weights", str(weight.shape), "of another length or negative", allowed=">= 0", remedy="check"
        )
    order = np.argsort(w)
    return w[order], h[order], weight[order]
