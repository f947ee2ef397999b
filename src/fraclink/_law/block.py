"""The parameter block of law.c: its contents, the order of its fields, its bytes, and
its modes.
"""

from __future__ import annotations

import hashlib
import math
import struct
import zlib
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple, Self, cast

from fraclink._arm.motor import DiscretePid
from fraclink._law.limits import Limits
from fraclink.errors import FieldError
from fracsys.checks import checked_choice

__all__ = [
    "COUNTS",
    "HEADER",
    "LEAST_RANGE",
    "MOTOR_LOOP",
    "PID",
    "REALS",
    "Block",
    "DiscreteMotorLoop",
    "Modes",
    "MotorModel",
    "Precision",
    "Tracking",
    "block_values",
    "correction_values",
    "exact_header",
    "framed",
    "inside_circle",
    "linear_range",
    "mode_norms",
    "modes_of",
    "pack",
    "real_type",
    "unpack",
]

Precision = Literal["single", "double"]

VERSION = 4
REAL_MODES, PAIR_MODES, FORWARD_MODES = 8, 2, 8
WITH_INNER, LATE_GAUGE, STOP_RINGING = 1, 2, 4

HEADER = ("version", "size", "precision", "crc")
COUNTS = (
    "options",
    "real_modes",
    "pair_modes",
    "forward_modes",
    "bad_limit",
    "missed_limit",
    "residual_limit",
    "stuck_limit",
    "frozen_limit",
    "block_limit",
)
# Name and length of every real field in the order of law.h; a test compares them with
# law.h. Modes are stored as (pole, gain), pairs as (pole, turn, gain, cross).
REALS: tuple[tuple[str, int], ...] = (
    ("period", 1),
    ("compliance", 1),
    ("direct", 1),
    ("real", 2 * REAL_MODES),
    ("pair", 4 * PAIR_MODES),
    ("forward_direct", 1),
    ("forward", 2 * FORWARD_MODES),
    ("sum_limit", 1),
    ("correction_limit", 1),
    ("forward_limit", 1),
    ("angle_limit", 1),
    ("angle_step", 1),
    ("torque_limit", 1),
    ("torque_step", 1),
    ("torque_trip", 1),
    ("torque_block", 1),
    ("reference_step", 1),
    ("reference_rate", 1),
    ("acceleration_limit", 1),
    ("motor_limit", 1),
    ("motor_step", 1),
    ("fade_step", 1),
    ("residual_angle", 1),
    ("motor_now", 1),
    ("motor_next", 1),
    ("motor_keep", 1),
    ("swing_angle", 1),
    ("frozen_angle", 1),
    ("stuck_torque", 1),
    ("stiffness", 1),
    ("wiring_energy", 1),
    ("inner_direct", 1),
    ("inner_angle", 1),
    ("integral_now", 1),
    ("integral_before", 1),
    ("filter_now", 1),
    ("filter_before", 1),
    ("filter_angle_now", 1),
    ("filter_angle_before", 1),
    ("filter_decay", 1),
    ("wanted_limit", 1),
    ("voltage_limit", 1),
    ("torque_voltage", 1),
    ("coulomb_voltage", 1),
    ("coulomb_slope", 1),
    ("link_scale", 1),
    ("payload_scale", 1),
    ("gauge_now", 1),
    ("gauge_keep", 1),
    ("payload_limit", 1),
    ("scale_step", 1),
)
_NAMES = [name for name, _ in REALS]
# The fields of the motor loop; the first nine are the PID.
MOTOR_LOOP = tuple(_NAMES[_NAMES.index("inner_direct") : _NAMES.index("link_scale")])
PID = MOTOR_LOOP[: MOTOR_LOOP.index("wanted_limit")]


def real_type(precision: Precision) -> Literal["f", "d"]:
    """The struct code of a real number; FieldError for an unknown precision."""
    checked_choice(
        "precision",
        precision,
        ("single", "double"),
        remedy="use single for a microcontroller with a single-precision FPU",
    )
    return "f" if precision == "single" else "d"


def _format(precision: Precision) -> str:
    reals = sum(length for _, length in REALS)
    body = len(COUNTS) * 4 + reals * struct.calcsize("<" + real_type(precision))
    # The size of the struct is a multiple of the alignment of its largest member.
    return f"<{len(COUNTS)}I{reals}{real_type(precision)}{-body % struct.calcsize(real_type(precision))}x"


