"""The figures of the reports: log, models, loop, moves, and campaigns."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.experiment import Experiment
from fraclink._campaign import Summary
from fraclink._design import Design
from fraclink._identify import Fit, StructureFit
from fraclink._show.drawing import (
    BLUE,
    FAILED,
    FAINT,
    FULL_WIDTH,
    GREY,
    INK,
    LINES,
    ORANGE,
    envelope,
    figure,
    load_matplotlib,
    svg,
)
from fraclink._show.tables import UNITS
from fraclink._show.text import grams
from fraclink._simulate import Run

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["SHOWN", "bode_figure", "drivers_figure", "failures_figure", "fit_figure", "log_figure"]
__all__ += ["margins_figure"]
__all__ += ["models_figure", "moves_figure", "nyquist_figure", "payloads_of", "spread_figure", "stacked"]
__all__ += ["structure_figure"]


def stacked(drawing: Figure, heights: Sequence[float], labels: Sequence[str], *, xlabel: str = "") -> Any:
    """Panels of these relative heights over one another, each with its label, on one horizontal axis."""
    panels = drawing.subplots(len(heights), 1, sharex=True, height_ratios=heights)
    for axes, label in zip(panels, labels, strict=True):
        axes.set_ylabel(label)
    panels[-1].set_xlabel(xlabel)
    return panels


OUTPUT_LABEL = {"torque": "base torque Γ [N·m]", "deflection": "deflection θm − θt [rad]"}


def log_figure(log: Experiment) -> str:
    """Draw motor angle and output against time."""
    with figure(FULL_WIDTH, 3.4) as drawing:
        labels = ("motor angle θm [rad]", OUTPUT_LABEL[log.output_kind])
        above, below = stacked(drawing, (1, 1), labels, xlabel="time [s]")
        above.plot(*envelope(log.time, log.motor_angle), color=INK, linewidth=0.9)
        below.plot(*envelope(log.time, log.output), color=BLUE, linewidth=0.8)
        below.set_xlim(log.time[0], log.time[-1])
        drawing.align_ylabels()
        return svg(drawing, "log", "The recorded motor angle and output against time")


def fit_figure(log: Experiment, fit: Fit) -> str:
    """Draw a whole log over its model: motor angle, measured and computed output, residual."""
    with figure(FULL_WIDTH, 5.0) as drawing:
        labels = ("angle θm [rad]", OUTPUT_LABEL[log.output_kind], "residual")
        angle, output, rest = stacked(drawing, (1, 2, 0.8), labels, xlabel="time [s]")
        angle.plot(*envelope(log.time, log.motor_angle), color=INK, linewidth=0.9)
        output.plot(*envelope(log.time, log.output), color=GREY, linewidth=2.6, alpha=0.5, label="measured")
        model = f"{fit.structure}, {log.source}" if log.source else fit.structure
        output.plot(*envelope(log.time, fit.predicted), color=BLUE, linewidth=0.9, label=model)
        rest.plot(*envelope(log.time, fit.residual), color=BLUE, linewidth=0.5)
        rest.axvline(log.time[fit.fitted_samples - 1], color=INK, linewidth=0.8, linestyle=(0, (2, 2)))
        output.legend(ncols=2, loc="lower left")
        rest.set_xlim(log.time[0], log.time[-1])
        drawing.align_ylabels()
        return svg(drawing, "fit", "The recorded output under its model, and what the model leaves")


def structure_figure(fit: StructureFit) -> str:
    """Draw what was measured over what the structure says, and what it leaves: in time or over frequency."""
    return _over_time(fit) if fit.domain == "time" else _over_frequency(fit)


def _over_time(fit: StructureFit) -> str:
    with figure(FULL_WIDTH, 3.6) as drawing:
        output, rest = stacked(drawing, (2, 0.8), ("output", "residual"), xlabel="time [s]")
        output.plot(
            *envelope(fit.place, fit.measured), color=GREY, linewidth=2.6, alpha=0.5, label="measured"
        )
        output.plot(*envelope(fit.place, fit.predicted), color=BLUE, linewidth=0.9, label=fit.expression)
        rest.plot(*envelope(fit.place, fit.measured - fit.predicted), color=BLUE, linewidth=0.5)
        rest.axvline(fit.place[fit.fitted - 1], color=INK, linewidth=0.8, linestyle=(0, (2, 2)))
        output.legend(ncols=2, loc="lower left")
        rest.set_xlim(fit.place[0], fit.place[-1])
        drawing.align_ylabels()
        return svg(drawing, "structure", "The recorded output under the structure, and what it leaves")


def _over_frequency(fit: StructureFit) -> str:
    with figure(FULL_WIDTH, 4.2) as drawing:
        labels = ("gain [dB]", "phase [°]", "error [%]")
        gain, phase, rest = stacked(drawing, (1.4, 1, 0.7), labels, xlabel="frequency ω [rad/s]")
        measured, predicted = (np.array_split(rows, 2) for rows in (fit.measured, fit.predicted))
        h, model = measured[0] + 1j * measured[1], predicted[0] + 1j * predicted[1]
        for row, draw in ((gain, lambda z: 20 * np.log10(np.abs(z))), (phase, _unwrapped)):
            row.plot(fit.place, draw(h), "o", color=GREY, markersize=3, label="measured")
            row.plot(fit.place, draw(model), color=BLUE, linewidth=1.0, label=fit.expression)
        rest.plot(fit.place, 100 * np.abs(h / model - 1), color=BLUE, linewidth=0.7)
        rest.set_ylim(bottom=0)
        for row in (gain, phase, rest):
            _decade_lines(row)
        gain.legend(ncols=2, loc="lower left")
        drawing.align_ylabels()
        return svg(drawing, "structure", "The measured response under the structure, and what it leaves")


def _unwrapped(response: NDArray[np.complex128]) -> NDArray[np.float64]:
    return np.degrees(np.unwrap(np.angle(response)))


_LARGE = 4.0  # a residual so many times the smallest gets a scale of its own: else the others are flat lines
_DETAIL = 0.18  # share of the log that the upper panel shows: the whole would be a band of ink


def models_figure(fits: Mapping[str, Fit]) -> str:
    """Draw a detail of the measured output under the models, and every model's residual."""
    some = next(iter(fits.values()))
    time, measured = some.period * np.arange(some.samples), some.predicted + some.residual
    with figure(FULL_WIDTH, 2.4 + 0.8 * len(fits)) as drawing:
        panels = drawing.subplots(1 + len(fits), 1, gridspec_kw={"height_ratios": [2.8] + [1] * len(fits)})
        detail, rows = panels[0], panels[1:]
        part = slice(0, max(2, int(_DETAIL * some.samples)))
        detail.plot(time[part], measured[part], color=GREY, linewidth=2.6, alpha=0.5, label="measured")
        for line, (name, fit) in zip(LINES, fits.items(), strict=False):
            detail.plot(time[part], fit.predicted[part], **line, linewidth=0.9, label=name)
        detail.set_ylabel(OUTPUT_LABEL[some.output_kind])
        detail.set_xlim(time[0], time[part][-1])
        detail.legend(ncols=1 + len(fits), loc="lower left")
        sizes = [1.1 * float(np.abs(fit.residual).max()) or 1.0 for fit in fits.values()]
        common = max(size for size in sizes if size <= _LARGE * min(sizes))
        for line, row, (name, fit) in zip(LINES, rows, fits.items(), strict=False):
            row.plot(*envelope(time, fit.residual), color=line["color"], linewidth=0.5)
            own = 1.1 * float(np.abs(fit.residual).max())
            size = common if own <= common else own
            row.set_ylim(-size, size)
            row.set_xlim(time[0], time[-1])
            row.set_ylabel(name)
            row.axvline(time[fit.fitted_samples - 1], color=INK, linewidth=0.8, linestyle=(0, (2, 2)))
            row.tick_params(labelbottom=row is rows[-1])
        rows[-1].set_xlabel("time [s]; residuals measured − model, held out right of the dashed line")
        drawing.align_ylabels()
        return svg(drawing, "models", "The models over the measured output, and their residuals")


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
    ticker = load_matplotlib().ticker
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(ticker.FormatStrFormatter("%g"))
    axes.xaxis.set_minor_formatter(ticker.NullFormatter())
    axes.grid(True, which="minor", color=FAINT, linewidth=0.25)


