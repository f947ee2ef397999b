"""Checks by annotation: what each kind of annotation admits, how it is normalised, and
how it is refused.
"""

from __future__ import annotations

import dataclasses
import gc
import math
import pickle
import typing
import weakref
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Protocol

import numpy as np
import pytest
from numpy.typing import NDArray

from fraclink._files.codec import Storage, codec_of
from fraclink.errors import FieldError, LogError
from fracsys.checks import (
    Angle,
    Array,
    Between,
    Count,
    FilePath,
    Length,
    Ordered,
    Payload,
    Period,
    PhaseMargin,
    Seed,
    Series,
    SeriesLike,
    Where,
    checked,
    checked_between,
    checked_choice,
    checked_noun,
    checked_number,
    checked_series,
    checked_whole,
    describe,
    is_whole,
    rules,
)
from fracsys.checks.equality import compared
from fracsys.checks.rules import rule

if TYPE_CHECKING:
    pass  # a name that does not exist when this file runs


def refusal(annotation: Any, value: object) -> FieldError:
    with pytest.raises(FieldError) as caught:
        rule(annotation).check("x", value)
    assert "\n" not in str(caught.value)
    return caught.value


class Log:
    """Something a user gets from a function."""

    __made_by__ = "read_log(path)"


class Shape(Protocol):
    def area(self) -> float: ...


# --- numbers --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "value", [2, 2.0, np.float32(2), np.int64(2), np.float64(2), np.uint8(2)]
)
def test_a_number_becomes_a_plain_float(value: object) -> None:
    plain = rule(float).check("x", value)
    assert type(plain) is float and plain == 2.0


@pytest.mark.parametrize(
    "value", [True, np.True_, "2", None, 2j, [2.0], np.array(2.0), object()]
)
def test_what_is_no_number_is_refused(value: object) -> None:
    assert refusal(float, value).problem == "not a number"
    assert refusal(Payload, value).problem == "not a number"


@pytest.mark.parametrize(
    "value", [math.nan, math.inf, -math.inf, np.float32("nan"), 10**400, -(10**400)]
)
def test_a_number_is_finite(value: object) -> None:
    assert refusal(float, value).problem == "not finite"
    assert refusal(Payload, value).field == "x"


def test_bounds_are_included_unless_open() -> None:
    closed = Annotated[float, Between(-1.0, 1.0)]
    assert [rule(closed).check("x", value) for value in (-1.0, 1.0)] == [-1.0, 1.0]
    half = Annotated[float, Between(-1.0, 1.0, low_open=True)]
    assert rule(half).check("x", 1.0) == 1.0
    assert refusal(half, -1.0).problem == "out of range"
    assert (
        refusal(Annotated[float, Between(-1.0, 1.0, high_open=True)], 1.0).problem
        == "out of range"
    )
    assert refusal(closed, math.nextafter(1.0, 2.0)).allowed == "-1 to 1"


def test_infinity_is_admitted_only_where_the_range_says_so() -> None:
    limit = Annotated[float, Between(0.0, low_open=True, finite=False)]
    assert rule(limit).check("x", math.inf) == math.inf
    refusal(limit, math.nan)
    refusal(limit, -math.inf)
    assert math.isnan(
        rule(Annotated[float, Between(finite=False)]).check("x", math.nan)
    )
    refusal(Annotated[float, Between(0.0)], math.inf)


@pytest.mark.parametrize("value", [3, np.int8(3), np.uint64(3)])
def test_a_whole_number_becomes_a_plain_int(value: object) -> None:
    plain = rule(Count).check("x", value)
    assert type(plain) is int and plain == 3


@pytest.mark.parametrize("value", [3.0, True, np.False_, "3", None, np.float64(3)])
def test_a_float_or_bool_is_no_whole_number(value: object) -> None:
    assert refusal(int, value).problem == "not a whole number"


def test_whole_numbers_compare_exactly_at_64_bits() -> None:
    assert rule(Seed).check("seed", 2**64 - 1) == 2**64 - 1
    refusal(Seed, 2**64)
    refusal(Seed, -1)
    refusal(Seed, 10**5000)  # longer than Python prints


