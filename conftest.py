"""Tests that are known to fail since the rebuild: they run, and are reported as expected failures.

The list is tests/known_failures.txt, one beginning of a test's name a line. A test leaves it when it passes.
"""

from __future__ import annotations

from pathlib import Path

import pytest

LIST = Path(__file__).parent / "tests" / "known_failures.txt"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    lines = LIST.read_text("utf-8").splitlines()
    starts = tuple(line.strip() for line in lines if line.strip() and not line.startswith("#"))
    for item in items:
        if item.nodeid.startswith(starts):
            item.add_marker(pytest.mark.xfail(reason="open since the rebuild", strict=False))
