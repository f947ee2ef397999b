"""Stiction: the motor stands still though it is driven."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.experiment import Experiment
from fraclink._logs.readers import converter_step
from fraclink.findings import Finding

__all__ = ["stiction"]

_WINDOW = 0.05  # s: over less, a slow motion cannot be told from a standstill by a coarse encoder
_SHORTEST = 0.02  # s: a standstill shorter than that is a reversal
_DRIVEN = 0.02  # of the largest voltage: less is an idle amplifier's offset


def _longest_run(mask: NDArray[np.bool_]) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate(([0], mask.astype(np.int8), [0]))))
    return int((edges[1::2] - edges[::2]).max()) if edges.size else 0


def _still(angle: NDArray[np.float64], window: int, reach: float) -> NDArray[np.bool_]:
    """Where the angle moves by no more than `reach` within `window` samples around."""
    moves = np.abs(angle[window:] - angle[:-window])
    still = np.zeros(angle.size, dtype=bool)
    still[window // 2 : window // 2 + moves.size] = moves <= reach
    return still


def stiction(experiment: Experiment) -> Iterator[Finding]:
    """A motor that stands still under voltage, with the voltage that did not move it.

    Without a voltage a standstill cannot be told from a motor that was asked to stand still.
    """
    if experiment.voltage is None:
        return
    step = converter_step(experiment.motor_angle)
    still = _still(experiment.motor_angle, max(3, round(_WINDOW / experiment.period)), 1.5 * step)
    driven = np.abs(experiment.voltage) > _DRIVEN * float(np.abs(experiment.voltage).max())
    shortest = max(5, round(_SHORTEST / experiment.period))
    stuck = still & driven
    if not driven.any() or _longest_run(stuck) < shortest:
        return
    share = float(stuck.sum() / driven.sum())
    held = float(np.quantile(np.abs(experiment.voltage[stuck]), 0.95))
    yield Finding(
        "W232",
        "warning" if share > 0.1 else "info",
        f"the motor stands still in {100 * share:.3g} % of its driven time, up to about {held:.3g} V",
        {"share": share, "voltage": held, "longest_s": _longest_run(stuck) * experiment.period},
        "stiction: compensate it in the motor loop; the model of the link is not touched by it",
    )
