"""Connections to an arm: a serial line, UDP, two Python functions."""

from __future__ import annotations

import hmac
import ipaddress
import os
import re
import socket
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from fraclink import _kernels
from fraclink.errors import FieldError
from fracsys.checks import Between, checked, whole_number

if sys.platform != "win32":
    import fcntl
    import pty
    import termios
    import tty

__all__ = [
    "Callback",
    "Command",
    "Connection",
    "Serial",
    "Udp",
    "arm_end",
    "controller_end",
    "parse_connection",
    "silent",
]

_FORMS = "serial:PORT@BAUD or udp:HOST:PORT"
_SECRET_BYTES = (
    16  # too many to guess: of the shortest key, of a tag (MESSAGE_TAG, realtime.h)
)
_PTY = "pty"  # a pseudo-terminal on which an arm is served


class Command(NamedTuple):
    """The output of the law in one period: motor_reference θm* [rad], voltage [V], the
    number of the period, and the law's mode, reason and flags (see law.h).

    In modes 0 and 4 the drive must be off, and the motor reference is meaningless: 0
    before the law has started, 4 for the safe stop, which is the last command of every
    run.
    """

    motor_reference: float
    voltage: float
    tick: int
    mode: int
    reason: int
    flags: int


def _error(connection: object, problem: str, allowed: str, remedy: str) -> FieldError:
    return FieldError("io", str(connection), problem, allowed, remedy)


@dataclass(frozen=True)
class Udp:
    """An arm that is reached by datagrams: `host`, a name or an address, and `port`, 1
    to 65535.

    Any host but this machine needs `unsafe_remote`: datagrams are not encrypted, and
    without a `key` everybody who can send to the arm can move it. With the same `key`
    of 16 bytes or more at both ends, messages carry the first 16 bytes of their
    HMAC-SHA-256 (RFC 2104), and others are dropped.

    >>> str(Udp("127.0.0.1", 5005))
    'udp:127.0.0.1:5005'
    """

    host: str
    port: int
    unsafe_remote: bool = False
    key: bytes | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        # The socket library takes an empty host as all addresses of this machine, which
        # is never intended.
        if not isinstance(self.host, str) or not self.host:
            raise _error("udp:", "without a host", _FORMS, "udp:127.0.0.1:5005")
        whole_number(Between(1, 65535)).check("port", self.port)
        if self.key is not None and not (
            isinstance(self.key, bytes) and len(self.key) >= _SECRET_BYTES
        ):
            # never show the key itself
            text = f"{len(self.key)} {type(self.key).__name__}"
            raise FieldError(
                "key",
                text,
                "not a key",
                f"{_SECRET_BYTES} bytes or more",
                "head -c 32 /dev/urandom > arm.key",
            )

    def __str__(self) -> str:
        return f"udp:{self.host}:{self.port}"


@dataclass(frozen=True)
class Serial:
    """An arm on a serial line: `port`, such as /dev/ttyACM0, and `baud` [bits/s], one of
    the speeds that the system knows.

    A message is 56 bytes of 10 bits: at 1 000 000 bits/s it takes 0.6 ms, at 115 200
    4.9 ms, in either direction. The port "pty", for `serve_arm` alone, is a
    pseudo-terminal whose name the system chooses.

    >>> str(Serial("/dev/ttyACM0", 2_000_000))
    'serial:/dev/ttyACM0@2000000'
    """

    port: str
    baud: int = 1_000_000

    def __post_init__(self) -> None:
        if not isinstance(self.port, str) or not self.port:
            raise _error("serial:", "without a port", _FORMS, "serial:/dev/ttyACM0")
        whole_number(Between(1, 100_000_000)).check("baud", self.baud)

    def __str__(self) -> str:
        return f"serial:{self.port}@{self.baud}"


@dataclass(frozen=True, eq=False)
class Callback:
    """A board behind two functions of Python, each called once in a period.

    `read` returns (motor angle [rad], torque [N·m]), or None where the sample was lost;
    `write` applies a `Command`. An exception in either stops the run safely and is
    raised again. Convenient, but the loop then waits for the interpreter: other threads
    of Python may hold it for milliseconds.
    """

    read: Callable[[], tuple[float, float] | None]
    write: Callable[[Command], object]

    def __str__(self) -> str:
        return "callback"


