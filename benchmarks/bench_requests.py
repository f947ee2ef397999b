"""Random requests to `design`: nothing is promised in silence, and what a refusal
offers is feasible.

Every request draws a rig, a link as a log may show it (a late gauge, a wrong gauge
gain, a second mode, damping), a payload range and options of `design`. Each ends as one
of:

- a design whose shipped law, measured here on the sampled loop with every alias summed
  one by one, keeps what was asked at every payload looked at, or a design that says
  what is missing;
- a refusal whose ``nearest`` is feasible when it is asked for in place of what was
  refused;
- a refusal that offers nothing, or a value that contradicts the rig (counted, not
  judged).

Anything else is an exception to the rule and is printed with its seed.
"""

from __future__ import annotations

import collections
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import fraclink as fl
from fraclink._arm.link import LinkModel, SecondMode
from fraclink._arm.rig import Rig
from fraclink.errors import FieldError, InfeasibleError
from harness import line, sizes

RIGS = ("paper-2023", "paper-2023-geared")
ROUNDING = 1e-6  # relative, of a requirement that is met with equality
ALLOWANCE = math.radians(0.5)  # what the fit of the law may cost without a word
ALIASES = 300


@dataclass(frozen=True)
class Request:
    """One random request: what `design` is called with."""

    seed: int
    rig: Rig
    model: LinkModel
    options: Mapping[str, Any]


def random_request(seed: int) -> Request:
    """The request of a seed: the same everywhere."""
    draw = np.random.default_rng(seed)
    rig = Rig.named(str(draw.choice(RIGS)))
    assert rig.model is not None
    if draw.random() < 0.5:
        loop = replace(
            rig.motor_loop,
            pole=float(draw.choice([40.0, 60.0, 80.0, 150.0])),
            delay_samples=int(draw.integers(0, 3)),
        )
        rig = replace(
            rig, period=float(draw.choice([1e-3, 2e-3, 4e-3, 5e-3])), motor_loop=loop
        )
    model = _random_link(rig.model, draw)
    light = 10.0 ** draw.uniform(-2.2, -1.5)
    payloads = light, light * 10.0 ** draw.uniform(0.02, 0.6)
    heavy = model.at_payload(payloads[1])
    options: dict[str, Any] = {"payloads": payloads}
    crossover = heavy.natural_frequency ** (2.0 / model.order) * draw.uniform(0.9, 2.2)
    options |= _one(
        draw, gain_crossover=crossover, settling_time=2.0 * math.pi / crossover
    )
    options |= _one(
        draw,
        phase_margin=math.radians(draw.uniform(20, 80)),
        max_sensitivity=draw.uniform(1.2, 2.5),
    )
    if draw.random() < 0.3:
        options |= _one(
            draw,
            filter_time=float(draw.choice([0.0, 0.002, 0.01, 0.05])),
            filter_order=1 + int(draw.random() < 0.5),
        )
    if draw.random() < 0.25:
        options["noise_gain"] = 10.0 ** draw.uniform(-0.5, 1.0)
    if model.second_mode is not None and draw.random() < 0.4:
        options["mode_gain"] = float(draw.uniform(0.1, 1.0))
    if draw.random() < 0.2:
        options |= {
            "inner": "sampled",
            "placement": str(draw.choice(["tustin", "direct"])),
        }
    if draw.random() < 0.1:
        options["margins"] = "ideal"
    return Request(seed, rig, model, options)


def _one(draw: np.random.Generator, **either: Any) -> dict[str, Any]:
    """One of the two options, the first three times as often; rarely both."""
    names = list(either)
    kept = names if draw.random() < 0.05 else [names[int(draw.random() < 0.25)]]
    return {name: either[name] for name in kept}


def _random_link(known: LinkModel, draw: np.random.Generator) -> LinkModel:
    order = float(draw.choice([2.0, draw.uniform(1.2, 2.0), draw.uniform(1.8, 2.0)]))
    # The resonance stays where it is: ω₀ has a unit that depends on λ.
    frequency = known.natural_frequency ** (order / known.order)
    model = replace(known, order=order, natural_frequency=frequency, payload=0.03)
    if draw.random() < 0.2:
        model = replace(
            model,
            damping=float(draw.uniform(0.1, 3.0)),
            damping_order=float(draw.uniform(0.5, 1.0)),
        )
    if draw.random() < 0.35:
        model = replace(
            model, gauge_delay=float(draw.choice([0.002, 0.005, 0.01, 0.02, 0.04]))
        )
    if draw.random() < 0.3:
        model = replace(model, gauge_gain=float(draw.uniform(0.7, 1.3)))
    if draw.random() < 0.35:
        mode = SecondMode(
            float(draw.uniform(40.0, 150.0)),
            float(draw.uniform(0.005, 0.05)),
            float(draw.uniform(0.01, 0.2)),
        )
        model = replace(model, second_mode=mode)
    return model


# ---- the sampled loop, once more --------------------------------------------------------------------------


