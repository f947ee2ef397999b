"""The real-time loop around two functions: the same law, missed periods, lost samples,
a stop at the end.

On a virtual clock, which advances only while all threads sleep: periods are lost on
purpose, by sleeping in the functions, and never because of a busy machine. The timing
of a real machine is measured by benchmarks/bench_realtime.py.
"""

from __future__ import annotations

import math
import os
import shutil
import signal
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fraclink as fl
from fraclink import Callback, Law, Reference, _kernels
from fraclink.errors import FieldError, FileFormatError, LogError
from fraclink.lab import RealtimeRun, run_realtime
from fraclink.lab import _loop as loop
from fraclink.lab._line import open_line
from fraclink.lab._machine import signals_held
from fraclink.lab._run import first_difference, saved
from virtual_clock import VirtualClock

if not _kernels.REALTIME:
    pytest.skip("the real-time loop is Linux's", allow_module_level=True)

RIG = fl.Rig.named("paper-2023")
PERIOD = 0.02
RUN, OFF = 1, 4  # modes of the law
MISSED, ENCODER = 8, 1  # LAW_FLAG_MISSED and LAW_FLAG_ENCODER of law.h


@pytest.fixture(scope="module")
def law() -> Law:
    return fl.discretize(
        fl.Controller(
            derivative_gain=0.069876, derivative_order=0.612197, link=RIG.model
        ),
        PERIOD,
        order=4,
    )


class Board:
    """An arm that stands where it is told to, and records everything that was written
    to it.
    """

    def __init__(self) -> None:
        self.angle = 0.3
        self.reads = 0
        self.commands: list[Any] = []

    def read(self) -> tuple[float, float]:
        self.reads += 1
        return self.angle, 0.01 * math.sin(0.1 * self.reads)

    def write(self, command: Any) -> None:
        self.commands.append(command)
        if command.mode != OFF:
            self.angle += 0.5 * (command.motor_reference - self.angle)

    def run(self, law: Law, **options: object) -> RealtimeRun:
        return live(
            law,
            Callback(self.read, self.write),
            fl.smooth_step(0.1, 0.2),
            **{"duration": 0.3} | options,
        )


def live(
    law: Law, board: Callback, reference: Reference | None = None, **options: object
) -> RealtimeRun:
    """Run `law` on a clock of its own; by default the arm is to stay where it is."""
    given = {"priority": 0, "lock_memory": False, "clock": VirtualClock(1)} | options
    return run_realtime(law, reference or fl.extend.hold(0.0), board, **given)  # type: ignore[arg-type]


def stopped(board: Board) -> bool:
    """Whether the last command is a stop: the drive off, no voltage."""
    return board.commands[-1].mode == OFF and board.commands[-1].voltage == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["double", "single"])
def test_the_record_replays_to_the_last_bit(law: Law, precision: str) -> None:
    used = law.in_precision(precision)  # type: ignore[arg-type]
    board = Board()
    run = board.run(used)
    assert run.stopped == "finished"
    assert run.first_difference is None
    assert run.passed
    assert (len(run.time), run.missed, run.overruns, run.lost_samples) == (16, 0, 0, 0)
    assert run.time == pytest.approx(PERIOD * (run.tick - 1.0), abs=1e-12)
    assert run.origin == pytest.approx(0.3)
    assert run.reference[-1] == pytest.approx(0.4, abs=1e-6)
    # the record is what was written, followed by the stop
    given = np.array([command.motor_reference for command in board.commands])
    assert given[:-1].tobytes() == run.motor_reference.tobytes()
    assert stopped(board)
    assert board.commands[-1].motor_reference == run.motor_reference[-1]
    assert all(command.mode != OFF for command in board.commands[:-1])


@pytest.mark.slow
@pytest.mark.parametrize(("payload", "periods"), [(0.0, 0), (0.03, 0), (50.0, 16)])
def test_a_payload_that_the_law_rejects_is_said(
    law: Law, payload: float, periods: int
) -> None:
    run = Board().run(law, payload=payload)
    assert [finding.evidence for finding in run.findings] == [
        {"periods": periods}
    ] * bool(periods)
    assert [found.code for found in run.overview().findings] == ["W603"] * bool(periods)


