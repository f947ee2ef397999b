"""What a design is asked for, and what it is: `Specification`, `Requirement`, `Design`."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.box import ParameterBox
from fraclink._arm.controller import Controller
from fraclink._arm.link import LinkModel
from fraclink._arm.loop import Loop, with_payload
from fraclink._arm.motor_loop import MotorLoop
from fraclink._arm.rig import Rig
from fraclink._arm.sampled import SampledPlant, sampled_plant
from fraclink._display import displayed
from fraclink._files import document, load, save
from fraclink._law.discretization import discretize, discretize_controller
from fraclink._law.estimator import PayloadEstimator, payload_estimator
from fraclink._law.requirement import (
    LAW_MARGIN,
    LAW_MODULUS,
    Looked,
    Requirement,
    kept_by_law,
    law_findings,
    law_margins,
    margins_of,
    no_law,
    no_law_kept,
)
from fraclink.errors import FieldError
from fraclink.findings import Finding, errors_of
from fracsys.checks import (
    Between,
    Duration,
    Frequency,
    NaturalFrequency,
    Ordered,
    Payload,
    PhaseMargin,
    checked,
    checked_between,
    checked_choice,
)

if TYPE_CHECKING:
    from fraclink._law.block import Precision
    from fraclink._law.law import Law
    from fracsys._margins import Margins

__all__ = ["Design", "Requirement", "Specification", "deg"]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


def deg(angle: float) -> float:
    """Return an angle given in degrees in radians, ``x π/180``.

    Parameters
    ----------
    angle
        angle [deg], any finite number.

    Examples
    --------
    >>> round(deg(50), 6)
    0.872665
    """
    return math.radians(checked_between("angle", angle, -1e9, 1e9, "deg"))


@checked
@dataclass(frozen=True)
class Specification:
    """What a design is asked for; None leaves a value to its rule.

    Parameters
    ----------
    payloads
        (lightest, heaviest) [kg]; the rig's own where neither range is given.
    natural_frequencies
        (low, high) ω₀ [s^(-λ/2)] instead of payloads.
    gain_crossover
        least ω_c [rad/s] over the range; from `settling_time` when left out.
    phase_margin
        least φ_m [rad] over the range; from `max_sensitivity` when left out.
    margins
        "loop" (everything that is in the real loop) or "ideal" (the paper's reading,
        Ĉ·G alone).
    filter_time
        δ [s], 0 for no filter; chosen so that it costs 10 % of the margin when left
        out.
    filter_order
        n; 1 for β < 1 and 2 otherwise when left out.
    inner
        the motor loop that is assumed: "ideal" or "sampled".
    placement
        of the sampled motor loop's poles, "tustin" or "direct".
    max_sensitivity
        bound on Ms.
    noise_gain
        bound on the motor reference's RMS for white gauge noise of RMS one.
    settling_time
        bound on 2π/ω_c [s].
    mode_gain
        bound on the loop gain at the higher modes of the link.

    Examples
    --------
    >>> Specification(gain_crossover=12, phase_margin=deg(50)).margins
    'loop'
    """

    payloads: Annotated[tuple[Payload, Payload], Ordered()] | None = None
    natural_frequencies: (
        Annotated[tuple[NaturalFrequency, NaturalFrequency], Ordered()] | None
    ) = None
    gain_crossover: Frequency | None = None
    phase_margin: PhaseMargin | None = None
    margins: Literal["loop", "ideal"] = "loop"
    filter_time: Annotated[float, Between(0.0, 1e3, "s")] | None = None
    filter_order: (
        Annotated[int, Between(1, 2, remedy="use 1 for β < 1, else 2")] | None
    ) = None
    inner: Literal["ideal", "sampled"] = "ideal"
    placement: Literal["tustin", "direct"] = "tustin"
    max_sensitivity: Annotated[float, Between(1.0, 100.0, low_open=True)] | None = None
    noise_gain: Annotated[float, Between(0.0, 1e6, low_open=True)] | None = None
    settling_time: Duration | None = None
    mode_gain: Annotated[float, Between(0.0, 1e3, low_open=True)] | None = None

    @property
    def bounded(self) -> bool:
        """Whether anything is bounded beside crossover and phase margin."""
        bounds = (
            self.max_sensitivity,
            self.noise_gain,
            self.settling_time,
            self.mode_gain,
        )
        return any(bound is not None for bound in bounds)


@displayed
@document(
    "design",
    version=3,
    period=lambda made: made.rig.period,
    summary=lambda made: {"passed": made.passed, "controller": made.controller.formula},
)
@dataclass(frozen=True)
class Design:
    """Result of `design`.

    Attributes
    ----------
    model, rig
        what it was designed for.
    controller
        the controller (eq. (57)).
    requirements
        each requirement with the value achieved, the payload where it is worst, and the
        slack.
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
    box
        the arms that keep the requirements; None where that is the model alone.

    Examples
    --------
    >>> import fraclink as fl
    >>> rig = fl.Rig.named("paper-2023")
    >>> design = fl.design(rig.model, rig, gain_crossover=12.0, phase_margin=fl.deg(50), filter_time=0.0)
    >>> design.passed, round(design.at(0.020).phase_margin / fl.deg(1))
    (True, 50)
    >>> print(design)  # doctest: +ELLIPSIS
    C(s) = 1 + 0.0698... s^0.612...; margins of the "loop" loop
    ...
    """

    __made_by__ = "fraclink.design(model, rig)"

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
    box: ParameterBox | None = None

    def __str__(self) -> str:
        lines = [
            f'{self.controller.formula}; margins of the "{self.margins_kind}" loop'
        ]
        return "\n".join(
            [*lines, *map(str, self.requirements), *map(str, self.findings)]
        )

    @property
    def passed(self) -> bool:
        """Whether every requirement is met over the whole payload range, and no finding
        is an error.
        """
        return (
            all(requirement.passed for requirement in self.requirements)
            and not self.doubts
        )

    @property
    def doubts(self) -> tuple[Finding, ...]:
        """The findings that are errors: with a wrong model or rig, met requirements
        show nothing.
        """
        return errors_of(self.findings)

    @property
    def has_law(self) -> bool:
        """Whether a law follows the controller, as far as that was looked at: False
        behind W410.
        """
        return all(finding.code != "W410" for finding in self.findings)

    def doubted(self, findings: Iterable[Finding]) -> Design:
        """Return the design with the errors among `findings`, such as those of the fit
        that it rests on.
        """
        # Errors only: a warning of a fit is the fit's to tell, an error takes the
        # ground from under the design. As a set that keeps its order, so that saying it
        # twice changes nothing.
        return replace(
            self, findings=tuple(dict.fromkeys((*errors_of(findings), *self.findings)))
        )

    @property
    def motor_loop(self) -> MotorLoop:
        """The motor loop that the controller was designed for."""
        return self.controller.inner or MotorLoop(
            self.rig.motor_loop.pole, self.rig.motor_loop.delay_samples
        )

    @property
    def loop(self) -> Loop:
        """The open loop the design was asked for; call it with ω [rad/s] and ω₀."""
        return self.full_loop if self.margins_kind == "loop" else self.ideal_loop

    @property
    def full_loop(self) -> Loop:
        """The loop that runs, whichever the design was asked for."""
        return Loop.of(self.controller, self.model, self.rig)

    @property
    def ideal_loop(self) -> Loop:
        """Ĉ·G alone, without the filter: the paper's L."""
        return Loop.ideal(self.model).with_controller(self.controller.without_filter())

    def natural_frequency(self, payload: float) -> float:
        """ω₀ of `payload` [kg] as the design used it (eq. (5)) [s^(-λ/2)]."""
        return with_payload(self.model, self.rig).at_payload(payload).natural_frequency

    def payload(self, natural_frequency: float) -> float:
        """Return the payload [kg] that gives the link this ω₀: the inverse of
        ``natural_frequency``.
        """
        return with_payload(self.model, self.rig).payload_at(
            _checked_frequency(natural_frequency)
        )

    def at(self, payload: float) -> Margins:
        """Return every margin of the loop the design was asked for, at `payload` [kg] >
        0.
        """
        return self.at_frequency(self.natural_frequency(payload))

    def at_frequency(self, natural_frequency: float) -> Margins:
        """Return every margin of the loop the design was asked for, at a link with this
        ω₀ [s^(-λ/2)].
        """
        return self.loop.margins_at(_checked_frequency(natural_frequency))

    def sampled_plant(self, natural_frequency: float) -> SampledPlant:
        """Return what the law sees from its motor reference to the tip estimate,
        exactly sampled.
        """
        # ω₀ alone: the plant knows no payload, and a design for ω₀ in its own right has
        # none to be converted.
        link = replace(
            self.model, natural_frequency=_checked_frequency(natural_frequency)
        )
        return sampled_plant(link, self.motor_loop, self.rig.motor, self.rig.period)

    def sampled_at(
        self, payload: float, *, realisation: Callable[[Real], Complex] | str = "law"
    ) -> Margins:
        """Return every margin of the true sampled loop at `payload` [kg] > 0.

        Parameters
        ----------
        payload
            mass at the tip [kg].
        realisation
            "law" (the coefficients that are shipped), "exact" (Ĉ(jω) itself, which no
            computer runs), or Ĉ on the unit circle as a function of ω [rad/s].
        """
        if not callable(realisation):
            checked_choice(
                "realisation",
                realisation,
                ("law", "exact"),
                remedy="say 'law' for what is shipped",
            )
            shipped = realisation == "law"
            law = (
                discretize_controller(self.controller, self.rig.period)
                if shipped
                else None
            )
            realisation = law.frequency_response if law else self.controller.response
        else:
            _check_response(realisation)
        response, plant = (
            realisation,
            self.sampled_plant(self.natural_frequency(payload)),
        )
        return margins_of(response, plant)

    def law(self, *, order: int | None = None, precision: Precision = "single") -> Law:
        """Return the law that runs on the rig, `fraclink.discretize` of this design."""
        return discretize(self, order=order, precision=precision)

    def estimator(self, *, gain_doubt: float | None = None) -> PayloadEstimator:
        """Return the payload estimator of this arm, `fraclink.extend.payload_estimator` of
        this design.
        """
        link = with_payload(self.model, self.rig)
        return payload_estimator(
            link, self.rig, self.law(), self.payloads, gain_doubt=gain_doubt
        )

    def with_law(self) -> Design:
        """Return the design with the requirements on its law as it ships: the worst
        phase margin of the sampled loop, and its distance from -1.

        The margin is the one asked for less the law's own tolerance of 0.5°, over the
        payloads and over the box. A design for the paper's reading (`margins` "ideal")
        gets the findings of `warned_of_law` instead: the sampled loop was not what it
        was asked for.
        """
        if self.margins_kind == "ideal":
            return self.warned_of_law()
        # Asked twice, it is still one requirement each.
        others = tuple(
            r for r in self.requirements if r.name not in (LAW_MARGIN, LAW_MODULUS)
        )
        try:
            rows = kept_by_law(self, law_margins(self))
        except FieldError as error:
            if error.field != "order":
                raise
            findings = tuple(dict.fromkeys((*self.findings, no_law(error))))
            kept = (*others, no_law_kept(self))
            return replace(self, requirements=kept, findings=findings)
        return replace(self, requirements=(*others, *rows))

    def warned_of_law(self) -> Design:
        """Return the design with what its law keeps less in the sampled loop, as
        `design` looks at it.

        Finding W404 says that the phase margin is less than was asked for, an error where it is less than
        half of it; W408 that the law comes closer to -1 than half of what the design does, an error where
        |1 + L| < 0.1. Both are looked at with the modes of the link's mass. Near the Nyquist
        frequency a loop without a filter may, and crosses |L| = 1 nowhere near. A controller that no law of
        law.c's size follows is an error, too (W410).
        """
        return replace(self, findings=self._law_looked_at()[1])

    def _law_looked_at(self) -> tuple[tuple[Looked, ...], tuple[Finding, ...]]:
        """The law's margins, and the findings with what they say; no margins where no
        law fits.
        """
        try:
            found = law_margins(self)
        except FieldError as error:
            # "order" is the field of `modes_from`, for a fit of more modes than law.c
            # holds; any other fault is the caller's.
            if error.field != "order":
                raise
            return (), tuple(dict.fromkeys((*self.findings, no_law(error))))
        return found, law_findings(self, found)

    def save(self, path: Path | str) -> None:
        """Write the design to one JSON file that ``Design.load`` reads back equal."""
        save(self, path, force=True)

    @staticmethod
    def load(path: Path | str) -> Design:
        """Read a design back; FileFormatError where the file is not one, or was edited."""
        return load(path, Design)


def _check_response(response: Callable[[Real], Complex]) -> None:
    """Raise FieldError where `response` does not turn frequencies into as many complex
    values.
    """
    try:
        # Tried on two frequencies: a function of one number would fail deep inside the
        # search for margins.
        shape = np.asarray(response(np.array([1.0, 2.0])), dtype=np.complex128).shape
    except (TypeError, ValueError):
        shape = ()
    if shape != (2,):
        allowed, remedy = (
            "Ĉ as a function of ω [rad/s], shape kept",
            "say 'law' for what is shipped",
        )
        raise FieldError(
            "realisation",
            repr(response),
            "not a response",
            allowed=allowed,
            remedy=remedy,
        )


def _checked_frequency(value: object) -> float:
    return checked_between(
        "natural_frequency", value, 0.0, 1e6, "s^(-λ/2)", open_low=True
    )