def test_complex_numbers_are_finite() -> None:
    assert rule(complex).check("x", 1) == 1 + 0j
    assert type(rule(complex).check("x", np.complex64(1j))) is complex
    refusal(complex, complex(math.nan, 0.0))
    refusal(complex, 10**400)
    refusal(complex, "1j")


def test_a_bool_is_only_a_bool() -> None:
    assert rule(bool).check("x", np.True_) is True
    refusal(bool, 1)
    refusal(bool, "yes")


# --- words, paths, functions, instances -------------------------------------------------------------------


def test_literals_are_choices() -> None:
    hold = Literal["zero", "first"]
    assert rule(hold).check("hold", "first") == "first"
    error = refusal(hold, "second")
    assert (
        str(error)
        == "x: unknown (got second); expected zero or first. Choose one of these."
    )
    refusal(hold, ["zero"])
    refusal(hold, None)
    number = Literal[1, 2]
    assert type(rule(number).check("x", np.int64(2))) is int
    refusal(number, True)
    refusal(number, 1.0)


def test_paths_are_texts_that_name_something() -> None:
    for annotation in (Path, FilePath, str | Path):
        assert rule(annotation).check("x", "a/log.csv") == Path("a/log.csv")
        assert rule(annotation).check("x", Path("log.csv")) == Path("log.csv")
        for junk in ("", "a\0b", b"log.csv", None, 3):
            assert refusal(annotation, junk).allowed == "the name of a file or folder"


def test_a_text_beside_a_class_stays_a_text() -> None:
    assert rule(Log | str | Path).check("x", "log.csv") == "log.csv"


def test_functions_are_callable() -> None:
    assert rule(Callable[[float], float]).check("x", math.sin) is math.sin
    assert refusal(Callable[[float], float], 3.0).problem == "not a function"


def test_an_instance_says_where_to_get_one() -> None:
    log = Log()
    assert rule(Log).check("log", log) is log
    with pytest.raises(FieldError) as caught:
        rule(Log).check("log", "log.csv")
    assert (
        str(caught.value)
        == "log: not a Log (got 'log.csv'); expected a Log. Use read_log(path)."
    )
    assert refusal(FieldError, 3).remedy == "give a FieldError"
    assert refusal(Log, object()).value == "object"


def test_anything_and_protocols_are_left_to_the_type_checker() -> None:
    for annotation in (Any, object, Shape):
        assert rule(annotation).check("x", 3) == 3


def test_none_is_only_what_is_optional() -> None:
    assert rule(float | None).check("x", None) is None
    assert rule(float | None).check("x", 1) == 1.0
    assert refusal(float | None, "1").problem == "not a number"
    assert refusal(None, 1).problem == "not None"


def test_a_union_reports_the_member_whose_kind_fits() -> None:
    mixed = Payload | Literal["given"] | Log
    assert rule(mixed).check("x", "given") == "given"
    assert rule(mixed).check("x", 1) == 1.0
    assert refusal(mixed, -1.0).problem == "out of range"
    assert refusal(mixed, "taken").problem == "unknown"
    other = refusal(mixed, [1])
    assert other.problem == "of another type"
    assert other.allowed == "> 0 and <= 10000 kg, given or a Log"


def test_a_kind_that_is_tried_in_vain_keeps_no_caller_alive() -> None:
    """A refusal that lives on in a cycle holds every frame up to the caller's, and the
    arrays in it.
    """

    def caller() -> weakref.ref[NDArray[np.float64]]:
        samples = np.zeros(3)
        assert rule(int | str | None).convert("a text") == "a text"
        return weakref.ref(samples)

    gc.disable()
    try:
        assert caller()() is None
    finally:
        gc.enable()


def test_metadata_beside_a_union_narrows_each_member() -> None:
    optional = Annotated[float | None, Between(0.0, 1.0)]
    assert rule(optional).check("x", None) is None
    refusal(optional, 2.0)


