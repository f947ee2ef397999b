"""The file's shape for pydantic, built from the specifications that the nouns carry themselves."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, cast

from fraclink._arm.rig.columns import Channel, LogColumns, OutputKind, check_unit
from fraclink._arm.rig.parts import DesignRequest, Encoder, Gauge, Inner, Link, Motor, Payloads
from fraclink._arm.rig.quantities import NAME, SENTENCE, SOURCE, Quantity, Text, specs
from fraclink.errors import FieldError

if TYPE_CHECKING:
    from pydantic import BaseModel

    from fraclink._arm.link import LinkModel

__all__ = ["FORMAT", "SECTIONS", "ModelTable", "keys_at", "missing_remedy", "rig_arguments", "rig_schema"]

FORMAT = 1  # version of the file format


@dataclass(frozen=True)
class ModelTable:
    """The `[model]` table: what it leaves out follows from the link and the nominal payload."""

    order: Annotated[float, Quantity("order", "", above=1, at_most=2)]
    stiffness: Annotated[float | None, Quantity("stiffness_Nm_per_rad", "N·m/rad", above=0)] = None
    natural_frequency: Annotated[float | None, Quantity("natural_frequency", "s^(-order/2)", above=0)] = None
    damping: Annotated[float, Quantity("damping", "", at_least=0)] = 0.0
    damping_order: Annotated[float, Quantity("damping_order", "", at_least=0, at_most=2)] = 1.0
    payload: Annotated[float | None, Quantity("payload_kg", "kg", above=0)] = None

    def build(self, link: Link, payloads: Payloads) -> LinkModel:
        """The link model, with eq. (5) where the file states no natural frequency."""
        from fraclink._arm.link import LinkModel

        stiffness = self.stiffness or link.stiffness
        payload = self.payload or payloads.nominal
        lumped = math.sqrt(stiffness / (payload * link.length**2))
        return LinkModel(
            stiffness=stiffness,
            natural_frequency=self.natural_frequency or lumped,
            order=self.order,
            damping=self.damping,
            damping_order=self.damping_order,
            payload=payload,
        )


SECTIONS: dict[str, type] = {
    "motor": Motor,
    "link": Link,
    "payloads": Payloads,
    "encoder": Encoder,
    "gauge": Gauge,
    "inner_loop": Inner,
    "model": ModelTable,
    "design": DesignRequest,
}
_REQUIRED = ("motor", "link", "payloads")
_LOG_ROLES = ("time", "motor_angle", "torque", "deflection", "voltage")
_PERIODS = {
    "period_s": Quantity("period_s", "s", above=0, at_most=10),
    "period_ms": Quantity("period_ms", "ms", above=0, at_most=10_000),
}


def keys_at(place: str) -> tuple[str, ...]:
    """The keys that a table of the file may hold."""
    if not place:
        return ("format", "name", "source", *_PERIODS, "assumptions", *SECTIONS, "log")
    if place == "log":
        return _LOG_ROLES
    kind = SECTIONS.get(place, Channel)
    return tuple(spec.key for spec in specs(kind).values()) + (("offset",) if kind is Channel else ())


def missing_remedy(place: str, key: str) -> tuple[str, str]:
    """Allowed range of a key that is missing, and what to write."""
    if place.startswith("log.") and key == "unit":
        return (
            "a unit, such as s, ms, rad, deg, Nm, V",
            f"state the unit in [{place}]: units are never guessed",
        )
    kind = SECTIONS.get(place, Channel if place.startswith("log.") else None)
    known = tuple(specs(kind).values()) if kind else (NAME,)
    spec = next((spec for spec in known if spec.key == key), None)
    if spec is None:
        return (
            "a table",
            f"add [{key}]" if not place else f"add {key} = {{ column = …, unit = … }} to [{place}]",
        )
    return spec.allowed, f"add {key} = … to " + (f"[{place}]" if place else "the top of the file")


def _checked(spec: Quantity | Text) -> Any:
    from pydantic import BeforeValidator

    return Annotated[Any, BeforeValidator(lambda value: spec.check(spec.key, value))]


def _table(kind: type, after: Callable[[dict[str, Any]], object]) -> Any:
    """A pydantic model with the keys of `kind`, whose values are checked by their own specification."""
    fields: dict[str, Any] = {}
    for item in dataclasses.fields(kind):
        if item.name in specs(kind):
            spec = specs(kind)[item.name]
            required = item.default is dataclasses.MISSING
            fields[spec.key] = (_checked(spec), ...) if required else (_checked(spec) | None, None)
    if kind is Channel:
        fields["offset"] = (Any, None)
    return _model(kind.__name__, fields, after)


def _model(name: str, fields: dict[str, Any], after: Callable[[dict[str, Any]], object]) -> Any:
    from pydantic import ConfigDict, create_model, model_validator

    def build(self: BaseModel) -> BaseModel:
        after(stated(self))
        return self

    return create_model(
        name,
        __config__=ConfigDict(extra="forbid", strict=True),
        __validators__={"build": cast(Any, model_validator(mode="after")(build))},
        **fields,
    )


def stated(table: BaseModel) -> dict[str, Any]:
    """The keys that the file states, with their values."""
    return {key: getattr(table, key) for key in type(table).model_fields if key in table.model_fields_set}


def _part(kind: type, table: dict[str, Any]) -> Any:
    names = {spec.key: name for name, spec in specs(kind).items()}
    return kind(**{names.get(key, key): value for key, value in table.items()})


def _log_columns(table: dict[str, Any]) -> LogColumns:
    channels = {role: _part(Channel, stated(channel)) for role, channel in table.items()}
    outputs = [role for role in ("torque", "deflection") if role in channels]
    if len(outputs) != 1:
        raise FieldError(
            "log",
            " and ".join(outputs) or "(no output)",
            "not one output",
            allowed="torque or deflection",
            remedy="state exactly one of log.torque and log.deflection",
        )
    for role, channel in channels.items():
        check_unit(f"log.{role}.unit", role, channel.unit)
    kind: OutputKind = "torque" if "torque" in channels else "deflection"
    return LogColumns(
        channels["time"], channels["motor_angle"], channels[kind], kind, channels.get("voltage")
    )


def _check_top(table: dict[str, Any]) -> None:
    periods = [key for key in _PERIODS if key in table]
    if len(periods) != 1:
        raise FieldError(
            "period_ms" if not periods else periods[0],
            "(nothing)" if not periods else table[periods[0]],
            "missing" if not periods else "given twice, as period_s and as period_ms",
            allowed="one sampling period",
            remedy="state the control period as period_ms = … or period_s = …",
        )


@functools.cache
def rig_schema() -> type[BaseModel]:
    """The pydantic model of a rig file; made once, on first use (pydantic costs 0.1 s to import)."""
    channel = _table(Channel, lambda table: _part(Channel, table))
    roles = {
        role: (channel, ...) if role in ("time", "motor_angle") else (channel, None) for role in _LOG_ROLES
    }
    sentence: Any = _checked(SENTENCE)
    fields: dict[str, Any] = {
        "format": (_checked(Quantity("format", at_least=FORMAT, at_most=FORMAT, integer=True)), FORMAT),
        "name": (_checked(NAME), ...),
        "source": (_checked(SOURCE), ""),
        "assumptions": (list[sentence], []),
        "log": (_model("Log", roles, _log_columns), None),
    }
    fields |= {key: (_checked(spec), None) for key, spec in _PERIODS.items()}
    for section, kind in SECTIONS.items():
        table = _table(kind, functools.partial(_part, kind))
        fields[section] = (table, ... if section in _REQUIRED else None)
    made: type[BaseModel] = _model("RigFile", fields, _check_top)
    return made


def rig_arguments(table: BaseModel) -> dict[str, Any]:
    """What the constructor of a rig takes, from a checked file."""
    data = stated(table)
    parts = {
        section: _part(kind, stated(data[section])) for section, kind in SECTIONS.items() if section in data
    }
    if "model" in parts:
        parts["model"] = parts["model"].build(parts["link"], parts["payloads"])
    if "inner_loop" in parts:
        parts["inner"] = parts.pop("inner_loop")
    if "log" in data:
        parts["log"] = _log_columns(stated(data["log"]))
    period = data["period_s"] if "period_s" in data else data["period_ms"] / 1000
    texts = {key: data[key] for key in ("name", "source", "assumptions") if key in data}
    return parts | texts | {"period": period}
