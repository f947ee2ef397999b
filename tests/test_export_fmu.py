"""The FMU: its library driven through the functions of the standard, against the package, bit for bit."""

from __future__ import annotations

import ctypes
import importlib.util
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path

import numpy as np
import pytest

from fraclink.errors import FieldError
from fraclink.export import export_fmu
from law_bench import PERIOD, law, run, signals
from needed_tools import missing, tool

ROWS = signals(1000)


def _guid(archive: zipfile.ZipFile) -> str:
    root = ET.fromstring(archive.read("modelDescription.xml"))  # noqa: S314 - our own file
    return root.attrib["guid"]


@pytest.mark.parametrize("precision", ["single", "double"])
def test_the_library_is_the_law(precision: str, tmp_path: Path) -> None:
    tool("cc", "gcc")
    made = law(precision)
    with zipfile.ZipFile(export_fmu(made, tmp_path / "arm.fmu")) as archive:
        archive.extractall(tmp_path / "fmu")
        guid = _guid(archive)
    library = ctypes.CDLL(str(tmp_path / "fmu" / "binaries" / "linux64" / "arm.so"))
    library.fmi2Instantiate.restype = ctypes.c_void_p
    assert library.fmi2Instantiate(b"a", 1, b"{wrong}", b"", None, 0, 0) is None
    me = ctypes.c_void_p(library.fmi2Instantiate(b"a", 1, guid.encode(), b"", None, 0, 0))
    assert me.value is not None
    inputs, outputs = (ctypes.c_uint * 4)(0, 1, 2, 3), (ctypes.c_uint * 3)(4, 5, 6)
    modes = (ctypes.c_uint * 3)(7, 8, 9)
    values, reals, integers = (ctypes.c_double * 4)(), (ctypes.c_double * 3)(), (ctypes.c_int * 3)()
    got = np.empty((1000, 6))
    for k in range(1000):
        values[:] = ROWS[:, k].tolist()
        assert library.fmi2SetReal(me, inputs, ctypes.c_size_t(4), values) == 0
        assert library.fmi2DoStep(me, ctypes.c_double(k * PERIOD), ctypes.c_double(PERIOD), 1) == 0
        library.fmi2GetReal(me, outputs, ctypes.c_size_t(3), reals)
        library.fmi2GetInteger(me, modes, ctypes.c_size_t(3), integers)
        got[k] = [*reals, *integers]
    own = run(made, ROWS)
    wanted = [own.motor_reference, own.voltage, own.tip_estimate, own.mode, own.reason, own.flags]
    np.testing.assert_array_equal(got, np.column_stack(wanted))
    assert library.fmi2DoStep(me, ctypes.c_double(0), ctypes.c_double(0.003), 1) == 3
    assert library.fmi2SetReal(me, outputs, ctypes.c_size_t(3), reals) == 3
    library.fmi2FreeInstance(me)


def test_the_description_lists_every_output_twice(tmp_path: Path) -> None:
    with zipfile.ZipFile(export_fmu(law(), tmp_path / "arm.fmu", binary=False)) as archive:
        root = ET.fromstring(archive.read("modelDescription.xml"))  # noqa: S314 - our own file
        names = archive.namelist()
    outputs = [
        str(i) for i, v in enumerate(root.iter("ScalarVariable"), 1) if v.attrib["causality"] == "output"
    ]
    for part in ("Outputs", "InitialUnknowns"):
        assert [u.attrib["index"] for u in root.find("ModelStructure").find(part)] == outputs  # type: ignore[union-attr]
    assert "sources/all.c" in names
    assert not any(name.startswith("binaries") for name in names)


def test_the_standards_own_checker_finds_no_problem(tmp_path: Path) -> None:
    if importlib.util.find_spec("fmpy") is None:
        missing("FMPy is not installed (PyPI package fmpy)")
    from fmpy.validation import validate_fmu

    for precision in ("single", "double"):
        assert validate_fmu(str(export_fmu(law(precision), tmp_path / f"{precision}_law.fmu"))) == []


def test_the_same_law_gives_the_same_file(tmp_path: Path) -> None:
    first, second = (export_fmu(law(), tmp_path / f / "arm.fmu", binary=False).read_bytes() for f in "ab")
    assert first == second


@pytest.mark.parametrize("name", ["arm.zip", "2 arms.fmu", "for.fmu"])
def test_bad_names_are_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(FieldError, match="out"):
        export_fmu(law(), tmp_path / name)
    assert not list(tmp_path.iterdir())
