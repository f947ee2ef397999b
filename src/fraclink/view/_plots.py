"""Plots of steps, margins over the payload, the phase budget and the timing of a run,
in matplotlib axes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from fraclink._design.assess import MarginCurve, PhaseShare
from fraclink.errors import FieldError
from fraclink.view._drawing import Figure, Panel
from fraclink.view._loops import budget_figure, margin_curves_figure
from fraclink.view._marks import Bars, Curve, Mark, Upright
from fraclink.view._matplotlib import on_axes
from fraclink.view._responses import line_of, named
from fraclink.view._scales import POINTS, Scale
from fracsys._fractional import FractionalTransferFunction
from fracsys._loops import as_loop
from fracsys._response import step_response
from fracsys._stability import poles

if TYPE_CHECKING:
    from fraclink.lab._run import RealtimeRun

__all__ = ["latency", "margins_against_payload", "phase_shares", "step_plot"]

_TIMES = 8.0  # time constants of the slowest pole, after which 3e-4 is left


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
    names = named(systems, labels)
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
    time = np.linspace(0.0, duration, POINTS)
    curves = [
        Curve(time, step_response(system, time).output, line_of(k), name)
        for k, (system, name) in enumerate(zip(systems, names, strict=True))
    ]
    figure = Figure(
        "step",
        "Step responses",
        (Panel("step response", curves, 230.0),),
        "time [s]",
    )
    return on_axes(figure, ax, **style)


def _duration(system: FractionalTransferFunction) -> float:
    """Eight time constants of the slowest stable pole, or of the lowest corner if there
    is none.
    """
    delay = max(t.delay for t in system.numerator)
    if not any(t.delay for t in system.denominator):
        # Fractional systems finally decay like a power of time, without a time
        # constant; eight time constants of the slowest exponential show everything
        # before that tail.
        rates = -poles(system).real
        if np.any(rates > 0):
            return float(_TIMES / rates[rates > 0].min()) + 2 * delay
    # Without a stable pole, as for 1/(s^0.5 + 1), the lowest corner frequency is the
    # only time scale.
    low, _ = as_loop(system, None).span
    return _TIMES / math.exp(low) + 2 * delay


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
    >>> from fraclink.view import margins_against_payload
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
    return on_axes(margin_curves_figure(curves, payloads, wanted), ax)


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
    >>> from fraclink.view import phase_shares
    >>> axis = phase_shares([PhaseShare("link", -2.9), PhaseShare("derivative", 1.0)])
    >>> [text.get_text() for text in axis.get_yticklabels()][-1]
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
    return on_axes(budget_figure(shares), ax)


_BINS = 80  # over about four decades: a factor of 1.12 each
_LEAST = 1e-7  # [s]: a monotonic clock read twice resolves no shorter time


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
    >>> controller = fl.Controller(derivative_gain=0.069876, derivative_order=0.612197, link=rig.model)
    >>> law = fl.discretize(controller, rig.period, order=4)
    >>> at_rest = Callback(read=lambda: (0.0, 0.0), write=lambda command: None)
    >>> run = run_realtime(law, fl.extend.hold(0.0), at_rest, duration=0.04, priority=0, lock_memory=False)
    >>> latency(run).get_xlabel()
    'time [µs]'
    """
    # Up to twice the largest time, however late: every period must have its bar.
    times = {"wake-up latency": run.latency, "computing time": run.work}
    ends = (float(np.max(x, initial=0.0)) for x in times.values())
    bins = 1e6 * np.geomspace(_LEAST, 2 * max(run.period, *ends), _BINS)
    # A time of zero has no place on a logarithmic axis and counts as the smallest one,
    # so that no period is lost.
    marks: list[Mark] = [
        Bars(bins, np.histogram(1e6 * np.maximum(x, _LEAST), bins)[0], line, name, 0.5)
        for line, (name, x) in enumerate(times.items(), 1)
    ]
    marks.append(Upright(1e6 * run.period, "period"))
    most = 10 ** math.ceil(math.log10(max(len(run.latency), 1)) + 0.1)
    panel = Panel("periods", marks, 230.0, Scale(0.5, most, log=True))
    x = Scale(float(bins[0]), float(bins[-1]), log=True)
    description = "How late the loop woke up, and how long its work took"
    return on_axes(Figure("latency", description, (panel,), "time [µs]", scale=x), ax)
