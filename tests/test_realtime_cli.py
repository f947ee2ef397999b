"""run-realtime, serve-arm and export io, as a user calls them: libraries in C, an arm
in another process.

The loops run on a virtual clock, which two processes may share: a busy machine changes
nothing.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
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
from fraclink import _kernels
from fraclink._arm.motor_loop import MotorLoop
from fraclink._cli import boards, main
from fraclink._export import export_io
from fraclink._law import REASONS
from fraclink._simulate import geared
from fraclink.errors import FieldError
from fraclink.lab._arm import ServedArm
from fraclink.lab._connections import Library, Udp
from fraclink.lab._loop import run_realtime
from fraclink.lab._run import RealtimeRun
from fraclink.trials._study import load_study
from needed_tools import tool

if not _kernels.REALTIME:
    pytest.skip("the real-time loop is Linux's", allow_module_level=True)

Command = Callable[[str], tuple[int, str, str]]
STRICT = (
    "-std=c99",
    "-pedantic",
    "-Wall",
    "-Wextra",
    "-Wconversion",
    "-Wno-unused-parameter",
    "-Werror",
)
PERIOD = 0.02
MANY = 1_000_000

# A motor that follows a voltage or, as a servo, a reference; one sample is lost, the
# last command is noted.
BOARD = """
#include "arm_io.h"
#include <math.h>
#include <signal.h>
#include <stdio.h>
static double angle;
static double voltage;
static double reference;
static int reads;
static int deep(int level)
{
    volatile char room[4096];
    room[0] = (char)level;
    return (level < 0) ? 0 : deep(level + 1) + room[0];
}
uint32_t arm_io_version(void) { return VERSION; }
int arm_open(void) { return OPENED; }
int arm_read(arm_sample *sample)
{
    angle += (voltage != 0.0) ? (0.02 * voltage) : (0.5 * (reference - angle));
    sample->motor_angle = angle;
    sample->torque = 0.001 * (reads % 2); /* alive: one that never changes is a stuck gauge */
    reads++;
    if (reads >= BROKEN)
        return -1;
    if (reads >= CRASH)
        raise(SIGSEGV);
    if (reads >= DEEP)
        reads = deep(0);
    return reads == 5;
}
int arm_write(const arm_command *command)
{
    voltage = command->voltage;
    reference = command->motor_reference;
    FILE *const file = fopen("last", "w");
    (void)fprintf(file, "%u %.17g", (unsigned)command->mode, command->voltage);
    return fclose(file);
}
void arm_close(void)
{
    FILE *const file = fopen("closed", "w");
    (void)fclose(file);
}
"""


@pytest.fixture(scope="module")
def design(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rig = geared(replace(fl.Rig.named("paper-2023"), period=PERIOD))
    assert rig.model is not None
    design = fl.design(
        rig.model, rig, gain_crossover=12.0, phase_margin=fl.deg(20), filter_time=0.0
    )
    slow = replace(design.controller, inner=MotorLoop(pole=20.0))
    place = tmp_path_factory.mktemp("design") / "design.json"
    replace(design, controller=slow).save(place)
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
) -> Command:
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
    """The loop's clock is one on which this thread is alone."""
    clock = _kernels.RealtimeClock
    monkeypatch.setattr(
        _kernels, "RealtimeClock", lambda threads: clock(max(threads, 1))
    )


def compiled(folder: Path, name: str, text: str, **defines: object) -> Path:
    (folder / f"{name}.c").write_text(text, encoding="utf-8")
    library = folder / f"{name}.so"
    given = {
        "VERSION": "ARM_IO_VERSION",
        "OPENED": 0,
        "BROKEN": MANY,
        "CRASH": MANY,
        "DEEP": MANY,
    } | defines
    flags = [f"-D{key}={value}" for key, value in given.items()]
    subprocess.run(  # noqa: S603
        [
            tool("cc", "gcc"),
            *STRICT,
            "-shared",
            "-fPIC",
            *flags,
            f"{name}.c",
            "-o",
            library,
        ],
        cwd=folder,
        check=True,
    )
    return library


