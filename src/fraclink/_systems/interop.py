"""Between fraclink and python-control: exact systems there, integer-order systems here.

python-control is imported at the first call and not before (it costs seconds).
"""

from __future__ import annotations

import math
from typing import Any

from fraclink._systems.fractional import FractionalTransferFunction
from fraclink._systems.terms import Term
from fraclink.errors import FieldError, MissingExtraError


def to_control(system: FractionalTransferFunction, *, name: str | None = None) -> Any:
    """Return a fractional system as an exact python-control frequency response.

    The object is a `control.FrequencyResponseData` that evaluates G(jω) itself at any frequency, not an
    interpolation, so that `bode_plot`, `nyquist_plot`, `nichols_plot`, `margin`, `stability_margins`,
    `frequency_response` work on it. Products, sums, quotients and `feedback` with numbers and SISO
    continuous-time systems give exact systems again. What needs states (`step_response`, `ss`, `root_locus`)
    cannot work: use `fraclink.step_response`, or `approximate(...)` and its `state_space()`.

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
    >>> from fraclink._systems.fractional import s
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
            remedy="build it from fraclink.s",
        )
    try:
        # A module of its own, as its class derives from one of python-control's.
        from fraclink._systems.control_adapter import FractionalResponse
    except ImportError as error:
        raise MissingExtraError("control", "control") from error
    return FractionalResponse(system, name=name)


def from_control(system: Any) -> FractionalTransferFunction:
    """Return a python-control system as a fractional transfer function with integer orders.

    Parameters
    ----------
    system
        One input, one output, continuous time.


    Raises
    ------
    FieldError
        More than one input or output, a sampled system (`margins` takes it as it is), data without a model.

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
    # What `to_control` made holds the exact system: reading its samples back would make a stand-in of it.
    known = getattr(system, "fractional", None)
    if isinstance(known, FractionalTransferFunction):
        return known
    _check(system)
    if not hasattr(system, "num"):
        import control

        system = control.tf(system)
    return FractionalTransferFunction(_polynomial(system.num[0][0]), _polynomial(system.den[0][0]))


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
    # None is a system of unstated time base, which python-control treats as continuous.
    period = system.dt
    if period is True or (period is not None and period > 0):
        raise FieldError(
            "system.dt",
            period,
            "a sampling period",
            allowed="continuous time (dt = 0)",
            remedy="margins takes sampled systems as they are; or convert it to continuous time",
        )


def _polynomial(coefficients: Any) -> tuple[Term, ...]:
    degree = len(coefficients) - 1
    return tuple(
        Term(float(c), float(degree - k)) for k, c in enumerate(coefficients) if c and math.isfinite(c)
    )
