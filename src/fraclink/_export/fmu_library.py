"""Compile the sources of an FMU to a shared library, for the platform that the compiler compiles for."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path

from fraclink._validate import checked_noun
from fraclink.errors import FieldError

__all__ = ["SUFFIXES", "compiled", "found", "platform_of"]

SUFFIXES: Mapping[str, str] = {"linux": ".so", "windows": ".dll", "darwin": ".dylib"}

# -ffp-contract=off: a fused multiply-add rounds once where the simulation rounds twice
_FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared", "-fvisibility=hidden")


def found(compiler: str) -> str:
    """Return the path of a compiler, or raise FieldError where it is not installed."""
    path = shutil.which(checked_noun("compiler", compiler, str, remedy="a name on the PATH, such as cc"))
    if path is None:
        raise FieldError(
            "compiler",
            compiler,
            "not installed",
            allowed="gcc, clang or a cross compiler of theirs",
            remedy="install it, or export sources only",
        )
    return path


def platform_of(compiler: str) -> str:
    """Return what a compiler compiles for, as FMI 3 names it: "x86_64-linux", "aarch64-darwin" ..."""
    answer = subprocess.run(  # noqa: S603
        [found(compiler), "-dumpmachine"], capture_output=True, text=True, check=False
    )
    triple = answer.stdout.strip().lower()
    architecture = triple.partition("-")[0].replace("arm64", "aarch64")
    systems = {"mingw": "windows", "linux": "linux", "darwin": "darwin"}
    system = next((name for word, name in systems.items() if word in triple), "unknown")
    return f"{architecture}-{system}"


def compiled(sources: Mapping[str, str], compiler: str) -> bytes:
    """Return the shared library of all.c; FieldError with the compiler's first complaint where it fails."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for name, text in sources.items():
            (folder / name).write_text(text, encoding="utf-8")
        library = folder / "law.library"  # with a suffix of its own: compilers for Windows add one else
        command = [found(compiler), *_FLAGS, "all.c", "-o", library.name]
        answer = subprocess.run(  # noqa: S603
            command, cwd=folder, capture_output=True, text=True, errors="replace", check=False
        )
        if answer.returncode:
            complaints = [line for line in answer.stderr.splitlines() if "error" in line] or ["no message"]
            raise FieldError(
                "compiler",
                compiler,
                f"unable to compile the FMU ({complaints[0]})",
                allowed="a C99 compiler with its standard library",
                remedy="install another one, or export sources only",
            )
        return library.read_bytes()