@pytest.mark.slow
@pytest.mark.usefixtures("virtual")
def test_the_template_compiles_and_stands_still(
    fraclink: Command, tmp_path: Path
) -> None:
    code, out, _ = fraclink("export io --out board")
    assert (code, out.split()) == (0, ["board/arm_io.h", "board/my_board.c"])
    text = (tmp_path / "board" / "my_board.c").read_text("utf-8")
    compiled(tmp_path / "board", "my_board", text)
    line = "run-realtime design.json --io library:board/my_board.so --amplitude 0 --duration 0.2 --log log.csv"
    code, out, err = fraclink(f"{line} --force")
    assert code == 0, out + err
    assert "the record replays through the law to the last bit" in out
    assert "written: realtime.npz" in err
    lines = (tmp_path / "log.csv").read_text("utf-8").splitlines()
    assert "time_s,motor_angle_rad,torque_Nm" in lines
    assert float(lines[-1].split(",")[0]) == pytest.approx(0.2)
    assert fraclink("export io --out board")[0] == 2  # never over the user's work
    assert fraclink("export io --out board --force")[0] == 0
    # the header is C++ too
    cxx = [
        tool("c++", "g++"),
        "-fsyntax-only",
        "-Wall",
        "-Werror",
        "-x",
        "c++",
        "my_board.c",
    ]
    subprocess.run(cxx, cwd=tmp_path / "board", check=True)  # noqa: S603


@pytest.mark.slow
@pytest.mark.usefixtures("virtual")
def test_a_period_that_the_machine_does_not_keep_is_refused_before_anything_moves(
    fraclink: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It says what it measured: 0 µs on the virtual clock, then three of 250 wake-ups a
    period late.
    """
    export_io(tmp_path, force=True)
    compiled(tmp_path, "arm", BOARD)
    line = "run-realtime design.json --io library:arm.so --amplitude 0 --duration 0.1"
    assert "wake-ups 0 µs late on average, 0 µs at most" in (
        err := fraclink(line)[2]
    ), err
    assert "20 ms can be kept" in err
    (tmp_path / "last").unlink()
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
    assert not (tmp_path / "last").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("virtual")
def test_a_key_comes_from_a_file_and_only_for_datagrams(
    fraclink: Command, tmp_path: Path
) -> None:
    (tmp_path / "short").write_bytes(b"secret")
    for options, said in (
        ("--io udp:127.0.0.1:5005 --key-file short", "key: not a key (got 6 bytes)"),
        ("--io udp:127.0.0.1:5005 --key-file nowhere", "nowhere"),
        ("--io shm:arm --key-file short", "key: of no use here"),
    ):
        for command in ("run-realtime", "serve-arm"):
            code, _, err = fraclink(f"{command} design.json {options}")
            assert (code, said in err, "secret" in err) == (2, True, False), err


@pytest.mark.slow
@pytest.mark.usefixtures("virtual")
def test_a_library_is_run_and_left_in_order(fraclink: Command, tmp_path: Path) -> None:
    export_io(tmp_path, force=True)
    compiled(tmp_path, "arm", BOARD)
    line = "run-realtime design.json --io library:arm.so --amplitude 0.05 --move-time 0.5 --duration 0.6"
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
    assert (tmp_path / "last").read_text() == "4 0"  # off, without voltage
    assert (tmp_path / "closed").is_file()
    assert fraclink(line)[0] == 2  # the record is kept
    shutil.copy(
        "arm.so", "anew.so"
    )  # a library that is loaded already has its samples behind it
    code, out, err = fraclink(f"{line.replace('arm', 'anew')} --force --log log.csv")
    assert code == 1
    assert "samples); expected 1 %" in err
    assert not (tmp_path / "log.csv").exists()
    assert "passed" in out  # the run itself
    assert fraclink(f"{line} --force --single --no-motor")[0] == 0
    assert not fl.load("realtime.npz", RealtimeRun).voltage.any()
    # a record among the results of the other stages does not hinder their report
    assert load_study(tmp_path).design is not None


@pytest.mark.slow
@pytest.mark.usefixtures("virtual")
def test_a_reference_to_identify_from(fraclink: Command, tmp_path: Path) -> None:
    export_io(tmp_path, force=True)
    compiled(tmp_path, "arm", BOARD)
    line = "run-realtime design.json --io library:arm.so --excitation prbs --amplitude 0.1 --duration 1.5"
    fraclink(f"{line} --no-motor")
    run = fl.load("realtime.npz", RealtimeRun)
    # at rest for half a second; a register of ones makes the first nine bits alike
    assert run.reference.tolist() == pytest.approx(
        (0.1 * (run.time >= 0.4999)).tolist()
    )


@pytest.mark.slow
@pytest.mark.usefixtures("virtual")
def test_a_library_that_breaks_is_a_safe_stop(
    fraclink: Command, tmp_path: Path
) -> None:
    export_io(tmp_path, force=True)
    compiled(tmp_path, "arm", BOARD, BROKEN=9)
    code, out, _ = fraclink("run-realtime design.json --io library:arm.so --duration 5")
    assert code == 1
    assert out.splitlines()[-1] == "stopped: safe stop: connection failed"
    assert (tmp_path / "last").read_text() == "4 0"
    assert (
        len(fl.load("realtime.npz", RealtimeRun).time) == 7
    )  # the first read found the arm, the ninth failed


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
        ("shm:", "not a name"),
        ("shm:../etc", "not a name"),
        ("library:", "no way to an arm"),
        ("serial:", "without a port"),
        ("serial:/dev/ttyUSB0@fast", "without a speed"),
        ("", "no way to an arm"),
    ],
)
def test_ways_that_lead_nowhere(
    fraclink: Command, tmp_path: Path, io: str, said: str
) -> None:
    code = main(["run-realtime", "design.json", "--io", io, "--patience", "0.05"])
    assert code == 2
    assert not (tmp_path / "realtime.npz").exists()
    _, _, err = fraclink("--version")
    assert said in err
    assert len(err.strip().splitlines()) == 1


@pytest.mark.slow
def test_ways_that_fail_when_they_are_opened(
    law: fl.Law, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    export_io(tmp_path)
    for name, text, defines in (
        ("newer", BOARD, {"VERSION": 7}),
        ("asleep", BOARD, {"OPENED": 3}),
        ("bare", "int nothing;\n", {}),
    ):
        compiled(tmp_path, name, text, **defines)
    for way, said in (
        (Library(Path("newer.so")), r"made for version 7 of arm_io\.h"),
        (Library(Path("asleep.so")), r"not ready: arm_open gave 3"),
        (Library(Path("bare.so")), r"without arm_read, arm_write and arm_io_version"),
        (Library(Path("nowhere.so")), r"not to be loaded"),
        (Library(Path("arm_io.h")), r"not to be loaded"),
        (
            Udp("no-such-host.invalid", 5005),
            r"io: refused \(.*\(got udp:no-such-host\.invalid:5005\)",
        ),
    ):
        with pytest.raises(FieldError, match=said):
            run_realtime(law, fl.extend.hold(0.0), way, patience=0.05)
    assert not (tmp_path / "last").exists()


CRASHING = """
    import sys
    from pathlib import Path
    import fraclink as fl
    from fraclink.lab._connections import Library
    from fraclink.lab._loop import run_realtime
    law = fl.Design.load("design.json").law(order=4)
    run_realtime(law, fl.extend.hold(0.0), Library(Path(sys.argv[1])), priority=0, duration=5.0)
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "fault", ["CRASH", "DEEP"]
)  # a call without end leaves no stack to stop the arm on
def test_a_process_that_crashes_leaves_a_stop_behind(
    fraclink: Command, tmp_path: Path, fault: str
) -> None:
    export_io(tmp_path, force=True)
    board = compiled(tmp_path, "arm", BOARD, **{fault: 9})
    command = [sys.executable, "-c", textwrap.dedent(CRASHING), str(board)]
    assert subprocess.run(command, check=False).returncode == -signal.SIGSEGV  # noqa: S603
    assert (tmp_path / "last").read_text() == "4 0"
    assert not (tmp_path / "closed").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("virtual")
