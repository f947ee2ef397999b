"""`design`: from a request to a design, or to the reason why there is none."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.controller import Controller
from fraclink._arm.motor_loop import MotorLoop
from fraclink._design.goals import check_goals, crossover_for, goal_requirements, margin_for, reach
from fraclink._design.infeasible import refuse
from fraclink._design.loop import OpenLoop
from fraclink._design.plan import Design
from fraclink._design.request import Request, check_arm, check_request, link_at
from fraclink._design.solve import Solution, Specification, filter_by_rule, solve
from fraclink._design.verify import findings_of, verify, worst

if TYPE_CHECKING:
    from fraclink._arm.link import LinkModel
    from fraclink._arm.rig import Rig

__all__ = ["design"]


def design(
    model: LinkModel,
    rig: Rig,
    *,
    payloads: tuple[float, float] | None = None,
    natural_frequencies: tuple[float, float] | None = None,
    gain_crossover: float | None = None,
    phase_margin: float | None = None,
    margins: str = "loop",
    filter_time: float | None = None,
    filter_order: int | None = None,
    inner: str = "ideal",
    placement: str = "tustin",
    max_sensitivity: float | None = None,
    noise_gain: float | None = None,
    settling_time: float | None = None,
    mode_gain: float | None = None,
) -> Design:
    """Design ``C(s) = 1 + k_d s^β/(1 + δs)^n`` for every payload of a range (section 6, eqs. (54)–(57)).

    The gain crossover is met at the heaviest payload and the phase margin at the lightest; both are
    smallest there (Theorem 1), and the design reports the worst value found over the whole range.

    Parameters
    ----------
    model
        the link; its ``order``, ``damping`` and, where ``payload`` is known, its own ω₀ are used.
    rig
        motor loop, sampling period, payloads and stiffness.
    payloads
        (lightest, heaviest) [kg], > 0; the rig's own when neither range is given.
    natural_frequencies
        (low, high) ω₀ [s^(-λ/2)] instead of payloads.
    gain_crossover
        smallest ω_c [rad/s], > 0 and right of the peak of |L|; from `settling_time` when left out.
    phase_margin
        smallest φ_m [rad], 0 < φ_m < π; ``deg(50)`` for 50 degrees; from `max_sensitivity` when left out.
    margins
        "loop": filter, M(s), half a sample of hold and the computation delay stand inside (55).
        "ideal": the paper's reading, Ĉ·G alone.
    filter_time
        δ [s] >= 0; zero for none; chosen so that it costs 10 % of the margin when left out.
    filter_order
        n, 1 or 2; 1 for β < 1 and 2 otherwise when left out.
    inner
        "ideal" (M(s) of eq. (21)) or "sampled" (the PID at the control period, on the motor).
    placement
        for the sampled motor loop: "tustin" discretises (19), (20); "direct" places its poles in z.
    max_sensitivity
        bound on Ms = max 1/|1 + L|, > 1.
    noise_gain
        bound on the motor reference's RMS for white gauge noise of RMS one, > 0; more filter where needed.
    settling_time
        bound on 2π/ω_c [s], > 0.
    mode_gain
        bound on the loop gain at modes 2 and 3 of a link with mass, > 0; more filter where needed, paid for
        with a larger β. Below one no phase of the mode can destabilise it.

    Returns
    -------
    Design
        controller, requirements with what is achieved, findings.

    Raises
    ------
    FieldError
        a value is out of its range.
    InfeasibleError
        no controller of this form meets the request; names the condition and the nearest feasible request.

    Examples
    --------
    >>> from fraclink._design import deg, design
    >>> from fraclink._arm.rig import Rig
    >>> rig = Rig.named("paper-2023")
    >>> wanted = {"gain_crossover": 12.0, "phase_margin": deg(50), "filter_time": 0.0}
    >>> design = design(rig.model, rig, payloads=(0.020, 0.040), **wanted)
    >>> round(design.controller.gain, 6), round(design.controller.order, 6), design.passed
    (0.069876, 0.612197, True)
    """
    check_arm(model, rig)
    goals = check_goals(max_sensitivity, noise_gain, settling_time, mode_gain, rig)
    request = check_request(
        model,
        rig,
        payloads=payloads,
        natural_frequencies=natural_frequencies,
        gain_crossover=crossover_for(goals, gain_crossover),
        phase_margin=margin_for(goals, phase_margin),
        margins=margins,
        filter_time=filter_time,
        filter_order=filter_order,
        inner=inner,
        placement=placement,
    )
    asked = request
    if goals.any:

        def made(changed: Request, solution: Solution, order: int) -> Controller:
            return _controller(changed, rig, solution, order)

        request = reach(request, rig, goals, attempt, made, free_margin=phase_margin is None)
    solution, order = admissible(request)
    controller = _controller(request, rig, solution, order)
    requirements = verify(request, rig, controller)
    requirements += goal_requirements(request, rig, controller, goals, requirements[0].achieved)
    return Design(
        model=model,
        rig=rig,
        controller=controller,
        requirements=requirements,
        margins_kind=request.margins,
        payloads=request.payloads,
        natural_frequencies=(request.low, request.high),
        gain_crossover=request.gain_crossover,
        phase_margin=request.phase_margin,
        chi=solution.chi,
        gain_crossover_upper=solution.upper,
        findings=findings_of(asked, rig, controller, solution.upper, asked_mode=goals.mode_gain is not None),
    )


def specification(request: Request, order: int) -> Specification:
    """The two equations of a request, with a filter of order `order` where one stands inside (55)."""
    inside = request.margins == "loop"
    bare = OpenLoop(
        gain=1.0,
        order=0.0,
        link_order=request.model.order,
        damping=request.model.damping,
        damping_order=request.model.damping_order,
        filter_time=(request.filter_time or 0.0) if inside else 0.0,
        filter_order=order,
        lag=1.0 / request.inner_pole if inside else 0.0,
        delay=(request.delay_samples + 0.5) * request.period if inside else 0.0,
        correction=_correction(request) if inside else None,
    )
    return Specification(
        bare=bare,
        low=request.low,
        high=request.high,
        gain_crossover=request.gain_crossover,
        phase_margin=request.phase_margin,
        highest=math.pi / request.period if inside else math.inf,
        rule=inside and request.filter_time is None,
    )


def _correction(request: Request) -> Callable[[NDArray[np.float64]], NDArray[np.complex128]] | None:
    if request.inner_kind != "sampled":
        return None
    settings = MotorLoop(request.inner_pole, request.delay_samples, "sampled", request.placement)
    return settings.correction(request.motor, request.period)


def admissible(request: Request) -> tuple[Solution, int]:
    """Return the solution that Theorem 1 admits and n, or refuse with the nearest request."""
    found = attempt(request)
    return found if found is not None else refuse(request, attempt, candidates)


def attempt(request: Request) -> tuple[Solution, int] | None:
    """The admissible solution of a request and its n, None where there is none."""
    for order in (request.filter_order,) if request.filter_order else (1, 2):
        for solution in solve(specification(request, order)):
            proper = request.filter_order is not None or order == 2 or solution.order < 1.0
            if not proper or solution.violated(request.model.order) is not None:
                continue
            if _achieved(request, solution, order) >= request.phase_margin * (1.0 - 1e-9):
                return solution, order
    return None


def _achieved(request: Request, solution: Solution, order: int) -> float:
    """The worst phase margin over every payload and every crossing: (55) looks at one of each only."""
    given = specification(request, order)
    loop = replace(given.bare, gain=solution.gain, order=solution.order, filter_time=solution.filter_time)
    return worst(loop, request.low, request.high, given.highest)[1][0]


def candidates(request: Request) -> tuple[Solution, ...]:
    """Every solution of the two equations, admissible or not: what a refusal is explained from."""
    return tuple(solve(specification(request, request.filter_order or 1)))


def _controller(request: Request, rig: Rig, solution: Solution, order: int) -> Controller:
    time = solution.filter_time
    if request.margins == "ideal":
        time = (
            request.filter_time
            if request.filter_time is not None
            else _ideal_filter(request, solution, order)
        )
    nominal = link_at(request.model, rig, rig.payloads.nominal)
    return Controller(
        gain=solution.gain,
        order=solution.order,
        filter_time=time,
        filter_order=order,
        link=nominal,
        inner=MotorLoop(request.inner_pole, request.delay_samples, request.inner_kind, request.placement),
        period=request.period,
    )


def _ideal_filter(request: Request, solution: Solution, order: int) -> float:
    loop = replace(specification(request, order).bare, gain=solution.gain, order=solution.order)
    return filter_by_rule(loop, request.high, solution.upper, request.phase_margin, order)