def pack(values: Mapping[str, float | Sequence[float]], precision: Precision) -> bytes:
    """Return the block as bytes, with size and CRC-32 filled in; lists shorter than
    their field end in zeros.
    """
    flat: list[float] = []
    for name, length in REALS:
        value = values[name]
        items = list(value) if isinstance(value, Sequence) else [value]
        if len(items) > length:
            raise FieldError(
                name,
                len(items),
                "too many for the law",
                f"at most {length}",
                "ask for a lower order",
            )
        # A mode with gain 0 adds nothing, so shorter lists are padded with zeros; the
        # counts keep these modes out of the arithmetic.
        flat += items + [0.0] * (length - len(items))
    counts = [int(values[name]) for name in COUNTS]  # type: ignore[arg-type]
    try:
        body = struct.pack(_format(precision), *counts, *flat)
    except (OverflowError, struct.error) as error:
        raise FieldError(
            "law",
            str(error),
            "not representable",
            f"{precision} precision",
            "use double",
        ) from error
    # 0 marks a state that was never started; one block in 4 billion has this CRC
    if zlib.crc32(body) == 0:
        raise FieldError(
            "law",
            0,
            "a block with CRC 0",
            "any other",
            "change a limit slightly",
        )
    return framed(VERSION, body, precision)


def framed(version: int, body: bytes, precision: Precision) -> bytes:
    """Return a block with its header in front: version, size, width of a real,
    CRC-32.
    """
    width = struct.calcsize(real_type(precision))
    header = (version, 16 + len(body), width, zlib.crc32(body))
    return struct.pack("<IIII", *header) + body


def unpack(block: bytes, precision: Precision) -> dict[str, float | list[float]]:
    """Return the values of a block as the law has them: reals rounded to its precision,
    lists in full.
    """
    items = list(struct.unpack(_format(precision), block[16:]))
    result: dict[str, float | list[float]] = dict(
        zip(HEADER, map(float, struct.unpack("<IIII", block[:16])), strict=True)
    )
    for name in COUNTS:
        result[name] = items.pop(0)
    for name, length in REALS:
        head, items = items[:length], items[length:]
        result[name] = head if length > 1 else head[0]
    return result


def exact_header(
    block: bytes, precision: Precision, modes: Mapping[str, int]
) -> tuple[int, int]:
    """Return (size, CRC-32) of the block with arrays of exactly `modes` real modes,
    pairs and forward modes.

    The keys are "real", "pair" and "forward"; law.c has that layout if it is compiled
    for one design.
    """
    values = unpack(block, precision)
    each = {"real": 2, "pair": 4, "forward": 2}
    flat: list[float] = []
    for name, _ in REALS:
        value = values[name]
        flat += (
            value[: each[name] * modes[name]] if isinstance(value, list) else [value]
        )
    body = block[16 : 16 + 4 * len(COUNTS)] + struct.pack(
        f"<{len(flat)}{real_type(precision)}", *flat
    )
    return 16 + len(body), zlib.crc32(body)


class Block(ABC):
    """Numbers for a C file in one precision: what law and payload estimator share."""

    precision: Precision

    @property
    @abstractmethod
    def block(self) -> bytes:
        """The parameter block, byte for byte."""

    @property
    def single(self) -> bool:
        """Whether the precision is "single"."""
        return self.precision == "single"

    @property
    def digest(self) -> str:
        """SHA-256 of the block, 64 hexadecimal digits: two blocks with the same digest
        run identically, to the last bit.
        """
        return hashlib.sha256(self.block).hexdigest()

    def in_precision(self, precision: Precision) -> Self:
        """Return the same numbers in "single" or "double" precision."""
        real_type(precision)
        return cast("Self", replace(cast("Any", self), precision=precision))


class Modes(NamedTuple):
    """A small parallel filter d + Σ g/(z − p): real poles and one pole of each complex
    pair.
    """

    direct: float
    poles: tuple[float, ...] = ()
    gains: tuple[float, ...] = ()
    pair_poles: tuple[complex, ...] = ()
    pair_gains: tuple[complex, ...] = ()


# [rad/s]: with a wider band friction stops small corrections, with a sharp sign the
# voltage chatters
COULOMB_SPEED = 0.02


