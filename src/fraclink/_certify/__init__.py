"""Certificates: a proof that the sampled loop is stable and keeps its distance from -1,
in a file that others can check.
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
