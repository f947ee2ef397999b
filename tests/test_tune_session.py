"""What a tuning keeps, says and repeats; what a watch calls a change: the rules around
the stages.
"""

from __future__ import annotations

import math
import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import fraclink as fl
import fracsys
from fraclink import _kernels
from fraclink.errors import FieldError, FraclinkError, LogError
from fraclink.findings import Scope
from fraclink.lab import _tune as tuning
from fraclink.lab import _tune_link as linking
from fraclink.lab import _watch as watching
from fraclink.lab._tune import _lateness, _resumed, _Session, _worth_repeating
from fraclink.lab._tune_build import Built
from fraclink.lab._tune_guard import LimitReached, Record
from fraclink.lab._tune_link import LinkResult
from fraclink.lab._tune_motion import LawTripped
from fraclink.lab._tune_moves import FirstMove
from fraclink.lab._tune_wiring import Wiring
from fraclink.lab._watch import Change, Watch, _moving_time
from tuned_arms import LIMITS, RIG, arm

if not _kernels.REALTIME:
    pytest.skip("the real-time loop is Linux's", allow_module_level=True)

PLAN = fl.TuningPlan(LIMITS, payload=0.030, period=0.004)
WIRING = Wiring(
    60.0, 0.1, 0.004, 1.6, 12.0, 0.001, 1e-4, 0.01, 1e-3, 0.4, 0.02, ("a", "b")
)
MOVE = FirstMove(0.3, 0.5, 0.6, 0.62, *(0.001,) * 7, payload=0.030)
STATE = fl.lab.Tuning(LIMITS, 0.030, (0.0225, 0.04), 0.004)


class Guard:
    """A guard that moves nothing and counts its releases."""

    period, lost = 0.004, 0

    def __init__(self, count: int = 1000) -> None:
        self.count, self.released, self.learned = count, 0, []  # type: ignore[var-annotated]

    def release(self) -> None:
        self.released += 1

    def learn(self, gain: float, delay: float) -> None:
        self.learned.append((gain, delay))

    def record(self) -> Record:
        return Record(self.period, *np.arange(3.0 * self.count).reshape(3, -1))


@pytest.fixture
def session(tmp_path: Path) -> _Session:
    """A session in an empty folder, of which every line that it says is kept in `said`."""
    said: list[str] = []
    made = _Session(None, PLAN, tmp_path / "arm", True, said.append, "none", None)  # type: ignore[arg-type]
    made.out.mkdir()
    made.state = replace(STATE, folder=str(made.out))
    made.said = said  # type: ignore[attr-defined]
    return made


# --- what is resumed -------------------------------------------------------------------------------------


def test_a_tuning_goes_on_with_its_payload_or_moves_its_law_with_another(
    tmp_path: Path,
) -> None:
    def resumed(payload: float, **changes: Any) -> float:
        fl.save(replace(STATE, **changes), tmp_path / "tuning.json", force=True)
        plan = fl.TuningPlan(LIMITS, payload, (0.001, 1.0))
        return _resumed(tmp_path, plan).payload

    law = {"certified": "stable", "design_passed": True}
    assert resumed(0.030) == 0.030
    for payload in (0.0225, 0.035, 0.04):
        assert resumed(payload, **law) == 0.030
    for payload in (0.0224, 0.0401):
        with pytest.raises(
            FieldError,
            match=r"expected 0\.03 kg, as before, or 0\.0225 to 0\.04 kg to move",
        ):
            resumed(payload, **law)
    with pytest.raises(
        FieldError, match=r"\(got 0\.035\); expected 0\.03 kg, as before\. "
    ):
        resumed(0.035)
    (tmp_path / "tuning.json").unlink()
    with pytest.raises(FieldError, match="nothing to resume"):
        _resumed(tmp_path, PLAN)


