"""What programs read of each result: JSON in SI units and radians.

A result is looked up by the name of its class, as in the views: importing the classes
here would load every package whatever is written.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fraclink.view._text import looked_up
from fraclink.view._views import repeated

if TYPE_CHECKING:
    from fraclink.trials._study import Study
    from fraclink.trials._summary import Summary

__all__ = ["plain", "to_json"]


def to_json(result: Any) -> dict[str, Any]:
    """Return what programs read of a result: plain values in SI units and radians, null
    where not finite.
    """
    values: dict[str, Any] = looked_up(_RECORDS, result)(result)
    return values


def plain(value: Any) -> Any:
    """Return `value` as JSON has it: results by their records, other dataclasses by
    their fields.

    >>> plain({"gain": np.float64(1.5), "limit": math.inf, "payloads": (0.02, 0.04)})
    {'gain': 1.5, 'limit': None, 'payloads': [0.02, 0.04]}
    """
    if isinstance(value, float | np.floating):
        # JSON has neither infinity nor NaN; Python's own writer would put words there
        # that no other parser reads.
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.ndarray | np.generic):
        # numpy's scalars are no JSON either; bool and str of numpy come back as
        # Python's own.
        return plain(value.tolist())
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if is_dataclass(value):
        named = {item.name: plain(getattr(value, item.name)) for item in fields(value)}
        return to_json(value) if type(value).__name__ in _RECORDS else named
    return str(value) if isinstance(value, Path) else value


def _attribute(value: Any, path: str) -> Any:
    """The attribute at a dotted path; through a tuple that of every element."""
    for name in path.split("."):
        value = (
            [getattr(item, name) for item in value]
            if isinstance(value, tuple)
            else getattr(value, name)
        )
    return value


def _record(names: str, result: Any) -> dict[str, Any]:
    pairs = (name.partition(":") for name in names.split())
    return {key: plain(_attribute(result, path or key)) for key, _, path in pairs}


def _summary_json(summary: Summary) -> dict[str, Any]:
    def limit(x: float) -> float | str:
        return (
            x if math.isfinite(x) else str(x)
        )  # "inf" is an answer here: the run never settles

    def metric(m: Any) -> dict[str, Any]:
        quantiles = [
            [q.probability, *map(limit, (q.value, q.low, q.high))] for q in m.quantiles
        ]
        return {
            "quantiles": quantiles,
            "worst": [[n, limit(v)] for n, v in m.worst],
            "drivers": dict(m.drivers),
        }

    failure = summary.failure
    return {
        "passed": summary.passed,
        "left_out": summary.left_out,
        "runs": failure.runs,
        "failures": failure.count,
        "probability": [failure.estimate, failure.low, failure.high],
        "trips": [{"mode": m, "reason": r, "runs": c} for m, r, c in summary.trips],
        "failed": list(summary.failed),
        "given": summary.given,
        "metrics": {m.name: metric(m) for m in summary.metrics},
    }


def _study_json(study: Study) -> dict[str, Any]:
    verdict = study.verdict
    parts = {
        "passed": verdict.passed,
        "verdict": {"state": verdict.state, **plain(verdict)},
        "reasons": verdict.reasons,
        "findings": study.findings,
        "fits": list(study.comparison.fits.values()) if study.comparison else [],
    }
    rest = {
        name: getattr(study, name) for name in ("design", "runs", "arms", "assumptions")
    }
    return {name: plain(part) for name, part in (parts | rest).items()}


def _realtime_json(run: Any) -> dict[str, Any]:
    def spread(values: Any) -> dict[str, float] | None:
        return (
            None
            if math.isnan(values.mean)
            else {name: float(v) for name, v in values._asdict().items()}
        )

    names = "passed problem stopped missed overruns lost_samples lost_commands scheduling memory"
    return _record(names, run) | {
        "periods": len(run.tick),
        "latency_s": spread(run.latencies),
        "work_s": spread(run.works),
        "last_mode": int(run.mode[-1]) if len(run.mode) else None,
        "replays": run.first_difference is None,
    }


def _assessment_json(found: Any) -> dict[str, Any]:
    return {
        "phase_budget": {share.element: plain(share.phase) for share in found.budget},
        "phase_margin": {
            curve.kind: plain(curve.phase_margin) for curve in found.curves
        },
    } | _record("payloads spillover:modes", found)


def _faults_json(table: Any) -> dict[str, Any]:
    failures = [
        {
            "name": o.case.name,
            "detail": o.detail,
            "failed": [*map(str, o.failed)],
            "replay": repeated(table, o),
        }
        for o in table.failures
    ]
    faults = {
        row.number: {"runs": row.runs, "failed": row.failed} for row in table.rows()
    }
    return {
        "passed": table.passed,
        "runs": len(table.outcomes),
        "faults": faults,
        "failures": failures,
    }


# Names of attributes; ``key:path`` where the key is another, or the value belongs to a
# part of the result.
_NAMES = {
    "Finding": "code severity message evidence remedy",
    "LinkModel": "stiffness natural_frequency order damping damping_order payload",
    "Fit": "structure model gain offset delay mse nmse aic bic heldout_nmse standard_errors findings",
    "Start": "passed guesses columns findings fit decisions blanks",
    "Comparison": "preferred verdict fits",
    "JointFit": "structure common natural_frequencies:models.natural_frequency orders:models.order "
    "dampings:models.damping damping_orders:models.damping_order mse standard_errors stiffness "
    "p_value:test.p_value verdict",
    "SpectrumFit": "order resonances anti_resonances gain delay fit_percent:fit outliers standard_errors "
    "findings",
    "DrivenLinkFit": "passed output order anti_resonance peak parameters intervals:fit.intervals findings",
    "StructureFit": "passed expression parameters intervals standard_errors at_bound undetermined offset "
    "nmse heldout_nmse findings",
    "LogValidation": "source:log.source payload:log.payload nmse bias frequencies share fit",
    "Validation": "passed verdict nmse spread logs findings",
    "ExperimentDesign": "kind amplitude bit duration standard_error peak_deflection peak_voltage band",
    "Controller": "gain order filter_time filter_order",
    "Requirement": "name unit passed wanted achieved at_payload slack",
    "Design": "passed margins:margins_kind controller requirements findings",
    "FractionalPid": "proportional integral integral_order derivative derivative_order filter_time",
    "PidTuning": "passed controller stable gain_crossover:margins.gain_crossover "
    "phase_margin:margins.phase_margin gain_margin:margins.gain_margin "
    "sensitivity_peak:margins.sensitivity_peak itae horizon findings",
    "Metrics": "overshoot settling_time residual_vibration steady_state_error peak_voltage "
    "motor_reference_noise",
    "Measured": "name duration predicted settling_time largest_error residual_vibration peak_voltage limited",
    "ShapedMove": "passed amplitude payloads told voltage kept_back reserve duration:reference.duration "
    "settling_time measured findings",
    "Run": "payload passed:verdict.passed reason:verdict.reason metrics",
}

_RECORDS: dict[str, Callable[[Any], dict[str, Any]]] = {
    **{name: partial(_record, names) for name, names in _NAMES.items()},
    "tuple": lambda findings: {"findings": plain(findings)},
    "MotorFit": lambda fit: {
        item.name: plain(getattr(fit, item.name)) for item in fields(fit)
    },
    "Certificate": lambda certificate: (
        _record("passed verdict payload frequency", certificate)
        | {"sha256": certificate.sha256 if certificate.passed else None}
    ),
    "FeasibilityMap": lambda found: {"feasible": float(np.mean(found.feasible))},
    "Assessment": _assessment_json,
    "Summary": _summary_json,
    "FaultTable": _faults_json,
    "Study": _study_json,
    "RealtimeRun": _realtime_json,
    "ServedArm": lambda served: (
        _record("passed late controllers silences rejected", served)
        | {
            "periods": len(served.voltage),
            "last_tip_angle": float(served.tip_angle[-1])
            if len(served.tip_angle)
            else None,
        }
    ),
    "Replay": lambda result: (
        _record("passed first_difference largest_difference", result)
        | {"periods": len(result.mode), "last_mode": int(result.mode[-1])}
    ),
    "Tournament": lambda result: {
        "verdicts": list(result.verdicts()),
        "winners": result.winners(),
    },
}
