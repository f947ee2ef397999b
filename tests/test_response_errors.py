"""Error estimates against mpmath: Talbot's contour with many digits, in separate code."""

from __future__ import annotations

import math
from collections.abc import Callable

import mpmath
import numpy as np
import pytest

from fracsys import (
    FractionalTransferFunction,
    TimeResponse,
    impulse_response,
    poles,
    s,
    step_response,
    time_response,
)

MEMORY = 1 / (
    s**6.1 + 5 * s**5.2 + 11 * s**4.1 + 14 * s**2.9 + 11 * s**2.2 + 5 * s**0.9 + 1
)


def inverse(G: FractionalTransferFunction, time: float, degree: int) -> float:
    """Inverse Laplace transform of G(s)/s^degree, without the direct part for an
    impulse.

    Fixed Talbot (Abate and Valkó, 2004): with N nodes the contour passes the imaginary
    axis at 0.63 N/t, so that fast poles beside that axis need many; the digits are what
    its nodes' growth, e^(0.4 N), costs.
    """
    fastest = float(np.max(np.abs(poles(G).imag), initial=0.0))
    nodes = 80 + 2 * int(fastest * time)
    with mpmath.workdps(40 + nodes // 2):
        direct = mpmath.mpf(0)
        if degree == 0 and G.relative_degree == 0.0:
            direct = (
                mpmath.mpf(G.numerator[0].coefficient) / G.denominator[0].coefficient
            )

        def value(z: mpmath.mpc) -> mpmath.mpc:
            top, bottom = (
                mpmath.fsum(
                    t.coefficient * mpmath.exp(mpmath.mpf(t.order) * mpmath.log(z))
                    for t in side
                )
                for side in (G.numerator, G.denominator)
            )
            return (top / bottom - direct) / z**degree

        t = mpmath.mpf(time)
        scale = mpmath.mpf(2) * nodes / (5 * t)
        total = mpmath.exp(scale * t) * value(mpmath.mpc(scale)).real / 2
        for k in range(1, nodes):
            angle = k * mpmath.pi / nodes
            cotangent = mpmath.cot(angle)
            z = scale * angle * (cotangent + 1j)
            turn = 1 + 1j * (angle + (angle * cotangent - 1) * cotangent)
            total += (mpmath.exp(t * z) * value(z) * turn).real
        return float(total * scale / nodes)


def worst(
    found: TimeResponse, G: FractionalTransferFunction, degree: int, places: np.ndarray
) -> float:
    """Largest true error at a selection of the times."""
    return max(
        abs(found.output[k] - inverse(G, float(found.time[k]), degree)) for k in places
    )


@pytest.mark.parametrize("time", [1e-9, 1e-6, 1e-4, 1e-3])
def test_the_impulse_response_of_a_biproper_function_is_right_at_short_times(
    time: float,
) -> None:
    link = 1.56 * s**1.92 / (s**1.92 + 100.4)
    found = impulse_response(link, [time])
    exact = inverse(link, time, 0)
    assert found.output[0] == pytest.approx(exact, rel=1e-12)
    assert abs(found.output[0] - exact) <= found.error_estimate


@pytest.mark.slow
@pytest.mark.parametrize(
    "G", [MEMORY, 1 / (s**0.9 + 1) ** 5], ids=["order 6.1", "fivefold pole"]
)
def test_contours_keep_their_digits_where_residues_cancel(
    G: FractionalTransferFunction,
) -> None:
    """The output begins like t^6 while the residues are of order one."""
    found = time_response(G, np.ones(200), 0.001)
    assert found.method == "contour"
    true = worst(found, G, 1, np.array([10, 50, 120, 199]))
    assert true <= found.error_estimate <= 1e-10 * found.output[-1]


def random_system(generator: np.random.Generator) -> FractionalTransferFunction:
    """A product of 1/(s^a + c), stable for a < 2, with a sum in the numerator and
    sometimes a singular power.
    """
    G = (
        float(generator.choice([-1.0, 1.0])) * math.exp(generator.uniform(-2, 2))
        + 0 * s
    )
    for _ in range(int(generator.integers(1, 4))):
        constant = math.exp(generator.uniform(-3, 6))
        G = G * constant / (s ** float(generator.uniform(0.1, 1.8)) + constant)
    if generator.random() < 0.4:
        G = G * (1 + float(generator.uniform(0.1, 10)) * s ** (0.9 * G.relative_degree))
    return (
        G / s ** float(generator.uniform(0.0, 1.5)) if generator.random() < 0.3 else G
    )


@pytest.mark.slow
@pytest.mark.parametrize("respond", [impulse_response, step_response])
@pytest.mark.parametrize("seed", range(12))
def test_true_errors_stay_within_their_estimates(
    respond: Callable[..., TimeResponse], seed: int
) -> None:
    generator = np.random.default_rng(seed)
    G = random_system(generator)
    times = np.sort(
        np.exp(generator.uniform(-8, 0.5, size=int(generator.integers(1, 4))))
    )
    found = respond(G, times)
    true = worst(
        found, G, 0 if respond is impulse_response else 1, np.arange(len(times))
    )
    assert true <= found.error_estimate


def test_the_first_samples_of_a_linear_hold_keep_their_digits() -> None:
    """The output begins like t^1.1: it is 1e-6 after 28 samples, while modes have
    weights of order one.
    """
    G = 0.0158 / (s**1.1027 + 0.0158)
    found = time_response(G, np.ones(28), 1e-5, hold="first")
    true = worst(found, G, 1, np.array([1, 5, 27]))
    assert true <= min(found.error_estimate, 2e-11 * found.output[-1])


@pytest.mark.parametrize("hold", ["zero", "first"])
@pytest.mark.parametrize(("gain", "delay"), [(0.7, 0.5), (1.2, 1.0), (2.0, 0.3)])
def test_the_estimate_of_a_retarded_loop_is_near_its_error(
    gain: float, delay: float, hold: str
) -> None:
    """ẏ = k (u − y) with a delay; its step response is a polynomial between multiples
    of the delay.
    """
    loop = (gain / s).delayed(delay).feedback()
    count, period = 400, 0.02
    time = period * np.arange(count)
    exact = np.zeros(count)
    for n in range(1, 1 + int(time[-1] / delay) + 1):
        late = np.maximum(time - n * delay, 0.0)
        exact -= (-gain) ** n * late**n / math.factorial(n)
    found = time_response(loop, np.ones(count), period, hold=hold)
    assert found.method == "fft"
    error = float(np.abs(found.output - exact).max())
    assert error <= found.error_estimate <= max(1e4 * error, 1e-4)


@pytest.mark.slow
def test_the_errors_of_several_jumps_add_up() -> None:
    """Found by benchmarks/bench_promises.py, seed 100926: three jumps, each with the
    error of a step.
    """
    link = 1.56 / (
        s**1.7283840909811163
        + 0.0002466047329379374 * s**1.1106082016811476
        + 48.156444060782455
    )
    jumps, period = (
        {0: -0.69984677, 35: 0.99660463, 49: -0.41257491},
        0.01695048353398508,
    )
    u = np.zeros(164)
    for at, jump in jumps.items():
        u[at:] += jump
    found = time_response(link, u, period)
    steps = np.diff(u, prepend=0.0)
    for k in (100, 150, 163):
        exact = sum(steps[j] * inverse(link, (k - j) * period, 1) for j in jumps)
        assert abs(found.output[k] - exact) <= found.error_estimate
