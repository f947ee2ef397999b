"""Diagnosis: each fault put into a good log is found with its figures; a good log gives
no findings.
"""

from __future__ import annotations

import dataclasses
import math
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import chirp

from fraclink import (
    Experiment,
    LinkModel,
    Rig,
    bundled_log,
    prbs,
    read_log,
    smooth_step,
    spline,
)
from fraclink.extend import bundled_logs, simulated_torque
from fraclink.findings import Finding
from fraclink.logs import diagnose
from made_logs import made_experiment, made_motion, made_output
from shared_data import shared_data

RIGS = Path(__file__).parent / "rigs"
GOOD = made_experiment()


def changed(**fields: object) -> Experiment:
    return dataclasses.replace(GOOD, **fields)  # type: ignore[arg-type]


def found(log: Experiment, code: str, rig: Rig | None = None) -> Finding:
    findings = diagnose(log, rig)
    chosen = [finding for finding in findings if finding.code == code]
    assert chosen, f"{code} not among {[str(finding) for finding in findings]}"
    assert chosen[0].remedy
    return chosen[0]


def codes(log: Experiment, *severities: str) -> set[str]:
    return {
        finding.code
        for finding in diagnose(log)
        if not severities or finding.severity in severities
    }


def test_a_good_log_has_no_warning() -> None:
    assert codes(GOOD, "warning", "error") == set()
    mode = next(finding for finding in diagnose(GOOD) if finding.code == "W235")
    assert mode.evidence["frequency"] == pytest.approx(10.0, rel=0.03)
    assert mode.evidence["explained"] > 0.95


@pytest.mark.slow
@pytest.mark.parametrize("name", bundled_logs())
def test_bundled_logs_have_no_error(name: str) -> None:
    findings = diagnose(read_log(bundled_log(name)), Rig.named("paper-2023"))
    assert not [finding for finding in findings if finding.severity == "error"]
    assert "W230" in {finding.code for finding in findings}


@pytest.mark.slow
@pytest.mark.parametrize("frequency", [3.0, 10.0, 25.0])
@pytest.mark.parametrize("damping", [0.005, 0.05, 0.15])
@pytest.mark.parametrize("delay", [0, 3])
def test_the_vibration_is_found_with_its_delay(
    frequency: float, damping: float, delay: int
) -> None:
    _, motor = made_motion(4000)
    output = made_output(motor, frequency=frequency, damping=damping)
    output = np.concatenate((np.zeros(delay), output[: output.size - delay])) + 0.3
    log = Experiment(period=0.004, motor_angle=motor, output=output, payload=0.03)
    mode = next(each.evidence for each in diagnose(log) if each.code == "W235")
    assert mode["frequency"] == pytest.approx(frequency, rel=0.01)
    assert mode["explained"] > 0.8
    if delay:
        late = found(log, "W234").evidence["delay_s"]
        assert late == pytest.approx(0.004 * delay, abs=0.002)


def test_b02_a_motor_that_hardly_moves_is_an_error() -> None:
    log = changed(motor_angle=np.full(2000, 0.3) + 1e-15 * np.arange(2000))
    finding = found(log, "W202")
    assert finding.severity == "error"
    assert "0.3 rad" in finding.message
    assert finding.evidence["standard_deviation"] < 1e-12


def test_b03_a_dead_gauge_is_an_error() -> None:
    assert (
        found(changed(output=np.zeros(2000)), "W202").message
        == "the torque is zero throughout"
    )


def test_b04_fewer_than_three_periods() -> None:
    _, motor = made_motion(2000)
    log = changed(motor_angle=motor, output=made_output(motor, frequency=1.9))
    finding = found(log, "W204")
    assert finding.severity == "error"
    assert finding.evidence["periods"] < 3


def test_b09_degrees_called_radians() -> None:
    finding = found(changed(motor_angle=np.degrees(GOOD.motor_angle)), "W209")
    assert '"deg"' in finding.remedy
    assert finding.severity == "error"


