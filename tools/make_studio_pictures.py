"""Draw the pictures of the studio in docs/_static, in Chromium.

    python tools/make_studio_pictures.py

The log is a bundled one with two corrupted readings near its end, so that a finding has
a location in it, and the kept part begins at rest.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import fraclink as fl

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from browser import Page, browser  # in the folder of the tests  # noqa: E402

STATIC = ROOT / "docs" / "_static"


def spoilt(place: Path) -> Path:
    """A log with two readings far outside the range of the others."""
    lines = fl.bundled_log("prbs_30g").read_text("utf-8").splitlines()
    first = next(k for k, line in enumerate(lines) if line[:1].isdigit())
    for row in (first + 4100, first + 4101):
        lines[row] = ",".join([*lines[row].split(",")[:-1], "9.9"])
    place.write_text("\n".join(lines) + "\n", "utf-8")
    return place


def pictures(page: Page, address: str) -> None:
    """From the log to the board; a picture where there is something new to see."""
    page.look(height=960)
    page.open(address)
    page.key("2")
    page.until("document.querySelector('.slot.set')", "the channels")
    page.run("document.querySelector('#read').click()")
    page.until("document.querySelector('.flag')", "a finding at its time")
    page.run("document.querySelector('#replay-at').value = 430")
    page.run("document.querySelector('#replay-at').dispatchEvent(new Event('input'))")
    page.drag("#h-cut-1", (-260, 0))
    time.sleep(4.5)  # until the notification has disappeared
    page.picture(STATIC / "studio-channels.png")
    page.run("document.querySelector('#cut-keep').click()")
    page.until(
        "document.querySelector('#command').textContent.includes('--keep')",
        "the stretch",
    )
    page.key("3")
    page.run("document.querySelector('#fit').click()")
    page.until("document.querySelectorAll('.model').length === 4", "four fits")
    time.sleep(4.5)
    page.look(height=960, dark=True)
    time.sleep(0.6)
    page.picture(STATIC / "studio-dark.png")
    page.look(height=960)
    page.key("4")
    page.until(
        "document.querySelector('#go-design').dataset.mark !== 'not run'", "a design"
    )
    for number, (handle, by) in enumerate(
        (("#h-margin-phase", (0, 3)), ("#h-payload-0", (8, 0))), 2
    ):
        page.drag(handle, by, moves=4)
        page.until(
            f"document.querySelectorAll('.thumb').length >= {number}", "another state"
        )
        page.until(
            "!document.querySelector('#controller').classList.contains('preview')",
            "its design",
        )
    page.run("document.querySelector('.thumb .chip').click()")
    page.until("document.querySelector('.curve.other')", "a state over this one")
    page.until(
        "!document.querySelector('#controller').classList.contains('preview')",
        "an exact design",
    )
    page.until("document.querySelector('#p-map .cells')?.getAttribute('d')", "the map")
    time.sleep(1.0)
    page.picture(STATIC / "studio.png", whole=True)
    page.look(height=960)
    page.key("6")
    page.run("document.querySelector('#arms').click()")
    page.until("document.querySelector('#p-fan .fan')", "moves of arms")
    time.sleep(0.6)
    page.picture(STATIC / "studio-proof.png", whole=True)


def main() -> None:
    """Open a studio on the log and draw."""
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        words = [
            "studio",
            spoilt(place / "arm.csv").name,
            "--no-open",
            "--rig",
            "paper-2023-geared",
        ]
        command = [sys.executable, "-m", "fraclink", *words]
        process = subprocess.Popen(  # noqa: S603
            command, cwd=place, stdout=subprocess.PIPE, text=True
        )
        try:
            assert process.stdout is not None
            address = process.stdout.readline().strip()
            with browser(place) as page:
                pictures(page, address)
        finally:
            process.kill()
            process.communicate()


if __name__ == "__main__":
    main()
