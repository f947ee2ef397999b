"""The law in real time: run it on an arm, or serve a simulated arm for it to run on."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from fraclink._cli.console import emit, emit_json, table, tell
from fraclink._cli.options import Force, Gear, Json, LinkMass, Payload
from fraclink._cli.outcome import FAILS, HOLDS
from fraclink._cli.verdicts import DesignFile
from fraclink._files import output_path, save
from fraclink.errors import LogError

if TYPE_CHECKING:
    from fraclink._arm.reference import Reference
    from fraclink._design import Design
    from fraclink._law import Law
    from fraclink._realtime import RealtimeRun, Spread

__all__ = ["register"]

Excitation = Literal["move", "prbs"]

Way = Annotated[str, typer.Option("--io", metavar="WAY", help="udp:HOST:PORT, shm:NAME or library:FILE.so.")]
UnsafeRemote = Annotated[
    bool,
    typer.Option("--unsafe-remote", help="Allow another host: whoever can send there moves the arm."),
]


def run_realtime(
    plan_file: DesignFile,
    io: Way,
    out: Annotated[Path, typer.Option("--out", help="File to write the record to (npz).")] = Path(
        "realtime.npz"
    ),
    amplitude: Annotated[float, typer.Option("--amplitude", help="Size of the move [rad].")] = 1.0,
    move_time: Annotated[float, typer.Option("--move-time", help="Time of the move [s].")] = 1.0,
    duration: Annotated[
        float | None, typer.Option("--duration", help="Time to run [s]; default: 3 s after the move.")
    ] = None,
    excitation: Annotated[
        Excitation, typer.Option("--excitation", help="Reference of the tip: a move, or 20 s of a PRBS.")
    ] = "move",
    log: Annotated[
        Path | None, typer.Option("--log", help="File for the motion as a log (CSV), to identify from.")
    ] = None,
    absolute: Annotated[
        bool, typer.Option("--absolute", help="The move begins at angle 0, not where the arm stands.")
    ] = False,
    gear: Gear = None,
    motor: Annotated[
        bool,
        typer.Option("--motor/--no-motor", help="With the motor loop, or for a robot with its own servo."),
    ] = True,
    single: Annotated[
        bool, typer.Option("--single", help="In single precision, as on a microcontroller.")
    ] = False,
    patience: Annotated[float, typer.Option("--patience", help="Time to wait for the arm [s].")] = 5.0,
    priority: Annotated[
        int, typer.Option("--priority", help="Of SCHED_FIFO, 1 to 99; 0 asks for none.")
    ] = 80,
    lock_memory: Annotated[
        bool, typer.Option("--lock-memory/--no-lock-memory", help="Keep the process in memory (mlockall).")
    ] = True,
    allowed_overruns: Annotated[
        int,
        typer.Option("--allowed-overruns", help="Commands after the next deadline, up to which it holds."),
    ] = 0,
    json: Json = False,
    unsafe_remote: UnsafeRemote = False,
    force: Force = False,
) -> int:
    """Run the shipped law on an arm in real time (Linux), with times, overruns and a safe stop.

    The exit code is 1 after a safe stop (the law's guards, a signal, a broken connection) or too many
    overruns; the record is written all the same. Without an arm: `fraclink serve-arm`.
    """
    from fraclink._realtime import parse_connection
    from fraclink._realtime import run_realtime as run_law

    place = output_path(out, force=force)
    log_place = None if log is None else output_path(log, force=force)
    connection = parse_connection(io, unsafe_remote=unsafe_remote)
    law = _law(_plan(plan_file, gear), motor=motor, single=single)
    run = run_law(
        law,
        _reference(excitation, amplitude, move_time),
        connection,
        duration=duration,
        out=place,
        relative=not absolute,
        patience=patience,
        priority=priority,
        lock_memory=lock_memory,
        allowed_overruns=allowed_overruns,
    )
    emit_json(_values(run) | {"out": run.saved}) if json else emit(_text(run))
    _tell_refused("priority", run.scheduling)
    _tell_refused("memory", run.memory)
    if not json:
        tell(f"written: {run.saved}")
    if run.saved != str(place):
        tell(f"{place} could not be written")
    if log_place is not None and not _logged(run, log_place):
        return FAILS
    return HOLDS if run.passed else FAILS


def _logged(run: RealtimeRun, place: Path) -> bool:
    """Write the run as a log, or tell why it is none: the record of the run is kept in any case."""
    try:
        run.experiment().save(place)
    except LogError as error:
        tell(f"no log: {error}")
        return False
    tell(f"written: {place}")
    return True


def _reference(kind: Excitation, amplitude: float, move_time: float) -> Reference:
    from fraclink._arm.reference import prbs, smooth_step

    if kind == "move":
        return smooth_step(amplitude, duration=move_time)
    # As `fraclink record` excites the twin: bits of 0.24 s have their power where an arm's first mode is.
    return prbs(amplitude, 0.24, bits=81, register=9, start=0.5)


def _tell_refused(what: str, granted: str) -> None:
    if granted.startswith("refused"):
        tell(f"{what}: {granted}; the loop ran without it (limits rtprio and memlock of the user)")


def _plan(plan_file: Path, gear: float | None) -> Design:
    from fraclink._design import Design
    from fraclink._simulate import geared

    design = Design.load(plan_file)
    return design if gear is None else replace(design, rig=geared(design.rig, gear))


def _law(design: Design, *, motor: bool, single: bool) -> Law:
    law = design.law() if motor else design.controller.discretize(design.rig.period)
    return law.in_precision("single") if single else law


def _values(run: RealtimeRun) -> dict[str, object]:
    def spread(values: Spread) -> dict[str, float] | None:
        return None if math.isnan(values.mean) else {name: float(v) for name, v in values._asdict().items()}

    return {
        "passed": run.passed,
        "problem": run.problem,
        "stopped": run.stopped,
        "periods": len(run.tick),
        "missed": run.missed,
        "overruns": run.overruns,
        "lost_samples": run.lost_samples,
        "lost_commands": run.lost_commands,
        "latency_s": spread(run.latencies),
        "work_s": spread(run.works),
        "scheduling": run.scheduling,
        "memory": run.memory,
        "last_mode": int(run.mode[-1]) if len(run.mode) else None,
        "replays": run.first_difference is None,
    }


def _text(run: RealtimeRun) -> str:
    rows = [
        [name, *(f"{1e6 * value:.1f}" for value in values)]
        for name, values in (("latency of the wake-up", run.latencies), ("work of the period", run.works))
    ]
    same = "the record replays through the law to the last bit" if run.first_difference is None else ""
    return "\n".join(
        line
        for line in (
            f"{len(run.tick)} periods of {1e3 * run.period:g} ms, {run.missed} missed, "
            f"{run.overruns} overruns, {run.lost_samples} lost samples",
            f"scheduling {run.scheduling}, memory {run.memory}",
            table(["time [µs]", "least", "mean", "99.9 %", "most"], rows),
            same,
            "passed" if run.passed else f"does not hold: {run.problem}",
        )
        if line
    )


def serve_arm(
    plan_file: DesignFile,
    io: Annotated[str, typer.Option("--io", metavar="WAY", help="udp:HOST:PORT or shm:NAME.")],
    payload: Payload = None,
    link_mass: LinkMass = None,
    gear: Gear = None,
    duration: Annotated[float, typer.Option("--duration", help="Time to serve [s].")] = 600.0,
    watchdog: Annotated[
        int, typer.Option("--watchdog", help="Silent periods after which the drive is switched off.")
    ] = 10,
    once: Annotated[bool, typer.Option("--once", help="End when the first controller has left.")] = False,
    seed: Annotated[int, typer.Option("--seed", help="Seed of the gauge's noise.")] = 0,
    priority: Annotated[
        int, typer.Option("--priority", help="Of SCHED_FIFO, below the controller's; 0 asks for none.")
    ] = 70,
    unsafe_remote: UnsafeRemote = False,
    out: Annotated[
        Path | None, typer.Option("--out", help="File for what really happened (npz); default: none.")
    ] = None,
    json: Json = False,
    force: Force = False,
) -> int:
    """Serve a simulated arm in real time, for run-realtime to move; --duration, --once or Ctrl-C ends it.

    It is the twin on a clock. The exit code is 1 where a controller went silent and the watchdog had to
    switch the drive off.
    """
    from fraclink._realtime import parse_connection
    from fraclink._realtime import serve_arm as serve
    from fraclink._simulate import Twin

    place = None if out is None else output_path(out, force=force)
    connection = parse_connection(io, unsafe_remote=unsafe_remote)
    design = _plan(plan_file, gear)
    arm = Twin.from_rig(design.rig, payload=payload, link_mass=link_mass)
    for finding in arm.findings:
        tell(str(finding))
    tell(f"an arm at {connection}, {1e3 * design.rig.period:g} ms")
    served = serve(
        arm,
        connection,
        design.rig.period,
        duration=duration,
        watchdog=watchdog,
        once=once,
        seed=seed,
        priority=priority,
    )
    _tell_refused("priority", served.scheduling)
    if place is not None:
        save(served, place, force=True)
    told = {
        "passed": served.passed,
        "periods": len(served.voltage),
        "late": served.late,
        "controllers": served.controllers,
        "silences": served.silences,
        "rejected": served.rejected,
        "last_tip_angle": float(served.tip_angle[-1]) if len(served.tip_angle) else None,
    }
    if json:
        emit_json(told | ({"out": str(place)} if place else {}))
    else:
        emit(
            f"{told['periods']} periods, {served.late} late; {served.controllers} controllers, "
            f"{served.silences} of them left without a stop; {served.rejected} messages rejected"
        )
    return HOLDS if served.passed else FAILS


def register(app: typer.Typer) -> None:
    """Add the verbs of this module to the application."""
    app.command()(run_realtime)
    app.command()(serve_arm)
