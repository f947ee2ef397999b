"""Pictures of step 6: the sampled loop about −1 over payload and delay, and moves of arms that differ."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fraclink._campaign.arms import replay_run
from fraclink._campaign.campaign import Campaign
from fraclink._design import Design
from fraclink._law import Law
from fraclink._law.requirement import margins_of
from fraclink._show.text import grams

__all__ = ["moves_of_arms", "swept"]

Real = NDArray[np.float64]

_PAYLOADS, _DELAYS = 11, 8  # points of the map: 6 ms each
_LIGHTER, _HEAVIER, _LATER = (
    0.5,
    1.5,
    6,
)  # of the payloads designed for; periods beyond the delay
_POINTS = 400  # of a curve
_UNSTABLE = 1.0
_ARMS, _FAILED = 24, 12  # moves that are drawn, and of arms that fail: 4 ms each
_SEEN, _EVERY = 2.4, 3  # [s] of a move, and periods from point to point: a pixel


def swept(design: Design, law: Law) -> tuple[dict[str, Any], dict[str, Real]]:
    """Return the map of −|1 + L| over payload [g] and delay [ms], 1 where it is unstable; and curves.

    Curves are L on the unit circle at both ends of the range and between, without and with the delays of the
    map's middle, each as one row of real and one of imaginary parts.
    """
    low, high = design.payloads
    payloads = np.geomspace(_LIGHTER * low, _HEAVIER * high, _PAYLOADS)
    own = _plant(design, low, 0.0).delay
    more = np.linspace(-own, _LATER * law.period, _DELAYS)
    rows = [[_distance(design, law, float(mass), float(late)) for mass in payloads] for late in more]
    nyquist = np.pi / law.period
    w = np.geomspace(2e-3 * nyquist, 0.999 * nyquist, _POINTS)
    loops = []
    three = (low, 0.5 * (low + high), high)
    for mass in three:
        for late in (0.0, 0.5 * float(more[-1])):
            loops.append(law.frequency_response(w) * _plant(design, mass, late)(w))
    values = np.array(loops)
    values = np.where(np.abs(values) > 10.0, 10.0 * values / np.abs(values), values)
    head = {
        "names": [grams(mass) for mass in three],
        "payloads": 1e3 * payloads,
        "delays": 1e3 * (own + more),
        "near": rows,
    }
    return head, {"sweep_x": values.real, "sweep_y": values.imag}


def _plant(design: Design, payload: float, late: float) -> Any:
    plant = design.sampled_plant(design.natural_frequency(payload))
    return replace(plant, delay=plant.delay + late)


def _distance(design: Design, law: Law, payload: float, late: float) -> float:
    found = margins_of(law.frequency_response, _plant(design, payload, late))
    return -found.modulus_margin if found.stable else _UNSTABLE


def moves_of_arms(campaign: Campaign, failures: tuple[int, ...]) -> dict[str, Real]:
    """Return moves of arms of a campaign in percent of their goal, one row each, over `fan_t` [s].

    `fan_passed` are the first arms that pass, `fan_failed` the first that fail; without rows a curve is left
    out.
    """
    law = campaign.law
    passed = [run for run in range(min(campaign.runs, _ARMS + len(failures))) if run not in failures]
    count = round(_SEEN / law.period)
    curves: dict[str, Real] = {
        "fan_t": np.asarray(law.period * np.arange(0, count, _EVERY), dtype=np.float64)
    }
    for name, runs in (("fan_passed", passed[:_ARMS]), ("fan_failed", failures[:_FAILED])):
        moves = [replay_run(campaign, run) for run in runs]
        rows = [100.0 * move.tip_angle[:count:_EVERY] / move.reference[-1] for move in moves]
        if rows:
            curves[name] = np.clip(np.nan_to_num(np.array(rows), nan=1e3), -1e3, 1e3)
    return curves