def test_the_record_has_a_place_before_the_arm_moves_or_nothing_happens(
    fraclink: Command, tmp_path: Path
) -> None:
    export_io(tmp_path, force=True)
    compiled(tmp_path, "arm", BOARD)
    code, _, err = fraclink(
        "run-realtime design.json --io library:arm.so --out /proc/nope/r.npz"
    )
    assert (code, "the arm has not moved" in err) == (2, True)
    assert not (tmp_path / "last").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("virtual")
def test_no_file_of_a_run_is_refused_only_when_it_is_over(
    fraclink: Command, tmp_path: Path
) -> None:
    export_io(tmp_path, force=True)
    compiled(tmp_path, "arm", BOARD)
    run, serve = (
        "run-realtime design.json --io library:arm.so",
        "serve-arm design.json --io udp:127.0.0.1:5",
    )
    for line, said in (
        (f"{run} --log /proc/nope/log.csv", "log: not writable"),
        (f"{run} --out run.csv", "out: of another kind of file (got run.csv)"),
        (f"{serve} --out /proc/nope/arm.npz", "out: not writable"),
        (f"{serve} --out arm.json", "out: of another kind of file (got arm.json)"),
    ):
        code, _, err = fraclink(line)
        assert (code, said in err) == (2, True), err
    assert not (tmp_path / "last").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("virtual")
