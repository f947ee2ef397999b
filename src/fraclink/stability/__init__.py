"""Poles, stability, margins and norms of fractional systems and of any loop given as a callable."""

from __future__ import annotations

from fraclink.stability.margins import margins
from fraclink.stability.norms import norm
from fraclink.stability.poles import StabilityVerdict, is_stable, poles
from fraclink.stability.results import GainCrossing, Margins, PhaseCrossing

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
