"""Identification: from a log to a link model, with the figures needed to judge it.

`identify` fits the structure that the log supports; `compare_structures` shows all of
them.
"""

from fraclink._arm.recording import FrequencyResponse, Recording
from fraclink._identify.compare import Comparison, compare_structures, identify
from fraclink._identify.driven import DrivenLinkFit, identify_driven_link
from fraclink._identify.fit import (
    SYMBOLS,
    Fit,
    aic,
    coincidence,
)
from fraclink._identify.fitting import simulated_torque
from fraclink._identify.motor import MotorFit, identify_motor
from fraclink._identify.payloads import JointFit, LikelihoodRatio, identify_payloads
from fraclink._identify.problem import Interval
from fraclink._identify.residual import ResidualTests
from fraclink._identify.structure_fit import StructureFit
from fraclink._identify.structures import identify_structure
from fraclink._identify.validation import LogValidation, Validation

__all__ = [
    "SYMBOLS",
    "Comparison",
    "DrivenLinkFit",
    "Fit",
    "FrequencyResponse",
    "Interval",
    "JointFit",
    "LikelihoodRatio",
    "LogValidation",
    "MotorFit",
    "Recording",
    "ResidualTests",
    "StructureFit",
    "Validation",
    "aic",
    "coincidence",
    "compare_structures",
    "identify",
    "identify_driven_link",
    "identify_motor",
    "identify_payloads",
    "identify_structure",
    "simulated_torque",
]
