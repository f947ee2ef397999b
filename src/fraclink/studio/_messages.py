"""Messages on the socket: requests as small JSON objects, answers as a JSON header
followed by curves.

A request for a design has the options of `fraclink design`, under their names and with
their ranges.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, get_type_hints

import numpy as np
from numpy.typing import ArrayLike

from fraclink._design import Specification
from fraclink.errors import FieldError, FraclinkError, InfeasibleError
from fraclink.studio._protocol import LONGEST
from fraclink.view._text import plain
from fracsys.checks import PhaseMarginDeg, Real, rule

__all__ = [
    "NAMES",
    "Message",
    "Reply",
    "checked_request",
    "held",
    "parsed",
    "refusal",
    "wanted_of",
]


@dataclass(frozen=True)
class Message:
    """One request: its number, its verb, and the rest of its object."""

    seq: int
    verb: str
    given: Mapping[str, Any]


@dataclass(frozen=True)
class Reply:
    """An object, which says whether the request was met (`ok`), and curves: name to
    array of shape (N,) or (rows, N), sent as float32.
    """

    head: Mapping[str, Any] = field(default_factory=dict)
    curves: Mapping[str, ArrayLike] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "head", {"ok": True, **self.head})

    def packed(self, seq: int, verb: str) -> bytes:
        """The length of the head in four bytes, little-endian; the head, padded to a
        multiple of four; the curves.

        Non-finite numbers become null in the header; in a curve they are a defect.
        """
        arrays = {
            name: np.atleast_2d(np.asarray(curve, "<f4"))
            for name, curve in self.curves.items()
        }
        for name, array in arrays.items():
            # The page draws its data without a check: a NaN would end a line for no
            # visible reason.
            if not np.isfinite(array).all():
                raise AssertionError(f"curve {name} is not finite")
        shapes = {name: list(array.shape) for name, array in arrays.items()}
        head = plain({**self.head, "seq": seq, "verb": verb, "curves": shapes})
        text = json.dumps(head, allow_nan=False, separators=(",", ":")).encode()
        # A Float32Array in the page must begin at a multiple of four bytes; JSON allows
        # the added spaces.
        text += b" " * (-len(text) % 4)
        return (
            struct.pack("<I", len(text))
            + text
            + b"".join(array.tobytes() for array in arrays.values())
        )


def held(values: Real, most: float = 1e30) -> Real:
    """Return a signal with each value that a picture cannot show, NaN or beyond `most`,
    replaced by the one before it.

    Loggers write values such as 1e38 for missing ones; as float32 these are nearly
    infinite.

    >>> held(np.array([np.nan, 1.0, np.inf, 2.0])).tolist()
    [0.0, 1.0, 1.0, 2.0]
    """
    good = np.isfinite(values) & (np.abs(values) < most)
    last = np.maximum.accumulate(np.where(good, np.arange(values.size), 0))
    return np.where(good, values, 0.0)[last]


def _no_constant(name: str) -> float:
    raise ValueError(f"{name} is no JSON")


def parsed(text: object) -> Message:
    """Return the request in `text`; FieldError if it is not a valid one."""
    if not isinstance(text, str) or len(text) > LONGEST:
        raise _refused(
            "bytes" if not isinstance(text, str) else f"{len(text)} characters"
        )
    try:
        fields = json.loads(text, parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        raise _refused(text) from error
    if not isinstance(fields, dict):
        raise _refused(type(fields).__name__)
    seq, verb = fields.pop("seq", None), fields.pop("verb", None)
    # 2^53: the largest safe integer of JavaScript. `type`, because bool is a subclass
    # of int.
    valid = type(seq) is int and 0 <= seq < 2**53
    if not valid or not isinstance(verb, str):
        raise _refused(f"seq {seq}, verb {verb}")
    return Message(seq, verb, fields)


def _refused(value: object) -> FieldError:
    return FieldError(
        "message",
        value,
        "not a request",
        f'{{"seq": 0, "verb": "preview", …}}, at most {LONGEST} characters',
        "send one JSON object",
    )


def refusal(error: FraclinkError) -> Reply:
    """Return an error as an answer: its sentence, and the parts that a page can show
    next to a field.
    """
    head: dict[str, Any] = {"ok": False, "error": str(error)}
    if isinstance(error, FieldError):
        parts = {
            "field": error.field,
            "problem": error.problem,
            "allowed": error.allowed,
        }
        head |= parts | {"remedy": error.remedy}
    if isinstance(error, InfeasibleError):
        nearest = dict(error.nearest)
        if "phase_margin" in nearest:
            margin = math.degrees(nearest.pop("phase_margin"))
            nearest["phase_margin_deg"] = round(margin, 9)
        head |= {
            "condition": error.condition,
            "explanation": error.explanation,
            "nearest": nearest,
        }
    return Reply(head)


# --- what a page asks of a design -----------------------------------------------------------------------

_PYTHON_ONLY = (
    "phase_margin",
    "natural_frequencies",
    "motor_loop",
    "placement",
    "settling_time",
)
# Every option has the range stated in the library; the command line takes the margin in
# degrees.
_HINTS: dict[str, Any] = {
    name: hint
    for name, hint in get_type_hints(Specification, include_extras=True).items()
    if name not in _PYTHON_ONLY
} | {"phase_margin_deg": Annotated[PhaseMarginDeg | None, ""], "box": bool | None}
NAMES = tuple(_HINTS)


def checked_request(given: object) -> dict[str, Any]:
    """Return the request of a page with every option present; None leaves one to the
    rig or to its rule.

    Raises FieldError for an option unknown to `fraclink design`, and for a value out of
    its range.

    >>> checked_request({"gain_crossover": 12, "payloads": [0.02, 0.04]})["payloads"]
    (0.02, 0.04)
    """
    if not isinstance(given, Mapping):
        raise FieldError(
            "state",
            type(given).__name__,
            "not an object",
            "an object of options",
            "send the options by name",
        )
    for name in given:
        if name not in _HINTS:
            raise FieldError(
                "state",
                str(name),
                "unknown option",
                ", ".join(NAMES),
                "leave it out",
            )
    values = {}
    for name, hint in _HINTS.items():
        value = given.get(name)
        values[name] = None if value is None else rule(hint).check(name, value)
    return values


def wanted_of(request: Mapping[str, Any]) -> dict[str, Any]:
    """Return the request as `design_for` takes it, the margin in radians."""
    margin = request["phase_margin_deg"]
    rest = {
        name: value for name, value in request.items() if name != "phase_margin_deg"
    }
    return rest | {"phase_margin": None if margin is None else math.radians(margin)}
