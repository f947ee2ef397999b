"""From a log to a loop: whether a design that passes is stable on the twin with what
the log showed.

    python benchmarks/bench_rigs.py [--rigs 200] [--only links] [--arms 1 100]

The twin's motor has no friction and its gauge no noise here: what moves after the
reference is at rest is instability or vibration, and nothing else.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

import fraclink as fl
from fraclink._arm.reference import prbs
from fraclink._simulate import Beam, KelvinVoigt, PowerLaw, Sensors, Twin, simulate_log
from fraclink.errors import InfeasibleError
from identify_logs import line

PAPER = fl.Rig.named("paper-2023-geared")
DELAYS = (0.0, 0.002, 0.008, 0.020, 0.057, 0.090)
RANGES = ((0.010, 0.020), (0.020, 0.040), (0.040, 0.080))
STEP = fl.smooth_step(0.5, duration=0.5)


def log_of(
    beam: Beam, damping: object, delay: float, seed: int, noise: float = 0.02
) -> fl.Experiment:
    """A log of the twin: 20 s of a PRBS behind the motor loop."""
    time = PAPER.period * np.arange(5001)
    bits = prbs(0.1, 0.24, bits=83, register=9, start=0.5).angle(time)
    sensors = Sensors(gauge_noise=noise, gauge_delay=delay)
    log = simulate_log(
        beam, damping, bits, period=PAPER.period, sensors=sensors, seed=seed
    )  # type: ignore[arg-type]
    return fl.Experiment(
        period=PAPER.period,
        motor_angle=log.motor_angle,
        output=log.torque,
        payload=beam.payload,
    )


def quiet(rig: fl.Rig) -> fl.Rig:
    """The same rig without friction, noise and offset."""
    motor = replace(rig.motor, coulomb_torque=0.0)
    gauge = replace(rig.gauge, noise=0.0, offset=0.0)
    return replace(
        rig,
        motor=motor,
        gauge=gauge,
        encoder=replace(rig.encoder, counts_per_revolution=None),
    )


def moved(design: fl.Design, arm: Twin, payloads: tuple[float, ...]) -> Counter[str]:
    """Why moves of the twin fail, by the words of the verdict; empty where all of them
    pass.
    """
    law = design.law()
    # Long enough to see it: ten periods of the vibration, which a slow arm takes ten
    # seconds for.
    slowest = design.natural_frequency(max(payloads)) ** (2.0 / design.model.order)
    duration = 0.5 + max(5.0, 20.0 * np.pi / slowest)
    runs = (
        fl.simulate(law, STEP, arm=arm, payload=m, duration=duration) for m in payloads
    )
    return Counter(run.verdict.reason for run in runs if not run.verdict.passed)


def designed(
    model: fl.LinkModel | fl.Fit, rig: fl.Rig, crossover: float, margin: float
) -> fl.Design | None:
    """The design for a request or for the nearest one that is feasible; None where
    there is none.
    """
    wanted = {"gain_crossover": crossover, "phase_margin": margin}
    for _ in range(2):
        try:
            return fl.design(model, rig, **wanted)  # type: ignore[arg-type]
        except InfeasibleError as error:
            if not error.nearest:
                return None
            wanted |= error.nearest
    return None


def delays() -> None:
    """The delay of twin logs, by delay and payload."""
    worst, wrong = 0.0, []
    for seed, delay in enumerate(DELAYS):
        for low, high in RANGES:
            for payload in (low, high):
                beam = Beam(
                    PAPER.link.length,
                    PAPER.link.stiffness * PAPER.link.length / 3,
                    0.0,
                    payload,
                )
                fit = fl.identify(
                    log_of(beam, PowerLaw(1.92), delay, seed), details=False
                )
                error = abs(fit.delay - delay)
                worst = max(worst, error)
                if error > 0.5e-3:
                    wrong.append(
                        f"{1e3 * delay:g} ms at {1e3 * payload:g} g: {1e3 * fit.delay:.2f}"
                    )
    line(
        f"delay of {6 * len(DELAYS)} twin logs, worst error",
        f"{1e3 * worst:.3f} ms {'; '.join(wrong)}".strip(),
        "<= 0.5 ms",
        not wrong,
    )


def random_rig(random: np.random.Generator) -> tuple[fl.Rig, fl.LinkModel]:
    """A rig near the paper's, and the link that was identified on it, delay included."""
    length, stiffness = random.uniform(0.4, 0.9), random.uniform(0.8, 3.0)
    low = random.uniform(0.01, 0.05)
    high = low * random.uniform(1.2, 2.5)
    nominal = (low + high) / 2
    link = replace(
        PAPER.link,
        length=length,
        stiffness=stiffness,
        flexural_rigidity=stiffness * length / 3,
        mass=0.0,
    )
    payloads = replace(PAPER.payloads, low=low, high=high, nominal=nominal)
    rig = replace(quiet(PAPER), link=link, payloads=payloads, model=None)
    order = random.uniform(1.86, 1.98)
    frequency = (stiffness / (nominal * length**2)) ** 0.5
    delay = DELAYS[random.integers(len(DELAYS))] * random.uniform(0.8, 1.0)
    return rig, fl.LinkModel(
        stiffness, frequency, order, payload=nominal, gauge_delay=delay
    )


