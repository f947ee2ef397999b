"""The description of an FMU: variables, dependencies, units, identity, and its page."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
import zipfile
from functools import cache
from pathlib import Path

import pytest

import fraclink as fl
from fmu_bench import fmpy_or_skip
from fraclink import Law, export_fmu
from law_bench import law

# FMI 3.0, sections 2.4.7 and 2.4.8. Name, causality, unit, and where the value before
# the first step comes from; the position is the value reference.
OF_ARM = (
    ("reference", "input", "rad", ()),
    ("reference_acceleration", "input", "rad/s2", ()),
    ("motor_angle", "input", "rad", ()),
    ("torque", "input", "N.m", ()),
    ("motor_reference", "output", "rad", (2,)),
    ("voltage", "output", "V", ()),
    ("tip_estimate", "output", "rad", (2, 3)),
    ("mode", "output", (0, 4), ()),
    ("reason", "output", (0, 15), ()),
    ("flags", "output", (0, 2047), ()),
    ("time", "independent", "s", ()),
    ("payload", "input", "kg", ()),
)
# The units of the quantities that a PID controls are not known.
OF_PID = (
    ("reference", "input", "1", ()),
    ("reference_acceleration", "input", "1", ()),
    ("measurement", "input", "1", ()),
    ("torque", "input", "1", ()),
    ("filtered_reference", "output", "1", (2,)),
    ("output", "output", "1", ()),
    ("measurement_used", "output", "1", (2,)),
    *OF_ARM[7:11],
    ("payload", "input", "1", ()),
)


@cache
def pid() -> Law:
    controller = fl.extend.FractionalPid(2.0, integral=3.0, integral_order=0.8)
    return fl.extend.discretize_pid(
        controller, 0.01, output_limit=7.5, measurement_limit=2.0
    )


def _written(made: Law, folder: Path) -> tuple[ET.Element, dict[str, str]]:
    """Return the root of modelDescription.xml, and all texts of the FMU by name."""
    file = export_fmu(made, folder / "arm.fmu", compilers=())
    with zipfile.ZipFile(file) as archive:
        texts = {name: archive.read(name).decode() for name in archive.namelist()}
    return ET.fromstring(texts["modelDescription.xml"]), texts  # noqa: S314


@pytest.mark.parametrize("of_arm", [True, False])
def test_every_variable_is_described_as_the_standard_wants(
    of_arm: bool, tmp_path: Path
) -> None:
    made, wanted = (law(), OF_ARM) if of_arm else (pid(), OF_PID)
    root, _ = _written(made, tmp_path)
    variables = root.findall("ModelVariables/*")
    listed = [dict(item.attrib) for item in variables]
    kinds = [item.tag for item in variables]
    assert len(listed) == len(wanted)
    for place, (kind, about, (name, causality, unit, _)) in enumerate(
        zip(kinds, listed, wanted, strict=True)
    ):
        discrete = "discrete" if causality == "output" else "continuous"
        expected = {"name": name, "valueReference": str(place), "causality": causality}
        expected |= {"variability": discrete, "description": about["description"]}
        expected |= (
            {"unit": unit}
            if isinstance(unit, str)
            else {"min": str(unit[0]), "max": str(unit[1])}
        )
        # FMI requires one for every input
        expected |= {"start": "0"} if causality == "input" else {}
        assert about == expected
        assert kind == ("Float64" if isinstance(unit, str) else "UInt32")
    without = "leave it at 0: without effect in a PID"
    assert [k for k, about in enumerate(listed) if about["description"] == without] == (
        [] if of_arm else [1, 3, 11]
    )
    assert listed[7]["description"] == "0 idle, 1 run, 2 degraded, 3 hold, 4 off"


def test_units_are_powers_of_the_si_base_units(tmp_path: Path) -> None:
    """The SI brochure: N·m = kg m² s⁻², and V = N·m/(A·s)."""
    root, _ = _written(law(), tmp_path)
    told = {
        unit.get("name"): unit.find("BaseUnit").attrib  # type: ignore[union-attr]
        for unit in root.findall("UnitDefinitions/Unit")
    }
    torque = {"kg": "1", "m": "2", "s": "-2"}
    assert told == {
        "kg": {"kg": "1"},
        "N.m": torque,
        "V": torque | {"s": "-3", "A": "-1"},
        "rad": {"rad": "1"},
        "rad/s2": {"rad": "1", "s": "-2"},
        "s": {"s": "1"},
    }


def test_angles_are_shown_in_degrees(tmp_path: Path) -> None:
    root, _ = _written(law(), tmp_path)
    shown = root.findall("UnitDefinitions/Unit[@name='rad']/DisplayUnit")
    assert [unit.get("name") for unit in shown] == ["deg"]
    assert float(shown[0].get("factor", "")) == pytest.approx(180.0 / math.pi)


@pytest.mark.parametrize("of_arm", [True, False])
def test_another_program_takes_the_description(of_arm: bool, tmp_path: Path) -> None:
    """FMPy checks it against the schema of the standard and against rules that a schema
    cannot express.
    """
    fmpy = fmpy_or_skip()
    made = law() if of_arm else pid()
    file = export_fmu(made, tmp_path / "arm.fmu", compilers=())
    about = fmpy.read_model_description(str(file), validate=True)
    assert about.coSimulation.modelIdentifier == "arm"
    assert float(about.defaultExperiment.stepSize) == made.period
