"""What the twin's sensors make of the truth: counts, steps, noise, offset, drift, delay, limits."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fraclink._validate import checked_between, checked_whole
from fraclink.errors import FieldError

__all__ = ["Sensors"]

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Sensors:
    """Encoder at the hub and strain gauge at the base of the link.

    Parameters
    ----------
    counts_per_revolution
        encoder counts per turn of the hub, None for a continuous angle
    gauge_noise
        standard deviation of white noise [N·m], >= 0
    gauge_offset
        constant error [N·m]
    gauge_drift
        its growth [N·m/s]
    gauge_quantum
        resolution of the converter [N·m], 0 for none
    gauge_limit
        readings are clipped to ± this [N·m], None for no limit
    gauge_delay
        delay of the strain amplifier [s], >= 0

    >>> import numpy as np
    >>> Sensors(gauge_quantum=0.1, gauge_offset=0.02).gauge(np.array([0.11, 0.19]), period=0.004)
    array([0.1, 0.2])
    """

    counts_per_revolution: int | None = None
    gauge_noise: float = 0.0
    gauge_offset: float = 0.0
    gauge_drift: float = 0.0
    gauge_quantum: float = 0.0
    gauge_limit: float | None = None
    gauge_delay: float = 0.0

    def __post_init__(self) -> None:
        if self.counts_per_revolution is not None:
            # An encoder's lines count fourfold, and the gear multiplies them.
            checked_whole("counts_per_revolution", self.counts_per_revolution, 4, 2**53, "counts")
        off = "0 switches it off"
        for field, unit in (("gauge_noise", "N·m"), ("gauge_quantum", "N·m"), ("gauge_delay", "s")):
            checked_between(field, getattr(self, field), 0.0, 1e6, unit, remedy=off)
        for field, unit in (("gauge_offset", "N·m"), ("gauge_drift", "N·m/s")):
            checked_between(field, getattr(self, field), -1e6, 1e6, unit, remedy=off)
        if self.gauge_limit is not None:
            checked_between(
                "gauge_limit", self.gauge_limit, 0.0, 1e6, "N·m", open_low=True, remedy="None switches it off"
            )

    @property
    def angle_quantum(self) -> float:
        """Angle of one encoder count [rad], 0 for a continuous angle."""
        return 2.0 * math.pi / self.counts_per_revolution if self.counts_per_revolution else 0.0

    def encoder(self, angle: Vector) -> Vector:
        """Return the angle as the encoder counts it [rad]: the last count passed."""
        if not self.counts_per_revolution:
            return angle.copy()
        # A count changes at the edge of a line, so the reading is a floor; the offset of half a count that a
        # floor has on average goes with the zeroing of the encoder.
        quantum = self.angle_quantum
        return np.asarray(np.floor(angle / quantum + 0.5) * quantum)

    def gauge(
        self,
        torque: Vector,
        *,
        period: float,
        start: float = 0.0,
        generator: np.random.Generator | None = None,
    ) -> Vector:
        """Return the gauge's reading of a torque that is already delayed [N·m]."""
        time = start + period * np.arange(torque.size)
        reading = torque + self.gauge_offset + self.gauge_drift * time
        if self.gauge_noise > 0.0:
            if generator is None:
                raise FieldError(
                    "generator", None, "missing", allowed="a numpy Generator", remedy="give a seed"
                )
            reading = reading + self.gauge_noise * generator.standard_normal(torque.size)
        if self.gauge_limit is not None:
            reading = np.clip(reading, -self.gauge_limit, self.gauge_limit)
        if self.gauge_quantum > 0.0:
            reading = np.round(reading / self.gauge_quantum) * self.gauge_quantum
        return np.asarray(reading)
