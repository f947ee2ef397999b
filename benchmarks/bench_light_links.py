"""Links of aluminium and steel with hardly any damping in any mode: designs without a
request, and a move of the law that ships on the twin.

A draw has a link of 10 to 65 g, payloads within 20 to 40 g and one damping ratio of 0.1
to 1 % for every mode; the model is the first two modes of the beam as identified from a
log at the middle payload. The law runs on the twin with that payload and with both
ends.
"""

from __future__ import annotations

import collections
import math
import time
from dataclasses import replace

import numpy as np

import fraclink as fl
from fraclink import LinkModel, SecondMode
from fraclink._arm.beam import modal_shares
from fraclink.errors import InfeasibleError
from fraclink.extend import Beam, PowerLaw
from harness import line, sizes

# The motor of "paper-2023" has half a per cent of the inertia of these arms: the torque
# reading arrives too late for a vibration at 90 rad/s.
RIG = fl.Rig.named("paper-2023-geared")


def light_arm(seed: int) -> tuple[fl.Rig, LinkModel, fl.Twin, tuple[float, float]]:
    """(rig, model, twin, payloads) of a seed."""
    draw = np.random.default_rng(seed)
    mass, payload = float(draw.uniform(0.010, 0.065)), float(draw.uniform(0.02, 0.04))
    ratio = float(10.0 ** draw.uniform(-3.0, -2.0))
    rig = replace(RIG, link=replace(RIG.link, mass=mass))
    assert rig.model is not None
    # a power law s^λ = -ω² damps all modes equally, and shifts each to ω^(2/λ)
    law = PowerLaw(math.pi / math.acos(-ratio))
    undamped, sizes_ = modal_shares(Beam.from_rig(rig, payload=payload))
    frequencies = undamped ** (2.0 / law.order)
    shares = sizes_ / rig.model.stiffness
    model = replace(
        rig.model,
        order=2.0,
        natural_frequency=float(frequencies[0]),
        damping=2.0 * ratio * float(frequencies[0]),
        damping_order=1.0,
        gauge_gain=float(shares[0]),
        payload=payload,
        second_mode=SecondMode(
            float(frequencies[1]), float(shares[1] / shares[0]), ratio
        ),
    )
    twin = fl.Twin.from_rig(rig, payload=payload, damping=law)
    twin = replace(twin, gauge_gain=1.0)
    return rig, model, twin, (max(0.02, 0.75 * payload), min(0.04, 1.333 * payload))


def judged(seed: int) -> tuple[str, float]:
    """The outcome for an arm, and the CPU time of its design [s]."""
    rig, model, twin, payloads = light_arm(seed)
    begin = time.process_time()
    try:
        made = fl.design(model, rig, payloads=payloads, box=False)
    except InfeasibleError as error:
        return f"refused: {error.condition}", time.process_time() - begin
    spent = time.process_time() - begin
    swing = 1.2 * 2.0 * math.pi / model.natural_frequency
    reference = fl.smooth_step(0.3, duration=swing)
    law = made.law()
    for payload in (*payloads, model.payload):
        arm = replace(twin, beam=replace(twin.beam, payload=payload))
        run = fl.simulate(law, reference, arm=arm, payload=payload, told=True)
        if not run.verdict.passed:
            grams = f"{1e3 * payload:.0f} g"
            return f"fails on the twin at {grams}: {run.verdict.reason[:60]}", spent
    return "passed", spent


def main() -> None:
    """Print the outcomes for all arms."""
    count = sizes(__doc__, arms=(60, 1)).arms
    words: collections.Counter[str] = collections.Counter()
    times = []
    for seed in range(count):
        word, spent = judged(seed)
        words[word.partition(" at ")[0].partition(":")[0]] += 1
        times.append(spent)
        print(f"     arm {seed}: {word} ({spent:.2f} s)", flush=True)
    for word, number in words.most_common():
        print(f"     {number:5} {word}")
    line(
        "light links with a law that passes on the twin",
        f"{words['passed']} of {count}",
        ">= 80 %",
        words["passed"] >= 0.8 * count,
    )
    print(
        f"     CPU of a design: median {np.median(times):.2f}, most {max(times):.2f} s"
    )


if __name__ == "__main__":
    main()
