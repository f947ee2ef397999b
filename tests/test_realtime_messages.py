"""Controller and simulated arm by messages: the documented bytes, one controller at a time, silence.

Arm and controller run in two threads of this process (both leave the interpreter alone while they run), or
one of them is a few lines of Python that speak the format of docs/reference/file-formats.md.
"""

from __future__ import annotations

import math
import os
import random
import socket
import struct
import threading
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fraclink as fl
from fraclink import _kernels
from fraclink._arm.motor_loop import MotorLoop
from fraclink._law import REASONS, Law, equip
from fraclink._realtime import Library, RealtimeRun, ServedArm, SharedMemory, Udp, run_realtime, serve_arm
from fraclink._simulate import Twin, geared
from fraclink.errors import FieldError, FileFormatError, SizeError

if not _kernels.REALTIME:
    pytest.skip("the real-time loop is Linux's", allow_module_level=True)

PERIOD = 0.02  # half of it is the margin: a busy machine rarely wakes up 10 ms late
OFF = 4
MESSAGE = "<4sHHIIddIII"  # without its checksum
Way = Udp | SharedMemory


@pytest.fixture(scope="module")
def rig() -> fl.Rig:
    return geared(replace(fl.Rig.named("paper-2023"), period=PERIOD))


@pytest.fixture(scope="module")
def law(rig: fl.Rig) -> Law:
    slow_motor = MotorLoop(pole=20.0)  # what a period of 20 ms can close
    controller = fl.Controller(gain=0.069876, order=0.612197, link=rig.model, inner=slow_motor)
    assert rig.model is not None
    return equip(controller.discretize(PERIOD, order=4), rig, rig.model)


@pytest.fixture(scope="module")
def twin(rig: fl.Rig) -> Twin:
    arm = Twin.from_rig(rig, link_mass=0.00735)
    return replace(arm, sensors=replace(arm.sensors, gauge_noise=0.0, gauge_offset=0.02))


@pytest.fixture(params=["udp", "shm"])
def way(request: pytest.FixtureRequest) -> Way:
    return Udp("127.0.0.1", free_port()) if request.param == "udp" else SharedMemory(f"test-{os.getpid()}")


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as plug:
        plug.bind(("127.0.0.1", 0))
        return int(plug.getsockname()[1])


@contextmanager
def serving(twin: Twin, way: Way, **options: object) -> Iterator[Callable[[], ServedArm]]:
    """Serve the arm in a thread; yields a function that waits for its end."""
    results: list[ServedArm] = []
    given = {"duration": 10.0, "once": True} | options
    thread = threading.Thread(
        target=lambda: results.append(serve_arm(twin, way, PERIOD, **given))  # type: ignore[arg-type]
    )
    thread.start()

    def ended() -> ServedArm:
        thread.join(15.0)
        return results[0]

    yield ended
    thread.join(15.0)
    assert not thread.is_alive()


def message(kind: int, sequence: int, first: float, second: float, mode: int = 1, tick: int = 0) -> bytes:
    body = struct.pack(MESSAGE, b"FLRT", 1, kind, sequence, tick, first, second, mode, 0, 0)
    return body + struct.pack("<I", zlib.crc32(body))


def await_arm(way: Way) -> None:
    """Wait until somebody serves `way`."""
    for _ in range(500):
        if isinstance(way, SharedMemory):
            place = Path(f"/dev/shm/fraclink-{way.name}")  # noqa: S108
            # it gets its size once the arm holds it
            if place.exists() and place.stat().st_size == _kernels.realtime_memory_size():
                return
        else:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as plug:
                try:
                    plug.bind((way.host, way.port))
                except OSError:
                    return
        time.sleep(0.01)
    pytest.fail(f"nobody serves {way}")


def greet(plug: socket.socket, way: Udp) -> bytes:
    """Knock until the arm answers, and return its first sample."""
    plug.connect((way.host, way.port))
    plug.settimeout(PERIOD)
    for _ in range(500):
        try:
            plug.send(message(2, 1, 0.0, 0.0, mode=0))
            return plug.recv(100)
        except (TimeoutError, ConnectionRefusedError):
            time.sleep(0.01)
    pytest.fail("the arm never answered")


