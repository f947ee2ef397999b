"""The studio in Chromium: how soon a drag is seen, what it costs, sizes, start, memory,
hostile messages.

    python benchmarks/bench_studio.py [path of axe.min.js]

Every line: what was measured | value | wanted | error beside it. Pointer to painted is
from the event's own time stamp to the frame behind its drawing, of moves that come
every 16 ms. With a copy of axe-core (npm's package axe-core), violations are counted in
7 steps, 2 themes and 3 widths.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
import subprocess
import sys
import tempfile
import time
from importlib.metadata import files as installed
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from starlette.testclient import TestClient

import fraclink as fl
from fraclink._studio.preview import Subject, preview
from fraclink._studio.server import Studio, application
from fraclink._studio.session import opened

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from browser import Page, browser

MOVES = 100
DRAGS = (
    ("#h-crossover", (10, 0)),
    ("#h-margin-phase", (0, -10)),
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
STEPS = ("log", "channels", "model", "design", "move", "proof", "board")


def line(what: str, value: str, wanted: str, error: str = "") -> None:
    """Print one figure."""
    print(f"{what} | {value} | {wanted} | {error}", flush=True)


def previews() -> None:
    """CPU of the Python of a drag."""
    rig = fl.Rig.named("paper-2023")
    made = fl.design(
        rig.model, rig, gain_crossover=12.0, phase_margin=fl.deg(50), law=False
    )
    subject = Subject(rig, rig.model, made.law())
    taken = []
    for k in range(200):
        state = {
            "gain_crossover": 12.0 + 0.01 * k,
            "phase_margin_deg": 50.0,
            "payloads": [0.02, 0.04],
        }
        begin = time.process_time()
        size = len(preview(subject, state).packed(k, "preview"))
        taken.append(1e3 * (time.process_time() - begin))
    value = f"{np.median(taken):.1f} ms, p95 {np.quantile(taken, 0.95):.1f} ms"
    line("Python CPU a drag", value, "<= 12 ms", f"{size} bytes over the socket")


def sizes() -> None:
    """Bytes of the own script as it is served, and of the extra."""
    with tempfile.TemporaryDirectory() as place:
        studio = Studio(lambda: opened(None, out=Path(place)), hosts=["127.0.0.1:1"])
        client = TestClient(application(studio), base_url="http://127.0.0.1:1")
        names = [path.name for path in (files("fraclink._studio") / "page").iterdir()]
        own = sum(
            len(client.get(f"/{name}").content)
            for name in names
            if name.endswith(".js")
        )
        arm = len(client.get("/arm_box.js").content)
        rest = len(client.get("/").content) + len(client.get("/studio.css").content)
    line(
        "own script",
        f"{own / 1e3:.1f} kB",
        "<= 60 kB",
        f"{rest / 1e3:.1f} kB page and style, {arm / 1e3:.1f} kB arm",
    )
    packages = ("starlette", "uvicorn", "wsproto", "anyio", "h11", "idna", "click")
    if find_spec("wsproto") is None:
        line("extra [studio]", "not measured", "<= 6 MB", "wsproto is not installed")
        return
    total = sum(
        f.locate().stat().st_size
        for p in packages
        for f in installed(p) or ()
        if f.locate().is_file()
    )
    line("extra [studio]", f"{total / 1e6:.1f} MB", "<= 6 MB", ", ".join(packages))


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
    """Seconds of processor that a process has had."""
    fields = Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / 100.0


def drags(page: Page, process: int) -> None:
    for handle, by in DRAGS:
        page.run("performance.clearMeasures('drag')")
        before = cpu(process)
        took = page.drag(handle, by, moves=MOVES)
        used = cpu(process) - before
        page.until(
            "!document.querySelector('#controller').classList.contains('preview')",
            "an exact design",
        )
        assert page.run("document.querySelector('#refused').hidden"), (
            "a drag to where nothing is feasible"
        )
        seen = sorted(
            page.run("performance.getEntriesByName('drag').map(e => e.duration)")
        )
        median, late = np.median(seen), np.quantile(seen, 0.95)
        wanted = "<= 35 ms, p95 <= 70 ms; >= 20 redraws/s"
        value = f"{median:.0f} ms, p95 {late:.0f} ms; {len(seen) / took:.0f} redraws/s"
        load = float(Path("/proc/loadavg").read_text().split()[0])
        cost = 1e3 * used / max(len(seen), 1)
        line(
            f"pointer to painted, {handle}",
            value,
            wanted,
            f"server {cost:.1f} ms a redraw, load {load:.1f}",
        )


def violations(page: Page, axe: str) -> None:
    total, kinds = 0, set()
    for width in (390, 768, 1440):
        for dark in (False, True):
            page.look(width=width, height=900, dark=dark)
            for number, step in enumerate(STEPS, 1):
                page.key(str(number))
                time.sleep(0.3)
                page.run(axe + "; 0")
                found = page.run(
                    "axe.run().then(r => r.violations.map(v => [v.id, v.nodes.map(n => n.target[0])]))"
                )
                total += len(found)
                kinds |= {
                    f"{step} {width} {name}: {places[:3]}" for name, places in found
                }
    line(
        "axe, 7 steps x 2 themes x 3 widths",
        f"{total} violations",
        "0",
        "; ".join(sorted(kinds))[:600],
    )


def hostile(address: str) -> None:
    """10 000 random and hostile messages over a real socket; the study must be the one
    before.
    """
    from websockets.asyncio.client import connect
    from websockets.exceptions import ConnectionClosed

    rng = np.random.default_rng(1)
    token = address.split("#")[1]
    origin = address.split("/#")[0]
    junk = (
        None,
        -1,
        1e308,
        1e-320,
        "..",
        "../../x",
        [],
        {},
        [[1]],
        {"a": 1},
        True,
        10**30,
        "\u202e",
        "x" * 3000,
    )
    verbs = (
        "hello",
        "preview",
        "note",
        "go",
        "log",
        "columns",
        "rig",
        "model",
        "export",
        "zip",
        "cancel",
        "nearest",
        "x",
    )

    def text(k: int) -> str:
        if k % 3 == 0:
            return "".join(
                chr(c) for c in rng.integers(1, 0x2FFF, int(rng.integers(0, 80)))
            )
        fields = (
            "state",
            "at",
            "force",
            "name",
            "columns",
            "structure",
            "target",
            "payload",
        )
        given = {field: junk[int(rng.integers(len(junk)))] for field in fields}
        if k % 3 == 1:
            options = (
                "gain_crossover",
                "phase_margin_deg",
                "payloads",
                "filter_time",
                "box",
            )
            given["state"] = {
                name: junk[int(rng.integers(len(junk)))] for name in options
            }
        return json.dumps(
            {"seq": k, "verb": verbs[int(rng.integers(len(verbs)))], **given}
        )

    async def talk() -> tuple[int, int]:
        answers = bad = 0
        strange: list[str] = []

        async def read(socket) -> None:
            nonlocal answers, bad
            # A page that does not wait for its answers is shown the door (1008): that
            # is no defect.
            with contextlib.suppress(ConnectionClosed):
                async for data in socket:
                    answers += 1
                    size = int.from_bytes(data[:4], "little")
                    head = data[4 : 4 + size]
                    # As numbers: the arm's base64 may hold the letters.
                    bad += bool(
                        json.loads(head, parse_constant=strange.append).get("defect")
                    )
                    bad += len(strange)
                    strange.clear()

        sent = 0
        while sent < 10_000:
            async with connect(
                origin.replace("http", "ws") + "/talk", origin=origin, max_size=2**26
            ) as socket:
                await socket.send(token)
                reading = asyncio.create_task(read(socket))
                with contextlib.suppress(ConnectionClosed):
                    for _ in range(500):
                        await socket.send(text(sent))
                        sent += 1
                        if sent % 25 == 0:
                            await asyncio.sleep(0.02)
                await asyncio.sleep(1.0)
                reading.cancel()
        return answers, bad

    answers, bad = asyncio.run(talk())
    line("10 000 hostile messages", f"{bad} defects or NaN", "0", f"{answers} answers")


def main(arguments: list[str]) -> None:
    previews()
    sizes()
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        process, address, start = started(place)
        try:
            line("start, to the printed address", f"{start:.2f} s", "<= 1.5 s")
            with browser(place) as page:
                page.look()
                page.open(address)  # once for the profile of the browser
                page.until("document.querySelector('#h-crossover')")
                begin = time.perf_counter()
                page.open(address)
                page.until(
                    "document.querySelector('#p-gain .curve')?.getAttribute('d')"
                )
                curves = time.perf_counter() - begin
                paint = page.run(
                    "performance.getEntriesByName('first-contentful-paint')[0].startTime"
                )
                line("first paint", f"{paint / 1e3:.2f} s", "<= 0.4 s")
                line(
                    "first curves", f"{curves:.2f} s", "<= 1.5 s", "navigation included"
                )
                page.until("document.querySelector('.armbox')")
                time.sleep(1.5)
                page.drag(
                    "#h-margin-phase", (0, 4), moves=20
                )  # not measured: the first of a fresh engine
                time.sleep(1.0)
                drags(page, process.pid)
                line(
                    "frames while the arm moves", f"{page.run(FRAMES):.0f} /s", "60 /s"
                )
                if arguments:
                    violations(page, Path(arguments[0]).read_text())
                else:
                    line("axe", "not measured", "0", "give the path of axe.min.js")
                elsewhere = [
                    r
                    for r in page.requests
                    if "//127.0.0.1:" not in r and not r.startswith(("about:", "data:"))
                ]
                line(
                    "requests off this machine",
                    str(len(elsewhere)),
                    "0",
                    f"{len(page.requests)} in all",
                )
                line(
                    "complaints of the console",
                    str(len(page.complaints)),
                    "0",
                    "; ".join(page.complaints)[:200],
                )
            hostile(address)
            line("memory of the server", f"{memory(process.pid):.0f} MB", "<= 200 MB")
        finally:
            process.kill()


if __name__ == "__main__":
    main(sys.argv[1:])
