"""Identification: from a log to a link model, with what it takes to judge it.

`identify` fits one structure, `identify_all` the four of them with a verdict in words.
"""

from fraclink._identify.comparison import Comparison, Contest, identify_all
from fraclink._identify.excitation import ExperimentDesign, design_experiment
from fraclink._identify.fit import Fit, load_model, save_model
from fraclink._identify.jointfit import JointFit, LikelihoodRatio
from fraclink._identify.motor import MotorFit, identify_motor
from fraclink._identify.payloads import identify_payloads
from fraclink._identify.profile import Interval
from fraclink._identify.single import identify, simulated_torque
from fraclink._identify.spectrum import (
    FrequencyResponse,
    SpectrumFit,
    frequency_response,
    identify_frequency_response,
)
from fraclink._identify.statistics import ResidualTests, aic, bic

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
