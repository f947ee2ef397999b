"""Moves on arms that are not the model: the worst of the fit's box and of both damping
laws.

Laws for 8 to 80 g on the rig "paper-2023-geared" (link of 7.35 g, friction, 0.05 N·m
gauge offset, 10 mN·m noise), one made for its fractional link, one for the viscous link
with the same ω₀ and damping ratio. 1 rad; settling counts from the start of the move.
A payload with which the loop of the law is unstable on an arm of the set is named and
left out: no reference and no estimate settles it. The arms are those of
`fraclink.worst_case`: ω₀ ± 1.5 %, λ ± 0.03 about the law's own link, and the other
damping law.
"""

from __future__ import annotations

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before numpy is loaded

import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

import fraclink as fl
from fraclink._simulate.arm_set import links_over
from harness import line, sizes

NAMED = fl.Rig.named("paper-2023-geared")
RIG = replace(NAMED, gauge=replace(NAMED.gauge, offset=0.05))
PAYLOADS = (0.008, 0.012, 0.016, 0.020, 0.030, 0.040, 0.060, 0.080)
NOT_TOLD = (0.020, 0.040)
QUINTIC = fl.smooth_step(1.0, duration=0.5)
# settles on every arm whose loop is stable
SLOW = fl.smooth_step(1.0, duration=3.0)


def designs() -> dict[str, fl.Design]:
    """The laws made for either damping law.

    The second mode of a link with λ + 0.03 has two thirds of the model's damping: a
    loop gain of 0.3 at the model's mode is at most 0.5 on that link.
    """
    assert RIG.model is not None
    viscous = list(links_over(RIG.model, RIG).values())[-1]
    span = (PAYLOADS[0], PAYLOADS[-1])
    request = {
        "gain_crossover": 7.0,
        "phase_margin": fl.deg(35),
        "mode_gain": 0.3,
        "filter_time": 0.01,
        "filter_order": 2,
    }
    return {
        "law for λ 1.92": fl.design(RIG.model, RIG, payloads=span, **request),
        # nothing asked: the fastest law that passes every row on the links of the box
        "law for a viscous link": fl.design(viscous, RIG, payloads=span),
    }


def held(
    words: str, design: fl.Design, payloads: tuple[float, ...]
) -> tuple[float, ...]:
    """The payloads with which the loop is stable on every arm of the set."""
    known = {
        payload: fl.worst_case(
            design, SLOW, payloads=(payload, payload), told=True
        ).settling_time
        for payload in payloads
    }
    stable = tuple(payload for payload, time in known.items() if np.isfinite(time))
    others = [f"{1e3 * each:g} g" for each in payloads if each not in stable]
    line(
        f"{words}: payloads with which an arm of the set is not stable",
        ", ".join(others) or "none",
        "none",
        not others,
    )
    return stable


def told(
    words: str, design: fl.Design, payloads: tuple[float, ...], seeds: int
) -> None:
    """The payload told: the quintic of 0.5 s, and a reference shaped for each payload."""
    worst, own = 0.0, 0.0
    for payload in payloads:
        options = {"payloads": (payload, payload), "told": True, "seeds": seeds}
        quintic = fl.worst_case(design, QUINTIC, **options)
        began = time.process_time()
        move = fl.shape(design, 1.0, **options)
        spent = time.process_time() - began
        alone = fl.shape(design, 1.0, over="model", **options)
        worst, own = (
            max(worst, move.settling_time),
            max(own, alone.settling_time),
        )
        print(
            f"  {1e3 * payload:2g} g: 0.5 s quintic {quintic.nominal.settling_time:.2f} s "
            f"on the model, {quintic.settling_time:.2f} s at worst ({quintic.worst.arm}); "
            f"shaped {move.promised:.2f} s promised, {move.settling_time:.2f} s at worst, "
            f"found in {spent:.1f} s",
            flush=True,
        )
    line(
        f"{words}: told, worst settling of all arms",
        f"{worst:.2f} s",
        "<= 0.70 s",
        worst <= 0.70,
        f"{1e3 * payloads[0]:g} to {1e3 * payloads[-1]:g} g",
    )
    line(
        f"{words}: told, shaped for the model, which is the arm",
        f"{own:.2f} s",
        "<= 0.50 s",
        own <= 0.50,
    )


def inexact(design: fl.Design, payloads: tuple[float, ...], seeds: int) -> None:
    """The quintic on the arm of the model: payload not given, given, 5 % off."""
    for payload in payloads:
        words = []
        for factor in (0.0, 1.0, 0.95, 1.05):
            arm = fl.Twin.from_rig(RIG, payload=payload)
            runs = [
                fl.simulate(design, QUINTIC, arm=arm, seed=seed, told=factor * payload)
                for seed in range(seeds)
            ]
            words.append(f"{max(run.metrics.settling_time for run in runs):.2f} s")
        print(
            f"  {1e3 * payload:2g} g: not given, given, 5 % too little, 5 % too much: "
            f"{', '.join(words)}",
            flush=True,
        )


