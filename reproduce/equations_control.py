"""Equations (1) and (19) to (33): motor, inner loop, control law, closed loop, offset
and noise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fraclink._arm.controller import Controller
from fraclink._arm.motor import ContinuousPid, place_pid
from fraclink._arm.rig import Motor
from reproduce.forms import Complex
from reproduce.points import Check, Mass, Sides, mass, power, somewhere

__all__ = ["CONTROL"]

Draw = np.random.Generator


# ---- the inner loop ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Placed:
    """A random motor, a pole p, and PID coefficients from a linear system for the
    closed-loop polynomial.
    """

    motor: Motor
    pole: float
    s: complex

    @property
    def plant(self) -> complex:
        """Gm(s) from the two differential equations, speed and angle."""
        m = self.motor
        matrix = np.array(
            [[m.inertia * self.s + m.viscous_friction, 0.0], [-1.0, self.s]]
        )
        return complex(
            np.linalg.solve(matrix, np.array([m.torque_constant, 0.0], dtype=complex))[
                1
            ]
        )

    @property
    def ideal(self) -> complex:
        """M(s): four poles and two zeros at −p, with unit gain at s = 0."""
        poles, zeros = np.poly([-self.pole] * 4), np.poly([-self.pole] * 2)
        scale = poles[-1] / zeros[-1]
        return complex(scale * np.polyval(zeros, self.s) / np.polyval(poles, self.s))

    def coefficients(self) -> dict[str, float]:
        """c, a0, a1, a2, b0 and b1 that place all poles and both zeros at −p."""
        m, p = self.motor, self.pole
        gain, decay = m.torque_constant / m.inertia, m.viscous_friction / m.inertia
        names = ("c", "a0", "a1", "a2", "b0", "b1")
        # coefficients of s³, s², s and 1 of the closed-loop polynomial, then the zeros:
        # a1 = 2p a2 and a0 = p² a2
        rows = [
            ([1, 0, 0, 0, 0, 0], 4 * p - decay),
            ([decay, 0, 0, gain, 0, gain], 6 * p**2),
            ([0, 0, gain, 0, gain, 0], 4 * p**3),
            ([0, gain, 0, 0, 0, 0], p**4),
            ([0, 0, 1, -2 * p, 0, 0], 0.0),
            ([0, 1, 0, -(p**2), 0, 0], 0.0),
        ]
        found = np.linalg.solve(
            np.array([row for row, _ in rows], dtype=float),
            [right for _, right in rows],
        )
        return dict(zip(names, (float(x) for x in found), strict=True))

    def parts(self) -> tuple[complex, complex]:
        """C_m1(s) and C_m2(s) in the printed form, with these coefficients."""
        s, k = self.s, self.coefficients()
        first = (k["a2"] * s**2 + k["a1"] * s + k["a0"]) / (s * (s + k["c"]))
        return first, (k["b1"] * s + k["b0"]) / (s + k["c"])


def _placed(draw: Draw) -> _Placed:
    motor = Motor(
        draw.uniform(1e-5, 1e-3), draw.uniform(1e-4, 1e-2), draw.uniform(0.05, 1.0)
    )
    pole = float(draw.uniform(1.0, 10.0)) * max(motor.decay, 5.0)
    return _Placed(motor, pole, somewhere(draw, pole))


def _motor(code: Any, draw: Draw) -> Sides:
    at = _placed(draw)
    s, m = at.s, at.motor
    printed = (m.torque_constant / m.inertia) / (
        s * (s + m.viscous_friction / m.inertia)
    )
    own = code(m.inertia, m.viscous_friction, m.torque_constant)
    return printed, own.gain / (s * (s + own.decay)), at.plant


def _first(code: Any, draw: Draw) -> Sides:
    """(19): C_m1 required for M, given C_m2."""
    at = _placed(draw)
    own, s = code(at.motor, at.pole), at.s
    value = (own.a2 * s**2 + own.a1 * s + own.a0) / (s * (s + own.filter_pole))
    first, second = at.parts()
    return first, value, at.ideal * (1.0 / at.plant + second) / (1.0 - at.ideal)


def _second(code: Any, draw: Draw) -> Sides:
    """(20): C_m2 required for M, given C_m1."""
    at = _placed(draw)
    own, s = code(at.motor, at.pole), at.s
    first, second = at.parts()
    return (
        second,
        (own.b1 * s + own.b0) / (s + own.filter_pole),
        first * (1.0 / at.ideal - 1.0) - 1.0 / at.plant,
    )


def _inner(code: Any, draw: Draw) -> Sides:
    """(21): the closed inner loop from the motor and the controllers."""
    at = _placed(draw)
    first, second = at.parts()
    loop: ContinuousPid = place_pid(at.motor, at.pole)
    closed = first * at.plant / (1.0 + at.plant * (first + second))
    return 1.0 / (1.0 + at.s / at.pole) ** 2, code(loop)(at.s), closed


# ---- the outer loop ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Outer:
    """A random link, controller and motor loop at one value of s."""

    link: Mass
    controller: Controller
    lag: float
    s: complex

    @property
    def inertia(self) -> complex:
        """s^λ."""
        return power(self.s, self.link.order)

    @property
    def correction(self) -> complex:
        """Ĉ(s), in polar form."""
        k = self.controller
        return (
            k.derivative_gain
            * power(self.s, k.derivative_order)
            / (1.0 + k.filter_time * self.s) ** k.filter_order
        )

    @property
    def motor(self) -> complex:
        """M(s)."""
        return 1.0 / (1.0 + self.lag * self.s) ** 2

    def solved(
        self, *, motor: complex | None = None, correction: complex | None = None
    ) -> Complex:
        """P(s): θt, θm* for θt* = 1 and for d = 1, from Newton's law, gauge, motor loop
        and control law.

        Unknowns θt, θm, Γ, θm*. The law in Ĉ: θm* = θt* + (s^λ/ω₀²) θt* + Ĉ (θt* −
        θtᵉ).
        """
        m = self.motor if motor is None else motor
        k = self.correction if correction is None else correction
        c, heavy = self.link.stiffness, self.link.inertia * self.inertia
        matrix = np.array(
            [[heavy, 0, -1, 0], [c, -c, 1, 0], [0, 1, 0, -m], [0, k, -k / c, 1]],
            dtype=complex,
        )
        ahead = 1.0 + self.inertia * self.link.inertia / c + k
        right = np.array([[0, 0], [0, 0], [0, 0], [ahead, -k]], dtype=complex)
        found = np.linalg.solve(matrix, right)
        return np.array([found[0], found[3]])

    def printed(self, *, divided: bool) -> Complex:
        """(24) or (25) as printed, with s^λ instead of s^λ/ω₀²."""
        square, c, m, x = (
            self.link.natural**2,
            1.0 + self.correction,
            self.motor,
            self.inertia,
        )
        if divided:
            tip = square / (x + square)
            rows = [[m * tip * (c + x), -m * tip * (c - 1)], [c + x, -c + 1]]
            return np.array(rows) / (1 + m * tip * (c - 1))
        rows = [
            [square * m * (c + x), -square * m * (c - 1)],
            [(c + x) * (square + x), -(c - 1) * (square + x)],
        ]
        return np.array(rows) / (x + square + square * m * (c - 1))


def _outer(draw: Draw, *, axis: bool = False) -> _Outer:
    link = mass(draw)
    controller = Controller(
        derivative_gain=float(draw.uniform(0.05, 1.0)),
        derivative_order=float(draw.uniform(0.2, 1.5)),
        filter_time=float(draw.uniform(1e-3, 0.05)),
        filter_order=int(draw.integers(1, 3)),
    )
    s = somewhere(draw, link.natural ** (2.0 / link.order))
    return _Outer(
        link, controller, float(draw.uniform(0.002, 0.05)), 1j * abs(s) if axis else s
    )


def _law(code: Any, draw: Draw) -> Sides:
    """(22): the responses of the law to θt* and to d, with M = 1. The linearisation is
    meant to give θt = θt*.
    """
    at = _outer(draw)
    square = at.link.natural**2
    tip, x, c = square / (at.inertia + square), at.inertia, 1.0 + at.correction

    def closed(law: Any) -> list[complex]:
        # The law is linear: θm* = ahead θt* + back θtᵉ; θt = G θm* and θtᵉ = θt + d.
        ahead, back = law(1.0, 0.0), law(0.0, 1.0)
        return [tip * ahead / (1.0 - tip * back), tip * back / (1.0 - tip * back)]

    def printed(reference: float, estimate: float) -> complex:
        return reference + (x * reference + c * (reference - estimate))

    true = at.solved(motor=1.0)
    own = closed(
        lambda reference, estimate: code(reference, estimate, x, at.link.natural, c)
    )
    return closed(printed), own, [1.0, true[0, 1]]


def _estimate(code: Any, draw: Draw) -> Sides:
    """(23), for θm = 1 and a disturbance d' of the torque."""
    at, disturbance = _outer(draw), complex(draw.normal(), draw.normal())
    tip, torque = at.link.solved(at.s)
    c = at.link.stiffness
    return (
        1.0 - torque / c - disturbance / c,
        code(1.0, torque, disturbance, c),
        tip - disturbance / c,
    )


