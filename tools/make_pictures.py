"""Photograph the page that `fraclink report --arm` writes, for the docs, in Chromium:
`python tools/make_pictures.py`.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from dataclasses import replace
from pathlib import Path

import fraclink as fl

STATIC = Path(__file__).resolve().parent.parent / "docs" / "_static"
# The time at which the arm under its motor's PID alone swings farthest; the gauge is
# lost later, so that the ribbon shows two modes.
SETTINGS = "at=0.62&nan=310"


def main() -> None:
    """Write the picture, if there is a browser."""
    browser = shutil.which("chromium") or shutil.which("chromium-headless-shell")
    if browser is None:
        print("arm.png is left as it is: Chromium is not installed")
    else:
        photograph_arm(browser)


def photograph_arm(browser: str) -> None:
    """The page of the arm as a browser shows it, 1180 pixels wide."""
    rig = replace(fl.Rig.named("paper-2023"), name="Move the arm")
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
        )
        command = [
            browser,
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--hide-scrollbars",
            "--virtual-time-budget=2000",
        ]
        command += ["--window-size=1180,1390", f"--screenshot={STATIC / 'arm.png'}"]
        subprocess.run(  # noqa: S603
            [*command, f"{page.as_uri()}#{SETTINGS}"], check=True, capture_output=True
        )


if __name__ == "__main__":
    main()
