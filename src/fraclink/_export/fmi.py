"""The description of an FMU of the law: variables, units and identity in the form of
FMI 3.0.

Source: FMI 3.0, sections 2.4 and 2.5.
"""

from __future__ import annotations

import hashlib
import math
import uuid
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from typing import Literal, NamedTuple

from fraclink._law import MODES, REASONS, Law

__all__ = [
    "PLATFORMS",
    "VARIABLES",
    "Variable",
    "descriptions",
    "token_of",
]


class Variable(NamedTuple):
    """One variable; its position in `VARIABLES` is its value reference, which
    csrc/fmu/fmu_core.h knows.

    `start_from` names the variables from which its value before the first step follows;
    in a step no output depends on the inputs at the end of the step, so that an
    importer need not search for algebraic loops.
    """

    name: str
    causality: Literal["input", "output", "independent"]
    description: str
    unit: str = ""  # of a real one; integers have none
    largest: int = 0  # of an integer
    start_from: tuple[str, ...] = ()


VARIABLES: tuple[Variable, ...] = (
    Variable("reference", "input", "tip reference", "rad"),
    Variable(
        "reference_acceleration", "input", "acceleration of the tip reference", "rad/s2"
    ),
    Variable("motor_angle", "input", "encoder, at the gear's output", "rad"),
    Variable("torque", "input", "gauge: coupling torque", "N.m"),
    Variable(
        "motor_reference",
        "output",
        "reference of the motor angle",
        "rad",
        start_from=("motor_angle",),
    ),
    Variable(
        "voltage",
        "output",
        "voltage of the motor; 0 where the robot has its own servo",
        "V",
    ),
    Variable(
        "tip_estimate",
        "output",
        "motor angle - torque / stiffness",
        "rad",
        start_from=("motor_angle", "torque"),
    ),
    Variable(
        "mode",
        "output",
        ", ".join(f"{number} {name}" for number, name in enumerate(MODES)),
        largest=len(MODES) - 1,
    ),
    Variable(
        "reason",
        "output",
        ", ".join(f"{number} {name}" for number, name in enumerate(REASONS)),
        largest=len(REASONS) - 1,
    ),
    # 2047: all eleven bits of law.h.
    Variable(
        "flags",
        "output",
        "bits of the last period, LAW_FLAG_... in law.h",
        largest=2047,
    ),
    # The time and the input payload follow the outputs because they were added later:
    # value references stored by an importer must stay valid.
    Variable("time", "independent", "simulation time", "s"),
    Variable("payload", "input", "mass at the tip; 0 where it is not known", "kg"),
)


_RENAMED = {
    "reference": ("reference", "reference of the measurement"),
    "motor_angle": ("measurement", "measurement"),
    "motor_reference": (
        "filtered_reference",
        "measurement + (1 + C^) error, what the integral sees",
    ),
    "voltage": ("output", "output of the controller, limited"),
    "tip_estimate": (
        "measurement_used",
        "measurement, bridged where a sample was rejected",
    ),
}
_NO_EFFECT = "leave it at 0: without effect in a PID"


def _of_pid(variable: Variable) -> Variable:
    """A variable of the law as a variable of a PID, whose units only the user knows."""
    if not variable.unit or variable.causality == "independent":
        return variable
    name, description = _RENAMED.get(variable.name, (variable.name, _NO_EFFECT))
    start = ("measurement",) if variable.start_from else ()
    return variable._replace(
        name=name, description=description, unit="1", start_from=start
    )


PID_VARIABLES: tuple[Variable, ...] = tuple(_of_pid(variable) for variable in VARIABLES)


# Exponents of the SI base units.
UNITS: Mapping[str, Mapping[str, int]] = {
    "kg": {"kg": 1},
    "N.m": {"kg": 1, "m": 2, "s": -2},
    "V": {"kg": 1, "m": 2, "s": -3, "A": -1},
    "rad": {"rad": 1},
    "rad/s2": {"rad": 1, "s": -2},
    "s": {"s": 1},
    "1": {},
}


def token_of(sources: Mapping[str, str]) -> str:
    """Return the token of an FMU with these sources, which differs for every law and
    wrapper.
    """
    # The texts are joined by a character that C does not contain, so that moving a
    # boundary between them changes the hash.
    text = "\0".join(sources[name] for name in sorted(sources))
    digits = hashlib.sha256(text.encode()).hexdigest()
    # in the form of a GUID, as importers expect it
    return "{" + str(uuid.UUID(digits[:32])) + "}"


def _text(root: ET.Element) -> str:
    """Return the document of `root`, indented."""
    ET.indent(root)
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        + ET.tostring(root, encoding="unicode")
        + "\n"
    )


