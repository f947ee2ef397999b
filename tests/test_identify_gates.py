"""The gates of identification: logs that must not give a model for a design, and logs
that must.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from fraclink import Experiment, LinkModel, Rig, identify, identify_motor, prbs
from fraclink.errors import FraclinkError, LogError
from fraclink.extend import simulated_torque
from identify_cases import PERIOD, TRUTH
from made_logs import example_motor_log

Array = NDArray[np.float64]
COUNT = 4001
TIME = PERIOD * np.arange(COUNT)
ANGLE = prbs(0.3, 0.2, bits=78, register=9, start=0.2).angle(TIME)
ANGLE = np.asarray(lfilter([0.1], [1, -0.9], ANGLE))
TORQUE = simulated_torque(TRUTH, ANGLE, PERIOD, delay=0.004)
RANDOM = np.random.default_rng(7)
WHITE = RANDOM.normal(0, 1, COUNT)
SLOW = np.asarray(lfilter([0.0199**0.5], [1, -0.98], RANDOM.normal(0, 1, 5 * COUNT)))[
    -COUNT:
]
RING = np.asarray(np.clip((TIME - 0.5) / 0.2, 0, 1))


def log(
    angle: Array = ANGLE, output: Array | None = None, **options: object
) -> Experiment:
    values = TORQUE + 0.02 * WHITE if output is None else output
    return Experiment(period=PERIOD, motor_angle=angle, output=values, **options)  # type: ignore[arg-type]


def rolled(seconds: float) -> Array:
    return np.roll(TORQUE, round(seconds / PERIOD))


def slipped() -> Array:
    light = simulated_torque(replace(TRUTH, natural_frequency=22.0), ANGLE, PERIOD)
    return np.where(TIME < 9.0, TORQUE, light) + 0.02 * WHITE


def saturated(share: float) -> Array:
    return np.asarray(np.clip(TORQUE, -share * TORQUE.std(), share * TORQUE.std()))


DEFLECTION = TORQUE / 1.56
# name -> the log, and the finding it must give: its code and a part of its text
BAD: dict[str, tuple[Callable[[], Experiment], str, str]] = {
    # --- units, scale and sign
    "deflection in degrees": (
        lambda: log(output=np.rad2deg(DEFLECTION), output_kind="deflection"),
        "W320",
        "not a deflection in rad",
    ),
    "torque as deflection": (
        lambda: log(output=TORQUE, output_kind="deflection"),
        "W320",
        "not a deflection in rad",
    ),
    "angle in degrees, torque": (
        lambda: log(np.rad2deg(ANGLE)),
        "W209",
        "degrees labelled as radians",
    ),
    "torque with the other sign": (
        lambda: log(output=-TORQUE),
        "W211",
        "opposite sign",
    ),
    "deflection with the other sign": (
        lambda: log(output=-DEFLECTION, output_kind="deflection"),
        "W211",
        "opposite sign",
    ),
    # --- wrong columns
    "the angle twice": (
        lambda: log(output=ANGLE),
        "W324",
        "the motor's angle times a constant",
    ),
    "the speed as torque": (
        lambda: log(output=np.gradient(ANGLE, PERIOD)),
        "W324",
        "the motor's speed times",
    ),
    "the time as torque": (
        lambda: log(output=TIME.copy()),
        "W324",
        "the output grows steadily with time",
    ),
    "the time as angle": (
        lambda: log(TIME.copy()),
        "W324",
        "the motor angle grows by one step",
    ),
    "the reference as torque": (
        lambda: log(output=np.sign(ANGLE)),
        "W213",
        "a command, not a measurement",
    ),
    "a counter as torque": (
        lambda: log(output=np.arange(COUNT) % 256.0),
        "W324",
        "a clock, a counter",
    ),
    "another log's torque": (
        lambda: log(output=TORQUE[::-1].copy()),
        "W313",
        "hardly better than a constant",
    ),
    "channels two seconds apart": (
        lambda: log(output=rolled(2.0)),
        "W313",
        "both channels are of one recording",
    ),
    "channels half a second apart": (
        lambda: log(output=rolled(0.5)),
        "W316",
        "half a vibration more",
    ),
    # --- no signal
    "noise alone": (
        lambda: log(output=WHITE),
        "W313",
        "check that the gauge is connected",
    ),
    "slow noise alone": (
        lambda: log(output=SLOW),
        "W313",
        "check that the gauge is connected",
    ),
    "mains hum alone": (
        lambda: log(output=np.sin(2 * np.pi * 50 * TIME) + 0.1 * WHITE),
        "W313",
        "shielded from mains hum",
    ),
    "an amplifier's drift": (
        lambda: log(output=0.1 * TIME + 0.02 * WHITE),
        "W324",
        "the drift of an amplifier",
    ),
    "vibration under the noise": (
        lambda: log(output=TORQUE + 30 * TORQUE.std() * WHITE),
        "W313",
        "or move further",
    ),
    # --- no excitation
    "a motor that creeps": (
        lambda: log(0.02 * TIME, 0.02 * WHITE),
        "W324",
        "a speed that excites nothing",
    ),
    "a link too stiff to vibrate": (
        lambda: log(
            output=1e-3 * np.gradient(np.gradient(ANGLE, PERIOD), PERIOD) + 0.02 * WHITE
        ),
        "W324",
        "a stiff link needs faster moves",
    ),
    # --- an arm that changes
    "a payload that slips": (
        lambda: log(output=slipped()),
        "W318",
        "a payload that slipped",
    ),
    "a gauge that dies": (
        lambda: log(output=np.where(TIME < 9.0, TORQUE, 0.0) + 0.02 * WHITE),
        "W318",
        "a cable that came off",
    ),
    "a gauge that drifts away": (
        lambda: log(output=TORQUE + np.maximum(TIME - 8.0, 0.0) * 3 * TORQUE.std()),
        "W318",
        "a gauge that drifts",
    ),
    "a gauge hard at its stops": (
        lambda: log(output=saturated(0.05)),
        "W213",
        "the amplifier saturates",
    ),
    "a motor that stops, and noise": (
        lambda: log(np.where(TIME < 0.3, ANGLE, ANGLE[75]), 0.2 * WHITE),
        "W313",
        "hardly better than a constant",
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", BAD)
def test_a_bad_log_gives_no_model_that_passes_and_says_why(name: str) -> None:
    make, code, part = BAD[name]
    fit = identify(make())
    errors = [finding for finding in fit.findings if finding.severity == "error"]
    assert not fit.passed
    assert all(finding.remedy and finding.evidence for finding in errors)
    said = [str(finding) for finding in errors if finding.code == code]
    assert any(part in sentence for sentence in said), "\n".join(map(str, errors))


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["noise alone", "slow noise alone", "channels two seconds apart"]
)
def test_of_noise_neither_sign_nor_delay_is_said(name: str) -> None:
    fit = identify(BAD[name][0]())
    assert not {"W306", "W211", "W309", "W316"} & {
        finding.code for finding in fit.findings
    }


@pytest.mark.slow
def test_a_few_samples_at_the_stops_are_no_gate() -> None:
    few, many = (identify(log(output=saturated(share))) for share in (2.0, 1.5))
    assert abs(few.gain / 1.56 - 1) < 0.01
    assert few.passed
    assert abs(many.gain / 1.56 - 1) > 0.05
    assert not many.passed


@pytest.mark.slow
def test_a_log_cut_in_mid_motion_says_so_and_one_at_rest_does_not() -> None:
    """The vibration from before the cut is not in the model: here the delay is wrong by
    4 ms.
    """
    late = int(np.flatnonzero(np.diff(ANGLE) != 0)[0]) + 600
    cut = identify(log(ANGLE[late:], (TORQUE + 0.02 * WHITE)[late:]))
    (begins,) = (item for item in cut.findings if item.code == "W231")
    assert (
        begins.severity == "warning"
        and "the link is bent" in begins.message
        and "keep" in begins.remedy
    )
    residual = cut.residual[: cut.fitted_samples] ** 2
    first = residual[: round(float(begins.evidence["time"]) / PERIOD)]
    assert begins.evidence["first_mse"] == pytest.approx(first.mean())
    assert first.mean() > 2 * residual[first.size :].mean()
    whole = identify(log())
    assert "W231" not in {item.code for item in whole.findings}
    assert abs(cut.delay - 0.004) > 2 * abs(whole.delay - 0.004)


@pytest.mark.slow
@pytest.mark.parametrize("late", [300, 600, 1100])
def test_a_log_that_knows_the_angle_before_its_cut_is_fitted_as_the_whole_one(
    late: int,
) -> None:
    late += int(np.flatnonzero(np.diff(ANGLE) != 0)[0])
    found = identify(
        log(ANGLE[late:], (TORQUE + 0.02 * WHITE)[late:], earlier_angle=ANGLE[:late])
    )
    assert "W231" not in {item.code for item in found.findings}
    for name, truth in (
        ("delay", 0.004),
        ("natural_frequency", 10.02),
        ("order", 1.92),
    ):
        interval = found.intervals[name]
        spare = 0.3 * (
            interval.high - interval.low
        )  # 2.6 standard errors: one noise, nine intervals
        assert interval.low - spare < truth < interval.high + spare, name
    # The model of the cut log, driven by the whole angle, reproduces the prediction.
    again = (
        simulated_torque(found.model, ANGLE, PERIOD, delay=found.delay)[late:]
        + found.offset
    )
    # each grid of rates has its own error
    assert np.allclose(found.predicted, again, rtol=0, atol=3e-7)
    assert found.samples == ANGLE.size - late and found.fitted_samples < found.samples


@pytest.mark.slow
def test_a_good_log_passes_every_gate() -> None:
    for noise in (0.0, 0.02 * WHITE, 0.02 * SLOW):
        assert identify(log(output=TORQUE + noise)).passed
        deflection = log(output=(TORQUE + noise) / 1.56, output_kind="deflection")
        assert identify(deflection, stiffness=1.56).passed


@pytest.mark.slow
def test_a_quiet_end_is_not_what_is_held_out() -> None:
    torque = simulated_torque(TRUTH, RING, PERIOD)
    fit = identify(log(RING, torque + 0.02 * WHITE))
    assert fit.passed
    assert "W317" in {finding.code for finding in fit.findings}
    assert fit.heldout_nmse is not None
    assert fit.heldout_nmse < 0.5
    quiet = identify(log(RING, torque + 0.02 * WHITE), heldout=0.4)
    assert not quiet.passed
    assert quiet.findings[0].code == "W317"


def test_motion_that_comes_late_is_on_both_sides() -> None:
    late = np.asarray(
        0.3 * np.clip((TIME - 11) / 0.2, 0, 1)
        - 0.3 * np.clip((TIME - 13.5) / 0.2, 0, 1)
    )
    fit = identify(log(late, simulated_torque(TRUTH, late, PERIOD) + 0.005 * WHITE))
    assert fit.passed
    assert 11 / PERIOD < fit.fitted_samples < 13.5 / PERIOD


@pytest.mark.slow
def test_what_was_identified_travels_with_the_model() -> None:
    fit = identify(log())
    assert fit.model.gauge_delay == fit.delay == pytest.approx(0.004, abs=5e-4)
    assert fit.model.gauge_gain == 1.0
    assert fit.model.interval("gauge_delay") == (
        fit.intervals["delay"].low,
        fit.intervals["delay"].high,
    )
    assert fit.model.interval("order") == (
        fit.intervals["order"].low,
        fit.intervals["order"].high,
    )
    low, high = fit.model.interval("stiffness") or (0.0, 0.0)
    assert low < 1.56 < high
    deflection = identify(
        log(output=1.1 * DEFLECTION, output_kind="deflection"), stiffness=1.56
    )
    assert deflection.model.gauge_gain == pytest.approx(1.1, rel=1e-2)
    assert deflection.model.stiffness == 1.56


@pytest.mark.slow
@pytest.mark.parametrize("frequency", [80.0, 190.0, 400.0])
@pytest.mark.parametrize("ratio", [0.005, 0.03])
def test_a_second_mode_is_found_and_measured(frequency: float, ratio: float) -> None:
    second = LinkModel(1.0, frequency, damping=2 * ratio * frequency)
    share = 30.0 / frequency
    both = TORQUE + 1.56 * share * simulated_torque(second, ANGLE, PERIOD, delay=0.004)
    for noise in (WHITE, SLOW):
        mode = identify(log(output=both + 0.005 * noise)).model.second_mode
        assert mode is not None
        assert mode.frequency == pytest.approx(frequency, rel=0.03)
        assert mode.gain == pytest.approx(share, rel=0.3)
        assert mode.damping_ratio == pytest.approx(ratio, rel=0.5, abs=0.003)


@pytest.mark.slow
def test_no_second_mode_is_said_with_the_band_that_was_searched() -> None:
    for noise in (0.01 * WHITE, 0.01 * SLOW):
        model = identify(log(output=TORQUE + noise)).model
        assert model.second_mode is None
        assert model.unseen_up_to is not None
        assert 50.0 < model.unseen_up_to <= 0.8 * np.pi / PERIOD
    loud = identify(log(output=TORQUE + 0.5 * WHITE)).model
    assert loud.unseen_up_to is None or loud.unseen_up_to < model.unseen_up_to


@pytest.mark.slow
@pytest.mark.parametrize("channel", ["voltage", "angle"])
def test_a_motor_with_impossible_signs_is_refused(channel: str) -> None:
    voltage, angle = example_motor_log(samples=2500)
    signs = (-1, 1) if channel == "voltage" else (1, -1)
    with pytest.raises(LogError, match="impossible sign"):
        identify_motor(signs[0] * voltage, signs[1] * angle, period=PERIOD)
    fit = identify_motor(voltage, angle, period=PERIOD)
    assert fit.passed
    assert fit.nmse < 0.05


@pytest.mark.slow
def test_a_motor_that_its_voltage_does_not_explain_fails() -> None:
    voltage, angle = example_motor_log(samples=2500)
    with pytest.raises(FraclinkError):
        fit = identify_motor(voltage[::-1].copy(), angle, period=PERIOD)
        assert not fit.passed
        raise FraclinkError(fit.findings[0].message)


@pytest.mark.slow
def test_a_delay_of_the_logger_stays_out_of_the_loop() -> None:
    fit, rig = identify(log()), Rig.named("paper-2023")
    assert fit.loop_model(rig) == fit.model
    late_logger = replace(rig, gauge=replace(rig.gauge, delay_in_loop=False))
    model = fit.loop_model(late_logger)
    assert model.gauge_delay == 0.0
    assert model.interval("gauge_delay") is None
    assert model.interval("order") == fit.model.interval("order")


@pytest.mark.slow
def test_a_ring_down_is_judged_until_it_sinks_into_the_noise() -> None:
    """A disturbance after the vibration has decayed, even if larger than the noise, is
    no evidence for or against the model.
    """
    swing = simulated_torque(replace(TRUTH, order=1.9), RING, PERIOD)
    quiet = identify(log(RING, swing + 0.01 * swing.std() * WHITE), "UD-FOM")
    tremble = np.where(TIME > 12.0, 0.03 * swing.std() * np.sin(2 * np.pi * TIME), 0.0)
    shaken = identify(log(RING, swing + 0.01 * swing.std() * WHITE + tremble), "UD-FOM")
    assert quiet.passed and shaken.passed
    assert quiet.heldout_nmse == shaken.heldout_nmse

    false = swing + 0.01 * swing.std() * WHITE
    late = int(np.searchsorted(TIME, 1.5))
    false[late:] *= -1
    assert not identify(log(RING, false), "UD-FOM").passed