def bode_figure(design: Design) -> str:
    """Draw gain and phase of the open loop at the lightest, nominal and heaviest payload."""
    with figure(FULL_WIDTH, 4.4) as drawing:
        labels = ("gain |L| [dB]", "phase of L [°]")
        gain, phase = stacked(drawing, (1, 1), labels, xlabel="frequency ω [rad/s]")
        for line, payload in zip(LINES, payloads_of(design), strict=False):
            w = _frequencies(design, payload)
            value = design.loop.log(w, design.natural_frequency(payload))
            gain.plot(w, 20 * value.real / math.log(10), **line, label=grams(payload))
            phase.plot(w, np.degrees(value.imag), **line)
            found = design.at(payload)
            for crossing in found.gain_crossings:
                level = design.loop.log(np.array([crossing.frequency]), design.natural_frequency(payload))
                gain.plot(crossing.frequency, 0, "o", color=line["color"], markersize=4)
                phase.plot(
                    crossing.frequency, math.degrees(level[0].imag), "o", color=line["color"], markersize=4
                )
        gain.axhline(0, color=INK, linewidth=0.7)
        phase.axhline(-180, color=INK, linewidth=0.7)
        phase.set_yticks(np.arange(-360, 91, 90))
        phase.set_ylim(-360, 90)
        gain.set_ylim(-45, 30)
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
        for line, payload in zip(LINES, payloads_of(design), strict=False):
            w = _frequencies(design, payload)
            value = design.loop(w, design.natural_frequency(payload))
            axes.plot(value.real, value.imag, **line, label=grams(payload))
            for crossing in design.at(payload).gain_crossings:
                point = design.loop(np.array([crossing.frequency]), design.natural_frequency(payload))[0]
                axes.plot(point.real, point.imag, "o", color=line["color"], markersize=4)
        axes.plot(-1, 0, "+", color=INK, markersize=10, markeredgewidth=1.4)
        axes.annotate("−1", (-1, 0), xytext=(-9, 5), textcoords="offset points", ha="right")
        axes.set(xlim=(-2.3, 2.9), ylim=(-3.2, 2.0), aspect="equal", xlabel="Re L", ylabel="Im L")
        axes.legend(title="payload", loc="upper right")
        return svg(drawing, "nyquist", "Nyquist curve of the open loop around the critical point")


