"""Designs on disk: one JSON object that reads back equal."""

from __future__ import annotations

from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fraclink._arm.controller import Controller
from fraclink._arm.motor_loop import MotorLoop
from fraclink._files import read_json, write_json
from fraclink.errors import FieldError, FileFormatError
from fraclink.findings import Finding

if TYPE_CHECKING:
    from fraclink._arm.link import LinkModel
    from fraclink._design.specification import Design, Requirement

__all__ = ["controller_from", "load_plan", "save_plan"]

KIND, FORMAT = "design", 2
_WITHOUT_LEAD = 1  # the format of 0.1, whose controllers have no lead


def save_plan(design: Design, path: Path) -> None:
    """Write `design` to `path` in one step."""
    write_json(
        path,
        KIND,
        FORMAT,
        {
            "period": design.rig.period,
            "rig": design.rig.to_toml(),
            "model": asdict(design.model),
            "controller": asdict(design.controller),
            "margins_kind": design.margins_kind,
            "payloads": list(design.payloads),
            "natural_frequencies": list(design.natural_frequencies),
            "gain_crossover": design.gain_crossover,
            "phase_margin": design.phase_margin,
            "chi": design.chi,
            "gain_crossover_upper": design.gain_crossover_upper,
            "requirements": [asdict(requirement) for requirement in design.requirements],
            "findings": [
                {
                    "code": f.code,
                    "severity": f.severity,
                    "message": f.message,
                    "evidence": dict(f.evidence),
                    "remedy": f.remedy,
                }
                for f in design.findings
            ],
        },
    )


_FIELDS = {
    "rig",
    "model",
    "controller",
    "margins_kind",
    "payloads",
    "natural_frequencies",
    "gain_crossover",
    "phase_margin",
    "chi",
    "gain_crossover_upper",
    "requirements",
    "findings",
}


def load_plan(path: Path) -> Design:
    """Read a design that `save_plan` wrote; the controller and the model check their own values again."""
    from fraclink._arm.rig import Rig
    from fraclink._design.specification import Design

    data = read_json(path, KIND, (_WITHOUT_LEAD, FORMAT))
    missing = sorted(_FIELDS - data.keys())
    if missing:
        raise FileFormatError(
            "file", str(path), f"without {missing[0]!r}", allowed="a design file", remedy="make it again"
        )
    try:
        return Design(
            model=link_from(data["model"]),
            rig=Rig.from_toml(_text(data["rig"])),
            controller=controller_from(data["controller"]),
            requirements=tuple(_requirement(item) for item in data["requirements"]),
            margins_kind=data["margins_kind"],
            payloads=_pair(data["payloads"]),
            natural_frequencies=_pair(data["natural_frequencies"]),
            gain_crossover=float(data["gain_crossover"]),
            phase_margin=float(data["phase_margin"]),
            chi=float(data["chi"]),
            gain_crossover_upper=float(data["gain_crossover_upper"]),
            findings=tuple(Finding(**known(Finding, item)) for item in data["findings"]),
        )
    except (TypeError, KeyError, AttributeError) as error:
        raise FileFormatError(
            "file", str(path), f"damaged ({error})", allowed="a design file", remedy="make it again"
        ) from error


def _text(text: object) -> str:
    if not isinstance(text, str):
        raise FileFormatError("rig", text, "not text", allowed="a rig in TOML", remedy="make the file again")
    return text


def _pair(value: object) -> tuple[float, float]:
    if not isinstance(value, list) or len(value) != 2:
        raise FileFormatError(
            "range", value, "not a pair", allowed="two numbers", remedy="make the file again"
        )
    return float(value[0]), float(value[1])


def known(kind: type, item: object) -> dict[str, Any]:
    """`item` as keyword arguments of the dataclass `kind`; an unknown or missing key is an error."""
    names = {field.name for field in fields(kind)}
    if not isinstance(item, dict) or set(item) != names:
        extra = sorted(set(item) ^ names) if isinstance(item, dict) else [type(item).__name__]
        raise FieldError(
            kind.__name__,
            extra[0],
            "not as expected",
            allowed=", ".join(sorted(names)),
            remedy="make it again",
        )
    return dict(item)


def link_from(item: object) -> LinkModel:
    """A link model from the dictionary that `save_plan` wrote."""
    from fraclink._arm.link import LinkModel, SecondMode

    # Files of 0.1 state neither gauge nor second mode.
    unstated = {"gauge_delay": 0.0, "gauge_gain": 1.0, "second_mode": None, "unseen_up_to": None}
    values = known(LinkModel, {**unstated, "intervals": (), **item} if isinstance(item, dict) else item)
    if values["second_mode"] is not None:
        values["second_mode"] = SecondMode(**known(SecondMode, values["second_mode"]))
    return LinkModel(**values)


def _requirement(item: Any) -> Requirement:
    """A requirement; files of 0.1 state its slack and verdict in place of its direction."""
    from fraclink._design.specification import Requirement

    if "bound" in item:
        return Requirement(**known(Requirement, item))
    upwards = (item["achieved"] - item["wanted"]) * item["slack"] >= 0.0
    values = {key: item[key] for key in ("name", "wanted", "achieved", "unit", "at_payload")}
    return Requirement(**values, bound="at least" if upwards else "at most")


def controller_from(item: object) -> Controller:
    """A controller from the dictionary that `save_plan` wrote; a lead of 0.1 is not run any more."""
    values = {key: value for key, value in dict(item).items() if key != "lead" or value is not None}  # type: ignore[call-overload]
    values = known(Controller, values)
    if values["link"] is not None:
        values["link"] = link_from(values["link"])
    if values["inner"] is not None:
        values["inner"] = MotorLoop(**known(MotorLoop, values["inner"]))
    return Controller(**values)
