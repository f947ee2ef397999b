"""Design of the outer controller: the procedure of section 6, on the loop that runs."""

from __future__ import annotations

from fraclink._design.optimisation import Optimised, Step, optimise
from fraclink._design.procedure import design
from fraclink._law.design import Design, Requirement, Specification, deg

__all__ = [
    "Design",
    "Optimised",
    "Requirement",
    "Specification",
    "Step",
    "deg",
    "design",
    "optimise",
]
