"""What people read of each result: a headline with the verdict, tables, then notes.

A result is looked up by the name of its class: importing the classes here would load every package whatever
is shown.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from fraclink._arm.link import structure
from fraclink._law import MODES, REASONS
from fraclink._show.tables import (
    coincidence,
    faults_sentence,
    faults_table,
    fit_table,
    fits_table,
    moves_table,
    requirements_table,
    spread_table,
    verdict_sentence,
    verdict_table,
)
from fraclink._show.text import Row, Table, View, grams, looked_up, number, uncertain

if TYPE_CHECKING:
    from fraclink._campaign import Summary
    from fraclink._campaign.faults import FaultTable
    from fraclink._design import Design
    from fraclink._identify import Comparison, Fit
    from fraclink._simulate import Run
    from fraclink._workflow import Study
    from fraclink.findings import Finding

__all__ = ["view"]


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
    worst = [f.severity for f in findings]
    state = "failed" if "error" in worst else "not shown" if "warning" in worst else "passed"
    counts = [(worst.count(word), word) for word in ("error", "warning", "info") if word in worst]
    said = ", ".join(f"{n} {word}{'s' if n > 1 and word != 'info' else ''}" for n, word in counts)
    return View(said or "no findings", notes=tuple(map(str, findings)), state=state)


def _fit_view(fit: Fit) -> View:
    errors = [f for f in fit.findings if f.severity == "error"]
    share = (
        "nothing held out" if fit.heldout_nmse is None else f"held-out error {100 * fit.heldout_nmse:.2g} %"
    )
    notes = tuple(str(f) for f in fit.findings if f.severity != "info")
    return View(f"{fit.structure}, {share}", (fit_table(fit),), notes, "not shown" if errors else "passed")


def _comparison_view(comparison: Comparison) -> View:
    warned = (
        f"{name}: {finding}"
        for name, fit in comparison.fits.items()
        for finding in fit.findings
        if finding.severity != "info"
    )
    notes = (*coincidence(comparison.fits), *warned)
    return View(comparison.verdict, (fits_table(comparison.fits),), notes)


def _payloads_view(fit: Any) -> View:
    free = structure(fit.structure).free
    rows = tuple(
        (
            grams(m.payload),
            number(m.natural_frequency, 6),
            number(m.order, 5),
            number(m.damping) if "damping" in free else "–",
            number(m.damping_order) if "damping_order" in free else "–",
            number(mse),
            number(alone),
        )
        for m, mse, alone in zip(fit.models, fit.mse, fit.alone_mse, strict=True)
    )
    table = Table(("payload", "ω₀ [s^(−λ/2)]", "λ", "μ", "α", "MSE together", "MSE alone"), rows)
    return View(fit.verdict, (table,))


def _motor_view(fit: Any) -> View:
    errors = fit.standard_errors
    rows: tuple[Row, ...] = (
        ("K/J [rad/(V·s²)]", uncertain(fit.gain, errors["gain"])),
        ("ν/J [1/s]", uncertain(fit.decay, errors["decay"])),
        ("Coulomb friction [V]", uncertain(fit.coulomb_voltage, errors["coulomb_voltage"])),
        ("Coulomb torque [N·m]", number(fit.coulomb_torque)),
        ("dead zone [V]", number(fit.dead_zone)),
        ("delay [ms]", number(1e3 * fit.delay, 3)),
    )
    return View(tables=(Table(("motor", "value"), rows),))


def _spectrum_view(fit: Any) -> View:
    errors = fit.standard_errors
    rows = [("λ", uncertain(fit.order, errors.get("order")))]
    for name, values in (("resonance", fit.resonances), ("anti-resonance", fit.anti_resonances)):
        rows += [
            (f"{name} {i + 1} [rad/s]", uncertain(w, errors.get(f"{name} {i + 1}")))
            for i, w in enumerate(values)
        ]
    delay = uncertain(1e3 * fit.delay, 1e3 * errors["delay"] if "delay" in errors else None)
    rows += [("delay [ms]", delay), ("gain", number(fit.gain)), ("fit [%]", f"{fit.fit:.2f}")]
    aside = (f"{len(fit.outliers)} frequencies set aside as outliers",) if len(fit.outliers) else ()
    return View(tables=(Table(("frequency response", "value"), tuple(rows)),), notes=aside)


def _experiment_view(plan: Any) -> View:
    rows = [("kind", plan.kind), ("amplitude [rad]", number(plan.amplitude, 5))]
    rows += [] if plan.bit is None else [("bit [s]", number(plan.bit, 5))]
    rows += [
        ("band [rad/s]", f"{number(plan.band[0], 3)} to {number(plan.band[1], 3)}"),
        ("duration [s]", number(plan.duration, 5)),
        ("standard error of λ", number(plan.standard_error, 5)),
        ("peak deflection [rad]", number(plan.peak_deflection, 5)),
    ]
    rows += [] if plan.peak_voltage is None else [("peak voltage [V]", number(plan.peak_voltage, 5))]
    return View(tables=(Table(("experiment", "value"), tuple(rows)),))


def _design_view(design: Design) -> View:
    c = design.controller
    filtered = (
        f", filter δ = {number(c.filter_time)} s, n = {c.filter_order}" if c.filter_time else ", no filter"
    )
    headline = f"controller k_d = {number(c.gain, 5)}, β = {number(c.order, 5)}{filtered}"
    notes = tuple(map(str, design.findings))
    state = "passed" if design.passed else "failed"
    return View(headline, (requirements_table(design.requirements),), notes, state)


def _optimised_view(found: Any) -> View:
    figure = "worst noise gain" if found.goal == "noise" else "smallest crossover [rad/s]"
    rows = tuple(
        (
            s.structure,
            "none found in the bounds" if math.isnan(s.value) else number(s.value),
            "taken" * s.taken,
        )
        for s in found.steps
    )
    shown = _design_view(found.design)
    notes = shown.notes
    if not found.pays:
        notes = (f"no structure is better by {100 * found.least:g} %: the closed-form design is kept", *notes)
    return View(shown.headline, (Table(("structure", figure, ""), rows), *shown.tables), notes, shown.state)


def _run_view(run: Run) -> View:
    where = "" if run.verdict.passed else run.verdict.reason
    return View(
        where or "move settled", (moves_table([run]),), (), "passed" if run.verdict.passed else "failed"
    )


def _certificate_view(certificate: Any) -> View:
    text = certificate.verdict.removeprefix("Not certified: ")
    return View(text, state="passed" if certificate.passed else "failed")


def _summary_view(summary: Summary) -> View:
    trips = tuple(f"{count} runs: {MODES[mode]} ({REASONS[reason]})" for mode, reason, count in summary.trips)
    state = "failed" if summary.failure.count else "passed"
    return View(summary.failure.sentence, (spread_table(summary),), trips, state)


def _faults_view(table: FaultTable) -> View:
    rows = faults_table(table)
    short = Table(
        ("fault", "runs", "failed", "verdict"),
        tuple((r[0], r[2], r[3], r[5]) for r in rows.rows),
        judged=True,
    )
    return View(faults_sentence(table), (short,), (), "passed" if table.passed else "failed")


def _study_view(study: Study) -> View:
    verdict = study.verdict
    tables = [verdict_table(verdict)]
    notes = list(verdict.remarks)
    warned = (*study.findings, *(study.design.findings if study.design else ()))
    notes += [f"{finding.code}: {finding.message}" for finding in warned if finding.severity != "info"]
    if study.comparison:
        # The terminal has room for one number a structure; the report shows all.
        shown = fits_table(study.comparison.fits)
        picked = tuple(tuple(row[k] for k in (0, 1, 2, 5, 7, 8)) for row in shown.rows)
        tables.append(Table(tuple(shown.header[k] for k in (0, 1, 2, 5, 7, 8)), picked))
        notes += [*coincidence(study.comparison.fits), study.comparison.verdict]
    if study.design:
        tables.append(requirements_table(study.design.requirements))
    if study.runs:
        tables.append(moves_table(study.runs))
    return View(verdict_sentence(verdict), tuple(tables), tuple(notes), verdict.state)


def _realtime_view(run: Any) -> View:
    spreads = (("latency of the wake-up", run.latencies), ("work of the period", run.works))
    rows = tuple((name, *(f"{1e6 * value:.1f}" for value in values)) for name, values in spreads)
    headline = (
        f"{len(run.tick)} periods of {1e3 * run.period:g} ms, {run.missed} missed, "
        f"{run.overruns} overruns, {run.lost_samples} lost samples"
    )
    notes = [f"scheduling {run.scheduling}, memory {run.memory}"]
    notes += ["the record replays through the law to the last bit"] if run.first_difference is None else []
    notes += [] if run.passed else [f"stopped: {run.problem}"]
    table = Table(("time [µs]", "least", "mean", "99.9 %", "most"), rows)
    return View(headline, (table,), tuple(notes), "passed" if run.passed else "failed")


def _served_view(served: Any) -> View:
    headline = (
        f"{len(served.voltage)} periods, {served.late} late; {served.controllers} controllers, "
        f"{served.silences} of them left without a stop; {served.rejected} messages rejected"
    )
    return View(headline, state="passed" if served.passed else "failed")


def _replay_view(result: Any) -> View:
    if result.passed:
        return View(f"{len(result.mode)} periods agree to the last bit", state="passed")
    where = f"first difference in period {result.first_difference}, largest {result.largest_difference:.3g}"
    return View(where, state="failed")


def _tournament_view(result: Any) -> View:
    return View("\n".join(result.verdicts()), state="passed" if result.standings[0].passed else "failed")


_VIEWS: dict[str, Callable[[Any], View]] = {
    "tuple": _findings_view,
    "Fit": _fit_view,
    "Comparison": _comparison_view,
    "JointFit": _payloads_view,
    "MotorFit": _motor_view,
    "SpectrumFit": _spectrum_view,
    "ExperimentDesign": _experiment_view,
    "Design": _design_view,
    "Optimised": _optimised_view,
    "Run": _run_view,
    "Certificate": _certificate_view,
    "Summary": _summary_view,
    "FaultTable": _faults_view,
    "Study": _study_view,
    "RealtimeRun": _realtime_view,
    "ServedArm": _served_view,
    "Replay": _replay_view,
    "Tournament": _tournament_view,
}
