"""Findings: what the checks noticed, each with its evidence and its remedy. Verdicts:
what was shown of a design, in four scopes.

Rigs, logs and fits carry findings instead of printing warnings, so that a report can
show them and a program can act on their codes.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from fraclink._display import (
    Finding,
    Listed,
    Overview,
    Row,
    Severity,
    Table,
    displayed,
    rows_of,
)

__all__ = [
    "Finding",
    "Findings",
    "Judged",
    "Scope",
    "Severity",
    "State",
    "Verdict",
    "errors_of",
    "worst_first",
]


class Findings(Listed[Finding]):
    """Findings as a tuple; a prompt shows how many there are, a notebook each of them.

    >>> Findings([Finding("W305", "info", "the residual is not white")])
    Findings(✓ passed: 1 info)
    """

    def overview(self) -> Overview:
        """The number of findings of each severity, and their messages."""
        severities = [finding.severity for finding in self]
        # A warning is not a failure, but a result with one is not yet shown to be
        # right.
        state = "not shown" if "warning" in severities else "passed"
        counts = [
            f"{severities.count(word)} {word}{'s' if severities.count(word) > 1 and word != 'info' else ''}"
            for word in ("error", "warning", "info")
            if word in severities
        ]
        return Overview(
            ", ".join(counts) or "no findings",
            "failed" if "error" in severities else state,
            findings=tuple(self),
        )


def errors_of(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return the findings of severity "error": the gates that failed.

    >>> errors_of([Finding("W305", "info", "the residual is not white")])
    ()
    """
    return tuple(finding for finding in findings if finding.severity == "error")


class Judged:
    """A result with findings: those of severity "error" are gates that failed."""

    findings: Sequence[Finding]

    @property
    def passed(self) -> bool:
        """Whether no gate failed: no finding of severity "error"."""
        return not errors_of(self.findings)


def worst_first(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return the findings, errors first, then warnings, then the others, each in their
    order.
    """
    # sorted() is stable: within a severity, findings stay in the order in which a
    # person would check them.
    order = {"error": 0, "warning": 1, "info": 2}
    return tuple(sorted(findings, key=lambda finding: order[finding.severity]))


State = Literal["passed", "failed", "not shown", "not run"]
# A refuted part is worse than one that could not be shown, which is worse than one that
# was not requested: a verdict is never better than its worst part.
_WORST_FIRST: tuple[State, ...] = ("failed", "not shown", "not run", "passed")


@dataclass(frozen=True)
class Scope:
    """One part of a verdict: its state, and the reasons for anything but "passed"."""

    state: State
    reasons: tuple[str, ...] = ()


_SCOPES = {
    "promise": "requirements and proof",
    "model": "simulated moves of the model",
    "twin": "distributed mass; varied arms, faults if run",
    "arm": "records of the real arm",
}


@displayed
@dataclass(frozen=True)
class Verdict:
    """What was shown, in four scopes; the whole is never better than its worst part.

    promise: the requirements of the design, and their proof where one was asked for.
    model: simulated moves of the identified model. twin: the arm with distributed mass
    under the law as it ships, varied arms, and faults if they were
    injected. arm: records of the real arm; "not run" until there is one, which does not
    worsen the whole. remarks do not change the verdict.

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
        return {name: getattr(self, name) for name in _SCOPES}

    @property
    def sentence(self) -> str:
        """The states in one line.

        >>> Verdict(Scope("passed"), Scope("passed"), Scope("not run")).sentence
        'promise passed, model passed, twin not run, arm not run'
        """
        return ", ".join(f"{name} {scope.state}" for name, scope in self.scopes.items())

    def overview(self) -> Overview:
        """The four scopes, each with its reasons."""
        scopes = self.scopes.items()
        lines = (
            (
                Row("", "scope", name),
                Row("", "what", _SCOPES[name]),
                Row("", "why", "; ".join(scope.reasons) or "–"),
                Row("", "verdict", scope.state),
            )
            for name, scope in scopes
        )
        rows = rows_of(
            self,
            *(Row(name, "", scope) for name, scope in scopes),
            "remarks",
            "reasons",
        )
        return Overview(
            self.sentence,
            self.state,
            rows,
            (Table.of("", lines),),
            notes=self.remarks,
        )

    @property
    def state(self) -> State:
        """The worst state of the scopes. A missing record of the arm does not count, and
        a record of the arm replaces a twin that was not run.
        """
        scopes = [self.promise, self.model]
        scopes += [
            scope for scope in (self.twin, self.arm) if scope.state != "not run"
        ] or [self.twin]
        states = {scope.state for scope in scopes}
        return next(state for state in _WORST_FIRST if state in states)

    @property
    def passed(self) -> bool:
        """Whether every scope passed; one of twin and arm need not have been run."""
        return self.state == "passed"

    @property
    def reasons(self) -> tuple[str, ...]:
        """The reasons of all scopes, each once."""
        # A dict keeps the order, unlike a set.
        return tuple(
            dict.fromkeys(
                reason for scope in self.scopes.values() for reason in scope.reasons
            )
        )
