"""Commands on many runs: campaign montecarlo, report, replay and faults."""

from __future__ import annotations

import shlex
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import numpy as np
import typer

from fraclink import _campaign as campaigns
from fraclink._campaign import Campaign, Summary
from fraclink._campaign.fault_trial import Phase
from fraclink._campaign.faults import (
    PHASES,
    Bench,
    Case,
    FaultTable,
    Outcome,
    cases,
    observe,
    run_faults,
)
from fraclink._cli.app import group
from fraclink._cli.command import Answer, Writes, command, option
from fraclink._cli.console import steps, watching
from fraclink._cli.options import Gear, LinkMass, ModelFile, RigName, load_design, load_link_model, load_rig
from fraclink._design import Design
from fraclink._files import save, write_text
from fraclink._files.envelope import write_npz
from fraclink._show.faults import draw_outcome
from fraclink._show.report import write_campaign_report
from fraclink._show.text import View
from fraclink._show.views import view
from fraclink._simulate import geared
from fraclink._workflow import design_for
from fraclink.errors import FieldError

app = group()
campaign = group("Many runs: Monte Carlo and faults.")
app.add_typer(campaign, name="campaign")

Parts = Annotated[Path, typer.Argument(metavar="PARTS", help="Folder of a campaign.")]


def _many(word: str, metavar: str, help: str) -> Any:
    return option(word, metavar=metavar, help=f"{help}; may be repeated.")


@campaign.command()
@command
def montecarlo(
    out: Annotated[Path, option("--out", help="Folder for the parts; a started one goes on.")],
    rig: RigName = "paper-2023",
    design_file: Annotated[
        Path | None, option("--design", help="Design whose law is run; default: the rig's own request.")
    ] = None,
    model: ModelFile = None,
    runs: Annotated[int, option("--runs", help="Number of runs.")] = 10_000,
    seed: Annotated[int, option("--seed", help="Seed of everything that is drawn.")] = 0,
    workers: Annotated[int, option("--workers", help="Processes on this machine.")] = 1,
    scheduler: Annotated[
        str | None, option("--scheduler", help="Address of a Dask scheduler, e.g. tcp://host:8786.")
    ] = None,
) -> Answer:
    """Run a law on many arms that differ; resumes, and gives the same result whatever the workers."""
    if design_file is not None:
        made = Design.load(design_file)
    else:
        made, _ = design_for(load_rig(rig), load_link_model(model))
    asked = Campaign.of(made.rig, made.model, made.law(), runs=runs, seed=seed)
    with watching(runs) as watch:
        campaigns.run_campaign(asked, out, workers=workers, scheduler=scheduler, watch=watch)
    return _summarised(campaigns.summarise(asked, out), out)


@campaign.command()
@command
def report(
    parts: Parts,
    out: Annotated[
        Path | None, option("--out", help="Write a page with figures here (.html)."), Writes()
    ] = None,
) -> Answer:
    """Summarise the finished parts of a campaign: failures, quantiles, worst cases, what drives them."""
    asked = campaigns.load_campaign(parts)
    summary = campaigns.summarise(asked, parts)
    if out is not None:
        write_campaign_report(asked, parts, summary, out)
    return _summarised(summary, parts, () if out is None else (out,))


def _summarised(summary: Summary, parts: Path, written: tuple[Path, ...] = ()) -> Answer:
    following = ""
    if summary.failed:
        following = f"fraclink campaign replay {parts} --run {summary.failed[0]}"
    return Answer(summary, not summary.failure.count, written=written, following=following)


@campaign.command()
@command
def replay(
    parts: Parts,
    run: Annotated[int, option("--run", help="Number of the run.")],
    out: Annotated[Path, option("--out", help="File for the run's signals (.npz)."), Writes()] = Path(
        "run.npz"
    ),
) -> Answer:
    """Repeat one run of a campaign with all its signals."""
    found = campaigns.replay_run(campaigns.load_campaign(parts), run)
    found.save(out)
    return Answer(found, found.verdict.passed, values={"run": run}, written=(out,))


# --- faults -----------------------------------------------------------------------------------------------


