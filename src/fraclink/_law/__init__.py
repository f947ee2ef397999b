"""The control law: what is simulated is what is shipped (csrc/law.c), and these are its
coefficients.
"""

from __future__ import annotations

from fraclink._law.block import Drive, Modes, Tracking
from fraclink._law.discretization import (
    discretize,
    discretize_controller,
    drive_for,
    equip,
)
from fraclink._law.law import MODES, REASONS, Law, LawInputs, LawOutputs
from fraclink._law.limits import Limits, derive_limits

__all__ = [
    "MODES",
    "REASONS",
    "Drive",
    "Law",
    "LawInputs",
    "LawOutputs",
    "Limits",
    "Modes",
    "Tracking",
    "derive_limits",
    "discretize",
    "discretize_controller",
    "drive_for",
    "equip",
]
