"""Identify one structure from one log."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.experiment import Experiment
from fraclink._arm.link import LinkModel
from fraclink._arm.link import structure as structure_row
from fraclink._identify.errors_of_fit import Uncertainty, uncertainty
from fraclink._identify.fit import Fit
from fraclink._identify.notes import findings_of
from fraclink._identify.problem import Hold, Window, chosen_hold, columns_of
from fraclink._identify.profile import Interval, profile_interval
from fraclink._identify.search import Search
from fraclink._identify.shape import ALPHA_LIMITS, ORDER_LIMITS, model_of, shape_of
from fraclink._identify.solution import Solution
from fraclink._identify.statistics import ResidualTests, aic, bic, residual_tests
from fraclink._validate import checked_between, checked_choice, checked_noun, checked_series
from fraclink.errors import FieldError, LogError

__all__ = ["identify"]

_FIXABLE: dict[str, tuple[float, float]] = {
    "gain": (-1e12, 1e12),
    "offset": (-1e12, 1e12),
    "delay": (-1.0, 10.0),
    "order": ORDER_LIMITS,
    "damping_order": ALPHA_LIMITS,
}
_LEAST_SAMPLES = 50
_COLOURED = 0.01  # p-value below which the residual is taken for coloured


def identify(
    log: Experiment,
    structure: str = "UD-FOM",
    *,
    heldout: float = 0.4,
    stiffness: float | None = None,
    fixed: Mapping[str, float] | None = None,
    guess: LinkModel | None = None,
    hold: Hold = "auto",
    details: bool = True,
) -> Fit:
    """Fit a link structure to a log; gain, offset and sensor delay are fitted along, no guess is asked.

        minimise Σ (output − gain·y(t − delay) − offset)²,    Y = s^λ/(s^λ + μ s^α + ω₀²) Θm

    Arguments:
        log: the recorded motion, at rest before its first sample.
        structure: "UD-IOM", "D-IOM", "UD-FOM" or "D-FOM".
        heldout: share of the samples at the end that the fit does not see, 0 to 0.9 [1].
        stiffness: c [N·m/rad] where it is known: a torque log's gain is fixed to it; a deflection log,
            which cannot show it, gets it as the model's stiffness.
        fixed: values of "gain", "offset", "delay" [s], "order", "damping_order" that are not to be fitted.
        guess: a start to try beside the scan over all frequencies of the log.
        hold: what the motor angle does between samples: "first" (a measured motion), "zero" (a held
            command) or "auto" (zero only for angles that jump and rest).
        details: False leaves out intervals, tests and the allowance for coloured residuals (ten times
            faster, for loops over thousands of logs).

    Raises LogError for a log without motion or too short, FieldError for an option out of its range,
    NotConvergedError where no start has a fit. Source: the paper, Algorithm 1 and section 3.3.

    >>> import numpy as np
    >>> from fraclink._arm.experiment import Experiment
    >>> time = 0.004 * np.arange(3000)
    >>> angle = np.clip((time - 0.5) / 0.3, 0, 1)
    >>> swing = LinkModel(1.56, 10.02, order=1.92)
    >>> log = Experiment(period=0.004, motor_angle=angle, output=simulated_torque(swing, angle, 0.004))
    >>> fit = identify(log, "UD-FOM")
    >>> round(fit.model.order, 6), round(fit.model.natural_frequency, 5), round(fit.gain, 6)
    (1.92, 10.02, 1.56)
    """
    structure_row(structure)
    search = make_search(log, heldout=heldout, stiffness=stiffness, fixed=fixed, guess=guess, hold=hold)
    return fit_from(search, structure, log, stiffness=stiffness, details=details)


def simulated_torque(
    model: LinkModel,
    motor_angle: NDArray[np.float64],
    period: float,
    *,
    delay: float = 0.0,
    hold: Hold = "auto",
) -> NDArray[np.float64]:
    """Torque [N·m] of a link, at rest at first, whose motor angle [rad] is linear or held between samples.

    It is what `identify` compares a log with; the independent way is `fraclink.time_response`.
    """
    link = checked_noun("model", model, LinkModel, remedy="fit.model, or LinkModel(...)")
    angle = checked_series("motor_angle", motor_angle)
    step = checked_between("period", period, 1e-6, 1e6, "s")
    late = checked_between("delay", delay, *_FIXABLE["delay"], "s")
    if angle.size < 2 or not np.all(np.isfinite(angle)):
        raise FieldError(
            "motor_angle",
            f"{angle.size} samples",
            "too short or not finite",
            allowed=">= 2 finite samples",
            remedy="cut or repair it",
        )
    window = Window(angle, np.zeros_like(angle), step, chosen_hold(angle, hold))
    kernel = window.kernel(abs(link.pole), longest_delay=abs(late))
    return np.asarray(link.stiffness * columns_of(kernel, shape_of(link, late))[0])


def make_search(
    log: Experiment,
    *,
    heldout: float,
    stiffness: float | None,
    fixed: Mapping[str, float] | None,
    guess: LinkModel | None,
    hold: Hold,
) -> Search:
    """Check the options and cut the fitted part of the log."""
    checked_noun("log", log, Experiment, remedy="read the file with read_log first")
    share = checked_between("heldout", heldout, 0.0, 0.9, remedy="give 0.4, or 0 for none")
    values = {} if fixed is None else _checked(fixed)
    if stiffness is not None:
        known = checked_between(
            "stiffness", stiffness, 0.0, 1e9, "N·m/rad", open_low=True, remedy="give c or leave it out"
        )
        if log.output_kind == "torque":
            values.setdefault("gain", known)
    count = log.output.size - round(share * log.output.size)
    chosen = chosen_hold(log.motor_angle, hold)
    _check_motion(log, count)
    window = Window(log.motor_angle[:count], log.output[:count], log.period, chosen)
    start = None
    if guess is not None:
        checked_noun("guess", guess, LinkModel, remedy="give a LinkModel, or leave it out: none is needed")
        start = shape_of(guess, values.get("delay", 0.0))
        start[0] = np.clip(start[0], *ORDER_LIMITS)
    return Search(window, values, start)


def _checked(fixed: object) -> dict[str, float]:
    if not isinstance(fixed, Mapping):
        raise FieldError(
            "fixed",
            fixed,
            "no mapping",
            allowed="names to values",
            remedy='give values by name, such as {"delay": 0.0}',
        )
    return {
        checked_choice("fixed", name, _FIXABLE): checked_between(
            f"fixed {name}", value, *_FIXABLE[name], remedy="give another value"
        )
        for name, value in fixed.items()
    }


def _check_motion(log: Experiment, count: int) -> None:
    if count < _LEAST_SAMPLES:
        raise LogError(
            "output",
            count,
            "too few samples to fit",
            allowed=f">= {_LEAST_SAMPLES}",
            remedy="record a longer log",
        )
    for name, values in (("motor_angle", log.motor_angle), ("output", log.output)):
        if np.ptp(values[:count]) == 0:
            raise LogError(
                name,
                float(values[0]),
                "constant over the fitted part",
                allowed="a motion",
                remedy="check the wiring, or fit a part in which the arm moves",
            )


def fit_from(search: Search, name: str, log: Experiment, *, stiffness: float | None, details: bool) -> Fit:
    """The fit of one structure from a search, judged on the whole log."""
    solution = search.solve(name)
    window = search.window
    whole = Window(log.motor_angle, log.output, log.period, window.hold)
    kernel = whole.kernel(search.lowest, longest_delay=search.longest_delay)
    raw = columns_of(kernel, solution.shape)
    predicted = solution.gain * raw[0] + solution.offset
    residual = log.output - predicted
    errors = uncertainty(search, solution, search.kernel, coloured=details)
    tests, intervals = None, {}
    allow = False
    if details:
        tests = _tests(search, residual[: window.samples], errors)
        allow = tests.whiteness < _COLOURED and errors.coloured is not None
        intervals = _intervals(search, solution, errors, allow)
    return _assembled(search, solution, log, stiffness, predicted, residual, errors, tests, intervals, allow)


def _variances(errors: Uncertainty, allow: bool) -> NDArray[np.float64]:
    white = np.diag(errors.white)
    # Colour may also narrow an estimate, but the sandwich is too noisy to be believed there.
    return np.maximum(np.diag(errors.coloured), white) if allow and errors.coloured is not None else white


def _tests(search: Search, residual: NDArray[np.float64], errors: Uncertainty) -> ResidualTests:
    ratio = 1.0
    if errors.coloured is not None and errors.names:
        pairs = zip(np.diag(errors.coloured).tolist(), np.diag(errors.white).tolist(), strict=True)
        ratio = min(max((c / w for c, w in pairs if w > 0), default=1.0), 1e12)
    motion = search.window.increments()
    return residual_tests(residual, motion, search.window.period, errors.lag, ratio)


def _intervals(search: Search, solution: Solution, errors: Uncertainty, allow: bool) -> dict[str, Interval]:
    variances, white = _variances(errors, allow), np.diag(errors.white)
    result = {}
    for i, name in enumerate(errors.names):
        if name in ("gain", "offset"):
            continue
        inflation = min(float(variances[i]) / float(white[i]), 1e12) if white[i] > 0 else 1.0
        error = math.sqrt(max(white[i], 0.0) * inflation)
        result[name] = profile_interval(search, solution, search.kernel, name, error, inflation)
    if 3 in solution.free and "damping_order" not in result:  # at a limit: one-sided, but never left out
        result["damping_order"] = profile_interval(search, solution, search.kernel, "damping_order", 0.2, 1.0)
    if solution.on_edge:
        # ω₀ = 0 is where the interval begins; its width is set by how fast α may leave the edge.
        reach = 0.05 * math.exp(solution.shape[1])
        result["natural_frequency"] = profile_interval(
            search, solution, search.kernel, "natural_frequency", reach, 1.0
        )
    return result


def _bounds(solution: Solution) -> tuple[str, ...]:
    named = ("order", "natural_frequency", "damping", "damping_order", "delay")
    names = [named[i] for i in solution.at_bound]
    return tuple(
        names + (["natural_frequency"] if solution.on_edge and "natural_frequency" not in names else [])
    )


def _assembled(
    search: Search,
    solution: Solution,
    log: Experiment,
    stiffness: float | None,
    predicted: NDArray[np.float64],
    residual: NDArray[np.float64],
    errors: Uncertainty,
    tests: ResidualTests | None,
    intervals: Mapping[str, Interval],
    allow: bool,
) -> Fit:
    count = search.window.samples
    known = stiffness if log.output_kind == "deflection" else None
    fallback = 1.0 if log.output_kind == "deflection" else max(abs(solution.gain), 1e-12)
    model = model_of(solution.shape, known if known is not None else fallback, log.payload)
    mse = float(np.mean(residual[:count] ** 2))
    power = float(np.mean((log.output[:count] - solution.offset) ** 2))
    held = float(np.mean(residual[count:] ** 2)) if count < residual.size else None
    held_power = float(np.mean((log.output[count:] - solution.offset) ** 2)) if held is not None else 0.0
    parameters = len(structure_row(solution.structure).free)
    variances = _variances(errors, allow)
    fit = Fit(
        structure=solution.structure,
        model=model,
        gain=float(solution.gain),
        offset=float(solution.offset),
        delay=float(solution.shape[4]),
        hold=search.window.hold,
        output_kind=log.output_kind,
        period=float(log.period),
        fitted_samples=count,
        mse=mse,
        nmse=mse / power,
        aic=aic(mse, count, parameters),
        bic=bic(mse, count, parameters),
        heldout_mse=held,
        heldout_nmse=held / held_power if held is not None and held_power > 0 else None,
        standard_errors=dict(zip(errors.names, np.sqrt(np.maximum(variances, 0)).tolist(), strict=True)),
        white_standard_errors=dict(
            zip(errors.names, np.sqrt(np.maximum(np.diag(errors.white), 0)).tolist(), strict=True)
        ),
        errors_allow_colour=bool(allow),
        intervals=intervals,
        at_bound=_bounds(solution),
        effective_parameters=errors.effective,
        tests=tests,
        converged=solution.status == 0,
        evaluations=solution.evaluations,
        predicted=predicted,
        residual=residual,
        source=log.source,
        sha256=log.sha256,
    )
    import dataclasses

    return dataclasses.replace(fit, findings=findings_of(fit, errors.singular, stiffness))
