"""From the nouns of a law to the numbers of its parameter block."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

from fraclink._law.block import WITH_INNER
from fraclink._law.limits import Limits
from fraclink._law.nouns import Drive, Modes

__all__ = ["block_values"]


def block_values(
    period: float,
    stiffness: float,
    inner_pole: float,
    correction: Modes,
    feedforward: Modes,
    limits: Limits,
    drive: Drive | None,
) -> dict[str, Any]:
    """Return every field of law_params but its header."""
    return (
        asdict(limits)
        | _correction(correction)
        | _feedforward(feedforward)
        | _inner(drive, limits, inner_pole)
        | {
            "period": period,
            "compliance": 1 / stiffness,
            "stiffness": stiffness,
            "residual_rate": -math.expm1(-inner_pole * period),
        }
    )


def _correction(modes: Modes) -> dict[str, Any]:
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


def _feedforward(modes: Modes) -> dict[str, Any]:
    return {
        "forward_modes": len(modes.poles),
        "forward_direct": modes.direct,
        "forward": _listed(modes),
    }


def _inner(drive: Drive | None, limits: Limits, pole: float) -> dict[str, Any]:
    names = (
        "inner_direct",
        "inner_angle",
        "integral_now",
        "integral_before",
        "filter_now",
        "filter_before",
        "filter_angle_now",
        "filter_angle_before",
        "filter_decay",
        "wanted_limit",
        "voltage_limit",
        "torque_voltage",
        "coulomb_voltage",
        "coulomb_slope",
    )
    if drive is None:
        return dict.fromkeys(names, 0.0) | {"options": 0}
    loop = drive.loop
    # The motor follows at the reference's largest speed with the loop's lag, and a model's error behind it.
    friction = drive.coulomb_voltage
    error = (2 / (pole * loop.period) + 1.5) * limits.motor_step + limits.residual_angle
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
        drive.voltage_limit + loop.direct * error + drive.torque_voltage * limits.torque_limit + friction,
        drive.voltage_limit,
        drive.torque_voltage,
        friction,
        1 / (drive.coulomb_speed * loop.period) if drive.coulomb_voltage > 0 else 0.0,
    )
    return dict(zip(names, values, strict=True)) | {"options": WITH_INNER}
