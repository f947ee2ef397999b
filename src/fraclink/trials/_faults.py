"""Forty-four ways to break an arm, injected into the shipped law on the twin, each with
a verdict.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from fraclink._files import document
from fraclink._law import MODES, REASONS, Law
from fraclink.errors import FieldError
from fraclink.trials._fault_checks import (
    OTHER_MODE,
    SAFE,
    Check,
    Evidence,
    shared_checks,
)
from fraclink.trials._fault_rules import CATALOGUE, Fault, fault_named
from fraclink.trials._fault_trial import (
    MOVE,
    PHASES,
    RUN,
    Bench,
    Case,
    Phase,
    Trial,
    TrialSignals,
    execute,
)
from fracsys.checks import Between, Payload, checked

__all__ = [
    "CATALOGUE",
    "PHASES",
    "Bench",
    "Case",
    "Check",
    "Evidence",
    "Fault",
    "FaultTable",
    "Outcome",
    "Row",
    "TrialSignals",
    "cases",
    "fault_named",
    "observe",
    "run_case",
    "run_faults",
]

CleanRuns = dict[tuple[object, ...], TrialSignals]
GROUPS = (
    "met",
    "slower than promised",
    "trips without need",
    "unsafe",
)  # in the order of severity


# ---- the table of verdicts ---------------------------------------------------------------------------


@dataclass(frozen=True)
class Outcome:
    """What one run showed: every check, peak and final tip error [rad], and where the
    law ended.

    final: |mean tip error| of the last second, so that the gauge's noise averages out.
    reacted: periods from the fault to the first other mode, -1 where the law kept
    running. detail: what chance chose, such as the number of the state in which a bit
    was flipped.
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
        """Whether every check passed."""
        return not self.failed

    @property
    def group(self) -> str:
        """What a failure means, one of `GROUPS`.

        "unsafe": outputs that are not finite, in their limits and slew limited, or a
        tip more than 0.3 rad off with the drive still closed; "trips without need": a
        mode that the fault does not ask for; "slower than promised": everything else,
        such as a larger peak or a later reaction.
        """
        names = [check.name for check in self.failed]
        # A move that settles late may be far from its reference for a reason: an
        # actuator at its limit.
        astray = self.peak > SAFE and any(
            not name.startswith("settling") for name in names
        )
        if any(name.startswith(("G1", "G2", "G3")) for name in names):
            return "unsafe"
        if astray and self.mode in ("run", "degraded"):
            return "unsafe"
        if any(name.startswith(OTHER_MODE) for name in names):
            return "trips without need"
        return "slower than promised" if names else "met"

    @property
    def name(self) -> str:
        """The case's name, with what chance chose."""
        return f"{self.case.name}: {self.detail}" if self.detail else self.case.name

    @property
    def failed(self) -> tuple[Check, ...]:
        """The checks that failed."""
        return tuple(check for check in self.checks if not check.passed)


@dataclass(frozen=True)
class Row:
    """One fault in the summary: its runs, those that fail, the check that fails worst
    and its run.

    group: the most severe one of its runs, see `Outcome.group`.
    """

    number: str
    title: str
    reaction: str
    required: str
    runs: int
    failed: int
    worst: str
    example: Outcome | None
    group: str

    @property
    def passed(self) -> bool:
        """Whether every run met the requirement."""
        return self.failed == 0


