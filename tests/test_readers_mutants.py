"""Mutated files of every format: a clear error or a table, nothing else."""

from __future__ import annotations

from pathlib import Path

import pytest

from mutants import KINDS, run


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_mutants_are_read_or_refused(kind: str, tmp_path: Path) -> None:
    # A process for each binary one.
    count = {"text": 160, "rig": 160}.get(kind, 12)
    outcome = run(kind, count, tmp_path, seed=7)
    assert outcome.surprises == []
    assert sum(outcome.counts.values()) == count
    assert outcome.counts["refused"] + outcome.counts["child died"] > 0
    assert (
        outcome.slowest < 2
    )  # s of processor time here; the child has a limit of its own
