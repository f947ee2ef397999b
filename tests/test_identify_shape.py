"""The coordinates of a fit, the log as seen by the kernel, and which structures contain
which.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fraclink import Experiment, identify, identify_structure
from fraclink.errors import LogError
from fraclink.extend import simulated_torque
from identify_cases import PERIOD, TRUTH, late_cut, made_log

# --- starts and limits --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def log() -> Experiment:
    return made_log(noise=0.05, samples=2501)


@pytest.mark.parametrize("name", ["UD-IOM", "D-IOM", "D-FOM"])
def test_a_link_of_order_two_keeps_it_wherever_its_fit_is_begun(
    log: Experiment, name: str
) -> None:
    # The fit starts from a link of order 1.92, as a scan does.
    assert identify(log, name, heldout=0.0, details=False).model.order == 2.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 2, 3, 4, 6])
def test_a_lightly_damped_link_still_swings_by_what_was_long_before_the_cut(
    seed: int,
) -> None:
    """The last 2 s of 32 s at ζ = 0.02: with only 6 s before the cut the delay is wrong
    by up to 9 ms.
    """
    cut = late_cut(seed)
    fit = identify(cut)
    delay = fit.intervals["delay"]
    assert fit.passed and fit.structure == "D-IOM"
    assert delay.low < 0.0 < delay.high and delay.high - delay.low < 2e-3
    assert fit.model.natural_frequency == pytest.approx(10.0, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 4])
def test_a_vibration_elsewhere_that_fits_as_well_is_said(seed: int) -> None:
    """One vibration with 4 % of noise, excited by 31 s of motion before it: two links
    that differ by a few percent explain it.
    """
    late = late_cut(seed)
    at, size = late.output.size - 160, late.output.size
    noise = np.random.default_rng(seed).standard_normal(size)
    cut = Experiment(
        PERIOD,
        late.motor_angle[at:],
        np.asarray(late.output + 0.04 * late.output.std() * noise)[at:],
        earlier_angle=np.append(late.earlier_angle, late.motor_angle[:at]),
    )
    fit = identify(cut)
    assert not fit.passed
    assert "W357" in {finding.code for finding in fit.findings}


@pytest.mark.slow
@pytest.mark.parametrize("hold", ["first", "zero"])
def test_a_ring_down_behind_a_cut_is_fitted_by_the_move_before_it(hold: Any) -> None:
    time = PERIOD * np.arange(2500)
    angle = (
        0.4 * np.clip((time - 0.1) / 0.2, 0, 1)
        if hold == "first"
        else 0.4 * (time > 0.2)
    )
    torque = simulated_torque(TRUTH, angle, PERIOD, hold=hold)
    torque += 0.01 * torque.std() * np.random.default_rng(0).standard_normal(time.size)
    cut = Experiment(PERIOD, angle[100:], torque[100:], earlier_angle=angle[:100])
    fit = identify(cut)
    # The hold between samples is found from the move, not from an angle at rest, which
    # does not show it.
    assert fit.passed and fit.hold == hold
    assert fit.model.order == pytest.approx(TRUTH.order, abs=2e-3)
    assert abs(fit.delay) < 1e-3
    structured = identify_structure(cut, "k*s**a/(s**a + w)", details=False)
    assert structured.hold == hold
    assert structured.parameters["a"] == pytest.approx(TRUTH.order, abs=2e-3)
    with pytest.raises(LogError, match="motor_angle: constant"):
        identify(replace(cut, earlier_angle=np.full(100, 0.4)))


# --- which part is held out ---------------------------------------------------------------------------------


def test_too_short_and_still_logs_are_refused_with_what_is_wanted() -> None:
    log = made_log(samples=1000)
    short = Experiment(
        period=PERIOD, motor_angle=log.motor_angle[250:299], output=log.output[250:299]
    )
    with pytest.raises(LogError) as caught:
        identify(short, heldout=0.0)
    assert (caught.value.field, caught.value.value, caught.value.allowed) == (
        "output",
        49,
        ">= 50",
    )
    identify(
        Experiment(
            period=PERIOD,
            motor_angle=log.motor_angle[250:300],
            output=log.output[250:300],
        ),
        heldout=0.0,
        details=False,
    )
    still = Experiment(
        period=PERIOD, motor_angle=np.full(100, 0.3), output=log.output[250:350]
    )
    with pytest.raises(LogError) as caught:
        identify(still, heldout=0.0)
    assert (caught.value.field, caught.value.value, caught.value.allowed) == (
        "motor_angle",
        0.3,
        "a motion",
    )
