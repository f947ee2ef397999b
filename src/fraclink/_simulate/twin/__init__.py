"""An arm that is not the model: a flexible link with distributed mass, a sticking motor, sensors with faults.

The lumped model the controller is designed from is one massless spring. The twin is an Euler–Bernoulli
beam with a payload, reduced to its modes and stepped exactly, with a choice of damping, and it writes the
same logs as a rig. It is a simulation, and everything it writes says so.
"""

from __future__ import annotations

from fraclink._arm.beam import Beam, Modes
from fraclink._simulate.twin.arm import Twin, damping_of, geared
from fraclink._simulate.twin.damping import FractionalKelvinVoigt, KelvinVoigt, PowerLaw
from fraclink._simulate.twin.events import Obstacle, PayloadChange, Restart, SensorFault, TipPulse
from fraclink._simulate.twin.frequencies import exact_frequencies
from fraclink._simulate.twin.logs import TwinLog, simulate_log
from fraclink._simulate.twin.loop import run_twin
from fraclink._simulate.twin.plant import Plant, assemble
from fraclink._simulate.twin.run import TwinRun
from fraclink._simulate.twin.sensors import Sensors

__all__ = [
    "Beam",
    "FractionalKelvinVoigt",
    "KelvinVoigt",
    "Modes",
    "Obstacle",
    "PayloadChange",
    "Plant",
    "PowerLaw",
    "Restart",
    "SensorFault",
    "Sensors",
    "TipPulse",
    "Twin",
    "TwinLog",
    "TwinRun",
    "assemble",
    "damping_of",
    "exact_frequencies",
    "geared",
    "run_twin",
    "simulate_log",
]
