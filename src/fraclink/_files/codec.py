"""Values as plain JSON and back, by the type hints of frozen dataclasses.

    float            a number; "inf", "-inf" or "nan" where not finite; "0x1.8p+1" in hexadecimal documents
    int, str, bool   themselves
    None             null
    complex          [re, im]
    Literal[...]     one of its words
    tuple, list      a list
    Mapping          an object
    NDArray[dtype]   a list, or {"array": name} where the document keeps its arrays as members of an archive
    dataclass, NamedTuple   an object with a key for each field
    A | B            the first that fits; several dataclasses state their class as "type": name

The hints are those by which `fracsys.checks` checks arguments; here they serve two
forms, to write and to read the values of a file. What does not fit raises Refused,
whatever the file held: a reader of files meets every possible value, for which a
constructor may raise anything.
"""

from __future__ import annotations

import dataclasses
import difflib
import functools
import math
import re
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from fraclink._display import size_of
from fraclink.errors import FieldError, FileFormatError
from fracsys.checks import Between, Parameter, parameters, rule
from fracsys.checks.ranges import Form, Refused, Rule, number
from fracsys.checks.rules import REQUIRED

T = TypeVar("T")
Arrays = dict[str, NDArray[Any]]

_WORDS = {"inf": math.inf, "-inf": -math.inf, "nan": math.nan}
# float.fromhex reads "12" as 18: only the form that float.hex writes is accepted.
_HEX = re.compile(r"-?0x[01]\.[0-9a-f]{1,13}p[+-][0-9]{1,4}")
_REAL, _FINITE = number(Between(finite=False)), number()
_AGAIN = "make the file again"


@functools.cache
def _stored(kind: Any) -> dict[str, Parameter]:
    """The fields of a class that are stored in its file: all without
    ``metadata={"stored": False}``.
    """
    fields = dataclasses.fields(kind) if dataclasses.is_dataclass(kind) else ()
    left_out = {each.name for each in fields if not each.metadata.get("stored", True)}
    by_name = parameters(kind)
    return {name: by_name[name] for name in by_name if name not in left_out}


class _Encoder(Form):
    """Values in the form of JSON; with `arrays`, arrays become members of an archive."""

    def __init__(self, *, hex_floats: bool = False, arrays: bool = False) -> None:
        self.hex_floats, self.arrays = hex_floats, arrays
        self.own = {
            float: self.real,
            complex: self.pair,
            np.ndarray: self.array,
            Any: self.anything,
            type: self.fields,
        }

    def real(self, rule: Rule, value: Any) -> float | str:
        plain: float = _REAL.convert(value, self)
        # JSON has no infinities or NaN, and a reader in another language would stop at
        # them: they are written as strings.
        if not math.isfinite(plain):
            return str(plain)
        return plain.hex() if self.hex_floats else plain

    def pair(self, rule: Rule, value: Any) -> list[float | str]:
        if not isinstance(value, complex | np.complexfloating):
            raise _misfit(value, "not a complex number", rule)
        return [self.real(rule, value.real), self.real(rule, value.imag)]

    def array(self, rule: Rule, value: Any) -> Any:
        values = np.asarray(value)
        if values.dtype != rule.of or not values.ndim:
            shape = f"{values.dtype} of shape {values.shape}"
            expected = f"{rule.of}, at least one axis"
            raise Refused(shape, "an array of another type", expected, _AGAIN)
        if self.arrays:
            return values
        if values.dtype.kind == "c":
            values = np.stack([values.real, values.imag], axis=-1)
        return _Encoder().anything(rule, values.tolist())

    def anything(self, rule: Rule, value: Any) -> Any:
        """Any value of JSON itself, with non-finite reals as words and tuples as lists."""
        value = value.item() if isinstance(value, np.generic) else value
        if isinstance(value, Mapping):
            return {str(k): self.entry(rule, item, k) for k, item in value.items()}
        if isinstance(value, list | tuple):
            return [self.anything(rule, item) for item in value]
        if isinstance(value, float):
            return _Encoder().real(rule, value)
        if isinstance(value, bool | int | str | None):
            return value
        raise _misfit(type(value).__name__, "without a form in a file", rule)

    def fields(self, rule: Rule, value: Any) -> Any:
        kind: Any = rule.of
        fields = _stored(kind)
        if type(value) is not kind:
            raise _misfit(type(value).__name__, "of another type", rule)
        content = {"type": kind.__name__} if rule.named else {}
        for name, field in fields.items():
            content[name] = self.entry(field.rule, getattr(value, name), name)
        return content