def rigs(count: int) -> None:
    """Designs of random rigs with a late gauge, moved on the twin with that delay."""
    random = np.random.default_rng(14)
    passing = refused = tried = 0
    failed: list[str] = []
    while passing < count and tried < 6 * count:
        tried += 1
        rig, model = random_rig(random)
        crossover = (
            random.uniform(0.9, 1.9)
            * model.at_payload(rig.payloads.high).natural_frequency
        )
        margin = fl.deg(random.uniform(35, 60))
        design = designed(model, rig, crossover, margin)
        if design is None or not design.passed:
            refused += 1
            continue
        passing += 1
        arm = Twin.from_rig(
            rig, model=model, link_mass=0.0, damping=PowerLaw(model.order)
        )
        found = moved(design, arm, (rig.payloads.low, rig.payloads.high))
        if found:
            failed.append(f"{1e3 * model.gauge_delay:.0f} ms: {', '.join(found)}")
    line(
        f"random rigs with a late gauge, {passing} designs that pass ({refused} refused): fail on the twin",
        f"{len(failed)} {'; '.join(failed[:5])}".strip(),
        "0 of >= 200",
        not failed,
    )


def requested(
    fit: fl.Fit, rig: fl.Rig, random: np.random.Generator, omega: float
) -> Iterator[fl.Design]:
    """Designs that pass, of random requests: every second one for the motor loop as its
    PID runs it.
    """
    # The second mode of a heavy link leaves little room above the first: 1.5 of the
    # resonance at 0 g, 1.15 at 20 g and more.
    room = 0.05 + 0.45 * np.exp(-rig.link.mass / 0.008)
    for k in range(6):
        wanted = {
            "gain_crossover": omega * random.uniform(0.97, 1.1 + room),
            "phase_margin": fl.deg(random.uniform(20, 45)),
            "inner": ("ideal", "sampled")[k % 2],
            "placement": ("tustin", "direct")[k % 2],
        }
        try:
            # The law is looked at last: it takes most of the time.
            made = fl.design(fit, rig, **wanted, law=False, nearest=False)  # type: ignore[arg-type]
        except InfeasibleError:
            continue
        if made.passed and (made := made.warned_of_law()).passed:
            yield made


def links(arms: range, count: int) -> None:
    """Links of 0 to 60 g with three dampings: log, fit, design, then moves of the twin
    with that mass.

    Arm k is drawn from the seed (15, k), so that parts of the range can be measured one
    by one.
    """
    found: Counter[str] = Counter()
    failed: list[str] = []
    for k in arms:
        if found["pass"] >= count:
            break
        found["arms"] += 1
        random = np.random.default_rng((15, k))
        mass, payload = random.uniform(0.0, 0.06), random.uniform(0.02, 0.05)
        link = replace(
            PAPER.link,
            mass=mass,
            flexural_rigidity=PAPER.link.stiffness * PAPER.link.length / 3,
        )
        payloads = replace(
            PAPER.payloads, low=0.8 * payload, high=1.3 * payload, nominal=payload
        )
        rig = replace(quiet(PAPER), link=link, payloads=payloads, model=None)
        beam = Beam.from_rig(rig, payload=payload)
        omega = float(beam.modes(1).frequencies[0])
        damping = (
            PowerLaw(1.92),
            PowerLaw(1.98),
            KelvinVoigt.from_ratio(0.01, frequency=omega),
        )[k % 3]
        fit = fl.identify(log_of(beam, damping, 0.002, k))
        if not fit.passed:
            found["gated"] += 1
            continue
        arm = Twin.from_rig(
            rig, model=fit.model, damping=damping, gauge_delay=0.002, gauge_gain=1.0
        )
        before = found["pass"]
        for design in requested(fit, rig, random, omega):
            found["pass"] += 1
            why = moved(design, arm, (rig.payloads.low, rig.payloads.high))
            if why:
                what = f"{1e3 * mass:.0f} g, {damping.label}, {design.motor_loop.kind}"
                failed.append(f"arm {k}, {what}: {', '.join(why)}")
        found["arms with a design"] += found["pass"] > before
    counts = ", ".join(f"{number} {name}" for name, number in found.items())
    line(
        f"links of 0 to 60 g ({counts}): designs that pass and fail on the twin",
        f"{len(failed)} {'; '.join(failed[:5])}".strip(),
        "0 of >= 200",
        not failed,
    )


FIGURES = {
    "delays": lambda options: delays(),
    "rigs": lambda options: rigs(options.rigs),
    "links": lambda options: links(range(*options.arms), options.rigs),
}


def main() -> None:
    """Print every figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=200)
    parser.add_argument("--only", choices=FIGURES)
    parser.add_argument(
        "--arms",
        type=int,
        nargs=2,
        default=(1, 2000),
        help="of the links: from, to before",
    )
    options = parser.parse_args()
    for name, figure in FIGURES.items():
        if options.only in (None, name):
            figure(options)


if __name__ == "__main__":
    main()
