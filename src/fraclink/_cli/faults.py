"""The verb `campaign faults`: break the law on purpose and see what it does."""

from __future__ import annotations

import shlex
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from fraclink._cli.console import emit, emit_json, steps, table, tell
from fraclink._cli.options import Force, Gear, Json, LinkMass, load_rig
from fraclink._cli.outcome import FAILS, HOLDS
from fraclink._files import output_path, write_text
from fraclink.errors import FieldError

if TYPE_CHECKING:
    from fraclink._campaign.faults import Bench, Case, FaultTable, Outcome

__all__ = ["register"]

Figures = Literal["failures", "all", "none"]


def faults(
    out: Annotated[Path, typer.Option("--out", help="Folder for the table, its page and figures.")] = Path(
        "faults"
    ),
    rig: Annotated[
        str | None, typer.Option("--rig", help="A rig file or a bundled rig; default: the design's.")
    ] = None,
    design_file: Annotated[
        Path | None, typer.Option("--design", help="Design whose law is tested; default: the rig's request.")
    ] = None,
    gear: Gear = None,
    link_mass: LinkMass = None,
    only: Annotated[
        list[str] | None,
        typer.Option("--only", metavar="FAULT", help="A fault of the catalogue, e.g. F07; may be repeated."),
    ] = None,
    severity: Annotated[
        list[int] | None,
        typer.Option("--severity", metavar="LEVEL", help="1, 2 or 3; may be repeated; default: all."),
    ] = None,
    payload: Annotated[
        list[float] | None,
        typer.Option(
            "--payload", metavar="KG", help="Payload [kg]; may be repeated; default: low, nominal, high."
        ),
    ] = None,
    phase: Annotated[
        list[str] | None,
        typer.Option(
            "--phase", metavar="PHASE", help="whole, start, mid or rest; may be repeated; default: all."
        ),
    ] = None,
    seed: Annotated[
        list[int] | None,
        typer.Option("--seed", metavar="SEED", help="Seed; may be repeated; default: 1, 2, 3."),
    ] = None,
    figures: Annotated[Figures, typer.Option("--figures", help="Runs to draw.")] = "failures",
    json: Json = False,
    force: Force = False,
) -> int:
    """Inject the catalogue's faults F01-F44 into the shipped law on the twin; exit code 1 where one fails.

    Every fault at three severities, three payloads and several phases of a move of 1 rad. A run that does not
    meet its requirement gets a figure and a command that repeats it.
    """
    from fraclink._campaign.faults import PHASES, cases, run_faults

    place = output_path(out / "faults.json", force=force)
    bench = _bench(rig, design_file, gear, link_mass)
    planned = cases(
        bench,
        only=only or (),
        severities=severity or (1, 2, 3),
        payloads=payload or (),
        phases=phase or PHASES,
        seeds=seed or (1, 2, 3),
    )
    command = _command(rig, design_file, gear, link_mass)
    out.mkdir(parents=True, exist_ok=True)  # a folder that cannot be written is told before the work
    with steps(len({case.fault for case in planned})) as begin:
        result = run_faults(bench, planned, progress=begin, about={"command": command})
    result.save(place)
    write_text(out / "faults.md", _page(result, command))
    _draw(bench, result, out, figures)
    if len(planned) == 1:
        _keep_signals(bench, planned[0], out / "run.npz")
    _tell(result, command, out, json=json)
    return HOLDS if result.passed else FAILS


def _bench(rig: str | None, design_file: Path | None, gear: float | None, link_mass: float | None) -> Bench:
    from fraclink._campaign.faults import Bench
    from fraclink._design import Design
    from fraclink._simulate import geared
    from fraclink._workflow import Request, design_for

    if rig is None and design_file is None:
        raise FieldError(
            "design",
            None,
            "missing, and no rig",
            allowed="--design, --rig or both",
            remedy="give one of them",
        )
    given = None if rig is None else load_rig(rig)
    if design_file is not None:
        design = Design.load(design_file)
    else:
        assert given is not None  # noqa: S101  # refused above
        design, _ = design_for(given, None, Request())
    arm = given or design.rig
    bench = Bench.of(design, arm if gear is None else geared(arm, gear), link_mass=link_mass)
    for finding in bench.twin.findings:
        tell(str(finding))
    return bench


