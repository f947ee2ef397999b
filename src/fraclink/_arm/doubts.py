"""What contradicts the rig so far that nothing made from it can pass: payloads, stiffness, frequency.

`Rig.warnings` names values that differ by more than measurements do; here they differ by a wrong unit or by
being those of another arm.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

from fraclink._arm.link import LinkModel
from fraclink._arm.rig import Rig
from fraclink.findings import Finding

__all__ = ["doubts_of"]

# The source paper's stated and computed stiffness differ by 30 %, a gauge's calibration by some 20 %, and a
# beam rolled 15 % thicker has 1.5 times the stiffness: all of that together stays below 2.
_STIFFNESS_MOST = 2.0
# A link whose mass the rig does not state lowers the frequency: by 1.55 at 60 g and a payload of 10 g.
_FREQUENCY_MOST = 1.8
# Share of a uniform beam's mass that moves with its tip, 33/140 of Rayleigh's quotient.
_MOVING = 33.0 / 140.0
_UNITS = {
    math.degrees(1.0): "as with an angle in degrees that is called radians",
    1000.0: "as with milli- or kilo- left out of a unit",
}


def doubts_of(rig: Rig, model: LinkModel, payloads: Iterable[float] = ()) -> tuple[Finding, ...]:
    """Return the errors W105, W106 and W107 of a model and of payloads [kg] on this rig.

    A payload is in doubt a hundred times beyond the rig's range, a stiffness that differs from the rig's by
    more than a factor of 2, and a frequency that differs by more than 1.8 from √(c/J) with the rig's own c,
    J = (m + 33/140 M) L², payload m and link mass M.

    >>> rig = Rig.named("paper-2023")
    >>> [finding.code for finding in doubts_of(rig, LinkModel(0.0272, 10.0, order=1.92, payload=0.030))]
    ['W106']
    """
    given = (*payloads, *(() if model.payload is None else (model.payload,)))
    doubts = filter(None, map(rig.payloads.doubt, dict.fromkeys(given)))
    return (*doubts, *_of_stiffness(rig, model), *_of_frequency(rig, model))


def _of_stiffness(rig: Rig, model: LinkModel) -> Iterator[Finding]:
    stated, found = rig.link.stiffness, model.stiffness
    ratio = max(found / stated, stated / found)
    if ratio <= _STIFFNESS_MOST:
        return
    unit = next((words for factor, words in _UNITS.items() if 0.6 < ratio / factor < 1.6), "")
    hint = f": a factor of {ratio:.3g}, {unit}" if unit else ""
    yield Finding(
        "W106",
        "error",
        f"the model's stiffness is {found:.4g} N·m/rad, the rig's {stated:.4g} N·m/rad{hint}",
        {"model": found, "rig": stated, "ratio": ratio, "most": _STIFFNESS_MOST},
        "check the units in [log] of the rig file, and that model and rig are of one arm",
    )


def _of_frequency(rig: Rig, model: LinkModel) -> Iterator[Finding]:
    if model.payload is None:  # ω₀ is then taken from the rig
        return
    moving = model.payload + _MOVING * rig.link.mass
    expected = math.sqrt(rig.link.stiffness / (moving * rig.link.length**2))
    # Eq. (5) has ω₀ in s^(−λ/2) where a vibration has |p| in rad/s: either may be meant.
    found = (model.natural_frequency, abs(model.pole))
    ratios = [max(value / expected, expected / value) if value > 0 else math.inf for value in found]
    if min(ratios) <= _FREQUENCY_MOST:
        return
    yield Finding(
        "W107",
        "error",
        f"the model vibrates at {found[1]:.4g} rad/s with {model.payload:.4g} kg, where the rig's stiffness "
        f"and length give {expected:.4g} rad/s",
        {"model": found[1], "rig": expected, "ratio": min(ratios), "most": _FREQUENCY_MOST},
        "check the payload of the log, the rig's length, and that model and rig are of one arm",
    )
