"""Draw the README's picture from the README's own session: `python tools/make_pictures.py`.

Left: a move of 1 rad in 0.5 s at three payloads, simulated with the law that is shipped. Right: the phase
margin that the published procedure promises, what is left of it in the loop that runs, and the same for a
design that puts the loop into the equation.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

import fraclink as fl
from fraclink._files import write_text
from fraclink._show.drawing import BLUE, GREEN, GREY, ORANGE, figure, svg
from fraclink._systems.margins import Margins

PLACE = Path(__file__).resolve().parent.parent / "docs" / "_static" / "result.svg"


def main() -> None:
    """Write the picture."""
    rig = fl.Rig.named("paper-2023")
    model = fl.identify(fl.read_log(fl.bundled_log("prbs_30g"), rig=rig), "UD-FOM").model
    ours = fl.design(model, rig, payloads=(0.020, 0.040), gain_crossover=12.0, phase_margin=fl.deg(50))
    published = fl.design(
        model,
        rig,
        payloads=(0.020, 0.040),
        gain_crossover=16.0,
        phase_margin=fl.deg(70),
        margins="ideal",
        filter_order=2,
    )
    law = fl.discretize(ours.controller, rig.period)
    with figure(9.2, 3.3) as drawing:
        tip, margin = drawing.subplots(1, 2, width_ratios=(1.25, 1))
        for color, payload in zip((BLUE, ORANGE, GREEN), (0.020, 0.030, 0.040), strict=True):
            run = fl.simulate(
                law,
                fl.smooth_step(1.0, duration=0.5),
                rig=rig,
                model=model,
                payload=payload,
                motor_loop="sampled",
                duration=2.0,
            )
            tip.plot(run.time, run.tip_angle, color=color, label=f"{1e3 * payload:g} g")
        tip.plot(run.time, run.reference, color=GREY, linestyle=(0, (4, 2)), label="reference")
        tip.set(
            xlabel="time [s]", ylabel="tip angle [rad]", xlim=(0, 2), title="One controller, three payloads"
        )
        tip.legend(loc="lower right")
        mass = np.linspace(0.008, 0.045, 40)
        for color, style, label, at in (
            (GREY, (0, (4, 2)), "published procedure: promised", published.at),
            (ORANGE, "-", "published procedure: sampled at 4 ms", published.sampled_at),
            (BLUE, "-", "fraclink: sampled at 4 ms", ours.sampled_at),
        ):
            values = [_margin(at(float(m))) for m in mass]
            margin.plot(1e3 * mass, values, color=color, linestyle=style, label=label)
        margin.axhline(0, color=GREY, linewidth=0.8)
        margin.axvspan(20, 40, color="#eef3f8", linewidth=0)
        margin.set(
            xlabel="payload [g]; shaded: designed for",
            ylabel="phase margin [°]",
            xlim=(8, 45),
            ylim=(-20, 105),
        )
        margin.set_title("What is promised, what is left")
        margin.legend(loc="upper left", fontsize=7.5)
        write_text(
            PLACE, svg(drawing, "result", "Tip angle of three payloads; phase margin against payload") + "\n"
        )


def _margin(found: Margins) -> float:
    """Phase margin [°]; negative where the closed loop is unstable."""
    angle = math.degrees(found.phase_margin)
    return angle if found.stable is not False else -abs(angle)


if __name__ == "__main__":
    main()
