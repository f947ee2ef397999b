"""Commands that make and run a design: run, design, simulate, twin, certify, report."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypedDict, Unpack

import typer

from fraclink._certify import certify as prove
from fraclink._cli.app import group
from fraclink._cli.command import Answer, Default, Writes, command
from fraclink._cli.console import steps
from fraclink._cli.options import (
    Amplitude,
    ArmOptions,
    BoxFlag,
    DesignFile,
    DesignRequest,
    Estimate,
    GivenPayload,
    HeldOutShare,
    LinkMass,
    LogOptions,
    ModelFile,
    MotorLoopKind,
    MoveTime,
    Placement,
    ReferenceFile,
    RigName,
    SeedNumber,
    doubts_of_move,
    in_radians,
    load_arm,
    load_doubts,
    load_link_model,
    load_log,
    load_rig,
    reference_of,
    told_or_estimated,
)
from fraclink._design import Design
from fraclink._design.completed import design_for
from fraclink._files import output_path
from fraclink._simulate import simulate as run_law
from fraclink.trials._stages import run as run_study
from fraclink.trials._stages import simulate_move
from fraclink.trials._study import load_study
from fraclink.view._arm_page import write_arm_page
from fraclink.view._report import write_report

app = group()

# What a person may have put there before the first run, and what a run leaves: of all
# the files of a study these are the ones whose loss would cost something. The moves and
# the models of other structures (run-*.npz, model-*.json) come again from these, and
# are replaced.
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

Script = Annotated[
    bool, "With the arm that moves; without it the report holds no script at all"
]
Open = Annotated[bool, "Open the page in a browser when it is written"]


class RunOptions(LogOptions, DesignRequest):
    """How the log is read and what the design is asked for."""

    box: BoxFlag


@command(app)
def run(
    rig: RigName,
    log: Annotated[str, "The log; `demo` is the bundled one"],
    out: Annotated[Path, "Folder to write to", Writes(_STUDY)] = Path("results"),
    structure: Annotated[
        str | None, "Structure of the model; default: what the log supports"
    ] = None,
    heldout: HeldOutShare = None,
    certify: Annotated[bool, "Prove the design, too; takes a few seconds"] = False,
    arms: Annotated[
        int, "Arms that differ from the model to try; 0 leaves them out"
    ] = 1000,
    title: Annotated[str | None, "Title of the report"] = None,
    script: Script = True,
    open: Open = False,
    **options: Unpack[RunOptions],
) -> Answer:
    """Take a log to a model, a controller, simulated moves and a report; the exit code
    is the verdict.

    $ fraclink run --rig paper-2023 --log demo --out results
    """
    known = load_rig(rig)
    # Both groups come in one dictionary: what reads the log must not reach the design.
    reading = {name: options.pop(name) for name in LogOptions.__annotations__}  # type: ignore[misc]
    with steps(6 + certify) as begin:
        # Named before it is done: a reader that waits for a slow disk must be seen to
        # wait.
        begin("reading the log")
        study = run_study(
            known,
            load_log(log, known, **reading),
            structure=structure,
            heldout=heldout,
            certified=certify,
            arms=arms,
            out=out,
            begin=begin,
            **in_radians(options),
        )
        begin("writing the report")
        place = write_report(study, out / "report.html", title=title, script=script)
    # The arms that fail come before the export: a worst case that can be replayed is
    # the next thing to look at.
    following = (
        f"fraclink export c {out / 'design.json'} --out firmware" if study.law else ""
    )
    if study.arms and study.arms.failure.count:
        following = (
            f"fraclink campaign replay {out / 'arms'} --run {study.arms.failed[0]}"
        )
    values = {"report": str(place), "out": str(out)}
    shown = place if open else None
    return Answer(
        study,
        study.verdict.passed,
        values=values,
        written=(place,),
        following=following,
        opened=shown,
    )


class DesignOptions(DesignRequest):
    """Everything that a design can be asked for."""

    margins: Annotated[
        str,
        "loop: filter, motor loop, hold and delay included; ideal: those of the paper",
        Default("loop"),
    ]
    filter_order: Annotated[int | None, "n, 1 or 2"]
    inner: Annotated[MotorLoopKind, Default("ideal")]
    placement: Annotated[Placement, Default("tustin")]
    max_sensitivity: Annotated[
        float | None, "Bound on Ms; alone it replaces the phase margin"
    ]
    noise_gain: Annotated[
        float | None, "Bound on the motor reference's RMS per RMS of gauge noise"
    ]
    settling_time: Annotated[
        float | None, "Bound on 2π/ω_c [s]; alone it replaces the crossover"
    ]
    box: BoxFlag


@command(app)
def design(
    rig: RigName,
    model: ModelFile = None,
    link_mass: LinkMass = None,
    out: Annotated[Path, "File to write the design to", Writes()] = Path("design.json"),
    **request: Unpack[DesignOptions],
) -> Answer:
    """Design the outer controller for a payload range; every requirement is listed with
    what was achieved.

    $ fraclink design --rig rig.toml --model model.json
    """
    known = load_rig(rig, link_mass=link_mass)
    made, assumptions = design_for(
        known, load_link_model(model, known), **in_radians(request)
    )
    # Doubts of the fit travel with the design: requirements that are met for a model of
    # nothing do not pass.
    made = made.doubted(load_doubts(model)).with_law()
    made.save(out)
    assumed = tuple(f"assumed: {sentence}" for sentence in assumptions)
    # With the lightest payload, at which the phase margin is smallest.
    step = (
        f"simulate {out} --payload {made.payloads[0]:g}"
        if made.passed
        else f"assess {out}"
    )
    return Answer(
        made, made.passed, remarks=assumed, written=(out,), following=f"fraclink {step}"
    )


class MoveOptions(TypedDict):
    """The time, the disturbances and the motor loop of a simulation."""

    duration: Annotated[float, "Time to simulate [s]", Default(4.0)]
    gauge_offset: Annotated[
        float | None, "Offset of the gauge [N·m]; default: the rig's"
    ]
    noise: Annotated[float | None, "Gauge noise [N·m]; default: the rig's"]
    inner: Annotated[MotorLoopKind, Default("sampled")]
    seed: Annotated[SeedNumber, Default(0)]


@command(app)
def simulate(
    design_file: DesignFile,
    payload: Annotated[float, "Payload at the tip [kg]"],
    amplitude: Amplitude = None,
    move_time: Annotated[float | None, "Time of the move [s]; default: 0.5"] = None,
    reference: ReferenceFile = None,
    told: GivenPayload = 0.0,
    estimate: Estimate = False,
    out: Annotated[Path, "File to write the run to (npz)", Writes()] = Path("run.npz"),
    **options: Unpack[MoveOptions],
) -> Answer:
    """Simulate a move of the tip with the shipped law; the exit code says whether it
    settles.

    $ fraclink simulate design.json --payload 0.08 --told 0.08
    """
    made = Design.load(design_file)
    wanted = reference_of(reference, amplitude, move_time, usual_time=0.5)
    given = told_or_estimated(made, told, estimate)
    move = simulate_move(made, payload, reference=wanted, told=given, **options)
    move.save(out)
    following = f"fraclink twin {design_file} --payload {payload:g}"
    doubts = doubts_of_move(made, payload)
    return Answer(
        move, move.verdict.passed, doubts=doubts, written=(out,), following=following
    )


@command(app)
def twin(
    design_file: DesignFile,
    amplitude: Amplitude = None,
    move_time: MoveTime = None,
    reference: ReferenceFile = None,
    told: GivenPayload = 0.0,
    estimate: Estimate = False,
    seed: SeedNumber = 0,
    **options: Unpack[ArmOptions],
) -> Answer:
    """Run the shipped law on the twin: an arm with distributed mass that is not the
    model.

    $ fraclink twin design.json --gear 50 --link-mass 0.00735
    """
    made, arm = load_arm(design_file, options)
    wanted = reference_of(reference, amplitude, move_time)
    given = told_or_estimated(made, told, estimate)
    move = run_law(made.law(), wanted, arm=arm, told=given, seed=seed)
    doubts = doubts_of_move(made, options["payload"])
    following = (
        f"fraclink certify {design_file}"
        if move.verdict.passed
        else f"fraclink assess {design_file}"
    )
    return Answer(move, move.verdict.passed, doubts=doubts, following=following)


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
        typer.Option(metavar="MODEL"),
        "Model from another log of the same arm, which the proof is to hold for, too; may be repeated",
    ] = None,
) -> Answer:
    """Prove stability for every payload and delay in range; exit code 1 where the proof
    fails.

    $ fraclink certify design.json --modulus-margin 0.35
    """
    with steps(1) as begin:
        begin("proving")
        made = Design.load(design_file)
        models = filter(
            None, (load_link_model(other, made.rig) for other in others or ())
        )
        certificate = prove(made, modulus_margin=modulus_margin, others=models)
    if not certificate.passed:
        following = f"fraclink assess {design_file}"
        # No file: a certificate that failed must not lie where the next stage looks for
        # one.
        return Answer(
            certificate, passed=False, values={"out": None}, following=following
        )
    certificate.save(out)
    return Answer(
        certificate,
        written=(out,),
        following=f"fraclink export c {design_file} --out firmware",
    )


@command(app)
def report(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER"), "Folder of results"],
    out: Annotated[Path | None, "File to write; default: report.html there"] = None,
    title: Annotated[str | None, "Title of the report"] = None,
    script: Script = True,
    open: Open = False,
    force: bool = False,
) -> Answer:
    """Gather a folder of results into one self-contained HTML file.

    $ fraclink report results --out report.html
    """
    place = output_path(out or folder / "report.html", force=force)
    study = load_study(folder)
    write_report(study, place, title=title, script=script)
    values = {"out": str(place), "passed": study.verdict.passed}
    return Answer(text=str(place), values=values, opened=place if open else None)


@command(app)
def share(
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER"), "Folder of results with a design"
    ],
    out: Annotated[Path, "File to write"] = Path("arm.html"),
    title: Annotated[str | None, "Title of the page; default: the rig's name"] = None,
    open: Open = False,
    force: bool = False,
) -> Answer:
    """Write the arm as a page that moves: the same law in one HTML file, for any
    browser, without a server.

    $ fraclink share results --out arm.html
    """
    place = output_path(out, force=force)
    study = load_study(folder)
    write_arm_page(study, place, title=title)
    values = {"out": str(place), "passed": study.verdict.passed}
    return Answer(text=str(place), values=values, opened=place if open else None)
