"""Poles, stability, margins and norms of fractional systems and of any loop given as a callable."""

from __future__ import annotations

from fraclink._systems.stability.margins import margins
from fraclink._systems.stability.norms import norm
from fraclink._systems.stability.poles import StabilityVerdict, is_stable, poles
from fraclink._systems.stability.results import GainCrossing, Margins, PhaseCrossing

__all__ = [
    "GainCrossing",
    "Margins",
    "PhaseCrossing",
    "StabilityVerdict",
    "is_stable",
    "margins",
    "norm",
    "poles",
]
