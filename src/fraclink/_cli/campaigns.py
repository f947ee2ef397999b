"""Commands on many runs: campaign montecarlo, report, replay and faults."""

from __future__ import annotations

import shlex
from dataclasses import fields
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal, TypedDict, Unpack, cast

import numpy as np
import typer

from fraclink._cli.app import group
from fraclink._cli.command import Answer, Writes, command
from fraclink._cli.console import steps, watching
from fraclink._cli.options import (
    Gear,
    LinkMass,
    ModelFile,
    RigName,
    load_design,
    load_link_model,
    load_rig,
)
from fraclink._design import Design
from fraclink._design.completed import design_for
from fraclink._files import load, output_path, save, write_npz, write_text
from fraclink._reading.responses import read_reference
from fraclink._simulate import geared
from fraclink.errors import FieldError
from fraclink.trials._arms import replay_run
from fraclink.trials._campaign import Campaign, load_campaign
from fraclink.trials._fault_trial import Phase
from fraclink.trials._faults import (
    PHASES,
    Bench,
    Case,
    FaultTable,
    cases,
    observe,
    run_faults,
)
from fraclink.trials._run import run_campaign
from fraclink.trials._summary import Summary, summarise
from fraclink.view._report import write_campaign_report
from fraclink.view._runs import draw_outcome
from fraclink.view._views import faults_page

app = group()
campaign = group("Many runs: Monte Carlo and faults.")
app.add_typer(campaign, name="campaign")

Parts = Annotated[Path, typer.Argument(metavar="PARTS"), "Folder of a campaign"]
DesignOption = Annotated[
    Path | None, "Design whose law is run; default: the rig's own request"
]


@command(campaign)
def montecarlo(
    out: Annotated[Path, "Folder for the parts; a started one goes on"],
    rig: RigName = "paper-2023-geared",
    design: DesignOption = None,
    model: ModelFile = None,
    runs: Annotated[int, "Number of runs"] = 10_000,
    seed: Annotated[int, "Seed of everything that is drawn"] = 0,
    told: Annotated[bool, "The law is given the payload of each arm"] = False,
    estimate: Annotated[
        bool, "The law estimates the payload of each arm while it moves"
    ] = False,
    reference: Annotated[
        Path | None,
        "Move of `fraclink shape`, or a table, that every arm follows; default: quintics",
    ] = None,
    workers: Annotated[int, "Processes on this machine"] = 1,
    scheduler: Annotated[
        str | None, "Address of a Dask scheduler, e.g. tcp://host:8786"
    ] = None,
) -> Answer:
    """Run a law on many arms that differ; resumes, and gives the same result whatever
    the workers.

    $ fraclink campaign montecarlo --design design.json --runs 10000 --out mc
    """
    if design is not None:
        made = Design.load(design)
    else:
        known = load_rig(rig)
        made, _ = design_for(known, load_link_model(model, known))
    # Both set the law's payload, and which one acted would not be seen in the summary.
    if told and estimate:
        allowed, remedy = (
            "one of --told and --estimate",
            "leave --told out to have payloads estimated",
        )
        raise FieldError(
            "told", "given", "given beside --estimate", allowed=allowed, remedy=remedy
        )
    asked = Campaign.of(
        made.rig,
        made.model,
        made.law(),
        runs=runs,
        seed=seed,
        told=told,
        # The range in which the estimator looks: the design's, as on the board.
        estimated=made.payloads if estimate else None,
        reference=None if reference is None else read_reference(reference),
    )
    with watching(runs) as watch:
        run_campaign(asked, out, workers=workers, scheduler=scheduler, watch=watch)
    return _summarised(summarise(asked, out), out)


@command(campaign)
def report(
    parts: Parts,
    out: Annotated[
        Path | None, "Write a page with figures here (.html)", Writes()
    ] = None,
) -> Answer:
    """Summarise the finished parts of a campaign: failures, quantiles, worst cases,
    what drives them.

    $ fraclink campaign report mc --out campaign.html
    """
    asked = load_campaign(parts)
    summary = summarise(asked, parts)
    if out is not None:
        write_campaign_report(asked, parts, summary, out)
    return _summarised(summary, parts, () if out is None else (out,))


