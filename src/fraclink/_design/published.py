"""The procedure as it was published (section 6, (54)–(57)): crossover and margin met
with equality, for who asks for it.
"""

from __future__ import annotations

import math

from fraclink._arm.box import ParameterBox
from fraclink._arm.controller import Controller
from fraclink._arm.draft import doubts_of
from fraclink._arm.link import LinkModel
from fraclink._arm.loop import Loop, worst_margins
from fraclink._arm.rig import Rig
from fraclink._design.equations import (
    MARGIN_SHARE,
    Task,
    attempt,
    candidates,
    reason,
    task_of,
)
from fraclink._law.design import Design, Requirement, Specification
from fraclink._law.modes import MODE_LIMIT, higher_modes, mode_requirements, ringing
from fraclink._law.rows import row
from fraclink.errors import FieldError, InfeasibleError
from fraclink.findings import Finding
from fracsys.checks import checked_choice

__all__ = ["improper", "is_published", "published"]


def is_published(
    procedure: str, spec: Specification, box: ParameterBox | bool | None
) -> bool:
    """Whether the closed form is asked for; FieldError for what it does not know."""
    checked_choice(
        "procedure",
        procedure,
        ("solver", "published"),
        remedy="leave it out for a design that keeps every row",
    )
    if procedure != "published" and spec.margins == "loop":
        return False
    bounds = ("max_sensitivity", "noise_gain", "settling_time", "mode_gain")
    given = [name for name in bounds if getattr(spec, name) is not None]
    given += ["box"] if box else []
    if given:
        raise FieldError(
            given[0],
            "given",
            "unknown to the published procedure, which has crossover and margin alone",
            allowed="the solver, on the loop that runs",
            remedy='leave out procedure="published" and margins="ideal", or the bound',
        )
    return True


def published(link: LinkModel, rig: Rig, spec: Specification) -> Design:
    """The closed form of a specification, met with equality."""
    task = task_of(link, rig, spec)
    found = attempt(task)
    if found is None:
        raise InfeasibleError(*reason(task, candidates(task)), {})
    solution, order = found
    controller = task.controller(solution, order)
    return Design(
        model=link,
        rig=rig,
        controller=controller,
        requirements=_requirements(task, controller),
        margins_kind=task.margins,
        payloads=task.payloads,
        natural_frequencies=(task.low, task.high),
        gain_crossover=task.gain_crossover,
        phase_margin=task.phase_margin,
        chi=solution.chi,
        gain_crossover_upper=solution.upper,
        findings=_findings(task, controller, solution.upper),
    )


def _requirements(task: Task, controller: Controller) -> tuple[Requirement, ...]:
    """Return crossover and margin with their worst values over the payload range."""
    loop = task.loop(controller)
    (crossover, at_crossover), (margin, at_margin) = worst_margins(
        loop, task.low, task.high
    )
    where = task.model.payload_at
    return (
        row("gain_crossover").measured(
            task.gain_crossover, crossover, where(at_crossover)
        ),
        row("phase_margin").measured(task.phase_margin, margin, where(at_margin)),
    )


def _findings(task: Task, controller: Controller, upper: float) -> tuple[Finding, ...]:
    """Findings of a design: what contradicts the rig, and what is less than it seems
    (W401 …).

    `upper` is the crossover of the lightest payload [rad/s].
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
        found.append(improper(controller))
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
        *_spillover(task, controller),
    )


def _ringing(task: Task, controller: Controller) -> tuple[Finding, ...]:
    """W409 where the moves of the loop ring; the paper's reading has no loop that runs."""
    if task.margins == "ideal":
        return ()
    ends = {task.model.payload_at(w0): w0 for w0 in (task.low, task.high)}
    return ringing(task.full_loop(controller), ends)


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


def improper(controller: Controller) -> Finding:
    return Finding(
        "W402",
        "info",
        "Ĉ is not strictly proper (condition (32)): gauge noise is not filtered",
        {"order": controller.order, "filter_time": controller.filter_time},
        "the sampling bounds it; give filter_time, or leave it out to have it chosen",
    )
