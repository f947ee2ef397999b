"""Norms against closed forms, 20-digit quadrature and sums around the circle."""

from __future__ import annotations

import math
from typing import Any

import control
import mpmath
import numpy as np
import pytest

from fraclink._systems.fractional import FractionalTransferFunction, s
from fraclink._systems.norms import integrate, norm
from fraclink._systems.rational import approximate
from fraclink.errors import FieldError, NotConvergedError, UnstableError

INF = math.inf


def quadrature(system: FractionalTransferFunction) -> float:
    with mpmath.workdps(20):

        def density(x: mpmath.mpf) -> mpmath.mpf:
            z = mpmath.mpc(0, mpmath.exp(x))
            top = mpmath.fsum(
                t.coefficient * z ** mpmath.mpf(t.order) for t in system.numerator
            )
            bottom = mpmath.fsum(
                t.coefficient * z ** mpmath.mpf(t.order) for t in system.denominator
            )
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
    """Doubles hold ω₀² − ω² to 1e-16 ω₀², a 1e-8 part of the peak's width: so many
    digits are left.
    """
    assert norm(100 / (s**2 + 2e-7 * s + 100), 2) == pytest.approx(
        math.sqrt(2.5e8), rel=1e-8
    )


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
    """|s^λ/(s^λ + ω₀²)| peaks at 1/sin(πλ/2), where ω^λ = −ω₀²/cos(πλ/2) (ERRATA,
    (14)).
    """
    system = s**order / (s**order + 100)
    assert norm(system, INF) == pytest.approx(
        1 / math.sin(0.5 * math.pi * order), rel=1e-12
    )


def test_supremum_at_an_end_of_the_axis() -> None:
    assert norm(3 / (s**0.5 + 2), INF) == pytest.approx(1.5, rel=1e-14)
    assert norm(4 * s**0.7 / (s**0.7 + 2), INF) == pytest.approx(4.0, rel=1e-14)
    assert norm(s * 0 + 2.5, INF) == 2.5
    assert norm(0 * s, 2) == norm(0 * s, INF) == 0.0


@pytest.mark.slow
def test_delayed_feedback_has_norms_too() -> None:
    closed = (10 / (s + 1)).delayed(0.1).feedback()
    w = mpmath.linspace(7, 25, 20_001)
    peak = max(
        abs(10 / (1j * float(x) + 1 + 10 * complex(mpmath.exp(-0.1j * x)))) for x in w
    )
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
def test_no_norm(
    system: FractionalTransferFunction, p: float, error: type[FieldError], words: str
) -> None:
    with pytest.raises(error, match=words):
        norm(system, p)


def around_the_circle(top: list[float], bottom: list[float]) -> tuple[float, float]:
    """H2 and H∞ of a sampled filter by a dense trapezoidal sum, which converges
    exponentially on a circle.
    """
    z = np.exp(1j * np.linspace(-math.pi, math.pi, 200_001)[:-1])
    values = np.abs(np.polyval(top, z) / np.polyval(bottom, z))
    return math.sqrt(float(np.mean(values**2))), float(values.max())


@pytest.mark.parametrize(
    ("top", "bottom"),
    [
        ([0.5, 0.1], [1.0, -0.9]),
        ([1.0], [1.0, -1.6, 0.89]),
        ([0.3, -0.2, 0.7], [1.0, -1.99, 0.9902]),
        ([1.0, 0.0], [1.0, 0.97]),
        ([1.0, -1.0], [1.0, -0.5]),
    ],
)
@pytest.mark.parametrize("states", [False, True])
def test_sampled_systems(top: list[float], bottom: list[float], states: bool) -> None:
    system = control.tf(top, bottom, 0.01)
    square, peak = around_the_circle(top, bottom)
    given = control.ss(system) if states else system
    assert norm(given, 2) == pytest.approx(square, rel=1e-9)
    assert norm(given, INF) == pytest.approx(peak, rel=1e-6)
    assert norm(given, INF) >= peak * (1 - 1e-11)


def test_closed_forms_of_sampled_systems() -> None:
    """(z − a)⁻¹: 1/√(1 − a²) and 1/(1 − |a|), whatever the period."""
    for a in (-0.9, 0.3, 1 - 1e-6):
        for period in (True, 0.004):
            system = control.tf([1.0], [1.0, -a], period)
            assert norm(system, 2) == pytest.approx(
                1 / math.sqrt((1 - a) * (1 + a)), rel=1e-9
            )
            assert norm(system, INF) == pytest.approx(1 / (1 - abs(a)), rel=1e-9)


def test_a_lightly_damped_sampled_resonance_is_not_missed() -> None:
    """1/((z − p)(z − p̄)), p = r e^jθ: the peak lies where cos ω = (1 + r²) cos θ/(2
    r).
    """
    for r, theta in ((1 - 1e-7, 0.3), (1 - 1e-7, 2e-4), (0.999, 3.0)):
        p = r * np.exp(1j * theta)
        system = control.tf([1.0], [1.0, -2 * p.real, abs(p) ** 2], 1.0)
        cosine = min(1.0, (1 + r * r) * math.cos(theta) / (2 * r))
        z = cosine + 1j * math.sqrt((1 - cosine) * (1 + cosine))
        exact = 1 / abs((z - p) * (z - p.conjugate()))
        assert norm(system, INF) == pytest.approx(exact, rel=1e-7)


