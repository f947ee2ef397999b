"""Tools that some tests use: if they are missing, the tests are skipped on a user's
machine and fail under FRACLINK_CI.
"""

from __future__ import annotations

import os
import shutil
from typing import NoReturn

import pytest

CI = os.environ.get("FRACLINK_CI") == "1"


def missing(message: str) -> NoReturn:
    """Skip with `message`, or fail where nothing may be skipped."""
    if CI:
        pytest.fail(f"{message} (FRACLINK_CI=1: nothing may be skipped)")
    pytest.skip(message)


def tool(name: str, package: str | None = None) -> str:
    """Return the path of a program, or skip and name the Debian package that contains
    it.
    """
    path = shutil.which(name)
    if path is None:
        missing(f"{name} is not installed (Debian package {package or name})")
    return path


def chromium() -> str:
    """Return the path of Chromium: preferably its headless shell, which needs half the
    memory.
    """
    shell = "chromium-headless-shell"
    return shutil.which(shell) or shutil.which("chromium") or tool(shell)
