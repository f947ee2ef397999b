"""Every error fraclink raises on purpose.

    FraclinkError
    ├── FieldError(ValueError)          a value is out of its range
    │   ├── LogError                    a recorded log cannot be used as it is
    │   ├── FileFormatError             a file is damaged, or of another kind
    │   ├── SizeError                   refused before memory is taken
    │   └── UnstableError               the quantity exists for stable systems only
    ├── InfeasibleError(ValueError)     a design cannot be met
    ├── NotCertifiedError(ValueError)   a proof failed
    ├── NotConvergedError(RuntimeError) an iteration stopped short
    └── MissingExtraError(ImportError)  an optional dependency is not installed

The command line turns ``FieldError`` and ``MissingExtraError`` into exit code 2 (bad
input) and ``InfeasibleError``, ``NotCertifiedError`` and ``NotConvergedError`` into
exit code 1 (failed). Warnings are ``FraclinkWarning`` with a stable code (``W101``
...). A public name that will go warns with ``DeprecationWarning``;
docs/reference/stability.md says when.
"""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable
from typing import ParamSpec, TypeVar

__all__ = [
    "FieldError",
    "FileFormatError",
    "FraclinkError",
    "FraclinkWarning",
    "InfeasibleError",
    "LogError",
    "MissingExtraError",
    "NotCertifiedError",
    "NotConvergedError",
    "SizeError",
    "UnstableError",
]

P = ParamSpec("P")
R = TypeVar("R")

# What a message repeats of something that came from outside: a cell of 10 MB must not
# flood a terminal.
_VALUE_LIMIT = 80
_SENTENCE_LIMIT = 400


def value_text(value: object) -> str:
    """Return repr(value), or its type where Python declines: a whole number of over
    4300 digits.
    """
    # An entry of an array reads nan and 0.5, not np.float64(nan): the reader wrote no
    # type. By the module's name, as errors load without NumPy.
    if type(value).__module__ == "numpy" and getattr(value, "ndim", 1) == 0:
        value = getattr(value, "item")()  # noqa: B009
    try:
        return repr(value)
    except ValueError:
        return f"a huge {type(value).__name__}"


def _shown(value: object, limit: int = _VALUE_LIMIT) -> str:
    """The value as a message prints it: one line, printable characters only, bounded."""
    # A text stands without quotes, as the user wrote it into a file or a terminal; all
    # else as Python spells it.
    text = value if isinstance(value, str) else value_text(value)
    # Cut before it is escaped: of 10 MB only the part that is shown is looked at. An
    # escape sequence from a file must not reach the terminal, nor a line end make two
    # messages of one.
    text = "".join(
        c if c.isprintable() else f"\\x{ord(c):02x}" for c in text[: limit + 1]
    )
    return text if len(text) <= limit else text[:limit] + "…"


def _sentence(text: str) -> str:
    """`text` as a sentence; a leading identifier such as ``read_log(...)`` keeps its
    spelling.
    """
    # Only a plain word gets a capital: read_log(…) and --force are spelled as they are
    # typed.
    if text and text.split(maxsplit=1)[0].rstrip(",;:").isalpha():
        text = text[0].upper() + text[1:]
    return text if text.endswith((".", "?", "!", "…")) else f"{text}."


class FraclinkError(Exception):
    """Base of every error that fraclink raises on purpose."""


class FieldError(FraclinkError, ValueError):
    """A value is outside its range.

    The message reads ``field: problem (got value); expected range. Remedy.``, and each
    part of it is an attribute, so that a program can act on it and a form can show it
    beside the field. The problem "missing" reads ``field is required; expected range.
    Remedy.``, as there is no value to show.

    >>> raise FieldError("payload", -0.03, "negative", allowed="> 0 kg", remedy="give the mass in kg")
    Traceback (most recent call last):
    fraclink.errors.FieldError: payload: negative (got -0.03); expected > 0 kg. Give the mass in kg.
    >>> raise FieldError("rig", None, "missing", allowed="a Rig", remedy="use Rig.named or Rig.load")
    Traceback (most recent call last):
    fraclink.errors.FieldError: rig is required; expected a Rig. Use Rig.named or Rig.load.
    """

    field: str
    value: object
    problem: str
    allowed: str
    remedy: str

    def __init__(
        self, field: str, value: object, problem: str, *, allowed: str, remedy: str
    ) -> None:
        self.field, self.value, self.problem = field, value, problem
        self.allowed, self.remedy = allowed, remedy
        # Parsers of binary files put raw bytes of the file into the problem; every part
        # is escaped.
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
        # Keyword-only arguments are lost by the default protocol, and errors cross
        # process borders (file readers run in a child that may be killed).
        return _rebuild, (
            type(self),
            self.field,
            self.value,
            self.problem,
            self.allowed,
            self.remedy,
        )


def _rebuild(
    kind: type[FieldError],
    field: str,
    value: object,
    problem: str,
    allowed: str,
    remedy: str,
) -> FieldError:
    return kind(field, value, problem, allowed=allowed, remedy=remedy)


class LogError(FieldError):
    """A recorded log cannot be used as it is."""


