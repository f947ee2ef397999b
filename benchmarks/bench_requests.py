"""Requests to `design`: the table of known ones, random ones against a random search of
their own, and what refusals offer, followed.

A random request draws an arm (λ 1.86 to 2, with and without damping, a second mode, a
gauge 0 to 30 ms late), payloads and bounds. Each ends as one of: a design with every
row kept; a refusal with an offer, which is followed and has to pass; a refusal without
one. A search of 2000 random controllers says whether a refusal was right.
"""

from __future__ import annotations

import collections
import math
import time
from dataclasses import replace
from typing import Any

import numpy as np

import fraclink as fl
from fraclink._arm.link import LinkModel, SecondMode
from fraclink._arm.rig import Rig
from fraclink._design.procedure import request_of
from fraclink._design.request import Request
from fraclink._design.solver import Problem
from fraclink._law.design import Specification
from fraclink.errors import FieldError, InfeasibleError
from harness import line, sizes

CONTROLLERS = 2000
RIG = Rig.named("paper-2023")
# What the sketch of one solver has, without the rows that it does not know, and what
# the procedure and the searches before it had: worst noise gain over 20 to 40 g.
TABLE: tuple[tuple[str, dict[str, Any], float, str], ...] = (
    ("12 rad/s, 50°", {"phase_margin": fl.deg(50)}, 0.33, "1.41"),
    (
        "… and Ms 1.5",
        {"phase_margin": fl.deg(50), "max_sensitivity": 1.5},
        math.nan,
        "failed",
    ),
    ("… over the box, 45°", {"phase_margin": fl.deg(45), "box": True}, 0.79, "4.58"),
    (
        "100°, noise 0.5",
        {"phase_margin": fl.deg(100), "noise_gain": 0.5},
        0.535,
        "7.60",
    ),
    ("Ms 1.58", {"max_sensitivity": 1.58}, 0.4082, "0.4080"),
    ("Ms 1.64", {"max_sensitivity": 1.64}, 0.3643, "0.3645"),
    ("Ms 1.69", {"max_sensitivity": 1.69}, 0.3364, "0.3364"),
    ("Ms 1.705", {"max_sensitivity": 1.705}, 0.3292, "0.658"),
)


def table() -> None:
    """Print the known requests: CPU time with the law, and the worst noise gain."""
    for name, options, sketch, before in TABLE:
        begin = time.process_time()
        try:
            made = fl.design(RIG.model, RIG, gain_crossover=12.0, **options)
        except InfeasibleError as error:
            spent = time.process_time() - begin
            print(f"{name:22} {1e3 * spent:6.0f} ms  {error.nearest}")
            continue
        spent = time.process_time() - begin
        links = np.geomspace(*made.natural_frequencies, 9)
        noise = float(np.max(made.full_loop.noise_gain(links, RIG.period)))
        print(
            f"{name:22} {1e3 * spent:6.0f} ms  noise {noise:.4f} (sketch {sketch:g}, before {before})"
            f"  {'passed' if made.passed else 'FAILED'}"
        )


def random_request(seed: int) -> tuple[LinkModel, Rig, dict[str, Any]]:
    """The request of a seed: the same everywhere."""
    draw = np.random.default_rng(seed)
    rig = Rig.named(str(draw.choice(["paper-2023", "paper-2023-geared"])))
    assert rig.model is not None
    order = float(draw.uniform(1.86, 2.0))
    own = rig.model.natural_frequency ** (order / rig.model.order)
    model = replace(rig.model, order=order, natural_frequency=own, payload=0.03)
    if draw.random() < 0.4:
        damping = float(draw.uniform(0.05, 2.0))
        model = replace(model, damping=damping, damping_order=1.0)
    if draw.random() < 0.5:
        model = replace(model, gauge_delay=float(draw.uniform(0.0, 0.03)))
    if draw.random() < 0.3:
        mode = SecondMode(
            float(draw.uniform(100.0, 250.0)),
            float(draw.uniform(0.005, 0.05)),
            float(draw.uniform(0.02, 0.2)),
        )
        model = replace(model, second_mode=mode)
    light = 10.0 ** draw.uniform(-2.0, -1.5)
    payloads = light, light * 10.0 ** draw.uniform(0.05, 0.4)
    heavy = model.at_payload(payloads[1])
    resonance = heavy.natural_frequency ** (2.0 / order)
    options: dict[str, Any] = {"payloads": payloads}
    options["gain_crossover"] = float(resonance * draw.uniform(0.9, 1.8))
    if draw.random() < 0.7:
        options["phase_margin"] = math.radians(draw.uniform(25, 70))
    else:
        options["max_sensitivity"] = float(draw.uniform(1.3, 2.2))
    if draw.random() < 0.3:
        options["noise_gain"] = float(10.0 ** draw.uniform(-0.3, 1.0))
    return model, rig, options


def searched(request: Request, seed: int) -> bool:
    """Whether one of 2000 random controllers keeps every row, as the table has them."""
    draw = np.random.default_rng(seed)
    wanted = request.wanted(frozenset())
    problem = Problem(
        request.sheets[0], request.loops, wanted, "noise", request.reference(), 2
    )
    best, least = None, -math.inf
    for count in range(CONTROLLERS):
        if best is None or count < CONTROLLERS // 2:
            x = np.array(
                [
                    draw.uniform(-3.0, 2.0),
                    draw.uniform(0.1, request.model.order),
                    draw.uniform(math.log(1e-4), math.log(0.2)),
                ]
            )
        else:
            x = best + draw.normal(size=3) * (0.05, 0.05, 0.2)
        with np.errstate(all="ignore"):
            value = float(np.min(problem.rows(x, 14.0).value))
        if value > least:
            best, least = x, value
        if least > 0.0:
            return True
    return False


def judged(seed: int) -> tuple[str, float]:
    """What came of a request, and its CPU time [s]."""
    model, rig, options = random_request(seed)
    begin = time.process_time()
    try:
        made = fl.design(model, rig, **options)
        word = "met" if made.passed else "FAILED although returned"
    except FieldError:
        return "contradicts the rig", 0.0
    except InfeasibleError as error:
        spent = time.process_time() - begin
        if error.nearest:
            try:
                followed = fl.design(model, rig, **(options | error.nearest))
                word = "offer" if followed.passed else "OFFER FAILS"
            except InfeasibleError:
                word = "OFFER FAILS"
        else:
            word = f"no offer: {error.condition}"
        request = request_of(model, rig, Specification(**options), None)
        if searched(request, seed):
            word = f"MISSED ({word})"
        return word, spent
    return word, time.process_time() - begin


def main() -> None:
    """Print the table and what came of the random requests."""
    count = sizes(__doc__, requests=(500, 1)).requests
    table()
    words: collections.Counter[str] = collections.Counter()
    times = collections.defaultdict(list)
    for seed in range(count):
        word, spent = judged(seed)
        words[word] += 1
        times[word.split(":")[0]].append(spent)
        if "MISSED" in word or "FAIL" in word:
            print(f"     seed {seed}: {word}", flush=True)
    for word, number in words.most_common():
        print(f"     {number:5} {word}")
    for word, spent in times.items():
        middle, most = 1e3 * float(np.median(spent)), 1e3 * max(spent)
        print(f"     {word:24} CPU median {middle:.0f} ms, most {most:.0f} ms")
    for what, wanted in (("MISSED", 0.01 * count), ("FAIL", 0.0)):
        found = sum(number for word, number in words.items() if what in word)
        line(
            f"requests {what}", f"{found} of {count}", f"<= {wanted:g}", found <= wanted
        )


if __name__ == "__main__":
    main()
