"""Figures of the twin: modes, speed, deviation from the lumped model, and the model
identified from it.
"""

from __future__ import annotations

import math
import statistics
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np

from fraclink import (
    Design,
    Experiment,
    Rig,
    Twin,
    compare_structures,
    design,
    discretize,
    prbs,
    simulate,
    smooth_step,
)
from fraclink._simulate import assemble
from fraclink.extend import (
    Beam,
    FractionalKelvinVoigt,
    KelvinVoigt,
    PowerLaw,
    geared,
)
from harness import line, sizes

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from exact_frequencies import exact_frequencies
from reproduce.twin_logs import on_servo, simulate_log
from state_space import of_law, of_plant, spectral_radius

STIFFNESS, LENGTH, LINK_MASS, PERIOD = 1.56, 0.65, 0.00735, 0.004
RIGIDITY = STIFFNESS * LENGTH / 3
RATIO = 0.0654  # damping ratio of the mode at λ = 1.92, used for all three materials


def modes() -> None:
    """Print the worst error of a frequency over a grid of links, and the frequencies of
    the carbon rod.
    """
    worst = 0.0
    for payload in (0.0, 0.008, 0.020, 0.030, 0.040):
        for mass in (1e-6, 1e-4, 0.002, 0.00735, 0.02, 0.05):
            beam = Beam(LENGTH, 0.26, mass, payload)
            worst = max(
                worst,
                float(
                    np.abs(
                        beam.modes(3).frequencies / exact_frequencies(beam) - 1
                    ).max()
                ),
            )
    line("first three modes against exact roots, 30 links", f"{worst:.1e}", "<= 1e-4")
    rod = Beam(LENGTH, 0.26, LINK_MASS, 0.030).modes(3).frequencies
    line(
        "carbon rod 7.35 g, 30 g",
        "/".join(f"{w:.2f}" for w in rod),
        "9.46/177.5/569.8 rad/s",
    )


def designed(filter_time: float | None = None) -> Design:
    """Return the design whose law moves the twins: its own filter, or one that is
    given.
    """
    rig = geared(Rig.named("paper-2023"))
    return design(
        rig.model,
        rig,
        payloads=(0.020, 0.040),
        gain_crossover=12.0,
        phase_margin=np.radians(50.0),
        filter_time=filter_time,
    )


def speed(rounds: int) -> None:
    """Print how much faster than real time a twin with three modes at 1 ms runs under
    the shipped law.
    """
    result = designed()
    move = smooth_step(1.0, duration=0.6)
    for damping in (
        KelvinVoigt(0.0118),
        FractionalKelvinVoigt(0.04, 0.5),
        PowerLaw(1.92),
    ):
        twin = Twin.from_rig(result.rig, link_mass=LINK_MASS, damping=damping, modes=3)
        seconds = []
        for _ in range(rounds):
            began = time.process_time()
            simulate(result, move, arm=twin, duration=40.0)
            seconds.append(time.process_time() - began)
        factor = 40.0 / statistics.median(seconds)
        line(
            f"twin and law, 3 modes, 1 ms, {damping.label.split(',')[0]}",
            f"{factor:.0f} x real time",
            ">= 100",
        )


def lumped_table(payloads: int) -> None:
    """Print the twin's tip against the lumped model with eq. (5) and with the matched
    mode, 8 to 40 g.
    """
    move = smooth_step(1.0, duration=0.6)
    reference = move.angle(PERIOD * np.arange(1000))
    print(
        "payload g | link/payload | eq. (5) off % | mode 2 rad/s | tip apart mrad: eq. (5)/matched/1 mode"
    )
    table = (0.008, 0.012, 0.016, 0.020, 0.025, 0.030, 0.035, 0.040)
    for payload in table[:payloads]:
        beam = Beam(LENGTH, RIGIDITY, LINK_MASS, payload)
        modes_ = beam.modes(3).frequencies
        naive = Beam(LENGTH, RIGIDITY, 0.0, payload)
        matched = Beam(LENGTH, RIGIDITY, 0.0, STIFFNESS / (modes_[0] * LENGTH) ** 2)
        truth = simulate_log(beam, PowerLaw(1.92), reference).tip_angle
        apart = [
            1e3
            * float(
                np.abs(
                    simulate_log(b, PowerLaw(1.92), reference, modes=m).tip_angle
                    - truth
                ).max()
            )
            for b, m in ((naive, 1), (matched, 1), (beam, 1))
        ]
        # eq. (5)
        lumped = math.sqrt(naive.stiffness / (naive.payload * naive.length**2))
        print(
            f"{payload * 1e3:.0f} | {LINK_MASS / payload:.2f} | "
            f"{100 * (lumped / modes_[0] - 1):.1f} | "
            f"{modes_[1]:.0f} | {apart[0]:.1f} / {apart[1]:.1f} / {apart[2]:.1f}"
        )


