"""Design of the outer controller: the procedure of section 6, on the ideal loop or on the loop that runs."""

from __future__ import annotations

from fraclink._design.optimum import Optimised, Step, optimise
from fraclink._design.plan import Design, Requirement
from fraclink._design.procedure import design
from fraclink._design.request import deg

__all__ = ["Design", "Optimised", "Requirement", "Step", "deg", "design", "optimise"]
