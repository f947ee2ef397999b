"""Where a finding of the diagnosis begins and how grave it is: just below, at and just
above each bound.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable

import numpy as np
import pytest

from fraclink._arm.experiment import Experiment
from fraclink._arm.rig import Gauge, Rig
from fraclink._reading.columns import converter_step
from fraclink.findings import Finding
from fraclink.logs import _channels as channels
from fraclink.logs import _diagnosis as diagnosis
from fraclink.logs._channels import Mode

RIG = Rig.named("paper-2023")
MODE = Mode(
    frequency=10.0, damping_ratio=0.02, gain=1.5, delay=0.0, share=0.9, residual=0.01
)
NOISE = np.random.default_rng(1).normal(0, 1, (2, 1000))


def log(**changed: object) -> Experiment:
    """A thousand samples of noise, 4 s long, in which one thing is changed."""
    plain = Experiment(
        period=0.004, motor_angle=0.1 * NOISE[0], output=0.3 * NOISE[1], payload=0.03
    )
    return dataclasses.replace(plain, **changed)  # type: ignore[arg-type]


def told(findings: Iterable[Finding]) -> list[tuple[str, str]]:
    return [(finding.code, finding.severity) for finding in findings]


def of_mode(
    reverse: Mode | None = None, period: float = 0.004, **changed: float
) -> list[Finding]:
    mode = dataclasses.replace(MODE, **changed)
    return list(diagnosis.mode_findings(log(period=period), mode, reverse))


# --- the vibration ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("share", "found"),
    [
        (0.29, ("W233", "warning")),
        (0.3, ("W235", "warning")),
        (0.6, ("W235", "warning")),
        (0.61, ("W235", "info")),
    ],
)
def test_how_much_of_the_output_a_mode_explains(
    share: float, found: tuple[str, str]
) -> None:
    (finding,) = of_mode(share=share)
    assert (finding.code, finding.severity) == found
    assert finding.evidence["explained"] == share
    assert bool(finding.remedy) == (found[1] == "warning")


def test_the_mode_is_told_in_its_numbers() -> None:
    (finding,) = of_mode()
    assert finding.message == "a mode at 10 rad/s explains 90 % of the output"
    assert finding.evidence == {
        "frequency": 10.0,
        "damping_ratio": 0.02,
        "explained": 0.9,
    }


@pytest.mark.parametrize(
    ("reverse", "share", "swapped"),
    [
        (0.81, 0.4, True),
        (0.8, 0.39, False),
        (0.9, 0.44, True),
        (0.9, 0.45, False),
        (None, 0.4, False),
    ],
)
def test_exchanged_columns_explain_twice_as_much(
    reverse: float | None, share: float, swapped: bool
) -> None:
    other = None if reverse is None else dataclasses.replace(MODE, share=reverse)
    assert (told(of_mode(other, share=share))[0] == ("W210", "error")) == swapped


def test_a_negative_gain_is_the_wrong_sign() -> None:
    findings = of_mode(gain=-1.5)
    assert told(findings) == [("W235", "info"), ("W211", "error")]
    assert findings[1].evidence == {"gain": -1.5, "explained": 0.9}
    assert "the torque has the wrong sign" in findings[1].message
    assert told(of_mode(gain=1e-9)) == [("W235", "info")]


@pytest.mark.parametrize(
    ("periods", "found"),
    [(2.99, [("W235", "info"), ("W204", "error")]), (3.01, [("W235", "info")])],
)
def test_three_periods_are_needed(periods: float, found: list[tuple[str, str]]) -> None:
    duration = log().duration  # of 1000 samples: 999 steps of 4 ms
    assert duration == pytest.approx(3.996)
    findings = of_mode(frequency=2 * math.pi * periods / duration)
    assert told(findings) == found
    if len(findings) > 1:
        assert findings[1].evidence["periods"] == pytest.approx(periods)
        assert findings[1].evidence["period_of_vibration_s"] == pytest.approx(
            duration / periods
        )


@pytest.mark.parametrize(
    ("samples", "severity"),
    [(10.01, None), (9.99, "warning"), (4.01, "warning"), (3.99, "error")],
)
def test_ten_samples_a_period_are_wanted_and_four_needed(
    samples: float, severity: str | None
) -> None:
    findings = of_mode(frequency=2 * math.pi / (samples * 0.004))
    assert told(findings[1:]) == ([] if severity is None else [("W215", severity)])
    if severity:
        assert findings[1].evidence == {
            "samples_per_period": pytest.approx(samples),
            "period_s": 0.004,
        }
        assert (
            findings[1].remedy == f"record with a period below {samples * 0.4:.3g} ms"
        )


@pytest.mark.parametrize(
    ("delay", "severity"),
    [(0.002, None), (0.0021, "info"), (0.0174, "info"), (0.0176, "warning")],
)
def test_a_delay_counts_from_half_a_sample_and_misleads_from_ten_degrees(
    delay: float, severity: str | None
) -> None:
    findings = of_mode(delay=delay)  # at 10 rad/s ten degrees are 17.45 ms
    assert told(findings[1:]) == ([] if severity is None else [("W234", severity)])
    if severity:
        wanted = {"delay_s": delay, "samples": delay / 0.004, "phase": 10.0 * delay}
        assert findings[1].evidence == pytest.approx(wanted)
        assert (
            f"{1e3 * delay:.3g} ms ({math.degrees(10 * delay):.2g}°"
            in findings[1].message
        )


def test_a_log_without_a_mode_says_how_short_it_is() -> None:
    (finding,) = diagnosis.mode_findings(log(), None, None)
    assert finding.evidence == {"samples": 1000, "duration_s": pytest.approx(3.996)}


# --- one channel --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("ratio", "found"),
    [(0.1, []), (0.11, ["info"]), (0.5, ["info"]), (0.51, ["warning"])],
)
def test_an_offset_is_told_from_a_tenth_of_the_motion(
    ratio: float, found: list[str]
) -> None:
    rest = log(
        output=np.concatenate([np.zeros(300), 0.3 * NOISE[1][300:]]) + ratio,
        motor_angle=np.zeros(1000),
    )
    findings = [
        each for each in channels.rest_at_start(rest, ratio, 1.0) if each.code == "W212"
    ]
    assert [finding.severity for finding in findings] == found
    for finding in findings:
        assert (
            f"an offset of {ratio:.4g} N·m, {100 * ratio:.3g} % of the motion"
            in finding.message
        )
        assert finding.evidence == {"offset": ratio, "motion": 1.0}


def test_an_offset_of_a_log_without_motion_is_a_warning() -> None:
    found = [
        each.severity
        for each in channels.rest_at_start(log(), 0.001, 0.0)
        if each.code == "W212"
    ]
    assert found == ["warning"]


def test_the_motion_is_what_the_mode_s_residual_leaves() -> None:
    experiment = log(output=0.3 * NOISE[1] + 0.2)
    mean, spread = float(experiment.output.mean()), float(experiment.output.std())
    assert diagnosis._offset(experiment, None) == (mean, pytest.approx(spread))
    offset, motion = diagnosis._offset(
        experiment, dataclasses.replace(MODE, residual=0.6 * spread)
    )
    assert (offset, motion) == (mean, pytest.approx(0.8 * spread))
    # A residual as large as the signal leaves no motion to divide by: the signal itself
    # stands for it.
    assert diagnosis._offset(experiment, dataclasses.replace(MODE, residual=spread))[
        1
    ] == pytest.approx(spread)


@pytest.mark.parametrize(
    ("turn", "found"), [(2 * math.pi, []), (6.2832, [("W209", "error")])]
)
def test_more_than_a_turn_from_the_first_sample(
    turn: float, found: list[tuple[str, str]]
) -> None:
    angle = np.linspace(5.0, 5.0 + turn, 1000)
    angle[-1] = 5.0 + turn * (1 - 1e-15)
    findings = list(channels.range_of_angle(log(motor_angle=angle)))
    assert told(findings) == found
    if findings:
        wanted = {"largest_angle": turn, "if_degrees": math.radians(turn)}
        assert findings[0].evidence == pytest.approx(wanted)


@pytest.mark.parametrize(("factor", "count"), [(7.9, 0), (8.1, 1)])
@pytest.mark.parametrize("sign", [1, -1])
def test_an_outlier_is_eight_times_the_range_away(
    factor: float, count: int, sign: int
) -> None:
    values = np.linspace(-1, 1, 1001)
    values[400] = 0.0
    low, high = np.quantile(values, (0.005, 0.995))
    values[400] = sign * factor * max(high, -low)
    findings = list(
        channels.outliers(
            log(output=values[:1001], motor_angle=np.linspace(-1, 1, 1001))
        )
    )
    assert len(findings) == count
    if count:
        (finding,) = findings
        assert finding.severity == "error"
        assert finding.message == "1 outliers in the torque, the largest at sample 400"
        assert finding.evidence["outliers"] == 1 and finding.evidence[
            "time_s"
        ] == pytest.approx(1.6)
        assert finding.evidence["value"] == values[400]
        assert finding.evidence["median"] == pytest.approx(0.0, abs=0.01)


def test_both_channels_are_looked_at_for_outliers_and_dead_signals() -> None:
    spiked = np.concatenate([NOISE[0, :-1], [1000.0]])
    findings = list(channels.outliers(log(motor_angle=spiked, output=spiked)))
    assert [finding.message.split(",")[0] for finding in findings] == [
        "1 outliers in the motor angle", "1 outliers in the torque"
    ]  # fmt: skip
    dead = log(
        motor_angle=np.full(1000, 0.25), output=np.zeros(1000), output_kind="deflection"
    )
    assert [str(each.message) for each in channels.constant_channels(dead)] == [
        "the motor angle is constant at 0.25 rad",
        "the deflection is zero throughout",
    ]
    assert told(diagnosis.diagnose(dead)) == [("W202", "error"), ("W203", "error")]


@pytest.mark.parametrize(("spread", "dead"), [(0.9e-9, True), (1.1e-9, False)])
def test_a_channel_is_dead_below_a_billionth_of_its_value(
    spread: float, dead: bool
) -> None:
    values = 2.0 + 2.0 * spread * np.tile([1.0, -1.0], 500)
    assert told(channels.constant_channels(log(output=values))) == (
        [("W203", "error")] if dead else []
    )


@pytest.mark.parametrize("signed", [1, -1])
@pytest.mark.parametrize(
    ("at", "inside", "clipped"),
    [(6, 1, True), (5, 1, False), (30, 7, True), (28, 7, False)],
)
def test_samples_that_pile_up_at_the_end_of_the_range(
    signed: int, at: int, inside: int, clipped: bool
) -> None:
    """More than half a percent, and more than four times as many as one step inside."""
    values = np.tile(np.arange(20.0), 50)  # steps of 1
    values[values >= 18] = 0.0
    values[100 : 100 + at] = 19.0
    values[200 : 200 + inside] = 18.0
    assert converter_step(values) == 1.0
    findings = list(channels.clipping(log(output=signed * values), None))
    findings = [
        finding for finding in findings if finding.evidence["value"] == 19.0 * signed
    ]
    assert told(findings) == ([("W213", "warning")] if clipped else [])
    if clipped:
        assert findings[0].evidence == {
            "value": 19.0 * signed,
            "samples": at,
            "time_s": pytest.approx(0.4),
        }
        side = "largest" if signed > 0 else "smallest"
        assert (
            f"{100 * at / 1000:.3g} % of the samples lie at the {side} output"
            in findings[0].message
        )


def test_a_known_limit_of_the_gauge_is_reached_at_99_percent() -> None:
    rig = dataclasses.replace(RIG, gauge=Gauge(limit=2.0))
    values = 0.3 * NOISE[1]
    values[[500, 600]] = -1.98, 1.979
    (finding,) = [
        each
        for each in channels.clipping(log(output=values), rig)
        if "limit" in each.evidence
    ]
    assert finding.evidence == {"limit": 2.0, "samples": 1, "time_s": 2.0}
    assert not list(
        channels.clipping(log(output=values, output_kind="deflection"), rig)
    )


def test_the_amplifier_is_at_its_limit_at_99_percent() -> None:
    limit = RIG.motor.voltage_limit
    voltage = np.zeros(1000)
    voltage[[250, 750]] = -0.99 * limit, limit
    voltage[800] = 0.989 * limit
    (finding,) = channels.voltage_limit(log(voltage=voltage), RIG)
    assert finding.evidence == {"limit": limit, "share": 0.002, "time_s": 1.0}
    assert not [
        *channels.voltage_limit(log(voltage=voltage), None),
        *channels.voltage_limit(log(), RIG),
    ]
    free = dataclasses.replace(
        RIG, motor=dataclasses.replace(RIG.motor, voltage_limit=math.inf)
    )
    assert not list(channels.voltage_limit(log(voltage=voltage), free))


@pytest.mark.parametrize(
    ("levels", "severity"),
    [(49, "warning"), (50, "info"), (20_000, "info"), (20_001, None)],
)
def test_steps_are_coarse_below_fifty_levels(levels: int, severity: str | None) -> None:
    """And beyond 14 bits they are those of the numbers' text."""
    values = np.repeat(0.25 * np.arange(levels + 1.0), 2)
    experiment = log(output=values, motor_angle=np.linspace(0, 1, values.size))
    findings = list(channels.quantisation(experiment, None))
    assert [finding.severity for finding in findings] == (
        [] if severity is None else [severity]
    )
    for finding in findings:
        assert finding.evidence == {
            "step": 0.25,
            "levels": levels,
            "noise_of_steps": 0.25 / math.sqrt(12),
        }
        assert finding.message == f"the torque has steps of 0.25 N·m: {levels} levels"


