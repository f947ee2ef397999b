"""Drives Chromium through its DevTools protocol: scripts, mouse, keys, screenshots, and
the requests of a page.

The client of the socket is the one that the studio needs anyway, so no driver has to be
installed in addition to the browser.
"""

from __future__ import annotations

import base64
import json
import os
import re
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from websockets.sync.client import ClientConnection, connect

from needed_tools import chromium

# [s]. Nothing is measured with it, and a busy machine must not be mistaken for a broken
# page: at a load of 20, twelve seconds of processor time take longer than a minute.
_PATIENCE = 600.0
_KEYS = {
    "ArrowRight": 39,
    "ArrowLeft": 37,
    "ArrowUp": 38,
    "ArrowDown": 40,
    "Tab": 9,
    "Escape": 27,
    "Enter": 13,
}
_KEYS |= {"Delete": 46, "PageUp": 33, "PageDown": 34, "Home": 36, "End": 35, " ": 32}
_CONTROL, _SHIFT = 2, 8


class Page:
    """One tab, with the `complaints` of its console and the addresses of its
    `requests`.
    """

    def __init__(self, socket: ClientConnection) -> None:
        self._socket, self._number = socket, 0
        self.complaints: list[str] = []
        self.requests: list[str] = []
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.do(f"{domain}.enable")

    def do(self, method: str, **parameters: Any) -> Any:
        """Call a method of the protocol and return its result."""
        self._number += 1
        self._socket.send(
            json.dumps({"id": self._number, "method": method, "params": parameters})
        )
        while True:
            said = json.loads(self._socket.recv(timeout=_PATIENCE))
            if said.get("id") == self._number:
                if "error" in said:
                    raise AssertionError(f"{method}: {said['error']}")
                return said["result"]
            self._hear(said)

    def _hear(self, event: dict[str, Any]) -> None:
        given = event.get("params", {})
        if event.get("method") == "Network.requestWillBeSent":
            self.requests.append(given["request"]["url"])
        elif event.get("method") == "Network.webSocketCreated":
            self.requests.append(given["url"])
        elif event.get("method") == "Runtime.exceptionThrown":
            self.complaints.append(json.dumps(given["exceptionDetails"])[:600])
        elif event.get("method") == "Log.entryAdded" and given["entry"]["level"] in (
            "error",
            "warning",
        ):
            self.complaints.append(
                f"{given['entry']['text']} {given['entry'].get('url', '')}"
            )
        elif event.get("method") == "Runtime.consoleAPICalled" and given["type"] in (
            "error",
            "warning",
        ):
            self.complaints.append(str(given["args"])[:300])

    def run(self, script: str) -> Any:
        """The value of a JavaScript expression; a promise is awaited."""
        asked = {
            "expression": script,
            "returnByValue": True,
            "awaitPromise": True,
            "userGesture": True,
        }
        found = self.do("Runtime.evaluate", **asked)
        if "exceptionDetails" in found:
            raise AssertionError(f"{script[:120]}: {found['exceptionDetails']}")
        return found["result"].get("value")

    def until(self, condition: str | Callable[[], bool], what: str = "") -> None:
        """Wait until an expression, or the result of a function, is true."""
        end = time.monotonic() + _PATIENCE
        while time.monotonic() < end:
            if (
                self.run(f"Boolean({condition})")
                if isinstance(condition, str)
                else condition()
            ):
                return
            time.sleep(0.03)
        shown = self.run("document.body.innerText")[:4000]
        raise AssertionError(
            f"never: {what or condition}; {self.complaints}; the page says\n{shown}"
        )

    def open(self, address: str) -> None:
        """Load an address and wait until its script has said that it is ready."""
        self.do("Page.navigate", url="about:blank")
        self.do("Page.navigate", url=address)
        self.until("document.documentElement?.dataset.ready === 'true'")

    def look(
        self,
        *,
        width: int = 1440,
        height: int = 900,
        dark: bool = False,
        media: str = "screen",
    ) -> None:
        """Set the size of the window, the colour scheme preferred by the user, and the
        medium.
        """
        mobile = {"deviceScaleFactor": 1, "mobile": False}
        self.do(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, **mobile
        )
        scheme = [
            {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        ]
        self.do("Emulation.setEmulatedMedia", media=media, features=scheme)

    def middle(self, selector: str) -> tuple[float, float]:
        """The middle of an element in the window."""
        rect = f"document.querySelector({json.dumps(selector)})"
        self.run(f"{rect}.scrollIntoView({{block: 'nearest'}})")
        x, y = self.run(
            f"(r => [r.x + r.width / 2, r.y + r.height / 2])({rect}.getBoundingClientRect())"
        )
        return float(x), float(y)

    def mouse(self, kind: str, x: float, y: float, buttons: int = 1) -> None:
        button = "none" if kind == "mouseMoved" and not buttons else "left"
        self.do(
            "Input.dispatchMouseEvent",
            type=kind,
            x=x,
            y=y,
            button=button,
            buttons=buttons,
            clickCount=1,
        )

    def click(self, selector: str) -> None:
        """Press the left button on an element."""
        x, y = self.middle(selector)
        self.mouse("mouseMoved", x, y, 0)
        self.mouse("mousePressed", x, y)
        self.mouse("mouseReleased", x, y, 0)

    def drag(
        self,
        selector: str,
        by: tuple[float, float],
        *,
        moves: int = 20,
        pause: float = 0.016,
    ) -> float:
        """Drag an element by a number of pixels; return the duration of the moves in
        seconds.
        """
        x, y = self.middle(selector)
        self.mouse("mouseMoved", x, y, 0)
        self.mouse("mousePressed", x, y)
        begin = time.monotonic()
        for k in range(1, moves + 1):
            self.mouse("mouseMoved", x + by[0] * k / moves, y + by[1] * k / moves)
            time.sleep(max(0.0, begin + k * pause - time.monotonic()))
        took = time.monotonic() - begin
        self.mouse("mouseReleased", x + by[0], y + by[1], 0)
        return took

    def key(self, name: str, *, control: bool = False, shift: bool = False) -> None:
        """Press a key."""
        code = _KEYS.get(name, ord(name.upper()[0]))
        parts: dict[str, Any] = {"key": name, "windowsVirtualKeyCode": code}
        parts["modifiers"] = _CONTROL * control + _SHIFT * shift
        text = {} if control or (name in _KEYS and name != " ") else {"text": name}
        self.do(
            "Input.dispatchKeyEvent",
            type="keyDown" if text else "rawKeyDown",
            **parts,
            **text,
        )
        self.do("Input.dispatchKeyEvent", type="keyUp", **parts)

    def picture(self, path: Path, *, whole: bool = False) -> None:
        """Write a PNG of the window, or of the whole page."""
        # Make the window as high as the page, so that what is at the foot of the window
        # is at the foot of the page.
        if whole:
            self.look(height=int(self.run("document.documentElement.scrollHeight")))
            time.sleep(0.3)
        path.write_bytes(
            base64.b64decode(self.do("Page.captureScreenshot", format="png")["data"])
        )


def command_line(place: Path, *more: str) -> list[str]:
    """A headless Chromium with its profile in `place`, as a command to be followed by
    an address.

    Neither the pop-ups of an address bar that nobody sees, nor a renderer in reserve:
    together 80 MB.
    """
    unused = "WebUIOmniboxPopup,WebUIOmniboxAimPopup,SpareRendererForSitePerProcess"
    quiet = [
        "--no-first-run",
        "--disable-background-networking",
        "--disable-component-update",
    ]
    alone = [
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        f"--disable-features={unused}",
    ]
    return [chromium(), *alone, *quiet, f"--user-data-dir={place / 'profile'}", *more]


@contextmanager
def browser(place: Path) -> Iterator[Page]:
    """A headless Chromium with its profile in `place`, and its one page."""
    command = [*command_line(place), "--remote-debugging-port=0", "about:blank"]
    # Debian's chromium-headless-shell is a script that waits for the browser:
    # signalling the process group ends both.
    process = subprocess.Popen(  # noqa: S603
        command,
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
    )
    try:
        assert process.stderr is not None
        for line in process.stderr:
            if found := re.search(r"DevTools listening on (ws://\S+)", line):
                break
        else:
            raise AssertionError("Chromium did not start")
        host = re.match(r"ws://([^/]+)/", found[1])
        assert host is not None
        import urllib.request

        tabs = json.loads(
            urllib.request.urlopen(f"http://{host[1]}/json/list", timeout=30).read()
        )
        address = next(
            tab["webSocketDebuggerUrl"] for tab in tabs if tab["type"] == "page"
        )
        with connect(address, max_size=2**26, compression=None) as socket:
            yield Page(socket)
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
