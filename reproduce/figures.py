"""Figs. 3 to 6, 9 and 10 of the paper, drawn from fraclink's computations; each states
the data it uses.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from reproduce import designs
from reproduce.logs import twin_fits
from reproduce.loops import LOOP_DELAY, SWEEP, last_crossing, sampled
from reproduce.matplotlib_svg import BLUE, FAINT, GREY, INK, LEVELS, ORANGE, figure, svg

if TYPE_CHECKING:
    from matplotlib.axes import Axes


WIDTH = 8.6  # inches: width of a page
_TWIN = (
    "Data of the twin, into which λ = 1.92 was written, not of the laboratory, whose logs are not published: "
    "they show the method and confirm nothing."
)


@dataclass(frozen=True)
class Picture:
    """One figure: file name, title, caption and SVG text."""

    name: str
    title: str
    caption: str
    drawing: str


def identification_pictures() -> list[Picture]:
    """Figs. 3 to 6: measured torque and the four models."""
    sets = (
        (3, "pulse", "pulse of 1 rad, 30 g", (5.0, 13.0)),
        (4, "nominal", "PRBS, 30 g", (0.0, 8.0)),
        (5, "heavy", "PRBS, 40 g", (0.0, 8.0)),
        (6, "light", "PRBS, 20 g", (0.0, 8.0)),
    )
    return [_identification(*item) for item in sets]


def _identification(
    number: int, log: str, name: str, span: tuple[float, float]
) -> Picture:
    found = twin_fits(log)
    with figure(WIDTH, 5.2) as drawing:
        rows = drawing.subplots(4, 1, sharex=True, sharey=True)
        for color, axes, (structure, fit) in zip(
            LEVELS, rows, found.items(), strict=True
        ):
            time = fit.period * np.arange(fit.measured.size)
            part = (time >= span[0]) & (time <= span[1])
            axes.plot(
                time[part],
                fit.measured[part],
                color=GREY,
                alpha=0.5,
                linewidth=2.0,
                label="measured",
            )
            axes.plot(
                time[part],
                fit.predicted[part],
                color=color,
                linewidth=0.9,
                label=structure,
            )
            # Next to the title: inside the axes the legend would cover the curves.
            axes.legend(
                loc="lower right",
                bbox_to_anchor=(1.0, 0.97),
                ncols=2,
                borderaxespad=0.0,
            )
            axes.set_title(f"{structure}: MSE {fit.mse:.3g} (N·m)²")
        rows[-1].set_xlabel("time [s]")
        rows[-1].set_xlim(*span)
        drawing.supylabel("base torque Γ [N·m]", fontsize=8.5)
        text = svg(drawing, f"fig{number:02d}", f"Figure {number}: {name}")
    shared = "" if log == "pulse" else ", λ or α and μ common to the three payloads"
    caption = f"Measured torque and the four fitted models, c held at 1.56 N·m{shared}. {_TWIN}"
    return Picture(f"fig{number:02d}.svg", f"Fig. {number}: {name}", caption, text)


def nyquist_picture() -> Picture:
    """Fig. 9: G and L = Ĉ·G at 30 g."""
    tip = designs.link(0.030).tip()
    c = designs.measured_design().controller
    # The grid is dense near the resonance, where the curve turns quickly.
    w = np.union1d(
        np.geomspace(0.1, 300, 300), 12.2 * np.exp(np.linspace(-0.4, 0.4, 400))
    )
    g = np.asarray(tip(1j * w))
    loop = np.asarray(c.response(w)) * g
    with figure(WIDTH * 0.62, 4.9) as drawing:
        axes = drawing.subplots()
        turn = np.exp(1j * np.linspace(0, 2 * math.pi, 181))
        axes.plot(
            turn.real, turn.imag, color=GREY, linewidth=0.7, linestyle=(0, (4, 3))
        )
        axes.plot(g.real, g.imag, color=ORANGE, label="G(jω)")
        axes.plot(loop.real, loop.imag, color=BLUE, label="L(jω) = Ĉ·G")
        found = last_crossing(c, 0.030)
        point = complex(
            (
                np.asarray(c.response(np.array([found.frequency])))
                * tip(1j * np.array([found.frequency]))
            )[0]
        )
        axes.plot(point.real, point.imag, "o", color=BLUE, markersize=4)
        axes.annotate(
            f"ω_c = {found.frequency:.2f} rad/s\nφ_m = {found.margin:.1f}°",
            (point.real, point.imag),
            xytext=(-5.7, 1.5),
            textcoords="data",
            arrowprops={"arrowstyle": "-", "color": GREY, "linewidth": 0.7},
        )
        axes.plot(-1, 0, "+", color=INK, markersize=10, markeredgewidth=1.4)
        axes.set(
            xlim=(-6, 6), ylim=(-9, 3), xlabel="real part", ylabel="imaginary part"
        )
        axes.set_aspect("equal")
        axes.legend(loc="lower right")
        text = svg(drawing, "fig09", "Figure 9: Nyquist curves")
    return Picture(
        "fig09.svg",
        "Fig. 9: Nyquist curves",
        "At 30 g, by (5) with c = 1.56 N·m; Ĉ as section 6 gives it, without filter.",
        text,
    )


def margin_pictures() -> list[Picture]:
    """Fig. 10: crossover and margin against payload, for four readings of the
    controllers.
    """
    return [
        _margins(
            "fig10a.svg",
            "Fig. 10 with the printed controllers (58) and (59)",
            designs.printed(),
            "Missing parts: |L| < 1 everywhere, no crossing.",
        ),
        _margins(
            "fig10b.svg",
            "Fig. 10 with the printed gains and δ = 0.0016 s",
            designs.rescaled(),
            "The only power-of-ten reading of δ that keeps the paper's 10 % rule.",
        ),
        _margins(
            "fig10c.svg",
            "Fig. 10 with the corrected controllers",
            designs.corrected(),
            "Section 6 carried out with c = 1.56 N·m; δ = 0.0024 s by the paper's own 10 % rule, n = 2.",
        ),
        _margins(
            "fig10d.svg",
            "Fig. 10 with the controllers designed in the loop",
            designs.in_loop(),
            "fraclink's own: 12 rad/s and 50° with filter, M(s), hold and delay inside (55).",
        ),
    ]


_DRAWN = (0.008, 0.016, 0.020, 0.030, 0.040)  # kg, the payloads of section 7


def unstable(pair: designs.Pair, payloads: tuple[float, ...] = _DRAWN) -> str:
    """Describe which loops of 4 ms are unstable at which of the payloads, by the
    Nyquist criterion.
    """
    parts = []
    for name, controller in (("C", pair.fractional), ("C'", pair.integer)):
        at = [f"{1e3 * m:g}" for m in payloads if not sampled(controller, m).stable]
        if at:
            parts.append(f"{name} at {', '.join(at)} g")
    return "; ".join(parts)


def _margins(name: str, title: str, pair: designs.Pair, caption: str) -> Picture:
    mass = np.array(SWEEP)
    cases = (
        ("L", False, 0.0, "-"),
        ("LM", True, 0.0, (0, (5, 2))),
        ("LM at 4 ms", True, LOOP_DELAY, (0, (1, 1.2))),
    )
    with figure(WIDTH, 5.0) as drawing:
        above, below = drawing.subplots(2, 1, sharex=True)
        for color, prime, controller in (
            (BLUE, "", pair.fractional),
            (ORANGE, "'", pair.integer),
        ):
            for label, motor, delay, style in cases:
                found = [
                    last_crossing(controller, float(m), motor=motor, delay=delay)
                    for m in mass
                ]
                kind = (
                    label.replace("LM", f"LM{prime}") if "M" in label else f"L{prime}"
                )
                _line(
                    above, mass, [item.frequency for item in found], color, style, kind
                )
                _line(below, mass, [item.margin for item in found], color, style, kind)
        below.axhline(0, color=INK, linewidth=0.8)
        for axes in (above, below):
            axes.axvline(30, color=FAINT, linewidth=1.2)
        above.set_ylabel("gain crossover ω_c [rad/s]")
        below.set_ylabel("phase margin φ_m [°]")
        below.set_xlabel("payload [g]; grey: nominal")
        above.legend(ncols=2, loc="upper right")
        below.set_xlim(8, 45)
        text = svg(drawing, name.removesuffix(".svg"), title)
    bad = unstable(pair)
    flag = (
        f"Unstable at 4 ms: {bad}."
        if bad
        else "At 4 ms all are stable at the payloads of section 7."
    )
    return Picture(
        name,
        title,
        f"{caption} Negative margins: the closed loop is unstable. {flag}",
        text,
    )


def _line(
    axes: Axes,
    mass: np.ndarray,
    values: list[float],
    color: str,
    style: object,
    label: str,
) -> None:
    axes.plot(
        1e3 * mass, values, color=color, linestyle=style, linewidth=1.2, label=label
    )
