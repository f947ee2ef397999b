"""What the rest of a law must be for a claim about its loop to be one about the arm: the
filters that run beside the loop, the compensations, and every guard.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from fraclink._certify.statement import Statement
from fraclink._law.block import LATE_GAUGE, inside_circle
from fraclink._law.discretization import COULOMB_SPEED
from fraclink._law.limits import FADE_TIME, JUMP, SCALE_TIME, Limits
from fraclink.errors import FieldError

__all__ = ["check_guards"]

# rejected, missed and frozen samples that every law rides through
_COUNTS = ("bad_limit", "missed_limit", "residual_limit", "stuck_limit", "frozen_limit")


def check_guards(statement: Statement) -> None:
    """FieldError where the moves of the claim would meet a guard, or a part of the law
    beside its loop is not that of the claim's arm.
    """
    c = statement.coefficients
    for name, least in _least(statement):
        # Negated, so that nan is refused.
        if not float(c[name]) >= least * (1 - 1e-5):
            raise FieldError(
                f"law.{name}",
                c[name],
                "too small for the moves of the claim",
                allowed=f">= {least:.6g}",
                remedy="use the derived limits, or state the rig's [moves]",
            )
    for name, value, low, high in _parts(statement):
        if not low <= value <= high:
            raise FieldError(
                f"law.{name}",
                value,
                "not that of the arm of the claim",
                allowed=f"{low:.6g} … {high:.6g}",
                remedy="make the law with Design.law()",
            )


def _bend(s: Statement, frequency: float) -> complex:
    """1/G − 1 of the middle link with the payload of the law, over s²."""
    order, damping = (
        0.5 * (getattr(s, f"{name}_low") + getattr(s, f"{name}_high"))
        for name in ("order", "damping")
    )
    q, at = s.softness * s.nominal_payload, 1j * frequency
    return complex(q * at**order / (1 + q * damping * at**s.damping_order) / at**2)


def _least(s: Statement) -> Iterator[tuple[str, float]]:
    """(field, least value) of every guard, by the physics of the moves."""
    c, v, a = s.coefficients, s.velocity, s.acceleration
    period = float(c["period"])
    resonance = -JUMP / period * math.log1p(-c["reference_rate"])
    bend, held = abs(_bend(s, resonance)) * a, 1.5 * math.pi / resonance
    step, stiffness = 3 * v * period, s.stiffness
    push = 2 * stiffness * bend
    late = 1 / (c["motor_now"] + c["motor_next"] / (1 - c["motor_keep"]))
    yield "sum_limit", 4 * bend + abs(c["direct"]) * (2 * step + 1.05 * v * period)
    yield "correction_limit", 1.5 * (late * period * v + 0.15)
    yield "forward_limit", 3 * v / period
    yield "angle_limit", s.angle + 2 * bend
    yield "angle_step", 2 * step
    yield "torque_limit", push
    yield "torque_step", 2 * stiffness * step
    yield "torque_trip", push
    slow = abs(_bend(s, math.pi / held))
    yield "torque_block", 1.9 * stiffness * slow * min(a, 2 * v / held)
    yield "reference_step", 1.05 * v * period
    yield "acceleration_limit", 1.2 * a
    yield "motor_limit", s.angle
    yield "motor_step", step
    yield "fade_step", min(1.0, period / FADE_TIME)
    if c["payload_limit"]:
        yield "scale_step", min(1.0, period / SCALE_TIME)
    yield "frozen_angle", min(4.5 * a * period**2, v * period)
    yield "residual_angle", v * period + v * _unmodelled(s, resonance)
    for name in _COUNTS:
        yield name, getattr(Limits, name)
    yield "block_limit", max(5, round(held / period) - 1)
    for name in ("stuck_torque", "swing_angle", "wiring_energy"):
        yield name, 1e-6
    if s.motor_loop == "sampled":
        yield "voltage_limit", (a + s.decay * v) / s.gain_low
        yield (
            "wanted_limit",
            c["voltage_limit"] + abs(c["inner_direct"]) * late * step,
        )


def _unmodelled(s: Statement, resonance: float) -> float:
    """Largest distance of the motor from its model over the speed of the motion [s]: at
    a quarter to twice the resonance.
    """
    c, period = s.coefficients, float(s.coefficients["period"])
    w = resonance * np.array([0.25, 0.5, 1.0, 2.0])
    x = np.exp(-1j * w * period)
    h = c["motor_now"] + c["motor_next"] * x / (1 - c["motor_keep"] * x)
    model = h * x / (1 - x + h * x)
    if s.motor_loop == "ideal":
        keep = math.exp(-0.5 * (s.pole_low + s.pole_high) * period)
        log = -math.log(keep)
        top = (1 - keep * (1 + log)) * x + keep * (keep - 1 + log) * x**2
        loop = top / (1 - keep * x) ** 2 * x ** round(s.delay_high / period)
    else:
        lag = 1 / (1 - c["filter_decay"] * x)
        first = (
            c["inner_direct"]
            + (c["integral_now"] + c["integral_before"] * x) / (1 - x)
            + (c["filter_now"] + c["filter_before"] * x) * lag
        )
        both = (
            first
            + c["inner_angle"]
            + (c["filter_angle_now"] + c["filter_angle_before"] * x) * lag
        )
        e = math.exp(-s.decay * period)
        rest = -math.expm1(-s.decay * period) / s.decay
        gain = 0.5 * (s.gain_low + s.gain_high) / s.decay
        held = gain * ((period - rest) + (rest - period * e) * x)
        held = held * x ** (1 + s.whole + 1) / ((1 - x) * (1 - e * x))
        loop = first * held / (1 + both * held)
    return float(np.max(np.abs(loop - model) / w))


def _parts(s: Statement) -> Iterator[tuple[str, float, float, float]]:
    """(field, value, least, largest) of what runs beside the loop."""
    c = s.coefficients
    period = float(c["period"])
    resonance = -JUMP / period * math.log1p(-c["reference_rate"])
    poles, gains = c["forward"][::2], c["forward"][1::2]
    yield "forward.pole", max(map(abs, poles)), 0.0, 1 - 1e-9
    for frequency in (0.5 * resonance, resonance):
        z = np.exp(1j * frequency * period)
        value = c["forward_direct"] + sum(
            g / (z - p) for p, g in zip(poles, gains, strict=True)
        )
        # payloads of half and of twice the law's are what its guards leave room for
        yield "forward", abs(value / _bend(s, frequency) - 1), 0.0, 0.5
    yield "stiffness", c["stiffness"] * c["compliance"], 1 - 1e-6, 1 + 1e-6
    now, keep = c["motor_now"], c["motor_keep"]
    polynomial = [1.0, now - 1 - keep, keep - now * keep + c["motor_next"]]
    yield "motor_model", float(inside_circle(polynomial)), 1.0, 1.0
    if c["payload_limit"]:
        yield (
            "payload_scale",
            c["link_scale"] + c["payload_scale"] * s.nominal_payload,
            0.5,
            1.5,
        )
    gauge = 0.95 * s.gauge_gain_low, 1.05 * s.gauge_gain_high
    if c["options"] & LATE_GAUGE:
        yield "gauge_keep", c["gauge_keep"], 0.0, 1 - 1e-9
        yield "gauge_now", c["gauge_now"] / (1 - c["gauge_keep"]), *gauge
    if s.motor_loop == "sampled":
        yield "coulomb_voltage", c["coulomb_voltage"], 0.0, 1.05 * s.friction
        slope = 1.05 / (COULOMB_SPEED * period)
        yield "coulomb_slope", c["coulomb_slope"], 0.0, slope
        if c["torque_voltage"]:  # 0: a gauge that is too late compensates nothing
            # of the gauge's own reading, whose gain it has to undo
            ratio = c["torque_voltage"] / s.coupling
            yield "torque_voltage", ratio, 1 / gauge[1], 1 / gauge[0]
