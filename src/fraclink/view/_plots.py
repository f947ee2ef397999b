"""Plots of margins over the payload and of the phase budget, in matplotlib axes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from fraclink._design.assess import MarginCurve, PhaseShare
from fraclink.errors import FieldError
from fraclink.view._loops import budget_figure, margin_curves_figure
from fraclink.view._matplotlib import on_axes

__all__ = ["margins_against_payload", "phase_shares"]


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
            "one curve or more",
            "call margin_curve",
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
            "one share or more",
            "call phase_budget",
        )
    return on_axes(budget_figure(shares), ax)
