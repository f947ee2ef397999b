"""What people read of each result: a headline with the verdict, tables, then notes.

A result is looked up by the name of its class: importing the classes here would load
every package whatever is shown.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from fraclink._law import MODES, REASONS
from fraclink.findings import errors_of
from fraclink.view._fits import (
    driven_view,
    experiment_view,
    motor_view,
    payloads_view,
    recording_view,
    response_view,
    spectrum_view,
    structure_view,
    validation_view,
    worth_reading,
)
from fraclink.view._tables import (
    coincidence,
    faults_sentence,
    faults_table,
    fit_table,
    fits_table,
    held_out,
    log_table,
    moves_table,
    proof_sentence,
    proof_table,
    requirements_table,
    rig_table,
    source_name,
    spread_table,
    state_of,
    verdict_sentence,
    verdict_table,
)
from fraclink.view._text import (
    Table,
    View,
    degrees,
    finding_line,
    grams,
    looked_up,
    number,
)
from fraclink.view._tunings import pid_view, shaped_view, tuning_view, watch_view

if TYPE_CHECKING:
    from fraclink._arm.rig import Rig
    from fraclink._design import Design
    from fraclink._identify import Comparison, Fit
    from fraclink._law import Law
    from fraclink._simulate import Run
    from fraclink.findings import Finding
    from fraclink.logs._start import Start
    from fraclink.trials._faults import FaultTable, Outcome
    from fraclink.trials._study import Study
    from fraclink.trials._summary import Summary

__all__ = ["faults_page", "repeated", "view"]


def view(result: Any) -> View:
    """Return what people read of a result.

    >>> from fraclink.findings import Finding
    >>> print(view((Finding("W210", "warning", "the gauge has an offset", {}, "subtract it"),)))
    ! not shown: 1 warning
    <BLANKLINE>
    W210 warning: the gauge has an offset; subtract it
    """
    shown: View = looked_up(_VIEWS, result)(result)
    return shown


def _findings_view(findings: tuple[Finding, ...]) -> View:
    found = [f.severity for f in findings]
    # A warning is no failure, but a result with one is not yet shown to be right: the
    # word between.
    state = (
        "failed"
        if "error" in found
        else "not shown"
        if "warning" in found
        else "passed"
    )
    counts = [
        (found.count(word), word)
        for word in ("error", "warning", "info")
        if word in found
    ]
    headline = ", ".join(
        f"{n} {word}{'s' if n > 1 and word != 'info' else ''}" for n, word in counts
    )
    return View(
        headline or "no findings", notes=tuple(map(finding_line, findings)), state=state
    )


# --- rig, log and models ----------------------------------------------------------------------------------


def _rig_view(rig: Rig) -> View:
    return View(rig.name, (rig_table(rig),), tuple(map(finding_line, rig.warnings)))


def _log_view(log: Any) -> View:
    return View(source_name(log), (log_table(log),))


def _fit_view(fit: Fit) -> View:
    state = "passed" if fit.passed else "not shown"
    return View(
        f"{fit.structure}, {held_out(fit.heldout_nmse)}",
        (fit_table(fit),),
        worth_reading(fit.findings),
        state,
    )


def _start_view(started: Start) -> View:
    model = _fit_view(started.fit)
    rows = tuple(
        (guess.part, guess.value, guess.certainty, guess.evidence)
        for guess in started.guesses
    )
    check = len(started.uncertain)
    headline = (
        f"{model.headline}; {check} of {len(rows)} guesses to check"
        if check
        else model.headline
    )
    notes = (*map(str, errors_of(started.findings)), *model.notes)
    tables = (Table(("log", "taken as", "certainty", "evidence"), rows), *model.tables)
    return View(headline, tables, notes, "passed" if started.passed else "not shown")


def _comparison_view(comparison: Comparison) -> View:
    fits = comparison.fits
    warned = (
        f"{name}: {text}"
        for name, fit in fits.items()
        for text in worth_reading(fit.findings)
    )
    return View(comparison.verdict, (fits_table(fits),), (*coincidence(fits), *warned))


# --- the design and what it is worth ----------------------------------------------------------------------


def _design_view(design: Design) -> View:
    c = design.controller
    filtered = (
        f", filter δ = {number(c.filter_time)} s, n = {c.filter_order}"
        if c.filter_time
        else ", no filter"
    )
    if c.notch is not None:
        filtered += f", notch at {number(c.notch.frequency, 5)} rad/s"
    headline = (
        f"controller k_d = {number(c.gain, 5)}, β = {number(c.order, 5)}{filtered}"
    )
    tables = (requirements_table(design.requirements),)
    # A doubt about the input outweighs requirements that are met, for they are met by a
    # model in doubt; one that is missed fails whatever the input.
    missed = any(not item.passed for item in design.requirements)
    state = "not shown" if design.doubts and not missed else state_of(design)
    return View(headline, tables, tuple(map(finding_line, design.findings)), state)


def _law_view(law: Law) -> View:
    order = len(law.correction.poles) + 2 * len(law.correction.pair_poles)
    motor = (
        "with its motor loop"
        if law.drive is not None
        else "for a robot with its own servo"
    )
    motor = motor if law.has_gauge else "a fractional PID"
    headline = f"{order} states, one step every {number(1e3 * law.period)} ms, {motor}"
    return View(headline, notes=(f"SHA-256 {law.digest}",))


def _assessment_view(found: Any) -> View:
    payloads = found.payloads
    shares = tuple((share.element, degrees(share.phase, 2)) for share in found.budget)
    margins = tuple(
        (c.kind, *(degrees(float(p), 2) for p in c.phase_margin)) for c in found.curves
    )
    tables = (
        requirements_table(found.modes),
        Table((f"phase at {grams(payloads[-1])}", "share"), shares),
        Table(("phase margin", *(grams(float(f"{m:.3g}")) for m in payloads)), margins),
    )
    massless = "higher modes: none, as the link has no mass; give --link-mass [kg]"
    notes = () if found.modes else (massless,)
    sampled = next(c for c in found.curves if c.kind == "sampled")
    least = degrees(float(min(sampled.phase_margin)), 1)
    return View(
        f"at least {least} of phase margin in the sampled loop",
        tables,
        notes,
        state_of(found),
    )


def _map_view(found: Any) -> View:
    return View(
        f"{100 * float(np.mean(found.feasible)):.0f} % of the map is feasible",
        state="passed" if found.feasible.any() else "failed",
    )


def _run_view(run: Run) -> View:
    # The reason already says which requirement of the move was missed, with its number.
    headline = "move settled" if run.verdict.passed else run.verdict.reason
    return View(
        headline,
        (moves_table([run]),),
        tuple(map(finding_line, run.findings)),
        state_of(run.verdict),
    )


def _certificate_view(certificate: Any) -> View:
    # The sign before the headline says "failed" already.
    return View(
        proof_sentence(certificate).removeprefix("Not certified: "),
        (proof_table(certificate),) if certificate.passed else (),
        state=state_of(certificate),
    )


# --- many runs --------------------------------------------------------------------------------------------


def _summary_view(summary: Summary) -> View:
    trips = tuple(
        f"{count} runs: {MODES[mode]} ({REASONS[reason]})"
        for mode, reason, count in summary.trips
    )
    notes = (*filter(None, (summary.left_out, summary.given)), *trips)
    headline = summary.failure.sentence
    if summary.damaged:  # else "failed" would stand before "0 of 2000 runs failed"
        parts = (
            "1 part" if len(summary.damaged) == 1 else f"{len(summary.damaged)} parts"
        )
        headline = (
            f"{parts} of the campaign damaged or edited; of the others, {headline}"
        )
    return View(headline, (spread_table(summary),), notes, state_of(summary))


def repeated(table: FaultTable, outcome: Outcome) -> str:
    """The command that runs one case of a fault campaign again."""
    case, begun = outcome.case, table.about.get("command", "fraclink campaign faults")
    return (
        f"{begun} --only {case.fault} --severity {case.severity} --payload {case.payload!r} "
        f"--phase {case.phase} --seed {case.seed} --out {case.name}"
    )


def _faults_view(table: FaultTable) -> View:
    """The table, and for each fault that fails its worst run by name: `campaign replay`
    repeats it.
    """
    notes = tuple(f"{row.number}: {row.worst}" for row in table.rows() if row.example)
    return View(faults_sentence(table), (faults_table(table),), notes, state_of(table))


def faults_page(table: FaultTable) -> str:
    """The table as a Markdown page, with the command that repeats each failed run."""
    head = f"law {table.about['law_sha256'][:16]}, `{table.about['command']}`"
    lines = ["# Fault campaign", "", head, "", table.markdown()]
    lines += ["", "## Failed", ""] if table.failures else []
    for outcome in table.failures:
        lines.append(f"- {outcome.name}: {'; '.join(map(str, outcome.failed))}")
        lines.append(f"  `{repeated(table, outcome)}`")
    return "\n".join(lines) + "\n"


def _study_view(study: Study) -> View:
    verdict, design = study.verdict, study.design
    tables, notes = [verdict_table(verdict)], list(verdict.remarks)
    # What is only good to know fills the report; a terminal gets what may change a
    # decision.
    for finding in (*study.findings, *(design.findings if design else ())):
        notes += (
            [f"{finding.code}: {finding.message}"] if finding.severity != "info" else []
        )
    if study.comparison:
        tables.append(fits_table(study.comparison.fits, brief=True))
        notes += [*coincidence(study.comparison.fits), study.comparison.verdict]
    if design:
        tables.append(requirements_table(design.requirements))
    if study.runs:
        tables.append(moves_table(study.runs))
    return View(verdict_sentence(verdict), tuple(tables), tuple(notes), verdict.state)


# --- real time --------------------------------------------------------------------------------------------


def _realtime_view(run: Any) -> View:
    spreads = (("wake-up latency", run.latencies), ("computing time", run.works))
    rows = tuple(
        (name, *(f"{1e6 * value:.1f}" for value in values)) for name, values in spreads
    )
    headline = (
        f"{len(run.tick)} periods of {1e3 * run.period:g} ms, {run.missed} missed, "
        f"{run.overruns} overruns, {run.lost_samples} lost samples"
    )
    notes = [
        *map(finding_line, run.findings),
        f"scheduling {run.scheduling}, memory {run.memory}",
    ]
    # Bit for bit, or the record is not that of this law: there is no "nearly" to
    # report.
    notes += (
        ["the record replays through the law to the last bit"]
        if run.first_difference is None
        else []
    )
    notes += [] if run.passed else [f"stopped: {run.problem}"]
    table = Table(("time [µs]", "min", "mean", "99.9 %", "max"), rows)
    return View(headline, (table,), tuple(notes), state_of(run))


def _served_view(served: Any) -> View:
    headline = (
        f"periods {len(served.voltage)}, late {served.late}; controllers {served.controllers}, "
        f"left without a stop {served.silences}; messages rejected {served.rejected}"
    )
    return View(headline, state=state_of(served))


def _replay_view(result: Any) -> View:
    if result.passed:
        return View(f"{len(result.mode)} periods agree to the last bit", state="passed")
    where = f"first difference in period {result.first_difference}, largest {result.largest_difference:.3g}"
    return View(where, state="failed")


_VIEWS: dict[str, Callable[[Any], View]] = {
    "tuple": _findings_view,
    "Rig": _rig_view,
    "Experiment": _log_view,
    "Fit": _fit_view,
    "Start": _start_view,
    "Comparison": _comparison_view,
    "JointFit": payloads_view,
    "MotorFit": motor_view,
    "SpectrumFit": spectrum_view,
    "StructureFit": structure_view,
    "Validation": validation_view,
    "DrivenLinkFit": driven_view,
    "Recording": recording_view,
    "FrequencyResponse": response_view,
    "ExperimentDesign": experiment_view,
    "Design": _design_view,
    "Law": _law_view,
    "PidTuning": pid_view,
    "Assessment": _assessment_view,
    "FeasibilityMap": _map_view,
    "Run": _run_view,
    "Certificate": _certificate_view,
    "Summary": _summary_view,
    "FaultTable": _faults_view,
    "Study": _study_view,
    "RealtimeRun": _realtime_view,
    "ServedArm": _served_view,
    "Replay": _replay_view,
    "ShapedMove": shaped_view,
    "Tuning": tuning_view,
    "Watch": watch_view,
    "Tournament": lambda result: View(
        "\n".join(result.verdicts()), state=state_of(result.standings[0])
    ),
}
