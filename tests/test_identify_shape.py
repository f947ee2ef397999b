"""The coordinates of a fit, the log as the kernel sees it, and which structures contain
which.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fraclink._arm.experiment import Experiment
from fraclink._arm.link import LinkModel
from fraclink._identify import identify, identify_structure, simulated_torque
from fraclink._identify.fitting import (
    make_search,
)
from fraclink._identify.search import Search, Solution
from fraclink._identify.shape import (
    Window,
    columns_of,
    mask_of,
    model_of,
    shape_of,
)
from fraclink._identify.uncertainty import (
    link_intervals,
    uncertainty,
)
from fraclink.errors import LogError, NotConvergedError
from identify_cases import PERIOD, TRUTH, late_cut, made_log, smooth_pulse

LINKS = [
    LinkModel(1.0, 10.0),
    LinkModel(1.0, 10.0, order=1.7),
    LinkModel(1.0, 10.0, damping=1.3),
    LinkModel(1.0, 10.0, damping=1.3, damping_order=0.6),
    LinkModel(1.0, 10.0, damping=0.05, damping_order=1.6),
]


def test_columns_hold_the_output_and_its_derivatives() -> None:
    angle = smooth_pulse(PERIOD * np.arange(3000))
    window = Window(angle, np.zeros(3000), PERIOD, "first")
    shape = shape_of(LinkModel(1.0, 10.0, damping=1.3, damping_order=0.8), 0.01)
    kernel = window.kernel(8.0, longest_delay=0.02)
    columns = columns_of(kernel, shape, mask_of((1, 2, 3, 4)))
    for row, k in enumerate((1, 2, 3, 4)):
        step = 1e-5 * np.eye(5)[k]
        wanted = (
            columns_of(kernel, shape + step)[0] - columns_of(kernel, shape - step)[0]
        ) / 2e-5
        assert columns[1 + row] == pytest.approx(
            wanted, abs=1e-5 * np.abs(wanted).max()
        )
    with pytest.raises(NotConvergedError, match="the vibration pole") as caught:
        columns_of(kernel, np.array([2.0, 2.0, 1.2, 1.0, 0.0]))
    assert "0.9" in caught.value.remedy


# --- starts and limits --------------------------------------------------------------------------------------


def solution(shape: list[float], free: tuple[int, ...]) -> Solution:
    low, high = np.array([1.0, 0.0, 0.0, 0.1, 0.0]), np.array([2.0, 5.0, 0.9, 1.9, 0.1])
    return Solution(
        "D-FOM", free, np.array(shape), 1.0, 0.0, 1.0, np.eye(8), low, high, 0, 1
    )


def searched(log: Experiment, **options: object) -> Search:
    usual = {
        "heldout": 0.0,
        "stiffness": None,
        "fixed": None,
        "guess": None,
        "hold": "auto",
    }
    return make_search(log, **(usual | options))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def log() -> Experiment:
    return made_log(noise=0.05, samples=2501)


class Counted:
    """A kernel whose passes over the data are counted."""

    passes = 0

    def __init__(self, kernel: Any) -> None:
        self.kernel = kernel

    def costs(self, rows: Any, *options: Any) -> Any:
        Counted.passes += len(rows)
        return self.kernel.costs(rows, *options)

    def solve(self, *options: Any) -> Any:
        found = self.kernel.solve(*options)
        Counted.passes += found[5]
        return found


def test_evaluations_are_all_passes_of_the_search(
    log: Experiment, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = Window.kernel
    monkeypatch.setattr(
        Window,
        "kernel",
        lambda self, *given, **named: Counted(made(self, *given, **named)),
    )
    monkeypatch.setattr(Counted, "passes", 0)
    search = searched(log)
    first = search.solve("UD-FOM").evaluations
    assert first == Counted.passes > 0
    # Of the others the work that they start from is a part: special cases, and a row of
    # undamped links.
    for name in ("UD-IOM", "D-FOM"):
        assert search.solve(name).evaluations == Counted.passes > first
    guess = replace(TRUTH, natural_frequency=9.0)
    monkeypatch.setattr(Counted, "passes", 0)
    assert searched(log, guess=guess).solve("UD-FOM").evaluations == Counted.passes


@pytest.mark.parametrize("name", ["UD-IOM", "D-IOM", "D-FOM"])
def test_a_link_of_order_two_keeps_it_wherever_its_fit_is_begun(
    log: Experiment, name: str
) -> None:
    search = searched(log)  # of a link of order 1.92, which is what a scan begins with
    found = search.solve(name)
    assert found.shape[0] == 2.0
    assert search._from_other_valleys(found).shape[0] == 2.0


@pytest.mark.parametrize("seed", [0, 2, 3, 4, 6])
def test_a_lightly_damped_link_still_swings_by_what_was_long_before_the_cut(
    seed: int,
) -> None:
    """The last 2 s of 32 s at ζ = 0.02: by 6 s before the cut alone the delay is up to
    9 ms off.
    """
    cut = late_cut(seed)
    fit = identify(cut)
    delay = fit.intervals["delay"]
    assert fit.passed and fit.structure == "D-IOM"
    assert delay.low < 0.0 < delay.high and delay.high - delay.low < 2e-3
    assert fit.model.natural_frequency == pytest.approx(10.0, rel=1e-3)


@pytest.mark.parametrize("hold", ["first", "zero"])
def test_a_ring_down_behind_a_cut_is_fitted_by_the_move_before_it(hold: Any) -> None:
    time = PERIOD * np.arange(2500)
    angle = (
        0.4 * np.clip((time - 0.1) / 0.2, 0, 1)
        if hold == "first"
        else 0.4 * (time > 0.2)
    )
    torque = simulated_torque(TRUTH, angle, PERIOD, hold=hold)
    torque += 0.01 * torque.std() * np.random.default_rng(0).standard_normal(time.size)
    cut = Experiment(PERIOD, angle[100:], torque[100:], earlier_angle=angle[:100])
    fit = identify(cut)
    # Between samples the input does what it did in the move: of an angle at rest
    # nothing is seen of that.
    assert fit.passed and fit.hold == hold
    assert fit.model.order == pytest.approx(TRUTH.order, abs=2e-3)
    assert abs(fit.delay) < 1e-3
    structured = identify_structure(cut, "k*s**a/(s**a + w)", details=False)
    assert structured.hold == hold
    assert structured.parameters["a"] == pytest.approx(TRUTH.order, abs=2e-3)
    with pytest.raises(LogError, match="motor_angle: constant over the fitted part"):
        identify(replace(cut, earlier_angle=np.full(100, 0.4)))


# --- which part is held out ---------------------------------------------------------------------------------


def moved(*moves: tuple[float, float], count: int = 3000) -> Experiment:
    """A motor that ramps by 1 rad within 0.2 s at these times [s], in these directions."""
    time = PERIOD * np.arange(count)
    angle = sum(sign * np.clip((time - at) / 0.2, 0, 1) for at, sign in moves)
    output = np.exp(-np.maximum(time - moves[0][0], 0.0)) * np.where(
        time > moves[0][0], np.sin(10 * time), 0
    )
    return Experiment(period=PERIOD, motor_angle=angle, output=output)


def test_too_short_and_still_logs_are_refused_with_what_is_wanted() -> None:
    log = made_log(samples=1000)
    short = Experiment(
        period=PERIOD, motor_angle=log.motor_angle[250:299], output=log.output[250:299]
    )
    with pytest.raises(LogError) as caught:
        searched(short)
    assert (caught.value.field, caught.value.value, caught.value.allowed) == (
        "output",
        49,
        ">= 50",
    )
    searched(
        Experiment(
            period=PERIOD,
            motor_angle=log.motor_angle[250:300],
            output=log.output[250:300],
        )
    )
    still = Experiment(
        period=PERIOD, motor_angle=np.full(100, 0.3), output=log.output[250:350]
    )
    with pytest.raises(LogError) as caught:
        searched(still)
    assert (caught.value.field, caught.value.value, caught.value.allowed) == (
        "motor_angle",
        0.3,
        "a motion",
    )


def test_errors_under_white_noise_written_out(log: Experiment) -> None:
    """σ² (JᵀJ)⁻¹ of the written-out columns, for a viscous link with gain, offset and
    delay.
    """
    search = searched(log)
    solution = search.solve("D-IOM")
    found = uncertainty(search, solution, coloured=False)
    assert found.names == ("natural_frequency", "damping", "delay", "gain", "offset")
    model = model_of(solution.shape, 1.0, None)
    steps = {"natural_frequency": 1e-4, "damping": 1e-4, "delay": 1e-6}
    columns = []
    for name, step in steps.items():
        ends = []
        for sign in (1, -1):
            delay = solution.shape[4] + (sign * step if name == "delay" else 0.0)
            moved = (
                model
                if name == "delay"
                else replace(model, **{name: getattr(model, name) + sign * step})
            )
            ends.append(columns_of(search.kernel, shape_of(moved, delay))[0])
        columns.append(solution.gain * (ends[0] - ends[1]) / (2 * step))
    columns += [columns_of(search.kernel, solution.shape)[0], np.ones(log.output.size)]
    J = np.array(columns)
    variance = solution.cost / (log.output.size - 5)
    wanted = variance * np.linalg.inv(J @ J.T)
    assert found.white == pytest.approx(
        wanted, rel=2e-3, abs=1e-3 * np.sqrt(np.outer(*2 * [np.diag(wanted)])).min()
    )
    assert (found.lag, found.effective, found.singular, found.coloured) == (
        1,
        5.0,
        False,
        None,
    )
    # Of the resonance the error is relative: that of ln Ω, which viscous damping does
    # not move.
    assert found.resonance == pytest.approx(
        math.sqrt(wanted[0, 0]) / model.natural_frequency, rel=1e-2
    )
    coloured = uncertainty(search, solution, coloured=True)
    assert coloured.white == pytest.approx(found.white)
    assert coloured.coloured is not None
    assert np.diag(coloured.coloured) == pytest.approx(np.diag(wanted), rel=0.5)
    assert 3.0 < coloured.effective < 9.0


def test_a_profile_is_the_best_cost_with_the_parameter_held(log: Experiment) -> None:
    """At each end of an interval a fit with that value costs exp(1.96²/n) times the
    least.
    """
    search = searched(log)
    solution = search.solve("UD-FOM")
    interval = link_intervals(search, solution, {"order": 1.0})["order"]
    assert not interval.low_open and not interval.high_open
    assert interval.low < solution.shape[0] < interval.high
    for end in (interval.low, interval.high):
        held = searched(log, fixed={"order": end}).solve("UD-FOM")
        told = log.output.size * math.log(held.cost / solution.cost)
        assert math.sqrt(told) == pytest.approx(1.96, abs=5e-3)
    wide = link_intervals(search, solution, {"order": 4.0})["order"]
    assert wide.high - wide.low == pytest.approx(
        2 * (interval.high - interval.low), rel=0.05
    )
    own = link_intervals(search, solution, {"natural_frequency": 1.0})[
        "natural_frequency"
    ]
    assert own.contains(model_of(solution.shape, 1.0, None).natural_frequency)
