"""What the exported pages, headers and tables say, against the law and what a compiler
makes of the files.
"""

from __future__ import annotations

import math
import re
import struct
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

import fraclink as fl
from fraclink._arm.reference import sampled
from fraclink._export import export_c
from fraclink._export.board import export_reference
from fraclink._export.c import readme
from fraclink._export.claims import (
    NOT_CLAIMED,
    NOT_CLAIMED_OF_PID,
    claims_text,
    worst_case,
)
from fraclink._export.data import data_header, exact_flags, exact_sizes, hex_float
from fraclink._export.payload import payload_files, payload_readme
from fraclink._law import Law
from fraclink._law.estimator import HEADER, REALS, PayloadEstimator, payload_estimator
from law_bench import law, with_pair
from needed_tools import tool
from test_export import FLAGS, run, single
from test_export_fmu_description import pid

ROOT = Path(__file__).resolve().parents[1]


def page_of(made: Law) -> str:
    return readme(made, name="law_data", data="law_data.h")


def rows_of(page: str) -> dict[str, list[str]]:
    """The rows of the tables of a page in Markdown, by their first cell."""
    cells = [
        re.split(r" (?<!\\)\| ", line.strip("| "))
        for line in page.splitlines()
        if line.startswith("| ")
    ]
    return {row[0].strip("`"): row[1:] for row in cells}


# --- README.md ----------------------------------------------------------------------------------------------


def test_the_limits_are_those_that_the_header_ships() -> None:
    """Each number of the table is the one of law_data.h, and each unit the one of
    law.h.
    """
    made = law("single")
    rows = rows_of(page_of(made))
    units = dict(
        re.findall(
            r"law_real (\w+);.*\[([^]]+)\]",
            (ROOT / "csrc/law.h").read_text(encoding="utf-8"),
        )
    )
    limits = asdict(made.limits)
    limits.pop("stop_ringing")  # an option, no limit of a signal
    for name, shipped in limits.items():
        value, unit, meaning = rows[name]
        assert float(value) == pytest.approx(shipped, rel=5e-6) and meaning
        wanted = {"N m": "N·m", "rad^2": "rad²"}.get(
            units.get(name, ""), units.get(name)
        )
        assert unit == (wanted or unit)
        counted = name.endswith("_limit") and isinstance(shipped, int)
        assert (unit == "periods") == counted, name


@pytest.mark.slow
def test_a_pid_has_the_limits_that_can_act_on_it() -> None:
    made = pid()
    page = page_of(made)
    rows = rows_of(page)
    shown = [
        "angle_limit",
        "sum_limit",
        "correction_limit",
        "motor_limit",
        "bad_limit",
        "missed_limit",
    ]
    assert [
        name for name in rows if name.endswith(("limit", "step", "trip", "angle"))
    ] == shown
    for name in shown:
        assert float(rows[name][0]) == pytest.approx(
            float(getattr(made.limits, name)), rel=5e-6
        )
        assert rows[name][1] == (
            "periods" if name in ("bad_limit", "missed_limit") else "of the measurement"
        )
    assert "fractional PID, output within ±7.5, integral with anti-windup" in page
    assert "u = C(z) (r − y)" in page
    assert "feed-forward" not in page and "Stability of the loop" not in page
    assert page.endswith(NOT_CLAIMED_OF_PID)


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["single", "double"])
def test_the_memory_is_what_a_compiler_needs(precision: str, tmp_path: Path) -> None:
    """sizeof of the parameters and of the state, for every design and for this one
    alone.
    """
    made = law(precision)
    export_c(made, tmp_path)
    (tmp_path / "sizes.c").write_text(
        '#include <stdio.h>\n#include "law.h"\n'
        'int main(void) { printf("%d %d", (int)sizeof(law_state), (int)sizeof(law_params)); return 0; }\n',
        encoding="utf-8",
    )
    sizes = []
    for flags in ((), exact_flags(made)):
        run(
            tool("gcc"),
            *FLAGS,
            *single(made),
            *flags,
            "sizes.c",
            "-o",
            "sizes",
            cwd=tmp_path,
        )
        sizes.append(tuple(map(int, run(tmp_path / "sizes").stdout.split())))
    page = (tmp_path / "README.md").read_text(encoding="utf-8")
    assert rows_of(page)["state (RAM, one for each arm)"] == [str(sizes[0][0])]
    assert rows_of(page)["parameters (flash)"] == [str(sizes[0][1])]
    assert f"({sizes[1][0]} B of state, {sizes[1][1]} B of parameters)" in page
    assert exact_sizes(made) == sizes[1][::-1]
    assert f"add `{' '.join(exact_flags(made))}`: law.c" in page


