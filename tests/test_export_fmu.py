"""The FMU: its contents, whether FMPy accepts it, and its outputs, bitwise equal to
those of the package.
"""

from __future__ import annotations

import stat
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path

import numpy as np
import pytest

from fmu_bench import Imported, eventful, fmpy_or_skip, outputs_of
from fraclink import export_fmu
from fraclink._export.fmi import VARIABLES
from fraclink.errors import FieldError
from law_bench import PERIOD, law, run, signals
from needed_tools import tool

ROWS = signals(1000)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("precision", "ending", "modes"),
    [("double", "degraded", {1, 2, 4}), ("single", "held", {1, 3, 4})],
)
def test_50_000_periods_are_those_of_the_simulation(
    precision: str, ending: str, modes: set[int], tmp_path: Path
) -> None:
    """Noise, friction, saturation, NaN and lost sensors; every mode, and every flag
    that inputs can raise.
    """
    tool("cc", "gcc")
    made, rows, simulated = eventful(50_000, precision, ending)
    imported = Imported(
        export_fmu(
            made,
            tmp_path / "arm.fmu",
        ),
        tmp_path / "fmu",
    )
    imported.initialize()
    got = imported.run(rows, made.period)
    assert got.shape[0] > 50_000
    np.testing.assert_array_equal(
        got, outputs_of(made.run(made.initial_state(), *rows, first_tick=0)[1])
    )
    np.testing.assert_array_equal(got[:, 0], simulated.motor_reference)
    # the twin records the voltage that acts: that of the previous period
    np.testing.assert_array_equal(got[:-1, 1], simulated.voltage[1:])
    assert set(simulated.mode.tolist()) == modes
    seen = np.bitwise_or.reduce(simulated.flags)
    # Missed and repeated periods (8, 16) need another timer. A persistent residual
    # (256) needs an encoder that stands still; for a single period, a motor that an
    # event has pushed also deviates from its model.
    assert seen | 256 == 0x5FF - 8 - 16
    assert ending == "held" or seen & 256


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["single", "double"])
def test_fmpy_finds_no_problem_and_simulates_to_the_bit(
    precision: str, tmp_path: Path
) -> None:
    fmpy = fmpy_or_skip()
    tool("cc", "gcc")
    from fmpy.validation import validate_fmu

    made = law(precision)
    file = str(
        export_fmu(
            made,
            tmp_path / "arm.fmu",
        )
    )
    assert validate_fmu(file) == []
    names = [variable.name for variable in VARIABLES if variable.causality == "input"]
    table = np.zeros(
        ROWS.shape[1], dtype=[("time", float), *((name, float) for name in names)]
    )
    table["time"] = np.arange(ROWS.shape[1]) * PERIOD
    rows = np.vstack([ROWS, np.full(ROWS.shape[1], 0.05)])
    for name, row in zip(names, rows, strict=True):
        table[name] = row
    result = fmpy.simulate_fmu(
        file,
        input=table,
        stop_time=table["time"][-1],
        output_interval=PERIOD,
        validate=True,
    )
    own = run(made, rows, first_tick=0)
    got = np.column_stack(
        [result[v.name] for v in VARIABLES if v.causality == "output"]
    )
    np.testing.assert_array_equal(got[1:], outputs_of(own)[:-1])


@pytest.mark.slow
def test_the_description_and_the_library_know_the_same_variables(
    tmp_path: Path,
) -> None:
    tool("cc", "gcc")
    file = export_fmu(
        law(),
        tmp_path / "arm.fmu",
    )
    imported = Imported(file, tmp_path / "fmu")
    described = {v.valueReference: v for v in imported.about.modelVariables}
    assert [described[k].name for k in range(len(VARIABLES))] == [
        v.name for v in VARIABLES
    ]
    for reference, variable in enumerate(VARIABLES):
        assert described[reference].unit == (variable.unit or None)
        whole = "UInt32"
        assert described[reference].type == ("Float64" if variable.unit else whole)
    outputs = [v.name for v in VARIABLES if v.causality == "output"]
    assert [u.variable.name for u in imported.about.outputs] == outputs
    assert [u.variable.name for u in imported.about.initialUnknowns] == outputs
    assert all(u.dependencies == [] for u in imported.about.outputs)
    assert imported.about.defaultExperiment.stepSize == str(PERIOD)


