"""Two drawings without numbers: the arm with its signals, and the loop that runs on it."""

from __future__ import annotations

import math

import numpy as np

from fraclink.view._drawing import stand_alone
from fraclink.view._marks import escaped

__all__ = ["arm_sketch", "loop_sketch"]

_ARM = (425.0, 214.0)
_LOOP = (652.0, 220.0)


def _link(length: float, turned: float, bend: float) -> list[tuple[float, float]]:
    """A bent link from the hub's edge: points of a cantilever's first shape, turned by
    the motor's angle.
    """
    places = np.linspace(0.0, 1.0, 25)
    # w(x) = x² (3L − x)/2, scaled to 1 at the tip: a cantilever with a force at its
    # end, which is how a payload bends a massless link.
    away = bend * places**2 * (3 - places) / 2
    c, s = math.cos(turned), math.sin(turned)
    x, y = length * places, length * away
    return [
        (float(c * a - s * b), float(-(s * a + c * b)))
        for a, b in zip(x, y, strict=True)
    ]


def _text(
    x: float, y: float, text: str, style: str = "name", anchor: str = "start"
) -> str:
    return f'<text class="{style}" x="{x:g}" y="{y:g}" text-anchor="{anchor}">{escaped(text)}</text>'


def _arc(x: float, y: float, radius: float, end: float) -> str:
    """An arc from the horizontal up to an angle [rad]."""
    tip = f"{x + radius * math.cos(end):.1f} {y - radius * math.sin(end):.1f}"
    return f'<path class="c0 d0" d="M{x + radius:g} {y:g}A{radius:g} {radius:g} 0 0 0 {tip}"/>'


def arm_sketch(notes: tuple[str, str, str] = ("", "", "")) -> str:
    """Draw hub, link, payload and gauge from above, with θm, θt and Γ; notes: of motor,
    gauge and payload.
    """
    # Bent against the turn, as at the start of a move: the tip lags behind the motor,
    # θt < θm. Bend and angle are larger than life, to be told apart at this size.
    x, y, length, turned, bend = 70.0, 158.0, 300.0, math.radians(26), -0.16
    points = [(x + a, y + b) for a, b in _link(length, turned, bend)]
    tip = points[-1]
    line = "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in points)
    stiff = f"{x + length * math.cos(turned):.1f} {y - length * math.sin(turned):.1f}"
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
        _arc(x, y, 140.0, turned),
        _arc(x, y, 196.0, chord),
        _text(x + 145, y - 12, "θm", "label"),
        _text(x + 201, y - 12, "θt", "label"),
        _text(
            8, y + 44, f"motor and encoder: {notes[0] or 'voltage u in, angle θm out'}"
        ),
        _text(8, 58, f"strain gauge: torque Γ{notes[1] and ', ' + notes[1]}"),
        f'<path class="c0 d0" d="M78 66L{gauge[0]:.1f} {gauge[1] - 9:.1f}"/>',
        _text(
            tip[0] + 56,
            tip[1] + 38,
            f"payload m{notes[2] and ': ' + notes[2]}",
            anchor="end",
        ),
    ]
    said = "A flexible arm from above: hub at θm, bent link with a gauge at its root, payload at θt"
    return _drawn("".join(parts), _ARM, said)


def loop_sketch() -> str:
    """Draw the loop: move, correction, motor loop, arm, and the tip angle estimated
    from θm and Γ.
    """
    boxes = (
        (100, "correction", "k_d s^β, filtered"),
        (300, "motor loop", "hold and delay"),
        (462, "arm", "link and payload"),
    )
    parts = [_text(8, 74, "θt*", "label"), _text(8, 112, "reference")]
    parts += [_sum(74, 70, "−"), _sum(256, 70, "+")]
    for left, title, below in boxes:
        parts.append(
            f'<rect class="card" x="{left}" y="44" width="126" height="52" rx="7"/>'
        )
        parts.append(_text(left + 63, 67, title, "label", "middle"))
        parts.append(_text(left + 63, 85, below, "", "middle"))
    for start, end in (
        (36, 64),
        (84, 99),
        (227, 246),
        (266, 299),
        (427, 461),
        (589, 622),
    ):
        parts.append(_arrow(start, 70, end, 70))
    parts.append('<path class="c0 d0" d="M50 70V16H256V54"/>' + _head(256, 60, 0, 1))
    parts.append('<circle class="f0" cx="50" cy="70" r="2.5"/>')
    parts += [
        _text(282, 60, "θm*", "label", "middle"),
        _text(444, 60, "u", "label", "middle"),
    ]
    parts.append(_text(628, 74, "θt", "label"))
    parts.append('<rect class="card" x="296" y="156" width="296" height="52" rx="7"/>')
    parts.append(_text(444, 179, "estimate of the tip: θm − Γ/c", "label", "middle"))
    parts.append(
        _text(444, 197, "sampled every Ts; the gauge is late and noisy", "", "middle")
    )
    parts += [_down(500, 96, 155), _down(550, 96, 155)]
    parts += [_text(492, 130, "θm", "label", "end"), _text(558, 130, "Γ", "label")]
    parts.append('<path class="c0 d0" d="M296 182H74V86"/>' + _head(74, 80, 0, -1))
    said = "The loop: the motor follows the reference of the tip plus a correction, made of the difference "
    said += (
        "between it and the estimate of the tip; encoder and gauge give the estimate"
    )
    return _drawn("".join(parts), _LOOP, said)


def _sum(x: float, y: float, sign: str) -> str:
    return f'<circle class="c0 ring" cx="{x}" cy="{y}" r="10"/>' + _text(
        x, y + 4, sign, anchor="middle"
    )


def _arrow(x: float, y: float, to: float, down: float) -> str:
    return f'<path class="c0 d0" d="M{x:g} {y:g}L{to:g} {down:g}"/>' + _head(
        to, down, 1, 0
    )


def _down(x: float, y: float, to: float) -> str:
    return f'<path class="c0 d0" d="M{x:g} {y:g}V{to:g}"/>' + _head(x, to, 0, 1)


def _head(x: float, y: float, right: int, down: int) -> str:
    """The head of an arrow that points right, down or up."""
    a, b = (
        (x - 7 * right - 4 * down, y - 7 * down - 4 * right),
        (x - 7 * right + 4 * down, y - 7 * down + 4 * right),
    )
    return (
        f'<path class="f0 head" d="M{x:g} {y:g}L{a[0]:g} {a[1]:g}L{b[0]:g} {b[1]:g}z"/>'
    )


def _drawn(parts: str, size: tuple[float, float], said: str) -> str:
    return stand_alone(parts, *size, said)
