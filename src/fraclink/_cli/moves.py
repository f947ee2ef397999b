"""Commands on references: shape."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from fraclink._cli.app import group
from fraclink._cli.command import Answer, Keywords, Writes, command
from fraclink._cli.console import steps
from fraclink._cli.options import (
    Amplitude,
    DesignFile,
    Estimate,
    doubts_of_move,
    load_design,
    refuse_beside,
)
from fraclink._export.board import export_reference
from fraclink._simulate.shape import shape as shape_move
from fracsys import checks as ranges

app = group()


@command(app)
def shape(
    design_file: DesignFile,
    amplitude: Amplitude = None,
    payload: Annotated[
        ranges.Payload | None, "Payload, where it is known; instead of --payloads"
    ] = None,
    told: Annotated[bool, "The law is given the payload"] = False,
    estimate: Estimate = False,
    out: Annotated[Path, "File to write the move to", Writes()] = Path("move.json"),
    table: Annotated[
        Path | None, "Write its samples, too: .csv, or .h for C", Writes()
    ] = None,
    **request: Annotated[
        Any, Keywords(shape_move, "payloads", "voltage", "settle", "on", "over")
    ],
) -> Answer:
    """Shape the fastest move within the limits, or the gentlest that settles in time,
    for every arm of the fit's box and every payload of a range.

    $ fraclink shape design.json --amplitude 1 --settle 0.7 --table move.csv
    """
    if payload is not None:
        refuse_beside("--payload", "one payload", payloads=request["payloads"])
        # A range of one payload: the same shaping, without a compromise.
        request["payloads"] = (payload, payload)
    refuse_beside(
        "--estimate", "the payload it estimates", told=(told and estimate) or None
    )
    goal = 1.0 if amplitude is None else amplitude
    subject = load_design(design_file)
    with steps(1) as begin:
        begin("shaping the move")
        move = shape_move(
            subject, goal, told="estimated" if estimate else told, **request
        )
    if table is not None:
        export_reference(move.reference, table, period=move.period, force=True)
    # A move shaped for a known payload must be simulated with it.
    option = " --estimate" if estimate else " --told" if told else ""
    following = f"fraclink campaign montecarlo --design {design_file} --reference {out}{option} --out moves"
    doubts = doubts_of_move(subject, *move.worst_case.payloads)
    return Answer(
        move,
        move.passed,
        doubts=doubts,
        saved={out: move},
        written=() if table is None else (table,),
        following=following,
    )
