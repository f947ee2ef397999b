"""Conditions on the rest of a law under which a claim about its loop holds for the arm:
the filters outside the loop, the compensations, and every guard.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict

import numpy as np

from fraclink._arm.link import LinkModel
from fraclink._arm.rig_parts import Moves
from fraclink._certify.numeric import motor_loop
from fraclink._certify.statement import Statement
from fraclink._law.block import COULOMB_SPEED, LATE_GAUGE, MotorModel, inside_circle
from fraclink._law.limits import CREDIBLE_SHARE, TRIP_SHARE, derive_limits
from fraclink._law.tracking import Following, held_reference
from fraclink.errors import FieldError
from fracsys.checks import Complex, Real

__all__ = ["check_guards"]

# Chosen by a person, or determined by the resonance alone.
_FREE = ("swing_angle", "stop_ringing", "payload_limit", "reference_rate")


def check_guards(statement: Statement) -> None:
    """FieldError if the moves of the claim would reach a guard, or if a part of the law
    outside the loop does not belong to the arm of the claim.
    """
    link = statement.link
    for name, value, low, high in _bounded_parts(statement, link):
        if not low <= value <= high:
            raise FieldError(
                f"law.{name}",
                value,
                "does not fit the arm of the claim",
                f"{low:.6g} … {high:.6g}",
                "make the law with Design.law()",
            )
    for name, least in _least_limits(statement, link):
        value = float(statement.coefficients[name])
        # Negated, so that NaN is rejected.
        if not value >= least * (1 - 1e-5):
            raise FieldError(
                f"law.{name}",
                value,
                "too small for the moves of the claim",
                f">= {least:.6g}",
                "use the limits of Design.law() for these payloads, or state the rig's [moves]",
            )


def _least_limits(s: Statement, link: LinkModel) -> Iterator[tuple[str, float]]:
    """(field, least value) of every guard, as derived for the moves of the claim."""
    c, loop = s.coefficients, _followed(s)
    period = float(c["period"])
    # Largest torque of the moves, doubled for payloads above the nominal one: up to it,
    # neither the gauge nor the trip may limit a move.
    push = 2 * s.stiffness * abs(complex(link.lead(link.resonance))) * s.acceleration
    limits = derive_limits(
        link,
        period,
        Moves(s.angle, s.velocity, s.acceleration),
        loop=loop,
        gauge_limit=push / TRIP_SHARE / CREDIBLE_SHARE,
        sticking=0.0,
        kick=abs(c["direct"]),
        heaviest=s.payload_high / s.nominal_payload,
    )
    # block_limit: a slightly different resonance may round to another number of periods.
    # residual_angle: the moves of the claim need no margin for a command three times as
    # fast.
    step = s.velocity * period
    least = asdict(limits) | {
        "block_limit": limits.block_limit - 1,
        "residual_angle": (1 + loop.slow) * step
        + loop.quick * s.acceleration * period**2,
    }
    if not c["payload_limit"]:
        least["scale_step"] = 0.0
    if s.motor_loop == "sampled":
        least["voltage_limit"] = (s.acceleration + s.decay * s.velocity) / s.gain_low
        behind = abs(c["inner_direct"]) * loop.lag * limits.motor_step
        least["wanted_limit"] = c["voltage_limit"] + behind
    yield from ((name, least[name]) for name in least if name not in _FREE)


def _followed(s: Statement) -> Following:
    """The tracking of the motor loop in the middle of the box, with the longest delay,
    and the law's model of it.
    """
    c, period = s.coefficients, float(s.coefficients["period"])

    def follows(frequency: Real) -> Complex:
        if s.motor_loop == "sampled":
            gain = 0.5 * (s.gain_low + s.gain_high)
            return motor_loop(s, frequency, s.delay_high, gain)[1]
        back = np.exp(-1j * frequency * period)
        reach = 0.5 * (s.pole_low + s.pole_high) * period
        late = back ** round(s.delay_high / period)
        return held_reference(reach, back) * late

    model = MotorModel(c["motor_now"], c["motor_next"], c["motor_keep"])
    return Following.of(model, follows, period)


def _bounded_parts(
    s: Statement, link: LinkModel
) -> Iterator[tuple[str, float, float, float]]:
    """(field, value, least, largest) of the filters and compensations outside the loop."""
    c = s.coefficients
    period, resonance = float(c["period"]), link.resonance
    poles, gains = c["forward"][::2], c["forward"][1::2]
    yield "forward.pole", max(map(abs, poles)), 0.0, 1 - 1e-9
    for frequency in (0.5 * resonance, resonance):
        z = np.exp(1j * frequency * period)
        value = c["forward_direct"] + sum(
            g / (z - p) for p, g in zip(poles, gains, strict=True)
        )
        # the margins of the guards cover half and twice the law's payload
        yield "forward", abs(value / complex(link.lead(frequency)) - 1), 0.0, 0.5
    yield "stiffness", c["stiffness"] * c["compliance"], 1 - 1e-6, 1 + 1e-6
    now, keep = c["motor_now"], c["motor_keep"]
    polynomial = [1.0, now - 1 - keep, keep - now * keep + c["motor_next"]]
    yield "motor_model", float(inside_circle(polynomial)), 1.0, 1.0
    if c["payload_limit"]:
        scale = c["link_scale"] + c["payload_scale"] * s.nominal_payload
        yield "payload_scale", scale, 0.5, 1.5
    gauge = 0.95 * s.gauge_gain_low, 1.05 * s.gauge_gain_high
    if c["options"] & LATE_GAUGE:
        yield "gauge_keep", c["gauge_keep"], 0.0, 1 - 1e-9
        yield "gauge_now", c["gauge_now"] / (1 - c["gauge_keep"]), *gauge
    if s.motor_loop == "sampled":
        yield "coulomb_voltage", c["coulomb_voltage"], 0.0, 1.05 * s.friction
        slope = 1.05 / (COULOMB_SPEED * period)
        yield "coulomb_slope", c["coulomb_slope"], 0.0, slope
        if c["torque_voltage"]:  # 0: no compensation, as the gauge's delay is too long
            # relative to the reading of the gauge, whose gain the compensation must
            # undo
            ratio = c["torque_voltage"] / s.coupling
            yield "torque_voltage", ratio, 1 / gauge[1], 1 / gauge[0]
