"""The flexible link: one formula, four structures.

    Γ(s)/θm(s) = c s^λ / (s^λ + μ s^α + ϖ²)

A structure of the paper is a row of one table that says which of (ϖ, λ, μ, α) are free; the others
keep the value that makes the term vanish or classical.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from fraclink._validate import checked_choice, checked_number
from fraclink.errors import FieldError

if TYPE_CHECKING:
    from fraclink._systems.fractional import FractionalTransferFunction

__all__ = ["STRUCTURES", "LinkModel", "Structure", "structure"]


@dataclass(frozen=True)
class Structure:
    """A link structure: the parameters of the one formula that are free in it.

    `equation` is its equation in the paper; the count of `free` is k in the AIC (18).

    >>> structure("UD-FOM").free
    ('natural_frequency', 'order')
    """

    name: str
    free: tuple[str, ...]
    equation: str
    sentence: str


_FREQUENCY = "natural_frequency"
STRUCTURES: dict[str, Structure] = {
    row.name: row
    for row in (
        Structure("UD-IOM", (_FREQUENCY,), "(6)", "undamped, integer order"),
        Structure("D-IOM", (_FREQUENCY, "damping"), "(15)", "viscous damping, integer order"),
        Structure("UD-FOM", (_FREQUENCY, "order"), "(10)", "Newton's law of fractional order"),
        Structure("D-FOM", (_FREQUENCY, "damping", "damping_order"), "(16)", "damping of fractional order"),
    )
}


def structure(name: str) -> Structure:
    """Return the row of `name` ("UD-IOM", "D-IOM", "UD-FOM" or "D-FOM"); FieldError otherwise.

    >>> structure("D-IOM").sentence
    'viscous damping, integer order'
    """
    return STRUCTURES[checked_choice("structure", name, STRUCTURES)]


def _mass(payload: object) -> float:
    return checked_number(
        "payload",
        payload,
        allowed="> 0 kg",
        remedy="give the mass at the tip in kg",
        holds=lambda mass: mass > 0,
    )


@dataclass(frozen=True)
class LinkModel:
    """A flexible link that carries a payload, seen from the motor angle.

        Γ/θm = c s^λ / (s^λ + μ s^α + ϖ²),    θt/θm = (μ s^α + ϖ²) / (s^λ + μ s^α + ϖ²)

    Arguments:
        stiffness: c > 0 [N·m/rad].
        natural_frequency: ϖ ≥ 0 [s^(-λ/2)]; it is rad/s only for λ = 2, and may be 0 only where μ > 0.
        order: λ in [1, 2] [1], the order of the inertia.
        damping: μ ≥ 0 [s^(α-λ)].
        damping_order: α in (0, 2) [1]; without damping it plays no part.
        payload: m > 0 [kg] at which ϖ holds, or None where it is not known.

    Raises FieldError for a value out of its range. Source: the paper, equations (6), (10), (15), (16).

    >>> link = LinkModel(stiffness=1.56, natural_frequency=10.02, order=1.92)
    >>> link.structure, round(link.tip_resonance, 3), round(link.damping_ratio, 4)
    ('UD-FOM', 10.984, 0.0654)
    """

    stiffness: float
    natural_frequency: float
    order: float = 2.0
    damping: float = 0.0
    damping_order: float = 1.0
    payload: float | None = None

    def __post_init__(self) -> None:
        put = object.__setattr__
        checks: tuple[tuple[str, Callable[[float], bool], str, str], ...] = (
            ("stiffness", lambda x: x > 0, "> 0 N·m/rad", "give the measured torque per radian"),
            (_FREQUENCY, lambda x: 0 <= x < 1e6, "0 to 1e6 s^(-λ/2)", "give ϖ = sqrt(c/(m L²))"),
            ("order", lambda x: 1 <= x <= 2, "1 to 2", "give λ, 2 for a classical link"),
            ("damping", lambda x: x >= 0, ">= 0", "give μ, 0 for an undamped link"),
            ("damping_order", lambda x: 0 < x < 2, "0 < α < 2", "give α, 1 for viscous damping"),
        )
        for field, holds, allowed, remedy in checks:
            value = getattr(self, field)
            put(self, field, checked_number(field, value, holds=holds, allowed=allowed, remedy=remedy))
        if self.payload is not None:
            put(self, "payload", _mass(self.payload))
        if self.natural_frequency == 0 and self.damping == 0:
            raise FieldError(
                _FREQUENCY, 0.0, "zero without damping", allowed="> 0", remedy="give ϖ = sqrt(c/(m L²))"
            )

    @property
    def structure(self) -> str:
        """The paper's name of the structure: "UD-IOM", "D-IOM", "UD-FOM" or "D-FOM".

        A model with both λ < 2 and μ > 0 obeys the one formula but is none of the four: "general".
        """
        if self.damping == 0:
            return "UD-IOM" if self.order == 2 else "UD-FOM"
        if self.order != 2:
            return "general"
        return "D-IOM" if self.damping_order == 1 else "D-FOM"

    def tip(self) -> FractionalTransferFunction:
        """Return θt/θm = (μ s^α + ϖ²)/(s^λ + μ s^α + ϖ²) [rad/rad], the paper's (4) and (9).

        >>> abs(LinkModel(1.56, 10.0, order=1.9).tip()(0.001j)).__round__(6)
        1.0
        """
        return self._over_denominator(1.0, inertia=False)

    def torque(self) -> FractionalTransferFunction:
        """Return Γ/θm = c s^λ/(s^λ + μ s^α + ϖ²) [N·m/rad], the paper's (6), (10), (15), (16).

        >>> abs(LinkModel(1.56, 10.0, order=1.9).torque()(1e6j)).__round__(4)
        1.56
        """
        return self._over_denominator(self.stiffness, inertia=True)

    def _over_denominator(self, gain: float, *, inertia: bool) -> FractionalTransferFunction:
        from fraclink._systems.fractional import FractionalTransferFunction, Term

        restoring = [Term(self.natural_frequency**2, 0.0)] if self.natural_frequency else []
        restoring += [Term(self.damping, self.damping_order)] if self.damping else []
        moving = Term(1.0, self.order)
        numerator = [moving] if inertia else restoring
        scaled = tuple(replace(term, coefficient=gain * term.coefficient) for term in numerator)
        return FractionalTransferFunction(scaled, (*restoring, moving))

    @property
    def pole(self) -> complex:
        """The vibration pole with positive imaginary part [rad/s], root of s^λ + μ s^α + ϖ² = 0.

        Without damping it is ϖ^(2/λ) e^(jπ/λ) exactly; with damping a Newton iteration in ln s
        follows it there from that value (negative real where the link is overdamped).
        """
        if self.damping == 0:
            return cmath.rect(self.natural_frequency ** (2 / self.order), math.pi / self.order)
        return _damped_pole(self.order, self.damping, self.damping_order, self.natural_frequency**2)

    @property
    def damping_ratio(self) -> float:
        """ζ = −Re(p)/|p| of the vibration pole [1]; for UD-FOM −cos(π/λ), the same for every payload."""
        return 0.0 if self.structure == "UD-IOM" else -self.pole.real / abs(self.pole)

    @property
    def tip_resonance(self) -> float | None:
        """Frequency [rad/s] where |θt/θm| peaks, None where it has no peak.

        For UD-FOM it is (14), ω_r = (−ϖ² cos(πλ/2))^(1/λ).
        """
        if self.damping == 0:
            cosine = -math.cos(math.pi * self.order / 2)
            return (self.natural_frequency**2 * cosine) ** (1 / self.order) if self.order > 1 else None
        return self._peak(inertia=False)

    @property
    def torque_resonance(self) -> float | None:
        """Frequency [rad/s] where |Γ/θm| peaks, None where it has no peak.

        For UD-FOM it is (−ϖ²/cos(πλ/2))^(1/λ), which is what a torque spectrum shows; the paper
        compares (14), the peak of the tip angle, with the measured torque.
        """
        if self.damping == 0:
            cosine = -math.cos(math.pi * self.order / 2)
            return (self.natural_frequency**2 / cosine) ** (1 / self.order) if self.order > 1 else None
        return self._peak(inertia=True)

    def _peak(self, *, inertia: bool) -> float | None:
        import numpy as np

        def level(log_frequency: float) -> float:
            s = 1j * math.exp(log_frequency)
            restoring = self.damping * s**self.damping_order + self.natural_frequency**2
            moving = s**self.order
            return abs((moving if inertia else restoring) / (moving + restoring))

        centre = math.log(abs(self.pole))
        grid = np.linspace(centre - 3.0, centre + 3.0, 601)
        values = [level(x) for x in grid]
        best = int(np.argmax(values))
        if best in (0, len(values) - 1):
            return None  # a monotone curve: its largest value on the grid is an end of it
        return math.exp(_golden(level, float(grid[best - 1]), float(grid[best + 1])))

    def at_payload(self, payload: float) -> LinkModel:
        """Return the model at another `payload` [kg > 0]: ϖ scales by sqrt(m/payload), eq. (5).

        λ, μ and α are kept, as the paper keeps them in Table 3. Needs a known `payload`.

        >>> LinkModel(1.56, 10.0, order=1.92, payload=0.03).at_payload(0.12).natural_frequency
        5.0
        """
        if self.payload is None:
            raise FieldError(
                "payload",
                None,
                "not known",
                allowed="> 0 kg",
                remedy="make the model with the payload at which its frequency holds",
            )
        wanted = _mass(payload)
        ratio = self.payload / wanted
        return replace(
            self,
            natural_frequency=self.natural_frequency * math.sqrt(ratio),
            payload=wanted,
        )


def _damped_pole(order: float, damping: float, damping_order: float, square: float) -> complex:
    """Newton on z ↦ e^{λz} + μ e^{αz} + ϖ², z = ln s, while μ grows from 0 (or ϖ² from 0) to its value."""
    alone = damping ** (1 / (order - damping_order)) if order > damping_order and square == 0 else 0.0
    if alone:
        return cmath.rect(alone, min(math.pi / (order - damping_order), math.pi))
    z = complex(math.log(square) / order, math.pi / order)
    for share in (0.01, 0.03, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.0):
        for _ in range(12):
            moving, friction = cmath.exp(order * z), share * damping * cmath.exp(damping_order * z)
            step = (moving + friction + square) / (order * moving + damping_order * friction)
            z -= step if abs(step) < 0.5 else 0.5 * step / abs(step)
            z = complex(z.real, min(max(z.imag, 0.0), math.pi))
            if abs(step) < 1e-15:
                break
    return cmath.exp(z)


def _golden(level: Callable[[float], float], low: float, high: float) -> float:
    ratio = (math.sqrt(5) - 1) / 2
    while high - low > 1e-9:  # the square root of the precision: a maximum is flat to 1e-18 there
        left, right = high - ratio * (high - low), low + ratio * (high - low)
        low, high = (low, right) if level(left) > level(right) else (left, high)
    return (low + high) / 2
