"""Why a request has no controller, and the nearest one that has."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from fraclink._design.request import Request
from fraclink._design.solve import Solution
from fraclink.errors import InfeasibleError

__all__ = ["refuse"]

Attempt = Callable[[Request], "tuple[Solution, int] | None"]
Candidates = Callable[[Request], "tuple[Solution, ...]"]


def _nearest(request: Request, field: str, values: NDArray[np.float64], attempt: Attempt) -> float | None:
    """The feasible value of one field closest to the one asked for: a scan, closed in on by bisection."""
    asked = float(getattr(request, field))

    def feasible(value: float) -> bool:
        if field == "phase_margin":
            return attempt(replace(request, phase_margin=value)) is not None
        return attempt(replace(request, gain_crossover=value)) is not None

    for value in sorted(map(float, values), key=lambda v: abs(math.log(v / asked))):
        if feasible(value):
            bad, good = asked, value
            # To about 1e-8 and not to the last bit: what is told must hold when it is typed in again.
            for _ in range(20):
                middle = math.sqrt(bad * good)
                bad, good = (bad, middle) if feasible(middle) else (middle, good)
            return good
    return None


def refuse(request: Request, attempt: Attempt, candidates: Candidates) -> NoReturn:
    """Raise InfeasibleError with the binding condition and the nearest feasible request."""
    top = 0.999 * (min(math.pi / request.period, request.inner_pole) if request.margins == "loop" else 1e4)
    crossovers = np.geomspace(min(request.low ** (2.0 / request.model.order), top) / 3.0, top, 60)
    angles = np.linspace(0.01, math.pi - 0.01, 80)
    margin = _nearest(request, "phase_margin", angles, attempt)
    crossover = _nearest(request, "gain_crossover", crossovers, attempt)
    options = {"phase_margin": margin, "gain_crossover": crossover}
    asked = {"phase_margin": request.phase_margin, "gain_crossover": request.gain_crossover}
    change = {k: abs(math.log(v / asked[k])) for k, v in options.items() if v is not None}
    condition, reason = _reason(request, candidates(request))
    parts = [reason]
    if margin is not None:
        word = "largest" if margin < request.phase_margin else "smallest"
        parts.append(
            f"at {request.gain_crossover:.6g} rad/s the {word} phase margin is {math.degrees(margin):.4g}°"
        )
    if crossover is not None:
        word = "highest" if crossover < request.gain_crossover else "lowest"
        parts.append(
            f"with {math.degrees(request.phase_margin):.4g}° the {word} gain crossover "
            f"is {crossover:.6g} rad/s"
        )
    nearest = {}
    if change:
        chosen = min(change, key=lambda k: change[k])
        nearest = asked | {chosen: float(options[chosen] or 0.0)}
    raise InfeasibleError(condition, "; ".join(parts), nearest)


def _reason(request: Request, found: tuple[Solution, ...]) -> tuple[str, str]:
    """(condition, sentence) of the bound that is hit."""
    if not found:
        where = "below the Nyquist frequency " if request.margins == "loop" else ""
        return "phase margin unreachable", f"no ω̄_c {where}solves equation (55) for this phase margin"
    best = min(found, key=lambda s: abs(s.order - 1.0))
    violated = best.violated(request.model.order)
    if violated is None:
        return (
            "phase margin at the other gain crossing",
            f"β = {best.order:.6g} solves (55), but where |L| rises through one the loop passes -1 closer",
        )
    if "peak" in violated:
        return violated, _peak_sentence(request, violated)
    return f"phase margin unreachable ({violated})", f"equation (55) asks for β = {best.order:.6g}"


def _peak_sentence(request: Request, violated: str) -> str:
    cosine = math.cos(0.5 * math.pi * request.model.order)
    needed = (-(request.low**2) / cosine) ** (1.0 / request.model.order)
    return (
        f"ω_c = {request.gain_crossover:.6g} rad/s lies left of the peak of |L|, where the margins fall the "
        f"other way; condition (39) asks for more than {needed:.6g} rad/s"
    )
