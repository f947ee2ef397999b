"""A fit validated on other logs: against independent simulations with known truth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import fraclink as fl
from fraclink.errors import FieldError
from fracsys import time_response

PERIOD = 0.004
LINK = fl.LinkModel(1.5, 10.0, order=1.92, payload=0.030)


def motion(seed: int, count: int = 4000) -> NDArray[np.float64]:
    """Random steps through a servo with two poles, initially at rest."""
    rng = np.random.default_rng(seed)
    angle = np.repeat(rng.choice([-0.2, 0.2], count // 50 + 1), 50)[:count]
    angle[:50] = 0.0
    for _ in range(2):
        for k in range(1, count):
            angle[k] = angle[k - 1] + 0.3 * (angle[k] - angle[k - 1])
    return angle


def log(
    seed: int, link: fl.LinkModel = LINK, *, noise: float = 0.01, bias: float = 0.0
) -> fl.Experiment:
    """A log computed by `time_response`, which shares no code with the kernel of the
    fit.
    """
    angle = motion(seed)
    torque = time_response(link.torque(), angle, PERIOD, hold="first").output
    torque = torque + noise * np.random.default_rng(100 + seed).standard_normal(
        angle.size
    )
    return fl.Experiment(
        period=PERIOD,
        motor_angle=angle,
        output=torque + bias,
        payload=link.payload,
        source=f"{seed}.csv",
    )


@pytest.fixture(scope="module")
def fit() -> fl.Fit:
    return fl.identify(log(1))


def test_a_second_log_of_the_same_link_is_predicted_up_to_its_noise(
    fit: fl.Fit,
) -> None:
    second = log(2, bias=0.05)
    found = fit.validate(second)
    assert found.passed
    assert found.findings == ()
    power = float(np.var(second.output))
    assert found.nmse == pytest.approx(0.01**2 / power, rel=0.15)
    # The drift of the gauge is not an error of the model, and is reported.
    assert found.logs[0].bias == pytest.approx(0.05, abs=1e-3)
    resonance = found.figures_of(found.logs[0])["resonance"]
    assert resonance.low < abs(LINK.pole) < resonance.high


def test_where_over_frequency_the_prediction_errs_is_said(fit: fl.Fit) -> None:
    second = log(2)
    hum = 0.03 * np.sin(60.0 * second.time)
    each = fit.validate(replace(second, output=second.output + hum)).logs[0]
    assert each.frequencies[each.share.argmax()] == pytest.approx(60.0, abs=2.0)
    # The ratio is the missing gain of the model: three quarters of the output.
    each = fit.validate(replace(second, output=0.75 * second.output)).logs[0]
    near = np.abs(each.frequencies - 11.0) < 2.0
    assert np.abs(each.ratio[near]) == pytest.approx(0.75, rel=0.02)


def test_what_differs_by_more_than_both_intervals_is_a_finding(fit: fl.Fit) -> None:
    other = replace(LINK, natural_frequency=1.01 * LINK.natural_frequency)
    found = fit.validate(log(2), log(3, other))
    assert found.passed
    (finding,) = found.findings
    assert finding.code == "W362"
    assert "3.csv" in finding.message
    assert "resonance" in finding.message
    low, high = found.spread["resonance"]
    assert high / low == pytest.approx(1.01 ** (2 / 1.92), rel=2e-3)
    # The differences between two logs become the box of a design.
    rig = fl.Rig.named("paper-2023")
    box = fl.ParameterBox.of(fit.model, rig, others=found.models)
    for model in found.models:
        assert box.hull(fl.ParameterBox.at(model.at_payload(0.030))) == box


def test_a_log_of_another_arm_fails(fit: fl.Fit) -> None:
    found = fit.validate(log(2, replace(LINK, natural_frequency=14.0)))
    assert not found.passed
    assert {finding.code for finding in found.findings} == {"W318", "W362"}


def test_the_payload_of_the_log_is_the_one_predicted_for(fit: fl.Fit) -> None:
    lighter = log(2, LINK.at_payload(0.020))
    found = fit.validate(lighter)
    assert found.passed
    assert found.findings == ()
    assert not fit.validate(replace(lighter, payload=None)).passed


@pytest.mark.slow
def test_a_log_that_was_cut_moves_by_what_was_before(fit: fl.Fit) -> None:
    whole = log(2)
    cut = replace(
        whole,
        motor_angle=whole.motor_angle[1500:],
        output=whole.output[1500:],
        earlier_angle=whole.motor_angle[:1500],
    )
    unknown = replace(cut, earlier_angle=None)
    assert fit.validate(cut).nmse < 2 * fit.validate(whole).nmse
    assert fit.validate(unknown).nmse > 10 * fit.validate(cut).nmse


def test_bad_logs_are_refused(fit: fl.Fit) -> None:
    with pytest.raises(FieldError, match="logs"):
        fit.validate()
    with pytest.raises(FieldError, match="output_kind"):
        fit.validate(replace(log(2), output_kind="deflection"))


@pytest.mark.slow
def test_the_command(
    fit: fl.Fit, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model, picture = tmp_path / "model.json", tmp_path / "validation.svg"
    fit.save(model)
    places = []
    for seed, link in ((2, LINK), (3, replace(LINK, natural_frequency=14.0))):
        places.append(str(tmp_path / f"{seed}.csv"))
        log(seed, link).save(places[-1])
    words = ["--rig", "paper-2023", "--payload", "0.03"]
    assert (
        fl.main(["validate", str(model), places[0], *words, "--out", str(picture)]) == 0
    )
    assert "the model predicts the other log" in capsys.readouterr().out
    assert "predicted" in picture.read_text("utf-8")
    assert fl.main(["validate", str(model), places[1], *words]) == 1
    assert "W318" in capsys.readouterr().out