def test_sources_only_and_the_same_law_the_same_file(tmp_path: Path) -> None:
    files = [
        export_fmu(law(), tmp_path / folder / "arm.fmu", compilers=())
        for folder in "ab"
    ]
    assert files[0].read_bytes() == files[1].read_bytes()
    with zipfile.ZipFile(files[0]) as archive:
        assert not any(name.startswith("binaries") for name in archive.namelist())
        assert all(
            info.external_attr >> 16 & stat.S_IROTH for info in archive.infolist()
        )
        assert (
            archive.read("sources/law.c")
            == (Path(__file__).parents[1] / "csrc" / "law.c").read_bytes()
        )


def test_another_law_has_another_token(tmp_path: Path) -> None:
    tokens = set()
    for precision in ("single", "double"):
        file = export_fmu(
            law(), tmp_path / f"{precision}_arm.fmu", precision=precision, compilers=()
        )
        with zipfile.ZipFile(file) as archive:
            root = ET.fromstring(archive.read("modelDescription.xml"))  # noqa: S314
        tokens.add(root.attrib["instantiationToken"])
    assert len(tokens) == 2


@pytest.mark.parametrize("name", ["arm.zip", "2 arms.fmu", "for.fmu"])
def test_bad_names_are_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(FieldError, match="out"):
        export_fmu(law(), tmp_path / name)
    assert not list(tmp_path.iterdir())


def _compiler(folder: Path, triple: str) -> str:
    """A program that claims to compile for `triple` but cannot."""
    path = folder / f"cc-{triple}"
    path.write_text(
        f"#!/bin/sh\n[ $1 = -dumpmachine ] && echo {triple} && exit\necho 'all.c:1: error: no' >&2; exit 1\n",
        encoding="utf-8",
    )
    path.chmod(0o755)
    return str(path)


def test_compilers_that_cannot_are_named(tmp_path: Path) -> None:
    out = tmp_path / "arm.fmu"
    with pytest.raises(FieldError, match=r"compiler: not installed"):
        export_fmu(law(), out, compilers=("no-such-cc",))
    with pytest.raises(
        FieldError, match=r"a platform that FMI has no name for .got riscv64-linux"
    ):
        export_fmu(law(), out, compilers=(_compiler(tmp_path, "riscv64-linux-gnu"),))
    with pytest.raises(
        FieldError, match=r"unable to compile the FMU \(all.c:1: error: no\)"
    ):
        export_fmu(law(), out, compilers=(_compiler(tmp_path, "arm64-apple-darwin23"),))
    assert not out.exists()


@pytest.mark.parametrize(
    ("triple", "platform", "place"),
    [
        (
            "x86_64-linux-gnu",
            "x86_64-linux",
            "x86_64-linux/arm.so",
        ),
        (
            "x86_64-w64-mingw32",
            "x86_64-windows",
            "x86_64-windows/arm.dll",
        ),
        (
            "x86_64-apple-darwin23",
            "x86_64-darwin",
            "x86_64-darwin/arm.dylib",
        ),
        ("arm64-apple-darwin23", "aarch64-darwin", "aarch64-darwin/arm.dylib"),
        ("aarch64-unknown-linux-gnu", "aarch64-linux", "aarch64-linux/arm.so"),
    ],
)
def test_a_library_stands_where_importers_look_for_it(
    triple: str, platform: str, place: str, tmp_path: Path
) -> None:
    """In place of a real compiler, a program that records how it was called."""
    compiler = tmp_path / "writes-it-down"
    compiler.write_text(
        f'#!/bin/sh\n[ "$1" = -dumpmachine ] && echo {triple} && exit\necho "$@" > law.library\n',
        "utf-8",
    )
    compiler.chmod(0o755)
    compilers = (str(compiler),)
    file = export_fmu(law(), tmp_path / "arm.fmu", compilers=compilers)
    with zipfile.ZipFile(file) as archive:
        called = archive.read(f"binaries/{place}").decode().split()
        dates = {info.date_time for info in archive.infolist()}
    assert dates == {(1980, 1, 1, 0, 0, 0)}
    # Without -ffp-contract=off the library would not be bitwise equal to the
    # simulation.
    assert {"-std=c99", "-O2", "-ffp-contract=off", "-shared", "all.c"} < set(called)
    with pytest.raises(FieldError, match=f"the second one for {platform}"):
        export_fmu(law(), tmp_path / "twice.fmu", compilers=2 * compilers)