@campaign.command()
@command
def faults(
    out: Annotated[
        Path, option("--out", help="Folder for the table, its page and figures."), Writes(("faults.json",))
    ] = Path("faults"),
    rig: Annotated[
        str | None, option("--rig", help="A rig file or a bundled rig; default: the design's.")
    ] = None,
    design_file: Annotated[
        Path | None, option("--design", help="Design whose law is tested; default: the rig's request.")
    ] = None,
    gear: Gear = None,
    link_mass: LinkMass = None,
    model: ModelFile = None,
    only: Annotated[list[str] | None, _many("--only", "FAULT", "A fault of the catalogue, e.g. F07")] = None,
    severity: Annotated[list[int] | None, _many("--severity", "LEVEL", "1, 2 or 3; default: all")] = None,
    payload: Annotated[
        list[float] | None, _many("--payload", "KG", "Payload [kg]; default: low, nominal, high")
    ] = None,
    phase: Annotated[
        list[str] | None, _many("--phase", "PHASE", "whole, start, mid or rest; default: all")
    ] = None,
    seed: Annotated[list[int] | None, _many("--seed", "SEED", "Seed; default: 1, 2, 3")] = None,
    figures: Annotated[Literal["failures", "all", "none"], option("--figures", help="Runs to draw.")] = (
        "failures"
    ),
) -> Answer:
    """Inject the catalogue's faults F01-F44 into the shipped law on the twin; exit code 1 where one fails.

    Every fault at three severities, three payloads and several phases of a move of 1 rad. A run that does not
    meet its requirement gets a figure and a command that repeats it.
    """
    bench = _bench(rig, design_file, gear, link_mass, model)
    given = {
        "--rig": rig,
        "--design": design_file,
        "--gear": gear,
        "--link-mass": link_mass,
        "--model": model,
    }
    words = [word for name, value in given.items() if value is not None for word in (name, str(value))]
    repeat = "fraclink campaign faults " + shlex.join(words)
    planned = cases(
        bench,
        only=only or (),
        severities=severity or (1, 2, 3),
        payloads=payload or (),
        phases=[cast(Phase, word) for word in phase] if phase else PHASES,
        seeds=seed or (1, 2, 3),
    )
    out.mkdir(parents=True, exist_ok=True)  # a folder that cannot be written is found out before the work
    with steps(len({case.fault for case in planned})) as begin:
        result = run_faults(bench, planned, progress=begin, about={"command": repeat})
    save(result, out / "faults.json", force=True)
    write_text(out / "faults.md", _page(result, repeat))
    drawn = {"failures": result.failures, "all": result.outcomes, "none": ()}[figures]
    with steps(len(drawn)) as begin:
        for outcome in drawn:
            begin(outcome.case.name)
            draw_outcome(bench, outcome, out / "figures" / f"{outcome.case.name}.svg")
    if len(planned) == 1:
        _keep_signals(bench, planned[0], out / "run.npz")
    return Answer(
        result,
        result.passed,
        _faults_view(result, repeat),
        {"open": [_outcome_values(outcome, repeat) for outcome in result.failures], "out": str(out)},
        tuple(map(str, bench.twin.findings)),
        (out / "faults.md",),
    )


def _bench(
    rig: str | None, design_file: Path | None, gear: float | None, link_mass: float | None, model: Path | None
) -> Bench:
    if rig is None and design_file is None:
        allowed, remedy = "--design, --rig or both", "give one of them"
        raise FieldError("design", None, "missing", allowed=allowed, remedy=remedy)
    given = None if rig is None else load_rig(rig)
    if design_file is not None:
        made = load_design(design_file, model=model)
    else:
        made, _ = design_for(load_rig(rig or ""), load_link_model(model))
    arm = given if given is not None and given.model is not None else made.rig
    return Bench.of(made, arm if gear is None else geared(arm, gear), link_mass=link_mass)


def _repeated(case: Case, repeat: str) -> str:
    return (
        f"{repeat} --only {case.fault} --severity {case.severity} --payload {case.payload!r} "
        f"--phase {case.phase} --seed {case.seed} --out {case.name}"
    )


def _faults_view(result: FaultTable, repeat: str) -> View:
    """The table, and for each fault that fails its worst run with the command that repeats it."""
    shown = view(result)
    failed = [row for row in result.rows() if row.example is not None]
    notes = [
        f"{row.number}: {row.worst}\n  {_repeated(row.example.case, repeat)}"
        for row in failed
        if row.example is not None
    ]
    return View(shown.headline, shown.tables, tuple(notes), shown.state)


def _page(result: FaultTable, repeat: str) -> str:
    law = result.about["law_sha256"][:16]
    lines = ["# Fault campaign", "", f"law {law}, `{repeat}`", "", result.markdown()]
    lines += ["", "## Failed", ""] if result.failures else []
    for outcome in result.failures:
        lines.append(f"- {outcome.name}: {'; '.join(map(str, outcome.failed))}")
        lines.append(f"  `{_repeated(outcome.case, repeat)}`")
    return "\n".join(lines) + "\n"


def _outcome_values(outcome: Outcome, repeat: str) -> dict[str, Any]:
    return {
        "name": outcome.case.name,
        "detail": outcome.detail,
        "failed": [str(check) for check in outcome.failed],
        "replay": _repeated(outcome.case, repeat),
    }


def _keep_signals(bench: Bench, case: Case, path: Path) -> None:
    """Keep every signal of a replayed run."""
    e = observe(bench, case, bench.law.in_precision("double"))
    signals = {item.name: getattr(e.faulty, item.name) for item in fields(e.faulty)}
    arrays = {name: value for name, value in signals.items() if isinstance(value, np.ndarray)}
    write_npz(path, "fault-run", 1, {"case": case.name, "law_sha256": e.law.digest}, arrays)
