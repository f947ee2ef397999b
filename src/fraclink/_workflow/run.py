"""From a log to a verdict: examine, identify, design, discretize, simulate, and try a thousand arms."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

from fraclink._arm.doubts import doubts_of
from fraclink._arm.experiment import Experiment
from fraclink._arm.link import STRUCTURES, LinkModel
from fraclink._arm.reference import Reference, smooth_step
from fraclink._arm.rig import Rig
from fraclink._campaign import Campaign, run_campaign, summarise
from fraclink._certify import certify
from fraclink._design import Design
from fraclink._identify import compare_structures
from fraclink._law import Law
from fraclink._logs import diagnose
from fraclink._simulate import Run, simulate
from fraclink._validate import Between, Seed, checked
from fraclink._workflow.defaults import design_for
from fraclink._workflow.study import Study, save_study
from fraclink.errors import FieldError, FraclinkError, InfeasibleError

__all__ = ["run", "simulate_move"]

# Each of a thousand arms draws payload, stiffness, order, motor, friction, delay, offset and noise anew: half
# a second of work, and a share of failures of 0.3 % is seen with 95 % certainty.
_ARMS = 1000


@checked
def run(
    rig: Rig,
    log: Experiment,
    *,
    structure: str | None = None,
    certified: bool = False,
    arms: Annotated[int, Between(0, 10**6)] = _ARMS,
    seed: Seed = 0,
    out: Path | str | None = None,
    begin: Callable[[str], None] = lambda part: None,
    **wanted: Any,
) -> Study:
    """Examine a log, fit the four structures, design, and try the law on the model and on arms that differ.

    Moves are simulated at both ends of the payload range, and at the nominal payload where it lies within.

    Parameters
    ----------
    rig, log
        the rig and what it recorded.
    structure
        the model that the design uses; the one that the log supports where it is left out.
    certified
        whether a proof is asked for.
    arms
        how many arms that differ from the model are tried; 0 leaves them out.
    out
        folder to write the study to, with the arms below it.
    begin
        called with the name of each step as it begins.
    wanted
        what `design` is asked for, such as ``gain_crossover`` [rad/s]; the rig completes it.

    A step that fails ends the study and is named in its verdict; what was computed before it is kept.
    Raises FieldError where an argument is out of its range.

    >>> from fraclink._logs import bundled_log, read_log
    >>> rig = Rig.named("paper-2023-geared")
    >>> log = read_log(bundled_log("prbs_30g"), rig=rig)
    >>> study = run(rig, log, payloads=(0.020, 0.040), arms=0)
    >>> [f"{1e3 * move.payload:g} g" for move in study.runs], study.verdict.model.state, study.verdict.state
    (['20 g', '30 g', '40 g'], 'passed', 'not run')
    """
    if structure is not None and structure not in STRUCTURES:
        allowed = ", ".join(STRUCTURES)
        raise FieldError("structure", structure, "unknown", allowed=allowed, remedy="choose one of these")
    begin("examining the log")
    study = Study(rig, log, (*rig.warnings, *diagnose(log, rig)), assumptions=rig.assumptions)

    def identify(study: Study) -> Study:
        # A deflection log cannot show the stiffness; a torque log measures it.
        known = rig.link.stiffness if log.output_kind == "deflection" else None
        comparison = compare_structures(log, stiffness=known)
        chosen = structure or comparison.preferred
        fit = comparison.fits[chosen]
        contradictions = doubts_of(rig, fit.model)
        findings = tuple(dict.fromkeys((*study.findings, *contradictions)))
        return replace(study, comparison=comparison, fit=fit, findings=findings)

    def controller(study: Study) -> Study:
        assert study.fit is not None  # noqa: S101
        model, assumed = _with_payload(study.fit.model, rig)
        made, more = design_for(rig, model, **wanted)
        made = made.doubted(study.fit.findings).with_law()
        assumptions = (*study.assumptions, *assumed, *more)
        return replace(study, design=made, law=made.law(), assumptions=assumptions)

    def moves(study: Study) -> Study:
        assert study.design is not None  # noqa: S101
        payloads = _moved(study.design)
        return replace(study, runs=tuple(simulate_move(study.design, m, law=study.law) for m in payloads))

    def proof(study: Study) -> Study:
        assert study.design is not None  # noqa: S101
        found = certify(study.design, law=study.law)
        if found.passed:
            return replace(study, certificate=found)
        return replace(study, uncertified=found.verdict.removeprefix("Not certified: "))

    def fleet(study: Study) -> Study:
        assert study.design is not None  # noqa: S101
        assert study.law is not None  # noqa: S101
        campaign = Campaign.of(rig, study.design.model, study.law, runs=arms, seed=seed)
        with tempfile.TemporaryDirectory() as scratch:
            folder = Path(scratch) if out is None else Path(out) / "arms"
            run_campaign(campaign, folder)
            return replace(study, arms=summarise(campaign, folder))

    steps = {"identifying": identify, "designing": controller, "simulating": moves}
    steps |= {"proving": proof} if certified else {}
    steps |= {f"trying {arms} arms": fleet} if arms else {}
    for name, step in steps.items():
        begin(name)
        try:
            study = step(study)
        except FraclinkError as error:
            # A value that the caller gave is bad input; everything else is an answer.
            if isinstance(error, FieldError) and error.field.partition(".")[0].partition("[")[0] in wanted:
                raise
            why = str(error) if isinstance(error, InfeasibleError) else f"{name} failed: {error}"
            study = replace(study, uncertified=why) if name == "proving" else replace(study, stopped=why)
            if study.design is None:
                break
    if out is not None:
        save_study(study, out)
    return study


def _moved(made: Design) -> tuple[float, ...]:
    """The payloads to move [kg]: both ends of the range designed for, and the nominal one within it."""
    low, high = made.payloads
    nominal = made.rig.payloads.nominal
    return tuple(sorted({low, high} | ({nominal} if low < nominal < high else set())))


def _with_payload(model: LinkModel, rig: Rig) -> tuple[LinkModel, tuple[str, ...]]:
    """The model with the payload of its log: ω₀ can be carried to other payloads from there only."""
    if model.payload is not None:
        return model, ()
    nominal = rig.payloads.nominal
    return replace(model, payload=nominal), (
        f"the log was made with the nominal payload, {1e3 * nominal:g} g, as none was stated",
    )


@checked
def simulate_move(
    made: Design,
    payload: float,
    *,
    law: Law | None = None,
    reference: Reference | None = None,
    amplitude: float = 1.0,
    move_time: float = 0.5,
    duration: float = 4.0,
    inner: Literal["ideal", "sampled"] = "sampled",
    **options: Any,
) -> Run:
    """Simulate a move of the tip at `payload` [kg]: `amplitude` [rad] in `move_time` [s], or `reference`.

    `law` is the design's own where it is left out; making it takes a second. `options` are those of
    `simulate`, such as ``gauge_offset`` [N·m], ``noise`` [N·m] and ``seed``.

    >>> made, _ = design_for(Rig.named("paper-2023"), filter_time=0.0)
    >>> simulate_move(made, 0.020, amplitude=0.2).payload
    0.02
    """
    return simulate(
        law if law is not None else made.law(),
        smooth_step(amplitude, duration=move_time) if reference is None else reference,
        rig=made.rig,
        model=made.model,
        payload=payload,
        duration=duration,
        motor_loop=inner,
        **options,
    )
