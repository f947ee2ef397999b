"""Tuning an unknown arm: the wiring is identified before a loop is closed, limits are
kept, and the result is a law.

The arm is a twin in this process; each exchange of a voltage and a reading is one
period.
"""

from __future__ import annotations

import math
import re
import socket
import sys
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fraclink as fl
from fraclink import Callback, main
from fraclink._cli.tunings import _following
from fraclink.errors import FieldError, FraclinkError, InfeasibleError
from fraclink.extend import simulated_torque
from fraclink.lab._tune_build import _designs
from fraclink.lab._tune_guard import Guard
from fraclink.lab._tune_link import _fitted
from fraclink.lab._tune_motion import random_steps
from fraclink.lab._tune_wiring import check_wiring
from tuned_arms import LIMITS, PERIOD, RIG, arm, guarded, outside_arm
from virtual_clock import VirtualClock

if sys.platform != "linux":
    pytest.skip("the real-time loop is Linux's", allow_module_level=True)

PLAN = fl.TuningPlan(LIMITS, payload=0.030, period=PERIOD)


def wired(
    made: fl.lab.SimulatedArm,
    *,
    angle: float = 1,
    torque: float = 1,
    voltage: float = 1,
) -> Callback:
    """The arm with scale factors on its signals."""

    def read() -> tuple[float, float]:
        found = made.read()
        return angle * found[0], torque * found[1]

    def write(command: Any) -> None:
        made.write(command._replace(voltage=voltage * command.voltage))

    return Callback(read, write)


def swapped(made: fl.lab.SimulatedArm) -> Callback:
    return Callback(lambda: made.read()[::-1], made.write)


WRONG: dict[str, Callable[[fl.lab.SimulatedArm], Callback]] = {
    "encoder reversed": lambda made: wired(made, angle=-1),
    "motor reversed": lambda made: wired(made, voltage=-1),
    "gauge reversed": lambda made: wired(made, torque=-1),
    "encoder dead": lambda made: wired(made, angle=0),
    "gauge dead": lambda made: wired(made, torque=0),
    "neither encoder nor gauge answers": lambda made: wired(made, voltage=0),
    "both sensors dead": lambda made: wired(made, angle=0, torque=0),
    "channels swapped": swapped,
    "gauge scale wrong": lambda made: wired(made, torque=10),
    "encoder scale wrong": lambda made: wired(made, angle=4),
}


@pytest.mark.slow
@pytest.mark.parametrize("fault", WRONG)
def test_a_wrong_wire_is_named_within_the_plan(fault: str) -> None:
    made = arm()
    guard = guarded(WRONG[fault](made))
    with pytest.raises(FraclinkError, match=fault):
        check_wiring(guard, RIG)
    guard.release()
    assert np.ptp(made.record[:, 1]) < planned_motion()
    assert made.record[-1, 4] == 0.0  # the drive is off


@pytest.mark.parametrize("reversed_wire", ["angle", "torque", "voltage"])
def test_swapped_channels_are_named_with_any_sign(reversed_wire: str) -> None:
    made = arm()
    wires = wired(made, **{reversed_wire: -1})
    guard = guarded(Callback(lambda: wires.read()[::-1], wires.write))  # type: ignore[index]
    with pytest.raises(FraclinkError, match="channels swapped"):
        check_wiring(guard, RIG)
    assert np.ptp(made.record[:, 1]) < planned_motion()


# Its torque follows the angle for as long as a doublet and its pause take.
SLOW = {
    "L": 0.358,
    "c": 0.711,
    "payload": 0.13,
    "link": 0.00691,
    "zeta": 0.007,
    "J": 0.0258,
    "K": 0.494,
    "visc": 0.229,
    "Fc": 0.564,
    "Fs": 0.767,
    "gdelay": 0.0051,
    "gnoise": 0.0026,
    "hum": 0.0036,
    "counts": 9149,
    "seed": 5,
}
# Read as the angle, its gauge hides the motions of the plan.
LOUD = {"gnoise": 0.02, "hum": 0.015, "gdrift": 0.003, "goffset": 0.3}
# Read as the torque, its encoder exceeds the limit.
IN_VOLTS = {"ggain": 0.012, "gnoise": 5e-5, "goffset": 4e-4}


