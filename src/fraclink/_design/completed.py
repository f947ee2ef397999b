"""A design completed from its rig: what is asked for where neither the request nor the
rig says.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from fraclink._arm.link import LinkModel
from fraclink._arm.loop import with_payload
from fraclink._arm.rig import Rig
from fraclink._design.procedure import design
from fraclink._law.design import Design
from fraclink.errors import FieldError, InfeasibleError
from fracsys.checks import checked

__all__ = ["design_for"]

# The source paper's own proportions on its rig: a crossover of 12 rad/s where the
# heaviest payload's torque resonates at 10.4 rad/s. Below 1 there is no crossing right
# of the peak; each further step costs phase margin at the light end.
_CROSSOVER_RATIO = 1.15
# 50° where it is feasible; an arm with a slow control period cannot have them.
_MARGINS_DEG = (50.0, 45.0, 40.0, 35.0, 30.0)

# A loop gain of 0.7 at a mode that was not in the request leaves 3 dB before its phase
# matters.
_MODE_GAIN = 0.7


@checked
def design_for(
    rig: Rig, model: LinkModel | None = None, **wanted: Any
) -> tuple[Design, tuple[str, ...]]:
    """Design what is wanted, completed from the rig; also return what had to be
    assumed, in sentences.

    `wanted` are the options of `design`; None leaves one to the rig's ``[design]``
    table. Where that is silent, too, the gain crossover is 1.15 times the torque
    resonance of the heaviest payload [rad/s], or the feasible one nearest to it, and
    the phase margin 50°, or the largest of 45, 40, 35 and 30° that is feasible. What
    request or rig states is never changed.

    Raises InfeasibleError where what is stated cannot be met, FieldError where a value
    is out of its range.

    >>> made, assumed = design_for(Rig.named("paper-2023"), filter_time=0.0)
    >>> round(made.controller.gain, 4), assumed
    (0.0699, ())
    """
    link = model or rig.model
    if link is None:
        allowed, remedy = (
            "a model file",
            "identify a log first, then give --model model.json",
        )
        raise FieldError("model", None, "missing", allowed=allowed, remedy=remedy)
    asked = {name: value for name, value in wanted.items() if value is not None}
    asked.setdefault("payloads", (rig.payloads.low, rig.payloads.high))
    for name, instead in _COMPLETED.items():
        stated = None if rig.design is None else getattr(rig.design, name)
        if stated is not None and not {name, *instead} & set(asked):
            asked[name] = stated
    known = with_payload(link, rig)
    crossing = {"gain_crossover", "settling_time"} & set(asked)
    made, assumed = (_completed_margin if crossing else _usual_crossover)(
        known, rig, asked
    )
    return made, (*_assumed_payload(link, known), *assumed)


def _assumed_payload(link: LinkModel, known: LinkModel) -> tuple[str, ...]:
    """What takes the place of the frequency of a log that nobody knows the payload of."""
    if link.payload is not None or known.payload is None:
        return ()
    own, weight = link.natural_frequency, 1e3 * known.payload
    return (
        f"ω₀ {known.natural_frequency:.4g} at {weight:g} g, from the rig's stiffness and length, "
        f"as the model's {own:.4g} belongs to a payload that it does not state",
    )


# What the rig's [design] table completes, and what else in the request takes its place.
_COMPLETED = {
    "gain_crossover": ("settling_time",),
    "phase_margin": ("max_sensitivity",),
    "filter_time": ("noise_gain", "mode_gain"),
}


def _usual_crossover(
    link: LinkModel, rig: Rig, asked: Mapping[str, Any]
) -> tuple[Design, tuple[str, ...]]:
    """The design with the usual crossover, or with the feasible one nearest to it."""
    heavy = link.at_payload(
        max(asked["payloads"]) if len(asked["payloads"]) == 2 else rig.payloads.high
    )
    resonance = heavy.torque_resonance or heavy.natural_frequency ** (2.0 / heavy.order)
    usual = _CROSSOVER_RATIO * resonance
    rule = (
        f"{_CROSSOVER_RATIO:g} times the torque resonance of the heaviest payload ({resonance:.3g} rad/s), "
        "as neither the rig nor the request states one"
    )
    try:
        made, more = _completed_margin(link, rig, {**asked, "gain_crossover": usual})
    except InfeasibleError as error:
        if "gain_crossover" not in error.nearest or not _keeps(asked, error.nearest):
            raise
        made, more = _completed_margin(link, rig, {**asked, **error.nearest})
        if not math.isclose(made.gain_crossover, usual):
            rule = f"the nearest feasible to {usual:.3g} rad/s, {rule}"
        if "phase_margin" not in asked:
            more = (_margin_sentence(math.degrees(made.phase_margin)), *more)
    return made, (f"gain crossover {made.gain_crossover:.3g} rad/s: {rule}", *more)


def _keeps(asked: Mapping[str, Any], nearest: Mapping[str, float]) -> bool:
    """Whether the nearest feasible request keeps every value that was stated; the
    others may move.
    """
    return all(
        math.isclose(asked[name], value)
        for name, value in nearest.items()
        if name in asked
    )


def _completed_margin(
    link: LinkModel, rig: Rig, asked: Mapping[str, Any]
) -> tuple[Design, tuple[str, ...]]:
    """The design asked for; where no margin is, the one with the largest usual margin
    that is feasible.
    """
    if {"phase_margin", "max_sensitivity"} & set(asked):
        return _least_mode_gain(link, rig, asked)

    def ask(degrees: float) -> Design:
        return design(link, rig, **asked, phase_margin=math.radians(degrees), law=False)

    largest, *between, least = _MARGINS_DEG
    try:
        return ask(largest), (_margin_sentence(largest),)
    except InfeasibleError as error:
        # A refusal searches the nearest feasible request, for seconds: where the least
        # margin is refused, too, those between are not tried.
        try:
            made = ask(least)
        except InfeasibleError:
            raise error from None
    for degrees in between:
        try:
            return ask(degrees), (_margin_sentence(degrees),)
        except InfeasibleError:
            continue
    return made, (_margin_sentence(least),)


def _least_mode_gain(
    link: LinkModel, rig: Rig, asked: Mapping[str, Any]
) -> tuple[Design, tuple[str, ...]]:
    """The design with the usual bound on the gain at the second mode, or the least that
    is feasible.
    """
    try:
        return design(link, rig, **asked, law=False), ()
    except InfeasibleError as error:
        least = error.nearest.get("mode_gain", math.inf)
        if (
            "mode_gain" in asked
            or set(error.nearest) != {"mode_gain"}
            or least > _MODE_GAIN
        ):
            raise
    # The nearest feasible bound is met exactly: a hundredth more leaves room for
    # rounding.
    bound = math.ceil(100 * least) / 100
    sentence = f"gain of {bound:g} at the second mode, as 0.5 is not feasible with this crossover and margin"
    return design(link, rig, **asked, mode_gain=bound, law=False), (sentence,)


def _margin_sentence(degrees: float) -> str:
    # Degrees that came from radians differ from 50 in the last digit.
    usual = math.isclose(degrees, _MARGINS_DEG[0])
    less = "" if usual else f"; {_MARGINS_DEG[0]:g}° is not feasible at this crossover"
    return f"phase margin {degrees:g}°, as neither the rig nor the request states one{less}"