# --- sequences, pairs, mappings -----------------------------------------------------------------------------


def test_a_pair_is_checked_entry_by_entry() -> None:
    pair = tuple[Payload, Payload]
    for value in ((1, 2), [1, 2], np.array([1.0, 2.0])):
        plain = rule(pair).check("payloads", value)
        assert plain == (1.0, 2.0) and all(type(entry) is float for entry in plain)
    assert refusal(pair, (1.0, -1.0)).field == "x[1]"
    for junk in ((1.0,), (1.0, 2.0, 3.0), "ab", 1.0, {1.0: 2.0, 2.0: 1.0}, None):
        assert refusal(pair, junk).problem == "not a pair"


def test_an_ordered_pair_ascends() -> None:
    pair = Annotated[tuple[Payload, Payload], Ordered()]
    assert rule(pair).check("x", (1.0, 1.0)) == (1.0, 1.0)
    error = refusal(pair, (2.0, 1.0))
    assert error.allowed == "(low, high) with low <= high, each > 0 and <= 10000 kg"
    refusal(Annotated[tuple[float, float], Ordered(strict=True)], (1.0, 1.0))


@pytest.mark.parametrize(
    "kind", [tuple[Payload, ...], Sequence[Payload], Iterable[Payload]]
)
def test_a_sequence_becomes_a_tuple(kind: Any) -> None:
    for value in ([1, 2], (1.0, 2), np.array([1.0, 2.0]), range(1, 3)):
        assert rule(kind).check("x", value) == (1.0, 2.0)
    assert refusal(kind, [1.0, "2"]).field == "x[1]"
    for junk in ("12", b"12", 1.0, None, {1.0: 2.0}, np.array(1.0)):
        assert refusal(kind, junk).problem == "not a list"


def test_a_list_stays_a_list_and_generators_are_read_once() -> None:
    assert rule(list[int]).check("x", (1, 2)) == [1, 2]
    assert rule(Iterable[int]).check("x", (n for n in (1, 2))) == (1, 2)


def test_lengths_are_bounded() -> None:
    few = Annotated[tuple[float, ...], Length(1, 3)]
    assert rule(few).check("x", [1]) == (1.0,)
    assert refusal(few, []).problem == "empty"
    assert refusal(few, [1, 2, 3, 4]).problem == "of another length"
    assert (
        refusal(Annotated[str, Length(1, 2)], "abc").allowed
        == "a text; 1 to 2 characters"
    )


def test_mappings_are_checked_value_by_value() -> None:
    table = Mapping[str, Payload]
    assert rule(table).check("x", {"a": 1}) == {"a": 1.0}
    assert refusal(table, {"a": 1.0, "b": 0.0}).field == "x['b']"
    assert refusal(table, [("a", 1.0)]).problem == "not a mapping"


def test_a_condition_of_its_own_has_words() -> None:
    name = Annotated[
        str, Where(str.isidentifier, "a Python identifier", remedy="use letters and _")
    ]
    assert rule(name).check("x", "tip") == "tip"
    error = refusal(name, "2nd")
    assert (error.allowed, error.remedy) == ("a Python identifier", "use letters and _")
    assert refusal(name, 3).problem == "not a text"


# --- arrays -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("annotation", [Series, SeriesLike])
def test_a_series_is_one_column_of_finite_floats(annotation: Any) -> None:
    plain = rule(annotation).check("x", [0, 1, 2])
    assert plain.dtype == np.float64 and plain.shape == (3,)
    assert refusal(annotation, [[1.0], [2.0]]).problem == "of another shape"
    for junk in (
        ["a"],
        [None],
        [[1.0], [1.0, 2.0]],
        None,
        "12",
        [True],
        [1j],
        object(),
    ):
        assert refusal(annotation, junk).problem == "not an array of numbers"
    error = refusal(annotation, [0.0, math.nan])
    assert (error.field, error.problem) == ("x", "not finite (entry 1)")
    assert rule(annotation).check("x", [1e308, 1e308]).tolist() == [
        1e308,
        1e308,
    ]  # only their sum is not


