"""Frequency responses of a link alone: one mode and several, the DaISy arm."""

from __future__ import annotations

import numpy as np
import pytest

import fraclink as fl
from fraclink.errors import FieldError
from shared_data import shared_data

FREQUENCY = np.linspace(1, 40, 200)
LINK = fl.LinkModel(1.56, 10.02, order=1.92)
TEXT = "k*s**a/(s**a + w)*exp(-T*s)"
CLEAN = LINK.torque()(1j * FREQUENCY)


def noisy(seed: int) -> np.ndarray:
    generator = np.random.default_rng(seed)
    response = CLEAN * np.exp(-1j * FREQUENCY * 0.01)
    noise = generator.normal(size=200) + 1j * generator.normal(size=200)
    return np.asarray(response * (1 + 0.02 * noise))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_a_clean_response_is_found_exactly(seed: int) -> None:
    draw = np.random.default_rng(seed).uniform
    order, frequency, delay = draw(1.5, 1.995), draw(3, 25), draw(0, 0.03)
    link = fl.LinkModel(2.0, frequency, order=order)
    response = link.torque()(1j * FREQUENCY) * np.exp(-1j * FREQUENCY * delay)
    fit = fl.identify_structure(fl.FrequencyResponse(FREQUENCY, response), TEXT)
    truth = {"k": 2.0, "a": order, "w": frequency**2, "T": delay}
    assert fit.parameters == pytest.approx(truth, rel=1e-4, abs=1e-6)
    assert fit.passed


@pytest.mark.slow
def test_noise_of_every_line_and_its_order_in_the_table() -> None:
    for seed in range(4):
        measured = fl.FrequencyResponse(FREQUENCY, noisy(seed))
        fit = fl.identify_structure(measured, TEXT)
        assert fit.passed
        assert abs(fit.parameters["a"] - 1.92) < 4 * fit.standard_errors["a"]
    mixed = np.random.default_rng(3).permutation(FREQUENCY.size)
    again = fl.identify_structure(
        fl.FrequencyResponse(FREQUENCY[mixed], noisy(3)[mixed]), TEXT
    )
    assert again.parameters == fit.parameters


@pytest.mark.slow
def test_standard_errors_are_the_scatter_of_fits() -> None:
    """This also holds if the noise of a line does not depend on its magnitude, and a
    few lines at the resonance have the largest errors.
    """
    fits = [
        fl.identify_structure(
            fl.FrequencyResponse(FREQUENCY, noisy(seed)),
            TEXT,
            weighting="absolute",
            details=False,
        )
        for seed in range(16)
    ]
    for name in ("a", "T", "w"):
        said = np.median([fit.standard_errors[name] for fit in fits])
        scatter = np.std([fit.parameters[name] for fit in fits])
        assert 0.55 < said / scatter < 1.8, name  # from 16 values it is known to 18 %


@pytest.mark.slow
def test_daisy_arm_has_one_common_order() -> None:
    data = np.genfromtxt(
        shared_data("daisy_robot_arm", "robot-arm.csv"), delimiter=",", names=True
    )
    # One period of a sweep: the ratio of the transforms at its lines, in radians per
    # sample.
    into, out = (np.fft.rfft(data[name])[1:] for name in ("u", "y"))
    lines = np.abs(into) >= 0.05 * np.abs(into).max()
    assert lines.sum() == 108
    place = 2 * np.pi * np.arange(1, into.size + 1) / data["u"].size
    found = fl.FrequencyResponse(
        place[lines], out[lines] / into[lines], np.abs(into[lines])
    )
    text = "g*(s**l + z1**l)*(s**l + z2**l)/((s**l + p1**l)*(s**l + p2**l))*exp(-T*s)"
    band = (0.1, 2.0)
    bounds = {"l": (1.0, 2.0), **dict.fromkeys(("z1", "z2", "p1", "p2"), band)}
    fit = fl.identify_structure(
        found, text, bounds=bounds, weighting="magnitude", details=False
    )
    assert fit.parameters["l"] == pytest.approx(1.994, abs=0.002)
    assert fit.nmse <= 0.027**2
    resonances = sorted(fit.parameters[name] / (2 * np.pi) for name in ("p1", "p2"))
    assert resonances == pytest.approx([0.058, 0.127], abs=1e-3)


WHITE = noisy(0) / (CLEAN * np.exp(-1j * FREQUENCY * 0.01)) - 1  # 2 %
BAD = {
    "noise alone": 50 * WHITE,
    "the phase with the other sign": np.conj(CLEAN),
    "the gain in dB": 20 * np.log10(np.abs(CLEAN)) * np.exp(1j * np.angle(CLEAN)),
    "the phase in degrees": np.abs(CLEAN) * np.exp(1j * np.degrees(np.angle(CLEAN))),
    "no phase at all": np.abs(CLEAN) + 0j,
    "no mode": 1 + 5 * WHITE,
}


@pytest.mark.slow
@pytest.mark.parametrize("name", BAD)
def test_a_response_without_this_mode_fails_a_gate(name: str) -> None:
    measured = fl.FrequencyResponse(FREQUENCY, BAD[name])
    fit = fl.identify_structure(measured, TEXT, bounds={"a": (1.0, 2.0)}, details=False)
    assert not fit.passed
    assert all(item.remedy and item.evidence for item in fit.findings)
    if name == "no mode":  # then any resonance beyond the band will do
        (rival,) = (item for item in fit.findings if item.code == "W357")
        assert "w" in rival.evidence


def test_spectra_need_a_weight_that_was_measured() -> None:
    with pytest.raises(FieldError) as caught:
        fl.identify_structure(
            fl.FrequencyResponse(FREQUENCY, CLEAN), TEXT, weighting="magnitude"
        )
    assert caught.value.field == "weighting"
