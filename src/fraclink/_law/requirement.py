"""One requirement of a design, wanted and achieved; and what the law that ships keeps
of it, sampled.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.beam import unmodelled_modes
from fraclink._arm.box import Arm, arms_of
from fraclink._arm.link import LinkModel
from fraclink._arm.loop import with_payload
from fraclink._arm.motor_loop import MotorLoop
from fraclink._arm.sampled import SampledPlant
from fraclink._law.discretization import discretize_controller
from fraclink.errors import FieldError
from fraclink.findings import Finding
from fracsys._margins import Margins, margins

if TYPE_CHECKING:
    from fraclink._law.design import Design

__all__ = [
    "LAW_MARGIN",
    "LAW_MODULUS",
    "LEAST_SHARE",
    "Looked",
    "Requirement",
    "kept_by_law",
    "law_findings",
    "law_margins",
    "least_modulus",
    "margins_of",
    "no_law",
    "no_law_kept",
]

# relative: the equations are solved to 1e-15, a requirement met with equality must pass
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Requirement:
    """One requirement, the value achieved over the whole payload range, and where it is
    worst.

    ``bound`` says whether `wanted` is the least or the most that is admitted;
    ``at_payload`` [kg] is the payload of the worst value; ``unit`` the unit of wanted,
    achieved and slack.

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
    def at_least(
        name: str, wanted: float, achieved: float, unit: str, at_payload: float
    ) -> Requirement:
        """A lower bound: passed where achieved >= wanted."""
        return Requirement(name, wanted, achieved, unit, at_payload, "at least")

    @staticmethod
    def at_most(
        name: str, wanted: float, achieved: float, unit: str, at_payload: float
    ) -> Requirement:
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

    @property
    def shown(self) -> tuple[str, str]:
        """What is wanted and what is achieved as text, an angle in degrees."""
        unit = "°" if self.unit == "rad" else f" {self.unit}".rstrip()
        wanted, achieved = (
            math.degrees(x) if self.unit == "rad" else x
            for x in (self.wanted, self.achieved)
        )
        return f"{wanted:.5g}{unit}", f"{achieved:.5g}{unit}"

    def __str__(self) -> str:
        verdict = "passed" if self.passed else "FAILED"
        wanted, achieved = self.shown
        return (
            f"{self.name}: wanted {wanted}, achieved {achieved} "
            f"at {1e3 * self.at_payload:g} g, {verdict}"
        )


Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

LAW_MARGIN = "phase margin, shipped law"
LAW_MODULUS = "distance to -1, shipped law"
_ALLOWANCE = math.radians(0.5)  # of the fit of C, which the law states as its own error
_MODULUS = 0.25  # what `certify` asks for where nothing is stated
# Of a payload range, for the law: each asks for a sampled plant with its aliases, for
# every motor loop.
_PAYLOADS = 9
# Of the design's own |1 + L|: the hold and the fit of the law move it by a few per
# cent, not by half.
_NEAR = 0.5
# Less than half of the phase margin asked for, or an |1 + L| that a loop gain of 10 %
# more may take away, is another loop than the one designed: gauge, motor and damping
# are known to 5 % each at best.
LEAST_SHARE, _CLOSEST = 0.5, 0.1


@dataclass(frozen=True)
class Looked:
    """Margins of the sampled loop with the law, the payload [kg], and the kind of motor
    loop.

    The law closes the motor loop, too: a PID at the control period. A design for the
    ideal motor loop is looked at with both: with M(s), which a drive's own position
    loop may come close to, and with the PID that runs. Far above the motor loop's pole
    the two have nothing in common, and a late gauge keeps |L| near one as far up as
    that: B tends to 1 - e^(-τs) there, not to zero. So does a link with mass: its modes
    2 and 3 are in this loop wherever the rig states the mass, whether or not a log
    showed them.
    """

    margins: Margins
    payload: float
    motor_loop: str

    @property
    def phase_margin(self) -> float:
        """Signed phase margin [rad]: negative where the loop is not stable, π where |L|
        never crosses one.
        """
        found = self.margins
        # Signed by the stability of the loop as a whole: a crossing alone cannot tell
        # on which side of −1 it belongs. Without a crossing the engine says infinite;
        # no angle is more than π.
        margin = min(abs(found.phase_margin), math.pi)
        return margin if found.stable else -margin


def margins_of(response: Callable[[Real], Complex], plant: SampledPlant) -> Margins:
    """Return the margins of a sampled loop, up to the Nyquist frequency."""
    return margins(
        lambda s: response(np.imag(s)) * plant(np.imag(s)),
        limit=math.pi / plant.period,
        unstable_poles=0,
    )


