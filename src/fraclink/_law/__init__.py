"""The control law and its coefficients: the law that is simulated is the one that ships
(csrc/law.c).
"""

from __future__ import annotations

from fraclink._law.block import DiscreteMotorLoop, Modes, Tracking
from fraclink._law.discretization import (
    discrete_motor_loop,
    discretize,
    discretize_controller,
    equip,
)
from fraclink._law.law import MODES, REASONS, Law, LawInputs, LawOutputs
from fraclink._law.limits import Limits, derive_limits

__all__ = [
    "MODES",
    "REASONS",
    "DiscreteMotorLoop",
    "Law",
    "LawInputs",
    "LawOutputs",
    "Limits",
    "Modes",
    "Tracking",
    "derive_limits",
    "discrete_motor_loop",
    "discretize",
    "discretize_controller",
    "equip",
]
