"""What may be given as a loop, and where its response has to be looked at."""

from __future__ import annotations

import math
from typing import cast

import numpy as np

from fraclink.errors import FieldError
from fraclink.stability.sweep import Loop, Response

__all__ = ["as_loop"]

# Twelve decades around 1 rad/s hold every mechanical and electrical loop a callable can stand for.
_LOW, _HIGH = 1e-6, 1e6


def as_loop(loop: object, limit: float | None) -> Loop:
    """Return the loop with its range of frequencies and its seeds."""
    if limit is not None and not (math.isfinite(limit) and limit > 0):
        raise FieldError(
            "limit",
            limit,
            "not a frequency",
            allowed="> 0 rad/s",
            remedy="give the Nyquist frequency or None",
        )
    if not callable(loop):
        raise FieldError(
            "loop",
            type(loop).__name__,
            "not a loop",
            allowed="a transfer function or a callable of s",
            remedy="pass a FractionalTransferFunction or a function of s = jω",
        )
    high = _HIGH if limit is None else limit
    return Loop(cast(Response, loop), math.log(min(_LOW, high * 1e-6)), math.log(high), np.empty(0))
