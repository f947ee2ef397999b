"""The outer controller of the tip: ``C(s) = 1 + k_d s^β / (1 + δ s)^n`` (eq. (57))."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from fraclink._arm.link import LinkModel
from fraclink._arm.motor_loop import MotorLoop
from fraclink._arm.notch import Notch
from fraclink._arm.reference import Path
from fraclink._arm.rig_parts import positive
from fraclink._files import document
from fracsys._fractional import FractionalTransferFunction, s
from fracsys._margins import Margins
from fracsys.checks import Between, Complex, Period, above, checked

__all__ = ["Controller"]


# Registered here, as the classes themselves must not depend on the file format.
document("margins")(Margins)
document("reference")(Path)


@checked
@dataclass(frozen=True)
class Controller:
    """The fractional outer controller and what it was designed for.

    ``C(s) = 1 + Ĉ(s)``, ``Ĉ(s) = k_d s^β / (1 + δ s)^n`` (eqs. (28), (56), (57)).
    ``C(0) = 1`` removes the gauge's offset from the tip (eq. (27)). Where the loop gain
    at the link's second mode would be too high, a `Notch` N(s) is a factor of Ĉ.

    Parameters
    ----------
    derivative_gain
        k_d [s^β], > 0.
    derivative_order
        β, 0 < β < 2.
    filter_time
        δ [s], >= 0; zero means no filter.
    filter_order
        n, 1 or 2. The noise condition (32) asks for n > β.
    link
        nominal link model, used for the feed-forward ``s^λ/ω₀²`` (corrected eq. (22)).
    motor_loop
        the motor loop the controller was designed for.
    period
        control period [s] it was designed for.
    notch
        N(s), or None.

    Raises
    ------
    FieldError
        a value out of its range.

    Examples
    --------
    >>> from fraclink._arm.controller import Controller
    >>> controller = Controller(derivative_gain=0.215299, derivative_order=0.655361)
    >>> print(f"{abs(controller.response(16.0)):.5f}")
    1.32488
    """

    derivative_gain: Annotated[float, positive("s^β")]
    derivative_order: Annotated[
        float,
        above(
            0.0,
            2.0,
            "(β)",
            high_open=True,
            remedy="lower the derivative's order",
        ),
    ]
    filter_time: Annotated[float, Between(0.0, 1e6, "s")] = 0.0
    # A third pole would cost more phase at the crossover than it saves in noise: n = 1
    # for β < 1, else 2.
    filter_order: Annotated[int, Between(1, 2, remedy="n = 1 for β < 1, else 2")] = 1
    link: LinkModel | None = None
    motor_loop: MotorLoop | None = None
    period: Period | None = None
    notch: Notch | None = None

    @property
    def formula(self) -> str:
        """C(s) as text, numbers to five digits.

        >>> from fraclink._arm.controller import Controller
        >>> Controller(derivative_gain=0.148, derivative_order=0.65, filter_time=0.16, filter_order=2).formula
        'C(s) = 1 + 0.148 s^0.65 / (1 + 0.16 s)^2'
        """
        text = f"C(s) = 1 + {self.derivative_gain:.5g} s^{self.derivative_order:.5g}"
        if self.filter_time:
            text += f" / (1 + {self.filter_time:.5g} s)" + (
                "" if self.filter_order == 1 else "^2"
            )
        if self.notch is not None:
            text += (
                f", notch at {self.notch.frequency:.5g} rad/s, "
                f"ζ {self.notch.zeros:.3g} over {self.notch.poles:.3g}"
            )
        return text

    @property
    def is_strictly_proper(self) -> bool:
        """Whether Ĉ(jω) → 0 for ω → ∞, the high-frequency noise condition (32)."""
        return self.filter_time > 0.0 and self.filter_order > self.derivative_order

    def response(self, frequency: ArrayLike) -> Complex:
        """Return Ĉ(jω) (eq. (57) without its 1) at real `frequency` [rad/s] > 0, shape
        kept.

        >>> from fraclink._arm.controller import Controller
        >>> complex(Controller(derivative_gain=2.0, derivative_order=1.0).response(3.0)).imag
        6.0
        """
        w = np.asarray(frequency, float)
        # k ω^β e^{jπβ/2}: a power with a real base, so that no branch has to be chosen.
        derivative = (
            self.derivative_gain
            * np.power(w, self.derivative_order)
            * np.exp(0.5j * np.pi * self.derivative_order)
        )
        value = derivative / (1.0 + 1j * self.filter_time * w) ** self.filter_order
        if self.notch is not None:
            value = value * np.exp(self.notch.log(w))
        return value

    def correction(self) -> FractionalTransferFunction:
        """Return ``Ĉ(s) = k_d s^β/(1 + δ s)^n`` as a fractional transfer function (eq.
        (57)), with its notch.
        """
        value = (
            self.derivative_gain
            * s**self.derivative_order
            / (1.0 + self.filter_time * s) ** self.filter_order
        )
        return value if self.notch is None else value * self.notch.transfer()

    def transfer(self) -> FractionalTransferFunction:
        """Return ``C(s) = 1 + Ĉ(s)`` as a fractional transfer function (eq. (57))."""
        return 1.0 + self.correction()
