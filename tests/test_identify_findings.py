"""Every finding of a fit at its threshold: what is said on either side, with which
numbers.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fraclink._arm.experiment import Experiment
from fraclink._arm.link import LinkModel, SecondMode
from fraclink._arm.rig import Rig
from fraclink._design import design
from fraclink._identify import (
    Contest,
    Fit,
    Interval,
    ResidualTests,
    aic,
    bic,
    coincidence_text,
    frequency_text,
)
from fraclink._identify.columns import (
    column_findings,
    lead_of,
    mains_of,
    motion_at_start,
)
from fraclink._identify.compare import (
    _gap,
    _near,
    _of_the_delay,
    _of_the_parameters,
    identify,
    preferred_structure,
)
from fraclink._identify.findings import (
    _no_signal,
    _of_outliers,
    _of_the_gain,
    _of_the_optimum,
    _of_the_prediction,
    _of_the_residual,
    _of_the_stiffness,
    _of_the_vibration,
    signal_of,
)
from fraclink._identify.findings import (
    _of_the_delay as delay_findings,
)
from fraclink._identify.fit import _second_mode
from fraclink._identify.search import Solution
from fraclink._identify.uncertainty import Uncertainty
from fraclink.findings import Finding
from identify_cases import PERIOD, made_log

CYCLE = 2 * math.pi / 10.0


@pytest.fixture(scope="module")
def fit() -> Fit:
    """A fit without findings, to be changed."""
    return identify(made_log(noise=0.05, samples=2501), "UD-FOM", details=False)


def one(findings: Iterable[Finding]) -> Finding:
    (found,) = list(findings)
    return found


def codes(findings: Iterable[Finding]) -> list[str]:
    return [finding.code for finding in findings]


# --- the log's columns --------------------------------------------------------------------------------------


def columns(angle: Any, output: Any) -> list[Finding]:
    return list(
        column_findings(Experiment(period=PERIOD, motor_angle=angle, output=output))
    )


def test_a_copy_of_the_motor_is_told_by_the_variance_that_it_explains() -> None:
    rng = np.random.default_rng(0)
    angle, noise = 0.1 * rng.normal(size=(2, 20_000))
    noise -= noise @ angle / (angle @ angle) * angle
    for explained, told in ((0.985, True), (0.975, False)):
        output = 3.0 - 2.0 * (
            math.sqrt(explained) * angle / angle.std()
            + math.sqrt(1 - explained) * noise / noise.std()
        )
        found = columns(angle, output)
        assert codes(found) == ["W324"] * told
        if told:
            assert found[0].evidence == {
                "explained": pytest.approx(explained, abs=1e-3),
                "most": 0.98,
            }
            assert "the motor's angle times a constant" in found[0].message
            assert found[0].severity == "error"


def test_a_clock_and_a_counter_grow_by_one_step() -> None:
    rng = np.random.default_rng(0)
    angle, count = 1e-3 * np.cumsum(rng.normal(size=1000)), np.arange(1000)
    for output in (0.1 * count, count % 256.0, 5.0 - 0.2 * count):
        found = one(columns(angle, output))
        assert "grows steadily" in found.message
        assert found.evidence == {"first": output[0], "last": output[-1]}
    ramp = one(columns(3e-3 * count, rng.normal(size=1000)))
    assert "motor angle grows by one step" in ramp.message
    assert ramp.evidence == {"first": 0.0, "last": 3e-3 * 999}
    # A ramp for 92 % of the record is one, for 88 % none.
    for share, told in ((0.92, True), (0.88, False)):
        part = np.where(count < share * 1000, 1e-3 * count, 0.0)
        output = np.where(count < share * 1000, part, 2000 * rng.normal(size=1000))
        assert bool(columns(angle, output)) is told


def test_an_amplifier_at_its_stops() -> None:
    rng = np.random.default_rng(1)
    angle, wave = 1e-3 * np.cumsum(rng.normal(size=5000)), rng.normal(size=5000)
    for share, told in ((0.12, True), (0.08, False)):
        low, high = np.quantile(wave, [share / 2, 1 - share / 2])
        found = columns(angle, np.clip(wave, low, high))
        assert codes(found) == ["W325"] * told
        if told:
            assert found[0].evidence["share"] == pytest.approx(0.12, abs=1e-3)
            assert (found[0].evidence["low"], found[0].evidence["high"]) == (low, high)
            assert found[0].message.startswith("12 % of the samples")
    # A coarse converter has as many samples beside its extremes as at them: nothing
    # stands out.
    assert not columns(angle, np.round(np.clip(wave, -2, 2)))
    # Of two levels alone, all are extremes: a command.
    assert codes(columns(angle, np.sign(wave))) == ["W325"]


def test_a_log_that_begins_in_motion() -> None:
    assert [lead_of(np.zeros(n)) for n in (100, 1000, 1060, 5000)] == [10, 10, 11, 50]
    rest, swing = np.zeros(1000), np.zeros(1000)
    rest[500:] = 1.0
    assert motion_at_start(rest, swing, 1.0) is None
    assert (
        motion_at_start(np.linspace(0, 1, 1000), swing, 1.0) is None
    )  # 0.9 % in the first ten samples
    moving = rest.copy()
    moving[9] = 0.021
    assert motion_at_start(moving, swing, 1.0) == "the motor moves"
    moving[9] = 0.019
    assert motion_at_start(moving, swing, 1.0) is None
    for bent, told in (
        (0.51, "the link is bent"),
        (0.49, None),
        (-0.51, "the link is bent"),
    ):
        assert motion_at_start(rest, swing + bent, 1.0) == told


# --- is there a signal --------------------------------------------------------------------------------------


def test_the_signal_is_twice_the_log_likelihood_over_an_arm_at_rest(fit: Fit) -> None:
    count = fit.fitted_samples
    output = (fit.predicted + fit.residual)[:count]
    wanted = count * math.log(np.var(output) / np.mean(fit.residual[:count] ** 2))
    assert signal_of(fit) == pytest.approx(wanted, rel=1e-9)
    coloured = replace(fit, effective_parameters=3.0 * len(fit.standard_errors))
    assert signal_of(coloured) == pytest.approx(wanted / 3, rel=1e-9)
    assert signal_of(replace(fit, effective_parameters=1.0)) == pytest.approx(
        wanted, rel=1e-9
    )
    assert signal_of(replace(fit, mse=1e9)) == 0.0


def test_mains_are_told_by_their_line() -> None:
    rng = np.random.default_rng(0)
    time = PERIOD * np.arange(4001)

    def mains(output: Any, part: slice = slice(None)) -> float | None:
        log = Experiment(period=PERIOD, motor_angle=time[part], output=output[part])
        return mains_of(log)

    for hertz, told in (
        (50.0, 50.0),
        (50.4, 50.0),
        (49.6, 50.0),
        (60.0, 60.0),
        (59.7, 60.0),
    ):
        assert (
            mains(np.sin(2 * np.pi * hertz * time) + 0.3 * rng.normal(size=4001))
            == told
        )
    for hertz in (16.0, 48.0, 52.0, 55.0, 58.0, 62.0, 100.0):
        assert mains(np.sin(2 * np.pi * hertz * time)) is None
    assert mains(np.sin(2 * np.pi * 50 * time) + 2 * rng.normal(size=4001)) is None
    # A tenth of a second tells frequencies no better than to 10 Hz.
    assert mains(np.sin(2 * np.pi * 51.0 * time), slice(26)) == 50.0


def test_no_signal_names_the_cause() -> None:
    time = PERIOD * np.arange(2001)
    noise = np.random.default_rng(0).normal(size=2001)

    def said(turned: float, output: Any) -> Finding:
        angle = turned * np.where(time > 4.0, 1.0, 0.0)
        return _no_signal(
            12.0, Experiment(period=PERIOD, motor_angle=angle, output=output)
        )

    still = said(0.9e-3, noise)
    assert "hardly moves, it turns by 0.0009 rad" in still.message
    assert still.evidence == {
        "signal": 12.0,
        "least": 30.0,
        "motor_range": pytest.approx(0.9e-3),
    }
    assert "hardly better than a constant" in said(1.1e-3, noise).message
    assert "mains hum at 50 Hz" in said(0.5, np.sin(100 * np.pi * time)).message
    assert {said(x, noise).code for x in (1e-4, 1.0)} == {"W313"}
    assert {said(x, noise).severity for x in (1e-4, 1.0)} == {"error"}


def solution_of(fit: Fit, **changes: Any) -> Solution:
    shape = np.array([fit.model.order, math.log(10.0), 0.0, 1.0, 0.0])
    low, high = (
        np.array([1.01, 0.0, 0.0, 0.1, 0.0]),
        np.array([2.0, 5.0, 0.9, 1.9, 0.1]),
    )
    made = Solution(
        "UD-FOM", (0, 1, 4), shape, 1.0, 0.0, 1.0, np.eye(8), low, high, 0, 1
    )
    return replace(made, **changes)


def errors_of(resonance: float) -> Uncertainty:
    return Uncertainty(("order",), np.eye(1), None, 1, 1.0, False, resonance)


def test_a_vibration_is_neither_at_a_limit_nor_unknown(fit: Fit) -> None:
    log = made_log(samples=1000)

    def said(
        errors: float = 0.01, changed: Fit = fit, **solution: Any
    ) -> list[Finding]:
        return list(
            _of_the_vibration(
                changed, solution_of(changed, **solution), errors_of(errors), log
            )
        )

    assert said(0.0999) == []
    unknown = one(said(0.1001))
    assert (unknown.code, unknown.evidence["most"]) == ("W315", 0.1)
    assert unknown.evidence["resonance"] == pytest.approx(10.0)
    assert unknown.evidence["relative_error"] == 0.1001
    assert codes(said(upper=np.array([2.0, math.log(10.0), 0.9, 1.9, 0.1]))) == ["W314"]
    # λ at its lower limit vibrates no more; at its upper one it is a classical link.
    stuck = replace(fit, model=replace(fit.model, order=1.2))
    found = one(said(changed=stuck, lower=np.array([1.2, 0.0, 0.0, 0.1, 0.0])))
    assert (found.code, found.severity) == ("W314", "error")
    assert found.evidence == {"resonance": pytest.approx(10.0), "order": 1.2}
    classical = replace(fit, model=replace(fit.model, order=2.0))
    assert said(changed=classical) == []
    quiet = one(
        said(
            changed=replace(
                fit, mse=0.999 * float(np.var((fit.predicted + fit.residual)[:1501]))
            )
        )
    )
    assert quiet.code == "W313"


# --- does it predict ----------------------------------------------------------------------------------------


def held(
    fit: Fit, nmse: float, held_nmse: float | None, ratio: float = 0.0, **more: Any
) -> list[Finding]:
    """Findings for relative errors; `ratio` is that of the mean squared errors, by
    default the same.
    """
    part = None if held_nmse is None else (ratio or held_nmse / nmse) * 1e-3
    changed = replace(
        fit, nmse=nmse, mse=1e-3, heldout_nmse=held_nmse, heldout_mse=part
    )
    return list(_of_the_prediction(changed, more.get("motion", (0.4, 0.4))))


def test_what_was_held_out_is_predicted(fit: Fit) -> None:
    assert held(fit, 0.1, None) == []
    assert held(fit, 0.01, 0.0399) == []
    worse = one(held(fit, 0.01, 0.0401))
    assert (worse.code, worse.severity) == ("W311", "warning")
    assert worse.evidence == {"nmse": 0.01, "heldout_nmse": 0.0401}
    assert (
        held(fit, 0.01, 0.0401, ratio=1.9) == []
    )  # the vibration is smaller there, and the error with it
    assert held(fit, 0.3, 0.499) == []
    lost = one(held(fit, 0.3, 0.501))
    assert (lost.code, lost.severity) == ("W318", "error")
    assert (
        lost.evidence["heldout_nmse"],
        lost.evidence["most"],
        lost.evidence["nmse"],
    ) == (0.501, 0.5, 0.3)
    # A ring-down sunk into the noise: an error of 1.4 times that of the fitted part is
    # the noise.
    assert codes(held(fit, 0.4, 0.9, ratio=1.4)) == []
    assert codes(held(fit, 0.4, 0.9, ratio=1.6)) == ["W318"]
    assert codes(held(fit, 0.6, 0.9, ratio=1.4)) == ["W318"]


def test_a_held_out_part_at_rest_tests_nothing(fit: Fit) -> None:
    still = one(held(fit, 0.01, 0.3, motion=(0.009, 0.002)))
    assert (still.code, still.severity) == ("W317", "error")
    assert still.evidence == {"motion": 0.009, "vibration": 0.002, "heldout_nmse": 0.3}
    assert codes(held(fit, 0.01, 0.03, motion=(0.011, 0.0))) == []
    assert codes(held(fit, 0.01, 0.03, motion=(0.0, 0.011))) == []


def test_a_border_before_the_middle_is_told(fit: Fit) -> None:
    half = fit.samples // 2
    for count, told in ((half - 1, ["W319"]), (half, [])):
        changed = replace(
            fit,
            fitted_samples=count,
            nmse=0.01,
            heldout_nmse=0.01,
            mse=1.0,
            heldout_mse=1.0,
        )
        found = list(_of_the_prediction(changed, (0.3, 0.2)))
        assert codes(found) == told
    found = list(_of_the_prediction(replace(changed, fitted_samples=1000), (0.3, 0.2)))
    assert found[0].evidence == {"fitted_time": 4.0, "motion": 0.3, "vibration": 0.2}


@pytest.mark.parametrize(
    ("before", "after", "predicted", "part"),
    [
        (1.0, 0.29, 1.0, "a cable that came off"),
        (1.0, 0.31, 1.0, "a payload that slipped"),
        (1.0, 0.2, 0.5, "a payload that slipped"),
        (1.0, 2.1, 1.0, "a gauge that drifts"),
        (1.0, 1.9, 1.0, "a payload that slipped"),
        (1.0, 2.1, 1.1, "a payload that slipped"),
    ],
)
def test_the_cause_is_read_off_the_sizes(
    fit: Fit, before: float, after: float, predicted: float, part: str
) -> None:
    count = fit.fitted_samples
    sign = np.where(np.arange(fit.samples) % 2, 1.0, -1.0)
    output = sign * np.where(np.arange(fit.samples) < count, before, after)
    model = sign * np.where(np.arange(fit.samples) < count, before, predicted)
    changed = replace(
        fit,
        predicted=model,
        residual=output - model,
        nmse=0.2,
        heldout_nmse=0.9,
        mse=1.0,
        heldout_mse=9.0,
    )
    found = one(_of_the_prediction(changed, (0.4, 0.4)))
    assert part in found.remedy
    sizes = {"rms": after, "fitted_rms": before, "predicted_rms": predicted}
    assert {name: found.evidence[name] for name in sizes} == pytest.approx(
        sizes, rel=1e-3
    )


# --- the optimum --------------------------------------------------------------------------------------------


def test_a_parameter_at_its_bound_says_what_that_means(fit: Fit) -> None:
    for name, words in (
        ("order", "the link is classical"),
        ("damping", "no damping of this kind"),
        ("natural_frequency", "λ = 2 − α"),
        ("damping_order", "does not determine α"),
        ("delay", "a third of a period"),
    ):
        found = one(
            _of_the_optimum(
                replace(fit, at_bound=(name,), delay=0.02, hold="first"), False
            )
        )
        assert (found.code, found.severity) == ("W301", "warning")
        assert words in found.remedy
        value = 0.02 if name == "delay" else getattr(fit.model, name)
        assert found.evidence == {name: value}
    for changes in ({"delay": 0.0, "hold": "first"}, {"delay": 0.02, "hold": "zero"}):
        assert not list(
            _of_the_optimum(replace(fit, at_bound=("delay",), **changes), False)
        )  # type: ignore[arg-type]


def test_an_optimiser_that_stopped_and_a_singular_matrix(fit: Fit) -> None:
    assert list(_of_the_optimum(fit, False)) == []
    stopped = one(_of_the_optimum(replace(fit, converged=False, evaluations=77), False))
    assert (stopped.code, stopped.evidence) == ("W302", {"passes": 77.0})
    assert one(_of_the_optimum(fit, True)).code == "W303"


@pytest.mark.parametrize(
    ("interval", "told"),
    [
        (Interval(0.5, 0.99, False, False), False),
        (Interval(0.5, 1.01, False, False), True),
        (Interval(0.5, 0.6, True, False), True),
        (Interval(0.5, 0.6, False, True), True),
    ],
)
def test_a_wide_interval_of_alpha_is_told(
    fit: Fit, interval: Interval, told: bool
) -> None:
    found = list(
        _of_the_optimum(replace(fit, intervals={"damping_order": interval}), False)
    )
    assert codes(found) == ["W308"] * told
    if told:
        assert found[0].evidence == {
            "alpha_low": interval.low,
            "alpha_high": interval.high,
        }


# --- units, sign and delay ----------------------------------------------------------------------------------


def test_an_angle_of_more_than_a_turn() -> None:
    noise = np.random.default_rng(0).normal(size=300)
    assert columns(1.0 + np.linspace(0.0, 6.28**2, 300) ** 0.5, noise) == []
    found = one(columns(1.0 - np.linspace(0.0, 6.29**2, 300) ** 0.5, noise))
    assert (found.code, found.severity) == ("W323", "error")
    assert found.evidence == {
        "largest_angle": pytest.approx(6.29),
        "if_degrees": pytest.approx(0.10978, rel=1e-4),
    }


def test_the_gain_of_a_deflection_is_one(fit: Fit) -> None:
    def said(gain: float) -> list[str]:
        return codes(_of_the_gain(replace(fit, output_kind="deflection", gain=gain)))

    assert said(1.0) == said(-1.0) == said(1.49) == said(0.67) == []
    assert said(1.51) == said(0.66) == said(-1.51) == ["W320"]
    assert list(_of_the_gain(replace(fit, gain=7.0))) == []
    found = one(_of_the_gain(replace(fit, output_kind="deflection", gain=7.0)))
    assert found.evidence == {"gain": 7.0, "least": pytest.approx(2 / 3), "most": 1.5}


def test_the_stiffness_that_a_deflection_cannot_show_is_the_rigs(fit: Fit) -> None:
    deflected = replace(fit, output_kind="deflection", gain=1.0)
    assert codes(_of_the_stiffness(deflected, None)) == ["W304"]
    assert (
        list(_of_the_stiffness(deflected, 1.5))
        == list(_of_the_stiffness(fit, None))
        == []
    )
    # In every loop; one that a fit has stays its own.
    rig = Rig.named("paper-2023")
    placeholder = replace(fit.model, stiffness=1.0)
    unknown = tuple(_of_the_stiffness(deflected, None))
    blind = replace(deflected, model=placeholder, findings=unknown)
    assert blind.loop_model(rig) == replace(placeholder, stiffness=1.56)
    assert replace(blind, findings=()).loop_model(rig) == placeholder
    wanted = {
        "payloads": (0.02, 0.04),
        "gain_crossover": 11.5,
        "phase_margin": math.radians(40),
    }
    named = replace(blind, model=replace(placeholder, payload=0.03))
    assert (
        design(named, rig, **wanted, filter_time=0.0, law=False).model.stiffness == 1.56
    )
    noise = np.random.default_rng(0).normal(size=1500)
    deaf = identify(
        replace(made_log(samples=1500), output=noise, output_kind="deflection"),
        details=False,
    )
    assert {"W313", "W304"} <= {item.code for item in deaf.findings}
    assert deaf.loop_model(rig).stiffness == 1.56


def delayed(
    fit: Fit, delay: float, error: float | None = 1e-4, **changes: Any
) -> list[Finding]:
    errors = {} if error is None else {"delay": error}
    changed = replace(fit, delay=delay, standard_errors=errors, **changes)
    return list(delay_findings(changed, solution_of(fit)))


def test_a_delay_is_told_beyond_a_sample_and_four_errors(fit: Fit) -> None:
    assert (
        delayed(fit, 0.0039) == delayed(fit, -0.0039) == []
    )  # within one sample of 4 ms
    late = one(delayed(fit, 0.0041))
    assert (late.code, late.severity) == ("W306", "info")
    assert late.evidence == {"delay": 0.0041, "standard_error": 1e-4}
    early = one(delayed(fit, -0.0041))
    assert (early.code, early.severity) == ("W309", "warning")
    assert delayed(fit, 0.0079, 0.002) == delayed(fit, -0.0079, 0.002) == []
    assert codes(delayed(fit, 0.0081, 0.002)) == ["W306"]
    assert delayed(fit, 0.03, None) == delayed(fit, 0.03, 0.0) == []


def test_sign_and_delay_belong_together(fit: Fit) -> None:
    """A vibration of 10 rad/s has a period of 0.628 s: an eighth of it is 79 ms."""
    turned = one(delayed(fit, 0.078, None, gain=-1.5))
    assert (turned.code, turned.severity, turned.evidence) == (
        "W307",
        "error",
        {"gain": -1.5},
    )
    for delay, ms in ((0.079, "79"), (-0.079, "-79")):
        late = one(delayed(fit, delay, None, gain=-1.5))
        assert (late.code, late.severity) == ("W316", "error")
        half = 1e3 * (delay + CYCLE / 2)
        assert (
            f"{ms} ms late with the opposite sign, or about {half:.3g} ms late"
            in late.message
        )
        assert late.evidence == {
            "delay": delay,
            "vibration_period": pytest.approx(CYCLE),
            "gain": -1.5,
        }
    assert delayed(fit, 0.3, None, gain=1.5, at_bound=("order",)) == []
    limit = one(delayed(fit, 0.2, None, at_bound=("delay",), hold="first"))
    assert (limit.code, limit.severity) == ("W316", "error")
    assert limit.evidence == {"delay": 0.2, "vibration_period": pytest.approx(CYCLE)}
    assert delayed(fit, 0.0, None, at_bound=("delay",), hold="first") == []
    assert delayed(fit, 0.2, None, at_bound=("delay",), hold="zero") == []


# --- the residual -------------------------------------------------------------------------------------------


def test_what_the_residual_holds_is_told(fit: Fit) -> None:
    calm = ResidualTests(0.4, 1.1e-3, 0.02, 1.0)
    assert list(_of_the_residual(replace(fit, tests=calm))) == []
    colour = one(
        _of_the_residual(
            replace(fit, tests=replace(calm, whiteness=1e-5), errors_allow_colour=True)
        )
    )
    assert (colour.code, colour.severity) == ("W305", "info")
    assert colour.evidence == {"p_value": 1e-5, "correlation_time": 0.02}
    motion = one(
        _of_the_residual(replace(fit, tests=replace(calm, input_independence=0.9e-3)))
    )
    assert (motion.code, motion.evidence) == ("W310", {"p_value": 0.9e-3})
    mode = SecondMode(80.0, 0.4, 0.02)
    seen = one(
        _of_the_residual(
            replace(fit, tests=calm, model=replace(fit.model, second_mode=mode))
        )
    )
    assert seen.code == "W321"
    assert seen.evidence == {"frequency": 80.0, "gain": 0.4, "damping_ratio": 0.02}
    assert (
        list(_of_the_residual(replace(fit, tests=replace(calm, whiteness=math.nan))))
        == []
    )


def test_a_few_samples_that_cause_the_error(fit: Fit) -> None:
    count = 2000
    for size, told in ((0.31, True), (0.29, False)):
        # Four of 2000 samples with this share of the squares; beyond the fitted part
        # nothing counts.
        squares = np.full(count + 500, (1 - size) / (count - 4))
        squares[10:14] = size / 4
        squares[count:] = 1e6
        changed = replace(
            fit,
            residual=np.sqrt(squares),
            predicted=np.zeros(count + 500),
            fitted_samples=count,
        )
        found = list(_of_outliers(changed))
        assert codes(found) == ["W312"] * told
    squares[10:14] = 0.5
    worst = one(_of_outliers(replace(changed, residual=np.sqrt(squares))))
    assert worst.evidence["samples"] == 4.0
    assert worst.evidence["share_of_error"] == pytest.approx(
        2.0 / (2.0 + 0.71), rel=1e-2
    )
    assert list(_of_outliers(replace(changed, residual=np.zeros(count + 500)))) == []


# --- a fit in words -----------------------------------------------------------------------------------------


def test_criteria_written_out() -> None:
    assert aic(0.5, 100, 3) == pytest.approx(6.0 + 100 * math.log(0.5))
    assert bic(0.5, 100, 3) == pytest.approx(3 * math.log(100) + 100 * math.log(0.5))
    assert aic(0.0, 100, 3) == bic(0.0, 100, 3) == -math.inf


def test_a_fit_is_printed_with_units_and_errors(fit: Fit) -> None:
    model = LinkModel(1.56, 10.0, order=1.92, unseen_up_to=321.4)
    shown = replace(
        fit, model=model, standard_errors={"order": 0.00123}, delay=0.00321, offset=-0.25, nmse=0.0123,
        heldout_nmse=0.0234, aic=-1234.56, findings=(),
    )  # fmt: skip
    assert str(shown).split("\n") == [
        "UD-FOM: ω₀ = 10 s^(-λ/2), λ = 1.92 ± 0.0012",
        "delay 3.21 ms, offset -0.25; error 1.23 % (NMSE), held-out error 2.34 %; AIC -1234.6",
        "no second mode up to 321.4 rad/s",
    ]
    assert (
        repr(shown)
        == "Fit(UD-FOM: ω₀ = 10 s^(-λ/2), λ = 1.92 ± 0.0012; held-out error 2.34 %)"
    )
    assert "nothing held out" in repr(replace(shown, heldout_nmse=None))
    mode = replace(
        model, second_mode=SecondMode(80.04, 0.4321, 0.0212), unseen_up_to=None
    )
    assert _second_mode(mode) == ["second mode at 80.04 rad/s, gain 0.432, ζ 0.021"]
    assert _second_mode(replace(mode, second_mode=None)) == []


def test_a_natural_frequency_of_zero_is_a_dash_with_its_meaning(fit: Fit) -> None:
    edge = replace(fit, model=LinkModel(1.5, 0.0, damping=81.0, damping_order=0.3))
    assert (frequency_text(edge), frequency_text(fit)) == (
        "–",
        f"{fit.model.natural_frequency:.4f}",
    )
    assert coincidence_text({"UD-FOM": fit}) == []
    (line,) = coincidence_text({"UD-FOM": fit, "D-FOM": edge})
    assert (
        line
        == "– D-FOM ended at ω₀ = 0: it is UD-FOM with λ = 2 − α = 1.7000, ω₀ = √μ = 9.0000."
    )


# --- which structure ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("advantage", "preferred"), [(7.9, None), (-7.9, None), (8.0, "B"), (-8.0, "A")]
)
def test_a_contest_is_decided_at_eight(advantage: float, preferred: str | None) -> None:
    assert Contest("A", "B", advantage).preferred == preferred


CRITERIA = {
    "UD-IOM": (130.0, 90.0),
    "D-IOM": (100.0, 100.0),
    "UD-FOM": (107.0, 120.0),
    "D-FOM": (101.0, 103.0),
}


def test_a_structure_is_left_behind_by_both_criteria() -> None:
    assert _near(CRITERIA) == ["UD-IOM", "D-IOM", "UD-FOM", "D-FOM"]
    assert preferred_structure(CRITERIA) == "UD-IOM"
    behind = CRITERIA | {"UD-IOM": (130.0, 109.0)}
    assert _near(behind) == ["D-IOM", "UD-FOM", "D-FOM"]
    assert preferred_structure(behind) == "D-IOM"
    behind["D-IOM"], behind["UD-FOM"] = (107.9, 130.0), (108.0, 111.0)
    behind["D-FOM"], behind["UD-IOM"] = (100.0, 103.0), (130.0, 111.0)
    assert _near(behind) == ["D-IOM", "D-FOM"]
    behind["UD-FOM"] = (
        107.0,
        100.0,
    )  # as many parameters as D-IOM, and the lower criterion
    assert preferred_structure(behind) == "UD-FOM"


def test_a_gap_is_what_both_criteria_say() -> None:
    assert _gap(CRITERIA, "UD-FOM", "D-IOM") == 7.0
    assert _gap(CRITERIA, "D-IOM", "UD-FOM") == -7.0
    assert _gap(CRITERIA, "UD-IOM", "D-IOM") == 0.0  # they differ
    assert _gap(CRITERIA, "D-FOM", "D-IOM") == 1.0


def test_a_delay_that_explains_the_order_is_told(fit: Fit) -> None:
    late = {"standard_errors": {"delay": 1e-3}, "period": 0.004}
    fits = {
        "D-IOM": replace(fit, structure="D-IOM", aic=-100.0, delay=0.0051, **late),  # type: ignore[arg-type]
        "UD-FOM": replace(fit, aic=-101.9),
    }
    still = {"D-IOM": replace(fit, aic=-50.0), "UD-FOM": replace(fit, aic=-52.1)}
    (sentence,) = _of_the_delay(fits, still)
    order = fit.model.order
    assert f"without it UD-FOM wins (λ = {order:.3f})" in sentence
    assert "with the 5.1 ms that the log shows D-IOM is at least as good" in sentence
    assert _of_the_delay(fits, {}) == []
    assert _of_the_delay(fits, still | {"UD-FOM": replace(fit, aic=-51.9)}) == []
    assert _of_the_delay(fits | {"UD-FOM": replace(fit, aic=-102.1)}, still) == []
    small = replace(fits["D-IOM"], delay=0.0039)
    assert _of_the_delay(fits | {"D-IOM": small}, still) == []
    unsure = replace(fits["D-IOM"], standard_errors={"delay": 0.0018})
    assert _of_the_delay(fits | {"D-IOM": unsure}, still) == []
    assert (
        len(
            _of_the_delay(
                fits | {"D-IOM": replace(fits["D-IOM"], delay=-0.0051)}, still
            )
        )
        == 1
    )


def test_what_the_verdict_says_of_the_order(fit: Fit) -> None:
    plain = replace(
        fit,
        at_bound=(),
        intervals={"order": Interval(1.9, 1.94, False, False)},
        findings=(),
    )
    assert _of_the_parameters({"UD-FOM": plain}) == []
    stuck = replace(plain, at_bound=("order",))
    assert _of_the_parameters({"UD-FOM": stuck}) == [
        "λ is at its bound 2: this log shows no fractional order."
    ]
    open_end = replace(plain, intervals={"order": Interval(1.9, 2.0, False, True)})
    assert _of_the_parameters({"UD-FOM": open_end}) == [
        "λ = 2 is not excluded by this log."
    ]
    both = replace(open_end, at_bound=("order",))
    assert len(_of_the_parameters({"UD-FOM": both})) == 1
    vague = replace(plain, findings=(Finding("W308", "warning", "", {}, ""),))
    assert _of_the_parameters({"UD-FOM": plain, "D-FOM": vague}) == [
        "α is not identifiable."
    ]
