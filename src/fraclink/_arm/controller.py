"""The outer controller of the tip: ``C(s) = 1 + k_d s^β / (1 + δ s)^n`` (eq. (57)), and a lead."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fraclink._arm.link import LinkModel
from fraclink._arm.motor_loop import MotorLoop
from fraclink._validate import checked_between, checked_noun, is_whole
from fraclink.errors import FieldError

if TYPE_CHECKING:
    from fraclink._law import Law
    from fraclink._law.block import Precision
    from fraclink._systems.fractional import FractionalTransferFunction

__all__ = ["Controller", "Lead"]

_LARGEST = 1e12  # gains and times beyond it are slips of the pen; squaring them must not overflow


@dataclass(frozen=True)
class Lead:
    """A fractional lead ``(1 + (a s)^ν)/(1 + (b s)^ν)``; with a < b it is a lag, an integrator that ends.

    It is one at s = 0. Behind s^β it leaves ``C(0) = 1``, and with it the rejection of the gauge's offset,
    as it was; a pure integrator k_i s^-α would take it away.

    Parameters
    ----------
    zero_time
        a [s], > 0.
    pole_time
        b [s], > 0.
    order
        ν, 0 < ν <= 1: no pole on the principal sheet but -1/b for ν = 1.

    Examples
    --------
    >>> from fraclink._arm.controller import Lead
    >>> lead = Lead(zero_time=0.18, pole_time=0.045, order=0.5)
    >>> print(f"{abs(lead.response(1e-9)):.3f} {abs(lead.response(1e9)):.3f}")
    1.000 2.000
    """

    zero_time: float
    pole_time: float
    order: float

    def __post_init__(self) -> None:
        for field, high, unit in (("zero_time", 1e6, "s"), ("pole_time", 1e6, "s"), ("order", 1.0, "")):
            value = checked_between(f"lead.{field}", getattr(self, field), 0.0, high, unit, open_low=True)
            object.__setattr__(self, field, value)

    def log(self, frequency: ArrayLike) -> NDArray[np.complex128]:
        """Return its logarithm at real `frequency` [rad/s] > 0; the phase is continuous, as ν <= 1."""
        turned = np.exp(self.order * (np.log(np.asarray(frequency, dtype=float)) + 0.5j * np.pi))
        up, down = (np.log1p(time**self.order * turned) for time in (self.zero_time, self.pole_time))
        return np.asarray(up - down, dtype=np.complex128)

    def response(self, frequency: ArrayLike) -> NDArray[np.complex128]:
        """Return its value at jω, real `frequency` [rad/s] > 0, shape kept."""
        return np.asarray(np.exp(self.log(frequency)), dtype=np.complex128)

    def at(self, s: ArrayLike) -> NDArray[np.complex128]:
        """Return its value at complex `s` [rad/s] with |arg s| < π, shape kept."""
        power = np.exp(self.order * np.log(np.asarray(s, dtype=np.complex128)))
        up, down = (1.0 + time**self.order * power for time in (self.zero_time, self.pole_time))
        return np.asarray(up / down, dtype=np.complex128)

    def transfer(self) -> FractionalTransferFunction:
        """Return it as a fractional transfer function."""
        from fraclink._systems.fractional import s

        power = s**self.order
        up, down = (math.pow(time, self.order) for time in (self.zero_time, self.pole_time))
        return (1.0 + up * power) / (1.0 + down * power)


@dataclass(frozen=True)
class Controller:
    """The fractional outer controller and what it was designed for.

    ``C(s) = 1 + Ĉ(s)``, ``Ĉ(s) = k_d s^β / (1 + δ s)^n`` (eqs. (28), (56), (57)), times its `Lead`.
    ``C(0) = 1`` removes the gauge's offset from the tip (eq. (27)).

    Parameters
    ----------
    gain
        k_d [s^β], > 0.
    order
        β, 0 < β < 2.
    filter_time
        δ [s], >= 0; zero means no filter.
    filter_order
        n, 1 or 2. The noise condition (32) asks for n > β.
    link
        nominal link model, used for the feed-forward ``s^λ/ω₀²`` (corrected eq. (22)).
    inner
        the inner loop the controller was designed for.
    period
        control period [s] it was designed for.
    lead
        the lead that `optimise` may add; none in the paper's structure.

    Raises
    ------
    FieldError
        a value out of its range.

    Examples
    --------
    >>> from fraclink._arm.controller import Controller
    >>> controller = Controller(gain=0.215299, order=0.655361)
    >>> print(f"{abs(controller.response(16.0)):.5f}")
    1.32488
    """

    gain: float
    order: float
    filter_time: float = 0.0
    filter_order: int = 1
    link: LinkModel | None = None
    inner: MotorLoop | None = None
    period: float | None = None
    lead: Lead | None = None

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        set_(self, "gain", checked_between("gain", self.gain, 0.0, _LARGEST, "s^β", open_low=True))
        order = checked_between("order", self.order, 0.0, 2.0, "", open_low=True)
        if order >= 2.0:
            raise FieldError(
                "order", order, "out of range", allowed="> 0 and < 2", remedy="lower the derivative's order"
            )
        set_(self, "order", order)
        set_(self, "filter_time", checked_between("filter_time", self.filter_time, 0.0, 1e6, "s"))
        if not is_whole(self.filter_order, 1, 2):
            raise FieldError(
                "filter_order",
                self.filter_order,
                "not 1 or 2",
                allowed="1 or 2",
                remedy="n = 1 for β < 1, else 2",
            )
        for field, kind, remedy in (
            ("link", LinkModel, "fit.model, or rig.model"),
            ("inner", MotorLoop, "MotorLoop(pole=80.0)"),
            ("lead", Lead, "Lead(zero_time, pole_time, order), or leave it out"),
        ):
            if getattr(self, field) is not None:
                checked_noun(field, getattr(self, field), kind, remedy=remedy)
        if self.period is not None:
            set_(self, "period", checked_between("period", self.period, 0.0, 10.0, "s", open_low=True))

    @property
    def formula(self) -> str:
        """C(s) as text, numbers to five digits.

        >>> from fraclink._arm.controller import Controller
        >>> Controller(gain=0.148, order=0.65, filter_time=0.16, filter_order=2).formula
        'C(s) = 1 + 0.148 s^0.65 / (1 + 0.16 s)^2'
        """
        text = f"C(s) = 1 + {self.gain:.5g} s^{self.order:.5g}"
        if self.filter_time:
            text += f" / (1 + {self.filter_time:.5g} s)" + ("" if self.filter_order == 1 else "^2")
        if self.lead is None:
            return text
        up, down = (
            f"(1 + ({time:.5g} s)^{self.lead.order:.5g})"
            for time in (self.lead.zero_time, self.lead.pole_time)
        )
        return f"{text} · {up}/{down}"

    @property
    def is_strictly_proper(self) -> bool:
        """Whether Ĉ(jω) → 0 for ω → ∞, the high-frequency noise condition (32)."""
        return self.filter_time > 0.0 and self.filter_order > self.order

    def response(self, frequency: ArrayLike) -> NDArray[np.complex128]:
        """Return Ĉ(jω) (eq. (57) without its 1) at real `frequency` [rad/s] > 0, shape kept.

        >>> from fraclink._arm.controller import Controller
        >>> complex(Controller(gain=2.0, order=1.0).response(3.0)).imag
        6.0
        """
        w = np.asarray(frequency, dtype=float)
        # k ω^β e^{jπβ/2}: the power of a real base, so that no branch has to be chosen.
        derivative = self.gain * np.power(w, self.order) * np.exp(0.5j * np.pi * self.order)
        value = derivative / (1.0 + 1j * self.filter_time * w) ** self.filter_order
        return np.asarray(value if self.lead is None else value * self.lead.response(w), dtype=np.complex128)

    def correction(self) -> FractionalTransferFunction:
        """Return ``Ĉ(s) = k_d s^β/(1 + δ s)^n`` as a fractional transfer function (eq. (57))."""
        from fraclink._systems.fractional import s

        plain = self.gain * s**self.order / (1.0 + self.filter_time * s) ** self.filter_order
        return plain if self.lead is None else plain * self.lead.transfer()

    def transfer(self) -> FractionalTransferFunction:
        """Return ``C(s) = 1 + Ĉ(s)`` as a fractional transfer function (eq. (57))."""
        return 1.0 + self.correction()

    def discretize(
        self, period: float | None = None, *, order: int | None = None, precision: Precision = "double"
    ) -> Law:
        """Return the law that runs at `period` [s]: the same coefficients are simulated and exported.

        Parameters
        ----------
        period
            control period [s]; the design's own when it is left out.
        order
            states of Ĉ; chosen to meet 0.1 dB and 0.5° when it is left out.
        precision
            "double" or "single".
        """
        from fraclink._law import discretize_controller

        chosen = (
            self.period
            if period is None
            else checked_between("period", period, 0.0, 10.0, "s", open_low=True)
        )
        if chosen is None:
            raise FieldError(
                "period", None, "missing", allowed="> 0 s", remedy="give the control period in seconds"
            )
        return discretize_controller(self, chosen, order=order, precision=precision)

    def without_filter(self) -> Controller:
        """Return the same controller with δ = 0 (eq. (56)).

        >>> from fraclink._arm.controller import Controller
        >>> Controller(gain=1.0, order=0.5, filter_time=0.1).without_filter().filter_time
        0.0
        """
        return replace(self, filter_time=0.0)
