"""The description of an FMU of the law: variables, units and identity in the form of
FMI 3.0.

Source: FMI 3.0, sections 2.4 and 2.5.
"""

from __future__ import annotations

import hashlib
import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple

from fraclink._law import MODES, REASONS

__all__ = [
    "PID_VARIABLES",
    "PLATFORMS",
    "UNITS",
    "VARIABLES",
    "FmuModel",
    "Unit",
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
    unit: str = ""  # integers have none
    largest: int = 0  # of an integer
    start_from: tuple[str, ...] = ()

    @property
    def real(self) -> bool:
        """Whether it is real, not an integer."""
        return bool(self.unit)


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
    if not variable.real or variable.causality == "independent":
        return variable
    name, description = _RENAMED.get(variable.name, (variable.name, _NO_EFFECT))
    start = ("measurement",) if variable.start_from else ()
    return variable._replace(
        name=name, description=description, unit="1", start_from=start
    )


PID_VARIABLES: tuple[Variable, ...] = tuple(_of_pid(variable) for variable in VARIABLES)


class Unit(NamedTuple):
    """Exponents of the SI base units, and a unit to display it in with its factor."""

    base: Mapping[str, int]
    display: tuple[str, float] | None = None


UNITS: Mapping[str, Unit] = {
    "kg": Unit({"kg": 1}),
    "N.m": Unit({"kg": 1, "m": 2, "s": -2}),
    "V": Unit({"kg": 1, "m": 2, "s": -3, "A": -1}),
    # FMI defines display = factor·value (section 2.4.4): the factor for degrees is
    # 180/π, not its inverse.
    "rad": Unit({"rad": 1}, ("deg", 180.0 / math.pi)),
    "rad/s2": Unit({"rad": 1, "s": -2}, ("deg/s2", 180.0 / math.pi)),
    "s": Unit({"s": 1}),
    "1": Unit({}),
}


@dataclass(frozen=True)
class FmuModel:
    """The model that modelDescription.xml describes.

    `name` is the model's C identifier, `token` ties the description to the library,
    `period` [s] is the only communication step, `digest` identifies the law,
    `connected` names the output to use, `variables` are `VARIABLES` or those of a PID,
    in the same order.
    """

    name: str
    token: str
    period: float
    digest: str
    connected: str
    variables: tuple[Variable, ...] = VARIABLES

    @property
    def description(self) -> str:
        """One line for the importer's user."""
        what = (
            "Control law of a flexible link"
            if self.variables is VARIABLES
            else "Fractional PID"
        )
        return (
            f"{what}, one step each period of {self.period:g} s; {self.connected}; "
            f"law {self.digest}"
        )

    @property
    def interface(self) -> dict[str, str]:
        """Attributes of the element CoSimulation."""
        return {
            "modelIdentifier": self.name,
            "needsExecutionTool": "false",
            # The poles of the filter are those of one period; another step would make
            # another filter.
            "canHandleVariableCommunicationStepSize": "false",
            # law.c has no static data: two arms in one simulation are two instances.
            "canBeInstantiatedOnlyOncePerProcess": "false",
            "canGetAndSetFMUState": "true",
            "canSerializeFMUState": "true",
        }


def token_of(sources: Mapping[str, str]) -> str:
    """Return the token of an FMU with these sources, which differs for every law and
    wrapper.
    """
    # The texts are joined by a character that C does not contain, so that moving a
    # boundary between them changes the hash.
    digits = hashlib.sha256(
        "\0".join(sources[name] for name in sorted(sources)).encode()
    ).hexdigest()[:32]
    return (
        "{"
        + "-".join(
            (digits[:8], digits[8:12], digits[12:16], digits[16:20], digits[20:])
        )
        + "}"
    )


def _text(root: ET.Element) -> str:
    """Return the document of `root`, indented."""
    ET.indent(root)
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        + ET.tostring(root, encoding="unicode")
        + "\n"
    )