class Decoder(Form):
    """Values from JSON, or from an archive with `arrays`."""

    def __init__(
        self, *, hex_floats: bool = False, arrays: Mapping[str, Any] | None = None
    ) -> None:
        self.hex_floats, self.arrays = hex_floats, arrays or {}
        self.own = {
            float: self.real,
            complex: self.pair,
            np.ndarray: self.array,
            type: self.fields,
        }

    def real(self, rule: Rule, data: Any) -> float:
        if isinstance(data, str) and data in _WORDS:
            return _WORDS[data]
        if self.hex_floats and isinstance(data, str) and _HEX.fullmatch(data):
            return float(_made(lambda: float.fromhex(data)))
        if self.hex_floats or type(data) not in (int, float):
            raise _misfit(data, "not a number", rule)
        return float(_FINITE.convert(data, self))

    def pair(self, rule: Rule, data: Any) -> complex:
        if not isinstance(data, list) or len(data) != 2:
            raise _misfit(data, "not a pair [re, im]", rule)
        return complex(self.real(rule, data[0]), self.real(rule, data[1]))

    def array(self, rule: Rule, data: Any) -> NDArray[Any]:
        if isinstance(data, dict) and set(data) == {"array"}:
            data = self.arrays.get(str(data["array"]))
        values = _unlisted(rule, data) if isinstance(data, list) else data
        if not isinstance(values, np.ndarray) or values.dtype != rule.of:
            raise _misfit(type(data).__name__, f"not an array of {rule.of}", rule)
        values.flags.writeable = False
        return values

    def keys(self, kind: type) -> dict[str, Parameter]:
        """The fields of a class by their keys in the file."""
        return _stored(kind)

    def fields(self, rule: Rule, data: Any) -> Any:
        """The instance described by a table; all its faults are reported together."""
        kind, name = rule.of, rule.of.__name__
        if not isinstance(data, Mapping) or (rule.named and data.get("type") != name):
            raise _misfit(data, "not a table", rule)
        table = {k: v for k, v in data.items() if not (rule.named and k == "type")}
        by_key, values, faults = self.keys(kind), {}, []
        # Unknown keys first: a misspelt key is also missing under its right name, and
        # the wrong spelling explains why.
        for key in [*(key for key in table if key not in by_key), *by_key]:
            try:
                if key not in by_key:
                    raise _unknown(key, table[key], by_key)
                if key in table:
                    values[by_key[key].name] = self(by_key[key].rule, table[key])
                elif by_key[key].default is REQUIRED:
                    raise _missing(key, by_key[key].rule)
            except Refused as refused:
                refused.keys.append(key)
                faults.append(refused)
        if faults:
            together = Refused(data, "with faults", rule.expected, _AGAIN)
            together.inner = faults
            raise together
        # The constructor checks the values against each other.
        return _made(lambda: kind(**values))


def _unknown(key: str, value: Any, known: Mapping[str, Parameter]) -> Refused:
    remedy = suggestion(key, known) or "remove it"
    for own, field in known.items():
        _, own_name, unit = key.partition(f"{field.name}_")
        over, _, under = unit.partition("_per_")
        size = _size(over) / _size(under)
        if own_name and field.rule.unit and size != 1.0 and type(value) in (int, float):
            # The same number under the right key would be another value.
            remedy = f"give it in {field.rule.unit}: {own} = {value * size:.10g}"
    return Refused(value, "an unknown key", ", ".join(known), remedy)


def _size(unit: str) -> float:
    """The size in SI units of a unit as keys spell it: 1e-7 of g_cm2."""
    factors = re.findall(r"([^\d_]+)(\d?)", unit)
    return math.prod(size_of(name) ** int(power or 1) for name, power in factors)


def _missing(key: str, rule: Rule) -> Refused:
    expected = "a table" if rule.kind is type else rule.expected
    return Refused("(nothing)", "missing", expected, f"add {key} = …")


