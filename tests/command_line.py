"""The command line in a folder of its own, with listeners in the place of the functions
it calls.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import pytest

import fraclink as fl
from fraclink._cli import main
from fraclink._design.completed import design_for
from fraclink._reading.reading import bundled_log

RIG = fl.Rig.named("paper-2023")


class Calls(list[tuple[tuple[Any, ...], dict[str, Any]]]):
    """The calls of a function that does nothing else than keep them."""

    @property
    def last(self) -> dict[str, Any]:
        """The options of the last call."""
        return self[-1][1]

    @property
    def given(self) -> tuple[Any, ...]:
        """The arguments of the last call."""
        return self[-1][0]


@dataclass
class Found:
    """A result that passes, and notes where it was saved."""

    passed: bool = True
    saved: list[Any] = field(default_factory=list)

    def save(self, place: Any, **_: object) -> tuple[Path, ...]:
        self.saved.append(place)
        return (Path(place),)


class Told(NamedTuple):
    """Exit code and both streams."""

    code: int
    out: str
    err: str


@dataclass
class Line:
    """The command line in a folder of its own."""

    patch: pytest.MonkeyPatch
    capsys: pytest.CaptureFixture[str]

    def __call__(self, line: str, *more: str) -> Told:
        code = main([*line.split(), *more])
        return Told(code, *self.capsys.readouterr())

    def hear(self, place: str, found: Any = None) -> Calls:
        """Put a listener in the place of a function of the command line's modules."""
        calls = Calls()

        def heard(*given: Any, **named: Any) -> Any:
            calls.append((given, named))
            return found

        self.patch.setattr(f"fraclink._cli.{place}", heard)
        return calls


_MADE: list[fl.Design] = []


def made_design() -> fl.Design:
    """A design for the paper's rig, made once."""
    if not _MADE:
        _MADE.append(design_for(RIG, filter_time=0.0)[0])
    return _MADE[0]


def prepared(
    patch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], place: Path
) -> Line:
    """The command line in `place`, which holds a design and a log under two names."""
    patch.chdir(place)
    made_design().save("design.json")
    for name in ("log.csv", "table.csv"):
        Path(name).write_bytes(bundled_log("prbs_30g").read_bytes())
    (place / "results").mkdir()
    patch.setattr("fraclink._cli.command.view", lambda result: "")
    patch.setattr("fraclink._cli.command.to_json", lambda result: {})
    return Line(patch, capsys)
