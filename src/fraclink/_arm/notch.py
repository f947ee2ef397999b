"""A notch of Ĉ at the link's second mode."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from fraclink.errors import FieldError
from fracsys._fractional import FractionalTransferFunction, s
from fracsys.checks import Complex, Frequency, above, checked

__all__ = ["Notch"]

Ratio = Annotated[float, above(0.0, 1.0)]


@checked(prefix="notch.")
@dataclass(frozen=True)
class Notch:
    """``N(s) = (s² + 2 ζ_z ω s + ω²)/(s² + 2 ζ_p ω s + ω²)``, which is ζ_z/ζ_p at ω and
    1 far from it.

    Parameters
    ----------
    frequency
        ω [rad/s], > 0.
    zeros, poles
        damping ratios, 0 < ζ_z <= ζ_p <= 1.

    Examples
    --------
    >>> notch = Notch(frequency=170.0, zeros=0.02, poles=0.4)
    >>> round(float(abs(np.exp(notch.log(np.array(170.0))))), 6)
    0.05
    """

    frequency: Frequency
    zeros: Ratio
    poles: Ratio

    def __post_init__(self) -> None:
        if self.zeros > self.poles:
            raise FieldError(
                "notch.zeros",
                self.zeros,
                "above the damping ratio of the poles: a peak",
                f"at most {self.poles:g}",
                "exchange the two",
            )

    def log(self, frequency: NDArray[Any]) -> Complex:
        """Return ln N(jω): the phase of each quadratic changes by less than 180°, so
        the principal logarithm is continuous.
        """
        at, w = 1j * np.asarray(frequency), self.frequency
        rest = at * at + w * w
        top, bottom = (
            rest + 2.0 * ratio * w * at for ratio in (self.zeros, self.poles)
        )
        return np.log(top / bottom)

    def transfer(self) -> FractionalTransferFunction:
        """Return N as a transfer function."""
        w = self.frequency
        return (s**2 + 2.0 * self.zeros * w * s + w * w) / (
            s**2 + 2.0 * self.poles * w * s + w * w
        )
