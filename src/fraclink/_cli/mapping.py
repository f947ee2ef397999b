"""The map of what can be asked for: `design-map` writes it as a figure and as numbers."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import typer

from fraclink._cli.console import emit, emit_json
from fraclink._cli.figures import save_axes
from fraclink._cli.options import Force, Json, PayloadRange, RigName, load_rig
from fraclink._cli.outcome import FAILS, HOLDS
from fraclink._files import output_path, write_json
from fraclink.errors import FieldError

if TYPE_CHECKING:
    from fraclink._design.alternatives import FeasibilityMap

__all__ = ["register"]

_KINDS = (".svg", ".png")
_NOISE = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 300.0)
_SETTLING = (0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6, 0.8)


def draw(found: FeasibilityMap, path: Path) -> None:
    """Draw β in colour where a controller exists, with contours of noise gain and settling time."""

    def fill(axis: Any) -> None:
        grid = (found.gain_crossover, np.degrees(found.phase_margin))
        shade = axis.pcolormesh(*grid, np.ma.masked_invalid(found.order), cmap="Blues", shading="nearest")
        axis.figure.colorbar(shade, ax=axis, label="β")
        noise = axis.contour(*grid, np.ma.masked_invalid(found.noise_gain), _NOISE, colors="#c0392b")
        axis.clabel(noise, fmt="noise %g", fontsize=8)
        settling = axis.contour(*grid, np.ma.masked_invalid(found.settling_time), _SETTLING, colors="#444444")
        axis.clabel(settling, fmt="%g s", fontsize=8)
        axis.set(
            xlabel="gain crossover ω_c at the heaviest payload [rad/s]",
            ylabel="phase margin at the lightest payload [°]",
            title="Feasible requests; red: noise gain, grey: 2π/ω_c",
        )
        axis.set_facecolor("#f4f4f4")

    save_axes(path, fill)


def design_map(
    rig: RigName,
    out: Annotated[
        Path, typer.Option("--out", help="Figure, .svg or .png; a .json with the numbers lies beside it.")
    ] = Path("design-map.svg"),
    payloads: PayloadRange = None,
    points: Annotated[int, typer.Option("--points", min=5, max=400, help="Values on each axis.")] = 80,
    crossovers: Annotated[
        tuple[float, float], typer.Option("--crossovers", metavar="LOW HIGH", help="Range of ω_c [rad/s].")
    ] = (8.0, 45.0),
    filter_time: Annotated[
        float | None, typer.Option("--filter-time", help="δ [s], 0 for none; default: the 10 % rule.")
    ] = None,
    filter_order: Annotated[
        int, typer.Option("--filter-order", help="n, 1 or 2, the same for the whole map.")
    ] = 1,
    inner: Annotated[Literal["ideal", "sampled"], typer.Option("--inner", help="Motor loop.")] = "ideal",
    placement: Annotated[
        Literal["tustin", "direct"], typer.Option("--placement", help="Poles of the sampled motor loop.")
    ] = "tustin",
    json: Json = False,
    force: Force = False,
) -> int:
    """Map which crossovers and margins are feasible, with noise and settling contours."""
    from fraclink._design.alternatives import feasibility_map
    from fraclink._workflow.request import model_of

    if out.suffix.lower() not in _KINDS:
        allowed, remedy = " or ".join(_KINDS), "end the figure's name in one of these"
        raise FieldError("out", out.name, "of another kind", allowed=allowed, remedy=remedy)
    low, high = crossovers
    if not low < high:
        remedy = f"say --crossovers {high:g} {low:g}" if high < low else "give two different numbers"
        allowed = "low < high"
        raise FieldError("crossovers", crossovers, "no range", allowed=allowed, remedy=remedy)
    place = output_path(out, force=force)
    numbers = output_path(place.with_suffix(".json"), force=force)
    arm = load_rig(rig)
    found = feasibility_map(
        model_of(arm, None),
        arm,
        payloads=payloads,
        gain_crossovers=np.linspace(low, high, points),
        phase_margins=np.radians(np.linspace(10.0, 110.0, points)),
        filter_time=filter_time,
        filter_order=filter_order,
        inner=inner,
        placement=placement,
    )
    draw(found, place)
    names = ("gain", "order", "upper", "filter_time", "settling_time", "noise_gain")
    values: dict[str, object] = {
        name: [[None if math.isnan(x) else x for x in row] for row in getattr(found, name).tolist()]
        for name in names
    }
    values |= {"gain_crossover": found.gain_crossover.tolist(), "phase_margin": found.phase_margin.tolist()}
    write_json(numbers, "design-map", 1, values)
    share = float(np.mean(found.feasible))
    told = {"feasible": share, "out": [str(place), str(numbers)]}
    emit_json(told) if json else emit(f"{100 * share:.0f} % of the map is feasible\n{place}\n{numbers}")
    return HOLDS if share > 0.0 else FAILS


def register(app: typer.Typer) -> None:
    """Add the verb to the application."""
    app.command(name="design-map")(design_map)