def _summarised(
    summary: Summary, parts: Path, written: tuple[Path, ...] = ()
) -> Answer:
    following = (
        f"fraclink campaign replay {parts} --run {summary.failed[0]}"
        if summary.failed
        else ""
    )
    return Answer(summary, summary.passed, written=written, following=following)


@command(campaign)
def replay(
    parts: Parts,
    run: Annotated[int | None, "Number of the run, of arms that differ"] = None,
    case: Annotated[
        str | None,
        typer.Option(metavar="NAME"),
        "Name of a fault's run, e.g. F07-3-30g-mid-3",
    ] = None,
    out: Annotated[Path, "File for the run's signals (.npz)", Writes()] = Path(
        "run.npz"
    ),
    force: bool = False,
) -> Answer:
    """Repeat one run of a campaign with all its signals; of faults, with its figure
    beside them.

    $ fraclink campaign replay mc --run 17 --out run.npz
    """
    # Arms have numbers, faults have names: both or none would replay what was not
    # meant.
    if (run is None) == (case is None):
        problem, remedy = (
            "missing" if run is None else "given beside --case",
            "give one of them",
        )
        raise FieldError(
            "run",
            run,
            problem,
            allowed="--run of arms, or --case of faults",
            remedy=remedy,
        )
    if run is None:
        return _repeat_fault(
            parts, case or "", out, output_path(out.with_suffix(".svg"), force=force)
        )
    found = replay_run(load_campaign(parts), run)
    found.save(out)
    return Answer(found, found.verdict.passed, values={"run": run}, written=(out,))


# --- faults -----------------------------------------------------------------------------------------------


class BenchOptions(TypedDict):
    """The arm, the law and the model that faults are injected into; a repeating command
    states them again.
    """

    rig: Annotated[
        str | None,
        typer.Option(metavar="RIG"),
        "A rig file or a bundled rig; default: the design's",
    ]
    design: DesignOption
    gear: Gear
    link_mass: LinkMass
    model: ModelFile


@command(campaign)
def faults(
    out: Annotated[
        Path,
        "Folder for the table, its page and figures",
        Writes(("faults.json", "faults.md", "run.npz")),
    ] = Path("faults"),
    only: Annotated[
        list[str] | None, typer.Option(metavar="FAULT"), "A fault, e.g. F07"
    ] = None,
    severity: Annotated[
        list[int] | None, typer.Option(metavar="LEVEL"), "1, 2 or 3; default: all"
    ] = None,
    payload: Annotated[
        list[float] | None,
        typer.Option(metavar="KG"),
        "Payload [kg]; default: low, nominal, high",
    ] = None,
    phase: Annotated[
        list[str] | None,
        typer.Option(metavar="PHASE"),
        "whole, start, mid or rest; default: all",
    ] = None,
    seed: Annotated[
        list[int] | None, typer.Option(metavar="SEED"), "Seed; default: 1, 2, 3"
    ] = None,
    figures: Annotated[Literal["failures", "all", "none"], "Runs to draw"] = "failures",
    **options: Unpack[BenchOptions],
) -> Answer:
    """Inject the catalogue's faults F01-F44 into the shipped law on the twin; exit code
    1 where one fails.

    Every fault at three severities, three payloads and several phases of a move of 1
    rad. A run that does not meet its requirement gets a figure and a command that
    repeats it.

    $ fraclink campaign faults --design design.json --only F07 --out faults
    """
    bench = _bench(options)
    given = {_flag(name): options[name] for name in BenchOptions.__annotations__}  # type: ignore[literal-required]
    words = [
        word
        for name, value in given.items()
        if value is not None
        for word in (name, str(value))
    ]
    # As words of a shell, kept in the table: a replay a year later must find the same
    # arm, and names may have spaces.
    repeat = "fraclink campaign faults " + shlex.join(words)
    planned = cases(
        bench,
        only=only or (),
        severities=severity or (1, 2, 3),
        payloads=payload or (),
        phases=[cast(Phase, word) for word in phase] if phase else PHASES,
        seeds=seed or (1, 2, 3),
    )
    out.mkdir(
        parents=True, exist_ok=True
    )  # a folder that cannot be written is found out before the work
    with steps(len({case.fault for case in planned})) as begin:
        result = run_faults(bench, planned, progress=begin, about={"command": repeat})
    save(result, out / "faults.json", force=True)
    write_text(out / "faults.md", faults_page(result))
    drawn = {"failures": result.failures, "all": result.outcomes, "none": ()}[figures]
    with steps(len(drawn)) as begin:
        for outcome in drawn:
            begin(outcome.case.name)
            draw_outcome(bench, outcome, out / "figures" / f"{outcome.case.name}.svg")
    # One run alone is what somebody looks at closely.
    if len(planned) == 1:
        _keep_signals(bench, planned[0], out / "run.npz")
    remarks, written = tuple(map(str, bench.twin.findings)), (out / "faults.md",)
    worst = next((row.example.case.name for row in result.rows() if row.example), None)
    following = (
        f"fraclink campaign replay {out} --case {worst}"
        if worst and len(planned) > 1
        else ""
    )
    return Answer(
        result,
        result.passed,
        values={"out": str(out)},
        remarks=remarks,
        written=written,
        following=following,
    )


