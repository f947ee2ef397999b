"""Messages between a controller and a simulated arm: the documented bytes, one
controller at a time, silence.

Arm and controller run in two threads of this process, or one of them is a few lines of
Python that speak the format of docs/reference/file-formats.md. They take turns on a
virtual clock, so that the load of the machine has no effect.
"""

from __future__ import annotations

import contextlib
import hashlib
import hmac
import math
import random
import socket
import struct
import sys
import threading
import zlib
from dataclasses import replace

import numpy as np
import pytest

import fraclink as fl
from fraclink import Callback, Law, MotorLoop, Reference, Twin
from fraclink.errors import FieldError
from fraclink.extend import equip, geared
from fraclink.lab import RealtimeRun, ServedArm, Udp, run_realtime, serve_arm
from fraclink.lab._connections import arm_end
from virtual_clock import VirtualClock

if sys.platform != "linux":
    pytest.skip("the real-time loop is Linux's", allow_module_level=True)

PERIOD = 0.02
OFF = 4
MESSAGE = "<4sHHIIddIIIQ"  # without its checksum


@pytest.fixture(scope="module")
def rig() -> fl.Rig:
    return geared(replace(fl.Rig.named("paper-2023"), period=PERIOD))


@pytest.fixture(scope="module")
def law(rig: fl.Rig) -> Law:
    # a loop that can be closed with a period of 20 ms
    slow_motor = MotorLoop(pole=20.0)
    controller = fl.Controller(
        derivative_gain=0.069876,
        derivative_order=0.612197,
        link=rig.model,
        motor_loop=slow_motor,
    )
    assert rig.model is not None
    return equip(fl.discretize(controller, PERIOD, order=4), rig, rig.model)


@pytest.fixture(scope="module")
def twin(rig: fl.Rig) -> Twin:
    arm = Twin.from_rig(rig, link_mass=0.00735)
    return replace(arm, gauge=replace(arm.gauge, noise=0.0, offset=0.02))


@pytest.fixture
def way() -> Udp:
    return Udp("127.0.0.1", free_port())


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as plug:
        plug.bind(("127.0.0.1", 0))
        return int(plug.getsockname()[1])


class Serving:
    """An arm in a separate thread, and the clock that it shares with the thread of the
    test.
    """

    def __init__(
        self, twin: Twin, way: Udp, period: float = PERIOD, **options: object
    ) -> None:
        self.way, self.clock = way, VirtualClock(2)
        self.results: list[ServedArm] = []
        given = {
            "duration": 10.0,
            "once": True,
            "priority": 0,
            "clock": self.clock,
        } | options

        def serve() -> None:
            try:
                self.results.append(serve_arm(twin, way, period, **given))  # type: ignore[arg-type]
            finally:
                self.clock.leave()

        self.thread = threading.Thread(target=serve)

    def __enter__(self) -> Serving:
        self.thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.clock.leave()  # the arm continues alone until its time is over
        self.thread.join(60.0)
        assert not self.thread.is_alive() and not self.clock.stalled

    @property
    def arm(self) -> ServedArm:
        """The result of the arm, once the block has ended."""
        return self.results[0]

    def control(
        self, law: Law, reference: Reference | None = None, **options: object
    ) -> RealtimeRun:
        """Run a law on the arm."""
        given = {"clock": self.clock, "priority": 0, "lock_memory": False} | options
        return run_realtime(law, reference or fl.extend.hold(0.0), self.way, **given)  # type: ignore[arg-type]


