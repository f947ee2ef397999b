"""Logs of the twin: readable, marked as simulated, and the bundled ones are what the
script makes.
"""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest

import fraclink as fl
from fraclink.errors import FieldError, SizeError
from fraclink.extend import Beam, KelvinVoigt, PowerLaw, Sensors, simulate_log

ROOT = Path(__file__).parents[1]
ROD = Beam(0.65, 0.338, 0.00735, 0.030)
STEP = np.concatenate([np.zeros(50), np.full(700, 0.1)])


@pytest.mark.slow
def test_bundled_logs_are_what_the_script_makes():
    path = ROOT / "tools" / "make_logs.py"
    spec = importlib.util.spec_from_file_location("make_logs", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    made = module.build()
    folder = ROOT / "src" / "fraclink" / "data" / "logs"
    assert sorted(made) == sorted(p.name for p in folder.glob("*.csv"))
    for name, text in made.items():
        assert (folder / name).read_bytes() == text.encode(), name
        assert len(text) < 250_000


@pytest.mark.parametrize(
    ("name", "payload"), [("prbs_20g", 0.02), ("prbs_30g", 0.03), ("pulse_30g", 0.03)]
)
def test_bundled_logs_read_back(name, payload):
    log = fl.read_log(
        ROOT / "src/fraclink/data/logs" / f"{name}.csv", rig=fl.Rig.named("paper-2023")
    )
    assert (
        log.simulated and log.payload == payload and log.period == pytest.approx(0.004)
    )
    assert log.motor_angle.size == 5001


def test_a_saved_log_reads_back(tmp_path):
    log = simulate_log(
        ROD, PowerLaw(1.92), STEP, sensors=Sensors(gauge_noise=0.01), seed=4
    )
    log.save(tmp_path / "log.csv")
    text = (tmp_path / "log.csv").read_text(encoding="utf-8")
    assert (
        "# simulated: true\n" in text
        and "# payload_kg: 0.030\n" in text
        and "# seed: 4\n" in text
    )
    back = fl.read_log(tmp_path / "log.csv", rig=fl.Rig.named("paper-2023"))
    assert back.motor_angle == pytest.approx(log.motor_angle, rel=1e-8, abs=1e-12)
    assert back.output == pytest.approx(log.torque, rel=1e-8, abs=1e-12)
    assert back.payload == 0.030 and back.simulated


def test_sensors_do_what_they_say():
    clean = simulate_log(ROD, PowerLaw(1.92), STEP)
    assert np.array_equal(clean.torque, clean.true_torque)
    sensors = Sensors(gauge_offset=0.1, gauge_drift=0.02, gauge_limit=0.15)
    dirty = simulate_log(ROD, PowerLaw(1.92), STEP, sensors=sensors)
    assert dirty.torque == pytest.approx(
        np.clip(clean.torque + 0.1 + 0.02 * clean.time, -0.15, 0.15)
    )
    noisy = simulate_log(
        ROD, PowerLaw(1.92), STEP, sensors=Sensors(gauge_noise=0.05), seed=1
    )
    assert np.std(noisy.torque - clean.torque) == pytest.approx(0.05, rel=0.1)
    late = simulate_log(ROD, PowerLaw(1.92), STEP, sensors=Sensors(gauge_delay=0.008))
    assert late.torque[2:] == pytest.approx(clean.torque[:-2], abs=1e-12)


def test_a_delay_between_two_steps_is_interpolated():
    frequency = (
        2 * np.pi / 0.4
    )  # 100 samples a period, so that a sum over periods is a Fourier coefficient
    reference = 0.2 * np.sin(frequency * 0.004 * np.arange(1501))
    phases = []
    for delay in (0.0, 0.0023, 0.0123):
        log = simulate_log(
            ROD, KelvinVoigt(0.01), reference, sensors=Sensors(gauge_delay=delay)
        )
        phases.append(
            np.angle(
                log.torque[800:1500] @ np.exp(-1j * frequency * log.time[800:1500])
            )
        )
    assert phases[0] - phases[1] == pytest.approx(frequency * 0.0023, abs=1e-4)
    assert phases[0] - phases[2] == pytest.approx(frequency * 0.0123, abs=1e-4)


def test_the_gauges_gain_scales_the_torque_and_not_its_offset():
    plain = simulate_log(
        ROD, KelvinVoigt(0.01), STEP, sensors=Sensors(gauge_offset=0.1)
    )
    scaled = simulate_log(
        ROD, KelvinVoigt(0.01), STEP, sensors=Sensors(gauge_offset=0.1, gauge_gain=-2.0)
    )
    assert scaled.torque - 0.1 == pytest.approx(-2.0 * (plain.torque - 0.1), abs=1e-12)
    assert scaled.header["gauge_gain"] == "-2"


def test_servo_is_equation_21():
    log = simulate_log(ROD, KelvinVoigt(0.01), STEP)
    t = np.maximum(log.time - 50 * 0.004, 0.0)
    assert log.motor_angle == pytest.approx(
        0.1 * (1 - (1 + 80 * t) * np.exp(-80 * t)), abs=1e-12
    )


def test_a_start_away_from_zero_is_at_rest():
    log = simulate_log(ROD, PowerLaw(1.92), np.full(100, 0.3))
    assert np.all(log.torque == 0.0) and np.all(log.tip_angle == 0.3)


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"period": 0.0}, "period"),
        ({"period": float("nan")}, "period"),
        ({"modes": 9}, "modes"),
        ({"step": 0.002}, "step"),
    ],
)
def test_bad_settings(changes, field):
    with pytest.raises(FieldError) as caught:
        simulate_log(ROD, PowerLaw(1.92), STEP, **changes)
    assert caught.value.field == field


@pytest.mark.parametrize(
    "reference", [[1.0], [[0.0, 1.0]], [0.0, np.nan], [0.0, np.inf, 1.0]]
)
def test_bad_references(reference):
    with pytest.raises(FieldError, match="reference"):
        simulate_log(ROD, PowerLaw(1.92), reference)


@pytest.mark.slow
def test_a_log_of_a_month_is_refused_before_memory_is_taken():
    huge = np.broadcast_to(0.0, 600_000_000)
    with pytest.raises(SizeError, match="too long"):
        simulate_log(ROD, PowerLaw(1.92), huge)
