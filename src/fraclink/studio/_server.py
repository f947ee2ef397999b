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

from fraclink._reading.table import check_bytes
from fraclink.errors import SizeError
from fraclink.view._pages import ARM_SCRIPTS, squeezed

if TYPE_CHECKING:
    from fraclink.studio._session import Session

__all__ = ["Studio", "application"]

# No inline script or style, no other host, no frame: a script smuggled in by a hostile
# name in a log does not run. WebAssembly has to be compiled, hence 'wasm-unsafe-eval'.
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
# A plain file name with an ending: no folder, and no leading dot or hyphen.
_NAME = re.compile(r"[\w][\w .()+-]{0,100}\.\w{1,10}")
_PATIENCE = 10.0  # [s] for the token, which the page sends immediately

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]


class Studio:
    """State shared by all pages of a server: the session, the token, and the time since
    which no page is open.

    `opening` creates the session in parallel with the server: arrays, optimisation and
    the study take a second to load, and by then the browser has the page.
    """

    def __init__(
        self, opening: Callable[[], Session], *, hosts: Iterable[str] = ()
    ) -> None:
        self._session: Future[Session] = Future()
        # A daemon thread, so that Ctrl-C ends the studio while numpy is still loading.
        Thread(target=self._open, args=(opening,), daemon=True).start()
        self.token = secrets.token_urlsafe(24)  # 192 bits
        self.hosts = frozenset(hosts)  # empty until the port is known
        self.pages = 0
        self.alone_since = time.monotonic()

    def _open(self, opening: Callable[[], Session]) -> None:
        try:
            session = opening()
            # loaded in advance, before the first request
            import fraclink.studio._conversation  # noqa: F401
        # passed on to all that wait for the session
        except BaseException as error:  # noqa: BLE001
            self._session.set_exception(error)
        else:
            self._session.set_result(session)

    @property
    def session(self) -> Session:
        """The open study; waits for it, and raises the errors of opening it."""
        return self._session.result()

    @property
    def failed(self) -> bool:
        """Whether opening the study has failed."""
        return self._session.done() and self._session.exception() is not None

    def knows(self, token: object) -> bool:
        """Whether `token` is correct; compared in constant time."""
        return isinstance(token, str) and hmac.compare_digest(
            token.encode(), self.token.encode()
        )


class _Guard:
    """Rejects requests for another host (DNS rebinding: 421) and from another origin
    (403).
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
        # A browser states the origin of every socket and every POST, and no script of
        # another page can forge it; a GET from the same origin has none.
        foreign = (
            origin is not None
            and origin.removeprefix("http://") not in self.studio.hosts
        )
        # Another page may resolve its own name to 127.0.0.1 (DNS rebinding), which
        # makes the origins equal; but the Host header still contains that name.
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
    """All files that are served: path -> (content, kind). Nothing else can be
    requested.
    """
    contents = {
        f"/{path.name}": (
            squeezed(path.name, _PAGE).encode()
            if path.name.endswith((".js", ".css"))
            else path.read_bytes(),
            _KINDS[Path(path.name).suffix],
        )
        for path in _PAGE.iterdir()
        if Path(path.name).suffix in _KINDS
    }
    fragment = re.sub(r"{#.*?#}\s*", "", squeezed("arm_box.html"), flags=re.DOTALL)
    page = (
        contents.pop("/index.html")[0]
        .decode()
        .replace("<!-- arm_box.html -->", fragment)
    )
    contents["/"] = (page.encode(), "text/html")
    style = squeezed("palette.css") + squeezed("arm_box.css")
    contents["/arm_box.css"] = (style.encode(), "text/css")
    contents["/arm_box.js"] = (_arm_module().encode(), "text/javascript")
    contents |= {
        f"/{name}": (squeezed(name).encode(), "text/javascript")
        for name in ("svg.js", "plots.js")
    }
    return contents


def _arm_module() -> str:
    """The scripts of the arm's page as one module: the same code, with an entry point
    for another law.

    In the arm's page they write their settings to the address and listen to the whole
    document; here both belong to the studio.
    """
    before, after = (_PAGE / name for name in ("arm_before.txt", "arm_after.txt"))
    body = "".join(squeezed(name) for name in ARM_SCRIPTS)
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

    routes = [Route(path, page) for path in contents]
    app = Starlette(
        middleware=[Middleware(GZipMiddleware)],
        routes=[
            *routes,
            Route("/upload", upload, methods=["POST"]),
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
    """Write the body to the draft folder under its name, or reject it."""

    def refused(status: int, why: str) -> Response:
        return PlainTextResponse(why, status, headers=_HEADERS)

    if not studio.knows(request.headers.get("x-studio-token")):
        return refused(403, "wrong token")
    name = request.query_params.get("name", "")
    if not _NAME.fullmatch(name):
        return refused(400, "name: letters, digits, spaces, and an ending")
    # A file system counts bytes; common ones allow 255.
    if len(os.fsencode(name)) > 255:
        return refused(400, "name: longer than 255 bytes; give the file a shorter one")
    place = studio.session.draft / "upload" / name
    size = 0
    try:
        place.parent.mkdir(exist_ok=True)
        with place.open("wb") as file:
            async for part in request.stream():
                size += len(part)
                # Counted while receiving, because the length in the header is only a
                # claim.
                check_bytes(size)
                file.write(part)
    except (SizeError, ClientDisconnect) as error:
        place.unlink(missing_ok=True)
        return refused(413, str(error))
    except OSError as error:  # a full disk, or a folder of the same name
        if place.is_file():
            place.unlink()
        return refused(507, f"not stored: {error.strerror}")
    studio.session.upload = place
    return Response(status_code=204, headers=_HEADERS)


async def _talked(studio: Studio, socket: WebSocket) -> None:
    await socket.accept()
    try:
        # The token is sent as the first message and not in the address, which logs and
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
        # reported in the terminal by `serve`, which then ends
        except Exception:  # noqa: BLE001
            await socket.close(1011)
            return
        # loaded after the first paint, with the session
        from fraclink.studio._conversation import (
            Conversation,
        )

        await Conversation(session, socket).run()


@contextlib.asynccontextmanager
async def _counted(studio: Studio) -> AsyncIterator[None]:
    studio.pages += 1
    try:
        yield
    finally:
        studio.pages -= 1
        studio.alone_since = time.monotonic()