def test_arrays_keep_the_shape_and_kind_of_their_annotation() -> None:
    assert rule(NDArray[np.complex128]).check("x", [[1.0]]).dtype == np.complex128
    assert rule(NDArray[np.bool_]).check("x", [True]).dtype == np.bool_
    refusal(NDArray[np.int64], [1.5])
    table = Annotated[NDArray[np.float64], Array(2, finite=False)]
    assert math.isnan(rule(table).check("x", [[math.nan]])[0, 0])
    assert (
        refusal(Annotated[NDArray[np.float64], Array(1, min_size=2)], [1.0]).problem
        == "of another shape"
    )


def test_a_range_beside_an_array_is_for_every_entry() -> None:
    masses = Annotated[
        NDArray[np.float64], Array(2), Between(0.0, 1.0, "kg", low_open=True)
    ]
    assert (
        refusal(masses, [[0.5, 0.5], [0.5, 0.0]]).problem == "out of range (entry 1, 1)"
    )


def test_a_condition_is_a_signal_where_the_annotation_says_so() -> None:
    signal = Annotated[NDArray[np.float64], Array(1, flags=True)]
    assert rule(signal).check("u", np.arange(3) > 1).tolist() == [0.0, 0.0, 1.0]


def test_arguments_are_not_copied_and_fields_are_read_only_copies() -> None:
    values = np.arange(3.0)
    assert rule(Series).check("x", values) is values
    kept = rule(Series, own=True).check("x", values)
    values[0] = 9.0
    assert kept[0] == 0.0 and not kept.flags.writeable
    assert rule(Series, own=True).check("x", kept) is kept
    view = values.view()
    view.flags.writeable = False  # but its base can be written to
    assert rule(Series, own=True).check("x", view) is not view


# --- words for people ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("annotation", "words"),
    [
        (float, "a finite number"),
        (Period, "> 0 and <= 10 s"),
        (Angle, "-1e6 to 1e6 rad"),
        (PhaseMargin, "> 0 and < 3.14159 rad"),
        (Annotated[float, Between(0.0, unit="kg", low_open=True)], "> 0 kg"),
        (Annotated[float, Between(0.0, finite=False)], ">= 0 or infinite"),
        (Annotated[int, Between(0, 8, "samples")], "whole number 0 to 8 samples"),
        (Annotated[int, Between(1)], "whole number >= 1"),
        (int, "whole number"),
        (bool | None, "True or False"),
        (Literal["a", "b", "c"], "a, b or c"),
        (Series, "finite numbers of shape (N,)"),
        (tuple[Payload, ...], "a list, each entry > 0 and <= 10000 kg"),
        (tuple[float, str], "a pair: a finite number, a text"),
        (Log, "a Log"),
    ],
)
def test_a_range_reads_as_engineers_write_it(annotation: Any, words: str) -> None:
    assert describe(annotation) == words


@pytest.mark.parametrize(
    ("between", "words"),
    [
        (Between(-999_999, 999_999), "-999999 to 999999"),
        (Between(-(10**6), 10**6), "-1e6 to 1e6"),
        (Between(300_000.0, 1_500_000.0), "300000 to 1.5e6"),
        (Between(1e-12, 2.5e-7), "1e-12 to 2.5e-7"),
        (Between(0.1, 7.0, "s", low_open=True, high_open=True), "> 0.1 and < 7 s"),
        (Between(0.1, 7.0, high_open=True), ">= 0.1 and < 7"),
        (Between(high=7.0), "<= 7"),
        (Between(high=7.0, high_open=True, unit="V"), "< 7 V"),
        (Between(unit="V"), "a finite number V"),
        (Between(finite=False), "a number"),
        (Between(unit="V", finite=False), "a number V"),
        (Between(0.0, 1.0, "V", finite=False), "0 to 1 V or infinite"),
    ],
)
def test_figures_of_a_range(between: Between, words: str) -> None:
    assert between.expected == words


