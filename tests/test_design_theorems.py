"""Lemma 1, Theorem 1, Remark 1 and Theorem 2 for random admissible parameters, and the
exact condition.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from fraclink.extend import Loop


@dataclass(frozen=True)
class Case:
    loop: Loop
    pi: float
    crossover: float


@st.composite
def cases(draw: st.DrawFn, *, right_of_39: bool) -> Case:
    """A loop (34) with 1 < λ <= 2, 0 < β < λ, ω₀ > 1 and a crossover ω_c that meets
    (39) or does not.
    """
    order = draw(st.floats(1.05, 2.0))
    beta = order * draw(st.floats(0.05, 0.95))
    pi = draw(st.floats(1.5, 40.0))
    bare = Loop(gain=1.0, order=beta, link_order=order)
    ratio = draw(st.floats(1.02, 8.0)) if right_of_39 else draw(st.floats(0.3, 1.0))
    crossover = bare.sufficient(pi) * ratio
    gain = math.exp(-float(bare.log(crossover, pi).real))
    return Case(Loop(gain=gain, order=beta, link_order=order), pi, crossover)


def last_crossing(loop: Loop, pi: float) -> tuple[float, float]:
    """(ω_c, φ_m) of the falling crossover."""
    found = loop.crossings(pi)
    last = int(np.argmax(found.frequency))
    return float(found.frequency[last]), float(found.phase[last] + math.pi)


def denominator_49(case: Case) -> float:
    """The denominator of (49), which is positive above the peak of |L|."""
    loop, pi, w = case.loop, case.pi, case.crossover
    cosine, power = math.cos(0.5 * math.pi * loop.link_order), w**loop.link_order
    return (loop.link_order - loop.order) * power * (
        power + cosine * pi**2
    ) - loop.order * pi**2 * (pi**2 + cosine * power)


@settings(max_examples=150, deadline=None)
@given(cases(right_of_39=True))
def test_lemma_1_phase_falls_between_its_limits(case: Case):
    w = np.geomspace(1e-6, 1e6, 400) * case.crossover
    phase = case.loop.log(w, case.pi).imag
    assert np.all(np.diff(phase) <= 1e-12)
    half = 0.5 * math.pi
    assert phase[0] <= half * case.loop.order + 1e-9
    assert phase[-1] >= half * (case.loop.order - case.loop.link_order) - 1e-9


@settings(max_examples=150, deadline=None)
@given(cases(right_of_39=True), st.floats(1.1, 5.0))
def test_lemma_1_homothety(case: Case, factor: float):
    x = np.geomspace(0.01, 100.0, 50)
    scale = 2.0 / case.loop.link_order
    first = case.loop(x * case.pi**scale, case.pi)
    second = case.loop(x * (factor * case.pi) ** scale, factor * case.pi)
    ratio = factor ** (scale * case.loop.order)
    assert np.allclose(second, ratio * first, rtol=1e-9)


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(cases(right_of_39=True))
def test_theorem_1_and_remark_1(case: Case):
    """If (39) holds, φ_m falls and ω_c rises with ω₀, and the denominator of (49) is
    positive.
    """
    assert denominator_49(case) > 0.0
    crossovers, margins = zip(
        *(last_crossing(case.loop, case.pi * f) for f in (1.0, 1.05, 1.2, 2.0)),
        strict=True,
    )
    assert np.all(np.diff(crossovers) > 0.0)
    assert np.all(np.diff(margins) <= 1e-9)


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(cases(right_of_39=True), st.floats(1.0, 20.0))
def test_theorem_2_condition_39_is_inherited(case: Case, factor: float):
    crossover, _ = last_crossing(case.loop, case.pi * factor)
    assert crossover > case.loop.sufficient(case.pi * factor) * (1.0 - 1e-9)


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(cases(right_of_39=False))
def test_exact_condition_is_the_slope_and_reaches_further_than_39(case: Case):
    """Also where (39) does not hold, the denominator of (49) has the opposite sign of
    the slope and decides monotonicity.
    """
    # At the pole of an undamped link no finite gain gives a crossover.
    assume(abs(case.crossover / case.pi ** (2.0 / case.loop.link_order) - 1.0) > 1e-6)
    slope = float(case.loop.slope(case.crossover, case.pi).real)
    # A controller with zero gain has no meaningful crossover.
    assume(abs(slope) > 1e-3 and case.loop.gain > 1e-9)
    exact = denominator_49(case)
    assert (exact > 0.0) == (slope < 0.0)
    if exact > 0.0:
        step = 1.0 + 1e-4
        first, second = (
            float(case.loop.crossings(case.pi * f).phase[-1]) for f in (1.0, step)
        )
        assert second <= first + 1e-9


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(cases(right_of_39=True))
def test_crossings_are_exact_and_complete(case: Case):
    found = case.loop.crossings(case.pi)
    assert found.frequency.size == 2
    assert np.allclose(np.abs(case.loop(found.frequency, case.pi)), 1.0, rtol=1e-11)
    assert np.isclose(found.frequency[-1], case.crossover, rtol=1e-9)
    grid = np.geomspace(found.frequency[0] * 1.001, found.frequency[1] * 0.999, 200)
    assert np.all(np.abs(case.loop(grid, case.pi)) > 1.0)
