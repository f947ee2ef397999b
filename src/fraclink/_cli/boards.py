"""Commands that hand a law on: export, replay, and the law in real time."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Literal

import typer

from fraclink import _realtime as realtime
from fraclink._arm.reference import Reference, prbs, smooth_step
from fraclink._certify import Certificate, certify
from fraclink._cli.app import group
from fraclink._cli.command import Answer, Writes, command, option
from fraclink._cli.console import steps, tell
from fraclink._cli.options import (
    Columns,
    DesignFile,
    Gear,
    LinkMass,
    ModelFile,
    Payload,
    RigName,
    load_design,
    load_log,
    load_rig,
)
from fraclink._design import Design
from fraclink._export import Proof, export_c, export_fmu, export_io, export_matlab, replay_log
from fraclink._files import save
from fraclink._law import Law, discretize
from fraclink._simulate import Twin
from fraclink.errors import LogError, MissingExtraError

app = group()
export = group("Hand a design on: C for a board, MATLAB, FMU, a board's I/O.")
app.add_typer(export, name="export")

Motor = Annotated[
    bool, option("--motor/--no-motor", help="With the motor loop, or for a robot with its own servo.")
]

UnsafeRemote = Annotated[
    bool, option("--unsafe-remote", help="Allow another host: whoever can send there moves the arm.")
]


def _law(made: Design, *, motor: bool) -> Law:
    # Without the motor loop the robot has its own servo, and no placement of poles reaches it.
    return made.law() if motor else discretize(made.controller, made.rig.period)


@export.command()
@command
def c(
    design_file: DesignFile,
    out: Annotated[Path, option("--out", help="Folder to write to.")] = Path("firmware"),
    precision: Annotated[
        Literal["single", "double"], option("--precision", help="Arithmetic of the board.")
    ] = "single",
    motor: Motor = True,
    name: Annotated[str, option("--name", help="C identifier of the block of coefficients.")] = "law_data",
    title: Annotated[str, option("--title", help="Text for the first comment.")] = "",
    prove: Annotated[
        bool, option("--prove", help="Prove what the page claims; exit code 1 where something is not proved.")
    ] = False,
    force: bool = False,
) -> Answer:
    """Write the law as C99: the files that were simulated, the coefficients, a self-test, a page to read."""
    made = Design.load(design_file)
    shipped = _law(made, motor=motor).in_precision(precision)
    with steps(2 if prove else 0) as begin:
        certificate = None
        if prove:
            begin("certifying the loop")
            certificate = _certificate(made, shipped, motor=motor)
            begin("proving the files, half a minute")
        options = {"name": name, "title": title, "prove": prove, "certificate": certificate, "force": force}
        paths = export_c(shipped, out, **options)  # type: ignore[arg-type]
    proof = Proof.load(out / "proof.json") if prove else None
    values: dict[str, object] = {"out": [str(path) for path in paths]}
    if proof is not None:
        values |= {"passed": proof.passed, "claims": [asdict(claim) for claim in proof.claims]}
    text = "\n".join(map(str, (*paths, *([] if proof is None else [proof]))))
    return Answer(passed=proof is None or proof.passed, text=text, values=values)


def _certificate(made: Design, law: Law, *, motor: bool) -> Certificate | None:
    """The certificate of the loop that `law` closes; None, which leaves the claim open, without the extra."""
    try:
        return certify(made, law=law, inner=None if motor else "ideal")
    except MissingExtraError as error:
        tell(f"the loop is not certified: {error}")
        return None


@export.command()
@command
def matlab(
    design_file: DesignFile,
    out: Annotated[Path, option("--out", help="File to write, .m or .mat.")] = Path("arm_law.m"),
    force: bool = False,
) -> Answer:
    """Write the discrete law for MATLAB: a function (.m) or its numbers (.mat)."""
    path = export_matlab(_law(Design.load(design_file), motor=False), out, force=force)
    return Answer(text=str(path), values={"out": str(path)})


@export.command()
@command
def fmu(
    design_file: DesignFile,
    out: Annotated[Path, option("--out", help="File to write, .fmu.")] = Path("arm_law.fmu"),
    fmi: Annotated[
        Literal["2", "3"], option("--fmi", help="Version of the standard: 2 is what every importer reads.")
    ] = "2",
    precision: Annotated[
        Literal["single", "double"], option("--precision", help="Arithmetic of the law.")
    ] = "double",
    compiler: Annotated[
        list[str] | None,
        option(
            "--compiler",
            metavar="CC",
            help="Each adds a library for its platform: cc (where none is given), x86_64-w64-mingw32-gcc ...",
        ),
    ] = None,
    source: Annotated[bool, option("--source", help="C sources only, no library.")] = False,
    force: bool = False,
) -> Answer:
    """Write the law as an FMU for co-simulation (FMI 2.0 or 3.0): Simulink, Dymola, OpenModelica, FMPy."""
    path = export_fmu(
        _law(Design.load(design_file), motor=True),
        out,
        fmi=3 if fmi == "3" else 2,
        precision=precision,
        compilers=() if source else compiler or ("cc",),
        force=force,
    )
    return Answer(text=str(path), values={"out": str(path)})


@export.command()
@command
def io(
    out: Annotated[Path, option("--out", help="Folder to write to.")] = Path("board"), force: bool = False
) -> Answer:
    """Write a board to begin with, for the real-time loop: arm_io.h and a library in C that stands still."""
    paths = [str(path) for path in export_io(out, force=force)]
    return Answer(text="\n".join(paths), values={"out": paths})


@app.command()
@command
def replay(
    folder: Annotated[Path, typer.Argument(metavar="FIRMWARE", help="Folder made by `fraclink export c`.")],
    log_file: Annotated[str, typer.Argument(metavar="LOG", help="Log file, or demo for the bundled one.")],
    rig: RigName = "paper-2023",
    column: Columns = None,
) -> Answer:
    """Compile an exported law and run a log through it beside the package's: bit for bit, or exit code 1."""
    result = replay_log(folder, load_log(log_file, load_rig(rig), None, column))
    return Answer(result, result.passed)