@pytest.mark.parametrize(
    ("array", "words"),
    [
        (Array(None), "finite numbers of any shape"),
        (Array(0, finite=False), "numbers of no axis"),
        (Array(2, min_size=3), "finite numbers of shape (N, M) with N >= 3"),
        (Array(3), "finite numbers of 3 axes"),
    ],
)
def test_shapes_in_words(array: Array, words: str) -> None:
    assert array.expected == words


@pytest.mark.parametrize(
    ("annotation", "words"),
    [
        (Annotated[int, Between(high=3)], "whole number"),
        (Annotated[int, Between(2, 2 * 10**6)], "whole number 2 to 2e6"),
        (
            Annotated[tuple[int, ...], Length(2)],
            "a list, each entry whole number; at least 2 entries",
        ),
        (
            Annotated[tuple[int, ...], Length(2, 4)],
            "a list, each entry whole number; 2 to 4 entries",
        ),
        (tuple[float, float, float], "3 values, each a finite number"),
        (tuple[Any, ...], "a list"),
        (Mapping[str, float], "a mapping, each value a finite number"),
        (complex, "a finite complex number"),
        (float | str, "a finite number or a text"),
        (Series | None, "finite numbers of shape (N,)"),
        (
            Annotated[Series, Between(0.0, 1.0)],
            "finite numbers of shape (N,), each 0 to 1",
        ),
        (FieldError, "a FieldError"),
        (Exception, "an Exception"),
    ],
)
def test_other_ranges_in_words(annotation: Any, words: str) -> None:
    assert describe(annotation) == words


def test_a_rule_carries_its_bounds_and_unit() -> None:
    narrowed: tuple[Any, ...] = (
        Payload,
        Payload | None,
        Annotated[float, Between(0.0, 1e4, "kg", low_open=True)],
    )
    for annotation in narrowed:
        found = rule(annotation)
        assert (found.unit, found.low, found.high) == ("kg", 0.0, 1e4)
    pair = Annotated[tuple[Payload, Payload], Ordered(strict=True)]
    several: tuple[Any, ...] = (
        pair,
        tuple[Payload, ...],
        Annotated[tuple[Payload, ...], Length(1, 3)],
    )
    for annotation in several:
        found = rule(annotation)
        assert (found.unit, found.low, found.high) == ("kg", 0.0, 1e4)
    assert rule(Count).low == 1 and rule(Count).high == 10**9
    assert rule(Mapping[str, Payload]).unit == "kg"
    assert rule(Annotated[Series, Between(0.0, 1.0, "V")]).unit == "V"
    assert rule(Series).unit == ""
    assert rule(Literal["a", "b"] | None).choices == ("a", "b")
    assert (rule(float).low, rule(float).high) == (-math.inf, math.inf)


def test_what_was_given_is_shown_in_one_line() -> None:
    assert refusal(float, [1, 2]).value == "[1, 2]"
    assert refusal(float, list(range(8))).value == "[0, 1, 2, 3, 4, 5, 6, 7]"
    assert refusal(float, list(range(9))).value == "list"
    assert refusal(float, {"a": 1}).value == "dict"
    assert refusal(float, None).value == "None"
    assert refusal(float, "x").value == "'x'"
    assert refusal(Series, np.zeros((2, 3))).value == "shape (2, 3)"
    assert refusal(Series, [0.0, math.inf]).value == math.inf
    masses = Annotated[NDArray[np.float64], Array(None), Between(0.0, 1.0)]
    error = refusal(masses, np.array(2.0))
    assert (error.value, error.problem) == (2.0, "out of range (entry the only one)")


def test_a_number_out_of_an_array_is_shown_as_it_was_written() -> None:
    bounded = Annotated[NDArray[np.float64], Array(1), Between(0.0, 2.0)]
    for entry in (math.nan, -2.5, 3.0):
        assert f"(got {entry!r})" in str(refusal(bounded, np.array([1.0, entry])))
    for scalar, words in (
        (np.float32(0.5), "0.5"),
        (np.True_, "True"),
        (np.int64(7), "7"),
        (np.str_("a"), "a"),
    ):
        error = FieldError("x", scalar, "wrong", allowed="another", remedy="")
        assert str(error) == f"x: wrong (got {words}); expected another."


