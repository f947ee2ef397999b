"""What a design is asked for, and what fraclink asks for where nobody said."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import fields, replace

from fraclink._arm.link import LinkModel
from fraclink._arm.rig import Rig
from fraclink._design import Design, Specification, design
from fraclink._validate import checked_noun
from fraclink.errors import FieldError, InfeasibleError

__all__ = ["Request", "design_for"]

# The source paper's own proportions on its rig: a crossover of 12 rad/s where the heaviest payload's
# torque resonates at 10.4 rad/s. Below 1 there is no crossing right of the peak; each further step costs
# phase margin at the light end.
_CROSSOVER_RATIO = 1.15
_PHASE_MARGIN_DEG = 50.0
# An arm with a slow control period cannot have 50 degrees; the largest of these that is feasible is taken.
_FALLBACK_DEG = (45.0, 40.0, 35.0, 30.0)


Request = Specification  # None leaves a value to the rig file, and failing that to the default rule


def _completed(request: Request, rig: Rig) -> Request:
    """The request with what the rig's ``[design]`` table states where the user says nothing else."""
    payloads = request.payloads or (rig.payloads.low, rig.payloads.high)
    request = replace(request, payloads=payloads)
    wish = rig.design
    if wish is None:
        return request
    if request.gain_crossover is None and request.settling_time is None:
        request = replace(request, gain_crossover=wish.gain_crossover)
    if request.phase_margin is None and request.max_sensitivity is None:
        request = replace(request, phase_margin=wish.phase_margin)
    if request.filter_time is None and request.noise_gain is None and request.mode_gain is None:
        request = replace(request, filter_time=wish.filter_time)
    return request


def model_of(rig: Rig, model: LinkModel | None) -> LinkModel:
    """Return the model given, else the rig's own; FieldError where there is neither."""
    if model is not None:
        return model
    if rig.model is not None:
        return rig.model
    raise FieldError(
        "model",
        None,
        "not given, and the rig carries none",
        allowed="a model file",
        remedy="identify a log first, then give --model model.json",
    )


def design_for(rig: Rig, model: LinkModel | None, request: Request) -> tuple[Design, tuple[str, ...]]:
    """Design for a request completed from the rig; also return what had to be assumed, in sentences.

    Where neither the request nor the rig's ``[design]`` table states them, the gain crossover is 1.15 times
    the torque resonance of the heaviest payload [rad/s] and the phase margin 50° (or the largest of 45, 40,
    35 and 30° that is feasible).

    Raises InfeasibleError where the request cannot be met, FieldError where a value is out of its range.

    >>> from fraclink._arm.rig import Rig
    >>> design, assumed = design_for(Rig.named("paper-2023"), None, Request(filter_time=0.0))
    >>> round(design.controller.gain, 4), assumed
    (0.0699, ())
    """
    checked_noun("rig", rig, Rig, remedy="Rig.named or Rig.load make one")
    checked_noun("request", request, Request, remedy="Request(gain_crossover=12.0)")
    link = checked_noun("model", model_of(rig, model), LinkModel, remedy="fit.model, or rig.model")
    asked = _completed(request, rig)
    assumed: tuple[str, ...] = ()
    if asked.gain_crossover is None and asked.settling_time is None:
        own = (rig.payloads.low, rig.payloads.high) if asked.payloads is None else asked.payloads
        crossover, sentence = _usual_crossover(link, own[1])
        asked, assumed = replace(asked, gain_crossover=crossover), (sentence,)
    options = {item.name: getattr(asked, item.name) for item in fields(asked)}
    if asked.phase_margin is not None or asked.max_sensitivity is not None:
        result = design(link, rig, **options)
    else:
        result, sentence = _largest_margin(
            lambda margin: design(link, rig, **options | {"phase_margin": margin})
        )
        assumed = (*assumed, sentence)
    doubts = filter(None, map(rig.payloads.doubt, result.payloads))
    return replace(result, findings=(*result.findings, *doubts)), assumed


def _usual_crossover(link: LinkModel, heaviest: float) -> tuple[float, str]:
    heavy = link.at_payload(heaviest)
    resonance = heavy.torque_resonance or heavy.natural_frequency ** (2.0 / heavy.order)
    crossover = _CROSSOVER_RATIO * resonance
    return crossover, (
        f"gain crossover {crossover:.3g} rad/s: {_CROSSOVER_RATIO:g} times the torque resonance of the "
        f"heaviest payload ({resonance:.3g} rad/s), as neither the rig nor the request states one"
    )


def _largest_margin(ask: Callable[[float], Design]) -> tuple[Design, str]:
    """The design with the largest of the usual phase margins that is feasible."""
    for degrees in (_PHASE_MARGIN_DEG, *_FALLBACK_DEG[:-1]):
        try:
            design = ask(math.radians(degrees))
        except InfeasibleError:
            continue
        return design, _margin_sentence(degrees)
    return ask(math.radians(_FALLBACK_DEG[-1])), _margin_sentence(_FALLBACK_DEG[-1])


def _margin_sentence(degrees: float) -> str:
    less = (
        "" if degrees == _PHASE_MARGIN_DEG else f"; {_PHASE_MARGIN_DEG:g}° is not feasible at this crossover"
    )
    return f"phase margin {degrees:g}°, as neither the rig nor the request states one{less}"