@pytest.mark.slow
def test_the_flags_of_a_build_for_one_law(tmp_path: Path) -> None:
    """A kind of modes that there is none of: C has no empty arrays, so pairs are left
    out, others refuse.
    """
    made = law()
    counts = len(made.correction.poles), len(made.feedforward.poles)
    assert exact_flags(made) == (
        f"-DLAW_REALS={counts[0]}U",
        f"-DLAW_FORWARDS={counts[1]}U",
    )
    assert exact_flags(with_pair())[1] == "-DLAW_PAIRS=1U"
    assert exact_flags(pid()) == ()  # no feed-forward
    assert "loops of fixed length" not in page_of(pid())
    for made in (law(), pid()):
        export_c(made, tmp_path / str(made.order))
    check = (tool("gcc"), *FLAGS, "-fsyntax-only", "law_selftest.c")
    here, of_pid = (tmp_path / str(made.order) for made in (law(), pid()))
    run(*check, *exact_flags(law()), cwd=here)
    other = (f"-DLAW_REALS={counts[0] + 1}U", f"-DLAW_FORWARDS={counts[1]}U")
    assert (
        f"made for {' '.join(exact_flags(law()))}"
        in run(*check, *other, cwd=here, check=False).stderr
    )
    run(*check, cwd=of_pid)
    told = run(
        *check, "-DLAW_REALS=4U", "-DLAW_FORWARDS=1U", cwd=of_pid, check=False
    ).stderr
    assert "no modes of one kind" in told


@pytest.mark.slow
def test_what_the_page_says_of_build_call_and_precision() -> None:
    made = law("single")
    page = page_of(made)
    assert page.startswith("# Control law, period 4 ms, single precision\n")
    assert f"Law `{made.digest}`." in page
    assert "-ffp-contract=off -DLAW_SINGLE -O2 law_selftest.c" in page
    assert "-DLAW_SINGLE" not in page_of(law("double"))
    assert "motor loop closed by the law, voltage within ±10 V" in page
    assert "no motor loop: `motor_reference` goes to" in page_of(law(equipped=False))
    # The wiring test has a third of the time after which a blocked link is given up.
    time = made.limits.block_limit * 0.004 / 3
    assert (
        f"turns by\n{made.wiring_angle():.2f} rad or more within {time:.2f} s" in page
    )
    rows = rows_of(page)
    decibels, angle = made.correction_error
    assert rows["C = 1 + Ĉ against the design, 0.05 to 300 rad/s"] == [
        f"{decibels:.3f} dB, {angle:.3f}°"
    ]
    decibels, angle = made.feedforward_error
    forward = "feed-forward against s^(λ−2)/ω₀², from a fifth of the resonance on"
    assert rows[forward] == [f"{decibels:.3f} dB, {angle:.3f}°"]
    bounds = worst_case(made)
    assert bounds.error == 0.5
    (gain,) = (row for name, row in rows.items() if name.startswith("worst-case gain"))
    (rounding,) = (
        row for name, row in rows.items() if name.startswith("rounding of Ĉe")
    )
    assert (gain, rounding) == (
        [f"{bounds.gain:.9g}"],
        [f"≤ {bounds.rounding:.2e} rad"],
    )
    assert "`voltage` within ±10 V" in page and "±10 V" not in page_of(
        law(equipped=False)
    )
    assert page.endswith(
        f"{NOT_CLAIMED}Stability of the loop is the design's matter.\n"
    )