@pytest.mark.slow
def test_rational_models_of_a_fractional_system() -> None:
    plant = 100 / (s**1.92 + 100)
    continuous = approximate(plant, (1e-3, 1e4), 8, method="minimax")
    sampled = approximate(plant, (1e-2, 700.0), 8, method="minimax", period=0.004)
    for made in (continuous, sampled):
        assert norm(made, INF) == pytest.approx(norm(plant, INF), rel=0.01)
        same = control.ss(*made.state_space(), 0.004 if made is sampled else 0)
        assert norm(same, INF) == pytest.approx(norm(made, INF), rel=1e-9)
    # ‖g[k]‖² T⁻¹ tends to ‖g(t)‖² for a response that the samples resolve.
    assert norm(sampled, 2) / math.sqrt(0.004) == pytest.approx(
        norm(plant, 2), rel=0.05
    )
    light = control.tf([100.0], [1.0, 2e-3, 100.0])
    assert norm(light, 2) == pytest.approx(math.sqrt(25000.0), rel=1e-9)
    assert norm(control.ss(light), INF) == pytest.approx(
        1 / math.sin(math.acos(1 - 2e-8)), rel=1e-2
    )
    assert norm(plant.to_control(), 2) == norm(plant, 2)


@pytest.mark.parametrize(
    ("system", "p", "error", "words"),
    [
        (control.tf([1.0], [1.0, -1.0], 0.1), 2, UnstableError, "≥ 1"),
        (control.tf([1.0], [1.0, -1.1], 0.1), INF, UnstableError, "≥ 1"),
        (control.tf([1.0], [1.0, -1.0]), 2, UnstableError, "Re s"),
        (control.tf([1.0, 2.0], [1.0, 1.0]), 2, FieldError, "feedthrough"),
        (
            control.ss([[-1.0]], [[1.0, 1.0]], [[1.0]], [[0.0, 0.0]]),
            2,
            FieldError,
            "one input",
        ),
        (lambda z: 1 / (z + 1), 2, FieldError, "not a model"),
        (3, 2, FieldError, "system"),
    ],
)
def test_no_norm_of_a_model(
    system: Any, p: float, error: type[FieldError], words: str
) -> None:
    with pytest.raises(error, match=words) as refused:
        norm(system, p)
    assert refused.value.field == "system" and refused.value.remedy


def test_quadrature_is_exact_where_its_rule_is_and_halves_where_it_is_not() -> None:
    """16 Gauss points are exact to degree 31; |x − 1/3| needs halving, a narrow peak
    very much of it.
    """
    edges = np.array([-1.0, 0.5, 2.0])
    assert integrate(lambda x: x**31, edges, 1e-13, smooth=0.0) == pytest.approx(
        (2.0**32 - 1.0) / 32, rel=1e-13
    )
    assert integrate(
        lambda x: np.abs(x - 1 / 3), edges, 1e-13, smooth=0.0
    ) == pytest.approx(0.5 * ((4 / 3) ** 2 + (5 / 3) ** 2), rel=1e-12)
    assert integrate(
        lambda x: 1 / (x**2 + 1e-8), edges, 1e-12, smooth=0.0
    ) == pytest.approx(1e4 * (math.atan(2e4) + math.atan(1e4)), rel=1e-11)
    noise = np.random.default_rng(1)
    # Rounding that never agrees with itself ends at panels that are smooth by
    # assumption.
    rough = integrate(
        lambda x: 1.0 + 1e-9 * noise.normal(size=x.shape), edges, 1e-13, smooth=0.1
    )
    assert rough == pytest.approx(3.0, rel=1e-8)
    with pytest.raises(NotConvergedError, match="imaginary axis"):
        integrate(lambda x: noise.normal(size=x.shape), edges, 1e-13, smooth=0.0)


def test_models_without_states_are_their_gain() -> None:
    for period, square in ((0.1, 2.5), (0, None)):
        gain = control.tf([2.5], [1.0], period)
        assert norm(gain, INF) == 2.5
        if square is not None:
            assert norm(gain, 2) == 2.5
        else:
            with pytest.raises(FieldError, match="feedthrough"):
                norm(gain, 2)


def test_poles_exactly_at_the_limit_of_stability() -> None:
    for bad in (control.tf([1.0], [1.0, 0.0]), control.tf([1.0], [1.0, 0.0, 4.0])):
        with pytest.raises(UnstableError, match="Re s ≥ 0"):
            norm(bad, INF)
    for bad in (
        control.tf([1.0], [1.0, 1.0], 0.1),
        control.tf([1.0], [1.0, -1.0], 0.1),
    ):
        with pytest.raises(UnstableError, match=r"\|z\| ≥ 1"):
            norm(bad, 2)
    assert norm(control.tf([1.0], [1.0, -0.999999], 0.1), INF) == pytest.approx(
        1e6, rel=1e-6
    )


def test_the_relative_degree_that_a_norm_needs() -> None:
    with pytest.raises(FieldError, match="relative degree > 1/2"):
        norm(1 / (s**0.5 + 1), 2)
    assert norm(1 / (s**0.51 + 1), 2) > 1.0
    assert norm((s**0.5 + 3) / (s**0.5 + 1), INF) == pytest.approx(3.0, rel=1e-14)
    with pytest.raises(FieldError, match="proper systems"):
        norm((s**1.01 + 3) / (s + 1), INF)


@pytest.mark.slow
def test_the_largest_of_several_peaks() -> None:
    """Two resonances of like height: each is a local supremum, the higher one counts."""
    for small, large in ((0.9, 1.0), (1.0, 0.9)):
        system = small / (s**2 + 0.02 * s + 1) + 100 * large / (s**2 + 0.2 * s + 100)
        x = np.concatenate(
            [np.linspace(0.99, 1.01, 40_001), np.linspace(9.9, 10.1, 40_001)]
        )
        assert norm(system, INF) == pytest.approx(
            np.abs(system(1j * x)).max(), rel=1e-8
        )
