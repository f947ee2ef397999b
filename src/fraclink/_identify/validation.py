"""Validation of a fit on logs that it has not seen: its error on each, and a separate
fit to each log.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from fraclink._arm.experiment import Experiment
from fraclink._arm.link import LinkModel
from fraclink._display import (
    Overview,
    Row,
    Table,
    displayed,
    rows_of,
    source_name,
    state_of,
)
from fraclink._identify.compare import identify
from fraclink._identify.fit import Fit
from fraclink._identify.fitting import simulated_torque
from fraclink._identify.problem import CLEARLY_LESS, QUANTILE
from fraclink._identify.shape import moving_angle
from fraclink._identify.welch import averaged_response
from fraclink.errors import FieldError
from fraclink.findings import Finding, Judged, worst_first
from fracsys.checks import Complex, Real, checked_noun
from fracsys.checks.equality import compared


class Value(NamedTuple):
    """A figure of the link with its 95 % interval; nan where the fit has none."""

    value: float
    low: float
    high: float


@compared
@dataclass(frozen=True, eq=False)
class LogValidation:
    """One log and the prediction of a fit that was made without it.

    Parameters
    ----------
    log
        the log.
    predicted
        output that the fit predicts from the motor angle, its offset included, shape
        (N,) [unit of the output].
    nmse
        mean square of (output − predicted − bias) over that of (output − its mean): 0
        is perfect, 1 as bad as an arm at rest.
    bias
        mean of output − predicted: the gauge has drifted by that much [unit].
    frequencies
        where the log has motion, shape (K,) [rad/s].
    ratio
        measured over predicted output at each of them, complex, shape (K,): its modulus
        is the gain and its angle the phase [rad] that the model misses.
    share
        of the measured power at each frequency that the prediction leaves, shape (K,).
    fit
        the same structure fitted to this log alone.
    """

    log: Experiment
    predicted: Real
    nmse: float
    bias: float
    frequencies: Real
    ratio: Complex
    share: Real
    fit: Fit

    @property
    def worst_at(self) -> float:
        """Where the prediction leaves the largest share of the power [rad/s]."""
        return float(self.frequencies[self.share.argmax()])


# Figures of the link and their display units.
_UNITS = {
    "resonance": "rad/s",
    "order": "",
    "damping": "",
    "damping_order": "",
    "delay": "ms",
    "gain": "",
}


@displayed
@compared
@dataclass(frozen=True, eq=False, repr=False)
class Validation(Judged):
    """A fit compared with logs that it has not seen.

    Parameters
    ----------
    fit
        the fit.
    logs
        one `LogValidation` for each.
    findings
        W318 (error) where it does not predict a log, W362 (warning) where its intervals
        and those of a log's own fit do not overlap.

    Examples
    --------
    >>> import fraclink as fl
    >>> fit = fl.identify(fl.read_log(fl.bundled_log("prbs_30g")))
    >>> found = fit.validate(fl.read_log(fl.bundled_log("pulse_30g")))
    >>> found.passed, round(found.nmse, 3)
    (True, 0.013)
    """

    fit: Fit
    logs: tuple[LogValidation, ...]
    findings: tuple[Finding, ...]

    __made_by__ = "fit.validate(log)"

    @property
    def nmse(self) -> float:
        """The worst error of all logs [1]."""
        return max(each.nmse for each in self.logs)

    @property
    def models(self) -> tuple[LinkModel, ...]:
        """The link as each log alone shows it, for `others` of `ParameterBox.of`."""
        return tuple(each.fit.model for each in self.logs)

    @property
    def spread(self) -> Mapping[str, tuple[float, float]]:
        """Least and largest value of each figure over the fit and all logs."""
        rows = [self.figures, *map(self.figures_of, self.logs)]
        return {
            name: (
                min(row[name].value for row in rows),
                max(row[name].value for row in rows),
            )
            for name in self.figures
        }

    @property
    def figures(self) -> Mapping[str, Value]:
        """Resonance [rad/s], order, damping, delay [s] and gain of the fit."""
        return _figures(self.fit, self.fit.model)

    def figures_of(self, each: LogValidation) -> Mapping[str, Value]:
        """The same for a log's own fit, at the payload of this fit where both are known."""
        return _figures(each.fit, _at_payload(each.fit.model, self.fit.model.payload))

    @property
    def verdict(self) -> str:
        """The result in one sentence."""
        error = f"error {100 * self.nmse:.3g} % (NMSE)"
        if not self.passed:
            return f"the model does not predict the other log: {error}"
        which = (
            "the other log" if len(self.logs) == 1 else f"{len(self.logs)} other logs"
        )
        apart = any(finding.code == "W362" for finding in self.findings)
        rest = ", but they differ by more than their intervals allow" if apart else ""
        return f"the model predicts {which}: {error}{rest}"

    def overview(self) -> Overview:
        """The error on each log, and the link that each shows by itself."""
        names = [source_name(each.log.source) for each in self.logs]
        errors = (
            rows_of(
                each,
                Row("source", "log", name),
                Row("payload", "payload", each.log.payload, "g"),
                ("nmse", "error (NMSE)", "%", 3),
                ("bias", "bias", "", 3),
                Row("worst", "worst at", each.worst_at, "rad/s", digits=3),
                "fit",
            )
            for name, each in zip(names, self.logs, strict=True)
        )
        columns = (self.figures, *map(self.figures_of, self.logs))
        intervals = (
            (
                Row("name", "95 % interval", name.replace("_", " ")),
                *(
                    Row(
                        f"values.{title}",
                        title,
                        column[name].value,
                        unit,
                        0.5 * (column[name].high - column[name].low),
                    )
                    for title, column in zip(
                        ("the model", *names), columns, strict=True
                    )
                ),
            )
            for name, unit in _UNITS.items()
            if name in self.figures
        )
        rows = rows_of(self, "nmse", "spread", "verdict")
        return Overview(
            self.verdict,
            state_of(self.passed),
            rows,
            (Table.of("logs", errors), Table.of("figures", intervals)),
            self.findings,
        )


