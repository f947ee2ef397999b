"""What a reader of a fit should be told: findings W3xx."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from fraclink._identify.fit import Fit
from fraclink.findings import Finding

__all__ = ["findings_of"]

_AT_BOUND = {
    "order": "at λ = 2 the link is classical: use UD-IOM or D-IOM",
    "damping": "the log shows no damping of this kind: use UD-IOM",
    "natural_frequency": "at ω₀ = 0 D-FOM is UD-FOM with λ = 2 − α: use UD-FOM",
    "damping_order": "the log does not determine α: use UD-FOM or D-IOM",
    "delay": "the delay is larger than a third of a period, or the channels do not belong together",
}


def findings_of(fit: Fit, singular: bool, stiffness: float | None) -> tuple[Finding, ...]:
    """All findings of a fit, worst first."""
    order = {"error": 0, "warning": 1, "info": 2}
    found = [*_of_the_optimum(fit, singular), *_of_the_sensor(fit, stiffness), *_of_the_residual(fit)]
    return tuple(sorted(found, key=lambda finding: order[finding.severity]))


def _of_the_optimum(fit: Fit, singular: bool) -> Iterator[Finding]:
    values = {"order": fit.model.order, "damping_order": fit.model.damping_order, "delay": fit.delay}
    for name in fit.at_bound:
        if name == "delay" and (fit.delay == 0 or fit.hold == "zero"):
            continue  # a rough angle cannot show a negative one, a held one none between its samples
        evidence = {name: values.get(name, getattr(fit.model, name, 0.0))}
        yield Finding(
            "W301",
            "warning",
            f"{name} ended at the bound of its range and has no standard error",
            evidence,
            _AT_BOUND.get(name, "look at the log"),
        )
    if not fit.converged:
        yield Finding(
            "W302",
            "warning",
            "the optimiser did not converge; the values are the best that were met",
            {"passes": float(fit.evaluations)},
            "identify a simpler structure or a longer log",
        )
    if singular:
        yield Finding(
            "W303",
            "warning",
            "the log does not determine all parameters: the normal matrix is singular",
            {},
            "use a structure with fewer parameters, or excite the link more",
        )
    interval = fit.intervals.get("damping_order")
    if interval is not None and (
        interval.low_open or interval.high_open or interval.high - interval.low > 0.5
    ):
        yield Finding(
            "W308",
            "warning",
            "α is not identifiable: the log hardly tells its values apart",
            {"alpha_low": interval.low, "alpha_high": interval.high},
            "read α with its interval, or use UD-FOM or D-IOM",
        )


def _of_the_sensor(fit: Fit, stiffness: float | None) -> Iterator[Finding]:
    if fit.output_kind == "deflection" and stiffness is None:
        yield Finding(
            "W304",
            "warning",
            "a deflection log cannot show the stiffness; the model carries 1 N·m/rad",
            {},
            "give stiffness=",
        )
    if fit.gain < 0:
        yield Finding(
            "W307",
            "warning",
            "the output has the opposite sign: it is negative where the tip lags a motor that turns forward",
            {"gain": fit.gain},
            "state the sign of the channel in the rig file",
        )
    error = fit.standard_errors.get("delay")
    if error is None or error == 0:
        return
    if fit.delay > max(4 * error, fit.period):
        yield Finding(
            "W306",
            "info",
            "the output is behind the motor angle: a sensor delay was fitted along",
            {"delay": fit.delay, "standard_error": error},
            "check the filter of the strain amplifier; a design must count this delay",
        )
    if fit.delay < -max(4 * error, fit.period):
        yield Finding(
            "W309",
            "warning",
            "the motor angle is behind the output",
            {"delay": fit.delay, "standard_error": error},
            "check the filter of the encoder or which channel is sampled first",
        )


def _of_the_residual(fit: Fit) -> Iterator[Finding]:
    held, relative = fit.heldout_mse, fit.heldout_nmse
    if held is not None and relative is not None and relative > 4 * fit.nmse and held > 2 * fit.mse:
        yield Finding(
            "W311",
            "warning",
            "the part of the log that was held out is predicted much worse than the part that was fitted",
            {"nmse": fit.nmse, "heldout_nmse": relative},
            "look for a change of the arm within the log, or fit a longer part",
        )
    yield from _of_outliers(fit)
    if fit.tests is None or not math.isfinite(fit.tests.whiteness):
        return
    if fit.errors_allow_colour:
        yield Finding(
            "W305",
            "info",
            "the residual is not white; standard errors and intervals allow for its colour",
            {"p_value": fit.tests.whiteness, "correlation_time": fit.tests.correlation_time},
            "nothing, or look at the residual for a second mode or friction",
        )
    if fit.tests.input_independence < 1e-3:
        yield Finding(
            "W310",
            "info",
            "the residual still depends on the motor's motion: the structure misses part of the link",
            {"p_value": fit.tests.input_independence},
            "compare the other structures",
        )


def _of_outliers(fit: Fit) -> Iterator[Finding]:
    squares = np.sort(fit.residual[: fit.fitted_samples] ** 2)[::-1]
    few = max(fit.fitted_samples // 500, 1)
    share = float(squares[:few].sum() / squares.sum()) if squares[0] > 0 else 0.0
    # Of Gaussian noise the largest 0.2 % of the samples hold 2 % of the squares.
    if share > 0.3:
        yield Finding(
            "W312",
            "warning",
            "a few samples make most of the error: outliers pull the fit",
            {"samples": float(few), "share_of_error": share},
            "examine the log with diagnose and cut or repair these rows",
        )
