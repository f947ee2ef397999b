"""Systems of python-control as fractional ones.

python-control is imported at the first call only, since that takes seconds.
"""

from __future__ import annotations

import math
from typing import Any

from fracsys._fractional import FractionalTransferFunction
from fracsys._terms import Term
from fracsys.errors import FieldError


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
    # A result of `to_control` carries the exact system; its samples would only give an
    # approximation.
    fractional = getattr(system, "fractional", None)
    if isinstance(fractional, FractionalTransferFunction):
        return fractional
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
    # dt = None means that no time base was stated; it counts as continuous
    if system.dt:
        raise FieldError(
            "system.dt",
            system.dt,
            "a sampling period",
            allowed="continuous time (dt = 0)",
            remedy="pass it to margins, which takes it as it is",
        )
    if not hasattr(system, "num"):
        import control

        system = control.tf(system)
    top, bottom = system.num[0][0], system.den[0][0]
    return FractionalTransferFunction(_polynomial(top), _polynomial(bottom))


def _polynomial(coefficients: Any) -> tuple[Term, ...]:
    degree = len(coefficients) - 1
    return tuple(
        Term(float(c), float(degree - k))
        for k, c in enumerate(coefficients)
        if c and math.isfinite(c)
    )
