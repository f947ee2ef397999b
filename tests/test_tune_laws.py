"""From the measurements of a tuning to a law, and the first moves under it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import fraclink as fl
from fraclink import _kernels
from fraclink._arm.link import LinkModel
from fraclink._arm.motor_loop import MotorGain
from fraclink._design.completed import design_for
from fraclink._law import Law
from fraclink.errors import FieldError, InfeasibleError
from fraclink.findings import Finding
from fraclink.lab import _tune_build as tune_build
from fraclink.lab import _tune_moves as tune_moves
from fraclink.lab._tune_build import Built, build_law, measured_rig
from fraclink.lab._tune_guard import Guard, Record
from fraclink.lab._tune_motion import Follower, motor_law
from fraclink.lab._tune_motor import MotorResult
from fraclink.lab._tune_moves import (
    FirstMove,
    _agree,
    _compared,
    _moved,
    first_moves,
    planned_move,
)
from tuned_arms import LIMITS, PERIOD, RIG, Stages, arm, guarded, staged

if not _kernels.REALTIME:
    pytest.skip("the real-time loop is Linux's", allow_module_level=True)

Real = NDArray[np.float64]
MOTOR = MotorGain(60.0, 10.0)


@pytest.fixture(scope="module")
def stages() -> Stages:
    return staged()


# --- from the measurements to a law ----------------------------------------------------------------------


def rig_of(stages: Stages, **changes: Any) -> fl.Rig:
    _, _, wiring, _, link = stages
    given = {"stated": None, "name": "mine"} | changes
    wiring = given.pop("wiring", wiring)
    return measured_rig(wiring, link, LIMITS, (0.02, 0.04), 0.030, PERIOD, **given)


@pytest.mark.slow
def test_the_rig_is_what_was_measured(stages: Stages) -> None:
    _, _, wiring, _, link = stages
    rig = rig_of(stages)
    model, fit = link.fit.model, link.motor.fit
    # ω₀² = c/(mL²), c = 3EI/L: equations (5) and (4)
    assert model.natural_frequency**2 == pytest.approx(
        rig.link.stiffness / (0.030 * rig.link.length**2)
    )
    assert (
        rig.link.stiffness
        == pytest.approx(3 * rig.link.flexural_rigidity / rig.link.length)
        == model.stiffness
    )
    assert rig.motor.gain == pytest.approx(
        fit.gain
    ) and rig.motor.decay == pytest.approx(fit.decay)
    assert rig.motor.inertia == fit.inertia and rig.motor.voltage_limit == 10.0
    friction = (fit.coulomb_voltage + fit.dead_zone) * fit.gain * fit.inertia
    assert rig.motor.coulomb_torque == pytest.approx(friction)
    assert (rig.payloads.low, rig.payloads.high, rig.payloads.nominal) == (
        0.02,
        0.04,
        0.03,
    )
    assert (rig.period, rig.gauge.noise, rig.name) == (
        PERIOD,
        wiring.gauge_noise,
        "mine",
    )
    assert rig.motor_loop == link.motor.loop
    assert rig.encoder.counts_per_revolution == round(2 * math.pi / wiring.encoder_step)
    for step, counts in ((0.0, None), (0.02, None), (0.0199, 316), (1e-3, 6283)):
        made = rig_of(stages, wiring=replace(wiring, encoder_step=step))
        assert made.encoder.counts_per_revolution == counts
    stated = replace(RIG, name="theirs", gauge=replace(RIG.gauge, noise=9.0))
    known = rig_of(stages, stated=stated)
    assert (
        known.name == "theirs"
        and known.design == RIG.design
        and known.gauge.noise == wiring.gauge_noise
    )
    assert known.motor == rig.motor and known.link == rig.link


def test_a_fit_that_failed_a_gate_has_no_law() -> None:
    bad = Finding("W300", "error", "the log shows nothing", {}, "move more")
    fit = SimpleNamespace(
        passed=False, findings=(bad, replace(bad, code="W301", severity="info"))
    )
    built = build_law(RIG, SimpleNamespace(fit=fit))  # type: ignore[arg-type]
    assert built.reasons == ("the model failed a gate: W300: the log shows nothing",)
    assert not built.passed and built.design is built.law is built.certificate is None


def fake(
    gain: float, degrees: float, *, passed: bool = True, rings: bool = False
) -> Any:
    """A design with a loop gain at a second mode."""
    mode = SimpleNamespace(name="loop gain at mode 2", achieved=gain, passed=passed)
    other = SimpleNamespace(name="phase margin", achieved=9.0, passed=True)
    findings = (SimpleNamespace(code="W409"),) * rings
    return SimpleNamespace(
        requirements=(other, mode),
        passed=passed and not rings,
        findings=findings,
        gain_crossover=10.0,
        degrees=degrees,
    )


@pytest.fixture
def asked(
    monkeypatch: pytest.MonkeyPatch,
) -> tuple[list[tuple[float, float, float]], dict[int, Any]]:
    """What `_designs` asks for, and by the number of the request what it gets; None
    otherwise.
    """
    calls: list[tuple[float, float, float]] = []
    answers: dict[int, Any] = {}

    def made(
        _: object, __: object, crossover: float, degrees: float, filter_time: float
    ) -> Any:
        calls.append((crossover, degrees, filter_time))
        return answers.get(len(calls) - 1)

    monkeypatch.setattr(tune_build, "_asked", made)
    return calls, answers


def test_designs_come_with_the_quiet_ones_first_and_the_loud_ones_by_their_gain(
    asked: tuple[list[tuple[float, float, float]], dict[int, Any]],
) -> None:
    calls, answers = asked
    quiet, loud, louder, none = (
        fake(0.70, 32),
        fake(0.71, 34),
        fake(0.9, 46),
        fake(1.2, 28, passed=False),
    )
    answers |= {1: louder, 2: loud, 3: none, 4: quiet}
    missed: list[Any] = []
    found = list(tune_build._designs(replace(RIG, design=None), RIG.model, missed))  # type: ignore[arg-type]
    assert [made for made, _ in found] == [quiet, loud, louder] and missed == [none]
    resonance = RIG.model.at_payload(RIG.payloads.high).torque_resonance  # type: ignore[union-attr]
    assert resonance is not None
    for (crossover, degrees, filter_time), (ratio, margin, share) in zip(
        calls, tune_build._WANTED, strict=False
    ):
        assert crossover == pytest.approx(ratio * resonance) and degrees == margin
        assert filter_time == pytest.approx(share / resonance)
    # Between them it looks for margins, at the crossovers and filters that are listed.
    assert len(calls) > len(tune_build._WANTED)
    assert found[0][1] == (
        "gain crossover 10 rad/s and phase margin 28°, which the whole box keeps",
        "loop gain of 0.7 at most at the second mode",
    )
    bare = fake(0.0, 32)
    assert len(tune_build._words(bare, 32.0)) == 1
    assert tune_build._mode_gain(SimpleNamespace(requirements=())) == 0.0  # type: ignore[arg-type]


def test_why_there_is_no_law_counts_what_was_missed() -> None:
    mode = fl.SecondMode(frequency=140.0, damping_ratio=0.02, gain=0.5)
    model = replace(RIG.model, second_mode=mode, gauge_delay=0.012)  # type: ignore[type-var]
    missed = [
        fake(1.2, 32, passed=False),
        fake(1.13, 34, passed=False),
        fake(0.5, 40, rings=True),
    ]
    said = tune_build._none(RIG, model, missed)  # type: ignore[arg-type]
    low, high = 1e3 * RIG.payloads.low, 1e3 * RIG.payloads.high
    assert (
        "phase margin of 25° or more" in said
        and f"gauge delay 12 ms, payloads {low:.3g} to {high:.3g} g" in said
    )
    assert (
        f"of {len(tune_build._WANTED)} tried, {len(tune_build._WANTED) - 3} do not keep their margin"
        in said
    )
    assert "1 ring for more than ten periods after a move" in said
    assert (
        "2 have a loop gain of 1.13 or more at the second mode (140 rad/s), where 0.95 is allowed"
        in said
    )
    assert said.endswith("; a faster gauge or a narrower range of payloads helps")
    plain = tune_build._none(
        RIG, replace(model, second_mode=None), [fake(0.5, 40)] * len(tune_build._WANTED)
    )
    assert (
        "do not keep" not in plain
        and "ring for" not in plain
        and "second mode" not in plain
    )


def test_halving_goes_to_the_side_that_is_missed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def run(
        tried: list[tuple[float, Any]], passes: Callable[[float], Any]
    ) -> tuple[list[float], list[float]]:
        calls: list[float] = []

        def made(_: object, __: object, ___: float, degrees: float, ____: float) -> Any:
            calls.append(degrees)
            return passes(degrees)

        monkeypatch.setattr(tune_build, "_asked", made)
        found = tune_build._between(RIG.model, RIG, 10.0, 0.02, tried)  # type: ignore[arg-type]
        return calls, [degrees for degrees, _ in found]

    rings, loud = fake(0.5, 0, rings=True), fake(2.0, 0, passed=False)
    # All ring: 12° above the highest that rings, or half of that, three times.
    assert run([(34.0, rings)], lambda _: rings) == ([40.0, 46.0, 52.0], [])
    # None that is found is too quiet: from 25° on, halves below the lowest that is
    # loud.
    assert run([(34.0, loud)], lambda _: loud) == ([29.5, 27.25, 26.125], [])
    assert run([(34.0, None)], lambda _: None) == ([29.5, 27.25, 26.125], [])
    assert run([], lambda d: fake(0.5, d) if d > 30 else rings) == ([31.0], [31.0])
    # One of those that were offered passes: there is nothing to look for.
    assert run([(34.0, fake(0.5, 34))], lambda _: loud) == ([], [])
    # Neither rings nor is loud: no margin mends what it misses.
    odd = SimpleNamespace(
        passed=False, findings=(), requirements=(SimpleNamespace(passed=True),)
    )
    assert run([(34.0, odd)], lambda _: loud) == ([], [])


@pytest.mark.slow
def test_a_law_that_fails_anywhere_is_told_why(monkeypatch: pytest.MonkeyPatch) -> None:
    made, _ = design_for(RIG)
    certificate = SimpleNamespace(passed=True, verdict="stable")
    monkeypatch.setattr(tune_build, "_noise", lambda *_: share)
    monkeypatch.setattr(tune_build, "_moves_fail", lambda *_: moves)
    monkeypatch.setattr(tune_build, "certify", lambda *_, **__: certificate)
    monkeypatch.setattr(fl.Design, "with_law", lambda self: self)
    share: float
    moves: tuple[str, ...] = ()
    for noise, why in (
        (0.12, ""),
        (0.121, "noise of the gauge: at rest it takes 12 % of the voltage limit"),
    ):
        share = noise
        built = tune_build._proved(RIG, made, ("words",))
        assert ("; ".join(built.reasons)).startswith(why) and built.passed is (not why)
        assert (built.certificate is certificate) is (not why) and built.law is not None
    share, moves = 0.05, ("it rings",)
    assert tune_build._proved(RIG, made, ()).reasons == ("it rings",)
    moves = ()
    assert tune_build._proved(RIG, made, ("words",)).assumptions == (
        "words",
        "at rest the gauge's noise takes 5 % of the voltage limit",
    )
    certificate.passed, certificate.verdict = False, "not stable at 20 g"
    assert tune_build._proved(RIG, made, ()).reasons == ("not stable at 20 g",)

    def refused(*_: object, **__: object) -> None:
        raise FieldError("limits", 1, "too small", allowed="more", remedy="give more")

    monkeypatch.setattr(tune_build, "certify", refused)
    built = tune_build._proved(RIG, made, ())
    assert built.reasons == (
        str(FieldError("limits", 1, "too small", allowed="more", remedy="give more")),
    )


def test_the_noise_at_rest_is_that_of_the_voltage_once_it_has_settled(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    voltage = np.concatenate([np.full(100, 50.0), np.tile([0.3, -0.3], 100)])
    asked: list[dict[str, Any]] = []

    def simulated(law: object, reference: Any, **given: Any) -> Any:
        asked.append(given)
        assert reference.angle(np.array([1.0]))[0] == 0.0
        return SimpleNamespace(voltage=voltage)

    monkeypatch.setattr(tune_build, "simulate", simulated)
    made: Any = SimpleNamespace(rig=RIG, model=RIG.model)
    share = tune_build._noise(made, None)  # type: ignore[arg-type]
    assert share == pytest.approx(0.3 / RIG.motor.voltage_limit)
    assert asked[0]["duration"] == 1.5 and asked[0]["payload"] == RIG.model.payload  # type: ignore[union-attr]


def test_moves_are_tried_with_both_ends_of_the_payloads_on_every_link(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made: Any = SimpleNamespace(model=RIG.model, payloads=(0.02, 0.04))
    twins = [
        SimpleNamespace(beam=SimpleNamespace(link_mass=mass)) for mass in (0.0, 0.0075)
    ]
    monkeypatch.setattr(tune_build, "link_twins", lambda _: twins)
    tried: list[tuple[float, float]] = []
    bad: tuple[float, float] | None = None

    def simulated(
        law: object, move: Any, *, arm: Any, payload: float, told: bool
    ) -> Any:
        tried.append((arm.beam.link_mass, payload))
        heavy = abs(RIG.model.at_payload(0.04).pole)  # type: ignore[union-attr]
        assert told and move.duration == pytest.approx(1.2 * 2 * math.pi / heavy)
        assert move.angle(np.array([9.0]))[0] == pytest.approx(0.3)
        return SimpleNamespace(
            verdict=SimpleNamespace(passed=tried[-1] != bad, reason="it rings")
        )

    monkeypatch.setattr(tune_build, "simulate", simulated)
    assert tune_build._moves_fail(made, None) == ()  # type: ignore[arg-type]
    assert tried == [(0.0, 0.02), (0.0, 0.04), (0.0075, 0.02), (0.0075, 0.04)]
    bad = (0.0075, 0.02)
    (why,) = tune_build._moves_fail(made, None)  # type: ignore[arg-type]
    assert why == "moves of 20 g on a link of 7.5 g fail in the simulation: it rings"


def test_a_design_is_asked_for_over_the_box_with_the_mode_that_was_measured(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[dict[str, Any]] = []

    def designed(model: LinkModel, rig: fl.Rig, **given: Any) -> Any:
        asked.append(given)
        if given["gain_crossover"] > 20.0:
            raise InfeasibleError("phase margin", "no", {})
        return "made"

    monkeypatch.setattr(tune_build, "design", designed)
    mode = fl.SecondMode(frequency=140.0, damping_ratio=0.02, gain=0.5)
    model: Any = replace(RIG.model, second_mode=mode)  # type: ignore[type-var]
    assert tune_build._asked(model, RIG, 10.0, 30.0, 0.02) == "made"  # type: ignore[comparison-overlap]
    given = asked[0]
    assert (given["gain_crossover"], given["filter_time"], given["filter_order"]) == (
        10.0,
        0.02,
        2,
    )
    assert (
        given["phase_margin"] == pytest.approx(math.pi / 6)
        and given["mode_gain"] == 0.95
    )
    assert (given["inner"], given["placement"], given["law"], given["nearest"]) == (
        "sampled",
        "direct",
        False,
        False,
    )
    assert given["box"].mode_frequency == pytest.approx((140 * 0.97, 140 * 1.03))
    assert given["box"].mode_gain == pytest.approx((0.45, 0.55))
    assert tune_build._asked(model, RIG, 21.0, 30.0, 0.02) is None
    tune_build._asked(RIG.model, RIG, 10.0, 30.0, 0.02)  # type: ignore[arg-type]
    assert asked[-1]["mode_gain"] is None


# --- the first moves -------------------------------------------------------------------------------------


def test_a_measured_time_agrees_within_a_tenth_or_fifty_milliseconds() -> None:
    for measured, promised, agree in (
        (1.099, 1.0, True), (1.101, 1.0, False), (0.901, 1.0, True), (0.899, 1.0, False),
        (0.249, 0.2, True), (0.251, 0.2, False), (0.549, 0.5, True), (0.551, 0.5, False),
    ):  # fmt: skip
        assert _agree(measured, promised) is agree, (measured, promised)
        move = FirstMove(0.3, 0.5, promised, measured, 0, 0, 0, 0, 0, 0, 0)
        assert move.kept is agree


def test_moves_are_compared_by_their_medians_and_largest_values() -> None:
    time = PERIOD * np.arange(500)
    noise = np.where(np.arange(500) % 2, 1e-3, -1e-3)
    records = [
        (Record(PERIOD, np.full(500, 2.0), 3.0 * time, np.full(500, -0.4)), 0.002),
        (
            Record(
                PERIOD,
                np.full(500, -3.0),
                2.0 * time * (time < 1) + noise,
                np.full(500, 0.3),
            ),
            0.001,
        ),
    ]
    judged, promised = (
        [(0.6, 0.01), (0.5, 0.03), (0.7, 0.02)],
        [(0.4, 0.004), (0.45, 0.006)],
    )
    found = _compared(records, judged, promised, 0.3, 0.5, 0.03)
    assert (found.measured_settling, found.measured_residual) == (0.6, 0.02)
    assert (found.promised_settling, found.promised_residual) == (
        pytest.approx(0.425),
        pytest.approx(0.005),
    )
    assert found.measured_noise == pytest.approx(1e-3)  # of the last record's end
    assert (found.jump, found.peak_voltage, found.peak_torque) == (0.002, 3.0, 0.4)
    jump = 2.0 * time[249]  # within 16 ms at the end of its ramp
    assert found.peak_speed == pytest.approx(max(3.0, (jump + 2e-3) / 0.016), rel=0.05)
    assert (found.amplitude, found.duration, found.payload) == (0.3, 0.5, 0.03)


def moved_by(
    factor: Callable[[float, float], dict[str, float]], monkeypatch: pytest.MonkeyPatch
) -> list[tuple[float, float]]:
    """What `planned_move` tries, where the run of (amplitude, duration) has these
    shares of the limits.
    """
    tried: list[tuple[float, float]] = []

    def simulated(
        law: object, move: Any, *, arm: object, payload: float, told: bool
    ) -> Any:
        amplitude, duration = float(move.angle(np.array([99.0]))[0]), move.duration
        if not tried or tried[-1] != (amplitude, duration):
            tried.append((amplitude, duration))
        share = {"speed": 0.1, "torque": 0.1, "angle": 0.1, "passed": 1.0} | factor(
            amplitude, duration
        )
        angle = np.linspace(0.0, share["angle"] * LIMITS.angle, 2000)
        angle[:5] += share["speed"] * LIMITS.speed * PERIOD * np.arange(5)
        torque = np.full(2000, share["torque"] * LIMITS.torque)
        verdict = SimpleNamespace(passed=bool(share["passed"]))
        return SimpleNamespace(
            motor_angle_measured=angle, torque_measured=torque, verdict=verdict
        )

    monkeypatch.setattr(tune_moves, "simulate", simulated)
    monkeypatch.setattr(tune_moves, "link_twins", lambda _: ["massless", "heavy"])
    made: Any = SimpleNamespace(payloads=(0.02, 0.04))
    planned = planned_move(made, SimpleNamespace(period=PERIOD), LIMITS)  # type: ignore[arg-type]
    return [*tried, planned]


def test_the_first_move_is_the_fastest_within_three_fifths_of_the_limits(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    usual = (pytest.approx(0.36), pytest.approx(1.875 * 0.36 / (0.48 * 4.0)))
    few = {"angle": 0.05}
    assert moved_by(lambda *_: few, monkeypatch) == [usual, usual]
    slower = moved_by(
        lambda _, d: few | {"torque": 0.61 if d < 0.4 else 0.6}, monkeypatch
    )
    assert slower[-1] == (usual[0], pytest.approx(1.15 * 1.875 * 0.36 / (0.48 * 4.0)))
    smaller = moved_by(
        lambda a, _: {"angle": a / 0.6 + 0.05, "speed": 0.3}, monkeypatch
    )
    assert smaller[-1] == (pytest.approx(0.9 * 0.36), usual[1])
    rings = moved_by(lambda _, d: few | {"passed": float(d > 0.5)}, monkeypatch)
    assert (
        rings[-1][1] == pytest.approx(usual[1].expected * 1.15**3)
        and rings[-1][0] == usual[0]
    )
    never = moved_by(lambda *_: few | {"torque": 0.9}, monkeypatch)
    assert len(never) == 21 and never[-1][1] == pytest.approx(
        usual[1].expected * 1.15**20
    )


@pytest.mark.slow
def test_two_moves_decide_and_a_third_where_they_do_not(
    stages: Stages, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, _, _, motor, _ = stages
    guard = guarded(arm(seed=1).callback)
    times = iter([1.0, 0.50, 0.62, 0.51])  # the slow one, and three of the full one
    made: list[tuple[float, float]] = []

    def moved(
        guard: Guard, law: Law, motor: MotorResult, path: Any, payload: float
    ) -> tuple[Record, float]:
        made.append((float(path.angle(np.array([99.0]))[0]), path.duration))
        return Record(PERIOD, *np.ones((3, 400))), 0.001

    def judged(
        angle: Real, torque: Real, far: float, long: float, design: object
    ) -> tuple[float, float]:
        assert angle[0] == 0.0 or angle[0] == 5.0
        return (
            next(times)
            if angle[0] == 0.0
            else {4.0: 1.0}.get(round(long / 0.4, 3), 0.5),
            0.0,
        )

    monkeypatch.setattr(tune_moves, "planned_move", lambda *_: (0.3, 0.4))
    monkeypatch.setattr(tune_moves, "_moved", moved)
    monkeypatch.setattr(tune_moves, "_judged", judged)
    seeds: list[int] = []

    def simulated(*_: object, seed: int) -> tuple[Real, Real]:
        seeds.append(seed)
        return np.full(9, 5.0), np.zeros(9)

    monkeypatch.setattr(tune_moves, "_simulated", simulated)
    slow, fast = first_moves(guard, None, None, motor, 0.03)  # type: ignore[arg-type]
    assert [(abs(far), long) for far, long in made] == [
        (pytest.approx(0.12), pytest.approx(1.6)),
        *[(pytest.approx(0.3), pytest.approx(0.4))] * 3,
    ]
    # two fifths of the way in four times the time: a tenth of the speed
    assert (slow.measured_settling, slow.promised_settling) == (1.0, 1.0)
    assert (fast.measured_settling, fast.promised_settling) == (0.51, 0.5) and fast.kept
    assert seeds == [*range(7), *range(7)] and slow.payload == fast.payload == 0.03
    assert (
        all(far < 0 for far, _ in made[:1]) or guard.angle < 0
    )  # back towards where it stood at first


@pytest.mark.slow
def test_a_hand_over_shows_the_first_periods_only(
    stages: Stages, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, _, _, motor, _ = stages
    made = arm(seed=1)
    guard = guarded(made.callback)
    loop_law = motor_law(motor.gain, motor.loop, guard)
    path = fl.smooth_step(0.1, 0.4)
    begins: list[int] = []
    true = tune_moves.follow

    def watched(guard: Guard, law: Law, table: Real, **given: Any) -> Record:
        begins.append(guard.count)
        record = true(
            guard, loop_law, table, **(given | {"follower": Follower(loop_law)})
        )
        if len(begins) == 2:
            record.angle[4] += 0.03  # within the first five periods
            record.angle[5] += 0.50
        return record

    monkeypatch.setattr(tune_moves, "follow", watched)
    record, jump = _moved(guard, loop_law, motor, path, 0.03)
    assert jump == pytest.approx(0.03, abs=0.003)
    assert record.duration == pytest.approx(0.4 + 2.5, abs=PERIOD)
    assert np.diff(begins).tolist() == [50, 50] and begins[0] * PERIOD == pytest.approx(
        0.6
    )
    assert made.record[-1, 1] == pytest.approx(0.1, abs=0.01)


def test_what_the_model_promises_is_simulated_on_the_link_that_was_shown(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[dict[str, Any]] = []

    def simulated(law: object, path: object, **given: Any) -> Any:
        asked.append(given)
        return SimpleNamespace(motor_angle_measured="angle", torque_measured="torque")

    monkeypatch.setattr(tune_moves, "simulate", simulated)
    monkeypatch.setattr(
        tune_moves, "link_twins", lambda _: ["massless", "light", "heavy"]
    )
    made: Any = SimpleNamespace(model=RIG.model)
    path = fl.smooth_step(0.3, 0.5)
    assert tune_moves._simulated(made, None, path, 0.03, seed=4) == ("angle", "torque")  # type: ignore[arg-type, comparison-overlap]
    assert asked[0] == {
        "arm": "massless",
        "payload": 0.03,
        "told": True,
        "duration": 3.0,
        "seed": 4,
    }
    made.model = replace(
        RIG.model,
        second_mode=fl.SecondMode(frequency=140.0, damping_ratio=0.02, gain=0.5),
    )  # type: ignore[type-var]
    tune_moves._simulated(made, None, path, 0.03, seed=4)  # type: ignore[arg-type]
    assert asked[1]["arm"] == "heavy"


@pytest.mark.slow
def test_laws_that_pass_are_offered_and_the_first_refusal_is_told_where_none_does(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    reasons: list[tuple[str, ...]] = []
    proved: list[Any] = []

    def prove(rig: fl.Rig, made: Any, words: tuple[str, ...]) -> Built:
        proved.append(made)
        return Built(rig, made, None, None, reasons[len(proved) - 1], words)

    design = SimpleNamespace(doubted=lambda findings: findings)
    monkeypatch.setattr(
        tune_build, "_designs", lambda *_: ((design, ("words",)) for _ in reasons)
    )
    monkeypatch.setattr(tune_build, "_proved", prove)
    monkeypatch.setattr(tune_build, "_none", lambda *_: "there is none")
    fit = SimpleNamespace(passed=True, findings=("a finding",), model=RIG.model)
    link: Any = SimpleNamespace(fit=fit)
    for told, offered in (
        ([("it rings",), (), ("loud",), ()], [(), ()]),
        ([("it rings",), ("loud",)], [("it rings",)]),
        ([], [("there is none",)]),
    ):
        proved.clear()
        reasons[:] = told
        found = list(tune_build.built_laws(RIG, link))
        assert [one.reasons for one in found] == offered
        assert all(
            made == ("a finding",) for made in proved
        )  # the fit's doubts travel with each design
    proved.clear()
    reasons[:] = [(), ()]
    assert (
        next(tune_build.built_laws(RIG, link)).passed and len(proved) == 1
    )  # made when it is asked for