class FileFormatError(FieldError):
    """A file is damaged, hostile, of another kind, or of a version this release does
    not read.
    """


class SizeError(FieldError):
    """A request is refused because of its estimated size, before any memory is
    allocated.
    """


class UnstableError(FieldError):
    """The requested quantity exists only for stable systems."""


# Of the arguments that a request names; the others have none.
_UNITS = {"phase_margin": " rad", "gain_crossover": " rad/s"}


class InfeasibleError(FraclinkError, ValueError):
    """A design request cannot be met.

    ``condition`` names the bound that is hit, ``nearest`` holds the nearest feasible
    request as keyword arguments of the same call (empty where none was found).
    """

    condition: str
    explanation: str
    nearest: dict[str, float]

    def __init__(
        self, condition: str, explanation: str, nearest: dict[str, float] | None = None
    ) -> None:
        self.condition, self.explanation, self.nearest = (
            condition,
            explanation,
            dict(nearest or {}),
        )
        # As arguments of the same call, in its units: six digits can be typed, and the
        # bound that was hit is not known better.
        hint = ", ".join(
            f"{n} = {value:.6g}{_UNITS.get(n, '')}" for n, value in self.nearest.items()
        )
        super().__init__(
            f"{condition}: {explanation}"
            + (f"; nearest feasible: {hint}" if hint else "")
        )


class NotCertifiedError(FraclinkError, ValueError):
    """A proof failed; ``payload`` [kg] and ``frequency`` [rad/s] say where, if they are
    known.
    """

    reason: str
    payload: float | None
    frequency: float | None

    def __init__(
        self,
        reason: str,
        *,
        payload: float | None = None,
        frequency: float | None = None,
    ) -> None:
        self.reason, self.payload, self.frequency = reason, payload, frequency
        super().__init__(reason)


class NotConvergedError(FraclinkError, RuntimeError):
    """An iteration stopped before its tolerance; ``reached`` is the value it stopped
    at.
    """

    what: str
    reached: float
    wanted: float
    remedy: str

    def __init__(
        self, what: str, *, reached: float, wanted: float, remedy: str
    ) -> None:
        self.what, self.reached, self.wanted, self.remedy = (
            what,
            reached,
            wanted,
            remedy,
        )
        super().__init__(
            f"{what}: reached {reached:.3g}, wanted {wanted:.3g}; {remedy}"
        )


class MissingExtraError(FraclinkError, ImportError):
    """An optional dependency is not installed; the message says how to install it.

    `install` is the requirement for pip where the package is not one that the extra
    brings.
    """

    package: str
    extra: str

    def __init__(self, package: str, extra: str, *, install: str | None = None) -> None:
        self.package, self.extra = package, extra
        requirement = f"'fraclink[{extra}]'" if install is None else install
        super().__init__(
            f"{package} is not installed; it comes with `pip install {requirement}`"
        )


class FraclinkWarning(UserWarning):
    """A finding that does not stop the work; ``code`` (``W101`` ...) is stable across
    releases.
    """

    code: str
    message: str

    def __init__(self, code: str, message: str) -> None:
        self.code, self.message = code, message
        super().__init__(f"{code}: {message}")


def warn_deprecated(old: str, *, use: str, removed: str, depth: int = 1) -> None:
    """Warn that `old` is removed in release `removed`, and name what to use instead.

    The warning points at the line that uses the old name: `depth` callers above the
    caller of this function.

    >>> import warnings
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always")
    ...     warn_deprecated("Plan", use="Design", removed="0.3")
    >>> print(caught[0].message)
    Plan is deprecated and will be removed in fraclink 0.3: use Design
    """
    text = f"{old} is deprecated and will be removed in fraclink {removed}: use {use}"
    warnings.warn(text, DeprecationWarning, stacklevel=depth + 2)


def deprecated(
    *, use: str, removed: str, **renamed: str
) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Return a decorator that warns at each call, or, with `renamed`, where an old
    argument is given.

    `renamed` maps an old argument to its new name; its value is passed on under that.

    >>> @deprecated(use="phase_margin", removed="0.3", margin="phase_margin")
    ... def design(*, phase_margin: float) -> float:
    ...     return phase_margin
    >>> import warnings
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always")
    ...     print(design(margin=0.9), caught[0].message)
    0.9 design(margin=…) is deprecated and will be removed in fraclink 0.3: use phase_margin=
    """

    def mark(function: Callable[P, R]) -> Callable[P, R]:
        @functools.wraps(function)
        def call(*args: P.args, **kwargs: P.kwargs) -> R:
            if not renamed:
                warn_deprecated(function.__name__, use=use, removed=removed)
            for old, new in renamed.items():
                if old in kwargs:
                    # Given under both names, none can be preferred without ignoring the
                    # other: Python's own answer to that is TypeError.
                    if new in kwargs:
                        raise TypeError(
                            f"{function.__name__}() got both {old!r} and {new!r}, which replaces it"
                        )
                    warn_deprecated(
                        f"{function.__name__}({old}=…)", use=f"{new}=", removed=removed
                    )
                    kwargs[new] = kwargs.pop(old)
            return function(*args, **kwargs)

        return call

    return mark
