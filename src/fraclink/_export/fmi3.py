"""FMI 3.0: both descriptions and the names of platforms (FMI 3.0, sections 2.4 and 2.5)."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping

from fraclink._export.fmu_model import VARIABLES, FmuModel, xml_text

__all__ = ["PLATFORMS", "SOURCES", "descriptions"]

SOURCES: tuple[str, ...] = ("fmi3.c", "fmi3_not_offered.h")
PLATFORMS: Mapping[str, str] = {
    name: name
    for name in ("x86_64-linux", "x86_64-windows", "x86_64-darwin", "aarch64-linux", "aarch64-darwin")
}


def descriptions(model: FmuModel) -> dict[str, str]:
    """Return the descriptions that an FMU of this version holds: file name and text."""
    return {
        "modelDescription.xml": _model_description(model),
        "sources/buildDescription.xml": _build_description(model),
    }


def _model_description(model: FmuModel) -> str:
    root = ET.Element(
        "fmiModelDescription",
        fmiVersion="3.0",
        modelName=model.name,
        instantiationToken=model.token,
        description=model.description,
        generationTool="fraclink",
    )
    # No fixedInternalStepSize: it would allow communication steps of several periods, in which the law would
    # run on sensors that stand still.
    ET.SubElement(root, "CoSimulation", model.interface("State"))
    model.add_units(root)
    model.add_experiment(root)
    variables = ET.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(VARIABLES):
        about = {
            "name": variable.name,
            "valueReference": str(reference),
            "causality": variable.causality,
            "variability": "discrete" if variable.causality == "output" else "continuous",
            "description": variable.description,
        }
        if variable.real:
            start = {"start": "0"} if variable.causality == "input" else {}
            ET.SubElement(variables, "Float64", about | {"unit": variable.unit} | start)
        else:
            ET.SubElement(variables, "UInt32", about | {"min": "0", "max": str(variable.largest)})
    structure = ET.SubElement(root, "ModelStructure")
    place = {variable.name: reference for reference, variable in enumerate(VARIABLES)}
    outputs = [variable for variable in VARIABLES if variable.causality == "output"]
    for variable in outputs:
        ET.SubElement(structure, "Output", valueReference=str(place[variable.name]), dependencies="")
    for variable in outputs:
        known = " ".join(str(place[name]) for name in variable.start_from)
        ET.SubElement(
            structure, "InitialUnknown", valueReference=str(place[variable.name]), dependencies=known
        )
    return xml_text(root)


def _build_description(model: FmuModel) -> str:
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    build = ET.SubElement(root, "BuildConfiguration", modelIdentifier=model.name)
    sources = ET.SubElement(build, "SourceFileSet", language="C99")
    ET.SubElement(sources, "SourceFile", name="all.c")
    return xml_text(root)