def _add_general(root: ET.Element, model: FmuModel) -> None:
    """Add units, the single log category, and a default experiment of 500 periods."""
    units = ET.SubElement(root, "UnitDefinitions")
    symbols = {variable.unit for variable in model.variables}
    for name, unit in ((name, unit) for name, unit in UNITS.items() if name in symbols):
        element = ET.SubElement(units, "Unit", name=name)
        ET.SubElement(
            element, "BaseUnit", {key: str(power) for key, power in unit.base.items()}
        )
        if unit.display is not None:
            display, factor = unit.display
            ET.SubElement(element, "DisplayUnit", name=display, factor=repr(factor))
    categories = ET.SubElement(root, "LogCategories")
    ET.SubElement(
        categories, "Category", name="logStatusError", description="why a call failed"
    )
    # 500 periods are two seconds at 4 ms, a move and its settling. An importer may
    # choose another end, but no other step.
    times = {
        "startTime": "0",
        "stopTime": repr(500 * model.period),
        "stepSize": repr(model.period),
    }
    ET.SubElement(root, "DefaultExperiment", times)


def _about(variable: Variable, reference: int) -> dict[str, str]:
    return {
        "name": variable.name,
        "valueReference": str(reference),
        "causality": variable.causality,
        # Outputs change only at the ends of steps and are constant in between, which
        # FMI calls discrete although the values are real.
        "variability": "discrete" if variable.causality == "output" else "continuous",
        "description": variable.description,
    }


def _value(variable: Variable) -> dict[str, str]:
    """Attributes of a variable's value: unit and start of a real variable, range of an
    integer one.
    """
    if not variable.real:
        return {"min": "0", "max": str(variable.largest)}
    # Inputs have a start value; that of an output is calculated from the inputs that
    # `start_from` names.
    return {"unit": variable.unit} | (
        {"start": "0"} if variable.causality == "input" else {}
    )


def _unknowns(listed: tuple[Variable, ...]) -> list[tuple[str, str]]:
    """For each output its value reference, and those of the variables from which its
    start value is calculated.
    """
    place = {variable.name: str(index) for index, variable in enumerate(listed)}
    outputs = [variable for variable in listed if variable.causality == "output"]
    return [
        (place[v.name], " ".join(place[name] for name in v.start_from)) for v in outputs
    ]


def descriptions(model: FmuModel) -> dict[str, str]:
    """Return the files that describe a model by their names."""
    root = ET.Element(
        "fmiModelDescription",
        fmiVersion="3.0",
        modelName=model.name,
        instantiationToken=model.token,
        description=model.description,
        generationTool="fraclink",
    )
    # No fixedInternalStepSize: it would allow communication steps of several periods,
    # during which the law would run on constant sensor values.
    ET.SubElement(root, "CoSimulation", model.interface)
    _add_general(root, model)
    variables = ET.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(model.variables):
        kind = "Float64" if variable.real else "UInt32"
        ET.SubElement(variables, kind, _about(variable, reference) | _value(variable))
    structure = ET.SubElement(root, "ModelStructure")
    for place, _ in _unknowns(model.variables):
        ET.SubElement(structure, "Output", valueReference=place, dependencies="")
    for place, dependencies in _unknowns(model.variables):
        ET.SubElement(
            structure, "InitialUnknown", valueReference=place, dependencies=dependencies
        )
    build = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ET.SubElement(
        build, "BuildConfiguration", modelIdentifier=model.name
    )
    sources = ET.SubElement(configuration, "SourceFileSet", language="C99")
    ET.SubElement(sources, "SourceFile", name="all.c")
    return {
        "modelDescription.xml": _text(root),
        "sources/buildDescription.xml": _text(build),
    }


# Folders below binaries/.
PLATFORMS = (
    "x86_64-linux",
    "x86_64-windows",
    "x86_64-darwin",
    "aarch64-linux",
    "aarch64-darwin",
)
