"""A rig as the text of a TOML file that reads back equal, whatever its texts contain."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from fraclink._arm.rig.columns import Channel
from fraclink._arm.rig.parts import DesignRequest
from fraclink._arm.rig.quantities import specs
from fraclink._arm.rig.schema import FORMAT, ModelTable

if TYPE_CHECKING:
    from fraclink._arm.rig.rig import Rig

__all__ = ["rig_text", "toml_value"]

_ESCAPES = {'"': '\\"', "\\": "\\\\", "\n": "\\n", "\t": "\\t", "\r": "\\r"}


def rig_text(rig: Rig) -> str:
    """The rig file of `rig`: SI units, shortest numbers that read back to the same bits."""
    from fraclink import __version__

    lines = [f"# Written by fraclink {__version__}.", f"format = {FORMAT}", f"name = {toml_value(rig.name)}"]
    if rig.source:
        lines.append(f"source = {toml_value(rig.source)}")
    lines += [f"period_s = {toml_value(rig.period)}", "assumptions = [", *_sentences(rig.assumptions), "]"]
    sections: dict[str, Any] = {
        "motor": rig.motor,
        "link": rig.link,
        "payloads": rig.payloads,
        "encoder": rig.encoder,
        "gauge": rig.gauge,
        "inner_loop": rig.inner,
    }
    for section, part in sections.items():
        lines += ["", f"[{section}]", *_pairs(part, type(part))]
    if rig.model is not None:
        lines += ["", "[model]", *_pairs(rig.model, ModelTable)]
    if rig.design is not None:
        lines += ["", "[design]", *_pairs(rig.design, DesignRequest)]
    if rig.log is not None:
        for role, channel in rig.log.channels().items():
            offset = f"offset = {toml_value(channel.offset)}"
            lines += ["", f"[log.{role}]", *_pairs(channel, Channel), offset]
    return "\n".join(lines) + "\n"


def _sentences(sentences: tuple[str, ...]) -> list[str]:
    return [f"  {toml_value(sentence)}," for sentence in sentences]


def _pairs(part: Any, kind: type) -> list[str]:
    pairs = {spec.key: getattr(part, name) for name, spec in specs(kind).items()}
    return [
        f"{key} = {toml_value(value)}"
        for key, value in pairs.items()
        if value is not None and value != math.inf
    ]


def toml_value(value: float | int | str) -> str:
    """A number or text as TOML writes it; texts hold no character that ends a string or a line."""
    if isinstance(value, str):
        return '"' + "".join(_escaped(c) for c in value) + '"'
    return repr(value)


def _escaped(character: str) -> str:
    if character in _ESCAPES:
        return _ESCAPES[character]
    # Control characters, and what TOML readers or editors treat as a line end, are escaped by number.
    if character.isprintable():
        return character
    return f"\\u{ord(character):04X}" if ord(character) < 0x10000 else f"\\U{ord(character):08X}"
