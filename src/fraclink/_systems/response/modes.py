"""The noun `DiscreteModes`: a held response at a period as a recursion of exponential modes."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fraclink import _kernels
from fraclink._systems.response.quotient import Complexes

__all__ = ["DiscreteModes"]

Reals = NDArray[np.float64]


@dataclass(frozen=True)
class DiscreteModes:
    """Exact held response of G at the samples, with O(modes) memory.

        y[k] = direct·v[k] + first·v[k-1] + Σ gains_i x_i[k] + Re Σ pole_gains_j z_j[k],   v[k] = u[k - lag]
        x_i[k+1] = decays_i x_i[k] + v[k],   z_j[k+1] = pole_decays_j z_j[k] + v[k],   x, z = 0 at rest

    `hold` is "zero" (u is constant from sample to sample) or "first" (straight lines from sample to sample,
    the first one from u[-1] = 0; with a delay between samples y[k] then has early·v[k+1] besides). Valid for
    `span` [s] after a change of the input; `tolerance` is the error of the step response relative to its
    peak, as requested. `decays` = exp(`log_decays`): the logarithms hold what a slow mode's decay, near 1,
    has lost to rounding. An integrator is a real mode with a decay of exactly 1.
    """

    period: float
    hold: str
    direct: float
    first: float
    log_decays: Reals
    gains: Reals
    pole_log_decays: Complexes
    pole_gains: Complexes
    span: float
    lag: int = 0
    early: float = 0.0
    tolerance: float = 1e-12
    decays: Reals = field(init=False)
    pole_decays: Complexes = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "decays", np.exp(self.log_decays))
        object.__setattr__(self, "pole_decays", np.exp(self.pole_log_decays))
        for name in ("log_decays", "gains", "pole_log_decays", "pole_gains", "decays", "pole_decays"):
            getattr(self, name).flags.writeable = False

    @property
    def count(self) -> int:
        """Number of real modes plus two for each complex pair: the doubles of state."""
        return len(self.gains) + 2 * len(self.pole_gains)

    def respond(self, u: Reals, *, initial: Reals | None = None) -> Reals:
        """Return y for the samples u, from rest (or from `initial`: x, then z as re, im pairs)."""
        start = np.zeros(self.count) if initial is None else initial
        values = np.ascontiguousarray(u, np.float64)
        seen = max(len(values) - self.lag, 0)
        held = np.concatenate((np.zeros(len(values) - seen), values[:seen])) if self.lag else values
        output: Reals = _kernels.modes_response(
            held,
            self.direct,
            self.first,
            self.log_decays,
            self.gains,
            self.pole_log_decays,
            self.pole_gains,
            start,
        )
        if self.early and self.lag <= len(values):
            output[self.lag - 1 :] += self.early * values[: len(values) - self.lag + 1]
        return output

    def frequency_response(self, frequency: Reals) -> Complexes:
        """Return the pulse transfer function at e^(jωT), ω = `frequency` [rad/s]."""
        shift = np.exp(-1j * np.asarray(frequency, np.float64) * self.period)
        total = self.early / shift + self.direct + self.first * shift
        for gain, decay in zip(self.gains, self.decays, strict=True):
            total = total + gain * shift / (1.0 - decay * shift)
        for pole_gain, pole in zip(self.pole_gains, self.pole_decays, strict=True):
            total = total + 0.5 * pole_gain * shift / (1.0 - pole * shift)
            total = total + 0.5 * np.conj(pole_gain) * shift / (1.0 - np.conj(pole) * shift)
        result: Complexes = np.asarray(total * shift**self.lag, np.complex128)
        return result