# --- real time --------------------------------------------------------------------------------------------


@app.command()
@command
def run_realtime(
    design_file: DesignFile,
    io: Annotated[str, option("--io", metavar="WAY", help="udp:HOST:PORT, shm:NAME or library:FILE.so.")],
    out: Annotated[Path, option("--out", help="File to write the record to (npz)."), Writes()] = Path(
        "realtime.npz"
    ),
    amplitude: Annotated[float, option("--amplitude", help="Size of the move [rad].")] = 1.0,
    move_time: Annotated[float, option("--move-time", help="Time of the move [s].")] = 1.0,
    duration: Annotated[
        float | None, option("--duration", help="Time to run [s]; default: 3 s after the move.")
    ] = None,
    excitation: Annotated[
        Literal["move", "prbs"],
        option("--excitation", help="Reference of the tip: a move, or 20 s of a PRBS."),
    ] = "move",
    log: Annotated[
        Path | None,
        option("--log", help="File for the motion as a log (CSV), to identify from."),
        Writes(),
    ] = None,
    absolute: Annotated[
        bool, option("--absolute", help="The move begins at angle 0, not where the arm stands.")
    ] = False,
    gear: Gear = None,
    motor: Motor = True,
    single: Annotated[bool, option("--single", help="In single precision, as on a microcontroller.")] = False,
    patience: Annotated[float, option("--patience", help="Time to wait for the arm [s].")] = 5.0,
    unsafe_remote: UnsafeRemote = False,
    priority: Annotated[int, option("--priority", help="Of SCHED_FIFO, 1 to 99; 0 asks for none.")] = 80,
    lock_memory: Annotated[
        bool, option("--lock-memory/--no-lock-memory", help="Keep the process in memory (mlockall).")
    ] = True,
    allowed_overruns: Annotated[
        int, option("--allowed-overruns", help="Commands after the next deadline that are tolerated.")
    ] = 0,
) -> Answer:
    """Run the shipped law on an arm in real time (Linux), with times, overruns and a safe stop.

    The exit code is 1 after a safe stop (the law's guards, a signal, a broken connection) or too many
    overruns; the record is written all the same. Without an arm: `fraclink serve-arm`.
    """
    connection = realtime.parse_connection(io, unsafe_remote=unsafe_remote)
    law = _law(load_design(design_file, gear=gear), motor=motor)
    run = realtime.run_realtime(
        law.in_precision("single") if single else law,
        _reference(excitation, amplitude, move_time),
        connection,
        duration=duration,
        relative=not absolute,
        patience=patience,
        priority=priority,
        lock_memory=lock_memory,
        allowed_overruns=allowed_overruns,
        out=out,
    )
    remarks = _refused("priority", run.scheduling) + _refused("memory", run.memory)
    remarks += () if run.saved == str(out) else (f"{out} could not be written",)
    written: tuple[Path, ...] = (Path(run.saved),)
    logged = True
    if log is not None:
        try:
            run.experiment().save(log)
            written += (log,)
        except LogError as error:  # the record of the run is kept in any case
            logged, remarks = False, (*remarks, f"no log: {error}")
    return Answer(run, run.passed and logged, values={"out": run.saved}, remarks=remarks, written=written)


