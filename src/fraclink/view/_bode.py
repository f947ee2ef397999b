"""Bode plots: magnitude and phase of loops, and a loop's crossings and margins marked
in them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fraclink.errors import FieldError
from fraclink.view._axes import LoopCurve, labelled, new_axes, sample, tint
from fracsys._margins import Margins
from fracsys._margins import margins as find_margins

__all__ = ["bode", "margin_plot"]

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
    *systems
        transfer functions, functions of s = jω, or python-control systems.
    ax
        Magnitude and phase axes to draw into; new ones are made without.
    labels
        One for each system, shown in a legend.
    frequency
        Grid [rad/s]; without it the grid is chosen and refined where the curve bends.
    limit
        Highest frequency [rad/s], such as the Nyquist frequency.
    **style
        Passed to `Axes.plot`.

    Examples
    --------
    >>> from fracsys._fractional import s
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


def margin_plot(
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
    loop
        The open loop.
    ax, limit, frequency, **style
        As in `bode`.

    Examples
    --------
    >>> axes = margin_plot(lambda s: 4 / (s * (s + 1) * (s + 2)))
    >>> axes[0].get_title()
    'phase margin 11.42° at 1.143 rad/s'
    """
    found = find_margins(loop, limit=limit)
    curve = sample(loop, frequency, limit, _as_drawn)
    axes = _two_axes(ax)
    _draw(axes, curve, None, {"color": tint(axes[0], "ink"), "linewidth": 1.3, **style})
    axes[0].axhline(0.0, color=tint(axes[0], "quiet"), linewidth=0.8)
    phase = np.degrees(curve.phase)
    for crossing in found.gain_crossings:
        _mark_gain(axes, crossing.frequency, crossing.phase_margin, curve, phase)
    for place in found.phase_crossings:
        _mark_phase(axes, place.frequency, place.gain_margin, curve, phase)
    places = [c.frequency for c in found.gain_crossings] + [
        c.frequency for c in found.phase_crossings
    ]
    # The automatic grid runs over every corner of the loop; what decides on stability
    # lies around the crossings.
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


def _mark_gain(
    axes: Any, frequency: float, margin: float, curve: LoopCurve, phase: Real
) -> None:
    at = float(np.interp(math.log(frequency), np.log(curve.frequency), phase))
    # The multiple of −180° that the margin is measured from on the sheet that is drawn.
    line = at - math.degrees(margin)
    # Where a resonance rises through 0 dB the phase is far from −180° on either side:
    # neither good nor bad.
    name = (
        "quiet" if abs(margin) > 0.5 * math.pi else "line-2" if margin < 0 else "line-3"
    )
    color = tint(axes[0], name)
    axes[0].plot([frequency], [0.0], "o", color=color, markersize=4)
    axes[1].plot([frequency, frequency], [line, at], "-", color=color, linewidth=1.6)
    axes[1].plot([frequency], [at], "o", color=color, markersize=4)
    axes[1].axhline(line, color=tint(axes[1], "quiet"), linewidth=0.8)
    axes[1].annotate(
        f"{math.degrees(margin):.1f}°",
        (frequency, 0.5 * (line + at)),
        textcoords="offset points",
        xytext=(4, 0),
        fontsize="small",
        color=color,
        va="center",
    )


def _mark_phase(
    axes: Any, frequency: float, margin: float, curve: LoopCurve, phase: Real
) -> None:
    # |L| at the crossing is the inverse of the gain margin: the bar runs from 0 dB to
    # the curve, and says by how much the gain may grow.
    level = -20 * math.log10(margin)
    color = tint(axes[0], "line-2" if margin < 1 else "line-1")
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


def _as_drawn(curve: LoopCurve) -> tuple[Real, Real]:
    """Both panels at once: their curves bend at the same places."""
    x = np.log(curve.frequency)
    decibels = np.clip(np.nan_to_num(curve.decibels, nan=0.0), *_decibel_range(curve))
    # A flat magnitude, as of a delay, must not blow its rounding up to a span that asks
    # for refinement.
    span = max(float(np.ptp(decibels)), 6.0)
    phase = np.nan_to_num(curve.phase, nan=0.0) / max(
        float(np.ptp(np.nan_to_num(curve.phase))), 0.5
    )
    return (x - x[0]) / (x[-1] - x[0]), decibels / span + 0.5 * phase


def _decibel_range(curve: LoopCurve) -> tuple[float, float]:
    """What is shown: an undamped resonance is cut 30 dB above the rest."""
    usual = np.isfinite(curve.decibels)
    if not usual.any():
        return -1.0, 1.0
    x, decibels = np.log(curve.frequency[usual]), curve.decibels[usual]
    # By the length of the axis and not by points: those crowd at the resonance.
    even = np.interp(np.linspace(x[0], x[-1], 400), x, decibels)
    # What an undamped mode reaches depends on how near the grid comes to it: two per
    # cent of the axis belong to it, and 30 dB more show that it is one.
    low, high = np.percentile(even, [1, 99])
    return max(float(decibels.min()), float(low) - 30), min(
        float(decibels.max()), float(high) + 30
    )


def _two_axes(ax: Sequence[Any] | None) -> Any:
    if ax is None:
        return new_axes(2)
    axes = np.asarray(ax, dtype=object).reshape(-1)
    if axes.size != 2:
        raise FieldError(
            "ax",
            axes.size,
            "not two axes",
            allowed="magnitude and phase axes",
            remedy="plt.subplots(2, 1)",
        )
    return axes


def _draw(
    axes: Any, curve: LoopCurve, label: str | None, style: dict[str, Any]
) -> None:
    (line,) = axes[0].semilogx(curve.frequency, curve.decibels, label=label, **style)
    axes[1].semilogx(
        curve.frequency, np.degrees(curve.phase), **{"color": line.get_color(), **style}
    )
    low, high = _decibel_range(curve)
    spare = 0.05 * (high - low) + 1.0
    # Limits stated, matplotlib no longer scales: with a second system they must hold
    # both.
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
    if high > -270.0:
        # Below lies only what delay adds where the gain is long gone: it would flatten
        # what matters.
        low = max(low, -370.0)
    # Degrees that people count in; 1e9 is for a phase of thousands of turns, which
    # matplotlib divides itself.
    step = next(
        d for d in (15, 30, 45, 90, 180, 360, 720, 1e9) if (high - low) / d <= 7
    )
    if step <= 720:
        axes[1].set_yticks(
            np.arange(math.floor(low / step), math.ceil(high / step) + 1) * step
        )
        axes[1].set_ylim(low, high)
    for axis in axes:
        axis.grid(True, which="major", color=tint(axis, "rule"))
        axis.grid(
            True, which="minor", axis="x", color=tint(axis, "faint"), linewidth=0.5
        )
