"""Commands that make and run a design: run, design, simulate, certify, report."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from fraclink._arm.reference import Length
from fraclink._certify import certify as prove
from fraclink._cli.app import group
from fraclink._cli.command import Answer, Keywords, Writes, argument, command, option
from fraclink._cli.console import steps
from fraclink._cli.options import (
    LOG,
    REQUEST,
    Amplitude,
    BoxFlag,
    Columns,
    DesignFile,
    Estimate,
    NominalPayload,
    PhaseMarginDeg,
    ReferenceFile,
    RigName,
    doubts_of_move,
    in_radians,
    load_design,
    load_link_model,
    load_log,
    load_rig,
    reference_of,
    refuse_beside,
)
from fraclink._design import Design
from fraclink._design.completed import design_for
from fraclink._design.rows import ROWS
from fraclink._files import output_path
from fraclink._law.design import Specification
from fraclink._simulate import Twin
from fraclink._simulate import simulate as run_law
from fraclink.trials._stages import run as run_study
from fraclink.trials._study import load_study
from fraclink.view._arm_page import write_arm_page
from fraclink.view._report import write_report
from fraclink.view._text import options_text
from fracsys.checks import Between, Seed

app = group()

# Files of a study whose loss would matter: those that the user may have created before
# the first run, and the results of a run. The moves and the models of other structures
# (run-*.npz, model-*.json) can be derived from them and are replaced.
_STUDY = (
    "model.json",
    "design.json",
    "report.html",
    "rig.toml",
    "log.npz",
    "law.json",
    "certificate.json",
    "study.json",
)

ARMS = Keywords(run_study, "arms")


# Every requirement that a user may state; the crossover is in `REQUEST`, and the phase
# margin is stated in degrees.
BOUNDS = Keywords(
    Specification,
    *("filter_time", "filter_order"),
    *(
        row.key
        for row in ROWS
        if row.key in Specification.__annotations__
        and row.key not in ("gain_crossover", "phase_margin")
    ),
)


@command(app)
def run(
    rig: RigName,
    log: Annotated[str, "The log; `demo` is the bundled one"],
    out: Annotated[Path, "Folder to write to", Writes(_STUDY)] = Path("results"),
    certify: Annotated[bool, "Prove the design, too; takes a few seconds"] = False,
    column: Columns = None,
    phase_margin_deg: PhaseMarginDeg = None,
    box: BoxFlag = None,
    **options: Annotated[Any, LOG, REQUEST, BOUNDS, ARMS],
) -> Answer:
    """Take a log to a model, a controller, simulated moves and a report; the exit code
    is the verdict.

    $ fraclink run --rig paper-2023 --log demo --out results
    """
    arm = load_rig(rig)
    with steps(6 + certify) as begin:
        # Announced before it begins, so that a wait for a slow disk is visible.
        begin("reading the log")
        study = run_study(
            arm,
            load_log(log, arm, column, **LOG.of(options)),
            certified=certify,
            out=out,
            begin=begin,
            phase_margin=in_radians(phase_margin_deg),
            box=box,
            **REQUEST.of(options),
            **BOUNDS.of(options),
            **ARMS.of(options),
        )
        begin("writing the report")
        place = write_report(study, out / "report.html")
    following = (
        f"fraclink export c {out / 'design.json'} --out firmware" if study.law else ""
    )
    if study.refused:
        following = f"the same with {options_text(study.refused.nearest)}"
    # Failing arms come before the export: the first thing to look at is a worst case
    # that can be replayed.
    if study.arms and study.arms.summary.failed:
        following = (
            f"fraclink replay {out / 'arms.npz'} --run {study.arms.summary.failed[0]}"
        )
    return Answer(
        study,
        study.verdict.passed,
        values={"report": str(place), "out": str(out)},
        written=(place,),
        following=following,
    )


@command(app)
def design(
    rig: RigName,
    model: Annotated[
        Path | None,
        "Model of identify, or a design; default: the rig's or the design's own",
    ] = None,
    link_mass: Annotated[
        float | None, "Mass of the link [kg]; default: the rig's"
    ] = None,
    out: Annotated[Path, "File to write the design to", Writes()] = Path("design.json"),
    phase_margin_deg: PhaseMarginDeg = None,
    box: BoxFlag = None,
    **request: Annotated[Any, REQUEST, BOUNDS],
) -> Answer:
    """Design the outer controller for a payload range; every requirement is listed with
    what was achieved.

    $ fraclink design --rig rig.toml --model model.json
    """
    arm = load_rig(rig, link_mass=link_mass)
    link, doubts = load_link_model(model, arm)
    margin = in_radians(phase_margin_deg)
    result, assumptions = design_for(arm, link, phase_margin=margin, box=box, **request)
    # Doubts about the fit are passed on to the design: requirements met for a doubtful
    # model do not pass.
    result = result.doubted(doubts)
    assumed = tuple(f"assumed: {sentence}" for sentence in assumptions)
    # With the lightest payload, at which the phase margin is smallest.
    step = (
        f"simulate {out} --payload {result.payloads[0]:g}"
        if result.passed
        else f"assess {out}"
    )
    return Answer(
        result,
        result.passed,
        remarks=assumed,
        saved={out: result},
        following=f"fraclink {step}",
    )


@command(app)
def simulate(
    design_file: DesignFile,
    amplitude: Amplitude = None,
    move_time: Annotated[
        Length | None, "Time of the move; default: 0.5, on the twin 1"
    ] = None,
    reference: ReferenceFile = None,
    told: Annotated[
        float, Between(0.0, 1e4, "kg"), "Payload that the law is given; 0: none"
    ] = 0.0,
    estimate: Estimate = False,
    on: Annotated[
        Literal["model", "twin"],
        "The arm: the identified model, or the twin, an arm with distributed mass that is not the model",
    ] = "model",
    seed: Annotated[Seed, "Seed of the noise"] = 0,
    out: Annotated[
        Path | None, "File to write the run to; default: run.npz or twin.npz"
    ] = None,
    force: bool = False,
    payload: NominalPayload = None,
) -> Answer:
    """Simulate a move of the tip with the shipped law; the exit code says whether it
    settles.

    $ fraclink simulate design.json --payload 0.08 --told 0.08
    """
    twin = on == "twin"
    place = output_path(out or f"{'twin' if twin else 'run'}.npz", force=force)
    usual_time = 1.0 if twin else 0.5
    path = reference_of(reference, amplitude, move_time, usual_time=usual_time)
    subject = load_design(design_file)
    if amplitude is not None:
        # The law's guard would refuse the reference and hold the arm where it is.
        reach = subject.law().limits.angle_limit
        remedy = "give radians, 1.57 for 90°, or state the rig's [moves]"
        Between(-reach, reach, "rad", remedy=remedy).check("amplitude", amplitude)
    mass = payload or subject.rig.payloads.nominal
    # A payload of 0 means none, so that --told 0 together with --estimate is no
    # contradiction.
    refuse_beside(
        "--estimate",
        "the payload that the law estimates",
        told=(estimate and told) or None,
    )
    move = run_law(
        subject,
        path,
        arm=Twin.from_rig(subject.rig, payload=mass) if twin else None,
        payload=mass,
        told="estimated" if estimate else told,
        # On the model 3.5 s beyond the move: 4 s for the usual move, as in a report.
        duration=None if twin else path.duration + 3.5,
        seed=seed,
    )
    passed = move.verdict.passed
    # A move that fails on the model needs no twin.
    step = f"{'certify' if passed else 'assess'} {design_file}"
    if passed and not twin:
        step = f"simulate {design_file} --payload {mass:g} --on twin"
    return Answer(
        move,
        passed,
        doubts=doubts_of_move(subject, payload, told or None),
        saved={place: move},
        following=f"fraclink {step}",
    )


@command(app)
def certify(
    design_file: DesignFile,
    out: Annotated[Path, "File to write the certificate to", Writes()] = Path(
        "certificate.json"
    ),
    modulus_margin: Annotated[
        float | None, "|1 + L| to prove; default: what can be proved"
    ] = None,
    others: Annotated[
        list[Path] | None,
        option("MODEL"),
        "Model from another log of the same arm, for which the proof must hold, too",
    ] = None,
) -> Answer:
    """Prove stability for every payload and delay in range; exit code 1 where the proof
    fails.

    $ fraclink certify design.json --modulus-margin 0.35
    """
    with steps(1) as begin:
        begin("proving")
        subject = Design.load(design_file)
        models = [load_link_model(other, subject.rig)[0] for other in others or ()]
        certificate = prove(
            subject, modulus_margin=modulus_margin, others=filter(None, models)
        )
    if not certificate.passed:
        following = f"fraclink assess {design_file}"
        # No file: a failed certificate must not lie where the next command looks for
        # one.
        return Answer(
            certificate, passed=False, values={"out": None}, following=following
        )
    return Answer(
        certificate,
        saved={out: certificate},
        following=f"fraclink export c {design_file} --out firmware",
    )


@command(app)
def report(
    folder: Annotated[
        Path,
        argument("FOLDER"),
        "Folder of results",
    ],
    out: Annotated[
        Path | None, "File to write; default: report.html or arm.html there"
    ] = None,
    arm: Annotated[
        bool,
        "Only the arm that moves: the same law in one file, for any browser, without a server",
    ] = False,
    script: Annotated[
        bool, "With the arm that moves; without it the report holds no script at all"
    ] = True,
    force: bool = False,
) -> Answer:
    """Gather a folder of results into one self-contained HTML file.

    $ fraclink report results --out report.html
    """
    default = folder / ("arm.html" if arm else "report.html")
    place = output_path(out or default, force=force)
    study = load_study(folder)
    if arm:
        write_arm_page(study, place)
    else:
        write_report(study, place, script=script)
    values = {"out": str(place), "passed": study.verdict.passed}
    return Answer(text=str(place), values=values)