def test_a_record_that_was_touched_does_not(law: Law) -> None:
    run = Board().run(law)

    def touched(name: str, value: float) -> int | None:
        values = getattr(run, name).copy()
        values[4] = value
        return first_difference(law, {**vars(run), name: values})

    for name in ("motor_angle", "torque", "reference"):
        assert touched(name, getattr(run, name)[4] + 1e-6) == 4
    for name in ("motor_reference", "voltage", "tip_estimate"):
        assert touched(name, np.nextafter(getattr(run, name)[4], 2.0)) == 4
    for name in ("mode", "flags"):
        assert touched(name, 2) == 4


def test_the_reference_counts_from_where_the_arm_stands(law: Law) -> None:
    run = Board().run(law)
    assert run.origin == run.reference[0] == pytest.approx(0.3)
    assert abs(run.motor_reference[-1] - 0.4) < 0.02


def test_missed_periods_reach_the_law(law: Law) -> None:
    board, clock = Board(), VirtualClock(1)

    def late() -> tuple[float, float] | None:
        if board.reads == 5:
            clock.sleep(2.5 * PERIOD)
        return board.read()

    run = live(law, Callback(late, board.write), duration=0.4, clock=clock)
    jump = int(np.flatnonzero(np.diff(run.tick) > 1)[0]) + 1
    # Read 6 is that of period 5 (read 1 found the arm); it ends in the middle of period
    # 7, so 6 is lost.
    assert (run.tick[jump - 1], run.tick[jump], run.missed, run.overruns) == (
        5,
        7,
        1,
        2,
    )
    assert run.work[jump - 1] == pytest.approx(2.5 * PERIOD)
    assert run.latency[jump] == pytest.approx(1.5 * PERIOD)
    assert run.flags[jump] & MISSED
    assert run.mode[jump] == RUN  # the law continues
    assert run.first_difference is None
    assert not run.passed
    assert "overruns, allowed 0" in run.problem
    assert replace(run, allowed_overruns=run.overruns).passed


def test_too_many_missed_periods_switch_the_drive_off(law: Law) -> None:
    board, clock = Board(), VirtualClock(1)

    def asleep() -> tuple[float, float] | None:
        if board.reads == 5:
            clock.sleep((law.limits.missed_limit + 3) * PERIOD)
        return board.read()

    run = live(law, Callback(asleep, board.write), duration=2.0, clock=clock)
    assert run.stopped == "law off"
    assert run.problem.endswith("(missed periods)")
    assert run.problem == "safe stop: the law switched off (missed periods)"
    assert len(run.time) < 12
    assert run.first_difference is None
    assert stopped(board)


def test_lost_samples_are_ridden_through_and_a_silent_arm_is_given_up(law: Law) -> None:
    board = Board()
    lost = {3, 4, *range(8, 1000)}

    def read() -> tuple[float, float] | None:
        sample = board.read()
        return None if board.reads in lost else sample

    run = live(law, Callback(read, board.write), duration=5.0)
    missing_rows = np.flatnonzero(np.isnan(run.motor_angle))
    assert len(missing_rows) == run.lost_samples == 2 + law.limits.bad_limit
    assert all(run.flags[missing_rows] & ENCODER)
    assert run.mode[missing_rows[2] - 1] == RUN
    assert run.problem == "safe stop: the law switched off (encoder)"
    assert run.first_difference is None
    assert stopped(board)


def test_a_law_that_gave_up_the_gauge_goes_on_and_does_not_hold(law: Law) -> None:
    board = Board()
    run = live(
        law,
        Callback(lambda: (board.read()[0], math.nan), board.write),
        duration=0.3,
        allowed_overruns=99,
    )
    assert (run.stopped, run.passed) == ("finished", False)
    assert run.problem == "the law ended in mode degraded (gauge)"
    assert run.first_difference is None


ENDING = (
    "INT",
    "TERM",
    "HUP",
    "QUIT",
    "TSTP",
    "USR1",
    "USR2",
    "ALRM",
    "VTALRM",
    "XCPU",
    "TTIN",
    "RTMIN",
)


