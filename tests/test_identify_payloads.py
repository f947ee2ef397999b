"""Joint identification of payloads: common parameters, eq. (5), the test of both."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from fraclink._arm.experiment import Experiment
from fraclink._arm.link import LinkModel
from fraclink._identify import (
    JointFit,
    LikelihoodRatio,
    identify,
    identify_payloads,
    simulated_torque,
)
from fraclink._identify.joint import Coordinates
from fraclink._identify.payloads import _verdict
from fraclink._identify.shape import damping_and_square
from fraclink.errors import FieldError, LogError
from identify_cases import made_log

LINK = LinkModel(1.56, 11.0, order=1.92, payload=0.03)
DAMPED = LinkModel(1.56, 11.0, damping=1.37, damping_order=0.954, payload=0.03)


def payload_logs(
    link: LinkModel, *, noise: float = 0.05, tweak: float = 0.0
) -> list[Experiment]:
    logs = []
    for i, mass in enumerate((0.02, 0.03, 0.04)):
        model = link.at_payload(mass)
        if tweak:
            model = LinkModel(1.56, model.natural_frequency, model.order - i * tweak)
        logs.append(made_log(model, noise=noise, seed=i, payload=mass))
    return logs


@pytest.fixture(scope="module")
def fit() -> JointFit:
    """One order, a resonance of its own for each payload."""
    return identify_payloads(payload_logs(LINK))


@pytest.mark.slow
def test_common_order_and_own_frequencies(fit: JointFit) -> None:
    assert fit.common == ("order",)
    for model, mass in zip(fit.models, (0.02, 0.03, 0.04), strict=True):
        assert model.order == fit.models[0].order
        assert model.natural_frequency == pytest.approx(
            LINK.at_payload(mass).natural_frequency, rel=3e-3
        )
    assert abs(fit.models[0].order - 1.92) < 4 * fit.standard_errors["order"]
    assert fit.test.degrees == 2
    assert fit.test.common
    assert "λ may be common" in fit.verdict


@pytest.mark.slow
def test_joint_errors_are_smaller_than_those_alone() -> None:
    logs = payload_logs(LINK)
    alone = min(
        identify(log, "UD-FOM", heldout=0).standard_errors["order"] for log in logs
    )
    assert identify_payloads(logs).standard_errors["order"] < alone


@pytest.mark.slow
def test_a_common_order_is_refused_where_it_is_not() -> None:
    fit = identify_payloads(payload_logs(LINK, tweak=0.01))
    assert not fit.test.common
    assert "cannot be common" in fit.verdict


@pytest.mark.slow
def test_one_stiffness_by_equation_5() -> None:
    fit = identify_payloads(payload_logs(LINK), tied=True, length=0.65)
    assert fit.stiffness_over_square == pytest.approx(11.0**2 * 0.03, rel=3e-3)
    assert fit.stiffness == pytest.approx(11.0**2 * 0.03 * 0.65**2, rel=3e-3)
    assert fit.test.degrees == 4
    assert fit.test.common
    wrong = [
        Experiment(
            period=log.period,
            motor_angle=log.motor_angle,
            output=log.output,
            payload=mass,
        )
        for log, mass in zip(payload_logs(LINK), (0.02, 0.033, 0.04), strict=True)
    ]
    assert not identify_payloads(wrong, tied=True).test.common


@pytest.mark.slow
@pytest.mark.parametrize("tied", [False, True])
def test_common_fractional_damping(tied: bool) -> None:
    fit = identify_payloads(payload_logs(DAMPED, noise=0.02), "D-FOM", tied=tied)
    assert fit.models[0].damping == pytest.approx(1.37, rel=0.1)
    assert fit.models[0].damping_order == pytest.approx(0.954, abs=0.05)
    assert fit.models[2].damping == fit.models[0].damping
    assert fit.test.common


@pytest.mark.slow
def test_nothing_common_is_every_log_for_itself() -> None:
    fit = identify_payloads(payload_logs(LINK), common=())
    assert np.allclose(fit.mse, fit.alone_mse, rtol=1e-6)
    assert fit.test.p_value == 1.0


@pytest.mark.slow
def test_known_delay_and_stiffness() -> None:
    fit = identify_payloads(payload_logs(LINK), stiffness=1.56, delay=0.0)
    assert fit.gains == (1.56, 1.56, 1.56)
    assert fit.delays == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("payloads", [None, (0.02, 0.03, 0.04)])
def test_joint_derivatives(payloads: tuple[float, ...] | None) -> None:
    names = ("frequency", "damping", "damping_order", "delay")
    common = ("damping", "damping_order", "frequency")[: 3 if payloads else 2]
    coordinates = Coordinates(names, common, 3, None, payloads)
    theta = np.full(coordinates.size, 0.01)
    theta[coordinates.index("damping", 0)] = 0.3
    theta[coordinates.index("damping_order", 0)] = 0.8
    for i in range(3):
        theta[coordinates.index("frequency", i)] = (
            np.log(3.6) if payloads else 2.3 + 0.1 * i
        )
    for log in range(3):
        shape, rates = coordinates.shape(theta, log)
        for k in range(coordinates.size):
            step = np.eye(coordinates.size)[k] * 1e-6
            numeric = (
                coordinates.shape(theta + step, log)[0]
                - coordinates.shape(theta - step, log)[0]
            ) / 2e-6
            assert np.allclose(rates[:, k], numeric, atol=1e-8)
        assert shape[0] == 2.0


def test_bad_joint_requests() -> None:
    logs = payload_logs(LINK)
    with pytest.raises(LogError, match="too few"):
        identify_payloads(logs[:1])
    with pytest.raises(LogError, match="payload"):
        identify_payloads([made_log(noise=0.1), logs[0]], tied=True)
    with pytest.raises(LogError, match="payload"):
        identify_payloads([logs[0], logs[0]], tied=True)
    with pytest.raises(FieldError) as caught:
        identify_payloads(logs, "UD-FOM", common=("damping",))
    assert caught.value.field == "common"


@pytest.mark.slow
def test_a_joint_fit_in_numbers(fit: JointFit) -> None:
    """Each figure of the result from the logs and models in it."""
    logs = payload_logs(LINK)
    assert (
        len(fit.models)
        == len(fit.gains)
        == len(fit.offsets)
        == len(fit.delays)
        == len(fit.predicted)
        == 3
    )
    for i, (log, model) in enumerate(zip(logs, fit.models, strict=True)):
        unit = simulated_torque(
            replace(model, stiffness=1.0),
            log.motor_angle,
            log.period,
            delay=fit.delays[i],
        )
        predicted = fit.gains[i] * unit + fit.offsets[i]
        assert fit.predicted[i] == pytest.approx(predicted, abs=1e-6)
        assert fit.mse[i] == pytest.approx(
            float(np.mean((log.output - predicted) ** 2)), rel=1e-6
        )
        assert fit.aic[i] == pytest.approx(2 * 2 + 5001 * math.log(fit.mse[i]))
        assert fit.mse[i] >= fit.alone_mse[i] * (1 - 1e-9)
        assert (model.payload, model.gauge_delay) == (log.payload, fit.delays[i])
        assert model.stiffness == abs(fit.gains[i])
    wanted = sum(
        5001 * math.log(a / b) for a, b in zip(fit.mse, fit.alone_mse, strict=True)
    )
    assert 0.5 * wanted < fit.test.statistic <= wanted * (1 + 1e-9)  # k >= 1
    assert fit.test.p_value == pytest.approx(
        float(chi2.sf(fit.test.statistic, 2)), rel=1e-9
    )
    assert repr(fit) == f"JointFit(UD-FOM of 3 logs: {fit.verdict})"
    assert (
        fit.verdict == f"λ may be common to these 3 logs (p = {fit.test.p_value:.2g})."
    )
    assert (fit.stiffness, fit.stiffness_over_square) == (None, None)


@pytest.mark.slow
def test_names_and_sizes_of_joint_errors(fit: JointFit) -> None:
    """They are those of the fits alone, and a root of three smaller where three logs
    share a parameter.
    """
    logs, free = payload_logs(LINK), fit
    tied = identify_payloads(logs, tied=True)
    assert set(free.standard_errors) == {
        "order", *(f"{name} {i}" for name in ("resonance", "delay") for i in (1, 2, 3)),
    }  # fmt: skip
    assert set(tied.standard_errors) == {
        "order",
        "stiffness_over_square",
        "delay 1",
        "delay 2",
        "delay 3",
    }
    alone = [identify(log, "UD-FOM", heldout=0) for log in logs]
    orders = [own.white_standard_errors["order"] for own in alone]
    assert free.standard_errors["order"] == pytest.approx(
        sum(e**-2 for e in orders) ** -0.5, rel=0.25
    )
    for i, own in enumerate(alone):
        assert free.standard_errors[f"delay {i + 1}"] == pytest.approx(
            own.white_standard_errors["delay"], rel=0.5
        )
    over = tied.stiffness_over_square
    assert over is not None
    assert (
        abs(over - 11.0**2 * 0.03) < 4 * tied.standard_errors["stiffness_over_square"]
    )
    assert tied.standard_errors["stiffness_over_square"] < 1e-3 * over


@pytest.mark.parametrize(
    ("common", "payloads", "p_value", "words"),
    [
        (("order",), None, 0.051, "λ may be common to these 3 logs (p = 0.051)."),
        (("order", "delay"), None, 0.049, "λ and the delay cannot be common to these 3 logs (p = 0.049)."),
        (("damping",), (1.0, 2.0, 3.0), 1e-10,
         "μ and the stiffness of eq. (5) cannot be common to these 3 logs (p < 1e-9)."),
        ((), (1.0, 2.0, 3.0), 1e-9, "the stiffness of eq. (5) cannot be common to these 3 logs (p = 1e-09)."),
    ],
)  # fmt: skip
def test_the_verdict_of_the_likelihood_ratio(
    common: tuple[str, ...],
    payloads: tuple[float, ...] | None,
    p_value: float,
    words: str,
) -> None:
    coordinates = Coordinates(("frequency", "order"), common, 3, None, payloads)
    assert _verdict(coordinates, common, LikelihoodRatio(1.0, 2, p_value)) == words
    assert "Nothing is common" in _verdict(
        coordinates, (), LikelihoodRatio(0.0, 0, 1.0)
    )
    assert [LikelihoodRatio(1.0, 2, p).common for p in (0.05, 0.0499)] == [True, False]


def test_requests_that_no_logs_answer() -> None:
    logs = payload_logs(LINK)
    with pytest.raises(LogError) as caught:
        identify_payloads(logs[:1])
    assert (caught.value.field, caught.value.value, caught.value.allowed) == (
        "logs",
        1,
        ">= 2",
    )
    with pytest.raises(FieldError) as unknown:
        identify_payloads(logs, "D-FOM", common=("order",))
    assert unknown.value.allowed == "damping, damping_order or delay"
    assert unknown.value.remedy == "D-FOM has these"


@pytest.mark.parametrize("order", [1.8, 1.95])
def test_eq_5_ties_the_resonance_to_the_payload(order: float) -> None:
    """Ω^λ = κ/m + μ Ω^α cos(απ/2), for links of fractional order and damping."""
    names = ("frequency", "order", "damping", "damping_order", "delay")
    coordinates = Coordinates(
        names, ("frequency", "order", "damping", "damping_order"), 2, None, (0.02, 0.05)
    )
    theta = np.array([math.log(3.6), order, math.log(2.0), 0.7, 0.01, 0.02])
    for log, mass in enumerate((0.02, 0.05)):
        shape, _ = coordinates.shape(theta, log)
        resonance = math.exp(shape[1])
        right = 3.6 / mass + 2.0 * resonance**0.7 * math.cos(0.35 * math.pi)
        assert resonance**order == pytest.approx(right, rel=1e-12)
        damping, square = damping_and_square(shape)
        assert (damping, square) == (pytest.approx(2.0), pytest.approx(3.6 / mass))
        assert shape[4] == theta[4 + log]