def _at_payload(model: LinkModel, payload: float | None) -> LinkModel:
    if payload is None or model.payload is None:
        return model
    return model.at_payload(payload)


def _figures(fit: Fit, model: LinkModel) -> dict[str, Value]:
    """The figures of a fit that should be equal in another log of the same arm."""

    def interval(field: str, value: float) -> Value:
        low, high = model.interval(field) or (math.nan, math.nan)
        return Value(value, low, high)

    # ω₀ is in s^(−λ/2), a unit that depends on λ: two logs share the resonance. Its
    # interval is narrower than that of ω₀, which is correlated with λ.
    frequency = interval("natural_frequency", model.natural_frequency)
    ends = (
        abs(replace(model, natural_frequency=end, intervals=()).pole)
        if end > 0.0
        else math.nan
        for end in frequency
    )
    gain = QUANTILE * fit.standard_errors.get("gain", math.nan)
    figures = {"resonance": Value(*ends)}
    for name in ("order", "damping", "damping_order"):
        if name in fit.standard_errors:
            figures[name] = interval(name, getattr(model, name))
    figures["delay"] = interval("gauge_delay", fit.delay)
    figures["gain"] = Value(fit.gain, fit.gain - gain, fit.gain + gain)
    return figures


def _validated(fit: Fit, log: Experiment) -> LogValidation:
    if log.output_kind != fit.output_kind:
        raise FieldError(
            "output_kind",
            log.output_kind,
            "not what the fit predicts",
            fit.output_kind,
            "state the same output in both [log] tables, or fit that log by itself",
        )
    link = replace(_at_payload(fit.model, log.payload), stiffness=1.0)
    angle = moving_angle(log)
    swing = simulated_torque(link, angle, log.period, delay=fit.delay)
    predicted = fit.gain * swing[-log.output.size :] + fit.offset
    bias = float(np.mean(log.output - predicted))
    residual = log.output - predicted - bias
    power = float(np.var(log.output))
    frequencies, ratio, coherence = averaged_response(predicted, log.output, log.period)
    return LogValidation(
        log=log,
        predicted=predicted,
        nmse=float(np.mean(residual**2)) / power if power > 0.0 else math.inf,
        bias=bias,
        frequencies=frequencies,
        ratio=ratio,
        # P_rr/P_yy of the residual r = y − ŷ, with |H|² P_ŷŷ = γ² P_yy.
        share=1.0 + coherence * (1.0 - 2.0 * ratio.real) / np.abs(ratio) ** 2,
        fit=identify(log, fit.structure),
    )


def validate(fit: Fit, logs: Sequence[Experiment]) -> Validation:
    """Compare a fit with other logs of the same arm; see `Fit.validate`."""
    if not logs:
        raise FieldError(
            "logs",
            0,
            "none given",
            "at least one",
            "give a log that the fit was not made from",
        )
    validation = Validation(
        fit,
        tuple(_validated(fit, checked_noun("logs", log, Experiment)) for log in logs),
        (),
    )
    findings = (
        finding for each in validation.logs for finding in _findings(validation, each)
    )
    return replace(validation, findings=worst_first(findings))


Fit._validated = validate


def _findings(found: Validation, each: LogValidation) -> Iterator[Finding]:
    name = each.log.source or "the log"
    if not each.nmse <= CLEARLY_LESS:
        yield Finding(
            "W318",
            "error",
            f"the model does not predict {name}",
            {"nmse": each.nmse, "most": CLEARLY_LESS},
            "check that both logs are of one arm, with one payload and the same wiring; or fit this log by itself",
        )
    own = found.figures_of(each)
    apart = [
        key
        for key, value in found.figures.items()
        # Both intervals are known and disjoint.
        if key in own and (value.high < own[key].low or own[key].high < value.low)
    ]
    if apart:
        evidence = {key: found.figures[key].value for key in apart} | {
            f"{key}_here": own[key].value for key in apart
        }
        yield Finding(
            "W362",
            "warning",
            f"{name} shows another {', '.join(apart).replace('_', ' ')}: the 95 % intervals do not overlap",
            evidence,
            "give the models of both logs to the design: ParameterBox.of(model, rig, others=validation.models)",
        )
