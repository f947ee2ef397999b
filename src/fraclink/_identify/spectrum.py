"""Identify from a frequency response: several modes with one common λ, outliers set
aside.

    H(s) = g e^(−τs) s^(dλ) Π_i (s^λ + z_i^λ) / Π_i (s^λ + p_i^λ)

A resonance p_i and an anti-resonance z_i are in rad/s (or in radians per sample, where
the frequencies are); p_i = ω₀_i^(2/λ). d = 1 without anti-resonances is the torque of a
link, d = 0 its tip.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.recording import (
    Coherence,
    FrequencyResponse,
    Lines,
    coherence_weights,
)
from fraclink._identify.modal import (
    LONGEST,
    Bits,
    Complexes,
    ModalProblem,
    Reals,
    SpectrumFit,
)
from fraclink.errors import FieldError, LogError
from fraclink.findings import Finding
from fracsys.checks import Array, Between, Fraction, LinkOrder, checked

_EXCITED = 0.05  # of the largest input line: below, a line's ratio is mostly noise
_MOST_MODES = (
    12  # each takes two parameters; measured tables seldom tell more than six apart
)
_ROUNDS = 5  # of setting outliers aside
_HAMPEL = 6.0  # robust standard deviations from the neighbours' median
# A gate: a model that leaves more than half of the response is none of this arm.
_FIT_LEAST = 50.0
_ERROR_MOST = 0.1  # relative standard error of a resonance, as in a fit to a log

Signal = Annotated[NDArray[np.float64], Array(1)]
Modes = Annotated[int, Between(0, _MOST_MODES)]
Weights = Annotated[NDArray[np.float64], Array(1), Between(0.0)]


@checked
def frequency_response(
    signal: Signal,
    output: Signal,
    *,
    period: Annotated[float, Between(0.0, 1e6, "s", low_open=True)] = 1.0,
    threshold: Fraction = _EXCITED,
) -> FrequencyResponse:
    """Frequency response from whole periods of a periodic excitation.

    Parameters
    ----------
    signal, output
        shape (N,), one or more whole periods.
    period
        sampling period [s]; 1 where it is unknown: frequencies are then in radians per
        sample.
    threshold
        lines whose input is below this share of the largest are left out [1].

    Raises
    ------
    LogError
        lengths that differ.

    Examples
    --------
    >>> wave = np.cos(2 * np.pi * np.arange(64) / 16)
    >>> found = frequency_response(wave, 2 * wave)
    >>> found.response.real.round(6).tolist(), (found.frequency / 2 / np.pi).tolist()
    ([2.0], [0.0625])
    """
    u, y = np.asarray(signal), np.asarray(output)
    # Sixteen: eight lines, of which one mode takes six.
    if u.shape != y.shape or u.size < 16:
        problem, remedy = (
            f"not as long as the input {u.shape}",
            "cut both to the same whole periods",
        )
        raise LogError(
            "output",
            str(y.shape),
            problem,
            allowed=">= 16 samples of each",
            remedy=remedy,
        )
    # Without the constant: an offset of the gauge is no response to anything.
    into, out = np.fft.rfft(u)[1:], np.fft.rfft(y)[1:]
    lines = np.abs(into) >= threshold * np.max(np.abs(into))
    frequency = 2 * np.pi * np.arange(1, into.size + 1) / (u.size * period)
    return FrequencyResponse(
        frequency[lines], out[lines] / into[lines], np.abs(into[lines])
    )


@checked
def identify_frequency_response(
    frequency: Lines,
    response: Annotated[NDArray[np.complex128], Array(1)],
    *,
    coherence: Coherence | None = None,
    weights: Weights | None = None,
    resonances: Modes = 1,
    anti_resonances: Modes = 0,
    derivative: Annotated[int, Between(-4, 4)] | None = None,
    order: LinkOrder | None = None,
    delay: Annotated[float, Between(-10.0, 10.0, "s")] | None = None,
    robust: bool = True,
) -> SpectrumFit:
    """Fit modes with one common λ to a frequency response; no guess is needed.

        H(s) = g e^(−τs) s^(dλ) Π_i (s^λ + z_i^λ) / Π_i (s^λ + p_i^λ)

    Parameters
    ----------
    frequency
        ω, shape (N,), > 0, ascending or not [rad/s] (or radians per sample).
    response
        H(jω), complex, shape (N,).
    coherence
        γ² in (0, 1] of each line; an error then counts as √(γ²/(1 − γ²))/|H|.
    weights
        w of each line's error instead, such as the input's magnitude; 1 by default.
    resonances, anti_resonances
        their numbers.
    derivative
        d; 1 where there are no anti-resonances (base torque over motor angle), else 0.
    order, delay
        values of λ and τ [s] that are known.
    robust
        set lines aside that stand out from their neighbours (mains hum, lines of lost
        samples).

    Raises
    ------
    FieldError
        arguments out of range or of different lengths.
    NotConvergedError
        nothing fits.

    References
    ----------
    Benftima et al. (2023), (10) and (11), extended to several modes.

    Examples
    --------
    >>> from fraclink._arm.link import LinkModel
    >>> w = np.linspace(1, 40, 200)
    >>> link = LinkModel(1.56, 10.02, order=1.92)
    >>> fit = identify_frequency_response(w, link.torque()(1j * w))
    >>> round(fit.order, 6), round(fit.gain, 6), round(fit.model().natural_frequency, 5)
    (1.92, 1.56, 10.02)
    """
    w, h, weight = _lines(frequency, response, coherence, weights)
    # The outliers are found beside their neighbours in frequency, whatever order the
    # table had.
    ascending = np.argsort(w)
    # Torque over angle goes with s^λ at low frequency and has no zeros; a tip or a
    # point on the beam has them.
    power = (0 if anti_resonances else 1) if derivative is None else derivative
    least = 2 * (resonances + anti_resonances) + 4
    if w.size < least:
        remedy = "fit fewer modes"
        raise FieldError(
            "frequency", w.size, "too few lines", allowed=f">= {least}", remedy=remedy
        )
    columns = (w[ascending], h[ascending], weight[ascending])
    problem = ModalProblem(*columns, resonances, anti_resonances, power, order, delay)
    if not robust:
        every = np.ones(w.size, dtype=bool)
        found = problem.result(problem.solve(every, None, loss="linear"), every)
    else:
        # A loss that ignores outliers may also ignore a mode; one that does not may
        # follow an outlier.
        tried = [_without_outliers(problem, loss) for loss in ("soft_l1", "linear")]
        # A percent of the fit for a percent of the lines: setting lines aside must not
        # pay by itself.
        found = max(tried, key=lambda fit: fit.fit - 100 * len(fit.outliers) / w.size)
    found = replace(found, findings=tuple(_findings(found, columns[0])))
    return _in_order(found, ascending)


def _lines(
    w: Reals, h: Complexes, coherence: Reals | None, weights: Reals | None
) -> tuple[Reals, Complexes, Reals]:
    """The lines with the weight of each; FieldError where their lengths differ."""
    if weights is not None and coherence is not None:
        raise FieldError(
            "weights",
            "both",
            "given beside coherence",
            allowed="one of them",
            remedy="drop one",
        )
    for name, column in (
        ("response", h),
        ("coherence", coherence),
        ("weights", weights),
    ):
        if column is not None and column.shape != w.shape:
            problem, remedy = (
                f"not as long as frequency {w.shape}",
                "give one for each frequency",
            )
            raise FieldError(
                name, str(column.shape), problem, allowed="equal lengths", remedy=remedy
            )
    if coherence is None:
        return w, h, np.ones(w.size) if weights is None else weights
    return w, h, coherence_weights(h, coherence)


def _findings(fit: SpectrumFit, frequency: Reals) -> Iterator[Finding]:
    """The gates of a frequency response: least squares always ends somewhere, also
    without a mode.
    """
    if fit.fit < _FIT_LEAST:
        yield Finding(
            "W313",
            "error",
            "the modes leave most of the response unexplained",
            {"fit_percent": fit.fit, "least": _FIT_LEAST},
            "check gain, phase and their units, and fit as many modes as the table shows",
        )
    yield from _of_the_places(fit, float(frequency.min()), float(frequency.max()))
    longest = LONGEST / float(frequency.max())
    if "delay" in fit.standard_errors and abs(fit.delay) > 0.999 * longest:
        yield Finding(
            "W301",
            "error",
            "the delay ended at the bound of its range",
            {"delay": fit.delay, "bound": longest},
            "check the phase's sign and unit, or give delay",
        )
    # At 2 the order ends where a classical link has it: that is no fault.
    if fit.at_bound and fit.order < 1.5:
        yield Finding(
            "W301",
            "error",
            "the order ended at 1, where nothing vibrates",
            {"order": fit.order},
            "check the unit of the frequency and which column is the gain",
        )
    # With anti-resonances the sign depends on where along the beam was measured.
    if fit.gain < 0 and not fit.anti_resonances:
        yield Finding(
            "W211",
            "error",
            "the response has the opposite sign of a link's",
            {"gain": fit.gain},
            "reverse the sign of one channel, or add 180° to the phase",
        )


def _of_the_places(fit: SpectrumFit, low: float, high: float) -> Iterator[Finding]:
    """Whether each resonance and anti-resonance lies where was measured, and is known
    there.
    """
    places = {"resonance": fit.resonances, "anti-resonance": fit.anti_resonances}
    for name, place in (
        (f"{kind} {i + 1}", w) for kind in places for i, w in enumerate(places[kind])
    ):
        error = fit.standard_errors[name] / place
        if not low <= place <= high:
            yield Finding(
                "W315",
                "error",
                f"{name} lies outside the frequencies that were measured",
                {"place": place, "low": low, "high": high},
                "fit fewer modes, or measure a wider band",
            )
        elif not error <= _ERROR_MOST:
            yield Finding(
                "W303",
                "error",
                f"the response does not determine {name}",
                {"place": place, "relative_error": error, "most": _ERROR_MOST},
                "fit fewer modes, or measure at more frequencies around it",
            )


def _in_order(fit: SpectrumFit, ascending: NDArray[np.intp]) -> SpectrumFit:
    """The fit with its lines numbered as the caller gave them."""
    predicted = np.empty_like(fit.predicted)
    predicted[ascending] = fit.predicted
    return replace(
        fit,
        outliers=tuple(sorted(int(ascending[k]) for k in fit.outliers)),
        predicted=predicted,
    )


def _without_outliers(problem: ModalProblem, loss: str) -> SpectrumFit:
    kept = np.ones(problem.frequency.size, dtype=bool)
    best = problem.solve(kept, None, loss=loss)
    for _ in range(_ROUNDS):
        # All lines are judged anew each time: one that was set aside beside a worse one
        # may return.
        again = ~_standing_out(
            problem.weight
            * (problem.response - problem.fitted(problem.full(best), kept)[1])
        )
        best = problem.solve(again, best, loss="linear")
        settled = np.array_equal(again, kept)
        kept = again
        if settled:
            break
    return problem.result(best, kept)


def _standing_out(error: Complexes) -> Bits:
    """Lines whose error is far from the median of its neighbours': a model's error is
    smooth over lines.
    """
    count, reach = error.size, 4
    result = np.zeros(count, dtype=bool)
    # Where the neighbours agree to the last digit any line would stand out: it must do
    # so from the table's usual error, too.
    floor = 1.4826 * float(np.median(np.abs(error)))
    for k in range(count):
        near = [
            i for i in range(max(0, k - reach), min(count, k + reach + 1)) if i != k
        ]
        centre = np.median(error[near].real) + 1j * np.median(error[near].imag)
        # 1.4826 times the median deviation is the standard deviation of Gaussian
        # errors, and no outlier moves it.
        spread = 1.4826 * float(np.median(np.abs(error[near] - centre)))
        result[k] = abs(error[k] - centre) > _HAMPEL * max(spread, floor)
    return result
