"""Mutated files of every format: each gives a clear error or a table, nothing else."""

from __future__ import annotations

from pathlib import Path

import pytest

from mutants import KINDS, run


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_mutants_are_read_or_refused(kind: str, tmp_path: Path) -> None:
    # Each binary file needs a process.
    count = {"text": 160, "rig": 160}.get(kind, 6)
    outcome = run(kind, count, tmp_path, seed=7)
    assert outcome.surprises == []
    assert sum(outcome.counts.values()) == count
    assert outcome.counts["refused"] + outcome.counts["child died"] > 0
    # s of processor time here; the child process has its own limit
    assert outcome.slowest < 2
