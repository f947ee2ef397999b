"""Time responses against closed forms, exact properties, and the shapes of the results."""

from __future__ import annotations

import itertools
import math
from typing import Any

import mpmath as mp
import numpy as np
import pytest
from scipy.special import erfcx, gamma, wofz

from fraclink import LinkModel
from fraclink.errors import NotConvergedError
from fracsys import (
    FractionalTransferFunction,
    Term,
    discrete_modes,
    impulse_response,
    s,
    step_response,
    time_response,
)
from fracsys._response import held_quotient

T = 0.004
LINK = 11.54**2 / (s**1.92 + 11.54**2)
RNG = np.random.default_rng(7)
SIGNAL = RNG.choice([-1.0, 1.0], 600)


def peak_error(output: np.ndarray, expected: np.ndarray) -> float:
    return float(np.max(np.abs(output - expected)) / np.max(np.abs(expected)))


# ---------------------------------------------------------------------------------


def test_order_one_is_the_exponential() -> None:
    t = np.arange(2000) * T
    assert (
        peak_error(step_response(5 / (s + 5), t[-1], T).output, -np.expm1(-5 * t))
        < 1e-13
    )


def test_order_two_is_the_cosine_for_100_s() -> None:
    result = time_response(100 / (s**2 + 100), np.ones(25_001), T)
    assert peak_error(result.output, 1 - np.cos(10 * result.time)) < 1e-11
    assert result.modes == 2


def test_order_one_half_is_the_error_function() -> None:
    result = time_response(3 / (s**0.5 + 3), np.ones(2000), T)
    assert peak_error(result.output, 1 - erfcx(3 * np.sqrt(result.time))) < 1e-12


@pytest.mark.parametrize(
    "order", [0.0, 0.1, 0.5, 0.93, 0.95, 1.0, 1.5, 2.0, 3.0, math.pi]
)
def test_powers_of_the_integrator(order: float) -> None:
    result = time_response(2 / s**order, np.ones(3000), T)
    assert peak_error(result.output, 2 * result.time**order / gamma(1 + order)) < 5e-12
    ramp = time_response(2 / s**order, result.time, T, hold="first")
    assert (
        peak_error(ramp.output, 2 * result.time ** (order + 1) / gamma(2 + order))
        < 5e-12
    )


@pytest.mark.slow
def test_triple_complex_pole() -> None:
    t = np.arange(800) * 0.02
    system = 1 / (s**2 + 2 * s + 5) ** 3
    w, x = 2.0, 2.0 * t
    # inverse of 1/((s+1)² + w²)³: e^{-t} [(3 - x²) sin x - 3 x cos x] / (8 w⁵)
    exact = np.exp(-t) * ((3 - x**2) * np.sin(x) - 3 * x * np.cos(x)) / (8 * w**5)
    assert peak_error(impulse_response(system, t).output, exact) < 1e-10


def test_servo_and_link_a_double_pole_on_the_cut() -> None:
    """The plant of LinkModel with its servo: a double pole at −80, on the branch cut of
    s^1.92.
    """
    plant = LINK / (1 + s / 80) ** 2
    result = time_response(plant, np.ones(25_001), T)
    assert result.method == "modes"
    assert result.error_estimate < 1e-11
    # The double pole as the limit of two simple ones on the cut, by Richardson
    # extrapolation.
    values = []
    for gap in (16.0, 8.0, 4.0, 2.0, 1.0):
        low, high = 80 - gap, 80 + gap
        split = LINK * (6400 / ((s + low) * (s + high)))
        values.append(
            time_response(split, np.ones(400), T).output * (low * high / 6400)
        )
    for level in range(1, 5):
        values = [
            (4**level * b - a) / (4**level - 1) for a, b in itertools.pairwise(values)
        ]
    assert peak_error(result.output[:400], values[0]) < 1e-10


def test_undamped_double_resonance() -> None:
    """(100/(s²+100))²: 1 - cos 10t - 5t sin 10t, which grows."""
    result = time_response((100 / (s**2 + 100)) ** 2, np.ones(5000), T)
    t = result.time
    assert result.method == "modes"
    assert (
        peak_error(result.output, 1 - np.cos(10 * t) - 5 * t * np.sin(10 * t)) < 1e-11
    )