def sampled_loop(
    design: fl.Design, law: fl.Law, payload: float, w: np.ndarray
) -> np.ndarray:
    """The loop of the shipped law at ω [rad/s]: the alias sum as it is defined, no tail
    in closed form.
    """
    rig, model = design.rig, design.model
    period, spring = rig.period, design.natural_frequency(payload) ** 2
    motor = design.motor_loop
    s = 1j * (w[:, None] + 2.0 * math.pi / period * np.arange(-ALIASES, ALIASES + 1))
    inertia, drag = s**model.order, model.damping * s**model.damping_order
    torque = inertia / (inertia + drag + spring)
    if model.second_mode is not None:
        mode = model.second_mode
        torque = torque + mode.gain * s**2 / (
            s**2 + 2 * mode.damping_ratio * mode.frequency * s + mode.frequency**2
        )
    tip = 1.0 - model.gauge_gain * np.exp(-model.gauge_delay * s) * torque
    hold = (1.0 - np.exp(-1j * w * period)) / period
    if motor.kind == "sampled":
        drive = rig.motor.gain / (s * (s + rig.motor.decay))
        before = motor.sampled(rig.motor, period).voltage(w)
        plant = hold * before * np.sum(tip * drive / s, axis=1)
    else:
        drive = np.exp(-motor.delay_samples * period * s) / (1.0 + s / motor.pole) ** 2
        plant = hold * np.sum(tip * drive / s, axis=1)
    return np.asarray(law.frequency_response(w) * plant)


def kept(design: fl.Design, law: fl.Law, payload: float) -> float:
    """The smallest |angle of −L| over the crossings of |L| = 1 [rad]; π where there is
    none.
    """
    top = math.pi / design.rig.period
    scan = np.unique(
        np.concatenate(
            [np.geomspace(0.05, 0.999 * top, 1500), *_near(design, payload, top)]
        )
    )
    # A part at a time: all aliases of all frequencies are 100 MB.
    parts = np.array_split(scan, 10)
    value = np.concatenate([sampled_loop(design, law, payload, part) for part in parts])
    level = np.log(np.abs(value))
    worst = math.pi
    for i in np.flatnonzero((level[:-1] > 0) != (level[1:] > 0)):
        low, high = scan[i], scan[i + 1]
        for _ in range(4):  # nested scans: 16 points each leave 1e-5 of a step
            inner = np.linspace(low, high, 17)
            signs = np.log(np.abs(sampled_loop(design, law, payload, inner))) > 0
            at = int(np.flatnonzero(signs[:-1] != signs[1:])[0])
            low, high = inner[at], inner[at + 1]
        here = sampled_loop(design, law, payload, np.array([0.5 * (low + high)]))[0]
        worst = min(worst, abs(float(np.angle(-here))))
    return worst


def _near(design: fl.Design, payload: float, top: float) -> list[np.ndarray]:
    """Points about the modes, which are narrow."""
    model = design.model
    first = design.natural_frequency(payload) ** (2.0 / model.order)
    places = [(first, 0.3)]
    if model.second_mode is not None:
        places.append(
            (model.second_mode.frequency, 8.0 * model.second_mode.damping_ratio)
        )
    spread = np.sinh(np.linspace(-4.0, 4.0, 120)) / math.sinh(4.0)
    return [
        w[w < 0.999 * top]
        for w in (place * np.exp(width * spread) for place, width in places)
    ]


# ---- one request ------------------------------------------------------------------------------------------


def outcome(request: Request) -> tuple[str, str]:
    """(what became of it, why); "SILENT" and "NOT FEASIBLE" are exceptions to the rule."""
    try:
        design = fl.design(request.model, request.rig, **request.options)
    except FieldError as error:
        return "contradicts the rig", error.field
    except InfeasibleError as error:
        return _refused(request, error)
    return _designed(design)


def _designed(design: fl.Design) -> tuple[str, str]:
    told = {finding.code for finding in design.findings}
    if not design.passed:
        return "says what is missing", "a requirement or a finding fails"
    if design.margins_kind == "ideal":
        return "the paper's reading", "no promise about the loop that runs"
    law = design.law()
    ends = np.geomspace(*design.payloads, 3)
    least = min(kept(design, law, float(payload)) for payload in ends)
    lost = design.phase_margin - least
    if lost <= ALLOWANCE * (1.0 + 1e-3):
        return "kept", ""
    if "W404" in told:
        return "says what is missing", ""
    return (
        "SILENT",
        f"the shipped law keeps {math.degrees(lost):.2f}° less than was asked",
    )


def _refused(request: Request, error: InfeasibleError) -> tuple[str, str]:
    if not error.nearest:
        return "refused, nothing near", error.condition
    try:
        offered = fl.design(
            request.model,
            request.rig,
            **{**request.options, **error.nearest},
            law=False,
        )
    except (FieldError, InfeasibleError) as again:
        return "NOT FEASIBLE", f"{error.condition}: {error.nearest} ends in {again}"
    if not offered.passed:
        missed = next(str(item) for item in offered.requirements if not item.passed)
        return "NOT FEASIBLE", f"{error.condition}: {error.nearest} gives {missed}"
    return "refused, nearest is feasible", error.condition


def survey(seeds: range) -> tuple[collections.Counter[str], list[str]]:
    """(how often each outcome, a line for each exception to the rule)."""
    count: collections.Counter[str] = collections.Counter()
    broken = []
    for seed in seeds:
        what, why = outcome(random_request(seed))
        count[what] += 1
        if what.isupper():
            broken.append(f"seed {seed}: {what}: {why}")
    return count, broken


def main() -> None:
    many = sizes(__doc__, requests=(500, 2)).requests
    begin = time.process_time()
    count, broken = survey(range(many))
    for request in broken:
        print(f"     {request}")
    for what, times in count.most_common():
        print(f"     {what:<32} {times:>5}")
    print(f"     {time.process_time() - begin:.0f} s of CPU")
    line(
        "requests, exceptions to the rule",
        f"{len(broken)} of {many}",
        "0",
        not broken,
    )


if __name__ == "__main__":
    main()
