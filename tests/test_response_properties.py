"""Random systems: modes against contour integrals, superposition, shifts, and reliable
error estimates.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from fracsys import (
    FractionalTransferFunction,
    discrete_modes,
    s,
    step_response,
    time_response,
)

orders = st.floats(0.05, 1.98).map(lambda x: round(x, 3))
factors = st.builds(lambda a, c: (a, c), orders, st.floats(-3, 6).map(math.exp))


@st.composite
def stable_systems(draw: st.DrawFn) -> FractionalTransferFunction:
    """Products of 1/(s^a + c), a < 2, c > 0 (stable for any such a), with a sum of
    lower powers in the numerator.
    """
    G = draw(st.floats(-2, 2).filter(lambda g: abs(g) > 0.01)) + 0 * s
    for order, constant in draw(st.lists(factors, min_size=1, max_size=3)):
        G = G * constant / (s**order + constant)
    if draw(st.booleans()):
        G = G * (1 + draw(st.floats(0.1, 10.0)) * s ** (0.9 * G.relative_degree))
    return G


@pytest.mark.slow
@settings(deadline=None, max_examples=80)
@given(
    G=stable_systems(),
    period=st.floats(-6, -2).map(math.exp),
    count=st.integers(2, 2000),
)
def test_modes_agree_with_contours(
    G: FractionalTransferFunction, period: float, count: int
) -> None:
    result = time_response(G, np.ones(count), period)
    index = np.unique(np.geomspace(1, count - 1, 6).astype(int))
    # The response at a single time is computed by a separate contour integral.
    exact = [float(step_response(G, [k * period]).output[0]) for k in index]
    peak = float(np.max(np.abs(result.output)))
    error = float(np.max(np.abs(result.output[index] - exact)))
    assert error <= 2e-10 * peak
    assert error <= 10 * result.error_estimate + 1e-13 * peak


@pytest.mark.slow
@settings(deadline=None, max_examples=30)
@given(
    G=stable_systems(),
    seed=st.integers(0, 2**32),
    shift=st.integers(0, 30),
    hold=st.sampled_from(["zero", "first"]),
)
def test_superposition_and_time_invariance(
    G: FractionalTransferFunction, seed: int, shift: int, hold: str
) -> None:
    generator = np.random.default_rng(seed)
    u, v = generator.normal(size=(2, 120))
    if hold == "first":
        u[0] = v[0] = (
            # the jump from rest to u[0] is not linear between samples
            0.0
        )
    y = time_response(G, u, 0.01, hold=hold).output
    both = time_response(G, 2 * u - 3 * v, 0.01, hold=hold).output
    scale = float(np.max(np.abs(y))) + float(np.max(np.abs(both))) + 1e-300
    np.testing.assert_allclose(
        both, 2 * y - 3 * time_response(G, v, 0.01, hold=hold).output, atol=1e-9 * scale
    )
    late = time_response(
        G, np.concatenate((np.zeros(shift), u)), 0.01, hold=hold
    ).output
    np.testing.assert_allclose(late[shift:], y, atol=1e-9 * scale)


@settings(deadline=None, max_examples=30)
@given(G=stable_systems(), delay=st.floats(0, 0.5), period=st.floats(0.002, 0.05))
def test_delayed_step_is_the_step_delayed(
    G: FractionalTransferFunction, delay: float, period: float
) -> None:
    late = step_response(G.delayed(delay), 1.0, period)
    earlier = np.maximum(late.time - delay, 0.0)
    earlier[np.abs(late.time - delay) <= 1e-12 * max(1.0, delay)] = 0.0
    on_time = step_response(G, earlier).output
    expected = np.where(late.time >= delay - 1e-12 * max(1.0, delay), on_time, 0.0)
    peak = float(np.max(np.abs(expected)))
    np.testing.assert_allclose(late.output, expected, atol=2e-10 * peak + 1e-300)


@pytest.mark.slow
@settings(deadline=None, max_examples=20)
@example(G=1 / (s**1.25 + 2 * s**0.625 + 1), tolerance=1e-4)  # a double pole
@given(G=stable_systems(), tolerance=st.floats(-12, -4).map(lambda x: 10.0**x))
def test_tolerance_is_kept(G: FractionalTransferFunction, tolerance: float) -> None:
    modes = discrete_modes(G, 0.01, span=10.0, tolerance=tolerance)
    exact = time_response(G, np.ones(1000), 0.01).output
    error = np.max(np.abs(modes.respond(np.ones(1000)) - exact))
    assert error <= (6 * tolerance + 2e-10) * np.max(np.abs(exact))


@pytest.mark.parametrize(
    ("G", "method", "hold"),
    [
        (1 / (s**1.5 + s + 1), "modes", "zero"),
        (1 / s**0.96, "contour", "zero"),
        (1 / s**0.96, "contour", "first"),
        (1 / (s + (0.5 + 0 * s).delayed(1.0) + 1), "fft", "zero"),
    ],
)
def test_estimates_grow_with_the_input(
    G: FractionalTransferFunction, method: str, hold: str
) -> None:
    """A response is linear in its input, and so is what its error may be."""
    u = np.sin(np.arange(60.0)) * (np.arange(60) > 0)
    once, often = (time_response(G, k * u, 0.1, hold=hold) for k in (1.0, 64.0))
    assert once.method == often.method == method
    np.testing.assert_allclose(often.output, 64.0 * once.output, rtol=1e-12)
    assert often.error_estimate == pytest.approx(64.0 * once.error_estimate)
    # one jump instead of sixty that partly cancel
    jump = time_response(G, np.ones(60), 0.1, hold=hold).error_estimate
    assert 0.0 < jump <= 60.0 * once.error_estimate
