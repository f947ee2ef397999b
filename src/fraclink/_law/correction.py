"""The discrete Ĉ: C to the tolerance everywhere, Ĉ itself where the margins are read off."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fraclink._systems.discrete import DiscreteRational, fit_discrete

if TYPE_CHECKING:
    from fraclink._arm.controller import Controller
    from fraclink._arm.link import LinkModel

__all__ = ["fit_correction"]

Real = NDArray[np.float64]

# Around the crossover an error of C counts this many times over |1 + Ĉ|/|Ĉ|: 0.5° of C is 1.2° of the
# margin where |Ĉ| is 0.4, a third of 0.5° of Ĉ is 0.2°. The largest that C's 0.1 dB leaves room for is taken.
EMPHASES = (3.0, 2.0, 1.0)
REACH = 2.5  # either side of the nominal crossover: a factor of 5 in ω_c is one of 15 and more in payload
STATES = 6  # spent on the margin at most; more only where C itself needs them
MOST_STATES = 8  # what law.c holds
TOLERANCE_DB, TOLERANCE_DEG = 0.1, 0.5


def fit_correction(
    controller: Controller, link: LinkModel, period: float, band: tuple[float, float], order: int | None
) -> DiscreteRational:
    """Return Ĉ at `period` [s] as (1 − z⁻¹)(d + Σ g/(z − p)), fitted on `band` [rad/s].

    C = 1 + Ĉ is met to 0.1 dB and 0.5° with few states; what these leave free makes Ĉ accurate in a factor
    2.5 about the gain crossover with the nominal `link`, because the loop is Ĉ times the plant, not C. Where
    no such fit has 6 states or fewer (or `order`), C alone is fitted.
    """

    def fit(weight: Callable[[Real], Real] | None, highest: int) -> DiscreteRational:
        return fit_discrete(
            controller.response,
            period=period,
            order=order,
            zeros_at_one=1,
            offset=1.0,
            band=band,
            weight=weight,
            tolerance_db=TOLERANCE_DB,
            tolerance_deg=TOLERANCE_DEG,
            highest=highest,
        )

    centre = _crossover(controller, link)
    if band[0] < centre < band[1]:
        for emphasis in EMPHASES:
            found = fit(_weight(controller, centre, emphasis), STATES)
            if found.error_db <= TOLERANCE_DB and found.error_deg <= TOLERANCE_DEG:
                return found
    plain = fit(None, MOST_STATES)
    if plain.error_db <= TOLERANCE_DB and plain.error_deg <= TOLERANCE_DEG:
        return plain
    # Nothing meets C everywhere: then where the loop crosses counts more than the end of the band.
    near = fit(_weight(controller, centre, EMPHASES[0]), MOST_STATES)
    return near if near.error_db <= 2.0 * plain.error_db else plain


def _weight(controller: Controller, centre: float, emphasis: float) -> Callable[[Real], Real]:
    def weight(frequency: Real) -> Real:
        correction = controller.response(frequency)
        near = np.abs(np.log(frequency / centre)) <= np.log(REACH)
        relative = emphasis * np.abs(1.0 + correction) / np.abs(correction)
        return np.where(near, np.maximum(1.0, relative), 1.0)

    return weight


def _crossover(controller: Controller, link: LinkModel) -> float:
    """Where |Ĉ G| last falls through one [rad/s]; the link's resonance where it never does."""
    resonance = abs(link.pole)
    w = resonance * np.geomspace(0.2, 30.0, 500)
    above = np.abs(controller.response(w) * link.tip()(1j * w)) > 1.0
    falls = np.nonzero(above[:-1] & ~above[1:])[0]
    return float(w[falls[-1]]) if falls.size else resonance
