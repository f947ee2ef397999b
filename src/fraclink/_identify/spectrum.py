"""Identify from a frequency response: several modes with one common λ, outliers set aside.

    H(s) = g e^(−τs) s^(dλ) Π_i (s^λ + z_i^λ) / Π_i (s^λ + p_i^λ)

A resonance p_i and an anti-resonance z_i are in rad/s (or in radians per sample, where the frequencies
are); p_i = ω₀_i^(2/λ). d = 1 without anti-resonances is the torque of a link, d = 0 its tip.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fraclink._identify.modal import ModalProblem, SpectrumFit
from fraclink._validate import checked_between, checked_series, checked_whole
from fraclink.errors import FieldError, LogError

__all__ = ["FrequencyResponse", "SpectrumFit", "frequency_response", "identify_frequency_response"]

Reals = NDArray[np.float64]
Complexes = NDArray[np.complex128]

_EXCITED = 0.05  # of the largest input line: below, a line's ratio is mostly noise
_MOST_MODES = 12  # each takes two parameters; measured tables seldom tell more than six apart
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
    u, y = checked_series("signal", signal), checked_series("output", output)
    checked_between("period", period, 0.0, 1e6, "s", open_low=True)
    checked_between("threshold", threshold, 0.0, 1.0)
    if u.shape != y.shape or u.size < 16:
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

    >>> from fraclink._arm.link import LinkModel
    >>> w = np.linspace(1, 40, 200)
    >>> link = LinkModel(1.56, 10.02, order=1.92)
    >>> fit = identify_frequency_response(w, link.torque()(1j * w))
    >>> round(fit.order, 6), round(fit.gain, 6), round(fit.model().natural_frequency, 5)
    (1.92, 1.56, 10.02)
    """
    w, h, weight = _checked(frequency, response, coherence, weights)
    ascending = np.argsort(w)
    checked_whole("resonances", resonances, 0, _MOST_MODES)
    checked_whole("anti_resonances", anti_resonances, 0, _MOST_MODES)
    default = 0 if anti_resonances else 1
    power = default if derivative is None else checked_whole("derivative", derivative, -4, 4)
    if order is not None:
        order = checked_between("order", order, 1.0, 2.0)
    if delay is not None:
        delay = checked_between("delay", delay, -10.0, 10.0, "s")
    if w.size < 2 * (resonances + anti_resonances) + 4:
        raise FieldError(
            "frequency",
            w.size,
            "too few lines",
            allowed=f">= {2 * (resonances + anti_resonances) + 4}",
            remedy="fit fewer modes",
        )
    columns = (w[ascending], h[ascending], weight[ascending])
    problem = ModalProblem(*columns, resonances, anti_resonances, power, order, delay)
    if not robust:
        every = np.ones(w.size, dtype=bool)
        found = problem.result(problem.solve(every, None, loss="linear"), every)
    else:
        # A loss that ignores outliers may also ignore a mode; one that does not may follow an outlier.
        tried = [_without_outliers(problem, loss) for loss in ("soft_l1", "linear")]
        found = max(tried, key=lambda fit: fit.fit - 100 * len(fit.outliers) / w.size)
    return _in_order(found, ascending)


def _in_order(fit: SpectrumFit, ascending: NDArray[np.intp]) -> SpectrumFit:
    """The fit with its lines numbered as the caller gave them."""
    predicted = np.empty_like(fit.predicted)
    predicted[ascending] = fit.predicted
    return replace(fit, outliers=tuple(sorted(int(ascending[k]) for k in fit.outliers)), predicted=predicted)


def _without_outliers(problem: ModalProblem, loss: str) -> SpectrumFit:
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
    w, h = checked_series("frequency", frequency), _complexes(response)
    if h.shape != w.shape:
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
        share = checked_series("coherence", coherence)
        if share.shape != w.shape or not np.all((share > 0) & (share <= 1)):
            raise FieldError(
                "coherence",
                float(share.min()) if share.size else "an empty column",
                "out of range",
                allowed="0 < γ² <= 1, one a line",
                remedy="leave lines without coherence out",
            )
        if not np.all(np.abs(h) > 0):
            raise FieldError("response", 0, "zero at a line", allowed="|H| > 0", remedy="leave that line out")
        share = np.minimum(share, 1 - 1e-6)
        return w, h, np.sqrt(share / (1 - share)) / np.abs(h)
    weight = np.ones(w.size) if weights is None else checked_series("weights", weights)
    if weight.shape != w.shape or not np.all((weight >= 0) & (weight < math.inf)):
        raise FieldError(
            "weights",
            f"{weight.size} weights",
            "of another length, negative or not finite",
            allowed=">= 0, one a line",
            remedy="give one for each frequency",
        )
    return w, h, weight


def _complexes(response: ArrayLike) -> Complexes:
    """The response as a complex column; FieldError for anything else."""
    try:
        values = np.asarray(response)
        numbers = values.astype(np.complex128) if values.dtype.kind in "iufc" else None
    except (TypeError, ValueError, OverflowError):
        numbers = None
    if numbers is None or numbers.ndim != 1:
        raise FieldError(
            "response",
            type(response).__name__,
            "no column of complex numbers",
            allowed="shape (N,)",
            remedy="give gain·exp(j·phase)",
        )
    return numbers
