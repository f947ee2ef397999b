"""Every error fraclink raises on purpose.

    FraclinkError
    ├── FieldError(ValueError)          a value is out of its range
    │   ├── LogError                    a recorded log cannot be used as it is
    │   ├── FileFormatError             a file is damaged, or of another kind
    │   └── SizeError                   refused before memory is taken
    ├── InfeasibleError(ValueError)     a design cannot be met
    ├── NotCertifiedError(ValueError)   a proof failed
    ├── NotConvergedError(RuntimeError) an iteration stopped short
    └── MissingExtraError(ImportError)  an optional dependency is not installed

The command line turns ``FieldError`` and ``MissingExtraError`` into exit code 2 (bad
input) and ``InfeasibleError``, ``NotCertifiedError`` and ``NotConvergedError`` into
exit code 1 (failed). Warnings are ``FraclinkWarning`` with a stable code (``W101``
...).
"""

from __future__ import annotations

import math

from fracsys.errors import (
    FieldError,
    FracsysError,
    MissingExtraError,
    NotConvergedError,
    SizeError,
)
from fracsys.errors import (
    required as required,
)

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
]

# A single base for both packages: it catches everything that either raises on purpose.
FraclinkError = FracsysError


class LogError(FieldError):
    """A recorded log cannot be used as it is."""


class FileFormatError(FieldError):
    """A file is damaged, hostile, of another kind, or of a version this release does
    not read.
    """


class InfeasibleError(FraclinkError, ValueError):
    """A design request cannot be met.

    ``condition`` names the bound that is hit, ``nearest`` holds the nearest feasible
    request as keyword arguments of the same call (empty where none was found).
    """

    def __init__(
        self, condition: str, explanation: str, nearest: dict[str, float] | None = None
    ) -> None:
        self.condition, self.explanation = condition, explanation
        self.nearest = dict(nearest or {})
        hint = ", ".join(_argument(*item) for item in self.nearest.items())
        super().__init__(
            f"{condition}: {explanation}"
            + (f"; nearest feasible: {hint}" if hint else "")
        )


def _argument(name: str, value: float) -> str:
    """The value as typed into the same call: an angle in degrees, six digits."""
    if name == "phase_margin":
        return f"{name}=fl.deg({math.degrees(value):.6g})"
    return f"{name}={value:.6g}"


class NotCertifiedError(FraclinkError, ValueError):
    """A proof failed; ``payload`` [kg] and ``frequency`` [rad/s] say where, if they are
    known.
    """

    def __init__(
        self,
        reason: str,
        *,
        payload: float | None = None,
        frequency: float | None = None,
    ) -> None:
        self.reason, self.payload, self.frequency = reason, payload, frequency
        super().__init__(reason)


class FraclinkWarning(UserWarning):
    """A finding that does not stop the work; ``code`` (``W101`` ...) is stable across
    releases.
    """

    def __init__(self, code: str, message: str) -> None:
        self.code, self.message = code, message
        super().__init__(f"{code}: {message}")
