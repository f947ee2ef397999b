"""`tune` on random arms and wrong wirings, and what `watch` notices.

Arms are twins around four rig shapes: payload ±30 %, gear ±20 %, Coulomb friction a
half to twice, gauge gain ±30 %, gauge delay 0 to 20 ms, voltage delay of 1 or 2
periods, link mass 0 to 65 g, gauge noise a half to one and a half times, and separate
damping ratios of the first mode and of the higher ones, 0.1 to 10 %, log-uniform. Seed
of arm k: k. Everything runs in this process, each exchange of voltage and reading is
one period of the arm, so that no clock is waited for.
"""

from __future__ import annotations

import json
import math
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import fraclink as fl
from fraclink import Callback, SecondMode
from fraclink._arm.box import Arm
from fraclink.errors import FraclinkError
from fraclink.lab._connections import Command
from fraclink.lab._line import open_line
from fraclink.lab._tune_guard import Guard
from fraclink.lab._tune_wiring import WiringFault, check_wiring
from harness import line, sizes

PAPER = fl.Rig.named("paper-2023-geared")


@dataclass(frozen=True)
class Shape:
    """A rig around which arms are drawn, and the limits that its user would state."""

    name: str
    rig: fl.Rig
    limits: fl.MotionLimits


def _rig(
    length: float, stiffness: float, payload: float, gear: float, period: float
) -> fl.Rig:
    return replace(
        PAPER,
        link=fl.extend.Link(
            length=length, flexural_rigidity=stiffness * length / 3, stiffness=stiffness
        ),
        payloads=fl.extend.Payloads(
            low=0.75 * payload, high=1.35 * payload, nominal=payload
        ),
        motor=replace(PAPER.motor, gear_ratio=gear),
        gauge=replace(
            PAPER.gauge,
            noise=0.0064 * stiffness,
            quantum=0.00125 * stiffness,
            limit=2.5 * stiffness,
        ),
        period=period,
        model=None,
        design=None,
    )


SHAPES = (
    Shape(
        "paper",
        _rig(0.65, 1.56, 0.030, 50.0, 0.004),
        fl.MotionLimits(0.6, 4.0, 1.5, 10.0),
    ),
    Shape(
        "short",
        _rig(0.45, 3.0, 0.060, 60.0, 0.002),
        fl.MotionLimits(0.6, 5.0, 3.0, 10.0),
    ),
    Shape(
        "long",
        _rig(0.90, 2.2, 0.045, 80.0, 0.004),
        fl.MotionLimits(0.8, 3.0, 2.0, 10.0),
    ),
    Shape(
        "heavy",
        _rig(0.60, 4.0, 0.120, 80.0, 0.004),
        fl.MotionLimits(0.5, 3.0, 4.0, 10.0),
    ),
)


@dataclass(frozen=True)
class Drawn:
    """One arm: its shape, the twin, and the truth in the terms of a model."""

    shape: Shape
    twin: fl.Twin
    payload: float
    ratios: tuple[float, float]
    gauge_gain: float
    gauge_delay: float
    seed: int


def draw(seed: int) -> Drawn:
    """The arm of a seed."""
    random = np.random.default_rng(seed)
    shape = SHAPES[seed % len(SHAPES)]
    rig = shape.rig
    payload = rig.payloads.nominal * random.uniform(0.7, 1.3)
    motor = replace(
        rig.motor,
        gear_ratio=rig.motor.gear_ratio * random.uniform(0.8, 1.2),
        coulomb_torque=rig.motor.coulomb_torque * 2.0 ** random.uniform(-1.0, 1.0),
    )
    gain, delay = random.uniform(0.7, 1.3), random.uniform(0.0, 0.020)
    first, second = np.exp(random.uniform(math.log(1e-3), math.log(0.1), 2)).tolist()
    link = replace(rig.link, mass=random.uniform(0.0, 0.065))
    noise = rig.gauge.noise * random.uniform(0.5, 1.5)
    arm = replace(rig, motor=motor, link=link, gauge=replace(rig.gauge, noise=noise))
    # η of a mode with damping ratio ζ is 2ζ/ω.
    modes = fl.extend.Beam.from_rig(arm, payload=payload).modes(2).frequencies
    times = 2.0 * np.array([first, second]) / modes
    twin = fl.Twin.from_rig(
        arm,
        payload=payload,
        damping=fl.extend.KelvinVoigt(*times.tolist()),
    )
    late = int(random.integers(1, 3))
    twin = replace(twin, gauge_delay=delay, gauge_gain=gain, voltage_delay=late)
    return Drawn(shape, twin, payload, (first, second), gain, delay, seed)


