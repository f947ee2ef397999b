"""What an FMU of the law is, whatever the version of the standard: its variables, units and identity."""

from __future__ import annotations

import hashlib
import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple

from fraclink._law import MODES, REASONS

__all__ = ["UNITS", "VARIABLES", "FmuModel", "Unit", "Variable", "token_of", "xml_text"]


class Variable(NamedTuple):
    """One variable; its position in `VARIABLES` is its value reference, which csrc/fmu/fmu_core.h knows.

    `start_from` names what its value before the first step follows from; in a step no output depends on the
    inputs at the step's end, so that an importer need not look for algebraic loops.
    """

    name: str
    causality: Literal["input", "output", "independent"]
    description: str
    unit: str = ""  # a whole number has none
    largest: int = 0  # of a whole number
    start_from: tuple[str, ...] = ()

    @property
    def real(self) -> bool:
        """Whether it is a real number, not a whole one."""
        return bool(self.unit)


VARIABLES: tuple[Variable, ...] = (
    Variable("reference", "input", "tip reference", "rad"),
    Variable("reference_acceleration", "input", "acceleration of the tip reference", "rad/s2"),
    Variable("motor_angle", "input", "encoder, at the gear's output", "rad"),
    Variable("torque", "input", "gauge: coupling torque", "N.m"),
    Variable("motor_reference", "output", "reference of the motor angle", "rad", start_from=("motor_angle",)),
    Variable("voltage", "output", "voltage of the motor; 0 where the robot has its own servo", "V"),
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
        "reason", "output", "why a mode above run was entered, LAW_... in law.h", largest=len(REASONS) - 1
    ),
    Variable("flags", "output", "bits of the last period, LAW_FLAG_... in law.h", largest=1023),
    Variable("time", "independent", "simulation time", "s"),
    Variable("payload", "input", "mass at the tip; 0 where it is not known", "kg"),
)


class Unit(NamedTuple):
    """Exponents of the SI base units, and a unit to display it in with its factor."""

    base: Mapping[str, int]
    display: tuple[str, float] | None = None


UNITS: Mapping[str, Unit] = {
    "kg": Unit({"kg": 1}),
    "N.m": Unit({"kg": 1, "m": 2, "s": -2}),
    "V": Unit({"kg": 1, "m": 2, "s": -3, "A": -1}),
    "rad": Unit({"rad": 1}, ("deg", 180.0 / math.pi)),
    "rad/s2": Unit({"rad": 1, "s": -2}, ("deg/s2", 180.0 / math.pi)),
    "s": Unit({"s": 1}),
}


@dataclass(frozen=True)
class FmuModel:
    """The model that modelDescription.xml describes.

    `name` is the model's C identifier, `token` (FMI 2: guid) ties the description to the library, `period`
    [s] is the only communication step, `digest` identifies the law.
    """

    name: str
    token: str
    period: float
    digest: str

    @property
    def description(self) -> str:
        """One line for the importer's user."""
        return f"Control law of a flexible link, one step each period of {self.period:g} s; law {self.digest}"

    def interface(self, state_word: str) -> dict[str, str]:
        """Attributes of the element CoSimulation; FMI 2 and 3 write "state" of `state_word` differently."""
        return {
            "modelIdentifier": self.name,
            "needsExecutionTool": "false",
            "canHandleVariableCommunicationStepSize": "false",
            "canBeInstantiatedOnlyOncePerProcess": "false",
            f"canGetAndSetFMU{state_word}": "true",
            f"canSerializeFMU{state_word}": "true",
        }

    def add_units(self, root: ET.Element) -> None:
        """Add the units, which both versions write alike."""
        units = ET.SubElement(root, "UnitDefinitions")
        for name, unit in UNITS.items():
            element = ET.SubElement(units, "Unit", name=name)
            ET.SubElement(element, "BaseUnit", {key: str(power) for key, power in unit.base.items()})
            if unit.display is not None:
                display, factor = unit.display
                ET.SubElement(element, "DisplayUnit", name=display, factor=repr(factor))

    def add_experiment(self, root: ET.Element) -> None:
        """Add the only category of messages, and 500 periods as the experiment to start with."""
        categories = ET.SubElement(root, "LogCategories")
        ET.SubElement(categories, "Category", name="logStatusError", description="why a call failed")
        ET.SubElement(
            root,
            "DefaultExperiment",
            startTime="0",
            stopTime=repr(500 * self.period),
            stepSize=repr(self.period),
        )


def token_of(sources: Mapping[str, str]) -> str:
    """Return the token of an FMU made of these sources: another law or another wrapper, another token."""
    digits = hashlib.sha256("\0".join(sources[name] for name in sorted(sources)).encode()).hexdigest()[:32]
    return "{" + "-".join((digits[:8], digits[8:12], digits[12:16], digits[16:20], digits[20:])) + "}"


def xml_text(root: ET.Element) -> str:
    """Return the document of `root`, indented."""
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"
