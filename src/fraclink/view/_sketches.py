"""A schematic drawing of the arm with its signals."""

from __future__ import annotations

from fraclink._arm.rig import Rig
from fraclink.view._drawing import figure_of, stand_alone
from fraclink.view._marks import escaped
from fraclink.view._pages import template_text
from fraclink.view._words import sketch_notes

__all__ = ["arm_sketch"]


def arm_sketch(notes: tuple[str, str, str] = ("", "", "")) -> str:
    """Draw hub, link, payload and gauge from above, with θm, θt and Γ; notes: of motor,
    gauge and payload.

    The link is bent against the rotation as at the start of a move, by a cantilever's
    deflection under a force at its tip, exaggerated to be seen at this size.
    """
    motor, gauge, payload = map(escaped, notes)
    body = template_text("arm_sketch.svg").format(
        motor=motor or "voltage u in, angle θm out",
        gauge=gauge and f", {gauge}",
        payload=payload and f": {payload}",
    )
    description = "A flexible arm from above: hub at θm, bent link with a gauge at its root, payload at θt"
    return stand_alone(body.replace("\n", ""), 425.0, 214.0, description)


@figure_of.register
def _rig(rig: Rig) -> str:
    return arm_sketch(sketch_notes(rig, rig.model))
