"""Drawings of logs and models: record, prediction and residual."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from fraclink._arm.experiment import Experiment
from fraclink._identify import Comparison, Fit, StructureFit, Validation
from fraclink._identify.welch import averaged_response, segments
from fraclink.logs._start import Start
from fraclink.view._drawing import Figure, Panel, figure_of
from fraclink.view._marks import Across, Band, Curve, Mark, Upright, record
from fraclink.view._responses import decibels
from fraclink.view._scales import POINTS, Scale
from fracsys.checks import Complex, Real

__all__ = [
    "fit_figure",
    "fit_panels",
    "log_figure",
    "models_figure",
    "residual_figure",
    "response_figure",
]
__all__ += [
    "structure_figure",
    "validation_figure",
]

OUTPUT_LABEL = {
    "torque": "base torque Γ [N·m]",
    "deflection": "deflection θm − θt [rad]",
}
_SHORT = {"torque": "Γ [N·m]", "deflection": "θm − θt [rad]"}

Floats = NDArray[np.floating[Any]]


def _record(
    time: Floats, values: Floats, line: int, name: str = "", *, wide: bool = False
) -> Curve:
    """A record as a line that preserves every peak."""
    # With more than about two samples per dot a curve is a band of ink, whose edge a
    # thin stroke shows better.
    thin = not wide and len(values) > 2 * POINTS
    return record(time, values, line, name, "wide" if wide else "thin" if thin else "")


@figure_of.register
def log_figure(log: Experiment) -> Figure:
    """Draw motor angle and output against time."""
    panels = (
        Panel("motor angle θm [rad]", [_record(log.time, log.motor_angle, 0)]),
        Panel(OUTPUT_LABEL[log.output_kind], [_record(log.time, log.output, 1)]),
    )
    return Figure(
        "log",
        "The recorded motor angle and output against time",
        panels,
        "time [s]",
        "log",
    )


def fit_figure(log: Experiment, fit: Fit) -> Figure:
    """Draw a whole log and its model: motor angle, measured and computed output,
    residual.
    """
    # The last fitted sample: left of it the residual was minimised, right of it the
    # residual is a test.
    edge = float(log.time[fit.fitted_samples - 1])
    output = _measured(log.time, log.output, fit.predicted, fit.structure)
    panels = (
        Panel("angle θm [rad]", [_record(log.time, log.motor_angle, 0)], 80.0),
        Panel(OUTPUT_LABEL[log.output_kind], output, 180.0),
        Panel("residual", _rest(log.time, fit.residual, edge), 80.0),
    )
    return Figure(
        "fit",
        "The recorded output under its model, and the residual",
        panels,
        "time [s]",
        "log",
    )


def _measured(
    time: Floats, measured: Floats, predicted: Floats, name: str
) -> list[Mark]:
    """A measured record, with the prediction of the given name on top."""
    return [
        _record(time, measured, 0, "measured", wide=True),
        record(time, predicted, 1, name),
    ]


def _rest(time: Floats, residual: Floats, edge: float, line: int = 1) -> list[Mark]:
    """A residual, with the end of the fitted part marked."""
    mark = Upright(edge, "held out from here") if edge < time[-1] else None
    return [_record(time, residual, line), *([mark] if mark else [])]


@figure_of.register
def validation_figure(validation: Validation) -> Figure:
    """Draw each other log with the prediction of the fit and its residual."""
    panels = []
    for each in validation.logs:
        log, rest = each.log, each.log.output - each.predicted
        label = f"{OUTPUT_LABEL[log.output_kind]}, {log.source}".rstrip(", ")
        output = _measured(log.time, log.output, each.predicted, "predicted")
        marks: list[Mark] = [
            _record(log.time, rest, 1),
            Across(each.bias, "bias", limit=False),
        ]
        panels += [Panel(label, output), Panel("prediction error", marks, 60.0)]
    return Figure(
        "validation",
        "Logs that the fit has not seen, their predictions and the prediction errors",
        panels,
        "time [s]",
        "log",
    )


@figure_of.register
def structure_figure(fit: StructureFit) -> Figure:
    """Draw measurement, prediction of the structure and residual, over time or
    frequency.
    """
    return _over_time(fit) if fit.period is not None else _over_frequency(fit)


def _over_time(fit: StructureFit) -> Figure:
    place, rest = fit.place, fit.measured - fit.predicted
    output = _measured(place, fit.measured, fit.predicted, "structure")
    panels = (
        Panel("output", output, 180.0),
        Panel("residual", _rest(place, rest, float(place[fit.fitted - 1]))),
    )
    return Figure(
        "structure",
        f"The recorded output, its prediction by {fit.expression}, and the residual",
        panels,
        "time [s]",
        "log",
    )


def _over_frequency(fit: StructureFit) -> Figure:
    measured, predicted = (
        np.array_split(rows, 2) for rows in (fit.measured, fit.predicted)
    )
    h, model = measured[0] + 1j * measured[1], predicted[0] + 1j * predicted[1]
    # The phases are unwrapped separately and may differ by a whole turn, which would
    # look like a misfit.
    sheets = _same_sheet(_turned(h), _turned(model))
    error = 100 * np.abs(h / model - 1)
    panels = [
        Panel(
            label,
            [Curve(fit.place, points, 0, weight="dots"), Curve(fit.place, line, 1)],
        )
        for label, (points, line) in (
            ("gain [dB]", (decibels(h), decibels(model))),
            ("phase [°]", sheets),
        )
    ]
    up = Scale(0.0, 1.05 * float(error.max()))
    panels.append(Panel("error [%]", [Curve(fit.place, error, 1)], 70.0, up))
    return Figure(
        "structure",
        f"The measured response (dots), that of {fit.expression}, and their difference",
        panels,
        "frequency ω [rad/s]",
        "response",
        log=True,
    )


def _turned(response: Complex) -> Real:
    return np.degrees(np.unwrap(np.angle(response)))


def _same_sheet(first: Real, second: Real) -> tuple[Real, Real]:
    """The second phase, shifted by whole turns to the first."""
    # The median, since the unwrapping of a noisy measurement may lose a turn on the
    # way.
    turns = round(np.median(first - second) / 360.0) if first.size == second.size else 0
    return first, second + 360.0 * turns


@figure_of.register
def _comparison(comparison: Comparison) -> Figure:
    return models_figure(comparison.fits, comparison.preferred)


@figure_of.register
def _start(started: Start) -> Figure:
    return fit_figure(started.experiment, started.fit)


def models_figure(fits: Mapping[str, Fit], chosen: str | None = None) -> Figure:
    """Draw the residual of every model over the whole log, on a common scale."""
    some = next(iter(fits.values()))
    time = some.period * np.arange(some.samples)
    edge = float(time[some.fitted_samples - 1])
    # A perfect residual, as of a simulated log without noise, counts as 1, to avoid a
    # division by zero.
    sizes = {
        name: float(np.abs(fit.residual).max()) or 1.0 for name, fit in fits.items()
    }
    # A common scale, since otherwise a poor model would look as good as the others. It is
    # that of the models which passed: one that failed may exceed its panel, and is
    # labelled with its size. A label has to fit the width of a telephone.
    good = [sizes[name] for name, fit in fits.items() if fit.passed]
    common = 1.1 * max(good or [min(sizes.values())])
    panels = []
    for name, fit in fits.items():
        beyond = f", up to {sizes[name]:.2g}" if sizes[name] > common else ""
        remark = " (used)" if name == chosen and len(fits) > 1 else ""
        label = f"{name}{remark}: residual {_SHORT[some.output_kind]}{beyond}"
        marks = _rest(
            time, fit.residual, edge, 1 if name == chosen or len(fits) == 1 else 0
        )
        panels.append(Panel(label, marks, 70.0, Scale(-common, common)))
    return Figure(
        "models",
        "The residual of each model, all on one scale",
        panels,
        "time [s]",
        "log",
    )


@figure_of.register
def detail_figure(fit: Fit) -> Figure:
    """Draw the first part of the measured output with its model."""
    time, measured = fit.period * np.arange(fit.samples), fit.predicted + fit.residual
    # As many samples as dots can show; the whole log would be a band of ink.
    part = slice(0, POINTS)
    marks = [
        Curve(time[part], measured[part], 0, "measured", "wide"),
        Curve(time[part], fit.predicted[part], 1, fit.structure),
    ]
    panel = Panel(OUTPUT_LABEL[fit.output_kind], marks, 210.0)
    return Figure(
        "detail",
        f"The first part of the measured output under {fit.structure}",
        (panel,),
        "time [s]",
        "detail",
    )


# --- can the model be trusted -----------------------------------------------------------------------------


def _independent(count: int) -> float:
    """Return the equivalent number of independent segments for n half-overlapping ones
    with a Hann window: about 95 % of n.
    """
    # Welch (1967): var = (1 + 2 (1 − 1/n) ρ²)/n with ρ² = (1/6)², the squared
    # correlation of half-overlapping Hann windows; segments further apart share no
    # samples.
    return count / (1.0 + 2.0 * (1.0 - 1.0 / count) / 36.0)


def _residual_density(fit: Fit) -> tuple[Real, Real, float, float] | None:
    """Frequency [rad/s], the residual's spectral density relative to that of white
    noise, and its 99 % band.

    A Welch average over n independent segments is χ² with 2 n degrees of freedom; each
    line of white noise lies in the band with 99 % probability. None for a constant
    residual.
    """
    residual = fit.residual[: fit.fitted_samples]
    if not np.ptp(residual) > 0.0:
        return None
    frequency, lines = segments(residual, fit.period)
    # Parseval: the mean of |FFT|² of windowed white noise is its variance times the
    # energy of the window.
    energy = float(np.sum(np.hanning(2 * lines.shape[1]) ** 2))
    power = np.mean(np.abs(lines) ** 2, axis=0)
    share = power / (float(np.var(residual)) * energy)
    freedom = 2 * _independent(len(lines))
    # χ²_k/k is a gamma variable of shape k/2: this gives its quantiles without loading
    # all of scipy.stats.
    low, high = (
        float(gammaincinv(0.5 * freedom, p) / (0.5 * freedom)) for p in (0.005, 0.995)
    )
    # The line at the Nyquist frequency is real, and so has different statistics.
    return frequency[:-1], share[:-1], low, high


def response_figure(log: Experiment, fit: Fit) -> Figure | None:
    """Draw the responses of log and model with the noise's 95 % band; None if fewer
    than two frequencies contain information about the link.
    """
    # Both use the same windows, which affect a sharp resonance in the same way.
    (w, measured, coherence), (_, predicted, _) = (
        averaged_response(log.motor_angle, output, log.period)
        for output in (log.output, fit.predicted)
    )
    count = _independent(len(segments(log.output, log.period)[1]))
    # With n segments, the coherence of noise alone exceeds this in only 1 % of cases:
    # lines below it contain no information about the link.
    good = coherence > 1.0 - 0.01 ** (1.0 / (count - 1.0))
    if np.count_nonzero(good) < 2:
        return None
    w, coherence = w[good], coherence[good]
    measured, predicted = measured[good], predicted[good]
    # The relative error of an averaged response is complex normal with variance (1/γ² −
    # 1)/n: with a probability of 95 % its magnitude is below sqrt(−ln 0.05) times the
    # root of that (Bendat and Piersol).
    error = np.sqrt(-math.log(0.05) * (1.0 / coherence - 1.0) / count)
    # At 0.95 the lower edge is 26 dB below the model; at 1 it would be −∞, off every
    # scale.
    spread = np.minimum(error, 0.95)
    gain, level = decibels(measured), decibels(predicted)
    at, turn = _same_sheet(_turned(predicted), _turned(measured))
    # A disk of relative radius e about the response subtends ± arcsin e as seen from 0.
    arc = np.degrees(np.arcsin(spread))
    halves = Scale(0.0, 105.0, ticks=((0.0, "0"), (50.0, "50"), (100.0, "100")))
    panels = (
        Panel(
            f"gain of {_SHORT[log.output_kind].split(' [')[0]} over θm [dB]",
            [
                Band(w, level + decibels(1 - spread), level + decibels(1 + spread), 2),
                Curve(w, level, 1, "model"),
                Curve(w, gain, 0, "log", "dots"),
            ],
            200.0,
            Scale.around(gain, level),
        ),
        Panel(
            "phase [°]",
            [
                Band(w, at - arc, at + arc, 2),
                Curve(w, at, 1),
                Curve(w, turn, 0, weight="dots"),
            ],
            scale=Scale.around(at, turn),
        ),
        Panel(
            "coherence [%]",
            [Curve(w, 100 * coherence, 1)],
            60.0,
            halves,
        ),
    )
    return Figure(
        "response",
        "Gain and phase of log (dots) and model (line), with the band that contains 95 % of the noise",
        panels,
        "frequency ω [rad/s]",
        "response",
        log=True,
    )


def residual_figure(fit: Fit) -> Figure | None:
    """Draw the residual's spectrum and the band that contains 99 % of white noise of
    the same size.
    """
    density = _residual_density(fit)
    if density is None:
        return None
    frequency, share, low, high = density
    y = Scale(
        min(0.5 * low, 0.8 * float(share.min())),
        max(2 * high, 1.3 * float(share.max())),
        log=True,
    )
    marks: list[Mark] = [
        Band(frequency, np.full(frequency.size, low), np.full(frequency.size, high), 2),
        Curve(frequency, share, 1),
        Across(1.0, "white noise of the same size", limit=False),
    ]
    mode = fit.model.second_mode
    if mode is not None and frequency[0] < mode.frequency < frequency[-1]:
        marks.append(Upright(mode.frequency, "second mode, part of the model"))
    panel = Panel("density of the residual over that of white noise", marks, 180.0, y)
    return Figure(
        "residual",
        "Spectrum of the residual against the band that contains 99 % of white noise",
        (panel,),
        "frequency ω [rad/s]",
        "response",
        log=True,
    )


def fit_panels(log: Experiment, fit: Fit) -> dict[str, tuple[Scale, Panel]]:
    """Horizontal scale and panel of each drawing about a fit, by its plot in the studio.

    A drawing that has nothing to show of this fit is left out.
    """
    drawings = (
        (fit_figure(log, fit), ("angle", "fitted", "rest")),
        (response_figure(log, fit), ("response", "turn", "coherence")),
        (residual_figure(fit), ("spectrum",)),
    )
    return {
        name: (figure.x, panel)
        for figure, names in drawings
        if figure is not None
        for name, panel in zip(names, figure.panels, strict=True)
        if name != "angle"
    }