def undisturbed(run: RealtimeRun) -> int:
    """How many periods ran before the machine lost the first one."""
    lost = np.flatnonzero(np.isnan(run.motor_angle) | (run.tick != np.arange(1, len(run.tick) + 1)))
    return int(lost[0]) if lost.size else len(run.tick)


def test_the_arm_in_real_time_is_the_twin_to_the_last_bit(law: Law, twin: Twin, way: Way) -> None:
    move = fl.smooth_step(0.3, 1.0)
    wanted = fl.simulate(law, move, arm=twin, duration=1.0)
    for _ in range(5):  # a busy machine may lose periods at once; what ran before is compared
        with serving(twin, way) as ended:
            run = run_realtime(law, move, way, duration=0.5)
        assert run.first_difference is None
        assert ended().silences == 0
        alike = undisturbed(run)
        for name, other in (
            ("motor_angle", "motor_angle_measured"),
            ("torque", "torque_measured"),
            ("motor_reference", "motor_reference"),
        ):
            got, expected = getattr(run, name)[:alike], getattr(wanted, other)[:alike]
            assert got.tobytes() == expected.tobytes(), name
        if alike >= 15:
            assert run.motor_angle[alike - 1] > 0.01
            return
    pytest.fail("the machine lost a sample within 15 periods, five times in a row")


def test_a_longer_delay_is_waited_out_by_the_arm(law: Law, twin: Twin) -> None:
    way = Udp("127.0.0.1", free_port())
    slow = replace(twin, voltage_delay=3)
    with serving(slow, way) as ended, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as plug:
        answered = struct.unpack(MESSAGE, greet(plug, way)[:44])[4]  # the arm's period of the sample
        plug.send(message(2, 2, 0.0, 3.0))
        plug.settimeout(5.0)
        for _ in range(5):
            plug.recv(100)
        plug.send(message(2, 3, 0.0, 0.0, mode=OFF))
    acted = int(np.flatnonzero(ended().voltage == 3.0)[0])
    assert acted - answered >= 3
    with pytest.raises(FieldError, match="voltage_delay"):
        serve_arm(replace(twin, voltage_delay=0), way, PERIOD)


def test_an_arm_that_dies_is_given_up_by_the_law(law: Law, twin: Twin, way: Way) -> None:
    with serving(twin, way, duration=0.4, once=False):
        run = run_realtime(law, fl.smooth_step(0.3, 1.0), way, duration=5.0)
    assert (run.stopped, REASONS[run.reason[-1]]) == ("law off", "encoder")
    assert np.isnan(run.motor_angle[-law.limits.bad_limit :]).all()
    assert run.voltage[-1] == 0.0
    assert run.first_difference is None


def test_a_controller_that_dies_is_replaced_by_the_watchdog(twin: Twin) -> None:
    way = Udp("127.0.0.1", free_port())
    with serving(twin, way, watchdog=10) as ended, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as plug:
        greet(plug, way)
        for sequence in range(2, 20):
            plug.send(message(2, sequence, 0.0, 3.0))
            time.sleep(0.5 * PERIOD)
    served = ended()
    assert (served.controllers, served.silences, served.passed) == (1, 1, False)
    driven = np.flatnonzero(served.voltage == 3.0)
    assert len(driven) >= 10  # the watchdog's periods among them, in which the last voltage acts
    assert served.motor_angle.max() > 0.01
    assert set(served.voltage) == {0.0, 3.0}


