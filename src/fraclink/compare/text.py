"""The tournament as Markdown."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fraclink.compare.tournament import Standing, Tournament

__all__ = ["markdown"]

_HEAD = (
    "rival",
    "settling [s]",
    "overshoot [%]",
    "residual [mrad]",
    "offset error [mrad]",
    "noise [mrad]",
    "saturated [%]",
    "worst payload",
    "gain at mode 2",
    "linear loop",
    "Ms",
    "states",
    "products",
)


def _number(value: float, digits: int = 3) -> str:
    return "never" if math.isinf(value) else f"{value:.{digits}g}"


def _row(s: Standing) -> tuple[str, ...]:
    settled = "never" if math.isinf(s.worst_settling) else f"{s.worst_settling:.2f} s"
    return (
        s.name if s.holds else f"{s.name} (does not hold)",
        "never" if math.isinf(s.settling_time) else f"{s.settling_time:.2f}",
        f"{100 * s.overshoot:.1f}",
        f"{1e3 * s.residual_vibration:.1f}",
        _number(1e3 * s.offset_error),
        f"{1e3 * s.motor_reference_noise:.1f}",
        f"{100 * s.saturated:.1f}",
        f"{1e3 * s.worst_payload:g} g: {settled}",
        f"{s.mode_gain:.3f}",
        "stable" if s.growth == 0.0 else f"grows {s.growth:.2g}/s",
        "unstable" if math.isinf(s.peak) else f"{s.peak:.2f}",
        str(s.states),
        str(s.multiplications),
    )


def _hidden(result: Tournament) -> list[str]:
    """Why a rival holds whose linear loop does not."""
    lines = []
    for s in result.standings:
        if s.growth == 0.0 or not s.holds:
            continue
        bounded = (
            f"the voltage limit, reached in {100 * s.saturated:.2g} % of the periods, bounds it"
            if s.saturated > 0.0
            else "friction holds the oscillation while it is small"
        )
        lines.append(
            f"- {s.name}: the linear loop on the twin is unstable, e-fold in {1.0 / s.growth:.2g} s; in "
            f"these runs {bounded}. It is no design to ship, and no figure's winner."
        )
    return ["", "Unstable, though the runs hold:", "", *lines] if lines else []


def markdown(result: Tournament) -> str:
    """Return the table, who is better where, the rules of tuning and what was assumed."""
    rows = [_HEAD, tuple("---" for _ in _HEAD), *(_row(s) for s in result.standings)]
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    lines += _hidden(result)
    lines += ["", "Figure by figure:", "", *(f"- {sentence}" for sentence in result.verdicts())]
    lines += ["", "How each was tuned:", ""]
    lines += [f"- {s.name}: {s.rule} ({s.knob})" for s in result.standings]
    lines += ["", "Assumed:", "", *(f"- {note}" for note in result.notes)]
    return "\n".join(lines) + "\n"