@pytest.mark.slow
@pytest.mark.parametrize("detuning", [0.0, 1e-9, 1e-6, 1e-4, 1e-2])
def test_merging_resonances_are_continuous(detuning: float) -> None:
    """Two links in series, equal and nearly equal: Talbot's inversion does not use the
    poles.
    """
    pair = (
        LINK
        * (1 + detuning) ** 2
        * 11.54**2
        / (s**1.92 + (1 + detuning) ** 2 * 11.54**2)
    )
    result = step_response(pair, 5.0, T)

    def total(terms: tuple[Term, ...], z: mp.mpc) -> mp.mpc:
        return mp.fsum(x.coefficient * z ** mp.mpf(x.order) for x in terms)

    with mp.workdps(50):
        exact = mp.invertlaplace(
            lambda z: total(pair.numerator, z) / total(pair.denominator, z) / z,
            4.0,
            method="talbot",
            degree=220,
        )
        error = abs(float(result.output[1000] - exact))
    assert error < 2e-11 * np.max(np.abs(result.output))
    assert error <= 3 * result.error_estimate


def test_simple_pole_on_the_cut() -> None:
    """1/((s+1)(√s+2)): partial fractions in √s, with error functions of complex
    argument.
    """
    t = np.arange(1, 1500) * 0.01
    # 1/((w²+1)(w+2)) = Σ A_i/(w - w_i), w = √s; the step of 1/(√s - a) is (erfcx(-a√t)
    # - 1)/a
    roots = np.array([1j, -1j, -2.0])
    weights = 1 / np.array([2j * (1j + 2), -2j * (-1j + 2), 5.0])
    exact = sum(
        c / a * (wofz(-1j * a * np.sqrt(t)) - 1)
        for a, c in zip(roots, weights, strict=True)
    ).real
    result = step_response(1 / ((s + 1) * (s**0.5 + 2)), 14.99, 0.01)
    assert peak_error(result.output[1:], exact) < 1e-11


# ---------------------------------------------------------------------


def held_exactly(u: np.ndarray, delay: float, rate: float, hold: str) -> np.ndarray:
    """Response of e^(-τs) a/(s+a) to a held input, as a superposition of steps and
    ramps.
    """
    t = np.arange(len(u)) * T - delay

    def step(x: np.ndarray) -> np.ndarray:
        return np.where(x > 0, -np.expm1(-rate * np.maximum(x, 0)), 0.0)

    def ramp(x: np.ndarray) -> np.ndarray:
        return np.where(x > 0, x + np.expm1(-rate * np.maximum(x, 0)) / rate, 0.0)

    y = u[0] * step(t)
    for k in range(len(u) - 1):
        start = k * T
        if hold == "zero":
            y += (u[k + 1] - u[k]) * step(t - start - T)
        else:
            y += (u[k + 1] - u[k]) / T * (ramp(t - start) - ramp(t - start - T))
    return y


@pytest.mark.parametrize("hold", ["zero", "first"])
@pytest.mark.parametrize("delay", [0.0, 0.0011, T, 0.0123, 3.0])
def test_holds_and_delays(hold: str, delay: float) -> None:
    u = RNG.normal(size=400)
    result = time_response((5 / (s + 5)).delayed(delay), u, T, hold=hold)
    np.testing.assert_allclose(
        result.output, held_exactly(u, delay, 5.0, hold), atol=2e-13
    )


@pytest.mark.parametrize("hold", ["zero", "first"])
@pytest.mark.parametrize("delay", [0.0, 0.3 * T, 1.7 * T])
def test_integrators_of_held_inputs_seen_between_samples(
    hold: str, delay: float
) -> None:
    """2/s + 3/s²: the sums of held values and of their slopes, and the contribution of
    a jump at 0, with any delay.
    """
    u = RNG.normal(size=60)
    t = np.arange(60) * T - delay
    exact = np.zeros(60)
    starts, jumps = np.arange(60) * T, np.diff(u, prepend=0.0)
    for start, jump in zip(
        starts, jumps if hold == "zero" else [u[0], *np.zeros(59)], strict=True
    ):
        after = np.maximum(t - start, 0.0)
        exact += jump * (2 * after + 1.5 * after**2)
    if hold == "first":
        slopes = np.append(np.diff(u), 0.0) / T
        for start, bend in zip(starts, np.diff(slopes, prepend=0.0), strict=True):
            after = np.maximum(t - start, 0.0)
            exact += bend * (after**2 + 0.5 * after**3)
    both = time_response((2 / s + 3 / s**2).delayed(delay), u, T, hold=hold)  # type: ignore[arg-type]
    assert both.method == "contour"
    np.testing.assert_allclose(both.output, exact, atol=1e-13 * np.abs(exact).max())
    alone = time_response((2 / s).delayed(delay) + LINK.delayed(delay), u, T, hold=hold)  # type: ignore[arg-type]
    link = time_response(LINK.delayed(delay), u, T, hold=hold).output  # type: ignore[arg-type]
    held = time_response((3 / s**2).delayed(delay), u, T, hold=hold).output  # type: ignore[arg-type]
    np.testing.assert_allclose(
        alone.output - link, exact - held, atol=2e-12 * np.abs(exact).max()
    )


