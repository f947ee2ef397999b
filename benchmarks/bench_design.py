"""Design and certificates: every figure beside what is wanted.

Times are medians of CPU seconds of repeated calls; margins are compared with a loop
computed once more, in mpmath at 30 digits with aliases summed one by one.
"""

from __future__ import annotations

import importlib.util
import math
import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import count
from pathlib import Path
from types import ModuleType

import numpy as np

import fraclink as fl
from fraclink._arm.controller import closed_loop_poles
from fraclink._arm.motor_loop import motor_loop_costs
from fraclink._arm.rig import Rig
from fraclink._certify import Certificate, certify, enclose_phase_margin
from fraclink._design import Design
from fraclink._design.alternatives import compare_at_equal_sensitivity, feasibility_map
from fraclink._design.assess import PRINTED, match_at

RIG = Rig.named("paper-2023")
WANTED = {
    "payloads": (0.020, 0.040),
    "gain_crossover": 12.0,
    "phase_margin": fl.deg(50),
}


def figure(name: str, value: str, wanted: str, good: bool, error: str = "") -> None:
    print(
        f"{'ok  ' if good else 'MISS'} {name:<52} {value:<28} wanted {wanted}"
        + (f"  ({error})" if error else "")
    )


def near(name: str, value: float, wanted: float, tolerance: float) -> None:
    gap = abs(value - wanted)
    figure(
        name,
        f"{value:.8g}",
        f"{wanted:g} ± {tolerance:g}",
        gap <= tolerance,
        f"error {gap:.1e}",
    )


def seconds(work: Callable[[], object], repeats: int) -> list[float]:
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        work()
        times.append(time.process_time() - begin)
    return times


def timed(name: str, work: Callable[[], object], repeats: int, limit: float) -> None:
    times = seconds(work, repeats)
    middle = statistics.median(times)
    spread = f"{min(times) * 1e3:.3g} … {max(times) * 1e3:.3g} ms"
    figure(
        name,
        f"{middle * 1e3:.3g} ms",
        f"<= {limit * 1e3:g} ms",
        middle <= limit,
        spread,
    )


def paper() -> None:
    design = fl.design(
        RIG.model,
        RIG,
        natural_frequencies=(9.42, 14.14),
        gain_crossover=16.0,
        phase_margin=fl.deg(70),
        margins="ideal",
    )
    for name, value, wanted in (
        ("χ (54)", design.chi, 1.324873),
        ("β (55)", design.controller.order, 0.655361),
        ("k_d", design.controller.gain, 0.215299),
        ("ω̄_c [rad/s]", design.gain_crossover_upper, 27.346181),
        ("δ by the 10 % rule, n = 1 [s]", design.controller.filter_time, 0.004529),
    ):
        near(name, value, wanted, 5e-7)
    two = fl.design(
        RIG.model,
        RIG,
        natural_frequencies=(9.42, 14.14),
        gain_crossover=16.0,
        phase_margin=fl.deg(70),
        margins="ideal",
        filter_order=2,
    )
    near("δ by the 10 % rule, n = 2 [s]", two.controller.filter_time, 0.002246, 5e-7)
    nominal = design.at_frequency(11.54)
    near("nominal ω_c [rad/s]", nominal.gain_crossover, 20.865280, 5e-7)
    near("nominal φ [deg]", math.degrees(nominal.phase_margin), 70.741858, 5e-7)
    link = replace(RIG.model, order=2.0)
    matched = match_at(link, 11.54, nominal.gain_crossover, nominal.phase_margin)
    near("β' (λ = 2, matched)", matched.order, 0.786021, 5e-7)
    near("k_d'", matched.gain, 0.208339, 5e-7)
    pole = closed_loop_poles(
        PRINTED["(58)"], replace(RIG.model, natural_frequency=11.547), inner_pole=80.0
    )[0]
    near("(58) printed: Re of its pole at 30 g", pole.real, 0.106, 5e-4)
    near("(58) printed: |Im|", abs(pole.imag), 12.89, 5e-3)


