"""Findings W2xx and W3xx about a fit, and the gates that a model must pass to be used.

A gate is a finding of severity "error" with its threshold in the evidence. After a
failed gate the model is kept with all its numbers, but no result based on it can pass.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

from fraclink._arm.experiment import Experiment
from fraclink._identify.columns import column_findings, motion_at_start
from fraclink._identify.fit import Fit
from fraclink._identify.problem import (
    CERTAIN,
    CLEARLY_LESS,
    LEVEL,
    ORDER_MOST,
    QUANTILE,
)
from fraclink._identify.search import Solution
from fraclink._identify.shape import ORDER_LIMITS
from fraclink.findings import Finding, worst_first

# The calibration of a strain gauge is accurate to about 20 %; mrad for rad or volts for
# radians differ by more.
GAIN_RANGE = (2 / 3, 3 / 2)
# Largest relative standard error of the resonance; a link that vibrates visibly has
# 0.01 % to 1 %.
RESONANCE_MOST = 0.1
# Vibration periods at the beginning of a log that are compared with the rest, and the
# largest ratio of their error to that of the rest.
_START, _FIRST_ERROR = 2.0, 2.0

_AT_BOUND = {
    "order": "at λ = 2 the link is classical: use a structure of integer order",
    "damping": "the log shows no damping of this kind: use an undamped structure",
    "natural_frequency": "at ω₀ = 0 it is the undamped link with λ = 2 − α: use that structure",
    "damping_order": "the log does not determine α: use a structure without it",
    "delay": "the delay is larger than a third of a period, or the channels do not belong together",
}


def findings_of(
    fit: Fit,
    solution: Solution,
    sure: tuple[float, bool],
    stiffness: float | None,
    motion: tuple[float, float],
    log: Experiment,
) -> tuple[Finding, ...]:
    """All findings of a fit, worst first.

    `sure` are the resonance's relative standard error and whether the log leaves
    parameters undetermined, `motion` the held-out shares of motion and vibration.
    """
    # The signal that pure noise reaches with the chance LEVEL: fitting gain and phase
    # at one frequency adds χ² of two degrees, which exceeds x with the chance e^(−x/2),
    # and a fit chooses the best of the n/2 frequencies of a log.
    signal, least = _signal_of(fit), 2 * math.log(fit.fitted_samples / 2 / LEVEL)
    # Sign and delay of noise mean nothing.
    audible = signal >= least
    findings = [
        *column_findings(log),
        *(
            _of_the_vibration(fit, solution, sure[0])
            if audible
            else (
                Finding(
                    "W313",
                    "error",
                    "no signal: this model predicts the output hardly better than a constant does",
                    {
                        "signal": signal,
                        "least": least,
                        "motor_range": float(np.ptp(log.motor_angle)),
                    },
                    "check that the gauge is connected and shielded from mains hum, that the motor turns, and that "
                    "both channels are of one recording; or move further",
                ),
            )
        ),
        *_of_the_start(fit, log),
        *_of_the_prediction(fit, motion),
        *_of_the_optimum(fit, sure[1]),
        *_of_other_valleys(fit, solution),
        *_of_the_gain(fit, stiffness, audible),
        *(_of_the_delay(fit, solution) if audible else ()),
        *_of_the_residual(fit),
    ]
    return worst_first(findings)


def _signal_of(fit: Fit) -> float:
    """Twice the gain in log-likelihood of the model over an arm at rest, with the
    colour accounted for.
    """
    output = (fit.predicted + fit.residual)[: fit.fitted_samples]
    return likelihood_ratio(
        float(np.var(output)), fit.mse, fit.fitted_samples, _inflation(fit)
    )


def _inflation(fit: Fit) -> float:
    """The factor by which the residual's colour makes samples count less: under slow
    noise a thousand are worth a hundred independent ones, and chance has more effect.
    """
    return max(fit.effective_parameters / max(len(fit.standard_errors), 1), 1.0)


def likelihood_ratio(
    cost: float, least: float, samples: int, inflation: float
) -> float:
    """n ln(cost/least)/k: for Gaussian noise twice the difference in log-likelihood."""
    return samples * math.log(max(cost / max(least, 1e-300), 1.0)) / inflation


def _of_the_vibration(
    fit: Fit, solution: Solution, resonance: float
) -> Iterator[Finding]:
    # λ at its upper limit is a classical link; at the lower one nothing vibrates.
    if 1 in solution.at_bound or (
        0 in solution.at_bound and fit.model.order < sum(ORDER_LIMITS) / 2
    ):
        yield Finding(
            "W314",
            "error",
            "no vibration found: the fit ended at a limit of the frequencies or orders that the log can show",
            {"resonance": math.exp(solution.shape[1]), "order": fit.model.order},
            "check units and columns, and that the log holds two periods of the link's vibration",
        )
    elif resonance > RESONANCE_MOST:
        yield Finding(
            "W315",
            "error",
            "the motor does not excite the band of the vibration: its frequency is not determined",
            {
                "resonance": math.exp(solution.shape[1]),
                "relative_error": resonance,
                "most": RESONANCE_MOST,
            },
            "move faster, with rise times below half a period of the vibration",
        )


def _of_the_start(fit: Fit, log: Experiment) -> Iterator[Finding]:
    """W231: a vibration from before the first sample, which the model does not include.

    A fit takes such a vibration for delay and damping. A log that begins in motion and
    is fitted well from its first sample had little of it.
    """
    output = log.output - fit.offset
    _, begins = motion_at_start(log.motor_angle, output, float(output.std()))
    length = round(_START * 2 * math.pi / (abs(fit.model.pole) * fit.period))
    if begins is None or 2 * length > fit.fitted_samples:
        return
    error = fit.residual[: fit.fitted_samples] ** 2
    first, rest = float(error[:length].mean()), float(error[length:].mean())
    if first > _FIRST_ERROR * rest:
        yield Finding(
            "W231",
            "warning",
            f"the log begins in motion ({begins}), and the model is off most there: in the first "
            f"{length * fit.period:.2g} s its mean square error is {first / rest:.2g} times that of the rest",
            {
                "first_mse": first,
                "other_mse": rest,
                "time": length * fit.period,
                "most": _FIRST_ERROR,
            },
            "begin the log, or the stretch that is kept (keep=, --keep), where the arm is at rest",
        )


def _of_the_prediction(fit: Fit, motion: tuple[float, float]) -> Iterator[Finding]:
    heldout, relative = fit.heldout_mse, fit.heldout_nmse
    if fit.fitted_samples == fit.samples:
        return
    if heldout is None or relative is None or max(motion) < 0.01:
        yield Finding(
            "W317",
            "error",
            "the held-out part contains no motion, so nothing shows whether the model predicts",
            {"motion": motion[0], "vibration": motion[1]},
            "leave heldout out, or hold out a part in which the motor moves",
        )
    elif relative > CLEARLY_LESS:
        yield Finding(
            "W318",
            "error",
            "the model does not predict the part of the log that was held out",
            {"heldout_nmse": relative, "most": CLEARLY_LESS, "nmse": fit.nmse},
            "look for a payload that slipped, a gauge that drifts, a cable that came off, a blow, a wrong "
            "channel or saturation",
        )
    # Both conditions: at a quiet end the relative error is large merely because the
    # power is small, at a loud end the mean square merely because it is large.
    elif CLEARLY_LESS * relative > fit.nmse and heldout > 2 * fit.mse:
        yield Finding(
            "W318",
            "warning",
            "the part of the log that was held out is predicted much worse than the part that was fitted",
            {"nmse": fit.nmse, "heldout_nmse": relative},
            "look for a change of the arm within the log, or fit a longer part",
        )
    # By default 60 % are fitted: less than half means that the border was moved to
    # where the motion is.
    if fit.fitted_samples < fit.samples // 2:
        yield Finding(
            "W317",
            "info",
            "less than half of the log is fitted: the held-out part begins where the arm still moves, or as chosen",
            {
                "fitted_time": fit.fitted_samples * fit.period,
                "motion": motion[0],
                "vibration": motion[1],
            },
            "record motion until the end, or choose heldout",
        )


def _of_the_optimum(fit: Fit, singular: bool) -> Iterator[Finding]:
    for name in fit.at_bound:
        value = fit.delay if name == "delay" else getattr(fit.model, name)
        # A rough angle cannot show a negative delay, and a held one no delay between
        # its samples.
        if name != "delay" or (value != 0 and fit.hold != "zero"):
            yield Finding(
                "W301",
                "warning",
                f"{name} ended at the bound of its range and has no standard error",
                {name: value},
                _AT_BOUND.get(name, "look at the log"),
            )
    if not fit.converged:
        yield Finding(
            "W302",
            "warning",
            "the optimiser did not converge; the values are the best ones found",
            {},
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
        interval.low_open
        or interval.high_open
        or interval.high - interval.low > 2 * ORDER_MOST
    ):
        yield Finding(
            "W308",
            "warning",
            "α is not identifiable: the log hardly distinguishes its values",
            {"alpha_low": interval.low, "alpha_high": interval.high},
            "read α with its interval, or use a structure without it",
        )


def _of_the_gain(fit: Fit, stiffness: float | None, audible: bool) -> Iterator[Finding]:
    # For a torque the gain is a stiffness, which may have any value.
    if fit.output_kind != "deflection":
        return
    if stiffness is None:
        # Also for noise: `Fit.loop_model` takes the stiffness of the rig if this
        # finding says that the log does not determine it.
        yield Finding(
            "W304",
            "warning",
            "a deflection log cannot show the stiffness; the model carries 1 N·m/rad",
            {},
            "give stiffness=, or let `design` take the rig's",
        )
    if audible and not GAIN_RANGE[0] < abs(fit.gain) < GAIN_RANGE[1]:
        yield Finding(
            "W320",
            "error",
            "the output is not a deflection in rad: a deflection log has a gain of 1",
            {"gain": fit.gain, "least": GAIN_RANGE[0], "most": GAIN_RANGE[1]},
            "check the unit and scale of the channel in the rig file",
        )


def _of_the_delay(fit: Fit, solution: Solution) -> Iterator[Finding]:
    yield from _of_the_sign(fit, math.tau / math.exp(solution.shape[1]))
    error = fit.standard_errors.get("delay")
    if error is None or error == 0:
        return
    # One sample: a logger that stamps the sample before it reads the gauge causes this
    # delay, which no loop contains.
    if fit.delay > max(CERTAIN * error, fit.period):
        yield Finding(
            "W306",
            "info",
            "the output is behind the motor angle: a sensor delay was fitted, too",
            {"delay": fit.delay, "standard_error": error},
            "check the filter of the strain amplifier; a design must include this delay",
        )
    if fit.delay < -max(CERTAIN * error, fit.period):
        yield Finding(
            "W309",
            "warning",
            "the motor angle is behind the output",
            {"delay": fit.delay, "standard_error": error},
            "check the filter of the encoder or which channel is sampled first",
        )


def _of_the_sign(fit: Fit, cycle: float) -> Iterator[Finding]:
    """Sign and delay together: half a `cycle` more delay reverses a vibration's sign."""
    # Beyond an eighth of a cycle, a phase of half a turn may be delay and sign as well
    # as sign alone.
    late = abs(fit.delay) > cycle / 8
    if fit.gain < 0 and not late:
        yield Finding(
            "W211",
            "error",
            "the output has the opposite sign: it is negative where the tip lags a motor that turns forward",
            {"gain": fit.gain},
            "state the sign of the channel in the rig file",
        )
    elif fit.gain < 0:
        yield Finding(
            "W316",
            "error",
            f"the output is {1e3 * fit.delay:.3g} ms late with the opposite sign, or about "
            f"{1e3 * (fit.delay + cycle / 2):.3g} ms late with the right one, half a vibration more",
            {"delay": fit.delay, "vibration_period": cycle, "gain": fit.gain},
            "check that both channels are of one recording and on one clock, then the sign",
        )
    elif "delay" in fit.at_bound and fit.delay != 0 and fit.hold != "zero":
        yield Finding(
            "W316",
            "error",
            "the delay ended at its limit, a third of the vibration's period",
            {"delay": fit.delay, "vibration_period": cycle},
            "check that both channels are of one recording and on one clock",
        )