@pytest.mark.slow
@pytest.mark.parametrize("swapped", [False, True])
@pytest.mark.parametrize(
    ("changes", "torque"),
    [(SLOW, 1.5), (LOUD, 1.5), (IN_VOLTS, 0.02)],
    ids=["slow", "loud", "in volts"],
)
def test_the_channel_of_the_motor_is_the_one_that_stands(
    changes: dict[str, float], torque: float, swapped: bool
) -> None:
    own, order = outside_arm(**changes), -1 if swapped else 1
    board = Callback(lambda: own.read()[::order], own.write)
    guard = guarded(board, replace(LIMITS, torque=torque))
    if swapped:
        with pytest.raises(FraclinkError, match="channels swapped"):
            check_wiring(guard, None)
        assert np.ptp([row[1] for row in own.rows]) < planned_motion()
    else:
        assert check_wiring(guard, None).gain > 0.0


@pytest.mark.parametrize("fault", ["encoder dead", "both sensors dead"])
@pytest.mark.parametrize("speed", [0.5, 1.0, 2.0])
def test_a_motor_that_nothing_shows_keeps_to_the_speed_limit(
    fault: str, speed: float
) -> None:
    made = arm()
    guard = guarded(WRONG[fault](made), replace(LIMITS, speed=speed))
    with pytest.raises(FraclinkError, match=r"the encoder|encoder dead"):
        check_wiring(guard, RIG)
    guard.release()
    assert np.max(np.abs(made.record[:, 2])) < speed


def test_what_an_unknown_motor_may_not_have_is_said() -> None:
    # One period at the voltage limit takes a motor of 300 rad/s² to 1.2 rad/s.
    made = arm()
    guard = guarded(WRONG["both sensors dead"](made), replace(LIMITS, speed=0.4))
    with pytest.raises(FraclinkError, match=r"neither .* beyond 0\.4 rad/s .* raise"):
        check_wiring(guard, None)
    assert 2.0 < np.max(made.record[:, 4]) < 10.0 / 3.0


@pytest.mark.slow
def test_a_gauge_whose_scale_reaches_the_guard_is_named_by_smaller_pulses() -> None:
    quiet = replace(RIG, gauge=replace(RIG.gauge, noise=1e-3))

    def checked(limits: fl.MotionLimits) -> tuple[Guard, list[str]]:
        made, said = fl.lab.SimulatedArm(fl.Twin.from_rig(quiet), PERIOD), list[str]()
        guard = guarded(wired(made, torque=10), limits)
        with pytest.raises(FraclinkError, match="gauge scale wrong"):
            check_wiring(guard, RIG, said.append)
        return guard, said

    guard, said = checked(LIMITS)
    assert not said
    # The guard stops at 0.8 of the limit: pulses half as large pass.
    most = float(np.max(np.abs(guard.record().torque)))
    _, said = checked(replace(LIMITS, torque=most))
    assert len(said) == 1 and said[0].endswith("once more, half as large")


@pytest.mark.parametrize(
    ("fault", "changes", "torque"),
    [
        ("encoder dead", {"ggain": 0.012, "gnoise": 5e-5, "goffset": 4e-4}, 0.02),
        ("gauge dead", {"grav": 0.17, "Fc": 0.15, "Fs": 0.2}, 1.5),
        ("both sensors dead", {"grav": 0.17, "Fc": 0.15, "Fs": 0.2}, 1.5),
    ],
    ids=["a gauge in volts", "a tilted arm", "a tilted arm, unseen"],
)
def test_a_dead_sensor_is_named_within_the_plan_on_other_arms(
    fault: str, changes: dict[str, float], torque: float
) -> None:
    own = outside_arm(**changes)
    connection = WRONG[fault](own)
    limits = fl.MotionLimits(angle=0.698, speed=4.0, torque=torque, voltage=10.0)
    guard = guarded(connection, limits)
    with pytest.raises(FraclinkError, match=fault):
        check_wiring(guard, None)
    assert np.ptp([row[1] for row in own.rows]) < planned_motion()


