"""Draw the README's animation: `python tools/make_animation.py`.

docs/_static/arm.svg: the bundled arm with 30 g moves by 60° and back, on the twin with
a link of 7.35 g: on the left under its motor's own PID, on the right under the law that
is shipped; before the move back both lose their strain gauge. Every tip and every motor
is a sample of such a run; the bow between them is drawn twice as deep. A viewer
interpolates between samples 40 ms apart. A single file without a script, for light and
dark pages; with the system setting for reduced motion it is static.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

import fraclink as fl
from fraclink._files import write_text
from fraclink._law import MODES
from fraclink._simulate import SensorFault, Twin
from fraclink.trials._rivals import motor_alone

PLACE = Path(__file__).resolve().parents[1] / "docs" / "_static" / "arm.svg"
WIDTH, HEIGHT, LENGTH = 860, 330, 205  # LENGTH: length of the link in pixels
HUB = HEIGHT - 66  # below the top
MOVE = math.radians(60)
END, LOST = 4.0, 1.6  # [s]
STEP = 10  # periods between two samples of the drawing
BAND = math.radians(1.2)  # within 2 % of the move

STYLE = """
text { font: 14px system-ui, "Segoe UI", "Noto Sans", Helvetica, Arial, sans-serif; fill: #565f6d; }
.big { font-weight: 600; font-size: 16px; } .alone .big { fill: #a03b7a; } .ours .big { fill: #1c5d8c; }
.warn { fill: #8a5300; font-weight: 600; }
.arc { fill: none; stroke: #d5d2c8; stroke-width: 1.5; }
.goal { stroke: #1d2430; stroke-width: 3; stroke-linecap: round; }
.ghost { fill: none; stroke: #6d7480; stroke-width: 1.5; stroke-dasharray: 7 6; }
.link { fill: none; stroke: #1c5d8c; stroke-width: 9; stroke-linecap: round; } .alone .link { stroke: #a03b7a; }
.shine { fill: none; stroke: #fff; stroke-opacity: .55; stroke-width: 1.5; }
.load { fill: #c2570c; } .hub { fill: #8d949e; stroke: #4a515c; stroke-width: 2; } .axis { fill: #fff; }
.still { display: none; }
@media (prefers-reduced-motion: reduce) { .moving { display: none; } .still { display: inline; } }
@media (prefers-color-scheme: dark) { text { fill: #a3adbb; }
.alone .big { fill: #e070b4; } .ours .big { fill: #5fb4ec; }
.warn { fill: #f0b75e; }
.arc { stroke: #3a4554; } .goal { stroke: #e8ecf2; } .ghost { stroke: #98a2b1; }
.link { stroke: #5fb4ec; } .alone .link { stroke: #e070b4; }
.load { fill: #f09a4a; } .hub { fill: #77818f; stroke: #b8c0cb; } .axis { fill: #14171d; } }
""".strip()


def recorded() -> tuple[fl.Run, fl.Run]:
    """The runs that are drawn: of the motor's PID alone, and of fraclink's law."""
    rig = fl.Rig.named("paper-2023-geared")
    request = {"gain_crossover": 12.0, "phase_margin": fl.deg(50), "filter_time": 0.02}
    law = fl.design(rig.model, rig, payloads=(0.020, 0.040), **request).law()
    move = fl.smooth_step(MOVE, 0.5).then(fl.smooth_step(-MOVE, 0.5, END / 2 - 0.5))
    lost = SensorFault(LOST, END + 1.0, "gauge value", float("nan"))
    arm = Twin.from_rig(rig, payload=0.030)
    alone, ours = (
        fl.simulate(one, move, arm=arm, duration=END, told=True, events=[lost])
        for one in (motor_alone(law), law)
    )
    return alone, ours


def spot(angle: float, radius: float) -> tuple[float, float]:
    """Where a point at `angle` [rad] and `radius` [pixels] lies from the hub; the middle
    of the move points upwards.
    """
    turn = angle - MOVE / 2
    return -radius * math.sin(turn), -radius * math.cos(turn)


def bent(motor: float, tip: float) -> str:
    """The link's line. Clamped at the hub and loaded at its tip it bends as 3x²/2 −
    x³/2; as x³ its bow is twice as deep, its ends and its direction at the hub the same.
    """
    share = [i / 8 for i in range(9)]
    places = [spot(motor + (tip - motor) * x * x, LENGTH * x) for x in share]
    return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in places)


def animated(attribute: str, values: Iterable[str], *, discrete: bool = False) -> str:
    """One attribute over the run, repeated endlessly."""
    mode = ' calcMode="discrete"' if discrete else ""
    return (
        f'<animate attributeName="{attribute}" dur="{END:g}s" repeatCount="indefinite"{mode} '
        f'values="{";".join(values)}"/>'
    )


def arm(run: fl.Run, rows: list[int], tag: Callable[[str, list[str]], str]) -> str:
    """Reference, link and payload; `tag` writes an attribute's values."""
    link = [bent(run.motor_angle[k], run.tip_angle[k]) for k in rows]
    tips = [spot(run.tip_angle[k], LENGTH) for k in rows]
    ghosts = [spot(run.reference[k], LENGTH) for k in rows]
    columns = {
        "cx": [f"{x:.1f}" for x, _ in tips],
        "cy": [f"{y:.1f}" for _, y in tips],
        "x2": [f"{x:.1f}" for x, _ in ghosts],
        "y2": [f"{y:.1f}" for _, y in ghosts],
    }
    ghost = {"cx": columns["x2"], "cy": columns["y2"]}

    def drawn(name: str, kind: str, fixed: str, parts: dict[str, list[str]]) -> str:
        first = " ".join(f'{key}="{values[0]}"' for key, values in parts.items())
        return (
            f'<{name} class="{kind}" {fixed} {first}>'
            + "".join(map(tag, parts, parts.values()))
            + f"</{name}>"
        )

    return "\n".join(
        [
            drawn(
                "line",
                "ghost",
                'x1="0" y1="0"',
                {k: columns[k] for k in ("x2", "y2")},
            ),
            drawn("circle", "ghost", 'r="17"', ghost),
            drawn("path", "link", "", {"d": link}),
            drawn("path", "shine", "", {"d": link}),
            drawn("circle", "load", 'r="14"', {k: columns[k] for k in ("cx", "cy")}),
        ]
    )


def fate(run: fl.Run) -> str:
    """The outcome of the move there, in a few words; a swing that passes the goal just
    as the move back begins is not rest.
    """
    error = np.abs(run.tip_angle[: run.time.size // 2] - MOVE)
    swing = error[error.size // 2 :].max()
    if swing > BAND:
        return f"still swings by {math.degrees(swing):.0f}°"
    last = int(np.flatnonzero(error > BAND)[-1]) + 1
    return f"at rest after {last * run.period:.1f} s"


def lost(run: fl.Run, rows: list[int]) -> str:
    """That the gauge is lost, as a line that comes and goes."""
    values = ["1" if run.time[k] >= LOST else "0" for k in rows]
    return (
        f'<text class="warn" x="0" y="58" text-anchor="middle" opacity="0">its strain gauge reads NaN'
        f"{animated('opacity', values, discrete=True)}</text>"
    )


def drawing(kind: str, name: str, run: fl.Run, middle: float) -> str:
    """One arm about its hub, `middle` pixels from the left."""
    rows = list(range(0, run.time.size, STEP))
    still = int(0.15 / run.period) // STEP * STEP
    radius = LENGTH + 20
    (x1, y1), (x2, y2) = spot(MOVE + 0.45, radius), spot(-0.45, radius)
    goals = [(spot(a, radius - 9), spot(a, radius + 3)) for a in (0.0, MOVE)]
    parts = [
        f'<g class="{kind}" transform="translate({middle:g} {HUB})">',
        f'<path class="arc" d="M{x1:.1f} {y1:.1f}A{radius} {radius} 0 0 1 {x2:.1f} {y2:.1f}"/>',
        *(
            f'<line class="goal" x1="{a:.1f}" y1="{b:.1f}" x2="{c:.1f}" y2="{d:.1f}"/>'
            for (a, b), (c, d) in goals
        ),
        f'<g class="moving">\n{arm(run, rows, animated)}\n{lost(run, rows)}\n</g>',
        f'<g class="still">\n{arm(run, [still], lambda key, values: "")}\n</g>',
        '<circle class="hub" r="17"/><circle class="axis" r="3"/>',
        f'<text class="big" y="40" x="0" text-anchor="middle">{name}: {fate(run)}</text>',
        "</g>",
    ]
    return "\n".join(parts)


def main() -> None:
    """Write the animation."""
    alone, ours = recorded()
    assert {MODES[int(mode)] for mode in ours.mode} == {"run", "degraded"}
    title = (
        "The same flexible arm moves 30 g by 60 degrees and back under its motor's PID, and swings, "
        "and under fraclink, and rests; before the way back both lose their strain gauge"
    )
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" role="img"',
        f'aria-label="{title}">',
        f"<title>{title}</title>",
        f"<style>{STYLE}</style>",
        drawing("alone", "Motor PID alone", alone, WIDTH / 4),
        drawing("ours", "fraclink", ours, 3 * WIDTH / 4),
        f'<text x="{WIDTH / 2:g}" y="16" text-anchor="middle">30 g on 0.65 m, 60° in 0.5 s; dashed: where '
        "the tip should be; bow drawn twice as deep</text>",
        "</svg>",
    ]
    write_text(PLACE, "\n".join(parts) + "\n")
    print(PLACE.name, PLACE.stat().st_size, "bytes;", fate(alone), "/", fate(ours))


if __name__ == "__main__":
    main()
