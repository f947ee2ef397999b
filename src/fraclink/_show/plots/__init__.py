"""Plots of loops and responses: each draws into `ax` (or new axes) and returns the axes.

Conventions of python-control: dB, degrees, rad/s, one curve for each system. Unlike there, the grid refines
itself where the drawn curve bends, and the phase starts on the sheet of the low-frequency slope: a lead
s^0.65 is drawn at 58.5° and not at −301.5°. matplotlib is imported at the first plot.
"""

from __future__ import annotations

from fraclink._show.plots.bode import bode, margins
from fraclink._show.plots.design import margins_against_payload, phase_shares
from fraclink._show.plots.planes import nichols, nyquist
from fraclink._show.plots.realtime import latency
from fraclink._show.plots.time import step

__all__ = [
    "bode",
    "latency",
    "margins",
    "margins_against_payload",
    "nichols",
    "nyquist",
    "phase_shares",
    "step",
]
