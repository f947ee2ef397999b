"""The formulas of the rivals against those of the textbooks: shaper, PD with notch, LQG."""

from __future__ import annotations

import cmath
import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import expm

import fraclink as fl
from fraclink.trials import Rival, builders

RIG = fl.Rig.named("paper-2023-geared")
PERIOD = RIG.period
GRID = np.geomspace(0.5, 300.0, 40)
Real = NDArray[np.float64]


@pytest.fixture(scope="module")
def design() -> fl.Design:
    assert RIG.model is not None
    link = replace(RIG.model, second_mode=fl.SecondMode(180.0, 0.02, 0.02))
    request = {"gain_crossover": 12.0, "phase_margin": fl.deg(45.0)}
    return fl.design(link, RIG, payloads=(0.020, 0.040), **request)


@pytest.fixture(scope="module")
def lqg(design: fl.Design) -> Rival:
    return builders(design)["LQG"]()


def mode(design: fl.Design) -> complex:
    """The pole of s^λ = −ω₀² at the nominal payload, by hand."""
    link = design.model
    assert link.payload is not None
    ratio = link.payload / design.rig.payloads.nominal
    size = (link.natural_frequency**2 * ratio) ** (1.0 / link.order)
    return cmath.rect(size, math.pi / link.order)


def gain_of(rival: Rival) -> float:
    """The tuned gain, printed with four digits."""
    return float(rival.knob.split()[1])


def test_the_shaper_has_the_amplitudes_and_times_of_singer_and_seering(
    design: fl.Design,
) -> None:
    pole = mode(design)
    (first, large), (second, small) = builders(design)["ZV shaping"]().impulses
    # K = exp(−ζπ/√(1 − ζ²)), after half a damped period
    decay = math.exp(pole.real * math.pi / pole.imag)
    assert first == 0.0
    assert second == pytest.approx(math.pi / pole.imag, rel=1e-12)
    assert large == pytest.approx(1.0 / (1.0 + decay), rel=1e-12)
    assert small == pytest.approx(decay / (1.0 + decay), rel=1e-12)
    # by definition: together the impulses leave no vibration of the mode
    left = large + small * cmath.exp(-pole * second)
    assert abs(left) < 1e-12


def test_the_shaped_reference_is_the_convolution(design: fl.Design) -> None:
    move = fl.smooth_step(1.0, duration=0.4)
    rival = builders(design)["ZV shaping"]()
    shaped = rival.shaped(move)
    time = np.linspace(-0.1, 1.5, 200)
    for order in (0, 1, 2):
        wanted = sum(
            size * move.derivative(time - delay, order)
            for delay, size in rival.impulses
        )
        np.testing.assert_allclose(shaped.derivative(time, order), wanted, atol=1e-12)
    assert shaped.duration == pytest.approx(0.4 + rival.impulses[1][0])


@pytest.mark.slow
def test_the_pd_has_its_zero_at_the_mode_and_a_notch_at_the_second(
    design: fl.Design,
) -> None:
    """k (1 + s/ω₁)/(1 + s/100)·(s² + 2ζ₂ω₂s + ω₂²)/(s² + 1.4ω₂s + ω₂²) at Tustin's s."""
    rival = builders(design)["PD on the tip"]()
    z = np.exp(1j * GRID * PERIOD)
    s = 2.0 / PERIOD * (z - 1.0) / (z + 1.0)
    notch = (s**2 + 2 * 0.02 * 180.0 * s + 180.0**2) / (
        s**2 + math.sqrt(2.0) * 180.0 * s + 180**2
    )
    wanted = (1.0 + s / abs(mode(design))) / (1.0 + s / 100.0) * notch
    response = rival.law.frequency_response(GRID)
    np.testing.assert_allclose(response, gain_of(rival) * wanted, rtol=1e-3)


# --- LQG, written out -----------------------------------------------------------------


def riccati(a: Real, b: Real, q: Real, r: float) -> Real:
    """P of the regulator by Riccati's difference equation, repeated until it stands."""
    p = q.copy()
    for _ in range(100_000):
        before, row = p, b @ p @ a
        p = a.T @ p @ a - np.outer(row, row) / (r + b @ p @ b) + q
        if np.allclose(p, before, rtol=1e-12, atol=0.0):
            break
    return p


def held_arm(design: fl.Design) -> tuple[Real, Real, Real]:
    """(A, b, c) of motor loop, mode and one period of delay for each computed one."""
    loop, pole = design.rig.motor_loop, mode(design)
    square, twice = abs(pole) ** 2, -2.0 * pole.real
    whole = np.zeros((5, 5))
    whole[0, 1] = whole[2, 3] = 1.0
    whole[1] = [-(loop.pole**2), -2.0 * loop.pole, 0.0, 0.0, loop.pole**2]
    whole[3] = [square, 0.0, -square, -twice, 0.0]
    held = expm(whole * PERIOD)
    n = 4 + loop.delay_samples
    a, b = np.zeros((n, n)), np.zeros(n)
    a[:4, :4] = held[:4, :4]
    if loop.delay_samples:
        a[:4, 4] = held[:4, 4]
        b[4] = 1.0
    else:
        b[:4] = held[:4, 4]
    c = np.zeros(n)
    c[2] = 1.0
    return a, b, c


@pytest.mark.slow
def test_lqg_is_the_regulator_and_the_filter_of_its_riccati_equations(
    design: fl.Design, lqg: Rival
) -> None:
    a, b, c = held_arm(design)
    n = len(a)
    weight = 1.0 / gain_of(lqg)
    cost = riccati(a, b, np.outer(c, c), weight)
    gain = (b @ cost @ a) / (weight + b @ cost @ b)
    # The gauge's offset is one state more: it adds to what is measured, and nothing
    # moves it but its random walk of 3 mrad in ten seconds.
    wide, seen = np.eye(n + 1), np.append(c, 1.0)
    wide[:n, :n] = a
    noise = np.zeros((n + 1, n + 1))
    noise[:n, :n] = np.outer(b, b) * 0.01**2 + 1e-12 * np.eye(n)
    noise[n, n] = 3e-3**2 * PERIOD / 10.0
    sigma = design.rig.gauge.noise / design.model.stiffness
    # the filter is the regulator of the dual
    spread = riccati(wide.T, seen, noise, sigma**2)
    filtered = spread @ seen / (sigma**2 + seen @ spread @ seen)
    drive, act = np.append(b, 0.0), np.append(gain, 0.0)
    wanted = []
    for z in np.exp(1j * GRID * PERIOD):
        # x̂ = x̄ + K (y − c x̄), u = −k x̂, x̄ next = A x̂ + b u; the correction is −u/e
        # with y = −e
        correct = np.eye(n + 1) - np.outer(filtered, seen)
        closed = (wide - np.outer(drive, act)) @ correct
        enter = (wide - np.outer(drive, act)) @ filtered
        state = np.linalg.solve(z * np.eye(n + 1) - closed, enter)
        wanted.append(act @ (correct @ state + filtered))
    response = lqg.law.frequency_response(GRID)
    np.testing.assert_allclose(response, wanted, rtol=3e-3)


@pytest.mark.slow
def test_lqg_takes_a_constant_reading_for_the_gauges_offset(lqg: Rival) -> None:
    """A gauge that reads a constant is no reason to move: the offset's state takes it."""
    slow, usual = np.abs(lqg.law.frequency_response(np.array([1e-5, 10.0])))
    assert slow < 1e-3 * usual
