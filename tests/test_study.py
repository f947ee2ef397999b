"""A study: what each step hands to the next, what ends it, and the verdict in words."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import fraclink as fl
from fraclink._arm.experiment import Experiment
from fraclink._arm.link import STRUCTURES
from fraclink._simulate import MoveVerdict
from fraclink.errors import (
    FieldError,
    FileFormatError,
    InfeasibleError,
    NotConvergedError,
)
from fraclink.findings import Finding, Scope
from fraclink.trials import _stages as stages
from fraclink.trials import _study as study_module
from fraclink.trials._campaign import load_campaign
from fraclink.trials._faults import Case, Check, FaultTable, Outcome
from fraclink.trials._study import Refusal, Study, load_study, save_study
from fraclink.trials._summary import Failure, MetricSummary, Summary
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


def faults(failed: int, passed: int) -> FaultTable:
    outcomes = tuple(
        Outcome(
            Case(f"F{k + 1:02}", 1, 0.03, "mid", 1), (Check("peak", 2.0, 1.0, passed=k >= failed),),
            0.1, 0.1, 0.0, "run", "none", -1,
        )
        for k in range(failed + passed)
    )  # fmt: skip
    return FaultTable(outcomes)


def run(payload: float, *, passed: bool) -> Any:
    verdict = MoveVerdict(passed, "settled" if passed else "not settled; far away")
    return SimpleNamespace(payload=payload, verdict=verdict)


# ── the verdict
# ─────────────────────────────────────────────────────────────────────────────────────────────


def test_a_scope_fails_by_what_ran_and_is_not_run_without() -> None:
    nothing = Study().verdict
    assert [scope.state for scope in nothing.scopes.values()] == ["not run"] * 3
    moves = Study(runs=(run(0.02, passed=True), run(0.04, passed=False))).verdict
    assert moves.model == Scope("failed", ("move at 40 g: not settled; far away",))
    assert Study(runs=(run(0.02, passed=True),)).verdict.model == Scope("passed")
    stopped = Study(stopped="no data", uncertified="the box is too large").verdict
    assert stopped.promise == Scope(
        "failed", ("no data", "not certified: the box is too large")
    )


def test_a_requirement_that_is_missed_is_named_with_both_values() -> None:
    def item(
        name: str, achieved: float, wanted: float, unit: str, *, passed: bool
    ) -> Any:
        return SimpleNamespace(
            name=name, achieved=achieved, wanted=wanted, unit=unit, passed=passed
        )

    requirements = (
        item(
            "phase margin", math.radians(41.23), math.radians(50), "rad", passed=False
        ),
        item("crossover", 11.98765, 12.0, "rad/s", passed=False),
        item("Ms", 1.2345678, 1.2, "", passed=False),
        item("noise", 1.0, 2.0, "V", passed=True),
    )
    made: Any = SimpleNamespace(requirements=requirements, findings=())
    assert Study(design=made).verdict.promise.reasons == (
        "phase margin: 41.2° instead of 50.0°",
        "crossover: 11.99 rad/s instead of 12 rad/s",
        "Ms: 1.235 instead of 1.2",
    )
    kept: Any = SimpleNamespace(requirements=requirements[-1:], findings=())
    assert Study(design=kept).verdict.promise == Scope("passed")


def test_arms_that_fail_are_counted_with_what_they_depend_on() -> None:
    assert Study(arms=summary(0)).verdict.reality == Scope("passed")
    found = Study(arms=summary(15)).verdict.reality
    assert found == Scope(
        "failed",
        ("15 of 1000 arms fail (1.5 %); most depends on payload and motor gain",),
    )
    both = Study(arms=summary(15), faults=faults(2, 3)).verdict.reality
    assert both.reasons[1] == "2 of 5 faults miss their requirement"
    assert Study(faults=faults(0, 3)).verdict.reality == Scope("passed")


def test_an_error_of_log_model_or_design_is_told_once_and_leaves_nothing_shown() -> (
    None
):
    wrong = Finding("W399", "error", "the gauge is reversed", {}, "turn it")
    doubt = Finding("W201", "warning", "short", {}, "record more")
    fit: Any = SimpleNamespace(findings=(wrong, doubt))
    made: Any = SimpleNamespace(findings=(wrong,), requirements=())
    found = Study(design=made, fit=fit, runs=(run(0.02, passed=True),)).verdict
    assert found.promise == Scope(
        "not shown", ("the model: the gauge is reversed. turn it",)
    )
    assert found.model == found.promise and found.reality == found.promise
    own = replace(wrong, message="no margin")
    made = SimpleNamespace(findings=(own,), requirements=())
    assert Study(design=made).verdict.promise.reasons == (
        "the design: no margin. turn it",
    )
    assert Study(findings=(wrong,)).verdict.promise.reasons == (
        "the log: the gauge is reversed. turn it",
    )
    assert Study(findings=(doubt,)).verdict.promise == Scope("not run")
    failed = Study(findings=(wrong,), stopped="no design").verdict.promise
    assert failed == Scope(
        "failed", ("no design", "the log: the gauge is reversed. turn it")
    )


def test_a_simulated_log_is_remarked() -> None:
    assert Study(experiment=log()).verdict.remarks == () and not Study().simulated
    made = Study(experiment=log(notes=(("title", "x"), ("simulated", "true"))))
    assert made.simulated and made.verdict.remarks == (
        "the log is simulated, not measured",
    )


def test_the_fits_are_those_compared_or_the_one_there_is() -> None:
    fit: Any = SimpleNamespace(structure="UD-FOM")
    comparison: Any = SimpleNamespace(fits={"UD-FOM": fit, "D-FOM": None})
    assert Study().fits == {} and Study(fit=fit).fits == {"UD-FOM": fit}
    assert Study(fit=fit, comparison=comparison).fits is comparison.fits


def test_a_refusal_keeps_what_was_asked_for_of_the_nearest() -> None:
    nearest = {"gain_crossover": 11.0, "phase_margin": 0.8, "settling_time": 0.5}
    found = Refusal.of(
        {"gain_crossover": 14, "phase_margin": None, "payloads": (1.0, 2.0)}, nearest
    )
    assert found.nearest == nearest
    assert found.asked == {
        "gain_crossover": 14.0,
        "phase_margin": 0.8,
        "settling_time": 0.5,
    }


# ── the folder
# ──────────────────────────────────────────────────────────────────────────────────────────────


def test_what_was_remarked_comes_back_from_the_folder(tmp_path: Path) -> None:
    finding = Finding("W201", "warning", "short", {"seconds": 2.0}, "record more")
    kept = Study(
        rig=RIG, experiment=log(), findings=(finding,), stopped="no data", uncertified="too large",
        refused=Refusal({"gain_crossover": 14.0}, {"gain_crossover": 11.0}), assumptions=("a payload",),
        faults=faults(1, 1),
    )  # fmt: skip
    save_study(kept, tmp_path / "new")
    names = sorted(path.name for path in (tmp_path / "new").iterdir())
    assert names == ["faults.json", "log.npz", "rig.toml", "study.json"]
    back = load_study(tmp_path / "new")
    for name in (
        "findings",
        "stopped",
        "uncertified",
        "refused",
        "assumptions",
        "faults",
    ):
        assert getattr(back, name) == getattr(kept, name), name
    assert back.rig == RIG
    assert np.array_equal(back.experiment.output, log().output)  # type: ignore[union-attr]
    assert back.verdict == kept.verdict and back.fit is None and back.runs == ()


def test_a_comparison_is_of_all_four_structures_in_their_order() -> None:
    fits: Any = {name: f"fit of {name}" for name in reversed(STRUCTURES)}
    about: Any = SimpleNamespace(
        preferred="D-FOM", contest="contest", verdict="words", undecided=("UD-FOM",)
    )
    found = study_module._comparison(fits, about)
    assert found is not None and list(found.fits.items()) == [
        (name, fits[name]) for name in STRUCTURES
    ]
    assert (found.preferred, found.contest, found.verdict) == (
        "D-FOM",
        "contest",
        "words",
    )
    assert found.undecided == ("UD-FOM",) and found.without_delay == {}
    assert study_module._comparison(fits, None) is None
    assert study_module._comparison({"UD-FOM": fits["UD-FOM"]}, about) is None


def test_a_folder_without_results_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="not a folder"):
        load_study(tmp_path / "nothing")
    (tmp_path / "notes.txt").write_text("x")
    (tmp_path / "other.json").write_text("{}")
    with pytest.raises(FileFormatError, match="without results"):
        load_study(tmp_path)


# ── the steps
# ───────────────────────────────────────────────────────────────────────────────────────────────


class Steps:
    """The steps of `run`, each of which adds what it is for and notes that it ran; any
    may fail.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch, **failing: Exception) -> None:
        self.ran: list[Any] = []
        self.law: Any = "law"
        for name, part in {
            "identified": {"fit": SimpleNamespace(findings=())},
            "designed": {"design": SimpleNamespace(findings=(), requirements=())},
            "moved": {"runs": (run(0.02, passed=True),)},
            "proved": {"certificate": "proof"},
            "tried": {"arms": summary(0)},
        }.items():
            monkeypatch.setattr(stages, name, self._step(name, part, failing.get(name)))

    def _step(self, name: str, part: dict[str, Any], error: Exception | None) -> Any:
        def step(study: Study, *given: Any, **wanted: Any) -> Study:
            self.ran.append((name, *given, *wanted.items()))
            if error is not None:
                raise error
            return replace(
                study, **part, **({"law": self.law} if name == "designed" else {})
            )

        return step


