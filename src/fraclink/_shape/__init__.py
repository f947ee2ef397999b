"""References for the loop that runs: the fastest move within its limits, beside the known shapers."""

from __future__ import annotations

from fraclink._shape.move import Measured, ShapedMove
from fraclink._shape.procedure import shape

__all__ = ["Measured", "ShapedMove", "shape"]