def plan_of(drawn: Drawn) -> fl.TuningPlan:
    """What a user of that rig asks for."""
    payload = drawn.payload
    return fl.TuningPlan(
        drawn.shape.limits,
        payload,
        (0.8 * payload, 1.25 * payload),
        drawn.shape.rig.period,
        drawn.shape.rig,
    )


def broken(record: np.ndarray, limits: fl.MotionLimits) -> list[str]:
    """The limits that the true motion exceeded in any period; the torque is that at the
    link's root.
    """
    parts = {
        "angle": record[:, 1],
        "speed": record[:, 2],
        "torque": record[:, 3],
        "voltage": record[:, 4],
    }
    return [
        name
        for name, values in parts.items()
        if np.max(np.abs(values)) > getattr(limits, name)
    ]


def truth(
    drawn: Drawn, design: fl.Design, made: fl.lab.FirstMove | None
) -> tuple[float, float, list[str]]:
    """(promised, true) phase margin [°] at the tuned payload, and why moves of the true
    arm fail.
    """
    model, modes = design.model, drawn.twin.beam.modes(2)
    # Γ/θm of each mode far above its frequency [N·m/rad]
    sizes = (modes.participation * modes.frequencies) ** 2
    second = float(modes.frequencies[-1])
    damped, other = drawn.ratios
    real = fl.LinkModel(
        stiffness=model.stiffness,
        natural_frequency=float(modes.frequencies[0]),
        damping=2.0 * damped * float(modes.frequencies[0]),
        payload=drawn.payload,
        gauge_delay=drawn.gauge_delay,
        gauge_gain=drawn.gauge_gain * float(sizes[0]) / model.stiffness,
        second_mode=SecondMode(second, float(sizes[1] / sizes[0]), other),
    )
    ratio = drawn.twin.motor.gain / design.rig.motor.gain
    margins = []
    for link, times in ((model, 1.0), (real, ratio)):
        loop = Arm(link, times).loop(design.controller, design.rig)
        found = loop.margins(np.array([link.natural_frequency]))
        margins.append(math.degrees(float(found[1][0])))
    law, reasons = design.law(), []
    move = (
        fl.smooth_step(0.3, 0.6)
        if made is None
        else fl.smooth_step(made.amplitude, made.duration)
    )
    for payload in (0.8 * drawn.payload, drawn.payload, 1.25 * drawn.payload):
        run = fl.simulate(law, move, arm=drawn.twin, payload=payload, told=True)
        if not run.verdict.passed:
            reasons.append(f"{1e3 * payload:.0f} g: {run.verdict.reason}")
    return margins[0], margins[1], reasons


def one_arm(seed: int, out: Path) -> dict[str, Any]:
    """Tune one arm, and compare with the truth."""
    drawn = draw(seed)
    arm = fl.lab.SimulatedArm(drawn.twin, drawn.shape.rig.period, seed=seed)
    began = time.process_time()
    found = fl.tune(
        arm.callback, plan_of(drawn), out=out / f"{seed}", force=True, clock="none"
    )
    result: dict[str, Any] = {
        "seed": seed,
        "shape": drawn.shape.name,
        "computing": time.process_time() - began,
        "arm_time": len(arm.record) * drawn.shape.rig.period,
        "law": found.has_law,
        "verdict": found.verdict.state,
        "stopped": found.stopped,
        "reasons": list(found.reasons),
        "broken": broken(arm.record, drawn.shape.limits),
        "delay_ms": 1e3 * drawn.gauge_delay,
        "link_g": 1e3 * drawn.twin.beam.link_mass,
        "ratios": drawn.ratios,
        "payload_g": 1e3 * drawn.payload,
        "rounds": []
        if found.link is None
        else [[round(x, 4) for x in r] for r in found.link.rounds],
        "mode": found.link is not None and found.link.fit.model.second_mode is not None,
        "motor": None if found.motor is None else [found.motor.loop.pole],
        "moves": [(m.promised_settling, m.measured_settling) for m in found.moves],
    }
    if found.has_law:
        design = fl.load(out / f"{seed}" / "design.json")
        promised, true, failed = truth(
            drawn, design, found.moves[-1] if found.moves else None
        )
        result |= {"margin_promised": promised, "margin_true": true, "failed": failed}
    return result


