"""Roots, margins and discrete fits: their times next to the target and python-control,
and the error of the fit next to that from random starts.

Times are medians of processor time, calls taken in turns.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import control
import numpy as np

from fracsys import FractionalTransferFunction, margins, s, to_control
from fracsys._discrete import DiscreteFits
from fracsys._minimax import PartialFractions, improve, score
from fracsys._roots import log_zeros
from harness import interleaved, line, median, sizes

PERIOD = 0.004
BETA, GAIN, W = 0.65, 0.148, 10.0


def link_loop(
    order: float, gain: float = GAIN, beta: float = BETA
) -> FractionalTransferFunction:
    return gain * s**beta * W**2 / (s**order + W**2)


def against_python_control(rounds: int) -> None:
    """Margins against python-control's, on the grid that `to_control` writes."""
    loop = GAIN * s**BETA / (1 + 0.16 * s) ** 2 * 10.31**2 / (s**1.92 + 10.31**2)
    peer = to_control(loop)
    calls = {
        "own": lambda: margins(loop),
        "peer": lambda: control.stability_margins(peer),
    }
    spent = interleaved(calls, rounds)
    ratio, _ = median(spent["peer"] / spent["own"])
    line(
        "margins faster than control.stability_margins on our grid",
        f"{ratio:.0f} ×",
        ">= 10 ×",
        ratio >= 10,
    )


def zeros(cases: int) -> None:
    """Time of all zeros of a random sum of powers, with their count certified."""
    rng = np.random.default_rng(3)
    for n in (3, 4, 5, 6):
        times = []
        for _ in range(cases):
            orders = np.sort(rng.uniform(0, rng.uniform(1, 6), n))
            coefficients = rng.normal(size=n) * 10 ** rng.uniform(-4, 4, n)
            begin = time.thread_time()
            log_zeros(coefficients, orders, angle=math.pi)
            times.append(1e3 * (time.thread_time() - begin))
        middle, high = np.percentile(times, [50, 99])
        line(
            f"zeros of {n} terms, certified",
            f"{middle:.2f} ms, 99 % below {high:.1f} ms",
            "<= 3 ms",
            bool(middle <= 3),
        )


def correction(filter_time: float) -> Callable[[np.ndarray], np.ndarray]:
    """Ĉ of eq. (58) with another filter time."""
    return lambda w: GAIN * (1j * w) ** BETA / (1 + 1j * filter_time * w) ** 2


FITS = {
    "δ = 0.16, 0.05 … 785 rad/s": (correction(0.16), (0.05, 785.0), 4),
    "δ = 0.016, 0.05 … 600 rad/s": (correction(0.016), (0.05, 600.0), 6),
}


def fits(starts: int) -> None:
    for name, (response, band, order) in FITS.items():
        begin = time.perf_counter()
        made = DiscreteFits(
            response, period=PERIOD, band=band, zeros_at_one=1, offset=1.0
        ).fit()
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
        _restarts(response, band, order, starts)
    bare = DiscreteFits(
        lambda w: 0.06988 * (1j * w) ** 0.6122,
        period=PERIOD,
        band=(0.05, 200.0),
        zeros_at_one=1,
        offset=1.0,
    ).fit()
    shown = f"{bare.order}: {bare.error_db:.3f} dB, {bare.error_deg:.3f}°"
    line(
        "states without filter, 0.05 … 200 rad/s",
        shown,
        "6",
        bare.order <= 6 and bare.error_db <= 0.1,
    )
    ahead = DiscreteFits(
        lambda w: (1j * w) ** -0.08, period=PERIOD, band=(0.05, 300.0)
    ).fit()
    shown = f"{ahead.order}: {ahead.error_db:.3f} dB, {ahead.error_deg:.3f}°"
    line(
        "states of s^-0.08, 0.05 … 300 rad/s",
        shown,
        "6",
        ahead.order <= 6 and ahead.error_db <= 0.1,
    )


def _restarts(
    response: Callable[[np.ndarray], np.ndarray],
    band: tuple[float, float],
    order: int,
    starts: int,
) -> None:
    """The error of the growing fit relative to the best of random starts: 1 is equally
    good.
    """
    grown = DiscreteFits(response, period=PERIOD, band=band, zeros_at_one=1, offset=1.0)
    made, target = grown.fit(order), grown.target
    reached = max(made.error_db / 0.1, made.error_deg / 0.5)
    low, high = (
        math.log(math.tan(0.5 * band[0] * PERIOD)),
        math.log(math.tan(0.5 * band[1] * PERIOD)) + 2,
    )
    rng, best = np.random.default_rng(0), math.inf
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


def main() -> None:
    given = sizes(__doc__, rounds=(15, 1), cases=(100, 2), starts=(60, 2))
    against_python_control(given.rounds)
    zeros(given.cases)
    fits(given.starts)


if __name__ == "__main__":
    main()