@pytest.fixture(autouse=True)
def ordinary_signals() -> Iterator[None]:
    """Signal handlers as in a terminal: a background job ignores some signals, and an
    ignored one does not end a run.
    """
    numbers = [signal.Signals[f"SIG{name}"] for name in ENDING]
    before = [signal.signal(number, signal.SIG_DFL) for number in numbers]
    signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    for number, handler in zip(numbers, before, strict=True):
        signal.signal(number, handler)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.Signals[f"SIG{name}"] for name in ENDING])
def test_a_signal_stops_the_run_and_python_has_its_handler_back(
    law: Law, number: signal.Signals
) -> None:
    board = Board()
    before = signal.getsignal(number)

    def read() -> tuple[float, float] | None:
        if board.reads == 4:
            os.kill(os.getpid(), number)
        return board.read()

    run = live(law, Callback(read, board.write), duration=5.0)
    assert run.stopped == "signal"
    assert run.problem == "safe stop: signal"
    assert len(run.time) <= 6
    assert stopped(board)
    assert signal.getsignal(number) is before
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


def test_signals_that_end_nothing_and_those_the_program_uses_end_no_run(
    law: Law,
) -> None:
    board = Board()
    seen: list[int] = []
    before = signal.signal(signal.SIGUSR1, lambda number, frame: seen.append(number))
    ignored = signal.signal(signal.SIGHUP, signal.SIG_IGN)  # as with nohup

    def read() -> tuple[float, float] | None:
        if board.reads == 4:
            for number in (
                signal.SIGUSR1,
                signal.SIGHUP,
                signal.SIGWINCH,
                signal.SIGCONT,
                signal.SIGCHLD,
            ):
                os.kill(os.getpid(), number)
        return board.read()

    try:
        run = live(law, Callback(read, board.write), duration=0.3)
    finally:
        signal.signal(signal.SIGUSR1, before)
        signal.signal(signal.SIGHUP, ignored)
    assert (run.stopped, len(run.time), seen) == ("finished", 16, [signal.SIGUSR1])


@pytest.mark.parametrize("ended", [True, False])
def test_no_signal_takes_the_record_away(
    law: Law, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ended: bool
) -> None:
    """A second signal, as from a closed terminal, has no effect; a first one is
    deferred until the file is written.
    """
    board, place = Board(), tmp_path / "run.npz"

    def read() -> tuple[float, float]:
        if ended and board.reads == 4:
            os.kill(os.getpid(), signal.SIGINT)
        return board.read()

    def late(value: object, where: Path) -> Path:
        os.kill(os.getpid(), signal.SIGINT)
        return saved(value, where)

    monkeypatch.setattr(loop, "saved", late)
    way = Callback(read, board.write)
    if ended:
        assert live(law, way, duration=5.0, out=place).stopped == "signal"
    else:
        with pytest.raises(KeyboardInterrupt):
            live(law, way, duration=0.3, out=place)
    assert fl.load(place, RealtimeRun).stopped == ("signal" if ended else "finished")
    assert stopped(board)


def test_a_signal_that_comes_as_the_others_are_given_back_is_obeyed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    release = _kernels.realtime_release_signals

    def late() -> None:
        signal.raise_signal(signal.SIGINT)
        release()

    monkeypatch.setattr(_kernels, "realtime_release_signals", late)
    with pytest.raises(KeyboardInterrupt), signals_held():
        pass
    with signals_held() as obeyed:
        obeyed.set()


def test_a_name_that_no_record_can_have_is_found_before_the_arm_moves(
    law: Law, tmp_path: Path
) -> None:
    board = Board()
    other = r"out: of another kind of file \(got run\.csv\); expected \.npz"
    for place, said in ((tmp_path / "run.csv", other), (tmp_path, "out: a folder")):
        with pytest.raises(FieldError, match=said):
            board.run(law, out=place)
    assert (board.reads, board.commands, list(tmp_path.iterdir())) == (0, [], [])


