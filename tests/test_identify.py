"""Identification of one log: accuracy, nuisance parameters, bounds, files, bad input."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from fraclink import (
    Experiment,
    Fit,
    LinkModel,
    compare_structures,
    identify,
    load,
    save,
    smooth_step,
)
from fraclink.errors import FieldError, FileFormatError, LogError, SizeError
from fraclink.extend import STRUCTURES, Structure, simulated_torque
from fracsys import s as laplace
from fracsys import time_response
from identify_cases import PERIOD, TRUTH, made_log, smooth_pulse

NOISE = 0.0052**0.5


def test_noise_free_pulse_of_20_seconds_to_six_digits() -> None:
    time = PERIOD * np.arange(5001)
    angle = np.where((time >= 1) & (time < 8), 1.0, 0.0)
    torque = time_response(TRUTH.torque(), angle, PERIOD).output
    fit = identify(
        Experiment(period=PERIOD, motor_angle=angle, output=torque), "UD-FOM"
    )
    assert fit.hold == "zero"
    assert fit.model.order == pytest.approx(1.92, abs=1e-6)
    assert fit.model.natural_frequency == pytest.approx(10.02, abs=1e-6)
    assert fit.gain == pytest.approx(1.56, abs=1e-6)
    assert abs(fit.delay) < 1e-7


def test_gain_offset_and_delay_are_found_along() -> None:
    log = made_log(delay=0.0137, offset=-0.3, gain=-0.7)
    fit = identify(log, "UD-FOM")
    # 1e-4: the motor moves smoothly, and the fit interpolates linearly between its
    # samples.
    assert fit.model.order == pytest.approx(1.92, abs=1e-4)
    assert fit.model.natural_frequency == pytest.approx(10.02, abs=1e-3)
    assert fit.delay == pytest.approx(0.0137, abs=2e-5)
    assert fit.offset == pytest.approx(-0.3, abs=1e-3)
    assert fit.gain == pytest.approx(-0.7 * 1.56, rel=1e-3)
    assert fit.model.stiffness == pytest.approx(0.7 * 1.56, rel=1e-3)
    assert {"W306", "W211"} <= {finding.code for finding in fit.findings}


@settings(max_examples=15, deadline=None)
@example(
    order=1.6875, frequency=34.0, delay=0.01171875, seed=0
)  # the scan needs eight times the frequency for it
@example(
    order=1.6015625, frequency=35.0, delay=0.0, seed=0
)  # and the delay ends at the largest lead that this allows
@given(
    order=st.floats(1.6, 1.99),
    frequency=st.floats(3.0, 40.0),
    delay=st.floats(0.0, 0.02),
    seed=st.integers(0, 10**6),
)
def test_any_link_is_found_without_a_guess(
    order: float, frequency: float, delay: float, seed: int
) -> None:
    link = LinkModel(2.0, frequency ** (order / 2), order=order)
    fit = identify(
        made_log(link, noise=0.02, delay=delay, seed=seed, samples=3001),
        "UD-FOM",
        details=False,
    )
    for name, value in (
        ("order", order),
        ("natural_frequency", link.natural_frequency),
        ("delay", delay),
    ):
        found = fit.delay if name == "delay" else getattr(fit.model, name)
        assert (
            abs(found - value)
            < 6 * fit.standard_errors[name] + 2e-3 * abs(value) + 1e-4
        )


@pytest.mark.slow
def test_bad_guesses_do_not_matter() -> None:
    log = made_log(noise=NOISE)
    best = identify(log, "UD-FOM", heldout=0, details=False)
    generator = np.random.default_rng(2)
    for _ in range(40):
        order = float(generator.uniform(1.001, 2.0))
        frequency = (10.02 * 3 ** float(generator.uniform(-1, 1))) ** (order / 1.92)
        guess = LinkModel(1.0, frequency, order=order)
        assert identify(
            log, "UD-FOM", heldout=0, guess=guess, details=False
        ).mse <= best.mse * (1 + 1e-7)


def test_known_values_are_kept() -> None:
    log = made_log(noise=0.02, offset=0.1)
    fit = identify(
        log, stiffness=1.5, fixed={"delay": 0.002, "order": 1.9, "offset": 0.09}
    )
    assert (fit.gain, fit.delay, fit.model.order, fit.offset) == (1.5, 0.002, 1.9, 0.09)
    assert set(fit.standard_errors) == {"natural_frequency"}


@pytest.mark.parametrize(
    ("name", "link"),
    [
        ("UD-IOM", LinkModel(1.56, 10.0)),
        ("D-IOM", LinkModel(1.56, 10.0, damping=1.3)),
        ("UD-FOM", TRUTH),
        ("D-FOM", LinkModel(1.56, 10.5, damping=1.37, damping_order=0.7)),
    ],
)
def test_every_structure_finds_its_own_parameters(name: str, link: LinkModel) -> None:
    fit = identify(made_log(link), name, details=False)
    for field in ("natural_frequency", "order", "damping", "damping_order"):
        assert getattr(fit.model, field) == pytest.approx(
            getattr(link, field), rel=3e-3
        )
    assert fit.nmse < 1e-7


def test_fractional_damping_is_never_worse_than_its_special_cases() -> None:
    for seed, link in enumerate(
        (TRUTH, LinkModel(1.56, 10.0, damping=1.3), LinkModel(1.56, 9.0, order=1.98))
    ):
        log = made_log(link, noise=0.05, seed=seed)
        mse = {
            name: identify(log, name, details=False).mse
            for name in ("UD-FOM", "D-IOM", "D-FOM")
        }
        assert mse["D-FOM"] <= min(mse["UD-FOM"], mse["D-IOM"]) * (1 + 1e-7)


@pytest.mark.parametrize(
    ("name", "mse", "published"),
    [
        ("UD-IOM", 0.05845, -14199),
        ("D-IOM", 0.00531, -26192),
        ("UD-FOM", 0.00524, -26258),
        ("D-FOM", 0.00524, -26256),
    ],
)
def test_aic_of_table_2(name: str, mse: float, published: int) -> None:
    """A log of 5001 samples in the unit in which the structure leaves the paper's error
    has the paper's AIC.
    """
    log = made_log(noise=NOISE)
    size = math.sqrt(mse / identify(log, name, heldout=0, details=False).mse)
    scaled = replace(log, output=size * log.output)
    fit = identify(scaled, name, heldout=0, details=False)
    assert fit.mse == pytest.approx(mse, rel=1e-9)
    assert round(fit.aic) == published


def test_heldout_samples_are_not_seen() -> None:
    log = made_log(noise=0.05)
    spoilt = replace(log, output=np.where(np.arange(5001) < 3001, log.output, 0.0))
    first, second = (
        identify(x, "UD-FOM", heldout=0.4, details=False) for x in (log, spoilt)
    )
    assert first.fitted_samples == 3001
    assert first.model == second.model
    assert second.heldout_mse is not None
    assert first.heldout_mse is not None
    assert second.heldout_mse != first.heldout_mse
    assert identify(log, "UD-FOM", heldout=0, details=False).heldout_nmse is None


def test_b32_order_at_its_bound_has_no_error() -> None:
    fit = identify(made_log(LinkModel(1.56, 10.0), noise=0.05, seed=0), "UD-FOM")
    assert fit.at_bound == ("order",)
    assert fit.model.order == 2.0
    assert fit.model.structure == "UD-IOM"
    assert "order" not in fit.standard_errors
    assert "order" not in fit.intervals
    finding = next(f for f in fit.findings if f.code == "W301")
    assert finding.evidence["order"] == 2.0


def test_b50_a_log_that_does_not_show_alpha_says_so() -> None:
    fit = identify(
        made_log(LinkModel(1.56, 10.0, damping=0.5), noise=0.2, samples=2500), "D-FOM"
    )
    assert "W308" in {finding.code for finding in fit.findings}
    assert (
        fit.intervals["damping_order"].high - fit.intervals["damping_order"].low > 0.5
    )


def test_intervals_cover_and_agree_with_standard_errors() -> None:
    log = made_log(noise=NOISE)
    fit = identify(log, "UD-FOM", heldout=0)
    for name, value in (("order", 1.92), ("natural_frequency", 10.02), ("delay", 0.0)):
        interval, error = fit.intervals[name], fit.standard_errors[name]
        assert interval.contains(value)
        assert interval.high - interval.low == pytest.approx(2 * 1.96 * error, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "alpha"),
    [("UD-IOM", 1.0), ("D-IOM", 1.0), ("D-FOM", 0.7), ("D-FOM", 1.3), ("UD-FOM", 1.0)],
)
def test_standard_errors_are_those_of_differences(
    name: Structure, alpha: float
) -> None:
    """For white errors they equal (JᵀJ)⁻¹ s², with J by central differences of the
    simulated torque; at the minimum the gradient is zero.
    """
    truth = replace(TRUTH, order=1.9 if name == "UD-FOM" else 2.0)
    if name in ("D-IOM", "D-FOM"):
        truth = replace(truth, damping=1.2, damping_order=alpha)
    log = made_log(truth, noise=0.01, delay=0.004)
    fit = identify(log, name, heldout=0, details=False)
    free = [key for key in fit.standard_errors if key not in ("gain", "offset")]
    start = {key: getattr(fit.model, key, fit.delay) for key in free}

    def output(moved: str, step: float) -> NDArray[np.float64]:
        values = {**start, **({moved: start[moved] + step} if moved else {})}
        late = values.pop("delay")
        link = replace(fit.model, stiffness=1.0, second_mode=None, **values)
        return simulated_torque(link, log.motor_angle, PERIOD, delay=late)

    columns = [output("", 0.0), np.ones(log.output.size)]
    for key in free:
        step = 1e-3 * fit.standard_errors[key]
        slope = (output(key, step) - output(key, -step)) / (2 * step)
        columns.append(fit.gain * slope * fit.standard_errors[key])
    matrix = np.array(columns)
    variances = fit.mse * np.diag(np.linalg.inv(matrix @ matrix.T))[2:]
    assert np.sqrt(variances) == pytest.approx(np.ones(len(free)), rel=0.02)
    gradient = matrix @ fit.residual / np.linalg.norm(matrix, axis=1)
    assert np.abs(gradient).max() < 1e-3 * np.linalg.norm(fit.residual)


@pytest.mark.slow
def test_coverage_of_the_intervals() -> None:
    """60 logs: fewer than 52 inside (two-sided 0.2 %) would mean that the errors are
    wrong by a third.
    """
    clean = made_log(delay=0.003)
    inside = {"order": 0, "natural_frequency": 0}
    for seed in range(60):
        noise = np.random.default_rng(seed).normal(0, NOISE, clean.output.size)
        fit = identify(replace(clean, output=clean.output + noise), "UD-FOM", heldout=0)
        inside["order"] += fit.intervals["order"].contains(1.92)
        inside["natural_frequency"] += fit.intervals["natural_frequency"].contains(
            10.02
        )
    assert min(inside.values()) >= 52


def test_coloured_noise_widens_the_errors() -> None:
    clean = made_log()
    generator = np.random.default_rng(5)
    white = generator.normal(0, 1, 5001 + 200)
    coloured = np.convolve(white, np.exp(-np.arange(200) / 20), "valid")[:5001]
    log = replace(clean, output=clean.output + 0.05 * coloured / coloured.std())
    fit = identify(log, "UD-FOM", heldout=0)
    assert fit.tests is not None
    assert fit.tests.whiteness < 1e-6
    plain = identify(log, "UD-FOM", heldout=0, details=False).standard_errors
    assert fit.standard_errors["order"] > 1.5 * plain["order"]


@pytest.mark.slow
def test_tests_of_a_white_residual_are_calm() -> None:
    p_values = []
    for seed in range(12):
        fit = identify(made_log(noise=NOISE, seed=seed), "UD-FOM", heldout=0)
        assert fit.tests is not None
        p_values.append((fit.tests.whiteness, fit.tests.input_independence))
    assert np.median(p_values, axis=0).min() > 0.1
    assert np.min(p_values) > 1e-4


@pytest.mark.slow
def test_b24_outliers_are_told() -> None:
    log = made_log(noise=0.02)
    spoilt = log.output.copy()
    spoilt[[500, 2000]] *= 100
    assert "W224" in {
        f.code for f in identify(replace(log, output=spoilt), details=False).findings
    }
    assert "W224" not in {f.code for f in identify(log, details=False).findings}


@pytest.mark.slow
def test_deflection_log_takes_the_stiffness_it_is_told() -> None:
    log = replace(made_log(gain=1 / 1.56), output_kind="deflection")
    fit = identify(log, stiffness=1.3, details=False)
    assert fit.model.stiffness == 1.3
    assert fit.gain == pytest.approx(1.0, abs=1e-3)
    told = identify(log, details=False)
    assert "W304" in {finding.code for finding in told.findings}


def test_fit_survives_its_file(tmp_path: Path) -> None:
    fit = identify(made_log(noise=0.02, samples=1500), "D-FOM")
    fit.save(tmp_path / "model.json")
    back = Fit.load(tmp_path / "model.json")
    assert back == fit
    assert back.model == fit.model
    assert np.array_equal(back.residual, fit.residual)
    assert load(tmp_path / "model.json") == fit
    assert not back.residual.flags.writeable


@pytest.mark.slow
def test_b51_a_fit_too_large_for_text_goes_into_an_archive(tmp_path: Path) -> None:
    fit = identify(made_log(samples=800))
    noise = np.random.default_rng(0).normal(size=450_000)
    long = replace(fit, predicted=noise, residual=noise)
    with pytest.raises(SizeError, match=r"end its name in \.npz"):
        long.save(tmp_path / "fit.json")
    assert not (tmp_path / "fit.json").exists()
    long.save(tmp_path / "fit.npz")
    assert load(tmp_path / "fit.npz") == long


def test_model_files(tmp_path: Path) -> None:
    save(TRUTH, tmp_path / "link.json")
    assert load(tmp_path / "link.json") == TRUTH


def test_damaged_fit_file_is_refused(tmp_path: Path) -> None:
    identify(made_log(noise=0.02, samples=600)).save(tmp_path / "fit.json")
    data = json.loads((tmp_path / "fit.json").read_text())
    del data["content"]["gain"]
    (tmp_path / "fit.json").write_text(json.dumps(data))
    with pytest.raises(FileFormatError, match="changed after it was written"):
        Fit.load(tmp_path / "fit.json")


@pytest.mark.parametrize(
    ("field", "options"),
    [
        ("structure", {"structure": "FOM"}),
        ("heldout", {"heldout": 1.0}),
        ("heldout", {"heldout": -0.1}),
        ("stiffness", {"stiffness": 0.0}),
        ("fixed", {"fixed": {"lambda": 1.9}}),
        ("fixed['order']", {"fixed": {"order": 2.5}}),
        ("fixed['delay']", {"fixed": {"delay": math.nan}}),
        ("hold", {"hold": "second"}),
    ],
)
def test_bad_options_name_their_field(field: str, options: dict[str, object]) -> None:
    with pytest.raises(FieldError) as caught:
        identify(made_log(samples=300), **options)  # type: ignore[arg-type]
    assert caught.value.field == field


def test_logs_without_motion_are_refused() -> None:
    angle = smooth_pulse(PERIOD * np.arange(1000))
    still = np.zeros(1000)
    for motor, output, field in (
        (still, angle, "motor_angle"),
        (angle, still, "output"),
    ):
        with pytest.raises(LogError) as caught:
            identify(Experiment(period=PERIOD, motor_angle=motor, output=output))
        assert caught.value.field == field
    with pytest.raises(LogError, match="too few"):
        identify(
            Experiment(period=PERIOD, motor_angle=angle[300:340], output=angle[300:340])
        )


@pytest.mark.slow
def test_a_fifth_structure_is_one_row(monkeypatch: pytest.MonkeyPatch) -> None:
    row = Structure(
        "DF",
        ("natural_frequency", "order", "damping"),
        "fractional order, viscous damping",
    )
    monkeypatch.setitem(STRUCTURES, row.name, row)
    link = LinkModel(1.56, 10.0, order=1.95, damping=0.8)
    # The derivatives of the kernel and the time response of both terms: an independent
    # simulation.
    angle = smooth_pulse(PERIOD * np.arange(4000))
    torque = time_response(link.torque(), angle, PERIOD, hold="first").output
    log = Experiment(
        period=PERIOD,
        motor_angle=angle,
        output=torque + 1e-3 * np.sin(np.arange(4000) ** 2),
    )
    comparison = compare_structures(log)
    assert list(comparison.fits)[-1] == "DF"
    assert comparison.preferred in ("DF", "D-FOM")
    fit = comparison.fits["DF"]
    assert fit.model.order == pytest.approx(1.95, abs=5e-3)
    assert fit.model.damping == pytest.approx(0.8, rel=0.05)
    assert fit.mse <= min(comparison.fits[name].mse for name in ("UD-FOM", "D-IOM")) * (
        1 + 1e-7
    )
    assert set(fit.standard_errors) >= set(row.free)


@pytest.mark.parametrize(
    ("rise", "resonance", "order", "delay"),
    [(1.6, 23.7, 1.62, 0.0207), (1.6, 24.1, 1.60, 0.0129), (0.26, 16.2, 1.64, 0.035)],
)
def test_a_smooth_move_has_a_second_valley_in_the_delay(
    rise: float, resonance: float, order: float, delay: float
) -> None:
    """On a single smooth move λ and the delay are interchangeable: the fit with the
    true delay is no better.
    """
    period = 0.004
    angle = smooth_step(0.5, rise).angle(period * np.arange(900))
    link = LinkModel(1.5, resonance ** (order / 2), order=order)
    torque = simulated_torque(link, angle, period, delay=delay, hold="first")
    for seed in range(4):
        noise = 0.02 * np.std(torque) * np.random.default_rng(seed).normal(size=900)
        log = Experiment(period=period, motor_angle=angle, output=torque + noise)
        own = identify(log, "UD-FOM", hold="first", details=False)
        given = identify(
            log, "UD-FOM", hold="first", details=False, fixed={"delay": delay}
        )
        assert own.mse <= given.mse * (1 + 1e-6)
        assert own.delay == pytest.approx(delay, abs=0.008)


@pytest.mark.parametrize("name", ["D-IOM", "UD-FOM"])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_vibration_that_outlasts_the_log_is_found(name: str, seed: int) -> None:
    """At ζ = 5e-4 the phase after 12 s shows every frequency that is π/12 s⁻¹ off."""
    levels = np.random.default_rng(seed).uniform(-0.5, 0.5, 30)
    levels[0] = 0.0
    angle = time_response(
        1 / (0.012 * laplace + 1) ** 2, np.repeat(levels, 100), PERIOD
    ).output
    link = LinkModel(1.5, 50.0, damping=0.05)
    log = Experiment(PERIOD, angle, simulated_torque(link, angle, PERIOD))
    fit = identify(log, name, details=False)
    assert abs(fit.model.pole) == pytest.approx(50.0, rel=1e-4)