def law_margins(design: Design) -> tuple[Looked, ...]:
    """Return what the law has in the sampled loop where it is worst: at the smallest
    phase margin and at the smallest |1 + L|, over the payloads, or over the box.

    A table of each loop says where that is; the engine then measures it there.
    """
    # One law for every payload and arm, as one ships: the fit does not know the
    # payload.
    law, period = (
        discretize_controller(design.controller, design.rig.period),
        design.rig.period,
    )
    figures: list[tuple[float, float]] = []
    looks: list[tuple[SampledPlant, float, str]] = []
    for arm, payload in _arms(design):
        higher = unmodelled_modes(arm.model, design.rig, payload)
        for settings in _motor_loops(design):
            plant = arm.plant(settings, design.rig, period, higher=higher)
            figures.append(_tabled(law.frequency_response, plant, arm.model))
            looks.append((plant, payload, settings.kind))
    chosen = {
        min(range(len(looks)), key=lambda k: figures[k][which]) for which in (0, 1)
    }
    return tuple(
        Looked(margins_of(law.frequency_response, plant), payload, kind)
        for plant, payload, kind in (looks[k] for k in sorted(chosen))
    )


def _tabled(
    response: Callable[[Real], Complex], plant: SampledPlant, model: LinkModel
) -> tuple[float, float]:
    """(smallest phase margin [rad], negative beyond -180°; smallest |1 + L|) of a
    sampled loop, from a table.
    """
    nyquist = math.pi / plant.period
    mode = min(abs(model.pole), 0.3 * nyquist)
    near = np.geomspace(1e-4, 0.2, 16)
    parts = [
        np.geomspace(0.05 * mode, nyquist, 160),
        mode * (1.0 + near),
        mode / (1.0 + near),
    ]
    if model.second_mode is not None:
        width = model.second_mode.damping_ratio * np.linspace(-8.0, 8.0, 65)
        parts.append(model.second_mode.frequency * np.exp(width))
    if model.gauge_delay:
        turns = int(6.0 * model.gauge_delay * nyquist / math.pi) + 2
        parts.append(np.linspace(0.05 * mode, nyquist, min(turns, 2000)))
    w = np.unique(np.minimum(np.concatenate(parts), nyquist))
    loop = response(w) * plant.near(w)
    level, phase = np.log(np.abs(loop)), np.unwrap(np.angle(loop))
    i = np.flatnonzero((level[:-1] > 0.0) != (level[1:] > 0.0))
    share = level[i] / (level[i] - level[i + 1])
    at = phase[i] + share * (phase[i + 1] - phase[i])
    rising = level[i] <= 0.0
    turns = np.floor((at + math.pi) / (2.0 * math.pi))
    stable = np.sum(np.where(rising, turns, -turns)) == 0.0
    margin = math.pi - np.abs(np.remainder(at + math.pi, 2.0 * math.pi) - math.pi)
    least = float(np.min(margin, initial=math.pi))
    return least if stable else -least - 1.0, float(np.min(np.abs(1.0 + loop)))


def _motor_loops(design: Design) -> tuple[MotorLoop, ...]:
    """The motor loop of the design, and the one that runs where the design's is the
    ideal one.
    """
    settings = design.motor_loop
    return (
        (settings,)
        if settings.kind == "sampled"
        else (settings, replace(settings, kind="sampled"))
    )


def _arms(design: Design) -> Iterator[tuple[Arm, float]]:
    """Arms and payloads: payloads of the model, or the lightest and the heaviest of
    every arm of the box.
    """
    known = with_payload(design.model, design.rig)
    if design.box is None:
        for w0 in np.geomspace(*design.natural_frequencies, _PAYLOADS):
            yield (
                Arm(replace(known, natural_frequency=float(w0))),
                design.payload(float(w0)),
            )
        return
    for arm in arms_of(design.box, known):
        # The heaviest payload has the lowest ω₀: both ranges ascend, so they are gone
        # through in opposite directions. The box's own interval of ω₀ widens the range
        # at both ends.
        for end, payload in enumerate(reversed(design.payloads)):
            w0 = (
                design.natural_frequencies[end]
                * design.box.natural_frequency[end]
                / known.natural_frequency
            )
            yield replace(arm, model=replace(arm.model, natural_frequency=w0)), payload


