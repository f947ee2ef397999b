"""`design`: from a specification to a design, or to the reason why there is none."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.box import ParameterBox, arms_of, in_loop
from fraclink._arm.controller import Controller
from fraclink._arm.draft import doubts_of
from fraclink._arm.link import LinkModel
from fraclink._arm.loop import Loop, with_payload, worst_margins
from fraclink._arm.rig import Rig
from fraclink._design.bounds import bound_requirements, reach
from fraclink._design.equations import MARGIN_SHARE, Task, attempt, candidates, task_of
from fraclink._design.modes import MODE_LIMIT, higher_modes, mode_requirements, ringing
from fraclink._design.nearest import missed_bounds, offered, refuse
from fraclink._design.over_box import OverBox, at_arm, cost_of_box
from fraclink._law.design import Design, Requirement, Specification
from fraclink.errors import FieldError, InfeasibleError
from fraclink.findings import Finding
from fracsys.checks import checked_between, checked_noun

if TYPE_CHECKING:
    from fraclink._identify import Fit

__all__ = ["design", "findings_of", "requirements_of"]

Real = NDArray[np.float64]


def design(
    model: LinkModel | Fit,
    rig: Rig,
    *,
    payloads: tuple[float, float] | None = None,
    natural_frequencies: tuple[float, float] | None = None,
    gain_crossover: float | None = None,
    phase_margin: float | None = None,
    margins: Literal["loop", "ideal"] = "loop",
    filter_time: float | None = None,
    filter_order: int | None = None,
    inner: Literal["ideal", "sampled"] = "ideal",
    placement: Literal["tustin", "direct"] = "tustin",
    max_sensitivity: float | None = None,
    noise_gain: float | None = None,
    settling_time: float | None = None,
    mode_gain: float | None = None,
    box: ParameterBox | bool | None = None,
    law: bool = True,
    nearest: bool = True,
) -> Design:
    """Design ``C(s) = 1 + k_d s^β/(1 + δs)^n`` for every payload of a range (section 6,
    eqs. (54)–(57)).

    The gain crossover is met at the heaviest payload and the phase margin at the
    lightest; both are smallest there (Theorem 1), and the design reports the worst
    value found over the whole range. The gauge's delay, its gain and the second mode,
    where the model knows them, stand inside the equations.

    The result has the controller, the requirements with what is achieved, and findings.
    It does not pass where the fit failed a gate, where model or payloads contradict the
    rig (W105 to W107), or where a vibration takes more than ten of its periods to fall
    to 2 % (W409), on the model or on an arm of the box.

    Parameters
    ----------
    model
        the link, or the fit that found it; its ``order``, ``damping`` and, where
        ``payload`` is known, its own ω₀ are used, and everything that was identified of
        the gauge.
    rig
        motor loop, sampling period, payloads and stiffness.
    payloads
        (lightest, heaviest) [kg], > 0; the rig's own when neither range is given.
    natural_frequencies
        (low, high) ω₀ [s^(-λ/2)] instead of payloads.
    gain_crossover
        smallest ω_c [rad/s], > 0 and right of the peak of |L|; from `settling_time`
        when left out.
    phase_margin
        smallest φ_m [rad], 0 < φ_m < π; ``deg(50)`` for 50 degrees; from
        `max_sensitivity` when left out.
    margins
        "loop": filter, M(s), half a sample of hold and the computation delay stand
        inside (55). "ideal": the paper's reading, Ĉ·G alone.
    filter_time
        δ [s] >= 0; zero for none; chosen so that it costs 10 % of the margin when left
        out.
    filter_order
        n, 1 or 2; 1 for β < 1 and 2 otherwise when left out.
    inner
        "ideal" (M(s) of eq. (21)) or "sampled" (the PID at the control period, on the
        motor).
    placement
        for the sampled motor loop: "tustin" discretises (19), (20); "direct" places its
        poles in z.
    max_sensitivity
        bound on Ms = max 1/|1 + L|, > 1.
    noise_gain
        bound on the motor reference's RMS for white gauge noise of RMS one, > 0; more
        filter where needed.
    settling_time
        bound on 2π/ω_c [s], > 0.
    mode_gain
        bound on the loop gain at the higher modes of the link, > 0; more filter where
        needed, paid for with a larger β. Below one no phase of the mode can destabilise
        it. Where the model knows a second mode or the rig the link's mass, the bound is
        0.5 unless another is given.
    box
        arms that must keep every requirement: a `ParameterBox`; True for
        ``ParameterBox.of(model, rig)``, the fit's intervals and at least the rig's
        ``[tolerances]``; None or False for the model alone. Finding W407 says what it
        costs, and of which parameter. The design remembers it, and `certify` proves it.
    law
        whether to fit the law that ships, too, and say where it keeps less than the
        design in the sampled loop (W404, W408). The fit takes most of the time; without
        it nothing is said of the law.
    nearest
        False: a refusal does not search for the nearest request that is feasible, which
        takes seconds.

    Raises
    ------
    FieldError
        a value is out of its range.
    InfeasibleError
        no controller of this form meets the request; names the condition and the
        nearest feasible request.

    Examples
    --------
    >>> from fraclink._design import deg, design
    >>> from fraclink._arm.rig import Rig
    >>> rig = Rig.named("paper-2023")
    >>> wanted = {"gain_crossover": 12.0, "phase_margin": deg(50), "filter_time": 0.0}
    >>> found = design(rig.model, rig, payloads=(0.020, 0.040), **wanted)
    >>> round(found.controller.gain, 6), round(found.controller.order, 6), found.passed
    (0.069876, 0.612197, True)
    """
    link = _link_of(model, rig)
    spec = Specification(
        payloads=payloads,
        natural_frequencies=natural_frequencies,
        gain_crossover=gain_crossover,
        phase_margin=phase_margin,
        margins=margins,
        filter_time=filter_time,
        filter_order=filter_order,
        inner=inner,
        placement=placement,
        max_sensitivity=max_sensitivity,
        noise_gain=noise_gain,
        settling_time=settling_time,
        mode_gain=mode_gain,
    )
    try:
        made = (
            _designed_over(link, rig, spec, box, nearest)
            if box
            else _designed(link, rig, spec, nearest)
        )
    except InfeasibleError as error:
        offer = error.nearest  # of a box it was found as a whole
        if nearest and not box:
            offer = offered(offer, spec, lambda trial: _misses(link, rig, trial))
        explanation = error.explanation
        if error.nearest and not offer:
            explanation += "; but no request near that passes: it misses a bound, or its moves ring"
        # A payload in grams or the model of another arm is refused for reasons that
        # hide the cause.
        doubts = "; ".join(
            finding.message for finding in doubts_of(rig, link, payloads or ())
        )
        explanation += f"; but {doubts}" if doubts else ""
        raise InfeasibleError(error.condition, explanation, offer) from error
    made = made.doubted(getattr(model, "findings", ()))
    return made.warned_of_law() if law else made


def _bounded(spec: Specification, link: LinkModel, rig: Rig) -> Specification:
    """The specification with the usual bound on the gain at higher modes, where it
    states none.

    They are known from the log, or from the mass that the rig states: a log shows a
    second mode only where its share is large, its damping small and the motion fast.
    """
    known = link.second_mode is not None or rig.link.mass > 0.0
    if spec.mode_gain is None and known and spec.margins == "loop":
        return replace(spec, mode_gain=MODE_LIMIT)
    return spec


def _misses(link: LinkModel, rig: Rig, spec: Specification) -> dict[str, float] | None:
    """The bounds that a specification misses, with what is achieved; None where it
    meets all of them.
    """
    spec = _bounded(spec, link, rig)
    try:
        task = task_of(link, rig, spec)
        task = reach(task, spec, attempt) if spec.bounded else task
    except FieldError:
        return {}
    except InfeasibleError as error:
        return error.nearest
    found = attempt(task)
    if found is None:
        return {}
    controller = task.controller(*found)
    requirements = requirements_of(task, controller, spec)
    if not all(item.passed for item in requirements):
        return missed_bounds(requirements)
    # A design that rings does not pass either, and no bound says by how much it would
    # have to change.
    return {} if _ringing(task, controller) else None


def _designed(
    link: LinkModel, rig: Rig, spec: Specification, nearest: bool = True
) -> Design:
    """The design of a specification; InfeasibleError where there is none, with one that
    there is.
    """
    asked, given = task_of(link, rig, spec), spec.mode_gain is not None
    spec = _bounded(spec, link, rig)
    task = reach(asked, spec, attempt) if spec.bounded else asked
    found = attempt(task)
    if found is None:
        fastest = min(rig.motor_loop.pole, math.pi / rig.period)
        refuse(task, attempt, candidates(task), fastest, nearest=nearest)
    solution, order = found
    controller = task.controller(solution, order)
    requirements = requirements_of(task, controller, spec)
    findings = findings_of(asked, controller, solution.upper, mode_bounded=given)
    if spec.mode_gain is not None and not given:
        findings += _cost_of_mode(asked, task, controller)
    return Design(
        model=link,
        rig=rig,
        controller=controller,
        requirements=requirements,
        margins_kind=task.margins,
        payloads=task.payloads,
        natural_frequencies=(task.low, task.high),
        gain_crossover=task.gain_crossover,
        phase_margin=task.phase_margin,
        chi=solution.chi,
        gain_crossover_upper=solution.upper,
        findings=findings,
    )


def _designed_over(
    link: LinkModel,
    rig: Rig,
    spec: Specification,
    box: ParameterBox | bool,
    nearest: bool,
) -> Design:
    """The design that keeps a specification at every arm of a box."""
    if spec.margins == "ideal":
        problem, allowed = (
            "given for the paper's loop, which has no gauge and no motor",
            'margins="loop"',
        )
        raise FieldError(
            "box", "given", problem, allowed=allowed, remedy="leave one of the two out"
        )
    known = with_payload(link, rig)
    arms = (
        ParameterBox.of(known, rig)
        if box is True
        else checked_noun("box", box, ParameterBox, remedy=_BOX)
    )
    spec = _bounded(spec, link, rig)

    def solve(aim: Specification) -> tuple[Task, Controller] | None:
        try:
            task = task_of(link, rig, aim)
            task = reach(task, aim, attempt) if aim.bounded else task
        except InfeasibleError:
            return None
        found = attempt(task)
        return None if found is None else (task, task.controller(*found))

    asked = task_of(link, rig, spec)
    aim, requirements = OverBox(spec, arms, asked, solve, requirements_of).aimed(
        nearest=nearest
    )
    # Once more for what was aimed at, and not the last trial: findings of the filter
    # and of the mode are those of the controller that is returned.
    made = _designed(link, rig, aim)
    if all(finding.code != "W409" for finding in made.findings):
        made = replace(
            made,
            findings=(*made.findings, *_ringing_over(asked, made.controller, arms)),
        )
    return replace(
        made,
        requirements=requirements,
        gain_crossover=asked.gain_crossover,
        phase_margin=asked.phase_margin,
        findings=(*made.findings, cost_of_box(asked, made.controller, arms)),
        box=arms,
    )


_BOX = "ParameterBox.of(model, rig), or True for it"


def _link_of(model: LinkModel | Fit, rig: Rig) -> LinkModel:
    """The link of a model or a fit, with the gauge that the control loop has."""
    checked_noun("rig", rig, Rig, remedy="Rig.named or Rig.load make one")
    # A fit knows what it could not show; anything else that carries a model is taken at
    # its word.
    found = (
        model.loop_model(rig)
        if hasattr(model, "loop_model")
        else getattr(model, "model", model)
    )
    link = checked_noun(
        "model", found, LinkModel, remedy="give a fit, fit.model, or rig.model"
    )
    checked_between(
        "order",
        link.order,
        1.0,
        2.0,
        "(λ)",
        open_low=True,
        remedy="λ is 2 for a classical link",
    )
    return in_loop(link, rig)


def requirements_of(
    task: Task, controller: Controller, spec: Specification
) -> tuple[Requirement, ...]:
    """Return every requirement with its worst value over the payload range."""
    loop = task.loop(controller)
    (crossover, at_crossover), (margin, at_margin) = worst_margins(
        loop, task.low, task.high
    )
    where = task.model.payload_at
    return (
        Requirement.at_least(
            "gain crossover",
            task.gain_crossover,
            crossover,
            "rad/s",
            where(at_crossover),
        ),
        Requirement.at_least(
            "phase margin", task.phase_margin, margin, "rad", where(at_margin)
        ),
        *bound_requirements(task, controller, spec, crossover),
    )


def findings_of(
    task: Task, controller: Controller, upper: float, *, mode_bounded: bool
) -> tuple[Finding, ...]:
    """Findings of a design: what contradicts the rig, and what is less than it seems
    (W401 …).

    `task` is what was asked for, before any bound changed it; `upper` the crossover of
    the lightest payload [rad/s]; `mode_bounded` tells that the loop gain at the higher
    modes was asked for.
    """
    found = list(doubts_of(task.rig, task.model, task.payloads))
    # The lag at ω̄_c, where the phase margin is met: at ω_c the filter would look
    # cheaper than it is.
    cost = controller.filter_order * math.atan(controller.filter_time * upper)
    if task.filter_time is not None and cost > MARGIN_SHARE * task.phase_margin * (
        1.0 + 1e-2
    ):
        margin = task.phase_margin
        found.append(
            Finding(
                "W401",
                "warning",
                "the filter costs more than 10 % of the phase margin",
                {
                    "filter_time": controller.filter_time,
                    "cost_rad": cost,
                    "phase_margin_rad": margin,
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
    # At the heaviest payload: the bound (39) rises with ω₀, but the crossover is asked
    # for at ω_c only there.
    sufficient = Loop.ideal(task.model).sufficient(task.low)
    if task.gain_crossover <= sufficient:
        found.append(
            Finding(
                "W403",
                "info",
                "condition (39) does not hold; the exact condition of Theorem 1 does, and it is what counts",
                {"gain_crossover": task.gain_crossover, "condition_39": sufficient},
            )
        )
    return (
        *found,
        *_ringing(task, controller),
        *(() if mode_bounded else _spillover(task, controller)),
    )


def _ringing(task: Task, controller: Controller) -> tuple[Finding, ...]:
    """W409 where the moves of the loop ring; the paper's reading has no loop that runs."""
    if task.margins == "ideal":
        return ()
    ends = {task.model.payload_at(w0): w0 for w0 in (task.low, task.high)}
    return ringing(task.full_loop(controller), ends)


