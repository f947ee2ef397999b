"""Verbs of Monte Carlo campaigns: montecarlo, report, replay."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fraclink._cli.console import emit, emit_json, table, tell
from fraclink._cli.options import Force, Json, RigName, load_rig
from fraclink._cli.outcome import FAILS, HOLDS
from fraclink._files import output_path

if TYPE_CHECKING:
    from fraclink._campaign import Progress, Quantile, Summary

__all__ = ["register"]

Parts = Annotated[Path, typer.Argument(metavar="PARTS", help="Folder of a campaign.")]


def montecarlo(
    out: Annotated[Path, typer.Option("--out", help="Folder for the parts; a started one goes on.")],
    rig: RigName = "paper-2023",
    design_file: Annotated[
        Path | None, typer.Option("--design", help="Design whose law is run; default: the rig's own request.")
    ] = None,
    runs: Annotated[int, typer.Option("--runs", help="Number of runs.")] = 10_000,
    seed: Annotated[int, typer.Option("--seed", help="Seed of everything that is drawn.")] = 0,
    workers: Annotated[int, typer.Option("--workers", help="Processes on this machine.")] = 1,
    scheduler: Annotated[
        str | None, typer.Option("--scheduler", help="Address of a Dask scheduler, e.g. tcp://host:8786.")
    ] = None,
    json: Json = False,
) -> int:
    """Run a law on many arms that differ; resumes, and gives the same result whatever the workers."""
    from fraclink._campaign import Campaign, run_campaign, summarise
    from fraclink._design import Design
    from fraclink._workflow import Request, design_for

    if design_file is not None:
        design = Design.load(design_file)
    else:
        design, _ = design_for(load_rig(rig), None, Request())
    law = design.law()
    campaign = Campaign.of(design.rig, design.model, law, runs=runs, seed=seed)
    with _watching(campaign.runs) as watch:
        run_campaign(campaign, out, workers=workers, scheduler=scheduler, watch=watch)
    return _tell_summary(summarise(campaign, out), out, json=json)


def report(
    parts: Parts,
    out: Annotated[Path | None, typer.Option("--out", help="Write a page with figures here (.html).")] = None,
    json: Json = False,
    force: Force = False,
) -> int:
    """Summarise the finished parts of a campaign: failures, quantiles, worst cases, what drives them."""
    from fraclink._campaign import load_campaign, summarise

    place = None if out is None else output_path(out, force=force)
    campaign = load_campaign(parts)
    summary = summarise(campaign, parts)
    if place is not None:
        from fraclink._show.report.campaigns import write_campaign_report

        write_campaign_report(campaign, parts, summary, place)
        tell(f"written: {place}")
    return _tell_summary(summary, parts, json=json)


def replay(
    parts: Parts,
    run: Annotated[int, typer.Option("--run", help="Number of the run.")],
    out: Annotated[Path, typer.Option("--out", help="File for the run's signals (.npz).")] = Path("run.npz"),
    json: Json = False,
    force: Force = False,
) -> int:
    """Repeat one run of a campaign with all its signals."""
    from fraclink._campaign import load_campaign
    from fraclink._campaign import replay as repeat
    from fraclink._cli.summary import metrics_values

    place = output_path(out, force=force)
    campaign = load_campaign(parts)
    found = repeat(campaign, run)
    found.save(place)
    told = {"run": run, "passed": found.verdict.passed, "verdict": str(found.verdict), "out": str(place)}
    emit_json(told | {"metrics": metrics_values(found.metrics)}) if json else emit(
        f"run {run}: {found.verdict}"
    )
    if not json:
        tell(f"written: {place}")
    return HOLDS if found.verdict.passed else FAILS


def _tell_summary(summary: Summary, parts: Path, *, json: bool) -> int:
    if json:
        emit_json(_as_json(summary))
    else:
        emit(_text(summary, parts))
    return HOLDS if not summary.failure.count else FAILS


def _text(summary: Summary, parts: Path) -> str:
    from fraclink._law import MODES, REASONS

    header = ["metric", *(f"{100 * q.probability:g} %" for q in summary.metrics[0].quantiles), "driven by"]
    rows = [
        [
            m.name,
            *(f"{q.value:.4g}" for q in m.quantiles),
            ", ".join(f"{p} {r:+.2f}" for p, r in m.drivers[:2]),
        ]
        for m in summary.metrics
    ]
    worst = [
        f"worst {m.name}: {m.worst[0][1]:.4g} in run {m.worst[0][0]}: "
        f"fraclink campaign replay {parts} --run {m.worst[0][0]}"
        for m in summary.metrics[:5]
    ]
    trips = [f"{count} runs: {MODES[mode]} ({REASONS[reason]})" for mode, reason, count in summary.trips]
    return "\n".join([table(header, rows), "", *worst, "", *trips, summary.failure.sentence])


def _as_json(summary: Summary) -> dict[str, object]:
    def number(x: float) -> float | str:
        return x if abs(x) < float("inf") else str(x)

    def quantile(q: Quantile) -> list[float | str]:
        return [q.probability, number(q.value), number(q.low), number(q.high)]

    failure = summary.failure
    return {
        "runs": failure.runs,
        "failures": failure.count,
        "probability": [failure.estimate, failure.low, failure.high],
        "trips": [{"mode": m, "reason": r, "runs": c} for m, r, c in summary.trips],
        "failed": list(summary.failed),
        "metrics": {
            m.name: {
                "quantiles": [
                    [q.probability, number(q.value), number(q.low), number(q.high)] for q in m.quantiles
                ],
                "worst": [[n, number(v)] for n, v in m.worst],
                "drivers": dict(m.drivers),
            }
            for m in summary.metrics
        },
    }


@contextmanager
def _watching(runs: int) -> Iterator[Callable[[Progress], None] | None]:
    """Show a rate and the time the campaign will end on standard error; silent where that is no terminal."""
    import sys

    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    began = time.monotonic()
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TimeRemainingColumn())
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("simulating", total=runs)

        def watch(progress: Progress) -> None:
            rate = (progress.done - progress.before) / max(time.monotonic() - began, 1e-9)
            ends = time.strftime(
                "%H:%M:%S", time.localtime(time.time() + (runs - progress.done) / max(rate, 1e-9))
            )
            bar.update(task, completed=progress.done, description=f"{rate:.0f} runs/s, ends at {ends}")

        yield watch


def register(app: typer.Typer) -> None:
    """Add the verbs to the campaign's own application."""
    app.command()(montecarlo)
    app.command()(report)
    app.command()(replay)