@pytest.mark.parametrize(
    ("tilt", "friction"), [(0.34, (0.10, 0.12)), (0.34, (0.2, 0.3)), (0.5, (0.35, 0.5))]
)
def test_the_weight_of_a_tilted_arm_is_named_as_what_pulls_it(
    tilt: float, friction: tuple[float, float]
) -> None:
    """Friction holds it at rest; each doublet lets it sink, so that the motor is nowhere
    where the doublets alone would leave it.
    """
    own = outside_arm(grav=tilt, Fc=friction[0], Fs=friction[1])
    limits = fl.MotionLimits(angle=0.698, speed=4.0, torque=1.5, voltage=10.0)
    with pytest.raises(FraclinkError, match="weight"):
        check_wiring(guarded(Callback(own.read, own.write), limits), None)
    assert np.ptp([row[1] for row in own.rows]) < 1.5 * planned_motion()


def planned_motion() -> float:
    """The largest motion [rad] that the plan states for the wiring check."""
    (degrees,) = re.findall(r"wiring: .* over ([\d.]+)° at most", PLAN.text)
    return math.radians(float(degrees))


@pytest.mark.slow
def test_right_wiring_has_evidence() -> None:
    twin = replace(fl.Twin.from_rig(RIG), gauge_delay=0.012, gauge_gain=0.8)
    made = fl.lab.SimulatedArm(twin, PERIOD)
    found = check_wiring(guarded(made.callback), RIG)
    assert found.gain == pytest.approx(RIG.motor.gain, rel=0.3)
    assert found.gauge_delay == pytest.approx(0.012, abs=0.006)
    assert len(found.evidence) == 5 and "alive" in found.evidence[1]
    assert np.ptp(made.record[:, 1]) < math.radians(5.0)


@pytest.mark.slow
@pytest.mark.parametrize("coulomb", [0.5, 1.0, 2.0])
def test_friction_does_not_shorten_what_small_motions_show(coulomb: float) -> None:
    """With friction ignored, K/J came out half as large, and a gauge reading 0.7 times
    the torque as one reading 0.39 times.
    """
    twin = replace(fl.Twin.from_rig(RIG), gauge_gain=0.7)
    motor = replace(twin.motor, coulomb_torque=coulomb * twin.motor.coulomb_torque)
    made = fl.lab.SimulatedArm(replace(twin, motor=motor), PERIOD)
    found = check_wiring(guarded(made.callback), RIG)
    assert found.gain == pytest.approx(RIG.motor.gain, rel=0.12)
    assert round(found.delay / PERIOD) == twin.voltage_delay


def test_without_a_rig_it_says_that_no_scale_was_shown() -> None:
    found = check_wiring(guarded(arm().callback), None)
    assert "not shown" in found.evidence[-1]


@pytest.mark.parametrize(("voltage", "limit"), [(10.0, "speed"), (1.0, "angle")])
def test_the_guard_stops_before_a_limit(voltage: float, limit: str) -> None:
    made = arm()
    limits = replace(LIMITS, speed=1.0) if limit == "speed" else LIMITS
    guard = guarded(made.callback, limits)
    with pytest.raises(FraclinkError, match=limit):
        for _ in range(5000):
            guard.step(voltage)
    guard.release()
    guarded(made.callback, limits).rest(2.0)
    assert np.max(np.abs(made.record[:, 1])) <= limits.angle


def test_voltages_are_clipped_and_nothing_else_than_a_number_is_sent() -> None:
    made = arm()
    guard = guarded(made.callback, replace(LIMITS, voltage=0.01))
    guard.step(5.0)
    guard.step(math.nan)
    guard.release()
    assert guard.record().voltage.tolist() == [0.01, 0.0]


