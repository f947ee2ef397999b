"""A study: the results passed from step to step, what ends it, and the verdict in
words.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import fraclink as fl
from fraclink import Experiment
from fraclink.errors import (
    FileFormatError,
)
from fraclink.findings import Finding, Scope
from fraclink.trials import (
    Case,
    Check,
    FaultTable,
    Outcome,
    Study,
    Summary,
    load_study,
    save_study,
)
from fraclink.trials._study import Refusal
from fraclink.trials._summary import Failure, MetricSummary
from identify_cases import made_log

RIG = fl.Rig.named("paper-2023")


def log(**own: Any) -> Experiment:
    time = 0.004 * np.arange(60)
    return Experiment(
        period=0.004, motor_angle=np.sin(time), output=np.cos(time), **own
    )


def summary(failed: int, runs: int = 1000) -> Summary:
    drivers = (("payload", 0.9), ("motor_gain", -0.4), ("noise", 0.1))
    metric = MetricSummary("settling_time", (), (), drivers)
    other = MetricSummary("overshoot", (), (), tuple(reversed(drivers)))
    return Summary(
        Failure(failed, runs, failed / runs, 0.0, 0.1), (), (other, metric), ()
    )


def arms(failed: int) -> Any:
    """Runs of which so many failed."""
    return SimpleNamespace(summary=summary(failed))


def faults(failed: int, passed: int) -> FaultTable:
    outcomes = tuple(
        Outcome(
            Case(f"F{k + 1:02}", 1, 0.03, "mid", 1), (Check("peak", 2.0, 1.0, passed=k >= failed),),
            0.1, 0.1, 0.0, "run", "none", -1,
        )
        for k in range(failed + passed)
    )  # fmt: skip
    return FaultTable(outcomes)


# --- the verdict ----------------------------------------------------------------------


def test_arms_that_fail_are_counted_with_what_they_depend_on() -> None:
    assert Study(arms=arms(0)).verdict.twin == Scope("passed")
    found = Study(arms=arms(15)).verdict.twin
    assert found == Scope(
        "failed",
        ("15 of 1000 arms fail (1.5 %); most depends on payload and motor gain",),
    )
    both = Study(arms=arms(15), faults=faults(2, 3)).verdict.twin
    assert both.reasons[1] == "2 of 5 faults miss their requirement"
    assert Study(faults=faults(0, 3)).verdict.twin == Scope("passed")


def test_a_simulated_log_is_remarked() -> None:
    assert Study(experiment=log()).verdict.remarks == () and not Study().simulated
    made = Study(experiment=log(notes=(("title", "x"), ("simulated", "true"))))
    assert made.simulated and made.verdict.remarks == (
        "the log is simulated, not measured",
    )


# --- the folder -----------------------------------------------------------------------


def test_what_was_remarked_comes_back_from_the_folder(tmp_path: Path) -> None:
    finding = Finding("W205", "warning", "short", {"seconds": 2.0}, "record more")
    kept = Study(
        rig=RIG, experiment=log(), findings=(finding,), missing={"design": "no data", "certificate": "too large"},
        refused=Refusal({"gain_crossover": 14.0}, {"gain_crossover": 11.0}), assumptions=("a payload",),
        faults=faults(1, 1),
    )  # fmt: skip
    save_study(kept, tmp_path / "new")
    names = sorted(path.name for path in (tmp_path / "new").iterdir())
    assert names == ["faults.json", "log.npz", "rig.toml", "study.json"]
    back = load_study(tmp_path / "new")
    for name in (
        "findings",
        "missing",
        "refused",
        "assumptions",
        "faults",
    ):
        assert getattr(back, name) == getattr(kept, name), name
    assert back.rig == RIG
    assert np.array_equal(back.experiment.output, log().output)  # type: ignore[union-attr]
    assert back.verdict == kept.verdict and back.fit is None and back.runs == ()


def test_a_folder_without_results_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="not a folder"):
        load_study(tmp_path / "nothing")
    (tmp_path / "notes.txt").write_text("x")
    (tmp_path / "other.json").write_text("{}")
    with pytest.raises(FileFormatError, match="without results"):
        load_study(tmp_path)


@pytest.mark.parametrize("name", ["design.json", "run-20g.npz"])
@pytest.mark.parametrize("content", [b"", b"{", b"PK\x03\x04half"])
def test_a_damaged_file_is_named_and_not_left_out(
    name: str, content: bytes, tmp_path: Path
) -> None:
    save_study(Study(rig=RIG, experiment=log()), tmp_path)
    (tmp_path / "other.json").write_text('{"not": "of fraclink"}')
    np.savez(tmp_path / "other.npz", values=np.zeros(3))
    assert load_study(tmp_path).rig == RIG
    (tmp_path / name).write_bytes(content)
    with pytest.raises(FileFormatError, match=name):
        load_study(tmp_path)


# --- the steps ------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("damping", "damping_order", "delay"), [(1.0, 1.0, 0.004), (1.2, 0.85, 0.010)]
)
def test_an_ordinarily_damped_arm_passes(
    damping: float, damping_order: float, delay: float
) -> None:
    rig = fl.Rig.named("paper-2023-geared")
    assert rig.model is not None
    link = replace(rig.model, order=2.0, damping=damping, damping_order=damping_order)
    record = made_log(link, noise=0.003, delay=delay, payload=0.030)
    study = fl.trials.run(
        rig,
        record,
        structure=link.structure,
        payloads=(0.020, 0.040),
        gain_crossover=10.0,
        phase_margin=np.radians(50.0),
        arms=50,
    )
    assert study.verdict.passed, study.verdict.reasons
    # a payload may be told to the law that ships: those moves are judged too
    assert sum(bool(run.about["payload_given"]) for run in study.twins) == 3


@pytest.mark.slow
def test_a_model_that_contradicts_its_rig_is_moved_and_has_no_twin() -> None:
    geared = fl.Rig.named("paper-2023-geared")
    record = fl.read_log(fl.bundled_log("pulse_30g"), rig=geared)
    # 34 % in the resonance: too far for the beam of the rig, too near for a doubt
    stiff = replace(geared.link, stiffness=1.8 * geared.link.stiffness)
    asked = {"gain_crossover": 11.0, "phase_margin": fl.deg(40)}
    study = fl.trials.run(
        replace(geared, link=stiff), record, arms=0, payloads=(0.020, 0.040), **asked
    )
    assert study.design is not None and len(study.runs) == 3 and not study.twins
    assert study.verdict.model.state == "passed"
    assert study.verdict.twin.state == "not run"
    assert "natural_frequency" in study.verdict.twin.reasons[0]
