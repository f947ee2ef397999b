"""The tournament in sentences and as Markdown."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fraclink._campaign.tournament import Standing, Tournament

__all__ = ["markdown", "sentences"]

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
        s.name if s.passed else f"{s.name} (failed)",
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
    """Explain a rival that passes although its linear loop is unstable."""
    lines = []
    for s in result.standings:
        if s.growth == 0.0 or not s.passed:
            continue
        bounded = (
            f"the voltage limit, reached in {100 * s.saturated:.2g} % of the periods, bounds it"
            if s.saturated > 0.0
            else "friction holds the oscillation while it is small"
        )
        lines.append(
            f"- {s.name}: the linear loop on the twin is unstable, e-fold in {1.0 / s.growth:.2g} s; in "
            f"these runs {bounded}. It is not a design to ship, and wins no figure."
        )
    return ["", "Unstable linear loop, although the runs passed:", "", *lines] if lines else []


def sentences(result: Tournament) -> tuple[str, ...]:
    """Return a sentence for every figure: where fraclink is best, and where a rival is better."""
    winners, first = result.winners(), result.standings[0]
    if not winners:
        return ("no figure has a winner: no design passes with a stable linear loop",)
    if len(result.standings) == 1:
        return (f"{first.name} ran alone: nothing to compare with",)
    made = []
    for name, winner in winners.items():
        words = name.replace("_", " ")
        best = min(float(getattr(s, name)) for s in result.standings if s.sound)
        own = float(getattr(first, name))
        if first.name in winner:
            also = [w for w in winner if w != first.name]
            shared = f", with {', '.join(also)}" if also else ""
            made.append(f"{words}: {first.name} is best ({_figure(name, own)}){shared}")
        else:
            reached = f"{_figure(name, best)} against {_figure(name, own)}"
            made.append(f"{words}: better than fraclink: {', '.join(winner)} ({reached})")
    return tuple(made)


def _figure(name: str, value: float) -> str:
    if math.isinf(value):
        return "never"
    if name in ("residual_vibration", "offset_error", "motor_reference_noise"):
        return f"{1e3 * value if value > 1e-9 else 0.0:.3g} mrad"
    if name in ("settling_time", "worst_settling"):
        return f"{value:.3g} s"
    return f"{100 * value:.2g} %" if name in ("overshoot", "saturated") else f"{value:.3g}"


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
