"""From an annotation to its rule: what a type, and a range beside it, admit; in words
and as a check.

`fracsys.checks` is the door: its `checked` applies these rules to arguments and
fields.
"""

from __future__ import annotations

import functools
import inspect
import os
import types
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import InitVar, replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, Union, cast, get_args, get_origin

import numpy as np
from numpy.typing import NDArray

from fracsys.checks.ranges import (
    Array,
    Between,
    Check,
    Length,
    Ordered,
    Refused,
    Rule,
    Where,
    brief,
    complex_rule,
    number_rule,
    whole_rule,
)


def unaliased(annotation: Any) -> Any:
    """Return what `annotation` stands for if it is a type alias, as NDArray is from
    numpy 2.5 on; itself otherwise.

    >>> get_origin(unaliased(NDArray[np.float64]))
    <class 'numpy.ndarray'>
    """
    value = getattr(get_origin(annotation) or annotation, "__value__", None)
    if value is None:
        return annotation
    arguments = get_args(annotation)
    return unaliased(value[arguments] if arguments else value)


def rule(annotation: Any, *, own: bool = False) -> Rule:
    """Return the rule of `annotation`; with `own`, arrays become read-only copies, as a
    field keeps them.

    >>> rule(Annotated[float, Between(0.0, 1e6, "rad/s")]).check("gain_crossover", 12)
    12.0
    """
    try:
        return _rule(annotation, own)
    except TypeError:  # metadata that cannot be hashed
        return _rule.__wrapped__(annotation, own)


@functools.lru_cache(maxsize=4096)
def _rule(annotation: Any, own: bool) -> Rule:
    if isinstance(annotation, InitVar):
        annotation = annotation.type
    annotation = unaliased(annotation)
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _narrowed(arguments[0], arguments[1:], own)
    if origin is Union or isinstance(annotation, types.UnionType):
        return _union(arguments, own)
    if origin is Literal:
        return _choice(arguments)
    if isinstance(annotation, TypeVar):
        return rule(annotation.__bound__ or Any, own=own)
    if annotation in _SCALARS:
        return _SCALARS[annotation]
    kind = origin or annotation
    if kind is np.ndarray:
        return array_rule(annotation, Array(None, finite=False), None, own)
    if not isinstance(kind, type) or getattr(kind, "_is_protocol", False):
        return _SCALARS[Any]  # isinstance cannot ask a protocol; mypy has the say there
    return _container(kind, arguments, own)


def _container(kind: type, arguments: tuple[Any, ...], own: bool) -> Rule:
    if issubclass(kind, os.PathLike):
        return _PATH
    # tuple[float, float] is a pair; tuple[float, ...] a sequence of any length, as a
    # list is.
    if kind is tuple and arguments and arguments[-1] is not Ellipsis:
        return _fixed(tuple(rule(item, own=own) for item in arguments))
    if kind in _SEQUENCES:
        return _sequence(
            rule(arguments[0] if arguments else Any, own=own),
            list if kind is list else tuple,
        )
    if issubclass(kind, Mapping) and arguments:
        return _mapping(rule(arguments[1], own=own))
    return _FUNCTION if kind is cast(object, Callable) else instance_rule(kind)


def _narrowed(base: Any, metadata: tuple[Any, ...], own: bool) -> Rule:
    """The rule of Annotated[base, *metadata]."""
    base = unaliased(base)
    bounds = next((item for item in metadata if isinstance(item, Between)), None)
    shape = next((item for item in metadata if isinstance(item, Array)), None)
    if shape is None and get_origin(base) in (
        Union,
        types.UnionType,
    ):
        members = (
            Annotated[member, *metadata] if member is not type(None) else member
            for member in get_args(base)
        )
        return rule(Union[tuple(members)], own=own)  # noqa: UP007
    if shape is not None or get_origin(base) is np.ndarray:
        narrowed = array_rule(base, shape or Array(None), bounds, own)
    elif bounds is not None and base in (float, int):
        narrowed = number_rule(bounds) if base is float else whole_rule(bounds)
    elif bounds is not None:
        raise TypeError(
            f"Between stands beside float, int or an array, not beside {base}"
        )
    else:
        narrowed = rule(base, own=own)
    # In the order of the annotation: a later one sees only what the earlier ones let
    # through.
    for item in metadata:
        if isinstance(item, Ordered):
            narrowed = _ordered(narrowed, item)
        elif isinstance(item, Length):
            narrowed = _counted(narrowed, item)
        elif isinstance(item, Where):
            narrowed = conditional_rule(narrowed, item)
    return narrowed