def suggestion(word: str, known: Iterable[str]) -> str:
    """``did you mean 'x'?`` for the nearest known word, or an empty string if none is
    near.
    """
    original = {name.lower(): name for name in known}
    # At least half of the letters in common: this admits a typing error or a missing
    # unit, but not another word.
    near = difflib.get_close_matches(word.lower(), original, n=1, cutoff=0.5)
    return f"did you mean {original[near[0]]!r}?" if near else ""


def _unlisted(rule_: Rule, data: list[Any]) -> NDArray[Any]:
    dtype = rule_.of
    # Each leaf by itself: np.array would turn [1, "a"] into strings, and true into a
    # number.
    leaf = rule({"f": float, "c": float, "b": bool}.get(dtype.kind, int))
    decimal = Decoder()

    def leaves(part: Any) -> Any:
        return [*map(leaves, part)] if isinstance(part, list) else decimal(leaf, part)

    numbers = leaves(data)

    def array() -> NDArray[Any]:
        if dtype.kind != "c":
            return np.array(numbers, dtype)
        pairs = np.array(numbers, float)
        return pairs.reshape(-1, 2).view(complex).reshape(pairs.shape[:-1] or (0,))

    return _made(array)


def _misfit(value: object, problem: str, rule: Rule) -> Refused:
    return Refused(value, problem, rule.expected, _AGAIN, is_type=True)


def _made(make: Callable[[], Any]) -> Any:
    """Return what `make` returns; any exception that it raises for the values of a file
    becomes Refused.
    """
    try:
        return make()
    except Refused:
        raise
    except FieldError as error:
        refused = Refused(error.value, error.problem, error.allowed, error.remedy)
        refused.keys += [error.field] if error.field else []
        raise refused from error
    except Exception as error:  # a constructor may be given unforeseen values
        raise Refused(
            f"{type(error).__name__}: {error}", "damaged", "a file of fraclink", _AGAIN
        ) from error


def faults_of(
    refused: Refused, path: str = "", error: type[FieldError] = FileFormatError
) -> list[FieldError]:
    """Return an error for each fault of a file, named by its path from `path` on."""
    for key in map(str, reversed(refused.keys)):
        # The errors of a part already contain the name of the part.
        inside = not path or key.startswith(f"{path}.")
        path = key if inside else f"{path}.{key}"
    if refused.inner:
        return [each for r in refused.inner for each in faults_of(r, path, error)]
    allowed, remedy = refused.expected, refused.remedy
    if error is FileFormatError:  # such a file was not written by hand
        remedy = _AGAIN
    field, value = path or "content", refused.value
    return [error(field, value, refused.problem, allowed, remedy)]


def plain(
    value: Any, kind: Any, *, hex_floats: bool = False, arrays: Arrays | None = None
) -> Any:
    """Return a value of type `kind` in the form of JSON.

    With `arrays`, its arrays are stored there under their path in the value.
    """
    form = _Encoder(hex_floats=hex_floats, arrays=arrays is not None)
    members: Arrays = {} if arrays is None else arrays
    try:
        return _put_aside(form(rule(kind), value), "", members)
    except Refused as refused:
        raise faults_of(refused)[0] from None


def _put_aside(tree: Any, path: str, arrays: Arrays) -> Any:
    """The tree with its arrays moved to `arrays`; Refused for what no file can hold."""
    if isinstance(tree, dict) and all(isinstance(key, str) for key in tree):
        return {
            key: _put_aside(item, f"{path}.{key}" if path else key, arrays)
            for key, item in tree.items()
        }
    if isinstance(tree, list | tuple):
        return [_put_aside(x, f"{path}.{k}", arrays) for k, x in enumerate(tree)]
    if isinstance(tree, np.ndarray):
        arrays[path] = tree
        return {"array": path}
    if not isinstance(tree, bool | int | float | str | None):
        raise Refused(
            type(tree).__name__,
            "without a file format",
            "numbers, texts, arrays and results made of them",
            _AGAIN,
        )
    return tree


def from_plain(
    kind: type[T],
    data: Any,
    path: str = "",
    *,
    hex_floats: bool = False,
    arrays: Mapping[str, Any] | None = None,
) -> T:
    """Return the instance of `kind` in plain JSON and the arrays of an archive.

    FileFormatError names the place in the data, below `path`.
    """
    form = Decoder(hex_floats=hex_floats, arrays=arrays)
    try:
        value: T = form(rule(cast(Any, kind)), data)
    except Refused as refused:
        raise faults_of(refused, path)[0] from None
    return value
