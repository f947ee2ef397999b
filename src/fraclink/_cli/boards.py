"""Commands that hand a law on: export, and the law in real time."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

from fraclink import lab
from fraclink._arm.reference import Length
from fraclink._certify import Certificate, certify
from fraclink._cli.app import group
from fraclink._cli.command import Answer, Keywords, Writes, command, option
from fraclink._cli.console import steps, tell
from fraclink._cli.options import (
    Amplitude,
    DesignFile,
    Estimate,
    NominalPayload,
    ReferenceFile,
    load_design,
    reference_of,
    refuse_beside,
)
from fraclink._design import Design
from fraclink._design.pid_tuning import PidTuning
from fraclink._export import (
    Proof,
    export_arm_firmware,
    export_c,
    export_fmu,
)
from fraclink._files import check_ending, kind_of, output_path
from fraclink._law import Law, discretize
from fraclink._simulate import Twin
from fraclink.errors import MissingExtraError
from fraclink.lab._machine import signals_held
from fraclink.lab._rehearsal import rehearse
from fraclink.lab._run import saved

app = group()
export = group("Write the controller for C on a board, an FMU, or a board's I/O.")
app.add_typer(export, name="export")

Motor = Annotated[bool, "With the motor loop, or for a robot with its own servo"]
UnsafeRemote = Annotated[
    bool, "Allow another host: any host that can send there moves the arm"
]
KeyFile = Annotated[
    Path | None, "File with a key of 16 bytes or more that both ends share (udp only)"
]
Address = option("ADDRESS")


def connection_of(
    io: str, unsafe_remote: bool, key_file: Path | None
) -> lab.Serial | lab.Udp:
    """Return the connection to an arm that the options of a command describe."""
    # From a file and never from the command line, which `ps` and the shell's history
    # reveal. The bytes are used as they are: a line break belongs to the key at both
    # ends.
    key = None if key_file is None else key_file.read_bytes()
    return lab.parse_connection(io, unsafe_remote=unsafe_remote, key=key)


def _of_file(path: Path, *, motor: bool) -> tuple[Law, Design | None]:
    """The law and its design, from a file with a design; the law and None, from a file
    with a fractional PID.
    """
    # The content of the file decides, not its name: a design may be called pid.json.
    if kind_of(path) == "pid-tuning":
        return PidTuning.load(path).law(), None
    design = Design.load(path)
    return _law(design, motor=motor), design


def _law(design: Design, *, motor: bool) -> Law:
    # Without the motor loop the robot uses its own servo, which the pole placement does
    # not affect.
    return design.law() if motor else discretize(design.controller, design.rig.period)


def _listed(paths: Iterable[Path], following: str = "") -> Answer:
    """The files of an export, one per line."""
    names = [str(path) for path in paths]
    return Answer(
        text="\n".join(names),
        values={"out": names if len(names) > 1 else names[0]},
        following=following,
    )


@command(export)
def c(
    design_file: DesignFile,
    out: Annotated[Path, "Folder to write to"] = Path("firmware"),
    precision: Annotated[
        Literal["single", "double"], "Arithmetic of the board"
    ] = "single",
    motor: Motor = True,
    prove: Annotated[
        bool, "Prove what the page claims; exit code 1 where something is not proved"
    ] = False,
    estimate: Annotated[
        bool, "With the payload estimator, which gives the law its payload"
    ] = False,
    force: bool = False,
) -> Answer:
    """Write the law as C99: the files that were simulated, the coefficients, a
    self-test, a page to read.

    $ fraclink export c design.json --out firmware
    """
    law, design = _of_file(design_file, motor=motor)
    if design is None:
        refuse_beside("a fractional PID", "no payload", estimate=estimate or None)
    # Rounded before it is proved and written: the claim must be about the coefficients
    # on the board.
    shipped = law.in_precision(precision)
    with steps(2 if prove else 0) as begin:
        certificate = None
        if prove:
            begin("certifying the loop")
            # A fractional PID has no arm, and thus no payloads for a certificate.
            certificate = _certificate(design, shipped) if design else None
            begin("proving the files, half a minute")
        paths = export_c(
            shipped,
            out,
            prove=prove,
            certificate=certificate,
            estimator=design.estimator() if estimate and design else None,
            force=force,
        )
    listing = _listed(paths)
    if not prove:
        return listing
    proof = Proof.load(out / "proof.json")
    values = {
        "passed": proof.passed,
        "claims": [asdict(claim) for claim in proof.claims],
    }
    return Answer(
        passed=proof.passed,
        text=f"{listing.text}\n{proof}",
        values=listing.values | values,
    )


def _certificate(design: Design, law: Law) -> Certificate | None:
    """The certificate of the loop with `law`; None without the optional package, which
    leaves the claim open.
    """
    try:
        return certify(design, law=law)
    except MissingExtraError as error:
        tell(f"the loop is not certified: {error}")
        return None


@command(export)
def fmu(
    design_file: DesignFile,
    out: Annotated[Path, "File to write, .fmu"] = Path("arm_law.fmu"),
    precision: Annotated[
        Literal["single", "double"], "Arithmetic of the law"
    ] = "single",
    compiler: Annotated[
        list[str] | None,
        option("CC"),
        "Adds a library for its platform: cc (where none is given), x86_64-w64-mingw32-gcc",
    ] = None,
    source: Annotated[bool, "C sources only, no library"] = False,
    force: bool = False,
) -> Answer:
    """Write the law as an FMU for co-simulation (FMI 3.0): Simulink, Dymola, FMPy.

    $ fraclink export fmu design.json --out arm_law.fmu
    """
    path = export_fmu(
        _of_file(design_file, motor=True)[0],
        out,
        precision=precision,
        # The default is cc: an FMU without a library for this machine would run
        # nowhere.
        compilers=() if source else compiler or ("cc",),
        force=force,
    )
    return _listed([path])


@command(export)
def arm_firmware(
    out: Annotated[Path, "Folder to write to; the sketch has its name"] = Path("arm"),
    force: bool = False,
) -> Answer:
    """Write the arm's end of a serial line for a microcontroller: a sketch with encoder,
    gauge and H-bridge, and the messages in C99.

    $ fraclink export arm-firmware --out arm
    """
    return _listed(
        export_arm_firmware(out, force=force),
        "fraclink tune --io serial:/dev/ttyACM0@1000000 --payload KG",
    )


# --- real time --------------------------------------------------------------------------------------------


@command(app)
def run_realtime(
    design_file: DesignFile,
    io: Annotated[str, Address, "serial:PORT@BAUD or udp:HOST:PORT"],
    out: Annotated[Path, "File to write the record to (npz)", Writes()] = Path(
        "realtime.npz"
    ),
    amplitude: Amplitude = None,
    move_time: Annotated[Length | None, "Time of the move; default: 1"] = None,
    reference: ReferenceFile = None,
    motor: Motor = True,
    estimate: Estimate = False,
    unsafe_remote: UnsafeRemote = False,
    key_file: KeyFile = None,
    **options: Annotated[
        Any,
        Keywords(
            lab.run_realtime,
            *("payload", "duration", "patience", "priority", "allowed_overruns"),
        ),
    ],
) -> Answer:
    """Run the shipped law on an arm in real time (Linux), with times, overruns and a
    safe stop.

    The move is made on the model first: one that trips the law there is refused. Then
    the command measures for half a second how late this machine wakes up, prints it,
    and refuses the period if more than 1 % of the wake-ups are later than one period.

    The exit code is 1 after a safe stop (the law's guards, a signal, a broken
    connection) or too many overruns; the record is written all the same. Without an
    arm: `fraclink serve-arm`.

    $ fraclink run-realtime design.json --io udp:127.0.0.1:5005
    """
    move = reference_of(reference, amplitude, move_time)
    connection = connection_of(io, unsafe_remote, key_file)
    design = load_design(design_file)
    law = _law(design, motor=motor)
    estimator = design.estimator() if estimate else None
    rehearse(design, law, move, payload=options["payload"])
    # Measured before anything is opened: an arm whose controller misses its periods
    # trips in the middle of a move.
    awake = lab.measure_wake_ups(law.period, priority=options["priority"])
    tell(str(awake))
    awake.check()
    run = lab.run_realtime(
        law,
        move,
        connection,
        out=out,
        estimator=estimator,
        **options,
    )
    remarks = _refused("priority", run.scheduling) + _refused("memory", run.memory)
    # The record may have been saved elsewhere: the arm has moved, and its data must not
    # be lost because of a full disk.
    remarks += () if run.saved == str(out) else (f"{out} could not be written",)
    return Answer(
        run,
        run.passed,
        values={"out": run.saved},
        remarks=remarks,
        written=(Path(run.saved),),
    )


def _refused(what: str, granted: str) -> tuple[str, ...]:
    if not granted.startswith("refused"):
        return ()
    return (
        f"{what}: {granted}; the loop ran without it (limits rtprio and memlock of the user)",
    )


@command(app)
def serve_arm(
    design_file: DesignFile,
    io: Annotated[str, Address, "serial:pty or udp:HOST:PORT"],
    unsafe_remote: UnsafeRemote = False,
    key_file: KeyFile = None,
    out: Annotated[
        Path | None,
        "File for the true motion of the arm (npz); default: none",
        Writes(),
    ] = None,
    payload: NominalPayload = None,
    **options: Annotated[Any, Keywords(lab.serve_arm, "duration", "watchdog", "once")],
) -> Answer:
    """Serve a simulated arm in real time, for run-realtime to move; --duration, --once
    or Ctrl-C ends it.

    The arm is the twin, run in real time. The exit code is 1 where a controller went
    silent and the watchdog had to switch the drive off.

    $ fraclink serve-arm design.json --io udp:127.0.0.1:5005 --once
    """
    connection = connection_of(io, unsafe_remote, key_file)
    design = load_design(design_file)
    arm = Twin.from_rig(design.rig, payload=payload)
    # Before serving, since the command may run for hours and later output would not be
    # read.
    for finding in arm.findings:
        tell(str(finding))
    tell(f"an arm at {connection}, {1e3 * design.rig.period:g} ms")
    with signals_held() as obeyed:
        if out is not None:
            check_ending(lab.ServedArm, output_path(out, force=True))
        served = lab.serve_arm(
            arm,
            connection,
            design.rig.period,
            begin=tell,
            **options,
        )
        # Every signal requests the end, which has been reached: a further one only has
        # to wait for the file.
        obeyed.set()
        files = () if out is None else (saved(served, out),)
    return Answer(
        served,
        served.passed,
        remarks=_refused("priority", served.scheduling),
        written=files,
    )
