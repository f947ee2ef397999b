"""Plots of loops and responses: each draws into `ax` (or new axes) and returns the axes.

Conventions of python-control: dB, degrees, rad/s, one curve for each system. Unlike there, the grid refines
itself where the drawn curve bends, and the phase starts on the sheet of the low-frequency slope: a lead
s^0.65 is drawn at 58.5° and not at −301.5°. matplotlib is imported at the first plot.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fraclink._design.alternatives import FeasibilityMap
from fraclink._design.assess import MarginCurve, PhaseShare
from fraclink._show.curves import Curve, labelled, pyplot, sample
from fraclink._show.drawing import BLUE, FAINT, GREEN, GREY, INK, ORANGE
from fraclink._show.planes import nichols, nyquist
from fraclink._systems.fractional import FractionalTransferFunction
from fraclink._systems.loops import FractionalLoop
from fraclink._systems.margins import Margins
from fraclink._systems.margins import margins as find_margins
from fraclink._systems.response import step_response
from fraclink._systems.stability import poles
from fraclink.errors import FieldError

if TYPE_CHECKING:
    from fraclink._realtime import RealtimeRun

__all__ = [
    "bode",
    "feasibility",
    "latency",
    "margins",
    "margins_against_payload",
    "nichols",
    "nyquist",
    "phase_shares",
    "step",
]

Real = NDArray[np.float64]


def bode(
    *systems: Any,
    ax: Sequence[Any] | None = None,
    labels: Sequence[str] | None = None,
    frequency: ArrayLike | None = None,
    limit: float | None = None,
    **style: Any,
) -> Any:
    """Draw magnitude [dB] and phase [°] over frequency [rad/s].

    Parameters
    ----------
    *systems : FractionalTransferFunction, callable of s = jω, or python-control system
    ax : sequence of two Axes, optional
        Magnitude and phase axes to draw into; new ones are made without.
    labels : sequence of str, optional
        One for each system, shown in a legend.
    frequency : array_like, optional
        Grid [rad/s]; without it the grid is chosen and refined where the curve bends.
    limit : float, optional
        Highest frequency [rad/s], such as the Nyquist frequency.
    **style
        Passed to `Axes.plot`.

    Returns
    -------
    ndarray of two Axes

    Examples
    --------
    >>> from fraclink._systems.fractional import s
    >>> axes = bode(1.56 * s**1.92 / (s**1.92 + 100), labels=["30 g"])
    >>> axes[1].get_ylabel()
    'phase [°]'
    """
    named = labelled(systems, labels)
    axes = _two_axes(ax)
    for system, label in named:
        curve = sample(system, frequency, limit, _as_drawn)
        _draw(axes, curve, label, style)
    _finish(axes)
    if labels is not None:
        axes[0].legend(loc="best", fontsize="small")
    return axes


def margins(
    loop: Any,
    *,
    ax: Sequence[Any] | None = None,
    limit: float | None = None,
    frequency: ArrayLike | None = None,
    **style: Any,
) -> Any:
    """Draw a Bode plot with every gain crossing and every phase crossing marked.

    Parameters
    ----------
    loop : FractionalTransferFunction, callable of s = jω, or python-control system
        The open loop.
    ax, limit, frequency, **style
        As in `bode`.

    Returns
    -------
    ndarray of two Axes

    Examples
    --------
    >>> axes = margins(lambda s: 4 / (s * (s + 1) * (s + 2)))
    >>> axes[0].get_title()
    'phase margin 11.42° at 1.143 rad/s'
    """
    found = find_margins(loop, limit=limit)
    curve = sample(loop, frequency, limit, _as_drawn)
    axes = _two_axes(ax)
    _draw(axes, curve, None, {"color": "black", "linewidth": 1.3, **style})
    axes[0].axhline(0.0, color="0.6", linewidth=0.8)
    phase = np.degrees(curve.phase)
    for crossing in found.gain_crossings:
        _mark_gain(axes, crossing.frequency, crossing.phase_margin, curve, phase)
    for place in found.phase_crossings:
        _mark_phase(axes, place.frequency, place.gain_margin, curve, phase)
    places = [c.frequency for c in found.gain_crossings] + [c.frequency for c in found.phase_crossings]
    if places and frequency is None:  # a decade and a half beside them
        low, high = curve.frequency[[0, -1]]
        axes[0].set_xlim(max(min(places) / 30, low), min(max(places) * 30, high))
    _finish(axes)
    axes[0].set_title(_headline(found), fontsize="medium")
    return axes


def _headline(found: Margins) -> str:
    if found.critical is None:
        return f"no gain crossing; modulus margin {found.modulus_margin:.3f}"
    return f"phase margin {math.degrees(found.phase_margin):.2f}° at {found.gain_crossover:.4g} rad/s"


def _mark_gain(axes: Any, frequency: float, margin: float, curve: Curve, phase: Real) -> None:
    at = float(np.interp(math.log(frequency), np.log(curve.frequency), phase))
    # The multiple of −180° that the margin is measured from on the sheet that is drawn.
    line = at - math.degrees(margin)
    # Where a resonance rises through 0 dB the phase is far from −180° on either side: neither good nor bad.
    color = GREY if abs(margin) > 0.5 * math.pi else ORANGE if margin < 0 else GREEN
    axes[0].plot([frequency], [0.0], "o", color=color, markersize=4)
    axes[1].plot([frequency, frequency], [line, at], "-", color=color, linewidth=1.6)
    axes[1].plot([frequency], [at], "o", color=color, markersize=4)
    axes[1].axhline(line, color="0.6", linewidth=0.8)
    axes[1].annotate(
        f"{math.degrees(margin):.1f}°",
        (frequency, 0.5 * (line + at)),
        textcoords="offset points",
        xytext=(4, 0),
        fontsize="small",
        color=color,
        va="center",
    )


def _mark_phase(axes: Any, frequency: float, margin: float, curve: Curve, phase: Real) -> None:
    level = -20 * math.log10(margin)
    color = ORANGE if margin < 1 else BLUE
    at = float(np.interp(math.log(frequency), np.log(curve.frequency), phase))
    axes[0].plot([frequency, frequency], [0.0, level], "-", color=color, linewidth=1.6)
    axes[0].annotate(
        f"{-level:.1f} dB",
        (frequency, 0.5 * level),
        textcoords="offset points",
        xytext=(4, 0),
        fontsize="small",
        color=color,
        va="center",
    )
    axes[1].plot([frequency], [at], "s", color=color, markersize=3.5)


def _as_drawn(curve: Curve) -> tuple[Real, Real]:
    """Both panels at once: their curves bend at the same places."""
    x = np.log(curve.frequency)
    decibels = np.clip(np.nan_to_num(curve.decibels, nan=0.0), *_decibel_range(curve))
    span = max(float(np.ptp(decibels)), 6.0)
    phase = np.nan_to_num(curve.phase, nan=0.0) / max(float(np.ptp(np.nan_to_num(curve.phase))), 0.5)
    return (x - x[0]) / (x[-1] - x[0]), decibels / span + 0.5 * phase


def _decibel_range(curve: Curve) -> tuple[float, float]:
    """What is shown: an undamped resonance is cut 30 dB above the rest."""
    usual = np.isfinite(curve.decibels)
    if not usual.any():
        return -1.0, 1.0
    x, decibels = np.log(curve.frequency[usual]), curve.decibels[usual]
    # By the length of the axis and not by points: those crowd at the resonance.
    even = np.interp(np.linspace(x[0], x[-1], 400), x, decibels)
    low, high = np.percentile(even, [1, 99])
    return max(float(decibels.min()), float(low) - 30), min(float(decibels.max()), float(high) + 30)


def _two_axes(ax: Sequence[Any] | None) -> Any:
    if ax is None:
        _, axes = pyplot().subplots(2, 1, sharex=True, layout="constrained")
        return axes
    axes = np.asarray(ax, dtype=object).reshape(-1)
    if axes.size != 2:
        raise FieldError(
            "ax", axes.size, "not two axes", allowed="magnitude and phase axes", remedy="plt.subplots(2, 1)"
        )
    return axes


def _draw(axes: Any, curve: Curve, label: str | None, style: dict[str, Any]) -> None:
    (line,) = axes[0].semilogx(curve.frequency, curve.decibels, label=label, **style)
    axes[1].semilogx(curve.frequency, np.degrees(curve.phase), **{"color": line.get_color(), **style})
    low, high = _decibel_range(curve)
    spare = 0.05 * (high - low) + 1.0
    if axes[0].get_lines()[:-1]:
        bottom, top = axes[0].get_ylim()
        axes[0].set_ylim(min(bottom, low - spare), max(top, high + spare))
    else:
        axes[0].set_ylim(low - spare, high + spare)


def _finish(axes: Any) -> None:
    axes[0].set_ylabel("magnitude [dB]")
    axes[1].set_ylabel("phase [°]")
    axes[1].set_xlabel("frequency [rad/s]")
    low, high = axes[1].get_ylim()
    step = next(d for d in (15, 30, 45, 90, 180, 360, 720, 1e9) if (high - low) / d <= 7)
    if step <= 720:
        axes[1].set_yticks(np.arange(math.floor(low / step), math.ceil(high / step) + 1) * step)
        axes[1].set_ylim(low, high)
    for axis in axes:
        axis.grid(True, which="major", color="0.85")
        axis.grid(True, which="minor", axis="x", color="0.93", linewidth=0.5)


_POINTS = 1000
_TIMES = 8.0  # time constants of the slowest pole: what is left of it is 3e-4


def step(
    *systems: FractionalTransferFunction,
    duration: float | None = None,
    ax: Any = None,
    labels: Sequence[str] | None = None,
    **style: Any,
) -> Any:
    """Draw exact responses to a unit step from rest.

    Parameters
    ----------
    *systems : FractionalTransferFunction
        Proper.
    duration : float, optional
        Length of the time axis [s], > 0; without it eight time constants of the slowest pole.
    ax : Axes, optional
    labels : sequence of str, optional
        One for each system, shown in a legend.
    **style
        Passed to `Axes.plot`.

    Returns
    -------
    Axes

    Examples
    --------
    >>> from fraclink._systems.fractional import s
    >>> axis = step(100 / (s**1.92 + 100), duration=2.0)
    >>> axis.get_xlabel()
    'time [s]'
    """
    named = labelled(systems, labels)
    if duration is None:
        duration = max(_duration(system) for system in systems)
    if not (math.isfinite(duration) and duration > 0):
        raise FieldError(
            "duration", duration, "not a length of time", allowed="> 0 s", remedy="give the seconds to show"
        )
    if ax is None:
        _, ax = pyplot().subplots(layout="constrained")
    time = np.linspace(0.0, duration, _POINTS)
    for system, label in named:
        ax.plot(time, step_response(system, time).output, label=label, **style)
    ax.set(xlabel="time [s]", ylabel="step response", xlim=(0, duration))
    ax.grid(True, color="0.9")
    if labels is not None:
        ax.legend(loc="best", fontsize="small")
    return ax


def _duration(system: FractionalTransferFunction) -> float:
    """Eight time constants of the slowest stable pole; of the lowest corner where there is none."""
    delay = max(t.delay for t in system.numerator)
    if not any(t.delay for t in system.denominator):
        rates = -poles(system).real
        if np.any(rates > 0):
            return float(_TIMES / rates[rates > 0].min()) + 2 * delay
    low, _ = FractionalLoop.of(system, None).span
    return _TIMES / math.exp(low) + 2 * delay


_NAMES = {
    "ideal": "L: Ĉ·G alone",
    "motor": "LM: with filter and M(s)",
    "loop": "with hold and delay, too",
    "sampled": "sampled, with the shipped law",
}
# The sampled loop lies on the continuous one to a fraction of a degree: dots on a line show both.
_STYLES = {"ideal": ":", "motor": "--", "loop": "-", "sampled": "k."}
_LAG, _LEAD, _LEFT = ORANGE, BLUE, GREEN


def margins_against_payload(
    curves: Sequence[MarginCurve],
    *,
    payloads: tuple[float, float] | None = None,
    wanted: float | None = None,
    ax: Any = None,
) -> Any:
    """Draw phase margins against the payload, one line for each kind of loop (Fig. 10).

    Parameters
    ----------
    curves : sequence of MarginCurve
        From `margin_curve`. A margin below zero is that of an unstable loop.
    payloads : tuple of float, optional
        (lightest, heaviest) [kg] of the design, shaded.
    wanted : float, optional
        The phase margin asked for [rad], a thin line.
    ax : Axes, optional

    Returns
    -------
    Axes

    Examples
    --------
    >>> import fraclink as fl
    >>> from fraclink._design.assess import margin_curve
    >>> from fraclink._show.plots import margins_against_payload
    >>> rig = fl.Rig.named("paper-2023")
    >>> design = fl.design(rig.model, rig, gain_crossover=12.0, phase_margin=fl.deg(50))
    >>> axis = margins_against_payload([margin_curve(design, [0.02, 0.03, 0.04])])
    >>> axis.get_ylabel()
    'phase margin [°]'
    """
    if not curves:
        raise FieldError("curves", "none", "empty", allowed="one curve or more", remedy="call margin_curve")
    if ax is None:
        _, ax = pyplot().subplots(layout="constrained")
    if payloads is not None:
        ax.axvspan(*(1e3 * mass for mass in payloads), color="0.94", zorder=0)
    if wanted is not None:
        ax.axhline(math.degrees(wanted), color="0.5", linewidth=0.8)
    ax.axhline(0.0, color="0.2", linewidth=0.8)
    for curve in curves:
        ax.plot(
            1e3 * np.asarray(curve.payload),
            np.degrees(curve.phase_margin),
            _STYLES.get(curve.kind, "-"),
            markersize=4,
            label=_NAMES.get(curve.kind, curve.kind),
        )
    ax.set(xlabel="payload [g]", ylabel="phase margin [°]")
    ax.grid(True, color="0.9")
    ax.legend(loc="best", fontsize="small")
    return ax


def phase_shares(shares: Sequence[PhaseShare], *, ax: Any = None) -> Any:
    """Draw the phase budget as a waterfall: from 180° down to the phase margin.

    Parameters
    ----------
    shares : sequence of PhaseShare
        From `phase_budget`.
    ax : Axes, optional

    Returns
    -------
    Axes

    Examples
    --------
    >>> from fraclink._design.assess import PhaseShare
    >>> from fraclink._show.plots import phase_shares
    >>> axis = phase_shares([PhaseShare("link", -2.9), PhaseShare("derivative", 1.0)])
    >>> [text.get_text() for text in axis.get_xticklabels()][-1]
    'phase margin'
    """
    if not shares:
        raise FieldError("shares", "none", "empty", allowed="one share or more", remedy="call phase_budget")
    if ax is None:
        _, ax = pyplot().subplots(layout="constrained")
    level, names = 180.0, ["180°", *(share.element for share in shares), "phase margin"]
    ax.bar(0, level, color="0.8")
    for place, share in enumerate(shares, start=1):
        step = math.degrees(share.phase)
        ax.bar(place, step, bottom=level, color=_LAG if step < 0.0 else _LEAD)
        _label(ax, place, max(level, level + step), f"{step:+.1f}°")
        level += step
    ax.bar(len(shares) + 1, level, color=_LEFT)
    _label(ax, len(shares) + 1, max(level, 0.0), f"{level:.1f}°")
    ax.axhline(0.0, color="0.2", linewidth=0.8)
    ax.set_xticks(range(len(names)), names, rotation=25, ha="right")
    ax.set(ylabel="phase [°]")
    ax.set_ylim(top=195.0)
    ax.grid(True, axis="y", color="0.9")
    ax.set_axisbelow(True)
    return ax


def _label(ax: Any, place: int, top: float, text: str) -> None:
    ax.annotate(text, (place, top), (0, 3), textcoords="offset points", ha="center", fontsize=8)


_BINS = 80  # over some four decades: a factor of 1.12 each
_LEAST = 1e-7  # [s]: below, a monotonic clock read twice says nothing


def latency(run: RealtimeRun, *, ax: Any = None) -> Any:
    """Draw how late the loop woke up and how long its work took, as histograms on logarithmic axes.

    What counts is the tail: one late period in a thousand is a bar of its own. The period is a dashed line;
    latency and work together must stay left of it.

    Parameters
    ----------
    run : RealtimeRun
        From `fraclink._realtime.run_realtime`.
    ax : Axes, optional

    Returns
    -------
    Axes

    Examples
    --------
    >>> import fraclink as fl
    >>> from fraclink._realtime import Callback, run_realtime
    >>> rig = fl.Rig.named("paper-2023")
    >>> law = fl.discretize(fl.Controller(gain=0.069876, order=0.612197, link=rig.model), rig.period, order=4)
    >>> at_rest = Callback(read=lambda: (0.0, 0.0), write=lambda command: None)
    >>> run = run_realtime(law, fl.hold(0.0), at_rest, duration=0.04, priority=0, lock_memory=False)
    >>> latency(run).get_xlabel()
    'time [µs]'
    """
    if ax is None:
        _, ax = pyplot().subplots(layout="constrained")
    longest = max(run.period, *(float(np.max(x, initial=0.0)) for x in (run.latency, run.work)))
    bins = 1e6 * np.geomspace(_LEAST, 2 * longest, _BINS)
    for label, values in (("latency of the wake-up", run.latency), ("work of the period", run.work)):
        ax.hist(1e6 * np.maximum(values, _LEAST), bins=bins, label=label, alpha=0.8)
    ax.axvline(1e6 * run.period, color="0.3", linestyle="--", linewidth=1.0, label="period")
    ax.set(xscale="log", yscale="log", xlabel="time [µs]", ylabel="periods")
    ax.set_ylim(0.5, 10 ** math.ceil(math.log10(max(len(run.latency), 1)) + 0.1))
    ax.legend(loc="best", fontsize="small")
    return ax


_NOISE = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 300.0)
_SETTLING = (0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6, 0.8)


def feasibility(found: FeasibilityMap, *, ax: Any = None) -> Any:
    """Draw β in colour where a controller exists, with contours of noise gain and settling time.

    Parameters
    ----------
    found
        from `feasibility_map`.
    ax
        axes to draw into; new ones without.

    Examples
    --------
    >>> import fraclink as fl
    >>> from fraclink._design.alternatives import feasibility_map
    >>> rig = fl.Rig.named("paper-2023")
    >>> grid = {"gain_crossovers": np.linspace(9, 15, 6), "phase_margins": np.linspace(0.5, 1.2, 6)}
    >>> feasibility(feasibility_map(rig.model, rig, filter_order=1, **grid)).get_ylabel()
    'phase margin at the lightest payload [°]'
    """
    if ax is None:
        _, ax = pyplot().subplots(layout="constrained")
    grid = (found.gain_crossover, np.degrees(found.phase_margin))
    shade = ax.pcolormesh(*grid, np.ma.masked_invalid(found.order), cmap="Blues", shading="nearest")
    ax.figure.colorbar(shade, ax=ax, label="β")
    noise = ax.contour(*grid, np.ma.masked_invalid(found.noise_gain), _NOISE, colors=ORANGE)
    ax.clabel(noise, fmt="noise %g", fontsize=8)
    settling = ax.contour(*grid, np.ma.masked_invalid(found.settling_time), _SETTLING, colors=INK)
    ax.clabel(settling, fmt="%g s", fontsize=8)
    ax.set(
        xlabel="gain crossover ω_c at the heaviest payload [rad/s]",
        ylabel="phase margin at the lightest payload [°]",
        title="Feasible requests; orange: noise gain, black: 2π/ω_c",
    )
    ax.set_facecolor(FAINT)
    return ax
