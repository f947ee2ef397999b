"""Every figure of roots, margins, norms, the discrete fit and the approximations,
beside the wanted value.

References: mpmath at 30 digits, the exact condition for two crossings, python-control
in the same run, random restarts. Times are medians of interleaved calls beside half
their interquartile range.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable
from functools import partial

import control
import mpmath
import numpy as np

from fraclink._systems.discrete import _target as discrete_target
from fraclink._systems.discrete import fit_discrete
from fraclink._systems.exponential import ExponentialSum, count_strip
from fraclink._systems.fractional import FractionalTransferFunction, s
from fraclink._systems.interop import to_control
from fraclink._systems.margins import margins
from fraclink._systems.minimax import PartialFractions, improve, score
from fraclink._systems.norms import norm
from fraclink._systems.rational import approximate
from fraclink._systems.roots import log_zeros

PERIOD = 0.004
BETA, GAIN, W = 0.65, 0.148, 10.0


def line(figure: str, measured: str, wanted: str, holds: bool) -> None:
    print(
        f"{'ok  ' if holds else 'MISS'} {figure:<66} {measured:<34} wanted {wanted}",
        flush=True,
    )


def timed(
    calls: dict[str, Callable[[], object]], rounds: int
) -> dict[str, tuple[float, float]]:
    """Median and half the interquartile range of interleaved calls [s]."""
    spent: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            begin = time.perf_counter()
            call()
            spent[name].append(time.perf_counter() - begin)
    quartiles = {
        name: np.percentile(values, [25, 50, 75]) for name, values in spent.items()
    }
    return {
        name: (float(q[1]), float(q[2] - q[0]) / 2) for name, q in quartiles.items()
    }


def link_loop(
    order: float, gain: float = GAIN, beta: float = BETA
) -> FractionalTransferFunction:
    return gain * s**beta * W**2 / (s**order + W**2)


def exact_crossings(order: float, gain: float, beta: float) -> list[float]:
    """Every root of |L| = 1 in 30 digits, between the stationary points of |L|.

    With u = ω^λ and b = β/λ: (b − 1) u² + (2b − 1) cos(πλ/2) ω₀² u + b ω₀⁴ = 0.
    """
    with mpmath.workdps(30):
        k, beta, order, w2 = (mpmath.mpf(v) for v in (gain, beta, order, W**2))
        b, c = beta / order, mpmath.cos(mpmath.pi * order / 2)

        def level(x: mpmath.mpf) -> mpmath.mpf:
            u = mpmath.exp(order * x)
            return (
                mpmath.log(k * w2)
                + beta * x
                - mpmath.log(u**2 + 2 * u * w2 * c + w2**2) / 2
            )

        roots = mpmath.polyroots(
            [b - 1, (2 * b - 1) * c * w2, b * w2**2], maxsteps=200, extraprec=100
        )
        turns = sorted(
            mpmath.log(mpmath.re(u)) / order
            for u in roots
            if mpmath.re(u) > 0 == mpmath.im(u)
        )
        marks = [mpmath.mpf(-200), *turns, mpmath.mpf(200)]
        found = []
        for low, high in itertools.pairwise(marks):
            if level(low) * level(high) < 0:
                found.append(float(mpmath.exp(_bisected(level, low, high))))
        return found


def _bisected(
    level: Callable[[mpmath.mpf], mpmath.mpf], low: mpmath.mpf, high: mpmath.mpf
) -> mpmath.mpf:
    rising = level(low) < 0
    for _ in range(100):
        middle = (low + high) / 2
        low, high = (middle, high) if (level(middle) < 0) == rising else (low, middle)
    return low


def crossings() -> None:
    worst = 0.0
    for order in (1.2, 1.5, 1.8, 1.92, 1.99, 1.999, 1.99999):
        exact = exact_crossings(order, GAIN, BETA)
        for found in _both_ways(link_loop(order)):
            errors = [abs(w / e - 1) for w, e in zip(found, exact, strict=True)]
            worst = max(worst, *errors)
    figure = "crossings of k s^β ω₀²/(s^λ+ω₀²), λ 1.2 … 1.99999, relative error"
    line(figure, f"{worst:.1e}", "1e-9", worst <= 1e-9)

    rng, wrong, cases = np.random.default_rng(7), 0, 300
    for _ in range(cases):
        order, beta, gain = (
            rng.uniform(1.05, 1.9999),
            rng.uniform(0.1, 0.9),
            10 ** rng.uniform(-3, 0),
        )
        expected = len(exact_crossings(order, gain, beta))
        wrong += any(
            len(found) != expected for found in _both_ways(link_loop(order, gain, beta))
        )
    line(
        f"number of crossings wrong in {cases} random loops",
        f"{wrong}",
        "0",
        wrong == 0,
    )

    loops = {
        f"{order}": partial(margins, link_loop(order)) for order in (1.92, 1.999, 2.0)
    }
    for name, (median, spread) in timed(loops, 300).items():
        shown = f"{median * 1e3:.3f} ± {spread * 1e3:.3f} ms"
        line(
            f"all margins of k s^β ω₀²/(s^λ+ω₀²), λ = {name}",
            shown,
            "0.3 ms",
            median <= 0.3e-3,
        )


def _both_ways(loop: FractionalTransferFunction) -> list[list[float]]:
    """Gain crossings of the transfer function and of the same loop as a mere callable."""
    return [
        [c.frequency for c in margins(g).gain_crossings]
        for g in (loop, lambda z: loop(z))
    ]


def against_python_control() -> None:
    loop = GAIN * s**BETA / (1 + 0.16 * s) ** 2 * 10.31**2 / (s**1.92 + 10.31**2)
    peer = to_control(loop)
    spent = timed(
        {"own": lambda: margins(loop), "peer": lambda: control.stability_margins(peer)},
        15,
    )
    ratio = spent["peer"][0] / spent["own"][0]
    own = margins(loop)
    off = abs(control.margin(peer)[1] - math.degrees(own.phase_margin))
    line(
        "margins faster than control.stability_margins on our grid",
        f"{ratio:.0f} ×",
        "10 ×",
        ratio >= 10,
    )
    line(
        "python-control's phase margin on our grid is off by",
        f"{off:.1e}°",
        "1e-2°",
        off <= 1e-2,
    )


def zeros() -> None:
    rng = np.random.default_rng(3)
    spent: dict[int, list[float]] = {n: [] for n in (3, 4, 5, 6)}
    wrong, worst, cases = 0, 0.0, 400
    for case in range(cases):
        n = 3 + case % 4
        orders = np.sort(rng.uniform(0, rng.uniform(1, 6), n))
        coefficients = rng.normal(size=n) * 10 ** rng.uniform(-4, 4, n)
        begin = time.perf_counter()
        z = log_zeros(coefficients, orders, angle=math.pi)
        spent[n].append(time.perf_counter() - begin)
        inside = [v for v in z if v.imag < 3.0]
        counted = count_strip(ExponentialSum.of(coefficients, orders), 3.0)
        wrong += counted != sum(2 - (v.imag == 0) for v in inside)
        worst = max(
            [
                worst,
                *(
                    _against_conditioning(coefficients, orders, complex(v))
                    for v in z[:1]
                ),
            ]
        )
    for n, times in spent.items():
        median, high = np.percentile(times, [50, 99]) * 1e3
        line(
            f"zeros of {n} terms, certified",
            f"{median:.2f} ms, 99 % below {high:.1f} ms",
            "3 ms",
            median <= 3,
        )
    line(
        f"certified count ≠ zeros found, {cases} random sums",
        f"{wrong}",
        "0",
        wrong == 0,
    )
    line(
        "error of a zero over what one rounding of its terms allows",
        f"{worst:.1f}",
        "5",
        worst <= 5,
    )


def _against_conditioning(
    coefficients: np.ndarray, orders: np.ndarray, z: complex
) -> float:
    """Error of a zero over the error that one rounding of each exponent allows."""
    with mpmath.workdps(40):
        a, nu = (
            list(map(mpmath.mpf, values.tolist())) for values in (coefficients, orders)
        )
        exact = mpmath.mpc(z)
        for _ in range(4):  # quadratic: 15, 30, 40 digits
            terms = [c * mpmath.exp(o * exact) for c, o in zip(a, nu, strict=True)]
            slope = mpmath.fsum(o * t for o, t in zip(nu, terms, strict=True))
            exact -= mpmath.fsum(terms) / slope
        # e^(ln a + ν z): the exponent's last place is a relative error of the term.
        exponents = [
            1 + abs(mpmath.log(abs(c))) + abs(o * exact)
            for c, o in zip(a, nu, strict=True)
        ]
        rounding = [abs(t) * e for t, e in zip(terms, exponents, strict=True)]
        allowed = 2.2e-16 * (float(mpmath.fsum(rounding) / abs(slope)) + abs(z))
        return abs(z - complex(exact)) / allowed


def norms() -> None:
    exact = {
        100 / (s**2 + 2 * s + 100): 5.0,
        100 / (s**2 + 2e-3 * s + 100): math.sqrt(25000.0),
        1 / (s + 1): math.sqrt(0.5),
    }
    worst = max(abs(norm(g, 2) / value - 1) for g, value in exact.items())
    line(
        "H2 norm, closed forms, relative error", f"{worst:.1e}", "1e-12", worst <= 1e-12
    )
    peaks = {a: 1 / math.sin(0.5 * math.pi * a) for a in (1.2, 1.5, 1.92, 1.999)}
    worst = max(
        abs(norm(s**a / (s**a + 100), math.inf) / value - 1)
        for a, value in peaks.items()
    )
    line(
        "H∞ norm of the link, closed form, relative error",
        f"{worst:.1e}",
        "1e-12",
        worst <= 1e-12,
    )


def correction(filter_time: float) -> Callable[[np.ndarray], np.ndarray]:
    """Ĉ of eq. (58) with another filter time."""
    return lambda w: GAIN * (1j * w) ** BETA / (1 + 1j * filter_time * w) ** 2


FITS = {
    "δ = 0.16, 0.05 … 785 rad/s": (correction(0.16), (0.05, 785.0), 4),
    "δ = 0.016, 0.05 … 600 rad/s": (correction(0.016), (0.05, 600.0), 6),
}


def fits() -> None:
    for name, (response, band, order) in FITS.items():
        begin = time.perf_counter()
        made = fit_discrete(
            response, period=PERIOD, band=band, zeros_at_one=1, offset=1.0
        )
        spent = time.perf_counter() - begin
        good = made.order <= order and made.error_db <= 0.1 and made.error_deg <= 0.5
        shown = f"{made.order}: {made.error_db:.3f} dB, {made.error_deg:.3f}°"
        line(f"states of 1 + Ĉ within 0.1 dB and 0.5°, {name}", shown, f"{order}", good)
        line(
            "  time of that fit, all lower orders included",
            f"{spent:.2f} s",
            "2 s",
            spent <= 2,
        )
        _restarts(response, band, order)
    bare = fit_discrete(
        lambda w: 0.06988 * (1j * w) ** 0.6122,
        period=PERIOD,
        band=(0.05, 200.0),
        zeros_at_one=1,
        offset=1.0,
    )
    shown = f"{bare.order}: {bare.error_db:.3f} dB, {bare.error_deg:.3f}°"
    line(
        "states without filter, 0.05 … 200 rad/s",
        shown,
        "6",
        bare.order <= 6 and bare.error_db <= 0.1,
    )
    ahead = fit_discrete(lambda w: (1j * w) ** -0.08, period=PERIOD, band=(0.05, 300.0))
    shown = f"{ahead.order}: {ahead.error_db:.3f} dB, {ahead.error_deg:.3f}°"
    line(
        "states of s^-0.08, 0.05 … 300 rad/s",
        shown,
        "6",
        ahead.order <= 6 and ahead.error_db <= 0.1,
    )
    _single_precision()


def _restarts(
    response: Callable[[np.ndarray], np.ndarray], band: tuple[float, float], order: int
) -> None:
    """The error that growth reaches over the best of random starts: 1 is as good."""
    target = discrete_target(response, PERIOD, band, 1, 1.0, None, (0.1, 0.5))
    made = fit_discrete(
        response, period=PERIOD, band=band, order=order, zeros_at_one=1, offset=1.0
    )
    reached = max(made.error_db / 0.1, made.error_deg / 0.5)
    low, high = (
        math.log(math.tan(0.5 * band[0] * PERIOD)),
        math.log(math.tan(0.5 * band[1] * PERIOD)) + 2,
    )
    rng, best, starts = np.random.default_rng(0), math.inf, 60
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(starts):
            pairs = k % (order // 2 + 1)
            real = order - 2 * pairs
            start = PartialFractions(
                0.0,
                np.sort(rng.uniform(low, high, real)),
                np.zeros(real),
                rng.uniform(low + 3, high, pairs),
                rng.uniform(0.2, 1.5, pairs),
                np.zeros(pairs, dtype=complex),
            )
            best = min(best, score(improve(start, target), target))
    line(
        f"  its error over the best of {starts} random starts",
        f"{reached / best:.2f}",
        "1.2",
        reached <= 1.2 * best,
    )


def _single_precision() -> None:
    """The recursion in 32-bit floats against 64-bit with the same 32-bit coefficients."""
    response, band, _ = FITS["δ = 0.16, 0.05 … 785 rad/s"]
    made = fit_discrete(
        response, period=PERIOD, band=band, order=4, zeros_at_one=1, offset=1.0
    )
    rng = np.random.default_rng(1)
    noise = rng.normal(size=100_000)
    u = (0.03 * np.convolve(noise, np.ones(50) / 50**0.5, mode="same")).astype(
        np.float32
    )
    outputs = [
        _run(made, u, np.float32, np.complex64),
        _run(made, u, np.float64, np.complex128),
    ]
    rms = float(np.std(outputs[0] - outputs[1]))
    line(
        "32-bit arithmetic against 64-bit, 1e5 ticks, rms of the difference",
        f"{rms:.1e}",
        "1e-7",
        rms <= 1e-7,
    )


def _run(made: object, u: np.ndarray, real: type, whole: type) -> np.ndarray:
    p, g = (
        made.decays.astype(np.float32).astype(real),
        made.gains.astype(np.float32).astype(real),
    )
    q = whole(np.complex64(made.pole_decays[0]))
    c = whole(np.complex64(made.pole_gains[0]))
    d = real(np.float32(made.feedthrough))
    v = np.diff(u.astype(real), prepend=real(0))
    x, w, y = np.zeros(len(p), dtype=real), whole(0), np.empty(len(v), dtype=real)
    for k, drive in enumerate(v):
        y[k] = d * drive + g @ x + (c * w).real
        x, w = p * x + drive, q * w + whole(drive)
    return y


def approximations() -> None:
    link = 1.56 * s**1.92 / (s**1.92 + 100.4)
    band = (1e-2, 700.0)
    usual, best = (
        approximate(link, band, 15),
        approximate(link, band, 6, method="minimax"),
    )
    shown = f"{best.order}: {best.error_db:.3f} dB, {best.error_deg:.2f}°"
    wanted = f"below Oustaloup {usual.order}: {usual.error_db:.2f} dB"
    line(
        "minimax poles for the link, 0.01 … 700 rad/s",
        shown,
        wanted,
        best.error_db < usual.error_db,
    )
    wide = approximate(link, (1e-3, 1e5), 15)
    w = np.geomspace(0.1, 1000, 4000)
    error = float(np.max(np.abs(wide.frequency_response(w) / link(1j * w) - 1)))
    line(
        "best Oustaloup band (1e-3 … 1e5, N = 7) on the link",
        f"{error:.2%}",
        "known: about 1 %",
        0.003 < error < 0.03,
    )


def main() -> None:
    crossings()
    against_python_control()
    zeros()
    norms()
    fits()
    approximations()


if __name__ == "__main__":
    main()
