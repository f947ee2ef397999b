"""The arm in a page: sizes, bits against `simulate` under wasmtime and in browsers, and
the time of a run.

    python benchmarks/bench_page.py

Every line: what was measured | value | wanted | error beside it. A run counts as equal
where every sample of its signals and marks is. Chromium's times are of 200 runs of 4 s
in the page itself, whose policy is taken out of the copy that is measured.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import socket
import subprocess
import sys
import tempfile
import time
import zlib
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

import fraclink as fl
from fraclink._law import Law
from fraclink._show.arm_page import render_arm_page
from fraclink._show.report import render_report
from fraclink._simulate import SensorFault
from fraclink._simulate.engine import TWIN_MODES, engine_bytes
from fraclink._simulate.sensors import fault_rows

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from browser import browser as shown_in
from engine_bench import MARKS, SIGNALS, Engine

MOVE = fl.smooth_step(1.0, duration=0.5)
PAYLOADS = (0.008, 0.016, 0.030, 0.054)
END = 4.0
FAULTS: tuple[tuple[SensorFault, ...], ...] = (
    (),
    (SensorFault(0.3, 9.0, "gauge value", float("nan")),),
    (SensorFault(0.3, 9.0, "gauge frozen"),),
    (SensorFault(0.3, 9.0, "encoder frozen"),),
    (SensorFault(0.3, 9.0, "gauge gain", -1.0),),
    tuple(
        SensorFault(0.004 * k, 0.004 * (k + 1), "tick missed")
        for k in range(75, 1000)
        if k % 3
    ),
)
# Measured inside the page, behind its own first run.
TIMING = """
const timed = () => Array.from({length: 200}, () => { run(); return milliseconds; }).sort((a, b) => a - b);
const model = timed(), found = digest();
state.twin = true;
const twin = timed();
document.title = `took ${model[100]} ${model[199]} digest ${found} `
  + `twin ${twin[100]} ${twin[199]} digest ${digest()}`;
})();
"""


def line(what: str, value: str, wanted: str, error: str = "") -> None:
    """Print one figure."""
    print(f"{what} | {value} | {wanted} | {error}", flush=True)


def study() -> fl.Study:
    rig = fl.Rig.named("paper-2023-geared")
    assert rig.model is not None
    made = fl.design(
        rig.model,
        rig,
        payloads=(0.020, 0.040),
        gain_crossover=12.0,
        phase_margin=fl.deg(50),
    )
    return fl.Study(rig=rig, design=made, law=made.law())


def sizes(known: fl.Study) -> None:
    """Bytes of engine, page and the demo's report."""
    line("engine", f"{len(engine_bytes())} B", "<= 24 kB")
    line("page of the arm", f"{len(render_arm_page(known).encode())} B", "<= 150 kB")
    with tempfile.TemporaryDirectory() as folder:
        demo = fl.run(
            fl.Rig.named("paper-2023"),
            fl.read_log(fl.bundled_log("prbs_30g")),
            out=folder,
        )
        texts = [render_report(demo, script=script) for script in (True, False)]
    line(
        "report of the demo",
        f"{len(texts[0].encode())} B",
        "<= 700 kB",
        f"{len(texts[1].encode())} B without script",
    )