def _reference(kind: str, amplitude: float, move_time: float) -> Reference:
    if kind == "move":
        return smooth_step(amplitude, duration=move_time)
    # As `fraclink record` excites the twin: bits of 0.24 s have their power where an arm's first mode is.
    return prbs(amplitude, 0.24, bits=81, register=9, start=0.5)


def _refused(what: str, granted: str) -> tuple[str, ...]:
    if not granted.startswith("refused"):
        return ()
    return (f"{what}: {granted}; the loop ran without it (limits rtprio and memlock of the user)",)


@app.command()
@command
def serve_arm(
    design_file: DesignFile,
    io: Annotated[str, option("--io", metavar="WAY", help="udp:HOST:PORT or shm:NAME.")],
    payload: Payload = None,
    link_mass: LinkMass = None,
    gear: Gear = None,
    model: ModelFile = None,
    unsafe_remote: UnsafeRemote = False,
    duration: Annotated[float, option("--duration", help="Time to serve [s].")] = 600.0,
    watchdog: Annotated[
        int, option("--watchdog", help="Silent periods after which the drive is switched off.")
    ] = 10,
    once: Annotated[bool, option("--once", help="End when the first controller has left.")] = False,
    seed: Annotated[int, option("--seed", help="Seed of the gauge's noise.")] = 0,
    priority: Annotated[
        int, option("--priority", help="Of SCHED_FIFO, below the controller's; 0 asks for none.")
    ] = 70,
    out: Annotated[
        Path | None, option("--out", help="File for what really happened (npz); default: none."), Writes()
    ] = None,
) -> Answer:
    """Serve a simulated arm in real time, for run-realtime to move; --duration, --once or Ctrl-C ends it.

    It is the twin on a clock. The exit code is 1 where a controller went silent and the watchdog had to
    switch the drive off.
    """
    connection = realtime.parse_connection(io, unsafe_remote=unsafe_remote)
    made = load_design(design_file, gear=gear, model=model)
    arm = Twin.from_rig(made.rig, payload=payload, link_mass=link_mass)
    for finding in arm.findings:
        tell(str(finding))
    tell(f"an arm at {connection}, {1e3 * made.rig.period:g} ms")
    served = realtime.serve_arm(
        arm,
        connection,
        made.rig.period,
        duration=duration,
        watchdog=watchdog,
        once=once,
        seed=seed,
        priority=priority,
    )
    if out is not None:
        save(served, out, force=True)
    written = () if out is None else (out,)
    return Answer(served, served.passed, remarks=_refused("priority", served.scheduling), written=written)
