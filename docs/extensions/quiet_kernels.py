"""Silences the kernels that execute the pages, so that the output of `make docs` is
only about the pages.

Each kernel would warn of TCP without encryption, which is harmless on the loopback
interface of the build machine, and each page would be announced.
"""

from __future__ import annotations

import logging
import os
from pathlib import Path
from tempfile import TemporaryDirectory

from sphinx.application import Sphinx

ERRORS_ONLY = "c.IPKernelApp.log_level = 40\n"
# kept for the duration of the build
folder = TemporaryDirectory(prefix="docs-kernels-")


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    profile = Path(folder.name) / "profile_default"
    profile.mkdir()
    (profile / "ipython_kernel_config.py").write_text(ERRORS_ONLY, "utf-8")
    os.environ["IPYTHONDIR"] = folder.name
    logging.getLogger("traitlets").setLevel(logging.WARNING)
    return {"parallel_read_safe": True}