def margins_figure(design: Design) -> str:
    """Draw phase margin and gain crossover against payload, of the loop asked for and of the sampled one."""
    low, high = design.payloads
    payloads = np.geomspace(_BEYOND * low, 1.15 * high, _STEPS)
    asked = [design.at(float(m)) for m in payloads]
    sampled = [design.sampled_at(float(m)) for m in payloads]
    with figure(FULL_WIDTH / 2, 4.1) as drawing:
        labels, below = ("phase margin [°]", "gain crossover [rad/s]"), "payload [g]; shaded: designed for"
        margin, crossover = stacked(drawing, (1, 1), labels, xlabel=below)
        mass = 1e3 * payloads
        for axes in (margin, crossover):
            axes.axvspan(1e3 * low, 1e3 * high, color="#eef3f8", linewidth=0)
        loop_name = "loop designed for" if design.margins_kind == "loop" else "ideal loop (the paper's)"
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
        margin.legend(loc="lower right")
        drawing.align_ylabels()
        return svg(drawing, "margins", "Phase margin and gain crossover against payload")


def _or_nan(value: float | None) -> float:
    return math.nan if value is None or not math.isfinite(value) else value


def moves_figure(runs: Sequence[Run]) -> str:
    """Draw the tip's tracking, its error, the measured torque and the motor's voltage for every payload."""
    with figure(FULL_WIDTH, 6.2) as drawing:
        labels = ("tip angle θt [rad]", "tip error [mrad]", "gauge Γ [N·m]", "motor [V]")
        tip, error, torque, voltage = stacked(drawing, (2.2, 1.2, 1, 1), labels, xlabel="time [s]")
        tip.plot(
            *envelope(runs[0].time, runs[0].reference), color=GREY, linestyle=(0, (4, 2)), label="reference"
        )
        for line, run in zip(LINES, runs, strict=False):
            tip.plot(*envelope(run.time, run.tip_angle), **line, label=grams(run.payload))
            error.plot(*envelope(run.time, 1e3 * (run.tip_angle - run.reference)), **line, linewidth=0.9)
            torque.plot(*envelope(run.time, run.torque_measured), color=line["color"], linewidth=0.7)
            voltage.plot(*envelope(run.time, run.voltage), color=line["color"], linewidth=0.7)
        voltage.set_xlim(runs[0].time[0], runs[0].time[-1])
        tip.legend(loc="lower right", ncols=4)
        drawing.align_ylabels()
        return svg(drawing, "moves", "Tip angle, tip error, torque and voltage of the simulated moves")


# Metric of a campaign: what its histogram is called.
SHOWN = {
    "settling_time": "settling time",
    "overshoot": "overshoot",
    "residual_vibration": "residual vibration",
    "peak_tip_error": "largest tip error",
    "peak_voltage": "largest voltage",
    "motor_reference_noise": "motor reference noise",
}


