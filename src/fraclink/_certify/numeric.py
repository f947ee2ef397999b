"""The same sampled loop in plain floating point: where to look before anything is proved."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fraclink._certify.statement import Statement

if TYPE_CHECKING:
    from fraclink._law import Law

__all__ = ["loop_values", "windings", "worst_distance"]

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]


def loop_values(
    statement: Statement, law: Law, frequency: ArrayLike, payload: ArrayLike, delay: ArrayLike
) -> Complex:
    """Return L without its aliases; frequency [rad/s], payload [kg] and delay [s] broadcast."""
    w, m, late = (np.asarray(v, dtype=float) for v in (frequency, payload, delay))
    s, period = 1j * w, law.period
    soft = statement.softness * m
    drag = soft * statement.damping * s**statement.damping_order
    tip = (1.0 + drag) / (1.0 + soft * s**statement.order + drag)
    mode = np.zeros_like(s)
    if statement.mode_frequency:
        ratio = s / statement.mode_frequency
        mode = statement.mode_gain * ratio**2 / (ratio**2 + 2 * statement.mode_damping * ratio + 1)
    link = 1.0 - statement.gauge * np.exp(-s * statement.gauge_delay) * (1.0 - tip + mode)
    hold = -np.expm1(-s * period) / (s * period)
    outer = law.frequency_response(w) * hold * link * np.exp(-s * late)
    if statement.motor_loop == "ideal":
        return np.asarray(outer / (1.0 + s / statement.pole) ** 2)
    return np.asarray(
        outer * _voltage(statement, law, w, late) * statement.gain / (s * (s + statement.decay))
    )


def _voltage(statement: Statement, law: Law, frequency: Real, delay: Real) -> Complex:
    """Cm1/(1 + (Cm1 + Cm2) P_τ) with the held motor late by any part of a period."""
    c, x = law.coefficients, np.exp(-1j * frequency * law.period)
    slow = 1.0 / (1.0 - float(c["filter_decay"]) * x)  # type: ignore[arg-type]

    def pair(name: str) -> Complex:
        now, before = float(c[f"{name}_now"]), float(c[f"{name}_before"])  # type: ignore[arg-type]
        return np.asarray(now + before * x)

    first = float(c["inner_direct"]) + pair("integral") / (1.0 - x) + slow * pair("filter")  # type: ignore[arg-type]
    both = first + float(c["inner_angle"]) + slow * pair("filter_angle")  # type: ignore[arg-type]
    decay, left = statement.decay, law.period - delay
    held = (decay * left - 1.0) + decay * law.period * x / (1.0 - x)
    held = held + np.exp(-decay * left) * (1.0 - x) / (1.0 - np.exp(-decay * law.period) * x)
    return np.asarray(first / (1.0 + both * x * statement.gain / decay**2 * held))


def _grid(statement: Statement, law: Law, points: int) -> Real:
    """Frequencies up to Nyquist, dense where the modes of the payloads lie."""
    mode = (1.0 / (statement.softness * np.array([statement.payload_high, statement.payload_low]))) ** (
        1.0 / statement.order
    )
    nyquist = np.pi / law.period
    near = np.geomspace(0.5 * mode[0], min(4.0 * mode[1], nyquist), points)
    return np.unique(np.concatenate([near, np.geomspace(0.05, nyquist, points)]))


def _corners(statement: Statement, payloads: int, delays: int) -> tuple[Real, Real]:
    m = np.geomspace(statement.payload_low, statement.payload_high, payloads)
    return m[:, None, None], np.linspace(statement.delay_low, statement.delay_high, delays)[:, None]


def worst_distance(statement: Statement, law: Law) -> tuple[float, float, float, float]:
    """Return (|1 + L|, ω, payload, delay) where a grid finds the loop closest to -1."""
    w = _grid(statement, law, 600)
    m, late = _corners(statement, 9, 5)
    distance = np.abs(1.0 + loop_values(statement, law, w, m, late))
    a, b, c = np.unravel_index(int(np.argmin(distance)), distance.shape)
    around = w[max(int(c) - 1, 0) : int(c) + 2]
    fine = np.linspace(around[0], around[-1], 201)
    closest = np.abs(1.0 + loop_values(statement, law, fine, m[a, 0, 0], late[b, 0]))
    best = int(np.argmin(closest))
    return float(closest[best]), float(fine[best]), float(m[a, 0, 0]), float(late[b, 0])


def windings(statement: Statement, law: Law) -> tuple[float, float, float] | None:
    """Return (payload, delay, ω of the crossing left of -1) of an unstable corner, None where there is none.

    -1 is encircled as often as the phase of 1 + L ends away from zero; L itself is open-loop stable.
    """
    w = _grid(statement, law, 2000)
    m, late = _corners(statement, 5, 3)
    value = 1.0 + loop_values(statement, law, w, m, late)
    turned = np.unwrap(np.angle(value), axis=-1)
    circled = np.round((turned[..., -1] - turned[..., 0]) / np.pi) != 0
    if not np.any(circled):
        return None
    a, b = np.argwhere(circled)[-1]
    crossing = np.nonzero((value[a, b, :-1].imag > 0) != (value[a, b, 1:].imag > 0))[0]
    left = [i for i in crossing if value[a, b, i].real < 0.0]
    at = left[0] if left else int(np.argmin(np.abs(value[a, b])))
    return float(m[a, 0, 0]), float(late[b, 0]), float(w[at])