def test_another_system_is_refused_and_not_its_missing_calls(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(_kernels, "REALTIME", False)
    for name in ("watch_signals", "release_signals", "signalled"):
        monkeypatch.delattr(_kernels, f"realtime_{name}")
    refused = r"^system: without clock_nanosleep.*expected Linux"
    with pytest.raises(FieldError, match=refused), signals_held():
        pass


def test_a_place_that_is_lost_in_the_run_has_a_second_one(
    law: Law, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    board = Board()
    kept = board.run(law, out=tmp_path / "kept" / "run.npz")
    assert kept.saved == str(tmp_path / "kept" / "run.npz")
    assert [item.name for item in (tmp_path / "kept").iterdir()] == ["run.npz"]
    place, second = tmp_path / "lost", tmp_path / "second"
    place.mkdir()
    second.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(second))

    def read() -> tuple[float, float]:
        if board.reads == 40:  # the folder is replaced by a file while the arm moves
            shutil.rmtree(place)
            place.touch()
        return board.read()

    board.reads = 30
    # the alternative folder adds to the name, which is limited to 255 bytes there, too
    longest = "r" * 251 + ".npz"
    run = live(law, Callback(read, board.write), duration=0.3, out=place / longest)
    assert Path(run.saved).parent == second
    assert fl.load(run.saved, RealtimeRun).tick.tobytes() == run.tick.tobytes()


def test_a_run_whose_last_periods_never_ran_does_not_pass(law: Law) -> None:
    """The law is not called after them, and so does not trip."""
    board, clock = Board(), VirtualClock(1)

    def asleep() -> tuple[float, float] | None:
        if board.reads == 20:
            clock.sleep(3.0)
        return board.read()

    connection = Callback(asleep, board.write)
    run = live(law, connection, duration=2.0, clock=clock, allowed_overruns=999)
    assert (run.stopped, run.planned) == ("finished", round(2.0 / PERIOD) + 1)
    assert run.missed == run.planned - len(run.tick) > 70
    assert not run.passed
    assert run.problem.startswith(f"the last {run.unfinished} of {run.planned} periods")


def test_a_signal_before_the_first_sample_leaves_an_empty_record(
    law: Law, tmp_path: Path
) -> None:
    board = Board()

    def read() -> None:
        board.read()
        if board.reads == 3:
            os.kill(os.getpid(), signal.SIGTERM)

    run = live(law, Callback(read, board.write), duration=5.0)
    assert (run.stopped, run.problem, len(run.tick), run.missed) == (
        "signal",
        "safe stop: signal",
        0,
        0,
    )
    assert stopped(board)
    again = fl.load(fl.save(run, tmp_path / "run.npz"), RealtimeRun)
    assert math.isnan(again.latencies.mean)
    assert first_difference(law, vars(again)) is None
    with pytest.raises(LogError, match="0 of 0 samples"):
        again.experiment()


def test_an_exception_of_a_callback_stops_the_drive_first(law: Law) -> None:
    board = Board()

    def read() -> tuple[float, float] | None:
        if board.reads == 4:
            raise RuntimeError("the board is gone")
        return board.read()

    with pytest.raises(RuntimeError, match="the board is gone"):
        live(law, Callback(read, board.write), duration=5.0)
    assert stopped(board)
    calls: list[Any] = []

    def write(command: Any) -> None:
        calls.append(command)
        if len(calls) == 3:
            raise ValueError("the amplifier refuses")

    with pytest.raises(ValueError, match="the amplifier refuses"):
        live(law, Callback(Board().read, write), duration=5.0)
    assert calls[-1].mode == OFF
    with pytest.raises(TypeError, match=r"must return \(motor_angle, torque\) or None"):
        live(law, Callback(lambda: "0.1", write), duration=1.0)  # type: ignore[arg-type,return-value]


def test_an_arm_that_gives_no_sample_is_named(law: Law) -> None:
    commands: list[Any] = []
    with pytest.raises(
        FieldError, match=r"io: silent: no sample in 0.05 s \(got callback\)"
    ):
        live(law, Callback(lambda: None, commands.append), patience=0.05)
    assert {(command.voltage, command.motor_reference) for command in commands} == {
        (0.0, 0.0)
    }
    assert commands[-1].mode == OFF
    commands.clear()
    # an invalid sample does not start the run
    with pytest.raises(FieldError, match="silent"):
        live(
            law,
            Callback(lambda: (math.nan, 0.0), commands.append),
            patience=0.05,
        )


def test_a_saved_record_comes_back(law: Law, tmp_path: Path) -> None:
    run = Board().run(law)
    again = fl.load(fl.save(run, tmp_path / "run.npz"), RealtimeRun)
    assert first_difference(law, vars(again)) is None
    for name in ("time", "latency", "work", "torque", "tick", "flags"):
        assert getattr(again, name).tobytes() == getattr(run, name).tobytes()
    for name in (
        "stopped",
        "period",
        "connection",
        "scheduling",
        "memory",
        "origin",
        "first_difference",
    ):
        assert getattr(again, name) == getattr(run, name)
    with pytest.raises(ValueError, match="read-only"):
        again.torque[0] = 1.0
    other = tmp_path / "other.npz"
    fl.save(fl.Experiment(period=0.1, motor_angle=[0, 1], output=[0, 1]), other)
    with pytest.raises(FileFormatError, match="kind"):
        fl.load(other, RealtimeRun)


def test_a_run_is_a_log_to_identify_from(law: Law) -> None:
    run = Board().run(law, duration=2.1)
    count = int(run.tick[-1])
    assert count > 100
    lost = run.motor_angle.copy()
    lost[40] = math.nan
    log = replace(run, motor_angle=lost.copy()).experiment(payload=0.03)
    assert (log.period, log.payload, log.output_kind) == (PERIOD, 0.03, "torque")
    assert len(log.motor_angle) == count
    present = np.delete(np.arange(len(run.tick)), 40)
    rows = run.tick[present].astype(int) - 1
    assert log.motor_angle[rows].tobytes() == run.motor_angle[present].tobytes()
    assert log.output[rows].tobytes() == run.torque[present].tobytes()
    assert log.motor_angle[run.tick[40] - 1] == pytest.approx(
        0.5 * (lost[39] + lost[41]), abs=1e-3
    )
    assert ("interpolated_samples", str(1 + run.missed + run.lost_samples)) in log.notes
    lost[40:50] = math.nan
    with pytest.raises(
        LogError, match=rf"lost \(got 1[0-9] of {count} samples\); expected 1 %"
    ):
        replace(run, motor_angle=lost).experiment()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"duration": 0.0}, "duration"),
        ({"duration": math.nan}, "duration"),
        ({"patience": -1.0}, "patience"),
        ({"priority": 100}, "priority"),
        ({"priority": True}, "priority"),
        ({"allowed_overruns": -1}, "allowed_overruns"),
    ],
)
def test_bad_values_are_named(law: Law, options: dict[str, object], field: str) -> None:
    board = Board()
    with pytest.raises(FieldError) as caught:
        board.run(law, **options)
    assert caught.value.field == field
    assert board.commands == []


