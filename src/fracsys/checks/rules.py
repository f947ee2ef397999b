"""Conversion of annotations to rules: the only interpreter of type hints.

The values that a function or a dataclass accepts are declared once, in its annotations.
`parameters` reads these, and all users share the resulting rules: `checked` for the
arguments of a call, the codec for the fields of a file, the reader of TOML for keys and
their units, the command line for its options.
"""

from __future__ import annotations

import functools
import inspect
import os
import types
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, is_dataclass, replace
from pathlib import Path
from typing import (
    Annotated,
    Any,
    Literal,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
    is_typeddict,
)

import numpy as np
from numpy.typing import NDArray

from fracsys.checks.ranges import (
    Array,
    Between,
    Form,
    Refused,
    Rule,
    Where,
    brief,
    number,
    whole_number,
)

REQUIRED: Any = inspect.Parameter.empty


@dataclass(frozen=True)
class Parameter:
    """One argument of a function, or field of a dataclass.

    Parameters
    ----------
    name, hint
        its name, and its annotation with its metadata.
    rule
        the values that the annotation accepts.
    default
        its default, or `REQUIRED`.
    way
        how it is given: a kind of `inspect.Parameter`.
    """

    name: str
    hint: Any
    rule: Rule
    default: Any
    way: Any


def parameters(target: Callable[..., Any]) -> dict[str, Parameter]:
    """Return the annotated arguments of a function, or fields of a dataclass or
    TypedDict.

    >>> list(parameters(Between))[:3], parameters(Between)["low"].rule.expected
    (['low', 'high', 'unit'], 'a finite number')
    """
    hints = get_type_hints(target, include_extras=True)
    if is_typeddict(target):
        way = inspect.Parameter.KEYWORD_ONLY
        return {
            name: Parameter(name, x, rule(x), None, way) for name, x in hints.items()
        }
    signature = inspect.signature(target).parameters
    return {
        name: Parameter(name, hints[name], rule(hints[name]), each.default, each.kind)
        for name, each in signature.items()
        if name in hints
    }


@functools.lru_cache(maxsize=4096)
def rule(annotation: Any) -> Rule:
    """Return the rule of `annotation`.

    >>> rule(Annotated[float, Between(0.0, 1e6, "rad/s")]).check("gain_crossover", 12)
    12.0
    >>> rule(Literal["zero", "first"] | None).expected
    'zero or first'
    """
    annotation = _unaliased(annotation)
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _narrowed(arguments[0], arguments[1:])
    if origin is Union or isinstance(annotation, types.UnionType):
        return _union(arguments)
    if origin is Literal:
        return choice(arguments)
    if annotation in _SCALARS:
        return _SCALARS[annotation]
    kind = origin or annotation
    if kind is np.ndarray:
        return _array(annotation, Array(None, finite=False), None)
    if not isinstance(kind, type) or getattr(kind, "_is_protocol", False):
        return _SCALARS[Any]  # isinstance does not work with a protocol; mypy checks it
    return _container(kind, arguments)


def _unaliased(annotation: Any) -> Any:
    """`annotation` with type aliases resolved; NDArray is one from numpy 2.5 on."""
    value = getattr(get_origin(annotation) or annotation, "__value__", None)
    if value is None:
        return annotation
    arguments = get_args(annotation)
    return _unaliased(value[arguments] if arguments else value)


def _container(kind: type, arguments: tuple[Any, ...]) -> Rule:
    if issubclass(kind, os.PathLike):
        return _PATH
    # tuple[float, float] is a pair; tuple[float, ...] is a sequence of any length, like
    # a list.
    if kind is tuple and arguments and arguments[-1] is not Ellipsis:
        return _fixed(tuple(rule(item) for item in arguments))
    if kind in _SEQUENCES:
        return _sequence(rule(arguments[0] if arguments else Any), kind is list)
    if issubclass(kind, Mapping) and arguments:
        return _mapping(rule(arguments[1]))
    return _FUNCTION if kind is cast(object, Callable) else instance(kind)