def _kind(
    fits: Callable[[Any], bool],
    name: str,
    remedy: str,
    plain: Check = lambda value: value,
) -> Rule:
    """The rule of a kind of values that `fits` recognises and `plain` makes ordinary."""

    def convert(value: Any) -> Any:
        if fits(value):
            return plain(value)
        raise Refused(brief(value), f"not {name}", name, remedy, is_type=True)

    return Rule(name, convert)


def instance_rule(kind: type) -> Rule:
    """An instance of a class; its ``__made_by__`` says where to get one:
    ``"read_log(path)"``.
    """
    name = f"{'an' if kind.__name__[0] in 'AEIOU' else 'a'} {kind.__name__}"
    source = getattr(kind, "__made_by__", None)
    own = _kind(
        lambda value: isinstance(value, kind),
        name,
        f"use {source}" if source else f"give {name}",
    )
    made_of = getattr(kind, "__made_of__", None)
    if made_of is None:
        return own

    def convert(value: Any) -> Any:
        # A class may take what it can be made of: a path for the log in it, a name for
        # a bundled rig.
        made = made_of(value)
        return own.convert(value if made is None else made)

    return replace(own, convert=convert)


def _names_a_file(value: Any) -> bool:
    text = os.fspath(value) if isinstance(value, str | os.PathLike) else None
    # An empty text would stand for the folder one happens to be in; a NUL ends a name
    # inside the system.
    return isinstance(text, str) and bool(text) and "\0" not in text


_FUNCTION = _kind(callable, "a function", "give a function")
_PATH = _kind(_names_a_file, "the name of a file or folder", "give its path", Path)
_NOTHING = _kind(lambda value: value is None, "None", "leave it out")
_SCALARS: dict[Any, Rule] = {
    float: number_rule(),
    int: whole_rule(),
    complex: complex_rule(),
    bool: _kind(
        lambda value: isinstance(value, bool | np.bool_),
        "True or False",
        "give True or False",
        bool,
    ),
    str: _kind(lambda value: isinstance(value, str), "a text", "give a str"),
    None: _NOTHING,
    type(None): _NOTHING,
    Any: Rule("anything", lambda value: value),
    object: Rule("anything", lambda value: value),
}
_SEQUENCES: tuple[Any, ...] = (tuple, list, Sequence, Iterable, Collection)


def _choice(choices: tuple[Any, ...]) -> Rule:
    expected = listed([str(choice) for choice in choices])
    kinds = tuple({type(choice) for choice in choices})

    def convert(value: Any) -> Any:
        plain = int(value) if isinstance(value, np.integer) else value
        # True == 1 in Python, and a bool is no choice among numbers.
        if type(plain) in kinds or (isinstance(plain, str) and str in kinds):
            for choice in choices:
                if choice == plain:
                    return choice
        is_type = not isinstance(plain, kinds)
        raise Refused(
            value, "unknown", expected, "choose one of these", is_type=is_type
        )

    return Rule(expected, convert, choices=choices)


def _union(members: tuple[Any, ...], own: bool) -> Rule:
    present = [member for member in members if member not in (None, type(None))]
    kinds = [get_origin(member) or member for member in present]
    # str | Path: one value, the name of a file, however it is given.
    if len(kinds) > 1 and all(
        kind is str or kind in (os.PathLike, Path) for kind in kinds
    ):
        inner = _PATH
    elif len(present) == 1:
        inner = rule(present[0], own=own)
    else:
        inner = _any_of([rule(member, own=own) for member in present])
    if len(present) == len(members):
        return inner
    convert = inner.convert
    optional: Check = lambda value: None if value is None else convert(value)  # noqa: E731
    return Rule(
        inner.expected, optional, inner.unit, inner.low, inner.high, inner.choices
    )


