"""The paper's figures, drawn from fraclink's computations; each states the data it stands on."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from fraclink._arm.controller import Controller
from fraclink._arm.reference import smooth_step
from fraclink._law import Law, discretize
from fraclink._show.axes import BLUE, FAINT, GREY, INK, LEVELS, ORANGE, figure, svg
from fraclink._simulate import Run, simulate
from reproduce import designs
from reproduce.evidence import last_crossing
from reproduce.values import comparison

if TYPE_CHECKING:
    from matplotlib.axes import Axes


WIDTH = 8.6  # inches: a page's width
_TWIN = "Data of the twin, not of the laboratory, whose logs are not published."


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
        (3, "pulse", "Pulse, 30 g", (5.0, 13.0)),
        (4, "nominal", "PRBS, 30 g", (0.0, 8.0)),
        (5, "heavy", "PRBS, 40 g", (0.0, 8.0)),
        (6, "light", "PRBS, 20 g", (0.0, 8.0)),
    )
    return [_identification(*item) for item in sets]


def _identification(number: int, log: str, name: str, span: tuple[float, float]) -> Picture:
    found = comparison(log)
    with figure(WIDTH, 5.2) as drawing:
        rows = drawing.subplots(4, 1, sharex=True, sharey=True)
        for color, axes, (structure, fit) in zip(LEVELS, rows, found.fits.items(), strict=True):
            time = fit.period * np.arange(fit.samples)
            part = (time >= span[0]) & (time <= span[1])
            measured = fit.predicted + fit.residual
            axes.plot(time[part], measured[part], color=GREY, alpha=0.5, linewidth=2.0, label="measured")
            axes.plot(time[part], fit.predicted[part], color=color, linewidth=0.9, label=structure)
            # Beside the title: inside it would lie on the curves.
            axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.97), ncols=2, borderaxespad=0.0)
            axes.set_title(f"{structure}: MSE {fit.mse:.3g} (N·m)²")
        rows[-1].set_xlabel("time [s]")
        rows[-1].set_xlim(*span)
        drawing.supylabel("base torque Γ [N·m]", fontsize=8.5)
        text = svg(drawing, f"fig{number:02d}", f"Figure {number}: {name}")
    caption = f"Measured torque and the four fitted models. {_TWIN}"
    return Picture(f"fig{number:02d}.svg", f"Fig. {number}: {name}", caption, text)


def nyquist_picture() -> Picture:
    """Fig. 9: G and L = Ĉ·G at 30 g."""
    tip = designs.link(0.030).tip()
    c = designs.measured_design().controller
    # Dense where the mode turns the curve.
    w = np.union1d(np.geomspace(0.1, 300, 300), 12.2 * np.exp(np.linspace(-0.4, 0.4, 400)))
    g = np.asarray(tip(1j * w))
    loop = np.asarray(c.response(w)) * g
    with figure(WIDTH * 0.62, 4.9) as drawing:
        axes = drawing.subplots()
        turn = np.exp(1j * np.linspace(0, 2 * math.pi, 181))
        axes.plot(turn.real, turn.imag, color=GREY, linewidth=0.7, linestyle=(0, (4, 3)))
        axes.plot(g.real, g.imag, color=ORANGE, label="G(jω)")
        axes.plot(loop.real, loop.imag, color=BLUE, label="L(jω) = Ĉ·G")
        found = last_crossing(c, 0.030)
        point = complex(
            (np.asarray(c.response(np.array([found.frequency]))) * tip(1j * np.array([found.frequency])))[0]
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
        axes.set(xlim=(-6, 6), ylim=(-9, 3), xlabel="real part", ylabel="imaginary part")
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
    """Fig. 10: crossover and margin against payload, for the printed and the corrected controllers."""
    printed, own, ours = designs.printed(), designs.corrected(), designs.in_loop()
    return [
        _margins(
            "fig10a.svg",
            "Fig. 10 with the printed controllers (58) and (59)",
            printed,
            "Missing parts: |L| < 1 everywhere, no crossing. Negative margins: the closed loop is unstable.",
        ),
        _margins(
            "fig10b.svg",
            "Fig. 10 with the corrected controllers",
            own,
            "Section 6 carried out with c = 1.56 N·m; δ = 0.0024 s by the paper's own 10 % rule, n = 2.",
        ),
        _margins(
            "fig10c.svg",
            "Fig. 10 with the controllers designed in the loop",
            ours,
            "12 rad/s and 50° with filter, M(s), hold and delay inside equation (55).",
        ),
    ]


def _margins(name: str, title: str, pair: designs.Pair, caption: str) -> Picture:
    mass = np.linspace(0.008, 0.045, 75)
    cases = (
        ("L", False, 0.0, "-"),
        ("LM", True, 0.0, (0, (5, 2))),
        ("LM at 4 ms", True, 0.006, (0, (1, 1.2))),
    )
    with figure(WIDTH, 5.0) as drawing:
        above, below = drawing.subplots(2, 1, sharex=True)
        for color, prime, controller in ((BLUE, "", pair.fractional), (ORANGE, "'", pair.integer)):
            for label, motor, delay, style in cases:
                found = [last_crossing(controller, float(m), motor=motor, delay=delay) for m in mass]
                kind = label.replace("LM", f"LM{prime}") if "M" in label else f"L{prime}"
                _line(above, mass, [item.frequency for item in found], color, style, kind)
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
    return Picture(name, title, caption, text)


def _line(axes: Axes, mass: np.ndarray, values: list[float], color: str, style: object, label: str) -> None:
    axes.plot(1e3 * mass, values, color=color, linestyle=style, linewidth=1.2, label=label)


def controllers() -> tuple[tuple[str, str, Controller], ...]:
    """The six controllers of the tracking figures: column, line, controller."""
    return tuple(
        (pair.name, line, controller)
        for pair in (designs.printed(), designs.corrected(), designs.in_loop())
        for line, controller in (("C", pair.fractional), ("C'", pair.integer))
    )


_OFFSET = 0.05  # N·m: the paper prints none; Fig. 14 shows a small one
_FIGURES = ((11, 0.030), (12, 0.040), (13, 0.020), (15, 0.016), (16, 0.008))
_CAPTION = (
    "A move of 1 rad in 1 s at {grams:g} g with a gauge offset of 0.05 N·m, simulated on the fractional link "
    "(λ = 1.92, c = 1.56 N·m) with M(s), 4 ms and one sample of delay. {end}"
)


@cache
def _laws() -> dict[tuple[str, str], Law]:
    period = designs.rig().period
    return {(pair, line): discretize(controller, period) for pair, line, controller in controllers()}


def _run(law: Law, payload: float, noise: float = 0.0) -> Run:
    return simulate(
        law,
        smooth_step(1.0, duration=1.0),
        rig=designs.rig(),
        model=designs.link(0.030),
        payload=payload,
        duration=5.0,
        noise=noise,
        gauge_offset=_OFFSET,
        seed=1,
    )


def tracking_pictures() -> list[Picture]:
    """The tip's tracking at 30, 40, 20, 16 and 8 g, and the gauge with its offset."""
    pictures = [_tracking(number, payload) for number, payload in _FIGURES]
    return [*pictures[:3], _gauge(), *pictures[3:]]