def _of_the_residual(fit: Fit) -> Iterator[Finding]:
    yield from _of_outliers(fit)
    if fit.tests is None or not math.isfinite(fit.tests.whiteness):
        return
    if fit.tests.whiteness < LEVEL:
        yield Finding(
            "W305",
            "info",
            "the residual is not white; standard errors and intervals account for its colour",
            {"p_value": fit.tests.whiteness},
            "nothing, or look at the residual for a second mode or friction",
        )
    # Not at a level of 5 %: every real arm has friction, and every log would be reported.
    if fit.tests.input_independence < LEVEL:
        yield Finding(
            "W310",
            "info",
            "the residual still depends on the motor's motion: the structure misses part of the link",
            {"p_value": fit.tests.input_independence},
            "see the spectrum of the residual in the report: a peak is a further mode, a rise to the "
            "left friction",
        )
    mode = fit.model.second_mode
    if mode is not None:
        yield Finding(
            "W321",
            "info",
            "the log shows a second mode: it is part of the model, and a design must bound its loop gain",
            {
                "frequency": mode.frequency,
                "gain": mode.gain,
                "damping_ratio": mode.damping_ratio,
            },
            "nothing; the design takes it into account",
        )


def _of_outliers(fit: Fit) -> Iterator[Finding]:
    squares = fit.residual[: fit.fitted_samples] ** 2
    few, whole = max(fit.fitted_samples // 500, 1), float(squares.sum())
    # For Gaussian noise the largest 0.2 % of the samples contain 2 % of the sum of
    # squares.
    most = 0.3 * whole
    # Selecting them takes longer than all other findings of the residual.
    if few * float(squares.max()) <= most:
        return
    largest = float(np.partition(squares, -few)[-few:].sum())
    if largest > most:
        yield Finding(
            "W224",
            "warning",
            "a few samples cause most of the error: outliers distort the fit",
            {"samples": float(few), "share_of_error": largest / whole},
            "examine the log with diagnose and cut or repair these rows",
        )


def _of_other_valleys(fit: Fit, solution: Solution) -> Iterator[Finding]:
    for rival in solution.rivals:
        ratio = likelihood_ratio(
            rival.cost, solution.cost, fit.fitted_samples, _inflation(fit)
        )
        if ratio < QUANTILE**2:
            yield rival_finding({"resonance": rival.resonance})
            return


def rival_finding(values: Mapping[str, float]) -> Finding:
    return Finding(
        "W357",
        "error",
        "other parameters fit as well as the data can tell",
        values,
        "record a log that excites more of the band; the bounds of a formula can exclude them, too",
    )
