"""Events of an arm and its sensors during a run, as inputs of the run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np

from fraclink import _kernels
from fraclink._arm.reference import Reference, sampled
from fraclink._arm.rig import Gauge
from fraclink._law.estimator import PayloadEstimator
from fraclink._simulate.kernel import ArmState
from fraclink.errors import FieldError
from fracsys.checks import Angle, Between, Duration, Real, Time, above, checked

__all__ = [
    "FAULTS",
    "Action",
    "Event",
    "Obstacle",
    "PayloadChange",
    "Restart",
    "SensorFault",
    "TipPulse",
    "actions_of",
    "fault_rows",
    "given_payload",
    "healthy_inputs",
]

Action = Callable[[ArmState], None]

# Columns of the twin's inputs (csrc/kernels/twin.h); for the model only the columns of
# faults apply.
REFERENCE, VELOCITY, ACCELERATION, GAUGE_ERROR, TIP_FORCE, FAULT_BITS = range(6)
ENCODER_GAIN, ENCODER_ERROR, ENCODER_VALUE, GAUGE_GAIN, GAUGE_VALUE, PAYLOAD = range(
    6, 12
)


# --- events ---------------------------------------------------------------------------


@checked
@dataclass(frozen=True)
class PayloadChange:
    """From `time` [s] on the tip carries `payload` [kg]; a part that is picked up is
    assumed to move with the tip already.

    Shape, speed and material memory of the link are kept; only its modes change.

    >>> PayloadChange(time=0.5, payload=0.008).payload
    0.008
    """

    time: Time
    payload: Annotated[float, Between(0.0, 1e9, "kg", remedy="give the new mass in kg")]

    def act(self, arm: ArmState) -> None:
        """Change the payload of a running arm."""
        arm.change_payload(self.payload)


@checked
@dataclass(frozen=True)
class TipPulse:
    """A force on the tip, at right angles to the link, from `time` for `duration` [s];
    `force` [N].

    >>> TipPulse(time=1.0, force=0.5, duration=0.02).force
    0.5
    """

    time: Time
    force: Annotated[float, Between(-1e9, 1e9, "N", remedy="give newtons")]
    duration: Duration = 0.02


@checked
@dataclass(frozen=True)
class Obstacle:
    """A stop in the way of the tip between `time` and `until` [s].

    angle [rad]: where it stands. side: +1, the tip cannot pass above the angle; −1, not
    below. The stop is a spring of `stiffness` [N/m] that pushes and never pulls, with a
    loss of `damping` [N·s/m] while pressed. The default, 500 N/m, bends by 2 mm under a
    newton and makes a contact of about 20 ms with 30 g. Above 1e4 N/m a 1 ms step no
    longer resolves the contact of a payload of 10 g.

    >>> Obstacle(time=0.0, until=1.0, angle=0.4).side
    1
    """

    time: Time
    until: Duration
    angle: Angle
    side: Literal[1, -1] = 1
    stiffness: Annotated[
        float,
        above(
            0.0,
            1e4,
            "N/m",
            remedy="a stop of foam has 500 N/m, one of wood 1e4",
        ),
    ] = 500.0
    damping: Annotated[
        float, Between(0.0, 20.0, "N·s/m", remedy="2 is a dull contact")
    ] = 2.0

    def __post_init__(self) -> None:
        _check_span(self.time, self.until)

    def act(self, arm: ArmState) -> None:
        """Stand in the way of a running arm."""
        arm.obstacle[:3] = self.angle, self.stiffness, self.damping
        arm.obstacle[4] = self.side


@checked
@dataclass(frozen=True)
class Restart:
    """At `time` [s] the controller loses its memory and starts anew while the arm goes
    on moving.

    >>> Restart(time=0.7).time
    0.7
    """

    time: Time

    def act(self, arm: ArmState) -> None:
        """Restart the law of a running arm."""
        arm.restart()


# Kind -> (bit of the kernel's fault word or 0, input column that it sets or None).
FAULTS: dict[str, tuple[int, int | None]] = {
    "encoder value": (1, ENCODER_VALUE),
    "gauge value": (2, GAUGE_VALUE),
    "encoder frozen": (4, None),
    "gauge frozen": (8, None),
    "channels swapped": (16, None),
    "tick missed": (32, None),
    "tick repeated": (64, None),
    "encoder gain": (0, ENCODER_GAIN),
    "encoder offset": (0, ENCODER_ERROR),
    "gauge gain": (0, GAUGE_GAIN),
    "gauge offset": (0, GAUGE_ERROR),
}
_VALUED = tuple(kind for kind, (_, column) in FAULTS.items() if column is not None)


@checked
@dataclass(frozen=True)
class SensorFault:
    """From `time` to `until` [s] a sensor or the control task fails.

    kind: "encoder value" and "gauge value" replace the reading by `value` (NaN and
    infinity are allowed: that is what broken interfaces give); "encoder gain", "gauge
    gain" multiply the true value, "encoder offset", "gauge offset" add to it [rad,
    N·m]; "encoder frozen", "gauge frozen" repeat the last reading; "channels swapped"
    exchanges the two; "tick missed" does not run the law, "tick repeated" runs it
    twice.

    >>> SensorFault(time=0.5, until=0.52, kind="gauge value", value=float("nan")).kind
    'gauge value'
    """

    time: Time
    until: Duration
    kind: str
    value: Annotated[float, Between(finite=False)] | None = None

    def __post_init__(self) -> None:
        _check_span(self.time, self.until)
        if self.kind not in FAULTS:
            raise FieldError(
                "kind",
                self.kind,
                "unknown",
                ", ".join(FAULTS),
                "choose one of these",
            )
        if (self.value is not None) != (self.kind in _VALUED):
            raise FieldError(
                "value",
                self.value,
                "missing" if self.kind in _VALUED else "not used by this kind",
                f"a number for {', '.join(_VALUED)}",
                "give value=, or leave it out",
            )


Event = PayloadChange | TipPulse | Obstacle | Restart | SensorFault


def _check_span(time: float, until: float) -> None:
    if until <= time:
        raise FieldError(
            "until",
            until,
            "not after time",
            f"> {time:g} s",
            "exchange the two",
        )


# --- the inputs of every period -------------------------------------------------------


def healthy_inputs(
    gauge: Gauge,
    reference: Reference,
    period: float,
    length: float,
    generator: np.random.Generator,
) -> Real:
    """Return the kernel's inputs of a run of `length` [s] without events or faults, shape
    (N, 12).
    """
    path = sampled(reference, period, length)
    inputs = fault_rows((), period, path.shape[1])
    inputs[:, [REFERENCE, VELOCITY, ACCELERATION]] = path.T
    inputs[:, GAUGE_ERROR] = gauge.offset
    # Drawn even if the noise is 0, so that a seed gives the same noise sequence for
    # every amplitude.
    inputs[:, GAUGE_ERROR] += gauge.noise * generator.standard_normal(len(inputs))
    return inputs


def fault_rows(faults: tuple[SensorFault, ...], period: float, count: int) -> Real:
    """Return the kernels' inputs of faults alone, shape (count, 12)."""
    inputs = np.zeros((count, _kernels.TWIN_INPUTS))
    inputs[:, ENCODER_GAIN] = inputs[:, GAUGE_GAIN] = 1.0
    actions_of(faults, period, inputs)
    return inputs