def default() -> Design:
    design = fl.design(RIG.model, RIG, **WANTED, filter_time=0.0)
    near("default k_d", design.controller.gain, 0.069876, 5e-7)
    near("default β", design.controller.order, 0.612197, 5e-7)
    near("default ω̄_c [rad/s]", design.gain_crossover_upper, 17.7718, 5e-5)
    correction = design.controller.correction()

    def sums(w: np.ndarray) -> np.ndarray:  # the paper's: a backward difference for s
        return correction(-np.expm1(-1j * w * RIG.period) / RIG.period)

    given = ((0.040, 63.9), (0.030, 57.9), (0.020, 48.8), (0.016, 43.3), (0.008, 23.9))
    for payload, wanted in given:
        found = design.sampled_at(payload, realisation=sums)
        name = f"sampled margin, Grünwald law, {payload * 1e3:g} g [deg]"
        near(name, math.degrees(found.phase_margin), wanted, 0.5)
    for payload, wanted in given:
        found = design.sampled_at(payload)
        name = f"sampled margin, shipped law, {payload * 1e3:g} g [deg]"
        value = math.degrees(found.phase_margin)
        figure(name, f"{value:.4f}", f">= {wanted} - 0.5", value >= wanted - 0.5)
    return design


def independent_margin(design: Design, payload: float) -> float:
    """Phase margin of the sampled loop with Ĉ(jω), in mpmath: 400 aliases, no closed
    tail.
    """
    from mpmath import mp

    mp.dps = 30
    period, pole, order = mp.mpf(RIG.period), mp.mpf(80), mp.mpf(design.model.order)
    spring = mp.mpf(design.natural_frequency(payload)) ** 2
    c = design.controller

    def loop(w: object) -> object:
        total = mp.mpc(0)
        for k in range(-400, 401):
            s = mp.mpc(0, w + 2 * mp.pi * k / period)
            total += spring / (s**order + spring) / (1 + s / pole) ** 2 / s
        x = mp.expj(-w * period)
        outer = (
            c.gain
            * mp.mpc(0, w) ** c.order
            / (1 + c.filter_time * mp.mpc(0, w)) ** c.filter_order
        )
        return outer * (1 - x) / period * x * total

    guess = design.at(payload).gain_crossover
    w = mp.findroot(lambda v: mp.log(abs(loop(v))), (guess, guess * 1.001))
    return float(mp.degrees(mp.arg(-loop(w))))


def margins(design: Design) -> None:
    for payload in (0.020, 0.040):
        exact = independent_margin(design, payload)
        found = math.degrees(
            design.sampled_at(payload, realisation="exact").phase_margin
        )
        near(
            f"sampled margin against mpmath, {payload * 1e3:g} g [deg]",
            found,
            exact,
            0.01,
        )
        near(
            f"margin the design claims, {payload * 1e3:g} g [deg]",
            math.degrees(design.at(payload).phase_margin),
            exact,
            0.01,
        )
    sampled = fl.design(RIG.model, RIG, **WANTED, filter_time=0.0, inner="sampled")
    gap = (
        sampled.at(0.020).phase_margin
        - sampled.sampled_at(0.020, realisation="exact").phase_margin
    )
    near(
        "the same, sampled motor loop, 20 g: difference [deg]",
        math.degrees(gap),
        0.0,
        0.01,
    )


def speed() -> None:
    # Another crossover each time: a repeated request would be answered from a cache.
    asked = count()

    def call(**options: str) -> Design:
        crossover = 12.0 + 1e-3 * next(asked)
        wanted = {
            "gain_crossover": crossover,
            "phase_margin": fl.deg(50),
            "payloads": (0.020, 0.040),
        }
        return fl.design(RIG.model, RIG, **wanted, **options)

    timed("design call, rule's filter", call, 41, 5e-3)
    timed("design call, sampled motor loop", partial(call, inner="sampled"), 21, 5e-3)
    axes = {
        "gain_crossovers": np.linspace(8.0, 50.0, 100),
        "phase_margins": np.radians(np.linspace(10.0, 100.0, 100)),
    }
    timed(
        "feasibility map 100 × 100",
        lambda: feasibility_map(RIG.model, RIG, payloads=(0.020, 0.040), **axes),
        3,
        3.0,
    )


