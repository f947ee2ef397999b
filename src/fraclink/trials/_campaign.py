"""A campaign: one law, the arm for which it was made, and the parameters that vary
between arms.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from scipy.special import ndtr, ndtri

from fraclink._arm.link import LinkModel
from fraclink._arm.loop import with_payload
from fraclink._arm.reference import (
    Path,
    Reference,
    SampledReference,
    sampled,
    smooth_step,
)
from fraclink._arm.rig import Rig
from fraclink._law import Law, equip
from fraclink._law.estimator import PayloadEstimator, payload_estimator
from fraclink.errors import FieldError
from fracsys.checks import Between, Real, above, checked

__all__ = [
    "PART_RUNS",
    "SHAPES",
    "Campaign",
    "Distribution",
    "Draws",
    "draw",
    "draws_for",
]


# runs that are drawn from one stream of random numbers, and simulated by one thread
PART_RUNS = 1000
# After the longest move, an arm is observed for five periods of its link's vibration, and
# for 3 s at least.
REST, VIBRATIONS = 3.0, 5.0
SHAPES = (0.5, 0.75, 1.0)  # durations of the drawn moves [s]
DURATION = max(SHAPES) + REST
# A normal draw is truncated at ±4σ, 6e-5 of the draws, so that no motor has a negative
# inertia.
TAILS = 4.0


# --- what is drawn --------------------------------------------------------------------


@checked
@dataclass(frozen=True)
class Distribution:
    """One parameter's distribution.

    "uniform": low … high. "normal": mean (low + high)/2 and standard deviation (high −
    low)/8, cut at low and high, which are ±4σ.

    >>> Distribution("uniform", 0.02, 0.04).at(np.array([0.5])).tolist()
    [0.03]
    """

    kind: Literal["uniform", "normal"]
    low: float
    high: float

    def __post_init__(self) -> None:
        if self.low > self.high:
            raise FieldError(
                "low, high",
                (self.low, self.high),
                "not a range",
                "finite numbers, low <= high",
                "put the smaller number first",
            )

    def at(self, uniform: Real) -> Real:
        """Return the values whose cumulative probability is `uniform`, in [0, 1), with
        the shape of `uniform`.
        """
        if self.kind == "uniform" or self.low == self.high:
            return self.low + uniform * (self.high - self.low)
        cut = ndtr(-TAILS)
        deviation = ndtri(cut + uniform * (1.0 - 2.0 * cut))
        return 0.5 * (self.low + self.high) + deviation * (self.high - self.low) / (
            2.0 * TAILS
        )


def _around(centre: float, part: float) -> Distribution:
    """A normal distribution about `centre` whose 4σ is the share `part` of it."""
    return Distribution("normal", centre * (1.0 - part), centre * (1.0 + part))


def _always(value: float) -> Distribution:
    return Distribution("uniform", value, value)


_POSITIVE, _NOT_NEGATIVE = above(0.0), Between(0.0)
# Ranges within which the distributions must stay.
_RANGES = {
    "payload": _POSITIVE,
    "stiffness": _POSITIVE,
    "order": above(1.0, 2.0),
    "delay_samples": Between(0.0, 100.0),
    "motor_gain": _POSITIVE,
    "viscous_friction": _NOT_NEGATIVE,
    "coulomb_torque": _NOT_NEGATIVE,
    "noise": _NOT_NEGATIVE,
    "amplitude": _POSITIVE,
    "gauge_delay": _NOT_NEGATIVE,
    "payload_given": _NOT_NEGATIVE,
    "damping": _NOT_NEGATIVE,
}


@checked(prefix="draws.")
@dataclass(frozen=True)
class Draws:
    """The distributions of one campaign; factors multiply the rig's own value.

    payload [kg], stiffness [N·m/rad], order λ [1], motor_gain, viscous_friction,
    coulomb_torque, noise and the link's damping μ [factors], gauge_offset [N·m],
    delay_samples [periods, rounded down], amplitude of the move [rad], gauge_delay [s],
    gauge_gain [1], payload_given [1]: the payload that the law is given relative to the
    arm's, 0 for none.
    """

    payload: Distribution
    stiffness: Distribution
    order: Distribution
    gauge_offset: Distribution
    delay_samples: Distribution
    motor_gain: Distribution = Distribution("normal", 0.9, 1.1)
    viscous_friction: Distribution = Distribution("normal", 0.7, 1.3)
    coulomb_torque: Distribution = Distribution("uniform", 0.5, 1.5)
    noise: Distribution = Distribution("uniform", 0.5, 2.0)
    amplitude: Distribution = Distribution("uniform", 0.2, 1.2)
    gauge_delay: Distribution = Distribution("uniform", 0.0, 0.0)
    gauge_gain: Distribution = Distribution("uniform", 1.0, 1.0)
    payload_given: Distribution = Distribution("uniform", 0.0, 0.0)
    damping: Distribution = Distribution("uniform", 1.0, 1.0)

    def __post_init__(self) -> None:
        for name, allowed in _RANGES.items():
            own = getattr(self, name)
            allowed.check(f"draws.{name}", own.low)
            allowed.check(f"draws.{name}", own.high)


@checked
def draws_for(rig: Rig, model: LinkModel) -> Draws:
    """Return the default draws: what varies between two arms built from one drawing,
    and from day to day.

    payload over the rig's range, stiffness ±8 % and λ ±0.02 at 4σ, motor gain ±10 %,
    viscous friction and the link's damping ±30 %, Coulomb torque 0.5 … 1.5 ×, noise
    0.5 … 2 ×, gauge offset ±0.05 N·m, moves of 0.2 … 1.2 rad. The delay stays the
    rig's: one more sample is another design, not a tolerance. The gauge's delay is the
    identified one; the stiffness follows from ω₀ and payload, eq. (5), and the gauge's
    gain from that and the log.

    >>> import fraclink as fl
    >>> rig = fl.Rig.named("paper-2023")
    >>> draws_for(rig, rig.model).payload.high
    0.04
    """
    # With λ above 2 a link would generate energy: for a model near 2 the range is
    # reduced on both sides, so that its mean remains the model's.
    reach = min(0.02, 2.0 - model.order)
    # The amplitude of a torque log determines only the product of stiffness and gain;
    # the link's ω₀ determines the stiffness.
    link = with_payload(model, rig).at_payload(rig.payloads.nominal)
    stiffness = (
        rig.link.stiffness
        * (link.natural_frequency / rig.natural_frequency(rig.payloads.nominal)) ** 2
    )
    return Draws(
        payload=Distribution("uniform", rig.payloads.low, rig.payloads.high),
        stiffness=_around(stiffness, 0.08),
        order=Distribution("normal", model.order - reach, model.order + reach),
        gauge_offset=Distribution("uniform", -0.05, 0.05),
        delay_samples=_always(float(rig.motor_loop.delay_samples)),
        gauge_delay=_always(model.gauge_lag),
        gauge_gain=_always(link.gauge_gain * link.stiffness / stiffness),
        # without μ there is nothing to draw or to correlate with
        damping=_around(1.0, 0.3) if model.damping else _always(1.0),
    )


def draw(draws: Draws, seed: int, part: int, runs: int) -> dict[str, Real]:
    """Return the parameters of the runs of one part, by name; shape (runs,) each.

    Part `part` has its own stream, ``SeedSequence(seed, spawn_key=(part,))``: what is
    drawn depends on the seed and the part's number only, never on who computes it or
    when.
    """
    # Philox, a counter-based generator keyed by seed and part: the streams of two parts
    # cannot overlap.
    generator = np.random.Generator(
        np.random.Philox(np.random.SeedSequence(seed, spawn_key=(part,)))
    )
    names = [field.name for field in fields(draws)]
    uniform = generator.random((len(names), runs))
    shape = np.floor(generator.random(runs) * 2**31)
    return {
        name: getattr(draws, name).at(row)
        for name, row in zip(names, uniform, strict=True)
    } | {"shape": shape}


# --- the campaign ---------------------------------------------------------------------


@checked
@dataclass(frozen=True)
class Campaign:
    """Monte Carlo runs of one law on varied arms: payload, stiffness, λ, motor,
    friction, sensors.

    rig, model and law: the nominal arm and the law under test, with its motor loop.
    draws: the distributions. runs: how many, 1 … 10⁶. seed: 0
    … 2⁶³ − 1; the same seed gives the same runs whatever the number of workers.
    duration [s] of each run. reference: what the tip follows, times the drawn
    amplitude; default: a quintic of one of three durations. payloads [kg]: the range of
    the design if the law is given an estimate of the payload; else None.
    """

    rig: Rig
    model: LinkModel
    law: Law
    draws: Draws
    runs: Annotated[int, Between(1, 10**6)]
    seed: Annotated[int, Between(0, 2**63 - 1)] = 0
    duration: Annotated[
        float, Between(max(SHAPES) + 1.0, 600.0, "s", remedy="leave time to settle")
    ] = DURATION
    reference: Path | SampledReference | None = None
    payloads: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        # At least a second to settle: with less, every run would fail merely because it
        # ends too early.
        if self.reference is not None and self.reference.duration + 1.0 > self.duration:
            raise FieldError(
                "reference",
                self.reference.duration,
                "too long",
                f"<= {self.duration - 1.0:g} s",
                "run for longer",
            )

    @cached_property
    def estimator(self) -> PayloadEstimator | None:
        """The payload estimator of each arm, None if the payload is not estimated; until
        it has an estimate, the law assumes the nominal payload.
        """
        if self.payloads is None:
            return None
        return payload_estimator(
            with_payload(self.model, self.rig), self.rig, self.law, self.payloads
        )

    @property
    def references(self) -> tuple[Reference, ...]:
        """The references: each run follows one of them, scaled by its amplitude."""
        moves = tuple(smooth_step(1.0, duration) for duration in SHAPES)
        return moves if self.reference is None else (self.reference,)

    @property
    def parts(self) -> int:
        """Number of parts of 1000 runs; the last one may be shorter."""
        return -(-self.runs // PART_RUNS)

    def part_runs(self, part: int) -> int:
        """Number of runs of part `part`, 0 … parts − 1."""
        return min(PART_RUNS, self.runs - part * PART_RUNS)

    @staticmethod
    @checked
    def of(
        rig: Rig,
        model: LinkModel,
        law: Law,
        *,
        runs: int,
        seed: int = 0,
        draws: Draws | None = None,
        told: bool = False,
        estimated: tuple[float, float] | None = None,
        reference: Reference | None = None,
    ) -> Campaign:
        """Return the campaign of a law with the default draws of its rig; a law without
        a motor loop gets the rig's.

        With `told` the law is given the payload of each arm, whatever `draws` says about
        it; with `estimated`, the payload range (low, high) [kg] of its design, it is
        given an estimate while the arm moves. A `reference` is followed unscaled,
        whatever `draws` says about the amplitude.

        >>> import fraclink as fl
        >>> rig = fl.Rig.named("paper-2023")
        >>> controller = fl.Controller(derivative_gain=0.069876, derivative_order=0.612197, link=rig.model)
        >>> law = fl.discretize(controller, rig.period, order=4)
        >>> Campaign.of(rig, rig.model, law, runs=2500).parts
        3
        """
        own = equip(law, rig, model) if law.motor_loop is None else law
        ranges = draws_for(rig, model) if draws is None else draws
        ranges = replace(ranges, payload_given=_always(1.0)) if told else ranges
        rest = max(REST, VIBRATIONS * model.vibration_period)
        length = max(SHAPES) + rest
        if reference is not None:
            # A given reference has its own size: with a drawn amplitude the moves would
            # not be the planned ones.
            length = max(length, reference.duration + rest)
            ranges = replace(ranges, amplitude=_always(1.0))
        if reference is not None and not isinstance(reference, Path | SampledReference):
            # for any other reference, the samples that can be stored in a file
            length = math.ceil(reference.duration / own.period) * own.period
            rows = sampled(reference, own.period, length)
            reference = SampledReference(own.period, rows)
        return Campaign(
            rig, model, own, ranges, runs, seed, length, reference, estimated
        )
