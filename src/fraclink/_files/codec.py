"""Values as plain JSON and back, by the type hints of frozen dataclasses.

    float            a number; "inf", "-inf" or "nan" where not finite; "0x1.8p+1" in hexadecimal documents
    int, str, bool   themselves
    None             null
    complex          [re, im]
    bytes            hexadecimal text
    Literal[...]     one of its words
    tuple, list      a list
    Mapping          an object
    NDArray[dtype]   a list, or {"array": name} where the document keeps its arrays as members of an archive
    dataclass, NamedTuple   an object with a key for each field
    A | B            the first that fits; of several dataclasses with "type": the class's name

What does not fit its hint raises FileFormatError with the field's path, whatever the
file held: a reader of files meets every possible value, and a constructor fed with them
may raise anything.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import math
import re
import types
from collections import abc
from collections.abc import Callable, Mapping
from typing import Any, Literal, Protocol, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from fraclink._files.containers import guarded, misfit
from fraclink.errors import FileFormatError
from fracsys.checks import unaliased

__all__ = ["Storage", "codec_of", "stored_as"]

_WORDS = {"inf": math.inf, "-inf": -math.inf, "nan": math.nan}
# float.fromhex takes "12" for 18: only what float.hex writes is read.
_HEX = re.compile(r"-?0x[01]\.[0-9a-f]{1,13}p[+-][0-9]{1,4}")


@dataclasses.dataclass(frozen=True)
class Storage:
    """How a document keeps reals and arrays: `arrays` are the members of an archive,
    None for JSON alone.
    """

    hex_floats: bool = False
    arrays: dict[str, NDArray[Any]] | None = None


class Codec(Protocol):
    """Turns the values of one type into plain JSON and back; `path` names the field in
    errors.
    """

    def encode(self, value: Any, path: str, storage: Storage, /) -> Any: ...
    def decode(self, data: Any, path: str, storage: Storage, /) -> Any: ...


def _child(path: str, key: object) -> str:
    return f"{path}.{key}" if path else str(key)


class _Scalar:
    """bool, int, str and None: what JSON has itself. A bool is no int here, and a numpy
    scalar is written.
    """

    def __init__(self, *kinds: type) -> None:
        self.kinds = kinds

    def encode(self, value: Any, path: str, storage: Storage) -> Any:
        return self.decode(
            value.item() if isinstance(value, np.generic) else value, path, storage
        )

    def decode(self, data: Any, path: str, storage: Storage) -> Any:
        # Not isinstance: True is an int to Python, and to no other reader of the file.
        if type(data) not in self.kinds:
            expected = " or ".join(kind.__name__ for kind in self.kinds)
            raise misfit(path, data, f"of type {type(data).__name__}", expected)
        return data


class _Float:
    def encode(self, value: Any, path: str, storage: Storage) -> Any:
        if isinstance(value, bool) or not isinstance(
            value, int | float | np.integer | np.floating
        ):
            raise misfit(path, value, "not a number", "a real number")
        number = self._made(float, value, path)
        # JSON has no word for them, and a reader of another language would stop at NaN:
        # they are texts.
        if not math.isfinite(number):
            return str(number)
        return number.hex() if storage.hex_floats else number

    def decode(self, data: Any, path: str, storage: Storage) -> float:
        if isinstance(data, str) and data in _WORDS:
            return _WORDS[data]
        if storage.hex_floats and isinstance(data, str) and _HEX.fullmatch(data):
            return self._made(float.fromhex, data, path)
        if not storage.hex_floats and type(data) in (int, float):
            return self._made(float, data, path)
        allowed = (
            "a hexadecimal real such as 0x1.8p+1"
            if storage.hex_floats
            else "a real number"
        )
        raise misfit(path, data, "not a number", allowed)

    @staticmethod
    def _made(make: Callable[[Any], float], value: Any, path: str) -> float:
        try:
            return make(value)
        except OverflowError as error:
            raise misfit(
                path, value, "beyond the largest float", "a real number"
            ) from error


class _Complex:
    def encode(self, value: Any, path: str, storage: Storage) -> Any:
        if not isinstance(value, complex | np.complexfloating):
            raise misfit(path, value, "not a complex number", "a complex number")
        return _PAIR.encode((value.real, value.imag), path, storage)

    def decode(self, data: Any, path: str, storage: Storage) -> complex:
        return complex(*_PAIR.decode(data, path, storage))


class _Bytes:
    def encode(self, value: Any, path: str, storage: Storage) -> str:
        if not isinstance(value, bytes):
            raise misfit(path, value, "not bytes", "bytes")
        return value.hex()

    def decode(self, data: Any, path: str, storage: Storage) -> bytes:
        if not isinstance(data, str) or not re.fullmatch("([0-9a-f]{2})*", data):
            raise misfit(
                path,
                data,
                "not hexadecimal text",
                "two lower-case hexadecimal digits a byte",
            )
        return bytes.fromhex(data)


class _Plain:
    """Hints `Any` and `object`: whatever JSON holds itself, non-finite reals as words,
    tuples as lists.
    """

    def encode(self, value: Any, path: str, storage: Storage) -> Any:
        if isinstance(value, Mapping):
            return {
                str(key): self.encode(item, _child(path, key), storage)
                for key, item in value.items()
            }
        if isinstance(value, list | tuple):
            return [self.encode(item, path, storage) for item in value]
        if isinstance(value, float | np.floating):
            return _FLOAT.encode(value, path, Storage())
        return _Scalar(bool, int, str, type(None)).encode(value, path, storage)

    def decode(self, data: Any, path: str, storage: Storage) -> Any:
        return data


class _Word:
    """``Literal[...]``."""

    def __init__(self, words: tuple[Any, ...]) -> None:
        self.words = words

    def encode(self, value: Any, path: str, storage: Storage) -> Any:
        return self.decode(value, path, storage)

    def decode(self, data: Any, path: str, storage: Storage) -> Any:
        # 1 == True in Python: the type has to be the word's as well.
        if not any(type(data) is type(word) and data == word for word in self.words):
            raise misfit(path, data, "unknown", ", ".join(map(str, self.words)))
        return data


class _Array:
    """A numpy array; complex ones have a last axis [re, im] in JSON."""

    def __init__(self, dtype: Any) -> None:
        self.dtype = np.dtype(dtype)

    def encode(self, value: Any, path: str, storage: Storage) -> Any:
        values = np.asarray(value)
        if values.dtype != self.dtype or not values.ndim:
            found = f"{values.dtype} of shape {values.shape}"
            raise misfit(
                path,
                found,
                "an array of another type",
                f"{self.dtype}, at least one axis",
            )
        if storage.arrays is not None:
            storage.arrays[path] = values
            return {"array": path}
        if self.dtype.kind == "c":
            values = np.stack([values.real, values.imag], axis=-1)
        return _PLAIN.encode(values.tolist(), path, storage)

    def decode(self, data: Any, path: str, storage: Storage) -> NDArray[Any]:
        if (
            isinstance(data, dict)
            and set(data) == {"array"}
            and storage.arrays is not None
        ):
            data = storage.arrays.get(str(data["array"]))
        values = data if isinstance(data, np.ndarray) else self._unlisted(data, path)
        if values.dtype != self.dtype:
            raise misfit(
                path, str(values.dtype), "an array of another type", str(self.dtype)
            )
        values.flags.writeable = False
        return values

    def _unlisted(self, data: Any, path: str) -> NDArray[Any]:
        if not isinstance(data, list):
            raise misfit(path, data, "not an array", "a list of numbers")
        # Each leaf by itself: np.array makes texts of [1, "a"], and numbers of true and
        # false.
        item = codec_of({"f": float, "c": float, "b": bool}.get(self.dtype.kind, int))
        try:
            found = np.array(_leaves(data, item, path))
            if self.dtype.kind == "c":
                found = (
                    found.astype(float)
                    .reshape(-1, 2)
                    .view(complex)
                    .reshape(found.shape[:-1] or (0,))
                )
            values = found.astype(self.dtype)
        except (ValueError, OverflowError, IndexError) as error:
            if isinstance(error, FileFormatError):
                raise
            raise misfit(
                path, str(error), "not an array", f"equal rows of {self.dtype}"
            ) from error
        # astype wraps round: 300 as an unsigned byte would be 44.
        if self.dtype.kind in "iu" and not np.array_equal(values, found):
            raise misfit(path, "an integer", "out of range", str(self.dtype))
        return values


def _leaves(data: Any, item: Codec, path: str) -> Any:
    if isinstance(data, list):
        return [_leaves(part, item, path) for part in data]
    return item.decode(data, path, Storage())


class _Sequence:
    """list[T] and tuple[T, ...], one codec repeated; tuple[A, B, C], one for each
    place.
    """

    def __init__(
        self, make: Callable[..., Any], items: tuple[Any, ...], *, repeated: bool
    ) -> None:
        self.make, self.items, self.repeated = make, items, repeated

    def encode(self, value: Any, path: str, storage: Storage) -> Any:
        return [
            codec.encode(item, place, storage)
            for codec, item, place in self._each(value, path)
        ]

    def decode(self, data: Any, path: str, storage: Storage) -> Any:
        return self.make(
            codec.decode(item, at, storage)
            for codec, item, at in self._each(data, path)
        )

    def _each(self, values: Any, path: str) -> list[tuple[Codec, Any, str]]:
        if not isinstance(values, list | tuple):
            raise misfit(path, values, "not a list", "a list")
        items = self.items * len(values) if self.repeated else self.items
        if len(values) != len(items):
            raise misfit(
                path, values, f"not {len(items)} values", f"a list of {len(items)}"
            )
        places = enumerate(zip(items, values, strict=True))
        return [(codec_of(hint), value, _child(path, i)) for i, (hint, value) in places]


class _Table:
    """Mapping[K, V]; keys that are no texts are written as JSON themselves."""

    def __init__(self, key: Any, item: Any) -> None:
        self.key, self.item = key, item

    def encode(self, value: Any, path: str, storage: Storage) -> Any:
        if not isinstance(value, Mapping):
            raise misfit(path, value, "not a mapping", "a mapping")
        key, item = codec_of(self.key), codec_of(self.item)
        words = (key.encode(k, path, Storage()) for k in value)
        names = [word if isinstance(word, str) else json.dumps(word) for word in words]
        pairs = zip(names, value.values(), strict=True)
        return {
            name: item.encode(held, _child(path, name), storage) for name, held in pairs
        }

    def decode(self, data: Any, path: str, storage: Storage) -> Any:
        if not isinstance(data, dict):
            raise misfit(path, data, "not a table", "a table")
        item = codec_of(self.item)
        return {
            self._key(k, path): item.decode(v, _child(path, k), storage)
            for k, v in data.items()
        }

    def _key(self, text: str, path: str) -> Any:
        if self.key in (int, float) and text not in _WORDS:
            try:
                return codec_of(self.key).decode(json.loads(text), path, Storage())
            except ValueError as error:
                raise misfit(path, text, "not a key", self.key.__name__) from error
        return codec_of(self.key).decode(text, path, Storage())


class _Choice:
    """A | B | None: the first that fits; dataclasses among several carry their class's
    name as "type".
    """

    def __init__(self, hints: tuple[Any, ...]) -> None:
        classes: list[Any] = [
            hint
            for hint in hints
            if dataclasses.is_dataclass(hint) and hint not in _HOOKS
        ]
        self.named: dict[str, Any] = (
            {kind.__name__: kind for kind in classes} if len(classes) > 1 else {}
        )
        # None first: what is left out is the commonest, and nothing else reads null.
        hints = tuple(hint for hint in hints if hint not in self.named.values())
        self.hints = sorted(hints, key=lambda hint: hint is not type(None))

    def encode(self, value: Any, path: str, storage: Storage) -> Any:
        name = type(value).__name__
        if self.named.get(name) is type(value):
            return {"type": name} | codec_of(self.named[name]).encode(
                value, path, storage
            )
        return self._first("encode", value, path, storage)

    def decode(self, data: Any, path: str, storage: Storage) -> Any:
        if self.named and isinstance(data, dict) and "type" in data:
            name = _Word(tuple(self.named)).decode(
                data["type"], _child(path, "type"), storage
            )
            rest = {key: value for key, value in data.items() if key != "type"}
            return codec_of(self.named[name]).decode(rest, path, storage)
        return self._first("decode", data, path, storage)

    def _first(self, step: str, value: Any, path: str, storage: Storage) -> Any:
        failure = misfit(
            path, value, "unknown", ", ".join(self.named) or "another value"
        )
        for hint in self.hints:
            try:
                return getattr(codec_of(hint), step)(value, path, storage)
            except FileFormatError as error:
                # of the last: with `X | None` the one that names what is wrong inside X
                failure = error
        raise failure


class _Fields:
    """A dataclass or NamedTuple as an object; its constructor checks the values again.

    Fields with ``init=False`` or ``metadata={"stored": False}`` are left out.
    """

    def __init__(self, kind: Any) -> None:
        self.kind = kind
        if dataclasses.is_dataclass(kind):
            stored = [
                f
                for f in dataclasses.fields(kind)
                if f.init and f.metadata.get("stored", True)
            ]
            missing = dataclasses.MISSING
            self.names = [f.name for f in stored]
            self.required = [
                f.name
                for f in stored
                if f.default is missing and f.default_factory is missing
            ]
        else:
            self.names = list(kind._fields)
            self.required = [
                name for name in kind._fields if name not in kind._field_defaults
            ]

    @functools.cached_property
    def hints(self) -> dict[str, Any]:
        """Resolved on first use: hints may name classes of modules that are loaded
        later.
        """
        found = get_type_hints(self.kind)
        return {name: found[name] for name in self.names}

    def encode(self, value: Any, path: str, storage: Storage) -> Any:
        if type(value) is not self.kind:
            raise misfit(
                path, type(value).__name__, "of another type", self.kind.__name__
            )
        return {
            name: codec_of(hint).encode(
                getattr(value, name), _child(path, name), storage
            )
            for name, hint in self.hints.items()
        }

    def decode(self, data: Any, path: str, storage: Storage) -> Any:
        if not isinstance(data, dict):
            raise misfit(path, data, "not a table", self.kind.__name__)
        # Unknown keys first: a misspelt one is missing as well, and its own spelling
        # says why.
        for key in [*data, *self.required]:
            if key not in self.hints:
                raise misfit(
                    _child(path, key),
                    data[key],
                    "an unknown key",
                    ", ".join(self.hints),
                )
            if key not in data:
                raise misfit(
                    _child(path, key), "(nothing)", "missing", ", ".join(self.hints)
                )
        values = {
            k: codec_of(self.hints[k]).decode(v, _child(path, k), storage)
            for k, v in data.items()
        }
        return guarded(lambda: self.kind(**values), path)


@dataclasses.dataclass(frozen=True)
class _Hook:
    """A class that writes and reads itself."""

    kind: type
    write: Callable[[Any], Any]
    read: Callable[[Any], Any]

    def encode(self, value: Any, path: str, storage: Storage) -> Any:
        if not isinstance(value, self.kind):
            raise misfit(
                path, type(value).__name__, "of another type", self.kind.__name__
            )
        return _PLAIN.encode(self.write(value), path, Storage())

    def decode(self, data: Any, path: str, storage: Storage) -> Any:
        return guarded(lambda: self.read(data), path)


_HOOKS: dict[Any, _Hook] = {}
_FLOAT, _PLAIN = _Float(), _Plain()
_PAIR = _Sequence(tuple, (float, float), repeated=False)
_SIMPLE: dict[Any, Codec] = {
    float: _FLOAT,
    complex: _Complex(),
    bytes: _Bytes(),
    Any: _PLAIN,
    object: _PLAIN,
    **{kind: _Scalar(kind) for kind in (bool, int, str, type(None))},
}


def stored_as(
    kind: type, *, write: Callable[[Any], Any], read: Callable[[Any], Any]
) -> None:
    """Let `kind`, which is no plain dataclass, be stored as what `write` returns and
    `read` takes.
    """
    _HOOKS[kind] = _Hook(kind, write, read)


@functools.cache
def codec_of(hint: Any) -> Codec:
    """Return the codec of a type hint; TypeError for a hint that no file can hold."""
    if hint in _HOOKS or hint in _SIMPLE:
        return _HOOKS.get(hint) or _SIMPLE[hint]
    hint = unaliased(hint)
    origin, args = get_origin(hint), get_args(hint)
    if origin is Literal:
        return _Word(args)
    if origin in (Union, types.UnionType):
        return _Choice(args)
    if origin is np.ndarray:
        return _Array(get_args(args[1])[0])
    if origin is tuple:
        repeated = args[1:] == (...,)
        return _Sequence(tuple, args[:1] if repeated else args, repeated=repeated)
    if origin in (list, abc.Sequence):
        return _Sequence(list if origin is list else tuple, args, repeated=True)
    if origin in (dict, abc.Mapping):
        return _Table(*args)
    if isinstance(hint, type) and (
        dataclasses.is_dataclass(hint) or hasattr(hint, "_field_defaults")
    ):
        return _Fields(hint)
    raise TypeError(f"no file can hold a field of type {hint!r}")