def test_b10_exchanged_columns() -> None:
    finding = found(changed(motor_angle=GOOD.output, output=GOOD.motor_angle), "W210")
    assert finding.severity == "error"
    assert finding.evidence["explained_exchanged"] > 0.8
    assert "exchange" in finding.remedy


def test_b11_reversed_sign() -> None:
    finding = found(changed(output=-GOOD.output), "W211")
    assert finding.severity == "error"
    assert "sign" in finding.remedy


@pytest.mark.parametrize(("factor", "severity"), [(0.3, "info"), (3.0, "warning")])
def test_b12_offset_of_the_gauge(factor: float, severity: str) -> None:
    size = factor * float(GOOD.output.std())
    finding = found(changed(output=GOOD.output + size), "W212")
    assert finding.severity == severity
    assert finding.evidence["offset"] == pytest.approx(size, rel=0.2)


@pytest.mark.parametrize("side", [1, -1])
def test_b13_clipped_samples(side: int) -> None:
    limit = 0.6 * float(np.abs(GOOD.output).max())
    finding = found(
        changed(output=side * np.minimum(side * GOOD.output, limit)), "W213"
    )
    assert finding.evidence["value"] == pytest.approx(side * limit)
    assert finding.evidence["samples"] > 10
    assert f"{100 * finding.evidence['samples'] / 2000:.3g} %" in finding.message
    first = np.flatnonzero(side * GOOD.output >= limit)[0]
    assert finding.evidence["time_s"] == pytest.approx(0.004 * first)


def test_b13_a_coarse_crest_is_not_clipped() -> None:
    # A sine in steps of a twentieth: most samples are at the level of the crest, almost
    # as many at the one below.
    sine = 0.05 * np.round(20 * np.sin(2 * np.pi * np.arange(2000) / 200.3))
    assert "W213" not in codes(changed(output=sine))


def test_b14_coarse_steps() -> None:
    step = float(np.ptp(GOOD.output)) / 12
    finding = found(changed(output=step * np.round(GOOD.output / step)), "W214")
    assert finding.severity == "warning"
    assert finding.evidence["step"] == pytest.approx(step)


def test_b15_few_samples_in_a_period() -> None:
    _, motor = made_motion(3000, 0.004)
    slow = Experiment(
        period=0.08,
        motor_angle=motor[::20],
        output=made_output(motor)[::20],
        payload=0.03,
    )
    longer = np.tile(slow.motor_angle, 3)
    log = dataclasses.replace(
        slow, motor_angle=longer, output=made_output(longer, 0.08)
    )
    finding = found(log, "W215")
    assert finding.evidence["samples_per_period"] == pytest.approx(
        2 * math.pi / 10 / 0.08, rel=0.1
    )
    (longest,) = re.findall(r"below ([\d.]+) ms", finding.remedy)
    assert float(longest) == pytest.approx(1e3 * 2 * math.pi / 10 / 10, rel=0.1)


def test_b16_no_payload() -> None:
    assert found(changed(payload=None), "W216").severity == "warning"


@pytest.mark.slow
def test_b16_a_payload_outside_the_rigs_range() -> None:
    rig = Rig.named("paper-2023")
    for outside in (0.06, 0.01):
        assert found(changed(payload=outside), "W216", rig).evidence["high"] == 0.04
    for inside in (0.02, 0.04):
        assert "W216" not in codes(
            dataclasses.replace(changed(payload=inside), findings=())
        )
        assert "W216" not in {
            finding.code for finding in diagnose(changed(payload=inside), rig)
        }
    assert (
        found(changed(payload=30.0), "W105", Rig.named("paper-2023")).severity
        == "error"
    )


def test_b17_another_period_than_the_rigs() -> None:
    rig = dataclasses.replace(Rig.named("paper-2023"), period=0.002)
    assert found(GOOD, "W217", rig).evidence["log_period_s"] == 0.004
    assert "W217" not in {
        finding.code for finding in diagnose(GOOD, Rig.named("paper-2023"))
    }


