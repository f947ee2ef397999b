"""The exported law on emulated Cortex-M boards: bitwise equal to the package, with its
instructions counted.
"""

from __future__ import annotations

import itertools
import re
import struct
from pathlib import Path

import numpy as np
import pytest

import fraclink as fl
from fraclink import Law, export_c
from fraclink.extend import payload_estimator
from law_bench import law
from needed_tools import missing, tool
from test_export import FLAGS, own_flags, run, single

FIRMWARE = Path(__file__).parent / "firmware"
BOARDS = {
    "cortex-m4f": (
        ("-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard"),
        "mps2-an386",
    ),
    "cortex-m3": (("-mcpu=cortex-m3",), "mps2-an385"),
    "cortex-m7": (
        ("-mcpu=cortex-m7", "-mfpu=fpv5-d16", "-mfloat-abi=hard"),
        "mps2-an500",
    ),
    # its instructions are a subset of those of the Cortex-M3, whose board has enough
    # memory for newlib's printf
    "cortex-m0plus": (("-mcpu=cortex-m0plus",), "mps2-an385"),
}
SELF_TESTED = ("cortex-m4f", "cortex-m3")
# With both precisions in hardware: a core without them needs a library of the compiler.
RISCV = (
    "--target=riscv32",
    "-march=rv32imafdc",
    "-mabi=ilp32d",
    "-ffreestanding",
    "-nostdlib",
    "-fuse-ld=lld",
)
# An emulator needs fifty times as long: every sample that is lost and every payload that
# is told occurs within 10 000 periods.
PERIODS, EMULATED = 50_000, 10_000
NEWLIB = tuple(
    Path(place) for place in ("/usr/include/newlib", "/usr/lib/arm-none-eabi/include")
)


def on_board(
    folder: Path,
    made: Law,
    board: str,
    *sources: str | Path,
    counted: bool = False,
    exact: bool = False,
) -> str:
    flags, machine = BOARDS[board]
    compiler, emulator = (
        tool("arm-none-eabi-gcc", "gcc-arm-none-eabi"),
        tool("qemu-system-arm"),
    )
    link = ("-T", FIRMWARE / "board.ld", "--specs=rdimon.specs", "-nostartfiles")
    run(
        compiler, "-std=c99", "-O2", "-ffp-contract=off", "-mthumb", *flags, *single(made),
        *(own_flags(folder) if exact else ()), f"-DPERIODS={EMULATED}U", "-I", folder,
        *sources, FIRMWARE / "start.c", *link, "-o", folder / "board.elf",
    )  # fmt: skip
    clock = ("-icount", "shift=5") if counted else ()
    return run(
        emulator, "-M", machine, "-nographic", *clock,
        "-semihosting-config", "enable=on,target=native", "-kernel", folder / "board.elf",
    ).stdout  # fmt: skip


def on_riscv(folder: Path, made: Law, *sources: str | Path) -> str:
    """Output of `sources` on an emulated RV32 core; the headers of newlib work for
    every machine.
    """
    tool("ld.lld", "lld")
    emulator = tool("qemu-system-riscv32", "qemu-system-misc")
    include = next((place for place in NEWLIB if (place / "stdio.h").is_file()), None)
    if include is None:
        missing("newlib's headers are not installed (Debian package libnewlib-dev)")
    run(
        tool("clang"), *RISCV, "-std=c99", "-O2", "-ffp-contract=off", *single(made), f"-DPERIODS={EMULATED}U",
        "-I", folder, "-isystem", include, *sources, FIRMWARE / "start_riscv.c",
        f"-Wl,-T,{FIRMWARE / 'board_riscv.ld'}", "-o", folder / "riscv.elf",
    )  # fmt: skip
    machine = ("-M", "virt", "-nographic", "-bios", "none")
    return run(emulator, *machine, "-kernel", folder / "riscv.elf").stdout


