"""The Mittag-Leffler function against its series and against an integral along rays,
both by mpmath.
"""

from __future__ import annotations

import itertools
import math

import mpmath
import numpy as np
import pytest
from scipy.special import erfcx

import fraclink as fl
import fracsys


def series(z: complex, alpha: float, beta: float) -> complex:
    """Σ z^k/Γ(αk + β) with enough digits for the largest term."""
    size = abs(z) ** (1 / alpha)
    with mpmath.workdps(int(40 + 0.9 * size)):
        a, b, x = mpmath.mpf(alpha), mpmath.mpf(beta), mpmath.mpc(z)
        total, power, k = mpmath.mpc(0), mpmath.mpc(1), 0
        while True:
            term = power * mpmath.rgamma(a * k + b)
            total, power, k = total + term, power * x, k + 1
            if k * alpha + beta > size + 5 and abs(term) < 1e-30:
                return complex(total)


def on_rays(z: complex, alpha: float, beta: float) -> complex:
    """The integral of e^s s^(α−β)/(s^α − z) on two rays and an arc, with residues at
    the poles outside.
    """
    with mpmath.workdps(22):
        a, b, log = mpmath.mpf(alpha), mpmath.mpf(beta), mpmath.log(mpmath.mpc(z))
        turns = int(alpha / 2) + 1
        poles = [(log + 2j * mpmath.pi * k) / a for k in range(-turns, turns + 1)]
        poles = [p for p in poles if abs(p.imag) <= mpmath.pi]
        # The rays lie in the widest gap between the poles, and the arc keeps away from
        # their radius.
        radius = mpmath.mpf(3 if poles and 0.6 < mpmath.exp(poles[0].real) < 1.6 else 1)
        steep = 0.55 * math.pi
        angles = sorted(
            [
                steep,
                math.pi,
                *(abs(float(p.imag)) for p in poles if abs(p.imag) > steep),
            ]
        )
        low, high = max(itertools.pairwise(angles), key=lambda pair: pair[1] - pair[0])
        turn, start = mpmath.mpf(0.5 * (low + high)), mpmath.log(radius)

        def density(x: mpmath.mpc) -> mpmath.mpc:
            value = mpmath.exp(mpmath.exp(x) + (a - b + 1) * x) / (
                mpmath.exp(a * x) - z
            )
            return value / (2j * mpmath.pi)

        edges = mpmath.linspace(start, mpmath.log(60 / abs(mpmath.cos(turn))), 5)
        total = mpmath.quad(
            lambda x: density(mpmath.mpc(x, turn)) - density(mpmath.mpc(x, -turn)),
            edges,
        ) + mpmath.quad(
            lambda x: 1j * density(mpmath.mpc(start, x)),
            mpmath.linspace(-turn, turn, 5),
        )
        for p in poles:
            if abs(p.imag) < turn and p.real > start:
                total += mpmath.exp(mpmath.exp(p) + (1 - b) * p) / a
        return complex(total)


@pytest.mark.slow
def test_against_the_series_at_random_points() -> None:
    rng = np.random.default_rng(20)
    for i in range(144):
        alpha = float(10 ** rng.uniform(math.log10(0.03), math.log10(20)))
        beta = float(rng.uniform(-1, 4) if i % 3 else rng.uniform(4, 100))
        # Above α = 2, E has large values of both signs and zeros between them: no bound
        # relative to E exists.
        size = 10 ** rng.uniform(-2, 2 if alpha < 2 else 1.3)
        angle = (
            math.pi,
            0.0,
            alpha * math.pi / 2 * rng.uniform(0.9, 1.1),
            rng.uniform(-math.pi, math.pi),
        )
        z = complex(size**alpha * np.exp(1j * angle[i % 4]))
        exact = series(z, alpha, beta)
        error = abs(fracsys.mittag_leffler(z, alpha, beta=beta) - exact)
        assert error <= 1e-13 * max(1.0, abs(exact)), (z, alpha, beta)


@pytest.mark.slow
def test_against_an_integral_where_the_series_is_too_long() -> None:
    rng = np.random.default_rng(21)
    for _ in range(10):
        alpha, beta = float(10 ** rng.uniform(-1.5, 0.27)), float(rng.uniform(-1, 4))
        sector = rng.uniform(alpha * math.pi / 2 * 1.02, math.pi)
        z = complex(10 ** rng.uniform(0, 6) * np.exp(1j * sector))
        exact = on_rays(z, alpha, beta)
        error = abs(fracsys.mittag_leffler(z, alpha, beta=beta) - exact)
        assert error <= 1e-13 * max(1.0, abs(exact)), (z, alpha, beta)


def test_closed_forms() -> None:
    # 2 is at the vertex of the parabola: a pole there
    x = np.concatenate([np.linspace(-30, 30, 241), [2.0, -2.0]])
    assert fracsys.mittag_leffler(x, 1.0) == pytest.approx(
        np.exp(x), rel=1e-13, abs=1e-13
    )
    assert fracsys.mittag_leffler(-(x**2), 2.0) == pytest.approx(np.cos(x), abs=1e-13)
    assert fracsys.mittag_leffler(-(x**2), 2.0, beta=2.0) == pytest.approx(
        np.sinc(x / math.pi), abs=1e-13
    )
    y = np.geomspace(1e-8, 1e8, 200)
    assert fracsys.mittag_leffler(-y, 0.5) == pytest.approx(erfcx(y), abs=1e-14)


def test_shape_type_and_limits() -> None:
    assert isinstance(fracsys.mittag_leffler(-1.0, 0.5), float)
    assert (
        fracsys.mittag_leffler(np.zeros((2, 3)), 0.5, beta=2.0).tolist()
        == [[1.0] * 3] * 2
    )
    assert fracsys.mittag_leffler(np.array([[1j], [2j]]), 0.5).dtype == complex
    assert fracsys.mittag_leffler(0.0, 0.7, beta=0.0) == 0.0  # 1/Γ(0)
    assert fracsys.mittag_leffler(1e-300, 0.7, beta=0.0) < 1e-290
    assert fracsys.mittag_leffler([], 1.0).shape == (0,)
    assert fracsys.mittag_leffler(1e4, 1.0) == math.inf
    many = np.random.default_rng(3).normal(size=5000)
    assert fracsys.mittag_leffler(many, 0.8)[4321] == fracsys.mittag_leffler(
        many[4321], 0.8
    )


@pytest.mark.parametrize(
    ("z", "alpha", "beta", "field"),
    [
        (1.0, 0.0, 1.0, "alpha"),
        (1.0, 1.0, -2.0, "beta"),
        (math.nan, 1.0, 1.0, "z"),
        ("1", 1.0, 1.0, "z"),
    ],
)
def test_refusals(z: object, alpha: float, beta: float, field: str) -> None:
    with pytest.raises(fl.errors.FieldError) as refused:
        fracsys.mittag_leffler(z, alpha, beta=beta)  # type: ignore[arg-type]
    assert refused.value.field == field and refused.value.remedy
