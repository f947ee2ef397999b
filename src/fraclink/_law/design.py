"""A design and its requirements: `Specification` and `Design`."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Literal, TypedDict

from fraclink._arm.box import ParameterBox
from fraclink._arm.controller import Controller
from fraclink._arm.link import LinkModel
from fraclink._arm.loop import Loop, with_payload
from fraclink._arm.motor_loop import MotorLoop
from fraclink._arm.rig import Rig
from fraclink._arm.sampled import SampledPlant, sampled_plant
from fraclink._display import (
    Listed,
    Overview,
    Row,
    Table,
    displayed,
    quantity,
    rows_of,
    span,
)
from fraclink._files import Saved, document
from fraclink._law.discretization import discretize, discretize_controller
from fraclink._law.estimator import PayloadEstimator, payload_estimator
from fraclink._law.requirement import (
    Requirement,
    law_rows,
    margins_of,
    no_law,
    no_law_rows,
)
from fraclink.errors import FieldError
from fraclink.findings import Finding, Findings, errors_of
from fracsys.checks import (
    Between,
    Complex,
    Duration,
    Frequency,
    NaturalFrequency,
    Payload,
    PhaseMargin,
    Real,
    above,
    ascending,
)

if TYPE_CHECKING:
    from fraclink._law.block import Precision
    from fraclink._law.law import Law
    from fracsys._margins import Margins

__all__ = ["Design", "Requirement", "Specification", "deg"]


def deg(angle: float) -> float:
    """Return in radians an angle given in degrees, ``x π/180``.

    Parameters
    ----------
    angle
        angle [deg], any finite number.

    Examples
    --------
    >>> round(deg(50), 6)
    0.872665
    """
    return math.radians(Between(-1e9, 1e9, "deg").check("angle", angle))


class Specification(TypedDict, total=False):
    """The requirements of a design, each with what applies where it is left out.

    Parameters
    ----------
    payloads
        (lightest, heaviest) [kg]; the rig's own where neither range is given.
    natural_frequencies
        (low, high) ω₀ [s^(-λ/2)] instead of payloads.
    gain_crossover
        least ω_c [rad/s] over the range, below the motor loop's pole.
    settling_time
        bound on 2π/ω_c [s].
    phase_margin
        least φ_m [rad] over the range; the one that `max_sensitivity` implies when left
        out.
    max_sensitivity
        bound on Ms = max 1/|1 + L|; 2 where no margin is asked for.
    noise_gain
        bound on the motor reference's RMS for white gauge noise of RMS one.
    mode_gain
        bound on the loop gain at the higher modes of the link. Below one no phase
        of the mode can destabilise the loop. If the model has a second mode or the rig
        a link mass, the bound is 0.5 by default; if no controller keeps it at the
        model's second mode, that mode may exceed it with a phase that keeps the loop
        away from -1 at every payload.
    filter_time
        δ [s], 0 for no filter; chosen with the controller when left out.
    filter_order
        n; chosen with the controller when left out.
    motor_loop
        the motor loop that is assumed: "sampled", the PID at the control period, or
        "ideal", M(s) as it is written.
    placement
        of the sampled motor loop: "direct" places its poles in z, its delay included;
        "tustin" discretises (19), (20).

    Examples
    --------
    >>> asked = Specification(gain_crossover=12.0, phase_margin=deg(50))
    >>> sorted(asked)
    ['gain_crossover', 'phase_margin']
    """

    payloads: Annotated[tuple[Payload, Payload], ascending()] | None
    natural_frequencies: (
        Annotated[tuple[NaturalFrequency, NaturalFrequency], ascending()] | None
    )
    gain_crossover: Frequency | None
    phase_margin: PhaseMargin | None
    filter_time: Annotated[float, Between(0.0, 1e3, "s")] | None
    filter_order: Annotated[int, Between(1, 2, remedy="use 1 for β < 1, else 2")] | None
    motor_loop: Literal["ideal", "sampled"] | None
    placement: Literal["tustin", "direct"] | None
    settling_time: Duration | None
    max_sensitivity: Annotated[float, above(1.0, 100.0)] | None
    noise_gain: Annotated[float, above(0.0, 1e6)] | None
    mode_gain: Annotated[float, above(0.0, 1e3)] | None


@displayed
@document(
    "design",
    version=3,
    period=lambda made: made.rig.period,
    summary=lambda made: {"passed": made.passed, "controller": made.controller.formula},
)
@dataclass(frozen=True)
class Design(Saved):
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
        [rad/s] and [rad], as asked for; else the crossover that is reached and the
        margin that Ms implies.
    chi
        χ of eq. (54).
    gain_crossover_upper
        ω̄_c of eq. (55), the crossing at the lightest payload [rad/s].
    findings
        what a user should know (codes W4xx).
    box
        the arms that must keep the requirements; None for the model alone.

    Examples
    --------
    >>> import fraclink as fl
    >>> rig = fl.Rig.named("paper-2023")
    >>> design = fl.design(rig.model, rig, gain_crossover=12.0, phase_margin=fl.deg(50), filter_time=0.0)
    >>> design.passed, round(design.at(0.020).phase_margin / fl.deg(1))
    (True, 50)
    >>> print(design)  # doctest: +ELLIPSIS
    ✓ passed: carries 20 to 40 g at 12 rad/s with a phase margin of 50.0°; ...
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

    def __post_init__(self) -> None:
        object.__setattr__(self, "requirements", Listed(self.requirements))
        object.__setattr__(self, "findings", Findings(self.findings))

    @property
    def sentence(self) -> str:
        """The result in one sentence: payloads, crossover and phase margin, the further
        delay it tolerates, and its tightest requirement.
        """
        masses = span(*self.payloads, "g")
        parts = [
            f"carries {masses} at {quantity(self.gain_crossover, 'rad/s')} with a phase "
            f"margin of {quantity(self.phase_margin, 'rad')}"
        ]
        late = [r.achieved for r in self.requirements if r.name == "delay margin"]
        if late and late[0] > 0.0:
            parts.append(f"stays stable with {quantity(late[0], 'ms', 2)} more delay")
        parts += [f"missed: {requirement}" for requirement in self.missed]
        # Crossover and phase margin are in the sentence already; it names the tightest of
        # the others.
        others = [
            r
            for r in self.requirements
            if r.name not in ("gain crossover", "phase margin")
        ]
        if others and not self.missed:
            least = min(others, key=lambda r: r.spare)
            slack = quantity(max(0.0, least.slack), least.unit, 2)
            payload = quantity(least.at_payload, "g")
            parts.append(f"tightest: {least.name}, {slack} to spare at {payload}")
        return "; ".join(parts)

    def overview(self) -> Overview:
        """The summary sentence, the controller, and every requirement."""
        notch = self.controller.notch
        rows = rows_of(
            self,
            Row("margins", "", self.margins_kind),
            ("controller.derivative_gain", "k_d", "s^β", 5),
            ("controller.derivative_order", "β", "", 5),
            ("controller.filter_time", "δ", "ms"),
            ("controller.filter_order", "n"),
            Row("notch", "notch", notch and notch.frequency, "rad/s"),
            ("gain_crossover_upper", "ω̄_c", "rad/s"),
            Row(
                "",
                "box",
                "its worst arm counts in every row"
                if self.box
                else "not asked for: arms that differ from the model were not looked at",
            ),
        )
        # A doubt about the input outranks requirements that are met, because they are
        # met by a doubtful model; a missed one fails in any case.
        state = "failed" if self.missed else "not shown" if self.doubts else "passed"
        return Overview(
            self.sentence,
            state,
            rows,
            (Table.of("requirements", self.requirements),),
            self.findings,
        )

    @property
    def passed(self) -> bool:
        """Whether every requirement is met over the whole payload range, and no finding
        casts doubt on model or rig; False where no requirement was measured.
        """
        return bool(self.requirements) and not self.missed and not self.doubts

    @property
    def missed(self) -> tuple[Requirement, ...]:
        """The requirements that are not met."""
        return tuple(r for r in self.requirements if not r.passed)

    @property
    def doubts(self) -> tuple[Finding, ...]:
        """The findings that are errors: with a wrong model or rig, met requirements
        show nothing.
        """
        return errors_of(self.findings)

    @property
    def has_law(self) -> bool:
        """Whether a law can follow the controller: False only if the attempt failed, with
        finding W410.
        """
        return all(finding.code != "W410" for finding in self.findings)

    def doubted(self, findings: Iterable[Finding]) -> Design:
        """Return the design with the errors among `findings`, such as those of the fit
        that it rests on.
        """
        # Errors only, each once: the fit's warnings belong to its own report.
        return replace(
            self, findings=tuple(dict.fromkeys((*errors_of(findings), *self.findings)))
        )

    @property
    def motor_loop(self) -> MotorLoop:
        """The motor loop that the controller was designed for."""
        return self.controller.motor_loop or MotorLoop(
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
        return Loop.ideal(self.model).with_controller(
            replace(self.controller, filter_time=0.0)
        )

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
        """Return the exactly sampled plant from the law's motor reference to its tip
        estimate.
        """
        # By ω₀ alone: a design for natural frequencies may have no payload to convert.
        ratio = self.model.natural_frequency / _checked_frequency(natural_frequency)
        link = self.model.with_mass(ratio**2)
        return sampled_plant(link, self.motor_loop, self.rig.motor, self.rig.period)

    def sampled_at(
        self,
        payload: float,
        *,
        correction: Callable[[Real], Complex] | None = None,
    ) -> Margins:
        """Return every margin of the true sampled loop at `payload` [kg] > 0.

        Parameters
        ----------
        payload
            mass at the tip [kg].
        correction
            Ĉ on the unit circle as a function of ω [rad/s], such as the exact
            `controller.response`, which no computer runs; the response of the shipped
            coefficients where it is left out.
        """
        if correction is None:
            law = discretize_controller(self.controller, self.rig.period)
            correction = law.frequency_response
        plant = self.sampled_plant(self.natural_frequency(payload))
        return margins_of(correction, plant)

    def law(self, *, order: int | None = None, precision: Precision = "single") -> Law:
        """Return the law that runs on the rig, `fraclink.discretize` of this design."""
        return discretize(self, order=order, precision=precision)

    def estimator(self) -> PayloadEstimator:
        """Return the payload estimator of this arm, `fraclink.extend.payload_estimator` of
        this design.
        """
        link = with_payload(self.model, self.rig)
        return payload_estimator(link, self.rig, self.law(), self.payloads)

    def with_law(self) -> Design:
        """Return the design with the requirements on its law as it ships: the worst
        phase margin of the sampled loop, and its distance from -1.

        The required margin is the one asked for less the law's own tolerance of 0.5°,
        over the payloads or over the box, with the motor loop that runs and the modes
        of the link's mass; a design by the paper's L (`margins_kind` "ideal") only has
        to be stable. A controller that no law of law.c's size follows meets neither
        requirement (W410).
        """
        findings, rows = self.findings, no_law_rows(self)
        try:
            rows = law_rows(self)
        except FieldError as error:
            # `modes_from` raises "order" if the fit has more modes than law.c can hold;
            # any other error belongs to the caller.
            if error.field != "order":
                raise
            findings = tuple(dict.fromkeys((*findings, no_law(error))))
        # Applied twice, each is still a single requirement.
        names = {row.name for row in rows}
        others = (item for item in self.requirements if item.name not in names)
        return replace(self, requirements=(*others, *rows), findings=findings)


def _checked_frequency(value: object) -> float:
    return above(0.0, 1e6, "s^(-λ/2)").check("natural_frequency", value)
