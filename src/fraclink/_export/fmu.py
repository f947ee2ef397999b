"""Export the law as an FMU for co-simulation, FMI 3.0: sources, and libraries made of
them.
"""

from __future__ import annotations

import io
import os
import shutil
import subprocess
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from fraclink._export.data import data_header, identifier, law_source
from fraclink._export.fmi import PLATFORMS, descriptions, token_of
from fraclink._files import atomic_write, output_path
from fraclink._law import Law
from fraclink._law.block import Precision
from fraclink.errors import FieldError
from fracsys.checks import checked, checked_noun

__all__ = [
    "compiled",
    "export_fmu",
    "found",
    "platform_of",
]


@checked
def export_fmu(
    law: Law,
    path: Path | str,
    *,
    precision: Precision | None = None,
    compilers: Sequence[str] = ("cc",),
    force: bool = False,
) -> Path:
    """Write the law as an FMU for co-simulation to `path`, ending in .fmu, and return
    it.

    Inputs: reference [rad], reference_acceleration [rad/s²], motor_angle [rad], torque
    [N·m], payload [kg] (0: not given). Outputs: motor_reference [rad], voltage [V],
    tip_estimate [rad], mode, reason, flags. One communication step is one period [s];
    another step size is an error. The outputs of a step answer the inputs at its
    beginning, so the co-simulation adds the one period of delay that the design counts
    on. In every period they equal those of `simulate` bit for bit.

    Parameters
    ----------
    law
        From `discretize`; with the motor loop of a rig (`equip`) it closes the motor
        loop too.
    path
        The file; its stem is the model's name and must be a C identifier. An existing
        one needs `force`.
    precision
        Arithmetic of the law, by default its own; the FMU's variables are in double
        precision.
    compilers
        Each adds a library for the platform it compiles for: ``("cc",
        "x86_64-w64-mingw32-gcc")`` makes an FMU for Linux and Windows. The sources are
        always included; without a compiler nothing else is.

    Raises
    ------
    FieldError
        a bad name, an existing file without `force`, a compiler that is missing or
        fails, a platform that FMI has no name for or that two compilers build for.

    Source: FMI 3.0, chapters 2 and 4.

    >>> import fraclink as fl, tempfile
    >>> rig = fl.Rig.named("paper-2023")
    >>> controller = fl.Controller(derivative_gain=0.069876, derivative_order=0.612197, link=rig.model)
    >>> law = fl.discretize(controller, rig.period, order=4)
    >>> export_fmu(law, Path(tempfile.mkdtemp()) / "arm_law.fmu", compilers=()).name
    'arm_law.fmu'
    """
    place = output_path(path, force=force)
    if place.suffix != ".fmu":
        raise FieldError(
            "out",
            place.name,
            "of another kind",
            ".fmu",
            "end the name in .fmu",
        )
    name = identifier(place.stem)
    shipped = law if precision is None else law.in_precision(precision)
    # The token is a hash of the C sources: if a library is combined with the
    # description of another law, the FMU itself refuses to start.
    sources, token = _sources(shipped, name)
    parts = {f"sources/{file}": text.encode() for file, text in sources.items()}
    described = descriptions(shipped, name, token)
    parts |= {file: text.encode() for file, text in described.items()}
    for compiler in compilers:
        platform = platform_of(compiler)
        if platform not in PLATFORMS:
            raise FieldError(
                "compiler",
                platform,
                "a platform that FMI has no name for",
                ", ".join(PLATFORMS),
                "export sources only",
            )
        library = f"binaries/{platform}/{name}{PLATFORMS[platform]}"
        if library in parts:
            raise FieldError(
                "compiler",
                compiler,
                f"the second one for {platform}",
                "one for each platform",
                "leave one of them out",
            )
        parts[library] = compiled(sources, compiler)
    with atomic_write(place, "wb") as out:
        out.write(_zipped(parts))
    return place


