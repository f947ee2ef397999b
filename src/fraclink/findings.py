"""A finding: something a check noticed, with its evidence and what to do about it.

Rigs, logs and fits carry findings instead of printing warnings, so that a report can show them
and a program can act on their codes.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal

__all__ = ["Finding", "Severity", "errors_of"]

Severity = Literal["info", "warning", "error"]


@dataclass(frozen=True)
class Finding:
    """One observation of a check; `code` is stable across releases.

    Parameters
    ----------
    code
        ``W101`` and so on: rig W1xx, log W2xx.
    severity
        ``info`` (good to know), ``warning`` (results may mislead) or ``error`` (unusable).
    message
        One sentence for a person.
    evidence
        The numbers behind it, name to value, in SI units and radians.
    remedy
        What to do.

    Examples
    --------
    >>> print(Finding("W101", "warning", "c contradicts 3EI/L", {"c": 1.56, "3EI/L": 1.2}, "measure c"))
    W101 warning: c contradicts 3EI/L (c 1.56, 3EI/L 1.2); measure c
    """

    code: str
    severity: Severity
    message: str
    evidence: Mapping[str, float] = field(default_factory=dict)
    remedy: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "evidence", MappingProxyType(dict(self.evidence)))

    def __str__(self) -> str:
        numbers = ", ".join(f"{name.replace('_', ' ')} {value:.6g}" for name, value in self.evidence.items())
        text = f"{self.code} {self.severity}: {self.message}" + (f" ({numbers})" if numbers else "")
        return text + (f"; {self.remedy}" if self.remedy else "")

    def __hash__(self) -> int:
        return hash((self.code, self.severity, self.message, tuple(self.evidence.items()), self.remedy))

    def __reduce__(self) -> tuple[object, ...]:
        # A mapping proxy cannot cross a process border; its dict can.
        return type(self), (self.code, self.severity, self.message, dict(self.evidence), self.remedy)


def errors_of(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return the findings of severity "error": the gates that failed.

    >>> errors_of([Finding("W305", "info", "the residual is not white")])
    ()
    """
    return tuple(finding for finding in findings if finding.severity == "error")
