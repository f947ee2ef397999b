"""Commands that say what a design is worth: assess, compare."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal, TypedDict, Unpack

import numpy as np
import typer

from fraclink._cli.app import group
from fraclink._cli.command import Answer, Default, Writes, command
from fraclink._cli.console import steps
from fraclink._cli.options import (
    DesignFile,
    FilterTime,
    LinkMass,
    ModelFile,
    RigName,
    SeedNumber,
    load_link_model,
    load_rig,
)
from fraclink._design import Design, Requirement
from fraclink._design.assess import (
    CurveKind,
    MarginCurve,
    PhaseShare,
    margin_curve,
    mode_gains,
    phase_budget,
)
from fraclink._design.pid import tune_pid as pid_for
from fraclink._files import write_json, write_text
from fraclink._identify.expression import parse_expression
from fraclink._identify.structure_fit import StructureFit
from fraclink.errors import FieldError
from fraclink.trials._tournament import compare as run_rivals
from fraclink.view._loops import budget_figure, margin_curves_figure
from fraclink.view._records import to_json
from fracsys._fractional import FractionalTransferFunction
from fracsys.checks import Between, Frequency, PhaseMarginDeg

app = group()

_KINDS: tuple[CurveKind, ...] = ("ideal", "motor", "loop", "sampled")
_FIGURES, _NUMBERS = ("margins.svg", "phase-budget.svg"), "assessment.json"
_COMPARISON = ("comparison.md", "comparison.json", "comparison.svg")
_POINTS = (
    41  # payloads of a curve: the sampled margins take most of the second it costs
)


@dataclass(frozen=True)
class Assessment:
    """What a design is worth: phase budget, margins, higher modes."""

    payloads: tuple[float, ...]
    budget: tuple[PhaseShare, ...]
    curves: tuple[MarginCurve, ...]
    modes: tuple[Requirement, ...]

    @property
    def passed(self) -> bool:
        """Whether the loop gain at every higher mode keeps its bound."""
        return all(item.passed for item in self.modes)


@command(app)
def assess(
    design_file: DesignFile,
    link_mass: LinkMass = None,
    mode_damping: Annotated[
        float | None, "Damping ratio of modes 2 and 3; default: the model's damping"
    ] = None,
    out: Annotated[
        Path | None,
        "Folder to write two figures and assessment.json to",
        Writes((*_FIGURES, _NUMBERS)),
    ] = None,
) -> Answer:
    """Assess a design: phase budget, margins, higher modes.

    $ fraclink assess design.json --link-mass 0.00735
    """
    made = Design.load(design_file)
    low, high = made.payloads
    # Both ends and what lies between on the scale of ω₀ ∝ 1/√m.
    payloads = (high, math.sqrt(low * high), low)
    curves = tuple(margin_curve(made, payloads, kind=kind) for kind in _KINDS)
    link = (
        made.rig.link if link_mass is None else replace(made.rig.link, mass=link_mass)
    )
    found = Assessment(
        payloads,
        tuple(phase_budget(made, low)),
        curves,
        tuple(
            mode_gains(
                replace(made, rig=replace(made.rig, link=link)),
                damping_ratio=mode_damping,
            )
        ),
    )
    if out is None:
        return Answer(found, found.passed)
    _write_assessment(found, made, out)
    written = tuple(out / name for name in (*_FIGURES, _NUMBERS))
    return Answer(found, found.passed, values={"out": str(out)}, written=written)


def _write_assessment(found: Assessment, made: Design, out: Path) -> None:
    low, high = made.payloads
    # Beyond both ends, as the first question behind a design is what a payload outside
    # its range does.
    masses = np.geomspace(low / 2.5, 1.25 * high, _POINTS)
    curves = [margin_curve(made, masses, kind=kind) for kind in _KINDS]
    margin_curves_figure(curves, (low, high), made.phase_margin).save(out / _FIGURES[0])
    budget_figure(found.budget, low).save(out / _FIGURES[1])
    shown = {"payload": masses.tolist()} | {
        c.kind: c.phase_margin.tolist() for c in curves
    }
    write_json(out / _NUMBERS, "assessment", 1, to_json(found) | {"curves": shown})


@command(app)
def compare(
    rig: RigName,
    out: Annotated[
        Path, "Folder for table, figure and figures as JSON", Writes(_COMPARISON)
    ] = Path("comparison"),
    only: Annotated[
        list[str] | None,
        typer.Option(metavar="TEXT"),
        "Run rivals whose name contains this",
    ] = None,
    model: ModelFile = None,
    link_mass: LinkMass = None,
    gain_crossover: Annotated[
        float, "Crossover of the design by fraclink [rad/s]"
    ] = 12.0,
    phase_margin_deg: Annotated[
        PhaseMarginDeg, "Phase margin of the design by fraclink"
    ] = 45.0,
    filter_time: FilterTime = None,
    seed: SeedNumber = 0,
) -> Answer:
    """Run the design and its rivals on one twin, each tuned by a stated rule.

    $ fraclink compare --rig paper-2023 --only fraclink --only PD
    """
    known = load_rig(rig)
    with steps(15) as begin:
        result = run_rivals(
            known,
            model=load_link_model(model, known),
            link_mass=link_mass,
            gain_crossover=gain_crossover,
            phase_margin=math.radians(phase_margin_deg),
            filter_time=filter_time,
            names=only or None,
            seed=seed,
            progress=begin,
        )
    table = out / "comparison.md"
    write_text(table, result.markdown())
    result.save(out / "comparison.json")
    result.draw(out / "comparison.svg")
    return Answer(
        result, result.standings[0].passed, values={"out": str(out)}, written=(table,)
    )


# --- a fractional PID for any plant -----------------------------------------------------------------------


class PidOptions(TypedDict):
    """What `tune_pid` is asked for, in its own names."""

    gain_crossover: Annotated[Frequency | None, "ω_c [rad/s]; default: by ITAE"]
    gain_margin: Annotated[float | None, "Least gain margin, a factor above 1"]
    max_sensitivity: Annotated[
        float | None, "Bound on Ms; default: 2 where ω_c is free"
    ]
    flat_phase: Annotated[
        bool, "Phase flat at the crossover, against changes of the gain", Default(True)
    ]
    form: Annotated[
        Literal["PI", "PD", "PID"], "Parts of the controller", Default("PID")
    ]
    integral_order: Annotated[
        float | None, "λ where it is given; 1 for an ordinary integral"
    ]
    derivative_order: Annotated[float | None, "μ where it is given"]
    filter_time: Annotated[
        float | None, "T_f of the derivative [s]; default: 1/(20 ω_c)"
    ]
    horizon: Annotated[
        float | None, "Time over which ITAE is taken [s]; default: 40/ω_c"
    ]
    output_limit: Annotated[float | None, "Largest output, for the law"]
    measurement_limit: Annotated[
        float | None, "Largest credible reference and measurement, for the law"
    ]


@command(app)
def tune_pid(
    plant: Annotated[
        str,
        typer.Argument(metavar="PLANT"),
        'Transfer function, such as "2/(0.4*s**1.5 + 1)*exp(-0.05*s)", or a file of identify-structure',
    ],
    phase_margin_deg: Annotated[PhaseMarginDeg, "Phase margin at the crossover"] = 60.0,
    period_ms: Annotated[
        float | None,
        Between(0.0, 1e6, "ms", low_open=True),
        "Period of the law, counted as delay",
    ] = None,
    out: Annotated[Path, "File to write the tuning to", Writes()] = Path("pid.json"),
    **wanted: Unpack[PidOptions],
) -> Answer:
    """Tune a fractional PID for any plant: margins met, phase flat, least ITAE; export
    takes the file.

    $ fraclink tune-pid "1/(0.4*s**1.5 + 1)" --gain-crossover 2
    """
    made = pid_for(
        _plant(plant),
        phase_margin=math.radians(phase_margin_deg),
        period=None if period_ms is None else period_ms / 1e3,
        **wanted,
    )
    made.save(out)
    needed = {
        "--period-ms": made.period,
        "--output-limit": made.output_limit,
        "--measurement-limit": made.measurement_limit,
    }
    # A law needs a period and limits that the plant's formula does not hold: a tuning
    # without them is whole, and cannot be shipped yet.
    missing = ", ".join(name for name, value in needed.items() if not value)
    export = f"fraclink export c {out} --out firmware"
    again = f"the same with {missing}, then {export}"
    return Answer(
        made, made.passed, written=(out,), following=again if missing else export
    )


def _plant(text: str) -> FractionalTransferFunction:
    """The plant of a file, or of a formula in which every value is a number."""
    if text.endswith(".json"):
        return StructureFit.load(text).transfer_function
    expression = parse_expression(text)
    if expression.names:
        allowed = "numbers and s"
        remedy = (
            "write numbers, or give the file of identify-structure, which finds them"
        )
        raise FieldError(
            "plant",
            ", ".join(expression.names),
            "unknown",
            allowed=allowed,
            remedy=remedy,
        )
    return expression.function({})
