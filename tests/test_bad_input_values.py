"""Bad values of links, designs, laws and campaigns, by their numbers in the catalogue
of bad inputs.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable

import numpy as np
import pytest

import fraclink as fl
import fracsys
from fraclink import Experiment, LinkModel, identify_payloads
from fraclink.errors import FieldError, InfeasibleError
from fraclink.extend import simulated_torque
from identify_cases import smooth_pulse

RIG = fl.Rig.named("paper-2023")
LINK = LinkModel(stiffness=1.56, natural_frequency=11.0, order=1.92, payload=0.030)
PRINTED = fl.Controller(  # (58)
    derivative_gain=0.148, derivative_order=0.65, filter_time=0.16, filter_order=2
)


def refused(call: Callable[[], object], field: str) -> FieldError:
    """The error of `call`: of this field, complete, on one line."""
    with pytest.raises(FieldError) as caught:
        call()
    error = caught.value
    assert error.field == field
    assert error.problem and error.allowed and error.remedy
    assert "\n" not in str(error)
    return error


def planned(model: LinkModel = LINK, rig: fl.Rig = RIG, **changes: object) -> fl.Design:
    request = {
        "payloads": (0.020, 0.040),
        "gain_crossover": 12.0,
        "phase_margin": fl.deg(50),
    }
    return fl.design(model, rig, **(request | changes))


@functools.cache
def default_law() -> fl.Law:
    return fl.discretize(planned().controller, 0.004)


@pytest.mark.slow
def test_b17_logs_of_different_periods_share_one_order() -> None:
    def recorded(period: float, mass: float) -> Experiment:
        link = LINK.at_payload(mass)
        fine = smooth_pulse(period / 10 * np.arange(30_010))
        torque = simulated_torque(link, fine, period / 10, hold="first")[::10]
        return Experiment(
            period=period, motor_angle=fine[::10], output=torque, payload=mass
        )

    fit = identify_payloads([recorded(0.004, 0.020), recorded(0.005, 0.040)])
    for model, mass in zip(fit.models, (0.020, 0.040), strict=True):
        assert model.order == pytest.approx(1.92, abs=1e-4)
        assert model.natural_frequency == pytest.approx(
            LINK.at_payload(mass).natural_frequency, rel=1e-4
        )


@pytest.mark.slow
def test_b31_the_integer_orders_themselves() -> None:
    # λ = 1: c (1 − e^{−ω₀² t} …), λ = 2: c cos ω₀t: exact cases that need no special
    # treatment by the caller.
    time = np.array([0.1, 0.2, 0.7])
    for order, wanted in (
        (1.0, 1.56 * np.exp(-9 * time)),
        (2.0, 1.56 * np.cos(3 * time)),
    ):
        torque = LinkModel(1.56, 3.0, order=order).torque()
        assert fracsys.step_response(torque, time).output == pytest.approx(
            wanted, abs=1e-11
        )
    assert planned(dataclasses.replace(LINK, order=2.0)).passed


@pytest.mark.slow
def test_b34_a_design_that_needs_an_integral_instead() -> None:
    link = dataclasses.replace(LINK, natural_frequency=8.0, order=1.3)
    asked = {
        "gain_crossover": 70.0,
        "phase_margin": fl.deg(40),
        "filter_time": 0.0,
        "procedure": "published",
    }
    with pytest.raises(InfeasibleError, match="β > 0"):
        planned(link, **asked)


@pytest.mark.slow
def test_b35_a_slow_link_has_the_paper_s_design_in_another_unit_of_time() -> None:
    """Theorem 2 requires ω₀ > 1, which depends on the unit of time: a link that is 20
    times slower has the same design.
    """
    slower, scale = 20.0, 20.0 ** (LINK.order / 2)
    fast, slow = (
        planned(
            payloads=None,
            natural_frequencies=(9.0 / s, 14.0 / s),
            gain_crossover=16.0 / w,
            filter_time=0.0,
            procedure="published",
        ).controller
        for w, s in ((1.0, 1.0), (slower, scale))
    )
    assert 9.0 / scale < 1.0
    assert slow.derivative_order == pytest.approx(fast.derivative_order, rel=1e-9)
    assert slow.derivative_gain == pytest.approx(
        fast.derivative_gain * slower**fast.derivative_order, rel=1e-9
    )


@pytest.mark.slow
def test_b36_left_of_the_peak_only_the_published_procedure_has_no_controller() -> None:
    with pytest.raises(InfeasibleError, match=r"\(39\)"):
        planned(gain_crossover=9.0, procedure="published")
    design = planned(gain_crossover=9.0)
    assert design.passed
    assert all(design.at(payload).gain_crossover >= 9.0 for payload in design.payloads)


@pytest.mark.slow
def test_b37_the_nearest_request_is_offered_and_passes_when_followed() -> None:
    with pytest.raises(InfeasibleError, match="instead of 12 rad/s") as caught:
        planned(phase_margin=fl.deg(120))
    assert planned(**dict(caught.value.nearest)).passed


@pytest.mark.parametrize(
    ("crossover", "bound"), [(900.0, "785.398 rad/s"), (300.0, "80 rad/s")]
)
def test_b38_a_crossover_beyond_nyquist_or_the_motor_loop(
    crossover: float, bound: str
) -> None:
    assert (
        bound
        in refused(lambda: planned(gain_crossover=crossover), "gain_crossover").allowed
    )


@pytest.mark.slow
def test_b39_the_papers_filter_costs_more_than_all_of_the_margin() -> None:
    design = planned(filter_time=0.16, filter_order=2, procedure="published")
    (finding,) = (one for one in design.findings if one.code == "W405")
    assert "gain crossover: 0 rad/s at 40 g" in finding.message


@pytest.mark.slow
def test_b40_a_certificate_that_is_not_obtained_names_payload_frequency_and_margin() -> (
    None
):
    law = fl.discretize(dataclasses.replace(PRINTED, link=LINK), RIG.period)
    printed = fl.certify(law, model=LINK, rig=RIG, payloads=(0.020, 0.040))
    assert not printed.passed
    assert printed.payload == pytest.approx(0.040)
    found = fl.certify(planned(), modulus_margin=0.95)
    assert not found.passed
    assert found.payload is not None and 0.0199 < found.payload < 0.0401
    assert found.frequency is not None and found.frequency > 0
    assert found.distance is not None and found.distance < 0.95


@pytest.mark.slow
def test_b41_a_period_too_long_for_the_request() -> None:
    refused(
        lambda: planned(rig=dataclasses.replace(RIG, period=0.2)), "motor_loop.pole"
    )
    assert (
        refused(lambda: fl.discretize(planned().controller, 0.1), "period").allowed
        == "0.004 s"
    )


@pytest.mark.slow
def test_b43_a_move_beyond_the_motor_does_not_hold() -> None:
    law = fl.discretize(planned(RIG.model).controller, 0.004)
    run = fl.simulate(
        law,
        fl.smooth_step(1000.0, duration=0.01),
        rig=RIG,
        model=RIG.model,
        payload=0.020,
    )
    assert not run.verdict.passed
    assert abs(run.metrics.steady_state_error) > 1.0
    # The fault is that the tip is off target; it does not oscillate, so nothing is
    # called unstable.
    assert "unstable" not in run.verdict.reason


@pytest.mark.parametrize(
    ("call", "field"),
    [
        (lambda: fl.smooth_step(10**400, 1.0), "amplitude"),
        (lambda: fl.smooth_step(1.0, 10**400), "duration"),
        (lambda: LinkModel(10**400, 11.0), "stiffness"),
        (lambda: LINK.at_payload(10**400), "payload"),
        (lambda: Experiment(10**400, np.ones(3), np.ones(3)), "period"),
        (
            lambda: fl.simulate(
                default_law(),
                fl.extend.hold(0.0),
                rig=RIG,
                model=LINK,
                payload=10**400,
            ),
            "payload",
        ),
    ],
)
def test_b44_a_whole_number_that_no_float_holds(
    call: Callable[[], object], field: str
) -> None:
    # the 400 digits of the number are not printed either
    assert "0" * 30 not in str(refused(call, field))


def test_a_word_beside_other_kinds_names_them_all() -> None:
    move = fl.smooth_step(1.0, duration=0.5)
    error = refused(lambda: fl.simulate(default_law(), move, told="yes"), "told")
    assert error.value == "yes" and error.problem == "unknown"
    assert all(each in error.allowed for each in ("kg", "True", "estimated"))
