"""What may be given as a loop, and where its response has to be looked at."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from fraclink._systems.fractional import FractionalTransferFunction
from fraclink._systems.stability.fractional_loop import FractionalLoop
from fraclink._systems.stability.sweep import Loop
from fraclink._validate import checked_number
from fraclink.errors import FieldError

__all__ = ["Response", "as_loop"]

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]
Response = Callable[[Complex], Complex]

# Twelve decades around 1 rad/s hold every mechanical and electrical loop a callable can stand for.
_LOW, _HIGH = 1e-6, 1e6
# Central differences of ln L over 2e-5: exact to 1e-10, and the bracket guards what they get wrong.
_STEP = 1e-5


@dataclass(frozen=True)
class CallableLoop:
    """A loop given as a function of s, of which nothing else is known."""

    response: Response
    low: float
    high: float
    seeds: Real = field(default_factory=lambda: np.empty(0))
    delayed: bool = True  # for all that is known
    follow: float = -math.inf
    ends: tuple[complex, complex] = (complex(math.nan), complex(math.nan))

    def __call__(self, x: Real) -> Complex:
        """L(j e^x)."""
        values = np.asarray(self.response(1j * np.exp(x)), dtype=complex)
        if values.shape != x.shape:
            raise FieldError(
                "loop",
                values.shape,
                "of another shape than its argument",
                allowed=f"shape {x.shape}",
                remedy="write the callable with numpy operations on arrays of s",
            )
        if np.isnan(values).any():
            raise FieldError(
                "loop",
                "nan",
                f"not a number at {math.exp(float(x[np.isnan(values)][0])):.6g} rad/s",
                allowed="finite values (infinite at a pole on the axis)",
                remedy="check the callable there or lower limit=",
            )
        return values

    def point(self, x: float) -> tuple[complex, complex]:
        """L(j e^x) and d ln L/dx by a central difference, one-sided at the upper limit."""
        above, below = min(x + _STEP, self.high), x - _STEP
        low, here, high = self(np.array([below, x, above])).tolist()
        if not (low and high and cmath.isfinite(low) and cmath.isfinite(high)):
            return here, complex(math.nan, math.nan)
        return here, cmath.log(high / low) / (above - below)


def as_loop(loop: object, limit: float | None) -> Loop:
    """Return the loop with its range of frequencies and its seeds."""
    if limit is not None:
        limit = checked_number(
            "limit",
            limit,
            allowed="> 0 rad/s",
            remedy="give the Nyquist frequency",
            holds=lambda frequency: frequency > 0.0,
        )
    system = getattr(loop, "fractional", loop)  # what to_control wraps
    if isinstance(system, FractionalTransferFunction) and system.numerator:
        return FractionalLoop.of(system, limit)
    if hasattr(loop, "frdata") and hasattr(loop, "omega"):
        return _data_loop(loop, limit)
    if not callable(loop):
        raise FieldError(
            "loop",
            type(loop).__name__,
            "not a loop",
            allowed="a transfer function or a callable of s",
            remedy="pass a FractionalTransferFunction or a function of s = jω",
        )
    return _callable_loop(loop, limit)


def _data_loop(data: Any, limit: float | None) -> CallableLoop:
    """Measured frequency response data: straight lines in a Bode plot between the points."""
    omega, values = np.asarray(data.omega, dtype=float), np.asarray(data.frdata, dtype=complex)
    usable = omega > 0
    if values.size != omega.size or usable.sum() < 2 or not np.all(values):
        raise FieldError(
            "loop",
            values.shape,
            "not one response at two frequencies or more",
            allowed="one input, one output, values that are not zero",
            remedy="select one channel of the data",
        )
    x, logs = np.log(omega[usable]), np.log(np.abs(values.reshape(-1)[usable]))
    phase = np.unwrap(np.angle(values.reshape(-1)[usable]))

    def response(s: Complex) -> Complex:
        at = np.log(s.imag)
        return np.asarray(np.exp(np.interp(at, x, logs) + 1j * np.interp(at, x, phase)))

    high = float(x[-1]) if limit is None else min(float(x[-1]), math.log(limit))
    return CallableLoop(response, float(x[0]), high, seeds=x)


def _callable_loop(loop: Callable[..., object], limit: float | None) -> CallableLoop:
    """A function of s, or a python-control system (recognised by its `dt`; sampled ones stop at π/dt)."""
    response, period = loop, getattr(loop, "dt", None)
    if isinstance(period, (int, float)) and not isinstance(period, bool) and period > 0:
        step = float(period)
        limit = math.pi / step if limit is None else min(limit, math.pi / step)

        def response(s: Complex) -> object:
            return loop(np.exp(s * step))

    high = _HIGH if limit is None else limit
    return CallableLoop(cast(Response, response), math.log(min(_LOW, high * 1e-6)), math.log(high))