def bits(known: fl.Study) -> None:
    """Runs of which every bit is the package's, under wasmtime."""
    design, engine = known.design, Engine()
    assert design is not None
    equal = twins = total = 0
    for precision, payload, noise, offset, delay, faults in product(
        ("double", "single"), PAYLOADS, (0.0, 0.02), (0.0, 0.05), (1, 2), FAULTS
    ):
        law: Law = design.law().in_precision(precision)  # type: ignore[arg-type]
        gauge = {"noise": noise, "gauge_offset": offset, "delay_samples": delay}
        run = fl.simulate(
            law,
            MOVE,
            rig=design.rig,
            model=design.model,
            payload=payload,
            duration=END,
            events=faults,
            **gauge,
        )
        rows = fault_rows(faults, law.period, run.tip_angle.size) if faults else None
        changed = {"noise": noise, "offset": offset, "delay": float(delay)}
        page = engine.run(
            design, law, MOVE, payload=payload, duration=END, faults=rows, **changed
        )
        total += 1
        equal += all(
            np.array_equal(page[n], getattr(run, n), equal_nan=True)
            for n in (*SIGNALS, *MARKS)
        )
        twin = fl.Twin.from_rig(
            design.rig, model=design.model, payload=payload, modes=TWIN_MODES
        )
        sensors = replace(twin.sensors, gauge_noise=noise, gauge_offset=offset)
        twin = replace(twin, voltage_delay=delay, sensors=sensors)
        run = fl.simulate(law, MOVE, arm=twin, duration=END, events=faults)
        page = engine.run_twin(twin, law, MOVE, duration=END, faults=rows)
        twins += all(
            np.array_equal(page[n], getattr(run, n), equal_nan=True)
            for n in (*SIGNALS, *MARKS)
        )
    error = "2 precisions x 4 payloads x noise, offset, delay, faults"
    line(
        "runs equal in every bit, wasmtime: model", f"{equal} of {total}", "all", error
    )
    line("the same: twin", f"{twins} of {total}", "all", error)


def browser(known: fl.Study) -> None:
    """A run in Chromium: its time, and its digest against Python's."""
    chromium, design = shutil.which("chromium"), known.design
    assert design is not None
    if chromium is None:
        line("4 s run in Chromium", "Chromium is not installed", "<= 2 ms")
        return
    text = re.sub(
        r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", render_arm_page(known)
    )
    head, script = text.rsplit("})();\n", 1)
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "arm.html"
        place.write_text(head + TIMING + script, encoding="utf-8")
        command = [
            chromium,
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--dump-dom",
        ]
        answer = subprocess.run(  # noqa: S603
            [*command, f"--user-data-dir={folder}/profile", place.as_uri()],
            capture_output=True,
            text=True,
            check=True,
        )
    found = re.search(
        r"<title>took (\S+) (\S+) digest (\d+) twin (\S+) (\S+) digest (\d+)",
        answer.stdout,
    )
    middle, worst, _, slow, slowest, _ = map(float, found.groups())  # type: ignore[union-attr]
    line(
        "4 s run in Chromium, median: model",
        f"{middle:.2f} ms",
        "<= 2 ms",
        f"worst of 200: {worst:.2f} ms",
    )
    line(
        "the same: twin", f"{slow:.2f} ms", "<= 2 ms", f"worst of 200: {slowest:.2f} ms"
    )
    same = expected(known) == [int(found[3]), int(found[6])]  # type: ignore[index]
    line(
        "the same digests in Chromium and Python",
        "yes" if same else "no",
        "yes",
        "model and twin",
    )


def expected(known: fl.Study) -> list[int]:
    """The digests of the page's first move in Python: model and twin."""
    design = known.design
    assert design is not None
    there, back = (
        fl.smooth_step(1.0471975511965976, 0.5),
        fl.smooth_step(-1.0471975511965976, 0.5, 1.5),
    )
    twin = fl.Twin.from_rig(design.rig, model=design.model, modes=TWIN_MODES)
    move, own = there.then(back), {"payload": 0.03, "told": True, "duration": 4.0}
    runs = (
        fl.simulate(design, move, **own),
        fl.simulate(design, move, arm=twin, **own),
    )  # type: ignore[arg-type]
    return [zlib.crc32(run.tip_angle.tobytes()) for run in runs]


class Marionette:
    """The protocol that Firefox speaks without a driver: one JSON message behind its
    length and a colon.
    """

    def __init__(self, port: int = 2828) -> None:
        for _ in range(240):
            try:
                self._file = socket.create_connection(("127.0.0.1", port)).makefile(
                    "rwb"
                )
                break
            except OSError:
                time.sleep(0.25)
        self._number = 0
        self._read()

    def _read(self) -> Any:
        length = b""
        while (letter := self._file.read(1)) != b":":
            length += letter
        return json.loads(self._file.read(int(length)))

    def do(self, name: str, **given: Any) -> Any:
        """Call a command and return its result."""
        self._number += 1
        text = json.dumps([0, self._number, name, given]).encode()
        self._file.write(str(len(text)).encode() + b":" + text)
        self._file.flush()
        return self._read()[3]