def actions_of(
    events: Sequence[Event], period: float, inputs: Real
) -> dict[int, list[Action]]:
    """Return the actions on the arm with the period before which they happen; pulses
    and sensor faults are written to the inputs directly.
    """
    actions: dict[int, list[Action]] = {}
    for event in sorted(events, key=lambda e: e.time):
        # Rounded to a whole period: the arm is changed between two periods, never
        # within one.
        at = round(event.time / period)
        if isinstance(event, TipPulse):
            last = at + max(1, round(event.duration / period))
            inputs[at:last, TIP_FORCE] += event.force
        elif isinstance(event, SensorFault):
            # At least one period: a requested fault must occur.
            _inject(event, inputs[at : max(at + 1, round(event.until / period))])
        else:
            actions.setdefault(at, []).append(event.act)
        if isinstance(event, Obstacle):
            until = round(event.until / period)
            actions.setdefault(until, []).append(ArmState.free)
    return actions


def _inject(fault: SensorFault, rows: Real) -> None:
    """Write a sensor's fault into the kernel's inputs."""
    bit, column = FAULTS[fault.kind]
    # Two simultaneous faults are combined: the column holds a bit mask as a real.
    rows[:, FAULT_BITS] = rows[:, FAULT_BITS].astype(int) | bit
    if column is None or fault.value is None:
        return
    if column in (ENCODER_ERROR, GAUGE_ERROR):
        # An error is added to the existing noise and offset of the gauge; a gain or a
        # value replaces the previous one.
        rows[:, column] += fault.value
    else:
        rows[:, column] = fault.value


def given_payload(
    told: bool | float | str | PayloadEstimator, payload: float | None
) -> float:
    """The payload given to the law [kg]; 0 if there is none, or if it is estimated."""
    if isinstance(told, str | PayloadEstimator):
        return 0.0
    if told is not True:
        return float(told)
    if payload is None:
        raise FieldError(
            "told",
            True,
            "without a payload to tell",
            "a payload in kg",
            "give payload=, or a model that knows its own",
        )
    return payload