def spread_figure(values: dict[str, NDArray[Any]]) -> str:
    """Histograms of the metrics in SHOWN with their median and 95 % quantile."""
    with figure(FULL_WIDTH, 4.2) as drawing:
        for axes, (name, title) in zip(drawing.subplots(2, 3).flat, SHOWN.items(), strict=True):
            unit, factor = UNITS[name]
            column = factor * np.asarray(values[name], dtype=float)
            finite = column[np.isfinite(column)]
            if finite.size:
                top = float(np.quantile(finite, 0.999))
                low = float(finite.min())
                axes.hist(np.clip(finite, low, top), bins=60, color=BLUE, alpha=0.75, linewidth=0)
                for share, colour in ((0.5, INK), (0.95, ORANGE)):
                    axes.axvline(
                        float(np.quantile(finite, share)),
                        color=colour,
                        label=f"{100 * share:g} % of the finite",
                    )
            missing = len(column) - len(finite)
            axes.set_title(f"{title} [{unit}]")
            if missing:
                text = f"never: {100 * missing / len(column):.3g} %"
                axes.text(0.98, 0.95, text, ha="right", va="top", color=FAILED, transform=axes.transAxes)
            axes.set_yticks([])
        drawing.axes[1].legend(loc="upper right")
        return svg(drawing, "spread", "Histograms of the metrics of all runs")


def failures_figure(
    across: NDArray[Any], up: NDArray[Any], failed: NDArray[Any], names: tuple[str, str]
) -> str:
    """Share of runs that fail over two drawn parameters, whose axes `names` title."""
    runs, edges_x, edges_y = np.histogram2d(across, up, bins=14)
    bad, _, _ = np.histogram2d(across[failed], up[failed], bins=(edges_x, edges_y))
    with np.errstate(invalid="ignore"):
        share = np.where(runs > 0, 100.0 * bad / runs, np.nan)
    with figure(0.62 * FULL_WIDTH, 3.4) as drawing:
        axes = drawing.subplots()
        axes.grid(visible=False)
        top = max(1.0, float(np.nanmax(share)))
        mesh = _cells(axes, share.T, "OrRd", 0.0, top, edges=(edges_x, edges_y))
        _bar(drawing, mesh, axes, "runs that fail [%]")
        axes.set(xlabel=names[0], ylabel=names[1])
        return svg(drawing, "failures", "Share of failing runs over two parameters")


def _cells(axes: Any, values: Any, colours: str, low: float, top: float, *, edges: Any = None) -> Any:
    """Coloured rectangles: an image is a picture inside the SVG, which the page refuses."""
    table = np.asarray(values, dtype=float)
    x, y = edges or (np.arange(table.shape[1] + 1) - 0.5, np.arange(table.shape[0] + 1) - 0.5)
    return axes.pcolormesh(
        x, y, table, cmap=load_matplotlib().colormaps[colours].resampled(24), vmin=low, vmax=top
    )


def _bar(drawing: Any, mesh: Any, axes: Any, label: str) -> None:
    bar = drawing.colorbar(mesh, ax=axes)
    bar.solids.set_rasterized(False)
    bar.set_label(label)


def drivers_figure(summary: Summary) -> str:
    """Spearman's rank correlation of every metric with every parameter as a table in colours."""
    metrics = [m for m in summary.metrics if m.name != "saturated"]
    names = sorted({p for p, _ in metrics[0].drivers})
    table = np.array([[dict(m.drivers)[p] for p in names] for m in metrics])
    with figure(FULL_WIDTH, 3.4) as drawing:
        axes = drawing.subplots()
        axes.grid(visible=False)
        image = _cells(axes, table, "RdBu_r", -1.0, 1.0)
        axes.invert_yaxis()
        axes.set_xticks(range(len(names)), [n.replace("_", " ") for n in names], rotation=30, ha="right")
        axes.set_yticks(range(len(metrics)), [m.name.replace("_", " ") for m in metrics])
        for (row, column), value in np.ndenumerate(table):
            if abs(value) >= 0.05:
                colour = "white" if abs(value) > 0.6 else INK
                axes.text(column, row, f"{value:+.2f}", ha="center", va="center", color=colour, fontsize=7)
        _bar(drawing, image, axes, "rank correlation")
        return svg(drawing, "drivers", "Rank correlation of metrics with parameters")
