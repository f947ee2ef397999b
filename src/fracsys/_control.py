"""Conversion of python-control systems to fractional ones, and of fractional systems to
frequency responses of python-control.

python-control is only imported by the first call, since that takes seconds.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fracsys._fractional import FractionalTransferFunction
from fracsys._sweep import frequency_grid
from fracsys._terms import Term
from fracsys.errors import FieldError, MissingExtraError

__all__ = ["from_control", "to_control"]


def to_control(
    system: FractionalTransferFunction,
    frequencies: ArrayLike | None = None,
    *,
    name: str | None = None,
) -> Any:
    """Return the exact response of a fractional system as python-control's
    `FrequencyResponseData`.

    Its plots and margins accept it, and so do products, sums and feedback with other
    systems on the same frequencies. The same operations on functions of s are exact at
    every frequency: do them first and convert the result. Functions that need states
    (`step_response`, `ss`, `root_locus`) reject it: use `fracsys.step_response`, or
    `approximate(...)` and its `state_space()`.

    Parameters
    ----------
    system
        G(s).
    frequencies
        [rad/s], ascending; default: those that margins and plots need.
    name
        Name shown in python-control's legends.

    Raises
    ------
    MissingExtraError
        python-control is not installed.
    FieldError
        Not a fractional transfer function, or one that is zero.

    Examples
    --------
    >>> from fracsys._fractional import s
    >>> import control
    >>> loop = to_control(0.148 * s**0.65 * 100 / (s**1.92 + 100))
    >>> gain, phase, at_phase, at_gain = control.margin(loop)
    >>> print(f"{at_gain:.3f} rad/s")
    15.162 rad/s
    """
    if not isinstance(system, FractionalTransferFunction) or not system.numerator:
        raise FieldError(
            "system",
            repr(system),
            "not a fractional transfer function with a response",
            "FractionalTransferFunction other than 0",
            "build it from fracsys.s",
        )
    try:
        import control
    except ImportError as error:
        raise MissingExtraError("control", "control") from error
    # python-control takes margins from splines over the grid, accurate to 1e-4 degrees.
    w = frequency_grid(system) if frequencies is None else frequencies
    axis = np.asarray(w, float)
    label = name or repr(system)
    return control.frd(system(1j * axis), axis, name=name, sysname=label)


def from_control(system: Any) -> FractionalTransferFunction:
    """Return a python-control system as a fractional transfer function with integer
    orders.

    Parameters
    ----------
    system
        One input, one output, continuous time.

    Raises
    ------
    FieldError
        More than one input or output, a sampled system, data without a model.

    Examples
    --------
    >>> import control
    >>> from_control(control.tf([10], [1, 2, 10]))
    10/(s**2 + 2*s + 10)
    """
    if isinstance(system, FractionalTransferFunction):
        return system
    if isinstance(system, (int, float)):
        return FractionalTransferFunction((Term(system, 0.0),), (Term(1.0, 0.0),))
    if not (hasattr(system, "num") or hasattr(system, "A")):
        raise FieldError(
            "system",
            type(system).__name__,
            "not a model",
            "control.TransferFunction or control.StateSpace",
            "frequency data has no transfer function: pass a callable to margins instead",
        )
    if (system.ninputs, system.noutputs) != (1, 1):
        raise FieldError(
            "system",
            (system.noutputs, system.ninputs),
            "has several inputs or outputs",
            "one input and one output",
            "select one channel, such as system[0, 0]",
        )
    # dt = None means that no time base was stated; it counts as continuous
    if system.dt:
        raise FieldError(
            "system.dt",
            system.dt,
            "a sampling period",
            "continuous time (dt = 0)",
            "pass it to margins, which accepts it unchanged",
        )
    if not hasattr(system, "num"):
        import control

        system = control.tf(system)
    numerator, denominator = system.num[0][0], system.den[0][0]
    return FractionalTransferFunction(_polynomial(numerator), _polynomial(denominator))


def _polynomial(coefficients: Any) -> tuple[Term, ...]:
    degree = len(coefficients) - 1
    return tuple(
        Term(float(c), float(degree - k))
        for k, c in enumerate(coefficients)
        if c and math.isfinite(c)
    )
