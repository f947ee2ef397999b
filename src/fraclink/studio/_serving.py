"""Start the studio, say where it is, and end it when nobody looks any more."""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import socket
import time
import webbrowser
from collections.abc import Callable
from importlib.util import find_spec
from typing import TYPE_CHECKING, Literal

import uvicorn

from fraclink.errors import FieldError, MissingExtraError
from fraclink.studio._protocol import LONGEST
from fraclink.studio._server import Studio, application

if TYPE_CHECKING:
    from fraclink.studio._session import Session

__all__ = ["serve"]

_ALONE = 600.0  # [s] without a page, after which the studio ends
_LOOK = 0.5  # [s] between two looks
_PING = 20.0  # [s]


def serve(
    opening: Callable[[], Session],
    *,
    host: str = "127.0.0.1",
    port: int = 0,
    unsafe_remote: bool = False,
    open_page: bool = True,
    say: Callable[[str], None] = print,
) -> Session:
    """Serve a session until Ctrl-C, or until no page has been open for ten minutes, and
    return it.

    Parameters
    ----------
    opening
        makes the session; it runs while the browser loads the page, and what it raises
        ends the studio.
    host, port
        where to listen; port 0 takes one that is free. An address that others can reach
        needs `unsafe_remote`: everybody who learns the token can then read and change
        the study.
    open_page
        whether to open the browser.
    say
        called with the address, which holds the token, as a line.

    Raises
    ------
    FieldError
        the address is not of this machine alone, or is taken; or what `opening` raises.
    """
    listener = _listening(host, port, unsafe_remote)
    port = listener.getsockname()[1]
    shown = f"[{host}]" if ":" in host else host
    hosts = {f"{shown}:{port}"} | (
        {f"127.0.0.1:{port}", f"localhost:{port}"} if _is_loopback(host) else set()
    )
    studio = Studio(opening, hosts=hosts)
    address = f"http://{shown}:{port}/#{studio.token}"
    settings = uvicorn.Config(
        application(studio),
        log_level="critical",  # its lines would name the addresses of pages
        access_log=False,
        server_header=False,
        ws=_sockets(),
        # Four bytes a letter at most (UTF-8): longer than any request that `parsed`
        # would take.
        ws_max_size=4 * LONGEST,
        ws_ping_interval=_PING,
        ws_per_message_deflate=False,  # 14 kB a drag that never leave the machine
        h11_max_incomplete_event_size=LONGEST,
        lifespan="off",
    )
    server = uvicorn.Server(settings)
    say(address)
    # Said before the browser is opened: on a machine without one the line is all there
    # is.
    if open_page:
        webbrowser.open(address)
    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(_served(server, listener, studio))
    session = studio.session
    session.close()
    return session


def _sockets() -> Literal["wsproto", "websockets-sansio"]:
    """What speaks the protocol of the socket: wsproto, a tenth of the size, or what is
    there anyway.
    """
    if find_spec("wsproto") is not None:
        return "wsproto"
    if find_spec("websockets") is not None:
        return "websockets-sansio"
    raise MissingExtraError("wsproto", "studio")


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
        # A page that is reloaded is away for a second, a laptop that sleeps for longer:
        # ten minutes are both.
        if studio.failed or (
            not studio.pages and time.monotonic() - studio.alone_since > _ALONE
        ):
            server.should_exit = True


def _is_loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _listening(host: str, port: int, unsafe_remote: bool) -> socket.socket:
    if not unsafe_remote and not _is_loopback(host):
        problem, allowed = (
            "an address that others can reach",
            "127.0.0.1, localhost or ::1",
        )
        remedy = "leave it out, or give --unsafe-remote on a network of your own"
        raise FieldError("host", host, problem, allowed=allowed, remedy=remedy)
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    # Or a studio that is started again on its port waits a minute for the last one's
    # sockets.
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((host, port))
        # before the address is said: whoever opens it at once waits and is not refused
        listener.listen()
    except OSError as error:
        listener.close()
        allowed, remedy = (
            "a free port of this machine",
            "leave --port out: a free one is taken",
        )
        why = error.strerror or str(error)
        raise FieldError(
            "port", f"{host}:{port}", why, allowed=allowed, remedy=remedy
        ) from error
    return listener
