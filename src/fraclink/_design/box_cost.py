"""What a box of parameters costs a design, and which of its intervals costs most."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from fraclink._arm.box import Arm, ParameterBox, arms_of
from fraclink._arm.controller import Controller
from fraclink._arm.link import LinkModel
from fraclink._arm.rig import Rig
from fraclink.findings import Finding

__all__ = ["cost_of_box"]

# of an interval: the word for its parameter, and what narrows it
_WORDS = {
    "order": ("λ", "a longer log, or several logs of the arm,"),
    "natural_frequency": ("ω₀", "a longer log, or weighing the payload,"),
    "damping": ("μ", "a longer log that ends at rest"),
    "gauge_gain": ("the gauge's gain", "calibrating the gauge with known weights"),
    "gauge_delay": (
        "the gauge's delay",
        "measuring the delay that the controller sees",
    ),
    "motor_ratio": ("the motor", "identifying the motor"),
    "mode_frequency": ("the second mode", "a log that excites the second mode"),
}


def cost_of_box(
    model: LinkModel,
    rig: Rig,
    controller: Controller,
    natural_frequencies: tuple[float, float],
    box: ParameterBox,
) -> Finding:
    """Return W407: the phase margin that the box costs, and what each of its intervals
    would give back.

    At the worst corner one parameter after the other is taken as the model has it, and
    then half way there; `natural_frequencies` are those of the payloads' ends.
    """

    def margin(box: ParameterBox, arm: Arm) -> float:
        ends = (
            w0 * end / model.natural_frequency
            for w0, end in zip(natural_frequencies, box.natural_frequency, strict=True)
        )
        return float(arm.loop(controller, rig).margins(list(ends))[1].min())

    exact = ParameterBox.at(model)
    nominal = margin(exact, Arm(model))
    worst, arm = min(
        ((margin(box, arm), arm) for arm in arms_of(box, model)),
        key=lambda pair: pair[0],
    )
    gains: dict[str, tuple[float, float]] = {}
    for name in _WORDS:
        low, high = getattr(box, name)
        if low < high:
            point = getattr(exact, name)[0]
            # Half as wide is what a log four times as long gives; the exact parameter
            # is what no log can.
            known, half = (
                margin(*_shrunk(box, arm, name, point, share)) - worst
                for share in (0.0, 0.5)
            )
            gains[name] = known, half
    evidence: dict[str, float] = {"nominal_rad": nominal, "worst_rad": worst}
    evidence |= {f"{name}_rad": known for name, (known, _) in gains.items()}
    if not gains:
        return Finding(
            "W407",
            "info",
            "the box is a single arm and costs nothing",
            evidence,
            "give box=True for what fit and rig leave open",
        )
    top = max(gains, key=lambda name: gains[name][0])
    known, half = (math.degrees(value) for value in gains[top])
    low, high = getattr(box, top)
    word, remedy = _WORDS[top]
    return Finding(
        "W407",
        "info",
        f"the box costs {math.degrees(nominal - worst):.1f}° of phase margin, most of it {word} from "
        f"{low:.4g} to {high:.4g}: exactly known it would give back {known:.1f}°, half as wide {half:.1f}°",
        evidence,
        f"{remedy} narrows the interval",
    )


def _shrunk(
    box: ParameterBox, arm: Arm, name: str, point: float, share: float
) -> tuple[ParameterBox, Arm]:
    """(box, arm) with one parameter moved towards the model, to `share` of its
    distance.
    """

    def moved(value: float) -> float:
        return point + share * (value - point)

    link = arm.model
    if name == "natural_frequency":
        low, high = box.natural_frequency
        return replace(box, natural_frequency=(moved(low), moved(high))), arm
    if name == "motor_ratio":
        return box, replace(arm, motor_ratio=moved(arm.motor_ratio))
    if name == "mode_frequency":
        assert link.second_mode is not None  # its interval has a width  # noqa: S101
        second = replace(link.second_mode, frequency=moved(link.second_mode.frequency))
        return box, replace(arm, model=replace(link, second_mode=second))
    changed: dict[str, Any] = {name: moved(getattr(link, name))}
    return box, replace(arm, model=replace(link, **changed))
