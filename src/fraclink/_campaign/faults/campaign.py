"""Run the catalogue: every fault, severity, payload, phase and seed, each with its verdict."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from fraclink._campaign.faults.catalogue import CATALOGUE, fault_named
from fraclink._campaign.faults.evidence import Evidence, shared_checks
from fraclink._campaign.faults.nouns import PHASES, Case, Check, Fault, Outcome
from fraclink._campaign.faults.table import FaultTable
from fraclink._campaign.faults.trial import MOVE, Bench, Signals, Trial, execute
from fraclink._law import Law
from fraclink._validate import checked_choice, checked_noun, checked_whole
from fraclink.errors import FieldError

__all__ = ["cases", "observe", "run_case", "run_faults"]

CleanRuns = dict[tuple[object, ...], Signals]


def cases(
    bench: Bench,
    *,
    only: Sequence[str] = (),
    severities: Sequence[int] = (1, 2, 3),
    payloads: Sequence[float] = (),
    phases: Sequence[str] = PHASES,
    seeds: Sequence[int] = (1, 2, 3),
) -> tuple[Case, ...]:
    """Return every case of a campaign in order; empty `only` and `payloads` mean all.

    Raises FieldError for unknown faults, phases, severities, payloads, and where nothing is left to run.
    """
    _checked_bench(bench)
    faults = [fault_named(name) for name in _listed("only", only)] or list(CATALOGUE)
    masses = _listed("payloads", payloads) or bench.payloads
    chosen = tuple(checked_choice("phase", phase, PHASES) for phase in _listed("phases", phases))
    degrees = tuple(checked_whole("severity", degree, 1, 3) for degree in _listed("severities", severities))
    result = tuple(
        Case(fault.number, severity, payload, phase, seed)
        for fault in faults
        for severity in degrees
        for payload in masses
        for phase in chosen
        for seed in _listed("seeds", seeds)
        if phase in fault.phases and (severity, phase) not in fault.skips
    )
    if not result:
        raise FieldError(
            "phase",
            ", ".join(chosen),
            "none in which the fault is run",
            allowed=", ".join(sorted({phase for fault in faults for phase in fault.phases})),
            remedy="choose one of these",
        )
    return result


def _checked_bench(bench: object) -> None:
    checked_noun("bench", bench, Bench, remedy="Bench.of(design) makes one")


def _listed(field: str, values: object) -> tuple[Any, ...]:
    """Return a list's values; FieldError for a single one, which a text would be taken apart for."""
    if not isinstance(values, list | tuple | range):
        allowed, remedy = "a list", "put even a single value in a list"
        raise FieldError(field, repr(values), "no list", allowed=allowed, remedy=remedy)
    return tuple(values)


def observe(bench: Bench, case: Case, law: Law, *, clean: CleanRuns | None = None) -> Evidence:
    """Run one case with `law` and return both runs; `clean` keeps the clean ones for the next case."""
    _checked_bench(bench)
    checked_noun("law", law, Law, remedy="bench.law, or design.law()")
    fault = fault_named(case.fault)
    trial = _trial(bench, fault, case, law)
    fault.inject(trial)
    payload = bench.payloads[1] if fault.nominal else case.payload
    key = (
        payload,
        case.seed,
        fault.duration,
        fault.number if fault.prepare or fault.reference else "",
        law.digest,
    )
    known = {} if clean is None else clean
    if key not in known:
        known[key] = execute(_trial(bench, fault, Case(fault.number, 1, payload, "whole", case.seed), law))
    return Evidence(bench, case, trial.law, trial.row, trial.marks, execute(trial), known[key], trial.detail)


def _trial(bench: Bench, fault: Fault, case: Case, law: Law) -> Trial:
    trial = Trial(bench, case, law, fault.reference or MOVE, fault.duration)
    if fault.prepare is not None:
        fault.prepare(trial)
    return trial


def run_case(bench: Bench, case: Case, *, single: bool = True, clean: CleanRuns | None = None) -> Outcome:
    """Run one case and judge it; `single`: in single precision too, which must meet the same.

    A reading of 4.1 N·m for ever, beyond the gauge's range, must degrade the law within 5 samples:

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
    _checked_bench(bench)
    fault = fault_named(checked_noun("case", case, Case, remedy="cases(bench) makes them").fault)
    e = observe(bench, case, bench.law.in_precision("double"), clean=clean)
    checks = [*shared_checks(e, e.faulty), *(check(e) for check in fault.checks)]
    if single:
        other = observe(bench, case, bench.law.in_precision("single"), clean=clean)
        again = (*shared_checks(other, other.faulty), *(check(other) for check in fault.checks))
        checks += [_renamed(check) for check in again if not check.passed]
        checks.append(_same_modes(e.faulty, other.faulty))
    mode, reason = e.end
    return Outcome(case, tuple(checks), e.peak, e.clean_peak, e.final, mode, reason, e.reacted, e.detail)


def _renamed(check: Check) -> Check:
    return Check(f"{check.name}, single precision", check.measured, check.limit, check.passed)


def _changes(signals: Signals) -> list[tuple[int, int]]:
    """Modes and reasons in their order, without how long each lasted."""
    pairs = np.column_stack((signals.mode, signals.reason)).astype(int)
    kept = np.append(True, np.any(np.diff(pairs, axis=0) != 0, axis=1))
    return [(int(mode), int(reason)) for mode, reason in pairs[kept]]


def _same_modes(double: Signals, single: Signals) -> Check:
    """Same modes and reasons in the same order; a diverging loop may take them a few periods apart."""
    apart = _changes(double) != _changes(single)
    return Check.at_most("single precision: other modes or reasons", int(apart), 0)


def run_faults(
    bench: Bench,
    planned: Sequence[Case],
    *,
    single: bool = True,
    progress: Callable[[str], None] = lambda name: None,
    about: dict[str, str] | None = None,
) -> FaultTable:
    """Run `planned` cases on the bench and return the table of their verdicts.

    progress: called with the number of each fault when it begins. about: what the table is to remember.
    """
    _checked_bench(bench)
    for case in _listed("planned", planned):
        checked_noun("planned", case, Case, remedy="cases(bench) makes them")
    return FaultTable(
        outcomes=tuple(_outcomes(bench, planned, single, progress)),
        about={"law_sha256": bench.law.digest, **(about or {})},
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
