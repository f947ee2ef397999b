"""Beyond the closed form: `optimise` looks for a quieter or faster controller under the same bounds."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

import typer

from fraclink._cli.console import emit, emit_json, steps, table, tell
from fraclink._cli.options import Force, Json, ModeGain
from fraclink._cli.outcome import FAILS, HOLDS
from fraclink._cli.verdicts import DesignFile
from fraclink._files import output_path

__all__ = ["register"]


def optimise(
    plan_file: DesignFile,
    out: Annotated[Path, typer.Option("--out", help="File to write the design to.")] = Path("optimised.json"),
    goal: Annotated[
        Literal["noise", "crossover"],
        typer.Option("--goal", help="noise: least at the motor reference; crossover: the fastest loop."),
    ] = "noise",
    max_sensitivity: Annotated[
        float | None, typer.Option("--max-sensitivity", help="Bound on Ms; default: the design's own.")
    ] = None,
    gain_crossover: Annotated[
        float | None,
        typer.Option(
            "--gain-crossover", help="Least crossover [rad/s], for the goal noise; default: as designed."
        ),
    ] = None,
    noise_gain: Annotated[
        float | None,
        typer.Option(
            "--noise-gain", help="Bound on the noise, for the goal crossover; default: as designed."
        ),
    ] = None,
    mode_gain: ModeGain = None,
    least_percent: Annotated[
        float, typer.Option("--least-percent", help="Improvement below which the simpler structure is kept.")
    ] = 2.0,
    json: Json = False,
    force: Force = False,
) -> int:
    """Optimise k_d, β, δ and n for the worst payload, from a closed-form design."""
    from fraclink._cli.summary import plan_text, plan_values
    from fraclink._design import Design
    from fraclink._design import optimise as better

    place = output_path(out, force=force)
    with steps(1) as begin:
        begin("optimising")
        found = better(
            Design.load(plan_file),
            goal=goal,
            max_sensitivity=max_sensitivity,
            gain_crossover=gain_crossover,
            noise_gain=noise_gain,
            mode_gain=mode_gain,
            least=0.01 * least_percent,
        )
    design = found.design.with_law()
    design.save(place)
    tried = [
        {"structure": s.structure, "value": None if math.isnan(s.value) else s.value, "taken": s.taken}
        for s in found.steps
    ]
    if json:
        emit_json(plan_values(design) | {"pays": found.pays, "tried": tried, "out": str(place)})
        return HOLDS if design.passed else FAILS
    figure = "worst noise gain" if goal == "noise" else "smallest crossover [rad/s]"
    rows = [
        (
            s.structure,
            "none found in the bounds" if math.isnan(s.value) else f"{s.value:.4g}",
            "taken" * s.taken,
        )
        for s in found.steps
    ]
    emit(table(("structure", figure, ""), rows))
    if not found.pays:
        emit(f"no structure is better by {least_percent:g} %: the closed-form design is returned")
    emit("\n" + plan_text(design))
    for finding in design.findings:
        tell(str(finding))
    tell(f"written: {place}")
    return HOLDS if design.passed else FAILS


def register(app: typer.Typer) -> None:
    """Add the verb to the application."""
    app.command()(optimise)