class Peer(socket.socket):
    """A controller in Python: whatever it sends is received by the arm in its next
    period.
    """

    def __init__(self, serving: Serving) -> None:
        super().__init__(socket.AF_INET, socket.SOCK_DGRAM)
        assert isinstance(serving.way, Udp)
        self.address, self.clock, self.run = (
            (serving.way.host, serving.way.port),
            serving.clock,
            0,
        )
        self.key: bytes | None = None
        self.setblocking(False)

    def say(
        self,
        sequence: int,
        voltage: float = 0.0,
        *,
        mode: int = 1,
        run: int | None = None,
    ) -> bytes:
        """Send a command, and wait for slightly more than a period."""
        sent = message(
            2, sequence, 0.0, voltage, mode, self.run if run is None else run
        )
        sent = sent if self.key is None else tagged(sent, self.key)
        self.pass_on(sent)
        return sent

    def pass_on(self, sent: bytes, periods: float = 1.1) -> None:
        """Send bytes unchanged."""
        # caused by the previous message, sent before the arm existed
        with contextlib.suppress(ConnectionRefusedError):
            self.sendto(sent, self.address)
        self.clock.sleep(periods * PERIOD)

    def greet(self) -> bytes:
        """Send requests until the arm replies; return its first sample and adopt the
        number of the run.
        """
        with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
            while self.recv(100):  # samples of the previous run
                pass
        for _ in range(100):
            self.say(1, mode=0, run=0)
            with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
                sample = self.recv(100)
                self.run = struct.unpack(MESSAGE, sample[:52])[-1]
                return sample
        pytest.fail("the arm never answered")


def message(
    kind: int,
    sequence: int,
    first: float,
    second: float,
    mode: int = 1,
    run: int = 0,
    *,
    head: tuple[bytes, int] = (b"FLRT", 2),
) -> bytes:
    body = struct.pack(
        MESSAGE, *head, kind, sequence, 0, first, second, mode, 0, 0, run
    )
    return body + struct.pack("<I", zlib.crc32(body))


@pytest.mark.slow
def test_the_arm_in_real_time_is_the_twin_to_the_last_bit(
    law: Law, twin: Twin, way: Udp
) -> None:
    move = fl.smooth_step(0.3, 1.0)
    simulated = fl.simulate(law, move, arm=twin, duration=1.0)
    with Serving(twin, way) as serving:
        run = serving.control(law, move, duration=0.5)
    assert (run.passed, len(run.tick), run.missed, run.lost_samples) == (True, 26, 0, 0)
    assert serving.arm.passed
    for name, other in (
        ("motor_angle", "motor_angle_measured"),
        ("torque", "torque_measured"),
        ("motor_reference", "motor_reference"),
    ):
        assert (
            getattr(run, name).tobytes() == getattr(simulated, other)[:26].tobytes()
        ), name
    assert run.motor_angle[-1] > 0.01
    served = serving.arm
    begun = int(np.argmax(served.motor_angle != 0.0))
    moves = int(np.argmax(simulated.motor_angle != 0.0))
    for name in ("motor_angle", "tip_angle"):
        np.testing.assert_array_equal(
            getattr(served, name)[begun : begun + 15],
            getattr(simulated, name)[moves : moves + 15],
        )


@pytest.mark.slow
def test_an_arm_that_dies_is_given_up_by_the_law(
    law: Law, twin: Twin, way: Udp
) -> None:
    with Serving(twin, way, duration=0.4, once=False) as serving:
        run = serving.control(law, fl.smooth_step(0.3, 1.0), duration=5.0)
    assert run.problem == "safe stop: the law switched off (encoder)"
    assert np.isnan(run.motor_angle[-law.limits.bad_limit :]).all()
    assert run.voltage[-1] == 0.0
    assert run.first_difference is None


def test_a_controller_that_dies_is_replaced_by_the_watchdog(twin: Twin) -> None:
    way = Udp("127.0.0.1", free_port())
    with Serving(twin, way, watchdog=10) as serving, Peer(serving) as peer:
        peer.greet()
        for sequence in range(2, 20):
            peer.say(sequence, 3.0)
        peer.clock.sleep(20 * PERIOD)
    served = serving.arm
    assert (served.controllers, served.silences, served.passed) == (1, 1, False)
    driven = np.flatnonzero(served.voltage == 3.0)
    # including the periods of the watchdog, in which the last voltage continues
    assert len(driven) >= 17 + 9
    assert served.motor_angle.max() > 0.01
    assert set(served.voltage) == {0.0, 3.0}