def _matrix(divided: bool) -> Check:
    """(24), (25): P11, P12, P21 and P22."""

    def sides(code: Any, draw: Draw) -> Sides:
        at = _outer(draw)
        own = code(
            at.inertia, at.link.natural, 1.0 + at.correction, at.motor, divided=divided
        )
        return at.printed(divided=divided), own, at.solved()

    return Check(sides)


def _loop(code: Any, at: _Outer) -> complex:
    """L(jω) of the package's Loop, including M(s)."""
    k = at.controller
    loop = code(
        link_order=at.link.order,
        gain=k.derivative_gain,
        order=k.derivative_order,
        filter_time=k.filter_time,
        filter_order=k.filter_order,
        lag=at.lag,
    )
    return complex(loop(abs(at.s), at.link.natural))


def _tip_of_disturbance(code: Any, draw: Draw) -> Sides:
    """(26)."""
    at = _outer(draw, axis=True)
    loop = _loop(code, at)
    return at.printed(divided=False)[0, 1], -loop / (1.0 + loop), at.solved()[0, 1]


def _offset(code: Any, draw: Draw) -> Sides:
    """(27), for any Ĉ(0)."""
    at, left = _outer(draw), float(draw.uniform(0.0, 2.0))
    still = _Outer(at.link, at.controller, at.lag, 0j)
    square = at.link.natural**2
    printed = -square * left / (square + square * left)
    return printed, code(left), still.solved(motor=1.0, correction=left)[0, 1]


