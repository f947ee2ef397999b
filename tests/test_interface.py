"""Defaults and ranges of the interface are those recorded: what is not wanted does not
move unseen.
"""

from __future__ import annotations

import json

from golden.interface import RECORD, interface  # type: ignore[attr-defined]


def test_no_default_and_no_range_moves_unseen() -> None:
    """New names may come without a record; `python -m tests.golden.interface` takes
    them in.
    """
    told, found = json.loads(RECORD.read_text(encoding="utf-8")), interface()
    moved = [
        f"{place}, {name}: {what}: {before} became {found[place].get(name, {}).get(what, 'gone')}"
        for place, names in told.items()
        for name, entries in names.items()
        for what, before in entries.items()
        if found[place].get(name, {}).get(what) != before
    ]
    assert not moved, "\n".join(moved)


def test_the_record_holds_what_the_paper_and_the_boards_rely_on() -> None:
    functions = interface()["functions and classes"]
    assert functions["prbs"]["register"] == "7; 3, 4, 5, 6, 7, 9, 10 or 11"
    assert functions["design"]["margins"].startswith("'loop'")
    assert functions["Rig"]["period"] == "required; > 0 and <= 10 s"
