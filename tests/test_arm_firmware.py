"""The arm's firmware for microcontrollers: compiled for two cores, tested byte by byte,
and connected over a pseudo-terminal.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import pty
import queue
import struct
import sys
import threading
import time
import tty
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fraclink as fl
from fraclink.errors import FieldError
from fraclink.lab import Serial, parse_connection, run_realtime, serve_arm
from needed_tools import tool
from test_export import run

if sys.platform != "linux":
    pytest.skip("the real-time loop is Linux's", allow_module_level=True)

MESSAGE = "<4sHHIIddIIIQ"  # without its checksum
IDLE, RUN, OFF = 0, 1, 4
WATCHDOG = 10  # periods
STRICT = ("-std=c99", "-O2", "-Wall", "-Wextra", "-pedantic", "-Wconversion", "-Werror")


def firmware(folder: Path) -> int:
    """Return the exit code of the command that exports the firmware."""
    return fl.main(["export", "arm-firmware", "--out", str(folder)])


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Any:
    folder = tmp_path_factory.mktemp("arm")
    assert firmware(folder) == 0
    built = folder / "arm_link.so"
    compiler = tool("cc", "gcc")
    run(compiler, *STRICT, "-shared", "-fPIC", folder / "arm_link.c", "-o", built)
    return ctypes.CDLL(str(built))


class Firmware:
    """The exported C code with its three functions."""

    def __init__(self, library: Any, seed: int = 1) -> None:
        # The struct is private to the board: only its size matters here.
        self.library, self.link = library, ctypes.create_string_buffer(512)
        library.arm_link_begin(self.link, 4000, seed)

    def take(self, data: bytes) -> None:
        for byte in data:
            self.library.arm_link_take(self.link, ctypes.c_uint8(byte))

    def period(
        self, angle: float = 0.0, torque: float = 0.0
    ) -> tuple[float, tuple[Any, ...] | None]:
        """The voltage, and the fields of the sample if one is sent."""
        message, voltage = self.message(angle, torque)
        if message is None:
            return voltage, None
        (checksum,) = struct.unpack("<I", message[52:])
        assert checksum == zlib.crc32(message[:52])
        return voltage, struct.unpack(MESSAGE, message[:52])

    def message(self, angle: float, torque: float) -> tuple[bytes | None, float]:
        voltage, room = ctypes.c_float(), ctypes.create_string_buffer(56)
        sent = self.library.arm_link_period(
            self.link,
            ctypes.c_float(angle),
            ctypes.c_float(torque),
            ctypes.byref(voltage),
            room,
        )
        return (room.raw if sent else None), voltage.value


def command(sequence: int, voltage: float, mode: int = RUN, visit: int = 0) -> bytes:
    body = struct.pack(
        MESSAGE, b"FLRT", 2, 2, sequence, 1, 0.0, voltage, mode, 0, 0, visit
    )
    return body + struct.pack("<I", zlib.crc32(body))


def visited(library: Any, seed: int = 1) -> tuple[Firmware, int]:
    """An arm that has received a request, and the number of its run."""
    arm = Firmware(library, seed)
    assert arm.period() == (0.0, None)  # without a request there is no reply
    arm.take(command(1, 5.0, IDLE))
    voltage, sample = arm.period(0.25, -0.125)
    assert voltage == 0.0 and sample is not None
    assert sample[:7] == (b"FLRT", 2, 1, 1, 1, 0.25, -0.125)
    assert sample[7] == 4_000_000
    return arm, sample[10]


def test_the_voltage_of_a_command_of_this_run_acts_and_no_other(library: Any) -> None:
    arm, visit = visited(library)
    assert visit != 0
    arm.take(command(2, 1.5, visit=visit))
    assert arm.period()[0] == 1.5
    arm.take(command(2, 3.0, visit=visit))  # a repeated message
    arm.take(command(1, 3.0, visit=visit))  # a late message
    arm.take(command(3, 3.0, visit=visit + 1))  # a message of another run
    arm.take(command(3, 3.0))  # a message that knows no run
    assert arm.period()[0] == 1.5
    arm.take(command(3, float("nan"), visit=visit))
    assert arm.period()[0] == 0.0
    arm.take(command(4, 1e300, visit=visit))
    assert arm.period()[0] == 0.0


def test_a_stop_ends_the_run_and_what_is_replayed_moves_nothing(library: Any) -> None:
    arm, visit = visited(library)
    moves = command(2, 2.0, visit=visit)
    arm.take(moves + command(3, 0.0, OFF, visit) + command(4, 0.0, OFF, visit))
    assert arm.period() == (0.0, None)
    arm.take(moves)
    assert arm.period() == (0.0, None)
    arm.take(command(1, 0.0, IDLE))
    _, sample = arm.period()
    assert sample is not None and sample[10] not in (0, visit)
    arm.take(command(2, -1.0, visit=sample[10]))
    assert arm.period()[0] == -1.0


def test_another_start_has_another_run(library: Any) -> None:
    assert len({visited(library, seed)[1] for seed in range(100)}) == 100


def test_the_watchdog_switches_off_after_ten_silent_periods(library: Any) -> None:
    arm, visit = visited(library)
    arm.take(command(2, 2.0, visit=visit))
    voltages = [arm.period()[0] for _ in range(WATCHDOG + 1)]
    assert voltages == [2.0] * WATCHDOG + [0.0]


@pytest.mark.slow
def test_no_damaged_message_is_obeyed_and_the_next_whole_one_is(library: Any) -> None:
    arm, visit = visited(library)
    chance = np.random.default_rng(3)
    sequence = 2
    for _ in range(3000):
        whole = bytearray(command(sequence, 9.0, visit=visit))
        for _ in range(chance.integers(1, 5)):
            whole[chance.integers(56)] ^= 1 << int(chance.integers(8))
        # However many bits are flipped, a message whose bits are flipped back is
        # intact.
        if bytes(whole) == command(sequence, 9.0, visit=visit):
            continue
        cut = int(chance.choice((56, chance.integers(56))))
        arm.take(bytes(whole[:cut]))
        assert arm.period()[0] != 9.0
        # The rest of a truncated message can spoil one message, never two.
        arm.take(command(sequence, 0.5, visit=visit))
        arm.take(command(sequence + 1, 1.0, visit=visit))
        sequence += 2
        assert arm.period()[0] == 1.0


@pytest.mark.parametrize("value", [0.0, 1.0, -0.1, 2e-38, 3.4e38, float("inf")])
def test_samples_are_binary64_of_what_was_measured(library: Any, value: float) -> None:
    arm, visit = visited(library)
    arm.take(command(2, 0.0, visit=visit))
    sample = arm.period(value, -value)[1]
    assert sample is not None
    assert sample[5:7] == (float(np.float32(value)), -float(np.float32(value)))


@pytest.mark.parametrize(
    "core",
    [
        ("-mcpu=cortex-m0plus",),
        ("-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard"),
    ],
)
def test_the_c_file_compiles_for_microcontrollers(
    tmp_path: Path, core: tuple[str, ...]
) -> None:
    assert firmware(tmp_path) == 0
    compiler = tool("arm-none-eabi-gcc", "gcc-arm-none-eabi")
    source, target = tmp_path / "arm_link.c", tmp_path / "arm_link.o"
    run(compiler, *STRICT, "-mthumb", *core, "-c", source, "-o", target)


def test_the_sketch_has_the_folders_name_and_nothing_is_overwritten(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sketch = tmp_path / "my_arm"
    assert firmware(sketch) == 0
    names = {path.name for path in sketch.iterdir()}
    assert names == {"arm_link.h", "arm_link.c", "my_arm.ino"}
    capsys.readouterr()
    assert firmware(sketch) == 2
    assert "--force" in capsys.readouterr().err


@contextlib.contextmanager
def board(library: Any, period: float, sent: set[float]) -> Iterator[str]:
    """The firmware on a pseudo-terminal, at rest at angles recorded in `sent`."""
    here, there = pty.openpty()
    tty.setraw(there)
    os.set_blocking(here, False)
    arm, over = Firmware(library), threading.Event()

    def lives() -> None:
        number = 0
        while not over.is_set():
            time.sleep(period)
            with contextlib.suppress(BlockingIOError):
                arm.take(os.read(here, 4096))
            number += 1
            angle = float(np.float32(0.25 + 1e-6 * number))
            message, _ = arm.message(angle, 0.001 * (number % 7))
            if message is not None:
                sent.add(angle)
                os.write(here, b"\xffFLR" if number % 10 == 0 else b"")
                os.write(here, message[:20])
                time.sleep(0.2 * period)  # the other end reads a part of it
                os.write(here, message[20:])

    thread = threading.Thread(target=lives)
    thread.start()
    try:
        yield os.ttyname(there)
    finally:
        over.set()
        thread.join()
        os.close(here)
        os.close(there)


def test_a_law_runs_on_the_firmware_over_a_pseudo_terminal(library: Any) -> None:
    rig, sent = fl.Rig.named("paper-2023"), set[float]()
    law = fl.discretize(
        fl.Controller(
            derivative_gain=0.069876, derivative_order=0.612197, link=rig.model
        ),
        0.004,
        order=4,
    )
    with board(library, 0.004, sent) as port:
        seen = run_realtime(
            law,
            fl.extend.hold(0.0),
            Serial(port),
            duration=1.0,
            priority=0,
            lock_memory=False,
        )
    # A busy machine may lose samples, for which the law switches off. What does arrive
    # was measured, whatever noise is on the line.
    got = seen.motor_angle[np.isfinite(seen.motor_angle)]
    assert got.size > 0 and set(got.tolist()) <= sent


@pytest.mark.slow
def test_a_served_arm_is_reached_over_its_pseudo_terminal() -> None:
    design = fl.design(
        fl.Rig.named("paper-2023-geared").model, fl.Rig.named("paper-2023-geared")
    )
    twin = fl.Twin.from_rig(design.rig)
    names, ends = queue.Queue[str](), list[fl.lab.ServedArm]()

    def serves() -> None:
        ends.append(
            serve_arm(
                twin,
                Serial("pty"),
                design.rig.period,
                duration=10.0,
                once=True,
                priority=0,
                begin=names.put,
            )
        )

    thread = threading.Thread(target=serves)
    thread.start()
    way = parse_connection(names.get(timeout=60.0).removeprefix("arm at "))
    with pytest.raises(FieldError, match="speed"):
        run_realtime(design.law(), fl.extend.hold(0.0), Serial(way.port, 12345))  # type: ignore[union-attr]
    run_realtime(
        design.law(),
        fl.extend.hold(0.0),
        way,
        duration=0.5,
        priority=0,
        lock_memory=False,
    )
    thread.join()
    assert ends[0].controllers == 1 and ends[0].rejected == 0


def test_addresses_of_serial_lines() -> None:
    assert parse_connection("serial:/dev/ttyACM0@2000000") == Serial(
        "/dev/ttyACM0", 2_000_000
    )
    assert parse_connection("serial:/dev/ttyACM0").baud == 1_000_000  # type: ignore[union-attr]
    for io in ("serial:", "serial:/dev/ttyACM0@fast", "serial:/dev/ttyACM0@0"):
        with pytest.raises(FieldError):
            parse_connection(io)
    with pytest.raises(FieldError, match="port"):
        run_realtime(
            fl.discretize(
                fl.Controller(
                    derivative_gain=0.07,
                    derivative_order=0.6,
                    link=fl.Rig.named("paper-2023").model,
                ),
                0.004,
            ),
            fl.extend.hold(0.0),
            Serial("/dev/no-such-port"),
        )


def test_the_program_on_the_page_compiles_with_the_exported_files(
    tmp_path: Path,
) -> None:
    assert firmware(tmp_path) == 0
    page = Path(__file__).parents[1] / "docs" / "how-to" / "build-an-arm.md"
    program = page.read_text(encoding="utf-8").split("```c\n")[1].split("```")[0]
    # "lines of one's own": those of the board are its maker's
    assert len([line for line in program.splitlines() if line.strip()]) <= 25
    source = tmp_path / "own.c"
    source.write_text(program, encoding="utf-8")
    (tmp_path / "board.h").write_text(
        "void board_begin(void);\nunsigned board_noise(void);\nvoid timer_wait(void);\nint uart_get(void);\n"
        "float encoder_angle(void);\nfloat gauge_torque(void);\n"
        "void uart_put(const uint8_t *bytes, int count);\nvoid drive(float voltage);\n",
        encoding="utf-8",
    )
    run(tool("cc", "gcc"), *STRICT, "-c", source, "-o", source.with_suffix(".o"))
