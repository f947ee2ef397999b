"""Export the law as an FMU (FMI 2.0, co-simulation): its C sources, and a binary where a compiler is at
hand.
"""

from __future__ import annotations

import io
import shutil
import subprocess
import tempfile
import zipfile
from pathlib import Path
from xml.sax.saxutils import quoteattr

from fraclink.errors import FieldError
from fraclink.export.data import data_header
from fraclink.export.fmu_source import VARIABLES, WRAPPER
from fraclink.export.names import identifier
from fraclink.export.sources import law_source
from fraclink.files import atomic_write, output_path
from fraclink.law import Law

__all__ = ["export_fmu"]


def export_fmu(
    law: Law, path: Path | str, *, binary: bool = True, force: bool = False, compiler: str = "cc"
) -> Path:
    """Write the law as an FMU for co-simulation (FMI 2.0) to `path`, ending in .fmu, and return it.

    Inputs: reference [rad], reference_acceleration [rad/s²], motor_angle [rad], torque [N·m]. Outputs:
    motor_reference [rad], voltage [V], tip_estimate [rad], mode, reason, flags. One communication step is one
    period [s]; another step size is an error. The outputs of a step answer the inputs at its beginning, so
    the co-simulation adds the one period of delay that the design counts on. Sources are always inside;
    `binary` adds a Linux x86-64 library made by `compiler`, which FieldError names where it is missing. An
    existing file needs `force`; the file's name must be a C identifier.

    >>> import fraclink as fl, tempfile
    >>> rig = fl.Rig.named("paper-2023")
    >>> law = fl.Controller(gain=0.069876, order=0.612197, link=rig.model).discretize(rig.period, order=4)
    >>> export_fmu(law, Path(tempfile.mkdtemp()) / "arm_law.fmu", binary=False).name
    'arm_law.fmu'
    """
    place = output_path(path, force=force)
    if place.suffix != ".fmu":
        raise FieldError("out", place.name, "of another kind", allowed=".fmu", remedy="end the name in .fmu")
    name = identifier("out", place.stem)
    define = "#define LAW_SINGLE\n" if law.precision == "single" else ""
    sources = {
        "law.h": law_source("law.h").decode(),
        "law.c": law_source("law.c").decode(),
        "law_data.h": data_header(law, name="law_data", title=""),
        # one translation unit, so that a tool needs no flags of ours but those of the language
        "all.c": f'{define}#include "law.c"\n#include "law_data.h"\n'
        + WRAPPER.replace("@GUID@", _guid(law)).replace("@PERIOD@", law.period.hex()),
    }
    parts = {f"sources/{file}": text.encode() for file, text in sources.items()}
    parts["modelDescription.xml"] = _description(law, name).encode()
    if binary:
        parts[f"binaries/linux64/{name}.so"] = _library(sources, compiler)
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted(parts):
            # a fixed date: the same law gives the same file
            archive.writestr(zipfile.ZipInfo(file, (1980, 1, 1, 0, 0, 0)), parts[file], zipfile.ZIP_DEFLATED)
    with atomic_write(place, "wb") as out:
        out.write(stream.getvalue())
    return place


def _guid(law: Law) -> str:
    digits = law.digest[:32]
    return "{" + "-".join((digits[:8], digits[8:12], digits[12:16], digits[16:20], digits[20:])) + "}"


def _description(law: Law, name: str) -> str:
    rows, outputs = [], []
    for index, (variable, kind, causality, unit, text) in enumerate(VARIABLES, start=1):
        start = ' start="0"' if causality == "input" else ""
        of_unit = f' unit="{unit}"' if unit else ""
        variability = "continuous" if kind == "Real" and causality == "input" else "discrete"
        rows.append(
            f'    <ScalarVariable name="{variable}" valueReference="{index - 1}" causality="{causality}" '
            f'variability="{variability}" description={quoteattr(text)}>\n'
            f"      <{kind}{of_unit}{start}/>\n    </ScalarVariable>"
        )
        if causality == "output":
            outputs.append(f'<Unknown index="{index}"/>')
    listed = "".join(outputs)
    units = "".join(f'<Unit name="{unit}"/>' for unit in sorted({row[3] for row in VARIABLES if row[3]}))
    variables = "\n".join(rows)
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="{name}" guid="{_guid(law)}" generationTool="fraclink"
  description="Control law of a flexible link, one step a period; law {law.digest}">
  <CoSimulation modelIdentifier="{name}" canHandleVariableCommunicationStepSize="false"
    needsExecutionTool="false" canBeInstantiatedOnlyOncePerProcess="false">
    <SourceFiles><File name="all.c"/></SourceFiles>
  </CoSimulation>
  <UnitDefinitions>{units}</UnitDefinitions>
  <DefaultExperiment startTime="0" stopTime="{500 * law.period!r}" stepSize="{law.period!r}"/>
  <ModelVariables>
{variables}
  </ModelVariables>
  <ModelStructure><Outputs>{listed}</Outputs><InitialUnknowns>{listed}</InitialUnknowns></ModelStructure>
</fmiModelDescription>
"""


def _library(sources: dict[str, str], compiler: str) -> bytes:
    found = shutil.which(compiler)
    if found is None:
        raise FieldError(
            "compiler",
            compiler,
            "not installed",
            allowed="a C compiler",
            remedy="install gcc, or binary=False",
        )
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for file, text in sources.items():
            (folder / file).write_text(text, encoding="utf-8")
        flags = ["-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared", "-fvisibility=hidden"]
        command = [found, *flags, "all.c", "-o", "law.so"]
        subprocess.run(command, cwd=folder, check=True, capture_output=True)  # noqa: S603
        return (folder / "law.so").read_bytes()
