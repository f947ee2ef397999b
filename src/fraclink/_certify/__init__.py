"""Certificates: the sampled loop proved stable, with its distance from -1, in a file
others can check.
"""

from __future__ import annotations

from fraclink._certify.procedure import certify
from fraclink._certify.statement import ASSUMPTIONS, Certificate, Statement

__all__ = [
    "ASSUMPTIONS",
    "Certificate",
    "Statement",
    "certify",
]