def test_what_to_do_fits_the_kind() -> None:
    assert refusal(float, "x").remedy == "check the value and its unit"
    assert refusal(int, 1.5).remedy == "give a whole number"
    assert (
        refusal(Annotated[int, Between(1, 3, remedy="count again")], 9).remedy
        == "count again"
    )
    assert refusal(Series, "x").remedy == "give one column of numbers"
    assert refusal(NDArray[np.float64], "x").remedy == "give an array of numbers"
    assert refusal(tuple[float, float], 1.0).remedy == "give a pair"
    assert refusal(tuple[float, ...], 1.0).remedy == "put a single one in a list"
    assert refusal(Mapping[str, float], 1.0).remedy == "give a dict"
    assert (
        refusal(Annotated[tuple[float, ...], Length(1, 3)], []).remedy == "give 1 to 3"
    )
    assert (
        refusal(Annotated[tuple[float, ...], Length(2)], [1.0]).remedy
        == "give at least 2"
    )
    strict = Annotated[tuple[float, float], Ordered(strict=True)]
    assert refusal(strict, (2.0, 1.0)).remedy == "give the smaller one first"
    assert (
        refusal(strict, (2.0, 1.0)).allowed
        == "(low, high) with low < high, each a finite number"
    )
    assert rule(strict).check("x", (1.0, 2.0)) == (1.0, 2.0)
    assert (
        refusal(float | str, [1]).remedy == "check the value and its unit or give a str"
    )


# --- calls by name ------------------------------------------------------------------------------------------


def test_a_number_by_name_with_its_bounds() -> None:
    assert checked_between("x", 1, 1.0, 2.0) == 1.0
    assert checked_between("x", 2, 1.0, 2.0) == 2.0
    with pytest.raises(FieldError) as caught:
        checked_between("x", 1.0, 1.0, 2.0, "s", open_low=True, remedy="wait")
    assert (caught.value.field, caught.value.allowed, caught.value.remedy) == (
        "x",
        "> 1 and <= 2 s",
        "wait",
    )
    with pytest.raises(FieldError) as caught:
        checked_number(
            "x",
            3,
            allowed="an even number",
            holds=lambda n: n % 2 == 0,
            remedy="add one",
        )
    assert (caught.value.value, caught.value.allowed, caught.value.remedy) == (
        3.0,
        "an even number",
        "add one",
    )
    assert (
        checked_number("x", 4, allowed="an even number", holds=lambda n: n % 2 == 0)
        == 4.0
    )
    for junk, problem in (("4", "not a number"), (math.nan, "not finite")):
        with pytest.raises(FieldError) as caught:
            checked_number("x", junk, allowed="an even number", remedy="add one")
        assert (caught.value.problem, caught.value.allowed) == (
            problem,
            "an even number",
        )


def test_whole_numbers_and_choices_by_name() -> None:
    assert [checked_whole("n", k, 1, 3) for k in (1, np.int8(3))] == [1, 3]
    with pytest.raises(FieldError) as caught:
        checked_whole("n", 4, 1, 3, "samples")
    assert caught.value.allowed == "whole number 1 to 3 samples"
    assert [is_whole(k, 1, 3) for k in (0, 1, 3, 4, np.int64(2), True, 2.0, "2")] == [
        False, True, True, False, True, False, False, False,
    ]  # fmt: skip
    assert checked_choice("kind", "b", ["a", "b"]) == "b"
    for junk in ("c", 3, None):
        with pytest.raises(FieldError) as caught:
            checked_choice("kind", junk, iter(["a", "b", "c d"]), remedy="look")
        assert (caught.value.allowed, caught.value.problem) == (
            "a, b or c d",
            "unknown",
        )
        assert (caught.value.value, caught.value.remedy) == (junk, "look")


