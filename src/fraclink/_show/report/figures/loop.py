"""The open loop: Bode, Nyquist, and the margins against the payload."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fraclink._show.report.figures.drawing import FULL_WIDTH, grams
from fraclink._show.report.svg import BLUE, FAINT, GREY, INK, LEVELS, ORANGE, figure, svg

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from fraclink._design import Design

__all__ = ["bode_figure", "margins_figure", "nyquist_figure", "payloads_of"]

_BEYOND = 0.4  # the margins are shown down to this share of the lightest payload: 8 g for 20 g
_STEPS = 25


def payloads_of(design: Design) -> list[float]:
    """Lightest, nominal (where it lies inside) and heaviest payload [kg]."""
    low, high = design.payloads
    return sorted({low, high} | {m for m in (design.rig.payloads.nominal,) if low < m < high})


def _frequencies(design: Design, payload: float) -> NDArray[np.float64]:
    """A grid [rad/s] that is dense where the mode turns the curve, and ends at the Nyquist frequency."""
    mode = float(design.loop.peak(design.natural_frequency(payload)))
    near = mode * np.exp(np.sinh(np.linspace(-3.5, 3.5, 181)) / np.sinh(3.5) * 1.5)
    ends = np.geomspace(0.03 * mode, math.pi / design.rig.period, 160)
    grid = np.union1d(near, ends)
    return np.asarray(grid[(grid >= ends[0]) & (grid <= ends[-1])])


def _decade_lines(axes: Axes) -> None:
    from matplotlib.ticker import FormatStrFormatter, NullFormatter

    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(FormatStrFormatter("%g"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.grid(True, which="minor", color=FAINT, linewidth=0.25)


def bode_figure(design: Design) -> str:
    """Draw gain and phase of the open loop at the lightest, nominal and heaviest payload."""
    with figure(FULL_WIDTH, 4.4) as drawing:
        gain, phase = drawing.subplots(2, 1, sharex=True)
        for color, payload in zip(LEVELS, payloads_of(design), strict=False):
            w = _frequencies(design, payload)
            value = design.loop.log(w, design.natural_frequency(payload))
            gain.plot(w, 20 * value.real / math.log(10), color=color, label=grams(payload))
            phase.plot(w, np.degrees(value.imag), color=color)
            found = design.at(payload)
            for crossing in found.gain_crossings:
                level = design.loop.log(np.array([crossing.frequency]), design.natural_frequency(payload))
                gain.plot(crossing.frequency, 0, "o", color=color, markersize=4)
                phase.plot(crossing.frequency, math.degrees(level[0].imag), "o", color=color, markersize=4)
        gain.axhline(0, color=INK, linewidth=0.7)
        phase.axhline(-180, color=INK, linewidth=0.7)
        phase.set_yticks(np.arange(-360, 91, 90))
        phase.set_ylim(-360, 90)
        gain.set_ylim(-45, 30)
        gain.set_ylabel("gain |L| [dB]")
        phase.set_ylabel("phase of L [°]")
        phase.set_xlabel("frequency ω [rad/s]")
        for axes in (gain, phase):
            _decade_lines(axes)
        phase.set_xlim(1, math.pi / design.rig.period)
        gain.legend(title="payload", ncols=3, loc="upper right")
        return svg(drawing, "bode", "Gain and phase of the open loop against frequency")


def nyquist_figure(design: Design) -> str:
    """Draw L(jω) around the critical point −1."""
    with figure(FULL_WIDTH / 2, 4.1) as drawing:
        axes = drawing.subplots()
        turn = np.exp(1j * np.linspace(0, 2 * math.pi, 181))
        axes.plot(turn.real, turn.imag, color=GREY, linewidth=0.7, linestyle=(0, (4, 3)))
        for color, payload in zip(LEVELS, payloads_of(design), strict=False):
            w = _frequencies(design, payload)
            value = design.loop(w, design.natural_frequency(payload))
            axes.plot(value.real, value.imag, color=color, label=grams(payload))
            for crossing in design.at(payload).gain_crossings:
                point = design.loop(np.array([crossing.frequency]), design.natural_frequency(payload))[0]
                axes.plot(point.real, point.imag, "o", color=color, markersize=4)
        axes.plot(-1, 0, "+", color=INK, markersize=10, markeredgewidth=1.4)
        axes.annotate("−1", (-1, 0), xytext=(-9, 5), textcoords="offset points", ha="right")
        axes.set_xlim(-2.3, 2.9)
        axes.set_ylim(-3.2, 2.0)
        axes.set_aspect("equal")
        axes.set_xlabel("Re L")
        axes.set_ylabel("Im L")
        axes.legend(title="payload", loc="upper right")
        return svg(drawing, "nyquist", "Nyquist curve of the open loop around the critical point")


def margins_figure(design: Design) -> str:
    """Draw phase margin and gain crossover against payload, of the loop asked for and of the sampled one."""
    low, high = design.payloads
    payloads = np.geomspace(_BEYOND * low, 1.15 * high, _STEPS)
    asked = [design.at(float(m)) for m in payloads]
    sampled = [design.sampled_at(float(m)) for m in payloads]
    with figure(FULL_WIDTH / 2, 4.1) as drawing:
        margin, crossover = drawing.subplots(2, 1, sharex=True)
        mass = 1e3 * payloads
        for axes in (margin, crossover):
            axes.axvspan(1e3 * low, 1e3 * high, color="#eef3f8", linewidth=0)
        loop_name = "loop asked for" if design.margins_kind == "loop" else "ideal loop (the paper's)"
        for color, style, label, found in (
            (BLUE, "-", loop_name, asked),
            (ORANGE, (0, (4, 2)), "sampled loop, exact", sampled),
        ):
            margin.plot(
                mass, np.degrees([_or_nan(m.phase_margin) for m in found]), color=color, ls=style, label=label
            )
            crossover.plot(mass, [_or_nan(m.gain_crossover) for m in found], color=color, ls=style)
        margin.axhline(math.degrees(design.phase_margin), color=GREY, linewidth=0.8)
        crossover.axhline(design.gain_crossover, color=GREY, linewidth=0.8)
        margin.set_ylim(bottom=min(0.0, margin.get_ylim()[0]))
        margin.set_ylabel("phase margin [°]")
        crossover.set_ylabel("gain crossover [rad/s]")
        crossover.set_xlabel("payload [g]; shaded: designed for")
        margin.legend(loc="lower right")
        drawing.align_ylabels()
        return svg(drawing, "margins", "Phase margin and gain crossover against payload")


def _or_nan(value: float | None) -> float:
    return math.nan if value is None or not math.isfinite(value) else value