@dataclass(frozen=True)
class DiscreteMotorLoop:
    """The motor loop and what it needs to know about the motor; without it a law gives a
    motor reference only.
    """

    pid: DiscretePid
    voltage_limit: float  # [V]
    torque_voltage: float  # compensation of the coupling torque, 1/(K n) [V/(N·m)]
    coulomb_voltage: float  # compensation of Coulomb friction, Γc/K [V]
    # speed of the motor model [rad/s] below which this compensation decreases to zero
    coulomb_speed: float = COULOMB_SPEED


@dataclass(frozen=True)
class Tracking:
    """What a law needs to use a given payload: the scale of its feed-forward, and the tip
    angle to expect.

    For a payload m the nominal feed-forward is multiplied by (m + link)/nominal.
    The tip then follows the reference as the motor follows its own (`MotorModel`).
    """

    # mass [kg] for which the feed-forward was made, including the link's own if its
    # model has it
    nominal: float
    link: float  # equivalent mass of the link at the tip
    gauge_delay: float = 0.0  # [s]
    gauge_gain: float = 1.0


@dataclass(frozen=True)
class MotorModel:
    """The placed motor loop with its delay: θm follows θm* through H/(z − 1 + H), H =
    now + next/(z − keep).
    """

    now: float
    next: float
    keep: float


def block_values(
    period: float,
    stiffness: float,
    motor_loop_pole: float,
    motor: MotorModel,
    correction: Modes,
    feedforward: Modes,
    limits: Limits,
    motor_loop: DiscreteMotorLoop | None,
    tracking: Tracking | None = None,
) -> dict[str, Any]:
    """Return every field of law_params except its header."""
    late = tracking is not None and (
        tracking.gauge_delay > 0 or tracking.gauge_gain != 1
    )
    return (
        vars(limits)
        | correction_values(correction)
        | _tracking(tracking, period)
        | _motor_loop(motor_loop, limits, motor_loop_pole)
        | {
            "options": (WITH_INNER if motor_loop is not None else 0)
            | (LATE_GAUGE if late else 0)
            | (STOP_RINGING if limits.stop_ringing else 0),
            "forward_modes": len(feedforward.poles),
            "forward_direct": feedforward.direct,
            "forward": _listed(feedforward),
            "period": period,
            "compliance": 1 / stiffness,
            # Infinite without a gauge; but a block holds finite numbers, and no torque
            # is read then.
            "stiffness": stiffness if math.isfinite(stiffness) else 0.0,
            "motor_now": motor.now,
            "motor_next": motor.next,
            "motor_keep": motor.keep,
        }
    )


def correction_values(modes: Modes) -> dict[str, Any]:
    """Return the fields of a block that hold the correction."""
    return {
        "real_modes": len(modes.poles),
        "pair_modes": len(modes.pair_poles),
        "direct": modes.direct,
        "real": _listed(modes),
        "pair": [
            x
            for pole, gain in zip(modes.pair_poles, modes.pair_gains, strict=True)
            for x in (pole.real, pole.imag, gain.real, gain.imag)
        ],
    }


def _listed(modes: Modes) -> list[float]:
    return [x for mode in zip(modes.poles, modes.gains, strict=True) for x in mode]


def _tracking(tracking: Tracking | None, period: float) -> dict[str, float]:
    """Without tracking, the payload limit is 0 and none of these is used."""
    t = tracking or Tracking(nominal=1.0, link=0.0)
    keep = math.exp(-period / t.gauge_delay) if t.gauge_delay > 0 else 0.0
    return {
        "link_scale": t.link / t.nominal,
        "payload_scale": 1 / t.nominal,
        "gauge_now": t.gauge_gain * (1 - keep),
        "gauge_keep": keep,
    }