def _repeat_fault(folder: Path, name: str, out: Path, figure: Path) -> Answer:
    """Run one case of a finished campaign on faults again, on the same arm and with the
    same law.
    """
    table = load(folder / "faults.json", FaultTable)
    case = next(
        (outcome.case for outcome in table.outcomes if outcome.case.name == name), None
    )
    if case is None:
        allowed = f"a run that {folder / 'faults.json'} lists, such as {table.outcomes[0].case.name}"
        raise FieldError(
            "case",
            name,
            "no run of this campaign",
            allowed=allowed,
            remedy="copy its name",
        )
    bench = _bench(_options_of(table, folder))
    # By its digest: a design that was made anew under the same name would show another
    # law's behaviour as that of the fault.
    tested = table.about.get("law_sha256", bench.law.digest)
    if bench.law.digest != tested:
        problem, allowed = (
            "not the law that was tested",
            f"the campaign's law, {tested[:16]}",
        )
        remedy = "run the campaign again"
        raise FieldError(
            "law", bench.law.digest[:16], problem, allowed=allowed, remedy=remedy
        )
    result = run_faults(bench, [case], about=dict(table.about))
    _keep_signals(bench, case, out)
    draw_outcome(bench, result.outcomes[0], figure)
    return Answer(
        result, result.passed, values={"case": case.name}, written=(out, figure)
    )


def _options_of(table: FaultTable, folder: Path) -> BenchOptions:
    """What the campaign's command was given; the studio's, which has none, tests its
    folder's design.
    """
    words = shlex.split(table.about.get("command", ""))
    # Every option of the bench takes one word, so that a flag and its neighbour are its
    # name and value.
    given = {flag: text for flag, text in pairwise(words) if flag.startswith("--")}
    rig, design, gear, mass, model = (
        given.get(_flag(name)) for name in BenchOptions.__annotations__
    )
    design = str(folder / "design.json") if rig is None and design is None else design
    return {
        "rig": rig,
        "design": None if design is None else Path(design),
        "gear": None if gear is None else float(gear),
        "link_mass": None if mass is None else float(mass),
        "model": None if model is None else Path(model),
    }


def _flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _bench(options: BenchOptions) -> Bench:
    rig, design_file, model, gear = (
        options["rig"],
        options["design"],
        options["model"],
        options["gear"],
    )
    if rig is None and design_file is None:
        allowed, remedy = "--design, --rig or both", "give one of them"
        raise FieldError("design", None, "missing", allowed=allowed, remedy=remedy)
    given = None if rig is None else load_rig(rig)
    if design_file is not None:
        made = load_design(design_file, model=model)
    else:
        known = load_rig(rig or "")
        made, _ = design_for(known, load_link_model(model, known))
    # A rig without a model has no damping for the twin: then the design's own stands
    # in.
    arm = given if given is not None and given.model is not None else made.rig
    return Bench.of(
        made, arm if gear is None else geared(arm, gear), link_mass=options["link_mass"]
    )


def _keep_signals(bench: Bench, case: Case, path: Path) -> None:
    """Keep every signal of a replayed run."""
    # In double precision, as `simulate` runs a law.
    e = observe(bench, case, bench.law.in_precision("double"))
    signals = {item.name: getattr(e.faulty, item.name) for item in fields(e.faulty)}
    arrays = {
        name: value for name, value in signals.items() if isinstance(value, np.ndarray)
    }
    write_npz(
        path, "fault-run", 1, {"case": case.name, "law_sha256": e.law.digest}, arrays
    )
