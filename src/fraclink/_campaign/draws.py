"""What is drawn for each run of a campaign, and from which distribution."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from dataclasses import field as with_default

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.link import LinkModel
from fraclink._arm.rig import Rig
from fraclink._validate import checked_choice, checked_noun, checked_number
from fraclink.errors import FieldError

__all__ = ["Distribution", "Draws", "draw", "draws_for"]

Real = NDArray[np.float64]

_KINDS = ("uniform", "normal", "whole")
_TAILS = 4.0  # a normal draw is cut at ±4σ: 6e-5 of the draws, and no motor of negative inertia


@dataclass(frozen=True)
class Distribution:
    """One parameter's distribution.

    "uniform": low … high. "normal": mean (low + high)/2 and standard deviation (high − low)/8, cut at low
    and high, which are ±4σ. "whole": whole numbers low … high, all equally likely.

    >>> Distribution("uniform", 0.02, 0.04).at(np.array([0.5])).tolist()
    [0.03]
    """

    kind: str
    low: float
    high: float

    def __post_init__(self) -> None:
        checked_choice("kind", self.kind, _KINDS, remedy="use one of them")
        for name in ("low", "high"):
            value = checked_number(name, getattr(self, name), allowed="a finite number")
            object.__setattr__(self, name, value)
        if self.low > self.high:
            raise FieldError(
                "low, high",
                (self.low, self.high),
                "not a range",
                allowed="finite numbers, low <= high",
                remedy="put the smaller number first",
            )
        if self.kind == "whole" and (self.low != math.floor(self.low) or self.high != math.floor(self.high)):
            raise FieldError(
                "low, high", (self.low, self.high), "not whole", allowed="whole numbers", remedy="round them"
            )

    def at(self, uniform: Real) -> Real:
        """Return the values whose cumulated probability is `uniform`, in [0, 1); shape kept."""
        if self.kind == "whole":
            return np.asarray(self.low + np.floor(uniform * (self.high - self.low + 1.0)))
        if self.kind == "uniform" or self.low == self.high:
            return np.asarray(self.low + uniform * (self.high - self.low))
        from scipy.special import ndtr, ndtri

        cut = ndtr(-_TAILS)
        deviation = ndtri(cut + uniform * (1.0 - 2.0 * cut))
        return np.asarray(0.5 * (self.low + self.high) + deviation * (self.high - self.low) / (2.0 * _TAILS))


def _around(centre: float, part: float) -> Distribution:
    """A normal distribution about `centre` whose ±4σ are `part` of it."""
    return Distribution("normal", centre * (1.0 - part), centre * (1.0 + part))


@dataclass(frozen=True)
class Draws:
    """The distributions of one campaign; factors multiply the rig's own value.

    payload [kg], stiffness [N·m/rad], order λ [1], motor_gain, viscous_friction, coulomb_torque and noise
    [factors], gauge_offset [N·m], delay_samples [periods], amplitude of the move [rad].
    """

    payload: Distribution
    stiffness: Distribution
    order: Distribution
    gauge_offset: Distribution
    delay_samples: Distribution
    motor_gain: Distribution = with_default(default_factory=lambda: _around(1.0, 0.1))
    viscous_friction: Distribution = with_default(default_factory=lambda: _around(1.0, 0.3))
    coulomb_torque: Distribution = with_default(default_factory=lambda: Distribution("uniform", 0.5, 1.5))
    noise: Distribution = with_default(default_factory=lambda: Distribution("uniform", 0.5, 2.0))
    amplitude: Distribution = with_default(default_factory=lambda: Distribution("uniform", 0.2, 1.2))

    def __post_init__(self) -> None:
        for field in fields(self):
            own, remedy = getattr(self, field.name), 'say Distribution("uniform", low, high)'
            checked_noun(f"draws.{field.name}", own, Distribution, remedy=remedy)
        for name in ("payload", "stiffness", "motor_gain", "amplitude"):
            if getattr(self, name).low <= 0.0:
                raise FieldError(
                    f"draws.{name}",
                    getattr(self, name).low,
                    "not positive",
                    allowed="low > 0",
                    remedy="raise the lower end",
                )
        if not (self.order.low > 1.0 and self.order.high <= 2.0):
            raise FieldError(
                "draws.order",
                (self.order.low, self.order.high),
                "out of range",
                allowed="1 < λ <= 2",
                remedy="narrow the range",
            )
        for name in ("viscous_friction", "coulomb_torque", "noise", "delay_samples"):
            if getattr(self, name).low < 0.0:
                raise FieldError(
                    f"draws.{name}",
                    getattr(self, name).low,
                    "negative",
                    allowed="low >= 0",
                    remedy="raise the lower end",
                )


def draws_for(rig: Rig, model: LinkModel) -> Draws:
    """Return the stated defaults: what varies between two arms of one drawing, and from day to day.

    payload over the rig's range, stiffness ±8 % and λ ±0.02 at 4σ, motor gain ±10 %, viscous friction
    ±30 %, Coulomb torque 0.5 … 1.5 ×, noise 0.5 … 2 ×, gauge offset ±0.05 N·m, moves of 0.2 … 1.2 rad.
    The delay stays the rig's own: one more sample is another design, not a tolerance.

    >>> import fraclink as fl
    >>> rig = fl.Rig.named("paper-2023")
    >>> draws_for(rig, rig.model).payload.high
    0.04
    """
    checked_noun("rig", rig, Rig, remedy="Rig.named or Rig.load make one")
    order = checked_noun("model", model, LinkModel, remedy="fit.model, or rig.model").order
    return Draws(
        payload=Distribution("uniform", rig.payloads.low, rig.payloads.high),
        stiffness=_around(model.stiffness, 0.08),
        order=Distribution("normal", order - min(0.02, 2.0 - order), order + min(0.02, 2.0 - order)),
        gauge_offset=Distribution("uniform", -0.05, 0.05),
        delay_samples=Distribution("whole", rig.inner.delay_samples, rig.inner.delay_samples),
    )


def draw(draws: Draws, seed: int, part: int, runs: int) -> dict[str, Real]:
    """Return the parameters of the runs of one part, by name; shape (runs,) each.

    Part `part` has its own stream, ``SeedSequence(seed, spawn_key=(part,))``: what is drawn depends on the
    seed and the part's number only, never on who computes it or when.
    """
    generator = np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=(part,))))
    uniform = generator.random((len(fields(draws)), runs))
    values = {f.name: getattr(draws, f.name).at(row) for f, row in zip(fields(draws), uniform, strict=True)}
    return values | {"shape": np.floor(generator.random(runs) * 2**31)}