def test_every_step_runs_in_order_and_says_that_it_begins(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    steps, begun = Steps(monkeypatch), []
    study = stages.run(
        RIG,
        log(),
        structure="UD-FOM",
        heldout=0.25,
        certified=True,
        arms=7,
        seed=3,
        begin=begun.append,
        gain_crossover=12.0,
    )
    assert begun == [
        "examining the log",
        "identifying",
        "designing",
        "simulating",
        "proving",
        "trying 7 arms",
    ]
    assert steps.ran == [
        ("identified", "UD-FOM", 0.25),
        ("designed", ("gain_crossover", 12.0)),
        ("moved",),
        ("proved",),
        ("tried", 7, 3, None),
    ]
    assert study.certificate == "proof" and study.stopped is study.uncertified is None
    assert (
        study.findings[: len(RIG.warnings)] == RIG.warnings
        and study.assumptions == RIG.assumptions
    )


def test_proof_and_arms_are_left_out_unless_asked_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    steps = Steps(monkeypatch)
    stages.run(RIG, log(), arms=0)
    assert [name for name, *_ in steps.ran] == ["identified", "designed", "moved"]
    steps = Steps(monkeypatch)
    stages.run(RIG, log())
    assert steps.ran[-1] == ("tried", 1000, 0, None)


def test_a_step_that_fails_ends_the_study_and_is_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    failure = NotConvergedError(
        "fit", reached=1.0, wanted=0.0, remedy="look at the log"
    )
    steps = Steps(monkeypatch, identified=failure)
    study = stages.run(RIG, log())
    assert study.stopped == f"identifying failed: {failure}" and len(steps.ran) == 1
    refused = InfeasibleError(
        "gain_crossover", "too fast", nearest={"gain_crossover": 11.0}
    )
    steps = Steps(monkeypatch, designed=refused)
    study = stages.run(RIG, log(), gain_crossover=14.0)
    assert study.stopped == str(refused) and len(steps.ran) == 2
    assert study.refused == Refusal({"gain_crossover": 14.0}, {"gain_crossover": 11.0})
    steps = Steps(monkeypatch, designed=InfeasibleError("x", "no way"))
    assert stages.run(RIG, log()).refused is None


def test_a_proof_that_fails_does_not_keep_the_arms_from_being_tried(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    failure = NotConvergedError("proof", reached=1.0, wanted=0.0, remedy="narrow it")
    steps = Steps(monkeypatch, proved=failure)
    study = stages.run(RIG, log(), certified=True, arms=5)
    assert study.uncertified == f"proving failed: {failure}" and study.stopped is None
    assert steps.ran[-1][0] == "tried" and study.arms is not None


def test_without_a_law_nothing_moves(monkeypatch: pytest.MonkeyPatch) -> None:
    steps = Steps(monkeypatch)
    steps.law = None
    assert stages.run(RIG, log(), certified=True).runs == ()
    assert [name for name, *_ in steps.ran] == ["identified", "designed"]


def test_a_value_of_the_caller_that_is_wrong_is_raised_and_no_other(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for field in ("gain_crossover", "gain_crossover[0]", "gain_crossover.low"):
        Steps(
            monkeypatch,
            designed=FieldError(field, 1.0, "wrong", allowed="x", remedy="y"),
        )
        with pytest.raises(FieldError, match="wrong"):
            stages.run(RIG, log(), gain_crossover=1.0)
    Steps(
        monkeypatch, designed=FieldError("model", 1.0, "wrong", allowed="x", remedy="y")
    )
    assert "designing failed: model: wrong" in str(
        stages.run(RIG, log(), gain_crossover=1.0).stopped
    )
    with pytest.raises(FieldError, match="structure: unknown"):
        stages.run(RIG, log(), structure="X-FOM")


def test_a_study_is_written_where_it_is_asked_for(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    saved: list[Any] = []
    steps = Steps(monkeypatch)
    monkeypatch.setattr(
        stages, "save_study", lambda study, place: saved.append((study, place))
    )
    study = stages.run(RIG, log(), arms=5, out=tmp_path)
    assert saved == [(study, tmp_path)] and steps.ran[-1] == (
        "tried",
        5,
        0,
        tmp_path / "arms",
    )


@pytest.mark.parametrize(
    ("payloads", "moves"),
    [
        ((0.02, 0.04), [0.02, 0.03, 0.04]),
        ((0.03, 0.04), [0.03, 0.04]),
        ((0.01, 0.02), [0.01, 0.02]),
        ((0.05, 0.05), [0.05]),
    ],
)
def test_moves_are_made_at_both_ends_and_between(
    payloads: tuple[float, float], moves: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        stages, "simulate_move", lambda design, payload, law: (payload, law)
    )
    made: Any = SimpleNamespace(payloads=payloads, rig=RIG)
    study = stages.moved(Study(design=made, law="law"))  # type: ignore[arg-type]
    assert list(study.runs) == [(payload, "law") for payload in moves]


def test_a_proof_is_kept_or_the_reason_why_there_is_none(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made: Any = SimpleNamespace()
    for passed in (True, False):
        found = SimpleNamespace(
            passed=passed, verdict="Not certified: the box is too large."
        )
        monkeypatch.setattr(stages, "certify", lambda design, law, found=found: found)
        study = stages.proved(Study(design=made))
        assert study.certificate == (found if passed else None)
        assert study.uncertified == (None if passed else "the box is too large.")


def test_a_design_needs_a_rig_and_a_model_of_its_link() -> None:
    for study in (Study(), Study(rig=replace(RIG, model=None))):
        with pytest.raises(FieldError, match="model"):
            stages.subject(study)
    assert stages.subject(Study(rig=RIG)) == (RIG, RIG.model, ())
    assert RIG.model is not None
    other = replace(RIG.model, order=1.9)
    made: Any = SimpleNamespace(model=other)
    assert stages.subject(Study(rig=RIG, design=made))[1] is other
    fit: Any = SimpleNamespace(
        model=replace(other, payload=None), loop_model=lambda rig: fit.model
    )
    rig, link, assumed = stages.subject(Study(rig=RIG, design=made, fit=fit))
    assert link.payload == RIG.payloads.nominal and link.order == 1.9
    assert assumed == (
        "the log was made with the nominal payload, 30 g, as none was stated",
    )
    fit.model = replace(other, payload=0.021)
    assert stages.subject(Study(rig=RIG, fit=fit)) == (rig, fit.model, ())
    shown = replace(
        fit.model, stiffness=RIG.link.stiffness
    )  # where the log could not show it
    fit.loop_model = lambda rig: shown if rig is RIG else None
    assert stages.subject(Study(rig=RIG, fit=fit))[1] is shown


def test_a_deflection_log_is_fitted_with_the_rigs_stiffness(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[dict[str, Any]] = []
    doubt = Finding("W110", "warning", "doubtful", {}, "")
    fits: dict[str, Any] = {
        name: SimpleNamespace(model=name, structure=name)
        for name in ("UD-FOM", "D-FOM")
    }
    comparison = SimpleNamespace(fits=fits, preferred="D-FOM")
    monkeypatch.setattr(
        stages,
        "compare_structures",
        lambda log, **given: (asked.append(given), comparison)[1],  # type: ignore[func-returns-value]
    )
    monkeypatch.setattr(stages, "doubts_of", lambda rig, model: (doubt, doubt))
    for kind, stiffness in (("deflection", 1.56), ("torque", None)):
        study = stages.identified(
            Study(rig=RIG, experiment=log(output_kind=kind), findings=(doubt,)),
            None,
            0.3,
        )
        assert asked[-1] == {"stiffness": stiffness, "heldout": 0.3}
        assert study.fit is fits["D-FOM"] and study.findings == (doubt,)
    assert (
        stages.identified(Study(rig=RIG, experiment=log()), "UD-FOM").fit
        is fits["UD-FOM"]
    )


@pytest.mark.slow
def test_a_move_is_what_it_is_asked_to_be() -> None:
    made = fl.design(
        RIG.model,
        RIG,
        payloads=(0.02, 0.04),
        gain_crossover=12.0,
        phase_margin=fl.deg(50),
    )
    law = made.law()
    plain = stages.simulate_move(made, 0.02, law=law)
    assert (
        plain.time[-1] == pytest.approx(4.0) and plain.about["motor_loop"] == "sampled"
    )
    assert plain.reference == pytest.approx(
        fl.smooth_step(1.0, duration=0.5).angle(plain.time)
    )
    quick = stages.simulate_move(
        made,
        0.03,
        law=law,
        amplitude=0.3,
        move_time=0.2,
        duration=1.0,
        inner="ideal",
        gauge_offset=0.05,
    )
    assert quick.about["motor_loop"] == "ideal" and quick.about["gauge_offset"] == 0.05
    assert quick.reference == pytest.approx(
        fl.smooth_step(0.3, duration=0.2).angle(quick.time)
    )
    assert (quick.payload, quick.time[-1]) == (0.03, pytest.approx(1.0))
    held = stages.simulate_move(
        made, 0.03, law=law, reference=fl.extend.hold(0.2), duration=0.1
    )
    assert np.all(held.reference == 0.2)
    bare = replace(law, limits=replace(law.limits, motor_limit=0.1))
    assert (
        np.abs(
            stages.simulate_move(made, 0.03, law=bare, duration=0.5).motor_reference
        ).max()
        <= 0.1
    )


@pytest.mark.slow
def test_arms_are_tried_in_the_folder_that_is_given(tmp_path: Path) -> None:
    made = fl.design(
        RIG.model,
        RIG,
        payloads=(0.02, 0.04),
        gain_crossover=12.0,
        phase_margin=fl.deg(50),
    )
    study = Study(rig=RIG, design=made, law=made.law())
    kept = stages.tried(study, 3, 5, tmp_path / "arms")
    assert kept.arms is not None and kept.arms.failure.runs == 3
    campaign = load_campaign(tmp_path / "arms")
    assert (campaign.runs, campaign.seed, campaign.model) == (3, 5, made.model)
    again = stages.tried(study, 3, 5).arms
    assert again is not None and again.metrics == kept.arms.metrics


def test_arms_that_could_not_be_tried_are_not_run_and_break_no_promise(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    failure = FieldError("period", 0.1, "too long", allowed="< 0.01 s", remedy="-")
    Steps(monkeypatch, tried=failure)
    study = replace(stages.run(RIG, log()), design=None)
    assert study.stopped is None and "too long" in str(study.untried)
    reality = Study(untried=study.untried).verdict.reality
    assert (reality.state, reality.reasons) == ("not run", (study.untried,))


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
    study = stages.run(
        rig,
        record,
        structure=link.structure,
        payloads=(0.020, 0.040),
        gain_crossover=10.5,
        phase_margin=np.radians(50.0),
        arms=50,
    )
    assert study.verdict.passed, study.verdict.reasons