def test_the_bytes_on_the_wire_are_the_documented_ones(twin: Twin) -> None:
    way = Udp("127.0.0.1", free_port())
    with serving(twin, way) as ended, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as plug:
        first = greet(plug, way)
        plug.settimeout(5.0)
        samples = [first, plug.recv(100), plug.recv(100)]
        plug.send(message(2, 2, 0.0, 0.0, mode=OFF))
    numbers = []
    for sample in samples:
        assert len(sample) == 48
        assert struct.unpack("<I", sample[44:]) == (zlib.crc32(sample[:44]),)
        magic, version, kind, sequence, tick, angle, _, period, *rest = struct.unpack(MESSAGE, sample[:44])
        assert (magic, version, kind, period, rest) == (b"FLRT", 1, 1, 20_000_000, [0, 0])
        assert angle == 0.0
        numbers.append((sequence, tick))
    assert np.all(np.diff(np.array(numbers), axis=0) == 1)
    assert ended().passed


def test_what_is_damaged_late_or_from_somebody_else_changes_nothing(twin: Twin) -> None:
    """Every message that must be dropped would drive the arm with 5 V if it were heard."""
    way = Udp("127.0.0.1", free_port())
    plugs = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2)]
    drive = message(2, 10_000, 0.0, 5.0)
    noise = random.Random(7)  # noqa: S311  # not a secret
    flipped = [
        drive[:at] + bytes([drive[at] ^ 1 << noise.randrange(8)]) + drive[at + 1 :] for at in range(48)
    ]
    wrong = [
        b"",
        drive[:47],
        drive + b"\0",
        noise.randbytes(48),
        message(1, 10_000, 0.0, 5.0),  # a sample where a command is due
        message(2, 1, 0.0, 5.0),  # a step back
        *flipped,
    ]
    with serving(twin, way) as ended, plugs[0] as controller, plugs[1] as stranger:
        greet(controller, way)
        controller.send(message(2, 1000, 0.0, 0.0))
        time.sleep(2 * PERIOD)
        stranger.connect((way.host, way.port))
        for number, bad in enumerate(wrong):
            controller.send(message(2, 1001 + number, 0.0, 0.0))  # it is not silent
            controller.send(bad)
            stranger.send(drive)
            time.sleep(1.2 * PERIOD)
        controller.send(message(2, 20_000, math.nan, math.inf, mode=OFF))
    served = ended()
    assert set(served.voltage) == {0.0}
    assert served.rejected == 2 * len(wrong)
    assert (served.controllers, served.silences) == (1, 0)


def test_the_next_controller_is_welcome_and_its_count_may_begin_anew(law: Law, twin: Twin, way: Way) -> None:
    results: list[ServedArm] = []
    thread = threading.Thread(target=lambda: results.append(serve_arm(twin, way, PERIOD, duration=1.8)))
    thread.start()
    runs = [run_realtime(law, fl.smooth_step(0.1, 0.4), way, duration=0.5) for _ in range(2)]
    thread.join(15.0)
    assert [run.stopped for run in runs] == ["finished", "finished"]
    assert (results[0].controllers, results[0].silences, results[0].rejected) == (2, 0, 0)
    # the second move begins where the first one ended
    assert runs[1].origin == pytest.approx(
        runs[0].motor_angle[np.isfinite(runs[0].motor_angle)][-1], abs=0.05
    )


def test_periods_that_differ_are_refused(law: Law, twin: Twin, way: Way) -> None:
    results: list[ServedArm] = []
    thread = threading.Thread(
        target=lambda: results.append(serve_arm(twin, way, 0.025, duration=1.0, once=True))
    )
    thread.start()
    with pytest.raises(FieldError, match=r"period: not the arm's \(got 0\.02\); expected 0\.025 s"):
        run_realtime(law, fl.hold(0.0), way)
    thread.join(15.0)
    assert results[0].silences == 0


def test_nobody_there_and_somebody_there_already(law: Law, twin: Twin, way: Way) -> None:
    with pytest.raises(FieldError, match=r"silent|served by no arm") as caught:
        run_realtime(law, fl.hold(0.0), way, patience=0.1)
    assert caught.value.value == str(way)
    assert "fraclink serve-arm" in caught.value.remedy
    with serving(twin, way, duration=1.0, once=False):
        await_arm(way)
        with pytest.raises(FieldError) as busy:
            serve_arm(twin, way, PERIOD, duration=0.1)
    assert busy.value.field == "io"