def test_nouns_and_series_by_name() -> None:
    log = Log()
    assert checked_noun("log", log, Log) is log
    for remedy, said in ((None, "use read_log(path)"), ("read it", "read it")):
        with pytest.raises(FieldError) as caught:
            checked_noun("log", 3, Log, remedy=remedy)
        assert (caught.value.field, caught.value.remedy) == ("log", said)
    mine = np.arange(3.0)
    found = checked_series("u", mine)
    mine[0] = 9.0
    assert found.tolist() == [0.0, 1.0, 2.0]
    assert math.isnan(checked_series("u", [math.nan, 1.0])[0])
    with pytest.raises(LogError) as caught:
        checked_series("u", [[1.0]], error=LogError, remedy="one column")
    assert (caught.value.field, caught.value.problem, caught.value.remedy) == (
        "u",
        "of another shape",
        "one column",
    )


@pytest.mark.skipif(
    not hasattr(typing, "TypeAliasType"), reason="type aliases began with Python 3.12"
)
def test_an_alias_is_what_it_stands_for() -> None:
    alias = typing.TypeAliasType  # type: ignore[attr-defined]  # since Python 3.12
    scalar: Any = typing.TypeVar("scalar", bound=np.generic)
    matrix = alias("matrix", np.ndarray[Any, np.dtype[scalar]], type_params=(scalar,))
    speed = alias("speed", Annotated[float, Between(0.0, unit="rad/s")])
    assert rule(matrix[np.complex128]).convert([1j]).dtype == np.complex128
    assert rule(Annotated[matrix[np.float64], Array(1)]).convert([1]).dtype == float
    refusal(Annotated[matrix[np.float64], Array(1)], [[1.0]])
    assert "rad/s" in str(refusal(alias("fast", speed), -1.0))
    assert codec_of(matrix[np.float64]).encode([1.0], "x", Storage()) == [1.0]


# --- results that are compared ------------------------------------------------------------------------------


@compared
@dataclass(frozen=True, eq=False)
class Result:
    """Something with samples."""

    samples: Any
    name: str = ""
    note: str = dataclasses.field(default="", compare=False)


def test_results_are_equal_where_all_their_fields_are() -> None:
    a = Result(np.arange(3.0), "a")
    assert a == Result(np.arange(3.0), "a", "another note")
    assert a != Result(np.arange(3.0), "b")
    assert a != Result(np.arange(3), "a")  # integers are another answer
    assert a != Result(np.arange(4.0), "a")
    assert (a == "a") is False
    assert Result(np.array([math.nan])) == Result(np.array([math.nan]))
    assert Result(math.nan) == Result(math.nan) and Result(1.0) != Result(math.nan)
    between = Between(float("nan"))
    assert Result(between) == Result(Between(float("nan"))) != Result(Between(1.0))
    assert Result(np.array(["x"])) == Result(np.array(["x"]))
    assert Result({"k": np.ones(2)}) == Result({"k": np.ones(2)})
    assert (
        Result({"k": np.ones(2)})
        != Result({"k": np.zeros(2)})
        != Result({"j": np.zeros(2)})
    )
    assert Result((np.ones(2), 1)) == Result((np.ones(2), 1))
    assert (
        Result((np.ones(2), 1)) != Result((np.ones(2), 1, 2)) != Result((np.ones(2), 1))
    )
    assert Result(()) != Result((1,))
    assert Result((np.ones(2), 1)) != Result((np.ones(2), 2))
    assert (
        hash(a)
        == hash(Result(np.arange(3.0), "a", "another note"))
        != hash(Result(np.arange(3.0), "b"))
    )


def test_a_range_beside_the_wrong_type_is_a_mistake_of_ours() -> None:
    with pytest.raises(TypeError, match="Between stands beside"):
        rule(Annotated[str, Between(0.0)])


# --- functions ----------------------------------------------------------------------------------------------


