"""A deprecated name warns where it is used, does what it did, and is gone in the
release that it names.
"""

from __future__ import annotations

import ast
import inspect
import warnings

import pytest

import fraclink
from fraclink.errors import deprecated, warn_deprecated
from guard_sources import sources


@deprecated(use="length", removed="9.0")
def measure(text: str, *, unit: float = 1.0) -> float:
    """Length of a text."""
    return unit * len(text)


@deprecated(use="unit", removed="9.0", scale="unit")
def measured(text: str, *, unit: float = 1.0) -> float:
    return unit * len(text)


def test_a_deprecated_function_warns_at_the_line_that_calls_it_and_still_works() -> (
    None
):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        line = inspect.currentframe().f_lineno + 1  # type: ignore[union-attr]
        assert measure("abc", unit=2.0) == 6.0
    (warning,) = caught
    assert warning.category is DeprecationWarning
    assert (warning.filename, warning.lineno) == (__file__, line)
    assert "measure" in str(warning.message)
    assert "9.0" in str(warning.message)
    assert "use length" in str(warning.message)


def test_a_deprecated_function_keeps_its_name_text_and_signature() -> None:
    assert (measure.__name__, measure.__doc__) == ("measure", "Length of a text.")
    assert list(inspect.signature(measure).parameters) == ["text", "unit"]


def test_a_renamed_argument_is_passed_on_under_its_new_name() -> None:
    with pytest.warns(DeprecationWarning, match=r"measured\(scale=…\).*use unit="):
        assert measured("abc", scale=3.0) == 9.0  # type: ignore[call-arg]


def test_the_new_argument_does_not_warn() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert measured("abc", unit=3.0) == 9.0


def test_both_names_of_one_argument_are_an_error() -> None:
    with pytest.raises(TypeError, match="both 'scale' and 'unit'"):
        measured("abc", scale=3.0, unit=3.0)  # type: ignore[call-arg]


def test_a_renamed_root_name_warns_and_is_the_new_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(fraclink._RENAMED, "Plan", ("Design", "9.0"))
    with pytest.warns(
        DeprecationWarning, match=r"fraclink\.Plan .* 9\.0: use fraclink\.Design"
    ) as caught:
        assert fraclink.Plan is fraclink.Design  # type: ignore[attr-defined]
    assert caught[0].filename == __file__
    assert "Plan" not in fraclink.__all__


def _release(text: str) -> tuple[int, ...]:
    return tuple(int(part) for part in text.split("."))


@pytest.mark.slow
def test_nothing_outlives_the_release_that_removes_it() -> None:
    now = _release(fraclink.__version__)
    promised = [release for _, release in fraclink._RENAMED.values()]
    for source in sources():
        if source.name == "errors":
            continue
        calls = (node for node in ast.walk(source.tree) if isinstance(node, ast.Call))
        promised += [
            keyword.value.value
            for call in calls
            if isinstance(call.func, ast.Name)
            and call.func.id in {deprecated.__name__, warn_deprecated.__name__}
            for keyword in call.keywords
            if keyword.arg == "removed" and isinstance(keyword.value, ast.Constant)
        ]
    assert [release for release in promised if _release(release) <= now] == []


@pytest.mark.slow
def test_the_depth_says_whose_line_is_named() -> None:
    def old(depth: dict[str, int]) -> int:
        warn_deprecated("Plan", use="Design", removed="0.3", **depth)
        return inspect.currentframe().f_lineno - 1  # type: ignore[union-attr]

    for depth, caller in (({}, True), ({"depth": 1}, True), ({"depth": 0}, False)):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            here = inspect.currentframe().f_lineno + 1  # type: ignore[union-attr]
            inside = old(depth)
        assert caught[0].lineno == (here if caller else inside)
