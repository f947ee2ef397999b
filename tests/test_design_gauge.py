"""Designs with identified gauge delay, gauge gain and second mode, which are part of
the loop.

Stability is computed here independently of the package, from L written out again with
its exact delays: the winding number of 1 + L along a dense frequency axis.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import fraclink as fl
from fraclink import Design, LinkModel, SecondMode
from fraclink.errors import InfeasibleError
from fraclink.extend import Loop

RIG = fl.Rig.named("paper-2023")
MODEL = RIG.model
assert MODEL is not None
WANTED = {
    "payloads": (0.020, 0.040),
    "gain_crossover": 12.0,
    "phase_margin": fl.deg(50),
}
IDEAL = {"motor_loop": "ideal", "placement": "tustin"}
FREQUENCY = np.unique(
    np.concatenate(
        [np.geomspace(1e-3, 785.0, 60_000), np.linspace(0.01, 785.0, 60_000)]
    )
)


def written_out(
    design: Design, model: LinkModel, payload: float, w: np.ndarray
) -> np.ndarray:
    """L with the controller of the design on `model` at `payload` [kg], in plain
    complex arithmetic.
    """
    c, s = design.controller, 1j * w
    spring = model.natural_frequency**2 * model.payload / payload
    inertia, drag = s**model.order, model.damping * s**model.damping_order
    torque = inertia / (inertia + drag + spring)
    if model.second_mode is not None:
        mode = model.second_mode
        torque = torque + mode.gain * s**2 / (
            s**2 + 2 * mode.damping_ratio * mode.frequency * s + mode.frequency**2
        )
    tip = 1 - model.gauge_gain * np.exp(-s * model.gauge_delay) * torque
    outer = (
        c.derivative_gain
        * s**c.derivative_order
        / (1 + c.filter_time * s) ** c.filter_order
    )
    return (
        outer * np.exp(-1.5 * RIG.period * s) / (1 + s / RIG.motor_loop.pole) ** 2 * tip
    )


def is_stable(design: Design, model: LinkModel, payload: float) -> bool:
    turned = np.unwrap(np.angle(1 + written_out(design, model, payload, FREQUENCY)))
    return round((turned[-1] - turned[0]) / math.pi) == 0


@cache
def designed(
    delay: float, gain: float = 1.0, margin: float = 50.0
) -> Design | dict[str, float]:
    """The design for a late gauge, or the nearest request if there is none."""
    model = replace(MODEL, gauge_delay=delay, gauge_gain=gain)
    asked = WANTED | {"gain_crossover": 11.0, "phase_margin": fl.deg(margin)}
    try:
        return fl.design(model, RIG, **asked, law=False)
    except InfeasibleError as error:
        return error.nearest


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0.0, 0.001, 0.002, 0.004, 0.008, 0.012])
@pytest.mark.parametrize("gain", [0.9, 1.0, 1.1])
def test_a_design_for_a_late_gauge_is_stable_with_it(delay: float, gain: float) -> None:
    found = designed(delay, gain, 40.0)
    assert isinstance(found, Design) and found.passed
    for payload in (0.020, 0.025, 0.030, 0.035, 0.040):
        assert is_stable(found, found.model, payload)
        margin = found.at(payload).phase_margin
        assert abs(margin) >= fl.deg(40) - 1e-6


@pytest.mark.slow
def test_a_late_gauge_is_refused_with_a_request_that_works() -> None:
    nearest = designed(0.030)
    assert not isinstance(nearest, Design) and nearest
    model = replace(MODEL, gauge_delay=0.030)
    found = fl.design(model, RIG, **(WANTED | nearest), law=False)
    assert found.passed
    assert all(
        is_stable(found, model, payload)
        for payload in (0.020, 0.025, 0.030, 0.035, 0.040)
    )


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0.057, 0.090])
def test_a_crossing_on_a_lobe_of_a_very_late_gauge_is_no_crossover(
    delay: float,
) -> None:
    """At 60 rad/s |L| is one again, and the vibration is as before."""
    late = replace(MODEL, gauge_delay=delay)
    with pytest.raises(InfeasibleError, match="crosses beyond the resonance") as caught:
        fl.design(late, RIG, **WANTED, law=False)
    assert f"the gauge is {1e3 * delay:g} ms late" in str(caught.value)


@pytest.mark.slow
def test_no_crossing_below_the_nyquist_frequency_is_overlooked() -> None:
    """A gauge 1 ms late raises |L| up to 785 rad/s, past forty times the resonance."""
    late = replace(MODEL, gauge_delay=0.001)
    asked = {"gain_crossover": 16.0, "phase_margin": fl.deg(35)}
    made = fl.design(late, RIG, payloads=(0.020, 0.040), **asked, law=False)
    (row,) = (one for one in made.requirements if one.name == "last gain crossing")
    w = FREQUENCY[::10]
    for payload in (0.020, 0.030, 0.040):
        gain = np.abs(made.full_loop(w, made.natural_frequency(payload)))
        assert w[gain > 1.0].max() <= row.achieved <= row.wanted


def test_a_design_that_does_not_know_the_delay_is_unstable_with_it() -> None:
    blind = fl.design(MODEL, RIG, **WANTED, **IDEAL, law=False)
    late = replace(MODEL, gauge_delay=0.057)
    assert is_stable(blind, MODEL, 0.020)
    assert not all(is_stable(blind, late, payload) for payload in (0.020, 0.030, 0.040))


def test_a_delay_of_the_logger_alone_is_not_in_the_loop() -> None:
    rig = replace(RIG, gauge=replace(RIG.gauge, delay_in_loop=False))
    model = replace(MODEL, gauge_delay=0.057)
    assert (
        fl.design(model, rig, **WANTED, law=False).controller
        == fl.design(MODEL, RIG, **WANTED, law=False).controller
    )
    # Nor does the interval of the fitted delay: the box contains the tolerance of a
    # gauge without delay.
    found = replace(
        model, intervals=(("gauge_delay", 0.055, 0.059), ("order", 1.91, 1.93))
    )
    made = fl.design(found, rig, **WANTED, law=False)
    assert fl.ParameterBox.of(made.model, rig).gauge_delay == (
        0.0,
        rig.tolerances.gauge_delay,
    )
    assert made.model.interval("order") == (1.91, 1.93)


@pytest.mark.slow
def test_random_loops_count_their_encirclements_as_the_winding_does() -> None:
    rng = np.random.default_rng(3)
    base = fl.design(MODEL, RIG, **WANTED, **IDEAL, filter_time=0.0, law=False)
    verdicts = set()
    for _ in range(40):
        mode = SecondMode(
            rng.uniform(60, 250), rng.uniform(0.01, 0.3), rng.uniform(0.01, 0.05)
        )
        model = replace(
            MODEL,
            order=rng.choice([1.85, 1.92, 1.98]),
            gauge_delay=rng.choice([0.0, 0.008, 0.02, 0.057, 0.09]),
            gauge_gain=rng.uniform(0.7, 1.4),
            second_mode=mode if rng.random() < 0.5 else None,
        )
        controller = replace(
            base.controller,
            derivative_gain=base.controller.derivative_gain * rng.uniform(0.3, 4.0),
        )
        loop = Loop.of(controller, model, RIG)
        payload = rng.uniform(0.015, 0.05)
        trial = replace(base, controller=controller)
        frequency = model.at_payload(payload).natural_frequency
        stable = bool(loop.margins(frequency)[1][0] > 0.0)
        assert stable == is_stable(trial, model, payload)
        verdicts.add(stable)
    assert verdicts == {True, False}
