"""Joint identification of several payloads: common parameters, eq. (5), and the test of
both.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fraclink import Experiment, LinkModel, identify, identify_payloads
from fraclink.errors import FieldError, LogError
from identify_cases import made_log

LINK = LinkModel(1.56, 11.0, order=1.92, payload=0.03)
DAMPED = LinkModel(1.56, 11.0, damping=1.37, damping_order=0.954, payload=0.03)


def payload_logs(
    link: LinkModel, *, noise: float = 0.05, tweak: float = 0.0
) -> list[Experiment]:
    logs = []
    for i, mass in enumerate((0.02, 0.03, 0.04)):
        # μ common to all payloads, as in the paper's Table 3
        model = replace(link.at_payload(mass), damping=link.damping)
        if tweak:
            model = LinkModel(1.56, model.natural_frequency, model.order - i * tweak)
        logs.append(made_log(model, noise=noise, seed=i, payload=mass))
    return logs


@pytest.fixture(scope="module")
def fit() -> Any:
    """One common order, and a separate resonance for each payload."""
    return identify_payloads(payload_logs(LINK))


@pytest.mark.slow
def test_common_order_and_own_frequencies(fit: Any) -> None:
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


@pytest.mark.parametrize("tweak", [0.0, 1e-3])
def test_rounding_is_no_difference_and_a_difference_no_rounding(tweak: float) -> None:
    logs = payload_logs(LINK, noise=0.0, tweak=tweak)
    assert identify_payloads(logs, "UD-FOM").test.common is (tweak == 0.0)


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
    assert [model.gauge_delay for model in fit.models] == [0.0, 0.0, 0.0]


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
