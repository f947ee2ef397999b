"""A python-control frequency response that evaluates a fractional system exactly.

python-control's plots test for its own classes: an `LTI` subclass fails in them, and a
`TransferFunction` subclass is silently replaced by its integer-order stand-in. A
`FrequencyResponseData` works; unlike the stock class, this one interpolates nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import control
import numpy as np

from fracsys._fractional import FractionalTransferFunction
from fracsys._from_control import from_control
from fracsys._sweep import frequency_grid
from fracsys.errors import FracsysError

# python-control takes margins from splines over the grid: with these points and the
# refined ones they are accurate to 1e-4 degrees.
_POINTS = 1000


class FractionalResponse(control.FrequencyResponseData):  # type: ignore[misc]
    """G(jω) of a fractional system, exact at every frequency, with exact algebra."""

    # numpy scalars and arrays must leave `array * G` to this class instead of
    # multiplying element by element.
    __array_ufunc__ = None

    def __init__(
        self, system: FractionalTransferFunction, *, name: str | None = None
    ) -> None:
        self.fractional = system
        omega = frequency_grid(system, points=_POINTS)
        super().__init__(system(1j * omega), omega, dt=0, sysname=name or repr(system))
        if name is not None:
            self.name = name
        # python-control takes this attribute as "may be evaluated off the grid"; the
        # stock class keeps its splines in it.
        self._ifunc = True

    def eval(self, omega: Any, squeeze: bool | None = None) -> Any:
        """G(jω) at frequencies [rad/s], in the shape that python-control's `squeeze`
        rules ask for.
        """
        values = self.fractional(1j * np.atleast_1d(np.asarray(omega, dtype=float)))
        out = values.reshape(1, 1, -1)
        if np.ndim(omega) < 1:
            out = out[..., 0]
        if squeeze is None:
            squeeze = control.config.defaults["control.squeeze_frequency_response"]
        if squeeze:
            return np.squeeze(out)
        return out[0][0] if squeeze is None else out

    def __call__(
        self,
        x: Any = None,
        squeeze: bool | None = None,
        return_magphase: bool | None = None,
    ) -> Any:
        """G at any complex s [rad/s], not only on the imaginary axis; without s a copy,
        as in python-control.
        """
        if x is None:
            return super().__call__(squeeze=squeeze, return_magphase=return_magphase)
        points = np.asarray(x, dtype=complex)
        if squeeze is None and points.ndim < 2:
            return (
                self.fractional(points)
                if points.ndim
                else self.fractional(complex(points))
            )
        return self.eval(points.imag, squeeze=squeeze)

    def frd(self, omega: Any) -> Any:
        """Stock frequency response data on a given grid [rad/s], for functions that
        ignore `omega`.
        """
        grid = np.sort(np.asarray(omega, dtype=float).reshape(-1))
        return control.FrequencyResponseData(
            self.fractional(1j * grid), grid, dt=0, sysname=self.name
        )

    def frequency_response(self, omega: Any = None, squeeze: bool | None = None) -> Any:
        """Response at `omega` [rad/s] (default: the refined grid) as python-control's
        data object.
        """
        data = self.frd(self.omega if omega is None else omega)
        return data if squeeze is None else data(squeeze=squeeze)

    def dcgain(self) -> Any:
        """G(0): finite, zero or infinite."""
        return self.fractional(0j).real

    def __neg__(self) -> FractionalResponse:
        return FractionalResponse(-self.fractional)

    def __pow__(self, exponent: int) -> FractionalResponse:
        return FractionalResponse(self.fractional**exponent)

    def feedback(self, other: Any = 1, sign: int = -1) -> Any:
        """G/(1 − sign·G·H); unlike the stock class, this one uses the sign."""
        if type(other) is control.FrequencyResponseData:
            here = self.fractional(1j * other.omega)
            closed = here / (1 - sign * here * other.frdata.reshape(-1))
            return control.FrequencyResponseData(closed, other.omega, dt=0)
        # python-control accepts a feedback sign of any size; only its direction counts.
        return FractionalResponse(
            self.fractional.feedback(from_control(other), sign=-1 if sign < 0 else 1)
        )

    def _repr_eval_(self) -> str:
        return f"to_control({self.fractional!r})"

    def __str__(self) -> str:
        low, high = math.log10(self.omega[0]), math.log10(self.omega[-1])
        return f"{self.name}: {self.fractional!r}, exact; default grid 1e{low:.0f} to 1e{high:.0f} rad/s"


# --- algebra: exact with anything that has a transfer function; with measured data, on
# their own grid


def _operator(name: str) -> Callable[[FractionalResponse, Any], Any]:
    def operate(self: FractionalResponse, other: Any) -> Any:
        # Exactly this class, no subclass: a `FractionalResponse` is exact and must not
        # fall back to a grid.
        if type(other) is control.FrequencyResponseData:
            return getattr(self.frd(other.omega), name)(other)
        plain = other.item() if isinstance(other, np.generic) else other
        try:
            exact = from_control(plain)
        except (FracsysError, AttributeError):
            return NotImplemented
        return FractionalResponse(getattr(self.fractional, name)(exact))

    return operate


for _name in ("add", "sub", "mul", "truediv"):
    for _side in ("", "r"):
        _word = f"__{_side}{_name}__"
        setattr(FractionalResponse, _word, _operator(_word))