def locked_kilobytes() -> int:
    lines = Path("/proc/self/status").read_text("utf-8").splitlines()
    return int(next(line for line in lines if line.startswith("VmLck")).split()[1])


@pytest.mark.slow
def test_what_it_grants_is_given_back(law: Law) -> None:
    before = os.sched_getscheduler(0)
    seen: list[tuple[int, int]] = []

    def read() -> tuple[float, float]:
        seen.append((os.sched_getscheduler(0), locked_kilobytes()))
        return 0.3, 0.0

    board = Board()
    run = run_realtime(
        law, fl.extend.hold(0.0), Callback(read, board.write), duration=0.1, priority=5
    )
    scheduler, kilobytes = seen[-1]
    # A container may refuse either of them: then it is not in effect, which the result
    # states.
    assert (run.scheduling == "SCHED_FIFO 5") == (scheduler == os.SCHED_FIFO)
    assert (run.memory == "locked") == (kilobytes > 0)
    assert (os.sched_getscheduler(0), locked_kilobytes()) == (before, 0)


def test_a_board_that_states_no_period_must_be_told_one() -> None:
    sent: list[object] = []
    with (
        pytest.raises(FieldError, match="Give --period-ms") as caught,
        open_line(Callback(lambda: (0.0, 0.0), sent.append), None, clock="none"),
    ):
        pass
    assert caught.value.field == "period"
    with open_line(Callback(lambda: (0.1, 0.2), sent.append), PERIOD, clock="none") as (
        line,
        first,
    ):
        assert (line.period, first.angle, first.torque) == (PERIOD, 0.1, 0.2)