def _with_one(code: Any, draw: Draw) -> Sides:
    """(28), (56), (57): C(s) = 1 + Ĉ(s), and C(0) = 1."""
    at = _outer(draw)
    k, own = at.controller, code(at.controller)
    printed = (
        1.0
        + k.derivative_gain
        * at.s**k.derivative_order
        / (1.0 + k.filter_time * at.s) ** k.filter_order
    )
    return [printed, 1.0], [own(at.s), own(0j)], [1.0 + at.correction, 1.0]


def _without_filter(code: Any, draw: Draw) -> Sides:
    """(56)."""
    at = _outer(draw)
    k = replace(at.controller, filter_time=0.0)
    return (
        1.0 + k.derivative_gain * at.s**k.derivative_order,
        code(k)(at.s),
        1.0 + k.derivative_gain * power(at.s, k.derivative_order),
    )


def _reference_of_disturbance(*, modulus: bool = False, hat: bool = False) -> Check:
    """(29), (30) and (31): P22 in terms of C and of Ĉ, and its modulus with numerator
    and denominator divided by s^λ.
    """

    def sides(code: Any, draw: Draw) -> Sides:
        at = _outer(draw, axis=True)
        own = -at.correction / (1.0 + _loop(code, at))
        true = at.solved()[1, 1]
        x, square, k, m = at.inertia, at.link.natural**2, at.correction, at.motor
        if hat:
            return -k * (square + x) / (x + square * (1.0 + m * k)), own, true
        if not modulus:
            return at.printed(divided=False)[1, 1], own, true
        w, order = abs(at.s), at.link.order
        turned = square * np.exp(-0.5j * math.pi * order)
        printed = (
            abs(k)
            * abs(1 + turned / w**order)
            / abs(1 + turned * (w**-order + m * k * w**-order))
        )
        return printed, abs(own), abs(true)

    return Check(sides)


def _proper(code: Any, draw: Draw) -> Sides:
    """(32): P22 → 0 if and only if |Ĉ| → 0, which requires n > β."""
    at = _outer(draw, axis=True)

    def falls(value: Any) -> float:
        far, near = (
            abs(value(_Outer(at.link, at.controller, at.lag, 1j * w)))
            for w in (1e12, 1e9)
        )
        return float(far < 0.99 * near)

    printed = falls(lambda place: place.correction)
    return (
        printed + 1.0,
        float(code(at.controller)) + 1.0,
        falls(lambda place: place.solved()[1, 1]) + 1.0,
    )


def _derivative(code: Any, draw: Draw) -> Sides:
    """(33)."""
    at = _outer(draw)
    k = replace(at.controller, filter_time=0.0)
    return (
        k.derivative_gain * at.s**k.derivative_order,
        code(k)(at.s),
        k.derivative_gain * power(at.s, k.derivative_order),
    )


CONTROL: Mapping[str, Check] = {
    "(1)": Check(_motor),
    "(19)": Check(_first),
    "(20)": Check(_second),
    "(21)": Check(_inner),
    "(22)": Check(_law),
    "(23)": Check(_estimate),
    "(24)": _matrix(divided=True),
    "(25)": _matrix(divided=False),
    "(26)": Check(_tip_of_disturbance),
    "(27)": Check(_offset),
    "(28)": Check(_with_one),
    "(29)": _reference_of_disturbance(),
    "(30)": _reference_of_disturbance(hat=True),
    "(31)": _reference_of_disturbance(modulus=True),
    "(32)": Check(_proper),
    "(33)": Check(_derivative),
    "(56)": Check(_without_filter),
    "(57)": Check(_with_one),
}
