"""From an unknown arm to a certified law, by moving it: wiring, motor, link, design, proof, first moves.

Every voltage passes one guard, which keeps the user's limits and the record; every stage is a function of the
arm and of what is known, and is written when it is whole.
"""

from __future__ import annotations

from fraclink._tune.guard import LimitReached, MotionLimits
from fraclink._tune.moves import FirstMove
from fraclink._tune.plan import TuningPlan
from fraclink._tune.procedure import tune
from fraclink._tune.tuning import Tuning
from fraclink._tune.watch import Change, Watch, watch
from fraclink._tune.wiring import Wiring, WiringFault

__all__ = [
    "Change",
    "FirstMove",
    "LimitReached",
    "MotionLimits",
    "Tuning",
    "TuningPlan",
    "Watch",
    "Wiring",
    "WiringFault",
    "tune",
    "watch",
]
