"""The studio in Chromium: every handle, undo, keys, a killed server, and no request to
other hosts.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import fraclink as fl
from browser import Page, browser

pytestmark = pytest.mark.slow

HANDLES = {
    "#h-crossover": ((25, 0), "gain_crossover"),
    "#h-filter": ((-30, 0), "filter_time"),
    "#h-margin-phase": ((0, 6), "phase_margin_deg"),
    "#h-margin-nichols": ((-12, 0), "phase_margin_deg"),
    "#h-margin-payload": ((0, 8), "phase_margin_deg"),
    "#h-payload-0": ((12, 0), "payloads"),
    "#h-payload-1": ((-12, 0), "payloads"),
}


@contextmanager
def studio(place: Path, *words: str) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """A studio restricted to `place`/results: its address and its process."""
    studio = "-m fraclink studio --no-open --out results"
    command = [sys.executable, *studio.split(), *words]
    process = subprocess.Popen(command, cwd=place, stdout=subprocess.PIPE, text=True)  # noqa: S603
    try:
        assert process.stdout is not None
        yield process.stdout.readline().strip(), process
    finally:
        process.kill()
        process.communicate()


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> Iterator[Page]:
    with browser(tmp_path_factory.mktemp("browser")) as found:
        found.look()
        yield found


# The exact answer to the current request has been shown, and no preview is in progress.
_SETTLED = """import('/studio.js').then(
  ({app}) => app.exactly === JSON.stringify(app.state) && !app.link.dragging
)"""


def settled(page: Page) -> None:
    """Wait until the exact design is complete: before that, tables grow and handles
    move under the pointer.
    """
    page.until(lambda: bool(page.run(_SETTLED)), "an exact design")


def states(place: Path) -> list[dict]:
    lines = (place / "results" / "studio.jsonl").read_text().splitlines()
    return [json.loads(line) for line in lines]


def noted(page: Page, place: Path) -> dict:
    """Wait until the request of the page is the last state of its history, and return
    it.
    """
    shown = "import('/studio.js').then(({app}) => app.state)"
    page.until(
        lambda: states(place)[-1].get("state") == page.run(shown),
        "the state in the history",
    )
    return states(place)[-1]["state"]


# A busy machine may answer long after the next request: here, when the test triggers it
# (`window.late`).
_LATE = """((verb, changed) => {
  const hears = Object.getOwnPropertyDescriptor(WebSocket.prototype, 'onmessage');
  const {send} = WebSocket.prototype;
  Object.assign(window, {asked: [], late: [], refusals: 0});
  WebSocket.prototype.send = function (text) {
    if (text.includes(`"verb":"${verb}"`)) window.asked.push(JSON.stringify(JSON.parse(text).state));
    send.call(this, text);
  };
  Object.defineProperty(WebSocket.prototype, 'onmessage', {set(hear) {
    hears.set.call(this, (event) => {
      const size = new DataView(event.data).getUint32(0, true);
      const head = JSON.parse(new TextDecoder().decode(new Uint8Array(event.data, 4, size)));
      if (head.verb === verb) window.late.push(() => hear(changed(head, event))); else hear(event);
    });
  }});
})"""
# With the filter of the last design, a refused preview may not contain a nearest
# request.
_KNOWS_LESS = """(head, event) => {
  if (head.ok) return event;
  window.refusals += 1;
  const text = new TextEncoder().encode(JSON.stringify({...head, nearest: {}}));
  const data = new ArrayBuffer(4 + text.length);
  new DataView(data).setUint32(0, text.length, true);
  new Uint8Array(data, 4).set(text);
  return {data};
}"""


@contextmanager
def held_back(
    page: Page, verb: str, changed: str = "(head, event) => event"
) -> Iterator[Callable[[], object]]:
    """Hold back the answers to `verb` in pages opened from now on; the yielded function
    releases them.
    """
    source = f"{_LATE}('{verb}', {changed})"
    kept = page.do("Page.addScriptToEvaluateOnNewDocument", source=source)["identifier"]
    try:
        yield lambda: page.run("window.late.splice(0).forEach((hear) => hear())")
    finally:
        page.do("Page.removeScriptToEvaluateOnNewDocument", identifier=kept)


def ask_for(page: Page, crossover: str) -> None:
    """Type a gain crossover into its field, or clear it."""
    page.run(
        f"(i => {{ i.value = '{crossover}'; i.dispatchEvent(new Event('change')); }})"
        "(document.getElementById('f-gain_crossover'))"
    )


def test_a_preview_behind_the_exact_answer_takes_nothing_from_it(page, tmp_path):
    with (
        held_back(page, "preview", _KNOWS_LESS) as hand_on,
        studio(tmp_path) as (address, _process),
    ):
        page.open(address)
        page.key("4")

        def handed_on(condition: str) -> bool:
            hand_on()
            return bool(page.run(f"Boolean({condition})"))

        page.until(
            lambda: handed_on(
                "!document.querySelector('#controller').classList.contains('preview')"
            )
        )
        ask_for(page, "60")  # far beyond the reach of any law of the family
        page.until("document.querySelector('#refused button')", "the nearest")
        page.until(lambda: handed_on("window.refusals"), "the preview")
        refused = "document.querySelector('#refused')"
        assert page.run(
            f"!{refused}.hidden && Boolean({refused}.querySelector('button'))"
        )


def test_the_picture_of_a_state_is_asked_for_once(page, tmp_path):
    """When pictures were requested each time the strip was drawn, 64 requests were soon
    pending, and the studio closed the connection.
    """
    with held_back(page, "look") as hand_on, studio(tmp_path) as (address, _process):
        page.open(address)
        page.key("4")
        for number, value in enumerate(("12.5", "13", "13.5"), 2):
            ask_for(page, value)
            page.until(f"document.querySelectorAll('.thumb').length === {number}")
        page.until(
            "new Set(window.asked).size === 4", "every state's picture asked for"
        )
        assert page.run("window.asked.length") == 4
        page.until("window.late.length === 4", "every picture answered")
        hand_on()
        page.until(
            "document.querySelectorAll('.thumb path[d]').length === 4",
            "every picture drawn",
        )


def test_what_was_drawn_of_another_model_says_so(page, tmp_path):
    def step(name: str) -> str:
        return page.run(f"document.querySelector('#go-{name}').dataset.mark")

    with studio(tmp_path) as (address, _process):
        page.open(address)
        settled(page)
        page.key("6")
        page.click("#prove")
        page.until(
            "document.querySelector('#p-swept .proved')?.getAttribute('d')",
            "the box that was proved, in the map",
        )
        page.key("7")
        page.click("[data-target=c]")
        page.until(lambda: step("board") == "passed", "the files of the first design")
        page.key("1")
        page.until("document.querySelector('#bundled button')", "the bundled logs")
        page.click("#bundled button")
        page.until(lambda: step("log") == "passed", "the log")
        assert step("board") == "outdated"
        outdated = "document.querySelector('#step-design').matches('.outdated')"
        page.run(
            f"new MutationObserver(() => {{ window.grey ||= {outdated}; }})"
            ".observe(document.querySelector('#step-design'), {attributes: true})"
        )
        page.key("3")
        page.click("#fit")
        page.until(lambda: step("model") == "passed", "a fit")
        page.key("4")
        page.until(lambda: step("design") == "passed", "the design for the new model")
        page.until(f"window.grey && !{outdated}", "grey, and then the new design")
        assert step("board") == "outdated"
        page.until("!document.documentElement.dataset.busy", "the end of every wait")


def test_a_request_that_no_design_meets_has_no_command(page, tmp_path):
    with studio(tmp_path) as (address, _process):
        page.open(address)
        page.key("4")
        settled(page)
        page.until("!document.querySelector('#copy-command').disabled", "the command")
        ask_for(page, "60")
        page.until("!document.querySelector('#refused').hidden", "the refusal")
        assert page.run(
            "document.querySelector('#copy-command').disabled"
            " && document.querySelector('#copy-command').title.includes('no design')"
        )


def test_every_handle_drags_and_every_drag_can_be_undone(page, tmp_path):
    with studio(tmp_path) as (address, process):
        page.open(address)
        # the token is no longer in the address bar
        assert page.run("location.hash") == ""
        page.until("document.querySelector('.armbox')")
        settled(page)
        first = states(tmp_path)[-1]["state"]
        for number, (handle, (by, option)) in enumerate(HANDLES.items(), 1):
            settled(page)
            was = page.run(
                f"document.querySelector('{handle}').getAttribute('aria-valuenow')"
            )
            page.drag(handle, by, moves=6)
            assert (
                page.run(
                    f"document.querySelector('{handle}').getAttribute('aria-valuenow')"
                )
                != was
            ), handle
            page.until(
                lambda n=number: len(states(tmp_path)) > n, f"{handle} in the history"
            )
            before, after = (entry["state"] for entry in states(tmp_path)[-2:])
            assert [name for name in after if after[name] != before[name]] == [
                option
            ], handle
        for _ in HANDLES:  # one undo for each drag
            page.key("z", control=True)
        page.until(lambda: states(tmp_path)[-1]["at"] == 0, "undone to the first")
        page.key("z", control=True, shift=True)
        page.until(lambda: states(tmp_path)[-1]["at"] == 1, "redone")
        settled(page)
        # Escape returns a drag to its start, and nothing is recorded.
        lines = len(states(tmp_path)) + 1
        page.key("z", control=True)
        page.until(lambda: len(states(tmp_path)) == lines, "the undo before")
        settled(page)
        x, y = page.middle("#h-crossover")
        for kind, dx in (("mousePressed", 0), ("mouseMoved", 20), ("mouseMoved", 40)):
            page.mouse(kind, x + dx, y)
        page.key("Escape")
        page.mouse("mouseReleased", x + 40, y, 0)
        shown = page.run(
            "Number(document.querySelector('#h-crossover').getAttribute('aria-valuenow'))"
        )
        assert shown == first["gain_crossover"]
        time.sleep(0.3)
        assert len(states(tmp_path)) == lines
        # Keyboard only: a handle, the steps, Keep.
        page.run("document.querySelector('#h-margin-phase').focus()")
        for name in ("ArrowUp", "PageUp"):
            page.key(name)
        page.until(
            "document.querySelector('#h-margin-phase').getAttribute('aria-valuenow') === '55.5'"
        )
        page.until(
            "document.querySelector('#command').textContent.includes('--phase-margin-deg 55.5')"
        )
        settled(page)
        page.key("s", control=True)
        kept = tmp_path / "results" / "design.json"
        page.until(kept.is_file, "kept")
        for number, step in enumerate(
            ("log", "channels", "model", "design", "move", "proof", "board"), 1
        ):
            page.key(str(number))
            assert page.run(f"!document.querySelector('#step-{step}').hidden"), step
        page.key("4")
        # A click in the map sets both values; a state is overlaid on another; the
        # palette finds what has no key.
        page.until(
            "document.querySelector('#p-map .cells')?.getAttribute('d')", "the map"
        )
        settled(page)
        before = page.run("import('/studio.js').then(({app}) => app.state)")
        page.drag("#h-map-crossover", (6, 0), moves=3)
        after = noted(page, tmp_path)
        assert after == {**before, "gain_crossover": after["gain_crossover"]} != before
        page.run("document.querySelector('.thumb .chip').click()")
        page.until(
            "document.querySelectorAll('.curve.other').length === 7",
            "a state over this one: its loop, S and T, its margins and its move",
        )
        sensitivity_of_the_loop(page)
        zoomed(page)
        assert "B" in page.run("document.querySelector('#compared thead').textContent")
        page.run("document.querySelector('#fan').click()")
        page.until(
            "document.querySelector('#p-nichols .fan')?.getAttribute('d')",
            "the arms of the box",
        )
        page.run("document.querySelector('#fan').click()")
        page.key("k", control=True)
        page.do("Input.insertText", text="lightest")
        page.key("Enter")
        page.until(
            "document.activeElement.id === 'f-payloads.0'", "the field of that name"
        )
        page.run("document.activeElement.blur()")
        # An infeasible request: pale curves, a sentence, and the nearest feasible
        # request.
        page.key("4")
        for value in ("60", ""):
            ask_for(page, value)
            if value:
                page.until(
                    "document.querySelector('#refused').textContent"
                    ".includes('where 60 rad/s is asked for')",
                    "the reason, behind the sentence that it is searched for",
                )
                page.until("document.querySelector('#refused button')")
                page.run("document.querySelector('#refused button').click()")
                page.until("document.querySelector('#refused').hidden")
        # Killed in the middle of a drag: the kept state is there, and the history is
        # restored.
        settled(page)
        bytes_kept, lines = kept.read_bytes(), len(states(tmp_path))
        x, y = page.middle("#h-crossover")
        value = "document.querySelector('#h-crossover').getAttribute('aria-valuenow')"
        was = page.run(value)
        page.mouse("mousePressed", x, y)
        page.mouse("mouseMoved", x + 15, y)
        page.until(f"{value} !== '{was}'", "the drag")
        process.kill()
        page.mouse("mouseReleased", x + 15, y, 0)
        page.until(
            "!document.querySelector('#banner').hidden",
            "the page says that the studio is gone",
        )
    assert kept.read_bytes() == bytes_kept
    port = address.split(":")[2].split("/")[0]
    with studio(tmp_path, "--port", port) as (address, _):
        page.until(
            "document.querySelector('#banner').textContent.includes('key')",
            "another token",
        )
        page.open(address)
        assert page.run("document.querySelector('#undo').disabled") is False
        assert len(states(tmp_path)) >= lines
    ours = [r for r in page.requests if not r.startswith(("about:", "data:"))]
    assert ours and all(r.split("/")[2].startswith("127.0.0.1:") for r in ours)
    complaints = [
        c for c in page.complaints if "WebSocket" not in c and "ERR_CONNECTION" not in c
    ]
    assert complaints == []


def sensitivity_of_the_loop(page: Page) -> None:
    """|S| and |T| are those of the loop that is drawn beside them."""
    shown = page.run(
        "import('/studio.js').then(({design}) => ['gain', 'phase', 'S', 'T'].map("
        "(name) => Array.from(design[name].curves.get('light').ys)))"
    )
    gain, phase, s, t = (np.array(values) for values in shown)
    loop = 10.0 ** (gain / 20.0) * np.exp(1j * np.radians(phase))
    assert np.allclose(s, -20.0 * np.log10(np.abs(1.0 + loop)), atol=1e-3)
    assert np.allclose(t - s, gain, atol=1e-3)


def zoomed(page: Page) -> None:
    """Plus narrows the axis of a plot and of those over the same one, zero restores it."""
    ends = (
        "import('/studio.js').then(({design}) => ['gain', 'S', 'nichols'].map("
        "(name) => design[name].x.high / design[name].x.low))"
    )
    gain, sensitivity, nichols = page.run(ends)
    page.run("document.querySelector('#h-crossover').focus()")
    page.key("+")
    page.until(lambda: page.run(ends) == pytest.approx([gain**0.5] * 2 + [nichols]))
    page.key("0")
    page.until(lambda: page.run(ends) == pytest.approx([gain, sensitivity, nichols]))


def _loses_the_payload(page: Page) -> bool:
    """Click the moving payload: on a busy machine a click may miss it, or last long
    enough to count as a hold.
    """
    page.click("#load")
    end = time.monotonic() + 5.0
    while time.monotonic() < end:
        if page.run(
            "document.querySelector('#outcome').textContent.includes('the payload falls to')"
        ):
            return True
        time.sleep(0.1)
    return False


def replayed_and_cut(page: Page) -> None:
    """The drawn arm follows the log; a section is selected by keys, kept, and taken
    back.
    """
    page.key("2")
    page.until("!document.querySelector('#replayed').hidden", "an arm that can replay")
    log = fl.read_log(fl.bundled_log("prbs_30g"))
    for part in (0.0, 0.31, 0.9):
        page.run(
            f"(i => {{ i.value = {1000 * part}; i.dispatchEvent(new Event('input')); }})"
            "(document.getElementById('replay-at'))"
        )
        angle = -np.degrees(log.motor_angle[round(part * (log.output.size - 1))])
        page.until(
            "Math.abs(document.querySelector('#hub').getAttribute('transform')"
            f".match(/-?[\\d.]+/)[0] - {angle}) < 0.3",
            "the arm at that sample",
        )
    page.run("document.querySelector('#replay').click()")
    page.until(
        "Math.abs(document.querySelector('#replay-at').value - 900) > 5", "it moves"
    )
    page.run("document.querySelector('#replay').click()")
    page.run("document.querySelector('#h-cut-1').focus()")
    for _ in range(2):
        page.key("PageDown")
    page.until(
        "document.querySelector('#cut-said').textContent === 'Marked: 0 to 18 s'"
    )
    page.run("document.querySelector('#cut-keep').click()")
    page.until(
        "document.querySelector('#command').textContent.includes('--keep 0 18')",
        "the stretch in the command",
    )
    assert "W237" in page.run("document.querySelector('#log-findings').textContent")
    page.click("#p-output")  # a click without a drag selects nothing
    page.until("document.querySelector('#cut-keep').disabled")
    page.run("document.querySelector('#cut-all').click()")
    page.until("!document.querySelector('#command').textContent.includes('--keep')")
    # the numbers of a plot, its description, and the plot itself as a file
    tools = (
        "document.querySelector('#p-angle').closest('figure').querySelectorAll('.tool')"
    )
    page.run(f"{tools}[0].click()")
    page.run(
        "URL.createObjectURL = (blob) => { blob.arrayBuffer().then((data) => {"
        " window.file = [blob.type, new TextDecoder().decode(data)]; }); return 'data:,'; }"
    )
    for number, kind in enumerate(("image/svg+xml", "image/png"), 1):
        page.run(f"{tools}[{number}].click()")
        page.until(f"window.file?.[0] === '{kind}'", "the plot as a file")
        if number == 1:
            drawn = ElementTree.fromstring(page.run("window.file[1]"))  # noqa: S314
            texts = {node.text for node in drawn.iter() if node.tag.endswith("text")}
            assert {"Motor angle [°] over time [s]", "log"} <= texts
    page.until(
        "document.querySelectorAll('#p-angle + .tablebox tbody tr').length === 14"
    )
    page.until(
        "/^log from .* at 0 to /.test(document.querySelector('#p-angle desc').textContent)"
    )


def test_from_a_dropped_log_to_the_board(page, tmp_path):
    page.complaints.clear()
    with studio(tmp_path, "--rig", "paper-2023-geared") as (address, _):
        page.open(address)
        page.key("1")
        page.until("document.querySelector('#bundled button')")
        page.run(
            "fetch('/upload?name=x.csv', {method: 'POST', body: 'x'}).then(answer => answer.status)"
        )  # without a token
        # Dropped like a file: the listener of the page receives it.
        page.run(
            "(d => { d.items.add(new File([Array.from({length: 5000}, (_, k) => { const t = 0.004 * k,"
            " a = Math.sin(0.4 * t * t); return `${t.toFixed(3)},${a},${1.5 * a}`; }).join('\\n')"
            ".replace(/^/, 'time_s,motor_angle_rad,torque_Nm\\n')], 'swept.csv'));"
            " document.querySelector('#drop').dispatchEvent(new DragEvent('drop', {dataTransfer: d,"
            " bubbles: true, cancelable: true})); })(new DataTransfer())"
        )
        page.until(
            "document.querySelector('#log-said').textContent.startsWith('swept.csv')"
        )
        page.run("document.querySelector('#bundled [data-name=prbs_30g]').click()")
        page.until(
            "document.querySelector('#log-said').textContent.startsWith('prbs_30g')"
        )
        page.until(
            "document.querySelector('#log-payload').placeholder === '30'",
            "the log is read",
        )
        replayed_and_cut(page)
        page.key("3")
        page.run("document.querySelector('#fit').click()")
        page.until("document.querySelectorAll('.model').length === 4", "four fits")
        assert "Hz" in page.run("document.querySelector('#model-words').textContent")
        page.key("4")
        page.until(
            "document.querySelector('#go-design').dataset.mark !== 'not run'",
            "a design",
        )
        page.key("5")
        page.until(
            "document.querySelector('#outcome')?.textContent.startsWith('Settled after')",
            "the arm moves",
        )
        page.until(
            "/--payload .* --move-time/.test(document.querySelector('#command').textContent)"
        )
        page.click("#fault-nan")
        page.until("document.querySelector('#copy-command').disabled", "no command")
        page.until(
            "document.querySelector('#outcome').textContent.startsWith('Degraded')"
        )
        # Holding the tip by hand, and losing the payload during the move, on the twin.
        page.run("document.querySelector('#hold').click()")
        page.until(
            "document.querySelector('#outcome').textContent.startsWith('On the twin: the tip held at')"
        )
        assert (
            page.run("document.querySelector('#hold').getAttribute('aria-pressed')")
            == "true"
        )
        page.run("document.querySelector('#hold').click()")
        page.until(
            "document.querySelector('#hold').getAttribute('aria-pressed') === 'false'"
        )
        page.until(lambda: _loses_the_payload(page), "the payload falls")
        page.key("6")
        page.until(
            "document.querySelector('#p-swept .cells')?.getAttribute('d')",
            "the map about -1",
        )
        page.click("#faults")
        page.until("document.querySelector('.cell')", "faults stream")
        page.run("document.querySelector('#cancel').click()")
        page.until(
            "document.querySelector('#proof-said').textContent.includes('Cancelled')"
        )
        # A red cell shows its run. As none of the first faults need fail, a failure is
        # simulated.
        page.run(
            "import('/studio.js').then(({proof}) => proof.cell("
            "{fault: 'F01', severity: 1, payload: 0.02, phase: 'mid', passed: false}))"
        )
        page.run("document.querySelector('button.cell').click()")
        page.until(
            "/^F01, severity/.test(document.querySelector('#outcome').textContent)"
        )
        page.key("7")
        page.run("document.querySelector('#write-c').click()")
        page.until("document.querySelector('#files td')", "files")
        page.until("document.querySelectorAll('#power-on li').length === 6")
        assert "hash" in page.run("document.querySelector('#board-facts').textContent")
        assert (tmp_path / "results" / "firmware" / "law.c").is_file()
        for width, dark in ((390, True), (768, False)):
            page.look(width=width, height=844, dark=dark)
            for number in range(1, 8):
                page.key(str(number))
                over = "document.documentElement.scrollWidth - document.documentElement.clientWidth"
                assert page.run(over) <= 0, (number, width)
        page.look(media="print")
        page.key("4")
        assert (
            page.run("getComputedStyle(document.querySelector('.tools')).display")
            == "none"
        )
        page.look()
        time.sleep(0.1)
    complaints = [
        c for c in page.complaints if "WebSocket" not in c and "ERR_CONNECTION" not in c
    ]
    assert [c for c in complaints if "403" not in c] == []