def test_no_command_of_a_run_that_is_over_moves_the_arm(twin: Twin) -> None:
    """Late or recorded commands, from the address of the controller itself, with any
    sequence number.
    """
    way = Udp("127.0.0.1", free_port())
    with Serving(twin, way, duration=4.0, once=False) as serving, Peer(serving) as peer:
        peer.greet()
        first = peer.run
        recorded = [peer.say(sequence, 4.0) for sequence in range(2, 20)]
        off = message(2, 20, 0.0, 0.0, OFF, first)
        for _ in range(3):
            peer.pass_on(off, 0.0)
        peer.clock.sleep(2 * PERIOD)
        until = peer.clock.now
        for late in [
            *recorded,
            message(2, 10_000, 0.0, 4.0, 1, first),
            message(2, 10_000, 0.0, 4.0, 1, 0),
        ]:
            peer.pass_on(late)
        # a new run: the next controller is accepted, and its count starts again
        peer.greet()
        assert peer.run not in (0, first)
        for late in recorded:
            peer.pass_on(late, 0.0)
        peer.say(2, 3.0)
        peer.clock.sleep(15 * PERIOD)  # silence: the watchdog ends this run, too
        peer.say(3, 4.0)
    served = serving.arm
    driven = served.time[served.voltage == 4.0]
    assert driven.size and driven.max() < until
    assert np.count_nonzero(served.voltage == 3.0) == 10  # until the watchdog acts
    assert (served.controllers, served.silences) == (2, 1)
    assert served.rejected == 2 * len(recorded) + 3


def test_an_idle_command_moves_nothing_whatever_voltage_it_carries(twin: Twin) -> None:
    way = Udp("127.0.0.1", free_port())
    with Serving(twin, way) as serving, Peer(serving) as peer:
        peer.greet()
        peer.say(2, 5.0, mode=0)
        peer.say(3, mode=OFF)
    assert set(serving.arm.voltage) == {0.0}


def test_the_bytes_on_the_wire_are_the_documented_ones(twin: Twin) -> None:
    way = Udp("127.0.0.1", free_port())
    with Serving(twin, way) as serving, Peer(serving) as peer:
        samples = [peer.greet()]
        peer.clock.sleep(3 * PERIOD)
        samples += [peer.recv(100), peer.recv(100)]
        peer.say(2, mode=OFF)
    numbers = []
    for sample in samples:
        assert len(sample) == 56
        assert struct.unpack("<I", sample[52:]) == (zlib.crc32(sample[:52]),)
        magic, version, kind, sequence, tick, angle, _, period, *rest = struct.unpack(
            MESSAGE, sample[:52]
        )
        assert (magic, version, kind, period, rest) == (
            b"FLRT",
            2,
            1,
            20_000_000,
            [0, 0, peer.run],
        )
        assert angle == 0.0
        numbers.append((sequence, tick))
    assert np.all(np.diff(np.array(numbers), axis=0) == 1)
    assert serving.arm.passed


