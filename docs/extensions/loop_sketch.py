"""The loop that runs on the arm, drawn without numbers."""

from __future__ import annotations

from fraclink.view._drawing import stand_alone
from fraclink.view._marks import escaped

_SIZE = (652.0, 220.0)


def lettering(
    x: float, y: float, text: str, style: str = "name", anchor: str = "start"
) -> str:
    """A text of the sketch."""
    return f'<text class="{style}" x="{x:g}" y="{y:g}" text-anchor="{anchor}">{escaped(text)}</text>'


def loop_sketch() -> str:
    """Draw the loop: move, correction, motor loop, arm, and the tip angle estimated
    from θm and Γ.
    """
    boxes = (
        (100, "correction", "k_d s^β, filtered"),
        (300, "motor loop", "hold and delay"),
        (462, "arm", "link and payload"),
    )
    parts = [lettering(8, 74, "θt*", "label"), lettering(8, 112, "reference")]
    parts += [_sum(74, 70, "−"), _sum(256, 70, "+")]
    for left, title, below in boxes:
        parts.append(
            f'<rect class="card" x="{left}" y="44" width="126" height="52" rx="7"/>'
        )
        parts.append(lettering(left + 63, 67, title, "label", "middle"))
        parts.append(lettering(left + 63, 85, below, "", "middle"))
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
        lettering(282, 60, "θm*", "label", "middle"),
        lettering(444, 60, "u", "label", "middle"),
    ]
    parts.append(lettering(628, 74, "θt", "label"))
    parts.append('<rect class="card" x="296" y="156" width="296" height="52" rx="7"/>')
    parts.append(
        lettering(444, 179, "estimate of the tip: θm − Γ/c", "label", "middle")
    )
    parts.append(
        lettering(
            444, 197, "sampled every Ts; the gauge is late and noisy", "", "middle"
        )
    )
    parts += [_down(500, 96, 155), _down(550, 96, 155)]
    parts += [
        lettering(492, 130, "θm", "label", "end"),
        lettering(558, 130, "Γ", "label"),
    ]
    parts.append('<path class="c0 d0" d="M296 182H74V86"/>' + _head(74, 80, 0, -1))
    said = "The loop: the motor follows the reference of the tip plus a correction, made of the difference "
    said += (
        "between it and the estimate of the tip; encoder and gauge give the estimate"
    )
    return stand_alone("".join(parts), *_SIZE, said)


def _sum(x: float, y: float, sign: str) -> str:
    return f'<circle class="c0 ring" cx="{x}" cy="{y}" r="10"/>' + lettering(
        x, y + 4, sign, anchor="middle"
    )


def _arrow(x: float, y: float, to: float, down: float) -> str:
    return f'<path class="c0 d0" d="M{x:g} {y:g}L{to:g} {down:g}"/>' + _head(
        to, down, 1, 0
    )


def _down(x: float, y: float, to: float) -> str:
    return f'<path class="c0 d0" d="M{x:g} {y:g}V{to:g}"/>' + _head(x, to, 0, 1)


def _head(x: float, y: float, right: int, down: int) -> str:
    """An arrowhead that points right, down or up."""
    a, b = (
        (x - 7 * right - 4 * down, y - 7 * down - 4 * right),
        (x - 7 * right + 4 * down, y - 7 * down + 4 * right),
    )
    return (
        f'<path class="f0 head" d="M{x:g} {y:g}L{a[0]:g} {a[1]:g}L{b[0]:g} {b[1]:g}z"/>'
    )
