"""The cost of a parameter box for a design, the interval that costs most, and an arm of
the box in words.
"""

from __future__ import annotations

import math
from dataclasses import replace

from fraclink._arm.box import Arm, ParameterBox
from fraclink._design.search import Solution
from fraclink._display import quantity
from fraclink._law.design import Design
from fraclink.findings import Finding

__all__ = ["arm_in_words", "cost_of_box"]

# for each interval: the word for its parameter, its unit, and the remedy that narrows it
_WORDS = {
    "order": ("λ", "", "a longer log, or several logs of the arm,"),
    "natural_frequency": ("ω₀", "", "a longer log, or weighing the payload,"),
    "damping": ("μ", "", "a longer log that ends at rest"),
    "gauge_gain": ("the gauge's gain", "", "calibrating the gauge with known weights"),
    "gauge_delay": (
        "the gauge's delay",
        "ms",
        "measuring the delay that the controller sees",
    ),
    "motor_ratio": ("the motor", "", "identifying the motor"),
    "mode_frequency": (
        "the second mode",
        "rad/s",
        "a log that excites the second mode",
    ),
}


def cost_of_box(design: Design, solution: Solution) -> Finding:
    """Return W407: the phase margin that the box of a design costs, and what the worst
    corner would gain with each parameter at exactly the model's value.
    """
    model, box = design.model, design.box
    assert box is not None  # noqa: S101
    exact = ParameterBox.at(model)

    def margin(arm: Arm, frequencies: tuple[float, float]) -> float:
        """The least phase margin of an arm; `frequencies` of the box."""
        ends = [
            w0 * end / model.natural_frequency
            for w0, end in zip(design.natural_frequencies, frequencies, strict=True)
        ]
        return float(arm.loop(design.controller, design.rig).margins(ends)[1].min())

    nominal = margin(Arm(model), exact.natural_frequency)
    arm = solution.worst_arm("phase_margin")
    worst = margin(arm, box.natural_frequency)
    gains: dict[str, float] = {}
    for name in _WORDS:
        low, high = getattr(box, name)
        if low < high:
            known = exact if name == "natural_frequency" else box
            variant = arm.knowing(name, exact)
            gains[name] = margin(variant, known.natural_frequency) - worst
    evidence = {
        "nominal_rad": nominal,
        "worst_rad": worst,
        **{f"{name}_rad": gain for name, gain in gains.items()},
    }
    if not gains:
        return Finding(
            "W407",
            "info",
            "the box is a single arm and costs nothing",
            evidence,
            "give box=True for what fit and rig leave open",
        )
    top = max(gains, key=lambda name: gains[name])
    low, high = getattr(box, top)
    word, _, remedy = _WORDS[top]
    return Finding(
        "W407",
        "info",
        f"the box costs {math.degrees(nominal - worst):.1f}° of phase margin, most of it {word} from "
        f"{low:.4g} to {high:.4g}: known exactly, it would give back {math.degrees(gains[top]):.1f}°",
        evidence,
        f"{remedy} narrows the interval",
    )


def arm_in_words(arm: Arm, box: ParameterBox) -> str:
    """Return an arm's values of the parameters that its box leaves open, as text.

    ω₀ is left out: its interval widens the range of the payloads.
    """
    own = replace(ParameterBox.at(arm.model), motor_ratio=(arm.motor_ratio,) * 2)
    return ", ".join(
        f"{word} {quantity(getattr(own, name)[0], unit)}"
        for name, (word, unit, _) in _WORDS.items()
        if name != "natural_frequency" and len(set(getattr(box, name))) > 1
    )
