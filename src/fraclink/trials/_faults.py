"""Forty-four faults of an arm, injected while the shipped law runs on the twin, each
with a verdict.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from typing import Annotated, Any, Literal

import numpy as np

from fraclink._display import Overview, Row, Table, displayed, rows_of, state_of
from fraclink._files import document, from_plain
from fraclink._simulate.run import Run
from fraclink.errors import FieldError
from fraclink.trials._fault_checks import (
    CHECKS,
    OTHER_MODE,
    Check,
    Evidence,
    shared_checks,
)
from fraclink.trials._fault_injections import at_severity, inject
from fraclink.trials._fault_trial import (
    MOVES,
    PHASES,
    RUN,
    Bench,
    Case,
    FaultTrial,
    Phase,
    end_of,
    execute,
)
from fracsys.checks import Between, Payload, checked

__all__ = [
    "CATALOGUE",
    "GROUPS",
    "Fault",
    "FaultSummary",
    "FaultTable",
    "Outcome",
    "cases",
    "fault_named",
    "observe",
    "run_case",
    "run_faults",
]

CleanRuns = dict[tuple[object, ...], Run]
Steps = tuple[Mapping[str, Any], ...]
# in ascending order of severity
GROUPS = ("met", "slower than promised", "trips without need", "unsafe")
# [rad] between tip and reference: an arm farther away with its drive on is dangerous,
# whatever requirement it misses. F29 requires the same of a flipped bit.
SAFE = 0.3
# The mode that a reaction ends in: beside run, no other one is allowed.
REACTIONS = {"A": "run", "B": "degraded", "C": "hold", "D": "off", "-": "run"}


# --- the catalogue --------------------------------------------------------------------


@dataclass(frozen=True)
class Fault:
    """A row of the catalogue, as faults.toml explains it.

    reaction: A ride through, B degrade, C hold, D off, "-" for another requirement.
    inject: the steps that break a trial; require: the checks of its run, in addition to
    those of every run; also: modes that are allowed beside run and that of the
    reaction. prepare: steps for the faulty and the clean run alike. best: steps after
    the fault's own that make the law act as one that knows of the fault at once. move:
    the reference's name. duration of the run [s]. nominal: whether the clean run has
    the nominal payload. skips: severity and phase of cases that are not run. cause: why
    the shipped law misses the requirement on the paper's arm. note: a limit of the
    test.
    """

    number: str
    title: str
    injection: str
    severities: tuple[str, str, str]
    required: str
    reaction: Literal["A", "B", "C", "D", "-"]
    inject: Steps
    require: Steps
    also: tuple[str, ...] = ()
    phases: tuple[str, ...] = ("start", "mid", "rest")
    prepare: Steps = ()
    best: Steps = ()
    move: str = "move"
    duration: float = 7.0
    nominal: bool = False
    skips: tuple[tuple[int, str], ...] = ()
    cause: str = ""
    note: str = ""

    def trial(self, bench: Bench, case: Case) -> FaultTrial:
        """Return the trial of a case before it is broken."""
        trial = FaultTrial(bench, case, MOVES[self.move], self.duration)
        inject(trial, self.prepare)
        return trial

    def checks(self, evidence: Evidence) -> tuple[Check, ...]:
        """Return the checks of every run, and those of this fault."""
        case = evidence.trial.case
        checks = [*shared_checks(evidence, "run", REACTIONS[self.reaction], *self.also)]
        for row in self.require:
            of_phase = case.phase in row.get("phases", PHASES)
            if of_phase and case.severity in row.get("severities", (1, 2, 3)):
                options = at_severity(row, case, but=("check", "phases", "severities"))
                checks.append(CHECKS[row["check"]](evidence, **options))
        return tuple(checks)


def _catalogue() -> tuple[Fault, ...]:
    # Read at import, because every command names the faults; the table is data that a
    # user can read without knowing the code.
    rows = tomllib.loads(
        files("fraclink").joinpath("trials/faults.toml").read_text("utf-8")
    )
    return tuple(
        from_plain(Fault, {"number": number, **row}, number)
        for number, row in sorted(rows.items())
    )


CATALOGUE = _catalogue()


@checked
def fault_named(number: str) -> Fault:
    """Return a fault by its number; FieldError where there is none.

    >>> fault_named("F07").title
    'encoder stuck in a move'
    """
    # A number typed by hand may be in lower case.
    catalogue = {fault.number: fault for fault in CATALOGUE}
    if number.upper() not in catalogue:
        raise FieldError(
            "only",
            number,
            "not in the catalogue",
            f"{CATALOGUE[0].number} … {CATALOGUE[-1].number}",
            "choose one of these",
        )
    return catalogue[number.upper()]


# --- the table of verdicts ------------------------------------------------------------


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
    def failed(self) -> tuple[Check, ...]:
        """The checks that failed."""
        return tuple(check for check in self.checks if not check.passed)

    @property
    def group(self) -> str:
        """What a failure means, one of `GROUPS`.

        "unsafe": an output that is infinite, beyond its limits or its slew limit, or a
        tip more than 0.3 rad off with the drive still on; "trips without need": a
        mode that the fault does not ask for; "slower than promised": everything else,
        such as a larger peak or a later reaction.
        """
        names = [check.name for check in self.failed]
        # A move that settles late may be far from its reference for a legitimate
        # reason: an actuator at its limit.
        astray = self.peak > SAFE and any(
            not name.startswith("settling") for name in names
        )
        driven = self.mode in ("run", "degraded")
        if any(name.startswith("G") for name in names) or (astray and driven):
            return "unsafe"
        if OTHER_MODE in names:
            return "trips without need"
        return "slower than promised" if names else "met"

    @property
    def name(self) -> str:
        """The case's name, with what chance chose."""
        return f"{self.case.name}: {self.detail}" if self.detail else self.case.name


