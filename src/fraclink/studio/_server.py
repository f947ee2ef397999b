"""The studio's server: one page, one socket, this machine only."""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import os
import re
import secrets
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, MutableMapping
from concurrent.futures import Future
from importlib.resources import files
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from fraclink.view._pages import squeezed, template_text

if TYPE_CHECKING:
    from fraclink.studio._session import Session

__all__ = ["Studio", "application"]

# No inline script or style, no other host, no frame: what a hostile name in a log could
# smuggle into the page does not run. WebAssembly must be compiled, hence
# 'wasm-unsafe-eval'.
POLICY = (
    "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self'; img-src 'self' data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_HEADERS = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}
_PAGE = files("fraclink.studio") / "page"
_KINDS = {
    ".html": "text/html",
    ".js": "text/javascript",
    ".css": "text/css",
    ".svg": "image/svg+xml",
}
_SCRIPTS = ("arm_engine.js", "arm_drawing.js", "arm_page.js")
UPLOAD_LIMIT = 200_000_000  # bytes: as much as the readers of logs take
# A plain file name with an ending: no folder, no leading dot, nothing that a file
# system or a shell takes for something else.
_NAME = re.compile(r"[\w][\w .()+-]{0,100}\.\w{1,10}")
_PATIENCE = 10.0  # [s] for the token, which the page sends at once

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]


class Studio:
    """What all pages of one server share: the session, the token, and since when nobody
    has looked.

    `opening` makes the session. It runs beside the server: arrays, optimisation and the
    study take a second to load, and a browser has the page by then.
    """

    def __init__(
        self, opening: Callable[[], Session], *, hosts: Iterable[str] = ()
    ) -> None:
        self._session: Future[Session] = Future()
        # A daemon: Ctrl-C while numpy is still loading ends the studio.
        Thread(target=self._open, args=(opening,), daemon=True).start()
        self.token = secrets.token_urlsafe(24)  # 192 bits
        self.hosts = frozenset(hosts)  # empty: set when the port is known
        self.pages = 0
        self.alone_since = time.monotonic()

    def _open(self, opening: Callable[[], Session]) -> None:
        try:
            session = opening()
            import fraclink.studio._conversation  # what answers: before it is asked  # noqa: F401
        except BaseException as error:  # handed to whoever waits for the session  # noqa: BLE001
            self._session.set_exception(error)
        else:
            self._session.set_result(session)

    @property
    def session(self) -> Session:
        """The open study; waits for it, and raises what opening it raised."""
        return self._session.result()

    @property
    def failed(self) -> bool:
        """Whether there is no study to show, and never will be."""
        return self._session.done() and self._session.exception() is not None

    def knows(self, token: object) -> bool:
        """Whether `token` is the one; compared in a time that does not depend on it."""
        return isinstance(token, str) and hmac.compare_digest(
            token.encode(), self.token.encode()
        )


class _Guard:
    """Refuses another Host than this server's (DNS rebinding: 421) and sockets of other
    origins (403).
    """

    def __init__(self, app: Any, studio: Studio) -> None:
        self.app, self.studio = app, studio

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        headers = {
            key.decode("latin-1"): value.decode("latin-1")
            for key, value in scope["headers"]
        }
        origin = headers.get("origin")
        # A browser names the origin of every socket and of every POST, and no script of
        # another page can forge it; a GET of one's own has none.
        foreign = (
            origin is not None
            and origin.removeprefix("http://") not in self.studio.hosts
        )
        # Another page may resolve its own name to 127.0.0.1 (DNS rebinding) and is then
        # of one origin with it: the Host header still has its name.
        if headers.get("host") not in self.studio.hosts:
            await _refuse(scope, receive, send, 421, "wrong host")
        elif foreign or (origin is None and scope["type"] == "websocket"):
            await _refuse(scope, receive, send, 403, "wrong origin")
        else:
            await self.app(scope, receive, send)


async def _refuse(
    scope: Scope, receive: Receive, send: Send, status: int, why: str
) -> None:
    response = PlainTextResponse(why, status, headers=_HEADERS)
    if scope["type"] == "websocket":
        await WebSocket(scope, receive, send).send_denial_response(response)
    else:
        await response(scope, receive, send)


def _contents() -> dict[str, tuple[bytes, str]]:
    """Every file that is served: path -> (content, kind). Nothing else can be asked
    for.
    """
    found = {
        f"/{path.name}": (path.read_bytes(), _KINDS[Path(path.name).suffix])
        for path in _PAGE.iterdir()
        if Path(path.name).suffix in _KINDS
    }
    fragment = re.sub(r"{#.*?#}\s*", "", template_text("arm_box.html"), flags=re.DOTALL)
    page = (
        found.pop("/index.html")[0].decode().replace("<!-- arm_box.html -->", fragment)
    )
    found["/"] = (page.encode(), "text/html")
    style = squeezed("palette.css") + squeezed("arm_box.css")
    found["/arm_box.css"] = (style.encode(), "text/css")
    found["/arm_box.js"] = (_arm_module().encode(), "text/javascript")
    return found


