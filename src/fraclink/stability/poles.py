"""Poles on the principal sheet and the verdict on stability."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fraclink.errors import FieldError
from fraclink.roots import log_zeros

if TYPE_CHECKING:
    from fraclink.fractional import FractionalTransferFunction

__all__ = ["StabilityVerdict", "is_stable", "poles"]

Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class StabilityVerdict:
    """Whether a system is stable, and why; true or false where a bool is asked for."""

    stable: bool
    reason: str
    unstable_poles: tuple[complex, ...]
    integrators: float
    winding: int

    def __bool__(self) -> bool:
        return self.stable


def poles(system: FractionalTransferFunction) -> Complex:
    """Return the poles on the principal sheet −π < arg s ≤ π, conjugates included."""
    terms = system.denominator
    if any(t.delay for t in terms):
        raise FieldError(
            "denominator",
            repr(system),
            "with a delay: it has infinitely many poles",
            allowed="a denominator without delay",
            remedy="use is_stable or margins",
        )
    z = log_zeros([t.coefficient for t in terms], [t.order for t in terms], angle=math.pi)
    s = np.exp(z)
    inner = (z.imag > 0) & (z.imag < math.pi)
    s[z.imag == math.pi] = -np.exp(z.real[z.imag == math.pi])
    return np.asarray(np.concatenate([s, s[inner].conj()]))


def is_stable(system: FractionalTransferFunction) -> StabilityVerdict:
    """Return whether the system is stable (all poles of the principal sheet in Re s < 0, no integrator)."""
    p = poles(system)
    bad = tuple(complex(v) for v in p[p.real >= 0])
    lowest = min(t.order for t in system.denominator) - min(t.order for t in system.numerator)
    integrators = max(0.0, lowest)
    stable = not bad and integrators == 0
    reason = "all poles lie in the left half plane" if stable else "poles or integrators"
    return StabilityVerdict(stable, reason, bad, integrators, len(bad))