@document(
    "fault-campaign",
    version=2,
    sources=lambda table: (
        {"law": table.about["law_sha256"]} if "law_sha256" in table.about else {}
    ),
    summary=lambda table: {"passed": table.passed, "failures": len(table.failures)},
)
@dataclass(frozen=True)
class FaultTable:
    """Verdicts of a campaign in the order of the runs; `about` says what was run."""

    outcomes: tuple[Outcome, ...]
    about: Mapping[str, str] = field(default_factory=dict)

    @property
    def passed(self) -> bool:
        """Whether every run of every fault met its requirement."""
        return not self.failures

    @property
    def failures(self) -> tuple[Outcome, ...]:
        """The runs that did not meet their requirement: the failed runs."""
        return tuple(outcome for outcome in self.outcomes if not outcome.passed)

    def rows(self) -> tuple[Row, ...]:
        """Return one row a fault."""
        numbers = dict.fromkeys(outcome.case.fault for outcome in self.outcomes)
        return tuple(self._row(fault_named(number)) for number in numbers)

    def _row(self, fault: Fault) -> Row:
        mine = [
            outcome for outcome in self.outcomes if outcome.case.fault == fault.number
        ]
        failed = [outcome for outcome in mine if not outcome.passed]
        # By the factor over the limit: a peak in radians and a reaction in periods have
        # no other common measure.
        candidates = ((check, o) for o in failed for check in o.failed)
        check, example = max(
            candidates, key=lambda x: _excess(x[0]), default=(None, None)
        )
        worst = "" if example is None else f"{check} ({example.name})"
        counts = (len(mine), len(failed))
        # A fault is as bad as its worst run.
        group = max((outcome.group for outcome in mine), key=GROUPS.index)
        return Row(
            fault.number,
            fault.title,
            fault.reaction,
            fault.required,
            *counts,
            worst,
            example,
            group,
        )

    def markdown(self) -> str:
        """Return the summary as a Markdown table, then why faults are missed and what
        is not shown.
        """
        lines = [
            "| fault | what | class | required | runs | failed | group | worst |",
            "|---|---|---|---|---|---|---|---|",
        ]
        rows = self.rows()
        for row in rows:
            cells = (
                row.number,
                row.title,
                row.reaction,
                row.required,
                row.runs,
                row.failed,
                row.group,
            )
            lines.append(
                # |x| in a check's name would end a cell of Markdown.
                "| "
                + " | ".join(
                    str(cell).replace("|", "\\|") for cell in (*cells, row.worst)
                )
                + " |"
            )
        faults = [(row, fault_named(row.number)) for row in rows]
        causes = [
            f"- {row.number}: {fault.cause}."
            for row, fault in faults
            if fault.cause and not row.passed
        ]
        notes = [
            f"- {row.number}: {fault.note}." for row, fault in faults if fault.note
        ]
        lines += ["", "Why, on the paper's arm:", "", *causes] if causes else []
        lines += ["", "What this does not show:", "", *notes] if notes else []
        return "\n".join(lines).rstrip("\n") + "\n"


def _excess(check: Check) -> float:
    """By how much a limit is exceeded, as a factor; a reaction that never came is the
    worst.
    """
    if not math.isfinite(check.measured):
        return math.inf
    return check.measured / check.limit if check.limit > 0 else check.measured


# ---- running -----------------------------------------------------------------------------------------


@checked
def cases(
    bench: Bench,
    *,
    only: Sequence[str] = (),
    severities: Sequence[Annotated[int, Between(1, 3)]] = (1, 2, 3),
    payloads: Sequence[Payload] = (),
    phases: Sequence[Phase] = PHASES,
    seeds: Sequence[Annotated[int, Between(0, 2**63 - 1)]] = (1, 2, 3),
) -> tuple[Case, ...]:
    """Return every case of a campaign in order; empty `only` and `payloads` mean all.

    Raises FieldError for unknown faults, phases, severities, payloads, and where
    nothing is left to run.
    """
    # Faults outside, seeds inside: what can be shared, the clean run of a payload and a
    # seed, is met again soon.
    faults = [fault_named(name) for name in only] or list(CATALOGUE)
    result = tuple(
        Case(fault.number, severity, payload, phase, seed)
        for fault in faults
        for severity in severities
        for payload in payloads or bench.payloads
        for phase in phases
        for seed in seeds
        if phase in fault.phases and (severity, phase) not in fault.skips
    )
    if not result:
        allowed = ", ".join(
            sorted({phase for fault in faults for phase in fault.phases})
        )
        problem, remedy = "none in which the fault is run", "choose one of these"
        raise FieldError(
            "phases", ", ".join(phases), problem, allowed=allowed, remedy=remedy
        )
    return result


@checked
def observe(
    bench: Bench, case: Case, law: Law, *, clean: CleanRuns | None = None
) -> Evidence:
    """Run one case with `law` and return both runs; `clean` keeps the clean ones for
    the next case.

    Raises FieldError where the clean arm does not stay in mode run: nothing could be
    learnt from its faults.
    """
    fault = fault_named(case.fault)
    trial = _trial(bench, fault, case, law)
    fault.rule.inject(trial)
    payload = bench.payloads[1] if fault.nominal else case.payload
    special = (
        fault.number if fault.rule.prepare or fault.rule.reference is not MOVE else ""
    )
    # All that a clean run depends on. A fault that prepares its arm, or moves
    # otherwise, has a clean run of its own; the law's digest tells the two precisions
    # apart.
    key = (payload, case.seed, fault.duration, special, law.digest)
    # A dictionary of the caller's and no cache of the module: a campaign of 8610 runs
    # keeps some 100 clean ones, and frees them.
    known = {} if clean is None else clean
    if key not in known:
        healthy = execute(
            _trial(
                bench, fault, Case(fault.number, 1, payload, "whole", case.seed), law
            )
        )
        _check_clean(healthy, payload)
        known[key] = healthy
    best = None
    if fault.rule.best is not None:
        knowing = _trial(bench, fault, case, law)
        # The same fault, drawn by the same dice, and on top of it what a law would do
        # that knew.
        fault.rule.inject(knowing)
        fault.rule.best(knowing)
        best = execute(knowing)
    return Evidence(
        bench,
        case,
        trial.law,
        trial.row,
        trial.marks,
        execute(trial),
        known[key],
        trial.detail,
        best,
    )