def reference_hash(made: Law, periods: int = PERIODS) -> int:
    """Hash of the outputs of the law in the package, for the inputs of long.c."""
    seed, noises = 1, np.empty((periods, 3))
    for k in range(periods):
        for j in range(3):
            seed = (seed * 1664525 + 1013904223) % 2**32
            noises[k, j] = (seed >> 20) - 2048
    phase = np.arange(periods) % 1024
    reference = np.where(phase < 512, phase, 1024 - phase) / 1024
    kind = np.float32 if made.precision == "single" else np.float64
    angle = kind(reference) + kind(noises[:, 1] / 2097152)
    torque = noises[:, 2] / 1048576
    count = np.arange(periods)
    torque[count % 1000 == 500] = np.nan
    angle[count % 1000 == 700] = np.nan
    payload = np.where(count % 5000 < 2500, 0.0, (1 + count // 1000) / 1024)
    _, out = made.run(
        made.initial_state(), reference, noises[:, 0] / 4096, angle, torque, payload
    )
    reals = np.array(out[:5]).T.astype(kind)
    width = 1 if made.precision == "single" else 2
    words = np.concatenate(
        [np.ascontiguousarray(reals).view(np.uint32), np.array(out[5:]).T], axis=1
    )
    assert words.shape == (periods, 5 * width + 3)
    digest = 0x811C9DC5
    for word in words.ravel().tolist():
        digest = ((digest ^ word) * 16777619) % 2**32
    return digest


def _hash(text: str) -> int:
    found = re.search(r"hash ([0-9A-F]{8}) mode 1", text)
    assert found is not None, text
    return int(found.group(1), 16)


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["single", "double"])
def test_fifty_thousand_periods_agree_to_the_bit(
    precision: str, tmp_path: Path
) -> None:
    made = law(precision)
    export_c(made, tmp_path)
    wanted = reference_hash(made)
    sources = (FIRMWARE / "long.c", tmp_path / "law.c")
    for compiler, exact in itertools.product(
        ("gcc", "clang"), ((), own_flags(tmp_path))
    ):
        run(
            tool(compiler),
            *FLAGS,
            *single(made),
            *exact,
            "-I",
            tmp_path,
            *sources,
            "-o",
            tmp_path / "long",
        )
        assert _hash(run(tmp_path / "long").stdout) == wanted, (compiler, exact)
    if precision == "double":  # the emulators take minutes, so their self-test is short
        return
    wanted = reference_hash(made, EMULATED)
    for board in BOARDS:
        assert _hash(on_board(tmp_path, made, board, *sources, exact=True)) == wanted, (
            board
        )
    # with memory for every design
    assert _hash(on_board(tmp_path, made, "cortex-m4f", *sources)) == wanted


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["single", "double"])
def test_a_riscv_core_computes_the_same_bits(precision: str, tmp_path: Path) -> None:
    """clang for RV32; WebAssembly is tested in tests/test_engine.py."""
    made = law(precision)
    export_c(made, tmp_path)
    assert _hash(
        on_riscv(tmp_path, made, FIRMWARE / "long.c", tmp_path / "law.c")
    ) == reference_hash(made, EMULATED)


@pytest.mark.slow
@pytest.mark.parametrize("board", SELF_TESTED)
def test_the_self_test_passes_on_the_board(board: str, tmp_path: Path) -> None:
    made = law("single")
    export_c(made, tmp_path)
    text = on_board(
        tmp_path, made, board, tmp_path / "law_selftest.c", tmp_path / "law.c"
    )
    assert "passed" in text


@pytest.mark.slow
def test_a_period_on_a_cortex_m4f_is_short(tmp_path: Path) -> None:
    """Compiled for this design alone with -O2: 8 instructions per mode, and 15 without
    guards.
    """
    made = law("single")
    export_c(made, tmp_path)
    wholes = []
    for payload in ("0", "0.03F"):
        (tmp_path / "payload.h").write_text(
            f"#define PAYLOAD {payload}\n", encoding="utf-8"
        )
        text = on_board(
            tmp_path, made, "cortex-m4f", FIRMWARE / "count.c", counted=True, exact=True
        )
        found = re.search(r"outer (\d+) whole (\d+) mode 1", text)
        assert found is not None, text
        outer, whole = map(int, found.groups())
        wholes.append(whole)
        modes = made.order + len(made.feedforward.poles)
        assert 60 < outer <= 8 * modes + 16 <= 80
    assert 300 < wholes[0] < wholes[1] <= 460


@pytest.mark.slow
def test_the_payload_estimator_on_a_cortex_m4f(tmp_path: Path) -> None:
    """Bitwise equal to the desktop, and at most 1400 instructions per period including
    the law (issue 16).
    """
    made, rig = law("single"), fl.Rig.named("paper-2023")
    assert rig.model is not None
    export_c(
        made, tmp_path, estimator=payload_estimator(rig.model, rig, made, (0.02, 0.04))
    )
    sources = (tmp_path / "payload_selftest.c", tmp_path / "payload_estimator.c")
    assert "passed" in on_board(tmp_path, made, "cortex-m4f", *sources)
    (tmp_path / "payload.h").write_text(
        "#define PAYLOAD 0\n#define ESTIMATE\n", encoding="utf-8"
    )
    text = on_board(
        tmp_path, made, "cortex-m4f", FIRMWARE / "count.c", counted=True, exact=True
    )
    found = re.search(r"whole (\d+) mode 1", text)
    assert found is not None and 800 < int(found.group(1)) <= 1400, text


@pytest.mark.slow
def test_flash_and_memory_are_small(tmp_path: Path) -> None:
    made = law("single")
    export_c(made, tmp_path)
    flags, _ = BOARDS["cortex-m4f"]
    compiler = tool("arm-none-eabi-gcc", "gcc-arm-none-eabi")
    run(
        compiler, "-std=c99", "-Os", "-ffp-contract=off", "-mthumb", *flags, *single(made),
        "-c", tmp_path / "law.c", "-o", tmp_path / "law.o",
    )  # fmt: skip
    size = run(
        tool("arm-none-eabi-size", "binutils-arm-none-eabi"), tmp_path / "law.o"
    ).stdout.split()
    text, data, bss = map(int, size[6:9])
    assert text <= 4608  # 4.5 kB, as docs/reference/law.md says
    assert data == bss == 0  # no statics
    assert struct.calcsize("<14I42f") <= 256
    own = struct.calcsize(f"<14I{22 + made.order + len(made.feedforward.poles)}f")
    page = (tmp_path / "README.md").read_text(encoding="utf-8")
    assert f"({own} B of state, " in page
