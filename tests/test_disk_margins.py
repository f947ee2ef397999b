"""Disk margins against polynomial roots, python-control, other verbs of the package and their definition."""

from __future__ import annotations

import math

import control
import numpy as np
import pytest
from numpy.polynomial import polynomial

import fraclink as fl

s = fl.s
LINK = (0.148 * s**0.65 * 100 / (s**1.92 + 100)).delayed(0.01)
SKEWS = [-2.0, -1.0, -0.3, 0.0, 0.7, 1.0, 3.0]


def smallest(top: list[float], bottom: list[float], skew: float) -> float:
    """α of a rational loop (rising coefficients) from the real roots of the derivative of its square."""

    def square(p: np.ndarray) -> np.ndarray:
        """|p(jω)|² as a polynomial in x = ω²."""
        even, odd = p[0::2] * (-1.0) ** np.arange(len(p[0::2])), p[1::2] * (-1.0) ** np.arange(len(p[1::2]))
        return np.asarray(
            polynomial.polyadd(polynomial.polymul(even, even), [0, *polynomial.polymul(odd, odd)])
        )

    n, d = np.array(top), np.array(bottom)
    up = square(polynomial.polyadd(n, d))
    down = square(polynomial.polysub((1 + skew) * d, (1 - skew) * n))
    turning = polynomial.polysub(
        polynomial.polymul(polynomial.polyder(up), down), polynomial.polymul(up, polynomial.polyder(down))
    )
    places = [r.real for r in polynomial.polyroots(turning) if r.real > 0 and abs(r.imag) < 1e-6 * abs(r)]
    values = [polynomial.polyval(x, up) / polynomial.polyval(x, down) for x in (*places, 1e-14, 1e14)]
    return 2 * math.sqrt(min(values))


def rational(top: list[float], bottom: list[float]) -> fl.FractionalTransferFunction:
    zero = 0 * s
    return sum((c * s**k for k, c in enumerate(top)), zero) / sum(
        (c * s**k for k, c in enumerate(bottom)), zero
    )


def test_random_rational_loops() -> None:
    rng, count = np.random.default_rng(7), 0
    while count < 60:
        poles = -(10.0 ** rng.uniform(-1, 2, 3))
        bottom = polynomial.polyfromroots(poles).tolist()
        top = (10.0 ** rng.uniform(-1, 2) * np.array([1.0, rng.normal()]) * abs(np.prod(poles))).tolist()
        loop = rational(top, bottom)
        if not fl.is_stable(loop.feedback()):
            continue
        count += 1
        skew = float(rng.uniform(-2, 2))
        assert fl.disk_margin(loop, skew=skew).alpha == pytest.approx(smallest(top, bottom, skew), rel=1e-9)


@pytest.mark.parametrize("skew", SKEWS)
def test_as_python_control_on_a_fine_grid(skew: float) -> None:
    loop = control.tf([25], [1, 10, 10, 10])
    alpha, _, phase = control.disk_margins(loop, np.linspace(1.7, 2.2, 2001), skew=skew)
    for given in (25 / (s**3 + 10 * s**2 + 10 * s + 10), loop):
        found = fl.disk_margin(given, skew=skew, unstable_poles=0)
        assert found.alpha == pytest.approx(alpha, rel=1e-6) and found.alpha <= alpha * (1 + 1e-12)
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
    assert np.min(2 * np.abs(1 + values) / np.abs((1 + skew) - (1 - skew) * values)) >= found.alpha * (
        1 - 1e-12
    )


@pytest.mark.parametrize("skew", SKEWS)
def test_what_is_guaranteed_holds(skew: float) -> None:
    """Gains and phases inside the margins leave the loop stable; the disk touches both ends."""
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
    assert fl.disk_margin(LINK, skew=1.0).alpha == pytest.approx(fl.margins(LINK).modulus_margin, rel=1e-13)
    plain = 0.148 * s**0.65 * 100 / (s**1.92 + 100)
    assert fl.disk_margin(plain, skew=-1.0).alpha == pytest.approx(
        1 / fl.norm(plain.feedback(), math.inf), rel=1e-13
    )


def test_limits() -> None:
    one = fl.disk_margin(1 / s)
    assert (one.alpha, one.gain_margin) == (pytest.approx(2), (pytest.approx(0, abs=1e-15), math.inf))
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