def spillover(filter_time: float | None) -> None:
    """Print whether our design is stable with the modes of a link that it was not told
    of.

    The linear sampled loop of the shipped law with the twin behind the ideal motor
    servo, no friction. The power-law link has relaxations slower than any run, with poles
    that equal 1 to eleven digits: "stable" therefore means a radius below 1 + 1e-9.
    """
    result = designed(filter_time)
    rig = result.rig
    filtered = f"{1e3 * result.controller.filter_time:.2g} ms"
    correction = of_law(discretize(result.controller, rig.period))
    for mass in (LINK_MASS, 0.0141):
        beam = Beam(LENGTH, RIGIDITY, mass, 0.030)
        omega = float(beam.modes(1).frequencies[0])
        cases = (
            PowerLaw(1.92),
            PowerLaw(1.98),
            PowerLaw(1.995),
            KelvinVoigt(0.02 / omega),
            KelvinVoigt(0.002 / omega),
        )
        for damping in cases:
            plant = on_servo(assemble(beam, damping, hub_inertia=1.0))
            seen = of_plant(
                plant, plant.outputs[0] - plant.outputs[3] / STIFFNESS, rig.period, 1
            )
            radius = spectral_radius(seen, correction)
            second = float(plant.modes.frequencies[1])
            z = np.exp(1j * np.linspace(0.7 * second, 1.6 * second, 3000) * rig.period)
            gain = float(np.abs(seen.response(z) * correction.response(z)).max())
            line(
                f"spillover, filter {filtered}, link {1e3 * mass:g} g, {damping.label}",
                "stable"
                if radius < 1 + 1e-9
                else f"unstable, radius 1 + {radius - 1:.1e}",
                "stable",
                note=f"|L| at mode 2: {gain:.2f}",
            )


def fractional(order: float, omega: float) -> FractionalKelvinVoigt:
    """Return the fractional damping of order α with the same damping ratio at ω."""
    return FractionalKelvinVoigt(
        2 * RATIO / (omega**order * np.sin(np.pi * order / 2)), order
    )


def chosen(
    beam: Beam, damping: object, samples: int, pole: float, seeds: int
) -> tuple[Counter[str], Counter[str]]:
    """Count what a comparison and what AIC alone prefer over noise seeds, noise 1 % of
    the torque's power.
    """
    bits = prbs(0.1, 0.24, bits=int(samples * PERIOD / 0.24) + 1, register=9, start=0.5)
    reference = bits.angle(PERIOD * np.arange(samples))
    clean = simulate_log(beam, damping, reference, pole=pole)  # type: ignore[arg-type]
    by_comparison: Counter[str] = Counter()
    by_aic: Counter[str] = Counter()
    for seed in range(seeds):
        noise = (
            0.1
            * clean.torque.std()
            * np.random.default_rng(seed).standard_normal(samples)
        )
        log = Experiment(
            period=PERIOD, motor_angle=clean.motor_angle, output=clean.torque + noise
        )
        comparison = compare_structures(log, details=False, heldout=0.0)
        fits = comparison.fits
        by_comparison[comparison.preferred] += 1
        by_aic[min(fits, key=lambda name: fits[name].aic)] += 1
    return by_comparison, by_aic


def discrimination(seeds: int, beams: int, materials: int) -> None:
    """Print how often identification names the material of the twin."""
    massless = Beam(LENGTH, RIGIDITY, 0.0, 0.030)
    rod = Beam(LENGTH, RIGIDITY, LINK_MASS, 0.030)
    for beam, pole, name in (
        (massless, 80.0, "massless link, hub at 80 rad/s"),
        (rod, 10.0, "7.35 g link, hub at 10 rad/s"),
        (rod, 80.0, "7.35 g link, hub at 80 rad/s: mode 2 is in the log"),
    )[:beams]:
        omega = float(beam.modes(1).frequencies[0])
        cases: list[tuple[str, object, int, str]] = [
            ("UD-FOM", PowerLaw(1.92), 5001, "power law 1.92"),
            (
                "D-IOM",
                KelvinVoigt(2.0 * RATIO / omega),
                5001,
                "Kelvin-Voigt",
            ),
            ("D-FOM", fractional(0.5, omega), 5001, "fractional 0.5"),
            ("D-FOM", fractional(0.5, omega), 10001, "fractional 0.5"),
            ("D-FOM", fractional(0.7, omega), 20001, "fractional 0.7"),
        ][:materials]
        for right, damping, samples, material in cases:
            preferred, by_aic = chosen(beam, damping, samples, pole, seeds)
            line(
                f"{name}; {material}, {samples} samples -> {right}",
                f"preferred {100 * preferred[right] / seeds:.0f} %",
                ">= 95 %",
                note=f"AIC {100 * by_aic[right] / seeds:.0f} %; preferred {dict(preferred)}",
            )


def main() -> None:
    """Print every figure."""
    given = sizes(
        __doc__,
        seeds=(100, 1),
        rounds=(7, 1),
        payloads=(8, 1),
        beams=(3, 1),
        materials=(5, 1),
    )
    modes()
    speed(given.rounds)
    lumped_table(given.payloads)
    spillover(None)
    if not given.short:
        spillover(0.04)
    discrimination(given.seeds, given.beams, given.materials)


if __name__ == "__main__":
    main()