@dataclass(frozen=True)
class FaultSummary:
    """A fault in the summary, with its runs."""

    fault: Fault
    outcomes: tuple[Outcome, ...]

    @property
    def runs(self) -> int:
        """Number of runs."""
        return len(self.outcomes)

    @property
    def failed(self) -> int:
        """How many of them missed the requirement."""
        return sum(not outcome.passed for outcome in self.outcomes)

    @property
    def group(self) -> str:
        """The most severe group of its runs, see `Outcome.group`."""
        return max((outcome.group for outcome in self.outcomes), key=GROUPS.index)

    @property
    def worst(self) -> tuple[Check, Outcome] | None:
        """The check that fails worst, and its run; None where every run passed.

        Compared by the factor over the limit, the only common measure of a peak in
        radians and a reaction in periods.
        """
        failures = [(check, run) for run in self.outcomes for check in run.failed]
        return max(failures, key=lambda pair: pair[0].excess, default=None)

    @property
    def number(self) -> str:
        """The fault's number."""
        return self.fault.number

    @property
    def passed(self) -> bool:
        """Whether every run met the requirement."""
        return self.failed == 0

    @property
    def rows(self) -> tuple[Row, ...]:
        """Its line in a table."""
        return rows_of(
            self,
            "number",
            Row("", "fault", f"{self.number} {self.fault.title}"),
            Row("", "class", self.fault.reaction),
            ("runs", "runs"),
            ("failed", "failed"),
            Row("", "group", self.group),
            ("passed", "verdict"),
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """The run that misses its requirement most and why the paper's arm misses it,
        and the limits of the test.
        """
        fault, notes = self.fault, []
        if self.worst is not None:
            check, run = self.worst
            cause = f"; on the paper's arm: {fault.cause}" if fault.cause else ""
            notes.append(f"{self.number}: {check} ({run.name}){cause}")
        if fault.note:
            notes.append(f"note on {self.number}: {fault.note}")
        return tuple(notes)


@displayed
@document(
    "fault-campaign",
    version=3,
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

    @property
    def sentence(self) -> str:
        """How many faults meet their requirement in every run."""
        rows = self.rows()
        met = sum(row.passed for row in rows)
        return (
            f"{met} of {len(rows)} faults meet their requirement in every run, "
            f"{len(self.outcomes)} runs"
        )

    def repeated(self, outcome: Outcome) -> str:
        """The command that runs one case again."""
        case = outcome.case
        command = self.about.get(
            "command", "fraclink campaign faults --design design.json"
        )
        return (
            f"{command} --only {case.fault} --severity {case.severity} --payload {case.payload!r} "
            f"--phase {case.phase} --seed {case.seed} --out {case.name}"
        )

    def overview(self) -> Overview:
        """One line a fault, those that miss their requirement first; for each of these
        its worst run by name.
        """
        summaries = self.rows()
        counts = {f.number: {"runs": f.runs, "failed": f.failed} for f in summaries}
        failures = [
            {
                "name": outcome.case.name,
                "detail": outcome.detail,
                "failed": [str(check) for check in outcome.failed],
                "replay": self.repeated(outcome),
            }
            for outcome in self.failures
        ]
        return Overview(
            self.sentence,
            state_of(self.passed),
            (
                Row("runs", "", len(self.outcomes)),
                Row("failures", "", failures),
                Row("faults", "", counts),
            ),
            # sorted is stable: within met and missed the order of the catalogue
            # remains.
            (Table.of("", sorted(summaries, key=lambda f: f.passed)),),
            notes=tuple(note for fault in summaries for note in fault.notes),
        )

    def rows(self) -> tuple[FaultSummary, ...]:
        """Return one row a fault."""
        runs: dict[str, list[Outcome]] = {}
        for outcome in self.outcomes:
            runs.setdefault(outcome.case.fault, []).append(outcome)
        return tuple(
            FaultSummary(fault_named(number), tuple(each))
            for number, each in runs.items()
        )


# --- running --------------------------------------------------------------------------


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
    # Faults in the outer loop, seeds in the inner one: the clean run of a payload and a
    # seed, which can be shared, is needed again soon.
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
        raise FieldError(
            "phases",
            ", ".join(phases),
            "none in which the fault is run",
            ", ".join(sorted({phase for fault in faults for phase in fault.phases})),
            "choose one of these",
        )
    return result


@checked
def observe(bench: Bench, case: Case, *, clean: CleanRuns | None = None) -> Evidence:
    """Run one case and return both runs; `clean` keeps the clean ones for the next
    case.

    Raises FieldError where the clean arm does not stay in mode run: nothing could be
    learnt from its faults.
    """
    fault = fault_named(case.fault)
    trial = fault.trial(bench, case)
    inject(trial, fault.inject)
    payload = bench.payloads[1] if fault.nominal else case.payload
    # Everything on which a clean run depends; the clean run of a prepared arm belongs
    # to its fault alone.
    special = fault.number if fault.prepare else fault.move
    key = (payload, case.seed, fault.duration, special, bench.law.digest)
    # A dictionary of the caller instead of a module cache: a campaign of 2583 runs
    # keeps 66 clean runs, and frees them at its end.
    cache = {} if clean is None else clean
    if key not in cache:
        whole = Case(fault.number, 1, payload, "whole", case.seed)
        healthy, _ = execute(fault.trial(bench, whole))
        _check_clean(healthy, payload)
        cache[key] = healthy
    best = None
    if fault.best:
        # The same fault with the same random numbers, with the action of a law that
        # knows it.
        knowing = fault.trial(bench, case)
        inject(knowing, (*fault.inject, *fault.best))
        best, _ = execute(knowing)
    run, memory = execute(trial)
    return Evidence(trial, run, cache[key], memory, best)


def _check_clean(run: Run, payload: float) -> None:
    trips = np.flatnonzero(run.mode > RUN)
    if trips.size or not run.finished:
        mode, reason = end_of(run)
        time = run.time[trips[0] if trips.size else -1]
        raise FieldError(
            "bench",
            f"{mode} ({reason}) at {time:.3f} s",
            f"trips with {1e3 * payload:g} g before anything is broken",
            "a healthy arm that stays in mode run",
            "mend the rig or the design first; the paper's arm needs a gear: --rig paper-2023-geared",
        )


@checked
def run_case(bench: Bench, case: Case, *, clean: CleanRuns | None = None) -> Outcome:
    """Run one case with the law that ships and judge it.

    A reading of 4.1 N·m for ever, beyond the gauge's range, must degrade the law within
    5 samples:

    >>> import fraclink as fl
    >>> rig = fl.Rig.named("paper-2023-geared")
    >>> design = fl.design(
    ...     rig.model, rig, payloads=(0.020, 0.040), gain_crossover=12.0, phase_margin=fl.deg(50)
    ... )
    >>> outcome = run_case(Bench.of(design, link_mass=0.00735), Case("F09", 1, 0.030, "mid", 1))
    >>> outcome.passed, outcome.mode, outcome.reason, outcome.reacted
    (True, 'degraded', 'gauge', 5)
    """
    e = observe(bench, case, clean=clean)
    checks = fault_named(case.fault).checks(e)
    return Outcome(
        case,
        checks,
        e.peak,
        e.clean_peak,
        e.final,
        *end_of(e.faulty),
        e.reacted,
        e.trial.detail,
    )


@checked
def run_faults(
    bench: Bench,
    planned: Sequence[Case],
    *,
    watch: Callable[[Outcome], None] = lambda outcome: None,
    about: dict[str, str] | None = None,
) -> FaultTable:
    """Run `planned` cases on the bench and return the table of their verdicts.

    A healthy arm that trips ends the campaign at once, with a FieldError.

    Parameters
    ----------
    bench, planned
        what is tested, and the cases that `cases` returned.
    watch
        called with the outcome of each run.
    about
        what the table is to remember.
    """
    outcomes: list[Outcome] = []
    clean: CleanRuns = {}
    for case in planned:
        outcomes.append(run_case(bench, case, clean=clean))
        watch(outcomes[-1])
    return FaultTable(
        tuple(outcomes), {"law_sha256": bench.law.digest, **(about or {})}
    )
