"""A discrete rational transfer function in parallel form, with its zeros at z = 1 kept as factors."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fraclink._systems.rational.minimax import PartialFractions
from fraclink.errors import FieldError

__all__ = ["DiscreteRational"]

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class DiscreteRational:
    """H(z) = (1 − z⁻¹)^m · (d + Σ g_i/(z − p_i) + ½ Σ [c_j/(z − q_j) + c̄_j/(z − q̄_j)]).

    With v[k] = (1 − z⁻¹)^m u[k] the recursion is

        y[k] = d v[k] + Σ g_i x_i[k] + Re Σ c_j w_j[k]
        x_i[k+1] = p_i x_i[k] + v[k],   w_j[k+1] = q_j w_j[k] + v[k]

    Differencing first makes H(1) = 0 exactly in any arithmetic.

    Attributes
    ----------
    period : float
        Sampling period [s].
    zeros_at_one : int
        m, the zeros at z = 1 kept as factors.
    feedthrough : float
        d.
    decays, gains : ndarray, shape (n,)
        Real poles p_i in (−1, 1) and their residues g_i.
    pole_decays, pole_gains : ndarray of complex, shape (k,)
        One pole q_j of each pair (Im q > 0, |q| < 1) and its c_j.
    band : tuple of float
        Lowest and highest frequency [rad/s] of the fit.
    error_db, error_deg : float
        Largest error in the band of offset + H against offset + response, in decibels and in degrees
        (see `fit_discrete`).
    """

    period: float
    zeros_at_one: int
    feedthrough: float
    decays: Real
    gains: Real
    pole_decays: Complex
    pole_gains: Complex
    band: tuple[float, float]
    error_db: float = math.nan
    error_deg: float = math.nan

    def __post_init__(self) -> None:
        for name in ("decays", "gains", "pole_decays", "pole_gains"):
            kind = complex if name.startswith("pole") else float
            array = np.array(getattr(self, name), dtype=kind).reshape(-1)
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    @property
    def order(self) -> int:
        """Number of poles, which is the number of states without those of the differences."""
        return len(self.decays) + 2 * len(self.pole_decays)

    @property
    def poles(self) -> Complex:
        """All poles in the z-plane, conjugates included."""
        return np.concatenate([self.decays, self.pole_decays, self.pole_decays.conj()])

    def __call__(self, frequency: ArrayLike) -> Complex:
        """H(e^(jωT)) at frequencies ω [rad/s], shape kept."""
        w = np.asarray(frequency, dtype=float)
        z = np.exp(1j * w * self.period)[..., None]
        inner = self.feedthrough + (self.gains / (z - self.decays)).sum(-1)
        inner = inner + 0.5 * (self.pole_gains / (z - self.pole_decays)).sum(-1)
        inner = inner + 0.5 * (self.pole_gains.conj() / (z - self.pole_decays.conj())).sum(-1)
        # 1 − e^(−jθ) = 2j sin(θ/2) e^(−jθ/2) keeps its relative precision at the lowest frequencies.
        half = 0.5 * w * self.period
        return np.asarray((2j * np.sin(half) * np.exp(-1j * half)) ** self.zeros_at_one * inner)

    def filter(self, samples: ArrayLike) -> Real:
        """Response [any unit] to samples u[0], u[1], … from rest, by the recursion above."""
        v = np.asarray(samples, dtype=float)
        if v.ndim != 1:
            raise FieldError(
                "samples",
                v.shape,
                "not one signal",
                allowed="shape (N,)",
                remedy="filter one signal at a time",
            )
        for _ in range(self.zeros_at_one):
            v = np.diff(v, prepend=0.0)
        y = self.feedthrough * v
        x, w = np.zeros(len(self.decays)), np.zeros(len(self.pole_decays), dtype=complex)
        for k, drive in enumerate(v):
            y[k] += self.gains @ x + (self.pole_gains @ w).real
            x, w = self.decays * x + drive, self.pole_decays * w + drive
        return y

    @classmethod
    def from_fractions(
        cls, fit: PartialFractions, *, period: float, zeros_at_one: int, band: tuple[float, float]
    ) -> DiscreteRational:
        """Map partial fractions on the plane x = (z − 1)/(z + 1) = tanh(sT/2) back to z."""
        sigma, q = np.exp(fit.real_logs), fit.poles_of_pairs()
        real, pair = fit.real_gains * sigma / (1 + sigma), fit.pair_gains * q / (1 + q)
        decays, turned = (1 - sigma) / (1 + sigma), (1 - q) / (1 + q)
        gains = pair * (1 + turned)
        below = turned.imag < 0
        return cls(
            period=period,
            zeros_at_one=zeros_at_one,
            feedthrough=float(fit.direct + real.sum() + pair.real.sum()),
            decays=decays,
            gains=real * (1 + decays),
            pole_decays=np.where(below, turned.conj(), turned),
            pole_gains=np.where(below, gains.conj(), gains),
            band=band,
        )
