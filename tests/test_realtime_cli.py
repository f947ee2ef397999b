"""run-realtime and serve-arm, called as by a user: with an arm of two functions, and
with one in another process.

The loops run on a virtual clock, which two processes can share: a busy machine has no
effect.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import shutil
import signal
import socket
import struct
import subprocess
import sys
import textwrap
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import fraclink as fl
from fraclink import Callback, MotorLoop, _kernels, main
from fraclink._cli import boards
from fraclink.errors import LogError
from fraclink.extend import geared
from fraclink.lab import RealtimeRun, ServedArm
from fraclink.trials import load_study
from virtual_clock import VirtualClock

if not _kernels.REALTIME:
    pytest.skip("the real-time loop is Linux's", allow_module_level=True)

Line = Callable[[str], tuple[int, str, str]]
PERIOD = 0.02


class Board:
    """A motor that follows a voltage or, as a servo, a reference; one sample is lost."""

    def __init__(self, broken: int = 1_000_000) -> None:
        self.angle, self.reads, self.broken = 0.0, 0, broken
        self.last: Any = None

    def read(self) -> tuple[float, float] | None:
        if self.last is not None:
            self.angle += (
                0.02 * self.last.voltage
                if self.last.voltage
                else 0.5 * (self.last.motor_reference - self.angle)
            )
        self.reads += 1
        if self.reads >= self.broken:
            raise OSError("board: gone")
        # The torque varies: a constant one means a stuck gauge.
        return None if self.reads == 5 else (self.angle, 0.001 * (self.reads % 2))

    def write(self, command: Any) -> None:
        self.last = command


@pytest.fixture
def board(monkeypatch: pytest.MonkeyPatch) -> Board:
    """The board used by every --io of `run-realtime`; each run is a new session."""
    made = Board()
    monkeypatch.setattr(
        boards, "connection_of", lambda *given: Callback(made.read, made.write)
    )
    return made


@pytest.fixture(scope="module")
def design(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rig = geared(replace(fl.Rig.named("paper-2023"), period=PERIOD))
    assert rig.model is not None
    # The pole of 80 rad/s cannot be placed at this period; 20 is used below.
    asked = {"gain_crossover": 12.0, "phase_margin": fl.deg(20), "filter_time": 0.0}
    design = fl.design(rig.model, rig, **asked, motor_loop="ideal", placement="tustin")
    slow = replace(design.controller, motor_loop=MotorLoop(pole=20.0))
    place = tmp_path_factory.mktemp("design") / "design.json"
    massive = replace(rig, link=replace(rig.link, mass=0.00735))
    replace(design, controller=slow, rig=massive).save(place)
    return place


@pytest.fixture(scope="module")
def law(design: Path) -> fl.Law:
    return fl.Design.load(design).law(order=4)


@pytest.fixture
def fraclink(
    design: Path,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> Line:
    """Run the command line in a folder that holds design.json."""
    monkeypatch.chdir(tmp_path)
    shutil.copy(design, tmp_path)

    def run(line: str) -> tuple[int, str, str]:
        code = main(line.split())
        streams = capsys.readouterr()
        return code, streams.out, streams.err

    return run


@pytest.fixture
def virtual(monkeypatch: pytest.MonkeyPatch) -> None:
    """The clock of the loop, which only this thread uses."""
    clock = _kernels.RealtimeClock
    monkeypatch.setattr(
        _kernels, "RealtimeClock", lambda given: clock(given or VirtualClock())
    )


@pytest.mark.slow
@pytest.mark.usefixtures("virtual")
def test_a_period_that_the_machine_does_not_keep_is_refused_before_anything_moves(
    fraclink: Line, board: Board, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The measurement is reported: 0 µs on the virtual clock, then three of 250
    wake-ups late by a period.
    """
    line = (
        "run-realtime design.json --io udp:127.0.0.1:5005 --amplitude 0 --duration 0.1"
    )
    assert "wake-ups 0 µs late on average, 0 µs at most" in (
        err := fraclink(line)[2]
    ), err
    assert "20 ms can be kept" in err
    board.last = None
    bare = _kernels.realtime_bare

    def busy(latency: Any, *options: Any) -> Any:
        outcome = bare(latency, *options)
        latency[:3] = 0.021
        return outcome

    monkeypatch.setattr(_kernels, "realtime_bare", busy)
    code, _, err = fraclink(f"{line} --force")
    assert (code, "period: not kept by this machine: 1.2 % of its wake-ups" in err) == (
        2,
        True,
    ), err
    assert "21.0 ms at most" in err and "20 ms cannot be kept" in err
    assert board.last is None