def _motor_loop(
    motor_loop: DiscreteMotorLoop | None, limits: Limits, pole: float
) -> dict[str, Any]:
    if motor_loop is None:
        return dict.fromkeys(MOTOR_LOOP, 0.0)
    loop = motor_loop.pid
    friction = motor_loop.coulomb_voltage
    if pole > 0:
        # The largest error: at the largest speed of the reference the motor lags by 2/p
        # and 1.5 periods, and its model may be off.
        error = (
            2 / (pole * loop.period) + 1.5
        ) * limits.motor_step + limits.residual_angle
        credible = loop.direct * error
    # a PID without a motor: twice the response to the largest error, since the integral
    # may hold as much again
    else:
        error = limits.motor_limit + limits.angle_limit
        credible = (
            2 * error * (loop.direct + 2 * loop.integral_gain * loop.integral_now)
        )
    values = (
        loop.direct,
        loop.angle_direct,
        loop.integral_gain * loop.integral_now,
        loop.integral_gain * loop.integral_before,
        loop.filter_gain * loop.filter_now,
        loop.filter_gain * loop.filter_before,
        loop.angle_filter_gain * loop.filter_now,
        loop.angle_filter_gain * loop.filter_before,
        loop.filter_decay,
        motor_loop.voltage_limit
        + credible
        + motor_loop.torque_voltage * limits.torque_limit
        + friction,
        motor_loop.voltage_limit,
        motor_loop.torque_voltage,
        friction,
        # The slope of the softened sign function, per angle that the motor model turns
        # in a period; 0 without friction compensation.
        1 / (motor_loop.coulomb_speed * loop.period)
        if motor_loop.coulomb_voltage > 0
        else 0.0,
    )
    return dict(zip(MOTOR_LOOP, values, strict=True))


# [rad]: a law whose limits act on errors below 10 µrad would never correct anything
LEAST_RANGE = 1e-5


def modes_of(coefficients: Mapping[str, Any]) -> list[tuple[complex, complex]]:
    """(pole, gain) of every mode of the correction, conjugates included."""
    real, pair = coefficients["real"], coefficients["pair"]
    modes = [
        (complex(p), complex(g))
        for p, g in zip(real[::2], real[1::2], strict=True)
        if g
    ]
    for re, im, g, x in zip(*(pair[k::4] for k in range(4)), strict=True):
        if g or x:
            # The block stores c of ½(c/(z − q) + c̄/(z − q̄)): each fraction has half
            # of c.
            pole, gain = complex(re, im), complex(g, x) / 2
            modes += [(pole, gain), (pole.conjugate(), gain.conjugate())]
    return modes


def mode_norms(coefficients: Mapping[str, Any]) -> tuple[float, float]:
    """(largest state of a mode, largest correction) per largest error.

    A mode is driven by the change of the error: the impulse response of (1 − z⁻¹)/(z −
    p) is 1, p − 1, (p − 1) p, …, whose moduli sum to 1 + |1 − p|/(1 − |p|).
    """
    norms = [
        (1 + abs(1 - p) / (1 - abs(p)) if abs(p) < 1 else math.inf, abs(g))
        for p, g in modes_of(coefficients)
    ]
    gain = 2 * abs(coefficients["direct"]) + sum(norm * g for norm, g in norms)
    return max([norm for norm, _ in norms] + [1.0]), gain


def linear_range(coefficients: Mapping[str, Any]) -> float:
    """Return the tip error [rad] up to which no limit of the command acts, rounded down
    to two digits.

    By the l1 norms of the modes, term by term. FieldError if a limit leaves less than
    `LEAST_RANGE`: such a law is not the filter described by its modes.
    """
    c = coefficients
    state, gain = mode_norms(c)
    command = min(c["sum_limit"], c["motor_limit"], c["motor_step"] / 2)
    reach = min(command / max(gain, 1e-300), c["correction_limit"] / state) * (1 - 1e-9)
    if not (math.isfinite(reach) and reach >= LEAST_RANGE):
        raise FieldError(
            "law.limits",
            reach,
            "too narrow for the correction",
            f"limits that errors of {LEAST_RANGE:g} rad do not reach",
            "use the derived limits",
        )
    digit = 10.0 ** (math.floor(math.log10(reach)) - 1)
    return float(f"{math.floor(reach / digit) * digit:.2g}")


def inside_circle(coefficients: list[float]) -> bool:
    """Schur–Cohn test: whether every reflection coefficient of a real polynomial is
    below 1 in modulus, with a margin.
    """
    a = coefficients
    while len(a) > 1:
        if not abs(a[0]) * (1 - 1e-9) > abs(a[-1]):
            return False
        k = a[-1] / a[0]
        a = [a[i] - k * a[-1 - i] for i in range(len(a) - 1)]
    return True
