"""One requirement of a design, wanted and achieved; and what the law that ships keeps of it, sampled."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.box import ParameterBox, arms_of
from fraclink._arm.loop import with_payload
from fraclink._arm.sampled import SampledPlant
from fraclink._law import discretize_controller
from fraclink._systems.margins import Margins, margins
from fraclink.findings import Finding

if TYPE_CHECKING:
    from fraclink._design.specification import Design

__all__ = ["LAW_MARGIN", "Requirement", "kept_by_law", "law_findings", "law_margins", "margins_of"]

_ROUNDING = 1e-9  # relative: the equations are solved to 1e-15, a requirement met with equality must pass


@dataclass(frozen=True)
class Requirement:
    """One requirement, the value achieved over the whole payload range, and where it is worst.

    ``bound`` says whether `wanted` is the least or the most that is admitted; ``at_payload`` [kg] is the
    payload of the worst value; ``unit`` the unit of wanted, achieved and slack.

    Examples
    --------
    >>> Requirement.at_least("phase margin", 0.8, 0.9, "rad", 0.02).passed
    True
    >>> Requirement.at_most("Ms", 1.5, 1.6, "", 0.02).passed
    False
    """

    name: str
    wanted: float
    achieved: float
    unit: str
    at_payload: float
    bound: Literal["at least", "at most"]

    @staticmethod
    def at_least(name: str, wanted: float, achieved: float, unit: str, at_payload: float) -> Requirement:
        """A lower bound: passed where achieved >= wanted."""
        return Requirement(name, wanted, achieved, unit, at_payload, "at least")

    @staticmethod
    def at_most(name: str, wanted: float, achieved: float, unit: str, at_payload: float) -> Requirement:
        """An upper bound: passed where achieved <= wanted."""
        return Requirement(name, wanted, achieved, unit, at_payload, "at most")

    @property
    def slack(self) -> float:
        """Distance from the wanted value, positive with room to spare."""
        gap = self.achieved - self.wanted
        return gap if self.bound == "at least" else -gap

    @property
    def passed(self) -> bool:
        """Whether the bound is kept, to rounding."""
        return self.slack >= -_ROUNDING * max(1.0, abs(self.wanted))

    def __str__(self) -> str:
        shown = [math.degrees(x) if self.unit == "rad" else x for x in (self.wanted, self.achieved)]
        unit = "°" if self.unit == "rad" else f" {self.unit}".rstrip()
        verdict = "passed" if self.passed else "FAILED"
        return (
            f"{self.name}: wanted {shown[0]:.5g}{unit}, achieved {shown[1]:.5g}{unit} "
            f"at {1e3 * self.at_payload:g} g, {verdict}"
        )


Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Looked = Sequence[tuple[Margins, float]]  # margins of the sampled loop with the law, and the payload [kg]
LAW_MARGIN = "phase margin, shipped law"
_ALLOWANCE = math.radians(0.5)  # of the fit of C, which the law states as its own error
_PAYLOADS = 9
# Of the design's own |1 + L|: the hold and the fit of the law move it by a few per cent, not by half.
_NEAR = 0.5


def margins_of(response: Callable[[Real], Complex], plant: SampledPlant) -> Margins:
    """Return the margins of a sampled loop, up to the Nyquist frequency."""
    return margins(
        lambda s: response(np.imag(s)) * plant(np.imag(s)), limit=math.pi / plant.period, unstable_poles=0
    )


def law_margins(design: Design) -> Looked:
    """Return what the law has in the sampled loop, over the payloads, or at every arm of the design's box."""
    if design.box is not None:
        return tuple(_over_box(design, design.box))
    payloads = [design.payload(float(w0)) for w0 in np.geomspace(*design.natural_frequencies, _PAYLOADS)]
    return tuple((design.sampled_at(payload), payload) for payload in payloads)


def _over_box(design: Design, box: ParameterBox) -> Iterator[tuple[Margins, float]]:
    """For the lightest and the heaviest payload of every arm."""
    law, period = discretize_controller(design.controller, design.rig.period), design.rig.period
    known = with_payload(design.model, design.rig)
    for arm in arms_of(box, known):
        for end, payload in enumerate(reversed(design.payloads)):
            w0 = design.natural_frequencies[end] * box.natural_frequency[end] / known.natural_frequency
            link = replace(arm.model, natural_frequency=w0)
            plant = replace(arm, model=link).plant(design.motor_loop, design.rig, period)
            yield margins_of(law.frequency_response, plant), payload


def kept_by_law(design: Design, looked: Looked) -> Requirement:
    """Return the requirement on the law's worst phase margin: what was asked less the law's tolerance."""
    kept, payload = _least(looked)
    return Requirement.at_least(LAW_MARGIN, design.phase_margin - _ALLOWANCE, kept, "rad", payload)


def law_findings(design: Design, looked: Looked) -> tuple[Finding, ...]:
    """Return the findings of a design with W404 and W408, where its law keeps less than the design does."""
    kept, payload = _least(looked)
    others = tuple(finding for finding in design.findings if finding.code not in ("W404", "W408"))
    short = design.phase_margin - kept
    if short > 0.0:
        less = Finding(
            "W404",
            "error" if kept <= 0.0 else "warning" if short > _ALLOWANCE else "info",
            "the shipped law in the sampled loop keeps less phase margin than was asked for",
            {"phase_margin_rad": kept, "wanted_rad": design.phase_margin, "payload_kg": payload},
            "ask for as much more as is missing, with margins='loop'",
        )
        others += (less,)
    return others if kept <= 0.0 else (*others, *_near_minus_one(design, looked))


def _near_minus_one(design: Design, looked: Looked) -> tuple[Finding, ...]:
    """W408 where the sampled loop comes much closer to -1 than the design, as one without a filter may."""
    found, payload = min(looked, key=lambda pair: pair[0].modulus_margin)
    designed = design.full_loop.margins_at(design.natural_frequency(payload)).modulus_margin
    if found.modulus_margin >= _NEAR * designed:
        return ()
    close = Finding(
        "W408",
        "warning",
        f"the shipped law in the sampled loop comes to |1 + L| = {found.modulus_margin:.2g} at "
        f"{found.modulus_frequency:.4g} rad/s, where the loop of the design keeps {designed:.2g}",
        {"modulus_margin": found.modulus_margin, "designed": designed, "payload_kg": payload},
        "leave filter_time out: a filter keeps |L| small near the Nyquist frequency",
    )
    return (close,)


def _least(looked: Looked) -> tuple[float, float]:
    """(least phase margin [rad], its payload [kg]); negative where the loop is not stable."""
    return min((_signed(found), payload) for found, payload in looked)


def _signed(found: Margins) -> float:
    """π where |L| never crosses one."""
    margin = math.pi if found.phase_margin is None else abs(found.phase_margin)
    return margin if found.stable else -margin