def test_what_is_damaged_late_or_from_somebody_else_changes_nothing(twin: Twin) -> None:
    """Every message that must be dropped would drive the arm with 5 V if it were
    accepted.
    """
    way = Udp("127.0.0.1", free_port())
    with (
        Serving(twin, way, duration=30.0) as serving,
        Peer(serving) as peer,
        Peer(serving) as stranger,
    ):
        peer.greet()
        drive = message(2, 10_000, 0.0, 5.0, 1, peer.run)
        noise = random.Random(7)  # not a secret  # noqa: S311
        flipped = [
            drive[:at] + bytes([drive[at] ^ 1 << noise.randrange(8)]) + drive[at + 1 :]
            for at in range(len(drive))
        ]
        wrong = [
            b"",
            drive[:-1],
            drive + b"\0",
            noise.randbytes(len(drive)),
            message(1, 10_000, 0.0, 5.0, 1, peer.run),  # a sample instead of a command
            message(2, 1, 0.0, 5.0, 1, peer.run),  # an older sequence number
            message(2, 10_000, 0.0, 5.0, 1, peer.run ^ 1),  # another run
            # another protocol, and another version of this one
            message(2, 10_000, 0.0, 5.0, 1, peer.run, head=(b"FLRU", 2)),
            message(2, 10_000, 0.0, 5.0, 1, peer.run, head=(b"FLRT", 3)),
            *flipped,
        ]
        peer.say(1000)
        for number, bad in enumerate(wrong):
            peer.say(1001 + number)  # this controller is not silent
            stranger.pass_on(drive, 0.0)
            peer.pass_on(bad)
        peer.pass_on(message(2, 20_000, math.nan, math.inf, OFF, peer.run))
    served = serving.arm
    assert set(served.voltage) == {0.0}
    assert served.rejected == 2 * len(wrong)
    assert (served.controllers, served.silences) == (1, 0)


KEY = bytes(range(32))


def tagged(message: bytes, key: bytes = KEY) -> bytes:
    return message + hmac.new(key, message, hashlib.sha256).digest()[:16]


def test_with_a_shared_key_both_ends_agree_to_the_last_bit(
    law: Law, twin: Twin
) -> None:
    move, port = fl.smooth_step(0.3, 1.0), free_port()
    with Serving(twin, Udp("127.0.0.1", port, key=KEY)) as serving:
        keyed = serving.control(law, move, duration=0.5)
    with Serving(twin, Udp("127.0.0.1", port)) as open_to_all:
        run = open_to_all.control(law, move, duration=0.5)
    assert keyed.passed and serving.arm.passed and serving.arm.rejected == 0
    assert keyed.voltage.tobytes() == run.voltage.tobytes()


@pytest.mark.slow
def test_without_the_key_nothing_moves_the_arm(law: Law, twin: Twin) -> None:
    way = Udp("127.0.0.1", free_port(), key=KEY)
    assert "\\x01" not in repr(way)
    with (
        Serving(twin, way, duration=30.0) as serving,
        Peer(serving) as peer,
        Peer(serving) as stranger,
    ):
        peer.key = KEY
        assert len(sample := peer.greet()) == 72
        assert sample == tagged(sample[:56])
        drive = message(2, 10_000, 0.0, 5.0, 1, peer.run)
        other = tagged(message(2, 9_000, 0.0, 5.0, 1, peer.run))
        wrong = [
            drive,
            tagged(drive, bytes(32)),
            drive + other[56:],
            drive + bytes(16),
            tagged(drive)[:-1],
        ]
        wrong += [
            tagged(drive)[:at]
            + bytes([tagged(drive)[at] ^ 1])
            + tagged(drive)[at + 1 :]
            for at in (0, 56, 71)
        ]
        for number, bad in enumerate(wrong):
            peer.say(1001 + number)
            stranger.pass_on(tagged(drive), 0.0)
            peer.pass_on(bad)
        peer.say(2000, mode=OFF)
    served = serving.arm
    assert set(served.voltage) == {0.0}
    assert (served.rejected, served.controllers, served.silences) == (
        2 * len(wrong),
        1,
        0,
    )
    # a controller without the key or with another one gets no answer
    for key in (None, bytes(32)):
        with Serving(twin, way) as serving, pytest.raises(FieldError, match="silent"):
            run_realtime(
                law,
                fl.extend.hold(0.0),
                replace(way, key=key),
                patience=0.1,
                clock=serving.clock,
            )
        assert (serving.arm.controllers, set(serving.arm.voltage)) == (0, {0.0})


