"""What a design is worth, drawn: margins against the payload (Fig. 10) and where the phase goes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from fraclink._design.assess import MarginCurve, PhaseShare
from fraclink._show.plots.curves import pyplot
from fraclink.errors import FieldError

__all__ = ["margins_against_payload", "phase_shares"]

_NAMES = {
    "ideal": "L: Ĉ·G alone",
    "motor": "LM: with filter and M(s)",
    "loop": "with hold and delay, too",
    "sampled": "sampled, with the shipped law",
}
# The sampled loop lies on the continuous one to a fraction of a degree: dots on a line show both.
_STYLES = {"ideal": ":", "motor": "--", "loop": "-", "sampled": "k."}
_LAG, _LEAD, _LEFT = "#c8572a", "#1f5f99", "#3b7d4f"


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
    """Draw the phase budget as a waterfall: from half a turn down to the phase margin.

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
    level, names = 180.0, ["half a turn", *(share.element for share in shares), "phase margin"]
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
