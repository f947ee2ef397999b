"""A design: the controller that was designed, what was asked of it and what it achieves."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.controller import Controller
from fraclink._arm.motor_loop import MotorLoop
from fraclink._design.loop import OpenLoop
from fraclink._design.request import checked_natural_frequency, link_at, payload_of
from fraclink._design.sampled import SampledPlant, link_plant, realised
from fraclink.findings import Finding

if TYPE_CHECKING:
    from fraclink._arm.link import LinkModel
    from fraclink._arm.rig import Rig
    from fraclink._law import Law
    from fraclink._law.block import Precision
    from fraclink._systems.margins import Margins

__all__ = ["Design", "Requirement", "open_loop"]

_ROUNDING = 1e-9  # relative: the equations are solved to 1e-15, a requirement met with equality must hold


@dataclass(frozen=True)
class Requirement:
    """One requirement, the value achieved over the whole payload range, and where it is worst.

    ``slack`` is the distance from the wanted value, positive where the requirement holds with room to spare.
    ``at_payload`` [kg] is the payload of the worst value; ``unit`` the unit of wanted, achieved and slack.
    """

    name: str
    wanted: float
    achieved: float
    unit: str
    at_payload: float
    slack: float
    passed: bool

    @staticmethod
    def at_least(name: str, wanted: float, achieved: float, unit: str, at_payload: float) -> Requirement:
        """A lower bound: holds where achieved >= wanted.

        >>> Requirement.at_least("phase margin", 0.8, 0.9, "rad", 0.02).passed
        True
        """
        slack = achieved - wanted
        return Requirement(
            name, wanted, achieved, unit, at_payload, slack, slack >= -_ROUNDING * max(1.0, abs(wanted))
        )

    @staticmethod
    def at_most(name: str, wanted: float, achieved: float, unit: str, at_payload: float) -> Requirement:
        """An upper bound: holds where achieved <= wanted.

        >>> Requirement.at_most("Ms", 1.5, 1.6, "", 0.02).passed
        False
        """
        slack = wanted - achieved
        return Requirement(
            name, wanted, achieved, unit, at_payload, slack, slack >= -_ROUNDING * max(1.0, abs(wanted))
        )


def open_loop(controller: Controller, model: LinkModel, rig: Rig, *, margins: str) -> OpenLoop:
    """Return Ĉ·G alone (`margins` "ideal"), or with filter, M(s), hold and delay inside ("loop")."""
    inside = margins == "loop"
    inner = controller.inner
    pole = rig.inner.pole if inner is None else inner.pole
    samples = rig.inner.delay_samples if inner is None else inner.delay_samples
    period = rig.period if controller.period is None else controller.period
    kind = "ideal" if inner is None else inner.kind
    correction = None
    if inside and inner is not None and kind == "sampled":
        correction = inner.correction(rig.motor, period)
    return OpenLoop(
        gain=controller.gain,
        order=controller.order,
        link_order=model.order,
        damping=model.damping,
        damping_order=model.damping_order,
        filter_time=controller.filter_time if inside else 0.0,
        filter_order=controller.filter_order,
        lag=1.0 / pole if inside else 0.0,
        delay=(samples + 0.5) * period if inside else 0.0,
        correction=correction,
        lead=controller.lead,
    )


@dataclass(frozen=True)
class Design:
    """The answer of `design`.

    Attributes
    ----------
    model, rig
        what it was designed for.
    controller
        the controller (eq. (57)).
    requirements
        each requirement with the value achieved, the payload where it is worst, and the slack.
    margins_kind
        "loop" or "ideal": which loop the margins of ``at`` belong to.
    payloads
        (lightest, heaviest) [kg].
    natural_frequencies
        ω₀ at (heaviest, lightest) payload [s^(-λ/2)].
    gain_crossover, phase_margin
        as asked, [rad/s] and [rad].
    chi
        χ of eq. (54).
    gain_crossover_upper
        ω̄_c of eq. (55), the crossing at the lightest payload [rad/s].
    findings
        what a user should know (codes W4xx).

    Examples
    --------
    >>> import fraclink as fl
    >>> rig = fl.Rig.named("paper-2023")
    >>> design = fl.design(rig.model, rig, gain_crossover=12.0, phase_margin=fl.deg(50), filter_time=0.0)
    >>> design.passed, round(design.at(0.020).phase_margin / fl.deg(1), 3)
    (True, 50.0)
    >>> print(design)  # doctest: +ELLIPSIS
    C(s) = 1 + 0.0698... s^0.612...; margins of the "loop" loop
    ...
    """

    model: LinkModel
    rig: Rig
    controller: Controller
    requirements: tuple[Requirement, ...]
    margins_kind: str
    payloads: tuple[float, float]
    natural_frequencies: tuple[float, float]
    gain_crossover: float
    phase_margin: float
    chi: float
    gain_crossover_upper: float
    findings: tuple[Finding, ...] = ()

    def __str__(self) -> str:
        from fraclink._design.text import plan_text

        return plan_text(self)

    @property
    def passed(self) -> bool:
        """Whether every requirement holds over the whole payload range."""
        return all(requirement.passed for requirement in self.requirements)

    @property
    def loop(self) -> OpenLoop:
        """The open loop the design was asked for; call it with ω [rad/s] and ω₀."""
        return open_loop(self.controller, self.model, self.rig, margins=self.margins_kind)

    def natural_frequency(self, payload: float) -> float:
        """ω₀ of `payload` [kg] as the design used it (eq. (5)) [s^(-λ/2)]."""
        return link_at(self.model, self.rig, payload).natural_frequency

    def at(self, payload: float) -> Margins:
        """Return every margin of the loop the design was asked for, at `payload` [kg] > 0."""
        return self.at_frequency(self.natural_frequency(payload))

    def at_frequency(self, natural_frequency: float) -> Margins:
        """Return every margin of the loop the design was asked for, at a link with this ω₀ [s^(-λ/2)]."""
        from fraclink._systems.margins import margins

        checked_natural_frequency(natural_frequency)
        loop = self.loop

        def response(s: NDArray[np.complex128]) -> NDArray[np.complex128]:
            return loop(np.imag(s), natural_frequency)

        limit = math.pi / self.rig.period if self.margins_kind == "loop" else None
        return margins(response, limit=limit, unstable_poles=0)

    def sampled_plant(self, natural_frequency: float) -> SampledPlant:
        """Return what the law sees from its motor reference to the tip estimate, exactly sampled."""
        checked_natural_frequency(natural_frequency)
        inner, period = self.controller.inner or MotorLoop(), self.rig.period
        link = self.loop.link()
        if inner.kind == "sampled":
            motor = inner.sampled(self.rig.motor, period)
            return link_plant(link, natural_frequency, motor=motor, period=period, delay=0.0)
        delay = inner.delay_samples * period
        return link_plant(link, natural_frequency, motor=1.0 / inner.pole, period=period, delay=delay)

    def sampled_at(self, payload: float, *, realisation: str = "law") -> Margins:
        """Return every margin of the true sampled loop at `payload` [kg] > 0.

        Parameters
        ----------
        payload
            mass at the tip [kg].
        realisation
            "law" (the coefficients that are shipped), "exact" (Ĉ(jω) itself, which no computer runs) or
            "grunwald" (the paper's backward difference with all its memory, which lags by β ωTs/2).
        """
        from fraclink._systems.margins import margins

        plant = self.sampled_plant(self.natural_frequency(payload))
        outer = realised(self.controller, self.rig.period, realisation)

        def response(s: NDArray[np.complex128]) -> NDArray[np.complex128]:
            return outer(np.imag(s)) * plant(np.imag(s))

        return margins(response, limit=math.pi / self.rig.period, unstable_poles=0)

    def law(self, *, order: int | None = None, precision: Precision = "double") -> Law:
        """Return the law that runs on the rig: Ĉ at the period, and the motor loop the design was made for.

        `order` is the number of states of Ĉ; chosen to meet 0.1 dB and 0.5° when it is left out.
        """
        from fraclink._law import equip

        law = self.controller.discretize(self.rig.period, order=order, precision=precision)
        law = equip(law, self.rig, self.model)
        inner = self.controller.inner
        if inner is None or inner.placement != "direct" or law.drive is None:
            return law
        placed = inner.pid(self.rig.motor, self.rig.period)
        return replace(law, drive=replace(law.drive, loop=placed))

    def with_law(self) -> Design:
        """Return the design with the worst sampled margin of its law as a further requirement.

        The law is a fit: finding W404 says where it keeps less phase margin than was asked for.
        """
        from fraclink._design.shipped import with_law

        return with_law(self)

    def payload(self, natural_frequency: float) -> float:
        """Return the payload [kg] that gives the link this ω₀: the inverse of ``natural_frequency``."""
        return payload_of(self.model, self.rig, checked_natural_frequency(natural_frequency))

    def save(self, path: Path | str) -> None:
        """Write the design to one JSON file that ``Design.load`` reads back equal."""
        from fraclink._design.files import save_plan

        save_plan(self, Path(path))

    @staticmethod
    def load(path: Path | str) -> Design:
        """Read a design back; FileFormatError or FieldError where the file is not one."""
        from fraclink._design.files import load_plan

        return load_plan(Path(path))
