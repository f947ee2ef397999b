"""TOML that people write: every fault found with its place and remedy, limits, and text
that reads back.
"""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import pytest

from fraclink._files.toml import (
    keys_of,
    parse_toml,
    read_table,
    read_toml,
    table_of,
    toml_text,
    toml_value,
)
from fraclink.errors import FieldError, FileFormatError
from fracsys.checks import Between

HERE = Path("rig.toml")


@dataclass(frozen=True)
class Motor:
    """An inner table."""

    inertia: Annotated[float, Between(0, 10, "kg·m²")]
    limit: Annotated[float, Between(0, math.inf, "V")] = math.inf
    quick: bool = False


@dataclass(frozen=True)
class Column:
    """A table with a unit."""

    column: str
    unit: str


@dataclass(frozen=True)
class Made:
    """The whole file."""

    name: str
    motor: Motor
    angle: Column | None = None
    loads: tuple[float, ...] = field(default_factory=tuple)

    def __post_init__(self) -> None:
        if self.name == "heavy" and self.motor.inertia < 1:
            raise FieldError(
                "motor.inertia",
                self.motor.inertia,
                "too light",
                allowed=">= 1",
                remedy="add mass",
            )


GOOD = {"name": "arm", "motor": {"inertia_kg_m2": 2.0}}


def test_a_table_becomes_the_object_and_comes_back() -> None:
    made = read_table(Made, GOOD)
    assert made == Made("arm", Motor(2.0))
    assert table_of(made) == GOOD | {
        "loads": ()
    }  # no limit and no switch at its default
    whole = Made(
        "arm", Motor(2.0, 24.0, quick=True), Column("enc", "deg"), (0.02, 0.04)
    )
    table = table_of(whole)
    assert table["motor"] == {"inertia_kg_m2": 2.0, "limit_V": 24.0, "quick": True}
    assert table["angle"] == {"column": "enc", "unit": "deg"}
    assert read_table(Made, tomllib.loads(toml_text(table))) == whole
    assert list(keys_of(Motor)) == ["inertia_kg_m2", "limit_V", "quick"]
    assert [key.required for key in keys_of(Made).values()] == [
        True,
        True,
        False,
        False,
    ]


def test_limits_are_asked_before_the_parser_is() -> None:
    line = "# " + "x" * 998
    assert parse_toml(f"{line}\na = 1", HERE) == {"a": 1}
    for text, problem, allowed in (
        (f"a = 1\n{line}x", "too long in line 2", "lines of 1000 characters"),
        ("#\n" * 32_001, "too large", "64000 bytes"),
        ("a = ", "not valid TOML", "a rig file"),
    ):
        with pytest.raises(FileFormatError) as caught:
            parse_toml(text, HERE)
        assert problem in caught.value.problem and allowed in caught.value.allowed
        assert (caught.value.field, caught.value.value) == ("rig", "rig.toml")
    assert parse_toml("#\n" * 32_000, HERE) == {}


def test_a_mark_and_line_ends_of_other_editors(tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_bytes(b"\xef\xbb\xbfa = 1\r\n[b]\r\nc = 'x'\r\n")
    assert read_toml(tmp_path / "rig.toml") == {"a": 1, "b": {"c": "x"}}
    (tmp_path / "large.toml").write_bytes(b"#" * 64_001)
    with pytest.raises(FileFormatError, match="more than 64000 bytes"):
        read_toml(tmp_path / "large.toml")


@pytest.mark.slow
def test_values_read_back_whatever_they_hold() -> None:
    texts = ['a "b" \\ c', "tab\t line\n return\r", "\x1b[31m \u2028 \U000e0001", "°µ"]
    values = {
        "t": texts[0],
        "flag": False,
        "n": 3,
        "x": 0.1,
        "list": [1, 0.5, True],
        "words": texts,
    }
    table = {"top": 1, "a": {"b": {"c": 2}}, "odd name.": {"k": values}}
    text = toml_text(table)
    assert tomllib.loads(text) == {
        "top": 1,
        "a": {"b": {"c": 2}},
        "odd name.": {"k": values},
    }
    # A table of tables needs no header of its own; sentences stand one to a line.
    assert "[a.b]" in text.splitlines() and "[a]" not in text.splitlines()
    assert toml_value(["one", "two"]) == '[\n  "one",\n  "two",\n]'
    assert toml_value([1, 2]) == "[1, 2]"
    assert all(character.isprintable() for character in toml_value("".join(texts)))