def load_checker() -> ModuleType:
    place = Path(__file__).resolve().parents[1] / "tools" / "check_certificate.py"
    spec = importlib.util.spec_from_file_location("check_certificate", place)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def certificates() -> None:
    checker = load_checker()
    for inner, placement in (
        ("ideal", "tustin"),
        ("sampled", "tustin"),
        ("sampled", "direct"),
    ):
        design = fl.design(
            RIG.model, RIG, **WANTED, filter_time=0.0, inner=inner, placement=placement
        )
        law = design.law()
        name = f"{inner} motor loop" + (f", {placement}" if inner == "sampled" else "")
        found: list[Certificate] = []

        def make() -> None:
            # called at once
            certificate = certify(design, law=law, modulus_margin=0.35)  # noqa: B023
            found.append(certificate)  # noqa: B023

        timed(f"certificate |1+L| > 0.35, {name}: make", make, 3, 5.0)
        with tempfile.TemporaryDirectory() as folder:
            place = Path(folder) / "certificate.json"
            found[0].save(place)
            timed(
                f"certificate, {name}: check",
                partial(checker.check, str(place), law.digest),
                3,
                5.0,
            )
        figure(
            f"certificate, {name}: leaves",
            str(found[0].leaves),
            "proved",
            found[0].passed,
        )
        exact = replace(found[0].statement, delay_low=0.004)
        enclosed = enclose_phase_margin(exact, law)
        limit = 0.05 if inner == "ideal" else 1.0
        width = math.degrees(enclosed.high - enclosed.low)
        figure(
            f"worst margin enclosed, {name} [deg]",
            f"{width:.4f}",
            "<= 0.01",
            width <= 0.0100001,
        )
        again = partial(enclose_phase_margin, exact, law)
        timed(f"worst margin enclosed, {name}", again, 5, limit)
    refused = certify(
        PRINTED["(58)"], model=RIG.model, rig=RIG, payloads=(0.020, 0.040)
    )
    figure(
        "(58) as printed",
        refused.verdict[:60],
        "refused as unstable",
        "unstable" in refused.verdict,
    )


def comparison(design: Design) -> None:
    print(
        "\nat equal worst Ms = 1.55, 20–40 g, no filter (printed controllers as they are):"
    )
    print(
        f"{'controller':<22}{'β':>8}{'k_d':>10}{'stable':>8}{'ω_c':>8}{'φ_m':>8}{'noise':>9}"
    )
    for rival in compare_at_equal_sensitivity(design, max_sensitivity=1.55):
        c = rival.controller
        print(
            f"{rival.name:<22}{c.order:>8.4f}{c.gain:>10.5f}{rival.stable!s:>8}{rival.gain_crossover:>8.2f}"
            f"{math.degrees(rival.phase_margin):>8.1f}{rival.noise_gain:>9.2f}"
        )
    print("\nthe motor loop at p = 80 rad/s, 4 ms, one sample of delay:")
    for cost in motor_loop_costs(RIG, frequency=18.0):
        print(
            f"{cost.placement:<8} radius {cost.radius:.4f}, modulus margin {cost.modulus_margin:.3f}, "
            f"lag behind M(s) {math.degrees(cost.lag):+.2f}° at 18 rad/s, "
            f"noise {cost.voltage_per_noise:.1f} V/rad"
        )


def main() -> None:
    paper()
    design = default()
    margins(design)
    speed()
    certificates()
    comparison(design)


if __name__ == "__main__":
    main()
