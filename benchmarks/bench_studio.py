"""The studio in Chromium: how soon a drag is seen, what it costs, sizes, start,
memory.

Pointer to painted: from the event's own time stamp to the frame after its drawing, for
moves every 16 ms.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import fraclink as fl
from fraclink.studio._preview import Subject, preview
from harness import line, sizes

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from browser import Page, browser

DRAGS = (
    ("#h-crossover", (10, 0)),
    ("#h-margin-phase", (0, 10)),
    ("#h-payload-0", (25, 0)),
)
# Frames in two seconds, halved.
FRAMES = """new Promise((done) => {
  let n = 0, begin = 0;
  const count = (now) => {
    begin ||= now;
    if (now - begin > 2000) done(n / 2);
    else { n++; requestAnimationFrame(count); }
  };
  requestAnimationFrame(count);
})"""
# The times [ms] of each drag's request: sent, its answer arrived, its answer drawn. The
# page sends its token first, when its own listener is set: a listener added then runs
# after it, and after all that it draws.
TIMES = """
const RequestSocket = WebSocket;
const times = window.times = [];
const preview = (data) => typeof data === 'string' && data.includes('"verb":"preview"');
let sent = null, arrived = null;
window.WebSocket = class extends RequestSocket {
  constructor(...given) {
    super(...given);
    this.addEventListener('message', () => {
      arrived = sent && [sent, performance.now()];
      sent = null;
    });
  }
  send(data) {
    if (!this.listened) {
      this.listened = true;
      this.addEventListener('message', () => {
        if (arrived) times.push([...arrived, performance.now()]);
      });
    }
    super.send(data);
    if (preview(data)) sent = performance.now();
  }
};
"""
# Bytes of each of the studio's own scripts as sent and unpacked; the arm's script
# belongs to the shared page.
SCRIPTS = """performance.getEntriesByType('resource')
  .filter(({name}) => name.endsWith('.js') && !name.endsWith('arm_box.js'))
  .map((script) => [script.encodedBodySize, script.decodedBodySize])"""
PHASES = ("until sent", "until answered", "until drawn", "until the frame")


def previews(count: int) -> None:
    """CPU time of Python for a drag of each handle."""
    rig = fl.Rig.named("paper-2023")
    made = fl.design(
        rig.model, rig, gain_crossover=12.0, phase_margin=fl.deg(50), law=False
    )
    subject = Subject(rig, rig.model, made.law())
    begun = {
        "gain_crossover": 12.0,
        "phase_margin_deg": 50.0,
        "payloads": [0.02, 0.04],
    }
    places = np.linspace(0.0, 1.0, count)
    moved: dict[str, list[object]] = {
        "gain_crossover": [12.0 + 2.0 * place for place in places],
        "phase_margin_deg": [50.0 - 10.0 * place for place in places],
        "payloads": [[0.02 + 0.01 * place, 0.04] for place in places],
    }
    for handle, values in moved.items():
        taken, near = [], made.controller
        for k, value in enumerate(values):
            begin = time.process_time()
            answer, near = preview(subject, {**begun, handle: value}, near=near)
            size = len(answer.packed(k, "preview"))
            taken.append(1e3 * (time.process_time() - begin))
        took = f"{np.median(taken):.1f} ms, p95 {np.quantile(taken, 0.95):.1f} ms"
        name = f"Python CPU a drag, {handle}"
        line(name, took, "<= 8 ms", note=f"{size} bytes a drag")


def started(place: Path) -> tuple[subprocess.Popen[str], str, float]:
    begin = time.perf_counter()
    command = [
        sys.executable,
        "-m",
        "fraclink",
        "studio",
        "--no-open",
        "--out",
        str(place / "results"),
    ]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)  # noqa: S603
    assert process.stdout is not None
    return process, process.stdout.readline().strip(), time.perf_counter() - begin


def memory(process: int) -> float:
    """Resident memory [MB]."""
    text = Path(f"/proc/{process}/status").read_text()
    return int(re.search(r"VmRSS:\s+(\d+)", text)[1]) / 1e3


def cpu(process: int) -> float:
    """Processor seconds that a process has used."""
    fields = Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / 100.0


def drags(page: Page, process: int, moves: int) -> None:
    for handle, by in DRAGS:
        page.run("performance.clearMeasures('drag'); times.length = 0")
        before = cpu(process)
        took = page.drag(handle, by, moves=moves)
        used = cpu(process) - before
        page.until(
            "!document.querySelector('#controller').classList.contains('preview')",
            "an exact design",
        )
        assert page.run("document.querySelector('#refused').hidden"), (
            "a drag to where nothing is feasible"
        )
        drawn = page.run(
            "performance.getEntriesByName('drag').map(e => [e.startTime, e.duration])"
        )
        seen = [duration for _, duration in drawn]
        wanted = "<= 30 ms, p95 <= 50 ms; at load 8 <= 70, 150 ms; >= 20 redraws/s"
        if not seen:  # too few moves for a frame between them, or a page that hangs
            line(f"pointer to painted, {handle}", "no redraw seen", wanted, False)
            continue
        median, late = np.median(seen), np.quantile(seen, 0.95)
        value = f"{median:.0f} ms, p95 {late:.0f} ms; {len(seen) / took:.0f} redraws/s"
        load = float(Path("/proc/loadavg").read_text().split()[0])
        cost = 1e3 * used / max(len(seen), 1)
        line(
            f"pointer to painted, {handle}",
            value,
            wanted,
            note=f"server {cost:.1f} ms a redraw, load {load:.1f}",
        )
        # one row of five times for each redraw: the event, the three of TIMES, and the
        # frame
        moments = [
            [begin, *times, begin + duration]
            for (begin, duration), times in zip(drawn, page.run("times"), strict=False)
        ]
        shares = np.median(np.diff(moments), axis=0)
        phases = ", ".join(
            f"{name} {share:.1f}" for name, share in zip(PHASES, shares, strict=True)
        )
        line(f"its phases [ms], {handle}", phases, "told")


def in_browser(place: Path, moves: int) -> None:
    """Start, first curves, drags and frames in Chromium."""
    process, address, start = started(place)
    try:
        line("start, to the printed address", f"{start:.2f} s", "<= 1.5 s")
        with browser(place) as page:
            page.look()
            page.do("Page.addScriptToEvaluateOnNewDocument", source=TIMES)
            page.open(address)  # once for the browser's profile
            page.until("document.querySelector('#h-crossover')")
            begin = time.perf_counter()
            page.open(address)
            page.until("document.querySelector('#p-gain .curve')?.getAttribute('d')")
            curves = time.perf_counter() - begin
            line("first curves", f"{curves:.2f} s", "<= 1.5 s")
            served, decoded = np.sum(page.run(SCRIPTS), axis=0) / 1e3
            value = f"{served:.1f} kB, {decoded:.1f} kB unpacked"
            line("own scripts as served", value, "<= 60 kB")
            page.until("document.querySelector('.armbox')")
            # Not measured: the first drag of a new engine.
            page.drag("#h-margin-phase", (0, 4), moves=moves)
            time.sleep(1.0)
            drags(page, process.pid, moves)
            rate = f"{page.run(FRAMES):.0f} /s"
            line("frames while the arm moves", rate, "60 /s")
            complaints = "; ".join(page.complaints)[:200]
            line("complaints of the console", complaints or "none", "none")
        line("memory of the server", f"{memory(process.pid):.0f} MB", "<= 200 MB")
    finally:
        process.kill()


def main() -> None:
    given = sizes(__doc__, moves=(100, 10), previews=(200, 2))
    previews(given.previews)
    if shutil.which("chromium-headless-shell") is None:
        line("the page", "chromium-headless-shell is not installed", "measured")
        return
    with tempfile.TemporaryDirectory() as place:
        in_browser(Path(place), given.moves)


if __name__ == "__main__":
    main()
