"""Fit of one structure to one log: options, the held-out part, the fit and its
uncertainty.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np

from fraclink._arm.experiment import Experiment
from fraclink._arm.link import STRUCTURES, LinkModel, SecondMode
from fraclink._identify.findings import findings_of
from fraclink._identify.fit import Fit, aic
from fraclink._identify.problem import QUANTILE, Interval
from fraclink._identify.residual import find_second_mode, residual_tests
from fraclink._identify.search import Search, Solution
from fraclink._identify.shape import (
    ALPHA_LIMITS,
    COORDINATE,
    LEAST_SAMPLES,
    ORDER_LIMITS,
    Hold,
    Window,
    chosen_hold,
    columns_of,
    model_of,
    moving_angle,
    shape_of,
)
from fraclink._identify.uncertainty import (
    link_covariance,
    link_intervals,
)
from fraclink.errors import LogError
from fraclink.findings import errors_of
from fracsys.checks import Array, Between, Real, above, checked, checked_choice

_FIXABLE: dict[str, tuple[float, float]] = {
    "gain": (-1e12, 1e12),
    "offset": (-1e12, 1e12),
    "delay": (-1.0, 10.0),
    "order": ORDER_LIMITS,
    "damping_order": ALPHA_LIMITS,
}
HeldOut = Annotated[
    float, Between(0.0, 0.9, remedy="give 0.4, 0 for none, or leave it out")
]
Stiffness = Annotated[
    float,
    above(0.0, 1e9, "N·m/rad", remedy="give c in N·m/rad or leave it out"),
]
Motion = Annotated[Real, Array(1, min_size=2)]
Delay = Annotated[float, Between(*_FIXABLE["delay"], "s")]
SamplingPeriod = Annotated[float, Between(1e-6, 1e6, "s")]

_HELDOUT = 0.4
# share of the motor's motion (mean square speed) that a held-out part must contain
_MOVES = 0.05
# Parts of a log in which its motion is measured: they place a border to one per cent.
_BLOCKS = 120


@checked
def simulated_torque(
    model: LinkModel,
    motor_angle: Motion,
    period: SamplingPeriod,
    *,
    delay: Delay = 0.0,
    hold: Hold = "auto",
) -> Real:
    """Return the torque [N·m] of a link whose motor angle [rad] is linear or held
    between its samples.

    The link is at rest at first. `identify` compares a log with this torque;
    `fracsys.time_response` computes it independently.
    """
    window = Window(
        motor_angle, np.zeros_like(motor_angle), period, chosen_hold(motor_angle, hold)
    )
    kernel = window.kernel(abs(model.pole), longest_delay=abs(delay))
    return model.stiffness * columns_of(kernel, shape_of(model, delay))[0]


def make_search(
    log: Experiment,
    *,
    heldout: float | None,
    stiffness: float | None,
    fixed: Mapping[str, float] | None,
    guess: LinkModel | None,
    hold: Hold,
) -> Search:
    """Check the fixed parameters and select the fitted part of the log."""
    values = {
        checked_choice("fixed", name, _FIXABLE): Between(
            *_FIXABLE[name], remedy="give another value"
        ).check(f"fixed[{name!r}]", value)
        for name, value in (fixed or {}).items()
    }
    if stiffness is not None and log.output_kind == "torque":
        # In a deflection log the gain is that of the gauge, whatever the stiffness of
        # the link.
        values.setdefault("gain", stiffness)
    count = fitted_samples(log.motor_angle, log.output, heldout)
    # Motion before the cut counts as well: a ring-down after it determines the link
    # completely.
    window = fitted_window(log, count, chosen_hold(moving_angle(log), hold))
    if window.samples < LEAST_SAMPLES:
        raise LogError(
            "output",
            window.samples,
            "too few samples to fit",
            f">= {LEAST_SAMPLES}",
            "record a longer log",
        )
    check_motion(motor_angle=window.input, output=window.output)
    start = None
    if guess is not None:
        start = shape_of(guess, values.get("delay", 0.0))
        # A guess may be any link; a search that starts outside its limits would end
        # there.
        start[0] = np.clip(start[0], *ORDER_LIMITS)
    return Search(window, values, start)


def fitted_window(
    log: Experiment, count: int, hold: Literal["zero", "first"]
) -> Window:
    """The first `count` samples of a log, with the known earlier motion of the motor."""
    angle = moving_angle(log)
    return Window(
        angle[: angle.size - log.output.size + count],
        log.output[:count],
        log.period,
        hold,
    )


def check_motion(**channels: Real) -> None:
    """Raise LogError for a channel that does not change."""
    for name, values in channels.items():
        if np.ptp(values) == 0:
            raise LogError(
                name,
                float(values[0]),
                "constant",
                "a motion",
                "excite the arm, check gauge and wiring, or give another column or part of the log",
            )


# --- the held-out part ------------------------------------------------------------------------------------


def _activity(signal: Real) -> Real:
    """Share of the signal's energy after each of the blocks' borders, shape (_BLOCKS +
    1,).

    Twice the level of the quietest blocks counts as noise and is subtracted; otherwise
    half an hour of a noisy gauge at rest would outweigh a move of one second.
    """
    size, longer = divmod(signal.size, _BLOCKS)
    # Like np.array_split: the first blocks are one sample longer.
    starts = size * np.arange(_BLOCKS) + np.minimum(np.arange(_BLOCKS), longer)
    lengths = np.diff(starts, append=signal.size)
    blocks = np.add.reduceat(signal**2, starts) / lengths
    energy = np.maximum(blocks - 2 * np.quantile(blocks, 0.05), 0.0)
    # the same everywhere: a periodic motion
    energy = energy if energy.sum() > 0 else np.ones(_BLOCKS)
    return np.concatenate([np.cumsum(energy[::-1])[::-1], [0.0]]) / energy.sum()


def _activities(angle: Real, output: Real) -> tuple[Real, Real]:
    """The activity of the motor's motion and that of the output's vibration."""
    # Steps of the angle instead of the angle: a motor that rests away from zero does
    # not move.
    return _activity(np.diff(angle)), _activity(output - np.median(output))


def motion_after(angle: Real, output: Real, count: int) -> tuple[float, float]:
    """Shares of the motor's motion and of the output's vibration that lie after sample
    `count`.
    """
    if count >= output.size:
        return 0.0, 0.0
    places = np.linspace(0, output.size, _BLOCKS + 1)
    motion, vibration = (
        float(np.interp(count, places, activity))
        for activity in _activities(angle, output)
    )
    return motion, vibration


def fitted_samples(angle: Real, output: Real, heldout: float | None) -> int:
    """Number of samples to fit: all but the share `heldout`, by default so that both the
    fitted and the held-out part contain motion.

    The last 40 % are held out if the motor moves enough on both sides. Otherwise the
    border moves to the last rest that is followed by a quarter of the motion or more;
    a log of one move is cut within its ring-down, with a quarter of the vibration still
    to come.
    """
    total = output.size
    count = total - round((_HELDOUT if heldout is None else heldout) * total)
    # Blocks of one or two samples have no meaningful mean square.
    if (
        heldout is not None
        or total < 2 * _BLOCKS
        or _MOVES <= motion_after(angle, output, count)[0] <= 1 - _MOVES
    ):
        return count
    places = np.linspace(0, total, _BLOCKS + 1).astype(int)
    motor, swing = _activities(angle, output)
    borders = [k for k in range(1, _BLOCKS) if places[k] >= LEAST_SAMPLES]
    # A border at rest: the held-out part then begins like the model, without earlier
    # vibration.
    rests = [
        k
        for k in borders
        if motor[k - 1] - motor[k] < 0.01 and 0.25 <= motor[k] <= 0.75
    ]
    ringing = [k for k in borders if swing[k] >= 0.25 and motor[k] < 0.5]
    # The last of them, so that the fitted part is as long as possible.
    return int(places[max(rests or ringing or [round(_BLOCKS * (1 - _HELDOUT))])])


# --- the fit and its uncertainty ---------------------------------------------------------------------------


def predicted_output(search: Search, solution: Solution, log: Experiment) -> Real:
    """The output over the whole log, of which the search only used the first part."""
    whole = fitted_window(log, log.output.size, search.window.hold)
    kernel = search.kernel_of(whole)
    return solution.gain * columns_of(kernel, solution.shape)[0] + solution.offset


def fit_from(
    search: Search,
    name: str,
    log: Experiment,
    *,
    stiffness: float | None,
    details: bool,
    like: Fit | None = None,
) -> Fit:
    """The fit of one structure from a search, judged on the whole log. With a fit
    `like` of the same log, the second mode is taken from it.
    """
    solution = search.solve(name)
    window = search.window
    predicted = predicted_output(search, solution, log)
    residual = log.output - predicted
    # Without details only the white covariance: the coloured one takes as long as the
    # fit.
    covariance, resonance = link_covariance(search, solution, coloured=details)
    tests, intervals = None, {}
    if details:
        # On the fitted part: the held-out part is for judging the prediction, not the
        # noise.
        motion = np.ediff1d(window.input, to_end=0.0)[-window.samples :]
        tests = residual_tests(residual[: window.samples], motion)
        intervals = link_intervals(search, solution, covariance)
    mode: tuple[SecondMode | None, float | None] = (None, None)
    if like is not None:
        mode = like.model.second_mode, like.model.unseen_up_to
    elif details:
        mode = find_second_mode(search, solution, moving_angle(log), residual)
    stuck = {*solution.at_bound, *((1,) if solution.on_edge else ())}
    fit = Fit(
        structure=name,
        model=_identified(solution, log, covariance.errors, intervals, mode, stiffness),
        gain=float(solution.gain),
        offset=float(solution.offset),
        delay=float(solution.shape[4]),
        hold=window.hold,
        output_kind=log.output_kind,
        period=float(log.period),
        **_figures(log, residual, window.samples, solution),
        standard_errors=covariance.errors,
        intervals=intervals,
        at_bound=tuple(name for name, place in COORDINATE.items() if place in stuck),
        effective_parameters=covariance.effective,
        tests=tests,
        converged=solution.converged,
        predicted=predicted,
        residual=residual,
        source=log.source,
        sha256=log.sha256,
    )
    shares = motion_after(log.motor_angle, log.output, window.samples)
    sure = (resonance, covariance.unseen.size > 0)
    findings = findings_of(fit, solution, sure, stiffness, shares, log)
    # Errors that make the log unusable make the model unusable.
    return dataclasses.replace(fit, findings=(*errors_of(log.findings), *findings))


def _figures(
    log: Experiment, residual: Real, count: int, solution: Solution
) -> dict[str, Any]:
    """Errors and criteria over the fitted part and over the held-out part."""
    # Parameters of the structure, as counted in the paper: gain, offset and delay occur
    # in every structure and shift all criteria equally.
    parameters = len(STRUCTURES[solution.structure].free)
    # Powers about the offset, so that a constant error of the gauge explains nothing.
    swing = log.output - solution.offset
    squares, powers = residual**2, swing**2
    mse = float(np.mean(squares[:count]))
    # After the last sample at which the prediction exceeds the error of the fitted
    # part, a ring-down is lost in noise, and an error there says nothing about the
    # model.
    motion = (swing - residual)[count:] ** 2
    end = count + 1 + int(np.flatnonzero(motion >= mse).max(initial=-1))
    heldout, held_power = (
        (float(np.mean(squares[count:end])), float(np.mean(powers[count:end])))
        if end > count
        else (None, 0.0)
    )
    return {
        "fitted_samples": count,
        "mse": mse,
        "nmse": mse / float(np.mean(powers[:count])),
        "aic": aic(mse, count, parameters),
        "heldout_mse": heldout,
        "heldout_nmse": heldout / held_power
        if heldout is not None and held_power > 0
        else None,
    }


def _identified(
    solution: Solution,
    log: Experiment,
    errors: Mapping[str, float],
    intervals: Mapping[str, Interval],
    mode: tuple[SecondMode | None, float | None],
    stiffness: float | None,
) -> LinkModel:
    """The link with everything that the log determined, so that no later step has to
    state it again.

    A torque log determines the product of gauge gain and stiffness, which is the
    stiffness seen by the controller. A deflection log determines the gauge gain itself.
    A reversed sign is a wiring fault to be stated in the rig file (W211), not a
    property of the gauge.
    """
    # A link model cannot have zero stiffness; a fit to noise may end there, which its
    # gates report.
    size = max(abs(solution.gain), 1e-12)
    torque = log.output_kind == "torque"
    # The gain is linear in the prediction: its profile is a parabola, and the standard
    # error suffices.
    reach = QUANTILE * errors.get("gain", math.nan)
    rows = [
        ("gauge_delay" if name == "delay" else name, end.low, end.high)
        for name, end in intervals.items()
    ]
    if intervals and math.isfinite(reach):
        rows.append(
            ("stiffness" if torque else "gauge_gain", size - reach, size + reach)
        )
    return model_of(
        solution.shape,
        size if torque else stiffness or 1.0,
        log.payload,
        gauge_gain=1.0 if torque else size,
        second_mode=mode[0],
        unseen_up_to=mode[1],
        intervals=tuple(rows),
    )
