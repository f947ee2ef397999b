"""Commands on references: shape."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, TypedDict, Unpack, cast

from fraclink._arm.reference import Path as MovePath
from fraclink._arm.reference import SampledReference
from fraclink._cli.app import group
from fraclink._cli.command import Answer, Default, Writes, command
from fraclink._cli.console import steps
from fraclink._cli.options import (
    Amplitude,
    ArmOptions,
    DesignFile,
    Gear,
    LinkMass,
    ModelFile,
    PayloadRange,
    doubts_of_move,
    load_arm,
    refuse_beside,
)
from fraclink._export.board import export_reference
from fraclink._reading.responses import read_reference
from fraclink._simulate.shape import shape as shape_move
from fraclink.errors import FieldError
from fracsys import checks as ranges

FollowedPath = MovePath | SampledReference

app = group()


class MoveRequest(TypedDict):
    """What a move is shaped for, and within which limits."""

    payloads: PayloadRange
    told: Annotated[bool, "The law is given the payload"]
    voltage: Annotated[
        float | None,
        "Limit of |V| [V], noise and friction included; default: the rig's",
    ]
    speed: Annotated[
        float | None, "Limit of the motor's speed at the gear's output [rad/s]"
    ]
    torque: Annotated[float | None, "Limit of the torque at the link's root [N·m]"]
    reserve: Annotated[
        float, "Part of the 2 % band that is left to friction and noise", Default(0.25)
    ]
    gauge_offset: Annotated[
        float | None, "Offset of the gauge [N·m]; default: the rig's"
    ]
    seeds: Annotated[int, "Noises to measure each payload with", Default(5)]


@command(app)
def shape(
    design_file: DesignFile,
    amplitude: Amplitude = None,
    payload: Annotated[
        ranges.Payload | None, "Payload, where it is known; instead of --payloads"
    ] = None,
    follow: Annotated[
        Path | None,
        "Table of times and angles that the tip shall follow, instead of --amplitude",
    ] = None,
    out: Annotated[Path, "File to write the move to", Writes()] = Path("move.json"),
    table: Annotated[
        Path | None, "Write its samples, too: .csv, or .h for C", Writes()
    ] = None,
    on: Annotated[
        Literal["twin", "model"],
        "Arm that it is made for: the twin, or the model as identified",
    ] = "twin",
    link_mass: LinkMass = None,
    gear: Gear = None,
    model: ModelFile = None,
    **request: Unpack[MoveRequest],
) -> Answer:
    """Shape the fastest move within the limits, for every payload of a range, and
    measure it beside others.

    $ fraclink shape design.json --amplitude 1 --voltage 8 --table move.csv
    """
    if payload is not None:
        if request["payloads"] is not None:
            allowed, remedy = "one of --payload and --payloads", "leave one out"
            raise FieldError(
                "payload",
                payload,
                "given beside payloads",
                allowed=allowed,
                remedy=remedy,
            )
        # A range of one: the same shaping, without a compromise.
        request["payloads"] = (payload, payload)
    # The identified model is massless and has no twin around it: what describes the
    # twin would be ignored.
    if on == "model":
        if model is not None:
            allowed, remedy = (
                "the design's own model",
                "design with that model, and shape for that design",
            )
            raise FieldError(
                "model",
                str(model),
                "given beside --on model",
                allowed=allowed,
                remedy=remedy,
            )
        refuse_beside(
            "--on model", "the model's link, which has no mass", link_mass=link_mass
        )
    if follow is not None:
        refuse_beside("--follow", "the angles of the file", amplitude=amplitude)
    options = ArmOptions(payload=None, link_mass=link_mass, gear=gear, model=model)
    made, arm = load_arm(design_file, options)
    with steps(1) as begin:
        begin("shaping the move")
        wanted: float | FollowedPath = 1.0 if amplitude is None else amplitude
        if follow is not None:
            # A file holds one of these two: no other reference has points to follow.
            wanted = cast(FollowedPath, read_reference(follow))
        move = shape_move(
            made, wanted, on=on, arm=arm if on == "twin" else None, **request
        )
    move.save(out)
    written: tuple[Path, ...] = (out,)
    if table is not None:
        written += (
            export_reference(move.reference, table, period=move.period, force=True),
        )
    # A move that counts on the payload must be measured with it.
    told = " --told" if request["told"] else ""
    following = f"fraclink campaign montecarlo --design {design_file} --reference {out}{told} --out moves"
    doubts = doubts_of_move(made, *move.payloads)
    return Answer(
        move, move.passed, doubts=doubts, written=written, following=following
    )