@pytest.mark.slow
@pytest.mark.usefixtures("virtual")
def test_a_key_comes_from_a_file_and_only_for_datagrams(
    fraclink: Line, tmp_path: Path
) -> None:
    (tmp_path / "short").write_bytes(b"secret")
    for options, said in (
        ("--io udp:127.0.0.1:5005 --key-file short", "key: not a key (got 6 bytes)"),
        ("--io udp:127.0.0.1:5005 --key-file nowhere", "nowhere"),
        ("--io serial:/dev/ttyACM0 --key-file short", "key: of no use here"),
    ):
        for command in ("run-realtime", "serve-arm"):
            code, _, err = fraclink(f"{command} design.json {options}")
            assert (code, said in err, "secret" in err) == (2, True, False), err


@pytest.mark.slow
@pytest.mark.usefixtures("virtual")
def test_a_board_is_run_and_left_with_its_drive_off(
    fraclink: Line, board: Board, tmp_path: Path
) -> None:
    line = "run-realtime design.json --io udp:127.0.0.1:5005 --amplitude 0.05 --move-time 0.5 --duration 0.6"
    code, out, err = fraclink(f"{line} --json")
    told = json.loads(out)
    assert (code, told["passed"], told["stopped"], told["replays"]) == (
        0,
        True,
        "finished",
        True,
    ), err
    assert (told["periods"], told["missed"], told["overruns"]) == (31, 0, 0)
    assert told["lost_samples"] == 1
    assert set(told["latency_s"]) == {"least", "mean", "high", "most"}
    run = fl.load(told["out"], RealtimeRun)
    assert run.motor_angle[-1] > 0.01
    assert board.last is not None and (board.last.mode, board.last.voltage) == (4, 0.0)
    assert fraclink(line)[0] == 2  # an existing record is not overwritten
    board.reads = 0
    assert fraclink(f"{line} --force")[0] == 0
    with pytest.raises(LogError, match=r"samples\); expected 1 %"):
        fl.load("realtime.npz", RealtimeRun).experiment()
    assert fraclink(f"{line} --force --no-motor")[0] == 0
    assert not fl.load("realtime.npz", RealtimeRun).voltage.any()
    assert fraclink(f"{line} --force")[0] == 0
    fl.load("realtime.npz", RealtimeRun).experiment().save(tmp_path / "log.csv")
    lines = (tmp_path / "log.csv").read_text("utf-8").splitlines()
    assert "time_s,motor_angle_rad,torque_Nm,voltage_V" in lines
    # a record among the results of the other stages does not prevent their report
    assert load_study(tmp_path).design is not None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("io", "said"),
    [
        ("udp", "io: without a port (got udp)"),
        ("udp:127.0.0.1", "without a port"),
        ("udp::5005", "without a host"),
        (
            "udp:127.0.0.1:0",
            "port: out of range (got 0); expected whole number 1 to 65535",
        ),
        ("udp:127.0.0.1:70000", "port: out of range (got 70000)"),
        ("udp:127.0.0.1:http", "without a port"),
        ("shm:arm", "not a connection to an arm"),
        ("serial:", "without a port"),
        ("serial:/dev/ttyUSB0@fast", "without a speed"),
        ("", "not a connection to an arm"),
    ],
)
def test_ways_that_lead_nowhere(
    fraclink: Line, tmp_path: Path, io: str, said: str
) -> None:
    code = main(["run-realtime", "design.json", "--io", io, "--patience", "0.05"])
    assert code == 2
    assert not (tmp_path / "realtime.npz").exists()
    _, _, err = fraclink("--version")
    assert said in err
    assert len(err.strip().splitlines()) == 1


CRASHING = """
    import sys
    import fraclink as fl
    from fraclink.lab._connections import Udp
    from fraclink.lab._loop import run_realtime
    law = fl.Design.load("design.json").law(order=4)
    way = Udp("127.0.0.1", int(sys.argv[1]))
    run_realtime(law, fl.extend.hold(0.0), way, priority=0, duration=5.0, patience=60.0)
"""


