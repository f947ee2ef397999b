"""Closed-loop simulation around law.c."""

from __future__ import annotations

from fraclink._simulate.metrics import Metrics, Verdict
from fraclink._simulate.run import Run, Settings
from fraclink._simulate.simulate import simulate

__all__ = ["Metrics", "Run", "Settings", "Verdict", "simulate"]
