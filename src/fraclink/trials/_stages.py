"""From a log to a verdict: diagnosis, identification, design, discretisation,
simulation, and a thousand different arms.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from fraclink._arm.draft import doubts_of
from fraclink._arm.experiment import Experiment
from fraclink._arm.link import STRUCTURES, LinkModel
from fraclink._arm.reference import smooth_step
from fraclink._arm.rig import Rig
from fraclink._certify import certify
from fraclink._design.completed import design_for
from fraclink._identify import compare_structures
from fraclink._identify.fitting import HeldOut
from fraclink._simulate.arm import Twin
from fraclink._simulate.simulate import simulate
from fraclink.errors import FieldError, FraclinkError, InfeasibleError
from fraclink.logs import diagnose
from fraclink.trials._campaign import PART_RUNS, Campaign
from fraclink.trials._run import run_campaign
from fraclink.trials._study import Refusal, Study, save_study
from fracsys.checks import Between, Seed, checked, checked_choice

__all__ = [
    "designed",
    "examined",
    "identified",
    "moved",
    "proved",
    "run",
    "subject",
    "tried",
]

_MOVE, _WATCHED = smooth_step(1.0, duration=0.5), 4.0


@checked
def run(
    rig: Rig,
    log: Experiment,
    *,
    structure: str | None = None,
    heldout: HeldOut | None = None,
    certified: bool = False,
    # One part of a campaign detects a failure rate of 0.3 % with 95 % certainty.
    arms: Annotated[int, Between(0, 10**6)] = PART_RUNS,
    seed: Seed = 0,
    out: Path | str | None = None,
    begin: Callable[[str], None] = lambda part: None,
    **wanted: Any,
) -> Study:
    """Examine a log, fit the four structures, design, and try the law on the model and
    on varied arms.

    Moves are simulated at both ends of the payload range, and at the nominal payload
    where it lies within.

    Parameters
    ----------
    rig, log
        the rig and what it recorded.
    structure
        the model that the design uses; the one that the log supports where it is left
        out.
    heldout
        share of the samples at the end that no fit sees, as in `identify`.
    certified
        whether a proof is asked for.
    arms
        varied arms to try; 0 leaves them out.
    seed
        from which they are drawn.
    out
        folder to write the study to.
    begin
        called with the name of each step as it begins.
    wanted
        what `design` is asked for, such as ``gain_crossover`` [rad/s]; the rig
        completes it.

    A step that fails is named in the verdict, and those that need its result are left
    out; all other results are kept. Raises FieldError where an argument is out of its
    range.

    >>> from fraclink._reading.reading import bundled_log, read_log
    >>> rig = Rig.named("paper-2023-geared")
    >>> log = read_log(bundled_log("prbs_30g"), rig=rig)
    >>> study = run(rig, log, payloads=(0.020, 0.040), arms=0)
    >>> [f"{1e3 * move.payload:g} g" for move in study.runs], study.verdict.model.state, study.verdict.state
    (['20 g', '30 g', '40 g'], 'passed', 'not run')
    """
    if structure is not None:
        checked_choice("structure", structure, STRUCTURES)
    begin("examining the log")
    study = examined(rig, log)
    # Each with the part of the study that is missing if it fails: a part that could not
    # be run is "not run", and misses no requirement.
    steps: list[tuple[str, str, Callable[[Study], Study]]] = [
        ("identifying", "design", lambda study: identified(study, structure, heldout)),
        ("designing", "design", lambda study: designed(study, **wanted)),
        ("simulating", "design", moved),
        *([("proving", "certificate", proved)] if certified else []),
    ]
    if arms:
        trying = f"trying {arms} arms"
        steps.append((trying, "arms", lambda study: tried(study, arms, seed)))
    for name, part, step in steps:
        begin(name)
        try:
            study = step(study)
        except FraclinkError as error:
            # An error in a value given by the caller is bad input; any other error is a
            # result.
            if (
                isinstance(error, FieldError)
                and error.field.partition(".")[0].partition("[")[0] in wanted
            ):
                raise
            # The nearest request goes into `refused`, worded by each interface.
            why = (
                f"{error.condition}: {error.explanation}"
                if isinstance(error, InfeasibleError)
                else f"{name} failed: {error}"
            )
            study = replace(study, missing={**study.missing, part: why})
            if isinstance(error, InfeasibleError) and error.nearest:
                asked = {k: value for k, value in wanted.items() if value is not None}
                study = replace(study, refused=Refusal(asked, error.nearest))
        # Without a fit there is no design, and without a law nothing to run.
        if (study.fit if name == "identifying" else study.law) is None:
            break
    if out is not None:
        save_study(study, out)
    return study


# --- the steps, each from one study to the next -----------------------------------------------------------


def examined(rig: Rig, log: Experiment) -> Study:
    """Return the study of a log with the findings of its diagnosis."""
    return Study(
        rig, log, (*rig.warnings, *diagnose(log, rig)), assumptions=rig.assumptions
    )


def identified(
    study: Study, structure: str | None = None, heldout: float | None = None
) -> Study:
    """Return the study with all four structures fitted.

    `structure` is used, or the one that the log supports; `heldout` is the share of
    samples at the end that the fits do not use, as in `identify`.
    """
    assert study.rig is not None and study.experiment is not None  # noqa: S101
    rig, log = study.rig, study.experiment
    # A deflection log does not determine the stiffness; a torque log does.
    stiffness = rig.link.stiffness if log.output_kind == "deflection" else None
    comparison = compare_structures(log, stiffness=stiffness, heldout=heldout)
    fit = comparison.fits[structure or comparison.preferred]
    contradictions = doubts_of(rig, fit.model)
    findings = tuple(dict.fromkeys((*study.findings, *contradictions)))
    return replace(study, comparison=comparison, fit=fit, findings=findings)


def subject(study: Study) -> tuple[Rig, LinkModel, tuple[str, ...]]:
    """Return the subject of a design of the study: rig, link, and the assumptions about
    it.

    Raises FieldError where the study has neither a fit nor a rig with a model.
    """
    rig = study.rig
    if study.fit is not None:
        # Not `fit.model`: from a log that does not determine the stiffness its c is
        # arbitrary, and a law divides by it.
        link: LinkModel | None = study.fit.loop_model(rig) if rig else study.fit.model
    else:
        link = study.design.model if study.design else rig.model if rig else None
    if rig is None or link is None:
        raise FieldError(
            "model",
            None,
            "missing",
            "a rig with its model",
            "identify a log first, or open a rig that states a model",
        )
    if study.fit is None or link.payload is not None:
        return rig, link, ()
    # Without a payload, ω₀ would hold for the payload of the log only, and a design
    # over a range would be impossible. The assumption is recorded, because a wrong
    # payload shifts every frequency by its square root.
    nominal = rig.payloads.nominal
    assumption = f"the log was made with the nominal payload, {1e3 * nominal:g} g, as none was stated"
    return rig, replace(link, payload=nominal), (assumption,)


def designed(study: Study, **wanted: Any) -> Study:
    """Return the study with a design and its law; `wanted` as in `design_for`.

    The law is None if no law represents the controller, which is a finding of the
    design.
    """
    rig, model, first = subject(study)
    design, more = design_for(rig, model, **wanted)
    design = design.doubted(study.fit.findings if study.fit else ())
    assumptions = (*study.assumptions, *first, *more)
    return replace(
        study,
        design=design,
        law=design.law() if design.has_law else None,
        assumptions=assumptions,
    )


def moved(study: Study) -> Study:
    """Return the study with moves of the model and of the twin: at both ends of the
    payload range and at the nominal payload; the twin's law runs without and with its
    payload given.
    """
    assert study.design is not None  # noqa: S101
    design, law = study.design, study.law or study.design.law()
    low, high = design.payloads
    # The margin is smallest at one of the ends, and people look at the nominal payload.
    payloads = sorted({low, min(max(design.rig.payloads.nominal, low), high), high})
    missing = {name: why for name, why in study.missing.items() if name != "twins"}
    try:
        arms = [
            Twin.from_rig(design.rig, model=design.model, payload=m) for m in payloads
        ]
    except FieldError as error:
        # A model that contradicts its rig has no twin; its own moves are shown.
        arms, missing["twins"] = [], f"no twin: {error}"
    return replace(
        study,
        missing=missing,
        runs=tuple(
            simulate(
                law,
                _MOVE,
                rig=design.rig,
                model=design.model,
                payload=m,
                duration=_WATCHED,
            )
            for m in payloads
        ),
        twins=tuple(
            simulate(
                law,
                _MOVE,
                arm=arm,
                told=told,
                duration=_WATCHED,
            )
            for arm in arms
            for told in (False, True)
        ),
    )


def proved(study: Study) -> Study:
    """Return the study with its certificate, or with the reason why there is none."""
    assert study.design is not None  # noqa: S101
    certificate = certify(study.design, law=study.law)
    missing = {
        name: why for name, why in study.missing.items() if name != "certificate"
    }
    if not certificate.passed:
        missing["certificate"] = certificate.verdict.removeprefix("Not certified: ")
    proof = certificate if certificate.passed else None
    return replace(study, certificate=proof, missing=missing)


def tried(study: Study, arms: int, seed: int = 0) -> Study:
    """Return the study with `arms` runs of varied arms."""
    assert study.rig is not None and study.design is not None and study.law is not None  # noqa: S101
    # The model of the design, which differs from that of the fit if the log stated no
    # payload.
    campaign = Campaign.of(
        study.rig, study.design.model, study.law, runs=arms, seed=seed
    )
    return replace(study, arms=run_campaign(campaign))