def _narrowed(base: Any, metadata: tuple[Any, ...]) -> Rule:
    """The rule of Annotated[base, *metadata]."""
    base = _unaliased(base)
    bounds = next((item for item in metadata if isinstance(item, Between)), None)
    shape = next((item for item in metadata if isinstance(item, Array)), None)
    if shape is None and get_origin(base) in (Union, types.UnionType):
        members = (
            Annotated[member, *metadata] if member is not type(None) else member
            for member in get_args(base)
        )
        return rule(Union[tuple(members)])  # noqa: UP007
    if shape is not None or get_origin(base) is np.ndarray:
        narrowed = _array(base, shape or Array(None), bounds)
    elif bounds is None:
        narrowed = rule(base)
    elif base in (float, int):
        narrowed = number(bounds) if base is float else whole_number(bounds)
    else:
        raise TypeError(f"Between applies to float, int or an array, not {base}")
    # In the order of the annotation: a later item sees only values that passed the
    # earlier ones.
    for item in metadata:
        if isinstance(item, Where):
            narrowed = conditional(narrowed, item)
    return narrowed


def conditional(inner: Rule, where: Where) -> Rule:
    """Return the rule of the values that `inner` accepts and for which `where` holds."""
    expected = f"{inner.expected}; {where.expected}"

    def convert(value: Any, form: Form) -> Any:
        plain = form(inner, value)
        if not where.condition(plain):
            raise Refused(brief(plain), where.problem, expected, where.remedy)
        return plain

    # Without a kind, since a form that converts the inner kind by itself would not check
    # the condition.
    return replace(inner, expected=expected, convert=convert, kind=None)


def _kind(
    fits: Callable[[Any], bool],
    name: str,
    remedy: str,
    plain: Callable[[Any], Any] = lambda value: value,
    kind: Any = None,
) -> Rule:
    """The rule for the values that `fits` accepts; `plain` converts them to the
    ordinary type.
    """

    def convert(value: Any, form: Form) -> Any:
        if fits(value):
            return plain(value)
        raise Refused(brief(value), f"not {name}", name, remedy, is_type=True)

    return Rule(name, convert, kind)


def instance(kind: type) -> Rule:
    """Return the rule of the instances of a class; its ``__made_by__`` states how to
    get one, such as ``"read_log(path)"``.

    A class may accept values from which it can be created, such as the name of a
    bundled rig: its ``__made_of__`` returns an instance, or None.
    """
    name = f"{'an' if kind.__name__[0] in 'AEIOU' else 'a'} {kind.__name__}"
    source = getattr(kind, "__made_by__", None)
    made_of = getattr(kind, "__made_of__", lambda value: None)

    def convert(value: Any, form: Form) -> Any:
        if isinstance(value, kind):
            return value
        converted = made_of(value)
        if converted is None:
            raise Refused(
                brief(value),
                f"not {name}",
                name,
                f"use {source}" if source else f"give {name}",
                is_type=True,
            )
        return converted

    return Rule(name, convert, type, kind)


def _names_a_file(value: Any) -> bool:
    text = os.fspath(value) if isinstance(value, str | os.PathLike) else None
    # An empty string would mean the current directory; a NUL ends a name in system
    # calls.
    return isinstance(text, str) and bool(text) and "\0" not in text


def _is(kind: Any) -> Callable[[Any], bool]:
    return lambda value: isinstance(value, kind)


_FUNCTION = _kind(callable, "a function", "give a function")
_PATH = _kind(_names_a_file, "the name of a file or folder", "give its path", Path)
_NOTHING = _kind(_is(type(None)), "None", "leave it out")
_ANYTHING = Rule("anything", lambda value, form: value, Any)
_SCALARS: dict[Any, Rule] = {
    float: number(),
    int: whole_number(),
    complex: _kind(_is(complex), "a complex number", "give a number", kind=complex),
    bool: _kind(_is(bool | np.bool_), "True or False", "give True or False", bool),
    str: _kind(_is(str), "a string", "give a str"),
    bytes: _kind(_is(bytes), "bytes", "give bytes", kind=bytes),
    None: _NOTHING,
    type(None): _NOTHING,
    Any: _ANYTHING,
    object: _ANYTHING,
}
_SEQUENCES: tuple[Any, ...] = (tuple, list, Sequence, Iterable, Collection)


