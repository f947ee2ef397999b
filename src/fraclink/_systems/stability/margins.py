"""Every gain and phase crossing of a loop, its margins and its distance to −1."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fraclink._systems.stability.crossings import crossings, modulus_margin
from fraclink._systems.stability.fractional_loop import FractionalLoop
from fraclink._systems.stability.loops import as_loop
from fraclink._systems.stability.nyquist import unstable_closed_loop_poles
from fraclink._systems.stability.results import Margins
from fraclink._systems.stability.sweep import sweep
from fraclink._validate import checked_whole

if TYPE_CHECKING:
    from fraclink._systems.fractional import FractionalTransferFunction

__all__ = ["margins"]

Complex = NDArray[np.complex128]

_ON_AXIS = 1e-12  # a modulus margin of zero is a closed-loop pole on the axis


def margins(
    loop: FractionalTransferFunction | Callable[[Complex], Complex],
    *,
    limit: float | None = None,
    unstable_poles: int | None = None,
) -> Margins:
    """Return every gain crossing, phase crossing and the modulus margin of an open loop L.

    |L(jω)| = 1 gives the gain crossings, arg L(jω) = −π the phase crossings, min |1 + L(jω)| the modulus
    margin. There is no grid to choose: the response is followed until neither ln L nor 1 + L moves far
    between neighbours, and every crossing is polished to rounding. A delay makes countless phase crossings:
    with one (and for a callable, which may hide one) those below −60 dB are left out, or, where the loop
    rolls off too slowly for that, those below −6 dB at worst.

    Parameters
    ----------
    loop : FractionalTransferFunction, callable or python-control system
        L under unity negative feedback. A callable takes s = jω (complex, shape (n,)) and returns L(s) of
        the same shape; it is looked at from 1e-6 to 1e6 rad/s. A python-control system is a callable; if it
        is sampled it is evaluated on the unit circle up to its Nyquist frequency. Frequency response data
        are used in their own range, straight in a Bode plot from point to point.
    limit : float, optional
        Highest frequency [rad/s], > 0; the Nyquist frequency of a sampled loop.
    unstable_poles : int, optional
        Number of poles of L with Re s > 0, conjugates counted, which a callable cannot tell. With it (or for
        a transfer function, which knows) the encirclements of −1 decide `stable`.

    Returns
    -------
    Margins

    Raises
    ------
    FieldError
        `limit` ≤ 0, a response that is not a number, a callable of another shape, a response that turns more
        often than can be followed (a delay without roll-off: give `limit`).

    References
    ----------
    Nyquist (1932); modulus margin as in Åström and Hägglund, Advanced PID Control, section 4.6.

    Examples
    --------
    >>> m = margins(lambda s: 4 / (s * (s + 1) * (s + 2)), unstable_poles=0)
    >>> print(f"{m.gain_crossover:.6f} rad/s, {m.phase_margin:.6f} rad, {m.gain_margin:.6f}, {m.stable}")
    1.143203 rad/s, 0.199404 rad, 1.500000, True
    """
    if unstable_poles is not None:
        checked_whole("unstable_poles", unstable_poles, 0, 1000)
    known = as_loop(loop, limit)
    if unstable_poles is None and isinstance(known, FractionalLoop):
        unstable_poles = known.unstable_poles
    # Poles and zeros on the axis are infinities here and not faults.
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        x, values, quiet = sweep(known)
        gain, phase = crossings(known, x, values, quiet)
        modulus, at = modulus_margin(known, x, values)
        stable = None
        if modulus < _ON_AXIS:
            stable = False
        elif unstable_poles is not None:
            left = unstable_closed_loop_poles(
                known, x, values, open_loop=unstable_poles, ends_real=limit is not None
            )
            stable = None if left is None else left == 0
    return Margins(gain, phase, modulus, at, stable)
