"""Fractional transfer functions: `s`, `Term`, `FractionalTransferFunction`.

>>> from fraclink._systems.fractional import s
>>> 1 / (s**1.5 + 2 * s**0.5 + 1)
1 / (s^1.5 + 2 s^0.5 + 1)
"""

from fraclink._systems.fractional.function import FractionalTransferFunction, s
from fraclink._systems.fractional.terms import Term

__all__ = ["FractionalTransferFunction", "Term", "s"]
