"""Start the studio, say where it is, and end it when nobody looks any more."""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import socket
import time
import webbrowser
from collections.abc import Callable

import uvicorn

from fraclink._studio.messages import LONGEST
from fraclink._studio.server import Studio, application
from fraclink._studio.session import Session
from fraclink.errors import FieldError

__all__ = ["serve"]

_ALONE = 600.0  # [s] without a page, after which the studio ends
_LOOK = 2.0  # [s] between two looks
_PING = 20.0  # [s]


def serve(
    session: Session,
    *,
    host: str = "127.0.0.1",
    port: int = 0,
    unsafe_remote: bool = False,
    open_page: bool = True,
    say: Callable[[str], None] = print,
) -> None:
    """Serve `session` until Ctrl-C, or until no page has been open for ten minutes.

    Parameters
    ----------
    host, port
        where to listen; port 0 takes one that is free. An address that others can reach needs
        `unsafe_remote`: everybody who learns the token can then read and change the study.
    open_page
        whether to open the browser.
    say
        called with the address, which holds the token, as a line.

    Raises
    ------
    FieldError
        the address is not of this machine alone, or is taken.
    """
    listener = _listening(host, port, unsafe_remote)
    port = listener.getsockname()[1]
    shown = f"[{host}]" if ":" in host else host
    hosts = {f"{shown}:{port}"} | (
        {f"127.0.0.1:{port}", f"localhost:{port}"} if _is_loopback(host) else set()
    )
    studio = Studio(session, hosts=hosts)
    address = f"http://{shown}:{port}/#{studio.token}"
    settings = uvicorn.Config(
        application(studio),
        log_level="critical",  # its lines would name the addresses of pages
        access_log=False,
        server_header=False,
        ws="websockets-sansio",
        ws_max_size=4 * LONGEST,
        ws_ping_interval=_PING,
        h11_max_incomplete_event_size=LONGEST,
        lifespan="off",
    )
    server = uvicorn.Server(settings)
    say(address)
    if open_page:
        webbrowser.open(address)
    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(_served(server, listener, studio))
    session.close()


async def _served(server: uvicorn.Server, listener: socket.socket, studio: Studio) -> None:
    watching = asyncio.create_task(_watch(server, studio))
    try:
        await server.serve(sockets=[listener])
    finally:
        watching.cancel()


async def _watch(server: uvicorn.Server, studio: Studio) -> None:
    while True:
        await asyncio.sleep(_LOOK)
        if not studio.pages and time.monotonic() - studio.alone_since > _ALONE:
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
        problem, allowed = "an address that others can reach", "127.0.0.1, localhost or ::1"
        remedy = "leave it out, or give --unsafe-remote on a network of your own"
        raise FieldError("host", host, problem, allowed=allowed, remedy=remedy)
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((host, port))
        listener.listen()  # before the address is said: whoever opens it at once waits and is not refused
    except OSError as error:
        listener.close()
        allowed, remedy = "a free port of this machine", "leave --port out: a free one is taken"
        why = error.strerror or str(error)
        raise FieldError("port", f"{host}:{port}", why, allowed=allowed, remedy=remedy) from error
    return listener