def choice(choices: tuple[Any, ...]) -> Rule:
    """Return the rule that accepts one of several words or whole numbers."""
    expected = listed([str(word) for word in choices])
    kinds = tuple({type(word) for word in choices})

    def convert(value: Any, form: Form) -> Any:
        plain = int(value) if isinstance(value, np.integer) else value
        for word in choices:
            # True == 1 in Python, but a bool must not match a number.
            if word == plain and (type(plain) is type(word) or isinstance(plain, str)):
                return word
        same_type, remedy = isinstance(plain, kinds), "choose one of these"
        raise Refused(value, "unknown", expected, remedy, is_type=not same_type)

    return Rule(expected, convert, Literal)


def _union(members: tuple[Any, ...]) -> Rule:
    present = [member for member in members if member not in (None, type(None))]
    kinds = [get_origin(member) or member for member in present]
    # str | Path is a single value: the name of a file, in either form.
    if len(kinds) > 1 and all(kind in (str, os.PathLike, Path) for kind in kinds):
        inner = _PATH
    elif len(present) == 1:
        inner = rule(present[0])
    else:
        inner = _any_of([rule(member) for member in present])
    if len(present) == len(members):
        return inner

    def convert(value: Any, form: Form) -> Any:
        return None if value is None else form(inner, value)

    return replace(inner, convert=convert, kind=None)


def _any_of(members: Sequence[Rule]) -> Rule:
    expected = listed(list(dict.fromkeys(item.expected for item in members)))
    classes = [item for item in members if item.kind is type and is_dataclass(item.of)]
    if len(classes) > 1:
        members = [replace(item, named=item in classes) for item in members]

    def convert(value: Any, form: Form) -> Any:
        refusals = []
        for item in members:
            try:
                return form(item, value)
            except Refused as refused:
                # A traceback would keep this frame, and with it every array of every
                # caller, alive until the next garbage collection.
                refusals.append(refused.with_traceback(None))
        # A member that accepts this type but not this value gives the reason.
        for item, refusal in zip(members, refusals, strict=True):
            if not refusal.is_type:
                # A wrong word: the message also lists the numbers or objects that the
                # union accepts.
                refusal.expected = expected if item.kind is Literal else item.expected
                raise refusal
        raise Refused(
            brief(value),
            "of another type",
            expected,
            listed(list(dict.fromkeys(refusal.remedy for refusal in refusals))),
            is_type=True,
        )

    return Rule(expected, convert)


def _fixed(items: tuple[Rule, ...]) -> Rule:
    name = "a pair" if len(items) == 2 else f"{len(items)} values"
    words = list(dict.fromkeys(item.expected for item in items))
    each = f", each {words[0]}" if len(words) == 1 else f": {', '.join(words)}"

    def convert(value: Any, form: Form) -> tuple[Any, ...]:
        # Sets and dicts do not tell which entry comes first.
        is_list = isinstance(value, tuple | list | np.ndarray)
        if not is_list or len(value) != len(items):
            raise Refused(
                brief(value), f"not {name}", name + each, f"give {name}", is_type=True
            )
        pairs = enumerate(zip(items, value, strict=True))
        return tuple(form.entry(item, entry, place) for place, (item, entry) in pairs)

    return Rule(name + each, convert, unit=items[0].unit)


