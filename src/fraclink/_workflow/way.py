"""From a log to simulated moves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from fraclink._workflow.nouns import Move, Study
from fraclink._workflow.request import Request, design_for
from fraclink.errors import FieldError, InfeasibleError

if TYPE_CHECKING:
    from fraclink._arm.experiment import Experiment
    from fraclink._arm.link import LinkModel
    from fraclink._arm.rig import Rig
    from fraclink._design import Design
    from fraclink._law import Law
    from fraclink._simulate import Run

__all__ = ["conduct", "simulate_move"]


def _silent(part: str) -> None:
    """Progress that nobody watches."""


def conduct(
    rig: Rig,
    experiment: Experiment,
    request: Request | None = None,
    *,
    structure: str = "UD-FOM",
    move: Move | None = None,
    certify: bool = False,
    begin: Callable[[str], None] = _silent,
) -> Study:
    """Examine a log, fit the four structures, design for the payloads and simulate a move at several.

    Moves are made at both ends of the range designed for, and at the nominal payload where it lies within.

    Arguments:
        rig: the rig that made the log.
        experiment: the log.
        request: what the design is asked for; the rig, then the default rule, complete it.
        structure: the model that the design uses, "UD-IOM", "D-IOM", "UD-FOM" or "D-FOM".
        move: the move to simulate; default 1 rad in 0.5 s.
        certify: whether a proof is asked for; without one the study does not hold.
        begin: called with the name of each part as it begins.

    An infeasible request is not an error here: the study says why in `infeasible` and does not hold.
    Raises FieldError for a structure that is not known or a value out of its range.

    >>> from fraclink._arm.rig import Rig
    >>> from fraclink._logs import bundled_log, read_log
    >>> rig = Rig.named("paper-2023")
    >>> log = read_log(bundled_log("prbs_30g"), rig=rig)
    >>> study = conduct(rig, log, Request(payloads=(0.020, 0.045)))
    >>> study.passed, [f"{1e3 * run.payload:g} g" for run in study.runs]
    (True, ['20 g', '30 g', '45 g'])
    """
    from fraclink._arm.rig import Rig
    from fraclink._identify import identify_all
    from fraclink._logs import diagnose
    from fraclink._validate import checked_noun

    checked_noun("rig", rig, Rig, remedy="Rig.named or Rig.load make one")
    if request is not None:
        checked_noun("request", request, Request, remedy="Request(gain_crossover=12.0)")
    if move is not None:
        checked_noun("move", move, Move, remedy="Move(amplitude=1.0)")
    begin("examining the log")
    findings = (*rig.warnings, *diagnose(experiment, rig))
    begin("identifying")
    # A deflection log cannot show the stiffness; a torque log measures it.
    known = rig.link.stiffness if experiment.output_kind == "deflection" else None
    comparison = identify_all(experiment, stiffness=known)
    if structure not in comparison.fits:
        raise FieldError(
            "structure",
            structure,
            "unknown",
            allowed=", ".join(comparison.fits),
            remedy="choose one of these",
        )
    fit = comparison.fits[structure]
    model, assumed = _with_payload(fit.model, rig)
    begin("designing")
    found = Study(
        rig=rig,
        experiment=experiment,
        findings=findings,
        comparison=comparison,
        fit=fit,
        assumptions=(*rig.assumptions, *assumed),
    )
    try:
        design, more = design_for(rig, model, request or Request())
    except InfeasibleError as error:
        return replace(found, infeasible=str(error))
    begin("simulating")
    design = design.with_law()
    law = design.law()
    if certify:
        begin("proving")
        found = _certified(found, design, law)
    runs = tuple(simulate_move(design, move or Move(), payload, law=law) for payload in _moved(design))
    return replace(found, design=design, law=law, runs=runs, assumptions=(*found.assumptions, *more))


def _moved(design: Design) -> tuple[float, ...]:
    """The payloads to move [kg]: both ends of the range designed for, and the nominal one within it."""
    low, high = design.payloads
    nominal = design.rig.payloads.nominal
    return tuple(sorted({low, high} | ({nominal} if low < nominal < high else set())))


def _certified(study: Study, design: Design, law: Law) -> Study:
    from fraclink._certify import certify

    certificate = certify(design, law=law)
    if certificate.passed:
        return replace(study, certificate=certificate)
    return replace(study, uncertified=certificate.verdict.removeprefix("Not certified: "))


def _with_payload(model: LinkModel, rig: Rig) -> tuple[LinkModel, tuple[str, ...]]:
    """The model with the payload it holds for: ω₀ can be carried to other payloads from there only."""
    if model.payload is not None:
        return model, ()
    nominal = rig.payloads.nominal
    return replace(model, payload=nominal), (
        f"the log was made with the nominal payload, {1e3 * nominal:g} g, as nobody stated it",
    )


def simulate_move(design: Design, move: Move, payload: float, *, law: Law | None = None) -> Run:
    """Simulate one move of the tip with the design's law at `payload` [kg].

    `law` is the design's own where it is left out; making it takes a second.

    >>> from fraclink._arm.rig import Rig
    >>> from fraclink._workflow.request import Request, design_for
    >>> design, _ = design_for(Rig.named("paper-2023"), None, Request(filter_time=0.0))
    >>> simulate_move(design, Move(amplitude=0.2), 0.020).payload
    0.02
    """
    from fraclink._arm.reference import smooth_step
    from fraclink._design import Design
    from fraclink._simulate import simulate
    from fraclink._validate import checked_noun

    checked_noun("plan", design, Design, remedy="design(...) makes one")
    checked_noun("move", move, Move, remedy="Move(amplitude=1.0)")
    return simulate(
        law if law is not None else design.law(),
        smooth_step(move.amplitude, duration=move.move_time),
        rig=design.rig,
        model=design.model,
        payload=payload,
        duration=move.duration,
        motor_loop=move.inner,
        gauge_offset=move.gauge_offset,
        noise=move.noise,
        seed=move.seed,
    )