def _add_general(
    root: ET.Element, variables: tuple[Variable, ...], period: float
) -> None:
    """Add units, the single log category, and a default experiment of 500 periods."""
    units = ET.SubElement(root, "UnitDefinitions")
    symbols = {variable.unit for variable in variables}
    for name in (name for name in UNITS if name in symbols):
        element = ET.SubElement(units, "Unit", name=name)
        powers = {key: str(power) for key, power in UNITS[name].items()}
        ET.SubElement(element, "BaseUnit", powers)
        if name.startswith("rad"):
            # FMI defines display = factor·value (section 2.4.4): the factor for degrees
            # is 180/π, not its inverse.
            degrees = {
                "name": name.replace("rad", "deg"),
                "factor": repr(180 / math.pi),
            }
            ET.SubElement(element, "DisplayUnit", degrees)
    categories = ET.SubElement(root, "LogCategories")
    ET.SubElement(
        categories, "Category", name="logStatusError", description="why a call failed"
    )
    # 500 periods are two seconds at 4 ms, a move and its settling. An importer may
    # choose another end, but no other step.
    times = {"startTime": "0", "stopTime": repr(500 * period), "stepSize": repr(period)}
    ET.SubElement(root, "DefaultExperiment", times)


def _attributes(variable: Variable, reference: int) -> dict[str, str]:
    """Attributes of a variable: among them unit and start of a real one, range of an
    integer one.
    """
    attributes = {
        "name": variable.name,
        "valueReference": str(reference),
        "causality": variable.causality,
        # Outputs change only at the ends of steps and are constant in between, which
        # FMI calls discrete although the values are real.
        "variability": "discrete" if variable.causality == "output" else "continuous",
        "description": variable.description,
    }
    if not variable.unit:
        return attributes | {"min": "0", "max": str(variable.largest)}
    # Inputs have a start value; that of an output is calculated from the inputs that
    # `start_from` names.
    start = {"start": "0"} if variable.causality == "input" else {}
    return attributes | {"unit": variable.unit} | start


def _connected(law: Law) -> str:
    if law.motor_loop is None:
        return "connect motor_reference to the drive's own position servo"
    limit = f"within ±{law.motor_loop.voltage_limit:g}"
    return f"connect voltage, {limit} V" if law.has_gauge else f"output {limit}"


def descriptions(law: Law, name: str, token: str) -> dict[str, str]:
    """Return the files that describe the FMU of a law by their names: `name` is the
    model's C identifier, `token` ties the description to the library.
    """
    variables = VARIABLES if law.has_gauge else PID_VARIABLES
    what = "Control law of a flexible link" if law.has_gauge else "Fractional PID"
    root = ET.Element(
        "fmiModelDescription",
        fmiVersion="3.0",
        modelName=name,
        instantiationToken=token,
        # one line for the importer's user
        description=f"{what}, one step each period of {law.period:g} s; {_connected(law)}; law {law.digest}",
        generationTool="fraclink",
    )
    # No fixedInternalStepSize: it would allow communication steps of several periods,
    # during which the law would run on constant sensor values.
    ET.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=name,
        needsExecutionTool="false",
        # The poles of the filter are those of one period; another step would make
        # another filter.
        canHandleVariableCommunicationStepSize="false",
        # law.c has no static data: two arms in one simulation are two instances.
        canBeInstantiatedOnlyOncePerProcess="false",
        canGetAndSetFMUState="true",
        canSerializeFMUState="true",
    )
    _add_general(root, variables, law.period)
    listed = ET.SubElement(root, "ModelVariables")
    places = {}
    for reference, variable in enumerate(variables):
        kind = "Float64" if variable.unit else "UInt32"
        ET.SubElement(listed, kind, _attributes(variable, reference))
        places[variable.name] = str(reference)
    structure = ET.SubElement(root, "ModelStructure")
    outputs = [variable for variable in variables if variable.causality == "output"]
    for element in ("Output", "InitialUnknown"):
        for variable in outputs:
            # No output depends on the inputs at the end of a step; only initial values
            # depend on inputs.
            start = variable.start_from if element == "InitialUnknown" else ()
            dependencies = " ".join(places[other] for other in start)
            place = places[variable.name]
            ET.SubElement(
                structure, element, valueReference=place, dependencies=dependencies
            )
    build = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ET.SubElement(build, "BuildConfiguration", modelIdentifier=name)
    sources = ET.SubElement(configuration, "SourceFileSet", language="C99")
    ET.SubElement(sources, "SourceFile", name="all.c")
    return {
        "modelDescription.xml": _text(root),
        "sources/buildDescription.xml": _text(build),
    }


# Folders below binaries/, and how a library ends there.
PLATFORMS: Mapping[str, str] = {
    "x86_64-linux": ".so",
    "x86_64-windows": ".dll",
    "x86_64-darwin": ".dylib",
    "aarch64-linux": ".so",
    "aarch64-darwin": ".dylib",
}