@pytest.mark.slow
def test_claims_proved_failed_and_open() -> None:
    made = law()
    logs = (("proof/finite.log", "0123456789abcdef" * 4),)
    claims = (
        fl.extend.Claim(
            "outputs",
            "commands stay within their ranges",
            "proved",
            tools=("frama-c 26", "z3 4.8"),
            logs=logs,
        ),
        fl.extend.Claim(
            "rounding", "rounding stays below 1e-9 rad", "failed", "a counterexample"
        ),
        fl.extend.Claim(
            "loop", "the loop is stable", "not proved", "no certificate was given"
        ),
    )
    proof = fl.extend.Proof(made.digest, {"law.c": "11"}, claims)
    text = claims_text(made, proof)
    assert (
        "## Proved\n" in text and "## Not proved\n" in text and "## Claimed" not in text
    )
    words = " ".join(text.split())
    assert (
        "- commands stay within their ranges. (frama-c 26, z3 4.8: `proof/finite.log` 0123456789ab)"
        in words
    )
    assert "- rounding stays below 1e-9 rad: does not hold. a counterexample." in words
    assert "- the loop is stable: not proved. no certificate was given." in words
    assert (
        text.index("Proved")
        < text.index("does not hold")
        < text.index("## Not claimed")
    )
    assert text.endswith(NOT_CLAIMED)
    # The certificate bounds the second mode: what is left open are the modes that it
    # does not name.
    assert "modes of the link that nothing above names" in NOT_CLAIMED
    assert max(map(len, text.splitlines())) <= 110
    # A rounding that is proved stands among the claims, sharper: not in the table as
    # well.
    shown = "| rounding of Ĉe"
    assert shown in readme(made, name="law_data", data="law_data.h", proof=proof)
    proved = (
        *claims[:1],
        fl.extend.Claim(
            "rounding", "rounding stays below 1e-9 rad", "proved", tools=("gappa",)
        ),
    )
    whole = fl.extend.Proof(made.digest, {}, proved)
    assert shown not in readme(made, name="law_data", data="law_data.h", proof=whole)
    assert "Not proved" not in claims_text(made, whole)
    nothing = claims_text(made, fl.extend.Proof(made.digest, {}, claims[1:]))
    assert "## Proved" not in nothing and nothing.startswith("## Not proved")
    assert str(proof).splitlines() == [
        "proved: commands stay within their ranges",
        "failed: rounding stays below 1e-9 rad [a counterexample]",
        "not proved: the loop is stable [no certificate was given]",
    ]


def test_a_proof_comes_back_from_its_file(tmp_path: Path) -> None:
    claim = fl.extend.Claim(
        "loop",
        "stable",
        "proved",
        tools=("fraclink",),
        logs=(("proof/loop.log", "ab"),),
    )
    proof = fl.extend.Proof("00", {"law.c": "11", "law.h": "22"}, (claim,))
    proof.save(tmp_path / "proof.json")
    assert fl.extend.Proof.load(tmp_path / "proof.json") == proof
    assert '"passed": true' in (tmp_path / "proof.json").read_text(encoding="utf-8")


# --- law_data.h ---------------------------------------------------------------------------------------------


def test_the_header_names_itself_and_its_precision() -> None:
    texts = {
        p: data_header(law(p), name="arm_2", title="Arm 2")
        for p in ("single", "double")
    }
    for precision, text in texts.items():
        assert text.startswith(
            f"/* Coefficients of the control law: data only, generated by fraclink {fl.__version__}. Arm 2\n"
        )
        assert "#ifndef FRACLINK_ARM_2_H\n#define FRACLINK_ARM_2_H\n" in text
        assert f"this block is in {precision} precision" in text
    assert (
        '#if ! defined(LAW_SINGLE)\n#error "this block is in single' in texts["single"]
    )
    assert '#if defined(LAW_SINGLE)\n#error "this block is in double' in texts["double"]
    assert (
        "this file with -DLAW_SINGLE" in texts["single"]
        and "this file without -DLAW_SINGLE" in texts["double"]
    )
    assert (
        ".pair = " not in texts["double"]
    )  # there are none: C fills the array with zeros
    paired = data_header(with_pair(), name="law_data", title="")
    values = re.findall(r"\.pair = \{\{(.+?)\}\},", paired)[0].split(", ")
    assert [float.fromhex(value) for value in values] == pytest.approx(
        [0.93, 0.06, 0.02, -0.03], rel=1e-7
    )
    assert "generated by fraclink" in paired.splitlines()[0] and paired.splitlines()[
        0
    ].endswith(".")


# --- the payload estimator --------------------------------------------------------------------------------


