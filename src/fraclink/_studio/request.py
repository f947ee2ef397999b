"""What a page asks of a design: the options of `fraclink design`, under their names and with their ranges."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, get_type_hints

from fraclink._design import Specification
from fraclink._validate import PhaseMarginDeg
from fraclink._validate.rules import rule
from fraclink.errors import FieldError

__all__ = ["NAMES", "as_command", "as_python", "checked_request", "wanted_of"]

# Every option has the range that the library states for it; the command line gives the margin in degrees.
_HINTS: dict[str, Any] = {
    name: hint
    for name, hint in get_type_hints(Specification, include_extras=True).items()
    if name not in ("phase_margin", "natural_frequencies")
} | {"phase_margin_deg": Annotated[PhaseMarginDeg | None, ""], "box": bool}
NAMES = tuple(_HINTS)
_USUAL = {"margins": "loop", "inner": "ideal", "placement": "tustin", "box": False}
_FLAGS = ("box",)


def checked_request(given: object) -> dict[str, Any]:
    """Return what a page asked for, every option present; None leaves one to the rig or to its rule.

    Raises FieldError for a name that `fraclink design` does not have, and for a value out of its range.

    >>> checked_request({"gain_crossover": 12, "payloads": [0.02, 0.04]})["payloads"]
    (0.02, 0.04)
    """
    if not isinstance(given, Mapping):
        allowed, remedy = "an object of options", "send the options by name"
        raise FieldError("state", type(given).__name__, "not an object", allowed=allowed, remedy=remedy)
    for name in given:
        if name not in _HINTS:
            allowed, remedy = ", ".join(NAMES), "leave it out"
            raise FieldError("state", str(name), "unknown option", allowed=allowed, remedy=remedy)
    found = {}
    for name, hint in _HINTS.items():
        value = given.get(name)
        if isinstance(value, list):
            value = tuple(value)
        found[name] = _USUAL.get(name) if value is None else rule(hint).check(name, value)
    return found


def wanted_of(request: Mapping[str, Any]) -> dict[str, Any]:
    """Return the request as `design_for` takes it: the margin in radians, the box only where it is wanted."""
    margin = request["phase_margin_deg"]
    rest = {name: value for name, value in request.items() if name not in ("phase_margin_deg", "box")}
    return rest | {"phase_margin": None if margin is None else math.radians(margin), "box": request["box"]}


def as_command(request: Mapping[str, Any], rig: str, model: Path | None, out: Path) -> str:
    """Return the command that makes the design of `request`, byte for byte."""
    words = ["fraclink", "design", "--rig", rig]
    if model is not None:
        words += ["--model", str(model)]
    for name, value in request.items():
        if value is None or value == _USUAL.get(name):
            continue
        words.append(f"--{name.replace('_', '-')}")
        if name not in _FLAGS:
            words += map(_plain, value if isinstance(value, tuple) else (value,))
    return shlex.join([*words, "--out", str(out)])


def as_python(request: Mapping[str, Any], rig: str, model: Path | None) -> str:
    """Return the lines of Python that make the same design, with the completions of the rig."""
    by_file = rig.endswith(".toml")
    lines = ["import fraclink as fl", ""]
    lines.append(f"rig = fl.Rig.load({rig!r})" if by_file else f"rig = fl.Rig.named({rig!r})")
    link = "rig.model" if model is None else "fit"
    if model is not None:
        lines.append(f"fit = fl.load({str(model)!r})")
    lines += ["design = fl.design(", f"    {link}, rig,"]
    for name, value in request.items():
        if value is None or value == _USUAL.get(name):
            continue
        if name == "phase_margin_deg":
            lines.append(f"    phase_margin=fl.deg({_plain(value)}),")
        else:
            lines.append(f"    {name}={value!r},")
    return "\n".join([*lines, "    law=False,", ").with_law()", "law = fl.discretize(design)"])


def _plain(value: object) -> str:
    return repr(value) if isinstance(value, float) else str(value)
