"""Files as release 0.1 wrote them: every later release must read them, and find in them
what stood there.

The folder `formats` is never written again: a new format adds a file.
design-format-1.json is a design from before controllers had a lead. Results without a
reader (comparison, assessment, design map) are not here.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

import fraclink as fl
from fraclink._certify import Certificate
from fraclink._export import Proof
from fraclink._identify import load_model
from fraclink.lab._arm import ServedArm
from fraclink.lab._run import RealtimeRun
from fraclink.trials._campaign import load_campaign
from fraclink.trials._run import read_part
from fraclink.trials._study import load_study

FOLDER = Path(__file__).resolve().parent / "formats"
LINK = (
    "stiffness",
    "natural_frequency",
    "order",
    "damping",
    "damping_order",
    "payload",
)

Found = dict[str, Any]


def _named(thing: object, *names: str) -> Found:
    return {name: getattr(thing, name) for name in names}


def _sums(thing: object, *names: str) -> Found:
    """Length, sum and last value of every signal."""
    signals = {name: np.asarray(getattr(thing, name), dtype=float) for name in names}
    return {name: [len(x), float(x.sum()), float(x[-1])] for name, x in signals.items()}


def rigs() -> Found:
    """Rigs of the schema that users write by hand, and the one that the package wrote."""
    found: Found = {}
    for path in (FOLDER / "rig-by-hand.toml", FOLDER / "study" / "rig.toml"):
        rig = fl.Rig.load(path)
        motor = _named(
            rig.motor, "inertia", "viscous_friction", "torque_constant", "gear_ratio"
        )
        link = _named(rig.link, "length", "flexural_rigidity", "stiffness", "mass")
        span = _named(rig.payloads, "low", "high", "nominal")
        sensors = _named(rig.gauge, "noise", "offset", "limit", "quantum")
        sensors["counts"] = rig.encoder.counts_per_revolution
        rest = {"name": rig.name, "period": rig.period, "assumptions": rig.assumptions}
        model = None if rig.model is None else _named(rig.model, *LINK)
        found[path.name] = motor | link | span | sensors | rest | {"model": model}
    return found


def _plan(plan: fl.Design) -> Found:
    return {
        **_named(
            plan.controller, "gain", "order", "filter_time", "filter_order", "period"
        ),
        **_named(
            plan,
            "gain_crossover",
            "phase_margin",
            "chi",
            "payloads",
            "natural_frequencies",
            "passed",
        ),
        "rig": plan.rig.name,
        "model": _named(plan.model, *LINK),
        "requirements": [
            [r.name, r.wanted, r.achieved, r.passed] for r in plan.requirements
        ],
        "findings": [finding.code for finding in plan.findings],
    }


def designs() -> Found:
    """Designs of both formats, links and laws."""
    files = ("design-format-1.json", "study/design.json")
    found: Found = {name: _plan(fl.Design.load(FOLDER / name)) for name in files}
    for name in ("law-single.json", "law-no-motor.json", "study/law.json"):
        law = fl.Law.load(FOLDER / name)
        about = _named(
            law,
            "digest",
            "precision",
            "period",
            "stiffness",
            "order",
            "correction_error",
        )
        found[name] = about | {"drive": law.drive is not None}
    for name in ("model.json", "study/model.json"):
        found[name] = _named(load_model(FOLDER / name), *LINK)
    return found


def study() -> Found:
    """A whole folder of results."""
    got = load_study(FOLDER / "study")
    old = Certificate.load(FOLDER / "study" / "certificate.json")
    assert got.experiment is not None and got.comparison is not None
    assert got.faults is not None and got.fit is not None
    return {
        "log": _named(
            got.experiment, "period", "payload", "source", "notes", "output_kind"
        )
        | _sums(got.experiment, "motor_angle", "output"),
        "fits": {
            name: _named(fit, "gain", "offset", "delay", "mse", "aic", "converged")
            | _named(fit.model, *LINK)
            | {"standard_errors": fit.standard_errors}
            | _sums(fit, "predicted", "residual")
            for name, fit in got.fits.items()
        },
        "chosen": got.fit.structure,
        "preferred": got.comparison.preferred,
        "findings": [[finding.code, finding.severity] for finding in got.findings],
        "certificate": _named(old, "passed", "leaves", "verdict")
        | _named(
            old.statement,
            "modulus",
            "payload_low",
            "payload_high",
            "delay_high",
            "digest",
        ),
        "uncertified": got.uncertified,
        "runs": [_run(run) for run in got.runs],
        "assumptions": got.assumptions,
        "faults": {
            outcome.case.name: [
                outcome.passed,
                outcome.mode,
                outcome.peak,
                outcome.reacted,
            ]
            for outcome in got.faults.outcomes
        },
        "about_faults": got.faults.about,
    }


def _run(run: fl.Run) -> Found:
    return (
        _named(
            run.metrics,
            "overshoot",
            "settling_time",
            "peak_voltage",
            "steady_state_error",
        )
        | {
            "passed": run.verdict.passed,
            "payload": run.payload,
            "seed": run.about["seed"],
        }
        | _sums(
            run,
            "time",
            "reference",
            "tip_angle",
            "motor_angle",
            "torque",
            "voltage",
            "flags",
            "mode",
        )
    )


def runs() -> Found:
    """Runs of the twin, in real time, of a served arm, and a log as CSV."""
    twin, live = (
        fl.Run.load(FOLDER / "twin-run.npz"),
        fl.load(FOLDER / "realtime-run.npz", RealtimeRun),
    )
    arm = fl.load(FOLDER / "served-arm.npz", ServedArm)
    log = fl.read_log(FOLDER / "log.csv")
    law = fl.Law.load(FOLDER / "study" / "law.json")
    return {
        "twin": _sums(
            twin,
            "time",
            "tip_angle",
            "motor_angle",
            "torque_measured",
            "voltage",
            "mode",
        )
        | _sums(SimpleNamespace(**twin.extras), "payload")
        | {
            "finished": twin.finished,
            "overshoot": twin.metrics.overshoot,
            "about": twin.about,
        },
        "real time": _sums(
            live,
            "time",
            "latency",
            "work",
            "motor_angle",
            "voltage",
            "tick",
            "mode",
            "flags",
        )
        | _named(
            live,
            "period",
            "connection",
            "stopped",
            "lost_commands",
            "origin",
            "passed",
            "missed",
        )
        | {"difference": live.difference(law)},
        "served arm": _sums(arm, "tip_angle", "voltage", "connected")
        | _named(
            arm, "period", "late", "controllers", "silences", "rejected", "scheduling"
        ),
        "log": _named(log, "period", "payload", "notes")
        | _sums(log, "motor_angle", "output"),
    }


def campaigns() -> Found:
    """A campaign's folder with one part, a proof."""
    campaign = load_campaign(FOLDER / "campaign")
    part = read_part(campaign, FOLDER / "campaign", 0)
    assert part is not None
    proof = Proof.load(FOLDER / "proof.json")
    return {
        "campaign": _named(
            campaign, "runs", "seed", "motor_loop", "duration", "fingerprint"
        ),
        "part": {name: float(np.sum(values)) for name, values in part.items()},
        "proof": {
            claim.name: [claim.statement, claim.status, claim.tools, claim.logs]
            for claim in proof.claims
        }
        | {"law": proof.law, "sources": proof.sources},
    }


def formats() -> dict[str, Callable[[], Found]]:
    """What is read from every file."""
    return {
        "rigs": rigs,
        "designs": designs,
        "study": study,
        "runs": runs,
        "campaigns": campaigns,
    }