def _arm_module() -> str:
    """The scripts of the arm's page as one module: the same lines, with a door for
    another law.

    They write their settings to the page's address, and hear the whole document; both
    are the studio's here.
    """
    before, after = (_PAGE / name for name in ("arm_before.txt", "arm_after.txt"))
    body = "".join(squeezed(name) for name in _SCRIPTS)
    return before.read_text("utf-8") + body + after.read_text("utf-8")


def application(studio: Studio) -> Any:
    """Return the ASGI application of a studio."""
    contents = _contents()

    def page(request: Request) -> Response:
        content, kind = contents[request.url.path]
        return Response(content, media_type=kind, headers=_HEADERS)

    async def upload(request: Request) -> Response:
        return await _uploaded(studio, request)

    async def talk(socket: WebSocket) -> None:
        await _talked(studio, socket)

    def download(request: Request) -> Response:
        return _downloaded(studio, request)

    routes = [Route(path, page) for path in contents]
    app = Starlette(
        middleware=[Middleware(GZipMiddleware)],
        routes=[
            *routes,
            Route("/upload", upload, methods=["POST"]),
            Route("/studio.zip", download),
            WebSocketRoute("/talk", talk),
        ],
        exception_handlers={404: _nothing, 405: _nothing},
    )
    return _Guard(app, studio)


async def _nothing(request: Request, error: Exception) -> Response:
    return PlainTextResponse(
        "nothing here", getattr(error, "status_code", 404), headers=_HEADERS
    )


async def _uploaded(studio: Studio, request: Request) -> Response:
    """Write the body to the draft folder under the name that it has, or refuse it."""

    def refused(status: int, why: str) -> Response:
        return PlainTextResponse(why, status, headers=_HEADERS)

    if not studio.knows(request.headers.get("x-studio-token")):
        return refused(403, "wrong token")
    name = request.query_params.get("name", "")
    if not _NAME.fullmatch(name):
        return refused(400, "name: letters, digits, spaces, and an ending")
    # A file system counts bytes; 255 of them is what the common ones take.
    if len(os.fsencode(name)) > 255:
        return refused(400, "name: longer than 255 bytes; give the file a shorter one")
    place = studio.session.draft / "upload" / name
    size = 0
    try:
        place.parent.mkdir(exist_ok=True)
        with place.open("wb") as file:
            async for part in request.stream():
                size += len(part)
                # Counted while it comes: a length in the header is only a claim.
                if size > UPLOAD_LIMIT:
                    raise ValueError
                file.write(part)
    except (ValueError, ClientDisconnect):
        place.unlink(missing_ok=True)
        return refused(413, f"at most {UPLOAD_LIMIT} bytes")
    except OSError as error:  # a full disk, or a folder of that name
        if place.is_file():
            place.unlink()
        return refused(507, f"not stored: {error.strerror}")
    studio.session.upload = place
    return Response(status_code=204, headers=_HEADERS)


def _downloaded(studio: Studio, request: Request) -> Response:
    """The archive that the verb `zip` packed; with the token only, as it holds the
    user's files.
    """
    place = studio.session.draft / "studio.zip"
    if not studio.knows(request.headers.get("x-studio-token")):
        return PlainTextResponse("wrong token", 403, headers=_HEADERS)
    if not place.is_file():
        return PlainTextResponse("nothing here", 404, headers=_HEADERS)
    return Response(place.read_bytes(), media_type="application/zip", headers=_HEADERS)


async def _talked(studio: Studio, socket: WebSocket) -> None:
    await socket.accept()
    try:
        # The token comes as the first message and not in the address, which logs and
        # histories keep.
        token = await asyncio.wait_for(socket.receive_text(), _PATIENCE)
    except (
        TimeoutError,
        WebSocketDisconnect,
        KeyError,
    ):  # KeyError: bytes instead of text
        token = ""
    if not studio.knows(token):
        with contextlib.suppress(RuntimeError):  # gone already
            await socket.close(1008)
        return
    async with _counted(studio):
        try:
            session = await asyncio.to_thread(lambda: studio.session)
        except Exception:  # said in the terminal by `serve`, which ends now  # noqa: BLE001
            await socket.close(1011)
            return
        from fraclink.studio._conversation import (
            Conversation,
        )  # loaded behind the first paint, with the session

        await Conversation(session, socket).run()


@contextlib.asynccontextmanager
async def _counted(studio: Studio) -> AsyncIterator[None]:
    studio.pages += 1
    try:
        yield
    finally:
        studio.pages -= 1
        studio.alone_since = time.monotonic()
