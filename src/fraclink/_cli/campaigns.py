"""Commands on many runs: campaign montecarlo and faults."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated, Any, cast

from fraclink._cli.app import group
from fraclink._cli.command import Answer, Keywords, Writes, argument, command, option
from fraclink._cli.console import steps
from fraclink._cli.options import (
    load_design,
    refuse_beside,
)
from fraclink._design import Design
from fraclink._files import save
from fraclink._reading.responses import read_reference
from fraclink.trials._arms import replay_run
from fraclink.trials._campaign import Campaign
from fraclink.trials._fault_trial import PHASES, Bench, Phase
from fraclink.trials._faults import cases, observe, run_faults
from fraclink.trials._run import run_campaign
from fraclink.trials._summary import CampaignRuns
from fraclink.view._runs import outcome_figure

app = group()
campaign = group("Many runs: Monte Carlo and faults.")
app.add_typer(campaign, name="campaign")

DesignOption = Annotated[Path, "Design whose law is run"]


@command(campaign)
def montecarlo(
    design: DesignOption,
    out: Annotated[Path, "File to write the runs to (.npz)", Writes()] = Path(
        "campaign.npz"
    ),
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
    **machines: Annotated[Any, Keywords(run_campaign, "workers")],
) -> Answer:
    """Run a law on many varied arms, with the same result for any number of workers.

    $ fraclink campaign montecarlo --design design.json --runs 10000
    """
    subject = Design.load(design)
    # --told and --estimate both set the payload of the law, and the summary would not
    # show which one was used.
    refuse_beside(
        "--estimate", "the payload it estimates", told=(told and estimate) or None
    )
    study = Campaign.of(
        subject.rig,
        subject.model,
        subject.law(),
        runs=runs,
        seed=seed,
        told=told,
        # The range of the estimator is that of the design, as on the board.
        estimated=subject.payloads if estimate else None,
        reference=None if reference is None else read_reference(reference),
    )
    with steps(runs) as begin:

        def watch(done: int, failed: int) -> None:
            begin(f"{100 * failed / done:.1f} % failed", done)

        arms = run_campaign(study, watch=watch, **machines)
    summary = arms.summary
    again = f"fraclink replay {out} --run {summary.failed[0]}" if summary.failed else ""
    return Answer(summary, summary.passed, saved={out: arms}, following=again)


@command(app)
def replay(
    file: Annotated[Path, argument("FILE"), "File of `campaign montecarlo`"],
    run: Annotated[int, "Number of the run, as the campaign lists it"],
    out: Annotated[Path, "File for the signals of that run (.npz)", Writes()] = Path(
        "run.npz"
    ),
) -> Answer:
    """Repeat one run of a campaign on varied arms, with all its signals.

    $ fraclink replay mc.npz --run 65
    """
    move = replay_run(CampaignRuns.load(file).campaign, run)
    return Answer(move, move.verdict.passed, values={"run": run}, saved={out: move})


# --- faults -----------------------------------------------------------------------------------------------


@command(campaign)
def faults(
    design: DesignOption,
    out: Annotated[
        Path,
        "Folder for the table",
        Writes(("faults.json", "run.npz", "run.svg")),
    ] = Path("faults"),
    only: Annotated[list[str] | None, option("FAULT"), "A fault, e.g. F07"] = None,
    severity: Annotated[
        list[int] | None, option("LEVEL"), "1, 2 or 3; default: all"
    ] = None,
    payload: Annotated[
        list[float] | None,
        option("KG"),
        "Payload [kg]; default: low, nominal, high",
    ] = None,
    phase: Annotated[
        list[str] | None,
        option("PHASE"),
        "whole, start, mid or rest; default: all",
    ] = None,
    seed: Annotated[list[int] | None, option("SEED"), "Seed; default: 1, 2, 3"] = None,
) -> Answer:
    """Inject the catalogue's faults F01-F44 into the shipped law on the twin; exit code
    1 where one fails.

    Every fault at three severities, three payloads and several phases of a move of 1
    rad. If only one run is selected, all its signals and a figure are kept.

    $ fraclink campaign faults --design design.json --only F07 --out faults
    """
    bench = Bench.of(load_design(design))
    plan = cases(
        bench,
        only=only or (),
        severities=severity or (1, 2, 3),
        payloads=payload or (),
        phases=[cast(Phase, word) for word in phase] if phase else PHASES,
        seeds=seed or (1, 2, 3),
    )
    # fails early if the folder cannot be written
    out.mkdir(parents=True, exist_ok=True)
    with steps(len(plan)) as begin:
        result = run_faults(
            bench,
            plan,
            watch=lambda outcome: begin(outcome.case.name),
            # Stored in the table: a replay a year later must find the same arm.
            about={
                "command": f"fraclink campaign faults --design {shlex.quote(str(design))}"
            },
        )
    save(result, out / "faults.json", force=True)
    worst = next((row.worst[1] for row in result.rows() if row.worst), None)
    saved: dict[Path, Any] = {}
    if len(plan) == 1:  # meant to be inspected closely
        saved[out / "run.npz"] = observe(bench, plan[0]).faulty
        saved[out / "run.svg"] = outcome_figure(bench, result.outcomes[0])
    return Answer(
        result,
        result.passed,
        values={"out": str(out)},
        remarks=tuple(map(str, bench.twin.findings)),
        saved=saved,
        written=(out / "faults.json",),
        following=result.repeated(worst) if worst and not saved else "",
    )
