"""Certificates: the sampled loop proved stable, with its distance from -1, in a file
others can check.
"""

from __future__ import annotations

from fraclink._certify.procedure import certify
from fraclink._certify.search import Enclosure, enclose_phase_margin
from fraclink._certify.statement import ASSUMPTIONS, Certificate, Statement

__all__ = [
    "ASSUMPTIONS",
    "Certificate",
    "Enclosure",
    "Statement",
    "certify",
    "enclose_phase_margin",
]
