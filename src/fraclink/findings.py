"""A finding: something a check noticed, with its evidence and what to do; a verdict:
what all was shown.

Rigs, logs and fits carry findings instead of printing warnings, so that a report can
show them and a program can act on their codes.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal

__all__ = [
    "Finding",
    "Scope",
    "Severity",
    "State",
    "Verdict",
    "errors_of",
    "worst_first",
]

Severity = Literal["info", "warning", "error"]


@dataclass(frozen=True)
class Finding:
    """One observation of a check; `code` is stable across releases.

    Parameters
    ----------
    code
        ``W101`` and so on: rig W1xx, log W2xx.
    severity
        ``info`` (good to know), ``warning`` (results may mislead) or ``error``
        (unusable).
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
        # A copy behind a proxy: a finding travels with its experiment and is hashed, so
        # that nobody may change its numbers, not even by the dict it was made from.
        object.__setattr__(self, "evidence", MappingProxyType(dict(self.evidence)))

    def __str__(self) -> str:
        numbers = ", ".join(
            f"{name.replace('_', ' ')} {value:.6g}"
            for name, value in self.evidence.items()
        )
        text = f"{self.code} {self.severity}: {self.message}" + (
            f" ({numbers})" if numbers else ""
        )
        return text + (f"; {self.remedy}" if self.remedy else "")

    def __hash__(self) -> int:
        return hash(
            (
                self.code,
                self.severity,
                self.message,
                tuple(self.evidence.items()),
                self.remedy,
            )
        )

    def __reduce__(self) -> tuple[object, ...]:
        # A mapping proxy cannot cross a process border; its dict can.
        return type(self), (
            self.code,
            self.severity,
            self.message,
            dict(self.evidence),
            self.remedy,
        )


def errors_of(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return the findings of severity "error": the gates that failed.

    >>> errors_of([Finding("W305", "info", "the residual is not white")])
    ()
    """
    return tuple(finding for finding in findings if finding.severity == "error")


def worst_first(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return the findings with errors before warnings, and these before the others,
    else in their order.
    """
    # sorted() is stable: within a severity findings stay in the order in which a person
    # would ask.
    order = {"error": 0, "warning": 1, "info": 2}
    return tuple(sorted(findings, key=lambda finding: order[finding.severity]))


State = Literal["passed", "failed", "not shown", "not run"]
# What was refuted is worse than what could not be shown, and this worse than what
# nobody asked for: a verdict of parts is none better than any of them.
_WORST_FIRST: tuple[State, ...] = ("failed", "not shown", "not run", "passed")


@dataclass(frozen=True)
class Scope:
    """One part of a verdict: its state, and the reasons for anything but "passed"."""

    state: State
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True)
class Verdict:
    """What was shown, in four scopes; the whole is never better than its worst part.

    promise: the requirements of the design, and their proof where one was asked for.
    model: simulated moves of the identified model. twin: the arm with distributed mass
    under the law as it ships, arms that differ from the model, and faults if they were
    injected. arm: records of what the real one did; "not run" until there is one, which
    leaves the rest as it is. remarks stand beside the verdict and do not change it.

    >>> Verdict(Scope("passed"), Scope("passed"), Scope("not run")).state
    'not run'
    """

    promise: Scope
    model: Scope
    twin: Scope
    arm: Scope = Scope("not run")
    remarks: tuple[str, ...] = ()

    @property
    def scopes(self) -> Mapping[str, Scope]:
        """The four scopes by name."""
        names = ("promise", "model", "twin", "arm")
        return {name: getattr(self, name) for name in names}

    @property
    def state(self) -> State:
        """The worst state of the scopes; no record of the arm itself is none of them, and
        a record of the arm stands in for the twin where that was not run.
        """
        judged = [self.promise, self.model]
        judged += [
            scope for scope in (self.twin, self.arm) if scope.state != "not run"
        ] or [self.twin]
        states = {scope.state for scope in judged}
        return next(state for state in _WORST_FIRST if state in states)

    @property
    def passed(self) -> bool:
        """Whether every scope passed that was run, and nothing was left out."""
        return self.state == "passed"

    @property
    def reasons(self) -> tuple[str, ...]:
        """The reasons of all scopes, each once."""
        # dict keeps the order, which a set would not.
        return tuple(
            dict.fromkeys(
                reason for scope in self.scopes.values() for reason in scope.reasons
            )
        )
