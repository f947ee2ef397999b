"""Parts of a law: filters, drive, inputs, outputs and what modes and reasons are called."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from fraclink._arm.motor import DiscretePid

__all__ = ["MODES", "REASONS", "Drive", "LawInputs", "LawOutputs", "Modes"]

MODES = ("idle", "run", "degraded", "hold", "off")
REASONS = (
    "none",
    "parameter version",
    "parameter size",
    "parameter CRC",
    "parameter counts",
    "encoder",
    "gauge",
    "gauge stuck",
    "motor away from its model",
    "missed periods",
    "link overloaded",
    "gauge reversed",
    "gauge dead",
    "not moved enough",
)


class Modes(NamedTuple):
    """A small parallel filter d + Σ g/(z − p): real poles and one pole of each complex pair."""

    direct: float
    poles: tuple[float, ...] = ()
    gains: tuple[float, ...] = ()
    pair_poles: tuple[complex, ...] = ()
    pair_gains: tuple[complex, ...] = ()


@dataclass(frozen=True)
class Drive:
    """The inner loop and what it needs to know of the motor; without it a law gives a motor reference
    only.
    """

    loop: DiscretePid
    voltage_limit: float  # [V]
    torque_voltage: float  # compensation of the coupling torque, 1/(K n) [V/(N·m)]
    coulomb_voltage: float  # compensation of Coulomb friction, Γc/K [V]
    coulomb_speed: float  # reference speed below which it fades to zero [rad/s]


class LawInputs(NamedTuple):
    """One period's inputs: reference [rad], its acceleration [rad/s²], θm [rad], Γ
    [N·m].
    """

    reference: float
    reference_acceleration: float
    motor_angle: float
    torque: float


class LawOutputs(NamedTuple):
    """One period's outputs; scalars from `Law.step`, arrays of shape (N,) from `Law.run`.

    motor_reference θm* [rad], voltage [V], compensation: its part against the coupling torque [V],
    tip_estimate θm − Γ/c [rad], error [rad], mode (index of MODES), reason (index of REASONS), flags (bits
    of law.h).
    """

    motor_reference: Any
    voltage: Any
    compensation: Any
    tip_estimate: Any
    error: Any
    mode: Any
    reason: Any
    flags: Any
