"""The law on a microcontroller: instructions of a period on a Cortex-M4F, by compiler
and flags; memory.

QEMU counts instructions, not cycles. "Outer law": tip estimate, correction and
feed-forward, without guards.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from bench_law import RIG, ROOT, default_law, figure
from fraclink._export import export_c
from fraclink._export.data import exact_flags, exact_sizes
from fraclink._law import Law
from fraclink._law.estimator import PayloadEstimator, payload_estimator

CORE = ("-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard", "-DLAW_SINGLE")
CLANG = ("clang", "--target=thumbv7em-none-eabihf", "-ffreestanding")
# Compiler, flags, whether for the one design: every build gives the same bits.
BUILDS: tuple[tuple[tuple[str, ...], tuple[str, ...], bool], ...] = (
    (("arm-none-eabi-gcc", "-mthumb"), ("-O2",), True),
    (("arm-none-eabi-gcc", "-mthumb"), ("-O3",), True),
    # with the tables of a core whose VMLA is fast; on a Cortex-M4 it takes three
    # cycles, VMUL and VADD two
    (("arm-none-eabi-gcc", "-mthumb"), ("-O2", "-mtune=cortex-a5"), True),
    (CLANG, ("-O2",), True),
    (("arm-none-eabi-gcc", "-mthumb"), ("-O2",), False),
)
# What the checksum costs is what the law takes without it: nothing is damaged then, and
# nothing is summed.
WITHOUT_CHECKSUM = {
    "return (credible(sum - s->sum, LAW_TINY) != 0U) ? 0U : 1U;": "(void)s; (void)sum; return 0U;",
    "    s->sum = left + kept(s);\n    return flags;": "    return flags;",
}


def instructions() -> None:
    """Instructions of a period on an emulated Cortex-M4F, default design; the first
    build is the figure.
    """
    missing = [
        tool
        for tool in ("arm-none-eabi-gcc", "clang", "qemu-system-arm")
        if shutil.which(tool) is None
    ]
    if missing:
        figure(
            "instructions on a Cortex-M4F",
            f"not installed: {missing}",
            "<= 80, <= 440",
            False,
        )
        return
    law = default_law("single")
    estimator = bank_of(law)
    modes = f"{law.order} + {len(law.feedforward.poles)} modes"
    for place, (compiler, options, exact) in enumerate(BUILDS):
        flags = (*options, *(exact_flags(law) if exact else ()))
        (outer, whole), (_, given) = (
            counted(law, compiler, flags, payload=kg) for kg in ("0", "0.03F")
        )
        name = " ".join(
            (compiler[0], *options, "" if exact else "room for every design")
        ).strip()
        wanted = ("<= 80", "<= 440") if place == 0 else ("printed", "printed")
        figure(
            f"{name}: outer law", str(outer), wanted[0], place > 0 or outer <= 80, modes
        )
        figure(
            f"{name}: with guards and motor loop",
            str(whole),
            wanted[1],
            place > 0 or whole <= 440,
        )
        figure(
            f"{name}: and a payload that is given",
            str(given),
            wanted[1],
            place > 0 or given <= 440,
        )
        if place == 0:
            _, bare = counted(law, compiler, flags, payload="0", edits=WITHOUT_CHECKSUM)
            figure(
                f"{name}: without the checksum of its memory",
                str(bare),
                "<= 380",
                bare <= 380,
            )
        _, both = counted(law, compiler, flags, payload="0", estimator=estimator)
        wish = "<= 1400" if place == 0 else "printed"
        figure(
            f"{name}: and the payload estimator",
            str(both),
            wish,
            place > 0 or both <= 1400,
        )


def bank_of(law: Law) -> PayloadEstimator:
    assert RIG.model is not None
    return payload_estimator(RIG.model, RIG, law, (0.020, 0.040))


def counted(
    law: Law,
    compiler: tuple[str, ...],
    flags: tuple[str, ...],
    *,
    payload: str,
    estimator: PayloadEstimator | None = None,
    edits: Mapping[str, str] = MappingProxyType({}),
) -> tuple[int, int]:
    """Return the instructions (of the outer law without guards, of law_step) of one
    build in QEMU.

    With an estimator, of both on the average of the periods that make one of its
    samples. Edits change law.c.
    """
    board = ROOT / "tests" / "firmware"

    def run(*command: str | Path) -> str:
        return subprocess.run(  # noqa: S603
            command, cwd=scratch, check=True, capture_output=True, text=True
        ).stdout

    with tempfile.TemporaryDirectory() as scratch:
        export_c(law, Path(scratch) / "law", estimator=estimator)
        source = Path(scratch) / "law" / "law.c"
        text = source.read_text(encoding="utf-8")
        for before, after in edits.items():
            if text.count(before) != 1:
                raise RuntimeError(f"law.c has changed: {before!r} is not there once")
            text = text.replace(before, after)
        source.write_text(text, encoding="utf-8")
        estimate = "" if estimator is None else "#define ESTIMATE\n"
        text = f"#define PAYLOAD {payload}\n{estimate}"
        (Path(scratch) / "law" / "payload.h").write_text(text, encoding="utf-8")
        run(
            *compiler,
            "-std=c99",
            "-ffp-contract=off",
            *CORE,
            *flags,
            "-Ilaw",
            "-c",
            board / "count.c",
        )
        link = (
            "-T",
            board / "board.ld",
            "--specs=rdimon.specs",
            "-nostartfiles",
            "-o",
            "board.elf",
        )
        run(
            "arm-none-eabi-gcc",
            "-mthumb",
            *CORE,
            "-O2",
            "count.o",
            board / "start.c",
            *link,
        )
        machine = ("-M", "mps2-an386", "-nographic", "-icount", "shift=5")
        semihosting = (
            "-semihosting-config",
            "enable=on,target=native",
            "-kernel",
            "board.elf",
        )
        told = run("qemu-system-arm", *machine, *semihosting).split()
    return int(told[1]), int(told[3])


def main() -> None:
    instructions()
    law = default_law("single")
    params, state = exact_sizes(law)
    both = state + bank_of(law).state_size
    figure("state of law and payload estimator", f"{both} B", "<= 1024 B", both <= 1024)
    figure(
        "state of the law, built for this design",
        f"{state} B",
        "<= 256 B",
        state <= 256,
        f"{params} B of flash",
    )


if __name__ == "__main__":
    main()
