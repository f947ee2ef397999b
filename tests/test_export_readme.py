"""The exported pages, headers and tables, compared with the law and with what a
compiler makes of the files.
"""

from __future__ import annotations

import re
import struct
from pathlib import Path

import pytest

import fraclink as fl
from fraclink import export_c
from fraclink.extend import PayloadEstimator, payload_estimator
from law_bench import law
from needed_tools import tool
from test_export import FLAGS, own_flags, run, single


def rows_of(page: str) -> dict[str, list[str]]:
    """The rows of the tables of a page in Markdown, by their first cell."""
    cells = [
        re.split(r" (?<!\\)\| ", line.strip("| "))
        for line in page.splitlines()
        if line.startswith("| ")
    ]
    return {row[0].strip("`"): row[1:] for row in cells}


# --- README.md ----------------------------------------------------------------------------------------------


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
    for flags in ((), own_flags(tmp_path)):
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
    # The block, parsed back from the text: eight words, then reals in the order of the
    # header.
    whole = [int(word) for word in re.findall(r"= (\d+)U,", data)]
    texts = re.findall(r"-?0x[01]\.[0-9a-f]+p[+-]\d+(?=F?)", data)
    code = "f" if precision == "single" else "d"
    assert (
        struct.pack(f"<8I{len(texts)}{code}", *whole, *map(float.fromhex, texts))
        == made.block
    )
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
    assert f"must print `hash {said.split('hash ')[1][:8]}`" in page
    assert "The design covers 20 to 40 g" in page
    assert (
        f"remembers {made.state_size} bytes (RAM, one for each arm); its tables take\n{len(made.block)} bytes"
        in page
    )
    assert ("-ffp-contract=off -DLAW_SINGLE -O2 payload_selftest.c" in page) == (
        precision == "single"
    )