@pytest.mark.parametrize(
    ("change", "refused"),
    [
        ({}, ""),
        ({"gain": 60.0 * 1.34}, ""),
        ({"gain": 60.0 * 1.36}, "gain was 60 and is 81.6"),
        ({"gain": 60.0 * 0.64}, "gain"),
        ({"stiffness": 1.6 * 1.36}, "stiffness"),
        ({"natural_frequency": 12.0 * 1.36}, "natural_frequency"),
        ({"friction": 9.0, "delay": 0.1}, ""),
    ],
)
def test_another_arm_is_not_gone_on_with(
    session: _Session, change: dict[str, float], refused: str
) -> None:
    now = replace(WIRING, **change)
    session._same_arm(now)  # nothing is known yet
    session.state = replace(session.state, wiring=WIRING)
    if not refused:
        session._same_arm(now)
        return
    with pytest.raises(FraclinkError, match=refused):
        session._same_arm(now)
    session.plan = replace(
        PLAN, payload=0.035
    )  # another payload moves ω₀, and nothing else
    if refused == "natural_frequency":
        session._same_arm(now)
    else:
        with pytest.raises(FraclinkError, match=refused):
            session._same_arm(now)


# --- what is repeated ------------------------------------------------------------------------------------


def link(short: float, *, passed: bool = True) -> Any:
    """A link whose λ is known `short` times too badly."""
    fit = SimpleNamespace(
        passed=passed, model=RIG.model, gain=1.0, standard_errors={"order": 0.006 * short},
        save=lambda place: Path(place).write_text("model"),
    )  # fmt: skip
    return LinkResult(fit, SimpleNamespace(), ((0.1, 8.0, 0.001),))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("short", "passed", "design", "worth"),
    [
        (1.9, True, None, False),
        (2.1, True, None, True),
        (2.1, True, "made", True),
        (0.5, False, None, True),
        (0.5, False, "made", False),
        (0.5, True, None, False),
    ],
)
def test_an_experiment_is_repeated_where_a_longer_one_can_help(
    short: float, passed: bool, design: Any, worth: bool
) -> None:
    built = Built(RIG, design, None, None, ("why",))
    assert _worth_repeating(built, link(short, passed=passed)) is worth


def built(*reasons: str) -> Any:
    rig = SimpleNamespace(save=lambda place: Path(place).write_text("rig"))
    part = lambda word: SimpleNamespace(  # noqa: E731
        save=lambda place: Path(place).write_text(word),
        passed=not reasons,
        verdict="stable",
    )
    return Built(
        rig, part("design"), part("law"), part("certificate"), reasons, ("assumed",)
    )  # type: ignore[arg-type]


def linked(
    session: _Session,
    monkeypatch: pytest.MonkeyPatch,
    laws: list[list[Any]],
    shorts: list[float],
    count: int = 1000,
) -> tuple[list[float], Any]:
    """Run the link's stage with these laws and errors; returns how much longer each
    experiment was.
    """
    longer: list[float] = []
    errors, made = iter(shorts), iter(laws)

    def tuned(guard: Any, *_: Any, longer: float, **__: Any) -> Any:
        asked.append(longer)
        return link(next(errors)), None

    asked = longer
    monkeypatch.setattr(tuning, "tune_link", tuned)
    monkeypatch.setattr(
        tuning,
        "measured_rig",
        lambda *_, **__: SimpleNamespace(save=lambda place: None),
    )
    monkeypatch.setattr(tuning, "built_laws", lambda *_: iter(next(made)))
    monkeypatch.setattr(tuning, "save", lambda *_, **__: None)
    session.state = replace(session.state, wiring=WIRING, motor=SimpleNamespace())  # type: ignore[arg-type]
    return longer, session._link(Guard(count), None)  # type: ignore[arg-type]