def test_steps_are_coarse_where_they_exceed_what_the_mode_leaves() -> None:
    values = 0.01 * np.round(100 * 0.3 * NOISE[1])
    for residual, severity in ((0.0049, "warning"), (0.0051, "info")):
        mode = dataclasses.replace(MODE, residual=residual)
        (finding,) = channels.quantisation(log(output=values), mode)
        assert (finding.severity, finding.evidence["step"]) == (
            severity,
            pytest.approx(0.01),
        )
    coarse = 0.001 * np.round(
        1000 * 0.1 * NOISE[0]
    )  # of the angle the mode's residual says nothing
    (finding,) = channels.quantisation(
        log(motor_angle=coarse), dataclasses.replace(MODE, residual=1e-5)
    )
    assert (
        finding.severity == "info"
        and "the motor angle has steps of 0.001 rad" in finding.message
    )


# --- what the log says of itself ---------------------------------------------------------------------------


def test_the_rig_s_period_may_differ_by_one_percent() -> None:
    for ratio, found in (
        (1.009, []),
        (1.011, ["W217"]),
        (0.991, []),
        (0.989, ["W217"]),
    ):
        experiment = log(period=RIG.period * ratio)
        findings = list(channels.labels(experiment, RIG))
        assert [finding.code for finding in findings] == found
        for finding in findings:
            wanted = {"log_period_s": RIG.period * ratio, "rig_period_s": RIG.period}
            assert finding.evidence == pytest.approx(wanted)
            assert (
                f"a sample every {4 * ratio:.4g} ms, the rig's law runs every 4 ms"
                in finding.message
            )