def test_b24_outlier_rows() -> None:
    output = GOOD.output.copy()
    output[[500, 900]] *= 100
    output[500] = 100 * float(GOOD.output.std())
    finding = found(changed(output=output), "W224")
    assert finding.severity == "error"
    assert "sample" in finding.message
    assert (
        finding.evidence["value"] == output[round(finding.evidence["time_s"] / 0.004)]
    )


def test_a_log_that_starts_in_motion() -> None:
    cut = slice(260, None)
    log = changed(motor_angle=GOOD.motor_angle[cut], output=GOOD.output[cut])
    assert found(log, "W231").severity == "warning"


def test_a_resonance_that_is_not_excited() -> None:
    noise = np.random.default_rng(3).normal(0, 0.1, 2000)
    assert found(changed(output=noise), "W233").evidence["explained"] < 0.3


def test_a_late_gauge_is_measured() -> None:
    late = np.concatenate((np.zeros(12), GOOD.output[:-12]))
    finding = found(changed(output=late), "W234")
    assert finding.severity == "warning"
    assert finding.evidence["delay_s"] == pytest.approx(0.048, abs=0.004)


def test_merced_is_sensible() -> None:
    rig = Rig.load(RIGS / "merced.toml")
    log = read_log(
        shared_data("quanser_rfl_merced", "merced_rfl.csv"), rig=rig, payload=0.0158
    )
    findings = {finding.code: finding for finding in diagnose(log, rig)}
    assert not [finding for finding in findings.values() if finding.severity == "error"]
    assert findings["W235"].evidence["explained"] > 0.95
    assert findings["W235"].evidence["frequency"] == pytest.approx(21.2, rel=0.02)


@pytest.mark.slow
def test_ist_is_sensible() -> None:
    rig = Rig.load(RIGS / "ist.toml")
    for name in ("2_lab_a15_f10.csv", "2_lab_a10_f04.csv"):
        log = read_log(shared_data("ist_flexbar", name), rig=rig, payload=0.05)
        findings = {finding.code: finding for finding in diagnose(log, rig)}
        assert not [
            finding for finding in findings.values() if finding.severity == "error"
        ]
        assert findings["W235"].evidence["frequency"] == pytest.approx(42.5, rel=0.02)
        assert findings["W212"].evidence["offset"] == pytest.approx(
            math.radians(-0.095 * 1.301), rel=0.1
        )


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("kind", ["prbs", "pulse", "chirp"])
def test_signs_are_judged_right_on_links_of_any_order(kind: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    time = 0.004 * np.arange(5000)
    reference = {
        "prbs": prbs(0.2, float(rng.uniform(0.05, 0.3)), start=0.5),
        "pulse": smooth_step(1.0, 0.05, 0.5).then(smooth_step(-1.0, 0.05, 6.95)),
        "chirp": spline(time[:4501], 0.3 * chirp(time[:4501], 0.2, 18.0, 6.0, phi=-90)),
    }[kind]
    order, frequency = float(rng.uniform(1.75, 2.0)), float(rng.uniform(4, 30))
    if seed % 2:
        model = LinkModel(1.5, frequency ** (order / 2), order=order)
    else:
        damping = 2 * float(rng.uniform(0.01, 0.15)) * frequency
        model = LinkModel(1.5, frequency, order=2.0, damping=damping, damping_order=1.0)
    motor = np.asarray(reference.angle(time), dtype=np.float64)
    torque = (
        simulated_torque(model, motor, 0.004)
        + rng.normal(0, 0.03, 5000)
        + rng.normal(0, 0.1)
    )
    late = int(rng.integers(0, 6))
    torque = np.concatenate((np.full(late, torque[0]), torque[: 5000 - late]))
    good = Experiment(period=0.004, motor_angle=motor, output=torque, payload=0.03)
    assert codes(good, "error") == set()
    assert codes(dataclasses.replace(good, output=-torque), "error") == {"W211"}
