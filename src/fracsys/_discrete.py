"""A frequency response as a small discrete rational."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice, tee
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from fracsys._minimax import PartialFractions, Target, finish, grow, score
from fracsys.checks import Between, Complex, Real, above, ascending, rule
from fracsys.errors import FieldError

Band = Annotated[
    tuple[
        Annotated[float, above(0.0, unit="rad/s")],
        Annotated[float, above(0.0, unit="rad/s")],
    ],
    ascending(strict=True),
]
Order = Annotated[int, Between(0, 12, remedy="use order=None to choose")]

# Fraction of the tolerance that the fit may use on its grid: between the grid points
# the error is mostly up to 3 % larger.
_WITHIN = 0.97
# Above the band |H − F| may reach 2 |F| times the score; without this guard the gain
# there has no bound. On six controllers the guard costs up to two of eight states.
_GUARD = 2.0


class DiscreteFits:
    """The discrete rationals with the smallest worst error in a frequency band, one for
    each order; those of lower orders are kept, and higher ones start from them.

    The largest of |Re ε|/tolerance and |Im ε|/tolerance over the band is minimised,
    with ε = weight · (H − F)/(offset + F), whose real part is an error in nepers and
    imaginary part in radians.

    All poles are inside the unit circle. `error_db` and `error_deg` are measured on a
    finer grid.

    Parameters
    ----------
    response
        F(ω), an array of complex for an array of frequencies [rad/s].
    period
        Sampling period [s], > 0.
    band
        Lowest and highest frequency [rad/s] of the fit, 0 < low < high ≤ π/period.
    zeros_at_one
        Zeros imposed at z = 1 as factors (1 − z⁻¹)^m; 1 makes H(1) = 0 exactly.
    offset
        The error is judged on offset + H; 1 for a controller C = 1 + Ĉ fitted through
        Ĉ.
    weight
        A positive weight as a function of frequency.
    tolerance_db, tolerance_deg
        Tolerances [dB] and [°]; their ratio sets the balance between errors of modulus
        and phase.
    pairs
        Largest number of complex pairs among the poles; 0 for real poles only.
    inside
        Further frequencies [rad/s] for the grid of the fit, inside the band: where the
        response changes within a tenth of the frequency.

    Raises
    ------
    FieldError
        A band beyond the Nyquist frequency, a response that is zero or not finite.

    Examples
    --------
    >>> import numpy as np
    >>> fits = DiscreteFits(lambda w: 0.148 * (1j * w) ** 0.65 / (1 + 0.16j * w) ** 2, period=0.004,
    ...                     band=(0.05, 785.0), zeros_at_one=1, offset=1.0)
    >>> h = fits.fit(4)
    >>> h.order, h.error_db < 0.1, h.error_deg < 0.5
    (4, True, True)
    """

    def __init__(
        self,
        response: Callable[[Real], Complex],
        *,
        period: float,
        band: tuple[float, float],
        zeros_at_one: int = 0,
        offset: float = 0.0,
        weight: Callable[[Real], Real] | None = None,
        tolerance_db: float = 0.1,
        tolerance_deg: float = 0.5,
        pairs: float = math.inf,
        inside: ArrayLike = (),
    ) -> None:
        checked_band(band, period)
        within, nyquist = np.union1d(_grid(band, 80), inside), math.pi / period
        # Twenty points from the band up to the Nyquist frequency, none where the band
        # ends next to it.
        above = (
            np.linspace(band[1], nyquist, 21)[1:] * (1 - 1e-9)
            if band[1] < 0.99 * nyquist
            else np.empty(0)
        )
        # tan(ωT/2) is infinite at the Nyquist frequency
        w = np.minimum(np.concatenate([within, above]), nyquist * (1 - 1e-6))
        goal = np.asarray(response(w), complex)
        fitted = np.arange(w.size) < within.size
        # Inside the band the error is relative to the whole controller, which `offset`
        # may dominate. Above it only the size of the fitted part is guarded, and the
        # offset would mask it.
        base = np.where(fitted, offset + goal, np.abs(goal))
        if not np.all(np.isfinite(goal)) or not np.all(base):
            raise FieldError(
                "response",
                "0 or infinite",
                "not finite, or zero, at some frequency",
                "finite values that are not zero",
                "check it between the band's ends and the Nyquist frequency",
            )
        emphasis = np.where(fitted, 1.0 if weight is None else weight(w), 1.0)
        turn, half = emphasis / base, 0.5 * w * period
        factor = (2j * np.sin(half) * np.exp(-1j * half)) ** zeros_at_one
        # The error is in nepers and radians; 20/ln 10 dB and 180/π degrees per unit turn
        # it into multiples of the tolerance.
        tolerance = 20 / (math.log(10) * tolerance_db), 180 / (math.pi * tolerance_deg)
        weights = np.where(fitted, np.array(tolerance)[:, None], 1 / _GUARD)
        self.target = Target(np.tan(half), factor, turn * factor, turn * goal, weights)
        # tan(ωT/2) is infinite at the Nyquist frequency; 1.55 rad limits the mapped
        # frequency to 48.
        plane = (
            math.tan(0.5 * band[0] * period),
            math.tan(min(0.5 * band[1] * period, 1.55)),
        )
        # kept, so that each order is computed once
        (self._generations,) = tee(grow(self.target, plane, pairs=pairs), 1)
        self._response, self._offset = response, offset
        self._rational = partial(
            DiscreteRational.from_fractions,
            period=period,
            zeros_at_one=zeros_at_one,
            band=band,
        )

    def fit(self, order: int | None = None, highest: int = 8) -> DiscreteRational:
        """Return the rational of `order`; by default the one of lowest order that meets
        both tolerances, or else the best of those up to `highest`.
        """
        made = self._rational(self._best(order, highest))
        w = _grid(made.band, 400)
        ratio = np.log((self._offset + made(w)) / (self._offset + self._response(w)))
        return replace(
            made,
            error_db=float(np.max(np.abs(ratio.real)) * 20 / math.log(10)),
            error_deg=float(np.degrees(np.max(np.abs(ratio.imag)))),
        )

    def __iter__(self) -> Iterator[list[PartialFractions]]:
        """Return an iterator over the best few fractions of order 0, 1, …"""
        return copy(self._generations)

    def _best(self, order: int | None, highest: int) -> PartialFractions:
        if order is not None:
            return finish(next(islice(self, order, None)), self.target)
        for here in islice(self, highest + 1):
            # The full sequence of norms lowers the error of a quick fit by some 10 %,
            # and seldom by more than 25 %.
            if score(here[0], self.target) <= 1.3:
                fit = finish(here, self.target)
                if score(fit, self.target) <= _WITHIN:
                    return fit
        # The full sequence of norms does not lower all errors alike, so neighbours may
        # change ranks.
        ranked = sorted(
            islice(self, highest + 1), key=lambda here: score(here[0], self.target)
        )
        fits = (finish(here, self.target) for here in ranked[:2])
        return min(fits, key=lambda fit: score(fit, self.target))


def _grid(band: tuple[float, float], count: int) -> Real:
    """Frequencies spaced logarithmically over the band, and linearly over its upper
    three quarters, where the error ripples.
    """
    low, high = band
    return np.unique(
        np.concatenate(
            [np.geomspace(low, high, count), np.linspace(0.25 * high, high, count // 2)]
        )
    )


def checked_band(band: object, period: float) -> tuple[float, float]:
    """Return `band` as (low, high) [rad/s], below the Nyquist frequency of `period` [s]."""
    low, high = rule(Band).check("band", band)
    limit = math.pi / period
    # π/period itself is allowed, even when it was rounded up
    if high > limit * (1.0 + 1e-9):
        raise FieldError(
            "band",
            (low, high),
            "beyond the Nyquist frequency",
            f"0 < low < high <= {limit:.6g} rad/s",
            "lower the upper end or shorten the period",
        )
    return low, high


# --- A discrete rational transfer function in parallel form, with its zeros at z = 1 kept as factors


@dataclass(frozen=True, eq=False)
class DiscreteRational:
    """H(z) = (1 − z⁻¹)^m · (d + Σ g_i/(z − p_i) + ½ Σ [c_j/(z − q_j) + c̄_j/(z −
    q̄_j)]).

    With v[k] = (1 − z⁻¹)^m u[k] the recursion is

        y[k] = d v[k] + Σ g_i x_i[k] + Re Σ c_j w_j[k]
        x_i[k+1] = p_i x_i[k] + v[k],   w_j[k+1] = q_j w_j[k] + v[k]

    Differencing first makes H(1) = 0 exactly in any arithmetic.

    Attributes
    ----------
    period
        Sampling period [s].
    zeros_at_one
        m, the zeros at z = 1 kept as factors.
    feedthrough
        d.
    decays, gains
        Real poles p_i in (−1, 1) and their residues g_i.
    pole_decays, pole_gains
        One pole q_j of each pair (Im q > 0, |q| < 1) and its c_j.
    band
        Lowest and highest frequency [rad/s] of the fit.
    error_db, error_deg
        Largest error in the band of offset + H against offset + response, in decibels
        and in degrees (see `DiscreteFits`).
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
            array = np.array(getattr(self, name), kind).reshape(-1)
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    @property
    def order(self) -> int:
        """Number of poles, which is the number of states without those of the
        differences.
        """
        return len(self.decays) + 2 * len(self.pole_decays)

    @property
    def poles(self) -> Complex:
        """All poles in the z-plane, conjugates included."""
        return np.concatenate([self.decays, self.pole_decays, self.pole_decays.conj()])

    def __call__(self, frequency: ArrayLike) -> Complex:
        """H(e^(jωT)) at frequencies ω [rad/s], in the shape of ω."""
        w = np.asarray(frequency, float)
        z = np.exp(1j * w * self.period)[..., None]
        pair = 0.5 * self.pole_gains
        gains = np.concatenate([self.gains, pair, pair.conj()])
        inner = self.feedthrough + (gains / (z - self.poles)).sum(-1)
        # 1 − e^(−jθ) = 2j sin(θ/2) e^(−jθ/2) keeps its relative precision at the lowest
        # frequencies.
        half = 0.5 * w * self.period
        return (2j * np.sin(half) * np.exp(-1j * half)) ** self.zeros_at_one * inner

    @classmethod
    def from_fractions(
        cls,
        fit: PartialFractions,
        *,
        period: float,
        zeros_at_one: int,
        band: tuple[float, float],
    ) -> DiscreteRational:
        """Map partial fractions on the plane x = (z − 1)/(z + 1) = tanh(sT/2) back to
        z.
        """
        sigma, q = np.exp(fit.real_logs), fit.poles_of_pairs()
        real, pair = fit.real_gains * sigma / (1 + sigma), fit.pair_gains * q / (1 + q)
        decays, pole_values = (1 - sigma) / (1 + sigma), (1 - q) / (1 + q)
        gains = pair * (1 + pole_values)
        # The map (1 − q)/(1 + q) reverses the sign of Im q; the law keeps the pole of
        # each pair that has Im > 0.
        below = pole_values.imag < 0
        return cls(
            period=period,
            zeros_at_one=zeros_at_one,
            feedthrough=float(fit.direct + real.sum() + pair.real.sum()),
            decays=decays,
            gains=real * (1 + decays),
            pole_decays=np.where(below, pole_values.conj(), pole_values),
            pole_gains=np.where(below, gains.conj(), gains),
            band=band,
        )