def firefox(known: fl.Study) -> None:
    """The page's first move in Firefox, under its policy, against Python's digests."""
    program = shutil.which("firefox") or shutil.which("firefox-esr")
    if program is None:
        line(
            "the same digests in Firefox and Python", "Firefox is not installed", "yes"
        )
        return
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "arm.html"
        place.write_text(render_arm_page(known), encoding="utf-8")
        command = [
            program,
            "--headless",
            "--marionette",
            "--no-remote",
            "--profile",
            folder,
        ]
        browser = subprocess.Popen(  # noqa: S603
            command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        try:
            driver, found = Marionette(), []
            driver.do("WebDriver:NewSession")
            for settings in ("twin=0", "twin=1"):
                driver.do("WebDriver:Navigate", url="about:blank")
                driver.do("WebDriver:Navigate", url=f"{place.as_uri()}#{settings}")
                script = "return document.getElementById('python').textContent"
                text = driver.do("WebDriver:ExecuteScript", script=script, args=[])[
                    "value"
                ]
                found.append(int(re.search(r"# (\d+) in this page", text)[1]))  # type: ignore[index]
        finally:
            browser.terminate()
            browser.wait()
    same = "yes" if found == expected(known) else "no"
    line("the same digests in Firefox and Python", same, "yes", "model and twin")


# Every frame moves another slider, payload and move among them, which lay the drawing
# out anew.
SLIDING = """
new Promise((done) => {
  const ids = ['payload', 'move', 'noise', 'offset', 'delay'], begin = performance.now();
  let frames = 0;
  const step = (now) => {
    const input = document.getElementById(ids[++frames % ids.length]), low = Number(input.min);
    input.value = low + (Number(input.max) - low) * (0.5 + 0.5 * Math.sin(frames / 17));
    input.dispatchEvent(new Event('input'));
    if (now - begin < 4000) requestAnimationFrame(step);
    else done([frames, (now - begin) / 1e3]);
  };
  requestAnimationFrame(step);
})
"""


def processor_time() -> dict[int, float]:
    """CPU seconds of the main thread of every page that Chromium shows."""
    found = {}
    for place in Path("/proc").glob("[0-9]*"):
        try:
            if b"--type=renderer" in (place / "cmdline").read_bytes():
                numbers = (
                    (place / "task" / place.name / "stat")
                    .read_text()
                    .rpartition(")")[2]
                    .split()
                )
                found[int(place.name)] = (
                    int(numbers[11]) + int(numbers[12])
                ) / os.sysconf("SC_CLK_TCK")
        except OSError:
            continue  # it ended in between
    return found


def frames(known: fl.Study) -> None:
    """Frames while the sliders move, and what one costs: the second hardly depends on
    what else runs.
    """
    with tempfile.TemporaryDirectory() as folder, shown_in(Path(folder)) as page:
        place = Path(folder) / "arm.html"
        place.write_text(render_arm_page(known), encoding="utf-8")
        for arm in ("model", "twin"):
            page.open(f"{place.as_uri()}#twin={int(arm == 'twin')}")
            before = processor_time()
            count, seconds = page.run(SLIDING)
            cost = max(
                now - before.get(one, 0.0) for one, now in processor_time().items()
            )
            load = f"load {os.getloadavg()[0]:.0f} on {os.cpu_count()} cores"
            line(
                f"CPU time of a frame while sliders move: {arm}",
                f"{1e3 * cost / count:.1f} ms",
                "<= 16.7 ms",
            )
            line(
                f"frames while sliders move: {arm}",
                f"{count / seconds:.0f}/s",
                "60/s",
                load,
            )


def main() -> None:
    """Print all figures."""
    known = study()
    sizes(known)
    bits(known)
    browser(known)
    frames(known)
    firefox(known)


if __name__ == "__main__":
    main()
