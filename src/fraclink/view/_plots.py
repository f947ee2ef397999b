"""Plots of loops, responses and designs: each draws into `ax` (or new axes) and returns
the axes.

Conventions of python-control: dB, degrees, rad/s, one curve for each system. Unlike
there, the grid refines itself where the drawn curve bends, and the phase starts on the
sheet of the low-frequency slope: a lead s^0.65 is drawn at 58.5° and not at −301.5°.
matplotlib is imported at the first plot.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from fraclink._design.assess import MarginCurve, PhaseShare
from fraclink.errors import FieldError
from fraclink.view._axes import finish, labelled, new_axes, tint
from fraclink.view._bode import bode, margin_plot
from fraclink.view._planes import nichols, nyquist
from fracsys._fractional import FractionalTransferFunction
from fracsys._loops import FractionalLoop
from fracsys._response import step_response
from fracsys._stability import poles

if TYPE_CHECKING:
    from fraclink.lab._run import RealtimeRun

__all__ = [
    "bode",
    "latency",
    "margin_plot",
    "margins_against_payload",
    "nichols",
    "nyquist",
    "phase_shares",
    "step_plot",
]

_POINTS = 1000
_TIMES = 8.0  # time constants of the slowest pole: what is left of it is 3e-4


def step_plot(
    *systems: FractionalTransferFunction,
    duration: float | None = None,
    ax: Any = None,
    labels: Sequence[str] | None = None,
    **style: Any,
) -> Any:
    """Draw exact responses to a unit step from rest.

    Parameters
    ----------
    *systems
        Proper.
    duration
        Length of the time axis [s], > 0; without it eight time constants of the slowest
        pole.
    ax
        axes to draw into; new ones without.
    labels
        One for each system, shown in a legend.
    **style
        Passed to `Axes.plot`.

    Examples
    --------
    >>> from fracsys._fractional import s
    >>> axis = step_plot(100 / (s**1.92 + 100), duration=2.0)
    >>> axis.get_xlabel()
    'time [s]'
    """
    named = labelled(systems, labels)
    if duration is None:
        duration = max(_duration(system) for system in systems)
    if not (math.isfinite(duration) and duration > 0):
        raise FieldError(
            "duration",
            duration,
            "not a length of time",
            allowed="> 0 s",
            remedy="give the seconds to show",
        )
    ax = new_axes() if ax is None else ax
    time = np.linspace(0.0, duration, _POINTS)
    for system, label in named:
        ax.plot(time, step_response(system, time).output, label=label, **style)
    ax.set(xlabel="time [s]", ylabel="step response", xlim=(0, duration))
    return finish(ax, labels)


def _duration(system: FractionalTransferFunction) -> float:
    """Eight time constants of the slowest stable pole; of the lowest corner where there
    is none.
    """
    delay = max(t.delay for t in system.numerator)
    if not any(t.delay for t in system.denominator):
        # Fractional systems decay at last like a power of time, which has no time
        # constant; eight of the slowest exponential show what is not that tail.
        rates = -poles(system).real
        if np.any(rates > 0):
            return float(_TIMES / rates[rates > 0].min()) + 2 * delay
    # Without a stable pole, as for 1/(s^0.5 + 1), the lowest corner frequency is the
    # only time there is.
    low, _ = FractionalLoop.of(system, None).span
    return _TIMES / math.exp(low) + 2 * delay


_NAMES = {
    "ideal": "L: Ĉ·G alone",
    "motor": "LM: with filter and M(s)",
    "loop": "with hold and delay, too",
    "sampled": "sampled, with the shipped law",
}
# The sampled loop lies on the continuous one to a fraction of a degree: dots on a line
# show both.
_STYLES = {"ideal": ":", "motor": "--", "loop": "-", "sampled": "."}


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
    curves
        From `margin_curve`. A margin below zero is that of an unstable loop.
    payloads
        (lightest, heaviest) [kg] of the design, shaded.
    wanted
        The phase margin asked for [rad], a thin line.
    ax
        axes to draw into; new ones without.

    Examples
    --------
    >>> import fraclink as fl
    >>> from fraclink._design.assess import margin_curve
    >>> from fraclink.view._plots import margins_against_payload
    >>> rig = fl.Rig.named("paper-2023")
    >>> design = fl.design(rig.model, rig, gain_crossover=12.0, phase_margin=fl.deg(50))
    >>> axis = margins_against_payload([margin_curve(design, [0.02, 0.03, 0.04])])
    >>> axis.get_ylabel()
    'phase margin [°]'
    """
    if not curves:
        raise FieldError(
            "curves",
            "none",
            "empty",
            allowed="one curve or more",
            remedy="call margin_curve",
        )
    ax = new_axes() if ax is None else ax
    if payloads is not None:
        ax.axvspan(*(1e3 * mass for mass in payloads), color=tint(ax, "zone"), zorder=0)
    if wanted is not None:
        ax.axhline(math.degrees(wanted), color=tint(ax, "quiet"), linewidth=0.8)
    ax.axhline(0.0, color=tint(ax, "ink"), linewidth=0.8)
    for curve in curves:
        ax.plot(
            1e3 * np.asarray(curve.payload),
            np.degrees(curve.phase_margin),
            _STYLES.get(curve.kind, "-"),
            markersize=4,
            **({"color": tint(ax, "ink")} if curve.kind == "sampled" else {}),
            label=_NAMES.get(curve.kind, curve.kind),
        )
    ax.set(xlabel="payload [g]", ylabel="phase margin [°]")
    return finish(ax, [curve.kind for curve in curves])


