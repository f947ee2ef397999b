"""Where tests find the recorded data next to the repository."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

_DEFAULT = Path(__file__).resolve().parents[2] / "shared" / "data"


def shared_data(*parts: str) -> Path:
    """Path of a recorded data file; skips the test with a message where the folder is
    missing.
    """
    folder = Path(os.environ.get("FRACLINK_SHARED", str(_DEFAULT)))
    path = folder.joinpath(*parts)
    if not path.exists():
        pytest.skip(
            f"recorded data not there: {path}; set FRACLINK_SHARED to the folder that holds them"
        )
    return path
