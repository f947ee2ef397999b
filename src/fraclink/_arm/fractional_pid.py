"""The fractional PID controller: ``C(s) = k_p + k_i/s^λ + k_d s^μ/(1 + T_f s)^n``
(Podlubny 1999).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from fraclink._files import Saved, document
from fraclink.errors import FieldError
from fracsys._fractional import FractionalTransferFunction, s
from fracsys.checks import Between, Complex, above, checked

__all__ = ["FractionalPid"]

_ONE_SIGN = (
    "write a plant of negative gain as -plant, and negate the controller's output"
)
Gain = Annotated[float, Between(0.0, 1e12, remedy=_ONE_SIGN)]
PidOrder = Annotated[float, above(0.0, 2.0, high_open=True)]


@document("fractional-pid", summary=lambda made: {"formula": made.formula})
@checked
@dataclass(frozen=True)
class FractionalPid(Saved):
    """A PI^λD^μ controller that acts on an error: ``C(s) = k_p + k_i/s^λ + k_d s^μ/(1 + T_f
    s)^n``.

    n is 1 for μ ≤ 1 and 2 above it, the least that keeps C proper; λ = μ = 1 is the
    textbook PID.

    Parameters
    ----------
    proportional
        k_p, >= 0, in units of the output over those of the error.
    integral, derivative
        k_i and k_d, >= 0, in these units times seconds^(-λ) and seconds^μ; 0 leaves a
        part out.
    integral_order, derivative_order
        λ and μ, > 0 and < 2.
    filter_time
        T_f of the derivative [s], >= 0; zero means no filter.

    Raises
    ------
    FieldError
        a value out of its range, or all gains zero.

    Source: Podlubny, IEEE Trans. Automatic Control 44 (1999) 208–214.

    Examples
    --------
    >>> import fraclink as fl
    >>> pid = fl.extend.FractionalPid(2.0, integral=3.0, integral_order=0.8, derivative=0.5, derivative_order=1.2,
    ...                        filter_time=0.01)
    >>> pid.formula
    'C(s) = 2 + 3/s^0.8 + 0.5 s^1.2/(1 + 0.01 s)^2'
    >>> bool(abs(pid.transfer()(5j) - pid.response(5.0)) < 1e-12)
    True
    """

    proportional: Gain
    integral: Gain = 0.0
    integral_order: PidOrder = 1.0
    derivative: Gain = 0.0
    derivative_order: PidOrder = 1.0
    filter_time: Annotated[float, Between(0.0, 1e6, "s")] = 0.0

    def __post_init__(self) -> None:
        # Zero gains leave their orders undetermined, and a loop without a controller
        # has no margins.
        if not (self.proportional or self.integral or self.derivative):
            raise FieldError(
                "proportional",
                0.0,
                "zero like the other gains",
                "> 0",
                "give at least one gain above 0",
            )

    @property
    def filter_order(self) -> int:
        """n of the derivative's filter: the least for which the controller is proper."""
        # s^μ/(1 + T_f s)^n does not rise for n >= μ; one more pole would cost a phase
        # of ω_c T_f for nothing.
        return math.ceil(self.derivative_order)

    @property
    def formula(self) -> str:
        """C(s) as text, numbers to five digits."""
        parts = [f"{self.proportional:.5g}"] if self.proportional else []
        if self.integral:
            parts.append(f"{self.integral:.5g}/s{_exponent(self.integral_order)}")
        if self.derivative:
            part = f"{self.derivative:.5g} s{_exponent(self.derivative_order)}"
            if self.filter_time:
                part += f"/(1 + {self.filter_time:.5g} s)" + (
                    "" if self.filter_order == 1 else "^2"
                )
            parts.append(part)
        return "C(s) = " + " + ".join(parts)

    def response(self, frequency: ArrayLike) -> Complex:
        """Return C(jω) at real `frequency` [rad/s] > 0, shape kept."""
        return self.transfer()(1j * np.asarray(frequency, float))

    def transfer(self) -> FractionalTransferFunction:
        """Return C(s) as a fractional transfer function, as the rest of the package
        takes it.
        """
        # Adding 0·s^0 makes the sum a transfer function even if there is only k_p.
        whole = self.proportional + s**0 * 0.0
        if self.integral:
            whole = whole + self.integral / s**self.integral_order
        if self.derivative:
            lag = (1.0 + self.filter_time * s) ** (
                self.filter_order if self.filter_time else 0
            )
            whole = whole + self.derivative * s**self.derivative_order / lag
        return whole


def _exponent(order: float) -> str:
    return "" if order == 1.0 else f"^{order:.5g}"