def untold(words: str, design: fl.Design, seeds: int) -> None:
    """One reference for 20 to 40 g, and the law not told the payload."""
    quintic = fl.worst_case(design, QUINTIC, payloads=NOT_TOLD, seeds=seeds)
    move = fl.shape(design, 1.0, payloads=NOT_TOLD, seeds=seeds)
    nominal = move.worst_case.nominal.settling_time
    print(
        f"  20 to 40 g: 0.5 s quintic {quintic.nominal.settling_time:.2f} s on the model, "
        f"{quintic.settling_time:.2f} s at worst"
    )
    line(
        f"{words}: not told, worst settling of all arms over the model's",
        f"{move.settling_time:.2f} / {nominal:.2f} s",
        "<= 1.2",
        move.settling_time <= 1.2 * nominal,
    )


def estimated(
    words: str, design: fl.Design, payloads: tuple[float, ...], seeds: int
) -> None:
    """The second move, there and back, of a law that estimates the payload, with one
    reference for all payloads and arms, and a reserve for the difference between two
    estimates.
    """
    span = (payloads[0], payloads[-1])
    there, back = (
        fl.shape(design, size, payloads=span, told="estimated", reserve=0.35).reference
        for size in (1.0, -1.0)
    )
    # the second begins 3 s after the first
    begin = there.duration + 3.0
    path = there.then(fl.extend.hold(0.0, 3.0)).then(back)
    worst, arm = 0.0, ""
    for name, link in links_over(design.model, RIG).items():
        # The rig's length and stiffness determine the twin's ω₀: another ω₀ is another
        # mass.
        other = (design.model.natural_frequency / link.natural_frequency) ** 2
        for payload in payloads:
            twin = fl.Twin.from_rig(RIG, model=link, payload=payload * other)
            for seed in range(seeds):
                run = fl.simulate(design, path, arm=twin, told="estimated", seed=seed)
                outside = np.flatnonzero(np.abs(run.tip_angle) > 0.02)
                settled = float(run.time[outside[-1]] + run.period - begin)
                if settled > worst:
                    worst, arm = settled, f"{name}, {1e3 * payload:g} g"
    line(
        f"{words}: payload estimated, second move, worst of all arms",
        f"{worst:.2f} s",
        "<= 0.80 s",
        worst <= 0.80,
        arm,
    )


def wrong_order(seeds: int, right: int) -> None:
    """Moves until `watch` names a λ that is off by 0.03, and its alarms in moves of the
    arm that was tuned.
    """
    twin = fl.Twin.from_rig(NAMED)
    with tempfile.TemporaryDirectory() as folder:
        arm = fl.lab.SimulatedArm(twin, NAMED.period, seed=1)
        limits = fl.MotionLimits(angle=0.7, speed=4.0, torque=1.5, voltage=8.0)
        plan = fl.TuningPlan(limits, 0.030, period=NAMED.period)
        tuned = fl.tune(arm.callback, plan, out=Path(folder), moves=False, clock="none")
        law = fl.load(Path(folder) / "design.json").law()

    def record(arm: fl.Twin, moves: int, seed: int) -> fl.Experiment:
        path = fl.extend.hold(0.0, 0.5)
        for k in range(moves):
            path = path.then(fl.smooth_step(0.5 * (-1.0) ** k, 0.5, 0.5))
        run = fl.simulate(law, path, arm=arm, told=0.030, seed=seed)
        return fl.Experiment(
            period=law.period,
            motor_angle=run.motor_angle_measured,
            output=run.torque_measured,
            voltage=run.voltage,
        )

    def named(arm: fl.Twin, moves: int, seed: int) -> tuple[str, ...]:
        try:
            return fl.lab.watch(record(arm, moves, seed), tuned).due
        except fl.errors.FieldError:  # too little motion for a decision
            return ()

    assert NAMED.model is not None
    needed = []
    for change in (-0.03, 0.03):
        link = replace(NAMED.model, order=NAMED.model.order + change)
        other = fl.Twin.from_rig(NAMED, model=link)
        for seed in range(seeds):
            until = (n for n in range(2, 31) if "order" in named(other, n, seed))
            needed.append(next(until, 31))
    line(
        "λ off by 0.03: moves until it is named",
        f"{max(needed)} at most, {int(np.median(needed))} in the median",
        "<= 5",
        max(needed) <= 5,
    )
    alarms = sum(bool(named(twin, 10, 100 + k)) for k in range(right // 10))
    line(f"alarms in {right} moves of the right arm", str(alarms), "0", alarms == 0)


def main() -> None:
    """Print all figures."""
    sized = sizes(__doc__, seeds=(5, 1), payloads=(len(PAYLOADS), 1), laws=(2, 1))
    for words, design in list(designs().items())[: sized.laws]:
        print(words)
        inexact(design, PAYLOADS[: sized.payloads], sized.seeds)
        stable = held(words, design, PAYLOADS[: sized.payloads + 1])
        told(words, design, stable, sized.seeds)
        if not sized.short:
            untold(words, design, sized.seeds)
        estimated(words, design, stable, sized.seeds)
    if not sized.short:
        wrong_order(sized.seeds, 500)


if __name__ == "__main__":
    main()
