"""What programs read of each result: JSON in SI units and radians.

A result is looked up by the name of its class, as in the views: importing the classes here would load every
package whatever is written.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from fraclink._show.tables import PARAMETERS
from fraclink._show.text import looked_up

if TYPE_CHECKING:
    from fraclink._campaign import Summary
    from fraclink._campaign.faults import FaultTable
    from fraclink._design import Design, Requirement
    from fraclink._identify import Comparison, Fit
    from fraclink._simulate import Run
    from fraclink._workflow import Study
    from fraclink.findings import Finding

__all__ = ["to_json"]


def to_json(result: Any) -> dict[str, Any]:
    """Return what programs read of a result: plain values in SI units and radians, null where not finite."""
    values: dict[str, Any] = looked_up(_JSON, result)(result)
    return values


def finite(value: float | None) -> float | None:
    """JSON has no infinity: a number that is not finite is null."""
    return None if value is None or not math.isfinite(value) else float(value)


def _finding_json(finding: Finding) -> dict[str, Any]:
    evidence = {name: finite(value) for name, value in finding.evidence.items()}
    return {
        "code": finding.code,
        "severity": finding.severity,
        "message": finding.message,
        "evidence": evidence,
        "remedy": finding.remedy,
    }


def _findings_json(findings: tuple[Finding, ...]) -> dict[str, Any]:
    return {"findings": [_finding_json(finding) for finding in findings]}


def _fit_json(fit: Fit) -> dict[str, Any]:
    names = ("stiffness", *PARAMETERS, "payload")
    numbers = ("gain", "offset", "delay", "mse", "nmse", "aic", "bic", "heldout_nmse")
    return {
        "structure": fit.structure,
        "model": {name: getattr(fit.model, name) for name in names},
        **{name: finite(getattr(fit, name)) for name in numbers},
        "standard_errors": {name: finite(value) for name, value in fit.standard_errors.items()},
        "findings": [_finding_json(finding) for finding in fit.findings],
    }


def _comparison_json(comparison: Comparison) -> dict[str, Any]:
    fits = {name: _fit_json(fit) for name, fit in comparison.fits.items()}
    return {"preferred": comparison.preferred, "verdict": comparison.verdict, "fits": fits}


def _payloads_json(fit: Any) -> dict[str, Any]:
    return {
        "structure": fit.structure,
        "common": list(fit.common),
        "natural_frequencies": [model.natural_frequency for model in fit.models],
        "orders": [model.order for model in fit.models],
        "dampings": [model.damping for model in fit.models],
        "damping_orders": [model.damping_order for model in fit.models],
        "mse": list(fit.mse),
        "standard_errors": fit.standard_errors,
        "stiffness": fit.stiffness,
        "p_value": fit.test.p_value,
        "verdict": fit.verdict,
    }


def _spectrum_json(fit: Any) -> dict[str, Any]:
    return {
        "order": fit.order,
        "resonances": list(fit.resonances),
        "anti_resonances": list(fit.anti_resonances),
        "gain": fit.gain,
        "delay": fit.delay,
        "fit_percent": fit.fit,
        "outliers": [int(k) for k in fit.outliers],
        "standard_errors": fit.standard_errors,
    }


def _experiment_json(plan: Any) -> dict[str, Any]:
    names = ("kind", "amplitude", "bit", "duration", "standard_error", "peak_deflection", "peak_voltage")
    return {name: getattr(plan, name) for name in names} | {"band": list(plan.band)}


def requirement_json(item: Requirement) -> dict[str, Any]:
    """A requirement for programs."""
    names = ("wanted", "achieved", "at_payload", "slack")
    numbers = {name: finite(getattr(item, name)) for name in names}
    return {"name": item.name, "unit": item.unit, "passed": item.passed} | numbers


def _design_json(design: Design) -> dict[str, Any]:
    names = ("gain", "order", "filter_time", "filter_order")
    return {
        "passed": design.passed,
        "margins": design.margins_kind,
        "controller": {name: getattr(design.controller, name) for name in names},
        "requirements": [requirement_json(item) for item in design.requirements],
        "findings": [_finding_json(finding) for finding in design.findings],
    }


def _optimised_json(found: Any) -> dict[str, Any]:
    tried = [{"structure": s.structure, "value": finite(s.value), "taken": s.taken} for s in found.steps]
    return _design_json(found.design) | {"pays": found.pays, "tried": tried}


def _run_json(run: Run) -> dict[str, Any]:
    names = (
        *("overshoot", "settling_time", "residual_vibration", "steady_state_error"),
        *("peak_voltage", "motor_reference_noise"),
    )
    metrics = {name: finite(getattr(run.metrics, name)) for name in names}
    verdict = {"passed": run.verdict.passed, "reason": run.verdict.reason}
    return {"payload": run.payload} | verdict | {"metrics": metrics}


def _certificate_json(certificate: Any) -> dict[str, Any]:
    names = ("passed", "verdict", "payload", "frequency")
    return {name: getattr(certificate, name) for name in names} | {
        "sha256": certificate.sha256 if certificate.passed else None
    }


def _summary_json(summary: Summary) -> dict[str, Any]:
    def limit(x: float) -> float | str:
        return x if math.isfinite(x) else str(x)

    failure = summary.failure
    return {
        "passed": not failure.count,
        "runs": failure.runs,
        "failures": failure.count,
        "probability": [failure.estimate, failure.low, failure.high],
        "trips": [{"mode": m, "reason": r, "runs": c} for m, r, c in summary.trips],
        "failed": list(summary.failed),
        "metrics": {
            m.name: {
                "quantiles": [
                    [q.probability, limit(q.value), limit(q.low), limit(q.high)] for q in m.quantiles
                ],
                "worst": [[n, limit(v)] for n, v in m.worst],
                "drivers": dict(m.drivers),
            }
            for m in summary.metrics
        },
    }


def _faults_json(table: FaultTable) -> dict[str, Any]:
    faults = {row.number: {"runs": row.runs, "failed": row.failed} for row in table.rows()}
    return {"passed": table.passed, "runs": len(table.outcomes), "faults": faults}


def _study_json(study: Study) -> dict[str, Any]:
    verdict = study.verdict
    fits = study.comparison.fits.values() if study.comparison else ()
    return {
        "passed": verdict.passed,
        "verdict": {"state": verdict.state, **asdict(verdict)},
        "reasons": list(verdict.reasons),
        "findings": [_finding_json(finding) for finding in study.findings],
        "fits": [_fit_json(fit) for fit in fits],
        "design": _design_json(study.design) if study.design else None,
        "runs": [_run_json(run) for run in study.runs],
        "arms": _summary_json(study.arms) if study.arms else None,
        "assumptions": list(study.assumptions),
    }


def _realtime_json(run: Any) -> dict[str, Any]:
    def spread(values: Any) -> dict[str, float] | None:
        return None if math.isnan(values.mean) else {name: float(v) for name, v in values._asdict().items()}

    names = ("passed", "problem", "stopped", "missed", "overruns", "lost_samples", "lost_commands")
    return {name: getattr(run, name) for name in (*names, "scheduling", "memory")} | {
        "periods": len(run.tick),
        "latency_s": spread(run.latencies),
        "work_s": spread(run.works),
        "last_mode": int(run.mode[-1]) if len(run.mode) else None,
        "replays": run.first_difference is None,
    }


def _served_json(served: Any) -> dict[str, Any]:
    names = ("passed", "late", "controllers", "silences", "rejected")
    return {name: getattr(served, name) for name in names} | {
        "periods": len(served.voltage),
        "last_tip_angle": float(served.tip_angle[-1]) if len(served.tip_angle) else None,
    }


def _replay_json(result: Any) -> dict[str, Any]:
    return {
        "passed": result.passed,
        "periods": len(result.mode),
        "first_difference": result.first_difference,
        "largest_difference": result.largest_difference,
        "last_mode": int(result.mode[-1]),
    }


_JSON: dict[str, Callable[[Any], dict[str, Any]]] = {
    "tuple": _findings_json,
    "Finding": _finding_json,
    "Fit": _fit_json,
    "Comparison": _comparison_json,
    "JointFit": _payloads_json,
    "MotorFit": asdict,
    "SpectrumFit": _spectrum_json,
    "ExperimentDesign": _experiment_json,
    "Design": _design_json,
    "Optimised": _optimised_json,
    "Run": _run_json,
    "Certificate": _certificate_json,
    "Summary": _summary_json,
    "FaultTable": _faults_json,
    "Study": _study_json,
    "RealtimeRun": _realtime_json,
    "ServedArm": _served_json,
    "Replay": _replay_json,
    "Tournament": lambda result: {"verdicts": list(result.verdicts()), "winners": result.winners()},
}