def test_an_experiment_that_fails_is_made_twice_as_long_and_three_times_at_most(
    session: _Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    longer, (_, last, rest) = linked(
        session,
        monkeypatch,
        [[built("no law")], [built("still none")], [built("none")]],
        [3.0, 3.0, 3.0],
    )
    assert longer == [1.0, 2.0, 2.0] and last.reasons == ("none",) and list(rest) == []
    assert session.state.attempts == 3 and session.state.reasons == ("none",)
    said = [word for word in session.said if not word.startswith(" ")]  # type: ignore[attr-defined]
    assert said == [
        "link", "design, proof and law", "no law; the next experiment is twice as long",
        "link, experiment 2", "design, proof and law", "still none; the next experiment is twice as long",
        "link, experiment 3", "design, proof and law",
    ]  # fmt: skip


def test_an_experiment_that_suffices_or_tires_is_not_repeated(
    session: _Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    longer, (_, last, rest) = linked(
        session, monkeypatch, [[built(), built("second")]], [3.0]
    )
    assert longer == [1.0] and last.passed and len(list(rest)) == 1
    assert session.state.has_law and session.state.design_words == "assumed"
    session.state = replace(session.state, link=link(1.5))
    assert (
        linked(session, monkeypatch, [[built("no law")]], [])[0] == []
    )  # the link is there: it is used
    session.state = replace(session.state, link=None, attempts=0)
    # 75 s of motion, and the next experiment takes twice 8 s: more than a minute and a
    # half
    assert linked(
        session, monkeypatch, [[built("no law")]], [3.0], count=round(75.0 / 0.004)
    )[0] == [1.0]
    session.state = replace(
        session.state, link=None, attempts=0, refused=1, reasons=("it was refused",)
    )
    longer, (_, last, _) = linked(session, monkeypatch, [[built()], [built()]], [0.5])
    assert (
        last.reasons == ("it was refused",) and not last.passed
    )  # the only one has been refused before


def test_what_came_of_a_model_is_written_and_what_failed_is_not_left(
    session: _Session,
) -> None:
    session._wrote(built(), link(0.5))
    names = {
        "rig.toml": "rig",
        "model.json": "model",
        "design.json": "design",
        "law.json": "law",
    }
    assert {name: (session.out / name).read_text() for name in names} == names
    assert (session.out / "certificate.json").read_text() == "certificate"
    assert (
        session.state.certified == "stable"
        and session.state.design_passed
        and session.state.moves == ()
    )
    session.state = replace(session.state, moves=(MOVE,))
    session._wrote(built("it rings"), link(0.5))
    assert [
        name
        for name in ("design.json", "law.json", "certificate.json")
        if (session.out / name).exists()
    ] == []
    assert (session.out / "rig.toml").exists() and (session.out / "model.json").exists()
    assert (
        session.state.certified == ""
        and not session.state.design_passed
        and session.state.moves == ()
    )
    assert fl.load(session.out / "tuning.json").reasons == ("it rings",)
    assert session.said == ["  assumed", "  it rings"]  # type: ignore[attr-defined]


# --- the first moves -------------------------------------------------------------------------------------


def test_laws_are_moved_with_until_one_is_kept_and_three_at_most(
    session: _Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers: list[str] = []
    monkeypatch.setattr(_Session, "_refusal", lambda self, guard, made: answers.pop(0))
    wrote: list[Any] = []
    monkeypatch.setattr(_Session, "_wrote", lambda self, made, link: wrote.append(made))
    laws = [built() for _ in range(5)]
    for name in tuning.LAW_FILES:
        (session.out / name).write_text("x")
    answers[:] = ["too slow", ""]
    session._move(Guard(), link(0.5), iter(laws))  # type: ignore[arg-type]
    assert wrote == [laws[1]] and session.state.refused == 1
    assert not any((session.out / name).exists() for name in tuning.LAW_FILES)
    assert session.said == ["the arm refused that law, which is withheld; the next one"]  # type: ignore[attr-defined]
    answers[:] = ["a", "b", "c", "d"]
    session._move(Guard(), link(0.5), iter(laws))  # type: ignore[arg-type]
    assert answers == ["d"] and session.state.refused == 4
    assert session.state.reasons == ("the arm's own moves fail: c",)
    assert fl.load(session.out / "tuning.json").refused == 4


def test_a_law_is_refused_by_a_trip_a_limit_or_a_broken_promise(
    session: _Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    session.state = replace(
        session.state, motor="motor", certified="stable", design_passed=True,
        moves=(replace(MOVE, payload=0.025), MOVE),
    )  # type: ignore[arg-type]  # fmt: skip
    answer: Any = (replace(MOVE, measured_settling=0.63),)

    def moved(*_: Any) -> Any:
        if isinstance(answer, Exception):
            raise answer
        return answer

    monkeypatch.setattr(tuning, "first_moves", moved)
    monkeypatch.setattr(tuning, "save", lambda *_, **__: None)
    guard: Any = Guard()
    assert session._refusal(guard, built()) == ""
    assert [move.payload for move in session.state.moves] == [
        0.025,
        0.030,
    ]  # that of the other payload stays
    assert session.state.moves[1].measured_settling == 0.63 and guard.released == 1
    answer = (replace(MOVE, measured_settling=0.9),)
    assert session._refusal(guard, built()).startswith(
        "17.2° in 0.5 s with 30 g: promised 0.60 s, measured 0.90"
    )
    answer = LawTripped("the law went to mode off: encoder; the drive is off")
    assert session._refusal(guard, built()) == str(answer)
    answer = LimitReached("speed: too fast")
    with pytest.raises(LimitReached):
        session._refusal(guard, built())
    assert guard.released == 4 and session.state.refused == 1
    assert session.state.reasons == ("the arm's own moves fail: speed: too fast",)


# --- what is kept ----------------------------------------------------------------------------------------


def test_a_tuning_that_goes_on_keeps_the_records_of_before(session: _Session) -> None:
    (session.out / "log.npz").write_text("old")
    session.keep(Guard(2000))  # type: ignore[arg-type]
    log = fl.load(session.out / "log.npz")
    assert log.payload == 0.030 and log.period == 0.004 and log.motor_angle.size == 2000
    assert (
        log.source == "fraclink tune"
        and log.output[0] != log.motor_angle[0] != log.voltage[0]
    )
    assert session.state.arm_time == 8.0 and session.state.computing >= 0.0
    session.before = STATE
    for number in (2, 3):
        session.keep(Guard(10))  # type: ignore[arg-type]
        assert fl.load(session.out / f"log-{number}.npz").motor_angle.size == 10
    session.keep(Guard(1))  # type: ignore[arg-type]
    assert not (session.out / "log-4.npz").exists()


def test_samples_that_came_late_are_said_where_they_were_many() -> None:
    for lost, said in (
        (10, ""),
        (11, " (of 1000 samples 11 did not come in time: this machine, or"),
    ):
        guard: Any = SimpleNamespace(lost=lost, count=1000, period=0.004)
        assert _lateness(guard).startswith(said) and bool(_lateness(guard)) == bool(
            said
        )
    assert "too busy for a period of 4 ms" in _lateness(guard)


def test_a_plan_says_each_stage_with_its_numbers() -> None:
    limits = fl.MotionLimits(
        angle=math.radians(50.0), speed=2.5, torque=1.5, voltage=9.0
    )
    lines = fl.TuningPlan(limits, 0.030).text.splitlines()
    assert (
        lines[1]
        == "limits: 50° to each side of where the arm stands, 2.5 rad/s, 1.5 N·m at the gauge, 9 V"
    )
    assert lines[2] == (
        "1 wiring: short pulses that grow until the motor turns by 1°, 2.3° at most; nothing is closed; 8 s"
    )
    assert lines[3].startswith(
        "2 motor: slow moves within ±6.9°, growing to 60 % of the limits"
    )
    assert "within ±5.7°, growing to 60 % of the limits" in lines[4]
    assert "design for 22.5 to 40 g" in lines[5] and lines[6].startswith(
        "5 first moves: 30° at a tenth"
    )
    narrow = replace(
        PLAN, limits=replace(limits, angle=math.radians(10.0))
    ).text.splitlines()
    assert narrow[3].startswith("2 motor: slow moves within ±6°")
    rig = replace(RIG, payloads=replace(RIG.payloads, low=0.030, high=0.035))
    for payload, wanted in (
        (0.030, (0.030, 0.035)),
        (0.035, (0.030, 0.035)),
        (0.036, (0.027, 0.048)),
    ):
        assert fl.TuningPlan(LIMITS, payload, rig=rig).range == pytest.approx(wanted)
    assert fl.TuningPlan(LIMITS, 0.030, (0.030, 0.030), rig=rig).range == (0.030, 0.030)
    for payloads in ((0.031, 0.04), (0.02, 0.029), (0.0, 0.04)):
        with pytest.raises(FieldError, match=r"expected low <= 0\.03 <= high"):
            fl.TuningPlan(LIMITS, 0.030, payloads)


def test_a_verdict_has_its_three_scopes_and_the_reasons_of_each() -> None:
    law = replace(STATE, certified="stable", design_passed=True)
    for state, words in (
        (STATE, ("not run", "not run", "not run")),
        (law, ("passed", "not run", "not run")),
        (replace(STATE, certified="stable"), ("not run", "not run", "not run")),
        (replace(STATE, reasons=("why",)), ("failed", "not run", "not run")),
        (replace(STATE, stopped="by hand"), ("not run", "not run", "not run")),
        (replace(law, moves=(MOVE,)), ("passed", "passed", "passed")),
        (
            replace(
                law,
                moves=(replace(MOVE, promised_settling=2.5, measured_settling=2.5),),
            ),
            ("passed",) * 3,
        ),
        (
            replace(
                law,
                moves=(replace(MOVE, promised_settling=2.51, measured_settling=2.51),),
            ),
            ("passed", "failed", "passed"),
        ),
        (
            replace(law, moves=(replace(MOVE, measured_settling=2.0), MOVE)),
            ("passed", "passed", "passed"),
        ),
        (
            replace(law, moves=(MOVE, replace(MOVE, measured_settling=2.0))),
            ("passed", "passed", "failed"),
        ),
        (
            replace(
                law, moves=(replace(MOVE, measured_settling=2.0, payload=0.02), MOVE)
            ),
            ("passed", "passed", "failed"),
        ),
        (
            replace(law, moves=(replace(MOVE, jump=0.02),)),
            ("passed", "passed", "passed"),
        ),
        (
            replace(law, moves=(replace(MOVE, jump=0.021), MOVE)),
            ("passed", "passed", "failed"),
        ),
        (
            replace(law, moves=(MOVE,), stopped="by hand"),
            ("passed", "passed", "failed"),
        ),
    ):
        verdict = state.verdict
        assert (
            verdict.promise.state,
            verdict.model.state,
            verdict.reality.state,
        ) == words, state
        assert state.passed is (words == ("passed",) * 3)
    assert replace(STATE, reasons=("why",), stopped="by hand").verdict.promise == Scope(
        "failed", ("why",)
    )
    assert replace(STATE, stopped="by hand").verdict.promise == Scope(
        "not run", ("by hand",)
    )
    jumped = replace(law, moves=(replace(MOVE, jump=0.021),)).verdict.reality
    assert jumped.reasons == ("jump of 0.021 rad at the hand-over",)
    assert (
        not STATE.has_law
        and law.has_law
        and not replace(law, design_passed=False).has_law
    )
    assert replace(law, folder="f").file("law.json") == Path("f/law.json")


# --- the link's fit --------------------------------------------------------------------------------------


def test_a_mode_is_taken_out_of_the_torque_before_the_link_is_fitted_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each fit gets the output less what stands for the mode (2) and the ringing (1)."""
    seen: list[tuple[float, dict[str, Any]]] = []
    mode = fl.SecondMode(frequency=140.0, damping_ratio=0.02, gain=0.5)
    predicted = True

    def identified(log: Any, structure: str, **given: Any) -> Any:
        seen.append((float(log.output[0]), given))
        model = replace(RIG.model, second_mode=mode, unseen_up_to=99.0)  # type: ignore[type-var]
        holds = predicted or log.output.size != 5
        return SimpleNamespace(
            model=model, delay=0.003, passed=holds, size=log.output.size
        )

    monkeypatch.setattr(linking, "identify", identified)
    monkeypatch.setattr(
        linking,
        "_torque_of",
        lambda mode, shown, whole: np.full(whole.output.size, 2.0),
    )
    monkeypatch.setattr(linking, "_ringing", lambda fit, rest: np.ones(rest.size))
    monkeypatch.setattr(
        linking, "replace", lambda thing, **changes: _changed(thing, changes)
    )
    moves = SimpleNamespace(output=np.full(5, 10.0))
    whole = SimpleNamespace(output=np.full(9, 10.0))
    fit: Any = linking._fitted(moves, whole)  # type: ignore[arg-type]
    outputs = [output for output, _ in seen]
    # As it is; less mode; with mode less ringing, which shows the mode; once more;
    # clean, and a part of it.
    assert outputs == [10.0, 8.0, 9.0, 7.0, 9.0, 7.0, 7.0]
    assert [given.get("heldout") for _, given in seen] == [0.0] * 6 + [None]
    assert [given.get("fixed") for _, given in seen] == [
        None,
        None,
        {"delay": 0.003},
        None,
        {"delay": 0.003},
        None,
        None,
    ]
    assert (
        fit.size == 9
        and fit.model.second_mode == mode
        and fit.model.unseen_up_to == 99.0
    )
    predicted = False
    assert linking._fitted(moves, whole).size == 5  # type: ignore[arg-type, attr-defined]


def _changed(thing: Any, changes: dict[str, Any]) -> Any:
    return (
        replace(thing, **changes)
        if not isinstance(thing, SimpleNamespace)
        else SimpleNamespace(**vars(thing) | changes)
    )


# --- watch -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "was", "now", "error", "changed"),
    [
        ("natural_frequency", 10.0, 10.39, 0.01, False),
        ("natural_frequency", 10.0, 9.59, 0.01, True),
        ("gauge_gain", -2.0, -2.11, 0.01, True),
        ("gauge_gain", -2.0, -2.09, 0.01, False),
        ("gauge_delay", 0.0, 0.0026, 1e-4, True),
        ("gauge_delay", 0.1, 0.1024, 1e-4, False),
        ("friction", 0.1, 0.141, 0.001, True),
        ("friction", 0.1, 0.139, 0.001, False),
        ("natural_frequency", 10.0, 11.0, 0.251, False),  # as large, and not sure
        ("natural_frequency", 10.0, 11.0, 0.249, True),
    ],
)
def test_a_change_is_large_and_sure(
    name: str, was: float, now: float, error: float, changed: bool
) -> None:
    found = watching._change(name, was, now, error)
    assert found == Change(name, was, now, error, changed)
    assert str(found).startswith(
        f"{name} {'changed' if changed else 'as before'}: {was:.4g}, now {now:.4g} ± "
    )


def test_a_retune_is_due_for_what_changed_or_for_what_nothing_explains() -> None:
    same, other = Change("a", 1.0, 1.0, 0.1, False), Change("b", 1.0, 2.0, 0.1, True)
    for changes, residual, due in (
        ((same,), 0.04, ()),
        ((same,), 0.041, ("unexplained motion",)),
        ((same, other), 0.9, ("b",)),
    ):
        seen = Watch(changes, residual, 0.01, 9.0)
        assert seen.due == due and seen.passed is (not due)


def test_motion_is_counted_in_seconds_and_rest_is_not() -> None:
    time = 0.004 * np.arange(2500)
    angle = np.where(time < 5.0, 0.021 * time, 0.021 * 5.0)
    log = fl.Experiment(period=0.004, motor_angle=angle, output=np.zeros(2500))
    assert _moving_time(log) == pytest.approx(5.0, abs=0.06)
    slow = replace(log, motor_angle=0.019 * time)
    assert _moving_time(slow) == 0.0
    assert _moving_time(replace(log, motor_angle=-angle)) == pytest.approx(
        5.0, abs=0.06
    )


def test_a_watch_fits_anew_with_the_order_held_and_compares(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    errors = {"natural_frequency": 0.03, "gain": 0.04, "delay": 1e-4}
    model = replace(RIG.model, natural_frequency=10.0, order=1.9)  # type: ignore[type-var]
    known = SimpleNamespace(
        model=model, gain=1.6, delay=0.001, structure="UD-FOM", standard_errors=errors
    )
    now = SimpleNamespace(
        model=replace(model, natural_frequency=10.5),
        gain=1.61,
        delay=0.0011,
        mse=0.0004,
        standard_errors=errors,
    )
    asked: list[dict[str, Any]] = []

    def identified(log: Any, structure: str, **given: Any) -> Any:
        asked.append({"structure": structure} | given)
        return now

    motor = SimpleNamespace(friction=0.1, fit=SimpleNamespace(delay=0.004))
    drive = SimpleNamespace(
        coulomb_voltage=0.2, standard_errors={"coulomb_voltage": 0.003}
    )
    options: list[dict[str, Any]] = []

    def motor_of(voltage: Any, angle: Any, **given: Any) -> Any:
        options.append(given)
        if drive.coulomb_voltage > 1.0:
            raise LogError(
                "log", "it", "too few moves", allowed="more", remedy="move more"
            )
        return drive

    monkeypatch.setattr(watching, "identify", identified)
    monkeypatch.setattr(watching, "identify_motor", motor_of)
    monkeypatch.setattr(watching, "simulated_torque", lambda *_, **__: "torque")
    tuned: Any = replace(
        STATE, link=SimpleNamespace(fit=known), motor=motor, wiring=WIRING
    )  # type: ignore[arg-type]
    time = 0.004 * np.arange(2500)
    log = fl.Experiment(
        period=0.004, motor_angle=0.5 * time, output=0 * time, voltage=1.0 + 0 * time
    )
    seen = fl.lab.watch(log, tuned)
    assert seen.due == ("natural_frequency", "friction")
    assert [(c.name, c.was, c.now) for c in seen.changes] == [
        ("natural_frequency", 10.0, 10.5), ("gauge_gain", 1.6, 1.61), ("gauge_delay", 0.001, 0.0011),
        ("friction", 0.1, 0.2),
    ]  # fmt: skip
    assert [c.standard_error for c in seen.changes] == pytest.approx(
        [
            0.03 * math.sqrt(2),
            0.04 * math.sqrt(2),
            1e-4 * math.sqrt(2),
            math.hypot(0.003, 0.005),
        ]
    )
    assert (seen.residual, seen.expected) == (
        pytest.approx(0.02),
        0.01,
    ) and seen.motion == pytest.approx(10.0, abs=0.1)
    usual = {"structure": "UD-FOM", "hold": "first", "heldout": 0.0, "details": False}
    assert asked == [usual | {"fixed": {"order": 1.9}}]
    assert options == [
        {"period": 0.004, "torque": "torque", "delay": 0.004, "dead_zone": 0.0}
    ]
    drive.coulomb_voltage = 0.02  # less friction than before is no change
    assert fl.lab.watch(log, tuned).due == ("natural_frequency",)
    drive.coulomb_voltage = 9.0
    assert [c.name for c in fl.lab.watch(log, tuned).changes][-1] == "gauge_delay"
    assert len(fl.lab.watch(replace(log, voltage=None), tuned).changes) == 3
    known.model = replace(model, order=2.0)  # an integer order is the structure's own
    fl.lab.watch(log, tuned)
    assert asked[-1]["fixed"] == {}
    short = replace(log, motor_angle=np.where(time < 3.9, 0.5 * time, 0.5 * 3.9))
    with pytest.raises(
        FieldError,
        match=r"too little to tell \(got 3\.\d+ s of motion\); expected >= 4 s",
    ):
        fl.lab.watch(short, tuned)


def test_the_friction_of_a_cut_record_is_seen_under_the_load_of_the_whole_motion(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    loads: list[Any] = []

    def motor_of(voltage: Any, angle: Any, *, torque: Any, **_: Any) -> Any:
        loads.append(torque)
        return SimpleNamespace(
            coulomb_voltage=0.1, standard_errors={"coulomb_voltage": 0.003}
        )

    monkeypatch.setattr(watching, "identify_motor", motor_of)
    tuned: Any = SimpleNamespace(
        motor=SimpleNamespace(friction=0.1, fit=SimpleNamespace(delay=0.0))
    )
    fit: Any = SimpleNamespace(model=RIG.model)
    angle = 0.4 * np.clip((0.004 * np.arange(800) - 0.5) / 0.4, 0, 1)
    log = fl.Experiment(
        period=0.004, motor_angle=angle, output=0 * angle, voltage=1.0 + 0 * angle
    )
    cut = replace(
        log,
        motor_angle=angle[200:],
        output=log.output[200:],
        voltage=np.ones(600),
        earlier_angle=angle[:200],
    )
    for record in (log, cut):
        watching._friction(record, fit, tuned)
    exact = fracsys.time_response(RIG.model.torque(), angle, 0.004, hold="first").output  # type: ignore[union-attr]
    assert loads[0] == pytest.approx(exact, abs=1e-6) and loads[1] == pytest.approx(
        exact[200:], abs=1e-6
    )
    assert np.ptp(exact[:200]) > 0.1


def test_a_stage_that_is_whole_is_not_made_again(
    session: _Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Wiring and motor, then the link; what the motor's stage recorded plans the link's
    first excitation.
    """
    fit = SimpleNamespace(gain=61.0, decay=15.0, delay=0.0041)
    motor = SimpleNamespace(fit=fit, friction=0.09, loop=SimpleNamespace(pole=60.0))
    linked: list[Any] = []
    moved: list[Any] = []
    monkeypatch.setattr(tuning, "check_wiring", lambda guard, rig: WIRING)
    monkeypatch.setattr(tuning, "tune_motor", lambda guard, wiring: (motor, "begin"))
    monkeypatch.setattr(tuning, "save", lambda *_, **__: None)
    made = built()

    def link_stage(self: Any, guard: Any, begin: Any) -> Any:
        linked.append(begin)
        return link(0.5), made, iter(())

    monkeypatch.setattr(_Session, "_link", link_stage)
    monkeypatch.setattr(
        _Session, "_move", lambda self, guard, link, laws: moved.append(list(laws))
    )
    guard: Any = Guard()
    session.go(guard)
    assert linked == ["begin"] and moved == [[made]]
    assert guard.learned == [(60.0, 0.004), (61.0, 0.0041)]
    assert session.said == [  # type: ignore[attr-defined]
        "wiring", "  a", "  b", "motor",
        "  K/J 61 rad/(s²·V), ν/J 15 1/s, friction 0.09 V, delay 4.1 ms; loop at 60 rad/s",
    ]  # fmt: skip
    assert session.state.wiring == WIRING and session.state.motor is motor  # type: ignore[comparison-overlap]
    session.moves = False
    session.go(guard)
    assert (
        linked == ["begin", None] and len(moved) == 1
    )  # the motor is known, and no moves were asked for
    made = built("no law")
    session.moves = True
    session.go(guard)
    assert len(moved) == 1


ENDS: list[tuple[Callable[[], BaseException], str]] = [
    (lambda: FraclinkError("a limit"), "a limit"),
    (KeyboardInterrupt, "stopped by Ctrl-C; the drive is off"),
    (
        lambda: OSError(28, "No space left on device"),
        "[Errno 28] No space left on device",
    ),
]


@pytest.mark.slow
@pytest.mark.parametrize(("error", "said"), ENDS)
def test_however_a_tuning_ends_the_drive_is_off_and_its_reason_is_kept(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    error: Callable[[], BaseException],
    said: str,
) -> None:
    guard = Guard(50)

    def gone(self: Any, guard: Any) -> None:
        raise error()

    monkeypatch.setattr(tuning, "Guard", lambda opened, limits: guard)
    monkeypatch.setattr(_Session, "go", gone)
    told: list[str] = []
    board = fl.Callback(lambda: None, print)
    found = fl.tune(board, PLAN, out=tmp_path / "t", begin=told.append, clock="none")
    assert found.stopped == said and told == [f"  {said}"] and guard.released == 1
    assert fl.load(tmp_path / "t" / "tuning.json").stopped == said
    assert fl.load(tmp_path / "t" / "log.npz").motor_angle.size == 50


@pytest.mark.slow
@pytest.mark.parametrize("ended", [True, False])
def test_no_signal_takes_the_record_of_a_tuning_away(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ended: bool
) -> None:
    """A second one, as a closed terminal sends, changes nothing; a first one waits for
    the file.
    """
    made, keep = arm(), _Session.keep

    def read() -> tuple[float, float]:
        if ended and len(made.record) == 50:
            signal.raise_signal(signal.SIGINT)
        return made.read()

    def wrong(self: Any, guard: Any) -> None:
        guard.rest(0.5)
        raise FraclinkError("a limit")

    def late(self: Any, guard: Any) -> None:
        signal.raise_signal(signal.SIGINT)
        keep(self, guard)

    monkeypatch.setattr(_Session, "keep", late)
    handler = signal.signal(
        signal.SIGINT, signal.default_int_handler
    )  # ignored in the background of a shell
    try:
        if not ended:
            monkeypatch.setattr(_Session, "go", wrong)
        tuned(fl.Callback(read, made.write), tmp_path)
        interrupted = False
    except KeyboardInterrupt:
        interrupted = True
    finally:
        signal.signal(signal.SIGINT, handler)
    assert interrupted is not ended
    said = "stopped by a signal; the drive is off" if ended else "a limit"
    assert fl.load(tmp_path / "tuning.json").stopped == said
    assert fl.load(tmp_path / "log.npz").motor_angle.size == (50 if ended else 125)


@pytest.mark.slow
def test_a_signal_while_something_is_computed_ends_at_the_next_motion(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A closed terminal then takes nothing of what was recorded before."""

    def computing(self: Any, guard: Any) -> None:
        guard.rest(0.5)
        guard.release()
        signal.raise_signal(signal.SIGHUP)
        guard.rest(0.5)

    monkeypatch.setattr(_Session, "go", computing)
    caught: list[int] = []
    handler = signal.signal(signal.SIGHUP, lambda number, frame: caught.append(number))
    try:
        assert (
            tuned(arm().callback, tmp_path).stopped
            == "stopped by a signal; the drive is off"
        )
    finally:
        signal.signal(signal.SIGHUP, handler)
    assert not caught and fl.load(tmp_path / "log.npz").motor_angle.size == 125


def tuned(connection: fl.Callback, out: Path) -> fl.lab.Tuning:
    return fl.tune(connection, PLAN, out=out, clock="none")
