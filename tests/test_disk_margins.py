"""Disk margins against polynomial roots, python-control, other verbs of the package and
their definition.
"""

from __future__ import annotations

import math
from typing import Any

import control
import numpy as np
import pytest
from numpy.polynomial import polynomial

import fraclink as fl
from fraclink._systems.disk_margins import _gains, _phase

s = fl.s
LINK = (0.148 * s**0.65 * 100 / (s**1.92 + 100)).delayed(0.01)
SKEWS = [-2.0, -1.0, -0.3, 0.0, 0.7, 1.0, 3.0]


def smallest(top: list[float], bottom: list[float], skew: float) -> float:
    """α of a rational loop (rising coefficients) from the real roots of the derivative
    of its square.
    """

    def square(p: np.ndarray) -> np.ndarray:
        """|p(jω)|² as a polynomial in x = ω²."""
        even, odd = (
            p[0::2] * (-1.0) ** np.arange(len(p[0::2])),
            p[1::2] * (-1.0) ** np.arange(len(p[1::2])),
        )
        return np.asarray(
            polynomial.polyadd(
                polynomial.polymul(even, even), [0, *polynomial.polymul(odd, odd)]
            )
        )

    n, d = np.array(top), np.array(bottom)
    up = square(polynomial.polyadd(n, d))
    down = square(polynomial.polysub((1 + skew) * d, (1 - skew) * n))
    turning = polynomial.polysub(
        polynomial.polymul(polynomial.polyder(up), down),
        polynomial.polymul(up, polynomial.polyder(down)),
    )
    places = [
        r.real
        for r in polynomial.polyroots(turning)
        if r.real > 0 and abs(r.imag) < 1e-6 * abs(r)
    ]
    values = [
        polynomial.polyval(x, up) / polynomial.polyval(x, down)
        for x in (*places, 1e-14, 1e14)
    ]
    return 2 * math.sqrt(min(values))


def rational(top: list[float], bottom: list[float]) -> fl.FractionalTransferFunction:
    zero = 0 * s
    return sum((c * s**k for k, c in enumerate(top)), zero) / sum(
        (c * s**k for k, c in enumerate(bottom)), zero
    )


@pytest.mark.slow
def test_random_rational_loops() -> None:
    rng, count = np.random.default_rng(7), 0
    while count < 60:
        poles = -(10.0 ** rng.uniform(-1, 2, 3))
        bottom = polynomial.polyfromroots(poles).tolist()
        top = (
            10.0 ** rng.uniform(-1, 2)
            * np.array([1.0, rng.normal()])
            * abs(np.prod(poles))
        ).tolist()
        loop = rational(top, bottom)
        if not fl.is_stable(loop.feedback()):
            continue
        count += 1
        skew = float(rng.uniform(-2, 2))
        assert fl.disk_margin(loop, skew=skew).alpha == pytest.approx(
            smallest(top, bottom, skew), rel=1e-9
        )


@pytest.mark.parametrize("skew", SKEWS)
def test_as_python_control_on_a_fine_grid(skew: float) -> None:
    loop = control.tf([25], [1, 10, 10, 10])
    alpha, _, phase = control.disk_margins(loop, np.linspace(1.7, 2.2, 2001), skew=skew)
    for given in (25 / (s**3 + 10 * s**2 + 10 * s + 10), loop):
        found = fl.disk_margin(given, skew=skew, unstable_poles=0)
        assert found.alpha == pytest.approx(
            alpha, rel=1e-6
        ) and found.alpha <= alpha * (1 + 1e-12)
        assert math.degrees(found.phase_margin) == pytest.approx(phase, rel=1e-6)
        assert found.stable is True


@pytest.mark.parametrize("skew", SKEWS)
def test_the_perturbation_has_the_size_and_destabilises(skew: float) -> None:
    found = fl.disk_margin(LINK, skew=skew)
    f = found.perturbation
    assert abs(1 + f * LINK(1j * found.frequency)) < 1e-12
    delta = 2 * (f - 1) / ((1 - skew) + (1 + skew) * f)
    assert abs(delta) == pytest.approx(found.alpha, rel=1e-12)
    w = np.geomspace(1e-3, 1e4, 40_001)
    values = LINK(1j * w)
    assert np.min(
        2 * np.abs(1 + values) / np.abs((1 + skew) - (1 - skew) * values)
    ) >= found.alpha * (1 - 1e-12)


@pytest.mark.parametrize("skew", SKEWS)
def test_what_is_guaranteed_holds(skew: float) -> None:
    """Gains and phases inside the margins leave the loop stable; the disk touches both
    ends.
    """
    loop = 0.148 * s**0.65 * 100 / (s**1.92 + 100)
    found = fl.disk_margin(loop, skew=skew)
    low, high = found.gain_margin
    for gain in (max(low, 1e-3) * 1.001, min(high, 1e3) * 0.999):
        assert fl.is_stable((gain * loop).feedback())
    assert found.phase_margin <= abs(fl.margins(loop).phase_margin)
    for f in (low, high, complex(np.exp(1j * found.phase_margin))):
        if abs(f) < math.inf:
            delta = 2 * (f - 1) / ((1 - skew) + (1 + skew) * f)
            assert abs(delta) == pytest.approx(found.alpha, rel=1e-9)


def test_skews_that_are_other_margins() -> None:
    assert fl.disk_margin(LINK, skew=1.0).alpha == pytest.approx(
        fl.margins(LINK).modulus_margin, rel=1e-13
    )
    plain = 0.148 * s**0.65 * 100 / (s**1.92 + 100)
    assert fl.disk_margin(plain, skew=-1.0).alpha == pytest.approx(
        1 / fl.norm(plain.feedback(), math.inf), rel=1e-13
    )


