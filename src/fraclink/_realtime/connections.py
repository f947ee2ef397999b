"""Ways to reach an arm: UDP, shared memory, a library of the user's, two functions of Python."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from fraclink._files import checked_path
from fraclink._validate import checked_noun, checked_whole
from fraclink.errors import FieldError

__all__ = [
    "Callback",
    "Command",
    "Connection",
    "Library",
    "SharedMemory",
    "Udp",
    "check_connection",
    "parse_connection",
]

_NAME = re.compile(r"[A-Za-z0-9_-]{1,64}")
_FORMS = "udp:HOST:PORT, shm:NAME or library:FILE.so"


class Command(NamedTuple):
    """What the law gives in one period: motor_reference θm* [rad], voltage [V], the number of the period,
    and the law's mode, reason and flags (see law.h).

    In modes 0 and 4 the drive must be off, and the motor reference means nothing: 0 before the law has
    started, 4 for the safe stop, which is the last command of every run.
    """

    motor_reference: float
    voltage: float
    tick: int
    mode: int
    reason: int
    flags: int


@dataclass(frozen=True)
class Udp:
    """An arm that is reached by datagrams: `host`, a name or an address, and `port`, 1 to 65535.

    >>> str(Udp("127.0.0.1", 5005))
    'udp:127.0.0.1:5005'
    """

    host: str
    port: int

    def __post_init__(self) -> None:
        if not isinstance(self.host, str) or not self.host:
            raise FieldError("io", "udp:", "without a host", allowed=_FORMS, remedy="udp:127.0.0.1:5005")
        checked_whole("port", self.port, 1, 65535)

    def __str__(self) -> str:
        return f"udp:{self.host}:{self.port}"


@dataclass(frozen=True)
class SharedMemory:
    """An arm on the same machine, reached by POSIX shared memory of a `name` of letters, digits, _ and -.

    >>> str(SharedMemory("arm"))
    'shm:arm'
    """

    name: str

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not _NAME.fullmatch(self.name):
            raise FieldError(
                "io",
                f"shm:{self.name}",
                "not a name",
                allowed="1 to 64 letters, digits, _ and -",
                remedy="shm:arm",
            )

    def __str__(self) -> str:
        return f"shm:{self.name}"


@dataclass(frozen=True)
class Library:
    """A board behind a shared library with the functions of `arm_io.h`; `fraclink export io` makes a start.

    >>> str(Library(Path("my_board.so")))
    'library:my_board.so'
    """

    path: Path

    def __post_init__(self) -> None:
        object.__setattr__(self, "path", checked_path("path", self.path))

    def __str__(self) -> str:
        return f"library:{self.path}"


@dataclass(frozen=True, eq=False)
class Callback:
    """A board behind two functions of Python, each called once in a period.

    `read` returns (motor angle [rad], torque [N·m]), or None where the sample was lost; `write` applies a
    `Command`. An exception in either stops the run safely and is raised again. Convenient, but the loop then
    waits for the interpreter: other threads of Python may hold it for milliseconds.
    """

    read: Callable[[], tuple[float, float] | None]
    write: Callable[[Command], object]

    def __str__(self) -> str:
        return "callback"


Connection = Udp | SharedMemory | Library | Callback


def check_connection(value: object) -> None:
    """FieldError for anything that is no way to an arm, the words of the command line among it."""
    if not isinstance(value, Connection):
        allowed, remedy = "Udp, SharedMemory, Library or Callback", "parse_connection reads udp:HOST:PORT"
        raise FieldError("connection", repr(value), "no way to an arm", allowed=allowed, remedy=remedy)


def parse_connection(text: str) -> Udp | SharedMemory | Library:
    """Return what the words of the command line name: udp:HOST:PORT, shm:NAME or library:FILE.so.

    >>> parse_connection("udp:localhost:5005")
    Udp(host='localhost', port=5005)
    >>> parse_connection("tcp:localhost:5005")
    Traceback (most recent call last):
    fraclink.errors.FieldError: io: no way to an arm (got tcp:localhost:5005); expected udp:HOST:PORT,
    shm:NAME or library:FILE.so. Start with udp:, shm: or library:.
    """
    checked_noun("io", text, str, remedy="udp:127.0.0.1:5005")
    kind, _, rest = text.partition(":")
    if kind == "shm":
        return SharedMemory(rest)
    if kind == "library" and rest:
        return Library(Path(rest))
    if kind != "udp":
        raise FieldError(
            "io",
            text,
            "no way to an arm",
            allowed=_FORMS,
            remedy="start with udp:, shm: or library:",
        )
    host, _, port = rest.rpartition(":")
    if not re.fullmatch(r"[0-9]{1,5}", port):
        raise FieldError("io", text, "without a port", allowed="1 to 65535", remedy="udp:127.0.0.1:5005")
    return Udp(host.removeprefix("[").removesuffix("]"), int(port))
