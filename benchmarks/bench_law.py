"""The law: order and error of its filter, the time of its fit, its memory, and the
instructions of a period on a Cortex-M4F by compiler and flags.

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

import numpy as np

import fraclink as fl
from fraclink import Law, export_c
from fraclink._export.data import exact_flags, exact_sizes
from fraclink._law import discretize_controller
from fraclink._law.discretization import fit_correction
from fraclink.extend import PayloadEstimator, equip, payload_estimator
from harness import line, sizes, timed

ROOT = Path(__file__).resolve().parents[1]
RIG = fl.Rig.named("paper-2023")
CORE = ("-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard", "-DLAW_SINGLE")
CLANG = ("clang", "--target=thumbv7em-none-eabihf", "-ffreestanding")
# Compiler, flags, whether built for the one design: every build gives the same bits.
BUILDS: tuple[tuple[tuple[str, ...], tuple[str, ...], bool], ...] = (
    (("arm-none-eabi-gcc", "-mthumb"), ("-O2",), True),
    (("arm-none-eabi-gcc", "-mthumb"), ("-O3",), True),
    # with the tables of a core with a fast VMLA; on a Cortex-M4 it takes three cycles,
    # VMUL and VADD two
    (("arm-none-eabi-gcc", "-mthumb"), ("-O2", "-mtune=cortex-a5"), True),
    (CLANG, ("-O2",), True),
    (("arm-none-eabi-gcc", "-mthumb"), ("-O2",), False),
)
# The cost of the checksum is the difference from a law without it, which never takes
# its memory for damaged and sums nothing.
WITHOUT_CHECKSUM = {
    "return (credible(sum - s->sum, LAW_TINY) != 0U) ? 0U : 1U;": "(void)s; (void)sum; return 0U;",
    "    s->sum = left + kept(s);\n    return flags;": "    return flags;",
}


def default_law(precision: str = "double") -> Law:
    controller = fl.Controller(
        derivative_gain=0.069876, derivative_order=0.612197, link=RIG.model
    )
    made = discretize_controller(controller, RIG.period)
    assert RIG.model is not None
    return equip(made, RIG, RIG.model).in_precision(precision)  # type: ignore[arg-type]


def accuracy() -> None:
    for delta, wanted in ((0.16, 4), (0.016, 6)):
        controller = fl.Controller(
            derivative_gain=0.148,
            derivative_order=0.65,
            filter_time=delta,
            filter_order=2,
            link=RIG.model,
        )
        made = discretize_controller(controller, RIG.period)
        db, deg = made.correction_error
        line(
            f"order of Ĉ, δ = {delta} s, to 600 rad/s", str(made.order), f"<= {wanted}",
            made.order <= wanted and db <= 0.1 and deg <= 0.5, f"{db:.3f} dB, {deg:.3f}°",
        )  # fmt: skip
    made = default_law()
    db, deg = made.correction_error
    line(
        "order of Ĉ, default design, to 300 rad/s",
        str(made.order),
        "printed",
        True,
        f"{db:.3f} dB, {deg:.3f}°",
    )
    bare = discretize_controller(
        fl.Controller(
            derivative_gain=0.069876, derivative_order=0.612197, link=RIG.model
        ),
        RIG.period,
    )
    rows = np.zeros((4, 50_000))
    rows[3, 10:] = 0.078
    last = [
        float(law.run(law.initial_state(), *rows)[1].motor_reference[-1])
        for law in (bare, bare.in_precision("single"))
    ]
    line(
        "Ĉ of a constant error, double and single",
        str(last),
        "exactly 0",
        last == [0.0, 0.0],
    )


def fit_time(rounds: int) -> None:
    controller = fl.design(
        RIG.model, RIG, gain_crossover=12.0, phase_margin=fl.deg(50), law=False
    ).controller

    def fit() -> None:
        fit_correction.cache_clear()
        discretize_controller(controller, RIG.period)

    timed("fit of a law", fit, rounds, 0.1)


def instructions(builds: int) -> None:
    """Instructions of a period on an emulated Cortex-M4F, default design; the first
    build is the figure.
    """
    missing = [
        tool
        for tool in ("arm-none-eabi-gcc", "clang", "qemu-system-arm")
        if shutil.which(tool) is None
    ]
    if missing:
        line(
            "instructions on a Cortex-M4F",
            f"not installed: {missing}",
            "<= 80, <= 460",
            False,
        )
        return
    law = default_law("single")
    estimator = bank_of(law)
    modes = f"{law.order} + {len(law.feedforward.poles)} modes"
    for place, (compiler, options, exact) in enumerate(BUILDS[:builds]):
        flags = (*options, *(exact_flags(law) if exact else ()))
        (outer, whole), (_, given) = (
            counted(law, compiler, flags, payload=kg) for kg in ("0", "0.03F")
        )
        name = " ".join(
            (compiler[0], *options, "" if exact else "room for every design")
        ).strip()
        wanted = ("<= 80", "<= 460") if place == 0 else ("printed", "printed")
        line(
            f"{name}: outer law", str(outer), wanted[0], place > 0 or outer <= 80, modes
        )
        line(
            f"{name}: with guards and motor loop",
            str(whole),
            wanted[1],
            place > 0 or whole <= 460,
        )
        line(
            f"{name}: and a payload that is given",
            str(given),
            wanted[1],
            place > 0 or given <= 460,
        )
        if place == 0:
            _, bare = counted(law, compiler, flags, payload="0", edits=WITHOUT_CHECKSUM)
            line(
                f"{name}: without the checksum of its memory",
                str(bare),
                "<= 380",
                bare <= 380,
            )
        _, both = counted(law, compiler, flags, payload="0", estimator=estimator)
        wish = "<= 1400" if place == 0 else "printed"
        line(
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

    With an estimator, those of both, averaged over the periods of one of its samples.
    `edits` are replacements in law.c.
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
    given = sizes(__doc__, rounds=(5, 1), builds=(len(BUILDS), 1))
    accuracy()
    fit_time(given.rounds)
    instructions(given.builds)
    law = default_law("single")
    params, state = exact_sizes(law)
    both = state + bank_of(law).state_size
    line("state of law and payload estimator", f"{both} B", "<= 1024 B", both <= 1024)
    line(
        "state of the law, built for this design",
        f"{state} B",
        "<= 256 B",
        state <= 256,
        f"{params} B of flash",
    )


if __name__ == "__main__":
    main()
