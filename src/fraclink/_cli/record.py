"""Record a log of the twin: an experiment for whoever has no arm at hand."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from fraclink._cli.console import emit_json, tell
from fraclink._cli.options import Force, Json, LinkMass, Payload, RigName, load_rig
from fraclink._cli.outcome import HOLDS
from fraclink._files import output_path
from fraclink.errors import FieldError

if TYPE_CHECKING:
    from fraclink._arm.reference import Reference

__all__ = ["register"]

Excitation = Literal["prbs", "pulse", "chirp"]
LONGEST = 3600.0  # [s]: 900 000 samples at 4 ms, 30 MB of text
AT_REST = 0.5  # [s] before the excitation: an identification takes the first sample for rest


def _excitation(kind: Excitation, amplitude: float, duration: float) -> Reference:
    from fraclink._arm.reference import chirp, prbs, pulse

    if kind == "pulse":
        return pulse(amplitude, 0.35 * duration, start=AT_REST)
    if kind == "chirp":
        return chirp(amplitude, 0.2, 5.0, duration=duration)
    bit = 0.24
    return prbs(amplitude, bit, bits=max(1, int(duration / bit)), register=9, start=AT_REST)


def record(
    rig: RigName,
    out: Annotated[Path, typer.Option("--out", help="File to write the log to (CSV).")] = Path(
        "twin_log.csv"
    ),
    payload: Payload = None,
    link_mass: LinkMass = None,
    excitation: Annotated[Excitation, typer.Option("--excitation", help="Motor reference.")] = "prbs",
    amplitude: Annotated[float, typer.Option("--amplitude", help="Size of the excitation [rad].")] = 0.1,
    duration: Annotated[float, typer.Option("--duration", help="Length of the log [s].")] = 20.0,
    gauge_delay: Annotated[
        float, typer.Option("--gauge-delay", help="Delay of the strain amplifier [s], whole milliseconds.")
    ] = 0.0,
    seed: Annotated[int, typer.Option("--seed", help="Seed of the gauge's noise.")] = 0,
    json: Json = False,
    force: Force = False,
) -> int:
    """Record a log of the twin, in the same CSV a rig writes, marked as simulated."""
    import numpy as np

    from fraclink._simulate import Twin, simulate_log

    place = output_path(out, force=force)
    known = load_rig(rig)
    if not 2.0 <= duration <= LONGEST:
        raise FieldError(
            "duration", duration, "out of range", allowed=f"2 to {LONGEST:g} s", remedy="20 s is usual"
        )
    arm = Twin.from_rig(known, payload=payload, link_mass=link_mass, gauge_delay=gauge_delay)
    reference = _excitation(excitation, amplitude, duration)
    count = round(duration / known.period) + 1
    log = simulate_log(
        arm.beam,
        arm.damping,
        reference.angle(known.period * np.arange(count)),
        period=known.period,
        sensors=arm.sensors,
        servo_pole=known.inner.pole,
        seed=seed,
    )
    log.save(place)
    if json:
        emit_json({"out": str(place), "samples": count, "header": dict(log.header)})
    else:
        tell(f"written: {place} ({count} samples, simulated)")
    return HOLDS


def register(app: typer.Typer) -> None:
    """Add the verb of this module to the application."""
    app.command()(record)
