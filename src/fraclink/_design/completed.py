"""Designs completed from the rig, with defaults for what neither the request nor the
rig states.
"""

from __future__ import annotations

from typing import Any

from fraclink._arm.controller import Controller
from fraclink._arm.link import LinkModel
from fraclink._arm.loop import with_payload
from fraclink._arm.rig import Rig
from fraclink._design.procedure import design, sketched
from fraclink._design.rows import SENSITIVITY
from fraclink._law.design import Design
from fraclink.errors import required
from fracsys.checks import checked

__all__ = ["design_for"]

# Entries of the rig's [design] table, and the requests that replace each of them.
_COMPLETED = {
    "gain_crossover": ("settling_time",),
    "phase_margin": ("max_sensitivity",),
    "filter_time": ("noise_gain", "mode_gain"),
}


@checked
def design_for(
    rig: Rig,
    model: LinkModel | None = None,
    *,
    near: Controller | None = None,
    **wanted: Any,
) -> tuple[Design, tuple[str, ...]]:
    """Return the design for a request completed from the rig, and the assumptions as
    sentences.

    `wanted` are the options of `design`; an option that is None is taken from the rig's
    ``[design]`` table. Without an entry there, the crossover is close to the highest
    that meets every requirement, and Ms is at most 2. Values stated by the request or
    the rig are never changed.

    With the controller of a similar request (`near`), the design is `sketched` if
    possible.

    Raises InfeasibleError if the stated values cannot be met, FieldError if a value is
    out of its range.

    >>> made, assumed = design_for(Rig.named("paper-2023"), filter_time=0.0)
    >>> round(made.controller.derivative_gain, 3), assumed
    (0.064, ())
    """
    link = required(
        "model",
        model or rig.model,
        "a model file",
        "identify a log first, then give --model model.json",
    )
    request = {name: value for name, value in wanted.items() if value is not None}
    for name, alternatives in _COMPLETED.items():
        default = None if rig.design is None else getattr(rig.design, name)
        if default is not None and not {name, *alternatives} & set(request):
            request[name] = default
    own_model = with_payload(link, rig)
    result = None
    if near is not None:
        stated = {key: request[key] for key in request.keys() - {"law", "nearest"}}
        result = sketched(own_model, rig, near, **stated)
    result = result or design(own_model, rig, **request)
    return result, (*_assumed_payload(link, own_model), *_assumed(request, result))


def _assumed_payload(link: LinkModel, known: LinkModel) -> tuple[str, ...]:
    """The assumed ω₀ where the payload of the log is unknown."""
    if link.payload is not None or known.payload is None:
        return ()
    own, weight = link.natural_frequency, 1e3 * known.payload
    return (
        f"ω₀ {known.natural_frequency:.4g} at {weight:g} g, from the rig's stiffness and length, "
        f"as the model's {own:.4g} belongs to a payload that it does not state",
    )


def _assumed(request: dict[str, Any], result: Design) -> tuple[str, ...]:
    """The assumptions where no crossover or no margin is stated."""
    reason = "as neither the rig nor the request states one"
    sentences = []
    if not {"gain_crossover", "settling_time"} & set(request):
        sentences.append(
            f"gain crossover {result.gain_crossover:.3g} rad/s: close to the highest that "
            f"keeps every requirement, {reason}"
        )
    if not {"phase_margin", "max_sensitivity"} & set(request):
        sentences.append(f"sensitivity peak of {SENSITIVITY:g} at most, {reason}")
    return tuple(sentences)
