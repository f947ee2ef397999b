"""Golden figures: the results recorded before the refactoring are still obtained, entry
by entry.

A difference is either an improvement, explained by its author, or a defect.
`tests/golden/record.py` records again.
"""

from __future__ import annotations

import difflib

import pytest

from golden.commands import COMMANDS, TEXTS, Desk  # type: ignore[attr-defined]
from golden.record import TOPICS, differences, entries, plain, probe, recorded

# These take more than two seconds each.
SLOW = {
    "run",
    "report",
    "design-geared",
}
ENTRIES = [
    pytest.param(
        topic,
        title,
        marks=pytest.mark.slow if title in SLOW else (),
        id=f"{topic}: {title}",
    )
    for topic in TOPICS
    for title in entries(topic)
]


@pytest.mark.slow
@pytest.mark.parametrize(("topic", "title"), ENTRIES)
def test_the_recorded_figures_come_out(topic: str, title: str) -> None:
    told = recorded(topic)
    # Digests are valid for the arithmetic they were made with, numbers everywhere.
    bits = told["probe"] == probe()
    found = plain(entries(topic)[title]())
    lines = differences(
        told["figures"][title],
        found,
        TOPICS[topic][1],
        bits=bits,
        place=f"{topic}/{title}",
    )
    assert not lines, f"{len(lines)} values differ:\n" + "\n".join(lines)


@pytest.mark.parametrize("topic", TOPICS)
def test_every_recorded_figure_is_made(topic: str) -> None:
    assert sorted(recorded(topic)["figures"]) == sorted(entries(topic))


def test_every_topic_was_recorded_on_one_arithmetic() -> None:
    """If topics were recorded on different machines, the digests of one of them could
    not be compared on any machine.
    """
    assert len({recorded(topic)["probe"] for topic in TOPICS}) == 1


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Desk:
    """The folder in which the commands run; each uses the results of the earlier ones."""
    return Desk(tmp_path_factory.mktemp("desk"))


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow if name in SLOW else ())
        for name in COMMANDS
    ],
)
def test_a_command_prints_what_it_printed(name: str, desk: Desk) -> None:
    told = (TEXTS / f"{name}.txt").read_text("utf-8")
    printed = desk.text(name)
    lines = difflib.unified_diff(
        told.splitlines(), printed.splitlines(), "recorded", "now", lineterm=""
    )
    assert printed == told, f"commands/{name}.txt:\n" + "\n".join(lines)


def test_every_text_is_of_a_command() -> None:
    assert sorted(path.stem for path in TEXTS.glob("*.txt")) == sorted(COMMANDS)