def arms(first: int, count: int) -> None:
    """Arms from wiring to first move."""
    results = []
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(first, first + count):
            try:
                found = one_arm(seed, Path(folder))
            except Exception as error:  # a crash is a result too  # noqa: BLE001
                found = {"seed": seed, "crash": f"{type(error).__name__}: {error}"}
            print(json.dumps(found), flush=True)
            results.append(found)
    report(results)


def report(results: list[dict[str, Any]]) -> None:
    """The lines of the table."""
    whole = [found for found in results if "crash" not in found]
    good = [
        found
        for found in whole
        if found["law"] and not found["failed"] and not found["stopped"]
    ]
    bad = [found for found in whole if found["law"] and found["failed"]]
    refused = Counter(
        (found["stopped"] or "; ".join(found["reasons"]))[:60]
        for found in whole
        if not found["law"]
    )
    line(
        "arms with a law whose proof passed and whose moves pass on the truth",
        f"{len(good)} of {len(results)}; unsafe {len(bad)}; crashes {len(results) - len(whole)}; "
        f"refused {dict(refused)}",
        ">= 90 of 100, 0 unsafe",
        len(good) >= 0.9 * len(results) and not bad,
    )
    left = [found["seed"] for found in whole if found["broken"]]
    line(
        "arms on which a limit was left in any period",
        f"{len(left)} {left}",
        "0",
        not left,
    )
    times, computing = (
        np.array([found[name] for found in whole]) for name in ("arm_time", "computing")
    )
    line(
        "arm time; computing [s]",
        f"median {np.median(times):.0f}, {sum(times > 60)} over 60, most {times.max():.0f}; "
        f"{np.median(computing):.1f}, {sum(computing > 10)} over 10, most {computing.max():.1f}",
        "<= 45 / 60; <= 5 / 10",
        bool(
            np.median(times) <= 45
            and times.max() <= 60
            and np.median(computing) <= 5
            and computing.max() <= 10
        ),
    )
    moved = [found["moves"][-1] for found in whole if found["moves"]]
    near = sum(abs(m - p) <= max(0.1 * p, 0.05) for p, m in moved)
    line(
        "promised against measured settling within 10 % or 50 ms",
        f"{near} of {len(moved)}",
        "98 %",
        near >= 0.98 * len(moved),
    )
    margins = [
        found["margin_true"] - found["margin_promised"]
        for found in whole
        if found["law"]
    ]
    within = sum(abs(gap) <= 3.0 for gap in margins)
    line(
        "promised against true phase margin within 3°",
        f"{within} of {len(margins)}",
        "95 %",
        within >= 0.95 * len(margins),
    )


# ---- wrong wirings ----------------------------------------------------------------------------------------


def wired(
    arm: fl.lab.SimulatedArm, *, angle: float = 1, torque: float = 1, voltage: float = 1
) -> Callback:
    """The arm with factors on its wires."""

    def read() -> tuple[float, float]:
        found = arm.read()
        return angle * found[0], torque * found[1]

    def write(command: Command) -> None:
        arm.write(command._replace(voltage=voltage * command.voltage))

    return Callback(read, write)


WRONG: dict[str, Callable[[fl.lab.SimulatedArm], Callback]] = {
    "encoder reversed": lambda arm: wired(arm, angle=-1),
    "motor reversed": lambda arm: wired(arm, voltage=-1),
    "gauge reversed": lambda arm: wired(arm, torque=-1),
    "encoder dead": lambda arm: wired(arm, angle=0),
    "gauge dead": lambda arm: wired(arm, torque=0),
    "channels swapped": lambda arm: Callback(lambda: arm.read()[::-1], arm.write),
    "gauge scale wrong": lambda arm: wired(arm, torque=10),
    "encoder scale wrong": lambda arm: wired(arm, angle=4),
}