def _tracking(number: int, payload: float) -> Picture:
    laws = _laws()
    ends = []
    with figure(WIDTH, 3.1) as drawing:
        panels = drawing.subplots(1, 3, sharey=True)
        for axes, name in zip(panels, dict.fromkeys(pair for pair, _ in laws), strict=True):
            for line, color, style in (("C'", ORANGE, (0, (4, 1.5))), ("C", BLUE, "-")):
                run = _run(laws[name, line], payload)
                # A tripped law leaves the arm to itself: what follows is no tracking.
                alive = np.cumsum(run.mode != 1) == 0
                axes.plot(run.time[alive], run.tip_angle[alive], color=color, linestyle=style, label=line)
                if not alive.all():
                    axes.plot(run.time[alive][-1], run.tip_angle[alive][-1], "x", color=color, markersize=7)
                if not run.verdict.passed:
                    ends.append(f"{name}, {line}: {run.verdict.reason}.")
            axes.plot(run.time, run.reference, color=GREY, linewidth=0.8, linestyle=(0, (1, 1)))
            title = f"{name} (fraclink)" if name == "in the loop" else name
            axes.set(title=title, xlabel="time [s]", xlim=(0, 5), ylim=(-0.1, 1.6))
        panels[0].set_ylabel("tip angle θt [rad]")
        panels[-1].legend(loc="lower right")
        text = svg(drawing, f"fig{number}", f"Figure {number}: tracking at {1e3 * payload:g} g")
    end = "All six hold." if not ends else " ".join(ends)
    return Picture(
        f"fig{number}.svg",
        f"Fig. {number}: tracking at {1e3 * payload:g} g",
        _CAPTION.format(grams=1e3 * payload, end=end) + (" ×: the law trips." if "trips" in end else ""),
        text,
    )


def _gauge() -> Picture:
    run = _run(_laws()["in the loop", "C"], 0.030, noise=designs.rig().gauge.noise)
    with figure(WIDTH, 2.4) as drawing:
        axes = drawing.subplots()
        axes.plot(run.time, run.torque_measured, color=GREY, linewidth=0.7, label="gauge")
        axes.plot(run.time, run.torque, color=BLUE, label="true torque")
        axes.axhline(_OFFSET, color=ORANGE, linewidth=0.8, label="offset")
        axes.set(xlabel="time [s]", ylabel="torque Γ [N·m]", xlim=(0, 5))
        axes.legend(ncols=3, loc="upper right")
        text = svg(drawing, "fig14", "Figure 14: the gauge during a move")
    left = 1e3 * abs(float(run.tip_angle[-1] - run.reference[-1]))
    caption = (
        "The move of Fig. 11 with the in-loop controller and gauge noise of "
        f"{designs.rig().gauge.noise:g} N·m: "
        f"the gauge keeps its offset, the tip ends {left:.2f} mrad from its reference."
    )
    return Picture("fig14.svg", "Fig. 14: the gauge, with an offset", caption, text)
