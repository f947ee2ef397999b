"""The kernels that run the pages say nothing of their own: what `make docs` prints is
about the pages.

Each kernel would warn that it talks over TCP without encryption, which on the loopback
of the machine that builds is as it should be, and each page would be announced.
"""

from __future__ import annotations

import logging
import os
from pathlib import Path
from tempfile import TemporaryDirectory

from sphinx.application import Sphinx

ERRORS_ONLY = "c.IPKernelApp.log_level = 40\n"
folder = TemporaryDirectory(prefix="docs-kernels-")  # lives as long as the build


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    profile = Path(folder.name) / "profile_default"
    profile.mkdir()
    (profile / "ipython_kernel_config.py").write_text(ERRORS_ONLY, "utf-8")
    os.environ["IPYTHONDIR"] = folder.name
    logging.getLogger("traitlets").setLevel(logging.WARNING)
    return {"parallel_read_safe": True}
