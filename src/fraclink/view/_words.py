"""The sentences of a report: the arm, the reliability of the design, the next steps."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from fraclink._arm.link import LinkModel
from fraclink._arm.rig import Rig
from fraclink._design import Design
from fraclink._display import number
from fraclink.trials._study import Study
from fraclink.view._text import grams, grams_between, options_text

__all__ = [
    "arm_sentences",
    "nearest_command",
    "power_on",
    "sketch_notes",
    "steps",
]


def arm_sentences(rig: Rig, model: LinkModel | None) -> list[str]:
    """The numbers of the arm in words."""
    swings = (
        [] if model is None else [f"With the motor held, the tip {model.sentence}."]
    )
    # [ms] (1 + 4) e⁻⁴: a double pole is within 9 % after four time constants, a
    # customary figure.
    duration = number(4.0e3 / rig.motor_loop.pole, 2)
    carried = grams_between(rig.payloads.low, rig.payloads.high)
    return [
        f"It carries {carried} on a link of {number(rig.link.length)} m.",
        *swings,
        f"The motor follows within {duration} ms; the law runs every {number(1e3 * rig.period)} ms.",
    ]


def sketch_notes(rig: Rig, model: LinkModel | None) -> tuple[str, str, str]:
    """The labels of motor, gauge and payload in the drawing of the arm."""
    late = model.gauge_delay if model is not None else 0.0
    return (
        f"follows within {number(4.0e3 / rig.motor_loop.pole, 2)} ms",
        f"{number(1e3 * late, 2)} ms late" if late > 1e-6 else "",
        grams_between(rig.payloads.low, rig.payloads.high),
    )


def nearest_command(request: Mapping[str, Any]) -> str:
    """The command line for a request, with the log and the rig as they were read, which
    lie next to the report.
    """
    return f"fraclink run --rig rig.toml --log log.npz {options_text(request)}"


def steps(study: Study) -> list[tuple[str, str]]:
    """The next steps, each with its command in the folder of the report."""
    if study.design is None:
        return (
            [
                (
                    "Request the nearest feasible design",
                    nearest_command({**study.refused.asked, **study.refused.nearest}),
                )
            ]
            if study.refused
            else []
        )
    todo = []
    # A failing arm first, then the proof and the faults; the board last, since there an
    # error can do damage.
    if study.arms is not None and study.arms.summary.failed:
        todo.append(
            (
                "Look at a failing arm, with all its signals",
                f"fraclink replay arms.npz --run {study.arms.summary.failed[0]}",
            )
        )
    if not study.certificate:
        todo.append(("Prove the promise", "fraclink certify design.json"))
    if not study.faults:
        todo.append(
            (
                "Break sensors, clock and memory on the twin",
                "fraclink campaign faults --design design.json --out .",
            )
        )
    return [
        *todo,
        (
            "Write the law as C99 with a self-test",
            "fraclink export c design.json --out firmware",
        ),
        ("Share the moving arm as one file", "fraclink report . --arm"),
    ]


def power_on(design: Design) -> list[str]:
    """The steps of the first power-on, in the order in which a mistake does least
    damage.
    """
    volts = design.rig.motor.voltage_limit
    # A fifth of the voltage: with a wrong sign of encoder or gauge, the arm then moves
    # gently enough to be caught by hand.
    limit = (
        f" ({number(0.2 * volts, 2)} V of {number(volts, 3)} V)"
        if math.isfinite(volts)
        else ""
    )
    return [
        "Motor off: turn the hub by hand towards the positive side; the encoder must count up.",
        "Motor off: bend the tip by hand; the gauge torque must have the same sign as in the log.",
        f"Voltage limited to a fifth{limit}, link off: run the motor loop alone on a small move.",
        f"Link on, {grams(design.payloads[1])}, the heaviest payload, at the tip: a move of 0.1 rad; "
        "the law must stay in mode “run”.",
        f"The same with {grams(design.payloads[0])}, the lightest, where the margin is smallest; "
        "then the full move and the full voltage.",
        "Unplug the gauge during a move: the law must switch to “degraded” and finish the move.",
    ]
