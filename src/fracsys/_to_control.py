"""A fractional system as python-control takes it.

python-control is imported at the first call only, since that takes seconds.
"""

from __future__ import annotations

from typing import Any

from fracsys._fractional import FractionalTransferFunction
from fracsys.errors import FieldError, MissingExtraError

__all__ = ["to_control"]


def to_control(system: FractionalTransferFunction, *, name: str | None = None) -> Any:
    """Return a fractional system as an exact python-control frequency response.

    The object is a `control.FrequencyResponseData` that evaluates G(jω) itself at any
    frequency, not an interpolation, so that `bode_plot`, `nyquist_plot`,
    `nichols_plot`, `margin`, `stability_margins`, `frequency_response` work on it.
    Products, sums, quotients and `feedback` with numbers and SISO continuous-time
    systems give exact systems again. What needs states (`step_response`, `ss`,
    `root_locus`) cannot work: use `fracsys.step_response`, or `approximate(...)` and
    its `state_space()`.

    The result is a subclass with the attribute `fractional`, the system itself.

    Parameters
    ----------
    system
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
    >>> import control
    >>> from fracsys._fractional import s
    >>> loop = to_control(0.148 * s**0.65 * 100 / (s**1.92 + 100))
    >>> print(round(abs(loop(7.38002280875371j)), 9))
    1.0
    """
    if not isinstance(system, FractionalTransferFunction) or not system.numerator:
        raise FieldError(
            "system",
            repr(system),
            "not a fractional transfer function with a response",
            allowed="FractionalTransferFunction other than 0",
            remedy="build it from fracsys.s",
        )
    try:
        # A separate module, because its class derives from one of python-control's.
        from fracsys._control_adapter import FractionalResponse
    except ImportError as error:
        raise MissingExtraError("control", "control") from error
    return FractionalResponse(system, name=name)