def wiring(count: int) -> None:
    """Wrong wirings: named, and the motion until then."""
    named, moved, left, other = Counter[str](), [], 0, []
    for fault, wire in WRONG.items():
        for seed in range(count):
            drawn = draw(seed)
            arm = fl.lab.SimulatedArm(drawn.twin, drawn.shape.rig.period, seed=seed)
            guard = Guard(
                partial(open_line, wire(arm), drawn.shape.rig.period, clock="none"),
                drawn.shape.limits,
            )
            try:
                check_wiring(guard, drawn.shape.rig)
                other.append(f"{fault} {seed}: passed")
            except WiringFault as error:
                named[fault] += str(error).startswith(fault)
                if not str(error).startswith(fault):
                    other.append(f"{fault} {seed}: {str(error)[:50]}")
            except FraclinkError as error:
                other.append(f"{fault} {seed}: {str(error)[:50]}")
            guard.release()
            moved.append(math.degrees(float(np.ptp(arm.record[:, 1]))))
            left += bool(broken(arm.record, drawn.shape.limits))
    for text in other:
        print("  ", text)
    line(
        f"wrong wirings named, {len(WRONG)} kinds of {count}",
        ", ".join(f"{fault} {named[fault]}" for fault in WRONG),
        "all",
        not other,
    )
    line(
        "motion until it is named [°]",
        f"most {max(moved):.1f}",
        "<= 5",
        max(moved) <= 5.0,
    )
    line("wrong wirings that left a limit", str(left), "0", left == 0)


PAPER_TWIN = fl.Twin.from_rig(PAPER)


def running(law: fl.Law, twin: fl.Twin, seed: int) -> fl.Experiment:
    """Twenty seconds of random moves under a law."""
    random = np.random.default_rng(seed)
    path, at = fl.extend.hold(0.0, 0.5), 0.0
    while path.duration < 20.0:
        to, pause = float(random.uniform(-0.35, 0.35)), float(random.uniform(0.0, 0.6))
        path, at = (
            path.then(
                fl.smooth_step(to - at, float(random.uniform(0.35, 0.9)), start=pause)
            ),
            to,
        )
    run = fl.simulate(law, path, arm=twin, told=0.030, duration=20.0, seed=seed)
    return fl.Experiment(
        period=law.period,
        motor_angle=run.motor_angle_measured,
        output=run.torque_measured,
        voltage=run.voltage,
    )


def watching(count: int, windows: int) -> None:
    """Changes of the arm after its tuning, each seen in 20 s of moves, and alarms
    without a change.
    """
    motor = PAPER_TWIN.motor
    changed = {
        "natural_frequency": (
            PAPER_TWIN.with_payload(0.030 / 1.1**2),
            PAPER_TWIN.with_payload(0.030 / 0.9**2),
        ),
        "gauge_delay": (replace(PAPER_TWIN, gauge_delay=0.005),),
        "gauge_gain": tuple(replace(PAPER_TWIN, gauge_gain=g) for g in (0.9, 1.1)),
        "friction": (
            replace(
                PAPER_TWIN,
                motor=replace(motor, coulomb_torque=2 * motor.coulomb_torque),
            ),
        ),
    }
    with tempfile.TemporaryDirectory() as folder:
        arm = fl.lab.SimulatedArm(PAPER_TWIN, PAPER.period, seed=1)
        plan = fl.TuningPlan(SHAPES[0].limits, 0.030, period=PAPER.period)
        tuned = fl.tune(arm.callback, plan, out=Path(folder), moves=False, clock="none")
        law = fl.load(Path(folder) / "design.json").law()
    right = {
        name: sum(
            fl.lab.watch(running(law, twins[k % len(twins)], k), tuned).due == (name,)
            for k in range(count)
        )
        for name, twins in changed.items()
    }
    total = sum(right.values())
    line(
        "watch: changes named rightly, and nothing else, within 20 s",
        f"{total} of {4 * count} {right}",
        ">= 95 %",
        total >= 0.95 * 4 * count,
    )
    hours = windows * 20 / 3600
    alarms = sum(
        bool(fl.lab.watch(running(law, PAPER_TWIN, 1000 + k), tuned).due)
        for k in range(windows)
    )
    line(
        "watch: false alarms",
        f"{alarms} in {hours:.3g} h",
        "<= 1 in 10 h",
        alarms <= hours / 10,
    )


def main() -> None:
    """Print every figure; other first seeds are other arms."""
    given = sizes(
        __doc__,
        arms=(100, 0),
        first=(0, 0),
        wirings=(20, 1),
        records=(40, 0),
        windows=(180, 0),
    )
    if given.arms:  # a tuning takes most of a minute, and the tests also tune
        arms(given.first, given.arms)
    if given.wirings:
        wiring(given.wirings)
    if given.records:  # a separate tuning: 15 s
        watching(given.records, given.windows)


if __name__ == "__main__":
    main()