def _command(rig: str | None, design_file: Path | None, gear: float | None, link_mass: float | None) -> str:
    """The options that name the bench, as a shell reads them."""
    words = ["fraclink", "campaign", "faults"]
    given = {"--rig": rig, "--design": design_file, "--gear": gear, "--link-mass": link_mass}
    for name, value in given.items():
        if value is not None:
            words += [name, shlex.quote(str(value))]
    return " ".join(words)


def _replay(case: Case, command: str) -> str:
    return (
        f"{command} --only {case.fault} --severity {case.severity} --payload {case.payload!r} "
        f"--phase {case.phase} --seed {case.seed} --out {case.name}"
    )


def _page(result: FaultTable, command: str) -> str:
    lines = [
        "# Fault campaign",
        "",
        f"law {result.about['law_sha256'][:16]}, `{command}`",
        "",
        result.markdown(),
    ]
    if result.failures:
        lines += ["", "## Open", ""]
    for outcome in result.failures:
        lines.append(f"- {outcome.name}: {'; '.join(map(str, outcome.failed))}")
        lines.append(f"  `{_replay(outcome.case, command)}`")
    return "\n".join(lines) + "\n"


def _draw(bench: Bench, result: FaultTable, out: Path, figures: Figures) -> None:
    from fraclink._campaign.faults.figure import draw_outcome

    wanted = {"failures": result.failures, "all": result.outcomes, "none": ()}[figures]
    with steps(len(wanted)) as begin:
        for outcome in wanted:
            begin(outcome.case.name)
            draw_outcome(bench, outcome, out / "figures" / f"{outcome.case.name}.svg")


def _keep_signals(bench: Bench, case: Case, path: Path) -> None:
    """Keep every signal of a replayed run."""
    import numpy as np

    from fraclink._campaign.faults import observe
    from fraclink._npz import write_npz

    e = observe(bench, case, bench.law.in_precision("double"))
    signals = {field.name: getattr(e.faulty, field.name) for field in fields(e.faulty)}
    arrays = {name: value for name, value in signals.items() if isinstance(value, np.ndarray)}
    write_npz(path, "fault-run", 1, {"case": case.name, "law_sha256": e.law.digest}, arrays)


def _values(outcome: Outcome, command: str) -> dict[str, object]:
    return {
        "name": outcome.case.name,
        "detail": outcome.detail,
        "failed": [str(check) for check in outcome.failed],
        "replay": _replay(outcome.case, command),
    }


def _tell(result: FaultTable, command: str, out: Path, *, json: bool) -> None:
    rows = result.rows()
    if json:
        emit_json(
            {
                "passed": result.passed,
                "runs": len(result.outcomes),
                "faults": {row.number: {"runs": row.runs, "open": row.failed} for row in rows},
                "open": [_values(outcome, command) for outcome in result.failures],
                "out": str(out),
            }
        )
        return
    emit(
        table(
            ["fault", "class", "runs", "open"],
            [(f"{r.number} {r.title}", r.reaction, r.runs, r.failed or "-") for r in rows],
        )
    )
    if result.failures:
        emit("\nOpen, each with its worst run and the command that repeats it:")
    for row in rows:
        if row.example is not None:
            emit(f"{row.number}: {row.worst}\n  {_replay(row.example.case, command)}")
    if result.failures:
        emit(f"\nall {len(result.failures)} open runs: {out / 'faults.md'}, {out / 'figures'}")
    met = sum(row.passed for row in rows)
    emit(f"{met} of {len(rows)} faults meet their requirement in every run ({len(result.outcomes)} runs)")
    tell(f"written: {out}")


def register(campaign: typer.Typer) -> None:
    """Add the verb to `fraclink campaign`."""
    campaign.command()(faults)
