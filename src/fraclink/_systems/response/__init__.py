"""Exact time responses of fractional transfer functions to held inputs.

>>> from fraclink._systems.fractional import s
>>> from fraclink._systems.response import time_response
>>> result = time_response(100 / (s**1.92 + 100), [1.0] * 5, 0.004)
>>> result.method, result.error_estimate < 1e-12
('modes', True)
"""

from fraclink._systems.response.discrete import discretize
from fraclink._systems.response.grunwald import grunwald_letnikov
from fraclink._systems.response.modes import DiscreteModes
from fraclink._systems.response.simulate import TimeResponse, impulse_response, step_response, time_response

__all__ = [
    "DiscreteModes",
    "TimeResponse",
    "discretize",
    "grunwald_letnikov",
    "impulse_response",
    "step_response",
    "time_response",
]
