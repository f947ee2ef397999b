"""Draw the pictures of README and docs: `python tools/make_pictures.py`; the arm's page
needs Chromium.

result.svg, left and middle: a move of 1 rad in 0.5 s of the twin with the law that is
shipped, at four payloads, without and with the payload as its input. Right: the phase
margin promised by the published procedure, the margin that remains in the real loop,
and the same for a design that includes the loop in its equations. arm.png: the page
that `fraclink report --arm` writes.
"""

from __future__ import annotations

import math
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np

import fraclink as fl
from fraclink._files import write_text
from fraclink._simulate import Twin
from fraclink.view._drawing import Figure, Panel, beside
from fraclink.view._marks import Across, Curve, Mark, Zone
from fraclink.view._pages import LINES
from fraclink.view._scales import Scale
from fracsys._margins import Margins

STATIC = Path(__file__).resolve().parent.parent / "docs" / "_static"
PLACE = STATIC / "result.svg"
# The time at which the arm under its motor's PID alone swings farthest; the gauge is
# lost later, so that the ribbon shows two modes.
SETTINGS = "at=0.62&nan=310"


def main() -> None:
    """Write the pictures."""
    draw_result()
    browser = shutil.which("chromium") or shutil.which("chromium-headless-shell")
    if browser is None:
        print("arm.png is left as it is: Chromium is not installed")
    else:
        photograph_arm(browser)


def photograph_arm(browser: str) -> None:
    """The page of the arm as a browser shows it, 1180 pixels wide."""
    rig = fl.Rig.named("paper-2023")
    assert rig.model is not None
    made = fl.design(
        rig.model,
        rig,
        payloads=(0.020, 0.040),
        gain_crossover=12.0,
        phase_margin=fl.deg(50),
    )
    with tempfile.TemporaryDirectory() as folder:
        page = fl.view.write_arm_page(
            fl.trials.Study(rig=rig, design=made),
            Path(folder) / "arm.html",
            title="Move the arm",
        )
        command = [
            browser,
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--hide-scrollbars",
        ]
        command += ["--window-size=1180,1390", f"--screenshot={STATIC / 'arm.png'}"]
        subprocess.run(  # noqa: S603
            [*command, f"{page.as_uri()}#{SETTINGS}"], check=True, capture_output=True
        )


def draw_result() -> None:
    """Moves of four payloads, and what is left of a margin."""
    rig = fl.Rig.named("paper-2023")
    model = rig.model
    assert model is not None
    ours = fl.design(
        model,
        rig,
        payloads=(0.020, 0.040),
        gain_crossover=12.0,
        phase_margin=fl.deg(50),
    )
    published = fl.design(
        model,
        rig,
        payloads=(0.020, 0.040),
        gain_crossover=16.0,
        phase_margin=fl.deg(70),
        margins="ideal",
        filter_order=2,
    )
    mass = np.linspace(0.008, 0.045, 40)
    marks: list[Mark] = [Zone(20.0, 40.0), Across(0.0, limit=False)]
    for line, name, at in (
        (4, "promised", published.at),
        (2, "published", published.sampled_at),
        (1, "fraclink", ours.sampled_at),
    ):
        marks.append(
            Curve(1e3 * mass, [_margin(at(float(m))) for m in mass], line, name)
        )
    panel = Panel(
        "What is promised, what is left: phase margin [°]",
        Scale(-20.0, 105.0),
        marks,
        230.0,
    )
    left = Figure(
        "margin",
        "",
        Scale(8.0, 45.0),
        (panel,),
        "payload [g]; shaded: designed for",
        width=430.0,
    )
    told, untold = _moves(told=True), _moves(told=False)
    title = (
        "Tip angle of four payloads, not given and given; phase margin against payload"
    )
    write_text(PLACE, beside([untold, told, left], title) + "\n")


def _moves(*, told: bool) -> Figure:
    """Tip angle of four payloads: link 7.35 g, friction, gauge noise, 0.05 N·m gauge
    offset.
    """
    rig = fl.Rig.named("paper-2023-geared")
    assert rig.model is not None
    request = {"gain_crossover": 12.0, "phase_margin": fl.deg(50), "filter_time": 0.02}
    law = fl.design(rig.model, rig, payloads=(0.020, 0.040), **request).law()
    move = fl.smooth_step(1.0, duration=0.5)
    marks: list[Mark] = [Zone(0.98, 1.02, lying=True)]
    for line, payload in zip(LINES, (0.008, 0.020, 0.040, 0.080), strict=True):
        arm = Twin.from_rig(rig, payload=payload)
        run = fl.simulate(
            law, move, arm=arm, gauge_offset=0.05, duration=2.0, told=told
        )
        name = f"{1e3 * payload:g} g" if told else ""
        marks.append(Curve(run.time[::4], run.tip_angle[::4], line, name))
    title = "Payload given" if told else "Payload not given"
    panel = Panel(f"{title}: tip angle [rad]", Scale(0.0, 1.4), marks, 230.0)
    return Figure(
        "moves",
        title,
        Scale(0.0, 2.0),
        (panel,),
        "time [s]",
        width=360.0 if told else 310.0,
    )


def _margin(found: Margins) -> float:
    """Phase margin [°]; negative where the closed loop is unstable."""
    angle = math.degrees(found.phase_margin)
    return angle if found.stable is not False else -abs(angle)


if __name__ == "__main__":
    main()