@pytest.mark.parametrize(
    ("payload", "found"),
    [(0.02, []), (0.04, []), (0.0199, ["info"]), (0.0401, ["info"])],
)
def test_a_payload_beyond_the_rig_s(payload: float, found: list[str]) -> None:
    findings = list(channels.labels(log(payload=payload), RIG))
    assert [finding.severity for finding in findings] == found
    for finding in findings:
        assert finding.evidence == {"payload": payload, "low": 0.02, "high": 0.04}
    assert told(channels.labels(log(payload=None), RIG)) == [("W216", "warning")]


# --- stiction -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("held", "found"), [(10, None), (40, "info"), (300, "warning")]
)
def test_a_standstill_under_voltage(held: int, found: str | None) -> None:
    """The motor runs at 1 rad/s but for `held` samples of 4 ms, in which 0.5 V do not
    move it.
    """
    speed, voltage = np.ones(1000), np.full(1000, 2.0)
    speed[400 : 400 + held] = 0.0
    voltage[400 : 400 + held] = 0.5
    angle = 0.001 * np.round(4.0 * np.cumsum(speed))
    findings = list(diagnosis.stiction(log(motor_angle=angle, voltage=voltage)))
    assert [finding.severity for finding in findings] == (
        [] if found is None else [found]
    )
    for finding in findings:
        # Seen as a standstill is what does not move within 50 ms, 12 samples: half of
        # them at each end.
        assert finding.evidence["longest_s"] == pytest.approx(
            0.004 * (held - 12), abs=0.009
        )
        assert finding.evidence["time_s"] == pytest.approx(0.004 * 406, abs=0.009)
        assert finding.evidence["share"] == pytest.approx((held - 12) / 1000, abs=0.003)
        assert finding.evidence["voltage"] == 0.5