def bank(precision: str) -> PayloadEstimator:
    rig = fl.Rig.named("paper-2023")
    assert rig.model is not None
    return payload_estimator(rig.model, rig, law(precision), (0.02, 0.04)).in_precision(
        precision
    )


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["single", "double"])
def test_the_estimator_s_files_give_the_package_s_bits(
    precision: str, tmp_path: Path
) -> None:
    made = bank(precision)
    export_c(law(precision), tmp_path, estimator=made)
    data = (tmp_path / "payload_data.h").read_text(encoding="utf-8")
    # The block, taken from the text again: eight words, then reals in the order of the
    # header.
    whole = [int(word) for word in re.findall(r"= (\d+)U,", data)]
    texts = re.findall(r"-?0x[01]\.[0-9a-f]+p[+-]\d+(?=F?)", data)
    code = "f" if precision == "single" else "d"
    assert (
        struct.pack(f"<8I{len(texts)}{code}", *whole, *map(float.fromhex, texts))
        == made.block
    )
    assert re.findall(r"\.(\w+) =", data)[: len(HEADER)] == list(HEADER)
    assert set(REALS) < set(re.findall(r"\.(\w+) =", data))
    assert ("#if !" in data) == (
        precision == "single"
    ) and f"in {precision} precision" in data
    flags = (*FLAGS, "-O0", *single(law(precision)))
    run(
        tool("gcc"),
        *flags,
        "payload_selftest.c",
        "payload_estimator.c",
        "-o",
        "selftest",
        cwd=tmp_path,
    )
    said = run(tmp_path / "selftest").stdout
    assert "passed" in said
    page = (tmp_path / "README.md").read_text(encoding="utf-8")
    assert payload_readme(made) in page
    assert f"must print `hash {said.split('hash ')[1][:8]}`" in payload_readme(made)
    assert "The design covers 20 to 40 g" in page
    assert (
        f"remembers {made.state_size} bytes (RAM, one for each arm); its tables take\n{len(made.block)} bytes"
        in page
    )
    assert ("-ffp-contract=off -DLAW_SINGLE -O2 payload_selftest.c" in page) == (
        precision == "single"
    )
    assert b"#define PERIODS 1000U" in payload_files(made)["payload_selftest.c"]


# --- a board, and a reference as a table --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("period", "rows"), [(0.004, 126), (0.003, 168), (0.5, 2), (0.499, 3)]
)
def test_a_table_reaches_the_end_of_the_motion(
    period: float, rows: int, tmp_path: Path
) -> None:
    """Rows at 0, Ts ... up to the first at or behind the end, where the reference
    rests.
    """
    move = fl.smooth_step(1.0, 0.5)
    table = export_reference(move, tmp_path / "move.csv", period=period).read_text(
        encoding="utf-8"
    )
    names, *lines = table.splitlines()
    assert names == "time_s,angle_rad,velocity_rad_per_s,acceleration_rad_per_s2"
    values = np.array([[float(cell) for cell in line.split(",")] for line in lines])
    assert values.shape == (rows, 4)
    np.testing.assert_array_equal(values[:, 0], period * np.arange(rows))
    np.testing.assert_array_equal(values[:, 1:].T, sampled(move, period, rows))
    assert values[-1, 1:] == pytest.approx([1.0, 0.0, 0.0], abs=1e-12)
    assert values[-2, 1] < 1.0
    text = export_reference(move, tmp_path / "fast_move.h", period=period).read_text(
        encoding="utf-8"
    )
    assert (
        f"#define FAST_MOVE_LENGTH {rows}U" in text
        and "#ifndef FRACLINK_FAST_MOVE_H" in text
    )
    assert f"A row for each period of {period:g} s" in text
    for column, name in ((1, "fast_move_angle"), (3, "fast_move_acceleration")):
        array = re.findall(
            rf"law_real {name}\[FAST_MOVE_LENGTH\] = \{{(.+?)\}};", text, re.DOTALL
        )[0]
        listed = [
            float.fromhex(cell) for cell in re.findall(r"\(law_real\)(\S+),", array)
        ]
        np.testing.assert_array_equal(listed, values[:, column])


def test_hex_floats_are_short() -> None:
    texts = {
        0.5: "0x1.0p-1",
        0.1: "0x1.999999999999ap-4",
        -3.0: "-0x1.8p+1",
        0.0: "0x0.0p+0",
    }
    assert {value: hex_float(value, "double") for value in texts} == texts
    assert hex_float(math.ldexp(1.5, 100), "single") == "0x1.8p+100F"
