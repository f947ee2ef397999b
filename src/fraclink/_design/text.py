"""A design in a few lines, as `print` shows it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fraclink._design.plan import Design

__all__ = ["plan_text"]


def plan_text(design: Design) -> str:
    """Return controller, requirements and findings of a design."""
    lines = [f'{design.controller.formula}; margins of the "{design.margins_kind}" loop']
    for item in design.requirements:
        told = [math.degrees(x) if item.unit == "rad" else x for x in (item.wanted, item.achieved)]
        unit = "°" if item.unit == "rad" else f" {item.unit}".rstrip()
        at = "" if item.at_payload is None else f" at {1e3 * item.at_payload:g} g"
        verdict = "passed" if item.passed else "MISSED"
        lines.append(f"{item.name}: wanted {told[0]:.5g}{unit}, achieved {told[1]:.5g}{unit}{at}, {verdict}")
    return "\n".join([*lines, *map(str, design.findings)])