@checked
def move(
    amplitude: Angle,
    /,
    duration: Period = 1.0,
    *rest: Count,
    kind: Literal["step", "ramp"] = "step",
    **more: float,
) -> tuple[Any, ...]:
    """Return what it got."""
    return amplitude, duration, rest, kind, more


def test_arguments_are_normalised_by_position_and_by_name() -> None:
    assert move(1) == (1.0, 1.0, (), "step", {})
    assert move(1, 2, 3, np.int64(4), kind="ramp", a=1) == (
        1.0,
        2.0,
        (3, 4),
        "ramp",
        {"a": 1.0},
    )
    assert move(np.float32(1), duration=2)[:2] == (1.0, 2.0)


@pytest.mark.parametrize(
    ("arguments", "options", "field"),
    [
        (("1",), {}, "amplitude"),
        ((1.0, 11.0), {}, "duration"),
        ((1.0,), {"duration": 0.0}, "duration"),
        ((1.0, 1.0, 0), {}, ""),
        ((1.0,), {"kind": "sine"}, "kind"),
        ((1.0,), {"more": "x"}, "more"),
    ],
)
def test_a_refusal_names_the_argument(
    arguments: tuple[Any, ...], options: dict[str, Any], field: str
) -> None:
    with pytest.raises(FieldError) as caught:
        move(*arguments, **options)
    assert caught.value.field == field


def test_python_itself_refuses_wrong_calls() -> None:
    with pytest.raises(TypeError, match="amplitude"):
        move()  # type: ignore[call-arg]


def test_the_function_keeps_its_name_and_signature() -> None:
    assert move.__name__ == "move" and move.__doc__ == "Return what it got."
    assert pickle.loads(pickle.dumps(move)) is move  # noqa: S301


def test_the_class_of_the_error_and_the_place_can_be_stated() -> None:
    @checked(error=LogError, prefix="lead.")
    def compensate(high: Period) -> None: ...

    with pytest.raises(LogError, match=r"^lead\.high: out of range"):
        compensate(-1.0)


def test_an_error_inside_the_function_is_not_touched() -> None:
    @checked
    def fail(count: Count) -> None:
        raise ValueError("inside")

    with pytest.raises(ValueError, match=r"^inside$"):
        fail(1)


# --- dataclasses --------------------------------------------------------------------------------------------


@checked
@dataclass(frozen=True)
class Channel:
    """A column of a log."""

    __made_by__: ClassVar[str] = "Channel(...)"

    period: Period
    values: Series
    names: tuple[str, ...] = ()
    delay: float | None = None
    sides: dict[str, float] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.values.size * self.period > 100.0:  # fields are plain values by now
            raise FieldError(
                "values", self.values.size, "too long", allowed="100 s", remedy="cut it"
            )


def test_fields_are_normalised_at_construction() -> None:
    values = np.arange(3)
    channel = Channel(np.float32(0.5), values, names=["a"], delay=1)  # type: ignore[arg-type]
    assert (type(channel.period), channel.names, channel.delay) == (float, ("a",), 1.0)
    assert not channel.values.flags.writeable and channel.values.dtype == np.float64
    assert Channel(0.5, channel.values).values is channel.values


def test_fields_are_refused_by_name_also_on_replace() -> None:
    channel = Channel(0.5, np.arange(3.0))
    with pytest.raises(FieldError, match=r"^period: out of range"):
        dataclasses.replace(channel, period=-1.0)
    with pytest.raises(FieldError, match=r"^names\[0\]: not a text"):
        Channel(0.5, channel.values, names=(3,))  # type: ignore[arg-type]
    with pytest.raises(FieldError, match="too long"):
        Channel(10.0, np.arange(100.0))


def test_rules_of_fields_carry_bounds_for_a_files_schema() -> None:
    found = rules(Channel)
    assert (found["period"].low, found["period"].high, found["period"].unit) == (
        0.0,
        10.0,
        "s",
    )
    assert rules(move)["kind"].choices == ("step", "ramp")
    assert found["period"].check("file.period", 1) == 1.0


# --- the whole package --------------------------------------------------------------------------------------
