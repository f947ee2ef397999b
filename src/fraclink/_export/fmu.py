"""Export the law as an FMU for co-simulation, FMI 2.0 or 3.0: its C sources, and libraries made of them."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

from fraclink._export import fmi2, fmi3
from fraclink._export.data import data_header
from fraclink._export.fmu_library import SUFFIXES, compiled, platform_of
from fraclink._export.fmu_model import FmuModel, token_of
from fraclink._export.fmu_page import documentation
from fraclink._export.names import identifier
from fraclink._export.sources import law_source
from fraclink._files import atomic_write, output_path
from fraclink._law import Law
from fraclink._law.block import Precision
from fraclink._validate import checked_noun, is_whole
from fraclink.errors import FieldError

__all__ = ["export_fmu"]


class _Standard(NamedTuple):
    sources: tuple[str, ...]  # of csrc/fmu, the first one is compiled
    platforms: Mapping[str, str]  # platform as FMI 3 names it: folder under binaries/
    descriptions: Callable[[FmuModel], dict[str, str]]


_STANDARDS: Mapping[int, _Standard] = {
    2: _Standard(fmi2.SOURCES, fmi2.PLATFORMS, fmi2.descriptions),
    3: _Standard(fmi3.SOURCES, fmi3.PLATFORMS, fmi3.descriptions),
}


def export_fmu(
    law: Law,
    path: Path | str,
    *,
    fmi: Literal[2, 3] = 2,
    precision: Precision | None = None,
    compilers: Sequence[str] = ("cc",),
    force: bool = False,
) -> Path:
    """Write the law as an FMU for co-simulation to `path`, ending in .fmu, and return it.

    Inputs: reference [rad], reference_acceleration [rad/s²], motor_angle [rad], torque [N·m],
    payload [kg] (0: not given). Outputs:
    motor_reference [rad], voltage [V], tip_estimate [rad], mode, reason, flags. One communication step is one
    period [s]; another step size is an error. The outputs of a step answer the inputs at its beginning, so
    the co-simulation adds the one period of delay that the design counts on. In every period they are, to
    the bit, those of `simulate`.

    Parameters
    ----------
    law
        From `discretize`; with the motor loop of a rig (`equip`) it closes the motor loop too.
    path
        The file; its stem is the model's name and must be a C identifier. An existing one needs `force`.
    fmi
        Version of the standard. 2.0 is what every importer reads, so it is the default; 3.0 has unsigned
        whole numbers, and names for more platforms.
    precision
        Arithmetic of the law, its own where it is left out; the FMU's variables are in double precision.
    compilers
        Each adds a library for the platform it compiles for: ``("cc", "x86_64-w64-mingw32-gcc")`` makes an
        FMU for Linux and Windows. Sources are always inside; without a compiler nothing else is.

    Raises
    ------
    FieldError
        a bad name or version, a compiler that is missing or fails, and a platform without a
        name in the version.

    Source: FMI 2.0.4 and FMI 3.0, chapters 2 and 4.

    >>> import fraclink as fl, tempfile
    >>> rig = fl.Rig.named("paper-2023")
    >>> law = fl.discretize(fl.Controller(gain=0.069876, order=0.612197, link=rig.model), rig.period, order=4)
    >>> export_fmu(law, Path(tempfile.mkdtemp()) / "arm_law.fmu", fmi=3, compilers=()).name
    'arm_law.fmu'
    """
    checked_noun("law", law, Law, remedy="fl.discretize(design) makes one")
    if not isinstance(compilers, list | tuple):
        allowed = "a list of names"
        raise FieldError("compilers", repr(compilers), "no list", allowed=allowed, remedy='say ("cc",)')
    place = output_path(path, force=force)
    if place.suffix != ".fmu":
        raise FieldError("out", place.name, "of another kind", allowed=".fmu", remedy="end the name in .fmu")
    name = identifier("out", place.stem)
    if not is_whole(fmi, 2, 3):
        raise FieldError("fmi", fmi, "not offered", allowed="2 or 3", remedy="2 is read by every importer")
    standard = _STANDARDS[fmi]
    shipped = law if precision is None else law.in_precision(precision)
    sources, token = _sources(shipped, name, standard.sources)
    model = FmuModel(name=name, token=token, period=shipped.period, digest=shipped.digest)
    parts = {f"sources/{file}": text.encode() for file, text in sources.items()}
    parts |= {file: text.encode() for file, text in standard.descriptions(model).items()}
    parts["documentation/index.html"] = documentation(model, shipped).encode()
    for compiler in compilers:
        platform = platform_of(compiler)
        folder = _folder(platform, standard.platforms, fmi)
        library = f"binaries/{folder}/{name}{SUFFIXES[platform.rpartition('-')[2]]}"
        if library in parts:
            raise FieldError(
                "compiler",
                compiler,
                f"the second one for {platform}",
                allowed="one for each platform",
                remedy="leave one of them out",
            )
        parts[library] = compiled(sources, compiler)
    with atomic_write(place, "wb") as out:
        out.write(_zipped(parts))
    return place


def _sources(law: Law, name: str, wrapper: tuple[str, ...]) -> tuple[dict[str, str], str]:
    """Return the FMU's C files and its token."""
    sources = {"law_data.h": data_header(law, name="law_data", title="")}
    for file in ("law.h", "law.c", "fmu/fmu_core.h", *(f"fmu/{file}" for file in wrapper)):
        sources[Path(file).name] = law_source(file).decode()
    token = token_of(sources)
    lines = [
        "/* The whole FMU as one file to compile: an importer needs no flags but the language's. */",
        *(["#define LAW_SINGLE"] if law.precision == "single" else []),
        # Two FMUs that are linked into one program each bring their law.
        *(
            f"#define {function} {name}_{function}"
            for function in ("law_check", "law_init", "law_step", "law_check_wiring")
        ),
        f'#define FMU_TOKEN "{token}"',
        f"#define FMU_PERIOD {law.period.hex()} /* {law.period!r} s */",
        '#include "law.c"',
        '#include "law_data.h"',
        f'#include "{wrapper[0]}"',
        "",
    ]
    return sources | {"all.c": "\n".join(lines)}, token


def _folder(platform: str, known: Mapping[str, str], fmi: int) -> str:
    if platform not in known:
        raise FieldError(
            "compiler",
            platform,
            f"a platform that FMI {fmi} has no name for",
            allowed=", ".join(known),
            remedy="take another version of FMI, or export sources only",
        )
    return known[platform]


def _zipped(parts: Mapping[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for file in sorted(parts):
            # a fixed date: the same law gives the same file
            about = zipfile.ZipInfo(file, (1980, 1, 1, 0, 0, 0))
            about.external_attr = 0o644 << 16
            archive.writestr(about, parts[file], zipfile.ZIP_DEFLATED)
    return stream.getvalue()
