"""Exports: C and FMU files, and a starting point for a board."""

from __future__ import annotations

from fraclink._export.board import export_arm_firmware
from fraclink._export.c import export_c
from fraclink._export.claims import Claim, Proof
from fraclink._export.fmu import export_fmu

__all__ = [
    "Claim",
    "Proof",
    "export_arm_firmware",
    "export_c",
    "export_fmu",
]
