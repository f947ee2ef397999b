"""Frequency responses of a link with its motor: 5 % relative noise, and bands that miss
a feature.

The arm is that of the bundled rig with its gear (paper-2023-geared) and the link of the
paper (λ = 1.92, ω₀ = 10.02 s^(−λ/2)), voltage to motor angle, 2 ms of delay, 200 lines
from 1 to 80 rad/s. The noise is complex and normal, 5 % of each line. A band misses a
feature if it ends below or begins above it.
"""

from __future__ import annotations

import time

import numpy as np

import fraclink as fl
import fracsys
from harness import line, sizes

NOISE, ORDER, FREQUENCY, DELAY = 0.05, 1.92, 10.02, 0.002
LINES = np.geomspace(1.0, 80.0, 200)


def arm() -> fracsys.FractionalTransferFunction:
    """θm/V of link and motor."""
    rig, s = fl.Rig.named("paper-2023-geared"), fracsys.s
    inertia = rig.motor.inertia * rig.motor.gear_ratio**2
    link = s**ORDER / (s**ORDER + FREQUENCY**2)
    return (
        rig.motor.gain
        / (s**2 + rig.motor.decay * s + rig.link.stiffness / inertia * link)
    ).delayed(DELAY)


def noisy(seed: int) -> fl.FrequencyResponse:
    rng = np.random.default_rng(seed)
    error = rng.standard_normal((2, LINES.size)) / np.sqrt(2)
    return fl.FrequencyResponse(
        LINES, arm()(1j * LINES) * (1 + NOISE * (error[0] + 1j * error[1]))
    )


def missed(seeds: int, low: float, high: float, code: str) -> tuple[int, int]:
    """How many fits to a part of the band carry the code, and how many pass all the
    same.
    """
    found = [
        fl.extend.identify_driven_link(noisy(seed).between(low, high), details=False)
        for seed in range(seeds)
    ]
    return sum(code in {f.code for f in fit.findings} for fit in found), sum(
        fit.passed for fit in found
    )


def main() -> None:
    seeds = sizes(__doc__, seeds=(20, 1)).seeds
    clean = fl.extend.identify_driven_link(
        fl.FrequencyResponse(LINES, arm()(1j * LINES)), details=False
    )
    dip, peak = FREQUENCY ** (2 / ORDER), float(clean.peak or np.nan)
    begin = time.process_time()
    fits = [fl.extend.identify_driven_link(noisy(seed)) for seed in range(seeds)]
    seconds = (time.process_time() - begin) / seeds
    dips = max(abs(fit.anti_resonance / dip - 1) for fit in fits)
    peaks = max(abs((fit.peak or np.nan) / peak - 1) for fit in fits)
    orders = [abs(fit.order - ORDER) for fit in fits]
    inside = sum(fit.intervals["l"].contains(ORDER) for fit in fits)
    line(
        f"anti-resonance {dip:.4g} rad/s, worst of {seeds}",
        f"{100 * dips:.2f} %",
        "<= 2 %",
        dips <= 0.02,
    )
    line(
        f"peak {peak:.4g} rad/s, worst of {seeds}",
        f"{100 * peaks:.2f} %",
        "<= 2 %",
        peaks <= 0.02,
    )
    spread = f"{max(orders):.4f}, median {np.median(orders):.4f}"
    line(f"λ, worst of {seeds}", spread, "<= 0.02", max(orders) <= 0.02)
    line(
        "fits that pass",
        f"{sum(fit.passed for fit in fits)} of {seeds}",
        f"{seeds}",
        all(f.passed for f in fits),
    )
    line(
        "95 % intervals of λ that hold it",
        f"{inside} of {seeds}",
        ">= 17",
        inside >= 17 * seeds / 20,
    )
    for low, high, code, words in (
        (1.0, 0.96 * dip, "W315", "band ends below the anti-resonance"),
        (1.04 * dip, 80.0, "W315", "band begins above the anti-resonance"),
        (1.0, 0.96 * peak, "W315", "band ends below the peak"),
        (1.04 * peak, 80.0, "W315", "band begins above the peak"),
    ):
        told, passed = missed(seeds, low, high, code)
        line(
            words,
            f"{code} in {told}, {passed} pass",
            f"{seeds}, 0",
            told == seeds and not passed,
        )
    print(f"     {seconds:.2f} s of the processor for a fit with profile intervals")


if __name__ == "__main__":
    main()
