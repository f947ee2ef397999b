"""Start the studio, print its address, and end it when no page is open any more."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import time
import webbrowser
from collections.abc import Callable
from typing import TYPE_CHECKING

import uvicorn
import wsproto  # noqa: F401  (needed by uvicorn; its absence is reported before the start)

from fraclink.errors import FieldError
from fraclink.studio._protocol import LONGEST
from fraclink.studio._server import Studio, application

if TYPE_CHECKING:
    from fraclink.studio._session import Session

__all__ = ["serve"]

_HOST = "127.0.0.1"
_ALONE = 600.0  # [s] without a page, after which the studio ends
_LOOK = 0.5  # [s] between two checks


def serve(
    opening: Callable[[], Session],
    *,
    port: int = 0,
    open_page: bool = True,
    say: Callable[[str], None] = print,
) -> Session:
    """Serve a session until Ctrl-C, or until no page has been open for ten minutes, and
    return it.

    Parameters
    ----------
    opening
        makes the session; it runs while the browser loads the page, and an error in it
        ends the studio.
    port
        to listen on, of this machine only (127.0.0.1); 0 takes a free one. From another
        machine the page is reached through ``ssh -L``.
    open_page
        whether to open the browser.
    say
        called with the address, which holds the token, as a line.

    Raises
    ------
    FieldError
        the port is taken; or what `opening` raises.
    """
    listener = _listening(port)
    port = listener.getsockname()[1]
    studio = Studio(opening, hosts=(f"{_HOST}:{port}", f"localhost:{port}"))
    address = f"http://{_HOST}:{port}/#{studio.token}"
    settings = uvicorn.Config(
        application(studio),
        log_level="critical",  # its log lines would contain the addresses of pages
        access_log=False,
        server_header=False,
        ws="wsproto",
        # At most four bytes per character (UTF-8): longer than any request accepted by
        # `parsed`.
        ws_max_size=4 * LONGEST,
        ws_per_message_deflate=False,  # 9 to 27 kB an answer, all local
        h11_max_incomplete_event_size=LONGEST,
        lifespan="off",
    )
    server = uvicorn.Server(settings)
    say(address)
    # Printed before the browser is opened: on a machine without one, this line is the
    # only information.
    if open_page:
        webbrowser.open(address)
    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(_served(server, listener, studio))
    session = studio.session
    session.close()
    return session


async def _served(
    server: uvicorn.Server, listener: socket.socket, studio: Studio
) -> None:
    watching = asyncio.create_task(_watch(server, studio))
    try:
        await server.serve(sockets=[listener])
    finally:
        watching.cancel()


async def _watch(server: uvicorn.Server, studio: Studio) -> None:
    while True:
        await asyncio.sleep(_LOOK)
        # A reloaded page is away for a second, a sleeping laptop for longer: ten
        # minutes cover both.
        if studio.failed or (
            not studio.pages and time.monotonic() - studio.alone_since > _ALONE
        ):
            server.should_exit = True


def _listening(port: int) -> socket.socket:
    listener = socket.socket()
    # Without it, a studio restarted on its port would wait a minute for the old sockets
    # to expire.
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((_HOST, port))
        # before the address is printed, so that an immediate connection waits instead
        # of being refused
        listener.listen()
    except OSError as error:
        listener.close()
        allowed, remedy = (
            "a free port of this machine",
            "leave --port out: a free one is taken",
        )
        why = error.strerror or str(error)
        raise FieldError("port", f"{_HOST}:{port}", why, allowed, remedy) from error
    return listener
