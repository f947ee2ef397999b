"""Norms against closed forms and 20-digit quadrature."""

from __future__ import annotations

import math

import mpmath
import pytest

from fraclink._systems.fractional import FractionalTransferFunction, s
from fraclink._systems.stability import norm
from fraclink.errors import FieldError, UnstableError

INF = math.inf


def quadrature(system: FractionalTransferFunction) -> float:
    with mpmath.workdps(20):

        def density(x: mpmath.mpf) -> mpmath.mpf:
            z = mpmath.mpc(0, mpmath.exp(x))
            top = mpmath.fsum(t.coefficient * z ** mpmath.mpf(t.order) for t in system.numerator)
            bottom = mpmath.fsum(t.coefficient * z ** mpmath.mpf(t.order) for t in system.denominator)
            return abs(top / bottom) ** 2 * mpmath.exp(x)

        # |G|²ω falls like ω^(1−2r): e^(−60) of it is beyond the last panel.
        high = 60 / (2 * system.relative_degree - 1)
        edges = mpmath.linspace(-40, high, int((40 + high) / 3) + 1)
        return float(mpmath.sqrt(mpmath.quad(density, edges) / mpmath.pi))


@pytest.mark.parametrize(
    ("system", "exact"),
    [
        (1 / (s + 1), math.sqrt(0.5)),
        (3 / (s + 4), 3 / math.sqrt(8)),
        (100 / (s**2 + 2 * s + 100), 5.0),
        (100 / (s**2 + 2e-3 * s + 100), math.sqrt(25000.0)),
        (s / (s**2 + 0.5 * s + 4), 1.0),
        ((1 / (s + 1)).delayed(0.7), math.sqrt(0.5)),
    ],
)
def test_h2_closed_forms(system: FractionalTransferFunction, exact: float) -> None:
    assert norm(system, 2) == pytest.approx(exact, rel=2e-13)


def test_h2_of_a_damping_of_1e_8() -> None:
    """Doubles hold ω₀² − ω² to 1e-16 ω₀², a 1e-8 part of the peak's width: so many digits are left."""
    assert norm(100 / (s**2 + 2e-7 * s + 100), 2) == pytest.approx(math.sqrt(2.5e8), rel=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize(
    "system",
    [
        1 / (s**1.5 + 1),
        1 / (s**0.7 + 1),
        1 / (s**0.58 + 1),
        1.56 * s**0.3 / (s**1.92 + 100),
        1 / (s**1.08 + s + 1),
        (s**0.4 + 2) / (s**1.3 + 3 * s**0.5 + 0.2),
    ],
)
def test_h2_fractional(system: FractionalTransferFunction) -> None:
    assert norm(system, 2) == pytest.approx(quadrature(system), rel=1e-12)


@pytest.mark.parametrize("order", [1.2, 1.5, 1.92, 1.999])
def test_peak_of_the_link(order: float) -> None:
    """|s^λ/(s^λ + ω₀²)| peaks at 1/sin(πλ/2), where ω^λ = −ω₀²/cos(πλ/2) (ERRATA, (14))."""
    system = s**order / (s**order + 100)
    assert norm(system, INF) == pytest.approx(1 / math.sin(0.5 * math.pi * order), rel=1e-12)


def test_supremum_at_an_end_of_the_axis() -> None:
    assert norm(3 / (s**0.5 + 2), INF) == pytest.approx(1.5, rel=1e-14)
    assert norm(4 * s**0.7 / (s**0.7 + 2), INF) == pytest.approx(4.0, rel=1e-14)
    assert norm(s * 0 + 2.5, INF) == 2.5
    assert norm(0 * s, 2) == norm(0 * s, INF) == 0.0


def test_delayed_feedback_has_norms_too() -> None:
    closed = (10 / (s + 1)).delayed(0.1).feedback()
    w = mpmath.linspace(7, 25, 20_001)
    peak = max(abs(10 / (1j * float(x) + 1 + 10 * complex(mpmath.exp(-0.1j * x)))) for x in w)
    assert norm(closed, INF) == pytest.approx(peak, rel=1e-6)


@pytest.mark.parametrize(
    ("system", "p", "error", "words"),
    [
        (1 / (s**2 + 100), 2, UnstableError, "imaginary axis"),
        (1 / (s**2 + 100), INF, UnstableError, "imaginary axis"),
        (1 / s, 2, UnstableError, "divides the denominator"),
        (1 / (s - 1), INF, UnstableError, "Re s > 0"),
        (1 / (s**0.5 + 1), 2, FieldError, "low-pass"),
        ((s + 2) / (s + 1), 2, FieldError, "infinite"),
        (s**0.65, INF, FieldError, "improper"),
        (1 / (s + 1), 1, FieldError, "2 or inf"),
    ],
)
def test_no_norm(system: FractionalTransferFunction, p: float, error: type[FieldError], words: str) -> None:
    with pytest.raises(error, match=words):
        norm(system, p)
