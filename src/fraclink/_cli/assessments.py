"""Commands that say what a design is worth: assess, compare."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, get_args

from fraclink._cli.app import group
from fraclink._cli.command import Answer, Keywords, Writes, argument, command, option
from fraclink._cli.console import steps
from fraclink._cli.options import (
    DesignFile,
    in_seconds,
    load_design,
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
from fraclink._display import Overview, Row, Table, quantity, rows_of
from fraclink._files import save
from fraclink._identify.expression import parse_expression
from fraclink._identify.structure_fit import StructureFit
from fraclink.errors import FieldError
from fraclink.trials._tournament import compare as run_rivals
from fraclink.view._tables import budget_table
from fracsys._fractional import FractionalTransferFunction
from fracsys.checks import PhaseMarginDeg, above

app = group()


@dataclass(frozen=True)
class Assessment:
    """What a design is worth: phase budget, margins, higher modes; it passes only if
    the design itself does.
    """

    design: Design
    payloads: tuple[float, ...]
    budget: tuple[PhaseShare, ...]
    curves: tuple[MarginCurve, ...]
    modes: tuple[Requirement, ...]

    @property
    def passed(self) -> bool:
        """Whether the design passed, and the loop gain at every higher mode keeps its
        bound.
        """
        return self.design.passed and all(item.passed for item in self.modes)

    def overview(self) -> Overview:
        """The least margin, the phase budget, and the margins of every kind of loop."""
        margins = (
            (
                Row("", "phase margin", curve.kind),
                *(
                    Row("", quantity(payload, "g", 3), float(margin), "rad")
                    for payload, margin in zip(
                        self.payloads, curve.phase_margin, strict=True
                    )
                ),
            )
            for curve in self.curves
        )
        rows = rows_of(
            self,
            Row("phase_budget", "", {s.element: s.phase for s in self.budget}),
            Row("phase_margin", "", {c.kind: c.phase_margin for c in self.curves}),
            "payloads",
        )
        massless = (
            "higher modes: none, as the link has no mass: state mass_kg in the rig"
        )
        sampled = next(curve for curve in self.curves if curve.kind == "sampled")
        least = quantity(float(min(sampled.phase_margin)), "rad")
        spillover = not all(item.passed for item in self.modes)
        return Overview(
            f"at least {least} of phase margin in the sampled loop",
            "failed" if spillover else self.design.overview().state,
            rows,
            (
                Table.of("spillover", self.modes),
                budget_table(self.budget, self.payloads[-1]),
                Table.of("", margins),
            ),
            findings=self.design.findings,
            notes=() if self.modes else (massless,),
        )


@command(app)
def assess(
    design_file: DesignFile,
    mode_damping: Annotated[
        float | None, "Damping ratio of modes 2 and 3; default: the model's damping"
    ] = None,
) -> Answer:
    """Assess a design: phase budget, margins, higher modes.

    $ fraclink assess design.json
    """
    design = Design.load(design_file)
    low, high = design.payloads
    # Both ends and their geometric mean, at which ω₀ ∝ 1/√m also has its geometric
    # mean.
    payloads = (high, math.sqrt(low * high), low)
    assessment = Assessment(
        design,
        payloads,
        tuple(phase_budget(design, low)),
        tuple(
            margin_curve(design, payloads, kind=kind) for kind in get_args(CurveKind)
        ),
        tuple(mode_gains(design, damping_ratio=mode_damping)),
    )
    return Answer(assessment, assessment.passed)


@command(app)
def compare(
    design_file: DesignFile,
    out: Annotated[Path, "File to write the comparison to", Writes()] = Path(
        "comparison.json"
    ),
    only: Annotated[
        list[str] | None,
        option("TEXT"),
        "Run only the rivals whose name contains this",
    ] = None,
) -> Answer:
    """Run a design and its rivals on one twin, each tuned by a stated rule.

    $ fraclink compare design.json --only LQG --only PD
    """
    with steps(6) as begin:
        result = run_rivals(
            load_design(design_file),
            names=only or None,
            progress=begin,
        )
    save(result, out, force=True)
    return Answer(result, result.standings[0].passed, written=(out,))


# --- a fractional PID for any plant -----------------------------------------------------------------------


@command(app)
def tune_pid(
    plant: Annotated[
        str,
        argument("PLANT"),
        'Transfer function, such as "2/(0.4*s**1.5 + 1)*exp(-0.05*s)", or a file of `identify --structure`',
    ],
    phase_margin_deg: Annotated[PhaseMarginDeg, "Phase margin at the crossover"] = 60.0,
    period_ms: Annotated[
        float | None,
        above(0.0, 1e6, "ms"),
        "Period of the law, counted as delay",
    ] = None,
    out: Annotated[Path, "File to write the tuning to", Writes()] = Path("pid.json"),
    **wanted: Annotated[
        Any,
        Keywords(
            pid_for,
            *("gain_crossover", "gain_margin", "max_sensitivity", "flat_phase", "form"),
            *("integral_order", "derivative_order", "filter_time"),
            *("output_limit", "measurement_limit"),
        ),
    ],
) -> Answer:
    """Tune a fractional PID for any plant: margins met, phase flat, least ITAE; export
    takes the file.

    $ fraclink tune-pid "1/(0.4*s**1.5 + 1)" --gain-crossover 2
    """
    tuning = pid_for(
        _plant(plant),
        phase_margin=math.radians(phase_margin_deg),
        period=in_seconds(period_ms),
        **wanted,
    )
    options = {
        "--period-ms": tuning.period,
        "--output-limit": tuning.output_limit,
        "--measurement-limit": tuning.measurement_limit,
    }
    # A law needs a period and limits, which the formula of the plant does not contain:
    # a tuning without them is complete, but cannot ship yet.
    missing = ", ".join(name for name, value in options.items() if not value)
    export = f"fraclink export c {out} --out firmware"
    again = f"the same with {missing}, then {export}"
    return Answer(
        tuning,
        tuning.passed,
        saved={out: tuning},
        following=again if missing else export,
    )


def _plant(text: str) -> FractionalTransferFunction:
    """The plant from a file, or from a formula in which every value is a number."""
    if text.endswith(".json"):
        return StructureFit.load(text).transfer_function
    expression = parse_expression(text)
    if expression.names:
        raise FieldError(
            "plant",
            ", ".join(expression.names),
            "unknown",
            "numbers and s",
            "write numbers, or give the file of `identify --structure`, which finds them",
        )
    return expression.function({})