def test_limits() -> None:
    one = fl.disk_margin(1 / s)
    assert (one.alpha, one.gain_margin) == (
        pytest.approx(2),
        (pytest.approx(0, abs=1e-15), math.inf),
    )
    assert one.phase_margin == pytest.approx(math.pi / 2)
    sensitive = fl.disk_margin(1 / s, skew=1.0)
    assert (sensitive.alpha, sensitive.frequency) == (1.0, math.inf)
    other = fl.disk_margin(1 / s**0.5, skew=-1.0)
    assert (other.alpha, other.frequency, other.perturbation) == (1.0, 0.0, 0j)
    assert fl.disk_margin(1 / (1 + s), skew=5.0).phase_margin > 0
    assert "phase ±" in str(one)


def test_refusals() -> None:
    with pytest.raises(fl.errors.UnstableError) as refused:
        fl.disk_margin(100 / (s**3 + s**2 + s + 1))
    assert refused.value.field == "loop" and refused.value.remedy
    with pytest.raises(fl.errors.FieldError) as out:
        fl.disk_margin(1 / s, skew=11.0)
    assert out.value.field == "skew"
    assert fl.disk_margin(lambda z: 1 / (z + 1)).stable is None


def test_the_three_printed_lines() -> None:
    found = fl.disk_margin(25 / (s**3 + 10 * s**2 + 10 * s + 10))
    alpha = smallest([25.0], [10.0, 10.0, 10.0, 1.0], 0.0)
    low, high = (1 - alpha / 2) / (1 + alpha / 2), (1 + alpha / 2) / (1 - alpha / 2)
    lines = str(found).splitlines()
    assert (
        lines[0]
        == f"disk margin     {alpha:12.6g} (skew 0) at {found.frequency:.6g} rad/s"
    )
    phase = math.degrees(2 * math.atan(alpha / 2))
    assert (
        lines[1] == f"tolerated       gain {low:.4g} … {high:.4g}, phase ±{phase:.3f}°"
    )
    assert lines[2] == "closed loop     stable"
    assert str(fl.disk_margin(lambda z: 1 / (z + 1))).endswith(
        "not decided: give unstable_poles"
    )


@pytest.mark.parametrize("alpha", [0.3, 0.9, 1.6])
@pytest.mark.parametrize("skew", [-1.5, -1.0, 0.0, 0.4, 1.0, 2.0])
def test_gains_and_phases_are_where_the_disk_meets_axis_and_circle(
    alpha: float, skew: float
) -> None:
    """|δ(f)| is below α from f = 1 to each end, α there, and above it beyond."""

    def size(f: Any) -> Any:
        return np.abs(2 * (f - 1) / ((1 - skew) + (1 + skew) * f))

    inside = np.linspace(0.01, 0.999, 200)
    for end in _gains(alpha, skew):
        if abs(end) < math.inf:
            assert size(end) == pytest.approx(alpha, rel=1e-12)
            assert (
                np.all(size(1 + (end - 1) * inside) < alpha)
                and size(1 + (end - 1) * 1.001) > alpha
            )
    phase = _phase(alpha, skew)
    if phase == math.inf:
        assert np.all(size(np.exp(1j * np.linspace(0.0, math.pi, 200))) <= alpha)
    else:
        assert size(np.exp(1j * phase)) == pytest.approx(alpha, rel=1e-12)
        assert np.all(size(np.exp(1j * phase * inside)) < alpha)


def test_disks_that_reach_infinity() -> None:
    """With α(1 + σ) ≥ 2 the disk is a half plane or the outside of a circle: every
    larger gain is borne.
    """
    assert _gains(2.0, 0.0) == (0.0, math.inf)
    assert _gains(1.0, 1.0) == (0.5, math.inf)
    assert _gains(1.0, -3.0)[0] == -math.inf  # (1 + σ)α/2 = −1
    assert _gains(0.999, 1.0)[1] == pytest.approx(1000.0)
    assert _phase(1.0, 2.0) == math.inf and _phase(0.999, 2.0) < math.pi
    assert _phase(1.0, -2.0) == math.inf
    silent = fl.disk_margin(0 * s)
    assert (silent.alpha, silent.phase_margin) == (2.0, pytest.approx(math.pi / 2))


def test_a_limit_hides_what_lies_beyond_it() -> None:
    loop = 25 / (s**3 + 10 * s**2 + 10 * s + 10)
    whole = fl.disk_margin(loop)
    seen = fl.disk_margin(loop, limit=1.0)
    at = 25 / ((1j) ** 3 + 10 * (1j) ** 2 + 10j + 10)
    assert seen.alpha == pytest.approx(2 * abs(1 + at) / abs(1 - at), rel=1e-6)
    assert seen.frequency == pytest.approx(1.0) and seen.alpha > whole.alpha
    assert fl.disk_margin(loop, limit=100.0).alpha == pytest.approx(
        whole.alpha, rel=1e-12
    )
    # S − T of s + 1 tends to (1 − L)/(1 + L) = −1: α is 2 at ω → ∞, which a limit of 1
    # rad/s does not show.
    assert fl.disk_margin(2 * s + 3, skew=0.0).frequency == math.inf
    assert fl.disk_margin(2 * s + 3, skew=0.0, limit=1.0).frequency < 1.0 + 1e-9