def test_no_signal_takes_the_motion_of_a_served_arm_away(
    fraclink: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two of them, as a closed terminal sends: one that ends the serving, and one as it
    is written.
    """
    line = (
        f"serve-arm design.json --io shm:kept-{os.getpid()} --priority 0 --duration 0.2"
    )
    keep, hold = boards.saved, boards.reserved

    def first(*given: Any, **options: Any) -> Any:
        signal.raise_signal(signal.SIGINT)
        return hold(*given, **options)

    def late(value: object, place: Path) -> Path:
        signal.raise_signal(signal.SIGINT)
        return keep(value, place)

    monkeypatch.setattr(boards, "saved", late)
    handler = signal.signal(
        signal.SIGINT, signal.default_int_handler
    )  # ignored in the background of a shell
    try:
        code, _, err = fraclink(f"{line} --out whole.npz")
        assert (code, len(fl.load("whole.npz", ServedArm).time)) == (0, 10), err
        monkeypatch.setattr(boards, "reserved", first)
        code, _, err = fraclink(f"{line} --out none.npz")
        assert (code, len(fl.load("none.npz", ServedArm).time)) == (0, 0), err
    finally:
        signal.signal(signal.SIGINT, handler)


@pytest.mark.slow
def test_on_another_system_an_arm_is_refused_with_its_file(
    fraclink: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_kernels, "REALTIME", False)
    monkeypatch.delattr(os, "posix_fallocate")
    monkeypatch.delattr(_kernels, "realtime_watch_signals")
    for more in ("", " --out arm.npz"):
        code, _, err = fraclink(f"serve-arm design.json --io udp:127.0.0.1:5005{more}")
        assert (code, "system: without clock_nanosleep" in err) == (2, True), err
    assert [item.name for item in tmp_path.iterdir()] == ["design.json"]


@pytest.mark.slow
def test_another_machine_needs_a_word(fraclink: Command) -> None:
    for command in ("run-realtime", "serve-arm"):
        code, _, err = fraclink(f"{command} design.json --io udp:203.0.113.7:5005")
        assert (code, "not this machine" in err, "--unsafe-remote" in err) == (
            2,
            True,
            True,
        )
    code, _, err = fraclink(
        "serve-arm design.json --io udp:203.0.113.7:5005 --unsafe-remote"
    )
    assert (code, "refused" in err) == (2, True)  # nobody's address


# The command line, with its loop on the clock in a file that this process keeps.
ARM = """
    import sys
    from fraclink import _cli, _kernels
    clock = _kernels.RealtimeClock(0, int(sys.argv.pop(1)))
    _kernels.RealtimeClock = lambda threads: clock
    code = _cli.main(["serve-arm", "design.json", "--link-mass", "0.00735", *sys.argv[1:]])
    clock.leave()
    sys.exit(code)
"""


@contextmanager
def arm_process(
    threads: int, *more: str
) -> Iterator[tuple[subprocess.Popen[str], Any]]:
    """Serve an arm in another process, which ends with the block whatever happens in
    it.

    Yields it and the clock that `threads` take turns on, the arm's being one of them:
    nobody can be late.
    """
    file = os.memfd_create("clock")
    clock = _kernels.RealtimeClock(threads, file)
    command = [sys.executable, "-c", textwrap.dedent(ARM), str(file), *more]
    with subprocess.Popen(  # noqa: S603
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        pass_fds=(file,),
    ) as arm:
        try:
            assert arm.stderr is not None
            assert (
                "an arm at" in arm.stderr.readline()
            )  # however long it takes to start
            yield arm, clock
        finally:
            arm.kill()
            os.close(file)
    assert not clock.stalled


@pytest.mark.slow
def test_an_arm_in_another_process(
    fraclink: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    io = f"shm:cli-{os.getpid()}"
    with arm_process(2, "--io", io, "--once", "--out", "arm.npz", "--json") as (
        arm,
        clock,
    ):
        monkeypatch.setattr(_kernels, "RealtimeClock", lambda threads: clock)
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
    fraclink: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    io = f"shm:ice-{os.getpid()}"
    place = Path(f"/dev/shm/fraclink-{io.removeprefix('shm:')}")  # noqa: S108
    with arm_process(3, "--io", io, "--json") as (arm, clock):
        monkeypatch.setattr(_kernels, "RealtimeClock", lambda threads: clock)

        def freeze() -> None:
            clock.sleep(
                1.0
            )  # half a second goes by before the run, to see what the machine keeps
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
        arm.send_signal(signal.SIGTERM)  # waits until it goes on
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
    assert REASONS[run.reason[-1]] == "encoder"
    assert 20 < len(run.tick) < 40  # up to the frost and five periods more
    assert (arm.returncode, told["controllers"]) == (0, 1), arms
    assert not place.exists()


@pytest.mark.slow
def test_ctrl_z_ends_an_arm_and_does_not_only_stop_it(fraclink: Command) -> None:
    with arm_process(2, "--io", f"shm:end-{os.getpid()}", "--json") as (arm, clock):
        clock.sleep(0.1)  # it runs
        arm.send_signal(signal.SIGTSTP)
        clock.leave()
        printed, arms = arm.communicate()
    assert (arm.returncode, json.loads(printed)["controllers"]) == (0, 0), arms