def test_delay_of_whole_samples_shifts() -> None:
    late = time_response(LINK.delayed(5 * T), SIGNAL, T).output
    on_time = time_response(LINK, SIGNAL, T).output
    np.testing.assert_array_equal(late[:5], 0.0)
    np.testing.assert_allclose(late[5:], on_time[:-5], atol=1e-13)


# -----------------------------------------------------------------------------


@pytest.mark.parametrize("order", [1.01, 1.37, 1.92, 2.0])
def test_homothety(order: float) -> None:
    """The response of ω₀²/(s^λ + ω₀²) depends only on t ω₀^(2/λ) (Lemma 1 of the source
    paper).
    """
    t = np.linspace(0.01, 3.0, 50)
    slow = step_response(1 / (s**order + 1), t * 11.54 ** (2 / order)).output
    fast = step_response(11.54**2 / (s**order + 11.54**2), t).output
    np.testing.assert_allclose(slow, fast, atol=2e-12)


def test_impulse_responses_at_the_origin() -> None:
    assert impulse_response(2 / (s + 1), [0.0]).output[0] == 2.0
    assert impulse_response(LINK, [0.0]).output[0] == 0.0
    assert impulse_response(1 / s**0.5, [0.0]).output[0] == math.inf
    assert impulse_response(-1 / (s**0.5 + 1), [0.0]).output[0] == -math.inf
    assert impulse_response(3 / s, [0.0, 1.0]).output.tolist() == [3.0, 3.0]
    assert impulse_response((s + 3) / (s + 1), [0.0]).output[0] == 2.0


def test_link_models_of_every_structure() -> None:
    """tip + torque/c = motor angle at every sample, for every structure."""
    for model in (
        LinkModel(1.56, 11.54),
        LinkModel(1.56, 11.54, order=1.92),
        LinkModel(1.56, 11.54, damping=0.9),
        LinkModel(1.56, 11.54, damping=0.9, damping_order=0.5),
    ):
        tip = time_response(model.tip(), SIGNAL, T).output
        torque = time_response(model.torque(), SIGNAL, T).output
        np.testing.assert_allclose(tip + torque / 1.56, SIGNAL, atol=2e-11)


# --------------------------------------------------------------------------------------


def test_a_contour_per_lag_where_modes_would_cancel() -> None:
    """s^-2.9/(1 + 0.035 s^-0.2): its pole at 0.035^5 rad/s is far slower than the
    requested 30 ms.
    """
    system = 1 / (s**2.9 + 0.0350585 * s**2.7)
    result = time_response(system, np.ones(10), 0.003)
    assert result.method == "contour"
    series = sum(
        (-0.0350585) ** k * result.time ** (2.9 + 0.2 * k) / gamma(3.9 + 0.2 * k)
        for k in range(40)
    )
    assert peak_error(result.output, series) < 1e-12
    ramp = time_response(system, result.time, 0.003, hold="first")
    series = sum(
        (-0.0350585) ** k * result.time ** (3.9 + 0.2 * k) / gamma(4.9 + 0.2 * k)
        for k in range(40)
    )
    assert peak_error(ramp.output, series) < 1e-11


def delayed_integrator(gain: float) -> FractionalTransferFunction:
    """1/(s + gain e^-s), whose step response has a closed form by the method of steps."""
    return (1 / s).feedback((gain + 0 * s).delayed(1.0))