def _any_of(rules: Sequence[Rule]) -> Rule:
    expected = listed(list(dict.fromkeys(item.expected for item in rules)))

    def convert(value: Any) -> Any:
        refusals = []
        for item in rules:
            try:
                return item.convert(value)
            except Refused as refused:
                # Without its traceback: that holds this frame, the frame holds this
                # list, and so every array of every caller would live on until the next
                # search for cycles.
                refusals.append(refused.with_traceback(None))
        # A member whose kind fits knows the reason; otherwise no member takes such a
        # value.
        for refusal in refusals:
            if not refusal.is_type:
                raise refusal
        remedy = listed(list(dict.fromkeys(refusal.remedy for refusal in refusals)))
        raise Refused(brief(value), "of another type", expected, remedy, is_type=True)

    return Rule(expected, convert)


def _fixed(rules: tuple[Rule, ...]) -> Rule:
    count = len(rules)
    name = "a pair" if count == 2 else f"{count} values"
    words = list(dict.fromkeys(item.expected for item in rules))
    expected = (
        f"{name}, each {words[0]}" if len(words) == 1 else f"{name}: {', '.join(words)}"
    )

    def convert(value: Any) -> tuple[Any, ...]:
        # A set or a dict of two has no first entry.
        if not isinstance(value, tuple | list | np.ndarray) or len(value) != count:
            raise Refused(
                brief(value), f"not {name}", expected, f"give {name}", is_type=True
            )
        return tuple(_entries(zip(rules, value, strict=True)))

    return Rule(expected, convert, rules[0].unit, rules[0].low, rules[0].high)


def _sequence(item: Rule, kind: type[tuple[Any, ...]] | type[list[Any]]) -> Rule:
    expected = (
        "a list"
        if item.expected == "anything"
        else f"a list, each entry {item.expected}"
    )

    def convert(value: Any) -> Any:
        # A text is a sequence of letters and a mapping one of its keys: both are
        # mistakes where a list is wanted.
        if isinstance(value, str | bytes | Mapping) or not isinstance(value, Iterable):
            raise Refused(
                brief(value),
                "not a list",
                expected,
                "put a single one in a list",
                is_type=True,
            )
        if isinstance(value, np.ndarray) and value.ndim == 0:
            raise Refused(
                brief(value),
                "not a list",
                expected,
                "put a single one in a list",
                is_type=True,
            )
        # Once through: a generator cannot be read a second time.
        return kind(_entries((item, entry) for entry in value))

    return Rule(expected, convert, item.unit, item.low, item.high)


def _mapping(item: Rule) -> Rule:
    expected = f"a mapping, each value {item.expected}"

    def convert(value: Any) -> dict[Any, Any]:
        if not isinstance(value, Mapping):
            raise Refused(
                brief(value), "not a mapping", expected, "give a dict", is_type=True
            )
        entries = _entries(((item, entry) for entry in value.values()), tuple(value))
        return dict(zip(value, entries, strict=True))

    return Rule(expected, convert, item.unit)


def _entries(
    pairs: Iterable[tuple[Rule, Any]], keys: tuple[Any, ...] = ()
) -> list[Any]:
    entries: list[Any] = []
    for item, entry in pairs:
        try:
            entries.append(item.convert(entry))
        except Refused as refused:
            index = len(entries)
            refused.place = (
                f"[{keys[index]!r}]{refused.place}"
                if keys
                else f"[{index}]{refused.place}"
            )
            refused.is_type = False  # the container was of the right kind
            raise
    return entries


