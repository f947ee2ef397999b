"""Identification: from a log to a link model, with what it takes to judge it.

`identify` fits one structure, `identify_all` the four of them with a verdict in words.
"""

from fraclink.identify.comparison import Comparison, Contest, identify_all
from fraclink.identify.excitation import ExperimentDesign, design_experiment
from fraclink.identify.fit import Fit, load_model, save_model
from fraclink.identify.jointfit import JointFit, LikelihoodRatio
from fraclink.identify.motor import MotorFit, identify_motor
from fraclink.identify.payloads import identify_payloads
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
    "ExperimentDesign",
    "Fit",
    "FrequencyResponse",
    "Interval",
    "JointFit",
    "LikelihoodRatio",
    "MotorFit",
    "ResidualTests",
    "SpectrumFit",
    "aic",
    "bic",
    "design_experiment",
    "frequency_response",
    "identify",
    "identify_all",
    "identify_frequency_response",
    "identify_motor",
    "identify_payloads",
    "load_model",
    "save_model",
    "simulated_torque",
]
