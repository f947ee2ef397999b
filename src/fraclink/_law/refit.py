"""A quick law for a controller that is still changing: the poles of another law with
new gains.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fraclink._arm.controller import Controller
from fraclink._law.block import Modes
from fraclink._law.law import Law
from fracsys.checks import Complex, Real

__all__ = ["refitted"]

# more points change the gains by less than the missing optimisation of the poles does
_POINTS = 120


def refitted(law: Law, controller: Controller) -> tuple[Law, float]:
    """Return `law` with gains for `controller`, and the largest relative error of C on
    the law's band.

    Least squares of |C - C_law|/|C| on a logarithmic grid, with the poles of `law`: it
    takes a fraction of a millisecond, the minimax fit of `discretize` fifty
    milliseconds. The result is a preview without a verdict: its guards are those of
    `law`, and it is never saved or exported.

    >>> import fraclink as fl
    >>> rig = fl.Rig.named("paper-2023")
    >>> made = fl.design(rig.model, rig, gain_crossover=12.0, phase_margin=fl.deg(50), law=False)
    >>> near = fl.design(rig.model, rig, gain_crossover=12.5, phase_margin=fl.deg(50), law=False)
    >>> quick, error = refitted(made.law(), near.controller)
    >>> quick.correction.poles == made.law().correction.poles, error < 0.1
    (True, True)
    """
    w = np.geomspace(*law.band, _POINTS)
    exact = controller.response(w)
    # C − C_law = Ĉ − Ĉ_law, so the relative error of C is that of Ĉ divided by |1 + Ĉ|:
    # linear in the gains.
    weight = 1.0 / np.abs(1.0 + exact)
    # The poles depend on the band and hardly on the controller, whose β and δ change
    # little while a handle is dragged in the studio: with fixed poles the fit is
    # linear.
    rows = _terms(law, w) * weight[:, None]
    aim = exact * weight
    # Real and imaginary parts are stacked: the gains are real.
    gains = np.linalg.lstsq(
        np.vstack([rows.real, rows.imag]),
        np.concatenate([aim.real, aim.imag]),
        rcond=None,
    )[0]
    error = float(np.max(np.abs(rows @ gains - aim)))
    reals = len(law.correction.poles)
    pairs = gains[1 + reals :].reshape(-1, 2)
    modes = Modes(
        float(gains[0]),
        law.correction.poles,
        tuple(map(float, gains[1 : 1 + reals])),
        law.correction.pair_poles,
        tuple(complex(real, imaginary) for real, imaginary in pairs),
    )
    return replace(law, correction=modes), error


def _terms(law: Law, w: Real) -> Complex:
    """Response of every term of (1 - z⁻¹)(d + Σ g/(z - p)) with the gain 1, shape (N,
    terms).
    """
    z = np.exp(1j * w * law.period)[:, None]
    reals = 1.0 / (z - np.array(law.correction.poles)[None, :])
    pairs = np.array(law.correction.pair_poles, np.complex128)[None, :]
    up, down = 1.0 / (z - pairs), 1.0 / (z - pairs.conj())
    # ½(c/(z − q) + c̄/(z − q̄)) in the two real unknowns Re c and Im c, the form in
    # which the block stores a pair.
    both = np.stack([0.5 * (up + down), 0.5j * (up - down)], axis=2).reshape(w.size, -1)
    terms = np.concatenate([np.ones_like(z), reals, both], axis=1)
    return (1.0 - 1.0 / z) * terms