def _trial(bench: Bench, fault: Fault, case: Case, law: Law) -> Trial:
    trial = Trial(bench, case, law, fault.rule.reference, fault.duration)
    if fault.rule.prepare is not None:
        fault.rule.prepare(trial)
    return trial


def _check_clean(run: TrialSignals, payload: float) -> None:
    tripped = np.flatnonzero(run.mode > RUN)
    if tripped.size or not run.finished:
        row = int(tripped[0]) if tripped.size else -1
        where = f"{MODES[run.mode[row]]} ({REASONS[run.reason[row]]}) at {run.time[row]:.3f} s"
        raise FieldError(
            "bench",
            where,
            f"trips with {1e3 * payload:g} g before anything is broken",
            allowed="a healthy arm that stays in mode run",
            remedy="mend the rig or the design first; the paper's arm needs a gear (--gear 50)",
        )


@checked
def run_case(
    bench: Bench, case: Case, *, single: bool = True, clean: CleanRuns | None = None
) -> Outcome:
    """Run one case and judge it; `single`: in single precision too, which must meet the
    same.

    A reading of 4.1 N·m for ever, beyond the gauge's range, must degrade the law within
    5 samples:

    >>> import fraclink as fl
    >>> from fraclink._simulate import geared
    >>> rig = geared(fl.Rig.named("paper-2023"))
    >>> design = fl.design(
    ...     rig.model, rig, payloads=(0.020, 0.040), gain_crossover=12.0, phase_margin=fl.deg(50)
    ... )
    >>> outcome = run_case(Bench.of(design, link_mass=0.00735), Case("F09", 1, 0.030, "mid", 1))
    >>> outcome.passed, outcome.mode, outcome.reason, outcome.reacted
    (True, 'degraded', 'gauge', 5)
    """
    # Double precision is the reference; what is reported of a run, peak and final
    # error, is its.
    e = observe(bench, case, bench.law.in_precision("double"), clean=clean)
    checks = _judged(e)
    if single:
        other = observe(bench, case, bench.law.in_precision("single"), clean=clean)
        checks += [
            Check(
                f"{check.name}, single precision",
                check.measured,
                check.limit,
                check.passed,
            )
            for check in _judged(other)
            if not check.passed
        ]
        # In the same order. A loop that diverges amplifies the rounding: it may take
        # the modes a few periods apart, and for another of the reasons that are
        # allowed, to which each run is held on its own.
        apart = _modes(e.faulty) != _modes(other.faulty)
        checks.append(Check.at_most("single precision: other modes", int(apart), 0))
    mode, reason = e.end
    return Outcome(
        case,
        tuple(checks),
        e.peak,
        e.clean_peak,
        e.final,
        mode,
        reason,
        e.reacted,
        e.detail,
    )


def _judged(e: Evidence) -> list[Check]:
    return [
        *shared_checks(e),
        *(check(e) for check in fault_named(e.case.fault).rule.require),
    ]


def _modes(signals: TrialSignals) -> list[int]:
    """Modes in their order, without how long each lasted."""
    modes = signals.mode.astype(int)
    return [int(mode) for mode in modes[np.append(True, np.diff(modes) != 0)]]


@checked
def run_faults(
    bench: Bench,
    planned: Sequence[Case],
    *,
    single: bool = True,
    progress: Callable[[str], None] = lambda name: None,
    watch: Callable[[Outcome], None] = lambda outcome: None,
    about: dict[str, str] | None = None,
) -> FaultTable:
    """Run `planned` cases on the bench and return the table of their verdicts.

    A healthy arm that trips ends the campaign at once, with a FieldError.

    Parameters
    ----------
    single
        whether each case must pass in single precision, too.
    progress
        called with the number of each fault when it begins.
    watch
        called with the outcome of each run.
    about
        what the table is to remember.
    """
    outcomes = []
    for outcome in _outcomes(bench, planned, single, progress):
        watch(outcome)
        outcomes.append(outcome)
    return FaultTable(
        tuple(outcomes), {"law_sha256": bench.law.digest, **(about or {})}
    )


def _outcomes(
    bench: Bench, planned: Sequence[Case], single: bool, progress: Callable[[str], None]
) -> Iterator[Outcome]:
    clean: CleanRuns = {}
    current = ""
    for case in planned:
        if case.fault != current:
            current = case.fault
            progress(current)
        yield run_case(bench, case, single=single, clean=clean)