def test_one_controller_at_a_time_in_shared_memory(law: Law, twin: Twin) -> None:
    way = SharedMemory(f"one-{os.getpid()}")
    refused: list[FieldError] = []

    def second() -> None:
        time.sleep(0.2)
        with pytest.raises(FieldError) as caught:
            run_realtime(law, fl.hold(0.0), way, duration=0.1)
        refused.append(caught.value)

    thread = threading.Thread(target=second)
    with serving(twin, way):
        thread.start()
        run = run_realtime(law, fl.hold(0.0), way, duration=0.5)
        thread.join(5.0)
    assert run.stopped == "finished"
    assert "another controller" in str(refused[0])


def test_shared_memory_is_private_and_leaves_nothing_behind(law: Law, twin: Twin) -> None:
    way = SharedMemory(f"left-{os.getpid()}")
    place = Path("/dev/shm") / f"fraclink-{way.name}"  # noqa: S108
    place.write_bytes(b"\xff" * 512)  # an arm that was killed, of another release
    with serving(twin, way):
        run = run_realtime(law, fl.hold(0.0), way, duration=0.1)
    assert run.stopped == "finished"
    assert not place.exists()
    with serving(twin, way, duration=1.0, once=False):
        await_arm(way)
        assert place.stat().st_mode & 0o077 == 0
    place.symlink_to("elsewhere")
    try:
        with pytest.raises(FieldError, match="refused"):
            serve_arm(twin, way, PERIOD, duration=0.1)
    finally:
        place.unlink()


def test_a_command_from_before_a_kill_is_not_obeyed(twin: Twin) -> None:
    way = SharedMemory(f"stale-{os.getpid()}")
    slot = struct.pack("<I60x", 2) + message(2, 7, 0.0, 5.0) + bytes(16)  # turn, and at byte 64 the message
    (Path("/dev/shm") / f"fraclink-{way.name}").write_bytes(bytes(128) + slot)  # noqa: S108
    served = serve_arm(twin, way, PERIOD, duration=0.2)
    assert (served.controllers, served.rejected, set(served.voltage)) == (0, 0, {0.0})


def test_the_record_of_the_arm_comes_back(law: Law, twin: Twin, way: Way, tmp_path: Path) -> None:
    with serving(twin, way) as ended:
        run_realtime(law, fl.hold(0.0), way, duration=0.1)
    served = ended()
    served.save(tmp_path / "arm.npz")
    again = ServedArm.load(tmp_path / "arm.npz")
    assert again.voltage.tobytes() == served.voltage.tobytes()
    assert (again.period, again.late, again.scheduling) == (PERIOD, served.late, served.scheduling)
    assert again.time[-1] == pytest.approx(PERIOD * (len(again.voltage) - 1))
    with pytest.raises(FileFormatError, match="kind"):
        RealtimeRun.load(tmp_path / "arm.npz")


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"duration": 0.0}, "duration"),
        ({"watchdog": 0}, "watchdog"),
        ({"seed": -1}, "seed"),
        ({"priority": 100}, "priority"),
    ],
)
def test_bad_values_are_named(twin: Twin, options: dict[str, object], field: str) -> None:
    with pytest.raises(FieldError) as caught:
        serve_arm(twin, SharedMemory("bad"), PERIOD, **options)  # type: ignore[arg-type]
    assert caught.value.field == field


def test_more_is_refused_before_memory_is_taken(twin: Twin) -> None:
    with pytest.raises(SizeError):
        serve_arm(twin, SharedMemory("long"), PERIOD, duration=1e5)
    with pytest.raises(FieldError, match="no way to serve an arm"):
        serve_arm(twin, Library(Path("board.so")), PERIOD)  # type: ignore[arg-type]
    with pytest.raises(FieldError, match="refused"):
        serve_arm(twin, Udp("203.0.113.7", 5005), PERIOD)  # an address of nobody's, kept for documentation
