"""A schematic drawing of the arm with its signals."""

from __future__ import annotations

import math

import numpy as np

from fraclink._arm.rig import Rig
from fraclink.view._drawing import figure_of, stand_alone
from fraclink.view._marks import escaped
from fraclink.view._words import sketch_notes

__all__ = ["arm_sketch", "lettering"]

_ARM = (425.0, 214.0)


def _link(length: float, turned: float, bend: float) -> list[tuple[float, float]]:
    """A bent link from the edge of the hub: points of a cantilever's deflection,
    rotated by the motor angle.
    """
    places = np.linspace(0.0, 1.0, 25)
    # w(x) = x² (3L − x)/2, scaled to 1 at the tip: a cantilever with a force at its
    # end, the deflection of a massless link under a payload.
    away = bend * places**2 * (3 - places) / 2
    c, s = math.cos(turned), math.sin(turned)
    x, y = length * places, length * away
    return [
        (float(c * a - s * b), float(-(s * a + c * b)))
        for a, b in zip(x, y, strict=True)
    ]


def lettering(
    x: float, y: float, text: str, style: str = "name", anchor: str = "start"
) -> str:
    """A text of a sketch."""
    return f'<text class="{style}" x="{x:g}" y="{y:g}" text-anchor="{anchor}">{escaped(text)}</text>'


def _arc(x: float, y: float, radius: float, end: float) -> str:
    """An arc from the horizontal up to an angle [rad]."""
    tip = f"{x + radius * math.cos(end):.1f} {y - radius * math.sin(end):.1f}"
    return f'<path class="c0 d0" d="M{x + radius:g} {y:g}A{radius:g} {radius:g} 0 0 0 {tip}"/>'


def arm_sketch(notes: tuple[str, str, str] = ("", "", "")) -> str:
    """Draw hub, link, payload and gauge from above, with θm, θt and Γ; notes: of motor,
    gauge and payload.
    """
    # Bent against the rotation, as at the start of a move: the tip lags behind the
    # motor, θt < θm. Deflection and angle are exaggerated, so that they are visible at
    # this size.
    x, y, length, angle, bend = 70.0, 158.0, 300.0, math.radians(26), -0.16
    points = [(x + a, y + b) for a, b in _link(length, angle, bend)]
    tip = points[-1]
    line = "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in points)
    stiff = f"{x + length * math.cos(angle):.1f} {y - length * math.sin(angle):.1f}"
    chord = math.atan2(y - tip[1], tip[0] - x)
    root, gauge, out = points[2], points[3], points[5]
    parts = [
        f'<path class="w c0" d="M{x} {y}h335"/>',
        f'<path class="w c0" d="M{x} {y}L{stiff}"/>',
        f'<path class="w c0" d="M{x} {y}L{tip[0]:.1f} {tip[1]:.1f}"/>',
        f'<path class="beam" d="{line}"/>',
        f'<circle class="f0" cx="{x}" cy="{y}" r="25"/><circle class="ground" cx="{x}" cy="{y}" r="5"/>',
        f'<circle class="f2" cx="{tip[0]:.1f}" cy="{tip[1]:.1f}" r="12"/>',
        f'<path class="strain" d="M{root[0]:.1f} {root[1]:.1f}L{out[0]:.1f} {out[1]:.1f}"/>',
        _arc(x, y, 140.0, angle),
        _arc(x, y, 196.0, chord),
        lettering(x + 145, y - 12, "θm", "label"),
        lettering(x + 201, y - 12, "θt", "label"),
        lettering(
            8, y + 44, f"motor and encoder: {notes[0] or 'voltage u in, angle θm out'}"
        ),
        lettering(8, 58, f"strain gauge: torque Γ{notes[1] and ', ' + notes[1]}"),
        f'<path class="c0 d0" d="M78 66L{gauge[0]:.1f} {gauge[1] - 9:.1f}"/>',
        lettering(
            tip[0] + 56,
            tip[1] + 38,
            f"payload m{notes[2] and ': ' + notes[2]}",
            anchor="end",
        ),
    ]
    description = "A flexible arm from above: hub at θm, bent link with a gauge at its root, payload at θt"
    return stand_alone("".join(parts), *_ARM, description)


@figure_of.register
def _rig(rig: Rig) -> str:
    return arm_sketch(sketch_notes(rig, rig.model))
