"""Open a way to an arm, at the controller's end or at the arm's, and close it again."""

from __future__ import annotations

import ctypes
import fcntl
import os
import socket
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fraclink import _kernels
from fraclink._realtime.connections import Callback, Command, Connection, Library, SharedMemory, Udp
from fraclink.errors import FieldError

__all__ = ["arm_end", "controller_end"]

IO_VERSION = 1  # ARM_IO_VERSION of arm_io.h
_MEMORY = Path("/dev/shm")  # noqa: S108  # where Linux keeps POSIX shared memory, by shm_open(3)
_ARM, _CONTROLLER = 0, 1  # bytes of the shared memory that each end locks while it lives
_LOOK = 0.02  # [s] between two looks for an arm that is not there yet


@contextmanager
def controller_end(connection: Connection, patience: float) -> Iterator[Any]:
    """Open the controller's end, waiting up to `patience` [s] for shared memory; yields the kernel's way."""
    if isinstance(connection, Udp):
        with _datagrams(connection) as (plug, address):
            plug.connect(address)
            yield _kernels.RealtimeIo.socket(plug.fileno(), False)
    elif isinstance(connection, SharedMemory):
        with _attached(connection, patience) as file:
            yield _kernels.RealtimeIo.memory(file, False)
    elif isinstance(connection, Library):
        with _loaded(connection) as (read, write):
            yield _kernels.RealtimeIo.library(read, write)
    else:
        yield _callables(connection)


@contextmanager
def arm_end(connection: Connection) -> Iterator[Any]:
    """Open the arm's end; one arm at a time, and only one that sends messages."""
    if isinstance(connection, Udp):
        with _datagrams(connection) as (plug, address):
            try:
                plug.bind(address)
            except OSError as error:
                raise _refused(connection, error, "a free port of this machine") from error
            yield _kernels.RealtimeIo.socket(plug.fileno(), True)
    elif isinstance(connection, SharedMemory):
        with _created(connection) as file:
            yield _kernels.RealtimeIo.memory(file, True)
    else:
        raise FieldError(
            "io",
            str(connection),
            "no way to serve an arm",
            allowed="udp:HOST:PORT or shm:NAME",
            remedy="a library or a callback is the arm itself",
        )


def _refused(connection: Connection, error: OSError, allowed: str) -> FieldError:
    reason = error.strerror or str(error)
    return FieldError(
        "io",
        str(connection),
        f"refused ({reason})",
        allowed=allowed,
        remedy="choose another, or end the other",
    )


@contextmanager
def _datagrams(connection: Udp) -> Iterator[tuple[socket.socket, Any]]:
    try:
        found = socket.getaddrinfo(connection.host, connection.port, type=socket.SOCK_DGRAM)
    except OSError as error:
        raise _refused(connection, error, "a host that can be found") from error
    family, kind, protocol, _, address = found[0]
    with socket.socket(family, kind, protocol) as plug:
        yield plug, address


def _locked(file: int, byte: int) -> bool:
    """Lock one byte for as long as the file is open; False where another open file has it.

    Locks of open files (not of processes): they also hold between two threads, and die with their owner.
    """
    wish = struct.pack("hhqqi4x", fcntl.F_WRLCK, os.SEEK_SET, byte, 1, 0)  # struct flock
    try:
        fcntl.fcntl(file, fcntl.F_OFD_SETLK, wish)
    except (BlockingIOError, PermissionError):
        return False
    return True


def _served(file: int) -> bool:
    """Whether an arm holds its end."""
    wish = struct.pack("hhqqi4x", fcntl.F_WRLCK, os.SEEK_SET, _ARM, 1, 0)
    return bool(struct.unpack("hhqqi4x", fcntl.fcntl(file, fcntl.F_OFD_GETLK, wish))[0] != fcntl.F_UNLCK)


@contextmanager
def _created(connection: SharedMemory) -> Iterator[int]:
    place = _MEMORY / f"fraclink-{connection.name}"
    try:
        # Private: whoever may write here moves the arm.
        file = os.open(place, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    except OSError as error:
        raise _refused(connection, error, "shared memory of this user") from error
    try:
        if not _locked(file, _ARM):
            raise FieldError(
                "io", str(connection), "served by another arm", allowed="a free name", remedy="choose another"
            )
        try:
            os.ftruncate(file, _kernels.realtime_memory_size())
            yield file
        finally:
            place.unlink(missing_ok=True)
    finally:
        os.close(file)


@contextmanager
def _attached(connection: SharedMemory, patience: float) -> Iterator[int]:
    last = time.monotonic() + patience
    while (file := _existing(connection)) is None:
        if time.monotonic() > last:
            raise FieldError(
                "io",
                str(connection),
                f"served by no arm within {patience:g} s",
                allowed="an arm that serves it",
                remedy=f"start `fraclink serve-arm DESIGN --io {connection}`",
            )
        time.sleep(_LOOK)
    try:
        if not _locked(file, _CONTROLLER):
            raise FieldError(
                "io",
                str(connection),
                "in use by another controller",
                allowed="one controller",
                remedy="end the other one",
            )
        yield file
    finally:
        os.close(file)


def _existing(connection: SharedMemory) -> int | None:
    place = _MEMORY / f"fraclink-{connection.name}"
    try:
        file = os.open(place, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise _refused(connection, error, "shared memory of this user") from error
    if os.fstat(file).st_size == _kernels.realtime_memory_size() and _served(file):
        return file
    os.close(file)
    return None


@contextmanager
def _loaded(connection: Library) -> Iterator[tuple[int, int]]:
    """Load the library and open its board; yields the addresses of its two functions."""
    path = connection.path.resolve()  # without a slash the loader would search its own folders
    try:
        library = ctypes.CDLL(str(path))
    except OSError as error:
        raise _unfit(connection, f"not to be loaded ({error})") from error
    read, write, version = (_function(library, name) for name in ("arm_read", "arm_write", "arm_io_version"))
    if read is None or write is None or version is None:
        raise _unfit(connection, "without arm_read, arm_write and arm_io_version")
    if version() != IO_VERSION:
        raise _unfit(connection, f"made for version {version()} of arm_io.h")
    begin, end = _function(library, "arm_open"), _function(library, "arm_close")
    if begin is not None and (code := begin()) != 0:
        raise _unfit(connection, f"not ready: arm_open gave {code}")
    try:
        yield _address(read), _address(write)
    finally:
        if end is not None:
            end()


def _function(library: ctypes.CDLL, name: str) -> Callable[[], int] | None:
    return getattr(library, name, None)


def _address(function: Any) -> int:
    return ctypes.cast(function, ctypes.c_void_p).value or 0


def _unfit(connection: Library, problem: str) -> FieldError:
    return FieldError(
        "io",
        str(connection),
        problem,
        allowed=f"a library compiled with arm_io.h, version {IO_VERSION}",
        remedy="start from `fraclink export io`",
    )


def _callables(connection: Callback) -> Any:
    for name in ("read", "write"):
        if not callable(getattr(connection, name)):
            raise FieldError(
                f"callback.{name}",
                getattr(connection, name),
                "not a function",
                allowed="a callable",
                remedy="give a function",
            )
    apply = connection.write

    def write(*values: Any) -> None:
        apply(Command(*values))

    return _kernels.RealtimeIo.callables(connection.read, write)
