"""Golden figures: what was recorded before the rebuilding still comes out, entry by entry.

A difference is an improvement that its author names, or a defect. `tests/golden/record.py` records again.
"""

from __future__ import annotations

import difflib

import pytest

from golden.commands import COMMANDS, TEXTS, answers  # type: ignore[attr-defined]
from golden.record import TOPICS, differences, probe, recorded

SLOW = {"designs", "exports"}


@pytest.mark.parametrize(
    "topic", [pytest.param(name, marks=pytest.mark.slow if name in SLOW else ()) for name in TOPICS]
)
def test_the_recorded_figures_come_out(topic: str) -> None:
    figures, rel = TOPICS[topic]
    told = recorded(topic)
    # Digests hold for the arithmetic they were made with; numbers hold everywhere.
    found = differences(told["figures"], figures(), rel, bits=told["probe"] == probe(), place=topic)
    assert not found, f"{len(found)} entries differ:\n" + "\n".join(found)


@pytest.fixture(scope="module")
def printed() -> dict[str, str]:
    """The texts of all commands, run once: each works on what those before it wrote."""
    return dict(answers())


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_prints_what_it_printed(name: str, printed: dict[str, str]) -> None:
    told = (TEXTS / f"{name}.txt").read_text("utf-8")
    lines = difflib.unified_diff(
        told.splitlines(), printed[name].splitlines(), "recorded", "now", lineterm=""
    )
    assert printed[name] == told, f"commands/{name}.txt:\n" + "\n".join(lines)


def test_every_text_is_of_a_command() -> None:
    assert sorted(path.stem for path in TEXTS.glob("*.txt")) == sorted(COMMANDS)


def test_a_difference_is_named() -> None:
    told = {"run": {"gain": 1.0, "zero": 0.0, "codes": ["W101"], "sha256": {"tip": "ab"}, "lost": 1}}
    found = {"run": {"gain": 1.0 + 1e-6, "zero": 1e-14, "codes": ["W102"], "sha256": {"tip": "cd"}, "new": 1}}
    assert differences(told, found, 1e-9, bits=True, place="runs") == [
        "runs/run/lost: gone",
        "runs/run/new: new",
        "runs/run/gain: 1.0 became 1.000001",
        "runs/run/codes[0]: 'W101' became 'W102'",
        "runs/run/sha256/tip: 'ab' became 'cd'",
    ]
    assert len(differences(told, found, 1e-3, bits=False, place="runs")) == 3
