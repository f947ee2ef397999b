"""Draw the README's animation: `python tools/make_animation.py`.

docs/_static/arm.svg: the bundled arm with 30 g moves by 60° and back under the law that
is shipped, on the twin with a link of 7.35 g; before the way back its strain gauge is
lost. Every position is a sample of that run, drawn to scale; a viewer interpolates
between samples 40 ms apart. One file without a script, for light and dark pages; who
asks the system for less motion sees it stand still.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from pathlib import Path

import fraclink as fl
from fraclink._files import write_text
from fraclink._law import MODES
from fraclink._simulate import SensorFault, Twin

PLACE = Path(__file__).resolve().parents[1] / "docs" / "_static" / "arm.svg"
WIDTH, HEIGHT, LENGTH = 640, 416, 272  # LENGTH: of the link, in pixels
HUB = (WIDTH / 2, HEIGHT - 58)
MOVE = math.radians(60)
END, LOST = 4.0, 1.6  # [s]
STEP = 10  # periods between two samples of the drawing

STYLE = """
text { font: 14px system-ui, "Segoe UI", "Noto Sans", Helvetica, Arial, sans-serif; fill: #565f6d; }
.big { font-weight: 600; font-size: 16px; fill: #1d2430; } .warn { fill: #8a5300; }
.good { fill: #23683b; }
.arc { fill: none; stroke: #d5d2c8; stroke-width: 1.5; }
.goal { stroke: #1d2430; stroke-width: 3; stroke-linecap: round; }
.ghost { fill: none; stroke: #6d7480; stroke-width: 1.5; stroke-dasharray: 7 6; }
.link { fill: none; stroke: #1c5d8c; stroke-width: 9; stroke-linecap: round; }
.shine { fill: none; stroke: #8fc3e6; stroke-width: 1.5; }
.load { fill: #c2570c; } .hub { fill: #8d949e; stroke: #4a515c; stroke-width: 2; } .axis { fill: #fff; }
.still { display: none; }
@media (prefers-reduced-motion: reduce) { .moving { display: none; } .still { display: inline; } }
@media (prefers-color-scheme: dark) { text { fill: #a3adbb; } .big { fill: #e8ecf2; }
.warn { fill: #f0b75e; } .good { fill: #79d398; }
.arc { stroke: #3a4554; } .goal { stroke: #e8ecf2; } .ghost { stroke: #98a2b1; }
.link { stroke: #5fb4ec; } .shine { stroke: #d6eeff; }
.load { fill: #f09a4a; } .hub { fill: #77818f; stroke: #b8c0cb; } .axis { fill: #14171d; } }
""".strip()


def recorded() -> fl.Run:
    """The run that is drawn."""
    rig = fl.Rig.named("paper-2023-geared")
    request = {"gain_crossover": 12.0, "phase_margin": fl.deg(50), "filter_time": 0.02}
    law = fl.design(rig.model, rig, payloads=(0.020, 0.040), **request).law()
    move = fl.smooth_step(MOVE, 0.5).then(fl.smooth_step(-MOVE, 0.5, END / 2 - 0.5))
    lost = SensorFault(LOST, END + 1.0, "gauge value", float("nan"))
    arm = Twin.from_rig(rig, payload=0.030)
    return fl.simulate(law, move, arm=arm, duration=END, told=True, events=[lost])


def spot(angle: float, radius: float) -> tuple[float, float]:
    """Where a point at `angle` [rad] and `radius` [pixels] lies; the middle of the move
    points upwards.
    """
    turn = angle - MOVE / 2
    return HUB[0] - radius * math.sin(turn), HUB[1] - radius * math.cos(turn)


def bent(motor: float, tip: float) -> str:
    """The link's line: clamped at the hub and loaded at its tip it bends as 3x²/2 −
    x³/2.
    """
    share = [i / 8 for i in range(9)]
    places = [
        spot(motor + (tip - motor) * (1.5 * x - 0.5 * x * x), LENGTH * x) for x in share
    ]
    return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in places)


def animated(attribute: str, values: Iterable[str], *, discrete: bool = False) -> str:
    """One attribute over the run, again and again."""
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
                f'x1="{HUB[0]}" y1="{HUB[1]}"',
                {k: columns[k] for k in ("x2", "y2")},
            ),
            drawn("circle", "ghost", 'r="17"', ghost),
            drawn("path", "link", "", {"d": link}),
            drawn("path", "shine", "", {"d": link}),
            drawn("circle", "load", 'r="14"', {k: columns[k] for k in ("cx", "cy")}),
        ]
    )


def says(run: fl.Run, rows: list[int]) -> str:
    """What the law does, as lines that take turns."""
    modes = [MODES[int(run.mode[k])] for k in rows]
    lines = {
        "run": ("good", "The law runs on strain gauge and encoder."),
        "degraded": (
            "warn",
            "The strain gauge reads NaN: the law continues without it.",
        ),
    }
    assert set(modes) == set(lines), modes
    shown = []
    for mode, (kind, text) in lines.items():
        seen = animated(
            "opacity", ["1" if now == mode else "0" for now in modes], discrete=True
        )
        shown.append(
            f'<text class="big {kind}" x="20" y="32" opacity="0">{text}{seen}</text>'
        )
    return "\n".join(shown)


def main() -> None:
    """Write the animation."""
    run = recorded()
    rows = list(range(0, run.time.size, STEP))
    (x1, y1), (x2, y2) = spot(MOVE + 0.45, LENGTH + 24), spot(-0.45, LENGTH + 24)
    radius = LENGTH + 24
    goals = [(spot(a, radius - 9), spot(a, radius + 3)) for a in (0.0, MOVE)]
    middle = int(0.15 / run.period) // STEP * STEP
    title = "A flexible arm moves 30 g by 60 degrees and back; before the way back its strain gauge is lost"
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" role="img"',
        f'aria-label="{title}">',
        f"<title>{title}</title>",
        f"<style>{STYLE}</style>",
        f'<path class="arc" d="M{x1:.1f} {y1:.1f}A{radius} {radius} 0 0 1 {x2:.1f} {y2:.1f}"/>',
        *(
            f'<line class="goal" x1="{a:.1f}" y1="{b:.1f}" x2="{c:.1f}" y2="{d:.1f}"/>'
            for (a, b), (c, d) in goals
        ),
        f'<g class="moving">\n{says(run, rows)}\n{arm(run, rows, animated)}\n</g>',
        f'<g class="still">\n{arm(run, [middle], lambda key, values: "")}\n</g>',
        f'<circle class="hub" cx="{HUB[0]}" cy="{HUB[1]}" r="19"/>',
        f'<circle class="axis" cx="{HUB[0]}" cy="{HUB[1]}" r="3"/>',
        f'<text x="20" y="{HEIGHT - 16}">30 g on 0.65 m, to scale; dashed: where the tip should be</text>',
        "</svg>",
    ]
    write_text(PLACE, "\n".join(parts) + "\n")
    print(PLACE.name, PLACE.stat().st_size, "bytes;", run.verdict)


if __name__ == "__main__":
    main()
