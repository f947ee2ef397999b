"""Verbs that hand a design on: export c, and what else leaves the building."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from fraclink._cli.console import emit, emit_json, steps, tell
from fraclink._cli.listing import Listing
from fraclink._cli.options import Columns, Force, Json, RigName, load_log, load_rig
from fraclink._cli.outcome import FAILS, HOLDS
from fraclink._cli.verdicts import DesignFile

if TYPE_CHECKING:
    from fraclink._certify import Certificate
    from fraclink._law import Law

__all__ = ["register"]


def c(
    plan_file: DesignFile,
    out: Annotated[Path, typer.Option("--out", help="Folder to write to.")] = Path("firmware"),
    precision: Annotated[
        Literal["single", "double"], typer.Option("--precision", help="Arithmetic of the board.")
    ] = "single",
    motor: Annotated[
        bool,
        typer.Option("--motor/--no-motor", help="With the motor loop, or for a robot with its own servo."),
    ] = True,
    name: Annotated[
        str, typer.Option("--name", help="C identifier of the block of coefficients.")
    ] = "law_data",
    title: Annotated[str, typer.Option("--title", help="Text for the first comment.")] = "",
    prove: Annotated[
        bool,
        typer.Option(
            "--prove", help="Prove what the page claims; exit code 1 where something is not proved."
        ),
    ] = False,
    json: Json = False,
    force: Force = False,
) -> int:
    """Write the law as C99: the files that were simulated, the coefficients, a self-test, a page to read."""
    from fraclink._export import Proof, export_c

    shipped = _law(plan_file, motor=motor).in_precision(precision)
    with steps(2 if prove else 0) as begin:
        certificate = None
        if prove:
            begin("certifying the loop")
            certificate = _certificate(plan_file, shipped, motor=motor)
            begin("proving the files, half a minute")
        paths = export_c(
            shipped, out, name=name, title=title, prove=prove, certificate=certificate, force=force
        )
    proof = Proof.load(out / "proof.json") if prove else None
    if json:
        told: dict[str, object] = {"out": [str(path) for path in paths]}
        if proof is not None:
            told |= {"passed": proof.passed, "claims": [asdict(claim) for claim in proof.claims]}
        emit_json(told)
    else:
        emit("\n".join(map(str, (*paths, *([] if proof is None else [proof])))))
    return HOLDS if proof is None or proof.passed else FAILS


def _certificate(plan_file: Path, law: Law, *, motor: bool) -> Certificate | None:
    """The certificate of the loop that `law` closes; None, which leaves the claim open, without the extra."""
    from fraclink._certify import certify
    from fraclink._design import Design
    from fraclink.errors import MissingExtraError

    design = Design.load(plan_file)
    try:
        return certify(design, law=law, inner=None if motor else "ideal")
    except MissingExtraError as error:
        tell(f"the loop is not certified: {error}")
        return None


def _law(plan_file: Path, *, motor: bool) -> Law:
    from fraclink._design import Design

    design = Design.load(plan_file)
    # Without the motor loop the robot has its own servo, and no placement of ours reaches it.
    return design.law() if motor else design.controller.discretize(design.rig.period)


def matlab(
    plan_file: DesignFile,
    out: Annotated[Path, typer.Option("--out", help="File to write, .m or .mat.")] = Path("arm_law.m"),
    json: Json = False,
    force: Force = False,
) -> int:
    """Write the discrete law for MATLAB: a function (.m) or its numbers (.mat)."""
    from fraclink._export import export_matlab

    path = export_matlab(_law(plan_file, motor=False), out, force=force)
    emit_json({"out": str(path)}) if json else emit(str(path))
    return HOLDS


def fmu(
    plan_file: DesignFile,
    out: Annotated[Path, typer.Option("--out", help="File to write, .fmu.")] = Path("arm_law.fmu"),
    fmi: Annotated[
        Literal["2", "3"],
        typer.Option("--fmi", help="Version of the standard: 2 is what every importer reads."),
    ] = "2",
    precision: Annotated[
        Literal["single", "double"], typer.Option("--precision", help="Arithmetic of the law.")
    ] = "double",
    compiler: Annotated[
        list[str] | None,
        typer.Option(
            "--compiler",
            metavar="CC",
            help="Each adds a library for its platform: cc (where none is given), x86_64-w64-mingw32-gcc ...",
        ),
    ] = None,
    source: Annotated[bool, typer.Option("--source", help="C sources only, no library.")] = False,
    json: Json = False,
    force: Force = False,
) -> int:
    """Write the law as an FMU for co-simulation (FMI 2.0 or 3.0): Simulink, Dymola, OpenModelica, FMPy."""
    from fraclink._export import export_fmu

    path = export_fmu(
        _law(plan_file, motor=True),
        out,
        fmi=3 if fmi == "3" else 2,
        precision=precision,
        compilers=() if source else compiler or ("cc",),
        force=force,
    )
    emit_json({"out": str(path)}) if json else emit(str(path))
    return HOLDS


def io(
    out: Annotated[Path, typer.Option("--out", help="Folder to write to.")] = Path("board"),
    json: Json = False,
    force: Force = False,
) -> int:
    """Write a board to begin with, for the real-time loop: arm_io.h and a library in C that stands still."""
    from fraclink._export import export_io

    paths = export_io(out, force=force)
    emit_json({"out": [str(path) for path in paths]}) if json else emit("\n".join(map(str, paths)))
    return HOLDS


def replay(
    folder: Annotated[Path, typer.Argument(metavar="FIRMWARE", help="Folder made by `fraclink export c`.")],
    log_file: Annotated[str, typer.Argument(metavar="LOG", help="Log file, or demo for the bundled one.")],
    rig: RigName = "paper-2023",
    column: Columns = None,
    json: Json = False,
) -> int:
    """Compile an exported law and run a log through it beside the package's: bit for bit, or exit code 1."""
    from fraclink._export import replay_log

    result = replay_log(folder, load_log(log_file, load_rig(rig), None, column))
    told = {
        "passed": result.passed,
        "periods": len(result.mode),
        "first_difference": result.first_difference,
        "largest_difference": result.largest_difference,
        "last_mode": int(result.mode[-1]),
    }
    if json:
        emit_json(told)
    elif result.passed:
        emit(f"{len(result.mode)} periods: the exported law and the package agree to the last bit")
    else:
        emit(
            f"they part in period {result.first_difference}; "
            f"largest difference {result.largest_difference:.3g}"
        )
    return HOLDS if result.passed else FAILS


def register(app: typer.Typer) -> None:
    """Add the verbs of this module to the application, below `export`."""
    export = typer.Typer(cls=Listing, help="Hand a design on: C for a board, MATLAB, FMU, a board's I/O.")
    export.command()(c)
    export.command()(matlab)
    export.command()(fmu)
    export.command()(io)
    export.callback()(lambda: None)
    app.add_typer(export, name="export")
    app.command()(replay)