def _sources(law: Law, name: str) -> tuple[dict[str, str], str]:
    """Return the FMU's C files and its token."""
    sources = {"law_data.h": data_header(law)}
    for file in (
        "law.h",
        "law.c",
        "fmu/fmu_core.h",
        "fmu/fmi3.c",
        "fmu/fmi3_not_offered.h",
    ):
        sources[Path(file).name] = law_source(file).decode()
    token = token_of(sources)
    lines = [
        "/* The whole FMU as one file to compile: an importer needs no flags but the language's. */",
        *(["#define LAW_SINGLE"] if law.single else []),
        # Two FMUs may be linked into one program, each with its own law.
        *(
            f"#define {function} {name}_{function}"
            for function in ("law_check", "law_init", "law_step", "law_check_wiring")
        ),
        f'#define FMU_TOKEN "{token}"',
        # Hexadecimal, because the step is compared with it: another parser might read
        # 0.004 as a neighbouring double.
        f"#define FMU_PERIOD {law.period.hex()} /* {law.period!r} s */",
        '#include "law.c"',
        '#include "law_data.h"',
        '#include "fmi3.c"',
        "",
    ]
    return sources | {"all.c": "\n".join(lines)}, token


def _zipped(parts: Mapping[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        # Sorted, and each compressed separately: the bytes depend neither on the order
        # of a dict nor on the time.
        for file in sorted(parts):
            # a fixed date: the same law gives the same file
            about = zipfile.ZipInfo(file, (1980, 1, 1, 0, 0, 0))
            # Without permissions unzip would create unreadable files.
            about.external_attr = 0o644 << 16
            archive.writestr(about, parts[file], zipfile.ZIP_DEFLATED)
    return stream.getvalue()


# -ffp-contract=off: a fused multiply-add rounds once, the simulation twice
_FLAGS = (
    "-std=c99",
    "-O2",
    "-ffp-contract=off",
    "-fPIC",
    "-shared",
    "-fvisibility=hidden",
)


def found(compiler: str) -> str:
    """Return the path of a compiler; FieldError if it is not installed."""
    path = shutil.which(
        checked_noun("compiler", compiler, str, remedy="a name on the PATH, such as cc")
    )
    if path is None:
        raise FieldError(
            "compiler",
            compiler,
            "not installed",
            "gcc, clang or a cross compiler of theirs",
            "install it, or export sources only",
        )
    return path


def complaint(command: Sequence[str], folder: Path) -> str:
    """Run a compiler in `folder`; return its first error, or "" if there is none."""
    # Show the line with the error, since those before it only name the function; in
    # English, so that the word "error" can be found.
    answer = subprocess.run(  # noqa: S603
        command,
        cwd=folder,
        env=os.environ | {"LC_ALL": "C"},
        capture_output=True,
        text=True,
        errors="replace",
        check=False,
    )
    if not answer.returncode:
        return ""
    return next(
        (line for line in answer.stderr.splitlines() if "error" in line), "no message"
    )


def platform_of(compiler: str) -> str:
    """Return the target of a compiler in the notation of FMI 3: "x86_64-linux",
    "aarch64-darwin" ...
    """
    answer = subprocess.run(  # noqa: S603
        [found(compiler), "-dumpmachine"], capture_output=True, text=True, check=False
    )
    triple = answer.stdout.strip().lower()
    # Apple's name for aarch64 is arm64; FMI 3 uses aarch64.
    architecture = triple.partition("-")[0].replace("arm64", "aarch64")
    systems = {"mingw": "windows", "linux": "linux", "darwin": "darwin"}
    system = next((name for word, name in systems.items() if word in triple), "unknown")
    return f"{architecture}-{system}"


def compiled(sources: Mapping[str, str], compiler: str) -> bytes:
    """Return the shared library of all.c; FieldError with the first error of the
    compiler if it fails.
    """
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for name, text in sources.items():
            (folder / name).write_text(text, encoding="utf-8")
        # with an explicit suffix: compilers for Windows would add their own
        library = folder / "law.library"
        command = [found(compiler), *_FLAGS, "all.c", "-o", library.name]
        if message := complaint(command, folder):
            raise FieldError(
                "compiler",
                compiler,
                f"unable to compile the FMU ({message})",
                "a C99 compiler with its standard library",
                "install another one, or export sources only",
            )
        return library.read_bytes()
