"""Frequency responses: one mode and several, outliers, coherence, the DaISy arm."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fraclink._arm.link import LinkModel
from fraclink._identify import (
    SpectrumFit,
    frequency_response,
    identify_frequency_response,
)
from fraclink._identify.modal import ModalProblem
from fraclink.errors import FieldError, LogError
from fraclink.findings import Finding
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
    "noise alone": (FREQUENCY, 50 * WHITE, "W341"),
    "the phase with the other sign": (FREQUENCY, np.conj(CLEAN), "W341"),
    "the gain in dB": (
        FREQUENCY,
        20 * np.log10(np.abs(CLEAN)) * np.exp(1j * np.angle(CLEAN)),
        "W341",
    ),
    "the phase in degrees": (
        FREQUENCY,
        np.abs(CLEAN) * np.exp(1j * np.degrees(np.angle(CLEAN))),
        "W341",
    ),
    "no phase at all": (FREQUENCY, np.abs(CLEAN) + 0j, "W341"),
    "a band below the resonance": (FREQUENCY[LOW], noisy(0)[LOW], "W342"),
    "no mode": (FREQUENCY, 1 + 5 * WHITE, "W342"),
    "the other sign": (FREQUENCY, -CLEAN, "W346"),
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
    assert "W342" in {
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


def test_lines_of_whole_periods() -> None:
    """Amplitude and frequency of each line; the constant and weak lines are left out."""
    k = np.arange(64)
    u = 3.0 + np.cos(2 * np.pi * 4 * k / 64) + 0.06 * np.sin(2 * np.pi * 9 * k / 64)
    y = 7.0 + 2 * np.sin(2 * np.pi * 4 * k / 64) + 0.5 * np.sin(2 * np.pi * 9 * k / 64)
    found = frequency_response(u, y, period=0.5)
    assert found.frequency == pytest.approx(2 * np.pi * np.array([4, 9]) / 32.0)
    assert found.response == pytest.approx([-2j, 0.5 / 0.06])
    assert found.magnitude == pytest.approx([32.0, 0.06 * 32])
    few = frequency_response(u, y, period=0.5, threshold=0.07)
    assert few.frequency == pytest.approx([2 * np.pi * 4 / 32.0])
    assert frequency_response(u, y, threshold=0.05).frequency == pytest.approx(
        2 * np.pi * np.array([4, 9]) / 64
    )
    frequency_response(u[:16], y[:16])
    with pytest.raises(LogError) as caught:
        frequency_response(u[:15], y[:15])
    assert (caught.value.field, caught.value.allowed) == (
        "output",
        ">= 16 samples of each",
    )


def problem(**changes: object) -> ModalProblem:
    w = np.linspace(1.0, 20.0, 40)
    h = 2.0 * np.exp(-0.01j * w) * (1j * w) ** 1.9 / ((1j * w) ** 1.9 + 9.0**1.9)
    usual: dict[str, object] = {
        "frequency": w,
        "response": h,
        "weight": np.ones(40),
        "resonances": 1,
    }
    usual |= {"anti_resonances": 0, "derivative": 1, "order": None, "delay": None}
    return ModalProblem(**(usual | changes))  # type: ignore[arg-type]


def test_free_and_full_vectors() -> None:
    whole = problem()
    assert whole.moving.tolist() == [True, True, True]
    held = problem(order=1.9, delay=0.01)
    assert held.moving.tolist() == [False, False, True]
    assert held.full(np.array([2.2])).tolist() == [1.9, 0.01, 2.2]
    low, high = whole._limits()
    assert low == pytest.approx([1.0, -1.0, -1.5])
    assert high == pytest.approx([2.0, 1.0, np.log(20.0) + 1.5])
    truth = np.array([1.9, 0.01, np.log(9.0)])
    gain, predicted = whole.fitted(truth, np.ones(40, bool))
    assert gain == pytest.approx(2.0)
    assert predicted == pytest.approx(whole.response)
    assert whole.errors(truth, np.ones(40, bool)) == pytest.approx(
        np.zeros(80), abs=1e-12
    )
    few = np.arange(40) < 30
    assert whole.errors(truth + 0.01, few).size == 60
    # A real gain: turned by 90° nothing is left of it.
    assert problem(response=1j * whole.response).fitted(truth, np.ones(40, bool))[
        0
    ] == pytest.approx(0.0, abs=1e-9)


def test_the_result_of_a_fit_in_numbers() -> None:
    whole, every = problem(), np.ones(40, bool)
    spoilt = problem(response=whole.response + 0.1)
    found = spoilt.result(np.array([1.9, 0.01, np.log(9.0)]), every)
    weighed = whole.response
    gain = np.real(np.vdot(weighed / 2, spoilt.response)) / np.real(
        np.vdot(weighed / 2, weighed / 2)
    )
    left = np.linalg.norm(spoilt.response - gain * weighed / 2) / np.linalg.norm(
        spoilt.response
    )
    assert found.gain == pytest.approx(gain)
    assert found.fit == pytest.approx(100 * (1 - left))
    assert (found.order, found.delay, found.resonances) == (
        1.9,
        0.01,
        (pytest.approx(9.0),),
    )
    assert not found.at_bound and found.outliers == ()
    assert (
        problem(order=2.0).result(np.array([0.01, np.log(9.0)]), every).at_bound
        is False
    )  # it was given
    assert whole.result(np.array([2.0, 0.01, np.log(9.0)]), every).at_bound
    assert whole.result(np.array([1.0, 0.01, np.log(9.0)]), every).at_bound
    kept = np.arange(40) != 7
    assert whole.result(np.array([1.9, 0.01, np.log(9.0)]), kept).outliers == (7,)


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


GOOD = SpectrumFit(
    1.9,
    (9.0,),
    (),
    1.5,
    0.01,
    1,
    {"resonance 1": 0.1, "delay": 1e-4},
    97.0,
    (),
    False,
    np.ones(2),
)


def test_a_link_of_one_resonance() -> None:
    model = GOOD.model(payload=0.03)
    assert (model.stiffness, model.order, model.gauge_delay, model.payload) == (
        1.5,
        1.9,
        0.01,
        0.03,
    )
    assert model.natural_frequency == pytest.approx(9.0**0.95)
    assert replace(GOOD, gain=-1.5).model().stiffness == 1.5
    assert GOOD.model(stiffness=7.0).stiffness == 7.0
    for changes in ({"resonances": (3.0, 9.0)}, {"anti_resonances": (5.0,)}):
        with pytest.raises(FieldError) as caught:
            replace(GOOD, **changes).model()  # type: ignore[arg-type]
        assert caught.value.allowed == "1 resonance, no anti-resonance"
    assert (
        replace(GOOD, findings=(Finding("W341", "error", "m", {}, "r"),)).passed
        is False
    )
    assert GOOD.passed


def test_two_lines_for_each_mode_and_four_more() -> None:
    w = np.linspace(1.0, 20.0, 6)
    h = LINK.torque()(1j * w)
    assert identify_frequency_response(w, h, robust=False).order == pytest.approx(
        1.92, abs=1e-3
    )
    with pytest.raises(FieldError) as caught:
        identify_frequency_response(w[1:], h[1:])
    assert (caught.value.value, caught.value.allowed) == (5, ">= 6")
    with pytest.raises(FieldError) as caught:
        identify_frequency_response(w, h, resonances=2, anti_resonances=1)
    assert caught.value.allowed == ">= 10"