def kept_by_law(
    design: Design, looked: Sequence[Looked]
) -> tuple[Requirement, Requirement]:
    """Return the requirements on the law as it ships: its worst phase margin and its
    least |1 + L|.

    The margin is what was asked for less the law's tolerance; the distance half of the
    2 sin(φ_m/2) that a margin φ_m leaves at most, and no more than a proof asks for.
    """
    least = min(looked, key=_phase_margin)
    nearest = min(looked, key=lambda one: one.margins.modulus_margin)
    distance = nearest.margins.modulus_margin if nearest.margins.stable else 0.0
    return (
        Requirement.at_least(
            LAW_MARGIN,
            design.phase_margin - _ALLOWANCE,
            least.phase_margin,
            "rad",
            least.payload,
        ),
        Requirement.at_least(
            LAW_MODULUS,
            least_modulus(design.phase_margin),
            distance,
            "",
            nearest.payload,
        ),
    )


def least_modulus(phase_margin: float) -> float:
    """Return the |1 + L| that the shipped law has to keep: half of what a margin
    leaves at most, and no more than a proof asks for.
    """
    return min(_MODULUS, math.sin(0.5 * phase_margin))


def no_law_kept(design: Design) -> Requirement:
    """Return the requirement on the law's margin where no law follows the controller."""
    wanted = design.phase_margin - _ALLOWANCE
    payload = design.payloads[0]
    return Requirement.at_least(LAW_MARGIN, wanted, -math.pi, "rad", payload)


def law_findings(design: Design, looked: Sequence[Looked]) -> tuple[Finding, ...]:
    """Return the findings of a design with W404 and W408, where its law keeps less than
    the design does.
    """
    least = min(looked, key=_phase_margin)
    kept = least.phase_margin
    # What an earlier look found is replaced: a design may be looked at by `design`, by
    # `with_law` and by `certify`.
    others = tuple(
        finding
        for finding in design.findings
        if finding.code not in ("W404", "W408", "W410")
    )
    short = design.phase_margin - kept
    # The paper's reading was not asked for a margin of the loop that runs: there only
    # stability counts.
    enough = LEAST_SHARE * design.phase_margin if design.margins_kind == "loop" else 0.0
    if short > 0.0:
        less = Finding(
            "W404",
            "error"
            if kept <= 0.0 or kept < enough
            else "warning"
            if short > _ALLOWANCE
            else "info",
            f"the shipped law in the sampled loop{_loop_of(design, least)} keeps less phase margin than "
            "requested",
            {
                "phase_margin_rad": kept,
                "wanted_rad": design.phase_margin,
                "payload_kg": least.payload,
            },
            "request that much more margin, for the whole loop"
            if least.motor_loop == design.motor_loop.kind
            else "design with inner='sampled' (--inner sampled), or with a longer filter",
        )
        others += (less,)
    return others if kept <= 0.0 else (*others, *_near_minus_one(design, looked))


def no_law(error: FieldError) -> Finding:
    """Return W410, that no law of law.c's size follows the controller."""
    return Finding(
        "W410",
        "error",
        f"no law follows this controller: it takes {error.value}, and law.c holds {error.allowed}",
        {},
        "ask for a smaller phase margin or a slower gain crossover",
    )


def _near_minus_one(design: Design, looked: Sequence[Looked]) -> tuple[Finding, ...]:
    """W408 where the sampled loop comes much closer to -1 than the design, as one
    without a filter may.
    """
    nearest = min(looked, key=lambda one: one.margins.modulus_margin)
    found = nearest.margins
    designed = design.full_loop.margins_at(
        design.natural_frequency(nearest.payload)
    ).modulus_margin
    if found.modulus_margin >= _NEAR * designed:
        return ()
    close = Finding(
        "W408",
        "error" if found.modulus_margin < _CLOSEST else "warning",
        f"the shipped law in the sampled loop{_loop_of(design, nearest)} comes to "
        f"|1 + L| = {found.modulus_margin:.2g} at {found.modulus_frequency:.4g} rad/s, "
        f"where the loop of the design keeps {designed:.2g}",
        {
            "modulus_margin": found.modulus_margin,
            "designed": designed,
            "payload_kg": nearest.payload,
        },
        "leave filter_time out: a filter keeps |L| small near the Nyquist frequency"
        if nearest.motor_loop == design.motor_loop.kind
        else "design with inner='sampled' (--inner sampled), or with a longer filter",
    )
    return (close,)


def _loop_of(design: Design, found: Looked) -> str:
    """What the loop has that the one of the design has not, as part of a sentence."""
    modes = ("the link's modes 2 and 3",) if design.rig.link.mass > 0.0 else ()
    pid = (
        ()
        if found.motor_loop == design.motor_loop.kind
        else ("the motor's PID at the control period",)
    )
    return f", with {' and '.join((*modes, *pid))}," if modes or pid else ""


def _phase_margin(found: Looked) -> float:
    return found.phase_margin
