"""A law as JSON: reals are hex floats, so that what was designed is what is read back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields
from typing import TYPE_CHECKING, Any

from fraclink.errors import FileFormatError
from fraclink.law.limits import Limits
from fraclink.motor import DiscreteInnerLoop

if TYPE_CHECKING:
    from fraclink.law.law import Law

__all__ = ["from_json", "to_json"]


def _hexed(value: Any) -> Any:
    if isinstance(value, bool) or value is None or isinstance(value, int | str):
        return value
    if isinstance(value, float):
        return value.hex()
    if isinstance(value, complex):
        return [value.real.hex(), value.imag.hex()]
    if isinstance(value, Mapping):
        return {key: _hexed(item) for key, item in value.items()}
    return [_hexed(item) for item in value]


def to_json(law: Law) -> dict[str, Any]:
    """Return the law as plain JSON values, with the digest of its block."""
    return {
        "sha256": law.digest,
        "period": law.period.hex(),
        "precision": law.precision,
        "stiffness": law.stiffness.hex(),
        "correction": _hexed(law.correction._asdict()),
        "feedforward": _hexed(law.feedforward._asdict()),
        "inner_pole": law.inner_pole.hex(),
        "limits": _hexed(asdict(law.limits)),
        "drive": None if law.drive is None else _hexed(asdict(law.drive)),
        "correction_error": _hexed(law.correction_error),
        "feedforward_error": _hexed(law.feedforward_error),
        "band": _hexed(law.band),
    }


def from_json(data: Mapping[str, Any]) -> Law:
    """Return the law of `to_json`; FileFormatError names the first field that does not fit."""
    from fraclink.law.law import Drive, Law, Modes

    def real(field: str, value: object) -> float:
        try:
            if isinstance(value, str):
                return float.fromhex(value)
        except (ValueError, OverflowError):
            pass
        raise FileFormatError(
            field, value, "not a hex float", allowed="0x1.8p+1", remedy="make the file again"
        )

    def pair(field: str, value: object) -> tuple[float, float]:
        if not isinstance(value, list) or len(value) != 2:
            raise FileFormatError(
                field, value, "not two numbers", allowed="[a, b]", remedy="make the file again"
            )
        return real(field, value[0]), real(field, value[1])

    def modes(field: str) -> Modes:
        given = data[field]
        return Modes(
            real(f"{field}.direct", given["direct"]),
            tuple(real(f"{field}.poles", x) for x in given["poles"]),
            tuple(real(f"{field}.gains", x) for x in given["gains"]),
            tuple(complex(*pair(f"{field}.pair_poles", x)) for x in given["pair_poles"]),
            tuple(complex(*pair(f"{field}.pair_gains", x)) for x in given["pair_gains"]),
        )

    def drive() -> Drive | None:
        given = data["drive"]
        if given is None:
            return None
        loop = {
            f.name: real(f"drive.loop.{f.name}", given["loop"][f.name]) for f in fields(DiscreteInnerLoop)
        }
        names = ("voltage_limit", "torque_voltage", "coulomb_voltage", "coulomb_speed")
        return Drive(DiscreteInnerLoop(**loop), *(real(f"drive.{name}", given[name]) for name in names))

    try:
        return Law(
            period=real("period", data["period"]),
            precision=data["precision"],
            stiffness=real("stiffness", data["stiffness"]),
            correction=modes("correction"),
            feedforward=modes("feedforward"),
            inner_pole=real("inner_pole", data["inner_pole"]),
            limits=_limits(data["limits"], real),
            drive=drive(),
            correction_error=pair("correction_error", data["correction_error"]),
            feedforward_error=pair("feedforward_error", data["feedforward_error"]),
            band=pair("band", data["band"]),
        )
    except (KeyError, TypeError) as error:
        raise FileFormatError(
            "law",
            str(error),
            "missing or of the wrong kind",
            allowed="a file of Law.save",
            remedy="make it again",
        ) from error


def _limits(given: Mapping[str, Any], real: Any) -> Limits:
    counts = {"bad_limit", "missed_limit", "residual_limit", "stuck_limit"}
    values: dict[str, Any] = {}
    for field in fields(Limits):
        value = given[field.name]
        if field.name in counts:
            if not isinstance(value, int) or isinstance(value, bool):
                raise FileFormatError(
                    f"limits.{field.name}",
                    value,
                    "not a count",
                    allowed="0, 1, ...",
                    remedy="make the file again",
                )
            values[field.name] = value
        else:
            values[field.name] = real(f"limits.{field.name}", value)
    return Limits(**values)
