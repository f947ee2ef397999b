"""The outer controller of the tip: ``C(s) = 1 + k_d s^β / (1 + δ s)^n`` (eq. (57))."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fraclink._arm.link import LinkModel
from fraclink._arm.motor_loop import MotorLoop
from fraclink._arm.notch import Notch
from fraclink._arm.reference import Path
from fraclink._files import document
from fraclink.errors import FieldError
from fracsys._fractional import FractionalTransferFunction, s
from fracsys._margins import Margins
from fracsys._stability import poles
from fracsys.checks import checked_between, checked_noun, is_whole

__all__ = ["Controller", "closed_loop", "closed_loop_poles"]

# gains and times beyond it are slips of the pen; squaring them must not overflow
_LARGEST = 1e12

document("margins")(
    Margins
)  # here and not beside the class: systems stand below the codec
document("reference")(
    Path
)  # and a reference is needed where mypy has not seen the codec yet


@dataclass(frozen=True)
class Controller:
    """The fractional outer controller and what it was designed for.

    ``C(s) = 1 + Ĉ(s)``, ``Ĉ(s) = k_d s^β / (1 + δ s)^n`` (eqs. (28), (56), (57)).
    ``C(0) = 1`` removes the gauge's offset from the tip (eq. (27)). Where the link's
    second mode would sound, a `Notch` N(s) is a factor of Ĉ.

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
    notch
        N(s), or None.

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
    notch: Notch | None = None

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        set_(
            self,
            "gain",
            checked_between("gain", self.gain, 0.0, _LARGEST, "s^β", open_low=True),
        )
        order = checked_between("order", self.order, 0.0, 2.0, "", open_low=True)
        if order >= 2.0:
            raise FieldError(
                "order",
                order,
                "out of range",
                allowed="> 0 and < 2",
                remedy="lower the derivative's order",
            )
        set_(self, "order", order)
        set_(
            self,
            "filter_time",
            checked_between("filter_time", self.filter_time, 0.0, 1e6, "s"),
        )
        # A third pole would cost more phase at the crossover than it takes off the
        # noise behind the two.
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
            ("notch", Notch, "Notch(frequency=170.0, zeros=0.02, poles=0.4)"),
        ):
            if getattr(self, field) is not None:
                checked_noun(field, getattr(self, field), kind, remedy=remedy)
        if self.period is not None:
            set_(
                self,
                "period",
                checked_between("period", self.period, 0.0, 10.0, "s", open_low=True),
            )

    @property
    def formula(self) -> str:
        """C(s) as text, numbers to five digits.

        >>> from fraclink._arm.controller import Controller
        >>> Controller(gain=0.148, order=0.65, filter_time=0.16, filter_order=2).formula
        'C(s) = 1 + 0.148 s^0.65 / (1 + 0.16 s)^2'
        """
        text = f"C(s) = 1 + {self.gain:.5g} s^{self.order:.5g}"
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
        return self.filter_time > 0.0 and self.filter_order > self.order

    def response(self, frequency: ArrayLike) -> NDArray[np.complex128]:
        """Return Ĉ(jω) (eq. (57) without its 1) at real `frequency` [rad/s] > 0, shape
        kept.

        >>> from fraclink._arm.controller import Controller
        >>> complex(Controller(gain=2.0, order=1.0).response(3.0)).imag
        6.0
        """
        w = np.asarray(frequency, dtype=float)
        # k ω^β e^{jπβ/2}: the power of a real base, so that no branch has to be chosen.
        derivative = (
            self.gain * np.power(w, self.order) * np.exp(0.5j * np.pi * self.order)
        )
        value = derivative / (1.0 + 1j * self.filter_time * w) ** self.filter_order
        if self.notch is not None:
            value = value * np.exp(self.notch.log(w))
        return np.asarray(value, dtype=np.complex128)

    def correction(self) -> FractionalTransferFunction:
        """Return ``Ĉ(s) = k_d s^β/(1 + δ s)^n`` as a fractional transfer function (eq.
        (57)), with its notch.
        """
        value = (
            self.gain
            * s**self.order
            / (1.0 + self.filter_time * s) ** self.filter_order
        )
        return value if self.notch is None else value * self.notch.transfer()

    def transfer(self) -> FractionalTransferFunction:
        """Return ``C(s) = 1 + Ĉ(s)`` as a fractional transfer function (eq. (57))."""
        return 1.0 + self.correction()

    def without_filter(self) -> Controller:
        """Return the same controller with δ = 0 (eq. (56)).

        >>> from fraclink._arm.controller import Controller
        >>> Controller(gain=1.0, order=0.5, filter_time=0.1).without_filter().filter_time
        0.0
        """
        return replace(self, filter_time=0.0)


def closed_loop(
    controller: Controller, link: LinkModel, *, inner_pole: float | None = None
) -> FractionalTransferFunction:
    """Return ``T = L/(1 + L)``, ``L = Ĉ M G`` (eq. (25)); M = 1 without `inner_pole`
    [rad/s].

    Hold and delay are left out: with them the loop has infinitely many poles.
    """
    # G and not the gauge's B: a late gauge, like hold and delay, has infinitely many
    # poles.
    open_loop = controller.correction() * link.tip()
    if inner_pole is not None:
        open_loop = open_loop / (1.0 + s / inner_pole) ** 2
    return open_loop.feedback()


def closed_loop_poles(
    controller: Controller, link: LinkModel, *, inner_pole: float | None = None
) -> NDArray[np.complex128]:
    """Return the poles of the closed loop on the principal sheet, rightmost first
    [rad/s].

    Examples
    --------
    The paper's controller (58) on the paper's link at 30 g, with its motor loop, is
    unstable:

    >>> link = LinkModel(stiffness=1.56, natural_frequency=11.547, order=1.92)
    >>> controller = Controller(gain=0.148, order=0.65, filter_time=0.16, filter_order=2)
    >>> pole = closed_loop_poles(controller, link, inner_pole=80.0)[0]
    >>> print(f"{pole.real:+.3f} ± {abs(pole.imag):.2f}j")
    +0.106 ± 12.89j
    """
    found = poles(closed_loop(controller, link, inner_pole=inner_pole))
    return np.asarray(found[np.argsort(-found.real)], dtype=np.complex128)
