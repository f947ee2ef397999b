"""FMI 2.0: modelDescription.xml and the names of platforms (FMI 2.0.4, sections 2.2, 2.3 and 4.3)."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping

from fraclink._export.fmu_model import VARIABLES, FmuModel, Variable, xml_text

__all__ = ["PLATFORMS", "SOURCES", "descriptions"]

SOURCES: tuple[str, ...] = ("fmi2.c",)
PLATFORMS: Mapping[str, str] = {
    "x86_64-linux": "linux64",
    "x86_64-windows": "win64",
    "x86_64-darwin": "darwin64",
}


def descriptions(model: FmuModel) -> dict[str, str]:
    """Return the descriptions that an FMU of this version holds: file name and text."""
    root = ET.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=model.name,
        guid=model.token,
        description=model.description,
        generationTool="fraclink",
    )
    # the wrapper takes its few bytes from malloc: FMI 2 wants that stated
    interface = model.interface("state") | {"canNotUseMemoryManagementFunctions": "true"}
    simulation = ET.SubElement(root, "CoSimulation", interface)
    ET.SubElement(ET.SubElement(simulation, "SourceFiles"), "File", name="all.c")
    model.add_units(root)
    model.add_experiment(root)
    variables = ET.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(VARIABLES):
        _add_variable(variables, variable, reference)
    structure = ET.SubElement(root, "ModelStructure")
    place = {variable.name: index for index, variable in enumerate(VARIABLES, start=1)}
    outputs = [variable for variable in VARIABLES if variable.causality == "output"]
    listed = ET.SubElement(structure, "Outputs")
    for variable in outputs:
        ET.SubElement(listed, "Unknown", index=str(place[variable.name]), dependencies="")
    listed = ET.SubElement(structure, "InitialUnknowns")
    for variable in outputs:
        known = " ".join(str(place[name]) for name in variable.start_from)
        ET.SubElement(listed, "Unknown", index=str(place[variable.name]), dependencies=known)
    return {"modelDescription.xml": xml_text(root)}


def _add_variable(parent: ET.Element, variable: Variable, reference: int) -> None:
    element = ET.SubElement(
        parent,
        "ScalarVariable",
        name=variable.name,
        valueReference=str(reference),
        causality=variable.causality,
        variability="discrete" if variable.causality == "output" else "continuous",
        description=variable.description,
    )
    if variable.real:
        start = {"start": "0"} if variable.causality == "input" else {}
        ET.SubElement(element, "Real", {"unit": variable.unit} | start)
    else:
        ET.SubElement(element, "Integer", min="0", max=str(variable.largest))