def test_a_lost_link_ends_with_a_stop() -> None:
    sent: list[Any] = []
    samples = iter([(0.0, 0.0)] * 5)
    guard = guarded(Callback(lambda: next(samples, None), sent.append))
    with pytest.raises(FraclinkError, match="link to the arm is lost"):
        for _ in range(20):
            guard.step(0.1)
    guard.release()
    assert sent[-1].mode == 4 and sent[-1].voltage == 0.0


def test_samples_that_came_while_the_process_slept_are_counted() -> None:
    """A busy machine must not be mistaken for a fast arm: the motion between two
    samples took all the periods in between.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as plug:
        plug.bind(("127.0.0.1", 0))
        way = fl.lab.Udp("127.0.0.1", plug.getsockname()[1])
    clock = VirtualClock(2)
    served: list[fl.lab.ServedArm] = []

    def serve() -> None:
        try:
            twin = fl.Twin.from_rig(RIG)
            served.append(
                fl.lab.serve_arm(
                    twin, way, PERIOD, duration=1.0, priority=0, clock=clock
                )
            )
        finally:
            clock.leave()

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        guard = guarded(way, period=None, clock=clock)
        for _ in range(10):
            guard.step(0.5)
        before = guard.count
        clock.sleep(4.5 * PERIOD)
        guard.step(0.5)
        assert (
            guard.reading.periods in (4, 5) and guard.lost == guard.reading.periods - 1
        )
        assert guard.count == before + guard.reading.periods
        record = guard.record()
        between = np.diff(record.angle[-guard.reading.periods :])
        assert np.ptp(between) < 1e-9  # missing samples are interpolated linearly
        assert abs(guard.speed) < 1.2 * np.max(np.diff(record.angle)) / PERIOD
        clock.sleep(12.5 * PERIOD)
        with pytest.raises(FraclinkError, match="the link to the arm is lost"):
            for _ in range(20):
                guard.step(0.5)
        guard.release()
    finally:
        clock.leave()
        thread.join(60.0)
    assert served[0].voltage[-1] == 0.0


@pytest.fixture(scope="module")
def tuned(
    tmp_path_factory: pytest.TempPathFactory,
) -> tuple[fl.lab.Tuning, fl.lab.SimulatedArm, Path]:
    place, made = tmp_path_factory.mktemp("tune") / "arm", arm(seed=1)
    return fl.tune(made.callback, PLAN, out=place, clock="none"), made, place


@pytest.mark.slow
def test_an_unknown_arm_ends_with_a_law_that_it_follows(
    tuned: tuple[fl.lab.Tuning, fl.lab.SimulatedArm, Path],
) -> None:
    found, made, place = tuned
    assert found.has_law and not found.stopped
    assert found.link is not None and found.motor is not None
    assert found.link.fit.model.order == pytest.approx(1.92, abs=0.01)
    assert found.motor.fit.gain == pytest.approx(RIG.motor.gain, rel=0.02)
    assert found.verdict.promise.state == found.verdict.model.state == "passed"
    slow, fast = found.moves
    speeds = [abs(move.amplitude) / move.duration for move in (slow, fast)]
    assert speeds[1] == pytest.approx(10 * speeds[0])
    assert abs(fast.measured_settling - fast.promised_settling) < 0.1
    assert found.arm_time <= 60.0
    true = made.record
    assert np.max(np.abs(true[:, 1])) <= LIMITS.angle
    assert np.max(np.abs(true[:, 2])) <= LIMITS.speed
    assert np.max(np.abs(true[:, 3])) <= LIMITS.torque
    assert np.max(np.abs(true[:, 4])) <= LIMITS.voltage
    again = fl.load(place / "tuning.json")
    assert again.link.fit.model == found.link.fit.model and again.moves == found.moves
    assert (
        fl.load(place / "law.json").digest
        == fl.load(place / "design.json").law().digest
    )


@pytest.mark.slow
def test_a_law_that_is_there_moves_the_same_arm_alone(
    tuned: tuple[fl.lab.Tuning, fl.lab.SimulatedArm, Path], tmp_path: Path
) -> None:
    found, _, place = tuned
    for name in ("tuning.json", "design.json", "law.json"):
        (tmp_path / name).write_bytes((place / name).read_bytes())
    begun: list[str] = []
    again = fl.tune(
        arm(seed=2).callback,
        PLAN,
        out=tmp_path,
        resume=True,
        begin=begun.append,
        clock="none",
    )
    stages = [line for line in begun if not line.startswith(" ")]
    assert stages == ["wiring", "first moves"] and again.passed
    assert len(again.moves) == len(found.moves) and again.moves != found.moves
    other = arm(payload=0.120)
    refused = fl.tune(other.callback, PLAN, out=tmp_path, resume=True, clock="none")
    assert "another arm, payload or wiring" in refused.stopped


@pytest.mark.slow
def test_the_law_is_moved_with_another_payload_of_the_range(
    tuned: tuple[fl.lab.Tuning, fl.lab.SimulatedArm, Path], tmp_path: Path
) -> None:
    found, _, place = tuned
    for name in ("tuning.json", "design.json", "law.json"):
        (tmp_path / name).write_bytes((place / name).read_bytes())
    heavy = replace(PLAN, payload=0.038)
    again = fl.tune(
        arm(seed=3, payload=0.038).callback,
        heavy,
        out=tmp_path,
        resume=True,
        clock="none",
    )
    assert [move.payload for move in again.moves] == [0.030, 0.030, 0.038, 0.038]
    assert (
        again.has_law and again.verdict.arm.state == "passed" and again.payload == 0.030
    )
    assert again.link is not None and found.link is not None
    assert again.link.fit.model == found.link.fit.model
    with pytest.raises(FieldError, match=r"payload: .*0.0225.*0.04 kg"):
        fl.tune(
            arm().callback,
            replace(PLAN, payload=0.060, payloads=(0.05, 0.07)),
            out=tmp_path,
            resume=True,
        )


@pytest.mark.slow
def test_a_law_that_the_arm_refuses_is_withheld_and_the_next_one_is_tried(
    tuned: tuple[fl.lab.Tuning, fl.lab.SimulatedArm, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tried: list[str] = []

    def moved(
        guard: object, design: fl.Design, law: fl.Law, *_: object
    ) -> tuple[fl.lab.FirstMove, ...]:
        tried.append(law.digest)
        return (
            fl.lab.FirstMove(
                0.3, 0.5, 0.6, 2.4, *(0.001,) * 2, 0.006, *(0.001,) * 2, payload=0.030
            ),
        )

    monkeypatch.setattr("fraclink.lab._tune.first_moves", moved)
    found = fl.tune(arm().callback, PLAN, out=tmp_path, clock="none")
    assert len(set(tried)) == len(tried) == 2
    assert not found.has_law and found.verdict.promise.state == "failed"
    assert (
        "the arm's own moves fail" in found.reasons[0]
        and "measured 2.40 s" in found.reasons[0]
    )
    assert not any(
        (tmp_path / name).exists()
        for name in ("design.json", "law.json", "certificate.json")
    )


@pytest.mark.slow
@pytest.mark.parametrize(("ratio", "ringing"), [(0.03, 0.0), (0.005, 0.1)])
def test_the_second_mode_and_what_still_rings_do_not_bend_the_link(
    ratio: float, ringing: float
) -> None:
    period, random = 0.004, np.random.default_rng(7)
    moves = random_steps(0.1, 0.3, 0.1, 24, period)[0]
    shaken = np.repeat(random.choice([-1.0, 1.0], 170), 3)
    angle = np.concatenate([moves, 2e-3 * np.cumsum(shaken - shaken.mean())])
    link = fl.LinkModel(1.3, 10.0, 1.95)
    mode = fl.LinkModel(
        1.3 * 1.4, 140.0, 2.0, damping=2 * ratio * 140.0, damping_order=1.0
    )
    time = period * np.arange(angle.size)
    rings = np.exp(link.pole * time).real * 0.03
    rings += np.exp(mode.pole * time).real * ringing
    torque = rings + 0.01 * random.standard_normal(angle.size)
    for part in (link, mode):
        torque += simulated_torque(part, angle, period, delay=0.012, hold="first")
    log = fl.Experiment(period=period, motor_angle=angle, output=torque, payload=0.03)
    first = replace(log, motor_angle=angle[: moves.size], output=torque[: moves.size])
    fit = _fitted(first, log)
    found = fit.model.second_mode
    assert found is not None and found.frequency == pytest.approx(140.0, rel=0.01)
    assert found.gain == pytest.approx(1.4, rel=0.1)
    assert abs(fit.model.order - 1.95) < 4 * fit.standard_errors["order"] < 0.02
    assert abs(fit.delay - 0.012) < 4 * fit.standard_errors["delay"] < 0.003
    # of the moves, nothing is left but the noise
    assert np.std(fit.residual[: moves.size]) == pytest.approx(0.01, rel=0.1)
    bent = fl.identify(first, "UD-FOM")
    assert abs(bent.delay - 0.012) > 2 * abs(fit.delay - 0.012)


@pytest.mark.slow
def test_the_command_moves_a_law_with_what_was_asked_for_before(
    tuned: tuple[fl.lab.Tuning, fl.lab.SimulatedArm, Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "tuning.json").write_bytes((tuned[2] / "tuning.json").read_bytes())
    line = ["tune", "--io", "udp:127.0.0.1:9", "--out", str(tmp_path), "--resume"]
    assert main(line) == 2
    told = capsys.readouterr().err
    assert "design for 22.5 to 40 g" in told and "yes is required" in told
    assert "only the wiring and the first moves, with 30 g" in told


def test_only_a_law_whose_moves_were_as_promised_is_offered(tmp_path: Path) -> None:
    limits, place = LIMITS, tmp_path / "tuned"
    proved = fl.lab.Tuning(
        limits, 0.03, (0.02, 0.04), 0.004, certified="proved", design_passed=True
    )
    assert "run-realtime" in _following(proved, "udp:a:1", place)
    # With the payload of the tuning, and within the limits from the arm's present
    # position.
    kept = fl.lab.FirstMove(
        0.3, 0.5, 0.47, 0.48, *(0.001,) * 2, 0.006, *(0.001,) * 2, payload=0.03
    )
    following = _following(replace(proved, moves=(kept,)), "udp:a:1", place)
    assert following.endswith("--payload 0.03 --amplitude -0.300 --move-time 0.500")
    # A motor with persistent stick-slip is hunting, however well its moves settle.
    hunting = replace(kept, measured_unrest=0.003)
    hunted = replace(proved, moves=(hunting, kept))
    assert not hunted.passed and "back and forth" in hunted.verdict.arm.reasons[0]
    # The slow move is judged like the fast one.
    late = replace(kept, duration=1.6, promised_settling=1.4, measured_settling=1.6)
    assert not replace(proved, moves=(late, kept)).passed
    assert replace(proved, moves=(replace(late, measured_settling=1.5), kept)).passed
    slow = replace(kept, measured_settling=2.0)
    off = replace(proved, moves=(slow,))
    assert not off.passed and "diagnose" in _following(off, "udp:a:1", place)


@pytest.mark.slow
def test_a_wish_that_is_not_feasible_gets_the_law_that_is_with_the_reason(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def none(*_: object, **__: object) -> None:
        raise InfeasibleError("phase margin", "70° is too much", {})

    monkeypatch.setattr("fraclink.lab._tune_build.design_for", none)
    assert RIG.design is not None and RIG.model is not None
    made, words = next(_designs(RIG, RIG.model))
    assert made.passed and made.box is not None
    assert "70° is too much" in words[0] and "phase margin" in words[1]


@pytest.mark.slow
def test_a_fault_keeps_reason_and_record(tmp_path: Path) -> None:
    found = fl.tune(wired(arm(), torque=-1), PLAN, out=tmp_path / "new", clock="none")
    assert not found.passed and found.stopped.startswith("gauge reversed")
    assert len(fl.load(tmp_path / "new" / "log.npz").motor_angle) > 1000
    with pytest.raises(FieldError, match="already there"):
        fl.tune(arm().callback, PLAN, out=tmp_path / "new", clock="none")
    with pytest.raises(FieldError, match="without a law to try"):
        fl.tune(arm().callback, PLAN, out=tmp_path / "other", resume=True, clock="none")


def test_a_plan_says_what_will_move() -> None:
    lines = PLAN.text.splitlines()
    assert "34.4°" in lines[1] and "10 V" in lines[1]
    assert lines[2].startswith("domain") and "6.9 Hz" in lines[2]
    with pytest.raises(
        FieldError, match=r"payloads: the tuning payload is not in the range"
    ):
        replace(PLAN, payloads=(0.040, 0.050))


# ---- watch ------------------------------------------------------------------------------------------------


def running(place: Path, twin: fl.Twin) -> fl.Experiment:
    """Nine moves of an arm under the law of a tuning."""
    law, path, at = fl.load(place / "design.json").law(), fl.extend.hold(0.0, 0.5), 0.0
    for to in (0.3, -0.2, 0.1, -0.3, 0.25, -0.1, 0.3, -0.25, 0.0):
        path, at = path.then(fl.smooth_step(to - at, 0.6, start=0.5)), to
    run = fl.simulate(law, path, arm=twin, told=0.030, duration=12.0)
    return fl.Experiment(
        period=PERIOD,
        motor_angle=run.motor_angle_measured,
        output=run.torque_measured,
        voltage=run.voltage,
    )


TWIN = fl.Twin.from_rig(RIG)
CHANGED = {
    "": TWIN,
    "natural_frequency": TWIN.with_payload(0.030 / 1.1**2),
    "gauge_gain": replace(TWIN, gauge_gain=0.9),
    "gauge_delay": replace(TWIN, gauge_delay=0.005),
    "motor_gain": replace(
        TWIN,
        motor=replace(TWIN.motor, torque_constant=0.75 * TWIN.motor.torque_constant),
    ),
    "order": fl.Twin.from_rig(
        RIG, model=replace(RIG.model, order=RIG.model.order + 0.03)
    ),
    "friction": replace(
        TWIN, motor=replace(TWIN.motor, coulomb_torque=2 * TWIN.motor.coulomb_torque)
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CHANGED)
def test_watch_names_what_has_changed(
    tuned: tuple[fl.lab.Tuning, fl.lab.SimulatedArm, Path], name: str
) -> None:
    found, _, place = tuned
    seen = fl.lab.watch(running(place, CHANGED[name]), found)
    assert seen.due == ((name,) if name else ())
    assert seen.passed is (not name)


@pytest.mark.slow
def test_watch_names_a_change_within_the_record(
    tuned: tuple[fl.lab.Tuning, fl.lab.SimulatedArm, Path],
) -> None:
    found, _, place = tuned
    light = TWIN.with_payload(0.030 / 1.1**2)
    former, latter = running(place, TWIN), running(place, light)
    joined = replace(
        former,
        **{
            name: np.concatenate([getattr(former, name), getattr(latter, name)])
            for name in ("motor_angle", "output", "voltage")
        },
    )
    due = fl.lab.watch(joined, found).due
    assert set(due) == {"natural_frequency within the record", "natural_frequency"}


@pytest.mark.slow
def test_watch_refuses_what_shows_nothing(
    tuned: tuple[fl.lab.Tuning, fl.lab.SimulatedArm, Path],
) -> None:
    found, _, place = tuned
    log = running(place, TWIN)
    short = replace(
        log,
        motor_angle=log.motor_angle[:300],
        output=log.output[:300],
        voltage=log.voltage[:300],
    )
    with pytest.raises(FieldError, match="too little to tell"):
        fl.lab.watch(short, found)
    with pytest.raises(FieldError, match="without a model"):
        fl.lab.watch(log, replace(found, link=None))
    with pytest.raises(FieldError, match="not the tuning's"):
        fl.lab.watch(replace(log, period=0.005), found)
