"""Identification: from a log to a link model, with what it takes to judge it.

`identify` fits one structure, `identify_all` the four of them with a verdict in words.
"""

from fraclink.identify.comparison import Comparison, Contest, identify_all
from fraclink.identify.fit import Fit, load_model, save_model
from fraclink.identify.profile import Interval
from fraclink.identify.single import identify, simulated_torque
from fraclink.identify.statistics import ResidualTests, aic, bic

__all__ = [
    "Comparison",
    "Contest",
    "Fit",
    "Interval",
    "ResidualTests",
    "aic",
    "bic",
    "identify",
    "identify_all",
    "load_model",
    "save_model",
    "simulated_torque",
]
