"""What a controller achieves over the whole payload range: the worst value, and the payload it belongs to."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.controller import Controller
from fraclink._design.higher_modes import LIMIT, higher_modes, spillover_requirements
from fraclink._design.loop import OpenLoop
from fraclink._design.measure import sweep
from fraclink._design.plan import Requirement, open_loop
from fraclink._design.request import Request, payload_of
from fraclink._design.solve import MARGIN_SHARE
from fraclink.findings import Finding

if TYPE_CHECKING:
    from fraclink._arm.rig import Rig

__all__ = ["findings_of", "verify", "worst"]

Real = NDArray[np.float64]
_PAYLOADS = 17  # values of ω₀ at a time; a minimum inside the range is closed in on from its neighbours


@lru_cache(maxsize=64)  # asked for once to admit a solution and once to report it
def worst(
    loop: OpenLoop, low: float, high: float, highest: float
) -> tuple[tuple[float, float], tuple[float, float]]:
    """((smallest crossover, its ω₀), (smallest phase margin, its ω₀)) over [low, high]."""
    pi = np.geomspace(low, high, _PAYLOADS)
    crossover, margin = sweep(loop, pi, highest)
    first = int(np.argmin(crossover))
    place = int(np.argmin(margin))
    value, at = float(margin[place]), float(pi[place])
    for _ in range(4):
        if place in (0, pi.size - 1):
            break
        pi = np.geomspace(pi[place - 1], pi[place + 1], _PAYLOADS)
        margin = sweep(loop, pi, highest)[1]
        place = int(np.argmin(margin))
        value, at = float(margin[place]), float(pi[place])
    start = np.geomspace(low, high, _PAYLOADS)
    return (float(crossover[first]), float(start[first])), (value, at)


def verify(request: Request, rig: Rig, controller: Controller) -> tuple[Requirement, ...]:
    """Return every requirement with its worst value over the payload range."""
    loop = open_loop(controller, request.model, rig, margins=request.margins)
    highest = math.pi / request.period if request.margins == "loop" else math.inf
    (crossover, at_crossover), (margin, at_margin) = worst(loop, request.low, request.high, highest)

    def payload(pi: float) -> float:
        return payload_of(request.model, rig, pi)

    return (
        Requirement.at_least(
            "gain crossover", request.gain_crossover, crossover, "rad/s", payload(at_crossover)
        ),
        Requirement.at_least("phase margin", request.phase_margin, margin, "rad", payload(at_margin)),
    )


def findings_of(
    request: Request, rig: Rig, controller: Controller, upper: float, *, asked_mode: bool
) -> tuple[Finding, ...]:
    """Findings W401 … of a design: what holds less than it seems.

    `request` is what was asked for, before any bound changed it; `upper` the crossover of the lightest
    payload [rad/s]; `asked_mode` tells that the loop gain at the higher modes is among the requirements.
    """
    found = []
    cost = controller.filter_order * math.atan(controller.filter_time * upper)
    if request.filter_time is not None and cost > MARGIN_SHARE * request.phase_margin * (1.0 + 1e-2):
        found.append(
            Finding(
                "W401",
                "warning",
                "the filter costs more than 10 % of the phase margin",
                {
                    "filter_time": controller.filter_time,
                    "cost_rad": cost,
                    "phase_margin_rad": request.phase_margin,
                },
                "leave filter_time out to have it chosen by the rule",
            )
        )
    if not controller.is_strictly_proper:
        found.append(
            Finding(
                "W402",
                "info",
                "Ĉ is not strictly proper (condition (32)): gauge noise is not filtered",
                {"order": controller.order, "filter_time": controller.filter_time},
                "the sampling bounds it; give filter_time, or leave it out to have it chosen",
            )
        )
    bound = open_loop(controller, request.model, rig, margins="ideal").sufficient(request.low)
    if request.gain_crossover <= bound:
        found.append(
            Finding(
                "W403",
                "info",
                "condition (39) does not hold; the exact condition of Theorem 1 does, and it is what counts",
                {"gain_crossover": request.gain_crossover, "condition_39": bound},
            )
        )
    return (*found, *(() if asked_mode else _spillover(request, rig, controller)))


def _spillover(request: Request, rig: Rig, controller: Controller) -> tuple[Finding, ...]:
    """W405 where the loop reaches a higher mode of a link that states its mass."""
    loop = open_loop(controller, request.model, rig, margins="loop")
    modes = higher_modes(request.model, rig, loop, request.payloads)
    if modes is None:
        return ()
    found = spillover_requirements(modes, loop, LIMIT)
    worst = max(found, key=lambda item: item.achieved)
    if worst.passed:
        return ()
    return (
        Finding(
            "W405",
            "warning" if worst.achieved >= 1.0 else "info",
            f"the loop gain at mode {worst.name[-1]} of the link is high: above 1 the mode's phase decides, "
            "which nobody modelled",
            {"loop_gain": worst.achieved, "limit": LIMIT, "payload_kg": worst.at_payload},
            "ask for mode_gain=0.5 (--mode-gain 0.5), which lengthens the filter",
        ),
    )
