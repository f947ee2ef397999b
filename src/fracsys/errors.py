"""Every error that fracsys raises on purpose; fraclink adds its own to them.

FracsysError
├── FieldError(ValueError)          a value is out of its range
│   └── SizeError                   refused before memory is taken
├── NotConvergedError(RuntimeError) an iteration stopped short
└── MissingExtraError(ImportError)  an optional dependency is not installed
"""

from __future__ import annotations

from typing import TypeVar

__all__ = [
    "FieldError",
    "FracsysError",
    "MissingExtraError",
    "NotConvergedError",
    "SizeError",
    "required",
]

Value = TypeVar("Value")

# Limits of external text in a message [characters]: a cell of 10 MB must not flood a
# terminal.
_VALUE_LIMIT = 80
_SENTENCE_LIMIT = 400


def value_text(value: object) -> str:
    """Return repr(value), or its type if Python refuses, as for an integer of over 4300
    digits.
    """
    # An entry of an array is shown as nan or 0.5, not as np.float64(nan). The test uses
    # the name of the module, since this file does not import NumPy.
    if type(value).__module__ == "numpy" and getattr(value, "ndim", 1) == 0:
        value = getattr(value, "item")()  # noqa: B009
    try:
        return repr(value)
    except ValueError:
        return f"a huge {type(value).__name__}"


def printable(text: str) -> str:
    """Return `text` with all control characters escaped.

    That is C0, C1 and bidirectional marks: a file name that reverses the writing
    direction can display a false extension.

    >>> printable("a\\x1b[31mb\\u202ec")
    'a\\\\x1b[31mb\\\\u202ec'
    """
    return "".join(
        c if c.isprintable() else c.encode("unicode_escape").decode() for c in text
    )


def _shown(value: object, limit: int = _VALUE_LIMIT) -> str:
    """The value as shown in a message: one line of bounded length, printable characters
    only.
    """
    # Text is shown without quotes, as the user wrote it; everything else as Python
    # writes it.
    text = value if isinstance(value, str) else value_text(value)
    # Cut before escaping, so that only the shown part of 10 MB is processed. An escape
    # sequence from a file must not reach the terminal, and a line break must not split
    # a message.
    text = printable(text[: limit + 1])
    return text if len(text) <= limit else text[:limit] + "…"


def _sentence(text: str) -> str:
    """`text` as a sentence; only a leading plain word is capitalised, not
    ``read_log(...)`` or ``--force``.
    """
    if text and text.split(maxsplit=1)[0].rstrip(",;:").isalpha():
        text = text[0].upper() + text[1:]
    return text if text.endswith((".", "?", "!", "…")) else f"{text}."


class FracsysError(Exception):
    """Base of every error that fracsys or fraclink raises on purpose."""


class FieldError(FracsysError, ValueError):
    """A value is outside its range.

    The message reads ``field: problem (got value); expected range. Remedy.``, and each
    part of it is an attribute, so that a program can act on it and a form can show it
    beside the field. The problem "missing" reads ``field is required; expected range.
    Remedy.``, as there is no value to show.

    >>> raise FieldError("payload", -0.03, "negative", "> 0 kg", "give the mass in kg")
    Traceback (most recent call last):
    fracsys.errors.FieldError: payload: negative (got -0.03); expected > 0 kg. Give the mass in kg.
    >>> raise FieldError("rig", None, "missing", "a Rig", "use Rig.named or Rig.load")
    Traceback (most recent call last):
    fracsys.errors.FieldError: rig is required; expected a Rig. Use Rig.named or Rig.load.
    """

    def __init__(
        self, field: str, value: object, problem: str, allowed: str, remedy: str
    ) -> None:
        self.field, self.value, self.problem = field, value, problem
        self.allowed, self.remedy = allowed, remedy
        # Parsers of binary files put raw bytes into the problem; every part is escaped.
        name, expected = _shown(field), _shown(allowed, _SENTENCE_LIMIT)
        what = _shown(problem, _SENTENCE_LIMIT)
        head = (
            f"{name} is required"
            if problem == "missing"
            else f"{name}: {what} (got {_shown(value)})"
        )
        advice = f" {_sentence(_shown(remedy, _SENTENCE_LIMIT))}" if remedy else ""
        super().__init__(f"{head}; expected {expected.rstrip('.')}.{advice}")

    def __reduce__(self) -> tuple[object, ...]:
        # Pickled by its parts and not by its message, since errors cross process
        # boundaries (file readers run in a child process that may be killed).
        parts = (self.field, self.value, self.problem, self.allowed, self.remedy)
        return type(self), parts


def required(field: str, value: Value | None, allowed: str, remedy: str) -> Value:
    """Return a value that has to be given; FieldError where it is None."""
    if value is None:
        raise FieldError(field, None, "missing", allowed, remedy)
    return value


class SizeError(FieldError):
    """A request is refused because of its estimated size, before any memory is
    allocated.
    """


class NotConvergedError(FracsysError, RuntimeError):
    """An iteration stopped before it met its tolerance; ``reached`` is the value it
    stopped at.
    """

    def __init__(
        self, what: str, *, reached: float, wanted: float, remedy: str
    ) -> None:
        self.what, self.remedy = what, remedy
        self.reached, self.wanted = reached, wanted
        super().__init__(
            f"{what}: reached {reached:.3g}, wanted {wanted:.3g}; {remedy}"
        )


class MissingExtraError(FracsysError, ImportError):
    """An optional dependency is not installed; the message says how to install it.

    `install` is the requirement for pip, if the extra does not contain the package.
    """

    def __init__(self, package: str, extra: str, *, install: str | None = None) -> None:
        self.package, self.extra = package, extra
        requirement = f"'fraclink[{extra}]'" if install is None else install
        super().__init__(
            f"{package} is not installed; it comes with `pip install {requirement}`"
        )