def method_of_steps(t: np.ndarray, gain: float, power: int) -> np.ndarray:
    total = np.zeros(len(t))
    for k in range(int(t[-1]) + 1):
        total += (
            (-gain) ** k
            * np.maximum(t - k, 0) ** (k + power)
            / math.factorial(k + power)
        )
    return total


@pytest.mark.parametrize("gain", [0.5, 1.5, 2.0])
def test_delay_in_the_denominator(gain: float) -> None:
    """Delayed feedback, stable and unstable (gain > π/2): numerical inversion, with a
    reliable estimate.
    """
    result = step_response(delayed_integrator(gain), 10.0, 0.01)
    exact = method_of_steps(result.time, gain, 1)
    error = float(np.max(np.abs(result.output - exact)))
    assert result.method == "fft"
    assert error < 1e-7 * np.max(np.abs(exact))
    assert error <= result.error_estimate
    ramp = time_response(delayed_integrator(gain), result.time, 0.01, hold="first")
    exact = method_of_steps(result.time, gain, 2)
    error = float(np.max(np.abs(ramp.output - exact)))
    assert error < 1e-7 * np.max(np.abs(exact))
    assert error <= ramp.error_estimate


@pytest.mark.parametrize("hold", ["zero", "first"])
def test_inversion_where_poles_are_not_certified(
    hold: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """0.5 + 2/(s+1)^3, inverted as if its triple pole could not be found."""

    def lost(*_: object) -> None:
        raise NotConvergedError("zeros found", reached=1, wanted=3, remedy="none")

    system, u = 0.5 + 2 / (s + 1) ** 3, np.cos(np.arange(800) * 0.03)
    exact = time_response(system, u, 0.01, hold=hold)
    monkeypatch.setattr("fracsys._response.held_quotient", lost)
    with pytest.raises(NotConvergedError):
        impulse_response(system, 1.0, 0.01)
    monkeypatch.setattr(
        "fracsys._response.held_quotient",
        lambda top, bottom: held_quotient(top, bottom) if len(bottom) == 1 else lost(),
    )
    result = time_response(system, u, 0.01, hold=hold)
    error = float(np.max(np.abs(result.output - exact.output)))
    assert result.method == "fft"
    assert error <= result.error_estimate
    assert error < 1e-6
    assert step_response(system, 1.0, 0.01).method == "fft"


# -------------------------------------------


def test_a_sample_on_the_jump_counts_as_after_it() -> None:
    """0.3 is 2.9999999999999996 periods of 0.1 s: this still gives four samples, the
    last one after the jump.
    """
    late = step_response((0 * s + 2).delayed(0.3), 0.3, 0.1)
    assert late.output.tolist() == [0.0, 0.0, 0.0, 2.0]
    assert late.time.tolist() == pytest.approx([0.0, 0.1, 0.2, 0.3])
    assert len(step_response(LINK, 0.39, 0.1).time) == 4
    near = step_response(
        (0 * s + 2).delayed(0.3), [0.3 - 1e-9, 0.3 - 1e-14, 0.3 + 1e-9]
    )
    assert near.output.tolist() == [0.0, 2.0, 2.0]
    far = step_response((0 * s + 2).delayed(1000.0), [1000.0 - 1e-7, 1000.0 - 5e-10])
    assert far.output.tolist() == [0.0, 2.0]


def test_a_gain_claims_rounding_and_no_more() -> None:
    found = time_response(0 * s - 3, SIGNAL, T)
    assert (found.error_estimate, found.modes, found.method) == (
        pytest.approx(3 * 4e-15),
        0,
        "modes",
    )
    assert step_response(0 * s - 3, [0.0, 1.0]).error_estimate == pytest.approx(
        3 * 4e-15
    )


def test_several_delays_claim_the_errors_of_all_and_the_least_direct_method() -> None:
    plain, power = time_response(LINK, SIGNAL, T), time_response(1 / s**1.5, SIGNAL, T)
    assert (plain.method, power.method) == ("modes", "contour")
    both = time_response(LINK + LINK.delayed(0.1), SIGNAL, T)
    assert plain.error_estimate < both.error_estimate <= 2 * plain.error_estimate
    assert both.modes == plain.modes > 2
    mixed = time_response(
        1 / s**0.5 + (1 / s**0.5).delayed(0.1) * (1 + 1 / s), SIGNAL, T
    )
    assert mixed.method == "contour"
    assert time_response(0 * s, SIGNAL, T).error_estimate == 0.0


@pytest.mark.parametrize(
    ("delay", "lag"),
    [
        (0.0, 0),
        (T, 1),
        (1.5 * T, 2),
        (T * (1 - 1e-10), 1),  # a whole period except for rounding
        (T * (1 + 1e-10), 1),
        (T * (1 + 1e-6), 2),
        (1e-6 * T, 1),
    ],
)
def test_a_delay_is_whole_periods_and_the_rest_ahead(delay: float, lag: int) -> None:
    modes = discrete_modes((1 / (s + 1)).delayed(delay), T, span=1.0)
    assert modes.lag == lag
    late = np.maximum(np.arange(200) * T - delay, 0.0)
    np.testing.assert_allclose(
        modes.respond(np.ones(200)), -np.expm1(-late), atol=1e-11
    )


DAMPED = (s + 40) / (s**2 + 4 * s + 100) + 0.3


@pytest.mark.parametrize("hold", ["zero", "first"])
@pytest.mark.parametrize("delay", [0.0, 0.01, 0.013])
def test_the_frequency_response_is_the_transform_of_the_samples(
    hold: Any, delay: float
) -> None:
    modes = discrete_modes(DAMPED.delayed(delay), 0.01, hold=hold, span=20.0)
    impulse = np.zeros(2000)
    # the triangular pulse of a first-order hold starts one sample before
    impulse[1] = 1.0
    w = np.array([0.0, 0.4, 9.0, 70.0, 314.0])
    transform = np.exp(-1j * np.outer(w, np.arange(2000) - 1) * 0.01) @ modes.respond(
        impulse
    )
    np.testing.assert_allclose(modes.frequency_response(w), transform, atol=1e-12)
    assert modes.frequency_response(w)[0] == pytest.approx(DAMPED.dcgain(), abs=1e-12)
    exact = time_response(
        DAMPED.delayed(delay), np.sin(7 * np.arange(500) * 0.01), 0.01, hold=hold
    ).output
    np.testing.assert_allclose(
        modes.respond(np.sin(7 * np.arange(500) * 0.01)), exact, atol=1e-11
    )


def test_a_run_goes_on_from_the_state_in_which_another_ended() -> None:
    modes = discrete_modes(DAMPED + 2 / (s + 3), 0.01, span=10.0)
    whole = modes.respond(SIGNAL[:400])
    x, z = np.zeros(len(modes.gains)), np.zeros(len(modes.pole_gains), complex)
    for u in SIGNAL[:150]:
        x, z = modes.decays * x + u, modes.pole_decays * z + u
    state = np.concatenate((x, np.column_stack((z.real, z.imag)).ravel()))
    assert modes.count == len(state) == len(x) + 2 * len(z) == 3
    rest = modes.respond(SIGNAL[150:400], initial=state)
    # v[k-1] of the first sample, which is not part of the state
    rest[0] += modes.first * SIGNAL[149]
    np.testing.assert_allclose(rest, whole[150:], atol=1e-13)


def test_modes_that_a_board_runs() -> None:
    """A pair for the resonance, exponentials with evenly spaced logarithms of their
    rates above 1/span, and ten for all slower rates.
    """
    modes = discrete_modes(LINK, T, span=100.0)
    rates = -modes.log_decays / T
    assert (
        len(modes.pole_gains) == 1
        and modes.count
        == len(rates) + 2
        == time_response(LINK, np.ones(25_001), T).modes
    )
    slow, steps = rates[rates < 0.01], np.diff(np.log(rates[rates > 0.01]))
    # The error of the rule is e^(−2π·1.5/h)/2: h makes it equal to the tolerance.
    assert steps == pytest.approx(2 * math.pi * 1.5 / math.log(0.5 / 1e-12), rel=1e-9)
    longest = 100.0 + 2 * T
    chebyshev = 0.5 * (1 + np.cos(np.pi * (2 * np.arange(10) + 1) / 20)) / longest
    assert slow == pytest.approx(np.sort(chebyshev), rel=1e-9)
    # Rates whose term decays to e^-3 of the tolerance within a period are left out.
    assert rates[-1] * T < math.log(1e12) + 3
    assert discrete_modes(1 / (s + 1), T, span=10.0).count == 1
    assert discrete_modes(1 / (s**2 + s + 1), T, span=10.0).count == 2
