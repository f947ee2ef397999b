"""The procedure as it was published (section 6, (54)–(57)): crossover and margin of Ĉ·G
met with equality, on request.

Magnitude at the heaviest payload gives ``k_d = χ/ω_c^β`` (54). The phase of (55) is
linear in β and gives ``β(ω̄_c) = (2/π)(φ_m - π - arg G(jω̄_c; ω̄₀))``; its magnitude
then leaves one equation in ω̄_c alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fraclink._arm.box import ParameterBox
from fraclink._arm.controller import Controller
from fraclink._arm.draft import doubts_of
from fraclink._arm.link import LinkModel
from fraclink._arm.loop import Loop, with_payload
from fraclink._arm.rig import Rig
from fraclink._design.request import Request
from fraclink._design.search import Search, Solution
from fraclink._design.table import Outer
from fraclink._law.design import Design, Requirement
from fraclink._law.requirement import PAYLOADS
from fraclink.errors import FieldError, InfeasibleError
from fraclink.findings import Finding
from fracsys._sweep import bracketed_roots
from fracsys.checks import Real

__all__ = ["ClosedForm", "published"]


_SHARE = 0.1  # share of the phase margin that the filter may cost (section 6, step 5)
_GRID = 240  # trial values of ω̄_c, between which a change of sign is sought
_KNOWN = {
    "payloads",
    "natural_frequencies",
    "gain_crossover",
    "phase_margin",
    "filter_time",
    "filter_order",
    "motor_loop",
    "placement",
}


@dataclass(frozen=True)
class ClosedForm:
    """One solution of (54), (55), whether or not it is admissible."""

    order: float  # β
    gain: float  # k_d
    upper: float  # ω̄_c [rad/s]
    chi: float
    slope_low: (
        float  # d ln|L| / d ln ω at (ω₀ low, ω_c): negative to the right of the peak
    )
    slope_high: float  # the same at (ω₀ high, ω̄_c)

    def violated(self, link_order: float) -> str | None:
        """Name the first condition of Theorem 1 that fails, None if all are met.

        The exact condition is to lie right of the peak of |L|: the denominator of (49)
        is minus the slope times a positive factor, so its sign determines whether ω_c
        rises and φ_m falls with ω₀. (39) is only sufficient.
        """
        # β < λ is a condition of Theorem 1, and β < 2 holds for every controller; for λ
        # = 2 they coincide.
        if self.order <= 0.0:
            return "β > 0"
        if self.order >= min(link_order, 2.0):
            return "β < λ" if link_order < 2.0 else "β < 2"
        if self.slope_low >= 0.0:
            return "gain crossover right of the peak at the heaviest payload"
        if self.slope_high >= 0.0:
            return "gain crossover right of the peak at the lightest payload"
        return None


def published(
    model: LinkModel,
    rig: Rig,
    spec: Mapping[str, Any],
    box: ParameterBox | bool | None,
) -> Design:
    """The closed form of a specification, met with equality."""
    unknown = sorted(set(spec) - _KNOWN) + (["box"] if box else [])
    missing = [key for key in ("gain_crossover", "phase_margin") if key not in spec]
    for field in unknown + missing:
        raise FieldError(
            field,
            "given" if field in unknown else None,
            "unknown to the published procedure"
            if field in unknown
            else "missing for the published procedure",
            "crossover and margin, and nothing else",
            'leave out procedure="published": the solver needs neither and takes every requirement',
        )
    ideal = {"motor_loop": "ideal", "placement": "tustin", **spec}
    request = Request.of(with_payload(model, rig), rig, ideal, None)
    solution, order = _admissible(request)
    loop = replace(Loop.ideal(request.model), gain=solution.gain, order=solution.order)
    time = spec.get("filter_time")
    if time is None:
        time = _filter_afterwards(request, loop, order, solution.upper)
    controller = Controller(
        derivative_gain=solution.gain,
        derivative_order=solution.order,
        filter_time=time,
        filter_order=order,
        link=request.model.at_payload(rig.payloads.nominal),
        motor_loop=request.motor_loop,
        period=rig.period,
    )
    goals = spec["gain_crossover"], spec["phase_margin"]
    links = _links(request)
    rows = zip(
        ("gain crossover", "phase margin"),
        ("rad/s", "rad"),
        goals,
        loop.margins(links),
        strict=True,
    )
    return Design(
        model=model,
        rig=rig,
        controller=controller,
        requirements=tuple(
            Requirement(
                name,
                goal,
                float(achieved.min()),
                unit,
                request.model.payload_at(float(links[np.argmin(achieved)])),
                "at least",
            )
            for name, unit, goal, achieved in rows
        ),
        margins_kind="ideal",
        payloads=request.payloads,
        natural_frequencies=request.natural_frequencies,
        gain_crossover=goals[0],
        phase_margin=goals[1],
        chi=solution.chi,
        gain_crossover_upper=solution.upper,
        findings=(
            *doubts_of(rig, model, request.payloads),
            *_ignored_rows(request, controller),
        ),
    )


def _links(request: Request) -> Real:
    """ω₀ of the payloads at which loops are evaluated, as by the solver."""
    return np.geomspace(*request.natural_frequencies, PAYLOADS)


def _ignored_rows(request: Request, controller: Controller) -> Iterator[Finding]:
    """W405: the rows that the procedure does not cover and that its loop misses."""
    search = Search(request, request.first_links, controller.filter_order)
    outer = Outer.of(controller, request.reference)
    measured = Solution(search, outer.x, 0.0, 0.0).measured
    misses = "; ".join(str(item) for _, item in measured if not item.passed)
    if misses:
        yield Finding(
            "W405",
            "warning",
            f"the loop that runs misses requirements that the published procedure ignores: {misses}",
            {},
            'leave out procedure="published"',
        )


def _solutions(request: Request, order: int) -> Iterator[ClosedForm]:
    """All solutions of (54), (55) with ω̄_c above 0.9 ω_c, lowest ω̄_c first."""
    bare = replace(Loop.ideal(request.model), filter_order=order)
    low, high = request.natural_frequencies
    crossover, margin = request.spec["gain_crossover"], request.spec["phase_margin"]
    at_low = bare.log(crossover, low)

    def terms(upper: Real) -> tuple[Real, Real, Real]:
        """(residual of the magnitude of (55), β, ln χ) at trial values of ω̄_c."""
        at_high = bare.log(upper, high)
        # arg L = −π + φ_m at ω̄_c, and arg (jω)^β is βπ/2 at every ω: linear in β,
        # without a choice of branch, since `bare.log` has the unwrapped phase.
        beta = 2.0 / math.pi * (margin - math.pi - at_high.imag)
        chi = -at_low.real
        # ln|L(jω̄_c)| with k_d from (54): ln χ + β ln(ω̄_c/ω_c) + ln|G|. Its zero is the
        # second crossing.
        residual = chi + beta * (np.log(upper) - np.log(crossover)) + at_high.real
        return residual, beta, chi

    # Far above the mode |L| ∝ ω₀² ω^(β−λ), so from one payload to the other the
    # crossing moves by (ω̄₀/ω₀)^(2/(λ−β)): the square of the ratio for λ − β = 1. The
    # factor 50 covers flatter slopes.
    top = min(bare.highest, 50.0 * crossover * (high / low) ** 2)
    grid = np.geomspace(0.9 * crossover, max(top, 1.1 * crossover), _GRID)
    residual = terms(grid)[0]
    for i in np.nonzero((residual[:-1] > 0.0) != (residual[1:] > 0.0))[0]:
        upper = bracketed_roots(lambda x: terms(x)[0], grid[i], grid[i + 1])
        _, beta, log_chi = (float(x) for x in terms(upper))
        loop = replace(bare, order=beta)
        yield ClosedForm(
            order=beta,
            gain=math.exp(log_chi) / crossover**beta,
            upper=float(upper),
            chi=math.exp(log_chi),
            slope_low=float(loop.slope(crossover, low).real),
            slope_high=float(loop.slope(upper, high).real),
        )


def _admissible(request: Request) -> tuple[ClosedForm, int]:
    """The admissible solution and its n; InfeasibleError if there is none."""
    low, _ = request.natural_frequencies
    goals = request.spec["gain_crossover"], request.spec["phase_margin"]
    own, candidates = request.spec.get("filter_order"), []
    for order in (own,) if own else (1, 2):
        for solution in _solutions(request, order):
            violated = solution.violated(request.model.order)
            candidates.append((solution, violated))
            # With n = 1 and β ≥ 1 the noise gain of Ĉ would be unbounded: the next n is
            # used instead.
            if violated or (own is None and order == 1 and solution.order >= 1.0):
                continue
            loop = replace(
                Loop.ideal(request.model), gain=solution.gain, order=solution.order
            )
            reached = [part.min() for part in loop.margins(_links(request))]
            # A solution meets its own equations up to rounding.
            if all(x >= y * (1.0 - 1e-9) for x, y in zip(reached, goals, strict=True)):
                return solution, order
    if not candidates:
        sentence = "no ω̄_c solves equation (55) for this phase margin"
        raise InfeasibleError("phase margin unreachable", sentence, {})
    # Of several solutions, the one nearest to the middle of 0 < β < 2 is the closest to
    # being admissible.
    best, violated = min(candidates, key=lambda pair: abs(pair[0].order - 1.0))
    if violated is None:
        violated = "phase margin at the other gain crossing"
    bound = Loop.ideal(request.model).sufficient(low)
    sentence = (
        f"equation (55) asks for β = {best.order:.6g}; condition (39) asks for a crossover of more than "
        f"{bound:.6g} rad/s"
    )
    raise InfeasibleError(f"phase margin unreachable ({violated})", sentence, {})


def _filter_afterwards(request: Request, loop: Loop, n: int, upper: float) -> float:
    """δ [s] with which the filtered loop keeps exactly 90 % of the margin at the
    lightest payload.

    The filter lowers the crossing, so both are determined together: δ(ω) follows from
    the phase, and the magnitude gives one equation in ω (eq. (57) and the criterion
    after it).
    """
    high = request.natural_frequencies[1]
    margin = (1.0 - _SHARE) * request.spec["phase_margin"]

    def lag(frequency: Real) -> Real:
        return loop.log(frequency, high).imag + math.pi - margin

    def level(frequency: Real) -> Real:
        # Clipped: beyond a quarter turn per pole no filter can provide that lag.
        angle = np.clip(lag(frequency) / n, 0.0, 0.45 * math.pi)
        return loop.log(frequency, high).real + n * np.log(np.cos(angle))

    # Below ω̄_c the unfiltered loop has less lag and more gain: go down until the
    # filter can provide the lag. Steps of 1 %, down to 13 % of ω̄_c; no filter that
    # costs a tenth of the margin moves the crossing that far.
    steps: Real = upper * np.power(0.99, np.arange(1.0, 201.0))
    enough = (lag(steps) >= 0.45 * math.pi * n) | (level(steps) > 0.0)
    low = steps[int(np.argmax(enough))] if enough.any() else steps[-1]
    crossing = bracketed_roots(level, low, upper)
    return math.tan(float(lag(crossing)) / n) / float(crossing)