def _sequence(item: Rule, as_list: bool) -> Rule:
    each = "" if item.kind is Any else f", each entry {item.expected}"
    expected = f"a list{each}"

    def convert(value: Any, form: Form) -> Any:
        # A string is a sequence of characters and a mapping one of its keys; both are
        # mistakes where a list is expected.
        unlike = isinstance(value, str | bytes | Mapping)
        scalar = isinstance(value, np.ndarray) and value.ndim == 0
        if unlike or scalar or not isinstance(value, Iterable):
            raise Refused(
                brief(value),
                "not a list",
                expected,
                "put a single value in a list",
                is_type=True,
            )
        # A single pass: a generator cannot be read twice.
        entries = [form.entry(item, entry, place) for place, entry in enumerate(value)]
        return entries if as_list else tuple(entries)

    return Rule(expected, convert, unit=item.unit)


def _mapping(item: Rule) -> Rule:
    expected = f"a mapping, each value {item.expected}"

    def convert(value: Any, form: Form) -> dict[Any, Any]:
        if not isinstance(value, Mapping):
            raise Refused(
                brief(value), "not a mapping", expected, "give a dict", is_type=True
            )
        return {key: form.entry(item, entry, key) for key, entry in value.items()}

    return Rule(expected, convert, unit=item.unit)


def _array(annotation: Any, shape: Array, bounds: Between | None) -> Rule:
    dtype = _dtype(annotation)
    # Lossless conversions only: integers to floats and floats to complex numbers, but
    # never a float to an index.
    kinds = {"c": "iufc", "b": "b", "i": "iu"}.get(dtype.kind, "iuf")
    kinds += "b" if shape.flags else ""
    expected = f"{shape.expected}, each {bounds.expected}" if bounds else shape.expected
    remedy = "give an array of numbers"
    if shape.ndim == 1:
        remedy = "give one column of numbers"

    def convert(value: Any, form: Form) -> NDArray[Any]:
        try:
            raw = np.asarray(value)
        except (TypeError, ValueError, OverflowError):  # rows of different lengths
            raw = np.asarray(None)
        if raw.dtype.kind not in kinds:
            raise Refused(
                brief(value), "not an array of numbers", expected, remedy, is_type=True
            )
        if shape.ndim not in (None, raw.ndim) or raw.size < shape.min_size:
            raise Refused(f"shape {raw.shape}", "of another shape", expected, remedy)
        # Not copied if already float64: logs of millions of samples pass here with every
        # call.
        array = raw.astype(dtype, copy=False)
        # The sum shows NaN and infinity in one pass without a copy; only then is each
        # entry tested.
        if shape.finite and dtype.kind in "fc" and not _sum_is_finite(array):
            _check_entries(array, np.isfinite(array), "not finite", expected, remedy)
        if bounds is not None:
            inside = bounds.admits(array)
            _check_entries(array, inside, "out of range", expected, bounds.remedy)
        return array

    return Rule(
        expected, convert, np.ndarray, dtype, unit=bounds.unit if bounds else ""
    )


def _sum_is_finite(array: NDArray[Any]) -> bool:
    with np.errstate(over="ignore", invalid="ignore"):
        return bool(np.isfinite(array.sum()))


def _check_entries(
    array: NDArray[Any], good: Any, problem: str, expected: str, remedy: str
) -> None:
    if not good.all():
        place = np.argwhere(~good)[0]
        where = (
            f"entry {', '.join(map(str, place))}" if place.size else "the only entry"
        )
        value = array[tuple(place)]
        raise Refused(value, f"{problem} ({where})", expected, remedy)


def _dtype(annotation: Any) -> np.dtype[Any]:
    """The element type of NDArray[...]; float64 if none or more than one is given."""
    arguments = get_args(annotation) if get_origin(annotation) is np.ndarray else ()
    scalar = (*get_args(arguments[1]), None)[0] if len(arguments) == 2 else None
    concrete = isinstance(scalar, type) and not inspect.isabstract(scalar)
    return np.dtype(scalar if concrete else np.float64)


def listed(words: Sequence[str]) -> str:
    """Return words as a sentence lists them: a, b or c."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"
