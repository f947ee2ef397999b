"""What an FMU says of itself: variables, dependencies, units, identity, and its page."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path

import pytest

import fraclink as fl
from fmu_bench import fmpy_or_skip
from fraclink._export import export_fmu
from fraclink._law import Law
from law_bench import law

# FMI 3.0, sections 2.4.7 and 2.4.8. Name,
# causality, unit, where the value before the first step comes from; the place is the
# value reference.
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
    ("flags", "output", (0, 1023), ()),
    ("time", "independent", "s", ()),
    ("payload", "input", "kg", ()),
)
# A PID does not know the units of what it controls.
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
BASE = {
    "kg": {"kg": "1"},
    "N.m": {"kg": "1", "m": "2", "s": "-2"},
    "V": {"kg": "1", "m": "2", "s": "-3", "A": "-1"},
    "rad": {"rad": "1"},
    "rad/s2": {"rad": "1", "s": "-2"},
    "s": {"s": "1"},
    "1": {},
}


@cache
def pid() -> Law:
    controller = fl.extend.FractionalPid(2.0, integral=3.0, integral_order=0.8)
    return fl.extend.discretize_pid(
        controller, 0.01, output_limit=7.5, measurement_limit=2.0
    )


def _written(made: Law, folder: Path) -> tuple[ET.Element, dict[str, str]]:
    """The root of modelDescription.xml, and every text of the FMU by its name."""
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
        expected |= (
            {"start": "0"} if causality == "input" else {}
        )  # FMI wants one of every input
        assert about == expected
        assert kind == ("Float64" if isinstance(unit, str) else "UInt32")
    without = "leave it at 0: without effect in a PID"
    assert [k for k, about in enumerate(listed) if about["description"] == without] == (
        [] if of_arm else [1, 3, 11]
    )
    assert listed[7]["description"] == "0 idle, 1 run, 2 degraded, 3 hold, 4 off"


@pytest.mark.parametrize("of_arm", [True, False])
def test_dependencies_units_and_times_of_the_description(
    of_arm: bool, tmp_path: Path
) -> None:
    made, wanted = (law(), OF_ARM) if of_arm else (pid(), OF_PID)
    root, _ = _written(made, tmp_path)
    # No output depends on an input at once.
    outputs = [
        k for k, (_, causality, _, _) in enumerate(wanted) if causality == "output"
    ]
    at_once = [(str(k), "") for k in outputs]
    starts = [(str(k), " ".join(str(j) for j in wanted[k][3])) for k in outputs]
    key = "valueReference"
    for path, expected in (("Output", at_once), ("InitialUnknown", starts)):
        found = [item.attrib for item in root.findall(f"ModelStructure/{path}")]
        assert [(item[key], item["dependencies"]) for item in found] == expected
    units = {item.attrib["name"]: item for item in root.findall("UnitDefinitions/Unit")}
    assert set(units) == {unit for _, _, unit, _ in wanted if isinstance(unit, str)}
    for name, item in units.items():
        assert item[0].tag == "BaseUnit" and item[0].attrib == BASE[name]
        shown = [
            (part.attrib["name"], float(part.attrib["factor"]))
            for part in item.findall("DisplayUnit")
        ]
        # display = factor * value, as the standard has it: 1 rad is shown as 57.3
        # deg
        degrees = {"rad": "deg", "rad/s2": "deg/s2"}
        assert shown == (
            [(degrees[name], pytest.approx(57.29577951308232))]
            if name in degrees
            else []
        )
    times = root.find("DefaultExperiment")
    assert times is not None
    assert {key: float(value) for key, value in times.attrib.items()} == pytest.approx(
        {"startTime": 0.0, "stopTime": 500 * made.period, "stepSize": made.period}
    )


def test_what_an_importer_may_do_is_said(tmp_path: Path) -> None:
    made = law("single")
    root, texts = _written(made, tmp_path)
    expected = {
        "modelIdentifier": "arm",
        "needsExecutionTool": "false",
        "canHandleVariableCommunicationStepSize": "false",
        "canBeInstantiatedOnlyOncePerProcess": "false",
        "canGetAndSetFMUState": "true",
        "canSerializeFMUState": "true",
    }
    simulation = root.find("CoSimulation")
    assert simulation is not None
    assert simulation.attrib == expected
    token = root.attrib["instantiationToken"]
    assert re.fullmatch(r"\{[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}\}", token)
    assert root.attrib["fmiVersion"] == "3.0"
    assert root.attrib["modelName"] == "arm"
    about = f"Control law of a flexible link, one step each period of 0.004 s; law {made.digest}"
    assert root.attrib["description"] == about
    # The library answers to no other description: FMI calls the token the proof that
    # both belong together.
    unit = texts["sources/all.c"]
    assert f'#define FMU_TOKEN "{token}"' in unit
    assert float.fromhex(re.findall(r"FMU_PERIOD (\S+)", unit)[0]) == made.period
    assert "#define LAW_SINGLE" in unit.splitlines()
    assert "#define law_step arm_law_step" in unit.splitlines()
    assert re.findall(r'#include "(.+)"', unit) == [
        "law.c",
        "law_data.h",
        "fmi3.c",
    ]
    assert f"law {made.digest}" in texts["sources/law_data.h"]
    build = ET.fromstring(texts["sources/buildDescription.xml"])  # noqa: S314
    tree = [(item.tag, item.attrib) for item in build.iter()]
    assert tree == [
        ("fmiBuildDescription", {"fmiVersion": "3.0"}),
        ("BuildConfiguration", {"modelIdentifier": "arm"}),
        ("SourceFileSet", {"language": "C99"}),
        ("SourceFile", {"name": "all.c"}),
    ]


@pytest.mark.parametrize("of_arm", [True, False])
def test_another_program_takes_the_description(of_arm: bool, tmp_path: Path) -> None:
    """FMPy compares it with the schema of the standard and with the rules that a schema
    cannot hold.
    """
    fmpy = fmpy_or_skip()
    made = law() if of_arm else pid()
    file = export_fmu(made, tmp_path / "arm.fmu", compilers=())
    about = fmpy.read_model_description(str(file), validate=True)
    assert about.coSimulation.modelIdentifier == "arm"
    assert float(about.defaultExperiment.stepSize) == made.period


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (
            partial(law, equipped=False),
            (
                "connect motor_reference, not voltage",
                "the arm is taken to rest at motor_angle",
            ),
        ),
        (
            law,
            (
                "connect voltage, within ±10 V.",
                "the arm is taken to rest at motor_angle",
            ),
        ),
        (
            pid,
            (
                "connect output, within ±7.5.",
                "the controller is at rest, and its filter empty",
            ),
        ),
    ],
    ids=["its own motor loop", "arm", "PID"],
)
def test_the_page_says_what_to_connect(
    make: Callable[[], Law], told: tuple[str, str], tmp_path: Path
) -> None:
    made = make()
    _, texts = _written(made, tmp_path)
    page = re.sub(r"<[^>]+>", "", texts["documentation/index.html"])
    for words in (
        *told,
        f"step is {made.period!r} s, constant",
        f"law {made.digest}; {made.precision} precision",
    ):
        assert words in page
