"""Poles, verdicts and delayed denominators against polynomial roots, closed forms and
delay margins.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fraclink.errors import FieldError
from fracsys import (
    FractionalTransferFunction,
    is_stable,
    margins,
    poles,
    s,
    step_response,
)


def test_poles_of_integer_systems_are_the_polynomial_roots() -> None:
    system = (s + 5) / ((s + 1) * (s**2 + 2 * s + 10) * s)
    found = poles(system)
    assert len(found) == 4
    for root in (-1, -1 - 3j, -1 + 3j, 0):
        assert np.min(np.abs(found - root)) < 1e-13


@pytest.mark.parametrize("order", [1.01, 1.2, 1.5, 1.92, 1.999, 2.0])
def test_pole_pair_of_the_link(order: float) -> None:
    """ω₀^(2/λ) e^(±jπ/λ); damping ratio −cos(π/λ) (ERRATA, units)."""
    w = 11.094
    found = poles(1.56 * s**order / (s**order + w**2))
    size = w ** (2 / order)
    exact = size * np.exp(1j * math.pi / order)
    if order == 1.01:
        assert found.size == 2 and abs(found[0] - exact) < 1e-12 * size
    assert found.tolist() == pytest.approx(
        [exact, exact.conjugate()], rel=1e-13, abs=1e-12 * size
    )


def test_poles_on_other_sheets_are_none() -> None:
    assert poles(1 / (s**0.5 + 1)).size == 0
    assert poles(1 / (s**0.99 + 1)).size == 0
    assert poles(1 / (s + 1)).tolist() == [-1]


def test_cancelled_poles_are_left_out_and_named() -> None:
    hidden = (s - 1) / ((s - 1) * (s + 2))
    assert poles(hidden).tolist() == pytest.approx([-2])
    assert "cancels the pole at 1 rad/s" in is_stable(hidden).reason
    double = (s + 1) / ((s + 1) ** 2)
    assert poles(double).tolist() == pytest.approx([-1])
    fractional = (s**0.7 - 2) / ((s**0.7 - 2) * (s + 3))
    assert poles(fractional).tolist() == pytest.approx([-3])


@pytest.mark.parametrize(
    ("system", "stable", "integrators", "winding", "words"),
    [
        (1 / (s**1.5 + 1), True, 0, 0, "no pole"),
        (1 / (s**1.999 + 1), True, 0, 0, "no pole"),
        (1 / (s**2 + 1), False, 0, 0, "imaginary axis at 0 ± 1j"),
        (1 / (s**2.001 + 1), False, 0, 2, "2 poles have Re s > 0"),
        (1 / s, False, 1, 0, "s divides"),
        (1 / s**0.5, False, 0.5, 0, "s^0.5 divides"),
        (s**0.5 / (s + 1), True, 0, 0, "no pole"),
        (s**0.65, True, 0, 0, "improper"),
        (1 / (s - 1), False, 0, 1, "1 pole has"),
        (1 / (s**0.5 - 1), False, 0, 1, "rightmost at 1 rad/s"),
        (1 / ((s - 1) * s), False, 1, 1, "1 pole has"),
        (2 / (s**2 - 2 * s + 1), False, 0, 2, "2 poles have"),
    ],
)
def test_verdicts(
    system: FractionalTransferFunction,
    stable: bool,
    integrators: float,
    winding: int,
    words: str,
) -> None:
    verdict = is_stable(system)
    assert (bool(verdict), verdict.stable, verdict.integrators) == (
        stable,
        stable,
        integrators,
    )
    assert verdict.winding == winding
    assert words in verdict.reason
    assert all(p.real >= 0 for p in verdict.unstable_poles)


@pytest.mark.slow
@given(
    st.lists(st.floats(0.1, 6) | st.floats(-3, -0.1), min_size=1, max_size=3),
    st.floats(0.4, 1.6).filter(lambda a: abs(a - 1) > 0.02),
)
@settings(max_examples=100, deadline=None)
def test_products_of_known_factors(shifts: list[float], order: float) -> None:
    """Π (s^a + c): unstable by each c < 0 (arg 0), and by each pair π/a < π/2 never for
    a < 2.
    """
    system: FractionalTransferFunction = 1 / (s**order + shifts[0])
    for c in shifts[1:]:
        system = system / (s**order + c)
    unstable = sum(c < 0 for c in shifts)
    verdict = is_stable(system)
    assert verdict.winding == unstable
    assert bool(verdict) is (unstable == 0)
    pairs = sum(c > 0 for c in shifts) if order > 1 else 0
    assert len(poles(system)) == unstable + 2 * pairs


@pytest.mark.parametrize(
    "loop",
    [
        10 / (s + 1),
        0.07 * s**0.6 * 100 / (s**1.92 + 100),
        3 / (s**0.5 * (s + 1)),
        20 / (s**1.5 + 2 * s**0.7 + 1),
    ],
)
def test_delay_in_the_loop_agrees_with_the_delay_margin(
    loop: FractionalTransferFunction,
) -> None:
    spare = margins(loop).delay_margin
    assert is_stable(loop.delayed(0.99 * spare).feedback())
    late = is_stable(loop.delayed(1.01 * spare).feedback())
    assert not late
    assert late.winding == 2
    assert late.reason == "2 poles have Re s > 0"


def test_number_of_unstable_poles_with_a_large_delay() -> None:
    """s + 1 + 10 e^(−τs): a pair crosses at each τ with ωτ = π − atan ω + 2πm, ω = √99."""
    w = math.sqrt(99)
    crossings = [(math.pi - math.atan(w) + 2 * math.pi * m) / w for m in range(5)]
    for m, (low, high) in enumerate(itertools.pairwise(crossings)):
        closed = (10 / (s + 1)).delayed(0.5 * (low + high)).feedback()
        assert is_stable(closed).winding == 2 * (m + 1)


def test_delayed_integrator_in_the_denominator() -> None:
    """s + k e^(−s) is stable for 0 < k < π/2."""
    assert is_stable(1 / (s + (1.57 + 0 * s).delayed(1.0)))
    assert not is_stable(1 / (s + (1.572 + 0 * s).delayed(1.0)))


def rightmost_root(gain: float) -> float:
    """Largest Re s of s + 1 + gain (s + 2) e^(-s) = 0, by Newton's method from a grid,
    independent of the counting.
    """
    re, im = np.meshgrid(np.linspace(-3.0, 1.5, 40), np.linspace(0.0, 60.0, 400))
    z = (re + 1j * im).ravel()
    with np.errstate(all="ignore"):  # diverging starts are dropped below
        for _ in range(60):
            late = gain * np.exp(-z)
            z = z - (z + 1.0 + (z + 2.0) * late) / (1.0 + late - (z + 2.0) * late)
        left = np.abs(z + 1.0 + gain * (z + 2.0) * np.exp(-z))
    return float(
        np.max(z.real[np.isfinite(left) & (left < 1e-9) & (np.abs(z) < 200.0)])
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "gain", [-1.5, -1.0, -0.9, -0.6, -0.4, 0.1, 0.3, 0.5, 0.7, 0.95, 1.0, 2.0]
)
def test_neutral_loops_have_one_verdict(gain: float) -> None:
    """The closed loop of L = k (s + 2)/(s + 1) e^(-s): with |k| < 1 its far poles decay
    like ln |k|.
    """
    loop = (gain * (s + 2) / (s + 1)).delayed(1.0)
    verdict, found = is_stable(loop.feedback()), margins(loop)
    truth = abs(gain) < 1.0 and rightmost_root(gain) < 0.0
    assert verdict.stable == truth
    assert found.stable == truth or (abs(gain) == 1.0 and found.stable is None)
    if abs(gain) >= 1.0:
        assert verdict.winding == -1 and "infinitely many" in verdict.reason
    # Its jumps never end: no sample of a numerical inversion would be as accurate as
    # claimed.
    with pytest.raises(FieldError, match="jumps anew"):
        step_response(loop.feedback(), 4.0, 0.01)


def test_what_cannot_be_decided_says_why() -> None:
    with pytest.raises(FieldError, match="infinitely many poles"):
        poles((1 / (s + 1)).delayed(0.1).feedback())
    with pytest.raises(FieldError, match="imaginary axis"):
        is_stable(1 / (s + (0.5 * math.pi + 0 * s).delayed(1.0)))


def test_a_published_benchmark() -> None:
    """0.8 s^2.2 + 0.5 s^0.9 + 1 (Petráš, Fract. Calc. Appl. Anal. 12 (2009) 269): with
    w = s^(1/10) the pair next to the sector's edge is 1.0045 ± 0.1684j there, found by
    making the orders commensurate.
    """
    found = poles(1 / (0.8 * s**2.2 + 0.5 * s**0.9 + 1))
    assert np.exp(np.log(found) / 10).round(4).tolist() == [
        1.0045 + 0.1684j,
        1.0045 - 0.1684j,
    ]
    assert is_stable(1 / (0.8 * s**2.2 + 0.5 * s**0.9 + 1))


def test_a_pole_and_a_zero_at_the_origin_divide_out() -> None:
    assert is_stable(s / (s * (s + 1))) and is_stable(s**0.5 / s**0.5 * 1 / (s + 1))
    assert is_stable(s**0.3 / (s**0.5 * (s + 1))).integrators == pytest.approx(0.2)
    assert is_stable(s**2 / (s * (s + 1))).integrators == 0.0
    assert poles((s + 2) / (s**2 * (s + 1))).tolist() == pytest.approx([0, 0, -1])
    # a branch point is not a pole
    assert poles(1 / (s**1.5 * (s + 1))).tolist() == pytest.approx([-1])
    assert is_stable(0 * s).integrators == 0.0


def test_a_zero_cancels_one_pole_of_a_double_one_and_only_within_rounding() -> None:
    double = (s + 3) * (s + 1) / ((s + 1) ** 2 * (s + 4))
    assert sorted(poles(double).real) == pytest.approx([-4, -1])
    near = (s + 1 + 1e-8) * (s + 7) / ((s + 1) * (s + 2) * (s + 5))
    assert len(poles(near)) == 3
    same = (s + 1 + 1e-12) * (s + 7) / ((s + 1) * (s + 2) * (s + 5))
    assert len(poles(same)) == 2
    late = ((s + 1) * (s + 7)).delayed(0.1) / ((s + 1) * (s + 2) * (s + 5))
    assert len(poles(late)) == 2  # a common delay does not move any zero
    both = (s + (0 * s + 1).delayed(0.1)) / ((s + 1) * (s + 2) * (s + 5))
    assert len(poles(both)) == 3


def test_poles_come_in_pairs_and_exactly_on_the_axes() -> None:
    found = poles(1 / ((s + 2) * (s - 3) * (s**2 + 9) * (s**2 + s + 7)))
    assert set(found[found.imag == 0].real.round(12)) == {-2.0, 3.0}
    on_axis = found[found.real == 0.0]
    assert sorted(on_axis.imag) == pytest.approx([-3.0, 3.0], rel=1e-14)
    pair = found[(found.real != 0) & (found.imag != 0)]
    assert pair.sum().imag == 0.0 and pair.sum().real == pytest.approx(-1.0)
    assert np.all(np.diff(np.abs(np.angle(found))) >= -1e-14)  # sorted by argument


@pytest.mark.parametrize("order", [0.5, 1.0, 1.5])
def test_delayed_feedback_around_a_power(order: float) -> None:
    """s^a + k e^(−s): a pair crosses the axis at k = (π(1 − a/2))^a, and again 2π
    further on.
    """
    for turn, poles_ in ((0, 0), (1, 2), (2, 4)):
        low = (
            (math.pi * (1 - order / 2) + 2 * math.pi * (turn - 1)) ** order
            if turn
            else 0.0
        )
        high = (math.pi * (1 - order / 2) + 2 * math.pi * turn) ** order
        gain = 0.5 * (low + high)
        verdict = is_stable(1 / (s**order + (gain + 0 * s).delayed(1.0)))
        assert (verdict.winding, verdict.stable) == (poles_, poles_ == 0)
        assert verdict.unstable_poles == ()


def test_several_delays_and_orders_are_counted_as_their_roots() -> None:
    """s² + 0.4 s e^(−0.3 s) + 5 − k e^(−s): roots in Re s > 0 by Newton from a grid."""
    for k in (0.5, 3.0, 6.0, 20.0):
        re, im = np.meshgrid(np.linspace(0.0, 6.0, 60), np.linspace(-12.0, 12.0, 121))
        z = (re + 1j * im).ravel()
        with np.errstate(all="ignore"):
            for _ in range(50):
                value = z**2 + 0.4 * z * np.exp(-0.3 * z) + 5 - k * np.exp(-z)
                slope = 2 * z + 0.4 * np.exp(-0.3 * z) * (1 - 0.3 * z) + k * np.exp(-z)
                z = z - value / slope
            left = np.abs(z**2 + 0.4 * z * np.exp(-0.3 * z) + 5 - k * np.exp(-z))
        good = z[np.isfinite(left) & (left < 1e-9) & (z.real > 1e-9)]
        known = len({(round(p.real, 6), round(p.imag, 6) + 0.0) for p in good.tolist()})
        system = 1 / (s**2 + 0.4 * s.delayed(0.3) + 5 - (k + 0 * s).delayed(1.0))
        assert is_stable(system).winding == known


def test_a_neutral_loop_at_its_bound_and_below() -> None:
    """(s + 1) + g s e^(−s): for |g| = 1 there are poles arbitrarily close to the axis."""
    for gain, winding in ((0.999, 0), (-0.999, 0), (1.0, -1), (-1.0, -1), (1.5, -1)):
        assert is_stable(1 / (s + 1 + gain * s.delayed(1.0))).winding == winding
    assert "gain of 1 or more" in is_stable(1 / (s + 1 + s.delayed(1.0))).reason


@pytest.mark.slow
def test_terms_that_cancel_at_the_origin_are_refused() -> None:
    with pytest.raises(FieldError, match="what is zero at s = 0"):
        is_stable(1 / (s + 1 - (0 * s + 1).delayed(1.0)))
