"""A law as JSON: reals are hex floats, so that what was designed is what is read back."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

from fraclink._arm.motor import DiscretePid
from fraclink._law.limits import Limits
from fraclink._law.nouns import Drive, Modes
from fraclink.errors import FileFormatError

__all__ = ["arguments_of", "as_json"]

_COUNTS = {"bad_limit", "missed_limit", "residual_limit", "stuck_limit", "frozen_limit", "block_limit"}


def as_json(value: Any) -> Any:
    """Return a law, or a part of one, as plain JSON values."""
    if isinstance(value, bool) or value is None or isinstance(value, int | str):
        return value
    if isinstance(value, float):
        return value.hex()
    if isinstance(value, complex):
        return [value.real.hex(), value.imag.hex()]
    if is_dataclass(value):
        return {field.name: as_json(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Modes):
        return {name: as_json(item) for name, item in value._asdict().items()}
    return [as_json(item) for item in value]


def arguments_of(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of `Law` from `as_json`; FileFormatError names the first field that does not
    fit.
    """
    try:
        return {
            "period": _real("period", data["period"]),
            "precision": data["precision"],
            "stiffness": _real("stiffness", data["stiffness"]),
            "correction": _modes("correction", data["correction"]),
            "feedforward": _modes("feedforward", data["feedforward"]),
            "inner_pole": _real("inner_pole", data["inner_pole"]),
            "limits": _limits(data["limits"]),
            "drive": None if data["drive"] is None else _drive(data["drive"]),
            "correction_error": _pair("correction_error", data["correction_error"]),
            "feedforward_error": _pair("feedforward_error", data["feedforward_error"]),
            "band": _pair("band", data["band"]),
        }
    except (KeyError, TypeError) as error:
        raise FileFormatError(
            "law",
            str(error),
            "missing or of the wrong kind",
            allowed="a file of Law.save",
            remedy="make it again",
        ) from error


def _real(field: str, value: object) -> float:
    if isinstance(value, str):
        with contextlib.suppress(ValueError, OverflowError):
            return float.fromhex(value)
    raise FileFormatError(field, value, "not a hex float", allowed="0x1.8p+1", remedy="make the file again")


def _pair(field: str, value: object) -> tuple[float, float]:
    if not isinstance(value, list) or len(value) != 2:
        raise FileFormatError(field, value, "not two numbers", allowed="[a, b]", remedy="make the file again")
    return _real(field, value[0]), _real(field, value[1])


def _modes(field: str, given: Mapping[str, Any]) -> Modes:
    return Modes(
        _real(f"{field}.direct", given["direct"]),
        tuple(_real(f"{field}.poles", x) for x in given["poles"]),
        tuple(_real(f"{field}.gains", x) for x in given["gains"]),
        tuple(complex(*_pair(f"{field}.pair_poles", x)) for x in given["pair_poles"]),
        tuple(complex(*_pair(f"{field}.pair_gains", x)) for x in given["pair_gains"]),
    )


def _drive(given: Mapping[str, Any]) -> Drive:
    names = [field.name for field in fields(DiscretePid)]
    loop = DiscretePid(**{name: _real(f"drive.loop.{name}", given["loop"][name]) for name in names})
    names = [field.name for field in fields(Drive) if field.name != "loop"]
    return Drive(loop, **{name: _real(f"drive.{name}", given[name]) for name in names})


def _limits(given: Mapping[str, Any]) -> Limits:
    values: dict[str, Any] = {}
    for field in fields(Limits):
        value = given[field.name]
        if field.name not in _COUNTS:
            values[field.name] = _real(f"limits.{field.name}", value)
        elif isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 2**31:
            values[field.name] = value
        else:
            raise FileFormatError(
                f"limits.{field.name}",
                value,
                "not a count",
                allowed="0 to 2147483647",
                remedy="make the file again",
            )
    return Limits(**values)
