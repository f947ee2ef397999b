"""What a design is asked for where neither the request nor the rig says."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from fraclink._arm.link import LinkModel
from fraclink._arm.rig import Rig
from fraclink._design import Design, design
from fraclink._validate import checked
from fraclink.errors import FieldError, InfeasibleError

__all__ = ["design_for"]

# The source paper's own proportions on its rig: a crossover of 12 rad/s where the heaviest payload's
# torque resonates at 10.4 rad/s. Below 1 there is no crossing right of the peak; each further step costs
# phase margin at the light end.
_CROSSOVER_RATIO = 1.15
# 50° where it is feasible; an arm with a slow control period cannot have them.
_MARGINS_DEG = (50.0, 45.0, 40.0, 35.0, 30.0)

# A loop gain of 0.7 at a mode that was not in the request leaves 3 dB before its phase matters.
_MODE_GAIN = 0.7


@checked
def design_for(rig: Rig, model: LinkModel | None = None, **wanted: Any) -> tuple[Design, tuple[str, ...]]:
    """Design what is wanted, completed from the rig; also return what had to be assumed, in sentences.

    `wanted` are the options of `design`; None leaves one to the rig's ``[design]`` table. Where that is
    silent, too, the gain crossover is 1.15 times the torque resonance of the heaviest payload [rad/s] and
    the phase margin 50°, or the largest of 45, 40, 35 and 30° that is feasible.

    Raises InfeasibleError where this cannot be met, FieldError where a value is out of its range.

    >>> made, assumed = design_for(Rig.named("paper-2023"), filter_time=0.0)
    >>> round(made.controller.gain, 4), assumed
    (0.0699, ())
    """
    link = model or rig.model
    if link is None:
        allowed, remedy = "a model file", "identify a log first, then give --model model.json"
        raise FieldError("model", None, "missing", allowed=allowed, remedy=remedy)
    asked = {name: value for name, value in wanted.items() if value is not None}
    asked.setdefault("payloads", (rig.payloads.low, rig.payloads.high))
    for name, instead in _COMPLETED.items():
        stated = None if rig.design is None else getattr(rig.design, name)
        if stated is not None and not {name, *instead} & set(asked):
            asked[name] = stated
    assumed: tuple[str, ...] = ()
    if not {"gain_crossover", "settling_time"} & set(asked):
        heaviest = max(asked["payloads"]) if len(asked["payloads"]) == 2 else rig.payloads.high
        asked["gain_crossover"], sentence = _usual_crossover(link, heaviest)
        assumed = (sentence,)
    if {"phase_margin", "max_sensitivity"} & set(asked):
        made, sentences = _least_mode_gain(link, rig, asked)
        assumed = (*assumed, *sentences)
    else:
        made, sentence = _largest_margin(lambda margin: design(link, rig, **asked, phase_margin=margin))
        assumed = (*assumed, sentence)
    doubts = filter(None, map(rig.payloads.doubt, made.payloads))
    return replace(made, findings=(*made.findings, *doubts)), assumed


# What the rig's [design] table completes, and what else in the request takes its place.
_COMPLETED = {
    "gain_crossover": ("settling_time",),
    "phase_margin": ("max_sensitivity",),
    "filter_time": ("noise_gain", "mode_gain"),
}


def _usual_crossover(link: LinkModel, heaviest: float) -> tuple[float, str]:
    heavy = link.at_payload(heaviest)
    resonance = heavy.torque_resonance or heavy.natural_frequency ** (2.0 / heavy.order)
    crossover = _CROSSOVER_RATIO * resonance
    return crossover, (
        f"gain crossover {crossover:.3g} rad/s: {_CROSSOVER_RATIO:g} times the torque resonance of the "
        f"heaviest payload ({resonance:.3g} rad/s), as neither the rig nor the request states one"
    )


def _least_mode_gain(link: LinkModel, rig: Rig, asked: Mapping[str, Any]) -> tuple[Design, tuple[str, ...]]:
    """The design with the usual bound on the gain at the second mode, or the least that is feasible."""
    try:
        return design(link, rig, **asked), ()
    except InfeasibleError as error:
        least = error.nearest.get("mode_gain", math.inf)
        if "mode_gain" in asked or set(error.nearest) != {"mode_gain"} or least > _MODE_GAIN:
            raise
    # The nearest feasible bound is met exactly: a hundredth more leaves room for rounding.
    bound = math.ceil(100 * least) / 100
    sentence = f"gain of {bound:g} at the second mode, as 0.5 is not feasible with this crossover and margin"
    return design(link, rig, **asked, mode_gain=bound), (sentence,)


def _largest_margin(ask: Callable[[float], Design]) -> tuple[Design, str]:
    """The design with the largest of the usual phase margins that is feasible."""
    *usual, last = _MARGINS_DEG
    for degrees in usual:
        try:
            return ask(math.radians(degrees)), _margin_sentence(degrees)
        except InfeasibleError:
            continue
    return ask(math.radians(last)), _margin_sentence(last)


def _margin_sentence(degrees: float) -> str:
    less = "" if degrees == _MARGINS_DEG[0] else f"; {_MARGINS_DEG[0]:g}° is not feasible at this crossover"
    return f"phase margin {degrees:g}°, as neither the rig nor the request states one{less}"