Connection = Serial | Udp | Callback


@checked
def parse_connection(
    io: str, *, unsafe_remote: bool = False, key: bytes | None = None
) -> Serial | Udp:
    """Return the connection that the command line names: serial:PORT@BAUD or
    udp:HOST:PORT.

    `unsafe_remote` and `key` are those of `Udp`; a key for a serial line is refused.

    >>> parse_connection("udp:localhost:5005")
    Udp(host='localhost', port=5005, unsafe_remote=False)
    >>> parse_connection("tcp:localhost:5005")
    Traceback (most recent call last):
    fracsys.errors.FieldError: io: not a connection to an arm (got tcp:localhost:5005); expected serial:PORT@BAUD
    or udp:HOST:PORT. Start with serial: or udp:.
    """
    kind, _, rest = io.partition(":")
    # Rejected instead of ignored: a user who gives a key relies on it to keep strangers
    # out.
    if key is not None and kind != "udp":
        raise FieldError("key", io, "of no use here", "udp:HOST:PORT", "leave it out")
    if kind == "serial":
        port, at, baud = rest.rpartition("@")
        if not at:
            return Serial(rest)
        if not re.fullmatch(r"[0-9]{1,9}", baud):
            raise _error(io, "without a speed", "bits/s", f"serial:{port}@1000000")
        return Serial(port, int(baud))
    if kind != "udp":
        raise _error(
            io,
            "not a connection to an arm",
            _FORMS,
            "start with serial: or udp:",
        )
    # From the right, because an IPv6 address contains colons, in brackets or not.
    host, _, port = rest.rpartition(":")
    if not re.fullmatch(r"[0-9]{1,5}", port):
        raise _error(io, "without a port", "1 to 65535", "udp:127.0.0.1:5005")
    return Udp(host.removeprefix("[").removesuffix("]"), int(port), unsafe_remote, key)


# ---- opening and closing -----------------------------------------------------------------------------


@contextmanager
def controller_end(connection: Connection) -> Iterator[Any]:
    """Open the controller's end; yields the kernel's connection."""
    if isinstance(connection, Udp):
        with _datagrams(connection) as (plug, address):
            # Connected, so that the kernel drops datagrams from other senders before
            # they are read.
            plug.connect(address)
            yield _kernels.RealtimeIo.socket(plug.fileno(), False, _seal(connection))
    elif isinstance(connection, Serial):
        with _port(connection) as file:
            yield _kernels.RealtimeIo.serial(file, False)
    else:
        yield _callables(connection)


@contextmanager
def arm_end(
    connection: Connection, begin: Callable[[str], None] = lambda name: None
) -> Iterator[Any]:
    """Open the arm's end; one arm at a time, and only one that sends messages. `begin`
    receives the name of a pseudo-terminal.
    """
    if isinstance(connection, Udp):
        with _datagrams(connection) as (plug, address):
            try:
                plug.bind(address)
            except OSError as error:
                raise _error(
                    connection,
                    f"refused ({error.strerror or error})",
                    "a free port of this machine",
                    "choose another, or end the program that uses it",
                ) from error
            yield _kernels.RealtimeIo.socket(plug.fileno(), True, _seal(connection))
    elif isinstance(connection, Serial):
        with _terminal(begin) if connection.port == _PTY else _port(connection) as file:
            yield _kernels.RealtimeIo.serial(file, True)
    else:
        raise _error(
            connection,
            "no way to serve an arm",
            "serial:pty or udp:HOST:PORT",
            "a callback is the arm itself",
        )


def _seal(connection: Udp) -> Callable[[bytes], bytes] | None:
    """Return the function that computes the tag of a message; None without a key."""
    key = connection.key
    if key is None:
        return None
    # Truncated as RFC 2104, section 5, allows: 128 bits, half of the hash, leave a
    # forger a chance of 2^-128 per message.
    return lambda message: hmac.digest(key, message, "sha256")[:_SECRET_BYTES]


def silent(connection: Connection, patience: float) -> FieldError:
    """Return the error for an arm that sends no sample within `patience` seconds."""
    return _error(
        connection,
        f"silent: no sample in {patience:g} s",
        "an arm that answers",
        "start the arm first (`fraclink serve-arm`), or check the board",
    )


