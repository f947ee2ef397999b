"""Arms from outside fraclink, tuned and then moved by the law that ships and by its
rivals: the promise, the worst printed figure, and the true motion of the tip.

The arms are those of ../shared/arms (finite elements, friction, gear, sensors of their
own); without that folder nothing is measured. Each rival is tuned by its rule of
`fraclink compare` from the design that `tune` made. 2 % settling from the start of the
tuned move, on the true tip.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import fraclink as fl
from fraclink.trials import Rival, builders
from harness import line, sizes
from identify_logs import recorded

NAMES = (
    "01-benign",
    "01d-metal",
    "03-long-slow",
    "05-gauge-30ms",
    "14-hardening",
    "21-plastic-link",
)
REST = 4.0  # [s] after the reference


@dataclass(frozen=True)
class Truth:
    """What the tip of an arm did: settling time [s], half the peak-to-peak of the last
    second over the move [1], standard deviation of the voltage there [V].
    """

    settling: float
    ringing: float
    noise: float


def moved(
    arm: Any, law: fl.Law, reference: Any, size: float, payload: float = 0.0
) -> Truth:
    """Move an arm period by period under a law that is given a payload, 0 for none."""
    before, state = round(0.5 / law.period), law.initial_state()
    count = before + round((reference.duration + REST) / law.period)
    time = law.period * (np.arange(count) - before)
    path, push = reference.angle(time), reference.acceleration(time)
    zero, volts = arm.sense()[0], []
    for k in range(count):
        angle, torque = arm.sense()
        state, out = law.run(
            state, [zero + path[k]], [push[k]], [angle], [torque], payload,
            first_tick=k + 1,
        )  # fmt: skip
        driven = int(out.mode[0]) in (1, 2, 3)
        volts.append(float(out.voltage[0]) if driven else 0.0)
        arm.step(volts[-1])
    tip = np.array(arm.rows)[:count, 0]
    tip = (tip - tip[:before].mean())[before:] / size
    outside = np.flatnonzero(np.abs(tip - 1.0) > 0.02)
    settled = outside.size < tip.size and outside[-1] + 1 < tip.size
    last = round(1.0 / law.period)
    return Truth(
        law.period * float(outside[-1] + 1) if settled else np.inf,
        0.5 * float(np.ptp(tip[-last:])),
        float(np.std(volts[-last:])),
    )


def tried(arms: Any, name: str, rivals: bool) -> bool | None:
    """Tune an arm and move it; whether no move is later than the printed worst, None
    where `tune` made no law.
    """
    parameters, (angle, speed, torque, voltage), _ = arms.ARMS[name]
    arm = arms.Arm(**parameters)
    payload, period = arm.p["payload"], arm.p["T"]
    limits = fl.MotionLimits(angle=angle, speed=speed, torque=torque, voltage=voltage)
    plan = fl.TuningPlan(limits, payload=payload, period=period)
    with tempfile.TemporaryDirectory() as folder:
        link = fl.Callback(arm.read, arm.write)
        tuned = fl.tune(link, plan, out=Path(folder), clock="none")
        if not (tuned.has_law and tuned.passed):
            print(f"  {name}: no law")
            return None
        design = fl.load(Path(folder) / "design.json")
    first, (low, high) = tuned.moves[-1], tuned.payloads
    size = abs(first.amplitude)
    move = fl.smooth_step(size, first.duration)

    def true(mass: float) -> Any:
        return arms.Arm(**{**parameters, "payload": mass, "seed": 7, "lost": 0.0})

    within = True
    for mass in (low, payload, high):
        case = fl.worst_case(design, move, payloads=(mass, mass), told=True)
        truth = moved(true(mass), design.law(), move, size, mass)
        within &= truth.settling <= case.settling_time
        print(
            f"  {name}, {1e3 * mass:.0f} g told: promised {case.nominal.settling_time:.2f} s, "
            f"worst {case.settling_time:.2f} s, true {truth.settling:.2f} s",
            flush=True,
        )
    if rivals:
        made: dict[str, Rival] = {}
        for key, build in builders(design).items():
            try:
                made[key] = build()
            except fl.errors.FraclinkError as error:
                print(f"  {name}, {key}: left out, {error}")
        for key, rival in made.items():
            law = design.law() if key == "fraclink" else rival.law
            for told in (False, True):
                truths = [
                    moved(true(mass), law, rival.shaped(move), size, told * mass)
                    for mass in (low, payload, high)
                ]
                times = ", ".join(f"{truth.settling:.2f}" for truth in truths)
                print(
                    f"  {name}, {key}, {'told' if told else 'not told'}: {times} s, "
                    f"rings {100 * max(truth.ringing for truth in truths):.1f} %, "
                    f"{1e3 * max(truth.noise for truth in truths):.0f} mV",
                    flush=True,
                )
    return within


def main() -> None:
    """Print every arm."""
    given = sizes(__doc__, arms=(len(NAMES), 1), rivals=(1, 0))
    place = recorded("..", "arms")
    if place is None:
        line("arms that fraclink did not write", "no ../shared/arms", "there", None)
        return
    sys.path.insert(0, str(place))
    import arms  # its folder is next to the checkout
    from arm import Arm

    arms.Arm = Arm
    results = [tried(arms, name, bool(given.rivals)) for name in NAMES[: given.arms]]
    made = [result for result in results if result is not None]
    line(
        "arms that fraclink did not write: no told move later than the printed worst",
        f"{sum(made)} of {len(made)} arms",
        "all",
        all(made),
    )


if __name__ == "__main__":
    main()
