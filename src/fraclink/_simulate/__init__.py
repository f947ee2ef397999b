"""Single runs of one arm (the model with its massless link, or the twin) under the
shipped law, and shaped moves.
"""

from __future__ import annotations

from fraclink._arm.beam import Beam, BeamModes
from fraclink._simulate.arm import Twin, damping_of, geared
from fraclink._simulate.damping import (
    FractionalKelvinVoigt,
    KelvinVoigt,
    PowerLaw,
)
from fraclink._simulate.events import (
    Obstacle,
    PayloadChange,
    Restart,
    SensorFault,
    TipPulse,
)
from fraclink._simulate.metrics import Metrics, MoveVerdict
from fraclink._simulate.plant import Plant, assemble
from fraclink._simulate.run import Run
from fraclink._simulate.simulate import simulate

__all__ = [
    "Beam",
    "BeamModes",
    "FractionalKelvinVoigt",
    "KelvinVoigt",
    "Metrics",
    "MoveVerdict",
    "Obstacle",
    "PayloadChange",
    "Plant",
    "PowerLaw",
    "Restart",
    "Run",
    "SensorFault",
    "TipPulse",
    "Twin",
    "assemble",
    "damping_of",
    "geared",
    "simulate",
]
