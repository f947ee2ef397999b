"""The true sampled loop about −1 over payload and delay: how near it comes, and where it is unstable."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fraclink._design import Design
from fraclink._law import Law
from fraclink._law.requirement import margins_of

__all__ = ["swept"]

Real = NDArray[np.float64]

_PAYLOADS, _DELAYS = 11, 8  # points of the map: 6 ms each
_LIGHTER, _HEAVIER, _LATER = (
    0.5,
    1.5,
    6,
)  # of the payloads designed for; periods beyond the delay
_POINTS = 400  # of a curve
_UNSTABLE = 1.0


def swept(design: Design, law: Law) -> tuple[dict[str, Any], dict[str, Real]]:
    """Return the map of −|1 + L| over payload and computation delay, 1 where it is unstable; and curves.

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
    head = {"three": three, "payloads": payloads, "delays": own + more, "near": rows}
    return head, {"sweep_x": values.real, "sweep_y": values.imag}


def _plant(design: Design, payload: float, late: float) -> Any:
    plant = design.sampled_plant(design.natural_frequency(payload))
    return replace(plant, delay=plant.delay + late)


def _distance(design: Design, law: Law, payload: float, late: float) -> float:
    found = margins_of(law.frequency_response, _plant(design, payload, late))
    return -found.modulus_margin if found.stable else _UNSTABLE
