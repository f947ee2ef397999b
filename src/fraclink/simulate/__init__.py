"""Closed-loop simulation around law.c."""

from __future__ import annotations

from fraclink.simulate.metrics import Metrics, Verdict
from fraclink.simulate.run import Run, Settings
from fraclink.simulate.simulate import simulate

__all__ = ["Metrics", "Run", "Settings", "Verdict", "simulate"]
