"""Parameter uncertainty: intervals of the parameters of an arm."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import astuple, dataclass, replace
from decimal import ROUND_CEILING, ROUND_FLOOR, Context
from itertools import product

from fraclink._arm.controller import Controller
from fraclink._arm.link import LinkModel
from fraclink._arm.loop import Loop, with_payload
from fraclink._arm.motor_loop import MotorLoop
from fraclink._arm.rig import Rig
from fraclink._arm.sampled import SampledPlant, sampled_plant
from fraclink.errors import FieldError
from fracsys.checks import Complex

__all__ = ["Arm", "Interval", "ParameterBox", "arms_of", "in_loop", "outward"]

Interval = tuple[float, float]
# Least relative uncertainty of parameters without a tolerance in the rig: two logs of
# the same arm rarely agree on the damping to better than a tenth, and the second mode
# varies with the material by a few per cent.
_DAMPING, _MODE_FREQUENCY, _MODE_GAIN = 0.1, 0.05, 0.2


def in_loop(model: LinkModel, rig: Rig) -> LinkModel:
    """Return the model as part of the control loop, without a delay that only the
    logger has.

    >>> from fraclink._arm.rig_parts import Gauge
    >>> rig = replace(Rig.named("paper-2023"), gauge=Gauge(delay_in_loop=False))
    >>> in_loop(LinkModel(1.56, 10.78, order=1.92, gauge_delay=0.02), rig).gauge_delay
    0.0
    """
    if rig.gauge.delay_in_loop:
        return model
    # The interval of a delay outside the loop would tighten the design for nothing.
    intervals = tuple(row for row in model.intervals if row[0] != "gauge_delay")
    return replace(model, gauge_delay=0.0, intervals=intervals)


@dataclass(frozen=True)
class Arm:
    """One arm of a box: its link and gauge, and the ratio of its true to its assumed
    motor pole or gain.
    """

    model: LinkModel
    motor_ratio: float = 1.0

    def loop(self, controller: Controller, rig: Rig) -> Loop:
        """Return the loop on this arm; a sampled motor loop keeps the PID placed for
        the rig's motor.
        """
        return Loop.of(controller, self.model, rig, ratio=self.motor_ratio)

    def plant(
        self,
        settings: MotorLoop,
        rig: Rig,
        period: float,
        *,
        higher: Callable[[Complex], Complex] | None = None,
    ) -> SampledPlant:
        """Return the sampled response of this arm from motor reference to tip estimate,
        as seen by the law.

        `higher` is the part of the link that the model does not include, see
        `sampled_plant`.
        """
        ratio = self.motor_ratio
        return sampled_plant(
            self.model, settings, rig.motor, period, ratio=ratio, higher=higher
        )

    def knowing(self, name: str, box: ParameterBox) -> Arm:
        """Return the arm with one parameter, named as in `ParameterBox`, at the lower
        end of a box.
        """
        value, model = getattr(box, name)[0], self.model
        if name == "motor_ratio":
            return replace(self, motor_ratio=value)
        if name == "mode_frequency" and model.second_mode is not None:
            mode = replace(model.second_mode, frequency=value)
            return replace(self, model=replace(model, second_mode=mode))
        return replace(self, model=replace(model, **{name: value}))


@dataclass(frozen=True)
class ParameterBox:
    """An interval for every parameter of an arm that a proof or a design has to cover.

    Attributes
    ----------
    natural_frequency
        ω₀ [s^(-λ/2)] at the payload of the model.
    order, damping
        λ and μ.
    gauge_gain
        measured over true torque, including the uncertainty of the link's stiffness [1].
    gauge_delay
        [s].
    motor_ratio
        true over assumed pole of the motor loop, or gain of the motor where its loop is
        sampled [1].
    mode_frequency, mode_gain
        of the second mode [rad/s], [1]; (0, 0) where none is known.

    Examples
    --------
    >>> rig = Rig.named("paper-2023")
    >>> ParameterBox.of(rig.model, rig).gauge_gain
    (0.95, 1.05)
    """

    __made_by__ = "ParameterBox.of(model, rig), or ParameterBox.at(model)"

    natural_frequency: Interval
    order: Interval
    damping: Interval
    gauge_gain: Interval
    gauge_delay: Interval
    motor_ratio: Interval = (1.0, 1.0)
    mode_frequency: Interval = (0.0, 0.0)
    mode_gain: Interval = (0.0, 0.0)

    @staticmethod
    def at(model: LinkModel) -> ParameterBox:
        """Return the box that is one point: everything exactly as the model has it."""
        mode = model.second_mode
        values = (
            model.natural_frequency,
            model.order,
            model.damping,
            model.gauge_gain,
            model.gauge_delay,
            1.0,
        )
        second = (0.0, 0.0) if mode is None else (mode.frequency, mode.gain)
        return ParameterBox(*((value, value) for value in (*values, *second)))

    @staticmethod
    def of(
        model: LinkModel, rig: Rig, *, others: Iterable[LinkModel] = ()
    ) -> ParameterBox:
        """Return what is known of `model`: its fit's intervals, at least as wide as the
        rig's tolerances.

        `others` are models of the same arm from other logs; the box holds them, too.

        Raises
        ------
        FieldError
            the gauge leads the encoder by more than its tolerance, or one of `others`
            has a second mode and `model` has none.
        """
        return _around(with_payload(model, rig), rig).with_others(others, model, rig)

    def with_others(
        self, others: Iterable[LinkModel], model: LinkModel, rig: Rig
    ) -> ParameterBox:
        """Return the smallest box that holds this one and other models, each at the
        payload of `model`.
        """
        box, payload = self, with_payload(model, rig).known_payload
        for other in others:
            if other.second_mode is not None and model.second_mode is None:
                raise FieldError(
                    "others",
                    f"{other.second_mode.frequency:.4g} rad/s",
                    "with a second mode that the model does not know",
                    "models without one, or a `model` that has one, too",
                    "give the model with the second mode as `model`, and the other in `others`",
                )
            # ω₀ depends on the payload of its log: two logs can only be compared at the
            # same payload.
            box = box.hull(
                ParameterBox.at(with_payload(other, rig).at_payload(payload))
            )
        return box

    def hull(self, other: ParameterBox) -> ParameterBox:
        """Return the smallest box that holds both; a second mode that only one
        has may have a gain of 0.
        """
        frequencies = [
            box.mode_frequency for box in (self, other) if box.mode_gain[1] > 0.0
        ] or [(0.0, 0.0)]
        first, second = (
            replace(box, mode_frequency=frequencies[k])
            for box, k in ((self, 0), (other, -1))
        )
        return ParameterBox(*map(_hull, astuple(first), astuple(second)))


def arms_of(box: ParameterBox, model: LinkModel) -> tuple[Arm, ...]:
    """Return the arms at the corners of a box about `model`, each with the ω₀ of the
    model.

    The interval of ω₀ widens a range of payloads and adds no corners; for the gain of a
    second mode only the larger end is taken, the worse one whatever the mode's
    frequency.
    """
    names = (
        "order",
        "damping",
        "gauge_gain",
        "gauge_delay",
        "mode_frequency",
        "motor_ratio",
    )
    ends = [dict.fromkeys(getattr(box, name)) for name in names]
    arms = []
    for order, damping, gain, late, mode, ratio in product(*ends):
        second = model.second_mode
        if second is not None:
            second = replace(second, frequency=mode, gain=box.mode_gain[1])
        link = replace(
            model,
            order=order,
            damping=damping,
            gauge_gain=gain,
            gauge_delay=late,
            second_mode=second,
            intervals=(),
        )
        arms.append(Arm(link, ratio))
    return tuple(arms)


def _around(model: LinkModel, rig: Rig) -> ParameterBox:
    tolerances, mode = rig.tolerances, model.second_mode

    def share(name: str, value: float, part: float) -> Interval:
        return _hull((value * (1 - part), value * (1 + part)), model.interval(name))

    # The wider of two uncertainties at each end: an interval is what one log leaves
    # open, a tolerance covers what a laboratory does not measure at all.
    order = _hull(
        (model.order - tolerances.order, model.order + tolerances.order),
        model.interval("order"),
    )
    # An undamped link of order two never comes to rest: the interval ends halfway to
    # two.
    highest = 2.0 if model.damping else 0.5 * (model.order + 2.0)
    gain = share("gauge_gain", model.gauge_gain, tolerances.gauge_gain)
    # A torque log determines the product of gauge gain and stiffness, so the
    # uncertainty of c is also one of the gauge.
    stiffness = model.interval("stiffness") or (model.stiffness, model.stiffness)
    gain = _hull(gain, tuple(model.gauge_gain * c / model.stiffness for c in stiffness))  # type: ignore[arg-type]
    return ParameterBox(
        natural_frequency=share(
            "natural_frequency", model.natural_frequency, tolerances.natural_frequency
        ),
        order=(max(order[0], 0.5 * (model.order + 1.0)), min(order[1], highest)),
        damping=share("damping", model.damping, _DAMPING)
        if model.damping
        else (0.0, 0.0),
        gauge_gain=gain,
        gauge_delay=_gauge_delay(model, tolerances.gauge_delay),
        motor_ratio=(1.0 - tolerances.motor_pole, 1.0 + tolerances.motor_pole),
        mode_frequency=(0.0, 0.0)
        if mode is None
        else share("mode_frequency", mode.frequency, _MODE_FREQUENCY),
        mode_gain=(0.0, 0.0)
        if mode is None
        else share("mode_gain", mode.gain, _MODE_GAIN),
    )


def _gauge_delay(model: LinkModel, tolerance: float) -> Interval:
    low, high = _hull(
        (model.gauge_delay, model.gauge_delay + tolerance),
        model.interval("gauge_delay"),
    )
    # a lead within the tolerance counts as no delay
    if model.gauge_delay < -max(tolerance, 1e-4):
        raise FieldError(
            "model.gauge_delay",
            model.gauge_delay,
            "negative",
            ">= 0 s",
            "check which of encoder and gauge the logger delays",
        )
    return max(low, 0.0), max(high, 0.0)


def _hull(first: Interval, second: Interval | None) -> Interval:
    return (
        first
        if second is None
        else (min(first[0], second[0]), max(first[1], second[1]))
    )


def outward(low: float, high: float) -> tuple[float, float]:
    """The interval with ends of six digits, the first rounded down and the second up; a
    point stays as it is.

    A sentence of thirty numbers is readable only if they are short.
    """
    if low == high:
        return float(low), float(high)
    return _rounded(low, ROUND_FLOOR), _rounded(high, ROUND_CEILING)


def _rounded(value: float, way: str) -> float:
    # Twelve digits first: 0.30000000000000004 is 0.3, not 0.300001.
    return float(Context(prec=6, rounding=way).create_decimal(f"{value:.12g}"))
