"""Where the C files for users are: beside the installed kernels, or in csrc/ of a checkout."""

from __future__ import annotations

from pathlib import Path

from fraclink import _kernels
from fraclink.errors import FieldError

__all__ = ["law_source"]


def law_source(name: str) -> bytes:
    """Return the bytes of "law.h", "law.c" or "arm_io.h" as this package was built from.

    >>> law_source("law.h").startswith(b"/* The control law")
    True
    """
    here = Path(__file__).resolve()
    for folder in (here.parents[3] / "csrc", Path(_kernels.__file__).parent / "csrc"):
        if (folder / name).is_file():
            return (folder / name).read_bytes()
    raise FieldError(
        name, "missing", "not in this installation", allowed="a complete package", remedy="reinstall"
    )
