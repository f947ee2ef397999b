"""Draw the pictures of README and docs: `python tools/make_pictures.py`; the arm's page needs Chromium.

result.svg, left and middle: a move of 1 rad in 0.5 s of the twin with the law that is shipped, at four
payloads, without and with the payload as its input. Right: the phase margin that the published procedure
promises, what is left of it in the loop that runs, and the same for a design that puts the loop into the
equation. arm.png: the page that `fraclink share` writes.
"""

from __future__ import annotations

import math
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

import fraclink as fl
from fraclink._files import write_text
from fraclink._show.axes import BLUE, GREY, LINES, ORANGE, figure, svg
from fraclink._simulate import Twin
from fraclink._systems.margins import Margins

STATIC = Path(__file__).resolve().parent.parent / "docs" / "_static"
PLACE = STATIC / "result.svg"
# In the middle of the move; the gauge is lost half a second later, so that the ribbon shows two modes.
SETTINGS = "at=0.15&nan=140"


def main() -> None:
    """Write the pictures."""
    draw_result()
    browser = shutil.which("chromium")
    if browser is None:
        print("arm.png is left as it is: Chromium is not installed")
    else:
        photograph_arm(browser)


def photograph_arm(browser: str) -> None:
    """The page of the arm as a browser shows it, 1180 pixels wide."""
    rig = fl.Rig.named("paper-2023")
    assert rig.model is not None
    made = fl.design(rig.model, rig, payloads=(0.020, 0.040), gain_crossover=12.0, phase_margin=fl.deg(50))
    with tempfile.TemporaryDirectory() as folder:
        page = fl.write_arm_page(
            fl.Study(rig=rig, design=made), Path(folder) / "arm.html", title="Move the arm"
        )
        command = [browser, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"]
        command += ["--window-size=1180,1390", f"--screenshot={STATIC / 'arm.png'}"]
        subprocess.run([*command, f"{page.as_uri()}#{SETTINGS}"], check=True, capture_output=True)  # noqa: S603


def draw_result() -> None:
    """Moves of four payloads, and what is left of a margin."""
    rig = fl.Rig.named("paper-2023")
    model = rig.model
    assert model is not None
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
    with figure(10.5, 3.3) as drawing:
        *moves, margin = drawing.subplots(1, 3, width_ratios=(1, 1, 1.2))
        for tip, told in zip(moves, (False, True), strict=True):
            _draw_moves(tip, told=told)
        moves[1].sharey(moves[0])
        moves[1].legend(loc="lower right")
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
        title = "Tip angle of four payloads, not given and given; phase margin against payload"
        write_text(PLACE, svg(drawing, "result", title) + "\n")


def _draw_moves(tip: Axes, *, told: bool) -> None:
    """Tip angle of four payloads: link 7.35 g, friction, gauge noise, 0.05 N·m gauge offset."""
    rig = fl.Rig.named("paper-2023-geared")
    assert rig.model is not None
    request = {"gain_crossover": 12.0, "phase_margin": fl.deg(50), "filter_time": 0.02}
    law = fl.design(rig.model, rig, payloads=(0.020, 0.040), **request).law()
    move = fl.smooth_step(1.0, duration=0.5)
    for line, payload in zip(LINES, (0.008, 0.020, 0.040, 0.080), strict=True):
        arm = Twin.from_rig(rig, payload=payload)
        run = fl.simulate(law, move, arm=arm, gauge_offset=0.05, duration=2.0, told=told)
        tip.plot(run.time[::4], run.tip_angle[::4], **line, label=f"{1e3 * payload:g} g")
    tip.axhspan(0.98, 1.02, color="#eef3f8", linewidth=0)
    title = "Payload given" if told else "Payload not given"
    tip.set(xlabel="time [s]", ylabel="tip angle [rad]", xlim=(0, 2), ylim=(0, 1.4), title=title)


def _margin(found: Margins) -> float:
    """Phase margin [°]; negative where the closed loop is unstable."""
    angle = math.degrees(found.phase_margin)
    return angle if found.stable is not False else -abs(angle)


if __name__ == "__main__":
    main()