@pytest.mark.slow
@pytest.mark.usefixtures("fraclink")
def test_a_process_that_crashes_leaves_a_stop_behind() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as plug:
        plug.bind(("127.0.0.1", 0))
        plug.settimeout(60.0)
        port = str(plug.getsockname()[1])
        command = [sys.executable, "-c", textwrap.dedent(CRASHING), port]
        with subprocess.Popen(command) as process:  # noqa: S603
            plug.recv(100)  # it is searching for its arm
            process.send_signal(signal.SIGSEGV)
            modes = [0]
            while modes[-1] != 4:
                (mode,) = struct.unpack_from("<I", plug.recv(100), 32)
                modes.append(mode)
        assert process.returncode == -signal.SIGSEGV


@pytest.mark.slow
@pytest.mark.usefixtures("virtual")
def test_the_record_has_a_place_before_the_arm_moves_or_nothing_happens(
    fraclink: Line, board: Board
) -> None:
    code, _, err = fraclink(
        "run-realtime design.json --io udp:127.0.0.1:5005 --out design.json/r.npz"
    )
    assert (code, "which is not a folder" in err) == (2, True)
    assert board.last is None


@pytest.mark.slow
@pytest.mark.usefixtures("virtual")
def test_no_file_of_a_run_is_refused_only_when_it_is_over(
    fraclink: Line, board: Board
) -> None:
    run, serve = (
        "run-realtime design.json --io udp:127.0.0.1:5005",
        "serve-arm design.json --io udp:127.0.0.1:5",
    )
    for line, said in (
        (f"{run} --out run.csv", "out: of another kind of file (got run.csv)"),
        (f"{serve} --out design.json/arm.npz", "out: below design.json"),
        (f"{serve} --out arm.json", "out: of another kind of file (got arm.json)"),
    ):
        code, _, err = fraclink(line)
        assert (code, said in err) == (2, True), err
    assert board.last is None


