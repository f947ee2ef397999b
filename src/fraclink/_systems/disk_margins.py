"""Disk margins: how much gain and phase may vary together, at every frequency, before a
loop is unstable.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from fraclink._systems.fractional import FractionalTransferFunction
from fraclink._systems.loops import FractionalLoop, SampledLoop, as_loop
from fraclink._systems.margins import margins
from fraclink._systems.sweep import sweep, valleys, zero_of
from fraclink._systems.terms import Complexes, Reals
from fraclink._validate import Between, checked
from fraclink.errors import UnstableError

# Between neighbours of the sweep 1 + L changes by a factor of 2 at most and L by e^1.5:
# a grid point with more than their product times the smallest value is beside no
# minimum below it.
_SPARE = 10.0
_LARGEST = 1e150  # its square is still a double: stands for an infinite disk


@dataclass(frozen=True)
class DiskMargin:
    """The largest disk of perturbations f(δ) = (1 + (1−σ)/2 δ)/(1 − (1+σ)/2 δ), |δ| <
    α, that fL tolerates.

    Attributes
    ----------
    skew
        σ [1].
    alpha
        α [1], the disk margin.
    frequency
        Where the smallest destabilising perturbation acts [rad/s]; 0 or inf where α is
        only approached there.
    perturbation
        That perturbation, −1/L(jω): 1 + fL = 0.
    gain_margin
        Gains (γ_min, γ_max) [1] between which any constant is tolerated; γ_max is inf
        where the disk is a half plane or more.
    phase_margin
        Phase [rad] that is tolerated in either direction; inf where every phase is.
    stable
        Whether the closed loop 1/(1 + L) is stable; None where that was not decided: α
        is then a distance and no margin.
    """

    skew: float
    alpha: float
    frequency: float
    perturbation: complex
    gain_margin: tuple[float, float]
    phase_margin: float
    stable: bool | None

    def __str__(self) -> str:
        """The size of the disk, what it guarantees and where it is touched, in three
        lines.
        """
        low, high = self.gain_margin
        known = {
            True: "stable",
            False: "not stable",
            None: "not decided: give unstable_poles",
        }
        return (
            f"disk margin     {self.alpha:12.6g} (skew {self.skew:g}) at {self.frequency:.6g} rad/s\n"
            f"tolerated       gain {low:.4g} … {high:.4g}, phase ±{math.degrees(self.phase_margin):.3f}°\n"
            f"closed loop     {known[self.stable]}"
        )


@checked
def disk_margin(
    loop: FractionalTransferFunction | Callable[[Complexes], Complexes],
    *,
    skew: Annotated[float, Between(-10.0, 10.0)] = 0.0,
    limit: Annotated[float, Between(0.0, unit="rad/s", low_open=True)] | None = None,
    unstable_poles: Annotated[int, Between(0, 1000)] | None = None,
) -> DiskMargin:
    """Return the disk margin of an open loop L: the largest α such that fL is stable
    for every f in D(α, σ).

    α = 1/‖S + (σ − 1)/2‖∞ = inf_ω 2|1 + L(jω)|/|(1 + σ) − (1 − σ)L(jω)|,      S = 1/(1 + L)

    σ = 0 is balanced (S − T), σ = 1 the modulus margin, σ = −1 its counterpart 1/‖T‖∞.
    Gain and phase may vary together and with frequency inside the disk, which a gain
    margin and a phase margin do not allow. No grid is chosen: L is followed as by
    `margins`, and every minimum is polished to rounding.

    Parameters
    ----------
    loop, limit, unstable_poles
        As for `margins`; `limit` in [rad/s].
    skew
        σ [1], −10 … 10: above 0 the disk reaches farther towards gains above 1.

    Raises
    ------
    UnstableError
        The closed loop is not stable: it has no margin.
    FieldError
        As for `margins`; a skew out of range.

    References
    ----------
    Seiler, Packard and Gahinet, IEEE Control Systems 40(5) (2020) 78: D(α, σ), theorem
    1 for α, and the section on guaranteed gain and phase margins.

    Examples
    --------
    >>> from fraclink._systems.fractional import s
    >>> found = disk_margin(25 / (s**3 + 10 * s**2 + 10 * s + 10))
    >>> print(f"{found.alpha:.4f} at {found.frequency:.4f} rad/s")
    0.4581 at 1.9550 rad/s
    """
    stable = margins(loop, limit=limit, unstable_poles=unstable_poles).stable
    if stable is False:
        allowed, remedy = (
            "a loop that is stable when closed",
            "lower the gain, or see margins(loop)",
        )
        raise UnstableError(
            "loop", repr(loop), "not stable when closed", allowed=allowed, remedy=remedy
        )
    known = as_loop(loop, limit)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        x, values, _ = sweep(known)
        alpha, frequency, worst = _nearest(known, x, values, skew, whole=limit is None)
    # A loop of no gain tolerates every disk: finite numbers keep the formulas below
    # from 0/0.
    size = min(alpha, _LARGEST)
    return DiskMargin(
        skew, alpha, frequency, worst, _gains(size, skew), _phase(size, skew), stable
    )


def _nearest(
    loop: SampledLoop, x: Reals, values: Complexes, skew: float, *, whole: bool
) -> tuple[float, float, complex]:
    """inf of the distance over frequency, where it is [rad/s], and −1/L there."""
    distance = np.asarray(_distance(values, skew))
    # Where numerator and denominator are both infinite or zero nothing is known; a
    # neighbour of the grid is.
    distance[np.isnan(distance)] = math.inf
    best = int(np.argmin(distance))
    smallest, frequency, at = (
        float(distance[best]),
        math.exp(float(x[best])),
        complex(values[best]),
    )

    def slope(value: complex, rate: complex) -> float:
        moved = value * rate
        return (
            moved / (1 + value) + (1 - skew) * moved / ((1 + skew) - (1 - skew) * value)
        ).real

    for i in valleys(distance, spare=_SPARE):
        place, value = zero_of(loop, slope, float(x[i - 1]), float(x[i + 1]))
        here = float(_distance(np.array([value]), skew)[0])
        if here <= smallest:
            smallest, frequency, at = here, math.exp(place), value
    for value, place in zip(_ends(loop, whole=whole), (0.0, math.inf), strict=True):
        here = float(_distance(np.array([value]), skew)[0])
        if here < smallest:
            smallest, frequency, at = here, place, value
    return (
        smallest,
        frequency,
        -1 / at if at and abs(at) < math.inf else complex(0.0 if at else math.inf),
    )


def _distance(values: Complexes, skew: float) -> Reals:
    """2|1 + L|/|(1 + σ) − (1 − σ)L|, with its limit where L is infinite."""
    quotient = 2.0 * np.abs(1 + values) / np.abs((1 + skew) - (1 - skew) * values)
    limit = 2.0 / abs(1 - skew) if skew != 1.0 else math.inf
    return np.asarray(np.where(np.isinf(values), limit, quotient))


def _ends(loop: SampledLoop, *, whole: bool) -> tuple[complex, complex]:
    """L at ω → 0 and, unless a limit hides it, ω → ∞: as the loop knows it, and
    infinite where it grows.
    """
    start, end = loop.ends
    if isinstance(loop, FractionalLoop):
        top, bottom = loop.orders[: loop.top], loop.orders[loop.top :]
        start = complex(math.inf) if top.min() < bottom.min() else start
        end = complex(math.inf) if top.max() > bottom.max() and whole else end
    return start, end


def _gains(alpha: float, skew: float) -> tuple[float, float]:
    """Where the disk's edge meets the positive real axis: δ = ±α."""
    down, up = 0.5 * alpha * (1 - skew), 0.5 * alpha * (1 + skew)
    # f grows with δ from f(0) = 1, through infinity where (1 + σ)δ/2 = 1.
    low = (1 - down) / (1 + up) if up > -1 else -math.inf
    return low, (1 + down) / (1 - up) if up < 1 else math.inf


def _phase(alpha: float, skew: float) -> float:
    """Where the disk's edge meets the unit circle: |δ(e^jφ)| = α grows up to 2/|σ| at φ
    = π.
    """
    if alpha * abs(skew) >= 2.0:
        return math.inf
    square = alpha * alpha
    return math.acos(
        (4 - square * (1 + skew * skew)) / (4 + square * (1 - skew * skew))
    )