def _ringing_over(
    task: Task, controller: Controller, box: ParameterBox
) -> tuple[Finding, ...]:
    """W409 of the arm of a box whose moves ring longest, at either end of its payloads;
    3 ms each.
    """
    light, heavy = task.payloads
    found: list[Finding] = []
    for arm in arms_of(box, task.model):
        here = at_arm(task, box, arm)
        whose = f" of an arm of the box (λ = {arm.model.order:.4g}, gauge {arm.model.gauge_gain:.3g} times)"
        found += ringing(
            here.full_loop(controller), {heavy: here.low, light: here.high}, whose=whose
        )
    return tuple(sorted(found, key=lambda one: one.evidence["damping_ratio"])[:1])


def _spillover(task: Task, controller: Controller) -> tuple[Finding, ...]:
    """W405 where the loop reaches a higher mode."""
    loop = task.full_loop(controller)
    modes = higher_modes(task.model, task.rig, loop, task.payloads)
    if modes is None:
        return ()
    number, worst = max(
        mode_requirements(modes, loop, MODE_LIMIT), key=lambda pair: pair[1].achieved
    )
    if worst.passed:
        return ()
    return (
        Finding(
            "W405",
            "warning" if worst.achieved >= 1.0 else "info",
            f"the loop gain at mode {number} of the link is high: above 1, stability depends on the phase at "
            "a mode that is not modelled",
            {
                "loop_gain": worst.achieved,
                "limit": MODE_LIMIT,
                "payload_kg": worst.at_payload,
            },
            "ask for mode_gain=0.5 (--mode-gain 0.5), which lengthens the filter",
        ),
    )


def _cost_of_mode(
    asked: Task, task: Task, controller: Controller
) -> tuple[Finding, ...]:
    """W406 where the bound at the second mode changed the filter: from what, to what."""
    before = attempt(asked) if task != asked else None
    if before is None:
        return ()
    shorter = asked.controller(*before)
    loop = asked.full_loop(shorter)
    modes = higher_modes(asked.model, asked.rig, loop, asked.payloads)
    assert modes is not None  # the model knows its second mode  # noqa: S101
    gains = {
        number: item.achieved
        for number, item in mode_requirements(modes, loop, MODE_LIMIT)
    }
    return (
        Finding(
            "W406",
            "info",
            "the filter was lengthened so that the loop gain at the second mode stays below its limit",
            {
                "loop_gain_before": gains[2],
                "limit": MODE_LIMIT,
                "filter_time_before": shorter.filter_time,
                "filter_time": controller.filter_time,
                "order_before": shorter.order,
                "order": controller.order,
            },
            "a slower gain crossover or a smaller phase margin needs less filter",
        ),
    )
