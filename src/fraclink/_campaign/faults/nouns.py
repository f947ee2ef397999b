"""The nouns of a fault campaign: a fault of the catalogue, one run of it, and what the run showed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from fraclink._validate import checked_between, checked_choice, checked_noun, checked_whole

if TYPE_CHECKING:
    from fraclink._arm.reference import Reference
    from fraclink._campaign.faults.evidence import Evidence
    from fraclink._campaign.faults.trial import Trial

__all__ = ["PHASES", "Case", "Check", "Fault", "Outcome"]

PHASES = ("whole", "start", "mid", "rest")


@dataclass(frozen=True)
class Check:
    """One requirement on one run: what was measured, the limit it must not exceed, and whether it holds.

    >>> Check.at_most("peak [rad]", 0.5, 0.4).passed
    False
    """

    name: str
    measured: float
    limit: float
    passed: bool

    @staticmethod
    def at_most(name: str, measured: float, limit: float) -> Check:
        """A check that holds where ``measured <= limit``; NaN never does."""
        return Check(name, float(measured), float(limit), bool(measured <= limit))

    def __str__(self) -> str:
        return f"{self.name}: {self.measured:.5g} (limit {self.limit:.5g})"


@dataclass(frozen=True)
class Case:
    """One run of a fault: severity 1 … 3, payload [kg], phase of the move, seed of noise and chance.

    >>> Case("F07", 2, 0.02, "mid", 3).name
    'F07-2-20g-mid-3'
    """

    fault: str
    severity: int
    payload: float
    phase: str
    seed: int

    def __post_init__(self) -> None:
        checked_noun("fault", self.fault, str, remedy="the number of a fault, such as F07")
        checked_whole("severity", self.severity, 1, 3)
        mass = checked_between("payload", self.payload, 0.0, 1e3, "kg", open_low=True)
        object.__setattr__(self, "payload", mass)
        checked_choice("phase", self.phase, PHASES)
        checked_whole("seed", self.seed, 0, 2**63 - 1)

    @property
    def name(self) -> str:
        """A name for files."""
        return f"{self.fault}-{self.severity}-{1e3 * self.payload:g}g-{self.phase}-{self.seed}"


@dataclass(frozen=True)
class Fault:
    """A row of the catalogue.

    number, title: "F07", "encoder stuck in a move". injection and required: what is done and what the law
    must do, in words. severities: what the three are. reaction: A ride through, B degrade, C hold,
    D off, "-" for another requirement. phases: those it is run in. inject: does it to a trial. checks:
    measure the requirement. duration of the run [s]. reference, where not the campaign's move. prepare:
    done to the faulty and the clean run alike. nominal: compared with a clean run at the nominal payload.
    note: what the campaign cannot show. skips: severity and phase that make no sense together.
    """

    number: str
    title: str
    injection: str
    required: str
    severities: tuple[str, str, str]
    reaction: str
    inject: Callable[[Trial], None]
    checks: tuple[Callable[[Evidence], Check], ...]
    phases: tuple[str, ...] = ("start", "mid", "rest")
    duration: float = 7.0
    reference: Reference | None = None
    prepare: Callable[[Trial], None] | None = None
    nominal: bool = False
    note: str = ""
    skips: frozenset[tuple[int, str]] = frozenset()


@dataclass(frozen=True)
class Outcome:
    """What one run showed: every check, peak and final tip error [rad], and where the law ended.

    final: |mean tip error| of the last second, so that the gauge's noise averages out. reacted: periods from
    the fault to the first other mode, -1 where the law kept running. detail: what chance chose, such as the
    number of the state in which a bit was flipped.
    """

    case: Case
    checks: tuple[Check, ...]
    peak: float
    clean_peak: float
    final: float
    mode: str
    reason: str
    reacted: int
    detail: str = ""

    @property
    def passed(self) -> bool:
        """Whether every check holds."""
        return all(check.passed for check in self.checks)

    @property
    def name(self) -> str:
        """The case's name, with what chance chose."""
        return f"{self.case.name}: {self.detail}" if self.detail else self.case.name

    @property
    def failed(self) -> tuple[Check, ...]:
        """The checks that do not hold."""
        return tuple(check for check in self.checks if not check.passed)
