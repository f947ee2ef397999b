"""A requirement of a design, wanted and achieved, and the requirements on the sampled
loop of the law that ships.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from fraclink._arm.beam import model_at, unmodelled_modes
from fraclink._arm.box import Arm, arms_of
from fraclink._arm.link import LinkModel
from fraclink._arm.loop import with_payload
from fraclink._arm.sampled import SampledPlant
from fraclink._display import Row, quantity, rows_of
from fraclink._law.discretization import TOLERANCE_DEG, discretize_controller
from fraclink.errors import FieldError
from fraclink.findings import Finding
from fracsys._margins import Margins, margins
from fracsys._precision import COINCIDENT
from fracsys.checks import Complex, Real

if TYPE_CHECKING:
    from fraclink._law.design import Design

__all__ = [
    "LEAST_MODULUS",
    "PAYLOADS",
    "Requirement",
    "law_rows",
    "least_modulus",
    "margins_of",
    "no_law",
    "no_law_rows",
]


@dataclass(frozen=True)
class Requirement:
    """One requirement, the value achieved over the whole payload range, and where it is
    worst.

    ``bound`` says whether `wanted` is the least or the most that is admitted;
    ``at_payload`` [kg] is the payload of the worst value; ``unit`` the unit of wanted,
    achieved and slack.

    Examples
    --------
    >>> Requirement("phase margin", 0.8, 0.9, "rad", 0.02, "at least").passed
    True
    >>> Requirement("Ms", 1.5, 1.6, "", 0.02, "at most").passed
    False
    """

    name: str
    wanted: float
    achieved: float
    unit: str
    at_payload: float
    bound: Literal["at least", "at most"]

    @property
    def slack(self) -> float:
        """Distance from the wanted value, positive with room to spare."""
        gap = self.achieved - self.wanted
        return gap if self.bound == "at least" else -gap

    @property
    def passed(self) -> bool:
        """Whether the bound is kept, to rounding."""
        # The equations are solved to 1e-15, and a requirement met with equality passes.
        return self.slack >= -COINCIDENT * max(1.0, abs(self.wanted))

    @property
    def shown(self) -> tuple[str, str]:
        """The wanted and the achieved value as text."""
        return quantity(self.wanted, self.unit), quantity(self.achieved, self.unit)

    @property
    def spare(self) -> float:
        """The slack relative to the wanted value, or to the achieved one if that is 0."""
        return self.slack / (abs(self.wanted) or abs(self.achieved) or 1.0)

    @property
    def rows(self) -> tuple[Row, ...]:
        """The requirement as shown to people and programs."""
        sign = "≤" if self.bound == "at most" else "≥"
        # Rounded like the achieved value as it is shown: further digits are solver error.
        size = max(abs(self.achieved), abs(self.wanted))
        places = 3 - math.floor(math.log10(size)) if 0.0 < size < math.inf else 0
        slack = round(self.slack, places) if math.isfinite(self.slack) else self.slack
        return rows_of(
            self,
            ("name", "requirement"),
            "unit",
            "wanted",
            Row("", "required", f"{sign} {quantity(self.wanted, self.unit)}"),
            ("achieved", "achieved", self.unit),
            ("at_payload", "worst at", "g"),
            "slack",
            Row("", "slack", slack, "rad" if self.unit == "rad" else ""),
            ("passed", "verdict"),
        )

    def __str__(self) -> str:
        name, _, _, required, achieved, payload, *_ = (row.text for row in self.rows)
        verdict = "passed" if self.passed else "failed"
        return f"{name}: {achieved} at {payload}, required {required}: {verdict}"


LAW_MARGIN = "phase margin, shipped law"
LAW_MODULUS = "distance to -1, shipped law"
# Least |1 + L| of a loop that passes: a phase margin of 14.4° and a gain margin of a
# factor of 1.33, also for deviations not covered by the box.
LEAST_MODULUS = 0.25
# payloads of the model at which loops are evaluated; for an arm of the box only the ends
PAYLOADS = 9


def margins_of(response: Callable[[Real], Complex], plant: SampledPlant) -> Margins:
    """Return the margins of a sampled loop, up to the Nyquist frequency."""
    return margins(
        lambda s: response(np.imag(s)) * plant(np.imag(s)),
        limit=math.pi / plant.period,
        unstable_poles=0,
    )


def law_rows(design: Design) -> tuple[Requirement, Requirement]:
    """Return the requirements on the law that ships, with the real motor loop: its
    worst phase margin and its least |1 + L| in the sampled loop, over the payloads or
    over the box.

    The required margin is the requested one less the law's tolerance; the required
    distance is half of 2 sin(φ_m/2), the largest that a margin φ_m allows, and at most
    `LEAST_MODULUS`. A design for the paper's ideal loop has no request for the
    real loop: there only stability counts.
    """
    # One law for every payload and arm, as shipped: the fit does not know the payload.
    period = design.rig.period
    law = discretize_controller(design.controller, period)
    settings = replace(design.motor_loop, kind="sampled")
    looks: list[tuple[SampledPlant, float]] = []
    figures: list[tuple[float, float]] = []
    for arm, payload in _arms(design):
        higher = unmodelled_modes(arm.model, design.rig, payload)
        plant = arm.plant(settings, design.rig, period, higher=higher)
        figures.append(_tabled(law.frequency_response, plant, arm.model))
        looks.append((plant, payload))
    # A table of each loop locates the worst place, at which the engine then computes
    # the exact value.
    close, near = (
        looks[min(range(len(looks)), key=lambda k: figures[k][which])]
        for which in (0, 1)
    )
    at_margin = margins_of(law.frequency_response, close[0])
    at_modulus = (
        at_margin if near is close else margins_of(law.frequency_response, near[0])
    )
    # The sign follows from the stability of the whole loop: a crossing alone does not
    # show on which side of −1 it lies. Without a crossing the engine returns infinity.
    margin = min(abs(at_margin.phase_margin), math.pi)
    margin = margin if at_margin.stable else -margin
    modulus = at_modulus.modulus_margin if at_modulus.stable else 0.0
    return _rows_of_law(design, (margin, close[1]), (modulus, near[1]))


def no_law_rows(design: Design) -> tuple[Requirement, Requirement]:
    """Return the same requirements if no law represents the controller."""
    payload = design.payloads[0]
    return _rows_of_law(design, (-math.pi, payload), (0.0, payload))


def _rows_of_law(
    design: Design, margin: tuple[float, float], modulus: tuple[float, float]
) -> tuple[Requirement, Requirement]:
    """The two requirements, from (achieved value, payload [kg]) of each."""
    goal = least = 0.0
    if design.margins_kind != "ideal":
        goal = design.phase_margin - math.radians(TOLERANCE_DEG)
        least = least_modulus(design.phase_margin)
    return (
        Requirement(LAW_MARGIN, goal, margin[0], "rad", margin[1], "at least"),
        Requirement(LAW_MODULUS, least, modulus[0], "", modulus[1], "at least"),
    )


def _tabled(
    response: Callable[[Real], Complex], plant: SampledPlant, model: LinkModel
) -> tuple[float, float]:
    """(smallest phase margin [rad], below -1 where the loop is unstable; smallest |1 +
    L|) of a sampled loop, from a table.
    """
    nyquist = math.pi / plant.period
    mode = min(model.resonance, 0.3 * nyquist)
    near = np.geomspace(1e-4, 0.2, 16)
    parts = [
        np.geomspace(0.05 * mode, nyquist, 160),
        mode * (1.0 + near),
        mode / (1.0 + near),
    ]
    if model.second_mode is not None:
        parts.append(model.second_mode.about(65))
    if model.gauge_delay:
        turns = int(6.0 * model.gauge_delay * nyquist / math.pi) + 2
        parts.append(np.linspace(0.05 * mode, nyquist, min(turns, 2000)))
    w = np.unique(np.minimum(np.concatenate(parts), nyquist))
    loop = response(w) * plant(w, aliases=1)
    level, phase = np.log(np.abs(loop)), np.unwrap(np.angle(loop))
    i = np.flatnonzero((level[:-1] > 0.0) != (level[1:] > 0.0))
    share = level[i] / (level[i] - level[i + 1])
    at = phase[i] + share * (phase[i + 1] - phase[i])
    rising = level[i] <= 0.0
    turns = np.floor((at + math.pi) / math.tau)
    stable = np.sum(np.where(rising, turns, -turns)) == 0.0
    margin = math.pi - np.abs(np.remainder(at + math.pi, math.tau) - math.pi)
    least = float(np.min(margin, initial=math.pi))
    return least if stable else -least - 1.0, float(np.min(np.abs(1.0 + loop)))


def _arms(design: Design) -> Iterator[tuple[Arm, float]]:
    """Arms and payloads: payloads of the model, or the lightest and the heaviest of
    every arm of the box.
    """
    model = with_payload(design.model, design.rig)
    if design.box is None:
        for w0 in np.geomspace(*design.natural_frequencies, PAYLOADS):
            payload = design.payload(float(w0))
            mode = model_at(model, design.rig, payload).second_mode
            ratio = (model.natural_frequency / float(w0)) ** 2
            yield Arm(model.with_mass(ratio, second_mode=mode)), payload
        return
    for arm in arms_of(design.box, model):
        # The heaviest payload has the lowest ω₀: both ranges ascend, so one of them is
        # reversed. The box's own interval of ω₀ widens the range at both ends.
        for end, payload in enumerate(reversed(design.payloads)):
            w0 = (
                design.natural_frequencies[end]
                * design.box.natural_frequency[end]
                / model.natural_frequency
            )
            ratio = (arm.model.natural_frequency / w0) ** 2
            yield replace(arm, model=arm.model.with_mass(ratio)), payload


def least_modulus(phase_margin: float) -> float:
    """Return the |1 + L| that the law that ships has to keep: half of the largest
    distance that a margin allows, and at most `LEAST_MODULUS`.
    """
    return min(LEAST_MODULUS, math.sin(0.5 * phase_margin))


def no_law(error: FieldError) -> Finding:
    """Return W410: no law of law.c's size represents the controller."""
    return Finding(
        "W410",
        "error",
        f"no law follows this controller: it takes {error.value}, and law.c holds {error.allowed}",
        {},
        "ask for a smaller phase margin or a slower gain crossover",
    )