@pytest.mark.parametrize("key", [b"", bytes(15), "a password of 32 characters ....."])
def test_what_is_no_key_is_refused_and_not_shown(key: object) -> None:
    with pytest.raises(
        FieldError,
        match=r"key: not a key \(got \d+ (bytes|str)\); expected 16 bytes or more",
    ):
        Udp("127.0.0.1", 5005, key=key)  # type: ignore[arg-type]


def test_the_next_controller_is_welcome_and_its_count_may_begin_anew(
    law: Law, twin: Twin, way: Udp
) -> None:
    with Serving(twin, way, duration=1.8, once=False) as serving:
        runs = [
            serving.control(law, fl.smooth_step(0.1, 0.4), duration=0.5)
            for _ in range(2)
        ]
    assert [run.problem for run in runs] == ["", ""]
    assert (serving.arm.controllers, serving.arm.silences, serving.arm.rejected) == (
        2,
        0,
        0,
    )
    # the second move starts where the first one ended
    assert runs[1].origin == pytest.approx(runs[0].motor_angle[-1], abs=0.05)


@pytest.mark.slow
def test_nobody_there_and_somebody_there_already(
    law: Law, twin: Twin, way: Udp
) -> None:
    with pytest.raises(FieldError, match=r"silent|served by no arm") as caught:
        run_realtime(law, fl.extend.hold(0.0), way, patience=0.1)
    assert caught.value.value == str(way)
    assert "fraclink serve-arm" in caught.value.remedy
    with arm_end(way), pytest.raises(FieldError) as busy:
        serve_arm(twin, way, PERIOD, duration=0.1)
    assert busy.value.field == "io"


def test_a_law_of_another_period_moves_no_arm(law: Law, twin: Twin, way: Udp) -> None:
    serving = Serving(twin, way, 1.5 * PERIOD, duration=0.5)
    with serving, pytest.raises(FieldError, match="not the arm's") as caught:
        serving.control(law, duration=0.2)
    assert caught.value.allowed == f"{1.5 * PERIOD:g} s"
    assert not np.any(serving.arm.voltage)


def test_another_machine_needs_a_word(law: Law, twin: Twin) -> None:
    """An address reserved for documentation, which belongs to nobody, and all addresses
    of this machine at once.
    """
    for host in ("203.0.113.7", "0.0.0.0", "::"):  # noqa: S104
        for call in (
            lambda way: run_realtime(law, fl.extend.hold(0.0), way, patience=0.05),
            lambda way: serve_arm(twin, way, PERIOD, duration=0.1),
        ):
            with pytest.raises(
                FieldError, match=r"not this machine: .*password.*--unsafe-remote"
            ):
                call(Udp(host, free_port()))
    with pytest.raises(FieldError, match="refused"):
        serve_arm(twin, Udp("203.0.113.7", 5005, unsafe_remote=True), PERIOD)
    way = Udp("0.0.0.0", free_port(), unsafe_remote=True)  # noqa: S104
    assert (
        serve_arm(twin, way, PERIOD, duration=0.1, clock=VirtualClock(1)).controllers
        == 0
    )


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"duration": 0.0}, "duration"),
        ({"watchdog": 0}, "watchdog"),
        ({"seed": -1}, "seed"),
        ({"priority": 100}, "priority"),
    ],
)
def test_bad_values_are_named(
    twin: Twin, options: dict[str, object], field: str
) -> None:
    with pytest.raises(FieldError) as caught:
        serve_arm(twin, Udp("127.0.0.1", free_port()), PERIOD, **options)  # type: ignore[arg-type]
    assert caught.value.field == field


def test_more_is_refused_before_memory_is_taken(twin: Twin) -> None:
    with pytest.raises(FieldError, match="duration"):
        serve_arm(twin, Udp("127.0.0.1", free_port()), PERIOD, duration=1e5)
    with pytest.raises(FieldError, match="no way to serve an arm"):
        serve_arm(twin, Callback(lambda: None, print), PERIOD)  # type: ignore[arg-type]