@pytest.mark.slow
@pytest.mark.usefixtures("virtual")
def test_no_signal_takes_the_motion_of_a_served_arm_away(
    fraclink: Line, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two signals, as from a closed terminal: the first ends the serving, the second
    arrives while the file is written.
    """
    line = f"serve-arm design.json --io udp:127.0.0.1:{free_port()} --duration 0.2"
    keep, serve = boards.saved, boards.lab.serve_arm

    def first(*given: Any, **options: Any) -> Any:
        signal.raise_signal(signal.SIGINT)
        return serve(*given, **options)

    def late(value: object, place: Path) -> Path:
        signal.raise_signal(signal.SIGINT)
        return keep(value, place)

    monkeypatch.setattr(boards, "saved", late)
    # ignored by processes in the background of a shell
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        code, _, err = fraclink(f"{line} --out whole.npz")
        assert (code, len(fl.load("whole.npz", ServedArm).time)) == (0, 10), err
        monkeypatch.setattr(boards.lab, "serve_arm", first)
        code, _, err = fraclink(f"{line} --out none.npz")
        assert (code, len(fl.load("none.npz", ServedArm).time)) == (0, 0), err
    finally:
        signal.signal(signal.SIGINT, handler)


@pytest.mark.slow
def test_on_another_system_an_arm_is_refused_with_its_file(
    fraclink: Line, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_kernels, "REALTIME", False)
    monkeypatch.delattr(_kernels, "realtime_watch_signals")
    for more in ("", " --out arm.npz"):
        code, _, err = fraclink(f"serve-arm design.json --io udp:127.0.0.1:5005{more}")
        assert (code, "system: without clock_nanosleep" in err) == (2, True), err
    assert [item.name for item in tmp_path.iterdir()] == ["design.json"]


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as plug:
        plug.bind(("127.0.0.1", 0))
        return int(plug.getsockname()[1])


# The command line, with its loop on the clock of this process.
ARM = """
    import sys
    from fraclink import _cli, _kernels
    from virtual_clock import RemoteClock
    clock = RemoteClock(int(sys.argv.pop(1)))
    machine = _kernels.RealtimeClock
    _kernels.RealtimeClock = lambda given: machine(clock)
    code = _cli.main(["serve-arm", "design.json", *sys.argv[1:]])
    clock.leave()
    sys.exit(code)
"""


@contextmanager
def arm_process(
    threads: int, *more: str
) -> Iterator[tuple[subprocess.Popen[str], Any]]:
    """Serve an arm in another process, which always ends with the block. Yields it and
    the clock on which `threads` take turns, the arm being one of them, so that none can
    be late.

    Yields it and the clock that `threads` take turns on, the arm's being one of them:
    nobody can be late.
    """
    clock = VirtualClock(threads)
    here, there = multiprocessing.Pipe()
    clock.serve(here)
    file = there.fileno()
    command = [sys.executable, "-c", textwrap.dedent(ARM), str(file), *more]
    with subprocess.Popen(  # noqa: S603
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        pass_fds=(file,),
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parent)},
    ) as arm:
        there.close()
        try:
            assert arm.stderr is not None
            # however long the start takes
            assert "an arm at" in arm.stderr.readline()
            yield arm, clock
        finally:
            arm.kill()
    assert not clock.stalled


@pytest.mark.slow
def test_an_arm_in_another_process(
    fraclink: Line, monkeypatch: pytest.MonkeyPatch
) -> None:
    io = f"udp:127.0.0.1:{free_port()}"
    with arm_process(2, "--io", io, "--once", "--out", "arm.npz", "--json") as (
        arm,
        clock,
    ):
        machine = _kernels.RealtimeClock
        monkeypatch.setattr(_kernels, "RealtimeClock", lambda given: machine(clock))
        line = f"run-realtime design.json --io {io} --amplitude 0.2 --duration 2 --patience 60 --json"
        code, out, err = fraclink(line)
        clock.leave()
        printed, arms = arm.communicate()
    told, ran = json.loads(printed), json.loads(out)
    assert (code, ran["passed"], ran["stopped"], ran["replays"]) == (
        0,
        True,
        "finished",
        True,
    ), err
    assert (ran["periods"], ran["missed"], ran["overruns"], ran["lost_samples"]) == (
        101,
        0,
        0,
        0,
    )
    assert (arm.returncode, told["controllers"], told["silences"], told["late"]) == (
        0,
        1,
        0,
        0,
    ), arms
    served = fl.load("arm.npz", ServedArm)
    assert served.tip_angle[-1] == pytest.approx(told["last_tip_angle"])
    assert told["last_tip_angle"] == pytest.approx(0.2, abs=0.02)


@pytest.mark.slow
def test_an_arm_that_freezes_is_given_up_and_can_be_ended(
    fraclink: Line, monkeypatch: pytest.MonkeyPatch
) -> None:
    io = f"udp:127.0.0.1:{free_port()}"
    with arm_process(3, "--io", io, "--json") as (arm, clock):
        machine = _kernels.RealtimeClock
        monkeypatch.setattr(_kernels, "RealtimeClock", lambda given: machine(clock))

        def freeze() -> None:
            # half a second passes before the run, to measure the timing of the machine
            clock.sleep(1.0)
            arm.send_signal(signal.SIGSTOP)
            os.waitid(os.P_PID, arm.pid, os.WSTOPPED | os.WNOWAIT)
            clock.leave()
            clock.leave()  # for the arm, whose turn never ends

        frost = threading.Thread(target=freeze)
        frost.start()
        code, out, err = fraclink(
            f"run-realtime design.json --io {io} --duration 9 --patience 60 --json"
        )
        frost.join()
        clock.leave()
        arm.send_signal(signal.SIGTERM)  # pending until the process continues
        arm.send_signal(signal.SIGCONT)
        printed, arms = arm.communicate()
    told, ran = json.loads(printed), json.loads(out)
    assert (code, ran["stopped"], ran["replays"], ran["missed"]) == (
        1,
        "law off",
        True,
        0,
    ), err
    run = fl.load("realtime.npz", RealtimeRun)
    assert run.problem.endswith("(encoder)")
    assert 20 < len(run.tick) < 40  # up to the freeze and five more periods
    assert (arm.returncode, told["controllers"]) == (0, 1), arms


@pytest.mark.slow
def test_ctrl_z_ends_an_arm_and_does_not_only_stop_it(fraclink: Line) -> None:
    with arm_process(2, "--io", f"udp:127.0.0.1:{free_port()}", "--json") as (
        arm,
        clock,
    ):
        clock.sleep(0.1)  # the arm is running
        arm.send_signal(signal.SIGTSTP)
        clock.leave()
        printed, arms = arm.communicate()
    assert (arm.returncode, json.loads(printed)["controllers"]) == (0, 0), arms