def array_rule(
    annotation: Any, shape: Array, bounds: Between | None, own: bool
) -> Rule:
    dtype = _dtype(annotation)
    # What goes without loss: integers into floats, floats into complex numbers, never a
    # float into an index.
    kinds = {"c": "iufc", "b": "b", "i": "iu"}.get(dtype.kind, "iuf") + (
        "b" if shape.flags else ""
    )
    expected = f"{shape.expected}, each {bounds.expected}" if bounds else shape.expected
    remedy = (
        "give one column of numbers" if shape.ndim == 1 else "give an array of numbers"
    )

    def convert(value: Any) -> NDArray[Any]:
        try:
            raw = np.asarray(value)
        except (TypeError, ValueError, OverflowError):  # rows of different lengths
            raw = np.asarray(None)
        if raw.dtype.kind not in kinds:
            raise Refused(
                brief(value), "not an array of numbers", expected, remedy, is_type=True
            )
        if (
            shape.ndim is not None and raw.ndim != shape.ndim
        ) or raw.size < shape.min_size:
            raise Refused(f"shape {raw.shape}", "of another shape", expected, remedy)
        # Not copied where it is float64 already: logs of millions of samples pass here
        # at every call.
        array = raw.astype(dtype, copy=False)
        # One pass without a copy: NaN and infinity show in the sum, and only then every
        # entry is looked at.
        if shape.finite and dtype.kind in "fc" and not _sums_up(array):
            _check_entries(array, np.isfinite(array), "not finite", expected, remedy)
        if bounds is not None:
            _check_entries(
                array, bounds.admits(array), "out of range", expected, bounds.remedy
            )
        return _owned(array) if own else array

    return Rule(expected, convert, bounds.unit if bounds else "")


def _sums_up(array: NDArray[Any]) -> bool:
    with np.errstate(over="ignore", invalid="ignore"):
        return bool(np.isfinite(array.sum()))


def _check_entries(
    array: NDArray[Any], good: Any, problem: str, expected: str, remedy: str
) -> None:
    if not good.all():
        place = np.argwhere(~good)[0]
        where = ", ".join(map(str, place)) if place.size else "the only one"
        raise Refused(
            array[tuple(place)], f"{problem} (entry {where})", expected, remedy
        )


def _owned(array: NDArray[Any]) -> NDArray[Any]:
    """The array itself where it is read-only, a read-only copy otherwise."""
    # A read-only view is no promise: whoever holds the base writes through it.
    if array.flags.writeable or array.base is not None or not array.flags.c_contiguous:
        array = np.array(array, order="C")
        array.flags.writeable = False
    return array


def _dtype(annotation: Any) -> np.dtype[Any]:
    """The element type of NDArray[...]; float64 where none, or more than one, is
    stated.
    """
    arguments = get_args(annotation) if get_origin(annotation) is np.ndarray else ()
    scalar = (
        get_args(arguments[1])[0]
        if len(arguments) == 2 and get_args(arguments[1])
        else None
    )
    return np.dtype(
        scalar
        if isinstance(scalar, type) and not inspect.isabstract(scalar)
        else np.float64
    )


def _ordered(inner: Rule, order: Ordered) -> Rule:
    sign = "<" if order.strict else "<="
    expected = (
        f"(low, high) with low {sign} high, each {inner.expected.partition('each ')[2]}"
    )

    def convert(value: Any) -> Any:
        pair = inner.convert(value)
        if not (pair[0] < pair[1] or (pair[0] == pair[1] and not order.strict)):
            raise Refused(
                pair, "not in ascending order", expected, "give the smaller one first"
            )
        return pair

    return Rule(expected, convert, inner.unit, inner.low, inner.high)


def _counted(inner: Rule, length: Length) -> Rule:
    bound = (
        f"{length.low} to {length.high}"
        if length.high < 10**9
        else f"at least {length.low}"
    )
    expected = f"{inner.expected}; {bound} {'characters' if inner.expected == 'a text' else 'entries'}"

    def convert(value: Any) -> Any:
        entries = inner.convert(value)
        if not length.low <= len(entries) <= length.high:
            problem = "empty" if not len(entries) else "of another length"
            raise Refused(brief(value), problem, expected, f"give {bound}")
        return entries

    return Rule(expected, convert, inner.unit, inner.low, inner.high)


def conditional_rule(inner: Rule, where: Where) -> Rule:
    def convert(value: Any) -> Any:
        plain = inner.convert(value)
        if not where.condition(plain):
            raise Refused(plain, where.problem, where.expected, where.remedy)
        return plain

    return Rule(where.expected, convert, inner.unit, inner.low, inner.high)


def listed(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"
