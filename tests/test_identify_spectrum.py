"""Frequency responses: one mode and several, outliers, coherence, the DaISy arm."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fraclink import LinkModel, identify_frequency_response
from fraclink.errors import FieldError, LogError
from fraclink.extend import frequency_response
from shared_data import shared_data

FREQUENCY = np.linspace(1, 40, 200)
LINK = LinkModel(1.56, 10.02, order=1.92)


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(
    order=st.floats(1.5, 1.995), frequency=st.floats(3, 25), delay=st.floats(0, 0.03)
)
def test_clean_response_is_found_exactly(
    order: float, frequency: float, delay: float
) -> None:
    link = LinkModel(2.0, frequency, order=order)
    response = link.torque()(1j * FREQUENCY) * np.exp(-1j * FREQUENCY * delay)
    fit = identify_frequency_response(FREQUENCY, response)
    assert fit.order == pytest.approx(order, abs=1e-5)
    assert fit.delay == pytest.approx(delay, abs=1e-6)
    assert fit.model().natural_frequency == pytest.approx(frequency, rel=1e-4)
    assert fit.model(stiffness=3.0).stiffness == 3.0


def noisy(seed: int) -> np.ndarray:
    generator = np.random.default_rng(seed)
    response = LINK.torque()(1j * FREQUENCY) * np.exp(-1j * FREQUENCY * 0.01)
    return np.asarray(
        response
        * (1 + 0.02 * (generator.normal(size=200) + 1j * generator.normal(size=200)))
    )


@pytest.mark.slow
def test_outliers_are_set_aside_and_named() -> None:
    response = noisy(0)
    response[[20, 77, 150]] *= [5, -3, 0.1]
    response[100] = 30
    fit = identify_frequency_response(FREQUENCY, response)
    assert fit.outliers == (20, 77, 100, 150)
    assert abs(fit.order - 1.92) < 4 * fit.standard_errors["order"]
    spoilt = identify_frequency_response(FREQUENCY, response, robust=False)
    assert spoilt.standard_errors["order"] > 3 * fit.standard_errors["order"]


@pytest.mark.slow
@pytest.mark.parametrize("weighed", [False, True])
def test_the_order_of_the_lines_does_not_matter(weighed: bool) -> None:
    response = noisy(0)
    response[[20, 77, 150]] *= [5, -3, 0.1]
    coherence = np.linspace(0.6, 0.99, FREQUENCY.size) if weighed else None
    sorted_fit = identify_frequency_response(FREQUENCY, response, coherence=coherence)
    mixed = np.random.default_rng(3).permutation(FREQUENCY.size)
    fit = identify_frequency_response(
        FREQUENCY[mixed],
        response[mixed],
        coherence=None if coherence is None else coherence[mixed],
    )
    assert fit.order == sorted_fit.order
    assert set(FREQUENCY[mixed][list(fit.outliers)]) == set(
        FREQUENCY[list(sorted_fit.outliers)]
    )
    assert np.array_equal(fit.predicted, sorted_fit.predicted[mixed])


def test_tip_angle_and_known_values() -> None:
    response = LINK.tip()(1j * FREQUENCY)
    fit = identify_frequency_response(FREQUENCY, response, derivative=0, delay=0.0)
    assert fit.delay == 0.0
    assert "delay" not in fit.standard_errors
    assert fit.order == pytest.approx(1.92, abs=1e-6)
    assert fit.gain == pytest.approx(10.02**2, rel=1e-5)
    known = identify_frequency_response(FREQUENCY, response, derivative=0, order=1.92)
    assert known.order == 1.92
    assert np.allclose(fit.response(FREQUENCY), response, rtol=1e-6)


@pytest.mark.slow
def test_coherence_weighs_lines() -> None:
    response = noisy(1)
    bad = FREQUENCY > 20
    response[bad] *= 1 + 0.5 * np.random.default_rng(2).normal(size=int(bad.sum()))
    coherence = np.where(bad, 0.5, 0.999)
    weighed = identify_frequency_response(
        FREQUENCY, response, coherence=coherence, robust=False
    )
    plain = identify_frequency_response(FREQUENCY, response, robust=False)
    assert abs(weighed.order - 1.92) < 5e-3
    assert weighed.standard_errors["delay"] < plain.standard_errors["delay"]


@pytest.mark.slow
def test_two_modes_with_one_order() -> None:
    s = 1j * np.linspace(0.02, 1.3, 150)
    x = s**1.95
    places = {"p": (0.36, 0.8), "z": (0.2, 1.1)}
    response = -0.2 * np.exp(-0.3 * s)
    for place in places["z"]:
        response = response * (x + place**1.95)
    for place in places["p"]:
        response = response / (x + place**1.95)
    fit = identify_frequency_response(s.imag, response, resonances=2, anti_resonances=2)
    assert fit.resonances == pytest.approx(places["p"], rel=1e-5)
    assert fit.anti_resonances == pytest.approx(places["z"], rel=1e-5)
    assert fit.order == pytest.approx(1.95, abs=1e-6)
    with pytest.raises(FieldError, match="resonances"):
        fit.model()


@pytest.mark.slow
def test_daisy_arm_has_one_common_order() -> None:
    data = np.genfromtxt(
        shared_data("daisy_robot_arm", "robot-arm.csv"), delimiter=",", names=True
    )
    found = frequency_response(data["u"], data["y"])
    assert found.frequency.size == 108
    fit = identify_frequency_response(
        found.frequency,
        found.response,
        weights=found.magnitude,
        resonances=2,
        anti_resonances=2,
    )
    assert fit.order == pytest.approx(1.994, abs=0.002)
    assert fit.fit >= 97.3
    assert fit.passed
    assert np.array(fit.resonances) / (2 * np.pi) == pytest.approx(
        [0.058, 0.127], abs=1e-3
    )


CLEAN = LINK.torque()(1j * FREQUENCY)
WHITE = noisy(0) / (CLEAN * np.exp(-1j * FREQUENCY * 0.01)) - 1  # 2 %
LOW = FREQUENCY < 5
BAD = {
    "noise alone": (FREQUENCY, 50 * WHITE, "W313"),
    "the phase with the other sign": (FREQUENCY, np.conj(CLEAN), "W313"),
    "the gain in dB": (
        FREQUENCY,
        20 * np.log10(np.abs(CLEAN)) * np.exp(1j * np.angle(CLEAN)),
        "W313",
    ),
    "the phase in degrees": (
        FREQUENCY,
        np.abs(CLEAN) * np.exp(1j * np.degrees(np.angle(CLEAN))),
        "W313",
    ),
    "no phase at all": (FREQUENCY, np.abs(CLEAN) + 0j, "W313"),
    "a band below the resonance": (FREQUENCY[LOW], noisy(0)[LOW], "W315"),
    "no mode": (FREQUENCY, 1 + 5 * WHITE, "W315"),
    "the other sign": (FREQUENCY, -CLEAN, "W211"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", BAD)
def test_a_response_without_this_mode_fails_a_gate(name: str) -> None:
    frequency, response, code = BAD[name]
    fit = identify_frequency_response(frequency, response)
    assert not fit.passed
    finding = next(finding for finding in fit.findings if finding.code == code)
    assert finding.remedy
    assert finding.evidence


@pytest.mark.slow
def test_an_angle_of_the_motor_is_no_tip_response() -> None:
    """A motor with an anti-resonance at 26 and a peak at 29 rad/s: low frequencies win
    the fit.
    """
    s = 1j * FREQUENCY
    link = (s**2 + 0.52 * s + 26**2) / (s**2 + 1.16 * s + 29**2)
    fit = identify_frequency_response(
        FREQUENCY, 3000 * link / (s * (s + 15)), anti_resonances=1
    )
    assert "W315" in {
        finding.code for finding in fit.findings if finding.severity == "error"
    }


@pytest.mark.slow
def test_good_responses_pass() -> None:
    assert identify_frequency_response(FREQUENCY, CLEAN).passed
    assert all(
        identify_frequency_response(FREQUENCY, noisy(seed)).passed for seed in range(6)
    )


@pytest.mark.parametrize(
    ("field", "options"),
    [
        ("frequency", {"frequency": -FREQUENCY}),
        ("frequency", {"frequency": FREQUENCY[:5], "response": np.ones(5)}),
        ("response", {"response": np.ones(3)}),
        ("coherence", {"coherence": np.full(200, 1.5)}),
        ("weights", {"weights": -np.ones(200)}),
        ("weights", {"weights": np.ones(200), "coherence": np.full(200, 0.9)}),
    ],
)
def test_bad_responses_name_their_field(field: str, options: dict[str, object]) -> None:
    arguments: dict[str, object] = {
        "frequency": FREQUENCY,
        "response": noisy(0),
    } | options
    with pytest.raises(FieldError) as caught:
        identify_frequency_response(**arguments)  # type: ignore[arg-type]
    assert caught.value.field == field


def test_spectra_need_equal_lengths() -> None:
    with pytest.raises(LogError):
        frequency_response(np.ones(64), np.ones(63))


# --- the pieces against closed forms ------------------------------------------------------------------------


@pytest.mark.slow
def test_standard_errors_are_the_scatter_of_fits() -> None:
    fits = [
        identify_frequency_response(FREQUENCY, noisy(seed), robust=False)
        for seed in range(16)
    ]
    for name, values in (
        ("order", [fit.order for fit in fits]),
        ("delay", [fit.delay for fit in fits]),
        ("resonance 1", [fit.resonances[0] for fit in fits]),
    ):
        said = np.median([fit.standard_errors[name] for fit in fits])
        assert 0.55 < said / np.std(values) < 1.8, (
            name
        )  # the scatter of 16 is known to 18 %
