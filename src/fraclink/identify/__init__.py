"""Identification: from a log to a link model, with what it takes to judge it.

`identify` fits one structure, `identify_all` the four of them with a verdict in words.
"""

from fraclink.identify.comparison import Comparison, Contest, identify_all
from fraclink.identify.fit import Fit, load_model, save_model
from fraclink.identify.payloads import JointFit, LikelihoodRatio, identify_payloads
from fraclink.identify.profile import Interval
from fraclink.identify.single import identify, simulated_torque
from fraclink.identify.spectrum import (
    FrequencyResponse,
    SpectrumFit,
    frequency_response,
    identify_frequency_response,
)
from fraclink.identify.statistics import ResidualTests, aic, bic

__all__ = [
    "Comparison",
    "Contest",
    "Fit",
    "FrequencyResponse",
    "Interval",
    "JointFit",
    "LikelihoodRatio",
    "ResidualTests",
    "SpectrumFit",
    "aic",
    "bic",
    "frequency_response",
    "identify",
    "identify_all",
    "identify_frequency_response",
    "identify_payloads",
    "load_model",
    "save_model",
    "simulated_torque",
]
