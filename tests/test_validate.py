"""Checks by annotation: what each kind of annotation accepts, how it is normalised, and
how it is rejected.
"""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from fraclink.errors import FieldError
from fracsys.checks import (
    Angle,
    Array,
    Between,
    Payload,
    Period,
    checked,
    rule,
)
from fracsys.checks.equality import compared

Count = Annotated[int, Between(1, 10**9)]

if TYPE_CHECKING:
    pass  # a name that does not exist at run time


Series = Annotated[NDArray[np.float64], Array(1)]
SeriesLike = Annotated[ArrayLike, Array(1)]


def refusal(annotation: Any, value: object) -> FieldError:
    with pytest.raises(FieldError) as caught:
        rule(annotation).check("x", value)
    assert "\n" not in str(caught.value)
    return caught.value


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


@pytest.mark.parametrize("value", [3, np.int8(3), np.uint64(3)])
def test_a_whole_number_becomes_a_plain_int(value: object) -> None:
    plain = rule(Count).check("x", value)
    assert type(plain) is int and plain == 3


@pytest.mark.parametrize("value", [3.0, True, np.False_, "3", None, np.float64(3)])
def test_a_float_or_bool_is_no_whole_number(value: object) -> None:
    assert refusal(int, value).problem == "not a whole number"


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
    for annotation in (Path, str | os.PathLike[str], str | Path):
        assert rule(annotation).check("x", "a/log.csv") == Path("a/log.csv")
        assert rule(annotation).check("x", Path("log.csv")) == Path("log.csv")
        for junk in ("", "a\0b", b"log.csv", None, 3):
            assert refusal(annotation, junk).allowed == "the name of a file or folder"


def test_none_is_only_what_is_optional() -> None:
    assert rule(float | None).check("x", None) is None
    assert rule(float | None).check("x", 1) == 1.0
    assert refusal(float | None, "1").problem == "not a number"
    assert refusal(None, 1).problem == "not None"


# --- sequences, pairs, mappings -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "kind", [tuple[Payload, ...], Sequence[Payload], Iterable[Payload]]
)
def test_a_sequence_becomes_a_tuple(kind: Any) -> None:
    for value in ([1, 2], (1.0, 2), np.array([1.0, 2.0]), range(1, 3)):
        assert rule(kind).check("x", value) == (1.0, 2.0)
    assert refusal(kind, [1.0, "2"]).field == "x[1]"
    for junk in ("12", b"12", 1.0, None, {1.0: 2.0}, np.array(1.0)):
        assert refusal(kind, junk).problem == "not a list"


def test_mappings_are_checked_value_by_value() -> None:
    table = Mapping[str, Payload]
    assert rule(table).check("x", {"a": 1}) == {"a": 1.0}
    assert refusal(table, {"a": 1.0, "b": 0.0}).field == "x['b']"
    assert refusal(table, [("a", 1.0)]).problem == "not a mapping"


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
    # only their sum overflows
    assert rule(annotation).check("x", [1e308, 1e308]).tolist() == [
        1e308,
        1e308,
    ]


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


def test_arguments_are_not_copied_and_fields_are_read_only_copies() -> None:
    values = np.arange(3.0)
    assert rule(Series).check("x", values) is values
    kept = Channel(0.5, values).values
    values[0] = 9.0
    assert kept[0] == 0.0 and not kept.flags.writeable
    assert Channel(0.5, kept).values is kept
    view = values.view()
    view.flags.writeable = False  # but the base array is still writable
    assert Channel(0.5, view).values is not view


# --- results that are compared ------------------------------------------------------------------------------


@compared
@dataclass(frozen=True, eq=False)
class Result:
    """An object with samples."""

    samples: Any
    name: str = ""
    note: str = dataclasses.field(default="", compare=False)


def test_results_are_equal_where_all_their_fields_are() -> None:
    a = Result(np.arange(3.0), "a")
    assert a == Result(np.arange(3.0), "a", "another note")
    assert a != Result(np.arange(3.0), "b")
    assert a != Result(np.arange(3), "a")  # integers are a different result
    assert a != Result(np.arange(4.0), "a")
    assert (a == "a") is False
    assert Result(np.array([math.nan])) == Result(np.array([math.nan]))
    assert Result(math.nan) == Result(math.nan) and Result(1.0) != Result(math.nan)
    between = Between(float("nan"))
    assert Result(between) == Result(Between(float("nan"))) != Result(Between(1.0))
    assert Result(np.array(["x"])) == Result(np.array(["x"]))
    assert Result({"k": np.ones(2)}) == Result({"k": np.ones(2)})
    kinds = ({"k": 1}, {"k": math.nan}, {}, (1,), (), [1], 1, None, np.ones(1))
    for k, one in enumerate(kinds):
        assert [Result(one) == Result(other) for other in kinds].index(True) == k
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
    """Return the arguments."""
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
        ((1.0, 1.0, 0), {}, "rest"),
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
        # fields have been normalised to plain values at this point
        if self.values.size * self.period > 100.0:
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
    with pytest.raises(FieldError, match=r"^names\[0\]: not a string"):
        Channel(0.5, channel.values, names=(3,))  # type: ignore[arg-type]
    with pytest.raises(FieldError, match="too long"):
        Channel(10.0, np.arange(100.0))