def test_an_idle_amplifier_does_not_drive() -> None:
    voltage = np.full(1000, 0.03)
    voltage[:100] = 2.0
    angle = np.concatenate([0.001 * np.arange(100.0), np.full(900, 0.1)])
    assert not list(diagnosis.stiction(log(motor_angle=angle, voltage=voltage)))
    voltage[100:] = 0.05  # more than two percent of the largest
    assert told(diagnosis.stiction(log(motor_angle=angle, voltage=voltage))) == [
        ("W232", "warning")
    ]
    assert not list(diagnosis.stiction(log(motor_angle=angle, voltage=np.zeros(1000))))


# --- steps of a converter ---------------------------------------------------------------------------------


def test_the_step_of_a_converter_is_the_smallest_gap_that_is_no_rounding() -> None:
    levels = 0.5 * np.repeat(np.arange(10.0), 10)
    assert converter_step(levels) == 0.5
    rounded = levels + 1e-6 * (np.arange(100) == 7)  # one cell with another last digit
    assert converter_step(rounded) == pytest.approx(0.5, rel=1e-5)
    assert converter_step(np.arange(100.0)) == 0.0  # nothing repeats: continuous
    assert (
        converter_step(np.repeat(np.arange(50.0), 2)) == 1.0
    )  # half of the values are distinct
    assert (
        converter_step(np.concatenate([np.repeat(np.arange(49.0), 2), [98.0, 99.0]]))
        == 0.0
    )
    assert converter_step(np.full(100, 3.0)) == 0.0