@contextmanager
def _datagrams(connection: Udp) -> Iterator[tuple[socket.socket, Any]]:
    try:
        addresses = socket.getaddrinfo(
            connection.host, connection.port, type=socket.SOCK_DGRAM
        )
    except OSError as error:
        raise _error(
            connection,
            f"not found ({error.strerror or error})",
            "a host that can be found",
            "give its address, or a name that this machine resolves",
        ) from error
    # The first address only: trying another one could send commands to two arms.
    family, kind, protocol, _, address = addresses[0]
    # The address instead of the name, which may resolve to anything.
    loopback = ipaddress.ip_address(str(address[0]).partition("%")[0]).is_loopback
    if not loopback and not connection.unsafe_remote:
        raise _error(
            connection,
            "not this machine: messages can be read and held up"
            if connection.key is not None
            else "not this machine: commands carry no password: any host that can send there moves the arm",
            "127.0.0.1, ::1 or localhost",
            "on a dedicated network give --unsafe-remote (unsafe_remote=True), and a key",
        )
    with socket.socket(family, kind, protocol) as plug:
        yield plug, address


@contextmanager
def _port(connection: Serial) -> Iterator[int]:
    """Open a serial port for raw bytes, locked for this process."""
    speeds = {
        int(name[1:]): getattr(termios, name)
        for name in dir(termios)
        if re.fullmatch(r"B[1-9][0-9]*", name)
    }
    if connection.baud not in speeds:
        raise _error(
            connection,
            "not a speed of this system",
            ", ".join(str(speed) for speed in sorted(speeds) if speed >= 115_200),
            "choose one",
        )
    # Without waiting for a modem carrier, and without becoming the controlling terminal
    # of this process.
    flags = os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC
    try:
        file = os.open(connection.port, flags)
    except OSError as error:
        raise _error(
            connection,
            f"refused ({error.strerror or error})",
            "a serial port of this machine, e.g. /dev/ttyACM0, that this user may open",
            "list them with `ls /dev/tty[AU]*`; join the group of the port (`ls -l`)",
        ) from error
    try:
        _claimed(connection, file, speeds[connection.baud])
        yield file
    finally:
        os.close(file)


def _claimed(connection: Serial, file: int, speed: int) -> None:
    """Lock a serial port, set it to raw bytes and empty it."""
    try:
        # Two controllers would each receive half of the samples.
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        _raw(file, speed)
        # Bytes waiting there are left from an earlier connection.
        termios.tcflush(file, termios.TCIOFLUSH)
    except BlockingIOError as error:
        raise _error(
            connection,
            "in use by another controller",
            "one controller",
            "end the other one",
        ) from error
    except termios.error as error:
        raise _error(
            connection,
            f"no serial port ({error.args[-1]})",
            "a serial port",
            "check its name",
        ) from error


def _raw(file: int, speed: int) -> None:
    tty.setraw(file)
    modes = termios.tcgetattr(file)
    # No modem lines, one stop bit, no handshake; a read returns at once.
    modes[2] &= ~(termios.CSTOPB | termios.CRTSCTS)
    modes[2] |= termios.CLOCAL | termios.CREAD
    modes[4] = modes[5] = speed
    modes[6][termios.VMIN] = modes[6][termios.VTIME] = 0
    termios.tcsetattr(file, termios.TCSANOW, modes)


@contextmanager
def _terminal(begin: Callable[[str], None]) -> Iterator[int]:
    """Open a pseudo-terminal and report its name."""
    # Its other end stays open here, so that a controller that leaves causes silence
    # instead of an error.
    here, there = pty.openpty()
    try:
        _raw(there, termios.B1000000)
        os.set_blocking(here, False)
        begin(f"arm at serial:{os.ttyname(there)}")
        yield here
    finally:
        os.close(here)
        os.close(there)


def _callables(connection: Callback) -> Any:
    for name in ("read", "write"):
        if not callable(value := getattr(connection, name)):
            raise FieldError(
                f"callback.{name}",
                value,
                "not a function",
                "a callable",
                "give a function",
            )
    return _kernels.RealtimeIo.callables(
        connection.read, lambda *values: connection.write(Command(*values))
    )
