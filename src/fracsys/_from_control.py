"""Systems of python-control as fractional ones, sampled ones too.

python-control is imported at the first call and not before (it costs seconds).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import logm
from scipy.signal import ss2tf, tf2ss

from fracsys._fractional import FractionalTransferFunction
from fracsys._terms import Term
from fracsys.errors import FieldError

Reals = NDArray[np.float64]


def from_control(system: Any) -> FractionalTransferFunction:
    """Return a python-control system as a fractional transfer function with integer
    orders.

    Parameters
    ----------
    system
        One input, one output. Of a sampled one the result is the continuous system
        whose answer to an input that is held over each period is the same at every
        sample; poles at z = 0 become a delay.

    Raises
    ------
    FieldError
        More than one input or output, data without a model; a sampled system without a
        period, or one that no continuous system is (a pole on the negative real axis, a
        filter of finite length).

    Examples
    --------
    >>> import control
    >>> from_control(control.tf([10], [1, 2, 10]))
    10/(s**2 + 2*s + 10)
    >>> print(from_control(control.tf([1 - np.exp(-0.2)], [1, -np.exp(-0.2), 0], 0.1)))
    2 e^(-0.1 s) / (s + 2)
    """
    if isinstance(system, FractionalTransferFunction):
        return system
    if isinstance(system, (int, float)):
        return FractionalTransferFunction((Term(system, 0.0),), (Term(1.0, 0.0),))
    # What `to_control` made holds the exact system: reading its samples back would make
    # a stand-in of it.
    known = getattr(system, "fractional", None)
    if isinstance(known, FractionalTransferFunction):
        return known
    _check(system)
    if not hasattr(system, "num"):
        import control

        system = control.tf(system)
    top, bottom = system.num[0][0], system.den[0][0]
    if period := _sampling_period(system):
        return _continued(
            np.asarray(top, dtype=float), np.asarray(bottom, dtype=float), period
        )
    return FractionalTransferFunction(_polynomial(top), _polynomial(bottom))


def continuous(system: Any) -> FractionalTransferFunction:
    """`from_control` without sampled systems: an operator does not guess what holds
    their input.
    """
    period = getattr(system, "dt", None)
    if period is True or (period is not None and period > 0):
        raise FieldError(
            "system.dt",
            period,
            "a sampling period",
            allowed="continuous time (dt = 0)",
            remedy="fracsys.from_control(system) is the continuous system behind a zero-order hold",
        )
    return from_control(system)


def _check(system: Any) -> None:
    if not (hasattr(system, "num") or hasattr(system, "A")):
        raise FieldError(
            "system",
            type(system).__name__,
            "not a model",
            allowed="control.TransferFunction or control.StateSpace",
            remedy="frequency data has no transfer function: pass a callable to margins instead",
        )
    if (system.ninputs, system.noutputs) != (1, 1):
        raise FieldError(
            "system",
            (system.noutputs, system.ninputs),
            "of several inputs or outputs",
            allowed="one input and one output",
            remedy="select one channel, such as system[0, 0]",
        )


def _sampling_period(system: Any) -> float:
    """The period [s], 0 for continuous time; None is a time base that nobody stated:
    continuous, too.
    """
    period = system.dt
    if period is True:
        remedy = "give it one: control.tf(num, den, 0.01); margins takes it as it is"
        raise FieldError(
            "system.dt",
            period,
            "sampled, without a period",
            allowed="> 0 s",
            remedy=remedy,
        )
    return float(period or 0.0)


# --- sampled systems ------------------------------------------------------------------------------------

# of a polynomial's largest coefficient: a pole at z = 0 that rounding has moved
_AT_ZERO = 1e-12
_ON_AXIS = 1e-9
_ROUNDING = (
    1e-11  # of a numerator's largest term: what the logarithm's rounding leaves of none
)


def _continued(top: Reals, bottom: Reals, period: float) -> FractionalTransferFunction:
    """The continuous system behind a zero-order hold: [[A, B], [0, 1]] = exp([[A_c,
    B_c], [0, 0]] T).
    """
    top, bottom = np.trim_zeros(top, "f"), np.trim_zeros(bottom, "f")
    # A pole at z = 0 is a sample of delay; it has no logarithm, and goes first.
    steps = int(np.argmax(np.abs(bottom[::-1]) > _AT_ZERO * np.abs(bottom).max()))
    bottom = bottom[: bottom.size - steps]
    if top.size > bottom.size:
        _refuse(
            "a filter of finite length",
            period,
            "pass it to margins, which takes it as it is",
        )
    found = np.roots(bottom)
    if (turning := found[(found.real < 0.0) & (np.abs(found.imag) < _ON_AXIS)]).size:
        problem = f"a pole at z = {turning[0].real:.6g}, which alternates from sample to sample"
        _refuse(
            problem,
            period,
            "sample faster, or pass it to margins, which takes it as it is",
        )
    if bottom.size == 1:
        return FractionalTransferFunction(
            _polynomial(top), _polynomial(bottom)
        ).delayed(steps * period)
    a, b, c, d = tf2ss(top, bottom)
    order = len(a)
    # With the held input as one more state: dividing B by (A − I) fails for every
    # integrator, this does not.
    whole = (
        logm(np.block([[a, b], [np.zeros((1, order)), np.ones((1, 1))]])).real / period
    )
    numerator, denominator = ss2tf(whole[:order, :order], whole[:order, order:], c, d)
    # Terms are compared where they count: at the size of the poles.
    size = max(float(np.abs(np.log(found)).max()) / period, 1e-300) ** np.arange(
        order, -1, -1
    )
    kept = np.abs(numerator[0] * size) > _ROUNDING * np.abs(numerator[0] * size).max()
    made = FractionalTransferFunction(
        _polynomial(np.where(kept, numerator[0], 0.0)), _polynomial(denominator)
    )
    return made.delayed(steps * period)


def _refuse(problem: str, period: float, remedy: str) -> None:
    allowed = "what a continuous system gives behind a hold"
    raise FieldError(
        "system", f"dt = {period:g} s", problem, allowed=allowed, remedy=remedy
    )


def _polynomial(coefficients: Any) -> tuple[Term, ...]:
    degree = len(coefficients) - 1
    return tuple(
        Term(float(c), float(degree - k))
        for k, c in enumerate(coefficients)
        if c and math.isfinite(c)
    )
