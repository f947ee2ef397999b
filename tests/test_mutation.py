"""The mutants of tools/mutants.py: which changes are made, and that nothing
else is touched.
"""

from __future__ import annotations

import builtins
import importlib.util
import sys
from collections import Counter
from pathlib import Path
from types import ModuleType

import pytest

SOURCE = '''"""Text - never 1 < 2."""
LIMIT = 4


def first(a: "float < 1", b: int = 2) -> float:
    """Not - this."""
    if a < LIMIT and b > 0:
        a -= 1
    if b == 5:
        raise ValueError(f"b + {b + 1}")
    return pair(a, b) / 2.0


def pair(a, b):
    assert a != 17
    return -a if not b else a * b
'''


@pytest.fixture(scope="module")
def mutation() -> ModuleType:
    path = Path(__file__).parents[1] / "tools" / "mutation.py"
    spec = importlib.util.spec_from_file_location("mutation", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def source(tmp_path: Path) -> Path:
    path = tmp_path / "sample.py"
    path.write_text(SOURCE, encoding="utf-8")
    return path


def test_every_operator_finds_its_places_and_text_is_left_alone(
    mutation: ModuleType, source: Path
) -> None:
    _, found = mutation.sites(source)
    assert Counter(site.kind for site in found) == {
        "comparison": 5,  # two each of < and >, one of ==
        "boolean": 4,  # and → or; both conditions that are no comparison; not b
        "constant": 12,  # 4, 2, 0, 1, 5 and 2.0, two each
        "arithmetic": 4,  # −=, /, −a, a·b
        "swapped": 1,
        "removed statement": 4,  # a −= 1, raise, both returns
    }
    assert {site.line for site in found} == {2, 5, 7, 8, 9, 10, 11, 16}


def test_each_mutant_is_one_change_that_runs(
    mutation: ModuleType, source: Path
) -> None:
    def outcome(code: object) -> object:
        names: dict[str, object] = {}
        exec(code, names)  # type: ignore[call-overload]  # noqa: S102
        called = names["first"]
        assert callable(called)
        results = []
        for arguments in ((3.0,), (3.0, 0), (4.0,), (9.0, 1), (2.0, 5), (5.0, 0)):
            try:
                results.append(called(*arguments))
            except (ValueError, TypeError, ZeroDivisionError) as error:
                results.append(type(error))
        return results

    plain = outcome(compile(SOURCE, "sample", "exec"))
    _, found = mutation.sites(source)
    differ = 0
    for k in range(len(found)):
        code, site, words = mutation.mutated(source, k)
        before, after = words.split("  ->  ")
        assert before != after, site
        differ += outcome(code) != plain
    assert (
        differ >= len(found) - 4
    )  # a < 4 → a <= 4 and the like need the one number that tells them apart


def test_an_instrumented_module_notes_the_blocks_it_runs(
    mutation: ModuleType, source: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code, count = mutation.instrumented(source, 3)
    notes = bytearray(count)
    monkeypatch.setattr(builtins, mutation.HITS, notes, raising=False)
    names: dict[str, object] = {}
    exec(code, names)  # noqa: S102
    assert not any(notes)
    called = names["first"]
    assert callable(called)
    assert called(9.0, 1) == 4.5
    _, found = mutation.sites(source, 3)
    ran = {
        site.line: bool(notes[site.block]) for site in found if site.block is not None
    }
    assert ran == {7: True, 8: False, 9: True, 10: False, 11: True, 16: True}
