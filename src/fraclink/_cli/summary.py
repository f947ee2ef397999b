"""Results as text for people and as plain values for machines."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from fraclink._cli.console import table

if TYPE_CHECKING:
    from fraclink._design import Design
    from fraclink._identify import Fit
    from fraclink._simulate import Run
    from fraclink._simulate.metrics import Metrics
    from fraclink._workflow import Study
    from fraclink.findings import Finding

__all__ = [
    "finding_text",
    "finding_values",
    "findings_text",
    "fit_text",
    "fit_values",
    "metrics_values",
    "plan_text",
    "plan_values",
    "run_text",
    "run_values",
    "study_text",
    "study_values",
]


def _finite(value: float | None) -> float | None:
    """JSON has no infinity: a number that is not finite is null."""
    return None if value is None or not math.isfinite(value) else float(value)


def _share(value: float | None) -> str:
    return "none held out" if value is None else f"{value:.4g}"


def _grams(payload: float) -> str:
    return f"{1e3 * payload:g} g"


def finding_values(finding: Finding) -> dict[str, object]:
    """A finding for machines."""
    return {
        "code": finding.code,
        "severity": finding.severity,
        "message": finding.message,
        "evidence": {name: _finite(value) for name, value in finding.evidence.items()},
        "remedy": finding.remedy,
    }


def finding_text(finding: Finding) -> str:
    """A finding for people."""
    return str(finding)


def findings_text(findings: Sequence[Finding]) -> str:
    """Findings that take a verdict away, to append to a result; nothing where there are none."""
    return "".join(f"\n{finding_text(finding)}" for finding in findings)


def fit_values(fit: Fit) -> dict[str, object]:
    """A fit for machines."""
    model = fit.model
    errors: Mapping[str, float] = fit.standard_errors
    return {
        "structure": fit.structure,
        "model": {
            "stiffness": model.stiffness,
            "natural_frequency": model.natural_frequency,
            "order": model.order,
            "damping": model.damping,
            "damping_order": model.damping_order,
            "payload": model.payload,
        },
        "gain": _finite(fit.gain),
        "offset": _finite(fit.offset),
        "delay": _finite(fit.delay),
        "mse": _finite(fit.mse),
        "nmse": _finite(fit.nmse),
        "aic": _finite(fit.aic),
        "bic": _finite(fit.bic),
        "heldout_nmse": _finite(fit.heldout_nmse),
        "standard_errors": {name: _finite(value) for name, value in errors.items()},
    }


def fit_text(fit: Fit) -> str:
    """A fit for people."""
    from fraclink._arm.link import structure
    from fraclink._identify import SYMBOLS

    rows: list[tuple[str, str, str]] = []
    for name in structure(fit.structure).free:
        symbol, unit = SYMBOLS[name]
        error = fit.standard_errors.get(name)
        shown = "" if error is None else f"± {error:.2g}"
        rows.append(
            (
                f"{symbol} {name} {f'[{unit}]' if unit else ''}".strip(),
                f"{getattr(fit.model, name):.6g}",
                shown,
            )
        )
    rows.append(("sensor delay [ms]", f"{1e3 * fit.delay:.4g}", ""))
    rows.append(("gain, offset", f"{fit.gain:.4g}, {fit.offset:.4g}", ""))
    rows.append(("mean squared error", f"{fit.mse:.6g}", ""))
    rows.append(("AIC", f"{fit.aic:.1f}", ""))
    rows.append(("held-out error (NMSE)", _share(fit.heldout_nmse), ""))
    return table((f"{fit.structure}", "value", "error"), rows)


def plan_values(design: Design) -> dict[str, object]:
    """A design for machines."""
    controller = design.controller
    return {
        "passed": design.passed,
        "margins": design.margins_kind,
        "controller": {
            "gain": controller.gain,
            "order": controller.order,
            "filter_time": controller.filter_time,
            "filter_order": controller.filter_order,
        },
        "requirements": [
            {
                "name": item.name,
                "wanted": _finite(item.wanted),
                "achieved": _finite(item.achieved),
                "unit": item.unit,
                "at_payload": _finite(item.at_payload),
                "slack": _finite(item.slack),
                "passed": item.passed,
            }
            for item in design.requirements
        ],
    }


def shown_quantity(value: float, unit: str) -> str:
    """A requirement's value in the unit people read: angles in degrees.

    >>> shown_quantity(0.8726646259971648, "rad"), shown_quantity(12.0, "rad/s")
    ('50°', '12 rad/s')
    """
    return f"{math.degrees(value):.5g}°" if unit == "rad" else f"{value:.5g} {unit}".strip()


def plan_text(design: Design) -> str:
    """A design for people."""

    controller = design.controller
    filtered = (
        f", filter δ = {controller.filter_time:.6g} s, n = {controller.filter_order}"
        if controller.filter_time
        else ", no filter"
    )
    rows = [
        (
            item.name,
            f"{'≤' if item.bound == 'at most' else '≥'} {shown_quantity(item.wanted, item.unit)}",
            shown_quantity(item.achieved, item.unit),
            "" if item.at_payload is None else _grams(item.at_payload),
            "passed" if item.passed else "MISSED",
        )
        for item in design.requirements
    ]
    head = f"controller: k_d = {controller.gain:.6g}, β = {controller.order:.6g}{filtered}"
    return head + "\n" + table(("requirement", "wanted", "achieved", "at", "verdict"), rows)


def run_values(run: Run) -> dict[str, object]:
    """A simulated move for machines."""
    return {
        "payload": run.payload,
        "passed": run.verdict.passed,
        "reason": run.verdict.reason,
        "metrics": metrics_values(run.metrics),
    }


def metrics_values(metrics: Metrics) -> dict[str, float | None]:
    """The metrics of a run for machines; null where one is not finite (it never settles)."""
    names = (
        "overshoot",
        "settling_time",
        "residual_vibration",
        "steady_state_error",
        "peak_voltage",
        "motor_reference_noise",
    )
    return {name: _finite(getattr(metrics, name)) for name in names}


def _run_row(run: Run) -> tuple[str, ...]:
    metrics = run.metrics
    settled = f"{metrics.settling_time:.3f} s" if math.isfinite(metrics.settling_time) else "never"
    return (
        _grams(run.payload),
        f"{100 * metrics.overshoot:.2f} %",
        settled,
        f"{1e3 * metrics.residual_vibration:.3g} mrad",
        f"{1e3 * metrics.steady_state_error:.3g} mrad",
        f"{metrics.peak_voltage:.3g} V",
        "passed" if run.verdict.passed else "FAILS",
    )


_RUN_HEADER = (
    "payload",
    "overshoot",
    "settles in",
    "residual vibration",
    "final error",
    "peak voltage",
    "verdict",
)


def run_text(run: Run) -> str:
    """A simulated move for people."""
    text = table(_RUN_HEADER, [_run_row(run)])
    return text if run.verdict.passed else f"{text}\ndoes not hold: {run.verdict.reason}"


def study_values(study: Study) -> dict[str, object]:
    """A whole study for machines."""
    comparison = study.comparison
    return {
        "passed": study.passed,
        "reasons": list(study.reasons),
        "findings": [finding_values(finding) for finding in study.findings],
        "fits": [fit_values(fit) for fit in comparison.fits.values()] if comparison else [],
        "design": plan_values(study.design) if study.design else None,
        "runs": [run_values(run) for run in study.runs],
        "assumptions": list(study.assumptions),
    }


def study_text(study: Study) -> str:
    """A whole study for people."""
    from fraclink._identify import coincidence_text, frequency_text

    parts: list[str] = []
    designed = study.design.findings if study.design else ()
    warned = [finding for finding in (*study.findings, *designed) if finding.severity != "info"]
    if warned:
        parts.append("\n".join(f"{finding.code}: {finding.message}" for finding in warned))
    if study.comparison:
        rows = [
            (
                name,
                frequency_text(fit),
                f"{fit.model.order:.4f}",
                f"{fit.mse:.4g}",
                f"{fit.aic:.1f}",
                _share(fit.heldout_nmse),
                f"{1e3 * fit.delay:.2f} ms",
            )
            for name, fit in study.comparison.fits.items()
        ]
        parts.append(table(("model", "ω₀", "λ", "MSE", "AIC", "held-out NMSE", "delay"), rows))
        parts.append("\n".join([*coincidence_text(study.comparison.fits), study.comparison.verdict]))
    if study.design:
        parts.append(plan_text(study.design))
    if study.runs:
        parts.append(table(_RUN_HEADER, [_run_row(run) for run in study.runs]))
    # One reason a line, so that none is lost in another.
    reasons = "".join(f"\n  {reason}" for reason in study.reasons)
    parts.append(f"verdict: does not hold{reasons}" if reasons else "verdict: holds")
    return "\n\n".join(parts)
