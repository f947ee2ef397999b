"""The set of arms that a move has to serve, and the result of the worst of them.

A feed-forward s^λ/ω₀² is exact for one link. The uncertainty of the link (the box of
its fit and its damping law) is therefore represented by a set of links, and a move is
judged by the worst of them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Annotated, Any, Literal

import numpy as np

from fraclink import _kernels
from fraclink._arm.box import ParameterBox
from fraclink._arm.link import LinkModel
from fraclink._arm.loop import with_payload
from fraclink._arm.reference import Reference, smooth_step
from fraclink._arm.rig import Rig
from fraclink._display import Overview, Row, Table, displayed, quantity, rows_of, span
from fraclink._files import document
from fraclink._law import Law
from fraclink._law.design import Design
from fraclink._law.estimator import PayloadEstimator
from fraclink._law.limits import UNBOUNDED
from fraclink._simulate.arm import Twin
from fraclink._simulate.estimates import ESTIMATED
from fraclink._simulate.metrics import growth_per_window
from fraclink._simulate.run import Run
from fraclink._simulate.simulate import simulate
from fraclink.errors import FieldError
from fracsys.checks import Between, ascending, checked

__all__ = [
    "ArmFigures",
    "ArmSet",
    "Over",
    "Told",
    "WorstCase",
    "links_over",
    "worst_case",
]

Over = Literal["model", "box"]
On = Literal["twin", "model"]
Told = bool | Literal["estimated"]
Payloads = Annotated[tuple[float, float], ascending()]

# step in ln m between two payloads: the frequency of the link changes by a tenth
PAYLOAD_STEP = 0.2
# vibration periods for which an arm is observed after the end of the reference
REST = 5.0
# the same for the linear loop, which shows a growth of a hundredth per period
LONGEST = 12.0
# [rad] height of the step that a linear loop is run with: far below every guard of the
# law, and far enough above the rounding of doubles
STEP = 1e-3


def links_over(model: LinkModel, rig: Rig, over: Over = "box") -> dict[str, LinkModel]:
    """Return the links that a move has to serve, by their descriptions, the model
    first.

    "box" adds the corners of the fit's box in ω₀, λ and μ, which is at least as wide as
    the rig's tolerances, and the link of the other damping law with the same ω₀ and
    damping ratio.

    >>> rig = Rig.named("paper-2023")
    >>> list(links_over(rig.model, rig))[-1]
    'viscous, ζ 0.0654'
    """
    links = {"model": model}
    if over == "model":
        return links
    box = ParameterBox.of(model, rig)
    corners = product(
        *map(dict.fromkeys, (box.natural_frequency, box.order, box.damping))
    )
    for frequency, order, damping in corners:
        link = replace(
            model,
            natural_frequency=frequency,
            order=order,
            damping=damping,
            intervals=(),
        )
        words = f"ω₀ {frequency:.4g}, λ {order:.4g}"
        links[f"{words}, μ {damping:.3g}" if damping else words] = link
    ratio = model.damping_ratio
    if model.order < 2.0:
        links[f"viscous, ζ {ratio:.3g}"] = replace(
            model,
            order=2.0,
            damping=2.0 * ratio * model.natural_frequency,
            damping_order=1.0,
            intervals=(),
        )
    else:
        # cos(π/λ) = −ζ: the pole of s^λ + ω₀² has the argument π/λ
        order = math.pi / math.acos(-ratio)
        links[f"fractional, λ {order:.4g}"] = replace(
            model, order=order, damping=0.0, intervals=()
        )
    return links


@dataclass(frozen=True)
class ArmSet:
    """A law and the arms that it moves: each of `links` with each of `payloads` [kg].

    given: the payload that the law is told with each arm, see `simulate`. on: whether
    the arms are twins of the rig, or massless links as identified.
    """

    rig: Rig
    law: Law
    model: LinkModel
    links: dict[str, LinkModel]
    payloads: tuple[float, ...]
    given: Mapping[tuple[LinkModel, float], float | PayloadEstimator]
    on: On

    @staticmethod
    def of(
        design: Design,
        payloads: tuple[float, float] | None,
        size: float,
        *,
        told: Told,
        over: Over,
        on: On,
    ) -> ArmSet:
        """Return the arms of a design that move by `size` [rad]; `payloads` default to
        those of the design.
        """
        low, high = payloads or design.payloads
        if low <= 0.0:
            raise FieldError(
                "payloads",
                low,
                "no payload",
                "> 0 kg",
                "give kg: 0.030 is 30 g",
            )
        steps = math.ceil(math.log(high / low) / PAYLOAD_STEP)
        # Geometric spacing, since ω₀ varies with the inverse square root of the
        # payload.
        masses = np.geomspace(low, high, steps + 1).tolist() if steps else [low]
        model = with_payload(design.model, design.rig)
        links = links_over(model, design.rig, over)
        each = tuple(product(links.values(), masses))
        given: dict[tuple[LinkModel, float], float | PayloadEstimator] = {
            arm: arm[1] if told else 0.0 for arm in each
        }
        arms = ArmSet(design.rig, design.law(), model, links, tuple(masses), given, on)
        if told != ESTIMATED:
            return arms
        # with another damping law than the model's, the estimate from a move differs from
        # the one from a free vibration
        first = smooth_step(size, arms.vibration)
        finding = replace(arms, given=dict.fromkeys(each, design.estimator()))
        found = {
            arm: float(finding.run(*arm, first).extras["payload_given"][-1])
            for arm in each
        }
        return replace(arms, given=found)

    @property
    def vibration(self) -> float:
        """Longest vibration period of the model [s], that with the heaviest payload."""
        return self.model.at_payload(self.payloads[-1]).vibration_period

    @property
    def linear(self) -> ArmSet:
        """The set with linear loops: without friction, its compensation, and limits, and
        with sensors without quantisation, noise and offset; the gauge's delay remains.
        """
        drive = self.law.motor_loop
        assert drive is not None  # a design's law drives its motor  # noqa: S101
        free = replace(drive, coulomb_voltage=0.0, voltage_limit=UNBOUNDED)
        law = replace(self.law, motor_loop=free).in_precision("double")
        rig = self.rig
        motor = replace(rig.motor, coulomb_torque=0.0, voltage_limit=math.inf)
        gauge = replace(rig.gauge, noise=0.0, offset=0.0, quantum=0.0, limit=math.inf)
        encoder = replace(rig.encoder, counts_per_revolution=None)
        ideal = replace(rig, motor=motor, gauge=gauge, encoder=encoder)
        return replace(self, rig=ideal, law=law)

    @cached_property
    def unstable(self) -> tuple[tuple[str, float], ...]:
        """The links, by their words, and payloads [kg] with which the linear loop is
        unstable: its vibration grows, however small it is at the end of a move.
        """
        linear, window = self.linear, round(self.vibration / self.law.period)
        step = smooth_step(STEP, 0.1 * self.vibration)

        def grows(link: LinkModel, payload: float) -> bool:
            run = linear.run(link, payload, step, duration=LONGEST * self.vibration)
            left = run.tip_angle[window:] / STEP - 1.0
            # a guard of the law stops a vibration that would grow beyond all bounds
            return _guarded(run) or growth_per_window(left, window) > 0.0

        arms = product(self.links.items(), self.payloads)
        return tuple((words, m) for (words, link), m in arms if grows(link, m))

    def run(
        self,
        link: LinkModel,
        payload: float,
        reference: Reference,
        *,
        seed: int = 0,
        duration: float | None = None,
    ) -> Run:
        """Run a reference on one arm of the set until the arm has come to rest."""
        length = reference.duration + REST * self.vibration
        options: dict[str, Any] = {
            "told": self.given[link, payload],
            "duration": length if duration is None else duration,
            "seed": seed,
        }
        if self.on == "model":
            return simulate(
                self.law,
                reference,
                rig=self.rig,
                model=link,
                payload=payload,
                **options,
            )
        # The rig's stiffness and length determine the frequency of the twin: another ω₀
        # than the model's corresponds to another mass at the tip.
        other = (self.model.natural_frequency / link.natural_frequency) ** 2
        twin = Twin.from_rig(self.rig, model=link, payload=payload * other)
        return simulate(self.law, reference, arm=twin, **options)

    def figures(self, reference: Reference, seeds: int) -> tuple[ArmFigures, ...]:
        """Return the figures of a reference for each link of the set."""
        rows = []
        for words, link in self.links.items():
            runs = [
                (payload, self.run(link, payload, reference, seed=seed))
                for payload in self.payloads
                for seed in range(seeds)
            ]
            # A run that was cut off has not settled, nor has one whose vibration will
            # leave the band again.
            settling = [
                run.metrics.settling_time
                if run.verdict.passed and (words, payload) not in self.unstable
                else math.inf
                for payload, run in runs
            ]
            latest = np.argmax(settling)
            rows.append(
                ArmFigures(
                    arm=words,
                    payload=runs[latest][0],
                    settling_time=settling[latest],
                    overshoot=max(run.metrics.overshoot for _, run in runs),
                    residual_vibration=max(
                        run.metrics.residual_vibration for _, run in runs
                    ),
                    peak_voltage=max(run.metrics.peak_voltage for _, run in runs),
                    guarded=sum(_guarded(run) for _, run in runs) / len(runs),
                )
            )
        return tuple(rows)


def _guarded(run: Run) -> bool:
    """Whether a guard of the law acted on the reference, the motor or the voltage."""
    return bool(np.any(run.flags & ~np.uint32(_kernels.LAW_FLAG_STARTED)))


@dataclass(frozen=True)
class ArmFigures:
    """The figures of a move for one link of a set: the worst over its payloads and
    seeds.

    Parameters
    ----------
    arm
        the link in words.
    payload
        with which it settles last [kg].
    settling_time
        time from which the tip stays within 2 % of the move [s]; infinite where a run
        does not pass.
    overshoot
        of the move [1].
    residual_vibration
        half the peak-to-peak tip angle after the reference has come to rest [rad].
    peak_voltage
        largest |voltage| [V].
    guarded
        part of the runs in which a guard of the law acted [1].
    """

    arm: str
    payload: float
    settling_time: float
    overshoot: float
    residual_vibration: float
    peak_voltage: float
    guarded: float

    @property
    def rows(self) -> tuple[Row, ...]:
        """The figures as shown to people and programs."""
        return rows_of(
            self,
            ("arm", "arm"),
            Row.time("settling_time", "settles to 2 %", self.settling_time),
            ("payload", "with", "g"),
            ("overshoot", "overshoot", "%", 2),
            ("residual_vibration", "residual vibration", "mrad"),
            ("peak_voltage", "peak voltage", "V", 3),
            ("guarded", "guards act in runs", "%", 2),
        )


@displayed
@document(
    "worst-case",
    version=1,
    sources=lambda case: {"law": case.law_sha256},
    summary=lambda case: {"settling_time": case.settling_time},
)
@dataclass(frozen=True)
class WorstCase:
    """One move on every arm of a set.

    Parameters
    ----------
    arms
        one row for each link of the set, the model first.
    payloads
        lightest and heaviest [kg].
    told
        whether the law was given the payload, or "estimated".
    on
        "twin" or "model".
    law_sha256
        digest of the law that ran.
    """

    arms: tuple[ArmFigures, ...]
    payloads: tuple[float, float]
    told: Told
    on: str
    law_sha256: str

    @property
    def worst(self) -> ArmFigures:
        """The arm that settles last."""
        return max(self.arms, key=lambda each: each.settling_time)

    @property
    def settling_time(self) -> float:
        """Longest settling time of all arms [s]."""
        return self.worst.settling_time

    @property
    def carried(self) -> str:
        """The payloads, and whether they were given to the law."""
        state = "given" if self.told is True else self.told or "not given"
        return f"{span(*self.payloads, 'g')}, payload {state}"

    def overview(self) -> Overview:
        """The arm that settles last, and every arm of the set."""
        worst = self.worst
        rows = rows_of(self, "settling_time", "payloads", "told", "on")
        time = Row.time("", "", self.settling_time).text
        result = (
            f"every arm settles within {time}, last"
            if math.isfinite(self.settling_time)
            else "not every arm settles; worst is"
        )
        return Overview(
            f"{self.carried}: {result} the arm “{worst.arm}” with {quantity(worst.payload, 'g')}",
            rows=rows,
            tables=(Table.of("arms", self.arms),),
        )

    @property
    def nominal(self) -> ArmFigures:
        """The arm for which the law was made."""
        return self.arms[0]


@checked
def worst_case(
    design: Design,
    reference: Reference,
    *,
    payloads: Payloads | None = None,
    told: Told = False,
    over: Over = "box",
    on: On = "twin",
    seeds: Annotated[int, Between(1, 1000)] = 1,
) -> WorstCase:
    """Return the result of a move on every arm of a set: the links of the fit's box and
    of both damping laws, with every payload of a range.

    Parameters
    ----------
    design
        whose shipped law runs.
    reference
        of the tip.
    payloads
        lightest and heaviest payload [kg]; the design's where it is left out.
    told
        whether the law is given the payload; "estimated": the payload that its estimator
        finds in a first move of the same size that takes one vibration period.
    over
        "box": the fit's box, at least as wide as the rig's tolerances, and the other
        damping law with the same damping ratio; "model": the model alone.
    on
        "twin": arms with distributed mass, friction and sensors, made from the rig's
        stiffness and length; "model": massless links as they were identified.
    seeds
        number of noise seeds with which each arm is run.

    Raises
    ------
    FieldError
        a value out of its range.

    Examples
    --------
    >>> import fraclink as fl
    >>> rig = fl.Rig.named("paper-2023-geared")
    >>> design = fl.design(rig.model, rig, payloads=(0.020, 0.040), gain_crossover=12.0,
    ...                    phase_margin=fl.deg(50), filter_time=0.02)
    >>> case = worst_case(design, fl.smooth_step(1.0, 0.5), payloads=(0.030, 0.030), told=True)
    >>> case.nominal.settling_time < 0.5 < case.settling_time, case.worst.arm
    (True, 'viscous, ζ 0.0654')
    """
    start, end = (reference.angle(time) for time in (0.0, reference.duration))
    arms = ArmSet.of(design, payloads, float(end - start), told=told, over=over, on=on)
    return WorstCase(
        arms.figures(reference, seeds),
        (arms.payloads[0], arms.payloads[-1]),
        told,
        on,
        arms.law.digest,
    )