def phase_shares(shares: Sequence[PhaseShare], *, ax: Any = None) -> Any:
    """Draw the phase budget as a waterfall: from 180° down to the phase margin.

    Parameters
    ----------
    shares
        From `phase_budget`.
    ax
        axes to draw into; new ones without.

    Examples
    --------
    >>> from fraclink._design.assess import PhaseShare
    >>> from fraclink.view._plots import phase_shares
    >>> axis = phase_shares([PhaseShare("link", -2.9), PhaseShare("derivative", 1.0)])
    >>> [text.get_text() for text in axis.get_xticklabels()][-1]
    'phase margin'
    """
    if not shares:
        raise FieldError(
            "shares",
            "none",
            "empty",
            allowed="one share or more",
            remedy="call phase_budget",
        )
    ax = new_axes() if ax is None else ax
    level, names = 180.0, ["180°", *(share.element for share in shares), "phase margin"]
    ax.bar(0, level, color=tint(ax, "rule"))
    for place, share in enumerate(shares, start=1):
        step = math.degrees(share.phase)
        ax.bar(
            place,
            step,
            bottom=level,
            color=tint(ax, "line-2" if step < 0.0 else "line-1"),
        )
        _label(ax, place, max(level, level + step), f"{step:+.1f}°")
        level += step
    ax.bar(len(shares) + 1, level, color=tint(ax, "line-3"))
    _label(ax, len(shares) + 1, max(level, 0.0), f"{level:.1f}°")
    ax.axhline(0.0, color=tint(ax, "ink"), linewidth=0.8)
    ax.set_xticks(range(len(names)), names, rotation=25, ha="right")
    ax.set(ylabel="phase [°]")
    ax.set_ylim(top=195.0)
    ax.grid(True, axis="y", color=tint(ax, "faint"))
    ax.set_axisbelow(True)
    return ax


def _label(ax: Any, place: int, top: float, text: str) -> None:
    ax.annotate(
        text, (place, top), (0, 3), textcoords="offset points", ha="center", fontsize=8
    )


_BINS = 80  # over some four decades: a factor of 1.12 each
_LEAST = 1e-7  # [s]: below, a monotonic clock read twice says nothing


def latency(run: RealtimeRun, *, ax: Any = None) -> Any:
    """Draw how late the loop woke up and how long its work took, as histograms on
    logarithmic axes.

    What counts is the tail: one late period in a thousand is a bar of its own. The
    period is a dashed line; latency and work together must stay left of it.

    Parameters
    ----------
    run
        From `run_realtime`.
    ax
        axes to draw into; new ones without.

    Examples
    --------
    >>> import fraclink as fl
    >>> from fraclink.lab._connections import Callback
    >>> from fraclink.lab._loop import run_realtime
    >>> rig = fl.Rig.named("paper-2023")
    >>> law = fl.discretize(fl.Controller(gain=0.069876, order=0.612197, link=rig.model), rig.period, order=4)
    >>> at_rest = Callback(read=lambda: (0.0, 0.0), write=lambda command: None)
    >>> run = run_realtime(law, fl.extend.hold(0.0), at_rest, duration=0.04, priority=0, lock_memory=False)
    >>> latency(run).get_xlabel()
    'time [µs]'
    """
    ax = new_axes() if ax is None else ax
    # Up to twice the largest time, be it late: every period must have its bar.
    longest = max(
        run.period, *(float(np.max(x, initial=0.0)) for x in (run.latency, run.work))
    )
    bins = 1e6 * np.geomspace(_LEAST, 2 * longest, _BINS)
    for label, values in (
        ("wake-up latency", run.latency),
        ("computing time", run.work),
    ):
        # A time of zero has no place on a logarithmic axis and counts as the smallest:
        # no period is lost.
        ax.hist(1e6 * np.maximum(values, _LEAST), bins=bins, label=label, alpha=0.8)
    ax.axvline(
        1e6 * run.period,
        color=tint(ax, "quiet"),
        linestyle="--",
        linewidth=1.0,
        label="period",
    )
    # Limits before scales: an axis that scales itself warns of a run that ended before
    # its first period.
    ax.set_ylim(0.5, 10 ** math.ceil(math.log10(max(len(run.latency), 1)) + 0.1))
    ax.set(xscale="log", yscale="log", xlabel="time [µs]", ylabel="periods")
    ax.legend(loc="best", fontsize="small")
    return ax
