"""The flexible link: one formula, four structures.

    Γ(s)/θm(s) = c s^λ / (s^λ + μ s^α + ω₀²)

A structure of the paper is a row of a table that says which of (ω₀, λ, μ, α) are free;
the others keep the value with which their term vanishes or is classical.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from fraclink._display import number, quantity
from fraclink._files import document
from fraclink.errors import FieldError
from fracsys._fractional import FractionalTransferFunction, s
from fracsys.checks import Between, Complex, Real, Where, above, checked, checked_choice

__all__ = ["STRUCTURES", "LinkModel", "SecondMode", "Structure", "structure"]


@dataclass(frozen=True)
class Structure:
    """A link structure: the parameters of the one formula that are free in it.

    The count of `free` is k in the AIC (18).

    >>> structure("UD-FOM").free
    ('natural_frequency', 'order')
    """

    name: str
    free: tuple[str, ...]
    sentence: str


_FREQUENCY = "natural_frequency"
STRUCTURES: dict[str, Structure] = {
    row.name: row
    for row in (
        Structure("UD-IOM", (_FREQUENCY,), "undamped, integer order"),
        Structure("D-IOM", (_FREQUENCY, "damping"), "viscous damping, integer order"),
        Structure(
            "UD-FOM",
            (_FREQUENCY, "order"),
            "fractional order in place of damping",
        ),
        Structure(
            "D-FOM",
            (_FREQUENCY, "damping", "damping_order"),
            "fractional damping, integer order",
        ),
    )
}
# For the few places that need this one; all other code iterates over the table.
FRACTIONAL = "UD-FOM"


def structure(name: str) -> Structure:
    """Return the row of `name` ("UD-IOM", "D-IOM", "UD-FOM" or "D-FOM"); FieldError
    otherwise.

    >>> structure("D-IOM").sentence
    'viscous damping, integer order'
    """
    return STRUCTURES[checked_choice("structure", name, STRUCTURES)]


Mass = Annotated[
    float,
    above(0.0, unit="kg", remedy="give the mass at the tip in kg"),
]


@checked
@dataclass(frozen=True)
class SecondMode:
    """The second vibration mode of the link, as a log shows it in the torque.

        Γ/(c θm) gains the term  gain · s²/(s² + 2 ζ ω₂ s + ω₂²)

    Parameters
    ----------
    frequency
        ω₂ [rad/s], > 0.
    gain
        the mode's share of Γ/(c θm) far above ω₂ [1], > 0: the gauge sits at the root,
        where every mode pulls with the same sign.
    damping_ratio
        ζ [1], 0 < ζ < 1.

    Raises
    ------
    FieldError
        a value out of its range.

    Examples
    --------
    >>> mode = SecondMode(frequency=180.0, gain=0.05, damping_ratio=0.02)
    >>> round(abs(complex(mode.response(180.0j))), 3)
    1.25
    """

    frequency: Annotated[
        float,
        above(0.0, 1e6, "rad/s", remedy="give mode 2's frequency"),
    ]
    gain: Annotated[
        float,
        above(0.0, 1e3, remedy="give its share in Γ/(c θm)"),
    ]
    damping_ratio: Annotated[
        float,
        above(
            0.0,
            1.0,
            "(ζ)",
            high_open=True,
            remedy="give ζ, 0.02 where it is not known",
        ),
    ] = 0.02

    def about(self, count: int) -> Real:
        """Return `count` frequencies about the mode [rad/s], close within its width and
        wider apart to either side.
        """
        # At least eight half-widths: there the mode is down to an eighth of its peak. A
        # sharp peak is high, and its Nyquist circle passes -1 far from the mode.
        reach = math.asinh(max(8.0, 0.2 / self.damping_ratio))
        shape = self.damping_ratio * np.sinh(np.linspace(-reach, reach, count))
        return self.frequency * np.exp(shape)

    def response(self, s: ArrayLike) -> Complex:
        """Return ``gain s²/(s² + 2 ζ ω₂ s + ω₂²)`` at complex `s` [rad/s], shape kept."""
        x = np.asarray(s, np.complex128) / self.frequency
        return self.gain * x**2 / self.denominator(s)

    def denominator(self, s: ArrayLike) -> Complex:
        """Return ``1 + 2 ζ s/ω₂ + s²/ω₂²`` at complex `s` [rad/s], shape kept."""
        x = np.asarray(s, np.complex128) / self.frequency
        return x**2 + 2.0 * self.damping_ratio * x + 1.0


@document("model", version=2)
@checked
@dataclass(frozen=True)
class LinkModel:
    """A flexible link with a payload, seen from the motor angle, and the gauge that
    measures its torque.

        Γ/θm = c s^λ / (s^λ + μ s^α + ω₀²),    θt/θm = (μ s^α + ω₀²) / (s^λ + μ s^α + ω₀²)

    The controller reads the torque as ``g e^(−τ_g s) Γ``, with the second mode added
    where one is known.

    Parameters
    ----------
    stiffness
        c > 0 [N·m/rad].
    natural_frequency
        ω₀ ≥ 0 [s^(-λ/2)]; it is rad/s only for λ = 2, and may be 0 only where μ > 0.
    order
        λ in [1, 2], the order of the inertia.
    damping
        μ ≥ 0 [s^(α-λ)].
    damping_order
        α in (0, 2); without damping it plays no part.
    payload
        m > 0 [kg] at which ω₀ was found, or None where it is not known.
    gauge_delay
        τ_g [s], −10 to 10: the torque signal lags the motor angle by it; below zero it
        leads.
    gauge_gain
        g [1], not 0: measured over true torque.
    second_mode
        the second vibration mode, or None where none is known.
    unseen_up_to
        frequency [rad/s] up to which the log showed no second mode, or None where it
        was not examined.
    intervals
        (name, low, high) of each identified parameter's 95 % interval, in the unit of
        the parameter.

    Raises
    ------
    FieldError
        a value out of its range.

    References
    ----------
    Benftima et al. (2023), equations (6), (10), (15), (16).

    Examples
    --------
    >>> link = LinkModel(stiffness=1.56, natural_frequency=10.02, order=1.92)
    >>> link.structure, round(link.damping_ratio, 4)
    ('UD-FOM', 0.0654)
    """

    __made_by__ = "fit.model, or rig.model"

    stiffness: Annotated[
        float,
        above(0.0, unit="N·m/rad", remedy="give the torque for one radian"),
    ]
    natural_frequency: Annotated[
        float, Between(0.0, 1e6, "s^(-λ/2)", remedy="give ω₀ = sqrt(c/(m L²))")
    ]
    order: Annotated[
        float, Between(1.0, 2.0, "(λ)", remedy="give λ, 2 for a classical link")
    ] = 2.0
    damping: Annotated[float, Between(0.0, remedy="give μ, 0 for an undamped link")] = (
        0.0
    )
    damping_order: Annotated[
        float,
        above(
            0.0,
            2.0,
            "(α)",
            high_open=True,
            remedy="give α, 1 for viscous damping",
        ),
    ] = 1.0
    payload: Mass | None = None
    gauge_delay: Annotated[
        float, Between(-10.0, 10.0, "s", remedy="give the delay in seconds")
    ] = 0.0
    gauge_gain: Annotated[
        float,
        Between(-1e6, 1e6),
        Where(bool, "not 0", remedy="give measured over true torque"),
    ] = 1.0
    second_mode: SecondMode | None = None
    unseen_up_to: (
        Annotated[
            float,
            above(
                0.0,
                unit="rad/s",
                remedy="leave it out where it is not known",
            ),
        ]
        | None
    ) = None
    intervals: tuple[tuple[str, float, float], ...] = ()

    def __post_init__(self) -> None:
        if self.natural_frequency == 0 and (
            self.damping == 0 or self.damping_order >= self.order
        ):
            raise FieldError(
                "natural_frequency",
                0.0,
                "zero without a damping of lower order than the inertia",
                "> 0",
                "give ω₀ = sqrt(c/(m L²))",
            )

    def interval(self, name: str) -> tuple[float, float] | None:
        """Return the identified 95 % interval (low, high) of parameter `name`, None
        where there is none.

        >>> link = LinkModel(1.56, 10.0, order=1.92, intervals=(("order", 1.91, 1.93),))
        >>> link.interval("order"), link.interval("damping")
        ((1.91, 1.93), None)
        """
        return next(
            ((low, high) for field, low, high in self.intervals if field == name), None
        )

    @property
    def structure(self) -> str:
        """The paper's name of the structure: "UD-IOM", "D-IOM", "UD-FOM" or "D-FOM".

        A model with both λ < 2 and μ > 0 obeys the one formula but is none of the four:
        "general".
        """
        free = {_FREQUENCY}
        free |= {"order"} if self.order != 2 else set()
        free |= {"damping"} if self.damping else set()
        free |= {"damping_order"} if self.damping and self.damping_order != 1 else set()
        return next(
            (row.name for row in STRUCTURES.values() if set(row.free) == free),
            "general",
        )

    def tip(self) -> FractionalTransferFunction:
        """Return θt/θm = (μ s^α + ω₀²)/(s^λ + μ s^α + ω₀²) [rad/rad], the paper's (4)
        and (9).

        >>> abs(LinkModel(1.56, 10.0, order=1.9).tip()(0.001j)).__round__(6)
        1.0
        """
        return self._restoring / (s**self.order + self._restoring)

    def torque(self) -> FractionalTransferFunction:
        """Return Γ/θm = c s^λ/(s^λ + μ s^α + ω₀²) [N·m/rad], the paper's (6), (10),
        (15), (16).

        >>> abs(LinkModel(1.56, 10.0, order=1.9).torque()(1e6j)).__round__(4)
        1.56
        """
        return self.stiffness * s**self.order / (s**self.order + self._restoring)

    def lead(self, frequency: ArrayLike) -> Complex:
        """Return (1/G − 1)/s² = s^(λ−2)/(μ s^α + ω₀²) at s = jω, ω = `frequency`
        [rad/s]: by how much the motor leads the tip, per acceleration of the tip [s²].

        >>> abs(LinkModel(1.56, 10.0).lead(3.0)).item().__round__(6)
        0.01
        """
        s = 1j * np.asarray(frequency)
        return (1 / self.tip()(s) - 1) / s**2

    @property
    def _restoring(self) -> FractionalTransferFunction:
        """μ s^α + ω₀²."""
        return self.damping * s**self.damping_order + self.natural_frequency**2

    @property
    def pole(self) -> complex:
        """The vibration pole with positive imaginary part [rad/s], root of s^λ + μ s^α
        + ω₀² = 0.

        Without damping exactly ω₀^(2/λ) e^(jπ/λ). With damping it is found by Newton's
        method in ln s, which ends on the negative real axis for an overdamped link (at a
        pole only for λ = 2, α = 1, otherwise at a time scale).
        """
        if self.damping == 0:
            return cmath.rect(
                self.natural_frequency ** (2 / self.order), math.pi / self.order
            )
        return _damped_pole(
            self.order, self.damping, self.damping_order, self.natural_frequency**2
        )

    @property
    def resonance(self) -> float:
        """|p| of the vibration pole [rad/s]."""
        return abs(self.pole)

    @property
    def vibration_period(self) -> float:
        """Period of the vibration [s]; 2π over the decay rate of a link that decays
        faster than it swings.
        """
        return math.tau / max(self.pole.imag, -self.pole.real)

    @property
    def gauge_lag(self) -> float:
        """The delay of the gauge itself [s]: 0 if the model's gauge leads, since then it
        is the motor angle that is late.
        """
        return max(self.gauge_delay, 0.0)

    @property
    def loss(self) -> float:
        """η = μ/ω₀² [s^α]: a property of the material, the same for every payload.

        >>> LinkModel(1.56, 10.0, damping=0.4).loss
        0.004
        """
        if self.natural_frequency == 0:
            raise FieldError(
                "natural_frequency",
                0.0,
                "zero: the link is a springpot without a spring",
                "> 0",
                "state the same link by λ = 2 − α and ω₀ = √μ, without damping",
            )
        return self.damping / self.natural_frequency**2

    @property
    def damping_ratio(self) -> float:
        """ζ = −Re(p)/|p| of the vibration pole [1]; for UD-FOM −cos(π/λ), the same for
        every payload.
        """
        return 0.0 if self.structure == "UD-IOM" else -self.pole.real / self.resonance

    @property
    def oscillates(self) -> bool:
        """Whether the pole is that of a vibration: not real within rounding errors."""
        return abs(self.pole.imag) > 1e-9 * self.resonance

    @property
    def sentence(self) -> str:
        """The link in words, as seen with its motor held.

        >>> LinkModel(stiffness=1.56, natural_frequency=11.094, order=1.92, payload=0.03).sentence
        'swings at 12.24 rad/s (1.95 Hz) with 30 g, 6.5 % damping'
        """
        rate = abs(self.pole.imag)
        swing = "does not oscillate: it creeps back"
        if self.oscillates:
            swing = f"swings at {number(rate)} rad/s ({quantity(rate, 'Hz', 3)})"
            swing += (
                "" if self.payload is None else f" with {quantity(self.payload, 'g')}"
            )
            swing += f", {number(100 * self.damping_ratio, 2)} % damping"
        parts = [swing]
        if self.second_mode is not None:
            rate = self.second_mode.frequency
            parts.append(
                f"a second mode at {number(rate)} rad/s ({quantity(rate, 'Hz', 3)})"
            )
        # Less than a microsecond is the rounding of a fit: no log shows it.
        if abs(self.gauge_delay) > 1e-6:
            side = "late" if self.gauge_delay > 0 else "early"
            parts.append(f"gauge {quantity(abs(self.gauge_delay), 'ms', 2)} {side}")
        return "; ".join(parts)

    @checked
    def at_payload(self, payload: Mass) -> LinkModel:
        """Return the model at another `payload` [kg > 0]: ω₀ scales by sqrt(m/payload),
        eq. (5), and μ by m/payload, since the material stays the same.

        The paper's Table 3 keeps μ constant: its damped structures would need a
        material that damps more under a heavier payload. Needs a known `payload`.

        >>> LinkModel(1.56, 10.0, order=1.92, payload=0.03).at_payload(0.12).natural_frequency
        5.0
        """
        return self.with_mass(payload / self.known_payload, payload=payload)

    def with_mass(self, ratio: float, **others: Any) -> LinkModel:
        """Return the link with `ratio` times its mass, and other fields as given. The
        damping is the material's: D(s) = 1 + (μ/ω₀²) s^α is the same for every mass.

        >>> LinkModel(1.56, 10.0, damping=0.4).with_mass(4.0).damping
        0.1
        """
        scales = {_FREQUENCY: 1.0 / math.sqrt(ratio), "damping": 1.0 / ratio}
        intervals = tuple(
            (name, low * scales.get(name, 1.0), high * scales.get(name, 1.0))
            for name, low, high in self.intervals
        )
        own = {name: scale * getattr(self, name) for name, scale in scales.items()}
        return replace(self, intervals=intervals, **own, **others)

    def payload_at(self, natural_frequency: float) -> float:
        """Return the payload [kg] at which the link has this ω₀ [s^(-λ/2)], the inverse
        of `at_payload`.

        >>> LinkModel(1.56, 10.0, order=1.92, payload=0.03).payload_at(5.0)
        0.12
        """
        return self.known_payload * (self.natural_frequency / natural_frequency) ** 2

    @property
    def known_payload(self) -> float:
        """The payload [kg]; FieldError where it is not known."""
        if self.payload is None:
            raise FieldError(
                "payload",
                None,
                "not known",
                "> 0 kg",
                "make the model with the payload at which its frequency was found",
            )
        return self.payload


def _damped_pole(
    order: float, damping: float, damping_order: float, square: float
) -> complex:
    """Newton's method on z ↦ e^{λz} + μ e^{αz} + ω₀², z = ln s, with continuation in μ
    from 0 to its value.
    """
    alone = (
        damping ** (1 / (order - damping_order))
        if order > damping_order and square == 0
        else 0.0
    )
    if alone:
        return cmath.rect(alone, min(math.pi / (order - damping_order), math.pi))
    z = complex(math.log(square) / order, math.pi / order)
    for share in (0.01, 0.03, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.0):
        for _ in range(12):
            moving, friction = (
                cmath.exp(order * z),
                share * damping * cmath.exp(damping_order * z),
            )
            step = (moving + friction + square) / (
                order * moving + damping_order * friction
            )
            z -= step if abs(step) < 0.5 else 0.5 * step / abs(step)
            z = complex(z.real, min(max(z.imag, 0.0), math.pi))
            if abs(step) < 1e-15:
                break
    return cmath.exp(z)
