"""Integer-order approximations of fractional systems: Oustaloup's filter, and the
minimax rational.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import islice
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike

from fracsys._discrete import Band
from fracsys._fractional import FractionalTransferFunction
from fracsys._minimax import Target, finish, grow
from fracsys._stability import poles
from fracsys._zero_pole import (
    cascade,
    evaluate,
    oustaloup,
    substituted,
    zeros_of_fractions,
)
from fracsys.checks import Between, Complex, Real, checked
from fracsys.checks.equality import compared
from fracsys.errors import FieldError


@compared
@dataclass(frozen=True, eq=False)
class RationalApproximation:
    """R(s) = k Π(s − z_i)/Π(s − p_i).

    Attributes
    ----------
    zeros, poles
        z_i and p_i, conjugates included [rad/s].
    gain
        k.
    band
        Lowest and highest frequency [rad/s] of the approximation.
    method
        The method of `approximate`.
    error_db, error_deg
        Largest error of modulus [dB] and phase [°] inside the band.
    """

    zeros: Complex
    poles: Complex
    gain: float
    band: tuple[float, float]
    method: str
    error_db: float = math.nan
    error_deg: float = math.nan

    def __post_init__(self) -> None:
        for name in ("zeros", "poles"):
            array = np.array(getattr(self, name), complex).reshape(-1)
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    @property
    def order(self) -> int:
        """Number of poles."""
        return len(self.poles)

    def __call__(self, s: ArrayLike) -> Complex:
        """R at s [rad/s], any shape."""
        return evaluate(np.asarray(s, complex), self.zeros, self.poles, self.gain)

    def state_space(self) -> tuple[Real, Real, Real, Real]:
        """Real matrices A, B, C, D of second-order sections in series.

        Shapes (n, n), (n, 1), (1, n), (1, 1); ready for `control.ss(*r.state_space())`.
        """
        return cascade(self.zeros, self.poles, self.gain)


@checked
def approximate(
    system: FractionalTransferFunction,
    band: Band,
    order: Annotated[int, Between(1, 40)],
    *,
    method: Literal["oustaloup", "minimax"] = "oustaloup",
) -> RationalApproximation:
    """Return an integer-order approximation of a fractional system in a band, with its
    achieved error.

    Parameters
    ----------
    system
        Proper, or improper by less than one order; no delay.
    band
        Lowest and highest frequency [rad/s], 0 < low < high.
    order
        "minimax": total number of poles, 1 … 12. "oustaloup" replaces each
        fractional power s^(a − ⌊a⌋) by a filter of 1 … 40 pole-zero pairs.
    method
        "minimax" has the smallest worst relative error over the band for its number of
        poles. "oustaloup" is the recursive filter that FOMCON and others use, known to
        be poor at the band's ends.

    Raises
    ------
    FieldError
        Bad band, order or method, a delay, a system improper by one order or more,
        unstable poles (minimax).

    References
    ----------
    Oustaloup et al., IEEE Trans. Circuits Syst. I 47 (2000) 25.

    Examples
    --------
    >>> from fracsys._fractional import s
    >>> r = approximate(100 / (s**1.92 + 100), (0.1, 1000.0), 6, method="minimax")
    >>> r.order, r.error_db < 0.5, r.error_deg < 3.0
    (6, True, True)
    """
    _check(system)
    if method == "minimax":  # beyond 12 poles the fit is limited by rounding
        Between(1, 12).check("order", order)
        zeros, pole_values, gain = _fitted(system, band, order)
    else:
        zeros, pole_values, gain = substituted(
            system.numerator, system.denominator, lambda f: oustaloup(f, band, order)
        )
    result = RationalApproximation(zeros, pole_values, gain, band, method)
    w = np.geomspace(*band, 2000)
    # One logarithm gives both errors: the real part in nepers, the imaginary part in
    # radians without phase wrap.
    ratio = np.log(result(1j * w) / system(1j * w))
    return replace(
        result,
        error_db=float(np.max(np.abs(ratio.real)) * 20 / math.log(10)),
        error_deg=float(np.degrees(np.max(np.abs(ratio.imag)))),
    )


def _check(system: FractionalTransferFunction) -> None:
    """FieldError for a structure that cannot be approximated."""
    if any(t.delay for t in (*system.numerator, *system.denominator)):
        raise FieldError(
            "system",
            repr(system),
            "delayed",
            "systems without delay",
            "approximate the system without its delay and keep the delay as samples",
        )
    if not system.numerator:
        raise FieldError(
            "system",
            repr(system),
            "zero at every frequency",
            "functions other than 0",
            "approximate another function: the error is relative",
        )
    if system.relative_degree <= -1:
        raise FieldError(
            "system",
            repr(system),
            "improper by one order or more",
            "relative degree > -1",
            "divide by a power of s: s^1.65 is s times s^0.65",
        )


def _fitted(
    system: FractionalTransferFunction, band: tuple[float, float], order: int
) -> tuple[Complex, Complex, float]:
    exact = poles(system)
    # The fit places its poles in the open left half plane only. For an unstable system
    # it would silently return the stable function that is closest on the axis.
    if np.any(exact.real >= 0):
        raise FieldError(
            "system",
            repr(system),
            "not stable",
            "stable poles for method='minimax'",
            "use method='oustaloup'",
        )
    # 160 points: few enough for Newton steps of microseconds, and more than ten for
    # each pole at the highest order.
    w = np.geomspace(*band, 160)
    near = exact[
        (np.abs(exact) > band[0]) & (np.abs(exact) < band[1]) & (exact.imag > 0)
    ]
    for p in near:  # a resonance needs points of its own
        # ±4 in sinh are 27 half widths; farther out the even points resolve the skirt
        # of the resonance.
        width = max(abs(p.real) / abs(p), 1e-6)
        w = np.append(w, abs(p) * np.exp(width * np.sinh(np.linspace(-4, 4, 25))))
    w = np.unique(w[(w >= band[0]) & (w <= band[1])])
    values = system(1j * w)
    # 0.1 dB weighs as much as 0.5°, as in the fit of a law; the absolute scale does not
    # matter here.
    one = np.ones(w.size, complex)
    weights = np.outer([20 / math.log(10) / 0.1, 180 / math.pi / 0.5], np.ones(w.size))
    target = Target(w, one, 1 / values, one, weights)
    generations = grow(target, band, resonances=[-p for p in near])
    fit = finish(next(islice(generations, order, None)), target)
    sigma, q = np.exp(fit.real_logs), fit.poles_of_pairs()
    pole_values = np.concatenate([-sigma, -q, -q.conj()])
    half = 0.5 * fit.pair_gains * q
    zeros, gain = zeros_of_fractions(
        pole_values,
        np.concatenate([fit.real_gains * sigma, half, half.conj()]),
        fit.direct,
    )
    return zeros, pole_values, gain
