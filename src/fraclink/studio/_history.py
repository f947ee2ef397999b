"""Undo that survives a crash: one line of JSON for every released state, next to the
study.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fraclink.errors import FieldError
from fraclink.studio._protocol import LONGEST

__all__ = ["History"]

_NAME = "studio.jsonl"


@dataclass
class History:
    """The states of a study in order, and the index of the current one.

    >>> import tempfile
    >>> history = History.of(Path(tempfile.mkdtemp()))
    >>> for margin in (45.0, 50.0, 55.0):
    ...     history.add({"phase_margin_deg": margin})
    >>> history.go(0), History.of(history.path.parent).state
    ({'phase_margin_deg': 45.0}, {'phase_margin_deg': 45.0})
    >>> history.add({"phase_margin_deg": 60.0})
    >>> [state["phase_margin_deg"] for state in history.states]
    [45.0, 60.0]
    """

    path: Path
    states: list[dict[str, Any]]
    at: int = -1

    @staticmethod
    def of(folder: Path) -> History:
        """Return the history in `folder`; it ends at the first invalid line, such as an
        incomplete one.
        """
        history = History(folder / _NAME, [])
        if not history.path.is_file():
            return history
        with history.path.open("rb") as lines:
            for line in lines:
                entry = _entry(line)
                if entry is None:
                    break
                history._apply(entry)
        return history

    @property
    def state(self) -> dict[str, Any] | None:
        """The current state, None before the first."""
        return self.states[self.at] if self.states else None

    def add(self, state: Mapping[str, Any]) -> None:
        """Append `state` after the current one; undone states are discarded."""
        if self.states and dict(state) == self.state:
            return
        self._write({"at": self.at + 1, "state": dict(state)})

    def go(self, at: int) -> dict[str, Any]:
        """Make the state number `at` the current one, and return it."""
        if not 0 <= at < len(self.states):
            raise FieldError(
                "at",
                at,
                "out of range",
                f"0 to {len(self.states) - 1}",
                "undo ends at the first state",
            )
        if at != self.at:
            self._write({"at": at})
        return self.states[at]

    def _write(self, entry: dict[str, Any]) -> None:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        # Appended and closed at once: an interruption only loses the line being
        # written.
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(entry, allow_nan=False) + "\n")
        self._apply(entry)

    # The same method for reading and writing: a history read back equals the one that
    # was written.
    def _apply(self, entry: Mapping[str, Any]) -> None:
        # A file edited by hand may refer to a state far beyond the last: it becomes the
        # next one.
        at = min(int(entry["at"]), len(self.states))
        if "state" in entry:
            self.states = [*self.states[:at], dict(entry["state"])]
        self.at = min(at, len(self.states) - 1)


def _entry(line: bytes) -> dict[str, Any] | None:
    """The entry of a line; None if it is not valid."""
    # Longer lines are rejected, as requests of a page are: a file may be one endless
    # line.
    if len(line) > LONGEST:
        return None
    try:
        entry = json.loads(line)
    except ValueError:
        return None
    valid = (
        isinstance(entry, dict)
        and type(entry.get("at")) is int
        and entry["at"] >= 0
        and isinstance(entry.get("state", {}), dict)
    )
    return entry if valid else None
